"""The quantities of sensors and cameras in the letters of gnomon, a document or Kalibr, with their sigmas."""

from collections.abc import Iterator
from math import floor, isfinite, log10

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import quaternion_from_rotation, skew
from ...models.camera import PROJECTIONS, Camera
from ...models.distortions import DISTORTIONS
from ...models.forms import (
    AngrisanoAccelerometer,
    AngrisanoGyroscope,
    CorrectedTriad,
    KalibrAccelerometer,
    KalibrGyroscope,
    KrebsAccelerometer,
    KrebsGyroscope,
    TedaldiAccelerometer,
    TedaldiGyroscope,
    in_own_axes,
)
from ...recording import Floats
from ...results.calibration import Calibration
from ...results.sensors import unit_ratio

_FORCE, _RATE = "m/s^2", "rad/s"
_LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))


@value_class(eq=True)
class FormEntry:
    """One scalar of a form."""

    triad: str
    name: str
    value: float
    unit: str


@value_class(eq=True)
class _Maker:
    """Makes the entries of one triad; si is the unit of what it measures."""

    triad: str
    si: str

    def one(self, name: str, value: float, unit: str) -> FormEntry:
        return FormEntry(triad=self.triad, name=name, value=float(value), unit=unit)

    def vector(self, name: str, values: Floats, unit: str) -> Iterator[FormEntry]:
        """Name x, y, z."""
        for axis, value in zip("xyz", values.tolist(), strict=True):
            yield self.one(f"{name}_{axis}", value, unit)

    def matrix(
        self, name: str, values: Floats, unit: str, places: tuple[tuple[int, int], ...] | None = None
    ) -> Iterator[FormEntry]:
        """Name rows and columns by x, y, z: the sensor axis, then the body axis."""
        for i, j in places or tuple(np.ndindex(3, 3)):
            yield self.one(f"{name}_{'xyz'[i]}{'xyz'[j]}", values[i, j], unit)

    def angles(self, T: Floats, signed: dict[str, tuple[int, int, int]], prefix: str) -> Iterator[FormEntry]:
        for name, (sign, i, j) in signed.items():
            yield self.one(f"{prefix}{name}", sign * T[i, j], "rad")

    def corrected(
        self, form: CorrectedTriad, signed: dict[str, tuple[int, int, int]], prefix: str, letter: str, unit: str
    ) -> Iterator[FormEntry]:
        """Name angles, correction scales with their inverses as data sheets print them, and bias."""
        yield from self.angles(form.T, signed, prefix)
        yield from self.vector(letter, form.K, unit_ratio(self.si, unit))
        yield from self.vector(f"1/{letter}", 1 / form.K, unit_ratio(unit, self.si))
        yield from self.vector("b", form.b, unit)


_ACCELEROMETER, _GYROSCOPE = _Maker(triad="accelerometer", si=_FORCE), _Maker(triad="gyroscope", si=_RATE)
_UPPER_ANGLES = {"yz": (-1, 0, 1), "zy": (1, 0, 2), "zx": (-1, 1, 2)}
_ALL_ANGLES = {**_UPPER_ANGLES, "xz": (1, 1, 0), "xy": (-1, 2, 0), "yx": (1, 2, 1)}
"""Tedaldi, Eqs. (2.6), (2.7): angle -> (sign, row, column) in T."""
_ANGRISANO_ANGLES = {"z": (1, 0, 1), "y": (1, 0, 2), "x": (1, 1, 2)}
_KREBS_ANGLES = {"yz": (1, 1, 0), "zy": (1, 2, 0), "zx": (1, 2, 1)}


def sensitivity_accelerometer(S: Floats, b: Floats, unit: str) -> Iterator[FormEntry]:
    """Name sensitivity and bias."""
    yield from _ACCELEROMETER.matrix("sensitivity", S, unit_ratio(unit, _FORCE))
    yield from _ACCELEROMETER.vector("bias", b, unit)


def lever_arms(places: Floats) -> Iterator[FormEntry]:
    """Name where the accelerometers sit: the accelerometer, then the body axis."""
    yield from _ACCELEROMETER.matrix("r", places, "m")


def time_shift(shift_s: float) -> Iterator[FormEntry]:
    """Name what is added to the timestamps of the accelerometer."""
    yield _ACCELEROMETER.one("time_shift", 1e3 * shift_s, "ms")


def sensitivity_gyroscope(S: Floats, b: Floats, G: Floats, unit: str) -> Iterator[FormEntry]:
    """Name sensitivity, bias and g-sensitivity."""
    yield from _GYROSCOPE.matrix("sensitivity", S, unit_ratio(unit, _RATE))
    yield from _GYROSCOPE.vector("bias", b, unit)
    yield from _GYROSCOPE.matrix("g_sensitivity", G, unit_ratio(unit, _FORCE))


def tedaldi_accelerometer(S: Floats, b: Floats, unit: str) -> Iterator[FormEntry]:
    """Tedaldi, (2.6): angles alpha, scales s, bias b (added)."""
    yield from _ACCELEROMETER.corrected(TedaldiAccelerometer.from_sensor(S, b), _UPPER_ANGLES, "alpha_", "s", unit)


def tedaldi_gyroscope(S: Floats, b: Floats, G: Floats, unit: str) -> Iterator[FormEntry]:
    """Tedaldi, (2.7): angles gamma, scales s, bias b (added), with Krebs's g-sensitivity."""
    form = TedaldiGyroscope.from_sensor(S, b, G)
    yield from _GYROSCOPE.corrected(form, _ALL_ANGLES, "gamma_", "s", unit)
    yield from _GYROSCOPE.matrix("B", form.B, unit_ratio(unit, _FORCE))


def krebs_accelerometer(S: Floats, b: Floats, unit: str) -> Iterator[FormEntry]:
    """Krebs, chapter 3: misalignments M, scales S, bias b."""
    form = KrebsAccelerometer.from_sensor(S, b)
    yield from _ACCELEROMETER.angles(form.M, _KREBS_ANGLES, "M_")
    yield from _ACCELEROMETER.vector("S", form.S, unit_ratio(unit, _FORCE))
    yield from _ACCELEROMETER.vector("b", form.b, unit)


def krebs_gyroscope(S: Floats, b: Floats, G: Floats, unit: str) -> Iterator[FormEntry]:
    """Krebs: misalignments M, scales S, rotation q_bg, g-sensitivity B (chapter 3) and B' (chapter 4), bias b."""
    form = KrebsGyroscope.from_sensor(S, b, G)
    yield from _GYROSCOPE.angles(form.M, _KREBS_ANGLES, "M_")
    yield from _GYROSCOPE.vector("S", form.S, unit_ratio(unit, _RATE))
    for name, value in zip(("w", "i", "j", "k"), quaternion_from_rotation(form.C_bg).tolist(), strict=True):
        yield _GYROSCOPE.one(f"q_bg_{name}", value, "1")
    yield from _GYROSCOPE.matrix("B", form.B, unit_ratio(unit, _FORCE))
    yield from _GYROSCOPE.matrix("B'", G, unit_ratio(unit, _FORCE))
    yield from _GYROSCOPE.vector("b", form.b, unit)


def angrisano_accelerometer(S: Floats, b: Floats, unit: str) -> Iterator[FormEntry]:
    """Angrisano, (1), (2): angles a, scales k, bias b (subtracted)."""
    yield from _ACCELEROMETER.corrected(AngrisanoAccelerometer.from_sensor(S, b), _ANGRISANO_ANGLES, "a_", "k", unit)


def angrisano_gyroscope(S: Floats, b: Floats, G: Floats, unit: str) -> Iterator[FormEntry]:
    """Angrisano: as the accelerometer, in a frame of its own, rotated by C_gb and Krebs's g-sensitivity."""
    form = AngrisanoGyroscope.from_sensor(S, b, G)
    yield from _GYROSCOPE.corrected(form, _ANGRISANO_ANGLES, "a_", "k", unit)
    yield from _GYROSCOPE.matrix("C_gb", form.C_gb, "1")
    yield from _GYROSCOPE.matrix("B", form.B, unit_ratio(unit, _FORCE))


def kalibr_accelerometer(S: Floats, b: Floats, unit: str) -> Iterator[FormEntry]:
    """Kalibr: M lower triangular, bias."""
    form = KalibrAccelerometer.from_sensor(S, b)
    yield from _ACCELEROMETER.matrix("M", form.M, unit_ratio(unit, _FORCE), _LOWER)
    yield from _ACCELEROMETER.vector("bias", form.b, unit)


def kalibr_gyroscope(S: Floats, b: Floats, G: Floats, unit: str) -> Iterator[FormEntry]:
    """Kalibr: M lower triangular, C_gyro_i, A, its product with C_gyro_i that acts on body axes, and bias."""
    form = KalibrGyroscope.from_sensor(S, b, G)
    yield from _GYROSCOPE.matrix("M", form.M, unit_ratio(unit, _RATE), _LOWER)
    yield from _GYROSCOPE.matrix("C_gyro_i", form.C_gyro_i, "1")
    yield from _GYROSCOPE.matrix("A", form.A, unit_ratio(unit, _FORCE))
    yield from _GYROSCOPE.matrix("AC", G, unit_ratio(unit, _FORCE))
    yield from _GYROSCOPE.vector("bias", form.b, unit)


def sensitivity_magnetometer(S: Floats, b: Floats, unit: str, field_unit: str) -> Iterator[FormEntry]:
    """Name sensitivity (soft iron) and bias (hard iron)."""
    maker = _Maker(triad="magnetometer", si=field_unit)
    yield from maker.matrix("sensitivity", S, unit_ratio(unit, field_unit))
    yield from maker.vector("bias", b, unit)


def angrisano_magnetometer(S: Floats, b: Floats, unit: str, field_unit: str) -> Iterator[FormEntry]:
    """Angrisano, (1), (2): as the gyroscope, in a frame of its own, rotated by C_mb."""
    maker = _Maker(triad="magnetometer", si=field_unit)
    upper, C_mb = in_own_axes(S, AngrisanoAccelerometer.frame)
    form = AngrisanoAccelerometer.from_sensor(upper, b)
    yield from maker.corrected(form, _ANGRISANO_ANGLES, "a_", "k", unit)
    yield from maker.matrix("C_mb", C_mb, "1")


EQUATION = (
    "p_cam = R p_imu + t, rows of R: camera axes, columns: body axes; p: the camera in the body frame; "
    "t_imu = t_cam + time_shift_cam_imu"
)
EQUATION_ALONE = (
    "p_cam = R p_cam0 + t, rows of R: camera axes, columns: axes of cam0; p: the camera in the frame of cam0"
)
"""The same of cameras without an IMU."""
IMU_EQUATION = (
    "p_imu = R p_body + t, rows of R: axes of this IMU, columns: body axes (imu0's); p: the IMU in the body frame; "
    "t_imu0 = t_imu + time_shift_imu"
)
"""The same of an IMU beside imu0."""
Known = tuple[FormEntry, float]


def camera_equation(calibration: Calibration) -> str:
    """Return what the names of a calibration's cameras mean: of other projects' rigs no IMU's errors need be known."""
    on_body = any(camera.body == "imu0" for camera in calibration.cameras.values())
    return EQUATION if on_body else EQUATION_ALONE


def camera_entries(calibration: Calibration, name: str) -> Iterator[Known]:
    """Yield the scalars of one camera with their standard deviations."""
    calibrated = calibration.cameras[name]
    if name != calibrated.body:
        yield from _pose(calibration, name, calibrated.link, calibrated.T_cam_body)
    if calibrated.body == "imu0":
        yield from _scaled(calibration, name, "time_shift_cam_imu", 1e3, "ms")
        yield from _scaled(calibration, name, "line_delay", 1e6, "us")
    first, pixels, coeffs = _lens_names(calibrated.camera)
    intrinsics, sigma = calibrated.camera.intrinsics, calibration.sigma(f"{name}.intrinsics")
    yield from _block(name, first, intrinsics[:-4], sigma[:-4], "1")
    yield from _block(name, pixels, intrinsics[-4:], sigma[-4:], "px")
    bent = calibration.sigma(f"{name}.distortion_coeffs")
    yield from _block(name, coeffs, calibrated.camera.distortion_coeffs, bent, "1")


def imu_entries(calibration: Calibration, name: str) -> Iterator[Known]:
    """Yield the scalars of the pose and the clock of one IMU beside the body, with their standard deviations."""
    pose = calibration.imus[name].T_imu_body
    if pose is not None:
        yield from _pose(calibration, name, "T_imu_body", pose)
        yield from _scaled(calibration, name, "time_shift_imu", 1e3, "ms")


def _block(name: str, entries: list[str], values: Floats, sigmas: Floats, unit: str) -> Iterator[Known]:
    for entry, value, sigma in zip(entries, values.tolist(), sigmas.tolist(), strict=True):
        yield FormEntry(triad=name, name=entry, value=value, unit=unit), sigma


def _scaled(calibration: Calibration, name: str, label: str, factor: float, unit: str) -> Iterator[Known]:
    value, sigma = calibration.parameter(f"{name}.{label}"), calibration.sigma(f"{name}.{label}")
    yield from _block(name, [label], np.atleast_1d(value) * factor, np.atleast_1d(sigma) * factor, unit)


def _pose(calibration: Calibration, name: str, link: str, T: Floats) -> Iterator[Known]:
    """Yield R and t of p_sensor = T p_body, and p, the place of the sensor in the body frame."""
    path = f"{name}.{link}"
    R, t = T[:3, :3], T[:3, 3]
    covariance = calibration.covariance(f"{path}.rotation", f"{path}.translation")
    turns = R @ skew(np.eye(3))  # by the small rotation: dR = R [delta]x
    by_turn = turns.reshape(3, 9).T
    names = [f"R_{'xyz'[i]}{'xyz'[j]}" for i, j in np.ndindex(3, 3)]
    yield from _block(name, names, R.ravel(), _sigmas(by_turn, covariance[:3, :3]), "1")
    yield from _block(name, [f"t_{axis}" for axis in "xyz"], t, calibration.sigma(f"{path}.translation"), "m")
    position = -R.T @ t
    by_both = np.hstack([skew(position), -R.T])
    yield from _block(name, [f"p_{axis}" for axis in "xyz"], position, _sigmas(by_both, covariance), "m")


def _sigmas(jacobian: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    return np.sqrt(np.maximum(variance, 0.0))  # rounding may leave less than nothing of a fixed rotation


def _lens_names(camera: Camera) -> tuple[list[str], list[str], list[str]]:
    coeffs = DISTORTIONS[camera.distortion].names
    return list(PROJECTIONS[camera.projection].names), ["fu", "fv", "pu", "pv"], list(coeffs)


@value_class
class Baseline:
    """One camera as another one sees it.

    Attributes
    ----------
    T : (4, 4) p_second = T @ p_first [m]
    covariance : (6, 6) of a small rotation on the right of R_second_first [rad], and of the last column [m]
    """

    T: Floats
    covariance: Floats

    @property
    def distance(self) -> float:
        """How far apart they are [m]."""
        return float(np.linalg.norm(self.T[:3, 3]))

    @property
    def distance_sigma(self) -> float:
        """Standard deviation of the distance [m]."""
        along = self.T[:3, 3] / self.distance if self.distance else np.zeros(3)
        return float(np.sqrt(max(along @ self.covariance[3:, 3:] @ along, 0.0)))


def baseline_of(calibration: Calibration, first: str, second: str) -> Baseline:
    """Return the pose of the second camera to the first one.

    With R_a Exp(d) and t of each camera a against the body, R = R_2 R_1' and t = t_2 - R t_1:

        rotation on the right of R:  R_1 (d_2 - d_1);    t:  dt_2 - R dt_1 + R [t_1]x R_1 (d_2 - d_1)

    Parameters
    ----------
    first, second : such as "cam0", "cam1"
    """
    one, other = calibration.cameras[first], calibration.cameras[second]
    R1, t1 = one.T_cam_body[:3, :3], one.T_cam_body[:3, 3]
    R = other.T_cam_body[:3, :3] @ R1.T
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, other.T_cam_body[:3, 3] - R @ t1
    turn = np.vstack([R1, R @ skew(t1) @ R1])
    slopes = {
        first: np.hstack([-turn, np.vstack([np.zeros((3, 3)), -R])]),
        second: np.hstack([turn, np.vstack([np.zeros((3, 3)), np.eye(3)])]),
    }
    known = [name for name in (first, second) if name != calibration.cameras[name].body]
    paths = [
        f"{name}.{calibration.cameras[name].link}.{part}" for name in known for part in ("rotation", "translation")
    ]
    jacobian = np.hstack([slopes[name] for name in known])
    return Baseline(T=T, covariance=jacobian @ calibration.covariance(*paths) @ jacobian.T)


def value_text(value: float, sigma: float) -> str:
    """Return value and sigma with two significant digits of sigma.

    Examples
    --------
    >>> value_text(414.4075, 0.01234), value_text(0.0, 0.0), value_text(1.23456e-7, 1.2e-9)
    ('414.408 ± 0.012', '0 (fixed)', '(1.235 ± 0.012)e-07')
    """
    if sigma == 0:
        return f"{value:.6g} (fixed)"
    if not isfinite(sigma):
        return f"{value:.6g} (unknown sigma)"
    exponent = floor(log10(float(f"{sigma:.1e}")))
    largest = max(exponent, floor(log10(abs(value))) if value else exponent)
    if -4 <= largest < 6 and exponent < 2:
        decimals = 1 - exponent
        return f"{value:.{decimals}f} ± {sigma:.{decimals}f}"
    scale, decimals = 10.0**largest, largest - exponent + 1
    return f"({value / scale:.{decimals}f} ± {sigma / scale:.{decimals}f})e{largest:+03d}"
