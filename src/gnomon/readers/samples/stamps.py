"""Timestamps of samples: text or numbers in any unit -> nanoseconds, exactly where the numbers allow it."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...recording import Floats, Integers, usual_step
from ...units import TIME_UNITS_NS

_LARGEST_NS = 9.2e18
_HALF_A_DAY_NS = 12 * 3.6e12
_DECIMALS = {"s": 9, "ms": 6, "us": 3, "ns": 0, "100us": 5}
_FACTORS_NS = {**TIME_UNITS_NS, "100us": 100_000}
_EPOCH_S = (6e8, 4.1e9)  # 1989 to 2099
_POSSIBLE_HZ = (0.5, 1e5)
_TYPICAL_RATE_HZ = 130.0
_SLOWEST_MTI_S = 0.5
TYPICAL_FRAMES_HZ = 20.0


def stamp_kind(tokens: list[str]) -> str:
    """Return the NumPy dtype that holds timestamps like these without loss.

    Whole numbers are int64. Long decimal numbers (epoch seconds with a fraction) stay text, because float64 resolves
    only 238 ns there.
    """
    if all(re.fullmatch(r"[-+]?\d{1,18}|[-+]?[1-8]\d{18}", token.strip('"')) for token in tokens):
        return "i8"
    longest = max((len(re.sub(r"\D", "", token)) for token in tokens), default=0)
    plain = all(re.fullmatch(r'[-+"\d.,]*', token) for token in tokens)
    return "S40" if plain and longest > 15 else "f8"


def guess_time_unit(stamps: NDArray[Any], typical_hz: float = _TYPICAL_RATE_HZ) -> tuple[str, str]:
    """Return the unit of timestamps and why it must be that one.

    Timestamps that lie between 1989 and 2099 in some unit since 1970, at a possible sample rate, are in that unit.
    Otherwise the unit is the one that gives a usual rate: units are a factor of 1000 apart, so that one always does.
    """
    if len(stamps) < 2:
        return "s", "nothing tells otherwise"
    last = float(stamps[-1])
    steps = np.diff(stamps.astype(np.float64))
    middle, whole = float(np.median(steps)), (last - float(stamps[0])) / (len(stamps) - 1)
    if not max(middle, whole) > 0:
        return "s", "nothing tells otherwise"
    with np.errstate(over="ignore"):
        usual = {unit: usual_step(steps, factor) if middle > 0 else whole for unit, factor in TIME_UNITS_NS.items()}
        rates = {unit: 1e9 / np.float64(step * TIME_UNITS_NS[unit]) for unit, step in usual.items()}
    if not all(0 < rate < np.inf for rate in rates.values()):  # of no clock
        return "s", "nothing tells otherwise"
    for unit, factor in TIME_UNITS_NS.items():
        if _EPOCH_S[0] < last * factor * 1e-9 < _EPOCH_S[1] and _POSSIBLE_HZ[0] < rates[unit] < _POSSIBLE_HZ[1]:
            return unit, f"they count from 1970 and the rate is then {rates[unit]:.4g} Hz"
    unit = min(rates, key=lambda name: abs(np.log(rates[name] / typical_hz)))
    return unit, f"the rate is then {rates[unit]:.4g} Hz"


def named_unit(unit: str | None, stamps: NDArray[Any]) -> str | None:
    """Return the unit of stamps that a header names: Xsens' SampleTimeFine counts 100 us in an MTi, us in a DOT."""
    if unit != "100us" or len(stamps) < 2:
        return unit
    step = float(np.median(np.diff(stamps.astype(np.float64))))
    return "us" if step > _SLOWEST_MTI_S / 1e-4 else unit


def stray_timestamp(t_ns: Integers) -> int | None:
    """Return the index of the first timestamp (n,) [ns] more than half a day from the middle one; None if none is.

    No recording is so long; a timestamp that was written wrong would make it last for years.
    """
    far = np.abs(t_ns - np.median(t_ns)) > _HALF_A_DAY_NS if len(t_ns) else np.empty(0, bool)
    return int(np.argmax(far)) if far.any() else None


_WRAP = 1 << 32
_WRAPS = (_WRAP, 1 << 30)
"""Where counters begin again: micros() and millis(); MicroPython's ticks_us() and ticks_ms()."""


def _is_32_bits(stamps: NDArray[Any]) -> bool:
    return int(stamps.min()) >= -_WRAP // 2 and int(stamps.max()) < _WRAP


class Unwrapper:
    """Continues counters of 32 or 30 bits, such as micros() and ticks_us(), where they begin again at zero.

    A block of stamps is continued from the one before it. Only where the counter goes on within 1/64 of its range, 67 s
    of microseconds, has it begun again; any other step back is left as it is, and so are stamps that it cannot hold.
    """

    def __init__(self) -> None:
        self.wraps = 0
        self._ahead = 0
        self._last: int | None = None

    def __call__(self, stamps: NDArray[Any]) -> NDArray[Any]:
        """Return the next stamps (n,), integers, continued."""
        if stamps.dtype.kind != "i" or not len(stamps) or not _is_32_bits(stamps):
            return stamps
        steps = np.diff(stamps, prepend=stamps[0] if self._last is None else self._last)
        self._last = int(stamps[-1])
        ahead = np.full(len(stamps), self._ahead)
        for wrap in _WRAPS:
            back = (steps + wrap >= 0) & (steps + wrap < wrap // 64)
            late = (wrap - steps >= 0) & (wrap - steps < wrap // 64)  # a line from before that comes behind
            turns = back.astype(np.int64) - late
            self.wraps += int(turns.sum())
            ahead += wrap * np.cumsum(turns)
        self._ahead = int(ahead[-1])
        return stamps + ahead if ahead.any() else stamps


def to_ns(stamps: NDArray[Any], unit: str, where: str) -> Integers:
    """Return timestamps in nanoseconds, (n,) int64.

    Parameters
    ----------
    stamps : (n,) int64, float64 or text (dtype S)
    unit : "s", "ms", "us", "ns", or "100us"
    where : file, for messages

    Raises
    ------
    RecordingError
        If a timestamp is no number, or does not fit into 64 bits of nanoseconds.
    """
    if stamps.dtype.kind == "S":
        exact = _text_to_ns(stamps, _DECIMALS[unit])
        if exact is not None:
            return exact
    factor = _FACTORS_NS[unit]
    numbers = _numbers(stamps, where)
    if not np.isfinite(numbers).all():
        raise RecordingError(f"{where}: timestamp {int(np.argmin(np.isfinite(numbers))) + 1} is not a finite number.")
    if len(numbers) and float(np.abs(numbers).max()) * factor > _LARGEST_NS:
        raise RecordingError(
            f"{where}: timestamps of {float(np.abs(numbers).max()):g} {unit} are more than 292 years. "
            'State their unit, for example --units "ns".'
        )
    if stamps.dtype.kind in "iu":
        return stamps.astype(np.int64) * factor
    return np.rint(numbers * factor).astype(np.int64)


def _numbers(stamps: NDArray[Any], where: str) -> Floats:
    try:
        return stamps.astype(np.float64)
    except ValueError:
        for row, stamp in enumerate(stamps):
            try:
                float(stamp)
            except ValueError:
                found = bytes(stamp).decode("latin-1")[:40]
                raise RecordingError(
                    f'{where}: timestamp {row + 1} is "{found}", which is no number. Fix or remove its line.'
                ) from None
        raise


def _text_to_ns(stamps: NDArray[Any], decimals: int) -> Integers | None:
    """Return decimal numbers in text times 10^decimals as integers; None if one is not a plain decimal number."""
    characters = np.ascontiguousarray(stamps).view(np.uint8).reshape(len(stamps), -1)
    mantissa = np.zeros(len(stamps), np.int64)
    fraction = np.zeros(len(stamps), np.int64)  # digits behind the point
    behind = np.zeros(len(stamps), bool)
    negative = np.zeros(len(stamps), bool)
    for character in characters.T:
        digit = (character >= ord("0")) & (character <= ord("9"))
        point = character == ord(".")
        if not (digit | point | np.isin(character, np.frombuffer(b'\0 +-"', np.uint8))).all():
            return None
        take = digit & (fraction < decimals) | digit & ~behind
        mantissa = np.where(take, 10 * mantissa + (character - ord("0")), mantissa)
        fraction += take & behind
        behind |= point
        negative |= character == ord("-")
    mantissa *= 10 ** (decimals - fraction)
    return np.where(negative, -mantissa, mantissa)
