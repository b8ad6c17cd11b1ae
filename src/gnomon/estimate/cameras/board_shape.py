"""The shape of a board: how its points move with its aspect, its bow, and one by one."""

import numpy as np

from ...models.target import Target
from ...recording import Floats
from ..camera_imu.terms.board_terms import BoardPoints
from .rig import BoardShape

ASPECT, BOW, OFFSETS = "target.aspect", "target.bow", "target.offsets"
"""Names of the blocks."""

ASPECT_SIGMA = 0.1
"""Prior standard deviation of the aspect: no board is printed so badly."""

_BOW_SHARE = 0.1  # prior standard deviation of the bow over the size of the board
_GAUGE = 1e-3  # standard deviation of what the offsets leave to others, as a share of that of a point


def stated_shape(target: Target) -> BoardShape:
    """Return the shape of a board that is as it was stated."""
    return BoardShape(aspect=0.0, bow_m=np.zeros(2), offsets=np.zeros((len(target), 3)))


def aspect_move(target: Target) -> Floats:
    """Return where each point moves as the aspect grows, (1, n, 3) [m]."""
    move = np.zeros((1, len(target), 3))
    move[0, :, 1] = target.points[:, 1]
    return move


def bow_moves(target: Target) -> Floats:
    """Return where each point moves as the bow along x and that along y grow, (2, n, 3) [m/m]."""
    centred = target.points[:, :2] - target.points[:, :2].mean(axis=0)
    half = np.maximum(np.ptp(centred, axis=0) / 2, 1e-12)
    moves = np.zeros((2, len(target), 3))
    moves[:, :, 2] = (1 - (centred / half) ** 2).T
    return moves


def bow_sigma(target: Target) -> float:
    """Return the prior standard deviation of the bow [m]: no board is bent so much."""
    return _BOW_SHARE * max(target.size_m)


def board_points(target: Target, shape: BoardShape) -> Floats:
    """Return where the points are, (n, 3) [m]."""
    moved = shape.aspect * aspect_move(target)[0] + np.tensordot(shape.bow_m, bow_moves(target), axes=1)
    return target.points + moved + shape.offsets


def offsets_information(target: Target, others: Floats) -> Floats:
    """Return the prior information of the points' offsets, (3 n, 3 n) [1/m^2].

    A shift, a turn or another size of the whole board is another pose or another distance of the cameras: the offsets
    hold none of it, nor of what else is estimated of the shape.

    Parameters
    ----------
    target : the board
    others : (k, n, 3) moves of the points that parameters of their own stand for
    """
    board = BoardPoints.nominal(target)
    rows = np.concatenate([board.similarity(), others.reshape(len(others), 3 * len(target))])
    rows = np.linalg.qr(rows.T)[0].T / (_GAUGE * board.sigma_m)
    return np.eye(3 * len(target)) / board.sigma_m**2 + rows.T @ rows
