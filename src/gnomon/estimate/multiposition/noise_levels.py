"""Noise levels of the multi-position problem from its own residuals (variance components).

What the noise at rest does not explain is put into three extra variances: of the accelerometer and of the gyroscope
between static intervals, and of the rotations. Each is zero unless the residuals prove otherwise.

Motion between samples: what the integration of rotations does not see.

Integrated with every second sample, a rotation ends elsewhere: by the noise of the samples that are left out, whose
variance is that of the whole rotation, and by what the motion did between those that are kept. The integration is of
second order, so that all samples leave a third of the latter.
"""

from dataclasses import fields, replace

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats
from ...recording.samples import median_of
from ...results.result import Booleans
from ...solve.least_squares import ArrowSolution
from .measurements import MotionSegments, integrate_rates
from .model import MultiPositionData, MultiPositionLinearization, MultiPositionState, Whitening

_ORDER = 3.0  # error with every second sample over that with all, less one
_SURE = 4.0  # sigmas of chi-square


def with_sampling_error(data: MultiPositionData, state: MultiPositionState) -> MultiPositionData:
    """Return the data with the variance of rotations by motion between samples, where it stands out from the noise.

    Parameters
    ----------
    data : the problem
    state : near the best
    """
    s, b, c_g, b_g, g = state.matrices
    linked = data.linked
    if not linked.any():
        return data
    segments = data.segments
    force = (segments.accelerometer - b) @ invert_matrix(s).T
    omega = (segments.gyroscope - b_g - force @ g.T) @ c_g.T
    halved, kept = _every_second(segments)
    difference = np.einsum(
        "kji,kjl->kil",
        integrate_rates(segments, omega).rotation[linked],
        integrate_rates(halved, omega[kept]).rotation[linked],
    )
    skew = 0.5 * (difference - np.swapaxes(difference, 1, 2))
    squares = 0.5 * np.einsum("kij,kij->k", skew, skew)  # of the sine of the angle between both
    noise = 3 * rotation_variance(data, state)[linked]
    excess = float(np.sum(squares - noise))
    if excess <= _SURE * float(np.sqrt(2 / 3 * np.sum(noise**2))):
        return data
    return replace(data, sampling_variance=excess / (3 * len(noise)) / _ORDER**2)


def _every_second(segments: MotionSegments) -> tuple[MotionSegments, Booleans]:
    """Return the rotations with every second sample and the last, and which samples these are."""
    kept = np.zeros(len(segments.dt_s), dtype=bool)
    for first, length in zip(segments.first, segments.lengths, strict=True):
        kept[first : first + length : 2] = True
    kept[segments.first + segments.lengths - 1] = True
    lengths = segments.lengths // 2 + 1
    instants = np.cumsum(segments.dt_s) - segments.dt_s  # dt is 0 at the last sample of each
    dt_s = np.append(np.diff(instants[kept]), 0.0)
    dt_s[np.cumsum(lengths) - 1] = 0.0
    halved = MotionSegments(
        gyroscope=segments.gyroscope[kept], accelerometer=segments.accelerometer[kept], dt_s=dt_s, lengths=lengths
    )
    return halved, kept


@value_class
class ExtraVariance:
    """Variances beyond the noise at rest.

    Attributes
    ----------
    accelerometer : of an interval's mean specific force, per axis [g^2]
    gyroscope : of an interval's mean rate, per axis [(rad/s)^2]
    rotation : of a rotation, per axis [rad^2]
    """

    accelerometer: float = 0.0
    gyroscope: float = 0.0
    rotation: float = 0.0

    def agrees_with(self, other: "ExtraVariance") -> bool:
        """Return whether all three agree to 5 %."""
        pairs = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return all(abs(a - b) <= 0.05 * max(a, b) for a, b in pairs)


def whitened_rest(data: MultiPositionData, state: MultiPositionState, extra: ExtraVariance) -> tuple[Floats, Floats]:
    """Return inverse roots (n, 3, 3) of the covariances of the accelerometer's and the gyroscope's means at rest."""
    s, _, c_g, _, _ = state.matrices
    s_g = invert_matrix(c_g)
    gyroscope = extra.gyroscope + data.earth_rate_variance
    return (
        _inverse_root(data.accelerometer_variance, extra.accelerometer * s @ s.T),
        _inverse_root(data.gyroscope_variance, gyroscope * s_g @ s_g.T),
    )


def rotation_variance(data: MultiPositionData, state: MultiPositionState) -> Floats:
    """Return the variance of each rotation by noise, earth rate and sampling, (n - 1,), per axis [rad^2].

    Attitudes change during a rotation, so that the gyroscope's axes share their noise evenly.
    """
    c_g = state.matrices[2]
    noise = data.rotation_variance @ (c_g**2).sum(axis=0) / 3
    noise += data.earth_rate_variance * data.segments.duration_s**2 + data.sampling_variance
    return np.maximum(noise, np.finfo(float).tiny)


def estimate_extra_variance(
    data: MultiPositionData,
    state: MultiPositionState,
    lines: MultiPositionLinearization,
    arrow: ArrowSolution,
    whitening: Whitening,
    *,
    free: Booleans,
    robust: bool,
) -> ExtraVariance:
    """Return the extra variances at which the residuals' squares are what they should be.

    Parameters
    ----------
    data, state : the problem and where it stands
    lines : residuals at the solution
    arrow, whitening, free : the solution's covariance, and the weights and parameters it was found with
    robust : take medians for means, so that outliers do not count
    """
    s, _, c_g, _, _ = state.matrices
    turns = rotation_variance(data, state)
    modes = (
        _modes(lines.accelerometer, data.accelerometer_variance, s, 0.0),
        _modes(lines.gyroscope, data.gyroscope_variance, invert_matrix(c_g), data.earth_rate_variance),
        (lines.rotation**2 / turns[:, None], 1 / np.stack([turns, turns], axis=1)),
    )
    redundancy = residual_freedom(lines, arrow, whitening, free)
    kept = (whitening.accelerometer[:, 0, 0] > 0, whitening.gyroscope[:, 0, 0] > 0, whitening.rotation > 0)
    matching = _robust_variance if robust else _matching_variance
    found = [
        matching(squares[k], gains[k], float(np.sum(dof[k])))
        for (squares, gains), dof, k in zip(modes, redundancy, kept, strict=True)
    ]
    return ExtraVariance(accelerometer=found[0], gyroscope=found[1], rotation=found[2])


def _inverse_root(white: Floats, extra: Floats) -> Floats:
    """Return inverse Cholesky factors (n, 3, 3) of diag(white_k) + extra."""
    covariance = extra + white[:, :, None] * np.eye(3)
    return invert_matrix(np.linalg.cholesky(covariance).astype(np.float64))


def _modes(residual: Floats, white: Floats, root: Floats, floor: float) -> tuple[Floats, Floats]:
    """Return squares and gains (n, 3) with r' inv(V + v root root') r = sum of squares / (1 + v gains).

    V = diag(white) + floor root root' is what is known of the variance.
    """
    whitener = _inverse_root(white, floor * root @ root.T)
    scaled = whitener @ root
    gains, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    plain = np.einsum("kij,kj->ki", whitener, residual)
    return np.einsum("kij,ki->kj", vectors, plain) ** 2, np.maximum(gains, 0.0)


def interval_rows(
    name: str, lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return the whitened rows A of a group at rest, and their gain P A' with the covariance P of what they touch.

    Parameters
    ----------
    name : "accelerometer" or "gyroscope"

    Returns
    -------
    (n, 3, 2 + p) rows by the interval's direction and the p free parameters, and (n, 2 + p, 3) gain
    """
    whitener = getattr(whitening, name)
    by_u, by_theta = whitener @ getattr(lines, f"{name}_u"), whitener @ getattr(lines, f"{name}_theta")[..., free]
    u, theta = np.swapaxes(by_u, 1, 2), np.swapaxes(by_theta, 1, 2)
    cross = arrow.cross_covariance
    gain = np.concatenate(
        [
            arrow.state_covariance @ u + cross @ theta,
            np.swapaxes(cross, 1, 2) @ u + np.swapaxes(by_theta @ arrow.corner_covariance, 1, 2),
        ],
        axis=1,
    )
    return np.concatenate([by_u, by_theta], axis=2), gain


def rotation_rows(
    lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return the whitened rows A of the rotations, (n - 1, 2, 4 + p), and their gain P A', (n - 1, 4 + p, 2)."""
    weight = whitening.rotation[:, None, None]
    first, theta_rows = weight * lines.rotation_u, weight * lines.rotation_theta[..., free]
    second = weight * np.eye(2)
    u, v, theta = (np.swapaxes(rows, 1, 2) for rows in (first, second, theta_rows))
    own, following, cross = arrow.state_covariance, arrow.next_covariance, arrow.cross_covariance
    gain = np.concatenate(
        [
            own[:-1] @ u + following @ v + cross[:-1] @ theta,
            np.swapaxes(following, 1, 2) @ u + own[1:] @ v + cross[1:] @ theta,
            np.swapaxes(cross[:-1], 1, 2) @ u
            + np.swapaxes(cross[1:], 1, 2) @ v
            + np.swapaxes(theta_rows @ arrow.corner_covariance, 1, 2),
        ],
        axis=1,
    )
    return np.concatenate([first, second, theta_rows], axis=2), gain


def residual_freedom(
    lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats, Floats]:
    """Return trace(I - H) of each interval's accelerometer and gyroscope residuals and of each rotation's."""
    groups = (
        interval_rows("accelerometer", lines, arrow, whitening, free),
        interval_rows("gyroscope", lines, arrow, whitening, free),
        rotation_rows(lines, arrow, whitening, free),
    )
    traces = [np.einsum("kij,kji->k", rows, gain) for rows, gain in groups]
    return 3.0 - traces[0], 3.0 - traces[1], 2.0 - traces[2]


def _robust_variance(squares: Floats, gains: Floats, dof: float) -> float:
    """Return one extra variance from the median square, against the median of chi-square with as many degrees."""
    if dof < 1:
        return 0.0
    degrees = dof / len(squares)
    expected = degrees * max(1 - 2 / (9 * degrees), 0.1) ** 3  # Wilson and Hilferty
    excess = float(median_of(np.sum(squares, axis=1))) / expected - 1
    return max(excess, 0.0) / float(median_of(gains))


def _matching_variance(squares: Floats, gains: Floats, dof: float) -> float:
    """Return the extra variance v at which the sum of squares / (1 + v gains) is its expectation, dof.

    Nothing is added unless the excess over the noise at rest is significant (three sigma of chi-square), so that
    recordings which the noise explains keep its exactly known level.
    """
    if dof < 1 or np.sum(squares) <= dof + 3 * np.sqrt(2 * dof):
        return 0.0
    variance = 0.0
    for _ in range(50):  # Newton from below; the sum is convex and falling, so that no step goes too far
        shrink = 1 / (1 + variance * gains)
        step = (float(np.sum(squares * shrink)) - dof) / float(np.sum(squares * gains * shrink**2))
        variance += step
        if step < 1e-3 * variance:
            break
    return variance
