"""Does a calibration still hold? What an estimate from another recording says of each block of it.

The calibration c0 (covariance C0) is held against an estimate c of the same numbers from a fresh recording (C), with
V = C0 + C. If one block b alone moved, by delta, then c - c0 = E_b delta + errors, and

    delta = (E_b' V^-1 E_b)^-1 E_b' V^-1 (c - c0),    T = delta' E_b' V^-1 (c - c0)

T is Rao's score statistic of the block (Rao 1948) in the linearised problem, from which path and biases have been
eliminated: it follows chi^2 with as many degrees of freedom as the block has numbers. The block with the least
probability is freed, and the others are asked again with it, until none is certain; each look counts (Bonferroni).

Where the fresh estimate was helped by a wide prior (mean c0, covariance P), its share is taken out again: in axes in
which C is diagonal and P the identity, with variances l, the recording alone says (c - c0) / (1 - l), of variance
l / (1 - l).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from math import exp, floor, lgamma, log, log10, pi, sqrt
from statistics import NormalDist
from typing import Literal

import numpy as np

from ...estimate.trust.changes import chi_square_tail
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...options.requirements import BETWEEN_RECORDINGS, FIELD_UT, TURN_ON, Use
from ...recording import Floats, frozen_array
from ...results.calibration import ImuCalibration, Provenance
from ...results.trust import QuantityChange, Verdict
from ..changes import OF_HEADING, lens_movement, needed_of, told_with_cure, unit_of_quantity
from ..verdict import merge_by_cause, verdict_of
from .candidates import ComparisonCandidate, at_common_origins, in_common_frame
from .comparing import shares_gravity, subtract_quantity
from .comparison import block_words
from .quantities import ComparedQuantity, Statement, statement_of

State = Literal["holds", "moved", "cannot tell"]
BlockState = Literal["holds", "moved", "moved, within need", "cannot tell"]

_CHANCE = 0.01
"""Share of calibrations that hold and are said to have moved."""
_MATTERS = 0.25  # of what is needed; less is told, and the block holds
_SEEN = 3.0  # sigmas from which on a change of one block is likely to be seen
_UNDERFLOWS = 500.0  # less than exp(-500) is told by what probabilities of chi^2 are asymptotically
_UNTOLD = 1e-4  # share of a direction that the recording tells, of what the wide prior does

_HEADLINES: Mapping[State, str] = {
    "moved": "the calibration has moved: {blocks}",
    "holds": "the calibration still holds for {use}, as far as this recording tells",
    "cannot tell": "this recording cannot tell whether the calibration still holds",
}
_WITHIN = "{headline}; moved, but by less than a quarter of what that needs: {blocks}"
_INCOMPLETE = (
    "The corners of the fresh recording err in ways that no model here explains, which a lens takes up differently "
    "each time: lenses are not judged."
)
_EXACT = "{name} states no standard deviations: its numbers count as exact, and their own errors as movement."
_QUANTITIES: Mapping[str, str] = {
    "scale": "{triad}_scale",
    "misalignment": "{triad}_misalignment",
    "g-sensitivity": "gyroscope_g_sensitivity",
    "bias": "{triad}_bias",
    "translation": "{place}_translation",
    "time shift": "time_shift",
    "line delay": "time_shift",
    "lens": "lens",
}


@value_class
class VerifiedBlock:
    """A block of a calibration, and what a fresh recording says of it.

    Attributes
    ----------
    path, words : of the block, such as "cam0.translation"
    state : "moved" for certain, by more than a quarter of what is needed, or "moved, within need"; "cannot tell": a
        change as large as what is needed would not have been seen; else "holds"
    values, sigma : (k,) by how much the fresh recording finds it elsewhere, the blocks that moved allowed for, and
        standard deviations [unit of the block]
    log_probability : natural logarithm of that of an estimate so far off, or farther, if the block held
    change : the same in the unit of the need; `where` is the element that moved most, such as "x"
    needed : what the use needs of it [SI, px]; 0 where it does not ask
    """

    path: str
    words: str
    state: BlockState
    values: Floats
    sigma: Floats
    log_probability: float
    change: QuantityChange
    needed: float

    @property
    def z(self) -> float:
        """How many standard deviations of a single number are as improbable."""
        log_p = self.log_probability - log(2)
        if log_p > -_UNDERFLOWS:
            return max(0.0, -NormalDist().inv_cdf(exp(log_p)))
        z = sqrt(-2 * log_p)
        for _ in range(5):  # Abramowitz and Stegun 26.2.12
            z = sqrt(-2 * (log_p + 0.5 * log(2 * pi) + log(z) + 1 / z**2))
        return z


@value_class
class Verification:
    """Whether a calibration still holds.

    Attributes
    ----------
    state : of all: "moved" if any block has, by more than a use hardly feels; "cannot tell" if no block could be judged
    blocks : in the order of a calibration file
    use : what the calibration is for, or "general use"
    findings, verdict, headline : as of a calibration
    notes : what was taken for what was not stated
    provenance : the fresh recording, and what was stated for a certificate
    """

    state: State
    blocks: tuple[VerifiedBlock, ...]
    use: str
    findings: tuple[Finding, ...]
    verdict: Verdict
    headline: str
    notes: tuple[str, ...] = ()
    provenance: Provenance = field(default_factory=lambda: Provenance(method="verify"))

    @property
    def moved(self) -> tuple[VerifiedBlock, ...]:
        """Blocks that moved, whether the use feels it or not, the most certain first."""
        return _by_certainty(self.blocks, "moved", "moved, within need")

    @property
    def certain_z(self) -> float:
        """From which z on a block counts as moved: one of a hundred calibrations that hold has such a block."""
        return -NormalDist().inv_cdf(0.5 * _CHANCE / max(len(self.blocks), 1))


def _by_certainty(blocks: Sequence[VerifiedBlock], *states: BlockState) -> tuple[VerifiedBlock, ...]:
    return tuple(sorted((one for one in blocks if one.state in states), key=lambda block: block.log_probability))


@value_class
class _Movement:
    """Differences (n,) of all blocks, the inverse of their covariance, and where each block stands."""

    values: Floats
    weight: Floats
    rows: Mapping[str, slice]

    def freed(self, paths: Sequence[str]) -> tuple[Floats, Floats, float]:
        """Return by how much blocks moved if all others hold, the covariance of that, and by how much T grows."""
        at = np.concatenate([np.arange(self.rows[path].start, self.rows[path].stop) for path in paths])
        information, pull = self.weight[np.ix_(at, at)], self.weight[at] @ self.values
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        moved = covariance @ pull
        return moved, covariance, float(moved @ pull)


def verify_candidate(
    frozen: ComparisonCandidate,
    fresh: ComparisonCandidate,
    use: Use | None = None,
    wide: ComparisonCandidate | None = None,
    noticed: Sequence[Finding] = (),
) -> Verification:
    """Tell which blocks of a calibration a fresh estimate contradicts.

    Parameters
    ----------
    frozen : the calibration that is verified
    fresh : the estimate from a fresh recording
    use : what the calibration is for
    wide : the prior by which the fresh estimate was helped; its values are those of `frozen`
    noticed : what the fresh recording shows of itself: where its model leaves errors of the corners unexplained, a lens
        takes them up otherwise in each recording, beyond its sigmas, and is not judged; where it warns, nothing holds
    """
    if fresh.verdict == "fail":
        return _untold(use)
    given = [frozen, fresh] if wide is None else [frozen, fresh, wide]
    given = at_common_origins([in_common_frame(one) for one in given])
    known, found = (statement_of(one) for one in given[:2])
    incomplete = any(finding.code == "model-incomplete" for finding in noticed)
    paths = [
        path
        for path, one in found.quantities.items()
        if _comparable(known, one) and not (incomplete and one.kind == "lens")
    ]
    helped = None
    if wide is not None and (prior := given[2].covariance) is not None:
        helped = replace(known, covariance=known.jacobian @ prior.matrix @ known.jacobian.T)
    movement = _movement(known, found, paths, helped, same_gravity=shares_gravity(frozen, fresh))
    certain = _certain(movement)
    blocks: list[VerifiedBlock] = []
    for path in paths:
        quantity = known.quantities[path]
        values, covariance, log_p = _of_block(path, movement, certain)
        change, seen = _in_unit_of_need(quantity, values, covariance, known, frozen)
        needed = 0.0 if change.quantity in TURN_ON else needed_of(change, use)  # counted beyond what is usual alone
        moved: BlockState = "moved" if not needed or change.size > _MATTERS * needed else "moved, within need"
        blocks.append(
            VerifiedBlock(
                path=path,
                words=block_words(path),
                state=moved if path in certain else "cannot tell" if needed and seen > needed else "holds",
                values=frozen_array(values),
                sigma=frozen_array(np.sqrt(np.diag(covariance))),
                log_probability=log_p,
                change=change,
                needed=needed,
            )
        )
    notes = [_INCOMPLETE] if incomplete and frozen.cameras else []
    if frozen.covariance is None:
        notes.append(_EXACT.format(name=frozen.name))
    return _judged(tuple(blocks), use, tuple(notes), noticed)


def _comparable(known: Statement, one: ComparedQuantity) -> bool:
    """Tell whether the calibration states a block as the recording does, which estimated it with its sigmas."""
    other = known.quantities.get(one.path)
    return (
        one.estimated
        and one.kind != "lever arms"  # follow from the place of the IMU, which is compared
        and other is not None
        and other.unit == one.unit
        and other.elements == one.elements
    )


def _movement(
    known: Statement, found: Statement, paths: Sequence[str], wide: Statement | None, *, same_gravity: bool
) -> _Movement:
    rows: dict[str, slice] = {}
    count = 0
    for path in paths:
        rows[path] = slice(count, count + len(found.quantities[path].elements))
        count = rows[path].stop
    values = np.concatenate([subtract_quantity(found.quantities[path], known.quantities[path]) for path in paths])
    own = _part(found, paths)
    pull = np.concatenate([found.by_gravity[found.quantities[path].rows] for path in paths])
    if wide is not None:  # which helped a fit in which gravity was held
        values, own = _without_prior(values, _without_gravity(own, pull), _part(wide, paths))
        own = own + np.outer(pull, pull)
    held = np.zeros_like(own) if known.covariance is None else _part(known, paths)
    if same_gravity:  # the same error is in both
        own, held = _without_gravity(own, pull), _without_gravity(held, pull)
    covariance = own + held
    for path in paths:  # biases are others after each switching-on
        one = found.quantities[path]
        usual = BETWEEN_RECORDINGS.get(_quantity_of(one), 0.0) if one.kind == "bias" else 0.0
        scale = found.quantities.get(f"{path.rpartition('.')[0]}.scale")
        size = 1.0 if scale is None else float(np.cbrt(abs(np.prod(scale.values))))
        at = np.arange(rows[path].start, rows[path].stop)
        covariance[at, at] += 2 * (usual * size) ** 2
    weight = np.asarray(np.linalg.inv(covariance + 1e-12 * np.diag(np.diag(covariance))), dtype=np.float64)
    return _Movement(values=values, weight=weight, rows=rows)


def _part(statement: Statement, paths: Sequence[str]) -> Floats:
    """Return the covariance of some blocks; what is not stated counts as exact."""
    assert statement.covariance is not None
    at = np.concatenate(
        [np.arange(statement.quantities[path].rows.start, statement.quantities[path].rows.stop) for path in paths]
    )
    return np.nan_to_num(statement.covariance[np.ix_(at, at)])


def _without_gravity(covariance: Floats, pull: Floats) -> Floats:
    """Return a covariance without the error that gravity makes, at least as large as none in any direction.

    Parameters
    ----------
    covariance : (n, n); what counts as exact has zeros, and keeps them
    pull : (n,) by how much one sigma of gravity changes each number
    """
    without = np.zeros_like(covariance)
    told = np.flatnonzero(np.diag(covariance) > 0)
    among = np.ix_(told, told)
    size = np.sqrt(np.diag(covariance)[told])
    spread, axes = np.linalg.eigh((covariance - np.outer(pull, pull))[among] / np.outer(size, size))
    without[among] = (axes * np.maximum(spread, 1e-9)) @ axes.T * np.outer(size, size)
    return without


def _without_prior(values: Floats, own: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """Return the differences and their covariance as the recording alone tells them."""
    silent = np.flatnonzero(np.diag(prior) <= 0)  # of which the prior says nothing
    prior[silent, silent] = 1e6 * np.diag(own)[silent]
    root = np.linalg.cholesky(prior)
    inverse = np.linalg.inv(root)
    size, axes = np.linalg.eigh(inverse @ own @ inverse.T)
    told, back = np.maximum(1 - size, _UNTOLD), root @ axes
    return back @ ((axes.T @ inverse @ values) / told), (back * (np.minimum(size, 1.0) / told)) @ back.T


def _certain(movement: _Movement) -> dict[str, float]:
    """Return the blocks that moved for certain, and the logarithm of the probability of that if they held."""
    found: dict[str, float] = {}
    explained = 0.0
    while len(found) < len(movement.rows):
        best, least, reach = "", np.inf, 0.0
        for path, rows in movement.rows.items():
            if path not in found:
                _, _, total = movement.freed([*found, path])
                log_p = _log_tail(total - explained, rows.stop - rows.start)
                if log_p < least:
                    best, least, reach = path, log_p, total
        if least > np.log(_CHANCE / len(movement.rows)):
            break
        found[best], explained = least, reach
    return found


def _log_tail(value: float, freedom: int) -> float:
    """Return the logarithm of the probability of a larger value of chi^2, also of what underflows."""
    half, x = freedom / 2, max(value, 0.0) / 2
    if x < _UNDERFLOWS:
        return log(chi_square_tail(2 * x, freedom))
    return (half - 1) * log(x) - x - lgamma(half)  # Abramowitz and Stegun 6.5.32


def _of_block(path: str, movement: _Movement, certain: Mapping[str, float]) -> tuple[Floats, Floats, float]:
    """Return a block's movement beside those that are certain, its covariance, and its log probability if it held."""
    beside = [other for other in certain if other != path]
    values, covariance, reach = movement.freed([path, *beside])
    count = movement.rows[path].stop - movement.rows[path].start
    log_p = certain.get(path)
    if log_p is None:
        log_p = _log_tail(reach - (movement.freed(beside)[2] if beside else 0.0), count)
    return values[:count], covariance[:count, :count], log_p


def _quantity_of(quantity: ComparedQuantity) -> str:
    """Return what a use calls a block."""
    sensor, _, triad = quantity.path.rpartition(".")[0].partition(".")
    place = "imu" if sensor.startswith("imu") else "camera"
    if quantity.kind == "rotation":
        name = f"{triad}_misalignment" if triad in {"gyroscope", "magnetometer"} else f"{place}_rotation"
    else:
        name = _QUANTITIES[quantity.kind].format(triad=triad, place=place)
    return "heading" if name.startswith("magnetometer") else name


def _in_unit_of_need(
    quantity: ComparedQuantity, values: Floats, covariance: Floats, known: Statement, frozen: ComparisonCandidate
) -> tuple[QuantityChange, float]:
    """Return a movement in the unit of the need, and how large one must be to be seen whatever its direction."""
    name = _quantity_of(quantity)
    sensor, _, rest = quantity.path.partition(".")
    where = ""
    if name == "lens":
        size, sigma, spread = lens_movement(frozen.all_lenses[sensor], values, covariance, turned=not frozen.imus)
    else:
        scale = known.quantities.get(f"{sensor}.{rest.partition('.')[0]}.scale")
        by = np.ones(len(values))
        if quantity.kind in {"scale", "bias", "g-sensitivity"} and scale is not None:
            by = 1 / np.repeat(np.abs(scale.values), len(values) // 3)
        if name == "heading":
            by = by * (OF_HEADING / (_field(frozen.imus[sensor]) if quantity.kind == "bias" else 1.0))
        moved, shared = by * values, covariance * np.outer(by, by)
        where = quantity.elements[int(np.argmax(np.abs(moved)))]
        if quantity.kind in {"scale", "g-sensitivity"}:  # needs are of single numbers
            worst = int(np.argmax(np.abs(moved)))
            size, sigma = float(abs(moved[worst])), float(np.sqrt(shared[worst, worst]))
            spread = float(np.sqrt(np.diag(shared).max()))
        else:
            size = float(np.linalg.norm(moved))
            way = moved / max(size, 1e-300)
            sigma = float(np.sqrt(way @ shared @ way))
            spread = float(np.sqrt(np.linalg.eigvalsh(shared)[-1]))
    change = QuantityChange(
        block=quantity.path, quantity=name, sensor=sensor, size=size, sigma=sigma, where=where, at_s=None
    )
    return change, _SEEN * spread


def _field(imu: ImuCalibration) -> float:
    """Return the strength of the field in the unit in which a magnetometer's calibration states it."""
    assert imu.magnetometer is not None
    return FIELD_UT if imu.magnetometer.field_unit == "uT" else 1.0


def movement_words(block: VerifiedBlock) -> tuple[str, str, str, str, str]:
    """Return a block for a table: its name, by how much it moved, what is needed, z, and its state."""
    unit, size = unit_of_quantity(block.change.quantity)
    digits = max(0, 1 - floor(log10(max(block.change.sigma / size, 1e-12))))
    moved = f"{block.change.size / size:.{digits}f} ± {block.change.sigma / size:.{digits}f} {unit}"
    anew = "new each start" if block.change.quantity in TURN_ON else "not asked"
    needed = f"{block.needed / size:.2g} {unit}" if block.needed else anew
    return block.words, moved, needed, f"{block.z:.1f}", block.state


def _judged(
    blocks: tuple[VerifiedBlock, ...], use: Use | None, notes: tuple[str, ...], noticed: Sequence[Finding]
) -> Verification:
    findings = [*_findings(blocks, use), *noticed]
    told = any(block.state != "cannot tell" for block in blocks) and not any(
        finding.severity in ("warning", "problem") for finding in noticed
    )
    name = "general use" if use is None else use.name
    state: State = "moved" if any(block.state == "moved" for block in blocks) else "holds" if told else "cannot tell"
    moved, within = (_by_certainty(blocks, one) for one in ("moved", "moved, within need"))
    headline = _HEADLINES[state].format(blocks=_names(moved), use=name)
    if within and state == "holds":
        headline = _WITHIN.format(headline=headline, blocks=_names(within))
    ordered = merge_by_cause(findings)
    return Verification(
        state=state,
        blocks=blocks,
        use=name,
        findings=ordered,
        verdict=verdict_of(ordered),
        headline=headline,
        notes=notes,
    )


def _names(blocks: Sequence[VerifiedBlock]) -> str:
    return ", ".join(block.words for block in blocks)


def _untold(use: Use | None) -> Verification:
    finding = make_finding("cannot-verify/estimate")
    return Verification(
        state="cannot tell",
        blocks=(),
        use="general use" if use is None else use.name,
        findings=(finding,),
        verdict="warn",
        headline=_HEADLINES["cannot tell"],
    )


def _findings(blocks: Sequence[VerifiedBlock], use: Use | None) -> Iterator[Finding]:
    for block in _by_certainty(blocks, "moved", "moved, within need"):
        beyond = not block.needed or block.change.size > block.needed
        told, cure = told_with_cure(block.change, block.needed, use)
        most = f", most of all in {block.change.where}" if block.change.where else ""
        yield make_finding(
            "calibration-moved",
            block=block.path,
            severity="info" if block.state != "moved" else "problem" if beyond else "warning",
            case="beyond" if beyond else "",
            told=f"{told}{most}, z {block.z:.1f}",
            cure=cure,
        )
    untold = [block for block in blocks if block.state == "cannot tell"]
    if untold:
        yield make_finding("cannot-verify", blocks=_names(untold))
