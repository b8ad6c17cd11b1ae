"""Angrisano's experiment with the accelerometer, many times: Tables 1 and 2, Figs. 4-6, and gnomon beside it.

simulate 18 poses of the document's sensor -> its iteration and gnomon's fit -> sigmas, scatter, starts that work
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from ..simulate.scenarios.recorded import PoseScenario
from .angrisano_trial import (
    GROUPS,
    TABLE_2,
    TRUTH,
    AngrisanoOutcome,
    AngrisanoTrial,
    Basin,
    Journey,
    run_angrisano_trial,
    scan_basins,
    trace_journeys,
)
from .runs import (
    HERE,
    Cell,
    Claim,
    Progress,
    StudyTable,
    Workers,
    carry_out,
    claims_table,
    ratio_agrees,
    run_seeds,
    sigmas_claim,
)

NAMES = ("angle x", "angle y", "angle z", "bias x", "bias y", "bias z", "scale x", "scale y", "scale z")
UNITS = ("rad", "rad", "rad", "count", "count", "count", "m/s^2 per count", "m/s^2 per count", "m/s^2 per count")


@value_class(eq=True)
class Setting:
    """One way to do the experiment.

    Attributes
    ----------
    name : in words
    scenario : the same for the simulation
    table_1 : the sigmas that Angrisano states for it: angles [rad], biases [count], scale factors [m/s^2 per count]
    """

    name: str
    scenario: PoseScenario
    table_1: tuple[float, float, float] | None = None


_MINUTE = np.pi / 180 / 60

SETTINGS = (
    Setting(
        name="wedge, 1 deg",
        scenario=PoseScenario(attitude_error_deg=1.0, accelerometer_noise_density=2.7e-3),
        table_1=(1.0 * _MINUTE, 0.6, 2.6e-7),
    ),
    Setting(
        name="no support, 10 deg",
        scenario=PoseScenario(attitude_error_deg=10.0, accelerometer_noise_density=5.5e-3),
        table_1=(2.5 * _MINUTE, 1.3, 5.0e-7),
    ),
    Setting(
        name="10 deg, noise of the first",
        scenario=PoseScenario(attitude_error_deg=10.0, accelerometer_noise_density=2.7e-3),
    ),
)
"""Angrisano's two sets of poses, at the noise that its sigmas imply, and what the attitudes alone change."""


@value_class
class AngrisanoSample:
    """All runs of one setting.

    Attributes
    ----------
    setting : how the experiment was done
    outcomes : one for each run
    """

    setting: Setting
    outcomes: tuple[AngrisanoOutcome, ...]

    def stacked(self, name: str) -> Floats:
        """Return one attribute of the outcomes, (runs, ...)."""
        return np.array([getattr(outcome, name) for outcome in self.outcomes])

    def scatter(self, name: str) -> Floats:
        """Return the rms error of the estimates (runs, 9) of that name, (9,)."""
        return np.sqrt(np.mean((self.stacked(name) - TRUTH) ** 2, axis=0))

    def sigma(self, name: str) -> Floats:
        """Return the rms of the sigmas that a method states, (9,)."""
        return np.sqrt(np.mean(self.stacked(f"{name}_sigma") ** 2, axis=0))

    def ratio(self, name: str) -> Floats:
        """Return stated sigma over scatter, (9,)."""
        return self.sigma(name) / self.scatter(name)

    @property
    def iterations(self) -> Counter[int]:
        """How often Angrisano's method took so many iterations from the datasheet start."""
        return Counter(outcome.iterations for outcome in self.outcomes)


@value_class
class AngrisanoStudy:
    """What the study found.

    Attributes
    ----------
    runs, seed : of each setting, and where the random numbers come from
    samples : one for each of SETTINGS
    basins : of the first runs of the first setting, three each
    journeys : Figs. 4 to 6, of the first run
    """

    runs: int
    seed: int
    samples: tuple[AngrisanoSample, ...]
    basins: tuple[tuple[Basin, ...], ...]
    journeys: tuple[Journey, ...]

    def interval(self, group: int, method: str) -> Floats:
        """Return the medians over the experiments of the ends of a method's interval, (2,)."""
        ends = [basins[group].interval(getattr(basins[group], method)) for basins in self.basins]
        return np.median(np.array(ends), axis=0)


def study_angrisano(
    *, runs: int = 500, scans: int = 8, workers: Workers = HERE, seed: int = 0, progress: Progress | None = None
) -> AngrisanoStudy:
    """Carry out Angrisano's experiment many times.

    Parameters
    ----------
    runs : experiments of each setting
    scans : experiments, of the first ones, in which the starts of Table 2 are scanned
    workers : who does them; the result does not depend on it
    seed : every random number follows from it
    progress : is told what is being done
    """
    drawn = run_seeds(seed, runs)
    trials = [AngrisanoTrial(scenario=setting.scenario, seed=number) for setting in SETTINGS for number in drawn]
    outcomes = carry_out(run_angrisano_trial, trials, workers=workers, progress=progress, name="experiment")
    basins = carry_out(
        scan_basins, trials[: min(runs, scans)], workers=workers, progress=progress, name="scan of starts"
    )
    samples = tuple(
        AngrisanoSample(setting=setting, outcomes=tuple(outcomes[k * runs : (k + 1) * runs]))
        for k, setting in enumerate(SETTINGS)
    )
    return AngrisanoStudy(
        runs=runs, seed=seed, samples=samples, basins=tuple(basins), journeys=trace_journeys(trials[0])
    )


def angrisano_claims(study: AngrisanoStudy) -> Iterator[Claim]:
    """Yield what Angrisano says and gnomon promises, and whether the study agrees."""
    for method, whose in (("paper", "Angrisano's"), ("ours", "Gnomon's")):
        ratios = np.concatenate([sample.ratio(method) for sample in study.samples])
        yield sigmas_claim(f"{whose} sigmas agree with the scatter", ratios, study.runs)
    yield from _table_1(study)
    yield from _convergence(study)


def _table_1(study: AngrisanoStudy) -> Iterator[Claim]:
    allowed = 1.25 + 3 / np.sqrt(18 * study.runs)  # nine redundant equations a run
    for sample in study.samples:
        if sample.setting.table_1 is not None:
            stated = np.array(sample.setting.table_1)
            found = angrisano_group_rms(sample.sigma("paper")) / stated
            noise = sample.setting.scenario.accelerometer_noise_density
            yield Claim(
                claim=f"Table 1's sigmas, {sample.setting.name}, at a noise of {1e3 * noise:g} mm/s^2 of each mean",
                expected=f"sigmas over those of Table 1 {1 / allowed:.2f} to {allowed:.2f}",
                found=", ".join(f"{group} {ratio:.2f}" for group, ratio in zip(GROUPS, found, strict=True)),
                holds=ratio_agrees(bool(np.abs(np.log(found)).max() < np.log(allowed)), 1 / allowed, allowed),
            )
    close, rough = study.samples[0], study.samples[2]
    change = rough.scatter("paper") / close.scatter("paper")
    allowed = 1.25 + 4 / np.sqrt(2 * study.runs)
    yield Claim(
        claim="Roughly known attitudes do: 10 deg as good as 1 deg at the same noise (C7)",
        expected=f"scatter of both alike, ratio {1 / allowed:.2f} to {allowed:.2f}",
        found=f"ratio {change.min():.2f} to {change.max():.2f}",
        holds=ratio_agrees(bool(np.abs(np.log(change)).max() < np.log(allowed)), 1 / allowed, allowed),
    )


def _convergence(study: AngrisanoStudy) -> Iterator[Claim]:
    everything = [outcome for sample in study.samples for outcome in sample.outcomes]
    taken = Counter(outcome.iterations for outcome in everything)
    few = sum(count for number, count in taken.items() if number in (4, 5))
    converged = sum(outcome.status == "converged" for outcome in everything)
    yield Claim(
        claim="4 to 5 iterations from the datasheet start (12)",
        expected=f"{len(everything)} of {len(everything)} runs",
        found=f"{few}; {converged} in the right minimum",
        holds=few == converged == len(everything),
    )
    same = sum(outcome.same_minimum for outcome in everything)
    theirs = sum(outcome.paper_from_start == "converged" for outcome in everything)
    yield Claim(
        claim="Gnomon ends in the same minimum from starts drawn in Table 2's intervals widened threefold",
        expected=f"{len(everything)} of {len(everything)}",
        found=f"{same}; Angrisano's iteration {theirs}",
        holds=same == len(everything),
    )
    whole = [bool(basin.ours.all()) for basins in study.basins for basin in basins]
    yield Claim(
        claim="And from starts along each group of parameters, as far",
        expected=f"{len(whole)} of {len(whole)} scans",
        found=f"{sum(whole)}",
        holds=all(whole),
    )
    ratios = np.array([study.interval(group, "paper") / TABLE_2[group] for group in range(3)])
    yield Claim(
        claim="Table 2: the iteration converges from intervals of this size about the datasheet start, lopsided ones",
        expected="ends over those of Table 2 about 1, 0.33 to 3",
        found=", ".join(f"{group} {low:.2f} and {high:.2f}" for group, (low, high) in zip(GROUPS, ratios, strict=True)),
        holds=bool(ratios.min() > 1 / 3 and ratios.max() < 3),
    )


def angrisano_group_rms(values: Floats) -> Floats:
    """Return the rms of angles, of biases and of scale factors, (3,), of values (9,)."""
    return np.sqrt(np.mean(values.reshape(3, 3) ** 2, axis=1))


def angrisano_tables(study: AngrisanoStudy) -> Iterator[StudyTable]:
    """Yield all numbers of the study."""
    yield claims_table(angrisano_claims(study))
    yield StudyTable(
        name="parameters",
        head=("setting", "parameter", "unit", "truth", "paper_sigma", "paper_scatter", "ours_sigma", "ours_scatter",
              "components_scatter"),
        rows=list(_parameter_rows(study)),
    )  # fmt: skip
    yield StudyTable(
        name="runs",
        head=("setting", "run", "iterations", "status", *(f"paper {name} [{unit}]" for name, unit in _NAMED),
              *(f"ours {name} [{unit}]" for name, unit in _NAMED), "paper_from_start", "ours_from_start [sigma]"),
        rows=[
            (sample.setting.name, run, o.iterations, o.status, *o.paper.tolist(), *o.ours.tolist(), o.paper_from_start,
             o.ours_from_start)
            for sample in study.samples for run, o in enumerate(sample.outcomes, 1)
        ],
    )  # fmt: skip
    yield StudyTable(
        name="starts",
        head=("run", "group", "method", "offset", "right_minimum"),
        rows=[
            (run, b.group, method, float(offset), bool(found))
            for run, basins in enumerate(study.basins, 1) for b in basins
            for method, offsets, ended in (("paper", b.offset, b.paper), ("paper_as_printed", b.offset, b.printed),
                                           ("ours", b.ours_offset, b.ours))
            for offset, found in zip(offsets, ended, strict=True)
        ],
    )  # fmt: skip
    yield StudyTable(
        name="iterations",
        head=("start", "iteration", "q [(m/s^2)^4]", *(f"{name} [{unit}]" for name, unit in _NAMED)),
        rows=[
            (journey.name, k, float(journey.fit.q[k - 1]) if k else float("nan"), *X.tolist())
            for journey in study.journeys for k, X in enumerate(journey.fit.visited)
        ],
    )  # fmt: skip


_NAMED = tuple(zip(NAMES, UNITS, strict=True))


def _parameter_rows(study: AngrisanoStudy) -> Iterator[tuple[Cell, ...]]:
    for sample in study.samples:
        columns = (sample.sigma("paper"), sample.scatter("paper"), sample.sigma("ours"), sample.scatter("ours"))
        for k, (name, unit) in enumerate(_NAMED):
            numbers = (TRUTH[k], *(column[k] for column in columns), sample.scatter("components")[k])
            yield sample.setting.name, name, unit, *map(float, numbers)
