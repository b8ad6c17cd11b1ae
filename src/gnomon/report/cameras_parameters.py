"""The parameter tables of a camera calibration: lenses, and where the cameras sit to the first one."""

from dataclasses import replace
from math import degrees, isfinite

import numpy as np

from ..calibration import Calibration
from ..geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ..recording import Floats
from .camera_imu_parameters import lens_group, sigmas_of, triple
from .cameras_lens import field_of_view, focal_at_axis
from .numbers import fixed, number, with_sigma
from .page import Parameter, ParameterGroup

_DEG = degrees(1.0)


def lens_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return the parameters of a lens, what they mean beside them."""
    camera = calibration.cameras[name].camera
    width, height = camera.resolution
    middle = ((width - 1) / 2, (height - 1) / 2)
    wide, high = field_of_view(camera)
    axis = [f"{number(f, 5)} px at the axis, " if camera.projection != "pinhole" else "" for f in focal_at_axis(camera)]
    reads = {
        "fu": f"{axis[0]}sees {number(_DEG * wide, 4)}° across" if isfinite(wide) else axis[0].rstrip(", "),
        "fv": f"{axis[1]}sees {number(_DEG * high, 4)}° downwards" if isfinite(high) else axis[1].rstrip(", "),
        "pu": _beside(float(camera.intrinsics[-2]) - middle[0], "right", "left"),
        "pv": _beside(float(camera.intrinsics[-1]) - middle[1], "below", "above"),
    }
    group = lens_group(calibration, name)
    rows = tuple(replace(row, reads_as=reads.get(row.name, "")) for row in group.rows)
    held = "" if any(row.sigma for row in rows) else "; given, not estimated"
    note = f"{camera.model}, {width} x {height} px{held}"
    return (replace(group, note=note, rows=rows),)


def _beside(offset: float, more: str, less: str) -> str:
    word = more if offset > 0 else less
    return f"{fixed(abs(offset), 1)} px {word} {'of ' if word in ('right', 'left') else ''}the image's middle"


def pose_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return how a camera sits to cam0: where it is, the distance, and how it is turned; none for cam0 itself."""
    camera = calibration.cameras[name]
    if name == camera.body:
        return ()
    values, spreads = pose_numbers(calibration, name)
    place = triple("Position", f"origin of {name} in the frame of {camera.body}", "mm", values[:3], spreads[:3])
    text, sigma = with_sigma(float(values[3]), float(spreads[3]))
    distance = Parameter("baseline", text, sigma, "mm", reads_as="distance of the two")
    turn = triple("Rotation", f"from the axes of {camera.body} to those of {name}", "°", values[4:7], spreads[4:7])
    text, sigma = with_sigma(float(values[7]), float(spreads[7]))
    angle = Parameter("in all", text, sigma, "°")
    shift = triple(
        "Translation", f"last column of {camera.link}: origin of {camera.body} in the frame of {name}", "mm",
        1e3 * camera.T_cam_body[:3, 3], 1e3 * calibration.sigma(f"{name}.{camera.link}.translation"),
    )  # fmt: skip
    return replace(place, rows=(*place.rows, distance)), replace(turn, rows=(*turn.rows, angle)), shift


def pose_numbers(calibration: Calibration, name: str) -> tuple[Floats, Floats]:
    """Return how a camera sits to cam0, (8,), and the sigmas of these numbers.

    They are its position in the frame of cam0 and the distance [mm], the rotation vector of R_cam_cam0 and its angle
    [deg].
    """
    camera = calibration.cameras[name]
    R, t = camera.T_cam_body[:3, :3], camera.T_cam_body[:3, 3]

    def view(x: Floats) -> Floats:
        turned = R @ rotation_from_rotvec(x[:3])
        place = -1e3 * turned.T @ x[3:]
        turn = rotvec_from_rotation(turned) * _DEG
        size = [np.sqrt(np.sum(v * v, keepdims=True)) for v in (place, turn)]
        return np.concatenate([place, size[0], turn, size[1]])

    at = np.concatenate([np.zeros(3), t])
    path = f"{name}.{camera.link}"
    return view(at), sigmas_of(view, at, calibration.covariance(f"{path}.rotation", f"{path}.translation"))
