"""Blocks are added where the recording asks for them, and only there."""

import numpy as np
import pytest

from gnomon.estimate.trust.clusters import CandidateBlock, ClusterSums, model_steps

_CLUSTERS, _ROWS = 20, 30


def _sums(rng: np.random.Generator, truth: np.ndarray, at: np.ndarray, memory: int = 1) -> ClusterSums:
    """Return the sums of a linear problem at values `at`; each error is repeated in `memory` neighbouring rows."""
    a = rng.normal(size=(_CLUSTERS, _ROWS, len(truth)))
    errors = rng.normal(size=(_CLUSTERS, _ROWS // memory)).repeat(memory, axis=1)
    off = a @ (truth - at) + errors
    return ClusterSums(
        t_s=np.arange(float(_CLUSTERS)),
        pull=np.einsum("crp,cr->cp", a, off),
        information=np.einsum("crp,crq->cpq", a, a),
        prior_pull=np.zeros(len(truth)),
        prior_information=1e-6 * np.eye(len(truth)),
    )


def _candidates(at: np.ndarray) -> list[CandidateBlock]:
    return [
        CandidateBlock(name=name, columns=np.arange(k, k + 2), away=-at[k : k + 2])
        for name, k in (("scale", 2), ("lever arms", 4))
    ]


def test_a_block_that_is_there_is_added_and_one_that_is_not_is_left_out() -> None:
    rng = np.random.default_rng(1)
    truth = np.array([1.0, -1.0, 0.4, 0.0, 0.0, 0.0])
    at = truth + 0.05
    first, second = model_steps(_sums(rng, truth, at), np.arange(2), _candidates(at))
    assert first.used
    assert first.gain > 10
    assert not second.used
    moved = at[2] + first.change[2] + _candidates(at)[0].away[0]
    assert moved == pytest.approx(0.4, abs=5 * first.sigma[2])
    assert np.isnan(first.sigma[4])


@pytest.mark.parametrize("memory", [1, 15])
def test_a_block_that_is_not_there_is_added_in_no_more_than_one_of_a_hundred(memory: int) -> None:
    rng = np.random.default_rng(2)
    truth, added = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0]), 0
    for _ in range(300):
        steps = model_steps(_sums(rng, truth, truth, memory), np.arange(2), _candidates(truth))
        added += any(step.used for step in steps)
    assert added <= 8


def test_what_a_person_says_is_done() -> None:
    rng = np.random.default_rng(3)
    truth = np.array([1.0, -1.0, 0.4, 0.0, 0.0, 0.0])
    scale, arms = _candidates(truth)
    stated = [
        CandidateBlock(name=scale.name, columns=scale.columns, away=scale.away, forced=False),
        CandidateBlock(name=arms.name, columns=arms.columns, away=arms.away, forced=True),
    ]
    first, second = model_steps(_sums(rng, truth, truth), np.arange(2), stated)
    assert not first.used
    assert first.gain > first.needed
    assert second.used


@pytest.mark.parametrize(("effect", "least", "most"), [(0.0, 0, 4), (0.2, 90, 100), (-0.4, 0, 0)])
def test_one_effect_is_proved_by_clusters_that_pull_it_alike(effect: float, least: int, most: int) -> None:
    """An effect of five sigmas, of which the gains' signs tell no more than every other time; not a negative one."""
    rng, used = np.random.default_rng(4), {True: 0, False: 0}
    truth = np.array([1.0, -1.0, effect])
    for _ in range(100):
        sums = _sums(rng, truth, truth)
        for alike in used:
            one = CandidateBlock(name="exposure", columns=np.arange(2, 3), away=-truth[2:], alike=alike)
            used[alike] += model_steps(sums, np.arange(2), [one])[0].used
    assert least <= used[True] <= most
    assert used[False] > 90 if effect < 0 else used[False] <= max(used[True], 60)
