"""Commands that are killed or asked to end at any moment: old files or new ones, and nothing left after the next run.

A command is run to its end first, over an older result, and the steps of its writing are counted: every file or folder
that is opened for writing, made, renamed or removed. Then it is killed before some of these steps, and at some moments
of its whole time. What is found is compared byte by byte: nobody may edit gnomon's sources meanwhile.
"""

import os
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("resource", reason="signals and limits as POSIX has them")

from gnomon.output import put_in_place
from gnomon.study.journal import JOURNAL
from killing import Killer, contents, refill, visible

SMALL = ("--intervals", 12, "--t-init-s", 20, "--hold-s", 3, 3.5, "--rate-hz", 50)
FOREIGN = {"notes.txt": b"mine"}
KEPT = ("corners-", JOURNAL)
"""What is kept of work that was not finished; the names begin so."""
KILLS = int(os.environ.get("GNOMON_KILLS", "30"))


@dataclass(frozen=True)
class Case:
    """Two commands that write the same names, the older one and the newer one; without an older one nothing is there.

    A command takes (folder of the inputs, folder of the result).
    """

    new: Callable[[Path, Path], tuple[object, ...]]
    old: Callable[[Path, Path], tuple[object, ...]] | None = None


def seeds(*words: object, name: str = "") -> Case:
    """A simulation with two seeds."""

    def command(seed: int) -> Callable[[Path, Path], tuple[object, ...]]:
        return lambda inputs, out: (*words, "--seed", seed, "-o", out / name if name else out)

    return Case(command(2), command(1))


def recordings(*words: object, ending: str = ".npz", kind: str = "imu") -> Case:
    """A calibration of two recordings."""

    def command(number: int) -> Callable[[Path, Path], tuple[object, ...]]:
        return lambda inputs, out: (words[0], inputs / f"{kind}{number}{ending}", *words[1:], "-o", out)

    return Case(command(2), command(1))


CASES = {
    "imu": recordings("imu"),
    "noise": recordings("noise", kind="rest"),
    "magnetometer": recordings("magnetometer", kind="field"),
    "turntable": recordings("turntable", "--rate", "16rpm", kind="turns", ending=""),
    "camera": recordings("camera", kind="views", ending=""),
    "camera-imu": recordings("camera-imu", kind="waved", ending=""),
    "camera-imu of images": Case(
        lambda inputs, out: ("camera-imu", inputs / "images", "-o", out, "--workers", 1),
        lambda inputs, out: ("camera-imu", inputs / "waved1", "-o", out),
    ),
    "apply": Case(
        lambda inputs, out: ("apply", inputs / "truth.yaml", inputs / "imu2.npz", "-o", out / "a.csv"),
        lambda inputs, out: ("apply", inputs / "truth.yaml", inputs / "imu1.npz", "-o", out / "a.csv"),
    ),
    "convert": Case(
        lambda inputs, out: ("convert", inputs / "cal2.yaml", "--to", "kalibr", "-o", out),
        lambda inputs, out: ("convert", inputs / "cal1.yaml", "--to", "kalibr", "-o", out),
    ),
    "convert to a bag": Case(lambda inputs, out: ("convert", inputs / "images", "--to", "ros1", "-o", out / "a.bag")),
    "convert to a folder": Case(
        lambda inputs, out: ("convert", inputs / "images", "--to", "euroc", "-o", out / "euroc")
    ),
    "compare": Case(
        lambda inputs, out: ("compare", inputs / "cal1.yaml", inputs / "cal2.yaml", "-o", out),
        lambda inputs, out: ("compare", inputs / "cal2.yaml", inputs / "cal1.yaml", "-o", out),
    ),
    "target": Case(
        lambda inputs, out: ("target", "aprilgrid", "--size", "20mm", "--paper", "A3", "-o", out / "board"),
        lambda inputs, out: ("target", "aprilgrid", "--size", "20mm", "--paper", "A4", "-o", out / "board"),
    ),
    "simulate": seeds("simulate", *SMALL, name="imu.csv"),
    "simulate-poses": seeds("simulate-poses", name="poses.csv"),
    "simulate-turntable": seeds("simulate-turntable"),
    "simulate-platter-video": seeds("simulate", "platter-video", "--duration-s", 4, "--width", 160, name="video.mp4"),
    "simulate-magnetometer": seeds("simulate", "magnetometer", "--duration-s", 20, name="field.npz"),
    "simulate-noise": seeds("simulate", "noise", "--duration-s", 60, name="rest.npz"),
    "simulate-cameras": seeds("simulate", "cameras", "--views", 12),
    "simulate-camera-imu": seeds("simulate", "camera-imu", "--duration-s", 4),
    "simulate camera-imu --images": seeds(
        "simulate", "camera-imu", "--duration-s", 1, "--images", "--camera-rate-hz", 8
    ),
    "study": seeds("study", "angrisano", "--runs", 2),
    "demo": seeds("demo", "--no-report"),
}
CHEAP = ("convert",)
READING = {
    "show": lambda inputs: ("show", inputs / "cal1.yaml"),
    "check": lambda inputs: ("check", inputs / "imu1.npz"),
    "plan-imu": lambda inputs: ("plan-imu",),
}


@pytest.fixture(scope="module")
def inputs(run, tmp_path_factory):
    """Recordings and calibrations, made once, of the kinds that are asked for."""
    folder = tmp_path_factory.mktemp("inputs")

    def made(*words: object) -> None:
        code, _, err = run(*words)
        assert code in {0, 4}, err

    def rest(number: int) -> None:
        made("simulate", "noise", "-o", folder / f"rest{number}.npz", "--duration-s", 900, "--seed", number)

    def imu(number: int) -> None:
        made("simulate", *SMALL, "-o", folder / f"imu{number}.npz", "--seed", number)
        made("imu", folder / f"imu{number}.npz", "-o", folder / f"out{number}", "--no-report")
        shutil.copy(folder / f"out{number}" / "calibration.yaml", folder / f"cal{number}.yaml")

    def field(number: int) -> None:
        made("simulate", "magnetometer", "-o", folder / f"field{number}.npz", "--seed", number)

    def turns(number: int) -> None:
        made("simulate", "turntable", "-o", folder / f"turns{number}", "--seed", number)

    def views(number: int) -> None:
        made("simulate", "cameras", "-o", folder / f"views{number}", "--views", 20, "--seed", number)

    def waved(number: int) -> None:
        made("simulate", "camera-imu", "-o", folder / f"waved{number}", "--duration-s", 20, "--seed", number)

    def images(_: int) -> None:
        words = ("--duration-s", 20, "--images", "--camera-rate-hz", 4)
        made("simulate", "camera-imu", "-o", folder / "images", *words)

    makers = {maker.__name__: maker for maker in (rest, imu, field, turns, views, waved, images)}
    needs = {"noise": "rest", "magnetometer": "field", "turntable": "turns", "camera": "views", "camera-imu": "waved"}
    done: set[str] = set()

    def ready(name: str) -> Path:
        kinds = [needs.get(name, "imu")] if "images" not in name and "to a " not in name else ["images", "waved"]
        for kind in kinds:
            if kind not in done and not name.startswith("simulate"):
                done.add(kind)
                for number in (1, 2):
                    makers[kind](number)
        return folder

    return ready


def result(found: dict[str, bytes]) -> dict[str, bytes]:
    """Return the files of a folder without what is kept of unfinished work."""
    return {name: data for name, data in found.items() if not name.startswith(KEPT)}


@dataclass
class Stage:
    """A command that is about to be killed: over an older result, with what it writes when it is left in peace."""

    killer: Killer
    arguments: list[str]
    out: Path
    before: Path
    old: dict[str, bytes]
    new: dict[str, bytes]
    steps: int
    seconds: float

    def reset(self) -> None:
        refill(self.out, self.before)

    def judge(self, where: object) -> str:
        """Check what a killed command left, and return whether that is the old or the new result."""
        for name, data in visible(contents(self.out)).items():
            grown = name == JOURNAL and data.startswith(self.old[name]) and self.new[name].startswith(data)
            assert grown or data in {self.old.get(name), self.new.get(name)}, (where, name)
        put_in_place(self.out)  # what any gnomon command does that names the folder
        found = result(visible(contents(self.out)))
        sets = [result(self.old), result(self.new)]
        assert found in sets, (where, sorted(found))
        return "old" if found == sets[0] else "new"

    def finish(self, run: Callable[..., tuple[int, str, str]]) -> None:
        """Run the command to its end where it was killed: nothing is left of the one before."""
        code, _, err = run(*self.arguments)
        assert code in {0, 4}, err
        found = contents(self.out)
        assert sorted(found) == sorted(self.new)


def staged(case: Case, folder: Path, place: Path, run: Callable[..., tuple[int, str, str]]) -> Stage:
    """Make an older result, and see what the command makes of it."""
    killer, out, before = Killer(place / "killer"), place / "out", place / "before"
    out.mkdir()
    if case.old is not None:
        code, _, err = run(*case.old(folder, out))
        assert code in {0, 4}, err
    for name, data in FOREIGN.items():
        (out / name).write_bytes(data)
    refill(before, out)
    arguments = [str(word) for word in case.new(folder, out)]
    start = time.monotonic()
    steps = killer.steps(["-m", "gnomon", *arguments], place)
    seconds = time.monotonic() - start
    new = contents(out)
    assert new != contents(before)
    return Stage(killer, arguments, out, before, contents(before), new, steps, seconds)


def kills(stage: Stage, place: Path, after: list[float], at: list[int]) -> list[str]:
    """Kill a command at moments and steps, and return what was found each time."""
    command = ["-m", "gnomon", *stage.arguments]
    found: list[str] = []
    for seconds in after:
        stage.reset()
        assert stage.killer.killed_after(seconds, command, place) in {-signal.SIGKILL, 0, 4}
        found.append(stage.judge(seconds))
    for step in at:
        stage.reset()
        assert stage.killer.killed_at(step, command, place)[0] == -signal.SIGKILL, step
        found.append(stage.judge(step))
    return found


@pytest.mark.parametrize("name", CHEAP)
def test_a_killed_command_leaves_old_or_new(name, inputs, run, tmp_path):
    stage = staged(CASES[name], inputs(name), tmp_path, run)
    found = kills(stage, tmp_path, [], [stage.steps // 2, stage.steps - 2])
    assert found[-1] == "new"
    stage.finish(run)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_every_command_killed_at_many_moments(name, inputs, run, tmp_path, capsys):
    stage = staged(CASES[name], inputs(name), tmp_path, run)
    rng = np.random.default_rng(8)
    late = [stage.steps - k for k in range(min(2 * KILLS // 5, stage.steps))]
    early = sorted({int(step) for step in rng.integers(1, stage.steps + 1, KILLS // 3)} - set(late))
    count = KILLS - len(late) - len(early)
    moments = [float(second) for second in np.sort(rng.uniform(0.0, 1.05 * stage.seconds, count))]
    found = kills(stage, tmp_path, moments, [*late, *reversed(early)])
    stage.finish(run)  # after an early step: some commands replace nothing
    with capsys.disabled():
        print(f"\n{name}: {stage.steps} steps, {len(found)} kills: {found.count('old')} old, {found.count('new')} new")
    assert len(found) == KILLS


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow)]
)
def test_a_command_that_is_asked_to_end_tidies_up(number, code, inputs, run, tmp_path):
    """One line, its exit code, and everything as it was; asked in the middle of its writing."""
    folder, killer = inputs("imu"), Killer(tmp_path / "killer")
    command, out = ["-m", "gnomon", "convert", str(folder / "cal1.yaml"), "--to", "csv"], tmp_path / "deep" / "out"
    exit_code, err = killer.killed_at(5, [*command, "-o", str(out)], tmp_path, number)
    assert exit_code == code, err
    assert err == "gnomon: interrupted; no file is half-written.\n"
    assert not (tmp_path / "deep").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_every_command_tidies_up(name, number, code, inputs, run, tmp_path):
    stage = staged(CASES[name], inputs(name), tmp_path, run)
    rng = np.random.default_rng(9)
    for step in rng.integers(2, stage.steps + 1, 4).tolist():
        stage.reset()
        found, err = stage.killer.killed_at(step, ["-m", "gnomon", *stage.arguments], tmp_path, number)
        assert found == code, (step, err)
        assert "Traceback" not in err
        assert stage.judge(step) in {"old", "new"}
        assert not [path.name for path in stage.out.rglob(".*")], step


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_every_command_on_a_full_disk(name, inputs, run, tmp_path):
    """No file can grow to the size of the largest one of the result: a sentence, and everything as it was."""
    stage = staged(CASES[name], inputs(name), tmp_path, run)
    largest = max(len(data) for data in stage.new.values())
    for share in (0.1, 0.9):
        stage.reset()
        code, err = stage.killer.on_a_full_disk(int(share * largest), ["-m", "gnomon", *stage.arguments], tmp_path)
        assert code == 3, err
        assert "Traceback" not in err
        assert "cannot be written" in err.splitlines()[-1]
        assert result(contents(stage.out)) == result(stage.old), share


@pytest.mark.slow
@pytest.mark.parametrize("name", list(READING))
def test_commands_that_read_write_nothing(name, inputs, tmp_path):
    killer = Killer(tmp_path / "killer")
    arguments = [str(word) for word in READING[name](inputs("imu"))]
    (tmp_path / "here").mkdir()
    assert killer.steps(["-m", "gnomon", *arguments], tmp_path / "here") == 0
    assert contents(tmp_path / "here") == {}


def test_a_command_that_names_a_folder_ends_what_was_on_the_way(inputs, run, tmp_path):
    folder = inputs("imu")
    (tmp_path / ".gnomon-ready").mkdir()
    shutil.copy(folder / "cal1.yaml", tmp_path / "calibration.yaml")
    shutil.copy(folder / "cal2.yaml", tmp_path / ".gnomon-ready" / "calibration.yaml")
    code, text, err = run("show", tmp_path / "calibration.yaml", "--json")
    assert code == 0, err
    assert run("show", folder / "cal2.yaml", "--json")[1] == text
    assert sorted(contents(tmp_path)) == ["calibration.yaml"]
