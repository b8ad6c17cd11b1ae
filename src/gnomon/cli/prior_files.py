"""Files of --prior: other calibrations of the same sensor, and its noise."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OptionError

if TYPE_CHECKING:
    from ..calibration import Calibration
    from ..models.noise import ImuNoise
    from ..recording import Recording, Source


@dataclass(frozen=True, kw_only=True)
class PriorFiles:
    """What the files of --prior say.

    Attributes
    ----------
    stated : what was no file: NAME=SIGMA
    calibrations : of the sensor
    noise : of the IMU, or None
    sources : the files
    """

    stated: tuple[str, ...]
    calibrations: "tuple[Calibration, ...]" = ()
    noise: "ImuNoise | None" = None
    sources: "tuple[Source, ...]" = ()

    def known_of(self, recording: "Recording") -> "Recording":
        """Return the recording with the IMU's noise, and with the files among its sources."""
        known = self.noted_in(recording)
        return replace(known, sources=(*known.sources, *self.sources))

    def noted_in(self, recording: "Recording") -> "Recording":
        """Return the recording with the IMU's noise, where a file states it."""
        if self.noise is None:
            return recording
        imus = {name: replace(samples, noise=self.noise) for name, samples in recording.imus.items()}
        return replace(recording, imus=imus)


def read_priors(prior: tuple[str, ...]) -> PriorFiles:
    """Read the files among the values of --prior.

    Raises
    ------
    OptionError
        If a value is neither NAME=SIGMA nor a file, or two files state the noise.
    FormatError
        If a file cannot be read.
    """
    stated = tuple(text for text in prior if "=" in text and not Path(text).exists())
    files = [Path(text) for text in prior if text not in stated]
    if not files:
        return PriorFiles(stated=stated)
    from ..readers import load
    from ..readers.files import file_source

    calibrations: list[Calibration] = []
    noises: list[ImuNoise] = []
    for path in files:
        if not path.is_file():
            raise OptionError(
                f"--prior {path}: there is no such file. Give a calibration.yaml, a noise.yaml, Kalibr's imu.yaml, or "
                "NAME=SIGMA, such as imu0.gyroscope.bias=0.01."
            )
        noise = _noise(path)
        if noise is None:
            calibrations.append(_of_imu(path, load(path)))
        else:
            noises.append(noise)
    if len(noises) > 1:
        raise OptionError("--prior states the noise of the IMU in two files. Keep one of them.")
    return PriorFiles(
        stated=stated,
        calibrations=tuple(calibrations),
        noise=noises[0] if noises else None,
        sources=tuple(file_source(path) for path in files),
    )


def _of_imu(path: Path, calibration: "Calibration") -> "Calibration":
    """Return the calibration if it tells of an IMU."""
    if not calibration.imus:
        raise OptionError(
            f"--prior {path}: this calibration is of cameras alone. Give it to gnomon camera-imu as --cam."
        )
    return calibration


def _noise(path: Path) -> "ImuNoise | None":
    """Return the noise that a file states, or None where it is no such file."""
    from ..readers.own.noise_file import is_noise, load_noise
    from ..readers.projects.foreign_files import is_own

    if is_noise(path):
        return load_noise(path).imu_noise()
    if is_own(path):
        return None
    from ..readers.rig.sensor_inputs import read_imus

    return next(iter(read_imus(path, []).values())).noise
