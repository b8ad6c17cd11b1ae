"""One rig on its way round a circuit: how far odometry is off with each calibration, and with one part of it off.

Rigs are as their data sheets leave them; what calibrations of different depth make of them comes first. Errors of an
estimated path by the definitions of evo (github.com/MichaelGrupp/evo; Sturm et al., IROS 2012).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..assess.needs import achieved_quantities
from ..calibrate.camera_imu import calibrate_camera_imu
from ..calibrate.imu import calibrate_imu
from ..errors import GnomonError
from ..estimate.invariant_filter import Beginning, Sightings, estimate_path, preintegrate_imu
from ..frozen import field_names, value_class
from ..geometry.rotations import rotation_from_rotvec
from ..models.target import Target
from ..options import CameraImuOptions, ImuOptions
from ..options.requirements import BETWEEN_RECORDINGS, USES
from ..recording import CameraFrames, Floats
from ..results.calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..simulate.camera_imu import CameraImuSimulation, simulate_camera_imu
from ..simulate.camera_imu_rig import THESIS_NOISE, ImuTruth
from ..simulate.camera_imu_streams import FrameStreams, View, simulated_frames
from ..simulate.imu import simulate_imu
from ..simulate.scenarios.camera_imu import CameraImuScenario
from ..simulate.scenarios.recorded import Scenario
from ..simulate.walk import SimulatedWalk, WalkScenario, simulate_walk

DATA_SHEET: Mapping[str, float] = {
    # MPU-6000, product specification 3.4: scales to 3 %, axes to 2 %, 0.1 deg/s/g. Mounted by hand after a drawing.
    "camera_rotation": float(np.radians(1.0)),
    "camera_translation": 0.01,
    "time_shift": 0.01,
    "gyroscope_scale": 0.03,
    "gyroscope_misalignment": 0.02,
    "gyroscope_g_sensitivity": float(np.radians(0.1)) / 9.80665,
    "accelerometer_scale": 0.03,
    "accelerometer_misalignment": 0.02,
}
"""Tolerances within which a rig is before any calibration, evenly [SI]; the biases are left to the odometry."""

QUANTITIES = tuple(DATA_SHEET)
WALKS = (2e-4, THESIS_NOISE.accelerometer_random_walk)
DENSITIES = (THESIS_NOISE.gyroscope_noise_density, THESIS_NOISE.accelerometer_noise_density)
"""Of gyroscope and accelerometer, of an MPU-6000 after Krebs, Table A.1, but for the gyroscope's walk."""

RECORDING = CameraImuScenario(
    duration_s=30.0,
    imu="thesis",
    gyroscope_random_walk=WALKS[0],
    scale_range=DATA_SHEET["gyroscope_scale"],
    misalignment_range=DATA_SHEET["gyroscope_misalignment"],
    gyroscope_rotation_range=DATA_SHEET["gyroscope_misalignment"],
    g_sensitivity_range=DATA_SHEET["gyroscope_g_sensitivity"],
    time_shift_range_s=DATA_SHEET["time_shift"],
)
"""By which the rig is calibrated: 30 s before an AprilGrid, corners off by 0.3 px."""

_POSITIONS = Scenario(
    rate_hz=100.0,
    accelerometer_noise_density=DENSITIES[1],
    gyroscope_noise_density=DENSITIES[0],
    gyroscope_bias_walk=WALKS[0],
    accelerometer_misalignment=DATA_SHEET["accelerometer_misalignment"],
    gyroscope_misalignment=DATA_SHEET["gyroscope_misalignment"],
    accelerometer_scale=(0.97, 1.03),
    gyroscope_scale=(0.97, 1.03),
)
_LANDMARKS, _ROOM_M, _PLACED_M = 250, np.array([4.0, 2.6, 4.0]), 0.02


@value_class
class Rig:
    """A camera and an IMU, as they are or as somebody takes them to be.

    Attributes
    ----------
    imu : in body frame "accel-x"; its biases do not count
    T_cam_imu : (4, 4)
    time_shift_s : t_imu - t_cam [s]
    """

    imu: ImuCalibration
    T_cam_imu: Floats
    time_shift_s: float

    @classmethod
    def of(cls, calibration: Calibration) -> "Rig":
        """Return the rig of a calibration."""
        camera = calibration.cameras["cam0"]
        return cls(
            imu=calibration.imus["imu0"], T_cam_imu=camera.T_cam_imu, time_shift_s=float(camera.time_shift_cam_imu)
        )


@value_class
class CalibratedRig:
    """A rig, and what calibrations made of it.

    Attributes
    ----------
    sensor : its true IMU
    truth : what it is
    levels : calibrations by name; without those that came to nothing
    sigma : (q,) of the full calibration, in the order of QUANTITIES [SI]
    """

    sensor: ImuTruth
    truth: Rig
    levels: Mapping[str, Rig]
    sigma: Floats


LEVELS = ("nominal", "imu", "camera-imu basic", "camera-imu full", "without a board", "truth")
"""nominal: the data sheet and the drawing. imu: that, with a multi-position calibration. basic: pose and clock of the
camera before a board, the IMU as its data sheet has it. full: all of it. without a board: all of it, in a room."""


def calibrated_rig(seed: int, *, levels: bool = True) -> CalibratedRig:
    """Draw a rig, calibrate it in every way, and return both; only the rig where no levels are wanted."""
    simulation = simulate_camera_imu(RECORDING, seed)
    truth, sensor = Rig.of(simulation.truth), simulation.imus["imu0"].sensor
    drawn = np.random.default_rng((seed, 1)).uniform(-1.0, 1.0, 6)
    nominal = Rig(
        imu=ImuCalibration(
            accelerometer=AccelerometerCalibration(sensitivity=np.eye(3), bias=np.zeros(3), unit="m/s^2"),
            gyroscope=GyroscopeCalibration(
                sensitivity=np.eye(3), bias=np.zeros(3), g_sensitivity=np.zeros((3, 3)), unit="rad/s"
            ),
        ),
        T_cam_imu=_mounted(truth.T_cam_imu, drawn),
        time_shift_s=0.0,
    )
    found, sigma = {"nominal": nominal, "truth": truth}, np.full(len(QUANTITIES), np.nan)
    if not levels:
        return CalibratedRig(sensor=sensor, truth=truth, levels=found, sigma=sigma)
    try:
        found["imu"] = replace(nominal, imu=_by_positions(truth.imu, seed))
        basic = calibrate_camera_imu(simulation.recording, simulation.target, CameraImuOptions(model="basic"))
        found["camera-imu basic"] = Rig.of(basic.calibration)
        full = calibrate_camera_imu(simulation.recording, simulation.target, CameraImuOptions(model="full"))
        found["camera-imu full"] = Rig.of(full.calibration)
        known = {one.quantity: one.sigma for one in achieved_quantities(full.calibration)}
        sigma = np.array([known[name] for name in QUANTITIES])
        found["without a board"] = _in_a_room(seed)
    except GnomonError:
        pass  # the levels that are missing are told as missing
    return CalibratedRig(sensor=sensor, truth=truth, levels=found, sigma=sigma)


def _mounted(T_cam_imu: Floats, drawn: Floats) -> Floats:
    T = T_cam_imu.copy()
    T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(DATA_SHEET["camera_rotation"] * drawn[:3])
    T[:3, 3] += DATA_SHEET["camera_translation"] * drawn[3:]
    return T


def _by_positions(truth: ImuCalibration, seed: int) -> ImuCalibration:
    """Return the IMU as a multi-position calibration has it: off as another sensor's was, of the same noise."""
    recording, true = simulate_imu(_POSITIONS, seed)
    found = calibrate_imu(recording, ImuOptions(frame="accel-x")).calibration.imus["imu0"]
    other = true.in_frame("accel-x").imus["imu0"]
    assert found.gyroscope is not None
    assert other.gyroscope is not None
    assert truth.gyroscope is not None
    accelerometer, gyroscope = truth.required_accelerometer, truth.gyroscope
    of_force = np.linalg.solve(other.required_accelerometer.sensitivity, found.required_accelerometer.sensitivity)
    of_rate = np.linalg.solve(other.gyroscope.sensitivity, found.gyroscope.sensitivity)
    return replace(
        truth,
        accelerometer=replace(accelerometer, sensitivity=accelerometer.sensitivity @ of_force),
        gyroscope=replace(gyroscope, sensitivity=gyroscope.sensitivity @ of_rate, g_sensitivity=np.zeros((3, 3))),
    )


def _in_a_room(seed: int) -> Rig:
    """Return the calibration from landmarks of a room of which only rough places are known."""
    scenario = replace(RECORDING, motion="around", sensor_seed=seed)
    simulation = simulate_camera_imu(scenario, seed)
    rng = np.random.default_rng((seed, 2))
    points = _room(rng) + np.array([0.0, 0.0, scenario.distance_m])
    recording = replace(simulation.recording, cameras={"cam0": _seen_room(simulation, points, rng)})
    target = Target.landmarks(points + _PLACED_M * rng.standard_normal(points.shape))
    return Rig.of(calibrate_camera_imu(recording, target, CameraImuOptions(model="full")).calibration)


def _seen_room(simulation: CameraImuSimulation, points: Floats, rng: np.random.Generator) -> CameraFrames:
    truth, scenario = simulation.truth.cameras["cam0"], simulation.scenario
    view = View(path=simulation.trajectory.path, T_cam_cam0=np.eye(4), camera=truth.camera, points=points)
    frames, _, _ = simulated_frames(
        scenario,
        truth,
        view,
        stated=truth.camera,
        exposure_s=simulation.frames["cam0"].exposure_s,
        clock_offset_s=0.0,
        streams=FrameStreams(**dict(zip(field_names(FrameStreams), rng.spawn(6), strict=True))),
    )
    return frames


def _room(rng: np.random.Generator) -> Floats:
    """Return points on the six sides of a room (n, 3), about its middle [m]."""
    points = rng.uniform(-0.5, 0.5, (_LANDMARKS, 3))
    side = rng.integers(0, 3, _LANDMARKS)
    points[np.arange(_LANDMARKS), side] = np.where(points[np.arange(_LANDMARKS), side] > 0, 0.5, -0.5)
    return points * _ROOM_M


def perturb_rig(rig: Rig, sizes: Mapping[str, float], drawn: Mapping[str, Floats]) -> Rig:
    """Return the rig as somebody takes it to be who is off in some quantities.

    Parameters
    ----------
    rig : as it is
    sizes : quantity -> size of the error, per element [SI]
    drawn : quantity -> errors of size 1 (9,), of which each quantity takes as many as it has
    """

    def error(name: str) -> Floats:
        return sizes.get(name, 0.0) * drawn[name]

    accelerometer, gyroscope = rig.imu.required_accelerometer, rig.imu.gyroscope
    assert gyroscope is not None
    force, rate = np.diag(error("accelerometer_scale")[:3]), np.diag(error("gyroscope_scale")[:3])
    force[np.tril_indices(3, -1)] = error("accelerometer_misalignment")[:3]
    rate[~np.eye(3, dtype=bool)] = error("gyroscope_misalignment")[:6]
    T = rig.T_cam_imu.copy()
    T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(error("camera_rotation")[:3])
    T[:3, 3] += error("camera_translation")[:3]
    return Rig(
        imu=replace(
            rig.imu,
            accelerometer=replace(accelerometer, sensitivity=accelerometer.sensitivity @ (np.eye(3) + force)),
            gyroscope=replace(
                gyroscope,
                sensitivity=gyroscope.sensitivity @ (np.eye(3) + rate),
                g_sensitivity=gyroscope.g_sensitivity + error("gyroscope_g_sensitivity").reshape(3, 3),
            ),
        ),
        T_cam_imu=T,
        time_shift_s=rig.time_shift_s + float(error("time_shift")[0]),
    )


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
