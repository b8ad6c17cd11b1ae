"""ORB-SLAM3: the part of its settings that describes the rig, File.version 1.0.

IMU.T_b_c1 maps coordinates of the first camera to the IMU's, Stereo.T_c1_c2 those of the second camera to the first's.
ORB-SLAM3 takes an ideal IMU and stamps without shift; its noise is of continuous time, as Kalibr's is. It reads single
precision. Read back by `readers.projects.orb_slam3`.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..errors import OptionError
from ..models.camera import Camera
from .camera_poses import pose_in_body
from .context import Context, StatedImu
from .export import Export, Loss, g_sensitivity_losses, magnetometer_losses, uncertainty_loss
from .kalibr_camchain import baseline
from .lens_formats import unknown_lens
from .opencv_yaml import opencv_lines, opencv_matrix
from .sensor_losses import (
    accelerometer_losses,
    bias_losses,
    first_cameras,
    ideal_losses,
    no_shift_losses,
    noise_losses,
    other_imu_losses,
    require_cameras,
)
from .si_units import conversions, count_losses

FILE = "orb_slam3.yaml"

_WHOSE = "ORB-SLAM3"
_CAMERAS = 2
_HEAD = """\
%YAML:1.0
---
# The rig for ORB-SLAM3, made by gnomon; sigmas are in calibration.yaml. It is not the whole of the settings: take
# Camera.fps, Camera.RGB, Stereo.ThDepth, ORBextractor and Viewer from one of ORB-SLAM3's own.
# p_b = IMU.T_b_c1 p_c1 [m], b the IMU's frame; p_c1 = Stereo.T_c1_c2 p_c2 [m].
"""
_SHIFT = """\
# There is no key for the time shift: add {shift!r} s to the stamps of {name}, t_imu = t_cam + shift.
"""
_IDEAL = """\
# ORB-SLAM3 takes an ideal IMU: the pose holds for samples in m/s^2 and rad/s that were corrected (gnomon apply).
# Noise is of continuous time: NoiseGyro [rad/s/sqrt(Hz)], NoiseAcc [m/s^2/sqrt(Hz)], GyroWalk [rad/s^2/sqrt(Hz)],
# AccWalk [m/s^3/sqrt(Hz)], Frequency [Hz].
"""
_TYPES = {"none": "PinHole", "radtan": "PinHole", "radtan5": "PinHole", "equidistant": "KannalaBrandt8"}
_COEFFS = {
    "none": (),
    "radtan": ("k1", "k2", "p1", "p2"),
    "radtan5": ("k1", "k2", "p1", "p2", "k3"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}


def export(calibration: Calibration, context: Context) -> Export:
    """Return `orb_slam3.yaml`.

    Raises
    ------
    OptionError
        If there is no camera, or ORB-SLAM3 does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    cameras = dict(list(calibration.cameras.items())[:_CAMERAS])
    name, imu = next(iter(calibration.imus.items()))
    stated = context.of(name)
    text = _text(calibration, cameras, stated, context)
    losses = (
        *count_losses(name, imu, _WHOSE),
        *ideal_losses(name, imu, _WHOSE),
        *g_sensitivity_losses(calibration, _WHOSE),
        *bias_losses(name, imu, _WHOSE),
        *accelerometer_losses(calibration, _WHOSE),
        *noise_losses(stated, _WHOSE, "does not start without: add IMU.NoiseGyro and the others by hand"),
        *other_imu_losses(calibration, _WHOSE),
        *first_cameras(calibration, _CAMERAS, _WHOSE),
        *no_shift_losses(calibration, _WHOSE),
        *_topic_losses(cameras),
        *magnetometer_losses(calibration, _WHOSE),
        Loss(what="precision", why="ORB-SLAM3 reads floats.", size="6e-8 relative"),
        Loss(
            what="settings of the program",
            why="Camera.fps, Camera.RGB, Stereo.ThDepth, ORBextractor and Viewer are not of the rig. Take them from "
            "ORB-SLAM3's own files.",
        ),
        uncertainty_loss(_WHOSE),
    )
    return Export(files={FILE: text}, losses=losses)


def _text(calibration: Calibration, cameras: dict[str, CameraCalibration], stated: StatedImu, context: Context) -> str:
    types = {_type(name, camera.camera) for name, camera in cameras.items()}
    if len(types) > 1:
        raise OptionError(
            f"{' and '.join(cameras)} have lenses of two kinds, and ORB-SLAM3 takes one kind for both. Convert to "
            "kalibr, openvins or basalt."
        )
    name, imu = next(iter(calibration.imus.items()))
    first, *others = cameras.values()
    lines = [line for conversion in conversions(imu) for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    shifts = "".join(
        _SHIFT.format(shift=float(camera.time_shift_cam_imu), name=key)
        for key, camera in cameras.items()
        if camera.time_shift_cam_imu
    )
    rig: dict[str, Any] = {"File.version": "1.0", "Camera.type": types.pop()}
    for number, camera in enumerate(cameras.values(), start=1):
        rig |= {f"Camera{number}.{key}": value for key, value in _lens(camera.camera).items()}
    if len(cameras) > 1 and rig["Camera.type"] == "KannalaBrandt8":  # else ORB-SLAM3 ends at once
        last = first.camera.resolution[0] - 1
        for number in range(1, len(cameras) + 1):
            rig |= {f"Camera{number}.overlappingBegin": 0, f"Camera{number}.overlappingEnd": last}
    rig |= {"Camera.width": first.camera.resolution[0], "Camera.height": first.camera.resolution[1]}
    parts = [_HEAD, _IDEAL, shifts, context.comment(), comments, _joined(opencv_lines(rig))]
    if others:
        parts.append(_joined(opencv_matrix("Stereo.T_c1_c2", _second_to_first(first, others[0]), "f")))
    parts.append(_joined(opencv_matrix("IMU.T_b_c1", pose_in_body(first), "f")))
    noise = dict(_noise(stated))
    if len(noise) < 5:
        parts.append("# ORB-SLAM3 also needs IMU.NoiseGyro, NoiseAcc, GyroWalk, AccWalk and Frequency: add them.\n")
    return "".join([*parts, _joined(opencv_lines(noise))])


def _second_to_first(first: CameraCalibration, second: CameraCalibration) -> np.ndarray:
    """Return T_c1_c2 (4, 4), p_c1 = T_c1_c2 @ p_c2 [m]."""
    return baseline(second, first)


def _type(name: str, camera: Camera) -> str:
    if camera.projection != "pinhole" or camera.distortion not in _TYPES:
        raise unknown_lens(name, camera, "ORB-SLAM3 knows pinhole with radtan, equidistant or no distortion")
    return _TYPES[camera.distortion]


def _lens(camera: Camera) -> dict[str, float]:
    linear = zip(("fx", "fy", "cx", "cy"), camera.intrinsics.tolist(), strict=True)
    return dict(linear) | dict(zip(_COEFFS[camera.distortion], camera.distortion_coeffs.tolist(), strict=True))


def _noise(stated: StatedImu) -> Iterator[tuple[str, float]]:
    noise, rate_hz = stated.noise, stated.update_rate_hz
    if noise is not None:
        yield "IMU.NoiseGyro", noise.gyroscope_noise_density
        yield "IMU.NoiseAcc", noise.accelerometer_noise_density
        yield "IMU.GyroWalk", noise.gyroscope_random_walk
        yield "IMU.AccWalk", noise.accelerometer_random_walk
    if rate_hz is not None:
        yield "IMU.Frequency", float(rate_hz)


def _topic_losses(cameras: dict[str, CameraCalibration]) -> Iterator[Loss]:
    for name, camera in cameras.items():
        if camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="ORB-SLAM3 has no key for it.")


def _joined(lines: Iterator[str]) -> str:
    return "".join(f"{line}\n" for line in lines)
