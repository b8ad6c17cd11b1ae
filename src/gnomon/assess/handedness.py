"""Whether a board is seen from its front: the order of its points tells, whatever the lens and the pose."""

import numpy as np

from ..findings import Finding, make_finding
from ..models.target import Target
from ..recording import CameraFrames, Integers
from .camera_views import Booleans

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
    if target.kind == "circlegrid" and target.asymmetric:  # printed in both senses, which the detector finds out
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
    ends = np.searchsorted(frames.frame, np.stack([usable, usable + 1]))
    turned = np.zeros(len(usable), dtype=np.bool_)
    for k, (first, last) in enumerate(ends.T.tolist()):
        board = target.points[frames.point[first:last], :2]
        pixels = frames.pixels[first:last]
        board, pixels = board - board.mean(axis=0), pixels - pixels.mean(axis=0)
        turned[k] = np.linalg.det(np.linalg.lstsq(board, pixels, rcond=None)[0]) > 0
    return turned
