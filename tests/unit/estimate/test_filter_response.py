import numpy as np
import pytest

from gnomon.estimate.camera_imu.result.misfits import expected_square

SHARE, USUAL_S2 = 0.2, 32e-6


@pytest.mark.parametrize("sigma", [3e-6, 1e-5, 1e-4])
def test_a_filter_is_in_the_covariance_as_far_as_it_is_likely(sigma):
    """Triads of which one in five is filtered: the mean of q^2 of those for which about the same q was found."""
    rng = np.random.default_rng(7)
    q = np.where(rng.random(2_000_000) < SHARE, np.abs(rng.normal(scale=USUAL_S2, size=2_000_000)), 0.0)
    found = (q + sigma * rng.standard_normal(q.shape)) / sigma
    for z in (-1.0, 0.0, 1.0, 2.0, 2.76):
        alike = q[np.abs(found - z) < 0.05] ** 2
        assert (
            abs(expected_square(z * sigma, sigma) - alike.mean())
            < 5 * alike.std() / np.sqrt(len(alike)) + 0.05 * sigma**2
        )


def test_a_filter_that_is_proved_counts_whole():
    for z in (7.0, 30.0, 500.0):
        assert expected_square(z * 1e-7, 1e-7) == pytest.approx((z * 1e-7) ** 2, rel=0.03)
