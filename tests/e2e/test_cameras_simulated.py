"""Cameras before a board, simulated: the truth lies inside the covariance, whatever the lens and the board.

`pytest tests/e2e/test_cameras_simulated.py -m slow -s` looks at 50 recordings of every lens model, and at healthy ones.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.calibrate.steps.camera_lenses import CANDIDATES
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.options import CameraOptions
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.scenarios.cameras import USUAL_LENSES, CamerasScenario
from support.healthy import healthy_cameras

FEW = {"views": 30}


def errors(calibration, truth):
    """Return what every scalar is off, in the order of the covariance."""
    found = []
    for path in dict.fromkeys(name.partition("[")[0] for name in calibration.uncertainty.names):
        one, other = calibration.parameter(path), truth.parameter(path)
        if path.endswith(".rotation"):
            found.append(rotvec_from_rotation(rotation_from_rotvec(other).T @ rotation_from_rotvec(one)))
        else:
            found.append(np.ravel(one - other))
    return np.concatenate(found)


def squared(calibration, truth):
    """Return chi-square of what was estimated, and its degrees of freedom."""
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    free = sigma > 0
    z = errors(calibration, truth)[free] / sigma[free]
    correlation = calibration.uncertainty.matrix[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    return float(z @ np.linalg.solve(correlation, z)), int(free.sum())


@pytest.mark.first(4)
@pytest.mark.parametrize("model", USUAL_LENSES)
def test_truth_is_inside_the_covariance(model):
    simulation = simulate_cameras(CamerasScenario.with_lens(model, **FEW), 3)
    options = CameraOptions(model=(model,), board="stated")
    calibration = calibrate_cameras(simulation.recording, simulation.target, options).calibration
    assert calibration.verdict == "pass"
    total, freedom = squared(calibration, simulation.truth)
    assert 0.0005 < chi2.sf(total, freedom) < 0.9995


@pytest.mark.parametrize("model", ["pinhole-radtan", "pinhole-radtan5", "pinhole-equidistant"])
def test_the_lens_model_is_found(model):
    simulation = simulate_cameras(CamerasScenario.with_lens(model, **FEW), 2)
    result = calibrate_cameras(simulation.recording, simulation.target)
    fit = result.calibration.assessment.cameras
    assert result.calibration.cameras["cam0"].camera.model == model
    assert fit.models["cam0"][0] == model
    assert fit.holdout_rms_px["cam0"] == pytest.approx(0.15, abs=0.01)
    assert result.calibration.verdict == "pass"


def test_a_simpler_model_is_taken_where_it_predicts_as_well():
    simulation = simulate_cameras(CamerasScenario.with_lens("ds-none", **FEW), 2)
    result = calibrate_cameras(simulation.recording, simulation.target, CameraOptions(among=CANDIDATES))
    assert len(result.calibration.cameras["cam0"].camera.parameters) == 6
    unseen = {trial.model: trial.holdout_rms_px for trial in result.diagnostics.trials}
    assert unseen["pinhole-radtan"] > 3 * unseen["ds-none"]


@pytest.mark.parametrize("kind", ["checkerboard", "charuco", "circlegrid"])
def test_places_of_two_cameras_with_other_boards(kind):
    scenario = CamerasScenario(
        views=25, cameras=2, target_type=kind, target_cols=8, target_rows=6, target_size_m=0.06, fill=(0.3, 0.7)
    )
    simulation = simulate_cameras(scenario, 1)
    options = CameraOptions(model=("pinhole-radtan",), board="stated")
    calibration = calibrate_cameras(simulation.recording, simulation.target, options).calibration
    total, freedom = squared(calibration, simulation.truth)
    assert 0.0005 < chi2.sf(total, freedom) < 0.9995
    apart = calibration.cameras["cam1"].T_cam_body[:3, 3] - simulation.truth.cameras["cam1"].T_cam_body[:3, 3]
    assert np.abs(apart).max() < 3e-4


def test_a_known_baseline_tells_the_size_of_the_board():
    simulation = simulate_cameras(CamerasScenario(views=25, cameras=2, target_scale=1.02), 1)
    options = CameraOptions(model=("pinhole-radtan",), baseline=0.11, board="stated")
    calibration = calibrate_cameras(simulation.recording, simulation.target, options).calibration
    fit = calibration.assessment.cameras
    assert fit.print_scale == pytest.approx(1.02, abs=4 * fit.print_scale_sigma)
    assert fit.print_scale_sigma == pytest.approx(1e-4 / 0.11, rel=0.5)
    assert np.linalg.norm(calibration.cameras["cam1"].T_cam_body[:3, 3]) == pytest.approx(0.11, abs=1e-9)
    total, freedom = squared(calibration, simulation.truth)
    assert 0.0005 < chi2.sf(total, freedom) < 0.9995


def test_what_the_board_is_like_is_found():
    scenario = CamerasScenario(views=30, board_aspect=2e-3, board_bow_m=(1e-3, 0.0))
    simulation = simulate_cameras(scenario, 1)
    options = CameraOptions(model=("pinhole-radtan",))
    result = calibrate_cameras(simulation.recording, simulation.target, options)
    fit = result.calibration.assessment.cameras
    assert set(fit.board_added) == {"target.aspect", "target.bow"}
    assert fit.aspect == pytest.approx(2e-3, abs=4 * fit.aspect_sigma)
    assert fit.bow_m == pytest.approx(1e-3, abs=4 * fit.bow_sigma_m)
    total, freedom = squared(result.calibration, simulation.truth)
    assert 0.0005 < chi2.sf(total, freedom) < 0.9995


def test_errors_that_a_view_shares_widen_the_sigmas():
    simulation = simulate_cameras(CamerasScenario(views=40, view_bias_px=0.15), 2)
    robust, ordinary = (
        calibrate_cameras(
            simulation.recording,
            simulation.target,
            CameraOptions(model=("pinhole-radtan",), board="stated", covariance=covariance),
        ).calibration
        for covariance in ("robust", "ordinary")
    )
    assert (robust.sigma("cam0.intrinsics") > 1.5 * ordinary.sigma("cam0.intrinsics")).all()
    assert "model-incomplete" in [finding.code for finding in robust.assessment.findings]
    total, freedom = squared(robust, simulation.truth)
    assert chi2.sf(total, freedom) > 0.001


def test_a_video_is_thinned_to_what_tells():
    scenario = CamerasScenario(views=300, between=15, rate_hz=15.0)
    simulation = simulate_cameras(scenario, 1)
    result = calibrate_cameras(simulation.recording, simulation.target, CameraOptions(model=("pinhole-radtan",)))
    assert 20 <= result.calibration.assessment.cameras.views_used["cam0"] < 200
    assert result.calibration.verdict == "pass"
    total, freedom = squared(result.calibration, simulation.truth)
    assert chi2.sf(total, freedom) > 0.0005


@pytest.mark.slow
@pytest.mark.parametrize("model", USUAL_LENSES)
def test_chi_square_of_fifty_recordings(model):
    total, freedom = 0.0, 0
    for seed in range(50):
        simulation = simulate_cameras(CamerasScenario.with_lens(model), seed)
        options = CameraOptions(model=(model,))
        calibration = calibrate_cameras(simulation.recording, simulation.target, options).calibration
        one, count = squared(calibration, simulation.truth)
        total, freedom = total + one, freedom + count
    print(f"{model:22} chi2 {total:.0f} of {freedom}, p = {chi2.sf(total, freedom):.3g}")
    assert 0.7 < total / freedom < 1.3


@pytest.mark.slow
def test_nothing_is_said_against_healthy_recordings():
    for seed in range(25):
        simulation = simulate_cameras(healthy_cameras(seed), seed)
        calibration = calibrate_cameras(simulation.recording, simulation.target).calibration
        loud = [str(one) for one in calibration.assessment.findings if one.severity in ("warning", "problem")]
        assert calibration.verdict == "pass", (seed, loud)


def test_nothing_is_said_against_a_healthy_recording():
    simulation = simulate_cameras(healthy_cameras(2), 2)
    assert calibrate_cameras(simulation.recording, simulation.target).calibration.verdict == "pass"
