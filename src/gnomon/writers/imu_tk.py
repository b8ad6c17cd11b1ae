"""imu_tk: for each triad a file of T (3x3), K (3x3) and B (3), white space between them; calibrated = T K (x - B).

The format has no comments, but imu_tk reads no further than the numbers: what has to be said stands behind them. Read
back by `readers.projects.imu_tk_calib`.
"""

import numpy as np

from ..calibration import Calibration
from ..errors import OptionError
from ..models.forms import in_frame
from ..models.project_forms import ImuTkTriad
from ..recording import Floats
from .context import Context
from .export import (
    Export,
    Loss,
    g_sensitivity_losses,
    into_frame,
    magnetometer_losses,
    numbers_text,
    rig_losses,
    uncertainty_loss,
)
from .sensor_losses import accelerometer_losses


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
            files[f"{name}_acc.calib"] = _text(upper, imu.accelerometer.bias, imu.accelerometer.unit, "m/s^2", context)
            units.add(imu.accelerometer.unit)
        if imu.gyroscope is not None:
            files[f"{name}_gyro.calib"] = _text(
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
        losses=(
            *rig_losses(moved, "imu_tk"),
            *g_sensitivity_losses(moved, "imu_tk"),
            *accelerometer_losses(moved, "imu_tk"),
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


def _text(sensitivity: Floats, bias: Floats, unit: str, si: str, context: Context) -> str:
    form = ImuTkTriad.from_sensor(sensitivity, bias)
    blocks = (form.T, np.diag(form.K), form.B[:, None])
    numbers = "\n".join("".join(f"{numbers_text(row)}\n" for row in block) for block in blocks)
    return f"{numbers}\n# Made by gnomon: value [{si}] = T K (sample [{unit}] - B).\n{context.comment()}"
