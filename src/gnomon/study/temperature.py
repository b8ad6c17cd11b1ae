"""Biases over the temperature: gnomon beside the methods of PX4 and ArduPilot, on warm-ups that none of them saw.

draw a sensor, its thermometer and five warm-ups -> four of them through each method -> the change of the bias over the
fifth -> sensors that do not change, or whose temperature is steady
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..calibrate.temperature import calibrate_temperature
from ..frozen import value_class
from ..recording import Floats
from ..recording.thermometer import temperature_course
from ..results.temperature import TemperatureResult
from ..simulate.scenarios.recorded import TemperatureScenario
from ..simulate.temperature import TemperatureSimulation, simulate_temperature
from .runs import HERE, Claim, Progress, StudyTable, Workers, carry_out, claims_table, run_seeds

METHODS = ("gnomon", "PX4", "ArduPilot")
"""PX4: a cubic by least squares through all samples, with the temperature as read (process_sensor_caldata.py, by its
description). ArduPilot: a cubic through means of two seconds (INS_TCAL, by its documentation)."""
CHIPS = {"MPU-6050": (8.7e-5, 3.9e-3, 7e-5), "BMI088": (2.4e-4, 1.7e-3, 1e-5)}
"""White noise of gyroscope and accelerometer as of the data sheets, 0.005 and 0.014 deg/s/sqrt(Hz), 400 and 175
ug/sqrt(Hz), and the gyroscope's bias instability [SI]."""
_EVERY_S = {"PX4": 0.0, "ArduPilot": 2.0}
_AT, _NEAR_DEGC = 200, 35.0
_HEALTHY_SHARE = 2


@value_class
class TemperatureTask:
    """One sensor.

    Attributes
    ----------
    seed : every random number follows from it
    changes : whether its biases change with the temperature
    """

    seed: int
    changes: bool = True


@value_class
class TemperatureRun:
    """What became of one sensor.

    Attributes
    ----------
    order, found : of the gyroscope's polynomials, true and found
    lag_s, step_k : of its thermometer
    errors : (3,) rms error of the change of the gyroscope's bias over the warm-up left out, by METHODS [rad/s]
    z : rms error of gnomon's over its standard deviation; nan where no change was found
    """

    order: int
    found: int
    lag_s: float
    step_k: float
    errors: Floats
    z: float


@value_class
class TemperatureStudy:
    """What the study found.

    Attributes
    ----------
    runs, seed : sensors, and where the random numbers come from
    outcomes, healthy : of those that change, and of as many that do not or stay at one temperature, by `_HEALTHY_SHARE`
    """

    runs: int
    seed: int
    outcomes: tuple[TemperatureRun, ...]
    healthy: tuple[TemperatureRun, ...]

    @property
    def errors(self) -> Floats:
        """Errors of every sensor, (runs, 3) in the order of METHODS [rad/s]."""
        return np.array([outcome.errors for outcome in self.outcomes])

    @property
    def rms(self) -> Floats:
        """Rms over the sensors, (3,) [rad/s]."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)), dtype=np.float64)

    @property
    def z_rms(self) -> float:
        """Rms of gnomon's errors in their standard deviations."""
        return float(np.sqrt(np.nanmean([outcome.z**2 for outcome in self.outcomes])))


def study_temperature(
    *, runs: int = 100, workers: Workers = HERE, seed: int = 0, progress: Progress | None = None
) -> TemperatureStudy:
    """Carry out the study.

    Parameters
    ----------
    runs : sensors that change; half as many do not
    workers : who does them; the result does not depend on it
    seed : every random number follows from it
    progress : is told what is being done
    """
    drawn = run_seeds(seed, runs + runs // _HEALTHY_SHARE)
    tasks = [TemperatureTask(seed=number, changes=i < runs) for i, number in enumerate(drawn)]
    found = carry_out(run_temperature, tasks[:runs], workers=workers, progress=progress, name="sensor")
    healthy = carry_out(
        run_temperature, tasks[runs:], workers=workers, progress=progress, name="sensor that does not change"
    )
    return TemperatureStudy(runs=runs, seed=seed, outcomes=tuple(found), healthy=tuple(healthy))


def draw_scenario(rng: np.random.Generator, order: int) -> TemperatureScenario:
    """Return a sensor, its thermometer, and five warm-ups of 15 minutes."""
    gyroscope, accelerometer, instability = CHIPS[str(rng.choice(list(CHIPS)))]
    return TemperatureScenario(
        gyroscope_white_noise=gyroscope,
        accelerometer_white_noise=accelerometer,
        gyroscope_bias_instability=instability,
        recordings=5,
        rate_hz=20.0,
        duration_s=900.0,
        order=order,
        start_degc=float(rng.uniform(-5, 15)),
        end_degc=float(rng.uniform(45, 60)),
        time_constant_s=float(rng.uniform(120, 300)),
        lag_s=float(rng.choice([0.0, 10.0, 30.0, 60.0])),
        step_k=float(rng.choice([0.01, 0.1, 0.5, 1.0])),
        gyroscope_turn_on=float(rng.choice([1e-4, 1e-3])),
    )


def run_temperature(task: TemperatureTask) -> TemperatureRun:
    """Simulate one sensor, calibrate it by each method, and foretell the warm-up that was left out."""
    rng = np.random.default_rng(task.seed)
    order = int(rng.integers(0, 4)) if task.changes else 0
    scenario = draw_scenario(rng, order)
    if not task.changes:
        scenario = replace(scenario, recordings=3)
        if task.seed % 2:
            scenario = replace(scenario, start_degc=25.0, end_degc=25.4)
    made = simulate_temperature(scenario, task.seed % 2**31)
    result = calibrate_temperature(made.recordings[:-1])
    errors, z = _errors(made, result)
    return TemperatureRun(
        order=order,
        found=max(triad.order for triad in result.triads.values())
        if not task.changes
        else result.triads["gyroscope"].order,
        lag_s=scenario.lag_s,
        step_k=scenario.step_k,
        errors=errors,
        z=z,
    )


def _errors(made: TemperatureSimulation, result: TemperatureResult) -> tuple[Floats, float]:
    """Return the rms error of each method [rad/s], means left out, and that of gnomon's in sigmas."""
    found = result.calibration.imus["imu0"].temperature
    left_out = made.recordings[-1].imus["imu0"]
    assert found is not None
    assert left_out.temperature is not None
    at = np.linspace(0, len(left_out.gyroscope) - 1, _AT).astype(int)
    truth = _centred(made.truth.change("gyroscope_bias", made.degc[-1][at]))
    course = temperature_course(left_out.temperature, found.lag_s)
    assert course is not None
    degc = course.at(left_out.gyroscope.t_ns[at])
    ours = _centred(found.change("gyroscope_bias", degc))
    read = left_out.temperature.values[at] - _NEAR_DEGC
    foretold = {
        name: _centred(np.vander(read, 4, increasing=True) @ _cubic(made, every_s))
        for name, every_s in _EVERY_S.items()
    }
    off = [ours - truth, *(foretold[name] - truth for name in METHODS[1:])]
    z = float("nan")
    if found.gyroscope_bias is not None:
        covariance = result.calibration.covariance("imu0.temperature.gyroscope_bias")
        powers = np.vander(degc - found.reference_degc, len(found.gyroscope_bias) + 1, increasing=True)[:, 1:]
        powers = _centred(powers)
        variance = [np.einsum("ij,jk,ik->i", powers, covariance[axis::3, axis::3], powers) for axis in range(3)]
        z = float(np.sqrt(np.mean(off[0] ** 2) / np.mean(variance)))
    return np.array([float(np.sqrt(np.mean(one**2))) for one in off]), z


def _centred(values: Floats) -> Floats:
    """Return values without their mean, which belongs to the switching-on."""
    return np.asarray(values - values.mean(axis=0), dtype=np.float64)


def _cubic(made: TemperatureSimulation, every_s: float) -> Floats:
    """Return the coefficients (4, 3) of a cubic through samples, or means of so many seconds, by what was read."""
    x, y = list[Floats](), list[Floats]()
    for recording in made.recordings[:-1]:
        imu = recording.imus["imu0"]
        assert imu.temperature is not None
        read, values = imu.temperature.values, imu.gyroscope.values
        if every_s:
            parts = int(imu.gyroscope.duration_s / every_s)
            read, values = (
                np.array([part.mean(axis=0) for part in np.array_split(one, parts)]) for one in (read, values)
            )
        x.append(read)
        y.append(values)
    cubic = np.polynomial.polynomial.polyfit(np.concatenate(x) - _NEAR_DEGC, np.concatenate(y), 3)
    return np.asarray(cubic, dtype=np.float64)


_FEWEST = 20
"""Sensors from which on shares and ratios tell something."""
_RIGHT, _STAYS, _SIGMAS, _SMALLER = 0.95, 0.975, 1.2, 3.0


def temperature_claims(study: TemperatureStudy) -> Iterator[Claim]:
    """Yield what gnomon promises, and what the study found."""
    right = np.array([outcome.order == outcome.found for outcome in study.outcomes])
    stays = np.array([outcome.found == 0 for outcome in study.healthy])
    ratios = study.rms[1:] / study.rms[0]

    def told(holds: bool, count: int) -> bool | None:
        return holds if count >= _FEWEST else None

    yield Claim(
        claim="the order of the polynomials is found",
        expected=f"in {100 * _RIGHT:.0f} % or more",
        found=f"in {right.sum()} of {len(right)}",
        holds=told(bool(right.mean() >= _RIGHT), len(right)),
    )
    yield Claim(
        claim="a sensor that does not change, or whose temperature is steady, keeps order 0",
        expected=f"in {100 * _STAYS:.1f} % or more",
        found=f"in {stays.sum()} of {len(stays)}",
        holds=told(bool(stays.mean() >= _STAYS), len(stays)),
    )
    yield Claim(
        claim="standard deviations are those of the errors in a warm-up that was left out",
        expected=f"errors of {_SIGMAS:g} sigma rms or less",
        found=f"{study.z_rms:.2f} sigma",
        holds=told(study.z_rms <= _SIGMAS, len(right)),
    )
    for name, ratio in zip(METHODS[1:], ratios, strict=True):
        yield Claim(
            claim=f"errors in a warm-up that was left out are smaller than by the method of {name}",
            expected=f"{_SMALLER:g} times or more",
            found=f"{ratio:.1f} times",
            holds=told(bool(ratio >= _SMALLER), len(right)),
        )


def temperature_tables(study: TemperatureStudy) -> Iterator[StudyTable]:
    """Yield the tables."""
    yield claims_table(temperature_claims(study))
    yield StudyTable(
        name="warm_ups",
        head=("kind", "order", "order_found", "lag_s", "step_k", *(f"error_{name}_rad_s" for name in METHODS), "z"),
        rows=[
            (kind, one.order, one.found, one.lag_s, one.step_k, *one.errors.tolist(), one.z)
            for kind, outcomes in (("changes", study.outcomes), ("healthy", study.healthy))
            for one in outcomes
        ],
    )
