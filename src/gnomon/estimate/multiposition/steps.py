"""The models of an IMU one by one: biases, scales, misalignments, g-sensitivity, a bias that wanders."""

from collections.abc import Sequence

import numpy as np

from ...recording import Floats
from ...results.trust import BlockChange, ModelStep
from ..trust.clusters import CandidateBlock, CandidateStep, ClusterSums, model_steps
from .model import B_, BG_, CG_, G_, PARAMETERS, S_, BiasFunctions, MultiPositionState

_SCALES = np.array([S_.start, S_.start + 2, S_.start + 5, CG_.start, CG_.start + 4, CG_.start + 8])
_ANGLES = np.setdiff1d(np.r_[S_, CG_], _SCALES)
_OFFSETS = np.r_[B_, BG_]


def imu_models(
    sums: ClusterSums,
    state: MultiPositionState,
    scales: Floats | None,
    *,
    g_sensitivity: bool | None,
    functions: tuple[BiasFunctions, BiasFunctions],
) -> tuple[CandidateStep, ...]:
    """Return what each step of the model brings, by predicting clusters of time that were left out.

    Scales and misalignments are estimated whatever they bring: they are what is calibrated. Whether biases drift is
    found out before, by tests of their own.

    Parameters
    ----------
    sums : of clusters, over all parameters of `state`
    state : where the full model stands
    scales : (6,) scaled parameters of a sensor with nominal scales, accelerometer first; None where a count means
        nothing without a calibration
    g_sensitivity : whether it is in the model; None where the recording decides
    functions : of time that the gyroscope's and the accelerometer's bias follow, whose coefficients come last
    """
    theta = state.theta
    steps = [
        CandidateBlock(name="misalignment", columns=_ANGLES, away=-theta[_ANGLES], forced=True),
        CandidateBlock(name="g-sensitivity", columns=np.r_[G_], away=-theta[G_], forced=g_sensitivity),
    ]
    always = _OFFSETS
    if scales is None:
        always = np.sort(np.r_[_OFFSETS, _SCALES])
    else:
        steps.insert(0, CandidateBlock(name="scale", columns=_SCALES, away=scales - theta[_SCALES], forced=True))
    first = PARAMETERS
    for function, triad in zip(functions, ("", "accelerometer "), strict=True):
        columns = np.arange(first, first + 3 * len(function.kind))
        first += len(columns)
        stepping = np.repeat(function.of_kind("step", "single"), 3)
        warm = np.repeat(function.of_kind("temperature", "warming", "curve"), 3)
        kinds = {"drift": columns[~(stepping | warm)], "temperature": columns[warm], "bias steps": columns[stepping]}
        for name, own in kinds.items():
            if len(own):
                steps.append(CandidateBlock(name=triad + name, columns=own, away=-theta[own], forced=True))
    return model_steps(sums, always, steps)


def as_table(
    steps: Sequence[CandidateStep], jacobian: Floats, blocks: Sequence[tuple[str, Floats, str]], *, forced: bool
) -> tuple[ModelStep, ...]:
    """Return the steps with what each moved.

    Parameters
    ----------
    jacobian : (m, p) of the scalars by the parameters
    blocks : path, factor (m,) by which its scalars are shown and 0 for others, and unit
    forced : whether a person chose the g-sensitivity
    """
    return tuple(
        ModelStep(
            name=step.candidate.name,
            parameters=len(step.candidate.columns),
            gain=step.gain,
            gain_sigma=step.gain_sigma,
            needed=step.needed if step.candidate.name == "g-sensitivity" else 0.0,
            used=step.used,
            forced=forced and step.candidate.name == "g-sensitivity",
            changes=_changes(step, jacobian, blocks),
        )
        for step in steps
    )


def _changes(
    step: CandidateStep, jacobian: Floats, blocks: Sequence[tuple[str, Floats, str]]
) -> tuple[BlockChange, ...]:
    moved = jacobian @ step.change
    sigma = np.nan_to_num(step.sigma)
    found: list[BlockChange] = []
    for path, factor, unit in blocks:
        columns = np.any(jacobian[factor != 0] != 0, axis=0) & (sigma > 0)
        if not columns.any() or not np.any(step.change[columns]):
            continue
        found.append(
            BlockChange(
                block=path,
                change=float(np.abs(factor * moved).max()),
                unit=unit,
                sigmas=float(np.max(np.abs(step.change[columns]) / sigma[columns])),
            )
        )
    return tuple(sorted(found, key=lambda change: -change.sigmas))
