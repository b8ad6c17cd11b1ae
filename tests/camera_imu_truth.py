"""What is true of a simulated recording, against what a camera-IMU calibration found of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import gnomon
from gnomon.calibrate.steps.camera_imu_preparation import prepare_camera_imu
from gnomon.estimate.camera_imu.batch import Measurements, NoiseLevels, RigState, linearize_batch
from gnomon.estimate.camera_imu.choices import estimation_choices
from gnomon.estimate.camera_imu.gauss_newton import gauss_newton_step
from gnomon.estimate.camera_imu.layout import border_layout
from gnomon.estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
from gnomon.estimate.camera_imu.start.first_guess import ImuPath, align_cameras, imu_stream, initial_trajectory
from gnomon.estimate.camera_imu.terms.inertial_terms import InertialNoise
from gnomon.estimate.camera_imu.terms.visual_terms import VisualData
from gnomon.estimate.camera_imu.trajectory import POSE
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of the estimated scalars.

    Attributes
    ----------
    names : (p,)
    error : (p,) estimate minus truth; of rotations and of gravity's direction the small angles between them
    covariance : (p, p) as predicted
    """

    names: tuple[str, ...]
    error: np.ndarray
    covariance: np.ndarray

    @property
    def sigma(self):
        return np.sqrt(np.diag(self.covariance))

    @property
    def z(self):
        """Errors in units of their predicted standard deviation."""
        return self.error / self.sigma

    @property
    def nees(self):
        """Normalised estimation error squared: of p degrees of freedom."""
        correlation = self.covariance / np.outer(self.sigma, self.sigma)
        return float(self.z @ np.linalg.solve(correlation, self.z))

    def of(self, block):
        """Return the errors of a block."""
        return self.error[[name.partition("[")[0] == block for name in self.names]]


def errors(result, simulation) -> Errors:
    """Return the errors of all scalars that were estimated."""
    diagnostics, calibration, truth = result.diagnostics, result.calibration, simulation.truth_parameters
    estimated = [p for p in diagnostics.parameters if p.status != "fixed"]
    found = {}
    for p in diagnostics.parameters:
        found.setdefault(p.name.partition("[")[0], []).append(p.value)
    blocks = dict.fromkeys(p.name.partition("[")[0] for p in estimated)
    difference = {name: np.array(found[name]) - np.ravel(truth[name]) for name in blocks if not _is_rotation(name)}
    for name in filter(_is_rotation, blocks):
        if name == "gravity.direction":
            direction = simulation.gravity_target / np.linalg.norm(simulation.gravity_target)
            difference[name] = -diagnostics.gravity_plane.T @ direction
            continue
        true = rotation_from_rotvec(truth[name])
        if name == "imu0.q_bg":  # the coordinates count from the ideal IMU
            estimate = rotation_from_rotvec(np.array(found[name]))
        else:
            estimate = calibration.cameras[name.partition(".")[0]].T_cam_imu[:3, :3]
        difference[name] = rotvec_from_rotation(true.T @ estimate)
    index = [int(p.name.partition("[")[2][:-1] or 0) if "[" in p.name else 0 for p in estimated]
    sigma = np.array([p.sigma for p in estimated])
    return Errors(
        names=tuple(p.name for p in estimated),
        error=np.array([difference[p.name.partition("[")[0]][i] for p, i in zip(estimated, index, strict=True)]),
        covariance=diagnostics.correlation * np.outer(sigma, sigma),
    )


def _is_rotation(name):
    return name in ("gravity.direction", "imu0.q_bg") or name.endswith("T_cam_imu.rotation")


@dataclass(frozen=True, kw_only=True)
class Run:
    """One simulated recording, calibrated.

    Attributes
    ----------
    errors : None where the calibration failed
    failure : what was said
    """

    seed: int
    verdict: str
    converged: bool
    iterations: int
    errors: Errors | None
    failure: str = ""
    findings: tuple[str, ...] = field(default=())


def run(scenario, options, seed) -> Run:
    """Simulate and calibrate; a process of its own can do it."""
    simulation = gnomon.simulate_camera_imu(scenario, seed)
    try:
        result = gnomon.calibrate_camera_imu(simulation.recording, simulation.target, options)
    except gnomon.GnomonError as error:
        return Run(seed=seed, verdict="none", converged=False, iterations=0, errors=None, failure=str(error))
    assessment = result.calibration.assessment
    return Run(
        seed=seed,
        verdict=result.calibration.verdict,
        converged=assessment.camera_imu.converged,
        iterations=len(result.diagnostics.steps),
        errors=errors(result, simulation),
        findings=tuple(f.code for f in assessment.findings if f.severity in ("warning", "problem")),
    )


def ratios(found: Sequence[Errors]) -> dict[str, float]:
    """Return the empirical over the predicted sigma of every block, over many recordings."""
    z = np.array([errors.z for errors in found])
    blocks = [name.partition("[")[0] for name in found[0].names]
    return {
        block: float(np.sqrt(np.mean(z[:, [name == block for name in blocks]] ** 2))) for block in dict.fromkeys(blocks)
    }


def cramer_rao_sigma(simulation, options, gravity_plane, origin) -> dict[str, float]:
    """Return the Cramer-Rao bound of every estimated scalar: the information at the truth, with the true noise.

    `gravity_plane` (3, 2) says about which axes the direction of gravity is told.
    """
    prepared = prepare_camera_imu(simulation.recording, simulation.target, options)
    stream = imu_stream(prepared.inertial)
    found = align_cameras(simulation.recording.cameras, simulation.target, prepared.origin_ns, stream)
    parameters = true_parameters(simulation, gravity_plane, origin)
    state = RigState(
        trajectory=true_trajectory(simulation, stream.t_s, found, parameters, options), parameters=parameters
    )
    imu, root = simulation.recording.imus["imu0"].noise, np.sqrt(simulation.scenario.imu_rate_hz)
    noise = NoiseLevels(
        imus=(
            InertialNoise(
                gyroscope=imu.gyroscope_noise_density * root, accelerometer=imu.accelerometer_noise_density * root
            ),
        ),
        walks=((imu.gyroscope_random_walk, imu.accelerometer_random_walk),),
        pixel_sigma=(simulation.scenario.pixel_noise_px,) * len(found),
        huber=np.inf,
    )
    visual = tuple(
        VisualData(camera=i, exposures=look.poses.exposures, t_s=look.poses.t_s) for i, look in enumerate(found)
    )
    measurements = Measurements(
        inertial=prepared.inertial, visual=visual, used=tuple(np.ones(len(d.exposures), dtype=bool) for d in visual)
    )
    chosen = estimation_choices(parameters, options)
    columns = border_layout(parameters, chosen.status, chosen.prior_sigma)
    step = gauss_newton_step(linearize_batch(measurements, state, columns, noise, probing=False))
    names = np.array(columns.names)[columns.free]
    return dict(zip(names.tolist(), np.sqrt(np.diag(step.covariance)).tolist(), strict=True))


def true_parameters(simulation, gravity_plane, origin) -> RigParameters:
    truth = simulation.truth_parameters
    down = simulation.gravity_target / np.linalg.norm(simulation.gravity_target)
    plane = gravity_plane - np.outer(down, down @ gravity_plane)  # nearly the same, and across the true gravity
    return RigParameters(
        gravity_axes=np.column_stack([np.linalg.qr(plane)[0] * [-1, -1], down]),
        gravity_m_s2=float(truth["gravity.magnitude"]),
        target_scale=float(truth["target.scale"]),
        imus=(
            ImuParameters(
                **{name: truth[f"imu0.{name}"] for name in ("S_a", "M_a", "S_g", "M_g", "B_g")},
                C_bg=rotation_from_rotvec(truth["imu0.q_bg"]),
                origin=origin,
            ),
        ),
        cameras=tuple(
            CameraParameters(
                name=name,
                R_cam_imu=camera.T_cam_imu[:3, :3],
                p_cam_imu=camera.T_cam_imu[:3, 3],
                time_shift_s=camera.time_shift_cam_imu,
                camera=camera.camera,
            )
            for name, camera in simulation.truth.cameras.items()
        ),
    )


def true_trajectory(simulation, t_s, found, parameters, options):
    """Return splines through the true path, with the true biases at the knots."""
    motion = simulation.trajectory.at(t_s)
    path = ImuPath(t_s=t_s, R=motion.R_target_body, position=motion.p_target_body)
    seen_s = np.sort(
        np.concatenate(
            [one.poses.t_s + camera.time_shift_s for one, camera in zip(found, parameters.cameras, strict=True)]
        )
    )
    fitted = initial_trajectory(
        path, seen_s, options.knots_per_s or 50.0, order=options.spline_order, gyroscope_biases=[np.zeros(3)]
    )
    controls, grid = fitted.controls.copy(), fitted.grid
    for segment in grid.segments:
        index = np.arange(segment.spans + grid.order - 1)
        times = segment.start_s + (index - grid.bias_offset) * grid.spacing_s
        biases = np.hstack([simulation.b_g, simulation.b_a])
        recorded_s = simulation.trajectory.t_s
        for k in range(6):
            controls[segment.first + index, POSE + k] = np.interp(times, recorded_s, biases[:, k])
    return replace(fitted, controls=controls)


def turned(T, rotvec, shift):
    """Return a transform (4, 4) with a rotation on the right and a translation [m] added."""
    moved = T.copy()
    moved[:3, :3], moved[:3, 3] = T[:3, :3] @ rotation_from_rotvec(np.array(rotvec)), T[:3, 3] + shift
    return moved
