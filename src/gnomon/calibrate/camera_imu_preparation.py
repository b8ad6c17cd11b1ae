"""Before anything is estimated from cameras and IMU: checked, in SI units, on one time base."""

from dataclasses import dataclass, replace

import numpy as np

from ..assess.camera_checks import check_cameras
from ..assess.rig_checks import check_look
from ..detect.samples.repair import repaired
from ..detect.samples.saturation import saturated
from ..detect.samples.time_base import time_base
from ..errors import DetectionError, RecordingError
from ..estimate.camera_imu.batch import Noise
from ..estimate.camera_imu.first_guess import ImuStream, Look
from ..estimate.camera_imu.inertial_terms import InertialData, InertialNoise, TriadData
from ..findings import Finding
from ..models.noise import CONSUMER_MEMS, ImuNoise
from ..models.target import Target
from ..options import CameraImuOptions
from ..recording import ImuSamples, Recording, TriadSamples
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_CONTRADICTIONS = {"axes-differ", "axes-mirrored"}
_FEW_CODES = {"frames-few", "corners-few", "stream-short"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedCameraImu:
    """Readings ready for estimation.

    Attributes
    ----------
    inertial : of imu0
    origin_ns : stamp at which the seconds start [ns]
    rates_hz : sample rates of gyroscope and accelerometer
    nominal : noise as it was stated, or as consumer sensors have it
    stated : whether it was stated
    findings : what the data doctor noticed
    """

    inertial: tuple[InertialData, ...]
    origin_ns: int
    rates_hz: tuple[float, float]
    nominal: ImuNoise
    stated: bool
    findings: tuple[Finding, ...]

    def first_noise(self, pixel_sigma: tuple[float, ...], huber: float) -> Noise:
        """Return the noise levels to start with."""
        gyroscope, accelerometer = np.sqrt(self.rates_hz)
        return Noise(
            imus=(
                InertialNoise(
                    gyroscope=self.nominal.gyroscope_noise_density * gyroscope,
                    accelerometer=self.nominal.accelerometer_noise_density * accelerometer,
                ),
            ),
            walks=((self.nominal.gyroscope_random_walk, self.nominal.accelerometer_random_walk),),
            pixel_sigma=pixel_sigma,
            huber=huber,
        )


def prepare_camera_imu(recording: Recording, target: Target, options: CameraImuOptions) -> PreparedCameraImu:
    """Check a recording and put its first IMU into SI units and on its time base.

    Raises
    ------
    RecordingError
        If the recording holds no IMU or no camera, or something that no calibration can use.
    DetectionError
        If the board was seen too rarely.
    """
    if not recording.imus:
        raise RecordingError("the recording holds no IMU. Give a folder with imu0.csv beside the corners.")
    assumptions = recording.assumptions
    if len(recording.imus) > 1:
        first = next(iter(recording.imus))
        assumptions += (f"the recording holds {len(recording.imus)} IMUs; {first} is the one that is calibrated.",)
    found = (*recording.findings, *check_cameras(recording, target))
    for finding in found:
        if finding.severity == "problem":
            raise (DetectionError if finding.code in _FEW_CODES else RecordingError)(str(finding))
    findings = (*found, *(Finding(severity="info", code="assumed", message=text) for text in assumptions))
    samples = next(iter(recording.imus.values()))
    accelerometer = _in_si(repaired(samples.accelerometer), "accelerometer", ACCELEROMETER_UNITS_M_S2, "m/s^2")
    gyroscope = _in_si(repaired(samples.gyroscope), "gyroscope", GYROSCOPE_UNITS_RAD_S, "rad/s")
    origin = int(min(accelerometer.t_ns[0], gyroscope.t_ns[0]))
    return PreparedCameraImu(
        inertial=_inertial(accelerometer, gyroscope, origin, options),
        origin_ns=origin,
        rates_hz=(gyroscope.rate_hz, accelerometer.rate_hz),
        nominal=samples.noise or CONSUMER_MEMS,
        stated=samples.noise is not None,
        findings=(*findings, *_noise_findings(samples)),
    )


def with_looks(
    prepared: PreparedCameraImu, found: tuple[Look, ...], target: Target, stream: ImuStream, *, imu: str
) -> PreparedCameraImu:
    """Return the same with what cameras and IMU say of each other among its findings.

    Raises
    ------
    RecordingError
        If their axes contradict each other, so that nothing could be estimated.
    """
    gyroscope = next(data.gyroscope for data in prepared.inertial if data.gyroscope is not None)
    findings: list[Finding] = []
    for look in found:
        if look.alignment.score == 0:
            continue  # taken as stated, since nothing tells it
        findings += check_look(
            look.name,
            look.poses,
            look.alignment,
            look.frames.camera,
            target,
            stream=stream,
            imu=imu,
            unusable=~gyroscope.used,
        )
    for finding in findings:
        if finding.code in _CONTRADICTIONS:
            raise RecordingError(str(finding))
    return replace(prepared, findings=(*prepared.findings, *findings))


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
    accelerometer: TriadSamples, gyroscope: TriadSamples, origin: int, options: CameraImuOptions
) -> tuple[InertialData, ...]:
    clipped = saturated(gyroscope, options.gyroscope_range), saturated(accelerometer, options.accelerometer_range)
    triads = [
        TriadData(values=samples.values, used=~mask)
        for samples, mask in zip((gyroscope, accelerometer), clipped, strict=True)
    ]
    t_gyro = time_base(gyroscope, origin).t_s
    if np.array_equal(gyroscope.t_ns, accelerometer.t_ns):
        return (InertialData(imu=0, t_s=t_gyro, gyroscope=triads[0], accelerometer=triads[1]),)
    t_accel = time_base(accelerometer, origin).t_s
    return (
        InertialData(imu=0, t_s=t_gyro, gyroscope=triads[0], accelerometer=None),
        InertialData(imu=0, t_s=t_accel, gyroscope=None, accelerometer=triads[1]),
    )


def _noise_findings(samples: ImuSamples) -> list[Finding]:
    if samples.noise is not None:
        return []
    return [
        Finding(
            severity="info",
            code="noise-assumed",
            message="No noise of the IMU was stated; the random walks of its biases are taken as consumer sensors "
            "have them, the white noise from the residuals.",
            consequence="The uncertainty of the biases, and of what correlates with them, rests on that.",
            cure="Give imu.yaml with the noise by the Allan deviation.",
        )
    ]
