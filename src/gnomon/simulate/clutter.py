"""What is around a board: a wall with edges, lines and texture, and with tags that are not of the board."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..models.board_pattern import tag_cells, tag_codes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wall:
    """A plane behind the board, parallel to it; beyond its picture that is mirrored again and again.

    Attributes
    ----------
    texels : (rows, cols) grey levels; rows along y of the board's frame, columns along x
    origin : x and y of the centre of texel [0, 0] [m]
    texel_m : side of a texel [m]
    behind_m : distance from the board [m]
    """

    texels: NDArray[np.uint8]
    origin: tuple[float, float]
    texel_m: float
    behind_m: float


@lru_cache(maxsize=8)
def cluttered_wall(seed: int, *, foreign_tags: int = 12, own_tags: int = 36, behind_m: float = 0.6) -> Wall:
    """Return a wall full of things.

    Parameters
    ----------
    seed : every random number follows from it
    foreign_tags : number of tags of the family 36h11 that are drawn, a third each with ids of the board and a border of
        1 bit, with ids of the board and a border of 2 bits, and with other ids
    own_tags : number of tags of the board, whose ids are counted from 0
    behind_m : distance from the board [m]
    """
    import cv2

    rng = np.random.default_rng(seed)
    side, texel_m = 1600, 0.0025
    coarse = [rng.normal(0.0, level, (side // cell, side // cell)) for cell, level in ((100, 18), (25, 9), (5, 6))]
    grey = 110 + sum(
        cv2.resize(part.astype(np.float32), (side, side), interpolation=cv2.INTER_CUBIC) for part in coarse
    )
    texels = np.clip(grey, 0, 255).astype(np.uint8)
    for _ in range(40):
        shade = int(rng.integers(5, 250))
        corner = rng.integers(0, side, 2)
        if rng.random() < 0.5:
            box = cv2.RotatedRect(corner.tolist(), rng.integers(10, 160, 2).tolist(), float(rng.uniform(0, 180)))
            cv2.fillPoly(texels, [np.rint(box.points()).astype(np.int32)], shade, lineType=cv2.LINE_AA)
        else:
            end = (corner + rng.integers(-300, 300, 2)).tolist()
            cv2.line(texels, corner.tolist(), end, shade, int(rng.integers(1, 12)), cv2.LINE_AA)
    for k in range(foreign_tags):
        strange = k % 3 == 2
        tag = int(rng.integers(own_tags, len(tag_codes())) if strange else rng.integers(0, own_tags))
        _stick(texels, tag_cells(tag, 1 if k % 3 == 0 else 2), rng)
    return Wall(texels=texels, origin=(-texel_m * side / 2, -texel_m * side / 2), texel_m=texel_m, behind_m=behind_m)


def _stick(texels: NDArray[np.uint8], cells: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Draw a tag with a white rim somewhere, at any angle."""
    import cv2

    rim = np.pad(cells, 1, constant_values=True)[::-1]  # rows go up, as y does
    side = rng.uniform(24, 100)
    angle = rng.uniform(0, 2 * np.pi)
    turn = side / len(rim) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = rng.uniform(0.1, 0.9, 2) * texels.shape
    to_wall = np.column_stack([turn, middle - turn @ np.full(2, (len(rim) - 1) / 2)])
    inside = np.full(rim.shape, 255, np.uint8)
    size = (texels.shape[1], texels.shape[0])
    # the cells are drawn larger first: interpolation between single texels would blur them
    finer = 16
    picture = np.kron(rim, np.ones((finer, finer))).astype(np.uint8) * 235 + 15
    shrink = np.array([[1 / finer, 0, (1 / finer - 1) / 2], [0, 1 / finer, (1 / finer - 1) / 2], [0, 0, 1]])
    whole = np.vstack([to_wall, [0, 0, 1]]) @ shrink
    mask = np.kron(inside, np.ones((finer, finer), np.uint8))
    drawn = cv2.warpAffine(picture, whole[:2], size, flags=cv2.INTER_AREA)
    share = cv2.warpAffine(mask, whole[:2], size, flags=cv2.INTER_AREA)
    texels[share > 127] = drawn[share > 127]
