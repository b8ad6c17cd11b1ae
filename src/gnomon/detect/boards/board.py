"""What one image shows of a calibration board."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...frozen import FrozenMapping
from ...recording import Floats, Integers, frozen_array

NOT_WITH_NEIGHBOURS = "not where its neighbours say"
"""Reason for which corners of tags are left out."""

DIFFERS = "The stated board differs"
"""Where this is said of images, they show an AprilGrid that is not the stated one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The corners of a board that were found in one image.

    Attributes
    ----------
    point : (m,) number on the target, as `Target.points` counts; ascending, each once
    pixels : (m, 2) [px]; (0, 0) is the centre of the top left pixel
    sigma_px : (m,) standard deviation per axis [px]
    blur_px : standard deviation of the blur at the corners, their median [px]; nan where none was found
    black, white : grey levels of the board, medians; nan where it was not found
    dropped : reason -> number of corners that were found and left out
    """

    point: Integers
    pixels: Floats
    sigma_px: Floats
    blur_px: float = float("nan")
    black: float = float("nan")
    white: float = float("nan")
    dropped: Mapping[str, int] = field(default_factory=Counter[str])

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, np.int64))
        object.__setattr__(self, "pixels", frozen_array(self.pixels))
        object.__setattr__(self, "sigma_px", frozen_array(self.sigma_px))
        object.__setattr__(self, "dropped", FrozenMapping(self.dropped))

    def __len__(self) -> int:
        return len(self.point)


def nothing_seen(dropped: Mapping[str, int] | None = None) -> BoardView:
    """Return the view of an image in which the board was not found."""
    none = np.empty(0)
    return BoardView(point=np.empty(0, np.int64), pixels=none.reshape(0, 2), sigma_px=none, dropped=dropped or {})
