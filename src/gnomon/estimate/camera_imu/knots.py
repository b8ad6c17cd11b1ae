"""How many knots the trajectory needs, and how many the IMU supports.

A spline of order 6 follows motion up to about 1/4.5 of its knot rate within a hundredth of usual noise (measured: the
error falls from twenty sigmas at 2.5 knots a period to 0.01 at 4.5). Up to which frequency there is motion shows in the
spectrum of the IMU's readings above their floor of white noise. More knots cost no accuracy, but from half the IMU's
rate on they would follow its noise.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...recording import Floats
from .batch import NoiseLevels
from .trajectory import Trajectory

KNOTS_PER_PERIOD = 4.5
DEFAULT_PER_S = 50.0
LARGEST_SHARE = 0.5
"""Knots per IMU sample that the IMU supports at most."""

_PREFERRED_SHARE = 1 / 3
_WINDOW_S = 2.56
_STRAYS = 0.1
"""Sigmas of the mean between two bends of a bias, by which it may stray from the straight line."""
_EXCESS = 0.03
"""Share of the noise that motion above the limit may add."""


def knots_per_s(*signals: tuple[Floats, Floats], rate_hz: float | None = None) -> float:
    """Return the knots per second for the motion in an IMU's signals.

    Parameters
    ----------
    signals : timestamps (n,) [s] and readings (n, 3) of each triad
    rate_hz : sample rate that supports the knots; that of the slowest signal where it is not given
    """
    rates = [1 / float(np.median(steps[steps > 0])) for steps in (np.diff(t_s) for t_s, _ in signals)]
    highest = max(motion_limit_hz(t_s, values, rate) for (t_s, values), rate in zip(signals, rates, strict=True))
    rate = rate_hz or min(rates)  # the slower triad must not be followed into its noise
    wanted = max(KNOTS_PER_PERIOD * highest, min(DEFAULT_PER_S, _PREFERRED_SHARE * rate))
    return float(np.clip(5 * np.ceil(wanted / 5 - 1e-9), 5.0, LARGEST_SHARE * rate))


def with_tied_biases(trajectory: Trajectory, noise: NoiseLevels, rates_hz: Sequence[tuple[float, float]]) -> Trajectory:
    """Return the trajectory, its biases bending less often where their walks are far below the readings' noise.

    Between bends T apart a random walk strays by half of its sigma sqrt(T) from the straight line, while readings tell
    the mean over T to their density / sqrt(T).

    Parameters
    ----------
    rates_hz : of gyroscope and accelerometer of each IMU
    """
    grid = trajectory.grid
    apart_s = grid.spacing_s * (grid.order - 1)
    strays = [
        0.5 * walk * apart_s / (sigma / rate**0.5)
        for levels, walks, rates in zip(noise.imus, noise.walks, rates_hz, strict=True)
        for sigma, walk, rate in zip((levels.gyroscope, levels.accelerometer), walks, rates, strict=True)
    ]
    tied = len(grid.segments) == 1 and grid.order > 2 and max(strays) < _STRAYS
    return replace(trajectory, grid=replace(grid, tied=tied))


def motion_limit_hz(t_s: Floats, values: Floats, rate_hz: float) -> float:
    """Return the frequency above which a signal (n, 3) holds no more than its noise [Hz]."""
    frequency, power = power_spectrum(t_s, values, rate_hz)
    floor = float(np.median(power[len(power) * 3 // 4 :]))
    excess = np.cumsum((power - floor)[::-1])[::-1]
    beyond = np.flatnonzero(excess > _EXCESS * floor * len(power))
    return float(frequency[min(beyond[-1] + 1, len(frequency) - 1)]) if len(beyond) else 0.0


def power_spectrum(t_s: Floats, values: Floats, rate_hz: float) -> tuple[Floats, Floats]:
    """Return frequencies (f,) [Hz] and the mean power spectral density (f,) of the three axes [unit^2/Hz]."""
    uniform = np.arange(t_s[0], t_s[-1], 1 / rate_hz)
    signal = np.stack([np.interp(uniform, t_s, values[:, i]) for i in range(3)], axis=1)
    size = max(16, min(len(signal), 2 ** round(np.log2(_WINDOW_S * rate_hz))))
    starts = np.arange(0, max(len(signal) - size, 0) + 1, size // 2)
    window = np.hanning(size)[:, None]
    power = np.zeros(size // 2 + 1)
    for start in starts:
        part = signal[start : start + size]
        if len(part) < size:
            break
        trend = np.linspace(0, 1, size)[:, None]
        part = part - part[:1] - trend * (part[-1:] - part[:1])
        part = part - part.mean(axis=0)
        power += (np.abs(np.fft.rfft(part * window, axis=0)) ** 2).mean(axis=1)
    power *= 2 / (rate_hz * float((window**2).sum()) * max(len(starts), 1))
    return np.asarray(np.fft.rfftfreq(size, 1 / rate_hz)[1:], dtype=np.float64), power[1:]
