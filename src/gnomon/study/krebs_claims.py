"""What Krebs claims of its simulation, whether gnomon's runs agree, and all of their numbers as tables."""

from collections.abc import Iterator

import numpy as np

from ..recording import Floats
from .krebs import KrebsSample, KrebsStudy, group_mean, krebs_group_rms, scatter_reduction
from .krebs_run import CHANGES, GROUPS, NAMES, UNITS, group_columns, stated_mean, stated_sigma
from .runs import Cell, Claim, StudyTable, claims_table, ratio_agrees, sigmas_claim

_CHANCE = 1e-3
"""That a claim about many means fails although it holds."""

_BAND = 3.29  # of 99.9 %
_MOVED = 0.05
"""Sigmas by which an estimate may move that should not."""

_LIKE = 3.0
"""Factor within which sigmas count as like those of Krebs, whose board and camera are not known."""

_HALF = 0.5
"""Share of the basic model's bias: where the extended model may have that much there are too few runs to tell."""

_AT_MOST_MM = 5.0
"""Bias of p_cb by the basic model on one axis, section 5.1.3."""


def krebs_claims(study: KrebsStudy) -> Iterator[Claim]:
    """Yield what Krebs says and gnomon promises, and whether the study agrees."""
    done = sum(sample.converged for sample in study.samples)
    yield Claim(
        claim="Every recording is calibrated, whatever its noise",
        expected=f"{study.runs * len(study.samples)} of {study.runs * len(study.samples)} converge",
        found=f"{done}",
        holds=done == study.runs * len(study.samples),
    )
    yield _independent(study)
    yield _unbiased(study)
    yield _earth(study)
    yield from _honest(study)
    yield from _like_krebs(study)
    yield from _noise(study)
    yield from _neglect(study)


def _independent(study: KrebsStudy) -> Claim:
    found = study.independence
    own, others = np.abs(found.of_own), found.of_others
    worst = int(np.argmax(others))
    return Claim(
        claim="Change one parameter, and its estimate moves by as much and no other one (B11, 5.1.1)",
        expected=f"all {len(NAMES)} of them to within {_MOVED:g} sigma of a recording, without noise",
        found=f"own move to within {own.max():.2g} sigma; others at most {others[worst]:.2g} sigma "
        f"({found.moved_most(worst)} when {NAMES[worst]} changes)",
        holds=bool(own.max() < _MOVED and others.max() < _MOVED),
    )


def _unbiased(study: KrebsStudy) -> Claim:
    number = len(NAMES) * len(study.noise_levels)
    bound = _bound(study, number)
    largest = {sample.series.name: int(np.argmax(np.abs(sample.mean_in_errors))) for sample in study.noise_levels}
    shown = [
        f"{sample.series.name} {abs(sample.mean_in_errors[worst]):.2f} ({NAMES[worst]})"
        for sample, worst in zip(study.noise_levels, largest.values(), strict=True)
    ]
    return Claim(
        claim="The mean lies on the true value at each noise level (B12, 5.1.2)",
        expected=f"the largest of {number} mean errors below {bound:.1f} of its standard errors",
        found=", ".join(shown),
        holds=_mean_told(study, all(np.abs(s.mean_in_errors).max() < bound for s in study.noise_levels), bound),
    )


def _bound(study: KrebsStudy, number: int) -> float:
    """Return what the largest of so many mean errors, in standard errors, does not exceed by chance."""
    from scipy.stats import t

    return float(t.isf(_CHANCE / number / 2, study.runs - 1))


def _mean_told(study: KrebsStudy, inside: bool, bound: float) -> bool | None:
    """Return whether means agree with their bound; None where they do, but one that is off by a whole sigma would."""
    return None if inside and bound >= np.sqrt(study.runs) else inside


def _earth(study: KrebsStudy) -> Claim:
    """Table B.1 shows the same: in S3, three elements of B_g have mean errors of 4 to 7 standard errors."""
    least, (turning, still) = study.noise_levels[-1], study.quiet
    left = (least.mean - turning.error) / (least.scatter / np.sqrt(study.runs))
    bound, worst = _bound(study, len(NAMES)), int(np.argmax(np.abs(left)))
    known, rest = (np.abs(run.error / run.sigma) for run in study.quiet)
    most = int(np.argmax(known))
    return Claim(
        claim="What is left of that in S3 is the Earth's rate, which is in the simulation but not in the model",
        expected=f"mean errors less those of a recording without noise below {bound:.1f} of their standard errors; "
        f"without the Earth's rate it has none above {_MOVED:g} sigma",
        found=f"{abs(left[worst]):.2f} ({NAMES[worst]}); without noise {known[most]:.2f} sigma ({NAMES[most]}), "
        f"without the Earth's rate {rest.max():.2g}",
        holds=_mean_told(
            study,
            bool(abs(left[worst]) < bound and rest.max() < _MOVED and not still.failure and not turning.failure),
            bound,
        ),
    )


def _honest(study: KrebsStudy) -> Iterator[Claim]:
    half = _BAND * np.sqrt(2 * len(NAMES) / study.runs)
    earth = study.quiet[0].nees
    expected = np.array([0.0, 0.0, earth]) + len(NAMES)
    found = np.array([sample.nees for sample in study.noise_levels])
    yield Claim(
        claim="Gnomon's covariance is true: squared errors of all 34 parameters together (NEES)",
        expected=f"{len(NAMES)} ± {half:.1f} in S1 and S2, and {earth:.1f} more in S3, the Earth's rate",
        found=", ".join(f"{sample.series.name} {sample.nees:.1f}" for sample in study.noise_levels),
        holds=ratio_agrees(bool(np.abs(found - expected).max() < half), 1 - half / len(NAMES), 1 + half / len(NAMES)),
    )
    ratios = np.concatenate([sample.sigma / sample.scatter for sample in study.noise_levels])
    yield sigmas_claim("And each sigma is that of the scatter", ratios, study.runs - 1, " for all of them, S1 to S3")


def _like_krebs(study: KrebsStudy) -> Iterator[Claim]:
    ratios = {sample.series.name: _over_stated(sample, k) for k, sample in enumerate(study.noise_levels)}
    allowed = 1.0 + 3 / np.sqrt(2 * 3 * study.runs)
    above = [f"{name} {symbol} {r:.2f}" for name, found in ratios.items() for symbol, r in found.items() if r > allowed]
    highest = max(max(found.values()) for found in ratios.values())
    yield Claim(
        claim="The scatter is not larger than in Tables B.1 and B.2 (B12)",
        expected=f"rms of each group over the tables' at most {allowed:.2f}",
        found=", ".join(above) or f"at most {highest:.2f}",
        holds=ratio_agrees(not above, 1.0, allowed),
    )
    below = [
        f"{name} {symbol} {r:.2f}"
        for name, found in ratios.items()
        for symbol, r in found.items()
        if not 1 / _LIKE < r < _LIKE
    ]
    total = sum(len(found) for found in ratios.values())
    yield Claim(
        claim="And of the same size, though its board, camera and pixel noise are not stated",
        expected=f"all {total} groups within a factor of {_LIKE:g}",
        found=f"{total - len(below)}" + (f"; not {', '.join(below)}" if below else ""),
        holds=not below,
    )


def _over_stated(sample: KrebsSample, series: int) -> dict[str, float]:
    """Return scatter over that of Tables B.1 and B.2, rms over each group that they have."""
    ours, theirs = krebs_group_rms(sample.scatter), krebs_group_rms(stated_sigma(series))
    return {symbol: ours[symbol] / theirs[symbol] for symbol in ours if np.isfinite(theirs[symbol])}


def _noise(study: KrebsStudy) -> Iterator[Claim]:
    """B20; a step's mean over the axes is the geometric one."""
    room = float(np.exp(3 / np.sqrt(2 * 3 * study.runs) * np.sqrt(2)))
    for samples, wanted, claim in (
        (
            study.noise_levels,
            (2.0, 4.0),
            "A tenth of the IMU's noise divides sigma of p_cb by 2 to 4 (B20, Table 5.2)",
        ),
        (study.without_pixel_noise, (10.0, 10.0), "Without pixel noise it follows the noise (B20)"),
    ):
        steps = np.exp(np.mean(np.log(scatter_reduction(samples)), axis=1))
        bounds = wanted[0] / room, wanted[1] * room
        yield Claim(
            claim=claim,
            expected=f"{bounds[0]:.2g} to {bounds[1]:.2g}, mean of the axes, S1 to S2 and S2 to S3",
            found=", ".join(f"{step:.2f}" for step in steps),
            holds=ratio_agrees(bool(steps.min() > bounds[0] and steps.max() < bounds[1]), 1 / room, room),
        )


def _neglect(study: KrebsStudy) -> Iterator[Claim]:
    place = group_columns("p_cb")
    basic, full = study.basic, study.samples[0]
    surely = np.abs(basic.mean_in_errors[place]).max()
    chance = basic.scatter[place].max() / np.sqrt(study.runs)
    largest = 1e3 * np.abs(basic.mean[place]).max()
    yield Claim(
        claim="Neglecting the influences between the axes biases p_cb, by up to 5 mm on one axis (B13, Fig. 5.4)",
        expected=f"mean error of the basic model above 5 of its standard errors, at most {_AT_MOST_MM:g} mm",
        found=f"{_millimetres(basic.mean[place])} mm, {surely:.0f} standard errors",
        holds=None if surely <= 5 and 5e3 * chance >= _AT_MOST_MM else bool(surely > 5 and largest < _AT_MOST_MM),
    )
    left = np.linalg.norm(full.mean[place]) / np.linalg.norm(basic.mean[place])
    room = 0.05 + 3 * np.linalg.norm(full.scatter[place] / np.sqrt(study.runs)) / np.linalg.norm(basic.mean[place])
    yield Claim(
        claim="The extended model does not",
        expected=f"mean error at most {room:.2f} of the basic model's",
        found=f"{_millimetres(full.mean[place])} mm, {left:.2f} of it",
        holds=None if left < room and room >= _HALF else bool(left < room),
    )


def _millimetres(values: Floats) -> str:
    return ", ".join(f"{axis} {1e3 * value:+.2f}" for axis, value in zip("xyz", values, strict=True))


def krebs_tables(study: KrebsStudy) -> Iterator[StudyTable]:
    """Yield all numbers of the study."""
    yield claims_table(krebs_claims(study))
    yield StudyTable(
        name="parameters",
        head=("series", "parameter", "unit", "mean_error", "scatter", "sigma", "sigma_thesis", "mean_error_thesis"),
        rows=list(_parameter_rows(study)),
    )
    yield StudyTable(
        name="table_5_3",
        head=("group", "unit", "sigma_cal", "sigma_cal_thesis", "mean_of_tables_B1_B2"),
        rows=list(_table_5_3(study)),
    )
    yield StudyTable(
        name="runs",
        head=("series", "run", "iterations", "converged", "nees", *(f"error {n} [{u}]" for n, u in _NAMED),
              *(f"sigma {n} [{u}]" for n, u in _NAMED), "failure"),
        rows=[
            (sample.series.name, run, o.iterations, o.converged, o.nees, *o.error.tolist(), *o.sigma.tolist(),
             o.failure)
            for sample in study.samples for run, o in enumerate(sample.outcomes, 1)
        ],
    )  # fmt: skip
    yield StudyTable(
        name="independence",
        head=("changed", "unit", "by", "error_of_own_move [sigma]", "largest_other_move [sigma]", "which"),
        rows=[
            (name, unit, CHANGES[name.split(maxsplit=1)[0]], float(own), float(other), study.independence.moved_most(k))
            for k, ((name, unit), own, other) in enumerate(
                zip(_NAMED, study.independence.of_own, study.independence.of_others, strict=True)
            )
        ],
    )
    yield StudyTable(
        name="settings",
        head=("setting", *(f"sigma {group.symbol} [{group.unit}]" for group in GROUPS)),
        rows=[(setting.name, *krebs_group_rms(run.sigma).values()) for setting, run in study.settings],
    )


_NAMED = tuple(zip(NAMES, UNITS, strict=True))


def _parameter_rows(study: KrebsStudy) -> Iterator[tuple[Cell, ...]]:
    for number, sample in enumerate(study.samples):
        known = number < len(study.noise_levels)
        stated = stated_sigma(number) if known else np.full(len(NAMES), np.nan)
        means = stated_mean(number) if known else np.full(len(NAMES), np.nan)
        numbers = (sample.mean, sample.scatter, sample.sigma, stated, means)
        for k, (name, unit) in enumerate(_NAMED):
            yield sample.series.name, name, unit, *(float(column[k]) for column in numbers)


def _table_5_3(study: KrebsStudy) -> Iterator[tuple[Cell, ...]]:
    ours, tabled = group_mean(study.samples[0].scatter), group_mean(stated_sigma(0))
    for group in GROUPS:
        yield group.symbol, group.unit, ours[group.symbol], group.table_5_3, tabled[group.symbol]
