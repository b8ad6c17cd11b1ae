"""Lenses that are known with an uncertainty, and corners that are not alike."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.estimate.camera_imu.choices import estimation_choices
from gnomon.estimate.camera_imu.layout import border_layout
from gnomon.estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters, gravity_axes
from gnomon.estimate.camera_imu.start.board_poses import board_poses
from gnomon.estimate.camera_imu.terms.visual_terms import CornerNoise, Exposures, corner_sums
from gnomon.options import CameraImuOptions
from gnomon.recording import Recording

SCENARIO = gnomon.CameraImuScenario(duration_s=12.0, pixel_noise_px=0.1)


@pytest.fixture(scope="module")
def simulation():
    return gnomon.simulate_camera_imu(SCENARIO, 5)


def known(recording: Recording, covariance: np.ndarray | None) -> Recording:
    frames = replace(recording.cameras["cam0"], lens_covariance=covariance)
    return replace(recording, cameras={"cam0": frames})


def parameters(camera, covariance) -> RigParameters:
    entry = CameraParameters(
        name="cam0",
        R_cam_imu=np.eye(3),
        p_cam_imu=np.zeros(3),
        time_shift_s=0.0,
        camera=camera,
        lens_covariance=covariance,
    )
    return RigParameters(
        gravity_axes=gravity_axes(np.array([0.0, 0.0, -1.0])),
        gravity_m_s2=9.81,
        target_scale=1.0,
        imus=(ImuParameters.ideal(),),
        cameras=(entry,),
    )


def correlated(rng: np.random.Generator, size: int) -> np.ndarray:
    A = rng.standard_normal((size, size))
    return A @ A.T + np.eye(size)


def test_information_is_the_inverse_of_what_is_known(simulation):
    camera = simulation.recording.cameras["cam0"].camera
    covariance = correlated(np.random.default_rng(0), 8)
    start = parameters(camera, covariance)
    chosen = estimation_choices(start, CameraImuOptions())
    columns = border_layout(start, chosen.status, chosen.prior_sigma)
    at = [columns.names.index(name) for name in start.cameras[0].lens_names()]
    np.testing.assert_allclose(columns.prior_information[np.ix_(at, at)], np.linalg.inv(covariance), rtol=1e-12)
    np.testing.assert_allclose(columns.prior_sigma[at], np.sqrt(np.diag(covariance)))
    assert columns.free[at].all()
    assert not columns.weak[at].any()


def test_what_the_user_states_comes_first(simulation):
    camera = simulation.recording.cameras["cam0"].camera
    start = parameters(camera, correlated(np.random.default_rng(0), 8))
    options = CameraImuOptions(
        prior=("cam0.intrinsics[0]=0.25",), fix=("cam0.distortion_coeffs",), free=("cam0.intrinsics[1]",)
    )
    chosen = estimation_choices(start, options)
    assert chosen.prior_sigma["cam0.intrinsics[0]"] == 0.25
    assert chosen.status["cam0.distortion_coeffs[2]"] == "fixed"
    assert chosen.status["cam0.intrinsics[1]"] == "estimated"
    assert "cam0.intrinsics[1]" not in chosen.prior_sigma
    columns = border_layout(start, chosen.status, chosen.prior_sigma)
    row = columns.prior_information[columns.names.index("cam0.intrinsics[0]")]
    assert np.count_nonzero(row) == 1
    assert row.max() == 0.25**-2


def test_scalars_that_are_known_exactly_are_kept(simulation):
    camera = simulation.recording.cameras["cam0"].camera
    covariance = np.diag([1.0, 1.0, 1.0, 1.0, 0, 0, 0, 0])
    chosen = estimation_choices(parameters(camera, covariance), CameraImuOptions())
    assert chosen.status["cam0.intrinsics[3]"] == "prior"
    assert chosen.status["cam0.distortion_coeffs[0]"] == "fixed"


def test_a_lens_that_is_wrong_within_its_uncertainty_is_mended(simulation):
    """By default, without any option: the prior is about a focal length that is 1 px too long."""
    recording = simulation.recording
    frames = recording.cameras["cam0"]
    true = frames.camera
    wrong = true.with_parameters(true.parameters + np.r_[1.0, 1.0, 0, 0, 0, 0, 0, 0])
    covariance = np.diag(np.r_[1.0, 1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-4, 1e-4] ** 2)
    covariance[0, 1] = covariance[1, 0] = 0.98
    frames = replace(frames, camera=wrong, lens_covariance=covariance)
    calibration = gnomon.calibrate_camera_imu(
        replace(recording, cameras={"cam0": frames}), simulation.target
    ).calibration
    found = calibration.cameras["cam0"].camera.intrinsics - true.intrinsics
    sigma = np.asarray(calibration.sigma("cam0.intrinsics"))
    assert (sigma < 0.5).all()
    assert (np.abs(found) < 4 * sigma).all()
    assert (np.abs(found[:2]) < 0.5).all()


def exposures(rng: np.random.Generator, spread) -> Exposures:
    points = np.column_stack([rng.uniform(-0.3, 0.3, (60, 2)), np.zeros(60)])
    return Exposures(
        frame=np.arange(2),
        start=np.array([0, 30, 60]),
        points=points,
        pixels=rng.uniform(100, 400, (60, 2)),
        delay_rows=np.zeros(2),
        spread=spread,
    )


@pytest.mark.parametrize("huber", [np.inf, 2.0])
def test_sums_weigh_every_corner_by_its_own_sigma(simulation, huber):
    """Exposures of one corner each, with sigmas of their own, add up to the same."""
    camera = simulation.recording.cameras["cam0"].camera
    rng = np.random.default_rng(2)
    spread = rng.uniform(0.3, 3.0, 60)
    all_at_once = exposures(rng, spread)
    R, p = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 1.0], (2, 1))
    found = corner_sums(all_at_once, camera, R, p, CornerNoise(sigma_px=80.0, huber=huber))
    for e in range(2):
        gram, cost = 0.0, 0.0
        for i in range(30 * e, 30 * e + 30):
            one = Exposures(
                frame=np.array([0]),
                start=np.array([0, 1]),
                points=all_at_once.points[i : i + 1],
                pixels=all_at_once.pixels[i : i + 1],
                delay_rows=np.zeros(1),
            )
            part = corner_sums(one, camera, R[:1], p[:1], CornerNoise(sigma_px=80.0 * spread[i], huber=huber))
            gram, cost = gram + part.gram[0], cost + part.cost[0]
            rows = part.rows(np.array([0]))[0]
            assert len(rows) == 2  # no more rows than one corner has
            np.testing.assert_allclose(rows.T @ rows, part.gram[0], rtol=1e-12)
        np.testing.assert_allclose(found.gram[e], gram, rtol=1e-10, atol=1e-12 * np.abs(gram).max())
        np.testing.assert_allclose(found.cost[e], cost, rtol=1e-12)
    np.testing.assert_allclose(found.comparable, found.residual / spread[:, None])


def test_what_is_common_to_all_corners_makes_them_alike(simulation):
    """Where the residuals are far larger than what the detector knows of, its sigmas hardly count."""
    recording, target = simulation.recording, simulation.target
    frames = recording.cameras["cam0"]
    t_s = (frames.t_ns - frames.t_ns[0]) * 1e-9
    own = np.random.default_rng(3).uniform(0.005, 0.02, len(frames.frame))
    spread = board_poses(replace(frames, sigma_px=own), target, t_s).exposures.spread
    assert spread is not None
    assert spread.max() / spread.min() < 1.05  # the corners are good to 0.1 px
    own *= 0.1 / np.median(own)
    spread = board_poses(replace(frames, sigma_px=own), target, t_s).exposures.spread
    assert spread is not None
    assert spread.max() / spread.min() > 2.5


def test_corners_of_very_different_quality_are_used_as_they_deserve(simulation):
    """Half of the corners ten times worse: known sigmas give a smaller uncertainty, and the truth stays within it."""
    rng = np.random.default_rng(4)
    recording, target = simulation.recording, simulation.target
    frames = recording.cameras["cam0"]
    bad = rng.random(len(frames.frame)) < 0.5
    sigma = np.where(bad, 1.0, 0.1)
    noisy = frames.pixels + rng.standard_normal(frames.pixels.shape) * np.where(bad, np.sqrt(0.99), 0)[:, None]
    sigmas: list[float] = []
    for own in (None, sigma):
        changed = replace(frames, pixels=noisy, sigma_px=own)
        calibration = gnomon.calibrate_camera_imu(replace(recording, cameras={"cam0": changed}), target).calibration
        error = calibration.cameras["cam0"].T_cam_imu[:3, 3] - simulation.truth.cameras["cam0"].T_cam_imu[:3, 3]
        found = np.asarray(calibration.sigma("cam0.T_cam_imu.translation"))
        assert (np.abs(error) < 4 * found).all()
        sigmas.append(float(np.linalg.norm(found)))
    assert sigmas[1] < 0.9 * sigmas[0]
