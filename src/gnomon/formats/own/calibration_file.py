"""The top of gnomon's own calibration file, in YAML or in JSON."""

import re
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any, cast, get_args

import numpy as np

from ...errors import OptionError
from ...findings import Finding
from ...models.camera import Camera
from ...models.forms import in_frame
from ...models.lens_names import DistortionName, ProjectionName
from ...models.origin import AXES, ORIGIN_POINTS, Origin, OriginPoint
from ...recording import Floats
from ...results.calibration import (
    UNSTATED_GRAVITY,
    AccelerometerCalibration,
    Assessment,
    Calibration,
    CameraCalibration,
    CameraImuFit,
    CamerasFit,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    Holdout,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    calibration_parameters,
    covariance_names,
)
from ...results.temperature_dependence import TEMPERATURE_PARTS, TemperatureDependence
from ...results.trust import VERDICTS, Need, UncertaintySummary
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT
from ..shared.structured import Node, read_json, read_structured_text, read_yaml
from .calibration_text import (
    BOARD_NUMBERS,
    SCHEMA_MAJOR,
    TEMPERATURE_NUMBERS,
    VIEW_COUNTS,
    VIEW_NUMBERS,
    calibration_at,
    imu_keys,
)
from .dataclass_file import number_or_nan, read_class, read_typed

COMMENT = "comment"


def read_own(path: str | PathLike[str]) -> Node:
    """Parse calibration.yaml, that in the folder of a result, or calibration.json, whose comment is left out.

    Raises
    ------
    FormatError
        If the file cannot be read, or is neither YAML nor JSON.
    """
    path = calibration_at(path)
    if not read_structured_text(path).lstrip().startswith("{"):
        return read_yaml(path)
    root = read_json(path)
    if not isinstance(root.value, dict):
        return root
    return replace(root, value={key: value for key, value in root.value.items() if key != COMMENT})  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


SIGMAS = {
    "T_cam_imu.rotation": "T_cam_imu_rotation_sigma",
    "T_cam_imu.translation": "T_cam_imu_translation_sigma",
    "T_cam_cam0.rotation": "T_cam_cam0_rotation_sigma",
    "T_cam_cam0.translation": "T_cam_cam0_translation_sigma",
    "time_shift_cam_imu": "time_shift_cam_imu_sigma",
    "line_delay": "line_delay_sigma",
    "intrinsics": "intrinsics_sigma",
    "distortion_coeffs": "distortion_coeffs_sigma",
}
"""Parameter of a camera -> the key of its standard deviation."""
_LENS = (
    "camera_model",
    "intrinsics",
    "distortion_model",
    "distortion_coeffs",
    "resolution",
    "line_delay",
    "rostopic",
)
_LENS_SIGMAS = ("intrinsics_sigma", "distortion_coeffs_sigma")


def camera_entry(node: Node, *, alone: bool = False) -> CameraCalibration:
    """Return one camera, of cameras alone its pose to cam0.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    if alone:
        pose = () if node.key == "cam0" else ("T_cam_cam0",)
        sigmas = tuple(f"{name}_{part}_sigma" for name in pose for part in ("rotation", "translation"))
        keys = node.mapping((*pose, *_LENS), (*sigmas, *_LENS_SIGMAS))
        T = pose_entry(keys["T_cam_cam0"]) if pose else np.eye(4)
        return CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=_lens(node, keys), body="cam0")
    sigmas = tuple(key for name, key in SIGMAS.items() if not name.startswith("T_cam_cam0"))
    keys = node.mapping(("T_cam_imu", "time_shift_cam_imu", *_LENS), sigmas)
    return CameraCalibration(
        T_cam_body=pose_entry(keys["T_cam_imu"]),
        time_shift_cam_imu=keys["time_shift_cam_imu"].number(),
        camera=_lens(node, keys),
    )


def _lens(node: Node, keys: dict[str, Node]) -> Camera:
    width, height = (item.integer() for item in _pair(keys["resolution"]))
    try:
        return Camera(
            projection=keys["camera_model"].text(get_args(ProjectionName)),  # pyright: ignore[reportArgumentType]
            intrinsics=_numbers(keys["intrinsics"]),
            distortion=keys["distortion_model"].text(get_args(DistortionName)),  # pyright: ignore[reportArgumentType]
            distortion_coeffs=_numbers(keys["distortion_coeffs"]),
            resolution=(width, height),
            line_delay_s=keys["line_delay"].number(),
            topic=keys["rostopic"].text(),
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def _numbers(node: Node) -> Floats:
    return np.array([item.number() for item in node.items()], dtype=np.float64)


def _pair(node: Node) -> list[Node]:
    items = list(node.items())
    if len(items) != 2:
        raise node.fail(f"found {len(items)} numbers, expected width and height.")
    return items


def pose_entry(node: Node) -> Floats:
    """Return a pose (4, 4).

    Raises
    ------
    FormatError
        If it is none.
    """
    matrix = node.floats(4, 4)
    rotation = matrix[:3, :3]
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise node.fail("the last row of a pose is [0.0, 0.0, 0.0, 1.0].")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise node.fail("its first three rows and columns are no rotation matrix.")
    return matrix


def camera_imu_entry(node: Node, cameras: tuple[str, ...]) -> CameraImuFit:
    """Return what a camera-IMU calibration rests on; there is an entry for each of the cameras.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    keys = node.mapping(("duration_s", "converged", "cameras"))
    counts, rms = ("frames_found", "frames_used", "corners_used"), ("reprojection_rms_px",)
    return CameraImuFit(
        **_by_camera(keys["cameras"], cameras, {int: counts, float: rms}),
        duration_s=keys["duration_s"].number(),
        converged=read_typed(keys["converged"], bool),
    )


def _by_camera(node: Node, cameras: tuple[str, ...], keys: Mapping[Any, tuple[str, ...]]) -> dict[str, Any]:
    """Return, for each of the keys, camera -> value; `keys` are by the kind of their values, a float may be null."""
    every = [key for names in keys.values() for key in names]
    entries = {name: entry.mapping(every) for name, entry in node.mapping(cameras).items()}

    def read(value: Node, kind: Any) -> Any:
        return number_or_nan(value) if kind is float else read_typed(value, kind)

    return {
        key: {name: read(entry[key], kind) for name, entry in entries.items()}
        for kind, names in keys.items()
        for key in names
    }


def cameras_entry(node: Node, cameras: tuple[str, ...]) -> CamerasFit:
    """Return what a calibration of cameras alone rests on; there is an entry for each of the cameras.

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as expected.
    """
    keys = node.mapping(("converged", "board", "cameras"))
    board = keys["board"].mapping(("added", *BOARD_NUMBERS))
    kinds = {int: VIEW_COUNTS, float: VIEW_NUMBERS, tuple[str, ...]: ("models",)}
    numbers: dict[str, Any] = {name: number_or_nan(board[name]) for name in BOARD_NUMBERS}
    return CamerasFit(
        **_by_camera(keys["cameras"], cameras, kinds),
        **numbers,
        board_added=read_typed(board["added"], tuple[str, ...]),
        converged=read_typed(keys["converged"], bool),
    )


SCHEMA_MINOR = 9
_ROUNDED = 1e-7
"""By so much a correlation may pass one, and an eigenvalue for each scalar zero, through rounding."""
_ALWAYS = ("schema", "verdict", "body_frame", "cameras", "assessment", "provenance", "covariance")
_OF_IMUS = ("gravity", "imus")
FIELD_UNITS = ("uT", "local field")
"""Units of a calibrated magnetic field."""
_TRIADS = ("accelerometer", "gyroscope", "magnetometer")
_FRAMES = {
    "accel-x": ("accelerometer", "accel-x"),
    "accel-z": ("accelerometer", "accel-z"),
    "gyro-x": ("gyroscope", "accel-x"),
    "mag-x": ("magnetometer", "accel-x"),
}
"""Body frame -> the triad that defines it, and the frame of `geometry.rotations` whose zeros its sensitivity has."""


def load(path: str | PathLike[str]) -> Calibration:
    """Read a calibration from gnomon's own file, calibration.yaml or the same as calibration.json.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not as the schema says; the message names the key.
    """
    root = read_own(path)
    minor = _checked_minor(root)
    if minor >= 4 and root.value.get("body_frame") == "cam0":
        return _checked(root.mapping(_ALWAYS), _cameras_alone(root.mapping(_ALWAYS)))
    top = root.mapping((*_ALWAYS, *_OF_IMUS))
    imus = {node.key: _imu(node, minor) for node in top["imus"].entries()}
    if minor == 0:
        top["cameras"].mapping()
    cameras = {node.key: camera_entry(node) for node in top["cameras"].entries()}
    calibration = Calibration(
        imus=imus,
        frame=_frame(top["body_frame"], top["imus"], imus, minor),
        gravity=_gravity(top["gravity"]),
        uncertainty=_covariance(top["covariance"], covariance_names(imus, cameras)),
        assessment=_assessment(top["assessment"], tuple(cameras), minor),
        provenance=provenance_entry(top["provenance"]),
        cameras=cameras,
    )
    return _checked(top, calibration)


def _cameras_alone(top: dict[str, Node]) -> Calibration:
    """Return a calibration of cameras without an IMU."""
    cameras = {node.key: camera_entry(node, alone=True) for node in top["cameras"].entries()}
    if not cameras:
        raise top["cameras"].fail("found no camera; a calibration holds an IMU or a camera.")
    node = top["assessment"]
    keys = node.mapping(("verdict", "model", "held_by_prior", "findings"), ("cameras", "trust"))
    common = _common_assessment(keys)
    fit = cameras_entry(keys["cameras"], tuple(cameras)) if "cameras" in keys else None
    return Calibration(
        imus={},
        frame="cam0",
        gravity=UNSTATED_GRAVITY,
        uncertainty=_covariance(top["covariance"], covariance_names({}, cameras)),
        assessment=replace(common, cameras=fit),
        provenance=provenance_entry(top["provenance"]),
        cameras=cameras,
    )


def _checked(top: dict[str, Node], calibration: Calibration) -> Calibration:
    """Return the calibration if what stands twice in its file agrees."""
    if top["verdict"].text(VERDICTS) != calibration.verdict:
        raise top["verdict"].fail(
            f'"{top["verdict"].value}" contradicts assessment.verdict, "{calibration.verdict}". They are one thing.'
        )
    _check_sigmas(top, calibration)
    return calibration


def _checked_minor(root: Node) -> int:
    """Return the minor of a schema that this version reads."""
    if not isinstance(root.value, dict) or not isinstance(root.value.get("schema"), str):
        raise root.fail(
            'this is no gnomon calibration: it does not begin with "schema: gnomon/1". '
            "Give the calibration.yaml that gnomon wrote. Is it the recording, given in the place of the calibration?"
        )
    stated = root.child("schema")
    match = re.fullmatch(r"gnomon/(\d{1,6})(?:\.(\d{1,6}))?", stated.value)
    if match is None:
        noise = " This file holds the noise of a sensor." if stated.value.startswith("gnomon-noise/") else ""
        raise stated.fail(f'found "{stated.value}", expected gnomon/{SCHEMA_MAJOR}.{noise}')
    major, minor = int(match[1]), int(match[2] or 0)
    if (major, minor) > (SCHEMA_MAJOR, SCHEMA_MINOR):
        raise stated.fail(
            f"found {stated.value}, this version of gnomon reads up to gnomon/{SCHEMA_MAJOR}.{SCHEMA_MINOR}. "
            "The file comes from a newer gnomon: update gnomon."
        )
    if major < SCHEMA_MAJOR:
        raise stated.fail(f"found {stated.value}, expected gnomon/{SCHEMA_MAJOR}.")
    return minor


def _imu(node: Node, minor: int) -> ImuCalibration:
    required, optional = ["accelerometer"], ["gyroscope"]
    if minor >= 2:
        required, optional = [], ["accelerometer", "gyroscope", "magnetometer"]
    placed: tuple[str, ...] = ()
    if minor >= 5:
        placed = ("T_imu_body", "time_shift_imu")
        optional += [
            *placed,
            *(f"{name}_sigma" for name in ("T_imu_body_rotation", "T_imu_body_translation", placed[1])),
        ]
    optional += ["origin"] if minor >= 6 else []
    optional += ["temperature"] if minor >= 7 else []
    triads = node.mapping(required, optional)
    if triads.keys().isdisjoint(_TRIADS):
        raise node.fail("found no sensor, expected an accelerometer, a gyroscope or a magnetometer.")
    stated = [name for name in placed if name in triads]
    if len(stated) == 1:
        raise node.fail(f"found {stated[0]} alone; T_imu_body and time_shift_imu belong together.")
    accelerometer = _accelerometer(triads["accelerometer"], minor) if "accelerometer" in triads else None
    return ImuCalibration(
        origin=_origin(triads["origin"]) if "origin" in triads else _origin_of(accelerometer),
        T_imu_body=pose_entry(triads["T_imu_body"]) if stated else None,
        time_shift_s=triads["time_shift_imu"].number() if stated else 0.0,
        accelerometer=accelerometer,
        gyroscope=_gyroscope(triads["gyroscope"]) if "gyroscope" in triads else None,
        magnetometer=_magnetometer(triads["magnetometer"]) if "magnetometer" in triads else None,
        temperature=_temperature(triads["temperature"]) if "temperature" in triads else None,
    )


def _temperature(node: Node) -> TemperatureDependence:
    keys = node.mapping(TEMPERATURE_NUMBERS, [*TEMPERATURE_PARTS, *(f"{name}_sigma" for name in TEMPERATURE_PARTS)])
    reference, low, high, lag = (keys[name].number() for name in TEMPERATURE_NUMBERS)
    if not low < high:
        raise keys["high_degc"].fail("the range ends at or below its begin.")
    parts = {
        name: np.array([row.floats(*shape) for row in keys[name].items()])
        for name, shape in TEMPERATURE_PARTS.items()
        if name in keys
    }
    return TemperatureDependence(reference_degc=reference, low_degc=low, high_degc=high, lag_s=lag, **parts)


def _origin(node: Node) -> Origin:
    keys = node.mapping(("point",), ("weights", "place_m"))
    point = cast("OriginPoint", keys["point"].text(ORIGIN_POINTS))
    if (point == "place") != ("place_m" in keys):
        raise node.fail('place_m tells where the point "place" is, and belongs to it alone. Correct point, or place_m.')
    weights = None
    if "weights" in keys:
        weights = np.array([item.floats(3, 3) for item in keys["weights"].mapping(AXES).values()])
        if not np.allclose(weights.sum(axis=0), np.eye(3), rtol=0, atol=1e-6):
            raise keys["weights"].fail("the three weights have to sum up to the identity.")
    place = keys["place_m"].floats(3) if "place_m" in keys else None
    return Origin(point=point, weights=weights, place_m=place)


def _origin_of(accelerometer: AccelerometerCalibration | None) -> Origin | None:
    """Return the origin as lever arms alone tell it: the accelerometer without one; None where none is."""
    if accelerometer is None or accelerometer.lever_arms_m is None:
        return None
    zero = np.flatnonzero(~accelerometer.lever_arms_m.any(axis=1))
    return Origin(point=AXES[int(zero[0])]) if len(zero) else None


def _accelerometer(node: Node, minor: int) -> AccelerometerCalibration:
    may = ("lever_arms_m", *(("time_shift",) if minor >= 5 else ())) if minor >= 3 else ()
    keys = _triad_keys(node, "sensitivity", "bias", may=may)
    return AccelerometerCalibration(
        unit=keys["unit"].text(tuple(ACCELEROMETER_UNITS_M_S2)),
        sensitivity=_invertible(keys["sensitivity"]),
        bias=keys["bias"].floats(3),
        lever_arms_m=keys["lever_arms_m"].floats(3, 3) if "lever_arms_m" in keys else None,
        time_shift_s=keys["time_shift"].number() if "time_shift" in keys else None,
    )


def _gyroscope(node: Node) -> GyroscopeCalibration:
    keys = _triad_keys(node, "sensitivity", "bias", "g_sensitivity")
    return GyroscopeCalibration(
        unit=keys["unit"].text(tuple(GYROSCOPE_UNITS_RAD_S)),
        sensitivity=_invertible(keys["sensitivity"]),
        bias=keys["bias"].floats(3),
        g_sensitivity=keys["g_sensitivity"].floats(3, 3),
    )


def _magnetometer(node: Node) -> MagnetometerCalibration:
    keys = _triad_keys(node, "sensitivity", "bias", also=("field_unit",))
    return MagnetometerCalibration(
        unit=keys["unit"].text(tuple(MAGNETOMETER_UNITS_UT)),
        field_unit=keys["field_unit"].text(FIELD_UNITS),
        sensitivity=_invertible(keys["sensitivity"]),
        bias=keys["bias"].floats(3),
    )


def _triad_keys(node: Node, *values: str, also: tuple[str, ...] = (), may: tuple[str, ...] = ()) -> dict[str, Node]:
    return node.mapping(["unit", *also, *values], [*may, *(f"{name}_sigma" for name in (*values, *may))])


def _invertible(node: Node) -> Floats:
    matrix = node.floats(3, 3)
    if np.linalg.matrix_rank(matrix) < 3:
        raise node.fail("this matrix is singular: the three axes do not measure three directions.")
    return matrix


def _frame(node: Node, imus_node: Node, imus: dict[str, ImuCalibration], minor: int) -> str:
    frame = node.text((*(_FRAMES if minor >= 2 else ("accel-x", "accel-z")), "user"))
    if frame == "user":
        return frame
    triad, zeros = _FRAMES[frame]
    for name, imu in imus.items():
        sensor = getattr(imu, triad)
        if sensor is None:
            raise imus_node.child(name).fail(
                f"body frame {frame} is that of the {triad}, and there is none here. Correct body_frame, or state user."
            )
        try:
            in_frame(sensor.sensitivity, zeros)
        except OptionError:
            place = imus_node.child(name).child(triad).child("sensitivity")
            raise place.fail(
                f"in body frame {frame} this matrix is {'upper' if zeros == 'accel-z' else 'lower'} triangular, "
                "which it is not. Correct it, or state body_frame: user."
            ) from None
    return frame


def _gravity(node: Node) -> Gravity:
    found = read_class(node, Gravity, own={"sigma": _endless})
    if found.sigma < 0:
        raise node.child("sigma").fail(f"found {found.sigma:g}, expected a standard deviation, zero or more.")
    return found


def _covariance(node: Node, expected: tuple[str, ...]) -> Covariance:
    keys = node.mapping(("names", "lower_triangle"))
    names = tuple(item.text() for item in keys["names"].items())
    for i, (name, right) in enumerate(zip(names, expected, strict=False)):
        if name != right:
            raise keys["names"].fail(f"entry {i} is {name}, expected {right}.")
    if len(names) != len(expected):
        raise keys["names"].fail(f"found {len(names)} names, expected {len(expected)}, one for each parameter.")
    rows = list(keys["lower_triangle"].items())
    if len(rows) != len(names):
        raise keys["lower_triangle"].fail(f"found {len(rows)} rows, expected {len(names)}, one for each name.")
    matrix = np.zeros((len(names), len(names)))
    for i, row in enumerate(rows):
        matrix[i, : i + 1] = matrix[: i + 1, i] = row.floats(i + 1, finite=False)
    _check_covariance(matrix, names, keys["lower_triangle"])
    return Covariance(names=names, matrix=matrix)


def _check_covariance(matrix: Floats, names: tuple[str, ...], node: Node) -> None:
    """Refuse what is the covariance of nothing, as after an edit by hand; a scalar whose row is nan is not known."""
    known = np.flatnonzero(~np.isnan(matrix).all(axis=1))
    names, matrix = tuple(names[i] for i in known), matrix[np.ix_(known, known)]
    endless = np.argwhere(~np.isfinite(matrix))
    if len(endless):
        i, j = (int(place) for place in endless[0])
        raise node.fail(f"the covariance of {names[i]} and {names[j]} is {matrix[i, j]}, expected a finite number.")
    variance = np.diag(matrix)
    if (variance < 0).any():
        raise node.fail(f"the variance of {names[int(np.argmin(variance))]} is below zero.")
    sigma = np.sqrt(variance)
    scale = np.where(sigma > 0, sigma, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # beside a variance of zero: endless, and refused
        correlation = matrix / scale[:, None] / scale
    above = np.tril(np.abs(correlation), -1)
    if names and above.max() > 1 + _ROUNDED:
        i, j = (int(place) for place in np.unravel_index(int(np.argmax(above)), above.shape))
        raise node.fail(
            f"the covariance of {names[i]} and {names[j]} is larger than their variances allow: no covariance is so. "
            "Take the file as gnomon wrote it."
        )
    least = float(np.linalg.eigvalsh(correlation)[0]) if names else 0.0
    if least < -_ROUNDED * len(names):
        raise node.fail(
            f"this is no covariance: it is not positive semi-definite (least eigenvalue {least:.3g} as correlations). "
            "Take the file as gnomon wrote it."
        )


def _check_sigmas(top: dict[str, Node], calibration: Calibration) -> None:
    """Refuse sigmas that contradict the covariance: which of the two was meant cannot be known."""
    for path, value in calibration_parameters(calibration.imus, calibration.cameras):
        sensor, _, name = path.partition(".")
        if sensor in calibration.cameras:
            stated, key = top["cameras"].child(sensor), SIGMAS[name]
        else:
            _, (*triad, _), key = imu_keys(path)
            stated = top["imus"].child(sensor)
            for child in triad:
                stated = stated.child(child)
        if key not in stated.value:
            continue
        entry = stated.child(key)
        given = entry.floats(*value.shape, finite=False) if value.ndim else entry.number(finite=False)
        if not np.allclose(given, calibration.sigma(path), rtol=1e-6, atol=0.0, equal_nan=True):
            raise entry.fail("this contradicts the covariance, whose copy it is. Correct both, or remove this line.")


def _assessment(node: Node, cameras: tuple[str, ...], minor: int) -> Assessment:
    counts = ("intervals_found", "intervals_used", "rotations_found", "rotations_used")
    with_cameras = minor > 0 and isinstance(node.value, dict) and "camera_imu" in node.value
    basis = ("camera_imu",) if with_cameras else ("holdout", *counts)
    keys = node.mapping(("verdict", "model", *basis, "held_by_prior", "findings"), ("trust",) if minor >= 3 else ())
    common = _common_assessment(keys)
    if with_cameras:
        return replace(common, camera_imu=camera_imu_entry(keys["camera_imu"], cameras))
    newer = ("rate_rms", "field_rms") if minor >= 2 else ()
    holdout = keys["holdout"].mapping(("accelerometer_rms", "rotation_rms"), newer)
    rms = {name: number_or_nan(item) for name, item in holdout.items()}
    return replace(common, holdout=Holdout(**rms), **{name: keys[name].integer() for name in counts})


def _common_assessment(keys: dict[str, Node]) -> Assessment:
    """Return the part of an assessment that calibrations of every kind have."""
    verdict = keys["verdict"].text(VERDICTS)
    return Assessment(
        verdict=verdict,  # pyright: ignore[reportArgumentType]
        findings=tuple(finding_entry(item) for item in keys["findings"].items()),
        model=keys["model"].text(),
        held_by_prior=tuple(item.text() for item in keys["held_by_prior"].items()),
        trust=_trust(keys["trust"]) if "trust" in keys else UncertaintySummary(),
    )


def _trust(node: Node) -> UncertaintySummary:
    def ratios(node: Node) -> dict[str, float]:
        return {item.key: _endless(item) for item in node.entries()}

    def needs(node: Node) -> tuple[Need, ...]:
        return tuple(read_class(item, Need, own={"sigma": _endless, "needed": _endless}) for item in node.items())

    own = {"sigma_ratio": ratios, "split_z": number_or_nan, "needs": needs}
    return read_class(node, UncertaintySummary, optional=("recordings", "between", "changes"), own=own)


def _endless(node: Node) -> float:
    return node.number(finite=False)


def finding_entry(node: Node) -> Finding:
    """Return a finding.

    Raises
    ------
    FormatError
        If the entry is none.
    """
    found = read_class(node, Finding)
    before, said, cause = found.consequence.partition("It follows from: ")  # all that older files say of it
    return replace(found, follows_from=cause.rstrip(".")) if said and not (before or found.follows_from) else found


def provenance_entry(node: Node) -> Provenance:
    """Return where a result comes from.

    Raises
    ------
    FormatError
        If the entry does not say.
    """
    return read_class(node, Provenance, optional=("seed",))
