"""Mean readings at rest, attitude by attitude."""

from dataclasses import fields, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from ..frozen import value_class
from .arrays import Floats, Integers, frozen_array

Booleans = NDArray[np.bool_]


@value_class
class Poses:
    """Averages of an IMU at rest in several attitudes, one row a pose: a table that somebody made, or a file per pose.

    Attributes
    ----------
    name : (n,) what a person knows each pose by: a file, or the row of a table
    accelerometer : (n, 3) mean [accelerometer_unit]
    gyroscope : (n, 3) mean [gyroscope_unit], or None
    accelerometer_sigma, gyroscope_sigma : (n, 3) standard deviation of each mean [unit], or None where it is not known
    samples : (n,) samples in each mean; 0 where that is not known
    t_s : (n,) when [s], or None where it is not known
    specific_force : (n, 3) known specific force in the frame of the jig [m/s^2], or None (Angrisano, Eqs. 4 to 7)

    Raises
    ------
    RecordingError
        If the shapes do not fit.
    """

    name: tuple[str, ...]
    accelerometer: Floats
    accelerometer_unit: str
    gyroscope: Floats | None = None
    gyroscope_unit: str = "rad/s"
    accelerometer_sigma: Floats | None = None
    gyroscope_sigma: Floats | None = None
    samples: Integers | None = None
    t_s: Floats | None = None
    specific_force: Floats | None = None

    def __post_init__(self) -> None:
        n = len(self.name)
        for field_name in ("accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma", "specific_force"):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values))
                if np.shape(values) != (n, 3):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n}, 3); found {np.shape(values)}.")
        for field_name, dtype in (("samples", np.int64), ("t_s", np.float64)):
            values = getattr(self, field_name)
            if values is not None:
                object.__setattr__(self, field_name, frozen_array(values, dtype))
                if np.shape(values) != (n,):
                    raise RecordingError(f"{field_name} of {n} poses must be ({n},); found {np.shape(values)}.")

    def __len__(self) -> int:
        return len(self.name)

    def where(self, kept: Booleans) -> "Poses":
        """Return some of the poses."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        chosen = {name: value[kept] for name, value in values.items() if isinstance(value, np.ndarray)}
        return replace(self, name=tuple(compress(self.name, kept)), **chosen)
