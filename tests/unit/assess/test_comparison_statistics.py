"""The statistics of comparisons: z rms of 1 for honest sigmas, limits that one in a hundred exceeds."""

import numpy as np
import pytest

from gnomon.assess.comparison.comparison import Scatter, largest_z_limit, standing_out, z_rms_limit

RUNS = 4000


def drawn(rng, covariances, runs=RUNS):
    """Return scalars (runs, m, n) with the covariances (m, n, n)."""
    roots = np.linalg.cholesky(covariances)
    return np.einsum("mij,rmj->rmi", roots, rng.normal(size=(runs, *covariances.shape[:2])))


def z_rms(values, covariances):
    found = [Scatter(values=one, covariances=covariances).z_rms() for one in values]
    return np.array([value for value, _ in found]), found[0][1]


@pytest.mark.parametrize("count", [2, 5])
def test_correlated_scalars_of_different_accuracy(count):
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(count, 6, 6)) / np.sqrt(6) + 0.6
    covariances = mixing @ mixing.transpose(0, 2, 1) * 10.0 ** rng.uniform(-2, 0, size=(count, 1, 1))
    found, limit = z_rms(drawn(rng, covariances, 1500), covariances)
    assert np.mean(found**2) == pytest.approx(1.0, rel=0.1)
    assert limit == pytest.approx(np.quantile(found, 0.99), rel=0.1)


def test_one_who_states_no_sigmas_is_held_against_the_other():
    rng = np.random.default_rng(2)
    covariances = np.array([np.eye(4), np.zeros((4, 4))])
    values = rng.normal(size=(500, 2, 4)) * [[[1.0], [0.0]]]
    found, _ = z_rms(values, covariances)
    assert np.mean(found**2) == pytest.approx(1.0, rel=0.1)


def test_missing_scalars_do_not_count():
    values = np.array([[0.0, 1.0], [2.0, np.nan]])
    covariances = np.array([np.eye(2), np.diag([1.0, 0.0])])
    found, limit = Scatter(values=values, covariances=covariances).z_rms()
    assert found == pytest.approx(np.sqrt(2))  # (2 - 0)^2 / (1 + 1)
    assert limit == pytest.approx(z_rms_limit(1.0))


def test_nothing_known():
    none = Scatter(values=np.zeros((2, 3)), covariances=np.zeros((2, 3, 3)))
    assert np.isnan(none.z_rms()).all()


def test_the_largest_of_many():
    rng = np.random.default_rng(3)
    largest = np.abs(rng.normal(size=(20000, 31))).max(axis=1)
    assert np.mean(largest > largest_z_limit(31)) == pytest.approx(0.01, abs=0.003)


@pytest.mark.parametrize(
    ("conflicts", "outside"),
    [
        ([], ()),
        ([("A", "B", 9.0)], ()),
        ([("A", "B", 9.0), ("A", "C", 8.0), ("A", "D", 8.0)], ("A",)),
        ([("A", "C", 9.0), ("A", "D", 8.0), ("B", "C", 7.0), ("B", "D", 7.0), ("A", "B", 5.0)], ("A", "B")),
        ([("A", "B", 9.0), ("C", "D", 9.0)], ()),
    ],
)
def test_who_stands_out(conflicts, outside):
    assert standing_out("ABCD", conflicts) == outside
