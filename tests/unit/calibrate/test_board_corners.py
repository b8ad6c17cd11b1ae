"""The recipe from images to corners: order, damage, sizes, and what is kept for the next run."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from gnomon.calibrate.steps.board_corners import BoardCorners, CameraImages, detect_corners
from gnomon.calibrate.steps.camera_reading import cache_file, keep_corners, kept_corners
from gnomon.errors import DetectionError, OptionError, RecordingError
from gnomon.formats.kalibr.camchain import CameraInput
from gnomon.models.board_pattern import board_pattern
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import Source
from gnomon.recording.recording import Frame, Grey, ImageStream
from gnomon.simulate.images.rendering import render_board
from rendered import FACING

BOARD = Target.aprilgrid(tag_cols=3, tag_rows=3, tag_size_m=0.08, tag_spacing=0.3)
CAMERA = Camera(
    projection="pinhole",
    intrinsics=np.array([230.0, 230.0, 159.5, 119.5]),
    distortion="none",
    distortion_coeffs=np.empty(0),
    resolution=(320, 240),
)
KNOWN = CameraInput(camera=CAMERA)


@pytest.fixture(scope="module")
def views() -> list[Grey]:
    pattern = board_pattern(BOARD)
    middle = BOARD.points.mean(axis=0)
    places = [np.array([0.002 * k, -0.001 * k, 0.4]) for k in range(20)]
    return [
        render_board(pattern, CAMERA, FACING, place - FACING @ middle, rng=np.random.default_rng(1)) for place in places
    ]


def frames(images: list[Grey], stamps: list[int] | None = None) -> list[Frame]:
    times = stamps or [1000 * (k + 1) for k in range(len(images))]

    def decoder(image: Grey) -> Callable[[], Grey]:
        return lambda: image

    return [
        Frame(t_ns=t, where=f"image {k}", decode=decoder(image))
        for k, (t, image) in enumerate(zip(times, images, strict=True))
    ]


def damaged(frame: Frame) -> Frame:
    def fail() -> Grey:
        raise RecordingError(f"{frame.where}: this is no image.")

    return replace(frame, decode=fail)


def camera(content: list[Frame], known: CameraInput = KNOWN) -> CameraImages:
    def stream(_: list[str]) -> Iterator[Frame]:
        return iter(content)

    return CameraImages(name="cam0", stream=ImageStream(frames=stream, count=len(content)), known=known)


def equal(first: BoardCorners, second: BoardCorners) -> bool:
    a, b = first.frames, second.frames
    names = ("t_ns", "frame", "point", "pixels", "sigma_px")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def test_every_frame_has_its_corners(views):
    found = detect_corners(camera(frames(views)), BOARD, workers=1)
    corners = found.frames
    np.testing.assert_array_equal(corners.t_ns, 1000 * np.arange(1, 21))
    np.testing.assert_array_equal(np.bincount(corners.frame), 36)
    np.testing.assert_array_equal(corners.point.reshape(20, 36), np.tile(np.arange(36), (20, 1)))
    x, y = (BOARD.points[corners.point] - BOARD.points.mean(axis=0))[:, :2].T
    k = corners.frame
    expected = np.stack([230 * (x + 0.002 * k) / 0.4 + 159.5, 230 * (-y - 0.001 * k) / 0.4 + 119.5], axis=1)
    assert np.abs(corners.pixels - expected).max() < 0.1
    assert corners.quality is not None
    assert np.nanmax(np.abs(corners.quality.white - 210)) < 8
    assert np.nanmax(np.abs(corners.quality.black - 30)) < 8
    assert not found.notes


def test_workers_change_nothing_and_order_next_to_nothing(views):
    images = frames(views)
    one = detect_corners(camera(images), BOARD, workers=1)
    assert equal(one, detect_corners(camera(images), BOARD, workers=3))
    sorted_again = detect_corners(camera([images[3], *images[:3], *images[4:]]), BOARD, workers=2)
    assert np.array_equal(one.frames.point, sorted_again.frames.point)
    assert np.abs(one.frames.pixels - sorted_again.frames.pixels).max() < 0.02
    assert sorted_again.notes == ("cam0: the timestamps go back at 1 of 20 images, which were sorted.",)


def test_progress_counts_the_images(views):
    said: list[str] = []
    detect_corners(camera(frames(views)), BOARD, workers=1, progress=said.append)
    assert said[0] == "finding the board in the images of cam0: 0 of 20"
    assert said[-1] == "finding the board in the images of cam0: 18 of 20"


def test_damaged_images_are_left_out_and_named(views):
    images = frames(views)
    images[5], images[9] = damaged(images[5]), damaged(images[9])
    found = detect_corners(camera(images), BOARD, workers=2)
    counts = np.bincount(found.frames.frame, minlength=20)
    assert len(found.frames.t_ns) == 20
    np.testing.assert_array_equal(np.flatnonzero(counts == 0), [5, 9])
    assert found.notes == (
        "cam0: 2 of 20 images cannot be read and were left out. The first: image 5: this is no image.",
    )


def test_nothing_but_damage_is_refused(views):
    with pytest.raises(RecordingError, match=r"cam0: none of the 3 images can be read. The first: image 0: this is no"):
        detect_corners(camera([damaged(frame) for frame in frames(views[:3])]), BOARD)


def test_no_images_are_refused():
    with pytest.raises(RecordingError, match="cam0: there are no images"):
        detect_corners(camera([]), BOARD)


def test_a_stamp_that_was_there_before_is_left_out(views):
    found = detect_corners(camera(frames(views[:4], [1000, 2000, 2000, 3000])), BOARD)
    np.testing.assert_array_equal(found.frames.t_ns, [1000, 2000, 3000])
    assert found.notes == ("cam0: left out 1 of 4 images, whose timestamps were there before.",)


def test_stamps_that_stand_still_are_refused(views):
    with pytest.raises(
        RecordingError, match=r"cam0: all 4 images have the same timestamp, 7 ns. Record them with the time"
    ):
        detect_corners(camera(frames(views[:4], [7] * 4)), BOARD)


def test_intrinsics_of_another_image_size_are_refused(views):
    known = CameraInput(camera=replace(CAMERA, resolution=(640, 480)))
    message = r"cam0: the images are of 320 x 240 px, but its intrinsics are for 640 x 480 px"
    with pytest.raises(RecordingError, match=message):
        detect_corners(camera(frames(views[:2]), known), BOARD)


def test_images_of_two_sizes_are_refused(views):
    with pytest.raises(RecordingError, match=r"the images are of 320 x 240 and 160 x 120 px"):
        detect_corners(camera(frames([views[0], np.ascontiguousarray(views[1][::2, ::2])])), BOARD)


def test_a_board_that_is_nowhere_is_named():
    blank = np.full((240, 320), 128, np.uint8)
    with pytest.raises(
        DetectionError, match=r"cam0: the board of the target file, AprilGrid 3 x 3.*in none of 2 images"
    ):
        detect_corners(camera(frames([blank, blank])), BOARD)


def test_markers_of_an_unknown_dictionary_are_refused():
    board = Target.charuco(cols=5, rows=7, square_size_m=0.03, marker_size_m=0.02, dictionary="4X4_51")
    with pytest.raises(OptionError, match="no dictionary '4X4_51'"):
        detect_corners(camera(frames([np.full((240, 320), 128, np.uint8)])), board)


def test_kept_corners_come_back_as_they_were(views, tmp_path):
    covariance = np.eye(4)
    known = replace(KNOWN, lens_covariance=covariance)
    found = detect_corners(camera(frames(views), known), BOARD)
    found = replace(found, notes=("something was said.",))
    file = cache_file(tmp_path / "new", (Source(name="a", sha256="1"),), "cam0", "", BOARD)
    assert kept_corners(file, known) is None
    keep_corners(file, found)
    kept = kept_corners(file, known)
    assert kept is not None
    assert equal(found, kept)
    assert kept.notes == found.notes
    assert kept.frames.lens_covariance is not None
    quality, before = kept.frames.quality, found.frames.quality
    assert quality is not None
    assert before is not None
    np.testing.assert_array_equal(quality.blur_px, before.blur_px)
    assert dict(quality.dropped) == dict(before.dropped)


def test_whatever_changes_the_corners_changes_the_name(tmp_path):
    a, b = (Source(name="x", sha256=text) for text in "ab")

    def name(source=a, camera="cam0", topic="", target=BOARD):
        return cache_file(tmp_path, (source,), camera, topic, target).name

    larger = Target.aprilgrid(tag_cols=3, tag_rows=4, tag_size_m=0.08, tag_spacing=0.3)
    assert name() == name(replace(a, name="y"))
    assert len({name(), name(b), name(camera="cam1"), name(topic="/x"), name(target=larger)}) == 5


def test_a_file_that_is_no_cache_is_passed_over(views, tmp_path):
    found = detect_corners(camera(frames(views[:2])), BOARD)
    file = cache_file(tmp_path, (), "cam0", "", BOARD)
    keep_corners(file, found)
    whole = file.read_bytes()
    for content in (b"", b"nonsense", whole[: len(whole) // 2]):
        file.write_bytes(content)
        assert kept_corners(file, KNOWN) is None
    file.write_bytes(whole)
    assert kept_corners(file, CameraInput(camera=replace(CAMERA, resolution=(640, 480)))) is None


def test_corners_of_other_images_are_not_kept_for_ever(views, tmp_path):
    found = detect_corners(camera(frames(views[:2])), BOARD)
    files = [cache_file(tmp_path, (Source(name="", sha256=text),), "cam0", "", BOARD) for text in "ab"]
    other = cache_file(tmp_path, (), "cam1", "", BOARD)
    foreign = tmp_path / "corners-cam0-mine.npz"
    foreign.write_text("not gnomon's")
    for file in (other, *files):
        keep_corners(file, found)
    assert sorted(tmp_path.iterdir()) == sorted([other, files[1], foreign])


def test_a_camera_clock_that_drifts_is_found_when_a_bag_is_read(views, monkeypatch, tmp_path):
    """Where the recorder's clock is known: the camera's clock is 500 ppm slow, the IMU's is right."""
    from gnomon.calibrate.steps import camera_imu_reading
    from gnomon.recording import ImuSamples, TriadSamples
    from gnomon.recording.recording import Arrivals, ImageRecording

    t_ns = np.arange(0, 60_000_000_000, 50_000_000)
    late = np.random.default_rng(0).exponential(1e6, len(t_ns)).astype(np.int64)
    slow = Arrivals(t_ns=t_ns, received_ns=np.rint(t_ns * 1.0005).astype(np.int64) + late)
    right = Arrivals(t_ns=t_ns, received_ns=t_ns + late)
    samples = TriadSamples(t_ns=t_ns, values=np.zeros((len(t_ns), 3)), unit="m/s^2")
    recording = ImageRecording(
        imus={"imu0": ImuSamples(accelerometer=samples, gyroscope=replace(samples, unit="rad/s"))},
        streams={"cam0": replace(camera(frames(views)).stream, arrivals=slow, camera=CAMERA)},
        imu_arrivals={"imu0": right},
    )
    monkeypatch.setattr(camera_imu_reading, "open_images", lambda *_, **__: recording)
    board = tmp_path / "target.yaml"
    board.write_text("target_type: aprilgrid\ntagCols: 3\ntagRows: 3\ntagSize: 0.08\ntagSpacing: 0.3\n")
    read, _ = camera_imu_reading.read_camera_imu(tmp_path, target=board)
    (finding,) = read.findings
    assert finding.code == "clock-drift"
    assert "+499 +- 0.86 ppm" in finding.message  # +500 by truth


@pytest.mark.parametrize(("stated", "said"), [(0.5, "0.5"), (0.25, "0.25")])
def test_another_gap_between_the_tags_is_named(views, stated, said):
    board = Target.aprilgrid(tag_cols=3, tag_rows=3, tag_size_m=0.08, tag_spacing=stated)
    message = (
        rf"cam0: in the images the gap between the tags is 0\.30 of the side of a tag, but .* tagSpacing: {said}\."
    )
    with pytest.raises(DetectionError, match=message):
        detect_corners(camera(frames(views)), board)


def test_another_number_of_columns_is_named(views):
    board = Target.aprilgrid(tag_cols=4, tag_rows=3, tag_size_m=0.08, tag_spacing=0.3)
    with pytest.raises(DetectionError, match=r"The stated board differs: .*columns"):
        detect_corners(camera(frames(views)), board)


def test_the_gap_is_measured_whatever_the_perspective():
    from gnomon.detect.boards.aprilgrid import detect_aprilgrid
    from gnomon.detect.boards.board import tag_spacing
    from rendered import rendered_views

    board = Target.aprilgrid(tag_cols=6, tag_rows=5, tag_size_m=0.08, tag_spacing=0.37)
    seen = [detect_aprilgrid(view.image, board) for view in rendered_views(board, 6, 3)]
    found = tag_spacing(seen, board)
    assert found is not None
    assert abs(found - 0.37) < 0.005
    assert tag_spacing(seen[:0], board) is None


def many(content: list[Frame]) -> CameraImages:
    """Return a camera that says it has so many images that processes are worth their start."""
    images = camera(content)
    return replace(images, stream=replace(images.stream, count=1000))


def test_processes_find_what_threads_find(views):
    images = frames(2 * views)
    images[3] = damaged(images[3])
    assert equal(detect_corners(camera(images), BOARD, workers=1), detect_corners(many(images), BOARD, workers=2))


def test_work_of_a_process_that_is_lost_is_done_here(views, monkeypatch):
    from gnomon.detect.boards import worker

    lost: list[worker.BoardProcess] = []
    look = worker.BoardProcess.views

    def killed(self: worker.BoardProcess, images: list[Grey], *, follows: bool):
        if follows:  # in the middle of a run
            lost.append(self)
            self.close()
        return look(self, images, follows=follows)

    monkeypatch.setattr(worker.BoardProcess, "views", killed)
    images = frames(3 * views)
    found = detect_corners(many(images), BOARD, workers=3)
    assert len(lost) == 2
    assert equal(found, detect_corners(camera(images), BOARD, workers=1))


def test_without_processes_threads_do(views, monkeypatch):
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    found = detect_corners(many(frames(views)), BOARD, workers=2)
    assert equal(found, detect_corners(camera(frames(views)), BOARD, workers=1))
