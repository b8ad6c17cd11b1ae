"""Logs of autopilots, MAT files and printed lines that are cut off, damaged, or hold something else."""

import numpy as np
import pytest
from scipy.io import savemat

import field_logs
from field_logs import COUNT, STEP_S
from gnomon import read
from gnomon.errors import OptionError, RecordingError
from gnomon.readers.samples.table import Unwrapper

TRUTH = field_logs.samples()


def test_a_ulog_that_is_cut_off_is_read_so_far(tmp_path) -> None:
    recording = read(field_logs.ulog(tmp_path / "log.ulg", TRUTH, cut=20_010))
    samples = recording.imus["imu0"]
    count = len(samples.accelerometer)
    assert COUNT / 2 < count < COUNT
    np.testing.assert_allclose(samples.accelerometer.values, TRUTH.force[:count], atol=1e-5)
    assert any("cut off" in note for note in recording.assumptions)


def test_damage_in_a_dataflash_log_is_passed_over_and_told(tmp_path) -> None:
    recording = read(field_logs.dataflash(tmp_path / "log.bin", TRUTH, damage=b"\xa3\x95\x07" + bytes(40)))
    samples = recording.imus["imu0"]
    np.testing.assert_allclose(samples.gyroscope.values, TRUTH.rate, atol=1e-6)
    assert any("43 bytes are damaged" in note for note in recording.assumptions)


@pytest.mark.parametrize("cut", [17, 60, 200])
def test_the_head_of_an_autopilots_log_alone_is_refused_with_words(cut, tmp_path) -> None:
    for write, says in ((field_logs.ulog, "sensor_combined"), (field_logs.dataflash, "no messages IMU")):
        path = write(tmp_path / "log", TRUTH)
        path.write_bytes(path.read_bytes()[:cut])
        with pytest.raises(RecordingError, match=says):
            read(path)


@pytest.mark.parametrize(
    ("write", "was", "damaged", "says"),
    [
        (field_logs.ulog, b"uint64_t timestamp;float[3]", b"float[2] timestamp;float[3]", "timestamps are not whole"),
        (field_logs.dataflash, b"TimeUS,I,GyrX", b"TimeUS,,,GyrX", "no messages IMU"),
    ],
)
def test_a_damaged_format_of_an_autopilots_log_is_refused_with_words(write, was, damaged, says, tmp_path) -> None:
    path = write(tmp_path / "log", TRUTH)
    content = path.read_bytes()
    assert was in content
    path.write_bytes(content.replace(was, damaged))
    with pytest.raises(RecordingError, match=says):
        read(path)


def test_a_name_that_damage_gave_twice_and_a_nan_that_signals_are_passed_over(tmp_path) -> None:
    path = field_logs.ulog(tmp_path / "log.ulg", TRUTH)
    force = np.float32(TRUTH.force[3]).tobytes()
    content = path.read_bytes().replace(b"float x;float y;", b"float x;float x;").replace(force, b"\1\0\x80\x7f" * 3)
    path.write_bytes(content)
    (imu,) = read(path).imus.values()
    assert len(imu.accelerometer) == COUNT - 1
    assert imu.magnetometer is None


def test_an_autopilots_log_takes_no_columns(tmp_path) -> None:
    with pytest.raises(OptionError, match="Leave out --columns"):
        read(field_logs.ulog(tmp_path / "log.ulg", TRUTH), columns="t ax ay az gx gy gz")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"acc": np.ones((9, 3)), "gyro": np.ones((8, 3))}, "different lengths"),
        ({"note": "nothing"}, "no arrays of samples"),
        ({"acc": np.full((9, 3), np.nan), "t": np.arange(9.0)}, "expected a number|finite"),
        ({"acc": np.ones((9000, 3))}, "--rate"),
    ],
)
def test_a_mat_file_without_samples_is_refused_with_words(content, says, tmp_path) -> None:
    savemat(tmp_path / "log.mat", content)
    with pytest.raises(RecordingError, match=says):
        read(tmp_path / "log.mat")


def test_a_mat_file_that_is_cut_off_is_refused(tmp_path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"t": TRUTH.t, "acc": TRUTH.force})
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(RecordingError, match=r"damaged \(it ends early\)"):
        read(path)


def test_a_mat_file_of_version_7_3_is_refused_with_the_way_out(tmp_path) -> None:
    path = tmp_path / "log.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(RecordingError, match="-v7"):
        read(path)


def test_lines_between_samples_are_left_out_and_counted(tmp_path) -> None:
    def line(i):
        row = f"ax: {TRUTH.force[i, 0]:.4f} ay: {TRUTH.force[i, 1]:.4f} az: {TRUTH.force[i, 2]:.4f}"
        return f"t: {i * 20} {row}" + ("\nbutton pressed, state 3" if i in {50, 90} else "")

    recording = read(field_logs.lines(tmp_path / "log.txt", line, "ready"))
    accelerometer = recording.imus["imu0"].accelerometer
    np.testing.assert_allclose(accelerometer.values, TRUTH.force, atol=1e-4)
    np.testing.assert_array_equal(np.diff(accelerometer.t_ns), round(STEP_S * 1e9))
    assert any("2 lines between samples" in note and "first: 53" in note for note in recording.assumptions)


def test_a_bad_value_in_a_printed_line_is_found_at_its_line(tmp_path) -> None:
    path = field_logs.lines(tmp_path / "log.txt", lambda i: f"ax={'nan' if i == 7 else i} ay=2 az=3 t={i}", "ready")
    with pytest.raises(RecordingError, match="line 9, column 1"):
        read(path)


def test_counters_of_32_bits_go_on_in_blocks_and_other_steps_back_stay() -> None:
    unwrapper = Unwrapper()
    first, second = unwrapper(np.array([2**32 - 20, 2**32 - 10])), unwrapper(np.array([2, 2**32 - 5, 12]))
    np.testing.assert_array_equal(np.r_[first, second] - 2**32, [-20, -10, 2, -5, 12])
    for others in ([5_000_000, 10, 20], [100, 4_000_000_000, 101], [1_600_000_000_000_000_000, 5]):
        stamps = np.array(others)
        np.testing.assert_array_equal(Unwrapper()(stamps), stamps)


def test_named_columns_that_are_not_used_are_told(tmp_path) -> None:
    path = field_logs.lines(
        tmp_path / "log.csv", lambda i: f"{i / 50},1,2,{i % 3},24.5,7", "t,ax,ay,az,temperature,btn"
    )
    notes = read(path, units="si").assumptions
    assert "log.csv: columns that are not used: btn." in notes
