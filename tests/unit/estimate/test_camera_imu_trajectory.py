"""The trajectory: grids of knots, motion along splines, its first guess, and how many knots it gets."""

from itertools import pairwise

import numpy as np
import pytest

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.errors import InitialisationError
from gnomon.estimate.camera_imu.batch import mean_weights
from gnomon.estimate.camera_imu.start.first_guess import ImuPath, imu_path, initial_trajectory
from gnomon.estimate.camera_imu.terms.inertial_terms import knots_per_s, motion_limit_hz, power_spectrum
from gnomon.estimate.camera_imu.trajectory import Bases, KnotGrid, Segment, Trajectory
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.simulate.camera_imu_streams import START_NS

ORDERS = [4, 5, 6]


def grid_of(order, *, gap_s=1.0, spacing_s=0.1):
    spans = (7, 1, 4)
    segments, start_s, first = [], 10.0, 0
    for number, count in enumerate(spans):
        R = rotation_from_rotvec(np.random.default_rng(number).normal(size=3))
        segments.append(Segment(start_s=start_s, spans=count, first=first, R_reference=R))
        start_s, first = start_s + count * spacing_s + gap_s, first + count + order - 1
    return KnotGrid(segments=tuple(segments), spacing_s=spacing_s, order=order)


def random_trajectory(order, seed=0):
    grid = grid_of(order)
    controls = np.random.default_rng(seed).normal(0, 0.3, (grid.controls, 12))
    return Trajectory(grid=grid, controls=controls)


def at(trajectory, t_s):
    places = trajectory.grid.places(np.atleast_1d(np.asarray(t_s, dtype=float)))
    assert places.inside.all()
    return trajectory.motion(places, Bases.at(places, trajectory.grid))


@pytest.mark.parametrize("order", ORDERS)
def test_places_on_the_grid(order):
    grid = grid_of(order)
    assert grid.controls == sum(segment.spans for segment in grid.segments) + 3 * (order - 1)
    first, short, last = grid.segments
    t_s = np.array([9.99, 10.0, 10.05, 10.3, 10.699, 10.7, 10.71, 11.69, 11.75, 11.8, 11.81, 12.9, 13.2, 13.21])
    inside = [0, 1, 1, 1, 1, 1, 0, 0, 1, 1, 0, 1, 1, 0]
    places = grid.places(t_s + 1e-12 * np.isin(t_s, [10.3, 12.9]) - 1e-12 * np.isin(t_s, [10.7, 11.8, 13.2]))
    np.testing.assert_array_equal(places.inside, np.array(inside, dtype=bool))
    expected = {
        1: (0, 0.0),
        2: (0, 0.5),
        3: (3, 0.0),
        4: (6, 0.99),
        5: (6, 1.0),
        8: (0, 0.5),
        9: (0, 1.0),
        12: (3, 1.0),
    }
    for i, (span, u) in expected.items():
        segment = (first, short, last)[places.segment[i]]
        assert segment.start_s - 1e-9 <= t_s[i] <= segment.start_s + segment.spans * 0.1 + 1e-9
        assert places.first[i] == segment.first + span
        assert places.u[i] == pytest.approx(u, abs=1e-9)
    assert ((places.u >= 0) & (places.u <= 1)).all()
    assert ((places.first >= 0) & (places.first + order <= grid.controls)).all()


@pytest.mark.parametrize("order", ORDERS)
def test_motion_is_the_derivative_of_the_pose(order):
    trajectory = random_trajectory(order)
    t_s = np.array([10.03, 10.256, 10.42, 10.688, 11.74, 13.07, 13.17])
    motion, h = at(trajectory, t_s), 1e-5
    ahead, behind = at(trajectory, t_s + h), at(trajectory, t_s - h)
    np.testing.assert_allclose(motion.velocity, (ahead.position - behind.position) / (2 * h), atol=1e-7)
    np.testing.assert_allclose(motion.acceleration, (ahead.velocity - behind.velocity) / (2 * h), atol=1e-6)
    turned = rotvec_from_rotation(np.swapaxes(behind.R, 1, 2) @ ahead.R)
    np.testing.assert_allclose(motion.omega, turned / (2 * h), atol=1e-6)
    np.testing.assert_allclose(motion.R @ np.swapaxes(motion.R, 1, 2), np.tile(np.eye(3), (7, 1, 1)), atol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_reference_attitudes_and_steps_of_the_controls(order):
    trajectory = random_trajectory(order)
    still = Trajectory(grid=trajectory.grid, controls=np.zeros_like(trajectory.controls))
    t_s = np.array([10.2, 11.75, 13.1])
    np.testing.assert_allclose(at(still, t_s).R, [s.R_reference for s in trajectory.grid.segments], atol=1e-15)
    # a common step of all rotation vectors turns the body about its own axes by the right Jacobian
    step = np.zeros_like(trajectory.controls)
    step[:, :3] = [1e-6, -2e-6, 3e-6]
    before, after = at(trajectory, t_s), at(trajectory.plus(step), t_s)
    turned = rotvec_from_rotation(np.swapaxes(before.R, 1, 2) @ after.R)
    np.testing.assert_allclose(turned, before.phi_jacobian @ step[0, :3], atol=1e-11)
    np.testing.assert_allclose(after.omega - before.omega, before.omega_by_phi @ step[0, :3], atol=1e-10)


@pytest.mark.parametrize("order", ORDERS)
def test_biases_are_linear_between_the_knots(order):
    trajectory = random_trajectory(order)
    grid = trajectory.grid
    index, times = grid.knot_times()
    assert len(index) == sum(segment.spans + 1 for segment in grid.segments)
    nudged = times + 1e-9 * np.where(np.isin(times, [s.start_s for s in grid.segments]), 1, -1)
    gyroscope, accelerometer = trajectory.bias(grid.places(nudged))
    np.testing.assert_allclose(gyroscope, trajectory.controls[index, 6:9], atol=1e-7)
    np.testing.assert_allclose(accelerometer, trajectory.controls[index, 9:12], atol=1e-7)
    for (i, a), (j, b) in pairwise(zip(index, times, strict=True)):
        if b - a < 0.11:
            halfway = trajectory.bias(grid.places(np.array([0.5 * (a + b)])))[0][0]
            np.testing.assert_allclose(halfway, trajectory.controls[[i, j], 6:9].mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_mean_of_a_bias_is_its_integral_over_the_segments(order):
    trajectory = random_trajectory(order)
    t_s = np.concatenate([s.start_s + 1e-4 * (np.arange(1000 * s.spans) + 0.5) for s in trajectory.grid.segments])
    fine = trajectory.bias(trajectory.grid.places(t_s))[0].mean(axis=0)
    np.testing.assert_allclose(mean_weights(trajectory) @ trajectory.controls[:, 6:9], fine, atol=1e-7)
    assert mean_weights(trajectory).sum() == pytest.approx(1.0)


def simulated(**changes):
    """Return the exact path at the IMU's timestamps, when frames were seen, and the truth."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=12.0, **changes), seed=2)
    true = simulation.trajectory
    path = ImuPath(t_s=true.t_s, R=true.R_target_imu, position=true.p_target_imu)
    return path, simulation.frames["cam0"].exposure_s, simulation


def assert_follows(trajectory, path, atol):
    places = trajectory.grid.places(path.t_s)
    inside = places.inside
    motion = trajectory.motion(places, Bases.at(places, trajectory.grid))
    np.testing.assert_allclose(motion.R[inside], path.R[inside], atol=atol)
    np.testing.assert_allclose(motion.position[inside], path.position[inside], atol=atol)
    return inside


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("motion", ["normal", "rolling"])
def test_first_trajectory_passes_through_the_path(order, motion):
    path, seen_s, _ = simulated(motion=motion)
    bias = np.array([0.1, -0.2, 0.3])
    trajectory = initial_trajectory(path, seen_s, 50.0, order=order, gyroscope_biases=[bias])
    inside = assert_follows(trajectory, path, atol=2e-3)
    starts = [segment.start_s for segment in trajectory.grid.segments]
    assert starts == sorted(starts)
    # all of the time from the first to the last frame, and a margin, belongs to it
    covered = path.t_s[inside]
    assert covered[0] <= max(path.t_s[0], seen_s[0] - 0.09)
    assert covered[-1] >= min(path.t_s[-1], seen_s[-1] + 0.09)
    assert inside[(path.t_s >= covered[0]) & (path.t_s <= covered[-1])].all()
    np.testing.assert_array_equal(trajectory.controls[:, 6:9], np.tile(bias, (trajectory.grid.controls, 1)))
    np.testing.assert_array_equal(trajectory.controls[:, 9:], 0.0)
    vectors = at(trajectory, covered)
    assert np.isfinite(vectors.omega).all()
    longest = max(
        np.linalg.norm(trajectory.controls[s.first : s.first + s.spans + order - 1, :3], axis=1).max()
        for s in trajectory.grid.segments
    )
    assert longest < 5.3  # far from where the chart ends
    assert (len(starts) > 1) == (motion == "rolling")  # it turns over three times


def test_turning_over_once_and_back_needs_no_cut():
    t_s = np.arange(0, 10, 0.005)
    angle = 4.2 * np.sin(2 * np.pi * t_s / 10)
    R = rotation_from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    path = ImuPath(t_s=t_s, R=R, position=np.zeros((len(t_s), 3)))
    trajectory = initial_trajectory(path, np.arange(0, 10, 0.05), 50.0, order=6, gyroscope_biases=[np.zeros(3)])
    assert len(trajectory.grid.segments) == 1
    assert_follows(trajectory, path, atol=1e-4)


def test_gaps_of_the_imu_cut_it_and_short_ones_do_not():
    path, seen_s, _ = simulated()
    gap = ((path.t_s > 4.0) & (path.t_s < 4.5)) | ((path.t_s > 8.0) & (path.t_s < 8.03))
    kept = ImuPath(t_s=path.t_s[~gap], R=path.R[~gap], position=path.position[~gap])
    trajectory = initial_trajectory(kept, seen_s, 50.0, order=6, gyroscope_biases=[np.zeros(3)])
    first, second = trajectory.grid.segments
    assert first.start_s + first.spans * 0.02 == pytest.approx(4.0, abs=0.021)
    assert second.start_s == pytest.approx(4.5, abs=0.006)
    inside = assert_follows(trajectory, kept, atol=2e-3)
    assert inside[(kept.t_s > 8.02) & (kept.t_s < 8.1)].all()


def test_pieces_without_frames_are_left_out():
    path, seen_s, _ = simulated()
    gap = (path.t_s > 4.0) & (path.t_s < 4.5)
    kept = ImuPath(t_s=path.t_s[~gap], R=path.R[~gap], position=path.position[~gap])
    late = initial_trajectory(kept, seen_s[seen_s > 6.0], 50.0, order=6, gyroscope_biases=[np.zeros(3)])
    (only,) = late.grid.segments
    assert only.start_s == pytest.approx(seen_s[seen_s > 6.0][0] - 0.1, abs=0.01)
    with pytest.raises(InitialisationError, match="nowhere are there 5 frames with the board and the IMU's samples"):
        initial_trajectory(kept, seen_s + 100.0, 50.0, order=6, gyroscope_biases=[np.zeros(3)])
    with pytest.raises(InitialisationError, match="one recording"):
        initial_trajectory(kept, seen_s[:4], 50.0, order=6, gyroscope_biases=[np.zeros(3)])


def test_the_gyroscope_joins_the_attitudes_of_frames():
    path, _, simulation = simulated(random_extrinsics=True)
    rng = np.random.default_rng(0)
    bias = np.array([0.3, -0.4, 0.2])
    rate = simulation.trajectory.omega_imu + bias
    frame_t_s = np.sort(rng.uniform(0.2, 11.8, 40))  # unevenly, up to more than half a second apart
    truth = simulation.trajectory.at(frame_t_s)
    R, p = truth.R_target_body, truth.p_target_body
    found = imu_path(path.t_s, rate - bias, frame_t_s, R, p)
    np.testing.assert_allclose(found.R, path.R, atol=2e-3)
    # a bias that is not known is taken up by the frames: no drift
    drifting = imu_path(path.t_s, rate, frame_t_s, R, p)
    between = (path.t_s > frame_t_s[0]) & (path.t_s < frame_t_s[-1])
    error = np.linalg.norm(rotvec_from_rotation(np.swapaxes(path.R, 1, 2) @ drifting.R), axis=1)
    assert error[between].max() < 0.5 * np.linalg.norm(bias) * np.diff(frame_t_s).max() + 0.01
    index = np.clip(np.searchsorted(path.t_s, frame_t_s), 0, len(path.t_s) - 1)
    np.testing.assert_allclose(found.position[index], p, atol=0.02)


def test_spectrum_has_the_power_of_a_sine_and_of_white_noise():
    rng = np.random.default_rng(0)
    t_s = np.arange(0, 60, 0.005)
    values = 0.2 * rng.normal(size=(len(t_s), 3))
    values[:, 1] += 3.0 * np.sin(2 * np.pi * 20.0 * t_s)
    frequency, power = power_spectrum(t_s, values, 200.0)
    step = frequency[1] - frequency[0]
    beside = np.abs(frequency - 20.0) > 2.0
    assert np.median(power[beside]) == pytest.approx(0.2**2 / 100.0, rel=0.1)  # one-sided, to 100 Hz
    assert power[~beside].sum() * step == pytest.approx(4.5 / 3 + 4.0 * 0.2**2 / 100, rel=0.05)


@pytest.mark.parametrize(("to_hz", "least", "most"), [(2.0, 50.0, 50.0), (9.0, 45.0, 65.0), (18.0, 80.0, 95.0)])
def test_knots_follow_the_motion_and_not_the_noise(to_hz, least, most):
    rng = np.random.default_rng(1)
    t_s = np.arange(0, 40, 0.005)
    gyroscope = 2.4e-3 * rng.normal(size=(len(t_s), 3))
    accelerometer = 0.03 * rng.normal(size=(len(t_s), 3))
    for hz in np.linspace(0.2, to_hz, 12):
        gyroscope += 0.05 * np.sin(2 * np.pi * hz * t_s + rng.uniform(0, 6, 3)[:, None]).T
    found = knots_per_s((t_s, gyroscope), (t_s, accelerometer))
    assert least <= found <= most
    assert motion_limit_hz(t_s, gyroscope, 200.0) == pytest.approx(to_hz + 1, abs=1.0)  # no sharper than its window
    assert motion_limit_hz(t_s, accelerometer, 200.0) < 1.0


@pytest.mark.parametrize(("rate_hz", "expected"), [(1000.0, 50.0), (200.0, 50.0), (100.0, 35.0), (60.0, 20.0)])
def test_knots_of_a_calm_motion_by_the_rate_of_the_imu(rate_hz, expected):
    rng = np.random.default_rng(2)
    t_s = np.arange(0, 30, 1 / rate_hz)
    values = 0.01 * rng.normal(size=(len(t_s), 3)) + np.sin(2 * np.pi * 0.5 * t_s)[:, None]
    assert knots_per_s((t_s, values)) == expected
    violent = rng.normal(size=(len(t_s), 3)) + 50 * np.sin(2 * np.pi * 0.4 * rate_hz * t_s)[:, None]
    assert knots_per_s((t_s, violent)) == pytest.approx(0.5 * rate_hz)


def test_the_slower_triad_limits_the_knots():
    rng = np.random.default_rng(3)
    fast_s, slow_s = np.arange(0, 30, 1 / 400), np.arange(0, 30, 1 / 80)
    fast = 0.01 * rng.normal(size=(len(fast_s), 3)) + np.sin(2 * np.pi * 30.0 * fast_s)[:, None]
    slow = 0.01 * rng.normal(size=(len(slow_s), 3))
    assert knots_per_s((fast_s, fast)) == pytest.approx(140.0, abs=5.0)
    assert knots_per_s((fast_s, fast), (slow_s, slow)) == pytest.approx(40.0)


def test_stamps_of_simulated_frames_are_on_the_path_s_clock():
    # what the tests above take for granted
    _, seen_s, simulation = simulated()
    frames = simulation.recording.cameras["cam0"]
    shift_s = float(simulation.truth_parameters["cam0.time_shift_cam_imu"])
    np.testing.assert_allclose((frames.t_ns - START_NS) * 1e-9 + shift_s, seen_s, atol=1e-8)


@pytest.mark.parametrize("order", ORDERS)
def test_bases_over_an_exposure_are_their_means(order):
    """What is left is of the fourth power of the exposure, and nothing of cubic polynomials."""
    trajectory = random_trajectory(order)
    t_s = np.array([10.23, 10.55])  # the exposures lie within a span
    nodes, weights = np.polynomial.legendre.leggauss(5)
    places = trajectory.grid.places(t_s)
    for name in ("phi", "phi_rate", "position", "velocity"):
        left = []
        for exposure_s in (0.04, 0.02):
            several = [getattr(at(trajectory, t_s + exposure_s / 2 * node), name) for node in nodes]
            bases = Bases.at(places, trajectory.grid, exposure_s**2)
            mean = getattr(trajectory.motion(places, bases), name)
            assert np.abs(mean - getattr(at(trajectory, t_s), name)).max() > 1e-4
            left.append(np.abs(mean - np.tensordot(weights / 2, several, 1)).max())
        assert left[0] < 1e-12 or left[1] < left[0] / 15.5
