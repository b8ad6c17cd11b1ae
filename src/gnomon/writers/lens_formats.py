"""Which formats of estimators can hold a lens."""

from collections.abc import Iterable, Mapping

from ..errors import OptionError
from ..findings import listed
from ..models.camera import Camera
from ..models.lens_names import DistortionName, ProjectionName

_PLAIN = ("none",)
_LENSES: Mapping[str, Mapping[ProjectionName, tuple[DistortionName, ...]]] = {
    "kalibr": {
        "pinhole": ("none", "radtan", "radtan5", "equidistant", "fov"),
        "omni": ("none", "radtan"),
        "eucm": _PLAIN,
        "ds": _PLAIN,
    },
    "openvins": {"pinhole": ("none", "radtan", "radtan5", "equidistant")},
    "basalt": {
        "pinhole": ("none", "radtan", "radtan5", "equidistant"),
        "omni": _PLAIN,
        "eucm": _PLAIN,
        "ds": _PLAIN,
    },
}
"""What the programs read; radtan5 as the nearest radtan where they know no k3."""

_ANY = ("json", "csv")


def formats_of(cameras: Iterable[Camera]) -> tuple[str, ...]:
    """Return the formats that hold all of these lenses, json and csv where none of an estimator does."""
    lenses = tuple(cameras)
    return tuple(name for name in _LENSES if all(_holds(name, lens) for lens in lenses)) or _ANY


def unknown_lens(name: str, camera: Camera, knows: str) -> OptionError:
    """Return the error of a lens that a program does not know, with the formats that can hold it.

    Parameters
    ----------
    name : of the camera
    knows : who knows what, such as "OKVIS knows pinhole with radtan"
    """
    others = listed(formats_of([camera]))
    return OptionError(
        f"{name} is {camera.model}, and {knows}. Calibrate the camera with one of these, or convert to {others}."
    )


def _holds(name: str, camera: Camera) -> bool:
    if name == "basalt" and camera.projection == "omni" and float(camera.intrinsics[0]) < 0:
        return False  # its ucm has alpha = xi / (1 + xi) of 0 to 1
    return camera.distortion in _LENSES[name].get(camera.projection, ())
