"""How time and memory grow with the length of a recording.

    python benchmarks/length.py                      a day of imu, noise and apply, half an hour of camera-imu
    python benchmarks/length.py --quick              a fiftieth of that
    python benchmarks/length.py --only imu noise     some of them
    python benchmarks/length.py --write              keep the tables in benchmarks/results-length.md

Every length is a process of its own, `gnomon COMMAND RECORDING` as a person calls it, with its report. CPU time (user
and system) and peak memory are those of that process. The exponent is the slope of log time over log length, without
what any recording costs (the start of Python and of the libraries): 1 is linear, 2 quadratic.
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np
from imu import HERE, Table, child, machine

SHARES = (1 / 8, 1 / 4, 1 / 2, 1.0)
QUICK = 1 / 50
LARGEST_EXPONENT = 1.15
"""A step that is quadratic shows at these lengths as well above."""

_POSE_S = 6.25  # mean length of a rest and the motion after it


@dataclass(frozen=True, kw_only=True)
class Case:
    """A command and its recordings.

    Parameters
    ----------
    what : for the table
    full_s : longest recording [s]
    made : (folder, length [s]) -> arguments of the command, after its recording was made in the folder
    """

    what: str
    full_s: float
    made: Callable[[Path, float], list[str]]


def gnomon(*words: object) -> tuple[float, float]:
    """Run the command line; return its CPU time [s] and its peak memory [MiB]."""
    cpu, memory, code = child(["-m", "gnomon", *map(str, words)])
    if code not in {0, 4}:
        message = f"gnomon {' '.join(map(str, words))} ended with exit code {code}"
        raise SystemExit(message)
    return cpu, memory


def many_poses(folder: Path, length_s: float) -> list[str]:
    """Hand-held all the time: a rest every six seconds, 13 800 in a day."""
    gnomon("simulate", "-o", folder / "imu.npz", "--intervals", max(20, round(length_s / _POSE_S)), "--rate-hz", 200)
    return ["imu", str(folder / "imu.npz")]


def long_rest(folder: Path, length_s: float) -> list[str]:
    """Left lying, and turned into forty attitudes at the end."""
    rest = max(50.0, length_s - 40 * _POSE_S)
    gnomon("simulate", "-o", folder / "imu.npz", "--intervals", 40, "--t-init-s", rest, "--rate-hz", 200)
    return ["imu", str(folder / "imu.npz")]


def resting(folder: Path, length_s: float) -> list[str]:
    """At rest at 400 Hz: 35 million samples of each sensor in a day."""
    gnomon("simulate-noise", "-o", folder / "rest.npz", "--duration-s", length_s, "--rate-hz", 400)
    return ["noise", str(folder / "rest.npz")]


def measured(folder: Path, length_s: float) -> list[str]:
    """200 Hz from NPZ to CSV."""
    gnomon("simulate", "-o", folder / "short.npz", "--intervals", 30)
    gnomon("simulate-noise", "-o", folder / "long.npz", "--duration-s", length_s, "--rate-hz", 200)
    return ["apply", str(folder / "truth.yaml"), str(folder / "long.npz"), "-o", str(folder / "out.csv")]


def table_measured(folder: Path, length_s: float) -> list[str]:
    """From CSV to CSV."""
    arguments = measured(folder, length_s)
    gnomon(*arguments)
    (folder / "long.npz").unlink()
    (folder / "out.csv").replace(folder / "long.csv")
    return ["apply", arguments[1], str(folder / "long.csv"), "-o", arguments[-1]]


def waved(folder: Path, length_s: float) -> list[str]:
    """One camera at 20 Hz before an AprilGrid of 144 corners, an IMU at 200 Hz."""
    gnomon("simulate-camera-imu", "-o", folder / "waved", "--duration-s", max(length_s, 20.0))
    return ["camera-imu", str(folder / "waved")]


DAY_S, HALF_HOUR_S = 86_400.0, 1_800.0
CASES = {
    "imu": Case(what="`imu`, rests and turns all day, 200 Hz", full_s=DAY_S, made=many_poses),
    "imu-rest": Case(what="`imu`, one long rest and 40 attitudes, 200 Hz", full_s=DAY_S, made=long_rest),
    "noise": Case(what="`noise`, 400 Hz", full_s=DAY_S, made=resting),
    "apply": Case(what="`apply`, NPZ to CSV, 200 Hz", full_s=DAY_S, made=measured),
    "apply-csv": Case(what="`apply`, CSV to CSV, 200 Hz", full_s=DAY_S, made=table_measured),
    "camera-imu": Case(
        what="`camera-imu`, one camera at 20 Hz, 144 corners, IMU at 200 Hz", full_s=HALF_HOUR_S, made=waved
    ),
}


def _folder_sizes(folder: Path) -> tuple[float, float]:
    """Return the sizes of the largest report and the largest diagnostics in a folder and those below it [MB]."""
    sizes = [max((f.stat().st_size for f in folder.rglob(name)), default=0) for name in ("report.html", "*ics.npz")]
    return sizes[0] / 1e6, sizes[1] / 1e6


def measure(case: Case, shares: tuple[float, ...], scale: float) -> Table:
    """Run a command on recordings of several lengths."""
    table = Table(
        case.what,
        ("length", "CPU [s]", "CPU [s] per hour", "peak memory [MiB]", "report [MB]", "diagnostics [MB]"),
    )
    lengths, seconds, memories = [], [], []
    for share in shares:
        length_s = case.full_s * share * scale
        with tempfile.TemporaryDirectory() as scratch:
            arguments = case.made(Path(scratch), length_s)
            cpu, memory = gnomon(*arguments)
            report, diagnostics = _folder_sizes(Path(scratch))
        lengths.append(length_s / 3600)
        seconds.append(cpu)
        memories.append(memory)
        told = f"{length_s / 3600:.3g} h" if length_s >= 3600 else f"{length_s / 60:.3g} min"
        table.add(
            told, f"{cpu:.1f}", f"{cpu / lengths[-1]:.3g}", f"{memory:.0f}", f"{report:.2f}", f"{diagnostics:.2f}"
        )
        print(f"{case.what}: {' | '.join(table.rows[-1])}", flush=True)
    table.note = _growth(np.array(lengths), np.array(seconds), np.array(memories))
    return table


def _growth(hours: np.ndarray, seconds: np.ndarray, memories: np.ndarray) -> str:
    """Say how time and memory grow."""
    slope, start = np.polyfit(hours, seconds, 1, w=1 / seconds)
    exponent = np.polyfit(np.log(hours), np.log(np.maximum(seconds - max(start, 0.0), 0.05 * seconds)), 1)[0]
    grown, base = np.polyfit(hours, memories, 1)
    verdict = "linear" if exponent <= LARGEST_EXPONENT else "MORE THAN LINEAR"
    return (
        f"Time grows with the power {exponent:.2f} of the length ({verdict}): {slope:.3g} s per hour and {start:.1f} s "
        f"for the start. Memory: {base:.0f} MiB and {grown:.3g} MiB per hour."
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Measure how time and memory grow with the length of a recording.")
    parser.add_argument("--quick", action="store_true", help="a fiftieth of the lengths")
    parser.add_argument("--only", nargs="+", choices=tuple(CASES), default=tuple(CASES), help="some of the commands")
    parser.add_argument("--shares", nargs="+", type=float, default=SHARES, help="lengths, as fractions of the longest")
    parser.add_argument("--write", action="store_true", help="keep the tables in benchmarks/results-length.md")
    options = parser.parse_args()
    tables: list[Table] = []
    for name in options.only:
        tables.append(measure(CASES[name], tuple(options.shares), QUICK if options.quick else 1.0))
        print(tables[-1], flush=True)
    if options.write:
        head = f"# Length\n\nWritten by `python benchmarks/length.py --write`. {machine()}.\n"
        (HERE / "results-length.md").write_text("\n".join([head, *map(str, tables)]), encoding="utf-8")


if __name__ == "__main__":
    main()
