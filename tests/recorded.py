"""Small recordings of a simulated rig as images, whose truth is known, in every layout in which recordings come.

The images are rendered once for all tests of a session; what is changed is changed in a copy.
"""

import csv
import gzip
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
import yaml

import gnomon
from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.readers.images.image_recording import open_images
from gnomon.recording import Floats
from gnomon.recording.recording import ImageRecording, ImageStream
from gnomon.results.calibration import Calibration
from gnomon.writers.bag_recording import save_bag
from gnomon.writers.image_folders import save_euroc
from gnomon.writers.simulated_cameras import save_camera_imu_recording

SMALL: dict[str, Any] = {
    "images": True,
    "duration_s": 8.0,
    "camera_rate_hz": 10.0,
    "imu_rate_hz": 100.0,
    "resolution": (320, 240),
    "intrinsics": (215.0, 214.5, 160.5, 121.0),
    "target_cols": 4,
    "target_rows": 3,
    "target_size_m": 0.13,
}
"""Eighty images of 320 x 240 px: everything is there that is in a recording of a minute."""

CHECKERBOARD: dict[str, Any] = {
    "target_type": "checkerboard",
    "target_cols": 7,
    "target_rows": 6,
    "target_size_m": 0.08,
}
FRAMES = 80
INPUTS = ("cam", "imu", "target")
FILES = {"cam": "camchain.yaml", "imu": "imu.yaml", "target": "target.yaml"}

NAMES = {
    "euroc": "euroc",
    "ros1": "walk.bag",
    "ros2": "walk-ros2",
    "mcap": "walk.mcap",
    "kalibr": "kalibr",
    "video": "walk.mkv",
}
"""Layout -> name of the recording in it."""


def scenario(**changes: Any) -> CameraImuScenario:
    """Return the small scenario with some changes."""
    return CameraImuScenario(**SMALL | changes)


class Walks:
    """Recordings that are made when they are asked for, and once; what they are in is not to be changed.

    Parameters
    ----------
    place : returns a new folder of some name
    """

    def __init__(self, place: Callable[[str], Path]) -> None:
        self._place = place
        self._made: dict[Any, Path] = {}

    def rendered(self, *, seed: int = 1, **changes: Any) -> Path:
        """Return the folder of the small recording, or of one with some changes, as it was simulated."""
        wanted = scenario(**changes)
        if (wanted, seed) not in self._made:
            folder = self._place("simulated") / "walk"
            save_camera_imu_recording(simulate_camera_imu(wanted, seed), folder)
            self._made[wanted, seed] = folder
        return self._made[wanted, seed]

    def written(self, layout: str) -> Path:
        """Return the small recording in another layout."""
        if layout not in self._made:
            target = self._place(layout) / NAMES[layout]
            write(self.rendered(), target, layout)
            self._made[layout] = target
        return self._made[layout]


def write(source: Path, target: Path, layout: str) -> None:
    """Write a recording in another layout."""
    match layout:
        case "euroc":
            save_euroc(open_images(source), target)
        case "kalibr":
            write_kalibr(source, target)
        case "video":
            write_video(source, target)
        case "ros1" | "ros2" | "mcap":
            save_bag(open_images(source), target, layout)
        case _:
            raise ValueError(layout)


def inputs(folder: Path) -> list[Any]:
    """Return the options that name Kalibr's files of a rendered recording."""
    return [word for option in INPUTS for word in (f"--{option}", folder / FILES[option])]


def images_of(folder: Path) -> list[Path]:
    """Return the images of a rendered recording, in the order of time."""
    return sorted((folder / "cam0" / "data").glob("*.png"))


def thin_out(folder: Path, every: int) -> None:
    """Take most of the images of a rendered recording away, and their rows of the table."""
    for image in set(images_of(folder)) - set(images_of(folder)[::every]):
        image.unlink()
    table = folder / "cam0" / "data.csv"
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([head, *rows[::every]]) + "\n")


class Samples(NamedTuple):
    """Of an IMU, as its table holds them."""

    head: list[str]
    rows: list[list[str]]


def samples_of(folder: Path) -> Samples:
    with gzip.open(folder / "imu0.csv.gz", "rt") as file:
        head, *rows = csv.reader(file)
    return Samples(head, rows)


def write_samples(path: Path, samples: Samples, change: Callable[[int], int] = lambda t_ns: t_ns) -> None:
    """Write a table of samples, with other timestamps."""
    lines = [samples.head, *([str(change(int(t_ns))), *values] for t_ns, *values in samples.rows)]
    path.write_text("\n".join(",".join(line) for line in lines) + "\n", encoding="ascii")


def write_kalibr(source: Path, target: Path) -> None:
    """Write the layout that Kalibr makes bags from: cam0/<timestamp>.png, imu0.csv."""
    (target / "cam0").mkdir(parents=True)
    for image in images_of(source):
        shutil.copy(image, target / "cam0")
    head = ["timestamp", "omega_x", "omega_y", "omega_z", "alpha_x", "alpha_y", "alpha_z"]
    samples = samples_of(source)
    order = [0, *(samples.head.index(name) for name in samples.head[1:] if name.startswith(("w", "g", "omega")))]
    order += [k for k in range(1, 7) if k not in order]
    write_samples(target / "imu0.csv", Samples(head, [[row[k] for k in order] for row in samples.rows]))


def save_topics(
    path: Path, of: ImageRecording, cameras: Mapping[str, str], imus: Mapping[str, str], *, frames: int
) -> None:
    """Write a ROS 1 bag in which the first images, and the samples, stand several times under topics of their own."""
    samples, images = of.imus["imu0"], list(of.streams["cam0"].frames([]))[:frames]
    stream = ImageStream(frames=lambda _: iter(images), count=frames)
    several = ImageRecording(
        imus={name: replace(samples, topic=topic) for name, topic in imus.items()},
        streams={name: replace(stream, topic=topic) for name, topic in cameras.items()},
    )
    save_bag(several, path, "ros1")


VIDEO_START_NS = 5_000_000_000_000
"""Where the IMU's clock of a video begins; that of the video begins at zero."""


def write_video(source: Path, target: Path, *, codec: str = "ffv1", count: int | None = None) -> None:
    """Write a video without loss, and the samples in a table beside it, in a clock of their own."""
    images = images_of(source)[:count]
    first = int(images[0].stem)
    with av.open(str(target), "w") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "gray"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for image in images:
            frame = av.VideoFrame.from_ndarray(cv2.imread(str(image), cv2.IMREAD_GRAYSCALE), format="gray")
            frame.pts, frame.time_base = round((int(image.stem) - first) * 1e-6), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    samples = samples_of(source)
    start = int(samples.rows[0][0])
    write_samples(target.parent / "imu0.csv", samples, lambda t_ns: t_ns - start + VIDEO_START_NS)


def content(path: Path, *, without: tuple[str, ...] = ()) -> Any:
    """Return a calibration.yaml as it stands there, but for some keys of its provenance."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    for key in without:
        del document["provenance"][key]
    return document


def errors_in_sigmas(result: Calibration, truth: Calibration) -> dict[str, Floats]:
    """Return the errors of a calibration of a rig, each in its own standard deviation; of what was estimated."""
    found: dict[str, Floats] = {}

    def add(name: str, error: Any) -> None:
        error, sigma = np.ravel(error), np.ravel(result.sigma(name))
        if (sigma > 0).any():
            found[name] = error[sigma > 0] / sigma[sigma > 0]

    for name, imu in result.imus.items():
        true = truth.imus[name]
        add(f"{name}.accelerometer.sensitivity", imu.accelerometer.sensitivity - true.accelerometer.sensitivity)
        add(f"{name}.gyroscope.sensitivity", imu.gyroscope.sensitivity - true.gyroscope.sensitivity)
        add(f"{name}.gyroscope.g_sensitivity", imu.gyroscope.g_sensitivity - true.gyroscope.g_sensitivity)
    for name, camera in result.cameras.items():
        true = truth.cameras[name]
        turn = rotvec_from_rotation(true.T_cam_imu[:3, :3].T @ camera.T_cam_imu[:3, :3])
        add(f"{name}.T_cam_imu.rotation", turn)
        add(f"{name}.T_cam_imu.translation", camera.T_cam_imu[:3, 3] - true.T_cam_imu[:3, 3])
        add(f"{name}.time_shift_cam_imu", camera.time_shift_cam_imu - true.time_shift_cam_imu)
        for lens in ("intrinsics", "distortion_coeffs"):
            add(f"{name}.{lens}", getattr(camera.camera, lens) - getattr(true.camera, lens))
    return found


def most_sigmas(result: Calibration, truth: Calibration, *, shift: bool = True) -> float:
    """Return the largest of these errors, that of the time shift only where wanted."""
    errors = errors_in_sigmas(result, truth)
    return max(float(np.abs(error).max()) for name, error in errors.items() if shift or "time_shift" not in name)


def edited(path: Path, changes: Mapping[str, Any]) -> None:
    """Change entries at the top of a YAML file; those that become None go."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    document |= changes
    text = yaml.safe_dump({key: value for key, value in document.items() if value is not None})
    path.write_text(text, encoding="utf-8")


def truth_of(folder: Path) -> Calibration:
    return gnomon.load(folder / "truth.yaml")
