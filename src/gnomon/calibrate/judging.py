"""A calibration that exists, judged for a use."""

from os import PathLike

from ..assess.needs import judge_for_use
from ..errors import OptionError
from ..formats.own.dataclass_file import read_use
from ..options.requirements import GENERAL, Use
from ..results.calibration import Calibration
from ..results.result import Result, calibration_of


def judge(calibration: Calibration | Result, use: str | PathLike[str] | Use) -> Calibration:
    """Judge a calibration against what a use needs; the numbers stay, verdict and findings change.

    Parameters
    ----------
    calibration : any, with its covariance, or a result
    use : "vio", "ahrs", "gimbal", "phone", a YAML file that states other needs, or "general" for no special use

    Returns
    -------
    calibration : the same; `assessment.trust.needs` tells quantity by quantity what the use needs and what there is

    Raises
    ------
    OptionError
        If it is no calibration, there is no such use, or the calibration is of cameras alone; FormatError where the
        file is not as it should be.

    Examples
    --------
    >>> import gnomon
    >>> recording, truth = gnomon.simulate(gnomon.Scenario(intervals=20, t_init_s=20.0), seed=1)
    >>> result = gnomon.calibrate_imu(recording)
    >>> fit_for = gnomon.judge(result.calibration, "ahrs")
    >>> fit_for.assessment.trust.use, len(fit_for.assessment.trust.needs)
    ('ahrs', 6)
    """
    calibration = calibration_of(calibration)
    found = stated_use(use)
    if not calibration.imus:
        if found is None:
            return calibration
        raise OptionError(
            f"what {found.name} needs is of an IMU, alone or with cameras, and this calibration is of cameras alone: "
            "its verdict is by the errors on views that it had not seen."
        )
    return judge_for_use(calibration, found)


def stated_use(use: str | PathLike[str] | Use) -> Use | None:
    """Return a use, None for "general"; see `judge`."""
    if isinstance(use, Use):
        return use
    return None if use == GENERAL else read_use(use)
