"""Findings on what a recording hardly determines."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..estimate.multiposition.scaling import ImuEstimate
from ..findings import Finding, make_finding
from ..options.requirements import GENERAL_RIG
from ..recording import Floats
from ..results.calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..results.camera_diagnostics import EstimatedParameter
from ..results.trust import WeakDirection
from .directions import axis_words
from .observability import known_of, weak_directions

if TYPE_CHECKING:  # an IMU alone needs no SciPy
    from ..estimate.camera_imu.result.publish import PublishedRig
    from ..estimate.camera_imu.result.uncertainty import Uncertainty

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
