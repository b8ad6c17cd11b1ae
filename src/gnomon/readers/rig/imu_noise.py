"""The noise of an IMU from whichever file states it: gnomon's noise.yaml, or one that `sensor_inputs` reads."""

from os import PathLike

from ..own.noise_file import is_noise, load_noise
from .kalibr_imu_input import ImuInput
from .sensor_inputs import read_imus


def read_imu_noise(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, ImuInput]:
    """Read noise, rate and topic of IMUs, told by the content of the file.

    Parameters
    ----------
    path : gnomon's noise.yaml, Kalibr's imu.yaml, OpenVINS' kalibr_imu_chain.yaml, EuRoC's sensor.yaml or Basalt's JSON
    notes : where sentences on what was passed over are appended

    Returns
    -------
    mapping from "imu0", "imu1", ... to ImuInput

    Raises
    ------
    FormatError
        If the file cannot be read, is none of these, or a noise is missing or not above zero.
    OptionError
        If a noise.yaml is that of one sensor alone.
    """
    if not is_noise(path):
        return read_imus(path, notes)
    noise = load_noise(path)
    rates = [triad.rate_hz for triad in (noise.gyroscope, noise.accelerometer) if triad is not None]
    return {"imu0": ImuInput(noise=noise.imu_noise(), update_rate_hz=rates[0], topic="")}
