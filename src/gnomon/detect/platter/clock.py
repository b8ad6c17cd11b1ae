"""What the timestamps of a video are worth: a clock, or a number of frames."""

import numpy as np

from ...recording import Floats, Integers

MEASURED_CLOCK, NOMINAL_CLOCK, UNCHECKED_CLOCK = 5e-5, 1e-3, 5e-3
"""Relative standard deviation of the time that timestamps tell: by a quartz that stamped the frames; by a frame rate
that the video merely states (29.97 against 30 frames per second, and what cameras make of it); the same where frames
may be missing, unnoticed."""

_ROUNDING_S = 6e-4  # Matroska rounds to 1 ms
_FEWEST = 8
_EVEN_S = 1e-6


def stamps_are_nominal(t_s: Floats) -> bool:
    """Tell whether frames stand at even times, so that the video states a frame rate and no times."""
    if len(t_s) < _FEWEST:
        return True
    steps = np.diff(t_s)
    step = float(np.median(steps))
    off = t_s - t_s[0]
    for _ in range(3):  # frames may be missing
        number = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / step), 1))])
        step, start = np.polyfit(number, t_s, 1).tolist()
        off = t_s - start - step * number
    return bool(np.abs(off).max() < _ROUNDING_S)


def rate_by_jitter(t_s: Floats, off: Floats) -> tuple[float, float]:
    """Return by how much the phase changes more with irregular timestamps than a line has it, and its sigma [rad/s].

    Between two frames a platter may have made whole turns more than it seems. Where frames come irregularly, its
    phase then runs ahead and behind with them.

    Parameters
    ----------
    t_s : (n,) timestamps [s]
    off : (n,) phase less that of a line [rad]
    """
    uneven = np.diff(t_s, 2)
    bent = np.diff(off, 2)
    usual = np.abs(uneven - np.median(uneven)) < 8 * np.median(np.abs(uneven - np.median(uneven))) + 1e-9
    kept = usual & (np.abs(bent) < 1.0)
    x, y = uneven[kept], bent[kept]
    power = float(x @ x)
    if len(x) < 20 or power <= len(x) * _EVEN_S**2:
        return 0.0, np.inf
    slope = float(x @ y) / power
    spread = float(np.sqrt(np.mean((y - slope * x) ** 2)))
    return slope, spread * np.sqrt(3.0 / power)  # of second differences every third is new


def missing_frames(step_s: float, index: Integers, t_s: Floats, phase: Floats) -> tuple[Integers, float]:
    """Return how many frames are missing before each one, in a video whose timestamps merely count frames.

    Where one is missing the phase makes two steps at once, where one is repeated none.

    Parameters
    ----------
    step_s : from frame to frame, as the video states it [s]
    index : (n,) numbers of the frames in the video
    t_s : (n,) their timestamps [s]
    phase : (n,) [rad], unwrapped

    Returns
    -------
    missing : (n,) since the first
    clearness : the usual step of the phase, in units of its noise
    """
    beside = np.diff(index) == 1
    steps = np.maximum(np.rint(np.diff(t_s) / step_s), 1)
    ahead = np.diff(phase)
    usual = float(np.median(ahead[beside] / steps[beside]))
    extra = np.where(beside, np.rint(ahead / usual) - steps, 0)
    noise = 1.4826 * float(np.median(np.abs(ahead - usual * (steps + extra))[beside]))
    return np.concatenate([[0], np.cumsum(extra)]).astype(np.int64), abs(usual) / max(noise, 1e-12)
