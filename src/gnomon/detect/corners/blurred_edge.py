"""The normal distribution, as fast as pixels need it: what a Gaussian blur makes of an edge."""

import numpy as np

from .corner_windows import Singles

_FAR = np.float32(60.0)  # squared, in units of the blur


def normal_distribution(a: Singles) -> tuple[Singles, Singles]:
    """Return 2 Phi(a) - 1 and phi(a); the former to 2.5e-5 (Abramowitz and Stegun 7.1.25)."""
    square = a * a
    np.minimum(square, _FAR, out=square)  # beyond, there is nothing but denormal numbers, which are slow
    square *= -0.5
    exponential = np.exp(square, out=square)
    t = np.abs(a)
    t *= np.float32(0.47047 / np.sqrt(2))
    t += 1
    np.reciprocal(t, out=t)
    series = t * np.float32(0.7478556)
    series -= np.float32(0.0958798)
    series *= t
    series += np.float32(0.3480242)
    series *= t
    series *= exponential
    exponential *= np.float32(1 / np.sqrt(2 * np.pi))
    return np.copysign(1 - series, a), exponential
