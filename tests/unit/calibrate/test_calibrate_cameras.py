"""The recipe of a calibration of cameras alone: what is chosen, what is published, and what it rests on."""

import numpy as np
import pytest

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.calibrate.steps.camera_lenses import CANDIDATES, stated_models
from gnomon.errors import OptionError
from gnomon.options import CameraOptions
from gnomon.results.sensors import covariance_names
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.scenarios.cameras import USUAL_LENSES, CamerasScenario


@pytest.fixture(scope="module")
def simulation():
    return simulate_cameras(CamerasScenario(views=25, cameras=2, blurred_views=0.1), 4)


@pytest.fixture(scope="module")
def result(simulation):
    options = CameraOptions(model=("pinhole-radtan",), board="aspect")
    return calibrate_cameras(simulation.recording, simulation.target, options)


def test_models_are_stated_for_all_cameras_or_for_each():
    cameras = ("cam0", "cam1")
    assert stated_models((), cameras) == {}
    assert stated_models(("ds-none",), cameras) == {"cam0": "ds-none", "cam1": "ds-none"}
    assert stated_models(("cam1=eucm-none",), cameras) == {"cam1": "eucm-none"}
    with pytest.raises(OptionError, match="Did you mean pinhole-equidistant"):
        stated_models(("pinhole-equidistan",), cameras)
    with pytest.raises(OptionError, match="there is no cam2"):
        stated_models(("cam2=ds-none",), cameras)


def test_what_is_published_has_names_and_covariance_of_the_cameras_alone(result):
    calibration = result.calibration
    assert calibration.frame == "cam0"
    assert not calibration.imus
    assert calibration.uncertainty.names == covariance_names({}, calibration.cameras)
    matrix = calibration.uncertainty.matrix
    assert np.array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))).min() > 0
    assert calibration.provenance.method == "cameras"
    assert calibration.provenance.options == {"model": "('pinhole-radtan',)", "board": "aspect"}
    assert calibration.assessment.trust.covariance == "cluster-robust"


def test_tables_fit_together(simulation, result):
    diagnostics, fit = result.diagnostics, result.calibration.assessment.cameras
    estimated = [row for row in diagnostics.parameters if row.status == "estimated"]
    assert len(diagnostics.correlation) == len(estimated)
    assert np.allclose(np.diag(diagnostics.correlation), 1.0)
    assert {"target.aspect", "cam1.T_cam_cam0.translation[0]"} <= {row.name for row in estimated}
    assert next(row for row in diagnostics.parameters if row.name == "target.bow[0]").status == "fixed"
    for name, corners in diagnostics.corners.items():
        frames = simulation.recording.cameras[name]
        assert np.array_equal(corners.pixels, frames.pixels)
        used = corners.frame_used[corners.frame]
        assert diagnostics.coverage[name].sum() == np.sum(used & (corners.weight > 0)) == fit.corners_used[name]
        assert np.sqrt(np.mean(corners.residual[used] ** 2)) == pytest.approx(fit.reprojection_rms_px[name])
        assert np.isfinite(corners.residual).all()  # also of views that were left out, about a pose of their own
        assert fit.models[name][0] == "pinhole-radtan"
        assert set(fit.models[name]) == set(CANDIDATES)
    assert {trial.camera for trial in diagnostics.trials if trial.chosen} == {"cam0", "cam1"}
    for view in diagnostics.views:
        k = int(np.flatnonzero(simulation.t_ns == view.t_ns)[0])
        p = -simulation.R_cam0_target[k].T @ simulation.p_cam0_target[k]
        assert np.allclose(view.p_target_cam0, p, atol=5e-3)
        assert view.information > 0


def test_as_many_views_are_used_as_are_asked_for():
    simulation = simulate_cameras(CamerasScenario(views=25), 1)
    options = CameraOptions(model=("pinhole-radtan",), board="stated", views=12)
    calibration = calibrate_cameras(simulation.recording, simulation.target, options).calibration
    assert calibration.assessment.cameras.views_used == {"cam0": 12}


def test_a_second_run_gives_the_same_numbers(simulation, result):
    options = CameraOptions(model=("pinhole-radtan",), board="aspect")
    again = calibrate_cameras(simulation.recording, simulation.target, options)
    assert np.array_equal(again.calibration.uncertainty.matrix, result.calibration.uncertainty.matrix)


@pytest.mark.parametrize("model", USUAL_LENSES)
def test_simulated_corners_are_where_the_lens_sees_the_points(model):
    scenario = CamerasScenario.with_lens(model, views=8, cameras=2, pixel_noise_px=0.0)
    simulation = simulate_cameras(scenario, 5)
    for name, frames in simulation.recording.cameras.items():
        camera = simulation.truth.cameras[name]
        R, p = simulation.R_cam0_target[frames.frame], simulation.p_cam0_target[frames.frame]
        at = np.einsum("mij,mj->mi", R, simulation.points[frames.point]) + p
        T = camera.T_cam_body
        image = camera.camera.project(at @ T[:3, :3].T + T[:3, 3])
        assert np.abs(image.pixels - frames.pixels).max() < 1e-9
        assert (np.bincount(frames.frame) >= 0.4 * len(simulation.target)).all()


@pytest.mark.parametrize(
    "options",
    [{"views": 0}, {"fill": (0.5, 0.2)}, {"spread": 1.5}, {"intrinsics": (1.0, 2.0)}, {"board_aspect": -1.0}],
)
def test_scenarios_that_cannot_be_are_refused(options):
    with pytest.raises(OptionError):
        CamerasScenario(**options)
