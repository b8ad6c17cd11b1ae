"""How much of each rotation the gyroscope felt, as a gyroscope shows it whose range or unit changed half-way."""

import numpy as np

from ...recording import Floats
from .magnitude import fit_magnitude
from .problem import MultiPositionProblem

_LEAST_TILT = 0.5  # of gravity's unit vector; what turns about the vertical more than that tells too little


def turning_factors(problem: MultiPositionProblem) -> Floats:
    """Return what the gyroscope showed of each rotation over how far gravity turned, (m,) [its unit per rad/s].

    Gravity's direction u turns by u' = -omega x u in the body, so that of readings y = s omega the integral of -y x u
    is s times the change of u, with u all along the motion as the accelerometer has it: roughly, a fifth or so, but
    without any guess, and without the ambiguity of whole turns. See `linear_start`.

    Returns
    -------
    (m,), nan where gravity hardly changed its direction
    """
    data, segments = problem.data, problem.data.segments
    fit = fit_magnitude(data.accelerometer, 1.0)
    u_path = _directions((segments.accelerometer - fit.bias) @ fit.correction.T)
    change = np.diff(_directions((data.accelerometer - fit.bias) @ fit.correction.T), axis=0)
    at_rest = 0.5 * (data.gyroscope[:-1] + data.gyroscope[1:])  # before and after: its bias may have changed, too
    rates = (segments.gyroscope - np.repeat(at_rest, segments.lengths, axis=0)) * problem.gyroscope.spread
    weight = 0.5 * segments.dt_s
    weight[1:] += 0.5 * segments.dt_s[:-1]
    felt = -np.add.reduceat(np.cross(weight[:, None] * rates, u_path), segments.first)
    square = np.einsum("ki,ki->k", change, change)
    told = square > _LEAST_TILT**2
    return np.where(told, np.einsum("ki,ki->k", felt, change) / np.where(told, square, 1.0), np.nan)


def _directions(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
