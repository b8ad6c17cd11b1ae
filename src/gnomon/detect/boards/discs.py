"""Discs in an image: where circles of a grid might be, and the ellipses that they are seen as.

A pixel is dark where it is nearer to the darkest than to the lightest one of its neighbourhood; a dark region counts
whose area is that of the ellipse with its second moments.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ...images import Grey
from ...recording import Floats
from .quads import black_limits

_CONTRAST = 0.3  # a neighbourhood with less contrast than this share of the strongest has no disc
_LEAST_AREA_PX, _LARGEST = 8.0, 0.03  # of a disc; the latter over the image
_LIKE_ELLIPSE = 0.1  # how far the area may be from that of the ellipse with the same second moments
_SMALL_PX = 60.0  # area from which on that is asked; smaller ones are rough
_FEWEST_POINTS = 4
_MOMENTS = ("m00", "m10", "m01", "mu20", "mu11", "mu02")
_THINNEST = 0.15  # smaller half axis over the larger one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
