"""ArduPilot: parameters INS_ACCOFFS_X, INS_ACCSCAL_X, INS_GYROFFS_X, ..., in a file that ground stations load.

ArduPilot corrects f = (a - OFFS) SCAL, element by element, and w = y - OFFS, in the sensor's axes. Read back by
`formats.flight_parameters`.
"""

from collections.abc import Iterator, Mapping

from ..results.calibration import Calibration
from .shared.flight_parameters import FlightImu, ParameterNames, flight_head, flight_losses, require_flight_imus
from .shared.losses import Context, Export, Loss

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
    head = flight_head(_HEAD, calibration, context)
    losses = (*flight_losses(calibration, "ArduPilot", _IMUS, context), *_range_losses(imus), *_start_losses(imus))
    return Export(files={FILE: head + "".join(rows)}, losses=losses)


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
