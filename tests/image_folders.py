"""Tiny recordings of images and IMU samples, as folders and videos."""

from fractions import Fraction

import av
import cv2
import numpy as np

START = 1_600_000_000_092_999_937  # the nearest float64 is 1_600_000_000_092_999_936
STEP = 50_000_000
SAMPLES = "timestamp [ns],wx [rad/s],wy,wz,ax [m/s^2],ay,az"


def picture(number, *, height=24, width=32):
    """Return an image that differs from those of other numbers."""
    rows, columns = np.mgrid[:height, :width]
    return ((3 * rows + 5 * columns + 29 * number) % 256).astype(np.uint8)


def stamps(count):
    return [START + k * STEP for k in range(count)]


def write_images(folder, names, *, suffix=".png", change=lambda image: image):
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        (folder / f"{name}{suffix}").write_bytes(cv2.imencode(suffix, change(picture(number)))[1].tobytes())


def samples(count=40, seed=0):
    """Return timestamps (n,) and accelerometer and gyroscope (n, 6)."""
    rng = np.random.default_rng(seed)
    t_ns = START + 5_000_000 * np.arange(count)
    return t_ns, np.column_stack(
        [rng.normal(0, 1, (count, 2)), rng.normal(9.8, 1, count), rng.normal(0, 1, (count, 3))]
    )


def write_samples(path, count=40, header=SAMPLES):
    path.parent.mkdir(parents=True, exist_ok=True)
    t_ns, values = samples(count)
    rows = (
        f"{t},{','.join(map(repr, [*row[3:], *row[:3]]))}"
        for t, row in zip(t_ns.tolist(), values.tolist(), strict=True)
    )
    path.write_text("\n".join([header, *rows]) + "\n", encoding="ascii")


def write_video(path, *, count=30, codec="ffv1", pixels="gray", times_ms=None, rate=20, options=None):
    """Write a video; with times it has a variable frame rate."""
    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        if times_ms is not None:
            stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(picture(number, height=48, width=64), format="gray").reformat(
                format=pixels
            )
            if times_ms is not None:
                frame.pts, frame.time_base = int(times_ms[number]), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def frames_of(recording, camera="cam0"):
    """Return the timestamps, the images and the notes of a camera; what cannot be decoded is None."""
    from gnomon.errors import RecordingError

    notes, t_ns, images = [], [], []
    for frame in recording.streams[camera].frames(notes):
        t_ns.append(frame.t_ns)
        try:
            images.append(frame.decode())
        except RecordingError as error:
            images.append(None)
            notes.append(str(error))
    return t_ns, images, notes
