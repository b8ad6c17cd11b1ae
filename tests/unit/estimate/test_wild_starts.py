"""What wild cases brought to light, one by one (`support.wild_judge`)."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from gnomon.assess.checks.imu_checks import check_triad_clocks
from gnomon.errors import InitialisationError
from gnomon.estimate.camera_imu.choices import lens_tolerances
from gnomon.estimate.camera_imu.layout import parameter_blocks
from gnomon.estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
from gnomon.estimate.camera_imu.start.alignment import Alignment
from gnomon.estimate.camera_imu.start.board_poses import BoardPoses
from gnomon.estimate.camera_imu.start.first_guess import ImuStream, align_with_gravity
from gnomon.estimate.multiposition.bias_functions import walk_precision
from gnomon.estimate.trust.clusters import Robust
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.recording import ImuSamples, TriadSamples


def test_the_only_coefficient_of_a_lens_is_called_as_its_block_is():
    camera = Camera(
        projection="pinhole",
        intrinsics=np.array([330.0, 330.0, 320.0, 240.0]),
        distortion="fov",
        distortion_coeffs=np.array([0.9]),
        resolution=(640, 480),
    )
    entry = CameraParameters(name="cam0", R_cam_imu=np.eye(3), p_cam_imu=np.zeros(3), time_shift_s=0.0, camera=camera)
    start = RigParameters(
        gravity_axes=np.eye(3), gravity_m_s2=9.81, target_scale=1.0, imus=(ImuParameters.ideal(),), cameras=(entry,)
    )
    known = {scalar for block in parameter_blocks(start) for scalar in block.scalars()}
    assert set(lens_tolerances(start)) <= known


def test_a_turn_about_one_axis_in_few_frames_is_refused_in_words():
    t_s = np.arange(10) / 3.0  # too few to tell accelerations
    R = rotation_from_rotvec(np.outer(np.sin(t_s), [0.0, 0.0, 1.0]))
    alignment = Alignment(
        time_shift_s=0.0,
        R_cam_imu=np.eye(3),
        gyroscope_bias=np.zeros(3),
        rate_scale=1.0,
        score=1.0,
        axes=np.array([1.0, 0.0, 0.0]),
        directions=np.eye(3),
        consistent=np.ones(10, dtype=bool),
    )
    poses = _poses(t_s, R)
    stream = ImuStream(t_s=np.linspace(0, 7, 700), rate=np.zeros((700, 3)), force=np.zeros((700, 3)))
    with pytest.raises(InitialisationError, match="about one axis only"):
        align_with_gravity(alignment, poses, stream)


def _poses(t_s, R) -> BoardPoses:
    poses = object.__new__(BoardPoses)
    for name, value in (("t_s", t_s), ("R_cam_target", R), ("p_cam_target", np.tile([0.0, 0.0, 1.0], (len(R), 1)))):
        object.__setattr__(poses, name, value)
    return poses


def test_a_variance_that_is_zero_but_for_rounding_is_zero():
    errors = np.diag([1.0, -1e-30])
    robust = Robust(
        factor=np.ones(2), from_errors=errors, from_prior=np.zeros((2, 2)), correlation=np.eye(2), clusters=20
    )
    assert robust.covariance == pytest.approx(np.diag([1.0, 0.0]))


def test_an_axis_that_never_wanders_keeps_a_finite_weight():
    class Data:
        of_gyroscope = SimpleNamespace(of_kind=lambda _: np.ones(3, dtype=bool))
        span_s = (0.0, 10.0)

    precision = walk_precision(Data(), np.array([0.0, 1e-6, 1.0]))  # pyright: ignore[reportArgumentType]
    assert np.isfinite(precision).all()


def test_stamps_a_thousand_times_too_slow_are_judged_at_once():
    rng = np.random.default_rng(1)
    t_ns = np.arange(2000) * 30_000_000_000  # 30 s apart, as milliseconds that were taken for seconds
    triads = [TriadSamples(t_ns=t_ns, values=rng.standard_normal((2000, 3)), unit=unit) for unit in ("m/s^2", "rad/s")]
    imu = ImuSamples(accelerometer=triads[0], gyroscope=triads[1])
    started = time.process_time()
    assert check_triad_clocks(imu, "imu0") == []
    assert time.process_time() - started < 0.5
