"""Tedaldi's simulations: 40 sensors of 30 recordings each, Tables 4.1 to 4.5, and gnomon beside what was published.

simulate the signals of section 4.1 -> gnomon's recipe, Algorithm 1 as printed, the authors' script -> metrics 1 to 4

The claims are what Tedaldi 2014 found (Tables 4.1 to 4.5, set 1 and means over 40 sets).
"""

from collections.abc import Iterator

import numpy as np

from ..calibrate.imu import calibrate_imu
from ..frozen import field_names, value_class
from ..options import ImuOptions
from ..recording import Floats
from ..results.sensor_diagnostics import ImuDiagnostics
from ..simulate.imu import simulate_imu
from .runs import HERE, Cell, Claim, Progress, StudyTable, Workers, carry_out, claims_table, run_seeds, sigmas_claim
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


ACCELEROMETER = ("a_yz", "a_zy", "a_zx", "s_x", "s_y", "s_z", "b_x", "b_y", "b_z")
GYROSCOPE = ("g_yz", "g_zy", "g_xz", "g_zx", "g_xy", "g_yx", "s_x", "s_y", "s_z")
UNITS = ("rad",) * 3 + ("1",) * 3 + ("m/s^2",) * 3 + ("rad",) * 6 + ("1",) * 3
"""Of both vectors, Eqs. (3.2) and (3.6), one after the other."""

SPREAD = 1e-3 * np.array([
    0.0481, 0.0401, 0.0296, 0.0327, 0.0304, 0.0215, 0.1369, 0.2138, 0.1332,
    0.8547, 0.4419, 1.0630, 0.4102, 0.8154, 0.7250, 0.4121, 0.4059, 0.4216,
])  # fmt: skip
"""Standard deviation of the estimates of set 1 (Tables 4.1 and 4.2) over 30 signals."""

MEAN_ERROR = 1e-3 * np.array([
    0.0398, 0.0334, 0.0248, 0.0265, 0.0258, 0.0178, 0.1163, 0.1760, 0.0953,
    0.6392, 0.3468, 0.9080, 0.3386, 0.6375, 0.7315, 0.3366, 0.3353, 0.3410,
])  # fmt: skip
"""Mean absolute error of the estimates of set 1."""

GROUPS = {
    "accelerometer misalignment": (slice(0, 3), 0.0335e-3),
    "accelerometer scale": (slice(3, 6), 0.0206e-3),
    "accelerometer bias": (slice(6, 9), 0.1447e-3),
    "gyroscope misalignment": (slice(9, 15), 0.638e-3),
    "gyroscope scale": (slice(15, 18), 0.350e-3),
}
"""Parameters that belong together, and their mean absolute error over all 40 sets."""

SIGNAL_ERROR = {
    "accelerometer": ((0.0842, 0.0564, 0.0635), (0.0055, 0.0056, 0.0056)),
    "gyroscope": ((0.1043, 0.1097, 0.0345), (0.0035, 0.0039, 0.0042)),
}
"""Table 4.3: mean absolute error along x, y, z, uncalibrated and calibrated [m/s^2], [rad/s]."""

DIVERGENCE = {
    "uncalibrated": ((0.0665, 0.2133, 0.0623, 0.2098), (0.0114, 0.0226, 0.0115, 0.0240)),
    "calibrated": ((0.0056, 0.0299, 0.0056, 0.0298), (0.0009, 0.0035, 0.0009, 0.0038)),
}
"""Table 4.4: mean and largest, and both in the worst case [m/s^2]; the same as an angle [rad]."""

ROTATION = {
    "uncalibrated": ((4.7125, 9.2930, 5.2859, 8.5822), (0.5494, 0.6029)),
    "calibrated": ((0.2208, 0.4469, 0.5102, 0.8597), (0.0256, 0.0569)),
}
"""Table 4.5: mean and largest, and both in the worst case [m/s^2]; angle, and in the worst case [rad]."""

GYROSCOPE_SHARE = 0.6
"""Gnomon's errors of the gyroscope over those of Tedaldi 2014, at most."""

NAMES = (*(f"accelerometer {name}" for name in ACCELEROMETER), *(f"gyroscope {name}" for name in GYROSCOPE))

_BEFORE = (None, *METHODS)


def group_errors(study: TedaldiStudy, method: Method) -> Floats:
    """Return the mean absolute error of each of GROUPS over all sets, (5,)."""
    errors = known_mean(study.mean_error(method), axis=0)
    return np.array([errors[where].mean() for where, _ in GROUPS.values()])


def sigma_over_scatter(study: TedaldiStudy, method: Method) -> Floats:
    """Return, for each parameter, 1 over the rms of error over stated sigma, (18,)."""
    z = (study.estimates(method) - study.truth[:, None]) / study.sigmas(method)
    return 1 / np.sqrt(known_mean(z**2, axis=(0, 1)))


def noise_alone() -> tuple[float, float]:
    """Return the mean absolute value of one sample's noise [m/s^2] [rad/s]."""
    density = SCENARIO.accelerometer_noise_density, SCENARIO.gyroscope_noise_density
    mean_of_one = np.sqrt(2 / np.pi * SCENARIO.rate_hz)
    return float(density[0] * mean_of_one), float(density[1] * mean_of_one)


def tedaldi_claims(study: TedaldiStudy) -> Iterator[Claim]:
    """Yield what Tedaldi 2014 says and gnomon promises, and whether the study agrees."""
    failed = [len(study.failures(method)) for method in METHODS]
    total = sum(len(outcomes) for outcomes in study.outcomes)
    yield Claim(
        claim="Every recording is calibrated",
        expected=f"{total} of {total} by gnomon",
        found=f"{total - failed[0]}; as printed {total - failed[1]}; by the authors' script {total - failed[2]}",
        holds=failed[0] == 0,
    )
    yield from _parameters(study)
    yield sigmas_claim(
        "Gnomon's sigmas agree with the scatter, each of the 18 parameters",
        sigma_over_scatter(study, "gnomon"),
        sum(len(outcomes) for outcomes in study.outcomes),
    )
    yield from _signals(study)


def _parameters(study: TedaldiStudy) -> Iterator[Claim]:
    found = dict(zip(GROUPS, group_errors(study, "gnomon"), strict=True))
    for sensor, share, motion in (
        ("accelerometer", 1.0, ""),
        ("gyroscope", GYROSCOPE_SHARE, ", with motions of 1.5 to 3 s at up to 1.5 rad/s about two axes each"),
    ):
        limits = {name: share * theirs for name, (_, theirs) in GROUPS.items() if name.startswith(sensor)}
        most = "those of Tedaldi 2014" if share == 1 else f"{share:g} of Tedaldi's"
        yield Claim(
            claim=f"Mean absolute errors of the {sensor} are at most {most}{motion} (Tables 4.1, 4.2, all sets)",
            expected=", ".join(f"{name.split()[1]} {1e3 * limit:.4f}" for name, limit in limits.items()) + ", x 1e-3",
            found=", ".join(f"{name.split()[1]} {1e3 * found[name]:.4f}" for name in limits),
            holds=all(found[name] <= limit for name, limit in limits.items()),
        )


def _signals(study: TedaldiStudy) -> Iterator[Claim]:
    noise = noise_alone()
    force, rate = (study.signals("gnomon", name) for name in ("force", "rate"))
    scale = study.truth[:, 15:18]  # the noise of the readings is multiplied by it
    over = np.array([np.nanmean(force) / noise[0], np.nanmean(rate / scale[:, None]) / noise[1]])
    yield Claim(
        claim="What is left of the signals' errors is noise (Table 4.3)",
        expected="mean absolute error over that of the noise, both sensors, 0.97 to 1.06",
        found=f"accelerometer {over[0]:.3f}, gyroscope {over[1]:.3f}",
        holds=bool(np.all((over > 0.97) & (over < 1.06))),
    )
    found = known_mean(study.signals("gnomon", "divergence"), axis=(0, 1))
    stated = np.array(DIVERGENCE["calibrated"][0][:2])
    yield Claim(
        claim="Divergence from gravity at rest is that of Table 4.4",
        expected=f"mean {stated[0]:.4f} m/s^2 within 3 %, largest {stated[1]:.4f} m/s^2 within 20 %",
        found=f"{found[0]:.4f}, {found[1]:.4f} m/s^2",
        holds=bool(abs(found[0] / stated[0] - 1) < 0.03 and abs(found[1] / stated[1] - 1) < 0.2),
    )
    drift, printed, script = (np.nanmean(study.signals(method, "drift_angle")[..., 0]) for method in METHODS)
    angle = ROTATION["calibrated"][1][0]
    yield Claim(
        claim="Gravity carried by the gyroscope through the whole recording stays closer than in Table 4.5",
        expected=f"mean angle below {angle:.4f} rad",
        found=f"{drift:.4f} rad; as printed {printed:.4f}, by the authors' script {script:.4f}",
        holds=bool(drift < angle),
    )
    once = [float(np.nanmean(study.signals(method, "rotation_angle")[..., 0])) for method in METHODS]
    yield Claim(
        claim="And over a single rotation closer than by either published form",
        expected=f"mean angle below {min(once[1:]):.5f} rad",
        found=f"{once[0]:.5f} rad",
        holds=once[0] < min(once[1:]),
    )


def tedaldi_tables(study: TedaldiStudy) -> Iterator[StudyTable]:
    """Yield all numbers of the study."""
    yield claims_table(tedaldi_claims(study))
    yield StudyTable(
        name="parameters",
        head=("set", "method", "parameter", "unit", "truth", "mean", "spread", "mean_absolute_error", "sigma"),
        rows=list(_parameter_rows(study)),
    )
    yield StudyTable(
        name="tedaldi_2014",
        head=("parameter", "unit", "spread", "mean_absolute_error"),
        rows=[
            (name, unit, float(spread), float(error))
            for name, unit, spread, error in zip(NAMES, UNITS, SPREAD, MEAN_ERROR, strict=True)
        ],
    )
    yield StudyTable(
        name="signals",
        head=("set", "recording", "method", *(f"{name} {part}" for name, part in _signal_columns())),
        rows=list(_signal_rows(study)),
    )


def _parameter_rows(study: TedaldiStudy) -> Iterator[tuple[Cell, ...]]:
    for method in METHODS:
        columns = (
            study.truth,
            known_mean(study.estimates(method), axis=1),
            study.spread(method),
            study.mean_error(method),
            np.sqrt(known_mean(study.sigmas(method) ** 2, axis=1)),
        )
        for number in range(len(study.outcomes)):
            for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
                yield number + 1, method, name, unit, *(float(column[number, k]) for column in columns)


def _signal_columns() -> Iterator[tuple[str, str]]:
    units = {"force": "m/s^2", "rate": "rad/s", "divergence": "m/s^2", "rotation": "m/s^2", "drift": "m/s^2"}
    for name in field_names(SignalErrors):
        parts = ("x", "y", "z") if name in ("force", "rate") else ("mean", "largest")
        for part in parts:
            yield name, f"{part} [{units.get(name, 'rad')}]"


def _signal_rows(study: TedaldiStudy) -> Iterator[tuple[Cell, ...]]:
    for method in _BEFORE:
        values = np.concatenate([study.signals(method, name) for name in field_names(SignalErrors)], axis=2)
        for number, recordings in enumerate(values, 1):
            for run, row in enumerate(recordings, 1):
                yield number, run, method or "uncalibrated", *map(float, row)
