"""A calibration that still holds is said to; one number that was changed is named, with its size."""

import hashlib
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.cli.commands.verify import read_verification
from gnomon.estimate.trust.changes import estimates_alone
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.options.requirements import Use
from gnomon.report.comparison import verified_tables
from gnomon.simulate import CameraImuScenario, Scenario, simulate, simulate_camera_imu

LOOSE = Use(name="loose", words="a test", needs={"accelerometer_scale": 0.05})
SHORT = {"intervals": 12, "t_init_s": 6.0, "hold_s": (1.9, 2.1), "motion_s": (0.8, 1.2)}


@cache
def sensor(seed):
    """Return a calibration and a short fresh recording of one sensor."""
    drawn = {"g_sensitivity": 3e-4, "sensor_seed": seed}
    calibration = gnomon.calibrate_imu(simulate(Scenario(**drawn), seed)[0]).calibration
    return calibration, simulate(Scenario(**drawn, **SHORT), seed + 5000)[0]


def changed(calibration, **triads):
    imu = calibration.imus["imu0"]
    moved = {name: replace(getattr(imu, name), **change(getattr(imu, name))) for name, change in triads.items()}
    return replace(calibration, imus={**calibration.imus, "imu0": replace(imu, **moved)})


def scaled(axis, factor):
    def change(triad):
        rows = np.ones(3)
        rows[axis] = factor
        return {"sensitivity": rows[:, None] * triad.sensitivity}

    return change


def turned(degrees):
    turn = rotation_from_rotvec(np.radians(degrees) * np.array([0.6, -0.64, 0.48]))
    return lambda triad: {"sensitivity": triad.sensitivity @ turn}


CHANGES = {
    "imu0.gyroscope.scale": {"gyroscope": scaled(0, 1.002)},
    "imu0.accelerometer.scale": {"accelerometer": scaled(1, 1.002)},
    "imu0.gyroscope.rotation": {"gyroscope": turned(0.2)},
    "imu0.gyroscope.bias": {"gyroscope": lambda triad: {"bias": triad.bias + np.array([0, 0.03, 0])}},
    "imu0.accelerometer.bias": {"accelerometer": lambda triad: {"bias": triad.bias + np.array([0, 0, 0.5])}},
    "imu0.gyroscope.g_sensitivity": {
        "gyroscope": lambda triad: {"g_sensitivity": triad.g_sensitivity + 2e-3 * np.eye(3)[[1, 2, 0]]}
    },
}


@pytest.mark.first(6)
@pytest.mark.parametrize("path", CHANGES)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_number_that_moved_is_named_with_its_size(path, seed):
    calibration, fresh = sensor(seed)
    wrong = changed(calibration, **CHANGES[path])
    found = gnomon.verify(wrong, fresh)
    assert (found.state, [block.path for block in found.moved]) == ("moved", [path])
    whole = gnomon.compare(calibration, wrong, names=("true", "wrong")).difference("true", "wrong", path)
    (block,) = found.moved
    assert np.all(np.abs(block.values - whole.values) < 4 * block.sigma)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_calibration_that_holds_is_said_to_hold(seed):
    found = gnomon.verify(*sensor(seed))
    assert found.state == "holds"
    assert {block.state for block in found.blocks} == {"holds"}


@pytest.mark.parametrize("triad", ["gyroscope", "accelerometer"])
def test_a_number_that_the_calibration_leaves_out_hides_no_other(triad):
    _, fresh = sensor(1)
    assert gnomon.calibrate_imu(fresh).calibration.imus["imu0"].gyroscope.g_sensitivity.any()
    drawn = {"g_sensitivity": 3e-4, "sensor_seed": 1}
    recording = simulate(Scenario(**drawn), 1)[0]
    calibration = gnomon.calibrate_imu(recording, gnomon.ImuOptions(model="basic")).calibration
    found = gnomon.verify(changed(calibration, **{triad: scaled(1, 1.01)}), fresh)
    assert f"imu0.{triad}.scale" in {block.path for block in found.moved}
    assert all(block.sigma.max() < 1 for block in found.blocks)


@pytest.mark.parametrize("seed", [1, 2])
def test_nine_rests_verify_as_well(seed):
    drawn = {"g_sensitivity": 0.0, "sensor_seed": seed}
    calibration = gnomon.calibrate_imu(simulate(Scenario(**drawn), seed)[0]).calibration
    fresh = simulate(Scenario(**drawn, **SHORT | {"intervals": 9}), seed + 5000)[0]
    assert gnomon.verify(calibration, fresh).state == "holds"
    found = gnomon.verify(changed(calibration, gyroscope=scaled(0, 1.01)), fresh)
    assert "imu0.gyroscope.scale" in {block.path for block in found.moved}


def test_a_sign_is_not_taken_for_a_small_change():
    calibration, fresh = sensor(1)
    found = gnomon.verify(changed(calibration, gyroscope=scaled(1, -1.0)), fresh)
    assert found.moved[0].path in {"imu0.gyroscope.scale", "imu0.gyroscope.rotation"}
    assert found.verdict == "fail"


def test_the_prior_that_helps_does_not_pull_the_size_of_a_change_in_sign():
    calibration, fresh = sensor(1)
    wrong = changed(calibration, accelerometer=scaled(2, -1.0))
    (block,) = gnomon.verify(wrong, fresh).moved
    whole = gnomon.compare(calibration, wrong, names=("true", "wrong")).difference("true", "wrong", block.path)
    assert block.path == "imu0.accelerometer.scale"
    assert np.all(np.abs(block.values - whole.values) < 4 * block.sigma)


def test_what_is_estimated_alone_is_what_a_calibration_publishes():
    _, recording = sensor(4)
    one = gnomon.ImuOptions(multiplier=30.0)
    with estimates_alone() as postponed:
        alone, among_few = (gnomon.calibrate_imu(recording, options).calibration for options in (one, None))
    whole, among_all = (gnomon.calibrate_imu(recording, options).calibration for options in (one, None))
    for few, every in zip(of_scalars(among_few), of_scalars(among_all), strict=True):
        np.testing.assert_allclose(few, every, rtol=1e-2, atol=2e-3)  # of thresholds less than what noise makes of them
    np.testing.assert_array_equal(alone.uncertainty.matrix, whole.uncertainty.matrix)
    np.testing.assert_array_equal(alone.imus["imu0"].gyroscope.sensitivity, whole.imus["imu0"].gyroscope.sensitivity)
    assert postponed
    assert not any(search() for search in postponed)


def test_a_recording_in_which_a_number_changed_is_no_proof():
    """Half of it with another scale would tell of half the change: it is judged as a whole, and tells nothing."""
    drawn = {"g_sensitivity": 3e-4, "sensor_seed": 4}
    recording = simulate(Scenario(**drawn), 9004)[0]
    samples = recording.imus["imu0"]
    values = samples.gyroscope.values.copy()
    values[len(values) // 2 :] *= 1.03
    bad = replace(recording, imus={"imu0": replace(samples, gyroscope=replace(samples.gyroscope, values=values))})
    with estimates_alone() as postponed:
        gnomon.calibrate_imu(bad)
    assert [change.block for search in postponed for change in search()] == ["imu0.gyroscope.sensitivity"]
    assert gnomon.calibrate_imu(bad).calibration.verdict == "fail"
    assert gnomon.verify(sensor(4)[0], bad).state == "cannot tell"


def test_what_moved_within_the_need_is_named_and_holds():
    calibration, fresh = sensor(1)
    found = gnomon.verify(changed(calibration, accelerometer=scaled(1, 1.002)), fresh, use=LOOSE)
    assert (found.state, found.verdict) == ("holds", "pass")
    (block,) = found.moved
    assert (block.path, block.state, block.change.where) == ("imu0.accelerometer.scale", "moved, within need", "y")
    assert block.z > found.certain_z
    assert block.words in found.headline
    assert [(one.code, one.severity) for one in found.findings] == [("calibration-moved", "info")]


def test_a_recording_that_says_nothing_cannot_tell():
    calibration, _ = sensor(1)
    drawn = {"g_sensitivity": 3e-4, "sensor_seed": 1}
    found = gnomon.verify(calibration, simulate(Scenario(**drawn, **SHORT | {"intervals": 3}), 7)[0])
    assert found.state == "cannot tell"


def test_sensors_that_are_not_there_are_refused():
    calibration, fresh = sensor(1)
    other = replace(fresh, imus={"imu7": fresh.imus["imu0"]})
    with pytest.raises(gnomon.OptionError, match="nothing to verify"):
        gnomon.verify(calibration, other)


def test_a_recording_does_not_verify_the_calibration_that_it_made(tmp_path):
    _, fresh = sensor(1)
    path = tmp_path / "own.csv"
    values = [getattr(fresh.imus["imu0"], name) for name in ("gyroscope", "accelerometer")]
    rows = np.column_stack([values[0].t_ns, *(triad.values for triad in values)])
    head = "t_ns,wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt=["%d", *["%.12g"] * 6])
    own = gnomon.calibrate_imu(gnomon.read(path)).calibration
    steps = []
    with pytest.raises(gnomon.OptionError, match="very recording"):
        gnomon.verify(own, gnomon.read(path), progress=steps.append)
    assert not steps, "that can be said before anything is estimated"


RIG = {
    "cam0.translation": lambda T: T + np.array([[0, 0, 0, 0.004], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]),
    "cam0.rotation": lambda T: np.block(
        [
            [rotation_from_rotvec(np.radians([0, 0.15, 0])) @ T[:3, :3], T[:3, 3:]],
            [np.array([[0.0, 0, 0, 1]])],
        ]
    ),
}


@pytest.mark.long
def test_a_camera_that_was_knocked_is_named():
    scenario = CameraImuScenario(duration_s=30.0, imu_rate_hz=100.0, camera_rate_hz=10.0, sensor_seed=1)
    first, second = (simulate_camera_imu(scenario, seed) for seed in (1, 2))
    calibration = gnomon.calibrate_camera_imu(first.recording, first.target).calibration
    fresh = gnomon.calibrate_camera_imu(second.recording, second.target).calibration
    assert gnomon.verify(calibration, fresh).state == "holds"
    for path, move in RIG.items():
        camera = calibration.cameras["cam0"]
        wrong = replace(calibration, cameras={"cam0": replace(camera, T_cam_body=move(camera.T_cam_body))})
        assert [block.path for block in gnomon.verify(wrong, fresh).moved] == [path]


def test_the_command_says_it_in_its_exit_code(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration, fresh = sensor(2)
    gnomon.save(calibration, "calibration.yaml")
    gnomon.save(changed(calibration, **CHANGES["imu0.gyroscope.scale"]), "wrong.yaml")
    rows = np.column_stack([fresh.imus["imu0"].gyroscope.t_ns, fresh.imus["imu0"].gyroscope.values])
    rows = np.column_stack([rows, fresh.imus["imu0"].accelerometer.values])
    head = "t_ns,wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    np.savetxt("today.csv", rows, delimiter=",", header=head, comments="", fmt=["%d", *["%.12g"] * 6])
    assert main(["verify", "calibration.yaml", "today.csv", "--no-report"]) == 0
    assert main(["verify", "calibration.yaml", "today.csv", "-o", "out"]) == 0
    capsys.readouterr()
    assert main(["verify", "wrong.yaml", "today.csv", "--json", "-o", "out"]) == 4
    said = capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "verification.json").read_text())["state"] == "moved"
    assert json.loads(said[said.index("{") :])["state"] == "moved"
    assert "gyroscope" in (tmp_path / "out" / "report.html").read_text()
    _make_its_certificate(tmp_path)


def _make_its_certificate(tmp_path):
    pytest.importorskip("matplotlib")
    assert main(["verify", "wrong.yaml", "today.csv", "--serial", "A-17", "--date", "2026-11-27", "-o", "out"]) == 4
    known = read_verification(tmp_path / "out" / "verification.json")
    assert [block.path for block in known.moved] == ["imu0.gyroscope.scale"]
    assert known.moved[0].values.shape == (3,)
    stated, blocks, criteria = verified_tables(known)
    assert stated.rows == [("Serial number", "A-17"), ("Date", "2026-11-27")]
    assert {row[4] for row in blocks.rows} == {"moved", "holds"}
    assert criteria.rows[criteria.marked][0] == known.verdict
    written = {name: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() for name in ("today.csv", "wrong.yaml")}
    assert {source.name: source.sha256 for source in known.provenance.inputs} == written
    assert main(["certificate", "out", "-o", "out.pdf"]) == (4 if known.verdict == "fail" else 0)
    assert (tmp_path / "out.pdf").read_bytes().startswith(b"%PDF")
    assert main(["certificate", "out", "-o", "out.xml"]) == 2
    (tmp_path / "out" / "verification.json").write_text('{"subject": "", "state": "fine"}')
    assert main(["certificate", "out"]) == 3


def test_a_magnetometer_beside_new_iron_is_named():
    field = gnomon.FieldScenario(sensor_seed=1)
    first, second = (gnomon.simulate_magnetometer(field, seed)[0] for seed in (1, 901))
    calibration = gnomon.calibrate_magnetometer(first).calibration
    assert gnomon.verify(calibration, second).state == "holds"
    wrong = changed(calibration, magnetometer=lambda triad: {"bias": triad.bias + np.array([2.0, 0, 0])})
    (block,) = gnomon.verify(wrong, second).moved
    assert (block.path, block.change.quantity) == ("imu0.magnetometer.bias", "heading")


def test_soft_iron_is_named_where_the_strength_of_the_field_was_stated():
    field = gnomon.FieldScenario(sensor_seed=1)
    first, second = (gnomon.simulate_magnetometer(field, seed)[0] for seed in (1, 901))
    calibration = gnomon.calibrate_magnetometer(first, gnomon.MagnetometerOptions(field=48.2)).calibration
    assert gnomon.verify(calibration, second).state == "holds"
    wrong = changed(calibration, magnetometer=scaled(2, 1.03))
    assert "imu0.magnetometer.scale" in [block.path for block in gnomon.verify(wrong, second).moved]


def test_a_verification_starts_from_the_calibration_and_ends_where_one_without_does():
    field = gnomon.FieldScenario(sensor_seed=2)
    first, second = (gnomon.simulate_magnetometer(field, seed)[0] for seed in (2, 902))
    calibration = gnomon.calibrate_magnetometer(first).calibration
    wrong = changed(calibration, magnetometer=lambda triad: {"bias": triad.bias + np.array([2.0, 0, 0])})
    # how much a shaken pose of the accelerometer counts follows from where its fit starts, and the common frame from it
    agree(gnomon.verify(wrong, second), gnomon.verify(wrong, gnomon.calibrate_magnetometer(second)), within=1.0)


@cache
def rig():
    """Return a calibration of camera and IMU and a fresh recording of them."""
    scenario = CameraImuScenario(duration_s=30.0, imu_rate_hz=100.0, camera_rate_hz=10.0, sensor_seed=3)
    first, second = (simulate_camera_imu(scenario, seed) for seed in (3, 903))
    return gnomon.calibrate_camera_imu(first.recording, first.target).calibration, second


@pytest.mark.long
@pytest.mark.parametrize(("jump_s", "state"), [(0.0005, "holds"), (0.003, "cannot tell")])
def test_a_clock_that_jumps_in_the_last_tenth_is_told(jump_s, state):
    calibration, second = rig()
    frames = second.recording.cameras["cam0"]
    last = frames.t_ns >= np.quantile(frames.t_ns, 0.9)
    jumped = replace(frames, t_ns=frames.t_ns + np.where(last, round(1e9 * jump_s), 0))
    recording = replace(second.recording, cameras={"cam0": jumped})
    found = gnomon.verify(calibration, recording, second.target)
    assert (found.state, found.moved) == (state, ())
    told = " ".join(str(finding) for finding in found.findings)
    assert ("The time shift of cam0 is no constant" if state == "cannot tell" else "cam0.time_shift_cam_imu") in told


@pytest.mark.long
def test_a_rig_is_verified_from_its_calibration_as_without():
    calibration, second = rig()
    fresh = gnomon.calibrate_camera_imu(second.recording, second.target)
    agree(gnomon.verify(calibration, second.recording, second.target), gnomon.verify(calibration, fresh))
    camera = calibration.cameras["cam0"]
    wrong = replace(calibration, cameras={"cam0": replace(camera, time_shift_cam_imu=camera.time_shift_cam_imu + 0.5)})
    agree(gnomon.verify(wrong, second.recording, second.target), gnomon.verify(wrong, fresh))  # too far to start there


def of_scalars(calibration):
    """Return what an IMU's calibration publishes: values and sigmas, both by what they are."""
    imu = calibration.imus["imu0"]
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    return imu.accelerometer.sensitivity, imu.gyroscope.sensitivity, imu.gyroscope.bias, sigma


def agree(one, other, within=0.2):
    """Check that two verifications say the same, sizes within a share of a sigma."""
    assert [(block.path, block.state) for block in one.blocks] == [(block.path, block.state) for block in other.blocks]
    for a, b in zip(one.blocks, other.blocks, strict=True):
        assert np.all(np.abs(a.values - b.values) < within * b.sigma), a.path
        np.testing.assert_allclose(a.sigma, b.sigma, rtol=within)


@pytest.mark.long
def test_a_lens_is_verified_by_cameras_alone():
    scenario = gnomon.CamerasScenario()
    first, second = (gnomon.simulate_cameras(scenario, seed) for seed in (1, 51))
    calibration = gnomon.calibrate_cameras(first.recording, first.target).calibration
    assert gnomon.verify(calibration, second.recording, second.target).state == "holds"
    camera = calibration.cameras["cam0"]
    values = camera.camera.parameters.copy()
    values[:2] *= 1.005
    wrong = replace(calibration, cameras={"cam0": replace(camera, camera=camera.camera.with_parameters(values))})
    found = gnomon.verify(wrong, second.recording, second.target)
    assert [block.path for block in found.moved] == ["cam0.lens"]


def test_a_calibration_without_sigmas_is_verified():
    """As a simulation's truth is, whose numbers count as exact."""
    recording, truth = simulate(Scenario(intervals=14, t_init_s=20.0, hold_s=(3.0, 3.5), rate_hz=50.0), seed=1)
    found = gnomon.verify(truth, recording)
    assert found.state != "moved"
    assert "no standard deviations" in found.notes[0]
