"""The rows of readings in the normal equations, in NumPy: where there is no compiled kernel, which makes the same.

The residuals are those of `inertial_terms`. A change d of the rotation vector turns the body by Jr d, so that
df = [f]x Jr d - R' dg + R' dp''. Turning the pose by a small rotation d on the right changes each of R omega, R alpha
and R f, v, by -[v]x R d, with R = R_imu_body. The clock of an IMU, t_body = t_imu + d, moves the readings along the
trajectory: de/dd is the derivative of e by time, that by the control points times theirs.
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import acceleration_by_place, along_axes, skew
from ....models.forms import DIAGONAL, FULL, LOWER
from ....recording import Floats
from ..parameters import RigParameters
from ..trajectory import POSE, Bases, MotionState, Places, Trajectory
from .assembly import TRIAD, Columns

_Columns = dict[str, Callable[[], Floats]]
"""Block of an IMU -> its columns (n, 3, k)."""


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


class InertialRows:
    """Rows of the readings of one IMU at some timestamps.

    Attributes
    ----------
    chi2 : sum of squared whitened residuals of gyroscope and accelerometer that `filled` has met
    """

    def __init__(
        self, trajectory: Trajectory, parameters: RigParameters, index: int, columns: Columns, places: Places
    ) -> None:
        """Take what is the same for both triads: the motion in the IMU's axes, and the specific force at its origin.

        Parameters
        ----------
        trajectory, parameters, places : where to linearise
        index : of the IMU
        columns : of the rows
        """
        self._trajectory, self._parameters, self._columns = trajectory, parameters, columns
        self._index, self._imu, self._places = index, parameters.imus[index], places
        imu = self._imu
        self._bases = Bases.at(places, trajectory.grid)
        motion = trajectory.motion(places, self._bases)
        self._motion = motion if imu.is_body else motion.turned(imu.R_imu_body)
        self._force = self._motion.specific_force(parameters.gravity)
        self.chi2 = np.zeros(2)

    def filled(self, triads: Sequence[tuple[Floats, Floats] | None]) -> Floats:
        """Return the rows (n, 6 or 3, w).

        Parameters
        ----------
        triads : readings (n, 3) and weights (n,) of gyroscope and accelerometer; None where it has other timestamps
        """
        biases = self._trajectory.bias(self._places, self._index)
        height = TRIAD * sum(triad is not None for triad in triads)
        rows = np.zeros((len(self._places.u), height, self._columns.width))
        begin = 0
        for kind, triad in enumerate(triads):
            if triad is not None:
                fill = (self._fill_gyroscope, self._fill_accelerometer)[kind]
                fill(rows[:, begin : begin + TRIAD], biases[kind], *triad)
                begin += TRIAD
        return rows

    @cached_property
    def _A(self) -> Floats:
        """[alpha]x + [omega]x^2, (n, 3, 3): needed where something is away from the body's origin."""
        return acceleration_by_place(self._motion.omega, self._motion.alpha)

    def _fill_gyroscope(self, rows: Floats, bias: Floats, values: Floats, weight: Floats) -> None:
        imu, motion, places = self._imu, self._motion, self._imu.origin_places
        K, B = imu.gyroscope_sensitivity, imu.B_g
        force, by = self._force, ForceJacobian(phi=K @ motion.omega_by_phi, rate=K @ motion.phi_jacobian)
        if f"imu{self._index}.B_g" in self._columns.own or B.any():  # the specific force acts on it
            force, by_force = self._felt(places)
            by = by.plus(by_force.scaled(B))
        residual = motion.omega @ K.T + force @ B.T + bias - values
        turned = motion.omega @ imu.C_bg
        S, M = DIAGONAL.matrix(imu.S_g), LOWER.matrix(imu.M_g)
        own: _Columns = {
            "S_g": lambda: DIAGONAL.product_jacobian(turned @ M.T),
            "M_g": lambda: S @ LOWER.product_jacobian(turned),
            "q_bg": lambda: (S @ M) @ skew(turned),
            "B_g": lambda: FULL.product_jacobian(force),
            "T_imu_body.rotation": lambda: (
                (B @ jacobian_by_imu_rotation(motion, self._force, places) - K @ skew(motion.omega)) @ imu.R_imu_body
            ),
            "T_imu_body.translation": lambda: -B @ self._A,
            "time_shift": lambda: self._by_time(by, kind=0),
        }
        self._fill_local(rows, by, residual, weight, kind=0)
        self._fill_border(rows, own, by.acceleration, weight)

    def _fill_accelerometer(self, rows: Floats, bias: Floats, values: Floats, weight: Floats) -> None:
        imu, motion, places = self._imu, self._motion, self._imu.accelerometer_places
        K = imu.accelerometer_sensitivity
        felt, by_felt = self._felt(places)
        by = by_felt.scaled(K)
        residual = felt @ K.T + bias - values
        S, M = DIAGONAL.matrix(imu.S_a), LOWER.matrix(imu.M_a)
        own: _Columns = {
            "S_a": lambda: DIAGONAL.product_jacobian(felt @ M.T),
            "M_a": lambda: S @ LOWER.product_jacobian(felt),
            "lever_arms": lambda: K @ np.einsum("nkj,kjm->nkm", self._A, imu.places_by_arms),
            "T_imu_body.rotation": lambda: K @ jacobian_by_imu_rotation(motion, self._force, places) @ imu.R_imu_body,
            "T_imu_body.translation": lambda: -K @ self._A,
            "time_shift": lambda: self._by_time(by, kind=1),
            "accelerometer_shift": lambda: self._by_time(by, kind=1),
        }
        self._fill_local(rows, by, residual, weight, kind=1)
        self._fill_border(rows, own, by.acceleration, weight)

    def _by_time(self, by: ForceJacobian, *, kind: int) -> Floats:
        """Return the derivative of the residual by time, (n, 3, 1)."""
        motion, jerk = self._motion, self._trajectory.jerk(self._places)
        found = np.zeros((len(jerk), TRIAD, 1))
        for matrix, rate in (
            (by.phi, motion.phi_rate),
            (by.rate, motion.phi_acceleration),
            (by.phi_acceleration, jerk[:, :3]),
            (by.acceleration, jerk[:, 3:]),
        ):
            if matrix is not None:
                found += matrix @ rate[:, :, None]
        found[:, :, 0] += self._trajectory.bias_rate(self._places, self._index)[kind]
        return found

    def _fill_local(
        self,
        rows: Floats,
        by: ForceJacobian,
        residual: Floats,
        weight: Floats,
        *,
        kind: int,
    ) -> None:
        """Fill in the columns of pose, bias and right-hand sides; `kind` is 0 for the gyroscope, 1 for the other."""
        n, columns = len(weight), self._columns
        weighted = weight[:, None]
        pose = rows[:, :, : columns.pose].reshape(n, TRIAD, columns.order, POSE)  # a view
        bases = [(basis * weighted)[:, None, :, None] for basis in (self._bases.value, self._bases.rate)]
        np.multiply(bases[0], by.phi[:, :, None, :], out=pose[..., :3])
        if by.rate is not None:
            pose[..., :3] += bases[1] * by.rate[:, :, None, :]
        if by.acceleration is not None:
            basis = (self._bases.acceleration * weighted)[:, None, :, None]
            np.multiply(basis, by.acceleration[:, :, None, :], out=pose[..., 3:])
            if by.phi_acceleration is not None:
                pose[..., :3] += basis * by.phi_acceleration[:, :, None, :]
        for knot, share in enumerate((1 - self._places.u, self._places.u)):
            start = columns.bias(knot).start + TRIAD * kind
            for i in range(TRIAD):
                rows[:, i, start + i] = share * weight
        whitened = residual * weighted
        self.chi2[kind] += float(np.vdot(whitened, whitened))
        rows[:, :, columns.side] = -whitened

    def _fill_border(self, rows: Floats, own: _Columns, by_acceleration: Floats | None, weight: Floats) -> None:
        """Fill in the border columns: those of the triad's own parameters, and gravity's."""
        parameters = self._parameters
        blocks = {f"imu{self._index}.{name}": derivative for name, derivative in own.items()}
        if by_acceleration is not None:
            g, plane, direction = parameters.gravity_m_s2, parameters.gravity_plane, parameters.gravity_direction
            blocks["gravity.direction"] = lambda: by_acceleration @ (-g * plane)
            blocks["gravity.magnitude"] = lambda: by_acceleration @ -direction[:, None]
        for name, derivative in blocks.items():
            at = self._columns.own.get(name)
            if at is not None:
                np.multiply(derivative(), weight[:, None, None], out=rows[:, :, at])

    def _felt(self, places: Floats) -> tuple[Floats, ForceJacobian]:
        """Return component k of the specific force at places (3, 3), a row each, (n, 3), and its derivatives."""
        if not places.any():
            return self._force, at_origin(self._motion, self._force)
        felt = self._force + along_axes(self._A, places)
        return felt, at_places(self._motion, self._force, places)
