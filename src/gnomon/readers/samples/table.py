"""Format "table": text with one row a sample. EuRoC, TUM-VI, Kalibr and imu_tk files are such tables, too."""

import re
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...findings import list_first
from ...frozen import value_class
from ...options import option_range
from ...recording import Floats, Integers, TemperatureSamples, usual_step
from ...recording.samples import median_of
from ...units import TIME_UNITS_NS, Units
from ..files import TextFile
from .column_names import Roles, column_name, column_roles, time_columns, unit_of
from .printed_lines import lines_as_table
from .recognise import HELP, columns_help, time_help
from .text_table import Column, TextLayout, is_printed, parse_columns, sniff_layout

# ---- timestamps, text or numbers in any unit: nanoseconds, exactly where the numbers allow it ----

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
    middle, whole = float(median_of(steps)), (last - float(stamps[0])) / (len(stamps) - 1)
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
    step = float(median_of(np.diff(stamps.astype(np.float64))))
    return "us" if step > _SLOWEST_MTI_S / 1e-4 else unit


def stray_timestamp(t_ns: Integers) -> int | None:
    """Return the index of the first timestamp (n,) [ns] more than half a day from the middle one; None if none is.

    No recording is so long; a timestamp that was written wrong would make it last for years.
    """
    far = np.abs(t_ns - median_of(t_ns)) > _HALF_A_DAY_NS if len(t_ns) else np.empty(0, bool)
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


# ---- tables ----


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_RATE_KEYS = _words("fs rate samplerate samplingrate samplefrequency samplingfrequency frequency freq odr")
_PERIOD_KEYS = _words("dt period sampletime sampleperiod samplinginterval sampleinterval samplingperiod")
_PREAMBLE = re.compile(
    r"\W*(?P<key>[A-Za-z][\w .-]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*[,;:=\t ]\s*(?P<value>[\d.]+(?:[eE][-+]?\d+)?)"
    r"\W*(?P<tail>[A-Za-z]*)\W*"
)

_MOST_LISTED = 6
"""Names of columns that are not used that a sentence gives."""

_LONGEST_LINE = 200
"""Characters of a line of the preamble that states a rate."""

RATE_HELP = "State it with --rate, for example --rate 100: count the samples of a minute."


@value_class(eq=True)
class Triad:
    """Samples of one sensor; quantity "unnamed" where only the values can tell which one it is.

    Attributes
    ----------
    quantity : "accelerometer", "gyroscope", "magnetometer" or "unnamed"
    values : (n, 3)
    unit : where the header tells it
    """

    quantity: str
    values: Floats
    unit: str | None


@value_class(eq=True)
class SampleTable:
    """What is in a table.

    Attributes
    ----------
    t_ns : timestamps (n,) [ns]
    triads : see `Roles.triads`
    notes : what was assumed
    advice : what to do where a triad is missing
    temperature : of the thermometer, where a column is named so
    """

    t_ns: Integers
    triads: tuple[Triad, ...]
    notes: tuple[str, ...]
    advice: str = HELP
    temperature: TemperatureSamples | None = None


def read_table(file: TextFile, columns: str | None, rate_hz: float | None, units: Units) -> SampleTable:
    """Read a text table.

    Raises
    ------
    RecordingError
        If it is no table, or nothing tells what its columns are.
    OptionError
        If `columns` does not fit the table.
    """
    file = lines_as_table(file) if is_printed(file.data) else file
    layout = sniff_layout(file)
    used = column_roles(layout, columns, file.name)
    try:
        data, cut = _parse(file, layout, used)
    except RecordingError:
        if used.temperature is None:
            raise
        note = f"{file.name}: the temperature is not a number in every row, and is left out."
        used = replace(used, temperature=None, notes=(*used.notes, note))
        data, cut = _parse(file, layout, used)
    count = len(data[0])
    if count < 2:
        raise RecordingError(f"{file.name}: found {count} row of data; a recording has many. Was it copied completely?")
    if used.time:
        t_ns, note = _stamps(file, used, data, units.time)
        if rate_hz is not None:
            note += f" The rate of {rate_hz:g} Hz was not needed: the file has timestamps."
    else:
        t_ns, note = _made_stamps(file, layout, used, count, rate_hz)
    triads: list[Triad] = []
    for triad in used.triads:
        values = np.empty((count, 3))
        for axis, i in enumerate(triad.columns):
            values[:, axis] = data[i]
        values.flags.writeable = False  # so that it is kept without a copy
        triads.append(Triad(quantity=triad.quantity, values=values, unit=triad.unit))
    left = None if columns is not None or file.header else _left_columns(file.name, layout, used)
    notes = (*file.notes, *used.notes, *(text for text in (note, left, cut) if text))
    temperature = None
    if used.temperature is not None:
        column, unit = used.temperature
        temperature, said = temperature_samples(t_ns, data[column], unit)
        notes = (*notes, said)
    only = [triad.quantity for triad in triads] == ["gyroscope"]
    advice = columns_help(layout, [column_name(name).quantity for name in layout.header]) if only else HELP
    return SampleTable(t_ns=t_ns, triads=tuple(triads), notes=notes, advice=advice, temperature=temperature)


def parse_stamped(
    file: TextFile,
    layout: TextLayout,
    stamps: Collection[int],
    values: Collection[int],
    whole: Collection[int] = (),
    *,
    may_be_lost: bool = False,
) -> tuple[list[Column], str | None]:
    """Return the columns of a table, of which the timestamps lose no digit, and a note on a line that was cut off.

    Parameters
    ----------
    stamps, values, whole : numbers of the columns of timestamps, of samples, and of whole numbers
    may_be_lost : as for `parse_columns`
    """
    kinds = ["i8" if i in whole else "f8" if i in values else "" for i in range(layout.columns)]
    for i in stamps:
        kinds[i] = stamp_kind([row[i] for row in layout.sample])
    try:
        return parse_columns(file, layout, kinds, may_be_lost=may_be_lost)
    except RecordingError:
        if "i8" not in kinds:
            raise
        # What begins as whole numbers need not stay so.
        wider = [("S40" if i in stamps else "f8") if kind == "i8" else kind for i, kind in enumerate(kinds)]
        return parse_columns(file, layout, wider, may_be_lost=may_be_lost)


def _parse(file: TextFile, layout: TextLayout, used: Roles) -> tuple[list[Column], str | None]:
    values = {i for triad in used.triads for i in triad.columns} | (
        {used.temperature[0]} if used.temperature else set()
    )
    return parse_stamped(file, layout, [i for i, _ in used.time], values)


def _left_columns(name: str, layout: TextLayout, used: Roles) -> str | None:
    """Return which named columns are not used, or None."""
    taken = {i for i, _ in used.time} | {i for triad in used.triads for i in triad.columns}
    taken |= set() if used.temperature is None else {used.temperature[0]}
    left = [text for i, text in enumerate(layout.header) if i not in taken and text]
    return f"{name}: columns that are not used: {list_first(left, _MOST_LISTED)}." if left else None


_KELVIN, _CHIP = (220.0, 400.0), (-60.0, 130.0)
"""What the median of a thermometer is where it counts in K, and where in degC."""


def temperature_samples(t_ns: Integers, values: Floats, unit: str | None) -> tuple[TemperatureSamples, str]:
    """Return a thermometer's readings, their unit recognised where it is not told, and what was assumed."""
    if unit is not None:
        return TemperatureSamples(t_ns=t_ns, values=values, unit=unit), f"temperature in {unit} (as the file says)."
    middle = float(median_of(values))
    kelvin, chip = (low <= middle <= high for low, high in (_KELVIN, _CHIP))
    found = "K" if kelvin else "degC" if chip else "count"
    note = f"temperature in {found} (its median is {middle:.4g}; the file does not say)."
    return TemperatureSamples(t_ns=t_ns, values=values, unit=found), note


def read_temperature_table(file: TextFile) -> TemperatureSamples | None:
    """Read a table of a thermometer alone; None where it is none.

    Raises
    ------
    RecordingError
        If it is damaged.
    """
    layout = sniff_layout(file)
    names = [column_name(text) for text in layout.header]
    warm = next(((i, name.unit) for i, name in enumerate(names) if name.quantity == "temperature"), None)
    if warm is None or not {name.quantity for name in names} <= {"time", "temperature", "other"}:
        return None
    used = Roles(time=time_columns(names, layout), triads=(), temperature=warm)
    data, _ = _parse(file, layout, used)
    return temperature_samples(_stamps(file, used, data, None)[0], data[warm[0]], warm[1])[0]


def _column_words(layout: TextLayout, used: Roles) -> list[str]:
    """Return a word of --columns for each column that is used, "_" for the others."""
    words = ["_"] * layout.columns
    letters = {"accelerometer": "a", "gyroscope": "g", "magnetometer": "m"}
    for triad, otherwise in zip(used.triads, "agm", strict=False):
        for i, axis in zip(triad.columns, "xyz", strict=True):
            words[i] = letters.get(triad.quantity, otherwise) + axis
    return words


def _made_stamps(
    file: TextFile, layout: TextLayout, used: Roles, count: int, rate_hz: float | None
) -> tuple[Integers, str]:
    """Return timestamps at a stated rate [ns], and what was assumed."""
    origin = "as stated"
    if rate_hz is None:
        rate_hz, origin = preamble_rate(layout.preamble), "as its preamble says"
    if rate_hz is None:
        advice = time_help(layout, _column_words(layout, used))
        raise RecordingError(
            f"{file.name}: no column holds the time, and nothing tells the sample rate. {RATE_HELP}{advice}"
        )
    return uniform_stamps(count, rate_hz), f"{file.name}: no timestamps; {rate_hz:g} Hz {origin}."


def _stamps(file: TextFile, used: Roles, data: list[Column], stated: str | None) -> tuple[Integers, str]:
    """Return the timestamps in the table [ns], and what was assumed."""
    if len(used.time) == 2:
        both = [to_ns(data[i], unit or "ns", file.name) for i, unit in used.time]
        return both[0] + both[1], f"{file.name}: timestamps are seconds and nanoseconds, from the header."
    ((column, named),) = used.time
    unwrapper = Unwrapper()
    stamps = unwrapper(data[column])
    named = named_unit(named, stamps)
    if stated is not None:
        unit, reason = stated, "as stated"
    elif named is not None:
        unit, reason = named, "from the header"
    else:
        try:
            unit, reason = guess_time_unit(stamps)
        except ValueError:
            raise RecordingError(f"{file.name}: the timestamps are not numbers. {HELP}") from None
    if unwrapper.wraps:
        reason += f"; a counter that wraps, continued where it began again ({unwrapper.wraps} times)"
    return to_ns(stamps, unit, file.name), f"{file.name}: time in {unit} ({reason})."


def uniform_stamps(count: int, rate_hz: float, first: int = 0) -> Integers:
    """Return timestamps k / rate_hz, k = first .. first + count - 1, (count,) int64 [ns].

    Raises
    ------
    RecordingError
        If no sensor has such a rate, or the timestamps do not fit into 64 bits.
    """
    least, most = option_range("rate")
    if not least <= rate_hz <= most or (first + count) * (1e9 / rate_hz) > np.iinfo(np.int64).max:
        raise RecordingError(
            f"the rate {rate_hz:g} Hz of {count} samples is that of no sensor. State one from {least:g} to {most:g} Hz "
            "with --rate, or correct it in the file."
        )
    return np.rint(np.arange(first, first + count) * (1e9 / rate_hz)).astype(np.int64)


def preamble_rate(lines: tuple[str, ...]) -> float | None:
    """Return the sample rate [Hz] that lines such as "Fs,50.00" or "# dt: 5 ms" state, or None."""
    for line in lines:
        match = _PREAMBLE.fullmatch(line) if len(line) < _LONGEST_LINE else None
        if match is None:
            continue
        key = re.sub(r"[^a-z]", "", match["key"].lower())
        unit = match["unit"] or match["tail"] or ""
        if key.endswith("hz"):
            key = key.removesuffix("hz")
        value = float(match["value"])
        if (key in _RATE_KEYS or key.endswith("samplerate")) and value > 0:
            return value * (1000.0 if unit.lower() == "khz" else 1.0)
        if key in _PERIOD_KEYS and value > 0:
            return {"ns": 1e9, "us": 1e6, "ms": 1e3}.get(unit_of(unit, "time") or "s", 1.0) / value
    return None
