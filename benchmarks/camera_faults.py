"""Faults of cameras alone: lenses that change, boards that are not as stated, copies, clocks; and healthy cameras.

    python benchmarks/camera_faults.py                       every case, 12 seeds each
    python benchmarks/camera_faults.py healthy --seeds 60    all lens families, 10 to 100 views, mono and stereo

Rows as of `sensor_faults.py`. The error of a lens is what rays miss the image by, rms over the corners, a turn of the
camera taken out; its sigma is the same of the covariance. Where a lens changes, the worse of both halves counts.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

import numpy as np
from sensor_faults import Case, Floats, Outcome, main

import gnomon
from gnomon.assess.cameras.cameras_verdict import pixel_moves
from gnomon.errors import GnomonError
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames, Integers
from gnomon.simulate import CamerasScenario, simulate_cameras
from gnomon.simulate.cameras import CamerasSimulation
from gnomon.simulate.scenarios.cameras import USUAL_LENSES

LENS_PX, ROTATION, TRANSLATION_M = 0.25, np.radians(0.1), 5e-3  # what general use needs
Lenses = dict[str, tuple[Camera, ...]]
Edit = Callable[[CamerasSimulation, np.random.Generator], tuple[dict[str, CameraFrames], Lenses]]


def scenario_of(seed: int, *, cameras: int | None = None, views: int = 60) -> CamerasScenario:
    """Return a scenario whose lens, and number of cameras where it is not given, change from seed to seed."""
    model = list(USUAL_LENSES)[seed % len(USUAL_LENSES)]
    return CamerasScenario.with_lens(model, views=views, cameras=cameras or 1 + seed // len(USUAL_LENSES) % 2)


def outcome(
    frames: dict[str, CameraFrames], target: Target, truth: gnomon.Calibration, lenses: Lenses | None = None
) -> Outcome:
    """Return how a calibration turns out; `lenses` are those that each camera had, of the truth where not given."""
    recording = gnomon.Recording(imus={}, cameras=frames)
    try:
        found = gnomon.calibrate_cameras(recording, target).calibration
    except GnomonError:
        return Outcome(verdict="refused")
    assert found.uncertainty is not None
    worst: list[tuple[float, float]] = []
    for name, camera in found.cameras.items():
        names = [f"{name}.{one}" for one in camera.camera.parameter_names]
        covariance = _part(found, names)
        true = (lenses or {}).get(name) or (truth.cameras[name].camera,)
        worst += [_lens_error(camera.camera, covariance, one, frames[name].pixels) for one in true]
        if name != "cam0":
            worst += _place_errors(found, truth, name)
    beyond = [(sigmas, needs) for sigmas, needs in worst if needs > 1]
    sigmas, needs = max(beyond or worst)
    return Outcome(
        verdict=found.verdict,
        codes=tuple(f.code for f in found.assessment.findings if f.severity in ("warning", "problem")),
        sigmas=sigmas,
        needs=needs,
    )


def _part(found: gnomon.Calibration, names: list[str]) -> Floats:
    assert found.uncertainty is not None
    at = [found.uncertainty.names.index(name) for name in names]
    return found.uncertainty.matrix[np.ix_(at, at)]


def _lens_error(found: Camera, covariance: Floats, true: Camera, pixels: Floats) -> tuple[float, float]:
    """Return the error of a lens over the corners, in sigmas and in needs."""
    chosen = pixels[:: max(len(pixels) // 500, 1)]
    rays, seen = true.unproject(chosen)
    image = found.project(np.where(seen[:, None], rays, [0.0, 0.0, 1.0]))
    assert image.by_point is not None
    seen &= image.valid
    by_turn = np.cross(image.by_point[seen], rays[seen][:, None, :]).reshape(-1, 3)
    off = (image.pixels - chosen)[seen].ravel()
    off -= by_turn @ np.linalg.lstsq(by_turn, off, rcond=None)[0]
    moves = pixel_moves(found, image.pixels[seen])
    spread = np.einsum("mip,pq,miq->mi", moves, covariance, moves)
    rms = float(np.sqrt(2 * np.mean(off**2)))
    return rms / float(np.sqrt(2 * np.nanmean(spread))), rms / LENS_PX


def _place_errors(found: gnomon.Calibration, truth: gnomon.Calibration, name: str) -> list[tuple[float, float]]:
    """Return the errors of a camera's place, in sigmas and in needs."""
    T, true = (one.cameras[name].T_cam_body for one in (found, truth))
    errors = {
        "rotation": (rotvec_from_rotation(T[:3, :3] @ true[:3, :3].T), ROTATION),
        "translation": (T[:3, 3] - true[:3, 3], TRANSLATION_M),
    }
    return [
        (float(np.max(np.abs(off) / found.sigma(f"{name}.T_cam_cam0.{what}"))), float(np.linalg.norm(off)) / need)
        for what, (off, need) in errors.items()
    ]


def case(edit: Edit, make: Callable[[int], CamerasScenario] = scenario_of) -> Case:
    """Return the case of corners that are edited after they were detected."""

    def run(seed: int) -> Outcome:
        simulation = simulate_cameras(make(seed), seed)
        frames, lenses = edit(simulation, np.random.default_rng([55, seed]))
        return outcome(dict(simulation.recording.cameras) | frames, simulation.target, simulation.truth, lenses)

    return run


def stated_case(
    state: Callable[[Target, np.random.Generator], Target], scenario: CamerasScenario | None = None
) -> Case:
    """Return the case of a board that is not as it is stated."""

    def run(seed: int) -> Outcome:
        simulation = simulate_cameras(scenario or scenario_of(seed), seed)
        target = state(simulation.target, np.random.default_rng([56, seed]))
        return outcome(dict(simulation.recording.cameras), target, simulation.truth)

    return run


def simulated_case(**scenario: object) -> Case:
    """Return the case of a fault that the simulation has; a pair of numbers is drawn between evenly on a log scale."""

    def run(seed: int) -> Outcome:
        rng = np.random.default_rng([57, seed])
        drawn = {
            name: float(np.exp(rng.uniform(*np.log(value)))) if isinstance(value, tuple) else value
            for name, value in scenario.items()
        }
        if "bow" in drawn:
            drawn["board_bow_m"] = (float(drawn.pop("bow")), 0.0) if seed % 2 else (0.0, float(drawn.pop("bow")))
        simulation = simulate_cameras(replace(scenario_of(seed), **drawn), seed)
        return outcome(dict(simulation.recording.cameras), simulation.target, simulation.truth)

    return run


# ---- lenses that change


def lens_changes(change: str, when: str) -> Edit:
    """Return the edit that shifts the crop or zooms one camera, later or in every other view."""

    def edit(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
        name = str(rng.choice(list(simulation.recording.cameras)))
        frames, lens = simulation.recording.cameras[name], simulation.truth.cameras[name].camera
        count = len(frames.t_ns)
        later = np.arange(count) % 2 == 1 if when == "in turn" else np.arange(count) > rng.uniform(0.3, 0.7) * count
        shift, zoom = np.zeros(2), 1.0
        if change in ("crop", "both"):
            heading = rng.uniform(0, 2 * np.pi)
            shift = rng.uniform(6, 10) * np.array([np.cos(heading), np.sin(heading)])
        if change in ("zoom", "both"):
            zoom = 1 + rng.uniform(0.002, 0.005) * rng.choice([-1, 1])
        middle = lens.intrinsics[-2:]
        moved = middle + zoom * (frames.pixels - middle) + shift
        pixels = np.where(later[frames.frame][:, None], moved, frames.pixels)
        intrinsics = lens.intrinsics.copy()
        intrinsics[-4:-2] *= zoom
        intrinsics[-2:] += shift
        other = replace(lens, intrinsics=intrinsics)
        return {name: replace(frames, pixels=pixels)}, {name: (lens, other)}

    return edit


# ---- views


def mirrored_images(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Mirror all images of all cameras: left and right, or up and down."""
    axis, found = int(rng.integers(2)), dict[str, CameraFrames]()
    for name, frames in simulation.recording.cameras.items():
        pixels = frames.pixels.copy()
        pixels[:, axis] = frames.camera.resolution[axis] - 1 - pixels[:, axis]
        found[name] = replace(frames, pixels=pixels)
    return found, {}


def mirrored_numbers(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Give the corners the numbers from the other end of each row, as of a board that is seen from behind."""
    axis, points = int(rng.integers(2)), simulation.target.points
    other = points.copy()
    other[:, axis] = points[:, axis].max() - points[:, axis]
    number = np.argmin(np.linalg.norm(other[:, None] - points[None], axis=2), axis=1)
    return {name: renumbered(frames, number) for name, frames in simulation.recording.cameras.items()}, {}


def renumbered(frames: CameraFrames, number: Integers) -> CameraFrames:
    """Return frames whose corners have other numbers, ascending in each frame."""
    point = number[frames.point]
    order = np.lexsort((point, frames.frame))
    return replace(frames, point=point[order], pixels=frames.pixels[order])


def copied(jitter_px: float) -> Edit:
    """Return the edit that delivers each of twelve views twelve times, apart by what coding an image anew changes."""

    def edit(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
        found: dict[str, CameraFrames] = {}
        for name, frames in simulation.recording.cameras.items():
            kept = frames.frame < 12
            own, point, pixels = frames.frame[kept], frames.point[kept], frames.pixels[kept]
            frame = np.concatenate([12 * own + k for k in range(12)])
            order = np.lexsort((np.tile(point, 12), frame))
            again = np.tile(pixels, (12, 1))[order]
            found[name] = replace(
                frames,
                t_ns=frames.t_ns[0] + np.arange(144) * 50_000_000,
                frame=frame[order],
                point=np.tile(point, 12)[order],
                pixels=again + jitter_px * rng.standard_normal(again.shape),
            )
        return found, {}

    return edit


def of_another_size(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Scale the images of 5 to 50 % of the views of one camera down."""
    name = str(rng.choice(list(simulation.recording.cameras)))
    frames = simulation.recording.cameras[name]
    factor = float(rng.choice([0.5, 2 / 3, 0.75, 0.9, 0.97]))
    small = rng.random(len(frames.t_ns)) < rng.uniform(0.05, 0.5)
    small[int(rng.integers(len(small)))] = True
    pixels = np.where(small[frames.frame][:, None], (frames.pixels + 0.5) * factor - 0.5, frames.pixels)
    return {name: replace(frames, pixels=pixels)}, {}


# ---- clocks and boards


def moving_stereo(seed: int) -> CamerasScenario:
    """Return two cameras before a board that a hand moves, 10 images a second."""
    return replace(scenario_of(seed, cameras=2, views=200), rate_hz=10.0, between=10)


def late(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Let cam1 expose 1 to 20 ms later or earlier than cam0."""
    delay = float(np.exp(rng.uniform(np.log(1e-3), np.log(20e-3))) * rng.choice([-1, 1])) * simulation.scenario.rate_hz
    R, p = simulation.R_cam0_target, simulation.p_cam0_target
    to = np.clip(np.arange(len(R)) + (1 if delay > 0 else -1), 0, len(R) - 1)
    turn = rotvec_from_rotation(R.swapaxes(1, 2) @ R[to])
    R, p = R @ rotation_from_rotvec(abs(delay) * turn), p + abs(delay) * (p[to] - p)
    return {"cam1": seen_anew(simulation, "cam1", R, p, simulation.points)}, {}


def seen_anew(simulation: CamerasSimulation, name: str, R: Floats, p: Floats, points: Floats) -> CameraFrames:
    """Return the frames of a camera with the board elsewhere (v, 3, 3), (v, 3) or of other points, noise kept."""
    frames, camera = simulation.recording.cameras[name], simulation.truth.cameras[name]
    T, at = camera.T_cam_body, frames.frame
    p_cam = (np.einsum("mij,mj->mi", R[at], points[frames.point]) + p[at]) @ T[:3, :3].T + T[:3, 3]
    image = camera.camera.project(p_cam, point_jacobian=False)
    noise = frames.pixels - simulation.corners[name].pixels
    kept = image.valid
    return replace(frames, frame=at[kept], point=frames.point[kept], pixels=(image.pixels + noise)[kept])


def bent_otherwise(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Bend the board as no bow does: twisted, as an S, or one corner lifted, by 1 to 8 mm."""
    size, points = np.exp(rng.uniform(np.log(1e-3), np.log(8e-3))), simulation.points.copy()
    x, y = (2 * points[:, :2] / points[:, :2].max(axis=0) - 1).T
    points[:, 2] += size * [x * y, x**3 - x, np.maximum(x + y - 0.5, 0) ** 2][int(rng.integers(3))]
    R, p = simulation.R_cam0_target, simulation.p_cam0_target
    return {name: seen_anew(simulation, name, R, p, points) for name in simulation.recording.cameras}, {}


def a_row_off(simulation: CamerasSimulation, rng: np.random.Generator) -> tuple[dict[str, CameraFrames], Lenses]:
    """Detect a checkerboard without its last row, in some views from its second row on."""
    found: dict[str, CameraFrames] = {}
    cols, rows = simulation.scenario.target_cols, simulation.scenario.target_rows
    for name, frames in simulation.recording.cameras.items():
        later = rng.random(len(frames.t_ns)) < 0.5
        number = frames.point - np.where(later[frames.frame], cols, 0)
        kept = (number >= 0) & (number < cols * (rows - 1))
        found[name] = replace(frames, frame=frames.frame[kept], point=number[kept], pixels=frames.pixels[kept])
    return found, {}


def stretched(target: Target, rng: np.random.Generator) -> Target:
    """State a spacing that is 0.5 to 5 % off along one axis."""
    off = np.exp(rng.uniform(np.log(0.005), np.log(0.05))) * rng.choice([-1, 1])
    cols, rows = (1 + off, 1.0) if rng.random() < 0.5 else (1.0, 1 + off)
    return Target.checkerboard(cols=6, rows=7, row_spacing_m=rows * 0.06, col_spacing_m=cols * 0.06)


def other_columns(target: Target, rng: np.random.Generator) -> Target:
    """State tags in other rows and columns: their numbers then lie elsewhere."""
    cols, rows = [(5, 8), (7, 6), (9, 4), (6, 7)][int(rng.integers(3))]
    return Target.aprilgrid(tag_cols=cols, tag_rows=rows, tag_size_m=0.088, tag_spacing=0.3)


def other_gap(target: Target, rng: np.random.Generator) -> Target:
    """State a gap between the tags that is off by 0.01 to 0.1 of a tag."""
    off = np.exp(rng.uniform(np.log(0.01), np.log(0.1))) * rng.choice([-1, 1])
    return Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3 + off)


SQUARES = CamerasScenario(target_type="checkerboard", target_cols=6, target_rows=7, target_size_m=0.06)


def squares(seed: int) -> CamerasScenario:
    """Return one or two cameras before a checkerboard."""
    return replace(SQUARES, cameras=1 + seed % 2)


def fault_cases() -> Iterator[tuple[str, Case]]:
    """Yield the cases of faults by name."""
    for change in ("crop", "zoom", "both"):
        for when in ("once", "in turn"):
            yield f"{change} changes {when}", case(lens_changes(change, when))
    yield "images mirrored", case(mirrored_images)
    yield "numbers of the corners mirrored", case(mirrored_numbers)
    yield "twelve views copied twelve times", case(copied(0.0))
    yield "the same, coded anew", case(copied(0.01))
    yield "cam1 late by 1 to 20 ms", case(late, moving_stereo)
    yield "images of two sizes", case(of_another_size)
    yield "bow of 1 to 10 mm", simulated_case(bow=(1e-3, 1e-2))
    yield "board twisted, as an S, a corner lifted", case(bent_otherwise)
    yield "board longer by 0.5 to 5 %", simulated_case(board_aspect=(0.005, 0.05))
    yield "checkerboard, a spacing off", stated_case(stretched, SQUARES)
    yield "checkerboard, one row less", case(a_row_off, squares)
    yield "tags in other columns", stated_case(other_columns)
    yield "gap between the tags off", stated_case(other_gap)


def healthy_cases() -> Iterator[tuple[str, Case]]:
    """Yield the cases of healthy cameras by name; over the seeds they go through the lens families."""

    def drawn(seed: int) -> CamerasScenario:
        rng = np.random.default_rng([58, seed])
        views = int(np.rint(np.exp(rng.uniform(np.log(10), np.log(100)))))
        return scenario_of(seed, views=views)

    yield "healthy", case(lambda simulation, rng: ({}, {}), drawn)


if __name__ == "__main__":
    main({"faults": fault_cases, "healthy": healthy_cases}, __doc__)
