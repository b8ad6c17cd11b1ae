"""imu_tk's .calib files: T (3x3), K (3x3), B (3) of one triad, white space between them; calibrated = T K (x - B)."""

from os import PathLike

import numpy as np

from ..calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..errors import FormatError
from ..models.project_forms import ImuTkTriad
from ..recording import Floats
from .foreign import ForeignCalibration, recognised_frame
from .structured import read_text


def read_imu_tk(
    accelerometer: str | PathLike[str],
    gyroscope: str | PathLike[str] | None = None,
    *,
    accelerometer_unit: str = "count",
    gyroscope_unit: str = "count",
) -> ForeignCalibration:
    """Read imu_tk's file of the accelerometer, and that of the gyroscope if there is one.

    Parameters
    ----------
    accelerometer, gyroscope : paths
    accelerometer_unit, gyroscope_unit : units of the samples that the files are for, which they do not say

    Raises
    ------
    FormatError
        If a file cannot be read, or holds anything else than 21 numbers with a diagonal K.
    """
    sensitivity, bias = _triad(accelerometer)
    imu = ImuCalibration(
        accelerometer=AccelerometerCalibration(sensitivity=sensitivity, bias=bias, unit=accelerometer_unit)
    )
    if gyroscope is not None:
        rate_sensitivity, rate_bias = _triad(gyroscope)
        imu = ImuCalibration(
            accelerometer=imu.accelerometer,
            gyroscope=GyroscopeCalibration(
                sensitivity=rate_sensitivity, bias=rate_bias, g_sensitivity=np.zeros((3, 3)), unit=gyroscope_unit
            ),
        )
    imus = {"imu0": imu}
    units = accelerometer_unit if gyroscope is None else f"{accelerometer_unit} and {gyroscope_unit}"
    return ForeignCalibration(
        imus=imus,
        frame=recognised_frame(imus),
        notes=(f"imu_tk's files do not state the unit of the samples; taken: {units}.",),
        format="imu_tk",
    )


def _triad(path: str | PathLike[str]) -> tuple[Floats, Floats]:
    words = read_text(path).split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise FormatError(f"{path}: {error}. Expected 21 numbers: T (3x3), K (3x3), B (3).") from None
    if len(numbers) != 21 or not np.isfinite(numbers).all():
        raise FormatError(f"{path}: found {len(numbers)} numbers, expected 21 finite ones: T (3x3), K (3x3), B (3).")
    T, K, B = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    if np.count_nonzero(K - np.diag(np.diag(K))) or not np.diag(K).all() or np.linalg.matrix_rank(T) < 3:
        raise FormatError(f"{path}: the second matrix, K, must be diagonal without zeros on it, and T of full rank.")
    return ImuTkTriad(T=T, K=np.diag(K).copy(), B=B).to_sensor()
