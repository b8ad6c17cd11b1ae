"""What is done with thousands of clusters of time, or of control points, takes memory in proportion to them."""

import tracemalloc
from collections.abc import Callable

import numpy as np

from gnomon.estimate.trust.clusters import CandidateBlock, ClusterSums, _jackknife, model_steps, robust_variances
from gnomon.solve.bordered_band import BorderedBand, Workspace
from gnomon.solve.factorisation import Factor

SIZE = 6


def sums(clusters: int, seed: int = 0) -> ClusterSums:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((clusters, 4, SIZE)) * 10.0 ** np.arange(SIZE)
    return ClusterSums(
        t_s=np.arange(clusters, dtype=np.float64),
        pull=np.einsum("cri,cr->ci", rows, rng.standard_normal((clusters, 4))),
        information=np.swapaxes(rows, 1, 2) @ rows,
        prior_pull=np.zeros(SIZE),
        prior_information=np.eye(SIZE),
    )


def peak(work: Callable[[], object]) -> int:
    tracemalloc.start()
    work()
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found


def test_the_jackknife_is_that_of_the_whole_covariance_of_the_pulls():
    """Expectation and freedom of its variances: traces of a matrix that is as large as the clusters squared."""
    few, jacobian = sums(30), np.random.default_rng(1).standard_normal((3, SIZE)) / 10.0 ** np.arange(SIZE)
    _, expected, freedom = _jackknife(few, jacobian)
    total = few.total
    for m in range(3):
        arms = np.array([jacobian[m] @ np.linalg.inv(total - own) for own in few.information])
        seen = np.array([arm @ own for arm, own in zip(arms, few.information, strict=True)])
        covariance = np.diag(np.sum(seen * arms, axis=1)) - seen @ np.linalg.inv(total) @ seen.T
        assert np.isclose(expected[m], np.trace(covariance), rtol=1e-9)
        assert np.isclose(freedom[m], np.trace(covariance) ** 2 / np.sum(covariance**2), rtol=1e-9)


def test_memory_of_clusters_grows_with_their_number_and_not_with_its_square():
    def work(count: int) -> Callable[[], object]:
        many, block = sums(count), np.arange(SIZE)
        steps = [CandidateBlock(name="last", columns=np.array([SIZE - 1]), away=np.zeros(1))]

        def all_of_it() -> None:
            robust_variances([many, many.gathered(np.arange(count) // 2)], np.eye(SIZE), block)
            model_steps(many, np.arange(SIZE - 1), steps)

        return all_of_it

    work(100)()  # what is imported along the way
    few, many = peak(work(3_000)), peak(work(9_000))
    assert many < 3.3 * few
    assert many < 100e6  # a matrix of 9000 x 9000 is 650 MB


def test_clusters_in_any_order_are_gathered():
    cells, number = sums(12), np.array([3, 0, 0, 3, 7, 7, 0, 3, 7, 0, 3, 3])
    found = cells.gathered(number)
    for place, cluster in enumerate((0, 3, 7)):
        own = number == cluster
        assert np.allclose(found.pull[place], cells.pull[own].sum(axis=0), rtol=1e-12)
        assert np.allclose(found.information[place], cells.information[own].sum(axis=0), rtol=1e-12)
        assert np.isclose(found.t_s[place], cells.t_s[own].mean())


def test_of_thousands_of_clusters_the_gain_that_chance_needs_is_that_of_their_signs():
    many = sums(3_000)
    (step,) = model_steps(
        many, np.arange(SIZE - 1), [CandidateBlock(name="b", columns=np.array([5]), away=np.zeros(1))]
    )
    spread = step.gain_sigma  # of a sum of so many the 99 % point is that of a normal distribution
    assert 0.9 < step.needed / max(2.326 * spread, 2.0) < 1.15


def test_a_factor_outlasts_other_equations_in_the_memory_of_its_own():
    def filled(workspace: Workspace, seed: int) -> BorderedBand:
        rng = np.random.default_rng(seed)
        system = BorderedBand(controls=200, order=4, groups=(6, 3), parameters=5, sides=2, workspace=workspace)
        for g in range(2):
            for h in range(2):
                system.band[g][h][:] = 0.01 * rng.standard_normal(system.band[g][h].shape)
            system.band[g][g][:, :, 0, :] = 4 * np.eye(system.groups[g])
        system.tail[:] = rng.standard_normal(system.tail.shape)
        system.corner[:] = 1e4 * np.eye(5)
        return system

    workspace = Workspace()
    factor = Factor.of(filled(workspace, 1))
    before = factor.substituted(0, np.ones(5)), factor.marginals(np.arange(5), np.eye(5))[0]
    other = filled(workspace.beside_a_factor(), 2)
    assert np.shares_memory(other.tail, workspace.zeros("tail", (1,)))  # which overwrites one number, of the first ones
    again = Factor.of(other)
    after = factor.substituted(0, np.ones(5)), factor.marginals(np.arange(5), np.eye(5))[0]
    for one, same in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, same)
    assert not np.allclose(again.substituted(0, np.ones(5)), before[0])
