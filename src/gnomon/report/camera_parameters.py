"""The parameter tables of cameras: extrinsics as a person measures them, lenses, clocks.

Every sigma is that of the calibration's covariance, carried to the quantity shown by its derivatives.
"""

from dataclasses import replace
from itertools import permutations, product
from math import degrees, isfinite

import numpy as np

from ..geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ..recording import Floats
from ..results.calibration import Calibration
from .cameras.lens import field_of_view, focal_at_axis
from .drawing.figures import AXES
from .imu_parameters import axes_group, sigmas_of
from .numbers import fixed_text, number_text
from .page import Parameter, ParameterGroup, parameter_line

_DEG = degrees(1.0)


def nominal_mounting(R_cam_imu: Floats) -> Floats:
    """Return the rotation (3, 3) nearest to `R_cam_imu` that maps axes to axes: how the camera was meant to sit."""
    candidates: list[Floats] = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.eye(3)[list(order)] * np.array(signs)
        if np.linalg.det(matrix) > 0:
            candidates.append(matrix)
    return max(candidates, key=lambda m: float(np.sum(m * np.nan_to_num(R_cam_imu))))


def mounting_text(R_cam_imu: Floats, whose: str = "camera", body: str = "the IMU") -> str:
    """Return where the axes of a sensor point, such as "camera x, y, z along −y, −z, +x of the IMU"."""
    rows = nominal_mounting(R_cam_imu)
    along = [f"{'−' if row.sum() < 0 else '+'}{AXES[int(np.argmax(np.abs(row)))]}" for row in rows]
    return f"{whose} x, y, z along {', '.join(along)} of {body}"


def camera_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return how one camera sits against imu0 in space and time, and its lens where that was estimated."""
    groups = _pose_groups(
        calibration, f"{name}.T_cam_imu", calibration.cameras[name].T_cam_imu, ("camera", "the camera", "the IMU")
    )
    groups.append(_times(calibration, name))
    if float(np.max(calibration.sigma(f"{name}.intrinsics"), initial=0.0)) > 0:
        groups.append(lens_group(calibration, name))
    return tuple(groups)


def placed_imu_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return how an IMU sits against imu0 in space and time; the clock alone of the accelerometer of imu0."""
    imu = calibration.imus[name]
    groups: list[ParameterGroup] = []
    shifts: list[tuple[str, str, str]] = []
    if imu.T_imu_body is not None:
        groups = _pose_groups(calibration, f"{name}.T_imu_body", imu.T_imu_body, (name, name, "imu0"))
        shifts.append(("time shift", f"{name}.time_shift_imu", f"t_imu0 = t_{name} + time shift"))
    if imu.accelerometer is not None and imu.accelerometer.time_shift_s is not None:
        words = "t_gyroscope = t_accelerometer + time shift"
        shifts.append(("of the accelerometer", f"{name}.accelerometer.time_shift", words))
    rows = [
        parameter_line(label, 1e3 * calibration.parameter(path), 1e3 * calibration.sigma(path), "ms", reads_as=words)
        for label, path, words in shifts
    ]
    return (*groups, ParameterGroup("Time", "", rows)) if rows else tuple(groups)


def _pose_groups(calibration: Calibration, path: str, T: Floats, words: tuple[str, str, str]) -> list[ParameterGroup]:
    """Return attitude, translation and position of p_sensor = T p_body.

    Parameters
    ----------
    path : of the parameter, such as "cam0.T_cam_imu"
    words : what the sensor is called before its axes and elsewhere, and what the body is called
    """
    whose, sensor, body = words
    R, t = T[:3, :3], T[:3, 3]
    nominal = nominal_mounting(R)
    covariance = calibration.covariance(f"{path}.rotation", f"{path}.translation")

    def pose(x: Floats) -> Floats:
        turned = R @ rotation_from_rotvec(x[:3])
        tilt = rotvec_from_rotation(nominal.T @ turned) * _DEG
        return np.concatenate([tilt, 1e3 * x[3:], -1e3 * turned.T @ x[3:]])

    start = np.concatenate([np.zeros(3), t])
    values, spreads = pose(start), sigmas_of(pose, start, covariance)
    titles = (
        ("Attitude", f"turned against {mounting_text(R, whose, body)}", "°"),
        ("Translation", f"origin of {body} in the frame of {sensor}", "mm"),
        ("Position", f"origin of {sensor} in the frame of {body}", "mm"),
    )
    return [
        axes_group(title, note, unit, values[3 * i : 3 * i + 3], spreads[3 * i : 3 * i + 3])
        for i, (title, note, unit) in enumerate(titles)
    ]


def _times(calibration: Calibration, name: str) -> ParameterGroup:
    camera = calibration.cameras[name]
    shift, sigma = 1e3 * camera.time_shift_cam_imu, 1e3 * calibration.sigma(f"{name}.time_shift_cam_imu")
    rows = [parameter_line("time shift", shift, float(sigma), "ms", reads_as="t_imu = t_cam + time shift")]
    delay, spread = 1e6 * camera.camera.line_delay_s, 1e6 * float(calibration.sigma(f"{name}.line_delay"))
    if delay or spread:
        total = number_text(1e-3 * delay * camera.camera.resolution[1], 3)
        rows.append(parameter_line("line delay", delay, spread, "µs per row", reads_as=f"{total} ms per image"))
    return ParameterGroup("Time", "", rows)


def lens_group(calibration: Calibration, name: str) -> ParameterGroup:
    """Return the parameters of a lens, by their symbols."""
    camera = calibration.cameras[name].camera
    names, values = camera.parameter_symbols, camera.parameters
    spreads = np.concatenate([calibration.sigma(f"{name}.{part}") for part in ("intrinsics", "distortion_coeffs")])
    rows: list[Parameter] = []
    for label, value, spread in zip(names, values.tolist(), spreads.tolist(), strict=True):
        rows.append(parameter_line(label, value, spread, "px" if label[0] in "fp" and label[1] in "uv" else ""))
    return ParameterGroup("Lens", f"{camera.projection}, {camera.distortion}", rows)


def baseline_groups(calibration: Calibration, baselines: dict[str, Floats]) -> tuple[ParameterGroup, ...]:
    """Return the relative poses of the cameras, "cam1_cam0" -> T_cam1_cam0 (4, 4)."""
    groups: list[ParameterGroup] = []
    for pair in baselines:
        to, _, source = pair.partition("_")
        if not {to, source} <= set(calibration.cameras):
            continue
        values, spreads = _baseline(calibration, to, source)
        note = f"origin of {source} in the frame of {to}"
        translation = axes_group(f"{to} against {source}", note, "mm", values[:3], spreads[:3])
        distance = parameter_line("distance", values[3], spreads[3], "mm")
        groups.append(replace(translation, rows=(*translation.rows, distance)))
        note = f"from the axes of {source} to those of {to}"
        groups.append(axes_group("Rotation", note, "°", values[4:], spreads[4:]))
    return tuple(groups)


def _baseline(calibration: Calibration, to: str, source: str) -> tuple[Floats, Floats]:
    """Return translation [mm], distance [mm] and rotation vector [deg] of T_to_source, (7,), and their sigmas."""
    T_to, T_source = (calibration.cameras[name].T_cam_imu for name in (to, source))
    paths = [f"{name}.T_cam_imu.{part}" for name in (to, source) for part in ("rotation", "translation")]

    def view(x: Floats) -> Floats:
        R_to = T_to[:3, :3] @ rotation_from_rotvec(x[:3])
        R_source = T_source[:3, :3] @ rotation_from_rotvec(x[6:9])
        R = R_to @ R_source.T
        t = 1e3 * (x[3:6] - R @ x[9:])
        distance = np.sqrt(np.sum(t * t, keepdims=True))
        return np.concatenate([t, distance, rotvec_from_rotation(R) * _DEG])

    at = np.concatenate([np.zeros(3), T_to[:3, 3], np.zeros(3), T_source[:3, 3]])
    return view(at), sigmas_of(view, at, calibration.covariance(*paths))


def lens_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return the parameters of a lens, what they mean beside them."""
    camera = calibration.cameras[name].camera
    width, height = camera.resolution
    middle = ((width - 1) / 2, (height - 1) / 2)
    wide, high = field_of_view(camera)
    axis = [
        f"{number_text(f, 5)} px at the axis, " if camera.projection != "pinhole" else "" for f in focal_at_axis(camera)
    ]
    reads = {
        "fu": f"{axis[0]}sees {number_text(_DEG * wide, 4)}° across" if isfinite(wide) else axis[0].rstrip(", "),
        "fv": f"{axis[1]}sees {number_text(_DEG * high, 4)}° downwards" if isfinite(high) else axis[1].rstrip(", "),
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
    return f"{fixed_text(abs(offset), 1)} px {word} {'of ' if word in ('right', 'left') else ''}the image's middle"


def pose_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return how a camera sits to cam0: where it is, the distance, and how it is turned; none for cam0 itself."""
    camera = calibration.cameras[name]
    if name == camera.body:
        return ()
    values, spreads = pose_numbers(calibration, name)
    place = axes_group("Position", f"origin of {name} in the frame of {camera.body}", "mm", values[:3], spreads[:3])
    distance = parameter_line("baseline", values[3], spreads[3], "mm", reads_as="distance of the two")
    turn = axes_group("Rotation", f"from the axes of {camera.body} to those of {name}", "°", values[4:7], spreads[4:7])
    angle = parameter_line("in all", values[7], spreads[7], "°")
    shift = axes_group(
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
