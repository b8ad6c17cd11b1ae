"""A first trajectory: the attitudes of the camera, joined by the gyroscope, and its positions, as splines.

The stream is cut where the IMU has a gap that the splines cannot bridge, trimmed to where the board was seen, and cut
again where a rotation vector would come near a full turn from the segment's reference attitude.
"""

from collections.abc import Sequence

import numpy as np

from ....errors import InitialisationError
from ....frozen import value_class
from ....geometry.bspline import bspline_basis
from ....geometry.quaternion import rk4n_steps, rotation_from_quaternion, running_products
from ....geometry.rotation_vector import nearest_branch, rotation_from_rotvec, rotvec_from_rotation, unwrap_rotvecs
from ....recording import Floats
from ....solve.lapack import solve_banded
from ..trajectory import BIAS, MARGIN_S, KnotGrid, Segment, Trajectory

_GUIDE_S = 0.1  # from one rotation vector to the next where their branch is followed
_LARGEST_ANGLE = 4.5  # rad from the reference attitude; the chart ends at 2 pi
_WIDEST_GAP = 3.0  # knot spacings without IMU samples that the splines bridge
_FEWEST_FRAMES = 5
_SHORTEST_S = 0.5


@value_class
class ImuPath:
    """Attitude and position of the IMU at its timestamps, roughly.

    Attributes
    ----------
    t_s : (n,) [s]
    R : (n, 3, 3) R_target_imu
    position : (n, 3) [m], target frame
    """

    t_s: Floats
    R: Floats
    position: Floats


def imu_path(t_s: Floats, omega: Floats, frame_t_s: Floats, frame_R: Floats, frame_p: Floats) -> ImuPath:
    """Join the attitudes at frames by the gyroscope, and the positions by straight lines.

    Parameters
    ----------
    t_s : (n,) timestamps of the IMU [s]
    omega : (n, 3) gyroscope less its bias [rad/s]
    frame_t_s : (m,) timestamps of frames on the IMU's clock [s]
    frame_R : (m, 3, 3) R_target_imu at frames
    frame_p : (m, 3) position of the IMU at frames [m]
    """
    steps = rk4n_steps(omega[:-1], omega[1:], np.diff(t_s))
    products = running_products(steps, np.array([len(steps)]))
    turned = rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))
    before = np.clip(np.searchsorted(t_s, frame_t_s, side="right") - 1, 0, len(t_s) - 1)
    at_frame = turned[before] @ rotation_from_rotvec(omega[before] * (frame_t_s - t_s[before])[:, None])
    correction = frame_R @ np.swapaxes(at_frame, 1, 2)  # from integrated to true, drifting slowly
    between = rotvec_from_rotation(np.swapaxes(correction[:-1], 1, 2) @ correction[1:])
    k = np.clip(np.searchsorted(frame_t_s, t_s, side="right") - 1, 0, len(frame_t_s) - 2)
    share = np.clip((t_s - frame_t_s[k]) / (frame_t_s[k + 1] - frame_t_s[k]), 0.0, 1.0)
    R = correction[k] @ rotation_from_rotvec(share[:, None] * between[k]) @ turned
    position = np.stack([np.interp(t_s, frame_t_s, frame_p[:, i]) for i in range(3)], axis=1)
    return ImuPath(t_s=t_s, R=R, position=position)


def initial_trajectory(
    path: ImuPath, frame_t_s: Floats, knots_per_s: float, *, order: int, gyroscope_biases: Sequence[Floats]
) -> Trajectory:
    """Return splines through a path.

    Parameters
    ----------
    path : attitude and position at the IMU's timestamps
    frame_t_s : (m,) when the board was seen, on the IMU's clock [s], ascending
    knots_per_s, order : of the splines
    gyroscope_biases : of each IMU, (3,) [rad/s]

    Raises
    ------
    InitialisationError
        If nowhere board and IMU were recorded together for half a second.
    """
    spacing = 1 / knots_per_s
    spans = _usable_spans(path.t_s, frame_t_s, spacing)
    pieces = [piece for start, stop in spans for piece in _charted(path, start, stop)]
    if not pieces:
        raise InitialisationError(
            f"nowhere are there {_FEWEST_FRAMES} frames with the board and the IMU's samples within "
            f"{_SHORTEST_S:g} s. Check that both streams are of one recording."
        )
    segments: list[Segment] = []
    controls: list[Floats] = []
    first = 0
    for piece in pieces:
        start, stop = piece.start_s, piece.stop_s
        count = max(1, int(np.ceil((stop - start) / spacing - 1e-6)))
        inside = (path.t_s >= start - 1e-9) & (path.t_s <= stop + 1e-9)
        phi = _rotation_vectors(path, inside, piece)
        values = np.concatenate([phi, path.position[inside]], axis=1)
        position = np.clip((path.t_s[inside] - start) / spacing, 0.0, count - 1e-9)
        segments.append(Segment(start_s=start, spans=count, first=first, R_reference=piece.R_reference))
        pose = fitted_splines(position, values, count, order)
        biases = np.zeros((len(pose), BIAS * len(gyroscope_biases)))
        for imu, bias in enumerate(gyroscope_biases):
            biases[:, BIAS * imu : BIAS * imu + 3] = bias
        controls.append(np.concatenate([pose, biases], axis=1))
        first += count + order - 1
    grid = KnotGrid(segments=tuple(segments), spacing_s=spacing, order=order)
    return Trajectory(grid=grid, controls=np.concatenate(controls))


def _usable_spans(t_s: Floats, frame_t_s: Floats, spacing: float) -> list[tuple[float, float]]:
    """Return from when to when the IMU has no wide gap and the board was seen often enough."""
    step = np.diff(t_s)
    cuts = np.flatnonzero(step > max(_WIDEST_GAP * spacing, 2.5 * float(np.median(step)))) + 1
    spans: list[tuple[float, float]] = []
    for part in np.split(t_s, cuts):
        seen = frame_t_s[(frame_t_s >= part[0]) & (frame_t_s <= part[-1])]
        if len(seen) < _FEWEST_FRAMES or seen[-1] - seen[0] < _SHORTEST_S:
            continue
        spans.append((max(float(part[0]), float(seen[0]) - MARGIN_S), min(float(part[-1]), float(seen[-1]) + MARGIN_S)))
    return spans


@value_class
class _Piece:
    """A piece of the path: from when to when, its reference attitude, and its rotation vectors here and there."""

    start_s: float
    stop_s: float
    R_reference: Floats
    guide_t_s: Floats
    guide: Floats


def _charted(path: ImuPath, start: float, stop: float) -> list[_Piece]:
    """Return pieces whose rotation vectors stay far from a full turn about their reference attitudes."""
    inside = np.flatnonzero((path.t_s >= start - 1e-9) & (path.t_s <= stop + 1e-9))
    rate = (len(inside) - 1) / max(stop - start, 1e-9)
    thin = np.unique(np.append(inside[:: max(1, int(_GUIDE_S * rate))], inside[-1]))
    candidates = path.R[thin[:: max(1, len(thin) // 40)]]
    relative = np.swapaxes(candidates, 1, 2)[None] @ path.R[thin][:, None]
    vectors = unwrap_rotvecs(rotvec_from_rotation(relative))
    angles = np.linalg.norm(vectors, axis=-1).max(axis=0)
    best = int(np.argmin(angles))
    if angles[best] < _LARGEST_ANGLE or stop - start < 2 * _SHORTEST_S:
        return [
            _Piece(
                start_s=start,
                stop_s=stop,
                R_reference=candidates[best],
                guide_t_s=path.t_s[thin],
                guide=vectors[:, best],
            )
        ]
    middle = 0.5 * (start + stop)
    return _charted(path, start, middle) + _charted(path, middle, stop)


def _rotation_vectors(path: ImuPath, inside: np.ndarray, piece: _Piece) -> Floats:
    """Return continuous rotation vectors from the reference attitude, (n, 3)."""
    phi = rotvec_from_rotation(piece.R_reference.T @ path.R[inside])
    t_s = path.t_s[inside]
    guide = np.stack([np.interp(t_s, piece.guide_t_s, piece.guide[:, i]) for i in range(3)], axis=1)
    return nearest_branch(phi, guide)


def fitted_splines(position: Floats, values: Floats, spans: int, order: int) -> Floats:
    """Return control points (spans + order - 1, m) of splines near values (n, m) at positions (n,) in spans."""
    count = spans + order - 1
    first = np.minimum(position.astype(np.int64), spans - 1)
    weights = bspline_basis(order, position - first)
    banded, right = np.zeros((order, count)), np.zeros((count, values.shape[1]))
    for i in range(order):
        for j in range(i, order):
            banded[j - i] += np.bincount(first + i, weights[:, i] * weights[:, j], count)
        for axis in range(values.shape[1]):
            right[:, axis] += np.bincount(first + i, weights[:, i] * values[:, axis], count)
    # Third differences are held small where no sample is near; of what the samples show it changes nothing.
    third = np.array([-1.0, 3.0, -3.0, 1.0]) * 1e-3
    for i in range(min(4, count)):
        for j in range(i, 4):
            banded[j - i, i : count - 3 + i] += third[i] * third[j]
    return solve_banded(banded, right)
