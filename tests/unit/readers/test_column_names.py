"""Names of columns in the spellings that loggers, ROS tools and datasets use."""

import pytest

from gnomon.readers.samples.column_names import column_name, unit_of


@pytest.mark.parametrize(
    ("text", "quantity", "axis", "unit"),
    [
        ("ax", "accelerometer", 0, None),
        ("acc_x", "accelerometer", 0, None),
        ("accel_y [m/s^2]", "accelerometer", 1, "m/s^2"),
        ("a_RS_S_z [m s^-2]", "accelerometer", 2, "m/s^2"),
        ("accX", "accelerometer", 0, None),
        ("AccZ", "accelerometer", 2, None),
        ("linear_acceleration.x", "accelerometer", 0, None),
        ("field.linear_acceleration.y", "accelerometer", 1, None),
        ("alpha_x", "accelerometer", 0, None),
        ("ax_g", "accelerometer", 0, "g"),
        ("acc_z_mg", "accelerometer", 2, "mg"),
        ("Acceleration x (m/s²)", "accelerometer", 0, "m/s^2"),
        ("accelerometer_m_s2[1]", "accelerometer", 1, "m/s^2"),
        ("xacc", "accelerometer", 0, None),
        ("x-axis (g)", "accelerometer", 0, "g"),
        ("accelerometerAccelerationX(G)", "accelerometer", 0, "g"),
        ("ax [count]", "accelerometer", 0, "count"),
        ("imu0_accel_x", "accelerometer", 0, None),
        ("gx", "gyroscope", 0, None),
        ("gyro_x", "gyroscope", 0, None),
        ("GyrY", "gyroscope", 1, None),
        ("w_x", "gyroscope", 0, None),
        ("wz", "gyroscope", 2, None),
        ("omega_x", "gyroscope", 0, None),
        ("w_RS_S_x [rad s^-1]", "gyroscope", 0, "rad/s"),
        ("angular_velocity.z", "gyroscope", 2, None),
        ("gyr_x_dps", "gyroscope", 0, "deg/s"),
        ("gyro_y (°/s)", "gyroscope", 1, "deg/s"),
        ("gyro_rad[2]", "gyroscope", 2, "rad/s"),
        ("rotation rate z (deg/s)", "gyroscope", 2, "deg/s"),
        ("gyro_x [mdps]", "gyroscope", 0, "mdeg/s"),
        ("x", "unnamed", 0, None),
        ("Z", "unnamed", 2, None),
        ("t", "time", None, None),
        ("timestamp [ns]", "time", None, "ns"),
        ("ts_ns", "time", None, "ns"),
        ("t_us", "time", None, "us"),
        ("time_ms", "time", None, "ms"),
        ("Time (s)", "time", None, "s"),
        ("timestampNs", "time", None, "ns"),
        ("TimeUS", "time", None, "us"),
        ("seconds_elapsed", "time", None, "s"),
        ("header.stamp.nanosec", "time", None, "ns"),
        ("mx", "magnetometer", 0, None),
        ("mag_z", "magnetometer", 2, None),
        ("magnetic_field.y [uT]", "magnetometer", 1, "uT"),
        ("mag_x_gauss", "magnetometer", 0, "gauss"),
        ("x [nT]", "magnetometer", 0, "nT"),
        ("orientation.x", "other", None, None),
        ("angular_velocity_covariance[0]", "other", None, None),
        ("userAccelerationX", "other", None, None),
        ("temperature", "temperature", None, None),
        ("frame_id", "other", None, None),
        ("", "other", None, None),
    ],
)
def test_spelling_is_understood(text, quantity, axis, unit) -> None:
    name = column_name(text)
    assert (name.quantity, name.axis, name.unit) == (quantity, axis, unit)


def test_unknown_unit_is_none() -> None:
    assert unit_of("furlong", "time") is None
    assert unit_of("ms", "accelerometer") is None
