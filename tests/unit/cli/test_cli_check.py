"""`gnomon check` for rigs: corners, images, and what is known of them; an IMU alone as before."""

import contextlib
import io
import json

import cv2
import numpy as np
import pytest

from gnomon.cli import main

EPOCH = 1_600_000_000_000_000_000
GRAVITY = np.array([0, 9.81, 0])


def run(*arguments):
    """Exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def document(*arguments):
    code, out, err = run("check", *arguments, "--json")
    assert err.count("Traceback") == 0
    found = json.loads(out)
    assert found["exit_code"] == code
    return found, {finding["code"]: finding["severity"] for finding in found["findings"]}


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig") / "walk"
    code, _, err = run("simulate", "camera-imu", "-o", folder, "--duration-s", 25, "--seed", 5)
    assert code == 0, err
    return folder


def samples(path, seconds=20.0, columns="#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z"):
    rng = np.random.default_rng(1)
    t = np.arange(round(200 * seconds)) / 200
    rate = np.stack([1.1 * np.sin(6 * t), 0.9 * np.cos(5 * t), 0.8 * np.sin(4.1 * t + 1)], axis=1)
    force = np.stack([2 * np.sin(7 * t), 9.6 + 1.5 * np.cos(6 * t), 1.5 * np.sin(5 * t)], axis=1)
    values = np.concatenate([rate + rng.normal(0, 0.002, rate.shape), force + rng.normal(0, 0.03, force.shape)], axis=1)
    rows = (f"{EPOCH + round(s * 1e9)},{','.join(f'{x:.6f}' for x in row)}" for s, row in zip(t, values, strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([columns, *rows]) + "\n", encoding="ascii")


@pytest.fixture
def images(tmp_path):
    """A folder in EuRoC's layout, with pictures of anything."""
    folder = tmp_path / "flight"
    samples(folder / "mav0" / "imu0" / "data.csv")
    rng = np.random.default_rng(3)
    place = folder / "mav0" / "cam0" / "data"
    place.mkdir(parents=True)
    for k in range(200):
        image = np.full((120, 160), 90, np.uint8)
        for _ in range(25):
            box = cv2.boxPoints((tuple(rng.uniform(0, 150, 2)), tuple(rng.uniform(20, 60, 2)), rng.uniform(0, 90)))
            cv2.fillPoly(image, [np.rint(box).astype(np.int32)], int(rng.integers(20, 230)), lineType=cv2.LINE_AA)
        cv2.imwrite(str(place / f"{EPOCH + k * 100_000_000}.png"), cv2.GaussianBlur(image, (0, 0), 0.6))
    return folder


# ---- corners ----


def test_corners_with_all_that_is_known(corners) -> None:
    code, out, err = run("check", corners)
    assert (code, err) == (0, "")
    assert "detected: camchain.yaml, imu.yaml and target.yaml in the recording's folder are used." in out
    assert "cam0               " in out
    assert "never-static" not in out
    assert "The clocks of cam0 and imu0 keep together" in " ".join(out.split())
    found, codes = document(corners)
    assert codes["frames"] == "good"
    assert "attitudes" not in codes  # asked of an IMU alone
    assert found["cameras"]["cam0"]["frames"] > 400
    assert found["imus"]["imu0"]["gyroscope"]["unit"] == "rad/s"


def test_corners_without_camera_and_board(corners, tmp_path) -> None:
    for name in ("cam0_corners.csv.gz", "imu0.csv.gz"):
        (tmp_path / name).write_bytes((corners / name).read_bytes())
    code, out, _ = run("check", tmp_path)
    assert code == 0
    assert "without --cam and --target only timestamps and samples are looked at" in out
    found, codes = document(tmp_path)
    assert set(codes.values()) == {"good"}
    assert found["cameras"]["cam0"]["corners"] > 10_000
    stated = document(tmp_path, "--cam", corners / "camchain.yaml", "--target", corners / "target.yaml")[1]
    assert stated["frames"] == "good"


def test_corners_without_an_imu(corners, tmp_path) -> None:
    (tmp_path / "cam0_corners.csv.gz").write_bytes((corners / "cam0_corners.csv.gz").read_bytes())
    found, codes = document(tmp_path)
    assert codes["imu-missing"] == "warning"  # it serves for gnomon camera
    assert found["exit_code"] == 0


# ---- images ----


def test_images_alone(images) -> None:
    code, out, _ = run("check", images)
    assert code == 0, out
    assert "cam0               200 images of 160 x 120 px, 19.9 s at 10 Hz, 60 looked at" in out
    found, codes = document(images)
    assert codes["images"] == "good"
    assert {key: found["cameras"]["cam0"][key] for key in ("images", "width", "height", "looked_at")} == {
        "images": 200, "width": 160, "height": 120, "looked_at": 60
    }  # fmt: skip


def test_images_with_a_board_that_is_not_there(images, tmp_path) -> None:
    target = tmp_path / "board.yaml"
    target.write_text(
        "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n", encoding="ascii"
    )
    found, codes = document(images, "--target", target)
    assert codes["board-missing"] == "problem"
    assert found["exit_code"] == 4
    assert found["cameras"]["cam0"]["board_seen"] == 0
    (images / "target.yaml").write_bytes(target.read_bytes())
    assert document(images)[1]["board-missing"] == "problem"  # found where it lies


def test_size_against_the_intrinsics(images) -> None:
    (images / "camchain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [460, 458, 320, 240]\n  distortion_model: radtan\n"
        "  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n",
        encoding="ascii",
    )
    assert document(images)[1]["image-size"] == "problem"


def test_table_of_the_imu_elsewhere(images, tmp_path) -> None:
    table = images / "mav0" / "imu0" / "data.csv"
    elsewhere = tmp_path / "samples.csv"
    elsewhere.write_bytes(table.read_bytes())
    table.unlink()
    assert document(images)[1]["imu-missing"] == "warning"
    assert document(images, "--imu-table", elsewhere)[0]["exit_code"] == 0


# ---- wrong usage ----


def test_options_for_cameras_need_cameras(tmp_path) -> None:
    samples(tmp_path / "alone.csv")
    (tmp_path / "target.yaml").touch()
    code, _, err = run("check", tmp_path / "alone.csv", "--target", tmp_path / "target.yaml", "--topics", "cam0=/x")
    assert code == 2
    assert "--target, --topics are for recordings with cameras, and there is none in this one" in err


def test_topics_are_names_and_topics(images) -> None:
    code, _, err = run("check", images, "--topics", "left")
    assert code == 2
    assert "NAME=TOPIC" in err


def test_imu_alone_is_judged_as_before(tmp_path) -> None:
    samples(tmp_path / "alone.csv")
    found, codes = document(tmp_path / "alone.csv")
    assert "cameras" not in found
    assert codes["never-static"] == "problem"


def test_no_such_recording(tmp_path) -> None:
    code, _, err = run("check", tmp_path / "nothing")
    assert code == 3
    assert "nothing" in err
    assert "Traceback" not in err


def test_a_recording_that_is_fit_leads_on_with_its_options(tmp_path):
    rng = np.random.default_rng(8)
    up = rng.normal(size=(12, 3))
    force = np.repeat(9.81 * up / np.linalg.norm(up, axis=1, keepdims=True), 300, axis=0)
    values = np.hstack([force, np.zeros_like(force)]) + rng.normal(0, 0.005, (len(force), 6))
    values[(np.arange(len(force)) % 300) < 60] += rng.normal(0, 1, (12 * 60, 6))
    path = tmp_path / "log.csv"
    np.savetxt(path, values[:, :3], fmt="%.4f", delimiter=",", header="ax,ay,az", comments="")
    found, _ = document(path, "--rate", 100)
    assert found["next"] == [f"gnomon imu {path} --rate 100"]
    _, out, _ = run("check", path, "--rate", 100)
    assert "gyroscope  " not in out
    assert "nan" not in out


def test_what_was_turned_for_its_magnetometer_needs_no_rests(tmp_path) -> None:
    path = tmp_path / "field.npz"
    assert run("simulate", "magnetometer", "-o", path, "--seed", 3)[0] == 0
    found, codes = document(path)
    assert (found["exit_code"], codes["never-static"]) == (0, "info")
    _, out, _ = run("check", path)
    assert f"gnomon magnetometer {path}" in out


def test_one_attitude_is_for_noise_and_few_for_the_magnetometer(tmp_path) -> None:
    rest, few = tmp_path / "rest.npz", tmp_path / "few.npz"
    assert run("simulate", "noise", "-o", rest, "--seed", 3, "--duration-s", 120)[0] == 0
    found, codes = document(rest)
    assert (found["exit_code"], codes["always-static"]) == (4, "problem")
    assert found["next"] == [f"gnomon noise {rest}"]
    assert run("simulate", "imu", "-o", few, "--seed", 3, "--intervals", 5, "--t-init-s", 5)[0] == 0
    with np.load(few) as archive:
        arrays = dict(archive)
    np.savez(few, **arrays, magnetometer=arrays["accelerometer"] / 20)
    found, codes = document(few)
    assert (found["exit_code"], codes["attitudes"]) == (0, "warning")
    assert found["next"] == [f"gnomon magnetometer {few}"]
