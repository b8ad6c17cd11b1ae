"""How to use a calibration: commands, Python and formulas with numbers, for each triad that was calibrated."""

from collections.abc import Iterator

from ..calibration import Calibration, ImuCalibration
from .imu_parameters import readable_unit
from .page import Code, Section
from .wording import matrix_text

_MEANT = {"accelerometer": "specific force f", "gyroscope": "angular rate ω", "magnetometer": "magnetic field h"}


def use_section(calibration: Calibration) -> Section:
    """Return commands, a few lines of Python, and the formulas with their numbers."""
    imus = calibration.imus
    to = "kalibr" if all(imu.accelerometer is not None for imu in imus.values()) else "csv"
    blocks = [
        Code(
            "On the command line",
            "gnomon apply calibration.yaml RECORDING -o calibrated.csv\n"
            "gnomon show calibration.yaml\n"
            f"gnomon convert calibration.yaml --to {to}",
        )
    ]
    for name, imu in imus.items():
        blocks.append(
            Code(
                "In Python" if len(imus) == 1 else f"In Python, {name}",
                "import gnomon\n\n"
                'calibration = gnomon.load("calibration.yaml")\n'
                f'samples = gnomon.{_reader(imu)}("RECORDING").imus[{name!r}]\n'
                f"calibrated = calibration.imus[{name!r}].apply(samples)\n"
                f"# {_units(imu)}, in the body frame",
            )
        )
        blocks += _formulas(imu)
    meant = [text for triad, text in _MEANT.items() if any(getattr(imu, triad) is not None for imu in imus.values())]
    listed = " and ".join(filter(None, (", ".join(meant[:-1]), meant[-1])))
    return Section(
        "use", "How to use it", f"The calibration maps what the sensor reads to {listed} in the body frame.", blocks
    )


def _reader(imu: ImuCalibration) -> str:
    alone = imu.accelerometer is None and imu.magnetometer is None
    return "read_turntable" if alone else "read"


def _units(imu: ImuCalibration) -> str:
    units = ["m/s²"] if imu.accelerometer is not None else []
    units += ["rad/s"] if imu.gyroscope is not None else []
    if imu.magnetometer is not None:
        units.append("µT" if imu.magnetometer.field_unit == "uT" else "in units of the local field")
    return " and ".join(filter(None, (", ".join(units[:-1]), units[-1])))


def _formulas(imu: ImuCalibration) -> Iterator[Code]:
    if (accelerometer := imu.accelerometer) is not None:
        text = "m = S f + b          f = S⁻¹ (m − b)\n\n" + matrix_text("S", accelerometer.sensitivity)
        text += "\n\n" + matrix_text("b", accelerometer.bias[:, None])
        yield Code(f"Accelerometer: m in {accelerometer.unit}, f in m/s²", text)
    if (gyroscope := imu.gyroscope) is not None:
        felt = imu.accelerometer is not None or bool(gyroscope.g_sensitivity.any())
        text = "y = S ω + b + G f    ω = S⁻¹ (y − b − G f)" if felt else "y = S ω + b          ω = S⁻¹ (y − b)"
        text += "\n\n" + matrix_text("S", gyroscope.sensitivity)
        text += "\n\n" + matrix_text("b", gyroscope.bias[:, None])
        text += "\n\n" + matrix_text("G", gyroscope.g_sensitivity) if felt else ""
        yield Code(f"Gyroscope: y in {gyroscope.unit}, ω in rad/s", text)
    if (magnetometer := imu.magnetometer) is not None:
        text = "c = S h + b          h = S⁻¹ (c − b)\n\n" + matrix_text("S", magnetometer.sensitivity)
        text += "\n\n" + matrix_text("b", magnetometer.bias[:, None])
        field = "µT" if magnetometer.field_unit == "uT" else "units of the local field"
        yield Code(f"Magnetometer: c in {readable_unit(magnetometer.unit)}, h in {field}", text)
