"""From the estimated scalars to what a calibration publishes, with the covariance of all of it."""

from collections.abc import Sequence

import numpy as np

from ....frozen import value_class
from ....geometry.rotation_vector import skew
from ....models.matrix_pattern import DIAGONAL, FULL, LOWER
from ....recording import Floats, Integers
from ....results.calibration import AccelerometerCalibration, CameraCalibration, GyroscopeCalibration, ImuCalibration
from ....results.parameters import covariance_names
from ....results.trust import SigmaRatio, Splits, Trust
from ...trust.changes import estimates_are_judged, parameter_changes
from ...trust.clusters import robust_variances
from ...trust.parts import Split, part_agreement, part_differences
from ..parameters import CameraParameters, ImuParameters, RigParameters
from .uncertainty import TimeClusters, Uncertainty, with_uncertain_gravity

_IMU_SCALARS = 33
_BIASES = 6
_POSE_AND_CLOCK = (*(f"T_imu_body.{part}[{k}]" for part in ("rotation", "translation") for k in range(3)), "time_shift")
_LABELS = {
    "halves": ("first half", "second half"),
    "thirds": ("first third", "second third", "last third"),
}
_SHORTEST_PART_S = 5.0
"""A shorter part determines too little for itself."""


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
