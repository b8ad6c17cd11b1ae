"""Noise of known coefficients, made block by block, for recordings of any length.

White noise, quantisation (differences of white noise), random walk and ramp follow from their definitions. Noise with a
spectrum of 1/f is the sum of first-order Gauss-Markov processes of equal variance, whose time constants are a factor of
five apart, from a fifth of a sample to ten recordings: their spectra add up to 1/f within 1 % in between.
"""

from collections.abc import Iterator
from math import log, pi, sqrt

import numpy as np

from ..recording import Floats
from ..units import STANDARD_GRAVITY_M_S2
from .scenarios.recorded import NoiseScenario

_RATIO = 5.0
_REACH = 10.0  # recordings
_BLOCK = 1 << 18
_REST = {"accelerometer": (0.0, 0.0, STANDARD_GRAVITY_M_S2), "gyroscope": (0.0, 0.0, 0.0)}


def noise_blocks(scenario: NoiseScenario, sensor: str, seed: int = 0, block: int = _BLOCK) -> Iterator[Floats]:
    """Yield the samples of one sensor at rest, (n, 3) [m/s^2 or rad/s], z up.

    Parameters
    ----------
    sensor : "accelerometer" or "gyroscope"
    seed : every random number follows from it, and from the sensor
    block : samples in a block
    """
    rng = np.random.default_rng([seed, sensor == "gyroscope"])
    found, rate = scenario.of(sensor), scenario.rate_hz
    flicker = _Flicker(found["bias_instability"], scenario.samples, rng)
    walk = np.zeros(3)
    rounding = rng.standard_normal((1, 3))
    for start in range(0, scenario.samples, block):
        count = min(block, scenario.samples - start)
        values = np.tile(np.array(_REST[sensor]), (count, 1))
        values += found["white_noise"] * sqrt(rate) * rng.standard_normal((count, 3))
        values += flicker.block(count)
        if found["random_walk"]:
            steps = np.cumsum(found["random_walk"] / sqrt(rate) * rng.standard_normal((count, 3)), axis=0) + walk
            values += steps
            walk = steps[-1]
        if found["quantisation"]:
            rounded = np.concatenate([rounding, rng.standard_normal((count, 3))])
            values += found["quantisation"] * rate * np.diff(rounded, axis=0)
            rounding = rounded[-1:]
        values += found["rate_ramp"] / rate * np.arange(start, start + count)[:, None]
        yield values


class _Flicker:
    """1/f noise of bias instability B, in consecutive blocks."""

    def __init__(self, instability: float, samples: int, rng: np.random.Generator) -> None:
        count = int(log(_REACH * samples * _RATIO) / log(_RATIO)) + 2
        times = _RATIO ** np.arange(-1.0, count - 1)  # in samples
        self._rng = rng
        self._decay = np.exp(-1 / times) if instability else np.empty(0)
        self._sigma = instability * sqrt(log(_RATIO) / pi)
        self._state = self._sigma * rng.standard_normal((len(self._decay), 3))

    def block(self, count: int) -> Floats:
        """Return the next values (count, 3) of the bias instability, which go on from the last ones."""
        from scipy.signal import lfilter

        values = np.zeros((count, 3))
        for i, decay in enumerate(self._decay.tolist()):
            drive = self._sigma * sqrt(1 - decay**2) * self._rng.standard_normal((count, 3))
            made, _ = lfilter([1.0], [1.0, -decay], drive, axis=0, zi=decay * self._state[i : i + 1])
            self._state[i] = made[-1]
            values += made
        return values
