"""Rendered images -> calibration: the truth is where the standard deviations say."""

import json
import shutil

import numpy as np
import pytest
import yaml

import gnomon
import recorded

MOST_SIGMAS = 4.5
SEEDS = (1, 2, 3)


@pytest.fixture(scope="module")
def calibrated(run, walks, tmp_path_factory):
    """Return a function that renders and calibrates a recording, once: result, truth, document, folder.

    Corners that an earlier run kept spare the time to find them again.
    """
    made = {}

    def result(*arguments, seed=1, corners=None, **changes):
        key = (*map(str, arguments), seed, json.dumps(changes))
        if key not in made:
            source, out = walks.rendered(seed=seed, **changes), tmp_path_factory.mktemp("result")
            for kept in corners.glob("corners-*") if corners else ():
                shutil.copy(kept, out)
            words = ("-o", out, "--no-report", "--json", "--gravity", 9.80665)
            code, text, err = run("camera-imu", source, *words, *arguments)
            assert code == 0, err
            assert (corners is not None) == ("in the images of cam0" not in err)
            made[key] = gnomon.load(out / "calibration.yaml"), recorded.truth_of(source), json.loads(text), out
        return made[key]

    return result


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_an_aprilgrid(calibrated, seed):
    result, truth, _, _ = calibrated(seed=seed)
    assert recorded.most_sigmas(result, truth) < MOST_SIGMAS
    shift = result.cameras["cam0"].time_shift_cam_imu
    assert abs(shift - truth.cameras["cam0"].time_shift_cam_imu) < 50e-6


@pytest.mark.slow
def test_uncertainties_are_neither_too_small_nor_too_large(calibrated):
    """Root mean square of all errors in sigmas, over several recordings."""
    errors = [recorded.errors_in_sigmas(*calibrated(seed=seed)[:2]) for seed in SEEDS]
    together = np.concatenate([error for found in errors for error in found.values()])
    assert len(together) > 90
    assert 0.7 < np.sqrt(np.mean(together**2)) < 1.3


@pytest.mark.long
def test_a_checkerboard(calibrated):
    result, truth, _, _ = calibrated(**recorded.CHECKERBOARD)
    assert recorded.most_sigmas(result, truth) < MOST_SIGMAS


@pytest.mark.long
def test_two_cameras(calibrated):
    """The camera chain is known far better than either camera from the IMU."""
    result, truth, document, _ = calibrated(cameras=2)
    assert set(result.cameras) == {"cam0", "cam1"}
    assert recorded.most_sigmas(result, truth) < MOST_SIGMAS
    found, true = (c.cameras["cam1"].T_cam_imu @ np.linalg.inv(c.cameras["cam0"].T_cam_imu) for c in (result, truth))
    assert np.abs(found[:3, 3] - true[:3, 3]).max() < 0.2e-3
    assert np.abs(found[:3, :3] - true[:3, :3]).max() < 2e-4
    assert document["baselines"]


@pytest.fixture
def doubtful_lens(walks, tmp_path):
    """Return a function that writes a camchain.yaml with intrinsics that are off by 0.9 and 1 px, and perhaps more."""

    def write(**more):
        file = tmp_path / "camchain.yaml"
        shutil.copy(walks.rendered() / "camchain.yaml", file)
        chain = yaml.safe_load(file.read_text())
        off = {"intrinsics": [u + d for u, d in zip(chain["cam0"]["intrinsics"], (0.9, 0.9, 1, 1), strict=True)]}
        recorded.edited(file, {"cam0": chain["cam0"] | off | more})
        return file

    return write


def test_stated_intrinsics_that_are_off_are_noticed(calibrated, doubtful_lens):
    *_, earlier = calibrated()
    taken_up, truth, _, _ = calibrated("--cam", doubtful_lens(), corners=earlier)
    assert recorded.most_sigmas(taken_up, truth) < MOST_SIGMAS
    assert "intrinsics" in taken_up.assessment.trust.added
    result, truth, _, _ = calibrated("--cam", doubtful_lens(), "--model", "full", corners=earlier)
    assert recorded.most_sigmas(result, truth) > MOST_SIGMAS
    assert "intrinsics-doubtful" in {
        finding.code for finding in result.assessment.findings if finding.severity in {"warning", "problem"}
    }


def test_intrinsics_with_a_sigma_are_estimated_too(calibrated, doubtful_lens):
    """intrinsics_sigma in camchain.yaml, then the covariance in the result of that: the same wrong lens comes right."""
    *_, earlier = calibrated()
    sigmas = {"intrinsics_sigma": [1.0] * 4, "distortion_coeffs_sigma": [1e-3, 1e-3, 1e-4, 1e-4]}
    result, truth, _, out = calibrated("--cam", doubtful_lens(**sigmas), corners=earlier)
    assert recorded.most_sigmas(result, truth) < MOST_SIGMAS
    assert "cam0.intrinsics" in recorded.errors_in_sigmas(result, truth)
    assert (result.sigma("cam0.intrinsics") < 0.3).all()
    *_, kept = calibrated(seed=2)
    other, truth, _, _ = calibrated("--cam", out / "calibration.yaml", seed=2, corners=kept)
    assert recorded.most_sigmas(other, truth) < MOST_SIGMAS
    assert (other.sigma("cam0.intrinsics") > 0).all()
    assert (other.sigma("cam0.intrinsics") < result.sigma("cam0.intrinsics")).all()


def test_an_earlier_result_starts_another_recording_of_the_same_rig(calibrated, walks):
    """Without a sigma of the lens in it the lens stays as it is; its extrinsics are only the start."""
    (*_, out), (*_, kept) = calibrated(), calibrated(seed=2)
    result, truth, _, _ = calibrated("--cam", out / "calibration.yaml", seed=2, corners=kept)
    assert recorded.most_sigmas(result, truth) < MOST_SIGMAS
    np.testing.assert_array_equal(result.cameras["cam0"].camera.intrinsics, truth.cameras["cam0"].camera.intrinsics)
