"""YAML and JSON made to hurt: bombs, depth, tags, numbers and names; each is refused in words, and at once."""

import json
import os

import pytest
import yaml

import gnomon
from gnomon.errors import FormatError
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.own.calibration_file import read_own
from gnomon.formats.sensor_inputs import read_cameras
from gnomon.formats.shared.foreign_yaml import read_foreign_yaml
from gnomon.formats.shared.structured import read_json, read_yaml
from gnomon.readers.files import pose_files
from hostile.promise import Target, keep
from hostile.structured_targets import CAM, converted

DEEP = 200_000  # brackets; a tenth of that ends the program where nothing is done about it


def bomb(levels: int, *, merge: bool = False) -> str:
    """Return nine lines that stand for 9^levels values."""
    first = "a0: &a0 {k: 1}" if merge else "a0: &a0 [x, x, x, x, x, x, x, x, x]"
    one = "a{}: &a{} {{{}}}" if merge else "a{}: &a{} [{}]"
    inner = "<<: [{}]" if merge else "{}"
    names = (", ".join([f"*a{i - 1}"] * 9) for i in range(1, levels))
    return "\n".join([first, *(one.format(i, i, inner.format(n)) for i, n in enumerate(names, start=1))])


def refused(read, path, content: str | bytes, *words: str) -> None:
    """Refuse in words, without taking time or memory."""
    data = content.encode() if isinstance(content, str) else content
    target = Target(name="attack", file=path.name, seeds=list, read=lambda folder: read(folder / path.name))
    error = keep(target, path.parent, data)
    assert isinstance(error, FormatError)
    for word in words:
        assert word in str(error), str(error)


@pytest.mark.parametrize("read", [read_yaml, read_foreign_yaml, gnomon.load, load_foreign, read_cameras])
@pytest.mark.parametrize("merge", [False, True])
def test_yaml_bombs(tmp_path, read, merge):
    schema = "schema: gnomon/1\n" if read is gnomon.load else ""
    refused(read, tmp_path / "bomb.yaml", schema + bomb(12, merge=merge), "aliases (*) make", "Write out what is meant")


def test_aliases_that_save_some_lines_are_read(tmp_path):
    shared = {"cam0": CAM, "cam1": {**CAM, "T_cn_cnm1": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
    text = yaml.safe_dump(shared)
    assert "*id001" in text
    (tmp_path / "camchain.yaml").write_text(text)
    assert list(read_cameras(tmp_path / "camchain.yaml")) == ["cam0", "cam1"]


@pytest.mark.parametrize("text", ["a: &a [*a]", "&a {x: *a}", "a: &a\n  b: &b {c: [*a, *b]}", "? &a [*a]\n: 1"])
def test_values_that_hold_themselves(tmp_path, text):
    refused(read_foreign_yaml, tmp_path / "loop.yaml", text, "holds itself by an alias")


@pytest.mark.parametrize(
    "text",
    ["[" * DEEP, "[" * DEEP + "]" * DEEP, "- " * DEEP + "x", "{a: " * DEEP, "? " * DEEP, "a: " + "[" * 60 + "]" * 60],
)
def test_depth(tmp_path, text):
    refused(read_foreign_yaml, tmp_path / "deep.yaml", text, "nested more than 50 deep")
    refused(load_foreign, tmp_path / "deep.yaml", text, "nested more than 50 deep")


def test_depth_by_indents(tmp_path):
    refused(read_yaml, tmp_path / "deep.yaml", "\n".join(f"{' ' * i}a:" for i in range(300)), "nested more than 50")


def test_brackets_in_texts_and_comments_are_no_depth(tmp_path):
    (tmp_path / "a.yaml").write_text("# " + "[" * 99 + '\nname: "' + "[" * 99 + '"\n')
    assert read_yaml(tmp_path / "a.yaml").value == {"name": "[" * 99}


@pytest.mark.parametrize("text", ["[" * DEEP, '{"a":' * DEEP, "[" * 60 + "]" * 60])
def test_depth_of_json(tmp_path, text):
    refused(read_json, tmp_path / "deep.json", text, "nested more than 50 deep")


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.mkdir [{}]", "!!python/name:os.mkdir", "!!python/module:os"])
def test_tags_make_nothing_run(tmp_path, tag):
    place = tmp_path / "made"
    text = f"a: {tag.format(place)}"
    refused(read_yaml, tmp_path / "tag.yaml", text, "this is not YAML")
    target = Target(name="tag", file="tag.yaml", seeds=list, read=lambda folder: load_foreign(folder / "tag.yaml"))
    assert isinstance(keep(target, tmp_path, text.encode()), FormatError)
    assert not place.exists()


@pytest.mark.parametrize(
    "text",
    [
        "a: !!timestamp yesterday", "a: !!int x", "a: !!int ''", "a: !!float x", "a: !!binary \u00e9",
        "a: !!omap {b: 1}", "a: !!bool maybe", "a: 2001-99-99", "{[]: 1}", "{{}: 1}", "a: !!set [1]",
        "a: !!pairs x", "a: \0", "\ufffe", "@",
    ],
)  # fmt: skip
def test_tags_that_promise_what_is_not_there(tmp_path, text):
    refused(read_yaml, tmp_path / "tag.yaml", text)


@pytest.mark.parametrize("value", ["1" * 5000, "9" * 1_000_000, "1e999", ".inf", "-.inf", ".nan", "1e308", "-1e70"])
def test_numbers_of_any_size(tmp_path, value):
    noise = dict.fromkeys(("accelerometer_random_walk", "gyroscope_noise_density", "gyroscope_random_walk"), 1e-4)
    lines = [f"{key}: {number}" for key, number in noise.items()]
    refused(load_foreign, tmp_path / "imu.yaml", "\n".join([f"accelerometer_noise_density: {value}", *lines]))


@pytest.mark.parametrize(
    "value", ["1" * 5000, "9" * 1_000_000, "1e999", "1e308", "NaN", "-Infinity", "[" * 40 + "]" * 40]
)
def test_numbers_of_any_size_in_json(tmp_path, value):
    text = next(iter(converted("basalt").values()))
    key = '"calib_accel_bias": ['
    assert key in text
    refused(load_foreign, tmp_path / "basalt.json", text.replace(key, f"{key}{value}, "))


def test_names_in_messages_are_short(tmp_path):
    (tmp_path / "a.yaml").write_text(json.dumps({"cam0": {**CAM, "camera_model": "x" * 100_000}}))
    with pytest.raises(FormatError) as error:
        read_cameras(tmp_path / "a.yaml")
    assert "characters)" in str(error.value)
    assert len(str(error.value)) < 1500


def test_a_file_that_is_no_calibration_for_its_size(tmp_path):
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(FormatError, match="no calibration is larger than 32 MiB"):
        read_own(path)
    path.unlink()


def test_negative_variances(tmp_path):
    text = converted("json")["calibration.json"]
    document = json.loads(text)
    document["covariance"]["lower_triangle"][0][0] = -1.0
    refused(gnomon.load, tmp_path / "calibration.json", json.dumps(document), "variance", "is below zero")


@pytest.mark.parametrize("name", ["../cam0.yaml", "/etc/passwd", "a/../../cam0.yaml", "\0", "x" * 5000, ""])
def test_lenses_are_looked_for_beside_their_configuration(tmp_path, name):
    """VINS' configuration names the files of its lenses; those that lie elsewhere are not opened."""
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "cam0.yaml").write_text(converted("vins-fusion")["cam0.yaml"])
    text = converted("vins-fusion")["config.yaml"]
    assert 'cam0_calib: "cam0.yaml"' in text
    quoted = json.dumps(name)
    refused(load_foreign, inner / "config.yaml", text.replace('cam0_calib: "cam0.yaml"', f"cam0_calib: {quoted}"))


@pytest.mark.parametrize("key", ["cam" + "1" * 5000, "imu" + "9" * 5000, "schema: gnomon/" + "1" * 5000])
def test_numbers_in_names(tmp_path, key):
    for read in (load_foreign, read_cameras, gnomon.load):
        refused(read, tmp_path / "a.yaml", f"{key}: {{camera_model: pinhole, accelerometer_noise_density: 1}}")


@pytest.mark.skipif(os.name == "nt", reason="Windows knows no such names")
def test_poses_with_digits_of_other_scripts(tmp_path):
    """A superscript is a digit, but no number."""
    for name in ("pose\u00b2.csv", "pose1.csv", "pose\u0663.csv"):
        (tmp_path / name).write_text("0,1,2,3\n1,1,2,3\n")
    assert len(pose_files([tmp_path]) or ()) == 3
