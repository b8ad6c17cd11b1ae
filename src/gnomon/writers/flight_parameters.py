"""What PX4's and ArduPilot's parameters have in common: offsets, and scales of the accelerometer, for each IMU.

The samples are those of the drivers, in m/s^2 and rad/s, with no calibration applied; see `writers.si_units`. The axes
of the body frame are those of the sensor as the drivers turn it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..errors import OptionError
from ..models.diagonal_forms import DiagonalTriad
from ..recording import Floats
from .context import Context
from .count_scales import refuse_counts
from .export import Loss, g_sensitivity_losses, magnetometer_losses, rig_losses, uncertainty_loss
from .sensor_losses import accelerometer_losses, rest_size, si_sensitivity
from .si_units import conversions

_NOTHING = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightImu:
    """One IMU by offsets and scales; a triad that was not calibrated is None."""

    accelerometer: DiagonalTriad | None = None
    gyroscope: DiagonalTriad | None = None


def flight_imu(imu: ImuCalibration) -> FlightImu:
    """Return an IMU as these projects describe it."""
    found: dict[str, DiagonalTriad] = {}
    for conversion in conversions(imu):
        if conversion.triad == "gyroscope":
            found["gyroscope"] = DiagonalTriad.offset_alone(conversion.bias_si)
        else:
            found["accelerometer"] = DiagonalTriad.nearest(si_sensitivity(imu, conversion), conversion.bias_si)
    return FlightImu(**found)


def require_flight_imus(calibration: Calibration, whose: str, most: int) -> dict[str, FlightImu]:
    """Return the IMUs that a program takes, by name.

    Raises
    ------
    OptionError
        If there is neither accelerometer nor gyroscope, or one is in counts.
    """
    refuse_counts(calibration, whose)
    imus = {name: flight_imu(imu) for name, imu in list(calibration.imus.items())[:most]}
    if not any(imu.accelerometer or imu.gyroscope for imu in imus.values()):
        raise OptionError(
            f"gnomon writes {whose}'s parameters of accelerometers and gyroscopes, and this calibration holds neither. "
            "Convert to c-header or csv."
        )
    return imus


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterNames:
    """What a program calls the parameters of one IMU, with {axis} for X, Y or Z."""

    accelerometer_offset: str
    accelerometer_scale: str
    gyroscope_offset: str

    def values(self, imu: FlightImu) -> Iterator[tuple[str, float]]:
        """Yield name and value of each."""
        known: list[tuple[str, Floats]] = []
        if imu.accelerometer is not None:
            known += [(self.accelerometer_offset, imu.accelerometer.offset)]
            known += [(self.accelerometer_scale, imu.accelerometer.scale)]
        if imu.gyroscope is not None:
            known += [(self.gyroscope_offset, imu.gyroscope.offset)]
        for name, triad in known:
            for axis, value in zip("XYZ", triad.tolist(), strict=True):
                yield name.format(axis=axis), value


def flight_head(head: str, calibration: Calibration, context: Context) -> str:
    """Return the comment above the parameters: `head` with the frame filled in, and the origin."""
    return head.format(frame=calibration.frame) + context.comment()


def flight_losses(calibration: Calibration, whose: str, most: int) -> Iterator[Loss]:
    """Yield what these parameters cannot hold."""
    yield from rig_losses(calibration, whose)
    for name in list(calibration.imus)[most:]:
        yield Loss(what=name, why=f"{whose} knows {most} IMUs.")
    for name, imu in list(calibration.imus.items())[:most]:
        flight = flight_imu(imu)
        for conversion in conversions(imu):
            triad: DiagonalTriad = getattr(flight, conversion.triad)
            rest = triad.rest(si_sensitivity(imu, conversion))
            if np.abs(rest).max() > _NOTHING:
                is_accelerometer = conversion.triad == "accelerometer"
                yield Loss(
                    what=f"{'misalignment' if is_accelerometer else 'scale and misalignment'} of the "
                    f"{conversion.triad} of {name}",
                    why=f"{whose} knows an offset and a scale for each axis; the scales are those that leave the least "
                    f"error over all attitudes in body frame {calibration.frame}."
                    if is_accelerometer
                    else f"{whose} knows an offset for each axis only. Use the c-header to correct the rest.",
                    size=rest_size(rest, conversion.triad),
                )
    yield from g_sensitivity_losses(calibration, whose)
    yield from accelerometer_losses(calibration, whose)
    yield from magnetometer_losses(calibration, whose)
    yield Loss(what="precision", why=f"{whose} keeps floats.", size="6e-8 relative")
    yield uncertainty_loss(whose)
