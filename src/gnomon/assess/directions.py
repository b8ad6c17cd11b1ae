"""How to say in motions along which directions the parts of a calibration are known well or badly.

A part is what one kind of motion determines: where a camera sits, how a gyroscope answers to rotations about an axis,
how an accelerometer answers to forces along one. Its directions are the principal axes of its covariance.
"""

from math import ceil, isfinite
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..recording import Floats, Integers

Kind = Literal["rotation", "translation", "time_shift", "gyroscope", "g_sensitivity", "accelerometer"]
_CAMERA_AXES = ("x axis (right)", "y axis (down)", "optical axis")
_IMU_AXES = ("x axis", "y axis", "z axis")
_ALONG = 0.9
"""Cosine from which on a direction is called by the name of an axis."""

_TRADES = 0.9
"""Correlation from which on the scale of an accelerometer is said to trade with its bias."""

_PATIENCE_S = 600.0
_SOON_S, _SAME_S = 30.0, 180.0
"""Within the first a person goes on as before, whatever is missing; beyond the second never."""

_ALIKE = 0.6  # of the worst direction's sigma: as badly known
_CLOSE = 5.0  # times what is wanted: the motion was there, but too little of it


@value_class
class Part:
    """A part of a calibration, and its principal directions, the worst known first.

    Attributes
    ----------
    kind, sensor : such as "gyroscope" of "imu0"
    index : (k,) places of its scalars among the names; of matrices row by row
    axes : (3, 3) principal directions as columns: of a camera in its own axes; of an IMU in its own, of its pose in the
        body's
    sigma : (3,) standard deviation along each; of a matrix that of its answer to a unit vector, over all rows
    places : (3, k) each direction in the part's scalars, unit vectors
    bias_correlation : of an accelerometer's scale along the worst direction with its bias; 0 of others
    """

    kind: Kind
    sensor: str
    index: Integers
    axes: Floats
    sigma: Floats
    places: Floats
    bias_correlation: float = 0.0

    @property
    def of_camera(self) -> bool:
        """Whether it is a camera's."""
        return not self.sensor.startswith("imu")


def axis_words(direction: Floats, *, of_camera: bool) -> str:
    """Return what a person calls a direction: an axis, or what it lies between.

    Examples
    --------
    >>> axis_words(np.array([0.0, 0.1, -0.99]), of_camera=True)
    'optical axis'
    >>> axis_words(np.array([0.7, 0.0, 0.7]), of_camera=False)
    'diagonal of x axis and z axis'
    """
    names = _CAMERA_AXES if of_camera else _IMU_AXES
    size = np.abs(direction) / np.linalg.norm(direction)
    first, second = np.argsort(-size)[:2].tolist()
    if size[first] > _ALONG:
        return names[first]
    return f"diagonal of {names[min(first, second)]} and {names[max(first, second)]}"


def across_words(direction: Floats, *, of_camera: bool) -> str:
    """Return the two axes that lie across a direction most."""
    names = _CAMERA_AXES if of_camera else _IMU_AXES
    first, second = sorted(np.argsort(np.abs(direction))[:2].tolist())
    return f"{names[first]} and {names[second]}"


def seconds_more(part: Part, wanted: float, duration_s: float) -> tuple[float, bool]:
    """Return for how long to go on until the worst direction is known to `wanted`, and whether as before.

    The information gathered per second is that of the motion at hand: along the worst direction if all goes on as
    before, along the best one if what is missing is moved as briskly as the rest was. Infinite where neither will do.

    Parameters
    ----------
    part : its sigmas
    wanted : standard deviation [unit of the part]
    duration_s : of the recording; nan where not known
    """
    if not isfinite(duration_s) or trades_with_bias(part):
        return float("inf"), False
    missing = 1 / wanted**2 - 1 / part.sigma[0] ** 2
    same = duration_s * missing * part.sigma[0] ** 2
    best = duration_s * missing * float(part.sigma.min()) ** 2
    if same <= min(max(2 * best, _SOON_S), _SAME_S):
        return max(same, 0.0), True
    return best, False


def duration_text(seconds: float) -> str:
    """Return a time for people, rounded up, or nothing where it would be longer than anyone waits."""
    if not isfinite(seconds) or seconds > _PATIENCE_S:
        return ""
    step = 5 if seconds <= 60 else 30
    return f"{max(10, step * ceil(seconds / step)):d} s more"


def motion_advice(part: Part, wanted: float, duration_s: float, R_cam_imu: Floats | None = None) -> str:
    """Return the motion that determines the worst direction of a part.

    Parameters
    ----------
    part : see `estimated_parts`
    wanted : standard deviation [unit of the part]
    duration_s : of the recording; nan where not known
    R_cam_imu : (3, 3) where there is a camera, whose axes a person sees
    """
    seconds, as_before = seconds_more(part, wanted, duration_s)
    time = duration_text(seconds)
    if as_before and time:
        return f"Go on with the same motion for {time}."
    motion = _motion(part, R_cam_imu)
    if time:
        return f"{motion} for {time}, as briskly as in the other directions."
    if R_cam_imu is not None and isfinite(duration_s) and part.sigma[0] < _CLOSE * wanted:
        return f"{motion}, more briskly; come nearer to the board."
    return f"{motion}, briskly." if R_cam_imu is not None else f"{motion}."


def one_direction(part: Part) -> bool:
    """Return whether some directions are known much better than the worst: a motion is missing, not just time."""
    return trades_with_bias(part) or float(part.sigma.min()) < _ALIKE * float(part.sigma.max())


def _motion(part: Part, R_cam_imu: Floats | None) -> str:
    missing = one_direction(part)
    if part.kind == "time_shift":
        return "Turn the rig to and fro"
    if part.kind in ("rotation", "translation"):
        across = across_words(part.axes[:, 0], of_camera=part.of_camera)
        return (
            f"Turn {part.sensor} about its {across}"
            if missing and part.of_camera
            else f"Turn the rig about imu0's {across}"
            if missing
            else "Turn the rig about all three axes, and move it to and fro"
        )
    if part.kind == "gyroscope":
        return f"Turn the {'sensor' if R_cam_imu is None else 'rig'} about {_missing_axes(part, R_cam_imu)}"
    axis = f"the {imu_axis(part.axes[:, 0], R_cam_imu)}" if missing else "each axis of the IMU"
    return f"Tilt it so that {axis} points up, down and level"


def _missing_axes(part: Part, R_cam_imu: Floats | None) -> str:
    """Return the axes about which there was too little rotation."""
    if not one_direction(part):
        return "all three axes"
    if badly_known(part) == 2:
        best = part.axes[:, 2]
        if R_cam_imu is None:
            return f"its {across_words(best, of_camera=False)}"
        return f"the camera's {across_words(R_cam_imu @ best, of_camera=True)}"
    if R_cam_imu is None:
        return f"its {axis_words(part.axes[:, 0], of_camera=False)}"
    return f"the {imu_axis(part.axes[:, 0], R_cam_imu)}"


def badly_known(part: Part) -> int:
    """Return how many directions are about as badly known as the worst one."""
    return int(np.sum(part.sigma >= _ALIKE * part.sigma[0]))


def imu_axis(direction: Floats, R_cam_imu: Floats | None) -> str:
    """Return a direction in the body by the IMU's axes, and by the camera's where there is one."""
    words = f"IMU's {axis_words(direction, of_camera=False)}"
    seen = "" if R_cam_imu is None else axis_words(R_cam_imu @ direction, of_camera=True)
    if not seen or "diagonal" in words + seen:
        return words
    return f"{words} (the camera's {seen.replace(' (', ', ').rstrip(')')})"


def trades_with_bias(part: Part) -> bool:
    """Return whether an accelerometer's scale cannot be told from its bias: it was tilted too little."""
    return abs(part.bias_correlation) > _TRADES


OF_A_POSE: tuple[Kind, ...] = ("rotation", "translation", "time_shift")


def weak_subject(part: Part, *, several: bool) -> tuple[str, bool]:
    """Return what is hardly determined, and whether it is a plural; of `several` IMUs which one's it is."""
    whose = f" of {part.sensor}" if several else ""
    if part.kind in ("rotation", "translation"):
        return _pose_subject(part), False
    if part.kind == "time_shift":
        return f"The time shift of {part.sensor}", False
    if part.kind == "g_sensitivity":
        return f"The g-sensitivity of the gyroscope{whose}", False
    if trades_with_bias(part):
        axis = axis_words(part.axes[:, 0], of_camera=False).replace(" axis", "")
        return f"The {axis} scale of the accelerometer{whose}", False
    return f"The scales and axes of the {part.kind}{whose}", True


def _pose_subject(part: Part) -> str:
    """Return which part of a pose is hardly determined."""
    worst, count, of_camera = part.axes[:, 0], badly_known(part), part.of_camera
    subject = f"The {part.kind} of {part.sensor} against {'the IMU' if of_camera else 'imu0'}"
    if count == 3:
        return subject
    if part.kind == "rotation":
        return f"{subject} about {'the camera' if of_camera else 'imu0'}'s {axis_words(worst, of_camera=of_camera)}"
    two = across_words(part.axes[:, 2], of_camera=of_camera)
    return f"{subject} along {_its(part)} {two if count == 2 else axis_words(worst, of_camera=of_camera)}"


def _its(part: Part) -> str:
    """Return whose axes the directions of a pose are named by."""
    return "its" if part.of_camera else "imu0's"


def size_words(part: Part) -> str:
    """Return the sigma of the worst direction with its unit."""
    sigma = float(part.sigma[0])
    if part.kind == "rotation":
        return f"{np.degrees(sigma):.2g} deg"
    if part.kind == "translation":
        return f"{1e3 * sigma:.3g} mm"
    if part.kind == "time_shift":
        return f"{1e3 * sigma:.2g} ms"
    return f"{sigma:.2g} rad/s per m/s^2" if part.kind == "g_sensitivity" else f"{100 * sigma:.2g} %"


def why_weak(part: Part, limit: float, duration_s: float, R_cam_imu: Floats | None) -> str:
    """Return why the worst direction of a part is not known to `limit`; arguments as of `motion_advice`."""
    seconds, as_before = seconds_more(part, limit, duration_s)
    if as_before and duration_text(seconds):
        return "the recording is short"
    if part.kind in OF_A_POSE:
        return _pose_reason(part)
    return _imu_reason(part, R_cam_imu)


def _pose_reason(part: Part) -> str:
    if part.kind == "time_shift":
        return "the rig turned and moved too little, or too slowly"
    if not one_direction(part):
        return f"the rig hardly {'turned' if part.kind == 'translation' else 'moved'}"
    across = f"{_its(part)} {across_words(part.axes[:, 0], of_camera=part.of_camera)}"
    if part.kind == "translation":
        return f"rotation about {across} is missing"
    return f"rotation about {across}, and acceleration along them, are missing"


def _imu_reason(part: Part, R_cam_imu: Floats | None) -> str:
    count, axis = badly_known(part), imu_axis(part.axes[:, 0], R_cam_imu)
    if part.kind == "gyroscope":
        only = imu_axis(part.axes[:, 2], R_cam_imu)
        words = {1: f"rotation about the {axis} is missing", 2: f"it turned about one axis only, the {only}"}
        return words.get(count, "it hardly turned")
    if trades_with_bias(part):
        return "it trades with its bias, since it was hardly tilted"
    return f"the force {'that it felt' if count == 3 else f'along the {axis}'} hardly changed"
