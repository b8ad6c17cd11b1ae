"""Candidates -> Comparison: blocks in common, differences of pairs, scatter of all, and who stands out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import nan

import numpy as np

from ...errors import FormatError, OptionError
from ...geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from ...recording import Floats, Integers, frozen_array, recorded_hashes, shared_sources
from .candidates import FRAME, ComparisonCandidate, at_common_origins, in_common_frame
from .comparison import (
    UNJUDGED,
    ComparedCalibration,
    Comparison,
    Difference,
    LensDifference,
    Repeatability,
    Scatter,
    largest_z_limit,
    lens_difference,
)
from .comparison_findings import with_words
from .quantities import ComparedQuantity, Statement, statement_of, with_scatter_between_recordings

_MIXED_UNITS = 1.5
_LEAST_VARIANCE = 1e-6  # that is left when what is shared was taken off, of all of it
_MEAN_STEPS = 20


def compare_candidates(candidates: Sequence[ComparisonCandidate]) -> Comparison:
    """Compare calibrations of one rig.

    Raises
    ------
    OptionError
        If there is only one, two have one name, or they have nothing in common.
    FormatError
        If two of them are for measurements in different units.
    """
    _check_number(candidates)
    notes: list[str] = []
    common = at_common_origins([in_common_frame(candidate) for candidate in candidates])
    references = frozenset(body for candidate in common for body in candidate.bodies if body != "imu0")
    statements = {candidate.name: statement_of(candidate, references) for candidate in common}
    single = _of_one_occasion(common)
    statements |= {name: with_scatter_between_recordings(statements[name]) for name in single}
    shared = _same_gravity(common)
    _check_units(statements, notes)
    blocks: list[Repeatability] = []
    differences: list[Difference] = []
    for path in _paths(list(statements.values())):
        differences += _differences(path, statements, shared)
        found = _repeatability(path, statements, shared)
        if found is not None:
            blocks.append(found)
    lenses = tuple(_lenses(common))
    if not blocks and not lenses and not differences:
        raise OptionError(_nothing_in_common(candidates))
    judged = [block for block in blocks if block.judged]
    names = [candidate.name for candidate in candidates]
    pooled = _scatter([block.path for block in judged], statements, shared, names)
    z_rms, limit = pooled.z_rms()
    there = {block.path: block.names for block in judged}
    both = [item for item in differences if {item.first, item.second} <= {*there.get(item.path, ())}]
    count = sum(int(np.isfinite(item.z).sum()) for item in both)
    comparison = Comparison(
        calibrations=tuple(_described(candidate, candidate.name in single) for candidate in candidates),
        frame=_frame(common),
        blocks=tuple(blocks),
        differences=tuple(differences),
        lenses=lenses,
        z_rms=z_rms,
        limit=limit,
        z_limit=largest_z_limit(count),
        compared=count,
    )
    return with_words(comparison, common, notes)


def _frame(candidates: Sequence[ComparisonCandidate]) -> str:
    """Return the body frame in which they are compared: that of a camera where none holds an IMU."""
    bodies = frozenset[str]().union(*(candidate.bodies for candidate in candidates))
    imus = any(candidate.imus for candidate in candidates)
    return FRAME if imus or len(bodies) != 1 else next(iter(bodies)).replace("imu0", FRAME)


def _check_number(candidates: Sequence[ComparisonCandidate]) -> None:
    if len(candidates) < 2:
        raise OptionError(
            f"found {len(candidates)} calibration, expected at least two to compare. Name another one of the same rig, "
            "such as gnomon compare first-imu second-imu; files of one calibration are joined by +."
        )
    names = [candidate.name for candidate in candidates]
    for name in names:
        if names.count(name) > 1:
            raise OptionError(f'two calibrations are called "{name}". Name them: first=PATH second=PATH.')


def _of_one_occasion(candidates: Sequence[ComparisonCandidate]) -> frozenset[str]:
    """Return those that are of one recording each, and share it with none of the others."""
    inputs = {one.name: one.inputs for one in candidates if one.imus and not one.exact}
    known = {name: found for name, found in inputs.items() if recorded_hashes(found)}
    alone = {
        name
        for name, found in known.items()
        if not any(shared_sources(found, other) for who, other in known.items() if who != name)
    }
    single = {one.name for one in candidates if one.name in alone and not one.recordings and one.covariance is not None}
    return frozenset(single) if len(known) > 1 else frozenset()


def _described(candidate: ComparisonCandidate, one_occasion: bool) -> ComparedCalibration:
    gravity = candidate.gravity
    spread = f" +- {gravity.sigma:.2g}" if gravity is not None and gravity.sigma > 0 else ""
    return ComparedCalibration(
        name=candidate.name,
        format=candidate.format,
        frame=candidate.frame,
        gravity="" if gravity is None else f"{gravity.value:.7g}{spread} m/s^2 ({gravity.source})",
        sigmas=candidate.covariance is not None,
        exact=candidate.exact,
        inputs=candidate.inputs,
        verdict=candidate.verdict,
        sensors=(*candidate.imus, *candidate.cameras, *candidate.lenses),
        notes=candidate.notes,
        one_occasion=one_occasion,
    )


def shares_gravity(first: ComparisonCandidate, second: ComparisonCandidate) -> bool:
    """Tell whether two calibrations hold the same error of the same gravity."""
    found = _same_gravity((first, second))
    return len(found) > 1 and len(set(found.values())) == 1


def _same_gravity(candidates: Sequence[ComparisonCandidate]) -> dict[str, tuple[float, float, str]]:
    """Return name -> what was assumed of gravity, of those whose sigmas hold it; equal ones are the same error."""
    return {
        candidate.name: (candidate.gravity.value, candidate.gravity.sigma, candidate.gravity.source)
        for candidate in candidates
        if candidate.gravity is not None and candidate.gravity.sigma > 0 and not candidate.cameras
    }


def _paths(statements: Sequence[Statement]) -> list[str]:
    """Return the blocks that at least two state, in the order of the first that has them."""
    found: dict[str, int] = {}
    for statement in statements:
        for path in statement.quantities:
            found[path] = found.get(path, 0) + 1
    return [path for path, count in found.items() if count > 1]


def _check_units(statements: Mapping[str, Statement], notes: list[str]) -> None:
    """Refuse calibrations for measurements in other units; scales of counts and of SI are not compared."""
    for first, second in combinations(statements.values(), 2):
        for path in [path for path in first.quantities if path in second.quantities and path.endswith(".scale")]:
            one, other = first.quantities[path], second.quantities[path]
            if not (one.estimated and other.estimated):
                continue
            ratio = float(np.cbrt(abs(np.prod(one.values) / np.prod(other.values))))
            near = 1 / _MIXED_UNITS < ratio < _MIXED_UNITS
            if one.unit == other.unit and not near:
                raise FormatError(_mixed_units(path, ratio, first.name, second.name))
            if one.unit != other.unit and near:
                _take_unit(first, second, path, notes)
            elif one.unit != other.unit:
                notes.append(
                    f"{first.name} and {second.name} are for {path.split('.')[1]} samples in other units "
                    f"({_raw(one)}, {_raw(other)}); scale, bias and g-sensitivity were not compared."
                )


def _raw(quantity: ComparedQuantity) -> str:
    return "SI units" if quantity.unit == "1" else quantity.unit.split("/")[0]


def _mixed_units(path: str, ratio: float, first: str, second: str) -> str:
    larger, smaller = (first, second) if ratio > 1 else (second, first)
    ratio = max(ratio, 1 / ratio)
    guesses = {57.29578: "deg/s and rad/s", 9.80665: "m/s^2 and g", 1000.0: "a unit and its thousandth"}
    guess = next(
        (f" That is the ratio of {words}." for value, words in guesses.items() if abs(ratio / value - 1) < 0.05), ""
    )
    return (
        f"the {' '.join(path.split('.')[1:])} of {larger} is {ratio:.4g} times that of {smaller}: they are not for "
        f"measurements in the same units.{guess} Compare calibrations of one sensor, made from samples in one unit."
    )


def _take_unit(first: Statement, second: Statement, path: str, notes: list[str]) -> None:
    """Say that samples whose unit a file does not state are in SI units, as the scale shows."""
    counted = first if first.quantities[path].unit != "1" else second
    triad = path.rsplit(".", 1)[0]
    notes.append(
        f"{counted.name} does not state the unit of its {triad.split('.')[1]} samples; taken: SI units, as its scale "
        "shows."
    )
    for name in (f"{triad}.scale", f"{triad}.bias", f"{triad}.g_sensitivity"):
        if name in counted.quantities:
            other = (second if counted is first else first).quantities.get(name)
            unit = counted.quantities[name].unit if other is None else other.unit
            counted.quantities[name] = replace(counted.quantities[name], unit=unit)


def _nothing_in_common(candidates: Sequence[ComparisonCandidate]) -> str:
    held = "; ".join(
        f"{one.name} has {', '.join((*one.imus, *one.cameras, *one.lenses)) or 'nothing'}" for one in candidates
    )
    return (
        f"these calibrations have nothing in common that could be compared: {held}. Sensors are matched by name; "
        "rename them where they are called otherwise (--rename NAME.left=cam0), or give files that describe the same "
        "sensors (camchain and IMU files of one calibration are joined by +)."
    )


def _stated(path: str, statements: Mapping[str, Statement]) -> dict[str, ComparedQuantity]:
    """Return those that estimated a block, as far as they can be compared with the first of them."""
    found = {name: one.quantities[path] for name, one in statements.items() if path in one.quantities}
    estimated = {name: one for name, one in found.items() if one.estimated}
    if not estimated:
        return {}
    first = next(iter(estimated.values()))
    return {name: one for name, one in estimated.items() if _alike(one, first)}


def _alike(one: ComparedQuantity, other: ComparedQuantity) -> bool:
    return one.unit == other.unit and one.elements == other.elements


def _variances(statement: Statement, quantity: ComparedQuantity) -> Floats:
    """Return the variances (k,) of a block; nan where they are not stated, or zero."""
    if statement.covariance is None:
        return np.full(len(quantity.elements), nan)
    variance = np.diag(statement.covariance)[quantity.rows]
    return np.where(variance > 0, variance, nan)


def _differences(
    path: str, statements: Mapping[str, Statement], shared: Mapping[str, tuple[float, float, str]]
) -> Iterator[Difference]:
    """Yield every pair of those that state a block, where at least one estimated it."""
    stating = {name: one.quantities[path] for name, one in statements.items() if path in one.quantities}
    spread = {name: _variances(statements[name], one) for name, one in stating.items()}
    for (first, one), (second, other) in combinations(stating.items(), 2):
        if not (one.estimated or other.estimated) or not _alike(one, other):
            continue
        telling = [
            name for name, variance in spread.items() if _alike(stating[name], one) and not np.isnan(variance).all()
        ]
        own = [name for name in telling if name in {first, second}]
        variance = np.full(len(one.elements), nan)
        if own:
            variance = _sum_of_known([spread[name] for name in own])
        elif telling:  # the others are the yardstick
            variance = _sum_of_known([spread[name] for name in telling]) / len(telling)
        if first in shared and shared[first] == shared.get(second):
            pulls = statements[first].by_gravity[one.rows], statements[second].by_gravity[other.rows]
            less = variance - pulls[0] ** 2 - pulls[1] ** 2 + (pulls[0] - pulls[1]) ** 2
            variance = np.maximum(less, _LEAST_VARIANCE * variance)
        yield Difference(
            first=first,
            second=second,
            path=path,
            values=frozen_array(subtract_quantity(one, other)),
            sigmas=frozen_array(np.sqrt(variance)),
            basis=tuple(own or telling),
        )


def _sum_of_known(variances: Sequence[Floats]) -> Floats:
    """Return sums (k,) of those that are known; nan where none is."""
    table = np.array(variances)
    return np.where(np.isnan(table).all(axis=0), nan, np.nansum(table, axis=0))


def subtract_quantity(one: ComparedQuantity, other: ComparedQuantity) -> Floats:
    """Return how far a block differs from another, (k,); of rotations, the rotation vector between them."""
    if one.rotation is None or other.rotation is None:
        return one.values - other.values
    return rotvec_from_rotation(other.rotation.T @ one.rotation)


def _mean_rotation(rotations: Sequence[Floats]) -> Floats:
    """Return the rotation about which the rotation vectors of the others sum up to zero."""
    mean = rotations[0]
    for _ in range(_MEAN_STEPS):
        step = np.mean([rotvec_from_rotation(mean.T @ rotation) for rotation in rotations], axis=0)
        mean = mean @ rotation_from_rotvec(step)
        if np.linalg.norm(step) < 1e-15:
            break
    return mean


def _values(quantities: Sequence[ComparedQuantity]) -> tuple[Floats, Floats | None]:
    """Return the values (m, k) of a block, and the mean rotation where it is one."""
    rotations = [one.rotation for one in quantities if one.rotation is not None]
    if not rotations:
        return np.array([one.values for one in quantities]), None
    mean = _mean_rotation(rotations)
    return np.array([rotvec_from_rotation(mean.T @ rotation) for rotation in rotations]), frozen_array(mean)


def _repeatability(
    path: str, statements: Mapping[str, Statement], shared: Mapping[str, tuple[float, float, str]]
) -> Repeatability | None:
    found = _stated(path, statements)
    if not found:
        return None
    first = next(iter(found.values()))
    values, reference = _values(list(found.values()))
    sigmas = np.sqrt([_variances(statements[name], one) for name, one in found.items()])
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.isfinite(sigmas).sum(axis=0)
        predicted = np.sqrt(np.nansum(sigmas**2, axis=0) / np.where(known, known, nan))
    z_rms, limit = _scatter([path], statements, shared, list(found)).z_rms()
    return Repeatability(
        path=path,
        kind=first.kind,
        elements=first.elements,
        unit=first.unit,
        names=tuple(found),
        values=frozen_array(values),
        sigmas=frozen_array(sigmas),
        reference=reference,
        mean=frozen_array(values.mean(axis=0)),
        scatter=frozen_array(values.std(axis=0, ddof=1) if len(found) > 1 else np.full(len(first.elements), nan)),
        predicted=frozen_array(predicted),
        z_rms=z_rms,
        limit=limit,
        assumed=tuple(name for name, one in statements.items() if path in one.quantities and name not in found),
        judged=first.kind not in UNJUDGED,
    )


def _scatter(
    paths: Sequence[str],
    statements: Mapping[str, Statement],
    shared: Mapping[str, tuple[float, float, str]],
    names: Sequence[str],
) -> Scatter:
    """Return all scalars of the blocks, of those that state sigmas; of all where only one does."""
    stating = [name for name in names if statements[name].covariance is not None]
    used = stating if len(stating) > 1 else list(names)
    common = len({shared.get(name) for name in used}) == 1 and shared.get(used[0]) is not None if used else False
    columns = {path: len(next(iter(_stated(path, statements).values())).elements) for path in paths}
    total = sum(columns.values())
    values, covariances = np.full((len(used), total), nan), np.zeros((len(used), total, total))
    start = 0
    places: list[dict[str, slice]] = [{} for _ in used]
    for path, count in columns.items():
        found = {name: one for name, one in _stated(path, statements).items() if name in used}
        if len(found) > 1:
            numbers, _ = _values(list(found.values()))
            for (name, one), row in zip(found.items(), numbers, strict=True):
                values[used.index(name), start : start + count] = row
                places[used.index(name)][path] = one.rows
        start += count
    for i, name in enumerate(used):
        covariance = statements[name].covariance
        if covariance is None:
            continue
        if common:
            pull = statements[name].by_gravity
            reduced = covariance - np.outer(pull, pull)
            least = _LEAST_VARIANCE * np.diag(covariance)
            covariance = reduced + np.diag(np.fmax(least - np.diag(reduced), 0.0))
        rows = _gathered(places[i], columns)
        there = rows >= 0
        block = np.nan_to_num(covariance[np.ix_(rows[there], rows[there])])
        covariances[i][np.ix_(there, there)] = block
    return Scatter(values=values, covariances=covariances)


def _gathered(places: Mapping[str, slice], columns: Mapping[str, int]) -> Integers:
    """Return for each scalar where it stands in a covariance; -1 where it does not."""
    parts = [
        np.arange(places[path].start, places[path].stop) if path in places else np.full(count, -1)
        for path, count in columns.items()
    ]
    return np.concatenate(parts) if parts else np.empty(0, dtype=int)


def _lenses(candidates: Sequence[ComparisonCandidate]) -> Iterator[LensDifference]:
    """Yield how the lenses of every pair differ."""
    for first, second in combinations(candidates, 2):
        theirs = second.all_lenses
        for name, lens in first.all_lenses.items():
            if name in theirs:
                other = theirs[name]
                if name in first.guessed_sizes:  # the size that is stated holds for both
                    lens = replace(lens, resolution=other.resolution)  # noqa: PLW2901
                elif name in second.guessed_sizes:
                    other = replace(other, resolution=lens.resolution)
                found = lens_difference(name, (first.name, lens), (second.name, other))
                if found is not None:
                    yield found
