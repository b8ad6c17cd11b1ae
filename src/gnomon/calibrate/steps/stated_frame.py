"""The body frame that somebody states: one of the usual, or what poses of the recording define."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import OptionError
from ...geometry.rotations import nearest_rotation
from ...recording import Floats
from ...results.calibration import Calibration, Covariance, ImuCalibration, calibration_parameters, rotate_imu

_POSE = re.compile(r"([xyz])=(-?)(\d+)")


def in_stated_frame(calibration: Calibration, frame: str, rests: Floats, sigmas: Floats) -> Calibration:
    """Return the calibration in "accel-x", "accel-z", or the frame that poses such as "x=3 y=12 z=-7" define.

    Parameters
    ----------
    calibration : in body frame accel-x
    frame : as stated
    rests : (n, 3) means of the accelerometer in the static intervals [unit]
    sigmas : (n,) predicted sigma of |f| in each [m/s^2]

    Raises
    ------
    OptionError
        If the frame is neither, or a pose names no static interval of this recording.
    """
    if frame == "accel-x":
        return calibration
    if frame == "accel-z":
        return calibration.in_frame(frame)
    axes, rows = _poses(frame, len(rests))
    imu = calibration.imus["imu0"]
    means = rests[rows]
    sigma = sigmas[rows]
    flat = np.concatenate([value.ravel() for _, value in calibration_parameters({"imu0": imu})])

    def moved(x: Floats) -> Floats:
        """Parameters in the user's frame, from those in accel-x followed by the means of the poses."""
        n = len(flat)
        matrices = _unflattened(x[:n], imu)
        up = _up(matrices[0], matrices[1], x[n:].reshape(-1, 3))
        rotation = nearest_rotation(axes.T @ up)
        turned = [(m @ rotation.T).ravel() if m.shape == (3, 3) else m.ravel() for m in matrices]
        return np.concatenate(turned)

    point = np.concatenate([flat, means.ravel()])
    jacobian = _differences(moved, point)
    noise = np.zeros((len(point), len(point)))
    noise[: len(flat), : len(flat)] = calibration.uncertainty.matrix
    by_force = imu.required_accelerometer.sensitivity @ imu.required_accelerometer.sensitivity.T
    for k in range(len(rows)):
        part = slice(len(flat) + 3 * k, len(flat) + 3 * k + 3)
        noise[part, part] = by_force * sigma[k] ** 2
    rotation = nearest_rotation(
        axes.T @ _up(imu.required_accelerometer.sensitivity, imu.required_accelerometer.bias, means)
    )
    return replace(
        calibration,
        imus={"imu0": rotate_imu(imu, rotation)},
        frame="user",
        uncertainty=Covariance(names=calibration.uncertainty.names, matrix=jacobian @ noise @ jacobian.T),
    )


def _poses(text: str, intervals: int) -> tuple[Floats, list[int]]:
    """Return the axes (k, 3) that pointed up, and the intervals' indices, of "x=3 y=12 z=-7"."""
    words = text.replace(",", " ").split()
    matches = [_POSE.fullmatch(word) for word in words]
    if not words or not all(matches):
        raise OptionError(
            f'frame "{text}" is neither accel-x nor accel-z nor a list of poses such as "x=3 y=12 z=-7" '
            "(static interval 3 with x up, 12 with y up, 7 with z down; numbers as in the report)."
        )
    axes = np.zeros((len(words), 3))
    rows: list[int] = []
    for k, match in enumerate(matches):
        assert match is not None
        axis, minus, number = match.groups()
        if not 1 <= int(number) <= intervals:
            raise OptionError(
                f'frame "{text}": there is no static interval {number}; they are numbered 1 to {intervals}.'
            )
        axes[k, "xyz".index(axis)] = -1.0 if minus else 1.0
        rows.append(int(number) - 1)
    if np.linalg.matrix_rank(axes) < 2:
        raise OptionError(f'frame "{text}": one axis leaves the turn about it open. Name poses of two or three axes.')
    return axes, rows


def _unflattened(x: Floats, imu: ImuCalibration) -> list[Floats]:
    matrices: list[Floats] = []
    start = 0
    for _, value in calibration_parameters({"imu0": imu}):
        matrices.append(x[start : start + value.size].reshape(value.shape))
        start += value.size
    return matrices


def _up(sensitivity: Floats, bias: Floats, means: Floats) -> Floats:
    force = (means - bias) @ np.linalg.inv(sensitivity).T
    return force / np.linalg.norm(force, axis=1, keepdims=True)


def _differences(function: Callable[[Floats], Floats], point: Floats) -> Floats:
    """Return the Jacobian by central differences, with steps of 1e-6 of each number's own size."""
    size = np.maximum(np.abs(point), 1e-3 * np.abs(point).max())
    columns = [
        (function(point + step) - function(point - step)) / (2 * step[k]) for k, step in enumerate(np.diag(1e-6 * size))
    ]
    return np.stack(columns, axis=1)
