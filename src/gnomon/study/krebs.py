"""Document B's simulation many times: section 5.1, Tables 5.2, 5.3, B.1 and B.2, Figs. 5.2-5.4, and gnomon beside it.

simulate one motion with ever new noise -> calibrate camera and IMU -> errors, scatter, sigmas against the truth
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import SolveError
from ..recording import Floats
from .krebs_run import PIXEL_NOISE_PX, SCENARIO, KrebsRun, KrebsTask, Model, run_krebs
from .krebs_single import (
    SETTINGS,
    ChangeTask,
    Independence,
    QuietTask,
    Setting,
    SettingTask,
    run_changed,
    run_quiet,
    run_setting,
)
from .krebs_thesis import GROUPS, NAMES, columns
from .runs import HERE, Progress, Workers, carry_out, seeds

_FEWEST = 2
_CHANGED_S = 40.0  # recordings without noise tell as much when they are short


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """How the recordings of one series are made and calibrated.

    Attributes
    ----------
    name : S1, S2 and S3 are document B's
    noise_factor : of the IMU
    pixel_noise_px : of the corners
    model : extended (full) or basic
    """

    name: str
    noise_factor: float
    pixel_noise_px: float = PIXEL_NOISE_PX
    model: Model = "full"

    def task(self, seed: int, duration_s: float) -> KrebsTask:
        """Return what to do for one run."""
        return KrebsTask(
            seed=seed,
            noise_factor=self.noise_factor,
            pixel_noise_px=self.pixel_noise_px,
            model=self.model,
            duration_s=duration_s,
        )


SERIES = (
    Series(name="S1", noise_factor=1.0),
    Series(name="S2", noise_factor=0.1),
    Series(name="S3", noise_factor=0.01),
    Series(name="S1, basic model", noise_factor=1.0, model="basic"),
    Series(name="S1, no pixel noise", noise_factor=1.0, pixel_noise_px=0.0),
    Series(name="S2, no pixel noise", noise_factor=0.1, pixel_noise_px=0.0),
    Series(name="S3, no pixel noise", noise_factor=0.01, pixel_noise_px=0.0),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """All runs of one series; parameters are in the order of `krebs_thesis.NAMES`.

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
        """Standard deviation of the estimates, sigma_cal of document B, (34,)."""
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    samples: tuple[Sample, ...]
    independence: Independence
    settings: tuple[tuple[Setting, KrebsRun], ...]
    quiet: tuple[KrebsRun, KrebsRun]

    def sample(self, name: str) -> Sample:
        """Return a series by its name."""
        return next(sample for sample in self.samples if sample.series.name == name)

    @property
    def noise_levels(self) -> tuple[Sample, ...]:
        """S1, S2 and S3."""
        return self.samples[:3]

    @property
    def without_pixel_noise(self) -> tuple[Sample, ...]:
        """The same without pixel noise."""
        return self.samples[4:]

    @property
    def basic(self) -> Sample:
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
    """Carry out document B's simulations.

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
    drawn = seeds(seed, runs)
    tasks = [series.task(number, duration_s) for number in drawn for series in SERIES]
    outcomes = carry_out(run_krebs, tasks, workers=workers, progress=progress, name="recording")
    samples = tuple(
        Sample(series=series, outcomes=tuple(outcomes[k :: len(SERIES)])) for k, series in enumerate(SERIES)
    )
    for sample in samples:
        if len(sample.found) < _FEWEST:
            raise SolveError(f"{sample.series.name}: no result of {runs} recordings, {sample.outcomes[0].failure}")
    return KrebsStudy(
        runs=runs,
        seed=seed,
        samples=samples,
        independence=_independence(drawn[0], samples[0].sigma, workers, progress, min(duration_s, _CHANGED_S)),
        settings=_settings(drawn[0], workers, progress, duration_s),
        quiet=_quiet(drawn[0], workers, progress, duration_s),
    )


def _independence(
    seed: int, sigma: Floats, workers: Workers, progress: Progress | None, duration_s: float
) -> Independence:
    tasks = [ChangeTask(name=name, duration_s=duration_s, seed=seed) for name in ("", *NAMES)]
    before, *after = carry_out(run_changed, tasks, workers=workers, progress=progress, name="changed parameter")
    return Independence(moved=np.array([run.error - before.error for run in after]), sigma=sigma)


def _settings(
    seed: int, workers: Workers, progress: Progress | None, duration_s: float
) -> tuple[tuple[Setting, KrebsRun], ...]:
    tasks = [SettingTask(setting=setting, duration_s=duration_s, seed=seed) for setting in SETTINGS]
    found = carry_out(run_setting, tasks, workers=workers, progress=progress, name="setting")
    return tuple(zip(SETTINGS, found, strict=True))


def _quiet(seed: int, workers: Workers, progress: Progress | None, duration_s: float) -> tuple[KrebsRun, KrebsRun]:
    least = SERIES[2].noise_factor
    tasks = [
        QuietTask(weighed_as=least, earth_rate=earth_rate, duration_s=duration_s, seed=seed)
        for earth_rate in (True, False)
    ]
    turning, still = carry_out(run_quiet, tasks, workers=workers, progress=progress, name="recording without noise")
    return turning, still


def group_rms(values: Floats) -> dict[str, float]:
    """Return the rms over the elements of each group, of values (34,)."""
    return {group.symbol: float(np.sqrt(np.mean(values[columns(group.symbol)] ** 2))) for group in GROUPS}


def group_mean(values: Floats) -> dict[str, float]:
    """Return the mean over the elements of each group, as in Table 5.3, of values (34,)."""
    return {group.symbol: float(np.mean(values[columns(group.symbol)])) for group in GROUPS}


def reduction(samples: tuple[Sample, ...]) -> Floats:
    """Return by what the scatter of p_cb falls from each noise level to the next, (2, 3)."""
    place = columns("p_cb")
    return np.array([a.scatter[place] / b.scatter[place] for a, b in pairwise(samples)])
