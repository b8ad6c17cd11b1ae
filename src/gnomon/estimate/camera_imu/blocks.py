"""The scalars of the constant design variables: their names, weak priors, and what is known of them beforehand."""

from collections.abc import Iterator

import numpy as np

from ...frozen import value_class
from ...recording import Floats, KnownRig
from .parameters import RigParameters
from .terms.board_terms import OFFSETS


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
