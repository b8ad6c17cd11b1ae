"""Single images as they are, without a board: how sharp, how bright, how large.

The blur of an edge follows from how much its gradient falls when the image is blurred once more: with two widths
s1 < s2 of a Gaussian derivative, the peaks over an edge of blur s are as sqrt(s^2 + s2^2) to sqrt(s^2 + s1^2). A lens
blurs all edges, motion only those that it crosses; so edges are sorted by their direction, and the worst direction
counts.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..findings import Finding, make_finding
from ..images import Grey
from ..models.camera import Camera
from ..recording import Floats
from .image_checks import BRIGHT, DARK, FLAT, blur_findings

_WIDTHS_PX = (1.0, 2.0)
_DIFFERENCE = 1.0 / 3.0  # variance that the central difference adds [px^2]
_DIRECTIONS = 4
_FEWEST_EDGES = 300
_STRONGEST = 0.7  # quantile of the gradient from which edges are taken for those of sharp things
_WEAKEST = 2.0  # grey levels a pixel
_WIDEST_PX = 20.0

_BLURRED_PX = 2.0  # half a pixel beyond what is borne at a board: not everything in a room has sharp edges
_CLIPPED_SHARE = 0.25
_MANY = 0.2
_SAME = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageLook:
    """What one image is like.

    Attributes
    ----------
    size : (width, height)
    blur_px : standard deviation of the blur, along the direction in which it is worst [px]; nan where there are too
        few edges
    low, high : grey levels below which, and above which, a hundredth of the pixels lies
    clipped : share of pixels that read 250 or more
    digest : hash of the pixels
    """

    size: tuple[int, int]
    blur_px: float
    low: float
    high: float
    clipped: float
    digest: bytes


def look_at(image: Grey) -> ImageLook:
    """Measure one image, (height, width)."""
    low, high = np.quantile(image[::2, ::2], [0.01, 0.99])
    return ImageLook(
        size=(image.shape[1], image.shape[0]),
        blur_px=edge_blur(image),
        low=float(low),
        high=float(high),
        clipped=float(np.mean(image >= BRIGHT)),
        digest=hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest(),
    )


def edge_blur(image: Grey) -> float:
    """Return the standard deviation of the blur at the strong edges of an image [px]; nan where there are too few."""
    if min(image.shape) < 16:
        return float("nan")
    (x, y), (x_wide, y_wide) = (_gradient(image, width) for width in _WIDTHS_PX)
    fine, wide = x * x + y * y, x_wide * x_wide + y_wide * y_wide
    across = np.abs(x) > np.abs(y)
    middle = np.s_[1:-1, 1:-1]
    before = np.where(across[middle], fine[1:-1, :-2], fine[:-2, 1:-1])
    after = np.where(across[middle], fine[1:-1, 2:], fine[2:, 1:-1])
    weakest = max(_WEAKEST, 3 * float(np.median(np.sqrt(fine[::4, ::4])))) ** 2
    peak = (fine[middle] >= before) & (fine[middle] >= after) & (fine[middle] > weakest)
    strength = fine[middle][peak]
    if len(strength) < _FEWEST_EDGES:
        return float("nan")
    fall = strength / np.maximum(wide[middle][peak], 1e-9)
    first, second = (width**2 + _DIFFERENCE for width in _WIDTHS_PX)
    blur = np.sqrt(np.clip((second - fall * first) / np.maximum(fall - 1, 1e-3), 0, _WIDEST_PX**2))
    angle = np.arctan2(y[middle][peak], x[middle][peak]) / np.pi
    sector = np.floor(np.mod(_DIRECTIONS * angle + 0.5, _DIRECTIONS)).astype(np.int64)
    found = [_of_strongest(blur[sector == k], strength[sector == k]) for k in range(_DIRECTIONS)]
    known = [value for value in found if np.isfinite(value)]
    return max(known, default=float("nan"))


def _gradient(image: Grey, width_px: float) -> tuple[Floats, Floats]:
    import cv2  # OpenCV takes half of a second to load

    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), width_px)
    x, y = np.zeros_like(smooth), np.zeros_like(smooth)
    x[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    y[1:-1] = (smooth[2:] - smooth[:-2]) / 2
    return x, y  # pyright: ignore[reportReturnType]


def _of_strongest(blur: Floats, strength: Floats) -> float:
    if len(blur) < _FEWEST_EDGES:
        return float("nan")
    return float(np.median(blur[strength >= np.quantile(strength, _STRONGEST)]))


def check_sizes(name: str, looks: Sequence[ImageLook], camera: Camera | None) -> list[Finding]:
    """Return findings on sizes of images that differ from each other or from the camera's, and on repeated images.

    Codes: image-size, images-same.
    """
    sizes = list(dict.fromkeys(look.size for look in looks))
    if not sizes:
        return []
    if len(sizes) > 1:
        return [make_finding("image-size/mixed", name=name, sizes=", ".join(f"{w} x {h}" for w, h in sizes[:4]))]
    if camera is not None and sizes[0] != camera.resolution:
        (width, height), (stated_width, stated_height) = sizes[0], camera.resolution
        return [
            make_finding(
                "image-size/stated",
                name=name,
                width=width,
                height=height,
                stated_width=stated_width,
                stated_height=stated_height,
            )
        ]
    same = 1 - len({look.digest for look in looks}) / len(looks)
    if len(looks) < 3 or same <= _SAME:
        return []
    return [make_finding("images-same", name=name, same=same, images=len(looks))]


def check_looks(name: str, looks: Sequence[ImageLook]) -> list[Finding]:
    """Return findings on the sharpness and the exposure of images in which no board is known.

    Codes: images, motion-blur, out-of-focus, images-bright, images-dark, images-flat.
    """
    if not looks:
        return []
    blur = np.array([look.blur_px for look in looks])
    low, high, clipped = (np.array([getattr(look, key) for look in looks]) for key in ("low", "high", "clipped"))
    findings = [*blur_findings(name, blur, _BLURRED_PX, "strong edges"), *_light(name, low, high, clipped)]
    if not findings and np.isfinite(blur).any():
        findings.append(
            make_finding(
                "images/sampled",
                name=name,
                blur_px=np.nanmedian(blur),
                median_low=np.median(low),
                median_high=np.median(high),
            )
        )
    return findings


def _light(name: str, low: Floats, high: Floats, clipped: Floats) -> list[Finding]:
    bright, dark, flat = clipped > _CLIPPED_SHARE, high < DARK, high - low < FLAT
    levels = f"grey levels {np.median(low):.0f} to {np.median(high):.0f} of 255"
    if np.mean(bright) > _MANY:
        return [
            make_finding(
                "images-bright/sampled", name=name, bright=np.mean(bright), median_clipped=np.median(clipped[bright])
            )
        ]
    if np.mean(dark) > _MANY:
        return [make_finding("images-dark/sampled", name=name, dark=np.mean(dark), levels=levels)]
    if np.mean(flat) > _MANY:
        return [make_finding("images-flat/sampled", name=name, flat=np.mean(flat), levels=levels)]
    return []
