"""The sections of a camera-IMU report that show the estimate: cameras, IMU, noise and solution."""

from collections.abc import Iterator
from dataclasses import replace
from math import degrees, isfinite

import numpy as np

from ...geometry.rotation_vector import rotvec_from_rotation
from ...recording import Floats
from ...results.calibration import Calibration
from ...results.camera_diagnostics import CameraImuDiagnostics
from ..camera_parameters import baseline_groups, camera_groups, mounting_text, placed_imu_groups
from ..drawing.rig import origin_figure, rig_drawing
from ..estimation import noise_table, steps_table
from ..imu_parameters import groups_over_temperature, gyroscope_quaternion, imu_groups, other_reading
from ..numbers import estimate_text, fixed_text, number_text
from ..page import Code, Figure, Legend, ParameterGroup, ParameterTable, ReportTable, Section
from ..sections import aligned_matrix

_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
_IMU_GROUPS = 8
"""Groups of parameters of an IMU that is wholly estimated."""
_SYMBOLS = {
    "Accelerometer scale": "S_a",
    "Accelerometer misalignment": "M_a",
    "Accelerometer bias": "b_a",
    "Gyroscope scale": "S_g",
    "Gyroscope misalignment": "M_g",
    "Gyroscope bias": "b_g",
    "Gyroscope rotation": "q_bg",
    "Gyroscope g-sensitivity": "B_g",
    "Attitude": "T_cam_imu.rotation",
    "Translation": "T_cam_imu.translation",
    "Position": "T_cam_imu.translation",
    "Time": "time_shift_cam_imu",
}
"""Title of a group of parameters -> their name in the estimation."""


def camera_poses_section(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> Section | None:
    """Return where the cameras sit, and how their clocks run, against the IMU and each other; None without cameras."""
    if not calibration.cameras:
        return None
    first = next(iter(calibration.cameras))
    rig = Figure(
        "The rig",
        rig_drawing(calibration),
        _AXES,
        f"The frames of the {'IMUs' if len(calibration.imus) > 1 else 'IMU'} and of the cameras, to scale, "
        f"seen from behind {first}, a little from above. A camera's z looks out of the lens, x to the right of its "
        "image, y down.",
    )
    blocks: list[Figure | ParameterTable | Code] = [rig]
    for name, camera in calibration.cameras.items():
        blocks += [
            ParameterTable(
                title=name,
                groups=_marked(camera_groups(calibration, name), calibration, name),
                caption=_rotation_text(camera.T_cam_imu) + _started(diagnostics.initial_time_shift_s.get(name)),
            ),
            Code(
                f"T_cam_imu of {name}: p_cam = T_cam_imu p_imu, in metres",
                aligned_matrix("T_cam_imu", camera.T_cam_imu),
            ),
        ]
    groups = baseline_groups(calibration, diagnostics.baselines)
    if groups:
        blocks.append(ParameterTable(title="Between the cameras", groups=groups))
    placed = [block for name in calibration.imus for block in _placed_imu(calibration, name)]
    several = any(imu.T_imu_body is not None for imu in calibration.imus.values())
    return Section(
        "cameras",
        "Cameras and IMUs" if several else "Cameras and IMU",
        f"Where each camera {'and each further IMU sits on imu0' if several else 'sits on the IMU'}, and by how "
        "much its clock differs, each with its standard deviation σ. Bars show the estimate, whiskers ±2σ.",
        (*blocks, *placed),
    )


def _placed_imu(calibration: Calibration, name: str) -> Iterator[ParameterTable | Code]:
    """Yield pose and clock of an IMU beside imu0, and the clock of an accelerometer that has its own."""
    groups = _marked(placed_imu_groups(calibration, name), calibration, name)
    if groups:
        yield ParameterTable(title=name, groups=groups)
    pose = calibration.imus[name].T_imu_body
    if pose is not None:
        title = f"T_imu_body of {name}: p_{name} = T_imu_body p_imu0, in metres"
        yield Code(title, aligned_matrix("T_imu_body", pose))


def _marked(groups: tuple[ParameterGroup, ...], calibration: Calibration, sensor: str) -> tuple[ParameterGroup, ...]:
    """Mark the groups of which the recording does not determine all."""
    held = {name.split("[")[0] for name in calibration.assessment.held_by_prior}
    return tuple(
        replace(group, note="; ".join(part for part in (group.note, "not measured: held by an assumption") if part))
        if f"{sensor}.{_SYMBOLS.get(group.title)}" in held
        else group
        for group in groups
    )


def _rotation_text(T_cam_imu: Floats) -> str:
    R = np.ascontiguousarray(T_cam_imu[:3, :3])
    turn = rotvec_from_rotation(R)
    angle = float(np.linalg.norm(turn))
    axis = ", ".join(fixed_text(float(v), 4) for v in turn / (angle or 1.0))
    return (
        f"Attitude is what is left after the mounting with {mounting_text(R)}, as angles about the IMU's axes. The "
        f"whole rotation of T_cam_imu is {number_text(degrees(angle), 6)}° about ({axis})."
    )


def _started(shift_s: float | None) -> str:
    if shift_s is None or not isfinite(shift_s):
        return ""
    return f" The time shift was {number_text(1e3 * shift_s, 4)} ms at first, found from how fast camera and IMU turn."


def imu_section(calibration: Calibration) -> Section:
    """Return the IMU's parameters in the letters of Krebs."""
    blocks: list[ParameterTable | ReportTable | Figure] = []
    several, shown = len(calibration.imus) > 1, 0
    for name, imu in calibration.imus.items():
        caption = gyroscope_quaternion(imu.gyroscope.sensitivity) if imu.gyroscope is not None else ""
        groups = _marked(imu_groups(calibration, name), calibration, name)
        shown += len(groups)
        groups = (*groups, *groups_over_temperature(calibration, name))
        blocks.append(ParameterTable(title=name if several else "", groups=groups, caption=caption))
        drawing = origin_figure(calibration, name)
        blocks += [] if drawing is None else [drawing]
        table = other_reading(calibration, name)
        if table is not None:
            blocks.append(table)
    lead = (
        "accelerometer = S_a M_a f + b_a and gyroscope = S_g M_g C_bg′ ω + B_g f + b_g, with specific force f and "
        "angular rate ω in the body frame."
    )
    if calibration.assessment.model == "basic":
        lead += " With the basic model only the biases were estimated; everything else is an ideal sensor's."
    elif shown < _IMU_GROUPS * len(calibration.imus):
        lead += " What was held at an ideal sensor's value is left out."
    return Section("imu", "IMU", lead, blocks)


def solution_section(diagnostics: CameraImuDiagnostics, *, converged: bool) -> Section:
    """Return noise levels, gravity, and the iterations of the solver."""
    blocks = [
        *noise_table(diagnostics.noise),
        _gravity(diagnostics),
        *steps_table(diagnostics.steps, converged=converged),
    ]
    return Section("solution", "Noise and solution", blocks=blocks)


def _gravity(diagnostics: CameraImuDiagnostics) -> ReportTable:
    values, spreads = diagnostics.gravity_target, diagnostics.gravity_sigma
    cells = [estimate_text(float(v), float(s)) for v, s in zip(values, spreads, strict=True)]
    size = float(np.linalg.norm(values))
    magnitude = next((p for p in diagnostics.parameters if p.name == "gravity.magnitude"), None)
    spread = 0.0 if magnitude is None else magnitude.sigma
    along = int(np.argmax(np.abs(np.nan_to_num(values))))
    cosine = min(abs(float(values[along])) / size, 1.0) if size > 0 else float("nan")
    towards = f"{'−' if values[along] < 0 else '+'}{'xyz'[along]}"
    return ReportTable(
        "Gravity in the frame of the target",
        ("[m/s²]", *"xyz", "size"),
        (("gravity", *cells, estimate_text(size, spread)),),
        f"It points along {towards} of the target, but for {number_text(degrees(np.arccos(cosine)), 3)}°.",
    )
