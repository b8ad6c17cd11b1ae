"""Boards in images that gnomon did not render: those of EuRoC, and of another renderer with exact corners."""

import cv2
import numpy as np
import pytest

from detection import Score, with_truth
from gnomon.detect.boards.aprilgrid import detect_aprilgrid
from gnomon.detect.boards.checkerboard import detect_checkerboard
from gnomon.formats.kalibr.target import read_target

KALIBR = {"recall": 0.97, "rms": (0.0435, 0.034)}
"""Kalibr's extraction on the same images: tags found, errors in u and v [px]."""

RENDERED = {
    "a-aprilgrid-full": (detect_aprilgrid, 800),
    "d-checkerboard-ideal-imu": (detect_checkerboard, 252),
}
"""The six images of a recording: what finds their board, and how many corners it has to find."""

EUROC = {
    "cam0": ([458.654, 457.296, 367.215, 248.375], [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
    "cam1": ([457.587, 456.134, 379.999, 255.238], [-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05]),
}
"""What was published of the lenses: intrinsics and distortion."""


@pytest.mark.parametrize("name", RENDERED)
def test_rendered_images_of_another_program(real_data, name):
    folder = real_data(f"rendered-camimu/{name}")
    target = read_target(folder / "target.yaml", [])
    detect, corners = RENDERED[name]
    score = Score()
    for truth in with_truth(folder / "images", target):
        score.add(truth, detect(truth.image, target))
    assert score.images == 6
    assert len(score.error) >= corners
    assert score.recall == score.corner_recall == 1.0 > KALIBR["recall"]
    assert score.wrong == 0
    assert (score.rms < 0.02).all()
    assert (score.rms < KALIBR["rms"]).all()
    assert np.abs(score.bias).max() < 0.003
    assert 0.7 < score.z_rms < 1.3  # the errors are what the detector says of them


@pytest.mark.parametrize("camera", EUROC)
def test_both_images_of_euroc(real_data, camera):
    """Every tag, and every corner where the published lens and one pose of the board have it."""
    folder = real_data("euroc-cam-april")
    target = read_target(real_data("rendered-camimu") / "a-aprilgrid-full" / "target.yaml", [])
    image = cv2.imread(str(folder / f"{camera}_1403709395937837056.png"), cv2.IMREAD_GRAYSCALE)
    view = detect_aprilgrid(image, target)
    np.testing.assert_array_equal(view.point, np.arange(144))
    assert dict(view.dropped) == {}
    (fu, fv, pu, pv), distortion = EUROC[camera]
    lens = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]), np.array(distortion)
    _, turn, place = cv2.solvePnP(target.points, view.pixels, *lens)
    error = view.pixels - cv2.projectPoints(target.points, turn, place, *lens)[0][:, 0]
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert np.abs(error).max() < 0.6
