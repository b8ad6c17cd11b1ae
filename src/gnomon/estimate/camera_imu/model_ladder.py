"""The steps from the basic model to the largest one (B16): which scalars of the border each of them adds."""

from collections.abc import Mapping

import numpy as np

from ...geometry.rotation_vector import rotvec_from_rotation
from ...recording import Floats, Integers
from ...results.trust import BlockChange, ModelStep
from ..trust.clusters import ClusterSums
from ..trust.model_choice import CandidateBlock, CandidateStep, model_steps
from .choices import K3
from .layout import BorderLayout
from .parameters import RigParameters

ARMS, DELAY = "lever arms", "accelerometer delay"

LADDER = {
    "scale": ("S_a", "S_g"),
    "misalignment": ("M_a", "M_g", "q_bg"),
    "g-sensitivity": ("B_g",),
    ARMS: ("lever_arms",),
    DELAY: ("accelerometer_shift",),
    "intrinsics": ("intrinsics", "distortion_coeffs"),
    "k3": (),
}
"""Step -> blocks, of every sensor that has them; k3 is the last coefficient of radtan5. An accelerometer that has
timestamps of its own has a delay in every model."""

EXTRAS = (DELAY, "intrinsics", "k3")
"""Steps beyond the model of the IMU."""

_CHANGES = 3
"""Blocks that a step is said to have moved."""


def evaluate_nested_models(
    sums: ClusterSums,
    layout: BorderLayout,
    parameters: RigParameters,
    forced: Mapping[str, bool],
    least: Mapping[str, float],
) -> tuple[ModelStep, ...]:
    """Return what each step brings on clusters of time that were left out, in their order.

    Parameters
    ----------
    sums : of clusters longer than the residuals' memory, over the columns of `layout`
    layout, parameters : where the sums were made
    forced : step -> whether it is in the model, of those on which the recording does not decide
    least : step -> gain of the log-likelihood that it must bring, however certain it is
    """
    candidates = [
        CandidateBlock(
            name=name,
            columns=columns,
            away=_away(layout, parameters)[columns],
            forced=forced.get(name),
            least=least.get(name, 0.0),
        )
        for name in LADDER
        if len(columns := step_columns(layout, name))
    ]
    inside = np.concatenate([np.zeros(0, np.int64), *(candidate.columns for candidate in candidates)])
    free = layout.free_index
    biases = np.arange(layout.dense, sums.pull.shape[1])
    always = np.concatenate([np.setdiff1d(free[free < layout.dense], inside), biases])
    return tuple(_told(step, layout) for step in model_steps(sums, always, candidates))


def step_columns(layout: BorderLayout, name: str) -> Integers:
    """Return the columns of a step's blocks."""
    found = [
        column
        for block, columns in layout.columns.items()
        if block.partition(".")[2] in LADDER[name]
        for column in range(columns.start, columns.stop)
        if not layout.names[column].endswith(K3) and not _has_own_stamps(layout, block, name)
    ]
    if name == "k3":
        found = [column for column, scalar in enumerate(layout.names) if scalar.endswith(K3)]
    return np.array(found, dtype=np.int64)


def _has_own_stamps(layout: BorderLayout, block: str, name: str) -> bool:
    """Tell whether a block is the delay of an accelerometer with timestamps of its own."""
    return name == DELAY and layout.start.imus[int(block.partition(".")[0].removeprefix("imu"))].apart


def _away(layout: BorderLayout, parameters: RigParameters) -> Floats:
    """Return the step (p,) from present values to those of a model without the block.

    An IMU without the block is ideal; everything else keeps its start value.
    """
    away = layout.prior_mean - layout.values(parameters)
    for i, imu in enumerate(parameters.imus):
        ideal = {
            "S_a": 1 - imu.S_a,
            "S_g": 1 - imu.S_g,
            "M_a": -imu.M_a,
            "M_g": -imu.M_g,
            "q_bg": -rotvec_from_rotation(imu.C_bg),
            "B_g": -imu.B_g.ravel(),
        }
        for block, step in ideal.items():
            if (columns := layout.get(f"imu{i}.{block}")) is not None:
                away[columns] = step
    return away


def _told(step: CandidateStep, layout: BorderLayout) -> ModelStep:
    own = set(step.candidate.columns.tolist())
    changes: list[BlockChange] = []
    for block, columns in layout.columns.items():
        if columns.start >= layout.dense or own & set(range(columns.start, columns.stop)):
            continue
        sigmas = np.abs(step.change[columns]) / step.sigma[columns]
        if not np.isfinite(sigmas).any():
            continue
        worst = columns.start + int(np.nanargmax(sigmas))
        changes.append(
            BlockChange(
                block=block,
                change=float(step.change[worst]),
                unit=layout.units[worst],
                sigmas=float(np.nanmax(sigmas)),
            )
        )
    changes.sort(key=lambda change: -change.sigmas)
    return ModelStep(
        name=step.candidate.name,
        parameters=len(step.candidate.columns),
        gain=step.gain,
        gain_sigma=step.gain_sigma,
        needed=step.needed,
        used=step.used,
        forced=step.candidate.forced is not None,
        changes=tuple(changes[:_CHANGES]),
    )
