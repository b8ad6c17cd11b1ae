"""Verdict and advice on a camera-IMU calibration: what to trust, what to do next."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from ...estimate.camera_imu.choices import LADDER
from ...estimate.camera_imu.start.first_guess import imu_stream
from ...findings import Finding, list_first, make_finding
from ...geometry.rotations import rotvec_from_rotation
from ...options.requirements import GENERAL_RIG
from ...recording import Floats
from ...results.calibration import Assessment, CameraImuFit
from ...results.camera_diagnostics import CameraImuDiagnostics, EstimatedParameter, NoiseLevel
from ...results.trust import WeakDirection
from ..checks.clock_checks import check_drift
from ..directions import across_words, axis_words
from ..observability import PLACES_AND_CLOCKS, known_of, weak_directions, weak_findings
from ..verdict import grade_by_limits, gravity_findings, most_severe, with_verdict
from .camera_imu_tables import MISFIT, NO_BOARD, NOTHING, CameraImuFitSummary
from .rig_findings import cut_findings, residual_findings

if TYPE_CHECKING:
    from ...estimate.camera_imu.result.publish import PublishedRig
    from ...estimate.camera_imu.result.uncertainty import Uncertainty

_HELD = 0.3
"""Share of its weak prior's sigma from which on a parameter counts as not determined by the recording."""

_SIGNIFICANT, _MODEL_SIGNIFICANT = 5.0, 8.0  # sigmas; errors of a real detector feign four in the IMU's model
_OF_IMU = ("scale", "misalignment", "g-sensitivity", "lever arms", "accelerometer delay")
_GUESS_RAD = np.radians(10.0)
_EXCHANGED = 3.0  # times nearer to where the other camera was stated to be
_NOISE_FACTOR = 3.0
_WALK = ".walk"
_ONE_AXIS = 0.1
_EXPLAINED, _FITS = 0.9, 2.0


def assess_camera_imu(
    noticed: tuple[Finding, ...], evidence: CameraImuFitSummary, diagnostics: CameraImuDiagnostics
) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    noticed : what the data doctor found; what was fine is not repeated
    evidence : what the calibration was made of
    diagnostics : its tables
    """
    fit = _fit(evidence, diagnostics)
    held = tuple(
        p.name
        for p in diagnostics.parameters
        if p.status == "estimated" and np.isfinite(p.prior_sigma) and p.sigma > _HELD * p.prior_sigma
    )
    findings = [
        *(finding for finding in noticed if finding.severity != "good"),
        *_convergence(evidence),
        *_rotation(evidence),
        *_observability(held, diagnostics),
        *_residuals(evidence, diagnostics),
        *_frames(fit, diagnostics),
        *_board_size(evidence),
        *_scene_size(evidence),
        *_intrinsics(evidence),
        *_model(evidence, diagnostics),
        *_stated_guess(evidence),
        *_noise(diagnostics),
        *residual_findings(diagnostics),
        *_clocks(evidence),
        *cut_findings(diagnostics.segments, tuple(evidence.published.imus)),
        *gravity_findings(evidence.gravity),
    ]
    assessment = Assessment(
        model=_model_name(evidence),
        held_by_prior=held,
        camera_imu=fit,
    )
    return with_verdict(assessment, findings)


def _model_name(evidence: CameraImuFitSummary) -> str:
    """Return the model of the IMU; "auto" is the full one, to which blocks are added."""
    return "full" if evidence.options.model == "auto" else evidence.options.model


def _fit(evidence: CameraImuFitSummary, diagnostics: CameraImuDiagnostics) -> CameraImuFit:
    corners = diagnostics.corners
    rms: dict[str, float] = {}
    used: dict[str, int] = {}
    for name, fit in corners.items():
        taken = fit.frame_used[fit.frame] & np.isfinite(fit.residual[:, 0])
        used[name] = int(taken.sum())
        rms[name] = float(np.sqrt(np.mean(fit.residual[taken] ** 2))) if taken.any() else float("nan")
    return CameraImuFit(
        frames_found={name: int((fit.frame_corners > 0).sum()) for name, fit in corners.items()},
        frames_used={name: int(fit.frame_used.sum()) for name, fit in corners.items()},
        corners_used=used,
        reprojection_rms_px=rms,
        duration_s=evidence.solution.state.trajectory.grid.duration_s,
        converged=evidence.solution.converged,
    )


def _convergence(evidence: CameraImuFitSummary) -> list[Finding]:
    if evidence.solution.converged:
        return []
    accepted = sum(step.accepted for step in evidence.solution.iterations)
    return [make_finding("not-converged/rig", accepted=accepted)]


def _rotation(evidence: CameraImuFitSummary) -> list[Finding]:
    findings: list[Finding] = []
    # What the poses' noise hid before the estimation is no disagreement where the gyroscope fits after it.
    level = evidence.solution.noise_found.imus[0].gyroscope / np.sqrt(evidence.imus[0].rates_hz[0])
    fits = evidence.solution.converged and level < _FITS * evidence.imus[0].nominal.gyroscope_noise_density
    for look in evidence.looks:
        axes, score = look.alignment.axes, look.alignment.score
        if axes[1] < _ONE_AXIS * axes[0]:
            about = look.alignment.directions[:, 0]
            findings.append(
                make_finding(
                    "rotation-one-axis",
                    name=look.name,
                    axis=axis_words(about, of_camera=True),
                    others=across_words(about, of_camera=True),
                    axis_rate=axes[0],
                    second_rate=axes[1],
                )
            )
        if score < _EXPLAINED and not fits:
            findings.append(make_finding("rotation-disagrees", score=max(score, 0), name=look.name))
    return findings


def _observability(held: tuple[str, ...], diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Say what the recording does not determine: in words of motions, and what is left over by its name."""
    weak = () if diagnostics.trust is None else diagnostics.trust.weak
    findings = weak_findings(weak, with_camera=True)
    if not held or any(one.held for one in weak):
        return findings
    vital = [name for name in held if any(part in name for part in PLACES_AND_CLOCKS)]
    return [
        *findings,
        make_finding(
            "not-observable/rig",
            severity="problem" if vital else "warning",
            parameters=list_first(vital or list(held)),
        ),
    ]


def _residuals(evidence: CameraImuFitSummary, diagnostics: CameraImuDiagnostics) -> list[Finding]:
    findings: list[Finding] = []
    for look in evidence.looks:
        sigma = diagnostics.corners[look.name].sigma_px
        severity = grade_by_limits("corner residual", sigma)
        if severity != "good":
            findings.append(make_finding("reprojection/rig", severity=severity, name=look.name, sigma=sigma))
    return findings


def _frames(fit: CameraImuFit, diagnostics: CameraImuDiagnostics) -> list[Finding]:
    findings: list[Finding] = []
    for name, found in fit.frames_found.items():
        left = found - fit.frames_used[name]
        share = left / max(found, 1)
        severity = grade_by_limits("left out", share)
        if not left:
            continue
        reasons = diagnostics.corners[name].frame_reason
        counts = {reason: reasons.count(reason) for reason in dict.fromkeys(reasons) if reason}
        for nothing in (NO_BOARD, NOTHING):
            counts.pop(nothing, None)
        why = ", ".join(f"{count} {_plainly(reason)}" for reason, count in counts.items())
        findings.append(
            make_finding(
                "frames-left-out",
                severity="info" if severity == "good" else severity,
                case="few" if severity == "good" else "",
                name=name,
                left=left,
                found=found,
                why=why,
            )
        )
    return findings


def _plainly(reason: str) -> str:
    return {
        MISFIT: "fit badly as a whole (blurred, late or misdetected)",
        "outside of the trajectory": "lie outside of the trajectory",
        "too few corners": "have too few corners",
    }.get(reason, reason)


def _board_size(evidence: CameraImuFitSummary) -> Iterator[Finding]:
    """Say that the board's size contradicts gravity, which the accelerometer measures with it."""
    held = evidence.uncertainty.held.get("target.scale")
    if held is None:
        return
    offset, sigma = float(held.wanted[0]), float(held.wanted_sigma[0])
    severity = grade_by_limits("board size", abs(offset))
    if severity == "good" or abs(offset) < _SIGNIFICANT * sigma:
        return
    scale = evidence.solution.state.parameters.target_scale + offset
    way = "smaller" if scale < 1 else "larger"
    yield make_finding(
        "target-scale",
        severity=severity,
        scale=abs(scale - 1),
        way=way,
        sigma=sigma,
    )


def _scene_size(evidence: CameraImuFitSummary) -> Iterator[Finding]:
    """Say by what the size of a scene without a board is known, and how well."""
    if evidence.target.kind != "landmarks":
        return
    certain, scale = evidence.uncertainty, evidence.solution.state.parameters.target_scale
    at = certain.names.index("target.scale")
    sigma = float(np.sqrt(certain.covariance[at, at])) / scale
    severity = grade_by_limits("scene size", sigma)
    yield make_finding(
        "scene-size",
        severity="info" if severity == "good" else severity,
        landmarks=len(evidence.target),
        sigma=sigma,
    )


def _intrinsics(evidence: CameraImuFitSummary) -> list[Finding]:
    """Say that the stated intrinsics contradict the corners."""
    findings: list[Finding] = []
    for look in evidence.looks:
        held = evidence.uncertainty.held.get(f"{look.name}.intrinsics")
        if held is None or len(held.wanted) < 4:
            continue
        focal = look.frames.camera.intrinsics[-4:-2]
        relative = np.abs(held.wanted[-4:-2] / focal)
        shift = np.abs(held.wanted[-2:])
        significant = np.abs(held.wanted[-4:]) > _SIGNIFICANT * held.wanted_sigma[-4:]
        relative, shift = relative * significant[:2], shift * significant[2:]
        of_focal = grade_by_limits("focal length", float(relative.max()))
        severity = most_severe(of_focal, grade_by_limits("stated centre", float(shift.max())))
        if severity == "good":
            continue
        findings.append(
            make_finding(
                "intrinsics-doubtful",
                severity=severity,
                name=look.name,
                focal=relative.max(),
                centre_px=shift.max(),
            )
        )
    return findings


def _model(evidence: CameraImuFitSummary, diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Say that the IMU has errors beyond its model: a held block would take a step, or foretells time left out."""
    wanting: list[str] = []
    for name, held in evidence.uncertainty.held.items():
        if name.startswith("imu") and np.any(np.abs(held.wanted) > _MODEL_SIGNIFICANT * held.wanted_sigma):
            wanting.append(name)
    for step in () if diagnostics.trust is None else diagnostics.trust.models:
        told = any(name.endswith(LADDER.get(step.name, ())) for name in wanting)
        if step.name in _OF_IMU and not (told or step.used) and step.gain > step.needed:
            wanting.append(step.name)
    if not wanting:
        return []
    return [make_finding("model-too-simple/suggested", wanting=list_first(wanting), model=_model_name(evidence))]


def _stated_guess(evidence: CameraImuFitSummary) -> list[Finding]:
    """Say where a camera lies otherwise than it was stated to: turned, or as another camera was."""
    stated = {look.name: look.frames.T_cam_imu for look in evidence.looks}
    known = {name: T for name, T in stated.items() if T is not None}
    found = {name: evidence.published.cameras[name].T_cam_imu for name in known}
    findings: list[Finding] = []
    for name, T in known.items():
        angle = float(np.linalg.norm(rotvec_from_rotation(T[:3, :3].T @ found[name][:3, :3])))
        inverse = float(np.linalg.norm(rotvec_from_rotation(T[:3, :3] @ found[name][:3, :3])))
        if angle > _GUESS_RAD:
            findings.append(
                make_finding(
                    "extrinsics-contradicted", case="inverse" if inverse < _GUESS_RAD else "", name=name, angle=angle
                )
            )
    for name, other in combinations(known, 2):
        own, exchanged = (
            sum(float(np.linalg.norm(found[one] - known[two])) for one, two in pairs)
            for pairs in (((name, name), (other, other)), ((name, other), (other, name)))
        )
        if own > _EXCHANGED * exchanged:
            findings.append(make_finding("extrinsics-contradicted/exchanged", name=name, other=other))
    return findings


def _noise(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    white = [level for level in diagnostics.noise if not level.name.endswith(_WALK)]
    return [*_white_noise(white), *_walks(diagnostics)]


def _walks(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Say where biases wander more than stated; of a weaker walk a recording says little."""
    return [
        make_finding(
            "walk-differs",
            name=level.name.removesuffix(_WALK),
            ratio=level.estimated / level.used,
            estimated=level.estimated,
            used=level.used,
            unit=level.unit,
        )
        for level in diagnostics.noise
        if level.name.endswith(_WALK) and level.estimated > _NOISE_FACTOR * level.used
    ]


def _white_noise(levels: list[NoiseLevel]) -> list[Finding]:
    return [
        make_finding(
            "noise-differs",
            severity="warning" if level.estimated > _NOISE_FACTOR * level.used else "info",
            case="own-noise" if level.used == level.estimated else "",
            name=level.name,
            ratio=level.estimated / level.nominal,
            estimated=level.estimated,
            nominal=level.nominal,
            unit=level.unit,
            use=f"Used was {level.used:.3g} {level.unit}.",
        )
        for level in levels
        if np.isfinite(level.nominal) and not 1 / _NOISE_FACTOR < level.estimated / level.nominal < _NOISE_FACTOR
    ]


def _clocks(evidence: CameraImuFitSummary) -> list[Finding]:
    """Say where the time shift changes over the recording."""
    stream = imu_stream(evidence.solution.measurements.inertial)
    imu = next(iter(evidence.recording.imus))
    entries = evidence.solution.state.parameters.cameras
    return [
        finding
        for look, entry in zip(evidence.looks, entries, strict=True)
        for finding in check_drift(look.name, look.poses, stream, entry.time_shift_s, imu)
    ]


_PUBLISHED = {
    "S_a": "accelerometer.sensitivity",
    "M_a": "accelerometer.sensitivity",
    "S_g": "gyroscope.sensitivity",
    "M_g": "gyroscope.sensitivity",
    "q_bg": "gyroscope.sensitivity",
    "B_g": "gyroscope.g_sensitivity",
    "time_shift": "time_shift_imu",
    "accelerometer_shift": "accelerometer.time_shift",
}
"""Block of the estimation -> what of it is published."""


_USUAL_FOCAL_ERROR = 3e-3
"""Focal lengths of usual camera calibrations are off by so much: 0.5 to 0.8 % were found in those of EuRoC."""


_MATTERS = 2.0


def camera_imu_weak(
    published: "PublishedRig", found: "Uncertainty", parameters: Sequence[EstimatedParameter], duration_s: float
) -> tuple[WeakDirection, ...]:
    """Return the weak directions of cameras and IMU.

    Parameters
    ----------
    published : sensors and their covariance, of which that for independent errors tells what is determined
    found : what held intrinsics would do
    parameters : scalars of the estimation, whose status tells what was stated beforehand
    duration_s : of the recording
    """
    stated: dict[str, float] = {}
    for parameter in parameters:
        if parameter.status == "prior":
            sensor, _, rest = parameter.name.partition(".")
            block, bracket, place = rest.partition("[")
            path = _PUBLISHED.get(block)
            name = f"{sensor}.{path}" if path else f"{sensor}.{block}{bracket}{place}"
            stated[name] = parameter.prior_sigma
    known = known_of(published.imus, published.cameras, published.covariance, stated=stated, duration_s=duration_s)
    followed: list[WeakDirection] = []
    for name, camera in published.cameras.items():
        held = found.held.get(f"{name}.intrinsics")
        place = [known.names.index(f"{name}.T_cam_imu.translation[{k}]") for k in range(3)]
        focal = camera.camera.intrinsics[-4:-2]
        if held is None or len(held.names) < len(camera.camera.intrinsics):
            continue  # estimated jointly, at least in part
        moved = published.jacobian[place] @ held.by_unit[-4:-2].T @ focal * _USUAL_FOCAL_ERROR
        sigma = np.sqrt(np.diag(published.covariance)[place])
        one = through_stated_focal(name, moved, sigma)
        followed += [] if one is None else [one]
    return (*weak_directions(known), *followed)


def through_stated_focal(camera: str, moved: Floats, sigma: Floats) -> WeakDirection | None:
    """Return the direction that is known only as well as the focal length that was stated, where that matters.

    Parameters
    ----------
    camera : its name
    moved : (3,) change of its translation by a usual error of the focal length [m]
    sigma : (3,) published standard deviations of the translation [m]
    """
    size = float(np.linalg.norm(moved))
    along = moved / max(size, 1e-300)
    if size < GENERAL_RIG.needs["camera_translation"] or size < _MATTERS * float(np.linalg.norm(along * sigma)):
        return None
    order = np.argsort(-np.abs(along))
    return WeakDirection(
        shares=tuple((f"{camera}.T_cam_imu.translation[{i}]", float(along[i])) for i in order),
        determined=1.0,
        words=f"The translation of {camera} along its {axis_words(along, of_camera=True)} is known only through the "
        f"focal length that was stated: an error of {100 * _USUAL_FOCAL_ERROR:.1f} % moves it by {1e3 * size:.2g} mm, "
        "which its standard deviation does not hold.",
        cure=f"Come nearer to the board, or let the lens be estimated jointly: --prior {camera}.intrinsics=5.",
        held=False,
    )
