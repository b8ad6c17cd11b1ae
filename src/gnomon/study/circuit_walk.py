"""One rig on its way round a circuit: how far odometry is off with each calibration, and with one part of it off.

Errors of an estimated path by the definitions of evo (github.com/MichaelGrupp/evo; Sturm et al., IROS 2012).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..estimate.odometry.invariant_filter import Beginning, Sightings, estimate_path, preintegrate_imu
from ..frozen import value_class
from ..options.requirements import BETWEEN_RECORDINGS, USES
from ..recording import Floats
from ..simulate.walk import SimulatedWalk, WalkScenario, simulate_walk
from .circuit_rig import DENSITIES, LEVELS, QUANTITIES, WALKS, CalibratedRig, Rig, calibrated_rig, perturb_rig

STEP_M = 10.0
"""Way after which relative errors are taken."""

_TOLERANCE_M = 0.1 * STEP_M


@value_class(eq=True)
class PathErrors:
    """How far a path is off.

    Attributes
    ----------
    closure_m : distance of its end from the true one, where both begin at the same place
    ate_m : absolute: rms distance after the best rigid alignment (`evo_ape --align`)
    rpe_m : relative: rms error of the translation over each 10 m of way
        (`evo_rpe --delta 10 --delta_unit m --all_pairs`)
    """

    closure_m: float
    ate_m: float
    rpe_m: float


def path_errors(R: Floats, p: Floats, true_R: Floats, true_p: Floats) -> PathErrors:
    """Return the errors of a path R (n, 3, 3), p (n, 3) [m] against the true one, at the same n instants."""
    middle, true_middle = p.mean(axis=0), true_p.mean(axis=0)
    turn = Rotation.align_vectors(true_p - true_middle, p - middle)[0]
    off = turn.apply(p - middle) + true_middle - true_p
    return PathErrors(
        closure_m=float(np.linalg.norm((p[-1] - p[0]) - (true_p[-1] - true_p[0]))),
        ate_m=float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        rpe_m=_relative(R, p, true_R, true_p),
    )


def _relative(R: Floats, p: Floats, true_R: Floats, true_p: Floats) -> float:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    ends = np.array([start + np.argmin(np.abs(way[start:] - way[start] - STEP_M)) for start in range(len(way))])
    starts = np.flatnonzero(np.abs(way[ends] - way - STEP_M) <= _TOLERANCE_M)
    if not len(starts):
        return float("nan")
    ends = ends[starts]

    def moved(R: Floats, p: Floats) -> Floats:
        return np.einsum("nji,nj->ni", R[starts], p[ends] - p[starts])

    # | Q^-1 P | in translation: the turn of Q does not change its length
    return float(np.sqrt(np.mean(np.sum((moved(R, p) - moved(true_R, true_p)) ** 2, axis=1))))


SCENARIO = WalkScenario()
INFLATED = "nominal, noise of the IMU times 10"
"""What who has no calibration does: tell the filter that the IMU is worse than it is."""

WAYS = (INFLATED, *LEVELS)
MEASURES = ("closure_m", "ate_m", "rpe_m")
_INFLATED_BY = 10.0
_BEGINNING = (0.01, 0.05, 1e-4, BETWEEN_RECORDINGS["gyroscope_bias"], BETWEEN_RECORDINGS["accelerometer_bias"])
"""Standard deviations at the start: of the attitude [rad], velocity [m/s], position [m], and biases as after switching
the sensor on anew."""


@value_class(eq=True)
class CircuitTask:
    """A rig, its calibrations, and one walk with each."""

    seed: int


@value_class
class CircuitRun:
    """What became of it.

    Attributes
    ----------
    length_m : of the way
    errors : (ways, 3) in the order of WAYS and MEASURES [m]; nan where the calibration came to nothing
    sigma : (q,) of the full calibration, in the order of QUANTITIES [SI]
    example : (ways + 1, n, 2) of every way, and the true one last: the path seen from above [m]
    """

    length_m: float
    errors: Floats
    sigma: Floats
    example: Floats


@value_class(eq=True)
class PartsTask:
    """A walk with a rig that is known but for some parts.

    Attributes
    ----------
    seed : of rig and walk, as in `CircuitTask`
    off : cases; in each the size of the error of every quantity [SI], in the order of QUANTITIES
    """

    seed: int
    off: tuple[tuple[float, ...], ...]


@value_class
class PartsRun:
    """What became of it.

    Attributes
    ----------
    errors : (cases, 3) against the true path, in the order of MEASURES [m]
    added : (cases, 3) against the path with the true calibration, from the same measurements [m]
    """

    errors: Floats
    added: Floats


def limits_of_vio() -> tuple[float, ...]:
    """Return what `--for vio` needs, in the order of QUANTITIES [SI]."""
    return tuple(USES["vio"].needs[name] for name in QUANTITIES)


def walk_circuit(task: CircuitTask) -> CircuitRun:
    """Calibrate a rig in every way, and carry it round a circuit."""
    calibrated = calibrated_rig(task.seed)
    walk, draws = _walk(calibrated, task.seed)
    errors, paths = np.full((len(WAYS), len(MEASURES)), np.nan), [np.full_like(walk.p_world_imu, np.nan)] * len(WAYS)
    for row, way in enumerate(WAYS):
        rig = calibrated.levels.get("nominal" if way == INFLATED else way)
        if rig is None:
            continue
        path = follow_walk(walk, rig, draws["begin"], _INFLATED_BY if way == INFLATED else 1.0)
        errors[row], paths[row] = _errors(path, (walk.R_world_imu, walk.p_world_imu)), path[1]
    from_above = np.array([*paths, walk.p_world_imu])[:, :: max(1, len(walk.stamp_s) // 200)][..., [0, 2]]
    return CircuitRun(length_m=walk.length_m, errors=errors, sigma=calibrated.sigma, example=from_above)


def walk_with_parts_off(task: PartsTask) -> PartsRun:
    """Carry a rig round a circuit whose calibration is true but for some quantities."""
    calibrated = calibrated_rig(task.seed, levels=False)
    walk, draws = _walk(calibrated, task.seed)
    truth = walk.R_world_imu, walk.p_world_imu
    best = follow_walk(walk, calibrated.truth, draws["begin"])
    paths = [
        follow_walk(walk, perturb_rig(calibrated.truth, dict(zip(QUANTITIES, off, strict=True)), draws), draws["begin"])
        for off in task.off
    ]
    return PartsRun(
        errors=np.array([_errors(path, truth) for path in paths]),
        added=np.array([_errors(path, best) for path in paths]),
    )


def _walk(calibrated: CalibratedRig, seed: int) -> tuple[SimulatedWalk, Mapping[str, Floats]]:
    rng, truth = np.random.default_rng((seed, 3)), calibrated.truth
    walk = simulate_walk(SCENARIO, calibrated.sensor, truth.T_cam_imu, truth.time_shift_s, int(rng.integers(2**63)))
    return walk, {"begin": rng.standard_normal(15), **{name: rng.standard_normal(9) for name in QUANTITIES}}


def follow_walk(walk: SimulatedWalk, rig: Rig, drawn: Floats, noise: float = 1.0) -> tuple[Floats, Floats]:
    """Return the path by odometry with a calibration, R (k, 3, 3) and p (k, 3).

    It begins at the true pose, with the true velocity and biases but for errors of the stated sizes.

    Parameters
    ----------
    walk : what was recorded
    rig : the calibration
    drawn : (15,) errors of the start of size 1
    noise : by which the noise of the IMU is multiplied for the filter
    """
    sigma = np.repeat(_BEGINNING, 3)
    error = sigma * drawn
    imu = rig.imu
    assert imu.gyroscope is not None
    known = replace(
        imu,
        accelerometer=replace(imu.required_accelerometer, bias=walk.b_a + error[12:]),
        gyroscope=replace(imu.gyroscope, bias=walk.b_g + error[9:12]),
    )
    samples = known.apply(walk.samples)
    white = noise * DENSITIES[0], noise * DENSITIES[1]
    increments = preintegrate_imu(
        walk.imu_t_s, samples.gyroscope.values, samples.accelerometer.values, walk.stamp_s + rig.time_shift_s, white
    )
    sightings = Sightings(
        last=walk.last, count=walk.count, rays=walk.rays, sigma=SCENARIO.pixel_noise_px / SCENARIO.focal_px
    )
    beginning = Beginning(
        rotation=walk.R_world_imu[0],
        velocity=walk.velocity[0] + error[3:6],
        position=walk.p_world_imu[0],
        sigma=sigma,
        walks=(noise * WALKS[0], noise * WALKS[1]),
        gravity=walk.gravity,
    )
    return estimate_path(increments, sightings, rig.T_cam_imu, beginning)


def _errors(path: tuple[Floats, Floats], truth: tuple[Floats, Floats]) -> tuple[float, ...]:
    found = path_errors(*path, *truth)
    return tuple(getattr(found, name) for name in MEASURES)
