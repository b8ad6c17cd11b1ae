"""A dependence on temperature in every file that holds one: read back, and by the formulas of PX4, ArduPilot and C."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.formats.foreign_files import load_any
from gnomon.formats.shared.si_units import with_full_scale
from gnomon.recording import ImuSamples, TemperatureSamples, TriadSamples
from gnomon.results.calibration import Covariance, calibration_parameters, covariance_names
from gnomon.results.moved import imus_at_temperature
from gnomon.results.sensors import MagnetometerCalibration
from gnomon.results.temperature_dependence import TemperatureDependence
from gnomon.simulate import Scenario, simulate

FOUND = TemperatureDependence(
    reference_degc=22.0,
    low_degc=-5.0,
    high_degc=51.5,
    lag_s=17.0,
    accelerometer_bias=np.array([[1e-3, -2e-3, 3e-3]]),
    gyroscope_bias=np.array([[1e-4, 2e-4, -3e-4], [1e-6, -2e-6, 3e-6], [4e-8, 5e-8, -6e-8]]),
    accelerometer_sensitivity=np.tril(np.array([[[2e-4, 0, 0], [1e-5, -1e-4, 0], [2e-5, -3e-5, 3e-4]]])),
    gyroscope_sensitivity=np.array([1e-4 * np.eye(3) + 1e-5, 2e-6 * np.eye(3) - 1e-7]),
    gyroscope_g_sensitivity=np.array([[[3e-6, -1e-6, 2e-6], [4e-7, -5e-6, 1e-6], [2e-6, 1e-6, 6e-6]]]),
    magnetometer_bias=np.array([[0.1, -0.2, 0.05], [1e-3, 2e-3, -1e-3]]),
    magnetometer_sensitivity=np.array([np.diag([-3e-3, -2.8e-3, -3.1e-3])]),
)
MAGNETOMETER = MagnetometerCalibration(
    sensitivity=np.diag([1.02, 0.97, 1.05]), bias=np.array([12.0, -31.0, 7.5]), unit="uT", field_unit="uT"
)
DEGC = np.array([-20.0, -5.0, 0.0, 22.0, 40.0, 51.5, 80.0])


@pytest.fixture(scope="module")
def calibration():
    known = simulate(Scenario(intervals=12, t_init_s=6.0), 3)[1]
    imus = {"imu0": replace(known.imus["imu0"], magnetometer=MAGNETOMETER, temperature=FOUND)}
    names = covariance_names(imus)
    matrix = np.diag(np.linspace(1.0, 2.0, len(names)) ** 2 * 1e-8)
    return replace(known, imus=imus, uncertainty=Covariance(names=names, matrix=matrix))


@pytest.mark.parametrize("file", ["calibration.yaml", "calibration.json", "calibration.csv"])
def test_own_files_read_back_to_the_bit(calibration, tmp_path, file):
    kind = file.partition(".")[2]
    if kind == "yaml":
        gnomon.save(calibration, tmp_path / file)
    else:
        gnomon.convert(calibration, kind, tmp_path)
    read = load_any(tmp_path / file).imus["imu0"].temperature
    for key in ("reference_degc", "low_degc", "high_degc", "lag_s"):
        assert getattr(read, key) == getattr(FOUND, key)
    for part, value in FOUND.parts():
        assert np.array_equal(getattr(read, part), value)
    if kind != "csv":
        assert np.array_equal(gnomon.load(tmp_path / file).uncertainty.matrix, calibration.uncertainty.matrix)


def parameters(text):
    found = re.findall(r"([A-Z]\w+)[\t,]([-+\d.e]+)(?:\t\d+)?$", text, re.M)
    return {name: float(value) for name, value in found}


def test_px4s_formula_takes_off_the_same(calibration, tmp_path):
    gnomon.convert(calibration, "px4", tmp_path)
    known = parameters((tmp_path / "px4.params").read_text(encoding="utf-8"))
    assert known["TC_A_ENABLE"] == known["TC_G_ENABLE"] == 1
    for letter, part in (("A", "accelerometer_bias"), ("G", "gyroscope_bias")):
        prefix = f"TC_{letter}0_"
        t = np.clip(DEGC, known[f"{prefix}TMIN"], known[f"{prefix}TMAX"]) - known[f"{prefix}TREF"]
        off = sum(np.outer(t**order, [known[f"{prefix}X{order}_{axis}"] for axis in range(3)]) for order in range(4))
        assert np.allclose(off, FOUND.change(part, DEGC), rtol=1e-12, atol=1e-15)


def test_ardupilots_formula_takes_off_the_same(calibration, tmp_path):
    gnomon.convert(calibration, "ardupilot", tmp_path)
    known = parameters((tmp_path / "ardupilot.param").read_text(encoding="utf-8"))
    for name, part in (("ACC", "accelerometer_bias"), ("GYR", "gyroscope_bias")):
        low, high = known["INS_TCAL1_TMIN"], known["INS_TCAL1_TMAX"]

        def polynomial(degc, name=name):
            e = (degc - 35.0)[:, None]
            c = np.array([[known[f"INS_TCAL1_{name}{k}_{axis}"] for axis in "XYZ"] for k in (1, 2, 3)])
            return (c[0] + (c[1] + c[2] * e) * e) * e * 1e-6

        calibrated_at = np.array([known[f"INS_{name}1_CALTEMP"]])
        off = polynomial(np.clip(DEGC, low, high)) - polynomial(np.clip(calibrated_at, low, high))
        assert np.allclose(off, FOUND.change(part, DEGC), rtol=1e-9, atol=1e-13)


def coefficients_in_c(text, name):
    """Return the numbers of an array of the header as they stand there."""
    found = re.search(rf"gnomon_imu0_{name}\[[^=]*= ([^;]*);", text)
    return np.array([float(number) for number in re.findall(r"GNOMON_R\(([^)]*)\)", found[1])])


@pytest.mark.parametrize("program", ["json", "csv", "px4", "ardupilot", "c-header"])
def test_every_export_is_within_a_millionth_of_a_sigma(calibration, tmp_path, program):
    gnomon.convert(calibration, program, tmp_path)
    if program == "c-header":
        text = (tmp_path / "gnomon_imu.h").read_text(encoding="utf-8")
        names = {part: f"{part.replace('bias', '')}by_temperature" for part, _ in FOUND.parts() if "bias" in part}
        names |= {part: f"{part}_by_temperature" for part, _ in FOUND.parts() if "bias" not in part}
        read = {part: coefficients_in_c(text, name).reshape(getattr(FOUND, part).shape) for part, name in names.items()}
    else:
        file = {"px4": "px4.params", "ardupilot": "ardupilot.param"}.get(program, f"calibration.{program}")
        there = load_any(tmp_path / file).imus["imu0"].temperature
        assert (there.reference_degc, there.low_degc, there.high_degc) == (22.0, -5.0, 51.5)
        read = dict(there.parts())
    flight = program in {"px4", "ardupilot"}
    assert set(read) == ({"accelerometer_bias", "gyroscope_bias"} if flight else {part for part, _ in FOUND.parts()})
    for part, values in read.items():
        sigma = calibration.sigma(f"imu0.temperature.{part}")
        assert np.abs((values - getattr(FOUND, part)) / sigma).max() < 1e-6


@pytest.mark.parametrize("program", ["px4.params", "ardupilot.param"])
def test_parameters_of_autopilots_are_read_with_their_temperature(calibration, tmp_path, program):
    """Offsets beyond the polynomial, another reference of one triad, and one that is switched off."""
    gnomon.convert(calibration, program.partition(".")[0], tmp_path)
    path = tmp_path / program
    text, there = path.read_text(encoding="utf-8"), load_any(path).imus["imu0"]
    if program == "px4.params":
        bias, moved = "TC_G0_X0_1\t0.0", "TC_G0_X0_1\t0.25"
        path.write_text(text.replace(bias, moved), encoding="utf-8")
        assert np.allclose(load_any(path).imus["imu0"].gyroscope.bias - there.gyroscope.bias, [0, 0.25, 0])
        path.write_text(text.replace("TC_G0_TREF\t22.0", "TC_G0_TREF\t27.0"), encoding="utf-8")
        off = text.replace("TC_A_ENABLE\t1", "TC_A_ENABLE\t0").replace("TC_G_ENABLE\t1", "TC_G_ENABLE\t0")
    else:
        path.write_text(text.replace("INS_GYR1_CALTEMP,22.0", "INS_GYR1_CALTEMP,27.0"), encoding="utf-8")
        off = text.replace("INS_TCAL1_ENABLE,1", "INS_TCAL1_ENABLE,0")
    later = load_any(path).imus["imu0"]
    at = np.array([10.0, 30.0])
    taken = later.gyroscope.bias + later.temperature.change("gyroscope_bias", at)
    shift = 5.0 if program == "px4.params" else 0.0
    wanted = there.gyroscope.bias + there.temperature.change("gyroscope_bias", at - shift)
    if program == "ardupilot.param":  # zero at 27 degC instead of 22
        wanted = wanted - there.temperature.change("gyroscope_bias", np.array([27.0]))
    assert np.allclose(taken, wanted, rtol=0, atol=1e-12)
    path.write_text(off, encoding="utf-8")
    assert load_any(path).imus["imu0"].temperature is None


def test_autopilots_are_compared_at_a_temperature(calibration, tmp_path):
    gnomon.convert(calibration, "px4", tmp_path)
    gnomon.convert(calibration, "ardupilot", tmp_path)
    files = tmp_path / "px4.params", tmp_path / "ardupilot.param"
    found = [gnomon.compare(*files, temperature_c=degc).blocks for degc in (0.0, 40.0)]
    cold, warm = (next(one.values for one in blocks if one.path == "imu0.gyroscope.bias") for blocks in found)
    change = np.diff(FOUND.change("gyroscope_bias", np.array([0.0, 40.0])), axis=0)[0]
    assert np.allclose(warm - cold, change, rtol=1e-9)
    assert np.allclose(warm[0], warm[1], rtol=0, atol=1e-15)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize(("real", "rounding"), [("float", 2e-6), ("double", 1e-11)])
def test_the_c_header_takes_off_the_same(calibration, tmp_path, real, rounding):
    """In double it is the library's own to far less than 1e-6 of a sigma, which is no less than 1e-3 of a parameter."""
    gnomon.convert(calibration, "c-header", tmp_path)
    functions = "gnomon_imu0_at_reference(a, g, t); gnomon_imu0_at_reference_magnetometer(m, t);"
    run = f"void run({real} *a, {real} *g, {real} *m, {real} t) {{ {functions} }}\n"
    (tmp_path / "run.c").write_text(f'#include "gnomon_imu.h"\n{run}', encoding="utf-8")
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", *["-DGNOMON_DOUBLE"] * (real == "double")]
    subprocess.run(["cc", *options, "run.c", "-o", "run.so"], cwd=tmp_path, check=True)
    run, number = ctypes.CDLL(str(tmp_path / "run.so")).run, getattr(ctypes, f"c_{real}")
    imu = calibration.imus["imu0"]
    for degc in DEGC:
        accelerometer, gyroscope, magnetometer = ((number * 3)(0, 0, 0) for _ in range(3))
        run(accelerometer, gyroscope, magnetometer, number(degc))
        force, rate, field = (
            FOUND.to_reference(name, np.zeros((1, 3)), np.array([degc]), getattr(imu, name).bias)[0]
            for name in ("accelerometer", "gyroscope", "magnetometer")
        )
        rate = rate - FOUND.change("gyroscope_g_sensitivity", np.array([degc]))[0] @ (force - imu.accelerometer.bias)
        for values, wanted in ((accelerometer, force), (gyroscope, rate), (magnetometer, field)):
            assert np.allclose(np.array(values), wanted, rtol=rounding, atol=rounding / 20 * abs(wanted).max())


def test_counts_that_a_driver_divides_keep_their_temperature(calibration):
    """A count is a g over 2048 and a deg/s over 16.4: what the temperature changes is divided along."""
    imu, per_g, per_deg_s = calibration.imus["imu0"], 2048.0, 16.4
    counts = {"accelerometer": per_g / 9.80665, "gyroscope": per_deg_s * 180 / np.pi}
    triads = {}
    for name, factor in counts.items():
        triad = getattr(imu, name)
        more = {"g_sensitivity": factor * triad.g_sensitivity} if name == "gyroscope" else {}
        scaled = {"sensitivity": factor * triad.sensitivity, "bias": factor * triad.bias, "unit": "count"}
        triads[name] = replace(triad, **scaled, **more)
    found = replace(
        FOUND,
        accelerometer_bias=counts["accelerometer"] * FOUND.accelerometer_bias,
        gyroscope_bias=counts["gyroscope"] * FOUND.gyroscope_bias,
        gyroscope_g_sensitivity=counts["gyroscope"] / counts["accelerometer"] * FOUND.gyroscope_g_sensitivity,
    )
    raw = replace(calibration, imus={"imu0": replace(imu, temperature=found, **triads)})
    back = with_full_scale(raw, per_g, per_deg_s)
    there = back.imus["imu0"].temperature
    assert np.allclose(there.accelerometer_bias * 9.80665, FOUND.accelerometer_bias, rtol=1e-12)
    assert np.allclose(there.gyroscope_bias * np.pi / 180, FOUND.gyroscope_bias, rtol=1e-12)
    per = np.pi / 180 / 9.80665
    assert np.allclose(there.gyroscope_g_sensitivity * per, FOUND.gyroscope_g_sensitivity, rtol=1e-12)
    ratio = back.sigma("imu0.temperature.gyroscope_bias") / raw.sigma("imu0.temperature.gyroscope_bias")
    assert np.allclose(ratio, 1 / per_deg_s, rtol=1e-12)


def test_flight_controllers_say_that_they_know_biases_alone(calibration, tmp_path):
    for program in ("px4", "ardupilot"):
        losses = {loss.what for loss in gnomon.convert(calibration, program, tmp_path / program)}
        assert "sensitivity over the temperature of imu0" in losses
    losses = {loss.what for loss in gnomon.convert(calibration, "c-header", tmp_path / "c")}
    assert "sensitivity over the temperature of imu0" not in losses


def test_to_the_reference_and_back():
    rng = np.random.default_rng(0)
    values, bias = rng.normal(size=(len(DEGC), 3)), rng.normal(size=3)
    for name in ("accelerometer", "gyroscope", "magnetometer"):
        there = FOUND.from_reference(name, values, DEGC, bias)
        assert np.allclose(FOUND.to_reference(name, there, DEGC, bias), values, rtol=0, atol=1e-13)
        assert np.abs(there - values).max() > 1e-3


def test_programs_that_know_no_temperature_say_so(calibration, tmp_path):
    losses = {loss.what for loss in gnomon.convert(calibration, "imu_tk", tmp_path)}
    assert "temperature of imu0" in losses


def test_frames_leave_it_as_it_is(calibration):
    moved = calibration.in_frame("accel-z")
    assert np.array_equal(moved.imus["imu0"].temperature.gyroscope_bias, FOUND.gyroscope_bias)
    path = "imu0.temperature.gyroscope_bias"
    assert np.array_equal(moved.covariance(path), calibration.covariance(path))


def test_a_calibration_at_one_temperature_corrects_the_same(calibration):
    rng = np.random.default_rng(1)
    t_ns = np.arange(50) * 10**7
    recorded = ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=rng.normal(size=(50, 3)), unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=rng.normal(size=(50, 3)), unit="rad/s"),
        magnetometer=TriadSamples(t_ns=t_ns, values=30 * rng.normal(size=(50, 3)), unit="uT"),
        temperature=TemperatureSamples(t_ns=t_ns[[0, -1]], values=np.full(2, 40.0), unit="degC"),
    )
    there = calibration.at_temperature(40.0)
    wanted, found = (one.imus["imu0"].apply(recorded) for one in (calibration, there))
    for name in ("accelerometer", "gyroscope", "magnetometer"):
        assert np.allclose(getattr(found, name).values, getattr(wanted, name).values, rtol=0, atol=1e-12)
    with pytest.raises(gnomon.OptionError, match="not at 60"):
        calibration.at_temperature(60.0)


def test_the_covariance_at_one_temperature_is_that_of_drawn_calibrations(calibration):
    rng = np.random.default_rng(2)
    names, n = covariance_names(calibration.imus), 40
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix)) * 1e-3
    there = calibration.at_temperature(45.0)
    flat = np.concatenate([value.ravel() for _, value in calibration_parameters(there.imus)])
    jacobian = imus_at_temperature(calibration.imus, {}, 45.0).jacobian
    imu = calibration.imus["imu0"]
    for _ in range(n):
        drawn = sigma * rng.standard_normal(len(names))
        at, changed = 0, {}
        for path, value in calibration_parameters(calibration.imus):
            changed[path] = value + drawn[at : at + value.size].reshape(value.shape)
            at += value.size
        moved = replace(
            imu,
            accelerometer=replace(
                imu.accelerometer, sensitivity=changed["imu0.accelerometer.sensitivity"],
                bias=changed["imu0.accelerometer.bias"],
            ),
            gyroscope=replace(
                imu.gyroscope, sensitivity=changed["imu0.gyroscope.sensitivity"], bias=changed["imu0.gyroscope.bias"],
                g_sensitivity=changed["imu0.gyroscope.g_sensitivity"],
            ),
            magnetometer=replace(
                imu.magnetometer, sensitivity=changed["imu0.magnetometer.sensitivity"],
                bias=changed["imu0.magnetometer.bias"],
            ),
            temperature=replace(FOUND, **{p: changed[f"imu0.temperature.{p}"] for p, _ in FOUND.parts()}),
        )  # fmt: skip
        after = imus_at_temperature({"imu0": moved}, {}, 45.0).imus
        exact = np.concatenate([value.ravel() for _, value in calibration_parameters(after)]) - flat
        assert np.allclose(exact, jacobian @ drawn, rtol=0, atol=1e-3 * np.abs(exact).max())
