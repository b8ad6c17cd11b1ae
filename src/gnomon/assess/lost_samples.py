"""Samples that are missing from a recording without stamps, by the jumps that they leave in smooth motion."""

import numpy as np

from ..findings import Finding, make_finding
from ..recording import Floats, TriadSamples

_SIDE = 4  # samples on either side that tell how fast a signal changes
_STEEP = 7.0  # that change from sample to sample, in units of the noise
_ASIDE, _NEAR = 0.35, 0.3  # of that change
_FEWEST_STEEP, _FEWEST, _TIMES = 200, 6, 4.0
_QUIET, _PIECE = 0.1, 50
_SHARE_WARN = 1e-3


def check_lost_samples(samples: TriadSamples, label: str) -> list[Finding]:
    """Look for samples that were lost where stamps are a mere count of samples.

    In smooth motion a value is as far from the next one as its neighbours are from theirs; over a sample that was lost
    it is twice as far. Motion that is not smooth makes steps of half and of no length as often as of twice, and tells
    nothing.
    """
    steps = np.diff(samples.t_ns)
    if len(steps) < _FEWEST_STEEP or np.ptp(steps) > max(2, 1e-6 * float(np.median(steps))):
        return []
    extra = _extra_steps(samples.values)
    doubled, none = (int(np.count_nonzero(np.abs(extra - size) < _NEAR)) for size in (1.0, -1.0))
    share = (doubled - none) / max(len(extra), 1)
    if len(extra) < _FEWEST_STEEP or doubled < _FEWEST + _TIMES * none or share < _SHARE_WARN:
        return []
    return [make_finding("samples-skipped", label=label, share=share, doubled=doubled, count=len(extra))]


def _extra_steps(values: Floats) -> Floats:
    """Return by how much steps differ from those beside them, in units of these, where they are steep and straight."""
    n = len(values)
    k = np.arange(_SIDE, n - 1 - _SIDE)
    usual = ((values[k] - values[k - _SIDE]) + (values[k + 1 + _SIDE] - values[k + 1])) / (2 * _SIDE)
    size = np.linalg.norm(usual, axis=1)
    steep = size > max(_STEEP * _noise(values), 1e-300)
    usual, size, step = usual[steep], size[steep], (values[k + 1] - values[k])[steep]
    extra = np.einsum("ni,ni->n", step - usual, usual) / size**2
    aside = np.linalg.norm(step - usual * (1 + extra)[:, None], axis=1) / size
    return np.asarray(extra[aside < _ASIDE], dtype=np.float64)


def _noise(values: Floats) -> float:
    """Return the standard deviation of a sample's component where the signal is quietest [unit]."""
    third = np.diff(values, n=3, axis=0)  # of white noise, 20 times its variance
    count = len(third) // _PIECE
    power = np.square(third[: count * _PIECE]).reshape(count, _PIECE * 3).mean(axis=1)
    return float(np.sqrt(np.quantile(power, _QUIET) / 20)) if count else 0.0
