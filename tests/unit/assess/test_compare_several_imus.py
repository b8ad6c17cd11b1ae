"""Calibrations of several IMUs compared: their poses and clocks beside the rest, and what is weakly known of them."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.assess.comparison.candidates import ComparisonCandidate
from gnomon.assess.comparison.comparing import compare_candidates
from gnomon.assess.observability import known_of, weak_directions, weak_findings
from gnomon.geometry.rotations import invert_matrix, rotation_from_rotvec
from gnomon.results.calibration import Covariance, Provenance

SIGMA = 1e-4


@pytest.fixture(scope="module")
def truth():
    scenario = CameraImuScenario(duration_s=1.0, imus=2, accelerometer_delay_s=0.002, imu_time_shift_s=0.3)
    return simulate_camera_imu(scenario, seed=3).truth


def estimate(truth, seed, change=None):
    """Return a calibration that is off by its sigmas, 1e-4 of every scalar; `change` alters imu1 further."""
    rng = np.random.default_rng(seed)
    names = truth.uncertainty.names

    def off(shape=()):
        return SIGMA * rng.standard_normal(shape)

    imus = {}
    for name, imu in truth.imus.items():
        a, g, T = imu.accelerometer, imu.gyroscope, imu.T_imu_body
        if T is not None:
            T = T.copy()
            T[:3, :3], T[:3, 3] = T[:3, :3] @ rotation_from_rotvec(off(3)), T[:3, 3] + off(3)
        imus[name] = replace(
            imu, accelerometer=replace(a, bias=a.bias + off(3), time_shift_s=a.time_shift_s + off()),
            gyroscope=replace(g, bias=g.bias + off(3)), T_imu_body=T,
            time_shift_s=0.0 if T is None else imu.time_shift_s + off(),
        )  # fmt: skip
    imus["imu1"] = (change or (lambda imu: imu))(imus["imu1"])
    uncertain = ("bias", "T_imu_body", "time_shift")
    variance = [SIGMA**2 if any(word in name and "cam" not in name for word in uncertain) else 0.0 for name in names]
    return replace(
        truth, imus=imus, uncertainty=Covariance(names=names, matrix=np.diag(variance)),
        provenance=Provenance(gnomon_version="0", method="batch"),
    )  # fmt: skip


def comparison(*calibrations):
    return compare_candidates(
        [ComparisonCandidate.of(f"run{i}", calibration) for i, calibration in enumerate(calibrations)]
    )


def test_honest_ones_agree_in_pose_and_clock(truth):
    found = comparison(*(estimate(truth, seed) for seed in range(12)))
    blocks = {block.path: block for block in found.blocks}
    ours = ("imu1.imu0.rotation", "imu1.imu0.translation", "imu1.time_shift", "imu0.accelerometer.time_shift")
    for path in ours:
        assert 0.5 < blocks[path].z_rms < 1.5, path
        np.testing.assert_allclose(blocks[path].predicted, SIGMA, rtol=0.03)
    assert not [finding for finding in found.findings if finding.severity in ("warning", "problem")]


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda imu: replace(imu, T_imu_body=invert_matrix(imu.T_imu_body)), "pose-inverted", "T_imu_body of imu1"),
        (lambda imu: replace(imu, time_shift_s=-imu.time_shift_s), "shift-sign", "imu1"),
    ],
)
def test_wrong_ways_round_are_recognised(truth, change, code, words):
    found = comparison(estimate(truth, 1), estimate(truth, 2, change))
    named = next(finding for finding in found.findings if finding.code == code)
    assert words in named.message
    assert "imu0" in named.cure


def test_an_imu_that_was_moved_is_named(truth):
    def moved(imu):
        T = imu.T_imu_body.copy()
        T[0, 3] += 0.004
        return replace(imu, T_imu_body=T)

    found = comparison(*(estimate(truth, seed) for seed in range(3)), estimate(truth, 9, moved))
    worst = max(found.differences, key=lambda item: float(np.nanmax(np.abs(item.z))))
    assert worst.path == "imu1.imu0.translation"
    assert "run3" in (worst.first, worst.second)
    assert any("translation of imu1 against imu0" in finding.message for finding in found.findings)


def test_which_motion_a_pose_of_an_imu_lacks(truth):
    names = truth.uncertainty.names
    along = truth.imus["imu1"].T_imu_body[:3, :3] @ np.array([0.0, 0.0, 1.0])  # the body's z, in axes of imu1
    matrix = np.diag([1e-8 if name.startswith(("imu1.T", "imu1.time")) else 0.0 for name in names])
    rows = [names.index(f"imu1.T_imu_body.translation[{k}]") for k in range(3)]
    matrix[np.ix_(rows, rows)] += 0.8**2 * np.outer(along, along)
    weak = weak_directions(known_of(truth.imus, truth.cameras, matrix, duration_s=60.0))
    assert len(weak) == 1
    assert weak[0].held
    words = "The translation of imu1 against imu0 along imu0's z axis is not known"
    assert weak[0].words == f"{words}: rotation about imu0's x axis and y axis is missing."
    assert weak[0].cure.startswith("Turn the rig about imu0's x axis and y axis")
    assert weak_findings(weak, with_camera=True)[0].severity == "problem"


def test_which_imu_lacks_a_motion_is_said(truth):
    names = truth.uncertainty.names
    matrix = np.diag([0.05**2 if name.startswith("imu1.gyroscope.sens") else 0.0 for name in names])
    weak = weak_directions(known_of(truth.imus, truth.cameras, matrix, duration_s=60.0))
    assert weak[0].words.startswith("The scales and axes of the gyroscope of imu1 are known to")
