"""A calibration judged against what a use needs: a verdict for each quantity, and what to do next."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..findings import Finding, Severity, make_finding
from ..frozen import value_class
from ..options.requirements import (
    BETWEEN_RECORDINGS,
    FIELD_UT,
    GENERAL,
    GENERAL_IMU,
    GENERAL_RIG,
    QUANTITIES,
    TURN_ON,
    Use,
)
from ..recording import Floats
from ..results.calibration import Assessment, Calibration
from ..results.trust import Need
from .changes import change_findings, without_changes
from .directions import Kind, Part, duration_text, motion_advice, one_direction
from .observability import LIMITS, PLACES_AND_CLOCKS, estimated_parts, relative_covariance
from .verdict import grade_value, merge_by_cause, verdict_of, with_verdict

_PRECISION = ("imprecise", "uncertainty-accelerometer", "uncertainty-gyroscope")
"""Findings of the general verdict on standard deviations, in whose place those on a stated use stand."""

_USE = ("use-imprecise", "use-not-estimated", "use-turn-on", "use-verdict")
_DIP = np.radians(60.0)
_KINDS: dict[str, Kind] = {
    "camera_rotation": "rotation",
    "camera_translation": "translation",
    "time_shift": "time_shift",
    "imu_rotation": "rotation",
    "imu_translation": "translation",
    "gyroscope_scale": "gyroscope",
    "gyroscope_misalignment": "gyroscope",
    "gyroscope_g_sensitivity": "g_sensitivity",
    "accelerometer_scale": "accelerometer",
    "accelerometer_misalignment": "accelerometer",
}
_TAKEN_ALONG = 0.5
"""Correlation from which on a bias is as badly known as it is because another part is."""

_PREFIXES = {
    "camera_rotation": ("{}.T_cam_imu.rotation",),
    "camera_translation": ("{}.T_cam_imu.translation",),
    "time_shift": ("{}.time_shift_cam_imu", "{}.time_shift_imu", "{}.time_shift"),
    "imu_rotation": ("{}.T_imu_body.rotation",),
    "imu_translation": ("{}.T_imu_body.translation",),
    "gyroscope_scale": ("{}.gyroscope.sensitivity", "{}.S_g"),
    "gyroscope_misalignment": ("{}.gyroscope.sensitivity", "{}.M_g", "{}.q_bg"),
    "gyroscope_bias": ("{}.gyroscope.bias",),
    "gyroscope_g_sensitivity": ("{}.gyroscope.g_sensitivity", "{}.B_g"),
    "accelerometer_scale": ("{}.accelerometer.sensitivity", "{}.S_a"),
    "accelerometer_misalignment": ("{}.accelerometer.sensitivity", "{}.M_a"),
    "accelerometer_bias": ("{}.accelerometer.bias",),
}
"""Quantity -> beginnings of the names of its scalars, as published or as estimated."""


@value_class
class Achieved:
    """What a calibration offers of a quantity.

    Attributes
    ----------
    quantity, sensor : such as "camera_rotation" of "cam0"
    sigma : largest standard deviation of it [SI]; zero where it was not estimated
    part : directions in which it is known well or badly; None where there are none
    held : whether a prior holds it
    """

    quantity: str
    sensor: str
    sigma: float
    part: Part | None
    held: bool = False

    @property
    def words(self) -> str:
        """What it is, for people."""
        words = QUANTITIES[self.quantity].words
        if "{sensor}" in words or self.sensor == "imu0":
            return words.format(sensor=self.sensor)
        return f"{words} of {self.sensor}"


def achieved_quantities(calibration: Calibration) -> Iterator[Achieved]:
    """Yield what a calibration offers of every quantity that it has.

    Gravity's part is taken off the accelerometer's scale: see `requirements`.
    """
    found = relative_covariance(calibration.imus, calibration.cameras, calibration.uncertainty.matrix)
    column = {name: i for i, name in enumerate(found.names)}
    placed = {name: imu.T_imu_body for name, imu in calibration.imus.items() if imu.T_imu_body is not None}
    turns = {name: camera.T_cam_imu[:3, :3] for name, camera in calibration.cameras.items()}
    turns |= {name: T[:3, :3] for name, T in placed.items()}
    known = {(part.sensor, part.kind): part for part in estimated_parts(found.names, found.covariance, turns)}
    spread = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))

    def offer(quantity: str, sensor: str, sigma: float) -> Achieved:
        held = any(_is_of(name, quantity, sensor) for name in calibration.assessment.held_by_prior)
        kind = _KINDS.get(quantity)
        part = None if kind is None else known.get((sensor, kind))
        if quantity.endswith("_bias"):  # it is told from what changes with motion, where that is known itself
            triad = quantity.removesuffix("_bias")
            at = [column[f"{sensor}.{triad}.bias[{i}]"] for i in range(3)]
            part = _follows(known.values(), found.covariance, max(at, key=lambda i: spread[i]))
        return Achieved(quantity=quantity, sensor=sensor, sigma=sigma, part=part, held=held)

    def largest(names: list[str]) -> float:
        return float(max(spread[column[name]] for name in names))

    for name in calibration.cameras:
        yield offer("camera_rotation", name, largest([f"{name}.T_cam_imu.rotation[{k}]" for k in range(3)]))
        yield offer("camera_translation", name, largest([f"{name}.T_cam_imu.translation[{k}]" for k in range(3)]))
        yield offer("time_shift", name, largest([f"{name}.time_shift_cam_imu"]))
    for name in placed:
        yield offer("imu_rotation", name, largest([f"{name}.T_imu_body.rotation[{k}]" for k in range(3)]))
        yield offer("imu_translation", name, largest([f"{name}.T_imu_body.translation[{k}]" for k in range(3)]))
        yield offer("time_shift", name, largest([f"{name}.time_shift_imu"]))
    for name, imu in calibration.imus.items():
        for triad in ("gyroscope", "accelerometer"):
            sensor = getattr(imu, triad)
            if sensor is None:
                continue
            at = [column[f"{name}.{triad}.sensitivity[{i},{j}]"] for i in range(3) for j in range(3)]
            shared = calibration.gravity.sigma / calibration.gravity.value if triad == "accelerometer" else 0.0
            scale, angle = _scale_and_axes(sensor.sensitivity, found.covariance[np.ix_(at, at)], shared)
            yield offer(f"{triad}_scale", name, scale)
            yield offer(f"{triad}_misalignment", name, angle)
            yield offer(f"{triad}_bias", name, largest([f"{name}.{triad}.bias[{i}]" for i in range(3)]))
        if imu.gyroscope is not None:
            names = [f"{name}.gyroscope.g_sensitivity[{i},{j}]" for i in range(3) for j in range(3)]
            yield offer("gyroscope_g_sensitivity", name, largest(names))
        if imu.magnetometer is not None:
            yield offer("heading", name, _heading(calibration, name))


def _follows(known: Iterable[Part], covariance: Floats, scalar: int) -> Part | None:
    """Return the badly known part whose worst direction takes a scalar along, or None."""
    best, follows = None, _TAKEN_ALONG
    for part in known:
        joint = abs(float(covariance[scalar, part.index] @ part.places[0]))
        own = float(np.sqrt(part.places[0] @ covariance[np.ix_(part.index, part.index)] @ part.places[0]))
        correlation = joint / max(own * float(np.sqrt(covariance[scalar, scalar])), 1e-300)
        if part.sigma[0] > LIMITS[part.kind] and correlation > follows:
            best, follows = part, correlation
    return best


def _is_of(name: str, quantity: str, sensor: str) -> bool:
    """Return whether a scalar, as published or as estimated, belongs to a quantity."""
    path, _, place = name.partition("[")
    if path not in {text.format(sensor) for text in _PREFIXES.get(quantity, ())}:
        return False
    if not path.endswith(".sensitivity") or not place:
        return True
    row, _, column = place.rstrip("]").partition(",")
    return (row == column) == quantity.endswith("_scale")


def _scale_and_axes(sensitivity: Floats, covariance: Floats, shared: float) -> tuple[float, float]:
    """Return the largest relative sigma of a row's length, less what all share, and of its direction [rad].

    What all rows share is gravity's part; where it is not the stated one, as with cameras, which see accelerations too,
    the differences between the rows tell the rest. `covariance` (9, 9) is relative to the rows' lengths.
    """
    rows = sensitivity / np.linalg.norm(sensitivity, axis=1, keepdims=True)
    along = np.zeros((3, 9))
    angle = 0.0
    for i, row in enumerate(rows):
        along[i, 3 * i : 3 * i + 3] = row
        across = np.eye(3) - np.outer(row, row)
        own = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        angle = max(angle, float(np.max(np.diag(across @ own @ across))))
    scales = along @ covariance @ along.T
    apart = np.eye(3) - 1 / 3
    differing = 1.5 * np.diag(apart @ scales @ apart) if shared else np.zeros(3)
    variance = np.maximum(np.diag(scales) - shared**2, differing)
    return float(np.sqrt(max(variance.max(), 0.0))), float(np.sqrt(max(angle, 0.0)))


def _heading(calibration: Calibration, name: str) -> float:
    """Return the largest standard deviation of the heading of a level sensor, over all headings [rad]."""
    magnetometer = calibration.imus[name].magnetometer
    assert magnetometer is not None
    strength = FIELD_UT if magnetometer.field_unit == "uT" else 1.0
    covariance = calibration.covariance(f"{name}.magnetometer.sensitivity", f"{name}.magnetometer.bias")
    inverse = np.linalg.inv(magnetometer.sensitivity)
    worst = 0.0
    for heading in np.radians(np.arange(0, 360, 15)):
        level = np.array([np.cos(heading), -np.sin(heading), 0.0])
        field = strength * (np.cos(_DIP) * level - np.sin(_DIP) * np.array([0.0, 0.0, 1.0]))
        across = np.array([np.sin(heading), np.cos(heading), 0.0]) @ inverse / (strength * np.cos(_DIP))
        row = np.concatenate([np.outer(across, field).ravel(), across])
        worst = max(worst, float(row @ covariance @ row))
    return float(np.sqrt(worst))


def needs_of_use(calibration: Calibration, use: Use) -> tuple[Need, ...]:
    """Return what a use needs of a calibration, quantity by quantity, and whether it is there.

    What was not estimated is left out; see `judge_for_use`.
    """
    return tuple(_need(calibration, offer, use) for offer in _asked(calibration, use) if offer.sigma > 0)


def _asked(calibration: Calibration, use: Use) -> list[Achieved]:
    return [offer for offer in achieved_quantities(calibration) if offer.quantity in use.needs]


_ROUNDING = 1.05
"""A triad's axes have not quite the same scale, by whose mean the scatter between recordings is stated."""
_MEASURE_IT = (
    "Join several recordings of this sensor (gnomon imu A B C): then what it changes between them is measured, and "
    "takes the place of what is usual."
)
_SAME_CONDITIONS = (
    "What the sensor itself changes between recordings is too much: calibrate in its box and at the temperature of the "
    "use; more recordings tell the scatter better."
)


def _need(calibration: Calibration, offer: Achieved, use: Use) -> Need:
    quantity, needed = QUANTITIES[offer.quantity], use.needs[offer.quantity]
    floor = _floor(calibration, offer.quantity, use)
    counted = _within(calibration, offer) if offer.quantity in TURN_ON else float(np.hypot(offer.sigma, floor))
    grade = "problem" if offer.held else grade_value(counted, needed, use.fails_at * needed)
    return Need(
        block=offer.words,
        sigma=_rounded(offer.sigma / quantity.size),
        needed=_rounded(needed / quantity.size),
        unit=quantity.unit,
        verdict="fail" if grade == "problem" else "warn" if grade == "warning" else "pass",
        cure="" if grade == "good" else _cure(calibration, offer, needed),
        floor=_rounded(floor / quantity.size),
    )


def _floor(calibration: Calibration, quantity: str, use: Use) -> float:
    """Return what one recording cannot know of a quantity; nothing where several tell, and for general use."""
    of_several = bool(calibration.assessment.trust.recordings)
    return 0.0 if of_several or use.name == GENERAL else BETWEEN_RECORDINGS.get(quantity, 0.0)


def _within(calibration: Calibration, offer: Achieved) -> float:
    """Return the sigma without what changes from recording to recording, in the next one and in the mean of all."""
    trust = calibration.assessment.trust
    between = trust.between.get(offer.quantity, 0.0) ** 2 * (1 + 1 / max(trust.recordings, 1))
    return float(np.sqrt(max(offer.sigma**2 - _ROUNDING * between, 0.0)))


def _cure(calibration: Calibration, offer: Achieved, needed: float) -> str:
    fit, part = calibration.assessment.camera_imu, offer.part
    if not offer.held and min(offer.sigma, _within(calibration, offer)) < needed:
        return _MEASURE_IT if offer.sigma <= needed else _SAME_CONDITIONS
    if offer.quantity == "heading":
        return "Turn the sensor over the whole sphere, slowly, far from iron."
    if fit is None and (part is None or not one_direction(part)):
        return _more_attitudes(calibration, offer, needed)
    duration_s = float("nan") if fit is None else fit.duration_s
    if part is None:
        more = duration_text(duration_s * ((offer.sigma / needed) ** 2 - 1))
        if offer.quantity == "accelerometer_bias" and not more:
            return "Tilt it so that each axis of the IMU points up, down and level."
        return f"Go on for {more}." if more else "Record for longer, with a quieter or steadier sensor."
    camera = next(iter(calibration.cameras.values()), None)
    wanted = needed * float(part.sigma[0]) / offer.sigma  # a matrix' direction gathers all rows
    return motion_advice(part, wanted, duration_s, None if camera is None else camera.T_cam_imu[:3, :3])


def _rounded(number: float) -> float:
    return float(f"{number:.6g}")


def number_words(number: float) -> str:
    """Return a number for people, such as "0.12" or "168"."""
    return f"{number:.2g}" if abs(number) < 100 else f"{number:.0f}"


def _more_attitudes(calibration: Calibration, offer: Achieved, needed: float) -> str:
    """Say how many more rests would do, where so many can be asked of a person."""
    rests = calibration.assessment.intervals_used
    more = int(np.ceil(rests * ((offer.sigma / needed) ** 2 - 1)))
    if 0 < more <= 100:
        return f"Add {max(5, 5 * -(-more // 5))} attitudes, spread over the sphere, and as many turns between them."
    return "Rest longer in each attitude, in more of them; a quieter sensor may be needed."


def judge_for_use(calibration: Calibration, use: Use | None) -> Calibration:
    """Return a calibration with the verdict for a use; for no special use where None.

    Findings on standard deviations are those on what the use needs; what priors hold is a problem only if the use
    needs it. All other findings stay, and so do parameters and covariance.
    """
    general = _general(calibration)
    if use is None:
        return replace(calibration, assessment=general)
    found = needs_of_use(calibration, use)
    asked = _asked(calibration, use)
    serious = any(offer.held for offer in asked) or any(need.verdict == "fail" for need in found)
    kept = [
        _regraded(f, "problem" if serious else "info")
        for f in without_changes(general.findings, general.trust.changes)
        if f.code not in _PRECISION
    ]
    changed = change_findings(general.trust.changes, use)
    findings = merge_by_cause(
        [
            *kept,
            *changed,
            *_imprecise(found, use),
            *_not_estimated(calibration, asked, use),
            *_turn_on(calibration, asked, use),
        ]
    )
    verdict = verdict_of(findings)
    if verdict != general.verdict:
        findings = merge_by_cause([*findings, _why(general, verdict, use)])
    assessment = replace(
        general,
        verdict=verdict,
        findings=findings,
        trust=replace(general.trust, use=use.name, needs=found),
    )
    return replace(calibration, assessment=assessment)


def _regraded(finding: Finding, severity: Severity) -> Finding:
    """Return what a recording does not determine with another severity, unless a cause was named for it."""
    if finding.code == "rotation-one-axis":
        return replace(finding, severity="info" if severity == "info" else "problem")
    if finding.code != "not-observable" or finding.follows_from:
        return finding
    return replace(finding, severity=severity)


def _imprecise(found: tuple[Need, ...], use: Use) -> Iterator[Finding]:
    """Yield a finding for each next action, on all that asks for it."""
    cures = dict.fromkeys((need.verdict, need.cure) for need in found if need.verdict != "pass")
    for verdict, action in cures:
        parts_of_it = [
            f"the {need.block} to {number_words(need.needed)} {need.unit}, and has {number_words(need.sigma)}"
            f"{_with_floor(need)}"
            for need in found
            if (need.verdict, need.cure) == (verdict, action)
        ]
        yield make_finding(
            "use-imprecise",
            severity="problem" if verdict == "fail" else "warning",
            name=use.name,
            parts_of_it="; ".join(parts_of_it),
            action=action,
        )


def _with_floor(need: Need) -> str:
    """Return what comes on top of a sigma that would do by itself."""
    if not need.floor or need.sigma > need.needed:
        return ""
    both = number_words(float(np.hypot(need.sigma, need.floor)))
    return f", with the {number_words(need.floor)} that one recording cannot know {both}"


def _turn_on(calibration: Calibration, asked: list[Achieved], use: Use) -> Iterator[Finding]:
    """Say which biases are known less well at the next switching-on than a use needs; it has to follow them."""
    trust = calibration.assessment.trust
    parts_of_it: list[str] = []
    for offer in asked:
        usual = trust.between.get(offer.quantity, BETWEEN_RECORDINGS.get(offer.quantity, 0.0))
        if offer.quantity in TURN_ON and offer.sigma > 0 and usual > use.needs[offer.quantity]:
            quantity = QUANTITIES[offer.quantity]
            parts_of_it.append(f"the {offer.words} by {number_words(usual / quantity.size)} {quantity.unit}")
    if parts_of_it:
        source = f"as measured in {trust.recordings} recordings" if trust.recordings else "as is usual"
        yield make_finding("use-turn-on", name=use.name, source=source, parts_of_it=", ".join(parts_of_it))


def _not_estimated(calibration: Calibration, asked: list[Achieved], use: Use) -> Iterator[Finding]:
    missing, severity = [offer.words for offer in asked if not offer.sigma > 0], "info"
    for imu in calibration.imus.values():
        triads = {"gyroscope": imu.gyroscope, "accelerometer": imu.accelerometer}
        absent = tuple(f"{name}_" for name, triad in triads.items() if triad is None)
        if len(absent) == 1 and use.name != GENERAL:  # of a magnetometer alone, nothing inertial is expected
            unrecorded = [QUANTITIES[quantity].words for quantity in use.needs if quantity.startswith(absent)]
            missing, severity = [*missing, *unrecorded], "warning" if unrecorded else severity
    if missing:
        yield make_finding("use-not-estimated", severity=severity, name=use.name, missing=", the ".join(missing))


def _why(general: Assessment, verdict: str, use: Use) -> Finding:
    """Say in one sentence why the verdict for a use is not the general one."""
    reason = (
        f"{use.name} needs more than general use does, as said for each quantity"
        if _rank(verdict) > _rank(general.verdict)
        else f"what general use asks beyond that is not needed for {use.name}"
    )
    return make_finding("use-verdict", name=use.name, verdict=verdict, general=general.verdict, reason=reason)


def _rank(verdict: str) -> int:
    return ("pass", "warn", "fail").index(verdict)


def _general(calibration: Calibration) -> Assessment:
    """Return the assessment for no special use, also of a calibration that was judged for one."""
    assessment = calibration.assessment
    if not assessment.trust.use:
        return assessment
    held = assessment.held_by_prior
    vital = not calibration.cameras or any(part in name for name in held for part in PLACES_AND_CLOCKS)
    kept = [
        _regraded(finding, "problem" if vital else "warning")
        for finding in without_changes(assessment.findings, assessment.trust.changes)
        if finding.code not in _USE
    ]
    kept += change_findings(assessment.trust.changes, None)
    assessment = replace(assessment, trust=replace(assessment.trust, use="", needs=()))
    return with_verdict(assessment, [*kept, *general_precision(calibration)])


def with_precision(calibration: Calibration) -> Calibration:
    """Return a calibration whose verdict counts what is known worse than general use asks."""
    findings = [*calibration.assessment.findings, *general_precision(calibration)]
    return replace(calibration, assessment=with_verdict(calibration.assessment, findings))


def general_precision(calibration: Calibration) -> Iterator[Finding]:
    """Yield what is known worse than general use asks."""
    for need in needs_of_use(calibration, GENERAL_RIG if calibration.cameras else GENERAL_IMU):
        if need.verdict != "pass":
            yield make_finding(
                "imprecise/general",
                severity="problem" if need.verdict == "fail" else "warning",
                block=need.block,
                sigma=number_words(need.sigma),
                unit=need.unit,
                cure=need.cure,
            )
