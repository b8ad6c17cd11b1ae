"""Verdict and advice on a camera-IMU calibration: what to trust, what to do next."""

import numpy as np

from ..calibration import Assessment, CameraImuFit
from ..diagnostics import CameraImuDiagnostics, NoiseLevel
from ..estimate.camera_imu.first_guess import imu_stream
from ..estimate.camera_imu.model_ladder import LADDER
from ..findings import Finding
from ..geometry.rotation_vector import rotvec_from_rotation
from .camera_imu_tables import MISFIT, CameraImuEvidence
from .clock_drift import check_drift
from .rig_precision import precision_findings
from .rig_residuals import cut_findings, residual_findings
from .verdict import gravity_findings, verdict_of, worst_first
from .weak_findings import PLACES_AND_CLOCKS, weak_findings

_PIXELS_WARN, _PIXELS_FAIL = 1.0, 3.0
_LEFT_OUT_WARN, _LEFT_OUT_FAIL = 0.25, 0.6
_HELD = 0.3
"""Share of its weak prior's sigma from which on a parameter counts as not determined by the recording."""

_SCALE_WARN, _SCALE_FAIL = 0.003, 0.03
_FOCAL_WARN, _FOCAL_FAIL = 0.003, 0.03
_PRINCIPAL_WARN_PX, _PRINCIPAL_FAIL_PX = 1.0, 15.0  # 1 px is some 0.1 deg of rotation
_SIGNIFICANT, _MODEL_SIGNIFICANT = 5.0, 8.0  # sigmas; errors of a real detector feign four in the IMU's model
_OF_IMU = ("scale", "misalignment", "g-sensitivity", "lever arms", "accelerometer delay")
_GUESS_RAD = np.radians(10.0)
_NOISE_FACTOR = 3.0
_WALK = ".walk"
_ONE_AXIS = 0.1
_EXPLAINED, _FITS = 0.9, 2.0


def assess(noticed: tuple[Finding, ...], evidence: CameraImuEvidence, diagnostics: CameraImuDiagnostics) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    noticed : what the data doctor found; what was fine is not repeated
    evidence : what the calibration was made of
    diagnostics : its tables
    """
    fit = _fit(evidence, diagnostics)
    held = _held_by_prior(diagnostics)
    findings = [
        *(finding for finding in noticed if finding.severity != "good"),
        *_convergence(evidence),
        *_rotation(evidence),
        *_observability(held, diagnostics),
        *precision_findings(diagnostics, tuple(evidence.published.imus)[1:], tuple(evidence.published.cameras)),
        *_residuals(evidence, diagnostics),
        *_frames(fit, diagnostics),
        *_board_size(evidence),
        *_intrinsics(evidence),
        *_model(evidence, diagnostics),
        *_stated_guess(evidence),
        *_noise(diagnostics),
        *residual_findings(diagnostics),
        *_clocks(evidence),
        *cut_findings(diagnostics.segments, tuple(evidence.published.imus)),
        *gravity_findings(evidence.gravity),
    ]
    ordered = worst_first(findings)
    return Assessment(
        verdict=verdict_of(ordered),
        findings=ordered,
        model=_model_name(evidence),
        held_by_prior=held,
        camera_imu=fit,
    )


def _model_name(evidence: CameraImuEvidence) -> str:
    """Return the model of the IMU; "auto" is the full one, to which blocks are added."""
    return "full" if evidence.options.model == "auto" else evidence.options.model


def _fit(evidence: CameraImuEvidence, diagnostics: CameraImuDiagnostics) -> CameraImuFit:
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


def _graded(value: float, warn: float, fail: float) -> str | None:
    """Return "problem" beyond fail, "warning" beyond warn, None else."""
    return "problem" if not value <= fail else "warning" if value > warn else None


def _convergence(evidence: CameraImuEvidence) -> list[Finding]:
    if evidence.solution.converged:
        return []
    accepted = sum(step.accepted for step in evidence.solution.iterations)
    return [
        Finding(
            severity="problem",
            code="not-converged",
            message=f"The batch estimation did not come to rest within {accepted} iterations.",
            consequence="Its parameters are not a minimum.",
            cure="Check the target's size, the intrinsics and the units of the IMU; move about all three axes.",
        )
    ]


def _rotation(evidence: CameraImuEvidence) -> list[Finding]:
    findings: list[Finding] = []
    # What the poses' noise hid before the estimation is no disagreement where the gyroscope fits after it.
    level = evidence.solution.noise_found.imus[0].gyroscope / np.sqrt(evidence.imus[0].rates_hz[0])
    fits = evidence.solution.converged and level < _FITS * evidence.imus[0].nominal.gyroscope_noise_density
    for look in evidence.looks:
        axes, score = look.alignment.axes, look.alignment.score
        if axes[1] < _ONE_AXIS * axes[0]:
            findings.append(
                Finding(
                    severity="problem",
                    code="rotation-one-axis",
                    message=f"{look.name} turned about one axis only: {axes[0]:.2g} rad/s (rms) about it, "
                    f"{axes[1]:.2g} rad/s about any other.",
                    consequence="The translation along that axis, and much of the gyroscope, are not determined.",
                    cure="Turn about all three axes: nod, shake and roll.",
                )
            )
        if score < _EXPLAINED and not fits:
            findings.append(
                Finding(
                    severity="warning",
                    code="rotation-disagrees",
                    message=f"The gyroscope explains {100 * max(score, 0):.0f} % of the rotation of {look.name} "
                    "before the batch estimation.",
                    consequence="The time shift may be wrong, or the frames are stamped irregularly.",
                    cure="Check that both streams are of one recording, and how frames are stamped.",
                )
            )
    return findings


def _held_by_prior(diagnostics: CameraImuDiagnostics) -> tuple[str, ...]:
    return tuple(
        p.name
        for p in diagnostics.parameters
        if p.status == "estimated" and np.isfinite(p.prior_sigma) and p.sigma > _HELD * p.prior_sigma
    )


def _observability(held: tuple[str, ...], diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Say what the recording does not determine: in words of motions, and what is left over by its name."""
    weak = () if diagnostics.trust is None else diagnostics.trust.weak
    findings = weak_findings(weak, with_camera=True)
    if not held or any(one.held for one in weak):
        return findings
    vital = [name for name in held if any(part in name for part in PLACES_AND_CLOCKS)]
    return [
        *findings,
        Finding(
            severity="problem" if vital else "warning",
            code="not-observable",
            message=f"The recording does not determine {_listed(vital or list(held))}.",
            consequence="Their values are those of the start, and their sigmas those of a weak prior.",
            cure="Record again: turn about all three axes, move to and fro along all three, one to two minutes.",
        ),
    ]


def _listed(names: list[str], most: int = 6) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _residuals(evidence: CameraImuEvidence, diagnostics: CameraImuDiagnostics) -> list[Finding]:
    findings: list[Finding] = []
    for look in evidence.looks:
        sigma = diagnostics.corners[look.name].sigma_px
        severity = _graded(sigma, _PIXELS_WARN, _PIXELS_FAIL)
        if severity is not None:
            findings.append(
                Finding(
                    severity="problem" if severity == "problem" else "warning",
                    code="reprojection",
                    message=f"Corners of {look.name} lie {sigma:.2g} px (one sigma, per axis) from where they should; "
                    "0.05 to 0.5 px is usual.",
                    consequence="The lens model is not that of this camera, or the board is not the stated one.",
                    cure="Check camchain.yaml (camera, model, resolution) and target.yaml; calibrate the camera anew.",
                )
            )
    return findings


def _frames(fit: CameraImuFit, diagnostics: CameraImuDiagnostics) -> list[Finding]:
    findings: list[Finding] = []
    for name, found in fit.frames_found.items():
        left = found - fit.frames_used[name]
        share = left / max(found, 1)
        severity = _graded(share, _LEFT_OUT_WARN, _LEFT_OUT_FAIL)
        if not left:
            continue
        reasons = diagnostics.corners[name].frame_reason
        counts = {reason: reasons.count(reason) for reason in dict.fromkeys(reasons) if reason}
        counts.pop("no board found", None)
        why = ", ".join(f"{count} {_plainly(reason)}" for reason, count in counts.items())
        findings.append(
            Finding(
                severity="info" if severity is None else "problem" if severity == "problem" else "warning",
                code="frames-left-out",
                message=f"{name}: {left} of {found} frames with corners were left out: {why}.",
                consequence="" if severity is None else "What is left may be too little, or a biased choice.",
                cure="" if severity is None else "Move slower or light the board better, so that frames are sharp.",
            )
        )
    return findings


def _plainly(reason: str) -> str:
    return {
        MISFIT: "fit badly as a whole (blurred, late or misdetected)",
        "outside of the trajectory": "lie outside of the trajectory",
        "too few corners": "have too few corners",
    }.get(reason, reason)


def _board_size(evidence: CameraImuEvidence) -> list[Finding]:
    """Say that the board's size contradicts gravity, which the accelerometer measures with it."""
    held = evidence.uncertainty.held.get("target.scale")
    if held is None:
        return []
    offset, sigma = float(held.wanted[0]), float(held.wanted_sigma[0])
    severity = _graded(abs(offset), _SCALE_WARN, _SCALE_FAIL)
    if severity is None or abs(offset) < _SIGNIFICANT * sigma:
        return []
    scale = evidence.solution.state.parameters.target_scale + offset
    way = "smaller" if scale < 1 else "larger"
    return [
        Finding(
            severity="problem" if severity == "problem" else "warning",
            code="target-scale",
            message=f"The accelerometer says that the board is {100 * abs(scale - 1):.2g} % {way} than stated "
            f"(+- {100 * sigma:.1g} %).",
            consequence="Translations and the accelerometer's scale are wrong by about that.",
            cure="Measure the board and correct target.yaml (tagSize, or the spacing of the corners); for AprilGrids "
            "check tagSpacing too. If the board is right, check the unit of the accelerometer and local gravity.",
        )
    ]


def _intrinsics(evidence: CameraImuEvidence) -> list[Finding]:
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
        grades = {
            _graded(float(relative.max()), _FOCAL_WARN, _FOCAL_FAIL),
            _graded(float(shift.max()), _PRINCIPAL_WARN_PX, _PRINCIPAL_FAIL_PX),
        }
        if grades == {None}:
            continue
        findings.append(
            Finding(
                severity="problem" if "problem" in grades else "warning",
                code="intrinsics-doubtful",
                message=f"The corners contradict the intrinsics of {look.name}: focal length off by "
                f"{100 * relative.max():.2g} %, principal point by {shift.max():.2g} px.",
                consequence="Extrinsics and the accelerometer's scale follow that error: 0.3 % of the focal length "
                "are some 2 mm of translation.",
                cure="Check that camchain.yaml is of this camera, lens and resolution; calibrate the camera anew, or "
                f"let them be estimated: --prior {look.name}.intrinsics=5.",
            )
        )
    return findings


def _model(evidence: CameraImuEvidence, diagnostics: CameraImuDiagnostics) -> list[Finding]:
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
    return [
        Finding(
            severity="warning",
            code="model-too-simple",
            message=f"The residuals ask for {_listed(wanting)}, which the model {_model_name(evidence)} holds at the "
            "values of an ideal IMU.",
            consequence="Extrinsics, time shift and biases take up what the model leaves out, by many of their sigmas.",
            cure="Estimate the full model: --model full, or name what to estimate with --free.",
        )
    ]


def _stated_guess(evidence: CameraImuEvidence) -> list[Finding]:
    findings: list[Finding] = []
    for look in evidence.looks:
        stated = look.frames.T_cam_imu
        if stated is None:
            continue
        found = evidence.published.cameras[look.name].T_cam_imu
        angle = float(np.linalg.norm(rotvec_from_rotation(stated[:3, :3].T @ found[:3, :3])))
        inverse = float(np.linalg.norm(rotvec_from_rotation(stated[:3, :3] @ found[:3, :3])))
        if angle > _GUESS_RAD:
            findings.append(
                Finding(
                    severity="warning",
                    code="extrinsics-contradicted",
                    message=f"T_cam_imu as stated for {look.name} is turned by {np.degrees(angle):.0f} deg from the "
                    "estimate." + (" It is the inverse, T_imu_cam." if inverse < _GUESS_RAD else ""),
                    consequence="The statement was not used.",
                    cure="Check its convention: p_cam = T_cam_imu p_imu, camera x right, y down, z forward.",
                )
            )
    return findings


def _noise(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    white = [level for level in diagnostics.noise if not level.name.endswith(_WALK)]
    return [*_white_noise(white), *_walks(diagnostics)]


def _walks(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Say where biases wander more than stated; of a weaker walk a recording says little."""
    return [
        Finding(
            severity="info",
            code="walk-differs",
            message=f"The bias of {level.name.removesuffix(_WALK)} wanders {level.estimated / level.used:.2g} times as "
            f"strongly as was assumed, {level.estimated:.3g} instead of {level.used:.3g} {level.unit}.",
            consequence="Sigmas for independent errors are too small; those from clusters of time hold this wandering.",
            cure="Warm-up, vibration, or errors of lens and board look like this. Compare with a recording at rest "
            "(gnomon noise), or let the biases follow (--noise coloured).",
        )
        for level in diagnostics.noise
        if level.name.endswith(_WALK) and level.estimated > _NOISE_FACTOR * level.used
    ]


def _white_noise(levels: list[NoiseLevel]) -> list[Finding]:
    return [
        Finding(
            severity="warning" if level.estimated > _NOISE_FACTOR * level.used else "info",
            code="noise-differs",
            message=f"The noise of {level.name} is {level.estimated / level.nominal:.2g} times the stated one: "
            f"{level.estimated:.3g} instead of {level.nominal:.3g} {level.unit}.",
            consequence="The found level was used." if level.used == level.estimated else _use(level),
            cure="Vibration raises it; a filter in the sensor lowers it. Put the found level into your filter.",
        )
        for level in levels
        if np.isfinite(level.nominal) and not 1 / _NOISE_FACTOR < level.estimated / level.nominal < _NOISE_FACTOR
    ]


def _use(level: NoiseLevel) -> str:
    return f"Used was {level.used:.3g} {level.unit}."


def _clocks(evidence: CameraImuEvidence) -> list[Finding]:
    """Say where the time shift changes over the recording."""
    stream = imu_stream(evidence.solution.measurements.inertial)
    imu = next(iter(evidence.recording.imus))
    entries = evidence.solution.state.parameters.cameras
    return [
        finding
        for look, entry in zip(evidence.looks, entries, strict=True)
        for finding in check_drift(look.name, look.poses, stream, entry.time_shift_s, imu)
    ]
