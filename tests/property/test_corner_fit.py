"""The Jacobian of the picture of corners, whatever these look like."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gnomon.detect.boards.corner_fit import _columns, _crossing_or_tip, _frame, _normal_equations
from gnomon.detect.boards.corner_windows import Windows

_SIDE = 9


def between(low, high):
    return st.floats(low, high)


states = st.tuples(
    *[between(-0.8, 0.8)] * 2,  # place
    between(-3.1, 3.1),  # angle of the first normal
    between(0.7, 2.4),  # from there to the second
    *[between(0.5, 2.0)] * 2,  # blurs
    between(-0.6, 0.6),  # correlation
    between(60, 180),
    between(20, 90),
).map(lambda s: np.array([*s[:3], s[2] + s[3], *s[4:]]))


def modelled(state, place, kind):
    """Return the grey levels, as the docstring of the module has them, at single precision."""
    distances, _ = _frame(place, state[None])
    picture = _crossing_or_tip(distances, np.array([[state[6]]], np.float32), kind)[0][0]
    return state[7] - state[8] * picture.astype(np.float64)


@settings(deadline=None, max_examples=60)
@given(state=states, kind=st.sampled_from(["crossing", "tip"]))
def test_the_jacobian_is_that_of_the_picture(state, kind):
    offset = np.arange(_SIDE, dtype=np.float32) - _SIDE // 2
    x, y = (part.ravel() for part in np.meshgrid(offset, offset))
    place = np.stack([x, y, np.ones_like(x)])[None]
    values = np.random.default_rng(0).uniform(0, 254, (1, x.size)).astype(np.float32) + 0.5
    windows = Windows(values=values, place=place, weight=np.ones_like(values), saturated=False)
    normal, _ = _normal_equations(_columns(windows, state[None], kind)[0])
    residual = values[0] - modelled(state, place, kind)
    assert normal[0, -1, -1] == pytest.approx(residual @ residual, rel=1e-4)
    columns = []
    for i in range(9):
        move, step = np.zeros(9), 2e-3 * (100 if i > 6 else 1)
        if i < 2:  # along a normal
            cos, sin = np.cos(state[2:4]), np.sin(state[2:4])
            move[:2] = np.linalg.solve(np.column_stack([cos, sin]), np.eye(2)[i])
        else:
            move[i] = 1
        columns.append(
            (modelled(state + step * move, place, kind) - modelled(state - step * move, place, kind)) / (2 * step)
        )
    J = np.array(columns)
    size = np.sqrt(np.diag(J @ J.T)) + 1e-3
    np.testing.assert_allclose(normal[0, :9, :9] / np.outer(size, size), J @ J.T / np.outer(size, size), atol=5e-3)
    np.testing.assert_allclose(
        normal[0, :9, 9] / (size * np.linalg.norm(residual)),
        J @ residual / (size * np.linalg.norm(residual)),
        atol=5e-3,
    )
