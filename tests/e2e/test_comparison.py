"""Comparisons with genuine files of other projects, and of repeated recordings.

Our calibrations beside Kalibr's of the same recordings: test_camera_imu_recordings.py, which has them.
"""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.comparison import compare
from gnomon.cli import main

SAMPLES = (
    "basalt/euroc_ds_calib.json",
    "basalt/euroc_eucm_calib.json",
    "basalt/tumvi_512_ds_calib.json",
    *(f"openvins_{name}" for name in ("euroc_mav", "kaist_vio", "rpng_sim", "rs_d455", "tum_vi", "uzhfpv_indoor_45")),
)


@pytest.mark.parametrize("sample", SAMPLES)
def test_every_foreign_sample_is_read(real_data, sample, tmp_path, capsys):
    path = real_data("kalibr-format-samples") / sample
    assert main(["compare", f"a={path}", f"b={path}", "-o", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "a and b" in out
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_two_models_of_the_lenses_of_one_rig(real_data):
    """Basalt's two calibrations of EuRoC: ds and eucm lenses, one rig."""
    folder = real_data("kalibr-format-samples/basalt")
    found = compare(folder / "euroc_ds_calib.json", folder / "euroc_eucm_calib.json", names=["ds", "eucm"])
    lens = next(one for one in found.lenses if one.camera == "cam0")
    assert lens.models == ("ds-none", "eucm-none")
    assert lens.turned_rms_px < 1.0
    rotation = found.difference("ds", "eucm", "cam0.rotation").values
    assert np.degrees(np.linalg.norm(rotation)) < 0.5


def test_openvins_and_basalt_of_one_rig(real_data):
    """Published calibrations of EuRoC by two projects: T in both directions, several names for one thing."""
    folder = real_data("kalibr-format-samples")
    found = compare(folder / "basalt/euroc_ds_calib.json", folder / "openvins_euroc_mav", names=["basalt", "openvins"])
    for camera in ("cam0", "cam1"):
        rotation = found.difference("basalt", "openvins", f"{camera}.rotation").values
        assert np.degrees(np.linalg.norm(rotation)) < 1.0
        assert np.linalg.norm(found.difference("basalt", "openvins", f"{camera}.translation").values) < 0.02
    assert not {"pose-inverted", "shift-sign"} & {one.code for one in found.findings}


def test_repeated_recordings_scatter_as_predicted():
    """One simulated sensor, six recordings at a place whose gravity is not known: the sigmas hold, all agree."""
    scenario = gnomon.Scenario(intervals=25, t_init_s=20.0, sensor_seed=7)
    results = [gnomon.calibrate_imu(gnomon.simulate(scenario, seed)[0]) for seed in range(6)]
    found = compare(*results)
    assert [one.name for one in found.calibrations] == [*"ABCDEF"]
    assert found.verdict in {"pass", "warn"}
    assert found.outside == ()
    assert 0.6 < found.z_rms < found.limit
    scale = found.block("imu0.accelerometer.scale")
    assert 0.4 < scale.z_rms < scale.limit  # though the sigma of gravity, which all share, is a hundred times larger
    assert np.all(scale.scatter < 0.1 * scale.predicted)


@pytest.mark.long
def test_repeated_recordings_of_a_rig():
    scenario = gnomon.CameraImuScenario(duration_s=15.0, camera_rate_hz=10.0, cameras=2, sensor_seed=3)
    calibrations: list[gnomon.Calibration] = []
    for seed in range(3):
        made = gnomon.simulate_camera_imu(scenario, seed=seed)
        calibrations.append(gnomon.calibrate_camera_imu(made.recording, made.target).calibration)
    found = compare(*calibrations, names=["one", "two", "three"])
    assert found.outside == ()
    assert found.z_rms < found.limit
    bad = replace(calibrations[0], cameras={name: pushed(camera) for name, camera in calibrations[0].cameras.items()})
    assert compare(bad, *calibrations[1:], names=["one", "two", "three"]).outside == ("one",)


def pushed(camera):
    T = camera.T_cam_imu.copy()
    T[:3, 3] += 0.01
    return replace(camera, T_cam_body=T)
