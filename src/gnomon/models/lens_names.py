"""The lens models: their names, and those of their parameters, in the order of Kalibr's files. Needs no NumPy.

`models.projections` and `models.distortions` hold the equations.
"""

from collections.abc import Mapping
from typing import Literal

ProjectionName = Literal["pinhole", "omni", "eucm", "ds"]
DistortionName = Literal["none", "radtan", "radtan5", "equidistant", "fov"]

LINEAR = ("fu", "fv", "pu", "pv")
"""Focal lengths and principal point [px], which follow the shape of every projection."""

SHAPES: Mapping[ProjectionName, tuple[str, ...]] = {
    "pinhole": (),
    "omni": ("xi",),
    "eucm": ("alpha", "beta"),
    "ds": ("xi", "alpha"),
}
"""What a projection has beside focal lengths and principal point."""

COEFFICIENTS: Mapping[DistortionName, tuple[str, ...]] = {
    "none": (),
    "radtan": ("k1", "k2", "p1", "p2"),
    "radtan5": ("k1", "k2", "p1", "p2", "k3"),
    "equidistant": ("k1", "k2", "k3", "k4"),
    "fov": ("w",),
}
"""Coefficients of a distortion; radtan5 is radtan with k3."""
