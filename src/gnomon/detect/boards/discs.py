"""Discs in an image: the ellipses that they are seen as, the grid among them, and their middles to sub-pixel accuracy.

A pixel is dark where it is nearer to the darkest than to the lightest one of its neighbourhood; a dark region counts
whose area is that of the ellipse with its second moments.

The ellipse that a disc is seen as tells how its surroundings are foreshortened: where it is made a circle again, the
next discs are equally far off, a quarter turn apart. So perspective and lens do not matter, from disc to disc. Discs
that take each other for the next one are joined; what hangs together is laid out on integer places.

Their middles come from a maximum likelihood fit of blurred ellipses. The outline is where q = |B (x - c)| = 1, with a
symmetric matrix B; near it the distance inwards is d = (1 - q) / |grad q|, and a Gaussian blur of standard deviation s
makes the picture

    I = (white - (white - black) Phi(d / s)) (1 + light (x - c)).

Ten parameters a disc (middle, B, blur, two grey levels, slope of the light along x and y) are fitted to the pixels
near the outline by Gauss-Newton, all discs of an image at once. The picture of an ellipse is point symmetric: no error
of the blur's shape moves its middle.
"""

from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial import KDTree

from ...frozen import value_class
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .corner_windows import PointFits, Singles, damp_diagonals, normal_distribution, pack_rows
from .lattice import Lattice, laid_out
from .marker_boards import black_limits

_CONTRAST = 0.3  # a neighbourhood with less contrast than this share of the strongest has no disc
_LEAST_AREA_PX, _LARGEST = 8.0, 0.03  # of a disc; the latter over the image
_LIKE_ELLIPSE = 0.1  # how far the area may be from that of the ellipse with the same second moments
_SMALL_PX = 60.0  # area from which on that is asked; smaller ones are rough
_FEWEST_POINTS = 4
_MOMENTS = ("m00", "m10", "m01", "mu20", "mu11", "mu02")
_THINNEST = 0.15  # smaller half axis over the larger one
_NEAR = 24  # discs that are looked at for the next one; seen from aside, a row is three times as dense as a column
_ALIKE = (0.45, 2.2)  # area of a neighbour's outline over a disc's own
_TURN = np.radians(32)  # from the expected direction of a neighbour
_FARTHER = 1.7  # the farthest neighbour over the nearest one
_FEWEST_DISCS = 4
_SLACK = 2  # lines that may have been missed on one side
_FOUND = 0.85  # share of the circles that a lattice must have
_OF_SIDE = 0.6  # the same of the outermost ones on each side
_GOES_ON = 0.5  # share of the places beside the board that make it a larger one


@value_class
class Discs:
    """Ellipses in an image.

    Attributes
    ----------
    pixels : (n, 2) middles [px]
    shape : (n, 2, 2) symmetric: the outline is where (x - middle)' inv(shape) (x - middle) = 1 [px^2]
    """

    pixels: Floats
    shape: Floats

    def __len__(self) -> int:
        return len(self.pixels)


def find_discs(image: Grey) -> Discs:
    """Return the dark discs in an image; light ones are those of the negative.

    Parameters
    ----------
    image : (h, w)
    """
    outlines, tree = cv2.findContours(_dark(image), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return _no_discs()
    whole = np.asarray(tree)[0, :, 3] < 0  # not the outline of a hole
    found = [cv2.moments(outlines[i]) for i in np.flatnonzero(whole).tolist() if len(outlines[i]) >= _FEWEST_POINTS]
    moments = np.array([[m[name] for name in _MOMENTS] for m in found if m["m00"] > 0]).reshape(-1, len(_MOMENTS))
    area, by_x, by_y, xx, xy, yy = moments.T
    if not len(area):
        return _no_discs()
    squares, axes = np.linalg.eigh(np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2) / area[:, None, None])
    half = 2 * np.sqrt(np.maximum(squares, 1e-6))  # axes of the ellipse that has these second moments
    likeness = area / (np.pi * half.prod(axis=1))
    half += 0.5  # the outline runs through the middles of the outermost pixels
    good = (
        (area > _LEAST_AREA_PX)
        & (area < _LARGEST * image.size)
        & (np.abs(likeness - 1) < _LIKE_ELLIPSE * np.maximum(np.sqrt(_SMALL_PX / area), 1))
        & (half[:, 0] > _THINNEST * half[:, 1])
    )
    return Discs(
        pixels=np.stack([by_x / area, by_y / area], axis=1)[good],
        shape=np.einsum("nij,nj,nkj->nik", axes, np.square(half), axes)[good],
    )


def _no_discs() -> Discs:
    return Discs(pixels=np.empty((0, 2)), shape=np.empty((0, 2, 2)))


def _dark(image: Grey) -> Grey:
    """Return 255 for dark, 0 for light."""
    dark = np.asarray(cv2.compare(image, black_limits(image, 0.5, _CONTRAST), cv2.CMP_LT), np.uint8)
    dark[:1], dark[-1:], dark[:, :1], dark[:, -1:] = 0, 0, 0, 0
    return dark


def disc_lattices(discs: Discs) -> list[Lattice]:
    """Return the lattices that discs form, the largest first."""
    if len(discs) < _FEWEST_DISCS:
        return []
    following, onward = _neighbours(discs)
    return laid_out(discs.pixels, following, onward)


def _neighbours(discs: Discs) -> tuple[Integers, Integers]:
    """Return the next disc in four directions, (n, 4), -1 where none is, and which way goes on there, (n, 4, 4).

    Ways 0 and 1 are to and fro, ways 2 and 3 those a quarter turn on.
    """
    count = len(discs)
    _, near = KDTree(discs.pixels).query(discs.pixels, k=min(_NEAR + 1, count))
    near = np.asarray(near, np.int64)[:, 1:]
    squares, axes = np.linalg.eigh(discs.shape)
    rounded = np.einsum("nij,nj,nkj->nik", axes, 1 / np.sqrt(squares), axes)  # makes an ellipse a circle
    step = np.einsum("nij,nkj->nki", rounded, discs.pixels[near] - discs.pixels[:, None])
    distance, angle = np.hypot(step[..., 0], step[..., 1]), np.arctan2(step[..., 1], step[..., 0])
    area = np.sqrt(squares.prod(axis=1))
    ratio = area[near] / area[:, None]
    seen = rounded[:, None] @ discs.shape[near] @ rounded[:, None]  # of a neighbour, where this one is a circle
    spread = np.linalg.eigvalsh(seen)
    possible = (ratio > _ALIKE[0]) & (ratio < _ALIKE[1]) & (spread[..., 1] < 4 * spread[..., 0])
    possible &= distance > 1.5
    distance = np.where(possible, distance, np.inf)
    nearest = distance.argmin(axis=1)[:, None]
    first = np.take_along_axis(angle, nearest, 1)
    least = np.take_along_axis(distance, nearest, 1)
    directions = first + np.array([0.0, np.pi, np.pi / 2, -np.pi / 2])
    following = np.full((count, 4), -1)
    for way in range(4):
        off = np.abs(np.angle(np.exp(1j * (angle - directions[:, way : way + 1]))))
        onward = np.where((off < _TURN) & (distance < _FARTHER * least), distance, np.inf)
        nearest = onward.argmin(axis=1)[:, None]
        found = np.isfinite(np.take_along_axis(onward, nearest, 1))
        following[:, way] = np.where(found, np.take_along_axis(near, nearest, 1), -1)[:, 0]
    target = np.where(following >= 0, following, 0)
    returned = (following[target] == np.arange(count)[:, None, None]).any(axis=2)
    following[~returned] = -1
    # where a way goes on: the direction there that is most alike in the image
    spread_back = np.linalg.inv(rounded)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=2)
    along = np.einsum("nij,nwj->nwi", spread_back, along)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    onward = np.einsum("nwi,nkvi->nkwv", along, along[target]).argmax(axis=3)
    return following, onward


@lru_cache(maxsize=8)
def _places(target: Target) -> Integers:
    """Return where the circles are on a square lattice of neighbours, (n, 2); the second axis a quarter turn on."""
    if not target.asymmetric:
        return np.stack(np.divmod(np.arange(len(target)), target.cols), axis=1)
    x, y = np.rint(target.points[:, :2] / target.spacing_m).astype(np.int64).T
    return np.stack([(x + y) // 2, (y - x) // 2], axis=1)


def grids_in(lattice: Lattice, target: Target) -> list[Integers]:
    """Return which nodes of a lattice are which circles, (n,), -1 where one is missing; each way it may be.

    Parameters
    ----------
    lattice : of discs
    target : the grid of circles
    """
    found: list[tuple[int, Integers]] = []
    handed = lattice.handed()
    if not handed or len(lattice) < _FOUND * len(target):
        return []
    at = np.full(lattice.size, -1)
    at[lattice.place[:, 0], lattice.place[:, 1]] = np.arange(len(lattice))
    if handed > 0:
        at = at[::-1]
    own = _places(target)
    own = own - own.min(axis=0)
    extent = own.max(axis=0) + 1
    sides, beside = _sides(target), _beside(target)
    for turn in range(4):
        turned = np.rot90(at, turn)
        padded = np.pad(turned, _SLACK + 1, constant_values=-1)
        taken = padded >= 0
        spare = np.array(padded.shape) - extent - 1
        if (spare < 2).any():
            continue
        rows, cols = np.arange(1, spare[0]), np.arange(1, spare[1])
        counts = taken[rows[:, None, None] + own[:, 0], cols[:, None] + own[:, 1]].sum(axis=2)
        for i, j in 1 + np.argwhere(counts >= _FOUND * len(target)):
            node = padded[i + own[:, 0], j + own[:, 1]]
            whole = all((node[side] >= 0).mean() >= _OF_SIDE for side in sides)
            goes_on = any(taken[i + line[:, 0], j + line[:, 1]].mean() > _GOES_ON for line in beside)
            if whole and not goes_on:
                found.append((int(counts[i - 1, j - 1]), node))
    return [node for _, node in sorted(found, key=lambda one: -one[0])]


@lru_cache(maxsize=8)
def _sides(target: Target) -> tuple[Integers, ...]:
    """Return the circles on the sides of the board."""
    number = np.arange(len(target)).reshape(target.rows, target.cols)
    if not target.asymmetric:
        return number[0], number[-1], number[:, 0], number[:, -1]
    return number[0], number[-1], number[::2, 0], number[1::2, -1]


@lru_cache(maxsize=8)
def _beside(target: Target) -> tuple[Integers, ...]:
    """Return the places (k, 2) in a line beside each side of the board, counted as `_places` from the least ones."""
    own = _places(target)
    low = own.min(axis=0)
    if not target.asymmetric:
        rows, cols = np.arange(target.rows), np.arange(target.cols)
        lines = [(np.full_like(cols, k), cols) for k in (-1, target.rows)]
        lines += [(rows, np.full_like(rows, k)) for k in (-1, target.cols)]
        return tuple(np.stack(line, axis=1) for line in lines)
    width, height = 2 * target.cols, target.rows
    lines = [[(x, y) for x in range(width) if (x + y) % 2 == 0] for y in (-1, height)]
    lines += [[(x, y) for y in range(height) if (x + y) % 2 == 0] for x in (-1, width)]
    return tuple(np.array([((x + y) // 2, (y - x) // 2) for x, y in line]) - low for line in lines)


_PARAMETERS = 10
_ITERATIONS, _CONVERGED_PX, _MOST = 6, 0.01, 0.9  # the next step would be its square
_CENTRE, _OUTLINE, _BLUR, _WHITE, _FIT_CONTRAST, _LIGHT = slice(0, 2), slice(2, 5), 5, 6, 7, slice(8, 10)
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
    state[:, _FIT_CONTRAST] = state[:, _WHITE] - inside
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
    grey = s[:, _WHITE] - s[:, _FIT_CONTRAST] * inside
    model = grey * light
    # of the model by d, over the slope of q: the distance falls as q rises
    by_q = windows.weight * s[:, _FIT_CONTRAST] * phi / (s[:, _BLUR] * slope)
    J = np.empty((len(state), _PARAMETERS + 1, windows.x.shape[1]), np.float32)
    np.multiply(-by_q, g1, out=J[:, 0])
    np.multiply(-by_q, g2, out=J[:, 1])
    np.multiply(by_q, w1 * dx, out=J[:, 2])
    np.multiply(by_q, w1 * dy + w2 * dx, out=J[:, 3])
    np.multiply(by_q, w2 * dy, out=J[:, 4])
    np.multiply(windows.weight * s[:, _FIT_CONTRAST] / s[:, _BLUR], phi * a, out=J[:, _BLUR])
    J[:, _WHITE] = windows.weight
    np.multiply(-windows.weight, inside, out=J[:, _FIT_CONTRAST])
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
    contrast = np.abs(state[:, _FIT_CONTRAST])
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
        inside=state[:, _WHITE] - state[:, _FIT_CONTRAST],
        outside=state[:, _WHITE],
        misfit=misfit,
        good=good,
    )
