"""Calibration -> the files of other projects."""

from collections.abc import Mapping
from importlib import import_module
from os import PathLike
from pathlib import Path

from ..errors import OptionError
from ..models.lens_names import PROGRAMS
from ..output import write_together
from ..results.calibration import Calibration
from .foreign import ForeignCalibration, as_calibration
from .shared.losses import (
    Context,
    Export,
    Loss,
    StatedImu,
    ignored_values,
    loss_sentences,
    origin_remarks,
    remark_losses,
)
from .shared.sensor_losses import at_middle_rows
from .shared.si_units import with_full_scale

FORMATS = {
    "imu_tk": "imu_tk.export",
    "kalibr": "kalibr.imu.export",
    "openvins": "openvins.export",
    "vins-fusion": "vins_fusion.export",
    "orb-slam3": "orb_slam3.export",
    "basalt": "basalt.export",
    "okvis": "okvis.export",
    "px4": "flight_controllers.export_px4",
    "ardupilot": "flight_controllers.export_ardupilot",
    "ros2": "ros2.export",
    "imucal": "imucal.export",
    "c-header": "c_header.export",
    "json": "own.other_forms.export_json",
    "csv": "own.other_forms.export_csv",
}
"""Name of a format -> the function here that makes it, by its module."""

WITH_NOISE = ("kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis")
"""Formats that hold noise and rate of the IMU."""
_WITHOUT_CAMERAS = ("imu_tk", "px4", "ardupilot", "imucal", "c-header")

_LENSES_ALONE = ("kalibr", "ros2", "json", "csv")
"""Formats that can hold cameras without an IMU."""

_OF_ONE_INSTANT = ("openvins", "vins-fusion", "orb-slam3", "basalt", "okvis", "ros2")
"""Formats without a line delay: all rows of an image have one time shift."""

Stated = str | PathLike[str] | Mapping[str, StatedImu] | None


def convert(
    calibration: Calibration | ForeignCalibration,
    to: str,
    directory: str | PathLike[str],
    *,
    imu: Stated = None,
    accelerometer_lsb_per_g: float | None = None,
    gyroscope_lsb_per_deg_s: float | None = None,
) -> tuple[Loss, ...]:
    """Write a calibration in another project's format and return what that format cannot hold.

    Parameters
    ----------
    calibration : gnomon's own, or what `load_foreign` read of another project's
    to : "imu_tk", "kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis", "px4", "ardupilot", "ros2",
        "imucal", "c-header", "json" or "csv"
    directory : made if it is not there; only the files of the format are written, all of them or none
    imu : file with the noise and rate of the IMUs, such as Kalibr's imu.yaml or gnomon's noise.yaml, or what is known
        of each; another project's calibration may state them itself
    accelerometer_lsb_per_g, gyroscope_lsb_per_deg_s : counts per g and per deg/s by which the driver divides, where the
        calibration is of counts; "px4" and "ardupilot" need them

    Raises
    ------
    OptionError
        If there is no such format, or its model cannot represent this sensor.
    FormatError
        If the file of the noise cannot be read.
    OutputError
        If a file cannot be written.
    """
    export = export_texts(
        calibration,
        to,
        imu=imu,
        accelerometer_lsb_per_g=accelerometer_lsb_per_g,
        gyroscope_lsb_per_deg_s=gyroscope_lsb_per_deg_s,
    )
    write_together(directory, export.files)
    return export.losses


def export_texts(
    calibration: Calibration | ForeignCalibration,
    to: str,
    *,
    imu: Stated = None,
    accelerometer_lsb_per_g: float | None = None,
    gyroscope_lsb_per_deg_s: float | None = None,
) -> Export:
    """Return the texts of the files of another project's format, by name, without writing them; see `convert`.

    Raises
    ------
    OptionError
        If there is no such format, or its model cannot represent this sensor.
    FormatError
        If the file of the noise cannot be read.
    """
    if to not in FORMATS:
        raise OptionError(f'"{to}" is no format to convert to. Choose one of: {", ".join(FORMATS)}.')
    stated: dict[str, StatedImu] = {}
    if isinstance(calibration, ForeignCalibration):
        stated = {
            name: StatedImu(noise=data.noise, update_rate_hz=data.update_rate_hz, topic=data.topic)
            for name, data in calibration.imu_data.items()
        }
        calibration = as_calibration(calibration)
    if (accelerometer_lsb_per_g, gyroscope_lsb_per_deg_s) != (None, None):
        calibration = with_full_scale(calibration, accelerometer_lsb_per_g, gyroscope_lsb_per_deg_s)
    if not calibration.imus and to not in _LENSES_ALONE:
        raise OptionError(
            f"{to} describes an IMU, and this calibration is of cameras alone. Convert to {', '.join(_LENSES_ALONE)}, "
            "or calibrate with gnomon camera-imu, which takes this calibration with --cam."
        )
    if imu is not None:
        stated |= imu if isinstance(imu, Mapping) else stated_imus(imu)
    module, _, function = FORMATS[to].rpartition(".")
    losses = tuple(remark_losses(calibration, cameras=to not in _WITHOUT_CAMERAS))
    if to in PROGRAMS:
        from .shared.lens_refit import with_known_lenses

        calibration, refits = with_known_lenses(calibration, to)
        losses += refits
    losses += tuple(ignored_values(calibration, to))
    if to in _OF_ONE_INSTANT:
        calibration = at_middle_rows(calibration)
    export: Export = getattr(import_module(f".{module}", __package__), function)(
        calibration, Context(stated=stated, remarks=(*origin_remarks(calibration), *loss_sentences(losses)))
    )
    return Export(files=export.files, losses=(*losses, *export.losses))


def stated_imus(path: str | PathLike[str]) -> dict[str, StatedImu]:
    """Return noise, rate and topic of the IMUs that a file states; see `formats.sensor_inputs`.

    Raises
    ------
    FormatError
        If the file cannot be read, or is none of those that state noise.
    """
    from .sensor_inputs import read_imu_noise

    origin = f"noise from {Path(path).name}"
    return {
        name: StatedImu(noise=found.noise, update_rate_hz=found.update_rate_hz, topic=found.topic, comments=(origin,))
        for name, found in read_imu_noise(path).items()
    }
