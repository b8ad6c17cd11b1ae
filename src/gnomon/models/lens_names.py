"""Which lens models the programs know that take a calibration of cameras.

The lens models: their names, and those of their parameters, in the order of Kalibr's files. Needs no NumPy.

`models.camera` and `models.distortions` hold the equations.
"""

import difflib
from collections.abc import Mapping
from typing import Literal

from ..errors import OptionError

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

_PLAIN = ("none",)
LENSES: Mapping[str, Mapping[ProjectionName, tuple[DistortionName, ...]]] = {
    "kalibr": {
        "pinhole": ("none", "radtan", "radtan5", "equidistant", "fov"),
        "omni": ("none", "radtan"),
        "eucm": _PLAIN,
        "ds": _PLAIN,
    },
    "openvins": {"pinhole": ("none", "radtan", "radtan5", "equidistant")},
    "vins-fusion": {"pinhole": ("none", "radtan", "radtan5", "equidistant"), "omni": ("none", "radtan")},
    "orb-slam3": {"pinhole": ("none", "radtan", "radtan5", "equidistant")},
    "basalt": {
        "pinhole": ("none", "radtan", "radtan5", "equidistant"),
        "omni": _PLAIN,
        "eucm": _PLAIN,
        "ds": _PLAIN,
    },
    "okvis": {"pinhole": ("none", "radtan", "radtan5", "equidistant")},
    "ros2": {"pinhole": ("none", "radtan", "radtan5", "equidistant")},
}
"""What the programs read; radtan5 as the nearest radtan where they know no k3."""

_WITH_K3 = ("orb-slam3", "basalt", "okvis", "ros2")

PROGRAMS = tuple(LENSES)
"""Formats that describe cameras to a program, which knows some lenses and not others."""


def models_of(name: str) -> tuple[str, ...]:
    """Return the lens models that a program knows, such as "pinhole-radtan"."""
    return tuple(f"{projection}-{bent}" for projection, all_bent in LENSES[name].items() for bent in all_bent)


def read_everywhere() -> tuple[str, ...]:
    """Return the models that every program knows in full."""
    return tuple(model for model in refit_models(PROGRAMS[0]) if all(model in refit_models(name) for name in PROGRAMS))


def check_program(name: str) -> None:
    """Check that lenses of a program are known.

    Raises
    ------
    OptionError
        If there is no such program.
    """
    if name not in PROGRAMS:
        close = difflib.get_close_matches(name, PROGRAMS, n=1, cutoff=0.4)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise OptionError(
            f"{name}: it is not known which lenses this program reads.{hint} Known: {', '.join(PROGRAMS)}. "
            "Uses such as vio are stated to gnomon camera-imu."
        )


def refit_models(name: str) -> tuple[str, ...]:
    """Return the models that a program knows in full and that bend, of which the nearest to another lens is sought."""
    plain = {"pinhole-none", *(() if name in _WITH_K3 else ("pinhole-radtan5",))}
    return tuple(model for model in models_of(name) if model not in plain)
