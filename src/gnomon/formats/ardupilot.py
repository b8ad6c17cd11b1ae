"""ArduPilot: parameters INS_ACCOFFS_X, INS_ACCSCAL_X, INS_GYROFFS_X, ..., in a file that ground stations load.

ArduPilot corrects f = (a - OFFS) SCAL, element by element, and w = y - OFFS, in the sensor's axes. Read back by
`formats.flight_parameters`.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.polynomial import Polynomial

from ..results.calibration import Calibration, ImuCalibration
from .shared.flight_parameters import (
    ARDUPILOT_REFERENCE_DEGC,
    FlightImu,
    ParameterNames,
    flight_losses,
    require_flight_imus,
)
from .shared.losses import Context, Export, Loss
from .shared.si_units import si_conversions

FILE = "ardupilot.param"

_IMUS = 3
_SCALES, _LARGEST_OFFSET = (0.8, 1.2), 3.5  # ranges of its parameters [1], [m/s^2]
_HEAD = """\
# Sensor calibration for ArduPilot, made by gnomon. With samples a [m/s^2] and y [rad/s] as the drivers give them, axis
# by axis:
#   specific force = (a - OFFS) SCAL             angular rate = y - OFFS
# Body frame {frame}; its axes are those of the samples, before AHRS_ORIENTATION.
# There is no place for cameras: T_cam_imu and the time shift are not in this file.
"""


def export(calibration: Calibration, context: Context) -> Export:
    """Return `ardupilot.param`.

    Raises
    ------
    OptionError
        If there is neither accelerometer nor gyroscope.
    """
    imus = require_flight_imus(calibration, "ArduPilot", _IMUS)
    rows = [f"{name},{value!r}\n" for i, imu in enumerate(imus.values()) for name, value in _names(i).values(imu)]
    rows += [
        f"{name},{value!r}\n"
        for i, imu in enumerate(list(calibration.imus.values())[:_IMUS])
        for name, value in _temperature(i, imu)
    ]
    head = _HEAD.format(frame=calibration.frame) + context.comment()
    losses = (*flight_losses(calibration, "ArduPilot", _IMUS, context), *_range_losses(imus), *_start_losses(imus))
    return Export(files={FILE: head + "".join(rows)}, losses=losses)


def _temperature(index: int, imu: ImuCalibration) -> Iterator[tuple[str, float]]:
    """Yield name and value of the temperature's parameters.

    ArduPilot takes p(T) - p(CALTEMP) off the samples, with p(T) = 1e-6 (c1 e + c2 e^2 + c3 e^3) and e = T - 35 degC,
    and T no farther than TMIN and TMAX, before it applies offsets and scales.
    """
    found = imu.temperature
    if found is None or not any(part.endswith("_bias") for part, _ in found.parts()):
        return
    prefix, number = f"INS_TCAL{index + 1}_", str(index + 1)
    yield f"{prefix}ENABLE", 1
    yield f"{prefix}TMIN", found.low_degc
    yield f"{prefix}TMAX", found.high_degc
    for conversion in si_conversions(imu):
        coefficients = getattr(found, f"{conversion.triad}_bias")
        name = {"accelerometer": "ACC", "gyroscope": "GYR"}[conversion.triad]
        yield f"INS_{name}{number}_CALTEMP", found.reference_degc
        moved = np.zeros((3, 3))
        if coefficients is not None:
            whole = np.concatenate([np.zeros((1, 3)), coefficients * conversion.factor])
            about = Polynomial([ARDUPILOT_REFERENCE_DEGC - found.reference_degc, 1.0])  # T - T_ref by T - 35
            for axis in range(3):
                shifted = np.asarray(Polynomial(whole[:, axis])(about).coef[1:], dtype=np.float64)
                moved[: len(shifted), axis] = 1e6 * shifted
        for order, row in enumerate(moved.tolist(), 1):
            for axis, value in zip("XYZ", row, strict=True):
                yield f"{prefix}{name}{order}_{axis}", value


def _names(index: int) -> ParameterNames:
    number = str(index + 1) if index else ""
    return ParameterNames(
        accelerometer_offset=f"INS_ACC{number}OFFS_{{axis}}",
        accelerometer_scale=f"INS_ACC{number}SCAL_{{axis}}",
        gyroscope_offset=f"INS_GYR{number}OFFS_{{axis}}",
    )


def _range_losses(imus: Mapping[str, FlightImu]) -> Iterator[Loss]:
    low, high = _SCALES
    for name, imu in imus.items():
        triad = imu.accelerometer
        if triad is None:
            continue
        if triad.scale.min() < low or triad.scale.max() > high or abs(triad.offset).max() > _LARGEST_OFFSET:
            yield Loss(
                what=f"range of {name}",
                why=f"ArduPilot states scales from {low} to {high} and offsets up to {_LARGEST_OFFSET} m/s^2 as the "
                "range of its parameters, and these are beyond.",
            )


def _start_losses(imus: Mapping[str, FlightImu]) -> Iterator[Loss]:
    if any(imu.gyroscope for imu in imus.values()):
        yield Loss(
            what="gyroscope offsets",
            why="ArduPilot measures them anew at every start, unless INS_GYR_CAL is 0.",
        )
