"""What quaternions, skew matrices and tangent planes must obey, whatever the numbers."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gnomon.geometry.rotations import (
    nearest_rotation,
    normalise_quaternion,
    quaternion_product,
    rk4n_steps,
    rotation_from_quaternion,
    running_products,
    skew,
    tangent_basis,
)

component = st.floats(-10, 10, allow_subnormal=False)
quaternions = arrays(float, 4, elements=component).filter(lambda q: np.linalg.norm(q) > 1e-3)
vectors = arrays(float, 3, elements=component)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
units = quaternions.map(lambda q: q / np.linalg.norm(q))
lengths = st.lists(st.sampled_from([1, 2, 15, 16, 17, 31, 32, 33, 250]) | st.integers(1, 70), min_size=1, max_size=12)


def close(found, expected, scale=1.0):
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-14 * max(scale, 1.0))


@given(a=quaternions, b=quaternions, c=quaternions)
def test_product_is_associative_and_keeps_the_norm(a, b, c):
    size = np.linalg.norm(a) * np.linalg.norm(b) * np.linalg.norm(c)
    close(quaternion_product(quaternion_product(a, b), c), quaternion_product(a, quaternion_product(b, c)), size)
    close(np.linalg.norm(quaternion_product(a, b)), np.linalg.norm(a) * np.linalg.norm(b), size)


@given(a=quaternions)
def test_conjugate_over_square_is_the_inverse(a):
    inverse = a * [1, -1, -1, -1] / (a @ a)
    close(quaternion_product(a, inverse), [1, 0, 0, 0])
    close(quaternion_product(inverse, a), [1, 0, 0, 0])


@given(a=units, b=units, v=vectors)
def test_rotation_matrices_are_a_faithful_image(a, b, v):
    rotation = rotation_from_quaternion(a)
    close(rotation @ rotation.T, np.eye(3))
    close(np.linalg.det(rotation), 1.0)
    close(rotation_from_quaternion(quaternion_product(a, b)), rotation @ rotation_from_quaternion(b))
    close(rotation_from_quaternion(-a), rotation)
    turned = quaternion_product(quaternion_product(a, np.array([0.0, *v])), a * [1, -1, -1, -1])  # v_world = q v q*
    close(turned, [0.0, *(rotation @ v)], np.linalg.norm(v))


@given(v=vectors, w=vectors, q=units)
def test_skew_turns_with_the_frame(v, w, q):
    rotation = rotation_from_quaternion(q)
    close(skew(v) @ w, np.cross(v, w), 100)
    close(skew(rotation @ v), rotation @ skew(v) @ rotation.T, 20)


@given(u=directions)
def test_tangent_basis_completes_a_right_handed_frame(u):
    frame = np.column_stack([tangent_basis(u), u])
    close(frame.T @ frame, np.eye(3))
    close(np.linalg.det(frame), 1.0)


@given(q=units, noise=arrays(float, (3, 3), elements=st.floats(-0.3, 0.3)), other=units)
def test_nearest_rotation_is_nearest(q, noise, other):
    matrix = rotation_from_quaternion(q) + noise
    found = nearest_rotation(matrix)
    close(found @ found.T, np.eye(3))
    close(np.linalg.det(found), 1.0)
    for rival in (rotation_from_quaternion(q), rotation_from_quaternion(other)):
        assert np.linalg.norm(matrix - found) <= np.linalg.norm(matrix - rival) + 1e-12


@settings(deadline=None)
@given(lengths=lengths, seed=st.integers(0, 2**32 - 1))
def test_running_products_are_those_of_a_plain_loop(lengths, seed):
    steps = normalise_quaternion(np.random.default_rng(seed).normal(size=(sum(lengths), 4)))
    expected, k = np.empty_like(steps), 0
    for length in lengths:
        attitude = np.array([1.0, 0, 0, 0])
        for _ in range(length):
            attitude = quaternion_product(attitude, steps[k])
            expected[k] = attitude
            k += 1
    np.testing.assert_allclose(running_products(steps, np.array(lengths)), expected, rtol=0, atol=1e-13)


@settings(deadline=None)
@given(rates=arrays(float, (9, 3), elements=component), dt=st.floats(1e-4, 0.3))
def test_rk4n_backwards_in_time_undoes_itself(rates, dt):
    # Reversed, the sums of Eqs. (3.12)-(3.15) are the conjugate ones, term by term; coarse steps are no exception.
    there = rk4n_steps(rates[:-1], rates[1:], np.full(8, dt))
    back = rk4n_steps(-rates[1:], -rates[:-1], np.full(8, dt))
    close(quaternion_product(there, back), np.tile([1.0, 0, 0, 0], (8, 1)))
