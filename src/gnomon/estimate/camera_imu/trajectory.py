"""The trajectory and the biases as functions of continuous time (Krebs, sections 4.1.1 and 4.2).

The attitude is R_target_imu(t) = R_reference Exp(phi(t)), position, phi and biases are splines over one grid of knots:
cubic and higher for pose, linear for the biases, which is a random walk sampled at the knots. Where a stream has a gap,
or where phi would come near a full turn, the grid is cut into segments, each with a reference attitude of its own;
the random walk of the biases runs on from one to the next.

A B-spline of order k (degree k - 1) has, between knot j and knot j + 1, the value sum_i b_i(u) c_{j+i}, i = 0 .. k - 1,
with u in [0, 1) the place between the two knots. The basis functions are the same between all knots.
"""

from dataclasses import replace
from functools import cache
from math import comb, factorial

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import angular_acceleration_by_phi, body_rotation, skew
from ...recording import Floats, Integers

POSE = 6
"""Scalars of a pose control point: rotation vector, position."""

BIAS = 6
"""Bias scalars of one IMU at a knot: gyroscope, accelerometer."""


MARGIN_S = 0.1
"""How far the trajectory reaches beyond the first and the last frame, where the IMU does."""


@value_class
class Segment:
    """A piece of the trajectory.

    Attributes
    ----------
    start_s : time of its first knot [s]
    spans : intervals between its knots
    first : index of its first control point; it has spans + order - 1
    R_reference : (3, 3) attitude of the target about which its rotation vectors are counted
    """

    start_s: float
    spans: int
    first: int
    R_reference: Floats


@value_class
class KnotGrid:
    """Knots of the splines.

    Attributes
    ----------
    segments : in the order of time
    spacing_s : time between knots [s]
    order : of the pose splines
    tied : whether biases bend at every (order - 1)-th knot only, which is enough where they hardly wander in between
    """

    segments: tuple[Segment, ...]
    spacing_s: float
    order: int
    tied: bool = False

    @property
    def controls(self) -> int:
        """Number of control points."""
        last = self.segments[-1]
        return last.first + last.spans + self.order - 1

    @property
    def duration_s(self) -> float:
        """Time that the segments span together [s]."""
        return sum(segment.spans for segment in self.segments) * self.spacing_s

    @property
    def bias_offset(self) -> int:
        """Control point, counted from the first of a span, that holds the bias at the span's first knot."""
        return (self.order - 2) // 2

    def places(self, t_s: Floats) -> "Places":
        """Return where instants (n,) [s] lie on the grid; outside of all segments they are marked so."""
        starts = np.array([segment.start_s for segment in self.segments])
        which = np.clip(np.searchsorted(starts, t_s, side="right") - 1, 0, len(starts) - 1)
        spans = np.array([segment.spans for segment in self.segments])[which]
        position = (t_s - starts[which]) / self.spacing_s
        inside = (position >= 0) & (position <= spans)
        interval = np.clip(np.floor(position).astype(np.int64), 0, spans - 1)
        first = np.array([segment.first for segment in self.segments])[which]
        return Places(
            first=first + interval,
            u=np.where(inside, position - interval, 0.0),
            segment=which,
            inside=inside,
        )

    def references(self) -> Floats:
        """Return the reference attitudes of all segments, (s, 3, 3)."""
        return np.array([segment.R_reference for segment in self.segments])

    def knot_times(self) -> tuple[Integers, Floats]:
        """Return the control points that hold the bias at a knot, and the times of those knots [s]."""
        index = [segment.first + self.bias_offset + np.arange(segment.spans + 1) for segment in self.segments]
        times = [segment.start_s + self.spacing_s * np.arange(segment.spans + 1) for segment in self.segments]
        return np.concatenate(index), np.asarray(np.concatenate(times), dtype=np.float64)


@value_class
class Places:
    """Instants on a grid.

    Attributes
    ----------
    first : (n,) first control point of the span
    u : (n,) place in the span, 0 to 1
    segment : (n,) segment
    inside : (n,) whether the instant lies in a segment
    """

    first: Integers
    u: Floats
    segment: Integers
    inside: np.ndarray

    def some(self, which: np.ndarray | slice) -> "Places":
        """Return some of the places."""
        return Places(first=self.first[which], u=self.u[which], segment=self.segment[which], inside=self.inside[which])


@cache
def basis_matrix(order: int) -> Floats:
    """Return M (k, k) with b(u) = [1, u, ..., u^(k-1)] M: the columns are the pieces of the cardinal B-spline.

    Piece i is the part of the cardinal B-spline N(x) = sum_r (-1)^r C(k, r) (x - r)_+^(k-1) / (k-1)! with x = u +
    k - 1 - i.
    """
    k = order
    matrix = np.zeros((k, k))
    for i in range(k):
        for power in range(k):
            terms = ((-1) ** r * comb(k, r) * (k - 1 - i - r) ** (k - 1 - power) for r in range(k - i))
            matrix[power, i] = comb(k - 1, power) * sum(terms) / factorial(k - 1)
    matrix.flags.writeable = False
    return matrix


@cache
def basis_polynomials(order: int, derivative: int) -> Floats:
    """Return the matrix (k, k) of a derivative of b(u): rows are powers of u, the last ones zero."""
    matrix = basis_matrix(order)
    for _ in range(derivative):
        matrix = np.concatenate([matrix[1:] * np.arange(1, len(matrix))[:, None], np.zeros((1, order))])
    matrix.flags.writeable = False
    return matrix


def bspline_basis(order: int, u: Floats, derivative: int = 0) -> Floats:
    """Return b(u) or a derivative of it by u, (n, k), of places u (n,)."""
    matrix = basis_polynomials(order, derivative)[: max(order - derivative, 1)]
    powers = u[:, None] ** np.arange(len(matrix))
    return powers @ matrix


@value_class
class Bases:
    """Values of the pose splines' basis functions and of their first two derivatives by time, (n, k) each."""

    value: Floats
    rate: Floats
    acceleration: Floats

    @classmethod
    def at(cls, places: Places, grid: KnotGrid, exposure_s2: float = 0.0) -> "Bases":
        """Return the basis functions at places on a grid; values and rates are means over an exposure, squared [s^2].

        The mean of a function over an exposure e about t is f(t) + e^2 / 24 f''(t) + O(e^4), by Taylor's theorem.
        """
        k, dt = grid.order, grid.spacing_s
        value, rate, acceleration = (bspline_basis(k, places.u, n) / dt**n for n in range(3))
        if exposure_s2:
            value += exposure_s2 / 24 * acceleration
            rate += exposure_s2 / 24 * bspline_basis(k, places.u, 3) / dt**3
        return cls(value=value, rate=rate, acceleration=acceleration)


@value_class
class MotionState:
    """State of motion at some instants.

    Attributes
    ----------
    R : (n, 3, 3) R_target_imu
    phi_jacobian : (n, 3, 3) right Jacobian: a change d of phi turns the body by phi_jacobian d, in its own frame
    omega : (n, 3) angular rate, IMU frame [rad/s]
    omega_by_phi : (n, 3, 3)
    phi, phi_rate, phi_acceleration : (n, 3) rotation vector and its derivatives by time
    position, velocity, acceleration : (n, 3) of the IMU, target frame [m, m/s, m/s^2]
    turn : (3, 3) from the body's axes to those in which the motion is told; None for the body's own
    """

    R: Floats
    phi_jacobian: Floats
    omega: Floats
    omega_by_phi: Floats
    phi: Floats
    phi_rate: Floats
    phi_acceleration: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats
    turn: Floats | None = None

    def turned(self, turn: Floats) -> "MotionState":
        """Return the motion of the same body in other axes, v_new = turn @ v, (3, 3)."""
        return replace(
            self,
            R=self.R @ turn.T,
            phi_jacobian=turn @ self.phi_jacobian,
            omega=self.omega @ turn.T,
            omega_by_phi=turn @ self.omega_by_phi,
            turn=turn,
        )

    @property
    def alpha(self) -> Floats:
        """Angular acceleration, IMU frame, (n, 3) [rad/s^2]."""
        return (self.omega_by_phi @ self.phi_rate[:, :, None] + self.phi_jacobian @ self.phi_acceleration[:, :, None])[
            :, :, 0
        ]

    def specific_force(self, gravity: Floats) -> Floats:
        """Return the specific force at the body's origin under gravity (3,), IMU frame, (n, 3) [m/s^2]."""
        return np.matmul((self.acceleration - gravity)[:, None, :], self.R)[:, 0, :]

    def alpha_jacobians(self) -> tuple[Floats, Floats, Floats]:
        """Return the derivatives (n, 3, 3) of `alpha` by the rotation vector, its rate and its acceleration."""
        by_phi = angular_acceleration_by_phi(self.phi, self.phi_rate, self.phi_acceleration)
        if self.turn is not None:
            by_phi = self.turn @ by_phi
        return by_phi, 2 * self.omega_by_phi - skew(self.omega) @ self.phi_jacobian, self.phi_jacobian


@value_class
class Trajectory:
    """Control points on a grid.

    Attributes
    ----------
    grid : knots
    controls : (n, 6 + 6 m) rotation vector [rad], position [m], and for each IMU gyroscope bias [rad/s] and
        accelerometer bias [m/s^2]
    """

    grid: KnotGrid
    controls: Floats

    def plus(self, step: Floats) -> "Trajectory":
        """Return the trajectory with a step (n, 6 + 6 m) added to its control points."""
        return replace(self, controls=self.controls + step)

    def motion(self, places: Places, bases: Bases) -> MotionState:
        """Return the motion at places on the grid."""
        rows = places.first[:, None] + np.arange(self.grid.order)
        pose = self.controls[:, :POSE][rows]
        value, rate = _combined(bases.value, pose), _combined(bases.rate, pose)
        acceleration = _combined(bases.acceleration, pose)
        rotation, jacobian, omega, by_phi = body_rotation(value[:, :3], rate[:, :3])
        references = self.grid.references()
        R = references[0] @ rotation if len(references) == 1 else references[places.segment] @ rotation
        return MotionState(
            R=R,
            phi_jacobian=jacobian,
            omega=omega,
            omega_by_phi=by_phi,
            phi=value[:, :3],
            phi_rate=rate[:, :3],
            phi_acceleration=acceleration[:, :3],
            position=value[:, 3:],
            velocity=rate[:, 3:],
            acceleration=acceleration[:, 3:],
        )

    def jerk(self, places: Places) -> Floats:
        """Return the third derivatives by time of rotation vector [rad/s^3] and position [m/s^3], (n, 6)."""
        rows = places.first[:, None] + np.arange(self.grid.order)
        weights = bspline_basis(self.grid.order, places.u, 3) / self.grid.spacing_s**3
        return _combined(weights, self.controls[:, :POSE][rows])

    def bias_rate(self, places: Places, imu: int) -> tuple[Floats, Floats]:
        """Return the derivatives of `bias` by time, (n, 3) each [rad/s^2], [m/s^3]."""
        values = self.controls[:, POSE + BIAS * imu : POSE + BIAS * (imu + 1)]
        first = places.first + self.grid.bias_offset
        rate = (values[first + 1] - values[first]) / self.grid.spacing_s
        return rate[:, :3], rate[:, 3:]

    def bias(self, places: Places, imu: int = 0) -> tuple[Floats, Floats]:
        """Return gyroscope bias (n, 3) [rad/s] and accelerometer bias (n, 3) [m/s^2] at places on the grid."""
        start = POSE + BIAS * imu
        values = self.controls[:, start : start + BIAS]
        first = places.first + self.grid.bias_offset
        u = places.u[:, None]
        bias = values[first] * (1 - u) + values[first + 1] * u
        return bias[:, :3], bias[:, 3:]


def _combined(weights: Floats, pose: Floats) -> Floats:
    return np.matmul(weights[:, None, :], pose)[:, 0, :]
