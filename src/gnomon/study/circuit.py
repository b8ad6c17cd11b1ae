"""What a calibration is worth on the way: odometry round a circuit with calibrations of different depth.

draw a rig, calibrate it in every way, walk with each -> the same walks with one quantity off at a time
-> what each costs, and the limits that follow -> the same walks with all quantities at the limits
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..frozen import value_class
from ..options.requirements import parse_sigma
from ..recording import Floats
from .circuit_rig import DATA_SHEET, QUANTITIES
from .circuit_walk import (
    MEASURES,
    WAYS,
    CircuitRun,
    CircuitTask,
    PartsRun,
    PartsTask,
    limits_of_vio,
    walk_circuit,
    walk_with_parts_off,
)
from .runs import HERE, Progress, Workers, carry_out, run_seeds

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
