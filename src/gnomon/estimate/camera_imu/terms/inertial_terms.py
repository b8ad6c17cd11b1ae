"""Readings of gyroscopes and accelerometers, and their error terms (Krebs, section 4.1.2).

    e_g = S_g M_g C_bg' omega + B_g f + b_g - gyroscope,     e_a = S_a M_a f + b_a - accelerometer,

with the specific force f = R' (p'' - g), R = R_target_imu(t). Where the three accelerometers do not sit at one point,
e_a has the f that each of them feels at its place r_k,

    f_k + e_k' A r_k,   A = [alpha]x + [omega]x^2,   alpha = omega',

while the gyroscope's g-sensitivity acts on f at the IMU's origin. An IMU beside the first has omega, alpha and f in its
own axes: with R = R_imu_body and t the last column of T_imu_body, a sensor at r in its frame sits at r - t from the
body's origin, and

    omega_i = R omega,   alpha_i = R alpha,   f_i = R f + A (r - t),   A = [alpha_i]x + [omega_i]x^2.

How many knots readings support: a spline of order 6 follows motion up to about 1/4.5 of its knot rate within a
hundredth of usual noise (measured: the error falls from twenty sigmas at 2.5 knots a period to 0.01 at 4.5). Up to
which frequency there is motion shows in the spectrum of the readings above their floor of white noise. More knots cost
no accuracy, but from half the IMU's rate on they would follow its noise.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import acceleration_by_place, along_axes
from ....kernel import library
from ....models.forms import LOWER
from ....recording import Floats, Integers
from ....recording.samples import ImuNoise
from ..layout import BorderLayout, Status
from ..parameters import ImuParameters, RigParameters
from ..trajectory import BIAS, MARGIN_S, POSE, Bases, KnotGrid, MotionState, Places, Trajectory, basis_polynomials
from .assembly import TRIAD, Columns
from .inertial_rows import InertialRows

KNOTS_PER_PERIOD = 4.5
DEFAULT_PER_S = 50.0
LARGEST_SHARE = 0.5
"""Knots per IMU sample that the IMU supports at most."""

_PREFERRED_SHARE = 1 / 3
_WINDOW_S = 2.56
_EXCESS = 0.03
"""Share of the noise that motion above the limit may add."""

_DRAWN = 128  # spans whose signs are drawn together


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
        at_sensors = force + along_axes(A, imu.accelerometer_places)
        if imu.p_imu_body.any():
            at_origin = force + along_axes(A, imu.origin_places)
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
        motion = trajectory.motion(places, Bases.at(places, trajectory.grid))
        motion = motion if imu.is_body else motion.turned(imu.R_imu_body)
        found = predict_imu(imu, motion, motion.specific_force(parameters.gravity), trajectory.bias(places, data.imu))
        for kind in (0, 1) if which is None else (which,):
            whole[kind, inside] = found[kind]
    return whole[0], whole[1]


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


class InertialTerms:
    """Error terms of the readings of one IMU."""

    def __init__(
        self,
        data: InertialData,
        trajectory: Trajectory,
        parameters: RigParameters,
        *,
        layout: BorderLayout,
        noise: InertialNoise,
        probe: int | None,
        seed: int,
    ) -> None:
        """Put readings on the grid of a trajectory.

        Parameters
        ----------
        data : readings; those outside of the trajectory are left out
        trajectory, parameters, layout : where to linearise
        noise : standard deviations
        probe : right-hand side of the gyroscope's probe, the accelerometer's is the next; None for no probes
        seed : of the probes' random signs
        """
        self.data, self._places = on_grid(trajectory.grid, data, parameters.imus[data.imu])
        self._trajectory, self._parameters, self._noise = trajectory, parameters, noise
        mine = ("gravity.", f"imu{data.imu}.")
        probes = () if probe is None else (probe, probe + 1)
        self.columns = Columns.of(
            layout, trajectory.grid.order, lambda name: name.startswith(mine), imu=data.imu, probes=probes
        )
        self._imu = parameters.imus[data.imu]
        self._signs = None if probe is None else self._drawn_signs(np.random.default_rng(seed))
        self._chi2 = [0.0, 0.0]

    @property
    def first(self) -> Integers:
        """First control point of the span of each reading, (n,)."""
        return self._places.first

    @property
    def height(self) -> int:
        """Number of rows of each reading."""
        return TRIAD * sum(triad is not None for triad in (self.data.gyroscope, self.data.accelerometer))

    def _drawn_signs(self, rng: np.random.Generator) -> Floats:
        """Return random signs (n, 6 or 3); those of a beginning do not depend on how long the recording is."""
        signs = np.empty((len(self.first), self.height))
        edges = np.searchsorted(self.first, np.arange(0, self._trajectory.grid.controls + _DRAWN, _DRAWN))
        for begin, end in pairwise(edges.tolist()):
            for start in range(0, self.height, TRIAD):
                signs[begin:end, start : start + TRIAD] = rng.integers(0, 2, (end - begin, TRIAD)) * 2.0 - 1.0
        return signs

    def rows(self, part: slice) -> Floats:
        """Return the rows of both triads, or of the one that has these timestamps, (n, 6 or 3, w), of some readings."""
        if library.load_kernel() is not None:
            rows, chi2 = library.inertial_rows(self._readings(part), self.columns.width)
            self._count(chi2)
            return rows
        at = InertialRows(self._trajectory, self._parameters, self.data.imu, self.columns, self._places.some(part))
        triads = self._weighed(some_readings(self.data, part))
        rows = at.filled(triads)
        self._count(at.chi2)
        if self._signs is not None:
            for number, kind in enumerate(kind for kind, triad in enumerate(triads) if triad is not None):
                own = slice(TRIAD * number, TRIAD * (number + 1))
                used = (self.data.gyroscope, self.data.accelerometer)[kind]
                assert used is not None
                rows[:, own, self.columns.side + 1 + kind] = self._signs[part, own] * used.used[part, None]
        return rows

    def add_to(self, band: library.Band) -> Floats | None:
        """Add the products of all rows by the compiled kernel, and return those of the columns from the border on."""
        if self.columns.width > library.MOST_INERTIAL:
            return None
        products, chi2 = library.add_inertial_sums(self._readings(slice(None)), self.columns.width, band)
        self._count(chi2)
        return products

    def _count(self, chi2: Floats) -> None:
        self._chi2 = [before + more for before, more in zip(self._chi2, chi2.tolist(), strict=True)]

    def _readings(self, part: slice) -> library.Readings:
        """Return some readings as the compiled kernel takes them."""
        places, data = self._places.some(part), some_readings(self.data, part)
        trajectory, grid, own = self._trajectory, self._trajectory.grid, self.columns.own
        found = (own.get(name, own.get(f"imu{self.data.imu}.{name}")) for name in library.BLOCKS[:-1])
        gyroscope, accelerometer = self._weighed(data)
        return library.Readings(
            places=(places.first, places.u, places.segment),
            references=grid.references(),
            bases=np.stack([basis_polynomials(grid.order, d) / grid.spacing_s**d for d in range(4)]),
            controls=trajectory.controls,
            bias_at=POSE + BIAS * self.data.imu,
            bias_offset=grid.bias_offset,
            spacing_s=grid.spacing_s,
            imu=self._packed(),
            blocks=[*(-1 if at is None else at.start for at in found), self.columns.side],
            gyroscope=gyroscope,
            accelerometer=accelerometer,
            signs=None if self._signs is None else self._signs[part],
        )

    def _weighed(self, data: InertialData) -> list[tuple[Floats, Floats] | None]:
        """Return readings (n, 3) and weights (n,) of gyroscope and accelerometer, of those that have these times."""
        sigmas = (self._noise.gyroscope, self._noise.accelerometer)
        return [
            None if triad is None else (triad.values, triad.used / sigma)
            for triad, sigma in zip((data.gyroscope, data.accelerometer), sigmas, strict=True)
        ]

    def _packed(self) -> Floats:
        """Return what the kernel needs of the IMU and of gravity, in its order (Imu in kernel.c)."""
        imu, gravity = self._imu, self._parameters
        parts = (
            *(imu.gyroscope_sensitivity, imu.B_g, imu.C_bg, imu.S_g, LOWER.matrix(imu.M_g)),
            *(imu.accelerometer_sensitivity, imu.S_a, LOWER.matrix(imu.M_a), imu.R_imu_body),
            *(imu.origin_places, imu.accelerometer_places, imu.places_by_arms, gravity.gravity),
            *(-gravity.gravity_m_s2 * gravity.gravity_plane, -gravity.gravity_direction),
        )
        return np.concatenate([np.ravel(part) for part in parts])

    def chi2(self) -> tuple[float, float]:
        """Return the sum of squared whitened residuals of gyroscope and accelerometer that `rows` has met so far."""
        return self._chi2[0], self._chi2[1]
