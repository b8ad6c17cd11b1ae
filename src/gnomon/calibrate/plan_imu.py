"""What a planned multi-position recording would tell: the fit's own normal equations at the truth, no noise drawn.

plan -> exact samples and rests -> problem with the stated noise -> linearise once -> what it would publish
"""

from dataclasses import dataclass

import numpy as np

from .._version import __version__
from ..assess.checks.protocol import find_imu_rests
from ..detect.samples.rests import Rests
from ..errors import SolveError
from ..estimate.multiposition.drift import walk_precision, with_drift
from ..estimate.multiposition.fit import weak_prior_sigma
from ..estimate.multiposition.model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    MultiPositionState,
    Whitening,
    linearize_model,
    normal_equations,
)
from ..estimate.multiposition.noise_levels import ExtraVariance, rotation_variance, whitened_rest
from ..estimate.multiposition.problem import MultiPositionProblem, TriadStream, build_problem
from ..estimate.multiposition.scaling import to_physical_units
from ..models.gravity import EARTH_RATE_RAD_S
from ..models.noise import ImuNoise
from ..options import ImuOptions
from ..recording import Floats, ImuSamples, TriadSamples
from ..results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ..results.intervals import Booleans, interval_means
from ..simulate.planned import planned_rests
from ..simulate.plans import ImuPlan
from ..simulate.truth import changed_options
from ..solve.arrow import solve_arrow
from .steps.preparation import local_gravity


def planned_imu(plan: ImuPlan, noise: ImuNoise, seed: int = 0) -> Calibration:
    """Return the calibration that a planned recording would give of an ideal IMU, with its covariance.

    Parameters
    ----------
    plan : see there
    noise : of the IMU
    seed : of the attitudes

    Raises
    ------
    SolveError
        If such attitudes determine no calibration.
    """
    gravity = local_gravity(ImuOptions(gravity=plan.gravity, latitude=plan.latitude))
    problem, up, rests = _planned_problem(plan, noise, gravity.value, seed)
    walk = (noise.gyroscope_random_walk / problem.gyroscope.spread) ** 2
    fit = _at_the_truth(problem, up, walk, g_sensitivity=plan.model == "g-sensitivity")
    estimate = to_physical_units(
        fit,
        problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity.value,
        gravity_sigma_m_s2=gravity.sigma,
        latitude_deg=plan.latitude,
    )
    eye, zero = np.eye(3), np.zeros(3)
    imus = {
        "imu0": ImuCalibration(
            accelerometer=AccelerometerCalibration(sensitivity=eye, bias=zero, unit="m/s^2"),
            gyroscope=GyroscopeCalibration(sensitivity=eye, bias=zero, g_sensitivity=np.zeros((3, 3)), unit="rad/s"),
        )
    }
    return Calibration(
        imus=imus,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=estimate.covariance),
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model=plan.model,
            intervals_found=len(rests),
            intervals_used=len(up),
            rotations_found=len(rests) - 1,
            rotations_used=len(up) - 1,
        ),
        provenance=Provenance(gnomon_version=__version__, method="plan", options=changed_options(plan), seed=seed),
    )


def _planned_problem(
    plan: ImuPlan, noise: ImuNoise, gravity_m_s2: float, seed: int
) -> tuple[MultiPositionProblem, Floats, Rests]:
    """Return the problem of exact samples with the stated noise, the specific force (n, 3) of each rest, and the rests.

    The rests are those that a calibration would find in the samples with their noise.
    """
    planned = planned_rests(plan, gravity_m_s2, seed)
    rng = np.random.default_rng(seed)
    t_ns = np.rint(1e9 * planned.t_s).astype(np.int64)

    def noisy(exact: Floats, density: float, unit: str) -> TriadSamples:
        """Return samples (n, 3) with white noise of a density."""
        drawn = density * plan.rate_hz**0.5 * rng.normal(size=exact.shape)
        return TriadSamples(t_ns=t_ns, values=exact + drawn, unit=unit)

    samples = ImuSamples(
        accelerometer=noisy(planned.f_imu, noise.accelerometer_noise_density, "m/s^2"),
        gyroscope=noisy(planned.omega_imu, noise.gyroscope_noise_density, "rad/s"),
    )
    found = find_imu_rests(samples, gravity_m_s2=gravity_m_s2)
    rests = Rests.none() if found is None else found.chosen.rests
    still = rests.intervals
    if len(still) < 2:
        raise SolveError(f"{len(still)} of {plan.intervals} rests would be found. Plan longer ones (--hold-s).")

    def stream(values: Floats, density: float) -> TriadStream:
        """Return exact samples (n, 3) with white noise of a density."""
        return TriadStream(
            t_s=planned.t_s,
            values=values,
            saturated=np.zeros(len(values), dtype=bool),
            rate_hz=plan.rate_hz,
            density=np.full(3, density**2),
            density_in_motion=np.full(3, density**2),
            rounding=np.zeros((len(still), 3)),
            intervals=still,
        )

    cosine_squared = 2 / 3 if plan.latitude is None else float(np.cos(np.radians(plan.latitude)) ** 2)
    problem = build_problem(
        stream(planned.f_imu, noise.accelerometer_noise_density),
        stream(planned.omega_imu, noise.gyroscope_noise_density),
        EARTH_RATE_RAD_S**2 * cosine_squared / 2,
    )
    return problem, interval_means(planned.f_imu, still), rests


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """What a fit would say; see `estimate.multiposition.scaling.Fitted`."""

    state: MultiPositionState
    covariance: Floats
    free: Booleans


def _at_the_truth(problem: MultiPositionProblem, up: Floats, walk: Floats, *, g_sensitivity: bool) -> _Fit:
    """Linearise an ideal sensor's problem once at the truth.

    Parameters
    ----------
    problem : with exact samples
    up : (n, 3) specific force of each rest
    walk : (3,) random walk of the gyroscope's bias, scaled [1/s]
    """
    data = with_drift(problem.data)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    accelerometer, gyroscope = problem.accelerometer, problem.gyroscope
    theta = np.zeros(PARAMETERS + 3 * data.drift[0].shape[1])
    theta[S_] = np.diag(size.mean() / accelerometer.spread)[LOWER]
    theta[B_] = -accelerometer.centre / accelerometer.spread
    theta[CG_] = np.diag(gyroscope.spread).ravel()
    theta[BG_] = -gyroscope.centre / gyroscope.spread
    state = MultiPositionState(theta=theta, u=up / size)
    free = np.ones(len(theta), dtype=bool)
    free[G_] = g_sensitivity
    prior = np.zeros((len(theta), len(theta)))
    prior[:PARAMETERS, :PARAMETERS] = np.diag(weak_prior_sigma(state) ** -2.0)
    prior[PARAMETERS:, PARAMETERS:] = walk_precision(data, walk)
    rest_accelerometer, rest_gyroscope = whitened_rest(data, state, ExtraVariance())
    whitening = Whitening(
        accelerometer=rest_accelerometer,
        gyroscope=rest_gyroscope,
        rotation=data.linked / np.sqrt(rotation_variance(data, state)),
        prior=prior,
    )
    try:
        arrow = solve_arrow(normal_equations(linearize_model(data, state), whitening, np.zeros(len(theta)), free))
    except np.linalg.LinAlgError as error:
        raise SolveError("such attitudes determine no calibration. Plan more of them, about all axes.") from error
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(free, free)] = arrow.corner_covariance
    return _Fit(state=state, covariance=covariance[:PARAMETERS, :PARAMETERS], free=free[:PARAMETERS])
