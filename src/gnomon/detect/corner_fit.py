"""Corners to sub-pixel accuracy: maximum likelihood fit of two blurred edges that meet.

Around a corner c two straight edges with normals n1, n2 part black from white. With the distances a_i = n_i (x - c) / s
in units of the blur s, a Gaussian blur of the sharp picture gives

    crossing   I = mid + amplitude E[sign(a1 + z1) sign(a2 + z2)]      (X: black wedges opposite each other)
    tip        I = white - 2 amplitude P[a1 + z1 > 0, a2 + z2 > 0]     (L: one black wedge)

where z1, z2 are normal with the correlation rho = n1 n2. Of the bivariate normal distribution its expansion in rho is
taken, P = Phi Phi + phi phi (rho + rho^2 a1 a2 / 2). The crossing is point symmetric: no error of the blur's shape
moves it.

Seven parameters a corner (offsets along both normals, angles of both edges, blur, two grey levels) are fitted to the
pixels of a round window by Gauss-Newton, all corners of an image at once.
"""

from dataclasses import dataclass, fields
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images import Grey
from ..recording import Floats, Integers

Singles = NDArray[np.float32]
Booleans = NDArray[np.bool_]
CornerKind = Literal["crossing", "tip"]

LARGEST_RADIUS_PX = 5
SMALLEST_RADIUS_PX = 2.0

_PARAMETERS = 7
_ITERATIONS = 6
_SUBPIX = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 4, 0.03)
_CONVERGED_PX = 0.02  # the next step would be its square
_FIRST_BLUR_PX = 0.9
_BLUR_PX = (0.2, 4.0)
_WIDEST_BLUR = 0.6  # of the window's radius
_STEP_PX, _TURN, _BLUR_STEP_PX = 1.0, 0.35, 0.5
_FARTHEST_PX = 3.0
_LEAST_CONTRAST = 8.0  # grey levels between black and white
_MISFIT = 0.12  # rms of the residuals over the contrast
_LEAST_SINE = 0.3  # between the edges
_DAMPING = 1e-4
_FAR = np.float32(8.0)
_MODEL_SIGMA_PX = 0.005  # what a straight edge and a Gaussian blur leave out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFits:
    """Corners as they were fitted, m of them.

    Attributes
    ----------
    pixels : (m, 2) [px]
    sigma_px : (m,) standard deviation per axis, from the residuals [px]
    blur_px : (m,) standard deviation of the blur [px]
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
    """Pixels around the corners, (m, n), their places relative to the window's middle (n,), and their weights."""

    values: Singles
    x: Singles
    y: Singles
    weight: Singles

    def only(self, chosen: NDArray[np.integer]) -> "_Windows":
        return _Windows(values=self.values[chosen], x=self.x, y=self.y, weight=self.weight[chosen])


def fit_corners(
    image: Grey, guess: Floats, edges: Floats, radius: float | Floats, kind: CornerKind = "crossing"
) -> CornerFits:
    """Fit corners.

    Parameters
    ----------
    image : (h, w)
    guess : (m, 2) where they are, to a pixel or two; a corner whose window leaves the image is no good
    edges : (m, 2, 2) directions of two edges, pointing from the corner along both sides of a black wedge
    radius : of the window [px], which shall hold nothing but the corner; cut to 2 ... 5
    kind : what meets there
    """
    count = len(guess)
    if not count:
        return _no_fits()
    reach = np.clip(np.broadcast_to(np.asarray(radius, float), count), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX)
    middle = np.rint(guess).astype(np.int64)
    windows, inside = _windows(image, middle, reach)
    state = _start(windows, _nearer(image, guess, inside, reach) - middle, edges)
    information, variance = np.zeros((count, _PARAMETERS, _PARAMETERS)), np.full(count, np.inf)
    active = np.flatnonzero(inside)
    for _ in range(_ITERATIONS):
        normal, variance[active] = _normal_equations(windows.only(active), state[active], kind)
        information[active] = normal[:, :-1, :-1]
        step = _step(normal)
        state[active] = _moved(state[active], step)
        active = active[np.abs(step[:, :2]).max(axis=1) > _CONVERGED_PX]
        if not len(active):
            break
    return _judged(state, information, variance, start=guess - middle, middle=middle, reach=reach)


def _no_fits() -> CornerFits:
    none = np.empty(0)
    return CornerFits(
        pixels=none.reshape(0, 2), sigma_px=none, blur_px=none, black=none, white=none, misfit=none, good=none > 0
    )


def _windows(image: Grey, middle: Integers, reach: Floats) -> tuple[_Windows, Booleans]:
    """Return the pixels around the corners, and which windows are inside of the image."""
    half = int(np.ceil(reach.max()))
    height, width = image.shape
    inside = (middle >= half).all(axis=1) & (middle[:, 0] < width - half) & (middle[:, 1] < height - half)
    safe = np.where(inside[:, None], middle, half)
    offset = np.arange(-half, half + 1)
    x, y = np.tile(offset, len(offset)), np.repeat(offset, len(offset))
    near = np.hypot(x, y) < reach.max() + 0.5
    x, y = x[near], y[near]
    values = image[safe[:, 1, None] + y, safe[:, 0, None] + x]
    weight = np.clip(reach[:, None] + 0.5 - np.hypot(x, y), 0, 1)
    windows = _Windows(
        values=values.astype(np.float32),
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        weight=weight.astype(np.float32),
    )
    return windows, inside


def _nearer(image: Grey, guess: Floats, inside: Booleans, reach: Floats) -> Floats:
    """Return the corners to a tenth of a pixel or so, which saves iterations: where the gradients point past them."""
    nearer = guess.copy()
    for half in (2, 3):
        chosen = np.flatnonzero(inside & ((reach >= 3) == (half == 3)))
        if len(chosen):
            start = np.ascontiguousarray(guess[chosen, None], dtype=np.float32)
            nearer[chosen] = cv2.cornerSubPix(image, start, (half, half), (-1, -1), _SUBPIX)[:, 0]
    strayed = ~(np.abs(nearer - guess).max(axis=1) < reach)
    nearer[strayed] = guess[strayed]
    return nearer


# Columns of the state, (m, 7): place of the corner relative to the window's middle, angles of both normals, which point
# into the black wedge, blur, mean of black and white, half their difference.
_U, _V, _ANGLES, _BLUR, _MID, _AMPLITUDE = 0, 1, slice(2, 4), 4, 5, 6


def _start(windows: _Windows, centre: Floats, edges: Floats) -> Floats:
    within = windows.weight > 0.5
    low = np.where(within, windows.values, 255).min(axis=1)
    high = np.where(within, windows.values, 0).max(axis=1)
    along = np.arctan2(edges[:, :, 1], edges[:, :, 0])
    turn = np.sign(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    state = np.empty((len(centre), _PARAMETERS))
    state[:, :2] = centre
    state[:, _ANGLES] = along + (np.pi / 2) * np.stack([turn, -turn], axis=1)
    state[:, _BLUR] = _FIRST_BLUR_PX
    state[:, _MID] = (low + high) / 2
    state[:, _AMPLITUDE] = (high - low) / 2
    return state


def _normal_equations(windows: _Windows, state: Floats, kind: CornerKind) -> tuple[Floats, Floats]:
    """Return J'J with J'r as last row and column, (m, 8, 8), and the variance of the residuals (m,).

    The columns are offsets of the corner along both normals, angles, blur, grey levels, residual.
    """
    s = state.astype(np.float32)
    cos, sin = np.cos(s[:, _ANGLES]), np.sin(s[:, _ANGLES])
    dx, dy = windows.x - s[:, _U, None], windows.y - s[:, _V, None]
    blur = s[:, _BLUR, None]
    a1, a2 = ((cos[:, i, None] * dx + sin[:, i, None] * dy) / blur for i in (0, 1))
    picture, by_a1, by_a2 = _crossing_or_tip(a1, a2, (cos[:, 0] * cos[:, 1] + sin[:, 0] * sin[:, 1])[:, None], kind)
    weight, amplitude = windows.weight, s[:, _AMPLITUDE, None]
    columns = np.empty((len(s), _PARAMETERS + 1, len(windows.x)), dtype=np.float32)
    scale = weight * (amplitude / blur)
    q1 = np.multiply(scale, by_a1, out=columns[:, 0])
    q2 = np.multiply(scale, by_a2, out=columns[:, 1])
    for i, q in enumerate((q1, q2)):
        np.multiply(q, sin[:, i, None] * dx - cos[:, i, None] * dy, out=columns[:, 2 + i])
    np.add(q1 * a1, q2 * a2, out=columns[:, _BLUR])
    columns[:, _MID] = weight
    np.multiply(weight, -picture, out=columns[:, _AMPLITUDE])
    np.multiply(weight, windows.values - s[:, _MID, None] + amplitude * picture, out=columns[:, -1])
    normal = np.matmul(columns, columns.transpose(0, 2, 1)).astype(np.float64)
    pixels = np.square(weight).sum(axis=1)
    return normal, normal[:, -1, -1] / np.maximum(pixels - _PARAMETERS, 1)


def _crossing_or_tip(a1: Singles, a2: Singles, rho: Singles, kind: CornerKind) -> tuple[Singles, Singles, Singles]:
    """Return the picture, 1 in the black and -1 in the white, and its derivatives by both distances."""
    (G1, phi1), (G2, phi2) = _normal_distribution(a1), _normal_distribution(a2)
    both = phi1 * phi2
    half_square = 0.5 * rho * rho
    bend = rho + half_square * a1 * a2
    bend1, bend2 = half_square * a2 - a1 * bend, half_square * a1 - a2 * bend
    if kind == "crossing":
        both *= 4
        return G1 * G2 + both * bend, 2 * phi1 * G2 + both * bend1, 2 * phi2 * G1 + both * bend2
    both *= 2
    black1, black2 = 0.5 * (1 + G1), 0.5 * (1 + G2)
    picture = 2 * black1 * black2 - 1 + both * bend
    return picture, 2 * phi1 * black2 + both * bend1, 2 * phi2 * black1 + both * bend2


def _normal_distribution(a: Singles) -> tuple[Singles, Singles]:
    """Return 2 Phi(a) - 1 and phi(a); the former to 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    a = np.clip(a, -_FAR, _FAR)  # beyond, there is nothing but denormal numbers, which are slow
    exponential = np.exp(np.float32(-0.5) * a * a)
    t = 1 / (1 + np.float32(0.3275911 / np.sqrt(2)) * np.abs(a))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return np.copysign(1 - series * exponential, a), exponential * np.float32(1 / np.sqrt(2 * np.pi))


def _step(normal: Floats) -> Floats:
    """Return the Gauss-Newton step (m, 7), slightly damped and of bounded length."""
    matrix, side = normal[:, :-1, :-1].copy(), normal[:, :-1, -1]
    diagonal = np.einsum("mii->mi", matrix)
    diagonal *= 1 + _DAMPING
    diagonal += 1e-6
    step = np.linalg.solve(matrix, side[:, :, None])[:, :, 0]
    longest = np.abs(step[:, : _BLUR + 1] / [_STEP_PX, _STEP_PX, _TURN, _TURN, _BLUR_STEP_PX]).max(axis=1)
    return step / np.maximum(longest, 1)[:, None]


def _moved(state: Floats, step: Floats) -> Floats:
    moved = state + step
    moved[:, :2] = state[:, :2] + _by_normals(state, step[:, :2, None])[:, :, 0]
    moved[:, _BLUR] = np.clip(moved[:, _BLUR], *_BLUR_PX)
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
    variance = np.where(regular, variance, 0.0)
    contrast = 2 * state[:, _AMPLITUDE]
    misfit = np.sqrt(variance) / np.maximum(contrast, 1)
    angles = state[:, _ANGLES]
    good = (
        regular
        & (np.linalg.norm(state[:, :2] - start, axis=1) < np.minimum(_FARTHEST_PX, reach))
        & (contrast > _LEAST_CONTRAST)
        & (misfit < _MISFIT)
        & (np.abs(np.sin(angles[:, 0] - angles[:, 1])) > _LEAST_SINE)
        & (state[:, _BLUR] > 1.01 * _BLUR_PX[0])
        & (state[:, _BLUR] < _WIDEST_BLUR * reach)
    )
    place = _place_covariance(state, np.where(regular[:, None, None], information, np.eye(_PARAMETERS)))
    return CornerFits(
        pixels=middle + state[:, :2],
        sigma_px=np.sqrt(np.maximum(np.einsum("mii->m", place) / 2, 0) * variance + _MODEL_SIGMA_PX**2),
        blur_px=state[:, _BLUR].copy(),
        black=state[:, _MID] - state[:, _AMPLITUDE],
        white=state[:, _MID] + state[:, _AMPLITUDE],
        misfit=misfit,
        good=good,
    )


def _place_covariance(state: Floats, information: Floats) -> Floats:
    """Return the covariance (m, 2, 2) of the place of the corners for residuals of unit variance [px^2]."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("mii->mi", information), 1e-12))
    unit = information * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(_PARAMETERS)
    columns = np.broadcast_to(np.eye(_PARAMETERS)[:, :2], (len(unit), _PARAMETERS, 2))
    offsets = np.linalg.solve(unit, columns)[:, :2] * scale[:, :2, None] * scale[:, None, :2]
    return _by_normals(state, _by_normals(state, offsets).transpose(0, 2, 1))
