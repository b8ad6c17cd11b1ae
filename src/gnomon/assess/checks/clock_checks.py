"""The clocks of cameras and IMUs: one unit, one epoch, and no drift between them by the rotation that both felt.

For the drift the recording is cut into stretches. In each the time shift is corrected so that the gyroscope explains
the camera's rotation best, with a bias of its own; a line through these shifts is the drift, and their scatter about it
tells how certain it is, whatever makes them scatter.

A few seconds tell before there are enough stretches: the attitude that a camera saw in each frame is held against the
one that the gyroscope leads to from the first. Those have errors of their own, while differences of neighbouring frames
share them, and tell a drift several times worse. What the gyroscope's scales, axes and bias, the first frame and the
time shift do is estimated beside the drift.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...estimate.camera_imu.start.alignment import GyroscopeIntegral, gyroscope_integral
from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...geometry.rotations import nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from ...recording import Floats, Integers
from .rig_axes import rate_at

DRIFT_PPM, SIGMAS = 20.0, 3.0
"""Drift from which on it is told: 20 ppm are 1.2 ms a minute, a hundred times the uncertainty of a time shift."""

_UNIX_S = (1e9, 4e9)  # 2001 to 2096
_FACTORS = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)
_NEAR_FACTOR = 0.2


def zero_stamps(name: str, t_ns: Integers) -> Finding | None:
    """Return a problem where timestamps are zero: a driver left them out."""
    zero = int(np.count_nonzero(t_ns == 0))
    if zero < 2:  # time may start at zero
        return None
    return make_finding("stamps-zero", name=name, zero=zero, messages=len(t_ns))


def unit_factor(ratio: float) -> float | None:
    """Return by which unit timestamps are off, 1e3 where microseconds were taken for nanoseconds; None where fine."""
    near = [f for f in _FACTORS if abs(ratio * f - 1) < _NEAR_FACTOR]
    return near[0] if near else None


def drift_finding(camera: str, imu: str, *, drift: float, sigma: float, length_s: float, how: str) -> Finding | None:
    """Return a warning where two clocks drift apart by more than is borne, and that is certain.

    Parameters
    ----------
    drift : growth of the time shift t_imu - t_cam in a second
    sigma : its standard deviation
    length_s : of the recording
    how : it was found
    """
    if abs(drift) * 1e6 <= DRIFT_PPM or abs(drift) <= SIGMAS * sigma:
        return None
    return make_finding(
        "clock-drift",
        camera=camera,
        imu=imu,
        drift=drift,
        sigma=sigma,
        how=how,
        growth_ms=1e3 * drift * length_s,
        length_s=length_s,
    )


def check_epochs(stamps: Mapping[str, Integers]) -> tuple[Finding, ...]:
    """Look at the timestamps of all streams together: one unit, one epoch.

    Codes: stamps-zero, stamps-unit, stamps-epoch.

    Parameters
    ----------
    stamps : "cam0", "imu0", ... -> (n,) [ns]
    """
    zero = {name: finding for name, t in stamps.items() if (finding := zero_stamps(name, t)) is not None}
    known = {name: t for name, t in stamps.items() if len(t) > 1 and name not in zero and np.ptp(t) > 0}
    return (*zero.values(), *_units_apart(known), *_epochs_apart(known))


def _units_apart(stamps: Mapping[str, Integers]) -> list[Finding]:
    """Say where one stream lasts a thousand times, or a million times, as long as the IMU."""
    reference = next((name for name in stamps if name.startswith("imu")), None)
    if reference is None:
        return []
    length = float(np.ptp(stamps[reference])) * 1e-9
    findings: list[Finding] = []
    for name, t in stamps.items():
        own = float(np.ptp(t)) * 1e-9
        factor = unit_factor(own / length) if name != reference else None
        if factor is not None:
            findings.append(
                make_finding(
                    "stamps-unit/streams",
                    name=name,
                    own=own,
                    reference=reference,
                    length=length,
                    factor=max(factor, 1 / factor),
                )
            )
    return findings


def _epochs_apart(stamps: Mapping[str, Integers]) -> list[Finding]:
    """Say where some streams count from 1970 and others from when a device was switched on."""
    unix = {name: bool(_UNIX_S[0] < float(np.median(t)) * 1e-9 < _UNIX_S[1]) for name, t in stamps.items()}
    if len(set(unix.values())) < 2:
        return []
    since_1970 = ", ".join(name for name, yes in unix.items() if yes)
    since_start = ", ".join(name for name, yes in unix.items() if not yes)
    return [make_finding("stamps-epoch", since_1970=since_1970, since_start=since_start)]


_STEP_S, _LONGEST_STEP_S = 0.1, 0.35
_STRETCHES = 20
_FEWEST_TURNS, _FEWEST_STRETCHES = 25, 10
_ROUNDS, _PASSES = 3, 2
_ROBUST = 3.0
_LARGEST_S = 0.05  # a correction beyond this is no small one


@value_class
class ClockDrift:
    """How the time shift of one camera changes.

    Attributes
    ----------
    t_s : (k,) middle of the stretches [s]
    shift_s : (k,) correction of the time shift there
    sigma_s : (k,) its standard deviation, by the rotations of the stretch
    drift : growth of the time shift t_imu - t_cam in a second
    sigma : its standard deviation, by the scatter of the stretches
    """

    t_s: Floats
    shift_s: Floats
    sigma_s: Floats
    drift: float
    sigma: float


def look_at_drift(name: str, poses: BoardPoses, stream: ImuStream, time_shift_s: float, imu: str) -> list[Finding]:
    """Say whether a camera's clock drifts against that of the IMU (codes clock, clock-drift); as `check_drift`."""
    drift = clock_drift(poses, stream, time_shift_s)
    if drift is None:
        return early_drift(name, poses, stream, time_shift_s, imu)
    return [
        _warning(name, imu, poses, drift)
        or make_finding("clock/together", name=name, imu=imu, drift=drift.drift, sigma=drift.sigma)
    ]


def check_drift(name: str, poses: BoardPoses, stream: ImuStream, time_shift_s: float, imu: str) -> list[Finding]:
    """Return a warning where a camera's clock drifts against the IMU's (code clock-drift).

    Parameters
    ----------
    name : of the camera
    poses, stream, time_shift_s : see `clock_drift`
    imu : name of the IMU
    """
    drift = clock_drift(poses, stream, time_shift_s)
    found = None if drift is None else _warning(name, imu, poses, drift)
    return [] if found is None else [found]


def _warning(name: str, imu: str, poses: BoardPoses, drift: ClockDrift) -> Finding | None:
    length_s = float(poses.t_s[-1] - poses.t_s[0])
    how = "by the rotation that both felt"
    return drift_finding(name, imu, drift=drift.drift, sigma=drift.sigma, length_s=length_s, how=how)


def clock_drift(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> ClockDrift | None:
    """Return the drift of a camera's clock against the IMU's; None where too little turned to tell.

    Parameters
    ----------
    poses : of the target in the camera's frame, at the camera's timestamps
    stream : of the IMU
    time_shift_s : t_imu = t_cam + time_shift_s, to some milliseconds
    """
    integral = gyroscope_integral(stream.t_s, stream.rate)
    found: ClockDrift | None = None
    for _ in range(_PASSES):  # what was found first is taken out, so that the rest is small and nothing counts as wrong
        drift = 0.0 if found is None else found.drift
        turns = _turns(poses, time_shift_s, drift, integral)
        rest = _remaining(turns, integral, stream)
        if rest is None:
            return None
        found = replace(rest, drift=rest.drift + drift, shift_s=rest.shift_s + drift * (rest.t_s - _middle(poses)))
    return found


def _remaining(turns: "_Turns", integral: GyroscopeIntegral, stream: ImuStream) -> ClockDrift | None:
    if len(turns.start_s) < _FEWEST_TURNS * _FEWEST_STRETCHES:
        return None
    gyro = (integral(turns.stop_s) - integral(turns.start_s)) / turns.length_s
    change = (rate_at(stream, turns.stop_s) - rate_at(stream, turns.start_s)) / turns.length_s
    matrix, weight = _explained(turns.rate, gyro, change)
    rest = gyro - turns.rate @ matrix[:3]
    count = min(_STRETCHES, len(rest) // _FEWEST_TURNS)
    middle = 0.5 * (turns.start_s + turns.stop_s) - turns.shift_s
    parts = [_stretch(middle[k], rest[k], change[k], weight[k]) for k in np.array_split(np.arange(len(rest)), count)]
    known = [part for part in parts if part is not None]
    if len(known) < _FEWEST_STRETCHES:
        return None
    t, shift, sigma = np.array(known).T
    return _line(t, shift, sigma)


def _middle(poses: BoardPoses) -> float:
    return 0.5 * float(poses.t_s[0] + poses.t_s[-1])


@value_class
class _Turns:
    """Rotations of the camera: from when to when on the IMU's clock [s], the mean rate [rad/s], the shift taken [s]."""

    start_s: Floats
    stop_s: Floats
    rate: Floats
    shift_s: float

    @property
    def length_s(self) -> Floats:
        return (self.stop_s - self.start_s)[:, None]


def _turns(poses: BoardPoses, time_shift_s: float, drift: float, integral: GyroscopeIntegral) -> _Turns:
    steps = np.diff(poses.t_s)
    stride = max(1, round(_STEP_S / max(float(np.median(steps)), 1e-6))) if len(steps) else 1
    t_s = poses.t_s + time_shift_s + drift * (poses.t_s - _middle(poses)) if len(poses) else poses.t_s
    start, stop = t_s[:-stride], t_s[stride:]
    between = poses.R_cam_target[:-stride] @ np.swapaxes(poses.R_cam_target[stride:], 1, 2)
    rotvec = rotvec_from_rotation(between)
    inside = (start >= integral.t_s[0]) & (stop <= integral.t_s[-1])
    kept = inside & (stop > start) & (stop - start < _LONGEST_STEP_S) & (np.linalg.norm(rotvec, axis=1) < 2.0)
    start, stop = start[kept], stop[kept]
    return _Turns(start_s=start, stop_s=stop, rate=rotvec[kept] / (stop - start)[:, None], shift_s=time_shift_s)


def _explained(camera: Floats, gyro: Floats, change: Floats) -> tuple[Floats, Floats]:
    """Return the matrix (4, 3) that explains the gyroscope, and which turns it explains (n,), 0 or 1.

    It is a full matrix, so that scales and axes of the gyroscope need not be known, and a bias.
    """
    base = np.concatenate([camera, np.ones((len(camera), 1))], axis=1)

    def fitted(weight: Floats, shift: float) -> tuple[Floats, Floats, float]:
        wanted = weight[:, None] * (gyro + shift * change)
        matrix = np.asarray(np.linalg.lstsq(weight[:, None] * base, wanted, rcond=None)[0], dtype=np.float64)
        rest = gyro + shift * change - base @ matrix
        used = weight > 0
        late = float((change[used] * rest[used]).sum() / max(float((change[used] ** 2).sum()), 1e-30))
        error = np.linalg.norm(rest, axis=1)
        within = error < _ROBUST * 1.4826 * float(np.median(error)) + 1e-6
        return matrix, within.astype(np.float64), shift - late

    matrix, weight, shift = np.zeros((4, 3)), np.ones(len(gyro)), 0.0
    for _ in range(_ROUNDS):
        matrix, weight, shift = fitted(weight, shift)
    return matrix, weight


def _stretch(middle: Floats, rest: Floats, change: Floats, weight: Floats) -> tuple[float, float, float] | None:
    """Return when, the correction of the time shift and its standard deviation, of one stretch."""
    used = weight > 0
    if used.sum() < _FEWEST_TURNS / 2:
        return None
    rest, change = rest[used] - rest[used].mean(axis=0), change[used] - change[used].mean(axis=0)
    energy = float((change**2).sum())
    if energy <= 0:
        return None
    shift = -float((change * rest).sum()) / energy
    left = rest + shift * change
    sigma = float(np.sqrt((left**2).mean() / energy))
    if not (np.isfinite(shift) and 0 < sigma < _LARGEST_S and abs(shift) < _LARGEST_S):
        return None
    return float(middle[used].mean()), shift, sigma


def _line(t: Floats, shift: Floats, sigma: Floats) -> ClockDrift:
    """Return the line through the shifts, each weighed by its own sigma, with a floor that their scatter sets."""
    weight, drift, rest = 1 / sigma**2, 0.0, shift
    for _ in range(_ROUNDS):
        x = t - float(weight @ t / weight.sum())
        drift = float(weight @ (x * shift)) / float(weight @ (x * x))
        rest = shift - float(weight @ shift / weight.sum()) - drift * x
        floor = 1.4826 * float(np.median(np.abs(rest)))
        weight = 1 / (sigma**2 + (0.5 * floor) ** 2)
    # Neighbouring turns share a pose, whose error cancels in their sum: the stretches' own sigmas are too large, but
    # the scatter about the line tells. Of so few it is itself uncertain, hence four and not two degrees of freedom.
    excess = float(weight @ (rest * rest)) / (len(t) - 4)
    x = t - float(weight @ t / weight.sum())
    found = float(np.sqrt(excess / float(weight @ (x * x))))
    return ClockDrift(t_s=t, shift_s=shift, sigma_s=sigma, drift=drift, sigma=found)


_FEWEST_FRAMES, _ATTITUDE_ROUNDS, _ATTITUDE_ROBUST = 26, 3, 3.5
_EXPLAINED, _ALIKE = 0.999, 0.9
_FAST, _SIGMAS = 5e-3, 5.0


def early_drift(name: str, poses: BoardPoses, stream: ImuStream, time_shift_s: float, imu: str) -> list[Finding]:
    """Say that a camera's clock drifts by several parts in a thousand against the IMU's (code clock-drift).

    Parameters
    ----------
    name, imu : of camera and IMU
    poses, stream, time_shift_s : as of `clock_drift`
    """
    found = drift_by_attitudes(poses, stream, time_shift_s)
    if found is None or abs(found[0]) < max(_FAST, _SIGMAS * found[1]):
        return []
    return [far_drift_finding(name, imu, *found, length_s=float(poses.t_s[-1] - poses.t_s[0]))]


def far_drift_finding(camera: str, imu: str, drift: float, sigma: float, *, length_s: float) -> Finding:
    """Return that clocks drift apart so far that no time shift holds; arguments as of `drift_finding`."""
    growth_s = drift * length_s
    return make_finding(
        "clock-drift/far", camera=camera, imu=imu, drift=drift, sigma=sigma, growth_s=growth_s, length_s=length_s
    )


def drift_by_attitudes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> tuple[float, float] | None:
    """Return the drift of the time shift by single attitudes, and its sigma; None of few, or unexplained ones."""
    at = poses.t_s + time_shift_s
    inside = (at > stream.t_s[0]) & (at < stream.t_s[-1])
    at, R = at[inside], poses.R_cam_target[inside]
    if len(at) < _FEWEST_FRAMES:
        return None
    turned, wanted, design = _errors(at, R, stream)
    used, error, solution = np.ones(len(at), dtype=bool), wanted, np.zeros(design.shape[2])
    for _ in range(_ATTITUDE_ROUNDS):
        solution = np.linalg.lstsq(design[used].reshape(-1, design.shape[2]), wanted[used].ravel(), rcond=None)[0]
        error = wanted - design @ solution
        size = np.linalg.norm(error, axis=1)
        used = size < _ATTITUDE_ROBUST * 1.4826 * float(np.median(size)) + 1e-9
    rows, error = design[used].reshape(-1, design.shape[2]), error[used]
    if float((error**2).sum()) > (1 - _EXPLAINED) * float((turned**2).sum()):
        return None
    alike = float((error[1:] * error[:-1]).sum() / (error**2).sum()) + rows.shape[1] / rows.shape[0]
    alike = min(max(alike, 0.0), _ALIKE)  # as an autoregression: errors of a lens last
    variance = float((error**2).sum()) / max(len(rows) - rows.shape[1], 1) * (1 + alike) / (1 - alike)
    return float(solution[0]), float(np.sqrt(variance * np.linalg.pinv(rows.T @ rows)[0, 0]))


def _errors(at: Floats, R_cam_target: Floats, stream: ImuStream) -> tuple[Floats, Floats, Floats]:
    """Return turns since the first frame (n, 3), by what the gyroscope's differ (n, 3), and its causes (n, 3, 17)."""
    integral = gyroscope_integral(stream.t_s, stream.rate)
    steps, rate = np.diff(integral(at), axis=0), rate_at(stream, at)
    seen = rotvec_from_rotation(R_cam_target[:-1] @ np.swapaxes(R_cam_target[1:], 1, 2))
    X = nearest_rotation(seen.T @ steps)  # from the IMU's axes to the camera's
    steps, rate = steps @ X.T, rate @ X.T
    each = rotation_from_rotvec(-steps)
    predicted, carried = R_cam_target[0], np.zeros((3, 15))
    carried[:, 12:] = np.eye(3)
    off, causes, length = [np.zeros(3)], [carried], np.diff(at)
    for k, turn in enumerate(each):
        middle = rotation_from_rotvec(-0.5 * steps[k])
        added = np.concatenate([np.kron(np.eye(3), steps[k]), length[k] * np.eye(3)], axis=1)
        predicted, carried = turn @ predicted, turn @ carried
        carried[:, :12] += middle @ added
        off.append(rotvec_from_rotation(predicted @ R_cam_target[k + 1].T))
        causes.append(carried)
    t = at - at.mean()
    by_clock = np.stack([t[:, None] * rate, rate], axis=2)
    turned = rotvec_from_rotation(R_cam_target @ R_cam_target[0].T)
    return turned, np.array(off), np.concatenate([by_clock, np.array(causes)], axis=2)
