"""Faults of recordings of an IMU that rests in many attitudes."""

from dataclasses import replace
from math import radians

import numpy as np

from gnomon.recording import Floats, TriadSamples
from gnomon.simulate.scenarios.recorded import Scenario
from gnomon.units import STANDARD_GRAVITY_M_S2

from .fault_recordings import accelerometer, both, delayed, gyroscope, some, warming, with_imu
from .faults import Fault, FaultyRecording

_SOUND = Scenario(intervals=36, t_init_s=30.0, hold_s=(3.0, 4.0), gyroscope_scale=(0.98, 1.02))
_EVEN = replace(_SOUND, hold_s=(4.0, 4.0), motion_s=(2.0, 2.0))
_TOUCHED, _TOUCH_RAD = 7, 0.006


def _touched(t_s: Floats, values: Floats) -> Floats:
    """Tilt the sensor slowly to and fro in the middle of static interval 7, as a hand that leans on the table does."""
    start = _EVEN.t_init_s + (_TOUCHED - 1) * 2.0 + (_TOUCHED - 2) * 4.0 + 1.0
    tau = np.clip((t_s - start) / 2.0, 0, 1)
    tilt = _TOUCH_RAD * np.sin(np.pi * tau) ** 2
    values[:, :2] += STANDARD_GRAVITY_M_S2 * tilt[:, None]
    return values


def _lossy(samples: TriadSamples, rng: np.random.Generator) -> TriadSamples:
    """Lose samples for a fifth of a second, time and again, as a radio link does."""
    kept = np.ones(len(samples), dtype=bool)
    width = round(0.2 * samples.rate_hz)
    for start in rng.integers(0, len(samples) - width, len(samples) // (20 * width)):
        kept[start : start + width] = False
    return some(samples, kept)


def _doubled(samples: TriadSamples, _rng: np.random.Generator) -> TriadSamples:
    """Write each sample twice, as a logger that asks a slow sensor does."""
    t_ns = np.empty(2 * len(samples), dtype=np.int64)
    t_ns[::2], t_ns[1::2] = samples.t_ns, samples.t_ns + round(0.5e9 / samples.rate_hz)
    return replace(samples, t_ns=t_ns, values=np.repeat(samples.values, 2, axis=0))


def _stamped_on_arrival(samples: TriadSamples, rng: np.random.Generator) -> TriadSamples:
    """Timestamp samples when they arrive, held up now and then by a busy computer."""
    period = 1 / samples.rate_hz
    late = rng.exponential(0.8 * period, len(samples)) * 1e9
    return replace(samples, t_ns=np.maximum.accumulate(samples.t_ns + late.astype(np.int64)))


def _counted(samples: TriadSamples, _rng: np.random.Generator) -> TriadSamples:
    """Make timestamps by the number of the sample and half of the true rate."""
    return replace(samples, t_ns=samples.t_ns[0] + 2 * (samples.t_ns - samples.t_ns[0]))


def _apart(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    imu = case.recording.imus["imu0"]
    return with_imu(case, replace(imu, gyroscope=delayed(imu.gyroscope, 1.2)))


def _stuck(samples: TriadSamples, _rng: np.random.Generator) -> TriadSamples:
    """Repeat one sample for two seconds while the sensor is turned, as a link that hangs does."""
    values = np.array(samples.values)
    first = round(0.6 * len(values))
    values[first : first + round(2 * samples.rate_hz)] = values[first]
    return replace(samples, values=values)


def _without_gravity(t_s: Floats, values: Floats) -> Floats:
    """Take gravity away, as phones do for "linear acceleration"."""
    width = 201
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(np.pad(v, width // 2, mode="edge"), kernel, mode="valid") for v in values.T], axis=1)
    return values - smooth


def _shaken(t_s: Floats, values: Floats) -> Floats:
    """Shake the last third, as the motors of a drone do."""
    noise = np.random.default_rng(0).normal(0, 0.2, values.shape)
    return values + np.where(t_s > 0.65 * t_s[-1], 1.0, 0.0)[:, None] * noise


IMU_FAULTS = (
    Fault(
        name="accelerometer-in-g",
        title="The accelerometer is in g, and m/s² was stated",
        symptom="At rest it reads 1 instead of 9.81.",
        codes=("gravity-magnitude", "unit"),
        says=(r"\bin g\b|like g\b",),
        scenario=_SOUND,
        spoil=accelerometer(lambda _, values: values / STANDARD_GRAVITY_M_S2),
    ),
    Fault(
        name="gyroscope-in-deg-s",
        title="The gyroscope is in deg/s, and rad/s was stated",
        symptom="The gyroscope's scale comes out near 57.",
        codes=("unit",),
        says=(r"deg/s",),
        scenario=_SOUND,
        spoil=gyroscope(lambda _, values: np.degrees(values)),
    ),
    Fault(
        name="gyroscope-flipped",
        title="The sign of one gyroscope axis is wrong",
        symptom="The gyroscope's axes are left-handed, and a filter turns the wrong way about one axis.",
        codes=("axes-differ",),
        says=(r"gyroscope y",),
        scenario=_SOUND,
        spoil=gyroscope(lambda _, values: values * np.array([1.0, -1.0, 1.0])),
    ),
    Fault(
        name="accelerometer-swapped",
        title="Two columns of the accelerometer are exchanged",
        symptom="Gyroscope x measures about the accelerometer's y.",
        codes=("axes-differ",),
        says=(r"columns",),
        scenario=_SOUND,
        spoil=accelerometer(lambda _, values: values[:, [1, 0, 2]]),
    ),
    Fault(
        name="gyroscope-clips",
        title="The gyroscope clips at 250 deg/s",
        symptom="Its curve has flat tops during fast turns.",
        codes=("saturation",),
        says=(r"250(\.\d)? deg/s",),
        scenario=replace(_SOUND, motion_s=(0.7, 1.2), gyroscope_range=radians(250.0)),
    ),
    Fault(
        name="samples-lost",
        title="A radio link loses 5 % of the samples",
        symptom="Rotations do not end where gravity says.",
        codes=("gaps",),
        says=(r"samples lost",),
        scenario=_SOUND,
        spoil=both(_lossy),
    ),
    Fault(
        name="samples-doubled",
        title="The logger writes every sample twice",
        symptom="Sigmas come out too small.",
        codes=("samples-repeated",),
        scenario=_SOUND,
        spoil=both(_doubled),
    ),
    Fault(
        name="samples-stuck",
        title="The link hung for two seconds during a turn",
        symptom="A perfect rest in a place where there was none.",
        codes=("samples-stuck",),
        says=(r"times in a row",),
        scenario=_SOUND,
        spoil=both(_stuck),
    ),
    Fault(
        name="stamped-on-arrival",
        title="Samples are stamped when they arrive",
        symptom="Steps between timestamps scatter by most of a period.",
        codes=("jitter",),
        scenario=_SOUND,
        spoil=both(_stamped_on_arrival),
    ),
    Fault(
        name="rate-misstated",
        title="Timestamps were made by half of the true sample rate",
        symptom="Everything is slow; the gyroscope's scale comes out near 0.5.",
        codes=("unit", "rate-wrong"),
        says=(r"rate",),
        scenario=_SOUND,
        spoil=both(_counted),
    ),
    Fault(
        name="triads-apart",
        title="The gyroscope's timestamps are 1.2 s later than the accelerometer's",
        symptom="Rotations begin before and end after the accelerometer's motions; they fit badly.",
        codes=("triads-apart",),
        says=(r"1\.[12]\d* s",),
        scenario=_SOUND,
        spoil=_apart,
    ),
    Fault(
        name="interval-touched",
        title="Somebody leaned on the table during static interval 7",
        symptom="One interval shows another gravity than the rest.",
        codes=("intervals-left-out", "interval-touched"),
        says=(r"[Ii]nterval 7\b",),
        scenario=_EVEN,
        spoil=accelerometer(_touched),
        remedied=True,
    ),
    Fault(
        name="few-attitudes",
        title="Seven attitudes only",
        symptom="Sigmas are ten times the usual ones, or there is no result.",
        codes=("few-attitudes", "attitudes", "not-observable"),
        says=(r"attitudes",),
        scenario=replace(_SOUND, intervals=7),
    ),
    Fault(
        name="tilted-about-one-axis",
        title="The sensor was tilted about one axis only",
        symptom="One accelerometer axis never showed gravity.",
        codes=("not-observable", "attitudes", "attitudes-alike"),
        says=(r"attitudes|axis|up",),
        scenario=replace(_SOUND, attitudes="one-axis"),
    ),
    Fault(
        name="gyroscope-warms-up",
        title="The gyroscope's bias drifts by 0.6 deg/s while it warms up",
        symptom="Bias of the start and of the end differ.",
        codes=("warm-up", "gyroscope-drift"),
        says=(r"warm",),
        scenario=_SOUND,
        spoil=gyroscope(lambda t_s, values: values + radians(0.6) * warming(t_s, 60.0) * np.array([1.0, -0.5, 0.3])),
        remedied=True,
    ),
    Fault(
        name="accelerometer-warms-up",
        title="The accelerometer's bias drifts by 20 mg with temperature",
        symptom="Left-out intervals show gravity to 5 mg only.",
        codes=("warm-up", "accelerometer-drift"),
        says=(r"warm|temperature",),
        scenario=_SOUND,
        remedied=True,
        spoil=accelerometer(lambda t_s, values: values + 0.2 * warming(t_s, 90.0) * np.array([0.4, 1.0, -0.7])),
    ),
    Fault(
        name="range-set-back",
        title="A brown-out set the accelerometer's full scale to half of what it was",
        symptom="Gravity reads twice as much from then on.",
        codes=("range-changed",),
        says=(r"full scale",),
        scenario=_SOUND,
        spoil=accelerometer(lambda t_s, values: values * np.where(t_s > 0.6 * t_s[-1], 2.0, 1.0)[:, None]),
    ),
    Fault(
        name="motors-on",
        title="The motors ran during the last third of the rests",
        symptom="A third of the rests is missing.",
        codes=("intervals-left-out",),
        says=(r"shakes more",),
        scenario=_SOUND,
        spoil=accelerometer(_shaken),
    ),
    Fault(
        name="gravity-removed",
        title="The phone took gravity away before it wrote the file",
        symptom="At rest the accelerometer reads zero.",
        codes=("gravity-magnitude",),
        says=(r"gravity was removed",),
        scenario=_SOUND,
        spoil=accelerometer(_without_gravity),
    ),
    Fault(
        name="gyroscope-off",
        title="The gyroscope is switched off",
        symptom="It shows nothing but noise.",
        codes=("gyroscope-silent",),
        scenario=_SOUND,
        spoil=gyroscope(
            lambda _, values: 0.02 + values.std() * 1e-3 * np.random.default_rng(0).normal(size=values.shape)
        ),
    ),
)
"""The catalogue's part; the order is that of its gallery: units and axes, samples and timestamps, motion, sensor."""
