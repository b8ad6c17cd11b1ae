"""How well a camera and an IMU are calibrated without a board: rendered rooms, with their truth.

    python benchmarks/without_a_board.py seeds 8 [--motion around] [--board | --both]
    python benchmarks/without_a_board.py hostile
    python benchmarks/without_a_board.py blur 2 --first 9200
    python benchmarks/without_a_board.py cameras 2 --first 9001
    python benchmarks/without_a_board.py rotations 5
    python benchmarks/without_a_board.py lenses 10 --first 900
    python benchmarks/without_a_board.py euroc --data $GNOMON_DATA/euroc-imu-april --stated euroc

`seeds` draws fresh rooms, paths and errors of an MPU-6000 (30 s, 20 Hz, gyroscope's walk 2e-4), and prints the error
of the translation, of the rotation and of the time shift over their sigmas, and the sigmas over the bound of Cramer
and Rao of the measurements that were used; with --board the same motion before an AprilGrid instead, whose corners are
off by 0.1 px, with --both one after the other; --exposure-s makes images sharper, and their rendering faster. `hostile`
prints what becomes of scenes that are hard, or hopeless, `blur` of longer exposures, `cameras` of two cameras.
`rotations` compares board and room where the rig turns as usual and twice as fast, and to all sides. `lenses` knows
the lens by a covariance. `euroc` forgets the shape of the board of a real recording; `--stated` holds cam.yaml,
imu.yaml and target.yaml.
"""

import argparse
import itertools
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

import gnomon
from gnomon.calibrate.steps import landmark_map
from gnomon.detect.tracks import PointTracks
from gnomon.errors import GnomonError
from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.simulate import RoomScenario, camera_imu_path, simulate_camera_imu
from gnomon.study import circuit_walk
from gnomon.writers.simulated_cameras import save_camera_imu_recording

USUAL = RoomScenario(imu="thesis", gyroscope_random_walk=2e-4, random_extrinsics=True)
# for what is hard, or hopeless: blur takes the renderer a second for a full image
SMALL = replace(
    USUAL, duration_s=20.0, camera_rate_hz=15.0, resolution=(400, 300), intrinsics=(290.0, 289.0, 201.4, 148.1)
)
HOSTILE = {
    "at rest": replace(SMALL, motion="static"),
    "hardly moved": replace(SMALL, motion="slow"),
    "never turned": replace(SMALL, motion="translation"),
    "turned about one axis": replace(SMALL, motion="one-axis"),
    "painted walls and boxes": replace(SMALL, surface="plain"),
    "painted walls alone": replace(SMALL, surface="plain", furniture=0),
    "one tile again and again": replace(SMALL, surface="repeated"),
    "12 of 22 boxes move": replace(SMALL, moving=12),
    "two people walk": replace(SMALL, people=2),
    "five people walk": replace(SMALL, people=5),
    "a wall is a mirror": replace(SMALL, mirror=True),
    "a mirror, little else": replace(SMALL, mirror=True, furniture=3, room_m=(2.4, 2.2, 2.4)),
    "in the dark": replace(SMALL, light=0.06, image_noise=4.0),
    "blurred by motion": replace(SMALL, exposure_s=0.03, motion="shaky", duration_s=12.0),
    "unknown rolling shutter": replace(SMALL, line_delay_s=3e-5),
    "large empty hall": replace(SMALL, room_m=(14.0, 6.0, 14.0), furniture=0),
}
BLURS = (("normal", 0.004), ("normal", 0.015), ("normal", 0.025), ("shaky", 0.003), ("shaky", 0.005), ("shaky", 0.01))
TWO_CAMERAS = (
    replace(SMALL, cameras=2, duration_s=10.0, camera_rate_hz=12.0, exposure_s=0.0),
    replace(SMALL, cameras=2, duration_s=12.0, camera_rate_hz=12.0, exposure_s=0.0, baseline_m=0.25, motion="around"),
)
Z_NAMES = ("T_cam_imu.translation", "T_cam_imu.rotation", "time_shift_cam_imu")


def calibrate_room(scenario, seed, folder, *, board):
    """Return recording, result and truth; the lens is known, as its file in the folder says."""
    rig = scenario.rig()
    if board:
        rig = replace(rig, images=False, pixel_noise_px=0.1)
    simulation = simulate_camera_imu(rig, seed)
    save_camera_imu_recording(simulation, folder, room=None if board else scenario)
    if scenario.line_delay_s:  # nobody said so
        chain = folder / "camchain.yaml"
        chain.write_text("".join(line for line in chain.read_text().splitlines(True) if "line_delay" not in line))
    files = {"cam": folder / "camchain.yaml", "imu": folder / "imu.yaml"}
    recording, target = gnomon.read_camera_imu(folder, target=folder / "target.yaml" if board else "none", **files)
    return recording, gnomon.calibrate_camera_imu(recording, target), simulation.truth


def errors_of(result, truth, camera="cam0"):
    """Return errors, sigmas and their bounds (7,) each, of translation [mm], rotation [mdeg] and time shift [us].

    The bound is that of Cramer and Rao for the measurements that were used, at their noise as it was found: the inverse
    of the information of all that is estimated jointly.
    """
    found, true = (one.cameras[camera] for one in (result.calibration, truth))
    turn = np.degrees(rotvec_from_rotation(true.T_cam_imu[:3, :3].T @ found.T_cam_imu[:3, :3]))
    error = np.concatenate(
        [
            1e3 * (found.T_cam_imu[:3, 3] - true.T_cam_imu[:3, 3]),
            1e3 * turn,
            [1e6 * (found.time_shift_cam_imu - true.time_shift_cam_imu)],
        ]
    )
    trust = result.diagnostics.trust
    own = [k for name in Z_NAMES for k, of in enumerate(trust.names) if of.partition("[")[0] == f"{camera}.{name}"]
    units = np.repeat([1e3, 1e3 * 180 / np.pi, 1e6], [3, 3, 1])
    return error, trust.sigma[own] * units, trust.ordinary_sigma[own] * units


def run_one(scenario, seed, label, *, board=False):
    """Print what became of one recording; return errors and sigmas, or None where there is no result."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            recording, result, truth = calibrate_room(scenario, seed, Path(folder), board=board)
        except GnomonError as error:
            print(f"{label:26} refused: {error}", flush=True)
            return None
    calibration = result.calibration
    noted = sorted({finding.code for finding in calibration.assessment.findings if finding.severity != "info"})
    for camera in calibration.cameras:
        told, worst = _told(*errors_of(result, truth, camera))
        share = landmark_map.coming_and_going(recording.cameras[camera])
        print(
            f"{label:26} {camera} {calibration.verdict:4} {told}  worst {worst:.1f}  come and go {share:.1%}",
            flush=True,
        )
    print(f"{'':26} {time.process_time() - begin:.0f} s CPU  {' '.join(noted)}", flush=True)
    return errors_of(result, truth)


def _told(error, sigma, bound):
    """Return what errors and sigmas come to, in words, and the worst error over its sigma."""
    z = error / sigma
    parts = {"t mm": slice(0, 3), "R mdeg": slice(3, 6), "shift us": slice(6, 7)}
    size = {
        name: (np.linalg.norm(error[k]), np.linalg.norm(sigma[k]), np.sqrt(np.mean(z[k] ** 2)), _over(sigma, bound, k))
        for name, k in parts.items()
    }
    told = "  ".join(
        f"{name} {off:.3g} ({by:.3g}) z {score:.2f} bound x {over:.2f}" for name, (off, by, score, over) in size.items()
    )
    return told, float(np.abs(z).max())


def _over(sigma, bound, part):
    return np.linalg.norm(sigma[part]) / np.linalg.norm(bound[part])


def print_summary(found, count):
    """Print what the results of some seeds come to."""
    error, sigma, bound = np.moveaxis(np.array(found), 1, 0)
    blocks = {"translation": slice(0, 3), "rotation": slice(3, 6), "time shift": slice(6, 7)}
    rms = {name: np.sqrt(np.mean((error / sigma)[:, k] ** 2)) for name, k in blocks.items()}
    print(f"{len(found)} of {count} converged; z rms " + ", ".join(f"{name} {z:.2f}" for name, z in rms.items()))
    means = np.sqrt([np.mean(sigma[:, k] ** 2) for k in blocks.values()])
    print("sigma, rms of an axis: t {:.3f} mm, R {:.1f} mdeg, shift {:.1f} us".format(*means))
    for name, k in blocks.items():
        over, off = (
            np.array([_over(one, least, k) for one, least in zip(of, bound, strict=True)]) for of in (sigma, error)
        )
        print(f"{name}: sigma over bound, median {np.median(over):.2f}, most {over.max():.2f}; ", end="")
        print(f"error over bound, rms {np.sqrt(np.mean(off**2)):.2f}, above 1.5 in {(off > 1.5).sum()}")


def compare_euroc(folder, stated):
    """Print how EuRoC's corners of cam0 calibrate when the shape of the board is forgotten, beside the board itself.

    The map is made of the corners as if they were points that were followed: with the numbers that they have on the
    board, or with another number whenever one was out of sight (and 300 of these, those that are seen longest).
    """
    files = {name: stated / f"{name}.yaml" for name in ("cam", "imu", "target")}
    recording, board = gnomon.read_camera_imu(folder, **files)
    frames, samples = recording.cameras["cam0"], recording.imus["imu0"]
    alone = replace(recording, cameras={"cam0": frames})
    options = gnomon.CameraImuOptions(model="full")
    known = gnomon.calibrate_camera_imu(alone, board, options).calibration
    for label, number in (("numbers kept", frames.point), ("numbers lost", number_anew(frames))):
        seen = replace(frames, point=number)
        points, kept = forget_board(seen, samples)
        seen = replace(seen, frame=seen.frame[kept], point=np.unique(number[kept], return_inverse=True)[1],
                       pixels=seen.pixels[kept], sigma_px=None)  # fmt: skip
        target = gnomon.Target.landmarks(points)
        found = gnomon.calibrate_camera_imu(replace(alone, cameras={"cam0": seen}), target, options).calibration
        print(f"{label}: {len(points)} landmarks, verdict {found.verdict}")
        for path in EUROC_PATHS:
            for sigma, off in differences(known, found, path):
                print(f"  {path}: off by {off:.3g}, combined sigma {sigma:.3g}, {off / sigma:+.2f} sigma", flush=True)


EUROC_PATHS = (
    "cam0.T_cam_imu.rotation",
    "cam0.T_cam_imu.translation",
    "cam0.time_shift_cam_imu",
    "imu0.gyroscope.sensitivity",
)


def differences(one, other, path):
    """Yield combined sigma and difference of each scalar of a parameter of two calibrations [SI]."""
    sigmas = np.hypot(*(np.ravel(each.sigma(path)) for each in (one, other)))
    if path.endswith("rotation"):
        turns = [each.cameras["cam0"].T_cam_imu[:3, :3] for each in (one, other)]
        off = rotvec_from_rotation(turns[0].T @ turns[1])
    else:
        off = np.ravel(other.parameter(path)) - np.ravel(one.parameter(path))
    yield from ((s, d) for s, d in zip(sigmas, off, strict=True) if s > 0)


def number_anew(frames):
    """Return other numbers of corners: a new one whenever a corner comes back into sight."""
    order = np.lexsort((frames.frame, frames.point))
    new = np.diff(frames.point[order], prepend=-1) != 0
    new |= np.diff(frames.frame[order], prepend=-2) != 1
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return number


def forget_board(frames, samples):
    """Return landmarks (k, 3) mapped from corners alone, by ascending number, and the corners that see them (m,)."""
    tracks = PointTracks(frame=frames.frame, track=frames.point, pixels=frames.pixels)
    stream, origin_ns = landmark_map._stream(samples)
    t_s = (frames.t_ns - origin_ns) * 1e-9
    motion = landmark_map._motion("cam0", tracks, frames.camera, t_s, stream)
    scene, at = landmark_map._first_scene("cam0", tracks, frames.camera, motion)
    long = tracks.where(np.isin(tracks.frame, at))
    long = long.where(np.bincount(long.track)[long.track] >= landmark_map._FEWEST_KEYS)
    names = np.unique(long.track)  # of the scene's points, as _first_scene numbers them
    count = np.bincount(scene.point, minlength=len(names))
    best = np.sort(np.argsort(-count, kind="stable")[:300])
    best = best[count[best] >= landmark_map._FEWEST_KEYS]
    return scene.points[best], np.isin(frames.point, names[best])


def compare_rotations(first, count):
    """Print what turning more is worth, before a board and in a room, whose landmarks are projected, not rendered.

    Both are off by 0.3 px; the same rig is waved alike. `room` is 4 x 2.6 x 4 m with 250 landmarks on its sides.
    """
    print("motion, turning x: median of sigma (rms of an axis), its bound, and the error over sigma, rms")
    for motion, factor in (("normal", 1.0), ("normal", 2.0), ("around", 1.0), ("around", 2.0)):
        for place in ("board", "room"):
            found = [run for seed in range(first, first + count) if (run := _turned(motion, factor, place, seed))]
            told = f"{motion} x {factor:g}, {place}: {len(found)} of {count}"
            if found:
                error, sigma, bound = np.moveaxis(np.array(found), 1, 0)
                for name, k in (("t mm", slice(0, 3)), ("R mdeg", slice(3, 6)), ("shift us", slice(6, 7))):
                    size = [np.median(np.sqrt(np.mean(of[:, k] ** 2, axis=1))) for of in (sigma, bound)]
                    told += f"; {name} {size[0]:.3g} ({size[1]:.3g}) {np.sqrt(np.mean((error / sigma)[:, k] ** 2)):.2f}"
            print(told, flush=True)


def _turned(motion, factor, place, seed):
    style = camera_imu_path._STYLES[motion]
    turning = replace(style, mean_rate_rad_s=factor * style.mean_rate_rad_s, turning_rad_s=factor * style.turning_rad_s)
    rig = replace(USUAL, motion=motion).rig()
    rig = replace(rig, images=False, random_extrinsics=False)
    with mock.patch.dict(camera_imu_path._STYLES, {motion: turning}):
        simulation = simulate_camera_imu(rig, seed)
    recording, target = simulation.recording, simulation.target
    if place == "room":
        rng = np.random.default_rng((seed, 2))
        points = circuit_walk._room(rng) + np.array([0.0, 0.0, rig.distance_m])
        recording = replace(recording, cameras={"cam0": circuit_walk._seen_room(simulation, points, rng)})
        target = gnomon.Target.landmarks(points + 0.02 * rng.standard_normal(points.shape))
    try:
        result = gnomon.calibrate_camera_imu(recording, target, gnomon.CameraImuOptions(model="full"))
    except GnomonError as error:
        print(f"{motion} x {factor:g}, {place}, seed {seed}: refused: {error}", flush=True)
        return None
    return errors_of(result, simulation.truth)


def check_lenses(first, count):
    """Print errors over sigmas of lenses that are known by a covariance, and estimated along in a projected room."""
    every = []
    for seed in range(first, first + count):
        simulation = simulate_camera_imu(replace(circuit_walk.RECORDING, motion="around"), seed)
        rng = np.random.default_rng((seed, 2))
        points = circuit_walk._room(rng) + np.array([0.0, 0.0, simulation.scenario.distance_m])
        frames = circuit_walk._seen_room(simulation, points, rng)
        lens = frames.camera
        sigma = np.concatenate([[0.5, 0.5, 0.4, 0.4], np.full(len(lens.distortion_coeffs), 1e-3)])
        prior = np.diag(sigma**2)
        prior[0, 1] = prior[1, 0] = 0.95 * sigma[0] * sigma[1]
        off = rng.multivariate_normal(np.zeros(len(sigma)), prior)
        stated = replace(lens, intrinsics=lens.intrinsics + off[:4], distortion_coeffs=lens.distortion_coeffs + off[4:])
        frames = replace(frames, camera=stated, lens_covariance=prior)
        target = gnomon.Target.landmarks(points + 0.02 * rng.standard_normal(points.shape))
        recording = replace(simulation.recording, cameras={"cam0": frames})
        found = gnomon.calibrate_camera_imu(recording, target, gnomon.CameraImuOptions(model="full")).calibration
        names = ("intrinsics", "distortion_coeffs")
        z = [
            (getattr(found.cameras["cam0"].camera, name) - getattr(lens, name)) / found.sigma(f"cam0.{name}")
            for name in names
        ]
        every.append(np.concatenate(z))
        print(f"seed {seed}", every[-1].round(2), flush=True)
    print("rms", np.sqrt(np.mean(np.square(every), axis=0)).round(2), np.sqrt(np.mean(np.square(every))).round(2))


def main():
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("seeds", "hostile", "blur", "cameras", "euroc", "rotations", "lenses"))
    parser.add_argument("count", nargs="?", type=int, default=8)
    parser.add_argument("--motion", default="normal")
    parser.add_argument("--exposure-s", type=float, default=USUAL.exposure_s, help="of seeds")
    parser.add_argument("--first", type=int, default=100, help="the first seed")
    parser.add_argument("--board", action="store_true", help="before an AprilGrid")
    parser.add_argument("--both", action="store_true", help="without a board, and before an AprilGrid")
    parser.add_argument("--only", help="of hostile: scenes whose name has these words")
    parser.add_argument("--data", type=Path, help="of euroc: the recording")
    parser.add_argument("--stated", type=Path, help="of euroc: the folder of cam.yaml, imu.yaml, target.yaml")
    given = parser.parse_args()
    if given.what == "rotations":
        compare_rotations(given.first, given.count)
        return
    if given.what == "lenses":
        check_lenses(given.first, given.count)
        return
    if given.what == "euroc":
        compare_euroc(given.data, given.stated)
        return
    if given.what == "hostile":
        for label, scenario in HOSTILE.items():
            if given.only and given.only not in label:
                continue
            run_one(scenario, given.first, label)
        return
    seeds = range(given.first, given.first + given.count)
    if given.what == "cameras":
        for seed, scenario in itertools.product(seeds, TWO_CAMERAS):
            run_one(scenario, seed, f"seed {seed}, {scenario.motion}")
        return
    if given.what == "blur":
        for seed, (motion, exposure_s) in itertools.product(seeds, BLURS):
            scenario = replace(SMALL, duration_s=12.0, motion=motion, exposure_s=exposure_s)
            run_one(scenario, seed, f"seed {seed}, {motion}, {1e3 * exposure_s:g} ms")
        return
    scenario = replace(USUAL, motion=given.motion, exposure_s=given.exposure_s)
    ways = [False, True] if given.both else [given.board]
    results = [
        [run_one(scenario, seed, f"seed {seed}{' board' * board}", board=board) for board in ways] for seed in seeds
    ]
    for column, board in enumerate(ways):
        print("\nbefore an AprilGrid:" if board else "\nwithout a board:")
        print_summary([row[column] for row in results if row[column] is not None], given.count)
    if given.both:
        over = [_over(room[1], grid[1], slice(0, 3)) for room, grid in results if room is not None and grid is not None]
        within = sum(ratio <= 1.3 for ratio in over)
        print(f"\ntranslation: sigma over that before the board at the same motion, median {np.median(over):.2f}, ")
        print(f"at most 1.3 in {within} of {len(over)}")


if __name__ == "__main__":
    sys.exit(main())
