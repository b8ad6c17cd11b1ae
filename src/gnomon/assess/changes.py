"""What changed in the middle of a recording, in its own unit and against what a use needs.

`estimate.trust.changes` proves that a block of parameters changed. A change that a use does not feel is information;
beyond what it needs the result is a mean that holds for no part, whatever its sigmas say.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..findings import Finding, make_finding
from ..geometry.rotations import invert_matrix, skew
from ..models.camera import Camera
from ..options.requirements import FIELD_UT, GENERAL_IMU, GENERAL_RIG, QUANTITIES, RequiredQuantity, Use
from ..recording import Floats
from ..results.calibration import Calibration
from ..results.trust import ParameterChange, QuantityChange, Trust
from .verdict import grade_value, with_verdict

_CLOCKS = (".time_shift_cam_imu", ".time_shift_imu")

_CERTAIN = 3.0
"""Sigmas from which on a quantity of a block that changed counts as changed itself."""

_ROUNDING = 1e-9  # [SI, px]
_COLUMNS, _ROWS = 16, 12
OF_HEADING = 2.0
"""Error of a heading over that of the field's direction, where the field dips by 60 deg."""


_FASTEN = "Check that sensors, board and housing are screwed on and that nothing was touched"
_EXCHANGED = f"Check that its data are of one sensor throughout, not of another one from then on. {_FASTEN}"
_WARM = "Let the sensor warm up, and keep it at one temperature"
_QUANTITIES: Mapping[str, RequiredQuantity] = {
    **QUANTITIES,
    "lens": RequiredQuantity(words="lens of {sensor} (rms over the image)", unit="px", size=1.0),
}
_NEEDED: Mapping[str, float] = {
    **GENERAL_IMU.needs,
    **GENERAL_RIG.needs,
    # As for a phone's g-sensitivity and an attitude module's heading.
    "gyroscope_g_sensitivity": np.radians(0.1) / 9.80665,
    "heading": np.radians(0.7),
    "lens": 0.25,
}
"""Quantity -> what is needed where no use is stated [SI]; nothing of biases. A lens that is off by a quarter of a pixel
is worse than any good detector."""

_CURES = {
    "gyroscope_scale": _WARM,
    "accelerometer_scale": _WARM,
    "gyroscope_bias": _WARM,
    "accelerometer_bias": _WARM,
    "time_shift": "Stamp images and samples by one clock (a hardware trigger, or PTP)",
    "heading": "Keep iron, magnets and cables away from the sensor, or fix them to it",
    "lens": "Fix zoom, focus and crop of the camera, turn off autofocus and stabilisation, and check that all images "
    "are of one camera",
}


def with_changes(calibration: Calibration, trust: Trust | None) -> Calibration:
    """Return a calibration whose assessment says what changed during the recording.

    Parameters
    ----------
    calibration : as published, for no special use
    trust : what the recording tells of it
    """
    if trust is None or not trust.changes:
        return calibration
    changes = tuple(change for one in trust.changes for change in quantity_changes(one, calibration))
    assessment = replace(calibration.assessment, trust=replace(calibration.assessment.trust, changes=changes))
    findings = [*without_changes(assessment.findings, changes), *change_findings(changes, None)]
    return replace(calibration, assessment=with_verdict(assessment, findings))


def without_changes(findings: Sequence[Finding], changes: Sequence[QuantityChange]) -> list[Finding]:
    """Return findings but those on changes, and on jumps of clocks that these tell of better."""
    jumped = {name for change in changes if _is_jump(change) for name in (change.block, change.sensor)}
    return [
        one
        for one in findings
        if one.code != "parameter-changed" and not (one.code == "clock-jump" and one.subject in jumped)
    ]


def _is_jump(change: QuantityChange) -> bool:
    """Tell whether a clock jumped: a time shift that changed at once."""
    return change.block.endswith(_CLOCKS) and change.at_s is not None


def change_findings(changes: Sequence[QuantityChange], use: Use | None) -> Iterator[Finding]:
    """Yield a finding for each block that changed.

    Parameters
    ----------
    changes : of quantities, those of one block behind each other
    use : what the result is for; None for no special use
    """
    jumped = {change.sensor for change in changes if _is_jump(change)}
    moved = {
        change.sensor
        for change in changes
        if not change.block.endswith(_CLOCKS) and 0 < needed_of(change, use) < change.size
    }
    for place in dict.fromkeys((change.block, change.where) for change in changes):
        own = [change for change in changes if (change.block, change.where) == place]
        needed = [needed_of(change, use) for change in own]
        grades = [
            grade_value(change.size, need, (10.0 if use is None else use.fails_at) * need) if need else "good"
            for change, need in zip(own, needed, strict=True)
        ]
        severity = "problem" if "problem" in grades else "warning" if "warning" in grades else "info"
        told = "; ".join(_told(change, need, use) for change, need in zip(own, needed, strict=True))
        beyond = severity != "info"
        if beyond and _is_jump(own[0]) and own[0].sensor not in moved:
            yield make_finding(
                "clock-jump/parts",
                severity=severity,
                block=place[0],
                sensor=own[0].sensor,
                at_s=own[0].at_s,
                told=told,
            )
            continue
        worst = max(zip(own, needed, strict=True), key=lambda pair: pair[0].size / pair[1] if pair[1] else 0.0)[0]
        yield make_finding(
            "parameter-changed",
            severity=severity,
            case="beyond" if beyond else "",
            told=told,
            where=own[0].where,
            cure=_EXCHANGED if own[0].sensor in jumped & moved else _CURES.get(worst.quantity, _FASTEN),
        )


def needed_of(change: QuantityChange, use: Use | None) -> float:
    """Return what is needed of a quantity [SI]; zero where a use does not ask for it."""
    if use is None or change.quantity not in QUANTITIES:
        return _NEEDED.get(change.quantity, 0.0)
    return use.needs.get(change.quantity, 0.0)


def unit_of_quantity(quantity: str) -> tuple[str, float]:
    """Return the unit in which a quantity is told, and one of it [SI, px]."""
    return _QUANTITIES[quantity].unit, _QUANTITIES[quantity].size


def told_with_cure(change: QuantityChange, needed: float, use: Use | None) -> tuple[str, str]:
    """Return a change in words beside what is needed, and what to do about it."""
    return _told(change, needed, use), _CURES.get(change.quantity, _FASTEN)


def _told(change: QuantityChange, needed: float, use: Use | None) -> str:
    quantity = _QUANTITIES[change.quantity]
    words = quantity.words.format(sensor=change.sensor)
    if "{sensor}" not in quantity.words and change.sensor != "imu0":
        words += f" of {change.sensor}"
    who = "general use" if use is None else use.name
    limit = f"{who} needs {needed / quantity.size:.2g}" if needed else f"{who} does not ask for it"
    size, sigma = change.size / quantity.size, change.sigma / quantity.size
    return f"the {words} by {size:.2g} +- {sigma:.1g} {quantity.unit} ({limit})"


def quantity_changes(change: ParameterChange, calibration: Calibration) -> tuple[QuantityChange, ...]:
    """Return what a change of a block is in the units that uses ask for.

    Parameters
    ----------
    change : of a block of parameters
    calibration : whose parameters they are
    """
    sensor, _, rest = change.block.partition(".")
    found = [
        QuantityChange(
            block=change.block,
            quantity=name,
            sensor=sensor,
            size=size,
            sigma=sigma,
            where=change.where,
            at_s=change.at_s if np.isfinite(change.at_s) else None,
        )
        for name, size, sigma in _sizes(change, sensor, rest, calibration)
    ]
    moved = [one for one in found if one.size > _ROUNDING] or found
    certain = [one for one in moved if one.size > _CERTAIN * one.sigma]
    return tuple(certain or sorted(moved, key=lambda one: one.sigma / max(one.size, 1e-300))[:1])


def _sizes(
    change: ParameterChange, sensor: str, rest: str, calibration: Calibration
) -> Iterator[tuple[str, float, float]]:
    """Yield quantity, size of its change, and standard deviation of that [SI, px]."""
    if sensor in calibration.cameras and rest in ("intrinsics", "distortion_coeffs"):
        yield "lens", *_in_image(calibration.cameras[sensor].camera, change)
    elif rest.endswith(".sensitivity"):
        triad = rest.partition(".")[0]
        matrix = getattr(calibration.imus[sensor], triad).sensitivity
        if triad == "magnetometer":
            yield "heading", *_largest(change, OF_HEADING * np.kron(np.eye(3), np.linalg.inv(matrix).T))
            return
        rows = matrix / np.linalg.norm(matrix, axis=1, keepdims=True)
        relative = 1 / np.repeat(np.linalg.norm(matrix, axis=1), 3)
        along = np.kron(np.eye(3), np.ones((1, 3))) * rows.ravel() * relative
        yield f"{triad}_scale", *_largest(change, along)
        across = np.zeros((9, 9))
        for i, row in enumerate(rows):
            across[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.eye(3) - np.outer(row, row)
        yield f"{triad}_misalignment", *_largest(change, across * relative, groups=3)
    elif rest == "magnetometer.bias":
        magnetometer = calibration.imus[sensor].magnetometer
        assert magnetometer is not None
        field = FIELD_UT if magnetometer.field_unit == "uT" else 1.0
        yield "heading", *_largest(change, OF_HEADING / field * invert_matrix(magnetometer.sensitivity))
    elif rest.endswith(".g_sensitivity"):
        matrix = getattr(calibration.imus[sensor], rest.partition(".")[0]).sensitivity
        yield "gyroscope_g_sensitivity", *_largest(change, np.diag(1 / np.repeat(np.linalg.norm(matrix, axis=1), 3)))
    elif rest.endswith("line_delay"):
        rows = calibration.cameras[sensor].camera.resolution[1]
        yield "time_shift", *_largest(change, rows * np.eye(1))
    elif "time_shift" in rest:
        yield "time_shift", *_largest(change, np.eye(1))
    elif rest.endswith(".rotation"):
        yield f"{_kind(sensor)}_rotation", *_largest(change, np.eye(3), groups=3)
    elif rest.endswith((".translation", ".lever_arms_m")):
        count = 9 if rest.endswith("lever_arms_m") else 3
        yield f"{_kind(sensor)}_translation", *_largest(change, np.eye(count), groups=3)


def _kind(sensor: str) -> str:
    return "imu" if sensor.startswith("imu") else "camera"


def _largest(change: ParameterChange, by_scalar: Floats, groups: int = 1) -> tuple[float, float]:
    """Return the largest change of some numbers, or length of as many together, and its standard deviation.

    Parameters
    ----------
    by_scalar : (q, k) derivative of the numbers by the scalars of the whole block
    """
    values, covariance = _whole(change, by_scalar.shape[1])
    moved = (by_scalar @ values).reshape(-1, groups)
    spread = by_scalar @ covariance @ by_scalar.T
    lengths = np.linalg.norm(moved, axis=1)
    worst = int(np.argmax(lengths))
    at = slice(groups * worst, groups * worst + groups)
    way = moved[worst] / max(float(lengths[worst]), 1e-300)
    return float(lengths[worst]), float(np.sqrt(max(way @ spread[at, at] @ way, 0.0)))


def _whole(change: ParameterChange, count: int) -> tuple[Floats, Floats]:
    """Return change (count,) and covariance of all scalars of a block, zero for those that were not estimated."""
    at = [_place(name, count) for name in change.names]
    values, covariance = np.zeros(count), np.zeros((count, count))
    values[at] = change.values
    covariance[np.ix_(at, at)] = change.covariance
    return values, covariance


def _place(name: str, count: int) -> int:
    """Return where a scalar stands in its block, from "[2]" or "[0,1]"."""
    inside = name.partition("[")[2].rstrip("]")
    index = [int(part) for part in inside.split(",")] if inside else [0]
    return index[0] if len(index) == 1 else index[0] * (count // 3) + index[1]


def _in_image(camera: Camera, change: ParameterChange) -> tuple[float, float]:
    place = {name: k for k, name in enumerate(camera.parameter_names)}
    columns = [place[name.partition(".")[2]] for name in change.names]
    return lens_movement(camera, change.values, change.covariance, columns)[:2]


def lens_movement(
    camera: Camera, values: Floats, covariance: Floats, columns: Sequence[int] | None = None, *, turned: bool = False
) -> tuple[float, float, float]:
    """Return how far points of the image move, rms over it, the standard deviation of that, and its largest [px].

    Parameters
    ----------
    values, covariance : (k,), (k, k) change of parameters
    columns : which parameters these are; all where not given
    turned : whether a turn of the camera is taken out, which its pose takes up where nothing holds that
    """
    width, height = camera.resolution
    x, y = np.linspace(0, width - 1, _COLUMNS), np.linspace(0, height - 1, _ROWS)
    rays, seen = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    image = camera.project(np.where(seen[:, None], rays, [0.0, 0.0, 1.0]), parameters_jacobian=True)
    assert image.by_parameters is not None
    slopes = image.by_parameters[seen & image.valid]  # (n, 2, k)
    slopes = slopes if columns is None else slopes[:, :, columns]
    if turned:
        assert image.by_point is not None
        by_turn = (image.by_point @ skew(rays))[seen & image.valid].reshape(-1, 3)
        flat = slopes.reshape(len(by_turn), -1)
        slopes = (flat - by_turn @ np.linalg.lstsq(by_turn, flat, rcond=None)[0]).reshape(slopes.shape)
    gram = np.einsum("nik,nil->kl", slopes, slopes) / max(len(slopes), 1)
    size = float(np.sqrt(max(values @ gram @ values, 0.0)))
    along = gram @ values / max(size, 1e-300)
    spread = float(np.sqrt(max(np.linalg.eigvals(gram @ covariance).real.max(), 0.0)))
    return size, float(np.sqrt(max(along @ covariance @ along, 0.0))), spread
