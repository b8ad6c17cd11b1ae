"""An accelerometer that was turned by hand with a magnetometer: where up is, and how well that is known meanwhile."""

import numpy as np

from ...frozen import value_class
from ...geometry.so3 import invert_matrix
from ...recording import Floats
from ...results.intervals import Booleans
from .blocks import Stage, by_direction
from .triad import TriadFit, fit_triad
from .triad_poses import TriadPoses, TriadPrior

_SHORTEST_S = 0.04
_NEAR_S, _AROUND_S = 0.4, 1.0
_QUIET = 0.1  # quantile of the unrest below which poses count alike


@value_class
class GravityFit:
    """The accelerometer's parameters, and its direction of up in each pose.

    Attributes
    ----------
    triad : fit of the poses that `used` marks
    used : (n,) bool, of all poses
    up : (n, 3) unit vectors, frame accel-x
    sigma : (n,) of this direction, from how much |f| differs from gravity around each pose [rad]
    by_parameters : (n, 3, f) derivative of up by the free parameters
    stage : linearised, rows for all poses
    """

    triad: TriadFit
    used: Booleans
    up: Floats
    sigma: Floats
    by_parameters: Floats
    stage: Stage


def force_at(t_s: Floats, values: Floats, start_s: Floats, stop_s: Floats) -> Floats:
    """Return means of an accelerometer (k, 3) over given spans of time, at least 40 ms, (n, 3)."""
    middle, half = (start_s + stop_s) / 2, np.maximum((stop_s - start_s) / 2, _SHORTEST_S / 2)
    steps = np.diff(t_s)[:, None]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (values[1:] + values[:-1]) * steps, axis=0)])
    low = np.clip(middle - half, t_s[0], t_s[-1] - _SHORTEST_S)
    high = np.clip(middle + half, low + _SHORTEST_S / 2, t_s[-1])
    integral = [np.column_stack([np.interp(at, t_s, total[:, i]) for i in range(3)]) for at in (low, high)]
    return (integral[1] - integral[0]) / (high - low)[:, None]


def fit_gravity(
    t_s: Floats, measured: Floats, length: Floats, *, noise: Floats, gravity_m_s2: float, prior: TriadPrior | None
) -> GravityFit:
    """Fit the accelerometer to the magnitude of gravity; poses in the middle of accelerations count little.

    Parameters
    ----------
    t_s : (n,) rising [s]
    measured : (n, 3) means [unit]
    length : (n,) of a mean in units of gravity: the chord's less than 1 where the sensor turned meanwhile
    noise : (3,) of a sample [unit]
    gravity_m_s2 : its magnitude
    prior : what is known of the accelerometer

    Raises
    ------
    InitialisationError
        If the poses do not determine the accelerometer.
    """
    variance = np.maximum(noise, 1e-12) ** 2
    magnitude = gravity_m_s2 * length
    triad = fit_triad(TriadPoses.of(measured, magnitude, variance=variance), prior=prior)
    unrest = _unrest(t_s, np.linalg.norm(triad.physical(measured), axis=1) - magnitude)
    shaken = unrest[:, None] ** 2 * np.sum(triad.sensitivity**2, axis=1)  # a hand accelerates along all axes
    data = TriadPoses.of(measured, magnitude, variance=variance + shaken)
    triad = fit_triad(data, prior=prior)
    force = triad.physical(measured)
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    correction = invert_matrix(triad.sensitivity)
    free = triad.free[:12]
    weight = triad.used / triad.magnitude_sigma
    pull = up @ correction
    jacobian = -np.concatenate([(pull[:, :, None] * force[:, None, :]).reshape(-1, 9), pull], axis=1)
    return GravityFit(
        triad=triad,
        used=triad.used,
        up=up,
        sigma=np.sqrt(unrest**2 + triad.extra_sigma**2 + float(np.mean(variance * np.sum(correction**2, axis=0))))
        / gravity_m_s2,
        by_parameters=by_direction(force, correction)[:, :, free],
        stage=Stage(
            residual=triad.magnitude_error * weight,
            jacobian=jacobian[:, free] * weight[:, None],
            covariance=triad.covariance[:12, :12][np.ix_(free, free)],
            precision=None if prior is None else prior.precision[:12, :12][np.ix_(free, free)],
        ),
    )


def _unrest(t_s: Floats, error: Floats) -> Floats:
    """Return the root mean square of errors around each pose, (n,), not its own: a small error must not weigh more."""
    total = np.concatenate([[0.0], np.cumsum(error**2)])

    def within(span: float) -> tuple[Floats, Floats]:
        low = np.searchsorted(t_s, t_s - span)
        high = np.searchsorted(t_s, t_s + span, side="right")
        return total[high] - total[low], (high - low).astype(np.float64)

    (squares, count), (near, own) = within(_AROUND_S), within(_NEAR_S)
    alone = count == own
    around = np.sqrt(np.where(alone, squares / count, (squares - near) / np.where(alone, 1.0, count - own)))
    return np.maximum(around, np.quantile(around, _QUIET))
