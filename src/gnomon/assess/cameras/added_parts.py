"""What the model of a rig took up because the recording proved it to be there: its size, and what to do about it."""

from collections.abc import Mapping, Sequence
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ...findings import Finding, make_finding
from ...recording import Floats
from ..verdict import grade_by_limits

if TYPE_CHECKING:
    from ...estimate.camera_imu.layout import BorderLayout
    from ...estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
    from ...estimate.camera_imu.result.uncertainty import TriadMisfit
    from ...models.camera import Camera


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
