"""The error terms of gyroscope and accelerometer (document B, section 4.1.2).

    e_g = S_g M_g C_bg' omega + B_g f + b_g - gyroscope,     e_a = S_a M_a f + b_a - accelerometer,

with the specific force f = R' (p'' - g), R = R_target_imu(t). Their derivatives: a change d of the rotation vector
turns the body by Jr d, so that df = [f]x Jr d - R' dg + R' dp''.

Where the three accelerometers do not sit at one point, e_a has the f that each of them feels at its place r_k,

    f_k + e_k' A r_k,   A = [alpha]x + [omega]x^2,   alpha = omega',

while the gyroscope's g-sensitivity acts on f at the body's origin.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...geometry.rigid_body import acceleration_by_place, along_axes
from ...geometry.so3 import skew
from ...models.pattern import DIAGONAL, FULL, LOWER
from ...recording import Floats, Integers
from .assembly import TRIAD, Columns
from .parameters import ImuParameters, Layout, Parameters
from .trajectory import POSE, Bases, Grid, Motion, Places, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadData:
    """Readings of one triad.

    Attributes
    ----------
    values : (n, 3) [m/s^2 or rad/s]
    used : (n,) bool, False where masked
    """

    values: Floats
    used: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InertialData:
    """Readings of one IMU that share their stamps.

    Attributes
    ----------
    imu : index of the IMU
    t_s : (n,) [s], ascending
    gyroscope, accelerometer : readings; None where the triad has other stamps
    """

    imu: int
    t_s: Floats
    gyroscope: TriadData | None
    accelerometer: TriadData | None


def triads(inertial: tuple[InertialData, ...]) -> Iterator[tuple[Floats, Floats]]:
    """Yield stamps (n,) [s] and readings (n, 3) of every triad."""
    for data in inertial:
        for triad in (data.gyroscope, data.accelerometer):
            if triad is not None:
                yield data.t_s, triad.values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InertialNoise:
    """Standard deviation of a single reading of gyroscope [rad/s] and accelerometer [m/s^2]."""

    gyroscope: float
    accelerometer: float


def on_grid(grid: Grid, data: InertialData) -> tuple[InertialData, Places]:
    """Return those readings that lie on a grid, and where."""
    places = grid.places(data.t_s)
    keep = places.inside
    return _some(data, keep), places.some(keep)


def _some(data: InertialData, which: np.ndarray | slice) -> InertialData:
    def of(triad: TriadData | None) -> TriadData | None:
        return None if triad is None else TriadData(values=triad.values[which], used=triad.used[which])

    return InertialData(
        imu=data.imu, t_s=data.t_s[which], gyroscope=of(data.gyroscope), accelerometer=of(data.accelerometer)
    )


def specific_force(motion: Motion, gravity: Floats) -> Floats:
    """Return the specific force in the IMU's frame, (n, 3) [m/s^2]."""
    return np.matmul((motion.acceleration - gravity)[:, None, :], motion.R)[:, 0, :]


def predicted(
    imu: ImuParameters, motion: Motion, force: Floats, biases: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return what gyroscope [rad/s] and accelerometer [m/s^2] read, (n, 3) each, by the model of chapter 4."""
    gyroscope = motion.omega @ imu.gyroscope_sensitivity.T + force @ imu.B_g.T + biases[0]
    if imu.lever_arms.any():
        force = force + along_axes(acceleration_by_place(motion.omega, motion.alpha), imu.places)
    return gyroscope, force @ imu.accelerometer_sensitivity.T + biases[1]


class InertialTerms:
    """Error terms of the readings of one IMU."""

    def __init__(
        self,
        data: InertialData,
        trajectory: Trajectory,
        parameters: Parameters,
        *,
        layout: Layout,
        columns: Columns,
        noise: InertialNoise,
        probe: int | None,
        seed: int,
    ) -> None:
        """Put readings on the grid of a trajectory.

        Parameters
        ----------
        data : readings; those outside of the trajectory are left out
        trajectory, parameters, layout : where to linearise
        columns : of the rows
        noise : standard deviations
        probe : right-hand side of the gyroscope's probe, the accelerometer's is the next; None for no probes
        seed : of the probes' random signs
        """
        self.data, self._places = on_grid(trajectory.grid, data)
        self._trajectory, self._parameters, self._layout = trajectory, parameters, layout
        self._columns, self._noise, self._probe = columns, noise, probe
        self._imu = parameters.imus[data.imu]
        self._rng = np.random.default_rng(seed)
        self._chi2 = [0.0, 0.0]

    @property
    def first(self) -> Integers:
        """First control point of the span of each reading, (n,)."""
        return self._places.first

    def rows(self, part: slice) -> Floats:
        """Return the rows of both triads, or of the one that has these stamps, (n, 6 or 3, w), of some readings."""
        trajectory, index = self._trajectory, self.data.imu
        places, data = self._places.some(part), _some(self.data, part)
        bases = Bases.at(places, trajectory.grid)
        motion = trajectory.motion(places, bases)
        force = specific_force(motion, self._parameters.gravity)
        at = _Readings(u=places.u, bases=bases, motion=motion, force=force)
        biases = trajectory.bias(places, index)
        triads = (data.gyroscope, data.accelerometer)
        rows = np.zeros((len(places.u), TRIAD * sum(triad is not None for triad in triads), self._columns.width))
        begin = 0
        for kind, triad in enumerate(triads):
            if triad is None:
                continue
            fill = (self._fill_gyroscope, self._fill_accelerometer)[kind]
            fill(rows[:, begin : begin + TRIAD], at, biases[kind], triad)
            begin += TRIAD
        return rows

    def chi2(self) -> tuple[float, float]:
        """Return the sum of squared whitened residuals of gyroscope and accelerometer that `rows` has met so far."""
        return self._chi2[0], self._chi2[1]

    def _fill_gyroscope(self, rows: Floats, at: "_Readings", bias: Floats, triad: TriadData) -> None:
        imu, motion = self._imu, at.motion
        K, B = imu.gyroscope_sensitivity, imu.B_g
        weight = triad.used / self._noise.gyroscope
        by_phi, by_rate = K @ motion.omega_by_phi, K @ motion.phi_jacobian
        by_acceleration: Floats | None = None
        if self._layout.get(f"imu{self.data.imu}.B_g") is not None or B.any():  # the specific force acts on it
            by_phi = by_phi + B @ (skew(at.force) @ motion.phi_jacobian)
            by_acceleration = B @ np.swapaxes(motion.R, 1, 2)
        residual = motion.omega @ K.T + at.force @ B.T + bias - triad.values
        turned = motion.omega @ imu.C_bg
        S, M = DIAGONAL.matrix(imu.S_g), LOWER.matrix(imu.M_g)
        own = {
            "S_g": lambda: DIAGONAL.product_jacobian(turned @ M.T),
            "M_g": lambda: S @ LOWER.product_jacobian(turned),
            "q_bg": lambda: (S @ M) @ skew(turned),
            "B_g": lambda: FULL.product_jacobian(at.force),
        }
        by = _By(phi=by_phi, rate=by_rate, acceleration=by_acceleration)
        self._fill_local(rows, at, by, residual, weight, kind=0)
        self._fill_border(rows, own, by_acceleration, weight)

    def _fill_accelerometer(self, rows: Floats, at: "_Readings", bias: Floats, triad: TriadData) -> None:
        imu, motion = self._imu, at.motion
        K = imu.accelerometer_sensitivity
        weight = triad.used / self._noise.accelerometer
        by_phi = K @ (skew(at.force) @ motion.phi_jacobian)
        by_acceleration = K @ np.swapaxes(motion.R, 1, 2)
        by = _By(phi=by_phi, acceleration=by_acceleration)
        S, M = DIAGONAL.matrix(imu.S_a), LOWER.matrix(imu.M_a)
        own: dict[str, Callable[[], Floats]] = {}
        felt = at.force
        if imu.lever_arms.any() or self._layout.get(f"imu{self.data.imu}.lever_arms") is not None:
            A = acceleration_by_place(motion.omega, motion.alpha)
            own["lever_arms"] = lambda: np.concatenate(
                [K[:, k, None] * A[:, None, k, :] for k in imu.other_axes], axis=2
            )
            if imu.lever_arms.any():
                felt = at.force + along_axes(A, imu.places)
                by = _with_lever_arms(by, imu, motion)
        residual = felt @ K.T + bias - triad.values
        own["S_a"] = lambda: DIAGONAL.product_jacobian(felt @ M.T)
        own["M_a"] = lambda: S @ LOWER.product_jacobian(felt)
        self._fill_local(rows, at, by, residual, weight, kind=1)
        self._fill_border(rows, own, by_acceleration, weight)

    def _fill_local(
        self,
        rows: Floats,
        at: "_Readings",
        by: "_By",
        residual: Floats,
        weight: Floats,
        *,
        kind: int,
    ) -> None:
        """Fill in the columns of pose, bias and right-hand sides; `kind` is 0 for the gyroscope, 1 for the other."""
        n, columns = len(weight), self._columns
        weighted = weight[:, None]
        pose = rows[:, :, : columns.pose].reshape(n, TRIAD, columns.order, POSE)  # a view
        bases = [(basis * weighted)[:, None, :, None] for basis in (at.bases.value, at.bases.rate)]
        np.multiply(bases[0], by.phi[:, :, None, :], out=pose[..., :3])
        if by.rate is not None:
            pose[..., :3] += bases[1] * by.rate[:, :, None, :]
        if by.acceleration is not None:
            basis = (at.bases.acceleration * weighted)[:, None, :, None]
            np.multiply(basis, by.acceleration[:, :, None, :], out=pose[..., 3:])
            if by.phi_acceleration is not None:
                pose[..., :3] += basis * by.phi_acceleration[:, :, None, :]
        for knot, share in enumerate((1 - at.u, at.u)):
            start = columns.bias(self.data.imu, knot).start + TRIAD * kind
            for i in range(TRIAD):
                rows[:, i, start + i] = share * weight
        whitened = residual * weighted
        self._chi2[kind] += float(np.vdot(whitened, whitened))
        np.negative(whitened, out=rows[:, :, columns.side])
        if self._probe is not None:
            signs = self._rng.integers(0, 2, (n, TRIAD)) * 2.0 - 1.0
            rows[:, :, columns.side + self._probe + kind] = signs * (weighted > 0)

    def _fill_border(
        self, rows: Floats, own: dict[str, Callable[[], Floats]], by_acceleration: Floats | None, weight: Floats
    ) -> None:
        """Fill in the border columns: those of the triad's own parameters, and gravity's."""
        parameters = self._parameters
        blocks = {f"imu{self.data.imu}.{name}": derivative for name, derivative in own.items()}
        if by_acceleration is not None:
            g, plane, direction = parameters.gravity_m_s2, parameters.gravity_plane, parameters.gravity_direction
            blocks["gravity.direction"] = lambda: by_acceleration @ (-g * plane)
            blocks["gravity.magnitude"] = lambda: by_acceleration @ -direction[:, None]
        start = self._columns.border
        for name, derivative in blocks.items():
            at = self._layout.get(name)
            if at is not None:
                rows[:, :, start + at.start : start + at.stop] = derivative() * weight[:, None, None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Readings:
    """What is the same for both triads at some stamps: place in the span, basis functions, motion, specific force."""

    u: Floats
    bases: Bases
    motion: Motion
    force: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _By:
    """Derivatives (n, 3, 3) by the rotation vector, its rate and acceleration, and the acceleration of the body."""

    phi: Floats
    rate: Floats | None = None
    phi_acceleration: Floats | None = None
    acceleration: Floats | None = None


def _with_lever_arms(by: _By, imu: ImuParameters, motion: Motion) -> _By:
    """Return the derivatives of the accelerometer with those of e_k' A r_k, which depends on omega and alpha."""
    K, places, omega = imu.accelerometer_sensitivity, imu.places, motion.omega
    by_alpha = K @ np.cross(places, np.eye(3))
    along = omega @ places.T
    by_omega = along[:, :, None] * np.eye(3) + omega[:, :, None] * places
    by_omega -= 2 * np.diag(places)[:, None] * omega[:, None, :]
    by_omega = K @ by_omega
    alpha_by = motion.alpha_jacobians()
    return _By(
        phi=by.phi + by_omega @ motion.omega_by_phi + by_alpha @ alpha_by[0],
        rate=by_omega @ motion.phi_jacobian + by_alpha @ alpha_by[1],
        phi_acceleration=by_alpha @ alpha_by[2],
        acceleration=by.acceleration,
    )
