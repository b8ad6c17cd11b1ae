"""Writing recordings of images in EuRoC's layout: they read back to the same numbers, whole or not at all."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import OptionError, OutputError, RecordingError
from gnomon.models.camera import Camera
from gnomon.readers.images.image_recording import open_images
from gnomon.recording import ImuSamples, TriadSamples
from gnomon.recording.recording import Frame, ImageRecording, ImageStream
from gnomon.recording.samples import ImuNoise
from gnomon.writers.image_folders import save_euroc
from image_folders import START, STEP, frames_of, picture, stamps

CAMERA = Camera(
    projection="pinhole",
    intrinsics=[40.1, 41.3, 15.7, 11.2],
    distortion="radtan",
    distortion_coeffs=[-0.28, 0.075, 2e-4, -1.5e-5],
    resolution=(32, 24),
)
NOISE = ImuNoise(
    accelerometer_noise_density=2e-3,
    accelerometer_random_walk=3e-3,
    gyroscope_noise_density=1.7e-4,
    gyroscope_random_walk=1.9e-5,
)
C, S = np.cos(0.3), np.sin(0.3)
T_CAM_IMU = np.array([[C, -S, 0, 0.1], [S, C, 0, -0.2], [0, 0, 1, 1 / 3], [0, 0, 0, 1]])


def imu(count=50, seed=0):
    rng = np.random.default_rng(seed)
    t_ns = START + 5_000_000 * np.arange(count)
    values = rng.normal(0, 1, (2, count, 3)) * 10 ** rng.uniform(-12, 2, (2, count, 3))
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=values[0] + [0, 0, 9.8], unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=values[1], unit="rad/s"),
        noise=NOISE,
    )


def stream(count=20, *, damaged=(), t_ns=None, **known):
    def broken():
        raise RecordingError("bag, image 3: the image is damaged.")

    def frames(notes):
        for number, stamp in enumerate(t_ns or stamps(count)):
            decode = broken if number in damaged else lambda number=number: picture(number)
            yield Frame(t_ns=stamp, where=f"image {number}", decode=decode)
        notes.append("the bag ends early.")

    return ImageStream(frames=frames, count=count, **known)


def test_it_reads_back_to_the_same_numbers(tmp_path):
    streams = {"cam0": stream(camera=CAMERA, T_cam_imu=T_CAM_IMU), "cam1": stream(7)}
    recording = ImageRecording(imus={"imu0": imu(), "imu1": imu(seed=1)}, streams=streams)
    said, notes = [], []
    save_euroc(recording, tmp_path / "out", said.append, notes)
    assert notes == ["the bag ends early.", "the bag ends early."]
    assert "writing images of cam0: 1 of 20" in said
    again = open_images(tmp_path / "out")
    for name in streams:
        (t_ns, images, _), (expected_t, expected, _) = frames_of(again, name), frames_of(recording, name)
        assert t_ns == expected_t
        np.testing.assert_array_equal(images, expected)
    for name, samples in recording.imus.items():
        found = again.imus[name]
        for triad in ("accelerometer", "gyroscope"):
            np.testing.assert_array_equal(getattr(found, triad).t_ns, getattr(samples, triad).t_ns)
            np.testing.assert_array_equal(getattr(found, triad).values, getattr(samples, triad).values)
        assert found.noise == NOISE
    known = again.streams["cam0"]
    np.testing.assert_array_equal(known.camera.parameters, CAMERA.parameters)
    assert (known.camera.model, known.camera.resolution) == (CAMERA.model, CAMERA.resolution)
    np.testing.assert_allclose(known.T_cam_imu, T_CAM_IMU, rtol=0, atol=1e-15)
    assert again.streams["cam1"].camera is None


@pytest.mark.parametrize(
    ("projection", "intrinsics", "distortion", "coeffs"),
    [
        ("pinhole", [40, 41, 15, 11], "none", []),
        ("pinhole", [40, 41, 15, 11], "equidistant", [0.01, 0.02, -0.01, 0.001]),
        ("ds", [-0.2, 0.55, 40, 41, 15, 11], "none", []),
        ("omni", [0.9, 40, 41, 15, 11], "fov", [0.9]),
    ],
)
def test_every_lens_reads_back(tmp_path, projection, intrinsics, distortion, coeffs):
    camera = Camera(
        projection=projection,
        intrinsics=intrinsics,
        distortion=distortion,
        distortion_coeffs=coeffs,
        resolution=(32, 24),
        line_delay_s=2e-5,
    )
    save_euroc(ImageRecording(imus={}, streams={"cam0": stream(3, camera=camera)}), tmp_path / "out")
    found = open_images(tmp_path / "out", need_imu=False).streams["cam0"].camera
    assert found.model == camera.model
    np.testing.assert_array_equal(found.parameters, camera.parameters)
    assert found.line_delay_s == 2e-5


def test_damaged_images_and_stamps_twice_are_left_out(tmp_path):
    t_ns = [*stamps(5), START + STEP]
    recording, notes = ImageRecording(imus={}, streams={"cam0": stream(6, damaged={3}, t_ns=t_ns)}), []
    with pytest.raises(RecordingError, match="image 3: the image is damaged"):
        save_euroc(recording, tmp_path / "out")
    save_euroc(recording, tmp_path / "out", notes=notes)
    assert "1 images cannot be read and were left out; the first: bag, image 3" in notes[1]
    assert "1 images have the timestamp of another one" in notes[2]
    found, images, _ = frames_of(open_images(tmp_path / "out", need_imu=False))
    assert found == [t for k, t in enumerate(stamps(5)) if k != 3]
    np.testing.assert_array_equal(images[1], picture(1))


def test_nothing_half_written_is_left(tmp_path):
    def frames(_):
        yield Frame(t_ns=START, where="", decode=lambda: picture(0))
        raise RecordingError("the disk was pulled out")

    recording = ImageRecording(imus={"imu0": imu()}, streams={"cam0": ImageStream(frames=frames)})
    with pytest.raises(RecordingError, match="pulled out"):
        save_euroc(recording, tmp_path / "a" / "out")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RecordingError, match="none of its images can be read"):
        save_euroc(replace(recording, streams={"cam0": stream(2, damaged={0, 1})}), tmp_path / "a" / "out", notes=[])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_in_it_is_not_touched(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    recording = ImageRecording(imus={}, streams={"cam0": stream(2)})
    with pytest.raises(OutputError, match="not empty"):
        save_euroc(recording, tmp_path)
    with pytest.raises(OutputError, match="a file of this name"):
        save_euroc(recording, tmp_path / "mine.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "empty").mkdir()
    save_euroc(recording, tmp_path / "empty")
    assert [path.name for path in (tmp_path / "empty").iterdir()] == ["mav0"]


def test_triads_with_stamps_of_their_own_are_refused(tmp_path):
    samples = imu()
    slower = replace(samples.gyroscope, t_ns=samples.gyroscope.t_ns + 1)
    recording = ImageRecording(imus={"imu0": replace(samples, gyroscope=slower)}, streams={"cam0": stream(2)})
    with pytest.raises(OptionError, match="timestamps of their own"):
        save_euroc(recording, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
