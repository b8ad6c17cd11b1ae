"""Checkerboards numbered alike in all frames of a camera.

A board that looks the same after half a turn (or a quarter, if it is square) may be numbered from either end in every
image. Where the colours of its squares tell the ends apart the detector has used them, and nothing is left to do.
Otherwise the picture's rotation tells: from one frame to the next a hand cannot turn the board by half a turn. With the
intrinsics the whole rotation is followed, and with the gyroscope it is foreseen across gaps; without them its part
about the board's normal is, which is the part that a wrong end changes.

Every view is compared with the last few before it. The numbering that fits best is taken, and its probability says how
far it is to be trusted: where it is low a new piece begins, and what lies on both sides must be joined otherwise.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...geometry.rotations import nearest_rotation
from ...models.camera import Camera
from ...models.target import Target
from ...recording import Floats, Integers, frozen_array
from .board import BoardView

Turned = Callable[[int, int], Floats | None]
"""From timestamps t0 < t1 [ns] to R (3, 3) of the camera, R_cam_target(t1) = R @ R_cam_target(t0); None where unknown.
"""

_CERTAIN = 0.999
_LOOKED_BACK = 3
_STRAY = 1e-5  # likelihood of a view that tells nothing, against a perfect one
_LEAST_SIGMA = np.radians(2.0)  # of a view's rotation
_FORESEEN, _FORESEEN_PER_S = np.radians(2.0), np.radians(1.0)  # error of the gyroscope's prediction
_FAST = 0.9  # quantile of the angular rate that stands for the motion between frames
_SLOWEST = 0.2  # rad/s
_FEWEST = 4


@value_class
class OrderedViews:
    """Views of a board, numbered alike.

    Attributes
    ----------
    views : (n,) as they were, with the corners numbered anew where that was needed
    turns : (n,) quarter turns by which the numbers of each view were turned
    piece : (n,) which views are numbered alike for certain: those of one piece, counted from 0; -1 without a board
    probability : (pieces,) that a piece is numbered like those before it; 1 for the first
    """

    views: tuple[BoardView, ...]
    turns: Integers
    piece: Integers
    probability: Floats

    def __post_init__(self) -> None:
        for name in ("turns", "piece"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), np.int64))
        object.__setattr__(self, "probability", frozen_array(self.probability))

    @property
    def certain(self) -> bool:
        """Whether all views are numbered alike for certain."""
        return len(self.probability) <= 1


def consistent_order(
    views: Sequence[BoardView],
    t_ns: Integers,
    target: Target,
    *,
    camera: Camera | None = None,
    turned: Turned | None = None,
) -> OrderedViews:
    """Return views of a checkerboard with their corners numbered alike in all of them.

    Parameters
    ----------
    views : of one camera, in the order of time; also those without a board
    t_ns : (n,) their timestamps, rising [ns]
    target : the board; on others than checkerboards nothing is ambiguous
    camera : lens and intrinsics, where they are known
    turned : rotation of the camera between two timestamps, as the gyroscope tells it; the board must be at rest

    Raises
    ------
    OptionError
        If `turned` is given without the camera.
    """
    if turned is not None and camera is None:
        raise OptionError("the gyroscope tells nothing of a board's order without the camera's intrinsics.")
    ways = ambiguous_turns(target)
    seen = [i for i, view in enumerate(views) if len(view) >= _FEWEST]
    turns, piece = np.zeros(len(views), np.int64), np.full(len(views), -1)
    probability = [1.0] if seen else []
    if len(ways) == 1 or not seen:
        piece[seen] = 0
    else:
        rotations = _rotations([views[i] for i in seen], target, camera)
        turns[seen], piece[seen], probability = _followed(rotations, np.asarray(t_ns, np.int64)[seen], ways, turned)
    turns = _lengthwise(views, target, turns, piece)
    return OrderedViews(
        views=tuple(renumber_view(view, target, int(turn)) for view, turn in zip(views, turns, strict=True)),
        turns=turns,
        piece=piece,
        probability=np.array(probability),
    )


def _followed(
    rotations: Floats, t_ns: Integers, ways: tuple[int, ...], turned: Turned | None
) -> tuple[Integers, Integers, list[float]]:
    """Return turns (n,), pieces (n,) and their probabilities for R_cam_target (n, 3, 3) at timestamps (n,)."""
    rate = _rate(rotations, (t_ns - t_ns[0]) * 1e-9, ways)
    R = rotations.copy()
    turns, piece = np.zeros(len(R), np.int64), np.zeros(len(R), np.int64)
    probability = [1.0]
    for k in range(1, len(R)):
        found: list[tuple[int, float, int]] = []
        for j in range(k - 1, max(k - 1 - _LOOKED_BACK, -1), -1):
            gap = float(t_ns[k] - t_ns[j]) * 1e-9
            foreseen = None if turned is None else turned(int(t_ns[j]), int(t_ns[k]))
            sigma = rate * gap if foreseen is None else _FORESEEN + _FORESEEN_PER_S * gap
            start = R[j] if foreseen is None else foreseen @ R[j]
            turn, likely = _most_likely(start, R[k], ways, float(np.hypot(sigma, _LEAST_SIGMA)))
            found.append((turn, likely, int(piece[j])))
            if likely > _CERTAIN:
                break
        turns[k], likely, piece[k] = max(found, key=lambda one: one[1])  # the nearest of equals
        if likely < _CERTAIN:
            piece[k] = len(probability)
            probability.append(likely)
        R[k] = R[k] @ about_normal(int(turns[k]))
    return turns, piece, probability


def ambiguous_turns(target: Target) -> tuple[int, ...]:
    """Return the quarter turns after which a board cannot be told from itself."""
    if target.kind == "circlegrid":
        if target.asymmetric:  # half a turn puts the shifted rows in the places of others if their number is odd
            return (0,) if target.rows % 2 else (0, 2)
        return (0, 2) if target.rows != target.cols else (0, 1, 2, 3)
    if target.kind != "checkerboard":
        return (0,)
    if target.rows != target.cols:
        return (0,) if (target.rows + target.cols) % 2 else (0, 2)
    return (0, 2) if target.rows % 2 else (0, 1, 2, 3)


def renumber_view(view: BoardView, target: Target, turns: int) -> BoardView:
    """Return the view with its numbers counted from another end of the board, `turns` quarter turns on.

    Afterwards the board's axes are turned by so many quarters about its normal: R_cam_target becomes
    R_cam_target @ Rz(turns 90 deg).
    """
    if turns % 4 == 0 or not len(view):
        return view
    numbers = np.arange(len(target)).reshape(target.rows, target.cols)
    new = np.empty(len(target), np.int64)
    new[np.rot90(numbers, -turns).ravel()] = numbers.ravel()
    point = new[view.point]
    order = np.argsort(point)
    return replace(view, point=point[order], pixels=view.pixels[order], sigma_px=view.sigma_px[order])


def about_normal(turns: int) -> Floats:
    """Return the rotation (3, 3) by so many quarters about a board's normal."""
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns % 4]
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], dtype=np.float64)


def _most_likely(start: Floats, R: Floats, ways: tuple[int, ...], sigma: float) -> tuple[int, float]:
    """Return by how many quarters a rotation must be turned to be near another one, and with what probability."""
    likelihood = [
        float(np.exp(-0.5 * (angle_between(start, R @ about_normal(way)) / sigma) ** 2)) + _STRAY for way in ways
    ]
    best = int(np.argmax(likelihood))
    return ways[best], likelihood[best] / sum(likelihood)


def angle_between(first: Floats, second: Floats) -> float:
    """Return the angle between two rotations [rad]."""
    return float(np.arccos(np.clip(0.5 * (np.sum(first * second) - 1), -1, 1)))


def _rate(R: Floats, t_s: Floats, ways: tuple[int, ...]) -> float:
    """Return a high value of the rate at which the rotation changes from frame to frame [rad/s]."""
    steps = np.diff(t_s)
    if not len(steps):
        return _SLOWEST
    near = np.flatnonzero((steps > 0) & (steps < 1.5 * np.median(steps)))
    rates = [min(angle_between(R[k], R[k + 1] @ about_normal(way)) for way in ways) / steps[k] for k in near]
    return max(float(np.quantile(rates, _FAST)), _SLOWEST) if rates else np.pi


def _rotations(views: Sequence[BoardView], target: Target, camera: Camera | None) -> Floats:
    """Return R_cam_target (n, 3, 3); without a camera as if the board were seen from the front."""
    ends = np.cumsum([len(view) for view in views])[:-1]
    points = target.points[np.concatenate([view.point for view in views]), :2]
    points = (points - target.points[:, :2].mean(axis=0)) / max(target.size_m)
    plane = np.split(np.column_stack([points, np.ones(len(points))]), ends)
    pixels = np.concatenate([view.pixels for view in views])
    if camera is None:
        return np.array([_turn_in_image(*pair) for pair in zip(plane, np.split(pixels, ends), strict=True)])
    rays, valid = camera.unproject(pixels)
    rays = np.where(valid[:, None], rays, 0.0)  # such rows say nothing
    return np.array([_rotation(*pair) for pair in zip(plane, np.split(rays, ends), strict=True)])


def _turn_in_image(plane: Floats, pixels: Floats) -> Floats:
    """Return how the board's picture is turned about the line of sight."""
    by_x, by_y = np.linalg.lstsq(plane, pixels, rcond=None)[0][:2]
    # v points down: with z toward the viewer, the board's x and y turn as u and -v do.
    angle = np.arctan2(-by_x[1] - by_y[0], by_x[0] - by_y[1])
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def _rotation(plane: Floats, rays: Floats) -> Floats:
    """Return R_cam_target by the homography from the board (n, 3) to rays (n, 3), ray x H p = 0."""
    zero = np.zeros_like(plane)
    a, b, c = (rays[:, i, None] * plane for i in range(3))
    rows = np.concatenate([np.hstack([zero, -c, b]), np.hstack([c, zero, -a]), np.hstack([-b, a, zero])])
    homography = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    homography *= np.copysign(1.0, np.sum(rays * (plane @ homography.T)))
    first, second, _ = (homography / np.linalg.norm(homography, axis=0)).T
    return nearest_rotation(np.column_stack([first, second, np.cross(first, second)]))


def _lengthwise(views: Sequence[BoardView], target: Target, turns: Integers, piece: Integers) -> Integers:
    """Return the turns, with a quarter more for pieces of a square board that is stretched along the other axis.

    Views from aside stretch it, too, but on the whole as often along one axis as along the other.
    """
    if target.kind != "checkerboard" or target.rows != target.cols or target.row_spacing_m == target.col_spacing_m:
        return turns
    stated = np.log(target.row_spacing_m / target.col_spacing_m)
    turns = turns.copy()
    for number in range(int(piece.max(initial=-1)) + 1):
        those = np.flatnonzero(piece == number)
        stretch = np.mean([_stretch(renumber_view(views[int(i)], target, int(turns[i])), target) for i in those])
        if stretch * stated < 0:
            turns[those] += 1
    return turns % 4


def _stretch(view: BoardView, target: Target) -> float:
    """Return the logarithm of the step from row to row over that from column to column, both in pixels."""
    rows, cols = np.divmod(view.point, target.cols)
    plane = np.column_stack([rows, cols, np.ones(len(rows))])
    by_row, by_col = np.linalg.lstsq(plane, view.pixels, rcond=None)[0][:2]
    return float(np.log(np.linalg.norm(by_row) / np.linalg.norm(by_col)))
