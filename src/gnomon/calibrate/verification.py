"""A calibration and a fresh recording -> Verification: whether it still holds, and if not, which number moved.

estimate the same numbers from the fresh recording -> hold both against each other, block by block
"""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike

import numpy as np

from ..assess.comparison.candidates import ComparisonCandidate
from ..assess.comparison.verification import Verification, verify_candidate
from ..errors import GnomonError, OptionError
from ..estimate.trust.changes import estimates_alone
from ..formats.foreign import ForeignCalibration
from ..formats.foreign_files import load_any
from ..models.target import Target
from ..options import CameraImuOptions, CameraOptions
from ..options.requirements import Use
from ..progress import Progress
from ..recording import Recording, Source, shared_sources
from ..recording.thermometer import known_readings
from ..results.calibration import Calibration, Covariance
from ..results.result import Result

_WIDE = {"sensitivity": 0.05, "g_sensitivity": 3e-3}
"""Sigmas of the prior that lets a short recording be estimated, whose share is taken out again: relative to the scale;
and [rad/s per m/s^2], relative to it, too."""
_NOTICED = frozenset({"time-shift-varies", "clock-jump", "board-moved", "frames-left-out", "model-incomplete"})
"""What a fresh recording shows of itself and is told: parts of it that differ, or that are not judged."""


def verify(
    calibration: Calibration | ForeignCalibration | Result | str | PathLike[str] | Sequence[str | PathLike[str]],
    recording: Recording | Result | Calibration,
    target: Target | None = None,
    *,
    use: Use | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Tell whether a calibration still holds, from a fresh recording of the same sensors.

    A calibration that knows how it changes with the temperature is taken as it is at that of the recording.

    Parameters
    ----------
    calibration : which is verified: gnomon's or another project's, or its file or files
    recording : a fresh one, which may be shorter than one to calibrate by; or what was calibrated from it
    target : the board, where the recording holds cameras
    use : what the calibration is for
    progress : called with a sentence at each step

    Raises
    ------
    OptionError
        If recording and calibration are of different sensors, the calibration was made from that very recording, the
        board is missing, or the temperature, which the calibration needs, is not known or beyond its range.
    RecordingError, DetectionError, InitialisationError, SolveError
        If the recording cannot be used.

    Examples
    --------
    >>> found = gnomon.verify("monday-imu", gnomon.read("today.csv"))  # doctest: +SKIP
    >>> found.state, [block.path for block in found.moved]  # doctest: +SKIP
    """
    known = calibration if isinstance(calibration, Calibration | ForeignCalibration) else _loaded(calibration)
    known = _per_local_field(_at_its_temperature(known, recording))
    frozen = ComparisonCandidate.of("the calibration", known)
    fresh = recording.calibration if isinstance(recording, Result) else recording
    sources = fresh.sources if isinstance(fresh, Recording) else fresh.provenance.inputs
    _refuse_its_own(frozen, sources)
    if isinstance(fresh, Recording):
        found = _by_recording(known, frozen, fresh, target, use, progress)
    else:
        found = _held_against(frozen, fresh, None, use)
    stated = known.provenance.options if isinstance(known, Calibration) else {}
    sensor = {name: stated[name] for name in ("sensor", "serial") if name in stated}
    return replace(found, provenance=replace(found.provenance, inputs=tuple(sources), options=sensor))


def _by_recording(  # noqa: PLR0917
    known: Calibration | ForeignCalibration,
    frozen: ComparisonCandidate,
    recording: Recording,
    target: Target | None,
    use: Use | None,
    progress: Progress | None,
) -> Verification:
    with suppress(GnomonError, np.linalg.LinAlgError):
        with estimates_alone(known if isinstance(known, Calibration) else None) as postponed:
            quick = _held_against(frozen, *_estimated(known, frozen, recording, target, progress), use)
        if quick.state == "holds" or (quick.state == "moved" and not any(search() for search in postponed)):
            return quick
    # what makes no calibration, or changed on the way, is judged as a whole before it is held against another one
    return _held_against(frozen, *_estimated(known, frozen, recording, target, progress), use)


def _refuse_its_own(frozen: ComparisonCandidate, sources: Collection[Source]) -> None:
    if shared := shared_sources(frozen.inputs, sources):
        raise OptionError(
            f"the calibration was made from {shared[0].name}, the very recording that is to verify it: that says "
            "nothing. Record afresh."
        )


def _held_against(
    frozen: ComparisonCandidate, fresh: Calibration, wide: Calibration | None, use: Use | None
) -> Verification:
    helped = None if wide is None else ComparisonCandidate.of("the prior", wide)
    noticed = [finding for finding in fresh.assessment.findings if finding.code in _NOTICED]
    return verify_candidate(frozen, ComparisonCandidate.of("the recording", fresh), use, helped, noticed)


def _loaded(source: Result | str | PathLike[str] | Sequence[str | PathLike[str]]) -> Calibration | ForeignCalibration:
    if isinstance(source, Result):
        return source.calibration
    return load_any(source) if isinstance(source, str | PathLike) else load_any(*source)


def _at_its_temperature(
    known: Calibration | ForeignCalibration, recording: Recording | Result | Calibration
) -> Calibration | ForeignCalibration:
    """Return the calibration as it is at the mean temperature of a recording."""
    if isinstance(known, ForeignCalibration) or not any(
        imu.temperature is not None and imu.temperature.changes for imu in known.imus.values()
    ):
        return known
    degc: float | None = None
    if isinstance(recording, Recording):
        warm = [imu.temperature for imu in recording.imus.values() if imu.temperature is not None]
        read = [readings for one in warm if (readings := known_readings(one)) is not None]
        degc = float(np.mean(read[0][1])) if read else None
    else:
        fresh = recording.calibration if isinstance(recording, Result) else recording
        stated = fresh.provenance.options.get("temperature_c")
        stated = stated or fresh.provenance.options.get("chip_degc")
        degc = None if stated is None else float(stated)
    if degc is None:
        raise OptionError(
            "the calibration depends on the temperature, and the recording tells none. Record the chip's thermometer "
            "in a column such as temp_degC."
        )
    return known.at_temperature(degc)


def _per_local_field(known: Calibration | ForeignCalibration) -> Calibration | ForeignCalibration:
    """Return a magnetometer's calibration without the field's strength, which is another one elsewhere."""
    stated = known.provenance.options.get("field") if isinstance(known, Calibration) else None
    if isinstance(known, ForeignCalibration) or stated is None:
        return known
    imus = {
        name: imu
        if (sensor := imu.magnetometer) is None or sensor.field_unit != "uT"
        else replace(
            imu,
            magnetometer=replace(sensor, sensitivity=float(stated) * sensor.sensitivity, field_unit="local field"),
        )
        for name, imu in known.imus.items()
    }
    names = known.uncertainty.names
    scale = np.array([float(stated) if ".magnetometer.sensitivity" in name else 1.0 for name in names])
    matrix = known.uncertainty.matrix * np.outer(scale, scale)
    return replace(known, imus=imus, uncertainty=Covariance(names=names, matrix=matrix))


def _estimated(
    known: Calibration | ForeignCalibration,
    frozen: ComparisonCandidate,
    recording: Recording,
    target: Target | None,
    progress: Progress | None,
) -> tuple[Calibration, Calibration | None]:
    """Return the calibration that the recording makes, and the prior that helped it."""
    held, there = (*frozen.imus, *frozen.all_lenses), (*recording.imus, *recording.cameras)
    if not set(held) & set(there):
        raise OptionError(
            f"the calibration is of {', '.join(held)}, the recording of {', '.join(there) or 'averages alone'}: "
            "nothing to verify. Give a recording of the same sensors."
        )
    if recording.cameras:
        if target is None:
            raise OptionError("to verify cameras, say which board they saw (target).")
        lenses = frozen.all_lenses
        cameras = {
            name: replace(frames, camera=lenses[name]) if name in lenses else frames
            for name, frames in recording.cameras.items()
        }
        recording = replace(recording, cameras=cameras)
        if recording.imus:
            from .camera_imu import calibrate_camera_imu  # each loaded where a recording asks for it

            return calibrate_camera_imu(recording, target, CameraImuOptions(compare=False), progress).calibration, None
        from .cameras import calibrate_cameras

        options = CameraOptions(model=tuple(f"{name}={lenses[name].model}" for name in cameras if name in lenses))
        return calibrate_cameras(recording, target, options, progress).calibration, None
    imu = next(iter(frozen.imus.values()))
    if imu.magnetometer is not None and imu.gyroscope is None:
        from .magnetometer import calibrate_magnetometer

        return calibrate_magnetometer(recording, progress=progress).calibration, None
    from .imu import calibrate_imu
    from .several_recordings import at_reference

    wide = _wide(known) if isinstance(known, Calibration) and known.uncertainty.matrix.any() else None
    return at_reference(calibrate_imu(recording, progress=progress, prior=wide).calibration), wide


def _wide(calibration: Calibration) -> Calibration:
    """Return the calibration with standard deviations that are far too large to matter, of what is no bias."""
    calibration = calibration.in_frame("accel-x") if calibration.frame != "accel-x" else calibration
    name, imu = next(iter(calibration.imus.items()))
    names = calibration.uncertainty.names
    sigma = np.zeros(len(names))
    for i, scalar in enumerate(names):
        sensor, _, path = scalar.partition("[")[0].partition(".")
        triad, _, block = path.partition(".")
        if sensor == name and block in _WIDE and calibration.uncertainty.matrix[i, i] > 0:
            scale = float(np.cbrt(abs(np.linalg.det(getattr(imu, triad).sensitivity))))
            sigma[i] = _WIDE[block] * scale
    return replace(
        calibration,
        uncertainty=Covariance(names=names, matrix=np.diag(sigma**2)),
        provenance=replace(calibration.provenance, inputs=()),
    )
