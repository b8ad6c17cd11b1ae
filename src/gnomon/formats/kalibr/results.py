"""Kalibr's results, which people keep and send around: results-imucam.txt to its eight digits, and results-cam.txt.

Of cameras alone Kalibr prints "projection: [...] +- [...]" and "distortion: [...] +- [...]", and neither the resolution
nor all digits: both stand in camchain.yaml, which Kalibr writes along with it under a name alike.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, OptionError
from ...models.camera import Camera
from ...models.forms import KalibrAccelerometer, KalibrGyroscope
from ...models.target import Target
from ...recording import Floats, frozen_array
from ...recording.samples import ImuNoise
from ...results.calibration import (
    AccelerometerCalibration,
    CameraCalibration,
    GyroscopeCalibration,
    ImuCalibration,
)
from ..foreign import ForeignCalibration, ForeignImu, Residuals, Statistics, ideal_imu, recognised_frame
from ..shared.foreign_yaml import read_rotation, read_transform
from ..shared.structured import Node, read_structured_text
from .camchain import CameraInput, camera_of, is_kalibr_cam_results, read_camchain

_RESIDUAL = re.compile(
    r"(Reprojection|Gyroscope|Accelerometer) error \((\w+)\)\s*(\[.*?\])?:"
    r"\s*mean:?\s*(\S+?),\s*median:?\s*(\S+?),\s*std:\s*(\S+)"
)
_CAMERA, _IMU = re.compile(r"(cam\d+)\s*"), re.compile(r"(IMU\d+):?\s*")
_MATRICES = {"M": (3, 3), "A": (3, 3), "C_gyro_i": (3, 3), "rx_i": (3,), "ry_i": (3,), "rz_i": (3,)}
_LENS_KEYS = {"Camera model": "camera_model", "Distortion model": "distortion_model"}
_BOARD_KEYS = {"Type", "Rows", "Cols", "Size", "Count", "Distance", "Marker size", "Dictionary", "First", "Legacy"}
_LENS_LISTS = {"Focal length": "focal", "Principal point": "principal", "Distortion coefficients": "distortion_coeffs"}


def is_kalibr_results(text: str) -> bool:
    """Return whether a text is what Kalibr prints after a camera-IMU calibration."""
    return text.lstrip().startswith("Calibration results") and "T_ci" in text


def read_kalibr_results(path: str | PathLike[str]) -> ForeignCalibration:
    """Read Kalibr's results-imucam.txt, also gnomon's.

    The file does not state the resolution of the cameras; it is taken as twice the principal point. The
    camchain-imucam.yaml and imu.yaml of the same calibration have all digits.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not laid out as Kalibr does.
    """
    text = read_structured_text(path)
    if not is_kalibr_results(text):
        raise FormatError(f"{path}: expected Kalibr's results-imucam.txt, which begins with Calibration results.")
    page = _Page(str(path), text.split("Added by gnomon")[0].splitlines())
    page.read()
    notes: list[str] = []
    cameras = {name: page.camera(name, notes) for name in page.T_ci}
    data = {name: page.imu_data(name) for name in page.imus}
    imus = {name: data[name].placed(page.imu(name)) if i else page.imu(name) for i, name in enumerate(page.imus)}
    if cameras:
        notes.append(f"{Path(path).name} does not state the resolution; taken: twice the principal point.")
    if imus:
        notes.append("Kalibr's file holds no bias; taken: zero.")
    return ForeignCalibration(
        imus=imus,
        frame=recognised_frame(imus),
        notes=tuple(notes),
        cameras=cameras,
        imu_data=data,
        gravity_target=page.gravity,
        residuals={
            name: Residuals(normalised=found[True], plain=found[False])
            for name, found in page.residuals.items()
            if len(found) == 2
        },
        target=page.target(notes),
        format="Kalibr, results-imucam.txt",
        guessed_sizes=frozenset(cameras),
    )


@dataclass(slots=True)
class _Page:
    """The lines of the file, and what was found in them so far."""

    file: str
    lines: list[str]
    T_ci: dict[str, Node] = field(default_factory=dict[str, Node])
    shift: dict[str, float] = field(default_factory=dict[str, float])
    lenses: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    board: dict[str, Any] = field(default_factory=dict[str, Any])
    imus: dict[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    residuals: dict[str, dict[bool, Statistics]] = field(default_factory=dict[str, dict[bool, Statistics]])
    gravity: Floats | None = None

    def read(self) -> None:
        """Go through the lines once."""
        section: dict[str, Any] | None = None
        triad = ""
        for i, line in enumerate(self.lines):
            if found := _RESIDUAL.match(line):
                self._residual(i, found)
            elif line.startswith("T_ci"):
                name = line.split(" to ")[-1].split(")")[0]
                self.T_ci[name] = self._node(i, f"T_ci of {name}", self._array(i + 1, 16).reshape(4, 4))
            elif found := re.match(r"timeshift (cam\d+) to imu", line):
                self.shift[found[1]] = self._number(i + 1, self._line(i + 1))
            elif line.startswith("Gravity vector in target"):
                self.gravity = self._array(i + 1, 3)
            elif found := _CAMERA.fullmatch(line):
                section = self.lenses.setdefault(found[1], {})
            elif found := _IMU.fullmatch(line):
                section, triad = self.imus.setdefault(found[1].lower(), {}), ""
            elif section is not None:
                triad = line.strip().rstrip(":").lower() if line.strip() in {"Accelerometer:", "Gyroscope:"} else triad
                self._entry(i, line, section, triad)

    def _residual(self, i: int, found: re.Match[str]) -> None:
        kind, sensor, unit, *numbers = found.groups()
        name = sensor if kind == "Reprojection" else f"{sensor}.{kind.lower()}"
        values = [self._number(i, number) for number in numbers]
        statistics = Statistics(mean=values[0], median=values[1], std=values[2])
        self.residuals.setdefault(name, {})[unit is None] = statistics

    def _entry(self, i: int, line: str, section: dict[str, Any], triad: str) -> None:
        """Take one indented line of the configuration of a camera or an IMU."""
        key, _, rest = (part.strip() for part in line.partition(":"))
        bare = key.split(" [")[0]
        if key in _LENS_KEYS:
            section[_LENS_KEYS[key]] = rest
        elif key in _LENS_LISTS:
            section[_LENS_LISTS[key]] = self._numbers(i, rest)
        elif found := re.fullmatch(r"(Omni|EUCM|DS) (\w+)", key):
            section[found[2]] = self._number(i, rest)
        elif key in _BOARD_KEYS or key.startswith("Spacing"):
            self._board_entry(i, key, rest)
        elif key in {"Model", "Update rate", "Noise density", "Random walk"}:
            name = f"{triad} {key}" if key in {"Noise density", "Random walk"} else key
            section[name] = rest if key == "Model" else self._number(i, rest)
        elif key.startswith("time offset with respect to IMU0"):
            section["time offset"] = self._number(i, rest)
        elif key.startswith("T_ib"):
            section["T_ib"] = self._node(i, "T_ib", self._array(i + 1, 16).reshape(4, 4))
        elif bare in _MATRICES and not rest:
            shape = _MATRICES[bare]
            section[f"{triad} {bare}"] = self._array(i + 1, int(np.prod(shape))).reshape(shape)

    def _board_entry(self, i: int, key: str, rest: str) -> None:
        if key == "Type":
            self.board = {"Type": rest}
        elif key in {"Dictionary", "Legacy"}:
            self.board[key] = rest
        elif key in {"Marker size", "First"}:
            self.board[key] = self._number(i, rest)
        elif key in {"Rows", "Cols"}:
            self.board["counting"] = key
            if rest:
                self.board[key] = int(self._number(i, rest))
        elif key in {"Count", "Distance"}:
            self.board[f"{self.board.get('counting')} {key}"] = self._number(i, rest)
        else:
            self.board[key.split(maxsplit=1)[0]] = self._number(i, f"{key} {rest}")

    def camera(self, name: str, notes: list[str]) -> CameraCalibration:
        """Return one camera."""
        T = read_transform(self.T_ci[name])
        values = self.lenses.get(name, {})
        if not {"camera_model", "focal", "principal"} <= set(values):
            raise FormatError(f"{self.file}: the configuration of {name} is missing (Camera model, Focal length, ...).")
        shape = [values[key] for key in ("xi", "alpha", "beta") if key in values]
        document = {
            "camera_model": values["camera_model"],
            "intrinsics": [*shape, *values["focal"], *values["principal"]],
            "resolution": [max(1, round(2 * side)) for side in values["principal"]],
            "distortion_model": values.get("distortion_model", "none"),
            "distortion_coeffs": values.get("distortion_coeffs", []),
        }
        node = Node(file=self.file, path=name, value=document)
        camera: Camera = camera_of(node, {child.key: child for child in node.entries()}, notes)
        return CameraCalibration(T_cam_body=T, time_shift_cam_imu=self.shift.get(name, 0.0), camera=camera)

    def imu(self, name: str) -> ImuCalibration:
        """Return one IMU."""
        values = self.imus[name]
        if "accelerometer M" not in values:
            return ideal_imu()
        zero = np.zeros(3)
        S_a, b_a = KalibrAccelerometer(M=values["accelerometer M"], b=zero).to_sensor()
        accelerometer = AccelerometerCalibration(
            sensitivity=S_a, bias=b_a, unit="m/s^2", lever_arms_m=_lever_arms(values)
        )
        if not {"gyroscope M", "gyroscope A", "gyroscope C_gyro_i"} <= set(values):
            return ImuCalibration(accelerometer=accelerometer)
        C = read_rotation(Node(file=self.file, path=f"{name}.C_gyro_i", value=values["gyroscope C_gyro_i"].tolist()))
        form = KalibrGyroscope(M=values["gyroscope M"], A=values["gyroscope A"], C_gyro_i=C, b=zero)
        S_g, b_g, G = form.to_sensor()
        gyroscope = GyroscopeCalibration(sensitivity=S_g, bias=b_g, g_sensitivity=G, unit="rad/s")
        return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)

    def imu_data(self, name: str) -> ForeignImu:
        """Return what is said of an IMU besides its model."""
        values = self.imus[name]
        return ForeignImu(
            noise=_read_noise(values),
            update_rate_hz=values.get("Update rate"),
            T_imu_body=read_transform(values["T_ib"]) if "T_ib" in values else None,
            time_offset_s=values.get("time offset"),
            lever_arms_m=_lever_arms(values),
        )

    def target(self, notes: list[str]) -> Target | None:
        """Return the board; None where it is not described."""
        board = self.board
        try:
            match board.get("Type"):
                case "aprilgrid":
                    return Target.aprilgrid(
                        tag_cols=board["Cols"],
                        tag_rows=board["Rows"],
                        tag_size_m=board["Size"],
                        tag_spacing=float(f"{board['Spacing'] / board['Size']:.12g}"),  # Kalibr printed the product
                    )
                case "checkerboard":
                    return Target.checkerboard(
                        cols=int(board["Cols Count"]),
                        rows=int(board["Rows Count"]),
                        row_spacing_m=board["Rows Distance"],
                        col_spacing_m=board["Cols Distance"],
                    )
                case "charuco":
                    return Target.charuco(
                        cols=board["Cols"],
                        rows=board["Rows"],
                        square_size_m=board["Size"],
                        marker_size_m=board["Marker size"],
                        dictionary=board["Dictionary"],
                        first_marker=int(board["First"]),
                        legacy=board["Legacy"] == "yes",
                    )
                case "circlegrid":
                    notes.append("The file does not say whether the grid of circles is asymmetric; taken: it is not.")
                    return Target.circlegrid(
                        cols=int(board["Cols Count"]),
                        rows=int(board["Rows Count"]),
                        spacing_m=board["Rows Distance"],
                    )
                case _:
                    return None
        except (KeyError, ZeroDivisionError, OptionError) as error:
            notes.append(f"The board was left out: its description is incomplete ({error}).")
            return None

    def _line(self, i: int) -> str:
        return self.lines[i] if i < len(self.lines) else ""

    def _number(self, i: int, text: str) -> float:
        """Return the first number in a text."""
        for word in text.split():
            try:
                value = float(word)
            except ValueError:
                continue
            if np.isfinite(value):
                return value
        raise FormatError(f"{self.file}, line {i + 1}: found {text.strip()!r}, expected a number.")

    def _numbers(self, i: int, text: str) -> list[float]:
        """Return a list of numbers between brackets."""
        words = text.strip("[]").replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = [float("nan")]
        if not text.startswith("[") or not np.isfinite(values).all():
            raise FormatError(f"{self.file}, line {i + 1}: found {text!r}, expected numbers between brackets.")
        return values

    def _array(self, start: int, count: int) -> Floats:
        """Return the numbers of an array that NumPy printed over several lines."""
        text = " ".join(self._bracketed(start))
        try:
            values = np.array([float(word) for word in re.sub(r"[\[\],]", " ", text).split()])
        except ValueError:
            values = np.empty(0)
        if len(values) != count or not np.isfinite(values).all():
            raise FormatError(f"{self.file}, line {start + 1}: expected an array of {count} numbers between brackets.")
        return values

    def _bracketed(self, start: int) -> Iterator[str]:
        depth = 0
        for line in self.lines[start : start + 12]:
            yield line
            depth += line.count("[") - line.count("]")
            if depth <= 0:
                return

    def _node(self, i: int, path: str, values: Floats) -> Node:
        return Node(file=f"{self.file}, line {i + 1}", path=path, value=values.tolist())


def _lever_arms(values: dict[str, Any]) -> Floats | None:
    arms = [values.get(f"accelerometer {axis}") for axis in ("rx_i", "ry_i", "rz_i")]
    return None if any(arm is None for arm in arms) else np.array(arms)


def _read_noise(values: dict[str, Any]) -> ImuNoise | None:
    numbers = {
        f"{triad}_{ours}": values.get(f"{triad} {theirs}")
        for triad in ("accelerometer", "gyroscope")
        for ours, theirs in (("noise_density", "Noise density"), ("random_walk", "Random walk"))
    }
    found = {name: value for name, value in numbers.items() if value is not None and value > 0}
    return ImuNoise(**found) if len(found) == 4 else None


RESULTS_FILE = "results-imucam.txt"
LENS_NAMES = {"pinhole": (), "omni": ("Omni xi",), "eucm": ("EUCM alpha", "EUCM beta"), "ds": ("DS xi", "DS alpha")}
_CAMERA_BLOCK = re.compile(r"^(cam\d+) \(.*\):\s*$", re.MULTILINE)
_CAMERA_RESULTS_NAME = re.compile(r"results-cam(?=[-.])")


def read_cam_results(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, CameraInput]:
    """Read cameras with the standard deviations of their lenses; camchain.yaml has to be beside the file.

    Parameters
    ----------
    path : results-cam.txt, or such as data-results-cam.txt with data-camchain.yaml beside it
    notes : where sentences on what was taken are appended

    Raises
    ------
    FormatError
        If a file cannot be read, is not laid out as Kalibr does, or the two do not belong together.
    """
    file = Path(path)
    text = read_structured_text(path)
    if not is_kalibr_cam_results(text):
        raise FormatError(f"{path}: expected Kalibr's results-cam.txt, with Camera-system parameters in it.")
    chain = file.with_name(_CAMERA_RESULTS_NAME.sub("camchain", file.name)).with_suffix(".yaml")
    if not chain.is_file() and (file.parent / "camchain.yaml").is_file():
        chain = file.parent / "camchain.yaml"
    if not chain.is_file():
        raise FormatError(
            f"{path}: it does not state the resolution, and {chain.name} is not beside it. Put the camchain.yaml that "
            "Kalibr wrote along with it there."
        )
    said: list[str] = [] if notes is None else notes
    blocks = _CAMERA_BLOCK.split(text)[1:]
    printed = {name: _parameters(path, name, block) for name, block in zip(blocks[::2], blocks[1::2], strict=True)}
    cameras = read_camchain(chain, said)
    for name, camera in cameras.items():
        if name not in printed:
            said.append(f"{file.name} has no standard deviations of {name}.")
            continue
        values, sigmas = printed[name]
        stated = camera.camera.parameters
        if values.shape != stated.shape or not np.allclose(values, stated, rtol=1e-4, atol=1e-6):
            raise FormatError(
                f"{path}: {name} has projection and distortion {values.tolist()}, but {chain.name} has "
                f"{stated.tolist()}. The two files are not of one calibration."
            )
        if not (sigmas > 0).all():
            said.append(f"{file.name}: the standard deviations of {name} are not all above zero; they were left out.")
            continue
        cameras[name] = replace(camera, lens_covariance=frozen_array(np.diag(np.square(sigmas))))
    said.append(f"{chain.name} holds the cameras of {file.name}, which does not tell how its errors hang together.")
    return cameras


def _parameters(path: str | PathLike[str], name: str, block: str) -> tuple[Floats, Floats]:
    """Return projection and distortion, and their standard deviations."""
    found: list[list[float]] = [[], []]
    for key in ("projection", "distortion"):
        match = re.search(rf"^[ \t]*{key}:\s*\[([^\]]*)\]\s*\+-\s*\[([^\]]*)\]", block, re.MULTILINE)
        try:
            pair = (
                [[float(word) for word in part.replace(",", " ").split()] for part in match.groups()] if match else []
            )
        except ValueError:
            pair = []
        if not pair:
            raise FormatError(f"{path}: {name} has no line {key}: [...] +- [...] with numbers.")
        if len(pair[0]) != len(pair[1]):
            raise FormatError(f"{path}: {name} has {len(pair[0])} values of {key}, and {len(pair[1])} behind +-.")
        found[0] += pair[0]
        found[1] += pair[1]
    return np.array(found[0]), np.array(found[1])
