"""What is said of columns that nothing names: their ranges, and what their values may be.

What samples are, told from their values: which triad is which, and in which unit.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...units import ACCELEROMETER_UNITS_M_S2, MAGNETOMETER_UNITS_UT, STANDARD_GRAVITY_M_S2
from .text_table import TextLayout, column_rises, is_number

HELP = 'Say what the columns are with --columns, for example --columns "t ax ay az gx gy gz" (_ skips a column).'
TRIAL = ' By their values, try --columns "{}"{}.'
"""What `columns_help` says where the values tell it."""

_NO_COMMAS = "Export with semicolons or tabs between columns, or with decimal points."
_MOST_LISTED = 24
_FEWEST_COUNTED = 4


def columns_help(layout: TextLayout, quantities: Sequence[str] = ()) -> str:
    """Return which columns there are, their ranges in the first rows, and how --columns could name them.

    Parameters
    ----------
    layout : of the table
    quantities : what the header says of each column, as far as it does
    """
    values = _sample_values(layout)
    listed: list[str] = []
    for i, column in enumerate(values.T[:_MOST_LISTED]):
        name = f"{i + 1} ({layout.header[i][:40]})" if layout.header else f"{i + 1}"
        good = column[np.isfinite(column)]
        span = f"{good.min():.6g} to {good.max():.6g}" if len(good) else "no numbers"
        listed.append(f"{name}: {span}{', rises' if column_rises(layout, i) else ''}")
    more = "; ..." if layout.columns > _MOST_LISTED else ""
    words = _likely_columns(layout, values, quantities or ["other"] * layout.columns)
    trial = "" if words is None else TRIAL.format(" ".join(words), "" if "t" in words else " with --rate HZ")
    names = len(layout.preamble[-1].split(",")) if layout.preamble and layout.delimiter == "," else 0
    if names > 1 and layout.columns in {2 * names - 1, 2 * names}:
        trial = f" Above them stand {names} names: are commas decimal points, too? {_NO_COMMAS}"
    return f"Columns in the first rows: {'; '.join(listed)}{more}.{trial} {HELP}"


def column_counts(layout: TextLayout, column: int) -> bool:
    """Tell whether a column goes up by one from row to row, as a sample number does, and milliseconds at 1 kHz."""
    values = _sample_values(layout)[:, column]
    return len(values) >= _FEWEST_COUNTED and values[0] < values[-1] and bool((values[1:] == values[:-1] + 1).all())


def time_help(layout: TextLayout, words: Sequence[str]) -> str:
    """Return what to do about a column that may hold the time though nothing calls it so; empty without one.

    Parameters
    ----------
    layout : of the table
    words : of --columns for what is known, "_" for the others
    """
    rising = [i for i in range(layout.columns) if words[i] == "_" and column_rises(layout, i)]
    for i in sorted(rising, key=lambda i: column_counts(layout, i)):
        name = f"Column {i + 1} ({layout.header[i][:40]})" if layout.header else f"Column {i + 1}"
        if column_counts(layout, i):
            return f" {name} goes up by one from row to row: it numbers the rows, or holds milliseconds at 1000 Hz."
        line = " ".join([*words[:i], "t", *words[i + 1 :]])
        return f' {name} rises: if it holds the time, state --columns "{line}".'
    return ""


def _sample_values(layout: TextLayout) -> Floats:
    def number(token: str) -> float:
        plain = token.strip().strip('"')
        return float(plain.replace(",", ".", 1)) if is_number(plain, layout.decimal_comma) else np.nan

    return np.array([[number(token) for token in row] for row in layout.sample], dtype=np.float64)


def _likely_columns(layout: TextLayout, values: Floats, known: Sequence[str]) -> list[str] | None:
    """Return a word for each column: a time that rises, three that read gravity, three beside them; None without."""
    words = ["_"] * layout.columns
    rising = [i for i in range(layout.columns) if column_rises(layout, i) and len(np.unique(values[:, i])) > 2]
    time = next((i for i in rising if not column_counts(layout, i)), None)  # what counts the rows tells no time
    if time is not None:
        words[time] = "t"
    free = [np.isfinite(column).all() and np.ptp(column) > 0 and i not in rising for i, column in enumerate(values.T)]
    places = [i for i in range(layout.columns - 2) if all(free[i : i + 3])]
    begin = [max((j + 1 for j in range(i) if not free[j]), default=0) for i in places]  # of the columns without a gap
    places = [i for _, i in sorted(((i - j) % 3 > 0, i) for i, j in zip(places, begin, strict=True))]
    first = next(
        (i for i in places if _reads_gravity(values[:, i : i + 3]) and "gyroscope" not in known[i : i + 3]), None
    )
    if first is None:
        return None
    words[first : first + 3] = "ax", "ay", "az"
    named = [i for i in places if all(name == "gyroscope" for name in known[i : i + 3])]
    beside = [i for i in (first + 3, first + 4, first - 3, first - 4) if i in places]  # a thermometer may lie between
    beside.sort(key=lambda i: float(np.abs(np.median(values[:, i : i + 3], axis=0)).max()))  # rates at rest are small
    second = next((i for i in (*named, *beside, *places) if i in places and abs(i - first) >= 3), None)
    if second is not None:
        words[second : second + 3] = "gx", "gy", "gz"
    return words


def _reads_gravity(values: Floats) -> bool:
    norms = np.linalg.norm(values, axis=1)
    middle = float(np.median(norms))
    return gravity_unit(middle) is not None or is_gravity_in_counts(middle)


_WINDOWS = 1000
_WINDOW = 50  # samples; half a second at usual rates
_LIKE_GRAVITY = (0.8, 1.2)  # an uncalibrated accelerometer reads gravity within 20 %
_LIKE_GRAVITY_IN_MOTION = (0.5, 2.0)
_COUNTS_OF_G = (16384, 8192, 4096, 2048, 1024, 256)  # of data sheets
_LIKE_COUNTS = 0.15
_RATES_IN_MOTION = (("rad/s", 10.0), ("deg/s", 2000.0), ("mdeg/s", np.inf))  # largest rms of a hand that waves a sensor
_SOME = 20_000  # samples that are enough for a sphere
_ROUND = 0.25  # scatter of its radius; soft iron bends it
_WIDEST = 3.0  # radius in units of the range: a small cap tells none
_LIKE_EARTH_UT = (14.2, 142.0)  # the earth's field is 22 to 67 uT; an uncalibrated scale may be off
_DECISIVE = 10.0  # ratio of the scatters of the two triads between rests


@value_class(eq=True)
class Unit:
    """A unit that was recognised, and why."""

    unit: str
    reason: str


def _windows(values: Floats) -> tuple[Floats, Floats]:
    """Return means (k, 3) and total standard deviations (k,) of windows spread evenly over the samples."""
    length = min(_WINDOW, max(2, len(values) // 4), len(values))
    count = min(_WINDOWS, len(values) // length)
    start = np.linspace(0, len(values) - length, count).astype(np.int64)
    part = values[start[:, None] + np.arange(length)]
    means = part.mean(axis=1)
    return means, np.sqrt(((part - means[:, None]) ** 2).sum(axis=(1, 2)) / length)


def rest_magnitude(values: Floats) -> float:
    """Return the median magnitude of the samples in the quietest fifth of the recording, in their unit."""
    means, spread = _windows(values)
    quiet = spread <= np.quantile(spread, 0.2)
    return float(np.median(np.linalg.norm(means[quiet], axis=1)))


def gravity_unit(magnitude: float, limits: tuple[float, float] = _LIKE_GRAVITY) -> str | None:
    """Return the unit in which a magnitude is within these limits of gravity, or None."""
    for unit, factor in ACCELEROMETER_UNITS_M_S2.items():
        if factor is not None and limits[0] < magnitude * factor / STANDARD_GRAVITY_M_S2 < limits[1]:
            return unit
    return None


def is_gravity_in_counts(magnitude: float) -> bool:
    """Tell whether a magnitude is near the counts that data sheets state for one g."""
    return any(abs(magnitude / count - 1) < _LIKE_COUNTS for count in _COUNTS_OF_G)


def _whole_numbers(values: Floats) -> bool:
    part = values[:: max(1, len(values) // 10_000)]
    return bool((part == np.rint(part)).all())


def accelerometer_unit(values: Floats, *, in_motion: bool = False) -> Unit:
    """Recognise the unit of an accelerometer from its reading of gravity, (n, 3), at rest or moving."""
    if _whole_numbers(values):
        return Unit(unit="count", reason="whole numbers")
    what, limits = "magnitude at rest", _LIKE_GRAVITY
    if in_motion:
        what, limits = "median magnitude", _LIKE_GRAVITY_IN_MOTION
    magnitude = float(np.median(np.linalg.norm(values, axis=1))) if in_motion else rest_magnitude(values)
    unit = gravity_unit(magnitude, limits)
    if unit is not None:
        return Unit(unit=unit, reason=f"its {what} is {magnitude:.4g}")
    return Unit(unit="count", reason=f"its {what}, {magnitude:.4g}, is gravity in no known unit")


def gyroscope_unit(values: Floats, t_ns: Integers, accelerometer: Floats | None, *, in_motion: bool = False) -> Unit:
    """Recognise the unit of a gyroscope.

    Physics decides where it can: seen from the body, gravity turns with du/dt = -omega x u, whose slope tells the unit.
    Otherwise the noise at rest and the largest rate are held against those of usual sensors, or in motion the rate
    against how fast a hand moves.

    Parameters
    ----------
    values : (n, 3)
    t_ns : (n,) [ns]
    accelerometer : (n, 3) at the same timestamps, in a unit that has its zero at zero; None where there is no such
        thing
    in_motion : whether the sensor never rests
    """
    if _whole_numbers(values) and (np.ptp(values) > 0 or not in_motion):
        return Unit(unit="count", reason="whole numbers")
    slope = None if accelerometer is None else turning_of_gravity(accelerometer, values, t_ns)
    if slope is not None:
        unit = "rad/s" if slope > np.sqrt(np.pi / 180) else "deg/s"
        return Unit(unit=unit, reason=f"the turns of gravity are {slope:.3g} rad for each unit and second")
    if in_motion:
        rms = float(np.sqrt(values.var(axis=0).sum()))
        unit = next(unit for unit, largest in _RATES_IN_MOTION if rms <= largest)
        return Unit(unit=unit, reason=f"its root mean square is {rms:.3g}")
    _, spread = _windows(values)
    noise = max(float(np.quantile(spread, 0.1)) / np.sqrt(3), 1e-6)
    centred = np.abs(values - np.median(values[:: max(1, len(values) // 10_000)], axis=0))
    peak = max(float(centred.max()), noise)
    # Usual: noise 0.005 rad/s or 0.3 deg/s, largest rate of a hand 4 rad/s or 230 deg/s. A resting sensor has no peak.
    evidence = np.log(noise / 0.04)
    if peak > 20 * noise:
        evidence += 2 * np.log(peak / 30.0)
    unit = "deg/s" if evidence > 0 else "rad/s"
    return Unit(unit=unit, reason=f"noise at rest {noise:.2g}, largest value {peak:.3g}")


def magnetometer_unit(values: Floats) -> Unit:
    """Recognise the unit of a magnetometer from the earth's field, (n, 3).

    Where the sensor was turned, the radius of the sphere that it measured is the field whatever the offset is; else its
    magnitude is all there is.
    """
    if _whole_numbers(values):
        return Unit(unit="count", reason="whole numbers")
    magnitude = float(np.median(np.linalg.norm(values, axis=1)))
    field = _radius(values) or magnitude
    for unit, factor in MAGNETOMETER_UNITS_UT.items():
        if factor is not None and _LIKE_EARTH_UT[0] < field * factor < _LIKE_EARTH_UT[1]:
            return Unit(unit=unit, reason=f"the field is {field:.4g}")
    return Unit(unit="count", reason=f"the field, {field:.4g}, is that of the earth in no known unit")


def _radius(values: Floats) -> float | None:
    """Return the radius of the sphere of least squares through samples (n, 3); None where they surround none.

    |m|^2 = 2 b'm + (r^2 - |b|^2) is linear in the centre b; samples far outside of most of them are left out.
    """
    low, high = np.quantile(values, (0.005, 0.995), axis=0)
    width = float((high - low).max())
    if not width > 0:
        return None
    some = values[:: max(1, len(values) // _SOME)]
    some = some[((some >= low - 0.1 * width) & (some <= high + 0.1 * width)).all(axis=1)]
    middle = 0.5 * (low + high)
    m = (some - middle) / width
    rows = np.column_stack([2 * m, np.ones(len(m))])
    found, _, rank, _ = np.linalg.lstsq(rows, np.sum(m**2, axis=1), rcond=1e-3)
    square = float(found[3] + found[:3] @ found[:3])
    if rank < 4 or not square > 0:
        return None
    radius = float(np.sqrt(square))
    distance = np.linalg.norm(m - found[:3], axis=1)
    return radius * width if float(np.std(distance)) < _ROUND * radius and radius < _WIDEST else None


@value_class(eq=True)
class Recogniser:
    """What tells the units from the values: of the accelerometer, and of the gyroscope given timestamps and force."""

    accelerometer: Callable[[Floats], Unit]
    gyroscope: Callable[[Floats, Integers, Floats | None], Unit]


WITH_RESTS = Recogniser(accelerometer=accelerometer_unit, gyroscope=gyroscope_unit)
IN_MOTION = Recogniser(
    accelerometer=partial(accelerometer_unit, in_motion=True), gyroscope=partial(gyroscope_unit, in_motion=True)
)


def turning_of_gravity(accelerometer: Floats, gyroscope: Floats, t_ns: Integers) -> float | None:
    """Return the slope of du/dt against -omega x u [rad/s per unit of the gyroscope]; None if nothing turns."""
    size = min(len(gyroscope), 400_000)
    span = float(t_ns[size - 1] - t_ns[0]) * 1e-9
    length = max(1, round(0.1 * size / span)) if span > 0 else 1
    count = size // length
    if count < 20 or not span > 0:  # stamps may stand still
        return None
    force = accelerometer[: count * length].reshape(count, length, 3).mean(axis=1)
    rate = gyroscope[: count * length].reshape(count, length, 3).mean(axis=1)
    _, spread = _windows(gyroscope)
    means, _ = _windows(gyroscope)
    rate = rate - np.median(means[spread <= np.quantile(spread, 0.2)], axis=0)
    norm = np.linalg.norm(force, axis=1, keepdims=True)
    up = force / np.where(norm > 0, norm, 1.0)
    step = span / size * length
    measured = (up[2:] - up[:-2]) / (2 * step)
    predicted = -np.cross(rate[1:-1], up[1:-1])
    energy, cross = float((predicted**2).sum()), float((measured * predicted).sum())
    total = float((measured**2).sum())
    if not (energy > 0 and total > 0) or cross / np.sqrt(energy * total) < 0.5:
        return None
    return cross / energy


def accelerometer_is_first(first: Floats, second: Floats) -> tuple[bool | None, str]:
    """Tell which of two triads is the accelerometer, and why; None if the values do not tell.

    Between rests, a gyroscope comes back to the same reading (its bias), an accelerometer shows another attitude. Where
    nothing turned, only one of the two can read as gravity in a known unit, or in counts far above the other's.

    Parameters
    ----------
    first, second : (n, 3), (m, 3) of the same span of time
    """
    (means_1, spread_1), (means_2, spread_2) = _windows(first), _windows(second)
    count = min(len(means_1), len(means_2))
    rank = np.argsort(np.argsort(spread_1[:count])) + np.argsort(np.argsort(spread_2[:count]))
    quiet = rank <= np.quantile(rank, 0.2)
    scatter: list[float] = []
    gravity: list[str | None] = []
    magnitude: list[float] = []
    for means, spread in ((means_1[:count], spread_1[:count]), (means_2[:count], spread_2[:count])):
        between = float(np.sqrt(means[quiet].var(axis=0).sum()))
        scatter.append(between / max(float(np.median(spread[quiet])), 1e-12))
        magnitude.append(float(np.median(np.linalg.norm(means[quiet], axis=1))))
        gravity.append(gravity_unit(magnitude[-1]))
    ratio = scatter[0] / max(scatter[1], 1e-12)
    by_gravity = None if (gravity[0] is None) == (gravity[1] is None) else gravity[0] is not None
    by_scatter = (
        ratio > 1 if count >= 10 and max(scatter) > 3 and max(ratio, 1 / max(ratio, 1e-12)) > _DECISIVE else None
    )
    if by_scatter is not None and by_gravity in {None, by_scatter}:
        return by_scatter, "at rest it changes with the attitude, the other one does not"
    if by_scatter is None and by_gravity is not None:
        return by_gravity, f"its magnitude at rest is gravity in {gravity[0] if by_gravity else gravity[1]}"
    large, small = max(magnitude), min(magnitude)
    counts = _whole_numbers(first) and _whole_numbers(second)
    if by_scatter is None and counts and is_gravity_in_counts(large) and small < large / 4:
        return magnitude[0] > magnitude[1], f"at rest it reads {large:.0f} counts, as gravity does"
    return None, ""
