"""Other projects' files: what they can hold comes back exactly, what they cannot hold is said."""

import ctypes
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.errors import FormatError, OptionError, OutputError
from gnomon.formats.conversion import FORMATS, export_texts
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.imu_tk import read_imu_tk
from gnomon.formats.imucal import read_imucal
from gnomon.formats.own.other_forms import read_parameter_csv
from gnomon.recording import Recording
from gnomon.results.calibration import ImuCalibration
from kalibr_imus import read_kalibr


def said(losses):
    return " | ".join(str(loss) for loss in losses)


def agrees(found: ImuCalibration, expected: ImuCalibration, *, g_sensitivity=True, bias=True):
    for triad in ("accelerometer", "gyroscope"):
        one, other = getattr(found, triad), getattr(expected, triad)
        assert one.unit == other.unit
        assert np.abs(one.sensitivity - other.sensitivity).max() <= 1e-12 * np.abs(other.sensitivity).max()
        if bias:
            assert np.array_equal(one.bias, other.bias)
    kept = expected.gyroscope.g_sensitivity * g_sensitivity
    assert np.allclose(found.gyroscope.g_sensitivity, kept, rtol=0, atol=1e-12 * np.abs(kept).max())


@pytest.mark.parametrize("frame", ["accel-x", "accel-z", "user"])
def test_imu_tk(random_calibration, tmp_path, frame):
    calibration = random_calibration(3, frame=frame)
    losses = gnomon.convert(calibration, "imu_tk", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["imu0_acc.calib", "imu0_gyro.calib"]
    read = read_imu_tk(tmp_path / "imu0_acc.calib", tmp_path / "imu0_gyro.calib")
    assert read.frame == "accel-z"
    agrees(read.imus["imu0"], calibration.in_frame("accel-z").imus["imu0"], g_sensitivity=False)
    assert "g-sensitivity of imu0 (up to" in said(losses)
    assert ("body frame of imu0 (turned by" in said(losses)) == (frame != "accel-z")
    assert "R_new_old" in said(losses) or frame == "accel-z"
    numbers, *comments = (tmp_path / "imu0_acc.calib").read_text().split("#")
    numbers = numbers.split()
    assert len(numbers) == 21
    assert "value [m/s^2] = T K (sample [count] - B)" in comments[0]
    gyroscope = load_foreign(tmp_path / "imu0_gyro.calib").imus["imu0"]  # told by the comment, not by the order
    assert gyroscope.accelerometer is None
    assert gyroscope.gyroscope.unit == "count"
    both = load_foreign(tmp_path / "imu0_gyro.calib", tmp_path / "imu0_acc.calib").imus["imu0"]
    agrees(both, read.imus["imu0"])
    assert [float(x) for x in numbers[:9:4]] == [1, 1, 1]
    assert [numbers[i] for i in (3, 6, 7)] == ["0.0"] * 3


def test_imu_tk_size_of_the_g_sensitivity(random_calibration):
    """The stated rate is what the lost term feigns in the worst attitude, found here by trying attitudes."""
    calibration = random_calibration(1)
    gyroscope = calibration.imus["imu0"].gyroscope
    up = np.random.default_rng(0).normal(size=(200_000, 3))
    up *= 9.80665 / np.linalg.norm(up, axis=1)[:, None]
    feigned = up @ (np.linalg.inv(gyroscope.sensitivity) @ gyroscope.g_sensitivity).T
    worst = np.linalg.norm(feigned, axis=1).max()
    assert f"up to {worst:.2g} rad/s" in said(export_texts(calibration, "imu_tk").losses)


@pytest.mark.parametrize("units", [("m/s^2", "rad/s"), ("g", "deg/s"), ("mg", "mdeg/s")])
def test_kalibr_in_physical_units(random_calibration, tmp_path, units):
    calibration = random_calibration(2, units=units)
    losses = gnomon.convert(calibration, "kalibr", tmp_path)
    read = read_kalibr(tmp_path / "imu.yaml")
    imu, original = read.imus["imu0"], calibration.imus["imu0"]
    factors = {
        "m/s^2": 1.0,
        "g": 9.80665,
        "mg": 9.80665e-3,
        "rad/s": 1.0,
        "deg/s": np.pi / 180,
        "mdeg/s": np.pi / 180e3,
    }
    for triad, unit in zip(("accelerometer", "gyroscope"), units, strict=True):
        expected = getattr(original, triad).sensitivity * factors[unit]
        assert np.allclose(getattr(imu, triad).sensitivity, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.allclose(imu.gyroscope.g_sensitivity, original.gyroscope.g_sensitivity * factors[units[1]], rtol=1e-11)
    assert "accelerometer bias of imu0" in said(losses)
    assert "accelerometer_noise_density" in said(losses)
    assert read.frame == "accel-x"


def test_kalibr_file_has_kalibrs_keys(random_calibration, tmp_path):
    gnomon.convert(random_calibration(2, units=("m/s^2", "rad/s"), frame="accel-z"), "kalibr", tmp_path)
    imu = yaml.safe_load((tmp_path / "imu.yaml").read_text())["imu0"]
    assert set(imu) == {"model", "T_i_b", "time_offset", "accelerometers", "gyroscopes"}
    assert imu["model"] == "scale-misalignment"
    assert imu["T_i_b"] == np.eye(4).tolist()
    assert set(imu["gyroscopes"]) == {"M", "A", "C_gyro_i"}
    assert np.array_equal(np.triu(imu["accelerometers"]["M"], 1), np.zeros((3, 3)))
    assert np.linalg.det(imu["gyroscopes"]["C_gyro_i"]) == pytest.approx(1)


def test_kalibr_with_counts(random_calibration, tmp_path):
    """Samples converted as the file's comments say, then Kalibr's model: the same truth as from counts."""
    calibration = random_calibration(4)
    losses = gnomon.convert(calibration, "kalibr", tmp_path)
    text = (tmp_path / "imu.yaml").read_text()
    rng = np.random.default_rng(0)
    rate, force = rng.normal(size=(2, 6, 3))
    imu = calibration.imus["imu0"]
    counts = {
        "accelerometer": force @ imu.accelerometer.sensitivity.T + imu.accelerometer.bias,
        "gyroscope": rate @ imu.gyroscope.sensitivity.T + imu.gyroscope.bias + force @ imu.gyroscope.g_sensitivity.T,
    }
    read = read_kalibr(tmp_path / "imu.yaml").imus["imu0"]
    converted = {}
    for triad, values in counts.items():
        line = next(line for line in text.splitlines() if line.startswith(f"# imu0: {triad} [") and "count" in line)
        *offset, factor = (float(x) for x in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", line.split("count")[1]))
        converted[triad] = (values - np.array(offset)) * factor
        assert line.split("imu0: ")[1] in said(losses)
    found = read.accelerometer.specific_force(converted["accelerometer"])
    assert np.allclose(found, force, atol=1e-11)
    assert np.allclose(read.gyroscope.angular_rate(converted["gyroscope"], found), rate, atol=1e-11)


def test_imucal(random_calibration, tmp_path):
    calibration = random_calibration(5, units=("g", "count"), frame="user")
    gnomon.convert(calibration, "imucal", tmp_path)
    agrees(read_imucal(tmp_path / "imu0.json").imus["imu0"], calibration.imus["imu0"])
    raw = json.loads((tmp_path / "imu0.json").read_text())
    assert (raw["cal_type"], raw["_format_version"], raw["gyr_unit"]) == ("Ferraris", "2.0.0", "deg/s")
    assert (raw["from_acc_unit"], raw["from_gyr_unit"]) == ("g", "a.u.")
    # imucal's own arithmetic on one sample, in deg/s
    imu = calibration.imus["imu0"]
    force, rate = np.array([1.0, -2, 9]), np.array([0.3, 0.1, -2])
    y = imu.gyroscope.sensitivity @ rate + imu.gyroscope.bias + imu.gyroscope.g_sensitivity @ force
    p = {key: np.array(value) for key, value in raw.items() if isinstance(value, list)}
    degrees = np.linalg.inv(p["R_g"]) @ np.linalg.inv(p["K_g"]) @ (y - p["K_ga"] @ force - p["b_g"])
    assert np.allclose(np.radians(degrees), rate, atol=1e-12)


def test_csv(random_calibration, tmp_path):
    calibration = random_calibration(6, units=("mg", "deg/s"))
    losses = gnomon.convert(calibration, "csv", tmp_path)
    read = read_parameter_csv(tmp_path / "calibration.csv")
    agrees(read.imus["imu0"], calibration.imus["imu0"])
    for path in ("imu0.accelerometer.sensitivity", "imu0.gyroscope.g_sensitivity"):
        assert np.array_equal(read.sigmas[path], calibration.sigma(path))
    assert read.frame == "accel-x"
    assert "mg/(m/s^2)" in (tmp_path / "calibration.csv").read_text()
    assert "correlations" in said(losses)


@pytest.mark.parametrize("gyroscope", [True, False])
@pytest.mark.parametrize("standard", ["c99", "c++"])
def test_c_header_compiles_and_agrees(random_calibration, tmp_path, gyroscope, standard):
    compiler = shutil.which("cc" if standard == "c99" else "c++")
    if compiler is None:
        pytest.skip("needs a C compiler")
    calibration = random_calibration(7, gyroscope=gyroscope)
    gnomon.convert(calibration, "c-header", tmp_path)
    call = "gnomon_imu0_apply(a, g, f, w)" if gyroscope else "gnomon_imu0_apply(a, f)"
    prefix = 'extern "C" ' if standard == "c++" else ""
    source = tmp_path / ("t.c" if standard == "c99" else "t.cpp")
    signature = f"{prefix}void go(const float *a, const float *g, float *f, float *w)"
    includes = '#include "gnomon_imu.h"\n' * 2
    source.write_text(f"{includes}{signature};\n{signature} {{ (void)g; (void)w; {call}; }}\n")
    language = ["-std=c99", "-pedantic-errors"] if standard == "c99" else []
    flags = ["-O2", "-Wall", "-Wextra", "-Werror", *language, "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", tmp_path / "t.so", source], check=True)
    library = ctypes.CDLL(tmp_path / "t.so")
    imu = calibration.imus["imu0"]
    rng = np.random.default_rng(1)
    force, rate = rng.normal(0, 10, (300, 3)), rng.normal(0, 3, (300, 3))
    accel = np.rint(force @ imu.accelerometer.sensitivity.T + imu.accelerometer.bias)
    gyro = np.zeros((300, 3))
    if gyroscope:
        gyro = np.rint(rate @ imu.gyroscope.sensitivity.T + imu.gyroscope.bias + force @ imu.gyroscope.g_sensitivity.T)
    unit = "count"
    recording = Recording.from_arrays(np.arange(300) * 0.01, gyro, accel, units="raw")
    assert recording.imus["imu0"].accelerometer.unit == unit
    exact = imu.apply(recording.imus["imu0"])
    pointer = ctypes.POINTER(ctypes.c_float)
    for i in range(300):
        a, g = (np.ascontiguousarray(x[i], np.float32) for x in (accel, gyro))
        f, w = np.zeros(3, np.float32), np.zeros(3, np.float32)
        library.go(*(x.ctypes.data_as(pointer) for x in (a, g, f, w)))
        assert np.abs(f - exact.accelerometer.values[i]).max() <= 4e-7 * np.abs(exact.accelerometer.values[i]).max()
        if gyroscope:
            assert np.abs(w - exact.gyroscope.values[i]).max() <= 2e-6 * np.abs(exact.gyroscope.values[i]).max()


OF_CAMERAS = ("vins-fusion", "orb-slam3", "okvis", "ros2")


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_states_losses_and_gives_the_same_bytes(random_calibration, camera_calibration, tmp_path, to):
    si = {"units": ("m/s^2", "rad/s")} if to in {"px4", "ardupilot"} else {}  # which refuse counts
    calibration = camera_calibration(8, cameras=1) if to in OF_CAMERAS else random_calibration(8, **si)
    losses = gnomon.convert(calibration, to, tmp_path / "new" / "folder")
    assert all(isinstance(loss, gnomon.Loss) and loss.what and loss.why for loss in losses)
    assert any("calibration.yaml" in loss.why for loss in losses)
    before = {path.name: path.read_bytes() for path in (tmp_path / "new" / "folder").iterdir()}
    gnomon.convert(calibration, to, tmp_path / "new" / "folder")
    assert before == {path.name: path.read_bytes() for path in (tmp_path / "new" / "folder").iterdir()}
    assert set(before) == set(export_texts(calibration, to).files)


@pytest.mark.parametrize("to", [name for name in FORMATS if name not in OF_CAMERAS])
def test_accelerometer_alone(random_calibration, tmp_path, to):
    calibration = random_calibration(9, gyroscope=False, units=("m/s^2", "rad/s"))
    if to == "imucal":
        with pytest.raises(OptionError, match=r"imucal needs accelerometer and gyroscope, and .* no gyroscope of imu0"):
            gnomon.convert(calibration, to, tmp_path)
        assert not list(tmp_path.iterdir())
        return
    gnomon.convert(calibration, to, tmp_path)
    reader = {
        "imu_tk": lambda: read_imu_tk(tmp_path / "imu0_acc.calib", accelerometer_unit="m/s^2"),
        "kalibr": lambda: read_kalibr(tmp_path / "imu.yaml"),
        "csv": lambda: read_parameter_csv(tmp_path / "calibration.csv"),
    }.get(to)
    if reader is not None:
        read = reader().imus["imu0"]
        assert read.gyroscope is None
        frame = "accel-z" if to == "imu_tk" else "accel-x"
        expected = calibration.in_frame(frame).imus["imu0"].accelerometer.sensitivity
        assert np.allclose(read.accelerometer.sensitivity, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_unknown_format_and_unwritable_folder(random_calibration, tmp_path):
    with pytest.raises(OptionError, match="Choose one of: imu_tk"):
        gnomon.convert(random_calibration(), "matlab", tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        gnomon.convert(random_calibration(), "csv", tmp_path / "file" / "x")


@pytest.mark.parametrize(
    ("reader", "content", "expected"),
    [
        (read_imu_tk, "1 2 3", "found 3 numbers, expected 21"),
        (read_imu_tk, "1 2 x", "Expected 21 numbers"),
        (read_imu_tk, " ".join(["1"] * 21), "must be diagonal"),
        (read_kalibr, "cam0: {}", "the key imu0 is missing"),
        (read_kalibr, "imu0: {model: scale-misalignment}", "accelerometers is missing"),
        (read_kalibr, "imu0: {model: other}", r"imu0\.model"),
        (read_imucal, '{"cal_type": "Ferraris"}', "the key K_a is missing"),
        (read_imucal, "{", "line 1: this is not JSON"),
        (read_parameter_csv, "a,b\n", "line 1: expected name,value,sigma,unit"),
        (read_parameter_csv, "name,value,sigma,unit\nimu0.x,1,2,m\n", "imu0 has no row of an accelerometer"),
        (
            read_parameter_csv,
            'name,value,sigma,unit\n"imu0.accelerometer.bias[0]",1,2,m\n',
            "the row imu0.accelerometer.sensitivity",
        ),
    ],
)
def test_bad_files_are_named(tmp_path, reader, content, expected):
    path = tmp_path / "bad"
    path.write_text(content)
    with pytest.raises(FormatError, match=expected) as caught:
        reader(path)
    assert str(path) in str(caught.value)


def test_reads_kalibr_with_opencvs_first_line(random_calibration, tmp_path):
    gnomon.convert(random_calibration(units=("m/s^2", "rad/s")), "kalibr", tmp_path)
    path = tmp_path / "imu.yaml"
    path.write_text("%YAML:1.0\n" + path.read_text())
    assert read_kalibr(path).frame == "accel-x"
