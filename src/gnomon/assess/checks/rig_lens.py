"""What the corners say of lens, shutter and board when every frame may have any pose of its own.

The residuals of single frames' poses are explained by what would make such a pattern, all at once and to first order:
the focal lengths and the principal point, a radial distortion beyond the stated one, the time from row to row of a
rolling shutter, the gaps between the tags of an AprilGrid. What a pose can do is taken out of both sides first.

Before that a lens that is stated for images of another size is told: scaled to theirs it fits far better.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...estimate.camera_imu.start.board_poses import BoardPoses, board_poses, thin_exposures
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...geometry.rotations import skew
from ...models.camera import Camera
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers
from ...results.result import Booleans

_FEWEST_FRAMES, _ENOUGH_FRAMES = 30, 250
_LONGEST_S = 0.35
_ROUNDS, _ROBUST = 3, 4.0
_BLOCK_S = 0.5
_SIGMAS = 6.0
_ROLLING_S = 1e-3  # from the first row to the last: lenses that are not quite their model ask for half of it
_BORDER_PX = 1.5
_GAINED = 0.95  # rms with a better lens over rms without
_SPACING, _BLED = 0.004, 0.03
_PRIOR = np.array([0.1, 0.1, 30.0, 30.0, 0.3, 0.3, 1e-4, 0.2])
"""What is possible at all, so that what the motion does not tell stays where it is."""

_SIZES = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 5, 5 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)
"""Of the images over those for which a lens may be stated."""
_SIZE_FRAMES, _FEWEST_OTHERS, _OTHERS = 40, 5, 0.1
_BAD_PX, _FAR_BETTER = 0.7, 0.5
_FOCAL, _RADIAL, _DELAY, _GAP = slice(0, 2), slice(4, 6), 6, 7  # of the causes; 2 and 3: the principal point


@value_class
class LensFit:
    """What the corners of one camera ask for, beside what was stated.

    Attributes
    ----------
    focal : (2,) relative change of the focal lengths
    border_px, border_sigma_px : by which corners at the border of what was seen of the image lie further out than the
        lens says [px]
    line_delay_s, line_delay_sigma_s : time from row to row, beside the stated one [s]
    tag_spacing, tag_spacing_sigma : gap between tags over their side; the sigma is nan for other boards
    rms_px, rms_free_px : of the residuals per axis, with what was stated and with all this
    """

    focal: Floats
    border_px: float
    border_sigma_px: float
    line_delay_s: float
    line_delay_sigma_s: float
    tag_spacing: float
    tag_spacing_sigma: float
    rms_px: float
    rms_free_px: float


def check_image_size(name: str, frames: CameraFrames, usable: Integers, target: Target) -> Finding | None:
    """Return a problem where corners are of images of another size than the lens, in all or in some (code image-size).

    Parameters
    ----------
    name : of the camera
    frames, usable : what it saw, and which of them can be used
    target : the board; landmarks were mapped with the stated lens, and tell nothing
    """
    if target.kind == "landmarks":
        return None
    chosen = np.isin(frames.frame, usable[:: max(len(usable) // _SIZE_FRAMES, 1)])
    sigma_px = None if frames.sigma_px is None else frames.sigma_px[chosen]
    few = replace(
        frames, frame=frames.frame[chosen], point=frames.point[chosen], pixels=frames.pixels[chosen], sigma_px=sigma_px
    )
    number, stated_px = _fits_px(few, target, 1.0)
    bad = stated_px > _BAD_PX
    if bad.sum() < _FEWEST_OTHERS:
        return None
    fits = {size: _fits_px(few, target, size)[1] for size in _SIZES}
    size = min(fits, key=lambda size: float(np.minimum(fits[size], stated_px).sum()))
    other = bad & (fits[size] < _FAR_BETTER * stated_px)
    width, height = frames.camera.resolution
    if other.mean() > 1 - _OTHERS:
        return make_finding(
            "image-size/corners",
            name=name,
            stated_px=np.median(stated_px),
            fit_px=np.median(fits[size]),
            width=round(size * width),
            height=round(size * height),
            stated_width=width,
            stated_height=height,
        )
    if other.sum() < _FEWEST_OTHERS or other.mean() < _OTHERS or (~bad).sum() < _FEWEST_OTHERS:
        return None
    if np.median(fits[size][other]) > 2 * np.median(stated_px[~bad]):
        return None
    first_s = float(frames.t_ns[number[other][0]] - frames.t_ns[0]) * 1e-9
    return make_finding(
        "image-size/some",
        name=name,
        share=other.mean(),
        first_s=first_s,
        width=round(size * width),
        height=round(size * height),
        stated_width=width,
        stated_height=height,
    )


def _fits_px(frames: CameraFrames, target: Target, size: float) -> tuple[Integers, Floats]:
    """Return frames (n,), and how well each fits with the lens scaled to images of another size (n,) [px]."""
    intrinsics = frames.camera.intrinsics.copy()
    intrinsics[-4:-2] *= size
    intrinsics[-2:] = (intrinsics[-2:] + 0.5) * size - 0.5  # a pixel's centre is a whole number
    scaled = replace(frames, camera=replace(frames.camera, intrinsics=intrinsics))
    poses = board_poses(scaled, target, np.zeros(len(frames.t_ns)))
    return poses.exposures.frame, poses.scatter_px


def check_lens(
    name: str, poses: BoardPoses, camera: Camera, target: Target, certain: Booleans | None = None
) -> list[Finding]:
    """Return findings on the lens and the board of one camera, by its corners alone.

    Landmarks, which were mapped with the stated lens, tell of the shutter alone.

    Codes: tag-spacing, rolling-shutter, distortion.
    """
    fit = lens_fit(poses, camera, target, certain)
    if fit is not None and target.kind == "landmarks":
        return _shutter(name, fit, camera)
    return [] if fit is None else [*_tag_spacing(name, fit, target), *_shutter(name, fit, camera), *_lens(name, fit)]


def _tag_spacing(name: str, fit: LensFit, target: Target) -> list[Finding]:
    off = fit.tag_spacing - target.tag_spacing if target.kind == "aprilgrid" else 0.0
    if not abs(off) > max(_SPACING, _SIGMAS * fit.tag_spacing_sigma):
        return []
    message = (
        f"The gaps between the tags are {fit.tag_spacing:.3f} of a tag's side by the corners of {name}; "
        f"target.yaml states tagSpacing {target.tag_spacing:.3g}."
    )
    if abs(off) < _BLED + _SIGMAS * fit.tag_spacing_sigma:  # in EuRoC's last seconds 0.5 px of white bleed into black
        return [make_finding("tag-spacing/good", message=message)]
    return [make_finding("tag-spacing/wrong", message=message, percent=100 * abs(off) / (1 + target.tag_spacing))]


def _shutter(name: str, fit: LensFit, camera: Camera) -> list[Finding]:
    rows = camera.resolution[1]
    if not abs(fit.line_delay_s) > max(_ROLLING_S / rows, _SIGMAS * fit.line_delay_sigma_s):
        return []
    found = camera.line_delay_s + fit.line_delay_s
    readout = f"({1e3 * found * rows:.2g} ms from the first to the last)"
    stated = f"{1e6 * camera.line_delay_s:.3g} us a row were stated" if camera.line_delay_s else "none was stated"
    if abs(found) * rows > _ROLLING_S:
        message = f"{name} has a rolling shutter: its rows are exposed {1e6 * found:.3g} us after each other {readout}"
        consequence = (
            "Corners of one frame are of different instants; in a turn they are off by pixels, and the time shift by "
            "half of the time from the first row to the last."
        )
        cure = f"State it, --line-delay {found:.3g}, and let it be estimated: --free {name}.line_delay."
    else:
        message = f"{name} has a global shutter, as its corners show no line delay {readout}"
        consequence = "In a turn corners are off by pixels, and the time shift by half of what was stated for all rows."
        cure = f"State no line delay, or let it be estimated: --free {name}.line_delay."
    return [
        make_finding("rolling-shutter", message=message, stated=stated, consequence=consequence, cure=cure, name=name)
    ]


def _lens(name: str, fit: LensFit) -> Iterator[Finding]:
    if not (
        abs(fit.border_px) > max(_BORDER_PX, _SIGMAS * fit.border_sigma_px) and fit.rms_free_px < _GAINED * fit.rms_px
    ):
        return
    way = "inwards" if fit.border_px < 0 else "outwards"
    yield make_finding(
        "distortion",
        severity="problem" if abs(fit.border_px) > 10 * _BORDER_PX else "warning",
        name=name,
        border_px=abs(fit.border_px),
        way=way,
        rms_free_px=fit.rms_free_px,
        rms_px=fit.rms_px,
    )


def lens_fit(poses: BoardPoses, camera: Camera, target: Target, certain: Booleans | None = None) -> LensFit | None:
    """Return what the corners ask for; None where too few frames follow each other closely.

    Parameters
    ----------
    poses : of the board
    camera, target : as stated
    certain : (n,) poses to be used; all where not given
    """
    exposures = thin_exposures(replace(poses.exposures, spread=None))
    count = len(poses)
    steps = np.diff(poses.t_s)
    middle = np.zeros(count, dtype=bool)
    if count > 2:
        middle[1:-1] = (steps[:-1] < _LONGEST_S) & (steps[1:] < _LONGEST_S)
    if certain is not None:
        middle &= certain
    if middle.sum() < _FEWEST_FRAMES:
        return None
    kept = np.flatnonzero(middle)
    middle[:] = False
    middle[kept[:: max(1, len(kept) // _ENOUGH_FRAMES)]] = True
    of_frame = np.repeat(np.arange(count), np.diff(exposures.start))
    chosen = middle[of_frame]
    frame, points, pixels = of_frame[chosen], exposures.points[chosen], exposures.pixels[chosen]
    residual, by_pose, by_cause, seen = _linearised(poses, camera, target, _Corners(frame, points, pixels))
    weight = seen.astype(np.float64)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(frame) > 0]))
    sides = np.concatenate([by_cause, residual[:, :, None]], axis=2)
    solution, covariance, causes, free, left = np.zeros(8), np.zeros((8, 8)), by_cause, residual, residual
    for _ in range(_ROUNDS):
        both = _without_poses(sides, by_pose, weight, starts, frame)
        causes, left = both[:, :, :8], both[:, :, 8]
        solution, covariance = _solved(causes, left, weight)
        free = left - causes @ solution
        size = np.linalg.norm(free, axis=1)
        usual = float(np.median(size[weight > 0])) / np.sqrt(2 * np.log(2))
        weight = (seen & (size < _ROBUST * usual * np.sqrt(2))).astype(np.float64)
    used = weight > 0
    sigma = np.sqrt(np.diag(covariance) * (free[used] ** 2).mean())
    sigma = np.maximum(sigma, _jackknife(causes * np.sqrt(weight)[:, None, None], free, covariance, poses.t_s[frame]))
    border = _border(pixels[used], camera)
    grid = target.kind == "aprilgrid"
    return LensFit(
        focal=solution[_FOCAL],
        border_px=float(border @ solution[_RADIAL]),
        border_sigma_px=float(np.sqrt(border @ covariance[_RADIAL, _RADIAL] @ border * (free[used] ** 2).mean())),
        line_delay_s=float(solution[_DELAY]),
        line_delay_sigma_s=float(sigma[_DELAY]),
        tag_spacing=(target.tag_spacing + float(solution[_GAP])) if grid else float("nan"),
        tag_spacing_sigma=float(sigma[_GAP]) if grid else float("nan"),
        rms_px=float(np.sqrt((left[used] ** 2).mean())),
        rms_free_px=float(np.sqrt((free[used] ** 2).mean())),
    )


class _Corners(NamedTuple):
    """Corners: index of their frames (m,), points of the board (m, 3), pixels (m, 2)."""

    frame: np.ndarray
    points: Floats
    pixels: Floats


def _linearised(
    poses: BoardPoses, camera: Camera, target: Target, corners: _Corners
) -> tuple[Floats, Floats, Floats, Booleans]:
    """Return residuals (m, 2), their derivatives by pose (m, 2, 6) and causes (m, 2, 8), and which mean anything."""
    frame, points, pixels = corners
    R, p = poses.R_cam_target, poses.p_cam_target

    def placed(k: np.ndarray) -> Floats:
        return np.einsum("nij,nj->ni", R[k], points) + p[k]

    turned = np.einsum("nij,nj->ni", R[frame], points)
    here = camera.project(turned + p[frame])
    before, after = (camera.project(placed(frame + step), point_jacobian=False) for step in (-1, 1))
    velocity = (after.pixels - before.pixels) / (poses.t_s[frame + 1] - poses.t_s[frame - 1])[:, None]
    assert here.by_point is not None
    by_pose = np.concatenate([-here.by_point @ skew(turned), here.by_point], axis=2)
    # Where corners should be, not where they were found: their noise would explain itself.
    off = np.nan_to_num(here.pixels) - camera.intrinsics[-2:]
    scaled = (off**2).sum(axis=1, keepdims=True) / _radius2(camera)
    by_cause = np.zeros((len(points), 2, 8))
    by_cause[:, 0, 0], by_cause[:, 1, 1] = off[:, 0], off[:, 1]
    by_cause[:, 0, 2] = by_cause[:, 1, 3] = 1.0
    by_cause[:, :, 4], by_cause[:, :, 5] = off * scaled, off * scaled**2
    by_cause[:, :, 6] = velocity * np.nan_to_num(here.pixels[:, 1:])
    if target.kind == "aprilgrid":
        wider = np.floor_divide(points, target.tag_size_m * (1 + target.tag_spacing) * (1 - 1e-9)) * target.tag_size_m
        wider[:, 2] = 0.0
        by_cause[:, :, 7] = np.einsum("nij,njk,nk->ni", here.by_point, R[frame], wider)
    finite = np.logical_and.reduce(np.isfinite(np.column_stack([here.pixels, velocity])), axis=1)
    stated = here.pixels + camera.line_delay_s * by_cause[:, :, _DELAY]
    residual = np.where(finite[:, None], pixels - stated, 0.0)
    return (
        residual,
        np.where(finite[:, None, None], by_pose, 0.0),
        np.where(finite[:, None, None], by_cause, 0.0),
        finite,
    )


def _radius2(camera: Camera) -> float:
    return float((np.array(camera.resolution) ** 2).sum()) / 4


def _without_poses(sides: Floats, by_pose: Floats, weight: Floats, starts: np.ndarray, frame: np.ndarray) -> Floats:
    """Return columns (m, 2, k) less what the poses of their frames can do."""
    weighted = by_pose * weight[:, None, None]
    gram = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ by_pose, starts)
    right = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ sides, starts)
    eased = gram + 1e-9 * np.einsum("nii->n", gram)[:, None, None] * np.eye(6) + 1e-12 * np.eye(6)
    pose = np.linalg.solve(eased, right)
    return sides - by_pose @ np.repeat(pose, np.diff(np.append(starts, len(frame))), axis=0)


def _solved(causes: Floats, left: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the causes' sizes, and their covariance for a residual of one px."""
    columns, right = causes.reshape(-1, 8), left.reshape(-1)
    both = np.repeat(weight, 2)
    gram = columns.T @ (both[:, None] * columns) + np.diag(1 / _PRIOR**2)  # of residuals of a px, which is lenient
    scale = 1 / np.sqrt(np.diag(gram))
    inverse = np.linalg.inv(gram * np.outer(scale, scale)) * np.outer(scale, scale)
    return inverse @ (columns.T @ (both * right)), inverse


def _jackknife(causes: Floats, left: Floats, covariance: Floats, t_s: Floats) -> Floats:
    """Return the causes' sigmas by how much each half second moves them: errors of a lens last as long as the view.

    Of few half seconds they are larger, so that `_SIGMAS` of them are as rare as of a normal distribution (Student's t
    by Abramowitz and Stegun, 26.7.5).
    """
    starts = np.flatnonzero(np.diff(np.floor((t_s - t_s[0]) / _BLOCK_S), prepend=-1.0))
    scale = np.sqrt(np.diag(covariance))
    columns = causes * scale
    score = np.add.reduceat(np.einsum("nik,ni->nk", columns, left), starts)
    gram = np.add.reduceat(np.einsum("nik,nil->nkl", columns, columns), starts)
    others = np.linalg.inv(covariance / np.outer(scale, scale)) - gram
    moves = np.linalg.solve(others, score[:, :, None])[:, :, 0]
    rare = 1 + (_SIGMAS**2 + 1) / (4 * max(len(starts) - 1, 1))
    return rare * scale * np.sqrt((1 - 1 / len(starts)) * (moves**2).sum(axis=0))


def _border(pixels: Floats, camera: Camera) -> Floats:
    """Return how far both radial terms (2,) move what was seen furthest out, a straight stretch taken out [px]."""
    off = np.linalg.norm(pixels - camera.intrinsics[-2:], axis=1)
    r = np.linspace(0, float(np.quantile(off, 0.99)), 40)
    scaled = r**2 / _radius2(camera)
    bent = np.stack([r * scaled, r * scaled**2])
    inner = r < 0.6 * r[-1]
    straight = bent[:, inner] @ r[inner] / (r[inner] @ r[inner])
    return bent[:, -1] - straight * r[-1]
