"""PX4: parameters CAL_ACC0_XOFF, CAL_ACC0_XSCALE, CAL_GYRO0_XOFF, ..., in a file that ground stations load.

PX4 corrects f = (a - OFF) SCALE, element by element, and w = y - OFF, before it turns both from the sensor's axes to
the vehicle's. Read back by `formats.flight_parameters`.
"""

from ..results.calibration import Calibration
from .shared.flight_parameters import ParameterNames, flight_head, flight_losses, require_flight_imus
from .shared.losses import Context, Export, Loss

FILE = "px4.params"

_IMUS = 4  # accelerometers that PX4 calibrates
_FLOAT = 9  # MAVLink's type of a float
_HEAD = """\
# Sensor calibration for PX4, made by gnomon. With the samples a [m/s^2] and y [rad/s] of the topics sensor_accel and
# sensor_gyro, axis by axis:
#   specific force = (a - OFF) SCALE             angular rate = y - OFF
# Body frame {frame}; its axes are those of the samples. The parameters count only where CAL_ACC0_ID and CAL_GYRO0_ID
# are those of this sensor; they, CAL_..._PRIO and CAL_..._ROT are the vehicle's own and not in this file.
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
    head = flight_head(_HEAD, calibration, context)
    text = f"{head}#\n# Vehicle-Id Component-Id Name Value Type\n{''.join(rows)}"
    identity = Loss(
        what="identity of the sensor",
        why="PX4 takes the values only where CAL_ACC0_ID and CAL_GYRO0_ID are those of this sensor: calibrate it once "
        "with the ground station, then load this file.",
    )
    return Export(files={FILE: text}, losses=(*flight_losses(calibration, "PX4", _IMUS, context), identity))


def _names(index: int) -> ParameterNames:
    return ParameterNames(
        accelerometer_offset=f"CAL_ACC{index}_{{axis}}OFF",
        accelerometer_scale=f"CAL_ACC{index}_{{axis}}SCALE",
        gyroscope_offset=f"CAL_GYRO{index}_{{axis}}OFF",
    )
