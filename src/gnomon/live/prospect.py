"""What the recording so far would tell, and which attitude would add most to it."""

from collections.abc import Mapping
from dataclasses import field, replace
from itertools import product

import numpy as np

from ..assess.checks.imu_checks import distinct_attitudes, find_imu_rests
from ..assess.needs import needs_of_use
from ..calibrate.predicted import NominalFit, nominal_fit, predicted_calibration, with_one_more_rest
from ..calibrate.steps.preparation import weighted_stream
from ..detect.samples.faults import repair_samples, saturated_samples
from ..errors import GnomonError, SolveError
from ..estimate.multiposition.problem import MultiPositionProblem, build_problem, gyroscope_intervals
from ..frozen import value_class
from ..models.gravity import EARTH_RATE_RAD_S
from ..options.requirements import Use
from ..readers.samples.recognise import turning_of_gravity
from ..recording import Floats, ImuSamples
from ..recording.samples import consumer_mems
from ..results.calibration import UNSTATED_GRAVITY, Calibration, Provenance
from ..results.result import Booleans, StaticIntervals, interval_means
from ..results.trust import Need
from ..units import GYROSCOPE_UNITS_RAD_S

DIRECTIONS = np.array([row for row in product((-1.0, 0.0, 1.0), repeat=3) if any(row)])
"""Faces, edges and corners of a box, (26, 3), not of unit length."""
_UNIT = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
_FACES = _UNIT[np.count_nonzero(DIRECTIONS, axis=1) == 1]
_APART = np.cos(np.radians(35.0))
_FEWEST, _ATTITUDES = 7, 12
_PREDICTED = Provenance(method="live")


@value_class
class Prospect:
    """What the rests so far would tell.

    Attributes
    ----------
    up : (n, 3) direction of the specific force in the sensor, in each rest that can be used
    needs : what the use needs, and what would be reached; none as long as attitudes are too few to tell
    target : (3,) direction that shall point up next
    """

    up: Floats = field(default_factory=lambda: np.empty((0, 3)))
    needs: tuple[Need, ...] = ()
    target: Floats | None = None


def look_ahead(imu: ImuSamples, use: Use, factors: Mapping[str, float] | None = None) -> Prospect:
    """Return what the rests of a recording would tell.

    Parameters
    ----------
    imu : samples so far, of both triads
    use : what they are for
    factors : block -> by how much a calibration was less sure of it than was foreseen
    """
    found = find_imu_rests(imu)
    if found is None or not len(found.chosen.rests):
        return Prospect()
    rests, samples = found.chosen.rests, found.motion.samples
    still = rests.intervals
    means = interval_means(samples.values, still)
    up = means / np.linalg.norm(means, axis=1, keepdims=True)
    before = Prospect(up=up, target=_unlike(up))
    if len(up) < _FEWEST or np.linalg.matrix_rank(up, tol=0.5) < 3:
        return before
    alike = np.max(_UNIT @ up.T, axis=1) > _APART
    new = distinct_attitudes(means, samples)[0] < _ATTITUDES and not alike.all()  # after that the new one of equals
    sides, alike = (_UNIT[~alike], alike[~alike]) if new else (_UNIT, alike)
    try:
        problem = _problem_of(replace(imu, accelerometer=samples), found.motion.saturated, rests.intervals)
        fit = _nominal(problem, imu, means)
        needs = _needed(_predicted(fit, problem, imu), use, factors or {})
        after = [_worst(_predicted(more, problem, imu), use, factors or {}) for more in with_one_more_rest(fit, sides)]
    except (GnomonError, np.linalg.LinAlgError):  # attitudes too much alike
        return before
    return replace(before, needs=needs, target=sides[int(np.argmin(np.array(after) * (1 + 0.02 * alike)))])


def _unlike(up: Floats) -> Floats:
    """Return the side that is least like the attitudes so far; of all sides seen, the least like of 26 directions."""
    if not len(up):
        return _FACES[0]
    nearest = np.max(_FACES @ up.T, axis=1)
    if nearest.min() < _APART:
        return _FACES[int(np.argmin(nearest))]
    return _UNIT[int(np.argmin(np.max(_UNIT @ up.T, axis=1)))]


def _problem_of(imu: ImuSamples, saturated: Booleans, still: StaticIntervals) -> MultiPositionProblem:
    accelerometer, gyroscope = imu.accelerometer, repair_samples(imu.gyroscope)
    origin = int(accelerometer.t_ns[0])
    t_a, t_g = (np.asarray(1e-9 * (one.t_ns - origin), np.float64) for one in (accelerometer, gyroscope))
    at_rest = gyroscope_intervals(t_g, t_a[still.start], t_a[still.stop - 1])
    if len(at_rest) == 0 or np.any(at_rest.stop - at_rest.start < 2):
        raise SolveError("the gyroscope has no samples in some rests of the accelerometer.")
    return build_problem(
        weighted_stream(accelerometer, t_a, saturated, still),
        weighted_stream(gyroscope, t_g, saturated_samples(gyroscope), at_rest),
        EARTH_RATE_RAD_S**2 / 3,
    )


def _nominal(problem: MultiPositionProblem, imu: ImuSamples, means: Floats) -> NominalFit:
    rate_unit = rate_unit_of(imu)
    if rate_unit is None:
        raise SolveError("nothing tells the gyroscope's unit yet.")
    walk = (consumer_mems().gyroscope_random_walk / rate_unit / problem.gyroscope.spread) ** 2
    bias = np.median(problem.gyroscope_means, axis=0)
    return nominal_fit(problem, means, walk, g_sensitivity=True, rate_unit=rate_unit, rate_bias=bias)


def rate_unit_of(imu: ImuSamples) -> float | None:
    """Return about how many rad/s one of the gyroscope's units is; None where turns have not told it yet."""
    known = GYROSCOPE_UNITS_RAD_S[imu.gyroscope.unit]
    if known is not None:
        return known
    a, g = imu.accelerometer, imu.gyroscope
    force = np.column_stack([np.interp(g.t_ns, a.t_ns, a.values[:, axis]) for axis in range(3)])
    return turning_of_gravity(force, g.values, g.t_ns)


def _predicted(fit: NominalFit, problem: MultiPositionProblem, imu: ImuSamples) -> Calibration:
    units = {"accelerometer": imu.accelerometer.unit, "gyroscope": imu.gyroscope.unit}
    return predicted_calibration(fit, problem, UNSTATED_GRAVITY, units=units, provenance=_PREDICTED)


def _needed(calibration: Calibration, use: Use, factors: Mapping[str, float]) -> tuple[Need, ...]:
    needs = needs_of_use(calibration, use)
    return tuple(replace(need, sigma=need.sigma * factors.get(need.block, 1.0)) for need in needs)


def _worst(calibration: Calibration, use: Use, factors: Mapping[str, float]) -> float:
    """Return how far a calibration is from what is needed: the sum of squares, of which the worst decide."""
    return sum((need.sigma / need.needed) ** 2 for need in _needed(calibration, use, factors))
