"""The cameras of gnomon's own calibration file, from schema "gnomon/1.1" on; without an IMU from "gnomon/1.4" on."""

import math
from typing import get_args

import numpy as np

from ...calibration import CameraCalibration, CameraImuFit, CamerasFit
from ...errors import OptionError
from ...models.camera import Camera
from ...models.lens_names import DistortionName, ProjectionName
from ...recording import Floats
from ..structured import Node

SIGMAS = {
    "T_cam_imu.rotation": "T_cam_imu_rotation_sigma",
    "T_cam_imu.translation": "T_cam_imu_translation_sigma",
    "T_cam_cam0.rotation": "T_cam_cam0_rotation_sigma",
    "T_cam_cam0.translation": "T_cam_cam0_translation_sigma",
    "time_shift_cam_imu": "time_shift_cam_imu_sigma",
    "line_delay": "line_delay_sigma",
    "intrinsics": "intrinsics_sigma",
    "distortion_coeffs": "distortion_coeffs_sigma",
}
"""Parameter of a camera -> the key of its standard deviation."""

VIEW_COUNTS = ("views_found", "views_used", "corners_used")
VIEW_NUMBERS = ("reprojection_rms_px", "holdout_rms_px", "coverage")
BOARD_NUMBERS = ("aspect", "aspect_sigma", "bow_m", "bow_sigma_m", "print_scale", "print_scale_sigma")
"""Keys of what a calibration of cameras alone rests on, of each camera and of the board, as in `CamerasFit`."""

_LENS = (
    "camera_model",
    "intrinsics",
    "distortion_model",
    "distortion_coeffs",
    "resolution",
    "line_delay",
    "rostopic",
)


_LENS_SIGMAS = ("intrinsics_sigma", "distortion_coeffs_sigma")


def camera_entry(node: Node, *, alone: bool = False) -> CameraCalibration:
    """Return one camera, of cameras alone its pose to cam0.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    if alone:
        pose = () if node.key == "cam0" else ("T_cam_cam0",)
        sigmas = tuple(f"{name}_{part}_sigma" for name in pose for part in ("rotation", "translation"))
        keys = node.mapping((*pose, *_LENS), (*sigmas, *_LENS_SIGMAS))
        T = pose_entry(keys["T_cam_cam0"]) if pose else np.eye(4)
        return CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=_lens(node, keys), body="cam0")
    sigmas = tuple(key for name, key in SIGMAS.items() if not name.startswith("T_cam_cam0"))
    keys = node.mapping(("T_cam_imu", "time_shift_cam_imu", *_LENS), sigmas)
    return CameraCalibration(
        T_cam_body=pose_entry(keys["T_cam_imu"]),
        time_shift_cam_imu=keys["time_shift_cam_imu"].number(),
        camera=_lens(node, keys),
    )


def _lens(node: Node, keys: dict[str, Node]) -> Camera:
    width, height = (item.integer() for item in _pair(keys["resolution"]))
    try:
        return Camera(
            projection=keys["camera_model"].text(get_args(ProjectionName)),  # pyright: ignore[reportArgumentType]
            intrinsics=_numbers(keys["intrinsics"]),
            distortion=keys["distortion_model"].text(get_args(DistortionName)),  # pyright: ignore[reportArgumentType]
            distortion_coeffs=_numbers(keys["distortion_coeffs"]),
            resolution=(width, height),
            line_delay_s=keys["line_delay"].number(),
            topic=keys["rostopic"].text(),
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def _numbers(node: Node) -> Floats:
    return np.array([item.number() for item in node.items()], dtype=np.float64)


def _pair(node: Node) -> list[Node]:
    items = list(node.items())
    if len(items) != 2:
        raise node.fail(f"found {len(items)} numbers, expected width and height.")
    return items


def pose_entry(node: Node) -> Floats:
    """Return a pose (4, 4).

    Raises
    ------
    FormatError
        If it is none.
    """
    matrix = node.floats(4, 4)
    rotation = matrix[:3, :3]
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise node.fail("the last row of a pose is [0.0, 0.0, 0.0, 1.0].")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise node.fail("its first three rows and columns are no rotation matrix.")
    return matrix


def camera_imu_entry(node: Node, cameras: tuple[str, ...]) -> CameraImuFit:
    """Return what a camera-IMU calibration rests on; there is an entry for each of the cameras.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    keys = node.mapping(("duration_s", "converged", "cameras"))
    if not isinstance(keys["converged"].value, bool):
        raise keys["converged"].fail("expected true or false.")
    counts = ("frames_found", "frames_used", "corners_used")
    entries = {
        name: entry.mapping((*counts, "reprojection_rms_px"))
        for name, entry in keys["cameras"].mapping(cameras).items()
    }
    found, used, corners = ({name: entry[count].integer() for name, entry in entries.items()} for count in counts)
    return CameraImuFit(
        frames_found=found,
        frames_used=used,
        corners_used=corners,
        reprojection_rms_px={name: _known(entry["reprojection_rms_px"]) for name, entry in entries.items()},
        duration_s=keys["duration_s"].number(),
        converged=keys["converged"].value,
    )


def cameras_entry(node: Node, cameras: tuple[str, ...]) -> CamerasFit:
    """Return what a calibration of cameras alone rests on; there is an entry for each of the cameras.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    keys = node.mapping(("converged", "board", "cameras"))
    if not isinstance(keys["converged"].value, bool):
        raise keys["converged"].fail("expected true or false.")
    board = keys["board"].mapping(("added", *BOARD_NUMBERS))
    entries = {
        name: entry.mapping((*VIEW_COUNTS, *VIEW_NUMBERS, "models"))
        for name, entry in keys["cameras"].mapping(cameras).items()
    }

    def counts(key: str) -> dict[str, int]:
        return {name: entry[key].integer() for name, entry in entries.items()}

    def numbers(key: str) -> dict[str, float]:
        return {name: _known(entry[key]) for name, entry in entries.items()}

    return CamerasFit(
        views_found=counts("views_found"),
        views_used=counts("views_used"),
        corners_used=counts("corners_used"),
        reprojection_rms_px=numbers("reprojection_rms_px"),
        holdout_rms_px=numbers("holdout_rms_px"),
        coverage=numbers("coverage"),
        models={name: tuple(item.text() for item in entry["models"].items()) for name, entry in entries.items()},
        board_added=tuple(item.text() for item in board["added"].items()),
        aspect=_known(board["aspect"]),
        aspect_sigma=_known(board["aspect_sigma"]),
        bow_m=_known(board["bow_m"]),
        bow_sigma_m=_known(board["bow_sigma_m"]),
        print_scale=_known(board["print_scale"]),
        print_scale_sigma=_known(board["print_scale_sigma"]),
        converged=keys["converged"].value,
    )


def _known(node: Node) -> float:
    return math.nan if node.value is None else node.number()
