"""Readings of gyroscopes and accelerometers, where they lie on the trajectory, and how many knots they support.

What an IMU feels where it sits, and how that changes with the motion of the body.

With R = R_imu_body and t the last column of T_imu_body, in the axes of the IMU, a sensor at r in its frame sits at
r - t from the body's origin, and

    omega_i = R omega,   alpha_i = R alpha,   f_i = R f + A (r - t),   A = [alpha_i]x + [omega_i]x^2.

Turning the pose by a small rotation d on the right changes each of R omega, R alpha and R f, v, by -[v]x R d.

A spline of order 6 follows motion up to about 1/4.5 of its knot rate within a hundredth of usual noise (measured: the
error falls from twenty sigmas at 2.5 knots a period to 0.01 at 4.5). Up to which frequency there is motion shows in the
spectrum of the IMU's readings above their floor of white noise. More knots cost no accuracy, but from half the IMU's
rate on they would follow its noise.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ....frozen import value_class
from ....geometry.rotation_vector import acceleration_by_place, along_axes, skew
from ....models.noise import ImuNoise
from ....recording import Floats
from ..layout import Status
from ..parameters import ImuParameters, RigParameters
from ..trajectory import MARGIN_S, Bases, KnotGrid, MotionState, Places, Trajectory


@value_class
class TriadData:
    """Readings of one triad.

    Attributes
    ----------
    values : (n, 3) [m/s^2 or rad/s]
    used : (n,) bool, False where masked
    """

    values: Floats
    used: np.ndarray


@value_class
class InertialData:
    """Readings of one IMU that share their timestamps.

    Attributes
    ----------
    imu : index of the IMU
    t_s : (n,) [s], ascending
    gyroscope, accelerometer : readings; None where the triad has other timestamps
    """

    imu: int
    t_s: Floats
    gyroscope: TriadData | None
    accelerometer: TriadData | None


def triad_readings(inertial: tuple[InertialData, ...]) -> Iterator[tuple[Floats, Floats]]:
    """Yield timestamps (n,) [s] and readings (n, 3) of every triad."""
    for data in inertial:
        for triad in (data.gyroscope, data.accelerometer):
            if triad is not None:
                yield data.t_s, triad.values


@value_class
class InertialNoise:
    """Standard deviation of a single reading of gyroscope [rad/s] and accelerometer [m/s^2]."""

    gyroscope: float
    accelerometer: float


@value_class
class ImuBeforehand:
    """What is known of an IMU's recording before anything is estimated.

    Attributes
    ----------
    name : such as "imu0"
    origin_ns : timestamp at which its seconds start, of its own clock [ns]
    rates_hz : sample rates of gyroscope and accelerometer
    nominal : noise as it was stated, or as consumer sensors have it
    stated : whether it was stated
    """

    name: str
    origin_ns: int
    rates_hz: tuple[float, float]
    nominal: ImuNoise
    stated: bool

    @property
    def noise(self) -> InertialNoise:
        """Standard deviation of single readings."""
        gyroscope, accelerometer = np.sqrt(self.rates_hz)
        return InertialNoise(
            gyroscope=self.nominal.gyroscope_noise_density * gyroscope,
            accelerometer=self.nominal.accelerometer_noise_density * accelerometer,
        )

    @property
    def walks(self) -> tuple[float, float]:
        """Random walk of the biases of gyroscope [rad/s/sqrt(s)] and accelerometer [m/s^2/sqrt(s)]."""
        return self.nominal.gyroscope_random_walk, self.nominal.accelerometer_random_walk


def body_clock_times(data: InertialData, imu: ImuParameters) -> Floats:
    """Return when the readings were taken, on the body's clock, (n,) [s].

    Readings of both triads are where the gyroscope is; `split_triads` comes first where the accelerometer has a shift.
    """
    shift_s = imu.shift_s(accelerometer=data.gyroscope is None)
    return data.t_s + shift_s if shift_s else data.t_s


def split_triads(data: InertialData) -> tuple[InertialData, ...]:
    """Return the readings of gyroscope and accelerometer one by one."""
    if data.gyroscope is None or data.accelerometer is None:
        return (data,)
    return replace(data, accelerometer=None), replace(data, gyroscope=None)


def on_grid(grid: KnotGrid, data: InertialData, imu: ImuParameters) -> tuple[InertialData, Places]:
    """Return those readings that lie on a grid, and where."""
    places = grid.places(body_clock_times(data, imu))
    keep = places.inside
    return some_readings(data, keep), places.some(keep)


def within_trajectory(grid: KnotGrid, data: InertialData, imu: ImuParameters, margin_s: float) -> InertialData:
    """Return those readings that stay in their segment of a grid while the clock moves by no more than a margin."""
    at = body_clock_times(data, imu)
    places = [grid.places(at + step) for step in (-margin_s, margin_s)]
    same = places[0].segment == places[1].segment
    return some_readings(data, places[0].inside & places[1].inside & same)


def on_trajectory(
    data: InertialData, parameters: RigParameters, status: Mapping[str, Status], grid: KnotGrid
) -> Iterator[InertialData]:
    """Yield readings, of clocks that are estimated those that stay on the trajectory while it comes out where.

    Were readings to enter and to leave it at its ends, the cost of two steps could not be compared.
    """
    imu = parameters.imus[data.imu]
    delayed = imu.accelerometer_shift_s != 0 or status[f"imu{data.imu}.accelerometer_shift"] != "fixed"
    for one in split_triads(data) if delayed else (data,):
        moves = data.imu > 0 or (delayed and one.gyroscope is None)
        yield within_trajectory(grid, one, imu, MARGIN_S / 2) if moves else one


def some_readings(data: InertialData, which: np.ndarray | slice) -> InertialData:
    """Return some of the readings."""

    def of(triad: TriadData | None) -> TriadData | None:
        return None if triad is None else TriadData(values=triad.values[which], used=triad.used[which])

    return InertialData(
        imu=data.imu, t_s=data.t_s[which], gyroscope=of(data.gyroscope), accelerometer=of(data.accelerometer)
    )


def specific_force(motion: MotionState, gravity: Floats) -> Floats:
    """Return the specific force at the body's origin, in the axes of the motion, (n, 3) [m/s^2]."""
    return np.matmul((motion.acceleration - gravity)[:, None, :], motion.R)[:, 0, :]


def motion_of_imu(trajectory: Trajectory, places: Places, bases: Bases, imu: ImuParameters) -> MotionState:
    """Return the motion of the body in the axes of an IMU."""
    motion = trajectory.motion(places, bases)
    return motion if imu.is_body else motion.turned(imu.R_imu_body)


def origin_places(imu: ImuParameters) -> Floats:
    """Return three times where an IMU's origin is from the body's, in the IMU's axes, (3, 3), a row each [m]."""
    return np.tile(-imu.p_imu_body, (3, 1))


def accelerometer_places(imu: ImuParameters) -> Floats:
    """Return where an IMU's accelerometers are from the body's origin, in the IMU's axes, (3, 3), a row each [m]."""
    return imu.places - imu.p_imu_body


def predict_imu(
    imu: ImuParameters, motion: MotionState, force: Floats, biases: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return what gyroscope [rad/s] and accelerometer [m/s^2] read, (n, 3) each, by the model of chapter 4.

    Parameters
    ----------
    motion, force : of the body, in the axes of the IMU
    biases : (n, 3) of gyroscope and accelerometer
    """
    at_origin, at_sensors = force, force
    if imu.places.any() or imu.p_imu_body.any():
        A = acceleration_by_place(motion.omega, motion.alpha)
        at_sensors = force + along_axes(A, accelerometer_places(imu))
        if imu.p_imu_body.any():
            at_origin = force + along_axes(A, origin_places(imu))
    gyroscope = motion.omega @ imu.gyroscope_sensitivity.T + at_origin @ imu.B_g.T + biases[0]
    return gyroscope, at_sensors @ imu.accelerometer_sensitivity.T + biases[1]


def predicted_readings(trajectory: Trajectory, parameters: RigParameters, data: InertialData) -> tuple[Floats, Floats]:
    """Return what gyroscope and accelerometer should read at the timestamps of some readings, (n, 3) each.

    Of a triad that does not have these timestamps they mean nothing; outside of the trajectory they are nan.
    """
    imu = parameters.imus[data.imu]
    whole = np.full((2, len(data.t_s), 3), np.nan)
    for which in (0, 1) if imu.accelerometer_shift_s and data.gyroscope is not None else (None,):
        t_s = body_clock_times(data, imu) + (imu.accelerometer_shift_s if which == 1 else 0.0)
        places = trajectory.grid.places(t_s)
        inside = places.inside
        places = places.some(inside)
        motion = motion_of_imu(trajectory, places, Bases.at(places, trajectory.grid), imu)
        force = specific_force(motion, parameters.gravity)
        found = predict_imu(imu, motion, force, trajectory.bias(places, data.imu))
        for kind in (0, 1) if which is None else (which,):
            whole[kind, inside] = found[kind]
    return whole[0], whole[1]


@value_class
class ForceJacobian:
    """Derivatives (n, 3, 3) by the rotation vector, its rate and acceleration, and the acceleration of the body."""

    phi: Floats
    rate: Floats | None = None
    phi_acceleration: Floats | None = None
    acceleration: Floats | None = None

    def scaled(self, matrix: Floats) -> "ForceJacobian":
        """Return the derivatives of matrix @ v, (3, 3)."""
        return ForceJacobian(
            phi=matrix @ self.phi,
            rate=None if self.rate is None else matrix @ self.rate,
            phi_acceleration=None if self.phi_acceleration is None else matrix @ self.phi_acceleration,
            acceleration=None if self.acceleration is None else matrix @ self.acceleration,
        )

    def plus(self, other: "ForceJacobian") -> "ForceJacobian":
        """Return the derivatives of a sum."""
        return ForceJacobian(
            phi=self.phi + other.phi,
            rate=_sum(self.rate, other.rate),
            phi_acceleration=_sum(self.phi_acceleration, other.phi_acceleration),
            acceleration=_sum(self.acceleration, other.acceleration),
        )


def _sum(one: Floats | None, other: Floats | None) -> Floats | None:
    if one is None or other is None:
        return other if one is None else one
    return one + other


def at_origin(motion: MotionState, force: Floats) -> ForceJacobian:
    """Return the derivatives of the specific force at the body's origin."""
    return ForceJacobian(phi=skew(force) @ motion.phi_jacobian, acceleration=np.swapaxes(motion.R, 1, 2))


def at_places(motion: MotionState, force: Floats, places: Floats) -> ForceJacobian:
    """Return the derivatives of f_k + e_k' A r_k, which depends on omega and alpha, with r_k the rows of (3, 3)."""
    by_omega, by_alpha = _along(motion.omega, places)
    alpha_by = motion.alpha_jacobians()
    by = at_origin(motion, force)
    return ForceJacobian(
        phi=by.phi + by_omega @ motion.omega_by_phi + by_alpha @ alpha_by[0],
        rate=by_omega @ motion.phi_jacobian + by_alpha @ alpha_by[1],
        phi_acceleration=by_alpha @ alpha_by[2],
        acceleration=by.acceleration,
    )


def jacobian_by_imu_rotation(motion: MotionState, force: Floats, places: Floats) -> Floats:
    """Return the derivative (n, 3, 3) of f_k + e_k' A r_k by a small turn of omega, alpha and f against the places."""
    by_omega, by_alpha = _along(motion.omega, places)
    return -(skew(force) + by_omega @ skew(motion.omega) + by_alpha @ skew(motion.alpha))


def _along(omega: Floats, places: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives of e_k' A r_k by omega, (n, 3, 3), and by alpha, (3, 3)."""
    along = omega @ places.T
    by_omega = along[:, :, None] * np.eye(3) + omega[:, :, None] * places
    by_omega -= 2 * np.diag(places)[:, None] * omega[:, None, :]
    return by_omega, np.cross(places, np.eye(3))


KNOTS_PER_PERIOD = 4.5
DEFAULT_PER_S = 50.0
LARGEST_SHARE = 0.5
"""Knots per IMU sample that the IMU supports at most."""

_PREFERRED_SHARE = 1 / 3
_WINDOW_S = 2.56
_EXCESS = 0.03
"""Share of the noise that motion above the limit may add."""


def knots_per_s(*signals: tuple[Floats, Floats], rate_hz: float | None = None) -> float:
    """Return the knots per second for the motion in an IMU's signals.

    Parameters
    ----------
    signals : timestamps (n,) [s] and readings (n, 3) of each triad
    rate_hz : sample rate that supports the knots; that of the slowest signal where it is not given
    """
    rates = [1 / float(np.median(steps[steps > 0])) for steps in (np.diff(t_s) for t_s, _ in signals)]
    highest = max(motion_limit_hz(t_s, values, rate) for (t_s, values), rate in zip(signals, rates, strict=True))
    rate = rate_hz or min(rates)  # the slower triad must not be followed into its noise
    wanted = max(KNOTS_PER_PERIOD * highest, min(DEFAULT_PER_S, _PREFERRED_SHARE * rate))
    return float(np.clip(5 * np.ceil(wanted / 5 - 1e-9), 5.0, LARGEST_SHARE * rate))


def motion_limit_hz(t_s: Floats, values: Floats, rate_hz: float) -> float:
    """Return the frequency above which a signal (n, 3) holds no more than its noise [Hz]."""
    frequency, power = power_spectrum(t_s, values, rate_hz)
    floor = float(np.median(power[len(power) * 3 // 4 :]))
    excess = np.cumsum((power - floor)[::-1])[::-1]
    beyond = np.flatnonzero(excess > _EXCESS * floor * len(power))
    return float(frequency[min(beyond[-1] + 1, len(frequency) - 1)]) if len(beyond) else 0.0


def power_spectrum(t_s: Floats, values: Floats, rate_hz: float) -> tuple[Floats, Floats]:
    """Return frequencies (f,) [Hz] and the mean power spectral density (f,) of the three axes [unit^2/Hz]."""
    uniform = np.arange(t_s[0], t_s[-1], 1 / rate_hz)
    signal = np.stack([np.interp(uniform, t_s, values[:, i]) for i in range(3)], axis=1)
    size = max(16, min(len(signal), 2 ** round(np.log2(_WINDOW_S * rate_hz))))
    starts = np.arange(0, max(len(signal) - size, 0) + 1, size // 2)
    window = np.hanning(size)[:, None]
    power = np.zeros(size // 2 + 1)
    for start in starts:
        part = signal[start : start + size]
        if len(part) < size:
            break
        trend = np.linspace(0, 1, size)[:, None]
        part = part - part[:1] - trend * (part[-1:] - part[:1])
        part = part - part.mean(axis=0)
        power += (np.abs(np.fft.rfft(part * window, axis=0)) ** 2).mean(axis=1)
    power *= 2 / (rate_hz * float((window**2).sum()) * max(len(starts), 1))
    return np.asarray(np.fft.rfftfreq(size, 1 / rate_hz)[1:], dtype=np.float64), power[1:]
