"""Comparisons of cameras that were calibrated without an IMU, among each other and with calibrations that have one."""

from dataclasses import replace

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from cameras_result import make_cameras_result
from gnomon.assess.comparison.candidates import ComparisonCandidate
from gnomon.assess.comparison.comparing import compare_candidates
from gnomon.assess.comparison.quantities import statement_of
from gnomon.geometry.rotations import invert_matrix, rotation_from_rotvec, rotvec_from_rotation
from gnomon.report.comparison import comparison_page, write_comparison_report
from gnomon.results.calibration import Covariance
from html_page import Page


def candidate(name, **changes):
    """A calibration whose sigmas are right: its estimates are drawn from the covariance that they have."""
    result = make_cameras_result(trust=False, **changes)
    calibration = result.calibration
    honest = Covariance(names=calibration.uncertainty.names, matrix=calibration.uncertainty.matrix / 1.3**2)
    inputs = tuple(replace(source, sha256=name * 32) for source in calibration.provenance.inputs)
    provenance = replace(calibration.provenance, inputs=inputs)
    return ComparisonCandidate.of(name, replace(calibration, uncertainty=honest, provenance=provenance))


def moved(one, *, shift=(0.0, 0.0, 0.0), focal=0.0, upside_down=False):
    camera = one.cameras["cam1"]
    T = camera.T_cam_body.copy()
    T[:3, 3] += shift
    T = invert_matrix(T) if upside_down else T
    lens = camera.camera.with_parameters(camera.camera.parameters + np.eye(len(camera.camera.parameters))[0] * focal)
    return replace(one, cameras={**one.cameras, "cam1": replace(camera, T_cam_body=T, camera=lens)})


@pytest.fixture(scope="module")
def three():
    return [candidate(name, seed=seed) for name, seed in (("mon", 3), ("tue", 4), ("wed", 5))]


def test_honest_ones_agree_in_lens_and_baseline(three):
    comparison = compare_candidates(three)
    assert [block.path for block in comparison.blocks] == [
        "cam0.lens", "cam1.cam0.rotation", "cam1.cam0.translation", "cam1.lens",
    ]  # fmt: skip
    assert comparison.frame == "cam0"
    assert comparison.verdict == "pass", comparison.headline
    assert comparison.compared == 3 * (8 + 3 + 3 + 8)
    assert 0.7 < comparison.z_rms < comparison.limit
    assert all(block.names == ("mon", "tue", "wed") for block in comparison.blocks)
    assert comparison.findings == ()  # the lenses differ by chance, which is nothing to be told
    assert max(lens.rms_px for lens in comparison.lenses) > 0.05


def test_the_one_with_another_baseline_is_named(three):
    comparison = compare_candidates([*three[:2], moved(three[2], shift=(2e-3, 0, 0))])
    assert comparison.outside == ("wed",)
    assert comparison.verdict == "fail"
    assert "the translation of cam1 against cam0 by 2 mm" in comparison.headline


def test_another_focal_length_is_found(three):
    comparison = compare_candidates([three[0], moved(three[1], focal=3.0)])
    assert comparison.verdict == "fail"
    assert "lens of cam1" in comparison.headline
    codes = [finding.code for finding in comparison.findings]
    assert "lenses-differ" in codes
    assert "gravity-differs" not in codes


def test_inverse_baseline_is_recognised(three):
    turned = moved(three[1], shift=(0.0, 0.05, 0.0), upside_down=True)
    first = moved(three[0], shift=(0.0, 0.05, 0.0))
    found = [finding for finding in compare_candidates([first, turned]).findings if finding.code == "pose-inverted"]
    assert len(found) == 1
    assert "T_cam_cam0 of cam1 in mon" in found[0].message
    assert "IMU" not in found[0].consequence + found[0].cure


def test_one_camera_under_another_name(three):
    one = candidate("one", seed=6, cameras=1).renamed({"cam0": "cam1"})
    assert one.covariance is not None
    comparison = compare_candidates([three[0], one])
    assert [block.path for block in comparison.blocks] == ["cam1.lens"]
    assert comparison.verdict == "pass"


def test_exchanged_names_do_not_mix_up_poses(three):
    """Poses to another camera are another quantity: only the lenses are compared."""
    exchanged = three[1].renamed({"cam0": "cam1", "cam1": "cam0"})
    comparison = compare_candidates([three[0], exchanged])
    assert {block.kind for block in comparison.blocks} == {"lens"}


def with_imu():
    """A camera-IMU calibration whose covariance is full, of the pose of both cameras."""
    calibration = make_camera_imu_result(cameras=2, duration_s=5.0).calibration
    rng = np.random.default_rng(8)
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    root = rng.normal(size=(len(sigma), len(sigma)))
    matrix = (root @ root.T) / len(sigma) * sigma[:, None] * sigma
    return replace(calibration, uncertainty=Covariance(names=calibration.uncertainty.names, matrix=matrix))


def test_poses_to_an_imu_are_compared_as_baselines():
    calibration = with_imu()
    statement = statement_of(ComparisonCandidate.of("with", calibration), frozenset({"cam0"}))
    turn, shift = (statement.quantities[f"cam1.cam0.{part}"] for part in ("rotation", "translation"))
    rng = np.random.default_rng(3)
    paths = [f"cam{i}.T_cam_imu.{part}" for i in range(2) for part in ("rotation", "translation")]
    drawn = rng.multivariate_normal(np.zeros(12), calibration.covariance(*paths), 6000).reshape(-1, 2, 6)
    T = np.tile(np.eye(4), (6000, 2, 1, 1))
    for i in range(2):
        place = calibration.cameras[f"cam{i}"].T_cam_imu
        T[:, i, :3, :3] = place[:3, :3] @ rotation_from_rotvec(drawn[:, i, :3])
        T[:, i, :3, 3] = place[:3, 3] + drawn[:, i, 3:]
    between = T[:, 1] @ np.linalg.inv(T[:, 0])
    small = rotvec_from_rotation(np.ascontiguousarray(turn.rotation.T @ between[:, :3, :3]))
    sample = np.concatenate([small, between[:, :3, 3]], axis=1)
    rows = np.r_[turn.rows, shift.rows]
    stated = statement.covariance[np.ix_(rows, rows)]
    scale = np.sqrt(np.diag(stated))
    assert np.cov(sample.T) / scale / scale[:, None] == pytest.approx(stated / scale / scale[:, None], abs=0.06)
    assert shift.values == pytest.approx(sample[:, 3:].mean(axis=0), abs=2e-5)


def test_with_and_without_an_imu(three):
    comparison = compare_candidates([three[0], ComparisonCandidate.of("with", with_imu())])
    paths = [block.path for block in comparison.blocks]
    assert "cam1.cam0.translation" in paths
    assert "cam1.translation" not in paths  # only one of them states it
    assert comparison.frame == "accel-x"


def test_report_says_what_was_compared(three, tmp_path):
    comparison = compare_candidates(three)
    write_comparison_report(comparison, tmp_path / "r.html")
    text = Page((tmp_path / "r.html").read_text(encoding="utf-8")).text
    for words in ("Poses are to cam0", "Lens of cam0", "Translation of cam1 against cam0 [mm]", "axes of cam0 against",
                  "p_cam1 = T_cam1_cam0 p_cam0", "Where both would see one ray"):  # fmt: skip
        assert words in text, words
    for words in ("T_cam_imu", "Krebs: measured", "m/s²"):
        assert words not in text, words
    assert comparison_page(comparison).title == "Comparison of calibrations"
