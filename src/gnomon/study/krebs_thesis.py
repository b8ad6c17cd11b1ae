"""What Krebs states of its simulation: Table A.1, Tables 5.2 and 5.3, and appendix B.1."""

from dataclasses import field

import numpy as np

from ..frozen import value_class
from ..geometry.rotation_vector import rotation_from_rotvec
from ..recording import Floats
from ..simulate.camera_imu_rig import TABLE_A1

GRAVITY = 9.80665
"""Magnitude of gravity [m/s^2], section 3.2.5."""


def _cam_imu() -> Floats:
    """B.2: q_cb is the identity, the camera looks along z; the only p_cb that suits B.1 and B.2 alike."""
    T = np.eye(4)
    T[:3, 3] = 0.103, -0.015, -0.010
    return T


def _gravity() -> Floats:
    """Gravity in the frame of an upright board that leans back by 3 deg: down is -y."""
    lean = np.radians(3.0)
    return GRAVITY * np.array([0.0, -np.cos(lean), -np.sin(lean)])


@value_class
class KrebsRig:
    """What is true of the simulated camera and IMU; the defaults are those of Krebs.

    accelerometer = S_a M_a f + b_a, gyroscope = S_g M_g C_bg' omega + B_g f + b_g (section 4.1.2).

    Attributes
    ----------
    T_cam_imu : (4, 4)
    M_a, M_g : (3,) elements yz, zy, zx [rad]
    S_a, S_g : (3,) scale factors
    B_g : (3, 3) [rad/s per m/s^2]
    C_bg : (3, 3) rotation from the gyroscope's frame to the body's: one degree about z
    gravity : (3,) in the board's frame [m/s^2]
    time_shift_s : d, t_imu - t_cam [s]; not stated
    b_a, b_g : initial biases of every axis [m/s^2], [rad/s]
    """

    T_cam_imu: Floats = field(default_factory=_cam_imu)
    M_a: Floats = field(default_factory=lambda: TABLE_A1["M_a"])
    M_g: Floats = field(default_factory=lambda: TABLE_A1["M_g"])
    S_a: Floats = field(default_factory=lambda: TABLE_A1["S_a"])
    S_g: Floats = field(default_factory=lambda: TABLE_A1["S_g"])
    B_g: Floats = field(default_factory=lambda: TABLE_A1["B_g"].reshape(3, 3))
    C_bg: Floats = field(default_factory=lambda: rotation_from_rotvec(TABLE_A1["q_bg"]))
    gravity: Floats = field(default_factory=_gravity)
    time_shift_s: float = 0.007
    b_a: float = 0.491
    b_g: float = 0.02


@value_class(eq=True)
class Group:
    """Parameters that Krebs gives one name.

    Attributes
    ----------
    name, symbol, unit : as they are shown
    elements : their names
    table_5_3 : sigma of one recording of 90 s, mean over the elements
    sigma : those of S1, S2 and S3 in Tables B.1 and B.2, element by element; empty where they are not stated
    mean_error : the same of the mean errors in Table B.1
    """

    name: str
    symbol: str
    unit: str
    elements: tuple[str, ...]
    table_5_3: float
    sigma: tuple[tuple[float, ...], ...] = ()
    mean_error: tuple[tuple[float, ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.elements)


_XYZ = ("x", "y", "z")
_LOWER = ("yz", "zy", "zx")
_NINE = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")

GROUPS = (
    Group(
        name="translation camera to IMU",
        symbol="p_cb",
        unit="m",
        elements=_XYZ,
        table_5_3=0.004160,
        sigma=((1.715e-3, 3.909e-3, 6.855e-3), (8.439e-4, 8.685e-4, 1.681e-3), (3.524e-4, 2.380e-4, 4.640e-4)),
        mean_error=(
            (-2.640e-5, -7.096e-5, -2.106e-2),
            (-3.203e-5, -3.667e-5, -1.998e-2),
            (-6.373e-5, 5.165e-5, -2.002e-2),
        ),
    ),
    Group(
        name="rotation camera to IMU",
        symbol="q_cb",
        unit="-",
        elements=("i", "j", "k"),
        table_5_3=0.001586,
        sigma=((3.506e-4, 6.904e-4, 4.429e-4), (5.241e-5, 1.118e-4, 9.359e-5), (1.612e-5, 1.532e-5, 1.724e-5)),
    ),
    Group(
        name="misalignment of the accelerometer",
        symbol="M_a",
        unit="rad",
        elements=_LOWER,
        table_5_3=0.001745,
        sigma=((2.220e-3, 1.999e-3, 1.016e-3), (2.983e-4, 4.456e-4, 2.899e-4), (6.955e-5, 2.142e-4, 8.108e-5)),
        mean_error=(
            (4.933e-5, -1.794e-4, -8.920e-5),
            (-4.392e-5, -1.424e-5, 4.878e-6),
            (-2.916e-6, -2.224e-5, -1.853e-5),
        ),
    ),
    Group(
        name="misalignment of the gyroscope",
        symbol="M_g",
        unit="rad",
        elements=_LOWER,
        table_5_3=0.002456,
        sigma=((4.352e-3, 4.557e-3, 2.307e-3), (4.973e-4, 6.707e-4, 6.393e-4), (8.878e-5, 2.081e-4, 1.910e-4)),
        mean_error=((1.406e-4, -5.781e-4, 1.800e-4), (4.549e-5, -6.838e-7, 7.626e-5), (8.030e-6, -1.330e-6, 5.325e-5)),
    ),
    Group(
        name="scale factors of the accelerometer",
        symbol="S_a",
        unit="-",
        elements=_XYZ,
        table_5_3=0.001593,
        sigma=((2.175e-3, 1.282e-3, 1.323e-3), (2.880e-4, 1.891e-4, 2.825e-4), (5.264e-5, 4.801e-5, 1.011e-4)),
        mean_error=((3.082e-5, 1.759e-4, 1.656e-4), (5.818e-6, 3.818e-5, -1.712e-5), (1.239e-5, 9.961e-6, 2.068e-6)),
    ),
    Group(
        name="scale factors of the gyroscope",
        symbol="S_g",
        unit="-",
        elements=_XYZ,
        table_5_3=0.003081,
        sigma=((5.061e-3, 3.003e-3, 1.180e-3), (8.903e-4, 6.824e-4, 2.260e-4), (2.335e-4, 1.842e-4, 7.708e-5)),
        mean_error=(
            (-2.435e-3, -5.218e-5, -6.492e-5),
            (2.377e-5, -2.862e-5, -5.151e-6),
            (1.640e-5, 1.089e-6, 2.678e-6),
        ),
    ),
    Group(
        name="acceleration's influence on the gyroscope",
        symbol="B_g",
        unit="rad/s per m/s^2",
        elements=_NINE,
        table_5_3=0.000211,
        sigma=(
            (2.357e-4, 1.048e-4, 2.225e-4, 2.368e-4, 8.755e-5, 2.015e-4, 2.992e-4, 1.530e-4, 3.577e-4),
            (2.839e-5, 1.684e-5, 2.931e-5, 3.308e-5, 1.224e-5, 2.747e-5, 7.070e-5, 3.131e-5, 6.558e-5),
            (1.532e-5, 7.556e-6, 1.354e-5, 9.953e-6, 4.148e-6, 6.748e-6, 2.636e-5, 6.608e-6, 1.627e-5),
        ),
        mean_error=(
            (4.356e-5, -1.078e-5, 3.741e-6, 1.183e-5, 6.443e-7, -5.317e-6, 3.158e-5, -2.035e-6, -6.410e-6),
            (-1.708e-7, -1.004e-6, 8.672e-7, 4.224e-8, 4.529e-7, -4.546e-6, 5.624e-6, -1.810e-7, 2.192e-6),
            (3.288e-6, 5.578e-6, 2.679e-6, -3.217e-6, -3.465e-7, -1.635e-6, 9.451e-6, 3.289e-6, 3.214e-6),
        ),
    ),
    Group(
        name="rotation accelerometer to gyroscope",
        symbol="q_bg",
        unit="-",
        elements=("i", "j", "k"),
        table_5_3=0.000658,
        sigma=((9.092e-4, 8.173e-4, 8.993e-4), (1.869e-4, 2.088e-4, 1.228e-4), (3.880e-5, 7.000e-5, 3.561e-5)),
    ),
    Group(name="gravity", symbol="g_w", unit="m/s^2", elements=_XYZ, table_5_3=0.014348),
    Group(name="time offset of the camera", symbol="d", unit="s", elements=("",), table_5_3=0.000144),
)
"""In the order in which a study's numbers stand; of rotations the vector part of the quaternion of the error."""

NAMES = tuple(f"{group.symbol} {element}".strip() for group in GROUPS for element in group.elements)
UNITS = tuple(group.unit for group in GROUPS for _ in group.elements)


def group_columns(symbol: str) -> slice:
    """Return where a group stands among NAMES."""
    first = 0
    for group in GROUPS:
        if group.symbol == symbol:
            return slice(first, first + group.size)
        first += group.size
    raise KeyError(symbol)


def stated_sigma(series: int) -> Floats:
    """Return the sigmas of Tables B.1 and B.2 of a series, 0 to 2, in the order of NAMES; nan where there is none."""
    return np.concatenate([group.sigma[series] if group.sigma else np.full(group.size, np.nan) for group in GROUPS])


def stated_mean(series: int) -> Floats:
    """Return the mean errors of Table B.1 of a series, in the order of NAMES; nan where there is none."""
    return np.concatenate(
        [group.mean_error[series] if group.mean_error else np.full(group.size, np.nan) for group in GROUPS]
    )
