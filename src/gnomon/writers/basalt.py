"""Basalt: its calibration JSON, cameras and IMU in one file.

Basalt corrects f = (I + S) a - b and w = (I + S_g) y - b_g of samples in m/s^2 and rad/s (see `writers.si_units`), in
body frame accel-x. JSON has no comments: what the numbers mean stands under the key comment. Read back by
`readers.projects.basalt_json`.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration, ImuCalibration
from ..geometry.quaternion import quaternion_from_rotation
from ..models.camera import Camera
from ..models.estimator_forms import BasaltTriad
from ..models.noise import CONSUMER_MEMS
from ..recording import Floats
from .context import Context, StatedImu
from .export import (
    Export,
    Loss,
    g_sensitivity_losses,
    into_frame,
    magnetometer_losses,
    require_triads,
    uncertainty_loss,
)
from .lens_formats import unknown_lens
from .sensor_losses import (
    accelerometer_losses,
    missing_gyroscope_loss,
    noise_losses,
    other_imu_losses,
    shift_losses,
)
from .si_units import conversions, count_losses, si_imu

FILE = "calibration.json"

_RATE_HZ = 200.0
_NO_LIMIT = 1e6  # nothing is seen so far from the axis; Basalt then writes zero
_COMMENT = (
    "Made by gnomon. p_imu = T_imu_cam p_cam [m], quaternion x y z w; t_imu = t_cam + cam_time_offset_ns; specific "
    "force = (I + S) a - b, calib_accel_bias = b and the lower triangle of S by columns; angular rate = "
    "(I + S_g) y - b_g, calib_gyro_bias = b_g and S_g by columns."
)
_PLACEHOLDER = "of this file are not this IMU's but those of some consumer IMU: put in your own."
_INSTEAD = (
    "does not start without: the file has those of a consumer IMU (accel_noise_std, gyro_noise_std, accel_bias_std, "
    "gyro_bias_std, imu_update_rate). Put in yours"
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.json`.

    Raises
    ------
    OptionError
        If Basalt does not know the model of a camera, or an IMU has no accelerometer, which defines its frame.
    """
    require_triads(calibration, "basalt", "accelerometer", otherwise="imu_tk, c-header or csv")
    moved, losses = into_frame(calibration, BasaltTriad.frame, "Basalt's")
    name, imu = next(iter(moved.imus.items()))
    found = (
        *losses,
        *count_losses(name, imu, "Basalt"),
        *g_sensitivity_losses(moved, "Basalt"),
        *missing_gyroscope_loss(name, imu),
        *other_imu_losses(moved, "Basalt"),
        *shift_losses(moved, "Basalt"),
        *noise_losses(context.of(name), "Basalt", _INSTEAD),
        *accelerometer_losses(moved, "Basalt"),
        *_losses(moved),
        *magnetometer_losses(moved, "Basalt"),
    )
    return Export(
        files={FILE: basalt_text(moved, context.of(name), context.remarks)}, losses=(*found, uncertainty_loss("basalt"))
    )


def basalt_text(calibration: Calibration, stated: StatedImu | None = None, remarks: tuple[str, ...] = ()) -> str:
    """Return the text of the JSON for a calibration in body frame accel-x.

    Parameters
    ----------
    stated : noise and rate of imu0; without them those of a consumer IMU are put in, and the file says so
    remarks : sentences for the comment

    Raises
    ------
    OptionError
        If Basalt does not know the model of a camera.
    """
    imu = next(iter(calibration.imus.values()))
    accelerometer, gyroscope = _triads(imu)
    stated = stated or StatedImu()
    noise, rate_hz = stated.noise or CONSUMER_MEMS, stated.update_rate_hz or _RATE_HZ
    cameras = list(calibration.cameras.values())
    shift = cameras[0].time_shift_cam_imu if cameras else 0.0
    lines = [line for conversion in conversions(imu) if conversion.unit == "count" for line in conversion.lines()]
    placeholders = (*(() if stated.noise else ("Noise",)), *(() if stated.update_rate_hz else ("imu_update_rate",)))
    assumed = [f"{' and '.join(placeholders)} {_PLACEHOLDER}"] if placeholders else []
    comment = " ".join([_COMMENT, *assumed, *lines, *remarks])
    document: dict[str, Any] = {
        "comment": comment,
        "T_imu_cam": [_pose(camera) for camera in cameras],
        "intrinsics": [_lens(name, entry.camera) for name, entry in calibration.cameras.items()],
        "resolution": [list(camera.camera.resolution) for camera in cameras],
        "calib_accel_bias": [*accelerometer.b.tolist(), *(accelerometer.S.T[np.triu_indices(3)]).tolist()],
        "calib_gyro_bias": [*gyroscope.b.tolist(), *gyroscope.S.T.ravel().tolist()],
        "imu_update_rate": float(rate_hz),
        "accel_noise_std": [noise.accelerometer_noise_density] * 3,
        "gyro_noise_std": [noise.gyroscope_noise_density] * 3,
        "accel_bias_std": [noise.accelerometer_random_walk] * 3,
        "gyro_bias_std": [noise.gyroscope_random_walk] * 3,
        "cam_time_offset_ns": round(shift * 1e9),
        "vignette": [],
    }
    return json.dumps({"value0": document}, indent=4) + "\n"


def _triads(imu: ImuCalibration) -> tuple[BasaltTriad, BasaltTriad]:
    si = si_imu(imu)
    sensor = si.required_accelerometer
    accelerometer = BasaltTriad.of_accelerometer(sensor.sensitivity, sensor.bias)
    if si.gyroscope is None:
        return accelerometer, BasaltTriad(S=np.zeros((3, 3)), b=np.zeros(3))
    return accelerometer, BasaltTriad.from_sensor(si.gyroscope.sensitivity, si.gyroscope.bias)


def _pose(camera: CameraCalibration) -> dict[str, float]:
    R_imu_cam = camera.T_cam_imu[:3, :3].T
    p_imu_cam = -R_imu_cam @ camera.T_cam_imu[:3, 3]
    w, x, y, z = quaternion_from_rotation(R_imu_cam).tolist()
    px, py, pz = p_imu_cam.tolist()
    return {"px": px, "py": py, "pz": pz, "qx": x, "qy": y, "qz": z, "qw": w}


def _lens(name: str, camera: Camera) -> dict[str, Any]:
    """Return a lens in Basalt's terms."""
    shape, (fx, fy, cx, cy) = camera.intrinsics[:-4].tolist(), camera.intrinsics[-4:].tolist()
    linear = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
    match camera.projection, camera.distortion:
        case "pinhole", "none":
            return {"camera_type": "pinhole", "intrinsics": linear}
        case "pinhole", "equidistant":
            return {"camera_type": "kb4", "intrinsics": linear | _named("k1 k2 k3 k4", camera.distortion_coeffs)}
        case "pinhole", "radtan" | "radtan5":
            coeffs = np.zeros(8)
            coeffs[: len(camera.distortion_coeffs)] = camera.distortion_coeffs
            own = _named("k1 k2 p1 p2 k3 k4 k5 k6", coeffs)
            limit = camera.distortion_limit
            return {
                "camera_type": "pinhole-radtan8",
                "intrinsics": {**linear, **own, "rpmax": limit if limit < _NO_LIMIT else 0.0},
            }
        case "ds", "none":
            return {"camera_type": "ds", "intrinsics": {**linear, "xi": shape[0], "alpha": shape[1]}}
        case "eucm", "none":
            return {"camera_type": "eucm", "intrinsics": {**linear, "alpha": shape[0], "beta": shape[1]}}
        case "omni", "none" if shape[0] >= 0:  # Basalt divides by alpha rho + (1 - alpha) z, omni by xi rho + z
            scale = 1 + shape[0]
            return {
                "camera_type": "ucm",
                "intrinsics": {**linear, "fx": fx / scale, "fy": fy / scale, "alpha": shape[0] / scale},
            }
        case _:
            knows = "Basalt knows pinhole with radtan, equidistant or no distortion, and ds, eucm and omni without"
            raise unknown_lens(name, camera, knows)


def _named(names: str, values: Floats) -> dict[str, float]:
    return dict(zip(names.split(), values.tolist(), strict=True))


def _losses(calibration: Calibration) -> Iterator[Loss]:
    if not calibration.cameras:
        yield Loss(what="cameras", why="this calibration is of an IMU alone; Basalt needs at least one.")
        return
    yield Loss(what="time shift", why="Basalt counts whole nanoseconds: it was rounded.", size="at most 0.5 ns")
    for name, camera in calibration.cameras.items():
        if camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="Basalt has no key for it.")
        if camera.camera.model in ("pinhole-radtan", "pinhole-radtan5"):
            yield Loss(
                what=f"camera_type of {name}",
                why="only newer versions of Basalt know pinhole-radtan8; the first ones know no radtan at all.",
            )
