"""Reading recordings: what every format gives, and how every bad input is refused."""

import gzip
import hashlib
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError, RecordingError
from gnomon.readers.files import recording_files
from gnomon.readers.samples.npz import _values
from gnomon.readers.samples.table import guess_time_unit, preamble_rate, stamp_kind, to_ns
from gnomon.units import Units


def hand_held(rate_hz: float = 100.0, rests: int = 8, seed: int = 1):
    """Return timestamps [s], specific force [m/s^2] and angular rate [rad/s] of rests with turns between them."""
    rng = np.random.default_rng(seed)
    dt, still, turn = 1 / rate_hz, round(2 * rate_hz), round(1 * rate_hz)
    up, force, rate = np.array([0.0, 0.0, 1.0]), [], []
    for _ in range(rests):
        force += [9.81 * up] * still
        rate += [np.zeros(3)] * still
        axis = rng.normal(size=3)
        omega = axis / np.linalg.norm(axis) * 1.5
        for _ in range(turn):
            up = up - np.cross(omega, up) * dt
            up = up / np.linalg.norm(up)
            force.append(9.81 * up)
            rate.append(omega)
    n = len(force)
    accel = np.array(force) + rng.normal(0, 0.02, (n, 3))
    gyro = np.array(rate) + rng.normal(0, 0.004, (n, 3)) + [0.02, -0.01, 0.015]
    return np.arange(n) * dt, accel, gyro


def write_rows(path: Path, rows, header: str = "", delimiter: str = ",") -> Path:
    lines = [delimiter.join(f"{x:.9g}" for x in row) for row in rows]
    path.write_text((header + "\n" if header else "") + "\n".join(lines) + "\n")
    return path


def imu_of(recording):
    return recording.imus["imu0"]


def said(recording) -> str:
    return " ".join(recording.assumptions)


# ---- real recordings ----


def test_xsens_pair(real_data) -> None:
    folder = real_data("xsens_mti")
    recording = gnomon.read(folder / "xsens_acc.mat.gz", folder / "xsens_gyro.mat.gz")
    imu = imu_of(recording)
    assert len(imu.accelerometer) == len(imu.gyroscope) == 51175
    assert imu.accelerometer.unit == imu.gyroscope.unit == "count"
    assert imu.accelerometer.t_ns[0] == 29_840_000
    assert imu.accelerometer.values[0].tolist() == [33108, 33329, 36429]
    assert imu.gyroscope.values[0].tolist() == [32786, 32429, 32499]
    packed = (folder / "xsens_acc.mat.gz").read_bytes()
    assert recording.sources[0].sha256 == hashlib.sha256(packed).hexdigest()


def test_pair_is_told_apart_whatever_its_order_and_names(real_data, tmp_path) -> None:
    folder = real_data("xsens_mti")
    expected = imu_of(gnomon.read(folder))
    for name, source in (("one.txt", "xsens_gyro.mat.gz"), ("two.txt", "xsens_acc.mat.gz")):
        (tmp_path / name).write_bytes(gzip.decompress((folder / source).read_bytes()))
    found = imu_of(gnomon.read(tmp_path / "one.txt", tmp_path / "two.txt"))
    np.testing.assert_array_equal(found.accelerometer.values, expected.accelerometer.values)
    np.testing.assert_array_equal(found.gyroscope.values, expected.gyroscope.values)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_mikov_without_header_and_time(real_data, number) -> None:
    path = real_data(f"mikov-mpu9150-multipos/imu{number}.log")
    recording = gnomon.read(path, rate_hz=100)
    imu, table = imu_of(recording), np.loadtxt(path)
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    np.testing.assert_array_equal(imu.accelerometer.values, table[:, :3])
    np.testing.assert_array_equal(imu.gyroscope.values, table[:, 3:])
    assert "first three columns are the accelerometer" in said(recording)
    assert imu.accelerometer.t_ns[1] == 10_000_000


def test_mikov_needs_a_rate(real_data) -> None:
    with pytest.raises(RecordingError, match="--rate 100"):
        gnomon.read(real_data("mikov-mpu9150-multipos/imu0.log"))


def test_euroc(real_data) -> None:
    imu = imu_of(gnomon.read(real_data("euroc-imu-april/imu0.csv.gz")))
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    assert imu.gyroscope.t_ns[0] == 1404733405747800064  # exactly: float64 would lose it
    assert imu.gyroscope.values[0].tolist() == [0.014661, -0.028623, 0.125664]
    assert imu.accelerometer.values[0].tolist() == [9.365351, -0.335061, -3.277056]


@pytest.mark.parametrize("folder", ["a-aprilgrid-full", "b-aprilgrid-ideal-imu", "d-checkerboard-ideal-imu"])
def test_rendered(real_data, folder) -> None:
    imu = imu_of(gnomon.read(real_data(f"rendered-camimu/{folder}/imu0.csv.gz")))
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    assert imu.accelerometer.rate_hz == 200


# ---- dialects ----


def test_kalibr_header_and_folder(tmp_path) -> None:
    t, accel, gyro = hand_held()
    folder = tmp_path / "dataset"
    folder.mkdir()
    stamps = np.rint(t * 1e9).astype(np.int64) + 1_700_000_000_123_456_789
    lines = ["timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z"]
    lines += [",".join(map(str, [s, *g, *a])) for s, g, a in zip(stamps, gyro, accel, strict=True)]
    (folder / "imu0.csv").write_text("\n".join(lines))
    recording = gnomon.read(folder)
    np.testing.assert_array_equal(imu_of(recording).accelerometer.t_ns, stamps)
    np.testing.assert_array_equal(imu_of(recording).accelerometer.values, accel)
    np.testing.assert_array_equal(imu_of(recording).gyroscope.values, gyro)
    assert imu_of(recording).gyroscope.unit == "rad/s"


def test_euroc_folder(tmp_path) -> None:
    t, accel, gyro = hand_held()
    folder = tmp_path / "mav0" / "imu0"
    folder.mkdir(parents=True)
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]," + ",".join(
        f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"
    )
    write_rows(folder / "data.csv", np.column_stack([np.rint(t * 1e9), gyro, accel]), header)
    imu = imu_of(gnomon.read(tmp_path))
    np.testing.assert_allclose(imu.accelerometer.values, accel, rtol=1e-8)


@pytest.mark.parametrize("order", ["first", "last"])
@pytest.mark.parametrize("rate_unit", ["rad/s", "deg/s"])
@pytest.mark.parametrize("accel_unit", ["m/s^2", "g", "mg"])
def test_order_and_units_are_recognised_without_header(tmp_path, order, rate_unit, accel_unit) -> None:
    t, accel, gyro = hand_held()
    accel = accel / {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3}[accel_unit]
    gyro = np.degrees(gyro) if rate_unit == "deg/s" else gyro
    triads = [accel, gyro] if order == "first" else [gyro, accel]
    recording = gnomon.read(write_rows(tmp_path / "log", np.column_stack([t, *triads]), delimiter=" "))
    imu = imu_of(recording)
    np.testing.assert_allclose(imu.accelerometer.values, accel, rtol=1e-8)
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == (accel_unit, rate_unit)
    assert f"the {order} three columns are the accelerometer" in said(recording)


def test_raw_counts_are_recognised(tmp_path) -> None:
    t, accel, gyro = hand_held()
    counts = np.rint(np.column_stack([gyro * 4770 + 32768, accel * 415 + 33000]))
    imu = imu_of(gnomon.read(write_rows(tmp_path / "log.txt", np.column_stack([t, counts]))))
    assert imu.accelerometer.unit == imu.gyroscope.unit == "count"
    np.testing.assert_array_equal(imu.accelerometer.values, counts[:, 3:])


def test_rest_alone_tells_the_order_by_gravity(tmp_path) -> None:
    rng = np.random.default_rng(3)
    gyro, accel = rng.normal(0.01, 0.004, (500, 3)), rng.normal([0, 0, 9.8], 0.02, (500, 3))
    recording = gnomon.read(write_rows(tmp_path / "log", np.hstack([gyro, accel])), rate_hz=50)
    np.testing.assert_allclose(imu_of(recording).accelerometer.values, accel, rtol=1e-8)


def test_undecidable_order_asks_for_columns(tmp_path) -> None:
    rng = np.random.default_rng(3)
    path = write_rows(tmp_path / "log", rng.normal(500, 3, (400, 6)))
    with pytest.raises(RecordingError, match="--columns"):
        gnomon.read(path, rate_hz=50)
    imu = imu_of(gnomon.read(path, rate_hz=50, columns="gx gy gz ax ay az"))
    np.testing.assert_allclose(imu.gyroscope.values, np.loadtxt(path, delimiter=",")[:, :3])


def test_columns_skip_and_reorder(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=3)
    rows = np.column_stack([np.full(len(t), 21.5), t * 1e6, gyro[:, ::-1], accel])
    path = write_rows(tmp_path / "log.csv", rows, header="a,b,c,d,e,f,g,h")
    imu = imu_of(gnomon.read(path, columns="_ t_us gz gy gx ax ay az"))
    np.testing.assert_allclose(imu.gyroscope.values, gyro, rtol=1e-8)
    np.testing.assert_allclose(imu.gyroscope.t_s, t, atol=1e-6)


@pytest.mark.parametrize(
    ("columns", "message"), [("t ax ay az", "names 4 columns"), ("t ax ay az gx gy banana", '"banana" is not known')]
)
def test_wrong_columns_are_option_errors(tmp_path, columns, message) -> None:
    path = write_rows(tmp_path / "log", np.zeros((5, 7)))
    with pytest.raises(OptionError, match=message):
        gnomon.read(path, columns=columns)


@pytest.mark.parametrize(
    ("preamble", "rate"),
    [
        ("Fs,50.00\nInitialization time,60", 50.0),
        ("# sample rate: 200 Hz", 200.0),
        ("Sampling Rate (Hz); 100", 100.0),
        ("% dt = 5 ms", 200.0),
        ("Serial,1234", None),
    ],
)
def test_preamble_gives_the_rate(preamble, rate) -> None:
    assert preamble_rate(tuple(preamble.splitlines())) == (None if rate is None else pytest.approx(rate))


def test_preamble_above_a_header(tmp_path) -> None:
    _, accel, gyro = hand_held(rests=2)
    header = "Fs,50.00\nInitialization time,60\nax,ay,az,gx,gy,gz"
    recording = gnomon.read(write_rows(tmp_path / "log.csv", np.hstack([accel, gyro]), header))
    assert imu_of(recording).accelerometer.rate_hz == 50
    assert "50 Hz as its preamble says" in said(recording)


def test_row_of_units_below_the_names(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=2)
    header = "time;accX;accY;accZ;gyrX;gyrY;gyrZ\nms;g;g;g;dps;dps;dps"
    rows = np.column_stack([t * 1e3, accel / 9.80665, np.degrees(gyro)])
    imu = imu_of(gnomon.read(write_rows(tmp_path / "log.csv", rows, header, ";")))
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("g", "deg/s")
    assert imu.accelerometer.t_ns[1] == 10_000_000


def test_decimal_comma(tmp_path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t;ax;ay;az;gx;gy;gz\n" + "".join(f"0,0{i};1,5;2;9,81;0,25;-0,5;1e-3\n" for i in range(1, 9)))
    imu = imu_of(gnomon.read(path))
    assert imu.accelerometer.values[0].tolist() == [1.5, 2, 9.81]
    assert imu.accelerometer.t_ns[0] == 10_000_000


def test_ros_export_uses_the_header_stamp_and_ignores_the_rest(tmp_path) -> None:
    path = tmp_path / "imu.csv"
    names = ["%time", "field.header.stamp", "field.header.frame_id", "field.orientation.x"]
    names += [f"field.angular_velocity.{axis}" for axis in "xyz"] + ["field.angular_velocity_covariance0"]
    names += [f"field.linear_acceleration.{axis}" for axis in "xyz"]
    rows = [f"{1700000000_010000000 + i * 5_000_000},{1700000000_000000001 + i * 5_000_000},imu,0.5,1,2,3,0,4,5,6.5"
            for i in range(9)]  # fmt: skip
    path.write_text("\n".join([",".join(names), *rows]))
    imu = imu_of(gnomon.read(path))
    assert imu.gyroscope.t_ns[0] == 1700000000_000000001
    assert imu.gyroscope.values[0].tolist() == [1, 2, 3]
    assert imu.accelerometer.values[0].tolist() == [4, 5, 6.5]


def test_seconds_and_nanoseconds_are_added(tmp_path) -> None:
    path = tmp_path / "imu.csv"
    rows = [f"{1700000000 + i},{999_999_990 + i},0.1,0.2,9.8,1.5,2.5,3.5" for i in range(9)]
    path.write_text("\n".join(["stamp.sec,stamp.nanosec,ax,ay,az,gx,gy,gz", *rows]))
    assert imu_of(gnomon.read(path)).accelerometer.t_ns[1] == 1700000001_999_999_991


def test_comments_blank_lines_and_windows_line_ends(tmp_path) -> None:
    path = tmp_path / "log.txt"
    path.write_bytes(
        b"\xef\xbb\xbf# made by hand\r\nt ax ay az gx gy gz\r\n"
        + b"0.00 1 2 9.5 4 5 6.5\r\n\r\n# a pause\r\n0.01 1 2 9 4 5 6\r\n"
        b"0.02 1 2 9 4 5 6 # a remark\r\n"
    )
    assert len(imu_of(gnomon.read(path)).accelerometer) == 3


def test_accelerometer_alone(tmp_path) -> None:
    t, accel, _ = hand_held(rests=2)
    recording = gnomon.read(write_rows(tmp_path / "acc.csv", np.column_stack([t, accel]), "t,ax,ay,az"))
    assert len(imu_of(recording).gyroscope) == 0
    assert "no gyroscope" in said(recording)


def test_pair_with_stamps_of_their_own(tmp_path) -> None:
    t, accel, gyro = hand_held()
    write_rows(tmp_path / "walk-Accelerometer.csv", np.column_stack([t[::2], accel[::2]]), "time,x,y,z")
    write_rows(tmp_path / "walk-Gyroscope.csv", np.column_stack([t + 0.003, gyro]), "time,x,y,z")
    imu = imu_of(gnomon.read(tmp_path))
    assert (imu.accelerometer.rate_hz, imu.gyroscope.rate_hz) == (pytest.approx(50), pytest.approx(100))
    np.testing.assert_allclose(imu.accelerometer.values, accel[::2], rtol=1e-8)


def test_stated_units_win(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=2)
    path = write_rows(tmp_path / "log.csv", np.column_stack([t, accel, gyro]), "t [ms],ax,ay,az,gx,gy,gz [rad/s]")
    imu = imu_of(gnomon.read(path, units="g deg/s s"))
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("g", "deg/s")
    assert imu.accelerometer.t_ns[1] == 10_000_000
    assert imu_of(gnomon.read(path, units=Units(gyroscope="count"))).gyroscope.unit == "count"


def test_cut_last_line_is_left_out_and_said(tmp_path) -> None:
    path = write_rows(tmp_path / "log.csv", np.ones((4, 7)) * np.arange(1, 5)[:, None], "t,ax,ay,az,gx,gy,gz")
    path.write_text(path.read_text() + "5,5,5")
    recording = gnomon.read(path)
    assert len(imu_of(recording).accelerometer) == 4
    assert "cut off" in said(recording)


# ---- timestamps ----


def test_epoch_seconds_with_a_fraction_are_exact(tmp_path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"1700000000.{k:09d},1,2,9.7,4,5,6.5" for k in range(123_456_789, 123_456_789 + 90_000_000, 10_000_000)]
    path.write_text("\n".join(["t,ax,ay,az,gx,gy,gz", *rows]))
    t_ns = imu_of(gnomon.read(path)).accelerometer.t_ns
    assert t_ns[0] == 1700000000_123456789
    assert set(np.diff(t_ns)) == {10_000_000}


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("origin", [0.0, 3600.0, 1.7e9])
@pytest.mark.parametrize("rate_hz", [25.0, 100.0, 1000.0])
def test_time_unit_is_recognised(unit, origin, rate_hz) -> None:
    stamps = (origin + np.arange(50) / rate_hz) * {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    assert guess_time_unit(stamps)[0] == unit


def test_text_stamps_with_signs_and_few_digits() -> None:
    stamps = np.array([b"-1.5", b"0", b"+2.000000001", b"  3.", b".25"], dtype="S40")
    assert to_ns(stamps, "s", "x").tolist() == [-1_500_000_000, 0, 2_000_000_001, 3_000_000_000, 250_000_000]
    assert to_ns(np.array([b"1.23456"], dtype="S40"), "us", "x").tolist() == [1234]
    assert to_ns(np.array([b"1e-3"], dtype="S40"), "s", "x").tolist() == [1_000_000]


def test_stamps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(RecordingError, match="292 years"):
        to_ns(np.array([1.0, 1e18]), "s", "x")


def test_kind_of_stamps() -> None:
    assert stamp_kind(["1404733405747800064", "12"]) == "i8"
    assert stamp_kind(["1700000000.123456789"]) == "S40"
    assert stamp_kind(["2.984e-02"]) == "f8"


def test_stamps_may_turn_from_whole_to_decimal(tmp_path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{i},1,2,9.7,4,5,6.5" for i in range(300)] + ["300.5,1,2,9.7,4,5,6.5"]
    path.write_text("\n".join(["t_ms,ax,ay,az,gx,gy,gz", *rows]))
    assert imu_of(gnomon.read(path)).accelerometer.t_ns[-1] == 300_500_000


# ---- NPZ ----


def test_npz_round_trip_with_several_imus(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=2)
    arrays = {"t_s": t, "accelerometer": accel, "gyroscope": gyro, "unit_accelerometer": "m/s^2"}
    arrays |= {"imu1.accelerometer": np.rint(accel * 100).astype(np.int16), "imu1.rate_hz": 80.0}
    np.savez(tmp_path / "rec.npz", **arrays)
    recording = gnomon.read(tmp_path / "rec.npz")
    assert sorted(recording.imus) == ["imu0", "imu1"]
    np.testing.assert_array_equal(imu_of(recording).gyroscope.values, gyro)
    assert recording.imus["imu1"].accelerometer.unit == "count"
    assert recording.imus["imu1"].accelerometer.rate_hz == 80


def test_npz_with_stamps_of_their_own(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=2)
    np.savez(
        tmp_path / "rec.npz",
        accelerometer=accel[::4], gyroscope=gyro.astype(np.float32),
        t_accelerometer_ns=np.rint(t[::4] * 1e9).astype(np.int64), t_gyroscope_s=t,
    )  # fmt: skip
    imu = imu_of(gnomon.read(tmp_path / "rec.npz"))
    assert (imu.accelerometer.rate_hz, imu.gyroscope.rate_hz) == (pytest.approx(25), pytest.approx(100))
    assert imu.gyroscope.unit == "rad/s"


def test_npz_arrays_are_not_copied() -> None:
    values = np.zeros((10, 3))
    assert np.shares_memory(_values(values, "x"), values)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"data": np.zeros(3)}, "no array named accelerometer; found data"),
        ({"accelerometer": np.zeros((5, 3))}, "no timestamps"),
        ({"accelerometer": np.zeros((5, 4)), "rate_hz": 1.0}, r"expected numbers of shape \(n, 3\)"),
        ({"accelerometer": np.zeros((1, 3)), "rate_hz": 1.0}, "found 1 samples"),
        ({"accelerometer": np.zeros((5, 3)), "t_s": np.zeros(4)}, "5 samples of the accelerometer, but 4 timestamps"),
        ({"accelerometer": np.full((5, 3), np.nan), "rate_hz": 1.0}, "sample 0 is NaN"),
        ({"accelerometer": np.zeros((5, 3)), "unit_accelerometer": "V", "rate_hz": 1.0}, 'unit_accelerometer is "V"'),
        ({"accelerometer": np.zeros((5, 3)), "t_s": np.full(5, np.inf)}, "not a finite number"),
    ],
)
def test_bad_npz(tmp_path, arrays, message) -> None:
    np.savez(tmp_path / "rec.npz", **arrays)
    with pytest.raises(RecordingError, match=message):
        gnomon.read(tmp_path / "rec.npz")


def test_truncated_npz(tmp_path) -> None:
    np.savez_compressed(tmp_path / "rec.npz", accelerometer=np.random.default_rng(0).normal(size=(500, 3)))
    whole = (tmp_path / "rec.npz").read_bytes()
    (tmp_path / "rec.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match="damaged"):
        gnomon.read(tmp_path / "rec.npz")


# ---- bad input ----

HEAD = "t,ax,ay,az,gx,gy,gz\n0.00,1,2,9.5,4,5,6\n0.01,1,2,9.5,4,5,6\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"empty \(0 bytes\)"),
        (b"   \n \n", "no text"),
        (b"hello\nworld\n", "no table of numbers"),
        (b"t,ax,ay,az,gx,gy,gz\n", "no table of numbers"),
        (b"t,ax,ay,az,gx,gy,gz\n0,1,2,3,4,5,6\n", "found 1 row of data"),
        (HEAD + "0.02,1,two,9,4,5,6\n0.03,1,2,9,4,5,6\n", r'line 4, column 3 \(ay\): found "two"'),
        (HEAD + "0.02,1,,9,4,5,6\n0.03,1,2,9,4,5,6\n", r"line 4, column 3 \(ay\): found nothing"),
        (HEAD + "0.02,1,2,nan,4,5,6\n0.03,1,2,9,4,5,6\n", r"line 4, column 4 \(az\): found nan"),
        (HEAD + "0.02,1,2,9,4,5,-inf\n0.03,1,2,9,4,5,6\n", r"line 4, column 7 \(gz\): found -inf"),
        (HEAD + "nan,1,2,9,4,5,6\n0.03,1,2,9,4,5,6\n", r"line 4, column 1 \(t\): found nan"),
        (HEAD + "0.02,1,2,9,4,5\n0.03,1,2,9,4,5,6\n", "line 4: found 6 columns, expected 7"),
        (HEAD + "0.02,1,2,9,4,5,6,7\n0.03,1,2,9,4,5,6\n", "line 4: found 8 columns, expected 7"),
        ("t,ax,ay,gx,gy,gz\n" + "0,1,2,4,5,6\n" * 5, "each axis of the accelerometer once"),
        ("t,ax,ay,az,ax,gx,gy,gz\n" + "0,1,2,9,4,5,6,7\n" * 5, "x: 2"),
        ("time,temp\n" + "0,1\n" * 5, "names no accelerometer"),
        ("1,2\n" * 5, "2 columns separated by commas"),
        ("0,1,2,3,4,5,6,7,8\n" * 5, "9 columns"),
        ("9,1,2,3,4,5,6\n8,1,2,3,4,5,6\n7,1,2,3,4,5,6\n", "does not rise"),
        ("t,gx,gy,gz\n" + "0,1,2,4\n" * 5, "only a gyroscope"),
        (b"\x00\x01\x02" * 300, "binary file"),
        (b"#ROSBAG V2.0\n" + b"\x00" * 100, "damaged or cut off"),
        (b"\x89HDF\r\n\x1a\n" + b"\x00" * 100, "HDF5"),
    ],
)
def test_bad_text(tmp_path, content, message) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(RecordingError, match=message) as caught:
        gnomon.read(path)
    assert "log.csv" in str(caught.value)


def test_line_numbers_count_comments_and_blank_lines(tmp_path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("# by hand\n" + HEAD + "\n# pause\n0.02,1,2,9.5,4,5,6\n0.03,1,2,oops,4,5,6\n0.04,1,2,9,4,5,6\n")
    with pytest.raises(RecordingError, match="line 8, column 4"):
        gnomon.read(path)


def test_error_far_down_in_a_gzipped_file(tmp_path) -> None:
    rows = [f"{i * 0.01:.2f} 1 2 9.5 4 5 6" for i in range(20_000)]
    rows[15_000] = rows[15_000].replace("9.5", "9.5.5")
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress("\n".join(rows).encode()))
    with pytest.raises(RecordingError, match=r'log.gz, line 15001, column 4: found "9.5.5"'):
        gnomon.read(path, columns="t ax ay az gx gy gz")


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_damaged_gzip(tmp_path, damage) -> None:
    whole = gzip.compress((HEAD * 300).encode())
    cut = whole[: len(whole) // 2]
    (tmp_path / "log.csv.gz").write_bytes(cut if damage == "cut" else whole[:20] + b"\xff" * 9 + whole[29:])
    with pytest.raises(RecordingError, match="Copy it again"):
        gnomon.read(tmp_path / "log.csv.gz")


def test_missing_file(tmp_path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        gnomon.read(tmp_path / "nothing.csv")


def test_folder_without_recording_and_with_several(tmp_path) -> None:
    (tmp_path / "notes.pdf").write_bytes(b"x")
    with pytest.raises(RecordingError, match="no recording in this folder"):
        gnomon.read(tmp_path)
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(HEAD)
    with pytest.raises(RecordingError, match=r"2 files may be the recording \(a.csv, b.csv\)"):
        gnomon.read(tmp_path)


@pytest.mark.parametrize("read", [gnomon.read, gnomon.read_turntable])
def test_a_result_is_no_recording(tmp_path, read) -> None:
    (tmp_path / "calibration.yaml").write_text("schema: gnomon/1\n")
    for name in ("diagnostics.npz", "trajectory.txt", "allan.csv"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(RecordingError, match="this folder holds a result, and no recording"):
        read(tmp_path)
    for name in ("calibration.yaml", "diagnostics.npz"):
        with pytest.raises(RecordingError, match="belongs to a calibration and is no recording"):
            read(tmp_path / name)
    (tmp_path / "log.csv").write_text(HEAD * 9)  # a recording whose result lies beside it
    assert recording_files([tmp_path]) == [tmp_path / "log.csv"]


def test_pair_must_be_one_of_each(tmp_path) -> None:
    t, accel, gyro = hand_held(rests=2)
    one = write_rows(tmp_path / "1.csv", np.column_stack([t, accel]), "t,ax,ay,az")
    both = write_rows(tmp_path / "2.csv", np.column_stack([t, accel, gyro]), "t,ax,ay,az,gx,gy,gz")
    with pytest.raises(RecordingError, match="both hold an accelerometer"):
        gnomon.read(one, one)
    with pytest.raises(RecordingError, match="found two triads"):
        gnomon.read(one, both)


def test_wrong_use(tmp_path) -> None:
    with pytest.raises(OptionError, match="0 paths"):
        gnomon.read()
    with pytest.raises(OptionError, match="greater than zero"):
        gnomon.read(tmp_path / "x", rate_hz=-1)
    np.savez(tmp_path / "rec.npz", accelerometer=np.zeros((5, 3)))
    with pytest.raises(OptionError, match="columns are for text tables"):
        gnomon.read(tmp_path / "rec.npz", columns="t ax ay az")


@pytest.mark.parametrize("number", ["1e160", "-1e300"])
def test_numbers_beyond_all_measure_are_refused(tmp_path, number):
    rows = ["0.01 0.1 0.2 9.8 0.01 0.02 0.03"] * 5 + [f"0.06 0.1 {number} 9.8 0.01 0.02 0.03"]
    path = tmp_path / "table.txt"
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(RecordingError, match=f"line 6, column 3: found {number}, expected a finite number"):
        gnomon.read(path, rate_hz=100)
