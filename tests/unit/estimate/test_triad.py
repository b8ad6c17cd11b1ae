"""One triad from magnitudes: exactness, honest sigmas, every kind of pose, bad poses, priors, starts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gnomon import InitialisationError, OptionError
from gnomon.estimate.triads.triad import fit_triad
from gnomon.estimate.triads.triad_problem import TriadPoses, TriadPrior
from gnomon.estimate.triads.triad_start import constrained_ellipsoid, fit_sphere, general_ellipsoid
from gnomon.geometry.rotations import rotation_from_rotvec

GRAVITY = 9.80665
FACES = np.concatenate([np.eye(3), -np.eye(3)])
EDGES = np.array([np.roll([a, b, 0.0], k) for k in range(3) for a in (1, -1) for b in (1, -1)]) / np.sqrt(2)
ATTITUDES = np.concatenate([FACES, EDGES])  # the eighteen of Angrisano
SENSITIVITY = np.array([[547.6, 0.0, 0.0], [-0.25, 552.8, 0.0], [2.0, 7.4, 550.6]])
BIAS = np.array([33610.0, 33382.0, 32063.0])
G_SENSITIVITY = 550 * np.array([[-0.0012, 0.0008, 0.0015], [-0.0013, 0.0001, -0.0014], [0.0016, 0.0013, -0.0009]])


def tilted(directions, sigma_rad, rng):
    return np.einsum("kij,kj->ki", rotation_from_rotvec(rng.normal(0, sigma_rad, directions.shape)), directions)


def readings(vectors, force=None):
    measured = vectors @ SENSITIVITY.T + BIAS
    return measured if force is None else measured + force @ G_SENSITIVITY.T


def eighteen(rng, noise=1.5, sigma_deg=10.0):
    vectors = GRAVITY * tilted(ATTITUDES, np.radians(sigma_deg), rng)
    return TriadPoses.of(readings(vectors) + rng.normal(0, noise, (18, 3)), GRAVITY, variance=noise**2)


def errors(fit, sensitivity=SENSITIVITY, g_sensitivity=None):
    g = np.zeros((3, 3)) if g_sensitivity is None else g_sensitivity
    parts = (fit.sensitivity - sensitivity, fit.bias - BIAS, fit.g_sensitivity - g)
    return np.concatenate([part.ravel() for part in parts])[fit.free]


def nees(fit, **truth):
    error = errors(fit, **truth)
    return error @ np.linalg.solve(fit.covariance[np.ix_(fit.free, fit.free)], error)


def mean_within(values, degrees, sigmas=4.0):
    assert abs(np.mean(values) - degrees) < sigmas * np.sqrt(2 * degrees / len(values))


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    decades=st.lists(st.floats(-5, 5), min_size=3, max_size=3),
    offset=st.lists(st.floats(-1e5, 1e5), min_size=3, max_size=3),
    noise=st.sampled_from([0.0, 1.5, 60.0]),
)
def test_units_and_offsets_of_the_axes_do_not_matter(seed, decades, offset, noise):
    rng = np.random.default_rng(seed)
    poses = eighteen(rng, noise)
    unit = 10.0 ** np.array(decades)
    other = TriadPoses.of((poses.measured + offset) * unit, GRAVITY, variance=poses.variance * unit**2)
    one, two = fit_triad(poses), fit_triad(other)
    by_row = unit[:, None] * np.ones(3)
    close = 1e-3 * one.sigma + 1e-7 * np.concatenate([np.full(9, 550.0), np.full(3, 5500.0), np.ones(9)])
    turn = np.concatenate([by_row.ravel(), unit, np.ones(9)])
    assert (np.abs((two.sensitivity / by_row - one.sensitivity).ravel()) <= close[:9]).all()
    assert (np.abs(two.bias / unit - offset - one.bias) <= close[9:12] + 1e-9 * np.abs(offset)).all()
    np.testing.assert_allclose(two.sigma / turn, one.sigma, rtol=1e-3, atol=1e-9)
    np.testing.assert_array_equal(one.used, two.used)


def test_without_noise_the_truth_comes_out():
    fit = fit_triad(TriadPoses.of(readings(GRAVITY * ATTITUDES), GRAVITY))
    np.testing.assert_allclose(fit.sensitivity, SENSITIVITY, atol=1e-7)
    np.testing.assert_allclose(fit.bias, BIAS, atol=1e-6)
    assert np.array_equal(fit.sensitivity, np.tril(fit.sensitivity))
    assert fit.converged
    assert fit.in_own_frame
    assert not fit.held_by_prior.any()


def scatter(runs, sigma_deg, noise):
    fits = [fit_triad(eighteen(np.random.default_rng(seed), noise, sigma_deg)) for seed in range(runs)]
    found = np.array([errors(fit) for fit in fits])
    sigma = np.sqrt(np.mean([fit.sigma[fit.free] ** 2 for fit in fits], axis=0))
    mean_within([nees(fit) for fit in fits], 9)
    return sigma, np.sqrt(np.mean(found**2, axis=0))


def in_blocks(values):
    """Root mean squares of scales, angles and biases; free are S00, S10, S11, S20, S21, S22, b."""
    groups = ([0, 2, 5], [1, 3, 4], [6, 7, 8])
    return np.array([np.sqrt(np.mean(values[group] ** 2)) for group in groups])


@pytest.mark.parametrize(("sigma_deg", "noise"), [(1.0, 1.45), (10.0, 2.9)])
def test_sigmas_are_those_of_the_scatter_and_of_table_1(sigma_deg, noise):
    sigma, found = scatter(60, sigma_deg, noise)
    ratio = in_blocks(sigma) / in_blocks(found)
    assert (np.abs(ratio - 1) < 0.25).all()
    scale, angle, bias = in_blocks(sigma)
    printed = (2.6e-7, 1 / 60, 0.6) if sigma_deg == 1.0 else (5e-7, 2.5 / 60, 1.3)
    shown = np.array([scale / 550**2, np.degrees(angle / 550), bias])
    np.testing.assert_allclose(shown, printed, rtol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_deg", "noise"), [(1.0, 1.45), (10.0, 2.9)])
def test_sigmas_are_those_of_the_scatter_in_500_runs(sigma_deg, noise):
    sigma, found = scatter(500, sigma_deg, noise)
    ratio = in_blocks(sigma) / in_blocks(found)
    assert (ratio > 0.85).all()
    assert (ratio < 1.15).all()


def turntable(rng, *, directions=False, g_sensitivity=False, rest=True, speeds=(1.7, 3.5, 4.7), sigma=1e-4, noise=5.0):
    """Poses at several speeds whose common errors are drawn, and at rest; and the sensitivity as directions see it."""
    turn = rotation_from_rotvec(np.array([0.02, -0.01, 0.03])) if directions else np.eye(3)
    rates = np.repeat((*speeds, 0.0) if rest else speeds, 18)
    group = np.repeat(np.arange(len(rates) // 18), 18)
    u = tilted(np.tile(ATTITUDES, (len(rates) // 18, 1)), 0.2, rng)
    factor = 1 + rng.normal(0, sigma, group.max() + 1)[group]
    force = GRAVITY * u if g_sensitivity else None
    measured = readings((rates * factor)[:, None] * u @ turn.T, force) + rng.normal(0, noise, u.shape)
    poses = TriadPoses.of(
        measured,
        rates,
        variance=noise**2,
        group=group,
        group_sigma=np.full(group.max() + 1, sigma),
        direction=tilted(u, 2e-3, rng) if directions else None,
        direction_sigma=2e-3,
        force=force,
    )
    return poses, SENSITIVITY @ turn


@pytest.mark.first(2)
@pytest.mark.parametrize(
    ("kind", "degrees"),
    [
        ({}, 9),
        ({"rest": False}, 9),
        ({"speeds": (1.7,), "rest": False}, 9),
        ({"g_sensitivity": True}, 18),
        ({"directions": True}, 12),
        ({"directions": True, "g_sensitivity": True}, 21),
    ],
)
def test_turntable_errors_are_as_large_as_their_sigmas(kind, degrees):
    values = []
    for seed in range(15):
        poses, sensitivity = turntable(np.random.default_rng(seed), **kind)
        with_g = "g_sensitivity" in kind
        fit = fit_triad(poses, g_sensitivity=with_g)
        assert fit.converged
        assert fit.used.all()
        values.append(nees(fit, sensitivity=sensitivity, g_sensitivity=G_SENSITIVITY if with_g else None))
    assert len(errors(fit)) == degrees
    mean_within(values, degrees)


def test_many_rests_do_not_make_the_turning_poses_outliers():
    poses, _ = turntable(np.random.default_rng(6), speeds=(1.7,))
    index = np.concatenate([np.arange(18), np.tile(np.arange(18, 36), 4)])
    many = TriadPoses.of(
        poses.measured[index], poses.magnitude[index], variance=25.0, group=poses.group[index], group_sigma=[1e-4, 0.0]
    )
    fit = fit_triad(many)
    assert fit.used.all()
    assert nees(fit) < 60  # each rest counts four times, as if its noise were half of what it is


def test_the_error_of_a_speed_is_in_the_scales_sigma():
    rng = np.random.default_rng(3)
    one, _ = turntable(rng, speeds=(1.7,), sigma=1e-2, noise=0.01)
    relative = np.diag(fit_triad(one).sigma[:9].reshape(3, 3)) / np.diag(SENSITIVITY)
    np.testing.assert_allclose(relative, 1e-2, rtol=0.02)


def test_with_unknown_scale_ratios_are_known_and_the_common_scale_is_not():
    poses, _ = turntable(np.random.default_rng(4), sigma=0.0)
    fit = fit_triad(poses, unknown_scale=True)
    assert not fit.scale_known
    assert fit.held_by_prior[[0, 4, 8]].all()
    assert (np.diag(fit.sigma[:9].reshape(3, 3)) > 0.1 * np.diag(SENSITIVITY)).all()
    by_log = np.zeros(21)
    by_log[[0, 4]] = 1 / fit.sensitivity[0, 0], -1 / fit.sensitivity[1, 1]
    sigma = np.sqrt(by_log @ fit.covariance @ by_log)
    assert sigma < 2e-3
    ratio = fit.sensitivity[0, 0] / fit.sensitivity[1, 1]
    assert abs(ratio / (SENSITIVITY[0, 0] / SENSITIVITY[1, 1]) - 1) < 4 * sigma


def test_rests_alone_give_g_sensitivity_where_the_scale_is_known():
    # The static experiment of Krebs: six attitudes, the rate is zero in all of them.
    rng = np.random.default_rng(5)
    force = GRAVITY * tilted(np.tile(FACES, (3, 1)), 0.05, rng)
    poses = TriadPoses.of(
        readings(np.zeros((18, 3)), force) + rng.normal(0, 0.02, (18, 3)), 0.0, variance=4e-4, force=force
    )
    known = np.concatenate([SENSITIVITY.ravel(), np.full(12, np.nan)])
    prior = TriadPrior.of(known, np.where(np.isfinite(known), 1.0, np.inf))
    fit = fit_triad(poses, g_sensitivity=True, prior=prior)
    assert (np.abs(fit.g_sensitivity - G_SENSITIVITY) < 4 * fit.sigma[12:].reshape(3, 3)).all()
    assert (fit.sigma[12:] < 1e-3).all()
    with pytest.raises(InitialisationError, match="zero in every pose"):
        fit_triad(poses, g_sensitivity=True)


@pytest.mark.parametrize(("bad", "size", "count"), [(1, 200.0, 18), (6, 300.0, 36), (8, 1e6, 36), (60, 5e3, 200)])
def test_bad_poses_are_left_out(bad, size, count):
    good = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = tilted(np.tile(ATTITUDES, (count // 18 + 1, 1))[:count], 0.2, rng)
        measured = readings(GRAVITY * u) + rng.normal(0, 2.0, u.shape)
        wrong = rng.permutation(count)[:bad]
        measured[wrong] += size * rng.normal(size=(bad, 3)) + size * np.sign(rng.normal(size=(bad, 3)))
        fit = fit_triad(TriadPoses.of(measured, GRAVITY, variance=4.0))
        assert fit.used[np.setdiff1d(np.arange(count), wrong)].all()
        good += nees(fit) < 30  # 9 degrees of freedom
    assert good >= 5


def test_leave_one_out_is_what_a_fit_without_the_pose_says():
    poses = eighteen(np.random.default_rng(7))
    fit = fit_triad(poses, robust=False)
    for k in range(0, 18, 4):
        rest = np.delete(poses.measured, k, axis=0)
        other = fit_triad(TriadPoses.of(rest, GRAVITY, variance=2.25), robust=False)
        error = np.linalg.norm(other.physical(poses.measured[k : k + 1])) - GRAVITY
        assert abs(fit.magnitude_holdout[k] - error) < 2e-3 * abs(error) + 1e-6
    assert abs(fit.leverage.sum() - 9) < 1e-3


def test_scatter_of_touched_poses_enters_the_sigmas():
    rng = np.random.default_rng(8)
    poses = eighteen(rng, noise=40.0)
    stated = TriadPoses.of(poses.measured, GRAVITY, variance=1.0)
    fit = fit_triad(stated, robust=False)
    assert 0.4 < fit.extra_sigma / (40 / 550) < 1.8
    np.testing.assert_allclose(2 * fit.cost, fit.degrees_of_freedom, rtol=0.05)
    assert fit.sigma[0] > 20 * fit_triad(eighteen(rng, noise=1.0)).sigma[0]


def test_many_noisy_samples_agree_on_the_right_scale():
    # Ten percent of noise lengthens a vector by one percent, which is a hundred sigma here.
    rng = np.random.default_rng(9)
    u = rng.normal(size=(10_000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    sigma = np.array([100.0, 300.0, 540.0])
    measured = readings(GRAVITY * u) + rng.normal(0, sigma, u.shape)
    assert nees(fit_triad(TriadPoses.of(measured, GRAVITY, variance=sigma**2))) < 30
    alike = readings(GRAVITY * u) + rng.normal(0, 540, u.shape)
    fit = fit_triad(TriadPoses.of(alike, GRAVITY))  # noise unknown
    assert nees(fit) < 30
    assert abs(fit.extra_sigma * 550 - 540) < 20


def test_a_prior_can_say_which_body_frame_is_meant():
    turn = rotation_from_rotvec(np.array([0.1, -0.2, 0.3]))
    prior = TriadPrior.of(np.concatenate([(SENSITIVITY @ turn).ravel(), np.full(12, np.nan)]), 5.0)
    fit = fit_triad(eighteen(np.random.default_rng(11)), prior=prior)
    assert not fit.in_own_frame
    assert np.abs(fit.sensitivity - SENSITIVITY @ turn).max() < 5
    np.testing.assert_allclose(fit.sensitivity @ fit.sensitivity.T, SENSITIVITY @ SENSITIVITY.T, atol=200)


def test_held_parameters_stay():
    values = np.full(21, np.nan)
    values[[3, 6, 7]] = 0.0
    prior = TriadPrior.of(values, np.where(np.isfinite(values), 0.0, np.inf))
    rng = np.random.default_rng(12)
    diagonal = GRAVITY * FACES @ np.diag([540.0, 550.0, 560.0]) + BIAS + rng.normal(0, 1, (6, 3))
    fit = fit_triad(TriadPoses.of(diagonal, GRAVITY, variance=1.0), prior=prior)  # six unknowns, six poses
    assert (fit.sensitivity[[1, 2, 2], [0, 0, 1]] == 0).all()
    np.testing.assert_allclose(np.diag(fit.sensitivity), [540, 550, 560], atol=1.0)
    assert not fit.free[[1, 2, 3, 5, 6, 7]].any()
    assert (fit.sigma[[3, 6, 7]] == 0).all()


@pytest.mark.parametrize("seed", range(8))
def test_a_stated_start_changes_nothing(seed):
    # Angrisano, Table 2, three times as wide.
    rng = np.random.default_rng(seed)
    poses = eighteen(np.random.default_rng(1))
    angles, bias = np.radians(rng.uniform(-54, 57, 3)), 32767.5 + rng.uniform(-4500, 7500, 3)
    scale = 100 / 65535 + rng.uniform(-0.0018, 0.09, 3)
    reference = fit_triad(poses)
    fit = fit_triad(poses, start=np.concatenate([angles, bias, scale]))
    assert np.abs(errors(fit) - errors(reference)).max() < 1e-3 * reference.sigma.max()


def cap(rng, count, lowest):
    u = rng.normal(size=(200 * count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u[u[:, 2] > lowest][:count]


def test_where_the_algebraic_quadric_is_no_ellipsoid_another_start_is_found():
    refused = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        measured = readings(GRAVITY * cap(rng, 12, 0.5)) + rng.normal(0, 50, (12, 3))
        refused += general_ellipsoid(measured - measured.mean(axis=0), np.full(12, GRAVITY)) is None
        fit = fit_triad(TriadPoses.of(measured, GRAVITY, variance=2500.0))
        assert fit.converged
        weak = fit.held_by_prior.any() or fit.sigma[:9].max() > 0.05 * 550
        assert weak or nees(fit) < 40
    assert refused > 3


def test_every_closed_form_is_exact_where_it_holds():
    u = np.concatenate([ATTITUDES, tilted(ATTITUDES, 0.3, np.random.default_rng(2))])
    w = np.where(np.arange(36) < 18, 2.0, 1.0)
    m = u * w[:, None] * 3.0 + 0.1
    for form, length in ((general_ellipsoid, w), (fit_sphere, w), (fit_sphere, np.full(36, 2.0))):
        found = form(m if np.ptp(length) else u * 6.0 + 0.1, length)
        np.testing.assert_allclose(found.correction, np.eye(3) / 3, atol=1e-6)
        np.testing.assert_allclose(found.bias, 0.1, atol=1e-6)
    squeezed = u @ np.diag([1.0, 1.3, 0.8]) + 0.1
    found = constrained_ellipsoid(squeezed, np.ones(36))
    np.testing.assert_allclose(found.correction, np.diag([1.0, 1 / 1.3, 1 / 0.8]), atol=1e-6)


@pytest.mark.parametrize(
    ("vectors", "message"),
    [
        (np.tile([[0.0, 0, 1]], (18, 1)), "one orientation only"),
        (ATTITUDES[np.abs(ATTITUDES[:, 2]) < 0.1].repeat(2, axis=0), "mostly axis z"),
        (ATTITUDES[:8], "8 equations for 9 unknowns"),
    ],
)
def test_poses_that_determine_nothing_are_refused(vectors, message):
    rng = np.random.default_rng(13)
    measured = readings(GRAVITY * vectors) + rng.normal(0, 1, vectors.shape)
    with pytest.raises(InitialisationError, match=message):
        fit_triad(TriadPoses.of(measured, GRAVITY, variance=1.0))


def test_poses_are_checked():
    with pytest.raises(OptionError, match="pose 2"):
        TriadPoses.of(np.array([[1.0, 2, 3], [np.nan, 2, 3]]), 1.0)
    with pytest.raises(OptionError, match="groups"):
        TriadPoses.of(np.ones((2, 3)), 1.0, group=[0, 1])
    with pytest.raises(OptionError, match="specific force"):
        fit_triad(TriadPoses.of(ATTITUDES, 1.0), g_sensitivity=True)
