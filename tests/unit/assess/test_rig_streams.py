"""The data doctor's look at cameras and IMU together: every fault is named by its code, a good recording has none."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.checks.board_views import board_sightings, image_coverage
from gnomon.assess.checks.rig_streams import check_cameras
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames, ImuSamples, Recording, TriadSamples

BAD = {"warning", "problem"}
BOARD = Target.aprilgrid(tag_cols=3, tag_rows=2, tag_size_m=0.08, tag_spacing=0.3)
CAMERA = Camera(
    projection="pinhole",
    intrinsics=[460, 458, 320, 240],
    distortion="none",
    distortion_coeffs=[],
    resolution=(640, 480),
)
EPOCH = 1_600_000_000_000_000_000


def imu(seconds: float = 40.0, rate_hz: float = 200.0, seed: int = 1) -> ImuSamples:
    """Return samples of a waved IMU [m/s^2, rad/s]."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    rate = np.stack([1.1 * np.sin(6 * t), 0.9 * np.cos(5 * t), 0.8 * np.sin(4.1 * t + 1)], axis=1)
    force = np.stack([2 * np.sin(7 * t), 9.6 + 1.5 * np.cos(6 * t), 1.5 * np.sin(5 * t)], axis=1)
    t_ns = EPOCH + np.rint(t * 1e9).astype(np.int64)
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=force + rng.normal(0, 0.03, force.shape), unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=rate + rng.normal(0, 0.002, rate.shape), unit="rad/s"),
    )


def camera(seconds: float = 40.0, rate_hz: float = 20.0, scale: float = 70.0, sway: float = 150.0) -> CameraFrames:
    """Return frames of a board that sways over the image, all of its points in each."""
    count, points = round(seconds * rate_hz), len(BOARD.points)
    t = np.arange(count) / rate_hz
    centre = np.stack([320 + sway * np.sin(0.7 * t), 240 + 0.7 * sway * np.cos(1.1 * t)], axis=1)
    board = (BOARD.points[:, :2] - BOARD.points[:, :2].mean(axis=0)) / 0.08 * scale * [1, -1]  # v runs down
    return CameraFrames(
        t_ns=EPOCH + np.rint(t * 1e9).astype(np.int64),
        frame=np.repeat(np.arange(count), points),
        point=np.tile(np.arange(points), count),
        pixels=(centre[:, None] + board).reshape(-1, 2),
        camera=CAMERA,
    )


def kept(frames: CameraFrames, mask) -> CameraFrames:
    """Return the frames with only some of their corners."""
    return replace(frames, frame=frames.frame[mask], point=frames.point[mask], pixels=frames.pixels[mask])


def without_frames(frames: CameraFrames, gone) -> CameraFrames:
    """Return a recording in which some of the frames were lost."""
    stay = np.setdiff1d(np.arange(len(frames.t_ns)), gone)
    frames = kept(frames, np.isin(frames.frame, stay))
    return replace(frames, t_ns=frames.t_ns[stay], frame=np.searchsorted(stay, frames.frame))


def check(frames=None, samples=None):
    frames, samples = frames or camera(), samples or imu()
    return check_cameras(Recording(imus={"imu0": samples}, cameras={"cam0": frames}), BOARD)


def bad(*args, **kwargs):
    """Return code -> finding of what is wrong, each of which must tell what follows and what to do."""
    found = [finding for finding in check(*args, **kwargs) if finding.severity in BAD]
    assert all(finding.consequence and finding.cure for finding in found)
    return {finding.code: finding for finding in found}


def test_good_recording_has_only_good_findings() -> None:
    found = {finding.code: finding.severity for finding in check()}
    assert found == {
        "rate": "good",
        "saturation": "good",
        "gravity-magnitude": "good",
        "frames": "good",
        "image-coverage": "good",
    }
    assert "cam0: 800 frames in 40.0 s, the board in 800 of them, usually 24 of its 24 corners." in str(check()[-2])


def test_real_recordings_are_fit(real_data) -> None:
    path = real_data("euroc-imu-april")
    kalibr = real_data("kalibr-format-samples/openvins_euroc_mav")
    recording, target = gnomon.read_camera_imu(
        path,
        cam=kalibr / "kalibr_imucam_chain.yaml",
        imu=kalibr / "kalibr_imu_chain.yaml",
        target=real_data("rendered-camimu") / "a-aprilgrid-full" / "target.yaml",
    )
    assert {finding.severity for finding in check_cameras(recording, target)} == {"good"}


# ---- what a frame shows ----


def test_views_of_single_frames() -> None:
    frames = camera(seconds=0.3)
    few = np.isin(frames.point, [0, 1, 6]) | (frames.frame != 1)  # three corners
    line = np.isin(frames.point, [0, 1, 2, 3, 4, 5]) | (frames.frame != 2)  # the lowest row
    diagonal = np.isin(frames.point, [0, 6, 7, 8, 9, 10]) | (frames.frame != 3)  # one below the others is enough
    gone = frames.frame != 4
    seen = board_sightings(kept(frames, few & line & diagonal & gone), BOARD)
    assert seen.frame.tolist() == [0, 1, 2, 3, 5]
    assert seen.corners.tolist() == [24, 3, 6, 6, 24]
    assert seen.usable.tolist() == [True, False, False, True, True]
    width, height = np.ptp(BOARD.points[:, :2], axis=0) / 0.08 * 70
    assert seen.extent_px[0] == pytest.approx(np.hypot(width, height))


def test_corners_on_a_slanted_line_are_useless() -> None:
    board = Target.checkerboard(cols=6, rows=6, row_spacing_m=0.1, col_spacing_m=0.1)
    pixels = np.random.default_rng(1).uniform(10, 400, (36, 2))
    frames = replace(camera(seconds=0.05), point=np.arange(36), frame=np.zeros(36, np.int64), pixels=pixels)
    slanted = kept(frames, np.isin(frames.point, [0, 7, 14, 21, 28, 35]))
    assert board_sightings(slanted, board).usable.tolist() == [False]
    assert board_sightings(kept(frames, np.isin(frames.point, [0, 7, 14, 21, 28, 34])), board).usable.tolist() == [True]


def test_coverage_counts_cells() -> None:
    pixels = np.array([[-0.5, -0.5], [63, 59], [64, 59], [639.4, 479.4], [700, 20], [-5, 3]])
    assert image_coverage(pixels, (640, 480)) == 3 / 80
    assert image_coverage(np.empty((0, 2)), (640, 480)) == 0
    every = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1).reshape(-1, 2)
    assert image_coverage(every, (640, 480)) == 1


# ---- cameras ----


@pytest.mark.parametrize(
    ("count", "severity"), [(0, "problem"), (9, "problem"), (10, "warning"), (59, "warning"), (60, None)]
)
def test_few_frames(count, severity) -> None:
    frames = camera()
    # The frames are spread over the whole time; most of the others show three corners.
    whole = np.round(np.linspace(0, 799, count)).astype(int)
    seen = kept(frames, np.isin(frames.frame, whole) | ((frames.point < 3) & (frames.frame % 2 == 0)))
    found = bad(seen)
    assert found["frames-few"].severity == severity if severity else "frames-few" not in found
    if severity:
        assert f"800 frames in 40.0 s, the board in {count} of them" in found["frames-few"].message


def test_no_corners_at_all() -> None:
    frames = camera()
    found = bad(kept(frames, np.zeros(len(frames.frame), bool)))
    assert found["frames-few"].severity == "problem"
    empty = replace(kept(frames, np.zeros(len(frames.frame), bool)), t_ns=np.empty(0, np.int64))
    assert bad(empty)["frames-few"].severity == "problem"


@pytest.mark.parametrize(("share", "severity"), [(0.05, "info"), (0.5, "warning")])
def test_frames_with_few_corners(share, severity) -> None:
    frames = camera()
    seen = kept(frames, (frames.frame % 100 >= 100 * share) | (frames.point < 3))
    finding = next(finding for finding in check(seen) if finding.code == "corners-few")
    assert finding.severity == severity
    assert f"cam0: {round(800 * share)} of 800 frames" in finding.message


def test_frames_out_of_order_or_twice() -> None:
    frames = camera()
    t_ns = frames.t_ns.copy()
    t_ns[100] = t_ns[99]
    assert "the timestamp of frame 100 is not later" in bad(replace(frames, t_ns=t_ns))["frames-backward"].message
    t_ns[100] = t_ns[90]
    assert bad(replace(frames, t_ns=t_ns))["frames-backward"].severity == "problem"


@pytest.mark.parametrize("number", [24, -1])
def test_points_that_the_board_does_not_have(number) -> None:
    frames = camera()
    point = frames.point.copy()
    point[50] = number
    found = bad(replace(frames, point=point))
    assert list(found) == ["corners-unknown"]
    assert f"the first is point {number}" in found["corners-unknown"].message


def test_corners_outside_the_image() -> None:
    frames = camera()
    assert "corners-outside" not in bad(replace(frames, pixels=frames.pixels + np.array([100, 0])))
    assert bad(replace(frames, pixels=frames.pixels + np.array([300, 200])))["corners-outside"].severity == "problem"


@pytest.mark.parametrize(("rate_hz", "slow"), [(3.0, True), (5.0, False)])
def test_frame_rate(rate_hz, slow) -> None:
    assert ("frame-rate" in bad(camera(rate_hz=rate_hz))) == slow


def test_lost_frames() -> None:
    some = next(f for f in check(without_frames(camera(), [100, 101, 300])) if f.code == "frame-gaps")
    assert some.severity == "info"
    assert "2 gaps, about 3 frames missing; the longest lasts 0.15 s, 4.95 s after the start" in some.message
    many = np.flatnonzero(np.arange(800) % 4 == 0)
    assert "about 199 frames missing" in bad(without_frames(camera(), many))["frame-gaps"].message


def test_irregular_frames() -> None:
    frames = camera()
    jitter = np.random.default_rng(1).integers(-30_000_000, 30_000_000, 800)
    jittered = replace(frames, t_ns=np.sort(frames.t_ns + jitter))
    assert "timestamps are irregular" in bad(jittered)["frame-jitter"].message
    slight = replace(frames, t_ns=frames.t_ns + jitter // 20)
    assert bad(slight) == {}


def test_board_out_of_sight() -> None:
    frames = camera()
    hidden = kept(frames, (frames.frame < 201) | (frames.frame >= 282))
    found = bad(hidden)
    assert list(found) == ["board-unseen"]
    assert "out of sight for 4.1 s, from 10.0 s" in found["board-unseen"].message
    assert bad(kept(frames, (frames.frame < 200) | (frames.frame >= 220))) == {}


def test_board_in_a_corner_of_the_image_and_small() -> None:
    found = bad(camera(scale=20.0, sway=10.0))
    assert set(found) == {"image-coverage", "board-small"}
    assert "Errors of the intrinsics" in found["image-coverage"].consequence
    assert set(bad(camera(scale=20.0, sway=200.0))) == {"board-small"}


@pytest.mark.parametrize(("seconds", "severity"), [(4.0, "problem"), (15.0, "warning"), (21.0, None)])
def test_short_streams(seconds, severity) -> None:
    found = bad(camera(seconds=seconds))
    assert found["stream-short"].severity == severity if severity else "stream-short" not in found
    found = [f for f in check(samples=imu(seconds=seconds)) if f.code == "stream-short"]
    assert [f.severity for f in found] == (["problem"] if seconds < 5 else [])


@pytest.mark.parametrize(
    ("shift_s", "severity", "part"),
    [
        (0.0, None, ""),
        (2.0, None, ""),
        (10.0, "info", "only 30.0 s in common"),
        (38.0, "warning", "only 2.0 s in common"),
        (1e6, "info", "no time in common"),
        (-1e6, "info", "no time in common"),
    ],
)
def test_streams_apart(shift_s, severity, part) -> None:
    frames = camera()
    moved = replace(frames, t_ns=frames.t_ns + round(shift_s * 1e9))
    found = [finding for finding in check(moved) if finding.code == "streams-apart"]
    assert [finding.severity for finding in found] == ([severity] if severity else [])
    assert part in "".join(map(str, found))
    # A stated time shift brings them together.
    stated = replace(moved, time_shift_cam_imu_s=-shift_s)
    assert not [finding for finding in check(stated) if finding.code == "streams-apart"]


def test_no_camera() -> None:
    found = check_cameras(Recording(imus={"imu0": imu()}), BOARD)
    assert [finding.code for finding in found if finding.severity == "problem"] == ["cameras-missing"]


def test_every_camera_is_looked_at() -> None:
    cameras = {"cam0": camera(), "cam1": camera(seconds=4.0)}
    found = check_cameras(Recording(imus={"imu0": imu()}, cameras=cameras), BOARD)
    assert [str(f)[:5] for f in found if f.code == "stream-short"] == ["cam1:"]


# ---- IMUs ----


def changed(*, accelerometer=None, gyroscope=None, **stamps) -> ImuSamples:
    """Return a waved IMU with other values or units of a triad, or other timestamps (t_ns) of both."""
    samples = imu()
    return ImuSamples(
        accelerometer=replace(samples.accelerometer, **(accelerometer or {}), **stamps),
        gyroscope=replace(samples.gyroscope, **(gyroscope or {}), **stamps),
    )


FORCE, RATE, T_NS = imu().accelerometer.values, imu().gyroscope.values, imu().gyroscope.t_ns
NOISE = np.random.default_rng(2).normal(0, 0.002, RATE.shape)


def with_value(values, row: int, value: float):
    values = values.copy()
    values[row, 1] = value
    return values


@pytest.mark.parametrize(
    ("samples", "code", "severity"),
    [
        (changed(gyroscope={"values": with_value(RATE, 7, np.nan)}), "samples-lost", "problem"),
        (changed(accelerometer={"values": with_value(FORCE, 7, np.inf)}), "samples-lost", "problem"),
        (changed(accelerometer={"unit": "count"}), "unit", "problem"),
        (changed(gyroscope={"unit": "count"}), "unit", "problem"),
        (changed(accelerometer={"values": FORCE / 9.81}), "gravity-magnitude", "problem"),
        (changed(accelerometer={"values": FORCE - [0, 9.6, 0]}), "gravity-magnitude", "problem"),
        (changed(accelerometer={"values": FORCE * 1.4}), "gravity-magnitude", "warning"),
        (
            changed(
                accelerometer={"values": FORCE * np.where(np.arange(len(FORCE)) > 0.6 * len(FORCE), 2, 1)[:, None]}
            ),
            "range-changed",
            "problem",
        ),
        (changed(gyroscope={"values": np.degrees(RATE)}), "rate-magnitude", "warning"),
        (changed(gyroscope={"values": np.radians(RATE)}), "rate-magnitude", "warning"),
        (changed(gyroscope={"values": NOISE}), "gyroscope-silent", "problem"),
        (
            changed(gyroscope={"values": NOISE}, accelerometer={"values": np.array([0, 9.8, 0]) + NOISE}),
            "imu-still",
            "problem",
        ),
        (changed(gyroscope={"values": 0 * RATE}), "signal-constant", "problem"),
        (changed(gyroscope={"values": RATE * [1, 0, 1]}), "axis-constant", "problem"),
        (changed(gyroscope={"values": np.clip(RATE, -0.7, 0.7)}), "saturation", "warning"),
        (changed(t_ns=np.full(len(T_NS), EPOCH)), "time-constant", "problem"),
        (changed(t_ns=np.concatenate([T_NS[1000:], T_NS[:1000]])), "time-backward", "problem"),
        (changed(t_ns=T_NS + 10**9 * (np.arange(len(T_NS)) > 4000)), "gaps", "warning"),
        (imu(rate_hz=30), "imu-rate", "warning"),
        (imu(rate_hz=8), "imu-rate", "problem"),
        (imu(seconds=0.001), "samples-missing", "problem"),
    ],
)
def test_faults_of_the_imu(samples, code, severity) -> None:
    found = bad(samples=samples)
    assert found[code].severity == severity
    assert found[code].message.startswith("imu0")


def test_other_units_are_understood() -> None:
    force, rate = {"values": FORCE / 9.80665, "unit": "g"}, {"values": np.degrees(RATE), "unit": "deg/s"}
    assert bad(samples=changed(accelerometer=force, gyroscope=rate)) == {}
    found = [
        next(f for f in check(samples=s) if f.code == "gravity-magnitude")
        for s in (imu(), changed(accelerometer=force))
    ]
    assert found[0] == found[1]


def test_words_fit_a_recording_without_rests() -> None:
    gaps = bad(samples=changed(t_ns=T_NS + 10**9 * (np.arange(len(T_NS)) > 4000)))["gaps"]
    assert gaps.consequence == "There the trajectory rests on the other sensors alone."
    clipped = bad(samples=changed(gyroscope={"values": np.clip(RATE, -0.7, 0.7)}))["saturation"]
    assert clipped.consequence == "They are masked."
    for samples in (changed(gyroscope={"values": 0 * RATE}), changed(t_ns=np.full(len(T_NS), EPOCH))):
        assert not any(
            "--columns" in finding.cure or "--rate" in finding.cure for finding in bad(samples=samples).values()
        )


@pytest.mark.parametrize("bias", [0.5, -0.5])
def test_biases_are_no_fault(bias) -> None:
    samples = changed(
        gyroscope={"values": RATE + bias}, accelerometer={"values": FORCE + np.array([bias, 0, 2 * bias])}
    )
    assert bad(samples=samples) == {}


@pytest.mark.parametrize("frequency_hz", [8.0, 15.0, 20.0])
def test_shaking_is_no_silence_and_no_wrong_unit(frequency_hz) -> None:
    t = (T_NS - T_NS[0]) * 1e-9
    shake = np.sin(2 * np.pi * frequency_hz * t)[:, None] * [1.0, 0.8, 0.9]
    samples = changed(gyroscope={"values": RATE * 0.2 + 3 * shake}, accelerometer={"values": FORCE + 10 * shake})
    assert bad(samples=samples) == {}
