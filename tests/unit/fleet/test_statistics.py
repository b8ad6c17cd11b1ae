"""Statistics against the numbers of textbooks."""

from fractions import Fraction

import numpy as np
import pytest

from gnomon.fleet.statistics import (
    ewma_chart,
    gauge_study,
    group_offsets,
    individuals_chart,
    normal_limit,
    process_capability,
    robust_population,
    time_changes,
    wilson_interval,
)

# Borenstein, Hedges, Higgins, Rothstein: Introduction to Meta-Analysis (2009), chapter 14, data set 1.
EFFECTS = np.array([0.095, 0.277, 0.367, 0.664, 0.462, 0.185])
VARIANCES = 1 / np.array([30.352, 32.568, 20.048, 95.111, 23.439, 42.698])  # the weights as they are printed
# NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2 (individuals) and 6.3.2.4 (EWMA).
INDIVIDUALS = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])
EWMA = np.concatenate([[52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5], INDIVIDUALS])
# AIAG, Measurement Systems Analysis, 4th edition, table III-B: 10 parts, appraisers A to C, three trials each.
AIAG = np.array(
    [
        [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
        [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
        [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
        [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
        [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
        [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
        [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
    ]
).reshape(3, 3, 10)


def test_random_effects_are_those_of_borenstein():
    found = robust_population(EFFECTS, np.sqrt(VARIANCES), np.inf)
    assert found.heterogeneity == pytest.approx(12.0033, abs=3e-2)  # effects are printed with three digits
    assert found.spread**2 == pytest.approx(0.0372, abs=5e-5)
    assert (found.mean, found.mean_sigma**2) == (pytest.approx(0.3582, abs=1e-4), pytest.approx(0.0111, abs=5e-5))


def test_random_effects_are_the_formula_in_exact_arithmetic():
    y, v = [[Fraction(x).limit_denominator(10**6) for x in series] for series in (EFFECTS, VARIANCES)]
    w = [1 / x for x in v]
    fixed = sum(a * b for a, b in zip(w, y, strict=True)) / sum(w)
    q = sum(a * (b - fixed) ** 2 for a, b in zip(w, y, strict=True))
    tau2 = (q - 5) / (sum(w) - sum(a * a for a in w) / sum(w))
    total = [1 / (x + tau2) for x in v]
    mean = sum(a * b for a, b in zip(total, y, strict=True)) / sum(total)
    found = robust_population(np.array(y, dtype=float), np.sqrt(np.array(v, dtype=float)), np.inf)
    assert found.spread**2 == pytest.approx(float(tau2), abs=1e-12)
    assert found.mean == pytest.approx(float(mean), abs=1e-12)


def test_individuals_are_those_of_nist():
    chart = individuals_chart(INDIVIDUALS)
    reach = 2.66 * 1.8778  # 3 / 1.128, as it is printed
    assert chart.centre[0] == pytest.approx(50.81, abs=1e-12)
    assert chart.upper[0] == pytest.approx(50.81 + reach, abs=3e-3)
    moving = [2.0, 2.3, 1.4, 3.5, 3.4, 1.4, 0.2, 1.2, 1.5]
    assert chart.upper[0] - 50.81 == pytest.approx(1.5 * np.sqrt(np.pi) * sum(moving) / 9, abs=1e-12)
    assert chart.signals == []
    usual = np.append(np.full(len(INDIVIDUALS), True), False)
    with_outlier = individuals_chart(np.append(INDIVIDUALS, 500.0), usual=usual)
    assert (with_outlier.upper[0], with_outlier.signals) == (chart.upper[0], [len(INDIVIDUALS)])


def test_ewma_is_that_of_nist():
    chart = ewma_chart(EWMA, 2.0539, 50.0, weight=0.3)
    expected = [50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33, 50.11, 49.36, 49.52, 50.05,
                49.38, 49.92, 50.73, 51.23, 51.94, 51.99]  # fmt: skip
    np.testing.assert_allclose(chart.points, expected, atol=6e-3)
    assert (chart.lower[-1], chart.upper[-1]) == (pytest.approx(47.4115, abs=4e-3), pytest.approx(52.5884, abs=4e-3))


def test_ewma_limits_are_montgomerys_formula():
    # Montgomery, Introduction to Statistical Quality Control, 6th edition, example 9.2: lambda 0.1, L 2.7, mean 10.
    chart = ewma_chart(np.full(500, 10.0), 1.0, 10.0, weight=0.1, width=2.7)
    i = np.arange(1, 501)
    np.testing.assert_allclose(chart.upper, 10 + 2.7 * np.sqrt(0.1 / 1.9 * (1 - 0.9 ** (2 * i))), rtol=0, atol=1e-12)
    assert (chart.upper[0], chart.upper[-1]) == (pytest.approx(10.27, abs=1e-12), pytest.approx(10.62, abs=6e-3))


def test_gauge_study_is_the_aiags():
    found = gauge_study(AIAG.transpose(2, 0, 1))
    assert found.repeatability == pytest.approx(0.039973, abs=5e-7)
    assert found.reproducibility == pytest.approx(0.051455, abs=5e-7)
    assert found.part == pytest.approx(1.086446, abs=1e-6)
    assert (found.interaction, found.share) == (0.0, pytest.approx(0.2786, abs=5e-5))


def test_capability_is_that_of_nist():
    # e-Handbook, 6.1.6: limits 8 and 20, mean 16, standard deviation 2.
    found = process_capability(16.0, 2.0, lower=8.0, upper=20.0)
    assert (found.cp, found.cpk) == (pytest.approx(1.0, abs=1e-12), pytest.approx(2 / 3, abs=1e-12))
    assert found.yield_expected == pytest.approx(1 - 0.0227501319 - 0.0000316712, abs=1e-9)
    assert process_capability(1.0, 0.5, upper=3.0).cpk == pytest.approx(4 / 3, abs=1e-12)


def test_yield_has_wilsons_interval():
    # Newcombe 1998, table I: 81 of 263.
    low, high = wilson_interval(81, 263)
    assert (low, high) == (pytest.approx(0.2553, abs=5e-5), pytest.approx(0.3662, abs=5e-5))


def test_outliers_do_not_widen_the_spread():
    rng = np.random.default_rng(1)
    sigmas = rng.uniform(0.1, 0.5, 400)
    values = 3 + rng.normal(size=400) + sigmas * rng.normal(size=400)
    values[:5] += 40
    values[10] = np.nan
    found = robust_population(values, sigmas, 4.5)
    assert found.spread == pytest.approx(1.0, abs=0.1)
    assert abs(found.mean - 3) < 4 * found.mean_sigma
    assert np.flatnonzero(~found.kept).tolist() == [0, 1, 2, 3, 4, 10]
    assert np.isnan(found.z[10])


def test_steps_drifts_and_groups_have_honest_z():
    rng = np.random.default_rng(2)
    z = {"step": [], "drift": [], "group": []}
    for _ in range(400):
        variances = rng.uniform(0.5, 2.0, 60)
        values = np.sqrt(variances) * rng.normal(size=60)
        changes = {change.kind: change for change in time_changes(values, variances, np.arange(60.0))}
        z["drift"].append(changes["drift"].z)
        z["step"].append(abs(changes["step"].z) > normal_limit(0.01 / 60))
        z["group"] += [group_offsets(values, variances, np.tile(np.arange(3), 20), ["A", "B", "C"])[0].z]
    assert 0.9 < np.std(z["drift"]) < 1.1
    assert 0.9 < np.std(z["group"]) < 1.1
    assert np.mean(z["step"]) < 0.03
    values[40:] += 5
    (step, _) = time_changes(values, variances, np.arange(60.0))
    assert abs(step.at - 40) <= 1


def test_the_limit_is_that_of_the_normal_distribution():
    assert normal_limit(0.05) == pytest.approx(1.959963984540054, abs=1e-14)
    assert normal_limit(2e-10) == pytest.approx(6.361340902404056, abs=1e-12)
