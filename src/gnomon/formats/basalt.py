"""Basalt's calibration JSON: cameras against the IMU, its scale, misalignment and bias, and its noise.

Basalt corrects f = (I + S) a - b, S lower triangular, and w = (I + S_g) y - b_g; its lists hold the bias, then the
columns of S. T_imu_cam maps camera to IMU coordinates, with a Hamilton quaternion (x, y, z, w); cam_time_offset_ns is
t_imu - t_cam. Densities are of continuous time, as Kalibr's are.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import OptionError
from ..geometry.rotations import inverse_pose, quaternion_from_rotation
from ..models.camera import Camera
from ..models.lens_names import DistortionName, ProjectionName
from ..models.project_forms import BasaltTriad
from ..recording import Floats
from ..recording.samples import ImuNoise, consumer_mems
from ..results.calibration import (
    Calibration,
    CameraCalibration,
    ImuCalibration,
)
from .foreign import ForeignCalibration, ForeignImu, imu_in_si, recognised_frame
from .shared.foreign_yaml import passed_over, required_value, unit_quaternion, whole_number
from .shared.losses import Context, Export, Loss, StatedImu, into_frame, require_triads, unknown_lens
from .shared.sensor_losses import Holds, not_representable
from .shared.si_units import si_conversions, si_imu
from .shared.structured import Node

_NOISE = {
    "accel_noise_std": "accelerometer_noise_density",
    "accel_bias_std": "accelerometer_random_walk",
    "gyro_noise_std": "gyroscope_noise_density",
    "gyro_bias_std": "gyroscope_random_walk",
}
_KEYS = (
    "T_imu_cam", "intrinsics", "resolution", "calib_accel_bias", "calib_gyro_bias", "imu_update_rate",
    "cam_time_offset_ns", "vignette", "comment", *_NOISE,
)  # fmt: skip
_LINEAR = ("fx", "fy", "cx", "cy")
_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_NAMES = {
    "pinhole": (),
    "ds": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
    "ucm": ("alpha",),
    "kb4": ("k1", "k2", "k3", "k4"),
    "pinhole-radtan8": _RATIONAL,
}
"""Basalt's name of a camera -> its parameters beside focal lengths and principal point."""
_PROJECTIONS: dict[str, ProjectionName] = {"ds": "ds", "eucm": "eucm", "ucm": "omni"}
_DISTORTIONS: dict[str, DistortionName] = {"kb4": "equidistant", "pinhole-radtan8": "radtan"}
_KINDS = {
    ("pinhole", "none"): "pinhole",
    ("pinhole", "radtan5"): "pinhole-radtan8",
    **{("pinhole", distortion): kind for kind, distortion in _DISTORTIONS.items()},
    **{(projection, "none"): kind for kind, projection in _PROJECTIONS.items()},
}
"""Our names of a camera -> Basalt's."""


def is_basalt(root: Node) -> bool:
    """Return whether a JSON document is laid out as Basalt's calibrations are."""
    value = root.value.get("value0", root.value) if isinstance(root.value, dict) else None
    return isinstance(value, dict) and "T_imu_cam" in value and "intrinsics" in value


def basalt_of(root: Node) -> ForeignCalibration:
    """Return the calibration in a JSON document of Basalt's.

    Raises
    ------
    FormatError
        If it is not in Basalt's layout, or has a camera that gnomon does not know.
    """
    if not is_basalt(root):
        raise root.fail("expected Basalt's calibration, with T_imu_cam and intrinsics under value0.")
    top = root.child("value0") if "value0" in root.value else root
    keys = {node.key: node for node in top.entries()}
    notes: list[str] = []
    passed_over((node for key, node in keys.items() if key not in _KEYS), notes)
    S_a, b_a = _read_triad(keys.get("calib_accel_bias"), 9).to_sensor()
    imu = imu_in_si((np.tril(S_a), b_a), _read_triad(keys.get("calib_gyro_bias"), 12).to_sensor())
    noise = _read_noise(keys, notes)
    rate = keys["imu_update_rate"].number() if "imu_update_rate" in keys else None
    return ForeignCalibration(
        imus={"imu0": imu},
        frame=recognised_frame({"imu0": imu}),
        notes=tuple(notes),
        cameras=_cameras(keys, top),
        imu_data={"imu0": ForeignImu(noise=noise, update_rate_hz=rate)},
        format="Basalt",
    )


def _read_triad(node: Node | None, count: int) -> BasaltTriad:
    if node is None:
        return BasaltTriad(S=np.zeros((3, 3)), b=np.zeros(3))
    values = node.floats(count)
    S = np.zeros((3, 3))
    if count == 9:  # the lower triangle, column by column
        S[[0, 1, 2, 1, 2, 2], [0, 0, 0, 1, 1, 2]] = values[3:]
    else:
        S[:] = values[3:].reshape(3, 3).T
    if np.linalg.matrix_rank(np.eye(3) + S) < 3:
        raise node.fail("with these scales and misalignments the three axes do not measure three directions.")
    return BasaltTriad(S=S, b=values[:3])


def _read_noise(keys: dict[str, Node], notes: list[str]) -> ImuNoise | None:
    found: dict[str, float] = {}
    for name, ours in _NOISE.items():
        if name in keys:
            node = keys[name]
            values = node.floats(3) if isinstance(node.value, list) else np.full(3, node.number())
            found[ours] = float(values[0] if np.ptp(values) == 0 else np.sqrt(np.mean(np.square(values))))
            if np.ptp(values) != 0:
                notes.append(f"{name} differs from axis to axis; taken: the root of the mean square.")
    try:
        return ImuNoise(**found) if len(found) == len(_NOISE) else None
    except OptionError as error:
        notes.append(f"The noise was left out: {error}")
        return None


def _cameras(keys: dict[str, Node], top: Node) -> dict[str, CameraCalibration]:
    poses, lenses = list(keys["T_imu_cam"].items()), list(keys["intrinsics"].items())
    sizes = list(required_value(keys, "resolution", top, "[width, height] of each camera").items())
    if not len(poses) == len(lenses) == len(sizes):
        raise top.fail(
            f"found {len(poses)} poses (T_imu_cam), {len(lenses)} intrinsics and {len(sizes)} resolutions; expected "
            "one of each for every camera."
        )
    shift = keys["cam_time_offset_ns"].number() * 1e-9 if "cam_time_offset_ns" in keys else 0.0
    return {
        f"cam{i}": CameraCalibration(
            T_cam_body=_T_cam_imu(pose), time_shift_cam_imu=shift, camera=_read_camera(lens, size)
        )
        for i, (pose, lens, size) in enumerate(zip(poses, lenses, sizes, strict=True))
    }


def _T_cam_imu(node: Node) -> Floats:
    keys = {child.key: child for child in node.entries()}
    p, q = (
        np.array([required_value(keys, name, node, "a number").number() for name in names])
        for names in (("px", "py", "pz"), ("qw", "qx", "qy", "qz"))
    )
    T_imu_cam = np.eye(4)
    T_imu_cam[:3, :3], T_imu_cam[:3, 3] = unit_quaternion(node, q), p
    return inverse_pose(T_imu_cam)


def _read_camera(node: Node, size: Node) -> Camera:
    keys = {child.key: child for child in node.entries()}
    kind = required_value(keys, "camera_type", node, f"one of {', '.join(_NAMES)}").text(tuple(_NAMES))
    values = {child.key: child for child in required_value(keys, "intrinsics", node, "its parameters").entries()}

    def read(names: tuple[str, ...]) -> Floats:
        return np.array(
            [required_value(values, name, keys["intrinsics"], f"a number of {kind}").number() for name in names]
        )

    linear, own = read(_LINEAR), read(_NAMES[kind])
    sides = list(size.items())
    if len(sides) != 2:
        raise size.fail(f"found {len(sides)} numbers, expected [width, height].")
    resolution = whole_number(sides[0]), whole_number(sides[1])
    shape, coeffs = (own, np.empty(0)) if kind in {"ds", "eucm", "ucm"} else (np.empty(0), own)
    bent = _DISTORTIONS.get(kind, "none")
    if kind == "ucm":
        shape, linear = _omni(own, linear, node)
    if kind == "pinhole-radtan8":
        if coeffs[5:].any():
            raise node.fail("k4 to k6 are not all zero, and gnomon knows k1 k2 p1 p2 k3 of pinhole-radtan8 only.")
        bent = bent if coeffs[4] == 0 else "radtan5"
        coeffs = coeffs[: 4 if coeffs[4] == 0 else 5]
    try:
        return Camera(
            projection=_PROJECTIONS.get(kind, "pinhole"),
            intrinsics=np.concatenate([shape, linear]),
            distortion=bent,
            distortion_coeffs=coeffs,
            resolution=resolution,
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def _omni(own: Floats, linear: Floats, node: Node) -> tuple[Floats, Floats]:
    """Return shape and focal lengths: Basalt divides by alpha rho + (1 - alpha) z, Mei and Rives by xi rho + z."""
    alpha = float(own[0])
    if not 0 <= alpha < 1:
        raise node.fail(f"alpha {alpha:g} of ucm is out of range: it must be from 0 to below 1.")
    return own / (1 - alpha), linear / [1 - alpha, 1 - alpha, 1, 1]


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

HOLDS = Holds(
    program="Basalt",
    imus=1,
    g_sensitivity=False,
    ideal_gyroscope=True,
    time_shift="one",
    topics=False,
    without_noise=_INSTEAD,
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.json`.

    Raises
    ------
    OptionError
        If Basalt does not know the model of a camera, or an IMU has no accelerometer, which defines its frame.
    """
    require_triads(calibration, "basalt", "accelerometer")
    moved, losses = into_frame(calibration, BasaltTriad.frame, "Basalt's")
    name = next(iter(moved.imus))
    found = (*losses, *_losses(moved), *not_representable(moved, HOLDS, context))
    return Export(files={FILE: basalt_text(moved, context.of(name), context.remarks)}, losses=found)


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
    noise, rate_hz = stated.noise or consumer_mems(), stated.update_rate_hz or _RATE_HZ
    cameras = list(calibration.cameras.values())
    shift = cameras[0].time_shift_cam_imu if cameras else 0.0
    lines = [line for conversion in si_conversions(imu) if conversion.unit == "count" for line in conversion.lines()]
    placeholders = (*(() if stated.noise else ("Noise",)), *(() if stated.update_rate_hz else ("imu_update_rate",)))
    assumed = [f"{' and '.join(placeholders)} {_PLACEHOLDER}"] if placeholders else []
    comment = " ".join([_COMMENT, *assumed, *lines, *remarks])
    document: dict[str, Any] = {
        "comment": comment,
        "T_imu_cam": [_pose_entry(camera) for camera in cameras],
        "intrinsics": [_lens_entry(name, entry.camera) for name, entry in calibration.cameras.items()],
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


def _pose_entry(camera: CameraCalibration) -> dict[str, float]:
    T_imu_cam = inverse_pose(camera.T_cam_imu)
    w, x, y, z = quaternion_from_rotation(T_imu_cam[:3, :3]).tolist()
    px, py, pz = T_imu_cam[:3, 3].tolist()
    return {"px": px, "py": py, "pz": pz, "qx": x, "qy": y, "qz": z, "qw": w}


def _lens_entry(name: str, camera: Camera) -> dict[str, Any]:
    """Return a lens in Basalt's terms."""
    shape, linear = camera.intrinsics[:-4], camera.intrinsics[-4:]
    kind = _KINDS.get((camera.projection, camera.distortion))
    if kind is None or (kind == "ucm" and shape[0] < 0):
        knows = "Basalt knows pinhole with radtan, equidistant or no distortion, and ds, eucm and omni without"
        raise unknown_lens(name, camera, knows)
    own = np.concatenate([shape, camera.distortion_coeffs])
    own = np.append(own, np.zeros(len(_NAMES[kind]) - len(own)))  # of pinhole-radtan8 the last ones
    if kind == "ucm":  # Basalt divides by alpha rho + (1 - alpha) z, omni by xi rho + z
        scale = 1 + shape[0]
        own, linear = own / scale, linear / [scale, scale, 1, 1]
    values = dict(zip((*_LINEAR, *_NAMES[kind]), (*linear.tolist(), *own.tolist()), strict=True))
    if kind == "pinhole-radtan8":
        limit = camera.distortion_limit
        values["rpmax"] = limit if limit < _NO_LIMIT else 0.0
    return {"camera_type": kind, "intrinsics": values}


def _losses(calibration: Calibration) -> Iterator[Loss]:
    if not calibration.cameras:
        yield Loss(what="cameras", why="this calibration is of an IMU alone; Basalt needs at least one.")
        return
    yield Loss(what="time shift", why="Basalt counts whole nanoseconds: it was rounded.", size="at most 0.5 ns")
    for name, camera in calibration.cameras.items():
        if camera.camera.model in ("pinhole-radtan", "pinhole-radtan5"):
            yield Loss(
                what=f"camera_type of {name}",
                why="only newer versions of Basalt know pinhole-radtan8; the first ones know no radtan at all.",
            )
