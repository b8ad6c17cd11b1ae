"""Hamilton quaternions (w, x, y, z), and the kinematics of Tedaldi, section 3.4.2.

Quaternions describe R_world_body: v_world = q v_body q*, and grow on the right with the body's angular rate,
q' = 1/2 q (0, omega), which is Eq. (3.10).
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Complexes = NDArray[np.complex128]


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
