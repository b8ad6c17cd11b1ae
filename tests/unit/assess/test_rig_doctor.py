"""The data doctor's look at a recording whose cameras are images: every fault by its code, a good one has none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gnomon.assess.checks.rig_doctor import check_rig
from gnomon.errors import RecordingError
from gnomon.models.target import Target
from gnomon.recording import ImuSamples, TriadSamples
from gnomon.recording.recording import Arrivals, Frame, ImageRecording, ImageStream
from rendered import Ranges, euroc_camera, rendered_views

BOARD = Target.aprilgrid(tag_cols=4, tag_rows=3, tag_size_m=0.088, tag_spacing=0.3)
CHECKERBOARD = Target.checkerboard(cols=7, rows=6, row_spacing_m=0.08, col_spacing_m=0.08)
EPOCH = 1_600_000_000_000_000_000
CAMERA = euroc_camera()


def drawn(target):
    ranges = Ranges(tag_px=(35, 45), blur_px=(0.5, 0.7), motion_px=(0, 0.3), noise=(1, 2), tilt_deg=(0, 30),
                    vignetting=(0, 0.1), clutter=False, covers=0, partial=False)  # fmt: skip
    return [view.image for view in rendered_views(target, 6, 2, camera=CAMERA, ranges=ranges)]


@pytest.fixture(scope="module")
def board_images():
    return drawn(BOARD)


@pytest.fixture(scope="module")
def other_images():
    """Images without a board."""
    rng = np.random.default_rng(5)
    images = []
    for _ in range(6):
        image = np.full((480, 752), 110, np.uint8)
        for _ in range(100):
            at = tuple(rng.uniform(0, 752, 2))
            box = cv2.boxPoints((at, tuple(rng.uniform(40, 120, 2)), rng.uniform(0, 90)))
            cv2.fillPoly(image, [np.rint(box).astype(np.int32)], int(rng.integers(20, 230)), lineType=cv2.LINE_AA)
        images.append(cv2.GaussianBlur(image, (0, 0), 0.7))
    return images


def imu(seconds=20.0, rate_hz=200.0, start_s=0.0):
    rng = np.random.default_rng(1)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    rate = np.stack([1.1 * np.sin(6 * t), 0.9 * np.cos(5 * t), 0.8 * np.sin(4.1 * t + 1)], axis=1)
    force = np.stack([2 * np.sin(7 * t), 9.6 + 1.5 * np.cos(6 * t), 1.5 * np.sin(5 * t)], axis=1)
    t_ns = EPOCH + np.rint((start_s + t) * 1e9).astype(np.int64)
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=force + rng.normal(0, 0.03, force.shape), unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=rate + rng.normal(0, 0.002, rate.shape), unit="rad/s"),
    )


def stream(images, t_ns=None, *, count=None, damaged=(), note="", **more):
    """Return the images over and over, at 20 Hz; every frame that is decoded is noted in `stream.decoded`."""
    t_ns = EPOCH + np.arange(400) * 50_000_000 if t_ns is None else t_ns
    decoded = []

    def picture(number):
        decoded.append(number)
        if number in damaged:
            raise RecordingError(f"frame {number}: not a PNG.")
        # One grey level in a corner tells the frames apart.
        image = images[number % len(images)].copy()
        image[0, 0] = number % 256
        return image

    def frames(notes):
        for number, t in enumerate(t_ns.tolist()):
            yield Frame(t_ns=t, where=f"frame {number}", decode=lambda number=number: picture(number))
        if note:
            notes.append(note)

    made = ImageStream(frames=frames, count=len(t_ns) if count is None else count, **more)
    return made, decoded


def check(made, target=None, imus=None, sample=12, **more):
    recording = ImageRecording(imus={"imu0": imu()} if imus is None else imus, streams={"cam0": made}, **more)
    look = check_rig(recording, target, sample=sample)
    for finding in look.findings:
        assert finding.severity not in {"warning", "problem"} or (finding.consequence and finding.cure)
    return look


def bad(look):
    return {finding.code: finding for finding in look.findings if finding.severity in {"warning", "problem"}}


def test_recording_alone(other_images) -> None:
    made, decoded = stream(other_images, topic="/cam0/image_raw")
    look = check(made)
    assert {finding.severity for finding in look.findings} == {"good"}
    assert [finding.code for finding in look.findings][-1] == "images"
    found = look.streams["cam0"]
    assert (found.topic, len(found.t_ns), found.size, len(found.looks), found.views) == (
        "/cam0/image_raw", 400, (752, 480), 12, ()
    )  # fmt: skip
    assert decoded == np.unique(np.linspace(0, 399, 12).astype(int)).tolist()  # no other image was decoded


@pytest.mark.parametrize("target", [BOARD, CHECKERBOARD])
def test_with_a_board(target) -> None:
    made, _ = stream(drawn(target))
    look = check(made, target)
    assert bad(look) == {}
    assert look.streams["cam0"].seen >= 10
    assert "the board's black is" in next(f.message for f in look.findings if f.code == "images")


def test_number_of_images_not_known(board_images) -> None:
    made, decoded = stream(board_images, count=0)
    look = check(made, BOARD)
    assert bad(look) == {}
    assert len(decoded) == len(look.streams["cam0"].looks) == 12


def test_blurred_at_the_board(board_images) -> None:
    blurred = [cv2.blur(image, (9, 1)) if k % 2 else image for k, image in enumerate(board_images)]
    assert "motion-blur" in bad(check(stream(blurred)[0], BOARD))


def test_no_board(other_images) -> None:
    problems = bad(check(stream(other_images)[0], BOARD))
    assert list(problems) == ["board-missing"]
    assert "AprilGrid 4 x 3" in problems["board-missing"].message
    assert "none of 12 images" in problems["board-missing"].message


def test_another_board() -> None:
    message = bad(check(stream(drawn(CHECKERBOARD))[0], BOARD))["board-missing"].message
    assert "checkerboard" in message
    assert "7" in message.split("over the recording.")[1]


def test_board_in_half_of_the_images(board_images, other_images) -> None:
    problems = bad(check(stream([*board_images[:3], *other_images[:3]])[0], BOARD, sample=60))
    assert list(problems) == ["board-rare"]


def test_no_imu(other_images) -> None:
    problems = bad(check(stream(other_images)[0], imus={}))
    assert list(problems) == ["imu-missing"]


@pytest.mark.parametrize("count", [0, 3])
def test_hardly_any_images(other_images, count) -> None:
    look = check(stream(other_images, EPOCH + np.arange(count) * 50_000_000)[0])
    assert bad(look)["images-missing"].severity == "problem"
    assert f"{count} images" in bad(look)["images-missing"].message


def test_damaged_images(other_images) -> None:
    some = bad(check(stream(other_images, damaged={0})[0]))
    assert some["images-damaged"].severity == "warning"
    assert "1 of 12 images that were tried cannot be decoded. The first: frame 0: not a PNG." in str(
        some["images-damaged"]
    )
    every = bad(check(stream(other_images, damaged=range(400))[0]))
    assert every["images-damaged"].severity == "problem"


def test_recording_that_ends_early(other_images) -> None:
    problems = bad(check(stream(other_images, count=500, note="walk.bag: ends in the middle of a chunk.")[0]))
    assert list(problems) == ["images-incomplete"]
    assert "cam0: walk.bag: ends in the middle of a chunk." in problems["images-incomplete"].message


def test_size_of_the_images(other_images) -> None:
    made, _ = stream([image[:240, :320] for image in other_images], camera=CAMERA)
    assert bad(check(made))["image-size"].severity == "problem"


def test_stamps(other_images) -> None:
    t_ns = EPOCH + np.arange(400) * 50_000_000
    assert bad(check(stream(other_images, np.delete(t_ns, np.arange(100, 180)))[0]))["frame-gaps"]
    swapped = t_ns.copy()
    swapped[[50, 51]] = swapped[[51, 50]]
    assert list(bad(check(stream(other_images, swapped)[0]))) == ["frames-backward"]
    rng = np.random.default_rng(1)
    late = np.sort(t_ns + rng.integers(0, 90_000_000, 400))
    assert list(bad(check(stream(other_images, late)[0]))) == ["frame-jitter"]
    assert list(bad(check(stream(other_images, np.zeros(400, np.int64))[0]))) == ["stamps-zero"]
    assert list(bad(check(stream(other_images, (t_ns - EPOCH) // 1000 + EPOCH)[0]))) == ["stamps-unit"]


def test_clocks_of_a_bag(other_images) -> None:
    t_ns = EPOCH + np.arange(400) * 50_000_000
    rng = np.random.default_rng(1)

    def received(stamps, ppm):
        true = stamps + (stamps - stamps[0]) * ppm * 1e-6
        return (true + rng.gamma(1, 2e6, len(stamps))).astype(np.int64)

    samples = imu()
    own = samples.gyroscope.t_ns

    def found(ppm):
        made = replace(stream(other_images)[0], arrivals=Arrivals(t_ns=t_ns, received_ns=received(t_ns, ppm)))
        arrived = {"imu0": Arrivals(t_ns=own, received_ns=received(own, 0))}
        return check(made, imus={"imu0": samples}, imu_arrivals=arrived)

    steady, drifting = found(0), found(300)
    assert bad(steady) == {}
    assert [finding.code for finding in steady.findings].count("clock") == 2
    assert list(bad(drifting)) == ["clock-drift"]
