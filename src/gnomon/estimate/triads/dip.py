"""How a magnetometer stands to an accelerometer, from the constant angle between the field and the vertical.

With u the direction of the specific force, up at rest, and m that of the field in the magnetometer's own frame,

    u' Q m = -sin(dip)

in every attitude, with one rotation Q and one dip (positive down). Nothing need be known of the attitudes, but they
must differ about more than one axis. The pair (-Q, -dip) fits as well: Q is taken as a rotation, which is right where
both sensors are right-handed and the accelerometer shows specific force, up at rest. A dip of the wrong sign says
otherwise.
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import nearest_rotation, rotation_from_rotvec, skew
from ...recording import Floats
from ...results.result import Booleans
from .blocks import Stage

_SAMPLE = 400  # in which the start is sought
_STEPS = 30
_AS_PREDICTED = 2.0  # spread [sigma] of a start beside which no other one is tried: no other rotation explains as much
_TUNING = 4.685  # Tukey's biweight in units of the spread
_MAD = 1.4826


@value_class
class DipFit:
    """The rotation and the dip.

    Attributes
    ----------
    rotation : (3, 3) Q, from the magnetometer's own frame to that of the accelerometer
    sine : u' Q m, which is -sin(dip)
    error : (n,) u' Q m - sine
    sigma : (n,) predicted sigma of it
    weight : (n,) 0 to 1, small where a pose stands out
    stage : linearised: a small rotation on the right of Q (3,), then the sine; earlier: the free parameters of the
        magnetometer, then those of the accelerometer
    """

    rotation: Floats
    sine: float
    error: Floats
    sigma: Floats
    weight: Floats
    stage: Stage

    @property
    def dip_rad(self) -> float:
        """Angle of the field below the horizontal [rad]."""
        return float(-np.arcsin(np.clip(self.sine, -1, 1)))


def fit_dip(
    up: Floats,
    field: Floats,
    sigma: Floats,
    used: Booleans,
    *,
    by_up: Floats,
    by_field: Floats,
    turn: bool = True,
) -> DipFit:
    """Fit rotation and dip, robustly.

    Parameters
    ----------
    up : (n, 3) unit vectors, frame of the accelerometer
    field : (n, 3) unit vectors, frame of the magnetometer
    sigma : (n,) of each direction, together, about either axis across it [rad]
    used : (n,) bool
    by_up, by_field : (n, 3, p) derivatives of the unit vectors by the parameters behind them
    turn : whether Q is estimated; else it is the identity
    """
    some = np.flatnonzero(used)
    some = some[:: max(1, len(some) // _SAMPLE)]
    start = _linear(up[some], field[some], sigma[some]) if turn else np.eye(3)
    found = [_minimum(up[some], field[some], sigma[some], start, turn=turn)]
    if turn and found[0][2] > _AS_PREDICTED:
        found += [_minimum(up[some], field[some], sigma[some], start, turn=True) for start in _axes()]
    rotation, _, _ = min(found, key=lambda one: one[2])
    rotation, sine, _ = _minimum(up[used], field[used], sigma[used], rotation, turn=turn)
    error, jacobian = _rows(up, field, sigma, rotation, sine)
    size = error / sigma
    spread = _spread(size[used])
    weight = np.where(used, _tukey(size / spread), 0.0)
    root = (np.sqrt(weight) / (sigma * spread))[:, None]
    # Weights that move with the residuals hold the estimate less than fixed ones would.
    held = np.sqrt(np.sum(_slope(size[used] / spread)) / np.sum(weight[used]))
    earlier = (
        np.einsum("ni,nip->np", up @ rotation, by_field) * root,
        np.einsum("ni,nip->np", field @ rotation.T, by_up) * root,
    )
    rows = (jacobian if turn else jacobian[:, 3:]) * root
    return DipFit(
        rotation=rotation,
        sine=sine,
        error=error,
        sigma=sigma * spread,
        weight=weight,
        stage=Stage(
            residual=error * root[:, 0] / held,
            jacobian=rows * held,
            covariance=np.linalg.pinv(rows.T @ rows, hermitian=True) / held**2,
            earlier=(earlier[0] * held, earlier[1] * held),
        ),
    )


def _rows(up: Floats, field: Floats, sigma: Floats, rotation: Floats, sine: float) -> tuple[Floats, Floats]:
    """Return the errors (n,) and their derivatives (n, 4) by a small rotation on the right and by the sine.

    Directions that err by sigma on either side are on the average shorter by sigma^2 along the true one.
    """
    seen, length = up @ rotation, 1 - sigma**2
    error = np.einsum("ni,ni->n", seen, field) - sine * length
    return error, np.column_stack([np.cross(field, seen), -length])


def _minimum(up: Floats, field: Floats, sigma: Floats, start: Floats, *, turn: bool) -> tuple[Floats, float, float]:
    """Return rotation, sine and spread [sigma] of the robust minimum near a start."""
    rotation, sine = start, float(np.median(np.einsum("ni,ni->n", up @ start, field)))
    for _ in range(_STEPS):
        error, jacobian = _rows(up, field, sigma, rotation, sine)
        size = error / sigma
        root = np.sqrt(_tukey(size / _spread(size))) / sigma
        a = jacobian * root[:, None] if turn else jacobian[:, 3:] * root[:, None]
        step = np.linalg.lstsq(a, -error * root, rcond=1e-12)[0]
        sine += float(step[-1])
        if turn:
            shorter = min(1.0, 0.5 / max(float(np.abs(step[:3]).max()), 1e-12))
            rotation = rotation @ rotation_from_rotvec(np.asarray(shorter * step[:3], dtype=np.float64))
        if float(np.abs(step).max()) < 1e-10:
            break
    error, _ = _rows(up, field, sigma, rotation, sine)
    return rotation, sine, _spread(error / sigma)


def _spread(size: Floats) -> float:
    return max(_MAD * float(np.median(np.abs(size))), 1e-9)


def _tukey(size: Floats) -> Floats:
    return np.where(np.abs(size) < _TUNING, (1 - (size / _TUNING) ** 2) ** 2, 0.0)


def _slope(size: Floats) -> Floats:
    """Return the derivative of size times weight, (n,)."""
    ratio = (size / _TUNING) ** 2
    return np.where(ratio < 1, (1 - ratio) * (1 - 5 * ratio), 0.0)


def _linear(up: Floats, field: Floats, sigma: Floats) -> Floats:
    """Return the rotation nearest to the matrix of least squares, u' A m = constant."""
    rows = np.column_stack([np.einsum("ni,nj->nij", up, field).reshape(-1, 9), -np.ones(len(up))]) / sigma[:, None]
    a = np.linalg.svd(rows, full_matrices=False)[2][-1][:9].reshape(3, 3)
    return nearest_rotation(a * np.sign(np.linalg.det(a) or 1.0))


def _axes() -> list[Floats]:
    """Return the 24 rotations that bring axes to axes."""
    found: list[Floats] = []
    for i in range(3):
        for j in range(3):
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                if i != j:
                    x, y = signs[0] * np.eye(3)[i], signs[1] * np.eye(3)[j]
                    found.append(np.stack([x, y, np.cross(x, y)]))
    return found


def in_body_frame(sensitivity: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """Return the sensitivity (3, 3) in the accelerometer's frame, and its derivatives (9, 12).

    The derivatives are by the sensitivity in the own frame (row order) and by a small rotation on the right of Q.
    """
    jacobian = np.zeros((9, 12))
    jacobian[:, :9] = np.kron(np.eye(3), rotation)
    for axis in range(3):
        jacobian[:, 9 + axis] = -(sensitivity @ skew(np.eye(3)[axis]) @ rotation.T).ravel()
    return sensitivity @ rotation.T, jacobian
