"""The quantities of a calibration that are compared, block by block, with their joint covariance."""

from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from typing import Literal

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import frame_turn, invert_matrix, rotation_jacobian, skew
from ...models.forms import in_own_axes
from ...options.requirements import BETWEEN_RECORDINGS
from ...recording import Floats, frozen_array
from ...results.calibration import CameraCalibration, ImuCalibration
from ...results.sensors import calibration_parameters, covariance_names
from .candidates import FRAME, ComparisonCandidate

Kind = Literal[
    "scale",
    "misalignment",
    "rotation",
    "g-sensitivity",
    "bias",
    "lever arms",
    "translation",
    "time shift",
    "line delay",
    "lens",
]
_AXES = ("x", "y", "z")
_TILTS = ((1, 0), (2, 0), (2, 1))
_TILT_NAMES = ("yz", "zy", "zx")
_NINE = tuple(f"{row}{column}" for row in _AXES for column in _AXES)


@value_class
class ComparedQuantity:
    """A block of numbers of one calibration.

    Attributes
    ----------
    path : such as "cam0.translation" or "imu0.gyroscope.scale"
    kind : what it is
    elements : name of each scalar, such as "x"
    unit : of the scalars
    values : (k,); zero for a rotation
    rotation : (3, 3) of a rotation, from body axes; its scalars are small rotations about the body's axes [rad]
    estimated : whether it was estimated, not held at an ideal or given value
    rows : where its scalars stand in the covariance of the `Statement`
    """

    path: str
    kind: Kind
    elements: tuple[str, ...]
    unit: str
    values: Floats
    rotation: Floats | None = None
    estimated: bool = True
    rows: slice = field(default_factory=lambda: slice(0, 0))


@value_class
class Statement:
    """All that one calibration states.

    Attributes
    ----------
    name : of the calibration
    quantities : path -> ComparedQuantity
    jacobian : (n, m) derivative of all their scalars by those of the sensors
    covariance : (n, n) of all their scalars; None where it is not stated; nan where a part is not
    by_gravity : (n,) derivative of the scalars by the magnitude of gravity times its sigma, where it is part of the
        covariance, else zero
    """

    name: str
    quantities: dict[str, ComparedQuantity]
    jacobian: Floats
    covariance: Floats | None
    by_gravity: Floats


@value_class
class _Part:
    """A quantity and the derivative (k, n) of its scalars by those of its sensor."""

    quantity: ComparedQuantity
    jacobian: Floats


def statement_of(candidate: ComparisonCandidate, references: frozenset[str] = frozenset()) -> Statement:
    """Return what a candidate in the common frame states.

    Parameters
    ----------
    references : cameras to which the other ones are stated as well, where they are placed to an IMU; for comparisons
        with cameras that were calibrated without one
    """
    names = covariance_names(candidate.imus, candidate.cameras)
    parts: list[tuple[ComparedQuantity, Floats]] = []
    starts: dict[str, int] = {}
    start = 0
    for name, sensor in (*candidate.imus.items(), *candidate.cameras.items()):
        count = len(
            covariance_names(*(({name: sensor}, {}) if isinstance(sensor, ImuCalibration) else ({}, {name: sensor})))
        )
        found = _imu_parts(name, sensor) if isinstance(sensor, ImuCalibration) else _camera_parts(name, sensor)
        for part in found:
            whole = np.zeros((len(part.quantity.elements), len(names)))
            whole[:, start : start + count] = part.jacobian
            parts.append((part.quantity, whole))
        starts[name] = start
        start += count
    parts += _between(candidate, references, starts, len(names))
    jacobian = np.concatenate([np.zeros((0, len(names))), *(rows for _, rows in parts)])
    covariance = None if candidate.covariance is None else _carried(jacobian, candidate.covariance.matrix)
    own = candidate.verdict != ""
    alone = bool(candidate.bodies) and "imu0" not in candidate.bodies
    quantities: dict[str, ComparedQuantity] = {}
    row = 0
    for quantity, _ in parts:
        rows = slice(row, row + len(quantity.elements))
        row = rows.stop
        variance = None if covariance is None else np.diag(covariance)[rows]
        estimated = candidate.exact or _was_estimated(quantity, variance, own, alone)
        if estimated is not None:
            values = frozen_array(quantity.values)
            quantities[quantity.path] = replace(quantity, values=values, estimated=estimated, rows=rows)
    pull = jacobian @ _by_gravity(candidate)
    if covariance is not None and np.any(pull**2 > (1 + 1e-6) * np.diag(covariance)):
        pull = np.zeros(len(pull))  # the sigmas are smaller than gravity's share of them: it is not in them
    return Statement(
        name=candidate.name,
        quantities=quantities,
        jacobian=frozen_array(jacobian),
        covariance=None if covariance is None else frozen_array(covariance),
        by_gravity=frozen_array(pull),
    )


_BETWEEN: Mapping[tuple[str, str], str] = {
    (triad, kind): f"{triad}_{name}"
    for triad in ("accelerometer", "gyroscope")
    for kind, name in (
        ("scale", "scale"),
        ("misalignment", "misalignment"),
        ("rotation", "misalignment"),
        ("g-sensitivity", "g_sensitivity"),
        ("bias", "bias"),
    )
    if (triad, kind) != ("accelerometer", "g-sensitivity")
}
"""Triad and kind of a block -> the quantity whose scatter between recordings it has."""


def with_scatter_between_recordings(statement: Statement) -> Statement:
    """Return the statement of one recording with what the sensor itself changes to the next one, as is usual."""
    if statement.covariance is None:
        return statement
    covariance = statement.covariance.copy()
    for path, quantity in statement.quantities.items():
        sensor, _, triad = path.rpartition(".")[0].partition(".")
        usual = BETWEEN_RECORDINGS.get(_BETWEEN.get((triad, quantity.kind), ""), 0.0)
        scale = statement.quantities.get(f"{sensor}.{triad}.scale")
        if usual and scale is not None and quantity.estimated:
            size = 1.0 if quantity.unit == "rad" else float(np.cbrt(abs(np.prod(scale.values))))
            at = np.arange(quantity.rows.start, quantity.rows.stop)
            covariance[at, at] += np.where(covariance[at, at] > 0, (usual * size) ** 2, 0.0)
    return replace(statement, covariance=frozen_array(covariance))


def _carried(jacobian: Floats, matrix: Floats) -> Floats:
    """Return the covariance of what has the derivative; what depends on an unknown one is unknown."""
    unknown = ~np.isfinite(np.diag(matrix))
    known = np.where(unknown[:, None] | unknown, 0.0, matrix)
    carried = jacobian @ known @ jacobian.T
    touched = np.any(np.abs(jacobian[:, unknown]) > 0, axis=1)
    carried[touched] = carried[:, touched] = np.nan
    return np.asarray(carried, dtype=np.float64)


def _was_estimated(quantity: ComparedQuantity, variance: Floats | None, own: bool, alone: bool) -> bool | None:
    """Return whether a quantity was estimated or held; None where nothing is said of it.

    Parameters
    ----------
    variance : (k,) as stated
    own : whether it is of gnomon's own
    alone : whether it is of a calibration of cameras alone
    """
    ideal = not _deviation(quantity).any()
    if variance is not None:
        stated = bool(np.any(~(variance <= 0)))
        return stated if own or stated else (None if ideal else True)
    if quantity.kind in {"bias", "line delay"} and ideal:
        return None
    if quantity.kind == "lens":
        return alone  # with an IMU, as far as anybody knows: it was calibrated before
    return not ideal


def _deviation(quantity: ComparedQuantity) -> Floats:
    """Return by how much a quantity differs from that of an ideal sensor."""
    if quantity.rotation is not None:
        ideal = np.eye(3) if quantity.path.split(".")[-2] in {"gyroscope", "magnetometer"} else np.zeros((3, 3))
        return (quantity.rotation - ideal).ravel()
    return quantity.values - (1.0 if quantity.kind == "scale" and quantity.unit == "1" else 0.0)


def _by_gravity(candidate: ComparisonCandidate) -> Floats:
    """Return the derivative of all scalars by gravity times its sigma, of an IMU calibrated by gravity alone."""
    found: list[Floats] = [np.zeros(0)]
    gravity, covariance = candidate.gravity, candidate.covariance
    alone = gravity is not None and gravity.sigma > 0 and covariance is not None and not candidate.cameras
    for path, value in calibration_parameters(candidate.imus, candidate.cameras):
        acts = alone and path.endswith(("accelerometer.sensitivity", "g_sensitivity"))
        found.append(-value.ravel() * gravity.sigma / gravity.value if acts and gravity else np.zeros(value.size))
    return np.concatenate(found)


def _imu_parts(name: str, imu: ImuCalibration) -> Iterator[_Part]:
    """Yield the blocks of an IMU, with their derivatives by its scalars."""
    starts: dict[str, int] = {}
    count = 0
    for path, value in calibration_parameters({"": imu}):
        starts[path.removeprefix(".")] = count
        count += value.size

    def placed(quantity: ComparedQuantity, parameter: str, block: Floats) -> _Part:
        whole = np.zeros((len(quantity.elements), count))
        whole[:, starts[parameter] : starts[parameter] + block.shape[1]] = block
        return _Part(quantity=quantity, jacobian=whole)

    for triad in ("accelerometer", "gyroscope", "magnetometer"):
        for quantity, parameter, block in _triad_blocks(name, imu, triad):
            yield placed(quantity, f"{triad}.{parameter}", block)
    if imu.T_imu_body is not None:
        blocks = (*_pose(f"{name}.imu0", imu.T_imu_body), _time_shift(name, imu.time_shift_s))
        scalars = ("T_imu_body.rotation", "T_imu_body.translation", "time_shift_imu")
        for quantity, parameter in zip(blocks, scalars, strict=True):
            yield placed(quantity, parameter, np.eye(len(quantity.elements)))


def _triad_blocks(name: str, imu: ImuCalibration, triad: str) -> Iterator[tuple[ComparedQuantity, str, Floats]]:
    """Yield the blocks of one triad, each with the parameter that it is made of and its derivative by that."""
    sensor = getattr(imu, triad)
    if sensor is None:
        return
    path = f"{name}.{triad}"
    aligned = imu.accelerometer is not None  # only then two calibrations have one body frame
    own, C = in_own_axes(sensor.sensitivity, FRAME)
    to_own = rotation_jacobian([sensor.sensitivity], C, FRAME)
    S = np.diag(own)
    M = own / S[:, None]
    si = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}.get(triad) or sensor.field_unit
    unit = "1" if sensor.unit == si else f"{sensor.unit}/({si})"
    scale = ComparedQuantity(path=f"{path}.scale", kind="scale", elements=_AXES, unit=unit, values=S)
    yield scale, "sensitivity", np.eye(9)[[0, 4, 8]] @ to_own
    by_tilt = np.array([(np.eye(9)[3 * i + j] - M[i, j] * np.eye(9)[4 * i]) / S[i] for i, j in _TILTS])
    tilts = np.array([M[i, j] for i, j in _TILTS])
    skewed = ComparedQuantity(
        path=f"{path}.misalignment", kind="misalignment", elements=_TILT_NAMES, unit="rad", values=tilts
    )
    yield skewed, "sensitivity", by_tilt @ to_own
    if triad != "accelerometer" and aligned:
        turn = -C.T @ frame_turn(sensor.sensitivity, C, FRAME)  # C Exp(turn), about the body's axes
        turned = ComparedQuantity(
            path=f"{path}.rotation", kind="rotation", elements=_AXES, unit="rad", values=np.zeros(3)
        )
        yield replace(turned, rotation=C), "sensitivity", turn
    if triad == "gyroscope" and aligned:
        unit, values = f"({sensor.unit})/(m/s^2)", sensor.g_sensitivity.ravel()
        by_force = ComparedQuantity(
            path=f"{path}.g_sensitivity", kind="g-sensitivity", elements=_NINE, unit=unit, values=values
        )
        yield by_force, "g_sensitivity", np.eye(9)
    if triad == "accelerometer" and sensor.lever_arms_m is not None:
        values = sensor.lever_arms_m.ravel()
        arms = ComparedQuantity(path=f"{path}.lever_arms", kind="lever arms", elements=_NINE, unit="m", values=values)
        yield arms, "lever_arms_m", np.eye(9)
    if triad == "accelerometer" and sensor.time_shift_s is not None:
        yield _time_shift(path, sensor.time_shift_s), "time_shift", np.eye(1)
    bias = ComparedQuantity(path=f"{path}.bias", kind="bias", elements=_AXES, unit=sensor.unit, values=sensor.bias)
    yield bias, "bias", np.eye(3)


def _camera_parts(name: str, camera: CameraCalibration) -> Iterator[_Part]:
    """Yield the blocks of a camera, which are those of its scalars; its time shift is that of the middle row.

    Row 0 has another shift wherever the line delay is another, and programs that know none state the middle row's.
    """
    lens = camera.camera
    blocks: list[ComparedQuantity] = []
    if name != camera.body:
        blocks += _pose(name if camera.body == "imu0" else f"{name}.{camera.body}", camera.T_cam_body)
    if camera.body == "imu0":
        delay = np.array([lens.line_delay_s])
        blocks += [
            _time_shift(name, camera.time_shift_cam_imu + camera.middle_row_delay_s),
            ComparedQuantity(path=f"{name}.line_delay", kind="line delay", elements=("",), unit="s", values=delay),
        ]
    symbols, values = lens.parameter_symbols, lens.parameters
    blocks.append(ComparedQuantity(path=f"{name}.lens", kind="lens", elements=symbols, unit="", values=values))
    count = sum(len(block.elements) for block in blocks)
    start = 0
    for block in blocks:
        rows = np.eye(count)[start : start + len(block.elements)]
        if block.kind == "time shift":
            rows[0, start + 1] = 0.5 * (lens.resolution[1] - 1)  # by the line delay, which is next to it
        start += len(block.elements)
        yield _Part(quantity=block, jacobian=rows)


def _time_shift(path: str, shift_s: float) -> ComparedQuantity:
    values = np.array([shift_s])
    return ComparedQuantity(path=f"{path}.time_shift", kind="time shift", elements=("",), unit="s", values=values)


def _pose(path: str, T: Floats) -> tuple[ComparedQuantity, ComparedQuantity]:
    """Return rotation and translation of T (4, 4) under a path."""
    turn = ComparedQuantity(path=f"{path}.rotation", kind="rotation", elements=_AXES, unit="rad", values=np.zeros(3))
    shift = ComparedQuantity(path=f"{path}.translation", kind="translation", elements=_AXES, unit="m", values=T[:3, 3])
    return replace(turn, rotation=T[:3, :3]), shift


def _between(
    candidate: ComparisonCandidate, references: frozenset[str], starts: Mapping[str, int], count: int
) -> Iterator[tuple[ComparedQuantity, Floats]]:
    """Yield the poses of cameras to other cameras where all are placed to an IMU, with derivatives by all scalars.

    With T_10 = T_1 T_0^-1, small rotations on the right give d = R_0 (d_1 - d_0), and the translation moves by
    dt_1 - R_10 dt_0 + R_10 [t_0]x d.
    """
    for reference in sorted(references & set(candidate.cameras)):
        zero = candidate.cameras[reference]
        for name, camera in candidate.cameras.items():
            if name == reference or {camera.body, zero.body} != {"imu0"}:
                continue
            T = camera.T_cam_body @ invert_matrix(zero.T_cam_body)
            R, R_0, t_0 = T[:3, :3], zero.T_cam_body[:3, :3], zero.T_cam_body[:3, 3]
            one, other = starts[name], starts[reference]
            turn, shift = np.zeros((3, count)), np.zeros((3, count))
            turn[:, one : one + 3], turn[:, other : other + 3] = R_0, -R_0
            shift[:, one + 3 : one + 6], shift[:, other + 3 : other + 6] = np.eye(3), -R
            shift += R @ skew(t_0) @ turn
            yield from zip(_pose(f"{name}.{reference}", T), (turn, shift), strict=True)
