"""Kalibr's imu.yaml as input: noise, rate and topic of each IMU; flat, or keyed imu0, imu1, ... as Kalibr writes it."""

from collections.abc import Iterator, Mapping
from os import PathLike
from typing import Any

import numpy as np

from ...frozen import field_names, value_class
from ...models.forms import KalibrAccelerometer, KalibrGyroscope
from ...recording import Floats
from ...recording.samples import ImuNoise
from ...results.calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..foreign import ForeignCalibration, ForeignImu, ideal_imu, recognised_frame
from ..openvins import OPENVINS_KEYS, openvins_imu
from ..shared.foreign_yaml import (
    file_name,
    passed_over,
    read_foreign_yaml,
    read_matrix,
    read_rotation,
    read_sensors,
    read_transform,
    required_value,
)
from ..shared.losses import (
    Context,
    Export,
    Loss,
    StatedImu,
    into_frame,
    k3_losses,
    require_triads,
    stated_entry,
    uncertainty_loss,
)
from ..shared.sensor_losses import Holds, not_representable
from ..shared.si_units import si_conversions
from ..shared.structured import Node
from ..shared.yaml_text import kalibr_yaml
from .camchain import CAMCHAIN_FILE, LENS_FILE, camchain_text, lens_chain_text

_EXPECTED = "Kalibr's imu.yaml, with the noise densities and random walks at the top or under imu0"
_UNITS = {
    "accelerometer_noise_density": "m/s^2/sqrt(Hz)",
    "accelerometer_random_walk": "m/s^3/sqrt(Hz)",
    "gyroscope_noise_density": "rad/s/sqrt(Hz)",
    "gyroscope_random_walk": "rad/s^2/sqrt(Hz)",
}
_INPUT_RATES = ("update_rate", "rate_hz")  # Kalibr, EuRoC's sensor.yaml
_MODEL = {"accelerometers", "gyroscopes", "Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC"}
_IGNORED = {"rostopic", "model", "T_i_b", "time_offset", *_UNITS, *_INPUT_RATES, *_MODEL}


@value_class
class ImuInput:
    """What Kalibr's imu.yaml says of one IMU.

    Attributes
    ----------
    noise : densities and random walks
    update_rate_hz : sample rate [Hz], or None where it is not stated
    topic : ROS topic, or ""
    T_imu_body : (4, 4) of an IMU beside imu0, p_imu = T_imu_body @ p_imu0, where it is stated
    time_shift_s : t_imu0 = t_imu + time_shift_s, likewise [s]
    """

    noise: ImuNoise
    update_rate_hz: float | None
    topic: str
    T_imu_body: Floats | None = None
    time_shift_s: float | None = None


def read_imu_input(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, ImuInput]:
    """Read the noise of IMUs from Kalibr's imu.yaml.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was passed over are appended

    Returns
    -------
    mapping from "imu0", "imu1", ... to ImuInput

    Raises
    ------
    FormatError
        If the file cannot be read, or a noise is missing or not above zero.
    """
    said: list[str] = [] if notes is None else notes
    root = read_foreign_yaml(path, said)
    imus = read_sensors(root, "imu", "accelerometer_noise_density", _EXPECTED)
    if root not in imus.values():
        passed_over((node for node in root.entries() if node.key not in imus), said)
    return {name: _imu(node, said, is_body=number == 0) for number, (name, node) in enumerate(imus.items())}


def _imu(node: Node, notes: list[str], *, is_body: bool) -> ImuInput:
    keys = {child.key: child for child in node.entries()}
    noise = {name: _positive(required_value(keys, name, node, f"a number in {unit}")) for name, unit in _UNITS.items()}
    model = [key for key in keys if key in _MODEL]
    if model:
        notes.append(
            f"{file_name(node)}: the sensor model in it ({', '.join(model)}) was passed over; it is estimated anew."
        )
    if is_body and "time_offset" in keys and keys["time_offset"].number() != 0:
        passed_over([keys["time_offset"]], notes)
    placed = not is_body and "T_i_b" in keys
    passed_over((child for key, child in keys.items() if key not in _IGNORED), notes)
    rate = next((_positive(keys[name]) for name in _INPUT_RATES if name in keys), None)
    topic = keys["rostopic"].text() if "rostopic" in keys else ""
    return ImuInput(
        noise=ImuNoise(**noise),
        update_rate_hz=rate,
        topic=topic,
        T_imu_body=read_transform(keys["T_i_b"]) if placed else None,
        time_shift_s=keys["time_offset"].number() if placed and "time_offset" in keys else None,
    )


def _positive(node: Node) -> float:
    value = node.number()
    if value <= 0:
        raise node.fail(
            f"found {value:g}, expected a number greater than zero, from the data sheet or the Allan deviation."
        )
    return value


_NOISE = field_names(ImuNoise)
_RATES = ("update_rate", "rate_hz")
_OTHERS = ("rostopic", "T_i_b", "time_offset", *_NOISE, *_RATES)
_MODELS = ("calibrated", "scale-misalignment", "scale-misalignment-size-effect")
_LEVER_ARMS = ("rx_i", "ry_i", "rz_i")


def imus_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the IMUs of Kalibr's imu.yaml, or OpenVINS' kalibr_imu_chain.yaml, parsed, with notes.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in Kalibr's layout.
    """
    nodes = read_sensors(root, "imu", _NOISE[0], "Kalibr's imu.yaml")
    imus: dict[str, ImuCalibration] = {}
    data: dict[str, ForeignImu] = {}
    foreign = "Kalibr"
    for name, node in nodes.items():
        keys = {child.key: child for child in node.entries()}
        passed_over((child for key, child in keys.items() if key not in _known(keys)), notes)
        model = _model(node, keys, notes)
        data[name] = _data(node, keys, notes)
        if model is not None:
            imus[name] = data[name].placed(model) if imus else model
        if any(key in keys for key in OPENVINS_KEYS):
            foreign = "OpenVINS"
    if imus:
        notes.append(f"{foreign}'s file holds no bias; taken: zero.")
    return ForeignCalibration(
        imus=imus, frame=recognised_frame(imus), imu_data=data, notes=tuple(notes), format=f"{foreign}, IMU"
    )


def _known(keys: dict[str, Node]) -> tuple[str, ...]:
    own = OPENVINS_KEYS if any(key in keys for key in OPENVINS_KEYS) else ("accelerometers", "gyroscopes")
    return ("model", *own, *_OTHERS)


def _model(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuCalibration | None:
    """Return the sensors; None where the file is silent about them, as Kalibr's input is."""
    if any(key in keys for key in OPENVINS_KEYS):
        return openvins_imu(node, keys, notes)
    stated = "model" in keys
    if not stated and "accelerometers" not in keys:
        return None
    if stated:
        word = keys["model"].text().lower().replace("_", "-")
        if word not in _MODELS:
            keys["model"].text(_MODELS)
        if word == "calibrated":
            return ideal_imu()
    M = _lower(required_value(_parts(node, keys, "accelerometers"), "M", node, "a matrix 3x3"), notes)
    force_sensitivity, bias = KalibrAccelerometer(M=M, b=np.zeros(3)).to_sensor()
    accelerometer = AccelerometerCalibration(
        sensitivity=force_sensitivity, bias=bias, unit="m/s^2", lever_arms_m=_lever_arms(keys, notes)
    )
    if "gyroscopes" not in keys:
        return ImuCalibration(accelerometer=accelerometer)
    parts = _parts(node, keys, "gyroscopes")
    passed_over((part for key, part in parts.items() if key not in {"M", "A", "C_gyro_i"}), notes)
    form = KalibrGyroscope(
        M=_lower(required_value(parts, "M", keys["gyroscopes"], "a matrix 3x3"), notes),
        A=read_matrix(required_value(parts, "A", keys["gyroscopes"], "a matrix 3x3"), 3, 3),
        C_gyro_i=read_rotation(required_value(parts, "C_gyro_i", keys["gyroscopes"], "a rotation matrix")),
        b=np.zeros(3),
    )
    sensitivity, bias, g_sensitivity = form.to_sensor()
    gyroscope = GyroscopeCalibration(sensitivity=sensitivity, bias=bias, g_sensitivity=g_sensitivity, unit="rad/s")
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)


def _parts(node: Node, keys: dict[str, Node], name: str) -> dict[str, Node]:
    return {part.key: part for part in required_value(keys, name, node, "M of it").entries()}


def _lower(node: Node, notes: list[str]) -> Floats:
    """Return Kalibr's M, which is lower triangular."""
    M = read_matrix(node, 3, 3)
    size = np.abs(M).max()
    if np.linalg.matrix_rank(M) < 3:
        raise node.fail("this matrix is singular: the three axes do not measure three directions.")
    if np.abs(np.triu(M, 1)).max() > 1e-9 * size:
        if np.abs(np.tril(M, -1)).max() <= 1e-9 * size:
            raise node.fail("Kalibr's M is lower triangular, this is upper triangular. It seems to be transposed.")
        notes.append(f"{file_name(node)}: {node.path} is not lower triangular as Kalibr's are; taken as it is.")
    return M


def _data(node: Node, keys: dict[str, Node], notes: list[str]) -> ForeignImu:
    rate = next((keys[name].number() for name in _RATES if name in keys), None)
    return ForeignImu(
        noise=_noise(node, keys, notes),
        update_rate_hz=rate,
        topic=str(keys["rostopic"].value or "") if "rostopic" in keys else "",
        T_imu_body=read_transform(keys["T_i_b"]) if "T_i_b" in keys else None,
        time_offset_s=keys["time_offset"].number() if "time_offset" in keys else None,
        lever_arms_m=_lever_arms(keys, []),
    )


def _noise(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuNoise | None:
    found = {name: keys[name].number() for name in _NOISE if name in keys}
    if len(found) == len(_NOISE) and min(found.values()) > 0:
        return ImuNoise(**found)
    if found:
        notes.append(f"{file_name(node)}: the noise of {node.path or 'imu0'} is incomplete or zero; it was left out.")
    return None


def _lever_arms(keys: dict[str, Node], notes: list[str]) -> Floats | None:
    if "accelerometers" not in keys or not isinstance(keys["accelerometers"].value, dict):
        return None
    parts = {part.key: part for part in keys["accelerometers"].entries()}
    passed_over((part for key, part in parts.items() if key not in {"M", *_LEVER_ARMS}), notes)
    if not any(name in parts for name in _LEVER_ARMS):
        return None
    return np.vstack([read_matrix(parts[name], 1, 3) if name in parts else np.zeros((1, 3)) for name in _LEVER_ARMS])


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


@value_class
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


HOLDS = Holds(
    program="Kalibr", bias=False, lever_arms=True, k3=False, without_noise="needs them in its input: add them by hand"
)


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
    require_triads(calibration, "kalibr", "accelerometer")
    moved, losses = into_frame(calibration, KalibrAccelerometer.frame, "Kalibr's")
    found = (*losses, *_pose_losses(moved), *not_representable(moved, HOLDS, context))
    files = {IMU_FILE: imu_text(moved, context.stated, context.comment())}
    if moved.cameras:
        files[CAMCHAIN_FILE] = camchain_text(moved, context.comment())
    return Export(files=files, losses=found)


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
        comments += [f"{name}: {line}" for conversion in si_conversions(imu) for line in conversion.lines()]
        document[name] = _imu_entry(model, pose_in_kalibr(calibration, name))
        shift = imu.required_accelerometer.time_shift_s
        if shift:
            comments.append(f"{name}: t_gyroscope = t_accelerometer + {shift!r} s, for which Kalibr has no key.")
        if name in stated:
            document[name] |= stated_entry(stated[name])
            comments += [f"{name}: {line}" for line in stated[name].comments]
    keys = (*field_names(ImuNoise), "update_rate", "rostopic")
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
    factors = [conversion.factor for conversion in si_conversions(imu)]
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


def _imu_entry(model: KalibrModel, pose: tuple[Floats, float] | None) -> dict[str, Any]:
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


def _pose_losses(calibration: Calibration) -> Iterator[Loss]:
    for name in calibration.imus:
        if pose_in_kalibr(calibration, name) is None:
            why = "how the IMUs lie to each other was not measured: T_i_b is left out."
            yield Loss(what=f"pose of {name}", why=why)
