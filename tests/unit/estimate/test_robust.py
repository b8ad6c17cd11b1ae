"""Sigmas from few clusters: exact for independent errors, larger where errors are correlated, and parts compared."""

import numpy as np
import pytest

from gnomon.estimate.multiposition.bias_functions import accelerometer_drifts, with_trend
from gnomon.estimate.multiposition.evidence import segment_sums
from gnomon.estimate.multiposition.fit import fit_multiposition
from gnomon.estimate.trust.clusters import (
    ClusterSums,
    _jackknife,
    correlation_time,
    group_into_clusters,
    leave_clusters_out,
    robust_variances,
)
from gnomon.estimate.trust.parts import robust_covariance

NAMES = ("x.scale[0]", "x.scale[1]", "x.scale[2]", "x.bias[0]", "x.bias[1]", "x.bias[2]")
BLOCK = np.array([0, 0, 0, 1, 1, 1])


def linear(rng, stretches=36, rows=2, correlation=0.0, drift=0.0):
    """Return sums of a linear problem at its minimum, and by how much the six estimates are off.

    Parameters
    ----------
    correlation : between errors of neighbouring stretches
    drift : of the biases from the first stretch to the last
    """
    a = np.concatenate([rng.normal(size=(stretches, 3 * rows, 3)), np.tile(np.eye(3), (stretches, rows, 1))], axis=2)
    common = rng.normal(size=(stretches, 3))
    for k in range(1, stretches):
        common[k] = correlation * common[k - 1] + np.sqrt(1 - correlation**2) * common[k]
    common = (correlation > 0) * common + np.linspace(-0.5, 0.5, stretches)[:, None] * drift
    errors = rng.normal(size=(stretches, 3 * rows)) + np.tile(common, rows)
    information = np.einsum("crp,crq->cpq", a, a)
    off = np.linalg.solve(information.sum(axis=0), np.einsum("crp,cr->p", a, errors))
    sums = ClusterSums(
        t_s=np.arange(float(stretches)),
        pull=np.einsum("crp,cr->cp", a, errors - a @ off),
        information=information,
        prior_pull=np.zeros(6),
        prior_information=1e-9 * np.eye(6),
    )
    return sums, off


def found(sums):
    ordinary = np.linalg.inv(sums.total)
    return robust_covariance(sums, np.eye(6), NAMES, ordinary, biases=("x.bias",))


def z_rms(rng, count, **options):
    off, robust_sigma, ordinary_sigma = [], [], []
    for _ in range(count):
        sums, error = linear(rng, **options)
        trust = found(sums).trust
        off.append(error)
        robust_sigma.append(trust.sigma)
        ordinary_sigma.append(trust.ordinary_sigma)
    return [float(np.sqrt(np.mean((np.array(off) / np.array(s)) ** 2))) for s in (robust_sigma, ordinary_sigma)]


@pytest.mark.long
def test_independent_errors_keep_their_sigmas():
    ours, ordinary = z_rms(np.random.default_rng(0), 150)
    assert 0.93 < ordinary < 1.07
    assert 0.9 < ours < 1.05
    few, _ = z_rms(np.random.default_rng(1), 150, stretches=10, rows=1)
    assert 0.85 < few < 1.1


def test_correlated_errors_get_larger_sigmas():
    ours, ordinary = z_rms(np.random.default_rng(2), 100, correlation=0.7)
    assert ordinary > 1.4
    assert ours < 0.75 * ordinary


def test_factors_without_shrinkage_are_right_on_the_average():
    # What was expected of the jackknife for independent errors is what it gives, also with few clusters.
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(300):
        sums, _ = linear(rng, stretches=14, rows=1)
        moved, expected, freedom = _jackknife(sums, np.eye(6))
        ratios.append(np.diag(moved) / expected)
        assert np.all((freedom > 1) & (freedom < 14))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("correlation", "least", "most"), [(0.0, 1.0, 0.92), (0.7, 1.8, 0.95)])
def test_of_many_residuals_a_cluster_only_what_independent_errors_add_is_taken_away(correlation, least, most):
    rng = np.random.default_rng(8)
    factors, plain = [], []
    for _ in range(200):
        sums, _ = linear(rng, stretches=6, rows=1, correlation=correlation)
        factors.append(robust_variances([sums], np.eye(6), BLOCK, many=True).factor)
        moved = leave_clusters_out(sums)
        plain.append(5 / 6 * np.sum(moved**2, axis=0) / np.diag(np.linalg.inv(sums.total)))
    assert np.min(factors) >= 1.0
    assert least < np.mean(factors) < most * np.mean(plain)


def test_memory_makes_clusters_longer():
    rng = np.random.default_rng(4)
    seen = [
        correlation_time(leave_clusters_out(linear(rng, stretches=48, correlation=c)[0]), BLOCK)
        for c in (0.0,) * 20 + (0.8,) * 20
    ]
    assert np.mean(np.array(seen[:20]) > 0) < 0.4
    assert np.mean(np.array(seen[20:]) > 0) > 0.8
    sums, _ = linear(rng, stretches=48)
    phases, length = group_into_clusters(sums, 1)
    assert length == 3
    assert [len(phase) for phase in phases] == [16, 17]
    np.testing.assert_allclose(phases[1].total, sums.total, rtol=1e-12)


def test_a_bias_that_drifts_is_told_apart_from_parts_that_disagree():
    rng = np.random.default_rng(5)
    told = [found(linear(rng, drift=2.0)[0]) for _ in range(12)]
    assert sum(one.instabilities[0].proven for one in told) >= 10
    assert sum(one.trust.splits.z_rms > one.trust.splits.limit for one in told) <= 3
    worst = max(told, key=lambda one: one.instabilities[0].size).instabilities[0]
    assert worst.block == "x.bias"
    assert "last third" in worst.where or "half" in worst.where
    steady = [found(linear(rng)[0]) for _ in range(60)]
    assert sum(one.instabilities[0].proven for one in steady) <= 3
    assert sum(one.trust.splits.z_rms > one.trust.splits.limit for one in steady) <= 4
    pooled = np.sqrt(np.mean([one.trust.splits.z_rms_ordinary**2 for one in steady]))
    assert 0.9 < pooled < 1.1


def test_stretches_add_up_to_the_whole(multiposition):
    """Pulls are zero and information is the Schur complement, with drift and without g-sensitivity."""
    for walk, g_sensitivity in ((0.0, True), (3e-4, True), (0.0, False)):
        problem, _ = multiposition(4, g_sensitivity=2e-4, intervals=24, t_init_s=10.0, gyroscope_bias_walk=walk)
        fit = fit_multiposition(problem.data, g_sensitivity=g_sensitivity)
        sums = segment_sums(fit)
        sigma = np.sqrt(np.diag(fit.arrow.corner_covariance))
        np.testing.assert_allclose((sums.pull.sum(axis=0) + sums.prior_pull) * sigma, 0.0, atol=1e-4)
        inverse = np.linalg.inv(fit.arrow.corner_covariance / np.outer(sigma, sigma))
        np.testing.assert_allclose(sums.total * np.outer(sigma, sigma), inverse, atol=1e-5 * np.abs(inverse).max())


def test_a_drift_that_looks_like_g_sensitivity_is_seen():
    rng = np.random.default_rng(6)
    t_s = np.arange(20.0) * 25
    u = rng.normal(size=(20, 3))
    u[:, 0] += np.linspace(-3, 3, 20)  # the order of attitudes resembles time
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    used = np.ones(20, dtype=bool)
    drift = np.linspace(-1, 1, 20)[:, None] * np.array([1.0, 0.0, 0.0])
    measured = drift + 0.05 * rng.normal(size=(20, 3))
    design = np.column_stack([np.ones(20), u])
    residual = measured - design @ np.linalg.lstsq(design, measured, rcond=None)[0]
    trend = with_trend(t_s, measured, residual, u, used)
    assert np.corrcoef(trend[:, 0], drift[:, 0])[0, 1] > 0.99
    assert np.std(residual[:, 0]) < 0.5 * np.std(drift[:, 0])
    np.testing.assert_array_equal(trend[:, 1:], residual[:, 1:])


def test_an_accelerometer_that_drifts_is_seen():
    rng = np.random.default_rng(7)
    seen = {0.0: 0, 0.01: 0}
    for drift in seen:
        for _ in range(40):
            u = rng.normal(size=(24, 3))
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            time = np.linspace(-0.5, 0.5, 24)[:, None]
            measured = u + time * drift * rng.normal(size=3) + 2e-4 * rng.normal(size=(24, 3))
            seen[drift] += accelerometer_drifts(
                time[:, 0] * 500, measured, np.eye(3), np.zeros(3), np.ones(24, dtype=bool)
            )
    assert seen[0.0] <= 3
    assert seen[0.01] >= 36
