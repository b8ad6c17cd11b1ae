"""Whether camera, gyroscope and accelerometer agree on their axes and clocks, before anything is estimated.

The camera's poses tell how it turned and how it was accelerated. Both are compared with what the IMU read by linear
least squares, with any 3 x 3 matrix in place of a rotation, so that a wrong sign, exchanged columns or a mirror show:

    gyroscope = A_g omega_cam + b_g,      accelerometer = A_a R_cam_target (D2 (p + R_target_cam x) - g) + b_a.

D2 is the second difference over about a tenth of a second, which is the acceleration averaged with a triangular
window; the accelerometer is averaged with the same one. The products of A_a with the IMU's place x and with gravity g
are unknowns of their own, so that all of it stays linear.
"""

from dataclasses import dataclass

import numpy as np

from ..estimate.camera_imu.alignment import gyroscope_integral
from ..estimate.camera_imu.board_poses import BoardPoses
from ..estimate.camera_imu.first_guess import ImuStream
from ..geometry.rotation_vector import rotvec_from_rotation
from ..recording import Floats

_STEP_S = 0.1
_TURN_S = 0.1
_FEWEST, _FEWEST_TURNS = 60, 25
_ROUNDS, _ROBUST = 3, 3.5
_SEARCH_S, _TRIALS = 0.04, 17
_WINDOW = 21


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxesFit:
    """A sensor's readings as a linear map of what the camera saw.

    Attributes
    ----------
    matrix : (3, 3) from the camera's axes to the sensor's
    offset : (3,) what the sensor reads besides
    explained : share of the readings' variance that the map explains
    delay_s : by which the sensor's readings come later than what the camera saw, at the time shift that was assumed
    delay_sigma_s : its standard deviation
    """

    matrix: Floats
    offset: Floats
    explained: float
    delay_s: float
    delay_sigma_s: float

    @property
    def hand(self) -> float:
        """1 for a rotation, -1 for a mirror image, between them where it cannot be told."""
        singular = np.linalg.svd(self.matrix, compute_uv=False)
        size = float(np.prod(singular)) ** (1 / 3)
        return float(np.sign(np.linalg.det(self.matrix))) if singular[-1] > 0.3 * size > 0 else 0.0


def gyroscope_axes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> AxesFit | None:
    """Return how the gyroscope reads the camera's rotation; None where too little was seen."""
    integral = gyroscope_integral(stream.t_s, stream.rate)
    first, second = _pairs(poses.t_s, _TURN_S)
    start, stop = poses.t_s[first] + time_shift_s, poses.t_s[second] + time_shift_s
    inside = (start >= stream.t_s[0]) & (stop <= stream.t_s[-1])
    first, second, start, stop = first[inside], second[inside], start[inside], stop[inside]
    if len(first) < _FEWEST_TURNS:
        return None
    length = (stop - start)[:, None]
    between = poses.R_cam_target[first] @ np.swapaxes(poses.R_cam_target[second], 1, 2)
    seen = rotvec_from_rotation(between) / length
    read = (integral(stop) - integral(start)) / length
    design = np.column_stack([seen, np.ones(len(seen))])
    fit = _robust(design, read)
    change = (_rate(stream, stop) - _rate(stream, start)) / length
    delay = fit.shift(design, change)
    return AxesFit(
        matrix=fit.solution[:3].T,
        offset=fit.solution[3],
        explained=fit.explained,
        delay_s=delay,
        delay_sigma_s=fit.shift_sigma(design, change),
    )


def accelerometer_axes(poses: BoardPoses, stream: ImuStream, time_shift_s: float) -> AxesFit | None:
    """Return how the accelerometer reads gravity and the camera's acceleration; None where too little was seen."""
    t_s = poses.t_s + time_shift_s
    R = np.swapaxes(poses.R_cam_target, 1, 2)
    p = -np.einsum("nij,nj->ni", R, poses.p_cam_target)
    step_s = _step(t_s)
    centre, both = _second_differences(t_s, np.concatenate([p[:, :, None], R], axis=2), step_s)
    inside = (t_s[centre] > stream.t_s[0] + 0.2) & (t_s[centre] < stream.t_s[-1] - 0.2)
    centre, both = centre[inside], both[inside]
    if len(centre) < _FEWEST:
        return None
    R_cam_target = poses.R_cam_target[centre]
    felt = np.einsum("nij,njk->nik", R_cam_target, both).reshape(len(centre), 12)
    design = np.column_stack([felt, R_cam_target.reshape(len(centre), 9), np.ones(len(centre))])
    # columns 0, 4, 8 hold the acceleration, 1-3, 5-7, 9-11 the arm's
    at = t_s[centre]
    fit = _robust(design, _averaged(stream, at, step_s))
    slope = (_averaged(stream, at + 0.01, step_s) - _averaged(stream, at - 0.01, step_s)) / 0.02
    delays = np.linspace(-_SEARCH_S, _SEARCH_S, _TRIALS)
    costs = [_cost(design, _averaged(stream, at + delay, step_s), fit.weight) for delay in delays]
    best = int(np.argmin(costs))
    delay = float(delays[best])
    refined = _robust(design, _averaged(stream, at + delay, step_s))
    delay += refined.shift(design, slope)
    final = _robust(design, _averaged(stream, at + delay, step_s))
    return AxesFit(
        matrix=_accelerometer_matrix(final.solution),
        offset=final.solution[21],
        explained=final.explained,
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


def _averaged(stream: ImuStream, t_s: Floats, step_s: float) -> Floats:
    """Return the specific force averaged with a triangular window about instants, (n, 3)."""
    offsets = np.linspace(-1, 1, _WINDOW)[1:-1] * step_s
    weights = (1 - np.abs(offsets) / step_s) / (1 - np.abs(offsets) / step_s).sum()
    at = t_s[:, None] + offsets
    return np.stack([np.interp(at, stream.t_s, stream.force[:, i]) @ weights for i in range(3)], axis=1)


def _rate(stream: ImuStream, t_s: Floats) -> Floats:
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        return 2.0 * float(np.sqrt((rest * rest).mean() / energy))

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
