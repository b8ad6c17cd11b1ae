"""How many images a second are rendered: 752 x 480 px, with and without motion, exposure and a rolling shutter.

    python benchmarks/renderer.py            30 images of each kind
    python benchmarks/renderer.py --write    keep the table in benchmarks/results-renderer.md

Images per second of CPU time of one thread: what else runs on the machine matters little. Two processes render two
images at a time, so that two cores give twice as many; two threads of one process less, since Python lets them take
turns.
"""

import argparse
import os
import time
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: the problems are small

from imu import HERE, Table, machine

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.recording.recording import ImageStream
from gnomon.simulate import RoomScenario
from gnomon.simulate.images.board_images import simulated_images
from gnomon.simulate.images.room_images import room_images

LIMIT, ROOM_LIMIT = 20.0, 10.0  # images a second on two cores
BASE = CameraImuScenario(
    duration_s=6.0, camera_rate_hz=5.0, images=True, motion="static", exposure_s=0.0, resolution=(752, 480),
    intrinsics=(458.654, 457.296, 367.215, 248.375), distortion_coeffs=(-0.283, 0.074, 0.0002, 0.00002),
)  # fmt: skip
KINDS = {
    "AprilGrid at rest": {},
    "by hand, 4 ms": {"motion": "normal", "exposure_s": 4e-3},
    "by hand, rolling shutter": {"motion": "normal", "line_delay_s": 3e-5},
    "by hand, rolling shutter, 4 ms": {"motion": "normal", "line_delay_s": 3e-5, "exposure_s": 4e-3},
    "shaken, rolling shutter, 8 ms": {"motion": "shaky", "line_delay_s": 3e-5, "exposure_s": 8e-3},
    "defocus of 2 px, 4 ms": {"motion": "normal", "exposure_s": 4e-3, "defocus_px": 2.0},
    "wall full of things, 4 ms": {"motion": "normal", "exposure_s": 4e-3, "image_clutter": True},
    "checkerboard, 4 ms": {
        "motion": "normal", "exposure_s": 4e-3, "target_type": "checkerboard", "target_cols": 7, "target_size_m": 0.06,
    },
    "circles, 4 ms": {
        "motion": "normal", "exposure_s": 4e-3, "target_type": "circlegrid", "target_cols": 7, "target_size_m": 0.06,
    },
    "fisheye, 4 ms": {
        "motion": "normal", "exposure_s": 4e-3, "distortion": "equidistant",
        "intrinsics": (320.4, 319.8, 374.1, 243.6), "distortion_coeffs": (-0.012, 0.019, -0.015, 0.004),
    },
}  # fmt: skip
ROOMS = {
    "by hand, 4 ms": {},
    "turned to all sides, 4 ms": {"motion": "around"},
    "walked round a hall, 60 boxes, 4 ms": {
        "motion": "walk",
        "furniture": 60,
        "duration_s": 50.0,
        "camera_rate_hz": 0.6,
    },
}


def rate(stream: ImageStream) -> float:
    """Return images per second of CPU time."""
    frames = list(stream.frames([]))
    frames[0].decode()
    start = time.process_time()
    for frame in frames:
        frame.decode()
    return len(frames) / (time.process_time() - start)


def rooms() -> Table:
    """Return the table of rooms without a board."""
    table = Table(
        "Furnished rooms, images a second, 640 x 480 px",
        ("", "one core", "**two cores**", "over what was asked for"),
        f"Asked for: {ROOM_LIMIT:g} on two cores.",
    )
    for name, changes in ROOMS.items():
        scenario = RoomScenario(**{"duration_s": 6.0, "camera_rate_hz": 5.0, **changes})
        found = rate(room_images(scenario, simulate_camera_imu(scenario.rig(), seed=1)).streams["cam0"])
        table.add(name, f"{found:.1f}", f"**{2 * found:.0f}**", f"{2 * found / ROOM_LIMIT:.2f}")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="keep the table in benchmarks/results-renderer.md")
    parser.add_argument("--date", default="", help="date to be written with it")
    options = parser.parse_args()
    table = Table(
        "Images a second, 752 x 480 px",
        ("", "one core", "**two cores**", "over what was asked for", "over that at rest"),
        f"Asked for: {LIMIT:g} on two cores. Two cores are twice one: two processes do not know of each other.",
    )
    rest = 0.0
    for name, changes in KINDS.items():
        found = rate(simulated_images(simulate_camera_imu(replace(BASE, **changes), seed=1)).streams["cam0"])
        rest = rest or found
        table.add(name, f"{found:.1f}", f"**{2 * found:.0f}**", f"{2 * found / LIMIT:.2f}", f"{found / rest:.2f}")
    tables = f"{table}\n{rooms()}"
    print(tables)
    if options.write:
        when = f" {options.date}." if options.date else ""
        head = f"# Speed of the renderer\n\nWritten by `python benchmarks/renderer.py --write`.{when} {machine()}.\n"
        (HERE / "results-renderer.md").write_text(f"{head}\n{tables}", encoding="utf-8")


if __name__ == "__main__":
    main()
