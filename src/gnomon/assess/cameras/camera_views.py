"""Views of a board: which there are, copies, and mirrored ones."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers, Recording

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


Booleans = NDArray[np.bool_]

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
