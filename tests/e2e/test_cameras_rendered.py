"""From rendered images to lenses: whether the truth is inside the covariance, and how exact a stereo baseline is.

pytest tests/e2e/test_cameras_rendered.py -m slow -s      every lens model, several seeds; minutes
python tests/e2e/test_cameras_rendered.py 50              the same with 50 seeds; an hour
"""

import sys

import numpy as np
import pytest
from scipy.stats import chi2

from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.calibrate.steps.board_corners import CameraImages, detect_corners
from gnomon.formats.kalibr.camchain import CameraInput
from gnomon.models.camera import Camera
from gnomon.options import CameraOptions
from gnomon.recording import Recording
from gnomon.simulate.cameras import CamerasScenario, simulate_cameras
from gnomon.simulate.images.board_images import rendered_cameras
from gnomon.simulate.scenarios.cameras import USUAL_LENSES

SEEDS = 4


def detected(simulation):
    """The recording as the detector has it, of rendered images."""
    cameras = {}
    for name, stream in rendered_cameras(simulation).streams.items():
        known = CameraInput(camera=Camera.nominal(simulation.scenario.resolution, stream.topic))
        images = CameraImages(name=name, stream=stream, known=known, lens_known=False)
        cameras[name] = detect_corners(images, simulation.target, workers=1).frames
    return Recording(imus={}, cameras=cameras)


def calibrated(model="pinhole-radtan", seed=1, views=30, **changes):
    intrinsics, coeffs = USUAL_LENSES[model]
    projection, distortion = model.split("-")
    scenario = CamerasScenario(
        images=True, views=views, projection=projection, distortion=distortion, intrinsics=intrinsics,
        distortion_coeffs=coeffs, **changes,
    )  # fmt: skip
    simulation = simulate_cameras(scenario, seed)
    return simulation, calibrate_cameras(detected(simulation), simulation.target, CameraOptions(model=(model,)))


def nees(simulation, calibration, name="cam0"):
    """Joint chi2 of all parameters of a lens, and their number."""
    found, true = (side.cameras[name].camera.parameters for side in (calibration, simulation.truth))
    names = list(calibration.uncertainty.names)
    at = [names.index(f"{name}.{part}") for part in calibration.cameras[name].camera.parameter_names]
    covariance = calibration.uncertainty.matrix[np.ix_(at, at)]
    off = found - true
    return float(off @ np.linalg.solve(covariance, off)), len(off)


def baseline_error_mm(simulation, calibration):
    found, true = (side.cameras["cam1"].T_cam_body[:3, 3] for side in (calibration, simulation.truth))
    return 1e3 * float(np.linalg.norm(found) - np.linalg.norm(true)), 1e3 * float(np.linalg.norm(found - true))


@pytest.mark.long
def test_a_lens_from_images_is_the_true_one():
    simulation, result = calibrated(seed=3)
    value, degrees = nees(simulation, result.calibration)
    assert value < chi2.ppf(1 - 1e-4, degrees)  # straight edges in the fit of corners made it 49 of 8
    found, true = (side.cameras["cam0"].camera.parameters for side in (result.calibration, simulation.truth))
    assert np.abs(found - true)[:4].max() < 0.05
    assert result.calibration.assessment.cameras.reprojection_rms_px["cam0"] < 0.05


@pytest.mark.long
def test_a_stereo_baseline_is_exact_to_a_twentieth_of_a_millimetre():
    simulation, result = calibrated(seed=2, cameras=2, views=14)
    length, place = baseline_error_mm(simulation, result.calibration)
    assert abs(length) < 0.05
    assert place < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("model", USUAL_LENSES)
def test_the_truth_is_inside_the_covariance(model):
    values = [nees(*pair) for pair in studied(model, SEEDS)]
    total, degrees = (sum(column) for column in zip(*values, strict=True))
    print(f"{model}: joint chi2 {total:.1f} of {degrees}, {[round(value, 1) for value, _ in values]}")
    assert chi2.ppf(1e-4, degrees) < total < chi2.ppf(1 - 1e-4, degrees)


@pytest.mark.slow
def test_stereo_baselines():
    errors = np.array([baseline_error_mm(*pair) for pair in studied("pinhole-radtan", SEEDS, cameras=2)])
    print(f"baseline: length {errors[:, 0].round(4)} mm, place {errors[:, 1].round(4)} mm")
    assert np.abs(errors[:, 0]).max() < 0.05


def studied(model, seeds, **changes):
    for seed in range(1, seeds + 1):
        simulation, result = calibrated(model, seed, **changes)
        yield simulation, result.calibration


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS
    for name in sys.argv[2:] or USUAL_LENSES:
        pairs = [nees(*pair) for pair in studied(name, count)]
        chance = [float(chi2.cdf(value, number)) for value, number in pairs]
        total, degrees = (sum(column) for column in zip(*pairs, strict=True))
        print(
            f"{name}: mean chi2 over its expectation {total / degrees:.2f}, {np.mean(np.array(chance) < 0.95):.0%} "
            f"inside 95 %, chance of the sum {chi2.sf(total, degrees):.2g}, {np.round(sorted(chance), 2).tolist()}",
            flush=True,
        )
