"""Which formats of estimators can hold a lens."""

from collections.abc import Iterable

from ..errors import OptionError
from ..findings import listed
from ..models.camera import Camera
from ..models.lens_programs import PROGRAMS, knows

_ANY = ("json", "csv")


def formats_of(cameras: Iterable[Camera]) -> tuple[str, ...]:
    """Return the formats that hold all of these lenses, json and csv where none of an estimator does."""
    lenses = tuple(cameras)
    return tuple(name for name in PROGRAMS if all(knows(name, lens) for lens in lenses)) or _ANY


def unknown_lens(name: str, camera: Camera, known: str) -> OptionError:
    """Return the error of a lens that a program does not know, with the formats that can hold it.

    Parameters
    ----------
    name : of the camera
    known : who knows what, such as "OKVIS knows pinhole with radtan"
    """
    others = listed(formats_of([camera]))
    return OptionError(
        f"{name} is {camera.model}, and {known}. Calibrate the camera with one of these, or convert to {others}."
    )
