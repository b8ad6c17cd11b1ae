"""ORB-SLAM3's settings: lenses, IMU.T_b_c1 and Stereo.T_c1_c2, the noise; File.version 1.0, and those before it.

IMU.T_b_c1 (Tbc before) maps coordinates of the first camera to the IMU's, Stereo.T_c1_c2 those of the second camera to
the first's. There is no time shift.
"""

import numpy as np

from ...calibration import CameraCalibration
from ...errors import OptionError
from ...models.camera import Camera
from ...models.noise import ImuNoise
from ..rig.kalibr_yaml import required, whole_number
from ..structured import Node
from .camera_places_in_body import lens, placed
from .foreign import ForeignCalibration, ForeignImu
from .foreign_yaml import rigid

_NOISE = {
    "IMU.NoiseAcc": "accelerometer_noise_density",
    "IMU.AccWalk": "accelerometer_random_walk",
    "IMU.NoiseGyro": "gyroscope_noise_density",
    "IMU.GyroWalk": "gyroscope_random_walk",
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
    lenses = {"cam0": _lens(root, keys, "Camera1." if "Camera1.fx" in keys else "Camera.")}
    if "Camera2.fx" in keys:
        lenses["cam1"] = _lens(root, keys, "Camera2.")
    pose = next((keys[name] for name in _POSES if name in keys), None)
    cameras: dict[str, CameraCalibration] = {}
    if pose is not None:
        notes.append("ORB-SLAM3's file holds no time shift; taken: zero.")
        T_imu_cam0 = rigid(pose)
        cameras["cam0"] = placed(T_imu_cam0, 0.0, lenses["cam0"])
        stereo = next((keys[name] for name in _STEREO if name in keys), None)
        if stereo is not None and "cam1" in lenses:
            cameras["cam1"] = placed(T_imu_cam0 @ rigid(stereo), 0.0, lenses["cam1"])
    rate = keys["IMU.Frequency"].number() if "IMU.Frequency" in keys else None
    return ForeignCalibration(
        imus={},
        frame="accel-x",
        notes=tuple(notes),
        cameras=cameras,
        lenses={name: camera for name, camera in lenses.items() if name not in cameras},
        imu_data={"imu0": ForeignImu(noise=_noise(keys, notes), update_rate_hz=rate)} if pose is not None else {},
        format="ORB-SLAM3",
    )


def _lens(root: Node, keys: dict[str, Node], prefix: str) -> Camera:
    kind = keys["Camera.type"].text(("PinHole", "KannalaBrandt8", "Rectified"))
    width, height = (whole_number(required(keys, f"Camera.{side}", root, "a number")) for side in ("width", "height"))
    names = ("k1", "k2", "k3", "k4") if kind == "KannalaBrandt8" else ("k1", "k2", "p1", "p2", "k3")
    stated = [name for name in names if f"{prefix}{name}" in keys]
    coeffs = [keys[f"{prefix}{name}"].number() if name in stated else 0.0 for name in names]
    return lens(
        root,
        intrinsics=np.array(
            [required(keys, f"{prefix}{name}", root, "a number").number() for name in ("fx", "fy", "cx", "cy")]
        ),
        resolution=(width, height),
        coeffs=np.array(coeffs) if stated else np.empty(0),
        distortion="equidistant" if kind == "KannalaBrandt8" else "radtan" if stated else "none",
    )


def _noise(keys: dict[str, Node], notes: list[str]) -> ImuNoise | None:
    found = {ours: keys[name].number() for name, ours in _NOISE.items() if name in keys}
    try:
        return ImuNoise(**found) if len(found) == len(_NOISE) else None
    except OptionError as error:
        notes.append(f"The noise was left out: {error}")
        return None
