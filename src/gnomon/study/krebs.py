"""Krebs's simulation many times: section 5.1, Tables 5.2, 5.3, B.1 and B.2, Figs. 5.2-5.4, and gnomon beside it.

simulate one motion with ever new noise -> calibrate camera and IMU -> errors, scatter, sigmas against the truth
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..errors import SolveError
from ..frozen import value_class
from ..recording import Floats
from .krebs_run import GROUPS, NAMES, SCENARIO, KrebsRun, KrebsTask, group_columns, run_krebs
from .runs import HERE, Progress, Workers, carry_out, run_seeds

_FEWEST = 2
_CHANGED_S = 40.0  # recordings without noise tell as much when they are short


@value_class(eq=True)
class Series:
    """How recordings are made and calibrated: its name in words, and the task but for seed and duration."""

    name: str
    task: KrebsTask

    def run(self, seed: int, duration_s: float) -> KrebsTask:
        """Return what to do for one run."""
        return replace(self.task, seed=seed, duration_s=duration_s)


SERIES = (
    Series(name="S1", task=KrebsTask()),
    Series(name="S2", task=KrebsTask(noise_factor=0.1)),
    Series(name="S3", task=KrebsTask(noise_factor=0.01)),
    Series(name="S1, basic model", task=KrebsTask(model="basic")),
    Series(name="S1, no pixel noise", task=KrebsTask(pixel_noise_px=0.0)),
    Series(name="S2, no pixel noise", task=KrebsTask(noise_factor=0.1, pixel_noise_px=0.0)),
    Series(name="S3, no pixel noise", task=KrebsTask(noise_factor=0.01, pixel_noise_px=0.0)),
)
"""Of many runs each; S1, S2 and S3 are Krebs's."""

SETTINGS = (
    Series(name="as S1", task=KrebsTask()),
    Series(name="corners with 1 px of noise", task=KrebsTask(pixel_noise_px=1.0)),
    Series(name="10 frames per second", task=KrebsTask(camera_rate_hz=10.0)),
    Series(name="gyroscope walk 2·10⁻⁵ rad/s/√s, as consumer sensors have", task=KrebsTask(gyroscope_random_walk=2e-5)),
    Series(name="magnitude of gravity known", task=KrebsTask(gravity_known=True)),
)
"""S1 with one thing changed that Krebs leaves open, or that can be read otherwise; of one run each."""

_NOISELESS = KrebsTask(noise_factor=0.0, pixel_noise_px=0.0)


@value_class
class Independence:
    """What a change of one parameter does to the estimates.

    Attributes
    ----------
    moved : (34, 34) of the estimates, beyond what was changed: row by row the parameter that was changed
    sigma : (34,) of one recording at the noise of Table A.1
    """

    moved: Floats
    sigma: Floats

    @property
    def of_own(self) -> Floats:
        """Error of the changed parameter's own move, in sigmas, (34,)."""
        return np.diag(self.moved) / self.sigma

    @property
    def of_others(self) -> Floats:
        """Largest move of another parameter, in sigmas, (34,)."""
        share = np.abs(self.moved / self.sigma)
        np.fill_diagonal(share, 0.0)
        return share.max(axis=1)

    def moved_most(self, row: int) -> str:
        """Return which other parameter moves most where one is changed."""
        share = np.abs(self.moved[row] / self.sigma)
        share[row] = 0.0
        return NAMES[int(np.argmax(share))]


@value_class
class KrebsSample:
    """All runs of one series; parameters are in the order of `krebs_run.NAMES`.

    Attributes
    ----------
    series : how they were made
    outcomes : one for each run
    """

    series: Series
    outcomes: tuple[KrebsRun, ...]

    @property
    def found(self) -> tuple[KrebsRun, ...]:
        """Runs with a result."""
        return tuple(run for run in self.outcomes if not run.failure)

    @property
    def errors(self) -> Floats:
        """Estimate minus truth, (runs, 34)."""
        return np.array([run.error for run in self.found])

    @property
    def mean(self) -> Floats:
        """Mean error, (34,)."""
        return self.errors.mean(axis=0)

    @property
    def scatter(self) -> Floats:
        """Standard deviation of the estimates, sigma_cal of Krebs, (34,)."""
        return self.errors.std(axis=0, ddof=1)

    @property
    def sigma(self) -> Floats:
        """Root mean square of the sigmas that gnomon states, (34,)."""
        return np.sqrt(np.mean([run.sigma**2 for run in self.found], axis=0))

    @property
    def mean_in_errors(self) -> Floats:
        """Mean error over what the scatter of so many runs leaves of it, (34,)."""
        return self.mean / (self.scatter / np.sqrt(len(self.found)))

    @property
    def nees(self) -> float:
        """Mean of the squared error in units of the stated covariance; 34 where that is true."""
        return float(np.mean([run.nees for run in self.found]))

    @property
    def converged(self) -> int:
        """How many runs came to rest."""
        return sum(run.converged for run in self.outcomes)


@value_class
class KrebsStudy:
    """What the study found.

    Attributes
    ----------
    runs, seed : of each series, and where the random numbers come from
    samples : one for each of SERIES
    independence : one parameter at a time (B11)
    settings : the first recording of S1 with each of SETTINGS
    quiet : a recording without noise, weighed as in S3, and the same without the Earth's rate
    """

    runs: int
    seed: int
    samples: tuple[KrebsSample, ...]
    independence: Independence
    settings: tuple[tuple[Series, KrebsRun], ...]
    quiet: tuple[KrebsRun, KrebsRun]

    def sample(self, name: str) -> KrebsSample:
        """Return a series by its name."""
        return next(sample for sample in self.samples if sample.series.name == name)

    @property
    def noise_levels(self) -> tuple[KrebsSample, ...]:
        """S1, S2 and S3."""
        return self.samples[:3]

    @property
    def without_pixel_noise(self) -> tuple[KrebsSample, ...]:
        """The same without pixel noise."""
        return self.samples[4:]

    @property
    def basic(self) -> KrebsSample:
        """S1 with the basic model."""
        return self.samples[3]


def study_krebs(
    *,
    runs: int = 100,
    workers: Workers = HERE,
    seed: int = 0,
    progress: Progress | None = None,
    duration_s: float = SCENARIO.duration_s,
) -> KrebsStudy:
    """Carry out Krebs's simulations.

    Parameters
    ----------
    runs : recordings of each series, at least 2
    workers : who calibrates them; the result does not depend on it
    seed : every random number follows from it
    progress : is told what is being done
    duration_s : length of a recording

    Raises
    ------
    SolveError
        If hardly any recording of a series could be calibrated.
    """
    drawn = run_seeds(seed, runs)
    tasks = [series.run(number, duration_s) for number in drawn for series in SERIES]
    outcomes = carry_out(run_krebs, tasks, workers=workers, progress=progress, name="recording")
    samples = tuple(
        KrebsSample(series=series, outcomes=tuple(outcomes[k :: len(SERIES)])) for k, series in enumerate(SERIES)
    )
    for sample in samples:
        if len(sample.found) < _FEWEST:
            raise SolveError(f"{sample.series.name}: no result of {runs} recordings, {sample.outcomes[0].failure}")

    def run_each(name: str, tasks: Iterable[KrebsTask], seconds: float = duration_s) -> list[KrebsRun]:
        first = [replace(task, seed=drawn[0], duration_s=seconds) for task in tasks]
        return carry_out(run_krebs, first, workers=workers, progress=progress, name=name)

    changes = (replace(_NOISELESS, changed=name) for name in ("", *NAMES))
    before, *after = run_each("changed parameter", changes, min(duration_s, _CHANGED_S))
    settings = run_each("setting", (setting.task for setting in SETTINGS))
    quiet = (replace(_NOISELESS, weighed_as=SERIES[2].task.noise_factor, earth_rate=turns) for turns in (True, False))
    turning, still = run_each("recording without noise", quiet)
    moved = np.array([run.error - before.error for run in after])
    return KrebsStudy(
        runs=runs,
        seed=seed,
        samples=samples,
        independence=Independence(moved=moved, sigma=samples[0].sigma),
        settings=tuple(zip(SETTINGS, settings, strict=True)),
        quiet=(turning, still),
    )


def krebs_group_rms(values: Floats) -> dict[str, float]:
    """Return the rms over the elements of each group, of values (34,)."""
    return {group.symbol: float(np.sqrt(np.mean(values[group_columns(group.symbol)] ** 2))) for group in GROUPS}


def group_mean(values: Floats) -> dict[str, float]:
    """Return the mean over the elements of each group, as in Table 5.3, of values (34,)."""
    return {group.symbol: float(np.mean(values[group_columns(group.symbol)])) for group in GROUPS}


def scatter_reduction(samples: tuple[KrebsSample, ...]) -> Floats:
    """Return by what the scatter of p_cb falls from each noise level to the next, (2, 3)."""
    place = group_columns("p_cb")
    return np.array([a.scatter[place] / b.scatter[place] for a, b in pairwise(samples)])
