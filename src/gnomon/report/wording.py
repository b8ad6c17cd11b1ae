"""Sentences and texts that the pages of all kinds of calibration share."""

from ..calibration import Gravity
from ..recording import Floats
from .numbers import number

HEADLINES = {
    "pass": "This calibration is good to use.",
    "warn": "This calibration can be used, with the reservations below.",
    "fail": "Do not use this calibration.",
}

FRAMES = {
    "accel-x": "the x axis of the body is the sensitivity axis of the x accelerometer, and the y accelerometer lies in "
    "the x-y plane (Kalibr's convention)",
    "accel-z": "the z axis of the body is the sensitivity axis of the z accelerometer, and the y accelerometer lies in "
    "the y-z plane (the convention of Tedaldi and of imu_tk)",
    "gyro-x": "the x axis of the body is the sensitivity axis of the x gyroscope, and the y gyroscope lies in the x-y "
    "plane",
    "mag-x": "the x axis of the body is the sensitivity axis of the x magnetometer, and the y magnetometer lies in the "
    "x-y plane",
    "cam0": "x to the right of the image of cam0, y down, z out of its lens",
    "user": "axes of your own, taken from the poses that you named",
}
"""What the body frames mean."""


def gravity_text(gravity: Gravity) -> str:
    """Return the magnitude of gravity with its sigma, if it has one, and its unit."""
    spread = f" ± {number(gravity.sigma, 2)}" if gravity.sigma > 0 else ""
    return f"{number(gravity.value, 7)}{spread}\u00a0m/s²"


def matrix_text(name: str, values: Floats, digits: int = 9) -> str:
    """Return a matrix as aligned text, rows in brackets."""
    cells = [[f"{v:.{digits}g}" for v in row] for row in values.tolist()]
    width = max(len(cell) for row in cells for cell in row)
    middle = len(cells) // 2
    return "\n".join(
        f"{name if i == middle else ' ' * len(name)} {'=' if i == middle else ' '} "
        f"[ {'  '.join(c.rjust(width) for c in row)} ]"
        for i, row in enumerate(cells)
    )
