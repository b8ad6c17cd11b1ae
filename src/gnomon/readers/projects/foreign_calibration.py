"""Another project's calibration as one of gnomon's, so that it can be shown and written in other formats."""

from dataclasses import replace

import numpy as np

from ..._version import __version__
from ...calibration import Assessment, Calibration, Covariance, Gravity, Provenance, covariance_names, parameters
from ...errors import FormatError
from ...parameters import element_names
from ...recording import Floats
from ...units import STANDARD_GRAVITY_M_S2
from .foreign import FOREIGN_METHOD, ForeignCalibration
from .kalibr_imu import ideal_imu


def as_calibration(foreign: ForeignCalibration) -> Calibration:
    """Return what other projects' files tell as a calibration; standard deviations that they do not state are nan.

    An IMU of which they hold no sensor model is ideal, as the programs take it that have no place for one.

    Raises
    ------
    FormatError
        If there is neither an IMU nor a camera with its pose.
    """
    if not foreign.imus and not foreign.cameras:
        found = "lenses without their poses" if foreign.lenses else "no sensor"
        raise FormatError(
            f"{foreign.format}: found {found}. Give the file with the poses (T_cam_imu), or that of the IMU's model."
        )
    if not foreign.imus and all(camera.body == "cam0" for camera in foreign.cameras.values()):
        return told(foreign, unknown=float("nan"))
    return told(replace(foreign, imus=dict(foreign.imus) or {"imu0": ideal_imu()}), unknown=float("nan"))


def told(foreign: ForeignCalibration, unknown: float) -> Calibration:
    """Return nothing but what the files tell as a calibration.

    Parameters
    ----------
    unknown : taken for the variance of numbers without a standard deviation
    """
    imus = foreign.imus
    names = covariance_names(imus, foreign.cameras)
    variance = dict.fromkeys(names, unknown)
    for path, value in parameters(imus, foreign.cameras):
        if path in foreign.sigmas:
            squares = np.square(foreign.sigmas[path]).ravel().tolist()
            variance |= dict(zip(element_names(path, value.shape), squares, strict=True))
    return Calibration(
        imus=imus,
        cameras=foreign.cameras,
        frame=foreign.frame,
        gravity=Gravity(value=STANDARD_GRAVITY_M_S2, sigma=float("nan"), source="not stated"),
        uncertainty=Covariance(names=names, matrix=_diagonal([variance[name] for name in names])),
        assessment=Assessment(verdict="warn", findings=(), model="foreign"),
        provenance=Provenance(
            gnomon_version=__version__, method=FOREIGN_METHOD, options={"format": foreign.format or "another project"}
        ),
    )


def _diagonal(variances: list[float]) -> Floats:
    """Return a covariance without correlations; unknown ones are nan where a variance is."""
    matrix = np.diag(variances)
    unknown = np.isnan(variances)
    matrix[unknown] = matrix[:, unknown] = np.nan
    return matrix
