"""Places where two edges cross, black and white wedges opposite each other: candidates for corners of a checkerboard.

At a crossing the smoothed image is a saddle: the determinant of its second derivatives is negative. Around it, on a
circle, the grey levels repeat after half a turn and cross their mean four times; where they do tells both edges.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...images import Grey
from ...recording import Floats, Integers

Singles = NDArray[np.float32]

_SMOOTHING_PX = 1.0
_APART = 5  # one candidate in a square of so many pixels
_STRIP_PIXELS, _STRIP_ROWS = 40_000, 32
_HALO = 3  # rows beyond a strip on which its saddles depend: the derivatives' and those nearby
_LEAST_STRENGTH = 100.0  # of a saddle, in the units of Sobel's second derivatives squared
_MOST_MAXIMA, _MOST = 700, 360
_RADIUS_PX = 3.0
_ANGLES = 32
_LEAST_AMPLITUDE = 5.0  # grey levels, half the swing on the circle
_ODD = 0.75  # largest rms of what changes sign after half a turn, over the rms of what does not
_LEAST_SINE = 0.25  # between the two edges


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Saddles:
    """Crossings of two edges in an image.

    Attributes
    ----------
    pixels : (n, 2) [px], to about half a pixel
    edges : (n, 2) angles of both edges, 0 to pi from x towards y: turning on from the first one enters black
    swing : (n,) half the difference between white and black, in grey levels
    """

    pixels: Floats
    edges: Floats
    swing: Floats

    def __len__(self) -> int:
        return len(self.pixels)


def find_saddles(image: Grey) -> Saddles:
    """Return the crossings in an image, strongest first, in time that is bounded whatever the image shows."""
    smooth = np.asarray(cv2.GaussianBlur(image, (5, 5), _SMOOTHING_PX), np.uint8)
    pixels = _maxima(smooth)
    profile = _circles(smooth.astype(np.float32), pixels)
    half = _ANGLES // 2
    even, odd = 0.5 * (profile[:, :half] + profile[:, half:]), 0.5 * (profile[:, :half] - profile[:, half:])
    even = even - 0.5 * (even.min(axis=1) + even.max(axis=1))[:, None]
    swing = even.max(axis=1)
    changes = (even > 0) != np.roll(even > 0, -1, axis=1)
    plausible = (
        (changes.sum(axis=1) == 2)
        & (swing > _LEAST_AMPLITUDE)
        & (np.square(odd).sum(axis=1) < _ODD**2 * np.square(even).sum(axis=1))
    )
    edges = _edge_angles(even[plausible])
    pixels, swing = pixels[plausible], swing[plausible]
    wide = np.abs(np.sin(edges[:, 1] - edges[:, 0])) > _LEAST_SINE
    kept = np.flatnonzero(wide)[:_MOST]
    return Saddles(pixels=pixels[kept].astype(np.float64), edges=edges[kept], swing=swing[kept].astype(np.float64))


def _maxima(smooth: Grey) -> Singles:
    """Return where the image is most like a saddle, (n, 2), the strongest first.

    It is gone through in strips whose arrays stay in the processor's cache.
    """
    height, width = smooth.shape
    step = max(_STRIP_PIXELS // width, _STRIP_ROWS)
    strips = [_peaks(smooth, start, min(start + step, height)) for start in range(0, height, step)]
    rows, columns, strength = (np.concatenate(items) for items in zip(*strips, strict=True))
    border = int(np.ceil(_RADIUS_PX)) + 1
    inner = np.minimum(rows, columns) >= border
    inner &= (rows < height - border) & (columns < width - border)
    rows, columns, strength = rows[inner], columns[inner], strength[inner]
    if len(strength) > _MOST_MAXIMA:
        kept = np.argpartition(-strength, _MOST_MAXIMA)[:_MOST_MAXIMA]
        rows, columns, strength = rows[kept], columns[kept], strength[kept]
    order = np.lexsort((columns, rows, -strength))
    return np.stack([columns, rows], axis=1)[order].astype(np.float32)


def _peaks(smooth: Grey, start: int, stop: int) -> tuple[Integers, Integers, Singles]:
    """Return rows, columns and strengths of the saddles in some rows of an image that are the strongest nearby."""
    first = max(start - _HALO, 0)
    strip = smooth[first : stop + _HALO]
    xx = cv2.Sobel(strip, cv2.CV_16S, 2, 0, ksize=3)
    yy = cv2.Sobel(strip, cv2.CV_16S, 0, 2, ksize=3)
    xy = cv2.Sobel(strip, cv2.CV_16S, 1, 1, ksize=3)
    # Sobel's kernels sum to 4 for second derivatives along an axis and to 4 for the mixed one.
    strength = cv2.multiply(xy, xy, dtype=cv2.CV_32F)
    other = cv2.multiply(xx, yy, dtype=cv2.CV_32F)
    cv2.subtract(strength, other, dst=strength)
    highest = cv2.dilate(strength, np.ones((_APART, _APART), np.uint8), dst=other)
    peaks = np.flatnonzero(strength >= highest)
    values = np.asarray(strength, np.float32).ravel()[peaks]
    rows, columns = np.divmod(peaks, strip.shape[1])
    rows += first
    kept = (values > _LEAST_STRENGTH) & (rows >= start) & (rows < stop)
    return rows[kept], columns[kept], values[kept]


def _circles(smooth: Singles, pixels: Singles) -> Singles:
    """Return the grey levels on circles about pixels, (n, angles)."""
    if not len(pixels):
        return np.zeros((0, _ANGLES), np.float32)
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    x = pixels[:, :1] + (_RADIUS_PX * np.cos(angle)).astype(np.float32)
    y = pixels[:, 1:] + (_RADIUS_PX * np.sin(angle)).astype(np.float32)
    return np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR), np.float32)


def _edge_angles(even: Singles) -> Floats:
    """Return where the profile over half a turn falls through zero, and where it rises, (n, 2) [rad]."""
    following = np.concatenate([even[:, 1:], even[:, :1]], axis=1)
    rows = np.arange(len(even))
    angles = np.empty((len(even), 2))
    for k, crossing in enumerate(((even > 0) & (following <= 0), (even <= 0) & (following > 0))):
        at = crossing.argmax(axis=1)
        before, after = even[rows, at], following[rows, at]
        angles[:, k] = (at + before / (before - after)) * (2 * np.pi / _ANGLES)
    return np.mod(angles, np.pi)
