"""Medians and quantiles are those of NumPy, and distinct values come in order."""

import numpy as np
import pytest

from gnomon.recording.samples import distinct_values, median_of, quantile_of

SHAPES = [(1,), (2,), (9,), (10, 3), (4, 3, 5)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("strange", [0.0, np.nan, np.inf])
def test_median_is_that_of_numpy_along_any_axis(shape: tuple[int, ...], strange: float) -> None:
    values = np.random.default_rng(1).standard_normal(shape)
    values.flat[0] += strange
    for axis in (None, *range(len(shape))):
        assert np.array_equal(median_of(values, axis), np.median(values, axis=axis), equal_nan=True)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("levels", [0.0, 0.37, 1.0, [0.9, 0.5, 0.1]])
def test_quantiles_are_those_of_numpy(shape: tuple[int, ...], levels: float | list[float]) -> None:
    values = np.random.default_rng(2).standard_normal(shape)
    for axis in (None, 0):
        assert np.array_equal(quantile_of(values, levels, axis), np.quantile(values, levels, axis=axis))


def test_a_quantile_of_what_is_unknown_is_unknown() -> None:
    assert np.isnan(quantile_of([1.0, np.nan, 2.0], 0.5))


def test_distinct_values_come_once_and_in_order() -> None:
    assert distinct_values(np.array([[3, 1], [3, 2]])).tolist() == [1, 2, 3]
    assert distinct_values(np.empty(0)).tolist() == []
