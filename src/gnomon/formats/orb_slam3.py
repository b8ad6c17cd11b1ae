"""ORB-SLAM3's settings: lenses, IMU.T_b_c1 and Stereo.T_c1_c2, the noise; File.version 1.0, and those before it.

IMU.T_b_c1 (Tbc before) maps coordinates of the first camera to the IMU's, Stereo.T_c1_c2 those of the second camera to
the first's. There is no time shift.
"""

from typing import Any

import numpy as np

from ..errors import OptionError
from ..geometry.rotations import inverse_pose
from ..models.camera import Camera
from ..results.calibration import Calibration, CameraCalibration
from .foreign import ForeignCalibration, ForeignImu
from .kalibr.camchain import camera_baseline
from .shared.foreign_yaml import (
    noise_by_key,
    place_camera,
    read_lens,
    read_transform,
    required_value,
    stated_noise,
    whole_number,
)
from .shared.losses import Context, Export, StatedImu, unknown_lens
from .shared.sensor_losses import Holds, not_representable, require_cameras
from .shared.si_units import si_conversions
from .shared.structured import Node
from .shared.yaml_text import opencv_matrix, opencv_text

_NOISE = {
    "IMU.NoiseGyro": "gyroscope_noise_density",
    "IMU.NoiseAcc": "accelerometer_noise_density",
    "IMU.GyroWalk": "gyroscope_random_walk",
    "IMU.AccWalk": "accelerometer_random_walk",
}
_POSES = ("IMU.T_b_c1", "Tbc")
_STEREO = ("Stereo.T_c1_c2", "Tlr")


def is_orb_slam3(root: Node) -> bool:
    """Return whether a file is laid out as ORB-SLAM3's settings."""
    return isinstance(root.value, dict) and "Camera.type" in root.value


def orb_slam3_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the rig of ORB-SLAM3's settings.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in ORB-SLAM3's layout, or its cameras are of a kind that gnomon does not know.
    """
    keys = {node.key: node for node in root.entries()}
    lenses = {"cam0": _read_lens(root, keys, "Camera1." if "Camera1.fx" in keys else "Camera.")}
    if "Camera2.fx" in keys:
        lenses["cam1"] = _read_lens(root, keys, "Camera2.")
    pose = next((keys[name] for name in _POSES if name in keys), None)
    cameras: dict[str, CameraCalibration] = {}
    if pose is not None:
        notes.append("ORB-SLAM3's file holds no time shift; taken: zero.")
        T_imu_cam0 = read_transform(pose)
        cameras["cam0"] = place_camera(T_imu_cam0, 0.0, lenses["cam0"])
        stereo = next((keys[name] for name in _STEREO if name in keys), None)
        if stereo is not None and "cam1" in lenses:
            cameras["cam1"] = place_camera(T_imu_cam0 @ read_transform(stereo), 0.0, lenses["cam1"])
    rate = keys["IMU.Frequency"].number() if "IMU.Frequency" in keys else None
    imu = ForeignImu(noise=stated_noise(keys, _NOISE, notes), update_rate_hz=rate) if pose is not None else None
    return ForeignCalibration(
        imus={},
        frame="accel-x",
        notes=tuple(notes),
        cameras=cameras,
        lenses={name: camera for name, camera in lenses.items() if name not in cameras},
        imu_data={} if imu is None else {"imu0": imu},
        format="ORB-SLAM3",
    )


def _read_lens(root: Node, keys: dict[str, Node], prefix: str) -> Camera:
    kind = keys["Camera.type"].text(("PinHole", "KannalaBrandt8", "Rectified"))
    width, height = (
        whole_number(required_value(keys, f"Camera.{side}", root, "a number")) for side in ("width", "height")
    )
    names = ("k1", "k2", "k3", "k4") if kind == "KannalaBrandt8" else ("k1", "k2", "p1", "p2", "k3")
    stated = [name for name in names if f"{prefix}{name}" in keys]
    coeffs = [keys[f"{prefix}{name}"].number() if name in stated else 0.0 for name in names]
    return read_lens(
        root,
        intrinsics=np.array(
            [required_value(keys, f"{prefix}{name}", root, "a number").number() for name in ("fx", "fy", "cx", "cy")]
        ),
        resolution=(width, height),
        coeffs=np.array(coeffs) if stated else np.empty(0),
        distortion="equidistant" if kind == "KannalaBrandt8" else "radtan" if stated else "none",
    )


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
# There is no key for the time shift: add {shift!r} s to the timestamps of {name}, t_imu = t_cam + shift.
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

HOLDS = Holds(
    program=_WHOSE,
    imus=1,
    cameras=_CAMERAS,
    sensitivity=False,
    bias=False,
    g_sensitivity=False,
    time_shift="none",
    topics=False,
    without_noise="does not start without: add IMU.NoiseGyro and the others by hand",
    floats="reads",
    settings="Camera.fps, Camera.RGB, Stereo.ThDepth, ORBextractor and Viewer",
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `orb_slam3.yaml`.

    Raises
    ------
    OptionError
        If there is no camera, or ORB-SLAM3 does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    cameras = dict(list(calibration.cameras.items())[:_CAMERAS])
    text = _text(calibration, cameras, context.of(next(iter(calibration.imus))), context)
    losses = tuple(not_representable(calibration, HOLDS, context))
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
    lines = [line for conversion in si_conversions(imu) for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    shifts = "".join(
        _SHIFT.format(shift=float(camera.time_shift_cam_imu), name=key)
        for key, camera in cameras.items()
        if camera.time_shift_cam_imu
    )
    rig: dict[str, Any] = {"File.version": "1.0", "Camera.type": types.pop()}
    for number, camera in enumerate(cameras.values(), start=1):
        rig |= {f"Camera{number}.{key}": value for key, value in _lens_entry(camera.camera).items()}
    if len(cameras) > 1 and rig["Camera.type"] == "KannalaBrandt8":  # else ORB-SLAM3 ends at once
        last = first.camera.resolution[0] - 1
        for number in range(1, len(cameras) + 1):
            rig |= {f"Camera{number}.overlappingBegin": 0, f"Camera{number}.overlappingEnd": last}
    rig |= {"Camera.width": first.camera.resolution[0], "Camera.height": first.camera.resolution[1]}
    parts = [_HEAD, _IDEAL, shifts, context.comment(), comments, opencv_text(rig)]
    if others:
        parts.append(opencv_matrix("Stereo.T_c1_c2", camera_baseline(others[0], first), "f"))
    parts.append(opencv_matrix("IMU.T_b_c1", inverse_pose(first.T_cam_body), "f"))
    noise = {} if stated.noise is None else noise_by_key(stated.noise, _NOISE)
    noise |= {} if stated.update_rate_hz is None else {"IMU.Frequency": float(stated.update_rate_hz)}
    if len(noise) < 5:
        parts.append("# ORB-SLAM3 also needs IMU.NoiseGyro, NoiseAcc, GyroWalk, AccWalk and Frequency: add them.\n")
    return "".join([*parts, opencv_text(noise)])


def _type(name: str, camera: Camera) -> str:
    if camera.projection != "pinhole" or camera.distortion not in _TYPES:
        raise unknown_lens(name, camera, "ORB-SLAM3 knows pinhole with radtan, equidistant or no distortion")
    return _TYPES[camera.distortion]


def _lens_entry(camera: Camera) -> dict[str, float]:
    linear = zip(("fx", "fy", "cx", "cy"), camera.intrinsics.tolist(), strict=True)
    return dict(linear) | dict(zip(_COEFFS[camera.distortion], camera.distortion_coeffs.tolist(), strict=True))
