"""Whatever dialect a table is written in, the numbers come back."""

import gzip
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gnomon
from gnomon.recording import ImuSamples, Recording, TriadSamples
from gnomon.writers.recording_file import save_recording

HEADERS = (
    ("t_ns", "ax ay az", "gx gy gz"),
    ("timestamp [ns]", "a_RS_S_x a_RS_S_y a_RS_S_z", "w_RS_S_x w_RS_S_y w_RS_S_z"),
    ("time_ns", "accX accY accZ", "gyrX gyrY gyrZ"),
    ("stamp[ns]", "linear_acceleration.x linear_acceleration.y linear_acceleration.z",
     "angular_velocity.x angular_velocity.y angular_velocity.z"),
)  # fmt: skip

numbers = st.floats(-1e6, 1e6, allow_nan=False).map(lambda x: x if abs(x) > 1e-200 else 0.0)


@st.composite
def tables(draw):
    rows = draw(st.integers(2, 12))
    values = draw(st.lists(numbers, min_size=6 * rows, max_size=6 * rows))
    first = draw(st.integers(0, 2**60))
    steps = draw(st.lists(st.integers(0, 10**9), min_size=rows - 1, max_size=rows - 1))
    return np.cumsum([first, *steps], dtype=np.int64), np.array(values).reshape(rows, 6)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    table=tables(),
    header=st.sampled_from(HEADERS),
    delimiter=st.sampled_from([",", ";", "\t", " ", "  ", ", "]),
    comma=st.booleans(),
    mark=st.sampled_from(["", "#", "# ", "%"]),
    preamble=st.sampled_from(["", "Serial,12\n", "# made by a logger\n#\n"]),
    end=st.sampled_from(["\n", "\r\n"]),
    packed=st.booleans(),
    swap=st.booleans(),
)
def test_written_is_read(tmp_path, table, header, delimiter, comma, mark, preamble, end, packed, swap) -> None:
    stamps, values = table
    comma = comma and "," not in delimiter
    time, accel, gyro = header
    names = [time, *(gyro + " " + accel if swap else accel + " " + gyro).split()]
    columns = np.hstack([values[:, 3:], values[:, :3]]) if swap else values
    if delimiter.strip() == "" and delimiter != "\t":
        names = [name.replace(" [", "[") for name in names]
    lines = [mark + delimiter.join(names)]
    for stamp, row in zip(stamps.tolist(), columns.tolist(), strict=True):
        texts = [repr(x) for x in row]
        lines.append(delimiter.join([str(stamp), *(t.replace(".", ",") if comma else t for t in texts)]))
    data = (preamble.replace("\n", end) + end.join(lines) + end).encode()
    path = tmp_path / "table.txt"
    path.write_bytes(gzip.compress(data) if packed else data)
    imu = gnomon.read(path, units="si").imus["imu0"]
    np.testing.assert_array_equal(imu.accelerometer.t_ns, stamps)
    np.testing.assert_array_equal(imu.accelerometer.values, values[:, :3])
    np.testing.assert_array_equal(imu.gyroscope.values, values[:, 3:])


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    accel=tables(), gyro=tables(), shared=st.booleans(), alone=st.booleans(),
    units=st.sampled_from([("m/s^2", "rad/s"), ("g", "deg/s"), ("mg", "mdeg/s"), ("count", "count")]),
    suffix=st.sampled_from([".npz", ".csv", ".csv.gz"]),
)  # fmt: skip
def test_saved_is_read(tmp_path, accel, gyro, shared, alone, units, suffix) -> None:
    if shared:
        gyro = (accel[0], accel[1])
    accelerometer = TriadSamples(t_ns=accel[0], values=accel[1][:, :3], unit=units[0])
    gyroscope = TriadSamples(t_ns=gyro[0], values=gyro[1][:, 3:], unit=units[1])
    if alone:
        gyroscope = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s")
    recording = Recording(imus={"imu0": ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope)})
    paths = save_recording(recording, tmp_path / f"rec{suffix}")
    back = gnomon.read(*paths).imus["imu0"]
    for found, expected in ((back.accelerometer, accelerometer), (back.gyroscope, gyroscope)):
        np.testing.assert_array_equal(found.t_ns, expected.t_ns)
        np.testing.assert_array_equal(found.values, expected.values)
        assert found.unit == expected.unit


def test_saving_twice_gives_the_same_bytes(tmp_path) -> None:
    samples = TriadSamples(t_ns=np.arange(50) * 10**7, values=np.random.default_rng(0).normal(size=(50, 3)), unit="g")
    imu = ImuSamples(accelerometer=samples, gyroscope=replace(samples, unit="deg/s"))
    recording = Recording(imus={"imu0": imu})
    for name in ("rec.csv", "rec.csv.gz", "rec.npz"):
        (first,) = save_recording(recording, tmp_path / name)
        whole = first.read_bytes()
        (second,) = save_recording(recording, tmp_path / name)
        assert second.read_bytes() == whole
        assert [path.name for path in tmp_path.iterdir()].count(name) == 1


def test_saving_names_its_limits(tmp_path) -> None:
    samples = TriadSamples(t_ns=np.arange(5), values=np.zeros((5, 3)), unit="g")
    imu = ImuSamples(accelerometer=samples, gyroscope=replace(samples, unit="deg/s"))
    with pytest.raises(gnomon.OptionError, match="Choose one of these suffixes"):
        save_recording(Recording(imus={"imu0": imu}), tmp_path / "rec.xlsx")
    with pytest.raises(gnomon.OptionError, match="CSV holds one IMU"):
        save_recording(Recording(imus={"imu0": imu, "imu1": imu}), tmp_path / "rec.csv")
    assert not list(tmp_path.iterdir())


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    start=st.sampled_from([
        b"t,ax,ay,az,gx,gy,gz\n" + b"0.01,1,2,9.5,4,5,6\n0.02,1,2.5,9.5,4,5,6\n0.03,1,2,9,4,5,6\n" * 3,
        b"Fs,50\n" + b"1 2.5 9.5 0.1 0.2 0.3\n" * 12,
        b"",
    ]),
    edits=st.lists(
        st.tuples(st.integers(0, 300), st.integers(0, 4), st.binary(max_size=6) | st.sampled_from(
            [b"nan", b"inf", b"\n", b",", b";", b"\t", b'"', b"#", b"1e400", b"-", b"x", b"1e18", b"\r", b"\xff\xfe"])),
        max_size=6,
    ),
    packed=st.booleans(),
)  # fmt: skip
def test_any_bytes_are_read_or_refused_in_words(tmp_path, start, edits, packed) -> None:
    data = bytearray(start)
    for place, length, insert in edits:
        data[place : place + length] = insert
    path = tmp_path / "table.txt"
    path.write_bytes(gzip.compress(bytes(data)) if packed else bytes(data))
    try:
        imu = gnomon.read(path, rate_hz=100).imus["imu0"]
    except gnomon.GnomonError as error:
        assert "table.txt" in str(error)  # noqa: PT017
    else:
        assert len(imu.accelerometer) >= 2
        assert np.isfinite(imu.accelerometer.values).all()
        gnomon.check(Recording(imus={"imu0": imu}))
