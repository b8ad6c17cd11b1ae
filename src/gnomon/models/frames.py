"""Body frames that the accelerometer's sensitivity axes define.

A rotation Q moves the body frame, f_new = Q f_old, and every matrix that acts on body vectors with it:
S_new = S_old Q'. The frame "accel-x" makes the accelerometer's sensitivity lower triangular (the x axis of the body is
the sensitivity axis of the x accelerometer; Kalibr, Krebs), "accel-z" makes it upper triangular (z axis of the
z accelerometer; Tedaldi). See formats and conventions in docs/theory.
"""

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError

Floats = NDArray[np.float64]

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
    turn = np.kron(np.eye(3), rotation)  # dS Q' on the nine entries in row order
    return np.asarray(-np.linalg.solve(_tilt(sensitivity @ rotation.T)[entries], turn[entries]), dtype=np.float64)


def _tilt(matrix: Floats) -> Floats:
    """Return the derivative (9, 3) of the entries of matrix @ Exp(delta), in row order."""
    return np.stack([(matrix @ generator).ravel() for generator in _GENERATORS], axis=1)


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
    turn = np.kron(np.eye(3), rotation)
    delta = frame_turn(matrices[0], rotation, frame)
    for matrix, start in zip(matrices, starts, strict=False):
        if matrix.ndim == 2:
            jacobian[start : start + 9, start : start + 9] = turn
            jacobian[start : start + 9, :9] += _tilt(matrix @ rotation.T) @ delta
    jacobian[[3 * i + j for i, j in fixed_entries(frame)]] = 0.0
    return jacobian
