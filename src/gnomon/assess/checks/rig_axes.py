"""Whether camera, gyroscope and accelerometer agree on their axes and clocks, before anything is estimated.

The camera's poses tell how it turned and how it was accelerated. Both are compared with what the IMU read by linear
least squares, with any 3 x 3 matrix in place of a rotation, so that a wrong sign, exchanged columns or a mirror show:

    gyroscope = A_g omega_cam + b_g,      accelerometer = A_a R_cam_target (D2 (p + R_target_cam x) - g) + b_a.

D2 is the second difference over about a tenth of a second, which is the acceleration averaged with a triangular
window; the accelerometer is averaged with the same one. The products of A_a with the IMU's place x and with gravity g
are unknowns of their own, so that all of it stays linear.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...estimate.camera_imu.start.alignment import GyroscopeIntegral, gyroscope_integral
from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...frozen import value_class
from ...geometry.rotations import rk4n_steps, rotation_from_quaternion, rotvec_from_rotation, running_products
from ...recording import Floats
from ...results.result import Booleans
from ...solve.factorisation import solve_banded
from .board_views import BoardTurns, board_turns

_STEP_S = 0.1
_TURN_S = 0.1
_FEWEST, _FEWEST_TURNS, _FEWEST_FORCES = 60, 25, 20
_ROUNDS, _ROBUST = 3, 3.5
_SEARCH_S, _TRIALS = 0.04, 17
_WHOLLY, _HELD, _MOSTLY, _FEWEST_SECONDS = 0.97, 0.2, 0.9, 3
_LEFT, _CLEARLY = 0.1, 3.0  # of the variance, that the right exchange of axes leaves; times as much leaves any other
_EXCHANGES = np.array(
    [np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]
)


@value_class
class AxesFit:
    """A sensor's readings as a linear map of what the camera saw.

    Attributes
    ----------
    matrix : (3, 3) from the camera's axes to the sensor's
    offset : (3,) what the sensor reads besides
    explained : share of the readings' variance that the map explains, those apart that it cannot explain at all
    used : share of the readings that it can
    delay_s : by which the sensor's readings come later than what the camera saw, at the time shift that was assumed
    delay_sigma_s : its standard deviation
    """

    matrix: Floats
    offset: Floats
    explained: float
    used: float
    delay_s: float
    delay_sigma_s: float

    @property
    def hand(self) -> float:
        """1 for a rotation, -1 for a mirror image, between them where it cannot be told."""
        singular = np.linalg.svd(self.matrix, compute_uv=False)
        size = float(np.prod(singular)) ** (1 / 3)
        return float(np.sign(np.linalg.det(self.matrix))) if singular[-1] > 0.3 * size > 0 else 0.0


class FrameTurns(NamedTuple):
    """Turns between frames: when [s] (n,), mean rates that the camera saw and the gyroscope read [rad/s] (n, 3)."""

    start_s: Floats
    stop_s: Floats
    seen: Floats
    read: Floats


def turns_between_frames(poses: BoardPoses, integral: GyroscopeIntegral, time_shift_s: float) -> FrameTurns:
    """Return the turns between frames about a tenth of a second apart."""
    first, second = _pairs(poses.t_s, _TURN_S)
    start, stop = poses.t_s[first] + time_shift_s, poses.t_s[second] + time_shift_s
    inside = (start >= integral.t_s[0]) & (stop <= integral.t_s[-1])
    first, second, start, stop = first[inside], second[inside], start[inside], stop[inside]
    length = (stop - start)[:, None]
    between = poses.R_cam_target[first] @ np.swapaxes(poses.R_cam_target[second], 1, 2)
    seen = rotvec_from_rotation(between) / length
    return FrameTurns(start_s=start, stop_s=stop, seen=seen, read=(integral(stop) - integral(start)) / length)


def rotation_break(turns: FrameTurns) -> float | None:
    """Return the instant [s] up to which, or from which on, the gyroscope reads what the camera saw, and else does not.

    The map from one to the other is that of the first or of the last third, where it explains that third nearly wholly.
    """
    third = len(turns.seen) // 3
    if third < _FEWEST_TURNS:
        return None
    design = np.column_stack([turns.seen, np.ones(len(turns.seen))])
    second = (turns.start_s - turns.start_s[0]).astype(np.int64)
    start = np.flatnonzero(np.diff(second, prepend=-1))
    power = np.add.reduceat((turns.read**2).sum(axis=1), start)
    for known in (slice(third), slice(-third, None)):
        fit = _robust(design[known], turns.read[known])
        if fit.explained < _WHOLLY:
            continue
        left = np.add.reduceat(((turns.read - design @ fit.solution) ** 2).sum(axis=1), start)
        ahead = slice(None, None, 1 if known.start is None else -1)
        held = (left < _HELD * power)[ahead]
        k = int(np.argmax(np.cumsum(held - 0.5))) + 1
        if held[:k].mean() > _MOSTLY and len(held) - k >= _FEWEST_SECONDS and held[k:].mean() < 1 - _MOSTLY / 2:
            return float(turns.start_s[start[ahead][k]])
    return None


def gyroscope_axes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> AxesFit | None:
    """Return how the gyroscope reads the camera's rotation; None where too little was seen."""
    start, stop, seen, read = turns_between_frames(poses, gyroscope_integral(stream.t_s, stream.rate), time_shift_s)
    if len(seen) < _FEWEST_TURNS:
        return None
    length = (stop - start)[:, None]
    design = np.column_stack([seen, np.ones(len(seen))])
    fit = _robust(design, read)
    change = (rate_at(stream, stop) - rate_at(stream, start)) / length
    delay = fit.shift(design, change)
    return AxesFit(
        matrix=fit.solution[:3].T,
        offset=fit.solution[3],
        explained=fit.explained,
        used=float(fit.weight.mean()),
        delay_s=delay,
        delay_sigma_s=fit.shift_sigma(design, change),
    )


def felt_force(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> tuple[Floats, Floats, Floats] | None:
    """Return instants [s] (n,), what the camera saw of the force there (n, 22), and what was read (n, 3); or None."""
    seen = _seen_force(poses, stream, time_shift_s)
    return None if seen is None else (seen[0], seen[1], averaged_force(stream, seen[2])(seen[0]))


def exchanged_axes(poses: BoardPoses, stream: ImuStream, time_shift_s: float, gyroscope: AxesFit) -> Floats | None:
    """Return the signed exchange that makes the accelerometer's axes the gyroscope's; None where it cannot be told.

    Of all 48 it is the one with which the camera's turns, as the gyroscope reads them, show what the accelerometer
    reads: only gravity, the IMU's place and a bias are free.
    """
    seen = force_by_gyroscope(poses, stream, time_shift_s, gyroscope)
    if seen is None:
        return None
    at, step_s, known, free = seen
    read = averaged_force(stream, step_s)(at)
    wanted = np.moveaxis(read @ np.swapaxes(_EXCHANGES, 1, 2) - known, 0, 2)
    used, left = np.ones(len(at), dtype=bool), np.zeros(len(_EXCHANGES))
    for _ in range(_ROUNDS):
        rows = free[used].reshape(-1, 9)
        solution = np.linalg.lstsq(rows, wanted[used].reshape(len(rows), -1), rcond=None)[0]
        square = ((wanted - free @ solution) ** 2).sum(axis=1)
        left = square[used].sum(axis=0) / ((read[used] - read[used].mean(axis=0)) ** 2).sum()
        error = np.sqrt(square[:, np.argmin(left)])
        used = error < _ROBUST * 1.4826 * float(np.median(error)) + 1e-9
    best, second = np.partition(left, 1)[:2]
    return _EXCHANGES[np.argmin(left)] if best < _LEFT and second > _CLEARLY * best else None


def force_by_gyroscope(
    poses: BoardPoses, stream: ImuStream, time_shift_s: float, gyroscope: AxesFit
) -> tuple[Floats, float, Floats, Floats] | None:
    """Return what the accelerometer feels if its axes are the gyroscope's; None of too few frames.

    Returns
    -------
    t_s : (n,) instants [s]
    step_s : over which time about them [s]
    known : (n, 3) by the camera's acceleration
    free : (n, 3, 9) by the IMU's place, gravity and a bias
    """
    seen = _seen_force(poses, stream, time_shift_s, _FEWEST_FORCES)
    if seen is None:
        return None
    at, design, step_s = seen
    axes = gyroscope.matrix / np.cbrt(abs(np.linalg.det(gyroscope.matrix)))
    felt, down = axes @ design[:, :12].reshape(-1, 3, 4), axes @ design[:, 12:21].reshape(-1, 3, 3)
    free = np.concatenate([felt[:, :, 1:], down, np.broadcast_to(np.eye(3), down.shape)], axis=2)
    return at, step_s, felt[:, :, 0], free


def _seen_force(
    poses: BoardPoses, stream: ImuStream, time_shift_s: float, fewest: int = _FEWEST
) -> tuple[Floats, Floats, float] | None:
    """Return instants [s] (n,), what the camera saw there (n, 22), and over which time [s]; None of too few frames."""
    t_s = poses.t_s + time_shift_s
    R = np.swapaxes(poses.R_cam_target, 1, 2)
    p = -np.einsum("nij,nj->ni", R, poses.p_cam_target)
    step_s = _step(t_s)
    centre, both = _second_differences(t_s, np.concatenate([p[:, :, None], R], axis=2), step_s)
    inside = (t_s[centre] > stream.t_s[0] + 0.2) & (t_s[centre] < stream.t_s[-1] - 0.2)
    centre, both = centre[inside], both[inside]
    if len(centre) < fewest:
        return None
    R_cam_target = poses.R_cam_target[centre]
    felt = np.einsum("nij,njk->nik", R_cam_target, both).reshape(len(centre), 12)
    design = np.column_stack([felt, R_cam_target.reshape(len(centre), 9), np.ones(len(centre))])
    # columns 0, 4, 8 hold the acceleration, 1-3, 5-7, 9-11 the arm's
    return t_s[centre], design, step_s


def accelerometer_axes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> AxesFit | None:
    """Return how the accelerometer reads gravity and the camera's acceleration; None where too little was seen."""
    seen = _seen_force(poses, stream, time_shift_s)
    if seen is None:
        return None
    at, design, step_s = seen
    force = averaged_force(stream, step_s)
    fit = _robust(design, force(at))
    slope = (force(at + 0.01) - force(at - 0.01)) / 0.02
    delays = np.linspace(-_SEARCH_S, _SEARCH_S, _TRIALS)
    costs = [_cost(design, force(at + delay), fit.weight) for delay in delays]
    best = int(np.argmin(costs))
    delay = float(delays[best])
    refined = _robust(design, force(at + delay))
    delay += refined.shift(design, slope)
    final = _robust(design, force(at + delay))
    return AxesFit(
        matrix=_accelerometer_matrix(final.solution),
        offset=final.solution[21],
        explained=final.explained,
        used=float(final.weight.mean()),
        delay_s=delay,
        delay_sigma_s=final.shift_sigma(design, slope),
    )


def _accelerometer_matrix(solution: Floats) -> Floats:
    """Return A_a from its product with gravity, of rank one; the acceleration's own block tells the sign."""
    product = -solution[12:21].reshape(3, 3, 3).transpose(2, 0, 1).reshape(9, 3)  # (axis, cam), gravity
    left, size, _ = np.linalg.svd(product)
    matrix = left[:, 0].reshape(3, 3) * size[0] / 9.81
    own = solution[[0, 4, 8]].T
    return matrix * (np.sign(float((matrix * own).sum())) or 1.0)


def averaged_force(stream: ImuStream, step_s: float) -> Callable[[Floats], Floats]:
    """Return what tells the specific force (n, 3) at instants (n,) [s], averaged with a triangular window."""
    t_s, force = stream.t_s, stream.force
    ends = np.clip(t_s - step_s / 2, t_s[0], t_s[-1]), np.clip(t_s + step_s / 2, t_s[0], t_s[-1])
    for _ in range(2):  # a window of one height, twice
        integral = gyroscope_integral(t_s, force)
        force = (integral(ends[1]) - integral(ends[0])) / (ends[1] - ends[0])[:, None]
    return lambda at_s: np.stack([np.interp(at_s, t_s, axis) for axis in force.T], axis=1)


def rate_at(stream: ImuStream, t_s: Floats) -> Floats:
    """Return the angular rate at instants, (n, 3) [rad/s]."""
    return np.stack([np.interp(t_s, stream.t_s, stream.rate[:, i]) for i in range(3)], axis=1)


def _pairs(t_s: Floats, length_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of frames about that far apart."""
    steps = np.diff(t_s)
    stride = max(1, round(length_s / max(float(np.median(steps)), 1e-6))) if len(steps) else 1
    first = np.arange(max(len(t_s) - stride, 0))
    near = (t_s[first + stride] - t_s[first]) < 3 * length_s
    return first[near], first[near] + stride


def _step(t_s: Floats) -> float:
    """Return the whole number of frames' periods that is nearest to a tenth of a second [s]."""
    period = float(np.median(np.diff(t_s))) if len(t_s) > 1 else _STEP_S
    return max(1, round(_STEP_S / max(period, 1e-6))) * period


def _second_differences(t_s: Floats, values: Floats, step_s: float) -> tuple[np.ndarray, Floats]:
    """Return frames (m,) with neighbours a step before and after, and the second derivatives (m, ...) there."""
    slack = 0.2 * step_s
    before = np.clip(np.searchsorted(t_s, t_s - step_s - slack), 0, len(t_s) - 1)
    after = np.clip(np.searchsorted(t_s, t_s + step_s - slack), 0, len(t_s) - 1)
    back, ahead = t_s - t_s[before], t_s[after] - t_s
    k = np.flatnonzero((np.abs(back - step_s) < slack) & (np.abs(ahead - step_s) < slack))
    back, ahead = (x[k].reshape(-1, *([1] * (values.ndim - 1))) for x in (back, ahead))
    rise = (values[after[k]] - values[k]) / ahead - (values[k] - values[before[k]]) / back
    return k, 2 * rise / (back + ahead)


@value_class
class _Linear:
    """A robust linear fit: solution (k, 3), weight (n,), residual (n, 3), explained share."""

    solution: Floats
    weight: Floats
    residual: Floats
    explained: float

    def shift(self, design: Floats, slope: Floats) -> float:
        """Return by how much later the readings should be taken, to first order."""
        rest, free = self._free(design, slope)
        return -float((rest * free).sum()) / max(float((free * free).sum()), 1e-30)

    def shift_sigma(self, design: Floats, slope: Floats) -> float:
        """Return the standard deviation of that; neighbouring differences share poses, hence the factor two."""
        rest, free = self._free(design, slope)
        energy = max(float((free * free).sum()), 1e-30)
        freedom = max(rest.size - 3 * design.shape[1] - 1, 1)
        return 2.0 * float(np.sqrt((rest * rest).sum() / freedom / energy))

    def _free(self, design: Floats, slope: Floats) -> tuple[Floats, Floats]:
        used = self.weight > 0
        own = slope[used] - design[used] @ np.linalg.lstsq(design[used], slope[used], rcond=None)[0]
        return self.residual[used], own


def _robust(design: Floats, read: Floats) -> _Linear:
    weight = np.ones(len(design))
    solution = np.zeros((design.shape[1], 3))
    rest = read
    for _ in range(_ROUNDS):
        used = weight > 0
        solution = np.asarray(np.linalg.lstsq(design[used], read[used], rcond=None)[0], dtype=np.float64)
        rest = read - design @ solution
        error = np.linalg.norm(rest, axis=1)
        weight = (error < _ROBUST * 1.4826 * float(np.median(error)) + 1e-9).astype(np.float64)
    used = weight > 0
    spread = read[used] - read[used].mean(axis=0)
    return _Linear(
        solution=solution,
        weight=weight,
        residual=rest,
        explained=1 - float((rest[used] ** 2).sum() / max((spread**2).sum(), 1e-30)),
    )


def _cost(design: Floats, read: Floats, weight: Floats) -> float:
    used = weight > 0
    rest = read[used] - design[used] @ np.linalg.lstsq(design[used], read[used], rcond=None)[0]
    return float((rest**2).sum())


_LONGEST_S = 0.2
_RIG_FRAMES_FEWEST = 60
_PRIOR_S = 0.03
_NEIGHBOURS, _NEAR = 11, 21  # frames of which some may be late, and steps of which most are not
_TURNING_RAD_S = 0.3
_ITERATIONS = 4
_GAP_PERIODS = 3.5


@value_class
class FrameTimes:
    """How late each frame is stamped, and where the board moved.

    Attributes
    ----------
    t_s : (n,) timestamps [s]
    late_s : (n,) by which each timestamp is late, less the median [s]
    alone_s : (n,) the same, less that of its neighbours [s]
    sigma_s : (n,) its standard deviation; large where the camera hardly turned [s]
    scatter : (n,) by how much more rotations near it scatter across their axis than most do, at least 1
    turns : of the board, about each frame
    differs_rad : (n - 1, 3) rotation between frames that the gyroscope read and the camera did not see
    change_rad_s : (n - 1, 3) by which the rate changed meanwhile; zero where the frames are not compared
    """

    t_s: Floats
    late_s: Floats
    alone_s: Floats
    sigma_s: Floats
    scatter: Floats
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
    """Return what the gyroscope says of the frames' timestamps; None where too few follow each other closely.

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
    if close.sum() < _RIG_FRAMES_FEWEST:
        return None
    stream = replace(stream, rate=(stream.rate - axes.offset) @ np.linalg.inv(axes.matrix).T)  # in the camera's axes
    rate, read = _turned(stream.t_s, stream.rate, t_s)
    turned_back = R[1:] @ np.swapaxes(R[:-1], 1, 2)
    differs = np.where(close[:, None], rotvec_from_rotation(turned_back @ read), 0.0)
    errors, by_change = _errors_of_rate(stream, t_s, rate, differs, close)
    corrected = rotvec_from_rotation(turned_back @ _turned(stream.t_s, stream.rate - errors, t_s)[1])
    sigma = _noise(differs[close], 0.5 * (rate[1:] + rate[:-1])[close])
    late, sigma_s, rest = _lateness(differs, rate, close, sigma)
    local = _running_median(rest[close], _NEAR) / np.sqrt(2 * np.log(2))  # of the two axes across
    return FrameTimes(
        t_s=t_s - t_s[0],
        late_s=late - np.median(late),
        alone_s=late - _running_median(late, _NEIGHBOURS),
        sigma_s=sigma_s,
        scatter=np.interp(np.arange(len(t_s)), np.flatnonzero(close) + 0.5, np.maximum(local, 1.0)),
        turns=board_turns(t_s - axes.delay_s, poses, corrected - np.diff(rate, axis=0) @ by_change, compared),
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
    """Return the standard deviation per axis across the axis of rotation, where timestamps do nothing."""
    speed = np.linalg.norm(rate, axis=1)
    turning = speed > _TURNING_RAD_S
    chosen, along = (differs[turning], rate[turning]) if turning.sum() > _RIG_FRAMES_FEWEST else (differs, rate)
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    across = chosen - (chosen * unit).sum(axis=1, keepdims=True) * unit
    return max(float(np.median(np.linalg.norm(across, axis=1))) / np.sqrt(2 * np.log(2)), 1e-6)


def _running_median(values: Floats, count: int) -> Floats:
    """Return the medians of as many values about each; the ends go on as they are."""
    return np.median(sliding_window_view(np.pad(values, count // 2, mode="edge"), count), axis=1)


def _lateness(differs: Floats, rate: Floats, close: np.ndarray, sigma: float) -> tuple[Floats, Floats, Floats]:
    """Return by how much each frame is late, with its sigma, and what is left, by a robust banded least squares."""
    weight, rest = close / sigma**2, np.zeros(len(differs))
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
        banded[0], banded[1, :-1] = diagonal, -weight * cross
        late = solve_banded(banded, right)
        rest = np.linalg.norm(differs - rate[1:] * late[1:, None] + rate[:-1] * late[:-1, None], axis=1) / sigma
        weight = close / sigma**2 * np.minimum(1.0, 4.0 / np.maximum(rest, 1e-9)) ** 2
    return late, 1 / np.sqrt(diagonal), rest


def _errors_of_rate(
    stream: ImuStream, t_s: Floats, rate: Floats, differs: Floats, close: Booleans
) -> tuple[Floats, Floats]:
    """Return errors (k, 3) of the gyroscope's readings, and of rotations by the change (3, 3) of the rate meanwhile.

    What differs between frames that are close tells them, linear in the specific force, the rate and the time.
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
    steady = np.column_stack([stream.force, stream.rate, np.ones(len(stream.rate))])
    return steady @ solution[: steady.shape[1]], np.asarray(solution[steady.shape[1] :], dtype=np.float64)
