"""Before a magnetometer is calibrated: its samples, and an accelerometer's, checked and put on their time base."""

from dataclasses import dataclass, replace

import numpy as np

from ..assess.doctor import check_field_samples
from ..calibration import Calibration
from ..detect.samples.repair import repaired
from ..detect.samples.saturation import saturated
from ..detect.samples.time_base import time_base
from ..errors import DetectionError, OptionError, RecordingError
from ..estimate.triads.field_poses import rough_ellipsoid, sample_noise
from ..estimate.triads.triad_start import Ellipsoid
from ..evidence import Priors
from ..findings import Finding, make_finding
from ..intervals import Booleans
from ..recording import Floats, Recording, TriadSamples
from ..sensors import MagnetometerCalibration
from ..triad_options import MagnetometerOptions

_FIELDS_UT = (10.0, 200.0)
_FEWEST, _SHORTEST_S = 100, 5.0
_STILL = 15.0  # times the noise that the range of a turned sensor exceeds
_FLAT = 0.04  # of the widest direction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedField:
    """A magnetometer's recording, ready for estimation.

    Attributes
    ----------
    magnetometer : samples without duplicates
    t_s : (n,) instants of sampling [s]
    usable : (n,) bool, not clipped
    accelerometer : beside it, or None where there is none that can be used
    accelerometer_t_s : its instants of sampling, on the same clock
    shape, usual : rough ellipsoid of radius 1, and the usual distance of samples from it
    findings : what was noticed
    """

    magnetometer: TriadSamples
    t_s: Floats
    usable: Booleans
    accelerometer: TriadSamples | None
    accelerometer_t_s: Floats
    shape: Ellipsoid
    usual: float
    findings: tuple[Finding, ...]


def prepare_field(recording: Recording, options: MagnetometerOptions) -> PreparedField:
    """Check a recording and put its first magnetometer on its time base.

    Raises
    ------
    RecordingError
        If there is no magnetometer, or its samples are of no use.
    DetectionError
        If it was not turned, or about one axis only.
    """
    found = next(((name, imu) for name, imu in recording.imus.items() if imu.magnetometer is not None), None)
    if found is None:
        raise RecordingError(
            "the recording holds no magnetometer. Give a file with one; if its columns have other names, state them: "
            '--columns "t mx my mz" (_ skips a column).'
        )
    name, imu = found
    assert imu.magnetometer is not None
    findings = _checked(imu.magnetometer, f"{name} magnetometer")
    findings += [make_finding("assumed", text=sentence) for sentence in recording.assumptions]
    magnetometer = repaired(imu.magnetometer)
    accelerometer, more = _usable_accelerometer(imu.accelerometer, f"{name} accelerometer")
    origin = int(magnetometer.t_ns[0])
    if accelerometer is not None:
        origin = min(origin, int(accelerometer.t_ns[0]))
    t_s = time_base(magnetometer, origin).t_s
    usable = ~saturated(magnetometer, options.magnetometer_range)
    if usable.sum() < _FEWEST:
        raise RecordingError(
            f"{int((~usable).sum())} of {len(usable)} samples of the magnetometer stand at the end of its range. "
            "Set a wider range, or go farther away from iron and magnets."
        )
    shape, usual = _rough(magnetometer.values[usable])
    return PreparedField(
        magnetometer=magnetometer,
        t_s=t_s,
        usable=usable,
        accelerometer=accelerometer,
        accelerometer_t_s=np.empty(0) if accelerometer is None else time_base(accelerometer, origin).t_s,
        shape=shape,
        usual=usual,
        findings=(*findings, *more),
    )


def _checked(samples: TriadSamples, label: str) -> list[Finding]:
    if len(samples) < _FEWEST or samples.duration_s < _SHORTEST_S:
        raise RecordingError(
            f"{label}: {len(samples)} samples over {samples.duration_s:.1f} s are too short a recording. "
            "Turn the sensor slowly through all attitudes, for a minute or two."
        )
    findings = check_field_samples(samples, label)
    for finding in findings:
        if finding.severity == "problem":
            raise RecordingError(str(finding))
    return [finding for finding in findings if finding.severity != "good"]


def _usable_accelerometer(samples: TriadSamples, label: str) -> tuple[TriadSamples | None, list[Finding]]:
    """Return the accelerometer where nothing is wrong with it, and else what is."""
    if len(samples) < _FEWEST:
        return None, []
    findings = check_field_samples(samples, label)
    wrong = [finding for finding in findings if finding.severity == "problem"]
    if not wrong:
        return repaired(samples), [finding for finding in findings if finding.severity != "good"]
    consequence = "The accelerometer is not used; the magnetometer is calibrated in a frame of its own."
    return None, [replace(wrong[0], severity="warning", consequence=consequence)]


def _rough(values: Floats) -> tuple[Ellipsoid, float]:
    low, high = np.quantile(values, (0.01, 0.99), axis=0)
    if float((high - low).max()) < _STILL * float(sample_noise(values).max()):
        raise DetectionError(
            "the magnetometer shows the same field throughout: it was kept in one orientation. "
            "Turn the sensor through all attitudes, each axis once along the field and once against it."
        )
    inside = values[((values >= low - (high - low)) & (values <= high + (high - low))).all(axis=1)]
    centred = inside - inside.mean(axis=0)
    spread, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    thin = np.sqrt(max(float(spread[0]), 0.0))
    if thin < max(_FLAT * np.sqrt(float(spread[2])), 3 * float(sample_noise(values).max())):
        axis = "xyz"[int(np.argmax(np.abs(axes[:, 0])))]
        raise DetectionError(
            f"the magnetometer was turned about one axis only, most likely {axis}: all it measured lies in one plane. "
            f"Turn it about the other axes too, so that {axis} points along the field and against it."
        )
    found = rough_ellipsoid(values)
    if found is None:
        raise DetectionError(
            "what the magnetometer measured surrounds no ellipsoid. Turn the sensor through all attitudes in one "
            "place, away from iron and magnets."
        )
    return found


def check_field_options(prior: Priors, options: MagnetometerOptions) -> None:
    """Refuse options that cannot be meant, and to mix sensitivities per uT with those per local field.

    Raises
    ------
    OptionError
        If the field, the place or the range is none, or a prior's or a stated sensitivity is in the other unit.
    """
    if options.field is not None and not _FIELDS_UT[0] < options.field < _FIELDS_UT[1]:
        raise OptionError(
            f"field {options.field:g} uT is found nowhere on Earth (22 to 67 uT). Give the local strength in "
            "microtesla, or leave it out."
        )
    if options.dip is not None and not -90 <= options.dip <= 90:
        raise OptionError(f"dip {options.dip:g} deg is not between -90 and 90.")
    if options.magnetometer_range is not None and not options.magnetometer_range > 0:
        raise OptionError(f"magnetometer_range {options.magnetometer_range:g} must be greater than zero.")
    here = "local field" if options.field is None else "uT"
    priors = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    sensors: list[MagnetometerCalibration] = [
        imu.magnetometer for one in priors for imu in one.imus.values() if imu.magnetometer is not None
    ]
    for sensor in sensors:
        if sensor.field_unit != here:
            hint = "State --field in uT." if here == "local field" else "Leave --field out."
            raise OptionError(f"the prior calibration's field is in {sensor.field_unit}, here it is in {here}. {hint}")
    named = [
        text for text in (*options.fix, *options.prior) if "magnetometer.sens" in text or text.endswith("magnetometer")
    ]
    if named and here == "local field" and not sensors:
        raise OptionError(
            f"{named[0]}: the sensitivity has no value to be held at while the strength of the field is unknown. "
            "State it with --field in uT."
        )
