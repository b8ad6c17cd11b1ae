"""Grids of circles: where the centres of the discs are in an image.

find discs -> lattice -> the stated grid -> ellipses to sub-pixel accuracy -> centres of the discs, without the bias of
perspective

The board must be seen as a whole, but for a few discs that are covered. The middle of the ellipse as which a disc is
seen is not where the disc's centre is seen: perspective and lens make the nearer half larger. The grid itself tells the
map from the board to the image around each disc, and so by how much (see `_bias`).
"""

from collections import Counter
from dataclasses import replace

import cv2
import numpy as np

from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .board import NOT_WITH_NEIGHBOURS, SECOND_BOARD, BoardView, comes_first, nothing_seen
from .checkerboard import reduce_image
from .discs import DiscFits, Discs, disc_lattices, find_discs, fit_discs, grids_in
from .marker_boards import COVERED, as_good_as
from .plane_map import PlaneMap, plane_map

_LARGE_IMAGE_PX = 1.3e6  # images with more pixels are searched at half of their resolution, or less
_LARGEST_PX = 11.0  # half axis of a disc that is measured; the image is reduced until they are smaller
_REACH, _GAP = (1.25, 2.2), 0.5  # of the windows, over the radius; share of the gap to the next disc
_ASTRAY_PX, _ASTRAY = 0.2, 6.0  # how far from where the others say a disc may be: px, over the median
_UNTOLD = 0.4  # error of the bias over that of the map, as was measured
_FOUND = 0.8  # share of the circles that are needed
_ANGLES = 16  # at which a disc's outline is mapped
_TURNS = 2 * np.pi * np.arange(_ANGLES) / _ANGLES


class CircleGridDetector:
    """Finds a grid of circles in one image after the other; it remembers whether they are dark or light.

    A grid that looks the same after half a turn (or a quarter) may be numbered from either end; `consistent_order` does
    the rest.

    Parameters
    ----------
    target : the grid
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        self._light = False

    def detect(self, image: Grey) -> BoardView:
        """Return the centres in an image, (h, w) grey levels."""
        for light in (self._light, not self._light):
            view = _found(image, self._target, light)
            if len(view):
                self._light = light
                return view
        return nothing_seen()


def _found(image: Grey, target: Target, light: bool) -> BoardView:
    if light:
        image = np.asarray(cv2.bitwise_not(image), np.uint8)
    scale = max(int(np.ceil(np.sqrt(image.size / _LARGE_IMAGE_PX))), 1)
    while scale >= 1:
        discs = find_discs(reduce_image(image, scale))
        views: list[BoardView] = []
        for lattice in disc_lattices(discs)[:2]:
            for node in grids_in(lattice, target)[:1]:
                there = np.flatnonzero(node >= 0)
                chosen = lattice.node[node[there]]
                found = Discs(
                    pixels=(discs.pixels[chosen] + 0.5) * scale - 0.5, shape=discs.shape[chosen] * float(scale**2)
                )
                view = _measured(image, target, there, found, light)
                views += [view] if len(view) else []
        if views:
            return _first_of(views)
        scale //= 2
    return nothing_seen()


def _first_of(views: list[BoardView]) -> BoardView:
    """Return the view, or of two boards that of the one to the left, which says that there is another."""
    if len(views) < 2:
        return views[0]
    middles = [view.pixels.mean(axis=0) for view in views]
    first, other = views if comes_first(*middles) else views[::-1]
    return replace(first, dropped={**first.dropped, SECOND_BOARD: len(other)})


def _measured(image: Grey, target: Target, number: Integers, discs: Discs, light: bool) -> BoardView:
    fits = _fitted(image, discs)
    dropped = Counter[str]()
    dropped[COVERED] = len(target) - int(fits.good.sum())
    if fits.good.sum() < _FOUND * len(target):
        return nothing_seen(+dropped)
    misfit, sigma = float(np.median(fits.misfit[fits.good])), float(np.median(fits.sigma_px[fits.good]))
    good = fits.good & as_good_as(fits, misfit, sigma)
    number, fits = number[good], fits.only(good)
    points = target.points[number, :2] / target.spacing_m
    seen = plane_map(points, fits.pixels, image.shape[::-1])
    away = np.linalg.norm(seen.residual_px, axis=1)
    kept = away < _ASTRAY_PX + _ASTRAY * float(np.median(away))
    dropped[NOT_WITH_NEIGHBOURS] = int(np.count_nonzero(~kept))
    if not kept.all():
        number, fits, points = number[kept], fits.only(kept), points[kept]
        if len(number) < _FOUND * len(target):
            return nothing_seen(+dropped)
        seen = plane_map(points, fits.pixels, image.shape[::-1])
    black, white = float(np.median(fits.inside)), float(np.median(fits.outside))
    return BoardView(
        point=number,
        pixels=_centres(points, fits, seen, image.shape[::-1]),
        sigma_px=np.hypot(fits.sigma_px, _UNTOLD * _beyond_noise(seen.residual_px, fits.sigma_px)),
        blur_px=float(np.median(fits.blur_px)),
        black=255 - white if light else black,
        white=255 - black if light else white,
        dropped=+dropped,
    )


def _fitted(image: Grey, discs: Discs) -> DiscFits:
    """Return the ellipses, fitted in an image in which they are not larger than need be."""
    half = np.sqrt(np.linalg.eigvalsh(discs.shape)[:, 1])
    scale = max(int(np.ceil(np.median(half) / _LARGEST_PX)), 1)
    pixels, shape = (discs.pixels + 0.5) / scale - 0.5, discs.shape / scale**2
    fits = fit_discs(reduce_image(image, scale), pixels, shape, _reach(discs))
    return replace(
        fits,
        pixels=(fits.pixels + 0.5) * scale - 0.5,
        sigma_px=fits.sigma_px * scale,
        shape=fits.shape * float(scale**2),
        blur_px=fits.blur_px * scale,
    )


def _reach(discs: Discs) -> float:
    """Return how far there is nothing but one disc, over its radius."""
    steps = discs.pixels - discs.pixels[:, None]
    apart = np.sqrt(np.einsum("nki,nij,nkj->nk", steps, np.linalg.inv(discs.shape), steps))
    np.fill_diagonal(apart, np.inf)
    return float(np.clip(1 + _GAP * (np.median(apart.min(axis=1)) - 2), *_REACH))


def _beyond_noise(residual_px: Floats, sigma_px: Floats) -> float:
    """Return the rms of residuals (m, 2) that the discs' sigma (m,) does not explain [px]."""
    return float(np.sqrt(max(np.square(residual_px).mean() - np.square(sigma_px).mean(), 0.0)))


def _centres(points: Floats, fits: DiscFits, seen: PlaneMap, size: tuple[int, int]) -> Floats:
    """Return where the centres of discs are seen, (m, 2) [px].

    Parameters
    ----------
    points : (m, 2) on the board, in units of the spacing
    fits : of the discs
    seen : map from the board to the image, through the middles of the ellipses
    size : width and height of the image [px]
    """
    first = fits.pixels - _bias(points, seen, _radius(points, fits.shape, seen))
    seen = plane_map(points, first, size)  # through the centres: the bias bends the other one
    return fits.pixels - _bias(points, seen, _radius(points, fits.shape, seen))


def _radius(points: Floats, shape: Floats, seen: PlaneMap) -> float:
    """Return the radius of the discs on the board, from the areas of their ellipses."""
    slope, _ = _seen_circles(points, seen, _TRIAL)
    return float(np.median((np.linalg.det(shape) / np.square(np.linalg.det(slope))) ** 0.25))


def _bias(points: Floats, seen: PlaneMap, radius: float) -> Floats:
    """Return by how much the middles of ellipses are beside the centres of the discs, (m, 2) [px].

    A circle about a disc's centre is mapped into the image, and an ellipse laid through it: with the linear part of the
    map undone it is a circle, but for a shift whose part along the radius goes with the cosine of the angle. Of a
    homography that is -r^2 J g / (1 - r^2 g^2), J its derivative and g that of its scale.
    """
    slope, circles = _seen_circles(points, seen, radius)
    rounded = np.einsum("nij,nkj->nki", np.linalg.inv(slope), circles)
    outwards = np.einsum("nki,ki->nk", rounded, _DIRECTIONS)
    return np.einsum("nij,nj->ni", slope, 2 * np.einsum("nk,ki->ni", outwards, _DIRECTIONS) / _ANGLES)


def _seen_circles(points: Floats, seen: PlaneMap, radius: float) -> tuple[Floats, Floats]:
    """Return the map's derivatives at the centres (m, 2, 2), and circles as they are seen from there (m, angles, 2)."""
    circles = points[:, None] + radius * np.concatenate([np.zeros((1, 2)), _DIRECTIONS])
    pixels = seen.pixels(circles, _ANGLES + 1)
    away = pixels[:, 1:] - pixels[:, :1]
    return 2 / (radius * _ANGLES) * np.einsum("nki,kj->nij", away, _DIRECTIONS), away


_TRIAL = 0.2  # radius of circles that tell the map's derivative
_DIRECTIONS = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)
