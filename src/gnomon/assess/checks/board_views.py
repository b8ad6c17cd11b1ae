"""What the views of a board show: which there are, copies, mirrored ones, how large it is, and whether it was moved."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...estimate.camera_imu.start.board_poses import BoardPoses
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers, Recording
from ...results.result import Booleans

_FEW, _MANY = 0.02, 0.5
"""Shares of views that are copied, and that are alike, above which it is a warning."""


_CELLS = [(i, j) for i in (0, -1, 1) for j in (0, -1, 1)]


def without_copies(recording: Recording, *, alike_px: float = 0.0) -> tuple[Recording, tuple[Finding, ...]]:
    """Return a recording of cameras in which every view is there once, and what there is to say of the copies.

    Noise makes the corners of two images differ, also of a board that does not move: what is equal to the last digit is
    the same image, copied or delivered again. Copies that were coded anew differ by hundredths of a pixel, and so do
    images of a board and a camera at rest, whose errors are mostly the same: neither tells anything new of a lens.

    Parameters
    ----------
    alike_px : how far the corners of a copy may lie from those of an earlier view, root mean square [px]
    """
    cameras: dict[str, CameraFrames] = {}
    findings: list[Finding] = _shared_views(recording.cameras)
    for name, frames in recording.cameras.items():
        copies, views = _copies(frames, alike_px)
        cameras[name] = frames
        if copies:
            kept = ~np.isin(frames.frame, list(copies))
            sigma = None if frames.sigma_px is None else frames.sigma_px[kept]
            cameras[name] = replace(
                frames, frame=frames.frame[kept], point=frames.point[kept], pixels=frames.pixels[kept], sigma_px=sigma
            )
            exact = {frame: original for frame, (original, apart_px) in copies.items() if apart_px == 0}
            findings += [
                _copies_finding(name, of, views, exact=of is exact)
                for of in (exact, {frame: original for frame, (original, _) in copies.items() if frame not in exact})
                if of
            ]
    return (replace(recording, cameras=cameras), tuple(findings)) if findings else (recording, ())


def _shared_views(cameras: Mapping[str, CameraFrames]) -> list[Finding]:
    """Return which cameras have their corners, to the last digit, from the same images."""
    begins = {name: np.unique(frames.frame, return_index=True)[1] for name, frames in cameras.items()}
    first = {name: {*map(tuple, cameras[name].pixels[at].tolist())} for name, at in begins.items()}
    return [
        make_finding("views-copied/cameras", name=name, other=other, count=len(first[name] & first[other]))
        for name, other in combinations(cameras, 2)
        if len(first[name] & first[other]) > _FEW * min(len(first[name]), len(first[other]))
    ]


def _copies(frames: CameraFrames, alike_px: float) -> tuple[dict[int, tuple[int, float]], int]:
    """Return the frames that show an earlier one once more -> that one and how far apart, and how many show corners.

    Views alike have their middles in the same or in neighbouring cells of that width.
    """
    shown, first = np.unique(frames.frame, return_index=True)
    if not alike_px and len({*map(tuple, np.maximum.reduceat(frames.pixels, first).tolist())}) == len(shown):
        return {}, len(shown)  # no two reach as far to the right and down
    ends = np.append(first, len(frames.frame))
    seen: dict[tuple[bytes, int, int], list[tuple[int, Floats]]] = {}
    copies: dict[int, tuple[int, float]] = {}
    for k, frame in enumerate(shown.tolist()):
        part = slice(ends[k], ends[k + 1])
        order = np.argsort(frames.point[part], kind="stable")
        points, pixels = frames.point[part][order].tobytes(), frames.pixels[part][order]
        u, v = np.floor(pixels.mean(axis=0) / (alike_px or 1.0)).astype(np.int64).tolist()
        near = [one for i, j in _CELLS for one in seen.get((points, u + i, v + j), ())]
        apart_px = [float(np.sqrt(np.mean(((view - pixels) ** 2).sum(axis=1)))) for _, view in near]
        best = int(np.argmin(apart_px)) if apart_px else -1
        if best >= 0 and apart_px[best] <= alike_px:
            copies[frame] = near[best][0], apart_px[best]
        else:
            seen.setdefault((points, u, v), []).append((frame, pixels))
    return copies, len(shown)


def _copies_finding(name: str, copies: Mapping[int, int], views: int, *, exact: bool) -> Finding:
    frame, original = next(iter(copies.items()))
    return make_finding(
        "views-copied",
        severity="warning" if len(copies) > (_FEW if exact else _MANY) * views else "info",
        case="exact" if exact else "alike",
        name=name,
        count=len(copies),
        views=views,
        frame=frame + 1,
        original=original + 1,
    )


FEWEST_CORNERS = 6  # fewer tell no wrong detection from a right one; as the estimation asks
_ON_A_LINE = 1e-6  # smaller over larger variance of the points


@value_class
class BoardSightings:
    """The frames in which something of the board was detected.

    Attributes
    ----------
    frame : (k,) index into the timestamps of the camera
    corners : (k,) number of corners
    extent_px : (k,) diagonal of the rectangle around the corners [px]
    usable : (k,) whether they tell a pose: at least four corners, not all on a line of the board
    """

    frame: Integers
    corners: Integers
    extent_px: Floats
    usable: Booleans


def board_sightings(frames: CameraFrames, target: Target) -> BoardSightings:
    """Return what each frame shows; linear time. All points must be on the target."""
    if not len(frames.frame):
        return BoardSightings(
            frame=np.empty(0, np.int64), corners=np.empty(0, np.int64), extent_px=np.empty(0), usable=np.empty(0, bool)
        )
    first = np.flatnonzero(np.concatenate([[True], np.diff(frames.frame) > 0]))
    corners = np.diff(np.append(first, len(frames.frame)))
    extent = np.maximum.reduceat(frames.pixels, first) - np.minimum.reduceat(frames.pixels, first)
    plane = (target.points[:, :2] - target.points[:, :2].mean(axis=0))[frames.point]
    x, y = plane[:, 0], plane[:, 1]
    sums = np.add.reduceat(np.stack([x, y, x * x, x * y, y * y], axis=1), first) / corners[:, None]
    xx, xy, yy = sums[:, 2] - sums[:, 0] ** 2, sums[:, 3] - sums[:, 0] * sums[:, 1], sums[:, 4] - sums[:, 1] ** 2
    half, root = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return BoardSightings(
        frame=frames.frame[first],
        corners=corners,
        extent_px=np.hypot(extent[:, 0], extent[:, 1]),
        usable=(corners >= FEWEST_CORNERS) & (half - root > _ON_A_LINE * (half + root)),
    )


def image_coverage(pixels: Floats, resolution: tuple[int, int], cells: tuple[int, int] = (10, 8)) -> float:
    """Return the share of the cells of a grid over the image in which there is at least one corner.

    Parameters
    ----------
    pixels : (m, 2) [px]
    resolution : (width, height) [px]
    cells : number of cells along the width and along the height
    """
    index = np.floor((pixels + 0.5) * (np.array(cells) / np.array(resolution))).astype(np.int64)
    column, row = index[:, 0], index[:, 1]
    inside = (column >= 0) & (column < cells[0]) & (row >= 0) & (row < cells[1])
    return len(np.unique(column[inside] * cells[1] + row[inside])) / (cells[0] * cells[1])


_MIRRORED = 0.5
_SOME = 0.02


def check_handedness(name: str, frames: CameraFrames, usable: Integers, target: Target) -> list[Finding]:
    """Say that points of the board run the other way round in the image, as in a mirror.

    x cross y of the board points to the viewer, and v runs down in images: the determinant of the affine map from the
    board to the image is negative in every view. A mirrored image fits as well, with a board that is seen from behind
    and a principal point on the wrong side of the middle: no residual shows it.

    Parameters
    ----------
    usable : (k,) frames that tell a pose
    """
    # printed in both senses, which the detector finds out; or no plane at all
    if target.kind == "landmarks" or (target.kind == "circlegrid" and target.asymmetric):
        return []
    mirrored = _from_behind(frames, usable, target)
    share = float(np.mean(mirrored)) if len(mirrored) else 0.0
    if share <= _SOME:
        return []
    if share > _MIRRORED:
        what = f"in {np.count_nonzero(mirrored)} of {len(mirrored)} views the points of the board run as in a mirror"
        since = "the images are mirrored, or the corners are numbered the other way round than target.yaml says"
    else:
        what = f"in {np.count_nonzero(mirrored)} of {len(mirrored)} views alone the points run as in a mirror"
        since = "some images are mirrored, or their corners are numbered in another way"
    return [make_finding("board-mirrored", name=name, what=what, since=since)]


def _from_behind(frames: CameraFrames, usable: Integers, target: Target) -> Booleans:
    """Return of each frame whether the affine map from the board to the image keeps the sense of turning, (k,)."""
    mine = np.isin(frames.frame, usable)
    _, of, count = np.unique(frames.frame[mine], return_inverse=True, return_counts=True)
    columns = np.concatenate([target.points[frames.point[mine], :2], frames.pixels[mine]], axis=1).T
    columns = columns - np.stack([np.bincount(of, column) / count for column in columns])[:, of]
    (xu, xv), (yu, yv) = ([np.bincount(of, a * b) for b in columns[2:]] for a in columns[:2])
    return xu * yv > xv * yu  # det (B'B)^-1 B'P of board B and pixels P: its first factor is positive


_NEAR_S, _FAR_S = 1.0, 3.0
"""Frames up to the first are compared; those from the first to the second tell whether it lasts."""


_LONGEST_GAP_S = 3.0
"""Between frames, over which the gyroscope alone is trusted."""


_INDEPENDENT = 3.0
"""Poses of a second that err independently: lens, board and view err alike in frames that follow each other."""


_FEWEST = 4  # frames on each side
_FLOOR_RAD = 2e-3  # of a pose, however many corners it has
_DRIFT_RAD_S = 1e-3
_NEIGHBOURS, _ROBUST = 11, 4.0
_MOVED_RAD, _MOVED_SIGMAS, _MOVED_TIMES = 0.015, 6.0, 6.0
_LASTS = 0.5  # of the turn, by which it may be another one later, or by another camera
_TELLS = 0.25  # of the turn, below which its sigma must be where a camera is asked


@value_class
class BoardTurns:
    """By how much a camera saw the board turn about each frame.

    Attributes
    ----------
    t_s : (n,) of the frames, on the IMU's clock [s]
    turn_rad : (n, 3) from the second before to the second after, in the board's axes; nan where too little was seen
    sigma_rad : (n,) its standard deviation, of the worst axis
    lasting_rad : (n, 3) the same from some seconds before to some seconds after
    """

    t_s: Floats
    turn_rad: Floats
    sigma_rad: Floats
    lasting_rad: Floats

    @property
    def usual_rad(self) -> float:
        """How large these turns usually are [rad]."""
        size = np.linalg.norm(self.turn_rad, axis=1)
        return float(np.median(size[np.isfinite(size)])) if np.isfinite(size).any() else 0.0


@value_class
class BoardMove:
    """A board that was moved.

    Attributes
    ----------
    t_s : when, on the IMU's clock [s]
    turn_rad : by how much it turned [rad]; zero where it only shifted
    cameras : that saw it
    after_s : when, since the first of them saw the board [s]
    shift_m : by how much it shifted at least, where it only shifted [m]
    """

    t_s: float
    turn_rad: float
    cameras: tuple[str, ...]
    after_s: float
    shift_m: float = 0.0


def board_turns(t_s: Floats, poses: BoardPoses, differs: Floats, compared: Booleans) -> BoardTurns:
    """Return by how much a camera saw the board turn, beside what the gyroscope felt.

    Parameters
    ----------
    t_s : (n,) of the frames on the IMU's clock [s]
    poses : of these frames
    differs : (n - 1, 3) rotation between frames that the gyroscope read and the camera did not see, axes of the camera
        at the later one [rad]
    compared : (n - 1,) whether the gyroscope tells it
    """
    R = np.swapaxes(poses.R_cam_target, 1, 2)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(np.einsum("nij,nj->ni", R[1:], differs), axis=0)])
    covariance = R @ poses.rotation_covariance @ poses.R_cam_target
    excess = np.maximum(poses.scatter_px / max(float(np.median(poses.scatter_px)), 1e-9), 1.0)
    covariance = covariance * np.square(excess)[:, None, None] + _FLOOR_RAD**2 * np.eye(3)
    weight = np.linalg.inv(covariance) * _agreeing(total, covariance)[:, None, None]
    cut = ~compared | (np.diff(t_s) > _LONGEST_GAP_S)
    piece = np.concatenate([[0], np.cumsum(cut)])
    sums = _Sums.of(t_s, piece, total, weight)
    before, after = sums.mean(-_NEAR_S, 0.0), sums.mean(0.0, _NEAR_S)
    sooner, later = sums.mean(-_FAR_S, -_NEAR_S), sums.mean(_NEAR_S, _FAR_S)
    largest = np.sqrt(np.linalg.eigvalsh(before[1] + after[1])[:, -1])
    return BoardTurns(t_s=t_s, turn_rad=after[0] - before[0], sigma_rad=largest, lasting_rad=later[0] - sooner[0])


def board_move(cameras: Mapping[str, BoardTurns]) -> BoardMove | None:
    """Return where the board was moved, if one camera saw it that none contradicts."""
    found: list[tuple[float, str, int]] = []
    for name, turns in cameras.items():
        size = np.linalg.norm(turns.turn_rad, axis=1)
        least = max(_MOVED_RAD, _MOVED_TIMES * turns.usual_rad)
        told = (size > least) & (size > _MOVED_SIGMAS * turns.sigma_rad)
        told &= np.linalg.norm(turns.lasting_rad - turns.turn_rad, axis=1) < _LASTS * size
        found += [(float(size[k]), name, int(k)) for k in np.flatnonzero(told)]
    for size, name, k in sorted(found, reverse=True):
        turns = cameras[name]
        near = np.linalg.norm(turns.turn_rad - turns.turn_rad[k], axis=1) < 0.2 * size
        near &= np.abs(turns.t_s - turns.t_s[k]) < _NEAR_S
        t_s, turn = float(turns.t_s[near].mean()), turns.turn_rad[k]
        others = {other: _seen(one, t_s, turn) for other, one in cameras.items() if other != name}
        if False in others.values():
            continue
        agree = (name, *(other for other, seen in others.items() if seen))
        seen = tuple(camera for camera in cameras if camera in agree)
        return BoardMove(t_s=t_s, turn_rad=size, cameras=seen, after_s=t_s - float(cameras[seen[0]].t_s[0]))
    return None


def _seen(turns: BoardTurns, t_s: float, turn: Floats) -> bool | None:
    """Return whether a camera saw a turn at an instant; None where it cannot tell."""
    size = float(np.linalg.norm(turn))
    near = (np.abs(turns.t_s - t_s) < 0.5 * _NEAR_S) & (turns.sigma_rad < _TELLS * size)
    if not near.any():
        return None
    return bool((np.linalg.norm(turns.turn_rad[near] - turn, axis=1) < _LASTS * size).any())


def moved_finding(move: BoardMove) -> Finding:
    """Return what to say of a board that was moved."""
    when = f"{move.after_s:.0f} s after {move.cameras[0]} first saw it: {' and '.join(move.cameras)} saw"
    if move.shift_m > 0:
        return make_finding("board-moved/shifted", shift_m=move.shift_m, when=when)
    return make_finding("board-moved/turned", turn_rad=move.turn_rad, when=when)


def _agreeing(total: Floats, covariance: Floats) -> Floats:
    """Return weights (n,) that let single wrong poses count less: those far from their neighbours' median."""
    half = _NEIGHBOURS // 2
    padded = np.pad(total, ((half, half), (0, 0)), mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS, axis=0), axis=2)
    sigma = np.sqrt(np.einsum("nii->n", covariance))
    apart = np.linalg.norm(total - middle, axis=1) / (_ROBUST * sigma)
    return 1 / np.square(np.maximum(apart, 1.0))


@value_class
class _Sums:
    """Sums over frames, from which weighted means over stretches of time follow.

    Attributes
    ----------
    t_s : (n,) instants [s]
    first, last : (n,) first frame, and the one after the last, of the piece that the gyroscope holds together
    weight : (n + 1, 3, 3) sums of the weights up to each frame
    product : (n + 1, 3) of their products with the rotations
    """

    t_s: Floats
    first: np.ndarray
    last: np.ndarray
    weight: Floats
    product: Floats

    @classmethod
    def of(cls, t_s: Floats, piece: np.ndarray, total: Floats, weight: Floats) -> "_Sums":
        return cls(
            t_s=t_s,
            first=np.searchsorted(piece, piece, side="left"),
            last=np.searchsorted(piece, piece, side="right"),
            weight=np.concatenate([np.zeros((1, 3, 3)), np.cumsum(weight, axis=0)]),
            product=np.concatenate([np.zeros((1, 3)), np.cumsum(np.einsum("nij,nj->ni", weight, total), axis=0)]),
        )

    def mean(self, from_s: float, to_s: float) -> tuple[Floats, Floats]:
        """Return means (n, 3) over stretches beside each frame, and their covariances; nan, where frames are few."""
        begin = np.maximum(np.searchsorted(self.t_s, self.t_s + from_s, side="left"), self.first)
        end = np.minimum(np.searchsorted(self.t_s, self.t_s + to_s, side="right"), self.last)
        begin, end = (begin, np.minimum(end, np.arange(len(self.t_s)))) if to_s == 0 else (begin, end)
        count = end - begin
        enough = count >= _FEWEST
        begin, end = np.where(enough, begin, 0), np.where(enough, end, 1)
        inverse = np.linalg.inv(self.weight[end] - self.weight[begin])
        mean = np.einsum("nij,nj->ni", inverse, self.product[end] - self.product[begin])
        drift = (_DRIFT_RAD_S * max(abs(from_s), abs(to_s))) ** 2 * np.eye(3)
        wider = inverse * (np.maximum(count, 1) / _INDEPENDENT)[:, None, None] + drift
        return np.where(enough[:, None], mean, np.nan), np.where(enough[:, None, None], wider, 1e6 * np.eye(3))
