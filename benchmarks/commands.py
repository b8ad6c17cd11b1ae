"""Every command on a small job: its CPU time, how much of that is the start of the program, and where the rest goes.

    python benchmarks/commands.py             about six minutes
    python benchmarks/commands.py --write     keep the table in benchmarks/results-commands.md

Times are CPU seconds of whole processes, medians of three runs. The costliest place is the function that has the most
time of its own, in it and in what it calls outside of gnomon, by a fourth run under the profiler.
"""

import argparse
import pstats
import subprocess
import sys
import tempfile
from pathlib import Path

from imu import HERE, Table, machine
from limits import median_child

import gnomon

HOME = str(Path(gnomon.__file__).parent)

INPUTS = (
    "simulate -o imu.npz",
    "simulate-turntable -o turns",
    "simulate-platter-video --duration-s 15 -o platter.mp4",
    "simulate-magnetometer -o field.npz",
    "simulate-noise --duration-s 3600 -o rest.npz",
    "simulate-cameras -o views",
    "simulate-camera-imu -o rig",
    "simulate-camera-imu --duration-s 16 --camera-rate-hz 5 --images -o images",
    "simulate-poses -o poses.csv",
)
COMMANDS = (
    *INPUTS,
    "--help",
    "imu imu.npz -o of-imu",
    "imu poses.csv -o of-poses",
    "turntable turns --rate 16rpm -o of-turns",
    "rate platter.mp4",
    "magnetometer field.npz -o of-field",
    "noise rest.npz -o of-rest",
    "camera views -o of-views",
    "camera-imu rig -o of-rig",
    "check imu.npz",
    "check rig",
    "check images",
    "plan",
    "plan-imu",
    "target aprilgrid -o board",
    "show of-imu/calibration.yaml",
    "apply of-imu/calibration.yaml imu.npz -o applied.csv",
    "convert of-rig/calibration.yaml --to kalibr -o kalibr",
    "compare of-rig/calibration.yaml rig/truth.yaml -o compared",
    "study angrisano --runs 2 -o study",
    "demo -o demo",
)


def costliest(arguments: list[str], place: Path) -> str:
    """Return the function of gnomon with the most time outside of gnomon's other functions, and its share."""
    kept = place / "profile"
    words = [sys.executable, "-m", "cProfile", "-o", str(kept), "-m", "gnomon", *arguments]
    subprocess.run(words, cwd=place, capture_output=True, check=False)
    stats = pstats.Stats(str(kept)).stats  # pyright: ignore[reportAttributeAccessIssue]
    own: dict[str, float] = {}
    total = sum(found[2] for found in stats.values())
    for (file, _, name), (_, _, itself, _, callers) in stats.items():
        if file.startswith(HOME):
            own[_name(file, name)] = own.get(_name(file, name), 0.0) + itself
        else:  # what it calls itself counts as its own
            for (caller, _, its), shares in callers.items():
                if caller.startswith(HOME) and its != "<module>":
                    own[_name(caller, its)] = own.get(_name(caller, its), 0.0) + shares[3]
    best = max(own, key=lambda key: own[key])
    return f"{best} ({100 * own[best] / total:.0f} %)"


def _name(file: str, function: str) -> str:
    return f"{Path(file).relative_to(HOME).with_suffix('').as_posix()}.{function}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="keep the table in benchmarks/results-commands.md")
    options = parser.parse_args()
    table = Table("Every command on a small job", ("command", "CPU [s]", "peak [MiB]", "costliest place"))
    print("| " + " | ".join(table.columns) + " |", "|" + " --- |" * len(table.columns), sep="\n", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        for command in COMMANDS:
            words = command.split()
            seconds, peak = median_child(["-c", _IN, scratch, *words])
            table.add(f"`gnomon {command}`", f"{seconds:.2f}", f"{peak:.0f}", costliest(words, Path(scratch)))
            print("| " + " | ".join(table.rows[-1]) + " |", flush=True)
    table.note = f"{machine()}. `--help` is what the start of the program takes."
    if options.write:
        head = "# Every command\n\nWritten by `python benchmarks/commands.py --write`."
        (HERE / "results-commands.md").write_text(f"{head}\n\n{table}", encoding="utf-8")


_IN = """\
import os, runpy, sys
os.chdir(sys.argv[1])
sys.argv = ["gnomon", *sys.argv[2:]]
runpy.run_module("gnomon", run_name="__main__")
"""


if __name__ == "__main__":
    main()
