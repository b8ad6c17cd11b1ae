"""Rotations: as matrices, as Hamilton quaternions and as rotation vectors; what the points of a turning body feel.

Quaternions (w, x, y, z) describe R_world_body: v_world = q v_body q*, and grow on the right with the body's angular
rate, q' = 1/2 q (0, omega), which is Eq. (3.10) of Tedaldi, section 3.4.2.

Of rotation vectors here are the exponential map, its inverse, and the derivatives that a spline of them needs. With
R = Exp(phi) = exp([phi]x) and theta = |phi|,

    Exp(phi + d) = Exp(phi) Exp(Jr(phi) d) + O(d^2),     Jr(phi) = I - b [phi]x + c [phi]x^2,

    b = (1 - cos theta) / theta^2,   c = (theta - sin theta) / theta^3.

Where phi changes with time, Jr(phi) phi' is the angular rate in the turning body's frame. The chart has its
singularity at theta = 2 pi.

Body frames are those that the accelerometer's sensitivity axes define. A rotation Q moves the body frame,
f_new = Q f_old, and every matrix that acts on body vectors with it: S_new = S_old Q'. The frame "accel-x" makes the
accelerometer's sensitivity lower triangular (the x axis of the body is the sensitivity axis of the x accelerometer;
Kalibr, Krebs), "accel-z" makes it upper triangular (z axis of the z accelerometer; Tedaldi). See formats and
conventions in docs/theory.
"""

from math import factorial

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Complexes = NDArray[np.complex128]


def skew(v: Floats) -> Floats:
    """Return [v]x, (..., 3, 3), with skew(v) @ w = v x w, of vectors (..., 3)."""
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def tangent_basis(u: Floats) -> Floats:
    """Return two orthonormal vectors perpendicular to each unit vector, as columns: (..., 3) -> (..., 3, 2)."""
    first = _crossed(u, np.eye(3)[np.abs(u).argmin(axis=-1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, _crossed(u, first)], axis=-1)


def _crossed(a: Floats, b: Floats) -> Floats:
    """Return a x b of vectors (..., 3), for few of which `np.cross` takes several times as long."""
    following, last = [1, 2, 0], [2, 0, 1]
    return a[..., following] * b[..., last] - a[..., last] * b[..., following]


def invert_matrix(matrix: Floats) -> Floats:
    """Return the inverse of matrices (..., 3, 3)."""
    return np.linalg.inv(matrix).astype(np.float64, copy=False)


def kronecker_product(a: Floats, b: Floats) -> Floats:
    """Return what `np.kron` does of two matrices, which takes many times as long for small ones."""
    blocks = a[:, None, :, None] * b[:, None, :]
    return blocks.reshape(len(a) * len(b), -1)


def nearest_rotation(matrix: Floats) -> Floats:
    """Return the rotations (..., 3, 3), det +1, nearest to matrices in the Frobenius norm (Kabsch)."""
    left, _, right = np.linalg.svd(matrix)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right, dtype=np.float64)


def quaternion_product(a_wxyz: Floats, b_wxyz: Floats) -> Floats:
    """Return the Hamilton product, Eq. (2.14), of quaternions (..., 4)."""
    return np.moveaxis(_times(np.moveaxis(a_wxyz, -1, 0), np.moveaxis(b_wxyz, -1, 0)), 0, -1)


def _times(a: Floats, b: Floats) -> Floats:
    """Return the Hamilton product with components first, (4, ...); without temporary arrays it is six times faster."""
    product = np.empty((4, *np.broadcast_shapes(a.shape[1:], b.shape[1:])))
    term = np.empty(product.shape[1:])
    for k, terms in enumerate(_HAMILTON):
        component = product[k, ...]  # a view, of single quaternions too
        np.multiply(a[0], b[terms[0][1]], out=component)
        for i, j, add in terms[1:]:
            np.multiply(a[i], b[j], out=term)
            add(component, term, out=component)
    return product


_HAMILTON = (
    ((0, 0, np.add), (1, 1, np.subtract), (2, 2, np.subtract), (3, 3, np.subtract)),
    ((0, 1, np.add), (1, 0, np.add), (2, 3, np.add), (3, 2, np.subtract)),
    ((0, 2, np.add), (1, 3, np.subtract), (2, 0, np.add), (3, 1, np.add)),
    ((0, 3, np.add), (1, 2, np.add), (2, 1, np.subtract), (3, 0, np.add)),
)
"""Eq. (2.14): for each component w, x, y, z of the product, the components of both factors and their sign."""


def rotation_from_quaternion(q_wxyz: Floats) -> Floats:
    """Return rotation matrices (..., 3, 3), Eq. (2.13), of unit quaternions (..., 4)."""
    a, b, c, d = np.moveaxis(q_wxyz, -1, 0)
    rotation = np.empty((*q_wxyz.shape[:-1], 3, 3))
    rotation[..., 0, 0] = a * a + b * b - c * c - d * d
    rotation[..., 0, 1] = 2 * (b * c - a * d)
    rotation[..., 0, 2] = 2 * (b * d + a * c)
    rotation[..., 1, 0] = 2 * (b * c + a * d)
    rotation[..., 1, 1] = a * a - b * b + c * c - d * d
    rotation[..., 1, 2] = 2 * (c * d - a * b)
    rotation[..., 2, 0] = 2 * (b * d - a * c)
    rotation[..., 2, 1] = 2 * (c * d + a * b)
    rotation[..., 2, 2] = a * a - b * b - c * c + d * d
    return rotation


def quaternion_from_rotation(rotation: Floats) -> Floats:
    """Return unit quaternions (..., 4), w >= 0, of rotations (..., 3, 3).

    The products 4 q_i q_j are sums of the matrix's elements; the row of the largest q_i gives all four without loss.
    """
    R = rotation
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    products = np.empty((*R.shape[:-2], 4, 4))
    products[..., 0, 0] = 1 + trace
    for i in range(3):
        products[..., i + 1, i + 1] = 1 - trace + 2 * R[..., i, i]
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., 0, i + 1] = products[..., i + 1, 0] = R[..., k, j] - R[..., j, k]
        products[..., j + 1, k + 1] = products[..., k + 1, j + 1] = R[..., j, k] + R[..., k, j]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    q = normalise_quaternion(q)
    return np.where(q[..., :1] < 0, -q, q)


def normalise_quaternion(q_wxyz: Floats) -> Floats:
    """Return q / |q|, Eq. (3.16), of quaternions (..., 4)."""
    return q_wxyz / np.sqrt(np.einsum("...i,...i->...", q_wxyz, q_wxyz))[..., None]


def rk4n_steps(omega0: Floats, omega1: Floats, dt_s: Floats) -> Floats:
    """Return the quaternions by which RK4n, Eqs. (3.12)-(3.16), turns the attitude in single steps, (..., 4).

    The differential equation is linear in q, so that every step of the classical Runge-Kutta method is a product
    with a quaternion that depends on the rates alone: q_{k+1} = q_k p_k. Normalising p_k normalises q_{k+1}. The steps
    of a whole recording are thus found at once.

    Parameters
    ----------
    omega0, omega1 : (..., 3) [rad/s], rates at both ends of the step; between them the rate is linear in time
    dt_s : (...,) [s]
    """
    half = 0.5 * np.asarray(dt_s)
    start, end = np.zeros((2, 4, *omega0.shape[:-1]))  # dt f(1, t) at c = 0 and c = 1
    start[1:], end[1:] = half * np.moveaxis(omega0, -1, 0), half * np.moveaxis(omega1, -1, 0)
    middle = 0.5 * (start + end)
    k1 = start
    k2 = _times(k1, middle)
    k2 *= 0.5
    k2 += middle
    k3 = _times(k2, middle)
    k3 *= 0.5
    k3 += middle
    k4 = _times(k3, end)
    k4 += end
    step = k2
    step += k3
    step *= 2
    step += k1
    step += k4
    step /= 6
    step[0] += 1.0
    step /= np.sqrt(np.einsum("i...,i...->...", step, step))  # Eq. (3.16)
    return np.moveaxis(step, 0, -1)


_BLOCK = 16  # steps that are multiplied one after the other, in all blocks at once


def running_products(steps_wxyz: Floats, lengths: Integers) -> Floats:
    """Return the running products of segments of steps, each segment starting from the identity.

    The product is associative: segments are cut into blocks, the running products of all blocks are found at once, and
    each block is multiplied from the left with what came before it in its segment.

    Parameters
    ----------
    steps_wxyz : (n, 4), the segments one after the other
    lengths : (m,) number of steps of each segment, summing to n

    Returns
    -------
    (n, 4) : at each step, the product of the steps of its segment up to and including it
    """
    blocks = -(-lengths // _BLOCK)
    place = np.arange(len(steps_wxyz)) + np.repeat(
        _BLOCK * (np.cumsum(blocks) - blocks) - (np.cumsum(lengths) - lengths), lengths
    )
    w, x, y, z = steps_wxyz.T
    padded = np.zeros((2, int(blocks.sum()) * _BLOCK), dtype=np.complex128)
    padded[0] = 1.0
    padded[0, place], padded[1, place] = w + 1j * x, y + 1j * z
    grid = np.ascontiguousarray(padded.reshape(2, -1, _BLOCK).transpose(0, 2, 1))  # part, step, block
    for k in range(1, _BLOCK):
        grid[:, k] = _times_as_pairs(grid[:, k - 1], grid[:, k])
    before = _products_before(grid[:, -1], blocks)
    first, second = _times_as_pairs(before[:, None], grid).transpose(0, 2, 1).reshape(2, -1)[:, place]
    return np.moveaxis(np.stack([first.real, first.imag, second.real, second.imag]), 0, -1)


def _times_as_pairs(a: Complexes, b: Complexes) -> Complexes:
    """Return the Hamilton product of quaternions q = first + second j, Eqs. (2.9)-(2.10): (2, ...) complex.

    With j z = conj(z) j a product takes four complex multiplications, in a quarter of the calls on short arrays.
    """
    product = np.empty((2, *np.broadcast_shapes(a.shape[1:], b.shape[1:])), dtype=np.complex128)
    np.multiply(a[0], b[0], out=product[0])
    product[0] -= a[1] * np.conjugate(b[1])
    np.multiply(a[0], b[1], out=product[1])
    product[1] += a[1] * np.conjugate(b[0])
    return product


def _products_before(totals: Complexes, lengths: Integers) -> Complexes:
    """Return for each block (2, n) the product of those before it in its segment, by Hillis and Steele's scan."""
    position = np.arange(totals.shape[1]) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    products = np.empty_like(totals)
    products[:, 1:] = totals[:, :-1]
    products[:, position == 0] = np.array([[1.0], [0.0]])
    reach, longest = 1, int(lengths.max(initial=0))
    while reach < longest:
        later = np.flatnonzero(position >= reach)
        products[:, later] = _times_as_pairs(products[:, later - reach], products[:, later])
        reach *= 2
    return products


_SERIES_BELOW = 0.25
"""theta^2 below which the series are used: there they are exact, and above it the closed forms lose two digits only."""
_BEND_SERIES_BELOW = 2.0
_TERMS = 9


def _series(coefficients: list[float], x: Floats) -> Floats:
    """Return sum_n coefficients[n] x^n."""
    total = np.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total *= x
        total += coefficient
    return total


_A = [(-1) ** n / factorial(2 * n + 1) for n in range(_TERMS)]
_B = [(-1) ** n / factorial(2 * n + 2) for n in range(_TERMS)]
_C = [(-1) ** n / factorial(2 * n + 3) for n in range(_TERMS)]
_B_SLOPE = [(-1) ** n * 2 * n / factorial(2 * n + 2) for n in range(1, _TERMS + 1)]
_C_SLOPE = [(-1) ** n * 2 * n / factorial(2 * n + 3) for n in range(1, _TERMS + 1)]
_B_BEND = [(-1) ** n * 4 * n * (n - 1) / factorial(2 * n + 2) for n in range(2, _TERMS + 4)]
_C_BEND = [(-1) ** n * 4 * n * (n - 1) / factorial(2 * n + 3) for n in range(2, _TERMS + 4)]


def _coefficients(squared: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return a = sin(theta)/theta, b, c, and the slopes b'/theta, c'/theta, of theta^2."""
    small = squared < _SERIES_BELOW
    x = np.where(small, 1.0, squared)
    theta = np.sqrt(x)
    sine, versine = np.sin(theta), 2 * np.sin(theta / 2) ** 2
    closed = (
        sine / theta,
        versine / x,
        (theta - sine) / (x * theta),
        (theta * sine - 2 * versine) / (x * x),
        (theta * versine - 3 * (theta - sine)) / (x * x * theta),
    )
    if not small.any():
        return closed
    near = np.where(small, squared, 0.0)
    a, b, c, b_slope, c_slope = (
        np.where(small, _series(series, near), form)
        for series, form in zip((_A, _B, _C, _B_SLOPE, _C_SLOPE), closed, strict=True)
    )
    return a, b, c, b_slope, c_slope


def rotation_from_rotvec(phi: Floats) -> Floats:
    """Return Exp(phi), (..., 3, 3), of rotation vectors (..., 3) [rad]."""
    a, b, *_ = _coefficients(_squared(phi))
    return np.eye(3) + a[..., None, None] * skew(phi) + b[..., None, None] * _skew_squared(phi)


def right_jacobian(phi: Floats) -> Floats:
    """Return Jr(phi), (..., 3, 3), of rotation vectors (..., 3) [rad]."""
    _, b, c, *_ = _coefficients(_squared(phi))
    return np.eye(3) - b[..., None, None] * skew(phi) + c[..., None, None] * _skew_squared(phi)


def body_rotation(phi: Floats, phi_rate: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return how a body turns whose rotation vector changes.

    Parameters
    ----------
    phi : (n, 3) [rad]
    phi_rate : (n, 3) its time derivative [rad/s]

    Returns
    -------
    rotation : (n, 3, 3) Exp(phi)
    jacobian : (n, 3, 3) Jr(phi)
    omega : (n, 3) angular rate in the body's frame, Jr(phi) phi_rate [rad/s]
    omega_by_phi : (n, 3, 3) derivative of omega by phi [1/s]
    """
    a, b, c, b_slope, c_slope = (value[:, None, None] for value in _coefficients(_squared(phi)))
    cross, cross_squared = skew(phi), _skew_squared(phi)
    rotation = np.eye(3) + a * cross + b * cross_squared
    jacobian = np.eye(3) - b * cross + c * cross_squared
    once = np.matmul(cross, phi_rate[:, :, None])
    twice = np.matmul(cross, once)
    row, column = phi[:, None, :], phi[:, :, None]
    rate_row, rate_column = phi_rate[:, None, :], phi_rate[:, :, None]
    by_phi = b * skew(phi_rate) - b_slope * (once * row) + c_slope * (twice * row)
    by_phi += c * (column * rate_row - 2 * (rate_column * row))
    by_phi += np.eye(3) * (c * np.matmul(row, rate_column))
    omega = phi_rate - b[:, :, 0] * once[:, :, 0] + c[:, :, 0] * twice[:, :, 0]
    return rotation, jacobian, omega, by_phi


def angular_acceleration_by_phi(phi: Floats, phi_rate: Floats, phi_acceleration: Floats) -> Floats:
    """Return the derivative of the angular acceleration by the rotation vector, (n, 3, 3) [1/s^2].

    With omega = Jr(phi) phi' and W = d omega / d phi the angular acceleration in the body's frame is
    alpha = W phi' + Jr phi''. Its derivative by phi' is 2 W - [omega]x Jr, by phi'' it is Jr.

    Parameters
    ----------
    phi : (n, 3) [rad]
    phi_rate, phi_acceleration : (n, 3) its time derivatives [rad/s], [rad/s^2]
    """
    return body_rotation(phi, phi_acceleration)[3] + _bent(phi, phi_rate)


def _bent(phi: Floats, v: Floats) -> Floats:
    """Return the derivative by phi of (d(Jr(phi) v) / d phi) v, with v held, (n, 3, 3)."""
    x = _squared(phi)
    _, _, c, b_slope, c_slope = (value[:, None, None] for value in _coefficients(x))
    b_bend, c_bend = (value[:, None, None] for value in _bends(x))
    row, column = phi[:, None, :], phi[:, :, None]
    v_row, v_column = v[:, None, :], v[:, :, None]
    along, length = np.matmul(row, v_column), np.matmul(v_row, v_column)
    once = np.matmul(skew(phi), v_column)
    twice = column * along - x[:, None, None] * v_column
    bent = b_slope * (along * skew(v) - once * v_row) - b_bend * along * (once * row)
    bent += c_bend * along * (twice * row) + c_slope * (twice * v_row + (column * length - v_column * along) * row)
    bent += c_slope * along * (along * np.eye(3) + column * v_row - 2 * v_column * row)
    return bent + c * (length * np.eye(3) - v_column * v_row)


def _bends(squared: Floats) -> tuple[Floats, Floats]:
    """Return (b'/theta)'/theta and (c'/theta)'/theta of theta^2; the series hold further than those of the slopes."""
    small = squared < _BEND_SERIES_BELOW
    x = np.where(small, 1.0, squared)
    theta = np.sqrt(x)
    sine, versine = np.sin(theta), 2 * np.sin(theta / 2) ** 2
    b_closed = (x * (1 - versine) - 5 * theta * sine + 8 * versine) / x**3
    c_closed = (x * sine - 7 * theta * versine + 15 * (theta - sine)) / (x**3 * theta)
    near = np.where(small, squared, 0.0)
    return np.where(small, _series(_B_BEND, near), b_closed), np.where(small, _series(_C_BEND, near), c_closed)


def rotvec_from_rotation(rotation: Floats) -> Floats:
    """Return the rotation vectors (..., 3) of rotations (..., 3, 3), with |phi| <= pi; also at half a turn."""
    q = quaternion_from_rotation(rotation)
    length = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2 * np.arctan2(length, q[..., 0])
    tiny = length < 1e-7
    factor = np.where(tiny, 2.0, angle / np.where(tiny, 1.0, length))
    return factor[..., None] * q[..., 1:]


def nearest_branch(phi: Floats, guide: Floats) -> Floats:
    """Return, of all rotation vectors of the same rotations, the ones nearest to a guide; all (..., 3) [rad]."""
    length = np.linalg.norm(phi, axis=-1, keepdims=True)
    along = np.linalg.norm(guide, axis=-1, keepdims=True)
    fallback = guide / np.where(along > 0, along, 1.0)
    axis = np.where(length > 1e-9, phi / np.where(length > 1e-9, length, 1.0), fallback)
    turns = np.rint((np.sum(axis * guide, axis=-1, keepdims=True) - length) / (2 * np.pi))
    return phi + 2 * np.pi * turns * axis


def unwrap_rotvecs(phi: Floats) -> Floats:
    """Return rotation vectors (n, ..., 3) [rad] that change continuously along the first axis.

    Each is put on the branch nearest to its predecessor; neighbours must be much less than half a turn apart.
    """
    result = phi.copy()
    for i in range(1, len(phi)):
        result[i] = nearest_branch(phi[i], result[i - 1])
    return result


def _squared(phi: Floats) -> Floats:
    return np.einsum("...i,...i->...", phi, phi)


def _skew_squared(phi: Floats) -> Floats:
    """Return [phi]x^2 = phi phi' - |phi|^2 I."""
    return phi[..., :, None] * phi[..., None, :] - _squared(phi)[..., None, None] * np.eye(3)


def acceleration_by_place(omega: Floats, alpha: Floats) -> Floats:
    """Return A = [alpha]x + [omega]x^2, (n, 3, 3): the point at r is accelerated by A r more than the body's origin.

    Parameters
    ----------
    omega, alpha : (n, 3) angular rate [rad/s] and acceleration [rad/s^2], body frame
    """
    turned = omega[:, :, None] * omega[:, None, :]
    return skew(alpha) + turned - np.trace(turned, axis1=1, axis2=2)[:, None, None] * np.eye(3)


def along_axes(A: Floats, places: Floats) -> Floats:
    """Return e_k' A r_k, (n, 3): what the k-th of three sensors feels more than the body's origin, along axis k.

    Parameters
    ----------
    A : (n, 3, 3), see `acceleration_by_place`
    places : (3, 3) r_k, one row each [m]
    """
    return np.asarray(np.einsum("nkj,kj->nk", A, places), dtype=np.float64)


def inverse_pose(T: Floats) -> Floats:
    """Return the inverse of a rigid transformation (4, 4) [m], of T_cam_imu such as T_imu_cam."""
    R = T[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, -R @ T[:3, 3]
    return pose


_FIXED_ENTRIES = {"accel-x": ((0, 1), (0, 2), (1, 2)), "accel-z": ((1, 0), (2, 0), (2, 1))}
"""Entries of the accelerometer's sensitivity that a frame makes zero."""


def fixed_entries(frame: str) -> tuple[tuple[int, int], ...]:
    """Return the (row, column) entries of the accelerometer's sensitivity that `frame` makes zero.

    Raises
    ------
    OptionError
        If the frame is neither "accel-x" nor "accel-z".
    """
    if frame not in _FIXED_ENTRIES:
        raise OptionError(f'body frame "{frame}" is not known here. Choose accel-x or accel-z.')
    return _FIXED_ENTRIES[frame]


def frame_rotation(sensitivity: Floats, frame: str) -> Floats:
    """Return Q (3, 3), det +1, with f_new = Q f_old such that sensitivity @ Q.T has the form of `frame`.

    The diagonal of the new sensitivity is positive if sensitivity has a positive determinant; otherwise the axis whose
    sign cannot be fixed keeps its minus, since a left-handed frame is never made silently.

    Raises
    ------
    OptionError
        If the frame is neither "accel-x" nor "accel-z".
    """
    fixed_entries(frame)
    rows = sensitivity if frame == "accel-x" else sensitivity[::-1]
    # Gram-Schmidt by QR: rows' = Q_r R, so rows = R' Q_r' with R' lower triangular.
    q, r = np.linalg.qr(rows.T)
    axes = (q * np.sign(np.diag(r))).T
    if frame == "accel-z":
        axes = axes[::-1]
    if np.linalg.det(axes) < 0:
        weakest = 2 if frame == "accel-x" else 0
        axes[weakest] = -axes[weakest]
    return axes


_GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]],
    dtype=float,
)
"""[e]x of the three unit vectors."""


def frame_turn(sensitivity: Floats, rotation: Floats, frame: str) -> Floats:
    """Return by which small rotation delta the frame turns when the accelerometer's sensitivity changes, (3, 9) [rad].

    Q' becomes Q' Exp(delta) such that the entries that the frame fixes stay zero: with S_new = S Q' and a perturbation
    dS, dS_new = dS Q' + S_new [delta]x, three linear equations for delta.

    Parameters
    ----------
    sensitivity : (3, 3), of the accelerometer in the old frame; the columns of the result are its entries in row order
    rotation : (3, 3), from `frame_rotation`
    """
    entries = [3 * i + j for i, j in fixed_entries(frame)]
    turn = kronecker_product(np.eye(3), rotation)  # dS Q' on the nine entries in row order
    return np.asarray(-np.linalg.solve(_tilt(sensitivity @ rotation.T)[entries], turn[entries]), dtype=np.float64)


def _tilt(matrix: Floats) -> Floats:
    """Return the derivative (9, 3) of the entries of matrix @ Exp(delta), in row order."""
    return np.ascontiguousarray((matrix @ _GENERATORS).reshape(3, 9).T)


def rotation_jacobian(matrices: list[Floats], rotation: Floats, frame: str) -> Floats:
    """Return the Jacobian (n, n) of all scalars of one IMU under a change to `frame`, which depends on them.

    Parameters
    ----------
    matrices : accelerometer sensitivity (3, 3) and bias (3,), optionally gyroscope sensitivity (3, 3), bias (3,),
        g_sensitivity (3, 3), in the old frame
    rotation : (3, 3), from `frame_rotation`
    """
    starts = np.concatenate([[0], np.cumsum([m.size for m in matrices])])
    jacobian = np.eye(starts[-1])
    turn = kronecker_product(np.eye(3), rotation)
    delta = frame_turn(matrices[0], rotation, frame)
    for matrix, start in zip(matrices, starts, strict=False):
        if matrix.ndim == 2:
            jacobian[start : start + 9, start : start + 9] = turn
            jacobian[start : start + 9, :9] += _tilt(matrix @ rotation.T) @ delta
    jacobian[[3 * i + j for i, j in fixed_entries(frame)]] = 0.0
    return jacobian
