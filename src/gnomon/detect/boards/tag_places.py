"""Where the corners of a board of tags should be in an image, by what those around them say."""

from functools import lru_cache

import numpy as np

from ...kernel import library, load_kernel
from ...models.camera import Booleans
from ...models.target import Target
from ...recording import Floats, Integers
from .tags import square_to_quads

TAG = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""The corners of a tag, counter-clockwise from the lower left, in sides of it."""

_MIDDLE = np.array([[0.5, 0.5]])
_APART_PX, _APART = 1.5, 0.35  # how far, in px and in tags, a tag may be from where another one says
_MOST_GROUPS = 8
_REACH = 2  # tags; farther neighbours do not judge each other
_AROUND = ((20, 3), (16, 2), (10, 2), (6, 1))  # so many corners tell where another one is, by so high a polynomial
_WIDER = 1.2  # where a corner would have no weight, over the distance of the farthest one that is asked
_FAR_ADDED = 3.0  # the same of a corner that was added, in what is far for nine of ten
_FAR_CORNER_PX, _FAR_CORNER, _SIGMAS = 0.2, 6.0, 4.0  # how far from there it may be: px, typical distances, sigmas


def map_points(homographies: Floats, points: Floats) -> Floats:
    """Return points (n, 2), or (k, n, 2), mapped by homographies (k, 3, 3), (k, n, 2)."""
    x, y = points[..., 0], points[..., 1]
    H = homographies[:, None]
    w = H[..., 2, 0] * x + H[..., 2, 1] * y + H[..., 2, 2]
    w = np.where(np.abs(w) < 1e-9, 1e-9, w)
    u = (H[..., 0, 0] * x + H[..., 0, 1] * y + H[..., 0, 2]) / w
    v = (H[..., 1, 0] * x + H[..., 1, 1] * y + H[..., 1, 2]) / w
    return np.stack([u, v], axis=-1)


def shortest_side(corners: Floats) -> Floats:
    """Return the shortest side of tags (k, 4, 2), (k,) [px]."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)


def predict_points(target: Target, by: Integers, corners: Floats, of: Integers, points: Floats) -> Floats:
    """Return where points of tags should be by what each of some others says, (k, n, p, 2).

    Parameters
    ----------
    by : (k,) tags that were found, with their `corners` (k, 4, 2)
    of : (n,) tags that are asked for
    points : (p, 2) in these, in sides of a tag
    """
    return _as_told(target, by, of, square_to_quads(corners), points)


def _as_told(target: Target, by: Integers, of: Integers, H: Floats, points: Floats) -> Floats:
    right, up = _steps(target, by, of)
    local = (1 + target.tag_spacing) * np.stack([right, up], axis=-1)[:, :, None, :] + points
    return map_points(H, local.reshape(len(by), -1, 2)).reshape(len(by), len(of), -1, 2)


def far_apart(target: Target, by: Integers, of: Integers) -> Integers:
    """Return how many tags are between tags, (k, n), along rows or columns, one more than that."""
    right, up = _steps(target, by, of)
    return np.maximum(np.abs(right), np.abs(up))


def _steps(target: Target, by: Integers, of: Integers) -> tuple[Integers, Integers]:
    (row, col), (other_row, other_col) = np.divmod(by, target.cols), np.divmod(of, target.cols)
    return other_col - col[:, None], other_row - row[:, None]


def group_tags(target: Target, number: Integers, corners: Floats) -> list[Integers]:
    """Return which tags agree with each other on where they are: some groups of indices, the largest first.

    A tag that is twice in a group is there once, as more of the others say.
    """
    distance = far_apart(target, number, number)
    H = square_to_quads(corners)
    apart = _as_told(target, number, number, H, _MIDDLE)[:, :, 0] - map_points(H, _MIDDLE)[:, 0]
    apart = np.hypot(apart[..., 0], apart[..., 1])
    agrees = (apart < _APART_PX + _APART * shortest_side(corners) * distance) & (distance > 0) & (distance <= _REACH)
    agrees &= agrees.T
    group = connected_tags(agrees)
    sizes = np.bincount(group)
    largest = np.argsort(-sizes, kind="stable")[: min(_MOST_GROUPS, np.count_nonzero(sizes))]
    return [once_each(np.flatnonzero(group == name), number, agrees) for name in largest.tolist()]


def connected_tags(agrees: Booleans) -> Integers:
    """Return for each tag the smallest index of those that it agrees with, directly or through others, (k,).

    Parameters
    ----------
    agrees : (k, k) symmetric, which tags agree on where they are
    """
    count = len(agrees)
    group = np.arange(count)
    while True:
        smallest = np.minimum(group, np.where(agrees, group, count).min(axis=1, initial=count))
        if (smallest == group).all():
            return group
        group = smallest


def once_each(members: Integers, number: Integers, agrees: Booleans) -> Integers:
    """Return the members (m,) of a group, of those with the same number the one that most others agree with."""
    votes = agrees.sum(axis=1)
    by_votes = members[np.argsort(-votes[members], kind="stable")]
    by_number = by_votes[np.argsort(number[by_votes], kind="stable")]
    return by_number[np.diff(number[by_number], prepend=-1) > 0]


def locate_points(board: Floats, pixels: Floats, points: Floats) -> Floats:
    """Return where points (n, 2) of the board are in the image, (n, 2), by corners around them whose places are known.

    The map is a homography with a displacement on the board that is a polynomial around each point.

    Parameters
    ----------
    board, pixels : (m, 2) corners on the board [m], and in the image [px]
    points : on the board [m]
    """
    near, share = _shares(board, points, _AROUND[1:])
    return _interpolated(board, pixels, points, near, share)


def consistent_corners(board: Floats, pixels: Floats, sigma_px: Floats) -> tuple[Booleans, float]:
    """Return which corners (m,) are where those around them say, and how far from there nine of ten are [px].

    Parameters
    ----------
    board, pixels : (m, 2) corners on the board [m], and in the image [px]
    sigma_px : (m,) of the corners [px]
    """
    kept, most = np.ones(len(board), dtype=bool), 0.0
    for _ in range(len(board)):
        index = np.flatnonzero(kept)
        if len(index) <= _AROUND[-1][0]:
            break
        points = board[index]
        near, share = _leave_one_out(points.tobytes(), len(index))
        away = np.hypot(*(_interpolated(points, pixels[index], points, near, share) - pixels[index]).T)
        around = np.partition(away[near], near.shape[1] // 2, axis=1)[:, near.shape[1] // 2]
        by_size = np.sort(away)
        most = float(by_size[(9 * len(away)) // 10])
        typical = np.maximum(around, by_size[len(away) // 2])
        sigma = _told_sigma(sigma_px[index], sigma_px[index], near, share)
        far = away > _FAR_CORNER_PX + np.maximum(_FAR_CORNER * typical, _SIGMAS * sigma)
        worst = far & (away >= np.where(far[near], away[near], 0).max(axis=1))
        if not worst.any():
            break
        kept[index[worst]] = False
    return kept, most


def consistent_additions(board: Floats, pixels: Floats, sigma_px: Floats, new: int, most: float) -> Booleans:
    """Return the same of corners of which only some, at the end, are in question; `most` is what the others told."""
    kept = np.ones(len(board), dtype=bool)
    asked = np.arange(len(board) - new, len(board))
    if len(board) > _AROUND[-1][0]:
        near, share = _shares(board, asked, _AROUND)
        away = np.hypot(*(_interpolated(board, pixels, board[asked], near, share) - pixels[asked]).T)
        sigma = _told_sigma(sigma_px[asked], sigma_px, near, share)
        kept[asked] = away <= _FAR_CORNER_PX + np.maximum(_FAR_ADDED * most, _SIGMAS * sigma)
    return kept


def _told_sigma(own: Floats, others: Floats, near: Integers, share: Floats) -> Floats:
    """Return the sigma of how far corners are from where others tell, from their own and that of these, (n,) [px]."""
    return np.sqrt(np.square(own) + np.square(share * others[near]).sum(axis=1))


@lru_cache(maxsize=64)
def _leave_one_out(board: bytes, count: int) -> tuple[Integers, Floats]:
    """Return by which others each of some corners is told, (m, k), and their shares; the same sets come again."""
    return _shares(np.frombuffer(board).reshape(count, 2), np.arange(count), _AROUND)


def _shares(board: Floats, asked: Floats | Integers, around: tuple[tuple[int, int], ...]) -> tuple[Integers, Floats]:
    """Return by which corners each point is told, (n, k), and the share of each.

    Parameters
    ----------
    board : (m, 2) the corners [m]
    asked : (n, 2) points [m], or (n,) which of the corners, that tell nothing on themselves
    around : how many corners at most for a polynomial of which degree
    """
    themselves = asked.ndim == 1
    points = board[asked.astype(np.int64)] if themselves else asked
    away = np.square(points[:, None] - board).sum(axis=2)
    if themselves:
        away[np.arange(len(asked)), asked.astype(np.int64)] = np.inf
    others = len(board) - themselves
    count, degree = next(((most, degree) for most, degree in around if others >= most), (others, 1))
    near = np.argpartition(away, count - 1, axis=1)[:, :count]
    squares = np.take_along_axis(away, near, 1)
    widest = np.sqrt(squares.max(axis=1, keepdims=True))
    weight = np.square(1 - squares / (_WIDER * widest) ** 2)
    x, y = np.moveaxis((board[near] - points[:, None]) / widest[..., None], 2, 0)
    A = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=2)
    weighted = A * weight[..., None] ** 2
    normal = np.matmul(A.transpose(0, 2, 1), weighted) + 1e-7 * np.eye(A.shape[2])
    first = np.zeros((len(points), A.shape[2], 1))
    first[:, 0] = 1  # the polynomial at the point itself
    return near, np.matmul(weighted, np.linalg.solve(normal, first))[:, :, 0]


def _interpolated(board: Floats, pixels: Floats, points: Floats, near: Integers, share: Floats) -> Floats:
    H = fit_homography(board, pixels)
    displaced = map_points(np.asarray(np.linalg.inv(H), np.float64)[None], pixels)[0] - board
    return map_points(H[None], points + np.einsum("nk,nkd->nd", share, displaced[near]))[0]


def fit_homography(points: Floats, pixels: Floats) -> Floats:
    """Return the homography (3, 3) that maps points (m, 2) to pixels (m, 2) best, by algebraic distance."""
    if load_kernel() is not None:
        return library.solve_homography(points, pixels)
    (from_, p), (to, q) = _normalised(points), _normalised(pixels)
    p = np.column_stack([p, np.ones(len(p))])
    by = np.column_stack([np.ones(len(q)), -q, np.square(q).sum(axis=1)])
    M = (by.T @ (p[:, :, None] * p[:, None]).reshape(-1, 9)).reshape(4, 3, 3)
    normal = np.zeros((3, 3, 3, 3))  # block, row in it, block, column in it
    normal[0, :, 0] = normal[1, :, 1] = M[0]
    normal[0, :, 2] = normal[2, :, 0] = M[1]
    normal[1, :, 2] = normal[2, :, 1] = M[2]
    normal[2, :, 2] = M[3]
    least = np.linalg.eigh(normal.reshape(9, 9))[1][:, 0].reshape(3, 3)
    return np.asarray(np.linalg.solve(to, least @ from_), dtype=np.float64)


def _normalised(points: Floats) -> tuple[Floats, Floats]:
    """Return what moves points (m, 2) to zero mean and unit spread, and the moved ones."""
    mean = points.mean(axis=0)
    moved = points - mean
    scale = 1 / max(float(np.sqrt(np.square(moved).mean())), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]]), moved * scale
