"""Calibrations of one rig, from wherever they come -> Comparison."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

from ..assess.comparison.candidates import ComparisonCandidate
from ..assess.comparison.comparing import compare_candidates
from ..assess.comparison.comparison import Comparison
from ..errors import OptionError
from ..formats.foreign import ForeignCalibration
from ..formats.foreign_files import load_any, source_names
from ..results.calibration import Calibration
from ..results.moved import imus_at_temperature
from ..results.result import Result

CalibrationSource = Calibration | ForeignCalibration | Result | str | PathLike[str] | Sequence[str | PathLike[str]]
"""A calibration, a result, a file or folder, or the files of one calibration."""


def compare(
    *calibrations: CalibrationSource,
    names: Sequence[str] | None = None,
    rename: Mapping[str, Mapping[str, str]] | None = None,
    temperature_c: float | None = None,
) -> Comparison:
    """Compare calibrations of one rig, made by any program.

    Frames, signs and forms are reconciled: all are stated in body frame "accel-x", in SI units and in the form of
    Krebs (scale, misalignment, rotation from body to gyroscope, g-sensitivity), with their covariances. Sensors
    are matched by name.

    Parameters
    ----------
    calibrations : at least two: calibrations, results, files or folders; several files of one calibration (such as
        Kalibr's camchain-imucam.yaml and imu.yaml) as a sequence
    names : what each is called; by default taken from the paths, else A, B, C, ...
    rename : calibration's name -> sensors that are called otherwise there, such as {"kalibr": {"cam1": "cam0"}}
    temperature_c : of the chip [degC], at which those are compared that know how they change; by default at the
        reference of each

    Raises
    ------
    OptionError
        If there are fewer than two, they have nothing in common, a name is wrong, or one does not know the temperature.
    FormatError
        If a file cannot be read, or two calibrations are for measurements in different units.

    Examples
    --------
    >>> found = gnomon.compare("monday-imu", "tuesday-imu", "kalibr")  # doctest: +SKIP
    >>> found.headline, found.outside, found.z_rms  # doctest: +SKIP
    """
    called = _names(calibrations, names)
    renamed = dict(rename or {})
    unknown = [name for name in renamed if name not in called]
    if unknown:
        raise OptionError(f'"{unknown[0]}" is none of the calibrations. They are called: {", ".join(called)}.')
    candidates = [
        ComparisonCandidate.of(name, _loaded(source, temperature_c))
        for name, source in zip(called, calibrations, strict=True)
    ]
    return compare_candidates([one.renamed(renamed[one.name]) if one.name in renamed else one for one in candidates])


def _loaded(source: CalibrationSource, temperature_c: float | None) -> Calibration | ForeignCalibration:
    known = _read(source)
    if temperature_c is None:
        return known
    if isinstance(known, ForeignCalibration):
        return replace(known, imus=imus_at_temperature(known.imus, known.cameras, temperature_c).imus)
    return known.at_temperature(temperature_c)


def _read(source: CalibrationSource) -> Calibration | ForeignCalibration:
    match source:
        case Calibration() | ForeignCalibration():
            return source
        case Result():
            return source.calibration
        case str() | PathLike():
            return load_any(source)
        case _:
            return load_any(*source)


def _names(sources: Sequence[CalibrationSource], names: Sequence[str] | None) -> list[str]:
    """Return what each calibration is called."""
    if names is not None:
        if len(names) != len(sources):
            raise OptionError(f"found {len(names)} names for {len(sources)} calibrations. Give one for each.")
        return list(names)
    paths: dict[int, list[str | Path]] = {}
    for i, source in enumerate(sources):
        if isinstance(source, str | PathLike):
            paths[i] = [Path(source)]
        elif not isinstance(source, Calibration | ForeignCalibration | Result):
            paths[i] = [Path(path) for path in source]
    by_path = dict(zip(paths, source_names(list(paths.values())), strict=True))
    return [by_path.get(i, _letters(i)) for i in range(len(sources))]


def _letters(i: int) -> str:
    """Return A, B, ..., Z, A2, ... ."""
    return f"{chr(ord('A') + i % 26)}{i // 26 + 1 if i >= 26 else ''}"
