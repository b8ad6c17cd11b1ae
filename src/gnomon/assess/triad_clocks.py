"""Whether accelerometer and gyroscope move at the same time: by when they are stirred, whatever they measure."""

import numpy as np

from ..findings import Finding, make_finding
from ..gaps import close_gaps
from ..recording import Floats, ImuSamples

_GRID_S, _WIDTH_S = 0.02, 0.2
_LONGEST_S = 10.0
_APART_S, _FAR_S = 0.1, 0.3
_ALIKE, _GAINED = 0.5, 0.1
_LONG_S = 20.0
_FEWEST_IN_WIDTH = 2  # samples, about: fewer show nothing stirred, and stamps far too slow would need an endless grid
_LONGEST_GAP_NS = 1_000_000_000  # nothing is stirred in it


def check_triad_clocks(imu: ImuSamples, name: str) -> list[Finding]:
    """Return a finding where both triads are stirred alike, but one of them later (code triads-apart).

    Parameters
    ----------
    imu : samples of both, stamps not falling
    name : of the IMU
    """
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    first = max(int(accelerometer.t_ns[0]), int(gyroscope.t_ns[0]))
    last = min(int(accelerometer.t_ns[-1]), int(gyroscope.t_ns[-1]))
    slower_hz = min(accelerometer.rate_hz, gyroscope.rate_hz)
    if (last - first) * 1e-9 < _LONG_S or not slower_hz * _WIDTH_S >= _FEWEST_IN_WIDTH:
        return []
    both = [np.clip(samples.t_ns, first, last) for samples in (accelerometer, gyroscope)]
    stamps = close_gaps(both, _LONGEST_GAP_NS)
    grid = np.arange(0, (int(max(t_ns[-1] for t_ns in stamps)) - first) * 1e-9, _GRID_S)
    pushed, turned = (
        _stirred(samples.values, np.asarray((t_ns - first) * 1e-9, dtype=np.float64), grid)
        for samples, t_ns in zip((accelerometer, gyroscope), stamps, strict=True)
    )
    lag, best, now = _lag(pushed, turned)
    if abs(lag) < _APART_S or best < _ALIKE or best - now < _GAINED:
        return []
    later, earlier = ("gyroscope", "accelerometer") if lag > 0 else ("accelerometer", "gyroscope")
    return [
        make_finding(
            "triads-apart/imu",
            severity="problem" if abs(lag) > _FAR_S else "warning",
            name=name,
            later=later,
            lag=abs(lag),
            earlier=earlier,
        )
    ]


def _stirred(values: Floats, t_s: Floats, grid: Floats) -> Floats:
    """Return how much a sensor's readings vary about instants, as a logarithm without mean and of variance one."""
    first = np.searchsorted(t_s, grid - _WIDTH_S / 2)
    last = np.maximum(np.searchsorted(t_s, grid + _WIDTH_S / 2), first + 1)
    last = np.minimum(last, len(t_s))
    first = np.minimum(first, last - 1)
    values = values - values.mean(axis=0)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum((values**2).sum(axis=1))])
    count = (last - first).astype(np.float64)
    mean = (sums[last] - sums[first]) / count[:, None]
    variance = np.maximum((squares[last] - squares[first]) / count - (mean**2).sum(axis=1), 0.0)
    level = np.log(variance + np.quantile(variance, 0.2) + 1e-30)
    level = level - level.mean()
    return level / max(float(level.std()), 1e-12)


def _lag(pushed: Floats, turned: Floats) -> tuple[float, float, float]:
    """Return by how much the second comes later [s], the correlation there, and without a lag."""
    count = len(pushed)
    size = 1 << int(np.ceil(np.log2(2 * count)))
    cross = np.fft.irfft(np.conj(np.fft.rfft(pushed, size)) * np.fft.rfft(turned, size), size)
    most = min(round(_LONGEST_S / _GRID_S), count // 2)
    lags = np.arange(-most, most + 1)
    score = cross[lags] / (count - np.abs(lags))
    best = int(np.argmax(score))
    return float(lags[best]) * _GRID_S, float(score[best]), float(score[most])
