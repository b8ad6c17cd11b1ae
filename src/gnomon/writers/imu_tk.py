"""imu_tk: for each triad a file of T (3x3), K (3x3) and B (3), white space between them; calibrated = T K (x - B).

The format has no comments. Read back by `readers.imu_tk_calib`.
"""

import numpy as np

from ..calibration import Calibration
from ..errors import OptionError
from ..models.forms import in_frame
from ..models.project_forms import ImuTkTriad
from ..recording import Floats
from .export import (
    Export,
    Loss,
    camera_losses,
    g_sensitivity_losses,
    into_frame,
    magnetometer_losses,
    numbers_text,
    uncertainty_loss,
)


def export(calibration: Calibration) -> Export:
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
            files[f"{name}_acc.calib"] = _text(upper, imu.accelerometer.bias)
            units.add(imu.accelerometer.unit)
        if imu.gyroscope is not None:
            files[f"{name}_gyro.calib"] = _text(imu.gyroscope.sensitivity, imu.gyroscope.bias)
            units.add(imu.gyroscope.unit)
    if not files:
        raise OptionError(
            "imu_tk knows accelerometers and gyroscopes, and this calibration holds neither. "
            "Convert to c-header or csv, which know magnetometers."
        )
    unit = Loss(
        what="unit of the samples",
        why=f"the files do not say that they take samples in {' and '.join(sorted(units))} to m/s^2 and rad/s.",
    )
    return Export(
        files=files,
        losses=(
            *camera_losses(moved, "imu_tk"),
            *g_sensitivity_losses(moved, "imu_tk"),
            *magnetometer_losses(moved, "imu_tk"),
            *losses,
            unit,
            uncertainty_loss("imu_tk"),
        ),
    )


def _moved(calibration: Calibration) -> tuple[Calibration, tuple[Loss, ...]]:
    """Return the calibration in imu_tk's frame, which accelerometers define; without them any frame will do."""
    if any(imu.accelerometer is not None for imu in calibration.imus.values()):
        return into_frame(calibration, ImuTkTriad.frame, "imu_tk's")
    return calibration, ()


def _text(sensitivity: Floats, bias: Floats) -> str:
    form = ImuTkTriad.from_sensor(sensitivity, bias)
    blocks = (form.T, np.diag(form.K), form.B[:, None])
    return "\n".join("".join(f"{numbers_text(row)}\n" for row in block) for block in blocks)
