"""Findings on what a recording hardly determines.

What the model took up because the recording proved it to be there, with its size and what to do about it.

What was known beforehand, and whether the recording agrees with it.
"""

from collections.abc import Mapping, Sequence
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ..estimate.multiposition.problem import ImuEstimate
from ..findings import Finding, make_finding
from ..options.requirements import GENERAL_RIG
from ..recording import Floats
from ..results.calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..results.camera_diagnostics import EstimatedParameter
from ..results.trust import WeakDirection
from .directions import axis_words
from .observability import known_of, weak_directions
from .priors import NAMES, KnownScalars, Prior
from .verdict import grade_by_limits

if TYPE_CHECKING:
    from ..estimate.camera_imu.layout import BorderLayout
    from ..estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
    from ..estimate.camera_imu.result.publish import PublishedRig
    from ..estimate.camera_imu.result.uncertainty import TriadMisfit, Uncertainty
    from ..models.camera import Camera


_FOCAL_WARN, _PRINCIPAL_WARN_PX = 0.03, 15.0
"""Beyond these it is doubtful that the stated intrinsics are of this camera."""

_DELAYED, _CERTAIN, _FILTERED = "triads-apart", 3.0, 4.0

_FAST_RAD_S = 2 * pi * 5
"""Angular frequency of a fast motion of a hand, at which a filter is described."""


def added_findings(
    added: tuple[str, ...], start: "RigParameters", found: "RigParameters", *, board_told: bool, arms_told: bool = False
) -> list[Finding]:
    """Say what was added to the model.

    Parameters
    ----------
    added : steps of the model choice that are in the model
    start, found : parameters as they were stated and as they were estimated
    board_told : whether the recording is long enough to tell whether corners of the board lie off their places
    arms_told : whether it proves that the accelerometers do not sit at one point
    """
    findings: list[Finding] = []
    if arms_told:
        findings += [_lever_arms(f"imu{i}", imu) for i, imu in enumerate(found.imus)]
    if "intrinsics" in added:
        findings += [_lens(*pair, board_told) for pair in zip(start.cameras, found.cameras, strict=True)]
    if "exposure" in added:
        findings += [
            make_finding("exposure-found", name=entry.name, mean_s=max(entry.exposure_s2, 0.0) ** 0.5)
            for entry in found.cameras
        ]
    if "board" in added and found.board is not None:
        findings.append(_board(found.board.points, found.board.offsets))
    return findings


def delays_found(
    noticed: Sequence[Finding], imus: "Sequence[ImuParameters]", sigmas_s: Mapping[int, float], *, decided: bool
) -> list[Finding]:
    """Return what was noticed before the estimation, with the delays of accelerometers as the estimation tells them.

    Parameters
    ----------
    noticed : before the estimation
    imus : as they were estimated
    sigmas_s : of the delays that were estimated, by the number of the IMU [s]
    decided : whether the estimation decided by evidence on those that it does not have
    """
    if not sigmas_s and not decided:
        return list(noticed)
    told = [finding for finding in noticed if finding.code != _DELAYED]
    seen = len(told) < len(noticed)
    return told + [
        _delay(f"imu{i}", imus[i].accelerometer_shift_s, sigma_s)
        for i, sigma_s in sigmas_s.items()
        if (seen or not imus[i].apart) and abs(imus[i].accelerometer_shift_s) > _CERTAIN * sigma_s
    ]


def _delay(name: str, shift_s: float, sigma_s: float) -> Finding:
    later, earlier = ("accelerometer", "gyroscope") if shift_s < 0 else ("gyroscope", "accelerometer")
    return make_finding(
        "triads-apart/estimated", name=name, shift_s=abs(shift_s), sigma_s=sigma_s, later=later, earlier=earlier
    )


def misfits_found(misfits: "Sequence[TriadMisfit]") -> list[Finding]:
    """Say which triads show fast motion too small, or have another scale for negative readings.

    It is a warning where that is certain and moves a parameter by more than its standard deviation.
    """
    findings: list[Finding] = []
    for one in misfits:
        name, triad = f"imu{one.imu}", ("gyroscope", "accelerometer")[one.kind]
        severity = "warning" if one.moved > 1 and abs(one.size) > _FILTERED * one.sigma else "info"
        if one.axis is None:
            found = make_finding(
                "triad-filtered",
                severity=severity,
                name=name,
                triad=triad,
                share=one.size * _FAST_RAD_S**2,
                sigma=one.sigma * _FAST_RAD_S**2,
                cutoff_hz=1 / (2 * pi * sqrt(2 * one.size)),
                moved=one.moved,
            )
        else:
            found = make_finding(
                "scale-asymmetry",
                severity=severity,
                name=name,
                triad=triad,
                axis="xyz"[one.axis],
                way="smaller" if one.size > 0 else "larger",
                share=2 * abs(one.size),
                sigma=2 * one.sigma,
                moved=one.moved,
            )
        findings.append(found)
    return findings


def steps_left_out(failed: Mapping[str, str]) -> list[Finding]:
    """Say which steps the recording asks for, but could not be estimated: step -> reason."""
    return [make_finding("step-left-out", name=name, reason=reason) for name, reason in failed.items()]


def comparison_left_out(what: str, reason: str) -> Finding:
    """Say that something could not be estimated that would only have been compared with the result."""
    return make_finding("comparison-left-out", what=what, reason=reason)


def out_of_order(columns: "BorderLayout", found: "RigParameters") -> list[Finding]:
    """Say where g-sensitivity is estimated and what matters more, scale and misalignment, is taken for ideal."""
    findings: list[Finding] = []
    for i, imu in enumerate(found.imus):
        late, early = columns.get(f"imu{i}.B_g"), columns.get(f"imu{i}.S_g")
        if late is None or early is None or not columns.free[late].any() or columns.free[early].any():
            continue
        if np.any(imu.S_g != 1):
            continue  # somebody knows it
        findings.append(make_finding("model-too-simple/scale-fixed", i=i))
    return findings


def _lever_arms(name: str, imu: "ImuParameters") -> Finding:
    apart = ", ".join(
        f"{axis} at {' '.join(f'{1e3 * value:.1f}' for value in place)} mm"
        for axis, place in zip("xyz", imu.places.tolist(), strict=True)
    )
    return make_finding("lever-arms-found", name=name, apart=apart, words=imu.origin.words)


def _at_border_px(stated: "Camera", found: "Camera") -> float:
    """Return the largest distance of both images of one ray, at the corners and the middle of the edges [px]."""
    pixels = np.stack(np.meshgrid(*np.linspace(0, np.array(found.resolution) - 1.0, 3).T), axis=-1).reshape(-1, 2)
    rays, seen = found.unproject(pixels)
    image = stated.project(rays[seen], point_jacobian=False)
    return float(np.max(np.linalg.norm(image.pixels - pixels[seen], axis=1)[image.valid], initial=0.0))


def _lens(stated: "CameraParameters", found: "CameraParameters", board_told: bool) -> Finding:
    before, after = stated.camera.intrinsics[-4:], found.camera.intrinsics[-4:]
    focal = float(np.mean(after[:2] / before[:2]) - 1)
    moved = float(np.linalg.norm(after[2:] - before[2:]))
    doubtful = abs(focal) > _FOCAL_WARN or moved > _PRINCIPAL_WARN_PX
    k3 = found.camera.distortion_coeffs[4] if found.camera.distortion == "radtan5" else 0.0
    bent = f", up to {_at_border_px(stated.camera, found.camera):.3g} px at the border of the image"
    bent += f"; k3 is {k3:.3g}" if k3 else ""
    consequence = "The lens was estimated jointly: the corners fit clearly better with it than with the stated one."
    cure = "Use the lens of this result, or calibrate the camera anew."
    if doubtful:
        cure = "Check that camchain.yaml is of this camera, lens and resolution."
    elif not board_told:
        consequence = "A board that is not flat looks the same in so short a recording: either may be wrong."
        cure = "See that the board is flat, or record for 20 s: that tells the two apart."
    return make_finding(
        "lens-found",
        severity="warning" if doubtful or not board_told else "info",
        name=found.name,
        focal=focal,
        moved=moved,
        bent=bent,
        consequence=consequence,
        cure=cure,
    )


def _board(points: Floats, offsets: Floats) -> Finding:
    """Say where the corners lie; of a board with another aspect the size is known no better than half of that."""
    rms, most = (1e3 * f(np.linalg.norm(offsets, axis=1)) for f in (_rms, np.max))
    centred = points - points.mean(axis=0)
    x, y, _ = np.sum(centred * offsets, axis=0) / np.maximum(np.sum(centred**2, axis=0), 1e-300)
    stretched = grade_by_limits("scale", abs(y - x) / 2) != "good"
    return make_finding(
        "board-found/rig",
        severity="warning" if stretched else "info",
        case="stretched" if stretched else "",
        rms=rms,
        most=most,
        also=f"; its y axis is {100 * (y - x):+.2g} % longer against x than stated" if stretched else "",
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


_TELLS = 0.1  # information of the recording against that of the prior, from which on it can contradict it
_SURE = 3.7  # sigmas of a normal variable: one healthy recording of ten thousand


def prior_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether the recording contradicts it.

    Parameters
    ----------
    values : (n,) estimate from the recording alone, of the first n of the 45 scalars in the order of `evidence.NAMES`
    covariance : (n, n)
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        chi2, degrees, worst = _disagreement(part, values, covariance)
        if chi2 > _limit(degrees):
            findings.append(make_finding("prior-disagrees/imu", chi2=chi2, degrees=degrees, worst_name=NAMES[worst]))
    return findings


def cameras_disagree(
    names: tuple[str, ...], difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats
) -> list[Finding]:
    """Return whether a recording contradicts what was known of its cameras, which the estimate rests on, too.

    Parameters
    ----------
    names : (n,) scalars
    difference : (n,) estimate minus prior
    prior : (n, n) covariance of the prior
    ordinary, covariance : (n, n) of the estimate, for independent errors and as it is published
    """
    chi2, degrees = _pulled(difference, prior, ordinary, covariance)
    if not degrees or chi2 <= _limit(degrees):
        return []
    worst = int(np.argmax(np.abs(difference) / np.sqrt(np.diag(prior))))
    return [make_finding("prior-disagrees/cameras", chi2=chi2, degrees=degrees, worst_name=names[worst])]


def pulled_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether an estimate that rests on it, too, contradicts it.

    For recordings that determine too little on their own.

    Parameters
    ----------
    values, covariance : as for `prior_findings`, of the estimate from both
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        shown = part.index < len(values)
        index = part.index[shown]
        estimated = covariance[np.ix_(index, index)]
        difference = values[index] - part.mean[shown]
        prior = np.asarray(np.linalg.inv(part.precision)[np.ix_(shown, shown)], dtype=np.float64)
        chi2, degrees = _pulled(difference, prior, estimated, estimated)
        if degrees and chi2 > _limit(degrees):
            worst = NAMES[int(index[np.argmax(np.abs(difference) / np.sqrt(np.diag(prior)))])]
            findings.append(make_finding("prior-disagrees/rig", chi2=chi2, degrees=degrees, worst=worst))
    return findings


def _pulled(difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats) -> tuple[float, int]:
    """Return chi squared of recording minus prior, from an estimate that both made, and its degrees of freedom.

    In coordinates in which the prior's covariance is I and the recording's information diagonal, lambda, the estimate
    differs from the prior by w, and the recording alone would by w (1 + 1 / lambda), with the variance 1 + f / lambda
    where f is by how much its errors are larger than independent ones.
    """
    left = np.linalg.inv(np.linalg.cholesky(prior))
    kept, axes = np.linalg.eigh(left @ ordinary @ left.T)  # 1 / (1 + lambda)
    told = kept < 1 / (1 + _TELLS)
    if not told.any():
        return 0.0, 0
    information = 1 / np.maximum(kept[told], 1e-12) - 1
    white = axes[:, told].T @ left
    wider = np.maximum(np.einsum("ij,jk,ik->i", white, covariance, white) / kept[told], 1.0)
    by_recording = (white @ difference) ** 2 * (1 + 1 / information) ** 2
    return float(np.sum(by_recording / (1 + wider / information))), int(told.sum())


def prior_used(known: Prior) -> list[Finding]:
    """Return what was taken from elsewhere; nothing where nothing was."""
    if not known:
        return []
    paths = {NAMES[i].partition("[")[0].removeprefix("imu0.") for part in known.known for i in part.index}
    held = {NAMES[i].partition("[")[0].removeprefix("imu0.") for i in np.flatnonzero(known.fixed)}
    parts = [f"known beforehand: {', '.join(sorted(paths))}"] if paths else []
    parts += [f"held: {', '.join(sorted(held))}"] if held else []
    return [make_finding("prior-used", parts="; ".join(parts))]


def _disagreement(part: KnownScalars, values: Floats, covariance: Floats) -> tuple[float, int, int]:
    """Return chi squared of recording minus prior, its degrees of freedom, and the place of the worst scalar."""
    shown = part.index < len(values)
    index = part.index[shown]
    difference = values[index] - part.mean[shown]
    joint = covariance[np.ix_(index, index)] + np.linalg.inv(part.precision)[np.ix_(shown, shown)]
    sigma = np.sqrt(np.diag(joint))
    z = difference / sigma
    chi2 = z @ np.linalg.solve(joint / np.outer(sigma, sigma), z)
    return float(chi2), len(z), int(index[np.argmax(np.abs(z))])


def _limit(degrees: int) -> float:
    """Return the quantile of chi squared, by Wilson and Hilferty's approximation."""
    return degrees * (1 - 2 / (9 * degrees) + _SURE * np.sqrt(2 / (9 * degrees))) ** 3


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


PLACES_AND_CLOCKS = (".T_cam_imu.", ".time_shift_cam_imu", ".T_imu_body.", ".time_shift")
"""Parts of the names of scalars, as published and as estimated, that tell where and when a sensor is."""

_USUAL_FOCAL_ERROR = 3e-3
"""Focal lengths of usual camera calibrations are off by so much: 0.5 to 0.8 % were found in those of EuRoC."""

_MATTERS = 2.0
_MAINLY = 0.3
"""Share from which on a direction is mainly one of a parameter."""


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


def imu_weak(estimate: ImuEstimate) -> tuple[WeakDirection, ...]:
    """Return the weak directions of an IMU that was turned and held still, by the covariance for independent errors."""
    imu = ImuCalibration(
        accelerometer=AccelerometerCalibration(
            sensitivity=estimate.accelerometer_sensitivity, bias=estimate.accelerometer_bias, unit=""
        ),
        gyroscope=GyroscopeCalibration(
            sensitivity=estimate.gyroscope_sensitivity,
            bias=estimate.gyroscope_bias,
            g_sensitivity=estimate.g_sensitivity,
            unit="",
        ),
    )
    return weak_directions(known_of({"imu0": imu}, {}, estimate.covariance))


def weak_findings(weak: Sequence[WeakDirection], *, with_camera: bool) -> list[Finding]:
    """Return a finding for each weak direction, the weakest first.

    Without the place and the clock of its sensors a camera-IMU calibration is of no use, nor is that of an IMU alone
    without any of its triads.
    """
    findings: list[Finding] = []
    for one in weak:
        if not one.held:
            findings.append(make_finding("hardly-observable", words=one.words, cure=one.cure))
            continue
        vital = any(
            abs(share) > _MAINLY and any(part in name for part in PLACES_AND_CLOCKS) for name, share in one.shares
        )
        findings.append(
            make_finding(
                "not-observable/direction",
                severity="problem" if vital or not with_camera else "warning",
                words=one.words,
                cure=one.cure,
            )
        )
    return findings
