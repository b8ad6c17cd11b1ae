"""What consumers pass over of their own files is said, with its size; and what their files need is in them."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.formats.conversion import export_texts
from gnomon.models.camera import Camera
from gnomon.results.calibration import Gravity

WIDE = Camera(
    projection="pinhole", intrinsics=[300.0, 301, 320, 240], distortion="equidistant",
    distortion_coeffs=[-0.012, 0.022, -0.0137, 0.0027], resolution=(640, 480),
)  # fmt: skip


@pytest.fixture
def rig(camera_calibration):
    def make(*lenses, gravity=9.80353):
        made = camera_calibration(0, cameras=2)
        cameras = {
            name: replace(camera, camera=lens)
            for (name, camera), lens in zip(made.cameras.items(), lenses, strict=False)
        }
        names = gnomon.results.calibration.covariance_names(made.imus, cameras)
        zero = gnomon.Covariance(names=names, matrix=np.zeros((len(names),) * 2))
        return replace(
            made, cameras=cameras, uncertainty=zero, gravity=Gravity(value=gravity, sigma=0.0, source="given")
        )

    return make


def loss(calibration, to, what):
    return next((one for one in export_texts(calibration, to).losses if one.what.startswith(what)), None)


@pytest.mark.parametrize(("to", "key"), [("basalt", "cam_time_offset_ns"), ("okvis", "image_delay")])
def test_a_shift_that_is_not_applied(rig, to, key):
    calibration = rig(WIDE)
    shift = calibration.cameras["cam0"].time_shift_cam_imu
    found = loss(calibration, to, key)
    assert f"{shift * 1e3:+.6g} ms" in found.size
    text = " ".join("".join(export_texts(calibration, to).files.values()).replace("#", " ").split())
    assert "add the shift to the timestamps of the images" in text
    still = replace(calibration.cameras["cam0"], time_shift_cam_imu=0.0)
    assert loss(replace(calibration, cameras={"cam0": still}), to, key) is None


@pytest.mark.parametrize(("to", "whose"), [("basalt", "Basalt"), ("orb-slam3", "ORB-SLAM3"), ("openvins", "OpenVINS")])
def test_gravity_of_their_own(rig, to, whose):
    found = loss(rig(WIDE), to, "gravity")
    assert found.size == "-6.5 mm/s^2"
    assert found.why.startswith(f"{whose} has 9.81 m/s^2")
    assert loss(rig(WIDE, gravity=9.81), to, "gravity") is None
    assert loss(rig(WIDE), "vins-fusion", "gravity") is None  # its file has g_norm


def test_orb_slam3_takes_the_first_lens_twice(rig):
    second = replace(WIDE, distortion_coeffs=[-0.02, 0.03, -0.02, 0.005])
    found = loss(rig(WIDE, second), "orb-slam3", "Camera2.k1")
    assert float(found.size.split(" px at worst")[0].split()[-1]) > 1
    text = "".join(export_texts(rig(WIDE, second), "orb-slam3").files.values())
    for line in ("Camera1.overlappingBegin: 0", "Camera1.overlappingEnd: 639", "Camera2.overlappingEnd: 639"):
        assert line in text
    alone = "".join(export_texts(rig(WIDE), "orb-slam3").files.values())
    assert "overlapping" not in alone


def test_kalibr_passes_over_the_line_delay(rig):
    found = loss(rig(replace(WIDE, line_delay_s=3e-5)), "kalibr", "line_delay")
    assert found.size == "30 us a row, 14.4 ms an image"


def test_px4_keeps_its_old_values_where_the_new_ones_differ_little(random_calibration):
    calibration = random_calibration(0, units=("m/s^2", "rad/s"))
    imu = calibration.imus["imu0"]

    def with_bias(size):
        triad = replace(imu.gyroscope, bias=np.array([size, 0.0, 0.0]))
        return replace(calibration, imus={"imu0": replace(imu, gyroscope=triad)})

    assert "keeps 0" in loss(with_bias(0.004), "px4", "offsets of the gyroscope").why
    assert loss(with_bias(0.02), "px4", "offsets of the gyroscope") is None


def test_ardupilot_wants_its_sensor(random_calibration):
    assert "INS_ACC_ID" in loss(random_calibration(0, units=("m/s^2", "rad/s")), "ardupilot", "identity").why


def test_the_csv_says_what_its_rotations_are(rig):
    (text,) = export_texts(rig(WIDE), "csv").files.values()
    assert "rotation vector: axis times angle [rad]" in text


@pytest.mark.parametrize("to", ["vins-fusion", "orb-slam3", "okvis"])
def test_show_names_the_pose_of_a_program_as_that_to_the_imu(rig, to, tmp_path, capsys):
    gnomon.convert(rig(WIDE), to, tmp_path)
    name = {"vins-fusion": "config.yaml", "orb-slam3": "orb_slam3.yaml", "okvis": "okvis.yaml"}[to]
    assert main(["show", str(tmp_path / name)]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "p_cam = R p_imu + t" in words
    assert "p_cam0" not in words
