"""How far the platter turns while its picture repeats itself once: by how the pattern moves in the image."""

from fractions import Fraction
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats
from .phase import PhaseTemplate

Complex = NDArray[np.complex128]

_SMOOTHING = 1.2  # cells
_FLOW_HARMONICS = 4
_EDGE = 2  # cells
_RING = 1.5  # cells
_MOST_RINGS, _MOST_WAVES = 200, 40
_STRONGEST = 3
_EXPLAINED = 0.3
_CLEAR_SCORE, _CLEAR_RATIO = 0.25, 2.0
_OBVIOUS_SCORE, _OBVIOUS_RATIO = 0.5, 4.0
_ROUGHLY, _AT_ALL, _CLOSELY = 1.6, 3.0, 1.15
_AMBIGUOUS_RATIO = 1.05


@value_class(eq=True)
class PatternTurn:
    """Motion of the pattern in the image as that of a turning plane.

    Attributes
    ----------
    per_turn : how often the picture repeats itself in a turn of the platter: 1 where no part of a turn looks like
        another, 3 where a third of a turn looks the same; None where the pattern does not tell
    explained : share of the change of the pictures that a turning plane explains
    """

    per_turn: Fraction | None
    explained: float


def pattern_turn(template: PhaseTemplate, shape: tuple[int, int]) -> PatternTurn:
    """Return how the pattern turns while the phase of its repetition advances.

    A picture that a homography moves obeys the transport equation dI/dphase + v . grad I = 0 with the vector field v of
    a 3 x 3 generator. That of a turning plane in perspective has the eigenvalues 0 and +-i a, and a is the angle by
    which it turns while the phase advances by one; its eigenvectors are centre, angle and radius in the plane. Around
    the centre, a harmonic of the repetition has a whole number of waves, which is counted.
    """
    count = min(_FLOW_HARMONICS, template.sampled)
    if count < 1 or min(shape) < 4 * _EDGE:
        return PatternTurn(per_turn=None, explained=0.0)
    maps = template.maps().reshape(-1, *shape).astype(np.complex128)
    trust = float(np.median(template.sigma)) / template.sigma.reshape(shape).astype(np.float64)
    generator, explained = _generator(maps[:count], trust**2)
    values, left = (np.asarray(part, dtype=np.complex128) for part in np.linalg.eig(generator.T))
    turning, still = int(np.argmax(values.imag)), int(np.argmin(np.abs(values.imag)))
    angle = float(values[turning].imag)
    if explained < _EXPLAINED or angle <= 0:
        return PatternTurn(per_turn=None, explained=explained)
    x, y, _ = _coordinates(shape)
    points = np.stack([x, y, np.ones_like(x)], axis=-1)
    polar = (points @ left[:, turning]) / (points @ left[:, still].real)
    votes = [_waves(maps[k] * trust, polar, k + 1, angle) for k in _strongest(maps, template)]
    clear = {vote for vote in votes if vote is not None}
    per_turn = clear.pop() if len(clear) == 1 else None
    return PatternTurn(per_turn=per_turn, explained=explained)


def _coordinates(shape: tuple[int, int]) -> tuple[Floats, Floats, float]:
    """Return x and y of the cells about the middle, in units of half the width."""
    half = max(shape) / 2
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return (x - (shape[1] - 1) / 2) / half, (y - (shape[0] - 1) / 2) / half, half


def _generator(maps: Complex, trust: Floats) -> tuple[Floats, float]:
    """Fit the generator to the harmonics; return it and the share of the change that it explains.

    Parameters
    ----------
    maps : (h, rows, cols) complex amplitudes
    trust : (rows, cols) weight of the cells
    """
    x, y, half = _coordinates((maps.shape[1], maps.shape[2]))
    inner = (slice(_EDGE, -_EDGE),) * 2
    rows: list[Any] = []
    rights: list[Any] = []
    x, y, weight = x[inner].ravel(), y[inner].ravel(), trust[inner].reshape(-1, 1)
    for k, picture in enumerate(maps, start=1):
        smooth = cv2.GaussianBlur(picture.real, (0, 0), _SMOOTHING) + 1j * cv2.GaussianBlur(
            picture.imag, (0, 0), _SMOOTHING
        )
        dy, dx = (slope[inner].ravel() * half for slope in np.gradient(smooth))
        along = x * dx + y * dy
        columns = (x * dx, y * dx, dx, x * dy, y * dy, dy, -x * along, -y * along)
        rows.append(np.stack(columns, axis=1) * weight / k)
        # Re C e^(ik phase) changes as Re ik C e^(ik phase)
        rights.append(-1j * smooth[inner].ravel() * weight[:, 0])
    left_side, right_side = (np.concatenate(part) for part in (rows, rights))
    design = np.concatenate([np.real(left_side), np.imag(left_side)])
    right = np.concatenate([np.real(right_side), np.imag(right_side)])
    found = np.linalg.lstsq(design, right, rcond=None)[0]
    residual = right - design @ found
    explained = 1 - float(residual @ residual) / max(float(right @ right), 1e-300)
    return np.append(found, 0.0).reshape(3, 3), explained


def _strongest(maps: Complex, template: PhaseTemplate) -> list[int]:
    energy = (np.abs(maps) ** 2 / template.sigma.reshape(maps.shape[1:]) ** 2).sum(axis=(1, 2))
    return np.argsort(-energy[: template.sampled])[:_STRONGEST].tolist()


def _waves(picture: Complex, polar: Complex, harmonic: int, angle: float) -> Fraction | None:
    """Return how many waves a harmonic has around the centre for each of its periods, or None where that is not clear.

    Parameters
    ----------
    picture : (rows, cols) complex amplitude of the harmonic
    polar : (rows, cols) position in the platter's plane as a complex number, up to scale
    angle : of the motion, which must roughly agree
    """
    radius = np.abs(polar)
    width = float(np.median(np.hypot(*np.gradient(radius)))) * _RING
    ring = np.minimum(radius / width, _MOST_RINGS).astype(np.int64).ravel()
    size = np.maximum(np.bincount(ring), 1)
    waves = np.arange(_MOST_WAVES + 1)
    straight = polar / np.maximum(radius, 1e-12)
    score = np.empty(len(waves))
    turned: Any = picture
    for wave in waves:  # along a ring the picture turned back by its waves has one phase
        even = turned.ravel()
        score[wave] = ((np.bincount(ring, even.real) ** 2 + np.bincount(ring, even.imag) ** 2) / size).sum()
        turned = turned * straight
    score /= max(float((np.abs(picture) ** 2).sum()), 1e-300)
    top = int(np.argmax(score))
    second = float(np.delete(score, top).max())
    if top == 0 or score[top] < max(_CLEAR_SCORE, _AMBIGUOUS_RATIO * second):
        return None
    obvious = score[top] > max(_OBVIOUS_SCORE, _OBVIOUS_RATIO * second)
    limit = _AT_ALL if obvious else _ROUGHLY if score[top] > _CLEAR_RATIO * second else _CLOSELY
    agrees = 1 / limit < top * angle / harmonic < limit
    return Fraction(top, harmonic) if agrees else None
