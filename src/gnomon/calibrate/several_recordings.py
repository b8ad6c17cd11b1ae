"""One sensor from several recordings: each is calibrated for itself, and the results are joined.

recordings -> each: calibrate -> same sensor? -> random effects -> assess -> Result
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..assess.imu.joined_recordings import Scalars, joined_assessment, quantities_of, refuse_other_sensors
from ..assess.priors import Priors
from ..assess.uncertainty_budget import gravity_part
from ..errors import GnomonError, OptionError, RecordingError
from ..estimate.trust.between_recordings import join_estimates
from ..options import ImuOptions
from ..progress import Progress, as_step
from ..recording import Floats, Recording
from ..results.calibration import Calibration, Covariance, Provenance
from ..results.result import JoinedDiagnostics, JoinedRecording, Result
from ..results.sensor_diagnostics import ImuDiagnostics, TriadDiagnostics
from ..results.sensors import ImuCalibration, calibration_parameters
from .steps.preparation import recording_names, refuse_same_data, stated_options

CalibrateOne = Callable[[Recording, ImuOptions, Progress], Result]

_FRAMES = ("accel-x", "accel-z")


def calibrate_several(
    recordings: Sequence[Recording], options: ImuOptions, progress: Progress, prior: Priors, one: CalibrateOne
) -> Result:
    """Calibrate one sensor from several recordings, which join as recordings, not as one long one.

    The parameters are means over the recordings, and the covariance is that of the sensor as it is on another occasion,
    the scatter between recordings included: the turn-on bias, and what temperature does.

    Parameters
    ----------
    recordings : at least two
    one : how a single recording is calibrated

    Raises
    ------
    RecordingError
        If they are not of one sensor, tell of different things, or hold the same samples; what a single recording
        raises is raised with its name.
    OptionError
        If an option does not fit several recordings.
    """
    if not recordings:
        raise OptionError("no recording given. Give one, or several of one sensor.")
    _check_options(options, prior)
    names = recording_names(recordings)
    refuse_same_data(recordings, names)
    results = calibrated_alike(recordings, names, replace(options, frame="accel-x"), progress, one)
    progress("joining the recordings")
    scalars = scalars_of([result.calibration for result in results], names)
    refuse_other_sensors(scalars, names)
    return _joined(results, names, scalars, recordings, options)


def calibrated_alike(
    recordings: Sequence[Recording], names: Sequence[str], options: ImuOptions, progress: Progress, one: CalibrateOne
) -> list[Result]:
    """Calibrate each recording for itself, all with the same model; what one raises names it."""
    results = [
        _named(name, lambda recording=recording, tell=tell: one(recording, options, tell))
        for (name, recording, tell) in _one_by_one(names, recordings, progress)
    ]
    if len({result.calibration.assessment.model for result in results}) > 1:
        results = _with_one_model(_one_by_one(names, recordings, progress), results, options, one)
    return [replace(result, calibration=at_reference(result.calibration)) for result in results]


def at_reference(calibration: Calibration) -> Calibration:
    """Return a calibration of one IMU as it is at its reference temperature, without how it changes."""
    found = next(iter(calibration.imus.values())).temperature
    return calibration if found is None else calibration.at_temperature(found.reference_degc)


def _check_options(options: ImuOptions, prior: Priors) -> None:
    if options.preset != "gnomon":
        raise OptionError(
            f"preset {options.preset} knows one recording. Give one, or join several with the default preset."
        )
    if prior or options.prior:
        raise OptionError(
            "--prior counts once, and several recordings would each take it for evidence of their own. Leave it out: "
            "give the recording of that calibration instead, as one more."
        )
    if options.frame not in _FRAMES:
        raise OptionError(
            f'frame "{options.frame}" names static intervals of one recording. Of several, choose accel-x or accel-z.'
        )


def _one_by_one(
    names: Sequence[str], recordings: Sequence[Recording], progress: Progress
) -> list[tuple[str, Recording, Progress]]:
    def told(i: int) -> Progress:
        return lambda sentence: progress(as_step(sentence).within(f"recording {i} of {len(names)}"))

    return [(name, recording, told(i)) for i, (name, recording) in enumerate(zip(names, recordings, strict=True), 1)]


def _named(name: str, work: Callable[[], Result]) -> Result:
    """Do the work on one recording; what it raises names the recording."""
    try:
        return work()
    except GnomonError as error:
        raise type(error)(f"{name}: {error}") from error


def _with_one_model(
    each: Sequence[tuple[str, Recording, Progress]], results: Sequence[Result], options: ImuOptions, one: CalibrateOne
) -> list[Result]:
    """Calibrate again with the largest model that any recording asks for those that asked for less."""
    if not {result.calibration.assessment.model for result in results} <= {"basic", "g-sensitivity"}:
        raise RecordingError(_different([name for name, _, _ in each], [result.calibration for result in results]))
    larger = replace(options, model="g-sensitivity")
    return [
        result
        if result.calibration.assessment.model == "g-sensitivity"
        else _named(name, lambda recording=recording, tell=tell: one(recording, larger, tell))
        for (name, recording, tell), result in zip(each, results, strict=True)
    ]


def scalars_of(calibrations: Sequence[Calibration], names: Sequence[str]) -> Scalars:
    """Gather the scalars of all, in SI units.

    Raises
    ------
    RecordingError
        If they tell of different sensors, or are in different units.
    """
    first = calibrations[0]
    told = [np.diag(one.uncertainty.matrix) > 0 for one in calibrations]
    if any(
        one.uncertainty.names != first.uncertainty.names or one.frame != first.frame or not np.array_equal(own, told[0])
        for one, own in zip(calibrations, told, strict=True)
    ):
        raise RecordingError(_different(names, calibrations))
    units = [_units(one) for one in calibrations]
    for name, own in zip(names, units, strict=True):
        if own != units[0]:
            raise RecordingError(
                f"{names[0]} is in {' and '.join(units[0])}, {name} in {' and '.join(own)}. State the units "
                "of all with --units, or convert the files."
            )
    factor = _factors(calibrations)
    scale = np.outer(factor, factor)
    return Scalars(
        names=first.uncertainty.names,
        quantity=quantities_of(first),
        factor=factor,
        estimated=told[0],
        values=factor * np.array([_flat(one) for one in calibrations]),
        covariances=np.array([scale * (one.uncertainty.matrix - gravity_part(one)) for one in calibrations]),
        gravity=scale * gravity_part(first),
    )


def _different(names: Sequence[str], calibrations: Sequence[Calibration]) -> str:
    words = {
        "none": "the accelerometer alone",
        "static": "the accelerometer, and the gyroscope at rest",
    }
    parts = [
        f"{name} tells of {words.get(one.assessment.model, 'accelerometer and gyroscope in motion')}"
        for name, one in zip(names, calibrations, strict=True)
    ]
    return (
        f"these recordings cannot be joined, as they tell of different things: {'; '.join(parts)}. Leave out those "
        "that tell less, or calibrate all by their rests alone with --model static."
    )


def _units(calibration: Calibration) -> list[str]:
    imu = calibration.imus["imu0"]
    return [triad.unit for triad in (imu.accelerometer, imu.gyroscope) if triad is not None]


def _flat(calibration: Calibration) -> Floats:
    return np.concatenate([value.ravel() for _, value in calibration_parameters(calibration.imus)])


def _factors(calibrations: Sequence[Calibration]) -> Floats:
    """Return what brings each scalar to SI units: one over the mean scale of its triad, alike in all recordings."""
    factors: list[Floats] = []
    for path, value in calibration_parameters(calibrations[0].imus):
        triad = path.split(".")[1]
        volumes = [abs(float(np.linalg.det(one.parameter(f"imu0.{triad}.sensitivity")))) for one in calibrations]
        factors.append(np.full(value.size, 1 / float(np.mean(np.cbrt(volumes)))))
    return np.concatenate(factors)


def _joined(
    results: Sequence[Result],
    names: Sequence[str],
    scalars: Scalars,
    recordings: Sequence[Recording],
    options: ImuOptions,
) -> Result:
    at = np.flatnonzero(scalars.estimated)
    joined = join_estimates(scalars.values[:, at], scalars.covariances[:, at[:, None], at], scalars.blocks())
    mean, scatter = scalars.values.mean(axis=0), np.zeros(len(scalars.names))
    of_mean, covariance = scalars.gravity.copy(), scalars.gravity.copy()
    mean[at], scatter[at] = joined.mean, joined.scatter
    of_mean[np.ix_(at, at)] += joined.mean_covariance
    covariance[np.ix_(at, at)] += joined.covariance
    first = results[0].calibration
    imus = {"imu0": with_scalars(first.imus["imu0"], mean / scalars.factor)}
    inputs = tuple(dict.fromkeys(source for recording in recordings for source in recording.sources))
    stated = stated_options(options, recordings)
    calibration = replace(
        first,
        imus=imus,
        uncertainty=Covariance(names=scalars.names, matrix=covariance / np.outer(scalars.factor, scalars.factor)),
        provenance=Provenance(method="imu", inputs=inputs, options=stated),
    )
    calibration = replace(calibration, assessment=joined_assessment(calibration, results, names, scalars, scatter))
    diagnostics = JoinedDiagnostics(
        names=scalars.names,
        quantity=scalars.quantity,
        mean=mean,
        mean_sigma=np.sqrt(np.diag(of_mean)),
        scatter=scatter,
        recordings=tuple(
            _one(*each)
            for each in zip(names, results, scalars.values, _sigmas(scalars), scalars.foretold(), strict=True)
        ),
    )
    if options.frame not in (calibration.frame, "accel-x"):
        calibration = calibration.in_frame(options.frame)
    return Result(calibration=calibration, diagnostics=diagnostics)


def _sigmas(scalars: Scalars) -> Floats:
    return np.sqrt(np.maximum(np.diagonal(scalars.covariances, axis1=1, axis2=2), 0.0))


def _one(name: str, result: Result, values: Floats, sigma: Floats, z: Floats) -> JoinedRecording:
    assessment, diagnostics = result.calibration.assessment, result.diagnostics
    assert isinstance(diagnostics, ImuDiagnostics | TriadDiagnostics)
    return JoinedRecording(
        name=name,
        verdict=assessment.verdict,
        model=assessment.model,
        intervals=assessment.intervals_used,
        rotations=assessment.rotations_used,
        accelerometer_rms=assessment.holdout.accelerometer_rms,
        rotation_rms=assessment.holdout.rotation_rms,
        values=values,
        sigma=sigma,
        z=z,
        diagnostics=diagnostics,
    )


def with_scalars(imu: ImuCalibration, flat: Floats) -> ImuCalibration:
    """Return the IMU with other values of all its scalars."""
    start = 0
    triads = {}
    for path, value in calibration_parameters({"": imu}):
        _, triad, name = path.split(".")
        sensor = triads.get(triad) or getattr(imu, triad)
        triads[triad] = replace(sensor, **{name: flat[start : start + value.size].reshape(value.shape)})
        start += value.size
    return replace(imu, **triads)
