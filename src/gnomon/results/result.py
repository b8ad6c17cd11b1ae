"""A calibration, and how it came about: what a report draws, and its file `diagnostics.npz`.

Besides: runs of samples in which the sensor rested, results that can be plotted, and what a calibration rests on.

The file has every field of `gnomon.results` under its path: the key of an array is the path of its field, such as
"intervals.start_s"; what a result does not have has no key. A list of candidates is one array for each field, such as
"trials.rotation_rms"; a list of what holds lists itself is counted, such as "videos.0.period_s".
"""

import io
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from itertools import groupby
from math import isfinite
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..frozen import value_class
from ..output import atomic_file
from ..recording import Floats, Integers, frozen_array
from ..recording.samples import median_of
from .calibration import Calibration, calibration_parameters, element_names
from .camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics, CornerFit, SignalFit, TrajectoryTrack
from .sensor_diagnostics import ImuDiagnostics, TriadDiagnostics

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Booleans = NDArray[np.bool_]


@value_class
class StaticIntervals:
    """Runs of static samples.

    Attributes
    ----------
    start, stop : (n,) int64, first sample and one past the last
    """

    start: Integers
    stop: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen_array(self.start, np.int64))
        object.__setattr__(self, "stop", frozen_array(self.stop, np.int64))

    def __len__(self) -> int:
        return len(self.start)

    def where(self, keep: Booleans) -> "StaticIntervals":
        """Return the intervals that `keep` (n,) marks."""
        return StaticIntervals(start=self.start[keep], stop=self.stop[keep])


def runs_below(statistic: Floats, threshold: float, shortest: int, margin: int = 0) -> StaticIntervals:
    """Return the runs of samples whose statistic is below a threshold that are long enough.

    Parameters
    ----------
    statistic : (n,)
    threshold : compared with `statistic`
    shortest : least number of samples in a run, after the margin is taken off
    margin : samples taken off both ends of a run
    """
    still = np.concatenate([[False], statistic < threshold, [False]])
    edges = np.flatnonzero(still[1:] != still[:-1])
    start, stop = edges[::2] + margin, edges[1::2] - margin
    long_enough = stop - start >= shortest
    return StaticIntervals(start=start[long_enough], stop=stop[long_enough])


def split_long(intervals: StaticIntervals, most: int) -> tuple[StaticIntervals, Integers]:
    """Return intervals of about the usual length, into which long ones are cut, and the number of each one's whole.

    Parameters
    ----------
    intervals : (n)
    most : parts of one interval, at most

    Returns
    -------
    (m) parts in the order of the intervals, and (m,) which interval each is of
    """
    length = intervals.stop - intervals.start
    usual = float(median_of(length)) if len(length) else 1.0
    parts = np.clip(np.round(length / max(usual, 1.0)), 1, most).astype(np.int64)
    whole = np.repeat(np.arange(len(parts)), parts)
    k = np.arange(len(whole)) - np.repeat(np.cumsum(parts) - parts, parts)
    edges = [intervals.start[whole] + length[whole] * (k + i) // parts[whole] for i in (0, 1)]
    return StaticIntervals(start=edges[0], stop=edges[1]), whole


def interval_means(values: Floats, intervals: StaticIntervals) -> Floats:
    """Return the mean of the samples of every interval, (n, 3) [unit]."""
    if not len(intervals):
        return np.empty((0, 3))
    edges = np.stack([intervals.start, intervals.stop], axis=1).ravel()
    last = edges[-1] == len(values)  # reduceat takes the end of the data for granted
    sums = np.add.reduceat(values, edges[:-1] if last else edges, axis=0)[::2]
    return sums / (intervals.stop - intervals.start)[:, None]


class Plotted:
    """A result whose report has figures."""

    __slots__ = ()

    def plot(self, name: str = "") -> "Figure":
        """Draw a figure of the report with Matplotlib, such as "allan" or "signals".

        Parameters
        ----------
        name : short name of the figure, or the beginning of several; an unknown one is answered with all that there are

        Returns
        -------
        Figure
            of Matplotlib, whose axes can be changed before it is shown or saved

        Raises
        ------
        OptionError
            If the report has no such figure, or Matplotlib is not installed.
        """
        # Drawing comes after results on the data's way, so it is looked up by name when somebody asks for it.
        return import_module("gnomon.report.page").plot_result(self, name)


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


def counted_things(calibration: Calibration) -> str:
    """Return what `intervals_found` and `intervals_used` of the assessment count, such as "poses"."""
    if calibration.provenance.method == "turntable":
        return "steady parts"
    if calibration.provenance.method == "magnetometer":
        return "stretches"
    return "static intervals" if calibration.assessment.rotations_found else "poses"


def modelled_thing(calibration: Calibration) -> str:
    """Return what the model of the assessment is one of: "IMU", "gyroscope" or "magnetometer"."""
    if calibration.assessment.camera_imu is not None:
        return "IMU"
    if not calibration.imus:
        return "lens"
    return "magnetometer" if calibration.provenance.method == "magnetometer" else "gyroscope"


def rests_on_gravity(calibration: Calibration) -> bool:
    """Tell whether the magnitude of gravity has a part in any parameter."""
    return any(
        imu.accelerometer is not None or (imu.gyroscope is not None and bool(imu.gyroscope.g_sensitivity.any()))
        for imu in calibration.imus.values()
    )


def held_out_errors(calibration: Calibration) -> Iterator[tuple[str, str, float, str]]:
    """Yield (sensor, what was compared, rms, unit) of every hold-out error data that is known.

    Errors of the magnetic field are in percent of the local field.
    """
    holdout = calibration.assessment.holdout
    for found in (
        ("accelerometer", "|f| - g", holdout.accelerometer_rms, "m/s^2"),
        ("rotations", "rotations", holdout.rotation_rms, "rad"),
        ("gyroscope", "|w| - rate", holdout.rate_rms, "rad/s"),
        ("magnetometer", "|m| - field", 100 * holdout.field_rms, "%"),
    ):
        if isfinite(found[2]):
            yield found


def prior_held_names(calibration: Calibration) -> tuple[str, ...]:
    """Return what a prior holds, whole parameters by their path and others number by number."""
    sizes = {
        path: len(element_names(path, value.shape))
        for path, value in calibration_parameters(calibration.imus, calibration.cameras)
    }
    names: list[str] = []
    for path, group in groupby(calibration.assessment.held_by_prior, key=lambda name: name.split("[")[0]):
        elements = list(group)
        names += [path] if len(elements) == sizes.get(path) else elements
    return tuple(names)


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
