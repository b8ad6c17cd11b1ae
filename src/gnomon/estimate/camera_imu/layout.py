"""Which scalars are estimated: `BorderLayout` gives them, and those whose influence is wanted, columns in the border.

Rotations are perturbed on the right, and counted from where they started.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix, right_jacobian, rotation_from_rotvec, rotvec_from_rotation
from ...recording import Floats, Integers, KnownRig
from .parameters import OFFSETS, CameraParameters, ImuParameters, RigParameters

Status = Literal["estimated", "prior", "fixed"]

_IMU_ROTATIONS = ("q_bg", "T_imu_body.rotation")
_IMU_FIELDS = {
    "q_bg": "C_bg",
    "T_imu_body.rotation": "R_imu_body",
    "T_imu_body.translation": "p_imu_body",
    "time_shift": "time_shift_s",
    "accelerometer_shift": "accelerometer_shift_s",
}
"""Block of an IMU -> where `ImuParameters` holds it, unless under the same name."""


@value_class(eq=True)
class ParameterBlock:
    """Scalars that belong together.

    Attributes
    ----------
    name : such as "imu0.S_a"
    size : number of scalars
    weak_sigma : standard deviation of the prior that keeps what a recording does not determine from running away;
        does not move what it does
    unit : of the scalars
    pure : how many of them, the first, are pure numbers
    """

    name: str
    size: int
    weak_sigma: tuple[float, ...]
    unit: str
    pure: int = 0

    @property
    def units(self) -> list[str]:
        """Unit of each scalar."""
        return [""] * self.pure + [self.unit] * (self.size - self.pure)

    def scalars(self) -> list[str]:
        """Return the names of the scalars, such as "imu0.S_a[0]"; of a single one the block's name."""
        if self.size == 1:
            return [self.name]
        return [f"{self.name}[{i}]" for i in range(self.size)]


_IMU_BLOCKS = (
    ("S_a", 3, 0.1, ""),
    ("M_a", 3, 0.1, "rad"),
    ("S_g", 3, 0.1, ""),
    ("M_g", 3, 0.1, "rad"),
    ("q_bg", 3, 0.2, "rad"),
    ("B_g", 9, 0.02, "rad/s per m/s^2"),
)

_LEVER_ARMS = ("lever_arms", 6, 0.05, "m")
"""Weak prior of 5 cm: a sensor's case is not larger."""

_CHIP_M = 0.01
"""How far each accelerometer of an IMU is from some point between them, per axis, where nothing is known of it."""

_POSE_AND_CLOCK = (
    ("T_imu_body.rotation", 3, 1.0, "rad"),
    ("T_imu_body.translation", 3, 1.0, "m"),
    ("time_shift", 1, 0.1, "s"),
)
"""Of the IMUs beside the first, which is the body."""

_ACCELEROMETER_SHIFT = ("accelerometer_shift", 1, 0.1, "s")

_IMU_SCALARS = tuple(f"{name}[{i}]" for name, size, _, _ in _IMU_BLOCKS for i in range(size))

_LENS_SIGMA = {"projection": 0.1, "focal": 20.0, "principal": 20.0, "distortion": 0.1}


def parameter_blocks(parameters: RigParameters) -> tuple[ParameterBlock, ...]:
    """Return all blocks of scalars, in their order."""
    found = [
        ParameterBlock(name="gravity.direction", size=2, weak_sigma=(0.5,) * 2, unit="rad"),
        ParameterBlock(name="gravity.magnitude", size=1, weak_sigma=(0.05,), unit="m/s^2"),
        ParameterBlock(name="target.scale", size=1, weak_sigma=(0.1,), unit=""),
    ]
    for i in range(len(parameters.imus)):
        of_imu = (*_IMU_BLOCKS, _LEVER_ARMS, *(_POSE_AND_CLOCK if i else ()), _ACCELEROMETER_SHIFT)
        found += [
            ParameterBlock(name=f"imu{i}.{name}", size=size, weak_sigma=(sigma,) * size, unit=unit)
            for name, size, sigma, unit in of_imu
        ]
    for entry in parameters.cameras:
        name, lens = entry.name, entry.camera
        sigmas = tuple(_LENS_SIGMA[kind] for kind in lens.parameter_kinds)
        count = len(lens.intrinsics)
        found += [
            ParameterBlock(name=f"{name}.T_cam_imu.rotation", size=3, weak_sigma=(1.0,) * 3, unit="rad"),
            ParameterBlock(name=f"{name}.T_cam_imu.translation", size=3, weak_sigma=(1.0,) * 3, unit="m"),
            ParameterBlock(name=f"{name}.time_shift_cam_imu", size=1, weak_sigma=(0.1,), unit="s"),
            ParameterBlock(name=f"{name}.line_delay", size=1, weak_sigma=(1e-4,), unit="s"),
            ParameterBlock(name=f"{name}.exposure_squared", size=1, weak_sigma=(1e-2,), unit="s^2"),
            ParameterBlock(name=f"{name}.intrinsics", size=count, weak_sigma=sigmas[:count], unit="px", pure=count - 4),
        ]
        if len(sigmas) > count:
            found.append(
                ParameterBlock(
                    name=f"{name}.distortion_coeffs", size=len(sigmas) - count, weak_sigma=sigmas[count:], unit=""
                )
            )
    if parameters.board is not None:  # last: its columns are the wide part of the border
        size = parameters.board.offsets.size
        found.append(ParameterBlock(name=OFFSETS, size=size, weak_sigma=(parameters.board.sigma_m,) * size, unit="m"))
    return tuple(found)


def sensor_priors(parameters: RigParameters) -> Iterator[tuple[list[str], Floats, Floats]]:
    """Yield what is known of each sensor with an uncertainty: names (k), sigmas (k,) and correlation (k, k)."""
    sensors: list[tuple[list[str], Floats | None]] = [
        ([f"imu{i}.{name}" for name in _IMU_SCALARS], imu.covariance) for i, imu in enumerate(parameters.imus)
    ]
    # of differences to x, where the places of all three are independent
    arms = np.asarray(_CHIP_M**2 * np.kron([[2.0, 1.0], [1.0, 2.0]], np.eye(3)), dtype=np.float64)
    sensors += [([f"imu{i}.lever_arms[{k}]" for k in range(6)], arms) for i in range(len(parameters.imus))]
    if parameters.rig is not None:
        sensors.append(lenses_of(parameters.rig, parameters))
    else:
        sensors += [(entry.lens_names(), entry.lens_covariance) for entry in parameters.cameras]
    for names, covariance in sensors:
        if covariance is not None:
            sigma = np.sqrt(np.diag(covariance))
            known = np.flatnonzero(sigma)
            size = sigma[known]
            yield [names[i] for i in known], size, covariance[np.ix_(known, known)] / np.outer(size, size)


def lenses_of(rig: KnownRig, parameters: RigParameters) -> tuple[list[str], Floats]:
    """Return the names of the lenses' scalars that a rig knows, and their joint covariance."""
    wanted = {name for entry in parameters.cameras for name in entry.lens_names()}
    at = [i for i, name in enumerate(rig.names) if name in wanted]
    return [rig.names[i] for i in at], rig.covariance[np.ix_(at, at)]


@value_class
class BorderLayout:
    """Columns of the border.

    Attributes
    ----------
    columns : block name -> its columns, of the blocks that have any
    names, units : (p,) of the scalars
    free : (p,) bool, whether the scalar is estimated; the others' columns only tell what they would do
    prior_mean, prior_sigma : (p,) prior of the scalars, in the coordinates of `values`; infinite where there is none
    prior_information : (p, p) inverse of the priors' covariance
    weak : (p,) bool, whether the prior is only the weak one
    start : where the coordinates of rotations and directions are counted from, and the priors' means
    """

    columns: dict[str, slice]
    names: tuple[str, ...]
    units: tuple[str, ...]
    free: np.ndarray
    prior_mean: Floats
    prior_sigma: Floats
    prior_information: Floats
    weak: np.ndarray
    start: RigParameters

    def __len__(self) -> int:
        return len(self.names)

    @property
    def of_imu(self) -> np.ndarray:
        """Whether a scalar belongs to the errors of an IMU, not to its pose or its clocks, (p,) bool."""
        return np.array(
            [name.startswith("imu") and "T_imu_body" not in name and "_shift" not in name for name in self.names],
            dtype=bool,
        )

    @property
    def free_index(self) -> Integers:
        """Columns of the scalars that are estimated."""
        return np.flatnonzero(self.free)

    @property
    def dense(self) -> int:
        """Number of columns before those of the board's corners, which each row touches few of."""
        offsets = self.columns.get(OFFSETS)
        return len(self) if offsets is None else offsets.start

    def get(self, name: str) -> slice | None:
        """Return the columns of a block, or None where it has none."""
        return self.columns.get(name)

    def values(self, parameters: RigParameters) -> Floats:
        """Return the scalars (p,); of rotations and of gravity's direction the small angles from the start."""
        result = np.empty(len(self))
        for name, columns in self.columns.items():
            result[columns] = block_coordinates(name, parameters, self.start)
        return result

    def values_jacobian(self, parameters: RigParameters) -> Floats:
        """Return the derivative of `values` by a step of the scalars, (p, p)."""
        jacobian = np.eye(len(self))
        for name, columns in self.columns.items():
            block = _coordinates_jacobian(name, parameters, self.start)
            if block is not None:
                jacobian[columns, columns] = block
        return jacobian

    def plus(self, parameters: RigParameters, step: Floats) -> RigParameters:
        """Return parameters moved by a step (p,)."""
        moved = parameters
        for name, columns in self.columns.items():
            delta = step[columns]
            if delta.any():
                moved = _moved(name, moved, delta)
        return moved


def border_layout(
    start: RigParameters,
    status: dict[str, Status],
    prior_sigma: dict[str, float],
    consider: Sequence[str] = (),
) -> BorderLayout:
    """Return the columns for what is estimated.

    Parameters
    ----------
    start : start values, which priors are about
    status : scalar name -> "estimated" (weak prior), "prior" or "fixed"
    prior_sigma : scalar name -> standard deviation of a stated prior
    consider : blocks that get columns though they are not estimated, to see what they would do
    """
    columns: dict[str, slice] = {}
    names: list[str] = []
    units: list[str] = []
    sigma: list[float] = []
    weak: list[bool] = []
    for block in parameter_blocks(start):
        scalars = block.scalars()
        if block.name not in consider and all(status[name] == "fixed" for name in scalars):
            continue
        columns[block.name] = slice(len(names), len(names) + block.size)
        names += scalars
        units += block.units
        sigma += [prior_sigma.get(name, weak) for name, weak in zip(scalars, block.weak_sigma, strict=True)]
        weak += [name not in prior_sigma for name in scalars]
    draft = BorderLayout(
        columns=columns,
        names=tuple(names),
        units=tuple(units),
        free=np.array([status[name] != "fixed" for name in names], dtype=bool),
        prior_mean=np.zeros(len(names)),
        prior_sigma=np.array(sigma),
        prior_information=_information(start, names, np.array(sigma)),
        weak=np.array(weak, dtype=bool),
        start=start,
    )
    return replace(draft, prior_mean=draft.values(start))


def _information(start: RigParameters, names: list[str], sigma: Floats) -> Floats:
    """Return the inverse of the priors' covariance (p, p): what is known beforehand comes with its correlations."""
    information = np.diag(np.where(np.isfinite(sigma), sigma, np.inf) ** -2.0)
    column = {name: i for i, name in enumerate(names)}
    for known, size, correlation in sensor_priors(start):
        whole = np.linalg.inv(correlation) / np.outer(size, size)
        kept = [i for i, name in enumerate(known) if name in column and sigma[column[name]] == size[i]]
        at = [column[known[i]] for i in kept]
        information[np.ix_(at, at)] = whole[np.ix_(kept, kept)]
    if start.board is not None and (first := column.get(f"{OFFSETS}[0]")) is not None:
        information[first:, first:] += start.board.gauge_information()
    return information


def block_coordinates(name: str, parameters: RigParameters, start: RigParameters) -> Floats | float:
    """Return the scalars of a block; of rotations and of gravity's direction the small angles from the start."""
    owner, _, rest = name.partition(".")
    if name == "gravity.direction":
        return start.gravity_plane.T @ parameters.gravity_direction
    if name == OFFSETS:
        assert parameters.board is not None
        return parameters.board.offsets.ravel()
    if owner in ("gravity", "target"):
        return parameters.gravity_m_s2 if owner == "gravity" else parameters.target_scale
    if owner.startswith("imu"):
        index = int(owner[3:])
        return _imu_coordinates(rest, parameters.imus[index], start.imus[index])
    index = parameters.camera_index(owner)
    entry, lens = parameters.cameras[index], parameters.cameras[index].camera
    if rest == "T_cam_imu.rotation":
        return _turned(start.cameras[index].R_cam_imu, entry.R_cam_imu)
    values = {
        "T_cam_imu.translation": entry.p_cam_imu,
        "time_shift_cam_imu": entry.time_shift_s,
        "line_delay": lens.line_delay_s,
        "exposure_squared": entry.exposure_s2,
        "intrinsics": lens.intrinsics,
        "distortion_coeffs": lens.distortion_coeffs,
    }
    return values[rest]


def _imu_coordinates(rest: str, imu: ImuParameters, start: ImuParameters) -> Floats | float:
    field = _IMU_FIELDS.get(rest, rest)
    value = getattr(imu, field)
    if rest in _IMU_ROTATIONS:
        return _turned(getattr(start, field), value)
    if rest == "time_shift":  # between timestamps
        return value + imu.epoch_s
    return value if isinstance(value, float) else value.ravel()


def _turned(start: Floats, now: Floats) -> Floats:
    """Return the rotation vector from one rotation to another, on the right."""
    return rotvec_from_rotation(start.T @ now)


def _coordinates_jacobian(name: str, parameters: RigParameters, start: RigParameters) -> Floats | None:
    """Return the derivative of the coordinates of a block by its step, or None where it is the identity."""
    if name == "gravity.direction":
        return start.gravity_plane.T @ parameters.gravity_plane
    if name.endswith((".T_cam_imu.rotation", *(f".{block}" for block in _IMU_ROTATIONS))):
        return invert_matrix(right_jacobian(np.asarray(block_coordinates(name, parameters, start))))
    return None


def _moved(name: str, parameters: RigParameters, delta: Floats) -> RigParameters:
    owner, _, rest = name.partition(".")
    if owner == "gravity":
        if rest == "magnitude":
            return replace(parameters, gravity_m_s2=parameters.gravity_m_s2 + float(delta[0]))
        turn = np.cross(parameters.gravity_direction, parameters.gravity_plane @ delta)
        return replace(parameters, gravity_axes=rotation_from_rotvec(turn) @ parameters.gravity_axes)
    if name == OFFSETS:
        assert parameters.board is not None
        return replace(parameters, board=parameters.board.moved(delta))
    if owner == "target":
        return replace(parameters, target_scale=parameters.target_scale + float(delta[0]))
    if owner.startswith("imu"):
        index = int(owner[3:])
        imus = list(parameters.imus)
        imus[index] = _moved_imu(rest, imus[index], delta)
        return replace(parameters, imus=tuple(imus))
    index, cameras = parameters.camera_index(owner), list(parameters.cameras)
    cameras[index] = _moved_camera(rest, cameras[index], delta)
    return replace(parameters, cameras=tuple(cameras))


def _moved_imu(rest: str, imu: ImuParameters, delta: Floats) -> ImuParameters:
    field = _IMU_FIELDS.get(rest, rest)
    value = getattr(imu, field)
    if rest in _IMU_ROTATIONS:
        return replace(imu, **{field: value @ rotation_from_rotvec(delta)})
    if isinstance(value, float):
        return replace(imu, **{field: value + float(delta[0])})
    return replace(imu, **{field: value + delta.reshape(value.shape)})


def _moved_camera(rest: str, entry: CameraParameters, delta: Floats) -> CameraParameters:
    lens = entry.camera
    if rest == "T_cam_imu.rotation":
        return replace(entry, R_cam_imu=entry.R_cam_imu @ rotation_from_rotvec(delta))
    if rest == "T_cam_imu.translation":
        return replace(entry, p_cam_imu=entry.p_cam_imu + delta)
    if rest == "time_shift_cam_imu":
        return replace(entry, time_shift_s=entry.time_shift_s + float(delta[0]))
    if rest == "exposure_squared":
        return replace(entry, exposure_s2=entry.exposure_s2 + float(delta[0]))
    if rest == "line_delay":
        return replace(entry, camera=replace(lens, line_delay_s=lens.line_delay_s + float(delta[0])))
    vector, count = lens.parameters.copy(), len(lens.intrinsics)
    vector[slice(0, count) if rest == "intrinsics" else slice(count, None)] += delta
    return replace(entry, camera=lens.with_parameters(vector))
