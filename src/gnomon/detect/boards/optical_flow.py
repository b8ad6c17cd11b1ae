"""Where corners of a board are in the next image, to a pixel or two, by optical flow between reduced images."""

import cv2
import numpy as np

from ...models.camera import Booleans
from ...recording import Floats
from ...recording.frames import Grey

_WINDOW, _LEVELS, _STEPS, _STEP_PX = 13, 2, 15, 0.05


def carry_corners(before: Grey, now: Grey, corners: Floats, guess: Floats, scale: int) -> tuple[Floats, Booleans]:
    """Return where corners are in the next image, (m, 2) [px], and which of them could be followed, (m,).

    Parameters
    ----------
    before, now : (h, w) both images, reduced by `scale`
    corners, guess : (m, 2) in the image before, and about where they are now [px of the whole image]
    scale : whole number
    """
    start, first = (
        ((places - (scale - 1) / 2) / scale).reshape(-1, 1, 2).astype(np.float32) for places in (corners, guess)
    )
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        start,
        first,
        winSize=(_WINDOW, _WINDOW),
        maxLevel=_LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, _STEPS, _STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return moved.reshape(-1, 2).astype(np.float64) * scale + (scale - 1) / 2, status.ravel() == 1
