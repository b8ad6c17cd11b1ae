"""What document A says of its simulations and gnomon promises, and whether the study agrees."""

from collections.abc import Iterator

import numpy as np

from ..recording import Floats
from .runs import scatter_bounds
from .tables import Cell, Claim, StudyTable, claims_table, told
from .tedaldi import TedaldiStudy, known_mean
from .tedaldi_metrics import SignalErrors
from .tedaldi_thesis import ACCELEROMETER, DIVERGENCE, GROUPS, GYROSCOPE, MEAN_ERROR, ROTATION, SPREAD, UNITS
from .tedaldi_trial import METHODS, SCENARIO, Method

GYROSCOPE_SHARE = 0.6
"""Gnomon's errors of the gyroscope over those of document A, at most."""

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


def claims(study: TedaldiStudy) -> Iterator[Claim]:
    """Yield what document A says and gnomon promises, and whether the study agrees."""
    failed = [len(study.failures(method)) for method in METHODS]
    total = sum(len(outcomes) for outcomes in study.outcomes)
    yield Claim(
        claim="Every recording is calibrated",
        expected=f"{total} of {total} by gnomon",
        found=f"{total - failed[0]}; as printed {total - failed[1]}; by the authors' script {total - failed[2]}",
        holds=failed[0] == 0,
    )
    yield from _parameters(study)
    yield from _sigmas(study)
    yield from _signals(study)


def _parameters(study: TedaldiStudy) -> Iterator[Claim]:
    found = dict(zip(GROUPS, group_errors(study, "gnomon"), strict=True))
    for sensor, share, motion in (
        ("accelerometer", 1.0, ""),
        ("gyroscope", GYROSCOPE_SHARE, ", with motions of 1.5 to 3 s at up to 1.5 rad/s about two axes each"),
    ):
        limits = {name: share * theirs for name, (_, theirs) in GROUPS.items() if name.startswith(sensor)}
        most = "those of document A" if share == 1 else f"{share:g} of document A's"
        yield Claim(
            claim=f"Mean absolute errors of the {sensor} are at most {most}{motion} (Tables 4.1, 4.2, all sets)",
            expected=", ".join(f"{name.split()[1]} {1e3 * limit:.4f}" for name, limit in limits.items()) + ", x 1e-3",
            found=", ".join(f"{name.split()[1]} {1e3 * found[name]:.4f}" for name in limits),
            holds=all(found[name] <= limit for name, limit in limits.items()),
        )


def _sigmas(study: TedaldiStudy) -> Iterator[Claim]:
    least, most = scatter_bounds(sum(len(outcomes) for outcomes in study.outcomes), 0.15)
    ratios = sigma_over_scatter(study, "gnomon")
    yield Claim(
        claim="Gnomon's sigmas agree with the scatter, each of the 18 parameters",
        expected=f"sigma over scatter {least:.2f} to {most:.2f}",
        found=f"{np.min(ratios):.3f} to {np.max(ratios):.3f}",
        holds=told(bool(np.min(ratios) > least and np.max(ratios) < most), least, most),
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


def tables(study: TedaldiStudy) -> Iterator[StudyTable]:
    """Yield all numbers of the study."""
    yield claims_table(claims(study))
    yield StudyTable(
        name="parameters",
        head=("set", "method", "parameter", "unit", "truth", "mean", "spread", "mean_absolute_error", "sigma"),
        rows=list(_parameter_rows(study)),
    )
    yield StudyTable(
        name="document_a",
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
    for name in SignalErrors.__slots__:
        parts = ("x", "y", "z") if name in ("force", "rate") else ("mean", "largest")
        for part in parts:
            yield name, f"{part} [{units.get(name, 'rad')}]"


def _signal_rows(study: TedaldiStudy) -> Iterator[tuple[Cell, ...]]:
    for method in _BEFORE:
        values = np.concatenate([study.signals(method, name) for name in SignalErrors.__slots__], axis=2)
        for number, recordings in enumerate(values, 1):
            for run, row in enumerate(recordings, 1):
                yield number, run, method or "uncalibrated", *map(float, row)
