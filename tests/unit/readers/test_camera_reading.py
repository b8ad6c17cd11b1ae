"""Views of a board for a calibration of cameras alone: read from images and tables, without a lens or an IMU."""

import cv2
import numpy as np
import pytest

import gnomon
from bag_maker import make_bag, usual
from gnomon.errors import DetectionError, OptionError, RecordingError
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.readers.images.image_recording import open_images
from image_folders import START, stamps, write_images, write_samples
from rendered import Ranges, rendered_views

BOARD = Target.aprilgrid(tag_cols=4, tag_rows=3, tag_size_m=0.05, tag_spacing=0.3)
TARGET = "target_type: aprilgrid\ntagCols: 4\ntagRows: 3\ntagSize: 0.05\ntagSpacing: 0.3\n"
CHESS = "target_type: checkerboard\ntargetCols: 7\ntargetRows: 6\nrowSpacingMeters: 0.05\ncolSpacingMeters: 0.05\n"
CORNERS = "ts_ns,corner_id,u_px,v_px\n"
EASY = Ranges(tag_px=(40.0, 60.0), blur_px=(0.4, 0.6), motion_px=(0.0, 0.1), clutter=False, covers=0, tilt_deg=(0, 30))


@pytest.fixture(scope="module")
def views():
    return [view.image for view in rendered_views(BOARD, 3, 5, ranges=EASY)]


def target(folder, text=TARGET):
    path = folder / "target.yaml"
    path.write_text(text)
    return path


def write(folder, names, images):
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in zip(names, images, strict=True):
        assert cv2.imwrite(str(folder / f"{name}.png"), image)


def corner_table(path, pixels=((10.0, 20.0), (300.0, 200.0))):
    rows = [f"{START},{i},{u},{v}" for i, (u, v) in enumerate(pixels)]
    path.write_text(CORNERS + "\n".join(rows) + "\n")


def test_plain_folder_of_photographs(tmp_path, views):
    write(tmp_path / "photos", ["b", "c", "a"], views)
    recording, board = gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path))
    frames = recording.cameras["cam0"]
    assert recording.imus == {}
    assert board.describe() == BOARD.describe()
    assert frames.camera.resolution == (752, 480)
    assert np.array_equal(frames.camera.parameters, Camera.nominal((752, 480)).parameters)
    assert frames.t_ns.tolist() == [0, 10**9, 2 * 10**9]  # in the order of their names
    assert len(frames.frame) > 60
    assert any("numbered in the order of their names" in note for note in recording.assumptions)


def test_pairs_belong_together_by_their_numbers(tmp_path, views):
    """As OpenCV's sample has them: one of the pairs is missing on one side."""
    write(tmp_path / "pairs", ["left01", "left02", "left04"], views)
    write(tmp_path / "pairs", ["right02", "right04"], views[1:])
    recording, _ = gnomon.read_camera_views(tmp_path / "pairs", target=target(tmp_path))
    seen = {name: (frames.t_ns // 10**9).tolist() for name, frames in recording.cameras.items()}
    assert seen == {"cam0": [1, 2, 4], "cam1": [2, 4]}


@pytest.mark.parametrize(("first", "second"), [("left", "right"), ("cam0", "cam1")])
def test_folders_of_a_stereo_camera(tmp_path, first, second):
    for name in (first, second):
        write_images(tmp_path / name, stamps(3))
    opened = open_images(tmp_path, cameras_alone=True)
    assert {name: [frame.t_ns for frame in stream.frames([])] for name, stream in opened.streams.items()} == {
        "cam0": stamps(3),
        "cam1": stamps(3),
    }


def test_order_alone_does_not_pair_folders_of_different_length(tmp_path):
    write_images(tmp_path / "left", ["a", "b", "c"])
    write_images(tmp_path / "right", ["a", "c"])
    with pytest.raises(RecordingError, match=r"3 images in left/ and 2 images in right/, and their names hold no num"):
        open_images(tmp_path, cameras_alone=True)


def test_an_imu_is_passed_over_even_if_it_is_damaged(tmp_path):
    write_images(tmp_path / "mav0" / "cam0" / "data", stamps(3))
    write_samples(tmp_path / "mav0" / "imu0" / "data.csv")
    table = tmp_path / "mav0" / "imu0" / "data.csv"
    table.write_text(table.read_text().replace(",", ";;", 7))
    opened = open_images(tmp_path, cameras_alone=True)
    assert opened.imus == {}
    assert not any("imu" in source.name for source in opened.sources)


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_imus_in_a_bag_are_passed_over(tmp_path, form):
    """Also two of them, of which the reader could not tell which one is meant, and one with a stated topic."""
    bag = make_bag(tmp_path, form, usual(imus=("/imu_a", "/imu_b")))
    opened = open_images(bag, cameras_alone=True, topics={"imu0": "/nowhere"})
    assert opened.imus == {}
    assert opened.imu_arrivals == {}
    assert {name: stream.topic for name, stream in opened.streams.items()} == {"cam0": "/cam0/image_raw"}
    assert len(list(opened.streams["cam0"].frames([]))) == 3


def test_mixed_sizes_are_named(tmp_path, views):
    write(tmp_path / "photos", ["1", "2", "3"], [views[0], views[1], views[2][:400]])
    with pytest.raises(RecordingError, match=r"1\.png of 752 x 480 px and .*3\.png of 752 x 400 px"):
        gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path))


def test_a_stated_size_is_held_against_the_images(tmp_path, views):
    write(tmp_path / "photos", ["1", "2", "3"], views)
    with pytest.raises(RecordingError, match=r"640 x 480 px stated and .*1\.png of 752 x 480 px"):
        gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path), resolution=(640, 480))


def test_no_image_can_be_read(tmp_path):
    (tmp_path / "photos").mkdir()
    for name in "12":
        (tmp_path / "photos" / f"{name}.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    with pytest.raises(RecordingError, match="none of the 2 images can be read"):
        gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path))


def test_board_that_is_not_there(tmp_path):
    write_images(tmp_path / "photos", ["1", "2"])
    with pytest.raises(DetectionError, match="is in none of 2 images"):
        gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path))


def test_numbering_of_a_checkerboard_does_not_follow_a_stated_lens(tmp_path):
    """The corners are the same whatever lens stands in the file: it is not used."""
    board = Target.checkerboard(cols=7, rows=6, row_spacing_m=0.05, col_spacing_m=0.05)
    seen = [view.image for view in rendered_views(board, 3, 3, ranges=EASY)]
    write(tmp_path / "photos", ["1", "2", "3"], seen)
    chain = tmp_path / "camchain.yaml"
    chain.write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [90, 2000, 10, 470]\n  distortion_model: none\n"
        "  resolution: [752, 480]\n  rostopic: /a\n  line_delay: 2.0e-05\n"
    )
    plain, _ = gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path, CHESS))
    stated, _ = gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path, CHESS), cam=chain)
    one, other = plain.cameras["cam0"], stated.cameras["cam0"]
    assert len(one.point) >= 42
    assert np.array_equal(one.point, other.point)
    assert np.array_equal(one.pixels, other.pixels)
    assert (other.camera.topic, other.camera.line_delay_s) == ("/a", 2e-5)


def test_kept_corners_are_used_again(tmp_path, views):
    write(tmp_path / "photos", ["1", "2", "3"], views)
    cache = tmp_path / "kept"
    first, _ = gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path), cache=cache)
    again, _ = gnomon.read_camera_views(tmp_path / "photos", target=target(tmp_path), cache=cache)
    assert np.array_equal(first.cameras["cam0"].pixels, again.cameras["cam0"].pixels)
    assert any("an earlier run found" in note for note in again.assumptions)


# ---- tables of corners ----


def test_corner_tables_need_the_size_of_the_images(tmp_path):
    corner_table(tmp_path / "cam0_corners.csv")
    with pytest.raises(OptionError, match=r"how large the images of cam0 are\. Give --resolution WIDTH HEIGHT"):
        gnomon.read_camera_views(tmp_path, target=target(tmp_path))
    recording, _ = gnomon.read_camera_views(tmp_path, target=target(tmp_path), resolution=(640, 480))
    assert recording.cameras["cam0"].camera.resolution == (640, 480)
    assert len(recording.cameras["cam0"].frame) == 2


def test_size_by_an_image_or_a_camchain_beside(tmp_path):
    corner_table(tmp_path / "cam0_corners.csv")
    corner_table(tmp_path / "cam1_corners.csv")
    write_images(tmp_path, [f"cam0_{START}"], change=lambda _: np.zeros((400, 700), np.uint8))
    with pytest.raises(OptionError, match="of cam1 are"):
        gnomon.read_camera_views(tmp_path, target=target(tmp_path))
    (tmp_path / "camchain.yaml").write_text(
        "cam1:\n  camera_model: pinhole\n  intrinsics: [90, 90, 10, 40]\n  distortion_model: none\n"
        "  resolution: [640, 480]\n"
    )
    recording, _ = gnomon.read_camera_views(tmp_path, target=target(tmp_path))
    sizes = {name: frames.camera.resolution for name, frames in recording.cameras.items()}
    assert sizes == {"cam0": (700, 400), "cam1": (640, 480)}
    assert recording.cameras["cam1"].camera.intrinsics[0] != 90  # the lens itself is not taken


def test_two_sizes_that_contradict_each_other(tmp_path):
    corner_table(tmp_path / "cam0_corners.csv")
    chain = tmp_path / "lens.yaml"
    chain.write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [90, 90, 10, 40]\n  distortion_model: none\n"
        "  resolution: [640, 480]\n"
    )
    with pytest.raises(OptionError, match=r"--resolution 752 480, but lens\.yaml says 640 x 480 px of cam0"):
        gnomon.read_camera_views(tmp_path, target=target(tmp_path), cam=chain, resolution=(752, 480))


def test_euroc(real_data, tmp_path):
    """The resolution comes from the images beside the tables."""
    target(tmp_path, "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n")
    recording, board = gnomon.read_camera_views(real_data("euroc-cam-april"), target=tmp_path / "target.yaml")
    assert {name: len(frames.frame) for name, frames in recording.cameras.items()} == {"cam0": 3728, "cam1": 4064}
    assert {frames.camera.resolution for frames in recording.cameras.values()} == {(752, 480)}
    assert np.array_equal(recording.cameras["cam0"].t_ns, recording.cameras["cam1"].t_ns)
    assert len(board) == 144
