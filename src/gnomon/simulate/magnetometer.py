"""The simulation of a magnetometer that a hand turns over the sphere."""

from dataclasses import replace

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import frame_rotation, rotation_from_rotvec
from ..recording import Floats, ImuSamples, Recording, TriadSamples
from ..results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
)
from ..results.moved import rotate_imu
from ..results.temperature_dependence import TemperatureDependence
from ..units import MAGNETOMETER_UNITS_UT, STANDARD_GRAVITY_M_S2, Units
from .scenarios.recorded import FieldScenario, Scenario, TemperatureScenario
from .sensor import Converter, drawn_imu, sensor_converters, true_calibration
from .temperature import thermometer_readings, warm_up_share

_LIKE = Scenario(accelerometer_misalignment=0.005, accelerometer_scale=(0.995, 1.005), gyroscope_scale=(0.98, 1.02))
_RATES = {"sphere": (0.83, 0.47, 0.59), "one-axis": (0.0, 0.0, 0.9), "still": (0.0, 0.0, 0.0)}
_SWAY_RAD, _SWAYS = 0.5, 3


def simulate_magnetometer(scenario: FieldScenario | None = None, seed: int = 0) -> tuple[Recording, Calibration]:
    """Make a recording of a magnetometer that a hand turns over the sphere, and the calibration that is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    recording : one IMU, "imu0", with a magnetometer
    truth : in body frame "accel-x", or "mag-x" without accelerometer, with zero covariance; the field in uT

    Examples
    --------
    >>> recording, truth = simulate_magnetometer(FieldScenario(duration_s=20.0), seed=1)
    >>> len(recording.imus["imu0"].magnetometer), truth.frame
    (1000, 'accel-x')
    """
    scenario = scenario or FieldScenario()
    # One stream a purpose: an option for one leaves the others as they are.
    for_sensor, for_motion, for_field, for_noise, for_force, for_warmth = np.random.default_rng(seed).spawn(6)
    if scenario.sensor_seed is not None:
        for_sensor = np.random.default_rng(scenario.sensor_seed)
    to_field = _converter(scenario)
    imu = _sensor(scenario, to_field, for_sensor)
    assert imu.magnetometer is not None and imu.accelerometer is not None  # noqa: PT018
    motion = _Motion.drawn(scenario, for_motion)
    t_s = np.arange(int(scenario.duration_s * scenario.rate_hz)) / scenario.rate_hz
    field = _seen(motion, t_s, _field_world(scenario)) + _differences(scenario, t_s, for_field)
    field += scenario.noise * for_noise.standard_normal(field.shape)
    bad = for_noise.random(len(t_s)) < scenario.outliers
    field[bad] += scenario.field * for_noise.uniform(-1, 1, (int(bad.sum()), 3))
    values = field @ imu.magnetometer.sensitivity.T + imu.magnetometer.bias
    thermometer = None
    if scenario.heating_k:
        warm = _warming(scenario)
        degc = warm.start_degc + scenario.heating_k * warm_up_share(warm, t_s)
        changes = _changes(scenario, degc, to_field, for_warmth)
        values = changes.from_reference("magnetometer", values, degc, imu.magnetometer.bias)
        thermometer = thermometer_readings(warm, np.rint(t_s * 1e9).astype(np.int64), degc, for_warmth)
        imu = replace(imu, temperature=changes)
    magnetometer = _samples(t_s, to_field.digitise(values), to_field.unit)
    inertial = _inertial(scenario, motion, imu, for_force)
    samples = ImuSamples(
        accelerometer=inertial[0], gyroscope=inertial[1], magnetometer=magnetometer, temperature=thermometer
    )
    return Recording(imus={"imu0": samples}), _truth(scenario, seed, imu)


@value_class
class _Motion:
    """Attitude as three angles, R_world_imu = Rz(a) Ry(b) Rx(c), each a steady turn that sways.

    Attributes
    ----------
    rate, start : (3,) [rad/s], [rad]
    sway, frequency, phase : (3, k) [rad], [rad/s], [rad]
    pauses : (m, 2) begin and end of each [s]
    """

    rate: Floats
    start: Floats
    sway: Floats
    frequency: Floats
    phase: Floats
    pauses: Floats

    @classmethod
    def drawn(cls, scenario: FieldScenario, rng: np.random.Generator) -> "_Motion":
        """Return a motion of the stated kind, with rates, swaying and start by chance."""
        rate = np.array(_RATES[scenario.motion])
        moving = (rate != 0).astype(np.float64)
        shape = (3, _SWAYS)
        begin = (np.arange(scenario.rests) + 0.5) * scenario.duration_s / max(scenario.rests, 1)
        pauses = np.column_stack([begin - scenario.rest_s / 2, begin + scenario.rest_s / 2])
        return cls(
            rate=rate * rng.uniform(0.9, 1.1, 3),
            start=rng.uniform(-np.pi, np.pi, 3),
            sway=_SWAY_RAD * rng.uniform(0.3, 1.0, shape) * moving[:, None],
            frequency=rng.uniform(0.3, 1.2, shape),
            phase=rng.uniform(-np.pi, np.pi, shape),
            pauses=pauses,
        )

    def moving(self, t_s: Floats) -> np.ndarray:
        """Return whether the hand moves, (n,)."""
        resting = (t_s[:, None] >= self.pauses[:, 0]) & (t_s[:, None] < self.pauses[:, 1])
        return np.logical_not(np.any(resting, axis=1))

    def attitude(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Return R_world_imu (n, 3, 3) and the angular rate in the body frame (n, 3) [rad/s]."""
        # Time stands still in a pause.
        went = t_s - sum((np.clip(t_s - low, 0, high - low) for low, high in self.pauses), np.zeros(len(t_s)))
        wave = self.frequency[:, :, None] * went + self.phase[:, :, None]
        a, b, c = self.start[:, None] + self.rate[:, None] * went + np.einsum("ak,akn->an", self.sway, np.sin(wave))
        da, db, dc = self.rate[:, None] + np.einsum("ak,ak,akn->an", self.sway, self.frequency, np.cos(wave))
        axes = np.eye(3)
        turns = [rotation_from_rotvec(angle[:, None] * axis) for angle, axis in zip((a, b, c), axes[::-1], strict=True)]
        rate = np.column_stack([
            dc - da * np.sin(b),
            db * np.cos(c) + da * np.cos(b) * np.sin(c),
            da * np.cos(b) * np.cos(c) - db * np.sin(c),
        ])  # fmt: skip
        return turns[0] @ turns[1] @ turns[2], rate * self.moving(t_s)[:, None]


def _field_world(scenario: FieldScenario) -> Floats:
    """Return the field in the world, x magnetic north and z up, (3,) [uT]."""
    dip = np.radians(scenario.dip_deg)
    return scenario.field * np.array([np.cos(dip), 0.0, -np.sin(dip)])


def _seen(motion: _Motion, t_s: Floats, world: Floats) -> Floats:
    return np.swapaxes(motion.attitude(t_s)[0], 1, 2) @ world


def _differences(scenario: FieldScenario, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Return by how much the field differs from that of the place, (n, 3) [uT]: a little everywhere, more near iron."""
    keep = np.exp(-1 / (scenario.rate_hz * scenario.inhomogeneity_s))
    drive = rng.standard_normal((len(t_s), 3)) * np.sqrt(1 - keep**2)
    drive[0] /= np.sqrt(1 - keep**2)
    from scipy.signal import lfilter

    wander = scenario.inhomogeneity * np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0), dtype=np.float64)
    for middle in rng.uniform(0, scenario.duration_s, scenario.disturbances):
        push = rng.standard_normal(3)
        near = np.maximum(1 - (2 * (t_s - middle) / scenario.disturbance_s) ** 2, 0.0)
        wander += scenario.disturbance * near[:, None] * push / np.linalg.norm(push)
    return wander


def _converter(scenario: FieldScenario) -> Converter:
    unit = Units.parse(scenario.units).magnetometer or "uT"
    return Converter.of(unit, MAGNETOMETER_UNITS_UT[unit], scenario.magnetometer_range, None)


def _sensor(scenario: FieldScenario, to_field: Converter, rng: np.random.Generator) -> ImuCalibration:
    """Return the sensor in body frame "accel-x"."""
    inertial = drawn_imu(replace(_LIKE, units=scenario.units), rng)
    assert inertial.accelerometer is not None
    inertial = rotate_imu(inertial, frame_rotation(inertial.accelerometer.sensitivity, "accel-x"))
    upper = np.triu(rng.uniform(-scenario.soft_iron, scenario.soft_iron, (3, 3)))
    soft = np.eye(3) + upper + np.triu(upper, k=1).T
    axis = rng.standard_normal(3)
    turn = rotation_from_rotvec(np.radians(scenario.misalignment_deg) * axis / np.linalg.norm(axis))
    hard = rng.uniform(-scenario.hard_iron, scenario.hard_iron, 3)
    magnetometer = MagnetometerCalibration(
        sensitivity=soft @ turn / to_field.unit_si,
        bias=to_field.zero + hard / to_field.unit_si,
        unit=to_field.unit,
        field_unit="uT",
    )
    return ImuCalibration(accelerometer=inertial.accelerometer, gyroscope=inertial.gyroscope, magnetometer=magnetometer)


def _warming(scenario: FieldScenario) -> TemperatureScenario:
    """Return a chip that warms up and cools again, and its thermometer."""
    return TemperatureScenario(
        rate_hz=scenario.rate_hz, start_degc=25.0, end_degc=25.0 + scenario.heating_k, back=True,
        time_constant_s=scenario.duration_s / 8, lag_s=scenario.lag_s, thermometer_rate_hz=10.0,
    )  # fmt: skip


def _changes(
    scenario: FieldScenario, degc: Floats, to_field: Converter, rng: np.random.Generator
) -> TemperatureDependence:
    """Return what the temperature does to offsets and scales, about its mean."""
    offset, scale = rng.standard_normal((2, 3)) * [
        [scenario.offset_drift / to_field.unit_si],
        [scenario.sensitivity_drift],
    ]
    return TemperatureDependence(
        reference_degc=float(degc.mean()),
        low_degc=float(degc.min()) - 1.0,
        high_degc=float(degc.max()) + 1.0,
        lag_s=scenario.lag_s,
        magnetometer_bias=offset[None] if scenario.offset_drift else None,
        magnetometer_sensitivity=np.diag(scale)[None] if scenario.sensitivity_drift else None,
    )


def _inertial(
    scenario: FieldScenario, motion: _Motion, imu: ImuCalibration, rng: np.random.Generator
) -> tuple[TriadSamples, TriadSamples]:
    """Return samples of accelerometer and gyroscope, none where there is no such sensor."""
    like = replace(_LIKE, units=scenario.units)
    to_force, to_rate = sensor_converters(like)
    t_s = np.arange(int(scenario.duration_s * scenario.imu_rate_hz)) / scenario.imu_rate_hz
    rotation, rate = motion.attitude(t_s)
    from scipy.signal import lfilter

    keep = np.exp(-1 / (0.3 * scenario.imu_rate_hz))
    shake = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], rng.standard_normal((len(t_s), 3)), axis=0)
    force = np.swapaxes(rotation, 1, 2) @ np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    force += scenario.hand_acceleration * np.asarray(shake) * motion.moving(t_s)[:, None]
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    assert accelerometer is not None and gyroscope is not None  # noqa: PT018
    white = np.sqrt(scenario.imu_rate_hz) * rng.standard_normal((2, len(t_s), 3))
    a = (force + like.accelerometer_noise_density * white[0]) @ accelerometer.sensitivity.T + accelerometer.bias
    w = (rate + like.gyroscope_noise_density * white[1]) @ gyroscope.sensitivity.T + gyroscope.bias
    return (
        _samples(t_s, to_force.digitise(a), to_force.unit, there=scenario.accelerometer),
        _samples(t_s, to_rate.digitise(w), to_rate.unit, there=scenario.gyroscope),
    )


def _samples(t_s: Floats, values: Floats, unit: str, *, there: bool = True) -> TriadSamples:
    count = len(t_s) if there else 0
    return TriadSamples(t_ns=np.rint(t_s[:count] * 1e9).astype(np.int64), values=values[:count], unit=unit)


def _truth(scenario: FieldScenario, seed: int, imu: ImuCalibration) -> Calibration:
    frame, magnetometer, gyroscope = "accel-x", imu.magnetometer, imu.gyroscope
    accelerometer: AccelerometerCalibration | None = imu.accelerometer
    if not scenario.accelerometer:
        assert magnetometer is not None
        frame, accelerometer, gyroscope = "mag-x", None, None
        imu = rotate_imu(imu, frame_rotation(magnetometer.sensitivity, "accel-x"))
        magnetometer = imu.magnetometer
    kept: GyroscopeCalibration | None = gyroscope if scenario.gyroscope else None
    return true_calibration(
        scenario,
        seed,
        imus={
            "imu0": ImuCalibration(
                accelerometer=accelerometer, gyroscope=kept, magnetometer=magnetometer, temperature=imu.temperature
            )
        },
        frame=frame,
        gravity_m_s2=STANDARD_GRAVITY_M_S2,
        assessment=Assessment(verdict="pass", findings=(), model="full" if scenario.soft_iron else "hard-iron"),
        also={"field": str(scenario.field), "dip_deg": str(scenario.dip_deg)},
    )
