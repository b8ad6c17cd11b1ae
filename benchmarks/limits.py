"""What has a limit: ours, the limit, and where another program does the same the ratio to it, in one run.

    python benchmarks/limits.py               some four minutes; long recordings and their limits are cut short
    python benchmarks/limits.py --long        10 h of an IMU, 24 h of noise, 30 min of corners, 60 s of images
    python benchmarks/limits.py --only imu    some of it
    python benchmarks/limits.py --write       keep the table in benchmarks/results.md

Times are CPU times (user and system) of one thread, medians over several runs, unless "wall" is said. allantools and
imucal take part where they are installed (`make bench` installs them); recordings of $GNOMON_DATA where they are there.
A figure that misses its limit is marked; the exit code is 0 all the same, since the machine has a say in it.
"""

import argparse
import datetime
import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import camera_imu
import cameras
import cv2
import images
import imu
import imucal_poses
import noise
import platter_rate
import renderer
from imu import DATA, HERE, Table, child, machine

import gnomon
from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.scenarios.cameras import CamerasScenario

RUNS = 3


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A number with a limit.

    Parameters
    ----------
    issue : that asked for it
    what : for the table, with its unit
    ours, limit : the limit is the largest value allowed, or None
    least : the limit is the smallest value allowed
    peer, whose : the same of another program, in the same run
    """

    issue: int
    what: str
    ours: float
    limit: float | None = None
    least: bool = False
    peer: float | None = None
    whose: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None where there is none."""
        if self.limit is None:
            return None
        return self.ours >= self.limit if self.least else self.ours <= self.limit

    def cells(self) -> tuple[str, ...]:
        limit = "" if self.limit is None else f"{'>=' if self.least else '<='} {self.limit:.3g}"
        peer = "" if self.peer is None else f"{self.peer:.3g} ({self.whose})"
        ratio = "" if self.peer is None else f"{self.peer / self.ours:.3g}"
        met = {None: "", True: "yes", False: "**NO**"}[self.met]
        return str(self.issue), self.what, f"{self.ours:.3g}", limit, peer, ratio, met


def of_imu(*, long: bool) -> Iterator[Figure]:
    """Yield what issue 2 asks of `gnomon imu` and of the start of the program."""
    for what, arguments, limit in (
        ("`import gnomon` [s]", ["-c", "import gnomon"], 0.2),
        ("`gnomon --help` [s]", ["-m", "gnomon", "--help"], 0.4),
    ):
        yield Figure(issue=2, what=what, ours=median_child(arguments)[0], limit=limit)
    folder = DATA / "xsens_mti"
    if folder.exists():
        steps = imu.steps(gnomon.read(folder), gnomon.ImuOptions())
        fits = sum(seconds for step, seconds in steps.items() if step.startswith(("finding", "fitting")))
        yield Figure(issue=2, what="Xsens: detector and both fits, in memory [ms]", ours=1e3 * fits, limit=60)
        with tempfile.TemporaryDirectory() as scratch:
            words = ["-m", "gnomon", "imu", str(folder), "--no-report", "-o", f"{scratch}/result"]
            yield Figure(issue=2, what="Xsens: `gnomon imu --no-report` [s]", ours=median_child(words)[0], limit=0.8)
    hours = 10.0 if long else 1.0
    cells = imu.long_recordings([hours]).rows[0]
    yield Figure(issue=2, what=f"`gnomon imu`, {hours:g} h at 200 Hz [s]", ours=float(cells[3]), limit=6 * hours)
    yield Figure(issue=2, what="the same, peak memory [MiB] (3 GB for 10 h)", ours=float(cells[5]), limit=2861)


def of_imucal(*, long: bool) -> Iterator[Figure]:
    """Yield our calibration beside imucal's from the same poses."""
    del long
    found = imucal_poses.compared(RUNS)
    for what, ours, theirs in found:
        yield Figure(
            issue=2, what=f"poses and turns as imucal wants them: {what}", ours=ours, peer=theirs, whose="imucal"
        )


def of_camera_imu(*, long: bool) -> Iterator[Figure]:
    """Yield what issues 3 and 6 ask of `gnomon camera-imu` from corners."""
    limits = {"a, full": 1.5, "b, basic": 1.5, "d, basic": 1.5, "EuRoC, two cameras": 4.0}
    with tempfile.TemporaryDirectory() as scratch:
        for one in camera_imu.recordings(DATA, Path(scratch)):
            recording, target = one.read()
            options = one.options()
            took = camera_imu.timed(lambda r=recording, t=target, o=options: gnomon.calibrate_camera_imu(r, t, o), RUNS)
            yield Figure(issue=3, what=f"{one.name}, from corners [s]", ours=took.median_s, limit=limits[one.name])
            peak = child(["-c", camera_imu.ALONE, *camera_imu.alone(one)])[1]
            yield Figure(issue=3, what=f"{one.name}, peak memory [MiB]", ours=peak, limit=381)
    cells = camera_imu.trust([]).rows[0]
    total, share = float(cells[6].strip("*")), float(cells[5].removesuffix(" %"))
    yield Figure(issue=3, what="simulated, 60 s, models chosen by evidence [s]", ours=total, limit=1.5)
    yield Figure(issue=6, what="CR3 and splits, of all solving [%]", ours=share, limit=30)
    if long:
        cells = camera_imu.long_recordings([30.0]).rows[0]
        yield Figure(issue=3, what="30 min from corners, peak memory [MiB]", ours=float(cells[7]), limit=5722)


def of_images(*, long: bool) -> Iterator[Figure]:
    """Yield what issue 4 asks of images."""
    seconds, rounds, runs = (60.0, images.ROUNDS, images.RUNS) if long else (15.0, 2, 1)
    share = seconds / 60
    with tempfile.TemporaryDirectory() as scratch:
        boards = {name: images.prepare(Path(scratch), name, seconds) for name in images.BOARDS}
        _, found_ms = images.per_image(boards)
        for name, ms in found_ms.items():
            yield Figure(issue=4, what=f"finding the {name}, an image [ms]", ours=ms, limit=images.LIMIT_MS[name])
        _, ratios = images.two_workers(boards, rounds)
        for name, ratio in ratios.items():
            what = f"two workers over one, {name} (wall)"
            yield Figure(issue=4, what=what, ours=ratio, limit=images.LIMIT_GAIN, least=True)
        recordings = images.layouts(boards["AprilGrid"], ["ROS 1"])
        _, ((first, again),) = images.end_to_end(recordings, boards["AprilGrid"], runs)
        what = f"bag of {seconds:g} s of images to the report"
        yield Figure(issue=4, what=f"{what} [s, wall]", ours=first.wall_s, limit=share * images.LIMIT_S)
        yield Figure(issue=4, what=f"{what} again [s, wall]", ours=again.wall_s, limit=images.LIMIT_AGAIN_S)
        yield Figure(issue=4, what=f"{what}, peak memory [MiB]", ours=first.peak_mib, limit=images.LIMIT_MIB)


def of_noise(*, long: bool) -> Iterator[Figure]:
    """Yield what issue 5 asks of the Allan deviation and of videos of a platter."""
    ours, theirs, worst = noise.deviation()
    yield Figure(issue=5, what="Allan deviation, 6 axes of 1e6 samples [s, wall]", ours=ours, peer=theirs,
                 whose="allantools")  # fmt: skip
    if theirs is not None:
        yield Figure(issue=5, what="allantools over ours", ours=theirs / ours, limit=20, least=True)
        yield Figure(issue=5, what="largest relative difference from allantools'", ours=worst, limit=1e-5)
    hours = 24.0 if long else 2.0
    wall, peak = noise.recorded(hours)
    yield Figure(issue=5, what=f"`gnomon noise`, {hours:g} h at 400 Hz [s, wall]", ours=wall, limit=2.5 * hours)
    yield Figure(issue=5, what="the same, peak memory [MiB]", ours=peak, limit=954)
    seconds = 60.0 if long else 20.0
    row = platter_rate.measured(seconds, ("mpeg4",)).rows[0]
    yield Figure(issue=5, what=f"rate of a platter from {seconds:g} s of video, times decoding",
                 ours=float(row[3].strip("*")))  # fmt: skip
    yield Figure(issue=5, what="the same, relative error", ours=abs(float(row[5])), limit=1e-4)


def of_cameras(*, long: bool) -> Iterator[Figure]:
    """Yield what issue 7 asks of `gnomon camera` and of the renderer."""
    del long
    simulation = simulate_cameras(CamerasScenario(views=cameras.VIEWS), 1)
    took = cameras.cpu_s(lambda: calibrate_cameras(simulation.recording, simulation.target), RUNS)
    yield Figure(issue=7, what="60 views, one camera, from corners [s]", ours=took, limit=cameras.ALLOWED_S)
    for name in ("by hand, 4 ms", "shaken, rolling shutter, 8 ms"):
        rate = 2 * renderer.rate(renderer.KINDS[name])
        yield Figure(
            issue=7, what=f"rendering, {name} [images/s, two cores]", ours=rate, limit=renderer.LIMIT, least=True
        )


def of_apply(*, long: bool) -> Iterator[Figure]:
    """Yield how fast recordings are calibrated."""
    del long
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        recording, result, long_one, table = (
            str(place / name) for name in ("recording.npz", "result", "long.npz", "out.csv")
        )
        simulate = ["-m", "gnomon", "simulate", "--rate-hz", "200", "-o"]
        calibrate = ["-m", "gnomon", "imu", recording, "--no-report", "-o", result]
        for words in ([*simulate, recording], calibrate, [*simulate, long_one, "--intervals", "288"]):
            if child(words)[2]:
                raise SystemExit(f"python {' '.join(words)} failed")
        samples = len(gnomon.read(long_one).imus["imu0"].accelerometer)
        words = ["-m", "gnomon", "apply", f"{result}/calibration.yaml", long_one, "-o", table]
        yield Figure(issue=2, what=f"`gnomon apply`, {samples} samples to CSV [s]", ours=median_child(words)[0])


def median_child(arguments: list[str], runs: int = RUNS) -> tuple[float, float]:
    """Return the median CPU time [s] and the peak memory [MiB] of Python with these arguments."""
    child(arguments)
    found = [child(arguments) for _ in range(runs)]
    if any(code for *_, code in found):
        raise SystemExit(f"python {' '.join(arguments)} ended with exit code {found[0][2]}")
    return statistics.median(cpu for cpu, *_ in found), max(peak for _, peak, _ in found)


PARTS: dict[str, Callable[..., Iterator[Figure]]] = {
    "imu": of_imu,
    "imucal": of_imucal,
    "camera-imu": of_camera_imu,
    "images": of_images,
    "noise": of_noise,
    "camera": of_cameras,
    "apply": of_apply,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", action="store_true", help="long recordings at their full length")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS), help="parts, of all")
    parser.add_argument("--write", action="store_true", help="keep the table in benchmarks/results.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    table = Table("What has a limit", ("issue", "what", "ours", "limit", "peer", "peer / ours", "met"))
    start, references = time.monotonic(), [camera_imu.reference()]
    print("| " + " | ".join(table.columns) + " |", "|" + " --- |" * len(table.columns), sep="\n", flush=True)
    counts = {True: 0, False: 0, None: 0}
    for name in options.only:
        for figure in PARTS[name](long=options.long):
            counts[figure.met] += 1
            table.add(*figure.cells())
            print("| " + " | ".join(figure.cells()) + " |", flush=True)
        references.append(camera_imu.reference())
    load = f", load {os.getloadavg()[1]:.1f}" if hasattr(os, "getloadavg") else ""
    slowest, fastest = 1e3 * max(references), 1e3 * min(references)
    table.note = (
        f"{datetime.datetime.now(tz=datetime.UTC):%Y-%m-%d}. {machine()}, OpenCV {cv2.__version__}, "
        f"{platform.system()}, {os.cpu_count()} cores{load}. {counts[True]} limits of {counts[True] + counts[False]} "
        f"are kept; it took {(time.monotonic() - start) / 60:.1f} min. Times are CPU seconds of one thread, medians, "
        "unless wall is said; peer / ours is how many times as much the other program takes. A fixed piece of NumPy "
        f"work took {fastest:.0f} to {slowest:.0f} ms meanwhile: by that much times of different hours differ."
    )
    print(f"\n{table.note}")
    if options.write:
        head = "# Speed\n\nWritten by `make bench` (`python benchmarks/limits.py --write`)."
        (HERE / "results.md").write_text(f"{head}\n\n{table}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
