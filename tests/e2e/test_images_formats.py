"""One recording of images in every layout: the same calibration, and the same recording back."""

import shutil
from functools import cache

import numpy as np
import pytest
import yaml

import gnomon
import recorded
from gnomon.readers.images.image_recording import open_images

LAYOUTS = ("euroc", "ros1", "ros2", "mcap", "kalibr")


@pytest.fixture(scope="module")
def calibrated(run, walks, tmp_path_factory):
    """Return a function that calibrates the small recording in one layout, once: folder of the result, document."""

    @cache
    def result(layout):
        source = walks.rendered()
        out = tmp_path_factory.mktemp("result") / "out"
        path = source if layout == "simulated" else walks.written(layout)
        code, _, err = run("camera-imu", path, *recorded.inputs(source), "-o", out, "--no-report")
        assert code == 0, err
        return out

    return result


def document(out):
    """Return a calibration without what names the files and says how they were understood."""
    found = recorded.content(out / "calibration.yaml", without=("inputs",))
    findings = found["assessment"]["findings"]
    found["assessment"]["findings"] = [finding for finding in findings if finding["code"] != "assumed"]
    return found


@pytest.mark.first(2)
@pytest.mark.long
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_calibration_to_the_last_digit(calibrated, layout):
    expected, found = calibrated("simulated"), calibrated(layout)
    assert document(found) == document(expected)
    for name in ("camchain-imucam.yaml", "trajectory.txt"):
        assert (found / name).read_bytes() == (expected / name).read_bytes()


@pytest.mark.long
def test_inputs_name_what_was_read(calibrated):
    names = {
        layout: [source.name for source in gnomon.load(calibrated(layout) / "calibration.yaml").provenance.inputs]
        for layout in ("euroc", "mcap")
    }
    files = ["camchain.yaml", "imu.yaml", "target.yaml"]
    assert names["euroc"] == [*files, "cam0/data.csv", "cam0 (80 images)", "imu0/data.csv"]
    assert names["mcap"] == [*files, "walk.mcap"]


def test_a_video_with_a_clock_of_its_own_differs_in_the_time_shift_alone(calibrated, walks):
    """Its clock begins at zero, that of the samples hours away; the times of the video are in whole milliseconds."""
    one, other = (gnomon.load(calibrated(layout) / "calibration.yaml") for layout in ("simulated", "video"))
    folder = walks.rendered()
    frames, samples = int(recorded.images_of(folder)[0].stem), int(recorded.samples_of(folder).rows[0][0])
    between_s = (frames - samples + recorded.VIDEO_START_NS) * 1e-9
    shift = other.cameras["cam0"].time_shift_cam_imu - between_s
    assert abs(shift - one.cameras["cam0"].time_shift_cam_imu) < 1e-6
    shifted = replaced_shift(other, one.cameras["cam0"].time_shift_cam_imu)
    assert recorded.most_sigmas(shifted, one) < 0.01
    np.testing.assert_allclose(other.uncertainty.matrix, one.uncertainty.matrix, rtol=1e-3, atol=1e-14)


def replaced_shift(calibration, shift):
    from dataclasses import replace

    cameras = {"cam0": replace(calibration.cameras["cam0"], time_shift_cam_imu=shift)}
    return replace(calibration, cameras=cameras)


@pytest.mark.parametrize("form", ["euroc", "ros1", "ros2", "mcap"])
def test_convert_loses_nothing_on_the_way_there_and_back(run, walks, tmp_path, form):
    """From a folder into a format and from there into a folder, by the command line: every byte of every image."""
    source = walks.rendered()
    first, second = tmp_path / recorded.NAMES[form], tmp_path / "back"
    for path, to, output in ((source, form, first), (first, "euroc", second)):
        code, out, err = run("convert", path, "--to", to, "-o", output)
        assert code == 0, err
        assert out.splitlines()[-1] == f"written: {output} (cam0 {recorded.FRAMES} images, imu0 801 samples)"
    one, other = open_images(source), open_images(second)
    for (t_ns, image), (t_other, image_other) in zip(frames(one), frames(other), strict=True):
        assert t_ns == t_other
        np.testing.assert_array_equal(image, image_other)
    for triad in ("accelerometer", "gyroscope"):
        expected, found = (getattr(recording.imus["imu0"], triad) for recording in (one, other))
        np.testing.assert_array_equal(found.t_ns, expected.t_ns)
        np.testing.assert_array_equal(found.values, expected.values)


def frames(recording):
    notes = []
    yield from ((frame.t_ns, frame.decode()) for frame in recording.streams["cam0"].frames(notes))
    assert notes == []


@pytest.mark.main
def test_convert_writes_a_video_as_a_bag(run, walks, tmp_path):
    """Frames of a video without loss, in a container that ROS knows."""
    code, _, err = run("convert", walks.written("video"), "--to", "mcap", "-o", tmp_path / "x.mcap")
    assert code == 0, err
    expected = [image for _, image in frames(open_images(walks.rendered()))]
    found = [image for _, image in frames(open_images(tmp_path / "x.mcap"))]
    assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


def test_topics_come_from_the_command_from_kalibrs_files_and_from_names(walks, tmp_path):
    """A bag with two cameras and two IMUs: what is stated wins over rostopic of Kalibr's files, and that over names."""
    source, bag = walks.rendered(), tmp_path / "two.bag"
    topics = {"cam0": "/left/image", "cam1": "/right/image"}
    recorded.save_topics(bag, open_images(source), topics, {"imu0": "/imu/a", "imu1": "/imu/b"}, frames=8)
    files = {name: tmp_path / file for name, file in recorded.FILES.items()}
    for name, file in recorded.FILES.items():
        shutil.copy(source / file, files[name])
    for stated, written in ((True, ("/right/image", "/imu/a")), (False, ("/right/image", "/imu/b"))):
        chain = yaml.safe_load(files["cam"].read_text())
        recorded.edited(files["cam"], {"cam0": chain["cam0"] | {"rostopic": written[0]}})
        recorded.edited(files["imu"], {"rostopic": written[1]})
        wanted = {"cam0": "/left/image", "imu0": "/imu/b"} if stated else {}
        recording, _ = gnomon.read_camera_imu(bag, **files, topics=wanted)
        assert recording.cameras["cam0"].camera.topic == wanted.get("cam0", written[0])
        assert recording.imus["imu0"].topic == wanted.get("imu0", written[1])
        assert set(recording.cameras) == {"cam0"}
        assert len(np.unique(recording.cameras["cam0"].frame)) == 8
