"""Another project's calibration as tables, and as a document for programs."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any

import numpy as np

from ..formats.foreign import ForeignCalibration, ForeignImu, stated_calibration
from ..models.camera import Camera
from .tables import ParameterRows, Row, form_tables

_FIXED = " (fixed)"
_NOISE_UNITS = {
    "accelerometer_noise_density": "m/s^2/sqrt(Hz)",
    "accelerometer_random_walk": "m/s^3/sqrt(Hz)",
    "gyroscope_noise_density": "rad/s/sqrt(Hz)",
    "gyroscope_random_walk": "rad/s^2/sqrt(Hz)",
}


def foreign_tables(foreign: ForeignCalibration, form: str = "sensitivity") -> tuple[ParameterRows, ...]:
    """Return what a file of another project tells; values without standard deviations, where the file has none.

    Parameters
    ----------
    form : of the sensor model, as for `writers.tables.form_tables`

    Raises
    ------
    OptionError
        If there is no such form, or it cannot represent the sensor.
    """
    found = [_summary(foreign)]
    if foreign.imus or foreign.cameras:
        found += form_tables(stated_calibration(foreign, unknown=0.0), form)
    found += [_lens_table(name, camera) for name, camera in foreign.lenses.items()]
    if foreign.sigmas:
        return tuple(table for table in found if table.rows)
    return tuple(_without_sigmas(table) for table in found if table.rows)


def foreign_document(foreign: ForeignCalibration) -> dict[str, Any]:
    """Return what a program is told about a file of another project."""
    return {field.name: _plain(getattr(foreign, field.name)) for field in fields(foreign)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, frozenset):
        return sorted(value)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value) if field.init}
    return list(value) if isinstance(value, tuple) else value  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]


def _summary(foreign: ForeignCalibration) -> ParameterRows:
    rows = [Row(name="format", value=foreign.format, unit="")]
    if foreign.imus:
        rows.append(Row(name="body frame", value=foreign.frame, unit=""))
    if foreign.target is not None:
        rows.append(Row(name="board", value=foreign.target.describe(), unit=""))
    if foreign.gravity_target is not None:
        rows.append(Row(name="gravity, board's frame", value=_numbers(foreign.gravity_target), unit="m/s^2"))
    for name, data in foreign.imu_data.items():
        rows += [Row(name=f"{name} {row.name}", value=row.value, unit=row.unit) for row in _imu_rows(data)]
    units = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}
    for name, found in foreign.residuals.items():
        unit = units.get(name.split(".")[-1], "px")
        rows.append(Row(name=f"{name} residual, mean", value=f"{found.plain.mean:.6g}", unit=unit))
        rows.append(Row(name=f"{name} residual, mean", value=f"{found.normalised.mean:.6g}", unit="sigma"))
    note = "" if foreign.sigmas else "without standard deviations"
    return ParameterRows(title="another project's file", note=note, rows=tuple(rows))


def _imu_rows(data: ForeignImu) -> Iterator[Row]:
    for name, value in ({} if data.noise is None else asdict(data.noise)).items():
        yield Row(name=name, value=f"{value:.6g}", unit=_NOISE_UNITS[name])
    if data.update_rate_hz is not None:
        yield Row(name="update rate", value=f"{data.update_rate_hz:.6g}", unit="Hz")
    if data.topic:
        yield Row(name="topic", value=data.topic, unit="")
    if data.time_offset_s:
        yield Row(name="time offset to imu0", value=f"{data.time_offset_s:.6g}", unit="s")
    if data.T_imu_body is not None and not np.array_equal(data.T_imu_body, np.eye(4)):
        for i, row in enumerate(data.T_imu_body[:3]):
            yield Row(name=f"T_imu_imu0, row {i}", value=_numbers(row), unit="1; m")


def _lens_table(name: str, camera: Camera) -> ParameterRows:
    units = {"focal": "px", "principal": "px"}
    rows = [
        Row(name=symbol, value=f"{value:.6g}", unit=units.get(kind, "1"))
        for symbol, kind, value in zip(
            camera.parameter_symbols, camera.parameter_kinds, camera.parameters.tolist(), strict=True
        )
    ]
    width, height = camera.resolution
    rows.append(Row(name="resolution", value=f"{width} x {height}", unit="px"))
    return ParameterRows(title=f"{name}, {camera.model}", note="its pose is not stated", rows=tuple(rows))


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in np.asarray(values).tolist())


def _without_sigmas(table: ParameterRows) -> ParameterRows:
    rows = [Row(name=row.name, value=row.value.removesuffix(_FIXED), unit=row.unit) for row in table.rows]
    return ParameterRows(title=table.title, note=table.note, rows=tuple(rows))
