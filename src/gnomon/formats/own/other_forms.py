"""A calibration of gnomon's in other forms: a table of name, value, sigma and unit, which reads back; JSON.

Spreadsheets return the table. JSON is the whole of calibration.yaml, key by key, with what the numbers mean in words;
`gnomon.load` reads it. Numbers read back bit by bit; those that are not finite, which JSON does not know, are the texts
"nan" and "inf".
"""

import csv
import json
import math
import re
from collections.abc import Iterator
from os import PathLike
from typing import Any

import numpy as np
import yaml

from ...errors import FormatError, OptionError
from ...geometry.rotations import rotation_from_rotvec
from ...models.camera import PROJECTIONS, Camera
from ...models.distortions import DISTORTIONS
from ...recording import Floats
from ...results.calibration import (
    AccelerometerCalibration,
    Calibration,
    CameraCalibration,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
    calibration_parameters,
    element_names,
)
from ...results.sensors import element_units
from ...results.temperature_dependence import HIGHEST_ORDER, TEMPERATURE_PARTS, TemperatureDependence
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT
from ..foreign import ForeignCalibration, recognised_frame
from ..shared.entries import IMU_EQUATION, camera_equation
from ..shared.losses import Context, Export, Loss
from ..shared.structured import read_structured_text
from .calibration_file import FIELD_UNITS
from .calibration_text import FRAMES, TEMPERATURE_NUMBERS, calibration_text

_LARGEST_SIGMA = 1e100  # whose square is a number
_SHAPES = {
    "accelerometer": {"sensitivity": (3, 3), "bias": (3,)},
    "gyroscope": {"sensitivity": (3, 3), "bias": (3,), "g_sensitivity": (3, 3)},
    "magnetometer": {"sensitivity": (3, 3), "bias": (3,)},
}


def read_parameter_csv(path: str | PathLike[str]) -> ForeignCalibration:
    """Read the IMUs and the cameras of the table; cameras of older versions, without resolution, are passed over.

    Raises
    ------
    FormatError
        If the file cannot be read, or a row is missing or is not as expected.
    """
    lines = read_structured_text(path).splitlines()
    rows = list(csv.reader(lines))
    if not rows or rows[0] != ["name", "value", "sigma", "unit"]:
        raise FormatError(f"{path}, line 1: expected name,value,sigma,unit. Give a table that gnomon convert made.")
    table: dict[str, tuple[int, list[str]]] = {}
    for number, row in enumerate(rows[1:], start=2):
        if row and row[0] == "comment":
            continue
        if len(row) != 4 or row[0] in table:
            problem = f"{row[0]} stands here twice" if len(row) == 4 else f"found {len(row)} columns, expected 4"
            raise FormatError(f"{path}, line {number}: {problem}.")
        table[row[0]] = number, row
    frame = table.pop("body_frame", (0, ["", ""]))[1][1]
    table.pop("gravity", None)
    names = sorted({name.split(".")[0] for name in table})
    notes: list[str] = []
    cameras: dict[str, CameraCalibration] = {}
    reader = _Table(path, table, alone=frame == "cam0")
    for name in [name for name in names if re.fullmatch(r"cam\d+", name)]:
        if f"{name}.resolution" in table:
            cameras[name] = reader.camera(name)
            continue
        notes.append(f"{name} was passed over.")
        for key in [key for key in table if key.split(".")[0] == name]:
            del table[key]
    imus = {name: reader.imu(name) for name in names if not re.fullmatch(r"cam\d+", name)}
    if table:
        name, (number, _) = next(iter(table.items()))
        raise FormatError(f"{path}, line {number}: {name} is no parameter of a calibration.")
    return ForeignCalibration(
        imus=imus,
        frame=frame if reader.alone else recognised_frame(imus),
        sigmas=reader.sigmas,
        notes=tuple(notes),
        cameras=cameras,
        format="gnomon's csv",
    )


class _Table:
    """Takes parameters out of the rows."""

    def __init__(self, path: str | PathLike[str], rows: dict[str, tuple[int, list[str]]], *, alone: bool) -> None:
        self.path, self.rows, self.alone = path, rows, alone
        self.sigmas: dict[str, Floats] = {}

    def imu(self, name: str) -> ImuCalibration:
        """Return the triads of an IMU that have rows."""
        there = [triad for triad in _SHAPES if any(row.startswith(f"{name}.{triad}.") for row in self.rows)]
        if not there:
            raise FormatError(f"{self.path}: {name} has no row of an accelerometer, a gyroscope or a magnetometer.")
        return ImuCalibration(
            accelerometer=self.accelerometer(name) if "accelerometer" in there else None,
            gyroscope=self.gyroscope(name) if "gyroscope" in there else None,
            magnetometer=self.magnetometer(name) if "magnetometer" in there else None,
            **self.placed(name),
            temperature=self.temperature(name),
        )

    def temperature(self, name: str) -> TemperatureDependence | None:
        """Return how an IMU changes with the temperature; None where no row tells."""
        if f"{name}.temperature.{TEMPERATURE_NUMBERS[0]}" not in self.rows:
            return None
        reference, low, high, lag = (float(self.words(f"{name}.temperature.{key}")) for key in TEMPERATURE_NUMBERS)
        parts: dict[str, Floats] = {}
        for part, shape in TEMPERATURE_PARTS.items():
            path, first = f"{name}.temperature.{part}", ",0" * len(shape)
            order = sum(f"{path}[{j}{first}]" in self.rows for j in range(HIGHEST_ORDER))
            if order:
                parts[part] = self.take(path, (order, *shape))[0]
        return TemperatureDependence(reference_degc=reference, low_degc=low, high_degc=high, lag_s=lag, **parts)

    def placed(self, name: str) -> dict[str, Any]:
        """Return pose and clock of an IMU beside the body; nothing of the body."""
        pose, shift = f"{name}.T_imu_body", f"{name}.time_shift_imu"
        if f"{pose}.rotation[0]" not in self.rows:
            return {}
        T = np.eye(4)
        T[:3, :3] = rotation_from_rotvec(self.take(f"{pose}.rotation", (3,))[0])
        T[:3, 3] = self.take(f"{pose}.translation", (3,))[0]
        return {"T_imu_body": T, "time_shift_s": float(self.take(shift, ())[0])}

    def camera(self, name: str) -> CameraCalibration:
        """Return a camera; its rotation is a rotation vector."""
        projection, _, distortion = self.words(f"{name}.model").partition("-")
        shape = next((known for name, known in PROJECTIONS.items() if name == projection), None)
        bent = next((known for name, known in DISTORTIONS.items() if name == distortion), None)
        if shape is None or bent is None:
            raise FormatError(f'{self.path}: {name}.model is "{projection}-{distortion}", which is no model of a lens.')
        sides = self.words(f"{name}.resolution").split()
        if len(sides) != 2 or not all(side.isdigit() for side in sides):
            raise FormatError(f"{self.path}: {name}.resolution is {' '.join(sides)!r}, expected width and height.")
        T = np.eye(4)
        link = f"{name}.{'T_cam_cam0' if self.alone else 'T_cam_imu'}"
        if not self.alone or name != "cam0":
            T[:3, :3] = rotation_from_rotvec(self.take(f"{link}.rotation", (3,))[0])
            T[:3, 3] = self.take(f"{link}.translation", (3,))[0]
        delayed = not self.alone or f"{name}.line_delay" in self.rows
        try:
            camera = Camera(
                projection=projection,  # pyright: ignore[reportArgumentType]
                intrinsics=self.take(f"{name}.intrinsics", (len(shape.names) + 4,))[0],
                distortion=distortion,  # pyright: ignore[reportArgumentType]
                distortion_coeffs=self.take(f"{name}.distortion_coeffs", (len(bent.names),))[0],
                resolution=(int(sides[0]), int(sides[1])),
                line_delay_s=float(self.take(f"{name}.line_delay", ())[0]) if delayed else 0.0,
                topic=self.words(f"{name}.rostopic") if f"{name}.rostopic" in self.rows else "",
            )
        except OptionError as error:
            raise FormatError(f"{self.path}: {name}: {error}") from None
        if self.alone:
            self.sigmas.pop(f"{name}.line_delay", None)
            return CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=camera, body="cam0")
        shift = float(self.take(f"{name}.time_shift_cam_imu", ())[0])
        return CameraCalibration(T_cam_body=T, time_shift_cam_imu=shift, camera=camera)

    def words(self, name: str) -> str:
        """Return a value that is no number."""
        if name not in self.rows:
            raise FormatError(f"{self.path}: the row {name} is missing.")
        return self.rows.pop(name)[1][1]

    def accelerometer(self, name: str) -> AccelerometerCalibration:
        """Return the accelerometer, with its lever arms where there are any."""
        found = self.triad(name, "accelerometer")
        unit = self.unit(found["bias"][1], ACCELEROMETER_UNITS_M_S2)
        arms = f"{name}.accelerometer.lever_arms_m"
        known: dict[str, Any] = {"lever_arms_m": self.take(arms, (3, 3))[0]} if f"{arms}[0,0]" in self.rows else {}
        shift = f"{name}.accelerometer.time_shift"
        known |= {"time_shift_s": float(self.take(shift, ())[0])} if shift in self.rows else {}
        return AccelerometerCalibration(**{key: value for key, (value, _) in found.items()}, **known, unit=unit)

    def gyroscope(self, name: str) -> GyroscopeCalibration:
        found = self.triad(name, "gyroscope")
        unit = self.unit(found["bias"][1], GYROSCOPE_UNITS_RAD_S)
        return GyroscopeCalibration(**{key: value for key, (value, _) in found.items()}, unit=unit)

    def magnetometer(self, name: str) -> MagnetometerCalibration:
        """Return the magnetometer; the unit of its sensitivity tells that of the field."""
        found = self.triad(name, "magnetometer")
        unit = self.unit(found["bias"][1], MAGNETOMETER_UNITS_UT)
        stated = {"1" if unit == field else f"{unit}/{field}": field for field in FIELD_UNITS}
        if found["sensitivity"][1] not in stated:
            raise FormatError(
                f'{self.path}: the sensitivity of the magnetometer is in "{found["sensitivity"][1]}", expected '
                f"{' or '.join(stated)}."
            )
        values = {key: value for key, (value, _) in found.items()}
        return MagnetometerCalibration(**values, unit=unit, field_unit=stated[found["sensitivity"][1]])

    def triad(self, name: str, triad: str) -> dict[str, tuple[Floats, str]]:
        return {key: self.take(f"{name}.{triad}.{key}", shape) for key, shape in _SHAPES[triad].items()}

    def take(self, parameter: str, shape: tuple[int, ...]) -> tuple[Floats, str]:
        """Return the value of a parameter and the unit of its last row."""
        values, sigmas, unit = np.empty(shape), np.empty(shape), ""
        for index in np.ndindex(shape):
            name = f"{parameter}[{','.join(map(str, index))}]" if index else parameter
            if name not in self.rows:
                raise FormatError(f"{self.path}: the row {name} is missing.")
            number, row = self.rows.pop(name)
            try:
                values[index], sigmas[index] = float(row[1]), float(row[2])
            except ValueError:
                raise FormatError(
                    f"{self.path}, line {number}: found {row[1]!r} and {row[2]!r}, expected two numbers."
                ) from None
            if sigmas[index] < 0 or sigmas[index] > _LARGEST_SIGMA:  # nan: not known
                raise FormatError(f"{self.path}, line {number}: {row[2]} is no standard deviation.")
            unit = row[3]
        self.sigmas[parameter] = sigmas
        return values, unit

    def unit(self, found: str, known: dict[str, float | None]) -> str:
        """Return a unit of a bias, which is that of the samples."""
        if found not in known:
            raise FormatError(f'{self.path}: the bias is in "{found}", expected one of {", ".join(known)}.')
        return found


_EQUATION = (
    "measured = sensitivity true + bias, of the gyroscope + g_sensitivity f; f specific force [m/s^2]; rows: sensor "
    "axes, columns: body axes; body frame {frame}: {words}"
)
_ROTATION = (
    "every ...rotation[0..2] is a rotation vector: axis times angle [rad], R = exp of its cross-product matrix; its "
    "sigmas are about the axes of the frame on the right of the name"
)


def export_csv(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.csv`: a row for every scalar of every IMU and camera, for gravity, body frame and lenses."""
    frame = calibration.frame
    rows = ["name,value,sigma,unit"]
    equation = _EQUATION.format(frame=frame, words=FRAMES.get(frame, FRAMES["user"]))
    rows += [f"comment,{_text(equation)},,"] if calibration.imus else []
    rows += [f"comment,{_text(camera_equation(calibration))},,"] if calibration.cameras else []
    posed = [
        path for path, _ in calibration_parameters(calibration.imus, calibration.cameras) if path.endswith(".rotation")
    ]
    rows += [f"comment,{_text(_ROTATION)},,"] if posed else []
    placed = any(imu.T_imu_body is not None for imu in calibration.imus.values())
    rows += [f"comment,{_text(IMU_EQUATION)},,"] if placed else []
    rows += [f"comment,{_text(remark)},," for remark in context.remarks]
    rows.append(f"body_frame,{frame},,")
    if calibration.imus:
        rows.append(f"gravity,{float(calibration.gravity.value)!r},{float(calibration.gravity.sigma)!r},m/s^2")
    alone = not calibration.imus
    rows += [row for name, camera in calibration.cameras.items() for row in _camera(name, camera.camera, alone=alone)]
    for name, imu in calibration.imus.items():
        if imu.temperature is not None:
            units = (*["degC"] * 3, "s")
            known = [(key, float(getattr(imu.temperature, key))) for key in TEMPERATURE_NUMBERS]
            rows += [
                f"{name}.temperature.{key},{value!r},,{unit}" for (key, value), unit in zip(known, units, strict=True)
            ]
    for path, value in calibration_parameters(calibration.imus, calibration.cameras):
        numbers = value.ravel().tolist(), calibration.sigma(path).ravel().tolist(), element_units(calibration, path)
        for name, number, sigma, unit in zip(element_names(path, value.shape), *numbers, strict=True):
            rows.append(f'"{name}",{number!r},{sigma!r},{unit}')
    loss = Loss(
        what="correlations and origin",
        why="the table has sigmas, but no covariances, no verdict and no provenance. Keep calibration.yaml.",
    )
    return Export(files={"calibration.csv": "\n".join(rows) + "\n"}, losses=(loss,))


def _camera(name: str, camera: Camera, *, alone: bool) -> Iterator[str]:
    """Yield what is no number that was estimated."""
    yield f"{name}.model,{camera.model},,"
    yield f"{name}.resolution,{camera.resolution[0]} {camera.resolution[1]},,px"
    if alone and camera.line_delay_s:
        yield f"{name}.line_delay,{float(camera.line_delay_s)!r},0.0,s"
    if camera.topic:
        yield f"{name}.rostopic,{_text(camera.topic)},,"


def _text(text: str) -> str:
    quoted = text.replace('"', '""')
    return f'"{quoted}"'


JSON_FILE = "calibration.json"
_LENSES_ALONE = {
    "T_cam_cam0": "p_cam = T_cam_cam0 p_cam0 [m], 4x4 row by row: from the frame of cam0 (x right, y down, z forward) "
    "to that of the camera.",
    "sigma": "every *_sigma is one standard deviation; T_cam_cam0_rotation_sigma is that of a small rotation about the "
    "axes of cam0 [rad].",
}
_DEFINITIONS = {
    "imus": "measured = sensitivity * true + bias, of the gyroscope + g_sensitivity * f, in the unit of each sensor; f "
    "specific force [m/s^2], true rate [rad/s], in the body frame; rows are sensor axes, columns body axes.",
    "T_cam_imu": "p_cam = T_cam_imu p_imu [m], 4x4 row by row: from the body frame of imu0 to the camera's (x right, "
    "y down, z forward).",
    "time_shift_cam_imu": "t_imu = t_cam + time_shift_cam_imu [s]; row v of an image is line_delay * v later [s].",
    "T_imu_body": "p_imu = T_imu_body p_body [m], 4x4 row by row: from the body frame, imu0's, to that of another IMU.",
    "time_shift_imu": "t_imu0 = t_imu + time_shift_imu [s], of the timestamps of the gyroscopes; of an accelerometer "
    "t_gyroscope = t_accelerometer + time_shift [s].",
    "sigma": "every *_sigma is one standard deviation; T_cam_imu_rotation_sigma is that of a small rotation about the "
    "body's axes [rad].",
    "covariance": "lower_triangle[i][j] is the covariance of names[i] and names[j]; 0 where a scalar was held fixed.",
}


def export_json(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.json`; nothing is lost."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    document = _plain(yaml.load(calibration_text(calibration), Loader=loader))
    frame = f"{calibration.frame}: {FRAMES.get(calibration.frame, FRAMES['user'])}"
    words = _DEFINITIONS if calibration.imus else _LENSES_ALONE | {"covariance": _DEFINITIONS["covariance"]}
    comment = {"made by": "gnomon", **words, "body_frame": frame, "remarks": list(context.remarks)}
    text = json.dumps(
        {"schema": document["schema"], "comment": comment, **document}, indent=2, ensure_ascii=False, allow_nan=False
    )
    return Export(files={JSON_FILE: text + "\n"})


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list) else value
