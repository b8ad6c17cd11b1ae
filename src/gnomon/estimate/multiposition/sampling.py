"""Motion between samples: what the integration of rotations does not see.

Integrated with every second sample, a rotation ends elsewhere: by the noise of the samples that are left out, whose
variance is that of the whole rotation, and by what the motion did between those that are kept. The integration is of
second order, so that all samples leave a third of the latter.
"""

from dataclasses import replace

import numpy as np

from ...geometry.rotation_vector import invert_matrix
from ...results.result import Booleans
from .model import MultiPositionData, MultiPositionState
from .noise_levels import rotation_variance
from .rotations import MotionSegments, integrate_rates

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
