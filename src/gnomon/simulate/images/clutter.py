"""What is around a board: a wall behind it, with edges, lines, texture and foreign tags; hands and cables before it."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.board_pattern import tag_cells, tag_codes
from ...recording import Floats

_POINTS = 48  # of an outline


@value_class
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


@value_class
class _Occluder:
    """One of them; all numbers in px but for those of time.

    Attributes
    ----------
    outline : (n, 2) about its middle
    middle : (2,) of its way
    swing : (2,) how far it moves to both sides
    pulsation, phase : (2,) of the swing [rad/s], [rad]
    """

    outline: Floats
    middle: Floats
    swing: Floats
    pulsation: Floats
    phase: Floats

    def at(self, t_s: float) -> Floats:
        return self.outline + self.middle + self.swing * np.sin(self.pulsation * t_s + self.phase)


@value_class
class MovingOccluders:
    """Hands and cables before a board."""

    occluders: tuple[_Occluder, ...]

    def at(self, t_s: float) -> list[Floats]:
        """Return their outlines (n, 2) [px] at an instant, for `gnomon.simulate.rendering.render_board`."""
        return [one.at(t_s) for one in self.occluders]


def moving_occluders(count: int, seed: tuple[int, ...], resolution: tuple[int, int]) -> MovingOccluders | None:
    """Return so many of them, hands and cables in turn; None for none.

    Parameters
    ----------
    count : of hands and cables
    seed : every random number follows from it
    resolution : (width, height) of the images [px]
    """
    if not count:
        return None
    rng, size = np.random.default_rng([*seed, count]), np.array(resolution, dtype=np.float64)
    occluders = [
        _Occluder(
            outline=(_hand if k % 2 == 0 else _cable)(size, rng),
            middle=size * rng.uniform(0.15, 0.85, 2),
            swing=size * rng.uniform(0.1, 0.4, 2),
            pulsation=rng.uniform(0.3, 1.5, 2),
            phase=rng.uniform(0, 2 * np.pi, 2),
        )
        for k in range(count)
    ]
    return MovingOccluders(occluders=tuple(occluders))


def _hand(size: Floats, rng: np.random.Generator) -> Floats:
    """Return a lump with fingers."""
    angle = np.linspace(0, 2 * np.pi, _POINTS, endpoint=False)
    fingers = 0.25 * np.cos(rng.integers(4, 7) * angle + rng.uniform(0, 6)) + 0.15 * np.cos(2 * angle)
    radius = size.min() * rng.uniform(0.06, 0.12) * (1 + fingers)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _cable(size: Floats, rng: np.random.Generator) -> Floats:
    """Return a thin band across the image, bent."""
    along = np.linspace(-0.8, 0.8, _POINTS // 2) * np.linalg.norm(size)
    bent = size.min() * rng.uniform(0.05, 0.15) * np.sin(along / size.min() * rng.uniform(2, 5) + rng.uniform(0, 6))
    half, turn = size.min() * rng.uniform(0.006, 0.015), rng.uniform(0, np.pi)
    band = np.concatenate([np.column_stack([along, bent + half]), np.column_stack([along[::-1], bent[::-1] - half])])
    return band @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
