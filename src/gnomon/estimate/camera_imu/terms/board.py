"""Where the corners of a board truly are: a shift of each from its nominal place, shared by all cameras.

A bad print, a warped plate and the bias of a detector are all alike on the images: each corner stays off its nominal
place, in all frames and cameras. A shift, a turn or another size of the whole board would only be another trajectory,
another direction of gravity, another scale: these seven freedoms are taken from the shifts.
"""

from dataclasses import replace

import numpy as np

from ....frozen import value_class
from ....models.target import Target
from ....recording import Floats

OFFSETS = "target.offsets"
"""Name of the block of these shifts."""

_SHARE = 0.01
"""Prior standard deviation of a corner's shift, as a share of the side of a tag or a square, or the distance of two
circles: what a bad print or a detector does, and far more than the recording leaves open."""

_SCENE = 0.2
"""The same of a landmark, as a share of the size of the scene."""

_GAUGE = 1e-3
"""Standard deviation of the freedoms of the whole board, as a share of that of a corner."""


@value_class
class BoardPoints:
    """The corners of the target.

    Attributes
    ----------
    points : (k, 3) nominal places, target frame [m]
    offsets : (k, 3) from there to where they are [m]
    sigma_m : prior standard deviation of an offset, each axis
    pitch_m : distance of a corner from the same corner of the next tag, or from the next corner or circle
    """

    points: Floats
    offsets: Floats
    sigma_m: float
    pitch_m: float

    @classmethod
    def nominal(cls, target: Target) -> "BoardPoints":
        """Return a board as it was stated; of landmarks hardly more than that they are there is known."""
        sides = {
            "aprilgrid": target.tag_size_m,
            "checkerboard": min(target.row_spacing_m, target.col_spacing_m),
            "circlegrid": target.spacing_m,
            "charuco": target.square_size_m,
            "landmarks": _SCENE / _SHARE * float(np.sqrt(np.mean((target.points - target.points.mean(axis=0)) ** 2))),
        }
        side = sides[target.kind]
        return cls(
            points=target.points,
            offsets=np.zeros_like(target.points),
            sigma_m=_SHARE * side,
            pitch_m=side * (1 + target.tag_spacing),
        )

    def moved(self, step: Floats) -> "BoardPoints":
        """Return the board with a step (3 k,) of its corners."""
        return replace(self, offsets=self.offsets + step.reshape(-1, 3))

    def similarity(self) -> Floats:
        """Return orthonormal rows (7, 3 k): how corners move when the board is shifted, turned or made larger."""
        centred = self.points - self.points.mean(axis=0)
        size = np.sqrt(np.mean(centred**2))
        unit = centred / size
        moves = [np.broadcast_to(axis, unit.shape) for axis in np.eye(3)]
        moves += [np.cross(axis, unit) for axis in np.eye(3)]
        moves.append(unit)
        rows = np.array([move.ravel() for move in moves])
        return np.ascontiguousarray(np.linalg.qr(rows.T)[0].T)

    def gauge_information(self) -> Floats:
        """Return the information (3 k, 3 k) by which the freedoms of the whole board are held, beside the prior."""
        rows = self.similarity() / (_GAUGE * self.sigma_m)
        return rows.T @ rows
