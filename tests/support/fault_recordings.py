"""Sound recordings, spoilt: what the edits of the catalogue's faults have in common."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gnomon.options import CameraImuOptions, ImuOptions
from gnomon.recording import CameraFrames, Floats, ImuSamples, Integers, TriadSamples
from gnomon.simulate.camera_imu import CameraImuSimulation, simulate_camera_imu
from gnomon.simulate.imu import simulate_imu
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.scenarios.recorded import Scenario

from .faults import Fault, FaultyRecording, Spoil


def faulty_recording(fault: Fault, seed: int) -> FaultyRecording:
    """Return a recording with a fault; see `support.faults`."""
    case = sound_recording(fault.scenario, seed)
    return case if fault.spoil is None else fault.spoil(case, np.random.default_rng([seed, 1]))


def sound_recording(scenario: Scenario | CameraImuScenario, seed: int) -> FaultyRecording:
    """Return a recording as it is simulated."""
    if isinstance(scenario, Scenario):
        recording, truth = simulate_imu(scenario, seed)
        return FaultyRecording(recording=recording, target=None, options=ImuOptions(), truth=truth)
    simulation = simulate_camera_imu(scenario, seed)
    return FaultyRecording(
        recording=simulation.recording,
        target=simulation.target,
        options=CameraImuOptions(),
        truth=simulation.truth,
    )


def simulation_of(case: FaultyRecording, scenario: CameraImuScenario) -> CameraImuSimulation:
    """Return the simulation behind a recording of cameras: its true motion."""
    seed = case.truth.provenance.seed
    assert seed is not None
    return simulate_camera_imu(scenario, seed)


def with_imu(case: FaultyRecording, imu: ImuSamples) -> FaultyRecording:
    """Return the recording with other samples."""
    return replace(case, recording=replace(case.recording, imus={"imu0": imu}))


def with_frames(case: FaultyRecording, frames: CameraFrames) -> FaultyRecording:
    """Return the recording with other frames of cam0."""
    return replace(case, recording=replace(case.recording, cameras={"cam0": frames}))


def seconds(t_ns: Integers) -> Floats:
    """Return timestamps as seconds from the first of them."""
    return np.asarray((t_ns - t_ns[0]) * 1e-9, dtype=np.float64)


def values_of(samples: TriadSamples, change: Callable[[Floats, Floats], Floats]) -> TriadSamples:
    """Return samples with values that `change` makes of the seconds (n,) and the values (n, 3)."""
    return replace(samples, values=change(seconds(samples.t_ns), np.array(samples.values)))


def accelerometer(change: Callable[[Floats, Floats], Floats]) -> Spoil:
    """Return the fault that changes the values of the accelerometer."""

    def spoil(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
        imu = case.recording.imus["imu0"]
        return with_imu(case, replace(imu, accelerometer=values_of(imu.accelerometer, change)))

    return spoil


def gyroscope(change: Callable[[Floats, Floats], Floats]) -> Spoil:
    """Return the fault that changes the values of the gyroscope."""

    def spoil(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
        imu = case.recording.imus["imu0"]
        return with_imu(case, replace(imu, gyroscope=values_of(imu.gyroscope, change)))

    return spoil


def both(change: Callable[[TriadSamples, np.random.Generator], TriadSamples]) -> Spoil:
    """Return the fault that changes both triads of the IMU in the same way, by the same random numbers."""

    def spoil(case: FaultyRecording, rng: np.random.Generator) -> FaultyRecording:
        imu, seed = case.recording.imus["imu0"], int(rng.integers(2**32))
        triads = [change(samples, np.random.default_rng(seed)) for samples in (imu.accelerometer, imu.gyroscope)]
        return with_imu(case, replace(imu, accelerometer=triads[0], gyroscope=triads[1]))

    return spoil


def frames_of(change: Callable[[CameraFrames, np.random.Generator], CameraFrames]) -> Spoil:
    """Return the fault that changes the frames of cam0."""

    def spoil(case: FaultyRecording, rng: np.random.Generator) -> FaultyRecording:
        return with_frames(case, change(case.recording.cameras["cam0"], rng))

    return spoil


def some(samples: TriadSamples, kept: np.ndarray) -> TriadSamples:
    """Return some of the samples, (n,) bool."""
    return replace(samples, t_ns=samples.t_ns[kept], values=samples.values[kept])


def delayed(samples: TriadSamples, by_s: float) -> TriadSamples:
    """Return samples that are stamped later than they were taken."""
    return replace(samples, t_ns=samples.t_ns + round(by_s * 1e9))


def warming(t_s: Floats, time_constant_s: float) -> Floats:
    """Return how far a sensor has warmed up, 0 to 1, as a column."""
    return 1 - np.exp(-t_s[:, None] / time_constant_s)
