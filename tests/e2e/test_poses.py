"""`gnomon imu` without rotations: an accelerometer alone, averaged poses, one file a pose, known attitudes."""

import json
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.cli.commands.simulated_imu import join_poses, pose_averages
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.recording import ImuSamples, Piece, Poses, Recording, TriadSamples
from gnomon.simulate import PoseScenario, simulate_poses
from gnomon.writers.recording_file import save_pose_files, save_poses, save_recording

STATED = gnomon.ImuOptions(gravity=9.80665)
PATHS = ("imu0.accelerometer.sensitivity", "imu0.accelerometer.bias")
SI = {"sensor": "drawn", "units": "si", "bits": None}


def codes(document):
    return {f["code"]: f["severity"] for f in document["calibration"]["assessment"]["findings"]}


def in_sigmas(calibration, truth):
    """Return the accelerometer's errors over their sigmas."""
    found = []
    for path in PATHS:
        sigma = calibration.sigma(path)
        error = calibration.parameter(path) - truth.parameter(path)
        found.append((error[sigma > 0] / sigma[sigma > 0]).ravel())
    return np.concatenate(found)


@pytest.fixture(scope="module")
def simulation():
    """Angrisano's accelerometer in 18 poses, each to a degree."""
    return simulate_poses(PoseScenario(samples=400), seed=3)


def without_gyroscope(recording):
    samples = recording.imus["imu0"]
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s")
    return Recording(imus={"imu0": ImuSamples(accelerometer=samples.accelerometer, gyroscope=nothing)})


@pytest.fixture(params=["table", "table without sigma", "folder", "files", "recording"])
def given(request, simulation, tmp_path):
    """The same poses in every form, as paths."""
    means = pose_averages(simulation)
    if request.param.startswith("table"):
        sigma = means.accelerometer_sigma if request.param == "table" else None
        table = Poses(
            name=means.name, accelerometer=means.accelerometer, accelerometer_unit="count", accelerometer_sigma=sigma
        )
        save_poses(table, tmp_path / "poses.csv")
        return [tmp_path / "poses.csv"]
    if request.param == "recording":
        return save_recording(without_gyroscope(join_poses(simulation)), tmp_path / "one.csv")
    files = save_pose_files(
        [without_gyroscope(Recording(imus={"imu0": p})).imus["imu0"] for p in simulation.poses], tmp_path
    )
    return [tmp_path] if request.param == "folder" else files


@pytest.mark.main
def test_every_form_gives_the_accelerometer(given, simulation, run, tmp_path):
    code, out, err = run("imu", *given, "--gravity", 9.80665, "--json", "-o", tmp_path / "result")
    assert code == 0, err
    document = json.loads(out)
    assert document["verdict"] == "pass"
    assert (tmp_path / "result" / "report.html").exists()
    calibration = gnomon.load(tmp_path / "result" / "calibration.yaml")
    assert calibration.imus["imu0"].gyroscope is None
    z = in_sigmas(calibration, simulation.truth.in_frame("accel-x"))
    assert np.abs(z).max() < 4
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.8
    assert calibration.assessment.intervals_used == 18
    assert np.isfinite(calibration.assessment.holdout.accelerometer_rms)


def test_words_on_the_terminal(simulation, run, tmp_path):
    (tmp_path / "poses").mkdir()
    save_pose_files(simulation.poses, tmp_path / "poses")
    code, out, err = run("imu", tmp_path / "poses", "-o", tmp_path / "result")
    assert code == 0, err
    assert "18 files, one pose each" in out
    assert "poses              18 used of 18" in out
    assert "Rests do not show the gyroscope's scale" in out


def test_the_frame_of_named_poses(simulation):
    recording = Recording(imus={}, poses=pose_averages(simulation))
    result = gnomon.calibrate_imu(recording, gnomon.ImuOptions(gravity=9.80665, frame="x=1 y=2"))
    calibration = result.calibration
    assert calibration.frame == "user"
    force = calibration.imus["imu0"].accelerometer.specific_force(simulation.accelerometer[:2])
    assert np.abs(force - 9.80665 * np.eye(3)[:2]).max() < 0.4  # the attitudes themselves are a degree off


class TestKnownAttitudes:
    """Angrisano, Eqs. (4) to (7): the components are known, and the sensor lies somehow in its jig."""

    SCENARIO = PoseScenario(**SI, known=True, attitude_error_deg=0.02, jig_rotation_deg=(3.0, -5.0, 2.0), samples=400)

    def poses(self, seed=1):
        return pose_averages(simulate_poses(self.SCENARIO, seed))

    def in_jig(self, seed):
        """Return the true sensitivity by the axes of the jig."""
        truth = simulate_poses(self.SCENARIO, seed).truth.imus["imu0"].accelerometer
        return truth.sensitivity @ rotation_from_rotvec(np.radians(self.SCENARIO.jig_rotation_deg)), truth.bias

    def test_alignment_and_nine_entries(self):
        z = []
        for seed in range(8):
            means = self.poses(seed)
            calibration = gnomon.calibrate_imu(Recording(imus={}, poses=means), STATED).calibration
            sensitivity, bias = self.in_jig(seed)
            assert calibration.frame == "user"
            error = calibration.parameter(PATHS[0]) - sensitivity
            assert (calibration.sigma(PATHS[0]) > 0).all()
            z += [*(error / calibration.sigma(PATHS[0])).ravel()]
            z += [*((calibration.parameter(PATHS[1]) - bias) / calibration.sigma(PATHS[1]))]
        assert 0.8 < np.std(z) < 1.25
        assert np.abs(z).max() < 4.5

    def test_four_attitudes_suffice(self):
        means = self.poses()
        keep = [0, 1, 2, 3]
        few = Poses(
            name=tuple(means.name[k] for k in keep),
            accelerometer=means.accelerometer[keep],
            accelerometer_unit=means.accelerometer_unit,
            accelerometer_sigma=means.accelerometer_sigma[keep],
            specific_force=means.specific_force[keep],
        )
        calibration = gnomon.calibrate_imu(Recording(imus={}, poses=few), STATED).calibration
        assert np.abs(calibration.parameter(PATHS[0]) - self.in_jig(1)[0]).max() < 0.05

    def test_misstated_attitudes_are_named(self, run, tmp_path):
        means = self.poses()
        stated = means.specific_force.copy()
        stated[4] *= -1
        row = next(k for k in range(6, 18) if stated[k, 0] != stated[k, 1])
        stated[row] = stated[row][[1, 0, 2]]
        save_poses(replace(means, specific_force=stated), tmp_path / "poses.csv")
        code, out, err = run("imu", tmp_path / "poses.csv", "--gravity", 9.80665, "--json", "-o", tmp_path / "result")
        assert code == 0, err
        document = json.loads(out)
        named = [
            f["message"] for f in document["calibration"]["assessment"]["findings"] if f["code"] == "attitude-misstated"
        ]
        assert len(named) == 2
        assert any(text.startswith("pose 5: gravity is 1") and "the sign of" in text for text in named)
        assert any(text.startswith(f"pose {row + 1}: ") and "x and y swapped" in text for text in named)
        calibration = gnomon.load(tmp_path / "result" / "calibration.yaml")
        assert np.abs(calibration.parameter(PATHS[0]) - self.in_jig(1)[0]).max() < 2e-3

    def test_attitudes_to_ten_degrees_give_the_same_accelerometer(self):
        rough = pose_averages(simulate_poses(replace(self.SCENARIO, attitude_error_deg=10.0), 2))
        exact = pose_averages(simulate_poses(self.SCENARIO, 2))
        shapes = []
        for means in (rough, exact):
            calibration = gnomon.calibrate_imu(Recording(imus={}, poses=means), STATED).calibration
            shapes.append(calibration.in_frame("accel-x").parameter(PATHS[0]))
        np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-3)

    def test_frame_and_known_attitudes_contradict_each_other(self):
        means = self.poses()
        with pytest.raises(gnomon.OptionError, match="--frame"):
            gnomon.calibrate_imu(Recording(imus={}, poses=means), gnomon.ImuOptions(frame="accel-z"))


class TestPresetAngrisano:
    """Angrisano as its authors carry it out."""

    OPTIONS = gnomon.ImuOptions(preset="angrisano", gravity=9.80665, bits=16, full_scale=50.0)

    def test_table_1(self, simulation, run, tmp_path):
        save_poses(pose_averages(simulation), tmp_path / "poses.csv")
        options = ["--preset", "angrisano", "--bits", 16, "--full-scale", 50, "--gravity", 9.80665]
        code, out, err = run("imu", tmp_path / "poses.csv", *options, "-o", tmp_path / "result")
        assert code == 0, err
        assert "calibrates the accelerometer alone" in " ".join(out.split())
        calibration = gnomon.load(tmp_path / "result" / "calibration.yaml")
        assert calibration.frame == "accel-z"
        assert calibration.imus["imu0"].gyroscope is None
        assert np.abs(in_sigmas(calibration, simulation.truth)).max() < 4

    def test_iterations_and_history(self, simulation):
        result = gnomon.calibrate_imu(Recording(imus={}, poses=pose_averages(simulation)), self.OPTIONS)
        history = result.diagnostics.triads["accelerometer"].history
        assert 3 <= len(history.q) <= 6
        assert history.parameters.shape == (len(history.q), 9)
        assert (np.diff(history.q) < 0).all()
        assert {f.code for f in result.calibration.assessment.findings} >= {"iteration", "preset-start"}

    def test_the_default_finds_the_same_minimum(self, simulation):
        recording = Recording(imus={}, poses=pose_averages(simulation))
        ours = gnomon.calibrate_imu(recording, STATED).calibration
        theirs = gnomon.calibrate_imu(recording, self.OPTIONS).calibration.in_frame("accel-x")
        for path in PATHS:
            sigma = np.maximum(ours.sigma(path), 1e-9)
            assert np.abs((ours.parameter(path) - theirs.parameter(path)) / sigma).max() < 1.0

    def test_both_geometries_are_one_sensor(self, simulation):
        recording = Recording(imus={}, poses=pose_averages(simulation))
        found = [
            gnomon.calibrate_imu(recording, replace(self.OPTIONS, geometry=geometry)).calibration.parameter(PATHS[0])
            for geometry in ("small-angle", "exact")
        ]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-4)

    def test_a_wrong_start_is_condemned(self, simulation, run, tmp_path):
        save_poses(pose_averages(simulation), tmp_path / "poses.csv")
        options = ["--preset", "angrisano", "--bits", 12, "--full-scale", 50, "--gravity", 9.80665]
        code, out, err = run("imu", tmp_path / "poses.csv", *options, "--json", "-o", tmp_path / "result")
        document = json.loads(out)
        if code == 4:
            assert codes(document)["wrong-minimum"] == "problem"
        else:
            assert code == 3
            assert "diverged" in err

    def test_counts_need_the_data_sheet(self, simulation):
        with pytest.raises(gnomon.OptionError, match="--bits 16 --full-scale 50"):
            gnomon.calibrate_imu(
                Recording(imus={}, poses=pose_averages(simulation)), gnomon.ImuOptions(preset="angrisano")
            )

    def test_units_start_from_themselves(self):
        simulation = simulate_poses(PoseScenario(**SI), 4)
        recording = Recording(imus={}, poses=pose_averages(simulation))
        options = gnomon.ImuOptions(preset="angrisano", gravity=9.80665)
        calibration = gnomon.calibrate_imu(recording, options).calibration
        assert np.abs(in_sigmas(calibration, simulation.truth)).max() < 4.5

    def test_components_where_attitudes_are_known(self):
        simulation = simulate_poses(PoseScenario(**SI, known=True, attitude_error_deg=0.0), 4)
        recording = Recording(imus={}, poses=pose_averages(simulation))
        options = gnomon.ImuOptions(preset="angrisano", gravity=9.80665)
        calibration = gnomon.calibrate_imu(recording, options).calibration
        assert np.abs(in_sigmas(calibration, simulation.truth)).max() < 4.5


def moving(samples, seed=0):
    rng = np.random.default_rng(seed)
    shaken = samples.accelerometer.values + 300 * np.cumsum(rng.normal(size=(len(samples.accelerometer), 3)), axis=0)
    triad = samples.accelerometer
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=triad.t_ns, values=shaken, unit=triad.unit), gyroscope=samples.gyroscope
    )


def test_files_that_never_rest_are_left_out_by_name(simulation, run, tmp_path):
    poses = list(simulation.poses)
    poses[6] = moving(poses[6])
    (tmp_path / "poses").mkdir()
    save_pose_files(poses, tmp_path / "poses")
    code, out, err = run("imu", tmp_path / "poses", "--json", "-o", tmp_path / "result")
    assert code == 0, err
    (finding,) = [f for f in json.loads(out)["calibration"]["assessment"]["findings"] if f["code"] == "poses-left-out"]
    assert "pose07.csv (the sensor never rests in it)" in finding["message"]


def test_handling_at_the_ends_of_a_file_does_not_count(simulation):
    def handled(samples, k):
        values = samples.accelerometer.values.copy()
        values[:80] += 400 * np.sin(np.arange(80) / 5 + k)[:, None] * [1, -0.5, 0.7]
        triad = samples.accelerometer
        return TriadSamples(t_ns=triad.t_ns, values=values, unit=triad.unit)

    rest = Recording(imus={"imu0": simulation.poses[0]})
    triads = [handled(samples, k) for k, samples in enumerate(simulation.poses)]
    joined_up = TriadSamples(
        t_ns=np.concatenate([t.t_ns for t in triads]), values=np.concatenate([t.values for t in triads]), unit="count"
    )
    pieces = tuple(Piece(name=f"{k}", start=400 * k, stop=400 * (k + 1)) for k in range(18))
    nothing = without_gyroscope(rest).imus["imu0"].gyroscope
    recording = Recording(imus={"imu0": ImuSamples(accelerometer=joined_up, gyroscope=nothing)}, pieces=pieces)
    result = gnomon.calibrate_imu(recording, STATED)
    assert result.calibration.assessment.intervals_used == 18
    assert (result.diagnostics.triads["accelerometer"].poses.samples <= 320).all()
    assert np.abs(in_sigmas(result.calibration, simulation.truth.in_frame("accel-x"))).max() < 4


BAD = {
    "one orientation": lambda m: np.repeat(m[:1], len(m), axis=0) + np.arange(len(m))[:, None] * 1e-3,
    "five attitudes": lambda m: m[[0, 1, 2, 3, 4] * 3],
    "turned about one axis": lambda m: np.array(
        [[33000 + 5400 * np.sin(a), 33000 + 5400 * np.cos(a), 32000] for a in np.linspace(0, 5, 20)]
    ),
    "two poses": lambda m: m[:2],
}


@pytest.mark.parametrize("what", BAD)
def test_bad_poses_are_refused_in_words(what, simulation, run, tmp_path, names):
    means = BAD[what](simulation.accelerometer)
    table = Poses(name=tuple(map(str, range(len(means)))), accelerometer=means, accelerometer_unit="count")
    save_poses(table, tmp_path / "poses.csv")
    code, _, err = run("imu", tmp_path / "poses.csv", "--json", "-o", tmp_path / "result")
    assert code in {3, 4}, err
    assert "Traceback" not in err
    assert "bug" not in err
    if code == 3:
        assert "attitude" in err or "plane" in err or "orientation" in err
        assert names(tmp_path) == ["poses.csv"]


def test_whole_recordings_are_no_poses(good_table, write_table, run, tmp_path):
    rng = np.random.default_rng(4)
    for k in range(3):  # of their own noise: the same data twice are refused as that
        noise = 1e-3 * rng.normal(size=good_table.shape)
        noise[:, 0] = 0
        write_table(tmp_path / f"{k}.csv", good_table + noise)
    code, _, err = run("imu", tmp_path, "-o", tmp_path / "result")
    assert code == 3
    assert "several recordings of one sensor" in err


def test_check_says_what_the_files_are(simulation, run, tmp_path):
    save_pose_files(simulation.poses, tmp_path)
    code, out, err = run("check", tmp_path)
    assert code == 0, err
    assert "18 files of one pose each" in out


@pytest.mark.parametrize("output", ["poses.csv", "poses.npz", "poses"])
def test_simulate_poses_writes_what_imu_takes(output, run, tmp_path, names):
    options = ["--samples", 400, "--sensor", "drawn", "--units", "si", "--seed", 4, "--known"]
    code, out, err = run("simulate", "poses", "-o", tmp_path / output, *options, "--json")
    assert code == 0, err
    document = json.loads(out)
    truth = gnomon.load(document["truth"])
    code, out, err = run("imu", tmp_path / output, "--gravity", 9.80665, "--json", "--no-report", "-o", tmp_path / "r")
    assert code == 0, err
    calibration = gnomon.load(tmp_path / "r" / "calibration.yaml")
    assert calibration.frame == ("user" if output == "poses.csv" else "accel-x")  # only a table tells the attitudes
    assert np.abs(in_sigmas(calibration.in_frame("accel-z"), truth)).max() < 4.5
    assert names(tmp_path)[0] == output
