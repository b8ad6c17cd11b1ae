"""Along which directions the parts of a calibration are known well or badly, and how to say that in motions.

A part is what one kind of motion determines: where a camera sits, how a gyroscope answers to rotations about an axis,
how an accelerometer answers to forces along one. Its directions are the principal axes of its covariance.
"""

from collections.abc import Iterator, Mapping
from math import ceil, isfinite, sqrt
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..recording import Floats, Integers
from ..results.parameters import calibration_parameters, covariance_names
from ..results.sensors import CameraCalibration, ImuCalibration

Kind = Literal["rotation", "translation", "time_shift", "gyroscope", "g_sensitivity", "accelerometer"]

_CAMERA_AXES = ("x axis (right)", "y axis (down)", "optical axis")
_IMU_AXES = ("x axis", "y axis", "z axis")
_VECTORS: tuple[Kind, Kind] = ("rotation", "translation")
_SHIFTS = {"T_cam_imu": "time_shift_cam_imu", "T_imu_body": "time_shift_imu"}
"""Name of a pose -> that of the time shift of the same sensor."""

_IMU_MATRICES: dict[Kind, str] = {
    "gyroscope": "gyroscope.sensitivity",
    "g_sensitivity": "gyroscope.g_sensitivity",
    "accelerometer": "accelerometer.sensitivity",
}
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


@value_class
class Relative:
    """Scalars of a calibration in SI units, of sensors relative to the size of their sensitivity.

    Attributes
    ----------
    names : (n,) as in `Covariance.names`
    covariance : (n, n)
    """

    names: tuple[str, ...]
    covariance: Floats


def relative_covariance(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration], covariance: Floats
) -> Relative:
    """Return the covariance (n, n) of sensors and cameras, whatever the unit of their measurements.

    A row of a sensitivity becomes relative to its length, a bias that of specific force [m/s^2], angular rate [rad/s]
    or field, and the g-sensitivity that of a gyroscope in rad/s.
    """
    names = covariance_names(imus, cameras)
    factor = np.ones(len(names))
    start = 0
    for path, value in calibration_parameters(imus, cameras):
        sensor, _, rest = path.partition(".")
        triad, _, parameter = rest.partition(".")
        if sensor in imus and parameter in ("sensitivity", "bias", "g_sensitivity"):
            matrix = getattr(imus[sensor], triad).sensitivity
            by_row = 1 / np.linalg.norm(matrix, axis=1)
            factor[start : start + value.size] = np.repeat(by_row, value.size // 3)
        start += value.size
    return Relative(names=names, covariance=covariance * np.outer(factor, factor))


def estimated_parts(names: tuple[str, ...], covariance: Floats, R_sensor_body: Mapping[str, Floats]) -> Iterator[Part]:
    """Yield the parts of which anything was estimated.

    Parameters
    ----------
    names : (n,) scalars as in `Covariance.names`
    covariance : (n, n), of matrices relative to the size of their rows
    R_sensor_body : of cameras, and of IMUs beside the body, "cam0" -> (3, 3)
    """
    column = {name: i for i, name in enumerate(names)}
    for sensor, R in R_sensor_body.items():
        of_imu = sensor.startswith("imu")
        link = "T_imu_body" if of_imu else "T_cam_imu"
        for kind in _VECTORS:
            index = _index(column, [f"{sensor}.{link}.{kind}[{k}]" for k in range(3)])
            if index is not None and covariance[index, index].any():
                # the rotation's perturbation is in the body's axes, the translation in those of the sensor
                turn = np.eye(3)
                if of_imu != (kind == "rotation"):
                    turn = R.T if of_imu else R
                yield _vector_part(kind, sensor, index, covariance, turn)
        shift = column.get(f"{sensor}.{_SHIFTS[link]}")
        if shift is not None and covariance[shift, shift] > 0:
            yield Part(
                kind="time_shift",
                sensor=sensor,
                index=np.array([shift]),
                axes=np.eye(3),
                sigma=np.full(3, sqrt(covariance[shift, shift])),
                places=np.ones((3, 1)),
            )
    for sensor in dict.fromkeys(name.partition(".")[0] for name in names if name.startswith("imu")):
        for kind, path in _IMU_MATRICES.items():
            index = _index(column, [f"{sensor}.{path}[{i},{j}]" for i in range(3) for j in range(3)])
            if index is not None and covariance[index, index].any():
                bias = _index(column, [f"{sensor}.accelerometer.bias[{i}]" for i in range(3)])
                yield _matrix_part(kind, sensor, index, covariance, bias if kind == "accelerometer" else None)


def _index(column: Mapping[str, int], wanted: list[str]) -> Integers | None:
    return np.array([column[name] for name in wanted]) if all(name in column for name in wanted) else None


def _vector_part(kind: Kind, sensor: str, index: Integers, covariance: Floats, turn: Floats) -> Part:
    own = turn @ covariance[np.ix_(index, index)] @ turn.T
    variance, axes = np.linalg.eigh(own)
    axes = axes[:, ::-1]
    sigma = np.sqrt(np.maximum(variance[::-1], 0.0))
    return Part(kind=kind, sensor=sensor, index=index, axes=axes, sigma=sigma, places=axes.T @ turn)


def _matrix_part(kind: Kind, sensor: str, index: Integers, covariance: Floats, bias: Integers | None) -> Part:
    """Return the part of a matrix: a direction e is as badly known as the matrix' answer to it, over all rows."""
    own = covariance[np.ix_(index, index)].reshape(3, 3, 3, 3)
    variance, axes = np.linalg.eigh(np.einsum("iaib->ab", own))
    axes = axes[:, ::-1]
    places: list[Floats] = []
    for e in axes.T:
        rows = np.linalg.eigh(np.einsum("iajb,a,b->ij", own, e, e))[1][:, -1]
        places.append(np.outer(rows, e).ravel())
    correlation = 0.0
    if bias is not None:
        answer = np.kron(np.eye(3), axes[:, 0])  # of each row to the worst direction
        joint = answer @ covariance[np.ix_(index, bias)]
        size = np.sqrt(np.einsum("ij,jk,ik->i", answer, covariance[np.ix_(index, index)], answer))
        spread = size * np.sqrt(covariance[bias, bias])
        worst = int(np.argmax(size))
        correlation = float(joint[worst, worst] / spread[worst]) if spread[worst] > 0 else 0.0
    return Part(
        kind=kind,
        sensor=sensor,
        index=index,
        axes=axes,
        sigma=np.sqrt(np.maximum(variance[::-1], 0.0)),
        places=np.array(places),
        bias_correlation=correlation,
    )


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
