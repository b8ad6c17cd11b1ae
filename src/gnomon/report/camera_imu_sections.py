"""The sections of a camera-IMU report that show the estimate: cameras, IMU, every scalar, noise and solution."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from math import degrees, isfinite

import numpy as np

from ..calibration import Calibration
from ..diagnostics import CameraImuDiagnostics, CamerasDiagnostics, EstimatedParameter, NoiseLevel, SolverStep
from ..geometry.rotation_vector import rotvec_from_rotation
from ..recording import Floats
from . import camera_imu_images as images
from . import camera_imu_motion
from .camera_imu_parameters import (
    baseline_groups,
    camera_groups,
    every_parameter,
    gyroscope_quaternion,
    imu_groups,
    mounting_text,
    other_reading,
    placed_imu_groups,
    plus_minus,
)
from .imu_origin import origin_figure
from .numbers import fixed, number, readable_unit
from .page import Code, Figure, Legend, ParameterGroup, Parameters, Section, Table
from .sections import matrix_text

_AXES = tuple(Legend("line", axis, axis) for axis in "xyz")
_MOST_ROWS = 60
_MOST_PAIRS = 12
_IMU_GROUPS = 8
"""Groups of parameters of an IMU that is wholly estimated."""
_STRONG = 0.5
"""Correlation from which a pair is listed."""
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


def cameras_section(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> Section | None:
    """Return where the cameras sit, and how their clocks run, against the IMU and each other; None without cameras."""
    if not calibration.cameras:
        return None
    first = next(iter(calibration.cameras))
    rig = Figure(
        "The rig",
        camera_imu_motion.rig(calibration),
        _AXES,
        f"The frames of the {'IMUs' if len(calibration.imus) > 1 else 'IMU'} and of the cameras, to scale, "
        f"seen from behind {first}, a little from above. A camera's z looks out of the lens, x to the right of its "
        "image, y down.",
    )
    blocks: list[Figure | Parameters | Code] = [rig]
    for name, camera in calibration.cameras.items():
        blocks += [
            Parameters(
                title=name,
                groups=_marked(camera_groups(calibration, name), calibration, name),
                caption=_rotation_text(camera.T_cam_imu) + _started(diagnostics.initial_time_shift_s.get(name)),
            ),
            Code(
                f"T_cam_imu of {name}: p_cam = T_cam_imu p_imu, in metres", matrix_text("T_cam_imu", camera.T_cam_imu)
            ),
        ]
    groups = baseline_groups(calibration, diagnostics.baselines)
    if groups:
        blocks.append(Parameters(title="Between the cameras", groups=groups))
    placed = [block for name in calibration.imus for block in _placed_imu(calibration, name)]
    several = any(imu.T_imu_body is not None for imu in calibration.imus.values())
    return Section(
        "cameras",
        "Cameras and IMUs" if several else "Cameras and IMU",
        f"Where each camera {'and each further IMU sits on imu0' if several else 'sits on the IMU'}, and by how "
        "much its clock differs, each with its standard deviation σ. Bars show the estimate, whiskers ±2σ.",
        (*blocks, *placed),
    )


def _placed_imu(calibration: Calibration, name: str) -> Iterator[Parameters | Code]:
    """Yield pose and clock of an IMU beside imu0, and the clock of an accelerometer that has its own."""
    groups = _marked(placed_imu_groups(calibration, name), calibration, name)
    if groups:
        yield Parameters(title=name, groups=groups)
    pose = calibration.imus[name].T_imu_body
    if pose is not None:
        title = f"T_imu_body of {name}: p_{name} = T_imu_body p_imu0, in metres"
        yield Code(title, matrix_text("T_imu_body", pose))


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
    axis = ", ".join(fixed(float(v), 4) for v in turn / (angle or 1.0))
    return (
        f"Attitude is what is left after the mounting with {mounting_text(R)}, as angles about the IMU's axes. The "
        f"whole rotation of T_cam_imu is {number(degrees(angle), 6)}° about ({axis})."
    )


def _started(shift_s: float | None) -> str:
    if shift_s is None or not isfinite(shift_s):
        return ""
    return f" The time shift was {number(1e3 * shift_s, 4)} ms at first, found from how fast camera and IMU turn."


def imu_section(calibration: Calibration) -> Section:
    """Return the IMU's parameters in the letters of document B."""
    blocks: list[Parameters | Table | Figure] = []
    several, shown = len(calibration.imus) > 1, 0
    for name, imu in calibration.imus.items():
        caption = gyroscope_quaternion(imu.gyroscope.sensitivity) if imu.gyroscope is not None else ""
        groups = _marked(imu_groups(calibration, name), calibration, name)
        shown += len(groups)
        blocks.append(Parameters(title=name if several else "", groups=groups, caption=caption))
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


def parameters_section(diagnostics: CameraImuDiagnostics | CamerasDiagnostics) -> Section | None:
    """Return every scalar with its sigma, and how they are correlated; None without any."""
    if not diagnostics.parameters:
        return None
    blocks: list[Figure | Table] = [every_parameter(diagnostics)]
    free = [p for p in diagnostics.parameters if p.status in ("estimated", "prior")]
    matrix = np.asarray(diagnostics.correlation, dtype=np.float64)
    if len(free) > 1 and matrix.shape == (len(free), len(free)):
        legend = (Legend("band", "after", "positive"), Legend("band", "heldout", "negative"))
        blocks += [
            Figure(
                "Correlation",
                images.correlation(_groups(free), matrix),
                legend,
                "The stronger the colour, the stronger the correlation; below 0.05 it is left out. What is "
                "strongly correlated is known better together than each on its own.",
            ),
            _strongest(free, matrix),
        ]
    return Section(
        "parameters",
        "Every parameter",
        "All scalars of the batch estimation, and how strongly they depend on each other.",
        blocks,
    )


_SHORTER = (
    ("T_cam_imu.", ""),
    ("T_cam_cam0.", ""),
    ("T_imu_body.", ""),
    ("time_shift_cam_imu", "time_shift"),
    ("distortion_coeffs", "distortion"),
)


def _groups(free: list[EstimatedParameter]) -> list[tuple[str, list[str]]]:
    """Return consecutive parameters of one block under one name, with what tells them apart."""
    groups: list[tuple[str, list[str]]] = []
    for parameter in free:
        name, _, index = parameter.name.partition("[")
        short = reduce(lambda text, pair: text.replace(*pair), _SHORTER, name)
        if not groups or groups[-1][0] != short:
            groups.append((short, []))
        groups[-1][1].append(index.rstrip("]"))
    return groups


def _strongest(free: list[EstimatedParameter], matrix: Floats) -> Table:
    first, second = np.triu_indices(len(free), 1)
    values = np.nan_to_num(matrix[first, second])
    order = np.argsort(-np.abs(values), kind="stable")
    strong = [k for k in order[:_MOST_PAIRS].tolist() if abs(values[k]) >= _STRONG] or order[:1].tolist()
    return Table(
        "Strongest correlations",
        ("parameter", "with", "correlation"),
        tuple((free[int(first[k])].name, free[int(second[k])].name, fixed(float(values[k]), 3)) for k in strong),
    )


def solution_section(diagnostics: CameraImuDiagnostics, *, converged: bool) -> Section:
    """Return noise levels, gravity, and the iterations of the solver."""
    blocks = [
        *noise_table(diagnostics.noise),
        _gravity(diagnostics),
        *steps_table(diagnostics.steps, converged=converged),
    ]
    return Section("solution", "Noise and solution", blocks=blocks)


def noise_table(noise: tuple[NoiseLevel, ...], example: str = "vibration") -> list[Table]:
    """Return noise levels as stated, found and used; none without any."""
    if not noise:
        return []
    return [
        Table(
            "Noise",
            ("of", "stated", "found in the residuals", "used", "unit"),
            tuple(_noise_row(level) for level in noise),
            f"Noise found in the residuals holds all that the model does not explain, such as {example}.",
        )
    ]


def steps_table(steps: tuple[SolverStep, ...], *, converged: bool) -> list[Table]:
    """Return the iterations of the solver; none without any."""
    if not steps:
        return []
    rows = tuple(
        (str(i + 1), number(s.cost, 7), number(s.largest_step, 3), number(s.damping, 2), _ACCEPTED[s.accepted])
        for i, s in enumerate(steps[:_MOST_ROWS])
    )
    return [
        Table(
            "Iterations",
            ("", "cost before", "largest step [σ]", "damping", ""),
            rows,
            "The solver came to rest." if converged else "The solver did not come to rest.",
        )
    ]


_ACCEPTED = {True: "accepted", False: "rejected"}


def _gravity(diagnostics: CameraImuDiagnostics) -> Table:
    values, spreads = diagnostics.gravity_target, diagnostics.gravity_sigma
    cells = [plus_minus(float(v), float(s)) for v, s in zip(values, spreads, strict=True)]
    size = float(np.linalg.norm(values))
    magnitude = next((p for p in diagnostics.parameters if p.name == "gravity.magnitude"), None)
    spread = 0.0 if magnitude is None else magnitude.sigma
    along = int(np.argmax(np.abs(np.nan_to_num(values))))
    cosine = min(abs(float(values[along])) / size, 1.0) if size > 0 else float("nan")
    towards = f"{'−' if values[along] < 0 else '+'}{'xyz'[along]}"
    return Table(
        "Gravity in the frame of the target",
        ("[m/s²]", *"xyz", "size"),
        (("gravity", *cells, plus_minus(size, spread)),),
        f"It points along {towards} of the target, but for {number(degrees(np.arccos(cosine)), 3)}°.",
    )


def _noise_row(level: NoiseLevel) -> tuple[str, ...]:
    sensor, _, what = level.name.partition(".")
    unit = readable_unit(level.unit).replace("sqrt(Hz)", "√Hz")
    return (f"{sensor} {what}", *(number(v, 3) for v in (level.nominal, level.estimated, level.used)), unit)
