"""What a comparison finds in the poses of cameras: inverses of each other, and time shifts of opposite sign."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from ..findings import Finding
from ..geometry.rotation_vector import rotvec_from_rotation
from ..geometry.so3 import inverse
from ..recording import Floats
from .candidates import Candidate

_INVERSE = 0.1  # share of the distance that is left when one pose is inverted
_ARM_M = 0.1  # what a turn of one radian moves, for adding turns and distances
_SHIFT_S = 1e-3


def pose_findings(candidates: Sequence[Candidate]) -> Iterator[Finding]:
    """Recognise poses that are the inverse of each other, and time shifts of opposite sign."""
    for first, second in combinations(candidates, 2):
        for name in [name for name in first.cameras if name in second.cameras]:
            one, other = first.cameras[name], second.cameras[name]
            if one.body != other.body:
                continue
            distance = _distance(one.T_cam_body, other.T_cam_body)
            if _distance(inverse(one.T_cam_body), other.T_cam_body) < _INVERSE * distance:
                yield _inverted(name, first.name, second.name, one.link)
            shifts = one.time_shift_cam_imu, other.time_shift_cam_imu
            if min(map(abs, shifts)) > _SHIFT_S and abs(sum(shifts)) < _INVERSE * abs(shifts[0] - shifts[1]):
                yield Finding(
                    severity="problem",
                    code="shift-sign",
                    message=f"The time shifts of {name} in {first.name} and {second.name} have opposite signs: "
                    f"{1e3 * shifts[0]:.3f} and {1e3 * shifts[1]:.3f} ms.",
                    consequence="One of them is t_cam - t_imu.",
                    cure="t_imu = t_cam + time_shift_cam_imu, in gnomon, Kalibr, VINS (td) and Basalt.",
                )


def _inverted(camera: str, first: str, second: str, link: str) -> Finding:
    with_imu = link == "T_cam_imu"
    return Finding(
        severity="problem",
        code="pose-inverted",
        message=f"{link} of {camera} in {first} is nearly the inverse of that in {second}.",
        consequence=f"One of them maps the other way{', camera to IMU' if with_imu else ''}, and stands under the name "
        "of its inverse.",
        cure="p_cam = T_cam_imu p_imu. Write the inverse under T_imu_cam, which is read as well."
        if with_imu
        else f"p_cam = {link} p_cam0, and from each camera to the next p_cn = T_cn_cnm1 p_cnm1.",
    )


def _distance(first: Floats, second: Floats) -> float:
    """Return how far two poses lie apart, turns and distances added [rad]."""
    angle = float(np.linalg.norm(rotvec_from_rotation(first[:3, :3].T @ second[:3, :3])))
    return angle + float(np.linalg.norm(first[:3, 3] - second[:3, 3])) / _ARM_M
