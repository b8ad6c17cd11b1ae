"""VINS-Fusion and VINS-Mono: the part of `config.yaml` that describes the rig, and `cam0.yaml` for each lens.

body_T_cam0 maps camera to IMU coordinates and td is t_imu - t_cam. VINS takes an ideal IMU. Its noise is that of a
sample: acc_n and gyr_n are the standard deviation of a sample, density times the root of the rate, and acc_w, gyr_w
times the interval of the samples are the standard deviation of a step of the bias. Read back by
`readers.projects.vins_fusion`.
"""

from collections.abc import Iterator
from math import sqrt
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..models.camera import Camera
from .camera_poses import pose_in_body
from .context import Context, StatedImu
from .export import Export, Loss, g_sensitivity_losses, magnetometer_losses, uncertainty_loss
from .lens_fit import cameras_without_k3, k3_losses
from .lens_formats import unknown_lens
from .opencv_yaml import FIRST_LINE, opencv_lines, opencv_matrix
from .sensor_losses import (
    accelerometer_losses,
    bias_losses,
    first_cameras,
    ideal_losses,
    noise_losses,
    other_imu_losses,
    require_cameras,
    shift_losses,
)
from .si_units import conversions, count_losses

FILE = "config.yaml"

_WHOSE = "VINS-Fusion"
_CAMERAS = 2
_HEAD = """\
# The rig for VINS-Fusion, made by gnomon; sigmas are in calibration.yaml. It is not the whole of a configuration: take
# the settings of the tracker and the optimiser from one of VINS' own.
# p_imu = body_T_cam0 p_cam0 [m]; t_imu = t_cam + td [s].
# VINS takes an ideal IMU: the poses hold for samples in m/s^2 and rad/s that were corrected (gnomon apply).
"""
_NOISE = """\
# Noise of a sample: acc_n [m/s^2] and gyr_n [rad/s] = density * sqrt(update_rate), acc_w [m/s^3] and gyr_w [rad/s^2] =
# random walk * sqrt(update_rate); update_rate [Hz] is gnomon's own key, which VINS passes over.
"""
_SETTINGS = "max_cnt, min_dist, freq, F_threshold, max_solver_time, max_num_iterations, keyframe_parallax and others"


def export(calibration: Calibration, context: Context) -> Export:
    """Return `config.yaml`, and `cam0.yaml`, `cam1.yaml` for the lenses.

    Raises
    ------
    OptionError
        If there is no camera, or VINS does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    cameras = cameras_without_k3(dict(list(calibration.cameras.items())[:_CAMERAS]))
    name, imu = next(iter(calibration.imus.items()))
    stated = context.of(name)
    files = {f"{camera}.yaml": _lens_text(camera, known.camera, context) for camera, known in cameras.items()}
    losses = (
        *count_losses(name, imu, _WHOSE),
        *ideal_losses(name, imu, _WHOSE),
        *g_sensitivity_losses(calibration, _WHOSE),
        *bias_losses(name, imu, _WHOSE),
        *accelerometer_losses(calibration, _WHOSE),
        *noise_losses(stated, _WHOSE, "does not start without acc_n, gyr_n, acc_w and gyr_w: add them by hand"),
        *other_imu_losses(calibration, _WHOSE),
        *first_cameras(calibration, _CAMERAS, _WHOSE),
        *k3_losses(calibration, _WHOSE),
        *shift_losses(calibration, _WHOSE),
        *magnetometer_losses(calibration, _WHOSE),
        Loss(what="settings of the program", why=f"{_SETTINGS} are not of the rig. Take them from VINS' own files."),
        uncertainty_loss(_WHOSE),
    )
    return Export(files={FILE: _text(calibration, cameras, stated, context), **files}, losses=losses)


def _text(calibration: Calibration, cameras: dict[str, CameraCalibration], stated: StatedImu, context: Context) -> str:
    name, imu = next(iter(calibration.imus.items()))
    first = next(iter(cameras.values()))
    noise = dict(_noise(stated))
    lines = [line for conversion in conversions(imu) for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    comments += f"# g_norm [m/s^2]: {calibration.gravity.source}\n"
    rig: dict[str, Any] = {"imu": 1, "num_of_cam": len(cameras)}
    rig |= {"imu_topic": stated.topic} if stated.topic else {}
    rig |= {f"image{i}_topic": camera.camera.topic for i, camera in enumerate(cameras.values()) if camera.camera.topic}
    rig |= {f"cam{i}_calib": f"{camera}.yaml" for i, camera in enumerate(cameras)}
    rig |= {"image_width": first.camera.resolution[0], "image_height": first.camera.resolution[1]}
    rig["estimate_extrinsic"] = 0
    end: dict[str, Any] = {
        **noise,
        "g_norm": float(calibration.gravity.value),
        "estimate_td": 0,
        "td": float(first.time_shift_cam_imu),
    }
    parts = [FIRST_LINE, _HEAD, context.comment(), comments, _joined(opencv_lines(rig))]
    for i, camera in enumerate(cameras.values()):
        parts.append(_joined(opencv_matrix(f"body_T_cam{i}", pose_in_body(camera), "d")))
    parts.append(_NOISE if noise else "# VINS also needs acc_n, gyr_n, acc_w and gyr_w: add them.\n")
    return "".join([*parts, _joined(opencv_lines(end))])


def _noise(stated: StatedImu) -> Iterator[tuple[str, float]]:
    """Yield the noise of a sample, which needs the rate."""
    noise, rate_hz = stated.noise, stated.update_rate_hz
    if noise is None or rate_hz is None:
        return
    root = sqrt(rate_hz)
    yield "acc_n", noise.accelerometer_noise_density * root
    yield "gyr_n", noise.gyroscope_noise_density * root
    yield "acc_w", noise.accelerometer_random_walk * root
    yield "gyr_w", noise.gyroscope_random_walk * root
    yield "update_rate", float(rate_hz)


def _lens_text(name: str, camera: Camera, context: Context) -> str:
    width, height = camera.resolution
    document: dict[str, Any] = {"camera_name": name, "image_width": width, "image_height": height}
    lens = _lens(name, camera)
    head = "# Lens for VINS' camera models, made by gnomon. Pixel (0, 0) is the centre of the top-left pixel.\n"
    return FIRST_LINE + head + context.comment() + _joined(opencv_lines({"model_type": lens[0], **document, **lens[1]}))


def _lens(name: str, camera: Camera) -> tuple[str, dict[str, Any]]:
    """Return the name of a model and its parameters."""
    shape, (fx, fy, cx, cy) = camera.intrinsics[:-4].tolist(), camera.intrinsics[-4:].tolist()
    coeffs = camera.distortion_coeffs if camera.distortion != "none" else np.zeros(4)
    bent = dict(zip(("k1", "k2", "p1", "p2"), coeffs.tolist(), strict=False))
    match camera.projection, camera.distortion:
        case "pinhole", "none" | "radtan":
            linear = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
            return "PINHOLE", {"distortion_parameters": bent, "projection_parameters": linear}
        case "pinhole", "equidistant":
            theta = dict(zip(("k2", "k3", "k4", "k5"), coeffs.tolist(), strict=True))
            return "KANNALA_BRANDT", {"projection_parameters": {**theta, "mu": fx, "mv": fy, "u0": cx, "v0": cy}}
        case "omni", "none" | "radtan":
            linear = {"gamma1": fx, "gamma2": fy, "u0": cx, "v0": cy}
            mirror = {"xi": shape[0]}
            return "MEI", {
                "mirror_parameters": mirror, "distortion_parameters": bent, "projection_parameters": linear,
            }  # fmt: skip
        case _:
            knows = "pinhole with radtan, equidistant or no distortion, and omni with radtan or none"
            raise unknown_lens(name, camera, f"VINS-Fusion knows {knows}")


def _joined(lines: Iterator[str]) -> str:
    return "".join(f"{line}\n" for line in lines)
