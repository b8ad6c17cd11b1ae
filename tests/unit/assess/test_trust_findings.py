"""What is said of sigmas that the model does not explain, and of parts that disagree."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.assess.cameras.rig_findings import residual_correlation, wandering_residuals
from gnomon.assess.verdict import model_incomplete, parts_disagree, time_shift_varies, uncertainty_summary
from gnomon.results.camera_diagnostics import SignalFit
from gnomon.results.trust import BlockAgreement, Clusters, SigmaRatio, Splits, Trust


def trust(*ratios, clusters=True, splits=None):
    return Trust(
        clusters=Clusters(count=20, length_s=2.5, memory_s=1.0) if clusters else None,
        names=("cam0.time_shift_cam_imu",),
        ordinary_sigma=np.array([1e-5]),
        sigma=np.array([3e-5]),
        ratios=tuple(SigmaRatio(block=f"block{i}", ratio=ratio) for i, ratio in enumerate(ratios)),
        splits=splits,
    )


def parts(z):
    block = BlockAgreement(
        block="cam0.T_cam_imu.rotation", comparisons=12, z_rms=z, z_rms_ordinary=z, largest=2 * z,
        where="[1], first half and second half",
    )  # fmt: skip
    return Splits(splits=("halves", "thirds"), blocks=(block,), z_rms=z, z_rms_ordinary=z, limit=1.3)


def test_large_ratios_are_told_the_worst_first():
    assert model_incomplete(trust(1.0, 1.99)) == []
    assert model_incomplete(trust(3.0, clusters=False)) == []
    (finding,) = model_incomplete(trust(2.5, 1.0, 6.0, 3.0, 4.0), ["the board"], cure="Print it anew.")
    assert (finding.code, finding.severity) == ("model-incomplete", "info")
    assert "block2 6 times, block4 4 times, block3 3 times and 1 more" in finding.message
    assert "Likely missing: the board." in finding.consequence
    assert finding.cure == "Print it anew."


def test_errors_without_memory_do_not_last_for_0_s():
    clusters = Clusters(count=20, length_s=1.0, memory_s=0.0)
    (finding,) = model_incomplete(replace(trust(3.0), clusters=clusters))
    assert "0 s" not in finding.message


def test_parts_disagree_beyond_the_limit_only():
    assert parts_disagree(None) == []
    assert parts_disagree(parts(1.3)) == []
    (finding,) = parts_disagree(parts(1.9))
    assert (finding.code, finding.severity) == ("parts-disagree", "warning")
    assert "cam0.T_cam_imu.rotation by 3.8 sigma: [1], first half and second half" in finding.message


@pytest.mark.parametrize(("ratio", "sigma", "told"), [(16.0, 2e-4, True), (3.0, 2e-4, False), (16.0, 1e-4, False)])
def test_a_time_shift_that_varies_is_told_where_it_matters(ratio, sigma, told):
    """By 0.5 ms, rms of its stretches: the sigma of a mean of twenty is 4.5 times smaller."""
    found = replace(
        trust(), sigma=np.array([sigma]), ratios=(SigmaRatio(block="cam0.time_shift_cam_imu", ratio=ratio),)
    )
    assert [finding.code for finding in time_shift_varies(found)] == told * ["time-shift-varies"]
    assert time_shift_varies(replace(found, clusters=None)) == []


def test_note_keeps_what_counts():
    note = uncertainty_summary(trust(2.5, splits=parts(1.1)))
    assert (note.covariance, note.clusters, note.cluster_s) == ("cluster-robust", 20, 2.5)
    assert note.sigma_ratio == {"block0": 2.5}
    assert note.split_z == 1.1
    note = uncertainty_summary(trust(1.0, clusters=False))
    assert (note.covariance, note.clusters) == ("ordinary", 0)
    assert np.isnan(note.split_z)


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_correlation_of_neighbouring_residuals(share):
    rng = np.random.default_rng(1)
    white = rng.normal(size=(5001, 3))
    residual = white[1:] + share * white[:-1]
    fit = SignalFit(
        t_s=np.arange(5000) / 200, measured=residual, predicted=np.zeros_like(residual), basic=None,
        used=np.ones(5000, dtype=bool), sigma=1.0, unit="rad/s",
    )  # fmt: skip
    assert residual_correlation(fit) == pytest.approx(share / (1 + share**2), abs=0.03)


@pytest.mark.parametrize(("rate_hz", "lasts_s", "named"), [(200, 0.0, False), (1000, 0.03, False), (100, 2.0, True)])
def test_a_gyroscope_that_takes_its_bias_off_by_itself_leaves_residuals_that_last(rate_hz, lasts_s, named):
    """Motion faster than the knots is left over for some hundredths of a second."""
    count, rng = 20 * rate_hz, np.random.default_rng(5)
    residual, kept = rng.standard_normal((count, 3)), np.exp(-1 / (rate_hz * lasts_s)) if lasts_s else 0.0
    for k in range(1, count):
        residual[k] += kept * residual[k - 1]
    fit = SignalFit(
        t_s=np.arange(count) / rate_hz, measured=residual, predicted=np.zeros((count, 3)), basic=None,
        used=np.ones(count, dtype=bool), sigma=1.0, unit="rad/s",
    )  # fmt: skip
    assert [finding.code for finding in wandering_residuals("imu0.gyroscope", fit)] == ["residuals-wander"] * named
    assert not wandering_residuals("imu0.accelerometer", fit)
    shaken = 3 * np.sin(2 * np.pi * 20.0 * fit.t_s)[:, None] + rng.standard_normal((count, 3))
    assert not wandering_residuals("imu0.gyroscope", replace(fit, measured=shaken))
