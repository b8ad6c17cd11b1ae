"""Every lens model that is named is known wherever one has to be."""

import pytest

from gnomon.estimate.cameras.first_lens import BENDINGS, SHAPES, names_of
from gnomon.formats.kalibr.results import LENS_NAMES
from gnomon.models import lens_names
from gnomon.models.camera import PROJECTIONS
from gnomon.models.distortions import DISTORTIONS
from gnomon.report.cameras.page import DISTORTION_FORMULAS, PROJECTION_FORMULAS


def missing(name, tables):
    return [file for file, table in tables.items() if name not in table]


@pytest.mark.parametrize("name", lens_names.SHAPES)
def test_a_projection_is_known_everywhere(name):
    tables = {
        "models/camera.py": PROJECTIONS,
        "estimate/cameras/first_lens.py": SHAPES,
        "report/cameras_use.py": PROJECTION_FORMULAS,
        "formats/kalibr/results.py": LENS_NAMES,
    }
    assert missing(name, tables) == []
    assert PROJECTIONS[name].names == lens_names.SHAPES[name]
    assert all(len(shape) == len(lens_names.SHAPES[name]) for shape in SHAPES[name])
    assert len(LENS_NAMES[name]) == len(lens_names.SHAPES[name])
    assert names_of(f"{name}-none") == (name, "none")


@pytest.mark.parametrize("name", lens_names.COEFFICIENTS)
def test_a_distortion_is_known_everywhere(name):
    tables = {
        "models/distortions.py": DISTORTIONS,
        "estimate/cameras/first_lens.py": BENDINGS,
        "report/cameras_use.py": DISTORTION_FORMULAS,
    }
    assert missing(name, tables) == []
    assert DISTORTIONS[name].names == lens_names.COEFFICIENTS[name]
    assert all(len(coefficients) == len(lens_names.COEFFICIENTS[name]) for coefficients in BENDINGS[name])
    assert names_of(f"pinhole-{name}") == ("pinhole", name)
