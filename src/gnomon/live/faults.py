"""What is wrong with the samples of the last seconds, named while it can still be mended."""

from collections.abc import Iterator

import numpy as np

from ..detect.samples.faults import saturated_samples
from ..frozen import value_class
from ..recording import ImuSamples, TriadSamples, smallest_steps
from ..units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2

_SLOW_HZ = 80.0
_FEWEST, _WHOLE = 20, 0.05
_GAP, _IN_BURSTS = 3.5, 0.1  # periods; share of the steps that are as long
_REPEATED = 0.3
_CLIPPED = 3
_FAST_RAD = 0.12  # between two samples; a rate of 6 rad/s at 50 Hz
_COARSE_M_S2, _COARSE_RAD_S = 0.03, 1.4e-3  # Chromium: 0.1, 0.0017; 16 bits of 16 g and 2000 deg/s: 0.005, 0.001
_PLAUSIBLE, _POSSIBLE = (0.7, 1.3), (0.5, 2.0)  # gravity at rest, and in motion


@value_class(eq=True)
class Fault:
    """Something that spoils the recording, and a way on.

    Attributes
    ----------
    code : names it, such as "saturated"
    text : what is wrong, and what to do
    """

    code: str
    text: str


def faults_of(recent: ImuSamples, rate_unit: float | None, *, still: bool) -> Iterator[Fault]:
    """Yield what is wrong with samples.

    Parameters
    ----------
    recent : of the last seconds
    rate_unit : of the gyroscope, about [rad/s], where it is known
    still : whether the sensor rests now
    """
    accelerometer, gyroscope = recent.accelerometer, recent.gyroscope
    if not len(gyroscope):
        yield Fault(code="no-gyroscope", text="No gyroscope arrives: let the device send it too.")
    triads = [("accelerometer", accelerometer), ("gyroscope", gyroscope)]
    for name, samples in triads:
        if len(samples) >= _FEWEST:
            yield from _of_stamps(samples, name)
            yield from _of_values(samples, name)
    if len(accelerometer) < _FEWEST:
        return
    force_unit = ACCELEROMETER_UNITS_M_S2[accelerometer.unit]
    yield from _coarse(accelerometer, force_unit, _COARSE_M_S2, "accelerometer")
    if len(gyroscope) >= _FEWEST:
        yield from _coarse(gyroscope, rate_unit, _COARSE_RAD_S, "gyroscope")
        largest = np.quantile(np.abs(gyroscope.values).max(axis=1), 0.98)
        fastest = (rate_unit or 0.0) * float(largest)
        if fastest > _FAST_RAD * gyroscope.rate_hz:
            yield Fault(code="too-fast", text=f"Too fast ({np.degrees(fastest):.0f} deg/s): turn it more slowly.")
    if force_unit is not None:
        sizes = np.linalg.norm(accelerometer.values, axis=1)
        found = float(np.median(sizes)) * force_unit / STANDARD_GRAVITY_M_S2
        least, most = _PLAUSIBLE if still else _POSSIBLE
        if found < least:
            yield Fault(
                code="no-gravity",
                text=f"The accelerometer shows {found:.2f} g: gravity was removed, or the unit is another one. "
                "Let the device send the acceleration with gravity.",
            )
        elif found > most:
            text = f"The accelerometer shows {found:.2f} g: its unit is another one. State it with --units."
            yield Fault(code="not-gravity", text=text)


def _of_stamps(samples: TriadSamples, name: str) -> Iterator[Fault]:
    steps = np.diff(samples.t_ns)
    period = float(np.median(steps))
    if (steps < 0).any():
        text = "The device's clock went back: it was restarted. Stop, and begin a new recording."
        yield Fault(code="clock-back", text=text)
        return
    if period > 0 and name == "accelerometer":
        late = steps > _GAP * period
        lost = int(np.rint(steps[late] / period - 1).sum())
        if late.mean() > _IN_BURSTS:
            text = "Timestamps come in bursts: they tell when samples arrived. Let the device timestamp each itself."
            yield Fault(code="bursts", text=text)
        elif lost:
            cure = "use a shorter cable, a higher baud rate, or a lower sample rate."
            yield Fault(code="dropped", text=f"{lost} samples were lost in the last seconds: {cure}")
        if 1e9 / period < _SLOW_HZ:
            text = f"Only {1e9 / period:.0f} samples a second arrive: let the device send 100 or more."
            yield Fault(code="throttled", text=text)


def _of_values(samples: TriadSamples, name: str) -> Iterator[Fault]:
    if float((np.diff(samples.values, axis=0) == 0).all(axis=1).mean()) > _REPEATED:
        code, text = "repeated", "repeats its readings: it is slower than it is read."
        if not np.ptp(samples.values, axis=0).any():
            code, text = "silent", "never changes: is it switched on?"
            if samples.values[-1].any():
                code, text = "rounded", "reads one number all the time: it is rounded, or it has stopped."
        yield Fault(code=code, text=f"The {name} {text}")
        return
    if np.count_nonzero(saturated_samples(samples)) >= _CLIPPED:
        why = "turn it more slowly" if name == "gyroscope" else "do not hit or shake it"
        yield Fault(code="saturated", text=f"The {name} is at the end of its range: {why}.")


def _coarse(samples: TriadSamples, unit: float | None, limit: float, name: str) -> Iterator[Fault]:
    steps = np.nan_to_num(smallest_steps(samples.values))
    step = steps.max() * (unit or 0.0)
    if step <= limit:
        return
    axis = int(np.argmax(steps))
    counts = np.diff(samples.values[:, axis]) / steps[axis]
    if np.abs(counts - np.rint(counts)).max() < _WHOLE:  # a fast motion makes large steps, too, but no whole ones
        text = f"The {name} arrives rounded to {step:.2g} {'m/s^2' if name[0] == 'a' else 'rad/s'}: let the device send"
        yield Fault(code="rounded", text=f"{text} all digits. Web browsers round; an app of its own does not.")
