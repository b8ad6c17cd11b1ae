"""Both geometries of Angrisano are exact views of any upper triangular sensor."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gnomon.models.angrisano import AngrisanoTriad, alignment_matrix, angles_and_scales

angle = st.floats(-1.4, 1.4)
scale = st.floats(1e-4, 1e4)
geometry = st.sampled_from(["small-angle", "exact"])


@given(st.tuples(angle, angle, angle), st.tuples(scale, scale, scale), geometry, geometry)
def test_a_sensor_in_one_geometry_is_the_same_in_the_other(angles, scales, one, other):
    correction = alignment_matrix(np.array(angles), one) * np.array(scales)
    back, K = angles_and_scales(correction, other)
    np.testing.assert_allclose(
        alignment_matrix(back, other) * K, correction, rtol=1e-12, atol=1e-12 * np.abs(correction).max()
    )
    np.testing.assert_allclose(angles_and_scales(correction, one)[0], angles, rtol=1e-9, atol=1e-9)


@given(st.tuples(angle, angle, angle), st.tuples(scale, scale, scale), geometry)
def test_measurements_go_there_and_back(angles, scales, kind):
    triad = AngrisanoTriad(angles=np.array(angles), b=np.array([33000.0, -5.0, 0.1]), K=np.array(scales), geometry=kind)
    force = np.array([[9.8, 0.0, 0.0], [-1.0, 5.0, 3.0]])
    again = (triad.predict(force) - triad.b) @ triad.correction.T
    np.testing.assert_allclose(again, force, rtol=1e-6, atol=1e-5 * np.linalg.cond(triad.correction / triad.K))
    sensitivity, bias = triad.to_sensor()
    np.testing.assert_allclose(triad.predict(force), force @ sensitivity.T + bias, rtol=1e-12)
