"""Every lens model that is named is known wherever one has to be."""

import pytest

from gnomon.estimate.cameras.first_lens import BENDINGS, SHAPES, names_of
from gnomon.models import lens_names
from gnomon.models.distortions import DISTORTIONS
from gnomon.models.projections import PROJECTIONS
from gnomon.report.cameras_use import DISTORTION_FORMULAS, PROJECTION_FORMULAS
from gnomon.writers.kalibr_results import LENS_NAMES


@pytest.mark.parametrize("name", lens_names.SHAPES)
def test_a_projection_is_known_everywhere(name):
    assert PROJECTIONS[name].names == lens_names.SHAPES[name]
    assert all(len(shape) == len(lens_names.SHAPES[name]) for shape in SHAPES[name])
    assert len(LENS_NAMES[name]) == len(lens_names.SHAPES[name])
    assert name in PROJECTION_FORMULAS
    assert names_of(f"{name}-none") == (name, "none")


@pytest.mark.parametrize("name", lens_names.COEFFICIENTS)
def test_a_distortion_is_known_everywhere(name):
    assert DISTORTIONS[name].names == lens_names.COEFFICIENTS[name]
    assert all(len(coefficients) == len(lens_names.COEFFICIENTS[name]) for coefficients in BENDINGS[name])
    assert name in DISTORTION_FORMULAS
    assert names_of(f"pinhole-{name}") == ("pinhole", name)
