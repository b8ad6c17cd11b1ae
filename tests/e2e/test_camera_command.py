"""`gnomon camera` from recording to files, on simulated views, and what the other commands do with its result."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.formats.kalibr.results import read_cam_results
from gnomon.formats.shared.entries import baseline_of

TARGET = "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
QUICK = ("--model", "pinhole-radtan", "--board", "stated")
FILES = {"calibration.yaml", "diagnostics.npz", "camchain.yaml", "results-cam.txt"}


def write_views(folder, simulation):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "target.yaml").write_text(TARGET)
    for name, frames in simulation.recording.cameras.items():
        corners = zip(frames.frame.tolist(), frames.point.tolist(), frames.pixels.tolist(), strict=True)
        rows = [f"{frames.t_ns[view]},{point},{u!r},{v!r}" for view, point, (u, v) in corners]
        (folder / f"{name}_corners.csv").write_text("ts_ns,corner_id,u_px,v_px\n" + "\n".join(rows) + "\n")


def run(capsys, *arguments):
    """Return exit code, the document, and what was said besides."""
    code = main([*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


@pytest.fixture(scope="module")
def simulation():
    return gnomon.simulate_cameras(gnomon.CamerasScenario(views=24, cameras=2), 7)


@pytest.fixture(scope="module")
def views(simulation, tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera") / "views"
    write_views(folder, simulation)
    return folder


@pytest.fixture(scope="module")
def made(views):
    """The folder of a result, made once, and what was on the screen."""
    with contextlib.redirect_stdout(io.StringIO()) as screen:
        assert main(["camera", str(views), "--resolution", "752", "480", *QUICK, "--no-report"]) == 0
    folder = views.with_name("views-camera")
    assert {path.name for path in folder.iterdir()} == FILES
    return folder, screen.getvalue()


@pytest.fixture(scope="module")
def result(made):
    return made[0]


def test_truth_is_inside_the_sigmas(result, simulation):
    calibration = gnomon.load(result / "calibration.yaml")
    assert calibration.frame == "cam0"
    for name, true in simulation.truth.cameras.items():
        sigma = np.concatenate([calibration.sigma(f"{name}.{key}") for key in ("intrinsics", "distortion_coeffs")])
        z = (calibration.cameras[name].camera.parameters - true.camera.parameters) / sigma
        assert np.abs(z).max() < 5
        assert sigma[:4].max() < 0.5
    found, true = baseline_of(calibration, "cam0", "cam1"), simulation.truth.cameras["cam1"].T_cam_body
    moved = (found.T[:3, 3] - true[:3, 3]) / np.sqrt(np.diag(found.covariance))[3:]
    assert np.abs(moved).max() < 5
    assert found.distance_sigma < 5e-4


def test_kalibrs_files_hold_the_same(result):
    calibration = gnomon.load(result / "calibration.yaml")
    read = read_cam_results(result / "results-cam.txt", [])
    for name, camera in calibration.cameras.items():
        assert np.array_equal(read[name].camera.parameters, camera.camera.parameters)
        sigma = np.concatenate([calibration.sigma(f"{name}.{key}") for key in ("intrinsics", "distortion_coeffs")])
        assert np.allclose(np.sqrt(np.diag(read[name].lens_covariance)), sigma, rtol=1e-6)
    text = (result / "results-cam.txt").read_text()
    assert "baseline T_1_0:" in text
    assert "    Rows: 6\n" in text
    q = np.array(text.split("    q: [")[1].split("]")[0].split(), float)
    R = calibration.cameras["cam1"].T_cam_body[:3, :3]
    x, y, z, w = q  # JPL's, as Kalibr has them: C(q) = 1 - 2 w [v]x + 2 [v]x^2
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    assert np.allclose(np.eye(3) - 2 * w * cross + 2 * cross @ cross, R, atol=1e-7)
    assert "cam_overlaps: [1]" in (result / "camchain.yaml").read_text()


def test_the_screen(views, made):
    out = made[1]
    assert "target.yaml in the recording's folder is used." in out
    for words in ("of 24 views", "hold-out  ", "% of the image", "pinhole-radtan *", "t_x from cam0", "mm apart"):
        assert words in out
    assert "next         gnomon camera-imu RECORDING --target" in out
    assert max(map(len, out.replace(str(views.parent), "").splitlines())) < 200


@pytest.mark.main
def test_the_document(views, capsys, tmp_path):
    arguments = ("camera", views, "--resolution", 752, 480, *QUICK, "--no-report", "-o", tmp_path / "out")
    code, document, _ = run(capsys, *arguments)
    assert (code, document["exit_code"]) == (0, 0)
    assert set(map(Path, document["files"].values())) == {tmp_path / "out" / name for name in FILES}
    assert document["calibration"]["schema"] == "gnomon/1.4"
    assert {trial["camera"] for trial in document["trials"] if trial["chosen"]} == {"cam0", "cam1"}
    assert document["next"][0].startswith("gnomon camera-imu RECORDING")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "how large the images of cam0 and cam1 are"),
        (("--resolution", 752, 480, "--target", "nowhere.yaml"), 3, "nowhere.yaml"),
        (("--resolution", 752, 480, "--model", "pinhole-banana"), 2, "banana"),
        (("--resolution", 752, 0), 2, "at least 1 pixel"),
        (("--resolution", 300, 200), 3, "lie outside the image"),
    ],
)
def test_what_is_wrong_is_said_and_nothing_is_written(views, capsys, tmp_path, arguments, code, message):
    found, document, _ = run(capsys, "camera", views, *arguments, "-o", tmp_path / "out")
    assert found == code
    assert message in document["error"]["message"]
    assert not (tmp_path / "out").exists()


def test_too_few_views(capsys, tmp_path):
    write_views(tmp_path / "few", gnomon.simulate_cameras(gnomon.CamerasScenario(views=2), 1))
    found, document, _ = run(capsys, "camera", tmp_path / "few", "--resolution", 752, 480)
    assert found == 3
    assert "views" in document["error"]["message"] or "images" in document["error"]["message"]
    assert not (tmp_path / "few-camera").exists()


def test_missing_target(capsys, tmp_path, simulation):
    write_views(tmp_path / "views", simulation)
    (tmp_path / "views" / "target.yaml").unlink()
    found, document, _ = run(capsys, "camera", tmp_path / "views", "--resolution", 752, 480)
    assert found == 2
    assert "--target is missing" in document["error"]["message"]


def test_inputs_are_not_written_over(result, views, capsys):
    found, document, _ = run(capsys, "camera", views, "--cam", result / "camchain.yaml")
    assert found == 2
    assert "would replace this file of --cam" in document["error"]["message"]
    found, document, _ = run(capsys, "camera", views, "--resolution", 752, 480, "-o", views)
    assert found == 2
    assert "the recording's folder" in document["error"]["message"]


def test_commands_that_take_a_calibration(result, views, capsys, tmp_path):
    """Each finishes, or says clearly why not."""
    path = result / "calibration.yaml"
    (tmp_path / "imu.csv").write_text(
        "t,ax,ay,az,gx,gy,gz\n" + "".join(f"{k / 100},0,0,9.8,0,0,0\n" for k in range(200))
    )
    for arguments, code, words in (
        (("show", path), 0, None),
        (("show", path, "--for", "vio"), 2, "cameras alone"),
        (("convert", path, "--to", "kalibr", "-o", tmp_path / "kalibr"), 0, None),
        (("convert", path, "--to", "okvis", "-o", tmp_path / "okvis"), 2, "cameras alone"),
        (("apply", path, tmp_path / "imu.csv", "-o", tmp_path / "out.csv"), 2, "cameras alone"),
        (("imu", tmp_path / "imu.csv", "--prior", path, "-o", tmp_path / "imu"), 2, "cameras alone"),
        (("check", views), 0, None),
        (("check", views, "--cam", path), 0, None),
        (("compare", f"a={path}", f"b={path}", "-o", tmp_path / "compared"), 0, None),
    ):
        found, document, _ = run(capsys, *arguments)
        assert found == code, (arguments, document)
        assert words is None or words in document["error"]["message"]
    assert not (tmp_path / "okvis").exists()
    assert not (tmp_path / "out.csv").exists()
