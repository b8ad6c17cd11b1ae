"""Vibration: a narrow line in the spectrum of a sensor, far above what surrounds it, faster than a hand moves."""

import numpy as np

from ..findings import Finding, make_finding
from ..recording import Floats, TriadSamples
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_SLOWEST_HZ = 30.0  # hands tremble at up to 12 Hz, and shake at up to 20
_PART_S = 2.0
_AROUND = 12  # bins on each side in which a line is compared
_ABOVE = 30.0  # times the power of what surrounds it
_LOUD = 3.0  # times the white noise, rms
_LEAST_M_S2, _LEAST_RAD_S = 0.1, 5e-3


def check_vibration(accelerometer: TriadSamples, gyroscope: TriadSamples, name: str) -> list[Finding]:
    """Return a finding on vibration (code vibration), where there is much of it.

    Parameters
    ----------
    accelerometer, gyroscope : of one IMU, stamps not falling
    name : of the IMU
    """
    found = (
        _line(accelerometer, ACCELEROMETER_UNITS_M_S2, _LEAST_M_S2),
        _line(gyroscope, GYROSCOPE_UNITS_RAD_S, _LEAST_RAD_S),
    )
    known = [line for line in found if line is not None]
    if not known:
        return []
    hz = known[0][0]
    sizes = [
        f"{line[1]:.2g} {unit} (rms) in the {triad}"
        for line, unit, triad in zip(found, ("m/s^2", "rad/s"), ("accelerometer", "gyroscope"), strict=True)
        if line is not None
    ]
    return [make_finding("vibration", name=name, hz=hz, sizes=" and ".join(sizes))]


def _line(samples: TriadSamples, units: dict[str, float | None], least: float) -> tuple[float, float] | None:
    """Return frequency [Hz] and rms [SI] of the strongest line over all axes; None where there is none."""
    rate, factor = samples.rate_hz, units.get(samples.unit)
    if not (np.isfinite(rate) and rate > 2.5 * _SLOWEST_HZ) or factor is None:
        return None
    spectrum = _spectrum(samples.values * factor, rate)
    if spectrum is None:
        return None
    hz, density = spectrum  # one-sided, summed over the axes
    fast = np.flatnonzero((hz > _SLOWEST_HZ) & (hz < 0.49 * rate))
    if len(fast) < 3 * _AROUND:
        return None
    top = int(fast[np.argmax(density[fast])])
    around = density[np.r_[max(top - _AROUND, fast[0]) : top - 2, top + 3 : min(top + _AROUND, fast[-1])]]
    power = float(density[max(top - 2, 0) : top + 3].sum() * (hz[1] - hz[0]))
    usual = float(np.median(density[fast]))
    white = np.sqrt(usual * rate / 2)
    loud = np.sqrt(power) > max(least, _LOUD * white)
    if not loud or density[top] < _ABOVE * float(np.median(around)):
        return None
    return float(hz[top]), float(np.sqrt(power))


def _spectrum(values: Floats, rate_hz: float) -> tuple[Floats, Floats] | None:
    """Return frequencies and the power density summed over the axes, by Welch's method: medians over parts."""
    size = round(_PART_S * rate_hz)
    parts = len(values) // size
    if parts < 4 or size < 64:
        return None
    cut = values[: parts * size].reshape(parts, size, 3)
    window = np.hanning(size)[:, None]
    power = np.abs(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    density = 2 * np.median(power, axis=0).sum(axis=1) / (rate_hz * float((window**2).sum()))
    return np.asarray(np.fft.rfftfreq(size, 1 / rate_hz), dtype=np.float64), np.asarray(density, dtype=np.float64)
