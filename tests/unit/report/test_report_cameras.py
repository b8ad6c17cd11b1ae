"""The report of a camera calibration: complete, right in its numbers, small, whatever is missing."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

from cameras_result import BOARD, LENSES, PIXEL_SIGMA, make_cameras_result, without_lens_covariance
from gnomon.calibrate.cameras import calibrate_cameras
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.camera import Camera
from gnomon.options import CameraOptions
from gnomon.report.cameras.lens import (
    field_of_view,
    focal_at_axis,
    lens_covariance,
    projection_spread,
    radial_curve,
    undistorted_grid,
)
from gnomon.report.cameras.page import board_section
from gnomon.report.cameras.views import epipolar_errors, views_around
from gnomon.report.corners import unseen_places, view_groups
from gnomon.report.page import write_report
from gnomon.report.rig_parameters import pose_numbers
from gnomon.results.calibration import Covariance
from gnomon.results.camera_diagnostics import ViewPose
from gnomon.simulate.cameras import simulate_cameras
from gnomon.simulate.scenarios.cameras import CamerasScenario
from html_page import Page


@pytest.fixture(scope="module")
def result():
    return make_cameras_result()


@pytest.fixture
def page_of(tmp_path):
    def make(result):
        path = tmp_path / "report.html"
        write_report(result, path)
        return Page(path.read_text(encoding="utf-8"))

    return make


def with_diagnostics(result, **changes):
    return replace(result, diagnostics=replace(result.diagnostics, **changes))


def used_pixels(result, name="cam0"):
    fit = result.diagnostics.corners[name]
    return fit.pixels[fit.frame_used[fit.frame]]


def test_page_says_the_verdict_first_and_everything_once(result, page_of, tmp_path):
    page = page_of(result)
    text = page.text
    order = [
        "Camera calibration", "Warn. This calibration can be used", "Hold-out reprojection", "0.149 px", "40 of 54",
        "Image covered", "92 %", "457.976 ± 0.078 px", "σ of the projection", "Baseline to cam1", "110.000 ± 0.025 mm",
        "Hold the board into the lower left corner",
        "Corners in the image", "cam0 in the lower left; cam1 in the lower left", "Mean residual over the image",
        "Uncertainty of the projection", "pinhole-radtan, 752 x 480 px", "sees 93.02° across", "k1",
        "The rig", "cam1 against cam0", "T_cam_cam0 of cam1", "Distance from epipolar lines", "Can it be trusted?",
        "each of 40 clusters of 0.5 s", "Corners of cam0", "Views of cam0", "40 of 54 views were used",
        "Views that were not used", "fits badly as a whole", "Cameras around the board", "From above and from the side",
        "Tilt of the board", "From ray to pixel, cam0", "straightened",
        "Lens models tried on cam1", "pinhole-equidistant", "+60.0 %", "Board", "bow", "+0.800 ± 0.050 mm",
        "Correlation", "Strongest correlations", "The solver came to rest", "What was assumed",
        "the board is as large as its file says", "gnomon camera-imu RECORDING --cam calibration.yaml",
        "cv2.undistort(image, K, d)", "cv2.remap", "T_cn_cnm1", "Provenance", "method", "camera",
    ]  # fmt: skip
    place = 0
    for words in order:
        assert words in text[place:], words
        place = text.index(words, place)
    assert page.tags.count("h1") == 1
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link.startswith(("#", "data:"))
        assert link in ("data:,", "#") or link[1:] in page.ids
    raw = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.findall(r"https?://[^\s\"']+", raw)
    assert all(target.lstrip("#") in page.ids for target in re.findall(r"url\(([^)]*)\)", raw))
    assert not re.search(r"\bnan\b|\binf\b|m/s²", text)
    assert len(raw) < 700_000


@pytest.mark.parametrize("model", list(LENSES))
@pytest.mark.parametrize("cameras", [1, 3])
def test_every_lens_and_number_of_cameras(page_of, model, cameras):
    text = page_of(make_cameras_result(model=model, cameras=cameras, used=15, held=4)).text
    assert ("Field of view" in text) == (cameras == 1)
    assert ("cam2 against cam0" in text) == (cameras == 3)
    assert ("In OpenCV" in text) == (model != "ds-none")
    assert not re.search(r"\bnan\b|\binf\b", text)


def test_same_result_gives_same_bytes(tmp_path):
    for name in "ab":
        write_report(make_cameras_result(used=10, held=3), tmp_path / f"{name}.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_many_views_stay_small_and_quick(tmp_path):
    many = make_cameras_result(used=150, held=100)
    start = time.process_time()
    write_report(many, tmp_path / "r.html")
    assert time.process_time() - start < 4.0  # 0.6 s where nothing else runs
    assert (tmp_path / "r.html").stat().st_size < 800_000


def test_what_is_missing_is_left_out(page_of, result):
    bare = make_cameras_result(cameras=1, used=6, held=0, trust=False, trials=False, bow_m=0.0)
    text = page_of(bare).text
    assert "no view was held out" in text
    assert "Can it be trusted?" not in text
    assert "Lens models tried" not in text
    assert "taken as stated: flat" in text
    assert "Where the points of the board are" not in text
    empty = with_diagnostics(result, corners={}, views=(), coverage={}, parameters=(), correlation=np.empty((0, 0)))
    text = page_of(empty).text
    assert "Cameras around the board" not in text
    assert "From ray to pixel" in text


def test_given_lenses_have_no_uncertainty(page_of, result):
    text = page_of(without_lens_covariance(result)).text
    assert "given, not estimated" in text
    assert "Uncertainty of the projection" not in text
    assert "The lens was given; no σ is known." in text
    assert not re.search(r"\bnan\b", text)


def test_markup_in_names_is_shown_and_not_run(page_of, tmp_path):
    evil = "<script>alert(1)</script>&\"'"
    hostile = make_cameras_result(used=8, held=2, names=(evil,))
    fit = hostile.diagnostics.corners["cam0"]
    reasons = tuple(reason and f"{reason} {evil}" for reason in fit.frame_reason)
    corners = {**hostile.diagnostics.corners, "cam0": replace(fit, frame_reason=reasons)}
    trials = tuple(replace(trial, model=evil) for trial in hostile.diagnostics.trials)
    page = page_of(with_diagnostics(hostile, corners=corners, trials=trials))
    assert page.tags.count("script") == 1
    assert page.text.count(evil) > 5
    raw = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in raw


# ---- numbers ----


def best_turn(camera, other, rays):
    """Return images of rays in another lens after the turn of the camera that fits best, by iteration."""
    pixels = camera.project(rays).pixels
    R = np.eye(3)
    for _ in range(4):
        turned = rays @ R.T
        image = other.project(turned)
        x, y, z = turned.T
        o = np.zeros_like(x)
        cross = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
        slopes = -image.by_point @ cross
        step, *_ = np.linalg.lstsq(slopes.reshape(-1, 3), (pixels - image.pixels).ravel(), rcond=None)
        R = rotation_from_rotvec(step) @ R
    return other.project(rays @ R.T).pixels - pixels


@pytest.mark.parametrize("model", list(LENSES))
def test_uncertainty_of_the_projection_is_that_of_drawn_lenses(model):
    result = make_cameras_result(model=model, cameras=1, used=20, held=0, hidden=False)
    camera = result.calibration.cameras["cam0"].camera
    covariance = lens_covariance(result.calibration, "cam0")
    width, height = camera.resolution
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 80), np.linspace(0, height - 1, 60)), -1).reshape(-1, 2)
    rays, valid = camera.unproject(grid)
    spread = projection_spread(camera, covariance, grid[valid])  # corners wherever there are rays
    middle = spread.corner + np.array(spread.size) / 2
    known = np.isfinite(spread.sigma)
    rays, _ = camera.unproject(middle[known])
    rng = np.random.default_rng(4)
    draws = rng.multivariate_normal(camera.parameters, covariance, 160)
    off = np.array([best_turn(camera, camera.with_parameters(draw), rays) for draw in draws])
    fixed = np.array([camera.with_parameters(draw).project(rays).pixels for draw in draws]) - middle[known]
    for found, drawn in ((spread.sigma, off), (spread.fixed, fixed)):
        truth = np.sqrt(np.nanmean(drawn**2, axis=(0, 2)))
        assert found[known] == pytest.approx(truth, rel=0.25)
        assert np.median(found[known] / truth) == pytest.approx(1.0, abs=0.08)


def test_a_turn_of_the_camera_is_no_uncertainty():
    """A principal point that may be anywhere moves a narrow image, but hardly the directions between its pixels."""
    camera = Camera(projection="pinhole", intrinsics=[5000, 5000, 320, 240], distortion="none", distortion_coeffs=[],
                    resolution=(640, 480))  # fmt: skip
    pixels = np.random.default_rng(0).uniform((0, 0), (639, 479), (4000, 2))
    spread = projection_spread(camera, np.diag([0, 0, 9.0, 9.0]), pixels)
    assert spread.fixed == pytest.approx(3.0)
    assert np.nanmax(spread.sigma) < 0.03
    assert spread.seen.all()


def test_cells_without_corners_are_told(result):
    camera = result.calibration.cameras["cam0"].camera
    spread = projection_spread(camera, lens_covariance(result.calibration, "cam0"), used_pixels(result))
    middle = spread.corner + np.array(spread.size) / 2
    hidden = (middle[:, 0] < 190) & (middle[:, 1] > 350)
    assert not spread.seen[hidden].any()
    assert spread.seen[~hidden].mean() > 0.9
    assert np.median(spread.sigma[hidden]) > 1.3 * np.median(spread.sigma[~hidden])


def test_radial_curve_is_the_lens(result):
    camera = LENSES["pinhole-radtan"]
    covariance = lens_covariance(result.calibration, "cam0")
    curve = radial_curve(camera, covariance, used_pixels(result))
    r = np.tan(curve.angle)
    k1, k2 = camera.distortion_coeffs[:2]
    expected = r * (1 + k1 * r**2 + k2 * r**4) * np.mean(camera.intrinsics[:2])
    assert curve.radius == pytest.approx(expected, rel=2e-3)
    rng = np.random.default_rng(2)
    drawn = rng.multivariate_normal(camera.parameters, covariance, 60)
    radii = np.array([radial_curve(camera.with_parameters(p), covariance, np.empty((0, 2))).focal for p in drawn])
    assert radii.std() == pytest.approx(curve.sigma[1] / curve.angle[1], rel=0.35)
    corner, _ = camera.unproject(used_pixels(result))
    assert curve.reach == pytest.approx(np.arccos(corner[:, 2]).max(), abs=1e-9)


def test_field_of_view_of_a_pinhole():
    camera = Camera(projection="pinhole", intrinsics=[300, 200, 299.5, 199.5], distortion="none", distortion_coeffs=[],
                    resolution=(600, 400))  # fmt: skip
    assert field_of_view(camera) == pytest.approx((2 * np.arctan(299.5 / 300), 2 * np.arctan(199.5 / 200)))
    lines = undistorted_grid(camera)
    assert all(np.ptp(line, axis=0).min() < 1e-9 for line in lines)  # rows and columns stay straight
    ends = np.concatenate(lines)
    assert (ends.min(axis=0), ends.max(axis=0)) == (pytest.approx([0, 0]), pytest.approx([599, 399]))


def test_epipolar_errors_are_the_noise_of_two_corners(result):
    errors = epipolar_errors(result.calibration, result.diagnostics.corners, "cam0", "cam1")
    assert len(errors.error) > 4000
    assert errors.typical_used == pytest.approx(np.sqrt(2) * PIXEL_SIGMA, rel=0.05)
    # A camera that is turned about its own x axis by a milliradian moves the lines by half a pixel.
    cam1 = result.calibration.cameras["cam1"]
    T = cam1.T_cam_body.copy()
    T[:3] = rotation_from_rotvec(np.array([1e-3, 0, 0])) @ T[:3]
    wrong = {**result.calibration.cameras, "cam1": replace(cam1, T_cam_body=T)}
    off = epipolar_errors(replace(result.calibration, cameras=wrong), result.diagnostics.corners, "cam0", "cam1")
    assert 0.4 < np.abs(np.mean(off.error)) < 0.75


def test_baseline_is_right_and_so_is_its_sigma(result):
    calibration = result.calibration
    values, sigmas = pose_numbers(calibration, "cam1")
    path = "cam1.T_cam_cam0"
    covariance = calibration.covariance(f"{path}.rotation", f"{path}.translation")
    rng = np.random.default_rng(1)
    T = calibration.cameras["cam1"].T_cam_body
    drawn = rng.multivariate_normal(np.zeros(6), covariance, 5000)
    R = T[:3, :3] @ rotation_from_rotvec(drawn[:, :3])
    t = T[:3, 3] + drawn[:, 3:]
    turn = np.degrees(rotvec_from_rotation(R))
    place = -1e3 * np.einsum("nji,nj->ni", R, t)
    sample = np.column_stack([place, np.linalg.norm(place, axis=1), turn, np.linalg.norm(turn, axis=1)])
    assert values == pytest.approx(sample.mean(axis=0), abs=0.2 * sigmas.min() + 1e-3)
    assert sigmas == pytest.approx(sample.std(axis=0), rel=0.06)


def view(p, R=None, information=float("nan")):
    R = np.diag([1.0, -1.0, -1.0]) if R is None else R
    return ViewPose(t_ns=0, cameras=("cam0",), R_target_cam0=R, p_target_cam0=np.array(p), information=information)


def test_views_from_straight_ahead_and_from_the_right():
    middle = BOARD.points.mean(axis=0)
    turn = rotation_from_rotvec(np.array([0, np.radians(30), 0]))  # the camera goes to +x and looks back
    straight = view(middle + np.array([0, 0, 1.0]), information=0.1)
    right = view(middle + turn @ np.array([0, 0, 2.0]), turn @ np.diag([1.0, -1.0, -1.0]), information=3.0)
    around = views_around((straight, right), BOARD.points)
    assert np.degrees(around.tilt) == pytest.approx([0, 30])
    assert np.degrees(around.seen_from[1]) == pytest.approx([30, 0], abs=1e-9)
    assert around.distance == pytest.approx([1, 2])
    assert around.telling.tolist() == [True, True]
    # A board whose z points into the wall gives the same drawing.
    flip = np.diag([1.0, -1.0, -1.0])
    flipped = [view(flip @ v.p_target_cam0, flip @ v.R_target_cam0, v.information) for v in (straight, right)]
    other = views_around(flipped, BOARD.points @ flip)
    assert other.position == pytest.approx(around.position)
    assert other.tilt == pytest.approx(around.tilt)


def test_places_without_corners_are_named():
    count = np.ones((8, 10))
    assert unseen_places(count) == []
    count[6:, :3] = 0
    assert [name for _, name in unseen_places(count)] == ["lower left"]
    count[:2, 8:] = 0
    assert {name for _, name in unseen_places(count)} == {"lower left", "upper right"}
    assert len(unseen_places(np.zeros((8, 10)))) == 3


def test_views_that_are_not_needed_are_not_called_bad(result):
    groups = view_groups(result.diagnostics.corners["cam0"])
    assert {key: int(found.sum()) for key, found in groups.items()} == {"used": 40, "spare": 12, "bad": 2}


def test_board_tells_size_and_direction(result):
    fit = result.calibration.assessment.cameras
    figure, table = board_section(fit, result.diagnostics).blocks
    assert "up to 0.8 mm" in figure.caption
    assert dict(row[:2] for row in table.rows)["largest shift out of it"] == "0.8\u00a0mm"
    shifts = np.zeros_like(BOARD.points)
    shifts[0] = (1e-3, 0, 0)
    figure, _ = board_section(fit, replace(result.diagnostics, board_shifts=shifts)).blocks
    assert "Arrows are 20 times as long" in figure.caption


def test_correlated_parameters_are_named(result, page_of):
    covariance = result.calibration.uncertainty
    assert isinstance(covariance, Covariance)
    text = page_of(result).text
    assert "cam0.intrinsics[0] cam0.intrinsics[1]" in text


def test_focal_length_at_the_axis_is_that_of_the_image():
    for camera in LENSES.values():
        focal = focal_at_axis(camera)
        small = 1e-6
        images = camera.project(np.array([[0, 0, 1.0], [small, 0, 1.0], [0, small, 1.0]])).pixels
        assert np.diag(images[1:] - images[0]) / small == pytest.approx(focal, rel=1e-5)
    assert focal_at_axis(LENSES["pinhole-radtan"]) == pytest.approx([458.65, 457.3])


def test_a_simulated_calibration(page_of):
    """What the recipe hands on is what the report takes: views that were not needed too."""
    made = simulate_cameras(CamerasScenario(views=12), 2)
    options = CameraOptions(model=("pinhole-radtan",), board="stated", views=8)
    found = calibrate_cameras(made.recording, made.target, options)
    text = page_of(found).text
    assert "8 of 12" in text
    for words in (
        "Views that were not used",
        "tells nothing that others do not",
        "Field of view",
        "Tilt of the board",
    ):
        assert words in text, words
    assert not re.search(r"\bnan\b|\binf\b", text)
    groups = view_groups(found.diagnostics.corners["cam0"])
    assert groups["used"].sum() == 8
    assert groups["spare"].sum() == 4
