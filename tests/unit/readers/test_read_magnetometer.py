"""Magnetometers in recordings: columns, arrays, units, and files that hold nothing else."""

import numpy as np
import pytest

import gnomon
from gnomon.errors import RecordingError
from gnomon.readers.samples.npz import sensor_arrays
from gnomon.readers.samples.recognise import magnetometer_unit
from gnomon.simulate import FieldScenario, simulate_magnetometer
from gnomon.writers.recording_file import save_recording


def field(count=500, radius=45.0):
    u = np.random.default_rng(1).standard_normal((count, 3))
    return radius * u / np.linalg.norm(u, axis=1, keepdims=True) + [10.0, -5.0, 3.0]


def written(path, header, *columns, preamble=""):
    table = np.column_stack(columns)
    rows = "\n".join(",".join(repr(float(x)) for x in row) for row in table)
    path.write_text(f"{preamble}{header}\n{rows}\n")
    return path


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("t_s,mx [uT],my [uT],mz [uT]", "uT"),
        ("time (s),mag_x_gauss,mag_y_gauss,mag_z_gauss", "gauss"),
        ("time,magnetic_field.x [nT],magnetic_field.y [nT],magnetic_field.z [nT]", "nT"),
        ("t,MagX (µT),MagY (µT),MagZ (µT)", "uT"),
        ("t,magnetometer_x [count],magnetometer_y [count],magnetometer_z [count]", "count"),
    ],
)
def test_a_magnetometer_alone_is_read(tmp_path, header, unit) -> None:
    values = field()
    recording = gnomon.read(written(tmp_path / "mag.csv", header, np.arange(500) / 50, values))
    imu = recording.imus["imu0"]
    assert (len(imu.accelerometer), len(imu.gyroscope)) == (0, 0)
    assert imu.magnetometer.unit == unit
    np.testing.assert_array_equal(imu.magnetometer.values, values)
    assert "no accelerometer and no gyroscope in this recording." in recording.assumptions


def test_nine_columns_are_three_triads(tmp_path) -> None:
    rng = np.random.default_rng(2)
    a, g, m = rng.normal([0, 0, 9.8], 0.1, (500, 3)), rng.normal(0, 0.1, (500, 3)), field()
    header = "timestamp_us,ax,ay,az,gx,gy,gz,mx,my,mz"
    path = written(tmp_path / "imu.csv", header, np.arange(500) * 10_000, a, g, m)
    imu = gnomon.read(path).imus["imu0"]
    np.testing.assert_array_equal(imu.accelerometer.values, a)
    np.testing.assert_array_equal(imu.gyroscope.values, g)
    np.testing.assert_array_equal(imu.magnetometer.values, m)
    stated = gnomon.read(path, columns="t _ _ _ gx gy gz mx my mz").imus["imu0"]
    assert len(stated.accelerometer) == 0
    assert len(stated.gyroscope) == len(stated.magnetometer) == 500


def test_a_magnetometer_with_an_axis_missing_does_not_spoil_the_rest(tmp_path) -> None:
    a = np.random.default_rng(2).normal([0, 0, 9.8], 0.1, (500, 3))
    path = written(tmp_path / "imu.csv", "t,ax,ay,az,mag_x,mag_y", np.arange(500) / 100, a, field()[:, :2])
    imu = gnomon.read(path).imus["imu0"]
    assert imu.magnetometer is None
    assert len(imu.accelerometer) == 500
    path = written(tmp_path / "mag.csv", "t,mag_x,mag_y", np.arange(500) / 100, field()[:, :2])
    with pytest.raises(RecordingError, match="each axis of the magnetometer once"):
        gnomon.read(path)


def test_a_pair_of_files_may_be_magnetometer_and_accelerometer(tmp_path) -> None:
    a = np.random.default_rng(2).normal([0, 0, 9.8], 0.1, (1000, 3))
    first = written(tmp_path / "mag.csv", "t,mx,my,mz", np.arange(500) / 50, field())
    second = written(tmp_path / "acc.csv", "t,ax,ay,az", np.arange(1000) / 100, a)
    for order in ((first, second), (second, first)):
        imu = gnomon.read(*order).imus["imu0"]
        assert (len(imu.accelerometer), len(imu.gyroscope), len(imu.magnetometer)) == (1000, 0, 500)
    with pytest.raises(RecordingError, match="both hold a magnetometer"):
        gnomon.read(first, first)


@pytest.mark.parametrize("preamble", ["Fs,50.00\nInitialization time,60\n", "# rate: 50 Hz\n"])
def test_the_rate_stands_in_the_preamble(tmp_path, preamble) -> None:
    path = written(tmp_path / "mag.csv", "mx,my,mz", field(), preamble=preamble)
    recording = gnomon.read(path)
    assert recording.imus["imu0"].magnetometer.rate_hz == pytest.approx(50.0)
    assert any("50 Hz as its preamble says" in note for note in recording.assumptions)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
@pytest.mark.parametrize(
    "scenario", [FieldScenario(duration_s=5.0), FieldScenario(duration_s=5.0, accelerometer=False)]
)
def test_written_recordings_are_read_as_they_were(tmp_path, suffix, scenario) -> None:
    recording, _ = simulate_magnetometer(scenario, 1)
    paths = save_recording(recording, tmp_path / f"rec{suffix}")
    imu, other = recording.imus["imu0"], gnomon.read(*paths).imus["imu0"]
    np.testing.assert_array_equal(imu.magnetometer.t_ns, other.magnetometer.t_ns)
    np.testing.assert_array_equal(imu.magnetometer.values, other.magnetometer.values)
    np.testing.assert_array_equal(imu.accelerometer.values, other.accelerometer.values)
    assert other.magnetometer.unit == "uT"


def test_arrays_named_after_a_sensor_are_understood(tmp_path) -> None:
    np.savez(
        tmp_path / "a.npz", acc_mg=1000 * field()[:, :], t_acc_mg=np.arange(500) / 100, mag_uT=field(), t=np.arange(500)
    )
    imu = gnomon.read(tmp_path / "a.npz").imus["imu0"]
    assert (imu.accelerometer.unit, imu.magnetometer.unit) == ("mg", "uT")
    np.savez(tmp_path / "b.npz", mag=field())
    with pytest.raises(RecordingError, match="no timestamps for mag"):
        gnomon.read(tmp_path / "b.npz")
    assert gnomon.read(tmp_path / "b.npz", rate_hz=20.0).imus["imu0"].magnetometer.rate_hz == 20.0
    assert "accelerometer" not in sensor_arrays(["acc_g", "accel"])  # one of them, but which


@pytest.mark.parametrize(
    ("radius", "unit"), [(45.0, "uT"), (0.5, "gauss"), (450.0, "mgauss"), (48e3, "nT"), (5e-5, "T")]
)
def test_the_unit_shows_in_the_field(radius, unit) -> None:
    values = field(radius=radius) - [10.0, -5.0, 3.0]
    assert magnetometer_unit(values + 1.5 * radius).unit == unit
    assert magnetometer_unit(np.rint(field())).unit == "count"
    assert magnetometer_unit(1e6 * field()).unit == "count"


@pytest.mark.parametrize("offset", [0.0, 30.0, 230.0, 2000.0])
@pytest.mark.parametrize(("unit", "factor"), [("uT", 1.0), ("gauss", 0.01), ("mgauss", 10.0), ("nT", 1000.0)])
def test_the_unit_follows_from_the_radius_whatever_hard_iron_is(offset, unit, factor) -> None:
    values = (field(2000, 48.0) * [1.0, 0.9, 1.1] + offset * np.array([0.6, -0.7, 0.4])) * factor + 1e-3
    assert magnetometer_unit(values).unit == unit
