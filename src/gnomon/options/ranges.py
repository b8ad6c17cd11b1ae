"""Ranges of options that are numbers: what is no number, or outside, is refused."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import Any

from ..errors import OptionError

_HUGE = 1e9
_DAY_S = 86400.0
_RANGES: dict[str, tuple[float, float]] = {
    "altitude": (-12_000, 100_000),
    "baseline": (1e-4, 1e4),
    "between": (0, 10_000),
    "bits": (2, 32),
    "cols": (1, 1000),
    "covers": (0, 1000),
    "dip_deg": (-90, 90),
    "disturbances": (0, 10_000),
    "earth_rate_latitude": (-90, 90),
    "field": (1e-3, 1e6),
    "first": (0, 100_000),
    "focus_m": (1e-3, 1e4),
    "gravity": (9.0, 10.5),
    "height": (1, 16_384),
    "imus": (1, 100),
    "intervals": (1, 10_000),
    "jobs": (1, 1024),
    "knots_per_s": (0.01, 10_000),
    "latitude": (-90, 90),
    "line_delay": (-1.0, 1.0),
    "max_iterations": (1, 10_000),
    "multiplier": (1e-3, 1e6),
    "pixel_sigma": (1e-6, 1000),
    "poses": (1, 10_000),
    "rate": (1e-3, 1e6),
    "rate_rad_s": (-1000, 1000),
    "rate_sigma": (0, 1),
    "resolution": (1, 65_536),
    "rests": (0, 10_000),
    "rows": (1, 1000),
    "rpm": (-10_000, 10_000),
    "runs": (1, 1_000_000),
    "sample_rate": (1e-3, 1e6),
    "samples": (1, 10_000_000),
    "start_s": (-1e10, 1e10),
    "stop_s": (-1e10, 1e10),
    "symmetry": (1, 1000),
    "target_cols": (1, 1000),
    "target_rows": (1, 1000),
    "touched": (0, 10_000),
    "views": (1, 100_000),
    "width": (1, 16_384),
    "window_s": (1e-3, _DAY_S),
    "workers": (1, 1024),
}
"""Name of an option -> its least and its largest value."""
_ENDINGS: dict[str, tuple[float, float]] = {
    "seed": (0, 2.0**64),
    "_hz": (1e-3, 1e6),
    "_deg": (-360, 360),
    "_m": (-1e4, 1e4),
    "_px": (-1e5, 1e5),
    "duration_s": (1e-3, 40 * _DAY_S),
    **dict.fromkeys(("hold_s", "init_s", "motion_s", "rest_s", "wait_s", "steady_s", "handling_s"), (0, _DAY_S)),
    **dict.fromkeys(("spin_up_s", "spin_down_s", "exposure_s"), (0, _DAY_S)),
    "clock_offset_s": (-1e10, 1e10),
    "_s": (-1e7, 1e7),
    "": (-_HUGE, _HUGE),
}
"""Ending of a name -> the same, for all others; the first that fits."""


def option_range(name: str) -> tuple[float, float]:
    """Return the least and the largest value of an option.

    Examples
    --------
    >>> option_range("latitude"), option_range("gyroscope_rate_hz")
    ((-90, 90), (0.001, 1000000.0))
    """
    if name in _RANGES:
        return _RANGES[name]
    return next(limits for ending, limits in _ENDINGS.items() if name.endswith(ending))


def check_ranges(options: Any, *, positive: str = "", not_negative: str = "", fractions: str = "") -> None:
    """Check all numbers in a dataclass of options, and in those in it.

    Parameters
    ----------
    positive, not_negative, fractions : names of options, with spaces between, that must be greater than zero; not below
        zero; from zero to below one

    Raises
    ------
    OptionError
        If one is not finite, or outside of its range.
    """
    for name, value in _numbers(options):
        least, most = option_range(name)
        if not isfinite(value):
            raise OptionError(f"{name} {value:g} is not a finite number. Give one from {least:g} to {most:g}.")
        if not least <= value <= most:
            raise OptionError(f"{name} {value:g} is out of range. Give a number from {least:g} to {most:g}.")
    for names, fits, wanted in (
        (positive, lambda value: value > 0, " must be greater than zero."),
        (not_negative, lambda value: value >= 0, " must not be below zero."),
        (fractions, lambda value: 0 <= value < 1, ": give a fraction from 0 to below 1."),
    ):
        for name in names.split():
            value = getattr(options, name)
            if value is not None and not fits(value):
                raise OptionError(f"{name} {value:g}{wanted}")


def _numbers(options: Any) -> Iterator[tuple[str, float]]:
    """Yield the name and the value of every number, those in tuples too."""
    for entry in fields(options):
        todo: list[Any] = [getattr(options, entry.name)]
        while todo:
            value = todo.pop()
            if isinstance(value, tuple):
                todo.extend(value)  # pyright: ignore[reportUnknownArgumentType]
            elif isinstance(value, int | float) and not isinstance(value, bool):
                yield entry.name, value
            elif is_dataclass(value) and not isinstance(value, type):
                yield from _numbers(value)


def check_gravity(gravity_m_s2: float | None) -> None:
    """Raise an OptionError where a stated gravity [m/s^2] is found nowhere on Earth."""
    if gravity_m_s2 is not None and not 9.0 < gravity_m_s2 < 10.5:
        raise OptionError(
            f"gravity {gravity_m_s2:g} m/s^2 is found nowhere on Earth (9.76 to 9.84). "
            "Give the local value in m/s^2, or --latitude and --altitude."
        )


def check_stretch(start_s: float, stop_s: float | None) -> None:
    """Raise an OptionError where a part of a recording ends before it begins, or begins before the recording does."""
    if not 0 <= start_s < float("inf"):
        raise OptionError(f"start_s {start_s:g} must be zero or more.")
    if stop_s is not None and not stop_s > start_s:
        raise OptionError(f"stop_s {stop_s:g} must be later than start_s {start_s:g}.")


def check_positive(options: object, names: tuple[str, ...]) -> None:
    """Raise an OptionError where one of these fields has a value that is not greater than zero."""
    for name in names:
        value = getattr(options, name)
        if value is not None and not value > 0:
            raise OptionError(f"{name} {value:g} must be greater than zero.")
