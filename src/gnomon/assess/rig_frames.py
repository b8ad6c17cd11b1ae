"""Frame by frame against the gyroscope: stamps that are late, a clock that jumped, a board that was turned.

From one frame to the next the camera turned by what its poses say, and the gyroscope by what it read. A frame that was
stamped late by tau differs by omega tau on one side of it and by minus that on the other; a board that was moved
differs once, and for good.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solveh_banded

from ..estimate.camera_imu.board_poses import BoardPoses
from ..estimate.camera_imu.first_guess import ImuStream
from ..geometry.quaternion import rk4n_steps, rotation_from_quaternion, running_products
from ..geometry.rotation_vector import rotvec_from_rotation
from ..intervals import Booleans
from ..recording import Floats
from .board_turn import BoardTurns, board_turns
from .rig_axes import AxesFit

_LONGEST_S = 0.2
_FEWEST = 60
_PRIOR_S = 0.03
_NEIGHBOURS = 11
_TURNING_RAD_S = 0.3
_ITERATIONS = 4
_GAP_PERIODS = 3.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameTimes:
    """How late each frame is stamped, and where the board moved.

    Attributes
    ----------
    t_s : (n,) stamps [s]
    late_s : (n,) by which each stamp is late, less the median [s]
    alone_s : (n,) the same, less that of its neighbours [s]
    sigma_s : (n,) its standard deviation; large where the camera hardly turned [s]
    turns : of the board, about each frame
    differs_rad : (n - 1, 3) rotation between frames that the gyroscope read and the camera did not see
    change_rad_s : (n - 1, 3) by which the rate changed meanwhile; zero where the frames are not compared
    """

    t_s: Floats
    late_s: Floats
    alone_s: Floats
    sigma_s: Floats
    turns: BoardTurns
    differs_rad: Floats
    change_rad_s: Floats

    def level(self, from_s: float, to_s: float) -> float:
        """Return the mean lateness of the frames in a part of the recording [s], by one least squares over it."""
        part = (self.t_s[:-1] >= from_s) & (self.t_s[1:] < to_s) & (self.change_rad_s != 0).any(axis=1)
        differs, change = self.differs_rad[part], self.change_rad_s[part]
        level = 0.0
        for _ in range(_ITERATIONS):
            rest = np.linalg.norm(differs - level * change, axis=1)
            weight = rest < 4 * float(np.median(rest)) + 1e-12
            energy = float((change[weight] ** 2).sum())
            level = float((change[weight] * differs[weight]).sum()) / max(energy, 1e-30)
        return level


def frame_times(
    poses: BoardPoses, stream: ImuStream, time_shift_s: float, axes: AxesFit, unusable: Booleans | None = None
) -> FrameTimes | None:
    """Return what the gyroscope says of the frames' stamps; None where too few follow each other closely.

    Parameters
    ----------
    poses, stream : of the board, of the IMU
    time_shift_s : t_imu - t_cam, about
    axes : how the gyroscope reads the camera's rotation
    unusable : (n,) readings of the gyroscope that are clipped
    """
    t_s = poses.t_s + time_shift_s + axes.delay_s
    inside = (t_s > stream.t_s[0]) & (t_s < stream.t_s[-1])
    t_s, poses = t_s[inside], poses.where(inside)
    R, compared = poses.R_cam_target, ~_broken(stream, unusable, t_s)
    close = (np.diff(t_s) < _LONGEST_S) & compared
    if close.sum() < _FEWEST:
        return None
    in_camera = (stream.rate - axes.offset) @ np.linalg.inv(axes.matrix).T
    rate, read = _turned(stream.t_s, in_camera, t_s)
    seen = R[:-1] @ np.swapaxes(R[1:], 1, 2)
    apart = rotvec_from_rotation(np.swapaxes(seen, 1, 2) @ read)
    differs = np.where(close[:, None], apart, 0.0)
    sigma = _noise(differs[close], 0.5 * (rate[1:] + rate[:-1])[close])
    late, sigma_s = _lateness(differs, rate, close, sigma)
    ends = np.pad(late, _NEIGHBOURS // 2, mode="edge")
    return FrameTimes(
        t_s=t_s - t_s[0],
        late_s=late - np.median(late),
        alone_s=late - np.median(sliding_window_view(ends, _NEIGHBOURS), axis=1),
        sigma_s=sigma_s,
        turns=board_turns(t_s - axes.delay_s, poses, apart - _felt(stream, t_s, rate, apart, close), compared),
        differs_rad=differs,
        change_rad_s=np.diff(rate, axis=0) * close[:, None],
    )


def _turned(t_s: Floats, rate: Floats, at_s: Floats) -> tuple[Floats, Floats]:
    """Return the rates (m, 3) at instants, and the rotations (m - 1, 3, 3) from each to the next."""
    every = np.union1d(t_s, at_s)
    rates = np.stack([np.interp(every, t_s, rate[:, i]) for i in range(3)], axis=1)
    steps = rk4n_steps(rates[:-1], rates[1:], np.diff(every))
    total = running_products(steps, np.array([len(steps)]))
    place = np.searchsorted(every, at_s)
    first = np.array([1.0, 0.0, 0.0, 0.0])
    attitude = rotation_from_quaternion(np.concatenate([first[None], total])[place])
    return rates[place], np.swapaxes(attitude[:-1], 1, 2) @ attitude[1:]


def _broken(stream: ImuStream, unusable: Booleans | None, t_s: Floats) -> Booleans:
    """Return between which frames, (n - 1,), samples of the gyroscope are missing or clipped."""
    steps = np.diff(stream.t_s)
    bad = np.concatenate([steps > _GAP_PERIODS * float(np.median(steps)), [False]])
    if unusable is not None:
        bad |= unusable
    counted = np.concatenate([[0], np.cumsum(bad)])
    first = np.maximum(np.searchsorted(stream.t_s, t_s[:-1]) - 1, 0)
    last = np.minimum(np.searchsorted(stream.t_s, t_s[1:]) + 1, len(stream.t_s))
    return counted[last] > counted[first]


def _noise(differs: Floats, rate: Floats) -> float:
    """Return the standard deviation per axis of what differs across the axis of rotation, where stamps do nothing."""
    speed = np.linalg.norm(rate, axis=1)
    turning = speed > _TURNING_RAD_S
    chosen, along = (differs[turning], rate[turning]) if turning.sum() > _FEWEST else (differs, rate)
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    across = chosen - (chosen * unit).sum(axis=1, keepdims=True) * unit
    return max(float(np.median(np.linalg.norm(across, axis=1))) / np.sqrt(2 * np.log(2)), 1e-6)


def _lateness(differs: Floats, rate: Floats, close: np.ndarray, sigma: float) -> tuple[Floats, Floats]:
    """Return by how much each frame is late, with its sigma, by a robust banded least squares."""
    weight = close / sigma**2
    late, diagonal = np.zeros(len(rate)), np.ones(len(rate))
    square = (rate * rate).sum(axis=1)
    cross = (rate[1:] * rate[:-1]).sum(axis=1)
    for _ in range(_ITERATIONS):
        diagonal = np.full(len(rate), 1 / _PRIOR_S**2)
        diagonal[1:] += weight * square[1:]
        diagonal[:-1] += weight * square[:-1]
        right = np.zeros(len(rate))
        right[1:] += weight * (rate[1:] * differs).sum(axis=1)
        right[:-1] -= weight * (rate[:-1] * differs).sum(axis=1)
        banded = np.zeros((2, len(rate)))
        banded[0, 1:], banded[1] = -weight * cross, diagonal
        late = np.asarray(solveh_banded(banded, right), dtype=np.float64)
        rest = np.linalg.norm(differs - rate[1:] * late[1:, None] + rate[:-1] * late[:-1, None], axis=1) / sigma
        weight = close / sigma**2 * np.minimum(1.0, 4.0 / np.maximum(rest, 1e-9)) ** 2
    return late, 1 / np.sqrt(diagonal)


def _felt(stream: ImuStream, t_s: Floats, rate: Floats, differs: Floats, close: Booleans) -> Floats:
    """Return the part of what differs (n - 1, 3) that errors of the gyroscope and of the clock explain.

    They are linear in the specific force, the rate, the time and the change of the rate.
    """
    middle, length = 0.5 * (t_s[1:] + t_s[:-1]), np.diff(t_s)
    force = np.stack([np.interp(middle, stream.t_s, stream.force[:, i]) for i in range(3)], axis=1)
    turned = 0.5 * (rate[1:] + rate[:-1])
    steady = np.column_stack([force, turned, np.ones(len(force))]) * length[:, None]
    design = np.column_stack([steady, np.diff(rate, axis=0)])
    weight, solution = close.copy(), np.zeros((design.shape[1], 3))
    for _ in range(_ITERATIONS):
        solution = np.linalg.lstsq(design[weight], differs[weight], rcond=None)[0]
        rest = np.linalg.norm(differs - design @ solution, axis=1)
        weight = close & (rest <= 4 * float(np.median(rest[close])))
    return design @ solution
