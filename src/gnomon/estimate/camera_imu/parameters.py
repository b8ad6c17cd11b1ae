"""The values of the constant design variables of Table 4.1 of Krebs, and where the corners of the board truly are.

`layout` names their scalars.
"""

from dataclasses import field, replace

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import tangent_basis
from ...models.camera import Camera
from ...models.forms import DIAGONAL, LOWER
from ...models.origin import Origin
from ...models.target import Target
from ...recording import Floats, KnownRig

OFFSETS = "target.offsets"
"""Name of the block of these shifts."""

_SHARE = 0.01
"""Prior standard deviation of a corner's shift, as a share of the side of a tag or a square, or the distance of two
circles: what a bad print or a detector does, and far more than the recording leaves open."""

_SCENE = 0.2
"""The same of a landmark, as a share of the size of the scene."""

_GAUGE = 1e-3
"""Standard deviation of the freedoms of the whole board, as a share of that of a corner."""


@value_class
class BoardPoints:
    """Where the corners of a board truly are: a shift of each from its nominal place, shared by all cameras.

    A bad print, a warped plate and the bias of a detector are all alike on the images: each corner stays off its
    nominal place, in all frames and cameras. A shift, a turn or another size of the whole board would only be another
    trajectory, another direction of gravity, another scale: these seven freedoms are taken from the shifts.

    Attributes
    ----------
    points : (k, 3) nominal places, target frame [m]
    offsets : (k, 3) from there to where they are [m]
    sigma_m : prior standard deviation of an offset, each axis
    """

    points: Floats
    offsets: Floats
    sigma_m: float

    @classmethod
    def nominal(cls, target: Target) -> "BoardPoints":
        """Return a board as it was stated; of landmarks hardly more than that they are there is known."""
        sides = {
            "aprilgrid": target.tag_size_m,
            "checkerboard": min(target.row_spacing_m, target.col_spacing_m),
            "circlegrid": target.spacing_m,
            "charuco": target.square_size_m,
            "landmarks": _SCENE / _SHARE * float(np.sqrt(np.mean((target.points - target.points.mean(axis=0)) ** 2))),
        }
        offsets = np.zeros_like(target.points)
        return cls(points=target.points, offsets=offsets, sigma_m=_SHARE * sides[target.kind])

    def moved(self, step: Floats) -> "BoardPoints":
        """Return the board with a step (3 k,) of its corners."""
        return replace(self, offsets=self.offsets + step.reshape(-1, 3))

    def similarity(self) -> Floats:
        """Return orthonormal rows (7, 3 k): how corners move when the board is shifted, turned or made larger."""
        centred = self.points - self.points.mean(axis=0)
        size = np.sqrt(np.mean(centred**2))
        unit = centred / size
        moves = [np.broadcast_to(axis, unit.shape) for axis in np.eye(3)]
        moves += [np.cross(axis, unit) for axis in np.eye(3)]
        moves.append(unit)
        rows = np.array([move.ravel() for move in moves])
        return np.ascontiguousarray(np.linalg.qr(rows.T)[0].T)

    def gauge_information(self) -> Floats:
        """Return the information (3 k, 3 k) by which the freedoms of the whole board are held, beside the prior."""
        rows = self.similarity() / (_GAUGE * self.sigma_m)
        return rows.T @ rows


@value_class
class ImuParameters:
    """Deterministic errors of one IMU (Krebs, chapter 3; implemented variant of chapter 4), its place and clock.

    accelerometer = S_a M_a f + b_a,   gyroscope = S_g M_g C_bg' omega + B_g f + b_g

    f and omega are those at its own origin in its own axes; of the first IMU these are the body's. Component k of the f
    that the accelerometer feels is that at the place r_k of the k-th accelerometer,
    (f + alpha x r_k + omega x (omega x r_k))_k, as Kalibr's scale-misalignment-size-effect has it.

    Attributes
    ----------
    S_a, S_g : (3,) scale factors
    M_a, M_g : (3,) misalignment yz, zy, zx
    C_bg : (3, 3) rotation from the gyroscope's frame to the body
    B_g : (3, 3) influence of the specific force, body frame, on the gyroscope [rad/s per m/s^2]
    covariance : (24, 24) of S_a, M_a, S_g, M_g, q_bg (small rotation on the right of C_bg) and B_g as they were known
        beforehand, zero where they were not; or None
    lever_arms : (6,) from the x accelerometer to y and to z, in the IMU's axes [m]
    origin : which point of the IMU its origin is
    R_imu_body : (3, 3), p_imu_body : (3,) [m] of T_imu_body; identity and zero of the first IMU
    time_shift_s : t_body = t_imu + time_shift_s, in seconds from the starts of both clocks; zero of the first IMU
    accelerometer_shift_s : t_gyroscope = t_accelerometer + accelerometer_shift_s
    apart : whether the accelerometer has timestamps of its own
    epoch_s : start of the body's seconds less the start of this IMU's, each a timestamp of its own clock: timestamps
    differ by
        time_shift_s + epoch_s
    """

    S_a: Floats
    M_a: Floats
    S_g: Floats
    M_g: Floats
    C_bg: Floats
    B_g: Floats
    covariance: Floats | None = None
    lever_arms: Floats = field(default_factory=lambda: np.zeros(6))
    origin: Origin = field(default_factory=Origin)
    R_imu_body: Floats = field(default_factory=lambda: np.eye(3))
    p_imu_body: Floats = field(default_factory=lambda: np.zeros(3))
    time_shift_s: float = 0.0
    accelerometer_shift_s: float = 0.0
    apart: bool = False
    epoch_s: float = 0.0

    @classmethod
    def ideal(cls) -> "ImuParameters":
        """Return an IMU without errors."""
        ones, zeros = np.ones(3), np.zeros(3)
        return cls(S_a=ones, M_a=zeros, S_g=ones, M_g=zeros, C_bg=np.eye(3), B_g=np.zeros((3, 3)))

    def without_errors(self) -> "ImuParameters":
        """Return the ideal IMU at the same place, with the same clock."""
        ideal = ImuParameters.ideal()
        return replace(
            self,
            **{name: getattr(ideal, name) for name in ("S_a", "M_a", "S_g", "M_g", "C_bg", "B_g", "lever_arms")},
            covariance=None,
        )

    @property
    def places(self) -> Floats:
        """Where the x, y and z accelerometers lie in the IMU's frame, (3, 3), one row each [m]."""
        from_x = np.concatenate([np.zeros(3), self.lever_arms]).reshape(3, 3)
        return from_x - self.origin.of(from_x)

    @property
    def places_by_arms(self) -> Floats:
        """Derivative of `places` by the lever arms, (3, 3, 6)."""
        weights = self.origin.combination[0]
        by_places = np.eye(9).reshape(3, 3, 9) - np.hstack(list(weights))
        return by_places[:, :, 3:]

    @property
    def origin_places(self) -> Floats:
        """Three times where its origin is from the body's, in its axes, (3, 3), a row each [m]."""
        return np.tile(-self.p_imu_body, (3, 1))

    @property
    def accelerometer_places(self) -> Floats:
        """Where its accelerometers are from the body's origin, in its axes, (3, 3), a row each [m]."""
        return self.places - self.p_imu_body

    @property
    def is_body(self) -> bool:
        """Whether its axes and its origin are the body's, as those of the first IMU are."""
        return not self.p_imu_body.any() and bool((self.R_imu_body == np.eye(3)).all())

    @property
    def T_imu_body(self) -> Floats:
        """Body coordinates to those of this IMU, (4, 4) [m]."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R_imu_body, self.p_imu_body
        return T

    def shift_s(self, *, accelerometer: bool) -> float:
        """Return what the timestamps of the accelerometer, or of the gyroscope, are behind the body's clock [s]."""
        return self.time_shift_s + (self.accelerometer_shift_s if accelerometer else 0.0)

    @property
    def accelerometer_sensitivity(self) -> Floats:
        """S_a M_a, (3, 3)."""
        return DIAGONAL.matrix(self.S_a) @ LOWER.matrix(self.M_a)

    @property
    def gyroscope_sensitivity(self) -> Floats:
        """S_g M_g C_bg', (3, 3)."""
        return DIAGONAL.matrix(self.S_g) @ LOWER.matrix(self.M_g) @ self.C_bg.T


@value_class
class CameraParameters:
    """One camera: where it sits, how its clock runs, and its lens.

    Attributes
    ----------
    name : of the camera, such as "cam0"
    R_cam_imu : (3, 3), p_cam_imu : (3,) [m] of T_cam_imu
    time_shift_s : t_imu = t_cam + time_shift_s
    camera : lens, intrinsics and line delay
    lens_covariance : (k, k) of `camera.parameters` as it was known beforehand, or None
    exposure_s2 : square of the time over which a corner's place is a mean, less that of the IMU's samples [s^2]
    """

    name: str
    R_cam_imu: Floats
    p_cam_imu: Floats
    time_shift_s: float
    camera: Camera
    lens_covariance: Floats | None = None
    exposure_s2: float = 0.0

    def with_k3(self) -> "CameraParameters":
        """Return the camera with a third radial coefficient, 0 and unknown so far, where its lens is radtan."""
        lens, known = self.camera.with_k3(), self.lens_covariance
        if known is not None and len(known) < len(lens.parameters):
            known = np.pad(known, (0, 1))
        return replace(self, camera=lens, lens_covariance=known)

    def lens_names(self) -> list[str]:
        """Return the names of `camera.parameters`."""
        first, second = len(self.camera.intrinsics), len(self.camera.distortion_coeffs)
        names = [f"{self.name}.intrinsics[{i}]" for i in range(first)]
        if second == 1:  # a lone scalar is called like its block
            return [*names, f"{self.name}.distortion_coeffs"]
        return names + [f"{self.name}.distortion_coeffs[{i}]" for i in range(second)]


def gravity_axes(direction: Floats) -> Floats:
    """Return a rotation (3, 3) whose last column is a direction (3,), of any length."""
    unit = direction / np.linalg.norm(direction)
    plane = tangent_basis(unit)
    return np.column_stack([plane, unit])


@value_class
class RigParameters:
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
    board: BoardPoints | None = None
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
