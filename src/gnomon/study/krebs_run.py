"""One simulated recording of Krebs, section 5.1, calibrated: errors and sigmas of all of Table 4.1's constants."""

from dataclasses import replace
from typing import Literal

import numpy as np

from ..calibrate.camera_imu import calibrate_camera_imu
from ..errors import GnomonError
from ..frozen import field_names, value_class
from ..geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ..models.forms import DIAGONAL, LOWER
from ..models.noise import ImuNoise
from ..options import CameraImuOptions
from ..recording import Floats, ImuSamples, Recording, TriadSamples
from ..results.calibration import Calibration
from ..results.camera_diagnostics import CameraImuDiagnostics
from ..simulate.camera_imu import CameraImuSimulation, simulate_camera_imu
from ..simulate.camera_imu_rig import THESIS_NOISE, earth_rate_target
from ..simulate.scenarios.camera_imu import CameraImuScenario
from .krebs_thesis import GRAVITY, NAMES, KrebsRig, group_columns

SCENARIO = CameraImuScenario(
    duration_s=90.0,
    motion="gentle",
    target_type="checkerboard",
    target_cols=7,
    target_rows=6,
    target_size_m=0.06,
    earth_rate_latitude=47.4,
    imu="ideal",
    accelerometer_noise_density=THESIS_NOISE.accelerometer_noise_density,
    accelerometer_random_walk=THESIS_NOISE.accelerometer_random_walk,
    gyroscope_noise_density=THESIS_NOISE.gyroscope_noise_density,
    gyroscope_random_walk=THESIS_NOISE.gyroscope_random_walk,
    trajectory_seed=0,
)
"""One motion for all runs, as in Krebs; board, frame rate and pixel noise are not stated there."""

OPTIONS = CameraImuOptions(
    gravity=GRAVITY,
    model="full",
    free=("gravity.magnitude",),
    noise="nominal",
    covariance="ordinary",
    robust=False,
    knots_per_s=25.0,
)
"""Krebs's estimate: known weights, all of Table 4.1 with gravity's three elements; motion up to 2 Hz."""

PIXEL_NOISE_PX = SCENARIO.pixel_noise_px
NO_PIXEL_NOISE_PX = PIXEL_NOISE_PX / 100
"""By which corners without noise are weighed, beside an IMU of noise factor 1: next to nothing."""

Model = Literal["full", "basic"]

_NEGLIGIBLE = 1e-12

CHANGES = {
    **{"p_cb": 0.02, "q_cb": 0.02, "M_a": 0.01, "M_g": 0.01, "S_a": 0.01, "S_g": 0.01},
    **{"B_g": 1e-3, "q_bg": 0.02, "g_w": 0.01, "d": 0.02},
}
"""By how much one element of each group is changed, in its unit."""


@value_class(eq=True)
class KrebsTask:
    """What to simulate and with which model to calibrate it.

    Attributes
    ----------
    seed : of the noise
    duration_s, camera_rate_hz, gyroscope_random_walk : as in the scenario
    noise_factor : multiplies noise and walk of the IMU
    pixel_noise_px : standard deviation of a corner, per axis
    earth_rate : whether the Earth turns in the simulation; it does not in the model
    model : extended (full) or basic
    gravity_known : whether gravity's magnitude is known, and only its direction estimated
    weighed_as : noise factor by which a recording without noise is weighed
    changed : parameter of `NAMES` that is changed as `CHANGES` says; "" for none
    """

    seed: int = 0
    duration_s: float = SCENARIO.duration_s
    camera_rate_hz: float = SCENARIO.camera_rate_hz
    gyroscope_random_walk: float | None = SCENARIO.gyroscope_random_walk
    noise_factor: float = 1.0
    pixel_noise_px: float = PIXEL_NOISE_PX
    earth_rate: bool = True
    model: Model = "full"
    gravity_known: bool = False
    weighed_as: float = 1.0
    changed: str = ""


@value_class
class KrebsRun:
    """What became of it; in the order of `krebs_thesis.NAMES`, nan where the model does not estimate something.

    Attributes
    ----------
    error : (34,) estimate minus truth
    sigma : (34,) as predicted
    nees : squared error in units of the predicted covariance, all elements together
    iterations : of the batch estimation
    converged : whether it came to rest
    failure : why there is no result; "" where there is one
    """

    error: Floats
    sigma: Floats
    nees: float
    iterations: int
    converged: bool
    failure: str = ""


def run_krebs(task: KrebsTask) -> KrebsRun:
    """Simulate one recording and calibrate it; errors are those against what is true of the rig, changed or not."""
    scenario = replace(
        SCENARIO,
        duration_s=task.duration_s,
        camera_rate_hz=task.camera_rate_hz,
        gyroscope_random_walk=task.gyroscope_random_walk,
        noise_factor=task.noise_factor,
        pixel_noise_px=task.pixel_noise_px,
        earth_rate_latitude=SCENARIO.earth_rate_latitude if task.earth_rate else None,
    )
    unseen_px = NO_PIXEL_NOISE_PX * task.noise_factor or PIXEL_NOISE_PX
    options = replace(
        OPTIONS,
        model=task.model,
        pixel_sigma=task.pixel_noise_px or unseen_px,
        free=() if task.gravity_known else OPTIONS.free,
    )
    rig = change_parameter(KrebsRig(), task.changed) if task.changed else KrebsRig()
    return calibrated_run(simulate_camera_imu(scenario, task.seed), rig, options, task.weighed_as)


def change_parameter(rig: KrebsRig, name: str) -> KrebsRig:
    """Return the rig with one parameter of `NAMES` changed as `CHANGES` says."""
    step = np.zeros(len(NAMES))
    step[NAMES.index(name)] = CHANGES[name.split(maxsplit=1)[0]]

    def part(symbol: str) -> Floats:
        return step[group_columns(symbol)]

    T_cam_imu = rig.T_cam_imu.copy()
    T_cam_imu[:3, 3] += part("p_cb")
    T_cam_imu[:3, :3] = T_cam_imu[:3, :3] @ rotation_from_rotvec(2 * part("q_cb"))
    return KrebsRig(
        T_cam_imu=T_cam_imu,
        M_a=rig.M_a + part("M_a"),
        M_g=rig.M_g + part("M_g"),
        S_a=rig.S_a + part("S_a"),
        S_g=rig.S_g + part("S_g"),
        B_g=rig.B_g + part("B_g").reshape(3, 3),
        C_bg=rig.C_bg @ rotation_from_rotvec(2 * part("q_bg")),
        gravity=rig.gravity + part("g_w"),
        time_shift_s=rig.time_shift_s + float(part("d")[0]),
    )


def calibrated_run(
    simulation: CameraImuSimulation, rig: KrebsRig, options: CameraImuOptions, weighed_as: float = 1.0
) -> KrebsRun:
    """Calibrate what a rig records of a simulated motion; see `sense_motion`."""
    try:
        result = calibrate_camera_imu(sense_motion(simulation, rig, weighed_as), simulation.target, options)
    except GnomonError as error:
        nothing = np.full(len(NAMES), np.nan)
        return KrebsRun(
            error=nothing, sigma=nothing, nees=float("nan"), iterations=0, converged=False, failure=str(error)
        )
    assert isinstance(result.diagnostics, CameraImuDiagnostics)
    return against_truth(result.calibration, result.diagnostics, rig)


def sense_motion(simulation: CameraImuSimulation, rig: KrebsRig, weighed_as: float = 1.0) -> Recording:
    """Return the recording that a rig would have made of the motion of a simulation with an ideal IMU.

    Noise and walks are those of the simulation: what its ideal sensors show beside the motion. A simulation without
    noise is weighed by the noise of Table A.1 times `weighed_as`.
    """
    recording, trajectory = simulation.recording, simulation.trajectory
    imu, frames = recording.imus["imu0"], recording.cameras["cam0"]
    f, omega = _felt(simulation, rig)
    S_a = DIAGONAL.matrix(rig.S_a) @ LOWER.matrix(rig.M_a)
    S_g = DIAGONAL.matrix(rig.S_g) @ LOWER.matrix(rig.M_g) @ rig.C_bg.T
    force = f @ S_a.T + rig.b_a + (imu.accelerometer.values - trajectory.f_imu)
    rate = omega @ S_g.T + f @ rig.B_g.T + rig.b_g + (imu.gyroscope.values - trajectory.omega_imu)
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=imu.accelerometer.t_ns, values=force, unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=imu.gyroscope.t_ns, values=rate, unit="rad/s"),
        noise=imu.noise
        if simulation.scenario.noise_factor
        else ImuNoise(**{name: weighed_as * getattr(THESIS_NOISE, name) for name in field_names(ImuNoise)}),
    )
    later_ns = round((simulation.scenario.time_shift_s - rig.time_shift_s) * 1e9)
    moved = replace(frames, t_ns=frames.t_ns + later_ns)
    return replace(recording, imus={"imu0": samples}, cameras={"cam0": moved})


def _felt(simulation: CameraImuSimulation, rig: KrebsRig) -> tuple[Floats, Floats]:
    """Return specific force [m/s^2] and angular rate [rad/s] of the rig's body, each (n, 3)."""
    motion = simulation.trajectory.path.at(simulation.trajectory.t_s).of(rig.T_cam_imu)
    earth, R = earth_rate_target(simulation.scenario), motion.R_target_body
    acceleration = motion.acceleration + 2 * np.cross(earth, motion.velocity) - rig.gravity
    return np.einsum("nji,nj->ni", R, acceleration), motion.omega + earth @ R


def against_truth(calibration: Calibration, diagnostics: CameraImuDiagnostics, rig: KrebsRig) -> KrebsRun:
    """Return errors and sigmas of a result."""
    values, sigmas = dict[str, float](), dict[str, float]()
    for parameter in diagnostics.parameters:
        values[parameter.name] = parameter.value
        if parameter.status in ("estimated", "prior"):
            sigmas[parameter.name] = parameter.sigma
    free = list(sigmas)
    covariance = diagnostics.correlation * np.outer(list(sigmas.values()), list(sigmas.values()))
    error = np.full(len(NAMES), np.nan)
    by_free = np.zeros((len(NAMES), len(free)))

    def put(symbol: str, block: str, difference: Floats, factor: float = 1.0) -> None:
        place = group_columns(symbol)
        names = [f"{block}[{k}]" if place.stop - place.start > 1 else block for k in range(place.stop - place.start)]
        if all(name in sigmas for name in names):
            error[place] = factor * difference
            by_free[range(place.start, place.stop), [free.index(name) for name in names]] = factor

    def numbers(block: str, count: int) -> Floats:
        return np.array([values[f"{block}[{k}]"] for k in range(count)])

    T = calibration.cameras["cam0"].T_cam_imu
    put("p_cb", "cam0.T_cam_imu.translation", T[:3, 3] - rig.T_cam_imu[:3, 3])
    put("q_cb", "cam0.T_cam_imu.rotation", rotvec_from_rotation(rig.T_cam_imu[:3, :3].T @ T[:3, :3]), 0.5)
    for name in ("M_a", "M_g", "S_a", "S_g"):
        put(name, f"imu0.{name}", numbers(f"imu0.{name}", 3) - getattr(rig, name))
    put("B_g", "imu0.B_g", numbers("imu0.B_g", 9) - rig.B_g.ravel())
    C_bg = rotation_from_rotvec(numbers("imu0.q_bg", 3))
    put("q_bg", "imu0.q_bg", rotvec_from_rotation(rig.C_bg.T @ C_bg), 0.5)
    put("d", "cam0.time_shift_cam_imu", np.array([values["cam0.time_shift_cam_imu"] - rig.time_shift_s]))
    gravity, by_gravity = _gravity(diagnostics, free)
    error[group_columns("g_w")] = gravity - rig.gravity
    by_free[group_columns("g_w")] = by_gravity
    fit = calibration.assessment.camera_imu
    return _told(
        error,
        by_free @ covariance @ by_free.T,
        iterations=len(diagnostics.steps),
        converged=fit is not None and fit.converged,
    )


def _gravity(diagnostics: CameraImuDiagnostics, free: list[str]) -> tuple[Floats, Floats]:
    """Return gravity in the board's frame (3,) [m/s^2] and its derivative by the free scalars."""
    gravity, plane = diagnostics.gravity_target, diagnostics.gravity_plane
    size = float(np.linalg.norm(gravity))
    by_free = np.zeros((3, len(free)))
    for k in range(2):
        by_free[:, free.index(f"gravity.direction[{k}]")] = size * plane[:, k]
    if "gravity.magnitude" in free:
        by_free[:, free.index("gravity.magnitude")] = gravity / size
    return gravity, by_free


def _told(error: Floats, covariance: Floats, *, iterations: int, converged: bool) -> KrebsRun:
    sigma = np.sqrt(np.diag(covariance))
    told = np.flatnonzero(sigma > 0)
    z, correlation = error[told] / sigma[told], covariance[np.ix_(told, told)] / np.outer(sigma[told], sigma[told])
    # gravity of known magnitude has three elements, and two degrees of freedom
    inverse = np.linalg.pinv(correlation, rcond=_NEGLIGIBLE, hermitian=True)
    return KrebsRun(
        error=error,
        sigma=np.where(sigma > 0, sigma, np.nan),
        nees=float(z @ inverse @ z),
        iterations=iterations,
        converged=converged,
    )
