"""`gnomon convert` with calibrations: where the noise comes from, what is said, and files of other projects."""

import contextlib
import io
import json
from dataclasses import replace

import pytest

import gnomon
from gnomon.cli import main
from gnomon.formats.conversion import WITH_NOISE
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.own.noise_file import save_noise
from gnomon.formats.shared.losses import StatedImu
from gnomon.recording.samples import ImuNoise
from gnomon.results.calibration import Provenance
from gnomon.results.sensor_noise import COEFFICIENTS, AxisNoise, Coefficient, SensorNoise, TriadNoise

NOISE = ImuNoise(
    accelerometer_noise_density=0.0039,
    accelerometer_random_walk=0.0012,
    gyroscope_noise_density=8.73e-5,
    gyroscope_random_walk=2e-5,
)
IMU_YAML = "".join(f"{key}: {getattr(NOISE, key)!r}\n" for key in ImuNoise.__slots__) + "update_rate: 200.0\n"


def run(*arguments):
    """Run a command in this process: exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture
def result(tmp_path, camera_calibration):
    """Return calibration.yaml in a folder of its own, with a lens that all programs know."""
    calibration = camera_calibration(0, cameras=1)
    held = replace(calibration.assessment, held_by_prior=("cam0.time_shift_cam_imu",))
    (tmp_path / "rig").mkdir()
    gnomon.save(replace(calibration, assessment=held), tmp_path / "rig/calibration.yaml")
    return tmp_path / "rig/calibration.yaml"


@pytest.mark.parametrize("to", ["kalibr", "ros2"])  # ros2 is a format of recordings too
def test_the_folder_of_a_result_stands_for_its_calibration(result, tmp_path, to):
    (result.parent / "imu.yaml").write_text(IMU_YAML)
    assert run("convert", result, "--to", to, "-o", tmp_path / "file")[0] == 0
    code, out, err = run("convert", result.parent, "--to", to)
    assert code == 0, err
    for path in (tmp_path / "file").iterdir():
        assert (result.parent / to / path.name).read_bytes() == path.read_bytes()
    assert ("noise and rate are taken from" in out) == (to == "kalibr")
    (tmp_path / "empty").mkdir()
    code, _, err = run("convert", tmp_path / "empty", "--to", "kalibr")
    assert (code, "of a result, give its folder" in err) == (2, True)


def test_a_file_in_place_of_the_folder_is_said(result, tmp_path):
    (tmp_path / "mine").write_text("")
    code, _, err = run("convert", result, "--to", "json", "-o", tmp_path / "mine")
    assert (code, f"{tmp_path / 'mine'}: this is a file" in err) == (3, True)


@pytest.mark.parametrize("to", WITH_NOISE)
def test_noise_beside_the_calibration_is_taken(result, to):
    """What a user has after a calibration: imu.yaml in the folder of the result."""
    (result.parent / "imu.yaml").write_text(IMU_YAML)
    code, out, err = run("convert", result, "--to", to)
    assert code == 0, err
    assert f"noise and rate are taken from {result.parent / 'imu.yaml'}" in out
    assert "noise and rate:" not in out
    assert f"not representable in {to}: held by assumption, not measured (1 numbers): cam0.time_shift_cam_imu: " in out
    found = load_foreign(*sorted((result.parent / to).iterdir())).imu_data["imu0"]
    for key in ImuNoise.__slots__:
        assert getattr(found.noise, key) == pytest.approx(getattr(NOISE, key), rel=1e-14)
    assert found.update_rate_hz == 200.0


def a_noise():
    """Make the noise of an IMU, all axes alike."""
    kinds = {name: Coefficient(value=1e-3, sigma=1e-4) for name in COEFFICIENTS}
    triad = TriadNoise(rate_hz=199.98, samples=1000, tau_s=(0.01, 100.0), axes=(AxisNoise(**kinds),) * 3)
    return SensorNoise(
        accelerometer=triad, gyroscope=triad, t_init_s=41.0, verdict="pass", findings=(),
        provenance=Provenance(gnomon_version="0", method="noise"),
    )  # fmt: skip


def test_noise_is_given_or_lies_in_noise_yaml(result, tmp_path):
    code, out, _ = run("convert", result, "--to", "openvins", "-o", tmp_path / "none")
    assert code == 0
    assert "not representable in openvins: noise and rate: accelerometer_noise_density" in out
    save_noise(a_noise(), result.parent / "noise.yaml")
    code, out, _ = run("convert", result, "--to", "openvins", "-o", tmp_path / "beside")
    assert f"taken from {result.parent / 'noise.yaml'}" in out
    found = load_foreign(*sorted((tmp_path / "beside").iterdir())).imu_data["imu0"]
    assert (found.noise, found.update_rate_hz) == (a_noise().imu_noise(), 199.98)
    (tmp_path / "mine.yaml").write_text(IMU_YAML)
    for option in ("--imu", "--noise"):
        code, out, _ = run(
            "convert", result, "--to", "openvins", "-o", tmp_path / "given", option, tmp_path / "mine.yaml"
        )
        assert code == 0
        assert "noise.yaml" not in out
        found = load_foreign(*sorted((tmp_path / "given").iterdir())).imu_data["imu0"]
        assert found.noise == NOISE


def test_noise_that_cannot_be_used(result, tmp_path):
    (result.parent / "imu.yaml").write_text(IMU_YAML.replace("0.0039", "0"))
    code, out, _ = run("convert", result, "--to", "kalibr", "-o", tmp_path / "out")
    assert code == 0
    assert "imu.yaml beside the calibration was not used: " in out
    assert "not representable in kalibr: noise and rate" in out
    code, _, err = run("convert", result, "--to", "kalibr", "-o", tmp_path / "x", "--imu", result.parent / "imu.yaml")
    assert code == 3
    assert "expected a number greater than zero" in err
    assert not (tmp_path / "x").exists()
    (result.parent / "imu.yaml").write_text(IMU_YAML)
    code, _, err = run("convert", result, "--to", "px4", "--imu", result.parent / "imu.yaml")
    assert code == 2
    assert "px4 has no place for noise" in err


def test_ros2_is_for_both(result):
    code, out, err = run("convert", result, "--to", "ros2", "--json")
    assert code == 0, err
    document = json.loads(out)
    names = [file.rsplit("/", 1)[1].rsplit("\\", 1)[-1] for file in document["files"]]
    assert names == ["static_transforms.launch.yaml", "cam0_camera_info.yaml"]
    assert document["notes"] == []
    assert {"what", "why", "size"} == set(document["losses"][0])


def test_files_of_other_projects(result, tmp_path):
    stated = {"imu0": StatedImu(noise=NOISE, update_rate_hz=200.0)}
    gnomon.convert(gnomon.load(result), "kalibr", tmp_path / "kalibr", imu=stated)
    files = tmp_path / "kalibr/camchain-imucam.yaml", tmp_path / "kalibr/imu.yaml"
    code, out, err = run("convert", *files, "--to", "basalt", "-o", tmp_path / "basalt")
    assert code == 0, err
    assert "note:    Kalibr's file holds no bias; taken: zero." in out
    assert "origin: converted from Kalibr, cameras + Kalibr, IMU; how uncertain" in out
    assert load_foreign(tmp_path / "basalt/calibration.json").imu_data["imu0"].noise == NOISE
    code, out, err = run(
        "convert", tmp_path / "basalt/calibration.json", "--to", "vins-fusion", "-o", tmp_path / "vins"
    )
    assert code == 0, err
    assert run("show", tmp_path / "vins/config.yaml")[0] == 0
    code, _, err = run("convert", tmp_path / "vins/cam0.yaml", "--to", "kalibr", "-o", tmp_path / "x")
    assert code == 3
    assert "lenses without their poses" in err
    before = files[1].read_bytes()
    code, _, err = run("convert", *files, "--to", "kalibr", "-o", tmp_path / "kalibr")
    assert code == 3
    assert "this file is converted, and would be replaced" in err
    assert files[1].read_bytes() == before
    code, _, err = run("convert", result, files[0], "--to", "kalibr", "-o", tmp_path / "x")
    assert code == 2
    assert "one at a time" in err


def test_json_is_read_as_a_calibration(result, tmp_path):
    assert run("convert", result, "--to", "json", "-o", tmp_path / "json")[0] == 0
    path = tmp_path / "json/calibration.json"
    assert run("show", path) == run("show", result)
    assert run("convert", path, "--to", "csv", "-o", tmp_path / "csv")[0] == 0
    code, _, err = run("convert", path, "--to", "euroc")
    assert code == 2
    assert "this is a calibration" in err
