"""From the estimated scalars to what a calibration publishes, with the covariance of all of it.

First, the points of the IMUs to which their poses refer: those where a model with one place for each IMU finds itself.
With other lever arms a, held in the model, the rest of the estimate would go K da, K = -C_nn^-1 C_na of the normal
equations, whatever is known of the arms beforehand (`models.origin.Origin`). The point whose translation does not move
with them is p*. It is known when everything is estimated: until then the origin is that which the options ask for, or
the mean of `EVEN_WEIGHTS`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import skew
from ....models.forms import DIAGONAL, FULL, LOWER
from ....models.origin import EVEN_WEIGHTS, Origin
from ....recording import Floats, Integers
from ....results.calibration import AccelerometerCalibration, CameraCalibration, GyroscopeCalibration, ImuCalibration
from ....results.sensors import covariance_names
from ....results.trust import SigmaRatio, Splits, Trust
from ...trust.changes import estimates_are_judged, parameter_changes
from ...trust.clusters import robust_variances
from ...trust.parts import Split, part_agreement, part_differences
from ..layout import BorderLayout
from ..parameters import CameraParameters, ImuParameters, RigParameters
from ..solution import Solution
from ..start.first_guess import fitted_splines
from ..trajectory import POSE, Bases, Trajectory
from .uncertainty import TimeClusters, Uncertainty

_IMU_SCALARS = 33
_BIASES = 6
_POSE_AND_CLOCK = (*(f"T_imu_body.{part}[{k}]" for part in ("rotation", "translation") for k in range(3)), "time_shift")
_LABELS = {
    "halves": ("first half", "second half"),
    "thirds": ("first third", "second third", "last third"),
}
_SHORTEST_PART_S = 5.0
"""A shorter part determines too little for itself."""

_PER_SPAN = 3
"""Instants in each span of the splines by which they follow the origin."""


@value_class
class _Shift:
    """How far an origin moves (3,) [m], IMU's axes, and its derivative (3, 6) by the lever arms."""

    by: Floats
    by_arms: Floats

    @classmethod
    def between(cls, imu: ImuParameters, origin: Origin) -> "_Shift":
        """Return that from the present origin of an IMU to another one."""
        weights = origin.combination[0]
        return cls(by=origin.of(imu.places), by_arms=np.hstack(list(weights)) @ imu.places_by_arms.reshape(9, 6))


def single_place_origins(solution: Solution) -> list[Origin]:
    """Return p* of each IMU, where the translations do not move with its lever arms.

    Of the body's, that is the mean over the cameras, weighed by how well each is known. Where a translation is not
    known, but for its weak prior, p* has the `EVEN_WEIGHTS`.
    """
    layout, parameters = solution.layout, solution.state.parameters
    even = Origin(point="optimal")
    origins: list[Origin] = []
    for i, imu in enumerate(parameters.imus):
        by_arms, covariance = _by_arms(solution, i)
        own = _Shift.between(imu, even)
        if i:
            step = (
                _beside_the_body(layout, imu, i, by_arms, _Shift.between(parameters.imus[0], origins[0])) - own.by_arms
            )
        else:
            step = -_mean_over_cameras(layout, parameters, by_arms, covariance, own)
        shares = np.stack([-step[:, :3] - step[:, 3:], step[:, :3], step[:, 3:]])
        origins.append(Origin(point="optimal", weights=EVEN_WEIGHTS + shares))
    return origins


def _by_arms(solution: Solution, imu: int) -> tuple[Floats, Floats]:
    """Return how the estimate follows the lever arms of an IMU, (p, 6), and its covariance (p, p) with these held."""
    layout, schur = solution.layout, solution.step.factor.schur
    arms = layout.columns[f"imu{imu}.lever_arms"]
    kept = np.setdiff1d(layout.free_index, np.arange(arms.start, arms.stop))
    scale = 1 / np.sqrt(np.maximum(np.diag(schur)[kept], 1e-300))
    inverse = np.linalg.inv(schur[np.ix_(kept, kept)] * np.outer(scale, scale)) * np.outer(scale, scale)
    covariance, by_arms = np.zeros_like(schur), np.zeros((len(schur), 6))
    covariance[np.ix_(kept, kept)] = inverse
    by_arms[kept] = -inverse @ schur[kept, arms]
    return by_arms, covariance


def _beside_the_body(layout: BorderLayout, imu: ImuParameters, number: int, by_arms: Floats, body: _Shift) -> Floats:
    """Return how the place of an IMU beside the first, whose origin is at p*, goes with its arms, (3, 6), its axes."""
    columns, turn, arms = (
        layout.get(name)
        for name in (f"imu{number}.T_imu_body.translation", f"imu{number}.T_imu_body.rotation", "imu0.lever_arms")
    )
    place, turned, moved = (
        np.zeros((size, 6)) if at is None else by_arms[at] for at, size in ((columns, 3), (turn, 3), (arms, 6))
    )
    return place + imu.R_imu_body @ (body.by_arms @ moved - skew(body.by) @ turned)


def _mean_over_cameras(
    layout: BorderLayout, parameters: RigParameters, by_arms: Floats, covariance: Floats, own: _Shift
) -> Floats:
    """Return how the origin goes with the arms of the body as the cameras see it, (3, 6), the body's axes."""
    total, right = np.zeros((3, 3)), np.zeros((3, 6))
    for entry in parameters.cameras:
        columns, turn = (layout.get(f"{entry.name}.T_cam_imu.{part}") for part in ("translation", "rotation"))
        if columns is None or not np.diag(covariance)[columns].all():
            continue
        R = entry.R_cam_imu
        turned = by_arms[turn] if turn is not None else np.zeros((3, 6))
        precision = R.T @ np.linalg.inv(covariance[columns, columns]) @ R
        total += precision
        right += precision @ (R.T @ by_arms[columns] + own.by_arms - skew(own.by) @ turned)
    return np.linalg.inv(total) @ right if total.any() else right


def moved_to_origins(solution: Solution, found: Uncertainty, origins: Sequence[Origin]) -> tuple[Solution, Uncertainty]:
    """Return the same estimate with the origins of the IMUs at other points, trajectory and uncertainty too.

    As `parameters.moved_to_origin` does with what is published. Residuals stay as they are, but for the gyroscope's
    g-sensitivity, which acts on the specific force at the origin: some 1e-6 rad/s.
    """
    parameters = solution.state.parameters
    shifts = [_Shift.between(imu, origin) for imu, origin in zip(parameters.imus, origins, strict=True)]
    jacobian, body = np.eye(len(found.covariance)), shifts[0]
    place = {name: k for k, name in enumerate(found.names)}

    def follow(path: str, rotation: Floats, shift: _Shift, imu: int) -> None:
        """Fill in that the translation of a pose goes with a shift of the origin of an IMU, turned by a rotation."""
        rows = [place.get(f"{path}.translation[{k}]") for k in range(3)]
        arms = [(f"imu{imu}.lever_arms[{k}]", rotation @ shift.by_arms[:, k]) for k in range(6)]
        turns = [(f"{path}.rotation[{k}]", -rotation @ skew(shift.by)[:, k]) for k in range(3)] if imu == 0 else []
        for name, column in (*arms, *turns):
            for row, value in zip(rows, column.tolist(), strict=True):
                if row is not None and name in place:
                    jacobian[row, place[name]] += value

    cameras, imus = list(parameters.cameras), list(parameters.imus)
    for i, entry in enumerate(cameras):
        follow(f"{entry.name}.T_cam_imu", entry.R_cam_imu, body, 0)
        cameras[i] = replace(entry, p_cam_imu=entry.p_cam_imu + entry.R_cam_imu @ body.by)
    for i, (imu, origin) in enumerate(zip(imus, origins, strict=True)):
        imus[i] = replace(imu, origin=origin)
        if i:
            follow(f"imu{i}.T_imu_body", imu.R_imu_body, body, 0)
            follow(f"imu{i}.T_imu_body", -np.eye(3), shifts[i], i)
            imus[i] = replace(imus[i], p_imu_body=imu.p_imu_body + imu.R_imu_body @ body.by - shifts[i].by)
    state = replace(
        solution.state,
        parameters=replace(parameters, imus=tuple(imus), cameras=tuple(cameras)),
        trajectory=_moved_trajectory(solution.state.trajectory, body.by),
    )
    by_time = found.by_time
    return replace(solution, state=state), replace(
        found,
        covariance=jacobian @ found.covariance @ jacobian.T,
        ordinary=jacobian @ found.ordinary @ jacobian.T,
        held={name: replace(one, by_unit=one.by_unit @ jacobian.T) for name, one in found.held.items()},
        by_time=None if by_time is None else replace(by_time, scalars=jacobian @ by_time.scalars),
    )


def _moved_trajectory(trajectory: Trajectory, shift: Floats) -> Trajectory:
    """Return the trajectory of the point that lies at a shift (3,) [m], body's axes."""
    grid, controls = trajectory.grid, trajectory.controls.copy()
    if not shift.any():
        return trajectory
    for segment in grid.segments:
        position = (np.arange(_PER_SPAN * segment.spans) + 0.5) / _PER_SPAN
        places = grid.places(segment.start_s + grid.spacing_s * position)
        moved = trajectory.motion(places, Bases.at(places, grid)).R @ shift
        rows = slice(segment.first, segment.first + segment.spans + grid.order - 1)
        controls[rows, 3:POSE] += fitted_splines(position, moved, segment.spans, grid.order)
    return replace(trajectory, controls=controls)


@value_class
class PublishedRig:
    """IMUs and cameras.

    Attributes
    ----------
    covariance : of all their scalars, in the order of `covariance_names`
    ordinary : the same for independent errors
    jacobian : of these scalars by the free ones and the means of the biases
    """

    imus: dict[str, ImuCalibration]
    cameras: dict[str, CameraCalibration]
    covariance: Floats
    ordinary: Floats
    jacobian: Floats


_GRAVITY = "gravity.magnitude"


def with_uncertain_gravity(found: Uncertainty, gravity_sigma: float, *, ordinary: bool = False) -> Floats:
    """Return the covariance, or that for independent errors, with the uncertainty of held gravity added."""
    covariance = found.ordinary if ordinary else found.covariance
    if _GRAVITY not in found.held or not np.isfinite(gravity_sigma):
        return covariance
    influence = found.held[_GRAVITY].by_unit[0]
    return covariance + np.outer(influence, influence) * gravity_sigma**2


def publish_rig(found: Uncertainty, parameters: RigParameters, gravity_sigma: float) -> PublishedRig:
    """Return what the estimate says, each IMU in its own frame "accel-x".

    Parameters
    ----------
    found : covariance of the free scalars and of the bias means
    parameters : estimate
    gravity_sigma : standard deviation of the magnitude of gravity, which was held [m/s^2]
    """
    column = {name: i for i, name in enumerate(found.names)}
    both = [with_uncertain_gravity(found, gravity_sigma, ordinary=ordinary) for ordinary in (False, True)]
    width = len(both[0])
    rows: list[Floats] = []
    imus: dict[str, ImuCalibration] = {}
    for i, imu in enumerate(parameters.imus):
        bias = found.bias_mean[i]
        has_arms, has_shift = (_has(imu, i, column, block) for block in ("lever_arms", "accelerometer_shift"))
        imus[f"imu{i}"] = ImuCalibration(
            accelerometer=AccelerometerCalibration(
                sensitivity=imu.accelerometer_sensitivity,
                bias=bias[3:],
                unit="m/s^2",
                lever_arms_m=imu.places if has_arms else None,
                time_shift_s=imu.accelerometer_shift_s if has_shift else None,
            ),
            gyroscope=GyroscopeCalibration(
                sensitivity=imu.gyroscope_sensitivity, bias=bias[:3], g_sensitivity=imu.B_g, unit="rad/s"
            ),
            T_imu_body=imu.T_imu_body if i else None,
            origin=imu.origin,
            time_shift_s=imu.time_shift_s + imu.epoch_s if i else 0.0,
        )
        rows.append(_imu_rows(imu, i, column, width, len(found.names) + _BIASES * i))
        if has_arms:
            rows.append(_lever_arm_rows(imu, i, column, width))
        names = [*(_POSE_AND_CLOCK if i else ()), *(["accelerometer_shift"] if has_shift else [])]
        rows.append(_same(f"imu{i}", names, column, width))
    calibrated: dict[str, CameraCalibration] = {}
    for entry in parameters.cameras:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = entry.R_cam_imu, entry.p_cam_imu
        calibrated[entry.name] = CameraCalibration(
            T_cam_body=T, time_shift_cam_imu=entry.time_shift_s, camera=entry.camera
        )
        rows.append(_camera_rows(entry, column, width))
    jacobian = np.concatenate(rows)
    covariance, ordinary = (jacobian @ inner @ jacobian.T for inner in both)
    return PublishedRig(
        imus=imus,
        cameras=calibrated,
        covariance=0.5 * (covariance + covariance.T),
        ordinary=0.5 * (ordinary + ordinary.T),
        jacobian=jacobian,
    )


def _imu_rows(imu: ImuParameters, index: int, column: dict[str, int], width: int, biases: int) -> Floats:
    """Return the derivative of the published scalars of an IMU, (33, width)."""
    rows = np.zeros((_IMU_SCALARS, width))
    S_a, M_a = DIAGONAL.matrix(imu.S_a), LOWER.matrix(imu.M_a)
    S_g, M_g = DIAGONAL.matrix(imu.S_g), LOWER.matrix(imu.M_g)

    def put(start: int, block: str, derivatives: list[Floats]) -> None:
        for k, derivative in enumerate(derivatives):
            at = column.get(f"imu{index}.{block}[{k}]")
            if at is not None:
                rows[start : start + 9, at] = derivative.ravel()

    units = [_unit(i, j) for i, j in FULL.entries]
    put(0, "S_a", [_unit(i, j) @ M_a for i, j in DIAGONAL.entries])
    put(0, "M_a", [S_a @ _unit(i, j) for i, j in LOWER.entries])
    rows[9:12, biases + 3 : biases + 6] = np.eye(3)
    put(12, "S_g", [_unit(i, j) @ M_g @ imu.C_bg.T for i, j in DIAGONAL.entries])
    put(12, "M_g", [S_g @ _unit(i, j) @ imu.C_bg.T for i, j in LOWER.entries])
    put(12, "q_bg", [-S_g @ M_g @ skew(axis) @ imu.C_bg.T for axis in np.eye(3)])
    rows[21:24, biases : biases + 3] = np.eye(3)
    put(24, "B_g", units)
    return rows


def _has(imu: ImuParameters, index: int, column: dict[str, int], block: str) -> bool:
    """Tell whether the accelerometers of an IMU are taken to sit at different points, or to have their own delay."""
    if any(name.partition("[")[0] == f"imu{index}.{block}" for name in column):
        return True
    return bool(imu.lever_arms.any()) if block == "lever_arms" else imu.apart or imu.accelerometer_shift_s != 0


def _lever_arm_rows(imu: ImuParameters, index: int, column: dict[str, int], width: int) -> Floats:
    """Return the derivative of the accelerometers' places, (9, width)."""
    return imu.places_by_arms.reshape(9, 6) @ _same(
        f"imu{index}", [f"lever_arms[{k}]" for k in range(6)], column, width
    )


def _unit(i: int, j: int) -> Floats:
    matrix = np.zeros((3, 3))
    matrix[i, j] = 1.0
    return matrix


def _camera_rows(entry: CameraParameters, column: dict[str, int], width: int) -> Floats:
    lens = entry.camera
    names = [f"T_cam_imu.rotation[{k}]" for k in range(3)] + [f"T_cam_imu.translation[{k}]" for k in range(3)]
    names += ["time_shift_cam_imu", "line_delay"]
    names += [f"intrinsics[{k}]" for k in range(len(lens.intrinsics))]
    coeffs = len(lens.distortion_coeffs)
    names += ["distortion_coeffs"] if coeffs == 1 else [f"distortion_coeffs[{k}]" for k in range(coeffs)]
    return _same(entry.name, names, column, width)


def _same(sensor: str, names: Sequence[str], column: dict[str, int], width: int) -> Floats:
    """Return the derivative of scalars that are published as they are estimated, (n, width)."""
    rows = np.zeros((len(names), width))
    for row, name in enumerate(names):
        at = column.get(f"{sensor}.{name}")
        if at is not None:
            rows[row, at] = 1.0
    return rows


def recording_trust(result: PublishedRig, found: Uncertainty) -> Trust:
    """Return what the recording tells of the uncertainty of what is published."""
    names = np.array(covariance_names(result.imus, result.cameras))
    estimated = np.diag(result.ordinary) > 0
    sigma, ordinary = (np.sqrt(np.diag(covariance)) for covariance in (result.covariance, result.ordinary))
    paths = [name.partition("[")[0] for name in names.tolist()]
    blocks = {path: np.flatnonzero(estimated & (np.array(paths) == path)) for path in dict.fromkeys(paths)}
    blocks = {path: members for path, members in blocks.items() if len(members)}
    by_time = found.by_time
    return Trust(
        clusters=None if by_time is None else by_time.clusters,
        names=tuple(names[estimated].tolist()),
        ordinary_sigma=ordinary[estimated],
        sigma=sigma[estimated],
        ratios=tuple(
            SigmaRatio(block=path, ratio=float(np.sqrt(np.mean((sigma[members] / ordinary[members]) ** 2))))
            for path, members in blocks.items()
        ),
        splits=None
        if by_time is None or not estimates_are_judged()
        else _splits(by_time, result.jacobian, names, blocks),
        changes=()
        if by_time is None
        else parameter_changes(by_time.stretches, result.jacobian @ by_time.scalars, names.tolist(), judged=estimated),
    )


def _splits(by_time: TimeClusters, jacobian: Floats, names: np.ndarray, blocks: dict[str, Integers]) -> Splits | None:
    """Compare halves and thirds in everything but the biases, which wander indeed."""
    compared = {path: members for path, members in blocks.items() if not path.endswith(".bias")}
    counts = np.zeros(len(names), dtype=bool)
    counts[np.concatenate([np.zeros(0, np.int64), *compared.values()])] = True
    since = by_time.stretches.t_s - by_time.stretches.t_s[0]
    share = since / (since[-1] + since[1])
    splits = [
        Split(name=name, part=np.floor(len(labels) * share).astype(np.int64), labels=labels, counts=counts)
        for name, labels in _LABELS.items()
        if since[-1] > len(labels) * _SHORTEST_PART_S
    ]
    if not splits or not counts.any():
        return None
    scalars = jacobian @ by_time.scalars
    number = np.unique([name.partition("[")[0] for name in names], return_inverse=True)[1].astype(np.int64)
    wider = robust_variances(by_time.phases, scalars, number, many=True)
    found = part_differences(by_time.stretches, scalars, wider, splits)
    return part_agreement(found, splits, tuple(names.tolist()), compared) if len(found) else None
