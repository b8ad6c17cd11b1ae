"""PX4: parameters CAL_ACC0_XOFF, CAL_ACC0_XSCALE, CAL_GYRO0_XOFF, ..., in a file that ground stations load.

PX4 corrects f = (a - OFF) SCALE, element by element, and w = y - OFF, before it turns both from the sensor's axes to
the vehicle's. Read back by `formats.flight_parameters`.
"""

from collections.abc import Iterator

import numpy as np

from ..results.calibration import Calibration, ImuCalibration
from .shared.flight_parameters import ParameterNames, flight_losses, require_flight_imus
from .shared.losses import Context, Export, Loss
from .shared.si_units import si_conversions

FILE = "px4.params"

_IMUS = 4  # accelerometers that PX4 calibrates
_WARM_IMUS = 3  # of which it knows the temperature
_INTEGER, _FLOAT = 6, 9  # MAVLink's types
_HEAD = """\
# Sensor calibration for PX4, made by gnomon. With the samples a [m/s^2] and y [rad/s] of the topics sensor_accel and
# sensor_gyro, axis by axis:
#   specific force = (a - OFF) SCALE             angular rate = y - OFF
# Body frame {frame}; its axes are those of the samples. The parameters count only where CAL_ACC0_ID and CAL_GYRO0_ID
# are those of this sensor; they, CAL_..._PRIO and CAL_..._ROT are the vehicle's own and not in this file.
# Where the temperature was calibrated, TC_... is taken off the samples first; TC_A0_ID and TC_G0_ID, the vehicle's
# own, have to be those of this sensor.
# There is no place for cameras: T_cam_imu and the time shift are not in this file.
"""


def export(calibration: Calibration, context: Context) -> Export:
    """Return `px4.params`.

    Raises
    ------
    OptionError
        If there is neither accelerometer nor gyroscope.
    """
    imus = require_flight_imus(calibration, "PX4", _IMUS)
    rows = [
        f"1\t1\t{name}\t{value!r}\t{_FLOAT}\n"
        for i, imu in enumerate(imus.values())
        for name, value in _names(i).values(imu)
    ]
    rows += [
        f"1\t1\t{name}\t{value!r}\t{kind}\n"
        for i, imu in enumerate(list(calibration.imus.values())[:_WARM_IMUS])
        for name, value, kind in _temperature(i, imu)
    ]
    head = _HEAD.format(frame=calibration.frame) + context.comment()
    text = f"{head}#\n# Vehicle-Id Component-Id Name Value Type\n{''.join(rows)}"
    identity = Loss(
        what="identity of the sensor",
        why="PX4 takes the values only where CAL_ACC0_ID and CAL_GYRO0_ID are those of this sensor: calibrate it once "
        "with the ground station, then load this file.",
    )
    return Export(files={FILE: text}, losses=(*flight_losses(calibration, "PX4", _IMUS, context), identity))


def _temperature(index: int, imu: ImuCalibration) -> Iterator[tuple[str, float, int]]:
    """Yield name, value and type of the temperature's parameters.

    PX4 takes X1 d + X2 d^2 + X3 d^3 off the samples, d = T - TREF, with T no farther than TMIN and TMAX, before it
    applies CAL_ACC and CAL_GYRO.
    """
    found = imu.temperature
    if found is None:
        return
    for conversion in si_conversions(imu):
        coefficients = getattr(found, f"{conversion.triad}_bias")
        if coefficients is None:
            continue
        letter = conversion.triad[0].upper()
        yield f"TC_{letter}_ENABLE", 1, _INTEGER
        for name, value in (("TMIN", found.low_degc), ("TMAX", found.high_degc), ("TREF", found.reference_degc)):
            yield f"TC_{letter}{index}_{name}", value, _FLOAT
        for order in range(4):
            row = np.zeros(3) if not 1 <= order <= len(coefficients) else coefficients[order - 1] * conversion.factor
            for axis, value in enumerate(row.tolist()):
                yield f"TC_{letter}{index}_X{order}_{axis}", value, _FLOAT


def _names(index: int) -> ParameterNames:
    return ParameterNames(
        accelerometer_offset=f"CAL_ACC{index}_{{axis}}OFF",
        accelerometer_scale=f"CAL_ACC{index}_{{axis}}SCALE",
        gyroscope_offset=f"CAL_GYRO{index}_{{axis}}OFF",
    )
