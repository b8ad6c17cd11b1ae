"""What a camera-IMU model most likely lacks, where its errors are larger than independent errors would be."""

from collections.abc import Mapping

import numpy as np

from ..diagnostics import SignalFit
from ..estimate.camera_imu.residual_patterns import Pattern, board_evidence, corner_correlation, lens_evidence
from ..estimate.camera_imu.solution import Solution

_CHANCE, _SHARE = 0.01, 0.02
_LASTING = 0.2
"""Correlation of a corner's residuals in frames that follow each other, from which on they are no noise."""
_COLOURED = 0.2
"""Correlation of neighbouring residuals of an IMU: of white noise it is a little below zero."""


def likely_missing(solution: Solution, signals: Mapping[str, SignalFit]) -> list[str]:
    """Return what the residuals of corners and IMU show, as parts of a sentence.

    Parameters
    ----------
    solution : the estimate
    signals : "imu0.accelerometer", ... -> readings and what the estimate predicts
    """
    found: list[str] = []
    if _there(board := board_evidence(solution)):
        found.append(
            f"corners that stay off their places on the board by {board.rms_px:.2g} px in all frames (a bad print, a "
            "bent board, or a bias of the detector)"
        )
    if _there(lens := lens_evidence(solution)):
        found.append(
            f"a lens that is not quite the stated one, {lens.rms_px:.2g} px off in the same parts of all images"
        )
    if not found and (lasting := _lasting(solution)) > _LASTING:
        found.append(
            "errors of the detector that depend on attitude and distance, or a lens that its model cannot follow (a "
            f"corner's residual is correlated by {lasting:.2g} from frame to frame)"
        )
    for name, fit in signals.items():
        correlation = neighbours(fit)
        if correlation > _COLOURED:
            found.append(
                f"vibration, or motion faster than the trajectory's knots, in {name} (neighbouring residuals are "
                f"correlated by {correlation:.2g})"
            )
    return found


def _lasting(solution: Solution) -> float:
    """Return the largest correlation, of any camera, of a corner's residual with that in the next frame."""
    return max((found.over_time[0] for found in corner_correlation(solution).values()), default=0.0)


def neighbours(fit: SignalFit) -> float:
    """Return the correlation of neighbouring residuals of a triad."""
    residual = (fit.measured - fit.predicted)[fit.used]
    power = float(np.sum(residual**2))
    return float(np.sum(residual[1:] * residual[:-1])) / power if power > 0 else 0.0


def _there(pattern: Pattern) -> bool:
    return pattern.chance < _CHANCE and pattern.share > _SHARE
