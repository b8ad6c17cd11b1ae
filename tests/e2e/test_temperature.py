"""`gnomon temperature` from recordings to a corrected recording, and what it refuses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.recording import TemperatureSamples
from gnomon.simulate import Scenario, simulate
from gnomon.simulate.scenarios.recorded import TemperatureScenario
from gnomon.simulate.temperature import simulate_temperature
from gnomon.writers.recording_file import save_recording

SCENARIO = TemperatureScenario(recordings=3, rate_hz=10.0, duration_s=900.0, order=1, step_k=0.1)


@pytest.fixture(scope="module")
def warm_ups(tmp_path_factory):
    folder = tmp_path_factory.mktemp("warm-ups")
    made = simulate_temperature(SCENARIO, 11)
    paths = [folder / f"{i}.npz" for i in range(3)]
    for path, recording in zip(paths, made.recordings, strict=True):
        save_recording(recording, path)
    return made, paths


@pytest.fixture(scope="module")
def by_one(warm_ups):
    """The result of the first warm-up alone."""
    return gnomon.calibrate_temperature(warm_ups[0].recordings[:1])


@pytest.mark.long
def test_the_command_finds_it_and_apply_takes_it_off(warm_ups, run, tmp_path):
    made, paths = warm_ups
    code, out, err = run("temperature", *paths[:2], "-o", tmp_path / "found", "--json")
    assert code == 0, err
    document = json.loads(out)
    assert document["orders"] == {"gyroscope": 1, "accelerometer": 1}
    page = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    told = re.findall(r"left out: rms ([\d.]+) \S+ before, ([\d.]+) \S+ after", page)
    assert len(told) == 2
    assert all(float(after) < 0.3 * float(before) for before, after in told)
    found = tmp_path / "found" / "calibration.yaml"
    corrected = tmp_path / "corrected.csv"
    code, _, err = run("apply", found, paths[2], "-o", corrected)
    assert code == 0, err
    rate = np.loadtxt(corrected, delimiter=",", skiprows=1)[:, 1:4]
    raw = made.recordings[2].imus["imu0"].gyroscope.values
    drift = [np.ptp([part.mean(axis=0) for part in np.array_split(one, 10)], axis=0).max() for one in (raw, rate)]
    assert drift[1] < drift[0] / 4
    assert run("show", found)[1].count("gyroscope_bias1_") == 3


@pytest.mark.long
def test_apply_needs_a_temperature_and_tells_of_its_range(warm_ups, by_one, run, tmp_path):
    made, _ = warm_ups
    found = tmp_path / "calibration.yaml"
    gnomon.save(by_one.calibration, found)
    imu = made.recordings[2].imus["imu0"]
    bare = tmp_path / "bare.npz"
    save_recording(gnomon.Recording(imus={"imu0": replace(imu, temperature=None)}), bare)
    code, _, err = run("apply", found, bare, "-o", tmp_path / "x.csv")
    assert code == 3
    assert "temperature" in err
    assert run("apply", found, bare, "-o", tmp_path / "x.csv", "--temperature-c", "20")[0] == 0
    code, out, err = run("apply", found, bare, "-o", tmp_path / "x.csv", "--temperature-c", "90")
    assert code == 0
    assert "beyond the range" in out + err
    assert run("apply", found, bare, "-o", tmp_path / "y.csv", "--temperature-c", "90", "--strict")[0] == 3
    assert not (tmp_path / "y.csv").exists()


@pytest.mark.long
def test_it_is_added_to_a_calibration_that_says_at_which_temperature_it_holds(warm_ups):
    made, _ = warm_ups
    base = simulate(Scenario(intervals=12, t_init_s=6.0), 1)[1]
    with pytest.raises(gnomon.OptionError, match="--reference-degc"):
        gnomon.calibrate_temperature(made.recordings[:1], base)
    result = gnomon.calibrate_temperature(made.recordings[:1], base, reference_degc=30.0)
    assert result.calibration.imus["imu0"].temperature.reference_degc == 30.0
    assert np.array_equal(result.calibration.parameter("imu0.gyroscope.bias"), base.parameter("imu0.gyroscope.bias"))
    assert not result.nominal


def test_what_was_wrong_with_the_calibration_stays_said(warm_ups):
    made, _ = warm_ups
    base = simulate(Scenario(intervals=12, t_init_s=6.0), 1)[1]
    wrong = gnomon.Finding(severity="problem", code="holdout", message="It does not fit.")
    base = replace(base, assessment=replace(base.assessment, verdict="fail", findings=(wrong,)))
    result = gnomon.calibrate_temperature(made.recordings[:1], base, reference_degc=30.0)
    assert result.calibration.verdict == "fail"
    assert wrong in result.calibration.assessment.findings


@pytest.mark.long
def test_a_calibration_that_came_of_it_is_a_calibration_as_any(warm_ups, by_one):
    made, _ = warm_ups
    assert by_one.nominal
    sensor = by_one.calibration.imus["imu0"]
    bias = np.array([0.1, -0.2, 0.3])
    known = replace(sensor, gyroscope=replace(sensor.gyroscope, bias=bias), temperature=None)
    again = gnomon.calibrate_temperature(
        made.recordings[1:2], replace(by_one.calibration, imus={"imu0": known}), reference_degc=30.0
    )
    assert not again.nominal
    assert np.array_equal(again.calibration.imus["imu0"].gyroscope.bias, bias)


@pytest.fixture(scope="module")
def oven(tmp_path_factory):
    folder = tmp_path_factory.mktemp("oven")
    made = simulate_temperature(replace(SCENARIO, turned=True, rate_hz=100.0), 12)
    paths = [folder / f"{i}.npz" for i in range(3)]
    for path, recording in zip(paths, made.recordings, strict=True):
        save_recording(recording, path)
    return made, paths


@pytest.fixture(scope="module")
def by_oven(oven, run, tmp_path_factory):
    """The folder of the command's result by the turned recordings, and what it said as JSON."""
    folder = tmp_path_factory.mktemp("by-oven") / "found"
    code, out, err = run("temperature", *oven[1], "-o", folder, "--json")
    assert code == 0, err
    return folder, json.loads(out)


@pytest.mark.long
def test_scales_follow_the_temperature_of_three_turned_recordings(oven, by_oven, run):
    made, _ = oven
    folder, document = by_oven
    assert document["orders"] == document["sensitivity_orders"] == {"gyroscope": 1, "accelerometer": 1}
    known = gnomon.load(folder / "calibration.yaml")
    found = known.imus["imu0"].temperature
    for part in ("accelerometer_sensitivity", "gyroscope_sensitivity"):
        sigma = known.sigma(f"imu0.temperature.{part}")
        free = np.tril(np.ones((3, 3), dtype=bool)) if part.startswith("acc") else np.ones((3, 3), dtype=bool)
        z = ((getattr(found, part) - getattr(made.truth, part)) / np.where(free, sigma, 1.0))[0]
        assert np.sqrt(np.mean(z[free] ** 2)) < 2.0
        assert np.abs(z[free]).max() < 3.5
        assert not z[~free].any()
        assert np.all(sigma[0][free] < 3e-5)
    assert "scale over the temperature" in (folder / "report.html").read_text(encoding="utf-8")
    assert run("show", folder)[1].count("accelerometer_sensitivity1_") == 6


def test_scales_of_turned_recordings_are_those_of_the_stated_gravity(oven, run, tmp_path):
    _, paths = oven
    code, _, err = run("temperature", *paths, "-o", tmp_path / "found", "--gravity", "9.82", "--no-report")
    assert code == 0, err
    known = gnomon.load(tmp_path / "found" / "calibration.yaml")
    assert known.gravity.value == 9.82
    assert known.provenance.options["gravity"] == "9.82"
    scale = np.diag(known.imus["imu0"].accelerometer.sensitivity)
    relative = np.diag(known.sigma("imu0.accelerometer.sensitivity")) / scale
    assert np.all(relative < 8e-4)  # 2e-3 where gravity is not stated


@pytest.mark.long
def test_a_rate_at_another_temperature_is_right_after_apply(oven, by_oven):
    made, _ = oven
    sensor = gnomon.load(by_oven[0]).imus["imu0"]
    assert made.sensor is not None
    true = replace(made.sensor, temperature=made.truth)
    for recording in (made.recordings[0], made.recordings[2]):
        samples = recording.imus["imu0"]
        wanted, without = true.apply(samples), replace(sensor, temperature=None).apply(samples)
        for name in ("accelerometer", "gyroscope"):
            off = [
                np.abs(getattr(one, name).values - getattr(wanted, name).values).mean()
                for one in (sensor.apply(samples), without)
            ]
            assert off[0] < off[1] / 3


@pytest.mark.slow
def test_the_g_sensitivity_follows_the_temperature_of_three_turned_recordings(run, tmp_path):
    scenario = replace(SCENARIO, turned=True, rate_hz=100.0, g_sensitivity=3e-6)
    made = simulate_temperature(scenario, 21)
    result = gnomon.calibrate_temperature(made.recordings)
    known = result.calibration
    found, path = known.imus["imu0"].temperature, "imu0.temperature.gyroscope_g_sensitivity"
    assert found.gyroscope_g_sensitivity.shape == (1, 3, 3)
    z = (found.gyroscope_g_sensitivity - made.truth.gyroscope_g_sensitivity) / known.sigma(path)
    assert np.sqrt(np.mean(z**2)) < 2.0
    assert np.abs(z).max() < 3.5
    told = [one.message for one in known.assessment.findings if one.code == "temperature-g-sensitivity"]
    assert len(told) == 1
    # In the cold it is another one: rates are off by less than where that is not known.
    samples = made.recordings[0].imus["imu0"]
    without = replace(known.imus["imu0"], temperature=replace(found, gyroscope_g_sensitivity=None))
    true = replace(made.sensor, temperature=made.truth).apply(samples).gyroscope.values
    rates = [one.apply(samples).gyroscope.values for one in (known.imus["imu0"], without)]
    off = [float(np.std(rate - true, axis=0).max()) for rate in rates]
    assert off[0] < off[1] / 2
    # The file knows it, and the command that applies it block by block does the same as the library.
    gnomon.save(known, tmp_path / "calibration.yaml")
    assert "schema: gnomon/1.8" in (tmp_path / "calibration.yaml").read_text(encoding="utf-8")
    save_recording(made.recordings[0], tmp_path / "cold.npz")
    assert run("apply", tmp_path / "calibration.yaml", tmp_path / "cold.npz", "-o", tmp_path / "out.csv")[0] == 0
    written = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, 1:4]
    assert np.allclose(written, rates[0], rtol=0, atol=1e-9)


@pytest.mark.long
def test_warm_ups_and_turned_recordings_are_told_apart_and_joined(oven, warm_ups):
    made, _ = oven
    recordings = [*made.recordings, simulate_temperature(replace(SCENARIO, recordings=1), 12).recordings[0]]
    result = gnomon.calibrate_temperature(recordings)
    assert not result.nominal
    assert result.sensitivities["accelerometer"].order == 1
    assert len(result.triads["gyroscope"].axes[0].degc) > 20
    assert "one-attitude" not in {finding.code for finding in result.calibration.assessment.findings}


@pytest.mark.long
def test_it_is_verified_and_compared_at_the_temperature_of_a_recording(oven, by_oven, run, tmp_path):
    made, _ = oven
    folder, _ = by_oven
    known = gnomon.load(folder)
    # The same seed and range are the same sensor; the fourth of five is at 34 degC.
    fresh = simulate_temperature(replace(SCENARIO, turned=True, rate_hz=100.0, recordings=5), 12).recordings[3]
    assert gnomon.verify(known, fresh).state == "holds"
    imu = replace(known.imus["imu0"], temperature=None)
    kept = [i for i, name in enumerate(known.uncertainty.names) if ".temperature." not in name]
    names = tuple(known.uncertainty.names[i] for i in kept)
    fixed = replace(known.uncertainty, names=names, matrix=known.uncertainty.matrix[np.ix_(kept, kept)])
    assert gnomon.verify(replace(known, imus={"imu0": imu}, uncertainty=fixed), fresh).state == "moved"
    with pytest.raises(gnomon.OptionError, match="tells none"):
        gnomon.verify(known, without_thermometer(fresh))
    first, last = (gnomon.calibrate_imu(made.recordings[i]).calibration for i in (0, 2))
    hot = float(made.degc[2].mean())
    at_its_own = gnomon.compare(known, last, temperature_c=hot)
    assert at_its_own.verdict != "fail"
    assert gnomon.compare(known, first, temperature_c=hot).verdict == "fail"
    gnomon.save(last, tmp_path / "a.yaml")
    code, _, err = run("compare", folder, tmp_path / "a.yaml", "--temperature-c", hot, "--no-report")
    assert code == 0, err
    assert run("compare", folder, tmp_path / "a.yaml", "--temperature-c", 90, "--no-report")[0] == 2


def test_turned_recordings_at_one_temperature_are_refused(oven):
    same = replace(SCENARIO, turned=True, rate_hz=50.0, start_degc=20.0, end_degc=20.0, intervals=12)
    with pytest.raises(gnomon.RecordingError, match="3 temperatures or more"):
        gnomon.calibrate_temperature(simulate_temperature(same, 3).recordings)


def turned(recording):
    imu = recording.imus["imu0"]
    values = imu.accelerometer.values.copy()
    values[len(values) // 2 :] = values[len(values) // 2 :, [2, 0, 1]]
    return gnomon.Recording(imus={"imu0": replace(imu, accelerometer=replace(imu.accelerometer, values=values))})


def without_thermometer(recording):
    return gnomon.Recording(imus={"imu0": replace(recording.imus["imu0"], temperature=None)})


def in_counts(recording):
    imu = recording.imus["imu0"]
    return gnomon.Recording(imus={"imu0": replace(imu, temperature=replace(imu.temperature, unit="count"))})


@pytest.mark.parametrize(
    ("change", "says"), [(turned, "turned by"), (without_thermometer, "temperature"), (in_counts, "temperature")]
)
def test_what_tells_nothing_is_refused(warm_ups, change, says):
    made, _ = warm_ups
    with pytest.raises(gnomon.RecordingError, match=says):
        gnomon.calibrate_temperature([change(made.recordings[0])])


def test_samples_that_hide_what_a_warm_up_shall_tell_are_named(warm_ups, by_one):
    """The signals are looked at as those of every other recording."""
    made, _ = warm_ups
    imu = made.recordings[0].imus["imu0"]
    rate, middle = imu.gyroscope.values, np.median(imu.gyroscope.values, axis=0)
    dead = np.where(np.abs(rate - middle) < rate.std(axis=0), middle, rate)
    spoilt = replace(imu, gyroscope=replace(imu.gyroscope, values=dead))
    found = gnomon.calibrate_temperature([gnomon.Recording(imus={"imu0": spoilt})])
    assert "dead-band" in {f.code for f in found.calibration.assessment.findings if f.severity == "warning"}
    assert "dead-band" not in {f.code for f in by_one.calibration.assessment.findings}


def test_the_same_recording_twice_is_refused(warm_ups):
    made, _ = warm_ups
    with pytest.raises(gnomon.GnomonError):
        gnomon.calibrate_temperature([made.recordings[0], made.recordings[0]])


def test_simulated_warm_ups_are_read_by_the_command_that_they_propose(run, tmp_path):
    options = ("--recordings", "1", "--duration-s", "300", "--json")
    code, out, err = run("simulate", "temperature", "-o", tmp_path / "w", *options)
    assert code == 0, err
    files = json.loads(out)["recordings"]
    assert run("temperature", *files, "--no-report")[0] == 0


@pytest.mark.long
def test_a_temperature_that_goes_one_way_is_told(by_one):
    """A drift from the start on looks the same; one recording that also cools down tells them apart."""
    back = simulate_temperature(replace(SCENARIO, recordings=1, back=True), 11)
    both_ways = gnomon.calibrate_temperature(back.recordings)
    told, untold = ({finding.code for finding in one.calibration.assessment.findings} for one in (by_one, both_ways))
    assert "temperature-one-way" in told - untold


@pytest.mark.long
def test_imu_tells_its_temperature_and_what_goes_on(run, tmp_path):
    scenario = TemperatureScenario(
        turned=True, order=1, sensitivity_order=0, recordings=1, intervals=24, rate_hz=50.0, self_heating_k=15.0,
        time_constant_s=50.0, back=True,
    )  # fmt: skip
    save_recording(simulate_temperature(scenario, 3).recordings[0], tmp_path / "warm.npz")
    code, out, err = run("imu", tmp_path / "warm.npz", "-o", tmp_path / "result")
    assert code == 0, err
    assert "bias follows the temperature" in " ".join(out.split())
    assert "(T - T_ref)^1" in out
    assert f"gnomon temperature WARM-UP --calibration {tmp_path / 'result'}" in out
    page = (tmp_path / "result" / "report.html").read_text(encoding="utf-8")
    assert "bias over the temperature" in page
    assert "Temperature of the chip" in page


def test_camera_imu_says_that_the_warm_up_is_not_over():
    scenario = gnomon.CameraImuScenario(
        duration_s=9.0, motion="normal", imu_rate_hz=100.0, camera_rate_hz=10.0, target_cols=3, target_rows=3
    )
    made = gnomon.simulate_camera_imu(scenario, 3)
    imu = made.recording.imus["imu0"]
    t_ns = imu.gyroscope.t_ns[::10]
    degc = 40 - 15 * np.exp(-(t_ns - t_ns[0]) * 1e-9 / 5)
    warm = replace(imu, temperature=TemperatureSamples(t_ns=t_ns, values=degc, unit="degC"))
    recording = replace(made.recording, imus={"imu0": warm})
    result = gnomon.calibrate_camera_imu(recording, made.target, gnomon.CameraImuOptions(model="basic"))
    told = [one for one in result.calibration.assessment.findings if one.code == "temperature"]
    assert len(told) == 1
    assert "time constant 5 s" in told[0].message
