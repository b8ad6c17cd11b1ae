"""Which model of the gyroscope's bias a multi-position recording asks for."""

from dataclasses import dataclass

import numpy as np

from ..estimate.multiposition.bias_changes import BiasChanges
from ..estimate.multiposition.fit import MultiPositionFit, fit_multiposition
from ..estimate.multiposition.leave_one_out import HeldOut, leave_one_out
from ..estimate.multiposition.problem import MultiPositionProblem
from ..estimate.multiposition.scaling import blocks_of_scalars, sensor_scalars
from ..estimate.multiposition.steps import as_table, imu_models
from ..estimate.multiposition.sums import free_jacobian, stretch_sums
from ..estimate.trust.robust import clustered, memory
from ..evidence import Evidence
from ..options import ImuOptions
from ..recording import Floats
from ..trust import ModelStep
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .prior_knowledge import knowledge

_G = slice(24, 33)  # g-sensitivity among what may be known
_G_PATH = "imu0.gyroscope.g_sensitivity"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChosenModel:
    """The model taken, its fit, and what speaks for it.

    Attributes
    ----------
    fit, heldout : with the model taken
    rivals : model -> errors of intervals and rotations that were left out
    steps : what each step of the model brings
    """

    fit: MultiPositionFit
    heldout: HeldOut
    rivals: dict[str, HeldOut]
    steps: tuple[ModelStep, ...]


def choose_model(
    problem: MultiPositionProblem,
    options: ImuOptions,
    known: Evidence,
    *,
    units: dict[str, str],
    gravity_m_s2: float,
    walk: Floats | None,
    course: BiasChanges | None,
) -> ChosenModel:
    """Fit with g-sensitivity, and keep it where clusters of time that were left out prove it or somebody says so.

    `course` is how the accelerometer's bias changed, where that is known already.
    """
    beforehand = knowledge(known, problem, gravity_m_s2=gravity_m_s2, latitude_deg=options.latitude)

    def fitted(*, g_sensitivity: bool, before: MultiPositionFit | None = None) -> MultiPositionFit:
        changes = (None, course) if before is None else before.changes
        return fit_multiposition(
            problem.data, g_sensitivity=g_sensitivity, known=beforehand, walk=walk, changes=changes
        )

    if known.fixed[_G].all() and not known.value[_G].any():
        fit = fitted(g_sensitivity=False)
        heldout = leave_one_out(fit)
        return ChosenModel(fit=fit, heldout=heldout, rivals={"basic": heldout}, steps=())
    stated = {"basic": False, "g-sensitivity": True}.get(options.model)
    if known.knows(_G_PATH) or _G_PATH in options.free:
        stated = stated is not False
    fit = fitted(g_sensitivity=True)
    steps = _steps(problem, fit, units, gravity_m_s2, stated)
    rivals = {
        "basic": leave_one_out(fit, g_sensitivity=False),
        "g-sensitivity": leave_one_out(fit),
    }
    taken = "g-sensitivity" if next(step.used for step in steps if step.name == "g-sensitivity") else "basic"
    if taken == "basic":
        fit = fitted(g_sensitivity=False, before=fit)
        rivals["basic"] = leave_one_out(fit)
    return ChosenModel(fit=fit, heldout=rivals[taken], rivals=rivals, steps=steps)


def _steps(
    problem: MultiPositionProblem,
    fit: MultiPositionFit,
    units: dict[str, str],
    gravity_m_s2: float,
    stated: bool | None,
) -> tuple[ModelStep, ...]:
    """Return what each step of the model brings, by clusters of static intervals and rotations."""
    values, jacobian = sensor_scalars(
        fit.state, problem.accelerometer, problem.gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=None
    )
    jacobian = free_jacobian(fit, jacobian)
    sums = stretch_sums(fit)
    clusters = clustered(sums, memory(sums, jacobian, np.repeat(np.arange(5), [9, 3, 9, 3, 9])))[0][0]
    nominal, functions = _nominal(problem, units, gravity_m_s2), (fit.data.of_gyroscope, fit.data.of_accelerometer)
    steps = imu_models(clusters, fit.state, nominal, g_sensitivity=stated, functions=functions)
    return as_table(steps, jacobian, blocks_of_scalars(values), forced=stated is not None)


def _nominal(problem: MultiPositionProblem, units: dict[str, str], gravity_m_s2: float) -> Floats | None:
    """Return the scaled parameters (6,) of nominal scales; None where a triad counts."""
    force, rate = ACCELEROMETER_UNITS_M_S2[units["accelerometer"]], GYROSCOPE_UNITS_RAD_S[units["gyroscope"]]
    if force is None or rate is None:
        return None
    return np.append(gravity_m_s2 / force / problem.accelerometer.spread, rate * problem.gyroscope.spread)
