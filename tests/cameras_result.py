"""A result of a camera calibration with realistic numbers, made without a solver: what a report has to show.

Cameras look at an AprilGrid from all sides. Corners are its images with noise; the covariance follows from the
derivatives of these images, the poses of the views eliminated, and the estimate is drawn from it.
"""

from dataclasses import dataclass, replace

import numpy as np

from gnomon.assess.cameras.cameras_tables import MISFIT, NOT_CHOSEN
from gnomon.findings import Finding
from gnomon.geometry.rotations import rotation_from_rotvec, skew
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import Source
from gnomon.results.calibration import Assessment, Calibration, CamerasFit, Covariance, Gravity, Provenance
from gnomon.results.camera_diagnostics import (
    CamerasDiagnostics,
    CornerFit,
    EstimatedParameter,
    LensTrial,
    NoiseLevel,
    SolverStep,
    ViewPose,
)
from gnomon.results.result import Result
from gnomon.results.sensors import CameraCalibration, covariance_names
from gnomon.results.trust import BlockAgreement, Clusters, SigmaRatio, Splits, Trust, UncertaintySummary

PIXEL_SIGMA = 0.15
ROBUST = 1.3
BOARD = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)

LENSES = {
    "pinhole-radtan": Camera(
        projection="pinhole", intrinsics=[458.65, 457.3, 367.2, 248.4], distortion="radtan",
        distortion_coeffs=[-0.2834, 0.0740, 2e-4, 1.8e-5], resolution=(752, 480),
    ),
    "ds-none": Camera(
        projection="ds", intrinsics=[-0.2, 0.59, 160.0, 160.2, 319.0, 241.5], distortion="none",
        distortion_coeffs=[], resolution=(640, 480),
    ),
    "pinhole-equidistant": Camera(
        projection="pinhole", intrinsics=[461.6, 460.2, 362.7, 248.1], distortion="equidistant",
        distortion_coeffs=[-0.0015, 0.0012, -6e-4, 2e-4], resolution=(752, 480),
    ),
}  # fmt: skip

FINDINGS = (
    Finding(
        severity="warning",
        code="image-not-covered",
        message="cam0 has no corners in the lower left of its image.",
        consequence="There nothing tests the lens.",
        cure="Hold the board into the lower left corner of the image, and tilt it there.",
    ),
    Finding(severity="info", code="assumed", message="the board is as large as its file says."),
    Finding(severity="good", code="held-out", message="Views that were held out fit as well as those used."),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    cameras: int = 2
    used: int = 40
    held: int = 12
    model: str = "pinhole-radtan"
    verdict: str = "warn"
    findings: tuple[Finding, ...] = FINDINGS
    names: tuple[str, ...] = ("stereo.bag", "target.yaml")
    bow_m: float = 0.0008
    hidden: bool = True  # no corners at the lower left
    trust: bool = True
    trials: bool = True
    seed: int = 3


def make_cameras_result(**changes) -> Result:
    """Return a result; `changes` are fields of Case."""
    case = Case(**changes)
    rng = np.random.default_rng(case.seed)
    truth = {f"cam{i}": LENSES[case.model] for i in range(case.cameras)}
    T = _places(case.cameras)
    poses = _poses(case, rng)
    seen = {name: _seen(case, T[i], truth[name], poses, rng) for i, name in enumerate(truth)}
    names, covariance = _covariance(case, truth, T, poses, seen)
    return _result(case, rng, truth, T, poses, seen, names, covariance)


def _places(count) -> np.ndarray:
    T = np.tile(np.eye(4), (count, 1, 1))
    for i in range(1, count):
        T[i, :3, :3] = rotation_from_rotvec(np.array([0.001, -0.006, 0.012 * i]))
        T[i, :3, 3] = (-0.11 * i, 0.0004, -0.0008)
    return T


def _poses(case, rng) -> list[tuple[np.ndarray, np.ndarray]]:
    """R_cam0_target and p_cam0_target of views: the board tilted and turned, somewhere in the image."""
    found = []
    lens, middle = LENSES[case.model], BOARD.points.mean(axis=0)
    width, height = lens.resolution
    while len(found) < case.used + case.held + 2:
        tilt, azimuth, roll = rng.uniform(0.05, 0.75), rng.uniform(-np.pi, np.pi), rng.normal(0, 0.3)
        turn = rotation_from_rotvec(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
        R = turn @ rotation_from_rotvec(np.array([0, 0, roll])) @ np.diag([1.0, -1.0, -1.0])
        ray, valid = lens.unproject(rng.uniform((0.1 * width, 0.1 * height), (0.9 * width, 0.9 * height), (1, 2)))
        if valid[0]:
            found.append((R, rng.uniform(0.4, 1.1) * ray[0] - R @ middle))
    return found


def _points(case) -> np.ndarray:
    """The board as it is: it bulges in its middle."""
    size = np.array(BOARD.size_m)
    off = (2 * BOARD.points[:, :2] / size - 1) ** 2
    return BOARD.points + np.array([0, 0, case.bow_m])[None] * (1 - off[:, :1])


def _seen(case, T, lens, poses, rng):
    """Frame, point, pixels and what the noise was, of all corners in the image."""
    frame, point, pixels = [], [], []
    for k, (R, p) in enumerate(poses):
        in_camera = (_points(case) @ R.T + p) @ T[:3, :3].T + T[:3, 3]
        image = lens.project(in_camera)
        u, v = np.nan_to_num(image.pixels, nan=-1.0).T
        inside = image.valid & (u > 4) & (u < lens.resolution[0] - 5) & (v > 4) & (v < lens.resolution[1] - 5)
        if case.hidden:
            inside &= ~((u < 0.3 * lens.resolution[0]) & (v > 0.65 * lens.resolution[1]))
        frame.append(np.full(inside.sum(), k))
        point.append(np.flatnonzero(inside))
        pixels.append(image.pixels[inside])
    frame, point, pixels = np.concatenate(frame), np.concatenate(point), np.concatenate(pixels)
    return frame, point, pixels, rng.normal(0, PIXEL_SIGMA, pixels.shape)


def _covariance(case, lenses, T, poses, seen):
    """Names and covariance of the shared scalars, the poses of the views eliminated."""
    sizes = [len(lens.parameters) for lens in lenses.values()]
    places = np.cumsum([0, *sizes])
    total = int(places[-1]) + 6 * (len(lenses) - 1)
    names = [f"{name}.{p}" for name, lens in lenses.items() for p in lens.parameter_names]
    names += [f"cam{i}.T_cam_cam0.{part}[{k}]" for i in range(1, len(lenses))
              for part in ("rotation", "translation") for k in range(3)]  # fmt: skip
    information = np.zeros((total, total))
    for k in range(case.used):
        R, p = poses[k]
        rows = []
        for i, (name, lens) in enumerate(lenses.items()):
            frame, point, _, _ = seen[name]
            at = _points(case)[point[frame == k]]
            if not len(at):
                continue
            in_cam0 = at @ R.T + p
            image = lens.project(in_cam0 @ T[i, :3, :3].T + T[i, :3, 3], parameters_jacobian=True)
            block = np.zeros((len(at), 2, total + 6))
            block[:, :, places[i] : places[i + 1]] = image.by_parameters
            turned = image.by_point @ T[i, :3, :3]
            block[:, :, total : total + 3] = -turned @ R @ skew(at)
            block[:, :, total + 3 :] = turned
            if i:
                at_pose = int(places[-1]) + 6 * (i - 1)
                block[:, :, at_pose : at_pose + 3] = -turned @ skew(in_cam0)
                block[:, :, at_pose + 3 : at_pose + 6] = image.by_point
            rows.append(block.reshape(-1, total + 6))
        if rows:
            J = np.concatenate(rows)
            A = J.T @ J
            information += A[:total, :total] - A[:total, total:] @ np.linalg.pinv(A[total:, total:]) @ A[total:, :total]
    scale = 1 / np.sqrt(np.diag(information))
    covariance = scale[:, None] * np.linalg.inv(scale[:, None] * information * scale) * scale
    return names, PIXEL_SIGMA**2 * covariance


def _result(case, rng, truth, T, poses, seen, names, covariance) -> Result:
    off = dict(zip(names, rng.multivariate_normal(np.zeros(len(names)), covariance), strict=True))
    cameras, corners = {}, {}
    for i, (name, true) in enumerate(truth.items()):
        lens = true.with_parameters(true.parameters + [off[f"{name}.{p}"] for p in true.parameter_names])
        place = T[i].copy()
        if i:
            turn = np.array([off[f"{name}.T_cam_cam0.rotation[{k}]"] for k in range(3)])
            place[:3, :3] = place[:3, :3] @ rotation_from_rotvec(turn)
            place[:3, 3] += [off[f"{name}.T_cam_cam0.translation[{k}]"] for k in range(3)]
        cameras[name] = CameraCalibration(T_cam_body=place, time_shift_cam_imu=0.0, camera=lens, body="cam0")
        corners[name] = _corner_fit(case, *seen[name], lens.resolution)
    published = ROBUST**2 * covariance
    order = [names.index(name) for name in covariance_names({}, cameras)]
    calibration = Calibration(
        imus={},
        cameras=cameras,
        frame="cam0",
        gravity=Gravity(value=9.80665, sigma=0.0, source="standard gravity, since no place was given"),
        uncertainty=Covariance(names=covariance_names({}, cameras), matrix=published[np.ix_(order, order)]),
        assessment=_assessment(case, corners),
        provenance=Provenance(
            gnomon_version="0.3.0",
            method="camera",
            inputs=tuple(Source(name=name, sha256=f"{i:x}" * 64) for i, name in enumerate(case.names)),
            options={"board": "auto"},
        ),
    )
    sigma = np.sqrt(np.diag(published))
    return Result(
        calibration=calibration,
        diagnostics=CamerasDiagnostics(
            corners=corners,
            views=tuple(_view(case, k, R, p, corners, rng) for k, (R, p) in enumerate(poses[: case.used])),
            coverage={name: _coverage(fit) for name, fit in corners.items()},
            trials=_trials(case, corners) if case.trials else (),
            parameters=_parameters(case, calibration, names, sigma),
            correlation=_correlation(case, published, sigma),
            noise=tuple(
                NoiseLevel(name=f"{name}.corners", unit="px", nominal=np.nan, estimated=PIXEL_SIGMA, used=PIXEL_SIGMA)
                for name in corners
            ),
            steps=tuple(
                SolverStep(cost=cost, largest_step=step, damping=0.0, accepted=True)
                for cost, step in ((2.1e5, 310.0), (9.2e3, 22.0), (8.8e3, 0.4), (8.8e3, 2e-5))
            ),
            board_points=BOARD.points,
            board_shifts=_points(case) - BOARD.points,
            trust=_trust(case, calibration) if case.trust else None,
        ),
    )


def _corner_fit(case, frame, point, pixels, noise, resolution) -> CornerFit:
    frames = case.used + case.held + 2
    residual = -noise
    residual[frame >= frames - 2] *= 20  # two views in which the board moved
    used = np.arange(frames) < case.used
    count = np.bincount(frame, minlength=frames)
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(np.bincount(frame, (residual**2).sum(axis=1), minlength=frames) / (2 * count))
    order = np.random.default_rng(1).permutation(frames)  # held out here and there
    times = np.empty(frames)
    times[order] = np.arange(frames) * 0.5
    reason = ["" if k < case.used else NOT_CHOSEN if k < frames - 2 else MISFIT for k in range(frames)]
    return CornerFit(
        frame_t_s=times,
        frame_corners=count,
        frame_rms=rms,
        frame_used=used & (count > 0),
        frame_reason=tuple(r if n else "no corners" for r, n in zip(reason, count, strict=True)),
        frame=frame,
        point=point,
        pixels=pixels + noise,
        residual=residual,
        weight=np.clip(2 * PIXEL_SIGMA / np.fmax(np.linalg.norm(residual, axis=1), 1e-9), 0, 1),
        sigma_px=PIXEL_SIGMA,
        resolution=resolution,
    )


def _view(case, k, R, p, corners, rng) -> ViewPose:
    seen_by = tuple(name for name, fit in corners.items() if fit.frame_corners[k])
    first = next(iter(corners.values()))
    return ViewPose(
        t_ns=int(1e9 * first.frame_t_s[k]),
        cameras=seen_by,
        R_target_cam0=R.T,
        p_target_cam0=-R.T @ p,
        information=float(rng.gamma(2.0, 0.4)),
    )


def _coverage(fit) -> np.ndarray:
    kept = fit.frame_used[fit.frame]
    width, height = fit.resolution
    cells = np.histogram2d(
        fit.pixels[kept, 1], fit.pixels[kept, 0], (8, 10), ((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    return cells[0].astype(np.int64)


def _trials(case, corners) -> tuple[LensTrial, ...]:
    tried = (
        ("pinhole-radtan", 1.0, 1.0, 8), ("pinhole-radtan5", 1.002, 0.999, 9), ("pinhole-equidistant", 1.6, 1.55, 8),
        ("omni-radtan", 1.004, 0.998, 9), ("eucm-none", 2.3, 2.2, 6), ("ds-none", 2.4, 2.3, 6),
        ("pinhole-none", 30.0, 28.0, 4),
    )  # fmt: skip
    return tuple(
        LensTrial(
            camera=camera, model=model, chosen=model == case.model, parameters=count,
            holdout_rms_px=float("nan") if model == "omni-radtan" else held * PIXEL_SIGMA, rms_px=used * PIXEL_SIGMA,
        )
        for camera in corners
        for model, held, used, count in tried
    )  # fmt: skip


def _parameters(case, calibration, names, sigma) -> tuple[EstimatedParameter, ...]:
    def value(name):
        path, _, index = name.rstrip("]").partition("[")
        return float(calibration.parameter(path)[int(index)])

    found = [
        EstimatedParameter(
            name=name, unit=_unit(name), value=value(name), start=1.02 * value(name), sigma=float(spread),
            prior_sigma=float("inf"), status="estimated",
        )
        for name, spread in zip(names, sigma, strict=True)
    ]  # fmt: skip
    for name, unit, at, spread in (("target.bow[0]", "m", case.bow_m, 5e-5), ("target.aspect", "", 0.0, 0.0)):
        status = "estimated" if spread and case.bow_m else "fixed"
        found.append(EstimatedParameter(
            name=name, unit=unit, value=at, start=0.0, sigma=spread if status == "estimated" else 0.0,
            prior_sigma=float("inf"), status=status,
        ))  # fmt: skip
    return tuple(found)


def _unit(name) -> str:
    if "intrinsics" in name:
        return "px"
    return "rad" if "rotation" in name else "m" if "translation" in name else ""


def _correlation(case, covariance, sigma) -> np.ndarray:
    matrix = covariance / sigma[:, None] / sigma
    if case.bow_m:
        matrix = np.block([[matrix, np.full((len(sigma), 1), 0.1)], [np.full((1, len(sigma)), 0.1), np.ones((1, 1))]])
    return matrix


def _assessment(case, corners) -> Assessment:
    def rms(fit, kept):
        return float(np.sqrt(np.mean(fit.residual[kept[fit.frame]] ** 2)))

    frames = np.arange(case.used + case.held + 2)
    held = (frames >= case.used) & (frames < case.used + case.held)
    return Assessment(
        verdict=case.verdict,
        findings=case.findings,
        model=", ".join(dict.fromkeys([case.model] * case.cameras)),
        cameras=CamerasFit(
            views_found={name: int((fit.frame_corners > 0).sum()) for name, fit in corners.items()},
            views_used={name: int(fit.frame_used.sum()) for name, fit in corners.items()},
            corners_used={name: int(fit.frame_used[fit.frame].sum()) for name, fit in corners.items()},
            reprojection_rms_px={name: rms(fit, fit.frame_used) for name, fit in corners.items()},
            holdout_rms_px={name: rms(fit, held) if case.held else float("nan") for name, fit in corners.items()},
            coverage={name: float(np.mean(_coverage(fit) > 0)) for name, fit in corners.items()},
            models=dict.fromkeys(corners, (case.model, "ds-none")),
            board_added=("target.bow",) if case.bow_m else (),
            bow_m=case.bow_m,
            bow_sigma_m=5e-5 if case.bow_m else 0.0,
        ),
        trust=UncertaintySummary(covariance="cluster-robust" if case.trust else "ordinary", clusters=case.used),
    )


def _trust(case, calibration) -> Trust:
    names = tuple(calibration.uncertainty.names)
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    blocks = list(dict.fromkeys(name.partition("[")[0] for name in names))
    return Trust(
        clusters=Clusters(count=case.used, length_s=0.5, memory_s=0.0),
        names=names,
        ordinary_sigma=sigma / ROBUST,
        sigma=sigma,
        ratios=tuple(SigmaRatio(block=block, ratio=ROBUST) for block in blocks),
        splits=Splits(
            splits=("halves",),
            blocks=tuple(
                BlockAgreement(block=block, comparisons=4, z_rms=0.9 + 0.1 * i, z_rms_ordinary=1.2 + 0.12 * i,
                               largest=1.9, where="[0], first and second half")
                for i, block in enumerate(blocks)
            ),
            z_rms=1.05, z_rms_ordinary=1.4, limit=1.5,
        ),
    )  # fmt: skip


def without_lens_covariance(result: Result) -> Result:
    """Return the result with lenses that were given and held."""
    uncertainty = result.calibration.uncertainty
    kept = np.array([0.0 if "intrinsics" in name or "coeffs" in name else 1.0 for name in uncertainty.names])
    changed = replace(uncertainty, matrix=uncertainty.matrix * kept[:, None] * kept)
    return replace(result, calibration=replace(result.calibration, uncertainty=changed))
