"""Rests left out behind each other: something changed, where chance does not explain it."""

import numpy as np
import pytest

from gnomon.assess.left_out import cluster


@pytest.mark.parametrize(
    ("out", "n", "expected"),
    [
        ((), 40, None),
        ((3, 17, 30), 40, None),
        ((38, 39), 40, None),
        ((37, 38, 39), 40, (37, 39)),
        ((0, 1, 2), 40, (0, 2)),
        ((5, 20, 21, 22), 40, (20, 22)),
        ((35, 36, 38, 39), 40, (35, 39)),  # one of another sensor's agrees by chance
        ((0, 8, 9, 30), 40, None),
    ],
)
def test_rests_left_out_together(out, n, expected):
    assert cluster(np.isin(np.arange(n), out)) == expected


def test_independent_rests_are_rarely_together():
    rng = np.random.default_rng(1)
    found = [cluster(rng.permutation(200) < 15) for _ in range(200)]
    assert sum(one is not None for one in found) < 30
