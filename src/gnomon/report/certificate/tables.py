"""Page one of every report, the certificate: what was calibrated, the numbers with U = 2 sigma, criteria."""

from collections.abc import Iterator, Mapping

from ...frozen import FrozenMapping
from ...results.calibration import Calibration
from ..camera_parameters import camera_groups, lens_groups, pose_groups
from ..imu_parameters import imu_groups, parameter_groups
from ..numbers import MISSING, fixed_text
from ..page import ParameterGroup, ReportTable

STATED: Mapping[str, str] = FrozenMapping(
    {
        "sensor": "Sensor",
        "serial": "Serial number",
        "date": "Date",
        "operator": "Operator",
        "place": "Place",
        "temperature_c": "Temperature",
    }
)
"""Option that states it -> its name on the certificate. Never the clock: equal inputs and options give equal bytes."""
_MOST = 12
"""Numbers on page one."""
_MATTERS = ("scale", "bias")
"""Ends of the titles of the groups of a triad that stand on page one."""
_CRITERIA = (
    ("pass", "no finding speaks against its use"),
    ("warn", "usable, with the reservations named under What to do"),
    ("fail", "at least one finding says not to use it"),
)


def certificate_tables(calibration: Calibration) -> tuple[ReportTable, ...]:
    """Return the tables of page one; that of the sources of uncertainty where the result tells them."""
    return tuple(
        table
        for table in (_stated(calibration), _numbers(calibration), _budget(calibration), _criteria(calibration))
        if table.rows
    )


def stated_facts(calibration: Calibration) -> list[tuple[str, str]]:
    """Return name and text of what was stated of the sensor and the measurement."""
    options = calibration.provenance.options
    units = {"temperature_c": "\u00a0°C"}
    return [(name, options[key] + units.get(key, "")) for key, name in STATED.items() if key in options]


def _stated(calibration: Calibration) -> ReportTable:
    return ReportTable("Certificate", ("", ""), stated_facts(calibration), prose=True)


def _numbers(calibration: Calibration) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for where, group in _groups(calibration):
        if rows and len(rows) + len(group.rows) > _MOST:  # a group is shown as a whole
            break
        rows += [
            (f"{where}{_called(group.title, row.name)}", row.value, row.expanded or MISSING, row.unit)
            for row in group.rows
        ]
    return ReportTable(
        "The numbers that matter",
        ("", "estimate", "U = 2σ", "unit"),
        rows,
        "U is the expanded uncertainty with coverage factor k = 2 (about 95 %). Without U: fixed, or not estimated.",
        dense=True,
    )


def _called(group: str, name: str) -> str:
    """Return a group of parameters and one of it, "Accelerometer scale x", without saying a word twice."""
    first, _, rest = name.partition(" ")
    return f"{group} {rest}" if rest and group.lower().split()[-1] == first.lower() else f"{group}: {name}"


def _groups(calibration: Calibration) -> Iterator[tuple[str, ParameterGroup]]:
    """Yield the groups of parameters for page one, and the words before their titles."""
    cameras, several = calibration.cameras, len(calibration.cameras) > 1
    for name in cameras:
        where = f"{name} " if several else ""
        groups = camera_groups(calibration, name) if calibration.imus else lens_groups(calibration, name)
        shown = ("Translation", "Attitude", "Time")
        yield from ((where, group) for group in groups if not calibration.imus or group.title in shown)
        if not calibration.imus and name != cameras[name].body:
            yield from ((where, group) for group in pose_groups(calibration, name))
    if cameras and not calibration.imus:
        return
    groups = [g for name in calibration.imus for g in imu_groups(calibration, name)] if cameras else ()
    for group in groups or parameter_groups(calibration):
        if group.title.endswith(_MATTERS):
            yield "", group


def _budget(calibration: Calibration) -> ReportTable:
    """Return which share of the variance of each block is that of independent noise, where that is known."""
    trust = calibration.assessment.trust
    ratios = trust.sigma_ratio if trust.covariance == "cluster-robust" else {}
    rows = [
        (block, f"{fixed_text(100 * share, 1)}\u00a0%", f"{fixed_text(100 * (1 - share), 1)}\u00a0%")
        for block, ratio in ratios.items()
        if ratio > 0
        for share in (min(1.0, ratio**-2),)
    ]
    return ReportTable(
        "Where the uncertainty comes from",
        ("share of the variance", "independent noise", "errors that last"),
        rows[:_MOST],
        "Errors that last: what the scatter between parts of the recording shows beyond independent noise.",
        dense=True,
    )


def _criteria(calibration: Calibration) -> ReportTable:
    verdict = [name for name, _ in _CRITERIA].index(calibration.verdict)
    return ReportTable(
        "What the verdict means",
        ("verdict", "criterion"),
        _CRITERIA,
        "Each finding has its limit, listed with the symptoms of the documentation.",
        marked=verdict,
        prose=True,
    )
