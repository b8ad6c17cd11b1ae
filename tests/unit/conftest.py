"""What the tests of the estimation and of the files share."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.preparation import weighted_stream
from gnomon.detect.samples.stillness import static_statistic, window_samples
from gnomon.estimate.multiposition.problem import MultiPositionProblem, build_problem
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames, ImuSamples, Recording, TriadSamples
from gnomon.recording.samples import ImuNoise
from gnomon.results.calibration import Calibration, CameraCalibration, CameraImuFit, Covariance, Holdout, Provenance
from gnomon.results.result import runs_below
from gnomon.results.sensors import covariance_names


@pytest.fixture(scope="session")
def multiposition() -> Callable[..., tuple[MultiPositionProblem, gnomon.Calibration]]:
    """Return a function that simulates a recording and gathers its multi-position problem; the truth beside it."""

    def make(seed=0, *, earth_rate_variance=0.0, **scenario):
        recording, truth = gnomon.simulate(gnomon.Scenario(**scenario), seed)
        imu = recording.imus["imu0"]
        samples = imu.accelerometer
        statistic = static_statistic(samples.values, window_samples(samples, 1.0))
        still = runs_below(statistic, 100.0, round(0.5 * samples.rate_hz))
        clipped = np.zeros(len(imu.accelerometer), dtype=bool)
        streams = [
            weighted_stream(samples, samples.t_s, clipped, still) for samples in (imu.accelerometer, imu.gyroscope)
        ]
        return build_problem(*streams, earth_rate_variance), truth

    return make


LENSES = (
    ("pinhole", [460.0, 458.5, 322.4, 237.1], "radtan", [-0.28, 0.075, 2e-4, -1.5e-4], 0.0),
    ("ds", [-0.2, 0.55, 290.25, 291.5, 319.0, 241.0], "none", [], 2.5e-5),
    ("omni", [0.9, 540.5, 536.25, 321.0, 239.0], "fov", [0.9], -1.5e-5),
    ("eucm", [0.6, 1.1, 230.5, 231.25, 320.0, 240.0], "equidistant", [0.01, -0.02, 0.005, -0.001], 0.0),
)


@pytest.fixture(scope="session")
def camera_calibration(random_calibration) -> Callable[..., Calibration]:
    """Make a calibration of a random IMU and cameras with a full covariance, also between IMU and cameras."""

    def make(seed: int = 0, *, cameras: int = 2, model: str = "full", **changes) -> Calibration:
        alone = random_calibration(seed, **{"units": ("m/s^2", "rad/s"), **changes})
        rng = np.random.default_rng(seed + 1000)
        chain: dict[str, CameraCalibration] = {}
        for i, (projection, intrinsics, distortion, coeffs, line_delay) in enumerate(LENSES[:cameras]):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = rotation_from_rotvec(rng.normal(size=3)), rng.normal(0, 0.1, 3)
            camera = Camera(
                projection=projection, intrinsics=intrinsics, distortion=distortion, distortion_coeffs=coeffs,
                resolution=(640, 480), line_delay_s=line_delay, topic=f"/cam{i}/image_raw",
            )  # fmt: skip
            chain[f"cam{i}"] = CameraCalibration(T_cam_body=T, time_shift_cam_imu=rng.normal(0, 0.01), camera=camera)
        names = covariance_names(alone.imus, chain)
        old = len(alone.uncertainty.names)
        fixed = ("line_delay", "intrinsics", "distortion_coeffs")
        free = np.array([not any(word in name for word in fixed) for name in names], dtype=float)
        free[:old] = np.diag(alone.uncertainty.matrix) > 0
        size = np.full(len(names), 1e-4) * free
        size[:old] = np.sqrt(np.diag(alone.uncertainty.matrix))
        root = (rng.normal(size=(len(names), len(names))) / np.sqrt(len(names)) + np.eye(len(names))) * size[:, None]
        fit = CameraImuFit(
            frames_found=dict.fromkeys(chain, 1197), frames_used=dict.fromkeys(chain, 1190),
            corners_used=dict.fromkeys(chain, 41022), reprojection_rms_px=dict.fromkeys(chain, 0.125),
            duration_s=59.75, converged=True,
        )  # fmt: skip
        assessment = replace(
            alone.assessment, model=model, camera_imu=fit, intervals_found=0, intervals_used=0, rotations_found=0,
            rotations_used=0, holdout=Holdout(accelerometer_rms=float("nan")), held_by_prior=("imu0.B_g",),
        )  # fmt: skip
        return replace(
            alone, cameras=chain, uncertainty=Covariance(names=names, matrix=root @ root.T), assessment=assessment,
            provenance=Provenance(gnomon_version="0.2.0", method="camera-imu", options={"model": model}),
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def camera_imu_case() -> Callable[..., tuple[gnomon.Result, Recording, Target]]:
    """Make a result of a camera-IMU calibration without a solver, and the recording and the board it could be of."""
    spec = importlib.util.spec_from_file_location(
        "camera_imu_result", Path(__file__).parents[1] / "camera_imu_result.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    target = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)

    def make(**changes) -> tuple[gnomon.Result, Recording, Target]:
        result = module.make_camera_imu_result(**{"duration_s": 20.0, **changes})
        t_ns = result.diagnostics.trajectory.t_ns
        triads = {
            name.split(".")[1]: TriadSamples(t_ns=t_ns, values=fit.measured[: len(t_ns)], unit=fit.unit)
            for name, fit in result.diagnostics.signals.items()
        }
        noise = ImuNoise(
            accelerometer_noise_density=0.0039, accelerometer_random_walk=0.0012, gyroscope_noise_density=8.73e-5,
            gyroscope_random_walk=2e-5,
        )  # fmt: skip
        frames = {
            name: CameraFrames(
                t_ns=t_ns[0] + np.rint(fit.frame_t_s * 1e9).astype(np.int64), frame=fit.frame, point=fit.point,
                pixels=fit.pixels, camera=result.calibration.cameras[name].camera,
            )
            for name, fit in result.diagnostics.corners.items()
        }  # fmt: skip
        return (
            result,
            Recording(imus={"imu0": ImuSamples(**triads, noise=noise, topic="/imu0")}, cameras=frames),
            target,
        )

    return make
