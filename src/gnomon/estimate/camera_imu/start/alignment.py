"""Where one camera's clock and axes lie to the IMU's, from the rotation that both of them felt.

Between two frames the camera turns by a rotation vector that its poses tell; the gyroscope's integral over the same
time is that rotation seen from the IMU. The time shift is where the two streams agree best: as a score that neither an
unknown rotation between the axes nor a bias can change, the sum of the singular values of their cross-covariance is
taken, at every shift of the whole overlap.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....errors import InitialisationError
from ....frozen import value_class
from ....geometry.rotations import nearest_rotation, rotvec_from_rotation
from ....recording import Floats
from .board_poses import BoardPoses

_GRID_S = 0.01
_STEP_S = 0.1
_LONGEST_STEP_S = 0.35  # frames further apart tell no rate
_SHORTEST_OVERLAP_S = 3.0
_FINE_S = 0.02  # search about the coarse shift
_STEPS, _FINER = 8, 3
_ROBUST, _ROUNDS = 3.0, 3
_EXPLAINED, _PROPER, _PLAIN = 0.3, 0.9, 0.95
_SCALE = 0.5
_FILLED_S, _SPARSEST, _LONGEST_S = 1.0, 20.0, 600.0  # a longer step is a gap; times of what is filled, and beside it

_WINDOW_S, _MOST_WINDOWS, _WINDOW_FEWEST = 3.0, 40, 20  # windows aligned by themselves: their length, number, turns
_WINDOW_RAD_S, _TWO_AXES = 0.1, 0.2  # of the second axis, rms; and of the first one's rate
_SAME_AXES_RAD = 0.1
_LEAST_STEP_S, _STEP_TIMES = 0.02, 8.0  # a step, and times the usual change between windows
_WORSE, _SURE = 1.2, 30.0  # a single shift leaves so many times the variance in a part; its log-likelihood, at least
_FEWEST_WINDOWS, _LEAST_GROWTH_S, _BENT = 4, 0.1, 0.1  # of a drift: windows, growth, and off the line, of the growth


@value_class
class GyroscopeIntegral:
    """The integral of the gyroscope's readings over time, to be read at any instant.

    Attributes
    ----------
    t_s : (n,) [s]
    angle : (n, 3) [rad], the integral of the readings from t_s[0]
    """

    t_s: Floats
    angle: Floats

    def __call__(self, t_s: Floats) -> Floats:
        """Return the integral (..., 3) at instants (...) [s], held at the ends."""
        return np.stack([np.interp(t_s, self.t_s, self.angle[:, i]) for i in range(self.angle.shape[1])], axis=-1)


@value_class
class Alignment:
    """One camera's clock and axes relative to the IMU.

    Attributes
    ----------
    time_shift_s : t_imu = t_cam + time_shift_s
    R_cam_imu : (3, 3)
    gyroscope_bias : (3,) [rad/s]
    rate_scale : gyroscope's rate over the camera's; 1 for a gyroscope in rad/s
    score : 0 to 1, share of the camera's rotation that the gyroscope explains, up to its scale
    axes : (3,) rms angular rate of the camera along its principal axes, largest first [rad/s]
    directions : (3, 3) these axes as columns, in the camera's frame
    consistent : (n,) which frames of the poses agree with the gyroscope
    """

    time_shift_s: float
    R_cam_imu: Floats
    gyroscope_bias: Floats
    rate_scale: float
    score: float
    axes: Floats
    directions: Floats
    consistent: np.ndarray


@value_class
class _Turns:
    """Rotations of the camera from frame `first` to frame `second`: from `start_s` to `stop_s`, by `rotvec`."""

    start_s: Floats
    stop_s: Floats
    rotvec: Floats
    first: np.ndarray
    second: np.ndarray

    def where(self, kept: np.ndarray) -> "_Turns":
        return _Turns(
            start_s=self.start_s[kept],
            stop_s=self.stop_s[kept],
            rotvec=self.rotvec[kept],
            first=self.first[kept],
            second=self.second[kept],
        )


def gyroscope_integral(t_s: Floats, rate: Floats) -> GyroscopeIntegral:
    """Return the integral of angular rates (n, 3) [rad/s] by the trapezoidal rule."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)[:, None]
    return GyroscopeIntegral(t_s=t_s, angle=np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)]))


def align_camera(poses: BoardPoses, integral: GyroscopeIntegral, name: str) -> Alignment:
    """Find the time shift, the rotation between camera and IMU, and the gyroscope's bias.

    Parameters
    ----------
    poses : of the target in the camera's frame, at the camera's timestamps
    integral : of the gyroscope, at the IMU's timestamps
    name : of the camera, for messages

    Raises
    ------
    InitialisationError
        If the streams are too short, do not overlap at any shift, or nothing turned.
    """
    _refuse_jump(poses.t_s, name)
    _refuse_jump(integral.t_s, "the gyroscope")
    turns = _turns(poses)
    if len(turns.first) < 10:
        raise InitialisationError(
            f"{name}: the board was seen in {len(poses)} frames, and in fewer than ten pairs of frames less than "
            f"{_LONGEST_STEP_S:g} s apart. Keep the board in view while you move, and record at 4 Hz or more."
        )
    spread, _ = _principal_rates(turns, np.ones(len(turns.first), dtype=bool))
    if spread[0] < 0.02:
        raise InitialisationError(
            f"{name}: the camera turned by {np.degrees(spread[0]):.2g} deg/s (rms) only; without rotation neither the "
            "time shift nor the rotation between camera and IMU can be found. Turn it about all three axes, briskly."
        )
    found = _aligned(poses, turns, integral, name)
    if found.score < _PROPER and _is_mirrored(turns, integral, found.time_shift_s):
        return found  # with its low score: whoever looks at the axes says what is wrong with them
    fits_scale = 1 - _SCALE < found.rate_scale < 1 + _SCALE
    if found.score < (_EXPLAINED if fits_scale else _PROPER):
        raise InitialisationError(
            f"{name} and the gyroscope do not show the same rotation at any time shift: the best one, "
            f"{found.time_shift_s:.2f} s, explains {100 * max(found.score, 0):.0f} % of it (rms {name} "
            f"{np.degrees(np.linalg.norm(spread)):.3g}, gyroscope {np.degrees(_rate(integral)):.3g} deg/s). Either "
            "hardly anything turned, or the camera's poses are too uncertain (small board in the image, blurred), or "
            "the streams are not of one recording. Turn about all three axes, briskly, with a board large in view."
        )
    if not fits_scale:
        raise InitialisationError(
            f"the gyroscope reads {found.rate_scale:.3g} times the rotation that {name} sees, at the best time shift. "
            + _unit_hint(found.rate_scale)
        )
    return found


@value_class
class ClockStep:
    """A step of the time shift between a camera and the IMU.

    Attributes
    ----------
    at_s : timestamp of the camera's last frames before it [s]
    before_s, after_s : t_imu - t_cam before and after it [s]
    """

    at_s: float
    before_s: float
    after_s: float


@value_class
class ClockGrowth:
    """By how much the time shift t_imu - t_cam grows in a second, and the standard deviation of that."""

    drift: float
    sigma: float


def clock_changes(
    poses: BoardPoses, integral: GyroscopeIntegral, alignment: Alignment | None
) -> tuple[ClockStep, ...] | ClockGrowth:
    """Return where the time shift steps, or how it grows, by so much that a single one cannot explain the rotation.

    Each window of the recording is aligned by itself, at any time shift. Windows count where the gyroscope explains the
    camera's rotation about two axes at least, by the same rotation between their axes as in most of the others: a
    shift found by chance would need another one. Gaps by themselves change nothing.

    Parameters
    ----------
    poses, integral : as of `align_camera`
    alignment : of the whole recording, None where it failed; where it explains every window nothing is sought
    """
    if len(poses) < _WINDOW_FEWEST or _mostly_gaps(poses.t_s) or _mostly_gaps(integral.t_s):
        return ()
    turns = _turns(poses)
    if not _alike_in_size(turns, integral):  # another unit or another recording is what is to be said
        return ()
    kept = _aligned_windows(poses, turns, integral, alignment)
    if len(kept) < 2:
        return ()
    if (growth := _growth(kept)) is not None:
        return growth
    shifts = np.array([one.time_shift_s for _, one in kept])
    changes = np.diff(shifts)
    least = max(_LEAST_STEP_S, _STEP_TIMES * float(np.median(np.abs(changes)))) if len(changes) > 2 else _LEAST_STEP_S
    steps = np.flatnonzero(np.abs(changes) > least)
    # A step within a window gives that a shift between those of its neighbours, and then looks like two.
    spans = [(run[0], run[-1] + 1) for run in np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1) if len(run)]
    edges = [0, *(edge for span in spans for edge in (span[0] + 1, span[1])), len(kept)]
    segments = list(zip(edges[::2], edges[1::2], strict=True))
    levels = [float(np.median(shifts[a:b])) for a, b in segments]
    if alignment is not None and not any(_is_worse(kept[a:b], integral, alignment) for a, b in segments):
        return ()  # such as of a rolling shutter, or few frames: windows alone tell their shifts badly
    return tuple(
        _located(turns, integral, kept[first], kept[last], (levels[k], levels[k + 1]))
        for k, (first, last) in enumerate(spans)
    )


def _aligned_windows(
    poses: BoardPoses, turns: "_Turns", integral: GyroscopeIntegral, alignment: Alignment | None
) -> list[tuple["_Turns", Alignment]]:
    """Return the windows that count, each aligned by itself; none where one alignment explains them all."""
    windows = _windows(turns)
    if alignment is not None and all(_explains(poses, window, integral, alignment.time_shift_s) for window in windows):
        return []
    found = [(window, one) for window in windows if (one := _window_alignment(poses, window, integral)) is not None]
    if len(found) < 2:
        return []
    R = np.array([one.R_cam_imu for _, one in found])
    alike = np.trace(np.swapaxes(R, 1, 2)[:, None] @ R[None], axis1=2, axis2=3) > 1 + 2 * np.cos(_SAME_AXES_RAD)
    most = alike[int(alike.sum(axis=1).argmax())]
    return [one for one, same in zip(found, most.tolist(), strict=True) if same]


def _growth(windows: Sequence[tuple["_Turns", Alignment]]) -> ClockGrowth | None:
    """Return how the time shift grows from window to window, where that is a straight line and no small one."""
    if len(windows) < _FEWEST_WINDOWS:
        return None
    t = np.array([float((window.start_s + window.stop_s).mean()) / 2 for window, _ in windows])
    shift = np.array([one.time_shift_s for _, one in windows])
    drift = float(np.median(np.diff(shift) / np.diff(t)))  # a step changes one of them
    off, growth = shift - drift * t, abs(drift) * float(t[-1] - t[0])
    if growth < _LEAST_GROWTH_S or float(np.abs(off - np.median(off)).max()) > _BENT * growth:
        return None
    (drift, _), covariance = np.polyfit(t, shift, 1, cov=True)
    return ClockGrowth(drift=float(drift), sigma=float(np.sqrt(covariance[0, 0])))


def _alike_in_size(turns: "_Turns", integral: GyroscopeIntegral) -> bool:
    """Whether camera and gyroscope turned by about as much in all, whatever their clocks."""
    if not len(turns.first):
        return False
    seen = float(np.median(np.linalg.norm(turns.rotvec, axis=1) / (turns.stop_s - turns.start_s)))
    step = np.linalg.norm(np.diff(integral.angle, axis=0), axis=1) / np.maximum(np.diff(integral.t_s), 1e-9)
    return bool(0.4 * seen < float(np.median(step)) < 2.5 * seen)


def _windows(turns: "_Turns") -> list["_Turns"]:
    """Return the turns in windows of equal time, without those that are too few."""
    if not len(turns.first):
        return []
    filled = float(np.minimum(np.diff(turns.start_s), _FILLED_S).sum())
    number = ((turns.start_s - turns.start_s[0]) // max(_WINDOW_S, filled / _MOST_WINDOWS)).astype(np.int64)
    edges = np.flatnonzero(np.diff(number)) + 1
    parts = np.split(np.arange(len(number)), edges)
    return [turns.where(part) for part in parts if len(part) >= _WINDOW_FEWEST]


def _explains(poses: BoardPoses, window: "_Turns", integral: GyroscopeIntegral, shift: float) -> bool:
    """Tell whether a window's rotation is explained best about a shift, or is too slow to be asked."""
    spread, _ = _principal_rates(window, np.ones(len(window.first), dtype=bool))
    if spread[1] < _WINDOW_RAD_S:
        return True
    off = np.linspace(-_FINE_S, _FINE_S, 9)
    trials = _hand_eyes(window, integral, shift + off)
    best = int(np.argmin([trial.cost for trial in trials]))
    if trials[best].explained > _PLAIN and abs(off[best]) <= _LEAST_STEP_S / 4:  # finer steps would not lead away
        return True
    found = _refined(poses, window, integral, shift)
    return found is not None and found.score > _PROPER and abs(found.time_shift_s - shift) < _LEAST_STEP_S / 2


def _window_alignment(poses: BoardPoses, window: "_Turns", integral: GyroscopeIntegral) -> Alignment | None:
    """Return the alignment of a window by itself; None where nothing certain is found."""
    spread, _ = _principal_rates(window, np.ones(len(window.first), dtype=bool))
    if spread[1] < max(_WINDOW_RAD_S, _TWO_AXES * spread[0]):
        return None
    try:
        coarse = _coarse_shift(window, integral, "", limited=False)
    except InitialisationError:
        return None
    found = _refined(poses, window, integral, coarse)
    return found if found is not None and found.score > _PROPER else None


def _is_worse(windows: Sequence[tuple["_Turns", Alignment]], integral: GyroscopeIntegral, alignment: Alignment) -> bool:
    """Tell whether the alignment of a whole recording explains some windows surely worse than their own do."""
    logs = [
        float(np.log(np.mean(_errors(turns, integral, alignment) ** 2) / np.mean(_errors(turns, integral, own) ** 2)))
        for turns, own in windows
    ]
    gained = 1.5 * sum(log * len(turns.first) for log, (turns, _) in zip(logs, windows, strict=True))  # three axes
    return bool(np.mean(logs) > np.log(_WORSE) and gained > _SURE)


def _errors(turns: "_Turns", integral: GyroscopeIntegral, found: Alignment) -> Floats:
    """Return how far gyroscope and camera disagree in each turn, (n,) [rad/s]."""
    length_s = (turns.stop_s - turns.start_s)[:, None]
    read = (integral(turns.stop_s + found.time_shift_s) - integral(turns.start_s + found.time_shift_s)) / length_s
    return np.linalg.norm(read - found.gyroscope_bias - turns.rotvec / length_s @ found.R_cam_imu, axis=1)


def _located(
    turns: "_Turns",
    integral: GyroscopeIntegral,
    before: tuple["_Turns", Alignment],
    after: tuple["_Turns", Alignment],
    shifts: tuple[float, float],
) -> ClockStep:
    """Return the step between two windows, at the instant that explains the turns from one to the other best."""
    inside = (turns.start_s >= before[0].start_s[0]) & (turns.stop_s <= after[0].stop_s[-1])
    between = turns.where(np.flatnonzero(inside))
    errors = [
        _errors(between, integral, replace(found, time_shift_s=shift))
        for shift, (_, found) in zip(shifts, (before, after), strict=True)
    ]
    worse = np.concatenate([[0.0], np.cumsum(errors[0] - errors[1])])
    k = max(int(worse.argmin()), 1)
    return ClockStep(at_s=float(between.stop_s[k - 1]), before_s=shifts[0], after_s=shifts[1])


def _refuse_jump(t_s: Floats, name: str) -> None:
    """Refuse timestamps that are mostly gaps, as a clock that jumps leaves them: grids over them had no bound."""
    steps = np.diff(t_s)
    filled = float(np.minimum(steps, _FILLED_S).sum())
    if _mostly_gaps(t_s):
        at = int(np.argmax(steps))
        raise InitialisationError(
            f"{name}: for {steps[at]:.6g} s, from {t_s[at] - t_s[0]:.6g} s after its beginning on, nothing was "
            f"recorded, and all else lasts {filled:.6g} s. Its clock jumped, or recordings of different times are in "
            "one: cut it there."
        )


def _mostly_gaps(t_s: Floats) -> bool:
    filled = float(np.minimum(np.diff(t_s), _FILLED_S).sum())
    return len(t_s) > 1 and bool(t_s[-1] - t_s[0] > _LONGEST_S + _SPARSEST * filled)


def _aligned(poses: BoardPoses, turns: _Turns, integral: GyroscopeIntegral, name: str) -> Alignment:
    """Return the alignment at the time shift of best agreement.

    A few poses that are far off make a search by least squares fail; then long rotations are made short in another one.
    """
    tried: list[Alignment] = []
    for limited in (False, True):
        coarse = _coarse_shift(turns, integral, name, limited=limited)
        found = _refined(poses, turns, integral, coarse)
        tried += [] if found is None else [found]
        if found is not None and found.score >= _PROPER:
            break
    if not tried:
        raise InitialisationError(
            f"{name} and gyroscope overlap in fewer than ten pairs of frames at the best time shift. "
            "Record both together, in one go."
        )
    return max(tried, key=lambda one: one.score)


def _principal_rates(turns: _Turns, used: np.ndarray) -> tuple[Floats, Floats]:
    """Return the rms angular rate along the principal axes (3,) [rad/s], largest first, and these as columns (3, 3)."""
    rates = (turns.rotvec / (turns.stop_s - turns.start_s)[:, None])[used]
    variance, directions = np.linalg.eigh(np.cov(rates.T))
    return np.sqrt(np.maximum(variance, 0.0))[::-1], directions[:, ::-1]


def _rate(integral: GyroscopeIntegral) -> float:
    """Return the rms angular rate about the mean one [rad/s]."""
    rate = np.diff(integral.angle, axis=0) / np.maximum(np.diff(integral.t_s), 1e-9)[:, None]
    return float(np.sqrt(np.var(rate, axis=0).sum()))


def _is_mirrored(turns: _Turns, integral: GyroscopeIntegral, shift: float) -> bool:
    """Tell whether the gyroscope reads the mirror image of the camera's rotation, about all axes."""
    start, stop = turns.start_s + shift, turns.stop_s + shift
    inside = (start >= integral.t_s[0]) & (stop <= integral.t_s[-1])
    if inside.sum() < 10:
        return False
    step = (stop - start)[inside, None]
    read = (integral(stop) - integral(start))[inside] / step
    seen = np.column_stack([turns.rotvec[inside] / step, np.ones(int(inside.sum()))])
    matrix = np.asarray(np.linalg.lstsq(seen, read, rcond=None)[0], dtype=np.float64)
    left = float(((read - seen @ matrix) ** 2).sum()) / max(float(((read - read.mean(axis=0)) ** 2).sum()), 1e-12)
    singular = np.linalg.svd(matrix[:3], compute_uv=False)
    return bool(left < 1 - _PROPER and np.linalg.det(matrix[:3]) < 0 and singular[-1] > _SCALE * singular[0])


def _unit_hint(scale: float) -> str:
    if 40 < scale < 80:
        return "It is in deg/s, not in rad/s: state its unit (--units)."
    if 1 / 80 < scale < 1 / 40:
        return "It is in rad/s, not in deg/s: state its unit (--units)."
    return "Check the unit of the gyroscope, the target's size and the intrinsics."


def _turns(poses: BoardPoses) -> _Turns:
    """Return rotations over a tenth of a second where frames are nearer: the noise of poses counts less then."""
    steps = np.diff(poses.t_s)
    stride = max(1, round(_STEP_S / max(float(np.median(steps)), 1e-6))) if len(steps) else 1
    step = poses.t_s[stride:] - poses.t_s[:-stride]
    first = np.flatnonzero((step > 0) & (step < _LONGEST_STEP_S))
    second = first + stride
    # R_cam_target of the later frame times the transpose of the earlier one turns camera axes; in the camera's own
    # (body) frame the rotation from earlier to later is R_earlier R_later'.
    between = poses.R_cam_target[first] @ np.swapaxes(poses.R_cam_target[second], 1, 2)
    rotvec = rotvec_from_rotation(between)
    usable = np.linalg.norm(rotvec, axis=1) < 2.0
    first, second = first[usable], second[usable]
    return _Turns(start_s=poses.t_s[first], stop_s=poses.t_s[second], rotvec=rotvec[usable], first=first, second=second)


def _coarse_shift(turns: _Turns, integral: GyroscopeIntegral, name: str, *, limited: bool) -> float:
    """Return the shift of best agreement on a grid over the whole overlap, by fast Fourier transforms.

    Parameters
    ----------
    limited : take rates above the median one for as large as that
    """
    length = float(np.median(turns.stop_s - turns.start_s))
    step = turns.stop_s - turns.start_s
    camera_start = float(turns.start_s[0])
    camera_count = int(np.ceil((turns.stop_s[-1] - camera_start) / _GRID_S)) + 1
    centre = np.rint((0.5 * (turns.start_s + turns.stop_s) - camera_start) / _GRID_S).astype(np.int64)
    camera = np.zeros((3, camera_count))
    mask = np.zeros(camera_count)
    rate = turns.rotvec / step[:, None]
    rate -= np.median(rate, axis=0)
    if limited:
        size = np.linalg.norm(rate, axis=1)
        rate *= np.minimum(1.0, np.median(size) / np.maximum(size, 1e-12))[:, None]
    camera[:, centre], mask[centre] = rate.T, 1.0
    first, last = float(integral.t_s[0]), float(integral.t_s[-1])
    grid = np.arange(first, last, _GRID_S)
    gyroscope = ((integral(grid + length / 2) - integral(grid - length / 2)) / length).T
    gyroscope -= gyroscope.mean(axis=1, keepdims=True)
    size = 1 << int(np.ceil(np.log2(camera_count + len(grid))))
    F_camera, F_mask = np.conj(np.fft.rfft(camera, size)), np.conj(np.fft.rfft(mask, size))
    F_gyro, F_inside = np.fft.rfft(gyroscope, size), np.fft.rfft(np.ones(len(grid)), size)
    cross = np.fft.irfft(F_camera[:, None] * F_gyro[None, :], size)  # (3, 3, lag), gyroscope later by the lag
    samples = np.fft.irfft(F_mask * F_inside, size)
    sum_camera = np.fft.irfft(F_camera * F_inside, size)
    sum_gyro = np.fft.irfft(F_mask * F_gyro, size)
    square_gyro = np.fft.irfft(F_mask * np.fft.rfft((gyroscope**2).sum(axis=0), size), size)
    n = np.maximum(samples, 1.0)
    covariance = cross - sum_camera[:, None] * sum_gyro[None, :] / n
    gyro_energy = np.maximum(square_gyro - (sum_gyro**2).sum(axis=0) / n, 1e-12)
    lag = np.arange(size)
    lag = np.where(lag > len(grid), lag - size, lag)
    between = float(np.median(np.diff(turns.start_s)))
    enough = samples >= min(0.25 * len(step), _SHORTEST_OVERLAP_S / between)
    if not enough.any():
        raise InitialisationError(
            f"{name}: the streams of camera ({turns.stop_s[-1] - turns.start_s[0]:.1f} s) and IMU "
            f"({last - first:.1f} s) are too short to overlap by {_SHORTEST_OVERLAP_S:g} s. Record both for a minute."
        )
    # By the sum of the singular values, which is between the root of their squares' sum and root 3 times as much.
    least = np.sqrt((covariance**2).sum(axis=(0, 1)) / gyro_energy)
    likely = np.flatnonzero(enough & ~(np.sqrt(3.0) * least < least[enough].max()))
    nuclear = np.linalg.svd(np.moveaxis(covariance[:, :, likely], -1, 0), compute_uv=False).sum(axis=1)
    best = int(likely[np.argmax(nuclear / np.sqrt(gyro_energy[likely]))])
    return float(lag[best]) * _GRID_S + first - camera_start


def _refined(poses: BoardPoses, turns: _Turns, integral: GyroscopeIntegral, coarse: float) -> Alignment | None:
    """Return the alignment near a time shift; None where the streams hardly overlap."""
    shifts, best = coarse + np.linspace(-_FINE_S, _FINE_S, 17), coarse
    found: _HandEye | None = None
    finer = 0
    for _ in range(_STEPS):
        trials = _hand_eyes(turns, integral, shifts)
        place = int(np.argmin([trial.cost for trial in trials]))
        best, found = float(shifts[place]), trials[place]
        if finer or 0 < place < len(shifts) - 1:
            finer += 1
            shifts = best + np.linspace(-1, 1, 9) * (shifts[1] - shifts[0])
        else:  # the coarse shift is off by more: go on from here
            shifts = best + np.linspace(-_FINE_S, _FINE_S, 17)
        if finer == _FINER:
            break
    if found is None or found.cost == np.inf:
        return None
    consistent = np.ones(len(poses), dtype=bool)
    bad = found.good == 0
    # A frame is inconsistent where the rotations on both of its sides are.
    before, after = np.zeros(len(poses), dtype=bool), np.zeros(len(poses), dtype=bool)
    after[turns.first[bad]] = True
    before[turns.second[bad]] = True
    consistent[before & after] = False
    axes, directions = _principal_rates(turns, found.good > 0)
    return Alignment(
        time_shift_s=best,
        R_cam_imu=found.R.T,
        gyroscope_bias=found.bias,
        rate_scale=found.scale,
        score=found.explained,
        axes=axes,
        directions=directions,
        consistent=consistent,
    )


def _hand_eyes(turns: _Turns, integral: GyroscopeIntegral, shifts: Floats) -> list["_HandEye"]:
    """Return the best rotation and bias at each shift (k,), at infinite cost where the streams hardly overlap."""
    start, stop = turns.start_s + shifts[:, None], turns.stop_s + shifts[:, None]
    inside = (start >= integral.t_s[0]) & (stop <= integral.t_s[-1])
    overlap = inside.sum(axis=1) >= 10
    inside |= ~overlap[:, None]
    step = (stop - start)[..., None]
    gyro, camera = (integral(stop) - integral(start)) / step, turns.rotvec / step
    weight, limit = inside.astype(np.float64), np.empty((len(shifts), 1))
    for _ in range(_ROUNDS):
        fit = _kabsch(gyro, camera, weight)
        limit = _ROBUST * 1.4826 * _medians(fit.error, inside)[:, None] + 1e-6
        weight = (inside & (fit.error < limit)).astype(np.float64)
    fit = _kabsch(gyro, camera, weight)
    cost = (np.minimum(fit.error, limit) ** 2 * inside).sum(axis=1) / inside.sum(axis=1)
    turned = weight[..., None] * ((camera - _means(camera, weight)) @ np.swapaxes(fit.R, 1, 2))
    read = weight[..., None] * (gyro - _means(gyro, weight))
    energy, common = np.maximum((turned**2).sum(axis=(1, 2)), 1e-12), (turned * read).sum(axis=(1, 2))
    explained = np.maximum(common, 0.0) ** 2 / (energy * np.maximum((read**2).sum(axis=(1, 2)), 1e-12))
    good = np.where(inside & (fit.error > 2 * limit), 0.0, 1.0)
    return [
        _HandEye(
            cost=float(cost[k]) if overlap[k] else np.inf,
            R=fit.R[k],
            bias=fit.bias[k],
            good=good[k],
            scale=float(common[k] / energy[k]),
            explained=float(explained[k]),
        )
        for k in range(len(shifts))
    ]


@value_class
class _Fits:
    """Rotations R_imu_cam (k, 3, 3), gyroscope biases (k, 3) [rad/s], and the error of every turn (k, n) [rad/s]."""

    R: Floats
    bias: Floats
    error: Floats


@value_class
class _HandEye:
    """The best rotation and bias at a time shift.

    Attributes
    ----------
    cost : mean squared error, of bad turns the limit [rad^2/s^2]; infinite where the streams hardly overlap
    R, bias : rotation R_imu_cam (3, 3) and gyroscope bias (3,) [rad/s]
    good : (n,) 0 for turns that fit badly, else 1
    scale, explained : see Alignment
    """

    cost: float
    R: Floats
    bias: Floats
    good: Floats
    scale: float
    explained: float


def _kabsch(gyro: Floats, camera: Floats, weight: Floats) -> _Fits:
    """Return rotations and biases with gyro = R camera + bias, (k, n, 3) each, by least squares of weights (k, n)."""
    mean_gyro, mean_camera = _means(gyro, weight), _means(camera, weight)
    R = nearest_rotation(np.swapaxes(gyro - mean_gyro, 1, 2) @ (weight[..., None] * (camera - mean_camera)))
    turn = np.swapaxes(R, 1, 2)
    bias = mean_gyro - mean_camera @ turn
    left = gyro - camera @ turn - bias
    return _Fits(R=R, bias=bias[:, 0], error=np.sqrt(np.einsum("kni,kni->kn", left, left)))


def _means(values: Floats, weight: Floats) -> Floats:
    """Return weighted means (k, 1, 3) of values (k, n, 3)."""
    return (weight[:, None] @ values) / weight.sum(axis=1)[:, None, None]


def _medians(values: Floats, counts: np.ndarray) -> Floats:
    """Return the medians (k,) of those values (k, n) that count (k, n)."""
    ordered = np.sort(np.where(counts, values, np.inf), axis=1)
    number, row = counts.sum(axis=1), np.arange(len(values))
    return (ordered[row, (number - 1) // 2] + ordered[row, number // 2]) / 2
