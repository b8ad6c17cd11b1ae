"""The data doctor's look at images in which a board was sought: every fault by its code, good images have none."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.assess.checks.image_checks import (
    BLURRED_PX,
    BoardDetections,
    check_images,
    check_quality,
    check_sight,
    corner_boxes,
)
from gnomon.assess.checks.rig_streams import check_cameras
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.recording import CameraFrames, FrameQuality, Recording

BAD = {"warning", "problem"}
COUNT, CORNERS = 400, 24
BOARD = Target.aprilgrid(tag_cols=3, tag_rows=2, tag_size_m=0.08, tag_spacing=0.3)
CAMERA = Camera(
    projection="pinhole",
    intrinsics=[460, 458, 320, 240],
    distortion="none",
    distortion_coeffs=[],
    resolution=(640, 480),
)


def quality(**changes) -> FrameQuality:
    rng = np.random.default_rng(1)
    good = {
        "blur_px": rng.normal(0.65, 0.05, COUNT),
        "black": rng.normal(35, 3, COUNT),
        "white": rng.normal(190, 5, COUNT),
        "dropped": {"near the border": 40},
    }
    return FrameQuality(**{**good, **changes})


def camera(drift=0.2, **changes) -> CameraFrames:
    """Return frames of a board that swings from side to side, all of its points in each."""
    t = np.arange(COUNT) / 20
    left = 260 + 1000 * drift * np.sin(0.9 * t)
    board = 60 * (BOARD.points[:, :2] - BOARD.points[:, :2].mean(axis=0)) / 0.08
    pixels = np.stack([left, np.full(COUNT, 240.0)], axis=1)[:, None] + board
    return CameraFrames(
        t_ns=np.rint(t * 1e9).astype(np.int64),
        frame=np.repeat(np.arange(COUNT), CORNERS),
        point=np.tile(np.arange(CORNERS), COUNT),
        pixels=pixels.reshape(-1, 2),
        camera=CAMERA,
        sigma_px=np.full(COUNT * CORNERS, 0.04),
        quality=quality(**changes),
    )


def found(frames, seen=None):
    findings = check_images("cam0", frames, np.arange(COUNT) if seen is None else seen)
    for finding in findings:
        assert finding.severity not in BAD or (finding.consequence and finding.cure)
    return {finding.code: finding for finding in findings}


def share(portion, value, otherwise):
    """Return a value for the first part of the frames, and another for the rest."""
    return np.where(np.arange(COUNT) < portion * COUNT, value, otherwise)


def test_good_images() -> None:
    assert {code: finding.severity for code, finding in found(camera()).items()} == {"images": "good"}
    assert "blur 0.65 px" in found(camera())["images"].message
    assert "corners known to 0.04 px" in found(camera())["images"].message


def test_nothing_known_of_the_images() -> None:
    assert found(replace(camera(), quality=None)) == {}


def test_board_seen_nowhere() -> None:
    none = np.full(COUNT, np.nan)
    assert check_quality("cam0", quality(blur_px=none, black=none, white=none, dropped={}), 0, None) == []


@pytest.mark.parametrize(("portion", "severity"), [(0.5, "warning"), (0.1, "info")])
def test_motion_blur(portion, severity) -> None:
    blurred = found(camera(blur_px=share(portion, 2.4, 0.6)))
    assert blurred["motion-blur"].severity == severity
    assert f"{100 * portion:.0f} % of the images" in blurred["motion-blur"].message
    assert "the worst by 2.4 px; the sharpest by 0.6 px" in blurred["motion-blur"].message
    assert ("images" in blurred) == (severity == "info")


def test_some_blur_is_usual() -> None:
    assert "motion-blur" not in found(camera(blur_px=share(0.02, 2.4, 0.6)))
    assert "motion-blur" not in found(camera(blur_px=share(0.9, BLURRED_PX - 0.1, 0.6)))


def test_out_of_focus() -> None:
    assert list(found(camera(blur_px=np.full(COUNT, 2.1)))) == ["out-of-focus"]


@pytest.mark.parametrize(
    ("code", "changes"),
    [
        ("images-bright", {"white": share(0.4, 254.0, 200.0)}),
        ("images-dark", {"white": share(0.4, 45.0, 200.0), "black": np.full(COUNT, 12.0)}),
        ("images-flat", {"white": np.full(COUNT, 130.0), "black": share(0.4, 105.0, 30.0)}),
    ],
)
def test_exposure(code, changes) -> None:
    spoilt = found(camera(**changes))
    assert list(spoilt) == [code]
    assert spoilt[code].severity == "warning"
    assert "40 % of the images" in spoilt[code].message


@pytest.mark.parametrize(("count", "severity"), [(9000, "warning"), (1500, "info")])
def test_corners_dropped(count, severity) -> None:
    spoilt = found(camera(dropped={"near the border": 10, "blurred": count, "of nothing": 0}))
    assert spoilt["corners-dropped"].severity == severity
    assert f"{count + 10} of {count + 10 + COUNT * CORNERS} corners that were found were left out: {count} blurred, " \
        "10 near the border." in spoilt["corners-dropped"].message  # fmt: skip


def test_uncertain_corners() -> None:
    frames = replace(camera(), sigma_px=np.full(COUNT * CORNERS, 0.6))
    assert list(found(frames)) == ["corners-uncertain"]


# ---- where the board is ----


def without(frames, gone):
    kept = ~np.isin(frames.frame, gone)
    return replace(
        frames,
        frame=frames.frame[kept],
        point=frames.point[kept],
        pixels=frames.pixels[kept],
        sigma_px=frames.sigma_px[kept],
    )


def test_board_leaves_at_an_edge() -> None:
    frames = camera(drift=0.35)
    outside = np.flatnonzero((frames.pixels[:, 0] < 20).reshape(COUNT, CORNERS).any(axis=1))
    seen = np.setdiff1d(np.arange(COUNT), outside)
    assert 0.6 < len(seen) / COUNT < 0.9
    finding = found(without(frames, outside), seen)["board-rare"]
    assert finding.severity == "info"
    assert "at the left edge" in finding.message
    assert "away from the edges" not in finding.message


def test_board_vanishes_in_the_middle_by_blur() -> None:
    frames = camera(drift=0.05, blur_px=share(1.0, 1.9, 0.6))
    gone = np.flatnonzero(np.arange(COUNT) % 10 > 4)
    seen = np.setdiff1d(np.arange(COUNT), gone)
    finding = found(without(frames, gone), seen)["board-rare"]
    assert finding.severity == "warning"
    assert "the board is in 50 % of the images" in finding.message
    assert (
        "It was lost 40 times: 40 away from the edges, where the images were blurred by 1.9 px before"
        in finding.message
    )
    assert "expose shorter" in finding.cure


def test_sample_tells_no_edge() -> None:
    seen = np.arange(60) % 2 == 0
    sight = BoardDetections(
        t_ns=np.arange(60) * 10**9,
        seen=seen,
        box_px=np.where(seen[:, None], [5.0, 100.0, 200.0, 300.0], np.nan),
        blur_px=np.full(60, 0.6),
        resolution=(640, 480),
        consecutive=False,
    )
    (finding,) = check_sight("cam0", sight)
    assert finding.message == "cam0: the board is in 50 % of the images."
    assert "at the left edge" in check_sight("cam0", replace(sight, consecutive=True))[0].message


def test_boxes() -> None:
    pixels = np.array([[1.0, 2], [3, -1], [7, 7]])
    box = corner_boxes(np.array([1, 1, 3]), pixels, 4)
    assert np.isnan(box[[0, 2]]).all()
    assert box[[1, 3]].tolist() == [[1, -1, 3, 2], [7, 7, 7, 7]]
    assert np.isnan(corner_boxes(np.empty(0, np.int64), np.empty((0, 2)), 2)).all()


def test_part_of_the_checks_of_a_calibration() -> None:
    recording = Recording(imus={}, cameras={"cam0": camera(blur_px=np.full(COUNT, 2.1))})
    assert "out-of-focus" in {finding.code for finding in check_cameras(recording, BOARD)}
    few = without(camera(blur_px=np.full(COUNT, 2.1)), np.arange(5, COUNT))
    codes = [finding.code for finding in check_cameras(replace(recording, cameras={"cam0": few}), BOARD)]
    assert codes[:2] == ["frames-few", "out-of-focus"]  # what is wrong, and why
