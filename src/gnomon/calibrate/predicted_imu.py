"""What rests and the rotations between them tell of an IMU, before anything is fitted: one linearisation.

problem, attitudes -> nominal sensor -> normal equations -> covariance -> what one more rest would add
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..estimate.multiposition.bias_functions import walk_precision, with_drift
from ..estimate.multiposition.fit import weak_prior_sigma
from ..estimate.multiposition.measurements import MotionSegments
from ..estimate.multiposition.model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    BiasFunctions,
    MultiPositionData,
    MultiPositionState,
    Whitening,
    linearize_model,
    normal_equations,
)
from ..estimate.multiposition.noise_levels import ExtraVariance, rotation_variance, whitened_rest
from ..estimate.multiposition.problem import MultiPositionProblem, to_physical_units
from ..frozen import value_class
from ..geometry.rotation_vector import rotation_from_rotvec, skew, tangent_basis
from ..recording import Floats
from ..results.calibration import (
    Assessment,
    Calibration,
    Covariance,
    Gravity,
    Provenance,
    covariance_names,
)
from ..results.result import Booleans
from ..solve.least_squares import solve_arrow
from .steps.preparation import imu_calibration

_TURN_S, _TURN_STEPS = 1.5, 24


@value_class
class NominalFit:
    """What a fit would say of a sensor near to an ideal one; see `estimate.multiposition.problem.Fitted`.

    Attributes
    ----------
    state : the ideal sensor, and the attitudes
    joint : covariance of all free parameters, those of the bias in time included
    every_free : whether each of them is estimated
    data : what was linearised
    """

    state: MultiPositionState
    joint: Floats
    every_free: Booleans
    data: MultiPositionData

    @property
    def free(self) -> Booleans:
        """Whether each of the sensor's parameters is estimated, (30,)."""
        return self.every_free[:PARAMETERS]

    @property
    def covariance(self) -> Floats:
        """Of the sensor's parameters, (30, 30)."""
        covariance = np.zeros((len(self.every_free), len(self.every_free)))
        covariance[np.ix_(self.every_free, self.every_free)] = self.joint
        return covariance[:PARAMETERS, :PARAMETERS]


def nominal_fit(
    problem: MultiPositionProblem,
    up: Floats,
    walk: Floats,
    *,
    g_sensitivity: bool,
    rate_unit: float = 1.0,
    rate_bias: Floats | float = 0.0,
) -> NominalFit:
    """Linearise the problem of a nearly ideal sensor once.

    Parameters
    ----------
    problem : of the samples
    up : (n, 3) specific force of each rest [unit of the accelerometer]
    walk : (3,) random walk of the gyroscope's bias, scaled, squared [1/s]
    g_sensitivity : whether it is estimated
    rate_unit : of the gyroscope, about [rad/s]
    rate_bias : what the gyroscope reads at rest [its unit]

    Raises
    ------
    SolveError
        If such attitudes determine no calibration.
    """
    data = with_drift(problem.data)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    accelerometer, gyroscope = problem.accelerometer, problem.gyroscope
    theta = np.zeros(PARAMETERS + 3 * data.drift[0].shape[1])
    theta[S_] = np.diag(size.mean() / accelerometer.spread)[LOWER]
    theta[B_] = -accelerometer.centre / accelerometer.spread
    theta[CG_] = np.diag(gyroscope.spread * rate_unit).ravel()
    theta[BG_] = (rate_bias - gyroscope.centre) / gyroscope.spread
    state = MultiPositionState(theta=theta, u=up / size)
    free = np.ones(len(theta), dtype=bool)
    free[G_] = g_sensitivity
    prior = np.zeros((len(theta), len(theta)))
    prior[:PARAMETERS, :PARAMETERS] = np.diag(weak_prior_sigma(state) ** -2.0)
    prior[PARAMETERS:, PARAMETERS:] = walk_precision(data, walk)
    try:
        lines, whitening = linearize_model(data, state), _whitening(data, state, prior)
        arrow = solve_arrow(normal_equations(lines, whitening, np.zeros(len(theta)), free))
    except np.linalg.LinAlgError as error:
        raise SolveError("such attitudes determine no calibration. Plan more of them, about all axes.") from error
    return NominalFit(state=state, joint=arrow.corner_covariance, every_free=free, data=data)


def _whitening(data: MultiPositionData, state: MultiPositionState, prior: Floats) -> Whitening:
    accelerometer, gyroscope = whitened_rest(data, state, ExtraVariance())
    rotation = data.linked / np.sqrt(rotation_variance(data, state))
    return Whitening(accelerometer=accelerometer, gyroscope=gyroscope, rotation=rotation, prior=prior)


def with_one_more_rest(fit: NominalFit, directions: Floats) -> Iterator[NominalFit]:
    """Yield what the fit would be with one more rest in each direction, turned to from the last rest the short way.

    Parameters
    ----------
    directions : (m, 3) unit vectors of the specific force in the sensor's frame
    """
    known = np.linalg.inv(fit.joint)
    free, size = fit.every_free, len(fit.every_free)
    nothing = np.zeros((size, size))
    for direction in directions:
        data, state = _one_turn(fit, direction)
        lines, whitening = linearize_model(data, state), _whitening(data, state, nothing)
        system = normal_equations(lines, whitening, np.zeros(size), free)
        tight = 1e12 * np.trace(system.diagonal[0]) * np.eye(2)  # where the last rest points is known already
        blocks = np.zeros((4, 4))
        blocks[:2, :2], blocks[2:, 2:] = system.diagonal[0] + tight, system.diagonal[1]
        blocks[:2, 2:] = system.coupling[0]
        blocks[2:, :2] = system.coupling[0].T
        border = system.border.reshape(4, -1)
        more = system.corner - border.T @ np.linalg.solve(blocks, border)
        yield replace(fit, joint=np.linalg.inv(known + 0.5 * (more + more.T)))


def _one_turn(fit: NominalFit, direction: Floats) -> tuple[MultiPositionData, MultiPositionState]:
    """Return the last rest, a turn from it, and a rest in another direction, as the nominal sensor reads them."""
    data, (s, b, c_g, b_g, _) = fit.data, fit.state.matrices
    last = fit.state.u[-1]
    axis = skew(direction) @ last
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, last @ direction))
    axis = axis / sine if sine > 1e-6 else tangent_basis(last[None])[0, :, 0]
    share = (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
    force = last @ rotation_from_rotvec(np.outer(share, axis * angle))
    constant: Floats = np.linalg.solve(c_g, axis * angle / _TURN_S) + b_g
    rate = np.tile(constant, (_TURN_STEPS, 1))
    u = np.array([last, direction])
    hats = np.repeat(data.drift[0][-1:], 2, axis=0)
    turn = MultiPositionData(
        accelerometer=u @ s.T + b,
        gyroscope=np.tile(b_g, (2, 1)),
        accelerometer_variance=np.tile(np.median(data.accelerometer_variance, axis=0), (2, 1)),
        gyroscope_variance=np.tile(np.median(data.gyroscope_variance, axis=0), (2, 1)),
        segments=MotionSegments(
            gyroscope=rate,
            accelerometer=force @ s.T + b,
            dt_s=np.full(_TURN_STEPS, _TURN_S / _TURN_STEPS),
            lengths=np.array([_TURN_STEPS]),
        ),
        rotation_variance=np.median(data.rotation_variance, axis=0)[None],
        linked=np.ones(1, dtype=bool),
        interval_s=np.zeros(2),
        rotation_s=np.zeros(1),
        span_s=(0.0, 1.0),
        earth_rate_variance=data.earth_rate_variance,
        sampling_variance=data.sampling_variance,
        gyroscope_functions=BiasFunctions(
            at_rest=hats, in_motion=hats[:1], kind=data.of_gyroscope.kind, sigma=data.of_gyroscope.sigma
        ),
    )
    return turn, MultiPositionState(theta=fit.state.theta, u=u)


def predicted_calibration(
    fit: NominalFit,
    problem: MultiPositionProblem,
    gravity: Gravity,
    *,
    units: Mapping[str, str],
    latitude: float | None = None,
    found: int = 0,
    provenance: Provenance,
) -> Calibration:
    """Return the calibration that a fit would publish, with its covariance.

    Parameters
    ----------
    units : of "accelerometer" and "gyroscope"
    latitude : [deg], where it is known
    found : rests, of which some may not be used
    """
    estimate = to_physical_units(
        fit,
        problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity.value,
        gravity_sigma_m_s2=gravity.sigma,
        latitude_deg=latitude,
    )
    imus = {"imu0": imu_calibration(replace(estimate, g_sensitivity=np.zeros((3, 3))), units)}
    used = len(fit.state.u)
    return Calibration(
        imus=imus,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=estimate.covariance),
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model="g-sensitivity" if fit.free[G_].all() else "basic",
            intervals_found=found,
            intervals_used=used,
            rotations_found=max(found - 1, 0),
            rotations_used=int(problem.data.linked.sum()),
        ),
        provenance=provenance,
    )
