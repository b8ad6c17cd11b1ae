"""What is wrong with a line: causes that many results show together, one after the other, each with its cure.

What explains others is looked for first, and taken off: one recording under two serial numbers, another gravity, a
wrong unit, a station, a change in time; then devices that are unlike the others, and devices that changed. All tests of
one kind together raise one false alarm in a thousand lines.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import date
from math import log, pi, sqrt
from typing import Any

import numpy as np

from ..assess.verdict import SEVERITIES
from ..findings import Finding, join_names, make_finding
from ..frozen import value_class
from ..recording import Floats, Integers
from .entries import LibraryEntry, LineTable
from .statistics import (
    GroupOffset,
    Population,
    TimeChange,
    group_offsets,
    normal_limit,
    robust_population,
    time_changes,
)

CHANCE = 1e-3
"""Of a false alarm of one kind on a line."""
_FEWEST = 8
"""Devices of a line, or repeated measurements, from which on a spread is told."""
_MOST_NAMED = 20
_WIDE = 6.0  # standard deviations within which pairs are averaged
_SAME_GRAVITY = 5e-4  # m/s^2
_UNITS = {
    "g in m/s^2": 9.80665,
    "m/s^2 in g": 1 / 9.80665,
    "deg/s in rad/s": 180 / pi,
    "rad/s in deg/s": pi / 180,
    "thousandths": 1e3,
    "thousands": 1e-3,
}
_UNIT_TOLERANCE = log(1.15)


@value_class
class LineAssessment:
    """What a line's results tell.

    Attributes
    ----------
    table : all results
    first : (d,) rows of the first result of each device
    populations : (k,) of each scalar over the devices, stations and changes in time taken off
    reproducibility : (k,) standard deviation of a device from one measurement to the next [units]; nan where too few
        devices were measured twice
    repeats : how many times a device was measured again
    stations : offsets of stations: the scalar's index, and how far it is off
    changes : changes in time: the scalar's index, and the change; rows of `first`
    worst : |z| of each result against the population (n,)
    worst_scalar : its scalar (n,)
    findings : what is wrong, worst first
    """

    table: LineTable
    first: tuple[int, ...]
    populations: tuple[Population, ...]
    reproducibility: Floats
    repeats: int
    stations: tuple[tuple[int, GroupOffset], ...]
    changes: tuple[tuple[int, TimeChange], ...]
    worst: Floats
    worst_scalar: tuple[int, ...]
    findings: tuple[Finding, ...]


def assess_line(table: LineTable) -> LineAssessment:
    """Return what the results of a line tell, with findings; the order of the rows is that of the measurements."""
    found = list[Finding]()
    rows, doubles = _without_doubles(table.entries)
    found += doubles
    table = table if len(rows) == len(table.entries) else table.rows(rows)
    serials = [entry.serial for entry in table.entries]
    first_of = dict(zip(reversed(serials), range(len(serials) - 1, -1, -1), strict=True))
    first = np.array(sorted(first_of.values()), dtype=np.int64)
    values = table.values.copy()
    found += _other_gravity(table, values)
    found += _wrong_units(table, values)
    corrected = replace(table, values=values)
    devices, pairs = _Devices(corrected, first), _repeats(table.entries)
    stations = _station_offsets(devices, pairs)
    found += [
        make_finding(
            "line-station",
            station=offset.group or "without name",
            name=table.names[k],
            offset=offset.offset,
            sigma=offset.sigma,
            unit=table.units[k],
            count=offset.count,
        )
        for k, offset in stations
    ]
    changes = _changes_in_time(devices)
    found += [_time_finding(table, first, k, change) for k, change in changes]
    populations = tuple(devices.population(k) for k in range(len(table.names)))
    z = np.stack([_z(corrected, k, one) for k, one in enumerate(populations)], axis=1) if populations else values
    size = np.nan_to_num(np.abs(z))
    worst_scalar = size.argmax(axis=1) if size.size else np.zeros(len(serials), dtype=int)
    worst = size.max(axis=1, initial=0.0)
    reproducibility, repeats, moved = _changed_devices(corrected, pairs)
    found += moved
    found += _outliers(table, z, devices.limit, first)
    return LineAssessment(
        table=table,
        first=tuple(first.tolist()),
        populations=populations,
        reproducibility=reproducibility,
        repeats=repeats,
        stations=tuple(stations),
        changes=tuple(changes),
        worst=worst,
        worst_scalar=tuple(worst_scalar.tolist()),
        findings=tuple(sorted(found, key=lambda finding: SEVERITIES[finding.severity])),
    )


def days_of(entries: Sequence[LibraryEntry]) -> Floats:
    """Return the days (n,) of measurements; without any date their order; what has none is taken for the first."""
    dates = {entry.measured for entry in entries}
    day_of = {day: date.fromisoformat(day).toordinal() if day else 0 for day in dates}
    known = [day_of[entry.measured] for entry in entries]
    start = min((day for day in known if day), default=0)
    return np.array([max(day, start) for day in known], dtype=float) if start else np.arange(float(len(entries)))


# ---- one recording, gravity, units ----


def _without_doubles(entries: Sequence[LibraryEntry]) -> tuple[list[int], list[Finding]]:
    """Return the rows that hold each recording once, its newest result, and findings where two serials share one."""
    keys = [entry.digests or entry.values.tobytes() for entry in entries]
    if len(set(keys)) == len(keys):
        return [*range(len(keys))], []
    of: dict[object, list[int]] = {}
    for index, key in enumerate(keys):
        of.setdefault(key, []).append(index)
    kept, found = list[int](), list[Finding]()
    for rows in of.values():
        if len(rows) == 1:
            kept.append(rows[0])
            continue
        serials = list(dict.fromkeys(entries[row].serial for row in rows))
        kept.append(rows[-1] if len(serials) == 1 else rows[0])
        if len(serials) > 1:
            names = join_names(serials[:5])
            inputs = entries[rows[0]].inputs
            recording = inputs[0][0] if inputs else "the same numbers"
            found.append(make_finding("line-duplicate", serials=names, recording=recording))
    return sorted(kept), found


def _other_gravity(table: LineTable, values: Floats) -> Iterator[Finding]:
    """Yield a finding for each station where a few took another gravity; their scales are blanked."""
    scale = [k for k, name in enumerate(table.names) if "accelerometer.sensitivity" in name]
    stations: dict[str, list[int]] = {}
    for row, entry in enumerate(table.entries):
        stations.setdefault(entry.station, []).append(row)
    taken_by = np.array([entry.gravity for entry in table.entries])
    for station, rows in stations.items():
        (usual, count), *_ = Counter(taken_by[rows].round(4).tolist()).most_common(1)
        odd = [row for row in rows if abs(taken_by[row] - usual) > _SAME_GRAVITY]
        if not scale or not odd or count < max(_FEWEST, 0.8 * len(rows)):
            continue
        values[np.ix_(odd, scale)] = np.nan
        taken = table.entries[odd[0]].gravity
        yield make_finding(
            "line-gravity",
            serials=join_names(list(dict.fromkeys(table.entries[row].serial for row in odd))[:5]),
            count=len(odd),
            gravity=taken,
            usual=usual,
            share=abs(taken / usual - 1),
            station=station or "without name",
        )


def _wrong_units(table: LineTable, values: Floats) -> Iterator[Finding]:
    """Yield a finding for each device whose scales are a known factor off; they are blanked."""
    for triad in sorted({name.rpartition(".")[0] for name in table.names if name.endswith(".sensitivity[0,0]")}):
        diagonal = [
            k for i in range(3) for k, name in enumerate(table.names) if name == f"{triad}.sensitivity[{i},{i}]"
        ]
        all_ = [k for k, name in enumerate(table.names) if name.startswith(f"{triad}.")]
        sizes = np.abs(values[:, diagonal])
        usual = np.nanmedian(sizes, axis=0) if len(sizes) >= _FEWEST else np.full(len(diagonal), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.log(sizes / usual).mean(axis=1)
        for row in np.flatnonzero(np.abs(ratios) > log(1.5)).tolist():
            near = min(_UNITS, key=lambda unit: abs(log(_UNITS[unit]) - ratios[row]))
            if abs(log(_UNITS[near]) - ratios[row]) < _UNIT_TOLERANCE:
                values[row, all_] = np.nan
                factor = float(np.exp(ratios[row]))
                yield make_finding("line-unit", serial=table.entries[row].serial, triad=triad, factor=factor, unit=near)


# ---- stations and time ----


class _Devices:
    """The first results of all devices, rows of a table; their populations are found again where values changed."""

    def __init__(self, table: LineTable, rows: Integers) -> None:
        self.table, self.rows = table, rows
        self.limit = normal_limit(CHANCE / max(table.values.size, 1))
        self._known: dict[int, Population] = {}
        self._weighted: dict[int, tuple[Floats, Floats]] = {}

    def population(self, k: int) -> Population:
        if k not in self._known:
            self._known[k] = robust_population(
                self.table.values[self.rows, k], self.table.sigmas[self.rows, k], self.limit
            )
        return self._known[k]

    def weighted(self, k: int) -> tuple[Floats, Floats]:
        """Return values of a scalar, drawn in to the limits of the population, and their variances about its mean."""
        if k not in self._weighted:
            known = self.population(k)
            variances = known.spread**2 + self.table.sigmas[self.rows, k] ** 2
            reach = normal_limit(CHANCE / max(len(self.rows), 1)) * np.sqrt(variances)
            drawn_in = np.clip(self.table.values[self.rows, k], known.mean - reach, known.mean + reach)
            self._weighted[k] = drawn_in, variances
        return self._weighted[k]

    def take_off(self, rows: Sequence[int] | slice, k: int, offset: float | Floats) -> None:
        self.table.values[rows, k] -= offset
        for found in (self._known, self._weighted):
            found.pop(k, None)


def _station_offsets(devices: _Devices, pairs: Integers) -> list[tuple[int, GroupOffset]]:
    """Return stations that are off, the most certain first, and take their offsets off the values."""
    table, first = devices.table, devices.rows
    stations = [entry.station for entry in table.entries]
    number = {name: index for index, name in enumerate(dict.fromkeys(stations))}
    names = list(number)
    limit = normal_limit(CHANCE / max(len(table.names) * len(names), 1))
    found: list[tuple[int, GroupOffset]] = []
    labels = np.array(stations)
    of_first = np.array([number[name] for name in stations])[first]
    for _ in names[1:]:
        offsets: dict[str, dict[int, GroupOffset]] = {}
        for k in range(len(table.names)):
            y, variances = devices.weighted(k)
            for offset in group_offsets(y, variances, of_first, names):
                if offset.count >= _FEWEST:
                    offsets.setdefault(offset.group, {})[k] = offset
            for offset in _paired_offsets(table, pairs, labels, k, limit):
                of = offsets.setdefault(offset.group, {})
                of[k] = max(of.get(k, offset), offset, key=lambda one: abs(one.z))
        every = [(k, one) for of in offsets.values() for k, one in of.items()]
        k, worst = max(every, key=lambda item: abs(item[1].z), default=(0, None))
        if worst is None or abs(worst.z) < limit:
            break
        found.append((k, worst))
        own = [row for row, station in enumerate(stations) if station == worst.group]
        for column, offset in offsets[worst.group].items():
            if abs(offset.z) > limit:
                devices.take_off(own, column, offset.offset)
    return found


def _paired_offsets(
    table: LineTable, pairs: Integers, stations: np.ndarray[Any, Any], k: int, limit: float
) -> Iterator[GroupOffset]:
    """Yield how far a station is off by devices that it and another one measured, where that may be beyond the limit.

    Sigmas stand for Student's t, which is farther from zero than the z that is as improbable.
    """
    if len(pairs) < _FEWEST:
        return
    before, after = pairs.T
    steps = table.values[after, k] - table.values[before, k]
    steps -= np.nanmedian(steps) if np.isfinite(steps).any() else 0.0  # what changed for all stations
    sigmas = np.hypot(table.sigmas[after, k], table.sigmas[before, k])
    for station in dict.fromkeys(stations.tolist()):
        sign = (stations[after] == station).astype(float) - (stations[before] == station)
        rows = np.flatnonzero(sign)
        if len(rows) < _FEWEST:
            continue
        known = robust_population(sign[rows] * steps[rows], sigmas[rows], _WIDE)
        if known.count >= _FEWEST and abs(known.mean) > limit * known.mean_sigma:
            from scipy.special import ndtri, stdtr  # takes longer to load than all else here

            z = -float(ndtri(stdtr(known.count - 1, -abs(known.mean) / known.mean_sigma)))
            yield GroupOffset(group=station, offset=known.mean, sigma=abs(known.mean) / max(z, 1e-9), count=known.count)


def _repeats(entries: Sequence[LibraryEntry]) -> Integers:
    """Return the rows (p, 2) of each two results of a device that follow each other."""
    last: dict[str, int] = {}
    pairs: list[tuple[int, int]] = []
    for row, entry in enumerate(entries):
        if entry.serial in last:
            pairs.append((last[entry.serial], row))
        last[entry.serial] = row
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _changes_in_time(devices: _Devices) -> list[tuple[int, TimeChange]]:
    """Return steps and drifts of the line, the most certain first, and take them off the values."""
    table, rows = devices.table, devices.rows
    every_day = days_of(table.entries)
    days = every_day[rows]
    limit = normal_limit(CHANCE / max(2 * len(table.names) * len(rows), 1))
    found: list[tuple[int, TimeChange]] = []
    for _ in range(3):
        changes: list[tuple[int, TimeChange]] = []
        for k in range(len(table.names)):
            changes += [(k, one) for one in time_changes(*devices.weighted(k), days)]
        k, worst = max(changes, key=lambda item: abs(item[1].z), default=(0, None))
        if worst is None or abs(worst.z) < limit:
            break
        found.append((k, worst))
        for column, change in changes:
            if change.kind == worst.kind and abs(change.z) > limit:
                devices.take_off(slice(None), column, _course(change, rows, every_day))
    return found


def _course(change: TimeChange, rows: Integers, days: Floats) -> Floats:
    """Return what a change adds to each result of the line (n,)."""
    if change.kind == "step":
        return np.where(np.arange(len(days)) >= rows[change.at], change.size, 0.0)
    span = days[rows].max() - days[rows].min()
    return change.size * (days - days[rows].min()) / span


def _z(table: LineTable, k: int, known: Population) -> Floats:
    if known.count < _FEWEST:
        return np.full(len(table.entries), np.nan)
    return (table.values[:, k] - known.mean) / np.sqrt(known.spread**2 + table.sigmas[:, k] ** 2)


def _time_finding(table: LineTable, first: Integers, k: int, change: TimeChange) -> Finding:
    at = table.entries[first[change.at]]
    name, unit, z = table.names[k], table.units[k], abs(change.z)
    if change.kind == "step":
        return make_finding("line-step", when=at.measured or at.serial, name=name, size=change.size, unit=unit, z=z)
    return make_finding("line-drift", name=name, size=change.size, unit=unit, z=z)


# ---- devices ----


def _changed_devices(table: LineTable, pairs: Integers) -> tuple[Floats, int, list[Finding]]:
    """Return reproducibility (k,), number of repetitions, and findings on devices that changed or were confused."""
    if len(pairs) < _FEWEST:
        return np.full(len(table.names), np.nan), len(pairs), []
    before, after = pairs.T
    steps = table.values[after] - table.values[before]
    variances = table.sigmas[after] ** 2 + table.sigmas[before] ** 2
    limit = normal_limit(CHANCE / steps.size)
    known = [robust_population(steps[:, k], np.sqrt(variances[:, k]), limit) for k in range(steps.shape[1])]
    spread2 = np.array([one.spread**2 for one in known])
    z = np.stack([one.z for one in known], axis=1)
    size = np.nan_to_num(np.abs(z))
    moved = np.flatnonzero(size.max(axis=1) > limit).tolist()
    confused = {row: _looks_like(table, int(after[row]), spread2) for row in moved}
    found = list(_confused(table, pairs, {row: other for row, other in confused.items() if other}))
    for row in sorted(moved, key=lambda row: -size[row].max())[:_MOST_NAMED]:
        if confused[row]:
            continue
        k = int(size[row].argmax())
        found.append(
            make_finding(
                "line-moved",
                serial=table.entries[after[row]].serial,
                name=table.names[k],
                change=float(steps[row, k]),
                unit=table.units[k],
                z=float(size[row, k]),
                before=table.entries[before[row]].measured or "the first",
                after=table.entries[after[row]].measured or "the next",
            )
        )
    return np.sqrt(spread2 / 2), len(pairs), found


def _looks_like(table: LineTable, row: int, spread2: Floats) -> str:
    """Return the serial number that a changed device has become, "" where it is like no other one.

    Distances are mean squares of all scalars over their variances, 1 for the same device.
    """
    variances = table.sigmas**2 + table.sigmas[row] ** 2 + spread2
    with np.errstate(invalid="ignore"):
        squares = np.square(table.values - table.values[row]) / variances
    known = np.isfinite(squares)
    distance = np.where(known, squares, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    serial = table.entries[row].serial
    other = np.array([entry.serial != serial for entry in table.entries])
    near = int(np.where(other & (known.sum(axis=1) >= 3), distance, np.inf).argmin())
    reach = 1 + 5 * sqrt(2 / max(int(known[near].sum()), 1))
    return table.entries[near].serial if other[near] and distance[near] < reach else ""


def _confused(table: LineTable, pairs: Integers, of: dict[int, str]) -> Iterator[Finding]:
    own = {table.entries[pairs[row][1]].serial: other for row, other in of.items()}
    when = {table.entries[pairs[row][1]].serial: table.entries[pairs[row][1]].measured for row in of}
    for serial, other in own.items():
        if own.get(other) == serial and other < serial:
            continue  # said of the pair
        both = own.get(other) == serial
        yield make_finding(
            "line-swapped", case="both" if both else "one", serial=serial, other=other, when=when[serial] or "its last"
        )


def _outliers(table: LineTable, z: Floats, limit: float, first: Integers) -> Iterator[Finding]:
    size = np.nan_to_num(np.abs(z))
    worst = size.max(axis=1, initial=0.0)
    beyond = [row for row in first.tolist() if worst[row] > limit]
    for row in sorted(beyond, key=lambda row: -worst[row])[:_MOST_NAMED]:
        k = int(size[row].argmax())
        yield make_finding(
            "line-outlier",
            serial=table.entries[row].serial,
            name=table.names[k],
            value=float(table.values[row, k]),
            unit=table.units[k],
            z=float(size[row, k]),
            others=int((size[row] > limit).sum()) - 1,
        )
