"""Results of every kind go through pickle, through `deepcopy`, and to another process and back, as they are."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import field, fields, is_dataclass
from multiprocessing import get_context

import numpy as np
import pytest

import gnomon
from cameras_result import make_cameras_result
from gnomon.frozen import FrozenMapping, value_class
from gnomon.simulate.scenarios.recorded import TemperatureScenario
from gnomon.simulate.temperature import simulate_temperature


def same(one, other) -> bool:
    """Return whether two values are of one type and hold the same, arrays bit by bit."""
    if type(one) is not type(other):
        return False
    if is_dataclass(one):
        return all(same(getattr(one, entry.name), getattr(other, entry.name)) for entry in fields(one))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, (dict, FrozenMapping)):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or (one != one and other != other)


def imu():
    recording, truth = gnomon.simulate(gnomon.Scenario(intervals=12), 3)
    return recording, truth, gnomon.calibrate_imu(recording)


def poses():
    simulation = gnomon.simulate_poses(gnomon.PoseScenario(), 0)
    means = gnomon.Poses(
        name=tuple(f"pose {k}" for k in range(len(simulation.poses))),
        accelerometer=simulation.accelerometer,
        accelerometer_unit=simulation.poses[0].accelerometer.unit,
    )
    return simulation, gnomon.calibrate_imu(gnomon.Recording(imus={}, poses=means))


def turntable():
    simulation = gnomon.simulate_turntable(gnomon.TurntableScenario(steady_s=8.0), 0)
    rates = [
        gnomon.StatedRate(name=name, rate_rad_s=rate, sigma_rad_s=1e-3 * rate)
        for name, rate in zip("abcdef", simulation.rates, strict=False)
    ]
    return gnomon.calibrate_turntable(simulation.recordings, rates)


def magnetometer():
    return gnomon.calibrate_magnetometer(gnomon.simulate_magnetometer(gnomon.FieldScenario(), 0)[0])


def noise():
    rng = np.random.default_rng(0)
    t_ns = np.arange(40_000) * 10_000_000
    triad = [
        gnomon.TriadSamples(t_ns=t_ns, values=middle + rng.normal(0, sigma, (len(t_ns), 3)), unit=unit)
        for middle, sigma, unit in (([0, 0, 9.81], 1e-2, "m/s^2"), (0, 1e-3, "rad/s"))
    ]
    return gnomon.identify_noise(
        gnomon.Recording(imus={"imu0": gnomon.ImuSamples(accelerometer=triad[0], gyroscope=triad[1])})
    )


def comparison():
    _, truth, result = imu()
    return gnomon.compare(result.calibration, truth)


def plan():
    return gnomon.plan(gnomon.ImuPlan())


def verification():
    _, _, result = imu()
    return gnomon.verify(result, gnomon.simulate(gnomon.Scenario(intervals=12), 4)[0])


def several():
    scenario = gnomon.Scenario(intervals=12, sensor_seed=3)
    return gnomon.calibrate_imu([gnomon.simulate(scenario, seed)[0] for seed in (3, 4)])


def temperature():
    scenario = TemperatureScenario(recordings=2, rate_hz=5.0, duration_s=300.0, order=1, step_k=0.1)
    made = simulate_temperature(scenario, 11)
    return made, gnomon.calibrate_temperature(made.recordings)


def scenario():
    return gnomon.simulate_camera_imu(
        gnomon.CameraImuScenario(duration_s=2.0, camera_rate_hz=5.0, imu_rate_hz=100.0), 0
    )


KINDS = {
    "imu": imu, "poses": poses, "turntable": turntable, "magnetometer": magnetometer, "noise": noise,
    "cameras": make_cameras_result, "comparison": comparison, "plan": plan, "simulated rig": scenario,
    "verification": verification, "several recordings": several, "temperature": temperature,
}  # fmt: skip


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.long] * (kind == "temperature")) for kind in KINDS]
)
def test_a_result_survives_pickle_and_deepcopy(kind):
    result = KINDS[kind]()
    for twin in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        assert same(result, twin)


def test_a_camera_imu_result_and_its_recording_survive_too(camera_imu_case):
    case = camera_imu_case()
    for twin in (pickle.loads(pickle.dumps(case)), copy.deepcopy(case)):
        assert same(case, twin)


def test_a_foreign_calibration_survives(tmp_path):
    _, truth, _ = imu()
    gnomon.convert(truth, "kalibr", tmp_path)
    foreign = gnomon.load_foreign(tmp_path / "imu.yaml")
    assert same(foreign, pickle.loads(pickle.dumps(foreign)))


def test_results_come_back_from_a_process_pool():
    recordings = [gnomon.simulate(gnomon.Scenario(intervals=12), seed)[0] for seed in (1, 2)]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(gnomon.calibrate_imu, recordings))
    for recording, result in zip(recordings, found, strict=True):
        assert same(result.calibration, gnomon.calibrate_imu(recording).calibration)


def test_a_frozen_mapping_is_read_like_a_dict_and_cannot_be_changed():
    held = {"b": 1, "a": 2}
    frozen = FrozenMapping(held)
    held["c"] = 3
    assert frozen == {"b": 1, "a": 2}
    assert list(frozen) == ["b", "a"]
    assert list(reversed(frozen)) == ["a", "b"]
    assert frozen | {"a": 5} == {"b": 1, "a": 5}
    assert {"a": 5} | frozen == {"a": 2, "b": 1}
    with pytest.raises(TypeError):
        frozen["a"] = 3
    assert type(copy.deepcopy(frozen)) is FrozenMapping


@value_class
class _Made:
    """A value with all that a field may be."""

    hz: float
    unit: str = "Hz"
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        object.__setattr__(self, "hz", float(self.hz))


def test_the_first_and_the_hundredth_value_of_a_class_are_made_alike() -> None:
    for _ in range(100):
        value = _Made(hz=2)
        assert (type(value.hz), value.hz, value.unit, value.notes) == (float, 2.0, "Hz", [])
        assert _Made(hz=1, unit="rad/s", notes=["a"]).notes == ["a"]


@pytest.mark.parametrize("wrong", [{}, {"hz": 1.0, "khz": 2.0}, {"unit": "Hz"}])
def test_missing_and_unknown_fields_are_refused_from_the_first_value_on(wrong: dict[str, object]) -> None:
    made = value_class(type("Made", (), {"__annotations__": {"hz": float}, "__doc__": "One."}))
    for _ in range(2):
        with pytest.raises(TypeError):
            made(**wrong)
