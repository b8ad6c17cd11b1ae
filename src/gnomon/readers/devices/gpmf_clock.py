"""When the samples of a GPMF stream were taken: an even clock, fitted to what is known of the beginnings of payloads.

The camera stores samples in payloads of about a second, whose limits jitter by some samples, while the sensor samples
evenly, at a rate of its own that drifts slowly. So timestamps are not spread payload by payload: one clock is fitted to
all beginnings, with a rate that may change from minute to minute.
"""

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Floats, Integers
from .gpmf_streams import Device, PayloadBlock

NOMINAL_PAYLOAD_S = 1.001  # of 30, 60, ... frames at 29.97 frames/s
_KNOT_S = 60.0
_OUTLYING = 5.0
_FEW = 8


@value_class
class PayloadTimes:
    """When the payloads begin, as the container says; none of a raw stream.

    Attributes
    ----------
    start_s : (k,) [s]
    duration_s : (k,) [s]
    """

    start_s: Floats
    duration_s: Floats


@value_class
class Clock:
    """Timestamps of all samples of a stream.

    Attributes
    ----------
    t_ns : (n,) [ns]
    rate_hz : mean rate
    stray_s : by which the farthest beginning of a payload is off that clock [s]
    stamped : whether they come from the camera's timestamps; else from the times of payloads
    lost : samples between payloads that the counts say are missing
    """

    t_ns: Integers
    rate_hz: float
    stray_s: float
    stamped: bool
    lost: int


def sample_clock(blocks: tuple[PayloadBlock, ...], times: PayloadTimes | None, origin_s: float) -> Clock:
    """Fit the clock of a stream.

    Parameters
    ----------
    blocks : its samples; at least one block
    times : of the payloads, or None of a raw stream
    origin_s : where the time begins in the camera's clock of timestamps [s]

    Raises
    ------
    RecordingError
        If the timestamps do not rise.
    """
    key = blocks[0].key
    counts = np.array([len(block.values) for block in blocks])
    first, lost = _first_samples(blocks, counts)
    stamps = [block.stamp_us for block in blocks]
    stamped = None not in stamps and bool((np.diff(np.array(stamps, dtype=np.float64)) > 0).all())
    if stamped:
        at = np.array(stamps, dtype=np.float64) * 1e-6 - origin_s
        index, at = _with_end(first, at, counts, _last_s(blocks, times) if len(blocks) == 1 else None)
    elif times is not None:
        at = np.array([times.start_s[block.payload] for block in blocks])
        index, at = _with_end(first, at, counts, _last_s(blocks, times))
    else:
        at = np.array([block.payload * NOMINAL_PAYLOAD_S for block in blocks])
        index, at = _with_end(first, at, counts, NOMINAL_PAYLOAD_S if len(blocks) < 3 else None)
    samples = np.concatenate([begin + np.arange(count) for begin, count in zip(first, counts, strict=True)])
    t_s, stray_s = _fitted(index.astype(np.float64), at, samples.astype(np.float64))
    span = float(t_s[-1] - t_s[0])
    if not (np.isfinite(t_s).all() and np.abs(t_s).max() < 9e9 and (np.diff(t_s) > 0).all()):
        raise RecordingError(f"{key}: the times of its payloads do not rise.")
    return Clock(
        t_ns=np.rint(t_s * 1e9).astype(np.int64),
        rate_hz=float(samples[-1] - samples[0]) / span if span > 0 else float("nan"),
        stray_s=stray_s,
        stamped=stamped,
        lost=lost,
    )


def _first_samples(blocks: tuple[PayloadBlock, ...], counts: Integers) -> tuple[Integers, int]:
    """Return the number of the first sample of each block, and how many samples are missing between blocks.

    The camera's count is taken where it fits: blocks do not overlap in it.
    """
    running = np.cumsum(counts) - counts
    totals = [block.total for block in blocks]
    if None in totals:
        return running, 0
    counted = np.array(totals, dtype=np.int64) - counts
    missing = np.diff(counted) - counts[:-1]
    if (missing < 0).any():
        return running, 0
    return counted - counted[0], int(missing.sum())


def _last_s(blocks: tuple[PayloadBlock, ...], times: PayloadTimes | None) -> float:
    """Return how long the last payload lasts [s]."""
    duration = NOMINAL_PAYLOAD_S if times is None else float(times.duration_s[blocks[-1].payload])
    return duration if duration > 0 else NOMINAL_PAYLOAD_S


def _with_end(first: Integers, at: Floats, counts: Integers, last_s: float | None) -> tuple[Integers, Floats]:
    """Return the beginnings of payloads, and the end of the last one where that is known."""
    if last_s is None:
        return first, at
    return np.append(first, first[-1] + counts[-1]), np.append(at, at[-1] + last_s)


def _fitted(index: Floats, at: Floats, samples: Floats) -> tuple[Floats, float]:
    """Return the times of samples, and how far the farthest beginning strays, both in seconds.

    A line, or for longer recordings lines that meet at knots a minute apart; single payloads that are off are left out.
    """
    knots = np.linspace(index[0], index[-1], max(2, 1 + min(round(np.ptp(at) / _KNOT_S), len(index) // _FEW)))
    kept = np.ones(len(index), bool)
    coefficients = np.zeros(len(knots))
    for _ in range(3):
        coefficients = np.linalg.lstsq(_hats(index[kept], knots), at[kept], rcond=None)[0]
        off = np.abs(at - _hats(index, knots) @ coefficients)
        limit = _OUTLYING * 1.5 * float(np.median(off)) + 1e-6
        if (off[kept] <= limit).all() or int((off <= limit).sum()) < max(len(knots) + 1, len(index) // 2):
            break
        kept = off <= limit
    times = _hats(samples, knots) @ coefficients
    return times, float(np.abs(at - _hats(index, knots) @ coefficients)[kept].max())


def _hats(index: Floats, knots: Floats) -> Floats:
    """Return the weights of the values at knots in a line from knot to knot, (n, knots); beyond them it goes on."""
    step = knots[1] - knots[0]
    left = np.clip(np.floor((index - knots[0]) / step), 0, len(knots) - 2).astype(np.int64)
    part = (index - knots[left]) / step
    weights = np.zeros((len(index), len(knots)))
    rows = np.arange(len(index))
    weights[rows, left], weights[rows, left + 1] = 1 - part, part
    return weights


_STABILISED_RAD = np.radians(0.2)


def notes_on_clock(clock: Clock, blocks: tuple[PayloadBlock, ...], sensor: str, name: str, *, timed: bool) -> list[str]:
    """Say where the timestamps of a triad come from, how well they are known, and how warm the sensor was.

    Parameters
    ----------
    clock, blocks : of the triad
    sensor, name : the triad and the file, for the sentences
    timed : whether the container states the times of payloads
    """
    count = len(blocks)
    stray = f" (largest deviation {1e3 * clock.stray_s:.2g} ms)" if count > 2 else ""
    if clock.stamped and count > 1:
        how = f"an even clock through the camera's timestamps of {count} payloads{stray}"
    elif timed:
        how = f"spread evenly over {count} payloads of the video, whose samples have no timestamps{stray}"
    else:
        how = f"as if each payload took {NOMINAL_PAYLOAD_S:g} s, which nothing states: off by 1 % or so{stray}"
    notes = [f"{name}: {sensor} at {clock.rate_hz:.5g} Hz, {how}."]
    if clock.lost:
        notes.append(f"{name}: {clock.lost} samples of the {sensor} are missing between payloads, as its count says.")
    degrees = np.array([block.temperature for block in blocks])
    if sensor == "gyroscope" and np.isfinite(degrees).any():
        low, high = float(np.nanmin(degrees)), float(np.nanmax(degrees))
        notes.append(f"{name}: its sensor was at {low:.1f} to {high:.1f} degrees Celsius.")
    return notes


def notes_on_video(device: Device, name: str, *, video: bool) -> list[str]:
    """Say what matters for the images: electronic stabilisation, and the time to read out the sensor."""
    notes: list[str] = []
    turned = [block.values for block in device.of("IORI") if block.values.shape[1] == 4]
    if video and turned:  # quaternions of the image to the body, the real part first
        vector = np.linalg.norm(np.concatenate(turned)[:, 1:], axis=1)
        angle = float(2 * np.arcsin(np.clip(vector.max(), 0, 1)))
        if angle > _STABILISED_RAD:
            notes.append(
                f"{name}: the images were turned by up to {np.degrees(angle):.1f} degrees against the camera (IORI): "
                "stabilisation (HyperSmooth) was on. Images like that fit no IMU; switch it off to calibrate a camera."
            )
    read_out = device.of("SROT")
    if video and read_out:
        ms = float(np.median(np.concatenate([block.values.ravel() for block in read_out])))
        notes.append(f"{name}: rolling shutter; the camera states {ms:.3g} ms to read out the sensor (SROT).")
    return notes
