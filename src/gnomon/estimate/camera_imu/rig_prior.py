"""What was known beforehand of the cameras together: their poses to cam0, along with their lenses.

With l the lenses' scalars and b the poses, both as small deviations from what was known, and P their joint covariance,

    b given l:  mean  K l,  K = P_bl P_ll^-1,     covariance  P_bb - K P_lb

so that the residual b - K l and the prior of the lenses are independent, and together are the joint prior. A lens and
the rotation between two cameras hang together closely: a principal point that is off by a pixel turns the camera.
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix, right_jacobian, rotvec_from_rotation, skew
from ...recording import Floats, KnownRig
from .layout import BorderLayout, lenses_of
from .parameters import RigParameters

_POSE = 6


@value_class
class RigResidual:
    """Poses against what was known of them.

    Attributes
    ----------
    names : (k,) scalars, such as "cam1.T_cam_cam0.rotation[0]"
    residual : (k,) small rotations [rad] and differences of translations [m]
    jacobian : (k, p) derivative by a step of the border's scalars
    """

    names: tuple[str, ...]
    residual: Floats
    jacobian: Floats


def pose_residual(rig: KnownRig, layout: BorderLayout, parameters: RigParameters) -> RigResidual:
    """Return how far the poses of the cameras to cam0 are from what was known."""
    names: list[str] = []
    residual: list[Floats] = []
    jacobian: list[Floats] = []
    cameras = {entry.name: entry for entry in parameters.cameras}
    for name, known in rig.T_cam_cam0.items():
        one, other = cameras["cam0"], cameras[name]
        R = other.R_cam_imu @ one.R_cam_imu.T
        turn = rotvec_from_rotation(known[:3, :3].T @ R)
        moved = other.p_cam_imu - R @ one.p_cam_imu - known[:3, 3]
        straight = invert_matrix(right_jacobian(turn)) @ one.R_cam_imu
        around = R @ skew(one.p_cam_imu) @ one.R_cam_imu
        rows = np.zeros((_POSE, len(layout)))
        for block, by_turn, by_place in (("cam0", (-straight, -around), -R), (name, (straight, around), np.eye(3))):
            if (columns := layout.get(f"{block}.T_cam_imu.rotation")) is not None:
                rows[:3, columns], rows[3:, columns] = by_turn
            if (columns := layout.get(f"{block}.T_cam_imu.translation")) is not None:
                rows[3:, columns] = by_place
        names += [f"{name}.T_cam_cam0.{part}[{k}]" for part in ("rotation", "translation") for k in range(3)]
        residual += [turn, moved]
        jacobian.append(rows)
    empty = np.zeros((0, len(layout)))
    return RigResidual(
        names=tuple(names),
        residual=np.concatenate(residual) if residual else np.empty(0),
        jacobian=np.vstack(jacobian) if jacobian else empty,
    )


def from_known(rig: KnownRig, layout: BorderLayout, parameters: RigParameters) -> RigResidual:
    """Return how far all that is known of the cameras together, lenses and poses, is from what was known."""
    poses = pose_residual(rig, layout, parameters)
    column = {name: i for i, name in enumerate(layout.names)}
    lenses = [name for name in lenses_of(rig, parameters)[0] if name in column]
    at = [column[name] for name in lenses]
    away = layout.values(parameters) - layout.prior_mean
    return RigResidual(
        names=(*lenses, *poses.names),
        residual=np.concatenate([away[at], poses.residual]),
        jacobian=np.vstack([np.eye(len(layout))[at], poses.jacobian]),
    )


def rig_prior(layout: BorderLayout, parameters: RigParameters) -> tuple[Floats, Floats, float]:
    """Return information (p, p) and pull (p,) of what is known of the poses, given the lenses, and its cost."""
    rig, size = layout.start.rig, len(layout)
    if rig is None or not rig.T_cam_cam0:
        return np.zeros((size, size)), np.zeros(size), 0.0
    found = pose_residual(rig, layout, parameters)
    lenses, of_lenses = lenses_of(rig, parameters)
    place = {name: i for i, name in enumerate(rig.names)}
    at, told = [place[name] for name in found.names], [place[name] for name in lenses]
    known = np.flatnonzero(np.diag(of_lenses) > 0)
    lenses, told = [lenses[i] for i in known], [told[i] for i in known]
    gain = np.linalg.solve(of_lenses[np.ix_(known, known)], rig.covariance[np.ix_(told, at)]).T
    covariance = rig.covariance[np.ix_(at, at)] - gain @ rig.covariance[np.ix_(told, at)]
    column = {name: i for i, name in enumerate(layout.names)}
    away, jacobian = layout.values(parameters) - layout.prior_mean, found.jacobian.copy()
    residual = found.residual.copy()
    for i, name in enumerate(lenses):
        if name in column:
            residual -= gain[:, i] * away[column[name]]
            jacobian[:, column[name]] -= gain[:, i]
    scale = 1 / np.sqrt(np.diag(covariance))
    whole = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    return jacobian.T @ whole @ jacobian, -jacobian.T @ whole @ residual, 0.5 * float(residual @ whole @ residual)
