"""A calibration, and how it came about: what a report draws and `diagnostics.npz` keeps. Values only."""

from ..errors import OptionError
from ..frozen import value_class
from ..recording import Floats
from .calibration import Calibration
from .camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics
from .imu_diagnostics import ImuDiagnostics
from .plotting import Plotted
from .triad_diagnostics import TriadDiagnostics


@value_class
class JoinedRecording:
    """One of several recordings of one sensor, calibrated for itself.

    Attributes
    ----------
    name : its file, or its number
    verdict, model : of it alone
    intervals, rotations : used
    accelerometer_rms, rotation_rms : on data left out [m/s^2], [rad]
    values, sigma : (n,) its scalars and their standard deviations [SI; of a sensor in counts relative to its scale]
    z : (n,) its distance from what the others foretell, in standard deviations; nan where nothing was estimated
    diagnostics : how it came about
    """

    name: str
    verdict: str
    model: str
    intervals: int
    rotations: int
    accelerometer_rms: float
    rotation_rms: float
    values: Floats
    sigma: Floats
    z: Floats
    diagnostics: ImuDiagnostics | TriadDiagnostics


@value_class
class JoinedDiagnostics:
    """How the calibration of one sensor from several recordings came about.

    Attributes
    ----------
    names : (n,) scalars, as in `Covariance.names`
    quantity : (n,) of each, such as "accelerometer_scale"
    mean, mean_sigma : (n,) over the recordings, and its standard deviation [as `JoinedRecording.values`]
    scatter : (n,) standard deviation from recording to recording
    recordings : one by one, in the order given
    """

    names: tuple[str, ...]
    quantity: tuple[str, ...]
    mean: Floats
    mean_sigma: Floats
    scatter: Floats
    recordings: tuple[JoinedRecording, ...]


@value_class
class Result(Plotted):
    """A calibration, and how it came about."""

    calibration: Calibration
    diagnostics: ImuDiagnostics | CameraImuDiagnostics | CamerasDiagnostics | TriadDiagnostics | JoinedDiagnostics

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_()  # pyright: ignore[reportPrivateUsage]

    def __repr__(self) -> str:
        """Return it on one line."""
        return f"Result({self.calibration!r})"


def calibration_of(given: Calibration | Result) -> Calibration:
    """Return the calibration that was given, or that of a result.

    Raises
    ------
    OptionError
        If it is neither.
    """
    calibration = given.calibration if isinstance(given, Result) else given
    if not isinstance(calibration, Calibration):  # pyright: ignore[reportUnnecessaryIsInstance] - of people
        raise OptionError(
            f"a calibration or a result is wanted, not {type(given).__name__}. gnomon.load(FILE) reads a calibration."
        )
    return calibration
