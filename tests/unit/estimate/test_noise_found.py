"""Noise levels from residuals."""

from types import SimpleNamespace

import numpy as np
import pytest

from gnomon.estimate.camera_imu.gauss_newton import pixel_levels


@pytest.mark.parametrize("assumed", [0.05, 0.17, 0.6])
def test_the_level_of_corners_does_not_hang_on_the_one_that_was_assumed(assumed):
    rng = np.random.default_rng(3)
    residual = 0.17 * rng.standard_normal((20_000, 2))
    residual[::50] += 3.0  # wrong corners
    sums = SimpleNamespace(lengths=np.full(200, 100), comparable=residual)
    step = SimpleNamespace(factor=SimpleNamespace(quadratic=lambda *_: 0.0), covariance=np.zeros((0, 0)))
    noise = SimpleNamespace(imus=(), pixel_sigma=(assumed,), huber=2.5)
    (found,) = pixel_levels([sums], [np.ones(200, bool)], noise, step, np.zeros(0, int))
    assert found == pytest.approx(0.17 * 1.024, rel=0.01)  # with two percent held at 2.5 sigma
