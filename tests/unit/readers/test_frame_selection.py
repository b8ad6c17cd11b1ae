"""Parts of recordings with cameras: which frames are taken, and that nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraFrames, FrameSelection, OptionError, Recording, RecordingError
from gnomon.models.camera import Camera
from gnomon.readers.images.frame_stamps import select_frames, select_images
from gnomon.recording.recording import Arrivals, Frame, FrameQuality, ImageRecording, ImageStream

CAMERA = Camera(
    projection="pinhole",
    intrinsics=np.array([400.0, 400, 320, 240]),
    distortion="none",
    distortion_coeffs=np.empty(0),
    resolution=(640, 480),
)
START_NS = 1_700_000_000_000_000_000


def stream(t_s, arrivals=False) -> ImageStream:
    stamps = np.asarray(np.round(np.asarray(t_s) * 1e9), np.int64) + START_NS
    frames = [Frame(t_ns=int(t), where="", decode=lambda: np.zeros((2, 2), np.uint8)) for t in stamps]
    known = Arrivals(t_ns=stamps, received_ns=stamps) if arrivals else None
    return ImageStream(frames=lambda _: iter(frames), count=len(frames), arrivals=known)


def times_s(images: ImageRecording, name="cam0"):
    return np.array([frame.t_ns - START_NS for frame in images.streams[name].frames([])]) * 1e-9


@pytest.mark.parametrize("arrivals", [False, True])
def test_a_stretch_at_a_rate_is_taken_and_counted(arrivals) -> None:
    images = ImageRecording(imus={}, streams={"cam0": stream(np.arange(600) / 60, arrivals)})
    taken = select_images(images, FrameSelection(start_s=2, stop_s=4, frame_rate_hz=20))
    np.testing.assert_allclose(times_s(taken), 2 + np.arange(41) / 20, atol=1e-8)
    assert taken.streams["cam0"].count == 41
    assert "from 2 s to 4 s, 20 a second" in taken.assumptions[0]
    np.testing.assert_allclose(times_s(taken), times_s(taken))  # as often as it is asked for


def test_cameras_that_lost_frames_keep_the_same_ones() -> None:
    t_s = np.arange(300) / 30 + np.random.default_rng(1).uniform(-2e-3, 2e-3, 300)
    lost = np.delete(t_s, [30, 31, 150])
    images = ImageRecording(imus={}, streams={"cam0": stream(t_s), "cam1": stream(lost)})
    taken = select_images(images, FrameSelection(frame_rate_hz=10))
    first, second = times_s(taken), times_s(taken, "cam1")
    assert len(first) == len(second) == 100
    assert np.sum(first == second) >= 98  # another frame stands in where one was lost


def test_all_frames_are_the_recording_itself() -> None:
    images = ImageRecording(imus={}, streams={"cam0": stream([0, 1])})
    assert select_images(images, FrameSelection()) is images


def test_corners_go_with_their_frames() -> None:
    frame = np.repeat(np.arange(10), 3)
    quality = FrameQuality(blur_px=np.arange(10.0), black=np.arange(10.0), white=np.arange(10.0), dropped={"blur": 1})
    frames = CameraFrames(
        t_ns=START_NS + np.arange(10) * 10**9,
        frame=frame,
        point=np.tile(np.arange(3), 10),
        pixels=np.column_stack([frame, np.zeros(30)]),
        camera=CAMERA,
        sigma_px=1.0 + frame,
        quality=quality,
    )
    recording = Recording(imus={}, cameras={"cam0": frames})
    taken = select_frames(recording, FrameSelection(start_s=3, stop_s=8, frame_rate_hz=0.5)).cameras["cam0"]
    assert ((taken.t_ns - START_NS) // 10**9).tolist() == [3, 5, 7]
    assert taken.frame.tolist() == np.repeat([0, 1, 2], 3).tolist()
    assert taken.pixels[:, 0].tolist() == np.repeat([3.0, 5.0, 7.0], 3).tolist()
    assert taken.sigma_px is not None
    assert taken.sigma_px.tolist() == np.repeat([4.0, 6.0, 8.0], 3).tolist()
    assert taken.quality is not None
    assert taken.quality.blur_px.tolist() == [3, 5, 7]
    assert (
        select_frames(recording, FrameSelection()).cameras["cam0"].t_ns.tolist()
        == recording.cameras["cam0"].t_ns.tolist()
    )
    with pytest.raises(RecordingError, match="cam0 has no frames from 20 s on"):
        select_frames(recording, FrameSelection(start_s=20))
    bare = replace(frames, sigma_px=None, quality=None)
    assert len(bare.where(np.arange(10) < 2).frame) == 6


def test_a_stretch_without_images_is_refused() -> None:
    images = ImageRecording(imus={}, streams={"cam0": stream([0, 1])})
    with pytest.raises(RecordingError, match="cam0 has no frames from 5 s to 6 s"):
        select_images(images, FrameSelection(start_s=5, stop_s=6))


@pytest.mark.parametrize("options", [{"start_s": -1}, {"start_s": 3, "stop_s": 2}, {"frame_rate_hz": 0}])
def test_odd_stretches_are_refused(options) -> None:
    with pytest.raises(OptionError, match=next(reversed(options))):
        FrameSelection(**options)
