"""How long a multi-position calibration takes.

    python benchmarks/imu.py                   on the recording of Tedaldi (in $GNOMON_DATA)
    python benchmarks/imu.py --long 1 3 10     simulated recordings of so many hours at 200 Hz, too
    python benchmarks/imu.py --write           keep the tables in benchmarks/results-imu.md

All numbers are CPU time (user and system) of one process, medians over several runs; ratios are to the method of
Tedaldi as its authors' program does it (preset imu_tk) in the same run, so that another machine's tables compare.
"""

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np

import gnomon
from gnomon.calibrate.steps.preparation import prepare_imu
from gnomon.detect.samples.stillness import static_statistic, window_samples

HERE = Path(__file__).resolve().parent
DATA = Path(os.environ.get("GNOMON_DATA", HERE.parent.parent / "shared" / "data"))
RUNS = 9
PROCESS_RUNS = 5
LONG_RATE_HZ = 200.0
BASELINE = "Tedaldi's method (preset imu_tk)"


@dataclass
class Table:
    """Rows of text that are printed and, with --write, kept."""

    title: str
    columns: tuple[str, ...]
    note: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add(self, *cells: str) -> None:
        self.rows.append(cells)

    def __str__(self) -> str:
        lines = [f"## {self.title}", ""]
        lines += ["| " + " | ".join(row) + " |" for row in (self.columns, ("---",) * len(self.columns), *self.rows)]
        return "\n".join([*lines, "", self.note] if self.note else lines) + "\n"


def median_cpu(work: Callable[[], object], runs: int = RUNS) -> float:
    """Return the median CPU time of some work in this process [s]; a first run warms it up."""
    work()
    seconds: list[float] = []
    for _ in range(runs):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


def steps(recording: gnomon.Recording, options: gnomon.ImuOptions) -> dict[str, float]:
    """Return the median CPU time of each step that the recipe announces [s]."""
    gathered: dict[str, list[float]] = {}
    for run in range(RUNS + 1):
        marks: list[tuple[str, float]] = []
        gnomon.calibrate_imu(recording, options, lambda step, marks=marks: marks.append((step, time.process_time())))
        marks.append(("", time.process_time()))
        if run:
            for (step, start), (_, end) in pairwise(marks):
                gathered.setdefault(step, []).append(end - start)
    return {step: statistics.median(seconds) for step, seconds in gathered.items()}


_WATCH = """
import os, resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss, done.returncode)
"""
"""Run in a small process of its own, as a child's peak memory starts with that of its parent."""


def child(arguments: list[str]) -> tuple[float, float, int]:
    """Run Python with arguments and return its CPU time [s], its peak memory [MiB] and its exit code."""
    command = [sys.executable, "-S", "-c", _WATCH, sys.executable, *arguments]
    compiled = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    words = subprocess.run(command, capture_output=True, text=True, check=True, env=compiled).stdout.split()
    per_mib = 1024 if sys.platform != "darwin" else 1024**2
    return float(words[0]), float(words[1]) / per_mib, int(words[2])


def in_memory(recording: gnomon.Recording) -> Table:
    table = Table(
        "In memory, the recording of Tedaldi (51 175 samples a triad, 37 rotations)",
        ("", "CPU [ms]", f"of {BASELINE}"),
    )
    default = gnomon.ImuOptions()
    presets = ("gnomon", "imu_tk", "tedaldi2014", "tedaldi2014-text")
    whole = {name: median_cpu(lambda name=name: gnomon.calibrate_imu(recording, gnomon.ImuOptions(preset=name)))
             for name in presets}  # fmt: skip
    samples = prepare_imu(recording, default).accelerometer
    window = window_samples(samples, default.window_s)
    detector = median_cpu(lambda: static_statistic(samples.values, window))
    baseline = whole["imu_tk"]

    def add(name: str, seconds: float) -> None:
        table.add(name, f"{1e3 * seconds:.1f}", f"{100 * seconds / baseline:.0f} %")

    add("static detector, Eq. (3.9), all samples", detector)
    estimation = 0.0
    for step, seconds in steps(recording, default).items():
        add(f"default: {step}", seconds)
        if step.startswith(("finding", "fitting")):
            estimation += seconds
    add("**default: detector, threshold and both fits**", estimation)
    add("**default: whole `calibrate_imu`**", whole["gnomon"])
    for name in presets[1:]:
        add(BASELINE if name == "imu_tk" else f"preset {name}", whole[name])
    table.note = (
        f"{recording.imus['imu0'].accelerometer.duration_s:.0f} s of recording. "
        "Checking is the data doctor; assessing makes the tables of the report."
    )
    return table


def whole_process(folder: Path) -> Table:
    table = Table("Whole processes", ("", "CPU [s]", "beyond Python [s]", "peak memory [MiB]"))
    with tempfile.TemporaryDirectory() as scratch:
        imu = ["-m", "gnomon", "imu", str(folder), "--no-report", "-o", str(Path(scratch) / "result")]
        commands = {
            "`python -c pass`": ["-c", "pass"],
            "`import numpy`": ["-c", "import numpy"],
            "`import gnomon`": ["-c", "import gnomon"],
            "`gnomon --help`": ["-m", "gnomon", "--help"],
            "`gnomon imu --no-report` on the gzipped pair": imu,
            "the same with `--preset imu_tk`": [*imu, "--preset", "imu_tk"],
            "`gnomon imu` with its report": [word for word in imu if word != "--no-report"],
        }
        bare = 0.0
        for name, arguments in commands.items():
            child(arguments)
            runs = [child(arguments) for _ in range(PROCESS_RUNS)]
            if any(code for *_, code in runs):
                message = f"{name} ended with exit code {runs[0][2]}"
                raise SystemExit(message)
            cpu = statistics.median(cpu for cpu, *_ in runs)
            bare = bare or cpu
            table.add(name, f"{cpu:.3f}", f"{cpu - bare:.3f}", f"{max(memory for _, memory, _ in runs):.0f}")
    return table


def long_recordings(hours: list[float]) -> Table:
    table = Table(
        f"Long recordings ({LONG_RATE_HZ:g} Hz, simulated, NPZ), whole process `gnomon imu --no-report`",
        ("hours", "rotations", "file [MB]", "CPU [s]", "CPU [s] per hour", "peak memory [MiB]", "MiB per hour"),
    )
    for length in hours:
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / "recording.npz"
            intervals = round(length * 3600 / 6.25)
            simulation = ["simulate", "-o", str(path), "--intervals", str(intervals), "--rate-hz", str(LONG_RATE_HZ)]
            if child(["-m", "gnomon", *simulation])[2]:
                message = f"the simulation of {length:g} h failed"
                raise SystemExit(message)
            arguments = ["-m", "gnomon", "imu", str(path), "--no-report", "-o", str(Path(scratch) / "result")]
            cpu, memory, code = child(arguments)
            table.add(
                f"{length:g}", f"{intervals - 1}", f"{path.stat().st_size / 1e6:.0f}", f"{cpu:.1f}",
                f"{cpu / length:.2f}", f"{memory:.0f}", f"{memory / length:.0f}",
            )  # fmt: skip
            if code:
                table.note = f"The {length:g} h recording ended with exit code {code}."
    return table


def machine() -> str:
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":")[1].strip()
            for line in info.read_text(encoding="utf-8").splitlines()
            if line.startswith("model name")
        ]
        processor = names[0] if names else processor
    return f"{processor}, Python {platform.python_version()}, NumPy {np.__version__}, gnomon {gnomon.__version__}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how long calibrations take.")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of recordings (default: $GNOMON_DATA)")
    parser.add_argument(
        "--long", type=float, nargs="*", default=[], metavar="HOURS", help="simulate so long recordings"
    )
    parser.add_argument("--write", action="store_true", help="keep the tables in benchmarks/results-imu.md")
    options = parser.parse_args()
    folder = options.data / "xsens_mti"
    tables: list[Table] = []

    def show(table: Table) -> None:
        print(table, flush=True)
        tables.append(table)

    if folder.exists():
        show(in_memory(gnomon.read(folder)))
        show(whole_process(folder))
    else:
        print(f"{folder} is not there: state --data, or $GNOMON_DATA.", file=sys.stderr)
    if options.long:
        show(long_recordings(options.long))
    if options.write and tables:
        head = (
            f"# Speed of multi-position calibrations\n\nWritten by `python benchmarks/imu.py --write`. {machine()}.\n"
        )
        (HERE / "results-imu.md").write_text("\n".join([head, *map(str, tables)]), encoding="utf-8")


if __name__ == "__main__":
    main()
