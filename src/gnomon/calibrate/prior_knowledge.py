"""What is known beforehand, for the multi-position problem in its scaled units."""

import numpy as np

from ..errors import OptionError
from ..estimate.multiposition.fit import Knowledge
from ..estimate.multiposition.model import State
from ..estimate.multiposition.problem import MultiPositionProblem
from ..estimate.multiposition.scaling import ImuEstimate, sensor_scalars
from ..evidence import SCALARS, Evidence, Priors
from ..options import ImuOptions
from ..recording import Floats

_OF_IMU = slice(0, 33)
_FIXED_SIGMA = 1e-7  # of what the scaled parameters move a scalar by: as good as nothing


def knowledge(
    found: Evidence, problem: MultiPositionProblem, *, gravity_m_s2: float, latitude_deg: float | None
) -> Knowledge | None:
    """Return the prior on the scaled parameters, or None where nothing is known."""
    if not found:
        return None

    def at(state: State) -> tuple[Floats, Floats]:
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


def with_fixed(estimate: ImuEstimate, found: Evidence) -> ImuEstimate:
    """Return the estimate with what was held fixed exactly where it was held, and certain."""
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


def refuse_evidence(options: ImuOptions, prior: Priors) -> None:
    """Refuse evidence for a published method, which knows no use of it.

    Raises
    ------
    OptionError
        If there is any.
    """
    if prior or options.fix or options.free or options.prior:
        raise OptionError(
            f"preset {options.preset} knows neither --prior nor --fix nor --free. "
            "Leave them out, or use the default preset."
        )
