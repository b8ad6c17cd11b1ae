"""What the walks round a circuit say, as claims and tables."""

from collections.abc import Iterator

import numpy as np
from scipy.stats import bootstrap

from ..options.requirements import QUANTITIES as KNOWN
from ..recording import Floats
from .circuit import SIZES, CircuitStudy
from .circuit_rig import QUANTITIES
from .circuit_walk import MEASURES, WAYS, limits_of_vio
from .tables import Claim, StudyTable, claims_table

CONFIDENCE = 0.95
_RESAMPLES = 2000
_FEWEST = 8
"""Walks from which on a bootstrap means something."""

_ALIKE = 1.2
_WORSE = 1.5


def mean_between(values: Floats) -> tuple[float, float, float]:
    """Return the mean of values (n,) that are known, and where it is with confidence (percentiles of a bootstrap)."""
    known = values[np.isfinite(values)]
    if len(known) < 2:
        return float("nan"), float("nan"), float("nan")
    found = bootstrap(
        (known,), np.mean, n_resamples=_RESAMPLES, confidence_level=CONFIDENCE, method="percentile", rng=0
    ).confidence_interval
    return float(known.mean()), float(found.low), float(found.high)


def level_numbers(study: CircuitStudy, way: str) -> dict[str, tuple[float, float, float]]:
    """Return mean and interval of each error with a calibration; "closure_percent" is of the way's length."""
    errors = study.errors[:, WAYS.index(way)]
    found = {name: mean_between(errors[:, k]) for k, name in enumerate(MEASURES)}
    closure = 100 * errors[:, MEASURES.index("closure_m")] / study.length_m
    return {**found, "closure_percent": mean_between(closure)}


def ratio_to_truth(study: CircuitStudy, way: str) -> tuple[float, float, float]:
    """Return the rms of the absolute error over that with the true calibration on the same walks, and its interval."""
    column = MEASURES.index("ate_m")
    squared = study.errors[:, [WAYS.index(way), WAYS.index("truth")], column] ** 2
    squared = squared[np.isfinite(squared).all(axis=1)]
    if len(squared) < _FEWEST:
        return float("nan"), float("nan"), float("nan")

    def ratio(own: Floats, true: Floats, axis: int = -1) -> Floats:
        return np.sqrt(own.mean(axis=axis) / true.mean(axis=axis))

    found = bootstrap(
        (squared[:, 0], squared[:, 1]),
        ratio,
        paired=True,
        n_resamples=_RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=0,
    ).confidence_interval
    return float(ratio(squared[:, 0], squared[:, 1])), float(found.low), float(found.high)


def circuit_claims(study: CircuitStudy) -> Iterator[Claim]:
    """Yield what should hold, and whether it does."""
    for way, words in (
        ("camera-imu full", "the full calibration before a board is as good on the way as the truth"),
        ("without a board", "so is the calibration without a board"),
    ):
        ratio, low, high = ratio_to_truth(study, way)
        yield Claim(
            claim=words,
            expected=f"absolute error over that with the truth below {_ALIKE:g}",
            found=_between(ratio, low, high),
            holds=None if not np.isfinite(ratio) else high < _ALIKE,
        )
    for way in ("camera-imu basic", "imu", "nominal"):
        ratio, low, high = ratio_to_truth(study, way)
        yield Claim(
            claim=f"what '{way}' leaves out costs on the way",
            expected=f"absolute error over that with the truth above {_WORSE:g}",
            found=_between(ratio, low, high),
            holds=None if not np.isfinite(ratio) else low > _WORSE,
        )
    added = joint_costs(study)[1] / study.own_m
    yield Claim(
        claim="all quantities off by the limits that follow, at once, add the odometry's own drift once more",
        expected="drift that is added over its own: 0.5 to 2",
        found=f"{added:.2f}",
        holds=None if len(study.joint) < _FEWEST else 0.5 < added < 2.0,
    )


def joint_costs(study: CircuitStudy) -> Floats:
    """Return the rms of the error that all quantities off at once add: by the limits of vio, and the derived ones."""
    column = MEASURES.index("ate_m")
    return np.sqrt(np.mean([run.added[:, column] ** 2 for run in study.joint], axis=0))


def _between(ratio: float, low: float, high: float) -> str:
    if not np.isfinite(ratio):
        return f"fewer than {_FEWEST} walks"
    return f"{ratio:.2f}, {low:.2f} to {high:.2f} with {100 * CONFIDENCE:.0f} % confidence"


def circuit_tables(study: CircuitStudy) -> Iterator[StudyTable]:
    """Yield all numbers of the study."""
    yield claims_table(circuit_claims(study))
    names = ("closure_percent", *MEASURES)
    yield StudyTable(
        name="levels",
        head=("calibration", "walks", *(f"{name}{end}" for name in names for end in ("", "_low", "_high"))),
        rows=[
            (
                way,
                int(np.isfinite(study.errors[:, WAYS.index(way), 0]).sum()),
                *(number for name in names for number in numbers[name]),
            )
            for way in WAYS
            for numbers in (level_numbers(study, way),)
        ],
    )
    yield StudyTable(
        name="walks",
        head=("walk", "length_m", "calibration", *MEASURES),
        rows=[
            (number, one.length_m, way, *one.errors[row].tolist())
            for number, one in enumerate(study.outcomes, 1)
            for row, way in enumerate(WAYS)
        ],
    )
    limits = limits_of_vio()
    yield StudyTable(
        name="parts",
        head=("quantity", "unit", *(f"{what}: {of}" for what in SIZES for of in ("size", "added_m")), "limit of vio",
              "derived limit"),
        rows=[
            (
                name,
                KNOWN[name].unit,
                *(float(v) for s in range(len(SIZES)) for v in (study.sizes[s, k] / KNOWN[name].size,
                                                               study.costs_m[s, k])),
                limits[k] / KNOWN[name].size,
                float(study.derived[k] / KNOWN[name].size),
            )
            for k, name in enumerate(QUANTITIES)
        ],
    )  # fmt: skip
