"""Patterns in the residuals of corners; triads behind a filter, or with another scale for negative readings."""

import numpy as np
import pytest

from gnomon.estimate.camera_imu.result.misfits import (
    CountingCorners,
    _pattern,
    along_board,
    corner_correlation,
    expected_square,
    missing_term,
)
from gnomon.models.camera import Camera

LABELS, RATE_HZ = 40, 10.0


def residuals(rng, *, pattern, memory_s, duration_s=40.0):
    """Return residuals (m, 2) of unit variance that remember a while, labels, timestamps, with a pattern of a size."""
    t_s = np.arange(0, duration_s, 1 / RATE_HZ)
    keep = np.exp(-1 / (RATE_HZ * memory_s)) if memory_s else 0.0
    values = rng.normal(size=(len(t_s), LABELS, 2))
    for i in range(1, len(t_s)):
        values[i] = keep * values[i - 1] + np.sqrt(1 - keep**2) * values[i]
    values += rng.normal(size=(len(t_s), 1, 2))  # and all corners of a frame have something in common
    values += pattern * rng.normal(size=(LABELS, 2))
    label = np.tile(np.arange(LABELS), len(t_s))
    return values.reshape(-1, 2), label, np.repeat(t_s, LABELS)


@pytest.mark.parametrize("memory_s", [0.0, 0.5])
def test_correlated_residuals_are_no_pattern(memory_s):
    rng = np.random.default_rng(7)
    found = [_pattern(*residuals(rng, pattern=0.0, memory_s=memory_s)) for _ in range(60)]
    chance = np.array([one.chance for one in found])  # uniform between 0 and 1
    assert np.abs(np.mean([one.z for one in found])) < 4 / np.sqrt(60)
    assert chance.min() > 1e-3
    assert abs(chance.mean() - 0.5) < 4 / np.sqrt(12 * 60)
    assert all(one.clusters == 20 for one in found)


@pytest.mark.parametrize("size", [0.2, 0.5, 1.0])
def test_a_pattern_is_found_at_its_size(size):
    rng = np.random.default_rng(8)
    found = _pattern(*residuals(rng, pattern=size, memory_s=0.5))
    assert found.chance < 1e-3
    assert found.z > 3
    assert found.rms_px == pytest.approx(size, rel=0.3)
    assert found.share == pytest.approx(size**2 / (2 + size**2), rel=0.6)


def test_too_short_a_recording_has_no_pattern():
    found = _pattern(*residuals(np.random.default_rng(9), pattern=1.0, memory_s=0.0, duration_s=5.0))
    assert (found.z, found.chance) == (0.0, 1.0)


@pytest.mark.parametrize("angle", [-2.5, 0.0, 0.4, 1.9])
def test_residuals_are_turned_along_the_board(angle):
    # The board's x axis points along (cos, sin) of the image, its y axis, which points up, a quarter turn before it.
    x, y = np.array([np.cos(angle), np.sin(angle)]), np.array([np.sin(angle), -np.cos(angle)])
    by_place = 400.0 * np.stack([x, y], axis=1)[None]
    np.testing.assert_allclose(along_board(by_place, 2 * x[None]), [[2, 0]], atol=1e-12)
    np.testing.assert_allclose(along_board(by_place, 3 * y[None]), [[0, 3]], atol=1e-12)


@pytest.mark.parametrize("memory_s", [0.0, 0.2, 2.0])
def test_the_correlation_from_frame_to_frame_is_that_of_what_residuals_remember(memory_s):
    rng = np.random.default_rng(3)
    keep = np.exp(-1 / (RATE_HZ * memory_s)) if memory_s else 0.0
    values = rng.normal(size=(400, LABELS, 2))
    for i in range(1, len(values)):
        values[i] = keep * values[i - 1] + np.sqrt(1 - keep**2) * values[i]
    frame, point = (grid.ravel() for grid in np.indices(values.shape[:2]))
    there = rng.random(len(frame)) < 0.8  # not every corner is found in each frame
    corners = CountingCorners(
        residual=values.reshape(-1, 2)[there],
        on_board=values.reshape(-1, 2)[there],
        frame=frame[there],
        point=point[there],
        t_s=frame[there] / RATE_HZ,
        pixels=np.zeros((there.sum(), 2)),
    )
    assert abs(corner_correlation(corners) - keep) < 0.03


@pytest.mark.parametrize(("size", "asked"), [(0.0, False), (0.05, True)])
def test_a_lens_moves_by_the_term_that_its_series_lacks(size, asked):
    """Corners of a lens with k3 = `size`, seen through the best radtan: refitted, that moves by what the term gives."""
    rng, most = np.random.default_rng(9), 6000
    lens = Camera(
        projection="pinhole",
        intrinsics=np.array([460.0, 460.0, 376.0, 240.0]),
        distortion="radtan",
        distortion_coeffs=np.array([-0.3, 0.1, 0.0, 0.0]),
        resolution=(752, 480),
    )
    pixels = rng.uniform([40, 40], [711, 439], (most, 2))
    rays, seen = lens.unproject(pixels)
    assert seen.all()
    flat = rays[:, :2] / rays[:, 2:]
    term = 460.0 * flat * np.sum(flat**2, axis=1, keepdims=True) ** 3
    image = lens.project(rays, parameters_jacobian=True)
    turned = np.cross(image.by_point, rays[:, None, :])
    known = np.concatenate([turned, image.by_parameters], axis=2).reshape(2 * most, -1)
    noise = 0.2 * rng.standard_normal((most, 2))
    off = (size * term + noise).ravel()
    left = off - known @ np.linalg.lstsq(known, off, rcond=None)[0]
    corners = CountingCorners(
        residual=left.reshape(-1, 2),
        on_board=left.reshape(-1, 2),
        frame=np.arange(most) // 100,
        point=np.arange(most) % 100,
        t_s=np.arange(most) // 100 / 2.0,
        pixels=pixels / lens.resolution,
    )
    moved = missing_term(lens, corners)
    expected = np.linalg.lstsq(known, size * term.ravel(), rcond=None)[0][3:]
    assert moved.any() == asked
    np.testing.assert_allclose(moved, expected, rtol=0.2, atol=1e-12 if not asked else 0.02 * np.abs(expected).max())


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
