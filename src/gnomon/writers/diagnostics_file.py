"""How a result came about, as an NPZ file: every field of `gnomon.results` under its path.

The key of an array is the path of its field, such as "intervals.start_s"; what a result does not have has no key.
A list of candidates is one array for each field, such as "trials.rotation_rms"; a list of what holds lists itself is
counted, such as "videos.0.period_s".
"""

import io
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..output import atomic_file
from ..results.camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics, CornerFit, SignalFit, TrajectoryTrack
from ..results.result import JoinedDiagnostics
from ..results.sensor_diagnostics import ImuDiagnostics, TriadDiagnostics

_LEVEL = 1  # higher levels take twice the time for a twentieth of the size
_SMALL = 2048  # bytes: less is kept as it is
_SAMPLE = 16_384  # bytes in the middle of an array that tell whether it shrinks,
_WORTH = 0.75  # to this share at least: readings with noise hardly do, and would take most of the time
_SINGLE: Mapping[type, frozenset[str]] = {
    SignalFit: frozenset({"measured", "predicted", "basic"}),
    CornerFit: frozenset({"pixels", "residual", "weight", "corner_sigma_px"}),
    TrajectoryTrack: frozenset({"p_target_imu", "q_target_imu_wxyz", "omega_imu", "f_imu"}),
}
"""What has a row for each sample or corner of a recording, and is kept in single precision: pixels to 1e-4 px, the
others to 6e-8 of their size. Timestamps, and all that was estimated, keep theirs."""

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same diagnostics give the same bytes


def save_diagnostics(
    diagnostics: ImuDiagnostics | CameraImuDiagnostics | CamerasDiagnostics | TriadDiagnostics | JoinedDiagnostics,
    path: str | PathLike[str],
) -> None:
    """Write diagnostics to a compressed NPZ file; `numpy.load` reads it without pickle.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_file(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in diagnostic_arrays(diagnostics):
            content = io.BytesIO()
            np.lib.format.write_array(content, array, allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            packing = zipfile.ZIP_DEFLATED if _shrinks(content.getbuffer()) else zipfile.ZIP_STORED
            archive.writestr(entry, content.getbuffer(), packing, _LEVEL)


def _shrinks(content: memoryview) -> bool:
    if len(content) < _SMALL:
        return False
    start = max(0, (len(content) - _SAMPLE) // 2)
    sample = content[start : start + _SAMPLE]
    return len(zlib.compress(sample, _LEVEL)) < _WORTH * len(sample)


def diagnostic_arrays(node: Any, path: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield (path, array) of everything in a tree of dataclasses, mappings, sequences and numbers."""
    if node is None:
        return
    if is_dataclass(node):
        single = _SINGLE.get(type(node), frozenset())
        for entry in fields(node):
            for name, array in diagnostic_arrays(getattr(node, entry.name), _joined(path, entry.name)):
                yield name, array.astype(np.float32) if entry.name in single else array
    elif isinstance(node, Mapping):
        for key, value in node.items():  # pyright: ignore[reportUnknownVariableType]
            yield from diagnostic_arrays(value, _joined(path, str(key)))
    elif isinstance(node, tuple) and node and is_dataclass(node[0]):
        if any(isinstance(getattr(node[0], entry.name), np.ndarray | tuple) for entry in fields(node[0])):
            for i, item in enumerate(node):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
                yield from diagnostic_arrays(item, _joined(path, str(i)))
            return
        for entry in fields(node[0]):
            yield _joined(path, entry.name), np.array([getattr(item, entry.name) for item in node])
    elif isinstance(node, tuple) and all(isinstance(item, str) for item in node):  # of words, or none at all
        yield path, np.array(node, dtype=np.str_)
    else:
        yield path, np.asarray(node)


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
