"""First guesses for the IMUs beside the first, and for an accelerometer with a clock of its own.

The rotation that a camera saw is compared with each gyroscope in turn (`alignment`). With t_imu = t_cam + d for either,

    t_body = t_imu + d_body - d_imu,     R_imu_body = R_cam_imu' R_cam_body.

Clocks may have nothing in common: each IMU counts its seconds from its own first timestamp. Where it sits on the body
is left to the estimation, which starts from the body's origin.

The delay between accelerometer and gyroscope: the camera's own acceleration is told by its positions
(`camera_accelerations`). At each delay of a grid gravity g, the place p of the accelerometer and its bias b are fitted
in

    f = R_cam_imu' (R_cam_target (a - g)) + A p + b,     A = [alpha]x + [omega]x^2 by the gyroscope,

with f averaged as the second difference averages; the delay that leaves least is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....errors import InitialisationError, OptionError
from ....frozen import value_class
from ....geometry.rotations import acceleration_by_place
from ....recording import Floats, ImuSamples
from ..choices import kept_or_prior
from ..layout import Status
from ..parameters import ImuParameters
from .alignment import Alignment, align_camera, gyroscope_integral
from .board_poses import BoardPoses, averaged_derivative, averaged_readings, camera_accelerations
from .first_guess import CameraAlignment, ImuStream, align_with_gravity

_GRID_S = np.arange(-0.06, 0.0601, 0.002)
_FEWEST = 10  # accelerations
_EXPLAINED = 0.5
"""Share of the scatter of the specific force that has to be explained."""


def accelerometer_delay(alignment: Alignment, poses: BoardPoses, stream: ImuStream) -> float:
    """Return t_gyroscope - t_accelerometer of the timestamps of one instant [s]; zero where nothing tells it.

    Parameters
    ----------
    alignment, poses : of a camera, and to this IMU
    stream : its readings by their timestamps
    """
    centre, acceleration, at_s = camera_accelerations(poses, alignment.time_shift_s)
    if len(centre) < _FEWEST:
        return 0.0
    R_imu_target = alignment.R_cam_imu.T @ poses.R_cam_target[centre]
    omega = averaged_readings(at_s, stream.t_s, stream.rate)
    alpha = averaged_derivative(at_s, stream.t_s, stream.rate)
    columns = np.concatenate(
        [-R_imu_target, acceleration_by_place(omega, alpha), np.broadcast_to(np.eye(3), R_imu_target.shape)], axis=2
    ).reshape(-1, 9)
    basis = np.linalg.qr(columns)[0]
    known = np.einsum("nij,nj->ni", R_imu_target, acceleration)
    left = np.empty(len(_GRID_S))
    for k, delay in enumerate(_GRID_S):
        error = (averaged_readings(at_s - delay, stream.t_s, stream.force) - known).ravel()
        left[k] = error @ error - np.square(basis.T @ error).sum()
    best = int(np.argmin(left))
    force = averaged_readings(at_s, stream.t_s, stream.force)
    if not 0 < best < len(left) - 1 or left[best] > _EXPLAINED * float(np.square(force - force.mean(axis=0)).sum()):
        return 0.0
    before, least, after = left[best - 1 : best + 2]
    step = _GRID_S[1] - _GRID_S[0]
    return float(_GRID_S[best] + 0.5 * step * (before - after) / (before - 2 * least + after))


@value_class
class ImuAlignment:
    """An IMU beside the first.

    Attributes
    ----------
    name : such as "imu1"
    look : camera by which it was aligned
    alignment : of that camera to it; the score is 0 where nothing was aligned
    R_imu_body : (3, 3)
    time_shift_s : t_body = t_imu + time_shift_s, in seconds from the starts of both clocks
    """

    name: str
    look: CameraAlignment
    alignment: Alignment
    R_imu_body: Floats
    time_shift_s: float

    @property
    def gyroscope_bias(self) -> Floats:
        """Bias of its gyroscope, (3,) [rad/s]."""
        return self.alignment.gyroscope_bias


def align_imus(
    found: Sequence[CameraAlignment],
    streams: Sequence[ImuStream],
    imus: Sequence[tuple[str, ImuSamples]],
    epochs_s: Sequence[float],
) -> tuple[ImuAlignment, ...]:
    """Return how the IMUs after the first lie to it.

    Parameters
    ----------
    found : what the cameras saw, aligned to the first IMU
    streams : of all IMUs
    imus : names and recordings of all IMUs
    epochs_s : for each IMU, start of the body's seconds less the start of its own [s]

    Raises
    ------
    InitialisationError
        If one cannot be aligned to any camera, and nothing is stated of how it lies.
    """
    guides = sorted(found, key=lambda look: -int(look.alignment.consistent.sum()))
    return tuple(
        _beside(name, samples, stream, guides, epoch_s)
        for (name, samples), stream, epoch_s in list(zip(imus, streams, epochs_s, strict=True))[1:]
    )


def _beside(
    name: str, samples: ImuSamples, stream: ImuStream, guides: Sequence[CameraAlignment], epoch_s: float
) -> ImuAlignment:
    integral = gyroscope_integral(stream.t_s, stream.rate)
    failure: InitialisationError | None = None
    for look in guides:
        try:
            alignment = align_camera(look.poses, integral, look.name)
        except InitialisationError as error:
            failure = failure or error
            continue
        alignment = align_with_gravity(alignment, look.poses, stream)
        return ImuAlignment(
            name=name,
            look=look,
            alignment=alignment,
            R_imu_body=alignment.R_cam_imu.T @ look.alignment.R_cam_imu,
            time_shift_s=look.alignment.time_shift_s - alignment.time_shift_s,
        )
    if samples.T_imu_body is None:
        raise InitialisationError(f"{name}: {failure}")
    look = guides[0]
    unknown = replace(look.alignment, score=0.0, gyroscope_bias=0.0 * look.alignment.gyroscope_bias)
    return ImuAlignment(
        name=name,
        look=look,
        alignment=unknown,
        R_imu_body=samples.T_imu_body[:3, :3],
        time_shift_s=(samples.time_shift_s or 0.0) - epoch_s,
    )


def first_imu(one: ImuAlignment, known: ImuParameters) -> ImuParameters:
    """Return an IMU as it is estimated first, with its place and clock.

    Parameters
    ----------
    known : its errors, as they are known beforehand, and its epoch
    """
    return replace(known, R_imu_body=one.R_imu_body, time_shift_s=one.time_shift_s)


def with_stated_pose(imu: ImuParameters, name: str, samples: ImuSamples, status: dict[str, Status]) -> ImuParameters:
    """Return an IMU with its stated place and clock where these are kept or have a prior.

    Clocks of which nothing is stated are taken for one where the shift is kept.

    Raises
    ------
    OptionError
        If a place shall be kept, or has a prior, that was not stated.
    """
    T = samples.T_imu_body
    for block in ("T_imu_body.rotation", "T_imu_body.translation"):
        if not kept_or_prior(status, f"{name}.{block}"):
            continue
        if T is None:
            raise OptionError(
                f"{name}.{block} shall be kept, or has a prior, but nothing states how {name} lies: state its "
                "T_imu_body with the recording, or let it be estimated."
            )
        imu = replace(imu, R_imu_body=T[:3, :3]) if block.endswith("rotation") else replace(imu, p_imu_body=T[:3, 3])
    if kept_or_prior(status, f"{name}.time_shift"):
        imu = replace(imu, time_shift_s=(samples.time_shift_s or 0.0) - imu.epoch_s)
    return imu
