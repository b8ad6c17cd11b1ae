"""YAML files of other programs, read leniently: what people and programs write that is almost YAML.

OpenCV begins a file with %YAML:1.0, with or without --- behind it, and writes matrices as mappings with a tag of its
own (!!opencv-matrix). People indent with tabs and leave a comma behind a row. Our own files are read strictly, by
`structured.read_yaml`.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, OptionError
from ...geometry.rotations import inverse_pose, normalise_quaternion, rotation_from_quaternion
from ...models.camera import Camera
from ...models.distortions import DISTORTIONS
from ...models.lens_names import DistortionName, ProjectionName
from ...recording import Floats, frozen_array
from ...recording.samples import ImuNoise
from ...results.calibration import CameraCalibration
from .structured import Node, parse_yaml, read_structured_text

_ROW_WITH_COMMA = re.compile(r"^(\s*(?:-\s|[\w.]+\s*:).*[\]}])\s*,\s*(#.*)?$")
_TAB_WIDTHS = (2, 4, 8)

_NO_ROTATION = 0.02  # numbers typed by hand have few digits
_EXACT = 1e-14  # numbers with all their digits are left as they are
_FARTHEST_M = 100.0


def read_foreign_yaml(path: str | PathLike[str], notes: list[str] | None = None) -> Node:
    """Parse a YAML file of another program.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was fixed are appended

    Raises
    ------
    FormatError
        If the file cannot be read, is no YAML even so, or holds a key twice.
    """
    text = re.sub(r"(?m)^%", "#", read_structured_text(path))
    try:
        return Node(file=str(path), path="", value=parse_yaml(text, path, any_tag=True))
    except FormatError as error:
        for value, said in _mended(text, path):
            if notes is not None:
                notes.append(f"{Path(path).name}: {said}")
            return Node(file=str(path), path="", value=value)
        raise error from None


def _mended(text: str, path: str | PathLike[str]) -> Iterator[tuple[Any, str]]:
    """Yield what the file holds without its usual mistakes, and a sentence on them; nothing where they are others."""
    lines = text.splitlines()
    without = [_without_comma(line) for line in lines]
    said = ["commas at the ends of rows"] if without != lines else []
    if "\t" not in text:
        values = _parsed(["\n".join(without)], path) if said else []
    else:
        # A file may mix tabs and spaces: then the width of a tab decides what belongs to what, which nobody knows.
        values = _parsed(["\n".join(without).expandtabs(width) for width in _TAB_WIDTHS], path)
        said.append("tabs")
    if values and all(value == values[0] for value in values):
        yield values[0], f"{' and '.join(said)}, which YAML does not allow, were passed over."


def _parsed(texts: list[str], path: str | PathLike[str]) -> list[Any]:
    """Return what those texts hold that are YAML."""
    values: list[Any] = []
    for text in texts:
        try:
            values.append(parse_yaml(text, path, any_tag=True))
        except FormatError:
            continue
    return values


def _without_comma(line: str) -> str:
    found = _ROW_WITH_COMMA.match(line)
    if found is None or any(found[1].count(a) != found[1].count(b) for a, b in ("[]", "{}")):
        return line
    return f"{found[1]} {found[2] or ''}"


def unwrap_rows(node: Node) -> Node:
    """Return the rows of a matrix that is written as OpenCV does (rows, cols, dt, data); anything else as it is.

    Raises
    ------
    FormatError
        If rows and cols do not fit the data.
    """
    if not (isinstance(node.value, dict) and "data" in node.value):
        return node
    values = [item.value for item in node.child("data").items()]
    rows, cols = (
        int(node.child(key).number()) if key in node.value else fallback
        for key, fallback in (("rows", 1), ("cols", len(values)))
    )
    if rows < 1 or cols < 1 or rows * cols != len(values):
        raise node.fail(f"rows {rows} and cols {cols} do not fit its {len(values)} numbers.")
    table = [values[i * cols : (i + 1) * cols] for i in range(rows)]
    return replace(node, value=table if min(rows, cols) > 1 else values)


def read_matrix(node: Node, rows: int, cols: int) -> Floats:
    """Return a matrix: a list of rows, of all numbers row by row, or a matrix of OpenCV's.

    Raises
    ------
    FormatError
        If it is another thing.
    """
    plain = unwrap_rows(node)
    if isinstance(plain.value, list) and len(plain.value) == rows * cols:
        return plain.floats(rows * cols).reshape(rows, cols)
    return plain.floats(rows, cols)


def read_transform(node: Node) -> Floats:
    """Return a rigid transformation (4, 4); its rotation is made exact, since numbers in files are rounded.

    Raises
    ------
    FormatError
        If it is none.
    """
    T = read_matrix(node, 4, 4)
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-6:
        turned = " It seems to be transposed." if np.abs(T[:, 3] - [0, 0, 0, 1]).max() <= 1e-6 else ""
        raise node.fail(f"the last row of the matrix is {T[3].tolist()}, expected [0, 0, 0, 1].{turned}")
    exact = np.eye(4)
    exact[:3, :3] = _nearest_rotation(T[:3, :3], node, "its left upper 3x3 part")
    if np.abs(T[:3, 3]).max() > _FARTHEST_M:
        raise node.fail(f"found the translation {T[:3, 3].tolist()} m. The unit is the metre; was it in millimetres?")
    exact[:3, 3] = T[:3, 3]
    return frozen_array(exact)


def read_rotation(node: Node) -> Floats:
    """Return a rotation matrix (3, 3), made exact.

    Raises
    ------
    FormatError
        If it is none.
    """
    return frozen_array(_nearest_rotation(read_matrix(node, 3, 3), node, "this"))


def _nearest_rotation(R: Floats, node: Node, what: str) -> Floats:
    error = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else float(np.abs(R).max())
    if error > _NO_ROTATION:
        raise node.fail(
            f"{what} is no rotation matrix: its rows should be of length 1 and at right angles, and miss that by "
            f"{error:.2g}."
        )
    if np.linalg.det(R) < 0:
        raise node.fail(f"{what} is mirrored (determinant -1), which no rotation is. Is the sign of an axis wrong?")
    if error < _EXACT:
        return R
    u, _, v = np.linalg.svd(R)
    return u @ v


_NOISE = "accelerometer_noise_density"


def read_sensors(root: Node, prefix: str, flat_key: str, expected: str) -> dict[str, Node]:
    """Return the sensors of a file keyed by name, "cam0", "cam1", ..., or the one of a file without such keys.

    Parameters
    ----------
    root : top of the file
    prefix : of the names, such as "cam"
    flat_key : key by which a file of one sensor without its name is known
    expected : what the file should be, for messages

    Raises
    ------
    FormatError
        If there is no such sensor in the file; the message says what the file seems to be instead.
    """
    entries = {node.key: node for node in root.entries()}
    named = {key: node for key, node in entries.items() if re.fullmatch(rf"{prefix}\d{{1,9}}", key)}
    if named:
        return dict(sorted(named.items(), key=lambda item: int(item[0].removeprefix(prefix))))
    if flat_key in entries:
        return {f"{prefix}0": root}
    raise root.fail(f"the key {prefix}0 is missing. Expected {expected}.{file_hint(root)}")


def file_hint(root: Node) -> str:
    """Return a sentence on what a file given in the wrong place seems to be; empty where nothing tells."""
    keys: set[str] = set()
    if isinstance(root.value, dict):
        keys = {str(key) for value in (root.value, *root.value.values()) if isinstance(value, dict) for key in value}
    kinds = (
        ("target_type", "a target, which belongs to --target"),
        ("camera_model", "a chain of cameras, which belongs to --cam"),
        (_NOISE, "the noise of an IMU, which belongs to --imu"),
    )
    return next((f" This seems to be {kind}." for key, kind in kinds if key in keys), "")


def passed_over(nodes: Iterable[Node], notes: list[str]) -> None:
    """Note keys that mean nothing to gnomon."""
    found = list(nodes)
    if found:
        names = ", ".join(node.path for node in found[:8]) + (", ..." if len(found) > 8 else "")
        notes.append(f"{file_name(found[0])}: {names} {'was' if len(found) == 1 else 'were'} passed over.")


def file_name(node: Node) -> str:
    """Return the name of the file without its folder."""
    return Path(node.file).name


def whole_number(node: Node) -> int:
    """Return a whole number, also one that is written like 6.0.

    Raises
    ------
    FormatError
        If it is another thing.
    """
    value = node.number()
    if value != int(value):
        raise node.fail(f"found {value:g}, expected a whole number.")
    return int(value)


def required_value(keys: dict[str, Node], name: str, parent: Node, expected: str) -> Node:
    """Return the value under a key.

    Raises
    ------
    FormatError
        If the key is missing; the message says what is expected there, and any key that was perhaps meant.
    """
    if name not in keys:
        from difflib import get_close_matches

        close = get_close_matches(name, keys, n=1, cutoff=0.7)
        meant = f" Found {close[0]}: was {name} meant?" if close else ""
        raise parent.fail(f"the key {name} is missing. Expected {expected}.{meant}")
    return keys[name]


def place_camera(T_imu_cam: Floats, shift_s: float, camera: Camera) -> CameraCalibration:
    """Return a camera by its place in the IMU's frame, and t_imu - t_cam."""
    return CameraCalibration(T_cam_body=inverse_pose(T_imu_cam), time_shift_cam_imu=shift_s, camera=camera)


def read_numbers(node: Node, names: tuple[str, ...]) -> Floats:
    """Return numbers under keys.

    Raises
    ------
    FormatError
        If one is missing.
    """
    keys = {child.key: child for child in node.entries()}
    return np.array([required_value(keys, name, node, "a number").number() for name in names])


def read_lens(
    node: Node,
    *,
    intrinsics: Floats,
    resolution: tuple[int, int],
    coeffs: Floats,
    distortion: DistortionName,
    projection: ProjectionName = "pinhole",
    topic: str = "",
) -> Camera:
    """Return a lens, with zeros for coefficients of radtan that are not stated; with k3 it is radtan5.

    Raises
    ------
    FormatError
        If its numbers are of no lens.
    """
    if distortion == "radtan" and len(coeffs) > len(DISTORTIONS[distortion].names) and coeffs[4] != 0:
        distortion = "radtan5"
    wanted = len(DISTORTIONS[distortion].names)
    if len(coeffs) > wanted and np.any(coeffs[wanted:]):
        raise node.fail(
            f"found {len(coeffs)} coefficients of distortion, and gnomon knows {wanted} of {distortion} only; those "
            "behind are not zero."
        )
    padded = np.zeros(wanted)
    padded[: min(wanted, len(coeffs))] = coeffs[:wanted]
    try:
        return Camera(
            projection=projection,
            intrinsics=intrinsics,
            distortion=distortion,
            distortion_coeffs=padded,
            resolution=resolution,
            topic=topic,
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def text_of(keys: Mapping[str, Node], name: str) -> str:
    """Return a text under a key, "" where there is none."""
    return str(keys[name].value or "") if name in keys else ""


def stated_noise(
    keys: Mapping[str, Node], names: Mapping[str, str], notes: list[str], divisor: float = 1.0
) -> ImuNoise | None:
    """Return the noise of an IMU where all of it is stated and of use; else None, and a note where it is of no use.

    Parameters
    ----------
    names : a program's key -> the name in `ImuNoise`
    divisor : by which the stated numbers are divided
    """
    found = {ours: keys[name].number() / divisor for name, ours in names.items() if name in keys}
    try:
        return ImuNoise(**found) if len(found) == len(names) else None
    except OptionError as error:
        notes.append(f"The noise was left out: {error}")
        return None


def noise_by_key(noise: ImuNoise, names: Mapping[str, str], factor: float = 1.0) -> dict[str, float]:
    """Return a program's keys and numbers of the noise of an IMU, the way back of `stated_noise`."""
    return {name: factor * getattr(noise, ours) for name, ours in names.items()}


def unit_quaternion(node: Node, q_wxyz: Floats) -> Floats:
    """Return the rotation (3, 3) of a quaternion (4,) whose length is one but for rounding.

    Raises
    ------
    FormatError
        If it is not.
    """
    length = float(np.linalg.norm(q_wxyz))
    if not 0.98 < length < 1.02:
        raise node.fail(f"the quaternion (qx, qy, qz, qw) has length {length:.3g}, expected 1.")
    return rotation_from_quaternion(normalise_quaternion(q_wxyz))
