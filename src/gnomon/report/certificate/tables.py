"""Page one of every report, the certificate: what was calibrated, the numbers with U = 2 sigma, criteria."""

import re
from collections.abc import Iterator, Mapping
from math import isfinite

from ...assess.comparison.comparison import Comparison
from ...assess.comparison.comparison_words import block_words, typical_size
from ...assess.comparison.verification import Verification, movement_words
from ...assess.uncertainty_budget import uncertainty_budget
from ...frozen import FrozenMapping
from ...results.calibration import Calibration
from ...results.sensor_noise import UNITS, SensorNoise
from ..imu_parameters import groups_over_temperature, imu_groups, parameter_groups
from ..numbers import MISSING, fixed_text, number_text, readable_unit, with_sigma
from ..page import ParameterGroup, ReportTable

STATED: Mapping[str, str] = FrozenMapping(
    {
        "sensor": "Sensor",
        "serial": "Serial number",
        "date": "Date",
        "operator": "Operator",
        "place": "Place",
        "temperature_c": "Temperature",
        "chip_degc": "Temperature of the chip",
    }
)
"""Option that states it -> its name on the certificate. Never the clock: equal inputs and options give equal bytes."""
BUDGET_TITLE = "Where the uncertainty comes from"
Certified = Calibration | SensorNoise | Verification | Comparison
_HEAD = ("", "estimate", "U = 2σ", "unit")
_EXPANDED = "U is the expanded uncertainty with coverage factor k = 2 (about 95 %)."
_MOST = 14
"""Numbers on page one."""
_MATTERS = ("scale", "bias")
"""Ends of the titles of the groups of a triad that stand on page one."""
_CRITERIA = (
    ("pass", "no finding speaks against its use"),
    ("warn", "usable, with the reservations named under What to do"),
    ("fail", "at least one finding says not to use it"),
)
_AGREEMENT = (
    ("pass", "they differ by no more than chance"),
    ("warn", "they agree, with the reservations named under What to do"),
    ("fail", "two of them differ by more than the standard deviations of both allow"),
)


def certificate_tables(result: Certified) -> tuple[ReportTable, ...]:
    """Return the tables of page one but the uncertainty budget, which stands behind the figures."""
    if isinstance(result, Verification):
        numbers = [_blocks(result)]
    elif isinstance(result, Comparison):
        numbers = [_compared(result), _scatter(result)]
    elif isinstance(result, SensorNoise):
        numbers = [_noise_numbers(result)]
    else:
        numbers = [_numbers(result), *_over_temperature(result)]
    return tuple(table for table in (_stated(result), *numbers, _criteria(result)) if table.rows)


def stated_facts(calibration: Certified) -> list[tuple[str, str]]:
    """Return name and text of what was stated of the sensor and the measurement."""
    options = calibration.provenance.options
    units: dict[str, str] = dict.fromkeys(("temperature_c", "chip_degc"), "\u00a0°C")
    return [(name, options[key] + units.get(key, "")) for key, name in STATED.items() if key in options]


def _stated(calibration: Certified) -> ReportTable:
    return ReportTable("Certificate", ("", ""), stated_facts(calibration), prose=True)


def _numbers(calibration: Calibration) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    note = f"{_EXPANDED} Without U: fixed, or not estimated."
    for where, group in _groups(calibration):
        if rows and len(rows) + len(group.rows) > _MOST:  # a group is shown as a whole
            break
        rows += [
            (f"{where}{_called(group.title, row.name)}", row.value, row.expanded or MISSING, row.unit)
            for row in group.rows
        ]
        note += f" {where}Attitude: {group.note}." if group.title == "Attitude" else ""
    return ReportTable("The numbers that matter", _HEAD, rows, note, dense=True)


def _noise_numbers(noise: SensorNoise) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for sensor, triad in noise.triads.items():
        for kind in ("white_noise", "random_walk"):
            for axis, own in zip("xyz", triad.axes, strict=True):
                found = own.coefficients()[kind]
                value, expanded = f"< {number_text(found.bound, 2)}", MISSING
                if found.found:
                    value, expanded = with_sigma(found.value, 2 * found.sigma)
                name = f"{sensor.capitalize()} {kind.replace('_', ' ')} {axis}"
                rows.append((name, value, expanded, readable_unit(UNITS[sensor][kind])))
    note = f"{_EXPANDED} Without U: not seen, an upper bound (about 97 %)."
    return ReportTable("The numbers that matter", _HEAD, rows, note, dense=True)


def _blocks(verification: Verification) -> ReportTable:
    return ReportTable(
        "Block by block",
        ("block", "moved by (± 1 σ)", f"{verification.use} needs", "z", "state"),
        [tuple(map(readable_unit, movement_words(block))) for block in verification.blocks],
        "By how much the recording finds each block elsewhere if all others hold, but those that moved; U is "
        "twice the ± (k = 2, about 95 %). z: standard deviations of a single number that are as improbable; from "
        f"{verification.certain_z:.1f} on a block moved for certain. Biases are new at each start: their ± includes "
        "what is usual.",
        dense=True,
        stacked=True,
    )


def _compared(comparison: Comparison) -> ReportTable:
    rows = [(one.name, one.format, one.stated_sigmas, one.verdict or MISSING) for one in comparison.calibrations]
    return ReportTable("What was compared", ("name", "format", "standard deviations", "verdict"), rows, prose=True)


def _scatter(comparison: Comparison) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    every = len(comparison.calibrations)
    for block in comparison.blocks:
        (scatter, unit), (predicted, _) = (typical_size(block, values) for values in (block.scatter, block.predicted))
        z_rms = f"{number_text(block.z_rms, 3)} (≤ {number_text(block.limit, 3)})" if isfinite(block.z_rms) else MISSING
        notes = ["not judged"] * (not block.judged) + [f"by {len(block.names)} of {every}"] * (len(block.names) < every)
        notes += [f"held by {', '.join(block.assumed)}"] * bool(block.assumed)
        sizes = (number_text(scatter, 2), number_text(predicted, 2), readable_unit(unit))
        rows.append((block_words(block.path), *sizes, z_rms, ", ".join(notes)))
    return ReportTable(
        "Scatter against predicted sigma",
        ("block", "scatter", "predicted σ", "unit", "z rms", "remark"),
        rows,
        "Scatter: standard deviation over the calibrations, root mean square over the scalars of the block, of a lens "
        "over those in px. z rms: scatter over predicted sigma, scalar by scalar; in brackets what honest sigmas "
        "exceed in one of a hundred comparisons. Biases are new at each start, and not judged.",
        dense=True,
        stacked=True,
        remarked=True,
    )


def _over_temperature(calibration: Calibration) -> Iterator[ReportTable]:
    """Yield, for each IMU that changes with its temperature, the slopes of biases and scales."""
    for name, imu in calibration.imus.items():
        if imu.temperature is None:
            continue
        known, groups = imu.temperature, groups_over_temperature(calibration, name)
        yield ReportTable(
            "Over the temperature" + (f", {name}" if len(calibration.imus) > 1 else ""),
            ("", "slope", "U = 2σ", "unit"),
            [
                (f"{group.title.partition(' over ')[0]} {row.name[-1]}", row.value, row.expanded or MISSING, row.unit)
                for group in groups
                if "g-sensitivity" not in group.title
                for row in group.rows
            ],
            f"At {known.reference_degc:.1f} °C, where the numbers that matter hold; known from {known.low_degc:.1f} to "
            f"{known.high_degc:.1f} °C. All coefficients stand in calibration.yaml.",
            dense=True,
        )


def _called(group: str, name: str) -> str:
    """Return a group of parameters and one of it, "Accelerometer scale x", without saying a word twice."""
    first, _, rest = name.partition(" ")
    return f"{group} {rest}" if rest and group.lower().split()[-1] == first.lower() else f"{group}: {name}"


def _camera_groups(calibration: Calibration) -> Iterator[tuple[str, ParameterGroup]]:
    from ..camera_parameters import camera_groups, lens_groups, pose_groups  # loaded where there are cameras

    cameras, several = calibration.cameras, len(calibration.cameras) > 1
    for name in cameras:
        where = f"{name} " if several else ""
        groups = camera_groups(calibration, name) if calibration.imus else lens_groups(calibration, name)
        shown = ("Translation", "Attitude", "Time")
        yield from ((where, group) for group in groups if not calibration.imus or group.title in shown)
        if not calibration.imus and name != cameras[name].body:
            yield from ((where, group) for group in pose_groups(calibration, name))


def _groups(calibration: Calibration) -> Iterator[tuple[str, ParameterGroup]]:
    """Yield the groups of parameters for page one, and the words before their titles."""
    if calibration.cameras:
        yield from _camera_groups(calibration)
        if not calibration.imus:
            return
    groups = [g for name in calibration.imus for g in imu_groups(calibration, name)] if calibration.cameras else ()
    groups = groups or parameter_groups(calibration)
    for group in sorted(groups, key=lambda group: "Magnetometer" not in group.title):  # the accelerometer serves it
        if group.title.endswith(_MATTERS):
            yield "", group


def _read_aloud(calibration: Calibration, name: str) -> str:
    """Return the name of a scalar in words, "imu0.accelerometer.bias[1]" -> "imu0 accelerometer bias y"."""
    device, _, rest = name.partition(".")
    symbols: dict[str, str] = {}
    if device in calibration.cameras:
        camera = calibration.cameras[device].camera
        symbols = dict(zip(camera.parameter_names, camera.parameter_symbols, strict=True))
    path, _, element = rest.rstrip("]").partition("[")
    axes = "".join("xyz"[int(i)] for i in element.split(",")) if re.fullmatch("[012](,[012])?", element) else element
    words = path.replace("T_cam_imu.", "").replace("g_sensitivity", "g-sensitivity")
    words = re.sub("_(cam_imu|m)$", "", words).replace("_", " ").replace(".", " ")
    return f"{device} {symbols.get(rest) or f'{words} {axes}'.strip()}"


def budget_table(calibration: Calibration) -> ReportTable:
    """Return the uncertainty budget: of each block the least certain scalar, and from which sources its sigma comes."""
    rows: list[tuple[str, ...]] = []
    faint = set[int]()
    for quantity in uncertainty_budget(calibration):
        sigma, expanded = (number_text(size, 2) for size in (quantity.sigma, quantity.expanded))
        unit = "" if quantity.unit == "1" else f"\u00a0{readable_unit(quantity.unit)}"
        rows.append((_read_aloud(calibration, quantity.name), "", f"U\u00a0=\u00a0{expanded}{unit}", "", "", sigma, ""))
        for source in quantity.sources:
            share = source.variance / quantity.sigma**2
            stated = "" if source.unit == "1" else f"\u00a0{readable_unit(source.unit)}"
            faint.add(len(rows))
            rows.append(
                (
                    f"\u2003{source.name}",
                    source.kind,
                    f"{number_text(source.amount, 2)}{stated}",
                    "√3 (rect.)" if source.distribution == "rectangular" else "1 (normal)",
                    number_text(source.sensitivity, 2),
                    number_text(source.variance**0.5, 2),
                    f"{fixed_text(100 * share, 1)}\u00a0%",
                )
            )
    rig = calibration.imus and calibration.cameras
    within = " Noise, and what gravity and detector leave uncertain, are not told apart here." if rig else ""
    return ReportTable(
        BUDGET_TITLE,
        ("quantity, and its sources", "type", "amount", "divisor", "sensitivity", "u", "share"),
        rows,
        "Of each block of parameters the least certain one, after JCGM 100:2008. Type A: by the statistics of the "
        "recording, B: known otherwise. u = |sensitivity| × amount / divisor, in the unit of U; its share is of the "
        "variance. The first line of each has the combined standard uncertainty and U = 2u (k = 2, about 95 %). Errors "
        f"that last: what the scatter between parts of the recording shows beyond independent noise.{within}",
        faint=frozenset(faint),
        dense=True,
    )


def _criteria(calibration: Certified) -> ReportTable:
    criteria = _AGREEMENT if isinstance(calibration, Comparison) else _CRITERIA
    verdict = [name for name, _ in criteria].index(calibration.verdict)
    return ReportTable(
        "What the verdict means",
        ("verdict", "criterion"),
        criteria,
        "Each finding has its limit, listed with the symptoms of the documentation.",
        marked=verdict,
        prose=True,
    )
