"""A planned multi-position recording without any noise, and when it rests."""

from dataclasses import dataclass

import numpy as np

from ..recording import Floats
from .plans import ImuPlan
from .scenario import Scenario
from .trajectory import hand_motions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedRests:
    """What an ideal IMU would measure.

    Attributes
    ----------
    t_s : (n,) instants of the samples [s]
    f_imu, omega_imu : (n, 3) specific force [m/s^2] and angular rate [rad/s]
    start_s, stop_s : (k,) when each rest begins and ends [s]
    """

    t_s: Floats
    f_imu: Floats
    omega_imu: Floats
    start_s: Floats
    stop_s: Floats


def planned_rests(plan: ImuPlan, gravity_m_s2: float, seed: int) -> PlannedRests:
    """Return what an ideal IMU would measure when it is turned as planned.

    Parameters
    ----------
    plan : see there
    gravity_m_s2 : magnitude of gravity
    seed : of the attitudes
    """
    scenario = Scenario(
        intervals=plan.intervals,
        attitudes=plan.attitudes,
        t_init_s=plan.t_init_s,
        hold_s=(plan.hold_s, plan.hold_s),
        motion_s=(plan.motion_s, plan.motion_s),
    )
    motions, end_s = hand_motions(scenario, np.random.default_rng(seed).spawn(2)[1])
    t_s = np.arange(int(end_s * plan.rate_hz + 1e-6) + 1) / plan.rate_hz
    f_imu, omega_imu = motions.evaluate(t_s, gravity_m_s2, np.zeros(3))
    return PlannedRests(
        t_s=t_s,
        f_imu=f_imu,
        omega_imu=omega_imu,
        start_s=np.concatenate([[0.0], motions.start_s + motions.duration_s]),
        stop_s=np.concatenate([motions.start_s, [end_s]]),
    )
