"""Observability: along which directions a calibration is known, and what the recording hardly determines.

The covariance is looked at in two units: that of the weak prior, which tells whether anything but the prior determines
a direction, and that of what any use needs, beyond which a direction is worth a word.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from math import sqrt

import numpy as np

from ..findings import Finding, make_finding
from ..frozen import value_class
from ..recording import Floats, Integers
from ..results.sensors import CameraCalibration, ImuCalibration, calibration_parameters, covariance_names
from ..results.trust import WeakDirection
from .directions import (
    OF_A_POSE,
    Kind,
    Part,
    axis_words,
    motion_advice,
    size_words,
    weak_subject,
    why_weak,
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
        return first if first is None or own is None or part.kind in OF_A_POSE else first @ own.T


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
    prior, camera = _prior_along(known, part), known.main_camera(part)
    subject, plural = weak_subject(part, several=bool(known.R_imu_body))
    if held:
        known_how = f"{'are' if plural else 'is'} not known"
    else:
        known_how = f"{'are' if plural else 'is'} known to {size_words(part)} only"
    return WeakDirection(
        shares=_shares(known, part),
        determined=float(np.clip(1 - (part.sigma[0] / prior) ** 2, 0.0, 1.0)),
        words=f"{subject} {known_how}: {why_weak(part, limit, known.duration_s, camera)}.",
        cure=motion_advice(part, limit, known.duration_s, camera),
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


PLACES_AND_CLOCKS = (".T_cam_imu.", ".time_shift_cam_imu", ".T_imu_body.", ".time_shift")
"""Parts of the names of scalars, as published and as estimated, that tell where and when a sensor is."""


_MAINLY = 0.3
"""Share from which on a direction is mainly one of a parameter."""


def weak_findings(weak: Sequence[WeakDirection], *, with_camera: bool) -> list[Finding]:
    """Return a finding for each weak direction, the weakest first.

    Without the place and the clock of its sensors a camera-IMU calibration is of no use, nor is that of an IMU alone
    without any of its triads.
    """
    findings: list[Finding] = []
    for one in weak:
        if not one.held:
            findings.append(make_finding("hardly-observable", words=one.words, cure=one.cure))
            continue
        vital = any(
            abs(share) > _MAINLY and any(part in name for part in PLACES_AND_CLOCKS) for name, share in one.shares
        )
        findings.append(
            make_finding(
                "not-observable/direction",
                severity="problem" if vital or not with_camera else "warning",
                words=one.words,
                cure=one.cure,
            )
        )
    return findings


_VECTORS: tuple[Kind, Kind] = ("rotation", "translation")
_SHIFTS = {"T_cam_imu": "time_shift_cam_imu", "T_imu_body": "time_shift_imu"}
"""Name of a pose -> that of the time shift of the same sensor."""


_IMU_MATRICES: dict[Kind, str] = {
    "gyroscope": "gyroscope.sensitivity",
    "g_sensitivity": "gyroscope.g_sensitivity",
    "accelerometer": "accelerometer.sensitivity",
}


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
