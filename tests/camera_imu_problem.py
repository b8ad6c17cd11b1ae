"""Small problems of the batch estimation in which everything is free, and its errors are as large as they get."""

from dataclasses import replace
from itertools import product

import numpy as np

from camera_imu_reference import Problem
from gnomon.estimate.camera_imu.batch import Measurements, NoiseLevels, RigState
from gnomon.estimate.camera_imu.layout import border_layout, parameter_blocks
from gnomon.estimate.camera_imu.parameters import (
    BoardPoints,
    CameraParameters,
    ImuParameters,
    RigParameters,
    gravity_axes,
)
from gnomon.estimate.camera_imu.start.first_guess import per_corner
from gnomon.estimate.camera_imu.terms.inertial_terms import InertialData, InertialNoise, TriadData
from gnomon.estimate.camera_imu.terms.visual_terms import Exposures, VisualData, board_in_camera, exposure_times
from gnomon.estimate.camera_imu.trajectory import Bases, KnotGrid, Segment, Trajectory
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.models.origin import Origin, single_point_weights

SHAPES = {"pinhole": [], "omni": [0.9], "eucm": [0.6, 1.1], "ds": [-0.2, 0.55]}
COEFFS = {
    "none": [],
    "radtan": [-0.28, 0.075, 2e-3, -1.5e-3],
    "radtan5": [-0.32, 0.15, 2e-3, -1.5e-3, -0.04],
    "equidistant": [0.01, -0.02, 0.005, -0.001],
    "fov": [0.9],
}
LENSES = list(product(SHAPES, COEFFS))
SPACING_S = 0.1

ORIGINS = (
    Origin(point="x"),
    Origin(point="optimal", weights=single_point_weights(*np.random.default_rng(4).normal(size=(2, 8, 3)))),
    Origin(point="place", place_m=np.array([0.03, -0.02, 0.05])),
)


def lens(projection, distortion):
    return Camera(
        projection=projection,
        intrinsics=[*SHAPES[projection], 300.0, 310.0, 322.0, 237.0],
        distortion=distortion,
        distortion_coeffs=COEFFS[distortion],
        resolution=(640, 480),
    )


def problem(
    models=(("pinhole", "radtan"), ("ds", "none")), *, order=5, length=1.0, segments=1, imus=1, rolling=False,
    apart=False, huber=2.0, fixed=(), flat=True, board=0, seed=0,
):  # fmt: skip
    """Return a problem of half a second a segment with everything free, and its errors as large as they get.

    In the midst of each segment the rotation vector has a stated length; a board has so many corners, all off.
    """
    rng = np.random.default_rng(seed)
    R_cam_imu = rotation_from_rotvec(rng.normal(size=3))
    R_target_imu = np.diag([1.0, -1.0, -1.0]) @ R_cam_imu  # the camera looks at the board
    pieces, controls = [], []
    spans = 4
    for number in range(segments):
        start_s, count = 1.7 * number, spans + order - 1
        axis = rng.normal(size=3)
        middle = length * axis / np.linalg.norm(axis)
        since = (np.arange(count) - (count - 1) / 2) * SPACING_S  # a spline of these values is this straight line
        phi = middle + since[:, None] * rng.normal(0, 0.7, 3)
        position = np.array([0.1, 0.15, 0.75]) + 0.04 * rng.normal(size=(count, 3))
        biases = 0.1 * rng.normal(size=(count, 6 * imus))
        reference = R_target_imu @ rotation_from_rotvec(middle).T
        pieces.append(Segment(start_s=start_s, spans=spans, first=number * count, R_reference=reference))
        controls.append(np.hstack([phi, position, biases]))
    grid = KnotGrid(segments=tuple(pieces), spacing_s=SPACING_S, order=order)
    trajectory = Trajectory(grid=grid, controls=np.concatenate(controls))
    parameters = RigParameters(
        gravity_axes=gravity_axes(rng.normal(size=3)),
        gravity_m_s2=9.7,
        target_scale=1.1,
        imus=tuple(errors_of_an_imu(rng, ORIGINS[(seed + i) % 3], i) for i in range(imus)),
        cameras=tuple(
            CameraParameters(
                name=f"cam{i}",
                R_cam_imu=rotation_from_rotvec(0.05 * rng.normal(size=3)) @ R_cam_imu,
                p_cam_imu=0.05 * rng.normal(size=3),
                time_shift_s=0.01 * (i + 1),
                exposure_s2=2e-3 * (i - 0.5),
                camera=replace(lens(*model), line_delay_s=3e-5 * rolling),
            )
            for i, model in enumerate(models)
        ),
    )
    if board:
        places = rng.uniform(-0.12, 0.3, (board, 3)) * [1, 1, 0 if flat else 0.2]
        parameters = replace(
            parameters,
            board=BoardPoints(points=places, offsets=0.01 * rng.normal(size=(board, 3)), sigma_m=0.02),
        )
    noise = NoiseLevels(
        imus=tuple(InertialNoise(gyroscope=0.02 + 0.01 * i, accelerometer=0.1) for i in range(imus)),
        walks=tuple((0.05, 0.3 + 0.1 * i) for i in range(imus)),
        pixel_sigma=tuple(0.5 + 0.1 * i for i in range(len(models))),
        huber=huber,
    )
    state = RigState(trajectory=trajectory, parameters=parameters)
    visual = tuple(seen(state, i, rng, flat=flat, rolling=rolling) for i in range(len(models)))
    measurements = Measurements(
        inertial=tuple(data for i in range(imus) for data in readings(grid, i, rng, apart=apart)),
        visual=visual,
        used=tuple(rng.random(len(data.exposures)) < 0.9 for data in visual),
    )
    return Problem(measurements=measurements, state=state, layout=columns(parameters, fixed, rng), noise=noise)


def errors_of_an_imu(rng, origin=ORIGINS[0], number=0):
    placed = {"accelerometer_shift_s": 0.004 - 0.011 * number}
    if number:
        placed |= {
            "R_imu_body": rotation_from_rotvec(rng.normal(size=3)),
            "p_imu_body": 0.1 * rng.normal(size=3),
            "time_shift_s": 0.013,
            "epoch_s": -250.0,
        }
    return ImuParameters(
        **placed,
        S_a=1 + 0.1 * rng.normal(size=3), M_a=0.1 * rng.normal(size=3), S_g=1 + 0.1 * rng.normal(size=3),
        M_g=0.1 * rng.normal(size=3), C_bg=rotation_from_rotvec(0.3 * rng.normal(size=3)),
        B_g=0.05 * rng.normal(size=(3, 3)), lever_arms=0.05 * rng.normal(size=6), origin=origin,
    )  # fmt: skip


def columns(parameters, fixed, rng):
    """Return columns for all scalars, with priors about values that they do not have."""
    status = {
        name: "fixed" if name in fixed else "estimated" for b in parameter_blocks(parameters) for name in b.scalars()
    }
    assert set(fixed) <= set(status)
    sigma = {name: 10.0 ** rng.uniform(-2, 0) for name in status}
    found = border_layout(parameters, status, sigma, consider=[b.name for b in parameter_blocks(parameters)])
    off = np.array([not any(word in name for word in ("direction", "rotation", "q_bg")) for name in found.names])
    return replace(found, prior_mean=found.prior_mean + off * rng.normal(size=len(found)) * 0.01)


def readings(grid, imu, rng, *, apart):
    """Return readings of an IMU, also before and after the trajectory; masked here and there."""
    last = grid.segments[-1].start_s + 0.6
    stamps = [np.sort(rng.uniform(-0.1, last, int(60 * last))) for _ in range(2)]

    def triad(size, count):
        return TriadData(values=size * rng.normal(size=(count, 3)), used=rng.random(count) < 0.9)

    (n, m), (first, second) = map(len, stamps), stamps
    if apart:
        return [
            InertialData(imu=imu, t_s=first, gyroscope=triad(0.5, n), accelerometer=None),
            InertialData(imu=imu, t_s=second, gyroscope=None, accelerometer=triad(5.0, m)),
        ]
    return [InertialData(imu=imu, t_s=first, gyroscope=triad(0.5, n), accelerometer=triad(5.0, n))]


def seen(state, camera, rng, *, flat, rolling):
    """Return corners where they are seen, but for noise and some wrong ones; some frames are outside."""
    grid, entry = state.trajectory.grid, state.parameters.cameras[camera]
    t_s = np.concatenate([s.start_s + np.array([-0.2, 0.02, 0.11, 0.17, 0.33, 0.38, 0.6]) for s in grid.segments])
    lengths = np.full(len(t_s), 7) if camera else rng.integers(5, 9, len(t_s))  # as many in each frame, or not
    points = rng.uniform(-0.12, 0.3, (lengths.sum(), 3)) * [1, 1, 0 if flat else 0.2]
    board, point = state.parameters.board, None
    if board is not None:
        point = np.concatenate([rng.permutation(len(board.points))[:count] for count in lengths])
        points = board.points[point]
    data = VisualData(
        camera=camera,
        exposures=Exposures(
            frame=np.arange(len(t_s)), start=np.concatenate([[0], np.cumsum(lengths)]), points=points,
            pixels=rng.uniform(100, 400, (len(points), 2)), delay_rows=np.zeros(len(t_s)),
            point=point,
        ),
        t_s=t_s - entry.time_shift_s,
    )  # fmt: skip
    if rolling:
        of = data.exposures.of_corner
        data = replace(data, exposures=per_corner(data.exposures), t_s=data.t_s[of])
    places = grid.places(exposure_times(data, entry))
    R, p = board_in_camera(state.trajectory.motion(places, Bases.at(places, grid)), entry)
    of = data.exposures.of_corner
    truth = np.einsum("nij,nj->ni", R[of], state.parameters.target_scale * points) + p[of]
    image = entry.camera.project(truth)
    assert image.valid[places.inside[of]].all()
    pixels = np.nan_to_num(image.pixels) + 0.5 * rng.normal(size=(len(points), 2))
    wrong = rng.random(len(points)) < 0.15
    pixels[wrong] += rng.normal(0, 20.0, (wrong.sum(), 2))
    return replace(data, exposures=replace(data.exposures, pixels=pixels))
