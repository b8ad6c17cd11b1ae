"""What a comparison of calibrations says in words: who agrees, who stands out and in what, and why that may be."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...findings import Finding, join_names, make_finding
from ...frozen import value_class
from ...geometry.rotations import invert_matrix, rotvec_from_rotation
from ...options.requirements import BETWEEN_RECORDINGS, QUANTITIES
from ...recording import Floats, shared_sources
from ...results.trust import Verdict
from ..needs import number_words
from ..verdict import merge_by_cause
from .candidates import ComparisonCandidate, origin_findings
from .comparison import Comparison, Difference, block_words, sigma_text, size_text, standing_out

_INVERSE = 0.1  # share of the distance that is left when one pose is inverted
_ARM_M = 0.1  # what a turn of one radian moves, for adding turns and distances
_SHIFT_S = 1e-3


@value_class
class _Placed:
    """A sensor with its pose: `link` is the name of T, p_sensor = T p_body, `shift` that of its time shift."""

    T: Floats
    shift_s: float
    link: str
    body: str
    shift: str


def pose_findings(candidates: Sequence[ComparisonCandidate]) -> Iterator[Finding]:
    """Recognise poses that are the inverse of each other, and time shifts of opposite sign."""
    for first, second in combinations(candidates, 2):
        ones, others = _placed(first), _placed(second)
        for name in [name for name in ones if name in others]:
            one, other = ones[name], others[name]
            if one.body != other.body:
                continue
            distance = _distance(one.T, other.T)
            if _distance(invert_matrix(one.T), other.T) < _INVERSE * distance:
                yield make_finding(
                    "pose-inverted",
                    link=one.link,
                    sensor=name,
                    first=first.name,
                    second=second.name,
                    other_way=_OTHER_WAY.get(one.link, ""),
                    convention=_POSES.get(one.link, _POSES["T_cam_cam0"]),
                )
            shifts = one.shift_s, other.shift_s
            if min(map(abs, shifts)) > _SHIFT_S and abs(sum(shifts)) < _INVERSE * abs(shifts[0] - shifts[1]):
                yield make_finding(
                    "shift-sign",
                    name=name,
                    first=first.name,
                    second=second.name,
                    first_s=shifts[0],
                    second_s=shifts[1],
                    opposite=_OPPOSITE[one.shift],
                    signs=_SIGNS[one.shift],
                )


def _placed(candidate: ComparisonCandidate) -> dict[str, _Placed]:
    """Return the sensors of a calibration that have a pose: cameras, and IMUs beside imu0."""
    placed = {
        name: _Placed(
            T=imu.T_imu_body, shift_s=imu.time_shift_s, link="T_imu_body", body="imu0", shift="time_shift_imu"
        )
        for name, imu in candidate.imus.items()
        if imu.T_imu_body is not None
    }
    return placed | {
        name: _Placed(
            T=camera.T_cam_body,
            shift_s=camera.time_shift_cam_imu,
            link=camera.link,
            body=camera.body,
            shift="time_shift_cam_imu",
        )
        for name, camera in candidate.cameras.items()
    }


_OPPOSITE = {
    "time_shift_cam_imu": "One of them is t_cam - t_imu.",
    "time_shift_imu": "One of them is t_imu - t_imu0.",
}
_SIGNS = {
    "time_shift_cam_imu": "t_imu = t_cam + time_shift_cam_imu, in gnomon, Kalibr, VINS (td) and Basalt.",
    "time_shift_imu": "t_imu0 = t_imu + time_shift_imu, in gnomon, and as time_offset in Kalibr.",
}
_OTHER_WAY = {"T_cam_imu": ", camera to IMU", "T_imu_body": ", to imu0"}
_POSES = {
    "T_cam_imu": "p_cam = T_cam_imu p_imu. Write the inverse under T_imu_cam, which is read as well.",
    "T_cam_cam0": "p_cam = T_cam_cam0 p_cam0, and from each camera to the next p_cn = T_cn_cnm1 p_cnm1.",
    "T_imu_body": "p_imu = T_imu_body p_imu0, which Kalibr calls T_i_b.",
}


def _distance(first: Floats, second: Floats) -> float:
    """Return how far two poses lie apart, turns and distances added [rad]."""
    angle = float(np.linalg.norm(rotvec_from_rotation(first[:3, :3].T @ second[:3, :3])))
    return angle + float(np.linalg.norm(first[:3, 3] - second[:3, 3])) / _ARM_M


_KALIBRS_SIGMAS = (
    "Kalibr gives every corner 1 px and the IMU its nominal noise: gnomon camera-imu --pixel-sigma 1 --noise nominal "
    "on the same recording states the sigmas of such a result. Add it to the comparison."
)
_MOST = 3  # differences that a sentence names
_FARTHER = 5.0  # times the largest distance between the others, where no sigmas tell
_LENS_PX = 0.5
_GRAVITY = 1e-4  # of it


def with_words(comparison: Comparison, candidates: Sequence[ComparisonCandidate], notes: Sequence[str]) -> Comparison:
    """Return the comparison with who stands out, its findings, its verdict and its headline.

    Parameters
    ----------
    candidates : in the common frame
    notes : sentences on what was restated
    """
    names = [one.name for one in comparison.calibrations]
    beyond = _beyond(comparison)
    conflicts = [
        (first, second, max(item.largest for item in beyond if (item.first, item.second) == (first, second)))
        for first, second in dict.fromkeys((item.first, item.second) for item in beyond)
    ]
    known = [item for item in _judged(comparison) if np.isfinite(item.largest)]
    outside = standing_out(names, conflicts) if known else _far_away(comparison)
    comparison = replace(comparison, outside=outside)
    findings = [
        *_disagreement(comparison, beyond),
        *pose_findings(candidates),
        *_too_much_scatter(comparison),
        *_assumed(comparison),
        *_lenses(comparison),
        *_sensors_in_some(comparison),
        *_gravities(candidates),
        *origin_findings(candidates),
        *_knowledge(comparison),
        *_occasions(comparison),
        *_own_axes(comparison),
        *_biases(comparison),
        *(make_finding("restated", note=note) for note in notes),
    ]
    verdict: Verdict = "pass"
    if any(_certain(comparison, item) for item in beyond):
        verdict = "fail"
    elif beyond or not known or outside or any(one.severity in {"warning", "problem"} for one in findings):
        verdict = "warn"
    return replace(
        comparison,
        findings=merge_by_cause(findings),
        verdict=verdict,
        headline=_headline(comparison, beyond, bool(known)),
    )


def _judged(comparison: Comparison) -> list[Difference]:
    """Return the differences that count: of blocks that both estimated, biases excepted."""
    there = {block.path: block.names for block in comparison.blocks if block.judged}
    return [item for item in comparison.differences if {item.first, item.second} <= {*there.get(item.path, ())}]


def _beyond(comparison: Comparison) -> list[Difference]:
    """Return the judged differences beyond the limit, the largest first."""
    found = [item for item in _judged(comparison) if item.largest > comparison.z_limit]
    return sorted(found, key=lambda item: -item.largest)


def _certain(comparison: Comparison, item: Difference) -> bool:
    """Tell whether the errors of both are known: by their sigmas, or because one is the truth."""
    return item.mutual or bool(_truths(comparison) & {item.first, item.second} and item.basis)


def _truths(comparison: Comparison) -> set[str]:
    return {one.name for one in comparison.calibrations if one.exact}


def _far_away(comparison: Comparison) -> tuple[str, ...]:
    """Return those that lie far from all others, who are close together; for calibrations without sigmas."""
    far: dict[str, float] = {}
    for block in comparison.blocks:
        if not block.judged or len(block.names) < 3:
            continue
        for i, name in enumerate(block.names):
            others = np.delete(block.values, i, axis=0)
            width = max(float(np.linalg.norm(a - b)) for a, b in combinations(others, 2))
            distance = float(np.linalg.norm(others - block.values[i], axis=1).min())
            if distance > _FARTHER * width and distance > 0:
                far[name] = max(far.get(name, 0.0), distance / width if width > 0 else np.inf)
    return tuple(sorted(far, key=lambda name: -far[name]))


def _against_others(comparison: Comparison, name: str) -> list[tuple[float, str]]:
    """Return how one differs from those that do not stand out: (size in sigmas, words), the largest first."""
    found: list[tuple[float, str]] = []
    for block in comparison.blocks:
        others = [i for i, other in enumerate(block.names) if other != name and other not in comparison.outside]
        if not block.judged or name not in block.names or not others:
            continue
        i = block.names.index(name)
        values = block.values[i] - block.values[others].mean(axis=0)
        each = (
            np.where(np.isfinite(block.sigmas), block.sigmas, block.predicted) ** 2
        )  # the yardstick, where not stated
        variance = each[i] + each[others].sum(axis=0) / len(others) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(variance > 0, values / np.sqrt(variance), np.nan)
        largest = float(np.nanmax(np.abs(z))) if np.isfinite(z).any() else np.nan
        text = f"the {block_words(block.path)} by {size_text(block, values, z)}"
        if np.isfinite(largest):
            found.append((largest, f"{text} ({largest:.1f} sigma)"))
        else:
            width = float(np.max(np.ptp(block.values[others], axis=0)))
            found.append((float(np.linalg.norm(values)) / max(width, 1e-300), text))
    return sorted(found, key=lambda item: -item[0])


def _pair_text(comparison: Comparison, items: Sequence[Difference], most: int = _MOST) -> str:
    """Return in what a pair differs, the largest first."""
    parts = [
        f"the {block_words(item.path)} by {size_text(comparison.block(item.path), item.values, item.z)}"
        f" ({sigma_text(item)})"
        for item in items
    ]
    return _first_of(parts, most)


def _outside_text(comparison: Comparison, name: str, most: int = _MOST) -> str:
    limit = comparison.z_limit if np.isfinite(comparison.z_rms) else _FARTHER
    found = [text for size, text in _against_others(comparison, name) if size > limit]
    found = found or [text for _, text in _against_others(comparison, name)[:1]]
    return f"{name} differs in {_first_of(found, most)}"


def _headline(comparison: Comparison, beyond: Sequence[Difference], known: bool) -> str:
    names = [one.name for one in comparison.calibrations]
    inside = [name for name in names if name not in comparison.outside]
    if comparison.outside:
        together = f"{join_names(inside)} agree; " if len(inside) > 1 else ""
        return f"{together}{'; '.join(_outside_text(comparison, name, 1) for name in comparison.outside)}."
    if beyond:
        first, second = beyond[0].first, beyond[0].second
        items = [item for item in beyond if (item.first, item.second) == (first, second)]
        rest = "" if len(names) == 2 else " Nothing tells which of them is right."
        return f"{first} and {second} differ in {_pair_text(comparison, items, 1)}.{rest}"
    if not comparison.blocks:
        worst = max(comparison.lenses, key=lambda lens: lens.largest_px, default=None)
        if worst is None or worst.same:
            return f"{join_names(names)} hold all that they have in common at the same values."
        return (
            f"{join_names(names)} have only lenses in common; the images of {worst.camera} differ by up to "
            f"{worst.largest_px:.2g} px ({worst.turned_rms_px:.2g} px rms after a turn of the camera)."
        )
    if not known:
        stated = any(one.sigmas for one in comparison.calibrations)
        unsure = "no two estimated the same number" if stated else "none states standard deviations"
        return f"{join_names(names)} were compared; {unsure}, so nothing says what differences mean."
    largest = max(item.largest for item in _judged(comparison) if np.isfinite(item.largest))
    return (
        f"{join_names(names)} agree: of {comparison.compared} differences the largest is {largest:.1f} sigma, "
        f"where up to {comparison.z_limit:.1f} is chance."
    )


def _disagreement(comparison: Comparison, beyond: Sequence[Difference]) -> Iterator[Finding]:
    for name in comparison.outside:
        yield make_finding(
            "stands-out",
            severity="problem" if any(_certain(comparison, item) for item in beyond) else "warning",
            outside=_outside_text(comparison, name),
            name=name,
        )
    for first, second in dict.fromkeys((item.first, item.second) for item in beyond):
        if {first, second} & set(comparison.outside):
            continue
        items = [item for item in beyond if (item.first, item.second) == (first, second)]
        yield make_finding(
            "calibrations-differ",
            severity="problem" if any(_certain(comparison, item) for item in items) else "warning",
            first=first,
            second=second,
            pair=_pair_text(comparison, items),
            meaning=_what_it_means(comparison, items),
            how_to_tell=_how_to_tell(comparison, (first, second)),
        )


def _what_it_means(comparison: Comparison, items: Sequence[Difference]) -> str:
    pair = items[0].first, items[0].second
    if truths := _truths(comparison) & {*pair}:
        return f"{join_names(sorted(truths))} is the truth of a simulation: the errors are those of the other one."
    if any(item.mutual for item in items):
        return ""
    return f"Sigmas are those of {join_names(items[0].basis)} alone; what the errors of the other are, nobody knows."


def _how_to_tell(comparison: Comparison, pair: tuple[str, str]) -> str:
    if _truths(comparison) & {*pair}:
        return "Look at its report: what it does not model of the simulated sensor is in its other parameters."
    if _kalibrs(comparison, pair):
        return _KALIBRS_SIGMAS
    return "Record once more and compare all three: with a third calibration the odd one out is named."


def _kalibrs(comparison: Comparison, names: tuple[str, str]) -> bool:
    """Return whether one of a pair is a camera-IMU calibration of Kalibr's, which states no sigmas."""
    pair = [one for one in comparison.calibrations if one.name in names]
    return any("Kalibr, cameras" in one.format or "results-imucam" in one.format for one in pair)


def _too_much_scatter(comparison: Comparison) -> Iterator[Finding]:
    if not comparison.z_rms > comparison.limit or sum(one.sigmas for one in comparison.calibrations) < 2:
        return  # of one alone the differences tell
    worst = max((b for b in comparison.blocks if b.judged and np.isfinite(b.z_rms)), key=lambda b: b.z_rms)
    yield make_finding(
        "scatter-beyond-sigma",
        z_rms=comparison.z_rms,
        limit=comparison.limit,
        block=block_words(worst.path),
        worst_z_rms=worst.z_rms,
    )


def _assumed(comparison: Comparison) -> Iterator[Finding]:
    """Name what one holds at an ideal or a given value, and another finds otherwise."""
    named: dict[str, dict[str, str]] = {}
    for item in sorted(comparison.differences, key=lambda item: -np.nan_to_num(item.largest)):
        block = comparison.block(item.path)
        holding = [name for name in (item.first, item.second) if name in block.assumed]
        if not (block.judged and holding and item.largest > comparison.z_limit):
            continue
        text = f"the {block_words(item.path)} by {size_text(block, item.values, item.z)} ({sigma_text(item)})"
        named.setdefault(holding[0], {}).setdefault(item.path, text)
    for name, texts in named.items():
        yield make_finding(
            "held-elsewhere-found",
            case="lens" if all(comparison.block(path).kind == "lens" for path in texts) else "",
            name=name,
            found=_first_of(list(texts.values())),
        )


def _first_of(texts: Sequence[str], most: int = _MOST) -> str:
    """Return the first texts as a list, and how many more there are."""
    rest = len(texts) - most
    return join_names([*texts[:most], *([f"{rest} more" if rest > 1 else "one more"] if rest > 0 else [])])


def _lenses(comparison: Comparison) -> Iterator[Finding]:
    """Say that lenses differ beyond their sigmas, since the pose of a camera depends on its lens."""
    alone = not any(sensor.startswith("imu") for one in comparison.calibrations for sensor in one.sensors)
    chance = {
        (item.first, item.second, item.path)
        for item in comparison.differences
        if item.mutual and item.largest <= comparison.z_limit
    }
    for lens in comparison.lenses:
        explained = (lens.first, lens.second, f"{lens.camera}.lens") in chance and lens.turned_rms_px <= _LENS_PX
        if lens.rms_px < _LENS_PX / 10 or explained:
            continue
        models = " and ".join(dict.fromkeys(lens.models))
        sizes = (
            ""
            if lens.resolutions[0] == lens.resolutions[1]
            else ("; their resolutions are {}x{} and {}x{}".format(*lens.resolutions[0], *lens.resolutions[1]))
        )
        turn = float(np.degrees(np.linalg.norm(lens.turn)))
        yield make_finding(
            "lenses-differ",
            severity="warning" if lens.turned_rms_px > _LENS_PX else "info",
            case="alone" if alone else "",
            camera=lens.camera,
            first=lens.first,
            second=lens.second,
            models=models,
            rms_px=lens.rms_px,
            turned_rms_px=lens.turned_rms_px,
            turn=turn,
            sizes=sizes,
        )


def _sensors_in_some(comparison: Comparison) -> Iterator[Finding]:
    """Name what is in some of the calibrations only."""
    everything = dict.fromkeys(sensor for one in comparison.calibrations for sensor in one.sensors)
    for sensor in everything:
        there = [one.name for one in comparison.calibrations if sensor in one.sensors]
        if len(there) < len(comparison.calibrations):
            rest = [one.name for one in comparison.calibrations if one.name not in there]
            yield make_finding(
                "only-in-some", sensor=sensor, there=join_names(there), rest=join_names(rest, "or"), missing_in=rest[0]
            )


def _gravities(candidates: Sequence[ComparisonCandidate]) -> Iterator[Finding]:
    """Say that different magnitudes of gravity were assumed."""
    taken = {one.name: one.gravity.value for one in candidates if one.gravity is not None}
    low, high = (choose(taken, key=taken.__getitem__, default="") for choose in (min, max))
    if low and taken[high] - taken[low] > _GRAVITY * taken[high]:
        yield make_finding(
            "gravity-differs",
            low=low,
            low_m_s2=taken[low],
            high=high,
            high_m_s2=taken[high],
            difference=taken[high] / taken[low] - 1,
        )


def _knowledge(comparison: Comparison) -> Iterator[Finding]:
    """Say what the z values rest on."""
    silent = [one.name for one in comparison.calibrations if not (one.sigmas or one.exact)]
    stating = [one.name for one in comparison.calibrations if one.sigmas]
    if silent:
        verb, part = ("states", "it takes") if len(silent) == 1 else ("state", "they take")
        rest = f"z is by the sigmas of {join_names(stating)} alone" if stating else "there is no z at all"
        yield make_finding("sigmas-not-stated", silent=join_names(silent), verb=verb, part=part, rest=rest)
    groups = {
        tuple(other.name for other in comparison.calibrations if shared_sources((source,), other.inputs)): None
        for one in comparison.calibrations
        for source in one.inputs
    }
    for names in groups:
        if len(names) > 1:
            yield make_finding("same-recording", names=join_names(names))


def _own_axes(comparison: Comparison) -> Iterator[Finding]:
    named = [one.name for one in comparison.calibrations if one.frame == "user" and one.verdict]
    if named:
        yield make_finding(
            "user-axes", named=join_names(named), verb="states" if len(named) == 1 else "state", frame=comparison.frame
        )


def _occasions(comparison: Comparison) -> Iterator[Finding]:
    """Say that sigmas of one recording were widened by what a sensor itself changes to the next one."""
    names = [one.name for one in comparison.calibrations if one.one_occasion]
    if names:
        yield make_finding(
            "different-recordings", names=join_names(names), verb="is" if len(names) == 1 else "are", usual=_usual()
        )


def _usual() -> str:
    """Return what is usual of each quantity, in words."""
    return ", ".join(
        f"{QUANTITIES[name].words} {number_words(value / QUANTITIES[name].size)} {QUANTITIES[name].unit}"
        for name, value in BETWEEN_RECORDINGS.items()
    )


def _biases(comparison: Comparison) -> Iterator[Finding]:
    """Report how far biases moved between the recordings."""
    for block in comparison.blocks:
        if block.kind != "bias" or len(block.names) < 2:
            continue
        span = np.ptp(block.values, axis=0)
        if not span.any() or block.z_rms <= block.limit:
            continue
        yield make_finding(
            "bias-instability/compared", block=block_words(block.path), size=size_text(block, span, np.full(3, np.nan))
        )
