"""Which board do images show? Asked where the one that was stated is hardly ever found."""

from collections import Counter
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np

from ...frozen import value_class
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.recording import Grey
from .board import DIFFERS
from .checkerboard import board_near, checkerboard_search_scale, fill_grid, reduce_image
from .discs import disc_lattices, find_discs
from .lattice import Lattice, find_lattices, find_saddles
from .marker_boards import black_quads
from .tags import Tags, read_markers, read_tags, square_to_quads

_MOST_IMAGES = 16
_FEWEST_TAGS = 4
_FEWEST_CORNERS = 12
_OCCUPIED = 0.5  # share of a line of corners that makes it part of the board
_FLAT = 6.0  # grey levels from the darkest to the brightest part of an image that shows nothing
_FEWEST_GAPS, _SPACING = 6, 0.03  # to tell the gap between tags, and by how much it may be off at least, over the tag
_STRAIGHT, _FARTHEST = 0.3, 2.6  # how far from a line, and from each other, the middles of neighbours may be, in tags
_BORDERS = (2, 1)
_FEWEST_DISCS, _FULL = 12, 0.9
_LARGE_PX = 1.3e6
_FEWEST_MARKERS, _OFTEN = 6, 0.35
_DICTIONARIES = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL")


def guess_board(images: Sequence[Grey], stated: Target) -> str:
    """Return a few sentences on the board that images seem to show.

    Parameters
    ----------
    images : some of a recording, over all of its length; of more than 16 as many are looked at
    stated : the board that was expected
    """
    looked = [images[i] for i in np.unique(np.linspace(0, len(images) - 1, _MOST_IMAGES).astype(int))] if images else []
    if not looked:
        return "There is no image to look at."
    if all(_is_flat(image) for image in looked):
        return "The images show nothing at all: they are of one grey level. Check exposure, lens cap and encoding."
    tags = _tag_board(looked)
    checkerboard, part = _checkerboard(looked)
    if tags is not None and tags.count >= _FEWEST_TAGS and tags.numbers:
        return _about_tags(tags, stated)
    return (
        _about_markers(markers_shown(looked, stated), stated)
        or _about_circles(circles_shown(looked), stated)
        or _about_squares(checkerboard, part, stated)
    )


def _about_markers(shown: str, stated: Target) -> str:
    if not shown:
        return ""
    text = f"They show a ChArUco board, or ArUco markers: {shown}."
    if stated.kind != "charuco":
        return f"{text} State that board instead of the {stated.kind}."
    return f"{text} Compare columns, rows, dictionary, first marker and legacy of the stated {stated.describe()}."


def _about_circles(shown: str, stated: Target) -> str:
    if not shown:
        return ""
    if stated.kind != "circlegrid":
        return f"They show {shown}. State that board instead of the {stated.kind}."
    return f"They show {shown}. The stated one is: {stated.describe()}. It must be in the image as a whole."


def _about_squares(whole: tuple[int, int] | None, part: tuple[int, int] | None, stated: Target) -> str:
    if whole is not None:
        return _about_checkerboard(whole, stated)
    if part is not None:
        return (
            f"They show parts of a checkerboard, {_by(part)} inner corners and perhaps more. A checkerboard must be in "
            "the image as a whole, with a white margin around it."
        )
    return (
        "They show no board that can be recognised: neither tags of the family 36h11, nor ArUco markers, circles or a "
        "checkerboard. Check that the board is in view, sharp, well lit, and large enough in the image."
    )


def _is_flat(image: Grey) -> bool:
    low, high = np.quantile(image[::5, ::5], [0.02, 0.98])
    return bool(high - low < _FLAT)


@value_class
class _TagBoard:
    """Tags as they were read in several images: with a border of some bits, perhaps only in the mirror."""

    views: tuple[Tags, ...]
    border_bits: int
    mirrored: bool

    @property
    def count(self) -> int:
        return sum(len(view) for view in self.views)

    @property
    def numbers(self) -> list[int]:
        """Numbers of the tags, those left out that were read only once, while others were read more often."""
        cols = self.cols
        often = Counter(int(number) for view in self.views for number in view.number[_in_order(view, cols)])
        most = max(often.values(), default=0)
        return sorted(number for number, times in often.items() if times > 1 or most < 4)

    @property
    def cols(self) -> int:
        """By how much the numbers of most tags grow from row to row; 0 where that cannot be told."""
        growths = Counter(int(growth) for view in self.views for growth in _growths(view) if growth > 0)
        return max(growths, key=lambda growth: growths[growth], default=0)

    @property
    def gaps(self) -> Floats:
        """The gaps between tags of neighbouring numbers, over the tag."""
        return np.concatenate([_gaps(view) for view in self.views])


def _tag_board(images: Sequence[Grey]) -> _TagBoard | None:
    """Return the tags with the border that reads most of them, as they are or in the mirror."""
    quads = [black_quads(image) for image in images]
    boards: list[_TagBoard] = []
    for mirrored, bits in product((False, True), _BORDERS):
        views: list[Tags] = []
        for image, outlines in zip(images, quads, strict=True):
            if mirrored:
                turned_over = outlines[:, ::-1] * [-1, 1] + [image.shape[1] - 1, 0]
                views.append(read_tags(np.ascontiguousarray(image[:, ::-1]), turned_over, border_bits=bits))
            else:
                views.append(read_tags(image, outlines, border_bits=bits))
        boards.append(_TagBoard(views=tuple(map(_in_grids, views)), border_bits=bits, mirrored=mirrored))
    return max(boards, key=lambda board: board.count)


def _places_in_tags(view: Tags) -> Floats:
    """Return where the middles of all tags are as seen from the middle of each one, (k, k, 2) [tags]."""
    inverse = np.linalg.inv(square_to_quads(view.corners))
    x, y, w = np.einsum("kij,nj->ikn", inverse, np.column_stack([view.corners.mean(axis=1), np.ones(len(view))]))
    w = np.where(np.abs(w) < 1e-9, 1e-9, w)
    return np.stack([x / w - 0.5, y / w - 0.5], axis=2)


def _in_grids(view: Tags) -> Tags:
    """Return the tags that have another one straight beside, above or below them: foreign ones stand alone."""
    if not len(view):
        return view
    place = np.abs(_places_in_tags(view))
    near, far = place.min(axis=2), place.max(axis=2)
    beside = (near < _STRAIGHT) & (far > 1.0) & (far < _FARTHEST)
    kept = (beside & beside.T).any(axis=1)
    return view.only(kept)


def _gaps(view: Tags) -> Floats:
    """Return the gaps between tags and those numbered next to them, over the tag, in each tag's own perspective."""
    if not len(view):
        return np.empty(0)
    place = _places_in_tags(view)
    onward = view.number[None, :] - view.number[:, None]
    distance = place[..., 0] * onward
    chosen = (np.abs(onward) == 1) & (np.abs(place[..., 1]) < _STRAIGHT) & (distance > 1.0) & (distance < _FARTHEST)
    return distance[chosen] - 1.0


def _growths(view: Tags) -> Integers:
    """Return by how much the numbers of the nearest tags straight above are larger than those of tags."""
    if not len(view):
        return np.empty(0, np.int64)
    place = _places_in_tags(view)
    above = (np.abs(place[..., 0]) < _STRAIGHT) & (place[..., 1] > 1.0) & (place[..., 1] < _FARTHEST)
    nearest = np.where(above, place[..., 1], np.inf).argmin(axis=1)
    return (view.number[nearest] - view.number)[above.any(axis=1)]


def _in_order(view: Tags, cols: int) -> Booleans:
    """Tell which tags have a neighbour whose number is one more or less, or so many columns: foreign ones have not."""
    if not len(view):
        return np.empty(0, bool)
    place = _places_in_tags(view)
    onward = view.number[None, :] - view.number[:, None]
    beside = (onward == np.sign(place[..., 0])) & (np.abs(place[..., 1]) < _STRAIGHT)
    above = (onward == cols * np.sign(place[..., 1])) & (np.abs(place[..., 0]) < _STRAIGHT)
    return ((beside | above) & (np.abs(place).max(axis=2) < _FARTHEST) & (onward != 0)).any(axis=1)


def _about_tags(board: _TagBoard, stated: Target) -> str:
    numbers, cols, gaps = board.numbers, board.cols, board.gaps
    first, last = numbers[0], numbers[-1]
    told = f"tags {first} to {last} of the family 36h11" if len(numbers) > 1 else f"tag {first} of the family 36h11"
    told += f", with a border of {board.border_bits} bit{'s' * (board.border_bits > 1)}"
    if cols:
        told += f", {cols} in a row"
    if len(gaps) >= _FEWEST_GAPS:
        told += f", gaps of {np.median(gaps):.2f} tags"
    text = f"They show an AprilGrid: {told}."
    if board.mirrored:
        text += " Its tags can only be read in the mirror: turn the mirroring of the camera's images off."
    if stated.kind != "aprilgrid":
        return f"{text} State that board instead of a {stated.kind}."
    return f"{text} {_difference(board, stated)}"


def _difference(board: _TagBoard, stated: Target) -> str:
    """Return what in the stated AprilGrid is not as the images have it."""
    numbers, cols, gaps = board.numbers, board.cols, board.gaps
    first, last = stated.first_tag, stated.first_tag + stated.tags - 1
    wrong: list[str] = []
    if numbers[0] < first or numbers[-1] > last:
        wrong.append(f"its tags are {first} to {last}")
    if board.border_bits != stated.border_bits:
        wrong.append(f"its tagBorderBits is {stated.border_bits}")
    if cols and cols != stated.cols:
        exchanged = cols == stated.rows and stated.rows != stated.cols
        wrong.append(f"it has {stated.cols} columns" + (" (are tagCols and tagRows exchanged?)" if exchanged else ""))
    if len(gaps) >= _FEWEST_GAPS and abs(np.median(gaps) - stated.tag_spacing) > _doubt(gaps):
        wrong.append(f"its tagSpacing is {stated.tag_spacing:.2g} (the gap over the side of a tag)")
    if wrong:
        return f"{DIFFERS}: {', '.join(wrong)}."
    return "That is the stated one, but in most images too little of it can be read."


def _doubt(gaps: Floats) -> float:
    """Return by how much the median of gaps may be wrong."""
    scatter = 1.4826 * float(np.median(np.abs(gaps - np.median(gaps))))
    return max(_SPACING, 4 * 1.25 * scatter / np.sqrt(len(gaps)))


def _checkerboard(images: Sequence[Grey]) -> tuple[tuple[int, int] | None, tuple[int, int] | None]:
    """Return the size of the checkerboard that most images show as a whole, and the largest part of one."""
    whole: Counter[tuple[int, int]] = Counter()
    parts: list[tuple[int, int]] = []
    for image in images:
        scale = checkerboard_search_scale(image)
        for factor in {scale, max(scale // 2, 1)}:
            small = reduce_image(image, factor)
            for lattice in find_lattices(small, find_saddles(small))[:1]:
                grid = _trimmed(lattice)
                size = (max(grid.shape[:2]), min(grid.shape[:2]))
                if len(lattice) < _FEWEST_CORNERS or size[1] < 2:
                    continue
                parts.append(size)
                whole[size] += board_near(image, fill_grid(grid * factor + (factor - 1) / 2)) is not None
    best = max(whole, key=lambda size: whole[size], default=None)
    return best if best is not None and whole[best] else None, max(
        parts, key=lambda size: size[0] * size[1], default=None
    )


def _trimmed(lattice: Lattice) -> Floats:
    """Return the lattice without the outer lines that have few corners."""
    grid = lattice.grid()
    for _ in range(sum(grid.shape[:2])):
        share = [np.isfinite(line[:, 0]).mean() for line in (grid[0], grid[-1], grid[:, 0], grid[:, -1])]
        worst = int(np.argmin(share))
        if share[worst] > _OCCUPIED or min(grid.shape[:2]) < 2:
            break
        grid = (grid[1:], grid[:-1], grid[:, 1:], grid[:, :-1])[worst]
    return grid


def _about_checkerboard(size: tuple[int, int], stated: Target) -> str:
    text = f"They show a checkerboard of {_by(size)} inner corners."
    if stated.kind != "checkerboard":
        return f"{text} State that board instead of the {stated.kind}."
    expected = (max(stated.cols, stated.rows), min(stated.cols, stated.rows))
    if expected == (size[0] + 1, size[1] + 1):
        return (
            f"{text} The stated {_by(expected)} seem to count squares; targetCols and targetRows count inner corners."
        )
    if expected == size:
        return f"{text} That is the stated one, but in most images it is not visible as a whole, or not sharp."
    return f"{text} The stated one has {_by(expected)}: correct targetCols and targetRows."


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def circles_shown(images: Sequence[Grey]) -> str:
    """Return what grid of circles most images show, such as "a circle grid of 8 x 6"; "" where there is none."""
    found: Counter[str] = Counter()
    for image in images:
        small = reduce_image(image, max(int(np.ceil(np.sqrt(image.size / _LARGE_PX))), 1))
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
