"""Corners that are means over an exposure: its length joins the model by evidence, and then biases nothing."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from camera_imu_truth import errors
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.simulate.camera_imu_streams import View

SCENARIO = CameraImuScenario(
    duration_s=15.0, motion="shaky", camera_rate_hz=15.0, target_cols=4, target_rows=4, random_extrinsics=True
)


def exposed(exposure_s, seed):
    """Return a simulation and its recording, each corner the mean of its path over the exposure (Gauss-Legendre)."""
    simulation = simulate_camera_imu(SCENARIO, seed)
    frames, t_s = simulation.recording.cameras["cam0"], simulation.frames["cam0"].exposure_s
    view = View(
        path=simulation.trajectory.path,
        T_cam_cam0=np.eye(4),
        camera=simulation.truth.cameras["cam0"].camera,
        points=simulation.target.points,
    )
    places, weights = np.polynomial.legendre.leggauss(6)
    paths = [view.corners(t_s + exposure_s / 2 * place)[0] for place in places]
    mean = np.tensordot(weights / 2, paths, 1) - view.corners(t_s)[0]
    frames = replace(frames, pixels=frames.pixels + mean[frames.frame, frames.point])
    truth = {**simulation.truth_parameters, "cam0.exposure_squared": np.array(exposure_s**2)}
    recording = replace(simulation.recording, cameras={"cam0": frames})
    return replace(simulation, truth_parameters=truth), recording


@pytest.mark.long
@pytest.mark.parametrize(("exposure_s", "seed"), [(0.01, 1), (0.0, 1)])
def test_an_exposure_is_found_where_there_is_one(exposure_s, seed):
    simulation, recording = exposed(exposure_s, seed)
    result = calibrate_camera_imu(recording, simulation.target, CameraImuOptions(gravity=SCENARIO.gravity))
    assert result.calibration.assessment.trust.added == (("exposure",) if exposure_s else ())
    assert np.abs(errors(result, simulation).z).max() < 4.0
    told = [one for one in result.calibration.assessment.findings if one.code == "exposure-found"]
    assert [one.severity for one in told] == ["info"] * (exposure_s > 0)
    status = {row.name: row.status for row in result.diagnostics.parameters}
    assert status.get("cam0.exposure_squared", "fixed") == ("estimated" if exposure_s else "fixed")


@pytest.mark.slow
def test_without_it_the_camera_is_off_along_its_optical_axis():
    simulation, recording = exposed(0.01, 1)
    options = CameraImuOptions(gravity=SCENARIO.gravity)
    held = replace(options, fix=("cam0.exposure_squared",))
    with_it, without = (
        errors(calibrate_camera_imu(recording, simulation.target, each), simulation) for each in (options, held)
    )
    along = "cam0.T_cam_imu.translation[2]"
    sigma = with_it.sigma[with_it.names.index(along)]
    assert without.error[without.names.index(along)] > 3 * sigma
