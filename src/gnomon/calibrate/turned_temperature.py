"""Multi-position recordings at several temperatures -> a calibration that knows how sensitivities and biases change.

each recording: calibrate -> order by evidence -> polynomials by weighted least squares -> calibration at the reference
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..assess.imu.joined_recordings import Scalars
from ..errors import RecordingError
from ..estimate.trust.between_recordings import Calibrations, RegressedEstimate, proven_order
from ..frozen import value_class
from ..options import ImuOptions
from ..progress import Progress
from ..recording import Floats, Recording
from ..results.calibration import Calibration, Covariance, covariance_names
from ..results.result import Result
from ..results.sensors import ImuCalibration
from ..results.temperature import AxisOverTemperature, TriadOverTemperature
from ..results.temperature_dependence import TEMPERATURE_PARTS, TemperatureDependence
from ..results.trust import VERDICTS
from .imu import calibrate_imu
from .several_recordings import calibrated_alike, scalars_of, with_scalars

FEWEST_TEMPERATURES = 3
_APART_K = 4.0
"""By which temperatures have to differ to count as two [K]."""
_BESIDE = {"accelerometer_bias": 0.2, "gyroscope_bias": 0.2, "gyroscope_scale": 1 / 3}
"""What remains of the usual difference between recordings where the temperature is known to about a kelvin:
`BETWEEN_RECORDINGS` states these for a change of 5 and 3 K. Of the others it was measured at one temperature."""
_MEDIAN = 0.48
"""`usual` over the median of its prior in `between_recordings`, whose tail is that heavy. Here what is usual is the
median: three temperatures hardly tell the scatter, and sigmas would be those of a sensor that scatters twice that."""
_PARTS = {
    f"{triad}_{part}": tuple(f"{triad}_{quantity}" for quantity in quantities)
    for triad in ("gyroscope", "accelerometer")
    for part, quantities in (("bias", ("bias",)), ("sensitivity", ("scale", "misalignment")))
} | {"gyroscope_g_sensitivity": ("gyroscope_g_sensitivity",)}
"""What may change with the temperature, each with one order, and its quantities."""


@value_class
class TurnedRecordings:
    """What was found of multi-position recordings.

    Attributes
    ----------
    results : of each recording
    names : of the recordings
    degc : (k,) mean temperature of each [degC]
    scalars : of all calibrations [SI]
    recorded : those that were estimated, in blocks
    orders : such as "gyroscope_bias" -> order
    found : the polynomials
    reference_degc : where they begin [degC]
    supported : highest order that was looked for
    """

    results: Sequence[Result]
    names: Sequence[str]
    degc: Floats
    scalars: Scalars
    recorded: Calibrations
    orders: dict[str, int]
    found: RegressedEstimate
    reference_degc: float
    supported: int

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest temperature [degC]."""
        return float(self.degc.min()), float(self.degc.max())

    def selection(self, power: int) -> Floats:
        """Return which coefficient is that of a power of each scalar, (n, p) of 0 and 1."""
        chosen = np.zeros((len(self.scalars.names), len(self.found.coefficients)))
        for i, scalar in enumerate(np.flatnonzero(self.scalars.estimated)):
            if (place := self.found.start[i] + power) < self.found.start[i + 1]:
                chosen[scalar, place] = 1.0
        return chosen


def fit_turned(
    recordings: Sequence[Recording], names: Sequence[str], degc: Floats, reference_degc: float, *,
    options: ImuOptions, supported: int, progress: Progress,
) -> TurnedRecordings:  # fmt: skip
    """Calibrate each recording, and find how the scalars follow the temperature.

    Parameters
    ----------
    degc : (k,) of each recording [degC]
    options : of each calibration
    supported : highest order that the range supports

    Raises
    ------
    RecordingError
        If there are too few temperatures; what a single recording raises is raised with its name.
    """
    apart = 1 + int(np.count_nonzero(np.diff(np.sort(degc)) > _APART_K))
    if apart < FEWEST_TEMPERATURES:
        told = ", ".join(f"{one:.1f}" for one in degc)
        raise RecordingError(
            f"the recordings in which the sensor is turned are at {told} degC. Sensitivities need "
            f"{FEWEST_TEMPERATURES} temperatures or more, {_APART_K:g} K or more apart."
        )
    results = calibrated_alike(recordings, names, options, progress, calibrate_imu)
    progress("joining the recordings over the temperature")
    scalars = scalars_of([result.calibration for result in results], names)
    at = np.flatnonzero(scalars.estimated)
    kept = dict.fromkeys(quantity for quantity, flag in zip(scalars.quantity, scalars.estimated, strict=True) if flag)
    recorded = Calibrations(
        degc=degc - reference_degc,
        values=scalars.values[:, at],
        covariances=scalars.covariances[:, at[:, None], at],
        blocks={
            name: replace(block, usual=_MEDIAN * block.usual * _BESIDE.get(name, 1.0))
            for name, block in zip(kept, scalars.blocks(), strict=True)
        },
    )
    most = min(supported, apart - 1, len(degc) - 2)
    progress("finding the polynomials")
    orders = dict.fromkeys(_PARTS, 0)
    for part, quantities in _PARTS.items():
        if there := [name for name in quantities if name in recorded.blocks]:
            orders[part] = proven_order(recorded.only(there), most)
    powers = {name: orders[part] for part, quantities in _PARTS.items() for name in quantities}
    return TurnedRecordings(
        results=results, names=names, degc=degc, scalars=scalars, recorded=recorded, orders=orders,
        found=recorded.fit(powers), reference_degc=reference_degc, supported=most,
    )  # fmt: skip


def turned_calibration(
    turned: TurnedRecordings, base: Calibration | None, low_degc: float, high_degc: float
) -> Calibration:
    """Return the calibration with its dependence on the temperature, and the covariance of both.

    Parameters
    ----------
    base : what is known of the sensor at the reference; where None, what these recordings tell, with the assessment of
        the worst of them
    """
    first = max((result.calibration for result in turned.results), key=lambda one: VERDICTS.index(one.verdict))
    scalars, coefficients = turned.scalars, turned.found.coefficients
    flat = [turned.selection(power) @ coefficients / scalars.factor for power in range(max(turned.orders.values()) + 1)]
    flat[0] = np.where(scalars.estimated, flat[0], scalars.values.mean(axis=0) / scalars.factor)
    terms = [with_scalars(first.imus["imu0"], one) for one in flat]
    jacobians = [turned.selection(power) / scalars.factor[:, None] for power in range(len(flat))]
    at = {name: i for i, name in enumerate(scalars.names)}
    parts: dict[str, Floats] = {}
    rows: dict[str, Floats] = {}
    for part in TEMPERATURE_PARTS:
        if not (order := turned.orders.get(part, 0)):
            continue
        triad, kind = part.split("_", 1)
        places = [at[name] for name in scalars.names if name.startswith(f"imu0.{triad}.{kind}[")]
        values = [getattr(getattr(term, triad), kind) for term in terms[1 : order + 1]]
        moved = [jacobian[places] for jacobian in jacobians[1 : order + 1]]
        if kind == "sensitivity":
            values, moved = _relative(getattr(terms[0], triad).sensitivity, values, jacobians[0][places], moved)
        elif kind == "g_sensitivity":
            values, moved = _by_itself(terms[0], parts.get("gyroscope_sensitivity"), values, moved)
        parts[part], rows[part] = np.array(values), np.concatenate(moved)
    found = replace(
        TemperatureDependence(reference_degc=turned.reference_degc, low_degc=low_degc, high_degc=high_degc), **parts
    )
    if base is None:
        jacobian = np.concatenate([jacobians[0], *rows.values()])
        matrix = jacobian @ turned.found.covariance @ jacobian.T
        own = np.zeros(len(scalars.names))
        own[scalars.estimated] = turned.found.scatter**2
        per_unit = np.outer(scalars.factor, scalars.factor)
        matrix[: len(own), : len(own)] += (np.diag(own) + scalars.gravity) / per_unit
        return _with_dependence(replace(first, imus={"imu0": terms[0]}), found, matrix)
    known = len(base.uncertainty.names)
    jacobian = np.concatenate([np.zeros((0, len(coefficients))), *rows.values()])
    matrix = np.zeros((known + len(jacobian), known + len(jacobian)))
    matrix[:known, :known] = base.uncertainty.matrix
    matrix[known:, known:] = jacobian @ turned.found.covariance @ jacobian.T
    return _with_dependence(base, found, matrix)


def _relative(
    sensitivity: Floats, values: Sequence[Floats], own: Floats, moved: Sequence[Floats]
) -> tuple[list[Floats], list[Floats]]:
    """Return coefficients relative to a sensitivity, D_j = P_j S^-1, and their derivatives, (9, p) each."""
    inverse = np.linalg.inv(sensitivity)
    count = own.shape[1]
    relative = [value @ inverse for value in values]
    derivatives = [
        np.einsum("rmp,mc->rcp", one.reshape(3, 3, count), inverse)
        - np.einsum("rn,nmp,mc->rcp", D, own.reshape(3, 3, count), inverse)
        for D, one in zip(relative, moved, strict=True)
    ]
    return relative, [one.reshape(9, count) for one in derivatives]


def _by_itself(
    sensor: ImuCalibration, relative: Floats | None, values: Sequence[Floats], moved: Sequence[Floats]
) -> tuple[list[Floats], list[Floats]]:
    """Return what of the g-sensitivity's coefficients is not that of the sensitivity, by the accelerometer's readings.

    H_j = (P_j - D_j G) S^-1, and the derivatives (9, p) by P_j: D_j G is of second order, and S known far better.
    """
    assert sensor.gyroscope is not None
    inverse = np.linalg.inv(sensor.required_accelerometer.sensitivity)
    known = [] if relative is None else list(relative)
    along = [D @ sensor.gyroscope.g_sensitivity for D in known] + [np.zeros((3, 3))] * len(values)
    own = [(value - part) @ inverse for value, part in zip(values, along, strict=False)]
    return own, [np.einsum("rmp,mc->rcp", one.reshape(3, 3, -1), inverse).reshape(9, -1) for one in moved]


def _with_dependence(base: Calibration, found: TemperatureDependence, matrix: Floats) -> Calibration:
    """Return a calibration of one IMU with a dependence on the temperature; the covariance lists its scalars last."""
    name, sensor = next(iter(base.imus.items()))
    imus = {name: replace(sensor, temperature=found)}
    names = covariance_names(imus, base.cameras)
    listed = [scalar for scalar in names if ".temperature." not in scalar]
    listed += [scalar for scalar in names if ".temperature." in scalar]
    order = [listed.index(scalar) for scalar in names]
    return replace(
        base, imus=imus, uncertainty=Covariance(names=names, matrix=np.ascontiguousarray(matrix[np.ix_(order, order)]))
    )


def describe_turned(turned: TurnedRecordings, calibration: Calibration, kind: str) -> dict[str, TriadOverTemperature]:
    """Return the biases or the scales ("bias", "scale") of each triad over the temperature; scales relative."""
    sensor: ImuCalibration = next(iter(calibration.imus.values()))
    return {
        triad: _described(turned, triad, kind, calibration)
        for triad in ("gyroscope", "accelerometer")
        if getattr(sensor, triad) is not None and f"{triad}_{kind}" in turned.recorded.blocks
    }


def _described(turned: TurnedRecordings, triad: str, kind: str, calibration: Calibration) -> TriadOverTemperature:
    quantity = f"{triad}_{kind}"
    order = turned.orders[f"{triad}_{'bias' if kind == 'bias' else 'sensitivity'}"]
    block = turned.recorded.blocks[quantity]
    scale = np.ones(3)
    if kind == "scale":  # the entries of the diagonal, in SI units
        scale = np.array([turned.found.coefficients[turned.found.start[i]] for i in block.index])
    axes = tuple(_axis(turned, int(i), order, float(one)) for i, one in zip(block.index, scale, strict=True))
    leave = turned.recorded.can_leave_out(order)
    z = np.abs(turned.recorded.only([quantity]).foretold(order)[0]) if leave else np.full((1, len(block.index)), np.nan)
    return TriadOverTemperature(
        order=order,
        axes=axes,
        turn_on=turned.found.scatter[block.index] / np.abs(scale),
        walk=np.full(3, np.nan),
        branches=np.full(3, np.nan),
        branches_sigma=np.full(3, np.nan),
        left_out_z=z,
    )


def _axis(turned: TurnedRecordings, scalar: int, order: int, scale: float) -> AxisOverTemperature:
    start = turned.found.start[scalar]
    own = slice(start + 1, start + 1 + order)
    return AxisOverTemperature.from_polynomial(
        turned.found.coefficients[own] / scale,
        turned.found.covariance[own, own] / scale**2,
        reference_degc=turned.reference_degc,
        span_degc=turned.span,
        degc=turned.degc,
        values=(turned.recorded.values[:, scalar] - turned.found.coefficients[start]) / scale,
        warm_up=np.arange(len(turned.degc), dtype=np.float64),
    )
