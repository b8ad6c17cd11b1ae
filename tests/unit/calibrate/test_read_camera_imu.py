"""Reading recordings of cameras and IMUs: both layouts of corners, what is fixed with a note, and what is refused."""

import gzip
import hashlib
import re
import shutil
import time

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gnomon
from gnomon.assess.checks.rig_streams import check_cameras
from gnomon.errors import FormatError, GnomonError, OptionError, RecordingError
from gnomon.readers.samples.recognise import gyroscope_unit

CAM = {
    "camera_model": "pinhole",
    "intrinsics": [460, 458.5, 322.4, 237.1],
    "distortion_model": "radtan",
    "distortion_coeffs": [-0.28, 0.075, 0.0002, -0.00015],
    "resolution": [640, 480],
    "rostopic": "/cam0",
}
IMU = {
    "accelerometer_noise_density": 0.0039,
    "accelerometer_random_walk": 0.0012,
    "gyroscope_noise_density": 8.73e-5,
    "gyroscope_random_walk": 2e-5,
    "update_rate": 200.0,
    "rostopic": "/imu0",
}
APRIL = {"target_type": "aprilgrid", "tagCols": 3, "tagRows": 2, "tagSize": 0.088, "tagSpacing": 0.3}
CHECKERS = {
    "target_type": "checkerboard",
    "targetCols": 5,
    "targetRows": 4,
    "rowSpacingMeters": 0.1,
    "colSpacingMeters": 0.1,
}
START = 1_600_000_000_092_999_937  # the nearest float64 is 1_600_000_000_092_999_936
TAG_CORNERS = [(tag, corner) for tag in range(6) for corner in range(4)]
TAG_POINTS = [0, 1, 7, 6, 2, 3, 9, 8, 4, 5, 11, 10, 12, 13, 19, 18, 14, 15, 21, 20, 16, 17, 23, 22]
"""Number on the 3 x 2 board of each of TAG_CORNERS, counted by hand."""


def stamps(frames: int = 4, step_ns: int = 50_000_000):
    return START + step_ns * np.arange(frames)


def pixel(frame: int, number: int) -> tuple[float, float]:
    return 100.0 + 3 * number + 0.25 * frame, 50.0 + 7 * number + 0.5 * frame


def tag_rows(frames: int = 4) -> list[list[object]]:
    """Return rows of time, tag, corner of the tag, u, v."""
    return [
        [t, *ids, *pixel(f, TAG_POINTS[k])] for f, t in enumerate(stamps(frames)) for k, ids in enumerate(TAG_CORNERS)
    ]


def point_rows(frames: int = 4, points: int = 24) -> list[list[object]]:
    """Return rows of time, number of the corner on the target, u, v."""
    return [[t, k, *pixel(f, k)] for f, t in enumerate(stamps(frames)) for k in range(points)]


def imu_rows(samples: int = 400, step_ns: int = 5_000_000) -> list[list[object]]:
    """Return rows of time, gyroscope [rad/s], accelerometer [m/s^2] of a sensor that is waved."""
    t = np.arange(samples) * step_ns * 1e-9
    rate = np.stack([np.sin(7 * t), 1.2 * np.cos(5 * t), 0.8 * np.sin(4 * t + 1)], axis=1)
    force = np.stack([2 * np.sin(3 * t), 1.5 * np.cos(6 * t), 9.6 + np.sin(5 * t)], axis=1)
    return [[START + k * step_ns, *rate[k], *force[k]] for k in range(samples)]


def text(rows, header: str = "") -> str:
    lines = [",".join(str(x) for x in row) for row in rows]
    return "\n".join([header, *lines] if header else lines) + "\n"


TAG_HEADER, POINT_HEADER, IMU_HEADER = (
    "ts_ns,tag_id,corner_idx,u_px,v_px",
    "ts_ns,corner_id,u_px,v_px",
    "ts_ns,wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]",
)


@pytest.fixture
def folder(tmp_path):
    """Return a recording of one camera and one IMU, with Kalibr's files in it."""
    for name, content in (("camchain", {"cam0": CAM}), ("imu", IMU), ("target", APRIL)):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(content))
    (tmp_path / "cam0_corners.csv").write_text(text(point_rows(), POINT_HEADER))
    (tmp_path / "imu0.csv").write_text(text(imu_rows(), IMU_HEADER))
    return tmp_path


def read(path, **options):
    files = {"cam": path / "camchain.yaml", "imu": path / "imu.yaml", "target": path / "target.yaml"}
    return gnomon.read_camera_imu(path, **{**files, **options})


def corners(path, **options):
    return read(path, **options)[0].cameras["cam0"]


def said(path, **options) -> str:
    return "\n".join(read(path, **options)[0].assumptions)


def assert_same_corners(frames, count: int = 4) -> None:
    assert frames.t_ns.tolist() == stamps(count).tolist()
    assert frames.frame.tolist() == np.repeat(np.arange(count), 24).tolist()
    assert frames.point.tolist() == np.tile(np.arange(24), count).tolist()
    assert frames.pixels.tolist() == [list(pixel(f, k)) for f in range(count) for k in range(24)]


# ---- what is read ----


def test_everything_in_its_place(folder) -> None:
    recording, target = read(folder)
    assert_same_corners(recording.cameras["cam0"])
    assert target.kind == "aprilgrid"
    imu = recording.imus["imu0"]
    assert (imu.topic, imu.noise.gyroscope_noise_density) == ("/imu0", 8.73e-5)
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    assert imu.gyroscope.t_ns[0] == START
    assert imu.accelerometer.values.tolist() == [row[4:] for row in imu_rows()]
    assert recording.cameras["cam0"].T_cam_imu is None
    assert recording.cameras["cam0"].camera.topic == "/cam0"
    names = ["camchain.yaml", "imu.yaml", "target.yaml", "imu0.csv", "cam0_corners.csv"]
    assert [source.name for source in recording.sources] == names
    for source in recording.sources:
        assert source.sha256 == hashlib.sha256((folder / source.name).read_bytes()).hexdigest()


def test_both_layouts_give_the_same(folder) -> None:
    (folder / "cam0_corners.csv").write_text(text(tag_rows(), TAG_HEADER))
    # Within a frame the tags come in another order than the points.
    assert_same_corners(corners(folder))


@pytest.mark.parametrize(
    "header",
    [
        "#timestamp [ns],tag_id,corner_id,u [px],v [px]",
        "# ts_ns, tag, corner, x, y",
        "timestamp_ns,tagId,cornerIdx,px,py",
        "stamp_ns,april_id,corner_index,corner_x,corner_y",
    ],
)
def test_other_names_of_the_columns(folder, header) -> None:
    (folder / "cam0_corners.csv").write_text(text(tag_rows(), header))
    assert_same_corners(corners(folder))


@pytest.mark.parametrize("header", ["t_ns;id;u;v", "ts_ns;point_id;pixel_x;pixel_y", "ts_ns;corner;x;y"])
def test_other_names_and_another_delimiter(folder, header) -> None:
    body = text(point_rows(), header).replace(",", ";")
    (folder / "cam0_corners.csv").write_text("# corners of cam0\n" + body)
    assert_same_corners(corners(folder))


def test_other_columns_are_passed_over(folder) -> None:
    rows = [[9, *row[:3], 0.1, 0.2, *row[3:], 0.3] for row in tag_rows()]
    header = "frame_id,ts_ns,tag_id,corner_idx,x_m,y_m,u_px,v_px,sigma_px"
    (folder / "cam0_corners.csv").write_text(text(rows, header))
    assert_same_corners(corners(folder))


@pytest.mark.parametrize("rows", [point_rows(), tag_rows()], ids=["points", "tags"])
def test_no_header(folder, rows) -> None:
    (folder / "cam0_corners.csv").write_text(text(rows))
    assert_same_corners(corners(folder))
    assert "cam0_corners.csv: no header; the columns were taken for time," in said(folder)
    assert "cam0_corners.csv: time in ns (they count from 1970 and the rate is then 20 Hz)." in said(folder)


@pytest.mark.parametrize(
    "rows",
    [
        [[*row[:2], int(row[2]), int(row[3])] for row in point_rows()],  # coordinates could be numbers of something
        [[row[0], row[2], row[1], *row[3:]] for row in tag_rows()],  # corner before tag
        [[*row, 1] for row in tag_rows()],
        [[row[1], row[0], *row[2:]] for row in point_rows()],
    ],
)
def test_no_header_and_not_clear(folder, rows) -> None:
    (folder / "cam0_corners.csv").write_text(text(rows))
    with pytest.raises(RecordingError, match=r"cam0_corners\.csv: no header, .* Add a first line, \"ts_ns,tag_id"):
        read(folder)


@pytest.mark.parametrize(
    ("header", "stamp", "exact"),
    [
        ("t [s],corner_id,u,v", lambda t: f"{t // 10**9}.{t % 10**9:09d}", True),
        ("timestamp_us,corner_id,u,v", lambda t: f"{t // 1000}", False),
        ("sec,nsec,corner_id,u,v", lambda t: f"{t // 10**9},{t % 10**9}", True),
    ],
)
def test_stamps_in_other_units(folder, header, stamp, exact) -> None:
    rows = [[stamp(int(row[0])), *row[1:]] for row in point_rows()]
    (folder / "cam0_corners.csv").write_text(text(rows, header))
    assert np.abs(corners(folder).t_ns - stamps()).max() <= (0 if exact else 999)


def test_packed_files(folder) -> None:
    for name in ("cam0_corners.csv", "imu0.csv"):
        (folder / f"{name}.gz").write_bytes(gzip.compress((folder / name).read_bytes()))
        (folder / name).unlink()
    assert_same_corners(corners(folder))


def test_unpacked_file_comes_first(folder) -> None:
    (folder / "cam0_corners.csv.gz").write_bytes(gzip.compress(text(point_rows(2), POINT_HEADER).encode()))
    assert_same_corners(corners(folder))


def test_layout_of_euroc(folder) -> None:
    (folder / "mav0" / "cam0").mkdir(parents=True)
    (folder / "mav0" / "imu0").mkdir()
    shutil.move(folder / "cam0_corners.csv", folder / "mav0" / "cam0" / "corners.csv")
    shutil.move(folder / "imu0.csv", folder / "mav0" / "imu0" / "data.csv")
    assert_same_corners(corners(folder))


def test_frames_without_corners(folder) -> None:
    listed = sorted([*stamps().tolist(), START + 1, START + 120_000_000])
    (folder / "cam0_frames.csv").write_text(text([[t, 0] for t in listed], "ts_ns,n_corners"))
    frames = corners(folder)
    assert frames.t_ns.tolist() == listed
    assert frames.t_ns[frames.frame].tolist() == np.repeat(stamps(), 24).tolist()
    assert read(folder)[0].sources[-1].name == "cam0_frames.csv"
    (folder / "cam0_frames.csv").write_text("".join(f"{t}\n" for t in stamps()[:3]))
    assert "1 of 4 frames are missing in the list of all frames; they were added" in said(folder)
    assert_same_corners(corners(folder))


def test_several_cameras_and_imus(folder) -> None:
    (folder / "camchain.yaml").write_text(yaml.safe_dump({"cam0": CAM, "cam1": {**CAM, "timeshift_cam_imu": 0.01}}))
    (folder / "imu.yaml").write_text(yaml.safe_dump({"imu0": IMU}))
    (folder / "cam1_corners.csv").write_text(text(tag_rows(), TAG_HEADER))
    (folder / "imu1.csv").write_text(text(imu_rows(), IMU_HEADER))
    recording, _ = read(folder)
    assert list(recording.cameras) == ["cam0", "cam1"]
    assert recording.cameras["cam1"].time_shift_cam_imu_s == 0.01
    assert [imu.noise is None for imu in recording.imus.values()] == [False, True]
    assert "imu1: accelerometer in m/s^2, gyroscope in rad/s (as the file says)." in recording.assumptions


def test_without_imu_file(folder) -> None:
    assert read(folder, imu=None)[0].imus["imu0"].noise is None


# ---- timestamps ----


@settings(max_examples=25)
@given(
    st.integers(0, 2**62),
    st.lists(st.integers(0, 40_000_000_000_000), min_size=2, max_size=20, unique=True),
    st.randoms(),
)
def test_stamps_survive_to_the_nanosecond(tmp_path_factory, origin, offsets, shuffle) -> None:
    times = [origin + offset for offset in offsets]
    path = tmp_path_factory.mktemp("recording")
    for name, content in (("camchain", {"cam0": CAM}), ("imu", IMU), ("target", APRIL)):
        (path / f"{name}.yaml").write_text(yaml.safe_dump(content))
    rows = [[t, k, 10.5 + k, 20 + i] for i, t in enumerate(times) for k in (0, 5)]
    shuffle.shuffle(rows)
    (path / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    (path / "imu0.csv").write_text(text(imu_rows(20), IMU_HEADER))
    frames = corners(path)
    assert frames.t_ns.tolist() == sorted(times)
    found = zip(frames.t_ns[frames.frame].tolist(), frames.point.tolist(), frames.pixels[:, 1].tolist(), strict=True)
    assert list(found) == sorted((t, k, 20.0 + i) for i, t in enumerate(times) for k in (0, 5))


def test_unsorted_rows_are_sorted_with_a_note(folder) -> None:
    rows = point_rows()
    (folder / "cam0_corners.csv").write_text(text(rows[48:] + rows[:48], POINT_HEADER))
    assert_same_corners(corners(folder))
    assert "cam0_corners.csv: the rows are not in the order of time; they were sorted." in said(folder)


def test_corner_twice_in_a_frame(folder) -> None:
    rows = point_rows()
    rows.insert(30, [*rows[25][:2], 600.0, 400.0])
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    assert_same_corners(corners(folder))
    assert "cam0_corners.csv: left out 1 of 97 corners (the same corner is in the frame already)." in said(folder)


def test_stamps_too_coarse_to_tell_frames_apart(folder) -> None:
    rows = [[int(row[0]) // 10**9, row[1], float(row[2]) + 9 * (i // 24), row[3]] for i, row in enumerate(point_rows())]
    (folder / "cam0_corners.csv").write_text(text(rows, "t [s],corner_id,u,v"))
    with pytest.raises(RecordingError, match=r"several times at one timestamp, at different places \(72 of 96 rows\)"):
        read(folder)


def test_imu_out_of_order_is_sorted_with_a_note(folder) -> None:
    rows = imu_rows()
    rows[100], rows[101] = rows[101], rows[100]
    (folder / "imu0.csv").write_text(text(rows, IMU_HEADER))
    imu = read(folder)[0].imus["imu0"]
    for triad, columns in ((imu.gyroscope, slice(1, 4)), (imu.accelerometer, slice(4, 7))):
        assert triad.t_ns.tolist() == [row[0] for row in imu_rows()]
        assert triad.values.tolist() == [row[columns] for row in imu_rows()]
    assert said(folder).count("imu0: the timestamps go back at 1 of 400 samples, which were sorted.") == 1


def test_packets_of_samples_stay_whole(folder) -> None:
    """Samples that came together over a wire share a timestamp; their clock is found from their number later."""
    rows = [[imu_rows()[k - k % 4 + 3][0], *row[1:]] for k, row in enumerate(imu_rows())]
    (folder / "imu0.csv").write_text(text(rows, IMU_HEADER))
    assert read(folder)[0].imus["imu0"].gyroscope.values.tolist() == [row[1:4] for row in imu_rows()]
    assert "go back" not in said(folder)


def test_imu_in_blocks_is_sorted_and_a_clock_set_anew_is_not(folder) -> None:
    rows = imu_rows()
    (folder / "imu0.csv").write_text(text(rows[200:] + rows[:200], IMU_HEADER))
    assert read(folder)[0].imus["imu0"].gyroscope.t_ns.tolist() == [row[0] for row in rows]
    later = [[row[0] if k < 200 else row[0] - 700_000_001, *row[1:]] for k, row in enumerate(rows)]
    (folder / "imu0.csv").write_text(text(later, IMU_HEADER))
    with pytest.raises(RecordingError, match=r"imu0: the timestamps jump back by 0\.695 s after sample 199"):
        read(folder)


def test_stamp_that_strayed_is_refused(folder) -> None:
    with_row(folder, 30, [0, 6, 5.0, 4.0])
    with pytest.raises(
        RecordingError, match=r"cam0_corners\.csv, line 32: the timestamp 0 ns is more than half a day from"
    ):
        read(folder)
    with_row(folder, 30, point_rows()[30])
    (folder / "cam0_frames.csv").write_text(text([[t, 24] for t in [*stamps(), 7]], "ts_ns,n_corners"))
    with pytest.raises(RecordingError, match=r"cam0_frames\.csv, line 6: the timestamp 7 ns"):
        read(folder)
    (folder / "cam0_frames.csv").unlink()
    rows = imu_rows()
    rows[50][0] = -5
    (folder / "imu0.csv").write_text(text(rows, IMU_HEADER))
    with pytest.raises(RecordingError, match=r"imu0: the timestamp of sample 50, -5 ns, is more than half a day"):
        read(folder)


@pytest.mark.parametrize("late", [False, True])
def test_stamp_that_is_no_number(folder, late) -> None:
    """The kind of the timestamps is known from the first hundred lines; later ones are another case."""
    for name, rows, header in (
        ("cam0_corners.csv", point_rows(10), POINT_HEADER),
        ("imu0.csv", imu_rows(), IMU_HEADER),
    ):
        whole, row = (folder / name).read_text(), 150 if late else 30
        rows[row][0] = "16000x"
        (folder / name).write_text(text(rows, header))
        place = (
            f'timestamp {row + 1} is "16000x", which is no number'
            if late
            else f"line {row + 2}, column 1 (ts_ns): found"
        )
        with pytest.raises(RecordingError, match=re.escape(place)) as caught:
            read(folder)
        assert str(caught.value).startswith(name)
        (folder / name).write_text(whole)


# ---- corners that are left out or refused ----


def with_row(folder, index: int, row) -> None:
    rows = point_rows()
    rows[index] = row
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))


@pytest.mark.parametrize("u", ["nan", "inf", "-inf", "NaN"])
def test_lost_corners_are_left_out(folder, u) -> None:
    with_row(folder, 30, [START + 50_000_000, 6, u, 4.0])
    frames = corners(folder)
    assert len(frames.frame) == 95
    assert frames.point[24:47].tolist() == [k for k in range(24) if k != 6]
    assert "cam0_corners.csv: left out 1 of 96 corners (NaN or infinity instead of pixels)." in said(folder)


def test_frame_with_nothing_but_nan_is_a_frame_without_corners(folder) -> None:
    rows = [[*row[:2], "nan", "nan"] if 24 <= i < 48 else row for i, row in enumerate(point_rows())]
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    frames = corners(folder)
    assert frames.t_ns.tolist() == stamps().tolist()
    assert set(frames.frame.tolist()) == {0, 2, 3}


def test_mostly_nan_is_refused(folder) -> None:
    rows = [[*row[:2], "nan", "nan"] if i > 40 else row for i, row in enumerate(point_rows())]
    (folder / "cam0_corners.csv").write_text("# first\n\n" + text(rows, POINT_HEADER))
    with pytest.raises(RecordingError, match=r"line 45: NaN or infinity instead of pixels, as in 55 of 96 rows"):
        read(folder)


@pytest.mark.parametrize("number", [24, -1, 99999])
def test_corners_that_are_not_on_the_target(folder, number) -> None:
    with_row(folder, 30, [START + 50_000_000, number, 5.0, 4.0])
    expected = (
        rf"cam0_corners\.csv, line 32: corner {number} is not on the target \(AprilGrid 3 x 2, .*which holds corners 0 "
        r"to 23\. 1 of 96 rows name such corners.*target\.yaml"
    )
    with pytest.raises(RecordingError, match=expected):
        read(folder)


@pytest.mark.parametrize(("tag", "corner"), [(6, 0), (0, 4), (-1, 0), (2, -1)])
def test_tags_that_are_not_on_the_target(folder, tag, corner) -> None:
    rows = [[row[0], tag, corner, *row[3:]] if i >= 90 else row for i, row in enumerate(tag_rows())]
    (folder / "cam0_corners.csv").write_text(text(rows, TAG_HEADER))
    expected = (
        rf"line 92: corner {corner} of tag {tag} is not on the target .* tags 0 to 5 with corners 0 to 3\. 6 of 96"
    )
    with pytest.raises(RecordingError, match=expected):
        read(folder)


def test_tags_on_a_checkerboard(folder) -> None:
    (folder / "cam0_corners.csv").write_text(text(tag_rows(), TAG_HEADER))
    (folder / "target.yaml").write_text(yaml.safe_dump(CHECKERS))
    with pytest.raises(RecordingError, match="these are the corners of tags, but the target is a checkerboard"):
        read(folder)


def test_corner_numbers_must_be_whole(folder) -> None:
    rows = [[row[0], f"{row[1]}.0", *row[2:]] for row in point_rows()]
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    assert_same_corners(corners(folder))
    rows[5][1] = "5.5"
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    with pytest.raises(RecordingError, match=r"line 7: found 5\.5 as the number of a tag or corner, expected a whole"):
        read(folder)


@pytest.mark.parametrize(
    ("u", "v", "inside"),
    [
        (-0.5, -0.5, True),
        (640.4, 480.4, True),
        (-1.6, 5, False),
        (640.6, 5, False),
        (5, -1.6, False),
        (5, 480.6, False),
    ],
)
def test_corners_at_the_border(folder, u, v, inside) -> None:
    with_row(folder, 30, [START + 50_000_000, 6, u, v])
    assert len(corners(folder).frame) == 95 + inside
    note = "cam0_corners.csv: left out 1 of 96 corners (outside the image of 640 x 480 px)."
    assert (note in said(folder)) == (not inside)


def test_image_of_another_size_is_refused(folder) -> None:
    (folder / "camchain.yaml").write_text(yaml.safe_dump({"cam0": {**CAM, "resolution": [120, 90]}}))
    with pytest.raises(
        RecordingError, match=r"of 96 corners lie outside the image of 120 x 90 px; u runs from 100 to 170"
    ):
        read(folder)


def test_normalised_coordinates_are_refused(folder) -> None:
    rows = [[*row[:2], row[2] / 640, row[3] / 480] for row in point_rows()]
    (folder / "cam0_corners.csv").write_text(text(rows, POINT_HEADER))
    with pytest.raises(RecordingError, match=r"all coordinates lie between .* these seem to be normalised"):
        read(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"cam0_corners\.csv: the file is empty"),
        (POINT_HEADER + "\n", r"no table of numbers found .* Expected rows such as: time, number of the tag"),
        (text(point_rows(), "ts_ns,tag_id,u,v"), r"does not tell .* \(ts_ns, tag_id, u, v\)\. Expected \"ts_ns,tag"),
        (text(point_rows(), "a,corner_id,u,v"), r"the header does not tell which columns are time, corner, u and v"),
        (text(tag_rows(), "ts_ns,corner_id,corner_idx,u,v"), r"the header does not tell"),
        (text(point_rows(), POINT_HEADER).replace(",50.0\n", ",\n"), r"line 2, column 4 \(v_px\): found nothing"),
        (text(point_rows(), POINT_HEADER).replace(",50.0\n", ",x\n"), r'line 2, column 4 \(v_px\): found "x"'),
        (text(point_rows(), POINT_HEADER) + "1,2\n", r"line 98: found 2 columns, expected 4"),
        ("\x00\x01binary", r"binary file"),
    ],
)
def test_damaged_tables(folder, content, message) -> None:
    (folder / "cam0_corners.csv").write_text(content)
    with pytest.raises(RecordingError, match=message):
        read(folder)


# ---- samples ----


def test_units_are_converted_and_said(folder) -> None:
    rows = [[row[0], *np.degrees(row[1:4]), *(np.array(row[4:]) / 9.80665)] for row in imu_rows()]
    for header in ("t_ns,gx,gy,gz,ax,ay,az", "t_ns,gx [deg/s],gy [deg/s],gz [deg/s],ax [g],ay [g],az [g]"):
        (folder / "imu0.csv").write_text(text(rows, header))
        imu = read(folder)[0].imus["imu0"]
        assert np.abs(imu.accelerometer.values - [row[4:] for row in imu_rows()]).max() < 1e-12
        assert np.abs(imu.gyroscope.values - [row[1:4] for row in imu_rows()]).max() < 1e-12
        assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
        assert "imu0.csv: the gyroscope was converted from deg/s to rad/s." in said(folder)
        assert "imu0.csv: the accelerometer was converted from g to m/s^2." in said(folder)
    (folder / "imu0.csv").write_text(text(rows, "t_ns,gx,gy,gz,ax,ay,az"))
    stated = read(folder, units="si")[0].imus["imu0"]
    assert stated.accelerometer.values.tolist() == [row[4:] for row in rows]
    with pytest.raises(OptionError, match="furlong"):
        read(folder, units="furlong")


@pytest.mark.parametrize("amplitude", [0.2, 1.0, 6.0])
@pytest.mark.parametrize(("unit", "per_rad_s"), [("rad/s", 1.0), ("deg/s", 180 / np.pi), ("mdeg/s", 180e3 / np.pi)])
def test_unit_of_a_gyroscope_that_never_rests(amplitude, unit, per_rad_s) -> None:
    t = np.arange(4000) / 200
    rate = amplitude * np.stack([np.sin(60 * t), np.cos(47 * t), np.sin(31 * t + 1)], axis=1)  # no smooth rest between
    found = gyroscope_unit(rate * per_rad_s, np.rint(t * 1e9).astype(np.int64), None, in_motion=True)
    assert found.unit == unit


def test_raw_counts_are_refused(folder) -> None:
    rows = [[row[0], *(round(1000 * x) for x in row[1:])] for row in imu_rows()]
    (folder / "imu0.csv").write_text(text(rows, "t_ns,gx,gy,gz,ax,ay,az"))
    with pytest.raises(RecordingError, match=r"imu0\.csv: the accelerometer is in raw counts.*--units.*gnomon apply"):
        read(folder)
    (folder / "imu0.csv").write_text(text(imu_rows(), IMU_HEADER))
    with pytest.raises(RecordingError, match="the accelerometer is in raw counts"):
        read(folder, units="raw")


def test_tables_of_samples_that_say_too_little(folder) -> None:
    (folder / "imu0.csv").write_text(text([row[1:] for row in imu_rows()], "wx,wy,wz,ax,ay,az"))
    with pytest.raises(RecordingError, match=r"no column holds the time.*ts_ns,wx,wy,wz,ax,ay,az") as caught:
        read(folder)
    assert "--rate" not in str(caught.value)
    (folder / "imu0.csv").write_text(text(imu_rows(), "t,a,b,c,d,e,f"))
    with pytest.raises(RecordingError, match=r"the header names no accelerometer.*ts_ns,wx,wy,wz,ax,ay,az") as caught:
        read(folder)
    assert "--columns" not in str(caught.value)
    (folder / "imu0.csv").write_text(text([[row[0], *row[4:]] for row in imu_rows()], "t_ns,ax,ay,az"))
    with pytest.raises(RecordingError, match=r"imu0\.csv: found no gyroscope; both triads"):
        read(folder)


def test_nan_among_the_samples(folder) -> None:
    rows = imu_rows()
    rows[5][2] = "nan"
    (folder / "imu0.csv").write_text(text(rows, IMU_HEADER))
    with pytest.raises(RecordingError, match=r"imu0\.csv, line 7, column 3 .*: found nan, expected a finite number"):
        read(folder)


def test_stated_rate_that_is_not_the_rate_is_noted(folder) -> None:
    (folder / "imu.yaml").write_text(yaml.safe_dump({**IMU, "update_rate": 100}))
    assert "imu0: its samples come at 200 Hz, not at the stated update_rate of 100 Hz" in said(folder)
    (folder / "imu.yaml").write_text(yaml.safe_dump({**IMU, "update_rate": 201}))
    assert "update_rate" not in said(folder)


# ---- folders ----


def test_streams_that_are_in_one_place_only_are_left_out_with_a_note(folder) -> None:
    (folder / "camchain.yaml").write_text(yaml.safe_dump({"cam0": CAM, "cam2": CAM}))
    (folder / "imu.yaml").write_text(yaml.safe_dump({"imu0": IMU, "imu3": IMU}))
    (folder / "cam1_corners.csv").write_text("this is not even read")
    notes = said(folder)
    assert "cam2 of camchain.yaml has no corners here and was left out." in notes
    assert "cam1_corners.csv was left out: camchain.yaml does not describe cam1." in notes
    assert "imu3 of imu.yaml has no samples here." in notes


def test_no_camera_in_both(folder) -> None:
    (folder / "camchain.yaml").write_text(yaml.safe_dump({"cam1": CAM}))
    with pytest.raises(RecordingError, match=r"there are corners of cam0, but camchain\.yaml describes cam1"):
        read(folder)


def test_nothing_to_read(folder, tmp_path_factory) -> None:
    files = {key: folder / f"{name}.yaml" for key, name in (("cam", "camchain"), ("imu", "imu"), ("target", "target"))}
    empty = tmp_path_factory.mktemp("empty")
    with pytest.raises(RecordingError, match=r"no images of a camera in this folder; found nothing at all\. Expected"):
        gnomon.read_camera_imu(empty, **files)
    (empty / "cam0").mkdir()
    (empty / "cam0" / "1600000005093000000.png").write_bytes(b"image")
    with pytest.raises(RecordingError, match=r"there are images, but no samples of an IMU in this folder"):
        gnomon.read_camera_imu(empty, **files)
    (folder / "imu0.csv").unlink()
    with pytest.raises(RecordingError, match=r"no samples of an IMU in this folder\. Expected .*imu0\.csv"):
        read(folder)
    with pytest.raises(RecordingError, match="there is no such file or folder"):
        gnomon.read_camera_imu(folder / "nowhere", **files)
    with pytest.raises(RecordingError, match=r"this is a text file, which holds no images\. Expected a ROS bag"):
        gnomon.read_camera_imu(folder / "cam0_corners.csv", **files)


WRONG = [
    "nan",
    "inf",
    "",
    "-",
    "1e300",
    "-1",
    "x",
    "\n",
    ",",
    "#",
    '"',
    "9" * 20,
    "9" * 400,
    "[",
    "{",
    "null",
    "~",
    "é",
]


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    st.sampled_from(["camchain.yaml", "imu.yaml", "target.yaml", "cam0_corners.csv", "cam0_frames.csv", "imu0.csv"]),
    st.lists(st.tuples(st.floats(0, 1), st.sampled_from(WRONG)), min_size=1, max_size=3),
    st.floats(0, 1),
)
def test_no_damage_ends_in_a_traceback(folder, name, damages, cut) -> None:
    (folder / "cam0_frames.csv").write_text(text([[t, 24] for t in stamps()], "ts_ns,n_corners"))
    whole = (folder / name).read_text()
    damaged = whole[: int(2 * cut * len(whole))]  # half of the files are cut off
    for place, wrong in damages:
        words = [match.span() for match in re.finditer(r"[^,\s:\[\]]+", damaged)] or [(0, 0)]
        start, stop = words[int(place * (len(words) - 1))]
        damaged = damaged[:start] + wrong + damaged[stop:]
    (folder / name).write_text(damaged)
    try:
        recording, target = read(folder)
        assert check_cameras(recording, target)
    except GnomonError:
        pass  # refused, with a message
    finally:
        (folder / name).write_text(whole)


def test_kalibrs_files_are_checked_first(folder) -> None:
    with pytest.raises(FormatError, match="This seems to be a target, which belongs to --target"):
        read(folder, cam=folder / "target.yaml")
    with pytest.raises(FormatError, match="there is no such file"):
        read(folder, imu=folder / "nowhere.yaml")


# ---- real recordings ----


@pytest.mark.parametrize(
    ("name", "frames", "rows"),
    [
        ("a-aprilgrid-full", 1197, 163007),
        ("b-aprilgrid-ideal-imu", 1197, 163602),
        ("d-checkerboard-ideal-imu", 1179, 49473),
    ],
)
def test_rendered(real_data, name, frames, rows) -> None:
    recording, target = read(real_data(f"rendered-camimu/{name}"))
    cam = recording.cameras["cam0"]
    assert (len(cam.t_ns), len(cam.frame), len(recording.imus["imu0"].gyroscope)) == (frames, rows, 12001)
    assert cam.point.max() == len(target.points) - 1
    assert len(recording.sources) == 5


@pytest.mark.parametrize("name", ["a-aprilgrid-full", "d-checkerboard-ideal-imu"])
def test_rendered_corners_are_where_the_renderer_put_them(real_data, name) -> None:
    cam = read(real_data(f"rendered-camimu/{name}"))[0].cameras["cam0"]
    true = np.genfromtxt(
        real_data(f"rendered-camimu/{name}") / "images" / "true_corners.csv", delimiter=",", names=True, dtype=None
    )
    errors = []
    for t, point, u, v, *_ in true.tolist():
        found = np.flatnonzero((np.abs(cam.t_ns[cam.frame] - t) < 1000) & (cam.point == point))
        errors += [cam.pixels[k] - (u, v) for k in found]
    assert len(errors) > 200
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


def test_euroc_in_time(real_data) -> None:
    kalibr = real_data("kalibr-format-samples/openvins_euroc_mav")
    files = {"cam": kalibr / "kalibr_imucam_chain.yaml", "imu": kalibr / "kalibr_imu_chain.yaml"}
    target = real_data("rendered-camimu") / "a-aprilgrid-full" / "target.yaml"
    took = []
    for _ in range(3):
        start = time.process_time()
        recording, board = gnomon.read_camera_imu(real_data("euroc-imu-april"), target=target, **files)
        took.append(time.process_time() - start)
    assert min(took) < 1.2  # usually 0.4; parsing row by row in Python would take 2 s
    cam0, cam1 = recording.cameras["cam0"], recording.cameras["cam1"]
    assert (len(cam0.t_ns), len(cam0.frame), len(cam1.t_ns), len(cam1.frame)) == (960, 123912, 960, 123344)
    assert cam0.t_ns[0] == 1404733405732800000
    assert recording.imus["imu0"].gyroscope.t_ns[0] == 1404733405747800064
    assert recording.imus["imu0"].gyroscope.unit == "rad/s"
    assert cam0.T_cam_imu is not None
    # Corner 0 of tag 0, then corner 1, as the README says which is which.
    assert np.abs(cam0.pixels[:2] - [[175.9866943359, 336.8252258301], [213.3338928223, 334.5094604492]]).max() == 0
    assert board.points[cam0.point[:2]].tolist() == [[0, 0, 0], [0.088, 0, 0]]
    for frames in (cam0, cam1):
        for number in range(0, 960, 100):
            seen = frames.frame == number
            assert homography_error(board.points[frames.point[seen], :2], frames.pixels[seen]) < 10  # the lens bends


def homography_error(plane, pixels) -> float:
    """Return the rms distance in px of points from where the homography that fits them best puts them."""
    x = np.column_stack([plane - plane.mean(axis=0), np.full(len(plane), 0.1)])
    u = (pixels - pixels.mean(axis=0)) / 100
    zero = np.zeros_like(x)
    A = np.block([[x, zero, -u[:, :1] * x], [zero, x, -u[:, 1:] * x]])
    H = np.linalg.svd(A)[2][-1].reshape(3, 3)
    image = x @ H.T
    return 100 * float(np.sqrt(np.mean(np.sum((image[:, :2] / image[:, 2:] - u) ** 2, axis=1))))
