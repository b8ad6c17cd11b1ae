"""The report of a camera-IMU calibration: its page, and the sections that show the estimate."""

from collections.abc import Iterator
from dataclasses import replace
from math import degrees, isfinite

import numpy as np

from ...geometry.rotations import rotvec_from_rotation
from ...recording import Floats
from ...results.calibration import Calibration, CameraImuFit
from ...results.camera_diagnostics import CameraImuDiagnostics
from ..camera_images import images_section
from ..certificate import calibration_page, groups_over_temperature
from ..corners import corner_view
from ..drawing.rig import origin_figure, rig_drawing
from ..numbers import MISSING, estimate_text, fixed_text, number_text
from ..page import (
    FRAMES,
    Code,
    Figure,
    KeyNumber,
    Legend,
    ParameterGroup,
    ParameterTable,
    ReportPage,
    ReportTable,
    Section,
    aligned_matrix,
    assumptions_section,
    gravity_text,
    provenance_section,
)
from ..rig_parameters import (
    baseline_groups,
    camera_groups,
    gyroscope_quaternion,
    imu_groups,
    mounting_text,
    other_reading,
    placed_imu_groups,
)
from ..trust import noise_table, parameters_section, steps_table, trust_section
from . import evidence

_MODELS = {
    "basic": "the IMU is ideal but for its biases",
    "scale-misalignment": "scale, misalignment, gyroscope rotation",
    "full": "scale, misalignment, gyroscope rotation, g-sensitivity",
}


def camera_imu_page(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> ReportPage:
    """Return the page of a camera-IMU calibration."""
    fit = calibration.assessment.camera_imu
    word = "corner" if diagnostics.scene is None else "landmark"
    imaged = any(corners.quality is not None for corners in diagnostics.corners.values())
    views = {name: corner_view(corners, word) for name, corners in diagnostics.corners.items()}
    parts = (
        camera_poses_section(calibration, diagnostics),
        imu_section(calibration),
        trust_section(calibration.assessment, diagnostics.trust),
        evidence.fit_section(diagnostics),
        evidence.camera_imu_residuals_section(diagnostics, views),
        images_section(diagnostics.corners) if imaged else None,
        evidence.camera_imu_coverage_section(diagnostics, views),
        evidence.scene_section(diagnostics),
        evidence.biases_section(diagnostics),
        parameters_section(diagnostics),
        solution_section(diagnostics, converged=fit is None or fit.converged),
        _assumptions(calibration, diagnostics),
        _use(calibration),
        provenance_section(calibration.provenance),
    )
    plots = ("residuals", "coverage", "cameras")
    numbers = _key_numbers(calibration, diagnostics)
    return calibration_page("Camera-IMU calibration", calibration, numbers, parts, plots)


def _key_numbers(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> tuple[KeyNumber, ...]:
    fit = calibration.assessment.camera_imu
    numbers = [*_fit_numbers(fit, before_board=diagnostics.scene is None)] if fit is not None else []
    shifts = {name: _in_ms(calibration, f"{name}.time_shift_cam_imu") for name in calibration.cameras}
    if shifts:
        first, *others = shifts
        note = "t_imu = t_cam + time shift" + "".join(f"; {name} {shifts[name]}" for name in others)
        numbers.append(KeyNumber(f"Time shift of {first}", shifts[first], note))
        numbers.append(_placed(calibration))
    for name, imu in calibration.imus.items():
        if imu.T_imu_body is not None:
            value = _in_ms(calibration, f"{name}.time_shift_imu")
            note = f"t_imu0 = t_{name} + time shift"
            numbers.append(KeyNumber(f"Time shift of {name}", value, note))
    model, added = calibration.assessment.model, calibration.assessment.trust.added
    note = _MODELS.get(model, "") + (f"; by evidence {', '.join(added)}" if added else "")
    numbers.append(KeyNumber("Model", model, note))
    pieces = f" in {diagnostics.segments} pieces" if diagnostics.segments > 1 else ""
    duration = number_text(fit.duration_s, 4) if fit is not None else MISSING
    numbers.append(
        KeyNumber(
            "Trajectory",
            f"{duration}\u00a0s{pieces}",
            f"{number_text(diagnostics.knots_per_s, 3)} knots/s, spline of order {diagnostics.spline_order}",
        )
    )
    return tuple(numbers)


def _fit_numbers(fit: CameraImuFit, *, before_board: bool) -> tuple[KeyNumber, KeyNumber]:
    corners = sum(fit.corners_used.values())
    squares = [fit.corners_used[name] * rms**2 for name, rms in fit.reprojection_rms_px.items() if isfinite(rms)]
    pooled = float(np.sqrt(sum(squares) / corners)) if corners and squares else float("nan")
    each = "; ".join(f"{name} {number_text(rms, 3)}" for name, rms in fit.reprojection_rms_px.items())
    frames = "; ".join(f"{name} {used} of {fit.frames_found[name]}" for name, used in fit.frames_used.items())
    several = len(fit.frames_used) > 1
    what, where = ("corners", "the board was") if before_board else ("sightings of landmarks", "landmarks were")
    return (
        KeyNumber(
            "Reprojection rms",
            f"{number_text(pooled, 3, trim=False)}\u00a0px",
            f"per axis, of {corners} {what}" + (f": {each}" if several else ""),
        ),
        KeyNumber(
            "Frames used",
            f"{sum(fit.frames_used.values())} of {sum(fit.frames_found.values())}",
            frames if several else f"of those in which {where} found",
        ),
    )


def _in_ms(calibration: Calibration, path: str) -> str:
    return f"{estimate_text(1e3 * float(calibration.parameter(path)), 1e3 * float(calibration.sigma(path)))}\u00a0ms"


def _placed(calibration: Calibration) -> KeyNumber:
    """Return how well the cameras' places are known: the largest sigma of an axis."""

    def worst(part: str) -> float:
        found = [float(np.max(calibration.sigma(f"{name}.T_cam_imu.{part}"))) for name in calibration.cameras]
        return max((s for s in found if isfinite(s)), default=float("nan"))

    translation, rotation = worst("translation"), worst("rotation")
    value = f"{number_text(1e3 * translation, 2)}\u00a0mm, {number_text(degrees(rotation), 2)}°"
    note = "largest σ of an axis of T_cam_imu" + (", of all cameras" if len(calibration.cameras) > 1 else "")
    return KeyNumber("σ of position and attitude", value, note)


def _assumptions(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> Section:
    gravity = calibration.gravity
    frame = FRAMES.get(calibration.frame, calibration.frame)
    status = {parameter.name: parameter.status for parameter in diagnostics.parameters}
    points = [
        f"Gravity is {gravity_text(gravity)} ({gravity.source}). Where accelerometer scales are estimated, a relative "
        "error of gravity is the same relative error of them.",
        f"The body frame is {calibration.frame}: {frame}. {_origin(calibration)}",
    ]
    if diagnostics.scene is not None:
        points.append(
            "The scene stood still. How large it is follows from the accelerometer and from gravity alone, and with it "
            "the translations."
        )
    if status.get("target.scale", "fixed") == "fixed":
        shape = "" if "board" in calibration.assessment.trust.added else "flat and "
        points.append(
            f"The board is {shape}as large as its file says. An error of its size is the same relative error of every "
            "length, the translations included."
        )
    for name, camera in calibration.cameras.items():
        points += _camera_points(calibration, name, camera.camera.line_delay_s)
    return assumptions_section(calibration, points)


def _origin(calibration: Calibration) -> str:
    imu = next(iter(calibration.imus.values()))
    arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
    if arms is None:
        return "Its origin is where accelerometer and gyroscope sit, taken as one point."
    where = "a point between its accelerometers" if imu.origin is None else imu.origin.words
    return f"Its origin is {where}; where each accelerometer lies from it was estimated."


def _camera_points(calibration: Calibration, name: str, line_delay_s: float) -> list[str]:
    camera = calibration.cameras[name].camera
    points: list[str] = []
    if not calibration.sigma(f"{name}.intrinsics").any():
        lens = camera.projection if camera.distortion == "none" else f"{camera.projection}-{camera.distortion}"
        points.append(f"The intrinsics of {name} ({lens}) are as given; they were not estimated.")
    if not float(calibration.sigma(f"{name}.line_delay")):
        points.append(
            f"All rows of an image of {name} are exposed at once."
            if line_delay_s == 0
            else f"The rows of an image of {name} follow each other by {number_text(1e6 * line_delay_s, 4)} µs, as "
            "given."
        )
    return points


_FILES = """\
calibration.yaml      everything, with covariance, findings and origin
camchain-imucam.yaml  cameras: T_cam_imu, timeshift_cam_imu, as Kalibr writes them
imu.yaml              IMU: M, A, C_gyro_i, T_i_b, time_offset, as Kalibr writes them
results-imucam.txt    summary, as Kalibr writes it
trajectory.txt        path of the IMU in the target's frame (TUM: t x y z qx qy qz qw)
diagnostics.npz       the numbers behind the figures of this report"""


def _of_others(calibration: Calibration) -> str:
    """Return what to do with the pose and the clock of an IMU beside imu0."""
    other = next((name for name, imu in calibration.imus.items() if imu.T_imu_body is not None), None)
    if other is None:
        return ""
    return (
        f'\n{other} = calibration.imus["{other}"]\n'
        f"p_{other} = {other}.T_imu_body @ p_imu0                     # homogeneous, in metres\n"
        f"t_imu0 = t_{other} + {other}.time_shift_s                   # in seconds"
    )


def _use(calibration: Calibration) -> Section:
    camera = next(iter(calibration.cameras), "cam0")
    blocks = [
        Code("Files beside this report", _FILES),
        Code(
            "In Python",
            "import gnomon\n\n"
            'calibration = gnomon.load("calibration.yaml")\n'
            f"{camera} = calibration.cameras[{camera!r}]\n"
            f"p_cam = {camera}.T_cam_imu @ p_imu                    # homogeneous, in metres\n"
            f"t_imu = t_cam + {camera}.time_shift_cam_imu           # in seconds\n"
            f'sigma = calibration.sigma("{camera}.T_cam_imu.translation")\n'
            'samples = gnomon.read("imu0.csv").imus["imu0"]\n'
            'calibrated = calibration.imus["imu0"].apply(samples)  # m/s² and rad/s in the body frame'
            + _of_others(calibration),
        ),
    ]
    for name, imu in calibration.imus.items():
        of = f" of {name}" if len(calibration.imus) > 1 else ""
        text = "m = S f + b          f = S⁻¹ (m − b)        S = S_a M_a\n\n" + aligned_matrix(
            "S", imu.required_accelerometer.sensitivity
        )
        text += "\n\n" + aligned_matrix("b", imu.required_accelerometer.bias[:, None])
        blocks.append(Code(f"Accelerometer{of}: m and f in m/s²", text))
        if imu.gyroscope is not None:
            text = "y = S ω + G f + b    ω = S⁻¹ (y − b − G f)    S = S_g M_g C_bg′, G = B_g\n\n"
            text += (
                aligned_matrix("S", imu.gyroscope.sensitivity)
                + "\n\n"
                + aligned_matrix("G", imu.gyroscope.g_sensitivity)
            )
            text += "\n\n" + aligned_matrix("b", imu.gyroscope.bias[:, None])
            blocks.append(Code(f"Gyroscope{of}: y and ω in rad/s, f in m/s²", text))
    return Section(
        "use",
        "How to use it",
        "T_cam_imu takes points from the body frame of the IMU to a camera, the time shift takes timestamps from the "
        "camera's clock to the IMU's, and the IMU's matrices turn what it reads into specific force and angular rate.",
        blocks,
    )


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
