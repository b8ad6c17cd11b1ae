"""Recordings in whose middle something changes: what is named, and how often a healthy one is accused.

    python benchmarks/changes.py                          every fault, three seeds each, and twenty healthy of a kind
    python benchmarks/changes.py --seeds 20 --healthy 50  more of them
    python benchmarks/changes.py --only remount zoom      some of the faults
    python benchmarks/changes.py --write                  keep the table in benchmarks/results-changes.md

A fault is edited into a simulated recording, of a size drawn evenly on a log scale, at a random time in its middle
half. Missed is what passes although the truth at the end or at the beginning of the recording lies beyond four
published sigmas and beyond what general use needs. Named is what `parameter-changed` tells.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np
from imu import HERE, Table, machine

import gnomon
from gnomon import CameraImuOptions, CameraImuScenario, Recording, Scenario
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.options import StatedRate
from gnomon.simulate import (
    CamerasScenario,
    FieldScenario,
    TurntableScenario,
    simulate_camera_imu,
    simulate_cameras,
    simulate_magnetometer,
    simulate_turntable,
)

NEEDED = {"rotation": np.radians(0.1), "scale": 2e-3, "axes": 3e-3, "time shift": 5e-4, "lens": 0.25, "field": 0.0122}
"""What general use needs [rad, 1, rad, s, px, rad], as `gnomon.assess.changes` has it."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a calibration says of a recording.

    Parameters
    ----------
    verdict : of the calibration
    named : whether a change is told
    missed : whether it passes although the truth is beyond its sigmas and the need
    size : of the fault
    """

    verdict: str
    named: bool
    missed: bool
    size: float


def random_axis(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def when(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return which instants are after a random one in the middle half."""
    return t > t[0] + rng.uniform(0.25, 0.75) * (t[-1] - t[0])


def outcome(calibration: Any, path: str, truths: tuple[np.ndarray, ...], needed: float, size: float) -> Outcome:
    """Judge a matrix, relative to its rows: beyond four sigmas and the need of the truth at either end."""
    found, sigma = calibration.parameter(path), calibration.sigma(path)
    beyond = False
    for truth in truths:
        error = np.abs(found - truth)
        length = np.linalg.norm(truth, axis=-1, keepdims=True) if truth.ndim == 2 else 1.0
        beyond |= bool(np.any((error > 4 * sigma) & (error > needed * length)))
    named = any(finding.code == "parameter-changed" for finding in calibration.assessment.findings)
    loud = calibration.verdict != "pass"
    return Outcome(verdict=calibration.verdict, named=named, missed=beyond and not loud, size=size)


def imu_fault(kind: str, seed: int, size: float) -> Outcome:
    """Remount the gyroscope by `size` deg, or let the scale of a triad drift by `size` %."""
    rng = np.random.default_rng(10_000 + seed)
    recording, truth = gnomon.simulate(Scenario(), seed)
    samples, sensors = recording.imus["imu0"], truth.imus["imu0"]
    t = samples.gyroscope.t_s
    rate, force = samples.gyroscope.values.copy(), samples.accelerometer.values.copy()
    triad = "accelerometer" if kind == "accelerometer drift" else "gyroscope"
    values, sensor = (force if triad == "accelerometer" else rate), getattr(sensors, triad)
    if kind == "remount":
        turn = rotation_from_rotvec(np.radians(size) * random_axis(rng))
        later = sensor.sensitivity @ turn
        moved = (values - sensor.bias) @ np.linalg.inv(sensor.sensitivity).T @ later.T + sensor.bias
        values[:] = np.where(when(t, rng)[:, None], moved, values)
    else:
        grows = 1 + size / 100 * ((t - t[0]) / (t[-1] - t[0]))[:, None] * (rng.permutation([1, 0, 0]) if size else 0)
        later = sensor.sensitivity * grows[-1][:, None]
        values[:] = (values - sensor.bias) * grows + sensor.bias
    calibration = gnomon.calibrate_imu(Recording.from_arrays(t, rate, force)).calibration
    need = NEEDED["axes" if kind == "remount" else "scale"]
    return outcome(calibration, f"imu0.{triad}.sensitivity", (sensor.sensitivity, later), need, size)


def lens_fault(kind: str, seed: int, size: float) -> Outcome:
    """Shift the crop by `size` px, or zoom by `size` %, at once or in every other image."""
    rng = np.random.default_rng(20_000 + seed)
    simulation = simulate_cameras(CamerasScenario(), seed)
    frames = simulation.recording.cameras["cam0"]
    middle = (np.array(simulation.scenario.resolution) - 1) / 2
    late = frames.frame % 2 == 1 if kind == "two cameras" else when(np.arange(len(frames.t_ns)), rng)[frames.frame]
    heading = rng.uniform(0, 2 * np.pi)
    shift = size * np.array([np.cos(heading), np.sin(heading)])
    moved = frames.pixels + shift if kind == "crop" else middle + (frames.pixels - middle) * (1 + size / 100)
    pixels = np.where(late[:, None], moved, frames.pixels)
    recording = replace(simulation.recording, cameras={"cam0": replace(frames, pixels=pixels)})
    calibration = gnomon.calibrate_cameras(recording, simulation.target).calibration
    true = np.array(simulation.scenario.intrinsics)
    later = true + np.r_[0, 0, shift] if kind == "crop" else true * (1 + np.r_[1, 1, 0, 0] * size / 100)
    found = calibration.parameter("cam0.intrinsics")
    if len(found) != len(true) or not size:  # another lens model: its numbers are not those of the truth
        true = later = found if not size else np.full(len(found), np.inf)
    return outcome(calibration, "cam0.intrinsics", (true, later), 2 * NEEDED["lens"], size)


def rig_fault(kind: str, seed: int, size: float) -> Outcome:
    """Knock the camera by `size` deg, or shift its clock by `size` ms."""
    rng = np.random.default_rng(30_000 + seed)
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=30.0), seed)
    frames, truth = simulation.recording.cameras["cam0"], simulation.truth
    late = when(frames.t_ns, rng)
    if kind == "knock":
        lens, turn = truth.cameras["cam0"].camera, rotation_from_rotvec(np.radians(size) * random_axis(rng))
        rays, _ = lens.unproject(frames.pixels)
        moved = frames.pixels + lens.project(rays @ turn.T).pixels - lens.project(rays).pixels
        edited = replace(frames, pixels=np.where(late[frames.frame][:, None], moved, frames.pixels))
        path, apart, need = "cam0.T_cam_imu.rotation", np.radians(size), NEEDED["rotation"]
    else:
        edited = replace(frames, t_ns=frames.t_ns + np.where(late, round(1e6 * size), 0))
        path, apart, need = "cam0.time_shift_cam_imu", size * 1e-3, NEEDED["time shift"]
    recording = replace(simulation.recording, cameras={"cam0": edited})
    result = gnomon.calibrate_camera_imu(recording, simulation.target, CameraImuOptions(compare=False))
    told = outcome(result.calibration, path, (), need, size)
    sigma = float(np.max(result.calibration.sigma(path)))  # one of the ends is at least half of the change away
    return replace(told, missed=told.verdict == "pass" and apart / 2 > max(4 * sigma, need))


def field_fault(kind: str, seed: int, size: float) -> Outcome:
    """Let the scales of one axis of a magnetometer grow by `size` %."""
    rng = np.random.default_rng(40_000 + seed)
    recording, truth = simulate_magnetometer(FieldScenario(rests=8), seed)
    samples, sensor = recording.imus["imu0"], truth.imus["imu0"].magnetometer
    magnetometer = samples.magnetometer
    late = (
        when(magnetometer.t_s, rng)[:, None] if kind == "soft iron" else np.zeros((len(magnetometer.values), 1), bool)
    )
    grows = 1 + size / 100 * rng.permutation([1, 0, 0])
    values = np.where(late, (magnetometer.values - sensor.bias) * grows + sensor.bias, magnetometer.values)
    edited = replace(samples, magnetometer=replace(magnetometer, values=values))
    result = gnomon.calibrate_magnetometer(replace(recording, imus={"imu0": edited}))
    told = outcome(result.calibration, "imu0.magnetometer.sensitivity", (), NEEDED["field"], size)
    return replace(told, missed=told.verdict == "pass" and size / 100 > 2 * NEEDED["field"])


def turntable_fault(kind: str, seed: int, size: float) -> Outcome:
    """Let the gyroscope's scale be larger by `size` % in the second half of the orientations."""
    del kind
    simulation = simulate_turntable(TurntableScenario(files="each"), seed)
    recordings = list(simulation.recordings)
    sensor = simulation.truth.imus["imu0"].gyroscope
    for k in range(len(recordings) // 2, len(recordings)):
        samples = recordings[k].imus["imu0"]
        values = (samples.gyroscope.values - sensor.bias) * (1 + size / 100) + sensor.bias
        edited = replace(samples, gyroscope=replace(samples.gyroscope, values=values))
        recordings[k] = replace(recordings[k], imus={"imu0": edited})
    result = gnomon.calibrate_turntable(recordings, [stated(rpm) for rpm in simulation.scenario.rpm])
    told = outcome(result.calibration, "imu0.gyroscope.sensitivity", (), NEEDED["scale"], size)
    return replace(told, missed=told.verdict == "pass" and size / 200 > NEEDED["scale"])


def stated(rpm: float) -> StatedRate:
    rate = rpm * np.pi / 30
    return StatedRate(name=f"{rpm:g}rpm", rate_rad_s=rate, sigma_rad_s=1e-3 * rate)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault: what is edited, between which sizes, in which unit."""

    run: Callable[[str, int, float], Outcome]
    sizes: tuple[float, float]
    unit: str


FAULTS = {
    "remount": Fault(run=imu_fault, sizes=(0.3, 3.0), unit="deg"),
    "gyroscope drift": Fault(run=imu_fault, sizes=(0.3, 3.0), unit="%"),
    "accelerometer drift": Fault(run=imu_fault, sizes=(0.3, 3.0), unit="%"),
    "crop": Fault(run=lens_fault, sizes=(2.0, 16.0), unit="px"),
    "zoom": Fault(run=lens_fault, sizes=(0.2, 0.5), unit="%"),
    "two cameras": Fault(run=lens_fault, sizes=(0.2, 0.5), unit="%"),
    "knock": Fault(run=rig_fault, sizes=(0.3, 1.0), unit="deg"),
    "clock": Fault(run=rig_fault, sizes=(1.0, 5.0), unit="ms"),
    "soft iron": Fault(run=field_fault, sizes=(3.0, 10.0), unit="%"),
    "turntable": Fault(run=turntable_fault, sizes=(0.5, 3.0), unit="%"),
}
HEALTHY = {
    "imu": ("gyroscope drift", imu_fault),
    "camera": ("zoom", lens_fault),
    "camera-imu": ("clock", rig_fault),
    "magnetometer": ("healthy", field_fault),
    "turntable": ("turntable", turntable_fault),
}


def study(names: list[str], seeds: int, healthy: int, first: int) -> Iterator[tuple[str, list[Outcome]]]:
    """Yield the outcomes of each fault, then those of healthy recordings of each kind."""
    for name in names:
        fault, rng = FAULTS[name], np.random.default_rng(first + len(name))
        low, high = np.log(fault.sizes)
        sizes = np.exp(rng.uniform(low, high, seeds))
        yield (
            f"{name}, {fault.sizes[0]:g} to {fault.sizes[1]:g} {fault.unit}",
            [fault.run(name, first + seed, float(size)) for seed, size in enumerate(sizes)],
        )
    for name, (kind, run) in HEALTHY.items():
        if healthy and (len(names) == len(FAULTS) or any(FAULTS[one].run is run for one in names)):
            yield f"healthy {name}", [run(kind, first + 1000 + seed, 0.0) for seed in range(healthy)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000, help="first seed; healthy ones begin 1000 later")
    parser.add_argument("--only", nargs="*", choices=list(FAULTS), default=list(FAULTS))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    begin = time.process_time()
    columns = ("recordings", "number", "named", "pass", "warn", "fail", "missed")
    table = Table(title="Changes in mid-recording", columns=columns)
    for name, found in study(options.only, options.seeds, options.healthy, options.first):
        counts = [sum(one.verdict == verdict for one in found) for verdict in ("pass", "warn", "fail")]
        cells = [len(found), sum(one.named for one in found), *counts, sum(one.missed for one in found)]
        table.add(name, *map(str, cells))
        print(f"{name:40} {cells}", flush=True)
    text = f"{table}\n{time.process_time() - begin:.0f} s of CPU on {machine()}.\n"
    print(f"\n{text}")
    if options.write:
        (HERE / "results-changes.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
