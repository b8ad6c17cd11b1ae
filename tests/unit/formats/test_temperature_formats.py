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
from gnomon.recording import ImuSamples, TemperatureSamples, TriadSamples
from gnomon.results.at_temperature import imus_at_temperature
from gnomon.results.calibration import Covariance, calibration_parameters, covariance_names
from gnomon.results.sensors import TemperatureDependence
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
)
DEGC = np.array([-20.0, -5.0, 0.0, 22.0, 40.0, 51.5, 80.0])


@pytest.fixture(scope="module")
def calibration():
    known = simulate(Scenario(intervals=12, t_init_s=6.0), 3)[1]
    imus = {"imu0": replace(known.imus["imu0"], temperature=FOUND)}
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


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_header_takes_off_the_same(calibration, tmp_path):
    gnomon.convert(calibration, "c-header", tmp_path)
    source = '#include "gnomon_imu.h"\nvoid run(float *a, float *g, float t) { gnomon_imu0_at_reference(a, g, t); }\n'
    (tmp_path / "run.c").write_text(source, encoding="utf-8")
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "run.c", "-o", "run.so"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    run = ctypes.CDLL(str(tmp_path / "run.so")).run
    for degc in DEGC:
        accelerometer, gyroscope = (ctypes.c_float * 3)(0, 0, 0), (ctypes.c_float * 3)(0, 0, 0)
        run(accelerometer, gyroscope, ctypes.c_float(degc))
        imu = calibration.imus["imu0"]
        for values, name in ((accelerometer, "accelerometer"), (gyroscope, "gyroscope")):
            wanted = FOUND.to_reference(name, np.zeros((1, 3)), np.array([degc]), getattr(imu, name).bias)
            assert np.allclose(np.array(values), wanted[0], rtol=2e-6, atol=1e-7 * abs(wanted).max())


def test_flight_controllers_say_that_they_know_biases_alone(calibration, tmp_path):
    for program in ("px4", "ardupilot"):
        losses = {loss.what for loss in gnomon.convert(calibration, program, tmp_path / program)}
        assert "sensitivity over the temperature of imu0" in losses
    losses = {loss.what for loss in gnomon.convert(calibration, "c-header", tmp_path / "c")}
    assert "sensitivity over the temperature of imu0" not in losses


def test_to_the_reference_and_back():
    rng = np.random.default_rng(0)
    values, bias = rng.normal(size=(len(DEGC), 3)), rng.normal(size=3)
    for name in ("accelerometer", "gyroscope"):
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
        temperature=TemperatureSamples(t_ns=t_ns[[0, -1]], values=np.full(2, 40.0), unit="degC"),
    )
    there = calibration.at_temperature(40.0)
    wanted, found = (one.imus["imu0"].apply(recorded) for one in (calibration, there))
    for name in ("accelerometer", "gyroscope"):
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
            temperature=replace(FOUND, **{p: changed[f"imu0.temperature.{p}"] for p, _ in FOUND.parts()}),
        )  # fmt: skip
        after = imus_at_temperature({"imu0": moved}, {}, 45.0).imus
        exact = np.concatenate([value.ravel() for _, value in calibration_parameters(after)]) - flat
        assert np.allclose(exact, jacobian @ drawn, rtol=0, atol=1e-3 * np.abs(exact).max())
