"""The simulation of cameras before a board, without an IMU: views, exact corners, and what a detector has of them.

Each view has an attitude of its own; with `between` the board moves smoothly from one to the next. Corners, not images:
what is true of lenses, poses and board is in `CamerasSimulation`, so that images can be drawn of the same views.
"""

from collections.abc import Mapping

import numpy as np

from ..errors import OptionError
from ..frozen import FrozenMapping, value_class
from ..geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from ..models.camera import Booleans, Camera
from ..models.target import Target
from ..recording import CameraFrames, Floats, Integers, Recording
from ..results.calibration import Assessment, Calibration, CameraCalibration, CamerasFit
from ..units import STANDARD_GRAVITY_M_S2
from .camera_imu_rig import beside_the_whole
from .camera_imu_streams import BORDER_PX, START_NS
from .scenarios.cameras import CamerasScenario
from .sensor import true_calibration

_TILT_BETWEEN_CAMERAS = np.array([0.004, -0.012, 0.007])
_FOCAL_BETWEEN_CAMERAS = 1.004
_CENTRE_BETWEEN_CAMERAS_PX = np.array([2.5, -1.5])

_WHOLE = {"checkerboard", "circlegrid"}
"""Boards that are detected whole or not at all."""

_LEAST_SEEN = 0.4
"""Of the corners of the other boards: views that show less are not taken."""

_TRIES = 20
_TOWARDS_THE_MIDDLE = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0)
"""Share of the way from the middle of the image at which the board is tried."""

_ONE_TILT = np.array([0.35, 0.25, 0.1])
"""The attitude of all views with the attitude "one", a rotation vector [rad]."""


@value_class
class CornersTruth:
    """What is true of the corners of `CameraFrames`, in the same order.

    Attributes
    ----------
    pixels : (m, 2) exact corners [px], of images of full size
    outlier : (m,) whether the corner was detected in a wrong place
    """

    pixels: Floats
    outlier: Booleans


@value_class
class CamerasSimulation:
    """A recording of cameras before a board, and everything that is true of it.

    Attributes
    ----------
    scenario, seed : what was simulated
    recording : corners as a detector delivers them; resolutions are known, lenses are not
    target : the board, as its owner describes it
    truth : the cameras in frame "cam0", with zero covariance
    points : (k, 3) places of the board's points as they truly are, in the board's frame [m]
    t_ns : (v,) timestamp of each view [ns]
    R_cam0_target, p_cam0_target : (v, 3, 3) and (v, 3) pose of the board in cam0's frame [m]
    corners : "cam0", ... -> what is true of each corner
    blurred, resized : (v,) whether the view's corners are bad, whether its images are of half the size
    """

    scenario: CamerasScenario
    seed: int
    recording: Recording
    target: Target
    truth: Calibration
    points: Floats
    t_ns: Integers
    R_cam0_target: Floats
    p_cam0_target: Floats
    corners: Mapping[str, CornersTruth]
    blurred: Booleans
    resized: Booleans


def simulate_cameras(scenario: CamerasScenario | None = None, seed: int = 0) -> CamerasSimulation:
    """Make a recording of cameras that see a board in view after view, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Raises
    ------
    OptionError
        If the scenario's lens or board is impossible, or the board does not fit into the image.

    Examples
    --------
    >>> simulation = simulate_cameras(CamerasScenario(views=12), seed=1)
    >>> len(simulation.recording.cameras["cam0"].t_ns), simulation.truth.frame
    (12, 'cam0')
    """
    scenario = scenario or CamerasScenario()
    poses, board, views, *streams = np.random.default_rng(seed).spawn(3 + scenario.cameras)
    target, cameras = scenario.stated_board(), _cameras(scenario)
    points = _true_points(scenario, target, board)
    R, p = _drawn_poses(scenario, points, cameras, poses)
    count = scenario.views
    blurred = views.random(count) < scenario.blurred_views
    resized = views.random(count) < scenario.resized_views
    t_ns = START_NS + np.rint(np.arange(count) * 1e9 / scenario.rate_hz).astype(np.int64)
    recorded: dict[str, CameraFrames] = {}
    corners: dict[str, CornersTruth] = {}
    for i, ((name, camera), rng) in enumerate(zip(cameras.items(), streams, strict=True)):
        pixels, seen = _seen(points, R, p, camera)
        if target.kind in _WHOLE:
            seen &= seen.all(axis=1, keepdims=True)
        if not scenario.shared_views:
            seen[np.arange(count) % scenario.cameras != i] = False
        detected, outlier = _detected(scenario, pixels, blurred, rng)
        detected[resized] = (detected[resized] + 0.5) / 2 - 0.5
        frame, point = np.nonzero(seen)
        recorded[name] = CameraFrames(
            t_ns=t_ns,
            frame=frame,
            point=point,
            pixels=detected[seen],
            camera=Camera.nominal(scenario.resolution, camera.camera.topic),
        )
        corners[name] = CornersTruth(pixels=pixels[seen], outlier=outlier[seen])
    return CamerasSimulation(
        scenario=scenario,
        seed=seed,
        recording=Recording(imus={}, cameras=recorded),
        target=target,
        truth=_truth(scenario, seed, cameras, recorded),
        points=points,
        t_ns=t_ns,
        R_cam0_target=R,
        p_cam0_target=p,
        corners=FrozenMapping(corners),
        blurred=blurred,
        resized=resized,
    )


def _true_points(scenario: CamerasScenario, target: Target, rng: np.random.Generator) -> Floats:
    """Return where the points of the board truly are, (k, 3) [m]."""
    points = target.points
    middle, half = (points.max(axis=0) + points.min(axis=0))[:2] / 2, np.ptp(points, axis=0)[:2] / 2
    towards_viewer = (1 - ((points[:, :2] - middle) / half) ** 2) @ np.array(scenario.board_bow_m)
    shaped = points * np.array([1.0, 1 + scenario.board_aspect, 1.0]) + towards_viewer[:, None] * np.eye(3)[2]
    offsets = beside_the_whole(scenario.corner_offset_m * rng.standard_normal(points.shape), points)
    return scenario.target_scale * (shaped + offsets)


def _cameras(scenario: CamerasScenario) -> dict[str, CameraCalibration]:
    """Return the true cameras, each a little different from the one before."""
    found: dict[str, CameraCalibration] = {}
    for i in range(scenario.cameras):
        intrinsics = np.array(scenario.intrinsics)
        intrinsics[-4:-2] *= _FOCAL_BETWEEN_CAMERAS**i
        intrinsics[-2:] += i * _CENTRE_BETWEEN_CAMERAS_PX
        T = np.eye(4)
        T[:3, :3] = rotation_from_rotvec(i * _TILT_BETWEEN_CAMERAS)
        T[:3, 3] = T[:3, :3] @ np.array([-i * scenario.baseline_m, 0.0, 0.0])
        camera = Camera(
            projection=scenario.projection,
            intrinsics=intrinsics,
            distortion=scenario.distortion,
            distortion_coeffs=np.array(scenario.distortion_coeffs),
            resolution=scenario.resolution,
            topic=f"/cam{i}/image_raw",
        )
        found[f"cam{i}"] = CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=camera, body="cam0")
    return found


def _drawn_poses(
    scenario: CamerasScenario, points: Floats, cameras: Mapping[str, CameraCalibration], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return poses of the board in cam0's frame, (v, 3, 3) and (v, 3)."""
    count = -(-scenario.views // scenario.between)
    count += scenario.between > 1  # the last attitude is moved towards
    drawn = [_drawn_pose(scenario, points, cameras, rng) for _ in range(count)]
    R, middle = np.array([pose[0] for pose in drawn]), np.array([pose[1] for pose in drawn])
    if scenario.between > 1:
        at = np.arange(scenario.views) / scenario.between
        before, share = at.astype(np.int64), (at % 1)[:, None]
        turn = rotvec_from_rotation(R[before].swapaxes(1, 2) @ R[before + 1])
        turned = R[before] @ rotation_from_rotvec(share * turn)
        moved = (1 - share) * middle[before] + share * middle[before + 1]
        return turned, moved - turned @ _middle(points)
    return R, middle - R @ _middle(points)


def _middle(points: Floats) -> Floats:
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _drawn_pose(
    scenario: CamerasScenario, points: Floats, cameras: Mapping[str, CameraCalibration], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return R_cam0_target and the middle of the board in cam0's frame; draw until enough of the board is seen."""
    camera = cameras["cam0"].camera
    size, shared = np.array(camera.resolution), scenario.shared_views
    looked = list(cameras.values()) if shared else [cameras["cam0"]]
    needed = 1.0 if scenario.target_type in _WHOLE else _LEAST_SEEN
    focal = float(np.diff(camera.project(np.array([[0.0, 0.0, 1.0], [1e-6, 0.0, 1.0]])).pixels[:, 0])[0]) * 1e6
    for k in range(_TRIES):
        width = np.interp(rng.random() * (1 - k / _TRIES), [0, 1], scenario.fill)
        aside, draws = (size - 1) / 2 * scenario.spread * rng.uniform(-1, 1, 2), rng.random(3)
        for share in _TOWARDS_THE_MIDDLE:
            ray, valid = camera.unproject(((size - 1) / 2 + share * aside)[None])
            if not valid[0]:
                continue
            R = _attitude(scenario, ray[0], draws)
            middle = ray[0] * focal * np.ptp(points[:, :2], axis=0).max() / (width * size[0])
            p = middle - R @ _middle(points)
            if min(_seen(points, R[None], p[None], one)[1].mean() for one in looked) >= needed:
                return R, middle
    raise OptionError(
        f"no view was found in which the board is seen: fill {scenario.fill[0]:g} to {scenario.fill[1]:g} of the "
        "image's width may be too large for it. Give less fill, or less tilt_deg."
    )


def _attitude(scenario: CamerasScenario, ray: Floats, draws: Floats) -> Floats:
    """Return R_cam0_target (3, 3) of a board that is seen along a ray (3,), by random numbers (3,) from 0 to 1."""
    upright = _UPRIGHT_BY_ROWS if scenario.target_type == "checkerboard" else _UPRIGHT
    roll, tilt, way = 2 * draws[0] - 1, np.sqrt(draws[1]), 2 * np.pi * draws[2]
    if scenario.attitude == "facing":
        return upright.copy()
    if scenario.attitude == "one":
        return rotation_from_rotvec(_ONE_TILT) @ upright
    axis = np.cross([0.0, 0.0, 1.0], ray)
    facing = rotation_from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * np.arctan2(np.linalg.norm(axis), ray[2]))
    tilted = rotation_from_rotvec(np.radians(scenario.tilt_deg) * tilt * np.array([np.cos(way), np.sin(way), 0.0]))
    rolled = rotation_from_rotvec(np.radians(scenario.roll_deg) * roll * np.eye(3)[2])
    return facing @ tilted @ rolled @ upright


_UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""The board's x points to the right of the image, y up, z to the viewer."""

_UPRIGHT_BY_ROWS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Of a checkerboard, whose rows follow each other along x: x down, y right."""


def _seen(points: Floats, R: Floats, p: Floats, camera: CameraCalibration) -> tuple[Floats, Booleans]:
    """Return the exact pixels (v, k, 2), and which of them are in the image (v, k)."""
    T = camera.T_cam_body
    p_cam = (points @ R.swapaxes(1, 2) + p[:, None]) @ T[:3, :3].T + T[:3, 3]
    pixels = camera.camera.project(p_cam.reshape(-1, 3), point_jacobian=False).pixels.reshape(len(R), -1, 2)
    behind = np.einsum("vi,vi->v", R[:, :, 2], p) >= 0  # the viewer is on the board's side of positive z
    with np.errstate(invalid="ignore"):
        inside = (pixels >= BORDER_PX) & (pixels <= np.array(camera.camera.resolution) - 1 - BORDER_PX)
    return pixels, inside[..., 0] & inside[..., 1] & ~behind[:, None]


def _detected(
    scenario: CamerasScenario, pixels: Floats, blurred: Booleans, rng: np.random.Generator
) -> tuple[Floats, Booleans]:
    """Return where corners are detected (v, k, 2), and which of them are outliers (v, k)."""
    noise = rng.standard_normal(pixels.shape)
    bent = rng.standard_normal((len(pixels), len(_BENDS), 2))
    outlier = rng.random(pixels.shape[:2]) < scenario.outliers
    length = scenario.outlier_px * rng.uniform(0.5, 1.5, pixels.shape[:2])
    angle = rng.uniform(0, 2 * np.pi, pixels.shape[:2])
    wrong = length[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    sigma = np.where(blurred, scenario.blurred_px, scenario.pixel_noise_px)
    detected = pixels + sigma[:, None, None] * noise + np.where(outlier[..., None], wrong, 0.0)
    if scenario.view_bias_px:
        x, y = np.moveaxis(2 * pixels / np.array(scenario.resolution) - 1, -1, 0)
        shape = np.stack([x**i * y**j for i, j in _BENDS], axis=-1) @ bent  # (v, k, 2)
        shape -= np.nanmean(shape, axis=1, keepdims=True)
        detected += scenario.view_bias_px * shape / np.sqrt(np.nanmean(shape**2, axis=(1, 2), keepdims=True))
    return np.clip(detected, 0.0, np.array(scenario.resolution) - 1.0), outlier


_BENDS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y that the errors of one view are made of."""


def _truth(
    scenario: CamerasScenario, seed: int, cameras: dict[str, CameraCalibration], recorded: dict[str, CameraFrames]
) -> Calibration:
    used = {name: len(np.unique(frames.frame)) for name, frames in recorded.items()}
    return true_calibration(
        scenario,
        seed,
        cameras=cameras,
        frame="cam0",
        gravity_m_s2=STANDARD_GRAVITY_M_S2,
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model=" ".join(dict.fromkeys(camera.camera.model for camera in cameras.values())),
            cameras=CamerasFit(
                views_found=used,
                views_used=used,
                corners_used={name: len(frames.frame) for name, frames in recorded.items()},
                reprojection_rms_px=dict.fromkeys(recorded, scenario.pixel_noise_px),
                holdout_rms_px=dict.fromkeys(recorded, scenario.pixel_noise_px),
                coverage=dict.fromkeys(recorded, float("nan")),
                models={name: (camera.camera.model,) for name, camera in cameras.items()},
                aspect=scenario.board_aspect,
                bow_m=max(scenario.board_bow_m, key=abs),
                print_scale=scenario.target_scale,
                print_scale_sigma=0.0,
            ),
        ),
    )
