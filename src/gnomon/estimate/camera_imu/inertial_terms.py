"""The error terms of gyroscope and accelerometer (document B, section 4.1.2).

    e_g = S_g M_g C_bg' omega + B_g f + b_g - gyroscope,     e_a = S_a M_a f + b_a - accelerometer,

with the specific force f = R' (p'' - g), R = R_target_imu(t). Their derivatives: a change d of the rotation vector
turns the body by Jr d, so that df = [f]x Jr d - R' dg + R' dp''.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...geometry.so3 import skew
from ...models.pattern import DIAGONAL, FULL, LOWER
from ...recording import Floats, Integers
from .assembly import TRIAD, RowShape
from .parameters import ImuParameters, Layout, Parameters
from .trajectory import BIAS, POSE, Bases, Grid, Motion, Places, Trajectory


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
    return gyroscope, force @ imu.accelerometer_sensitivity.T + biases[1]


class InertialTerms:
    """Error terms of the readings of one IMU."""

    def __init__(
        self,
        data: InertialData,
        trajectory: Trajectory,
        parameters: Parameters,
        layout: Layout,
        noise: InertialNoise,
        *,
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
        self.data, self._places = on_grid(trajectory.grid, data)
        self._trajectory, self._parameters, self._layout = trajectory, parameters, layout
        self._noise = noise
        self._imu = parameters.imus[data.imu]
        self._rng = np.random.default_rng(seed)
        order = trajectory.grid.order
        self._gyroscope = RowShape(
            order=order,
            bias=BIAS * data.imu,
            border=self._border(("S_g", "M_g", "q_bg", "B_g"), feels_force=self._gyroscope_feels_force()),
            probe=probe,
        )
        self._accelerometer = RowShape(
            order=order,
            bias=BIAS * data.imu + TRIAD,
            border=self._border(("S_a", "M_a"), feels_force=True),
            probe=None if probe is None else probe + 1,
        )

    @property
    def first(self) -> Integers:
        """First control point of the span of each reading, (n,)."""
        return self._places.first

    def rows(self, part: slice) -> Iterator[tuple[str, Floats, RowShape]]:
        """Yield the rows of gyroscope and accelerometer, (n, 3, w), of some readings."""
        trajectory, index = self._trajectory, self.data.imu
        places, data = self._places.some(part), _some(self.data, part)
        bases = Bases.at(places, trajectory.grid)
        at = _Readings(
            u=places.u,
            bases=bases,
            motion=(motion := trajectory.motion(places, bases)),
            force=specific_force(motion, self._parameters.gravity),
        )
        biases = trajectory.bias(places, index)
        if data.gyroscope is not None:
            rows = self._gyroscope_rows(at, biases[0], data.gyroscope)
            yield f"imu{index}.gyroscope", rows, self._gyroscope
        if data.accelerometer is not None:
            rows = self._accelerometer_rows(at, biases[1], data.accelerometer)
            yield f"imu{index}.accelerometer", rows, self._accelerometer

    def _gyroscope_feels_force(self) -> bool:
        return self._layout.get(f"imu{self.data.imu}.B_g") is not None or bool(self._imu.B_g.any())

    def _border(self, own: tuple[str, ...], *, feels_force: bool) -> Integers:
        """Return the border columns that a triad touches: its own, and gravity's if it feels the specific force."""
        names = ["gravity.direction", "gravity.magnitude"] if feels_force else []
        names += [f"imu{self.data.imu}.{name}" for name in own]
        found = [np.arange(s.start, s.stop) for name in names if (s := self._layout.get(name)) is not None]
        return np.concatenate(found) if found else np.empty(0, np.int64)

    def _gyroscope_rows(self, at: "_Readings", bias: Floats, triad: TriadData) -> Floats:
        imu, motion = self._imu, at.motion
        K, B = imu.gyroscope_sensitivity, imu.B_g
        weight = triad.used / self._noise.gyroscope
        by_phi, by_rate = K @ motion.omega_by_phi, K @ motion.phi_jacobian
        by_acceleration: Floats | None = None
        if self._gyroscope_feels_force():
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
        rows = self._local_rows(at, (by_phi, by_rate, by_acceleration), residual, weight, self._gyroscope)
        return self._with_border(rows, own, by_acceleration, weight, self._gyroscope)

    def _accelerometer_rows(self, at: "_Readings", bias: Floats, triad: TriadData) -> Floats:
        imu, motion = self._imu, at.motion
        K = imu.accelerometer_sensitivity
        weight = triad.used / self._noise.accelerometer
        by_phi = K @ (skew(at.force) @ motion.phi_jacobian)
        by_acceleration = K @ np.swapaxes(motion.R, 1, 2)
        residual = at.force @ K.T + bias - triad.values
        S, M = DIAGONAL.matrix(imu.S_a), LOWER.matrix(imu.M_a)
        own = {
            "S_a": lambda: DIAGONAL.product_jacobian(at.force @ M.T),
            "M_a": lambda: S @ LOWER.product_jacobian(at.force),
        }
        rows = self._local_rows(at, (by_phi, None, by_acceleration), residual, weight, self._accelerometer)
        return self._with_border(rows, own, by_acceleration, weight, self._accelerometer)

    def _local_rows(
        self,
        at: "_Readings",
        by: tuple[Floats, Floats | None, Floats | None],
        residual: Floats,
        weight: Floats,
        shape: RowShape,
    ) -> Floats:
        """Return whitened rows (n, 3, w) without their border columns.

        `by` holds the derivatives by rotation vector, its rate, and the acceleration of the body, (n, 3, 3) each.
        """
        n = len(weight)
        rows = np.zeros((n, 3, shape.width))
        weighted = weight[:, None]
        pose = rows[:, :, : shape.pose].reshape(n, 3, shape.order, POSE)  # a view
        bases = [(basis * weighted)[:, None, :, None] for basis in (at.bases.value, at.bases.rate)]
        by_phi, by_rate, by_acceleration = by
        np.multiply(bases[0], by_phi[:, :, None, :], out=pose[..., :3])
        if by_rate is not None:
            pose[..., :3] += bases[1] * by_rate[:, :, None, :]
        if by_acceleration is not None:
            basis = (at.bases.acceleration * weighted)[:, None, :, None]
            np.multiply(basis, by_acceleration[:, :, None, :], out=pose[..., 3:])
        start = shape.pose
        for i in range(TRIAD):
            rows[:, i, start + i] = (1 - at.u) * weight
            rows[:, i, start + TRIAD + i] = at.u * weight
        np.multiply(residual, weighted, out=rows[:, :, shape.residual])
        if shape.probe is not None:
            signs = self._rng.integers(0, 2, (n, 3)) * 2.0 - 1.0
            rows[:, :, shape.residual + 1] = signs * (weighted > 0)
        return rows

    def _with_border(
        self,
        rows: Floats,
        own: dict[str, Callable[[], Floats]],
        by_acceleration: Floats | None,
        weight: Floats,
        shape: RowShape,
    ) -> Floats:
        """Fill in the border columns: those of the triad's own parameters, and gravity's."""
        parameters = self._parameters
        blocks = {f"imu{self.data.imu}.{name}": derivative for name, derivative in own.items()}
        if by_acceleration is not None:
            g, plane, direction = parameters.gravity_m_s2, parameters.gravity_plane, parameters.gravity_direction
            blocks["gravity.direction"] = lambda: by_acceleration @ (-g * plane)
            blocks["gravity.magnitude"] = lambda: by_acceleration @ -direction[:, None]
        place = {int(column): shape.border_columns.start + i for i, column in enumerate(shape.border)}
        for name, derivative in blocks.items():
            columns = self._layout.get(name)
            if columns is not None:
                begin = place[columns.start]
                rows[:, :, begin : begin + columns.stop - columns.start] = derivative() * weight[:, None, None]
        return rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Readings:
    """What is the same for both triads at some stamps: place in the span, basis functions, motion, specific force."""

    u: Floats
    bases: Bases
    motion: Motion
    force: Floats
