"""What a foreign format cannot hold, said in words and numbers."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import degrees

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..errors import OptionError
from ..findings import listed
from ..models.frames import Floats, frame_rotation
from ..units import STANDARD_GRAVITY_M_S2
from .lens_formats import formats_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """One thing that a converted file does not say, or says otherwise.

    Attributes
    ----------
    what : what is lost or changed, such as "g-sensitivity"
    why : why the format cannot hold it, and what to do
    size : how much it matters, with its unit; may be empty
    """

    what: str
    why: str
    size: str = ""

    def __str__(self) -> str:
        return f"{self.what}{f' ({self.size})' if self.size else ''}: {self.why}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """A calibration in a foreign format: texts by file name, and what they do not say."""

    files: Mapping[str, str]
    losses: tuple[Loss, ...] = field(default=())


def require_triads(calibration: Calibration, format_name: str, *triads: str, otherwise: str) -> None:
    """Refuse a calibration whose IMUs lack a triad that a format cannot do without.

    Parameters
    ----------
    triads : "accelerometer", "gyroscope"
    otherwise : the formats that can do without

    Raises
    ------
    OptionError
        If one is missing.
    """
    for name, imu in calibration.imus.items():
        missing = next((triad for triad in triads if getattr(imu, triad) is None), None)
        if missing is not None:
            raise OptionError(
                f"{format_name} needs {' and '.join(triads)}, and this calibration holds no {missing} of {name}. "
                f"Convert to {otherwise}, or calibrate {missing} too."
            )


def into_frame(calibration: Calibration, frame: str, whose: str) -> tuple[Calibration, tuple[Loss, ...]]:
    """Return the calibration in the frame that a format prescribes, and what its reader has to know about it."""
    if calibration.frame == frame:
        return calibration, ()
    another = "another" if calibration.cameras else "a"  # those of the calibration are turned with it
    turns = {
        name: frame_rotation(imu.required_accelerometer.sensitivity, frame) for name, imu in calibration.imus.items()
    }
    losses = tuple(
        Loss(
            what=f"body frame of {name}",
            why=f"{whose} frame is {frame}, the calibration's is {calibration.frame}. Turn whatever else is known in "
            f"the old frame, such as the pose of {another} camera, by R_new_old = {matrix_text(turn)}.",
            size=f"turned by {degrees(rotation_angle(turn)):.3g} deg",
        )
        for name, turn in turns.items()
    )
    return calibration.in_frame(frame), losses


def uncertainty_loss(format_name: str) -> Loss:
    """Say that sigmas, assessment and origin stay behind."""
    return Loss(
        what="uncertainty and origin",
        why=f"{format_name} has no place for sigmas, covariance, verdict and provenance. Keep calibration.yaml.",
    )


def magnetometer_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format has no place for magnetometers."""
    for name, imu in calibration.imus.items():
        if imu.magnetometer is not None:
            yield Loss(
                what=f"magnetometer of {name}",
                why=f"{format_name} knows none. Use c-header or csv to write it too, or keep calibration.yaml.",
            )


def rig_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format of inertial sensors has no place for cameras, nor for where several IMUs are."""
    if calibration.cameras:
        yield Loss(
            what=", ".join(calibration.cameras),
            why=f"{format_name} knows no cameras: T_cam_imu, time shift and lens are left out. "
            f"Use {listed(formats_of(c.camera for c in calibration.cameras.values()))} to write them too, or keep "
            "calibration.yaml.",
        )
    for name, imu in calibration.imus.items():
        if imu.T_imu_body is not None:
            yield Loss(
                what=f"pose and clock of {name}",
                why=f"{format_name} does not say how IMUs lie to each other: T_imu_body and time shift are left out. "
                "Use kalibr, json or csv to write them too.",
                size=f"{1e3 * float(np.linalg.norm(imu.T_imu_body[:3, 3])):.3g} mm, {1e3 * imu.time_shift_s:+.6g} ms",
            )


def g_sensitivity_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say what leaving out the g-sensitivity costs, for each gyroscope that has one."""
    for name, imu in calibration.imus.items():
        size = g_sensitivity_rate(imu)
        if size:
            yield Loss(
                what=f"g-sensitivity of {name}",
                why=f"{format_name} knows no gyroscope bias that depends on the specific force. Use kalibr, "
                "openvins, imucal, c-header or csv to keep it, or calibrate with --model basic so that the bias "
                "absorbs what it can.",
                size=f"up to {size:.2g} rad/s = {degrees(size):.2g} deg/s at 1 g",
            )


def g_sensitivity_rate(imu: ImuCalibration) -> float:
    """Return the largest rate that the g-sensitivity feigns at 1 g, over all attitudes [rad/s]."""
    if imu.gyroscope is None:
        return 0.0
    response = np.linalg.inv(imu.gyroscope.sensitivity) @ imu.gyroscope.g_sensitivity
    return float(np.linalg.norm(response, 2)) * STANDARD_GRAVITY_M_S2


def rotation_angle(rotation: Floats) -> float:
    """Return the angle of a rotation matrix (3, 3) [rad]."""
    sine = np.linalg.norm(rotation - rotation.T) / (2 * np.sqrt(2))
    return float(np.arctan2(sine, (np.trace(rotation) - 1) / 2))


def matrix_text(matrix: Floats) -> str:
    """Return a matrix (3, 3) as one line."""
    return f"[{'; '.join(' '.join(f'{value:.9g}' for value in row) for row in matrix)}]"


def numbers_text(values: Floats, separator: str = " ") -> str:
    """Return numbers that read back bit by bit."""
    return separator.join(map(repr, values.tolist()))
