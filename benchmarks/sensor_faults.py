"""Faults of magnetometers, resting IMUs, turntables and poses: does a wrong result ever pass, does a right one warn?

    python benchmarks/sensor_faults.py                        every case, 12 seeds each, some ten minutes
    python benchmarks/sensor_faults.py magnetometer --seeds 4

One row a case: verdicts, the largest error in sigmas, and `missed`: results that pass with an error beyond 4 sigma and
beyond what is needed. Rows of healthy recordings count warnings. The sensors and the faults are drawn from the seeds.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import gnomon
from gnomon.errors import GnomonError
from gnomon.recording import Recording
from gnomon.simulate import FieldScenario, simulate_magnetometer

Floats = NDArray[np.float64]
_BEYOND = 4.0  # sigmas


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Of one recording: verdict ("refused" where there is none), codes of warnings, error in sigmas, and in needs."""

    verdict: str
    codes: tuple[str, ...] = ()
    sigmas: float = 0.0
    needs: float = 0.0

    @property
    def missed(self) -> bool:
        """Whether a wrong result passed."""
        return self.verdict == "pass" and self.sigmas > _BEYOND and self.needs > 1


Case = Callable[[int], Outcome]


def tried(
    result: Callable[[], "gnomon.Result"], error: Callable[["gnomon.Calibration"], tuple[Floats, Floats, Floats]]
):
    """Return the outcome of a calibration; `error` gives errors, sigmas and what is needed."""
    try:
        calibration = result().calibration
    except GnomonError:
        return Outcome(verdict="refused")
    off, sigma, need = (np.concatenate([np.ravel(part) for part in parts]) for parts in error(calibration))
    known = sigma > 0
    worst = float(np.max(np.abs(off[known]) / sigma[known], initial=0.0))
    if (np.abs(off[~known]) > need[~known]).any():
        worst = np.inf
    return Outcome(
        verdict=calibration.verdict,
        codes=tuple(f.code for f in calibration.assessment.findings if f.severity in ("warning", "problem")),
        sigmas=worst,
        needs=float(np.max(np.abs(off) / need)),
    )


# ---- magnetometers

_FIELD_UT = 48.0


def _with_magnetometer(recording: Recording, values: Floats, unit: str | None = None) -> Recording:
    imu = recording.imus["imu0"]
    assert imu.magnetometer is not None
    changed = replace(imu.magnetometer, values=values, unit=unit or imu.magnetometer.unit)
    return replace(recording, imus={"imu0": replace(imu, magnetometer=changed)})


def _field_outcome(
    seed: int, scenario: FieldScenario, edit: Callable[[Floats, np.random.Generator], Floats], **options
) -> Outcome:
    recording, truth = simulate_magnetometer(scenario, seed)
    imu = recording.imus["imu0"]
    assert imu.magnetometer is not None
    edited = _with_magnetometer(recording, edit(imu.magnetometer.values, np.random.default_rng(seed)))
    names = "imu0.magnetometer.sensitivity", "imu0.magnetometer.bias"

    def error(found: gnomon.Calibration) -> tuple[list[Floats], list[Floats], list[Floats]]:
        off = [found.parameter(name) - truth.parameter(name) for name in names]
        if found.frame != truth.frame:  # only lengths compare
            off[0] = found.parameter(names[0]) @ found.parameter(names[0]).T
            off[0] = np.diag(off[0] - truth.parameter(names[0]) @ truth.parameter(names[0]).T) * np.eye(3) / 2
        return off, [found.sigma(name) for name in names], [np.full((3, 3), 0.02), np.full(3, 0.02 * _FIELD_UT)]

    wanted = gnomon.MagnetometerOptions(field=_FIELD_UT, **options)
    return tried(lambda: gnomon.calibrate_magnetometer(edited, wanted), error)


def _mirrored(values: Floats, rng: np.random.Generator) -> Floats:
    kind = int(rng.integers(0, 6))
    if kind < 3:
        return values * np.where(np.arange(3) == kind, -1.0, 1.0)
    order = [[1, 0, 2], [0, 2, 1], [2, 1, 0]][kind - 3]
    return values[:, order]


def _stepped(size_ut: float) -> Callable[[Floats, np.random.Generator], Floats]:
    def edit(values: Floats, rng: np.random.Generator) -> Floats:
        later = np.arange(len(values)) > rng.uniform(0.3, 0.7) * len(values)
        return values + later[:, None] * size_ut * rng.standard_normal(3)

    return edit


def _same(values: Floats, rng: np.random.Generator) -> Floats:
    del rng
    return values


def magnetometer_cases() -> Iterator[tuple[str, Case]]:
    """Yield cases by name."""
    for soft in (0.005, 0.02, 0.05):
        scenario = FieldScenario(soft_iron=soft, inhomogeneity=0.3, rests=8, duration_s=60.0)
        yield f"soft iron {soft}, auto", lambda seed, s=scenario: _field_outcome(seed, s, _same)
        yield (
            f"soft iron {soft}, hard-iron",
            lambda seed, s=scenario: _field_outcome(seed, s, _same, model="hard-iron"),
        )
    north = FieldScenario(rests=8, inhomogeneity=0.2)
    yield "axis mirrored, --latitude", lambda seed: _field_outcome(seed, north, _mirrored, latitude=48.0)
    south = replace(north, dip_deg=-50.0)
    yield "axis mirrored, south, --dip", lambda seed: _field_outcome(seed, south, _mirrored, dip=-50.0)
    yield "axis mirrored, nothing stated", lambda seed: _field_outcome(seed, north, _mirrored)
    for size in (1.0, 5.0):
        yield f"hard iron changes by {size} uT", lambda seed, size=size: _field_outcome(seed, north, _stepped(size))
    yield "healthy: south, --dip", lambda seed: _field_outcome(seed, south, _same, dip=-50.0)
    yield "healthy: with accelerometer", lambda seed: _field_outcome(seed, north, _same)
    alone = FieldScenario(accelerometer=False, inhomogeneity=0.3)
    yield "healthy: alone", lambda seed: _field_outcome(seed, alone, _same)


KINDS: dict[str, Callable[[], Iterator[tuple[str, Case]]]] = {"magnetometer": magnetometer_cases}


def main() -> None:
    """Print one row a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", help=f"of {', '.join(KINDS)}; all where none is named")
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--only", default="", help="part of the name of a case")
    stated = parser.parse_args()
    for kind in stated.kinds or KINDS:
        print(f"## {kind}\n")
        for name, case in KINDS[kind]():
            if stated.only not in name:
                continue
            outcomes = [case(seed) for seed in range(stated.first, stated.first + stated.seeds)]
            verdicts = Counter(outcome.verdict for outcome in outcomes)
            codes = Counter(code for outcome in outcomes for code in outcome.codes)
            worst = sorted((o.sigmas for o in outcomes if o.verdict != "refused"), reverse=True)[:3]
            print(
                f"{name:38s} {dict(verdicts)}  missed {sum(o.missed for o in outcomes)}  "
                f"worst {', '.join(f'{z:.1f}' for z in worst)}  {dict(codes)}",
                flush=True,
            )
        print()


if __name__ == "__main__":
    main()
