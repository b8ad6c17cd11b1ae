"""How long a camera-IMU calibration takes, and how much memory.

    python benchmarks/camera_imu.py                    on the recordings in $GNOMON_DATA
    python benchmarks/camera_imu.py --long 5 10 30     simulated recordings of so many minutes, too
    python benchmarks/camera_imu.py --write            keep the tables in benchmarks/results-camera-imu.md
    python benchmarks/camera_imu.py --only trust       one table: memory, trust, stages or processes
    python benchmarks/camera_imu.py --write --date 2026-11-21

All times are CPU time (user and system) of one thread, medians over several runs. On a shared machine the same work
takes up to twice as long at one time than at another: before and after each run a fixed piece of NumPy work is timed,
and times are given in units of it, too. Tables of other machines compare in those.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np
from imu import DATA, HERE, Table, child, machine

import gnomon
from gnomon.calibrate import camera_imu as recipe

RUNS = 5
PROCESS_RUNS = 3
RENDERED = {
    "a, full": ("a-aprilgrid-full", "full"),
    "b, basic": ("b-aprilgrid-ideal-imu", "basic"),
    "d, basic": ("d-checkerboard-ideal-imu", "basic"),
}
KALIBR = {"a, full": "36", "EuRoC, two cameras": "78"}
"""CPU time of Kalibr on the same corners in seconds, where it is known."""

EUROC = {
    "camchain.yaml": """
cam0: {camera_model: pinhole, intrinsics: [458.654, 457.296, 367.215, 248.375], distortion_model: radtan,
  distortion_coeffs: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05], resolution: [752, 480]}
cam1: {camera_model: pinhole, intrinsics: [457.587, 456.134, 379.999, 255.238], distortion_model: radtan,
  distortion_coeffs: [-0.28368365, 0.07451284, -0.00010473, -3.555e-05], resolution: [752, 480]}
""",
    "imu.yaml": """
{update_rate: 200.0, accelerometer_noise_density: 2.0e-3, accelerometer_random_walk: 3.0e-3,
  gyroscope_noise_density: 1.6968e-4, gyroscope_random_walk: 1.9393e-5}
""",
    "target.yaml": "{target_type: aprilgrid, tagCols: 6, tagRows: 6, tagSize: 0.088, tagSpacing: 0.3}",
}
"""What was published with that recording."""

_WORK = np.random.default_rng(0)
_SQUARE, _TALL, _LONG = _WORK.normal(size=(200, 200)), _WORK.normal(size=(2000, 64)), _WORK.normal(size=20000)


def reference() -> float:
    """Return the CPU time of the fixed piece of work [s]: products of small matrices, and sines."""
    start = time.process_time()
    for _ in range(100):
        _SQUARE @ _SQUARE
        _TALL.T @ _TALL
        np.sin(_LONG)
    return time.process_time() - start


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Medians over several runs: CPU time [s], in units of the reference; and the fastest run [s]."""

    median_s: float
    relative: float
    fastest_s: float


def timed(work: Callable[[], object], runs: int = RUNS) -> Timing:
    """Time some work in this process; a first run warms it up."""
    work()
    seconds: list[float] = []
    relative: list[float] = []
    for _ in range(runs):
        before = reference()
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
        relative.append(2 * seconds[-1] / (before + reference()))
    return Timing(median_s=statistics.median(seconds), relative=statistics.median(relative), fastest_s=min(seconds))


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recording on disk with the files that go with it, and the model to estimate."""

    name: str
    folder: Path
    stated: Path
    model: str

    def read(self) -> tuple[gnomon.Recording, gnomon.Target]:
        cam, imu, target = (self.stated / name for name in EUROC)
        return gnomon.read_camera_imu(self.folder, cam=cam, imu=imu, target=target)

    def options(self) -> gnomon.CameraImuOptions:
        return gnomon.CameraImuOptions(model=self.model)

    def command(self, output: Path) -> list[str]:
        files = [
            f"--{option}={self.stated / name}" for option, name in zip(("cam", "imu", "target"), EUROC, strict=True)
        ]
        return ["-m", "gnomon", "camera-imu", str(self.folder), *files, "--model", self.model, "-o", str(output)]


def recordings(data: Path, scratch: Path) -> list[Recorded]:
    """Return the recordings that are there."""
    found = [
        Recorded(
            name=name, folder=data / "rendered-camimu" / folder, stated=data / "rendered-camimu" / folder, model=model
        )
        for name, (folder, model) in RENDERED.items()
    ]
    for name, text in EUROC.items():
        (scratch / name).write_text(text, encoding="utf-8")
    found.append(Recorded(name="EuRoC, two cameras", folder=data / "euroc-imu-april", stated=scratch, model="full"))
    return [one for one in found if one.folder.exists()]


def in_memory(found: list[Recorded]) -> Table:
    table = Table(
        "Recordings in memory",
        ("", "frames", "corners", "knots/s", "iterations", "reading [s]", "**calibration [s]**", "fastest [s]",
         "of the reference", "Kalibr [s]", "peak memory [MiB]"),
    )  # fmt: skip
    for one in found:
        recording, target = one.read()
        reading = timed(one.read, runs=3)
        calibration = timed(lambda one=one, r=recording, t=target: gnomon.calibrate_camera_imu(r, t, one.options()))
        diagnostics = gnomon.calibrate_camera_imu(recording, target, one.options()).diagnostics
        fits = diagnostics.corners.values()
        table.add(
            one.name, f"{sum(len(fit.frame_t_s) for fit in fits)}", f"{sum(len(fit.frame) for fit in fits)}",
            f"{diagnostics.knots_per_s:.0f}", f"{len(diagnostics.steps)}", f"{reading.median_s:.2f}",
            f"**{calibration.median_s:.2f}**", f"{calibration.fastest_s:.2f}", f"{calibration.relative:.1f}",
            KALIBR.get(one.name, ""), f"{child(['-c', ALONE, *alone(one)])[1]:.0f}",
        )  # fmt: skip
    bare = child(["-c", "import numpy, scipy.linalg, gnomon; gnomon.calibrate_camera_imu"])[1]
    table.note = (
        f"Medians of {RUNS} runs. The reference is a fixed piece of NumPy work, timed before and after each run; here "
        f"it took {1e3 * statistics.median(reference() for _ in range(9)):.0f} ms. Peak memory is that of a process "
        f"that reads and calibrates; {bare:.0f} MiB of it are Python with NumPy and SciPy. Kalibr: the same "
        "corners on another machine, in 0.8 to 0.95 GB."
    )
    return table


@contextmanager
def clocked(seconds: dict[str, list[float]]) -> Generator[None]:
    """Note the CPU time of each call of what makes up a calibration."""
    pieces = ("estimate_rig", "select_model", "_with_uncertainty", "recording_trust")

    def noting(name: str, work: Callable[..., object]) -> Callable[..., object]:
        def noted(*arguments: object, **named: object) -> object:
            start = time.process_time()
            found = work(*arguments, **named)
            seconds.setdefault(name, []).append(time.process_time() - start)
            return found

        return noted

    kept = {name: getattr(recipe, name) for name in pieces}
    for name, work in kept.items():
        setattr(recipe, name, noting(name, work))
    try:
        yield
    finally:
        for name, work in kept.items():
            setattr(recipe, name, work)


def trust(found: list[Recorded]) -> Table:
    """Tell what the choice of the model and the covariance from clusters of time cost beside the solve."""
    table = Table(
        "Model \"auto\": what its choice and the covariance from clusters of time cost",
        ("", "first solve [s]", "choosing the model [s]", "covariance and trust [s]", "**calibration [s]**",
         "of the reference", "joined the model"),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "walk"
        if child(["-m", "gnomon", "simulate", "camera-imu", "-o", str(folder), "--duration-s", "60", "--seed", "1"])[2]:
            raise SystemExit("the simulation failed")
        healthy = Recorded(name="simulated, 60 s, nothing wrong", folder=folder, stated=folder, model="auto")
        for one in (healthy, *found):
            recording, target = one.read()
            rows: list[tuple[float, ...]] = []
            for _ in range(PROCESS_RUNS):
                seconds: dict[str, list[float]] = {}
                before, start = reference(), time.process_time()
                with clocked(seconds):
                    result = gnomon.calibrate_camera_imu(recording, target)
                total = time.process_time() - start
                certain = sum(seconds["_with_uncertainty"] + seconds["recording_trust"])
                relative = 2 * total / (before + reference())
                rows.append((sum(seconds["estimate_rig"]), sum(seconds["select_model"]), certain, total, relative))
            first, choosing, certain, total, relative = (statistics.median(each) for each in zip(*rows, strict=True))
            note = result.calibration.assessment.trust
            table.add(
                one.name.partition(", full")[0].partition(", basic")[0], f"{first:.2f}", f"{choosing:.2f}",
                f"{certain:.2f}", f"**{total:.2f}**", f"{relative:.0f}", ", ".join(note.added) if note else "",
            )  # fmt: skip
    table.note = (
        f"Medians of {PROCESS_RUNS} runs. Choosing the model: tests of what may join it, estimating what joined along, "
        "and the sums of clusters of time."
    )
    return table


ALONE = """
import sys, time
import gnomon
from gnomon.calibrate.camera_imu import calibrate_camera_imu
folder, cam, imu, target, model, output = sys.argv[1:]
start = time.process_time()
recording, board = gnomon.read_camera_imu(folder, cam=cam, imu=imu, target=target)
read = time.process_time()
result = calibrate_camera_imu(recording, board, gnomon.CameraImuOptions(model=model))
done = time.process_time()
if output:
    frames = sum(len(fit.frame_t_s) for fit in result.diagnostics.corners.values())
    with open(output, "w") as file:
        print(read - start, done - read, frames, len(result.diagnostics.steps), result.calibration.verdict, file=file)
"""
"""Read and calibrate, in a process of its own."""


def alone(one: Recorded, output: str = "") -> list[str]:
    """Return the arguments of that process."""
    return [str(one.folder), *(str(one.stated / name) for name in EUROC), one.model, output]


def stages(found: list[Recorded]) -> Table:
    """Tell how the time is shared by the steps that the recipe announces."""
    gathered: dict[str, dict[str, float]] = {}
    for one in found:
        recording, target = one.read()
        runs: dict[str, list[float]] = {}
        for run in range(RUNS + 1):
            marks: list[tuple[str, float]] = []

            def mark(step: str, marks: list[tuple[str, float]] = marks) -> None:
                if not step.startswith("iteration"):  # they are part of the estimation, whose share is told, too
                    marks.append((step.partition(":")[0], time.process_time()))

            gnomon.calibrate_camera_imu(recording, target, one.options(), mark)
            marks.append(("", time.process_time()))
            totals = Counter[str]()
            for (step, start), (_, end) in pairwise(marks):
                totals[step] += end - start
            for step, seconds in totals.items() if run else ():
                runs.setdefault(step, []).append(seconds)
        gathered[one.name] = {step: statistics.median(seconds) for step, seconds in runs.items()}
    table = Table("Share of the stages", ("", *gathered))
    steps = list(dict.fromkeys(step for shares in gathered.values() for step in shares))
    for step in steps:
        cells = [
            f"{s.get(step, 0.0):.2f} s, {100 * s.get(step, 0.0) / sum(s.values()):.0f} %" for s in gathered.values()
        ]
        table.add(step, *cells)
    return table


def whole_process(found: list[Recorded]) -> Table:
    table = Table(
        "Whole processes, `gnomon camera-imu`",
        ("", "CPU [s], `--no-report`", "peak memory [MiB]", "CPU [s], with report", "peak memory [MiB]"),
    )
    with tempfile.TemporaryDirectory() as scratch:
        for one in found:
            cells: list[str] = []
            for more in (["--no-report"], []):
                command = [*one.command(Path(scratch) / "result"), *more]
                runs = [child(command) for _ in range(PROCESS_RUNS)]
                if any(code for *_, code in runs):
                    message = f"{one.name} ended with exit code {runs[0][2]}"
                    raise SystemExit(message)
                cells += [f"{statistics.median(cpu for cpu, *_ in runs):.2f}", f"{max(mib for _, mib, _ in runs):.0f}"]
            table.add(one.name, *cells)
    table.note = f"Medians of {PROCESS_RUNS} runs; reading, writing and the start of Python included."
    return table


def long_recordings(minutes: list[float]) -> Table:
    table = Table(
        "Long recordings (simulated: one camera at 20 Hz, 144 corners, IMU at 200 Hz), reading and calibrating",
        ("minutes", "frames", "iterations", "reading [s]", "calibration [s]", "calibration [s] per minute",
         "of the reference, per minute", "peak memory [MiB]", "MiB per minute", "verdict"),
    )  # fmt: skip
    for length in minutes:
        with tempfile.TemporaryDirectory() as place:
            folder, output = Path(place) / "walk", Path(place) / "times.txt"
            arguments = ["simulate", "camera-imu", "-o", str(folder), "--duration-s", f"{60 * length:g}", "--seed", "1"]
            if child(["-m", "gnomon", *arguments])[2]:
                message = f"the simulation of {length:g} min failed"
                raise SystemExit(message)
            before = reference()
            one = Recorded(name="", folder=folder, stated=folder, model="full")
            _, memory, code = child(["-c", ALONE, *alone(one, str(output))])
            if code:
                table.add(f"{length:g}", *[""] * 6, f"{memory:.0f}", "", f"exit code {code}")
                continue
            reading, calibration, frames, iterations, verdict = output.read_text(encoding="utf-8").split()
            per_minute = float(calibration) / length
            table.add(
                f"{length:g}", frames, iterations, f"{float(reading):.1f}", f"{float(calibration):.1f}",
                f"{per_minute:.2f}", f"{2 * per_minute / (before + reference()):.0f}", f"{memory:.0f}",
                f"{memory / length:.0f}", verdict,
            )  # fmt: skip
    return table


MEASURES = {"memory": in_memory, "trust": trust, "stages": stages, "processes": whole_process}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how long camera-IMU calibrations take.")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of recordings (default: $GNOMON_DATA)")
    parser.add_argument(
        "--long", type=float, nargs="*", default=[], metavar="MINUTES", help="simulate so long recordings"
    )
    parser.add_argument("--write", action="store_true", help="keep the tables in benchmarks/results-camera-imu.md")
    parser.add_argument("--only", nargs="*", choices=MEASURES, default=list(MEASURES), help="tables, of all")
    parser.add_argument("--remark", default="", help="what else to write with them, such as the machine's load")
    parser.add_argument("--date", default="", help="date to be written with them")
    options = parser.parse_args()
    tables: list[Table] = []

    def show(table: Table) -> None:
        print(table, flush=True)
        tables.append(table)

    with tempfile.TemporaryDirectory() as scratch:
        found = recordings(options.data, Path(scratch))
        if found:
            for name in options.only:
                show(MEASURES[name](found))
        else:
            print(
                f"{options.data} holds no recording of camera and IMU: state --data, or $GNOMON_DATA.", file=sys.stderr
            )
    if options.long:
        show(long_recordings(options.long))
    if options.write and tables:
        head = "# Speed of camera-IMU calibrations\n\nWritten by `python benchmarks/camera_imu.py --write`."
        path = HERE / "results-camera-imu.md"
        kept = path.read_text(encoding="utf-8").split("\n## ")[1:] if path.exists() else []
        sections = {text.partition("\n")[0]: f"## {text.strip()}\n" for text in kept}
        for table in tables:
            table.note = " ".join(filter(None, [table.note, options.remark, options.date]))
            sections[table.title] = f"{str(table).strip()}\n"
        text = "\n".join([f"{head} {machine()}.\n", *sections.values()])
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
