"""The report of a camera-IMU calibration: complete, right in its numbers, small, whatever is missing."""

import re
import time
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from camera_imu_result import C_GYRO_IMU, G_SENSITIVITY, GYRO_SENSITIVITY, T_CAM_IMU, make_camera_imu_result
from gnomon.cli.results import held_lines
from gnomon.findings import Finding
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.report.camera_imu.page import imu_section
from gnomon.report.camera_imu.signals import rig_motion, signal_name, telling_section
from gnomon.report.corners import corner_view, draw_residual_field, field_magnification
from gnomon.report.page import write_report
from gnomon.report.rig_parameters import (
    NOT_ABOVE,
    baseline_groups,
    camera_groups,
    imu_groups,
    mounting_text,
    nominal_mounting,
    other_reading,
)
from gnomon.report.trust import every_parameter
from gnomon.results.calibration import Covariance
from gnomon.results.camera_diagnostics import SceneMap, SignalFit
from html_page import Page


@pytest.fixture(scope="module")
def result():
    return make_camera_imu_result(cameras=2, gap_s=(20.0, 23.0))


@pytest.fixture(scope="module")
def short():
    """A short result, which is drawn quickly: to be changed by a test."""
    return make_camera_imu_result(duration_s=8.0)


@pytest.fixture
def page_of(tmp_path):
    def make(result):
        path = tmp_path / "report.html"
        write_report(result, path)
        return Page(path.read_text(encoding="utf-8"))

    return make


def with_diagnostics(result, **changes):
    return replace(result, diagnostics=replace(result.diagnostics, **changes))


def value_of(text):
    """Return the number that a page shows."""
    mantissa, _, power = text.replace("−", "-").partition("·10")
    digits = power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-"))
    return float(mantissa) * 10.0 ** int(digits or 0)


def shown(groups, title):
    """Return the values and the sigmas of one group."""
    rows = next(group for group in groups if group.title == title).rows
    return np.array([value_of(row.value) for row in rows]), np.array([value_of(row.sigma) for row in rows])


def test_page_says_the_verdict_first_and_everything_once(result, page_of, tmp_path):
    page = page_of(result)
    text = page.text
    order = [
        "Camera-IMU calibration", "Warn. This calibration can be used", "0.126 px", "2258 of 2394",
        "7.0500 ± 0.0060 ms", "60 s in 2 pieces", "Move faster", "Corners of cam0", "Corners in the image",
        "The rig", "T_cam_imu of cam0", "T_cam_imu of cam1",
        "Between the cameras", "Accelerometer scale", "0.98860 ± 0.00030", "Gyroscope rotation",
        "body frame (Krebs, chapter 4)", "q_bg = (0.999962, 0.000000, 0.000000, 0.008727)",
        "force in the gyroscope's axes (Krebs, chapter 3)",
        "Accelerometer over the recording", "Gyroscope over the recording", "models differ by up to",
        "Frames of cam1", "Mean residual over the image", "Samples of the IMU",
        "fits badly: 47 sigma", "Axes of rotation", "Path of the IMU", "About their means",
        "imu0.B_g[4]", "Correlation", "Strongest correlations", "found in the residuals",
        "Gravity in the frame of the target", "−9.79110 ± 0.00010", "rejected", "The solver came to rest",
        "What was assumed", "columns as in the EuRoC data set", "held by assumption: imu0.B_g[4]",
        "camchain-imucam.yaml", 'gnomon.load("calibration.yaml")', "Provenance", "model = full",
    ]  # fmt: skip
    place = 0
    for words in order:
        assert words in text[place:], words
        place = text.index(words, place)
    assert page.tags.count("h1") == 1
    assert text.count("columns as in the EuRoC data set") == 1
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link.startswith(("#", "data:"))
        assert link in ("data:,", "#") or link[1:] in page.ids
    raw = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\s\"']+", raw)) <= {"http://www.w3.org/1999/xlink"}
    assert all(target.lstrip("#") in page.ids for target in re.findall(r"url\(([^)]*)\)", raw))
    assert "#c0de" not in raw
    assert not re.search(r"\bnan\b|\binf\b", text)
    assert len(raw) < 1_300_000


def test_same_result_gives_same_bytes(short, tmp_path):
    write_report(short, tmp_path / "a.html")
    write_report(make_camera_imu_result(duration_s=8.0), tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_long_recording_stays_small_and_quick(tmp_path):
    long = make_camera_imu_result(duration_s=1800.0, frames_hz=4.0)
    assert len(long.diagnostics.signals["imu0.gyroscope"].t_s) == 360_000
    start = time.process_time()
    write_report(long, tmp_path / "r.html")
    assert time.process_time() - start < 8.0  # 2.5 s where nothing else runs
    assert (tmp_path / "r.html").stat().st_size < 2_000_000


@pytest.fixture(scope="module")
def uncertain(result):
    """The calibration of two cameras with a full covariance, so that every correlation counts."""
    calibration = result.calibration
    sigma = np.sqrt(np.diag(calibration.uncertainty.matrix))
    root = np.random.default_rng(2).normal(size=(len(sigma), len(sigma)))
    matrix = (root @ root.T) / len(sigma) * sigma[:, None] * sigma
    return replace(calibration, uncertainty=Covariance(names=calibration.uncertainty.names, matrix=matrix))


def drawn_poses(calibration, count=4000):
    """Draw T_cam_imu of both cameras from their joint covariance, (count, 2, 4, 4)."""
    paths = [f"cam{i}.T_cam_imu.{part}" for i in range(2) for part in ("rotation", "translation")]
    rng = np.random.default_rng(3)
    delta = rng.multivariate_normal(np.zeros(12), calibration.covariance(*paths), count).reshape(count, 2, 6)
    poses = np.tile(np.eye(4), (count, 2, 1, 1))
    for i in range(2):
        T = calibration.cameras[f"cam{i}"].T_cam_imu
        poses[:, i, :3, :3] = T[:3, :3] @ rotation_from_rotvec(delta[:, i, :3])
        poses[:, i, :3, 3] = T[:3, 3] + delta[:, i, 3:]
    return poses


def agree(shown_pair, samples):
    """Compare values and sigmas of a page with a sample (n, 3)."""
    values, sigmas = shown_pair
    assert values[: samples.shape[1]] == pytest.approx(samples.mean(axis=0), abs=0.1 * sigmas.max())
    assert sigmas[: samples.shape[1]] == pytest.approx(samples.std(axis=0), rel=0.07)


def test_extrinsics_are_right_and_so_are_their_sigmas(uncertain):
    groups = camera_groups(uncertain, "cam1")
    poses = drawn_poses(uncertain)[:, 1]
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    nominal = nominal_mounting(T_CAM_IMU[1][:3, :3])
    agree(shown(groups, "Attitude"), np.degrees(rotvec_from_rotation(nominal.T @ R)))
    agree(shown(groups, "Translation"), 1e3 * t)
    agree(shown(groups, "Position"), -1e3 * np.einsum("nji,nj->ni", R, t))
    shift, sigma = shown(groups, "Time")
    assert shift == pytest.approx([7.12])
    assert sigma == pytest.approx(1e3 * uncertain.sigma("cam1.time_shift_cam_imu"), rel=0.05)


def test_what_the_recording_does_not_determine_is_marked(result):
    assert result.calibration.assessment.held_by_prior == ("imu0.B_g[4]",)
    groups = imu_section(result.calibration).blocks[0].groups
    marked = [group.title for group in groups if "not measured" in group.note]
    assert marked == ["Gyroscope g-sensitivity"]
    said = " ".join(" ".join(held_lines(result.calibration)).split())
    assert said.startswith("not measured imu0.B_g (at least in part): held by an assumption")


def test_baseline_is_right_and_so_is_its_sigma(uncertain, result):
    groups = baseline_groups(uncertain, result.diagnostics.baselines)
    poses = drawn_poses(uncertain)
    T = poses[:, 1] @ np.linalg.inv(poses[:, 0])
    translation = 1e3 * T[:, :3, 3]
    distance = np.linalg.norm(translation, axis=1, keepdims=True)
    agree(shown(groups, "cam1 against cam0"), np.concatenate([translation, distance], axis=1))
    agree(shown(groups, "Rotation"), np.degrees(rotvec_from_rotation(np.ascontiguousarray(T[:, :3, :3]))))


def test_baseline_of_unknown_cameras_is_left_out(uncertain):
    assert baseline_groups(uncertain, {"cam7_cam0": np.eye(4)}) == ()


@pytest.mark.parametrize("seed", range(5))
def test_mounting_is_the_nearest_of_all_axis_aligned_rotations(seed):
    rng = np.random.default_rng(seed)
    turned = rotation_from_rotvec(rng.uniform(-3, 3, 3))
    found = nominal_mounting(turned)
    assert np.linalg.det(found) == pytest.approx(1.0)
    assert (np.abs(found).sum(axis=0) == 1).all()
    # No rotation lies farther from the 24 than 62.8 deg, the angle to a cube's corner cell.
    assert np.linalg.norm(rotvec_from_rotation(found.T @ turned)) < np.radians(62.81)
    slightly = found @ rotation_from_rotvec(rng.uniform(-0.2, 0.2, 3))
    assert (nominal_mounting(slightly) == found).all()


def test_mounting_reads_as_the_directions_of_the_camera_axes():
    assert mounting_text(T_CAM_IMU[0][:3, :3]) == "camera x, y, z along −y, −z, +x of the IMU"


def test_imu_in_the_letters_of_document_b(result):
    groups = imu_groups(result.calibration, "imu0")
    assert shown(groups, "Accelerometer scale")[0] == pytest.approx([1.001, 1.0008, 0.9886], abs=1e-6)
    yz, zy, zx = shown(groups, "Accelerometer misalignment")[0]
    assert [yz, zy, zx] == pytest.approx([1e3 * 0.0052 / 1.0008, -1.7 / 0.9886, 2.6 / 0.9886], abs=0.01)
    assert shown(groups, "Gyroscope scale")[0] == pytest.approx(np.diag(GYRO_SENSITIVITY), abs=1e-5)
    assert shown(groups, "Gyroscope misalignment")[0] == pytest.approx(
        [3.5 / 0.999, -2.6 / 1.0011, 16.4 / 1.0011], abs=0.01
    )
    assert shown(groups, "Gyroscope rotation")[0] == pytest.approx([0, 0, 1], abs=1e-4)
    assert shown(groups, "Gyroscope g-sensitivity")[0] == pytest.approx(1e3 * G_SENSITIVITY.ravel(), abs=1e-3)
    rows = other_reading(result.calibration, "imu0").rows
    chapter3 = np.array([[value_of(cell.split(" ± ")[0]) for cell in row[1:]] for row in rows])
    assert chapter3 == pytest.approx(1e3 * G_SENSITIVITY @ C_GYRO_IMU.T, abs=1e-3)


def test_sigmas_of_the_gyroscope_follow_from_the_covariance(uncertain):
    groups = imu_groups(uncertain, "imu0")
    path = "imu0.gyroscope.sensitivity"
    S = uncertain.parameter(path)
    rng = np.random.default_rng(5)
    samples = S + rng.multivariate_normal(np.zeros(9), uncertain.covariance(path), 3000).reshape(-1, 3, 3)
    lower, rotation = np.empty((3000, 3, 3)), np.empty((3000, 3))
    for k, matrix in enumerate(samples):
        gram = matrix @ matrix.T  # = L L', L lower triangular
        lower[k] = np.linalg.cholesky(gram)
        rotation[k] = np.degrees(rotvec_from_rotation((np.linalg.inv(lower[k]) @ matrix).T))
    agree(shown(groups, "Gyroscope scale"), np.diagonal(lower, axis1=1, axis2=2))
    unit = lower / np.diagonal(lower, axis1=1, axis2=2)[:, :, None]
    agree(shown(groups, "Gyroscope misalignment"), 1e3 * unit[:, [1, 2, 2], [0, 0, 1]])
    agree(shown(groups, "Gyroscope rotation"), rotation)


def test_entries_not_above_their_sigma_are_marked(result):
    """Rule B16 of Krebs: q_bg about x and y are zero, and B_g yy is half its sigma."""
    groups = imu_groups(result.calibration, "imu0")
    marked = [f"{group.title}: {row.name}" for group in groups for row in group.rows if row.note == NOT_ABOVE]
    assert marked == [
        "Gyroscope rotation: about x",
        "Gyroscope rotation: about y",
        "Gyroscope g-sensitivity: y by force y",
    ]
    table = every_parameter(result.diagnostics)
    faint = {table.rows[i][0] for i in table.faint}
    assert {"imu0.q_bg[0]", "imu0.q_bg[1]", "imu0.B_g[4]", "gravity.magnitude", "cam0.intrinsics[2]"} <= faint
    assert not faint & {"imu0.S_a[0]", "imu0.M_g[2]", "gravity.direction[1]", "cam0.T_cam_imu.translation[1]"}
    statuses = {row[0]: row[-1] for row in table.rows}
    assert statuses["imu0.B_g[4]"] == "prior, ≤ σ"
    assert statuses["imu0.S_a[1]"] == "estimated"
    assert statuses["target.scale"] == "fixed"
    # The same scalars as deviations from one, as another parametrisation would have them.
    p = next(p for p in result.diagnostics.parameters if p.name == "imu0.S_a[0]")
    for value, weak in ((1.0 + 0.9 * p.sigma, True), (1.0 + 1.1 * p.sigma, False), (0.9 * p.sigma, True)):
        diagnostics = replace(result.diagnostics, parameters=(replace(p, value=value),))
        assert bool(every_parameter(diagnostics).faint) == weak


def test_freed_parameters_of_a_camera_are_shown(result):
    calibration = result.calibration
    sigma = dict(zip(calibration.uncertainty.names, np.diag(calibration.uncertainty.matrix), strict=True))
    for name in sigma:
        if name.startswith("cam0.intrinsics"):
            sigma[name] = 0.5**2
        if name == "cam0.line_delay":
            sigma[name] = (2e-7) ** 2
    matrix = np.diag(list(sigma.values()))
    camera = replace(calibration.cameras["cam0"].camera, line_delay_s=3e-5)
    cameras = {"cam0": replace(calibration.cameras["cam0"], camera=camera)}
    freed = replace(calibration, cameras=cameras, uncertainty=replace(calibration.uncertainty, matrix=matrix))
    lens = next(group for group in camera_groups(freed, "cam0") if group.title == "Lens")
    assert [row.name for row in lens.rows] == ["fu", "fv", "pu", "pv", "k1", "k2", "p1", "p2"]
    assert (lens.rows[0].value, lens.rows[0].sigma, lens.rows[0].unit) == ("460.00", "0.50", "px")
    assert lens.rows[4].unit == ""
    delay = next(row for group in camera_groups(freed, "cam0") for row in group.rows if row.name == "line delay")
    assert (delay.value, delay.sigma, delay.reads_as) == ("30.00", "0.20", "14.4 ms per image")
    assert not [g for g in camera_groups(calibration, "cam0") if g.title == "Lens"]


def _fit(basic=None, *, used=None):
    rng = np.random.default_rng(8)
    t = np.arange(0, 40, 0.005)
    predicted = np.sin(t)[:, None] * np.ones(3)
    measured = predicted + rng.normal(0, 0.01, predicted.shape)
    used = np.ones(len(t), dtype=bool) if used is None else used
    return SignalFit(
        t_s=t, measured=measured, predicted=predicted, basic=basic, used=used, sigma=0.01, unit="m/s^2"
    )  # fmt: skip


def test_section_is_where_the_models_differ_most():
    fit = _fit()
    basic = fit.predicted.copy()
    basic[(fit.t_s > 12.5) & (fit.t_s < 14.5), 2] += 0.02
    basic[(fit.t_s > 30.0) & (fit.t_s < 30.4), 2] += 0.03
    start, stop = telling_section(replace(fit, basic=basic))
    assert start == pytest.approx(12.5, abs=0.01)
    assert stop - start == pytest.approx(2.0)
    # What was not used does not count, nor what was not predicted.
    hidden = (fit.t_s > 12.0) & (fit.t_s < 15.0)
    basic[hidden] = np.nan
    assert telling_section(replace(fit, basic=basic))[0] == pytest.approx(29.4, abs=1.01)


def test_without_basic_model_the_section_is_where_the_model_fits_worst():
    fit = _fit()
    measured = fit.measured.copy()
    measured[(fit.t_s > 20) & (fit.t_s < 22), 0] += 0.02
    measured[1000] += 50.0  # one outlier does not decide
    start, _ = telling_section(replace(fit, measured=measured))
    assert start == pytest.approx(20.0, abs=0.2)


def test_without_basic_model(short, page_of):
    assert "basic model" in page_of(short).text
    page = page_of(make_camera_imu_result(duration_s=8.0, basic=False))
    assert "basic model" not in page.text
    assert "the model fits worst" in page.text
    assert "models differ" not in page.text


def test_basic_model(page_of):
    page = page_of(make_camera_imu_result(duration_s=8.0, model="basic", basic=False))
    assert "only the biases were estimated" in page.text
    assert "Gyroscope bias" in page.text
    for absent in ("Gyroscope scale", "Gyroscope rotation", "g-sensitivity b", "q_bg = ("):
        assert absent not in page.text
    assert NOT_ABOVE not in page.text
    assert "chapter 3" not in page.text
    assert "held by assumption" not in page.text


def test_groups_held_at_ideal_values_are_left_out(result):
    calibration = result.calibration
    imu = calibration.imus["imu0"]
    without = replace(imu, gyroscope=replace(imu.gyroscope, g_sensitivity=np.zeros((3, 3))))
    names = calibration.uncertainty.names
    free = np.array(["g_sensitivity" not in name for name in names], dtype=float)
    matrix = calibration.uncertainty.matrix * free[:, None] * free
    held = replace(calibration, imus={"imu0": without}, uncertainty=Covariance(names=names, matrix=matrix))
    titles = [group.title for group in imu_groups(calibration, "imu0")]
    assert [group.title for group in imu_groups(held, "imu0")] == titles[:-1]
    assert titles[-1] == "Gyroscope g-sensitivity"
    assert len(titles) == 8
    assert "What was held at an ideal sensor's value is left out." in imu_section(held).lead
    assert "left out" not in imu_section(calibration).lead
    assert other_reading(held, "imu0") is None


def test_corners_of_frames_left_out_do_not_count(short):
    fit = short.diagnostics.corners["cam0"]
    view = corner_view(fit)
    counted = sum(int(n) for n, used in zip(fit.frame_corners, fit.frame_used, strict=True) if used)
    assert len(view.residual) == counted < len(fit.residual)
    assert view.density.count.sum() == view.field.count.sum() == counted
    assert 4 * fit.sigma_px <= view.reach <= 6 * fit.sigma_px


def test_mean_residuals_belong_to_their_place_in_the_image(short):
    fit = short.diagnostics.corners["cam0"]
    right = fit.pixels[:, 0] > 320
    residual = np.where(right[:, None], [0.3, -0.1], [0.0, 0.2])
    view = corner_view(replace(fit, residual=residual, frame_used=np.ones_like(fit.frame_used)))
    centre = view.field.corner + np.array(view.field.size) / 2
    known = np.isfinite(view.field.mean).all(axis=1)
    assert known.sum() > 50
    for there, mean in zip(centre[known], view.field.mean[known], strict=True):
        if abs(there[0] - 319.5) > view.field.size[0]:
            assert mean == pytest.approx([0.3, -0.1] if there[0] > 319.5 else [0.0, 0.2])
    longer = field_magnification({"cam0": view})
    assert 0.5 * view.field.size[0] < longer * np.hypot(0.3, 0.1) < view.field.size[0]

    drawing = draw_residual_field({"cam0": view}).svg  # the bar above it is as long as an arrow of the length it tells
    told = re.search(r"arrow of ([\d.]+) px", drawing)
    bar = re.search(r'd="M([\d.]+) ([\d.]+) ([\d.]+) \2"', drawing)
    width = float(re.search(r'data-panel="\S+ \S+ (\S+)', drawing)[1])
    assert float(bar[3]) - float(bar[1]) == pytest.approx(longer * float(told[1]) * width / 640, rel=1e-3)


def test_motion_has_no_gravity_in_its_acceleration(short):
    """At rest, specific force is minus gravity, turned into the body frame."""
    diagnostics = short.diagnostics
    track, gravity = diagnostics.trajectory, diagnostics.gravity_target
    half_turn = np.tile([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], (len(track.t_ns), 1))  # x_body = -z_target
    force = np.tile(-np.array([-gravity[2], gravity[1], gravity[0]]), (len(track.t_ns), 1))
    motion = rig_motion(replace(track, q_target_imu_wxyz=half_turn, f_imu=force), gravity)
    assert np.abs(motion.acceleration).max() < 1e-12
    assert motion.rate[:, 1] == pytest.approx(np.degrees(track.omega_imu[:, 1]))


def test_strongest_correlations_come_first(short, page_of):
    free = [p.name for p in short.diagnostics.parameters if p.status != "fixed"]
    matrix = np.eye(len(free))
    for first, second, value in ((0, 5, 0.61), (9, 4, -0.97), (7, 8, 0.49)):
        matrix[first, second] = matrix[second, first] = value
    text = page_of(with_diagnostics(short, correlation=matrix)).text
    assert f"{free[4]} {free[9]} −0.970 {free[0]} {free[5]} 0.610 Noise" in text


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>&\"'{{ 7 * 7 }}", "</style><img src=x onerror=alert(1)>\udcff"]
)
def test_names_are_escaped_everywhere(page_of, name):
    finding = Finding(severity="problem", code="x", message=name, consequence=name, cure=name)
    result = make_camera_imu_result(duration_s=4.0, names=(name,), findings=(finding,))
    diagnostics = result.diagnostics
    corners = diagnostics.corners["cam0"]
    fit = replace(corners, frame_reason=(name,) * len(corners.frame_t_s))
    parameters = tuple(replace(p, name=name, unit=name) for p in diagnostics.parameters)
    noise = tuple(replace(level, name=name, unit=name) for level in diagnostics.noise)
    page = page_of(with_diagnostics(result, corners={"cam0": fit}, parameters=parameters, noise=noise))
    assert page.tags.count("script") == 1
    assert page.tags.count("style") == 1
    assert "img" not in page.tags
    assert page.text.count(name.encode("utf-8", "backslashreplace").decode()) > 40


def _blanked(value):
    """Return a frozen value with nan in all of its floating-point arrays and scalars."""
    changes = {}
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, np.ndarray) and part.dtype == np.float64:
            changes[field.name] = np.full_like(part, np.nan)
        elif isinstance(part, float):
            changes[field.name] = float("nan")
        elif isinstance(part, tuple) and part and is_dataclass(part[0]):
            changes[field.name] = tuple(_blanked(item) for item in part)
        elif isinstance(part, dict):
            changes[field.name] = {k: _blanked(v) if is_dataclass(v) else v * np.nan for k, v in part.items()}
        elif is_dataclass(part):
            changes[field.name] = _blanked(part)
    return replace(value, **changes)


def test_nothing_but_nan(page_of):
    result = make_camera_imu_result(duration_s=4.0, cameras=2)
    calibration = result.calibration
    nothing = np.full_like(calibration.uncertainty.matrix, np.nan)
    calibration = replace(calibration, uncertainty=replace(calibration.uncertainty, matrix=nothing))
    page = page_of(replace(result, calibration=calibration, diagnostics=_blanked(result.diagnostics)))
    assert not re.search(r"\bnan\b|\binf\b", page.text)
    assert not re.search(r"\bnan\b", " ".join(page.links))


def _emptied(value, kept):
    """Return a frozen value whose arrays have only so many rows."""
    return replace(value, **{
        field.name: getattr(value, field.name)[:kept]
        for field in fields(value)
        if isinstance(getattr(value, field.name), np.ndarray | tuple) and field.name != "resolution"
    })  # fmt: skip


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_next_to_nothing(short, page_of, kept):
    diagnostics = short.diagnostics
    fit = diagnostics.corners["cam0"]
    seen = fit.frame < kept
    corners = replace(
        _emptied(fit, kept), frame=fit.frame[seen], point=fit.point[seen], pixels=fit.pixels[seen],
        residual=fit.residual[seen], weight=fit.weight[seen],
    )  # fmt: skip
    page = page_of(
        with_diagnostics(
            short,
            signals={name: _emptied(signal, kept) for name, signal in diagnostics.signals.items()},
            biases={name: _emptied(bias, kept) for name, bias in diagnostics.biases.items()},
            corners={"cam0": corners},
            trajectory=_emptied(diagnostics.trajectory, kept),
            parameters=diagnostics.parameters[:kept],
            correlation=diagnostics.correlation[:kept, :kept],
            noise=(),
            steps=(),
        )
    )
    assert "What was assumed" in page.text


def test_nothing_used(short, page_of):
    diagnostics = short.diagnostics
    fit = diagnostics.corners["cam0"]
    corners = replace(fit, frame_used=np.zeros_like(fit.frame_used), frame_reason=("",) * len(fit.frame_t_s))
    signals = {k: replace(s, used=np.zeros_like(s.used)) for k, s in diagnostics.signals.items()}
    page = page_of(with_diagnostics(short, corners={"cam0": corners}, signals=signals))
    assert "no reason given" in page.text
    assert "0 of 160 frames were used" in page.text


def test_reasons_that_differ_in_numbers_share_a_row(short, page_of):
    fit = short.diagnostics.corners["cam0"]
    used = np.ones_like(fit.frame_used)
    used[[3, 5, 8]] = False
    reason = tuple("" if u else f"fits badly: {i}.5 sigma" for i, u in enumerate(used))
    changed = replace(fit, frame_used=used, frame_reason=reason)
    page = page_of(with_diagnostics(short, corners={"cam0": changed}))
    assert "cam0: fits badly: … sigma 3 0.18, 0.28, 0.43" in page.text


def test_a_solver_that_did_not_come_to_rest_is_said(short, page_of):
    calibration = short.calibration
    fit = replace(calibration.assessment.camera_imu, converged=False)
    assessment = replace(calibration.assessment, camera_imu=fit, verdict="fail")
    page = page_of(replace(short, calibration=replace(calibration, assessment=assessment)))
    assert "The solver did not come to rest." in page.text
    assert "Fail. Do not use this calibration." in page.text


def test_two_imus_are_told_apart():
    assert signal_name("imu0.gyroscope", ["imu0.accelerometer", "imu0.gyroscope"]) == "Gyroscope"
    assert signal_name("imu1.gyroscope", ["imu0.gyroscope", "imu1.gyroscope"]) == "Gyroscope of imu1"


def test_without_a_board_there_are_landmarks_and_a_map(short, page_of):
    count = 1 + max(int(fit.point.max()) for fit in short.diagnostics.corners.values())
    points = np.random.default_rng(3).uniform(-2, 2, (count, 3))
    scene = SceneMap(points=points, sigma=np.full((count, 3), 2e-3))
    before, after = (page_of(one).text for one in (short, with_diagnostics(short, scene=scene)))
    assert f"{count} landmarks stand in" in after
    assert "Landmarks in the image" in after
    assert "2 mm" in after.replace("\u00a0", " ")
    for word in ("Corners of cam0", "Corners in the image", "of those in which the board was found"):
        assert word in before
        assert word not in after
