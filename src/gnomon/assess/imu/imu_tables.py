"""What a multi-position calibration was made of and how well it explains it, as tables for the report."""

import numpy as np

from ...detect.samples.rests import ThresholdTrial
from ...estimate.multiposition.bias_changes import BiasChanges
from ...estimate.multiposition.evidence import LeaveOneOutErrors
from ...estimate.multiposition.fit import MultiPositionFit
from ...estimate.multiposition.measurements import MotionSegments, integrate_rates, propagate_directions
from ...estimate.multiposition.model import B_, BG_, PARAMETERS
from ...estimate.multiposition.noise_levels import allan_deviation, averaging_time, whitened_rest
from ...estimate.multiposition.problem import ImuEstimate, MultiPositionProblem, TriadStream
from ...estimate.trust.parts import Instability
from ...findings import join_names, list_first
from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans, interval_means
from ...results.sensor_diagnostics import (
    AllanCurve,
    BiasSegments,
    DetectorTrace,
    ImuDiagnostics,
    IntervalTable,
    ModelTrial,
    RotationTable,
    SignalEnvelope,
)
from ...results.temperature_dependence import TemperatureDependence
from ...results.trust import Trust
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_BINS = 1500
_ALLAN_FROM_S, _ALLAN_TO_S = 1.0, 225.0


@value_class
class ImuFitSummary:
    """Everything that a multi-position calibration was made of.

    Attributes
    ----------
    accelerometer, gyroscope : the streams of the used intervals
    accelerometer_unit, gyroscope_unit : their units
    statistic : (n,) of the static detector, 1 at rest
    chosen, trials : the threshold taken, and all that were tried
    touched : intervals of `chosen` that were left out
    course : how the accelerometer's bias changed, by the magnitude of gravity in the intervals of `chosen`
    problem, fit, heldout : the estimation problem, its solution, its leave-one-out errors
    rivals : model -> leave-one-out errors
    estimate : the parameters
    trust, instabilities : how far they can be trusted, and how biases differed between parts of the recording
    unseen_sigma : (33,) part of the sigmas that is by changes of a bias which the data cannot exclude
    gravity_m_s2 : magnitude of gravity
    temperature : how the biases follow it; None where they do not, or nothing tells
    """

    accelerometer: TriadStream
    gyroscope: TriadStream
    accelerometer_unit: str
    gyroscope_unit: str
    statistic: Floats
    chosen: ThresholdTrial
    trials: tuple[ThresholdTrial, ...]
    touched: Booleans
    course: BiasChanges
    problem: MultiPositionProblem
    fit: MultiPositionFit
    heldout: LeaveOneOutErrors
    rivals: dict[str, LeaveOneOutErrors]
    estimate: ImuEstimate
    trust: Trust
    instabilities: tuple[Instability, ...]
    unseen_sigma: Floats
    gravity_m_s2: float
    temperature: TemperatureDependence | None = None

    @property
    def rows(self) -> Integers:
        """Numbers, among all rests that were found, of those in the problem."""
        return np.flatnonzero(self.chosen.rests.used)[~self.touched]

    def marked(self, of_chosen: Booleans) -> Booleans:
        """Return marks of the intervals of `chosen` as marks of all rests that were found."""
        found = np.zeros(len(self.chosen.rests), dtype=bool)
        found[self.chosen.rests.used] = of_chosen
        return found


def describe_imu(evidence: ImuFitSummary) -> ImuDiagnostics:
    """Return the tables and curves of a calibration."""
    a, g, fit = evidence.accelerometer, evidence.gyroscope, evidence.fit
    edges = bin_edges(len(a.t_s))
    return ImuDiagnostics(
        accelerometer=signal_envelope(a.t_s, a.values, evidence.accelerometer_unit),
        gyroscope=signal_envelope(g.t_s, g.values, evidence.gyroscope_unit),
        detector=DetectorTrace(
            t_s=_centres(a.t_s, edges),
            statistic=np.maximum.reduceat(evidence.statistic, edges),
            multiplier=evidence.chosen.multiplier,
            candidates=np.array(
                [[t.multiplier, len(t.intervals), t.heldout_rms, t.criterion] for t in evidence.trials]
            ),
        ),
        intervals=_interval_table(evidence),
        rotations=_rotation_table(evidence),
        allan=allan_curve(g, evidence.estimate.gyroscope_sensitivity),
        trials=tuple(
            ModelTrial(
                model=name,
                chosen=trial is evidence.heldout,
                accelerometer_rms=root_mean_square(trial.magnitude[fit.interval_used]) * evidence.gravity_m_s2,
                rotation_rms=root_mean_square(np.linalg.norm(trial.rotation[fit.rotation_used], axis=1)),
                parameters=30 if name == "g-sensitivity" else 21,
            )
            for name, trial in evidence.rivals.items()
        ),
        noise=_noise(evidence),
        trust=evidence.trust,
        bias_segments=_bias_segments(evidence),
    )


def root_mean_square(values: Floats) -> float:
    """Return the root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else float("nan")


def bin_edges(samples: int) -> Integers:
    """Return the first sample of each bin of an envelope."""
    bins = min(samples, _BINS)
    return (np.arange(bins) * samples) // max(bins, 1)


def _centres(t_s: Floats, edges: Integers) -> Floats:
    last = np.append(edges[1:], len(t_s)) - 1
    return 0.5 * (t_s[edges] + t_s[last])


def signal_envelope(t_s: Floats, values: Floats, unit: str) -> SignalEnvelope:
    """Return the extremes of a signal (n, 3) in at most 1500 bins."""
    edges = bin_edges(len(t_s))
    return SignalEnvelope(
        t_s=_centres(t_s, edges),
        low=np.minimum.reduceat(values, edges, axis=0),
        high=np.maximum.reduceat(values, edges, axis=0),
        unit=unit,
    )


def allan_curve(gyroscope: TriadStream, sensitivity: Floats) -> AllanCurve | None:
    """Return the Allan deviation over the first static interval, Eq. (3.17); None where it is under 8 s."""
    start, stop = int(gyroscope.intervals.start[0]), int(gyroscope.intervals.stop[0])
    static_s = (stop - start) / gyroscope.rate_hz
    if static_s < 8 * _ALLAN_FROM_S:
        return None
    tau = np.geomspace(_ALLAN_FROM_S, min(_ALLAN_TO_S, static_s / 4), 20)
    values = gyroscope.values[start:stop] / np.linalg.norm(sensitivity, axis=1)
    deviation = allan_deviation(values, gyroscope.rate_hz, tau)
    return AllanCurve(tau_s=tau, deviation=deviation, t_init_s=averaging_time(tau, deviation), static_s=static_s)


def uncalibrated_error(means: Floats, unit: str, gravity_m_s2: float) -> Floats:
    """Return |f| - g of static means (n, 3) as an uncalibrated sensor reads it, (n,) [m/s^2].

    In a physical unit by its nominal value; in counts by the best single scale and offsets, a sphere.
    """
    nominal = ACCELEROMETER_UNITS_M_S2.get(unit)
    if nominal is not None:
        return np.linalg.norm(means, axis=1) * nominal - gravity_m_s2
    centred = means - means.mean(axis=0)
    design = np.concatenate([2 * centred, np.ones((len(means), 1))], axis=1)
    solution = np.linalg.lstsq(design, np.sum(centred**2, axis=1), rcond=None)[0]
    radius = np.sqrt(max(solution[3] + solution[:3] @ solution[:3], np.finfo(float).tiny))
    return gravity_m_s2 * (np.linalg.norm(centred - solution[:3], axis=1) / radius - 1)


def uncalibrated_rotation_error(
    segments: MotionSegments, still: Floats, unit: str, sensitivity: Floats, u: Floats
) -> Floats:
    """Return |u_a - u_g| (m,) [rad] with one scale for all axes and the bias of the first static interval.

    Parameters
    ----------
    segments : rotations in the unit of the gyroscope
    still : (3,) mean of the first static interval [unit]
    unit : of the gyroscope; its nominal value is the scale, in counts it is the mean of the estimated ones
    sensitivity : (3, 3) estimated [unit per rad/s]
    u : (m + 1, 3) directions that the accelerometer measured
    """
    nominal = GYROSCOPE_UNITS_RAD_S.get(unit)
    scale = nominal if nominal is not None else float(np.abs(np.linalg.det(sensitivity))) ** (-1 / 3)
    turns = integrate_rates(segments, (segments.gyroscope - still) * scale)
    return np.linalg.norm(u[1:] - propagate_directions(turns.rotation, u[:-1]), axis=1)


def _interval_table(evidence: ImuFitSummary) -> IntervalTable:
    rests, fit, held = evidence.chosen.rests, evidence.fit, evidence.heldout
    stream, estimate, g = evidence.accelerometer, evidence.estimate, evidence.gravity_m_s2
    still, rows = rests.kept, evidence.rows
    means = interval_means(stream.values, still)
    drift = np.zeros_like(means)
    drift[rows] = fit.accelerometer_drift * evidence.problem.accelerometer.spread
    force = (means - drift - estimate.accelerometer_bias) @ np.linalg.inv(estimate.accelerometer_sensitivity).T
    norm = np.linalg.norm(force, axis=1)
    after, left_out = norm - g, norm - g
    direction = force / norm[:, None]
    left_out[rows] = held.magnitude * g
    direction[rows] = fit.state.u
    used = np.zeros(len(rests), dtype=bool)
    used[rows] = fit.interval_used
    reason = [
        why or ("" if ok else "gravity differs there from the others")
        for why, ok in zip(rests.reason, used, strict=True)
    ]
    for row in rows[~fit.interval_used]:
        reason[row] = _why_gated(evidence, int(np.searchsorted(rows, row)))
    rates = np.full((len(still), 3), np.nan)
    rates[rows] = evidence.problem.gyroscope_means
    duration = (still.stop - still.start) / stream.rate_hz
    per_unit = 1 / np.linalg.norm(estimate.accelerometer_sensitivity, axis=1)
    white = np.sqrt(np.mean(stream.density * per_unit**2) / duration)
    return IntervalTable(
        start_s=stream.t_s[still.start],
        stop_s=stream.t_s[still.stop - 1],
        samples=(still.stop - still.start).astype(np.float64),
        accelerometer=means,
        gyroscope=rates,
        direction=direction,
        error_before=uncalibrated_error(means, evidence.accelerometer_unit, g),
        error_after=after,
        error_holdout=left_out,
        sigma=np.sqrt(white**2 + fit.extra.accelerometer * g**2),
        used=used,
        reason=tuple(reason),
    )


def _why_gated(evidence: ImuFitSummary, k: int) -> str:
    """Return why the fit does not use interval k of the problem: by the triad that does not go with the others."""
    fit = evidence.fit
    force, rate = (
        float(np.linalg.norm(root[k] @ residual[k]))
        for root, residual in zip(
            whitened_rest(fit.data, fit.state, fit.extra), (fit.lines.accelerometer, fit.lines.gyroscope), strict=True
        )
    )
    return "gravity differs there from the others" if force >= rate else "the gyroscope's rate differs there"


def _rotation_table(evidence: ImuFitSummary) -> RotationTable:
    problem, fit, held = evidence.problem, evidence.fit, evidence.heldout
    u = held.measured
    raw = problem.gyroscope
    segments = MotionSegments(
        gyroscope=problem.data.segments.gyroscope * raw.spread + raw.centre,
        accelerometer=problem.data.segments.accelerometer,
        dt_s=problem.data.segments.dt_s,
        lengths=problem.data.segments.lengths,
    )
    before = uncalibrated_rotation_error(
        segments, problem.gyroscope_means[0], evidence.gyroscope_unit, evidence.estimate.gyroscope_sensitivity, u
    )
    cosine = np.clip(np.einsum("ki,ki->k", u[1:], u[:-1]), -1, 1)
    neighbours = fit.interval_used[1:] & fit.interval_used[:-1]
    reason = [
        why or ("" if ok else _why_not_used(beside))
        for why, ok, beside in zip(problem.unlinked, fit.rotation_used, neighbours, strict=True)
    ]
    for place in (place for changes in fit.changes for place in changes.steps if place == int(place)):
        reason[int(place) - 1] = ACROSS_STEP
    with np.errstate(divide="ignore"):
        # the length of an error has two components
        sigma = np.where(fit.whitening.rotation > 0, np.sqrt(2) / fit.whitening.rotation, np.nan)
    return RotationTable(
        start_s=problem.start_s,
        stop_s=problem.stop_s,
        first=evidence.rows[:-1],
        angle_rad=np.arccos(cosine),
        measured=u[1:],
        propagated=fit.lines.propagated,
        error_before=before,
        error_after=np.linalg.norm(held.rotation_fit, axis=1),
        error_holdout=np.linalg.norm(held.rotation, axis=1),
        sigma=sigma,
        used=fit.rotation_used,
        reason=tuple(reason),
    )


def _bias_segments(evidence: ImuFitSummary) -> tuple[BiasSegments, ...]:
    """Return the bias of each part of the recording, of each triad whose bias stepped."""
    fit, problem = evidence.fit, evidence.problem
    covariance = np.zeros((len(fit.free),) * 2)
    covariance[np.ix_(fit.free, fit.free)] = fit.arrow.corner_covariance
    still, t_s = evidence.accelerometer.intervals, evidence.accelerometer.t_s
    found: list[BiasSegments] = []
    first = PARAMETERS
    for triad, functions, bias, scaling, changes in (
        ("gyroscope", fit.data.of_gyroscope, BG_, problem.gyroscope, fit.changes[0]),
        ("accelerometer", fit.data.of_accelerometer, B_, problem.accelerometer, fit.changes[1]),
    ):
        columns = first + 3 * np.flatnonzero(functions.of_kind("step"))[:, None] + np.arange(3)
        first += 3 * len(functions.kind)
        if not len(columns):
            continue
        own = np.arange(bias.start, bias.stop)
        values, sigmas = [fit.state.theta[own]], [np.diag(covariance[np.ix_(own, own)])]
        for step in reversed(columns):
            both = covariance[np.ix_(np.r_[own, step], np.r_[own, step])]
            values.insert(0, fit.state.theta[own] + fit.state.theta[step])
            sigmas.insert(0, np.diag(both)[:3] + np.diag(both)[3:] + 2 * np.diag(both[:3, 3:]))
        starts, stops = (t_s[np.append(edge, edge[-1])] for edge in (still.start, still.stop - 1))
        first_rest = np.array(changes.steps, dtype=np.int64)
        within = np.array(changes.steps) - first_rest
        inside = starts[first_rest] + within * (stops - starts)[first_rest]
        found.append(
            BiasSegments(
                triad=triad,
                start_s=np.append(starts[0], np.where(within > 0, inside, starts[first_rest])),
                stop_s=np.append(np.where(within > 0, inside, stops[first_rest - 1]), stops[-1]),
                bias=np.array(values) * scaling.spread + scaling.centre,
                sigma=np.sqrt(np.maximum(sigmas, 0.0)) * scaling.spread,
                published=len(columns),
            )
        )
    return tuple(found)


ACROSS_STEP = "a bias stepped during it"


def _why_not_used(neighbours_used: bool) -> str:
    if neighbours_used:
        return "the gyroscope does not lead to the gravity measured after it"
    return "a static interval beside it is left out"


def _noise(evidence: ImuFitSummary) -> dict[str, float]:
    estimate, fit, g = evidence.estimate, evidence.fit, evidence.gravity_m_s2
    accelerometer = np.sqrt(evidence.accelerometer.density) / np.linalg.norm(estimate.accelerometer_sensitivity, axis=1)
    gyroscope = np.sqrt(evidence.gyroscope.density) / np.linalg.norm(estimate.gyroscope_sensitivity, axis=1)
    return {
        "accelerometer.density": root_mean_square(accelerometer),
        "accelerometer.between_intervals": float(np.sqrt(fit.extra.accelerometer)) * g,
        "gyroscope.density": root_mean_square(gyroscope),
        "gyroscope.between_intervals": float(np.sqrt(fit.extra.gyroscope)),
        "rotation.beyond_noise": float(np.sqrt(fit.extra.rotation)),
    }


def interval_numbers(marked: Booleans) -> str:
    """Return "3, 7 and 12": the numbers, counted from 1 as in the report, of marked intervals."""
    numbers = [str(k + 1) for k in np.flatnonzero(marked)]
    return list_first(numbers, 8) if len(numbers) > 8 else join_names(numbers) or "none"
