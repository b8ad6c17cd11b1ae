"""Logs of the field are read without options, or with the option that the message proposes.

Each format is written here as its public documentation or code writes it (the source stands beside it), of one motion;
what is read must be that motion, in its units and with its timestamps.
"""

import re
import zipfile

import numpy as np
import pytest

import bag_maker
import field_devices
import field_logs
from field_logs import COUNT, STEP_S, clock, lines, numbers
from gnomon import read
from gnomon.errors import RecordingError
from gnomon.readers.images.image_recording import holds_images
from gnomon.readers.samples.stream import open_stream
from gnomon.units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from phone_logs import G

TRUTH = field_logs.samples()
T, F, W, M = TRUTH.t, TRUTH.force, TRUTH.rate, TRUTH.field
A, D = F / G, np.degrees(W)
AC, GC = TRUTH.counts


def _i(*rows, form="%d", separator=","):
    return numbers(*rows, form=form, separator=separator)


def rowberg(path):  # github.com/jrowberg/i2cdevlib, Arduino/MPU6050/examples/MPU6050_raw
    head = ("Initializing I2C devices...", "Testing device connections...", "MPU6050 connection successful")
    return lines(path, lambda i: f"a/g:\t{_i(AC[i], GC[i], separator=chr(9))}", *head)


def playground(path):  # playground.arduino.cc/Main/MPU-6050, the short example
    def line(i):
        (ax, ay, az), (gx, gy, gz) = AC[i], GC[i]
        return f"AcX = {ax} | AcY = {ay} | AcZ = {az} | Tmp = 24.53 | GyX = {gx} | GyY = {gy} | GyZ = {gz}"

    return lines(path, line)


def adafruit_mpu6050(path):  # github.com/adafruit/Adafruit_MPU6050, examples/basic_readings
    def line(i):
        (ax, ay, az), (gx, gy, gz) = F[i], W[i]
        return (
            f"Acceleration X: {ax:.3f}, Y: {ay:.3f}, Z: {az:.3f} m/s^2\n"
            f"Rotation X: {gx:.4f}, Y: {gy:.4f}, Z: {gz:.4f} rad/s\nTemperature: 27.55 degC\n"
        )

    return lines(path, line, "Adafruit MPU6050 test!", "MPU6050 Found!", "Accelerometer range set to: +-8G", "")


def adafruit_lsm6ds(path):  # github.com/adafruit/Adafruit_LSM6DS, examples/adafruit_lsm6dsox_test
    def line(i):
        (ax, ay, az), (gx, gy, gz) = F[i], W[i]
        return (
            f"\t\tTemperature 24.50 deg C\n\t\tAccel X: {ax:.3f} \tY: {ay:.3f} \tZ: {az:.3f} m/s^2 \n"
            f"\t\tGyro X: {gx:.4f} \tY: {gy:.4f} \tZ: {gz:.4f} radians/s \n"
        )

    return lines(path, line, "Adafruit LSM6DSOX test!", "LSM6DSOX Found!")


def sparkfun_icm20948(path):  # github.com/sparkfun/SparkFun_ICM-20948_ArduinoLibrary, Example1_Basics
    def line(i):
        a, g, m = (", ".join(f"{x:09.3f}" for x in v) for v in (1e3 * A[i], D[i], M[i]))
        return f"Scaled. Acc (mg) [ {a} ], Gyr (DPS) [ {g} ], Mag (uT) [ {m} ], Tmp (C) [ 00023.40 ]"

    return lines(path, line, "Initialization of the sensor returned: All is well.")


def arduino_monitor(path):  # support.arduino.cc, "Show timestamp" of the IDE's serial monitor
    return lines(path, lambda i: f"{clock(T[i])} -> {numbers(F[i], W[i])}")


def over_midnight(path):  # the same, over midnight
    return lines(path, lambda i: f"{clock(T[i] + 3590, 23).replace('24:', '00:')} -> {numbers(F[i], W[i])}")


def monitor_and_millis(path):  # a sketch with its own clock, copied out of the serial monitor
    return lines(path, lambda i: f"{clock(T[i])} -> {1e3 * T[i]:.0f},{numbers(F[i], W[i])},25.1",
                 f"{clock(0)} -> millis,ax,ay,az,gx,gy,gz,temp")  # fmt: skip


def name_value(path):  # forum.arduino.cc: name=value lines, time last
    def line(i):
        pairs = zip(("ax", "ay", "az", "gx", "gy", "gz"), (*F[i], *W[i]), strict=True)
        return " ".join(f"{name}={value:.6f}" for name, value in pairs) + f" t={1e6 * T[i]:.0f}"

    return lines(path, line)


def serial_plotter(path):  # docs.arduino.cc, serial plotter: "label:value,label:value"
    def line(i):
        pairs = zip(("accX", "accY", "accZ", "gyroX", "gyroY", "gyroZ"), (*A[i], *D[i]), strict=True)
        return f"Time_us:{1e6 * T[i]:.0f}," + ",".join(f"{name}:{value:.5f}" for name, value in pairs)

    return lines(path, line)


def micros_wraps(path):  # docs.arduino.cc, micros(): back to zero after some 70 minutes
    return lines(path, lambda i: f"{(2**32 - 5_000_000 + round(1e6 * T[i])) % 2**32},{numbers(F[i], W[i])}",
                 "micros,ax,ay,az,gx,gy,gz")  # fmt: skip


def esp_idf(path):  # docs.espressif.com, ESP-IDF logging library: "I (milliseconds) tag: text"
    def line(i):
        names = ("acce_x", "acce_y", "acce_z", "gyro_x", "gyro_y", "gyro_z")
        pairs = zip(names, (*A[i], *D[i]), strict=True)
        return f"I ({1e3 * T[i] + 321:.0f}) mpu6050 test: " + ", ".join(f"{name}:{value:.5f}" for name, value in pairs)

    return lines(path, line)


def json_lines(path):  # jsonlines.org; MQTT and web loggers of ESP32
    def line(i):
        a, w = (", ".join(f"{x:.6f}" for x in v) for v in (F[i], W[i]))
        return f'{{"t_us": {1e6 * T[i]:.0f}, "acc": [{a}], "gyro": [{w}], "temp": 24.1}}'

    return lines(path, line)


def witmotion(path):  # wit-motion.com, WT901 user manual: the text that its software records
    def line(i):
        stamp = f"2023-03-23 {clock(T[i])}"
        return f"{stamp}\t{stamp}\t{numbers(A[i], D[i], separator=chr(9))}\t35.2"

    names = [*(f"a{x}(g)" for x in "xyz"), *(f"w{x}(deg/s)" for x in "xyz")]
    return lines(path, line, "\t".join(["Time(s)", "ChipTime", *names, "T(°)"]))


def vectornav(path):  # vectornav.com, UM001: $VNIMU, magnetometer, accelerometer, gyroscope, temperature, pressure
    def line(i):
        body = f"VNIMU,{numbers(M[i] / 100, F[i], W[i], form='%+.4f')},+20.1,+101.3"
        return f"${body}*{np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)):02X}"

    return lines(path, line)


def razor(path):  # github.com/Razor-AHRS/razor-9dof-ahrs, output mode #osrt
    def line(i):
        a, m, g = (",".join(f"{x:.2f}" for x in v) for v in (AC[i], M[i], GC[i]))
        return f"#A-R={a}\n#M-R={m}\n#G-R={g}"

    return lines(path, line)


def st_mems_studio(path):  # st.com, UM3233: MEMS Studio's and Unicleo's text
    names = [*(f"A_{x} [mg]" for x in "XYZ"), *(f"G_{x} [dps]" for x in "XYZ")]
    return lines(path, lambda i: f"{1e6 * T[i]:.0f}\t{numbers(1e3 * A[i], D[i], separator=chr(9))}",
                 "\t".join(["timestamp[us]", *names]))  # fmt: skip


def x_io(path):  # x-io.co.uk, x-IMU3 user manual: Inertial.csv
    names = [*(f"Gyroscope {x} (deg/s)" for x in "XYZ"), *(f"Accelerometer {x} (g)" for x in "XYZ")]
    return lines(path, lambda i: f"{1e6 * T[i]:.0f},{numbers(D[i], A[i])}", ",".join(["Timestamp (us)", *names]))


def xsens_mt_manager(path):  # mtidocs.movella.com, export of MT Manager: comments, tabs, PacketCounter
    names = [*(f"Acc_{x}" for x in "XYZ"), *(f"Gyr_{x}" for x in "XYZ")]
    head = ("// General information:", "//  MT Manager version: 2021.0", "// Update Rate: 50.0Hz")
    return lines(path, lambda i: f"{i:05d}\t{round(T[i] * 1e4)}\t{numbers(F[i], W[i], separator=chr(9))}",
                 *head, "\t".join(["PacketCounter", "SampleTimeFine", *names]))  # fmt: skip


def european(path):  # semicolons and decimal commas, as spreadsheets in Europe save
    return lines(path, lambda i: numbers(T[i], F[i], W[i], separator=";").replace(".", ","),
                 "Zeit;acc_x (m/s²);acc_y;acc_z;gyro_x (rad/s);gyro_y;gyro_z".replace("Zeit", "Time (s)"))  # fmt: skip


def ros_echo(path):  # wiki.ros.org/rostopic: rostopic echo -p
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += [f"field.angular_velocity.{x}" for x in "xyz"] + [f"field.linear_acceleration.{x}" for x in "xyz"]

    def line(i):
        ns = 1_600_000_000_000_000_000 + round(T[i] * 1e9)
        return f"{ns + 300},{i},{ns},imu_link,{numbers(W[i], F[i])}"

    return lines(path, line, ",".join(names))


def realsense(path):  # github.com/realsenseai/librealsense: an IMU logged through pyrealsense2, stamps in ms
    return lines(path, lambda i: f"{1.6e12 + 1e3 * T[i]:.3f},{numbers(F[i], W[i])}",
                 "timestamp_ms,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z")  # fmt: skip


def betaflight(path):  # github.com/betaflight/blackbox-log-viewer: CSV of blackbox_decode, units of gyro and acc stated
    names = ["loopIteration", "time (us)", *(f"gyroADC[{i}] (deg/s)" for i in range(3))]
    names += [*(f"accSmooth[{i}] (g)" for i in range(3)), "motor[0]"]
    return lines(path, lambda i: f"{i},{1e6 * T[i]:.0f},{numbers(D[i], A[i])},1000", ",".join(names))


def fourteen_columns(path):  # experience of users: a table without names, with more than two triads
    return lines(path, lambda i: f"{i},{1e3 * T[i]:.0f},{numbers(F[i], W[i])},24.1,101325,0,0,1,7")


def gyroscope_first(path):  # nine columns without time in front and gravity along x
    return lines(path, lambda i: f"1,{numbers(D[i], A[i][[2, 0, 1]])},33.3,{T[i]:.3f}")


def tx_ty_tz(path):  # names that nobody knows
    return lines(path, lambda i: f"{numbers(T[i], F[i], W[i])}", "time tx ty tz wx wy wz".replace(" ", ","))


def ulog(path):  # docs.px4.io/main/en/dev_log/ulog_file_format.html
    return field_logs.ulog(path, TRUTH)


def dataflash(path):  # ardupilot.org/copter/docs/logmessages.html; ArduPilot/libraries/AP_Logger/LogStructure.h
    return field_logs.dataflash(path, TRUTH)


def dataflash_text(path):  # ardupilot.org, downloading and analysing data logs: .log
    return field_logs.dataflash_text(path, TRUTH)


def mat(path):  # mathworks.com, MAT-file versions: arrays of a workspace
    from scipy.io import savemat

    savemat(path, {"t": T, "acc": F, "gyro": W, "note": "on the bench"})
    return path


def mat_struct(path):  # a struct with a rate, arrays lying
    from scipy.io import savemat

    savemat(path, {"imu": {"accel_g": A.T, "gyro_dps": D.T}, "Fs": 1 / STEP_S})
    return path


WITHOUT_OPTIONS = [
    arduino_monitor, over_midnight, monitor_and_millis, name_value, serial_plotter, micros_wraps, esp_idf, json_lines,
    witmotion, st_mems_studio, x_io, xsens_mt_manager, european, ros_echo, realsense, betaflight, ulog, dataflash,
    dataflash_text, mat, mat_struct, *field_devices.WITHOUT_OPTIONS,
]  # fmt: skip
WITH_A_RATE = [
    rowberg, playground, adafruit_mpu6050, adafruit_lsm6ds, sparkfun_icm20948, vectornav, razor,
    *field_devices.WITH_A_RATE,
]  # fmt: skip
WITH_COLUMNS = [fourteen_columns, gyroscope_first, tx_ty_tz, *field_devices.WITH_COLUMNS]


def _check(recording, turned=False):
    samples = recording.imus["imu0"]
    accel, gyro = samples.accelerometer, samples.gyroscope
    force = F[:, [2, 0, 1]] if turned else F
    assert len(accel) == len(gyro) == COUNT
    assert np.diff(accel.t_ns) == pytest.approx(STEP_S * 1e9, abs=1.1e6)
    per_m_s2 = ACCELEROMETER_UNITS_M_S2[accel.unit] or G / 16384
    per_rad_s = GYROSCOPE_UNITS_RAD_S[gyro.unit] or np.radians(1 / 131)
    np.testing.assert_allclose(accel.values * per_m_s2, force, atol=2e-3)
    np.testing.assert_allclose(gyro.values * per_rad_s, W, atol=1e-3)
    if samples.magnetometer is not None and samples.magnetometer.unit != "count":
        scale = {"uT": 1.0, "gauss": 100.0, "mgauss": 0.1}[samples.magnetometer.unit]
        np.testing.assert_allclose(samples.magnetometer.values * scale, M, atol=0.06)


@pytest.mark.parametrize("write", WITHOUT_OPTIONS, ids=lambda write: write.__name__)
def test_read_without_options(write, tmp_path) -> None:
    paths = write(tmp_path / "log.txt")
    assert isinstance(paths, list) or not holds_images(paths), "gnomon check would look for a video"
    _check(read(*paths) if isinstance(paths, list) else read(paths))


@pytest.mark.parametrize("write", WITH_A_RATE, ids=lambda write: write.__name__)
def test_read_with_the_rate_that_is_asked_for(write, tmp_path) -> None:
    path = write(tmp_path / "log.txt")
    with pytest.raises(RecordingError, match="--rate"):
        read(path)
    _check(read(path, rate_hz=1 / STEP_S))


@pytest.mark.parametrize("write", WITH_COLUMNS, ids=lambda write: write.__name__)
def test_read_with_the_columns_that_the_message_proposes(write, tmp_path) -> None:
    path = write(tmp_path / "log.txt")
    with pytest.raises(RecordingError, match="rises") as error:
        read(path)
    proposed = re.search(r'try --columns "([^"]*)"', str(error.value))
    assert proposed is not None
    _check(read(path, columns=proposed[1]), turned=write is gyroscope_first)


def test_rows_that_are_numbered_are_not_timed(tmp_path) -> None:
    path = lines(tmp_path / "log.txt", lambda i: f"{i},{_i(AC[i], GC[i])}")
    with pytest.raises(RecordingError, match=r"--rate 100: .* Column 1 goes up by one"):
        read(path)
    _check(read(path, rate_hz=1 / STEP_S))


def test_a_time_of_an_unknown_name_is_asked_for(tmp_path) -> None:
    path = lines(tmp_path / "log.txt", lambda i: f"{T[i]:.3f},{_i(A[i], D[i], form='%.6f')}", "Zeit,ax,ay,az,gx,gy,gz")
    with pytest.raises(RecordingError, match=r"Column 1 \(Zeit\) rises") as error:
        read(path)
    proposed = re.search(r'state --columns "([^"]*)"', str(error.value))
    assert proposed is not None
    _check(read(path, columns=proposed[1]))


def test_a_thermometer_between_the_triads_is_left_out(tmp_path) -> None:
    path = lines(tmp_path / "log.txt", lambda i: f"{_i(AC[i])},{-3200 + i % 7},{_i(GC[i])}")
    with pytest.raises(RecordingError, match=r'try --columns "ax ay az _ gx gy gz" with --rate HZ'):
        read(path)
    _check(read(path, columns="ax ay az _ gx gy gz", rate_hz=1 / STEP_S))


def test_counts_at_rest_tell_the_accelerometer(tmp_path) -> None:
    rng = np.random.default_rng(5)
    still = [tuple(np.rint(rng.normal((-40, 25, 60, 300, -8000, 1400), 8)).astype(int)) for _ in range(COUNT)]
    path = lines(tmp_path / "log.txt", lambda i: f"{10_000 * i},{_i(still[i])}")
    imu = read(path).imus["imu0"]
    assert abs(float(np.linalg.norm(imu.accelerometer.values.mean(axis=0))) - 8130) < 20


BY_BLOCKS = [adafruit_mpu6050, over_midnight, witmotion, micros_wraps, rowberg, mat]
BY_BLOCKS += [field_devices.ros2_echo, field_devices.movella_dot, field_devices.micropython, field_devices.gnss_logger]


@pytest.mark.parametrize("write", BY_BLOCKS, ids=lambda write: write.__name__)
def test_block_by_block_is_the_same(write, tmp_path) -> None:
    path = write(tmp_path / "log.txt")
    rate = 1 / STEP_S if write in WITH_A_RATE else None
    samples = read(path, rate_hz=rate).imus["imu0"]
    stream = open_stream(path, expected=Units.parse("si"), rate_hz=rate, block_bytes=1000)
    blocks = list(stream.accelerometer)
    np.testing.assert_array_equal(np.concatenate([block.values for block in blocks]), samples.accelerometer.values)
    np.testing.assert_array_equal(np.concatenate([block.t_ns for block in blocks]), samples.accelerometer.t_ns)


@pytest.mark.parametrize("form", ["ros1", "ros2", "mcap"])
def test_an_imu_is_read_from_a_bag_without_looking_at_its_cameras(form, tmp_path) -> None:
    stamps = bag_maker.T0 + np.rint(T * 1e9).astype(np.int64)
    messages = [
        bag_maker.imu("/imu/data_raw", int(ns), gyro=tuple(w), accel=tuple(f))
        for ns, w, f in zip(stamps, W, F, strict=True)
    ]
    pictures = [bag_maker.image(f"/camera{side}", bag_maker.T0, np.zeros((4, 4), np.uint8)) for side in "ab"]
    _check(read(bag_maker.make_bag(tmp_path, form, [*messages, *pictures])))


def test_a_bag_of_an_imu_alone_is_told_from_one_with_images(tmp_path) -> None:
    from gnomon.readers.bags.bag import bag_holds_only_imu

    samples = bag_maker.usual(images=0)
    assert bag_holds_only_imu(bag_maker.make_bag(tmp_path, "ros2", samples, name="alone"))
    assert not bag_holds_only_imu(bag_maker.make_bag(tmp_path, "ros2", bag_maker.usual(), name="rig"))


def test_commas_between_columns_and_in_numbers_are_told(tmp_path) -> None:
    rows = lambda i: numbers(T[i], F[i], W[i]).replace(".", ",")  # noqa: E731
    path = lines(tmp_path / "log.csv", rows, "t,ax,ay,az,gx,gy,gz")
    with pytest.raises(RecordingError, match="Above them stand 7 names: are commas decimal points"):
        read(path)


def test_a_workbook_and_a_blackbox_are_told(tmp_path) -> None:
    with zipfile.ZipFile(tmp_path / "log.xlsx", "w") as book:
        book.writestr("xl/workbook.xml", "<w/>")
    (tmp_path / "flight.bbl").write_bytes(b"H Product:Blackbox flight data recorder\n\x00\x01" + bytes(900))
    with pytest.raises(RecordingError, match=r"workbook of a spreadsheet program\. Export"):
        read(tmp_path / "log.xlsx")
    with pytest.raises(RecordingError, match="blackbox_decode"):
        read(tmp_path / "flight.bbl")


def test_letters_in_a_column_are_no_sensors(tmp_path) -> None:
    mode = "AG"
    path = lines(
        tmp_path / "log.csv", lambda i: f"{mode[i % 2]},{numbers(T[i], F[i], W[i])}", "mode,t,ax,ay,az,gx,gy,gz"
    )
    _check(read(path))
    _check(read(path, columns="_ t ax ay az gx gy gz"))
