"""How much faster this version is than an older one: both in one run, in turns.

    python benchmarks/against.py 70de556                  all rows, some ten minutes
    python benchmarks/against.py 70de556 --only xsens     such as these only
    python benchmarks/against.py 70de556 --write          keep the table in benchmarks/results-against.md
    python benchmarks/against.py 70de556 --check          end with 1 where a ratio fell by a fifth since it was kept

The older version is checked out beside this one, and both run with the libraries of this environment. Every run is a
process of its own; old and new take turns; CPU times (user and system, of all threads and children) are medians.
"In memory" rows leave the imports out. A ratio above 1 means that this version is faster. The recordings
of $GNOMON_DATA take part where they are there.
"""

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from imu import DATA, HERE, Table, machine

TIMED = """
import json, resource, sys
def cpu():
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)
import gnomon, scipy.linalg, scipy.optimize, scipy.sparse, scipy.stats, scipy.signal, scipy.interpolate, cv2
spent = 0.0
for number in range(1 + {repeats}):
    exec({prepare!r})
    before = cpu()
    {work}
    spent += (cpu() - before) * bool(number)
print("seconds", spent / {repeats})
"""
"""The first, uncounted, time imports what is imported on demand. Each time the recording is read anew."""
READ_RIG = "recording, target = gnomon.read_camera_imu({folder!r}, cam={cam!r}, imu={imu!r}, target={target!r})"
RIG = "gnomon.calibrate_camera_imu(recording, target{options})"
TRACK = """
try:
    from gnomon.calibrate.steps.board_corners import CameraImages, detect_corners
    from gnomon.formats.kalibr.target import read_target
    from gnomon.formats.sensor_inputs import read_cameras
except ImportError:  # as 70de556 has them
    from gnomon.calibrate.board_corners import CameraImages, detect_corners
    from gnomon.readers.rig.kalibr_target import read_target
    from gnomon.readers.rig.sensor_inputs import read_cameras
from gnomon.readers.images.image_recording import open_images
from pathlib import Path
folder = Path({folder!r})
known, target = read_cameras(folder / "camchain.yaml")["cam0"], read_target(folder / "target.yaml", [])
stream = open_images(folder).streams["cam0"]
"""
IMAGES = "--duration-s 12 --camera-rate-hz 20 --images --seed 5 --resolution 752 480 --intrinsics 460 459 375 240"


@dataclass(frozen=True, kw_only=True)
class Job:
    """Something to time: the words of a command, or code in memory."""

    what: str
    words: str = ""
    prepare: str = ""
    work: str = ""
    repeats: int = 1


def jobs(place: Path) -> list[Job]:
    """Return what is timed; the recordings that it needs are in the folder."""
    found = [
        Job(what="`gnomon --help`", words="--help"),
        Job(what="`gnomon show`", words="show imu/calibration.yaml"),
        Job(what="`gnomon convert` to PX4", words="convert imu/calibration.yaml --to px4 -o {out}/px4"),
        Job(what="`gnomon imu`, simulated", words="imu imu.npz -o {out}/imu"),
        Job(what="`gnomon apply`, 300 000 samples to CSV", words="apply imu/calibration.yaml long.npz -o {out}/x.csv"),
        Job(what="`gnomon noise`, 2 h at 100 Hz", words="noise rest.npz -o {out}/noise"),
        Job(what="`gnomon camera-imu`, 240 images to the report", words="camera-imu tags -o {out}/rig"),
    ]
    for board in ("tags", "squares"):
        stream = TRACK.format(folder=str(place / board))
        found += [
            Job(
                what=f"board in 240 images: {board}, with reading",
                prepare=stream,
                work="detect_corners(CameraImages(name='cam0', stream=stream, known=known), target)",
            )
        ]
    if DATA.is_dir():
        xsens = str(DATA / "xsens_mti")
        found += [
            Job(what="`gnomon imu`, Xsens", words=f"imu {xsens} -o {{out}}/xsens"),
            Job(
                what="Xsens in memory",
                prepare=f"recording = gnomon.read({xsens!r})",
                work="gnomon.calibrate_imu(recording)",
                repeats=3,
            ),
        ]
        rendered, euroc = DATA / "rendered-camimu" / "a-aprilgrid-full", DATA / "euroc-imu-april"
        stated = DATA / "kalibr-format-samples" / "openvins_euroc_mav"
        board = str(rendered / "target.yaml")
        files = {name: str(rendered / f"{file}.yaml") for name, file in (("cam", "camchain"), ("imu", "imu"))}
        read = READ_RIG.format(folder=str(rendered), target=board, **files)
        full = RIG.format(options=", gnomon.CameraImuOptions(model='full')")
        found += [
            Job(what="rendered a in memory, full", prepare=read, work=full),
            Job(what="rendered a in memory, default", prepare=read, work=RIG.format(options="")),
        ]
        files = {
            name: str(stated / f"kalibr_{file}.yaml") for name, file in (("cam", "imucam_chain"), ("imu", "imu_chain"))
        }
        read = READ_RIG.format(folder=str(euroc), target=board, **files)
        found += [
            Job(what="EuRoC in memory, two cameras, default", prepare=read, work=RIG.format(options="")),
            Job(
                what="`gnomon camera`, EuRoC's corners",
                words=f"camera {euroc} --target {board} --resolution 752 480 -o {{out}}/lenses",
            ),
        ]
    return found


def make_inputs(place: Path, older: Path) -> None:
    """Make the recordings by this version, and a calibration by the older one, which both can read."""
    for line in (
        "simulate -o imu.npz --seed 7",
        "simulate -o long.npz --rate-hz 200 --intervals 288",
        "simulate-noise --duration-s 7200 -o rest.npz --seed 7",
        f"simulate-camera-imu -o tags {IMAGES}",
        f"simulate-camera-imu -o squares {IMAGES} --target-type checkerboard --target-cols 7 --target-rows 6"
        " --target-size-m 0.08",
    ):
        subprocess.run([sys.executable, "-m", "gnomon", *line.split()], cwd=place, check=True, capture_output=True)
    calibrate = [sys.executable, "-m", "gnomon", "imu", "imu.npz", "--no-report", "-o", "imu"]
    environment = {**os.environ, "PYTHONPATH": str(older)}
    subprocess.run(calibrate, cwd=place, check=True, capture_output=True, env=environment)


def measure(job: Job, source: Path, place: Path) -> tuple[float, float]:
    """Return the CPU time [s] and the peak memory [MiB] of a job, done by the version in that folder."""
    with tempfile.TemporaryDirectory() as out:
        if job.words:
            words = ["-m", "gnomon", *job.words.format(out=out).split()]
        else:
            words = ["-c", TIMED.format(prepare=job.prepare, work=job.work, repeats=job.repeats)]
        environment = {**os.environ, "PYTHONPATH": str(source), "PYTHONPYCACHEPREFIX": str(place / "bytecode")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        with tempfile.TemporaryFile("w+") as printed:
            process = subprocess.Popen([sys.executable, *words], cwd=place, env=environment, stdout=printed,
                                       stderr=subprocess.STDOUT)  # fmt: skip
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            printed.seek(0)
            text = printed.read()
    if process.returncode:
        raise SystemExit(f"{job.what} failed with {source}:\n{text[-2000:]}")
    seconds = float(text.rsplit("seconds", 1)[1]) if job.work else usage.ru_utime + usage.ru_stime
    return seconds, usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 1024)


def compare(sources: tuple[Path, Path], place: Path, runs: int, only: str) -> Table:
    """Return the table: medians of both versions and their ratio."""
    table = Table("Against an older version", ("", "old CPU [s]", "new CPU [s]", "old / new", "old, new peak [MiB]"))
    for job in jobs(place):
        if only.lower() not in job.what.lower():
            continue
        measured: tuple[list[tuple[float, float]], list[tuple[float, float]]] = ([], [])
        for number in range(runs + 1):
            for source, rows in zip(sources, measured, strict=True):
                taken = measure(job, source, place)
                if number:  # the first one compiles
                    rows.append(taken)
        old, new = (statistics.median(seconds for seconds, _ in rows) for rows in measured)
        peaks = ", ".join(f"{max(peak for _, peak in rows):.0f}" for rows in measured)
        table.add(job.what, f"{old:.2f}", f"{new:.2f}", f"**{old / new:.2f}**", peaks)
        print(" | ".join(table.rows[-1]), file=sys.stderr, flush=True)
    return table


KEPT = HERE / "results-against.md"
FALLEN = 0.8
"""Share of the kept ratio below which a row is told."""


def fallen_rows(kept: str, measured: str) -> list[str]:
    """Return the rows whose ratio is less than `FALLEN` of the one in the kept table, with both numbers."""
    row = re.compile(r"^\| (?P<what>.+?) \|.*\*\*(?P<ratio>[\d.]+)\*\* \|", re.MULTILINE)
    before = {found["what"]: float(found["ratio"]) for found in row.finditer(kept)}
    now = {found["what"]: float(found["ratio"]) for found in row.finditer(measured)}
    return [
        f"{what}: {ratio:.2f}, kept {before[what]:.2f}"
        for what, ratio in now.items()
        if what in before and ratio < FALLEN * before[what]
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", help="the older version")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--check", action="store_true", help="fail where a ratio fell since it was kept")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        place, older = Path(scratch), Path(scratch) / "older"
        tree = ["git", "-C", str(HERE.parent), "worktree"]
        subprocess.run([*tree, "add", "--quiet", "--detach", str(older), options.commit], check=True)
        try:
            make_inputs(place, older / "src")
            table = compare((older / "src", HERE.parent / "src"), place, options.runs, options.only)
        finally:
            subprocess.run([*tree, "remove", "--force", str(older)], check=True)
    table.note = f"Against {options.commit}; medians of {options.runs}, in turns. {machine()}"
    print(table)
    if options.write and not options.only:
        KEPT.write_text(f"# Against an older version\n\n{table}")
    if options.check and (fallen := fallen_rows(KEPT.read_text(), str(table))):
        sys.exit("Slower than it was:\n" + "\n".join(fallen))


if __name__ == "__main__":
    main()
