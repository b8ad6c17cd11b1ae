"""What is known beforehand: of an IMU, in the letters of document B, and of the cameras together."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..assess.prior_findings import cameras_disagree
from ..calibration import Calibration, Covariance, Gravity
from ..estimate.camera_imu.parameters import ImuParameters
from ..estimate.camera_imu.rig_prior import from_known
from ..estimate.camera_imu.solution import Solution
from ..estimate.camera_imu.uncertainty import Uncertainty
from ..evidence import SCALARS, TRIADS, Evidence, Priors, known_beforehand
from ..findings import Finding
from ..geometry.rotation_vector import rotvec_from_rotation
from ..models.forms import KrebsAccelerometer, KrebsGyroscope
from ..models.pattern import LOWER
from ..options import CameraImuOptions
from ..recording import Floats

_SI = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
_ACCELEROMETER, _GYROSCOPE = TRIADS["accelerometer"], TRIADS["gyroscope"]
_S_A = _ACCELEROMETER.start + np.array([0, 3, 4, 6, 7, 8])
_S_G = np.arange(_GYROSCOPE.start, _GYROSCOPE.start + 9)
_B_G = np.arange(_GYROSCOPE.stop - 9, _GYROSCOPE.stop)
_Q_BG = slice(12, 15)  # among the 24 letters


def evidence_of_imu(prior: Priors, gravity: Gravity, name: str, *, first: bool) -> Evidence:
    """Return what other calibrations know of an IMU, in SI units; where it sits is not asked.

    Parameters
    ----------
    name : of the IMU
    first : whether it is the first IMU; a calibration of one IMU alone is then of this one, whatever its name

    Raises
    ------
    OptionError
        If a calibration is for measurements in counts.
    """
    given = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    own = [one if first else _alone(one, name) for one in given if first or name in one.imus]
    return known_beforehand(own, CameraImuOptions(), _SI, gravity=gravity)


def _alone(calibration: Calibration, name: str) -> Calibration:
    """Return a calibration of one IMU of several."""
    at = [i for i, scalar in enumerate(calibration.uncertainty.names) if scalar.startswith(f"{name}.")]
    return replace(
        calibration,
        imus={name: calibration.imus[name]},
        cameras={},
        uncertainty=Covariance(
            names=tuple(calibration.uncertainty.names[i] for i in at),
            matrix=calibration.uncertainty.matrix[np.ix_(at, at)],
        ),
    )


def known_imu(found: Evidence) -> ImuParameters | None:
    """Return the IMU as it is known beforehand, with the covariance of what is known; None without anything."""
    if not found:
        return None
    covariance, own = _joint_covariance(found)
    start, letters = _letters(found.value)
    jacobian = _derivative(letters, found.value)
    if own:
        jacobian[_Q_BG] = 0.0  # a gyroscope known in its own frame says nothing of how it lies in the body
    return replace(start, covariance=jacobian @ covariance @ jacobian.T)


def cameras_moved(solution: Solution, certain: Uncertainty) -> list[Finding]:
    """Return whether the recording contradicts what was known of the cameras together, lenses and poses."""
    layout, parameters = solution.layout, solution.state.parameters
    rig = layout.start.rig
    if rig is None:
        return []
    found = from_known(rig, layout, parameters)
    at = [i for i, name in enumerate(rig.names) if name in found.names]
    order = [found.names.index(rig.names[i]) for i in at]
    free = layout.free_index
    jacobian, size = found.jacobian[order][:, free], len(free)
    return cameras_disagree(
        tuple(rig.names[i] for i in at),
        found.residual[order],
        rig.covariance[np.ix_(at, at)],
        jacobian @ certain.ordinary[:size, :size] @ jacobian.T,
        jacobian @ certain.covariance[:size, :size] @ jacobian.T,
    )


def _joint_covariance(found: Evidence) -> tuple[Floats, bool]:
    """Return the covariance (45, 45) of what is known, and whether the gyroscope is known in its own frame alone."""
    precision = np.zeros((SCALARS, SCALARS))
    own = any(part.own_frame for part in found.known)
    for part in found.known:
        inside = ~np.isin(part.index, _B_G) if part.own_frame else np.ones(len(part.index), dtype=bool)
        at = part.index[inside]
        precision[np.ix_(at, at)] += np.linalg.inv(np.linalg.inv(part.precision)[np.ix_(inside, inside)])
    known = np.flatnonzero(np.diag(precision))
    size = 1 / np.sqrt(np.diag(precision)[known])
    scale = np.outer(size, size)
    covariance = np.zeros((SCALARS, SCALARS))
    covariance[np.ix_(known, known)] = np.linalg.inv(precision[np.ix_(known, known)] * scale) * scale
    return covariance, own


def _letters(x: Floats) -> tuple[ImuParameters, Callable[[Floats], Floats]]:
    """Return the IMU of scalars x (45,), and the function that gives the 24 letters of others near it."""

    def imu(y: Floats) -> ImuParameters:
        """Return the IMU of scalars (45,)."""
        accelerometer = KrebsAccelerometer.from_sensor(np.tril(y[:9].reshape(3, 3)), y[9:12])
        gyroscope = KrebsGyroscope.from_sensor(y[_S_G].reshape(3, 3), np.zeros(3), np.zeros((3, 3)))
        return ImuParameters(
            S_a=accelerometer.S,
            M_a=LOWER.parameters(accelerometer.M),
            S_g=gyroscope.S,
            M_g=LOWER.parameters(gyroscope.M),
            C_bg=gyroscope.C_bg,
            B_g=y[_B_G].reshape(3, 3),
        )

    start = imu(x)

    def letters(y: Floats) -> Floats:
        now = imu(y)
        turned = rotvec_from_rotation(start.C_bg.T @ now.C_bg)
        return np.concatenate([now.S_a, now.M_a, now.S_g, now.M_g, turned, now.B_g.ravel()])

    return start, letters


def _derivative(letters: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Return the derivative (24, 45) of the letters by the scalars."""
    jacobian = np.zeros((24, SCALARS))
    for i in (*_S_A, *_S_G, *_B_G):
        step = np.zeros(SCALARS)
        step[i] = 1e-6
        jacobian[:, i] = (letters(x + step) - letters(x - step)) / 2e-6
    return jacobian
