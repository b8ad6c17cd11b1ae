"""Several recordings of one sensor: whether it is one sensor, what stands out, and what they say together."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import isfinite, nan

import numpy as np

from ...errors import RecordingError
from ...estimate.trust.between_recordings import RecordingBlock, join_estimates
from ...findings import Finding, Severity, list_first, make_finding
from ...frozen import value_class
from ...options.requirements import BETWEEN_RECORDINGS, QUANTITIES
from ...recording import Floats
from ...results.calibration import Assessment, Calibration, Holdout
from ...results.result import Result
from ...results.sensors import calibration_parameters
from ...results.trust import UncertaintySummary
from ..comparison.comparison import standing_out
from ..needs import general_precision, number_words
from ..verdict import with_verdict

_OTHER: Mapping[str, float] = {
    "accelerometer_scale": 1e-2,
    "gyroscope_scale": 1e-2,
    "accelerometer_misalignment": 1e-2,
    "gyroscope_misalignment": 1e-2,
}
"""Differences that no sensor has with itself, and two of one type mostly have: data sheets state 1 to 3 % for scales
and 1 to 2 % for axes; 40 K change a scale by 1 %."""
_SURE = 6.0
"""Standard deviations from which on a difference is one."""
_STRANGE, _STRANGE_SIGMAS = 6.0, 4.0
"""Times what is usual, and standard deviations, from which on a recording stands out."""
_FEWEST_TO_JUDGE = 3
_MOST_NAMED = 3
_REPLACED = ("imprecise", "uncertainty-accelerometer", "uncertainty-gyroscope", "gravity")


@value_class
class Scalars:
    """The scalars of several calibrations of one sensor, in SI units; of one in counts relative to its scale.

    Attributes
    ----------
    names : (n,)
    quantity : (n,) to which each belongs, such as "accelerometer_scale"
    factor : (n,) by which each was multiplied
    estimated : (n,) bool
    values : (k, n)
    covariances : (k, n, n) without the error of gravity, which all share
    gravity : (n, n) that part
    """

    names: tuple[str, ...]
    quantity: tuple[str, ...]
    factor: Floats
    estimated: np.ndarray
    values: Floats
    covariances: Floats
    gravity: Floats

    def blocks(self) -> list[RecordingBlock]:
        """Return the quantities of which anything was estimated, as places among the estimated scalars."""
        kept = [quantity for quantity, flag in zip(self.quantity, self.estimated, strict=True) if flag]
        return [
            RecordingBlock(
                index=np.flatnonzero([other == quantity for other in kept]).astype(np.int64),
                usual=BETWEEN_RECORDINGS[quantity],
            )
            for quantity in dict.fromkeys(kept)
        ]

    def foretold(self) -> Floats:
        """Return how far each recording is from what the others foretell, in standard deviations (k, n)."""
        z = np.full(self.values.shape, nan)
        at = np.flatnonzero(self.estimated)
        for i in range(len(self.values) if len(self.values) >= _FEWEST_TO_JUDGE else 0):
            others = np.arange(len(self.values)) != i
            rest = join_estimates(
                self.values[others][:, at], self.covariances[others][:, at[:, None], at], self.blocks()
            )
            variance = np.diag(rest.covariance) + np.diagonal(self.covariances[i])[at]
            z[i, at] = (self.values[i, at] - rest.mean) / np.sqrt(variance)
        return z


def quantities_of(calibration: Calibration) -> tuple[str, ...]:
    """Return to which quantity each scalar of an IMU belongs; an entry is a scale where it is most of its row."""
    found: list[str] = []
    for path, value in calibration_parameters(calibration.imus):
        triad, kind = path.split(".")[1:]
        if kind != "sensitivity":
            found += [f"{triad}_{kind}"] * value.size
            continue
        along = np.abs(value) > np.linalg.norm(value, axis=1, keepdims=True) / 2
        found += [f"{triad}_{'scale' if flag else 'misalignment'}" for flag in along.ravel()]
    return tuple(found)


def refuse_other_sensors(scalars: Scalars, names: Sequence[str]) -> None:
    """Refuse recordings of different sensors, by scales and axes that no one sensor has.

    Raises
    ------
    RecordingError
        If there are any; the message names them and in what they differ.
    """
    conflicts: dict[tuple[int, int], tuple[float, str]] = {}
    for i, j in combinations(range(len(names)), 2):
        for size, z, at in _differences(scalars, i, j):
            if size > _OTHER[scalars.quantity[at]] and z > _SURE:
                words = f"{_place_words(scalars, at)} by {_amount(scalars.quantity[at], size)} ({z:.0f} sigma)"
                conflicts[i, j] = max(conflicts.get((i, j), (0.0, "")), (z, words))
    if not conflicts:
        return
    order = [(names[i], names[j], z) for (i, j), (z, _) in conflicts.items()]
    outside = standing_out(list(names), order)
    (i, j), (_, words) = max(conflicts.items(), key=lambda item: item[1][0])
    who = f"{', '.join(outside)} against the others" if outside else f"{names[j]} against {names[i]}"
    raise RecordingError(
        f"these recordings are not of one sensor with one setting: {who}; {names[i]} and {names[j]} differ most, in "
        f"the {words}. One sensor differs from recording to recording by about "
        f"{_amount('accelerometer_scale', BETWEEN_RECORDINGS['accelerometer_scale'])}. Calibrate "
        f"{', '.join(outside) or 'each'} alone, or leave it out."
    )


def _differences(scalars: Scalars, i: int, j: int) -> Iterator[tuple[float, float, int]]:
    """Yield size, standard deviations and place of the differences of two recordings in scales and axes."""
    variance = np.diag(scalars.covariances[i]) + np.diag(scalars.covariances[j])
    for at in np.flatnonzero(scalars.estimated):
        if scalars.quantity[at] in _OTHER:
            size = abs(float(scalars.values[i, at] - scalars.values[j, at]))
            yield size, size / float(np.sqrt(variance[at])), int(at)


def _place_words(scalars: Scalars, at: int) -> str:
    quantity = QUANTITIES[scalars.quantity[at]].words
    return f"{quantity} {'xyz'[int(scalars.names[at].partition('[')[2][0])]}"


def _amount(quantity: str, value: float) -> str:
    unit = QUANTITIES[quantity]
    return f"{number_words(value / unit.size)} {unit.unit}"


def joined_assessment(
    calibration: Calibration, results: Sequence[Result], names: Sequence[str], scalars: Scalars, between: Floats
) -> Assessment:
    """Judge the calibration of one sensor from several recordings.

    Parameters
    ----------
    calibration : the joined one, its assessment not yet made
    results, names : of the recordings one by one
    between : (n,) scatter from recording to recording
    """
    each = [result.calibration.assessment for result in results]
    scatter = {
        quantity: float(between[np.array(scalars.quantity) == quantity].max())
        for quantity in dict.fromkeys(scalars.quantity)
    }
    scatter = {quantity: value for quantity, value in scatter.items() if value > 0}
    held = dict.fromkeys(name for one in each for name in one.held_by_prior)
    assessment = Assessment(
        verdict="pass",
        findings=(),
        model=each[0].model,
        holdout=Holdout(
            accelerometer_rms=_pooled([(one.holdout.accelerometer_rms, one.intervals_used) for one in each]),
            rotation_rms=_pooled([(one.holdout.rotation_rms, one.rotations_used) for one in each]),
        ),
        intervals_found=sum(one.intervals_found for one in each),
        intervals_used=sum(one.intervals_used for one in each),
        rotations_found=sum(one.rotations_found for one in each),
        rotations_used=sum(one.rotations_used for one in each),
        held_by_prior=tuple(held),
        trust=UncertaintySummary(
            covariance="between-recordings",
            recordings=len(each),
            between=scatter,
            changes=tuple(
                replace(change, where=f"{name}, {change.where}")
                for name, one in zip(names, each, strict=True)
                for change in one.trust.changes
            ),
        ),
    )
    findings = [
        *_of_each(each, names),
        *standing_out_findings(scalars, names),
        *general_precision(replace(calibration, assessment=assessment)),
        _joined(scatter, names),
    ]
    return with_verdict(assessment, findings)


def _pooled(parts: Sequence[tuple[float, int]]) -> float:
    known = [(value, count) for value, count in parts if isfinite(value) and count]
    total = sum(count for _, count in known)
    return float(np.sqrt(sum(count * value**2 for value, count in known) / total)) if total else nan


def _of_each(each: Sequence[Assessment], names: Sequence[str]) -> Iterator[Finding]:
    """Yield what was noticed in the recordings, once for each code and severity; precision is judged of all."""
    found: dict[tuple[Severity, str], list[tuple[str, Finding]]] = {}
    for name, assessment in zip(names, each, strict=True):
        for finding in assessment.findings:
            if finding.severity != "good" and finding.code not in _REPLACED:
                found.setdefault((finding.severity, finding.code), []).append((name, finding))
    for same in found.values():
        first = same[0][1]
        of = list(dict.fromkeys(name for name, _ in same))
        if len(of) < len(names) or len({finding.message for _, finding in same}) > 1:
            too = f" The like, with other numbers, in {list_first(of[1:], _MOST_NAMED)}." if len(of) > 1 else ""
            first = replace(first, message=f"{of[0]}: {first.message}{too}")
        yield first


def standing_out_findings(scalars: Scalars, names: Sequence[str]) -> Iterator[Finding]:
    """Yield a warning on each recording whose scales or axes the others do not foretell."""
    usual = np.array([BETWEEN_RECORDINGS[quantity] for quantity in scalars.quantity])
    shape = np.array([quantity in _OTHER for quantity in scalars.quantity])
    if len(names) < _FEWEST_TO_JUDGE:
        yield from _two_differ(scalars, names, usual, shape)
        return
    z = scalars.foretold()
    for i, name in enumerate(names):
        others = np.delete(scalars.values, i, axis=0).mean(axis=0)
        size = np.abs(scalars.values[i] - others)
        strange = shape & (size > _STRANGE * usual) & (np.abs(z[i]) > _STRANGE_SIGMAS)
        if strange.any():
            at = int(np.argmax(np.where(strange, np.abs(z[i]), 0.0)))
            yield make_finding(
                "recording-stands-out/one",
                name=name,
                place=_place_words(scalars, at),
                amount=_amount(scalars.quantity[at], float(size[at])),
                z=abs(z[i, at]),
            )


def _two_differ(scalars: Scalars, names: Sequence[str], usual: Floats, shape: np.ndarray) -> Iterator[Finding]:
    """Yield a warning where two recordings differ by more than one sensor does, by what is usual."""
    size = np.abs(scalars.values[0] - scalars.values[1])
    variance = np.diagonal(scalars.covariances, axis1=1, axis2=2).sum(axis=0) + 2 * usual**2
    z = size / np.sqrt(variance)
    strange = shape & scalars.estimated & (size > _STRANGE * usual) & (z > _STRANGE_SIGMAS)
    if strange.any():
        at = int(np.argmax(np.where(strange, z, 0.0)))
        yield make_finding(
            "recording-stands-out/two",
            first=names[0],
            second=names[1],
            place=_place_words(scalars, at),
            amount=_amount(scalars.quantity[at], float(size[at])),
            z=z[at],
        )


def _joined(scatter: Mapping[str, float], names: Sequence[str]) -> Finding:
    words = ", ".join(f"{QUANTITIES[quantity].words} {_amount(quantity, value)}" for quantity, value in scatter.items())
    return make_finding("recordings-joined", count=len(names), words=words)
