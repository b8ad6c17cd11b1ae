"""A calibration of several IMUs applied: which one is meant, and the clock of an accelerometer that is late."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.cli import main
from gnomon.writers.simulated_cameras import save_camera_imu_recording

SCENARIO = CameraImuScenario(
    duration_s=3.0, imus=2, noise_factor=0.0, accelerometer_rate_hz=150.0, further_accelerometer_delay_s=0.006
)


@pytest.fixture(scope="module")
def simulation():
    return simulate_camera_imu(SCENARIO, seed=4)


@pytest.fixture(scope="module")
def folder(simulation, tmp_path_factory):
    place = tmp_path_factory.mktemp("rig")
    save_camera_imu_recording(simulation, place)
    return place


def table(path):
    return np.loadtxt(path, delimiter=",", skiprows=1)


@pytest.mark.parametrize("name", ["imu0", "imu1"])
def test_the_imu_is_chosen_by_its_name_in_a_folder(name, simulation, folder, tmp_path):
    assert main(["apply", str(folder / "truth.yaml"), str(folder), "--imu", name, "-o", str(tmp_path / "a.csv")]) == 0
    found, motion = table(tmp_path / "a.csv"), simulation.imus[name].trajectory
    np.testing.assert_array_equal(found[:, 0], simulation.recording.imus[name].gyroscope.t_ns)
    inner = slice(20, -20)
    # between samples of the accelerometer the force is interpolated; a shift left out would be off by 0.2 m/s^2
    assert np.abs(found[inner, 4:7] - motion.f_imu[inner]).max() < 0.04
    assert np.abs(found[inner, 1:4] - motion.omega_imu[inner]).max() < 2e-3


def test_the_name_of_a_file_tells_its_imu(simulation, folder, tmp_path):
    pair = [str(folder / f"imu1-{triad}.csv.gz") for triad in ("acc", "gyr")]
    assert main(["apply", str(folder / "truth.yaml"), *pair, "-o", str(tmp_path / "a.csv")]) == 0
    in_memory = simulation.truth.imus["imu1"].apply(simulation.recording.imus["imu1"])
    np.testing.assert_allclose(table(tmp_path / "a.csv")[:, 1:4], in_memory.gyroscope.values, atol=1e-12)
    shift_ns = in_memory.accelerometer.t_ns - simulation.recording.imus["imu1"].accelerometer.t_ns
    assert set(shift_ns.tolist()) == {-6_000_000}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{truth}", "{folder}"], "this calibration is of imu0, imu1. Say with --imu which of them recorded"),
        (["{truth}", "{folder}", "--imu", "imu7"], "of imu0, imu1, not of imu7. Choose one of them with --imu"),
        (["{truth}", "{other}", "--imu", "imu1"], "there are samples of imu0, and none of imu1"),
    ],
)
def test_what_is_not_clear_is_asked(arguments, message, folder, simulation, tmp_path, capsys):
    other = tmp_path / "other"
    save_camera_imu_recording(simulate_camera_imu(replace(SCENARIO, imus=1), seed=4), other)
    places = {"truth": folder / "truth.yaml", "folder": folder, "other": other}
    words = [word.format(**places) for word in arguments]
    assert main(["apply", *words, "-o", str(tmp_path / "a.csv")]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "a.csv").exists()


def test_a_table_is_not_written_under_another_name(folder, tmp_path, capsys):
    out = tmp_path / "a.npz"
    assert main(["apply", str(folder / "truth.yaml"), str(folder), "--imu", "imu0", "-o", str(out)]) == 2
    assert "written as a CSV table. Name the file so, a.csv." in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_the_calibration_of_one_imu_needs_no_name(tmp_path):
    simulation = simulate_camera_imu(replace(SCENARIO, imus=1, accelerometer_rate_hz=None), seed=4)
    save_camera_imu_recording(simulation, tmp_path)
    out = tmp_path / "a.csv"
    assert main(["apply", str(tmp_path / "truth.yaml"), str(tmp_path / "imu0.csv.gz"), "-o", str(out)]) == 0
    assert len(table(out)) == len(gnomon.read(tmp_path / "imu0.csv.gz").imus["imu0"].gyroscope)
