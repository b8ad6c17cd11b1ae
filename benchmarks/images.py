"""How long it takes from images to the calibration of cameras and an IMU, and how much memory.

    python benchmarks/images.py                 a rendered recording of 60 s at 20 Hz, 752 x 480 px, of each board
    python benchmarks/images.py --quick         of 10 s, as a folder, once
    python benchmarks/images.py --keep FOLDER   render into a folder that stays, and take what is there already
    python benchmarks/images.py --write         keep the tables in benchmarks/results-images.md

Whole commands are processes of their own. Wall time depends on what else runs on the machine, CPU time much less: both
are given, medians over several runs, with the share of a core that a busy thread got.
"""

import argparse
import json
import multiprocessing
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import cv2
from imu import HERE, Table, child, machine

from gnomon.calibrate.steps.board_corners import CameraImages, detect_corners
from gnomon.detect.boards.worker import make_detector
from gnomon.formats.kalibr.target import read_target
from gnomon.formats.sensor_inputs import read_cameras
from gnomon.models.target import Target
from gnomon.readers.images.image_recording import open_images
from gnomon.recording.recording import Frame, ImageRecording

RUNS = 3
RATE_HZ = 20.0
BOARDS = {
    "AprilGrid": (),
    "checkerboard": (
        *("--target-type", "checkerboard", "--target-cols", "7", "--target-rows", "6", "--target-size-m", "0.08"),
    ),
}
RIG = (
    *("--images", "--camera-rate-hz", f"{RATE_HZ:g}", "--resolution", "752", "480"),
    *("--intrinsics", "458", "457", "367", "248", "--seed", "3"),
)
LAYOUTS = {"EuRoC": "euroc", "ROS 1": "walk.bag", "MCAP": "walk.mcap"}
FORMS = {"EuRoC": "euroc", "ROS 1": "ros1", "MCAP": "mcap"}
LIMIT_MS = {"AprilGrid": 10.0, "checkerboard": 5.0}
KALIBR_MS = {"AprilGrid": 26.0, "checkerboard": 14.0}
KALIBR_S, KALIBR_MIB = 75.0, 886e6 / 2**20
LIMIT_S, LIMIT_AGAIN_S, LIMIT_MIB, LIMIT_GAIN = 12.0, 3.0, 500e6 / 2**20, 1.6
"""What is asked for, and what Kalibr takes for the same work on another machine."""

IMAGES, THREAD_IMAGES, ROUNDS = 320, 160, 5


@dataclass(frozen=True, kw_only=True)
class Run:
    """One process: times [s], peak memory [MiB]."""

    wall_s: float
    cpu_s: float
    peak_mib: float


def run(arguments: list[str]) -> Run:
    """Run Python, and stop where it fails."""
    start = time.perf_counter()
    cpu, peak, code = child(arguments)
    if code:
        raise SystemExit(f"python {' '.join(arguments)} ended with exit code {code}")
    return Run(wall_s=time.perf_counter() - start, cpu_s=cpu, peak_mib=peak)


def medians(runs: list[Run]) -> Run:
    """Return the median times and the largest peak."""
    return Run(
        wall_s=statistics.median(one.wall_s for one in runs),
        cpu_s=statistics.median(one.cpu_s for one in runs),
        peak_mib=max(one.peak_mib for one in runs),
    )


def prepare(place: Path, board: str, seconds: float) -> Path:
    """Render a recording where it is not there yet, and return its folder."""
    folder = place / f"{board}-{seconds:g}"
    if not (folder / "scenario.yaml").exists():
        print(f"rendering {seconds * RATE_HZ:.0f} images of the {board}", file=sys.stderr)
        run(["-m", "gnomon", "simulate-camera-imu", "-o", str(folder), "--duration-s", f"{seconds:g}", *RIG,
             *BOARDS[board]])  # fmt: skip
    return folder


def layouts(simulated: Path, wanted: list[str]) -> dict[str, Path]:
    """Return the recording in several layouts, beside it."""
    found: dict[str, Path] = {}
    for name in wanted:
        found[name] = simulated.with_name(f"{simulated.name}-{LAYOUTS[name]}")
        if not found[name].exists():
            run(["-m", "gnomon", "convert", str(simulated), "--to", FORMS[name], "-o", str(found[name])])
    return found


def command(recording: Path, simulated: Path, output: Path, *more: str) -> list[str]:
    files = [f"--{option}={simulated / name}" for option, name in INPUTS.items()]
    return ["-m", "gnomon", "camera-imu", str(recording), *files, "-o", str(output), *more]


INPUTS = {"cam": "camchain.yaml", "imu": "imu.yaml", "target": "target.yaml"}


def end_to_end(recordings: dict[str, Path], simulated: Path, runs: int) -> tuple[Table, list[tuple[Run, Run]]]:
    """Measure first runs, and second ones that find the corners beside the result."""
    table = Table(
        f"From images to the report, `gnomon camera-imu`, {_facts(simulated)}",
        ("", "first run: wall [s]", "CPU [s]", "peak memory [MiB]", "second run: wall [s]", "CPU [s]",
         "peak memory [MiB]"),
        f"{_medians(runs)}, default options, {os.cpu_count()} cores. A second run finds the corners of the first "
        "beside its result. Reading, writing, the report and the start of Python included.",
    )  # fmt: skip
    measured: list[tuple[Run, Run]] = []
    for name, recording in recordings.items():
        for words in ((), ("--no-report",)) if name == "EuRoC" else ((),):
            firsts: list[Run] = []
            seconds: list[Run] = []
            with tempfile.TemporaryDirectory() as scratch:
                for number in range(runs):
                    output = Path(scratch) / f"result{number}"
                    firsts.append(run(command(recording, simulated, output, *words)))
                    seconds.append(run(command(recording, simulated, output, *words)))
                    shutil.rmtree(output)
            pair = medians(firsts), medians(seconds)
            cells = [f"{value:.{digits}f}" for one in pair
                     for value, digits in ((one.wall_s, 1), (one.cpu_s, 1), (one.peak_mib, 0))]  # fmt: skip
            table.add(f"{name}{', `--no-report`' if words else ''}", *cells)
            if not words:
                measured.append(pair)
    return table, measured


_SHARED = "reading the images and finding the board"
_STEPS = """
import json, resource, sys, time
from pathlib import Path
marks = []
def mark(step):
    own = resource.getrusage(resource.RUSAGE_SELF)
    marks.append((step, time.perf_counter(), own.ru_utime + own.ru_stime, own.ru_maxrss))
recording, folder, output = map(Path, sys.argv[1:])
mark("starting")
import gnomon, scipy.linalg, scipy.optimize, cv2, rosbags.highlevel
from gnomon.calibrate.camera_imu import calibrate_camera_imu
from gnomon.calibrate.steps.board_corners import CameraImages, detect_corners
from gnomon.detect.boards.worker import make_detector
from gnomon.readers.images.image_recording import open_images
from gnomon.formats.kalibr.target import read_target
from gnomon.formats.sensor_inputs import read_cameras, read_imus
from gnomon.recording import Recording
from gnomon.report.page import write_report
from gnomon.writers.kalibr_files import save_camera_imu_files
from gnomon.formats.own.calibration_text import save
from gnomon.results.result import save_diagnostics
from dataclasses import replace
mark("importing what is needed")
known, noise = read_cameras(folder / "camchain.yaml")["cam0"], read_imus(folder / "imu.yaml")["imu0"]
target = read_target(folder / "target.yaml", [])
images = open_images(recording)
mark("opening: samples, stamps, hash of all images")
corners = detect_corners(CameraImages(name="cam0", stream=images.streams["cam0"], known=known), target)
mark("reading the images and finding the board")
samples = replace(images.imus["imu0"], noise=noise.noise)
read = Recording(imus={"imu0": samples}, cameras={"cam0": corners.frames}, sources=images.sources)
result = calibrate_camera_imu(read, target)
mark("calibrating")
save(result.calibration, output / "calibration.yaml")
save_diagnostics(result.diagnostics, output / "diagnostics.npz")
save_camera_imu_files(result, read, target, output)
mark("writing the result")
write_report(result, output / "report.html")
mark("drawing the report")
print(json.dumps(marks))
"""
"""The same steps as those of the command, one after the other, with a mark after each."""


def stages(recordings: dict[str, Path], simulated: Path, runs: int) -> tuple[Table, float]:
    """Measure the steps, and return also what all of them would take if two cores were free [s]."""
    import subprocess

    table = Table("Steps, wall and CPU time [s]", ("", *recordings))
    gathered: dict[str, dict[str, list[tuple[float, float, float]]]] = {}
    for name, recording in recordings.items():
        for _ in range(runs):
            with tempfile.TemporaryDirectory() as scratch:
                words = [sys.executable, "-c", _STEPS, str(recording), str(simulated), scratch]
                done = subprocess.run(words, capture_output=True, text=True, check=True)
            marks = json.loads(done.stdout)
            for before, after in pairwise(marks):
                times = (after[1] - before[1], after[2] - before[2], after[3] / 1024)
                gathered.setdefault(after[0], {}).setdefault(name, []).append(times)
    free = dict.fromkeys(recordings, 0.0)
    for step, by_name in gathered.items():
        cells: list[str] = []
        for name, times in by_name.items():
            wall, cpu, peak = (statistics.median(column) for column in zip(*times, strict=True))
            cells.append(f"{wall:.2f}, {cpu:.2f}; {peak:.0f} MiB")
            free[name] += cpu / 2 if step == _SHARED else cpu
        table.add(step, *cells)
    table.add("**the sum, were two cores free**", *(f"**{seconds:.1f}**" for seconds in free.values()))
    table.note = (
        f"{_medians(runs)}; the memory is the highest until then. The sum is of CPU times, half of it where the "
        "work is shared by two workers."
    )
    return table, max(free.values())


def _medians(runs: int) -> str:
    return f"Medians of {runs} runs" if runs > 1 else "One run"


def opened(folder: Path) -> tuple[ImageRecording, Target, list[Frame]]:
    recording = open_images(folder)
    frames = list(islice(recording.streams["cam0"].frames([]), IMAGES))
    return recording, read_target(folder / "target.yaml", []), frames


def per_image(boards: dict[str, Path]) -> tuple[Table, dict[str, float]]:
    """Measure the CPU time of one image in one thread, as consecutive images are handed to a worker."""
    table = Table(
        "One image of 752 x 480 px, one thread, CPU time [ms]",
        ("", "images", "decoding the PNG", "**finding the board**", "slowest tenth", "limit", "Kalibr"),
        "Medians over the images. The one before helps, 32 in a row, as it does in the command.",
    )
    found: dict[str, float] = {}
    cv2.setNumThreads(1)
    for name, folder in boards.items():
        _, target, frames = opened(folder)
        decoding: list[float] = []
        finding: list[float] = []
        find = make_detector(target)
        for number, frame in enumerate(frames):
            if number % 32 == 0:
                find = make_detector(target)
            start = time.process_time()
            image = frame.decode()
            middle = time.process_time()
            find(image)
            decoding.append(middle - start)
            finding.append(time.process_time() - middle)
        found[name] = 1e3 * statistics.median(finding)
        slowest = statistics.quantiles(finding, n=10)[-1]
        table.add(
            name, str(len(frames)), f"{1e3 * statistics.median(decoding):.1f}", f"**{found[name]:.1f}**",
            f"{1e3 * slowest:.1f}", f"{LIMIT_MS[name]:g}", f"{KALIBR_MS[name]:g}",
        )  # fmt: skip
    return table, found


def some_images(folder: Path) -> tuple[CameraImages, Target]:
    """Return the first images of a recording, which are still to be decoded."""
    recording, target, frames = opened(folder)
    some = frames[:THREAD_IMAGES]
    stream = replace(recording.streams["cam0"], frames=_first(some), count=len(some))
    known = read_cameras(folder / "camchain.yaml")["cam0"]
    return CameraImages(name="cam0", stream=stream, known=known), target


def a_process(folder: Path, barrier: Any, rounds: int) -> None:
    """Look at the images with one worker whenever all processes are ready."""
    images, target = some_images(folder)
    detect_corners(images, target, workers=1)
    for _ in range(rounds):
        barrier.wait()
        detect_corners(images, target, workers=1)
        barrier.wait()


def two_workers(boards: dict[str, Path], rounds: int) -> tuple[Table, dict[str, float]]:
    """Measure how much faster two workers are than one, and two processes, one after the other in every round."""
    table = Table(
        "Workers, images a second",
        ("", "one", "two", "two processes", "**two workers over one**", "two processes over one",
         "CPU time of two workers over one"),
        f"Wall time over {THREAD_IMAGES} images with decoding, medians of {rounds} rounds. Two processes that know "
        "nothing of each other tell what the machine had to give: two workers cannot gain more than these.",
    )  # fmt: skip
    ratios: dict[str, float] = {}
    context = multiprocessing.get_context("spawn")
    for name, folder in boards.items():
        images, target = some_images(folder)
        barrier = context.Barrier(3)
        processes = [context.Process(target=a_process, args=(folder, barrier, rounds)) for _ in range(2)]
        for process in processes:
            process.start()
        detect_corners(images, target, workers=2)  # warms up
        rates: dict[str, list[float]] = {}
        cpus: dict[int, list[float]] = {}
        for _ in range(rounds):
            barrier.wait()  # of the two processes, which then wait for the next
            start = time.perf_counter()
            barrier.wait()
            rates.setdefault("processes", []).append(2 * images.stream.count / (time.perf_counter() - start))
            for workers in (1, 2):
                start, cpu = time.perf_counter(), time.process_time()
                detect_corners(images, target, workers=workers)
                rates.setdefault(str(workers), []).append(images.stream.count / (time.perf_counter() - start))
                cpus.setdefault(workers, []).append(time.process_time() - cpu)
        for process in processes:
            process.join()
        one, two, apart = (rates[key] for key in ("1", "2", "processes"))
        ratios[name] = statistics.median(b / a for a, b in zip(one, two, strict=True))
        control = statistics.median(b / a for a, b in zip(one, apart, strict=True))
        spent = statistics.median(b / a for a, b in zip(cpus[1], cpus[2], strict=True))
        table.add(
            name, *(f"{statistics.median(rate):.0f}" for rate in (one, two, apart)), f"**{ratios[name]:.2f}**",
            f"{control:.2f}", f"{spent:.2f}",
        )  # fmt: skip
    return table, ratios


def _first(frames: list[Frame]) -> Callable[[list[str]], Iterator[Frame]]:
    return lambda _: iter(frames)


def summary(
    images_ms: dict[str, float], ratios: dict[str, float], whole: tuple[list[tuple[Run, Run]], float] | None
) -> Table:
    table = Table(
        "What was asked for",
        ("", "here", "asked for", "Kalibr, another machine"),
        "Of the layouts the slowest and the largest.",
    )
    for name, found in images_ms.items():
        table.add(f"CPU of an image, {name} [ms]", f"{found:.1f}", f"<= {LIMIT_MS[name]:g}", f"{KALIBR_MS[name]:g}")
    for name, found in ratios.items():
        table.add(f"two workers over one, {name}", f"{found:.2f}", f">= {LIMIT_GAIN:g}, cores free", "")
    if whole is not None:
        measured, free_s = whole
        firsts, seconds = zip(*measured, strict=True)
        first, again = (max(one.wall_s for one in runs) for runs in (firsts, seconds))
        peak = max(one.peak_mib for one in (*firsts, *seconds))
        table.add("first run, wall [s]", f"{first:.1f}", f"<= {LIMIT_S:g}", f"{KALIBR_S:g}")
        table.add("the same were two cores free, by CPU time [s]", f"{free_s:.1f}", f"<= {LIMIT_S:g}", "")
        table.add("second run, wall [s]", f"{again:.1f}", f"<= {LIMIT_AGAIN_S:g}", "")
        table.add("peak memory [MiB]", f"{peak:.0f}", f"<= {LIMIT_MIB:.0f}", f"{KALIBR_MIB:.0f}")
    return table


def _facts(folder: Path) -> str:
    count = open_images(folder).streams["cam0"].count
    return f"{count / RATE_HZ:.0f} s, {count} images of the {folder.name.partition('-')[0]}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how long it takes from images to a calibration.")
    parser.add_argument("--quick", action="store_true", help="10 s, as a folder, once")
    parser.add_argument("--keep", type=Path, help="folder for the recordings, which stay there")
    parser.add_argument("--write", action="store_true", help="keep the tables in benchmarks/results-images.md")
    parser.add_argument("--date", default="", help="date to be written with them")
    options = parser.parse_args()
    seconds, runs, rounds = (10.0, 1, 2) if options.quick else (60.0, RUNS, ROUNDS)
    tables: list[Table] = []

    def show(table: Table) -> None:
        print(table, flush=True)
        tables.append(table)

    with tempfile.TemporaryDirectory() as scratch:
        place = options.keep or Path(scratch)
        boards = {name: prepare(place, name, seconds) for name in BOARDS}
        recordings = layouts(boards["AprilGrid"], ["EuRoC"] if options.quick else list(LAYOUTS))
        table, images_ms = per_image(boards)
        show(table)
        table, ratios = two_workers(boards, rounds)
        show(table)
        table, measured = end_to_end(recordings, boards["AprilGrid"], runs)
        show(table)
        table, free_s = stages(recordings, boards["AprilGrid"], runs)
        show(table)
        show(summary(images_ms, ratios, None if options.quick else (measured, free_s)))
    if options.write:
        when = f" {options.date}." if options.date else ""
        head = "# Speed from images to the calibration\n\nWritten by `python benchmarks/images.py --write`."
        text = "\n".join([f"{head}{when} {machine()}, OpenCV {cv2.__version__}.\n", *map(str, tables)])
        (HERE / "results-images.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
