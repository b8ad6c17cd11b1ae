"""Logs of phones: Sensor Logger, phyphox, and apps that write one table; made as their documentation describes them."""

import zipfile

import cv2
import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError, RecordingError
from gnomon.readers import files
from gnomon.readers.devices.device_log import is_device_log
from gnomon.readers.images.image_recording import holds_images, open_images
from gnomon.readers.samples.stream import open_stream
from gnomon.units import Units
from image_folders import picture, write_video
from phone_logs import EPOCH_NS, G, metadata, motion, phyphox, sensor_logger, table, zipped

T, FORCE, RATE = motion()
GRAVITY = np.tile([0.0, 0.6 * G, 0.8 * G], (len(T), 1))


def imu_of(*paths, **options):
    return gnomon.read(*paths, **options).imus["imu0"]


def said_of(path):
    return " ".join(gnomon.read(path).assumptions)


def refused(path, *words, **options):
    with pytest.raises((RecordingError, OptionError)) as error:
        gnomon.read(path, **options)
    text = str(error.value)
    assert all(word in text for word in words), text


def same(triad, t, values, unit, tolerance=1e-6):
    assert triad.unit == unit
    np.testing.assert_allclose(triad.values, values, atol=tolerance)
    np.testing.assert_allclose((triad.t_ns - triad.t_ns[0]) * 1e-9, t - t[0], atol=1e-6)


# ---- Sensor Logger ----


@pytest.fixture
def android(tmp_path):
    """A folder of Sensor Logger on Android with everything in it."""
    folder = tmp_path / "2023-10-28_13-52-24"
    sensor_logger(folder / "Accelerometer.csv", T, FORCE - GRAVITY)
    sensor_logger(folder / "Gravity.csv", T, GRAVITY)
    sensor_logger(folder / "TotalAcceleration.csv", T, FORCE + 0.01)
    sensor_logger(folder / "AccelerometerUncalibrated.csv", T, FORCE + 0.1)
    sensor_logger(folder / "Gyroscope.csv", T, RATE, offset_s=0.003)
    sensor_logger(folder / "GyroscopeUncalibrated.csv", T, RATE + 0.02, offset_s=0.003)
    sensor_logger(folder / "Magnetometer.csv", T[::2], 40 * FORCE[::2] / G)
    table(folder / "Orientation.csv", "time,seconds_elapsed,qz,qy,qx,qw,roll,pitch,yaw", [("1", "0", *"1234567")] * 9)
    metadata(folder, "android")
    return folder


def test_sensor_logger_on_android(android, tmp_path):
    """The uncalibrated sensors first, columns by name, each with its own timestamps; of the folder and of the zip."""
    for path in (android, zipped(android, tmp_path / "a.zip"), zipped(android, tmp_path / "b.zip", "in/")):
        imu = imu_of(path)
        same(imu.accelerometer, T, FORCE + 0.1, "m/s^2")
        same(imu.gyroscope, T, RATE + 0.02, "rad/s")
        same(imu.magnetometer, T[::2], 40 * FORCE[::2] / G, "uT")
        assert imu.accelerometer.t_ns[0] == EPOCH_NS
        assert imu.gyroscope.t_ns[0] == EPOCH_NS + 3_000_000
    assert [source.name for source in gnomon.read(tmp_path / "a.zip").sources] == ["a.zip"]


def test_the_phones_thermometer(android, tmp_path):
    assert imu_of(android).temperature is None
    warm = 30 + T[::50] / 10
    rows = zip(EPOCH_NS + 1e9 * T[::50], T[::50], warm, strict=True)
    table(android / "BatteryTemp.csv", "time,seconds_elapsed,temperature", rows)
    for path in (android, zipped(android, tmp_path / "warm.zip")):
        found = imu_of(path).temperature
        np.testing.assert_allclose(found.values, warm, atol=1e-6)
        np.testing.assert_allclose((found.t_ns - EPOCH_NS) * 1e-9, T[::50], atol=1e-6)
        assert "BatteryTemp.csv: temperatures of the phone" in said_of(path)


def test_phyphox_with_a_thermometer(tmp_path):
    folder = tmp_path / "warm"
    phyphox(folder / "Accelerometer.csv", "Acceleration", "m/s^2", T, FORCE)
    phyphox(folder / "Gyroscope.csv", "Gyroscope", "rad/s", T, RATE)
    rows = zip(T[::50], 20 + T[::50], strict=True)
    table(folder / "Temperature.csv", '"Time (s)","Temperature (°C)"', rows)
    found = imu_of(folder).temperature
    np.testing.assert_allclose(found.values, 20 + T[::50], atol=1e-6)
    assert found.unit == "degC"


def test_total_acceleration_comes_before_what_is_put_together(android):
    (android / "AccelerometerUncalibrated.csv").unlink()
    same(imu_of(android).accelerometer, T, FORCE + 0.01, "m/s^2")
    (android / "TotalAcceleration.csv").unlink()
    same(imu_of(android).accelerometer, T, FORCE, "m/s^2")
    assert "calibrates the phone's software" in said_of(android)


def test_gravity_has_stamps_of_its_own(android):
    for name in ("AccelerometerUncalibrated", "TotalAcceleration"):
        (android / f"{name}.csv").unlink()
    sensor_logger(android / "Gravity.csv", T[10:] + 0.004, GRAVITY[10:])
    same(imu_of(android).accelerometer, T[11:], FORCE[11:], "m/s^2")


def test_an_accelerometer_without_gravity_is_refused(android):
    for name in ("AccelerometerUncalibrated", "TotalAcceleration", "Gravity"):
        (android / f"{name}.csv").unlink()
    refused(android, "Accelerometer.csv is without gravity", "Record the uncalibrated")
    (android / "Accelerometer.csv").unlink()
    refused(android, "no accelerometer with gravity")


@pytest.mark.parametrize("standardised", [False, True])
def test_sensor_logger_on_ios(tmp_path, standardised):
    """In g and with the opposite sign, unless units and frames were standardised."""
    sensor_logger(tmp_path / "AccelerometerUncalibrated.csv", T, FORCE if standardised else -FORCE / G)
    sensor_logger(tmp_path / "GyroscopeUncalibrated.csv", T, RATE)
    metadata(tmp_path, "ios", "true" if standardised else "false")
    imu = imu_of(tmp_path)
    same(imu.accelerometer, T, FORCE if standardised else FORCE / G, "m/s^2" if standardised else "g")
    same(imu.gyroscope, T, RATE, "rad/s")


@pytest.mark.parametrize("standardised", [False, True])
def test_what_is_put_together_on_ios(tmp_path, standardised):
    sign = 1 if standardised else -1
    sensor_logger(tmp_path / "Accelerometer.csv", T, sign * (FORCE - GRAVITY))
    sensor_logger(tmp_path / "Gravity.csv", T, sign * GRAVITY)
    sensor_logger(tmp_path / "Gyroscope.csv", T, RATE)
    metadata(tmp_path, "ios", "true" if standardised else "false")
    same(imu_of(tmp_path).accelerometer, T, FORCE, "m/s^2")


def test_rows_that_stand_twice_are_read_once(tmp_path):
    again = np.sort(np.append(np.arange(len(T)), [5, 700]))
    sensor_logger(tmp_path / "TotalAcceleration.csv", T[again], FORCE[again])
    sensor_logger(tmp_path / "Gyroscope.csv", T, RATE)
    same(imu_of(tmp_path).accelerometer, T, FORCE, "m/s^2")
    assert "2 rows stand in it twice" in said_of(tmp_path)


def test_tables_alone(android):
    assert len(imu_of(android / "TotalAcceleration.csv").gyroscope) == 0
    assert len(imu_of(android / "Magnetometer.csv").magnetometer) == 1000
    same(imu_of(android / "TotalAcceleration.csv", android / "Gyroscope.csv").gyroscope, T, RATE, "rad/s")
    refused(android / "Gyroscope.csv", "no accelerometer with gravity")


def test_units_that_are_stated_win(android):
    assert imu_of(android, units="g deg/s").accelerometer.unit == "g"
    refused(android, "--columns", columns="t ax ay az")
    refused(android, "--rate", rate_hz=100)


def test_apply_reads_the_same(android):
    stream = open_stream(android, expected=Units())
    assert sum(map(len, stream.accelerometer)) == len(T)


@pytest.mark.parametrize("form", ["images", "video"])
def test_sensor_logger_with_its_camera(android, form):
    """Images are named by milliseconds since 1970, in Camera/; a video lies there too."""
    camera = android / "Camera"
    camera.mkdir()
    if form == "video":
        write_video(camera / "1698501144400.mp4", count=12, codec="mpeg4", pixels="yuv420p")
    else:
        for number in range(12):
            image = cv2.imencode(".jpg", picture(number))[1].tobytes()
            (camera / f"{EPOCH_NS // 10**6 + 50 * number}.jpg").write_bytes(image)
    assert holds_images(android)
    recording = open_images(android)
    assert recording.streams["cam0"].count == 12
    np.testing.assert_allclose(recording.imus["imu0"].accelerometer.values, FORCE + 0.1, atol=1e-6)
    if form == "images":
        frames = [frame.t_ns for frame in recording.streams["cam0"].frames([])]
        assert frames[0] == EPOCH_NS // 10**6 * 10**6


# ---- phyphox ----


@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", False), ("\t", False), (";", True), ("\t", True)])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_phyphox(tmp_path, separator, comma, encoding):
    folder, how = tmp_path / "phyphox", {"separator": separator, "comma": comma, "encoding": encoding}
    phyphox(folder / "Accelerometer.csv", "Acceleration", "m/s^2", T, FORCE, **how)
    phyphox(folder / "Gyroscope.csv", "Gyroscope", "rad/s", T + 0.002, RATE, **how)
    phyphox(folder / "Magnetometer.csv", "Magnetic field", "µT", T[::2], 40 * FORCE[::2] / G, **how)
    phyphox(folder / "Linear Accelerometer.csv", "Linear Acceleration", "m/s^2", T, FORCE - GRAVITY, **how)
    table(folder / "meta" / "device.csv", '"property","value"', [('"deviceModel"', '"A phone"')])
    table(folder / "meta" / "time.csv", '"event","experiment time","system time"', [('"START"', "0.0", "1.6E9")])
    for path in (folder, zipped(folder, tmp_path / "a.zip")):
        imu = imu_of(path)
        same(imu.accelerometer, T, FORCE, "m/s^2")
        same(imu.gyroscope, T, RATE, "rad/s")
        same(imu.magnetometer, T[::2], 40 * FORCE[::2] / G, "uT")
        assert imu.gyroscope.t_ns[0] - imu.accelerometer.t_ns[0] == pytest.approx(2e6, abs=10)
        assert "Linear Accelerometer.csv: without gravity, and left out" in said_of(path)


def test_linear_acceleration_alone_is_refused(tmp_path):
    phyphox(tmp_path / "Raw Data.csv", "Linear Acceleration", "m/s^2", T, FORCE - GRAVITY)
    refused(tmp_path / "Raw Data.csv", "without gravity", "Acceleration with g")
    refused(tmp_path, "without gravity", "Acceleration with g")
    refused(zipped(tmp_path, tmp_path / "a.zip"), "without gravity", "Acceleration with g")


def test_a_table_of_phyphox_alone(tmp_path):
    names = ["Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz"), "Absolute acceleration (m/s^2)"]
    rows = [(t, *row, float(np.linalg.norm(row))) for t, row in zip(T, FORCE, strict=True)]
    table(tmp_path / "Raw Data.csv", ",".join(f'"{name}"' for name in names), rows, number="%.9E")
    for path in (tmp_path / "Raw Data.csv", zipped(tmp_path, tmp_path / "a.zip")):
        same(imu_of(path).accelerometer, T, FORCE, "m/s^2")


def test_several_recordings_of_phyphox_are_poses_still(tmp_path):
    for pose in range(6):
        phyphox(
            tmp_path / f"pose{pose}.csv",
            "Acceleration",
            "m/s^2",
            T[:400],
            np.tile(np.roll([0.1, 0.2, G], pose), (400, 1)),
        )
    assert not is_device_log((tmp_path,))
    assert len(gnomon.read(tmp_path).pieces) == 6


# ---- apps that write one table ----


def test_hyperimu(tmp_path):
    header = (
        "Timestamp,Accelerometer.x,Accelerometer.y,Accelerometer.z,Gyroscope.x,Gyroscope.y,Gyroscope.z,Orientation.x"
    )
    rows = [(str(EPOCH_NS // 10**6 + round(1000 * t)), *f, *w, "0.5") for t, f, w in zip(T, FORCE, RATE, strict=True)]
    table(tmp_path / "hyper.csv", header, rows)
    imu = imu_of(tmp_path / "hyper.csv")
    same(imu.accelerometer, T, FORCE, "m/s^2")
    same(imu.gyroscope, T, RATE, "rad/s")


@pytest.mark.parametrize("comma", [False, True])
def test_physics_toolbox(tmp_path, comma):
    """gF is with gravity, in g; ax, ay, az beside it are linear."""
    separator = ";" if comma else ","
    header = separator.join(["time", "gFx", "gFy", "gFz", "ax", "ay", "az", "wx", "wy", "wz", "Bx", "By", "Bz"])
    rows = [(t, *f / G, 0.1, 0.2, 0.3, *w, 1.0, 2.0, 3.0) for t, f, w in zip(T, FORCE, RATE, strict=True)]
    table(tmp_path / "toolbox.csv", header, rows, separator=separator, comma=comma)
    imu = imu_of(tmp_path / "toolbox.csv")
    same(imu.accelerometer, T, FORCE / G, "g")
    same(imu.gyroscope, T, RATE, "rad/s")


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_androsensor(tmp_path, encoding):
    sensors = {"ACCELEROMETER": "m/s²", "GRAVITY": "m/s²", "LINEAR ACCELERATION": "m/s²", "GYROSCOPE": "rad/s"}
    names = [f"{name} {axis} ({unit})" for name, unit in sensors.items() for axis in "XYZ"]
    header = ";".join([*names, "Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"])
    rows = [
        (*f, *GRAVITY[0], 0.1, 0.2, 0.3, *w, str(round(1000 * t)), "2023-10-28 13-52-24_401")
        for t, f, w in zip(T, FORCE, RATE, strict=True)
    ]
    table(tmp_path / "andro.csv", header, rows, separator=";", encoding=encoding)
    imu = imu_of(tmp_path / "andro.csv")
    same(imu.accelerometer, T, FORCE, "m/s^2")
    same(imu.gyroscope, T, RATE, "rad/s")


@pytest.fixture
def mars(tmp_path):
    """A folder of the MARS logger: movie.mp4 with its frames' timestamps, and gyro_accel.csv in the same clock."""
    start = 5_000_000_000_000
    header = "Timestamp[nanosec], gx[rad/s], gy[rad/s], gz[rad/s], ax[m/s^2], ay[m/s^2], az[m/s^2], Unix time[nanosec]"
    stamps = [start + round(1e9 * t) for t in T]
    rows = [(str(s), *w, *f, str(EPOCH_NS)) for s, f, w in zip(stamps, FORCE, RATE, strict=True)]
    table(tmp_path / "gyro_accel.csv", header, rows, separator=", ")
    write_video(tmp_path / "movie.mp4", count=20, codec="mpeg4", pixels="yuv420p")
    frames = [start + 50_000_000 * k for k in range(20)]
    table(tmp_path / "frame_timestamps.txt", "Frame timestamp[nanosec]", [(str(stamp),) for stamp in frames])
    metadata_row = [(str(stamp), 500.0, 500.0, str(k)) for k, stamp in enumerate(frames[:-1])]
    table(tmp_path / "movie_metadata.csv", "Timestamp[nanosec],fx[px],fy[px],Frame No.", metadata_row)
    return tmp_path


def test_mars_logger(mars):
    recording = open_images(mars)
    assert [frame.t_ns for frame in recording.streams["cam0"].frames([])][:2] == [5 * 10**12, 5 * 10**12 + 50_000_000]
    same(recording.imus["imu0"].accelerometer, T, FORCE, "m/s^2")
    same(imu_of(mars / "gyro_accel.csv").gyroscope, T, RATE, "rad/s")


def test_opencamera_sensors(tmp_path):
    """Two tables without header, x, y, z, timestamp, called after the video."""
    for name, values in (("accel", FORCE), ("gyro", RATE)):
        rows = [(*row, str(5 * 10**12 + round(1e9 * t))) for t, row in zip(T, values, strict=True)]
        first, *rest = rows
        table(tmp_path / f"VID_20231028_135224{name}.csv", ",".join(map(str, first)), rest)
    same(imu_of(tmp_path).accelerometer, T, FORCE, "m/s^2", 1e-5)
    write_video(tmp_path / "VID_20231028_135224.mp4", count=20, codec="mpeg4", pixels="yuv420p")
    same(open_images(tmp_path / "VID_20231028_135224.mp4").imus["imu0"].gyroscope, T, RATE, "rad/s", 1e-5)


# ---- zips ----


def test_a_zip_of_something_else(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("notes.txt", "nothing to see\n")
    refused(tmp_path / "a.zip", "neither those of Sensor Logger nor of phyphox", "Unpack it")


def test_a_zip_without_tables(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("accelerometer.json", "[]")
    refused(tmp_path / "a.zip", "holds no table (accelerometer.json)", "as CSV")


def test_a_zip_of_several_recordings(android, tmp_path):
    path = tmp_path / "both.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for folder in ("one", "two"):
            for file in sorted(android.iterdir()):
                archive.write(file, f"{folder}/{file.name}")
    refused(path, "several recordings", "one/Metadata.csv, two/Metadata.csv")


def test_a_zip_that_swells_is_refused(android, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MUCH_BYTES", 10_000)
    monkeypatch.setattr(files, "MOST_TIMES", 1)
    refused(zipped(android, tmp_path / "a.zip"), "would be unpacked to more than")


def test_a_zip_with_paths_that_lead_out_of_it(android, tmp_path):
    """Nothing is unpacked onto the disk, so paths lead nowhere."""
    path = zipped(android, tmp_path / "a.zip", "../../../../tmp/gnomon-escape/")
    before = sorted(tmp_path.rglob("*"))
    same(imu_of(path).gyroscope, T, RATE + 0.02, "rad/s")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("keep", [0.3, 0.9, 0.999])
def test_a_zip_that_is_cut_off(android, tmp_path, keep):
    data = zipped(android, tmp_path / "whole.zip").read_bytes()
    (tmp_path / "a.zip").write_bytes(data[: int(keep * len(data))])
    refused(tmp_path / "a.zip", "cut off or damaged")


def test_a_zip_with_damage_inside(android, tmp_path):
    data = bytearray(zipped(android, tmp_path / "whole.zip").read_bytes())
    with zipfile.ZipFile(tmp_path / "whole.zip") as archive:
        place = archive.getinfo("AccelerometerUncalibrated.csv").header_offset
    data[place + 200 : place + 260] = bytes(60)
    (tmp_path / "a.zip").write_bytes(data)
    refused(tmp_path / "a.zip", "AccelerometerUncalibrated.csv", "damaged")


def test_an_npz_is_no_phone(tmp_path):
    np.savez(tmp_path / "a.npz", accelerometer=FORCE, t_s=T)
    assert not is_device_log((tmp_path / "a.npz",))
    same(imu_of(tmp_path / "a.npz").accelerometer, T, FORCE, "m/s^2")
