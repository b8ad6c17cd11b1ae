"""The points of the IMUs to which their poses refer: as the motion weighs the accelerometers (`models.origin`).

The motion is that which the gyroscope measured. A trajectory that has not been estimated yet has rotations that are
joined from frame to frame, and accelerations far too large.
"""

from dataclasses import replace

import numpy as np

from ...geometry.bspline import basis
from ...models.origin import single_point_weights
from ...recording import Floats
from .first_guess import ImuStream
from .initial_trajectory import fitted_splines
from .parameters import ImuParameters
from .trajectory import Grid

_ORDER = 4


def with_weighed_origin(imu: ImuParameters, stream: ImuStream, grid: Grid) -> ImuParameters:
    """Return the IMU with the weights of its accelerometers that its motion gives.

    Parameters
    ----------
    stream : of the IMU
    grid : of the trajectory, over which the motion is averaged
    """
    rate, acceleration = _motion(stream.t_s + imu.time_shift_s, stream.rate, grid)
    return replace(imu, origin=replace(imu.origin, weights=single_point_weights(rate, acceleration)))


def _motion(t_s: Floats, rate: Floats, grid: Grid) -> tuple[Floats, Floats]:
    """Return angular rate and acceleration, (n, 3) each, by splines through measured rates (n, 3) [rad/s]."""
    found: list[tuple[Floats, Floats]] = [(np.zeros((0, 3)), np.zeros((0, 3)))]
    for segment in grid.segments:
        position = (t_s - segment.start_s) / grid.spacing_s
        inside = (position >= 0) & (position < segment.spans)
        if not inside.any():
            continue
        position = position[inside]
        controls = fitted_splines(position, rate[inside], segment.spans, _ORDER)
        first = position.astype(np.int64)
        rows = controls[first[:, None] + np.arange(_ORDER)]
        values = [np.einsum("ni,nij->nj", basis(_ORDER, position - first, order), rows) for order in (0, 1)]
        found.append((values[0], values[1] / grid.spacing_s))
    return np.concatenate([one for one, _ in found]), np.concatenate([other for _, other in found])
