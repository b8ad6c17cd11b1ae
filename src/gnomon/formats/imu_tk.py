"""imu_tk's .calib files: T (3x3), K (3x3), B (3) of one triad, white space between them; calibrated = T K (x - B).

What gnomon says behind the numbers, in lines that begin with #, imu_tk does not read; the unit of the samples is in it.
"""

import re
from os import PathLike
from typing import Any

import numpy as np

from ..errors import FormatError, OptionError
from ..models.forms import in_frame
from ..models.project_forms import ImuTkTriad
from ..recording import Floats
from ..results.calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .foreign import ForeignCalibration, recognised_frame
from .shared.losses import Context, Export, Loss, into_frame, numbers_text
from .shared.sensor_losses import Holds, not_representable
from .shared.structured import read_structured_text

_COMMENT = re.compile(r"(?m)^[ \t]*#.*$")
_UNITS = re.compile(r"(?m)^#.*value \[(m/s\^2|rad/s)\] = T K \(sample \[([^\]]*)\] - B\)")


def is_imu_tk(text: str) -> bool:
    """Return whether a text is one triad in imu_tk's layout: 21 numbers, and comments."""
    plain = _COMMENT.sub("", text)
    return re.fullmatch(r"[\s\d.eE+-]+", plain) is not None and len(plain.split()) == 21


def stated_triad(text: str) -> str:
    """Return "accelerometer" or "gyroscope" where a comment of gnomon's tells; "" else."""
    found = _UNITS.search(text)
    return {"m/s^2": "accelerometer", "rad/s": "gyroscope"}[found[1]] if found else ""


def read_imu_tk(
    accelerometer: str | PathLike[str] | None = None,
    gyroscope: str | PathLike[str] | None = None,
    *,
    accelerometer_unit: str = "count",
    gyroscope_unit: str = "count",
) -> ForeignCalibration:
    """Read imu_tk's file of the accelerometer, that of the gyroscope, or both.

    Parameters
    ----------
    accelerometer, gyroscope : paths
    accelerometer_unit, gyroscope_unit : units of the samples that the files are for, where a comment of gnomon's does
        not tell

    Raises
    ------
    FormatError
        If a file cannot be read, or holds anything else than 21 numbers with a diagonal K.
    """
    triads: dict[str, Any] = {}
    assumed: list[str] = []
    if accelerometer is not None:
        sensitivity, bias, stated = _read_triad(accelerometer, ACCELEROMETER_UNITS_M_S2)
        assumed += [] if stated else [accelerometer_unit]
        triads["accelerometer"] = AccelerometerCalibration(
            sensitivity=sensitivity, bias=bias, unit=stated or accelerometer_unit
        )
    if gyroscope is not None:
        sensitivity, bias, stated = _read_triad(gyroscope, GYROSCOPE_UNITS_RAD_S)
        assumed += [] if stated else [gyroscope_unit]
        triads["gyroscope"] = GyroscopeCalibration(
            sensitivity=sensitivity, bias=bias, g_sensitivity=np.zeros((3, 3)), unit=stated or gyroscope_unit
        )
    imus = {"imu0": ImuCalibration(**triads)}
    note = f"imu_tk's files do not state the unit of the samples; taken: {' and '.join(assumed)}."
    return ForeignCalibration(
        imus=imus, frame=recognised_frame(imus), notes=(note,) if assumed else (), format="imu_tk"
    )


def _read_triad(path: str | PathLike[str], known: dict[str, float | None]) -> tuple[Floats, Floats, str]:
    """Return sensitivity, bias, and the unit of the samples, "" where it is not stated."""
    text = read_structured_text(path)
    words = _COMMENT.sub("", text).split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise FormatError(f"{path}: {error}. Expected 21 numbers: T (3x3), K (3x3), B (3).") from None
    if len(numbers) != 21 or not np.isfinite(numbers).all():
        raise FormatError(f"{path}: found {len(numbers)} numbers, expected 21 finite ones: T (3x3), K (3x3), B (3).")
    T, K, B = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    if np.count_nonzero(K - np.diag(np.diag(K))) or not np.diag(K).all() or np.linalg.matrix_rank(T) < 3:
        raise FormatError(f"{path}: the second matrix, K, must be diagonal without zeros on it, and T of full rank.")
    found = _UNITS.search(text)
    return *ImuTkTriad(T=T, K=np.diag(K).copy(), B=B).to_sensor(), found[2] if found and found[2] in known else ""


HOLDS = Holds(program="imu_tk", cameras=0, samples_in_si=False, g_sensitivity=False)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `imu0_acc.calib` and `imu0_gyro.calib` for each IMU, of the triads that there are.

    Raises
    ------
    OptionError
        If T cannot have a unit diagonal, or there is neither accelerometer nor gyroscope.
    """
    moved, losses = _moved(calibration)
    files: dict[str, str] = {}
    units: set[str] = set()
    for name, imu in moved.imus.items():
        if imu.accelerometer is not None:
            upper = in_frame(imu.accelerometer.sensitivity, ImuTkTriad.frame)
            files[f"{name}_acc.calib"] = _triad_text(
                upper, imu.accelerometer.bias, imu.accelerometer.unit, "m/s^2", context
            )
            units.add(imu.accelerometer.unit)
        if imu.gyroscope is not None:
            files[f"{name}_gyro.calib"] = _triad_text(
                imu.gyroscope.sensitivity, imu.gyroscope.bias, imu.gyroscope.unit, "rad/s", context
            )
            units.add(imu.gyroscope.unit)
    if not files:
        raise OptionError(
            "imu_tk knows accelerometers and gyroscopes, and this calibration holds neither. "
            "Convert to c-header or csv, which know magnetometers."
        )
    unit = Loss(
        what="unit of the samples",
        why=f"the samples have to be in {' and '.join(sorted(units))}; a comment behind the numbers says so, which "
        "imu_tk does not read.",
    )
    return Export(
        files=files,
        losses=(*losses, unit, *not_representable(moved, HOLDS, context)),
    )


def _moved(calibration: Calibration) -> tuple[Calibration, tuple[Loss, ...]]:
    """Return the calibration in imu_tk's frame, which accelerometers define; without them any frame will do."""
    if any(imu.accelerometer is not None for imu in calibration.imus.values()):
        return into_frame(calibration, ImuTkTriad.frame, "imu_tk's")
    return calibration, ()


def _triad_text(sensitivity: Floats, bias: Floats, unit: str, si: str, context: Context) -> str:
    form = ImuTkTriad.from_sensor(sensitivity, bias)
    blocks = (form.T, np.diag(form.K), form.B[:, None])
    numbers = "\n".join("".join(f"{numbers_text(row)}\n" for row in block) for block in blocks)
    return f"{numbers}\n# Made by gnomon: value [{si}] = T K (sample [{unit}] - B).\n{context.comment()}"
