"""Tedaldi's simulations: 40 sensors of 30 recordings each, Tables 4.1 to 4.5, and gnomon beside what was published.

simulate the signals of section 4.1 -> gnomon's recipe, Algorithm 1 as printed, the authors' script -> metrics 1 to 4
"""

import numpy as np

from ..calibrate.imu import calibrate_imu
from ..frozen import value_class
from ..options import ImuOptions
from ..recording import Floats
from ..results.imu_diagnostics import ImuDiagnostics
from ..simulate.imu import simulate_imu
from .runs import HERE, Progress, Workers, carry_out, run_seeds
from .tedaldi_trial import (
    METHODS,
    SCENARIO,
    Method,
    SignalErrors,
    TedaldiOutcome,
    TedaldiTrial,
    correct_samples,
    ideal_signals,
    recorded_samples,
    run_tedaldi_trial,
    tedaldi_trial,
)

SETS = 40
"""Parameter sets of Tedaldi 2014."""

_EXAMPLES = 4


@value_class
class Example:
    """One recording, to be looked at.

    Attributes
    ----------
    t_s : (n,) [s]
    before : force and rate as recorded, (n, 3) both [m/s^2] [rad/s]
    after : the same, corrected by gnomon's calibration
    truth : the same without noise and errors
    rests : (k, 2) beginning and end of the static intervals that were detected [s]
    """

    t_s: Floats
    before: tuple[Floats, Floats]
    after: tuple[Floats, Floats]
    truth: tuple[Floats, Floats]
    rests: Floats


@value_class
class TedaldiStudy:
    """What the study found.

    Attributes
    ----------
    runs, seed : recordings of each parameter set, and where the random numbers come from
    outcomes : one for each recording, by parameter sets
    examples : the first recording of each of the first sets
    """

    runs: int
    seed: int
    outcomes: tuple[tuple[TedaldiOutcome, ...], ...]
    examples: tuple[Example, ...]

    @property
    def truth(self) -> Floats:
        """Parameters of each set, (sets, 18)."""
        return np.array([outcomes[0].truth for outcomes in self.outcomes])

    def estimates(self, method: Method) -> Floats:
        """Return what a method estimated, (sets, runs, 18)."""
        return self._stacked(method, "estimate")

    def sigmas(self, method: Method) -> Floats:
        """Return what standard deviations it stated, (sets, runs, 18)."""
        return self._stacked(method, "sigma")

    def mean_error(self, method: Method) -> Floats:
        """Return the mean absolute errors of each set, (sets, 18)."""
        return known_mean(np.abs(self.estimates(method) - self.truth[:, None]), axis=1)

    def spread(self, method: Method) -> Floats:
        """Return the standard deviation of the estimates of each set, (sets, 18)."""
        estimates = self.estimates(method)
        away = estimates - known_mean(estimates, axis=1)[:, None]
        count = np.isfinite(estimates).sum(axis=1)
        return np.sqrt(known_mean(away**2, axis=1) * count / np.maximum(count - 1, 1))

    def signals(self, method: Method | None, name: str) -> Floats:
        """Return one of the metrics of signals, (sets, runs, 3 or 2); of no method, before the calibration."""
        return np.array([
            [getattr(signals_of(outcome, method), name) for outcome in outcomes] for outcomes in self.outcomes
        ])  # fmt: skip

    def failures(self, method: Method) -> list[str]:
        """Return why a method made nothing of a recording, for each of those."""
        which = METHODS.index(method)
        problems = [outcome.methods[which].problem for outcomes in self.outcomes for outcome in outcomes]
        return [problem for problem in problems if problem]

    def _stacked(self, method: Method, name: str) -> Floats:
        which = METHODS.index(method)
        return np.array([[getattr(outcome.methods[which], name) for outcome in outcomes] for outcomes in self.outcomes])


def known_mean(values: Floats, axis: int | tuple[int, ...]) -> Floats:
    """Return the mean of what is known, along axes; nan where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=axis)
    return np.where(count, np.where(known, values, 0.0).sum(axis=axis) / np.maximum(count, 1), np.nan)


def signals_of(outcome: TedaldiOutcome, method: Method | None) -> SignalErrors:
    """Return the errors of the signals that a method corrected; of no method, of those that were recorded."""
    return outcome.before if method is None else outcome.methods[METHODS.index(method)].errors


def study_tedaldi(
    *, runs: int = 30, sets: int = SETS, workers: Workers = HERE, seed: int = 0, progress: Progress | None = None
) -> TedaldiStudy:
    """Carry out Tedaldi's simulations.

    Parameters
    ----------
    runs : recordings of each parameter set
    sets : parameter sets
    workers : who does them; the result does not depend on it
    seed : every random number follows from it
    progress : is told what is being done
    """
    tasks = tedaldi_trials(seed, sets, runs)
    outcomes = carry_out(run_tedaldi_trial, tasks, workers=workers, progress=progress, name="recording")
    if progress:
        progress("calibrating the examples")
    return TedaldiStudy(
        runs=runs,
        seed=seed,
        outcomes=tuple(tuple(outcomes[k * runs : (k + 1) * runs]) for k in range(sets)),
        examples=tuple(_example(task) for task in tasks[: _EXAMPLES * runs : runs]),
    )


def tedaldi_trials(seed: int, sets: int, runs: int) -> list[TedaldiTrial]:
    """Return the recordings, by parameter sets; fewer sets or runs are the first of more."""
    return [
        tedaldi_trial(SCENARIO, number, signals)
        for number in run_seeds(seed, sets)
        for signals in run_seeds(number, runs)
    ]


def _example(task: TedaldiTrial) -> Example:
    recording, truth = simulate_imu(task.scenario, task.seed)
    result = calibrate_imu(recording, ImuOptions(gravity=task.scenario.gravity, frame="accel-z"))
    assert isinstance(result.diagnostics, ImuDiagnostics)
    force, rate = recorded_samples(recording)
    ideal = ideal_signals(task, truth)
    rests = result.diagnostics.intervals
    return Example(
        t_s=ideal.t_s,
        before=(force, rate),
        after=correct_samples(result.calibration.imus["imu0"], force, rate),
        truth=(ideal.force, ideal.rate),
        rests=np.stack([rests.start_s, rests.stop_s], axis=1),
    )
