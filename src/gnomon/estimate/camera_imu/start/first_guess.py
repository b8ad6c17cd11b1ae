"""The start of the batch estimation, found from the measurements alone: solver design, automatic initial guess.

board poses -> time shift, rotation between camera and IMU, gyroscope bias -> knots -> trajectory -> gravity

Where the IMU is in the camera's frame: the camera's own acceleration a is told by its positions
(`camera_accelerations`). The place r of the IMU, seen from the camera, gravity g and the accelerometer's bias b are
fitted in

    f = R_cam_imu' R_cam_target (a - g) + A r + b,     A = [alpha]x + [omega]x^2 by the gyroscope,

with f and A averaged as the second difference averages. From there the batch estimation starts nearer: a metre off,
where the rig is shaken, readings are wrong by thousands of their sigmas.

The first trajectory are the attitudes of the camera, joined by the gyroscope, and its positions, as splines. The stream
is cut where the IMU has a gap that the splines cannot bridge, trimmed to where the board was seen, and cut again where
a rotation vector would come near a full turn from the segment's reference attitude.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ....errors import InitialisationError, OptionError
from ....frozen import value_class
from ....geometry.rotations import (
    nearest_branch,
    rk4n_steps,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotvec_from_rotation,
    running_products,
    skew,
    unwrap_rotvecs,
)
from ....models.origin import Origin
from ....models.target import Target
from ....options import CameraImuOptions
from ....recording import CameraFrames, Floats
from ....solve.factorisation import solve_banded
from ..batch import RigState
from ..choices import estimation_choices, kept_or_prior, wants_k3
from ..layout import Status
from ..parameters import BoardPoints, CameraParameters, ImuParameters, RigParameters, gravity_axes
from ..terms.inertial_terms import InertialData
from ..terms.visual_terms import Exposures
from ..trajectory import BIAS, MARGIN_S, KnotGrid, Segment, Trajectory, bspline_basis
from .alignment import Alignment, align_camera, gyroscope_integral
from .board_poses import BoardPoses, averaged_derivative, averaged_readings, board_poses, camera_accelerations

_BAD_FRAME = 5.0
"""Frames whose pose fits worse than the median by this factor do not guide the first trajectory."""

_FEWEST_ACCELERATIONS = 10

_ONE_AXIS = 0.1
"""Ratio of the second to the first principal rate below which the rotation is about one axis only."""
_FEWEST = 20  # frames with an acceleration
_ROUNDS, _ROBUST = 3, 3.0
_USUAL = np.array([1.0] * 3 + [np.inf] * 3 + [5.0] * 3)
"""Place [m], gravity and bias [m/s^2] as they are without any measurement."""

_GUIDE_S = 0.1  # from one rotation vector to the next where their branch is followed
_LARGEST_ANGLE = 4.5  # rad from the reference attitude; the chart ends at 2 pi
_WIDEST_GAP = 3.0  # knot spacings without IMU samples that the splines bridge
_FEWEST_FRAMES = 5
_SHORTEST_S = 0.5


@value_class
class CameraAlignment:
    """What one camera saw, and how it lies to the IMU.

    Attributes
    ----------
    name, frames : of the camera
    poses : of the board
    alignment : to the IMU
    target : the board
    """

    name: str
    frames: CameraFrames
    poses: BoardPoses
    alignment: Alignment
    target: Target


@value_class
class ImuStream:
    """Gyroscope and accelerometer of an IMU on one time base, for the first guess only.

    Attributes
    ----------
    t_s : (n,) timestamps of the gyroscope [s]
    rate : (n, 3) [rad/s]
    force : (n, 3) [m/s^2], interpolated where the accelerometer has other timestamps
    """

    t_s: Floats
    rate: Floats
    force: Floats


def imu_stream(inertial: tuple[InertialData, ...], imu: int = 0) -> ImuStream:
    """Return the readings of an IMU at the timestamps of its gyroscope."""
    gyroscope = next(data for data in inertial if data.imu == imu and data.gyroscope is not None)
    accelerometer = next(data for data in inertial if data.imu == imu and data.accelerometer is not None)
    assert gyroscope.gyroscope is not None
    assert accelerometer.accelerometer is not None
    force = accelerometer.accelerometer.values
    if accelerometer is not gyroscope:
        force = np.stack([np.interp(gyroscope.t_s, accelerometer.t_s, force[:, i]) for i in range(3)], axis=1)
    return ImuStream(t_s=gyroscope.t_s, rate=gyroscope.gyroscope.values, force=force)


def align_cameras(
    cameras: Mapping[str, CameraFrames], target: Target, origin_ns: int, stream: ImuStream
) -> tuple[CameraAlignment, ...]:
    """Find the board in every frame, and every camera's clock and axes.

    Parameters
    ----------
    cameras : by name
    target : the board
    origin_ns : where the seconds of the cameras' timestamps start, of each camera's own clock too [ns]
    stream : of the IMU

    Raises
    ------
    InitialisationError
        If a camera cannot be aligned and has no stated guess.
    """
    integral = gyroscope_integral(stream.t_s, stream.rate)
    found: list[CameraAlignment] = []
    for name, frames in cameras.items():
        poses = board_poses(frames, target, np.asarray((frames.t_ns - origin_ns) * 1e-9, dtype=np.float64))
        try:
            alignment = align_camera(poses, integral, name)
        except InitialisationError:
            if frames.T_cam_imu is None or not len(poses):
                raise
            alignment = _as_stated(frames, poses)
            t_s = poses.t_s + alignment.time_shift_s
            if not np.any((t_s >= stream.t_s[0]) & (t_s <= stream.t_s[-1])):
                raise  # why it cannot be found says more than that what was stated is wrong, too
        else:
            stated = None if frames.T_cam_imu is None else frames.T_cam_imu[:3, :3]
            alignment = align_with_gravity(alignment, poses, stream, stated)
        found.append(CameraAlignment(name=name, frames=frames, poses=poses, alignment=alignment, target=target))
    return tuple(found)


def _as_stated(frames: CameraFrames, poses: BoardPoses) -> Alignment:
    assert frames.T_cam_imu is not None
    return Alignment(
        time_shift_s=frames.time_shift_cam_imu_s or 0.0,
        R_cam_imu=frames.T_cam_imu[:3, :3],
        gyroscope_bias=np.zeros(3),
        rate_scale=1.0,
        score=0.0,
        axes=np.zeros(3),
        directions=np.eye(3),
        consistent=np.ones(len(poses), dtype=bool),
    )


def align_with_gravity(
    alignment: Alignment, poses: BoardPoses, stream: ImuStream, R_stated: Floats | None = None
) -> Alignment:
    """Where the rotation was about one axis, find the angle about it from the specific force, unless it is stated.

    The camera's own acceleration (`camera_acceleration`) and the accelerometer, averaged as that is, are compared in
    the camera's axes, less their means, so that a bias does not matter.
    """
    if alignment.axes[1] > _ONE_AXIS * alignment.axes[0]:
        return alignment
    if R_stated is not None:
        return replace(alignment, R_cam_imu=R_stated)
    centre, acceleration, at_s = camera_accelerations(poses, alignment.time_shift_s)
    if len(centre) < _FEWEST_ACCELERATIONS:
        raise InitialisationError(
            f"the rig turned about one axis only, and {len(centre)} frames with the board have one just before and one "
            "just after them, too few to tell the camera's angle about that axis. Turn about all three axes, or state "
            "T_cam_imu in camchain.yaml."
        )
    R_cam_target = poses.R_cam_target[centre]
    force = averaged_readings(at_s, stream.t_s, stream.force)
    turns = rotvec_from_rotation(poses.R_cam_target[:-1] @ np.swapaxes(poses.R_cam_target[1:], 1, 2))
    axis = np.linalg.eigh(turns.T @ turns)[1][:, -1]
    best, least = alignment.R_cam_imu, np.inf
    for angle in np.arange(120) * np.radians(3.0):
        R = rotation_from_rotvec(angle * axis) @ alignment.R_cam_imu
        seen = force @ R.T
        gravity = (acceleration - np.einsum("nji,nj->ni", R_cam_target, seen)).mean(axis=0)
        error = seen - np.einsum("nij,nj->ni", R_cam_target, acceleration - gravity)
        scatter = float(np.var(error, axis=0).sum())
        if scatter < least:
            best, least = R, scatter
    return replace(alignment, R_cam_imu=best)


def per_corner(exposures: Exposures) -> Exposures:
    """Return exposures of single corners, each at the time of its own image row (rolling shutter)."""
    count = len(exposures.points)
    return Exposures(
        frame=np.repeat(exposures.frame, np.diff(exposures.start)),
        start=np.arange(count + 1),
        points=exposures.points,
        pixels=exposures.pixels,
        delay_rows=exposures.pixels[:, 1].copy(),
        spread=exposures.spread,
        point=exposures.point,
    )


def first_parameters(
    found: tuple[CameraAlignment, ...],
    gravity_m_s2: float,
    options: CameraImuOptions,
    imus: Sequence[ImuParameters] = (ImuParameters.ideal(),),
    places: Sequence[Floats] = (),
) -> RigParameters:
    """Return the constant parameters to start from; gravity's direction follows with the trajectory.

    What was stated of the cameras is taken where it shall be kept, or has a stated prior about it. Of the others
    `places` tells p_cam_imu (3,) [m], where given.

    Raises
    ------
    OptionError
        If something shall be kept, or has a prior, that was not stated.
    """
    start = RigParameters(
        gravity_axes=gravity_axes(np.array([0.0, 0.0, -1.0])),
        gravity_m_s2=gravity_m_s2,
        target_scale=1.0,
        board=BoardPoints.nominal(found[0].target) if found else None,
        imus=tuple(replace(imu, origin=Origin.stated(options.origin)) for imu in imus),
        cameras=tuple(
            CameraParameters(
                name=look.name,
                R_cam_imu=look.alignment.R_cam_imu,
                p_cam_imu=places[i] if places else np.zeros(3),
                time_shift_s=look.alignment.time_shift_s,
                camera=look.frames.camera,
                lens_covariance=look.frames.lens_covariance,
            )
            for i, look in enumerate(found)
        ),
    )
    named = [entry.with_k3() if wants_k3(entry.name, options) else entry for entry in start.cameras]
    start = replace(start, cameras=tuple(named))
    status = estimation_choices(start, options).status
    cameras = [_with_stated(entry, look.frames, status) for entry, look in zip(start.cameras, found, strict=True)]
    return replace(start, cameras=tuple(cameras))


def _with_stated(entry: CameraParameters, frames: CameraFrames, status: dict[str, Status]) -> CameraParameters:
    """Return a camera with its stated extrinsics and time shift where these are kept or have a prior."""

    def kept(block: str, stated: bool) -> bool:
        """Tell whether any scalar of a block is kept or has a prior, which something stated is needed for."""
        name = f"{entry.name}.{block}"
        if not kept_or_prior(status, name):
            return False
        if not stated:
            raise OptionError(
                f"{name} shall be kept, or has a prior, but camchain.yaml states none for {entry.name}: add "
                f"{'timeshift_cam_imu' if block == 'time_shift_cam_imu' else 'T_cam_imu'} there."
            )
        return True

    T, shift = frames.T_cam_imu, frames.time_shift_cam_imu_s
    if kept("T_cam_imu.rotation", T is not None) and T is not None:
        entry = replace(entry, R_cam_imu=T[:3, :3])
    if kept("T_cam_imu.translation", T is not None) and T is not None:
        entry = replace(entry, p_cam_imu=T[:3, 3])
    if kept("time_shift_cam_imu", shift is not None) and shift is not None:
        entry = replace(entry, time_shift_s=shift)
    return entry


@value_class
class ImuPath:
    """Attitude and position of the IMU at its timestamps, roughly.

    Attributes
    ----------
    t_s : (n,) [s]
    R : (n, 3, 3) R_target_imu
    position : (n, 3) [m], target frame
    """

    t_s: Floats
    R: Floats
    position: Floats


def imu_path(t_s: Floats, omega: Floats, frame_t_s: Floats, frame_R: Floats, frame_p: Floats) -> ImuPath:
    """Join the attitudes at frames by the gyroscope, and the positions by straight lines.

    Parameters
    ----------
    t_s : (n,) timestamps of the IMU [s]
    omega : (n, 3) gyroscope less its bias [rad/s]
    frame_t_s : (m,) timestamps of frames on the IMU's clock [s]
    frame_R : (m, 3, 3) R_target_imu at frames
    frame_p : (m, 3) position of the IMU at frames [m]
    """
    steps = rk4n_steps(omega[:-1], omega[1:], np.diff(t_s))
    products = running_products(steps, np.array([len(steps)]))
    turned = rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))
    before = np.clip(np.searchsorted(t_s, frame_t_s, side="right") - 1, 0, len(t_s) - 1)
    at_frame = turned[before] @ rotation_from_rotvec(omega[before] * (frame_t_s - t_s[before])[:, None])
    correction = frame_R @ np.swapaxes(at_frame, 1, 2)  # from integrated to true, drifting slowly
    between = rotvec_from_rotation(np.swapaxes(correction[:-1], 1, 2) @ correction[1:])
    k = np.clip(np.searchsorted(frame_t_s, t_s, side="right") - 1, 0, len(frame_t_s) - 2)
    share = np.clip((t_s - frame_t_s[k]) / (frame_t_s[k + 1] - frame_t_s[k]), 0.0, 1.0)
    R = correction[k] @ rotation_from_rotvec(share[:, None] * between[k]) @ turned
    position = np.stack([np.interp(t_s, frame_t_s, frame_p[:, i]) for i in range(3)], axis=1)
    return ImuPath(t_s=t_s, R=R, position=position)


def initial_trajectory(
    path: ImuPath, frame_t_s: Floats, knots_per_s: float, *, order: int, gyroscope_biases: Sequence[Floats]
) -> Trajectory:
    """Return splines through a path.

    Parameters
    ----------
    path : attitude and position at the IMU's timestamps
    frame_t_s : (m,) when the board was seen, on the IMU's clock [s], ascending
    knots_per_s, order : of the splines
    gyroscope_biases : of each IMU, (3,) [rad/s]

    Raises
    ------
    InitialisationError
        If nowhere board and IMU were recorded together for half a second.
    """
    spacing = 1 / knots_per_s
    spans = _usable_spans(path.t_s, frame_t_s, spacing)
    pieces = [piece for start, stop in spans for piece in _charted(path, start, stop)]
    if not pieces:
        raise InitialisationError(
            f"nowhere are there {_FEWEST_FRAMES} frames with the board and the IMU's samples within "
            f"{_SHORTEST_S:g} s. Check that both streams are of one recording."
        )
    segments: list[Segment] = []
    controls: list[Floats] = []
    first = 0
    for piece in pieces:
        start, stop = piece.start_s, piece.stop_s
        count = max(1, int(np.ceil((stop - start) / spacing - 1e-6)))
        inside = (path.t_s >= start - 1e-9) & (path.t_s <= stop + 1e-9)
        phi = _rotation_vectors(path, inside, piece)
        values = np.concatenate([phi, path.position[inside]], axis=1)
        position = np.clip((path.t_s[inside] - start) / spacing, 0.0, count - 1e-9)
        segments.append(Segment(start_s=start, spans=count, first=first, R_reference=piece.R_reference))
        pose = fitted_splines(position, values, count, order)
        biases = np.zeros((len(pose), BIAS * len(gyroscope_biases)))
        for imu, bias in enumerate(gyroscope_biases):
            biases[:, BIAS * imu : BIAS * imu + 3] = bias
        controls.append(np.concatenate([pose, biases], axis=1))
        first += count + order - 1
    grid = KnotGrid(segments=tuple(segments), spacing_s=spacing, order=order)
    return Trajectory(grid=grid, controls=np.concatenate(controls))


def _usable_spans(t_s: Floats, frame_t_s: Floats, spacing: float) -> list[tuple[float, float]]:
    """Return from when to when the IMU has no wide gap and the board was seen often enough."""
    step = np.diff(t_s)
    cuts = np.flatnonzero(step > max(_WIDEST_GAP * spacing, 2.5 * float(np.median(step)))) + 1
    spans: list[tuple[float, float]] = []
    for part in np.split(t_s, cuts):
        seen = frame_t_s[(frame_t_s >= part[0]) & (frame_t_s <= part[-1])]
        if len(seen) < _FEWEST_FRAMES or seen[-1] - seen[0] < _SHORTEST_S:
            continue
        spans.append((max(float(part[0]), float(seen[0]) - MARGIN_S), min(float(part[-1]), float(seen[-1]) + MARGIN_S)))
    return spans


@value_class
class _Piece:
    """A piece of the path: from when to when, its reference attitude, and its rotation vectors here and there."""

    start_s: float
    stop_s: float
    R_reference: Floats
    guide_t_s: Floats
    guide: Floats


def _charted(path: ImuPath, start: float, stop: float) -> list[_Piece]:
    """Return pieces whose rotation vectors stay far from a full turn about their reference attitudes."""
    inside = np.flatnonzero((path.t_s >= start - 1e-9) & (path.t_s <= stop + 1e-9))
    rate = (len(inside) - 1) / max(stop - start, 1e-9)
    thin = np.unique(np.append(inside[:: max(1, int(_GUIDE_S * rate))], inside[-1]))
    candidates = path.R[thin[:: max(1, len(thin) // 40)]]
    relative = np.swapaxes(candidates, 1, 2)[None] @ path.R[thin][:, None]
    vectors = unwrap_rotvecs(rotvec_from_rotation(relative))
    angles = np.linalg.norm(vectors, axis=-1).max(axis=0)
    best = int(np.argmin(angles))
    if angles[best] < _LARGEST_ANGLE or stop - start < 2 * _SHORTEST_S:
        return [
            _Piece(
                start_s=start,
                stop_s=stop,
                R_reference=candidates[best],
                guide_t_s=path.t_s[thin],
                guide=vectors[:, best],
            )
        ]
    middle = 0.5 * (start + stop)
    return _charted(path, start, middle) + _charted(path, middle, stop)


def _rotation_vectors(path: ImuPath, inside: np.ndarray, piece: _Piece) -> Floats:
    """Return continuous rotation vectors from the reference attitude, (n, 3)."""
    phi = rotvec_from_rotation(piece.R_reference.T @ path.R[inside])
    t_s = path.t_s[inside]
    guide = np.stack([np.interp(t_s, piece.guide_t_s, piece.guide[:, i]) for i in range(3)], axis=1)
    return nearest_branch(phi, guide)


def fitted_splines(position: Floats, values: Floats, spans: int, order: int) -> Floats:
    """Return control points (spans + order - 1, m) of splines near values (n, m) at positions (n,) in spans."""
    count = spans + order - 1
    first = np.minimum(position.astype(np.int64), spans - 1)
    weights = bspline_basis(order, position - first)
    banded, right = np.zeros((order, count)), np.zeros((count, values.shape[1]))
    for i in range(order):
        for j in range(i, order):
            banded[j - i] += np.bincount(first + i, weights[:, i] * weights[:, j], count)
        for axis in range(values.shape[1]):
            right[:, axis] += np.bincount(first + i, weights[:, i] * values[:, axis], count)
    # Third differences are held small where no sample is near; of what the samples show it changes nothing.
    third = np.array([-1.0, 3.0, -3.0, 1.0]) * 1e-3
    for i in range(min(4, count)):
        for j in range(i, 4):
            banded[j - i, i : count - 3 + i] += third[i] * third[j]
    return solve_banded(banded, right)


def first_state(
    found: tuple[CameraAlignment, ...],
    parameters: RigParameters,
    stream: ImuStream,
    knots_per_s: float,
    *,
    order: int,
    others: Sequence[Floats] = (),
) -> RigState:
    """Return trajectory and gravity for given extrinsics and time shifts.

    Parameters
    ----------
    stream : of the first IMU
    others : biases (3,) of the gyroscopes of the other IMUs [rad/s]

    Raises
    ------
    InitialisationError
        If board and IMU were nowhere recorded together.
    """
    guide = max(range(len(found)), key=lambda i: int(found[i].alignment.consistent.sum()))
    look, entry = found[guide], parameters.cameras[guide]
    poses = look.poses
    t_s = poses.t_s + entry.time_shift_s
    good = look.alignment.consistent & ~(poses.scatter_px > _BAD_FRAME * np.median(poses.scatter_px))
    good &= (t_s >= stream.t_s[0]) & (t_s <= stream.t_s[-1])
    if good.sum() < 2:
        raise InitialisationError(
            f"{look.name}: only {int(good.sum())} frames with the board lie within the IMU's recording. "
            "Check that camera and IMU were recorded together, in one go."
        )
    R = np.swapaxes(poses.R_cam_target, 1, 2) @ entry.R_cam_imu
    p = np.einsum("nji,nj->ni", poses.R_cam_target, entry.p_cam_imu - poses.p_cam_target)
    bias = look.alignment.gyroscope_bias
    path = imu_path(stream.t_s, stream.rate - bias, t_s[good], R[good], p[good])
    seen = np.sort(
        np.concatenate(
            [one.poses.t_s + camera.time_shift_s for one, camera in zip(found, parameters.cameras, strict=True)]
        )
    )
    trajectory = initial_trajectory(path, seen, knots_per_s, order=order, gyroscope_biases=(bias, *others))
    gravity = _gravity(path, stream, t_s[good])
    return RigState(trajectory=trajectory, parameters=replace(parameters, gravity_axes=gravity_axes(gravity)))


def _gravity(path: ImuPath, stream: ImuStream, seen_s: Floats) -> Floats:
    """Return minus the mean specific force in the target's frame: the mean acceleration of a wave is nearly zero."""
    nearest = np.clip(np.searchsorted(stream.t_s, seen_s), 0, len(stream.t_s) - 1)
    return -np.einsum("nij,nj->i", path.R[nearest], stream.force[nearest]) / len(nearest)


def first_place(alignment: Alignment, poses: BoardPoses, stream: ImuStream, delay_s: float = 0.0) -> Floats:
    """Return p_cam_imu (3,) [m], drawn to zero where the recording hardly tells it.

    Parameters
    ----------
    alignment, poses : of the camera
    stream : of the IMU
    delay_s : t_gyroscope - t_accelerometer of the timestamps of one instant
    """
    centre, acceleration, at_s = camera_accelerations(poses, alignment.time_shift_s)
    good = alignment.consistent[centre] & (at_s[:, 0] >= stream.t_s[0]) & (at_s[:, -1] <= stream.t_s[-1])
    if good.sum() < _FEWEST:
        return np.zeros(3)
    at_s = at_s[good]
    R = alignment.R_cam_imu.T @ poses.R_cam_target[centre[good]]
    columns = np.concatenate([_by_place(alignment, stream, at_s), -R, np.broadcast_to(np.eye(3), R.shape)], axis=2)
    right = averaged_readings(at_s - delay_s, stream.t_s, stream.force) - np.einsum("nij,nj->ni", R, acceleration[good])
    used, found = np.ones(len(R), dtype=bool), np.zeros(9)
    scatter = float(np.sqrt(np.mean(right**2)))
    for _ in range(_ROUNDS):
        rows = columns[used].reshape(-1, 9)
        normal = rows.T @ rows / scatter**2 + np.diag(1 / _USUAL**2)
        found = np.linalg.solve(normal, rows.T @ right[used].ravel() / scatter**2)
        error = np.linalg.norm(right - columns @ found, axis=1)
        used = error <= _ROBUST * float(np.median(error))
        scatter = float(np.sqrt(np.mean(error[used] ** 2) / 3)) + 1e-9
    return alignment.R_cam_imu @ found[:3]


def _by_place(alignment: Alignment, stream: ImuStream, at_s: Floats) -> Floats:
    """Return A, averaged over instants (m, k) [s], (m, 3, 3)."""
    omega = stream.rate - alignment.gyroscope_bias
    x, y, z = omega.T
    squares = averaged_readings(at_s, stream.t_s, omega**2)
    products = averaged_readings(at_s, stream.t_s, np.stack([y * z, z * x, x * y], axis=1))
    found = skew(averaged_derivative(at_s, stream.t_s, omega)) - squares.sum(axis=1)[:, None, None] * np.eye(3)
    found += squares[:, :, None] * np.eye(3)
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        found[:, i, j] += products[:, k]
        found[:, j, i] += products[:, k]
    return found
