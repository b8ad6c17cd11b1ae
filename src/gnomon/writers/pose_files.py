"""Poses -> a table of averages, or a file of samples for each, that `gnomon.read` gives back."""

from collections.abc import Sequence
from pathlib import Path

from ..errors import OptionError
from ..output import atomic_file
from ..recording import Floats, ImuSamples, Poses, Recording
from .recording_file import save_recording

_AXES = "xyz"


def save_poses(poses: Poses, path: str | Path) -> None:
    """Write a table of averaged poses, one row each; the columns are documented in `gnomon.readers.samples.pose_table`.

    Parameters
    ----------
    poses : the averages
    path : ends in .csv

    Raises
    ------
    OptionError
        If the suffix is another one.
    OutputError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise OptionError(f"{path}: a table of poses is written as .csv.")
    header, columns = ["pose"], list[list[str]]([[name.replace(",", " ") for name in poses.name]])

    def add(names: list[str], values: Floats | None, unit: str) -> None:
        if values is not None:
            header.extend(f"{name} [{unit}]" for name in names)
            columns.extend([repr(float(x)) for x in column] for column in values.reshape(len(poses), -1).T)

    add(["t"], poses.t_s, "s")
    add([f"a{axis}" for axis in _AXES], poses.accelerometer, poses.accelerometer_unit)
    add([f"sigma_a{axis}" for axis in _AXES], poses.accelerometer_sigma, poses.accelerometer_unit)
    add([f"g{axis}" for axis in _AXES], poses.gyroscope, poses.gyroscope_unit)
    add([f"sigma_g{axis}" for axis in _AXES], poses.gyroscope_sigma, poses.gyroscope_unit)
    add([f"ref_{axis}" for axis in _AXES], poses.specific_force, "m/s^2")
    if poses.samples is not None:
        header.append("samples")
        columns.append([str(int(count)) for count in poses.samples])
    rows = [",".join(row) for row in zip(*columns, strict=True)]
    with atomic_file(path) as stream:
        stream.write(("\n".join([",".join(header), *rows]) + "\n").encode())


def save_pose_files(poses: Sequence[ImuSamples], folder: Path) -> list[Path]:
    """Write the samples of each pose into a file of its own, pose01.csv and so on, and return them.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    digits = len(str(len(poses)))
    files: list[Path] = []
    for k, samples in enumerate(poses, start=1):
        files += save_recording(Recording(imus={"imu0": samples}), folder / f"pose{k:0{digits}}.csv")
    return files
