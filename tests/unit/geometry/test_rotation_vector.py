"""Rotation vectors against high precision, with angles swept on a log scale across every branch of the code."""

import mpmath as mp
import numpy as np
import pytest

from gnomon.geometry.rotations import (
    angular_acceleration_by_phi,
    body_rotation,
    nearest_branch,
    quaternion_from_rotation,
    right_jacobian,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotvec_from_rotation,
    unwrap_rotvecs,
)

# The series ends at |phi|^2 = 0.25: on both sides of it, and from nothing to nearly a full turn.
SWEPT = [0.0, *(10.0**e for e in np.arange(-20, -0.9, 0.5)), 0.3, 0.45, 0.49, 0.4999, 0.5, 0.5001, 0.51, 0.6, 0.8]
TURNS = [1.0, 1.57, 2.0, 3.0, 3.1415926, 3.1416, 3.5, 4.5, 5.2, 6.0, 6.28]
ANGLES = SWEPT + TURNS
AXES = [(1.0, 0.0, 0.0), (0.48, -0.6, 0.64), (-0.8, 0.0, 0.6)]


def exact(angle, axis, rate=(0.0, 0.0, 0.0)):
    """Return Exp, Jr, Jr phi' and its derivative by phi, in two hundred digits, of which closed forms lose many."""
    mp.mp.dps = 200
    vector = mp.matrix([mp.mpf(float(angle * a)) for a in axis])
    rate = mp.matrix([mp.mpf(float(w)) for w in rate])
    step = mp.mpf(10) ** -50

    def rotated_rate(v):
        return jacobian(v) * rate

    columns = []
    for k in range(3):
        d = mp.matrix(3, 1)
        d[k] = step
        columns.append((rotated_rate(vector + d) - rotated_rate(vector - d)) / (2 * step))
    by_phi = np.array([[float(columns[k][i]) for k in range(3)] for i in range(3)])
    rotation, J, omega = (as_array(m) for m in (exponential(vector), jacobian(vector), rotated_rate(vector)))
    return rotation, J, omega.ravel(), by_phi


def cross(v):
    theta = mp.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    return theta, mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def exponential(v):
    theta, V = cross(v)
    return mp.eye(3) if not theta else mp.eye(3) + mp.sin(theta) / theta * V + (1 - mp.cos(theta)) / theta**2 * V * V


def jacobian(v):
    theta, V = cross(v)
    if not theta:
        return mp.eye(3)
    return mp.eye(3) - (1 - mp.cos(theta)) / theta**2 * V + (theta - mp.sin(theta)) / theta**3 * V * V


def as_array(matrix):
    return np.array([[float(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)])


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_jacobian_and_turning_in_high_precision(angle):
    rate = np.array([0.7, -1.1, 0.4])
    for axis in AXES:
        phi = angle * np.array(axis)
        R, J, omega, by_phi = exact(angle, axis, rate)
        np.testing.assert_allclose(rotation_from_rotvec(phi), R, rtol=0, atol=1e-14)
        np.testing.assert_allclose(right_jacobian(phi), J, rtol=0, atol=2e-14)
        found = body_rotation(phi[None], rate[None])
        for value, expected in zip(found, (R, J, omega, by_phi), strict=True):
            np.testing.assert_allclose(value[0], expected, rtol=0, atol=2e-14)


@pytest.mark.parametrize("angle", [*ANGLES, 1.4, 1.4142, 1.41422, 1.43])
def test_angular_acceleration_by_its_rotation_vector_in_high_precision(angle):
    rate, curvature = ([mp.mpf(w) for w in values] for values in ((0.7, -1.1, 0.4), (-3.0, 2.0, 5.0)))
    mp.mp.dps = 200
    step = mp.mpf(10) ** -40

    def alpha(v):
        """Jr phi'' + (d/dt Jr) phi'."""
        turned = [mp.matrix([v[k] + sign * step * rate[k] for k in range(3)]) for sign in (1, -1)]
        ahead, behind = (jacobian(vector) * mp.matrix(rate) for vector in turned)
        return (ahead - behind) / (2 * step) + jacobian(v) * mp.matrix(curvature)

    for axis in AXES:
        phi = mp.matrix([mp.mpf(float(angle * a)) for a in axis])
        found = angular_acceleration_by_phi(*(np.array([[float(x) for x in v]]) for v in (phi, rate, curvature)))[0]
        for k in range(3):
            d = mp.matrix(3, 1)
            d[k] = mp.mpf(10) ** -30
            expected = as_array((alpha(phi + d) - alpha(phi - d)) / (2 * d[k])).ravel()
            np.testing.assert_allclose(found[:, k], expected, rtol=0, atol=5e-14 * 5)


@pytest.mark.parametrize("angle", SWEPT[1:])
def test_small_angles_lose_no_digits(angle):
    # What a rotation differs from the identity keeps its relative precision, however little it is.
    axis = AXES[1]
    R, J, *_ = exact(angle, axis)
    phi = angle * np.array(axis)
    odd = rotation_from_rotvec(phi) - rotation_from_rotvec(phi).T
    np.testing.assert_allclose(odd, R - R.T, rtol=1e-13 + 4e-16 / angle, atol=0)
    half = right_jacobian(phi) - right_jacobian(phi).T
    np.testing.assert_allclose(half, J - J.T, rtol=1e-13 + 4e-16 / angle, atol=0)


def test_many_at_once_are_the_same_as_one_by_one():
    # Small and large angles together go through both branches.
    rng = np.random.default_rng(3)
    phi = rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-9, 0.5, (40, 1))
    rate = rng.normal(size=(40, 3))
    together = body_rotation(phi, rate)
    for i in range(len(phi)):
        for many, one in zip(together, body_rotation(phi[i : i + 1], rate[i : i + 1]), strict=True):
            np.testing.assert_array_equal(many[i], one[0])
    stacked = rotation_from_rotvec(phi.reshape(2, 20, 3))
    np.testing.assert_array_equal(stacked.reshape(-1, 3, 3), rotation_from_rotvec(phi))
    np.testing.assert_array_equal(together[0], rotation_from_rotvec(phi))
    np.testing.assert_allclose(together[1], right_jacobian(phi), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a < np.pi])
@pytest.mark.parametrize("axis", AXES)
def test_logarithm_gives_the_vector_back(angle, axis):
    phi = angle * np.array(axis)
    np.testing.assert_allclose(rotvec_from_rotation(rotation_from_rotvec(phi)), phi, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("short_of", [0.0, *(10.0**e for e in range(-16, -1))])
@pytest.mark.parametrize("axis", [*AXES, (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
def test_logarithm_near_half_a_turn(short_of, axis):
    phi = (np.pi - short_of) * np.array(axis)
    found = rotvec_from_rotation(rotation_from_rotvec(phi))
    found *= np.sign(found @ phi) if short_of < 1e-14 else 1.0  # both ways round are the same there
    np.testing.assert_allclose(found, phi, rtol=0, atol=1e-14)
    assert np.linalg.norm(found) <= np.pi + 1e-15


@pytest.mark.parametrize("angle", TURNS)
def test_logarithm_is_the_shorter_way_round(angle):
    axis = np.array(AXES[1])
    found = rotvec_from_rotation(rotation_from_rotvec(angle * axis))
    shorter = angle if angle <= np.pi else angle - 2 * np.pi
    np.testing.assert_allclose(found, shorter * axis, rtol=0, atol=1e-14)


def test_quaternions_of_rotations():
    rng = np.random.default_rng(4)
    q = rng.normal(size=(200, 4))
    q[:40, 0] = 0.0  # half turns
    q[40:80, 1:3] = 0.0
    q[80:120] *= 10.0 ** rng.uniform(-12, 0, (40, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    found = quaternion_from_rotation(rotation_from_quaternion(q))
    same = np.sign(np.sum(found * q, axis=1, keepdims=True))
    np.testing.assert_allclose(same * found, q, rtol=0, atol=1e-15)
    assert (found[:, 0] >= 0).all()
    np.testing.assert_array_equal(quaternion_from_rotation(np.eye(3)), [1, 0, 0, 0])
    shaped = quaternion_from_rotation(rotation_from_quaternion(q).reshape(4, 50, 3, 3))
    np.testing.assert_array_equal(shaped.reshape(-1, 4), found)


def test_tiny_rotations_keep_their_direction():
    phi = np.array([[1e-9, -2e-9, 2e-9], [3e-17, 0, 4e-17], [0, 0, 0]])
    np.testing.assert_allclose(rotvec_from_rotation(rotation_from_rotvec(phi)), phi, rtol=1e-13, atol=0)


def test_unwrapped_follows_many_turns_about_an_axis_that_leans():
    angle = np.linspace(0.0, 4.9, 60)
    axis = np.stack([0.1 * np.sin(angle), 0.1 * np.cos(angle), np.ones(60)], axis=1)
    truth = angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    wrapped = rotvec_from_rotation(rotation_from_rotvec(truth))
    assert np.linalg.norm(wrapped - truth, axis=1).max() > 1
    np.testing.assert_allclose(unwrap_rotvecs(wrapped), truth, rtol=0, atol=1e-13)


def test_unwrapped_takes_many_tracks_at_once():
    angle = np.linspace(0.1, 5.5, 40)
    tracks = angle[:, None, None] * np.array(AXES) * np.array([1.0, -1.0, 0.5])[:, None]
    wrapped = rotvec_from_rotation(rotation_from_rotvec(tracks))
    np.testing.assert_allclose(unwrap_rotvecs(wrapped), tracks, rtol=0, atol=1e-13)


def test_of_no_rotation_the_branch_lies_along_the_guide():
    guide = np.array([0.0, 6.0, 0.1])
    found = nearest_branch(np.zeros(3), guide)
    np.testing.assert_allclose(found, 2 * np.pi * guide / np.linalg.norm(guide), rtol=1e-15)
    np.testing.assert_array_equal(nearest_branch(np.zeros(3), np.zeros(3)), np.zeros(3))
