"""Kalibr: `imu.yaml` with the model of each IMU, as Kalibr itself writes its results, and the cameras' chain.

Kalibr's samples are in m/s^2 and rad/s; see `writers.si_units`. Read back by `readers.projects.kalibr_imu`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..models.noise import ImuNoise
from ..models.project_forms import KalibrAccelerometer, KalibrGyroscope
from ..recording import Floats
from .context import Context, StatedImu
from .export import Export, Loss, into_frame, magnetometer_losses, require_triads, uncertainty_loss
from .kalibr_camchain import CAMCHAIN_FILE, LENS_FILE, camchain_text, lens_chain_text
from .kalibr_text import kalibr_yaml
from .lens_fit import k3_losses
from .sensor_losses import bias_losses, noise_losses, triad_shift_losses
from .si_units import conversions, count_losses

IMU_FILE = "imu.yaml"

_HEADER = """\
# IMU intrinsics in Kalibr's layout (model {model}), made by gnomon.
# With specific force f [m/s^2] and angular rate w [rad/s] in the IMU's frame (x along the sensitivity axis of the x
# accelerometer, the axis of the y accelerometer in the x-y plane){equations}
"""
_EQUATIONS = """\
, and C = C_gyro_i:
#   accelerometer [m/s^2] = M f + bias                gyroscope [rad/s] = M C w + A C f + bias"""
_SIZE_EFFECT = """\
# Component k of the f that the accelerometer feels is that at the k-th of rx_i, ry_i, rz_i, which stand from the body's
# origin [m]. (Kalibr's own estimates have rx_i = 0: their origin is the x accelerometer.)
"""
_IDEAL_EQUATIONS = """\
:
#   accelerometer [m/s^2] = f + bias                  gyroscope [rad/s] = w + bias"""


_SEVERAL = "Several IMUs: p_imu = T_i_b p_imu0 [m], t_imu0 = t_imu + time_offset [s]."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalibrModel:
    """One IMU as Kalibr describes it, for samples in m/s^2 and rad/s.

    Attributes
    ----------
    name : "calibrated" for an ideal sensor, else "scale-misalignment", with lever arms
        "scale-misalignment-size-effect"
    M_accel : (3, 3) [1], lower triangular
    M_gyro, A_gyro, C_gyro_i : (3, 3) [1], [rad/s per m/s^2], [1]; None without a gyroscope
    lever_arms_m : (3, 3) where the x, y and z accelerometers sit, one row each; or None
    """

    name: str
    M_accel: Floats
    M_gyro: Floats | None = None
    A_gyro: Floats | None = None
    C_gyro_i: Floats | None = None
    lever_arms_m: Floats | None = None


def export(calibration: Calibration, context: Context) -> Export:
    """Return `imu.yaml`, and `camchain-imucam.yaml` where there are cameras; of cameras alone `camchain.yaml`.

    Raises
    ------
    OptionError
        If an IMU has no accelerometer, which defines Kalibr's frame.
    """
    if not calibration.imus:
        text = lens_chain_text(calibration, context.comment())
        losses = (*k3_losses(calibration, "Kalibr"), uncertainty_loss("Kalibr"))
        return Export(files={LENS_FILE: text}, losses=losses)
    require_triads(calibration, "kalibr", "accelerometer", otherwise="imu_tk, c-header or csv")
    moved, losses = into_frame(calibration, KalibrAccelerometer.frame, "Kalibr's")
    found = list(losses)
    for name, imu in moved.imus.items():
        found.extend(_losses(moved, name, imu))
    found.extend(triad_shift_losses(moved, "Kalibr"))
    found.extend(magnetometer_losses(moved, "kalibr"))
    found.extend(k3_losses(moved, "Kalibr"))
    for name in moved.imus:
        found.extend(noise_losses(context.of(name), "Kalibr", "needs them in its input: add them by hand"))
    files = {IMU_FILE: imu_text(moved, context.stated, context.comment())}
    if moved.cameras:
        files[CAMCHAIN_FILE] = camchain_text(moved, context.comment())
    return Export(files=files, losses=(*found, uncertainty_loss("kalibr")))


def imu_text(calibration: Calibration, stated: Mapping[str, StatedImu] | None = None, remarks: str = "") -> str:
    """Return the text of `imu.yaml` for a calibration in Kalibr's body frame, accel-x.

    Parameters
    ----------
    stated : "imu0", ... -> noise, rate and topic; without them the file says that they have to be added
    remarks : lines of comment
    """
    stated = stated or {}
    names: set[str] = set()
    comments: list[str] = [_SEVERAL] if len(calibration.imus) > 1 else []
    document: dict[str, Any] = {}
    for name, imu in calibration.imus.items():
        model = kalibr_model(imu)
        names.add(model.name)
        comments += [f"{name}: {line}" for conversion in conversions(imu) for line in conversion.lines()]
        document[name] = _entry(model, pose_in_kalibr(calibration, name))
        shift = imu.required_accelerometer.time_shift_s
        if shift:
            comments.append(f"{name}: t_gyroscope = t_accelerometer + {shift!r} s, for which Kalibr has no key.")
        if name in stated:
            document[name] |= stated_entry(stated[name])
            comments += [f"{name}: {line}" for line in stated[name].comments]
    keys = (*ImuNoise.__slots__, "update_rate", "rostopic")
    missing = [key for key in keys if any(key not in entry for entry in document.values())]
    if missing:
        comments.append(f"Kalibr also needs {', '.join(missing)}: add them before you use this file as its input.")
    equations = _IDEAL_EQUATIONS if names == {"calibrated"} else _EQUATIONS
    header = _HEADER.format(model=" and ".join(sorted(names)), equations=equations)
    header += _SIZE_EFFECT if "scale-misalignment-size-effect" in names else ""
    return header + remarks + "".join(f"# {line}\n" for line in comments) + kalibr_yaml(document)


def kalibr_model(imu: ImuCalibration) -> KalibrModel:
    """Return an IMU in Kalibr's terms; it must be in body frame accel-x."""
    sensor = imu.required_accelerometer
    factors = [conversion.factor for conversion in conversions(imu)]
    M_accel = KalibrAccelerometer.from_sensor(sensor.sensitivity, sensor.bias).M * factors[0]
    arms = sensor.lever_arms_m
    ideal = _is_identity(M_accel)
    if imu.gyroscope is None:
        return KalibrModel(name=_model_name(arms, ideal=ideal), M_accel=M_accel, lever_arms_m=arms)
    ideal &= _is_identity(imu.gyroscope.sensitivity * factors[1]) and not imu.gyroscope.g_sensitivity.any()
    gyroscope = KalibrGyroscope.from_sensor(imu.gyroscope.sensitivity, imu.gyroscope.bias, imu.gyroscope.g_sensitivity)
    return KalibrModel(
        name=_model_name(arms, ideal=ideal),
        M_accel=M_accel,
        M_gyro=gyroscope.M * factors[1],
        A_gyro=gyroscope.A * factors[1],
        C_gyro_i=gyroscope.C_gyro_i,
        lever_arms_m=arms,
    )


def _model_name(arms: Floats | None, *, ideal: bool) -> str:
    if arms is not None:
        return "scale-misalignment-size-effect"
    return "calibrated" if ideal else "scale-misalignment"


def _is_identity(matrix: Floats) -> bool:
    return bool(np.abs(matrix - np.eye(3)).max() < 1e-12)


def pose_in_kalibr(calibration: Calibration, name: str) -> tuple[Floats, float] | None:
    """Return Kalibr's T_i_b (4, 4) [m] and time_offset [s] of an IMU; None where they were not measured."""
    imu = calibration.imus[name]
    if imu.T_imu_body is not None:
        return imu.T_imu_body, float(imu.time_shift_s)
    return (np.eye(4), 0.0) if name == next(iter(calibration.imus)) else None


def _entry(model: KalibrModel, pose: tuple[Floats, float] | None) -> dict[str, Any]:
    entry: dict[str, Any] = {"model": model.name}
    if pose is not None:
        entry |= dict(zip(("T_i_b", "time_offset"), pose, strict=True))
    if model.name == "calibrated":
        return entry
    entry["accelerometers"] = {"M": model.M_accel}
    if model.lever_arms_m is not None:
        entry["accelerometers"] |= dict(zip(("rx_i", "ry_i", "rz_i"), model.lever_arms_m, strict=True))
    if model.M_gyro is not None:
        entry["gyroscopes"] = {"M": model.M_gyro, "A": model.A_gyro, "C_gyro_i": model.C_gyro_i}
    return entry


def stated_entry(stated: StatedImu) -> dict[str, Any]:
    """Return noise, rate and topic by Kalibr's keys, as far as they are known."""
    entry: dict[str, Any] = {}
    if stated.noise is not None:
        entry |= {name: float(value) for name, value in asdict(stated.noise).items()}
    if stated.update_rate_hz is not None:
        entry["update_rate"] = float(stated.update_rate_hz)
    return entry | ({"rostopic": stated.topic} if stated.topic else {})


def _losses(calibration: Calibration, name: str, imu: ImuCalibration) -> Iterator[Loss]:
    yield from count_losses(name, imu, "Kalibr")
    yield from bias_losses(name, imu, "Kalibr")
    if pose_in_kalibr(calibration, name) is None:
        yield Loss(what=f"pose of {name}", why="how the IMUs lie to each other was not measured: T_i_b is left out.")
