"""How a camera turned from image to image, by the rays to points that it followed.

Of two images the rotation R and the direction t of the way between them make each pair of rays and t lie in a plane,
t . (R b1 x b2) = 0: the essential matrix, found so that most pairs of rays agree.
"""

import cv2
import numpy as np

from ...ahead import results_ahead
from ...frozen import value_class
from ...geometry.quaternion import rk4n_steps, rotation_from_quaternion, running_products
from ...geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ...recording import Floats, Integers
from ..camera_imu.start.alignment import gyroscope_integral
from ..camera_imu.start.board_poses import BoardPoses
from ..camera_imu.start.first_guess import ImuStream
from ..camera_imu.terms.corner_sums import Exposures

FEWEST_SHARED = 15
"""Points that two images must share."""

_TRUSTED = 0.999
_ROUNDS, _ROBUST = 4, 2.0
_SENSITIVITY, _BIAS_RAD_S, _G_SENSITIVITY = 0.02, 0.2, 2e-3


def turns_between(
    rays: Floats, pairs: list[tuple[Integers, Integers]], tolerance: float
) -> tuple[Floats, Floats, np.ndarray]:
    """Return rotations from the earlier camera frame to the later one, of pairs of images.

    Parameters
    ----------
    rays : (m, 3) towards all sightings
    pairs : for each pair of images, the sightings (k,) of the points in both
    tolerance : how far a ray may be off [rad]

    Returns
    -------
    R : (p, 3, 3) identity where it cannot be told
    moved : (p,) median angle between the rays, as they are [rad]
    known : (p,) whether it can be told
    """
    found = list(results_ahead(lambda pair: _turn_between(rays[pair[0]], rays[pair[1]], tolerance), pairs))
    R, moved, known = (np.array(part) for part in zip(*found, strict=True))
    return R.reshape(-1, 3, 3), moved, known


def _turn_between(first: Floats, second: Floats, tolerance: float) -> tuple[Floats, float, bool]:
    """Return what `turns_between` does, of the rays (k, 3) that two images share."""
    ahead = (first[:, 2] > 0.1) & (second[:, 2] > 0.1)
    a, b = first[ahead], second[ahead]
    if len(a) < FEWEST_SHARED:
        return np.eye(3), 0.0, False
    moved = float(np.median(np.linalg.norm(a - b, axis=1)))
    before, after = (np.ascontiguousarray(side[:, :2] / side[:, 2:]) for side in (a, b))
    matrix, inside = cv2.findEssentialMat(
        before, after, np.eye(3), method=cv2.USAC_MAGSAC, prob=_TRUSTED, threshold=tolerance
    )
    if np.shape(matrix) != (3, 3):
        return np.eye(3), moved, False
    count, R, _, _ = cv2.recoverPose(matrix, before, after, np.eye(3), mask=inside)
    return np.asarray(R, np.float64), moved, count >= FEWEST_SHARED


def turning_poses(t_s: Floats, R: Floats, known: np.ndarray) -> BoardPoses:
    """Return the attitudes of a camera, from the first image on, as the alignment with a gyroscope takes them.

    Parameters
    ----------
    t_s : (n,) timestamps [s]
    R : (n - 1, 3, 3) rotation from each camera frame to the next
    known : (n - 1,) whether it is one; elsewhere the camera seems to stand still, for which the alignment is robust
    """
    attitudes = np.empty((len(t_s), 3, 3))
    attitudes[0] = np.eye(3)
    for k, turn in enumerate(R):
        attitudes[k + 1] = turn @ attitudes[k]
    count = len(t_s)
    empty = np.empty((0, 3))
    return BoardPoses(
        exposures=Exposures(
            frame=np.arange(count),
            start=np.zeros(count + 1, np.int64),
            points=empty,
            pixels=empty[:, :2],
            delay_rows=np.zeros(count),
        ),
        t_s=t_s,
        R_cam_target=attitudes,
        p_cam_target=np.zeros((count, 3)),
        rotation_covariance=np.tile(np.eye(3), (count, 1, 1)),
        scatter_px=np.ones(count),
        sigma_px=1.0,
    )


@value_class
class SeenTurns:
    """Rotations R (p, 3, 3) of the IMU from instants to later ones, v_earlier = R v_later, as a camera saw them.

    `start_s` and `stop_s` (p,) are on the IMU's clock.
    """

    start_s: Floats
    stop_s: Floats
    R: Floats


def attitudes_of(rate: Floats, t_s: Floats, at_s: Floats) -> Floats:
    """Return the attitudes (k, 3, 3) at instants (k,) by angular rates (n, 3) at t_s, relative to that at the first."""
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(t_s))
    products = running_products(steps, np.array([len(steps)]))
    R = rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))
    before = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 1)
    return R[before] @ rotation_from_rotvec(rate[before] * (at_s - t_s[before])[:, None])


def rates_by_camera(turns: SeenTurns, stream: ImuStream) -> Floats:
    """Return angular rates (n, 3) [rad/s] at the readings: the gyroscope's, corrected by what the camera saw.

    Sensitivity, bias and g-sensitivity would turn the path by degrees within a minute; 21 numbers mend most of it.
    """
    columns = np.concatenate([stream.rate, np.ones((len(stream.rate), 1)), stream.force], axis=1)
    usual = np.tile(np.concatenate([np.full(3, _SENSITIVITY), [_BIAS_RAD_S], np.full(3, _G_SENSITIVITY)]) ** -2.0, 3)
    correction = np.zeros((3, 7))
    for _ in range(_ROUNDS):
        rate = stream.rate + columns @ correction.T
        R = attitudes_of(rate, stream.t_s, stream.t_s)
        # a correction of the rate turns the world axes by the integral of R times it
        by_world = (R[:, :, :, None] * columns[:, None, None, :]).reshape(len(R), 3, 21)
        integral = gyroscope_integral(stream.t_s, by_world.reshape(len(R), 63))
        ends = [attitudes_of(rate, stream.t_s, at) for at in (turns.start_s, turns.stop_s)]
        off = rotvec_from_rotation(ends[0] @ turns.R @ np.swapaxes(ends[1], 1, 2))
        J = (integral(turns.stop_s) - integral(turns.start_s)).reshape(-1, 3, 21)
        length = np.linalg.norm(off, axis=1)
        sigma = float(np.median(length)) / 1.54
        weight = np.minimum(1.0, _ROBUST * sigma / np.maximum(length, 1e-12)) ** 2 / sigma**2
        weighted = J * weight[:, None, None]
        H = np.einsum("pai,paj->ij", weighted, J) + np.diag(usual)
        correction += np.linalg.solve(H, np.einsum("pai,pa->i", weighted, off) - usual * correction.ravel()).reshape(
            3, 7
        )
    return stream.rate + columns @ correction.T
