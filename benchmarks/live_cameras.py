"""Guided capture of cameras and rigs, measured without hardware: a simulated hand, and planted faults.

    python benchmarks/live_cameras.py hand --seeds 100 120     seconds that guidance needs, and whether the result holds
    python benchmarks/live_cameras.py faults --seeds 100 110   what is wrong with images, and healthy captures

The hand turns or shakes the rig about or along the axis that is asked for, with 10 degrees of noise, for 4 s; one time
in five it does anything. What a calibration takes in the background passes meanwhile. Unguided, the rig is waved as the
tutorial's is (motion "normal"), until a calibration serves; the how-to asks for one to two minutes.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from importlib import import_module
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

import gnomon
from gnomon.assess.checks.image_checks import measure_image
from gnomon.assess.needs import needs_of_use
from gnomon.detect.boards.board import BoardView
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.live.camera_session import CameraSession
from gnomon.live.image_sources import SHOWN, ImageArrival, ReplayImages
from gnomon.live.rig_session import MotionCoach, RigCoach
from gnomon.live.sources import Pace
from gnomon.live.trials import try_calibration
from gnomon.models.target import Target
from gnomon.options.requirements import USES
from gnomon.recording import Recording
from gnomon.simulate import CameraImuScenario
from gnomon.simulate.camera_imu_path import CameraPath, camera_motion
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.images.board_images import rendered_cameras

simulator = import_module("gnomon.simulate.camera_imu")
STEP_S, EDGE_S, LONGEST_S, LOOK_S = 4.0, 0.7, 120.0, 0.5
TURN_RAD, TURN_HZ, SHAKE_M, SHAKE_HZ, ROLL_RAD, ROLL_HZ = 0.25, 0.8, 0.07, 1.3, 1.5, 0.25
TUTORIAL_S = 60.0
GREY = np.random.default_rng(1).normal(120, 40, (48, 64)).clip(0, 255).astype(np.uint8)
STATISTICS = replace(measure_image(GREY), size=(640, 480), low=20.0, high=200.0, blur_px=0.7, clipped=0.0)


class SteppedPath(CameraPath):
    """A path whose coordinates swing for one step after the other, with smooth edges: 6 x^5 - 15 x^4 + 10 x^3."""

    steps = ()  # of (amplitudes (9,), frequency in Hz)

    def coordinates(self, t_s):
        value, rate, curvature = (np.zeros((9, len(t_s))) for _ in range(3))
        value += self.offset[:, None]
        for k, (amplitude, hz) in enumerate(self.steps):
            u = t_s - k * STEP_S
            on = (u > 0) & (u < STEP_S)
            v, u = 2 * np.pi * hz, u[on]
            a, b = np.sin(v * u), np.cos(v * u)
            x = np.clip(np.minimum(u, STEP_S - u) / EDGE_S, 0, 1)
            way = np.where(u < STEP_S / 2, 1, -1) / EDGE_S
            g = x**3 * (6 * x**2 - 15 * x + 10)
            dg, ddg = 30 * x**2 * (x - 1) ** 2 * way, 60 * x * (2 * x**2 - 3 * x + 1) / EDGE_S**2
            value[:, on] += np.outer(amplitude, a * g)
            rate[:, on] += np.outer(amplitude, v * b * g + a * dg)
            curvature[:, on] += np.outer(amplitude, -(v**2) * a * g + 2 * v * b * dg + a * ddg)
        return value, rate, curvature

    def at(self, t_s):
        return camera_motion(self.middle, *self.coordinates(t_s))

    def pose(self, t_s):
        motion = self.at(t_s)
        return motion.R_target_body, motion.p_target_body


class RigHand:
    """A rig in a simulated hand, before a board; what it did so far is simulated again, longer, at each step."""

    def __init__(self, seed):
        self.seed, self.steps = seed, []
        self.rng = np.random.default_rng((seed, 1))
        self.R_cam_imu = simulator.nominal_extrinsics()[:3, :3]

    def do(self, phase, *, obeys):
        """Do what is asked for, about, for one step; return all that was recorded so far."""
        what, _, axis = phase.partition(" ")
        amplitude, rng = np.zeros(9), self.rng
        if what in {"turn", "shake"} and axis and obeys and rng.random() >= 0.2:
            way = self.R_cam_imu[:, "xyz".index(axis)]
            way = rotation_from_rotvec(np.radians(10.0) / np.sqrt(2) * rng.standard_normal(3)) @ way
            turns = what == "turn"
        else:
            way, turns = rng.standard_normal(3), None
            way /= np.linalg.norm(way)
        if turns is not False:
            amplitude[[5, 4, 3]] = TURN_RAD * way * rng.uniform(0.8, 1.3)
        if turns is not True:
            amplitude[6:] = SHAKE_M * way * [1, -1, -1] * rng.uniform(0.8, 1.3)
        if what == "roll" and obeys and rng.random() >= 0.2:
            amplitude[:] = 0
            amplitude[3] = ROLL_RAD * rng.uniform(0.8, 1.1)
            turns = None
        amplitude += 0.15 * rng.standard_normal(9) * [0.1, 0.1, 0.1, *[TURN_RAD] * 3, *[SHAKE_M] * 3]
        hz = TURN_HZ if turns else SHAKE_HZ if turns is False else 0.5 * (TURN_HZ + SHAKE_HZ)
        self.steps.append((amplitude, (ROLL_HZ if amplitude[3] > 1 else hz) * rng.uniform(0.85, 1.15)))
        scenario = CameraImuScenario(duration_s=STEP_S * len(self.steps), camera_rate_hz=20.0)
        drawn, simulator.drawn_path = simulator.drawn_path, self._path
        try:
            return simulator.simulate_camera_imu(scenario, self.seed)
        finally:
            simulator.drawn_path = drawn

    def _path(self, scenario, middle, _extrinsics, _rng):
        offset = np.zeros(9)
        offset[2] = scenario.distance_m
        none = np.empty(0)
        path = SteppedPath(
            middle=middle, offset=offset, slope=np.zeros(9), pulsation=none, phase=none, amplitude=np.empty((9, 0))
        )
        object.__setattr__(path, "steps", tuple(self.steps))
        return path


def views_of(frames, first=0, stop=None):
    """Return stamps and views of some frames."""
    views = []
    for k in range(first, len(frames.t_ns) if stop is None else stop):
        own = frames.frame == k
        sigma = np.full(int(own.sum()), 0.3)
        view = BoardView(
            point=frames.point[own], pixels=frames.pixels[own], sigma_px=sigma, blur_px=0.7, black=20.0, white=200.0
        )
        views.append((int(frames.t_ns[k]), view))
    return views


def part(simulation, first_ns, stop_ns):
    """Return the views and the samples of a span of time, by the camera's clock."""
    frames, imu = simulation.recording.cameras["cam0"], simulation.recording.imus["imu0"]
    frames_in = np.searchsorted(frames.t_ns, [first_ns, stop_ns])
    views = views_of(frames, *frames_in)
    triads = {name: getattr(imu, name) for name in ("accelerometer", "gyroscope")}
    new = {name: (one.t_ns >= first_ns) & (one.t_ns < stop_ns) for name, one in triads.items()}
    return views, {
        name: replace(one, t_ns=one.t_ns[new[name]], values=one.values[new[name]]) for name, one in triads.items()
    }


def captured(seed, use, *, obeys):
    """Return the simulation of a capture, its seconds, and what the trial that confirmed it reached."""
    hand = RigHand(seed)
    simulation, motion = hand.do("", obeys=obeys), MotionCoach(USES[use])
    first_ns = int(simulation.recording.cameras["cam0"].t_ns[0])
    coach, at_ns, ready_s, outcome = None, first_ns, 0.0, None
    lens = simulation.recording.cameras["cam0"].camera
    coach = RigCoach(simulation.target, lens, motion)
    while (seconds := (at_ns - first_ns) * 1e-9) < LONGEST_S:
        stop_ns = at_ns + int(LOOK_S * 1e9)
        if stop_ns - first_ns > (STEP_S * len(hand.steps) - 0.1) * 1e9:
            simulation = hand.do(coach.state.phase, obeys=obeys)
        views, samples = part(simulation, at_ns, stop_ns)
        at_ns = stop_ns
        motion.add_samples(samples, {name: one.unit for name, one in samples.items()})
        motion.look_at_samples()
        for t_ns, view in views[:-1]:
            coach.keep_view(t_ns, view, STATISTICS.size)
        coach.look_at_image(views[-1][0], GREY, views[-1][1], STATISTICS, seconds=seconds, rate_hz=20.0)
        if outcome is not None and seconds >= ready_s:
            coach.take_outcome(outcome)
            reached, outcome = outcome.needs, None
            if coach._confirmed:
                return simulation, seconds, dict(reached)
        if outcome is None and coach.wants_calibration:
            began_s = time.process_time()
            imu = replace(simulation.recording.imus["imu0"], **part(simulation, first_ns, at_ns)[1])
            recording = replace(coach.recording_so_far(), imus={"imu0": imu})
            outcome = try_calibration(recording, simulation.target, USES[use])
            ready_s = seconds + (time.process_time() - began_s)
    return simulation, LONGEST_S, None


def unguided(seed, use):
    """Return after how many seconds a recording as the tutorial makes it serves a use, in steps of 10 s."""
    simulation = simulator.simulate_camera_imu(CameraImuScenario(duration_s=LONGEST_S, camera_rate_hz=20.0), seed)
    first_ns = int(simulation.recording.cameras["cam0"].t_ns[0])
    for seconds in range(30, int(LONGEST_S), 10):
        recording = until(simulation.recording, first_ns + seconds * 10**9)
        found = try_calibration(recording, simulation.target, USES[use])
        if found.verdict == "pass" and all(ratio <= 1 for _, ratio in found.needs):
            return float(seconds)
    return LONGEST_S


def worst_error(result, simulation):
    """Return the largest of the errors of T_cam_imu and the time shift, over its standard deviation."""
    truth, sigma = simulation.truth_parameters, {p.name: p.sigma for p in result.diagnostics.parameters}
    camera = result.calibration.cameras["cam0"]
    R_error = rotation_from_rotvec(truth["cam0.T_cam_imu.rotation"]).T @ camera.T_cam_imu[:3, :3]
    error = {
        "T_cam_imu.rotation": rotvec_from_rotation(R_error),
        "T_cam_imu.translation": camera.T_cam_imu[:3, 3] - truth["cam0.T_cam_imu.translation"],
        "time_shift_cam_imu": np.atleast_1d(camera.time_shift_cam_imu - truth["cam0.time_shift_cam_imu"]),
    }
    return max(
        float(np.max(np.abs(values) / [value for key, value in sigma.items() if key.startswith(f"cam0.{name}")]))
        for name, values in error.items()
    )


def study_hand(first, last):
    for use in ("vio",):
        guided, alone, ratios, worst, verdicts = [], [], [], [], Counter()
        for seed in range(first, last):
            alone.append(unguided(seed, use))
            simulation, seconds, reached = captured(seed, use, obeys=True)
            guided.append(seconds)
            end_ns = int(simulation.recording.cameras["cam0"].t_ns[0]) + int(seconds * 1e9)
            result = gnomon.calibrate_camera_imu(until(simulation.recording, end_ns), simulation.target)
            verdicts[gnomon.judge(result.calibration, use).verdict] += 1
            worst.append(worst_error(result, simulation))
            final = {need.block: need.sigma / need.needed for need in needs_of_use(result.calibration, USES[use])}
            ratios += [reached[block] / ratio for block, ratio in final.items()] if reached else []
            print(f"  {seed}: {seconds:.0f} s, alone {alone[-1]:.0f} s, {worst[-1]:.1f} sigma", file=sys.stderr)
        print(
            f"{use}: {len(guided)} seeds; seconds guided {np.median(guided):.0f} ({min(guided):.0f} to "
            f"{max(guided):.0f}), unguided {np.median(alone):.0f} ({min(alone):.0f} to {max(alone):.0f}), how-to "
            f"{TUTORIAL_S:.0f} to {2 * TUTORIAL_S:.0f}; verdicts {dict(verdicts)}; largest error of T_cam_imu and time "
            f"shift {np.median(worst):.2f} sigma (median), {max(worst):.2f} (most), beyond 4: "
            f"{sum(w > 4 for w in worst)}; predicted over final sigma: quantiles 0, 5, 50, 95, 100 % "
            f"{np.round(np.quantile(ratios, [0, 0.05, 0.5, 0.95, 1]), 2).tolist()}"
        )


def until(recording, end_ns):
    """Return a recording up to a moment."""
    frames, imu = recording.cameras["cam0"], recording.imus["imu0"]
    count = int(np.searchsorted(frames.t_ns, end_ns))
    rows = {name: getattr(frames, name)[frames.frame < count] for name in ("frame", "point", "pixels")}
    triads = {name: getattr(imu, name) for name in ("accelerometer", "gyroscope")}
    kept = {name: one.t_ns < end_ns for name, one in triads.items()}
    return Recording(
        cameras={"cam0": replace(frames, t_ns=frames.t_ns[:count], **rows)},
        imus={
            "imu0": replace(
                imu,
                **{
                    name: replace(one, t_ns=one.t_ns[kept[name]], values=one.values[kept[name]])
                    for name, one in triads.items()
                },
            )
        },
    )


def blurred(image):
    kernel = np.zeros((21, 21))
    kernel[10] = 1 / 21
    return cv2.filter2D(image, -1, kernel)


def hidden(image):
    rng = np.random.default_rng(int(image.sum()))
    return cv2.GaussianBlur(rng.integers(60, 200, image.shape, dtype=np.uint8), (0, 0), 4)


IMAGE_FAULTS = {  # code -> what is done to the images from a moment on; None where the board is another one throughout
    "dark": lambda image: (0.15 * image).astype(np.uint8),
    "bright": lambda image: np.clip(3.0 * image + 60, 0, 255).astype(np.uint8),
    "blurred": blurred,
    "searching": hidden,
    "small": lambda image: cv2.copyMakeBorder(
        cv2.resize(image, (128, 96), interpolation=cv2.INTER_AREA), 192, 192, 256, 256, cv2.BORDER_REPLICATE
    ),
    "other-board": None,
}


def told(session):
    state = session.coach.state
    return {fault.code for fault in state.faults} | ({state.phase} & {"searching"})


def shown(seed, folder, target=None):
    """Return a session and the images that a rendered board gives, twice a second."""
    rng = np.random.default_rng(seed)
    board = {"target_rows": int(rng.integers(5, 8)), "target_cols": int(rng.integers(5, 8))}
    simulation = simulate_cameras(replace(SHOWN, images=True, rate_hz=2.0, views=130, between=1, **board), seed)
    source = ReplayImages(rendered_cameras(simulation), Pace(1), simulation.target)
    frames = (frame for _, _, _, frame in source._frames_of("cam0"))
    return CameraSession(source, folder, target or simulation.target), frames, simulation.target


def study_faults(first, seeds=10, healthy=20):
    for code, plant in IMAGE_FAULTS.items():
        delays = []
        for seed in range(first, first + seeds):
            with tempfile.TemporaryDirectory() as place:
                session, frames, board = shown(seed, Path(place) / "rec")
                if plant is None:
                    session.end_recording()
                    other = another_board(board, seed)
                    session, frames, _ = shown(seed, Path(place) / "other", other)
                begins = 0 if plant is None else int(np.random.default_rng(seed).integers(3, 9))
                found = np.inf
                for k, frame in enumerate(islice(frames, begins + 14)):
                    image = frame.decode()
                    if plant is not None and k >= begins:
                        image = plant(image)
                    session.take_image(ImageArrival(frame.t_ns, image))
                    session.look_at_arrivals()
                    if k >= begins and code in told(session):
                        found = (k - begins) * LOOK_S
                        break
                session.end_recording()
            delays.append(found)
        print(f"fault {code}: named in {sum(d <= 3 for d in delays)} of {seeds} within 3 s, latest {max(delays):.1f} s",
              flush=True)  # fmt: skip
    false = Counter()
    for seed in range(first, first + healthy):
        with tempfile.TemporaryDirectory() as place:
            session, frames, _ = shown(1000 + seed, Path(place) / "rec")
            for frame in islice(frames, 60):
                session.take_image(ImageArrival(frame.t_ns, frame.decode()))
                session.look_at_arrivals()
                false.update(told(session))
            session.end_recording()
    print(f"healthy: {healthy} captures of 30 s, false: {dict(false)}")


def another_board(target, seed):
    """Return what its owner states wrongly: a grid with one column less, or a checkerboard."""
    if seed % 2:
        return Target.checkerboard(cols=7, rows=6, row_spacing_m=0.03, col_spacing_m=0.03)
    return Target.aprilgrid(
        tag_cols=target.cols - 1, tag_rows=target.rows, tag_size_m=target.tag_size_m, tag_spacing=target.tag_spacing
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hand", "faults"))
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 110), metavar=("FIRST", "LAST"))
    given = parser.parse_args()
    if given.what == "hand":
        study_hand(*given.seeds)
    else:
        study_faults(given.seeds[0])


if __name__ == "__main__":
    main()
