"""What a comparison finds in the poses of sensors: inverses of each other, and time shifts of opposite sign."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..findings import Finding, make_finding
from ..geometry.rotation_vector import rotvec_from_rotation
from ..geometry.so3 import inverse
from ..recording import Floats
from .candidates import Candidate

_INVERSE = 0.1  # share of the distance that is left when one pose is inverted
_ARM_M = 0.1  # what a turn of one radian moves, for adding turns and distances
_SHIFT_S = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Placed:
    """A sensor with its pose: `link` is the name of T, p_sensor = T p_body, `shift` that of its time shift."""

    T: Floats
    shift_s: float
    link: str
    body: str
    shift: str


def pose_findings(candidates: Sequence[Candidate]) -> Iterator[Finding]:
    """Recognise poses that are the inverse of each other, and time shifts of opposite sign."""
    for first, second in combinations(candidates, 2):
        ones, others = _placed(first), _placed(second)
        for name in [name for name in ones if name in others]:
            one, other = ones[name], others[name]
            if one.body != other.body:
                continue
            distance = _distance(one.T, other.T)
            if _distance(inverse(one.T), other.T) < _INVERSE * distance:
                yield _inverted(name, first.name, second.name, one.link)
            shifts = one.shift_s, other.shift_s
            if min(map(abs, shifts)) > _SHIFT_S and abs(sum(shifts)) < _INVERSE * abs(shifts[0] - shifts[1]):
                yield make_finding(
                    "shift-sign",
                    name=name,
                    first=first.name,
                    second=second.name,
                    first_s=shifts[0],
                    second_s=shifts[1],
                    opposite=_OPPOSITE[one.shift],
                    signs=_SIGNS[one.shift],
                )


def _placed(candidate: Candidate) -> dict[str, _Placed]:
    """Return the sensors of a calibration that have a pose: cameras, and IMUs beside imu0."""
    placed = {
        name: _Placed(
            T=imu.T_imu_body, shift_s=imu.time_shift_s, link="T_imu_body", body="imu0", shift="time_shift_imu"
        )
        for name, imu in candidate.imus.items()
        if imu.T_imu_body is not None
    }
    return placed | {
        name: _Placed(
            T=camera.T_cam_body,
            shift_s=camera.time_shift_cam_imu,
            link=camera.link,
            body=camera.body,
            shift="time_shift_cam_imu",
        )
        for name, camera in candidate.cameras.items()
    }


_OPPOSITE = {
    "time_shift_cam_imu": "One of them is t_cam - t_imu.",
    "time_shift_imu": "One of them is t_imu - t_imu0.",
}
_SIGNS = {
    "time_shift_cam_imu": "t_imu = t_cam + time_shift_cam_imu, in gnomon, Kalibr, VINS (td) and Basalt.",
    "time_shift_imu": "t_imu0 = t_imu + time_shift_imu, in gnomon, and as time_offset in Kalibr.",
}
_OTHER_WAY = {"T_cam_imu": ", camera to IMU", "T_imu_body": ", to imu0"}
_POSES = {
    "T_cam_imu": "p_cam = T_cam_imu p_imu. Write the inverse under T_imu_cam, which is read as well.",
    "T_cam_cam0": "p_cam = T_cam_cam0 p_cam0, and from each camera to the next p_cn = T_cn_cnm1 p_cnm1.",
    "T_imu_body": "p_imu = T_imu_body p_imu0, which Kalibr calls T_i_b.",
}


def _inverted(sensor: str, first: str, second: str, link: str) -> Finding:
    return make_finding(
        "pose-inverted",
        link=link,
        sensor=sensor,
        first=first,
        second=second,
        other_way=_OTHER_WAY.get(link, ""),
        convention=_POSES.get(link, _POSES["T_cam_cam0"]),
    )


def _distance(first: Floats, second: Floats) -> float:
    """Return how far two poses lie apart, turns and distances added [rad]."""
    angle = float(np.linalg.norm(rotvec_from_rotation(first[:3, :3].T @ second[:3, :3])))
    return angle + float(np.linalg.norm(first[:3, 3] - second[:3, 3])) / _ARM_M
