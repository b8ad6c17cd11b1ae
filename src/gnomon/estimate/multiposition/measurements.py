"""What static intervals and the rotations between them measure (Tedaldi 2014, chapter 3).

At rest a triad measures m = S f + b, and |f| is known (section 3.2; Angrisano, Eqs. 8-11). In a body frame that the
triad's own axes define, S is triangular and the correction f = C (m - b), C = inv(S), has nine unknowns.

Rotations are integrated from the gyroscope (sections 3.3 and 3.4.2). Within one the rate is omega(t) = C z(t): C (3, 7)
is linear in what is sought, and z = (y, 1, f) holds the measured rate y, a one for the bias and the specific force f
for the g-sensitivity.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...geometry.rotations import rk4n_steps, rotation_from_quaternion, running_products
from ...kernel import array_in, array_out, c_long, load_kernel
from ...recording import Floats, Integers, frozen_array
from ...solve.least_squares import LeastSquaresSolution, levenberg_marquardt

_PART = 100_000  # samples


UPPER = np.triu_indices(3)


def ellipsoid_start(measured: Floats) -> tuple[Floats, Floats]:
    """Return an upper triangular correction C (3, 3) and bias b (3,) with |C (m - b)| near 1, in closed form.

    Points of constant magnitude lie on an ellipsoid, whose equation is linear in nine coefficients. No initial guess is
    needed. The data are centred and scaled first, so that any unit and offset of the sensor will do.

    Parameters
    ----------
    measured : (n, 3), n >= 9 [unit]

    Raises
    ------
    InitialisationError
        If the points determine no ellipsoid: too few, or too much alike.
    """
    centre = 0.5 * (measured.max(axis=0) + measured.min(axis=0))
    spread = 0.5 * np.ptp(measured, axis=0)
    if len(measured) < 9 or not (spread > 0).all():
        raise InitialisationError(
            f"{len(measured)} attitudes, of which an axis never changes or nine are not reached, determine no "
            "accelerometer calibration. Record at least nine well spread attitudes."
        )
    x, y, z = ((measured - centre) / spread).T
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    a = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
    quadric = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
    if np.linalg.eigvalsh(quadric).min() <= 0:
        raise InitialisationError(
            "the static attitudes do not surround an ellipsoid: they are too much alike, or the sensor moved in them. "
            "Turn the sensor so that every axis points up once and down once, and some directions between."
        )
    offset = -np.linalg.solve(quadric, a[6:])
    level = 1 + offset @ quadric @ offset
    upper = np.linalg.cholesky(quadric / level).T
    return upper / spread, centre + spread * offset


@value_class
class MagnitudeFit:
    """A triangular calibration from magnitudes.

    Attributes
    ----------
    correction : (3, 3) upper triangular, f = correction @ (m - bias) [m/s^2 per unit]
    bias : (3,) [unit]
    residual : (n,) weighted residuals at the minimum
    jacobian : (n, 9) their derivatives, in scaled parameters
    covariance : (9, 9) of the correction's six entries in row order and the bias, for residuals of unit variance
    leverage : (n,) diagonal of the hat matrix
    cost : half the sum of squared residuals
    converged : whether the minimum was reached
    """

    correction: Floats
    bias: Floats
    residual: Floats
    jacobian: Floats
    covariance: Floats
    leverage: Floats
    cost: float
    converged: bool


def fit_magnitude(
    measured: Floats,
    magnitude: float,
    weight: Floats | None = None,
    residual: Literal["magnitude", "square"] = "magnitude",
    tolerance: float = 1e-12,
) -> MagnitudeFit:
    """Fit a triangular calibration to measurements of a vector of known magnitude.

    Parameters
    ----------
    measured : (n, 3) [unit]
    magnitude : of the measured vector, such as local gravity [m/s^2]
    weight : (n,) multiplies the residuals; all 1 where not given
    residual : "square" is the cost g^2 - |f|^2 of Eq. (3.4); "magnitude" is g - |f|, which has the noise of the sensor
    tolerance : relative length of a step at which the minimum is reached

    Raises
    ------
    InitialisationError
        If the attitudes determine no start.
    """
    centre, scale = measured.mean(axis=0), measured.std(axis=0)
    normal = (measured - centre) / np.where(scale > 0, scale, 1.0)
    correction, bias = ellipsoid_start(normal)
    start = np.concatenate([(magnitude * correction)[UPPER], bias])
    weights = np.ones(len(measured)) if weight is None else weight
    solution = levenberg_marquardt(_magnitude_problem(normal, magnitude, weights, residual), start, tolerance)
    turn = np.concatenate([(1 / np.broadcast_to(scale, (3, 3)))[UPPER], scale])  # back to the unit of the sensor
    x = solution.x * turn
    correction = np.zeros((3, 3))
    correction[UPPER] = x[:6]
    unscaled, leverage = _covariance_and_leverage(solution)
    return MagnitudeFit(
        correction=correction,
        bias=x[6:] + centre,
        residual=solution.residual,
        jacobian=solution.jacobian,
        covariance=unscaled * np.outer(turn, turn),
        leverage=leverage,
        cost=solution.cost,
        converged=solution.converged,
    )


def _covariance_and_leverage(solution: LeastSquaresSolution) -> tuple[Floats, Floats]:
    q, r = np.linalg.qr(solution.jacobian)
    inverse = np.linalg.pinv(r)
    return inverse @ inverse.T, np.einsum("ij,ij->i", q, q)


def _magnitude_problem(
    measured: Floats, magnitude: float, weights: Floats, kind: str
) -> Callable[[Floats], tuple[Floats, Floats]]:
    def problem(x: Floats) -> tuple[Floats, Floats]:
        """Return weighted residuals (n,) and their derivative (n, 9) by the correction and the bias, x (9,)."""
        correction = np.zeros((3, 3))
        correction[UPPER] = x[:6]
        centred = measured - x[6:]
        force = centred @ correction.T
        norm = np.sqrt(np.einsum("ij,ij->i", force, force))
        # derivative of the residual with respect to f: -f / |f|, or -2 f for squares
        pull = -2 * force if kind == "square" else -force / norm[:, None]
        value = magnitude**2 - norm**2 if kind == "square" else magnitude - norm
        jacobian = np.empty((len(measured), 9))
        for column, (i, j) in enumerate(zip(*UPPER, strict=True)):
            jacobian[:, column] = pull[:, i] * centred[:, j]
        jacobian[:, 6:] = -pull @ correction
        return value * weights, jacobian * weights[:, None]

    return problem


@value_class
class MotionSegments:
    """The samples of all rotations, one after the other.

    Attributes
    ----------
    gyroscope : (n, 3) measured rate, any unit
    accelerometer : (n, 3) measured specific force at the same instants, any unit
    dt_s : (n,) [s], time to the next sample of the same rotation; 0 at the last sample of each
    lengths : (m,) number of samples of each rotation, summing to n
    """

    gyroscope: Floats
    accelerometer: Floats
    dt_s: Floats
    lengths: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "gyroscope", frozen_array(self.gyroscope))
        object.__setattr__(self, "accelerometer", frozen_array(self.accelerometer))
        object.__setattr__(self, "dt_s", frozen_array(self.dt_s))
        object.__setattr__(self, "lengths", frozen_array(self.lengths, np.int64))

    @property
    def first(self) -> Integers:
        """Index of the first sample of each rotation, (m,)."""
        return np.cumsum(self.lengths) - self.lengths

    def parts(self) -> list[tuple[slice, slice]]:
        """Return slices of rotations, and of their samples, that bound the memory of what each sample needs."""
        ends = np.cumsum(self.lengths)
        parts: list[tuple[slice, slice]] = []
        rotation = sample = 0
        while rotation < len(ends):
            last = max(int(np.searchsorted(ends, sample + _PART, "right")), rotation + 1)
            parts.append((slice(rotation, last), slice(sample, int(ends[last - 1]))))
            rotation, sample = last, int(ends[last - 1])
        return parts

    def part(self, rotations: slice, samples: slice) -> "MotionSegments":
        """Return some of the rotations with their samples, without copying them."""
        return MotionSegments(
            gyroscope=self.gyroscope[samples],
            accelerometer=self.accelerometer[samples],
            dt_s=self.dt_s[samples],
            lengths=self.lengths[rotations],
        )

    @property
    def duration_s(self) -> Floats:
        """Length of each rotation [s], (m,)."""
        return np.add.reduceat(self.dt_s, self.first) if len(self.lengths) else np.empty(0)


def segments_between(t_s: Floats, start_s: Floats, stop_s: Floats) -> tuple[Integers, Integers]:
    """Return for each rotation the index of its first sample and its number of samples.

    Parameters
    ----------
    t_s : (n,) timestamps, rising [s]
    start_s : (m,) last instant of the static interval before the rotation [s]
    stop_s : (m,) first instant of the static interval after it [s]
    """
    first = np.maximum(np.searchsorted(t_s, start_s, side="right") - 1, 0)
    last = np.minimum(np.searchsorted(t_s, stop_s, side="left"), len(t_s) - 1)
    return first, last - first + 1


def cut_segments(
    t_s: Floats, gyroscope: Floats, accelerometer: Floats, first: Integers, lengths: Integers
) -> MotionSegments:
    """Cut the samples of the rotations out of a recording.

    Parameters
    ----------
    t_s : (n,) [s]
    gyroscope, accelerometer : (n, 3), both at t_s
    first, lengths : (m,), from `segments_between`
    """
    offsets = np.cumsum(lengths) - lengths
    index = np.arange(lengths.sum()) - np.repeat(offsets - first, lengths)
    dt = t_s[np.minimum(index + 1, len(t_s) - 1)] - t_s[index]
    dt[np.cumsum(lengths) - 1] = 0.0
    return MotionSegments(gyroscope=gyroscope[index], accelerometer=accelerometer[index], dt_s=dt, lengths=lengths)


@value_class
class Turns:
    """Integrated rotations.

    Attributes
    ----------
    rotation : (m, 3, 3), R_start_end: v_start = rotation @ v_end for a vector fixed in the world
    sensitivity : (m, 3, 3, 7), small rotation of the end attitude, seen from the start frame, by a change of omega's
        coefficients: delta_theta[i] = sum over a, c of sensitivity[i, a, c] dC[a, c]
    """

    rotation: Floats
    sensitivity: Floats


def integrate_rates(segments: MotionSegments, omega: Floats, regressors: Floats | None = None) -> Turns:
    """Integrate rates by RK4n, Eqs. (3.10)-(3.16), with first-order sensitivities.

    The sensitivity is the integral of R(t) dC z(t) dt by the trapezoid rule, whose error vanishes for motions that
    begin and end at rest (Euler and Maclaurin).

    Parameters
    ----------
    segments : the rotations
    omega : (n, 3) [rad/s] at the samples of the segments
    regressors : (n, 7) z of the module's head; no sensitivity is computed where it is not given
    """
    if load_kernel() is not None:
        rotation, sensitivity = integrate_segments(segments.lengths, omega, segments.dt_s, regressors)
        return Turns(rotation=rotation, sensitivity=sensitivity)
    parts = [
        _integrate_part(
            segments.part(rotations, samples), omega[samples], None if regressors is None else regressors[samples]
        )
        for rotations, samples in segments.parts()
    ]
    return Turns(
        rotation=np.concatenate([part.rotation for part in parts]),
        sensitivity=np.concatenate([part.sensitivity for part in parts]),
    )


def integrate_segments(
    lengths: Integers, omega: Floats, dt_s: Floats, regressors: Floats | None
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and sensitivities (m, 3, 3, 7) of segments; see `integrate_rates`.

    Parameters
    ----------
    lengths : (m,) samples of the segments
    omega, dt_s, regressors : (n, 3) [rad/s], (n,) [s], (n, 7) or None: of the samples
    """
    library = load_kernel()
    assert library is not None
    rotation, sensitivity = np.empty((len(lengths), 3, 3)), np.empty((len(lengths), 3, 3, 7))
    library.gnomon_integrate_rates(
        *(
            c_long(len(lengths)),
            *map(array_in, (lengths, omega, dt_s, regressors)),
            array_out(rotation),
            array_out(sensitivity),
        )
    )
    return rotation, sensitivity


def _integrate_part(segments: MotionSegments, omega: Floats, regressors: Floats | None) -> Turns:
    first, lengths = segments.first, segments.lengths
    following = np.minimum(np.arange(len(omega)) + 1, len(omega) - 1)
    steps = rk4n_steps(omega, omega[following], segments.dt_s)
    attitude = running_products(steps, lengths)  # of the next sample, seen from the start of the segment
    rotation = rotation_from_quaternion(attitude[first + lengths - 1])
    if regressors is None:
        return Turns(rotation=rotation, sensitivity=np.zeros((len(lengths), 3, 3, 7)))
    at_sample = np.empty_like(attitude)
    at_sample[1:] = attitude[:-1]
    at_sample[first] = (1.0, 0.0, 0.0, 0.0)
    weight = 0.5 * segments.dt_s
    weight[1:] += 0.5 * segments.dt_s[:-1]
    path = rotation_from_quaternion(at_sample).reshape(-1, 9)
    path *= weight[:, None]
    sensitivity = np.empty((len(lengths), 9, 7))
    for k, (a, n) in enumerate(zip(first, lengths, strict=True)):
        np.matmul(path[a : a + n].T, regressors[a : a + n], out=sensitivity[k])
    return Turns(rotation=rotation, sensitivity=sensitivity.reshape(-1, 3, 3, 7))


def propagate_directions(rotation: Floats, u_start: Floats) -> Floats:
    """Return world-fixed vectors (m, 3) at the end of their rotations: u_end = R_start_end' u_start, Eq. (3.7)."""
    return np.einsum("kij,ki->kj", rotation, u_start)


def segment_moments(segments: MotionSegments, a: Floats, b: Floats) -> Floats:
    """Return the integrals of a_i b_j over each rotation, (m, 3, 3), of values (n, 3) at the samples."""
    weight = 0.5 * segments.dt_s
    weight[1:] += 0.5 * segments.dt_s[:-1]
    weighted = weight[:, None] * b
    ends = zip(segments.first, segments.first + segments.lengths, strict=True)
    return np.array([a[first:last].T @ weighted[first:last] for first, last in ends]).reshape(-1, 3, 3)


def linear_start(segments: MotionSegments, u_path: Floats) -> tuple[Floats, Floats]:
    """Return a first estimate of C_g (3, 3) and how well each of its entries is known, without any guess.

    A direction fixed in the world obeys u' = -omega x u in the body. Where the direction is known all along the motion
    at least roughly, u(end) - u(start) = -integral of (C y) x u dt is linear in C.

    Parameters
    ----------
    segments : gyroscope values with their bias removed
    u_path : (n, 3) direction of gravity in the body at the samples of the segments

    Returns
    -------
    (3, 3) correction with omega = C y, and (9,) singular values of the scaled problem, largest first
    """
    moments = segment_moments(segments, u_path, segments.gyroscope)
    last = segments.first + segments.lengths - 1
    change = u_path[last] - u_path[segments.first]
    levi_civita = np.zeros((3, 3, 3))
    levi_civita[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
    levi_civita[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0
    design = -np.einsum("iab,kbc->kiac", levi_civita, moments).reshape(-1, 9)
    scale = np.linalg.norm(design, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solution, _, _, singular = np.linalg.lstsq(design / scale, change.ravel(), rcond=1e-6)
    return (solution / scale).reshape(3, 3), singular
