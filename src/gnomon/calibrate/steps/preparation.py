"""Before anything is estimated: one IMU's samples, checked and put on their time base, its rests, and local gravity.

Of the rests some do not show gravity like the others: they were disturbed, and are left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from itertools import combinations

import numpy as np

from ...assess.checks.imu_checks import check_by_rests, find_imu_rests
from ...assess.imu.recording_changes import axes_changed_findings
from ...assess.imu.temperature import CHIP_DEGC
from ...assess.priors import Priors
from ...detect.samples.faults import repair_samples, repeated_stretches, saturated_samples
from ...detect.samples.rests import FEWEST_INTERVALS, RestDetection, ThresholdTrial
from ...errors import DetectionError, OptionError, RecordingError
from ...estimate.multiposition.bias_changes import BiasChanges, accelerometer_changes, functions_of_time
from ...estimate.multiposition.noise_levels import resting_noise, rounding_variance
from ...estimate.multiposition.problem import (
    ImuEstimate,
    MultiPositionProblem,
    TriadStream,
    build_problem,
    gyroscope_intervals,
    rest_means,
)
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.gravity import EARTH_RATE_RAD_S, NORMAL_GRAVITY_SIGMA_M_S2, normal_gravity_m_s2
from ...models.target import Target
from ...options import CameraImuOptions, CameraOptions, ImuOptions, MagnetometerOptions, TurntableOptions
from ...recording import Floats, ImuSamples, Recording, TemperatureSamples, TriadSamples, shared_sources, smallest_steps
from ...recording.samples import TimeBase, median_of, time_base
from ...recording.thermometer import known_readings, temperature_course
from ...results.calibration import (
    UNSTATED_GRAVITY,
    AccelerometerCalibration,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
)
from ...results.result import Booleans, StaticIntervals, interval_means
from .temperature_while_turned import rose_and_fell, temperature_powers

_READ = {
    "calibrate_imu": 'gnomon.calibrate_imu(gnomon.read("recording.csv"))',
    "calibrate_magnetometer": 'gnomon.calibrate_magnetometer(gnomon.read("recording.csv"))',
    "calibrate_turntable": 'gnomon.calibrate_turntable([gnomon.read_turntable("disc.csv")], rates)',
    "calibrate_cameras": 'gnomon.calibrate_cameras(*gnomon.read_camera_views("images", target="target.yaml"))',
    "calibrate_camera_imu": "gnomon.calibrate_camera_imu(*gnomon.read_camera_imu("
    '"rig.bag", cam="camchain.yaml", imu="imu.yaml", target="target.yaml"))',
}

_PROTOCOL_PROBLEMS = {"never-static", "always-static", "gyroscope-silent", "attitudes"}

LEFT_TO_RESTS = frozenset({"attitudes", "gyroscope-silent"})
"""What the data doctor holds against a multi-position recording, and what rests alone may do without."""

GAP_NS = 500_000_000
"""A longer step between two samples is a time that was not recorded."""

_GAP_STEPS = 20


def check_arguments(function: str, *values: object) -> None:
    """Check that a recipe is given recordings, and a board where it takes one as the last.

    Raises
    ------
    OptionError
        If one is something else, such as the path of a file.
    """
    kinds = (Recording, Target) if function in ("calibrate_cameras", "calibrate_camera_imu") else (Recording,)
    for number, value in enumerate(values):
        kind = kinds[min(number, len(kinds) - 1)]
        if not isinstance(value, kind):
            shown = f"{type(value).__name__} {value!r:.60}" if isinstance(value, str) else type(value).__name__
            raise OptionError(
                f"{function} takes a {kind.__name__}, and was given a {shown}. Read it first: {_READ[function]}."
            )


def is_evidence_stated(options: ImuOptions, prior: Priors) -> bool:
    """Return whether somebody states what is known beforehand, or what shall not be taken from it."""
    return bool(prior or options.fix or options.free or options.prior)


def refuse_evidence(options: ImuOptions, prior: Priors) -> None:
    """Refuse evidence for a published method, which knows no use of it.

    Raises
    ------
    OptionError
        If there is any.
    """
    if is_evidence_stated(options, prior):
        raise OptionError(
            f"preset {options.preset} knows neither --prior nor --fix nor --free. "
            "Leave them out, or use the default preset."
        )


@value_class
class PreparedImu:
    """One IMU, ready for estimation.

    Attributes
    ----------
    accelerometer, gyroscope : samples without duplicates
    accelerometer_time, gyroscope_time : instants of sampling, one origin
    accelerometer_saturated, gyroscope_saturated : (n,) clipped samples
    findings : what the data doctor noticed
    rests : where it rested, as the data doctor found it; None where it is shorter than two windows
    temperature : readings of its thermometer; None where it did not both rise and fall
    """

    accelerometer: TriadSamples
    gyroscope: TriadSamples
    accelerometer_time: TimeBase
    gyroscope_time: TimeBase
    accelerometer_saturated: Booleans
    gyroscope_saturated: Booleans
    findings: tuple[Finding, ...]
    rests: RestDetection | None
    temperature: TemperatureSamples | None = None

    @property
    def units(self) -> dict[str, str]:
        """Units of both triads, by their names."""
        return {"accelerometer": self.accelerometer.unit, "gyroscope": self.gyroscope.unit}


def check_and_detect(
    recording: Recording, name: str, options: ImuOptions
) -> tuple[tuple[Finding, ...], RestDetection | None]:
    """Return what the data doctor says of one IMU of a recording, and the rests that he found on the way."""
    found: list[RestDetection | None] = []

    def find_rests(imu: ImuSamples) -> RestDetection | None:
        """Find the rests of an IMU by the options, and keep them for the fit."""
        found.append(
            find_imu_rests(
                imu,
                window_s=options.window_s,
                multiplier=options.multiplier,
                accelerometer_range=options.accelerometer_range,
                gravity_m_s2=local_gravity(options).value,
                counted=options.time_base == "uniform",
            )
        )
        return found[-1]

    findings = check_by_rests(replace(recording, imus={name: recording.imus[name]}), find_rests)
    return findings, next(iter(found), None)


def prepare_imu(recording: Recording, options: ImuOptions, *, tolerated: frozenset[str] = frozenset()) -> PreparedImu:
    """Check a recording and put its first IMU on its time base.

    Parameters
    ----------
    recording, options : see `calibrate_imu`
    tolerated : codes of findings that are left to the caller, although the data doctor calls them a problem

    Raises
    ------
    RecordingError
        If the recording holds no IMU, or something that no calibration can use.
    DetectionError
        If it does not follow the protocol: never at rest, always at rest, too few attitudes.
    """
    if not recording.imus:
        raise RecordingError("the recording holds no IMU. Give a file with accelerometer and gyroscope samples.")
    name, samples = next(iter(recording.imus.items()))
    assumptions = recording.assumptions
    if len(recording.imus) > 1:
        assumptions += (f"the recording holds {len(recording.imus)} IMUs; {name} is the one that is calibrated.",)
    findings, rests = check_and_detect(recording, name, options)
    findings += tuple(map(assumption_finding, assumptions))
    raise_first_problem(findings, tolerated=tolerated)
    if not len(samples.gyroscope):
        raise RecordingError(
            "the recording holds no gyroscope samples. "
            "Give a file with both triads, or the gyroscope's file as a second path."
        )
    return _on_time_base(samples, findings, rests, options)


def raise_first_problem(findings: Iterable[Finding], *, tolerated: frozenset[str] = frozenset()) -> None:
    """Raise the first problem among what the data doctor found.

    Raises
    ------
    RecordingError, DetectionError
        See `prepare_imu`.
    """
    for finding in findings:
        if finding.severity == "problem" and finding.code not in tolerated:
            kind = DetectionError if finding.code in _PROTOCOL_PROBLEMS else RecordingError
            raise kind(str(finding))


def assumption_finding(sentence: str) -> Finding:
    """Return what a reader had to take for granted as a finding."""
    return make_finding("assumed", text=sentence)


def recording_names(recordings: Sequence[Recording]) -> list[str]:
    """Return what each recording is called: its first file, with its number where files are called alike."""
    files = [recording.sources[0].name if recording.sources else "" for recording in recordings]
    return [
        name if name and files.count(name) == 1 else f"recording {i}" + (f" ({name})" if name else "")
        for i, name in enumerate(files, 1)
    ]


def refuse_same_data(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    """Refuse recordings of which two hold the same samples, as files or in part.

    Raises
    ------
    RecordingError
        If there are such; the message says where.
    """
    for i, j in combinations(range(len(names)), 2):
        first, second = recordings[i], recordings[j]
        one, other = _telling_triad(first), _telling_triad(second)
        same = shared_sources(first.sources, second.sources)
        if same:
            alike = "file" if same[0].sha256 in {source.sha256 for source in second.sources} else "measurements"
            raise RecordingError(
                f"{names[i]} and {names[j]} are the same {alike}, which would count twice. Leave one out."
            )
        shared = [] if one is None or other is None else repeated_stretches(one.values, other.values)
        if shared and one is not None and other is not None:
            count = sum(repeat.first_stop - repeat.first for repeat in shared)
            raise RecordingError(
                f"{names[i]} and {names[j]} share {count} samples: those of {names[i]} from "
                f"{one.t_s[shared[0].first]:.2f} s on are those of {names[j]} from {other.t_s[shared[0].second]:.2f} s "
                "on. They would count twice. Leave one recording out, or cut what they share out of one."
            )


def _telling_triad(recording: Recording) -> TriadSamples | None:
    """Return the triad by whose samples a recording is known."""
    for imu in recording.imus.values():
        return imu.accelerometer if len(imu.accelerometer) else imu.gyroscope
    return None


def _on_time_base(
    samples: ImuSamples, findings: tuple[Finding, ...], rests: RestDetection | None, options: ImuOptions
) -> PreparedImu:
    counted = options.time_base == "uniform"
    if rests is not None:
        accelerometer, gyroscope, saturated = rests.motion.samples, rests.gyroscope, rests.motion.saturated
    else:
        accelerometer, gyroscope = (
            repair_samples(one, counted=counted) for one in (samples.accelerometer, samples.gyroscope)
        )
        saturated = saturated_samples(accelerometer, options.accelerometer_range)
    origin, warmth = int(min(accelerometer.t_ns[0], gyroscope.t_ns[0])), samples.temperature
    accelerometer_time = time_base(accelerometer, origin, options.time_base)
    shared = np.array_equal(accelerometer.t_ns, gyroscope.t_ns)
    gyroscope_time = accelerometer_time if shared else time_base(gyroscope, origin, options.time_base)
    findings += tuple(_uniform_despite_gaps(accelerometer_time, gyroscope_time))
    return PreparedImu(
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        accelerometer_time=accelerometer_time,
        gyroscope_time=gyroscope_time,
        accelerometer_saturated=saturated,
        gyroscope_saturated=saturated_samples(gyroscope, options.gyroscope_range),
        findings=findings,
        rests=rests,
        temperature=None if warmth is None or not rose_and_fell(warmth) else warmth,
    )


def _uniform_despite_gaps(accelerometer: TimeBase, gyroscope: TimeBase) -> list[Finding]:
    """Warn where a uniform time base was stated although the timestamps show that samples are missing."""
    missing, longest = max((base.missing, len(base.t_s)) for base in (accelerometer, gyroscope))
    if not missing:
        return []
    return [make_finding("time-base-stated", longest=longest, missing=missing)]


def local_gravity(options: ImuOptions | CameraImuOptions | TurntableOptions) -> Gravity:
    """Return gravity as stated, by latitude, or standard gravity with the spread that it has in the world."""
    if options.gravity is not None:
        return Gravity(value=options.gravity, sigma=0.0, source="as stated")
    if options.latitude is not None:
        value = normal_gravity_m_s2(options.latitude, options.altitude)
        source = f"normal gravity at latitude {options.latitude:g} deg, altitude {options.altitude:g} m"
        return Gravity(value=value, sigma=NORMAL_GRAVITY_SIGMA_M_S2, source=source)
    return UNSTATED_GRAVITY


def stated_options(
    options: ImuOptions | CameraImuOptions | CameraOptions | TurntableOptions | MagnetometerOptions,
    recordings: Sequence[Recording] = (),
) -> dict[str, str]:
    """Return the options that differ from their default, as text, and at which temperature the chip was recorded."""
    stated = {f.name: str(getattr(options, f.name)) for f in fields(options) if getattr(options, f.name) != f.default}
    return stated | chip_temperature(recordings)


def imu_calibration(estimate: ImuEstimate, units: Mapping[str, str]) -> ImuCalibration:
    """Return estimated parameters as the calibration of an IMU whose triads are in these units."""
    return ImuCalibration(
        accelerometer=AccelerometerCalibration(
            sensitivity=estimate.accelerometer_sensitivity,
            bias=estimate.accelerometer_bias,
            unit=units["accelerometer"],
        ),
        gyroscope=GyroscopeCalibration(
            sensitivity=estimate.gyroscope_sensitivity,
            bias=estimate.gyroscope_bias,
            g_sensitivity=estimate.g_sensitivity,
            unit=units["gyroscope"],
        ),
    )


def weighted_stream(samples: TriadSamples, t_s: Floats, clipped: Booleans, still: StaticIntervals) -> TriadStream:
    """Return samples with their noise at rest, as estimation needs them."""
    of_means, of_increments = resting_noise(samples.values, still, samples.rate_hz)
    step = np.nan_to_num(smallest_steps(samples.values))
    rounded = step**2 / 12 / samples.rate_hz  # in motion it is white
    return TriadStream(
        t_s=t_s,
        values=samples.values,
        saturated=clipped,
        rate_hz=samples.rate_hz,
        density=of_means,
        density_in_motion=np.maximum(of_increments, rounded),
        rounding=rounding_variance(samples.values, still, step),
        intervals=still,
    )


def recording_gaps(samples: TriadSamples) -> Booleans:
    """Return which steps from sample to sample are times that were not recorded, (n - 1,)."""
    steps = np.diff(samples.t_ns)
    return steps > max(GAP_NS, _GAP_STEPS * np.median(steps)) if len(steps) else np.empty(0, dtype=bool)


def chip_temperature(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return mean and range of the first IMU's temperature [degC], as text of the provenance; nothing without one."""
    imus = [next(iter(one.imus.values())) for one in recordings if one.imus]
    read = [known_readings(imu.temperature) for imu in imus if imu.temperature is not None]
    celsius = [one[1] for one in read if one is not None]
    if not celsius or len(celsius) < len(recordings):
        return {}
    mean = float(np.mean([one.mean() for one in celsius]))
    low, high = (float(pick([pick(one) for one in celsius])) for pick in (np.min, np.max))
    if not CHIP_DEGC[0] <= mean <= CHIP_DEGC[1]:
        return {}
    return {"chip_degc": f"{mean:.2f}", "chip_range_degc": f"{low:.2f} to {high:.2f}"}


def found_intervals(prepared: PreparedImu, options: ImuOptions) -> RestDetection:
    """Return the static intervals (Eq. 3.9) that were found, where they are enough for a calibration."""
    samples, detection = prepared.accelerometer, prepared.rests
    if detection is None:
        raise DetectionError(
            f"the recording of {samples.duration_s:.1f} s is too short for windows of {options.window_s:g} s. "
            "Record at least nine attitudes of 2 to 4 s each."
        )
    if detection.chosen.fit is None:
        most = max(len(trial.intervals) for trial in detection.trials)
        raise DetectionError(
            f"the {most} static intervals found do not determine the accelerometer: their attitudes are too much "
            "alike. Hold the sensor still with every axis up once and down once, and in some directions between."
        )
    return detection


@value_class
class ImuReadings:
    """What is fitted: static intervals of both triads, and the rotations between them.

    Attributes
    ----------
    problem, streams : see `build_problem`
    touched : which of the intervals found were disturbed, and are left out
    course : of the accelerometer's bias over the time, see `accelerometer_course`
    reference_degc : mean temperature at rest [degC]; None where it did not both rise and fall
    lag_s : of the thermometer, which is undone in the temperature [s]
    noticed : what all intervals, also those that were disturbed, show of axes that changed
    """

    problem: MultiPositionProblem
    streams: tuple[TriadStream, TriadStream]
    touched: Booleans
    course: BiasChanges
    reference_degc: float | None
    lag_s: float
    noticed: list[Finding]


def gather_readings(
    prepared: PreparedImu, chosen: ThresholdTrial, options: ImuOptions, *, lag_s: float = 0.0
) -> ImuReadings:
    """Return what is fitted, with the lag of the thermometer undone."""
    at_rest = weighted_stream(
        prepared.accelerometer,
        prepared.accelerometer_time.t_s,
        prepared.accelerometer_saturated,
        chosen.intervals,
    )
    reference = None
    if prepared.temperature is not None and (course := temperature_course(prepared.temperature, lag_s)) is not None:
        degc = course.with_rate(prepared.accelerometer.t_ns)
        resting = interval_means(degc, chosen.intervals)[:, 0]
        reference = float(resting.mean())
        at_rest = replace(at_rest, degc=temperature_powers(degc, resting, course.step_k))
    changes, functions = accelerometer_course(at_rest)
    touched = disturbed_intervals(chosen, prepared.accelerometer, functions, at_rest.density)
    problem, streams = _problem(prepared, at_rest, touched, options)
    whole = _problem(prepared, at_rest, np.zeros_like(touched), options)[0] if touched.any() else problem
    return ImuReadings(
        problem=problem,
        streams=streams,
        touched=touched,
        course=changes,
        reference_degc=reference,
        lag_s=lag_s,
        noticed=look_or_postpone(lambda: axes_changed_findings(whole)),
    )


_OUTLIER_SIGMA = 6.0
_SUSPICIOUS_SIGMA = 2.5
_REWEIGHTINGS = 6
_NO_WEIGHT = 1e-6


def accelerometer_course(accelerometer: TriadStream) -> tuple[BiasChanges, Floats]:
    """Return how the accelerometer's bias changed, by its rests, and the functions of time (n, j) that it follows."""
    changes = accelerometer_changes(rest_means(accelerometer))
    start, stop = (accelerometer.t_s[at] for at in (accelerometer.intervals.start, accelerometer.intervals.stop - 1))
    return changes, functions_of_time(changes, 0.5 * (start + stop), 0.5 * (stop - start), accelerometer.degc_at_rest)


def disturbed_intervals(
    trial: ThresholdTrial, samples: TriadSamples, course: Floats | None = None, noise: Floats | None = None
) -> Booleans:
    """Return which intervals do not show gravity like the others, (n,): touched, or not at rest.

    Where a residual stands out, the sum of absolute residuals is minimised first, by reweighting, so that several
    disturbed intervals cannot hide by bending the fit; then each interval is judged by its residual when left out of a
    fit to those that agree. Residuals of a few per cent of gravity are linear enough to be refitted as they stand.

    Parameters
    ----------
    course : (n, j) functions of time that the bias follows, from `accelerometer_course`
    noise : (3,) density of means at rest, where it is known; see `resting_noise`
    """
    assert trial.fit is not None
    duration = (trial.intervals.stop - trial.intervals.start) / samples.rate_hz
    weight = np.sqrt(duration / duration.mean())
    noise = resting_noise(samples.values, trial.intervals, samples.rate_hz)[0] if noise is None else noise
    white = np.sqrt(np.mean(noise) / duration) * np.abs(np.linalg.det(trial.fit.correction)) ** (1 / 3)
    residual, jacobian = trial.fit.residual / weight, trial.fit.jacobian / weight[:, None]
    if course is not None:
        moving = course[:, :, None] * jacobian[:, None, 6:]
        jacobian = np.concatenate([jacobian, moving.reshape(len(jacobian), -1)], axis=1)

    def left_out(given: Floats) -> Floats:
        """Return the size of each residual in a weighted fit from which it was left out."""
        q, r = np.linalg.qr(jacobian * given[:, None])
        step = -np.linalg.lstsq(r, q.T @ (residual * given), rcond=1e-12)[0]
        leverage = np.einsum("ij,ij->i", q, q)
        return np.abs(residual + jacobian @ step) / np.maximum(1 - leverage, 1e-6)

    def stand_out(size: Floats, usual: float, sigmas: float) -> Booleans:
        return size > sigmas * np.maximum(1.4826 * usual, white)

    nothing = np.zeros(len(weight), dtype=bool)
    size = left_out(weight)
    if not stand_out(size, float(median_of(size)), _SUSPICIOUS_SIGMA).any():
        return nothing
    for _ in range(_REWEIGHTINGS):
        size = left_out(1 / np.sqrt(np.maximum(size, white)))
    agree = ~stand_out(size, 2 * float(median_of(size)), _OUTLIER_SIGMA)
    size = left_out(np.where(agree, weight, _NO_WEIGHT))
    out = stand_out(size, float(median_of(size[agree])), _OUTLIER_SIGMA)
    keeps_enough = (~out).sum() >= max(FEWEST_INTERVALS + 1, 0.6 * len(out))
    return out if keeps_enough else nothing


def _problem(
    prepared: PreparedImu, accelerometer: TriadStream, touched: Booleans, options: ImuOptions
) -> tuple[MultiPositionProblem, tuple[TriadStream, TriadStream]]:
    """Gather what the undisturbed intervals and the rotations between them measured."""
    t_s, still = accelerometer.t_s, accelerometer.intervals.where(~touched)
    if touched.any():
        degc = accelerometer.degc
        accelerometer = weighted_stream(prepared.accelerometer, t_s, accelerometer.saturated, still)
        accelerometer = replace(accelerometer, degc=degc)
    rates, t_gyro = prepared.gyroscope, prepared.gyroscope_time.t_s
    at_rest = gyroscope_intervals(t_gyro, t_s[still.start], t_s[still.stop - 1])
    if len(at_rest) == 0 or np.any(at_rest.stop - at_rest.start < 2):
        raise DetectionError(
            "the gyroscope has no samples in some static intervals of the accelerometer. "
            "Both must be recorded together and stamped by one clock."
        )
    gyroscope = weighted_stream(rates, t_gyro, prepared.gyroscope_saturated, at_rest)
    if accelerometer.degc is not None:
        near = np.clip(np.searchsorted(t_s, t_gyro), 0, len(t_s) - 1)
        gyroscope = replace(gyroscope, degc=accelerometer.degc[near])
    # The earth's horizontal rate, of unknown heading, spread over the two level axes; 2/3 is the mean over the sphere.
    cosine_squared = 2 / 3 if options.latitude is None else float(np.cos(np.radians(options.latitude)) ** 2)
    unmodelled = EARTH_RATE_RAD_S**2 * cosine_squared / 2
    return build_problem(accelerometer, gyroscope, unmodelled), (accelerometer, gyroscope)
