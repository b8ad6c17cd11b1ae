"""The constant design variables of Table 4.1 of document B, and which of them are estimated.

Values are in `Parameters`; `Layout` gives each scalar that is estimated, or whose influence is wanted, its column in
the border of the normal equations.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ...geometry.rotation_vector import right_jacobian, rotation_from_rotvec, rotvec_from_rotation
from ...geometry.so3 import inverse, tangent_basis
from ...models.camera import Camera
from ...models.pattern import DIAGONAL, FULL, LOWER
from ...recording import Floats, Integers, KnownRig
from .board import OFFSETS, Board

Status = Literal["estimated", "prior", "fixed"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuParameters:
    """Deterministic errors of one IMU (document B, chapter 3; implemented variant of chapter 4).

    accelerometer = S_a M_a f + b_a,   gyroscope = S_g M_g C_bg' omega + B_g f + b_g

    Component k of the f that the accelerometer feels is that at the place r_k of the k-th accelerometer,
    (f + alpha x r_k + omega x (omega x r_k))_k, as Kalibr's scale-misalignment-size-effect has it.

    Attributes
    ----------
    S_a, S_g : (3,) scale factors
    M_a, M_g : (3,) misalignment yz, zy, zx
    C_bg : (3, 3) rotation from the gyroscope's frame to the body
    B_g : (3, 3) influence of the specific force, body frame, on the gyroscope [rad/s per m/s^2]
    covariance : (24, 24) of S_a, M_a, S_g, M_g, q_bg (small rotation on the right of C_bg) and B_g as they were known
        beforehand, zero where they were not; or None
    lever_arms : (6,) from the accelerometer that is the body's origin to the two others, in the order of the axes,
        body frame [m]
    origin : axis of the accelerometer that is the body's origin
    """

    S_a: Floats
    M_a: Floats
    S_g: Floats
    M_g: Floats
    C_bg: Floats
    B_g: Floats
    covariance: Floats | None = None
    lever_arms: Floats = field(default_factory=lambda: np.zeros(6))
    origin: int = 0

    @classmethod
    def ideal(cls) -> "ImuParameters":
        """Return an IMU without errors."""
        ones, zeros = np.ones(3), np.zeros(3)
        return cls(S_a=ones, M_a=zeros, S_g=ones, M_g=zeros, C_bg=np.eye(3), B_g=np.zeros((3, 3)))

    @property
    def other_axes(self) -> tuple[int, ...]:
        """Axes of the two accelerometers that are not the body's origin."""
        return tuple(axis for axis in range(3) if axis != self.origin)

    @property
    def places(self) -> Floats:
        """Where the x, y and z accelerometers lie in the body frame, (3, 3), one row each [m]."""
        found = np.zeros((3, 3))
        found[list(self.other_axes)] = self.lever_arms.reshape(2, 3)
        return found

    @property
    def accelerometer_sensitivity(self) -> Floats:
        """S_a M_a, (3, 3)."""
        return DIAGONAL.matrix(self.S_a) @ LOWER.matrix(self.M_a)

    @property
    def gyroscope_sensitivity(self) -> Floats:
        """S_g M_g C_bg', (3, 3)."""
        return DIAGONAL.matrix(self.S_g) @ LOWER.matrix(self.M_g) @ self.C_bg.T


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraParameters:
    """One camera: where it sits, how its clock runs, and its lens.

    Attributes
    ----------
    name : of the camera, such as "cam0"
    R_cam_imu : (3, 3), p_cam_imu : (3,) [m] of T_cam_imu
    time_shift_s : t_imu = t_cam + time_shift_s
    camera : lens, intrinsics and line delay
    lens_covariance : (k, k) of `camera.parameters` as it was known beforehand, or None
    """

    name: str
    R_cam_imu: Floats
    p_cam_imu: Floats
    time_shift_s: float
    camera: Camera
    lens_covariance: Floats | None = None

    def with_k3(self) -> "CameraParameters":
        """Return the camera with a third radial coefficient, 0 and unknown so far, where its lens is radtan."""
        lens, known = self.camera.with_k3(), self.lens_covariance
        if known is not None and len(known) < len(lens.parameters):
            known = np.pad(known, (0, 1))
        return replace(self, camera=lens, lens_covariance=known)

    def lens_names(self) -> list[str]:
        """Return the names of `camera.parameters`."""
        first, second = len(self.camera.intrinsics), len(self.camera.distortion_coeffs)
        return [f"{self.name}.intrinsics[{i}]" for i in range(first)] + [
            f"{self.name}.distortion_coeffs[{i}]" for i in range(second)
        ]


def gravity_axes(direction: Floats) -> Floats:
    """Return a rotation (3, 3) whose last column is a direction (3,), of any length."""
    unit = direction / np.linalg.norm(direction)
    plane = tangent_basis(unit)
    return np.column_stack([plane, unit])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parameters:
    """All constant design variables.

    Attributes
    ----------
    gravity_axes : (3, 3) rotation whose last column is the direction of gravity, target frame, pointing down; the
        first two span the plane in which it is moved
    gravity_m_s2 : magnitude
    target_scale : size of the board relative to what was stated
    board : its corners, or None where they are as stated
    imus, cameras : one by one
    rig : poses of the cameras to the first one and all lenses, as they were known beforehand, or None
    """

    gravity_axes: Floats
    gravity_m_s2: float
    target_scale: float
    imus: tuple[ImuParameters, ...]
    cameras: tuple[CameraParameters, ...]
    board: Board | None = None
    rig: KnownRig | None = None

    @property
    def gravity_direction(self) -> Floats:
        """Unit vector, target frame, pointing down, (3,)."""
        return self.gravity_axes[:, 2]

    @property
    def gravity_plane(self) -> Floats:
        """Two unit vectors perpendicular to gravity, (3, 2)."""
        return self.gravity_axes[:, :2]

    def camera_index(self, name: str) -> int:
        """Return the place of a camera."""
        return next(i for i, camera in enumerate(self.cameras) if camera.name == name)

    @property
    def gravity(self) -> Floats:
        """Gravity in the target frame, (3,) [m/s^2]."""
        return self.gravity_m_s2 * self.gravity_direction


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Scalars that belong together.

    Attributes
    ----------
    name : such as "imu0.S_a"
    size : number of scalars
    weak_sigma : standard deviation of the prior that keeps what a recording does not determine from running away;
        does not move what it does
    unit : of the scalars
    """

    name: str
    size: int
    weak_sigma: tuple[float, ...]
    unit: str

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

_IMU_SCALARS = tuple(f"{name}[{i}]" for name, size, _, _ in _IMU_BLOCKS for i in range(size))

_LENS_SIGMA = {"projection": 0.1, "focal": 20.0, "principal": 20.0, "distortion": 0.1}


def blocks(parameters: Parameters) -> tuple[Block, ...]:
    """Return all blocks of scalars, in their order."""
    found = [
        Block(name="gravity.direction", size=2, weak_sigma=(0.5,) * 2, unit="rad"),
        Block(name="gravity.magnitude", size=1, weak_sigma=(0.05,), unit="m/s^2"),
        Block(name="target.scale", size=1, weak_sigma=(0.1,), unit=""),
    ]
    for i in range(len(parameters.imus)):
        found += [
            Block(name=f"imu{i}.{name}", size=size, weak_sigma=(sigma,) * size, unit=unit)
            for name, size, sigma, unit in (*_IMU_BLOCKS, _LEVER_ARMS)
        ]
    for entry in parameters.cameras:
        name, lens = entry.name, entry.camera
        sigmas = tuple(_LENS_SIGMA[kind] for kind in lens.parameter_kinds)
        count = len(lens.intrinsics)
        found += [
            Block(name=f"{name}.T_cam_imu.rotation", size=3, weak_sigma=(1.0,) * 3, unit="rad"),
            Block(name=f"{name}.T_cam_imu.translation", size=3, weak_sigma=(1.0,) * 3, unit="m"),
            Block(name=f"{name}.time_shift_cam_imu", size=1, weak_sigma=(0.1,), unit="s"),
            Block(name=f"{name}.line_delay", size=1, weak_sigma=(1e-4,), unit="s"),
            Block(name=f"{name}.intrinsics", size=count, weak_sigma=sigmas[:count], unit="px"),
        ]
        if len(sigmas) > count:
            found.append(
                Block(name=f"{name}.distortion_coeffs", size=len(sigmas) - count, weak_sigma=sigmas[count:], unit="")
            )
    if parameters.board is not None:  # last: its columns are the wide part of the border
        size = parameters.board.offsets.size
        found.append(Block(name=OFFSETS, size=size, weak_sigma=(parameters.board.sigma_m,) * size, unit="m"))
    return tuple(found)


def known_beforehand(parameters: Parameters) -> Iterator[tuple[list[str], Floats, Floats]]:
    """Yield what is known of each sensor with an uncertainty: names (k), sigmas (k,) and correlation (k, k)."""
    sensors = [([f"imu{i}.{name}" for name in _IMU_SCALARS], imu.covariance) for i, imu in enumerate(parameters.imus)]
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


def lenses_of(rig: KnownRig, parameters: Parameters) -> tuple[list[str], Floats]:
    """Return the names of the lenses' scalars that a rig knows, and their joint covariance."""
    wanted = {name for entry in parameters.cameras for name in entry.lens_names()}
    at = [i for i, name in enumerate(rig.names) if name in wanted]
    return [rig.names[i] for i in at], rig.covariance[np.ix_(at, at)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
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
    start: Parameters

    def __len__(self) -> int:
        return len(self.names)

    @property
    def of_imu(self) -> np.ndarray:
        """Whether a scalar belongs to the model of an IMU, (p,) bool."""
        return np.array([name.startswith("imu") for name in self.names], dtype=bool)

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

    def values(self, parameters: Parameters) -> Floats:
        """Return the scalars (p,); of rotations and of gravity's direction the small angles from the start."""
        result = np.empty(len(self))
        for name, columns in self.columns.items():
            result[columns] = coordinates(name, parameters, self.start)
        return result

    def values_jacobian(self, parameters: Parameters) -> Floats:
        """Return the derivative of `values` by a step of the scalars, (p, p)."""
        jacobian = np.eye(len(self))
        for name, columns in self.columns.items():
            block = _coordinates_jacobian(name, parameters, self.start)
            if block is not None:
                jacobian[columns, columns] = block
        return jacobian

    def plus(self, parameters: Parameters, step: Floats) -> Parameters:
        """Return parameters moved by a step (p,)."""
        moved = parameters
        for name, columns in self.columns.items():
            delta = step[columns]
            if delta.any():
                moved = _moved(name, moved, delta)
        return moved


def layout(
    start: Parameters,
    status: dict[str, Status],
    prior_sigma: dict[str, float],
    consider: Sequence[str] = (),
) -> Layout:
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
    for block in blocks(start):
        scalars = block.scalars()
        if block.name not in consider and all(status[name] == "fixed" for name in scalars):
            continue
        columns[block.name] = slice(len(names), len(names) + block.size)
        names += scalars
        units += [block.unit] * block.size
        sigma += [prior_sigma.get(name, weak) for name, weak in zip(scalars, block.weak_sigma, strict=True)]
        weak += [name not in prior_sigma for name in scalars]
    draft = Layout(
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


def _information(start: Parameters, names: list[str], sigma: Floats) -> Floats:
    """Return the inverse of the priors' covariance (p, p): what is known beforehand comes with its correlations."""
    information = np.diag(np.where(np.isfinite(sigma), sigma, np.inf) ** -2.0)
    column = {name: i for i, name in enumerate(names)}
    for known, size, correlation in known_beforehand(start):
        whole = np.linalg.inv(correlation) / np.outer(size, size)
        kept = [i for i, name in enumerate(known) if name in column and sigma[column[name]] == size[i]]
        at = [column[known[i]] for i in kept]
        information[np.ix_(at, at)] = whole[np.ix_(kept, kept)]
    if start.board is not None and (first := column.get(f"{OFFSETS}[0]")) is not None:
        information[first:, first:] += start.board.gauge_information()
    return information


def coordinates(name: str, parameters: Parameters, start: Parameters) -> Floats | float:
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
        imu = parameters.imus[index]
        return _turned(start.imus[index].C_bg, imu.C_bg) if rest == "q_bg" else getattr(imu, rest).ravel()
    index = parameters.camera_index(owner)
    entry, lens = parameters.cameras[index], parameters.cameras[index].camera
    if rest == "T_cam_imu.rotation":
        return _turned(start.cameras[index].R_cam_imu, entry.R_cam_imu)
    values = {
        "T_cam_imu.translation": entry.p_cam_imu,
        "time_shift_cam_imu": entry.time_shift_s,
        "line_delay": lens.line_delay_s,
        "intrinsics": lens.intrinsics,
        "distortion_coeffs": lens.distortion_coeffs,
    }
    return values[rest]


def _turned(start: Floats, now: Floats) -> Floats:
    """Return the rotation vector from one rotation to another, on the right."""
    return rotvec_from_rotation(start.T @ now)


def _coordinates_jacobian(name: str, parameters: Parameters, start: Parameters) -> Floats | None:
    """Return the derivative of the coordinates of a block by its step, or None where it is the identity."""
    if name == "gravity.direction":
        return start.gravity_plane.T @ parameters.gravity_plane
    if name.endswith((".q_bg", ".T_cam_imu.rotation")):
        return inverse(right_jacobian(np.asarray(coordinates(name, parameters, start))))
    return None


def _moved(name: str, parameters: Parameters, delta: Floats) -> Parameters:
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
    if rest == "q_bg":
        return replace(imu, C_bg=imu.C_bg @ rotation_from_rotvec(delta))
    if rest == "B_g":
        return replace(imu, B_g=imu.B_g + FULL.matrix(delta))
    return replace(imu, **{rest: getattr(imu, rest) + delta})


def _moved_camera(rest: str, entry: CameraParameters, delta: Floats) -> CameraParameters:
    lens = entry.camera
    if rest == "T_cam_imu.rotation":
        return replace(entry, R_cam_imu=entry.R_cam_imu @ rotation_from_rotvec(delta))
    if rest == "T_cam_imu.translation":
        return replace(entry, p_cam_imu=entry.p_cam_imu + delta)
    if rest == "time_shift_cam_imu":
        return replace(entry, time_shift_s=entry.time_shift_s + float(delta[0]))
    if rest == "line_delay":
        return replace(entry, camera=replace(lens, line_delay_s=lens.line_delay_s + float(delta[0])))
    vector, count = lens.parameters.copy(), len(lens.intrinsics)
    vector[slice(0, count) if rest == "intrinsics" else slice(count, None)] += delta
    return replace(entry, camera=lens.with_parameters(vector))
