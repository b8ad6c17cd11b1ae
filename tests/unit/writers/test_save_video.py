"""Videos that are written keep their frames and their times."""

import numpy as np
import pytest

from gnomon.errors import OptionError, OutputError
from gnomon.readers.images.image_recording import open_images
from gnomon.writers.image_folders import save_video
from image_folders import frames_of, picture

TIMES = np.cumsum(np.random.default_rng(2).integers(30_000_000, 90_000_000, 12))


@pytest.mark.parametrize(
    ("name", "codec", "off_ns"),
    [("a.mkv", "ffv1", 600_000), ("a.mp4", "mpeg4", 20_000), ("a.mov", "mjpeg", 20_000), ("a.mkv", "mpeg4", 600_000)],
)
def test_frames_keep_their_times(tmp_path, name, codec, off_ns):
    images = [picture(k, height=48, width=64) for k in range(len(TIMES))]
    assert save_video(tmp_path / name, images, TIMES, codec=codec) == len(TIMES)
    t_ns, found, notes = frames_of(open_images(tmp_path / name, need_imu=False))
    assert notes == []
    np.testing.assert_allclose(t_ns, TIMES - TIMES[0], atol=off_ns)
    for image, original in zip(found, images, strict=True):
        if codec == "ffv1":
            np.testing.assert_array_equal(image, original)
        else:
            assert np.corrcoef(image.ravel().astype(float), original.ravel().astype(float))[0, 1] > 0.95


def test_avi_has_a_rate_only(tmp_path):
    images = [picture(k, height=48, width=64) for k in range(6)]
    save_video(tmp_path / "a.avi", images, TIMES[:6], codec="mjpeg", rate_hz=20.0)
    t_ns, _, _ = frames_of(open_images(tmp_path / "a.avi", need_imu=False))
    np.testing.assert_allclose(t_ns, 50_000_000 * np.arange(6), atol=1000)


def test_places_that_cannot_be_written(tmp_path):
    images = [picture(k, height=48, width=64) for k in range(3)]
    with pytest.raises(OptionError, match=r"found \.gif"):
        save_video(tmp_path / "a.gif", images, TIMES[:3])
    with pytest.raises(OutputError, match="cannot be written"):
        save_video(tmp_path / "nowhere" / "a.mkv", images, TIMES[:3])
    with pytest.raises(OptionError, match="no codec no-such-codec"):
        save_video(tmp_path / "odd.mp4", images, TIMES[:3], codec="no-such-codec")
    assert list(tmp_path.iterdir()) == []
