"""The report's section on the images, and the same numbers in diagnostics.npz."""

import re
from dataclasses import replace

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from gnomon.report.camera_images import images_section
from gnomon.report.page import write_report
from gnomon.results.result import Result, save_diagnostics


@pytest.fixture(scope="module")
def result():
    return make_camera_imu_result(images=True, cameras=2, duration_s=30)


def with_corners(result, change) -> Result:
    corners = {name: change(fit) for name, fit in result.diagnostics.corners.items()}
    return replace(result, diagnostics=replace(result.diagnostics, corners=corners))


def test_section(result) -> None:
    section = images_section(result.diagnostics.corners)
    assert [block.title for block in section.blocks] == [
        "Images of cam0",
        "How certain the corners of cam0 are",
        "Images of cam1",
        "How certain the corners of cam1 are",
        "In numbers",
        "Corners that were found and left out",
    ]
    numbers, dropped = section.blocks[-2:]
    quality = result.diagnostics.corners["cam0"].quality
    assert numbers.rows[0][2] == f"{np.nanmedian(quality.blur_px):.2f} px"
    kept = len(result.diagnostics.corners["cam0"].frame)
    assert dropped.rows[0][:2] == ("cam0: blurred", "2310")
    assert float(dropped.rows[0][2].removesuffix(" %")) == pytest.approx(100 * 2310 / (kept + 3162), rel=0.05)
    assert not any("of another board" in row[0] for row in dropped.rows)
    assert sum(len(block.svg) for block in section.blocks if block.kind == "figure") < 300_000


def test_sigma_of_the_detector_against_residuals(result) -> None:
    def honest(fit):
        rng = np.random.default_rng(1)
        sigma = rng.uniform(0.02, 0.2, len(fit.frame))
        return replace(fit, corner_sigma_px=sigma, residual=rng.normal(0, 1, fit.residual.shape) * 2 * sigma[:, None])

    section = images_section(with_corners(result, honest).diagnostics.corners)
    caption = section.blocks[1].caption
    assert float(re.search(r"Residuals are ([\d.]+) times", caption)[1]) == pytest.approx(2, abs=0.1)


def test_no_section_without_images() -> None:
    assert images_section(make_camera_imu_result(duration_s=10).diagnostics.corners) is None


def test_board_never_found_and_no_sigma(result, tmp_path) -> None:
    def nothing(fit):
        none = np.full(len(fit.frame_t_s), np.nan)
        return replace(
            fit, corner_sigma_px=None, quality=replace(fit.quality, blur_px=none, black=none, white=none, dropped={})
        )

    odd = with_corners(result, nothing)
    section = images_section(odd.diagnostics.corners)
    assert [block.title for block in section.blocks] == ["Images of cam0", "Images of cam1", "In numbers"]
    write_report(odd, tmp_path / "report.html")


def test_page(result, tmp_path) -> None:
    write_report(result, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert '<section id="images"' in page
    assert page.index('id="residuals"') < page.index('id="images"') < page.index('id="coverage"')
    assert len(page) < 2_000_000


def test_diagnostics_file(result, tmp_path) -> None:
    save_diagnostics(result.diagnostics, tmp_path / "diagnostics.npz")
    fit = result.diagnostics.corners["cam1"]
    with np.load(tmp_path / "diagnostics.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["corners.cam1.quality.blur_px"], fit.quality.blur_px, equal_nan=True)
        assert np.allclose(arrays["corners.cam1.corner_sigma_px"], fit.corner_sigma_px, rtol=1e-7, atol=0)
        assert arrays["corners.cam1.quality.dropped.blurred"] == 2310
    save_diagnostics(make_camera_imu_result(duration_s=5).diagnostics, tmp_path / "corners.npz")
    with np.load(tmp_path / "corners.npz", allow_pickle=False) as arrays:
        assert not [name for name in arrays if "quality" in name]
