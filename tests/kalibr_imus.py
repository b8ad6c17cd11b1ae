"""The IMUs of a file in Kalibr's layout."""

from pathlib import Path

from gnomon.formats.foreign import ForeignCalibration
from gnomon.formats.kalibr.imu import imus_of
from gnomon.formats.shared.foreign_yaml import read_foreign_yaml


def read_kalibr(path: Path) -> ForeignCalibration:
    """Read the IMUs of a file."""
    notes: list[str] = []
    return imus_of(read_foreign_yaml(path, notes), notes)
