"""Findings that calibrations from magnitudes share."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gnomon.assess.imu.imu_verdict import unit_findings
from gnomon.assess.imu.poses_verdict import redundancy_findings, relative_sigmas, scatter_findings
from gnomon.assess.verdict import grade_value
from gnomon.estimate.triads.triad import fit_triad
from gnomon.estimate.triads.triad_problem import TriadPoses

AXES = np.concatenate([np.eye(3), -np.eye(3)])
BETWEEN = np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1], [-1, 1, 0], [1, 0, -1], [0, -1, 1]]) / np.sqrt(2)


def fitted(count=12, noise=0.01, stated=0.01, **options):
    rng = np.random.default_rng(1)
    u = np.concatenate([AXES, BETWEEN])[:count]
    measured = 9.8 * u * [1.01, 0.99, 1.0] + 0.1 + rng.normal(0, noise, u.shape)
    return fit_triad(TriadPoses.of(measured, 9.8, variance=stated**2), robust=False, **options)


def test_grades():
    assert [grade_value(value, 1.0, 2.0) for value in (0.5, 1.5, 2.5, np.nan)] == [
        "good",
        "warning",
        "problem",
        "problem",
    ]


def test_few_poses_are_told():
    (finding,) = redundancy_findings(fitted(10))
    assert finding.code == "few-redundant"
    assert "10 equations for 9 unknowns leave 1" in finding.message
    assert redundancy_findings(fitted(12)) == []


def test_scatter_is_told_where_noise_does_not_explain_it():
    fit = fitted(noise=0.05, stated=0.001)
    (finding,) = scatter_findings(fit, 0.001, 9.8, "m/s^2")
    assert finding.code == "beyond-noise"
    assert finding.severity == "warning"
    assert scatter_findings(replace(fit, extra_sigma=0.01), 0.001, 9.8, "m/s^2")[0].severity == "info"
    assert scatter_findings(fitted(), 0.01, 9.8, "m/s^2") == []


@pytest.mark.parametrize(
    ("scales", "unit", "says"),
    [
        ([1.05, 0.9, 1.1], "rad/s", ""),
        ([57.3, 57.3, 56.0], "rad/s", "like deg/s"),
        ([1.0, 10.0, 1.1], "rad/s", "y axis reads 9.09 times what the others do"),
        ([1.0, 1.0, 57.3], "deg/s", "z axis reads 57.3 times what the others do"),
        ([820.0, 830.0, 410.0], "count", "x axis|z axis reads 0.5 times what the others do"),
        ([820.0, 830.0, 810.0], "count", ""),
    ],
)
def test_one_axis_in_another_unit_is_told_from_a_unit_of_all(scales, unit, says):
    """An axis ten times as large was said to be a sample rate that is wrong."""
    found = unit_findings("gyroscope", np.diag(scales) @ (np.eye(3) + 0.01), unit)
    assert [finding.code for finding in found] == ["unit"] * bool(says)
    assert all(re.search(says, finding.message) for finding in found)


def test_relative_sigmas_at_an_unknown_scale_are_those_at_a_known_one():
    known, unknown = relative_sigmas(fitted()), fitted(unknown_scale=True)
    free = np.tril(np.ones((3, 3), dtype=bool), -1)
    np.testing.assert_allclose(relative_sigmas(unknown)[free], known[free], rtol=1e-2)
    plain = unknown.sigma[[0, 4, 8]] / np.diag(unknown.sensitivity)
    assert (plain > 0.1).all()
    assert (np.diag(relative_sigmas(unknown)) < 0.003).all()
