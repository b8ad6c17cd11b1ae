"""Logs of more devices, written as their public documentation or code writes them; see test_field_formats."""

import zlib

import numpy as np

import field_logs
from field_logs import clock, lines, numbers
from phone_logs import G

TRUTH = field_logs.samples()
T, F, W, M = TRUTH.t, TRUTH.force, TRUTH.rate, TRUTH.field
A, D = F / G, np.degrees(W)
AC, GC = TRUTH.counts
MS, US, NS = (np.rint(factor * T).astype(np.int64) for factor in (1e3, 1e6, 1e9))


def _xyz(values, form, between=" "):
    return between.join(f"{axis}{value:{form}}" for axis, value in zip(("X: ", "Y: ", "Z: "), values, strict=True))


def _pair(path, names, header, line):
    """Write two tables, of accelerometer and gyroscope."""
    paths = [path.with_name(name) for name in names]
    for file, title in zip(paths, header, strict=True):
        lines(file, lambda i, file=file: line(i, (F if file == paths[0] else W)[i]), title)
    return paths


def movella_dot(path):  # base.movella.com, DOT app: CSV of the recording export; SampleTimeFine in us
    names = "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z,"
    head = ("sep=,", "DeviceTag:,DOT 1", "FirmwareVersion:,2.0.0", "OutputRate:,60Hz", "StartTime:,2021-09-16_12:34:56")
    return lines(path, lambda i: f"{i},{4_000_000_000 + US[i]},{numbers(0 * F[i], F[i], D[i])},", *head, "", names)


def shimmer(path):  # shimmersensing.com, Consensys: names above units, tabs
    names = ["Timestamp_Unix_CAL", *(f"Accel_LN_{x}_CAL" for x in "XYZ"), *(f"Gyro_{x}_CAL" for x in "XYZ")]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]
    tabs = "\t".join
    return lines(
        path, lambda i: tabs([f"{1.6e12 + 1e3 * T[i]:.3f}", numbers(F[i], D[i], separator="\t")]) + "\t",
        '"sep=\t"', tabs(f"Shimmer_C4FA_{name}" for name in names) + "\t", tabs(units) + "\t")  # fmt: skip


def gnss_logger(path):  # github.com/google/gps-measurement-tools: rows say their sensor, comments name the columns
    def columns(sensor, unit, bias):
        axes = ",".join(f"Uncal{sensor}{x}{unit}" for x in "XYZ")
        return f"# Uncal{sensor},utcTimeMillis,elapsedRealtimeNanos,{axes}," + ",".join(
            f"{bias}{x}{unit}" for x in "XYZ"
        )

    def line(i):
        stamp = f"{1_600_000_000_000 + MS[i]},{5_000_000_000_000 + NS[i]}"
        rows = (("Accel", F), ("Gyro", W), ("Mag", M))
        return (
            "\n".join(f"Uncal{sensor},{stamp},{numbers(v[i])},0.0,0.0,0.0" for sensor, v in rows) + f"\nRaw,{stamp},18"
        )

    head = (
        "# Version: v3.0.0.1 Platform: 11",
        "# Raw,utcTimeMillis,TimeNanos,LeapSecond",
        columns("Accel", "Mps2", "Bias"),
    )
    return lines(path, line, *head, columns("Gyro", "RadPerSec", "Drift"), columns("Mag", "MicroT", "Bias"), "# ")


def rs_convert(path):  # github.com/IntelRealSense/librealsense, tools/convert/converters/converter-csv.cpp
    head = "\n\nStream Type,F#,HW Timestamp (ms),Backend Timestamp(ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z"
    stamps = [f"{1.6e12 + 1e3 * t:.3f}" for t in T]
    blocks = [[f"{name},{i},{t},{t},{t},{numbers(v[i], form='%.4f')}" for i, t in enumerate(stamps)]
              for name, v in (("Gyro", W), ("Accel", F))]  # fmt: skip
    path.write_text("\n".join([head, *blocks[0], head, *blocks[1]]) + "\n")
    return path


def long_table(path):  # a row for each sensor and sample, as Android's sensor events are often written
    line = lambda i: f"{MS[i]},accel_g,{numbers(A[i])}\n{MS[i]},gyro_dps,{numbers(D[i])}"  # noqa: E731
    return lines(path, line, "epoch_ms,sensor,x,y,z")


def gopro_telemetry(path):  # github.com/JuanIrache/gopro-telemetry, CSV of the telemetry extractor
    header = [f'"cts","date","{name} (z) [{unit}]","{name} (x) [{unit}]","{name} (y) [{unit}]","temperature [°C]"'
              for name, unit in (("Accelerometer", "m/s2"), ("Gyroscope", "rad/s"))]  # fmt: skip
    return _pair(path, ("GH01-ACCL.csv", "GH01-GYRO.csv"), header,
                 lambda i, v: f"{1e3 * T[i]:.3f},2019-01-01T{clock(T[i])}Z,{numbers(v[[2, 0, 1]])},45.1")  # fmt: skip


def matlab_mobile(path):  # mathworks.com, writetimetable of Acceleration and AngularVelocity
    return _pair(path, ("Acceleration.csv", "AngularVelocity.csv"), ["Timestamp,X,Y,Z"] * 2,
                 lambda i, v: f"19-Oct-2023 {clock(T[i])},{numbers(v)}")  # fmt: skip


def sensor_kinetics(path):  # rotoview.com, Sensor Kinetics: a file for each sensor
    return _pair(path, ("accm.csv", "gyrm.csv"), ["time,X_value,Y_value,Z_value"] * 2,
                 lambda i, v: f"{T[i]:.4f},{numbers(v)}")  # fmt: skip


def px4_csv(path):  # github.com/PX4/pyulog, ulog2csv: a file for each topic
    names = "timestamp,timestamp_sample,device_id,x,y,z,temperature,error_count,clip_counter[0],samples"
    return _pair(path, ("log_sensor_accel_0.csv", "log_sensor_gyro_0.csv"), [names] * 2,
                 lambda i, v: f"{5_000_000 + US[i]},{5_000_000 + US[i]},1310988,{numbers(v)},45.1,0,0,8")  # fmt: skip


def gyroflow(path):  # docs.gyroflow.xyz, .gcsv: scales above the table
    head = ("GYROFLOW IMU LOG", "version,1.3", "id,custom_logger_name", "orientation,YxZ", "timestamp,1644159993",
            "tscale,0.001", "gscale,0.00013323124", "ascale,0.00006103516", "t,gx,gy,gz,ax,ay,az")  # fmt: skip
    return lines(path, lambda i: f"{MS[i]},{numbers(GC[i], AC[i], form='%d')}", *head)


def sense_hat(path):  # projects.raspberrypi.org, Sense HAT data logger
    names = "temp_h,temp_p,humidity,pressure,pitch,roll,yaw,mag_x,mag_y,mag_z,accel_x,accel_y,accel_z,"
    return lines(path, lambda i: f"31,30,40,1013,1,2,3,{numbers(M[i], A[i], W[i])},2018-05-01 12:34:{T[i]:09.6f}",
                 names + "gyro_x,gyro_y,gyro_z,timestamp")  # fmt: skip


def microstrain(path):  # microstrain.com, MIP Monitor's CSV: the time is that of the week
    names = ",".join(f"{x} {name}" for name in ("Accel [x8004]", "Gyro [x8005]") for x in "XYZ")
    return lines(path, lambda i: f"6,2105,{420_000 + T[i]:.4f},{numbers(A[i], W[i])}",
                 "Device Name: 3DM-GX5-25", "DATA_START", f"GPS TFlags,GPS Week,GPS TOW,{names}")  # fmt: skip


def openlog_artemis(path):  # github.com/sparkfun/OpenLog_Artemis: date and clock in two columns
    return lines(path, lambda i: f"01/02/2020,{clock(T[i])},{numbers(1e3 * A[i], D[i], M[i])},25.13,50.1,",
                 "rtcDate,rtcTime,aX,aY,aZ,gX,gY,gZ,mX,mY,mZ,imu_degC,output_Hz,")  # fmt: skip


def ros2_echo_csv(path):  # docs.ros.org, ros2 topic echo --csv of sensor_msgs/Imu
    zeros = ",".join(["0.0"] * 9)
    return lines(path, lambda i: f"{1_600_000_000 + NS[i] // 10**9},{NS[i] % 10**9},imu_link,0.0,0.0,0.0,1.0,{zeros},"
                                 f"{numbers(W[i])},{zeros},{numbers(F[i])},{zeros}")  # fmt: skip


def ros2_echo(path):  # docs.ros.org, ros2 topic echo of sensor_msgs/Imu
    def vector(name, values):
        body = "".join(f"  {axis}: {value:.6f}\n" for axis, value in zip("xyz", values, strict=False))
        return f"{name}:\n{body}{name}_covariance:\n" + "- 0.0\n" * 9

    def line(i):
        stamp = f"    sec: {1_600_000_000 + NS[i] // 10**9}\n    nanosec: {NS[i] % 10**9}\n"
        head = f"header:\n  stamp:\n{stamp}  frame_id: imu_link\n"
        return (
            head
            + vector("orientation", (0, 0, 0))
            + vector("angular_velocity", W[i])
            + vector("linear_acceleration", F[i])
            + "---"
        )

    return lines(path, line)


def micropython(path):  # docs.micropython.org, time.ticks_us(): back to zero at 2^30
    return lines(path, lambda i: f"{(2**30 - 5_000_000 + US[i]) % 2**30},{numbers(F[i], W[i])}",
                 "ticks_us,ax,ay,az,gx,gy,gz")  # fmt: skip


def uzh_fpv(path):  # fpv.ifi.uzh.ch: imu.txt
    return lines(path, lambda i: f"{i} {1.54e9 + T[i]:.6f} {numbers(W[i], F[i], separator=' ')}",
                 "# id timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z")  # fmt: skip


def sensor_log(path):  # github.com/berndthomas/SensorLog: filtered rates beside those of the gyroscope; some columns
    names = ["loggingTime(txt)", "loggingSample(N)", "accelerometerTimestamp_sinceReboot(s)"]
    names += [f"accelerometerAcceleration{x}(G)" for x in "XYZ"] + [f"motionRotationRate{x}(rad/s)" for x in "XYZ"]
    names += [f"motionUserAcceleration{x}(G)" for x in "XYZ"] + [f"gyroRotation{x}(rad/s)" for x in "XYZ"]
    return lines(path, lambda i: f"2017-01-19 {clock(T[i])} +0100,{i},{62608 + T[i]:.6f},"
                                 f"{numbers(A[i], W[i] + 0.1, 0 * A[i], W[i])}", ",".join(names))  # fmt: skip


def mpu6050_light(path):  # github.com/rfetick/MPU6050_light, examples/GetAllData
    def line(i):
        return (f"TEMPERATURE: 25.41\nACCELERO  {_xyz(A[i], '.4f', chr(9))}\nGYRO      {_xyz(D[i], '.3f', chr(9))}\n"
                f"ACC ANGLE X: 0.51\tY: -0.40\nANGLE     X: 0.50\tY: -0.38\tZ: 0.01\n{'=' * 53}\n")  # fmt: skip

    return lines(path, line, "MPU6050 status: 0", "Calculating offsets, do not move MPU6050", "Done!")


def mpu6050_tockn(path):  # github.com/tockn/MPU6050_tockn, examples/GetAllData
    def line(i):
        acc = "\t".join(f"acc{x} : {v:.4f}" for x, v in zip("XYZ", A[i], strict=True))
        gyro = "\t".join(f"gyro{x} : {v:.3f}" for x, v in zip("XYZ", D[i], strict=True))
        angles = "accAngleX : 0.51\taccAngleY : -0.4\ngyroAngleX : 0.1\tgyroAngleY : 0.2\tgyroAngleZ : 0.3"
        return (
            f"{'=' * 55}\ntemp : 25.41\n{acc}\n{gyro}\n{angles}\nangleX : 0.1\tangleY : 0.2\tangleZ : 0.3\n{'=' * 55}\n"
        )

    return lines(path, line)


def adafruit_lsm9ds1(path):  # github.com/adafruit/Adafruit_LSM9DS1: a unit behind each value
    def triad(name, values, unit):
        return f"{name} " + "\t".join(f"{x}: {v:.4f} {unit}" for x, v in zip("XYZ", values, strict=True))

    return lines(path, lambda i: "\n".join((triad("Accel", F[i], "m/s^2 "), triad("Mag", M[i], "uT"),
                                            triad("Gyro", W[i], "rad/s"), "")), "LSM9DS1 data read demo")  # fmt: skip


def sparkfun_lsm9ds1(path):  # github.com/sparkfun/SparkFun_LSM9DS1_Arduino_Library, LSM9DS1_Basic_I2C
    def line(i):
        g, a, m = (numbers(v, form="%.4f", separator=", ") for v in (D[i], A[i], M[i] / 100))
        return f"G: {g} deg/s\nA: {a} g\nM: {m} gauss\n\nPitch, Roll: 1.20, -0.30\nHeading: 12.30\n"

    return lines(path, line)


def sparkfun_mpu9250(path):  # github.com/sparkfun/SparkFun_MPU-9250_Breakout, MPU9250BasicAHRS
    def triad(name, values, unit):
        return "  ".join(f"{name}{x} = {v:.3f}" for x, v in zip("xyz", values, strict=True)) + f"  {unit}\n"

    return lines(path, lambda i: triad("a", 1e3 * A[i], "mg") + triad("g", D[i], "deg/s") + triad("m", 10 * M[i], "mG")
                 + "q0 = 1.0 qx = 0.0 qy = 0.0 qz = 0.0\nYaw, Pitch, Roll: 12.1, 1.2, 2.3\nrate = 0.1 Hz")  # fmt: skip


def electronicwings(path):  # electronicwings.com, MPU6050 with Raspberry Pi
    def triad(name, values, unit):
        return " \t".join(f"{name}{x}={v:.4f} {unit}" for x, v in zip("xyz", values, strict=True))

    return lines(path, lambda i: f"{triad('G', D[i], '°/s')} \t{triad('A', A[i], 'g')}", " Reading Data of Gyroscope")


def circuitpython(path):  # github.com/adafruit/Adafruit_CircuitPython_LSM6DS and _MPU6050, simpletest
    return lines(path, lambda i: f"Acceleration: {_xyz(F[i], '.3f', ', ')} m/s^2\n"
                                 f"Gyro {_xyz(D[i], '.3f', ', ')} degrees/s\nTemperature: 24.20 C\n")  # fmt: skip


def python_dicts(path):  # pypi.org/project/mpu6050-raspberrypi: print(get_accel_data(), get_gyro_data())
    line = lambda i: " ".join(str(dict(zip("xyz", map(float, v[i]), strict=True))) for v in (F, D))  # noqa: E731
    return lines(path, line)


def mu_plotter(path):  # codewith.mu, plotter: print((ax, ay, az, gx, gy, gz))
    return lines(path, lambda i: f"({numbers(F[i], W[i], separator=', ')})")


def motioncal(path):  # pjrc.com, MotionCal: "Raw:" and nine counts
    return lines(path, lambda i: f"Raw:{numbers(AC[i], GC[i], 10 * M[i], form='%d')}")


def bno055(path):  # github.com/adafruit/Adafruit_BNO055, sensorapi: tabs between name, axis and bar
    def triad(name, values):
        return f"{name}:\t" + " |\t".join(f"{x}= {v:.4f}" for x, v in zip("xyz", values, strict=True))

    return lines(path, lambda i: f"{triad('Accl', F[i])}\n{triad('Gyro', W[i])}\n--")


def bmi270(path):  # github.com/boschsensortec/BMI270_SensorAPI, examples/accel_gyro: counts beside units
    names = [f"{name}_{x}" for name in ("Acc_Raw", "Acc_ms2", "Gyr_Raw", "Gyro_DPS") for x in "XYZ"]
    return lines(path, lambda i: f"{i}, 2, {numbers(AC[i], form='%d', separator=', ')}, "
                                 f"{numbers(F[i], separator=', ')}, {numbers(GC[i], form='%d', separator=', ')}, "
                                 f"{numbers(D[i], separator=', ')}",
                 ", ".join(["Data set", "Accel Range", *names]))  # fmt: skip


def razor_m0(path):  # github.com/sparkfun/9DOF_Razor_IMU: milliseconds, then nine values without names
    return lines(path, lambda i: f"{3000 + MS[i]}, {numbers(A[i], D[i], M[i], separator=', ')}")


def nclt(path):  # robots.engin.umich.edu/nclt: ms25.csv, magnetometer first
    return lines(path, lambda i: f"{1_335_704_127_000_000 + US[i]}, {numbers(M[i] / 100, F[i], W[i], separator=', ')}")


def novatel(path):  # docs.novatel.com/OEM7, RAWIMUS: z, minus y, x; CRC of "ASCII, 32-bit CRC"; a log of another kind
    def line(i):
        (ax, ay, az), (gx, gy, gz) = AC[i], GC[i]
        stamp = f"2209,{491_612 + MS[i] // 1000}.{MS[i] % 1000:03d}"
        text = f"RAWIMUSA,{stamp};{stamp}588,ea5afe00,{az},{-ay},{ax},{gz},{-gy},{gx}"
        crc = zlib.crc32(text.encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF
        return f"%{text}*{crc:08x}" + ("\n#TIMEA,USB1,0,64.5,FINE;VALID,1.5*00000000" if i % 50 == 7 else "")

    return lines(path, line)


def m5stick(path):  # github.com/Diams/M5StackIMU, on the serial port: a sign in the place of the space
    def line(i):
        return f"acc:{numbers(A[i], form='% 5.5f')}\ngyro:{numbers(D[i], form='% 5.4f')}"

    return lines(path, line)


WITHOUT_OPTIONS = [
    movella_dot, shimmer, gnss_logger, rs_convert, long_table, gopro_telemetry, matlab_mobile, sensor_kinetics, px4_csv,
    gyroflow, novatel, sense_hat, microstrain, openlog_artemis, ros2_echo_csv, ros2_echo, micropython, uzh_fpv,
    sensor_log,
]  # fmt: skip
WITH_A_RATE = [
    mpu6050_light, mpu6050_tockn, adafruit_lsm9ds1, sparkfun_lsm9ds1, sparkfun_mpu9250, electronicwings, circuitpython,
    python_dicts, mu_plotter, motioncal, bno055, bmi270, m5stick,
]  # fmt: skip
WITH_COLUMNS = [razor_m0, nclt]
