"""Units in which magnitudes of specific force, angular rate and magnetic field are shown to a person."""

from math import isfinite

from .numbers import MISSING, number, prefixed, quantity

_BASE = {"m/s^2": ("m/s²", 1.0), "rad/s": ("rad/s", 1.0), "uT": ("T", 1e-6)}
"""Unit of a record -> unit that takes an SI prefix, and what one of the former is in the latter."""


def scaled(largest: float, si_unit: str) -> tuple[str, float]:
    """Return the unit with a prefix that suits values as large as this, and the factor to it from the record's unit.

    Examples
    --------
    >>> scaled(0.002, "m/s^2"), scaled(48.0, "uT"), scaled(0.01, "")
    (('mm/s²', 1000.0), ('µT', 1.0), ('% of the field', 100.0))
    """
    if si_unit not in _BASE:
        return "% of the field", 100.0
    unit, base = _BASE[si_unit]
    prefix, factor = prefixed(largest * base)
    return f"{prefix}{unit}", float(f"{factor * base:.12g}")


def shown(value: float, si_unit: str, digits: int = 3) -> str:
    """Return a value of a record as text with its unit, such as "2.65 mrad/s" or "1.23 %"."""
    if not isfinite(value):
        return MISSING
    if si_unit not in _BASE:
        return f"{number(100 * value, digits, trim=False)}\u00a0%"
    unit, base = _BASE[si_unit]
    return quantity(value * base, unit, digits)
