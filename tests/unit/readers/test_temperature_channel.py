"""The thermometer of an IMU is a channel of recordings: read from tables and NPZ, written, read back."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from bag_maker import FORMS, T0, imu, make_bag, other
from gnomon import read
from gnomon.recording import Recording, TemperatureSamples
from gnomon.writers.recording_file import save_recording

T = np.arange(100) / 50


def table(path, header, temperature):
    rows = [f"{t},0,0,9.81,0,0,{0.01 * (i % 2)},{temperature(i)}\n" for i, t in enumerate(T)]
    path.write_text(f"t,ax,ay,az,gx,gy,gz,{header}\n" + "".join(rows))
    return path


def test_of_two_thermometers_the_first_one_counts(tmp_path):
    path = table(tmp_path / "log.csv", "temp_imu_degC,temp_baro_degC", lambda i: f"{24 + i / 50},{50 - i / 50}")
    recording = read(path, units="si")
    np.testing.assert_allclose(recording.imus["imu0"].temperature.values, 24 + np.arange(100) / 50)
    assert "2 temperatures (temp_imu_degC, temp_baro_degC); temp_imu_degC is used" in " ".join(recording.assumptions)


@pytest.mark.parametrize(
    ("header", "value", "unit", "celsius"),
    [
        ("temp_degC", 24.5, "degC", 24.5),
        ("temperature [K]", 297.65, "K", 24.5),
        ("Temp (°F)", 76.1, "degF", 24.5),
        ("T (°C)", 24.5, "degC", 24.5),
        ("temp", 24.5, "degC", 24.5),
        ("temp", 297.65, "K", 24.5),
        ("temp", -4100, "count", None),
        ("temp_raw", 24.5, "count", None),
        ("temp_mpu6050", -4090, "MPU-6050 count", -4090 / 340 + 36.53),
        ("temperature [MPU-6000]", -4090, "MPU-6050 count", -4090 / 340 + 36.53),
        ("temp_icm42688", 53, "ICM-42688 count", 53 / 132.48 + 25),
    ],
)
def test_units_of_temperatures(tmp_path, header, value, unit, celsius) -> None:
    found = read(table(tmp_path / "log.csv", header, lambda _: value), units="si").imus["imu0"].temperature
    assert found.unit == unit
    np.testing.assert_array_equal(found.values, value)
    assert found.celsius() is None if celsius is None else np.allclose(found.celsius(), celsius, atol=1e-9)


def test_a_temperature_with_holes_is_left_out_and_told(tmp_path) -> None:
    recording = read(table(tmp_path / "log.csv", "temp", lambda i: "" if i == 50 else 24.5), units="si")
    assert recording.imus["imu0"].temperature is None
    assert len(recording.imus["imu0"].accelerometer) == len(T)
    assert any("not a number in every row" in note for note in recording.assumptions)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_written_and_read_back(tmp_path, suffix) -> None:
    made = Recording.from_arrays(T, np.zeros((100, 3)), np.tile([0, 0, 9.81], (100, 1)))
    imu = made.imus["imu0"]
    warmth = TemperatureSamples(t_ns=imu.accelerometer.t_ns, values=20 + T, unit="degC")
    save_recording(replace(made, imus={"imu0": replace(imu, temperature=warmth)}), tmp_path / f"log{suffix}")
    found = read(tmp_path / f"log{suffix}").imus["imu0"].temperature
    assert found.unit == "degC"
    np.testing.assert_array_equal(found.t_ns, warmth.t_ns)
    np.testing.assert_array_equal(found.values, warmth.values)


def test_a_slower_thermometer_is_not_lost_in_a_table(tmp_path) -> None:
    made = Recording.from_arrays(T, np.zeros((100, 3)), np.tile([0, 0, 9.81], (100, 1)))
    imu = made.imus["imu0"]
    slow = TemperatureSamples(t_ns=imu.accelerometer.t_ns[::33], values=20 + T[::33], unit="degC")
    save_recording(replace(made, imus={"imu0": replace(imu, temperature=slow)}), tmp_path / "log.csv")
    found = read(tmp_path / "log.csv").imus["imu0"].temperature
    np.testing.assert_allclose(found.values, 20 + T, atol=1e-9)


def test_the_thermometer_in_a_log_of_ardupilot(tmp_path) -> None:
    columns = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T"
    head = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", f"FMT, 172, 40, IMU, QBfffffff, {columns}"]
    rows = [f"IMU, {20_000 * i}, {i % 2}, 0, 0, 0, 0, 0, -9.81, {30 + i % 2}" for i in range(100)]
    (tmp_path / "log.log").write_text("\n".join([*head, *rows]) + "\n")
    found = read(tmp_path / "log.log").imus["imu0"].temperature
    assert found.unit == "degC"
    np.testing.assert_array_equal(found.values, np.full(50, 30.0))  # the first IMU's alone


def test_the_thermometer_in_a_log_of_px4(tmp_path) -> None:
    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + bytes(8) + message("B", bytes(40))
    for i, name in enumerate((b"sensor_accel", b"sensor_gyro")):
        out += message("F", name + b":uint64_t timestamp;float x;float y;float z;float temperature;")
        out += message("A", b"\0" + struct.pack("<H", i) + name)
    for k in range(100):
        for i, z in enumerate((-9.81, 0.0)):
            out += message("D", struct.pack("<HQ4f", i, 20_000 * k, 0, 0, z, 30 + k / 4))
    (tmp_path / "log.ulg").write_bytes(out)
    found = read(tmp_path / "log.ulg").imus["imu0"].temperature
    np.testing.assert_array_equal(found.values, 30 + np.arange(100) / 4)
    np.testing.assert_array_equal(found.t_ns, 20_000_000 * np.arange(100))


def test_of_two_columns_the_first_is_used_and_both_are_named(tmp_path) -> None:
    recording = read(table(tmp_path / "log.csv", "temp_degC,board_temp_degC", lambda i: f"{i % 2},90"), units="si")
    assert recording.imus["imu0"].temperature.values.max() == 1
    assert any("temp_degC, board_temp_degC" in note for note in recording.assumptions)


@pytest.mark.parametrize("form", FORMS)
def test_the_thermometer_in_a_bag(tmp_path, form) -> None:
    messages = [imu("/imu/data", T0 + i * 5_000_000, (0, 0, 0.01 * (i % 2)), (0, 0, 9.81)) for i in range(400)]
    for topic, start in (("/imu/temperature", 30.0), ("/outside/temperature", -3.0)):
        messages += [other(topic, T0 + i * 500_000_000, start + i) for i in range(4)]
    messages.append(other("/imu/temperature", T0 + 4 * 500_000_000, float("nan")))
    recording = read(make_bag(tmp_path, form, sorted(messages, key=lambda one: one.t_ns)))
    found = recording.imus["imu0"].temperature
    assert found.unit == "degC"
    np.testing.assert_array_equal(found.values, [30.0, 31.0, 32.0, 33.0])
    np.testing.assert_array_equal(found.t_ns, T0 + 500_000_000 * np.arange(4))
    assert any("/outside/temperature" in note for note in recording.assumptions)


def test_a_thermometer_elsewhere_is_not_the_imus(tmp_path) -> None:
    messages = [imu("/imu/data", T0 + i * 5_000_000, (0, 0, 0.01), (0, 0, 9.81)) for i in range(100)]
    messages += [other("/weather/temperature", T0 + i * 100_000_000) for i in range(4)]
    recording = read(make_bag(tmp_path, "ros2", sorted(messages, key=lambda one: one.t_ns)))
    assert recording.imus["imu0"].temperature is None
    assert any("/weather/temperature" in note for note in recording.assumptions)


def test_the_thermometer_in_arrays_that_somebody_else_named(tmp_path) -> None:
    arrays = {"acc_g": np.tile([0.0, 0, 1], (100, 1)), "gyro_dps": np.zeros((100, 3)), "temp_c": 25 + T[::2, None]}
    stamps = {"t_acc_g": T, "t_gyro_dps": T, "t_temp_c": T[::2]}
    np.savez(tmp_path / "log.npz", **arrays, **stamps)
    recording = read(tmp_path / "log.npz")
    found = recording.imus["imu0"].temperature
    assert found.unit == "degC"
    np.testing.assert_array_equal(found.values, 25 + T[::2])
    np.testing.assert_array_equal(found.t_ns, np.rint(1e9 * T[::2]).astype(np.int64))
    assert any("temp_c is the thermometer" in note for note in recording.assumptions)
    np.savez(tmp_path / "holes.npz", **arrays | {"temp_c": np.full(50, np.nan)}, **stamps)
    recording = read(tmp_path / "holes.npz")
    assert recording.imus["imu0"].temperature is None
    assert any("temp_c was left out" in note for note in recording.assumptions)
