"""Before anything is estimated from cameras and IMU: checked, in SI units, on one time base."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...assess.checks.board_views import BoardMove, BoardTurns, board_move, moved_finding
from ...assess.checks.rig_checks import check_clock_changes, check_look, name_imu
from ...assess.checks.rig_streams import check_cameras
from ...assess.priors import SCALARS, TRIADS, Prior, Priors, cameras_disagree, gather_prior
from ...detect.samples.faults import held_samples, repair_samples, saturated_samples
from ...errors import DetectionError, RecordingError
from ...estimate.camera_imu.batch import NoiseLevels
from ...estimate.camera_imu.parameters import ImuParameters
from ...estimate.camera_imu.result.uncertainty import Uncertainty
from ...estimate.camera_imu.solution import Solution
from ...estimate.camera_imu.start.alignment import Alignment, gyroscope_integral
from ...estimate.camera_imu.start.board_poses import BoardPoses, board_poses
from ...estimate.camera_imu.start.first_guess import CameraAlignment, ImuStream
from ...estimate.camera_imu.start.imu_alignment import ImuAlignment
from ...estimate.camera_imu.terms.assembly import from_known
from ...estimate.camera_imu.terms.inertial_terms import ImuBeforehand, InertialData, TriadData
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...geometry.rotations import rotvec_from_rotation
from ...models.forms import LOWER, KrebsAccelerometer, KrebsGyroscope
from ...models.target import Target
from ...options import CameraImuOptions
from ...recording import CameraFrames, Floats, Recording, TriadSamples
from ...recording.samples import consumer_mems, time_base
from ...results.calibration import Calibration, Covariance, Gravity
from ...results.result import runs_below
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_SI = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
_ACCELEROMETER, _GYROSCOPE = TRIADS["accelerometer"], TRIADS["gyroscope"]
_S_A = _ACCELEROMETER.start + np.array([0, 3, 4, 6, 7, 8])
_S_G = np.arange(_GYROSCOPE.start, _GYROSCOPE.start + 9)
_B_G = np.arange(_GYROSCOPE.stop - 9, _GYROSCOPE.stop)
_Q_BG = slice(12, 15)  # among the 24 letters
_HANGS_S = 0.25


def evidence_of_imu(prior: Priors, gravity: Gravity, name: str, *, first: bool) -> Prior | None:
    """Return what other calibrations know of an IMU, in SI units, None of nothing; where it sits is not asked.

    Parameters
    ----------
    name : of the IMU
    first : whether it is the first IMU; a calibration of one IMU alone is then of this one, whatever its name

    Raises
    ------
    OptionError
        If a calibration is for measurements in counts.
    """
    given = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    own = [one if first else _alone(one, name) for one in given if first or name in one.imus]
    return gather_prior(own, CameraImuOptions(), _SI, gravity=gravity) if own else None


def _alone(calibration: Calibration, name: str) -> Calibration:
    """Return a calibration of one IMU of several."""
    at = [i for i, scalar in enumerate(calibration.uncertainty.names) if scalar.startswith(f"{name}.")]
    return replace(
        calibration,
        imus={name: calibration.imus[name]},
        cameras={},
        uncertainty=Covariance(
            names=tuple(calibration.uncertainty.names[i] for i in at),
            matrix=calibration.uncertainty.matrix[np.ix_(at, at)],
        ),
    )


def known_imu(found: Prior | None) -> ImuParameters | None:
    """Return the IMU as it is known beforehand, with the covariance of what is known; None without anything."""
    if not found:
        return None
    covariance, own = _joint_covariance(found)
    start, letters = _letters(found.value)
    jacobian = _derivative(letters, found.value)
    if own:
        jacobian[_Q_BG] = 0.0  # a gyroscope known in its own frame says nothing of how it lies in the body
    return replace(start, covariance=jacobian @ covariance @ jacobian.T)


def imu_of(found: Prior) -> ImuParameters:
    """Return the IMU as it is known, without what is known of it."""
    return _letters(found.value)[0]


def cameras_moved(solution: Solution, certain: Uncertainty) -> list[Finding]:
    """Return whether the recording contradicts what was known of the cameras together, lenses and poses."""
    layout, parameters = solution.layout, solution.state.parameters
    rig = layout.start.rig
    if rig is None:
        return []
    found = from_known(rig, layout, parameters)
    at = [i for i, name in enumerate(rig.names) if name in found.names]
    order = [found.names.index(rig.names[i]) for i in at]
    free = layout.free_index
    jacobian, size = found.jacobian[order][:, free], len(free)
    return cameras_disagree(
        tuple(rig.names[i] for i in at),
        found.residual[order],
        rig.covariance[np.ix_(at, at)],
        jacobian @ certain.ordinary[:size, :size] @ jacobian.T,
        jacobian @ certain.covariance[:size, :size] @ jacobian.T,
    )


def _joint_covariance(found: Prior) -> tuple[Floats, bool]:
    """Return the covariance (45, 45) of what is known, and whether the gyroscope is known in its own frame alone."""
    precision = np.zeros((SCALARS, SCALARS))
    own = any(part.own_frame for part in found.known)
    for part in found.known:
        inside = ~np.isin(part.index, _B_G) if part.own_frame else np.ones(len(part.index), dtype=bool)
        at = part.index[inside]
        precision[np.ix_(at, at)] += np.linalg.inv(np.linalg.inv(part.precision)[np.ix_(inside, inside)])
    known = np.flatnonzero(np.diag(precision))
    size = 1 / np.sqrt(np.diag(precision)[known])
    scale = np.outer(size, size)
    covariance = np.zeros((SCALARS, SCALARS))
    covariance[np.ix_(known, known)] = np.linalg.inv(precision[np.ix_(known, known)] * scale) * scale
    return covariance, own


def _letters(x: Floats) -> tuple[ImuParameters, Callable[[Floats], Floats]]:
    """Return the IMU of scalars x (45,), and the function that gives the 24 letters of others near it."""

    def imu(y: Floats) -> ImuParameters:
        """Return the IMU of scalars (45,)."""
        accelerometer = KrebsAccelerometer.from_sensor(np.tril(y[:9].reshape(3, 3)), y[9:12])
        gyroscope = KrebsGyroscope.from_sensor(y[_S_G].reshape(3, 3), np.zeros(3), np.zeros((3, 3)))
        return ImuParameters(
            S_a=accelerometer.S,
            M_a=LOWER.parameters(accelerometer.M),
            S_g=gyroscope.S,
            M_g=LOWER.parameters(gyroscope.M),
            C_bg=gyroscope.C_bg,
            B_g=y[_B_G].reshape(3, 3),
        )

    start = imu(x)

    def letters(y: Floats) -> Floats:
        now = imu(y)
        turned = rotvec_from_rotation(start.C_bg.T @ now.C_bg)
        return np.concatenate([now.S_a, now.M_a, now.S_g, now.M_g, turned, now.B_g.ravel()])

    return start, letters


def _derivative(letters: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Return the derivative (24, 45) of the letters by the scalars."""
    jacobian = np.zeros((24, SCALARS))
    for i in (*_S_A, *_S_G, *_B_G):
        step = np.zeros(SCALARS)
        step[i] = 1e-6
        jacobian[:, i] = (letters(x + step) - letters(x - step)) / 2e-6
    return jacobian


_CONTRADICTIONS = {"axes-differ", "axes-mirrored"}
_OF_ONE_IMU = "triads-apart"  # of all that is noticed beside an IMU, what the others do not share
_SUSPECTS = (
    "clock-jump",
    "saturation",
    "rate-magnitude",
    "board-small",
    "corners-few",
    "gaps",
    "frame-rate",
    "frames-few",
)
"""What keeps camera and gyroscope from showing the same rotation, the surest first."""
_GRAVE = ("warning", "problem")

_FEW_CODES = {"frames-few", "corners-few", "stream-short"}


@value_class
class PreparedCameraImu:
    """Readings ready for estimation.

    Attributes
    ----------
    inertial : of all IMUs, each in seconds of its own clock
    imus : what is known of each
    findings : what the data doctor noticed
    move : where the board seems to have been moved, or None; the estimation tells whether it was
    landmarks : whether there was no board, but the landmarks of a scene
    """

    inertial: tuple[InertialData, ...]
    imus: tuple[ImuBeforehand, ...]
    findings: tuple[Finding, ...]
    move: BoardMove | None = None
    landmarks: bool = False

    @property
    def origin_ns(self) -> int:
        """Timestamp at which the seconds of the first IMU, and of the cameras, start [ns]."""
        return self.imus[0].origin_ns

    @property
    def epochs_s(self) -> tuple[float, ...]:
        """For each IMU, start of the body's seconds less the start of its own, as timestamps of their clocks [s]."""
        return tuple((self.origin_ns - imu.origin_ns) * 1e-9 for imu in self.imus)

    def first_noise(self, pixel_sigma: tuple[float, ...], huber: float) -> NoiseLevels:
        """Return the noise levels to start with."""
        return NoiseLevels(
            imus=tuple(imu.noise for imu in self.imus),
            walks=tuple(imu.walks for imu in self.imus),
            pixel_sigma=pixel_sigma,
            huber=huber,
            lasting=self.landmarks,
        )


def prepare_camera_imu(recording: Recording, target: Target, options: CameraImuOptions) -> PreparedCameraImu:
    """Check a recording and put its IMUs into SI units, each on its own time base.

    Raises
    ------
    RecordingError
        If the recording holds no IMU or no camera, or something that no calibration can use.
    DetectionError
        If the board was seen too rarely.
    """
    if not recording.imus:
        raise RecordingError("the recording holds no IMU. Give a folder with imu0.csv beside the corners.")
    found = (*recording.findings, *check_cameras(recording, target))
    for finding in found:
        if finding.severity == "problem":
            raise (DetectionError if finding.code in _FEW_CODES else RecordingError)(str(finding))
    findings = [*found, *(make_finding("assumed", text=text) for text in recording.assumptions)]
    inertial: list[InertialData] = []
    imus: list[ImuBeforehand] = []
    for number, (name, samples) in enumerate(recording.imus.items()):
        accelerometer = _in_si(
            repair_samples(samples.accelerometer), "accelerometer", ACCELEROMETER_UNITS_M_S2, "m/s^2"
        )
        gyroscope = _in_si(repair_samples(samples.gyroscope), "gyroscope", GYROSCOPE_UNITS_RAD_S, "rad/s")
        accelerometer, gyroscope = _without_hangs(accelerometer, gyroscope)
        origin = int(min(accelerometer.t_ns[0], gyroscope.t_ns[0]))
        inertial += _inertial(number, accelerometer, gyroscope, origin, options)
        imus.append(
            ImuBeforehand(
                name=name,
                origin_ns=origin,
                rates_hz=(gyroscope.rate_hz, accelerometer.rate_hz),
                nominal=samples.noise or consumer_mems(),
                stated=samples.noise is not None,
            )
        )
    findings += _noise_findings(imus)
    return PreparedCameraImu(
        inertial=tuple(inertial), imus=tuple(imus), findings=tuple(findings), landmarks=target.kind == "landmarks"
    )


def likely_cause(findings: Sequence[Finding], move: BoardMove | None = None) -> str:
    """Return, as a sentence, what was noticed that most likely keeps the same rotation from being seen; or nothing."""
    if move is not None:
        return f" Noticed: {moved_finding(move).message}"
    found = [one.message for code in _SUSPECTS for one in findings if one.code == code and one.severity in _GRAVE]
    return f" Noticed: {found[0]}" if found else ""


def refuse_clock_jumps(
    prepared: PreparedCameraImu, cameras: Mapping[str, CameraFrames], target: Target, streams: Sequence[ImuStream]
) -> None:
    """Say which clock jumped, where that is why nothing could be aligned; the first camera tells of the other IMUs.

    Raises
    ------
    RecordingError
        If one did.
    """
    for number, stream in enumerate(streams):
        for name, frames in list(cameras.items())[: 1 if number else None]:
            t_s = np.asarray((frames.t_ns - prepared.origin_ns) * 1e-9, dtype=np.float64)
            _refuse_clocks(name, board_poses(frames, target, t_s), None, stream, prepared.imus[number].name)


def _refuse_clocks(name: str, poses: BoardPoses, alignment: Alignment | None, stream: ImuStream, imu: str) -> None:
    for finding in check_clock_changes(name, poses, gyroscope_integral(stream.t_s, stream.rate), alignment, imu):
        raise RecordingError(str(finding))


def with_looks(
    prepared: PreparedCameraImu,
    found: Sequence[CameraAlignment],
    target: Target,
    streams: Sequence[ImuStream],
    beside: Sequence[ImuAlignment],
) -> PreparedCameraImu:
    """Return the same with what cameras and IMUs say of each other among its findings.

    Raises
    ------
    RecordingError
        If their axes contradict each other, or a clock jumped so far that one time shift means nothing.
    """
    findings: list[Finding] = []
    turns: dict[str, BoardTurns] = {}
    for look in found:
        own, seen = _looked(prepared, look, target, streams[0], 0)
        findings += own
        turns |= {} if seen is None else {look.name: seen}
    known = {finding.code for finding in findings}
    for number, one in enumerate(beside, 1):
        look = replace(one.look, alignment=one.alignment)
        own, _ = _looked(prepared, look, target, streams[number], number)
        findings += [name_imu(one.name, found) for found in own if found.code not in known or found.code == _OF_ONE_IMU]
    for finding in findings:
        if finding.code in _CONTRADICTIONS:
            raise RecordingError(str(finding))
    return replace(prepared, findings=(*prepared.findings, *findings), move=board_move(turns))


def _looked(
    prepared: PreparedCameraImu, look: CameraAlignment, target: Target, stream: ImuStream, number: int
) -> tuple[list[Finding], BoardTurns | None]:
    """Return what a camera and an IMU say of each other."""
    if look.alignment.score == 0:
        return [], None  # taken as stated, since nothing tells it
    _refuse_clocks(look.name, look.poses, look.alignment, stream, prepared.imus[number].name)
    gyroscope = next(data.gyroscope for data in prepared.inertial if data.imu == number and data.gyroscope is not None)
    return check_look(
        look.name,
        look.poses,
        look.alignment,
        None if number else look.frames.camera,
        target,
        stream=stream,
        imu=prepared.imus[number].name,
        unusable=~gyroscope.used,
    )


def _without_hangs(*triads: TriadSamples) -> list[TriadSamples]:
    """Return triads without the time in which one of them hung: over such a gap the trajectory is cut."""
    kept = [np.ones(len(samples), dtype=bool) for samples in triads]
    for samples in triads:
        moving = np.where(held_samples(samples.values), 0.0, 1.0)
        hangs = runs_below(moving, 0.5, max(round(_HANGS_S * samples.rate_hz), 5))
        for start, stop in zip(samples.t_ns[hangs.start], samples.t_ns[hangs.stop - 1], strict=True):
            kept = [one & ((of.t_ns < start) | (of.t_ns > stop)) for one, of in zip(kept, triads, strict=True)]
    return [
        samples if one.all() else replace(samples, t_ns=samples.t_ns[one], values=samples.values[one])
        for samples, one in zip(triads, kept, strict=True)
    ]


def _in_si(samples: TriadSamples, triad: str, units: dict[str, float | None], si: str) -> TriadSamples:
    factor = units[samples.unit]
    if factor is None:
        raise RecordingError(
            f"the {triad} is in {samples.unit}, which has no known scale; a camera-IMU calibration needs {si}. "
            "Convert the counts by the sensor's data sheet, or calibrate the IMU alone with gnomon imu."
        )
    if samples.unit == si:
        return samples
    return TriadSamples(t_ns=samples.t_ns, values=samples.values * factor, unit=si)


def _inertial(
    number: int, accelerometer: TriadSamples, gyroscope: TriadSamples, origin: int, options: CameraImuOptions
) -> tuple[InertialData, ...]:
    clipped = [
        saturated_samples(gyroscope, options.gyroscope_range),
        saturated_samples(accelerometer, options.accelerometer_range),
    ]
    named = any("lever_arms" in name for name in (*options.free, *options.prior))
    if (options.model == "auto" or named) and clipped[0].any():
        # With lever arms an accelerometer feels the angular acceleration, of which nothing is known there.
        near = np.interp(accelerometer.t_ns - origin, gyroscope.t_ns - origin, clipped[0]) > 0
        clipped[1] = clipped[1] | near
    triads = [
        TriadData(values=samples.values, used=~(mask | held_samples(samples.values)))
        for samples, mask in zip((gyroscope, accelerometer), clipped, strict=True)
    ]
    t_gyro = time_base(gyroscope, origin).t_s
    if np.array_equal(gyroscope.t_ns, accelerometer.t_ns):
        return (InertialData(imu=number, t_s=t_gyro, gyroscope=triads[0], accelerometer=triads[1]),)
    t_accel = time_base(accelerometer, origin).t_s
    return (
        InertialData(imu=number, t_s=t_gyro, gyroscope=triads[0], accelerometer=None),
        InertialData(imu=number, t_s=t_accel, gyroscope=None, accelerometer=triads[1]),
    )


def _noise_findings(imus: Sequence[ImuBeforehand]) -> list[Finding]:
    unknown = [imu.name for imu in imus if not imu.stated]
    if not unknown:
        return []
    of = "the IMU" if len(imus) == 1 else ", ".join(unknown)
    return [make_finding("noise-assumed", of=of)]
