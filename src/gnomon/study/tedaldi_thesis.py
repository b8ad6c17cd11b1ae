"""What document A found in its simulations: Tables 4.1 to 4.5, set 1, and the means over its 40 sets."""

import numpy as np

ACCELEROMETER = ("a_yz", "a_zy", "a_zx", "s_x", "s_y", "s_z", "b_x", "b_y", "b_z")
GYROSCOPE = ("g_yz", "g_zy", "g_xz", "g_zx", "g_xy", "g_yx", "s_x", "s_y", "s_z")
UNITS = ("rad",) * 3 + ("1",) * 3 + ("m/s^2",) * 3 + ("rad",) * 6 + ("1",) * 3
"""Of both vectors, Eqs. (3.2) and (3.6), one after the other."""

SET_1 = np.array([
    0.0049, -0.0055, 0.0079, 0.9908, 1.0068, 1.0066, 0.0793, -0.0024, 0.0636,
    0.0112, -0.0211, 0.0040, -0.0010, 0.0270, 0.0151, 0.8786, 0.9703, 1.0460,
])  # fmt: skip
"""The real values of Tables 4.1 and 4.2."""

SPREAD = 1e-3 * np.array([
    0.0481, 0.0401, 0.0296, 0.0327, 0.0304, 0.0215, 0.1369, 0.2138, 0.1332,
    0.8547, 0.4419, 1.0630, 0.4102, 0.8154, 0.7250, 0.4121, 0.4059, 0.4216,
])  # fmt: skip
"""Standard deviation of the estimates of set 1 over 30 signals."""

MEAN_ERROR = 1e-3 * np.array([
    0.0398, 0.0334, 0.0248, 0.0265, 0.0258, 0.0178, 0.1163, 0.1760, 0.0953,
    0.6392, 0.3468, 0.9080, 0.3386, 0.6375, 0.7315, 0.3366, 0.3353, 0.3410,
])  # fmt: skip
"""Mean absolute error of the estimates of set 1."""

GROUPS = {
    "accelerometer misalignment": (slice(0, 3), 0.0335e-3),
    "accelerometer scale": (slice(3, 6), 0.0206e-3),
    "accelerometer bias": (slice(6, 9), 0.1447e-3),
    "gyroscope misalignment": (slice(9, 15), 0.638e-3),
    "gyroscope scale": (slice(15, 18), 0.350e-3),
}
"""Parameters that belong together, and their mean absolute error over all 40 sets."""

SIGNAL_ERROR = {
    "accelerometer": ((0.0842, 0.0564, 0.0635), (0.0055, 0.0056, 0.0056)),
    "gyroscope": ((0.1043, 0.1097, 0.0345), (0.0035, 0.0039, 0.0042)),
}
"""Table 4.3: mean absolute error along x, y, z, uncalibrated and calibrated [m/s^2], [rad/s]."""

DIVERGENCE = {
    "uncalibrated": ((0.0665, 0.2133, 0.0623, 0.2098), (0.0114, 0.0226, 0.0115, 0.0240)),
    "calibrated": ((0.0056, 0.0299, 0.0056, 0.0298), (0.0009, 0.0035, 0.0009, 0.0038)),
}
"""Table 4.4: mean and largest, and both in the worst case [m/s^2]; the same as an angle [rad]."""

ROTATION = {
    "uncalibrated": ((4.7125, 9.2930, 5.2859, 8.5822), (0.5494, 0.6029)),
    "calibrated": ((0.2208, 0.4469, 0.5102, 0.8597), (0.0256, 0.0569)),
}
"""Table 4.5: mean and largest, and both in the worst case [m/s^2]; angle, and in the worst case [rad]."""
