"""Stated attitudes are compared with shown ones, and wrong ones are named."""

from itertools import product

import numpy as np
import pytest

from gnomon.estimate.triads.attitudes import compare_attitudes, rough_directions
from gnomon.geometry.rotations import rotation_from_rotvec

EDGES = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) in {1, 2}])
STATED = EDGES / np.linalg.norm(EDGES, axis=1, keepdims=True)
TURN = rotation_from_rotvec(np.array([0.4, -1.0, 0.3]))


def shown(turn=TURN, noise=0.02, seed=0):
    u = STATED @ turn.T + noise * np.random.default_rng(seed).normal(size=STATED.shape)
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def test_right_attitudes_agree():
    found = compare_attitudes(shown(), STATED)
    assert not found.wrong.any()
    assert not found.mirrored
    np.testing.assert_allclose(found.turn, TURN, atol=0.03)
    assert found.angle_rad.max() < 0.1


def test_exchanged_axes_and_lost_signs_are_named():
    stated = STATED.copy()
    at = [k for k in range(len(stated)) if np.count_nonzero(stated[k]) == 2]
    stated[at[0]] *= -1
    j = next(k for k in at[1:] if stated[k, 2] == 0)
    stated[j] = stated[j][[0, 2, 1]]
    found = compare_attitudes(shown(), stated)
    assert set(np.flatnonzero(found.wrong)) == {at[0], j}
    assert "sign" in found.guess[at[0]]
    assert found.guess[j] == "y and z swapped"


def test_a_left_handed_jig_is_noticed():
    found = compare_attitudes(shown(), STATED * np.array([1.0, -1.0, 1.0]))
    assert found.mirrored
    assert not found.wrong.any()


def test_several_wrong_ones_cannot_hide():
    stated = STATED.copy()
    stated[:5] = stated[:5][:, [1, 2, 0]]
    moved = np.linalg.norm(stated - STATED, axis=1) > 0.3
    found = compare_attitudes(shown(), stated)
    np.testing.assert_array_equal(found.wrong, moved)


@pytest.mark.parametrize("unit_si", [9.80665, None])
def test_rough_directions_of_counts_and_units(unit_si):
    measured = STATED if unit_si else 33000 + 5000 * STATED * np.array([1.0, 1.1, 0.9])
    angle = np.arccos(np.clip(np.sum(rough_directions(measured, unit_si) * STATED, axis=1), -1, 1))
    assert angle.max() < 0.02
