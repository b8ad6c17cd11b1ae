"""Recordings of several IMUs: folders, images in every form, NPZ, and Kalibr's files of their noise, read back."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gnomon
from gnomon import CameraImuScenario, FormatError, OptionError, Recording, read_camera_imu, simulate_camera_imu
from gnomon.assess.checks import rig_lens
from gnomon.assess.checks.rig_doctor import check_corners
from gnomon.calibrate.steps.camera_imu_preparation import prepare_camera_imu, with_looks
from gnomon.estimate.camera_imu.start.first_guess import CameraAlignment
from gnomon.estimate.camera_imu.start.imu_alignment import ImuAlignment
from gnomon.findings import Finding
from gnomon.formats.sensor_inputs import read_imus
from gnomon.formats.shared.yaml_text import kalibr_yaml
from gnomon.options import CameraImuOptions
from gnomon.readers.images.image_recording import open_images
from gnomon.readers.rig.folder import read_corner_stamps
from gnomon.writers.recording_file import save_recording
from gnomon.writers.simulated_cameras import save_camera_imu_recording

TWO = CameraImuScenario(
    duration_s=3.0, imus=2, cameras=2, further_imu_rate_hz=160.0, imu_clock_offset_s=55.0, clock_offset_s=-9.0,
    clock_offset_difference_s=-1e4,
)  # fmt: skip
APART = replace(TWO, accelerometer_rate_hz=110.0, accelerometer_delay_s=0.002)


def assert_same(found, expected):
    assert list(found) == list(expected)
    for name, imu in expected.items():
        for triad in ("accelerometer", "gyroscope"):
            one, other = getattr(found[name], triad), getattr(imu, triad)
            np.testing.assert_array_equal(one.t_ns, other.t_ns)
            np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize("scenario", [TWO, APART])
def test_a_folder_reads_back_bit_by_bit(scenario, tmp_path):
    simulation = simulate_camera_imu(scenario, seed=2)
    files = save_camera_imu_recording(simulation, tmp_path)
    names = {path.name for path in files}
    apart = {f"imu{i}-{triad}.csv.gz" for i in (0, 1) for triad in ("acc", "gyr")}
    assert (apart if scenario is APART else {"imu0.csv.gz", "imu1.csv.gz"}) <= names
    recording, _ = read_camera_imu(
        tmp_path, cam=tmp_path / "camchain.yaml", imu=tmp_path / "imu.yaml", target=tmp_path / "target.yaml"
    )
    assert_same(recording.imus, simulation.recording.imus)
    assert [imu.noise for imu in recording.imus.values()] == [i.noise for i in simulation.recording.imus.values()]
    assert [imu.topic for imu in recording.imus.values()] == ["/imu0", "/imu1"]
    assert_same(read_corner_stamps(tmp_path).imus, simulation.recording.imus)
    assert gnomon.load(tmp_path / "truth.yaml").imus["imu1"].time_shift_s == pytest.approx(-54.996, abs=1e-9)


def test_an_earlier_recording_of_more_imus_leaves_none_behind(tmp_path):
    save_camera_imu_recording(simulate_camera_imu(replace(APART, imus=3), seed=2), tmp_path)
    save_camera_imu_recording(simulate_camera_imu(replace(TWO, imus=1), seed=2), tmp_path)
    assert sorted(path.name for path in tmp_path.glob("imu*")) == ["imu.yaml", "imu0.csv.gz"]


@pytest.mark.parametrize(
    ("form", "scenario"),
    [("folder", APART), ("euroc", TWO), ("ros1", APART), ("mcap", TWO)],
)
def test_images_with_several_imus_read_back_in_every_form(form, scenario, tmp_path):
    short = replace(scenario, duration_s=0.4, images=True, resolution=(64, 48), intrinsics=(46.0, 45.8, 32.2, 23.7))
    simulation = simulate_camera_imu(short, seed=1)
    (place,) = {path for path in (tmp_path / form,) if not path.exists()}
    save_camera_imu_recording(simulation, place, form=form)
    found = open_images(place if form in ("folder", "euroc") else next(place.glob("recording*")))
    assert_same(found.imus, simulation.recording.imus)
    assert all(imu.T_imu_body is None for imu in found.imus.values())


def test_euroc_s_table_has_no_room_for_stamps_of_their_own(tmp_path):
    short = replace(APART, duration_s=0.4, images=True, resolution=(64, 48))
    with pytest.raises(OptionError, match=r"imu0: accelerometer .* have timestamps of their own"):
        save_camera_imu_recording(simulate_camera_imu(short, seed=1), tmp_path, form="euroc")


def test_npz_holds_several_imus(tmp_path):
    simulation = simulate_camera_imu(APART, seed=2)
    save_recording(Recording(imus=simulation.recording.imus), tmp_path / "both.npz")
    assert_same(gnomon.read(tmp_path / "both.npz").imus, simulation.recording.imus)
    with pytest.raises(OptionError, match="CSV holds one IMU"):
        save_recording(Recording(imus=simulation.recording.imus), tmp_path / "both.csv")


NOISE = {
    "accelerometer_noise_density": 0.002, "accelerometer_random_walk": 3e-4, "gyroscope_noise_density": 1.7e-4,
    "gyroscope_random_walk": 2e-5, "update_rate": 200.0, "rostopic": "/imu_a",
}  # fmt: skip
PLACED = {"T_i_b": np.diag([-1.0, -1.0, 1.0, 1.0]), "time_offset": 0.25}


def test_noise_of_several_imus_is_keyed_or_in_a_file_of_each(tmp_path):
    second = {**NOISE, "gyroscope_noise_density": 3e-4, "rostopic": "/imu_b"}
    files = [tmp_path / name for name in ("both.yaml", "first.yaml", "second.yaml")]
    for path, content in zip(files, ({"imu0": NOISE, "imu1": {**second, **PLACED}}, NOISE, second), strict=True):
        path.write_text(kalibr_yaml(content))
    keyed, apart = read_imus(files[0]), read_imus(files[1:])
    for found in (keyed, apart):
        assert {name: imu.topic for name, imu in found.items()} == {"imu0": "/imu_a", "imu1": "/imu_b"}
        assert found["imu1"].noise.gyroscope_noise_density == 3e-4
    np.testing.assert_array_equal(keyed["imu1"].T_imu_body, PLACED["T_i_b"])
    assert keyed["imu1"].time_shift_s == 0.25
    assert apart["imu1"].T_imu_body is None
    with pytest.raises(FormatError, match=r"both.yaml: this file is of imu0, imu1, and one of 2 files"):
        read_imus(files[:2])


def test_what_check_says_of_several_imus(monkeypatch):
    looked = []
    fit = rig_lens.lens_fit
    monkeypatch.setattr(rig_lens, "lens_fit", lambda *given: looked.append(1) or fit(*given))
    simulation = simulate_camera_imu(replace(APART, duration_s=12.0, accelerometer_delay_s=0.01), seed=3)
    recording = simulation.recording
    findings = check_corners(recording, simulation.target)
    assert len(looked) == len(recording.cameras)  # however many IMUs there are
    apart = {finding.message.split(" comes")[0]: finding for finding in findings if finding.code == "triads-apart"}
    assert set(apart) == {"The accelerometer of imu0", "The accelerometer of imu1"}
    assert sum(finding.code == "triads-apart" for finding in findings) == 2  # though each camera sees that of imu0
    assert "--free imu1.accelerometer_shift" in apart["The accelerometer of imu1"].cure
    without_time = [finding.message.split(" have")[0] for finding in findings if finding.code == "streams-apart"]
    assert without_time == ["cam0 and imu0", "cam0 and imu1", "cam1 and imu0"]
    flipped = recording.imus["imu1"]
    gyroscope = replace(flipped.gyroscope, values=flipped.gyroscope.values * [1, -1, 1])
    broken = Recording(
        imus={**recording.imus, "imu1": replace(flipped, gyroscope=gyroscope)}, cameras=recording.cameras
    )
    wrong = [f for f in check_corners(broken, simulation.target) if f.severity == "problem"]
    assert wrong
    assert all("imu1" in finding.message for finding in wrong)


def test_a_calibration_tells_of_each_imu_and_looks_at_a_lens_once(monkeypatch):
    simulation = simulate_camera_imu(replace(APART, duration_s=12.0), seed=3)
    prepared = prepare_camera_imu(simulation.recording, simulation.target, CameraImuOptions())
    lenses = []

    def look_at(name, _poses, _alignment, camera, _target, *, imu, **_):
        lenses.append(camera)
        told = [("triads-apart", f"accelerometer of {imu} late"), ("frames-late", f"{name}: frames late")]
        return [Finding(severity="warning", code=code, message=message) for code, message in told], None

    monkeypatch.setattr("gnomon.calibrate.steps.camera_imu_preparation.check_look", look_at)
    monkeypatch.setattr("gnomon.calibrate.steps.camera_imu_preparation.check_clock_changes", lambda *_: [])
    monkeypatch.setattr("gnomon.calibrate.steps.camera_imu_preparation.gyroscope_integral", lambda *_: None)
    aligned = SimpleNamespace(score=1.0)
    frames = simulation.recording.cameras["cam0"]
    look = CameraAlignment(name="cam0", frames=frames, poses=None, alignment=aligned, target=simulation.target)
    beside = ImuAlignment(name="imu1", look=look, alignment=aligned, R_imu_body=np.eye(3), time_shift_s=0.0)
    stream = SimpleNamespace(t_s=None, rate=None)
    found = with_looks(prepared, [look], simulation.target, [stream, stream], [beside]).findings
    told = [finding.message for finding in found if finding.code in {"triads-apart", "frames-late"}]
    assert told == ["accelerometer of imu0 late", "cam0: frames late", "accelerometer of imu1 late"]
    assert lenses == [frames.camera, None]
