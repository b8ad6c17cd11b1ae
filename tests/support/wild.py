"""Wild cases: recordings, options and statements that nobody would make on purpose, with what is true of them.

A case is drawn with several oddities at once, each of a size from harmless to hopeless. What a calibration may say of
it is judged by `support.wild_judge`.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gnomon.models.target import Target
from gnomon.options import CameraImuOptions, ImuOptions
from gnomon.recording import Floats, Recording
from gnomon.results.moved import moved_into_frame
from gnomon.results.sensors import CameraCalibration, ImuCalibration

WildKind = Literal["imu", "camera-imu"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Oddity:
    """One thing that is odd about a case.

    Attributes
    ----------
    name : what it is, with its size
    codes : findings that name it, or what comes of it, and say that the result suffers
    decisive : whether its own codes are needed where it is there, since it spoils everything
    """

    name: str
    codes: tuple[str, ...] = ()
    decisive: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WildCase:
    """A wild case.

    Attributes
    ----------
    recording, target, options : what the calibration is given
    imus, cameras : what is true, in the units and the timestamps of the recording, body frame accel-x
    oddities : what is odd about it
    wandering : path -> by how much the true value moved during the recording, so that no number is the true one
    """

    kind: WildKind
    seed: int
    recording: Recording
    target: Target | None
    options: ImuOptions | CameraImuOptions
    imus: dict[str, ImuCalibration]
    cameras: dict[str, CameraCalibration]
    oddities: tuple[Oddity, ...]
    wandering: dict[str, Floats]

    def with_oddity(self, name: str, *codes: str, decisive: bool = False) -> "WildCase":
        """Return the case with one more oddity."""
        return replace(self, oddities=(*self.oddities, Oddity(name=name, codes=codes, decisive=decisive)))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def signed_permutation(rng: np.random.Generator) -> Floats:
    """Draw columns exchanged and signs changed, (3, 3), of either handedness."""
    return np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)[:, None]


def reread(
    imu: ImuCalibration,
    *,
    accelerometer: Floats | float = 1.0,
    gyroscope: Floats | float = 1.0,
) -> ImuCalibration:
    """Return what is true of readings that were multiplied by a number or a matrix (3, 3)."""
    force, rate = imu.required_accelerometer, imu.gyroscope
    assert rate is not None
    by_force, by_rate = (
        np.asarray(one) if np.ndim(one) else np.eye(3) * np.asarray(one) for one in (accelerometer, gyroscope)
    )
    return replace(
        imu,
        accelerometer=replace(force, sensitivity=by_force @ force.sensitivity, bias=by_force @ force.bias),
        gyroscope=replace(
            rate,
            sensitivity=by_rate @ rate.sensitivity,
            bias=by_rate @ rate.bias,
            g_sensitivity=by_rate @ rate.g_sensitivity,
        ),
    )


def in_units_of(imu: ImuCalibration, *, force: float = 1.0, rate: float = 1.0) -> ImuCalibration:
    """Return what is true where one unit of the world's force, or of its rate, is taken for that many."""
    accelerometer, gyroscope = imu.required_accelerometer, imu.gyroscope
    assert gyroscope is not None
    return replace(
        imu,
        accelerometer=replace(accelerometer, sensitivity=accelerometer.sensitivity / force),
        gyroscope=replace(
            gyroscope, sensitivity=gyroscope.sensitivity / rate, g_sensitivity=gyroscope.g_sensitivity / force
        ),
    )


def on_a_turning_earth(imu: ImuCalibration, vertical: float, gravity: float) -> ImuCalibration:
    """Return what is true where the Earth, which stands still here, is said to turn with a vertical rate [rad/s].

    That rate turns with the attitude like gravity: the readings are those of another g-sensitivity. In the mirrored
    world, in which a left-handed accelerometer is calibrated, the Earth turns the other way.
    """
    rate = imu.gyroscope
    assert rate is not None
    hand = np.sign(np.linalg.det(imu.required_accelerometer.sensitivity))
    hidden = hand * rate.sensitivity * vertical / gravity
    return replace(imu, gyroscope=replace(rate, g_sensitivity=rate.g_sensitivity - hidden))


def seen_in_a_mirror(imu: ImuCalibration) -> ImuCalibration:
    """Return an IMU with a right-handed accelerometer in the mirrored world, where the recording is just as true.

    Gravity's magnitude does not tell a world from its mirror image: f becomes M f and, since a rate is no true vector,
    omega becomes -M omega.
    """
    accelerometer, gyroscope = imu.required_accelerometer, imu.gyroscope
    assert gyroscope is not None
    mirror = np.diag([1.0, 1.0, -1.0])
    return replace(
        imu,
        accelerometer=replace(accelerometer, sensitivity=accelerometer.sensitivity @ mirror),
        gyroscope=replace(
            gyroscope,
            sensitivity=gyroscope.sensitivity @ -mirror,
            g_sensitivity=gyroscope.g_sensitivity @ mirror,
        ),
    )


def in_body_frame(
    imu: ImuCalibration, cameras: dict[str, CameraCalibration]
) -> tuple[dict[str, ImuCalibration], dict[str, CameraCalibration]]:
    """Return the sensors in body frame accel-x."""
    moved = moved_into_frame({"imu0": imu}, cameras, "accel-x")
    return moved.imus, moved.cameras
