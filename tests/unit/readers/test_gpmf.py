"""Telemetry of GoPro cameras: GoPro's own samples, and files made as its documentation describes them."""

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gnomon
import gpmf_files as made
from gnomon.errors import OptionError, RecordingError
from gnomon.readers.devices.device_log import is_device_log, read_device_log
from gnomon.readers.devices.gpmf import has_gpmf
from gnomon.readers.devices.gpmf_streams import Telemetry, gpmf_entries, in_camera_axes
from gnomon.readers.images.image_recording import holds_images, open_images
from gnomon.readers.samples.stream import open_stream
from gnomon.units import Units
from image_folders import write_video

RATE = 197.3


def motion(count=1500, seed=3):
    """Return accelerometer and gyroscope of a device that turns, (n, 3) each."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / RATE
    force = 9.8 * np.column_stack([np.sin(t), np.cos(t) * np.sin(0.7 * t), np.cos(t) * np.cos(0.7 * t)])
    return force + rng.normal(0, 0.02, (count, 3)), rng.normal(0, 0.5, (count, 3))


def written(path, data):
    path.write_bytes(data)
    return path


def imu_of(path):
    return gnomon.read(path).imus["imu0"]


# ---- GoPro's samples ----

SAMPLES = {  # samples of accelerometer and gyroscope, their rates, |a|, order of the axes
    "hero5.raw": (199, 399, 198.8, 398.6, 9.95, "ZXY"),
    "hero6.raw": (204, 204, 203.8, 203.8, 10.16, "ZXY"),
    "hero6+ble.raw": (198, 198, 197.8, 197.8, 10.28, "YxZ"),
    "Fusion.raw": (197, 3300, 196.8, 3296.7, 9.31, "yXZ"),
    "hero7.raw": (3369, 3369, 198.4, 198.4, 9.00, "YxZ"),
    "max-heromode.mp4": (2082, 2082, 197.455, 197.455, 9.64, "XzY"),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_gopros_samples(name, real_data):
    accelerometers, gyroscopes, rate, turning_rate, magnitude, orientation = SAMPLES[name]
    recording = gnomon.read(real_data(f"gopro-gpmf/{name}"))
    imu = recording.imus["imu0"]
    assert (len(imu.accelerometer), len(imu.gyroscope)) == (accelerometers, gyroscopes)
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    np.testing.assert_allclose(imu.accelerometer.rate_hz, rate, rtol=1e-3)
    np.testing.assert_allclose(imu.gyroscope.rate_hz, turning_rate, rtol=1e-3)
    np.testing.assert_allclose(np.median(np.linalg.norm(imu.accelerometer.values, axis=1)), magnitude, atol=0.01)
    assert f"stored as {orientation}" in " ".join(recording.assumptions)
    assert all((np.diff(triad.t_ns) > 0).all() for triad in (imu.accelerometer, imu.gyroscope))


def test_stamps_of_a_video(real_data):
    """They are those of its first frame, which the camera stamped 5.031 ms after the first sample."""
    recording = gnomon.read(real_data("gopro-gpmf/max-heromode.mp4"))
    samples = recording.imus["imu0"].gyroscope
    assert abs(samples.t_ns[0] - (80_577 - 85_608) * 1000) < 30_000
    assert abs(samples.t_ns[-1] - 10_543e6) < 10e6  # the video lasts 10.543 s
    said = " ".join(recording.assumptions)
    assert "timestamps of 11 payloads (largest deviation 0.021 ms)" in said
    assert "turned by up to 19.4 degrees" in said
    assert "31.1 to 31.8 degrees Celsius" in said
    warm = recording.imus["imu0"].temperature
    assert len(warm) == 11
    assert (warm.values.min().round(1), warm.values.max().round(1)) == (31.1, 31.8)
    np.testing.assert_allclose(np.diff(warm.t_ns[:-1]) * 1e-9, 1.001, atol=0.01)


def test_axes_are_right_handed_and_common_to_both(real_data):
    """The direction of gravity as the camera fused it turns as the gyroscope says, du/dt = -omega x u, in our axes."""
    path = real_data("gopro-gpmf/max-heromode.mp4")
    gyroscope = gnomon.read(path).imus["imu0"].gyroscope
    up = gravity_of(path)
    t = np.arange(len(up)) * 1.001 / 30
    smooth = np.column_stack([np.convolve(axis, np.ones(7) / 7, "same") for axis in gyroscope.values.T])
    rate = np.column_stack([np.interp(t, gyroscope.t_ns * 1e-9, axis) for axis in smooth.T])
    turned, predicted = np.gradient(up, t, axis=0), -np.cross(rate, up)
    slope = float((turned * predicted).sum() / (predicted**2).sum())
    correlation = float((turned * predicted).sum() / np.sqrt((predicted**2).sum() * (turned**2).sum()))
    assert 0.97 < slope < 1.01
    assert correlation > 0.97


def gravity_of(path):
    """Return the camera's GRAV, which has x, z, y, as unit vectors in x, y, z."""
    found = []
    with av.open(str(path)) as container:
        for packet in container.demux([s for s in container.streams if s.type == "data"]):
            if bytes(packet)[:4] == b"DEVC":
                ((root,), _) = gpmf_entries(bytes(packet))
                streams = [gpmf_entries(e.data)[0] for e in gpmf_entries(root.data)[0] if e.key == "STRM"]
                found += [e.numbers() for inside in streams for e in inside if e.key == "GRAV"]
    up = np.concatenate(found)[:, [0, 2, 1]]
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def test_rough_motion_averages_to_gravity_with_the_gyroscope_s_turns(real_data):
    """HERO7, 17 s of shaking: brought into one frame by the gyroscope, the specific force keeps its mean."""
    imu = imu_of(real_data("gopro-gpmf/hero7.raw"))
    assert mean_in_one_frame(imu, 1) > 8.7
    assert mean_in_one_frame(imu, -1) < 7.0


def mean_in_one_frame(imu, sign):
    from gnomon.geometry.rotations import rotation_from_rotvec

    step = float(np.mean(np.diff(imu.gyroscope.t_ns))) * 1e-9
    R, total = np.eye(3), np.zeros(3)
    for force, turn in zip(
        imu.accelerometer.values, rotation_from_rotvec(sign * imu.gyroscope.values * step), strict=True
    ):
        total += R @ force
        R = R @ turn
    return float(np.linalg.norm(total / len(imu.accelerometer)))


def test_of_several_devices_the_camera_is_taken(real_data):
    assert "Hero6 Black was taken, not SENSORB6" in " ".join(
        gnomon.read(real_data("gopro-gpmf/hero6+ble.raw")).assumptions
    )


# ---- files that were made ----


@pytest.mark.parametrize("orientation", ["ZXY", "YxZ", "zxY", "XzY"])
def test_what_is_written_is_read_in_any_order(tmp_path, orientation):
    force, rate = motion()
    payloads, _ = made.payloads_of(force, rate, RATE, orientation=orientation)
    imu = imu_of(written(tmp_path / "a.raw", b"".join(payloads)))
    np.testing.assert_allclose(imu.accelerometer.values, force, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(imu.gyroscope.values, rate, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(imu.gyroscope.t_ns * 1e-9, np.arange(len(rate)) / RATE, atol=2e-6)


@pytest.mark.parametrize(
    ("names", "device", "axes"),
    [
        (("Accelerometer (up/down, right/left, forward/back)", "Gyroscope (z,x,y)"), "Camera", "ZXY"),
        (("Accelerometer (up/down, right/left, forward/back)", "Gyroscope (z,x,y)"), "Fusion", "yXZ"),
        (("Accelerometer", "Gyroscope"), "Camera", ""),
    ],
)
def test_the_order_by_the_model_or_by_the_names_of_streams(tmp_path, names, device, axes):
    force, rate = motion(count=200)
    streams = [made.stream(key, v, name=n) for key, v, n in zip(("ACCL", "GYRO"), (force, rate), names, strict=True)]
    path = written(tmp_path / "a.raw", made.device(*streams, name=device))
    expected = in_camera_axes(force, axes) if axes else force
    np.testing.assert_allclose(imu_of(path).accelerometer.values, expected, rtol=1e-6, atol=1e-6)
    said = f"stored as {axes}" if axes else "nothing says clearly how the axes are ordered"
    assert said in " ".join(gnomon.read(path).assumptions)


@pytest.mark.parametrize(("stamps", "jitter", "within_s"), [(True, 4, 3e-6), (False, 0, 5e-3), (False, 4, 0.02)])
def test_stamps_come_from_an_even_clock(tmp_path, stamps, jitter, within_s):
    """Payloads begin some samples too early or too late; the clock is even, and as exact as what is stated."""
    force, rate = motion(count=round(60 * RATE))
    payloads, durations = made.payloads_of(force, rate, RATE, stamps=stamps, jitter=jitter, first_us=80_000)
    path = written(tmp_path / "a.mp4", made.telemetry_only(payloads, durations))
    t_ns = imu_of(path).accelerometer.t_ns
    expected = np.arange(len(force)) / RATE - (0.005 if stamps else 0.0)
    assert np.abs(t_ns * 1e-9 - expected).max() < within_s
    steps = np.diff(t_ns)
    assert np.ptp(steps) <= 2
    np.testing.assert_allclose(1e9 / steps.mean(), RATE, rtol=1e-6 if stamps else 5e-4)


def test_a_clock_that_drifts_is_followed(tmp_path):
    """The rate falls by 300 ppm over ten minutes; a line alone would be more than 10 ms off."""
    count = round(600 * RATE)
    true_s = np.arange(count) / RATE * (1 + 150e-6 * np.linspace(-1, 1, count))
    line = true_s - np.polyval(np.polyfit(np.arange(count), true_s, 1), np.arange(count))
    force = np.tile([0.0, 0.0, 9.8], (count, 1))
    first = np.arange(0, count, 198)
    payloads = [
        made.device(
            *(
                made.stream(key, force[k : k + 198], total=min(k + 198, count), stamp_us=round(true_s[k] * 1e6))
                for key in ("ACCL", "GYRO")
            )
        )
        for k in first.tolist()
    ]
    t_s = imu_of(written(tmp_path / "a.raw", b"".join(payloads))).accelerometer.t_ns * 1e-9
    assert np.abs(line).max() > 10e-3
    assert np.abs(t_s - true_s).max() < 0.4e-3


def test_samples_that_were_lost_leave_a_gap(tmp_path):
    force, rate = motion()
    payloads, _ = made.payloads_of(force, rate, RATE)
    recording = gnomon.read(written(tmp_path / "a.raw", b"".join(payloads[:2] + payloads[3:])))
    steps = np.diff(recording.imus["imu0"].gyroscope.t_ns)
    assert steps.max() > 0.9e9
    assert np.sum(steps > 1e8) == 1
    assert "samples of the gyroscope are missing between payloads" in " ".join(recording.assumptions)


def test_counts_that_do_not_fit_are_not_believed(tmp_path):
    """HERO11 was seen to count 211 where it stored 512."""
    force = np.tile([0.0, 0.0, 9.8], (512, 1))
    payloads = [
        made.device(*(made.stream(key, force, total=211 * (k + 1), stamp_us=k * 1_000_000) for key in ("ACCL", "GYRO")))
        for k in range(5)
    ]
    np.testing.assert_allclose(
        imu_of(written(tmp_path / "a.raw", b"".join(payloads))).gyroscope.rate_hz, 512, rtol=1e-6
    )


def test_one_mp4_gives_video_and_samples_in_one_clock(tmp_path):
    write_video(tmp_path / "plain.mp4", count=60, codec="mpeg4", pixels="yuv420p", rate=30)
    force, rate = motion(count=400)
    payloads, durations = made.payloads_of(force, rate, RATE)
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(made.with_telemetry((tmp_path / "plain.mp4").read_bytes(), payloads, durations))
    (tmp_path / "plain.mp4").unlink()
    assert is_device_log((path,))
    assert has_gpmf(path)
    assert holds_images(path)
    for place in (path, tmp_path):
        recording = open_images(place)
        assert recording.streams["cam0"].count == 60
        np.testing.assert_allclose(recording.imus["imu0"].gyroscope.values, rate, rtol=1e-6, atol=1e-6)
        assert recording.imus["imu0"].gyroscope.t_ns[0] == pytest.approx(-5e6, abs=3e3)
        frames = list(recording.streams["cam0"].frames([]))
        assert (len(frames), frames[0].t_ns) == (60, 0)


def test_a_table_beside_the_video_goes_before_its_telemetry(tmp_path):
    from image_folders import write_samples

    write_video(tmp_path / "plain.mp4", count=10, codec="mpeg4", pixels="yuv420p")
    payloads, durations = made.payloads_of(*motion(count=400), RATE)
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(made.with_telemetry((tmp_path / "plain.mp4").read_bytes(), payloads, durations))
    write_samples(tmp_path / "GX010001_imu.csv")
    assert len(open_images(path).imus["imu0"].gyroscope) == 40


def test_samples_come_in_blocks_for_apply(tmp_path):
    force, rate = motion()
    payloads, _ = made.payloads_of(force, rate, RATE)
    path = written(tmp_path / "a.raw", b"".join(payloads))
    stream = open_stream(path, expected=Units(), triads=("gyroscope",))
    assert stream.accelerometer is None
    assert sum(map(len, stream.gyroscope)) == len(rate)


# ---- what is wrong with a file ----


def refused(path, *words, **options):
    with pytest.raises((RecordingError, OptionError)) as error:
        gnomon.read(path, **options)
    text = str(error.value)
    assert path.name in text
    assert all(word in text for word in words), text


def test_a_video_without_telemetry(tmp_path):
    write_video(tmp_path / "a.mp4", count=5, codec="mpeg4", pixels="yuv420p")
    refused(tmp_path / "a.mp4", "no telemetry (GPMF)", "copy the original")
    assert not has_gpmf(tmp_path / "a.mp4")


def test_an_mp4_without_its_index(tmp_path):
    payloads, durations = made.payloads_of(*motion(), RATE)
    data = made.telemetry_only(payloads, durations)
    refused(written(tmp_path / "a.mp4", data[: len(data) // 2]), "cut off")


def test_a_device_without_a_gyroscope(tmp_path):
    force, _ = motion(count=200)
    path = written(tmp_path / "a.raw", made.device(made.stream("ACCL", force)))
    refused(path, "no accelerometer (ACCL) with a gyroscope (GYRO); found ACCL")


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ({"scale": 0}, "its scale"),
        ({"unit": "furlong"}, "furlong"),
        ({"kind": "#"}, "compressed"),
        ({"two": True}, "three components"),
    ],
)
def test_streams_that_cannot_be(tmp_path, broken, words):
    force, rate = motion(count=200)
    if "two" in broken:
        accelerometer = made.stream("ACCL", force[:, :2])
    elif "kind" in broken:
        accelerometer = made.entry("STRM", None, made.entry("ACCL", "#", bytes(12), 6, 2))
    else:
        accelerometer = made.stream("ACCL", force, **broken)
    refused(written(tmp_path / "a.raw", made.device(accelerometer, made.stream("GYRO", rate))), words)


def test_stamps_that_do_not_rise_are_left(tmp_path):
    force, _ = motion(count=600)
    payloads = [
        made.device(*(made.stream(key, force[k : k + 200], stamp_us=7) for key in ("ACCL", "GYRO")))
        for k in (0, 200, 400)
    ]
    recording = gnomon.read(written(tmp_path / "a.raw", b"".join(payloads)))
    assert recording.imus["imu0"].gyroscope.rate_hz == pytest.approx(200 / 1.001, rel=1e-6)


def test_columns_and_a_rate_have_no_meaning(tmp_path):
    path = written(tmp_path / "a.raw", b"".join(made.payloads_of(*motion(), RATE)[0]))
    refused(path, "--columns", columns="t ax ay az gx gy gz")
    refused(path, "--rate", rate_hz=200.0)


def test_a_stream_that_ends_early_is_read_as_far_as_it_goes(tmp_path):
    payloads, _ = made.payloads_of(*motion(), RATE)
    data = b"".join(payloads)
    recording = gnomon.read(written(tmp_path / "a.raw", data[:-1000]))
    assert "cut off or damaged" in " ".join(recording.assumptions)
    assert 1000 < len(recording.imus["imu0"].gyroscope) < 1500


@given(st.binary(max_size=400))
def test_any_bytes_are_entries_or_are_cut(data):
    found, whole = gpmf_entries(data)
    assert sum(8 + len(entry.data) for entry in found) <= len(data)
    assert whole or len(data) >= 1
    for entry in found:
        try:
            numbers = entry.numbers()
        except RecordingError:
            continue
        assert numbers.shape[0] == entry.count


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2600), st.integers(0, 255)), max_size=8), st.integers(0, 2600))
def test_damaged_telemetry_ends_in_samples_or_in_one_message(tmp_path_factory, changes, cut):
    """Bytes are changed anywhere, lengths too, and the end is cut off."""
    payloads, _ = made.payloads_of(*motion(count=90), 60.0)
    data = bytearray(b"".join(payloads))
    for place, value in changes:
        data[place % len(data)] = value
    path = tmp_path_factory.getbasetemp() / "damaged.raw"
    path.write_bytes(b"DEVC" + bytes(data[4 : max(8, len(data) - cut)]))
    log = outcome(path)
    if isinstance(log, str):
        assert "damaged.raw" in log
        return
    for t_ns, triad in (log.accelerometer, log.gyroscope):
        assert len(t_ns) == len(triad.values) >= 2
        assert np.isfinite(triad.values).all()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=6))
def test_damaged_mp4_ends_in_samples_or_in_one_message(tmp_path_factory, changes):
    payloads, durations = made.payloads_of(*motion(count=90), 60.0)
    data = bytearray(made.telemetry_only(payloads, durations))
    index = data.index(b"moov")
    for place, value in changes:
        data[index + place % (len(data) - index)] = value
    path = tmp_path_factory.getbasetemp() / "damaged.mp4"
    path.write_bytes(data)
    log = outcome(path)
    assert log is None or not isinstance(log, str) or "damaged.mp4" in log


def outcome(path):
    """Return what is read, or the message."""
    try:
        return read_device_log((path,))
    except RecordingError as error:
        return str(error)


def test_telemetry_of_one_entry_in_itself_without_end():
    """Nesting is looked into at the depth of the format alone."""
    data = b""
    for _ in range(3000):
        data = made.entry("DEVC", None, data[:60_000] + bytes(-len(data[:60_000]) % 4))
    telemetry = Telemetry()
    telemetry.add(data)
    assert telemetry.devices()[0].blocks == ()


def test_axes():
    np.testing.assert_array_equal(in_camera_axes(np.array([[1.0, 2.0, 3.0]]), "ZXY"), [[2.0, 3.0, 1.0]])
