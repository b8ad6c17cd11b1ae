"""The g-sensitivity from rests: exact where there is no noise, honest where there is, and safe from drift."""

import numpy as np
import pytest

from gnomon.errors import InitialisationError
from gnomon.estimate.triads.gyroscope_at_rests import RestingRates, fit_static_g_sensitivity

THESIS = np.array([[-0.0012, 0.0008, 0.0015], [-0.0013, 0.0001, -0.0014], [0.0016, 0.0013, -0.0009]])
"""Krebs, appendix A.1."""

FACES = np.concatenate([np.eye(3), -np.eye(3)])
SEVEN = FACES[[5, 4, 2, 1, 0, 3, 5]]
BIAS = np.array([0.02, -0.01, 0.005])
NOISE = 2e-5


def rests(up, seed=None, *, drift=0.0, walk=0.0):
    n, t = len(up), 21.0 * np.arange(len(up))
    rng = np.random.default_rng(seed)
    noise = 0.0 if seed is None else NOISE
    force = 9.81 * up
    measured = BIAS + force @ THESIS.T + drift * ((t - t.mean()) / np.ptp(t))[:, None] + noise * rng.normal(size=(n, 3))
    measured = measured + walk * np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return RestingRates(measured=measured, variance=np.full((n, 3), NOISE**2), force=force, t_s=t)


@pytest.mark.parametrize("up", [FACES, SEVEN])
@pytest.mark.parametrize("drift", [0.0, 1e-4, 1e-2])
def test_exact_without_noise_whatever_the_steady_drift(up, drift):
    fit = fit_static_g_sensitivity(rests(up, drift=drift))
    np.testing.assert_allclose(fit.g_sensitivity, THESIS, atol=1e-12)
    np.testing.assert_allclose(fit.bias, BIAS, atol=1e-12)
    np.testing.assert_allclose(np.ptp(fit.drift, axis=0), drift, atol=1e-10)
    np.testing.assert_allclose(fit.predicted, rests(up, drift=drift).measured, atol=1e-12)


@pytest.mark.parametrize("up", [FACES, SEVEN])
def test_sigmas_say_how_far_it_is_off(up):
    fits = [fit_static_g_sensitivity(rests(up, seed, drift=1e-4)) for seed in range(100)]
    z = np.array([((f.g_sensitivity - THESIS).ravel()) / np.sqrt(np.diag(f.covariance)[3:]) for f in fits])
    assert np.mean(np.abs(z) > 3) < 0.01
    assert 0.7 < z.std() < 1.1
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(len(fits))


def test_a_wandering_bias_is_seen_and_said():
    up = np.random.default_rng(5).normal(size=(24, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    fits = [fit_static_g_sensitivity(rests(up, seed, walk=5 * NOISE)) for seed in range(60)]
    z = np.array([((f.g_sensitivity - THESIS).ravel()) / np.sqrt(np.diag(f.covariance)[3:]) for f in fits])
    assert 0.8 < z.std() < 1.25
    assert np.mean(np.abs(z) > 3) < 0.02
    quiet = fit_static_g_sensitivity(rests(up, 0))
    assert fits[0].extra_sigma.min() > 4 * quiet.extra_sigma.max()


def test_gain_is_the_derivative():
    data = rests(SEVEN, 3)
    fit = fit_static_g_sensitivity(data)
    moved = data.measured.copy()
    moved[2, 1] += 1e-9
    again = fit_static_g_sensitivity(
        RestingRates(measured=moved, variance=data.variance, force=data.force, t_s=data.t_s)
    )
    change = np.concatenate([[again.bias[1] - fit.bias[1]], again.g_sensitivity[1] - fit.g_sensitivity[1]]) / 1e-9
    np.testing.assert_allclose(change, fit.gain[1, :, 2], rtol=2e-3, atol=1e-4)  # the weights move a little, too


def test_unknown_noise_comes_from_the_residuals():
    data = rests(np.concatenate([SEVEN, SEVEN]), 1)
    known = fit_static_g_sensitivity(data)
    unknown = fit_static_g_sensitivity(
        RestingRates(measured=data.measured, variance=0 * data.variance, force=data.force, t_s=data.t_s)
    )
    ratio = np.sqrt(np.diag(unknown.covariance) / np.diag(known.covariance))
    assert ((ratio > 0.5) & (ratio < 2.0)).all()


def test_without_g_sensitivity_the_bias_alone():
    fit = fit_static_g_sensitivity(rests(SEVEN, 1), g_sensitivity=False)
    assert not fit.g_sensitivity.any()
    assert not fit.covariance[3:].any()


@pytest.mark.parametrize(
    ("up", "message"),
    [
        (FACES[:5], "at least 6"),
        (FACES[[0, 1, 3, 4, 0, 1, 3, 4]], "hardly changes along one axis"),
        (np.array([[1, 0, 0]] * 4 + [[0, 1, 0]] * 4 + [[0, 0, 1]] * 4, float) - 1 / 3, "hardly changes"),
    ],
)
def test_attitudes_that_do_not_suffice(up, message):
    with pytest.raises(InitialisationError, match=message):
        fit_static_g_sensitivity(rests(up, 0))


def test_an_order_in_which_drift_looks_like_g_sensitivity():
    up = np.column_stack(
        [np.linspace(-1, 1, 9), np.tile([1, -1, 0], 3), np.repeat([1, -1, 0], 3) * np.tile([0, 0, 1], 3)]
    )
    with pytest.raises(InitialisationError, match="looks like g-sensitivity"):
        fit_static_g_sensitivity(rests(up, 0))
