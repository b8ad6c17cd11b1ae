"""YAML that other programs and people write: what is understood, and what is refused."""

import numpy as np
import pytest

from gnomon.errors import FormatError
from gnomon.formats.kalibr.camchain import read_camchain
from gnomon.formats.kalibr.imu import read_imu_input
from gnomon.formats.shared.foreign_yaml import (
    read_foreign_yaml,
    read_matrix,
    read_rotation,
    read_transform,
    unwrap_rows,
)
from gnomon.formats.shared.structured import read_yaml

CAMERA = """\
cam0:
  camera_model: pinhole
  intrinsics: [460, 458.5, 322.4, 237.1]
  distortion_model: radtan
  distortion_coeffs: [-0.28, 0.075, 2e-4, -15e-5]
  resolution: [640, 480]
"""
OPENCV = """\
%YAML:1.0
---
cam0:
   camera_model: pinhole
   distortion_model: radtan
   intrinsics: !!opencv-matrix
      rows: 1
      cols: 4
      dt: d
      data: [ 460., 458.5, 322.4, 237.1 ]
   distortion_coeffs: !!opencv-matrix
      rows: 4
      cols: 1
      dt: d
      data: [ -0.28, 0.075, 2.0e-04, -1.5e-04 ]
   resolution: !!python/tuple [640, 480]
   T_cam_imu: !!opencv-matrix
      rows: 4
      cols: 4
      dt: d
      data: [ 0., -1., 0., 0.1, 0., 0., -1., -0.02, 1., 0., 0., 0.03,
         0., 0., 0., 1. ]
"""
NOISE = """\
accelerometer_noise_density: 2e-3
accelerometer_random_walk: 3E-3
gyroscope_noise_density: 1.7e-4
gyroscope_random_walk: 2e-5
update_rate: 200
"""


@pytest.fixture
def write(tmp_path):
    def make(text, name="file.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return make


def lens(path, notes=None):
    return read_camchain(path, notes)["cam0"].camera


@pytest.mark.parametrize(
    "head",
    ["", "%YAML:1.0\n", "%YAML:1.0\n---\n", "%YAML:1.0 # a word\n\n\n", "%YAML 1.2\n---\n", "%YAML 1.1\n", "---\n",
     "\ufeff%YAML:1.0\n", "# first a comment\n%YAML:1.0\n---\n", "%YAML:1.0\r\n---\r\n"],
)  # fmt: skip
def test_first_lines(write, head):
    notes = []
    assert lens(write(head + CAMERA), notes).parameters.tolist() == [
        460, 458.5, 322.4, 237.1, -0.28, 0.075, 2e-4, -15e-5,
    ]  # fmt: skip
    assert notes == []


def test_matrices_of_opencv(write):
    notes = []
    found = read_camchain(write(OPENCV), notes)["cam0"]
    assert found.camera.parameters.tolist() == [460, 458.5, 322.4, 237.1, -0.28, 0.075, 2e-4, -1.5e-4]
    assert found.camera.resolution == (640, 480)
    assert found.T_cam_imu.tolist() == [[0, -1, 0, 0.1], [0, 0, -1, -0.02], [1, 0, 0, 0.03], [0, 0, 0, 1]]
    assert notes == []


def test_what_opencv_wrote_itself(tmp_path):
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(tmp_path / "m.yaml"), cv2.FILE_STORAGE_WRITE)
    expected = np.random.default_rng(0).normal(size=(3, 4))
    storage.write("matrix", expected)
    storage.write("number", 0.1)
    storage.release()
    root = read_foreign_yaml(tmp_path / "m.yaml")
    assert np.array_equal(read_matrix(root.child("matrix"), 3, 4), expected)
    assert root.child("number").number() == 0.1


def test_matrix_whose_size_is_wrong(write):
    with pytest.raises(FormatError, match=r"cam0\.intrinsics: rows 1 and cols 5 do not fit its 4 numbers"):
        lens(
            write(OPENCV.replace("cols: 4\n      dt: d\n      data: [ 460", "cols: 5\n      dt: d\n      data: [ 460"))
        )


def test_scalars_with_tags_and_numbers_as_text(write):
    root = read_foreign_yaml(write('a: !number 1e-3\nb: "2.5"\nc: !x {d: !y [1, 2]}\ne: !!python/tuple [1]\n'))
    assert root.child("a").number() == 1e-3
    assert root.child("b").number() == 2.5
    assert root.value["c"] == {"d": [1, 2]}
    assert root.value["e"] == [1]


def test_our_own_files_stay_strict(write):
    for text in ("a: !x 1\n", "%YAML 1.1\na: 1\n", "a:\n\tb: 1\n", "a:\n  - [1, 2],\n"):
        with pytest.raises(FormatError, match="this is not YAML"):
            read_yaml(write(text))


def test_tabs_and_trailing_commas(write):
    notes = []
    text = (
        CAMERA.replace("  ", "\t")
        + "\tT_cam_imu:\n"
        + "".join(f"\t\t- [{', '.join(map(str, row))}],\n" for row in np.eye(4).tolist())
    )
    assert read_camchain(write(text), notes)["cam0"].T_cam_imu.tolist() == np.eye(4).tolist()
    assert notes == ["file.yaml: commas at the ends of rows and tabs, which YAML does not allow, were passed over."]
    notes = []
    assert read_imu_input(write(NOISE.replace(": ", ":\t")), notes)["imu0"].noise.gyroscope_random_walk == 2e-5
    assert notes == []  # a tab between key and value is YAML


def test_tabs_that_could_mean_two_things_are_refused(write):
    # With tabs of two columns b is beside a, with tabs of four it is under c.
    with pytest.raises(FormatError, match="this is not YAML"):
        read_foreign_yaml(write("x:\n  a: 1\n  c:\n\tb: 2\n"))


def test_a_comma_within_a_table_is_left_alone(write):
    text = "T: [[1, 2],\n  [3, 4],\n  [5, 6]]\n"
    notes = []
    assert read_matrix(read_foreign_yaml(write(text), notes).child("T"), 3, 2).tolist() == [[1, 2], [3, 4], [5, 6]]
    assert notes == []


@pytest.mark.parametrize("text", ["a: [1, 2\n", "a: 1\na: 2\n", "a: b: c\n", "- [1, 2],\nb: 1\n", "a: &x [*x]\nb: 1\n"])
def test_what_is_no_yaml_is_refused_with_its_place(write, text):
    with pytest.raises(FormatError, match=r"file\.yaml"):
        read_foreign_yaml(write(text)).child("a").number()


def test_matrices_in_every_layout(write):
    values = np.arange(12.0)
    rows = values.reshape(3, 4).tolist()
    text = f"a: {rows}\nb: {values.tolist()}\nc: {{rows: 3, cols: 4, data: {values.tolist()}}}\n"
    root = read_foreign_yaml(write(text))
    for key in "abc":
        assert np.array_equal(read_matrix(root.child(key), 3, 4), values.reshape(3, 4))
    with pytest.raises(FormatError, match=r"a: found 3 rows, expected 4"):
        read_matrix(root.child("a"), 4, 3)
    assert unwrap_rows(root.child("a")) is not None


def test_rotations_keep_their_digits(write):
    exact = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    root = read_foreign_yaml(write(f"R: {exact.tolist()}\nS: {(exact + 1e-4).tolist()}\nT: {(-exact).tolist()}\n"))
    assert np.array_equal(read_rotation(root.child("R")), exact)
    near = read_rotation(root.child("S"))
    assert np.abs(near @ near.T - np.eye(3)).max() < 1e-14
    assert np.abs(near - exact).max() < 2e-4
    with pytest.raises(FormatError, match=r"T: this is mirrored"):
        read_rotation(root.child("T"))
    with pytest.raises(FormatError, match=r"R: found 3 rows, expected 4"):
        read_transform(root.child("R"))
