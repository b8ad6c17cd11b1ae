"""How two cameras of a rig fit together: the distance of corners that both see from their epipolar lines."""

from dataclasses import dataclass

import numpy as np

from ..calibration import Calibration
from ..diagnostics import CornerFit
from ..geometry.so3 import skew
from ..models.camera import Camera
from ..recording import Floats, Integers
from .numbers import finite

_SAME_S = 1e-3
"""Frames of two cameras whose stamps differ by less show the same instant."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EpipolarErrors:
    """Corners that two cameras saw at one instant.

    Attributes
    ----------
    error : (m,) signed distance of the corner in the second image from the epipolar line of that in the first [px]
    used : (m,) whether both frames were used by the estimate
    """

    error: Floats
    used: np.ndarray

    @property
    def typical_used(self) -> float:
        """Robust standard deviation about zero over the views used [px]."""
        return _typical(self.error[self.used])

    @property
    def typical_other(self) -> float:
        """The same over the other views [px]; nan without any."""
        return _typical(self.error[~self.used])


def _typical(errors: Floats) -> float:
    """Return 1.4826 times the median distance from zero, the rms of normal errors whatever a few others are."""
    known = finite(errors)
    return 1.4826 * float(np.median(np.abs(known))) if known.size else float("nan")


def epipolar_errors(calibration: Calibration, corners: dict[str, CornerFit], first: str, second: str) -> EpipolarErrors:
    """Return the errors of all corners that both cameras saw at one instant; no pose and no board take part in them.

    With rays a and b of the first and the second camera, c = b' [t]x R a vanishes; c over its derivative by the place
    of the corner in the second image, along the steepest direction, is the distance from the line there.
    """
    one, other = corners[first], corners[second]
    pairs = _common(one, other)
    cameras = calibration.cameras
    T = cameras[second].T_cam_body @ np.linalg.inv(cameras[first].T_cam_body)
    a, sees = cameras[first].camera.unproject(one.pixels[pairs[0]])
    lens = cameras[second].camera
    b, too = lens.unproject(other.pixels[pairs[1]])
    kept = sees & too
    a, b, pairs = a[kept], b[kept], (pairs[0][kept], pairs[1][kept])
    normal = a @ (skew(T[:3, 3]) @ T[:3, :3]).T
    used = np.asarray(one.frame_used, dtype=bool)[one.frame[pairs[0]]]
    used &= np.asarray(other.frame_used, dtype=bool)[other.frame[pairs[1]]]
    return EpipolarErrors(error=_distance(lens, b, normal), used=used)


def _distance(lens: Camera, rays: Floats, normal: Floats) -> Floats:
    """Return rays . normal over its derivative by the pixels of the rays (m,) [px]."""
    by_ray = lens.project(rays).by_point
    assert by_ray is not None
    slope = np.linalg.norm(np.einsum("mi,mij->mj", normal, np.linalg.pinv(by_ray)), axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(slope > 0, np.sum(rays * normal, axis=1) / slope, np.nan)


def _common(one: CornerFit, other: CornerFit) -> tuple[Integers, Integers]:
    """Return the places in both lists of corners of what both saw at one instant, frames that fit badly apart."""
    if not len(other.frame_t_s) or not len(one.frame):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    order = np.argsort(other.frame_t_s, kind="stable")
    after = np.searchsorted(other.frame_t_s[order], one.frame_t_s).clip(1, max(len(order) - 1, 1))
    near = np.stack([order[after - 1], order[np.fmin(after, len(order) - 1)]])
    apart = np.abs(other.frame_t_s[near] - one.frame_t_s)
    match = np.where(apart.min(axis=0) < _SAME_S, near[apart.argmin(axis=0), np.arange(near.shape[1])], -1)
    points = 1 + max(int(one.point.max(initial=0)), int(other.point.max(initial=0)))
    frame = match[one.frame]
    there = (frame >= 0) & np.isfinite(one.residual).all(axis=1)
    wanted = np.where(there, frame * points + one.point, -1)
    found = np.where(np.isfinite(other.residual).all(axis=1), other.frame * points + other.point, -2)
    _, first, second = np.intersect1d(wanted, found, return_indices=True)
    return first, second
