"""Whether places and clocks of cameras and of IMUs beside the first are known well enough for anything."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..diagnostics import CameraImuDiagnostics
from ..findings import Finding, make_finding
from .verdict import graded


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits:
    """Standard deviations beyond which a word is due, and beyond which a result is of no use; factor for people."""

    word: str
    warn: float
    fail: float
    factor: float
    unit: str


_ROTATION = _Limits(word="rotation", warn=np.radians(0.1), fail=np.radians(1.0), factor=180 / np.pi, unit="deg")
_TRANSLATION = _Limits(word="translation", warn=5e-3, fail=5e-2, factor=1e3, unit="mm")
_TIME_SHIFT = _Limits(word="time shift", warn=5e-4, fail=5e-3, factor=1e3, unit="ms")


def precision_findings(
    diagnostics: CameraImuDiagnostics, imus: tuple[str, ...], cameras: tuple[str, ...]
) -> Iterator[Finding]:
    """Judge the standard deviations of poses and time shifts.

    Parameters
    ----------
    diagnostics : with the scalars of the estimation
    imus : those beside the first
    cameras : all of them
    """
    sigma = {parameter.name: parameter.sigma for parameter in diagnostics.parameters}
    placed = [(name, "T_cam_imu", "time_shift_cam_imu", "the IMU") for name in cameras]
    placed += [(name, "T_imu_body", "time_shift", "imu0") for name in imus]
    for name, link, shift, body in placed:
        turn, way = ([f"{link}.{part}[{k}]" for k in range(3)] for part in ("rotation", "translation"))
        for limits, scalars in ((_ROTATION, turn), (_TRANSLATION, way), (_TIME_SHIFT, [shift])):
            largest = max(sigma[f"{name}.{scalar}"] for scalar in scalars)
            severity = graded(largest, limits.warn, limits.fail)
            if severity == "good":
                continue
            known = f"{limits.factor * largest:.2g} {limits.unit}"
            yield make_finding("imprecise/rig", severity=severity, word=limits.word, name=name, body=body, known=known)
