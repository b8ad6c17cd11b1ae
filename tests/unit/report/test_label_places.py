"""Labels of drawings lie near what they name, and neither on lines nor on each other."""

import re
from itertools import pairwise

import numpy as np
import pytest

from gnomon.report.drawing.figures import TEXT
from gnomon.report.drawing.rig import LabelPlaces, half_size, rig_drawing
from gnomon.simulate import CameraImuScenario, simulate_camera_imu


def test_a_label_goes_where_nothing_is():
    line = np.array([[[0.0, 50.0], [200.0, 50.0]]])
    places = LabelPlaces(line, 200.0, 100.0)
    candidates = np.array([[100.0, 50.0], [100.0, 30.0], [100.0, 70.0], [195.0, 30.0], [50.0, 30.0]])
    assert places.take("cam0", candidates).tolist() == [100.0, 30.0]
    assert places.take("imu0", candidates).tolist() == [100.0, 70.0]
    assert places.take("imu1", candidates).tolist() == [50.0, 30.0]  # the other is half beyond the edge
    assert places.take_free("100 mm", candidates[:1]) is None
    assert places.take_free("100 mm", np.array([[50.0, 90.0]])).tolist() == [50.0, 90.0]


def texts_and_lines(svg):
    """Return the labels of a drawing with their centres, and points along all of its lines, a unit apart."""
    number = r"([\d.e-]+)"
    found = re.findall(rf'<text[^>]* x="{number}" y="{number}" dx="{number}em" dy="{number}em">([^<]+)</text>', svg)
    texts = [
        (text, np.array([float(x) + TEXT * float(dx), float(y) + TEXT * (float(dy) - 0.35)]))
        for x, y, dx, dy, text in found
    ]
    points = []
    for path in re.findall(r' d="(M[^"]+)"', svg):
        for piece in re.findall(r"M([\d. L-]+)", path):
            ends = np.array(re.findall(r"-?[\d.]+", piece), dtype=float).reshape(-1, 2)
            for a, b in pairwise(ends):
                points += [a + share * (b - a) for share in np.arange(0.0, 1.0, 1.0 / max(np.linalg.norm(b - a), 1.0))]
    return texts, np.array(points)


@pytest.mark.parametrize("seed", [0, 4, 9])
def test_labels_of_a_rig_can_be_read(seed):
    scenario = CameraImuScenario(duration_s=2.0, cameras=2, imus=3)
    texts, points = texts_and_lines(rig_drawing(simulate_camera_imu(scenario, seed).truth).svg)
    assert {text for text, _ in texts} >= {"imu0", "imu1", "imu2", "cam0", "cam1"}
    assert len(points) > 1500
    for k, (text, centre) in enumerate(texts):
        half = half_size(text) / 1.25
        covered = (np.abs(points - centre) < 0.8 * half).all(axis=1)
        assert covered.sum() <= 12, text
        for other, place in texts[:k]:
            apart = np.abs(centre - place) - half - half_size(other) / 1.25
            assert apart.max() > 0, (text, other)
