"""What a planned multi-position recording would tell: the fit's own normal equations at the truth, no noise drawn.

plan -> exact samples and rests -> problem with the stated noise -> linearise once -> what it would publish
"""

import numpy as np

from .._version import __version__
from ..assess.checks.protocol import find_imu_rests
from ..detect.samples.rests import Rests
from ..errors import SolveError
from ..estimate.multiposition.problem import MultiPositionProblem, TriadStream, build_problem
from ..models.gravity import EARTH_RATE_RAD_S
from ..models.noise import ImuNoise
from ..options import ImuOptions
from ..recording import Floats, ImuSamples, TriadSamples
from ..results.calibration import (
    Calibration,
    Provenance,
)
from ..results.intervals import interval_means
from ..simulate.planned import planned_rests
from ..simulate.plans import ImuPlan
from ..simulate.truth import changed_options
from .predicted_imu import nominal_fit, predicted_calibration
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
    fit = nominal_fit(problem, up, walk, g_sensitivity=plan.model == "g-sensitivity")
    return predicted_calibration(
        fit,
        problem,
        gravity,
        units=("m/s^2", "rad/s"),
        latitude=plan.latitude,
        found=len(rests),
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
