"""Whether cameras took the images of one timestamp at one instant: else the board moves on, and residuals show it."""

from collections.abc import Mapping

import numpy as np

from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import CameraFrames, Floats

_LONGEST_S = 0.5
"""Time between frames over which corners are taken to move evenly."""

_CERTAIN = 5.0
_MATTERS = 0.3
"""Motion between the exposures over the noise of corners, from which on it is said."""

_BENDS_PX = 1.0
"""Motion between the exposures from which on the result cannot be used."""

_FEWEST_VIEWS = 8


@value_class
class JointResiduals:
    """Corners of one camera in views of several, about the pose of each view that suits all cameras.

    Attributes
    ----------
    view, frame, point : (m,) view of each corner, its frame in the recording, its number on the board
    residual : (m, 2) predicted minus detected [px]; nan where the lens has no image of it
    """

    view: np.ndarray
    frame: np.ndarray
    point: np.ndarray
    residual: Floats


def check_synchronism(
    cameras: Mapping[str, CameraFrames], residuals: Mapping[str, JointResiduals], sigma_px: Mapping[str, float]
) -> list[Finding]:
    """Say that a camera exposes its images earlier or later than the first one those of the same timestamps.

    Where a corner moves by v [px/s] and the camera is late by d, detected = predicted + v d. The pose of the view gives
    way to both cameras: residuals, predicted minus detected, are a d v in the first and (a - 1) d v in the other. Their
    regressions on v differ by d, whatever a is; its sigma follows from the scatter between views.

    Parameters
    ----------
    cameras : "cam0", ... -> all frames
    residuals : the same
    sigma_px : noise of a corner of each camera [px]
    """
    first, *others = cameras
    found: list[Finding] = []
    for name in others:
        pair = {one: _by_view(cameras[one], residuals[one]) for one in (first, name)}
        views = np.flatnonzero((pair[first][1][: _most(pair)] > 0) & (pair[name][1][: _most(pair)] > 0))
        if len(views) < _FEWEST_VIEWS:
            continue
        delay, sigma, speed = _delay([tuple(part[views] for part in pair[one]) for one in (first, name)])
        moved = abs(delay) * speed
        if abs(delay) > _CERTAIN * sigma and moved > _MATTERS * max(sigma_px[first], sigma_px[name]):
            found.append(_finding(first, name, delay, moved))
    return found


def _most(pair: Mapping[str, tuple[Floats, Floats, Floats]]) -> int:
    return min(len(sums[0]) for sums in pair.values())


def _by_view(frames: CameraFrames, seen: JointResiduals) -> tuple[Floats, Floats, Floats]:
    """Return of each view the sums of v r [px^2/s] and of v v [px^2/s^2], and the number of corners."""
    velocity = _velocities(frames, seen)
    known = np.isfinite(velocity[:, 0]) & np.isfinite(seen.residual[:, 0])
    view, velocity, residual = seen.view[known], velocity[known], seen.residual[known]
    size = int(seen.view.max(initial=-1)) + 1
    along = np.bincount(view, np.sum(velocity * residual, axis=1), size)
    square = np.bincount(view, np.sum(velocity**2, axis=1), size)
    count = np.bincount(view, np.ones(len(view)), size).astype(np.float64)
    return along.astype(np.float64), square.astype(np.float64), count


def _velocities(frames: CameraFrames, seen: JointResiduals) -> Floats:
    """Return how fast each corner moves by the frames before and after it, (m, 2) [px/s]; nan where neither is near."""
    shown = np.unique(frames.frame)
    place = np.full(len(frames.t_ns), -1)
    place[shown] = np.arange(len(shown))
    points = int(frames.point.max(initial=0)) + 1
    table = np.full((len(shown), points, 2), np.nan)
    table[place[frames.frame], frames.point] = frames.pixels
    t_s = (frames.t_ns[shown] - frames.t_ns[0]) * 1e-9
    here = place[seen.frame]
    before, after = np.maximum(here - 1, 0), np.minimum(here + 1, len(shown) - 1)
    own = table[here, seen.point]
    steps = []
    for one in (before, after):
        apart_s = (t_s[one] - t_s[here])[:, None]
        near = (np.abs(apart_s) <= _LONGEST_S) & (apart_s != 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            steps.append(np.where(near, (table[one, seen.point] - own) / apart_s, np.nan))
    both = np.stack(steps)
    count = np.isfinite(both).sum(axis=0)
    return np.where(count > 0, np.nansum(both, axis=0) / np.maximum(count, 1), np.nan)


def _delay(sums: list[tuple[Floats, ...]]) -> tuple[float, float, float]:
    """Return by how much the second camera is late [s], its sigma, and how fast corners move (rms) [px/s]."""
    slopes, errors = [], []
    for along, square, _ in sums:
        slope = float(along.sum() / max(square.sum(), 1e-12))
        slopes.append(slope)
        errors.append((along - slope * square) / max(float(square.sum()), 1e-12))
    speed = float(np.sqrt(sum(square.sum() for _, square, _ in sums) / sum(count.sum() for *_, count in sums)))
    views = len(sums[0][0])
    sigma = float(np.sqrt(np.sum((errors[0] - errors[1]) ** 2) * views / (views - 1)))
    return slopes[0] - slopes[1], sigma, speed


def _finding(first: str, name: str, delay_s: float, moved_px: float) -> Finding:
    late = "later" if delay_s > 0 else "earlier"
    return make_finding(
        "cameras-unsynchronised",
        severity="problem" if moved_px > _BENDS_PX else "warning",
        name=name,
        delay_s=abs(delay_s),
        late=late,
        first=first,
        moved_px=moved_px,
    )
