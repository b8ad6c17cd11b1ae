"""Corners to sub-pixel accuracy: maximum likelihood fit of two blurred edges that meet.

Around a corner c two straight edges with normals n1, n2 part black from white. With the distances
a_i = n_i (x - c) / s_i in units of the blur across each edge, a Gaussian blur of the sharp picture gives

    crossing   I = mid - amplitude E[sign(a1 + z1) sign(a2 + z2)]      (X: black wedges opposite each other)
    tip        I = white - 2 amplitude P[a1 + z1 > 0, a2 + z2 > 0]     (L: one black wedge)

where z1, z2 are normal with the correlation rho, which is n1 n2 if the blur is the same all around, and another one if
the camera moves. Of the bivariate normal distribution its expansion in rho is taken,
P = Phi Phi + phi phi (rho + rho^2 a1 a2 / 2). The crossing is point symmetric: no error of the blur's shape moves it. A
tip is moved by such an error, unless longer pieces of its edges are looked at.

Nine parameters a corner (offsets along both normals, angles of both edges, blur across both, correlation, two grey
levels) are fitted to the pixels of a window by Gauss-Newton, all corners of an image at once. Pixels that are saturated
count where the model says that they should not be.
"""

from dataclasses import dataclass, fields
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images import Grey
from ..recording import Floats, Integers

Singles = NDArray[np.floating[Any]]
Booleans = NDArray[np.bool_]
CornerKind = Literal["crossing", "tip"]

LARGEST_RADIUS_PX = 5
SMALLEST_RADIUS_PX = 2.0
LONGEST_ARM_PX = 9.0
"""How far the edges of a tip are looked at."""

_PARAMETERS = 9
_ITERATIONS = 7
_SUBPIX = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 4, 0.03)
_CONVERGED = np.array([0.02, 0.02, 0.05, 0.05, 0.06, 0.06])  # px, rad, px; the next step would be its square
_FIRST_BLUR_PX = (0.35, 2.5)
_BLUR_PX = (0.2, 4.0)
_LARGEST_CORRELATION = 0.95
_WIDEST_BLUR = 0.75  # of the window's radius
_LONGEST_STEP = np.array([1.0, 1.0, 0.35, 0.35, 0.5, 0.5, 0.5])
_FARTHEST_PX, _FARTHEST = 3.0, 0.8  # in px, and of the window's radius
_LEAST_CONTRAST = 8.0  # grey levels between black and white
_MISFIT = 0.12  # rms of the residuals over the contrast
_LEAST_SINE = 0.3  # between the edges
_DAMPING = 1e-4
_BLURS_ALIKE_PX, _CORRELATION_KNOWN = 0.5, 0.5  # before the picture is looked at
_NOISE = 0.02  # of the contrast, for the weight of what is known before
_FAR = np.float32(8.0)
_SATURATED = 255
_MODEL_SIGMA_PX = 0.005  # what a straight edge and a Gaussian blur leave out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """Corners as they were fitted, m of them.

    Attributes
    ----------
    pixels : (m, 2) [px]
    sigma_px : (m,) standard deviation per axis, from the residuals [px]
    blur_px : (m,) standard deviation of the blur, root mean square across both edges [px]
    black, white : (m,) grey levels
    misfit : (m,) rms of the residuals over the contrast
    good : (m,) whether the picture is that of such a corner, near the guess
    """

    pixels: Floats
    sigma_px: Floats
    blur_px: Floats
    black: Floats
    white: Floats
    misfit: Floats
    good: Booleans

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, chosen: NDArray[np.integer] | Booleans) -> "CornerFits":
        """Return some of the corners."""
        return CornerFits(**{item.name: getattr(self, item.name)[chosen] for item in fields(self)})


def joined(first: CornerFits, second: CornerFits) -> CornerFits:
    """Return the corners of both."""
    return CornerFits(
        **{
            item.name: np.concatenate([getattr(first, item.name), getattr(second, item.name)])
            for item in fields(CornerFits)
        }
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Windows:
    """Pixels around the corners, (m, n), and their weights; their places relative to the middle, (m, n) or (1, n)."""

    values: Singles
    x: Singles
    y: Singles
    weight: Singles

    def only(self, chosen: NDArray[np.integer]) -> "_Windows":
        if len(chosen) == len(self.values):
            return self
        own = len(self.x) > 1
        return _Windows(
            values=self.values[chosen],
            x=self.x[chosen] if own else self.x,
            y=self.y[chosen] if own else self.y,
            weight=self.weight[chosen],
        )


def fit_corners(
    image: Grey,
    guess: Floats,
    edges: Floats,
    radius: float | Floats,
    kind: CornerKind = "crossing",
    *,
    arm: float | Floats = 0.0,
) -> CornerFits:
    """Fit corners.

    Parameters
    ----------
    image : (h, w)
    guess : (m, 2) where they are, to a pixel or two; a corner whose window leaves the image is no good
    edges : (m, 2, 2) directions of two edges, pointing from the corner along both sides of a black wedge
    radius : of the window [px], which shall hold nothing but the corner; cut to 2 ... 5
    kind : what meets there
    arm : how far along the edges of a tip there is nothing else within the radius [px]; cut to 9
    """
    count = len(guess)
    if not count:
        return _no_fits()
    image = np.ascontiguousarray(image)
    reach = np.clip(np.broadcast_to(np.asarray(radius, float), count), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX)
    arms = np.clip(np.broadcast_to(np.asarray(arm, float), count), reach, LONGEST_ARM_PX) if kind == "tip" else reach
    middle = np.rint(guess).astype(np.int64)
    patches, inside = _patches(image, middle, int(np.ceil(arms.max())))
    centre = _nearer(image, guess, inside, reach) - middle
    windows = _disc(patches, reach) if kind == "crossing" else _arms(patches, centre, edges, reach, arms)
    state = _start(patches, windows, centre, edges)
    information, variance = np.zeros((count, _PARAMETERS, _PARAMETERS)), np.full(count, np.inf)
    active = np.flatnonzero(inside)
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        normal, pixels = _normal_equations(windows.only(active), state[active], kind)
        step = _step(normal, state[active])
        information[active] = normal[:, :-1, :-1]
        variance[active] = _variance(normal, pixels, step)
        state[active] = _moved(state[active], step)
        active = active[(np.abs(step[:, : _BLURS.stop]) > _CONVERGED).any(axis=1)]
    return _judged(state, information, variance, start=guess - middle, middle=middle, reach=reach)


def _no_fits() -> CornerFits:
    none = np.empty(0)
    return CornerFits(
        pixels=none.reshape(0, 2), sigma_px=none, blur_px=none, black=none, white=none, misfit=none, good=none > 0
    )


def _patches(image: Grey, middle: Integers, half: int) -> tuple[Singles, Booleans]:
    """Return the squares around the corners, (m, side, side), and which are inside of the image."""
    height, width = image.shape
    inside = (middle >= half).all(axis=1) & (middle[:, 0] < width - half) & (middle[:, 1] < height - half)
    side = 2 * half + 1
    if min(height, width) < side:
        return np.zeros((len(middle), side, side), np.float32), np.zeros(len(middle), dtype=bool)
    first = np.where(inside[:, None], middle, half) - half
    offset = np.arange(side)
    place = (first[:, 1] * width + first[:, 0])[:, None] + (offset[:, None] * width + offset).ravel()
    return image.ravel().take(place).astype(np.float32).reshape(-1, side, side), inside


def _disc(patches: Singles, reach: Floats) -> _Windows:
    """Return the pixels of round windows."""
    half = patches.shape[1] // 2
    offset = np.arange(-half, half + 1, dtype=np.float32)
    x, y = np.tile(offset, len(offset)), np.repeat(offset, len(offset))
    distance = np.hypot(x, y)
    near = distance < reach.max() + 0.5
    weight = np.clip((reach[:, None] + 0.5).astype(np.float32) - distance[near], 0, 1)
    return _Windows(values=patches.reshape(len(patches), -1)[:, near], x=x[None, near], y=y[None, near], weight=weight)


def _arms(patches: Singles, centre: Floats, edges: Floats, reach: Floats, arms: Floats) -> _Windows:
    """Return the pixels near either edge of tips."""
    half = patches.shape[1] // 2
    offset = np.arange(-half, half + 1, dtype=np.float32)
    count = len(patches)
    x, y = np.tile(offset, len(offset)), np.repeat(offset, len(offset))
    place, single = centre.astype(np.float32), edges.astype(np.float32)
    dx, dy = x - place[:, :1], y - place[:, 1:]
    chosen = np.zeros(dx.shape, dtype=bool)
    for i in (0, 1):
        ex, ey = single[:, i, :1], single[:, i, 1:]
        along, across = ex * dx + ey * dy, ex * dy - ey * dx
        chosen |= (np.abs(across) <= reach[:, None]) & (along <= arms[:, None]) & (along >= -reach[:, None])
    row, pixel = np.nonzero(chosen)
    each = chosen.sum(axis=1)
    slot = np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each)
    index = np.zeros((count, max(int(each.max()), 1)), np.int64)
    weight = np.zeros(index.shape, np.float32)
    index[row, slot], weight[row, slot] = pixel, 1
    values = np.take_along_axis(patches.reshape(count, -1), index, axis=1)
    return _Windows(values=values, x=x[index], y=y[index], weight=weight)


def _nearer(image: Grey, guess: Floats, inside: Booleans, reach: Floats) -> Floats:
    """Return the corners to a tenth of a pixel or so, which saves iterations: where the gradients point past them."""
    nearer = guess.copy()
    for half in (2, 3):
        chosen = np.flatnonzero(inside & ((reach >= 3) == (half == 3)))
        if len(chosen):
            start = np.ascontiguousarray(guess[chosen, None], dtype=np.float32)
            nearer[chosen] = cv2.cornerSubPix(image, start, (half, half), (-1, -1), _SUBPIX)[:, 0]
    strayed = ~(np.abs(nearer - guess).max(axis=1) < _FARTHEST * reach)
    nearer[strayed] = guess[strayed]
    return nearer


# Columns of the state, (m, 9): place of the corner relative to the window's middle, angles of both normals, which point
# into the black wedge, blur across both edges, correlation, mean of black and white, half their difference.
_U, _V, _ANGLES, _BLURS, _RHO, _MID, _AMPLITUDE = 0, 1, slice(2, 4), slice(4, 6), 6, 7, 8


def _start(patches: Singles, windows: _Windows, centre: Floats, edges: Floats) -> Floats:
    within = windows.weight > 0.5
    low = np.where(within, windows.values, 255).min(axis=1)
    high = np.where(within, windows.values, 0).max(axis=1)
    along = np.arctan2(edges[:, :, 1], edges[:, :, 0])
    turn = np.sign(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    state = np.empty((len(centre), _PARAMETERS))
    state[:, :2] = centre
    state[:, _ANGLES] = along + (np.pi / 2) * np.stack([turn, -turn], axis=1)
    state[:, _BLURS] = _blur(patches, high - low)[:, None]
    state[:, _RHO] = np.cos(state[:, 2] - state[:, 3]).clip(-_LARGEST_CORRELATION, _LARGEST_CORRELATION)
    state[:, _MID] = (low + high) / 2
    state[:, _AMPLITUDE] = (high - low) / 2
    return state


def _blur(patches: Singles, contrast: Singles) -> Floats:
    """Return the blur that the steepest slope between black and white tells, (m,) [px]."""
    half = patches.shape[1] // 2
    k = slice(half - 2, half + 3)
    by_x = patches[:, k, half - 1 : half + 4] - patches[:, k, half - 3 : half + 2] if half >= 3 else None
    by_y = patches[:, half - 1 : half + 4, k] - patches[:, half - 3 : half + 2, k] if half >= 3 else None
    if by_x is None or by_y is None:
        return np.full(len(patches), 0.8)
    slope = np.sqrt((by_x * by_x + by_y * by_y).max(axis=(1, 2))) / 2
    wide = contrast / (np.sqrt(2 * np.pi) * np.maximum(slope, 1e-3))
    return np.sqrt(np.maximum(wide.astype(np.float64) ** 2 - 1 / 3, 0)).clip(*_FIRST_BLUR_PX)


def _normal_equations(windows: _Windows, state: Floats, kind: CornerKind) -> tuple[Floats, Floats]:
    """Return J'J with J'r as last row and column, (m, 10, 10), and how many pixels count (m,).

    The columns are offsets of the corner along both normals, angles, blurs, correlation, grey levels, residual.
    """
    s = state.astype(np.float32)
    cos, sin = np.cos(s[:, _ANGLES]), np.sin(s[:, _ANGLES])
    dx, dy = windows.x - s[:, _U, None], windows.y - s[:, _V, None]
    inverse = 1 / s[:, _BLURS]
    a1, a2 = ((cos[:, i, None] * dx + sin[:, i, None] * dy) * inverse[:, i, None] for i in (0, 1))
    picture, by_a1, by_a2, by_rho = _crossing_or_tip(a1, a2, s[:, _RHO, None], kind)
    amplitude = s[:, _AMPLITUDE, None]
    model = s[:, _MID, None] - amplitude * picture
    weight = _unsaturated(windows, model)
    columns = np.empty((len(s), _PARAMETERS + 1, weight.shape[1]), dtype=np.float32)
    scale = weight * amplitude
    for i, (by_a, a) in enumerate(((by_a1, a1), (by_a2, a2))):
        q = np.multiply(scale * inverse[:, i, None], by_a, out=columns[:, i])
        np.multiply(q, sin[:, i, None] * dx - cos[:, i, None] * dy, out=columns[:, 2 + i])
        np.multiply(q, a, out=columns[:, 4 + i])
    np.multiply(-scale, by_rho, out=columns[:, _RHO])
    columns[:, _MID] = weight
    np.multiply(-weight, picture, out=columns[:, _AMPLITUDE])
    np.multiply(weight, windows.values - model, out=columns[:, -1])
    normal = np.matmul(columns, columns.transpose(0, 2, 1)).astype(np.float64)
    return normal, np.square(weight).sum(axis=1)


def _unsaturated(windows: _Windows, model: Singles) -> Singles:
    """Return the weights without pixels that are as light, or as dark, as they can be where the model goes beyond."""
    if windows.values.max() < _SATURATED and windows.values.min() > 0:
        return windows.weight
    beyond = ((windows.values >= _SATURATED) & (model > _SATURATED - 0.5)) | ((windows.values <= 0) & (model < 0.5))
    return np.where(beyond, np.float32(0), windows.weight)


def _crossing_or_tip(
    a1: Singles, a2: Singles, rho: Singles, kind: CornerKind
) -> tuple[Singles, Singles, Singles, Singles]:
    """Return the picture, 1 in the black and -1 in the white, and its derivatives by both distances and by rho."""
    (G1, phi1), (G2, phi2) = _normal_distribution(a1), _normal_distribution(a2)
    both = phi1 * phi2
    half_square = 0.5 * rho * rho
    product = a1 * a2
    bend = rho + half_square * product
    bend1, bend2 = half_square * a2 - a1 * bend, half_square * a1 - a2 * bend
    by_rho = 1 + rho * product
    if kind == "crossing":
        both *= 4
        return G1 * G2 + both * bend, 2 * phi1 * G2 + both * bend1, 2 * phi2 * G1 + both * bend2, both * by_rho
    both *= 2
    black1, black2 = 0.5 * (1 + G1), 0.5 * (1 + G2)
    picture = 2 * black1 * black2 - 1 + both * bend
    return picture, 2 * phi1 * black2 + both * bend1, 2 * phi2 * black1 + both * bend2, both * by_rho


def _normal_distribution(a: Singles) -> tuple[Singles, Singles]:
    """Return 2 Phi(a) - 1 and phi(a); the former to 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    a = np.clip(a, -_FAR, _FAR)  # beyond, there is nothing but denormal numbers, which are slow
    exponential = np.exp(np.float32(-0.5) * a * a)
    t = 1 / (1 + np.float32(0.3275911 / np.sqrt(2)) * np.abs(a))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return np.copysign(1 - series * exponential, a), exponential * np.float32(1 / np.sqrt(2 * np.pi))


def _step(normal: Floats, state: Floats) -> Floats:
    """Return the Gauss-Newton step (m, 9), slightly damped and of bounded length.

    What the picture does not tell is taken from what is likely: alike blurs, and the correlation that goes with them.
    """
    matrix, side = normal[:, :-1, :-1].copy(), normal[:, :-1, -1].copy()
    noise = np.square(_NOISE * 2 * state[:, _AMPLITUDE])
    alike, known = noise / _BLURS_ALIKE_PX**2, noise / _CORRELATION_KNOWN**2
    first, second = _BLURS.start, _BLURS.start + 1
    for i, j in ((first, second), (second, first)):
        matrix[:, i, i] += alike
        matrix[:, i, j] -= alike
        side[:, i] += alike * (state[:, j] - state[:, i])
    matrix[:, _RHO, _RHO] += known
    side[:, _RHO] += known * (np.cos(state[:, 2] - state[:, 3]) - state[:, _RHO])
    diagonal = np.einsum("mii->mi", matrix)
    diagonal *= 1 + _DAMPING
    diagonal += 1e-6
    step = np.linalg.solve(matrix, side[:, :, None])[:, :, 0]
    longest = np.abs(step[:, : _RHO + 1] / _LONGEST_STEP).max(axis=1)
    return step / np.maximum(longest, 1)[:, None]


def _variance(normal: Floats, pixels: Floats, step: Floats) -> Floats:
    """Return the variance of the residuals after the step, (m,)."""
    before, slope = normal[:, -1, -1], np.einsum("mi,mi->m", normal[:, :-1, -1], step)
    bend = np.einsum("mi,mij,mj->m", step, normal[:, :-1, :-1], step)
    return np.maximum(before - 2 * slope + bend, 0) / np.maximum(pixels - _PARAMETERS, 1)


def _moved(state: Floats, step: Floats) -> Floats:
    moved = state + step
    moved[:, :2] = state[:, :2] + _by_normals(state, step[:, :2, None])[:, :, 0]
    moved[:, _BLURS] = np.clip(moved[:, _BLURS], *_BLUR_PX)
    moved[:, _RHO] = np.clip(moved[:, _RHO], -_LARGEST_CORRELATION, _LARGEST_CORRELATION)
    return moved


def _by_normals(state: Floats, offsets: Floats) -> Floats:
    """Return the moves in pixels (m, 2, k) that are such offsets (m, 2, k) along the normals."""
    (cos1, cos2), (sin1, sin2) = np.cos(state[:, _ANGLES]).T, np.sin(state[:, _ANGLES]).T
    sine = cos1 * sin2 - cos2 * sin1
    sine = np.where(np.abs(sine) < 1e-3, np.copysign(1e-3, sine), sine)
    inverse = np.array([[sin2, -sin1], [-cos2, cos1]]) / sine
    return np.matmul(inverse.transpose(2, 0, 1), offsets)


def _judged(
    state: Floats, information: Floats, variance: Floats, *, start: Floats, middle: Integers, reach: Floats
) -> CornerFits:
    regular = np.isfinite(variance) & np.isfinite(state).all(axis=1)
    state = np.where(regular[:, None], state, 1.0)
    variance = np.where(regular, variance, 0.0)
    contrast = 2 * state[:, _AMPLITUDE]
    misfit = np.sqrt(variance) / np.maximum(contrast, 1)
    angles, blurs = state[:, _ANGLES], state[:, _BLURS]
    good = (
        regular
        & (np.linalg.norm(state[:, :2] - start, axis=1) < np.minimum(_FARTHEST_PX, _FARTHEST * reach))
        & (contrast > _LEAST_CONTRAST)
        & (misfit < _MISFIT)
        & (np.abs(np.sin(angles[:, 0] - angles[:, 1])) > _LEAST_SINE)
        & (blurs.min(axis=1) > 1.01 * _BLUR_PX[0])
        & (blurs.max(axis=1) < _WIDEST_BLUR * reach)
    )
    place = _place_covariance(state, np.where(regular[:, None, None], information, np.eye(_PARAMETERS)))
    return CornerFits(
        pixels=middle + state[:, :2],
        sigma_px=np.sqrt(np.maximum(np.einsum("mii->m", place) / 2, 0) * variance + _MODEL_SIGMA_PX**2),
        blur_px=np.sqrt(np.square(blurs).mean(axis=1)),
        black=state[:, _MID] - state[:, _AMPLITUDE],
        white=state[:, _MID] + state[:, _AMPLITUDE],
        misfit=misfit,
        good=good,
    )


def _place_covariance(state: Floats, information: Floats) -> Floats:
    """Return the covariance (m, 2, 2) of the place of the corners for residuals of unit variance [px^2]."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("mii->mi", information), 1e-12))
    unit = information * scale[:, :, None] * scale[:, None, :] + 1e-6 * np.eye(_PARAMETERS)
    columns = np.broadcast_to(np.eye(_PARAMETERS)[:, :2], (len(unit), _PARAMETERS, 2))
    offsets = np.linalg.solve(unit, columns)[:, :2] * scale[:, :2, None] * scale[:, None, :2]
    return _by_normals(state, _by_normals(state, offsets).transpose(0, 2, 1))
