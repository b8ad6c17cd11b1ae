"""Algorithm 1 of Tedaldi: the threshold with the smallest residual, and the rotations between its rests."""

import numpy as np

from ...assess.imu.imu_tables import root_mean_square
from ...detect.samples.stillness import variance_magnitude_squared, window_samples, window_variances
from ...errors import DetectionError, InitialisationError
from ...estimate.multiposition.measurements import UPPER, MagnitudeFit, MotionSegments, cut_segments, segments_between
from ...estimate.multiposition.problem import gyroscope_intervals
from ...estimate.multiposition.tedaldi import (
    SAMPLES_PER_INTERVAL,
    GyroscopeFit,
    TedaldiRules,
    fit_gyroscope,
    fit_published_accelerometer,
    leave_group_out,
    select_samples,
    static_directions,
)
from ...frozen import value_class
from ...recording import Floats, TriadSamples
from ...results.result import StaticIntervals, interval_means, runs_below
from ..steps.preparation import PreparedImu

_FEWEST_AT_FIRST = 10  # samples that tell the noise


@value_class
class Search:
    """M_inf of Algorithm 1: the threshold with the smallest residual, and all that were tried.

    Attributes
    ----------
    multiplier : the threshold, a multiple of the noise of T_init
    intervals : k static intervals that it finds
    samples : (k n, 3) of the accelerometer, n of each interval, in its unit
    fit : to these
    candidates : (thresholds, 4) multiplier, intervals, held-out residual (rms) [m/s^2] and cost; nan where too few
    statistic : (samples,) of the detector, relative to T_init
    """

    multiplier: float
    intervals: StaticIntervals
    samples: Floats
    fit: MagnitudeFit
    candidates: Floats
    statistic: Floats


@value_class
class Turned:
    """The gyroscope's half of Algorithm 1, of k - 1 rotations between k static intervals.

    Attributes
    ----------
    bias, bias_sigma : (3,) of the gyroscope, in its unit
    segments : samples of the rotations
    u : (k, 3) direction of the specific force at rest, over whole intervals
    start_s, stop_s : (k - 1,) of the rotations
    fit : of the gyroscope
    at_rest : static intervals, by the gyroscope's samples
    """

    bias: Floats
    bias_sigma: Floats
    segments: MotionSegments
    u: Floats
    start_s: Floats
    stop_s: Floats
    fit: GyroscopeFit
    at_rest: StaticIntervals


def search_threshold(
    prepared: PreparedImu, rules: TedaldiRules, gravity_m_s2: float, t_init_s: float, window_s: float
) -> Search:
    """Return what the threshold with the smallest residual gives.

    Raises
    ------
    DetectionError
        If T_init is too short or not at rest, or no threshold finds enough static intervals.
    """
    samples = prepared.accelerometer
    values, relative = samples.values, _relative_variance(samples, rules, t_init_s, window_s)
    rows: list[tuple[float, ...]] = []
    best: tuple[float, StaticIntervals, Floats, MagnitudeFit] | None = None
    for multiplier in rules.multipliers:
        threshold = multiplier**2 if rules.statistic == "magnitude" else multiplier
        intervals = runs_below(relative, float(threshold), SAMPLES_PER_INTERVAL)
        rows.append((multiplier, len(intervals), np.nan, np.nan))
        if len(intervals) < rules.fewest_intervals:
            continue
        chosen = select_samples(values, intervals, rules, samples.rate_hz)
        try:
            fit = fit_published_accelerometer(chosen, rules, gravity_m_s2)
        except InitialisationError:
            continue
        rows[-1] = (
            multiplier,
            len(intervals),
            root_mean_square(held_out_forces(fit, chosen, len(intervals), gravity_m_s2)),
            fit.cost,
        )
        if best is None or fit.cost < best[3].cost:
            best = (multiplier, intervals, chosen, fit)
    if best is None:
        most = max(int(row[1]) for row in rows)
        raise DetectionError(
            f"no threshold finds the {rules.fewest_intervals} static intervals of a second that this preset needs, in "
            f"attitudes that differ; the most were {most}. Record more attitudes, or use the default preset."
        )
    return Search(
        multiplier=best[0],
        intervals=best[1],
        samples=best[2],
        fit=best[3],
        candidates=np.array(rows, dtype=np.float64),
        statistic=relative,
    )


def _relative_variance(samples: TriadSamples, rules: TedaldiRules, t_init_s: float, window_s: float) -> Floats:
    """Return the detector's statistic of every sample over that of T_init, (n,); infinite at the ends."""
    values, t_s = samples.values, (samples.t_ns - samples.t_ns[0]) * 1e-9
    window = window_samples(samples, window_s)
    first = _t_init_samples(t_s, samples.rate_hz, rules, t_init_s)
    if len(values) < max(first, 2 * window):
        raise DetectionError(
            f"the recording of {samples.duration_s:.1f} s is shorter than T_init = {t_init_s:g} s of this preset. "
            "State a shorter --t-init-s, or use the default preset, which needs none."
        )
    half = window // 2
    if first < max(_FEWEST_AT_FIRST, half + 1):
        raise DetectionError(
            f"only {first} samples lie in T_init, the first {t_init_s:g} s, by which this preset finds the noise; it "
            f"needs {max(_FEWEST_AT_FIRST, half + 1)}, more than half a window. State a longer --t-init-s, or use the "
            "default preset, which needs none."
        )
    level = float(np.sum(np.var(values[:first], axis=0, ddof=1) ** 2))
    if not level > 0:
        raise DetectionError(
            f"the accelerometer reads one number throughout the first {t_init_s:g} s: its converter is coarser than "
            "its noise, and this preset's threshold is a multiple of the noise. Use the default preset."
        )
    statistic = variance_magnitude_squared(window_variances(values, window))
    statistic[:half], statistic[len(statistic) - half :] = np.inf, np.inf
    if rules.leading_sample_static:
        statistic[half - 1] = 0.0
    relative = statistic / level
    if np.median(relative[half:first]) > 10 or level > 100 * np.quantile(statistic[half:-half:window], 0.1):
        raise DetectionError(
            f"the first {t_init_s:g} s are not at rest, as this preset needs (T_init). "
            "State a shorter --t-init-s, or use the default preset, which needs none."
        )
    return relative


def _t_init_samples(t_s: Floats, rate_hz: float, rules: TedaldiRules, t_init_s: float) -> int:
    """Return the number of samples of T_init, by count or by timestamps as the published form does."""
    if rules.uniform_dt:
        return round(t_init_s * rate_hz)
    return int(np.searchsorted(t_s, t_init_s, "right")) + rules.t_init_extra


def fit_rotations(prepared: PreparedImu, rules: TedaldiRules, search: Search, t_init_s: float) -> Turned:
    """Return the gyroscope that takes each static direction to the next, Eq. (3.8)."""
    accelerometer, gyroscope = prepared.accelerometer, prepared.gyroscope
    origin = min(accelerometer.t_ns[0], gyroscope.t_ns[0])
    t_accel, t_gyro = (accelerometer.t_ns - origin) * 1e-9, (gyroscope.t_ns - origin) * 1e-9
    still = search.intervals
    start_s, stop_s = t_accel[still.stop[:-1] - 1], t_accel[still.start[1:]]
    first, lengths = segments_between(t_gyro, start_s, stop_s)
    if rules.stop_early:
        lengths = np.maximum(lengths - 1, 2)
    if rules.gyroscope_bias == "first interval":
        within = slice(
            int(np.searchsorted(t_gyro, t_accel[still.start[0]])),
            int(np.searchsorted(t_gyro, t_accel[still.stop[0] - 1], "right")),
        )
    else:
        within = slice(0, _t_init_samples(t_gyro - t_gyro[0], gyroscope.rate_hz, rules, t_init_s))
    bias = gyroscope.values[within].mean(axis=0)
    spread = gyroscope.values[within].std(axis=0, ddof=1) / np.sqrt(max(within.stop - within.start, 1))
    clock = np.arange(len(t_gyro)) / gyroscope.rate_hz if rules.uniform_dt else t_gyro
    at_gyro = accelerometer.values
    if not np.array_equal(t_accel, t_gyro):
        at_gyro = np.column_stack([np.interp(t_gyro, t_accel, at_gyro[:, axis]) for axis in range(3)])
    segments = cut_segments(clock, gyroscope.values - bias, at_gyro, first, lengths)
    forces = (segments.accelerometer - search.fit.bias) @ search.fit.correction.T
    u_start, u_end = static_directions(accelerometer.values, still, search.fit, rules, accelerometer.rate_hz)
    means = (interval_means(accelerometer.values, still) - search.fit.bias) @ search.fit.correction.T
    return Turned(
        bias=bias,
        bias_sigma=spread,
        segments=segments,
        u=means / np.linalg.norm(means, axis=1, keepdims=True),
        start_s=start_s,
        stop_s=stop_s,
        fit=fit_gyroscope(segments, forces, u_start, u_end),
        at_rest=gyroscope_intervals(t_gyro, t_accel[still.start], t_accel[still.stop - 1]),
    )


def held_out_forces(fit: MagnitudeFit, samples: Floats, intervals: int, gravity_m_s2: float) -> Floats:
    """Return |f| - g of every interval's mean when the whole interval was left out, (n,) [m/s^2]."""
    n = len(samples) // intervals
    centred = samples - fit.bias
    force = centred @ fit.correction.T
    norm = np.linalg.norm(force, axis=1)
    pull = force / norm[:, None]
    columns = [pull[:, i] * centred[:, j] for i, j in zip(*UPPER, strict=True)]
    jacobian = np.column_stack([*columns, -pull @ fit.correction]).reshape(intervals, n, 9)
    covariance = np.linalg.pinv(np.einsum("kij,kil->jl", jacobian, jacobian))
    return leave_group_out(jacobian, (norm - gravity_m_s2).reshape(intervals, n), covariance).mean(axis=1)
