"""What rotation vectors and their branches must obey, whatever the numbers."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gnomon.geometry.rotations import (
    body_rotation,
    nearest_branch,
    right_jacobian,
    rotation_from_rotvec,
    rotvec_from_rotation,
    unwrap_rotvecs,
)

component = st.floats(-6, 6, allow_subnormal=False)
vectors = arrays(float, 3, elements=component)
tracks = st.integers(0, 2**32 - 1)


def close(found, expected, atol=1e-13):
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


@given(phi=vectors)
def test_exponential_is_a_rotation_about_its_own_axis(phi):
    R = rotation_from_rotvec(phi)
    close(R @ R.T, np.eye(3))
    close(np.linalg.det(R), 1.0)
    close(R @ phi, phi, 1e-12)
    close(rotation_from_rotvec(-phi), R.T)
    close(right_jacobian(-phi), R @ right_jacobian(phi), 1e-12)  # Jl(phi) = Jr(-phi) = Exp(phi) Jr(phi)


@given(phi=vectors)
def test_logarithm_is_the_shortest_vector_of_the_rotation(phi):
    R = rotation_from_rotvec(phi)
    found = rotvec_from_rotation(R)
    assert np.linalg.norm(found) <= np.pi * (1 + 1e-15)
    assert np.linalg.norm(found) <= np.linalg.norm(phi) + 1e-13
    close(rotation_from_rotvec(found), R)


@given(phi=vectors, d=vectors)
def test_right_jacobian_turns_small_changes(phi, d):
    step = 1e-6 * d
    ahead, behind = rotation_from_rotvec(phi + step), rotation_from_rotvec(phi - step)
    turned = rotvec_from_rotation(behind.T @ ahead)
    close(turned, right_jacobian(phi) @ (2 * step), 1e-13 + 1e-10 * np.linalg.norm(step))


@given(phi=vectors, rate=vectors)
def test_turning_agrees_with_the_plain_functions(phi, rate):
    R, J, omega, by_phi = (value[0] for value in body_rotation(phi[None], rate[None]))
    close(R, rotation_from_rotvec(phi), 1e-14)
    close(J, right_jacobian(phi), 1e-14)
    close(omega, J @ rate, 1e-13 * (1 + np.linalg.norm(rate)))
    # the rate grows in proportion: d(Jr(s phi) s rate)/ds at s = 1 is by_phi phi + omega
    h = 1e-5
    ahead, behind = (right_jacobian((1 + s) * phi) @ ((1 + s) * rate) for s in (h, -h))
    close(by_phi @ phi + omega, (ahead - behind) / (2 * h), 1e-7 * (1 + np.linalg.norm(rate)))


@given(phi=vectors, guide=vectors)
def test_nearest_branch_is_the_same_rotation_and_no_branch_is_nearer(phi, guide):
    length = np.linalg.norm(phi)
    assume(length > 1e-3)
    found = nearest_branch(phi, guide)
    close(rotation_from_rotvec(found), rotation_from_rotvec(phi), 1e-12)
    own = np.linalg.norm(found - guide)
    for turns in range(-3, 4):
        rival = phi + 2 * np.pi * turns * phi / length
        assert own <= np.linalg.norm(rival - guide) + 1e-12
    close(nearest_branch(found, guide), found, 1e-12)  # once is enough
    close(nearest_branch(phi, phi), phi, 0)


@settings(deadline=None)
@given(seed=tracks, bend=st.floats(0, 1.5), reach=st.floats(0.5, 13.0))
def test_unwrapped_gives_a_continuous_track_back(seed, bend, reach):
    # The axis wanders; not beyond a full turn, where the chart ends.
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.2, reach, 200)
    wandering = (bend if reach < 5.9 else 0.0) * np.sin(angle / 4 + rng.uniform(0, 6))[:, None] * rng.normal(size=3)
    axis = rng.normal(size=3) + wandering
    truth = angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    assume(np.linalg.norm(np.diff(truth, axis=0), axis=1).max() < 0.4)
    found = unwrap_rotvecs(rotvec_from_rotation(rotation_from_rotvec(truth)))
    close(found, truth, 1e-11)
