"""The jackknife over clusters against brute force on a linear problem."""

import numpy as np
import pytest

from gnomon.estimate.trust.clusters import (
    ClusterSums,
    held_out_costs,
    leave_clusters_out,
    part_estimates,
)
from jackknife import jackknife_covariance


def _problem(seed: int, cells: int = 24, rows: int = 20, size: int = 4) -> tuple[np.ndarray, np.ndarray, ClusterSums]:
    """Return rows (c, r, p) and values (c, r) of least squares with a prior about zero, and its sums at the minimum."""
    rng = np.random.default_rng(seed)
    scales = np.array([1.0, 1e-4, 1e3, 1.0])
    a = rng.normal(size=(cells, rows, size)) * scales
    y = a @ (rng.normal(size=size) / scales) + rng.normal(size=(cells, rows))
    prior = np.diag(scales**2) * 1e-2
    information = np.einsum("crp,crq->cpq", a, a)
    theta = np.linalg.solve(information.sum(axis=0) + prior, np.einsum("crp,cr->p", a, y))
    pull = np.einsum("crp,cr->cp", a, y - a @ theta)
    return (
        a,
        y,
        ClusterSums(
            t_s=np.arange(cells) * 0.5,
            pull=pull,
            information=information,
            prior_pull=-prior @ theta,
            prior_information=prior,
        ),
    )


def _estimate(a: np.ndarray, y: np.ndarray, prior: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.einsum("crp,crq->pq", a, a) + prior, np.einsum("crp,cr->p", a, y))


def test_left_out_is_the_estimate_without_the_cluster() -> None:
    a, y, sums = _problem(0)
    whole = _estimate(a, y, sums.prior_information)
    for c, moved in enumerate(leave_clusters_out(sums)):
        others = np.arange(len(a)) != c
        assert whole + moved == pytest.approx(_estimate(a[others], y[others], sums.prior_information), rel=1e-9)


def test_gathered_cells_are_the_same_estimates_as_whole_clusters() -> None:
    a, y, sums = _problem(1)
    number = np.floor((sums.t_s - sums.t_s[0]) / 2.0 + 0.5).astype(np.int64)
    clusters = sums.gathered(number)
    assert clusters.total == pytest.approx(sums.total)
    whole = _estimate(a, y, sums.prior_information)
    others = number != 1
    expected = _estimate(a[others], y[others], sums.prior_information)
    assert whole + leave_clusters_out(clusters)[1] == pytest.approx(expected, rel=1e-9)


def test_parts_are_estimated_from_their_own_clusters() -> None:
    a, y, sums = _problem(2)
    part = np.repeat([0, 1], 12)
    steps, inverses = part_estimates(sums, part)
    whole = _estimate(a, y, sums.prior_information)
    for number in (0, 1):
        own = part == number
        assert whole + steps[number] == pytest.approx(_estimate(a[own], y[own], sums.prior_information), rel=1e-9)
        information = np.einsum("crp,crq->pq", a[own], a[own]) + sums.prior_information
        assert inverses[number] == pytest.approx(np.linalg.inv(information), rel=1e-6)


def test_held_out_costs_are_those_of_estimates_without_the_cluster() -> None:
    a, y, sums = _problem(3)
    sub = np.array([0, 2])
    at = _estimate(a, y, sums.prior_information)
    for index in (np.arange(4), sub):
        costs = held_out_costs(sums.of_parameters(index))
        for c in (0, 7):
            others = np.arange(len(a)) != c
            held = y - a @ np.where(np.isin(np.arange(4), index), 0.0, at)
            b, prior = a[..., index], sums.prior_information[np.ix_(index, index)]
            theta = at.copy()
            theta[index] = _estimate(b[others], held[others], prior)
            gain = (np.sum((y[c] - a[c] @ theta) ** 2) - np.sum((y[c] - a[c] @ at) ** 2)) / 2
            assert costs[c] == pytest.approx(gain, rel=1e-7, abs=1e-9)


def test_white_noise_gives_the_ordinary_covariance_and_repeated_noise_a_larger_one() -> None:
    rng = np.random.default_rng(5)
    ratios = {1: [], 5: []}
    for repeated, found in ratios.items():
        for _ in range(40):
            a = rng.normal(size=(60, 1, 3)).repeat(repeated, axis=1)
            y = rng.normal(size=(60, 1)).repeat(repeated, axis=1)
            theta = _estimate(a, y, np.zeros((3, 3)))
            sums = ClusterSums(
                t_s=np.arange(60.0),
                pull=np.einsum("crp,cr->cp", a, y - a @ theta),
                information=np.einsum("crp,crq->cpq", a, a),
                prior_pull=np.zeros(3),
                prior_information=np.zeros((3, 3)),
            )
            found.append(np.diag(jackknife_covariance(sums)) / np.diag(np.linalg.inv(sums.total)))
    assert np.mean(ratios[1]) == pytest.approx(1.0, abs=0.12)
    assert np.mean(ratios[5]) == pytest.approx(5.0, rel=0.12)


def test_what_one_cluster_alone_tells_may_be_anywhere_without_it() -> None:
    """Of which the others have no information at all: equations that cannot be solved ended a calibration as a bug."""
    information = np.zeros((3, 2, 2))
    information[:, 0, 0] = 4.0
    information[0, 1, 1] = 1.0
    pull = np.array([[1.0, 0.5], [-2.0, 0.0], [1.0, 0.0]])
    sums = ClusterSums(
        t_s=np.arange(3.0),
        pull=pull,
        information=information,
        prior_pull=np.zeros(2),
        prior_information=np.zeros((2, 2)),
    )
    moves = leave_clusters_out(sums)
    np.testing.assert_allclose(moves[:, 0], -pull[:, 0] / 8.0, rtol=1e-9)
    assert abs(moves[0, 1]) > 1e6
    assert not moves[1:, 1].any()
