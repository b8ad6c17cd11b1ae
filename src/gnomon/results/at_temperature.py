"""IMUs as they are at one temperature: sensitivities and biases there, and the derivative of all scalars."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import OptionError
from ..recording import Floats
from .parameters import Moved, calibration_parameters, covariance_names
from .sensors import TRIADS, CameraCalibration, ImuCalibration, TemperatureDependence

_NEAR_K = 0.5
"""How far beyond the range a temperature still counts as in it."""


def imus_at_temperature(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration], degc: float
) -> Moved:
    """Return the IMUs as they are at a temperature, which then depend on it no longer.

    Parameters
    ----------
    degc : of all that know how they change [degC]

    Returns
    -------
    With a jacobian (m, n) of the scalars that remain by those before.

    Raises
    ------
    OptionError
        If it is beyond the range in which an IMU knows it.
    """
    before = {name: i for i, name in enumerate(covariance_names(imus, cameras))}
    moved = {name: _at(name, imu, degc) for name, imu in imus.items()}
    after = covariance_names(moved, cameras)
    jacobian = np.zeros((len(after), len(before)))
    for row, scalar in enumerate(after):
        jacobian[row, before[scalar]] = 1.0
    places = {scalar: i for i, scalar in enumerate(after)}
    for name, imu in imus.items():
        if imu.temperature is None:
            continue
        for path, value in calibration_parameters({name: replace(imu, temperature=None)}):
            triad, _, kind = path.removeprefix(f"{name}.").partition(".")
            if triad in TRIADS and kind in {"bias", "sensitivity", "g_sensitivity"}:
                rows = [places[f"{path}[{','.join(map(str, index))}]"] for index in np.ndindex(value.shape)]
                changed = value
                if kind == "g_sensitivity":
                    changed = value + _own_change(imu, degc)
                    jacobian[rows] += _more_of_own(before, name, imu, degc)
                jacobian[rows] += _more(before, imu.temperature, (name, triad, kind), changed, degc)
    return Moved(imus=moved, cameras=dict(cameras), jacobian=jacobian)


def _at(name: str, imu: ImuCalibration, degc: float) -> ImuCalibration:
    found = imu.temperature
    if found is None:
        return imu
    if found.changes and not found.low_degc - _NEAR_K <= degc <= found.high_degc + _NEAR_K:
        raise OptionError(
            f"{name} is known from {found.low_degc:.1f} to {found.high_degc:.1f} degC, and not at {degc:.1f} degC."
        )
    changed = {}
    for triad in TRIADS:
        sensor = getattr(imu, triad)
        if sensor is None:
            continue
        larger = np.eye(3) + found.change(f"{triad}_sensitivity", np.array([degc]))[0]
        bias = sensor.bias + found.change(f"{triad}_bias", np.array([degc]))[0]
        changed[triad] = replace(sensor, sensitivity=larger @ sensor.sensitivity, bias=bias)
        if triad == "gyroscope":
            felt = larger @ (sensor.g_sensitivity + _own_change(imu, degc))
            changed[triad] = replace(changed[triad], g_sensitivity=felt)
    return replace(imu, temperature=None, **changed)


def _own_change(imu: ImuCalibration, degc: float) -> Floats:
    """Return by how much the g-sensitivity changes by itself, (3, 3) [unit of the gyroscope per m/s^2]."""
    if imu.temperature is None or imu.temperature.gyroscope_g_sensitivity is None:
        return np.zeros((3, 3))
    change = imu.temperature.change("gyroscope_g_sensitivity", np.array([degc]))[0]
    return change @ imu.required_accelerometer.sensitivity


def _more_of_own(before: Mapping[str, int], name: str, imu: ImuCalibration, degc: float) -> Floats:
    """Return the derivative (9, n) of the g-sensitivity, (1 + D) (G + H S) with S of the accelerometer, by H and S."""
    rows = np.zeros((9, len(before)))
    found = imu.temperature
    if found is None or found.gyroscope_g_sensitivity is None:
        return rows
    larger = np.eye(3) + found.change("gyroscope_sensitivity", np.array([degc]))[0]
    by_sensitivity = larger @ found.change("gyroscope_g_sensitivity", np.array([degc]))[0]
    sensitivity = imu.required_accelerometer.sensitivity
    d = float(np.clip(degc, found.low_degc, found.high_degc)) - found.reference_degc
    path = f"{name}.temperature.gyroscope_g_sensitivity"
    for (r, c), row in zip(np.ndindex(3, 3), rows, strict=True):
        for m in range(3):
            row[before[f"{name}.accelerometer.sensitivity[{m},{c}]"]] = by_sensitivity[r, m]
            for n, j in np.ndindex(3, len(found.gyroscope_g_sensitivity)):
                row[before[f"{path}[{j},{n},{m}]"]] = larger[r, n] * d ** (j + 1) * sensitivity[m, c]
    return rows


def _more(
    before: Mapping[str, int], found: TemperatureDependence, which: tuple[str, str, str], value: Floats, degc: float
) -> Floats:
    """Return what the derivative of a bias or a matrix has beside that by itself at the reference, (k, n)."""
    name, triad, kind = which
    part = f"{triad}_{'bias' if kind == 'bias' else 'sensitivity'}"
    coefficients: Floats | None = getattr(found, part)
    rows = np.zeros((value.size, len(before)))
    if coefficients is None:
        return rows
    d = float(np.clip(degc, found.low_degc, found.high_degc)) - found.reference_degc
    path = f"{name}.temperature.{part}"
    powers = [d ** (j + 1) for j in range(len(coefficients))]
    if kind == "bias":
        for axis, row in enumerate(rows):
            for j, power in enumerate(powers):
                row[before[f"{path}[{j},{axis}]"]] = power
        return rows
    # M(T) = (1 + D) M: its entry (r, c) moves by sum_n (1 + D)_rn dM_nc + sum_n dD_rn M_nc
    relative = found.change(part, np.array([degc]))[0]
    for (r, c), row in zip(np.ndindex(3, 3), rows, strict=True):
        for n in range(3):
            row[before[f"{name}.{triad}.{kind}[{n},{c}]"]] = relative[r, n]
            for j, power in enumerate(powers):
                row[before[f"{path}[{j},{r},{n}]"]] = power * value[n, c]
    return rows
