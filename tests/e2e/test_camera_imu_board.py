"""A board whose corners are off their places, and a lens that was calibrated with it: nobody's fault, and cured."""

import numpy as np
import pytest

from gnomon.calibrate.camera_imu import calibrate_camera_imu
from gnomon.calibrate.steps import camera_imu_model
from gnomon.estimate.camera_imu import gauss_newton, solution
from gnomon.estimate.camera_imu.batch import linearize_batch
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.options import CameraImuOptions
from gnomon.simulate import CameraImuScenario, simulate_camera_imu

LENS = ("cam0.intrinsics", "cam0.distortion_coeffs", "cam0.k3")


def scenario(**changed):
    """Return what is wrong with the board and the intrinsics of EuRoC's cameras, at that size."""
    fields = {
        "duration_s": 20.0, "pixel_noise_px": 0.2, "corner_offset_m": 5e-4, "board_bow_m": 1e-3, "focal_error": -0.006,
        "principal_point_error_px": 2.0, "distortion": "radtan5", "distortion_coeffs": (-0.32, 0.15, 1e-4, 1e-4, -0.04),
        "distortion_error": (0.04, -0.08, 1e-4, -1e-4, 0.0), "known_k3": False,
    }  # fmt: skip
    return CameraImuScenario(**fields | changed)


def errors(result, simulation):
    """Return name -> error and z (k,) of the blocks that a board spoils."""
    truth = simulation.truth_parameters
    rows = {row.name: row for row in result.diagnostics.parameters}
    found = {}
    for block in ("imu0.S_g", "imu0.S_a", "cam0.T_cam_imu.translation", "cam0.intrinsics", "target.offsets"):
        scalars = [row for name, row in rows.items() if name.startswith(f"{block}[")]
        error = np.array([row.value for row in scalars]) - truth[block].ravel()[: len(scalars)]
        sigma = np.array([row.sigma for row in scalars])
        if scalars and sigma.all():
            found[block] = error, error / sigma
    T = result.calibration.cameras["cam0"].T_cam_imu[:3, :3]
    found["rotation"] = rotvec_from_rotation(rotation_from_rotvec(truth["cam0.T_cam_imu.rotation"]).T @ T), np.zeros(3)
    return found


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.long
def test_board_and_lens_are_found_along():
    simulation = simulate_camera_imu(scenario(), seed=3)
    options = {"compare": False}
    nominal = calibrate_camera_imu(simulation.recording, simulation.target, CameraImuOptions(model="full", **options))
    cured = calibrate_camera_imu(
        simulation.recording,
        simulation.target,
        CameraImuOptions(model="full", free=("target.offsets", *LENS), **options),
    )
    wrong, right = errors(nominal, simulation), errors(cured, simulation)
    assert np.abs(wrong["imu0.S_g"][0]).max() > 3e-3  # as EuRoC's, and far beyond its sigma
    assert np.abs(right["imu0.S_g"][0]).max() < 1e-3
    assert np.abs(wrong["cam0.T_cam_imu.translation"][0]).max() > 4e-3
    assert np.abs(right["cam0.T_cam_imu.translation"][0]).max() < 1e-3
    assert rms(wrong["rotation"][0]) > 5 * rms(right["rotation"][0])
    for block in ("imu0.S_g", "imu0.S_a", "cam0.T_cam_imu.translation", "cam0.intrinsics"):
        assert rms(right[block][1]) < 2, block
    z = right["target.offsets"][1]
    assert len(z) == 3 * len(simulation.target)
    assert rms(z) == pytest.approx(1, abs=0.15)
    camera = cured.calibration.cameras["cam0"].camera
    assert camera.distortion == "radtan5"
    assert camera.distortion_coeffs[4] == pytest.approx(-0.04, abs=3e-3)


def test_a_board_as_stated_stays_so():
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=12.0), seed=1)
    options = CameraImuOptions(model="full", free=("target.offsets",), compare=False)
    result = calibrate_camera_imu(simulation.recording, simulation.target, options)
    z = errors(result, simulation)["target.offsets"][1]
    assert rms(z) == pytest.approx(1, abs=0.15)


@pytest.mark.long
def test_board_and_lens_join_the_model_from_one_linearisation(monkeypatch):
    done = []

    def counted(*args, **keywords):
        done.append(len(args[2]))
        return linearize_batch(*args, **keywords)

    for module in (solution, gauss_newton, camera_imu_model):
        monkeypatch.setattr(module, "linearize_batch", counted)
    simulation = simulate_camera_imu(scenario(duration_s=12.0), seed=5)
    result = calibrate_camera_imu(simulation.recording, simulation.target)
    assert set(result.calibration.assessment.trust.added) == {"intrinsics", "k3", "board"}
    assert len(done) <= 8  # three to the frames that fit, one beside the candidates, four with them
    assert rms(errors(result, simulation)["target.offsets"][1]) == pytest.approx(1, abs=0.15)
