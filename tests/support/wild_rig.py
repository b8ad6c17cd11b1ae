"""Wild cases of cameras and an IMU."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.options import CameraImuOptions
from gnomon.recording import CameraFrames, ImuSamples, TriadSamples
from gnomon.recording.samples import ImuNoise
from gnomon.simulate.camera_imu import simulate_camera_imu
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.scenarios.cameras import INTRINSICS

from .fault_recordings import seconds, warming
from .wild import WildCase, in_body_frame, log_uniform, reread, signed_permutation

Edit = Callable[[WildCase, np.random.Generator], WildCase]

_LENS = ("intrinsics-doubtful", "distortion", "reprojection", "lens-found", "model-incomplete", "target-scale")
_BOARD = ("target-scale", "board-size", "intrinsics-doubtful")
_SEEN = ("board-rare", "board-small", "frames-few", "stream-short", "image-coverage", "corners-few", "frames-left-out")
_MOTION = ("rotation-one-axis", "motion-slow", "imu-still", "not-observable", "imprecise", "hardly-observable")
_IMU_RATE = ("imu-rate", "vibration", "knots")
_SHUTTER = ("rolling-shutter",)
_RARE = ("frame-rate",)
_CLIPS = ("saturation",)
_GAPS = ("gaps", "trajectory-cut", "frame-gaps", "frames-left-out")

_GRAVITY_WRONG = 0.01  # m/s^2
_RARE_HZ = 4.0  # frames a second, below which a motion by hand is not followed
_LINE_DELAYS_S = 5e-6, 1e-4
"""Shorter ones shift the time by up to a millisecond, and too short or noisy a recording does not show them."""
_LENSES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "radtan": ((460.0, 458.5, 322.4, 237.1), (-0.28, 0.075, 0.0002, -0.00015)),
    "equidistant": ((300.0, 299.4, 318.0, 243.0), (-0.01, 0.02, -0.015, 0.003)),
    "none": ((520.0, 519.0, 318.0, 243.0), ()),
    "fov": ((330.0, 329.0, 318.0, 243.0), (0.9,)),
    "omni": ((0.9, 800.0, 798.0, 318.0, 243.0), (-0.2, 0.05, 0.0, 0.0)),
    "eucm": ((0.6, 1.1, 330.0, 329.0, 318.0, 243.0), ()),
    "ds": ((-0.2, 0.59, 300.0, 299.0, 318.0, 243.0), ()),
}


def wild_rig(seed: int) -> WildCase:
    """Draw a wild case of cameras and an IMU."""
    rng = np.random.default_rng([seed, 12])
    scenario, said = _scenario(rng)
    simulation = simulate_camera_imu(scenario, seed)
    case = WildCase(
        kind="camera-imu",
        seed=seed,
        recording=simulation.recording,
        target=simulation.target,
        options=CameraImuOptions(),
        imus=dict(simulation.truth.imus),
        cameras=dict(simulation.truth.cameras),
        oddities=(),
        wandering={},
    )
    for name, codes in said:
        case = case.with_oddity(name, *codes)
    spread = {"b_a": simulation.b_a, "b_g": simulation.b_g}
    case = replace(
        case,
        wandering={
            "imu0.accelerometer.bias": np.ptp(spread["b_a"], axis=0),
            "imu0.gyroscope.bias": np.ptp(spread["b_g"], axis=0),
        },
    )
    for edit, share in _EDITS:
        if rng.random() < share:
            case = edit(case, rng)
    case = _with_options(case, scenario, rng)
    imus, cameras = in_body_frame(case.imus["imu0"], case.cameras)
    return replace(case, imus=imus, cameras=cameras)


Said = list[tuple[str, tuple[str, ...]]]


def _scenario(rng: np.random.Generator) -> tuple[CameraImuScenario, Said]:
    """Draw what every rig has and what few have; with it, what was drawn and the findings that it may cause."""
    chosen, width, said = _usual(rng)
    duration, size, coeffs = chosen["duration_s"], chosen["target_size_m"], chosen["distortion_coeffs"]

    def odd(share: float, name: str, value: Any, codes: tuple[str, ...], **also: Any) -> None:
        if rng.random() < share:
            chosen[name] = value
            chosen.update(also)
            said.append((f"{name} {value}", codes))

    odd(0.15, "clock_offset_s", float(rng.normal(0, 1e4)), ())
    odd(0.1, "distance_m", float(width * log_uniform(rng, 0.3, 6.0)), _SEEN)
    odd(0.1, "target_scale", float(1 + 0.1 * rng.normal()), _BOARD)
    odd(0.03, "target_scale", float(rng.choice([0.001, 0.1, 10.0, 25.4, 1000.0])), _BOARD)
    odd(0.08, "corner_offset_m", log_uniform(rng, 1e-4, 0.05 * size), ("corners-found", "model-incomplete"))
    odd(
        0.06,
        "board_bow_m",
        log_uniform(rng, 1e-4, 0.05 * width),
        ("board-bow", "corners-found", "model-incomplete", "lens-found"),
    )
    odd(0.1, "focal_error", float(0.05 * rng.normal()), _LENS)
    odd(0.08, "principal_point_error_px", float(15 * rng.normal()), _LENS)
    if coeffs:
        odd(0.1, "distortion_error", tuple((0.3 * np.array(coeffs) * rng.normal(size=len(coeffs))).tolist()), _LENS)
    odd(0.12, "line_delay_s", log_uniform(rng, *_LINE_DELAYS_S), _SHUTTER, known_line_delay=bool(rng.random() < 0.4))
    odd(0.1, "accelerometer_arms_m", tuple((0.03 * rng.normal(size=6)).tolist()), ("lever-arms-found",))
    odd(0.1, "scale_range", log_uniform(rng, 0.01, 0.8), ("unit",))
    odd(0.1, "misalignment_range", log_uniform(rng, 0.01, 0.5), ())
    odd(0.1, "gyroscope_rotation_range", log_uniform(rng, 0.01, 3.0), ("axes-differ",))
    odd(0.1, "g_sensitivity_range", log_uniform(rng, 1e-4, 1e-2), ())
    odd(0.1, "accelerometer_bias_range", log_uniform(rng, 0.1, 30.0), ("gravity-magnitude", "imu-bias"))
    odd(0.1, "gyroscope_bias_range", log_uniform(rng, 0.01, 5.0), ("rate-magnitude", "imu-bias"))
    odd(0.05, "accelerometer_range", log_uniform(rng, 10.0, 40.0), _CLIPS)
    odd(0.05, "gyroscope_range", log_uniform(rng, 0.3, 8.0), _CLIPS)
    odd(0.08, "dropped_samples", log_uniform(rng, 1e-3, 0.5), _GAPS)
    odd(0.08, "imu_jitter_s", log_uniform(rng, 1e-3, 0.3) / chosen["imu_rate_hz"], ("jitter", "time-backward"))
    odd(0.08, "imu_gaps_s", tuple((float(t), log_uniform(rng, 0.01, 1.0)) for t in rng.uniform(0, duration, 3)), _GAPS)
    odd(0.2, "outliers", log_uniform(rng, 1e-3, 0.3), ("corners-outlying",), outlier_px=log_uniform(rng, 1.0, 50.0))
    odd(0.08, "dropped_frames", log_uniform(rng, 1e-2, 0.9), _SEEN)
    odd(0.08, "late_frames", log_uniform(rng, 1e-2, 0.5), ("frames-late", "frame-jitter", "frames-left-out"))
    odd(0.08, "shifted_frames", log_uniform(rng, 1e-2, 0.5), ("frames-left-out",), shift_px=log_uniform(rng, 1, 50))
    late_s = log_uniform(rng, 1e-4, 0.2) / chosen["camera_rate_hz"]
    odd(0.08, "camera_jitter_s", late_s, ("frame-jitter", "frames-late"))
    odd(0.05, "camera_gaps_s", ((float(rng.uniform(0, duration)), float(rng.uniform(0.1, duration))),), _SEEN)
    return CameraImuScenario(**chosen), said


def _usual(rng: np.random.Generator) -> tuple[dict[str, Any], float, Said]:
    """Draw lens, board, motion and rates; with them, the board's width [m] and what was drawn."""
    lens = str(rng.choice(list(_LENSES), p=[0.4, 0.2, 0.1, 0.08, 0.08, 0.07, 0.07]))
    intrinsics, coeffs = _LENSES[lens]
    projection = lens if lens in INTRINSICS else "pinhole"
    distortion = lens if projection == "pinhole" else ("radtan" if coeffs else "none")
    kind = str(rng.choice(["aprilgrid", "checkerboard", "circlegrid"], p=[0.75, 0.2, 0.05]))
    columns, rows = int(rng.integers(3, 8)), int(rng.integers(3, 8))
    size = log_uniform(rng, 0.02, 0.15)
    width = columns * size * (1.3 if kind == "aprilgrid" else 1.0)
    motion = str(
        rng.choice(
            ["normal", "gentle", "tremor", "shaky", "rolling", "translation", "one-axis", "slow", "static"],
            p=[0.28, 0.18, 0.12, 0.12, 0.08, 0.06, 0.06, 0.06, 0.04],
        )
    )
    lengths = [(3.0, 8.0), (8.0, 16.0), (16.0, 60.0)][int(rng.choice(3, p=[0.1, 0.85, 0.05]))]
    duration = log_uniform(rng, *lengths)
    chosen: dict[str, Any] = {
        "duration_s": duration,
        "motion": motion,
        "imu_rate_hz": log_uniform(rng, 50.0, 1000.0) if duration < 12 else log_uniform(rng, 50.0, 300.0),
        "camera_rate_hz": log_uniform(rng, 3.0, 60.0) if duration < 8 else log_uniform(rng, 3.0, 20.0),
        "target_type": kind,
        "target_cols": columns,
        "target_rows": rows,
        "target_size_m": size,
        "distance_m": width * (2.0 if kind != "aprilgrid" else 1.3) * log_uniform(rng, 0.8, 1.3),
        "board_lean_deg": float(rng.uniform(-5, 90)) if rng.random() < 0.3 else float(rng.uniform(-5, 20)),
        "board_turn_deg": float(rng.uniform(-180, 180)) if rng.random() < 0.3 else float(rng.uniform(-10, 10)),
        "projection": projection,
        "intrinsics": intrinsics,
        "distortion": distortion,
        "distortion_coeffs": coeffs,
        "pixel_noise_px": log_uniform(rng, 0.03, 2.0),
        "cameras": 2 if rng.random() < 0.25 else 1,
        "random_extrinsics": True,
        "lever_arm_m": log_uniform(rng, 0.01, 2.0),
        "time_shift_range_s": log_uniform(rng, 1e-3, 10.0),
        "gravity": float(rng.uniform(9.77, 9.83)),
        "imu": str(rng.choice(["consumer", "thesis", "ideal"])),
        "noise_factor": log_uniform(rng, 0.1, 10.0),
    }
    drawn = f"{motion}, {duration:.3g} s, {kind}, {lens}"
    codes = _MOTION if motion in {"translation", "one-axis", "slow", "static"} else ()
    return chosen, width, [(drawn, (*codes, *(_RARE if chosen["camera_rate_hz"] < _RARE_HZ else ())))]


def _imu(case: WildCase) -> ImuSamples:
    return case.recording.imus["imu0"]


def _with_imu(case: WildCase, samples: ImuSamples) -> WildCase:
    return replace(case, recording=replace(case.recording, imus={"imu0": samples}))


def _with_cameras(case: WildCase, change: Callable[[CameraFrames], CameraFrames]) -> WildCase:
    cameras = {name: change(frames) for name, frames in case.recording.cameras.items()}
    return replace(case, recording=replace(case.recording, cameras=cameras))


def _axes(case: WildCase, rng: np.random.Generator) -> WildCase:
    axes, which = signed_permutation(rng), int(rng.choice([0, 0, 1, 2]))
    force, rate = (axes if which != 2 else np.eye(3)), (axes if which != 1 else np.eye(3))
    samples = _imu(case)
    changed = replace(
        samples,
        accelerometer=replace(samples.accelerometer, values=samples.accelerometer.values @ force.T),
        gyroscope=replace(samples.gyroscope, values=samples.gyroscope.values @ rate.T),
    )
    case = replace(
        _with_imu(case, changed), imus={"imu0": reread(case.imus["imu0"], accelerometer=force, gyroscope=rate)}
    )
    name = f"axes of {('both', 'accelerometer', 'gyroscope')[which]} {axes.astype(int).tolist()}"
    return case.with_oddity(name, "axes-mirrored")


def _units(case: WildCase, rng: np.random.Generator) -> WildCase:
    force = float(rng.choice([1.0, 1 / 9.80665, 9.80665, 100.0]))
    rate = float(rng.choice([1.0, 57.29578, 1 / 57.29578]))
    samples = _imu(case)
    changed = replace(
        samples,
        accelerometer=replace(samples.accelerometer, values=samples.accelerometer.values * force),
        gyroscope=replace(samples.gyroscope, values=samples.gyroscope.values * rate),
    )
    imu = reread(case.imus["imu0"], accelerometer=force, gyroscope=rate)
    case = replace(_with_imu(case, changed), imus={"imu0": imu})
    return case.with_oddity(f"units misstated {force:g} {rate:g}", "unit", "rate-magnitude", "gravity-magnitude")


def _noise(case: WildCase, rng: np.random.Generator) -> WildCase:
    samples = _imu(case)
    if samples.noise is None:
        return case
    factor = {name: log_uniform(rng, 0.01, 100.0) for name in ImuNoise.__slots__}
    stated = ImuNoise(**{name: getattr(samples.noise, name) * by for name, by in factor.items()})
    words = f"noise stated {[round(by, 3) for by in factor.values()]} times"
    return _with_imu(case, replace(samples, noise=stated)).with_oddity(words, "noise-differs", "walk-differs")


def _guessed(case: WildCase, rng: np.random.Generator) -> WildCase:
    def guess(frames: CameraFrames) -> CameraFrames:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation_from_rotvec(rng.normal(0, 1.5, 3)), rng.normal(0, 1, 3)
        return replace(frames, T_cam_imu=T, time_shift_cam_imu_s=float(rng.normal(0, 10.0 ** rng.uniform(-3, 2))))

    return _with_cameras(case, guess).with_oddity("wild first guesses")


def _repeated(case: WildCase, rng: np.random.Generator) -> WildCase:
    share = log_uniform(rng, 0.01, 0.5)

    def stale(frames: CameraFrames) -> CameraFrames:
        """Return frames of which a share shows what the one before showed."""
        count = len(frames.t_ns)
        if count < 2:
            return frames
        source = np.arange(count)
        held = np.flatnonzero(rng.random(count - 1) < share) + 1
        source[held] = source[held - 1]
        corners = [np.flatnonzero(frames.frame == k) for k in range(count)]
        chosen = np.concatenate([corners[k] for k in source])
        frame = np.repeat(np.arange(count), [len(corners[k]) for k in source])
        return replace(frames, frame=frame, point=frames.point[chosen], pixels=frames.pixels[chosen])

    return _with_cameras(case, stale).with_oddity(f"{share:.2g} stale frames", "frames-repeated", "frames-left-out")


def _exchanged(case: WildCase, _rng: np.random.Generator) -> WildCase:
    """Exchange two cameras' names, and with them what is true of them."""
    cameras = case.recording.cameras
    if len(cameras) < 2:
        return case
    recording = replace(case.recording, cameras={"cam0": cameras["cam1"], "cam1": cameras["cam0"]})
    truth = {"cam0": case.cameras["cam1"], "cam1": case.cameras["cam0"]}
    return replace(case, recording=recording, cameras=truth).with_oddity("cameras exchanged")


def _clock(case: WildCase, rng: np.random.Generator) -> WildCase:
    """Let the cameras' clock run fast: the time shift wanders."""
    drift = log_uniform(rng, 1e-6, 1e-2) * float(rng.choice([-1, 1]))
    span_s = _imu(case).gyroscope.duration_s

    def fast(frames: CameraFrames) -> CameraFrames:
        later = np.rint(drift * (frames.t_ns - frames.t_ns[0])).astype(np.int64)
        return replace(frames, t_ns=frames.t_ns + later)

    paths = {f"{name}.time_shift_cam_imu": np.array(abs(drift) * span_s) for name in case.cameras}
    case = replace(_with_cameras(case, fast), wandering=case.wandering | paths)
    return case.with_oddity(f"clock {1e6 * drift:.3g} ppm fast", "clock-drift", "frames-late")


def _jumped(case: WildCase, rng: np.random.Generator) -> WildCase:
    by_s, at = log_uniform(rng, 1e-3, 1.0), rng.uniform(0.1, 0.9)

    def jump(frames: CameraFrames) -> CameraFrames:
        later = seconds(frames.t_ns) > at * seconds(frames.t_ns)[-1]
        return replace(frames, t_ns=frames.t_ns + np.where(later, round(by_s * 1e9), 0))

    paths = {f"{name}.time_shift_cam_imu": np.array(by_s) for name in case.cameras}
    case = replace(_with_cameras(case, jump), wandering=case.wandering | paths)
    return case.with_oddity(f"clock jumps by {by_s:.2g} s", "clock-jump", "clock-drift", "frames-late")


def _apart(case: WildCase, rng: np.random.Generator) -> WildCase:
    samples, by_s = _imu(case), log_uniform(rng, 1e-3, 0.5) * float(rng.choice([-1, 1]))
    late = replace(samples.accelerometer, t_ns=samples.accelerometer.t_ns + round(by_s * 1e9))
    name = f"accelerometer {by_s:.2g} s late"
    imu = case.imus["imu0"]
    true = replace(imu, accelerometer=replace(imu.required_accelerometer, time_shift_s=-by_s))
    case = replace(_with_imu(case, replace(samples, accelerometer=late)), imus={"imu0": true})
    return case.with_oddity(name, "triads-apart", "clocks-apart")


def _warming(case: WildCase, rng: np.random.Generator) -> WildCase:
    samples = _imu(case)

    def drifting(samples: TriadSamples, size: float) -> tuple[TriadSamples, np.ndarray]:
        t_s = seconds(samples.t_ns)
        drift = size * rng.uniform(-1, 1, 3) * warming(t_s, log_uniform(rng, 1.0, 3 * t_s[-1]))
        drift -= drift.mean(axis=0)
        return replace(samples, values=samples.values + drift), np.ptp(drift, axis=0)

    force, by_force = drifting(samples.accelerometer, log_uniform(rng, 1e-3, 2.0))
    rate, by_rate = drifting(samples.gyroscope, log_uniform(rng, 1e-4, 0.2))
    moved = case.wandering
    wandering = moved | {
        "imu0.accelerometer.bias": moved["imu0.accelerometer.bias"] + by_force,
        "imu0.gyroscope.bias": moved["imu0.gyroscope.bias"] + by_rate,
    }
    case = replace(_with_imu(case, replace(samples, accelerometer=force, gyroscope=rate)), wandering=wandering)
    name = f"biases drift by {by_force.max():.2g} {by_rate.max():.2g}"
    return case.with_oddity(name, "walk-differs", "noise-differs")


_EDITS: tuple[tuple[Edit, float], ...] = (
    (_warming, 0.1),
    (_axes, 0.2),
    (_units, 0.06),
    (_noise, 0.25),
    (_guessed, 0.3),
    (_repeated, 0.08),
    (_exchanged, 0.3),
    (_clock, 0.08),
    (_jumped, 0.05),
    (_apart, 0.06),
)


def _stated_at_least(case: WildCase, name: str) -> float:
    """Return by how much the IMU differs from an ideal one: nobody can tell that a person stated less than that."""
    imu = in_body_frame(case.imus["imu0"], case.cameras)[0]["imu0"]
    if name == "imu0.S_a":
        return float(np.abs(np.diag(imu.required_accelerometer.sensitivity) - 1).max())
    if name == "imu0.B_g" and imu.gyroscope is not None:
        return float(np.abs(imu.gyroscope.g_sensitivity).max())
    return 0.0


def _with_options(case: WildCase, scenario: CameraImuScenario, rng: np.random.Generator) -> WildCase:
    chosen: dict[str, Any] = {}
    if rng.random() < 0.35:
        chosen["model"] = str(rng.choice(["basic", "scale-misalignment", "full"]))
    if rng.random() < 0.3:
        chosen["gravity"] = scenario.gravity if rng.random() < 0.6 else float(rng.uniform(9.3, 10.3))
    if rng.random() < 0.15:
        chosen["noise"] = str(rng.choice(["coloured", "nominal"]))
    if rng.random() < 0.1:
        chosen["pixel_sigma"] = log_uniform(rng, 0.01, 10.0)
    if rng.random() < 0.1:
        chosen["knots_per_s"] = log_uniform(rng, 3.0, 200.0)
    if rng.random() < 0.1:
        chosen["spline_order"] = int(rng.integers(4, 6))
    if rng.random() < 0.15:
        names = ["cam0.intrinsics", "cam0.line_delay", "target.scale", "imu0.lever_arms", "cam0.distortion_coeffs"]
        chosen["free"] = tuple(str(name) for name in rng.choice(names, int(rng.integers(1, 3)), replace=False))
    if rng.random() < 0.12:
        names = [
            "cam0.T_cam_imu.translation",
            "cam0.T_cam_imu.rotation",
            "cam0.time_shift_cam_imu",
            "imu0.S_a",
            "imu0.B_g",
        ]
        name, sigma = str(rng.choice(names)), log_uniform(rng, 1e-4, 1.0)
        chosen["prior"] = (f"{name}={max(sigma, _stated_at_least(case, name)):.3g}",)
    if rng.random() < 0.08:
        chosen["robust"] = False
    if rng.random() < 0.05:
        chosen["line_delay"] = log_uniform(rng, *_LINE_DELAYS_S)
    if rng.random() < 0.05:
        chosen["max_iterations"] = int(rng.integers(1, 10))
    if "gravity" in chosen:
        wrong = abs(chosen["gravity"] - scenario.gravity) > _GRAVITY_WRONG
        case = case.with_oddity(
            f"gravity {chosen['gravity']:.4g} for {scenario.gravity:.4g}",
            *(("gravity", "target-scale", "gravity-magnitude") if wrong else ()),
            decisive=wrong,
        )
    case = replace(case, options=CameraImuOptions(**chosen))
    codes = ("prior-disagrees", "model-too-simple", *(_SHUTTER if "line_delay" in chosen else ()))
    return case.with_oddity(f"options {chosen}", *codes) if chosen else case
