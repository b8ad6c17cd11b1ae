"""Observability in words: what a recording hardly determines, named as motions and parameters.

The covariance is looked at in two units: that of the weak prior, which tells whether anything but the prior determines
a direction, and that of what any use needs, beyond which a direction is worth a word.
"""

from collections.abc import Iterator, Mapping
from dataclasses import field

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from ..results.sensors import CameraCalibration, ImuCalibration
from ..results.trust import WeakDirection
from .directions import (
    Kind,
    Part,
    across_words,
    axis_words,
    badly_known,
    duration_text,
    estimated_parts,
    imu_axis,
    motion_advice,
    one_direction,
    relative_covariance,
    seconds_more,
    trades_with_bias,
)

HELD = 0.3
"""Share of its weak prior's sigma from which on a direction counts as not determined by the recording."""

LIMITS: dict[Kind, float] = {
    "rotation": np.radians(1.0),
    "translation": 0.05,
    "time_shift": 5e-3,
    "gyroscope": 0.02,
    "g_sensitivity": 2e-3,
    "accelerometer": 0.02,
}
"""Standard deviations [SI, matrices relative] that serve no use."""

_CAMERA_IMU_PRIORS = {
    "accelerometer.sensitivity": 0.1,
    "accelerometer.bias": 10.0,
    "gyroscope.sensitivity": 0.2,
    "gyroscope.bias": 1.0,
    "gyroscope.g_sensitivity": 0.02,
    "T_cam_imu.rotation": 1.0,
    "T_cam_imu.translation": 1.0,
    "time_shift_cam_imu": 0.1,
    "T_imu_body.rotation": 1.0,
    "T_imu_body.translation": 1.0,
    "time_shift_imu": 0.1,
    "accelerometer.time_shift": 0.1,
    "line_delay": 1e-4,
    "intrinsics": 20.0,
}
"""Weak priors of `estimate.camera_imu.parameters.blocks`, by what is published."""

_IMU_PRIORS = {
    "accelerometer.sensitivity": 0.3,
    "accelerometer.bias": 3.0,
    "gyroscope.sensitivity": 0.3,
    "gyroscope.bias": 1.0,
    "gyroscope.g_sensitivity": 0.01,
}
"""Weak priors of `estimate.multiposition.fit.weak_prior_sigma`, likewise."""

_MOST_SHARES = 6
_THROUGH = 0.8
"""Share of its variance from which on a coordinate is said to be known only through the lens."""

_OF_A_POSE: tuple[Kind, ...] = ("rotation", "translation", "time_shift")

_FOCAL, _PRINCIPAL = "focal length", "principal point"


@value_class
class AvailableInformation:
    """What a recording and priors know of a calibration.

    Attributes
    ----------
    names : (n,) scalars as in `Covariance.names`
    covariance : (n, n), of matrices relative to the size of their rows; zero where a scalar was held
    prior_sigma : (n,) of the priors; infinite where there is none
    weak : (n,) bool, whether the prior is only there to keep what is not determined from running away
    R_cam_imu : "cam0" -> (3, 3)
    duration_s : of the recording; nan where its length says nothing
    R_imu_body : of the IMUs beside the body, "imu1" -> (3, 3)
    """

    names: tuple[str, ...]
    covariance: Floats
    prior_sigma: Floats
    weak: np.ndarray
    R_cam_imu: Mapping[str, Floats]
    duration_s: float = float("nan")
    R_imu_body: Mapping[str, Floats] = field(default_factory=dict[str, Floats])

    def main_camera(self, part: Part) -> Floats | None:
        """Return the axes of the first camera against those of a part, (3, 3), or None without a camera."""
        first = next(iter(self.R_cam_imu.values()), None)
        own = self.R_imu_body.get(part.sensor)
        return first if first is None or own is None or part.kind in _OF_A_POSE else first @ own.T


def known_of(
    imus: Mapping[str, ImuCalibration],
    cameras: Mapping[str, CameraCalibration],
    covariance: Floats,
    *,
    stated: Mapping[str, float] | None = None,
    duration_s: float = float("nan"),
) -> AvailableInformation:
    """Return what is known of published sensors.

    Parameters
    ----------
    imus, cameras : by name
    covariance : (n, n) in the order of `covariance_names`
    stated : names of scalars, or of all below a path, of which something was stated beforehand -> standard deviation
    duration_s : of the recording; nan where its length says nothing
    """
    found = relative_covariance(imus, cameras, covariance)
    priors = _CAMERA_IMU_PRIORS if cameras else _IMU_PRIORS
    sigma, weak = np.full(len(found.names), np.inf), np.ones(len(found.names), dtype=bool)
    for i, name in enumerate(found.names):
        path = name.partition(".")[2].partition("[")[0]
        sigma[i] = priors.get(path, np.inf)
        for text, size in (stated or {}).items():
            if name == text or name.startswith((f"{text}[", f"{text}.")):
                sigma[i], weak[i] = size, False
    return AvailableInformation(
        names=found.names,
        covariance=found.covariance,
        prior_sigma=sigma,
        weak=weak,
        R_cam_imu={name: camera.T_cam_imu[:3, :3] for name, camera in cameras.items()},
        duration_s=duration_s,
        R_imu_body={name: imu.T_imu_body[:3, :3] for name, imu in imus.items() if imu.T_imu_body is not None},
    )


def weak_directions(known: AvailableInformation, limits: Mapping[Kind, float] = LIMITS) -> tuple[WeakDirection, ...]:
    """Return the directions that a recording hardly determines, the weakest first.

    Parameters
    ----------
    known : what it and priors know
    limits : standard deviations beyond which a direction is worth a word, such as what a use needs
    """
    found = [
        *(_weak(known, part, limits.get(part.kind, np.inf)) for part in _parts(known)),
        *_through_lens(known),
    ]
    return tuple(sorted((weak for weak in found if weak is not None), key=lambda weak: weak.determined))


def _parts(known: AvailableInformation) -> Iterator[Part]:
    return estimated_parts(known.names, known.covariance, {**known.R_cam_imu, **known.R_imu_body})


def _weak(known: AvailableInformation, part: Part, limit: float) -> WeakDirection | None:
    held = bool(part.sigma[0] > HELD * _prior_along(known, part))
    if part.sigma[0] <= limit and not held:
        return None
    limit = min(limit, LIMITS[part.kind])
    prior = _prior_along(known, part)
    subject, plural = _subject(part, several=bool(known.R_imu_body))
    if held:
        known_how = f"{'are' if plural else 'is'} not known"
    else:
        known_how = f"{'are' if plural else 'is'} known to {_size(part)} only"
    return WeakDirection(
        shares=_shares(known, part),
        determined=float(np.clip(1 - (part.sigma[0] / prior) ** 2, 0.0, 1.0)),
        words=f"{subject} {known_how}: {_reason(known, part, limit)}.",
        cure=motion_advice(part, limit, known.duration_s, known.main_camera(part)),
        held=held,
    )


def _prior_along(known: AvailableInformation, part: Part) -> float:
    """Return the prior's standard deviation of the worst direction, over all rows of a matrix."""
    sigma = np.where(known.weak[part.index], known.prior_sigma[part.index], np.inf)
    if len(part.index) == 9:
        rows = sigma.reshape(3, 3)
        rows = rows[np.isfinite(rows).all(axis=1)]
        return float(np.sqrt(np.sum(np.square(rows) @ np.square(part.axes[:, 0])))) or float("inf")
    return float(np.sqrt(np.sum((sigma * part.places[0]) ** 2))) if np.isfinite(sigma).all() else float("inf")


def _shares(known: AvailableInformation, part: Part) -> tuple[tuple[str, float], ...]:
    """Return how all scalars move along with the worst direction, in sigmas of what was assumed beforehand."""
    together = known.covariance[:, part.index] @ part.places[0]
    units = np.where(np.isfinite(known.prior_sigma), known.prior_sigma, np.inf)
    moved = together / units
    size = float(np.linalg.norm(moved))
    if size == 0:
        moved[part.index], size = part.places[0], 1.0
    order = np.argsort(-np.abs(moved))[:_MOST_SHARES]
    return tuple((known.names[i], float(moved[i] / size)) for i in order if moved[i])


def _subject(part: Part, *, several: bool) -> tuple[str, bool]:
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


def _size(part: Part) -> str:
    sigma = float(part.sigma[0])
    if part.kind == "rotation":
        return f"{np.degrees(sigma):.2g} deg"
    if part.kind == "translation":
        return f"{1e3 * sigma:.3g} mm"
    if part.kind == "time_shift":
        return f"{1e3 * sigma:.2g} ms"
    return f"{sigma:.2g} rad/s per m/s^2" if part.kind == "g_sensitivity" else f"{100 * sigma:.2g} %"


def _reason(known: AvailableInformation, part: Part, limit: float) -> str:
    seconds, as_before = seconds_more(part, limit, known.duration_s)
    if as_before and duration_text(seconds):
        return "the recording is short"
    if part.kind in _OF_A_POSE:
        return _pose_reason(part)
    return _imu_reason(part, known.main_camera(part))


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


def _through_lens(known: AvailableInformation) -> Iterator[WeakDirection]:
    """Yield directions of a camera's place that are known only as well as its lens was known beforehand."""
    column = {name: i for i, name in enumerate(known.names)}
    for camera in known.R_cam_imu:
        count = sum(name.startswith(f"{camera}.intrinsics[") for name in known.names)
        for words, axis, first, last in ((_FOCAL, 2, 4, 2), (_PRINCIPAL, 0, 2, 1), (_PRINCIPAL, 1, 1, 0)):
            lens = [column[f"{camera}.intrinsics[{k}]"] for k in range(count - first, count - last)]
            at = column.get(f"{camera}.T_cam_imu.translation[{axis}]")
            if count < 4 or at is None:
                continue
            weak = _known_through(known, camera, words, at, lens)
            if weak is not None:
                yield weak


def _known_through(
    known: AvailableInformation, camera: str, words: str, at: int, lens: list[int]
) -> WeakDirection | None:
    """Return the direction in which a coordinate of the camera (at) follows its lens, where only a prior knows that."""
    spread, prior = np.sqrt(np.diag(known.covariance)), known.prior_sigma
    lens = [i for i in lens if spread[i] > 0.5 * prior[i]]
    if not lens or not spread[at] > 0:
        return None
    joint = known.covariance[np.ix_(lens, lens)]
    follow = known.covariance[at, lens] @ np.linalg.solve(joint, known.covariance[lens, at])
    if follow < _THROUGH * known.covariance[at, at]:
        return None
    moved = known.covariance[:, at] / np.where(np.isfinite(prior), prior, np.inf)
    order = np.argsort(-np.abs(moved))[:_MOST_SHARES]
    size = float(np.linalg.norm(moved)) or 1.0
    axis = int(known.names[at].rpartition("[")[2].rstrip("]"))
    return WeakDirection(
        shares=tuple((known.names[i], float(moved[i] / size)) for i in order if moved[i]),
        determined=float(np.clip(1 - (spread[lens[0]] / prior[lens[0]]) ** 2, 0.0, 1.0)),
        words=f"The translation of {camera} along its {axis_words(np.eye(3)[axis], of_camera=True)} is known only "
        f"through the {words}: this recording tells that no better than it was known beforehand.",
        cure="Come nearer to the board, so that it fills the image, or calibrate the camera by itself and state its "
        "intrinsics.",
        held=True,
    )
