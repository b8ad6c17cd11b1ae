"""The parameter tables of a rig: IMUs in their own axes; cameras as a person measures them, lenses, clocks."""

from collections.abc import Callable
from dataclasses import replace
from itertools import permutations, product
from math import degrees, isfinite

import numpy as np

from ..geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from ..models.forms import in_own_axes
from ..recording import Floats
from ..results.calibration import Calibration
from ..units import STANDARD_GRAVITY_M_S2
from .drawing.figures import AXES
from .numbers import MISSING, estimate_text, fixed_text, number_text
from .page import Parameter, ParameterGroup, ReportTable, parameter_line, with_bars

_DEG = degrees(1.0)
_STEP = 1e-6
NOT_ABOVE = "within its σ"
"""Marks an entry that the recording does not tell from an ideal sensor's (the rule of Krebs, section 5.2)."""


def sigmas_of(view: Callable[[Floats], Floats], at: Floats, covariance: Floats) -> Floats:
    """Return the sigmas (m,) of view(x) at x (n,) for the covariance (n, n) of x, by central differences."""
    columns: list[Floats] = []
    for i, value in enumerate(at):
        step = np.zeros(len(at))
        step[i] = _STEP * max(abs(float(value)), 1.0)
        columns.append((view(at + step) - view(at - step)) / (2 * step[i]))
    slopes = np.stack(columns, axis=1)
    return np.sqrt(np.fmax(np.diag(slopes @ covariance @ slopes.T), 0.0))


def axes_group(title: str, note: str, unit: str, values: Floats, spreads: Floats) -> ParameterGroup:
    """Return a group of angles about the axes [°], or of lengths along them."""
    word = "about" if unit == "°" else "along"
    rows: list[Parameter] = []
    for axis, value, spread in zip(AXES, values.tolist(), spreads.tolist(), strict=True):
        reads_as = f"{fixed_text(1e3 * value / _DEG, 2)} mrad" if unit == "°" else ""
        rows.append(parameter_line(f"{word} {axis}", value, spread, unit, reads_as=reads_as))
    return ParameterGroup(title, note, with_bars(rows, _pairs(values, spreads)))


def _pairs(values: Floats, spreads: Floats) -> list[tuple[float, float]]:
    return list(zip(values.tolist(), spreads.tolist(), strict=True))


def imu_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return an IMU in the letters of Krebs, chapter 4: S, M, b of both triads, q_bg and B_g.

    Groups that were held at an ideal sensor's values are left out.
    """
    return tuple(
        group
        for group in _all_imu_groups(calibration, name)
        if any(row.sigma or row.bar is not None or row.value == MISSING for row in group.rows)
    )


def _all_imu_groups(calibration: Calibration, name: str) -> list[ParameterGroup]:
    imu = calibration.imus[name]
    path = f"{name}.accelerometer"
    triad = _lower_triad(imu.required_accelerometer.sensitivity)
    spreads = sigmas_of(
        _lower_triad, imu.required_accelerometer.sensitivity.ravel(), calibration.covariance(f"{path}.sensitivity")
    )
    groups = [*_own_triad("Accelerometer", "a", triad, spreads), _own_bias(calibration, path, "Accelerometer", "a")]
    groups += _lever_arms(calibration, path)
    if imu.gyroscope is None:
        return groups
    path = f"{name}.gyroscope"
    at = imu.gyroscope.sensitivity.ravel()
    own, spreads = _gyroscope(at), sigmas_of(_gyroscope, at, calibration.covariance(f"{path}.sensitivity"))
    groups += [*_own_triad("Gyroscope", "g", own[:6], spreads[:6]), _own_bias(calibration, path, "Gyroscope", "g")]
    turned = axes_group(
        "Gyroscope rotation", "C_bg, from the gyroscope's axes to the body's", "°", own[6:], spreads[6:]
    )
    groups.append(_marked(turned, own[6:], spreads[6:]))
    groups.append(_own_g_sensitivity(calibration, path, imu.gyroscope.g_sensitivity, imu.gyroscope.unit))
    return groups


def _lever_arms(calibration: Calibration, path: str) -> list[ParameterGroup]:
    """Return where the accelerometers that are not the body's origin lie; nothing where that was not estimated."""
    places = calibration.imus[path.split(".", maxsplit=1)[0]].required_accelerometer.lever_arms_m
    if places is None:
        return []
    spreads = calibration.sigma(f"{path}.lever_arms_m")
    return [
        axes_group(f"Place of the {axis} accelerometer", "from the body's origin", "mm", 1e3 * place, 1e3 * spread)
        for axis, place, spread in zip(AXES, places, spreads, strict=True)
        if spread.any()
    ]


def gyroscope_quaternion(sensitivity: Floats) -> str:
    """Return a sentence on the rotation C_bg, as the quaternion of Krebs and its angle; none without rotation."""
    rotvec = _gyroscope(sensitivity.ravel())[6:] / _DEG
    angle = float(np.linalg.norm(rotvec))
    if not angle > 0:
        return ""
    axis = np.sin(angle / 2) * rotvec / angle
    numbers = ", ".join(fixed_text(v, 6) for v in (np.cos(angle / 2), *axis.tolist()))
    return f"As a quaternion, C_bg is q_bg = ({numbers}), real part first: {number_text(degrees(angle), 3)}° in all."


def _lower_triad(sensitivity: Floats) -> Floats:
    """Return the diagonal of S and yz, zy, zx of M, (6,), of S M."""
    matrix = np.reshape(sensitivity, (3, 3))
    S = np.diag(matrix)
    return np.concatenate([S, (matrix / S[:, None])[[1, 2, 2], [0, 0, 1]]])


def _gyroscope(sensitivity: Floats) -> Floats:
    """Return S_g, M_g, and the rotation vector of C_bg [deg], (9,), of S_g M_g C_bg'."""
    lower, C_gb = in_own_axes(np.reshape(sensitivity, (3, 3)), "accel-x")
    return np.concatenate([_lower_triad(lower), rotvec_from_rotation(C_gb.T) * _DEG])


def _own_triad(title: str, letter: str, values: Floats, spreads: Floats) -> tuple[ParameterGroup, ParameterGroup]:
    percents, percent_spreads = 100 * (values[:3] - 1), 100 * spreads[:3]
    scales: list[Parameter] = []
    for i, axis in enumerate(AXES):
        reads_as = f"{estimate_text(float(percents[i]), float(percent_spreads[i]), sign=True)}\u00a0%"
        scales.append(parameter_line(f"scale {axis}", values[i], spreads[i], "", reads_as=reads_as))
    scale = ParameterGroup(
        f"{title} scale", f"S_{letter}; bars: deviation from one",
        with_bars(scales, _pairs(percents, percent_spreads)),
    )  # fmt: skip
    tilts: list[Parameter] = []
    for entry, value, spread in zip(("yz", "zy", "zx"), 1e3 * values[3:], 1e3 * spreads[3:], strict=True):
        reads_as = f"{fixed_text(float(value) * 1e-3 * _DEG, 3, sign=True)}°"
        tilts.append(
            parameter_line(f"entry {entry}", float(value), float(spread), "mrad", reads_as=reads_as, sign=True)
        )
    tilt = ParameterGroup(
        f"{title} misalignment", f"M_{letter} = [1 0 0; yz 1 0; zy zx 1]",
        with_bars(tilts, _pairs(1e3 * values[3:], 1e3 * spreads[3:])),
    )  # fmt: skip
    return (_marked(scale, percents, percent_spreads), _marked(tilt, values[3:], spreads[3:]))


def _marked(group: ParameterGroup, values: Floats, spreads: Floats) -> ParameterGroup:
    """Mark the rows whose deviation from an ideal sensor is not above its sigma."""
    rows = [
        replace(row, note=NOT_ABOVE) if spread > 0 and abs(value) <= spread else row
        for row, value, spread in zip(group.rows, values.tolist(), spreads.tolist(), strict=True)
    ]
    return replace(group, rows=rows)


def _own_bias(calibration: Calibration, path: str, title: str, letter: str) -> ParameterGroup:
    values, spreads = calibration.parameter(f"{path}.bias"), calibration.sigma(f"{path}.bias")
    gyroscope = letter == "g"
    rows: list[Parameter] = []
    for axis, value, spread in zip(AXES, values.tolist(), spreads.tolist(), strict=True):
        physical = f"{number_text(value * _DEG, 3)}\u00a0°/s" if gyroscope else f"{_milli_g(value)}\u00a0mg"
        unit = "rad/s" if gyroscope else "m/s²"
        rows.append(parameter_line(f"bias {axis}", value, spread, unit, reads_as=physical, sign=True))
    note = f"b_{letter}, mean over the recording"
    return ParameterGroup(f"{title} bias", note, with_bars(rows, _pairs(values, spreads)))


def _milli_g(value: float) -> str:
    return number_text(1e3 * value / STANDARD_GRAVITY_M_S2, 3)


def _own_g_sensitivity(calibration: Calibration, path: str, values: Floats, unit: str) -> ParameterGroup:
    flat, spreads = 1e3 * values.ravel(), 1e3 * calibration.sigma(f"{path}.g_sensitivity").ravel()
    rows: list[Parameter] = []
    for (i, j), value, spread in zip(np.ndindex(3, 3), flat.tolist(), spreads.tolist(), strict=True):
        per_g = f"{number_text(value * 1e-3 * _DEG * STANDARD_GRAVITY_M_S2, 3)} °/s per g"
        name = f"{AXES[i]} by force {AXES[j]}"
        rows.append(parameter_line(name, value, spread, f"m{unit} per m/s²", reads_as=per_g, sign=True))
    group = ParameterGroup(
        "Gyroscope g-sensitivity",
        "B_g, on the specific force in the body frame (Krebs, chapter 4)",
        with_bars(rows, _pairs(flat, spreads)),
    )
    return _marked(group, flat, spreads)


def other_reading(calibration: Calibration, name: str) -> ReportTable | None:
    """Return B_g as chapter 3 of Krebs reads it, on the force in the gyroscope's axes; None where it is zero."""
    gyroscope = calibration.imus[name].gyroscope
    if gyroscope is None or not gyroscope.g_sensitivity.any():
        return None

    def view(x: Floats) -> Floats:
        _, C_gb = in_own_axes(np.reshape(x[:9], (3, 3)), "accel-x")
        return 1e3 * (np.reshape(x[9:], (3, 3)) @ C_gb.T).ravel()

    at = np.concatenate([gyroscope.sensitivity.ravel(), gyroscope.g_sensitivity.ravel()])
    paths = (f"{name}.gyroscope.sensitivity", f"{name}.gyroscope.g_sensitivity")
    values, spreads = view(at).reshape(3, 3), sigmas_of(view, at, calibration.covariance(*paths)).reshape(3, 3)
    rows = tuple(
        (f"rate about {axis}", *(estimate_text(v, s, sign=True) for v, s in _pairs(values[i], spreads[i])))
        for i, axis in enumerate(AXES)
    )
    return ReportTable(
        "g-sensitivity on the force in the gyroscope's axes (Krebs, chapter 3)",
        (f"[m{gyroscope.unit} per m/s²]", *(f"force along {axis}" for axis in AXES)),
        rows,
        "B_g C_bg: it acts on the force in the gyroscope's own axes, which the rotation q_bg turns. The sensor "
        "is the same; Kalibr's A is this matrix too.",
    )


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
    from .cameras.lens import field_of_view, focal_at_axis  # loaded where there is a camera

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
