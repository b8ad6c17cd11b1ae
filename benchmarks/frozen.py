"""Whether two versions of gnomon give the same answers: numbers, verdicts and findings on two dozen recordings.

    python benchmarks/frozen.py record before.json             the answers of the gnomon that is imported
    python benchmarks/frozen.py compare before.json            run again, and list what differs
    python benchmarks/frozen.py compare before.json --only imu such as these only

Numbers are equal when they differ by less than 1e-9 of their size, or of 1e-3 of the largest number beside them
where that is more. Texts (messages, advice) may change; codes and verdicts may not. Simulated recordings are made by
the version under test: what a simulation changes is seen as a difference, too. The real recordings are looked for in
$GNOMON_DATA, and left out with a word where there are none. About two minutes.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

DATA = Path(os.environ.get("GNOMON_DATA", Path(__file__).parents[2] / "shared" / "data"))

SIMULATED = (
    "simulate -o imu.npz --seed 7 --sensor-seed 3",
    "simulate -o imu-other.npz --seed 9 --sensor-seed 3",
    "simulate -o raw.csv --seed 8 --units raw --g-sensitivity 3e-4",
    "simulate-turntable -o turns --seed 7",
    "simulate-magnetometer -o field.npz --seed 7",
    "simulate-noise --duration-s 3600 -o rest.npz --seed 7",
    "simulate-cameras -o views --cameras 2 --seed 7",
    "simulate-camera-imu -o rig --duration-s 25 --seed 7",
    "simulate-poses -o poses.csv --seed 7",
)
COMMANDS = {
    "imu-simulated": "imu imu.npz -o imu-simulated",
    "imu-raw": "imu raw.csv -o imu-raw --gravity 9.80665",
    "imu-tedaldi": "imu imu.npz -o imu-tedaldi --preset tedaldi2014",
    "imu-joined": "imu imu.npz imu-other.npz -o imu-joined",
    "check-imu": "check imu.npz --json",
    "poses": "imu poses.csv -o poses",
    "turntable": "turntable turns --rate 16rpm -o turntable",
    "magnetometer": "magnetometer field.npz -o magnetometer",
    "noise": "noise rest.npz -o noise",
    "camera": "camera views -o camera",
    "camera-imu": "camera-imu rig -o camera-imu",
    "check-rig": "check rig --json",
    "plan": "plan --json",
    "plan-imu": "plan-imu --json",
    "compare": "compare camera-imu/calibration.yaml rig/truth.yaml -o compare --json",
}
APRILGRID = "{data}/rendered-camimu/a-aprilgrid-full/target.yaml"
EUROC = "{data}/kalibr-format-samples/openvins_euroc_mav"
RECORDED = {
    "imu-xsens": "imu {data}/xsens_mti/xsens_acc.mat.gz {data}/xsens_mti/xsens_gyro.mat.gz"
    " --gravity 9.81744 -o imu-xsens",
    "imu-mikov": "imu {data}/mikov-mpu9150-multipos/imu1.log --rate 100 -o imu-mikov",
    "check-mikov": "check {data}/mikov-mpu9150-multipos/imu0.log --rate 100 --json",
    "magnetometer-qmc": "magnetometer {data}/qmc5883l-mag/noisy_raw_data.csv -o magnetometer-qmc",
    "noise-mpu": "noise {data}/mpu6050-hmc5883l/set-2__unmoved-with-x-pointing-forward-10min.npz -o noise-mpu",
    "magnetometer-mpu": "magnetometer {data}/mpu6050-hmc5883l/set-2__full-sphere.npz -o magnetometer-mpu",
    "camera-imu-rendered": "camera-imu {data}/rendered-camimu/a-aprilgrid-full -o camera-imu-rendered",
    "camera-imu-euroc": f"camera-imu {{data}}/euroc-imu-april --target {APRILGRID}"
    f" --cam {EUROC}/kalibr_imucam_chain.yaml --imu {EUROC}/kalibr_imu_chain.yaml -o camera-imu-euroc",
    "camera-euroc": f"camera {{data}}/euroc-cam-april --target {APRILGRID} -o camera-euroc",
}
CODES = ("verdict", "code", "severity", "model", "status", "subject", "follows_from")
"""Texts that are part of the answer, by their key."""


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Return the numbers and codes in a document, by their path."""
    if isinstance(value, dict):
        items = [(str(key), inner) for key, inner in value.items() if key not in ("seconds", "duration_of_run_s")]
    elif isinstance(value, list):
        items = [(str(number), inner) for number, inner in enumerate(value)]
    else:
        last = path.rsplit("/", 1)[-1]
        kept = isinstance(value, bool | int | float) or value is None or last in CODES
        return {path: value} if kept else {}
    return {key: found for name, inner in items for key, found in flatten(inner, f"{path}/{name}").items()}


def answers(only: str) -> dict[str, dict[str, Any]]:
    """Run the commands in a temporary folder and return the answers of each: exit code, numbers, codes."""
    commands = {**COMMANDS, **(RECORDED if DATA.is_dir() else {})}
    if not DATA.is_dir():
        print(f"no recordings in {DATA}; set GNOMON_DATA", file=sys.stderr)
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as place:
        for line in SIMULATED:
            run(line, place)
        for name, line in commands.items():
            if only in name:
                done = run(line.format(data=DATA), place)
                found[name] = {"exit": done.returncode, **documents(name, done.stdout, Path(place))}
                print(f"{name}: exit {done.returncode}, {len(found[name])} values", file=sys.stderr)
                if done.returncode not in (0, 4):
                    print(done.stderr, file=sys.stderr)
    return found


def run(line: str, place: str) -> subprocess.CompletedProcess[str]:
    """Run a command of gnomon in a folder."""
    words = [sys.executable, "-P", "-m", "gnomon", *line.split()]
    return subprocess.run(words, cwd=place, capture_output=True, text=True, check=False)


def documents(name: str, printed: str, place: Path) -> dict[str, Any]:
    """Return the flattened documents of a command: printed JSON, and the YAML and JSON files of its folder."""
    found = flatten(json.loads(printed), "json") if printed.lstrip().startswith("{") else {}
    for file in sorted((place / name).rglob("*")):
        if file.suffix in (".yaml", ".json"):
            loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
            found |= flatten(yaml.load(file.read_text(), loader), file.name)
    return found


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Return a line for each value that differs."""
    sizes: dict[str, float] = {}
    for path, value in before.items():
        if isinstance(value, float) and np.isfinite(value):
            row = path.rsplit("/", 1)[0]
            sizes[row] = max(sizes.get(row, 0.0), abs(value))
    lines: list[str] = []
    for path in sorted({*before, *after}):
        old, new = before.get(path, "none"), after.get(path, "none")
        if isinstance(old, float | int) and isinstance(new, float | int):
            scale = max(abs(old), 1e-3 * sizes.get(path.rsplit("/", 1)[0], 0.0))
            equal = old == new or abs(old - new) <= 1e-9 * scale or (np.isnan(old) and np.isnan(new))
        else:
            equal = old == new
        if not equal:
            lines.append(f"  {path}: {old} -> {new}")
    return lines


def main() -> int:
    """Record the answers, or compare with what was recorded; 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", default="", help="commands whose name holds this")
    parser.add_argument("--lines", type=int, default=20, help="differences shown of a command")
    options = parser.parse_args()
    found = answers(options.only)
    if options.action == "record":
        options.file.write_text(json.dumps(found, indent=0, sort_keys=True))
        return 0
    before = json.loads(options.file.read_text())
    # What was read from JSON is compared with what was through JSON, too.
    found = json.loads(json.dumps(found))
    worse = 0
    for name, values in found.items():
        lines = differences(before.get(name, {}), values)
        worse += bool(lines)
        print(f"{name}: {len(values)} values, {len(lines)} differ")
        print("".join(line + "\n" for line in lines[: options.lines]), end="")
    return int(worse > 0)


if __name__ == "__main__":
    sys.exit(main())
