"""Whether the board was moved: a turn that the cameras saw, the gyroscope did not feel, and that lasts.

From frame to frame the gyroscope tells how the camera turned, its poses how it turned to the board. What differs, added
up in the board's axes, is the error of the poses, and from a moved board on its turn. The mean over a second after an
instant is compared with that over a second before, poses weighed by their covariance: of a few corners at the border of
an image they may be off by degrees. A turn of the board lasts, and every camera that sees the board sees it.
"""

from collections.abc import Mapping

import numpy as np

from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans

_NEAR_S, _FAR_S = 1.0, 3.0
"""Frames up to the first are compared; those from the first to the second tell whether it lasts."""

_LONGEST_GAP_S = 3.0
"""Between frames, over which the gyroscope alone is trusted."""

_INDEPENDENT = 3.0
"""Poses of a second that err independently: lens, board and view err alike in frames that follow each other."""

_FEWEST = 4  # frames on each side
_FLOOR_RAD = 2e-3  # of a pose, however many corners it has
_DRIFT_RAD_S = 1e-3
_NEIGHBOURS, _ROBUST = 11, 4.0
_MOVED_RAD, _MOVED_SIGMAS, _MOVED_TIMES = 0.015, 6.0, 6.0
_LASTS = 0.5  # of the turn, by which it may be another one later, or by another camera
_TELLS = 0.25  # of the turn, below which its sigma must be where a camera is asked


@value_class
class BoardTurns:
    """By how much a camera saw the board turn about each frame.

    Attributes
    ----------
    t_s : (n,) of the frames, on the IMU's clock [s]
    turn_rad : (n, 3) from the second before to the second after, in the board's axes; nan where too little was seen
    sigma_rad : (n,) its standard deviation, of the worst axis
    lasting_rad : (n, 3) the same from some seconds before to some seconds after
    """

    t_s: Floats
    turn_rad: Floats
    sigma_rad: Floats
    lasting_rad: Floats

    @property
    def usual_rad(self) -> float:
        """How large these turns usually are [rad]."""
        size = np.linalg.norm(self.turn_rad, axis=1)
        return float(np.median(size[np.isfinite(size)])) if np.isfinite(size).any() else 0.0


@value_class
class BoardMove:
    """A board that was moved.

    Attributes
    ----------
    t_s : when, on the IMU's clock [s]
    turn_rad : by how much it turned [rad]; zero where it only shifted
    cameras : that saw it
    after_s : when, since the first of them saw the board [s]
    shift_m : by how much it shifted at least, where it only shifted [m]
    """

    t_s: float
    turn_rad: float
    cameras: tuple[str, ...]
    after_s: float
    shift_m: float = 0.0


def board_turns(t_s: Floats, poses: BoardPoses, differs: Floats, compared: Booleans) -> BoardTurns:
    """Return by how much a camera saw the board turn, beside what the gyroscope felt.

    Parameters
    ----------
    t_s : (n,) of the frames on the IMU's clock [s]
    poses : of these frames
    differs : (n - 1, 3) rotation between frames that the gyroscope read and the camera did not see, axes of the camera
        at the later one [rad]
    compared : (n - 1,) whether the gyroscope tells it
    """
    R = np.swapaxes(poses.R_cam_target, 1, 2)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(np.einsum("nij,nj->ni", R[1:], differs), axis=0)])
    covariance = R @ poses.rotation_covariance @ poses.R_cam_target
    excess = np.maximum(poses.scatter_px / max(float(np.median(poses.scatter_px)), 1e-9), 1.0)
    covariance = covariance * np.square(excess)[:, None, None] + _FLOOR_RAD**2 * np.eye(3)
    weight = np.linalg.inv(covariance) * _agreeing(total, covariance)[:, None, None]
    cut = ~compared | (np.diff(t_s) > _LONGEST_GAP_S)
    piece = np.concatenate([[0], np.cumsum(cut)])
    sums = _Sums.of(t_s, piece, total, weight)
    before, after = sums.mean(-_NEAR_S, 0.0), sums.mean(0.0, _NEAR_S)
    sooner, later = sums.mean(-_FAR_S, -_NEAR_S), sums.mean(_NEAR_S, _FAR_S)
    largest = np.sqrt(np.linalg.eigvalsh(before[1] + after[1])[:, -1])
    return BoardTurns(t_s=t_s, turn_rad=after[0] - before[0], sigma_rad=largest, lasting_rad=later[0] - sooner[0])


def board_move(cameras: Mapping[str, BoardTurns]) -> BoardMove | None:
    """Return where the board was moved, if one camera saw it that none contradicts."""
    found: list[tuple[float, str, int]] = []
    for name, turns in cameras.items():
        size = np.linalg.norm(turns.turn_rad, axis=1)
        least = max(_MOVED_RAD, _MOVED_TIMES * turns.usual_rad)
        told = (size > least) & (size > _MOVED_SIGMAS * turns.sigma_rad)
        told &= np.linalg.norm(turns.lasting_rad - turns.turn_rad, axis=1) < _LASTS * size
        found += [(float(size[k]), name, int(k)) for k in np.flatnonzero(told)]
    for size, name, k in sorted(found, reverse=True):
        turns = cameras[name]
        near = np.linalg.norm(turns.turn_rad - turns.turn_rad[k], axis=1) < 0.2 * size
        near &= np.abs(turns.t_s - turns.t_s[k]) < _NEAR_S
        t_s, turn = float(turns.t_s[near].mean()), turns.turn_rad[k]
        others = {other: _seen(one, t_s, turn) for other, one in cameras.items() if other != name}
        if False in others.values():
            continue
        agree = (name, *(other for other, seen in others.items() if seen))
        seen = tuple(camera for camera in cameras if camera in agree)
        return BoardMove(t_s=t_s, turn_rad=size, cameras=seen, after_s=t_s - float(cameras[seen[0]].t_s[0]))
    return None


def _seen(turns: BoardTurns, t_s: float, turn: Floats) -> bool | None:
    """Return whether a camera saw a turn at an instant; None where it cannot tell."""
    size = float(np.linalg.norm(turn))
    near = (np.abs(turns.t_s - t_s) < 0.5 * _NEAR_S) & (turns.sigma_rad < _TELLS * size)
    if not near.any():
        return None
    return bool((np.linalg.norm(turns.turn_rad[near] - turn, axis=1) < _LASTS * size).any())


def moved_finding(move: BoardMove) -> Finding:
    """Return what to say of a board that was moved."""
    when = f"{move.after_s:.0f} s after {move.cameras[0]} first saw it: {' and '.join(move.cameras)} saw"
    if move.shift_m > 0:
        return make_finding("board-moved/shifted", shift_m=move.shift_m, when=when)
    return make_finding("board-moved/turned", turn_rad=move.turn_rad, when=when)


def _agreeing(total: Floats, covariance: Floats) -> Floats:
    """Return weights (n,) that let single wrong poses count less: those far from their neighbours' median."""
    half = _NEIGHBOURS // 2
    padded = np.pad(total, ((half, half), (0, 0)), mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS, axis=0), axis=2)
    sigma = np.sqrt(np.einsum("nii->n", covariance))
    apart = np.linalg.norm(total - middle, axis=1) / (_ROBUST * sigma)
    return 1 / np.square(np.maximum(apart, 1.0))


@value_class
class _Sums:
    """Sums over frames, from which weighted means over stretches of time follow.

    Attributes
    ----------
    t_s : (n,) instants [s]
    first, last : (n,) first frame, and the one after the last, of the piece that the gyroscope holds together
    weight : (n + 1, 3, 3) sums of the weights up to each frame
    product : (n + 1, 3) of their products with the rotations
    """

    t_s: Floats
    first: np.ndarray
    last: np.ndarray
    weight: Floats
    product: Floats

    @classmethod
    def of(cls, t_s: Floats, piece: np.ndarray, total: Floats, weight: Floats) -> "_Sums":
        return cls(
            t_s=t_s,
            first=np.searchsorted(piece, piece, side="left"),
            last=np.searchsorted(piece, piece, side="right"),
            weight=np.concatenate([np.zeros((1, 3, 3)), np.cumsum(weight, axis=0)]),
            product=np.concatenate([np.zeros((1, 3)), np.cumsum(np.einsum("nij,nj->ni", weight, total), axis=0)]),
        )

    def mean(self, from_s: float, to_s: float) -> tuple[Floats, Floats]:
        """Return means (n, 3) over stretches beside each frame, and their covariances; nan, where frames are few."""
        begin = np.maximum(np.searchsorted(self.t_s, self.t_s + from_s, side="left"), self.first)
        end = np.minimum(np.searchsorted(self.t_s, self.t_s + to_s, side="right"), self.last)
        begin, end = (begin, np.minimum(end, np.arange(len(self.t_s)))) if to_s == 0 else (begin, end)
        count = end - begin
        enough = count >= _FEWEST
        begin, end = np.where(enough, begin, 0), np.where(enough, end, 1)
        inverse = np.linalg.inv(self.weight[end] - self.weight[begin])
        mean = np.einsum("nij,nj->ni", inverse, self.product[end] - self.product[begin])
        drift = (_DRIFT_RAD_S * max(abs(from_s), abs(to_s))) ** 2 * np.eye(3)
        wider = inverse * (np.maximum(count, 1) / _INDEPENDENT)[:, None, None] + drift
        return np.where(enough[:, None], mean, np.nan), np.where(enough[:, None, None], wider, 1e6 * np.eye(3))
