"""PX4 and ArduPilot, both ways: offsets and scales of accelerometers, offsets of gyroscopes, effects of temperature.

PX4 corrects f = (a - OFF) SCALE, ArduPilot f = (a - OFFS) SCAL, and both w = y - OFF, axis by axis, of samples in m/s^2
and rad/s; PX4 before it turns both from the sensor's axes to the vehicle's. Files are those of ground stations, of
"param set NAME VALUE", and NAME,VALUE or NAME VALUE: CAL_ACC0_XOFF, CAL_GYRO0_XOFF, ...; INS_ACCOFFS_X, ...
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import PathLike

import numpy as np
from numpy.polynomial import Polynomial

from ..errors import FormatError, OptionError
from ..frozen import value_class
from ..models.project_forms import DiagonalTriad
from ..recording import Floats
from ..results.calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..results.temperature_dependence import TemperatureDependence
from .foreign import ForeignCalibration, imu_in_si, recognised_frame
from .shared.losses import Context, Export, Loss
from .shared.sensor_losses import Holds, not_representable, rest_size, si_sensitivity
from .shared.si_units import refuse_counts, si_conversions
from .shared.structured import read_structured_text


@value_class
class FlightTemperature:
    """What is taken off the samples of an IMU.

    Attributes
    ----------
    found : the biases over the temperature
    at_reference : triad -> what is taken off at the reference, (3,) [m/s^2, rad/s]
    """

    found: TemperatureDependence
    at_reference: Mapping[str, Floats]


_PX4 = re.compile(r"CAL_(ACC|GYRO)(\d)_([XYZ])(OFF|SCALE)")
_ARDUPILOT = re.compile(r"INS_(ACC|GYR)(\d?)(OFFS|SCAL)_([XYZ])")
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(rf"^[ \t]*(?:\d+\s+\d+\s+|param\s+set(?:-default)?\s+)?([A-Z][A-Z0-9_]+)[ \t,=]+({_NUMBER})\b", re.M)
Key = tuple[int, str, str]
"""Index of the IMU from 0, "ACC" or "GYR", "offset" or "scale"."""


def is_flight_parameters(text: str) -> bool:
    """Return whether a text holds calibration parameters of PX4 or ArduPilot."""
    return any(_key(match[1]) is not None for match in _LINE.finditer(text))


def read_flight_parameters(path: str | PathLike[str]) -> ForeignCalibration:
    """Read the calibration among the parameters of PX4 or ArduPilot; axes that were not calibrated are ideal.

    Raises
    ------
    FormatError
        If the file cannot be read, or holds no such parameter, or a scale that is not above zero.
    """
    values: dict[Key, Floats] = {}
    every: dict[str, float] = {}
    format_name = ""
    for match in _LINE.finditer(read_structured_text(path)):
        every[match[1]] = float(match[2])
        found = _key(match[1])
        if found is None:
            continue
        format_name, (index, triad, what), axis = found
        row = values.setdefault((index, triad, what), np.full(3, 1.0 if what == "scale" else 0.0))
        row[axis] = float(match[2])
        if what == "scale" and not row[axis] > 0:
            raise FormatError(f"{path}: {match[1]} is {match[2]}, expected a number above zero.")
    if not values:
        raise FormatError(f"{path}: no parameter such as CAL_ACC0_XOFF or INS_ACCOFFS_X is in it.")
    imus = {
        f"imu{index}": _at_temperature(_imu(values, index), flight_temperature(every, index))
        for index in sorted({key[0] for key in values})
    }
    note = f"{format_name} knows no misalignment, and no scale of gyroscopes; taken: none."
    return ForeignCalibration(imus=imus, frame=recognised_frame(imus), notes=(note,), format=format_name)


def _key(name: str) -> tuple[str, Key, int] | None:
    """Return whose parameter it is, which one, and of which axis."""
    px4, ardupilot = _PX4.fullmatch(name), _ARDUPILOT.fullmatch(name)
    if px4 is not None:
        triad, index, axis, what = px4.groups()
        return "PX4", (int(index), triad[:3], "offset" if what == "OFF" else "scale"), "XYZ".index(axis)
    if ardupilot is not None:
        triad, number, what, axis = ardupilot.groups()
        index = int(number) - 1 if number else 0
        return "ArduPilot", (index, triad, "offset" if what == "OFFS" else "scale"), "XYZ".index(axis)
    return None


def _at_temperature(imu: ImuCalibration, warm: FlightTemperature | None) -> ImuCalibration:
    """Return an IMU that knows the temperature; what is taken off at the reference belongs to its biases."""
    if warm is None:
        return imu
    changed: dict[str, AccelerometerCalibration | GyroscopeCalibration] = {}
    for triad, constant in warm.at_reference.items():
        if (sensor := getattr(imu, triad)) is not None:
            changed[triad] = replace(sensor, bias=sensor.bias + constant)
    return replace(imu, temperature=warm.found, **changed)


def _imu(values: Mapping[Key, Floats], index: int) -> ImuCalibration:
    def triad(name: str) -> tuple[Floats, Floats] | None:
        if not any((index, name, what) in values for what in ("offset", "scale")):
            return None
        return DiagonalTriad(
            scale=values.get((index, name, "scale"), np.ones(3)),
            offset=values.get((index, name, "offset"), np.zeros(3)),
        ).to_sensor()

    return imu_in_si(triad("ACC"), triad("GYR"))


_NOTHING = 1e-12
_SHIFTED = {"accelerometer": 5.0, "gyroscope": 1.0}
"""Offset of every axis [m/s^2, rad/s] that no sensor has."""


@value_class
class FlightImu:
    """One IMU by offsets and scales; a triad that was not calibrated is None."""

    accelerometer: DiagonalTriad | None = None
    gyroscope: DiagonalTriad | None = None


def flight_imu(imu: ImuCalibration) -> FlightImu:
    """Return an IMU as these projects describe it."""
    found: dict[str, DiagonalTriad] = {}
    for conversion in si_conversions(imu):
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


@value_class(eq=True)
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


def flight_losses(calibration: Calibration, whose: str, most: int, context: Context) -> Iterator[Loss]:
    """Yield what these parameters cannot represent."""
    for name, imu in list(calibration.imus.items())[:most]:
        flight = flight_imu(imu)
        for conversion in si_conversions(imu):
            triad: DiagonalTriad = getattr(flight, conversion.triad)
            if np.abs(triad.offset).min() > _SHIFTED[conversion.triad]:
                yield Loss(
                    what=f"zero of the {conversion.triad} of {name}",
                    why=f"its counts seem to be unsigned, and drivers give {whose} signed ones: these offsets do not "
                    "fit them. Subtract the zero in the recording, such as 32768, and calibrate anew.",
                    size=f"every axis is off by {np.abs(triad.offset).min():.3g} {conversion.si} and more",
                )
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
    holds = Holds(
        program=whose, imus=most, cameras=0, samples_in_si=False, g_sensitivity=False, temperature=True,
        floats="keeps",
    )  # fmt: skip
    yield from not_representable(calibration, holds, context)


ARDUPILOT_REFERENCE_DEGC = 35.0
_TRIADS = {"accelerometer": ("A", "ACC"), "gyroscope": ("G", "GYR")}
_PX4_RANGE, _ARDUPILOT_RANGE = (0.0, 100.0), (0.0, 70.0)
"""Where the parameters state none: the programs' defaults [degC]."""


def flight_temperature(parameters: Mapping[str, float], index: int) -> FlightTemperature | None:
    """Return what the temperature changes of one IMU; None where it is not stated, or not enabled.

    Parameters
    ----------
    parameters : of one of the programs
    index : of the IMU, from 0
    """
    taken: dict[str, tuple[float, list[Polynomial]]] = {}
    ranges: list[tuple[float, float]] = []
    for triad, (letter, word) in _TRIADS.items():
        px4, ardupilot = f"TC_{letter}{index}_", f"INS_TCAL{index + 1}_"
        if parameters.get(f"TC_{letter}_ENABLE") and f"{px4}X1_0" in parameters:
            reference = parameters.get(f"{px4}TREF", 25.0)
            rows = [[parameters.get(f"{px4}X{order}_{axis}", 0.0) for order in range(4)] for axis in range(3)]
            taken[triad] = reference, [Polynomial(row) for row in rows]
            ranges.append(_range(parameters, px4, _PX4_RANGE))
        elif parameters.get(f"{ardupilot}ENABLE") and f"{ardupilot}{word}1_X" in parameters:
            reference = parameters.get(f"INS_{word}{index + 1}_CALTEMP", ARDUPILOT_REFERENCE_DEGC)
            about = Polynomial([reference - ARDUPILOT_REFERENCE_DEGC, 1.0])
            polynomials = list[Polynomial]()
            for axis in "XYZ":
                row = [1e-6 * parameters.get(f"{ardupilot}{word}{order}_{axis}", 0.0) for order in (1, 2, 3)]
                moved = Polynomial([0.0, *row])(about)
                polynomials.append(moved - moved(0.0))
            taken[triad] = reference, polynomials
            ranges.append(_range(parameters, ardupilot, _ARDUPILOT_RANGE))
    if not taken:
        return None
    reference = next(iter(taken.values()))[0]
    at_reference: dict[str, Floats] = {}
    biases: dict[str, Floats] = {}
    for triad, (own, polynomials) in taken.items():
        rows = np.zeros((4, 3))
        for axis, polynomial in enumerate(polynomials):
            coefficients = np.asarray(polynomial(Polynomial([reference - own, 1.0])).coef)
            rows[: len(coefficients), axis] = coefficients
        at_reference[triad] = rows[0]
        if (order := int(np.flatnonzero(rows.any(axis=1)).max(initial=0))) > 0:
            biases[f"{triad}_bias"] = rows[1 : order + 1]
    low, high = max(one[0] for one in ranges), min(one[1] for one in ranges)
    return FlightTemperature(
        found=TemperatureDependence(reference_degc=reference, low_degc=low, high_degc=high, lag_s=0.0, **biases),
        at_reference=at_reference,
    )


def _range(parameters: Mapping[str, float], prefix: str, usual: tuple[float, float]) -> tuple[float, float]:
    return parameters.get(f"{prefix}TMIN", usual[0]), parameters.get(f"{prefix}TMAX", usual[1])


PX4_FILE = "px4.params"
_PX4_IMUS = 4  # accelerometers that PX4 calibrates
_WARM_IMUS = 3  # of which it knows the temperature
_INTEGER, _FLOAT = 6, 9  # MAVLink's types
_PX4_HEAD = """\
# Sensor calibration for PX4, made by gnomon. With the samples a [m/s^2] and y [rad/s] of the topics sensor_accel and
# sensor_gyro, axis by axis:
#   specific force = (a - OFF) SCALE             angular rate = y - OFF
# Body frame {frame}; its axes are those of the samples. The parameters count only where CAL_ACC0_ID and CAL_GYRO0_ID
# are those of this sensor; they, CAL_..._PRIO and CAL_..._ROT are the vehicle's own and not in this file.
# Where the temperature was calibrated, TC_... is taken off the samples first; TC_A0_ID and TC_G0_ID, the vehicle's
# own, have to be those of this sensor.
# There is no place for cameras: T_cam_imu and the time shift are not in this file.
"""


def export_px4(calibration: Calibration, context: Context) -> Export:
    """Return `px4.params`.

    Raises
    ------
    OptionError
        If there is neither accelerometer nor gyroscope.
    """
    imus = require_flight_imus(calibration, "PX4", _PX4_IMUS)
    rows = [
        f"1\t1\t{name}\t{value!r}\t{_FLOAT}\n"
        for i, imu in enumerate(imus.values())
        for name, value in _px4_names(i).values(imu)
    ]
    rows += [
        f"1\t1\t{name}\t{value!r}\t{kind}\n"
        for i, imu in enumerate(list(calibration.imus.values())[:_WARM_IMUS])
        for name, value, kind in _px4_temperature(i, imu)
    ]
    head = _PX4_HEAD.format(frame=calibration.frame) + context.comment()
    text = f"{head}#\n# Vehicle-Id Component-Id Name Value Type\n{''.join(rows)}"
    identity = Loss(
        what="identity of the sensor",
        why="PX4 takes the values only where CAL_ACC0_ID and CAL_GYRO0_ID are those of this sensor: calibrate it once "
        "with the ground station, then load this file.",
    )
    return Export(files={PX4_FILE: text}, losses=(*flight_losses(calibration, "PX4", _PX4_IMUS, context), identity))


def _px4_temperature(index: int, imu: ImuCalibration) -> Iterator[tuple[str, float, int]]:
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


def _px4_names(index: int) -> ParameterNames:
    return ParameterNames(
        accelerometer_offset=f"CAL_ACC{index}_{{axis}}OFF",
        accelerometer_scale=f"CAL_ACC{index}_{{axis}}SCALE",
        gyroscope_offset=f"CAL_GYRO{index}_{{axis}}OFF",
    )


ARDUPILOT_FILE = "ardupilot.param"
_ARDUPILOT_IMUS = 3
_SCALES, _LARGEST_OFFSET = (0.8, 1.2), 3.5  # ranges of its parameters [1], [m/s^2]
_ARDUPILOT_HEAD = """\
# Sensor calibration for ArduPilot, made by gnomon. With samples a [m/s^2] and y [rad/s] as the drivers give them, axis
# by axis:
#   specific force = (a - OFFS) SCAL             angular rate = y - OFFS
# Body frame {frame}; its axes are those of the samples, before AHRS_ORIENTATION.
# There is no place for cameras: T_cam_imu and the time shift are not in this file.
"""


def export_ardupilot(calibration: Calibration, context: Context) -> Export:
    """Return `ardupilot.param`.

    Raises
    ------
    OptionError
        If there is neither accelerometer nor gyroscope.
    """
    imus = require_flight_imus(calibration, "ArduPilot", _ARDUPILOT_IMUS)
    rows = [
        f"{name},{value!r}\n" for i, imu in enumerate(imus.values()) for name, value in _ardupilot_names(i).values(imu)
    ]
    rows += [
        f"{name},{value!r}\n"
        for i, imu in enumerate(list(calibration.imus.values())[:_ARDUPILOT_IMUS])
        for name, value in _ardupilot_temperature(i, imu)
    ]
    head = _ARDUPILOT_HEAD.format(frame=calibration.frame) + context.comment()
    losses = (
        *flight_losses(calibration, "ArduPilot", _ARDUPILOT_IMUS, context),
        *_range_losses(imus),
        *_start_losses(imus),
    )
    return Export(files={ARDUPILOT_FILE: head + "".join(rows)}, losses=losses)


def _ardupilot_temperature(index: int, imu: ImuCalibration) -> Iterator[tuple[str, float]]:
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


def _ardupilot_names(index: int) -> ParameterNames:
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
