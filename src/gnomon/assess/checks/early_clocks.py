"""What a few seconds tell of the clocks of a camera and an IMU, before the usual checks have enough frames.

The attitude that a camera saw in each frame is held against the one that the gyroscope leads to from the first: those
have errors of their own, while differences of neighbouring frames share them, and tell a drift several times worse.
What the gyroscope's scales, axes and bias, the first frame and the time shift do is estimated beside the drift. An
accelerometer that comes late is told once the gyroscope's axes are known: gravity, the IMU's place and a bias are all
that is free then, not a matrix of its own.
"""

import numpy as np

from ...estimate.camera_imu.start.alignment import gyroscope_integral
from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...findings import Finding, make_finding
from ...geometry.rotation_vector import nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from ...recording import Floats
from .rig_axes import AxesFit, averaged_force, force_by_gyroscope, rate_at

_FEWEST, _ROUNDS, _ROBUST = 26, 3, 3.5
_EXPLAINED, _ALIKE = 0.999, 0.9
_FAST, _SIGMAS = 5e-3, 5.0
_SEARCH_S, _TRIALS, _STEP_S = 0.1, 41, 0.01
_LATE_S, _LATE_SIGMAS, _CLEARLY = 0.015, 4.0, 2.0
_LEFT = 0.1  # of the variance of the force, at most


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
    drift, sigma = found
    length_s = float(poses.t_s[-1] - poses.t_s[0])
    growth_s = drift * length_s
    return [
        make_finding(
            "clock-drift/far", camera=name, imu=imu, drift=drift, sigma=sigma, growth_s=growth_s, length_s=length_s
        )
    ]


def drift_by_attitudes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> tuple[float, float] | None:
    """Return the drift of the time shift by single attitudes, and its sigma; None of few, or unexplained ones."""
    at = poses.t_s + time_shift_s
    inside = (at > stream.t_s[0]) & (at < stream.t_s[-1])
    at, R = at[inside], poses.R_cam_target[inside]
    if len(at) < _FEWEST:
        return None
    turned, wanted, design = _errors(at, R, stream)
    used, error, solution = np.ones(len(at), dtype=bool), wanted, np.zeros(design.shape[2])
    for _ in range(_ROUNDS):
        solution = np.linalg.lstsq(design[used].reshape(-1, design.shape[2]), wanted[used].ravel(), rcond=None)[0]
        error = wanted - design @ solution
        size = np.linalg.norm(error, axis=1)
        used = size < _ROBUST * 1.4826 * float(np.median(size)) + 1e-9
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


def late_accelerometer(
    imu: str, poses: BoardPoses, stream: ImuStream, time_shift_s: float, gyroscope: AxesFit
) -> list[Finding]:
    """Say that an accelerometer's readings come by much later or earlier than the gyroscope's (code triads-apart)."""
    seen = force_by_gyroscope(poses, stream, time_shift_s, gyroscope)
    if seen is None:
        return []
    at, step_s, known, free = seen
    q, force = np.linalg.qr(free.reshape(-1, free.shape[2]))[0], averaged_force(stream, step_s)

    def left_at(delay_s: float) -> Floats:
        wanted = (force(at + delay_s) - known).ravel()
        return wanted - q @ (q.T @ wanted)

    delays = np.linspace(-_SEARCH_S, _SEARCH_S, _TRIALS)
    best = min(delays.tolist(), key=lambda delay_s: float((left_at(delay_s) ** 2).sum()))
    slope = (left_at(best + _STEP_S) - left_at(best - _STEP_S)) / (2 * _STEP_S)
    best -= float(slope @ left_at(best)) / float(slope @ slope)
    left, before = left_at(best), left_at(0.0)
    sigma = 2.0 * float(np.sqrt((left**2).mean() / (slope @ slope)))  # neighbouring differences share poses
    delay = best - gyroscope.delay_s
    read = force(at)
    explained = left @ left < _LEFT * ((read - read.mean(axis=0)) ** 2).sum() and abs(best) < _SEARCH_S
    clear = abs(delay) > max(_LATE_S, _LATE_SIGMAS * sigma) and before @ before > _CLEARLY * (left @ left)
    if not (explained and clear):
        return []
    later, earlier = ("accelerometer", "gyroscope") if delay > 0 else ("gyroscope", "accelerometer")
    return [make_finding("triads-apart/rig", later=later, imu=imu, delay=abs(delay), sigma=sigma, earlier=earlier)]
