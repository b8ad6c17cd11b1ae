"""What a calibration is worth on the way: odometry round a circuit with calibrations of different depth.

draw a rig, calibrate it in every way, walk with each -> the same walks with one quantity off at a time
-> what each costs, and the limits that follow -> the same walks with all quantities at the limits
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.stats import bootstrap

from ..errors import SolveError
from ..frozen import value_class
from ..options.requirements import QUANTITIES as KNOWN
from ..options.requirements import parse_sigma
from ..recording import Floats
from .circuit_walk import (
    DATA_SHEET,
    MEASURES,
    QUANTITIES,
    WAYS,
    CircuitRun,
    CircuitTask,
    PartsRun,
    PartsTask,
    limits_of_vio,
    walk_circuit,
    walk_with_parts_off,
)
from .runs import HERE, Claim, Progress, StudyTable, Workers, carry_out, claims_table, run_seeds

SIZES = ("one sigma", "probe", "data sheet")
"""Of an error of one quantity: of the full calibration; small, but more than noise; evenly within the tolerance."""

PROBES: Mapping[str, float] = {
    name: parse_sigma(name, text)
    for name, text in (
        ("camera_rotation", "0.1 deg"),
        ("camera_translation", "5 mm"),
        ("time_shift", "0.3 ms"),
        ("gyroscope_scale", "0.1 %"),
        ("gyroscope_misalignment", "0.06 deg"),
        ("gyroscope_g_sensitivity", "0.05 deg/s/g"),
        ("accelerometer_scale", "0.2 %"),
        ("accelerometer_misalignment", "0.1 deg"),
    )
}
"""Sizes from which the limits are derived."""

_ATE = MEASURES.index("ate_m")


@value_class
class CircuitStudy:
    """What the study found.

    Attributes
    ----------
    runs, seed : rigs, and where the random numbers come from
    outcomes : one for each rig
    sizes : (3, q) in the order of SIZES and QUANTITIES [SI]
    parts : of the first third of the rigs: first each size of each quantity, (3 q) cases
    joint : of the same rigs: all quantities off at once, by the limits of vio, and by those that follow
    """

    runs: int
    seed: int
    outcomes: tuple[CircuitRun, ...]
    sizes: Floats
    parts: tuple[PartsRun, ...]
    joint: tuple[PartsRun, ...]

    @property
    def errors(self) -> Floats:
        """Errors of every walk, (runs, ways, 3) in the order of WAYS and MEASURES [m]."""
        return np.array([outcome.errors for outcome in self.outcomes])

    @property
    def length_m(self) -> Floats:
        """Lengths of the walks, (runs,)."""
        return np.array([outcome.length_m for outcome in self.outcomes])

    @property
    def own_m(self) -> float:
        """Rms of the absolute error with the true calibration, of the walks of `parts` [m]."""
        return float(np.sqrt(np.mean(self.errors[: len(self.parts), WAYS.index("truth"), _ATE] ** 2)))

    @property
    def costs_m(self) -> Floats:
        """Rms of the error that each size of each quantity adds, (3, q) [m]."""
        return _costs(self.parts, len(SIZES))

    @property
    def derived(self) -> Floats:
        """Limits that follow, (q,) [SI]; see `derived_limits`."""
        return derived_limits(self.sizes[1], self.costs_m[1], self.own_m)


def derived_limits(sizes: Floats, costs_m: Floats, own_m: float) -> Floats:
    """Return up to which size errors together cost as much as the odometry's own drift, each the same part of it.

    Costs of independent quantities add as squares, and small ones are proportional to the size.

    Parameters
    ----------
    sizes, costs_m : (q,) sizes that were tried [SI], and what each added [m]
    own_m : drift without any [m]

    Examples
    --------
    >>> derived_limits(np.array([0.1, 1.0, 1.0, 1.0]), np.array([0.5, 1.0, 2.0, 0.25]), own_m=1.0)
    array([0.1 , 0.5 , 0.25, 2.  ])
    """
    return sizes * own_m / np.sqrt(len(sizes)) / costs_m


def study_circuit(
    *, runs: int = 30, workers: Workers = HERE, seed: int = 0, progress: Progress | None = None
) -> CircuitStudy:
    """Carry out the study.

    Parameters
    ----------
    runs : rigs, each with its own walk; a third of them, the first, walk with one quantity off as well
    workers : who does them; the result does not depend on it
    seed : every random number follows from it
    progress : is told what is being done

    Raises
    ------
    SolveError
        If no rig could be calibrated.
    """
    drawn = run_seeds(seed, runs)
    tasks = [CircuitTask(seed=number) for number in drawn]
    outcomes = carry_out(walk_circuit, tasks, workers=workers, progress=progress, name="rig")
    sigma = np.array([outcome.sigma for outcome in outcomes])
    sigma = sigma[np.isfinite(sigma).all(axis=1)]
    if not len(sigma):
        raise SolveError("no rig could be calibrated with the full model.")
    probes, tolerances = ([sizes[name] for name in QUANTITIES] for sizes in (PROBES, DATA_SHEET))
    sizes = np.array([np.sqrt(np.mean(sigma**2, axis=0)), probes, np.array(tolerances) / np.sqrt(3)])
    off = tuple(tuple(row) for size in sizes for row in np.diag(size).tolist())
    some = drawn[: max(2, runs // 3)]
    tasks = [PartsTask(seed=number, off=off) for number in some]
    parts = carry_out(walk_with_parts_off, tasks, workers=workers, progress=progress, name="walk with parts off")
    study = CircuitStudy(runs=runs, seed=seed, outcomes=tuple(outcomes), sizes=sizes, parts=tuple(parts), joint=())
    off = (limits_of_vio(), tuple(study.derived.tolist()))
    tasks = [PartsTask(seed=number, off=off) for number in some]
    joint = carry_out(walk_with_parts_off, tasks, workers=workers, progress=progress, name="walk at the limits")
    return replace(study, joint=tuple(joint))


def _costs(runs: tuple[PartsRun, ...], cases: int) -> Floats:
    added = np.array([run.added[:, _ATE] for run in runs])
    return np.sqrt(np.mean(added**2, axis=0)).reshape(cases, len(QUANTITIES))


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
