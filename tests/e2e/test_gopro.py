"""One MP4 of an action camera, video and telemetry, through the whole command."""

from fractions import Fraction

import av
import numpy as np
import pytest

import gnomon
import gpmf_files
import recorded
from gnomon.readers.images.image_recording import open_images


@pytest.mark.long
def test_one_mp4_is_calibrated_like_the_folder_it_was_made_of(run, walks, tmp_path):
    """Video and samples have one clock, so that even the time shift is the same."""
    source, path = walks.rendered(), tmp_path / "GX010001.MP4"
    write_gopro(open_images(source), path)
    code, out, err = run("check", path, "--target", source / "target.yaml")
    assert code == 0, err
    assert "80 images of 320 x 240 px" in out
    found = calibrated(run, path, source, tmp_path / "gopro")
    expected = calibrated(run, source, source, tmp_path / "folder")
    between = found.cameras["cam0"].time_shift_cam_imu - expected.cameras["cam0"].time_shift_cam_imu
    assert abs(between) < 20e-6  # timestamps of the telemetry are in whole microseconds
    assert recorded.most_sigmas(found, expected) < 0.3
    assert [source.name for source in found.provenance.inputs].count(path.name) == 1


def calibrated(run, path, source, out):
    code, _, err = run("camera-imu", path, *recorded.inputs(source), "-o", out, "--no-report")
    assert code == 0, err
    return gnomon.load(out / "calibration.yaml")


def write_gopro(recording, path):
    """Write a recording as one MP4, without loss, whose telemetry has its samples."""
    frames = list(recording.streams["cam0"].frames([]))
    plain = path.with_suffix(".plain.mp4")
    with av.open(str(plain), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"qp": "0"})
        stream.pix_fmt = "yuvj420p"
        height, width = frames[0].decode().shape
        stream.width, stream.height = width, height
        stream.codec_context.time_base = Fraction(1, 90_000)
        for frame in frames:
            image = av.VideoFrame.from_ndarray(frame.decode(), format="gray").reformat(format="yuvj420p")
            image.pts = round((frame.t_ns - frames[0].t_ns) * 90_000 / 1e9)
            image.time_base = Fraction(1, 90_000)
            container.mux(stream.encode(image))
        container.mux(stream.encode(None))
    imu = recording.imus["imu0"]
    first_us = gpmf_files.FRAME_US + (int(imu.gyroscope.t_ns[0]) - frames[0].t_ns) / 1000
    payloads, durations = gpmf_files.payloads_of(
        imu.accelerometer.values, imu.gyroscope.values, imu.gyroscope.rate_hz, first_us=first_us, orientation="YxZ"
    )
    path.write_bytes(gpmf_files.with_telemetry(plain.read_bytes(), payloads, durations))
    plain.unlink()
    np.testing.assert_allclose(gnomon.read(path).imus["imu0"].gyroscope.values, imu.gyroscope.values, atol=1e-6)
