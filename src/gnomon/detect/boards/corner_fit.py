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

from dataclasses import replace
from typing import Literal

import cv2
import numpy as np

from ...kernel import load_kernel
from ...kernel.library import MOST_PIXELS, descend_corners
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .corner_windows import (
    DAMPING,
    SATURATED,
    Booleans,
    CornerFits,
    PixelGrid,
    Singles,
    Windows,
    damp_diagonals,
    edge_windows,
    gather_pixels,
    grid_around,
    normal_distribution,
    round_windows,
)

CornerKind = Literal["crossing", "tip"]

LARGEST_RADIUS_PX = 4.5
SMALLEST_RADIUS_PX = 2.0
LONGEST_ARM_PX = 9.0
"""How far the edges of a tip are looked at."""

_PARAMETERS = 9
_ITERATIONS, _SOON = 5, 2
_SUBPIX = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 4, 0.03)
_CONVERGED = np.array([0.02, 0.02, 0.08, 0.08, 0.15, 0.15])  # px, rad, px; the next step would be its square
_FIRST_BLUR_PX, _SLOPE_TO_BLUR = (0.35, 2.5), 0.85  # the steepest slope is not on a pixel
_BLUR_PX = (0.2, 4.0)
_LARGEST_CORRELATION = 0.95
_WIDEST_BLUR = 0.75  # of the window's radius
_LONGEST_STEP = np.array([1.0, 1.0, 0.35, 0.35, 0.5, 0.5, 0.5])
_FARTHEST = 0.95  # from the guess, over the radius of the window
_LEAST_CONTRAST = 8.0  # grey levels between black and white
_MISFIT = 0.12  # rms of the residuals over the contrast
_UNBLURRED, _SHARP_PX = 1.8, 0.1  # blurs that what is inside of a tip is kept away from, beyond the radius
_CROWDED, _CROWDING = (2.2, 3.5), 0.1  # radius of the window of a tip over its blur
_HOPELESS = 0.3  # the same, after a few iterations
_LARGEST_SIGMA_PX = 0.25
_LEAST_SINE = 0.3  # between the edges
_BLURS_ALIKE_PX, _CORRELATION_KNOWN = 0.5, 0.5  # before the picture is looked at
_NOISE = 0.02  # of the contrast, for the weight of what is known before
_MODEL_SIGMA_PX = 0.005  # what a straight edge and a Gaussian blur leave out


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
    radius : of the window [px], which shall hold nothing but the corner; cut to 2 ... 4.5
    kind : what meets there
    arm : how far along the edges of a tip there is nothing else within the radius [px]; cut to 9
    """
    count = len(guess)
    if not count:
        return _no_fits()
    image = np.ascontiguousarray(image)
    reach = np.clip(np.broadcast_to(np.asarray(radius, float), count), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX)
    arms = np.clip(np.broadcast_to(np.asarray(arm, float), count), reach, LONGEST_ARM_PX) if kind == "tip" else reach
    height, width = image.shape
    u, v = guess.T
    inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)  # not where they are not numbers
    middle = np.where(inside[:, None], np.rint(guess), 0).astype(np.int64)
    centre = _nearer(image, guess, inside, reach) - middle
    grid = grid_around(int(np.ceil(arms.max())))
    values, seen = gather_pixels(image, middle, grid)
    state = _start(values, grid, centre, edges, reach)
    if kind == "crossing":
        windows = round_windows(values, seen, grid, reach)
    else:
        free = np.broadcast_to(np.asarray(radius, float), count)
        inner = np.clip(free - _UNBLURRED * (state[:, _BLURS.start] - _SHARP_PX), 0.8, reach)
        windows = edge_windows(values, seen, grid, (centre, edges), (reach, inner, arms))
    place, variance, bow, slope = _descend(windows, state, np.flatnonzero(inside), kind)
    place = _by_normals(state, _by_normals(state, place).transpose(0, 2, 1))
    crowded = (
        np.zeros(count) if kind == "crossing" else _crowding(state, np.broadcast_to(np.asarray(radius, float), count))
    )
    fits = _judged(state, place, variance, crowded, (guess - middle, middle, reach))
    return replace(fits, bow=bow, slope=slope)


def _descend(
    windows: Windows, state: Floats, active: Integers, kind: CornerKind
) -> tuple[Floats, Floats, Floats, Floats]:
    """Move the states (m, 9) of the active corners, in place, to where their windows are met best.

    Returns covariances of the offsets for residuals of unit variance (m, 2, 2), variances of the residuals (m,), and
    `_left_out`'s moves, (m, 2, 2) each. The last step is so small that these are told where it starts.
    """
    if load_kernel() is not None and windows.values.shape[1] <= MOST_PIXELS:
        chosen = np.zeros(len(state), dtype=bool)
        chosen[active] = True
        seen = windows.values, windows.place, windows.weight
        return descend_corners(seen, tip=kind == "tip", rules=_rules(windows), active=chosen, states=state)
    place, bow, slope = np.zeros((3, len(state), 2, 2))
    variance = np.full(len(state), np.inf)
    for k in range(_ITERATIONS):
        if not len(active):
            break
        chosen, at = windows.only(active), state[active]
        columns, leavers = _columns(chosen, at, kind)
        normal, pixels = _normal_equations(columns)
        step, place[active] = _step(normal, at)
        variance[active] = _variance(normal, pixels, step)
        state[active] = _moved(at, step)
        unsettled = (np.abs(step[:, : _BLURS.stop]) > _CONVERGED).any(axis=1)
        unsettled |= windows.saturated  # which pixels count, and so the grey levels, is told late
        unsettled &= k < _ITERATIONS - 1
        if k >= _SOON:
            unsettled &= variance[active] < np.square(_HOPELESS * 2 * state[active, _AMPLITUDE])
        done = np.flatnonzero(~unsettled)
        bow[active[done]], slope[active[done]] = _left_out(
            chosen.only(done), at[done], _rows(columns, done), _rows(leavers, done), normal[done]
        )
        active = active[unsettled]
    return place, variance, bow, slope


def _rules(windows: Windows) -> Floats:
    """Return what the kernel has to know (CornerRules)."""
    alike = _NOISE, _BLURS_ALIKE_PX, _CORRELATION_KNOWN, _HOPELESS, DAMPING, _ITERATIONS, _SOON, windows.saturated
    return np.array([*_CONVERGED, *_LONGEST_STEP, *_BLUR_PX, _LARGEST_CORRELATION, *alike], dtype=np.float64)


def _rows(values: Singles, chosen: Integers) -> Singles:
    return values if len(chosen) == len(values) else values[chosen]


def _no_fits() -> CornerFits:
    one, two = np.empty(0), np.empty((0, 2, 2))
    return CornerFits(
        pixels=two[:, 0],
        sigma_px=one,
        blur_px=one,
        black=one,
        white=one,
        misfit=one,
        normals=two,
        bow=two,
        slope=two,
        good=np.empty(0, dtype=np.bool_),
    )


def _nearer(image: Grey, guess: Floats, inside: Booleans, reach: Floats) -> Floats:
    """Return the corners to a tenth of a pixel or so, which saves iterations: where the gradients point past them."""
    nearer = guess.copy()
    halves = reach.astype(np.int64)
    for half in sorted(set(halves.tolist())):  # np.unique imports numpy.ma, which takes as long as ten images
        chosen = np.flatnonzero(inside & (halves == half))
        if len(chosen) and min(image.shape) >= 2 * half + 5:
            start = np.ascontiguousarray(guess[chosen, None], dtype=np.float32)
            nearer[chosen] = cv2.cornerSubPix(image, start, (half, half), (-1, -1), _SUBPIX)[:, 0]
    strayed = ~(np.abs(nearer - guess).max(axis=1) < _FARTHEST * reach)
    nearer[strayed] = guess[strayed]
    return nearer


# Columns of the state, (m, 9): place of the corner relative to the window's middle, angles of both normals, which point
# into the black wedge, blur across both edges, correlation, mean of black and white, half their difference.
_U, _V, _ANGLES, _BLURS, _RHO, _MID, _AMPLITUDE = 0, 1, slice(2, 4), slice(4, 6), 6, 7, 8


def _start(values: Singles, grid: PixelGrid, centre: Floats, edges: Floats, reach: Floats) -> Floats:
    near = values[:, : int(np.searchsorted(grid.distance, reach.max() + 0.1))]
    within = grid.distance[: near.shape[1]] <= reach[:, None] + 0.1
    low, high = np.where(within, near, 255).min(axis=1), np.where(within, near, 0).max(axis=1)
    along = np.arctan2(edges[:, :, 1], edges[:, :, 0])
    turn = np.sign(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    state = np.empty((len(centre), _PARAMETERS))
    state[:, :2] = centre
    state[:, _ANGLES] = along + (np.pi / 2) * np.stack([turn, -turn], axis=1)
    state[:, _BLURS] = _blur(values, grid, high - low)[:, None]
    state[:, _RHO] = np.cos(state[:, 2] - state[:, 3]).clip(-_LARGEST_CORRELATION, _LARGEST_CORRELATION)
    state[:, _MID] = (low + high) / 2
    state[:, _AMPLITUDE] = (high - low) / 2
    return state


def _blur(values: Singles, grid: PixelGrid, contrast: Singles) -> Floats:
    """Return the blur that the steepest slope between black and white tells, (m,) [px]."""
    by_x = values[:, grid.right] - values[:, grid.left]
    by_y = values[:, grid.below] - values[:, grid.above]
    slope = np.sqrt((by_x * by_x + by_y * by_y).max(axis=1)) / 2
    wide = contrast / (np.sqrt(2 * np.pi) * np.maximum(slope, 1e-3))
    return (_SLOPE_TO_BLUR * np.sqrt(np.maximum(wide.astype(np.float64) ** 2 - 1 / 3, 0))).clip(*_FIRST_BLUR_PX)


def _normal_equations(columns: Singles) -> tuple[Floats, Floats]:
    """Return J'J with J'r as last row and column, (m, 10, 10), and how many pixels count (m,), of `_columns`."""
    normal = np.matmul(columns, columns.transpose(0, 2, 1)).astype(np.float64)
    return normal, np.square(columns[:, _MID]).sum(axis=1)


def _left_out(
    windows: Windows, state: Floats, columns: Singles, leavers: Singles, normal: Floats
) -> tuple[Floats, Floats]:
    """Return the moves in pixels (m, 2, 2) that the fit makes of edges that bend, and of light that grows.

    Where it is blurred by s, an edge that bends by l^2 / 2 is seen at (l^2 + s^2) / 2.
    """
    left_out = np.empty((len(state), 4, columns.shape[2]), dtype=np.float32)
    bent, lit = left_out[:, :2], left_out[:, 2:]
    np.multiply(columns[:, _ANGLES], leavers, out=bent)
    bent += columns[:, :2] * np.square(state[:, _BLURS, None]).astype(np.float32)
    bent /= 2
    np.subtract(windows.place[:, :2], state[:, _U : _V + 1, None].astype(np.float32), out=lit)
    lit *= (columns[:, _MID] * windows.values)[:, None]
    matrix = normal[:, :_PARAMETERS, :_PARAMETERS].copy()
    sides = np.matmul(columns[:, :_PARAMETERS], left_out.transpose(0, 2, 1)).astype(np.float64)
    damp_diagonals(matrix)
    moves = _by_normals(state, np.asarray(np.linalg.solve(matrix, sides), np.float64)[:, :2])
    return moves[:, :, :2], moves[:, :, 2:]


def _columns(windows: Windows, state: Floats, kind: CornerKind) -> tuple[Singles, Singles]:
    """Return the derivatives of the pixels with their residuals as last row, (m, 10, n), and `_frame`'s leavers.

    The derivatives are by offsets of the corner along both normals, angles, blurs, correlation, grey levels.
    """
    distances, leavers = _frame(windows.place, state)
    s = state.astype(np.float32)
    picture, by_distance, by_rho = _crossing_or_tip(distances, s[:, _RHO, None], kind)
    amplitude = s[:, _AMPLITUDE, None]
    model = s[:, _MID, None] - amplitude * picture
    weight = _unsaturated(windows, model)
    columns = np.empty((len(s), _PARAMETERS + 1, weight.shape[1]), dtype=np.float32)
    scale = weight * amplitude
    offsets = columns[:, :2]
    np.multiply(by_distance, scale[:, None], out=offsets)
    offsets *= (1 / s[:, _BLURS])[:, :, None]
    np.multiply(offsets, leavers, out=columns[:, _ANGLES])
    np.multiply(offsets, distances, out=columns[:, _BLURS])
    np.multiply(-scale, by_rho, out=columns[:, _RHO])
    columns[:, _MID] = weight
    np.multiply(-weight, picture, out=columns[:, _AMPLITUDE])
    np.multiply(weight, windows.values - model, out=columns[:, -1])
    return columns, leavers


def _frame(place: Singles, state: Floats) -> tuple[Singles, Singles]:
    """Return the distances from both edges in units of the blur, and from the corner along them in px, (m, 2, n)."""
    cos, sin, blur = np.cos(state[:, _ANGLES]), np.sin(state[:, _ANGLES]), state[:, _BLURS]
    u, v = state[:, _U, None], state[:, _V, None]
    rows = np.empty((len(state), 4, 3), dtype=np.float32)
    rows[:, :2, 0], rows[:, :2, 1], rows[:, :2, 2] = cos / blur, sin / blur, -(cos * u + sin * v) / blur
    rows[:, 2:, 0], rows[:, 2:, 1], rows[:, 2:, 2] = sin, -cos, cos * v - sin * u
    shared = len(place) == 1
    both = (rows.reshape(-1, 3) @ place[0]).reshape(len(state), 4, -1) if shared else np.matmul(rows, place)
    return both[:, :2], both[:, 2:]


def _unsaturated(windows: Windows, model: Singles) -> Singles:
    """Return the weights without pixels that are as light, or as dark, as they can be where the model goes beyond."""
    if not windows.saturated:
        return windows.weight
    beyond = ((windows.values >= SATURATED) & (model > SATURATED - 0.5)) | ((windows.values <= 0) & (model < 0.5))
    return windows.weight * ~beyond


def _crossing_or_tip(a: Singles, rho: Singles, kind: CornerKind) -> tuple[Singles, Singles, Singles]:
    """Return the picture, 1 in the black and -1 in the white, (m, n), and its derivatives.

    These are those by both distances `a` (m, 2, n), (m, 2, n), and by rho (m, 1), (m, n).
    """
    signed, phi = normal_distribution(a)
    both = phi[:, 0] * phi[:, 1]
    both *= 4 if kind == "crossing" else 2
    product = a[:, 0] * a[:, 1]
    product *= rho
    bend = rho * (1 + 0.5 * product)
    by_a = (0.5 * rho * rho)[:, None] * a[:, ::-1]
    by_a -= a * bend[:, None]
    by_a *= both[:, None]
    if kind == "tip":
        signed = 0.5 * (1 + signed)
    phi *= 2
    phi *= signed[:, ::-1]
    by_a += phi
    picture = signed[:, 0] * signed[:, 1]
    if kind == "tip":
        picture = 2 * picture - 1
    picture += both * bend
    product += 1
    both *= product
    return picture, by_a, both


def _step(normal: Floats, state: Floats) -> tuple[Floats, Floats]:
    """Return the Gauss-Newton step (m, 9), slightly damped and of bounded length, and the covariance of the offsets.

    That is for residuals of unit variance, (m, 2, 2). What the picture does not tell is taken from what is likely:
    alike blurs, and the correlation that goes with them.
    """
    matrix = normal[:, :-1, :-1].copy()
    sides = np.zeros((len(normal), _PARAMETERS, 3))
    sides[:, :, 0], sides[:, 0, 1], sides[:, 1, 2] = normal[:, :-1, -1], 1, 1
    noise = np.square(_NOISE * 2 * state[:, _AMPLITUDE])
    alike, known = noise / _BLURS_ALIKE_PX**2, noise / _CORRELATION_KNOWN**2
    first, second = _BLURS.start, _BLURS.start + 1
    for i, j in ((first, second), (second, first)):
        matrix[:, i, i] += alike
        matrix[:, i, j] -= alike
        sides[:, i, 0] += alike * (state[:, j] - state[:, i])
    matrix[:, _RHO, _RHO] += known
    sides[:, _RHO, 0] += known * (np.cos(state[:, 2] - state[:, 3]) - state[:, _RHO])
    damp_diagonals(matrix)
    solved = np.asarray(np.linalg.solve(matrix, sides), dtype=np.float64)
    step = solved[:, :, 0]
    longest = np.abs(step[:, : _RHO + 1] / _LONGEST_STEP).max(axis=1)
    return step / np.maximum(longest, 1)[:, None], solved[:, :2, 1:]


def _variance(normal: Floats, pixels: Floats, step: Floats) -> Floats:
    """Return the variance of the residuals after the step, (m,)."""
    slope = (normal[:, :-1, -1] * step).sum(axis=1)
    bend = (np.matmul(normal[:, :-1, :-1], step[:, :, None])[:, :, 0] * step).sum(axis=1)
    return np.maximum(normal[:, -1, -1] - 2 * slope + bend, 0) / np.maximum(pixels - _PARAMETERS, 1)


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


def _crowding(state: Floats, radius: Floats) -> Floats:
    """Return by how much of its blur what is printed inside a tip may displace it, as was measured; inf for much."""
    blurs = radius / state[:, _BLURS].max(axis=1)
    return np.where(blurs < _CROWDED[0], np.inf, _CROWDING * np.clip((_CROWDED[1] - blurs) / np.ptp(_CROWDED), 0, 1))


def _judged(
    state: Floats, place: Floats, variance: Floats, crowding: Floats, guessed: tuple[Floats, Integers, Floats]
) -> CornerFits:
    start, middle, reach = guessed
    regular = np.isfinite(variance) & np.isfinite(state).all(axis=1)
    state = np.where(regular[:, None], state, 1.0)
    variance = np.where(regular, variance, 0.0)
    contrast = 2 * state[:, _AMPLITUDE]
    misfit = np.sqrt(variance) / np.maximum(contrast, 1)
    angles, blurs = state[:, _ANGLES], state[:, _BLURS]
    fitted = np.maximum((place[:, 0, 0] + place[:, 1, 1]) / 2, 0) * variance
    sigma = np.sqrt(fitted + _MODEL_SIGMA_PX**2 + np.square(crowding * blurs.max(axis=1)))
    good = (
        regular
        & (np.hypot(*(state[:, :2] - start).T) < _FARTHEST * reach)
        & (contrast > _LEAST_CONTRAST)
        & (misfit < _MISFIT)
        & (sigma < _LARGEST_SIGMA_PX)
        & (np.abs(np.sin(angles[:, 0] - angles[:, 1])) > _LEAST_SINE)
        & (blurs.min(axis=1) > 1.01 * _BLUR_PX[0])
        & (blurs.max(axis=1) < _WIDEST_BLUR * reach)
    )
    return CornerFits(
        pixels=middle + state[:, :2],
        sigma_px=sigma,
        blur_px=np.sqrt(np.square(blurs).mean(axis=1)),
        black=state[:, _MID] - state[:, _AMPLITUDE],
        white=state[:, _MID] + state[:, _AMPLITUDE],
        misfit=misfit,
        normals=np.stack([np.cos(angles), np.sin(angles)], axis=2),
        bow=np.zeros((len(state), 2, 2)),
        slope=np.zeros((len(state), 2, 2)),
        good=good,
    )
