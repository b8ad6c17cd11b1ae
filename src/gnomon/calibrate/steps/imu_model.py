"""Which model of the gyroscope's bias a multi-position recording asks for."""

import numpy as np

from ...assess.priors import SCALARS, Prior, Priors
from ...errors import OptionError
from ...estimate.multiposition.bias_changes import BiasChanges
from ...estimate.multiposition.evidence import (
    LeaveOneOutErrors,
    as_table,
    free_jacobian,
    imu_models,
    leave_one_out,
    segment_sums,
)
from ...estimate.multiposition.fit import Knowledge, MultiPositionFit, fit_multiposition
from ...estimate.multiposition.model import MultiPositionState
from ...estimate.multiposition.problem import ImuEstimate, MultiPositionProblem, blocks_of_scalars, sensor_scalars
from ...estimate.trust.changes import estimates_are_judged
from ...estimate.trust.clusters import correlation_time, group_into_clusters, leave_clusters_out
from ...frozen import value_class
from ...options import ImuOptions
from ...recording import Floats
from ...results.trust import ModelStep
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_OF_IMU = slice(0, 33)
_FIXED_SIGMA = 1e-7  # of what the scaled parameters move a scalar by: as good as nothing


def scaled_prior(
    found: Prior | None, problem: MultiPositionProblem, *, gravity_m_s2: float, latitude_deg: float | None
) -> Knowledge | None:
    """Return the prior on the scaled parameters, or None where nothing is known."""
    if not found:
        return None

    def at(state: MultiPositionState) -> tuple[Floats, Floats]:
        """Return precision (30, 30) and information (30,) of theta at a state."""
        values, jacobian = sensor_scalars(
            state, problem.accelerometer, problem.gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=latitude_deg
        )
        precision, information = (part[_OF_IMU] for part in found.quadratic(np.append(values, np.zeros(SCALARS - 33))))
        precision = precision[:, _OF_IMU].copy()
        reach = np.linalg.norm(jacobian, axis=1)
        held = np.flatnonzero(found.fixed[_OF_IMU] & (reach > 0))
        tight = (_FIXED_SIGMA * reach[held]) ** -2
        precision[held, held] += tight
        information = information.copy()
        information[held] += tight * found.value[held]
        theta = state.theta[: jacobian.shape[1]]
        weighted = jacobian.T @ precision
        return weighted @ jacobian, jacobian.T @ information - weighted @ (values - jacobian @ theta)

    return at


def with_fixed(estimate: ImuEstimate, found: Prior | None) -> ImuEstimate:
    """Return the estimate with what was held fixed exactly where it was held, and certain."""
    if found is None:
        return estimate
    held = np.flatnonzero(found.fixed[_OF_IMU])
    if not len(held):
        return estimate
    values, covariance = estimate.values, estimate.covariance.copy()
    values[held] = found.value[held]
    covariance[held] = covariance[:, held] = 0.0
    sensitivity, bias, gyro_sensitivity, gyro_bias, g_sensitivity = np.split(values, [9, 12, 21, 24])
    return ImuEstimate(
        accelerometer_sensitivity=sensitivity.reshape(3, 3),
        accelerometer_bias=bias,
        gyroscope_sensitivity=gyro_sensitivity.reshape(3, 3),
        gyroscope_bias=gyro_bias,
        g_sensitivity=g_sensitivity.reshape(3, 3),
        covariance=covariance,
    )


def is_evidence_stated(options: ImuOptions, prior: Priors) -> bool:
    """Return whether somebody states what is known beforehand, or what shall not be taken from it."""
    return bool(prior or options.fix or options.free or options.prior)


def refuse_evidence(options: ImuOptions, prior: Priors) -> None:
    """Refuse evidence for a published method, which knows no use of it.

    Raises
    ------
    OptionError
        If there is any.
    """
    if is_evidence_stated(options, prior):
        raise OptionError(
            f"preset {options.preset} knows neither --prior nor --fix nor --free. "
            "Leave them out, or use the default preset."
        )


_G = slice(24, 33)  # g-sensitivity among what may be known
_G_PATH = "imu0.gyroscope.g_sensitivity"


@value_class
class ChosenModel:
    """The model taken, its fit, and what speaks for it.

    Attributes
    ----------
    fit, heldout : with the model taken
    rivals : model -> errors of intervals and rotations that were left out
    steps : what each step of the model brings
    """

    fit: MultiPositionFit
    heldout: LeaveOneOutErrors
    rivals: dict[str, LeaveOneOutErrors]
    steps: tuple[ModelStep, ...]


def choose_model(
    problem: MultiPositionProblem,
    options: ImuOptions,
    known: Prior | None,
    *,
    units: dict[str, str],
    gravity_m_s2: float,
    walk: Floats | None,
    course: BiasChanges | None,
) -> ChosenModel:
    """Fit with g-sensitivity, and keep it where clusters of time that were left out prove it or somebody says so.

    `course` is how the accelerometer's bias changed, where that is known already.
    """
    beforehand = scaled_prior(known, problem, gravity_m_s2=gravity_m_s2, latitude_deg=options.latitude)

    def fitted(*, g_sensitivity: bool, before: MultiPositionFit | None = None) -> MultiPositionFit:
        changes = (None, course) if before is None else before.changes
        return fit_multiposition(
            problem.data, g_sensitivity=g_sensitivity, known=beforehand, walk=walk, changes=changes
        )

    if known and known.fixed[_G].all() and not known.value[_G].any():
        fit = fitted(g_sensitivity=False)
        heldout = leave_one_out(fit)
        return ChosenModel(fit=fit, heldout=heldout, rivals={"basic": heldout}, steps=())
    stated = {"basic": False, "g-sensitivity": True}.get(options.model)
    if (known and known.knows(_G_PATH)) or _G_PATH in options.free:
        stated = stated is not False
    fit = fitted(g_sensitivity=True)
    judged = stated is None or estimates_are_judged()
    steps = _steps(problem, fit, units, gravity_m_s2, stated) if judged else ()
    taken = "g-sensitivity" if stated or any(step.used for step in steps if step.name == "g-sensitivity") else "basic"
    largest = leave_one_out(fit)
    if taken == "basic":
        fit = fitted(g_sensitivity=False, before=fit)
    rivals = {"g-sensitivity": largest}
    if judged or taken == "basic":
        rivals["basic"] = leave_one_out(fit, g_sensitivity=False)
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
    sums = segment_sums(fit)
    moves = leave_clusters_out(sums) @ jacobian.T
    clusters = group_into_clusters(sums, correlation_time(moves, np.repeat(np.arange(5), [9, 3, 9, 3, 9])))[0][0]
    nominal, functions = _nominal(problem, units, gravity_m_s2), (fit.data.of_gyroscope, fit.data.of_accelerometer)
    steps = imu_models(clusters, fit.state, nominal, g_sensitivity=stated, functions=functions)
    return as_table(steps, jacobian, blocks_of_scalars(values), forced=stated is not None)


def _nominal(problem: MultiPositionProblem, units: dict[str, str], gravity_m_s2: float) -> Floats | None:
    """Return the scaled parameters (6,) of nominal scales; None where a triad counts."""
    force, rate = ACCELEROMETER_UNITS_M_S2[units["accelerometer"]], GYROSCOPE_UNITS_RAD_S[units["gyroscope"]]
    if force is None or rate is None:
        return None
    return np.append(gravity_m_s2 / force / problem.accelerometer.spread, rate * problem.gyroscope.spread)
