"""Corners of a board in random poses, seen by cameras that are known: what tests of camera calibration start from."""

from collections.abc import Mapping

import numpy as np

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames

BOARD = Target.aprilgrid(tag_cols=4, tag_rows=4, tag_size_m=0.088, tag_spacing=0.3)
STEP_NS = 100_000_000

_LENSES = {
    "pinhole-none": ([460, 458, 367, 248], []),
    "pinhole-radtan": ([460, 458, 367, 248], [-0.28, 0.07, 2e-4, -3e-4]),
    "pinhole-radtan5": ([460, 458, 367, 248], [-0.30, 0.1, 2e-4, -3e-4, -0.015]),
    "pinhole-equidistant": ([380, 379, 370, 255], [-0.01, 0.02, -0.01, 0.002]),
    "pinhole-fov": ([380, 379, 370, 255], [0.9]),
    "omni-none": ([1.1, 620, 618, 370, 250], []),
    "omni-radtan": ([1.1, 450, 449, 370, 250], [-0.1, 0.02, 2e-4, -3e-4]),
    "eucm-none": ([0.66, 1.05, 200, 199, 370, 250], []),
    "ds-none": ([-0.2, 0.58, 240, 239, 370, 250], []),
}
MODELS = tuple(_LENSES)


def lens(model: str) -> Camera:
    """Return a typical lens of a model; eucm-none sees more than 180 degrees."""
    projection, distortion = model.split("-")
    intrinsics, coeffs = _LENSES[model]
    return Camera(
        projection=projection,
        intrinsics=np.array(intrinsics, float),
        distortion=distortion,
        distortion_coeffs=np.array(coeffs, float),
        resolution=(752, 480),
    )


def pose(rotvec, translation) -> np.ndarray:
    """Return a pose (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rotvec(np.array(rotvec, float)), translation
    return T


def seen(
    cameras: Mapping[str, Camera],
    T_cam_cam0: np.ndarray,
    views: int,
    seed: int,
    *,
    target: Target = BOARD,
    points: np.ndarray | None = None,
    sigma_px: float = 0.2,
    fewest: int = 10,
    tilt: float = 0.7,
    common_px: float = 0.0,
) -> dict[str, CameraFrames]:
    """Return what cameras see of a board that is shown to one of them after the other.

    Parameters
    ----------
    points : where the board's points truly are; where the target says if not given
    fewest : corners of a frame
    tilt : of the board, at most, about each of its axes [rad]
    common_px : standard deviation of an error that all corners of a frame share, a smooth field over the image
    """
    rng = np.random.default_rng(seed)
    where = target.points if points is None else points
    names, found = list(cameras), {name: [] for name in cameras}
    count = 0
    while count < views:
        shown = int(rng.integers(len(names)))
        T = np.linalg.inv(T_cam_cam0[shown]) @ _shown(rng, cameras[names[shown]], target, tilt)
        frames = {name: _frame(camera, T_cam_cam0[k] @ T, where) for k, (name, camera) in enumerate(cameras.items())}
        if all(len(point) < fewest for point, _ in frames.values()):
            continue
        for name, (point, pixels) in frames.items():
            if len(point) >= fewest:
                noise = sigma_px * rng.standard_normal(pixels.shape) + common_px * _field(rng, pixels)
                found[name].append((count, point, pixels + noise))
        count += 1
    t_ns = np.arange(views) * STEP_NS
    return {name: _frames(t_ns, rows, cameras[name]) for name, rows in found.items()}


def _shown(rng, camera: Camera, target: Target, tilt: float) -> np.ndarray:
    width, height = camera.resolution
    rays, valid = camera.unproject(rng.uniform(0.1, 0.9, (20, 2)) * (width, height))
    ray = rays[valid][0]
    normal = -ray
    x = np.cross([0.0, -1.0, 0.0], normal)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(normal, x), normal], axis=1)
    R = R @ rotation_from_rotvec(rng.uniform(-1, 1, 3) * (tilt, tilt, 0.5))
    distance = max(target.size_m) / (2 * np.tan(rng.uniform(0.2, 0.5)))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, ray * distance - R @ target.points.mean(axis=0)
    return T


def _frame(camera: Camera, T: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    placed = points @ T[:3, :3].T + T[:3, 3]
    image = camera.project(placed, point_jacobian=False)
    with np.errstate(invalid="ignore"):
        inside = ((image.pixels > 0) & (image.pixels < np.array(camera.resolution) - 1)).all(axis=1)
    facing = placed @ T[:3, 2] < -0.15 * np.linalg.norm(placed, axis=1)
    visible = np.flatnonzero(image.valid & inside & facing)
    return visible, image.pixels[visible]


def _field(rng, pixels: np.ndarray) -> np.ndarray:
    """Return an error of each corner that varies slowly over the image, another field for each frame."""
    x, y = (pixels / 400 - 1).T
    columns = np.stack([np.sin(2 * x), np.sin(2 * y), x * y, x * x - y * y], axis=1)
    return columns @ rng.standard_normal((4, 2))


def _frames(t_ns: np.ndarray, rows: list, camera: Camera) -> CameraFrames:
    empty = [(0, np.empty(0, np.int64), np.empty((0, 2)))]
    rows = rows or empty
    return CameraFrames(
        t_ns=t_ns,
        frame=np.concatenate([np.full(len(point), frame) for frame, point, _ in rows]),
        point=np.concatenate([point for _, point, _ in rows]),
        pixels=np.concatenate([pixels for *_, pixels in rows]),
        camera=Camera.nominal(camera.resolution),
    )
