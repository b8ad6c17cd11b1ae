"""Circle grids and ChArUco boards that images show, in a few words; asked where the stated board is not found."""

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from ...images import Grey
from ...models.target import Target
from ...recording import Integers
from .checkerboard import reduced
from .disc_lattice import disc_lattices
from .discs import find_discs
from .markers import read_markers
from .quads import black_quads

_FEWEST_DISCS, _FULL = 12, 0.9
_LARGE_PX = 1.3e6
_FEWEST_MARKERS, _OFTEN = 6, 0.35
_DICTIONARIES = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL")


def circles_shown(images: Sequence[Grey]) -> str:
    """Return what grid of circles most images show, such as "a circle grid of 8 x 6"; "" where there is none."""
    found: Counter[str] = Counter()
    for image in images:
        small = reduced(image, max(int(np.ceil(np.sqrt(image.size / _LARGE_PX))), 1))
        for picture in (small, np.asarray(cv2.bitwise_not(small), np.uint8)):
            lattices = disc_lattices(find_discs(picture))
            words = _grid(lattices[0].place) if lattices and len(lattices[0]) >= _FEWEST_DISCS else ""
            if words:
                found[words] += 1
                break
    return found.most_common(1)[0][0] if found else ""


def _grid(place: Integers) -> str:
    """Return the grid that fills places (n, 2) of a square lattice; "" where none does."""
    rows, cols = sorted((np.ptp(place, axis=0) + 1).tolist())
    if len(place) >= _FULL * rows * cols:
        return f"a circle grid of {cols} x {rows}"
    turned = np.stack([place[:, 0] - place[:, 1], place[:, 0] + place[:, 1]], axis=1)
    along = np.ptp(turned, axis=0) + 1  # every other place of it is empty
    if len(place) >= _FULL * along.prod() / 2:
        ways = [f"{wide // 2} x {high}" for wide, high in (along, along[::-1]) if wide % 2 == 0]
        return f"an asymmetric circle grid of {' or '.join(ways)}" if ways else ""
    return ""


def markers_shown(images: Sequence[Grey], stated: Target) -> str:
    """Return which ArUco markers images show, such as "markers 0 to 23 of 4X4_1000"; "" where there are hardly any."""
    best: list[int] = []
    name = ""
    quads = [black_quads(image) for image in images]
    for dictionary in dict.fromkeys((*((stated.dictionary,) if stated.kind == "charuco" else ()), *_DICTIONARIES)):
        numbers: Counter[int] = Counter()
        for image, outlines in zip(images, quads, strict=True):
            numbers.update(set(read_markers(image, outlines, dictionary, first=0, count=1 << 20).number.tolist()))
        least = _OFTEN * max(numbers.values(), default=0)  # others are misread
        often = sorted(number for number, times in numbers.items() if times > least)
        if len(often) > len(best):
            best, name = often, dictionary
    return f"markers {best[0]} to {best[-1]} of {name}" if len(best) >= _FEWEST_MARKERS else ""
