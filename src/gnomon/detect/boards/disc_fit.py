"""Middles of discs to sub-pixel accuracy: maximum likelihood fit of a blurred ellipse.

The outline is where q = |B (x - c)| = 1, with a symmetric matrix B; near it the distance inwards is
d = (1 - q) / |grad q|, and a Gaussian blur of standard deviation s makes the picture

    I = (white - (white - black) Phi(d / s)) (1 + light (x - c)).

Ten parameters a disc (middle, B, blur, two grey levels, slope of the light along x and y) are fitted to the pixels
near the outline by Gauss-Newton, all discs of an image at once. The picture of an ellipse is point symmetric: no error
of the blur's shape moves its middle.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.frames import Grey
from ..corners.corner_windows import PointFits, Singles, damp_diagonals, normal_distribution, pack_rows

_PARAMETERS = 10
_ITERATIONS, _CONVERGED_PX, _MOST = 6, 0.01, 0.9  # the next step would be its square
_CENTRE, _OUTLINE, _BLUR, _WHITE, _CONTRAST, _LIGHT = slice(0, 2), slice(2, 5), 5, 6, 7, slice(8, 10)
_BAND_PX = 3.5  # pixels farther from the outline tell nothing
_FIRST_BLUR_PX = 0.8
_BLUR_PX = (0.15, 4.0)
_FARTHEST = 0.4  # from the guess, over the smaller half axis, beyond a pixel
_LEAST_CONTRAST = 8.0  # grey levels
_MISFIT = 0.12  # rms of the residuals over the contrast
_LARGEST_SIGMA_PX = 0.25
_MODEL_SIGMA_PX = 0.005  # what the model leaves out


@value_class
class DiscFits(PointFits):
    """Discs as they were fitted, by the middles of their ellipses.

    Attributes
    ----------
    shape : (m, 2, 2) symmetric: the outline is where (x - middle)' inv(shape) (x - middle) = 1 [px^2]
    inside, outside : (m,) grey levels
    """

    shape: Floats
    inside: Floats
    outside: Floats


def fit_discs(image: Grey, guess: Floats, shape: Floats, reach: float) -> DiscFits:
    """Fit discs, dark or light ones.

    Parameters
    ----------
    image : (h, w)
    guess : (m, 2) middles, to a pixel
    shape : (m, 2, 2) outlines as in `DiscFits`, to a pixel
    reach : how far there is nothing else, from the middle, over the radius of a disc
    """
    squares, axes = np.linalg.eigh(shape)
    half = np.sqrt(np.maximum(squares, 0.25))
    B = np.einsum("nij,nj,nkj->nik", axes, 1 / half, axes)
    middle = np.rint(guess).astype(np.int64)
    windows = _gathered(image, middle, guess - middle, B, reach)
    state = _start(windows, guess - middle, B)
    normal, pixels = _normal_equations(windows, state)
    for _ in range(_ITERATIONS):
        step = _step(normal)
        state += step
        state[:, _BLUR] = state[:, _BLUR].clip(*_BLUR_PX)
        normal, pixels = _normal_equations(windows, state)
        if (np.abs(step[:, _CENTRE]) < _CONVERGED_PX).mean() > _MOST:
            break
    return _judged(state, normal, pixels, (guess - middle, middle, half[:, 0]))


@value_class
class _Windows:
    """Pixels near outlines, (m, n): values, places relative to a middle, and weights."""

    values: Singles
    x: Singles
    y: Singles
    weight: Singles


def _gathered(image: Grey, middle: Integers, centre: Floats, B: Floats, reach: float) -> _Windows:
    longest = float(1 / np.sqrt(np.linalg.eigvalsh(B @ B)[:, 0].min()))
    height, width = image.shape
    side = int(np.ceil(min(longest * reach, longest + _BAND_PX))) + 1
    offset = np.arange(-side, side + 1)
    x, y = np.tile(offset, len(offset)), np.repeat(offset, len(offset))
    dx, dy = (x - centre[:, :1]).astype(np.float32), (y - centre[:, 1:]).astype(np.float32)
    q, slope = _outlined(dx, dy, B.astype(np.float32))
    d = (1 - q) / slope
    u, v = middle[:, :1] + x, middle[:, 1:] + y
    chosen = (np.abs(d) < _BAND_PX) & (q < reach) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    index, weight = pack_rows(chosen)
    u, v = np.take_along_axis(u, index, 1).clip(0, width - 1), np.take_along_axis(v, index, 1).clip(0, height - 1)
    return _Windows(
        values=image[v, u].astype(np.float32),
        x=x[index].astype(np.float32),
        y=y[index].astype(np.float32),
        weight=weight,
    )


def _outlined(dx: Singles, dy: Singles, B: Singles) -> tuple[Singles, Singles]:
    """Return q and the length of its gradient, (m, n), at places relative to the middle."""
    b11, b12, b22 = B[:, 0, 0, None], B[:, 0, 1, None], B[:, 1, 1, None]
    w1, w2 = b11 * dx + b12 * dy, b12 * dx + b22 * dy
    q = np.sqrt(w1 * w1 + w2 * w2 + np.float32(1e-6))
    return q, np.hypot(b11 * w1 + b12 * w2, b12 * w1 + b22 * w2) / q + np.float32(1e-6)


def _start(windows: _Windows, centre: Floats, B: Floats) -> Floats:
    state = np.zeros((len(centre), _PARAMETERS))
    state[:, _CENTRE] = centre
    state[:, _OUTLINE] = B[:, [0, 0, 1], [0, 1, 1]]
    state[:, _BLUR] = _FIRST_BLUR_PX
    dx, dy = windows.x - centre[:, :1].astype(np.float32), windows.y - centre[:, 1:].astype(np.float32)
    q, _ = _outlined(dx, dy, B.astype(np.float32))
    inner, outer = (windows.weight * (q < 1)), (windows.weight * (q > 1))
    inside = (windows.values * inner).sum(axis=1) / np.maximum(inner.sum(axis=1), 1)
    state[:, _WHITE] = (windows.values * outer).sum(axis=1) / np.maximum(outer.sum(axis=1), 1)
    state[:, _CONTRAST] = state[:, _WHITE] - inside
    return state


def _normal_equations(windows: _Windows, state: Floats) -> tuple[Floats, Floats]:
    """Return J'J with J'r as last row and column, (m, 11, 11), and how many pixels count (m,)."""
    s = state.astype(np.float32)[:, :, None]
    dx, dy = windows.x - s[:, 0], windows.y - s[:, 1]
    b11, b12, b22 = s[:, 2], s[:, 3], s[:, 4]
    w1, w2 = b11 * dx + b12 * dy, b12 * dx + b22 * dy
    q = np.sqrt(w1 * w1 + w2 * w2 + np.float32(1e-6))
    g1, g2 = b11 * w1 + b12 * w2, b12 * w1 + b22 * w2  # the gradient of q, times q
    slope = np.sqrt(g1 * g1 + g2 * g2) + np.float32(1e-6)  # the same
    a = (1 - q) * q / (slope * s[:, _BLUR])
    signed, phi = normal_distribution(a)
    inside = 0.5 * (1 + signed)
    light = 1 + s[:, 8] * dx + s[:, 9] * dy
    grey = s[:, _WHITE] - s[:, _CONTRAST] * inside
    model = grey * light
    # of the model by d, over the slope of q: the distance falls as q rises
    by_q = windows.weight * s[:, _CONTRAST] * phi / (s[:, _BLUR] * slope)
    J = np.empty((len(state), _PARAMETERS + 1, windows.x.shape[1]), np.float32)
    np.multiply(-by_q, g1, out=J[:, 0])
    np.multiply(-by_q, g2, out=J[:, 1])
    np.multiply(by_q, w1 * dx, out=J[:, 2])
    np.multiply(by_q, w1 * dy + w2 * dx, out=J[:, 3])
    np.multiply(by_q, w2 * dy, out=J[:, 4])
    np.multiply(windows.weight * s[:, _CONTRAST] / s[:, _BLUR], phi * a, out=J[:, _BLUR])
    J[:, _WHITE] = windows.weight
    np.multiply(-windows.weight, inside, out=J[:, _CONTRAST])
    np.multiply(windows.weight * grey, dx, out=J[:, 8])
    np.multiply(windows.weight * grey, dy, out=J[:, 9])
    np.multiply(windows.weight, windows.values - model, out=J[:, -1])
    normal = np.matmul(J, J.transpose(0, 2, 1)).astype(np.float64)
    return normal, windows.weight.sum(axis=1).astype(np.float64)


def _step(normal: Floats) -> Floats:
    """Return the Gauss-Newton step, (m, 10), slightly damped and of bounded length."""
    matrix = _damped(normal)
    step = np.asarray(np.linalg.solve(matrix, normal[:, :-1, -1:]), np.float64)[:, :, 0]
    longest = np.maximum(np.abs(step[:, _CENTRE]).max(axis=1), 2 * np.abs(step[:, _BLUR]))
    return step / np.maximum(longest, 1)[:, None]


def _damped(normal: Floats) -> Floats:
    matrix = normal[:, :-1, :-1].copy()
    damp_diagonals(matrix)
    return matrix


def _judged(state: Floats, normal: Floats, pixels: Floats, guessed: tuple[Floats, Integers, Floats]) -> DiscFits:
    start, middle, smallest = guessed
    regular = np.asarray(np.isfinite(state).all(axis=1) & np.isfinite(normal).all(axis=(1, 2)), np.bool_)
    state = np.where(regular[:, None], state, 1.0)
    normal = np.where(regular[:, None, None], normal, np.eye(_PARAMETERS + 1))
    variance = normal[:, -1, -1] / np.maximum(pixels - _PARAMETERS, 1)
    place = np.linalg.inv(_damped(normal))[:, :2, :2]
    contrast = np.abs(state[:, _CONTRAST])
    B = state[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    whole = np.linalg.det(B) > 1e-9
    inverse = np.linalg.inv(np.where(whole[:, None, None], B, np.eye(2)))
    sigma = np.sqrt(np.maximum(place[:, 0, 0] + place[:, 1, 1], 0) / 2 * variance + _MODEL_SIGMA_PX**2)
    misfit = np.sqrt(variance) / np.maximum(contrast, 1)
    moved = np.linalg.norm(state[:, _CENTRE] - start, axis=1)
    good = (
        regular
        & whole
        & (moved < 1 + _FARTHEST * smallest)
        & (contrast > _LEAST_CONTRAST)
        & (misfit < _MISFIT)
        & (sigma < _LARGEST_SIGMA_PX)
    )
    return DiscFits(
        pixels=middle + state[:, _CENTRE],
        sigma_px=sigma,
        shape=inverse @ inverse,
        blur_px=state[:, _BLUR],
        inside=state[:, _WHITE] - state[:, _CONTRAST],
        outside=state[:, _WHITE],
        misfit=misfit,
        good=good,
    )
