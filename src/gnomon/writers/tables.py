"""A calibration as tables of names, values with sigmas, and units, in letters of gnomon, a document or Kalibr."""

import csv
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from io import StringIO
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import OptionError
from ..findings import share_words
from ..formats.foreign import ForeignCalibration, ForeignImu, stated_calibration
from ..formats.shared import entries
from ..formats.shared.entries import IMU_EQUATION, FormEntry, camera_entries, camera_equation, imu_entries, value_text
from ..frozen import value_class
from ..geometry.rotations import Floats, frame_rotation
from ..models.camera import Camera
from ..results.calibration import (
    TRUTH_METHOD,
    Calibration,
    CameraImuFit,
    CamerasFit,
    ImuCalibration,
    calibration_parameters,
)
from ..results.result import counted_things, held_out_errors, modelled_thing, rests_on_gravity
from ..results.sensors import element_units

if TYPE_CHECKING:
    from ..assess.comparison.comparison import Comparison


_Entries = Callable[..., Iterator[FormEntry]]
_FORMS: dict[str, tuple[str | None, _Entries, _Entries, _Entries]] = {
    "sensitivity": (
        None,
        entries.sensitivity_accelerometer,
        entries.sensitivity_gyroscope,
        entries.sensitivity_magnetometer,
    ),
    "tedaldi": (
        "accel-z",
        entries.tedaldi_accelerometer,
        entries.tedaldi_gyroscope,
        entries.sensitivity_magnetometer,
    ),
    "krebs": (
        "accel-x",
        entries.krebs_accelerometer,
        entries.krebs_gyroscope,
        entries.sensitivity_magnetometer,
    ),
    "angrisano": (
        "accel-z",
        entries.angrisano_accelerometer,
        entries.angrisano_gyroscope,
        entries.angrisano_magnetometer,
    ),
    "kalibr": (
        "accel-x",
        entries.kalibr_accelerometer,
        entries.kalibr_gyroscope,
        entries.sensitivity_magnetometer,
    ),
}
"""Form -> the frame of its accelerometer (None: any), and what each triad consists of."""
_TRIADS = ("accelerometer", "gyroscope", "magnetometer")
_POINTS = {"optimal": "p*", "x": "x accelerometer", "y": "y accelerometer", "z": "z accelerometer"}
_MAGNETOMETER = "measured = sensitivity m + bias; the sensitivity holds soft iron, the bias hard iron"
_EQUATIONS = {
    "sensitivity": (
        "measured = sensitivity f + bias",
        "measured = sensitivity w + bias + g_sensitivity f",
        _MAGNETOMETER,
    ),
    "tedaldi": (
        "Tedaldi: f = T K (measured + b), T = [1 -yz zy; 0 1 -zx; 0 0 1]",
        "Tedaldi: w = T K (measured + b - B f), T = [1 -yz zy; xz 1 -zx; -xy yx 1]",
        _MAGNETOMETER,
    ),
    "krebs": (
        "Krebs: measured = S M f + b, M = [1 0 0; yz 1 0; zy zx 1]",
        "Krebs, ch. 3: measured = S M C_bg' w + B C_bg' f + b (reading B1); in ch. 4, B' f in place of B C_bg' f "
        "(reading B2); q_bg is the Hamilton quaternion of C_bg",
        _MAGNETOMETER,
    ),
    "angrisano": (
        "Angrisano: f = T K (measured - b), T = [1 az ay; 0 1 ax; 0 0 1]",
        "Angrisano: C_gb w = T K (measured - b - B f), T = [1 az ay; 0 1 ax; 0 0 1], in the gyroscope's own frame",
        "Angrisano: C_mb m = T K (measured - b), T = [1 az ay; 0 1 ax; 0 0 1], in the magnetometer's own frame",
    ),
    "kalibr": (
        "Kalibr: measured = M f + bias",
        "Kalibr: measured = M C_gyro_i w + A C_gyro_i f + bias; AC = A C_gyro_i. Of Krebs's B_g, A is reading B1, "
        "AC reading B2",
        _MAGNETOMETER,
    ),
}


@value_class(eq=True)
class Row:
    """A line of a table: name, value with its sigma as text, unit."""

    name: str
    value: str
    unit: str


@value_class(eq=True)
class ParameterRows:
    """Rows under a title; `note` is the equation that defines the names."""

    title: str
    note: str
    rows: tuple[Row, ...]


def form_tables(calibration: Calibration, form: str = "sensitivity") -> tuple[ParameterRows, ...]:
    """Return one table for each triad, for each pose of an IMU and for each camera, every value with its sigma.

    Sigmas follow from the covariance by the Jacobian of the whole way from gnomon's parameters to the form's, change of
    frame included.

    Parameters
    ----------
    form : "sensitivity" (gnomon's own, in the calibration's frame), "tedaldi", "krebs", "angrisano" or "kalibr"

    Raises
    ------
    OptionError
        If there is no such form, or it cannot represent this sensor.
    """
    if form not in _FORMS:
        raise OptionError(f'"{form}" is no form of the sensor model. Choose one of: {", ".join(_FORMS)}.')
    frame, written = calibration.frame, _values_of(calibration)
    tables: list[ParameterRows] = []
    for name, imu in calibration.imus.items():
        if imu.accelerometer is not None:  # which defines the frames of the forms; other triads stay in theirs
            frame = _FORMS[form][0] or calibration.frame
        paths = [path for path, _ in calibration_parameters({name: imu})]
        entries, sigmas = entries_with_sigmas(imu, calibration.covariance(*paths), form)
        for triad, note in zip(_TRIADS, _EQUATIONS[form], strict=True):
            rows = tuple(
                Row(name=entry.name, value=written(entry.value, sigma), unit=entry.unit)
                for entry, sigma in zip(entries, sigmas, strict=True)
                if entry.triad == triad
            )
            if rows:
                tables.append(ParameterRows(title=f"{name} {triad}, body frame {frame}", note=note, rows=rows))
    warm = (_temperature_table(calibration, name) for name in calibration.imus)
    return (*tables, *filter(None, warm), *_rig_tables(calibration, frame))


def _temperature_table(calibration: Calibration, name: str) -> ParameterRows | None:
    """Return what the temperature changes of an IMU, in sensor axes."""
    found = calibration.imus[name].temperature
    if found is None:
        return None
    written, rows = _values_of(calibration), list[Row]()
    for part, coefficients in found.parts():
        path = f"{name}.temperature.{part}"
        values = zip(
            np.ndindex(coefficients.shape), coefficients.flat, calibration.sigma(path).flat,
            element_units(calibration, path), strict=True,
        )  # fmt: skip
        for (order, *axes), value, sigma, unit in values:
            if sigma > 0 or value:
                place = "".join("xyz"[axis] for axis in axes)
                rows.append(Row(name=f"{part}{order + 1}_{place}", value=written(value, sigma), unit=unit))
    note = (
        f"change of the bias, and that of the sensitivity relative to it: sum of the terms j times d^j, d = T - "
        f"{found.reference_degc:g} degC; known from "
        f"{found.low_degc:.1f} to {found.high_degc:.1f} degC; lag of the thermometer {found.lag_s:.3g} s"
    )
    return ParameterRows(title=f"{name} over the temperature", note=note, rows=tuple(rows))


def _rig_tables(calibration: Calibration, frame: str) -> Iterator[ParameterRows]:
    """Yield a table for each IMU with a pose, and for each camera; poses are those against the form's body frame."""
    placed = [name for name, imu in calibration.imus.items() if imu.T_imu_body is not None]
    written = _values_of(calibration)
    if (calibration.cameras or placed) and frame != calibration.frame:
        calibration = calibration.in_frame(frame)
    for name in placed:
        rows = tuple(
            Row(name=entry.name, value=written(entry.value, sigma), unit=entry.unit)
            for entry, sigma in imu_entries(calibration, name)
        )
        yield ParameterRows(title=f"{name}, pose and clock, body frame {frame}", note=IMU_EQUATION, rows=rows)
    for name, camera in calibration.cameras.items():
        rows = tuple(
            Row(name=entry.name, value=written(entry.value, sigma), unit=entry.unit)
            for entry, sigma in camera_entries(calibration, name)
        )
        yield ParameterRows(
            title=f"{name}, {camera.camera.model}, body frame {frame}", note=camera_equation(calibration), rows=rows
        )


def entries_with_sigmas(imu: ImuCalibration, covariance: Floats, form: str) -> tuple[list[FormEntry], Floats]:
    """Return the scalars of a form, and their standard deviations (k,).

    Parameters
    ----------
    covariance : (n, n), of the IMU's scalars in the order of `calibration.parameters`
    """
    start = np.concatenate([value.ravel() for _, value in calibration_parameters({"": imu})])
    entries = list(_entries(start, imu, form))

    def values(x: Floats) -> Floats:
        return np.array([entry.value for entry in _entries(x, imu, form)])

    jacobian = np.empty((len(entries), len(start)))
    for i, step in enumerate(_steps(imu)):
        ahead, behind = start.copy(), start.copy()
        ahead[i] += step
        behind[i] -= step
        jacobian[:, i] = (values(ahead) - values(behind)) / (ahead[i] - behind[i])
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    # What is left of a variance that should vanish is rounding; the size of the terms tells.
    terms = np.einsum("ij,j->i", np.abs(jacobian), np.sqrt(np.diag(covariance))) ** 2
    return entries, np.sqrt(np.where(variance > 1e-18 * terms, variance, 0.0))


def _steps(imu: ImuCalibration) -> Iterator[float]:
    """Yield a step for each scalar, small beside its matrix, over which the forms are as good as quadratic."""
    for _, value in calibration_parameters({"": imu}):
        size = float(np.abs(value).max())
        yield from [1e-5 * size if size else 1.0] * value.size


def _entries(x: Floats, imu: ImuCalibration, form: str) -> Iterator[FormEntry]:
    frame, accelerometer, gyroscope, magnetometer = _FORMS[form]
    shaped = _shaped(x, imu)
    turn = np.eye(3)
    if imu.accelerometer is not None and frame is not None:
        turn = frame_rotation(shaped["accelerometer.sensitivity"], frame)
    turned = {path: value @ turn.T if value.ndim == 2 else value for path, value in shaped.items()}
    if imu.accelerometer is not None:
        matrix = turned["accelerometer.sensitivity"]
        if frame is not None:  # exactly, not to rounding
            matrix = np.tril(matrix) if frame == "accel-x" else np.triu(matrix)
        yield from accelerometer(matrix, turned["accelerometer.bias"], imu.accelerometer.unit)
        if imu.accelerometer.lever_arms_m is not None:
            yield from entries.lever_arms(turned["accelerometer.lever_arms_m"])
        if imu.accelerometer.time_shift_s is not None:
            yield from entries.time_shift(float(turned["accelerometer.time_shift"]))
    if imu.gyroscope is not None:
        names = ("gyroscope.sensitivity", "gyroscope.bias", "gyroscope.g_sensitivity")
        yield from gyroscope(*(turned[name] for name in names), imu.gyroscope.unit)
    if imu.magnetometer is not None:
        names = ("magnetometer.sensitivity", "magnetometer.bias")
        yield from magnetometer(*(turned[name] for name in names), imu.magnetometer.unit, imu.magnetometer.field_unit)


def _shaped(x: Floats, imu: ImuCalibration) -> dict[str, Floats]:
    """Return the scalars (n,) of an IMU as its parameters, "gyroscope.bias" -> (3,)."""
    found: dict[str, Floats] = {}
    start = 0
    for path, value in calibration_parameters({"": imu}):
        found[path.removeprefix(".")] = x[start : start + value.size].reshape(value.shape)
        start += value.size
    return found


def _values_of(calibration: Calibration) -> Callable[[float, float], str]:
    """Return what writes values with their sigmas, which the truth of a simulation has not."""
    return _exact_text if _is_exact(calibration) else value_text


def _is_exact(calibration: Calibration) -> bool:
    return calibration.provenance.method == TRUTH_METHOD and not calibration.uncertainty.matrix.any()


def _exact_text(value: float, _sigma: float) -> str:
    return f"{value:.6g}"


def summary_table(calibration: Calibration) -> ParameterRows:
    """Return what concerns the calibration as a whole: verdict, frame, gravity, and what it rests on."""
    if _is_exact(calibration):
        return _truth_table(calibration)
    assessment, gravity = calibration.assessment, calibration.gravity
    camera_imu = assessment.camera_imu
    note = f"gnomon {calibration.provenance.gnomon_version}"
    rows = [
        Row(name="verdict", value=calibration.verdict, unit=""),
        Row(name="body frame", value=calibration.frame, unit=""),
        *_origins(calibration),
    ]
    if rests_on_gravity(calibration):
        value = value_text(gravity.value, gravity.sigma)
        rows.append(Row(name="gravity", value=value, unit="m/s^2"))
        note += f"; gravity: {gravity.source}"
    if assessment.model != "none":
        rows.append(Row(name=f"{modelled_thing(calibration)} model", value=assessment.model, unit=""))
    if assessment.cameras is not None:
        rows += _cameras_rows(assessment.cameras)
    elif calibration.imus:
        rows += _magnitude_rows(calibration) if camera_imu is None else _camera_imu_rows(camera_imu)
    return ParameterRows(title="calibration", note=note, rows=tuple(rows))


def _origins(calibration: Calibration) -> Iterator[Row]:
    """Yield which point of each IMU its poses are of, where its accelerometers sit at different ones."""
    for name, imu in calibration.imus.items():
        arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
        if calibration.cameras and arms is not None and imu.origin is not None:
            yield Row(name=f"origin of {name}", value=_POINTS.get(imu.origin.point, imu.origin.words), unit="")


def _truth_table(calibration: Calibration) -> ParameterRows:
    rows = [Row(name="body frame", value=calibration.frame, unit=""), *_origins(calibration)]
    if rests_on_gravity(calibration):
        rows.append(Row(name="gravity", value=_exact_text(calibration.gravity.value, 0.0), unit="m/s^2"))
    note = f"gnomon {calibration.provenance.gnomon_version}; exact: what the recording was simulated with"
    return ParameterRows(title="truth of a simulation", note=note, rows=tuple(rows))


def _magnitude_rows(calibration: Calibration) -> Iterator[Row]:
    assessment = calibration.assessment
    for _, compared, rms, unit in held_out_errors(calibration):
        yield Row(name=f"hold-out {compared}, rms", value=_known(rms), unit=unit)
    used, found = assessment.intervals_used, assessment.intervals_found
    yield Row(name=f"{counted_things(calibration)} used", value=f"{used} of {found}", unit="")
    if assessment.rotations_found:
        yield Row(name="rotations used", value=f"{assessment.rotations_used} of {assessment.rotations_found}", unit="")


def _camera_imu_rows(fit: CameraImuFit) -> Iterator[Row]:
    yield Row(name="trajectory", value=f"{fit.duration_s:.1f}", unit="s")
    if not fit.converged:
        yield Row(name="solution", value="not converged", unit="")
    for name, found in fit.frames_found.items():
        yield Row(name=f"{name}, frames used", value=f"{fit.frames_used[name]} of {found}", unit="")
        yield Row(name=f"{name}, corners used", value=str(fit.corners_used[name]), unit="")
        yield Row(name=f"{name}, reprojection, rms per axis", value=_known(fit.reprojection_rms_px[name]), unit="px")


def _cameras_rows(fit: CamerasFit) -> Iterator[Row]:
    if not fit.converged:
        yield Row(name="solution", value="not converged", unit="")
    for name, found in fit.views_found.items():
        yield Row(name=f"{name}, views used", value=f"{fit.views_used[name]} of {found}", unit="")
        yield Row(name=f"{name}, corners used", value=str(fit.corners_used[name]), unit="")
        yield Row(name=f"{name}, reprojection, rms per axis", value=_known(fit.reprojection_rms_px[name]), unit="px")
        yield Row(name=f"{name}, the same of hold-out views", value=_known(fit.holdout_rms_px[name]), unit="px")
        yield Row(name=f"{name}, image covered", value=share_words(fit.coverage[name]).removesuffix(" %"), unit="%")
    if fit.aspect_sigma:
        yield Row(name="board, y over x, less 1", value=value_text(fit.aspect, fit.aspect_sigma), unit="1")
    if fit.bow_sigma_m:
        yield Row(name="board, bow", value=value_text(1e3 * fit.bow_m, 1e3 * fit.bow_sigma_m), unit="mm")
    if isfinite(fit.print_scale):
        yield Row(name="board, true over stated", value=value_text(fit.print_scale, fit.print_scale_sigma), unit="1")


def _known(value: float) -> str:
    return f"{value:.3g}" if isfinite(value) else "not known"


HEAD = ("calibration", "path", "element", "value", "sigma", "unit")


def comparison_csv(comparison: "Comparison") -> str:
    """Return a row for each scalar of each calibration, in SI units, floating-point numbers with all their digits.

    Rotations are small rotations about the body's axes against their mean, whose matrix stands in rows of the
    calibration "mean"; a sigma that is not stated is left empty.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEAD)
    for block in comparison.blocks:
        if block.reference is not None:
            for i, row in enumerate(block.reference.tolist()):
                for j, value in enumerate(row):
                    writer.writerow(("mean", block.path, f"R_{'xyz'[i]}{'xyz'[j]}", repr(value), "", "1"))
        for name, values, sigmas in zip(block.names, block.values.tolist(), block.sigmas.tolist(), strict=True):
            for element, value, sigma in zip(block.elements, values, sigmas, strict=True):
                known = repr(sigma) if isfinite(sigma) else ""
                writer.writerow((name, block.path, element, repr(value), known, block.unit))
    return text.getvalue()


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
