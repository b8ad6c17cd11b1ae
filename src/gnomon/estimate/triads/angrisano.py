"""The method of Angrisano as its authors carry it out: least squares, linearised again and again from a stated start.

The model is s = T K (s_out - b), Eqs. (1) and (2), with the bias subtracted; the unknowns are those of Eq. (3),

    X = [angle x y z, bias x y z, scale factor x y z]

The product at the start of an iteration is N, Eq. (5), and A = -dN/dX, Eq. (6), in which the row of b_x is +k_x like
those of b_y and b_z (the document prints a minus). Known attitudes give three equations each, A dX = -s + N (4); known
magnitudes give one, N'A dX = (N'N - s^2) / 2 (10). Both X = X_s + dX (7).

The iteration has no safeguard: from a poor start it ends in a wrong minimum, or nowhere (Angrisano, Table 2 and
Fig. 6). That is a status of the result here, not an error. `estimate.triads.triad` needs no start.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...models.angrisano import AngrisanoTriad, Geometry, alignment_derivatives, alignment_matrix, angles_and_scales
from ...recording import Floats

TOLERANCE = 0.0005
"""Stop rule of Angrisano: (q of the iteration before - q) / q."""

Status = Literal["converged", "mirrored", "wrong", "diverged", "not finished"]
"""How an iteration ended: at a minimum that explains the measurements, with positive scale factors; at its mirror
image, in which an axis is reversed; where the measurements are not explained; nowhere; or not in the allowed number."""

_EXPLAINED = 0.05
"""Measurements are explained if the rms of what is left is below this part of the reference: more than any sensor's
noise, less than any wrong minimum leaves."""

_ROUNDING = 1e-9
"""The same where measurements have no noise."""


@value_class
class AngrisanoFit:
    """What Angrisano's iteration came to.

    Attributes
    ----------
    parameters : (9,) X of Eq. (3): angles [rad], biases [unit], scale factors [SI per unit]
    covariance : (9, 9) of X by ordinary least squares, sigma_0^2 inv(H'H) with sigma_0^2 = q / (equations - 9); nan
        without redundant equations
    geometry : which alignment matrix the angles belong to
    visited : (m + 1, 9) X at the start and after each iteration
    q : (m,) residual quadratic form of each iteration
    residual_rms : sigma_0 [m/s^2 or rad/s], of components or of the magnitude
    status : how the iteration ended
    """

    parameters: Floats
    covariance: Floats
    geometry: Geometry
    visited: Floats
    q: Floats
    residual_rms: float
    status: Status

    @property
    def converged(self) -> bool:
        """Whether the iteration ended where it should."""
        return self.status == "converged"

    @property
    def iterations(self) -> int:
        """How many iterations were carried out."""
        return len(self.q)

    @property
    def form(self) -> AngrisanoTriad:
        """The sensor in the letters of Angrisano."""
        return AngrisanoTriad.from_parameters(self.parameters, self.geometry)

    @property
    def sensitivity(self) -> Floats:
        """Sensitivity of gnomon's model (3, 3) [unit per SI] in frame accel-z: measured = S @ true + bias."""
        return self.form.to_sensor()[0]

    @property
    def bias(self) -> Floats:
        """Bias of gnomon's model, (3,) [unit]."""
        return self.parameters[3:6]

    @property
    def sigma(self) -> Floats:
        """Standard deviation of each of X, (9,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def group_sigma(self) -> Floats:
        """Standard deviations of angles [rad], biases [unit] and scale factors of Table 1: rms of each group, (3,)."""
        return np.sqrt(np.mean(np.diag(self.covariance).reshape(3, 3), axis=1))

    @property
    def sensor_covariance(self) -> Floats:
        """Covariance (12, 12) of gnomon's sensitivity, entries in row order, and bias."""
        jacobian = sensor_jacobian(self.parameters, self.geometry)
        return jacobian @ self.covariance @ jacobian.T


def datasheet_start(bits: int, full_scale: float) -> Floats:
    """Return X (9,) of Eq. (12), for a converter of n bits that reads from minus to plus `full_scale` [SI].

    Examples
    --------
    >>> datasheet_start(16, 50.0)[5:7].round(6).tolist()
    [32767.5, 0.001526]
    """
    highest = 2**bits - 1
    return np.concatenate([np.zeros(3), np.full(3, highest / 2), np.full(3, 2 * full_scale / highest)])


def predict_magnitudes(X: Floats, measured: Floats, geometry: Geometry = "small-angle") -> Floats:
    """Return N (n, 3), Eq. (5): what measurements (n, 3) [unit] mean with X (9,)."""
    return (measured - X[3:6]) @ (alignment_matrix(X[:3], geometry) * X[6:]).T


def design_matrix(X: Floats, measured: Floats, geometry: Geometry = "small-angle") -> Floats:
    """Return A (n, 3, 9) = -dN/dX, Eq. (6), for measurements (n, 3) [unit] at X (9,)."""
    T, k, centred = alignment_matrix(X[:3], geometry), X[6:], measured - X[3:6]
    A = np.empty((len(measured), 3, 9))
    A[:, :, :3] = -np.einsum("aij,nj->nia", alignment_derivatives(X[:3], geometry), k * centred)
    A[:, :, 3:6] = T * k
    A[:, :, 6:] = -T * centred[:, None, :]
    return A


def fit_components(
    measured: Floats,
    truth: Floats,
    start: Floats,
    *,
    geometry: Geometry = "small-angle",
    tolerance: float = TOLERANCE,
    growth_stops: bool = False,
    most_iterations: int = 50,
) -> AngrisanoFit:
    """Solve Eqs. (4) and (7) again and again: three equations for each known attitude.

    Parameters
    ----------
    measured : (n, 3) means of the poses [unit], n >= 4
    truth : (n, 3) what acted on the sensor, in the orthogonal frame of its x axis and x-y plane [SI]
    start : (9,) X, such as `datasheet_start`
    geometry : alignment matrix: Eq. (15), or Eq. (14) where it is "exact"
    tolerance : of the stop rule
    growth_stops : whether q that grows meets the stop rule, as printed; in the document's Fig. 6 iterations went on
    most_iterations : bound on the number of iterations

    Raises
    ------
    InitialisationError
        If there are fewer than four poses: x alone has four unknowns.
    """
    _require(len(measured), 4, "components")

    def equations(X: Floats) -> tuple[Floats, Floats]:
        return design_matrix(X, measured, geometry).reshape(-1, 9), (
            predict_magnitudes(X, measured, geometry) - truth
        ).ravel()

    reference = float(np.sqrt(np.mean(np.sum(truth**2, axis=1))))
    rule = _Rule(tolerance=tolerance, growth_stops=growth_stops, most_iterations=most_iterations)
    return _iterate(equations, start, geometry, rule, unit=1.0, reference=reference)


def fit_magnitudes(
    measured: Floats,
    magnitude: float | Floats,
    start: Floats,
    *,
    geometry: Geometry = "small-angle",
    tolerance: float = TOLERANCE,
    growth_stops: bool = False,
    most_iterations: int = 50,
) -> AngrisanoFit:
    """Solve Eqs. (10) and (7) again and again: one equation for each pose, of which nine are needed and 18 advised.

    Parameters
    ----------
    measured : (n, 3) means of the poses [unit]
    magnitude : of what acted on the sensor: local gravity [m/s^2] or a rate [rad/s], one number or (n,)
    start, geometry, tolerance, growth_stops, most_iterations : as in `fit_components`

    Raises
    ------
    InitialisationError
        If there are fewer than nine poses.
    """
    _require(len(measured), 9, "magnitudes")
    s = np.broadcast_to(np.asarray(magnitude, dtype=np.float64), len(measured))

    def equations(X: Floats) -> tuple[Floats, Floats]:
        N = predict_magnitudes(X, measured, geometry)
        H = np.einsum("ni,nij->nj", N, design_matrix(X, measured, geometry))
        return H, 0.5 * (np.einsum("ni,ni->n", N, N) - s**2)

    reference = float(np.sqrt(np.mean(s**2)))
    # (N'N - s^2) / 2 is the magnitude's own residual times s
    rule = _Rule(tolerance=tolerance, growth_stops=growth_stops, most_iterations=most_iterations)
    return _iterate(equations, start, geometry, rule, unit=reference, reference=reference)


def canonical_parameters(X: Floats, geometry: Geometry = "small-angle") -> Floats:
    """Return X (9,) with positive scale factors; reversed axes of the orthogonal frame have the same magnitudes."""
    correction = alignment_matrix(X[:3], geometry) * X[6:]
    signs = np.where(np.diag(correction) < 0, -1.0, 1.0)
    angles, K = angles_and_scales(signs[:, None] * correction, geometry)
    return np.concatenate([angles, X[3:6], K])


def sensor_jacobian(X: Floats, geometry: Geometry) -> Floats:
    """Return the derivative (12, 9) of gnomon's sensitivity, entries in row order, and bias, by X (9,)."""
    T, k = alignment_matrix(X[:3], geometry), X[6:]
    S = np.linalg.inv(T * k)
    by = np.zeros((9, 3, 3))  # of T K
    by[:3] = alignment_derivatives(X[:3], geometry) * k
    for axis in range(3):
        by[6 + axis, :, axis] = T[:, axis]
    jacobian = np.zeros((12, 9))
    jacobian[:9] = -(S @ by @ S).reshape(9, 9).T
    jacobian[9:, 3:6] = np.eye(3)
    return jacobian


@value_class(eq=True)
class _Rule:
    """When to stop; see `fit_components`."""

    tolerance: float
    growth_stops: bool
    most_iterations: int

    def met(self, q: list[float]) -> bool:
        if len(q) < 2:
            return False
        fall = q[-2] - q[-1]
        return (fall if self.growth_stops else abs(fall)) <= self.tolerance * q[-1]


@np.errstate(over="ignore", invalid="ignore")  # an iteration that diverges does so thoroughly
def _iterate(
    equations: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
    geometry: Geometry,
    rule: _Rule,
    *,
    unit: float,
    reference: float,
) -> AngrisanoFit:
    """Solve H dX = l, add dX, and go on until q settles (Fig. 1 of Angrisano).

    q is what the linear equations leave, v = H dX - l, not what the model leaves at the new X.

    Parameters
    ----------
    equations : X -> H (m, 9), l (m,)
    unit : what a residual has to be divided by to be one of the quantity itself
    reference : size of that quantity
    """
    visited, q = [start.astype(np.float64)], list[float]()
    sigma_0, inverse = float("nan"), np.full((9, 9), np.nan)
    rounding = _ROUNDING * unit * reference
    rows, rest = equations(visited[0])
    status: Status = "not finished"
    while len(q) < rule.most_iterations and status == "not finished":
        solved = _solved(rows, rest)
        if solved is None:
            status = "diverged"
            break
        step, inverse = solved
        v = rows @ step - rest
        q.append(float(v @ v))
        sigma_0 = float(np.sqrt(q[-1] / (len(rest) - 9))) if len(rest) > 9 else float("nan")
        visited.append(visited[-1] + step)
        rows, rest = equations(visited[-1])
        left = float(np.sqrt(np.mean(rest**2)))  # by the model itself
        if left < rounding or rule.met(q):
            settled = left <= 2 * max(np.sqrt(q[-1] / len(rest)), rounding)
            explained = left < _EXPLAINED * unit * reference
            status = _minimum(visited[-1], geometry) if settled and explained else "wrong"
    return AngrisanoFit(
        parameters=visited[-1],
        covariance=sigma_0**2 * inverse,
        geometry=geometry,
        visited=np.array(visited),
        q=np.array(q),
        residual_rms=sigma_0 / unit,
        status=status,
    )


def _solved(H: Floats, rest: Floats) -> tuple[Floats, Floats] | None:
    """Return the least squares solution (9,) of H dX = l and inv(H'H); None where there is none.

    The columns are scaled first, since counts, radians and scale factors differ by ten powers of ten.
    """
    scale = np.linalg.norm(H, axis=0)
    if not (np.isfinite(scale).all() and (scale > 0).all() and np.isfinite(rest).all()):
        return None
    U, singular, Vt = np.linalg.svd(H / scale, full_matrices=False)
    if singular[-1] < 1e-13 * singular[0]:
        return None
    back = Vt.T / singular / scale[:, None]
    return back @ (U.T @ rest), back @ back.T


def _minimum(X: Floats, geometry: Geometry) -> Status:
    """Return which of the minima that explain the measurements X (9,) is."""
    return "converged" if (np.diag(alignment_matrix(X[:3], geometry) * X[6:]) > 0).all() else "mirrored"


def _require(poses: int, fewest: int, what: str) -> None:
    if poses < fewest:
        raise InitialisationError(
            f"{poses} poses do not determine the nine parameters of Angrisano from {what}: at least {fewest} are "
            "needed. Record more attitudes, 18 or more, well spread."
        )
