"""A camera-IMU result with realistic numbers, made without a solver: what a report has to show, and odd cases of it.

The motion is a sum of sines in front of an AprilGrid; predictions are exact, measurements differ from them by noise,
and the basic model's predictions by what an ideal sensor would have read.
"""

from dataclasses import dataclass

import numpy as np

from gnomon.findings import Finding
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.recording import FrameQuality, Source
from gnomon.results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    CameraCalibration,
    CameraImuFit,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
)
from gnomon.results.camera_diagnostics import (
    BiasTrack,
    CameraImuDiagnostics,
    CornerFit,
    EstimatedParameter,
    NoiseLevel,
    SignalFit,
    SolverStep,
    TrajectoryTrack,
)
from gnomon.results.result import Result
from gnomon.results.sensors import covariance_names

FINDINGS = (
    Finding(
        severity="warning",
        code="weak-parameters",
        message="imu0.B_g[4] is known to 0.9 of its size only.",
        consequence="The g-sensitivity of the y axis may be anything between zero and twice the estimate.",
        cure="Move faster: shake the rig along each of its axes.",
    ),
    Finding(
        severity="info",
        code="frames-gated",
        message="9 of 1200 frames of cam0 fitted badly and were left out.",
        consequence="Their residuals were beyond 6 sigma as a whole.",
    ),
    Finding(severity="info", code="assumed", message="imu0.csv.gz: columns as in the EuRoC data set."),
    Finding(severity="good", code="motion", message="All axes were turned and shaken well."),
)

T_CAM_IMU = (
    np.array([
        [-0.058741, -0.997800, 0.030729, 0.103],
        [-0.037497, -0.028555, -0.998889, -0.015],
        [0.997569, -0.059828, -0.035737, -0.010],
        [0, 0, 0, 1],
    ]),
    np.array([
        [-0.041220, -0.998791, 0.026801, -0.007],
        [-0.040011, -0.025152, -0.998883, -0.0146],
        [0.998349, -0.042246, -0.038926, -0.0098],
        [0, 0, 0, 1],
    ]),
)  # fmt: skip
SHIFTS = (0.00705, 0.00712)
GRAVITY_TARGET = np.array([0.2054, -9.7911, -0.5131])
SIGMAS = {"accelerometer": 0.0552, "gyroscope": 1.235e-3}
SENSITIVITY = np.array([[1.001, 0, 0], [0.0052, 1.0008, 0], [-0.0017, 0.0026, 0.9886]])
GYRO_SENSITIVITY = np.array([[1.002, 0, 0], [0.0035, 0.999, 0], [-0.0026, 0.0164, 1.0011]])
C_GYRO_IMU = rotation_from_rotvec(np.array([0.0, 0.0, -np.radians(1.0)]))
G_SENSITIVITY = np.array([[-1.2, 0.8, 1.5], [-1.3, 0.1, -1.4], [1.6, 1.3, -0.9]]) * 1e-4
PIXEL_SIGMA = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What the result should be like."""

    cameras: int = 1
    basic: bool = True
    model: str = "full"
    verdict: str = "warn"
    duration_s: float = 60.0
    imu_hz: float = 200.0
    frames_hz: float = 20.0
    gap_s: tuple[float, float] | None = None
    fixed: tuple[str, ...] = ("cam0.line_delay",)
    images: bool = False
    names: tuple[str, ...] = ("cam0_corners.csv.gz", "imu0.csv.gz", "camchain.yaml")
    findings: tuple[Finding, ...] = FINDINGS


def make_camera_imu_result(**changes) -> Result:
    """Return a result; `changes` are fields of Case."""
    case = Case(**changes)
    rng = np.random.default_rng(11)
    motion = _motion(case)
    corners = {f"cam{i}": _corners(case, motion, i, rng) for i in range(case.cameras)}
    estimated = _parameters(case, rng)
    calibration = _calibration(case, corners, estimated)
    signals = {name: _signal(case, motion, name, rng) for name in ("imu0.accelerometer", "imu0.gyroscope")}
    free = sum(p.status != "fixed" for p in estimated)
    baselines = {"cam1_cam0": T_CAM_IMU[1] @ np.linalg.inv(T_CAM_IMU[0])} if case.cameras > 1 else {}
    return Result(
        calibration=calibration,
        diagnostics=CameraImuDiagnostics(
            signals=signals,
            biases={name: _bias(motion, name, rng) for name in signals},
            corners=corners,
            trajectory=_track(motion),
            parameters=estimated,
            correlation=_correlation(free, rng),
            noise=_noise(case),
            steps=_STEPS,
            gravity_target=GRAVITY_TARGET,
            gravity_sigma=np.array([2e-3, 1e-4, 1.5e-3]),
            gravity_plane=np.eye(3)[:, [0, 2]],
            knots_per_s=100.0,
            spline_order=6,
            segments=1 if case.gap_s is None else 2,
            baselines=baselines,
            initial_time_shift_s={f"cam{i}": 0.0068 for i in range(case.cameras)},
        ),
    )


_STEPS = tuple(
    SolverStep(cost=cost, largest_step=step, damping=damping, accepted=accepted)
    for cost, step, damping, accepted in (
        (1.83e6, 812.0, 0.0, True),
        (9.1e4, 95.0, 0.0, True),
        (8.9e4, 40.0, 0.0, False),
        (8.9e4, 3.1, 1e-4, True),
        (88412.2, 0.02, 0.0, True),
        (88412.1, 4e-6, 0.0, True),
    )
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Motion:
    t_s: np.ndarray
    p: np.ndarray
    R: np.ndarray
    omega: np.ndarray
    f: np.ndarray
    known: np.ndarray


def _motion(case) -> _Motion:
    t = np.arange(round(case.duration_s * case.imu_hz)) / case.imu_hz
    swing = np.stack([0.45 * np.sin(2.1 * t + k) + 0.2 * np.sin(5.3 * t + 2 * k) for k in range(3)], axis=1)
    p = np.array([0.29, 0.25, 0.75]) + np.stack(
        [(0.25 - 0.05 * k) * np.sin((1.7 + 0.4 * k) * t + k) + 0.02 * np.sin(7.1 * t + k) for k in range(3)], axis=1
    )
    facing = np.linalg.inv(T_CAM_IMU[0])[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # the camera looks at the board
    R = facing.T[None] @ rotation_from_rotvec(swing)
    step = 1 / case.imu_hz
    a = np.gradient(np.gradient(p, step, axis=0), step, axis=0)
    turned = np.einsum("nji,njk->nik", R[:-1], R[1:])
    skewed = (turned - np.swapaxes(turned, 1, 2)) / 2
    omega = np.stack([skewed[:, 2, 1], skewed[:, 0, 2], skewed[:, 1, 0]], axis=1) / step
    omega = np.concatenate([omega, omega[-1:]])
    known = np.ones(len(t), dtype=bool)
    if case.gap_s is not None:
        known[(t >= case.gap_s[0]) & (t < case.gap_s[1])] = False
    return _Motion(t_s=t, p=p, R=R, omega=omega, f=np.einsum("nji,nj->ni", R, a - GRAVITY_TARGET), known=known)


def _signal(case, motion, name, rng) -> SignalFit:
    if name.endswith("accelerometer"):
        predicted = motion.f @ SENSITIVITY.T + np.array([0.149, -0.218, 0.209])
        ideal, unit = motion.f + np.array([0.149, -0.218, 0.18]), "m/s^2"
    else:
        bias = np.array([0.0048, 0.0107, 0.0188])
        predicted = motion.omega @ (GYRO_SENSITIVITY @ C_GYRO_IMU).T + motion.f @ G_SENSITIVITY.T + bias
        ideal, unit = motion.omega @ rotation_from_rotvec(np.array([0, 0, -0.012])).T + bias, "rad/s"
    sigma = SIGMAS[name.split(".")[1]]
    measured = predicted + rng.normal(0, sigma, predicted.shape)
    used = motion.known.copy()
    used[:5] = used[-5:] = False
    for values in (predicted, ideal):
        values[~motion.known] = np.nan
    basic = ideal if case.basic else None
    return SignalFit(
        t_s=motion.t_s, measured=measured, predicted=predicted, basic=basic, used=used, sigma=sigma, unit=unit
    )


def _bias(motion, name, rng) -> BiasTrack:
    accelerometer = name.endswith("accelerometer")
    walk, unit, start = (
        (1.2e-3, "m/s^2", (0.149, -0.218, 0.209)) if accelerometer else (2e-5, "rad/s", (5e-3, 1e-2, 0.019))
    )
    t = np.linspace(0, motion.t_s[-1], 400)
    value = np.array(start) + np.cumsum(rng.normal(0, walk * np.sqrt(t[1]), (400, 3)), axis=0)
    sigma = np.full((400, 3), 2.2 * walk) * (1 + 0.5 * np.abs(t / t[-1] - 0.5)[:, None])
    return BiasTrack(t_s=t, value=value, sigma=sigma, random_walk=walk, unit=unit)


def _track(motion) -> TrajectoryTrack:
    from scipy.spatial.transform import Rotation

    kept = motion.known
    quaternion = Rotation.from_matrix(motion.R[kept]).as_quat()[:, [3, 0, 1, 2]]
    return TrajectoryTrack(
        t_ns=np.rint(motion.t_s[kept] * 1e9).astype(np.int64) + 1_600_000_000_000_000_000,
        p_target_imu=motion.p[kept],
        q_target_imu_wxyz=quaternion,
        omega_imu=motion.omega[kept],
        f_imu=motion.f[kept],
    )


def _camera() -> Camera:
    return Camera(
        projection="pinhole",
        intrinsics=np.array([460.0, 458.5, 322.4, 237.1]),
        distortion="radtan",
        distortion_coeffs=np.array([-0.28, 0.075, 2e-4, -1.5e-4]),
        resolution=(640, 480),
    )


def _corners(case, motion, which, rng) -> CornerFit:
    tags = np.array([[c * 0.1144, r * 0.1144, 0.0] for r in range(6) for c in range(6)])
    offsets = np.array([[0, 0, 0], [0.088, 0, 0], [0.088, 0.088, 0], [0, 0.088, 0]])
    board = (tags[:, None] + offsets[None]).reshape(-1, 3)
    times = np.arange(0.02, case.duration_s, 1 / case.frames_hz)
    nearest = np.clip(np.rint(times * case.imu_hz).astype(int), 0, len(motion.t_s) - 1)
    T = T_CAM_IMU[which]
    seen_by_imu = np.einsum("nji,nmj->nmi", motion.R[nearest], board[None] - motion.p[nearest][:, None])
    in_camera = seen_by_imu @ T[:3, :3].T + T[:3, 3]
    pixels = np.array([460.0, 458.5]) * in_camera[..., :2] / in_camera[..., 2:] + np.array([322.4, 237.1])
    inside = (in_camera[..., 2] > 0.1) & (pixels > 4).all(axis=2) & (pixels < (635, 475)).all(axis=2)
    inside[40:43] = False  # the board was hidden
    frame, point = np.nonzero(inside)
    pixels = pixels[frame, point]
    from_centre = (pixels - (322.4, 237.1)) / 320
    residual = rng.normal(0, PIXEL_SIGMA, pixels.shape) + 0.05 * from_centre * (from_centre**2).sum(axis=1)[:, None]
    used = np.ones(len(times), dtype=bool)
    used[rng.choice(len(times), len(times) // 130, replace=False)] = False
    residual[~used[frame]] += rng.normal(0, 6.0, (int((~used[frame]).sum()), 2))
    outlier = rng.random(len(frame)) < 0.001
    residual[outlier] *= 15
    if case.gap_s is not None:
        hidden = (times >= case.gap_s[0]) & (times < case.gap_s[1])
        used[hidden] = False
        residual[hidden[frame]] = np.nan
    else:
        hidden = np.zeros(len(times), dtype=bool)
    count = np.bincount(frame, minlength=len(times))
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.bincount(frame, (residual**2).sum(axis=1), minlength=len(times)) / (2 * count))
    used &= count > 0
    reason = tuple(
        "" if u else "no corners" if n == 0 else "outside the trajectory" if h else "fits badly: 47 sigma"
        for u, n, h in zip(used, count, hidden, strict=True)
    )
    return CornerFit(
        frame_t_s=times + SHIFTS[which],
        frame_corners=count,
        frame_rms=rms,
        frame_used=used,
        frame_reason=reason,
        frame=frame,
        point=point,
        pixels=pixels + rng.normal(0, PIXEL_SIGMA, pixels.shape),
        residual=residual,
        weight=np.clip(2 * PIXEL_SIGMA / np.fmax(np.linalg.norm(np.nan_to_num(residual), axis=1), 1e-9), 0, 1),
        sigma_px=1.05 * PIXEL_SIGMA,
        resolution=(640, 480),
        **(_images(times, frame, count, rng) if case.images else {}),
    )


def _images(times, frame, count, rng) -> dict:
    """Return what the images were like: the faster, the more blurred."""
    blur = 0.6 + 0.9 * np.abs(np.sin(1.7 * times)) ** 6 + rng.normal(0, 0.03, len(times))
    white = 190 + 30 * np.sin(0.4 * times) + rng.normal(0, 2, len(times))
    blur[count == 0] = white[count == 0] = np.nan
    return {
        "corner_sigma_px": 0.05 * blur[frame] * rng.lognormal(0, 0.3, len(frame)),
        "quality": FrameQuality(
            blur_px=blur,
            black=white * 0.2,
            white=white,
            dropped={"near the border": 812, "blurred": 2310, "doubtful": 40, "of another board": 0},
        ),
    }


def _blocks(case) -> list[tuple[str, str, np.ndarray, np.ndarray, float]]:
    """Name, unit, value, start and sigma of every block of the batch estimation."""
    ones, zeros = np.ones(3), np.zeros(3)
    gyro_lower = np.array([0.0035, -0.0026, 0.0164])
    blocks = [
        ("gravity.direction", "rad", np.array([0.0031, -0.0008]), zeros[:2], 1.5e-4),
        ("gravity.magnitude", "m/s^2", np.array([9.80665]), np.array([9.80665]), 0.0),
        ("target.scale", "", np.ones(1), np.ones(1), 0.0),
        ("imu0.S_a", "", np.diag(SENSITIVITY), ones, 3e-4),
        ("imu0.M_a", "rad", np.array([0.0052, -0.0017, 0.0026]), zeros, 2.2e-4),
        ("imu0.S_g", "", np.diag(GYRO_SENSITIVITY), ones, 1.5e-4),
        ("imu0.M_g", "rad", gyro_lower, zeros, 1.4e-4),
        ("imu0.q_bg", "rad", np.array([3e-5, -1.1e-4, 0.017453]), zeros, 1.6e-4),
        ("imu0.B_g", "rad/s per m/s^2", G_SENSITIVITY.ravel(), np.zeros(9), 2.1e-5),
    ]
    for i in range(case.cameras):
        name = f"cam{i}"
        blocks += [
            (f"{name}.T_cam_imu.rotation", "rad", np.array([0.004, -0.007, 0.001]), zeros, 1.1e-4),
            (f"{name}.T_cam_imu.translation", "m", T_CAM_IMU[i][:3, 3], zeros, 2.3e-4),
            (f"{name}.time_shift_cam_imu", "s", np.array([SHIFTS[i]]), np.array([0.0068]), 6e-6),
            (f"{name}.line_delay", "s", np.zeros(1), np.zeros(1), 0.0),
            (f"{name}.intrinsics", "px", _camera().intrinsics, _camera().intrinsics, 0.0),
            (f"{name}.distortion_coeffs", "", _camera().distortion_coeffs, _camera().distortion_coeffs, 0.0),
        ]
    return blocks


_IDEAL = ("imu0.S_a", "imu0.M_a", "imu0.S_g", "imu0.M_g", "imu0.q_bg", "imu0.B_g")


def _parameters(case, rng) -> tuple[EstimatedParameter, ...]:
    found: list[EstimatedParameter] = []
    for name, unit, values, starts, sigma in _blocks(case):
        fixed = not sigma or name in case.fixed or (case.model == "basic" and name in _IDEAL)
        for i, (value, start) in enumerate(zip(values, starts, strict=True)):
            prior = float("inf")
            status = "fixed" if fixed else "estimated"
            if name == "imu0.B_g" and not fixed:
                prior, status = 1e-3, "prior"
            found.append(
                EstimatedParameter(
                    name=name if len(values) == 1 else f"{name}[{i}]",
                    unit=unit,
                    value=float(start if fixed else value),
                    start=float(start),
                    sigma=0.0 if fixed else float(sigma * rng.uniform(0.7, 1.4)),
                    prior_sigma=prior,
                    status=status,
                )
            )
    return tuple(found)


def _correlation(count, rng) -> np.ndarray:
    root = rng.normal(size=(count, count)) * 0.13 + np.eye(count)
    if count > 12:
        root[11] = root[5] + 0.2 * rng.normal(size=count)
        root[12] = -root[3] + 0.3 * rng.normal(size=count)
    covariance = root @ root.T
    scale = 1 / np.sqrt(np.diag(covariance))
    return covariance * scale[:, None] * scale


def _noise(case) -> tuple[NoiseLevel, ...]:
    return (
        NoiseLevel(name="imu0.accelerometer", unit="m/s^2/sqrt(Hz)", nominal=0.0039, estimated=0.00391, used=0.00391),
        NoiseLevel(name="imu0.gyroscope", unit="rad/s/sqrt(Hz)", nominal=8.73e-5, estimated=9.1e-5, used=9.1e-5),
        *(
            NoiseLevel(name=f"cam{i}.corners", unit="px", nominal=float("nan"), estimated=0.126, used=0.126)
            for i in range(case.cameras)
        ),
    )


def _calibration(case, corners, estimated) -> Calibration:
    ideal = case.model == "basic"
    imus = {
        "imu0": ImuCalibration(
            accelerometer=AccelerometerCalibration(
                sensitivity=np.eye(3) if ideal else SENSITIVITY, bias=np.array([0.149, -0.218, 0.209]), unit="m/s^2"
            ),
            gyroscope=GyroscopeCalibration(
                sensitivity=np.eye(3) if ideal else GYRO_SENSITIVITY @ C_GYRO_IMU,
                bias=np.array([0.0048, 0.0107, 0.0188]),
                g_sensitivity=np.zeros((3, 3)) if ideal else G_SENSITIVITY,
                unit="rad/s",
            ),
        )
    }
    cameras = {
        name: CameraCalibration(T_cam_body=T_CAM_IMU[i], time_shift_cam_imu=SHIFTS[i], camera=_camera())
        for i, name in enumerate(corners)
    }
    names = covariance_names(imus, cameras)
    sigmas = {
        "accelerometer.sensitivity": 0.0 if ideal else 3e-4, "accelerometer.bias": 2.5e-3,
        "gyroscope.sensitivity": 0.0 if ideal else 1.5e-4, "gyroscope.bias": 4e-5,
        "g_sensitivity": 0.0 if ideal else 2.1e-5, "rotation": 1.1e-4, "translation": 2.3e-4, "time_shift": 6e-6,
    }  # fmt: skip
    found = np.array([next((s for key, s in sigmas.items() if key in name), 0.0) for name in names])
    found[[1, 2, 5]] = 0.0  # the body frame is accel-x
    for path in case.fixed:
        found[[name.startswith(path) for name in names]] = 0.0
    return Calibration(
        imus=imus,
        cameras=cameras,
        frame="accel-x",
        gravity=Gravity(value=9.80665, sigma=0.0, source="standard gravity, since no place was given"),
        uncertainty=Covariance(names=names, matrix=np.diag(found**2)),
        assessment=Assessment(
            verdict=case.verdict,
            findings=case.findings,
            model=case.model,
            held_by_prior=("imu0.B_g[4]",) if case.model == "full" else (),
            camera_imu=CameraImuFit(
                frames_found={name: int((fit.frame_corners > 0).sum()) for name, fit in corners.items()},
                frames_used={name: int(fit.frame_used.sum()) for name, fit in corners.items()},
                corners_used={name: int(fit.frame_used[fit.frame].sum()) for name, fit in corners.items()},
                reprojection_rms_px=dict.fromkeys(corners, 1.05 * PIXEL_SIGMA),
                duration_s=case.duration_s,
                converged=True,
            ),
        ),
        provenance=Provenance(
            gnomon_version="0.2.0",
            method="camera-imu",
            inputs=tuple(Source(name=name, sha256=f"{i:x}" * 64) for i, name in enumerate(case.names)),
            options={"model": case.model},
        ),
    )
