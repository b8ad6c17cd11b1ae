"""What is known of an IMU before a recording is looked at, and whether the recording agrees with it.

It is another calibration, stated sigmas, and what is held fixed:

    prior = ("imu0.gyroscope.bias=0.01",)    known to 0.01 about the prior calibration's value, or the nominal one
    fix = ("imu0.gyroscope.g_sensitivity",)  held at that value
    free = ("imu0.accelerometer",)           the prior calibration is not asked

From a prior calibration come sensitivities and g-sensitivity, each with its covariance. Biases do not: they are others
each time a sensor is switched on, by much more than their sigmas say. Whoever knows better states their sigma.
"""

import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np

from ..errors import OptionError
from ..estimate.triads.triad_problem import TriadPrior
from ..findings import Finding, make_finding
from ..frozen import value_class
from ..geometry.rotations import frame_rotation
from ..options import stated_prior
from ..recording import Floats, Integers, Source, shared_sources
from ..results.calibration import Calibration, Gravity
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT
from .uncertainty_budget import gravity_part

TRIADS = {"accelerometer": slice(0, 12), "gyroscope": slice(12, 33), "magnetometer": slice(33, 45)}
"""Where the scalars of each triad stand: sensitivity (row order), bias, of the gyroscope g-sensitivity (row order)."""

SCALARS = 45
_SI = {
    "accelerometer": ACCELEROMETER_UNITS_M_S2,
    "gyroscope": GYROSCOPE_UNITS_RAD_S,
    "magnetometer": MAGNETOMETER_UNITS_UT,
}
_OWN_FRAMES = {"gyro-x": "gyroscope", "mag-x": "magnetometer"}
_UPPER = (1, 2, 5)  # of the sensitivity, in row order


class Stated(Protocol):
    """Options that name parameters."""

    @property
    def fix(self) -> tuple[str, ...]:
        """Names of what is held."""
        ...

    @property
    def prior(self) -> tuple[str, ...]:
        """What is stated as NAME=SIGMA."""
        ...


_MATRIX = ("[0,0]", "[0,1]", "[0,2]", "[1,0]", "[1,1]", "[1,2]", "[2,0]", "[2,1]", "[2,2]")
_VECTOR = ("[0]", "[1]", "[2]")
NAMES = (
    *map("imu0.accelerometer.sensitivity{}".format, _MATRIX),
    *map("imu0.accelerometer.bias{}".format, _VECTOR),
    *map("imu0.gyroscope.sensitivity{}".format, _MATRIX),
    *map("imu0.gyroscope.bias{}".format, _VECTOR),
    *map("imu0.gyroscope.g_sensitivity{}".format, _MATRIX),
    *map("imu0.magnetometer.sensitivity{}".format, _MATRIX),
    *map("imu0.magnetometer.bias{}".format, _VECTOR),
)
"""The 45 scalars of an IMU with a magnetometer, as `parameters.parameters` orders them."""


@value_class
class KnownScalars:
    """Scalars that are known with a joint uncertainty.

    Attributes
    ----------
    index : (k,) their places among the 45
    mean : (k,) [unit of the recording]
    precision : (k, k) inverse of their covariance
    own_frame : the triad in whose own body frame they are known, or "" where it is that of the accelerometer
    """

    index: Integers
    mean: Floats
    precision: Floats
    own_frame: str = ""


@value_class
class Prior:
    """What is known beforehand, in body frame accel-x and the units of the recording.

    Attributes
    ----------
    known : scalars that are known with an uncertainty
    fixed : (45,) bool, held
    value : (45,) prior calibration's value, or the nominal one; what is fixed is held at it, nan where there is none
    """

    known: tuple[KnownScalars, ...]
    fixed: np.ndarray
    value: Floats

    def __bool__(self) -> bool:
        """Return whether anything is known."""
        return bool(self.known) or bool(self.fixed.any())

    def knows(self, name: str) -> bool:
        """Return whether anything is known of a scalar, or of one below "imu0.gyroscope.g_sensitivity"."""
        at = {i for i, scalar in enumerate(NAMES) if scalar.startswith(name)}
        return any(at & set(part.index.tolist()) for part in self.known) or bool(self.fixed[list(at)].any())

    def quadratic(self, x: Floats) -> tuple[Floats, Floats]:
        """Return precision (45, 45) and information vector (45,) of the prior, linearised about scalars x (45,).

        Its cost is 1/2 y' precision y - y' information, plus a constant, for scalars y near x. What is held fixed is
        not in it.
        """
        precision, information = np.zeros((SCALARS, SCALARS)), np.zeros(SCALARS)
        for part in self.known:
            jacobian, now = np.eye(SCALARS)[part.index], x[part.index]
            if part.own_frame:
                jacobian, now = _in_own_frame(part, x)
            weighted = jacobian.T @ part.precision
            precision += weighted @ jacobian
            information += weighted @ (part.mean - now + jacobian @ x)
        return precision, information

    def triad_prior(self, triad: str, *, own_frame: bool = False) -> TriadPrior | None:
        """Return what is known of one triad for the estimation from magnitudes, or None where that is nothing.

        Parameters
        ----------
        triad : "accelerometer", "gyroscope" or "magnetometer"
        own_frame : whether it is estimated in its own body frame; what is known in that frame is of no use in another
        """
        at = TRIADS[triad]
        count = at.stop - at.start
        precision, information = np.zeros((21, 21)), np.zeros(21)
        for part in self.known:
            rows = part.index - at.start
            inside = (rows >= 0) & (rows < count)
            if not inside.any() or (part.own_frame and not own_frame):
                continue
            joint = np.linalg.inv(np.linalg.inv(part.precision)[np.ix_(inside, inside)])
            precision[np.ix_(rows[inside], rows[inside])] += joint
            information[rows[inside]] += joint @ part.mean[inside]
        if not precision.any() and not self.fixed[at].any():
            return None
        mean, fixed = np.zeros(21), np.zeros(21, dtype=bool)
        mean[:count] = np.where(np.isfinite(self.value[at]), self.value[at], 0.0)
        told = precision.any(axis=1)
        mean[told] = np.linalg.solve(precision[np.ix_(told, told)], information[told])
        fixed[:count] = self.fixed[at]
        return TriadPrior(mean=mean, precision=precision, fixed=fixed)


NOTHING = Prior(known=(), fixed=np.zeros(SCALARS, dtype=bool), value=np.full(SCALARS, np.nan))
"""Nothing is known beforehand."""


Priors = Calibration | Sequence[Calibration] | None
"""Other calibrations of the same sensor, independent of each other."""


def refuse_own_data(prior: Priors, sources: Collection[Source], triads: Collection[str] = tuple(TRIADS)) -> None:
    """Refuse a prior calibration that was made from one of the recordings that are calibrated now.

    Parameters
    ----------
    prior : other calibrations
    sources : files of the recordings
    triads : which of them are estimated; a prior that tells of none of these is no evidence for them

    Raises
    ------
    OptionError
        If there is one; its measurements would count twice.
    """
    priors = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    for one in priors:
        shared = shared_sources(sources, one.provenance.inputs)
        told = any(getattr(imu, triad) is not None for imu in one.imus.values() for triad in triads)
        if shared and told:
            raise OptionError(
                f"--prior holds a calibration that was made from {shared[0].name}, the very recording that is "
                "calibrated: its measurements would count twice. Leave it out, or give one made from another recording."
            )


def gather_prior(
    prior: Priors,
    stated: Stated,
    units: Mapping[str, str],
    *,
    free: Iterable[str] = (),
    gravity: Gravity | None = None,
) -> Prior:
    """Gather what is known of an IMU beforehand.

    Parameters
    ----------
    prior : other calibrations of the same sensor
    stated : options with `fix`, and `prior` in the form NAME=SIGMA
    units : "accelerometer" -> unit of the recording, for each triad that it has
    free : names of which the prior calibrations are not asked
    gravity : what is taken for gravity now; an error that a prior calibration shares does not count twice

    Raises
    ------
    OptionError
        If a name is unknown, stands in two lists, has no value to be held at, or the units cannot be brought together.
    """
    priors = () if prior is None else (prior,) if isinstance(prior, Calibration) else tuple(prior)
    read = [_from_calibration(one, units, gravity) for one in priors]
    value = _best_value(_nominal(units), read)
    owners: dict[int, str] = {}
    unasked = [_places(name, "free", owners) for name in free]
    fixed, sigma = np.zeros(SCALARS, dtype=bool), np.zeros(SCALARS)
    for name in stated.fix:
        fixed[_with_value(name, "fix", _places(name, "fix", owners), value)] = True
    for text in stated.prior:
        name, spread = stated_prior(text)
        sigma[_with_value(name, "prior", _places(name, "prior", owners), value)] = spread
    overruled = np.concatenate([*unasked, np.flatnonzero(fixed | (sigma > 0))]).astype(np.int64)
    known = list(_parts(value, np.diag(sigma**2), ""))
    for one, (mean, covariance) in zip(priors, read, strict=True):
        covariance[overruled] = covariance[:, overruled] = 0.0
        known += _parts(mean, covariance, _OWN_FRAMES.get(one.frame, ""))
    return Prior(known=tuple(known), fixed=fixed, value=value)


def _best_value(nominal: Floats, read: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Return the value of each scalar by the calibration that knows it best, else the nominal one."""
    value, best = nominal.copy(), np.full(SCALARS, np.inf)
    for mean, covariance in read:
        variance = np.diag(covariance)
        better = np.isfinite(mean) & ((variance > 0) & (variance < best) | ~np.isfinite(best))
        value[better] = mean[better]
        best[better & (variance > 0)] = variance[better & (variance > 0)]
    return value


def _nominal(units: Mapping[str, str]) -> Floats:
    """Return the scalars of an ideal sensor in the units of the recording; nan where a count says nothing."""
    value = np.full(SCALARS, np.nan)
    for triad, unit in units.items():
        factor = _SI[triad].get(unit)
        scale = np.nan if factor is None else 1 / factor
        matrix = np.where(np.eye(3) > 0, scale, 0.0).ravel()
        zeros = np.zeros(TRIADS[triad].stop - TRIADS[triad].start - 12)
        value[TRIADS[triad]] = np.concatenate([matrix, np.full(3, np.nan if factor is None else 0.0), zeros])
    return value


def _from_calibration(prior: Calibration, units: Mapping[str, str], gravity: Gravity | None) -> tuple[Floats, Floats]:
    """Return values (45,), nan where there is none, and covariance (45, 45) of what the prior calibration knows."""
    if prior.frame not in ("accel-x", *_OWN_FRAMES):
        prior = prior.in_frame("accel-x")
    name, imu = next(iter(prior.imus.items()))
    value, covariance = np.full(SCALARS, np.nan), np.zeros((SCALARS, SCALARS))
    places: list[int] = []
    rows: list[int] = []
    factor = np.ones(SCALARS)
    column = {scalar: i for i, scalar in enumerate(prior.uncertainty.names)}
    for triad in ("accelerometer", "gyroscope", "magnetometer"):
        sensor = getattr(imu, triad)
        if sensor is None or triad not in units:
            continue
        factor[TRIADS[triad]] = _unit_ratio(triad, sensor.unit, units[triad])
        for i in range(TRIADS[triad].start, TRIADS[triad].stop):
            path, _, element = NAMES[i].replace("imu0.", f"{name}.", 1).partition("[")
            entry = tuple(map(int, element.rstrip("]").split(",")))
            value[i] = prior.parameter(path)[entry] * factor[i]
            if ".bias" not in path:
                places.append(i)
                rows.append(column[f"{path}[{element}"])
    matrix = prior.uncertainty.matrix
    if gravity is not None and gravity.source == prior.gravity.source and prior.provenance.method == "imu":
        matrix = matrix - gravity_part(prior)  # the same error is made again
    covariance[np.ix_(places, places)] = matrix[np.ix_(rows, rows)] * np.outer(factor[places], factor[places])
    return value, covariance


def _unit_ratio(triad: str, unit: str, wanted: str) -> float:
    if unit == wanted:
        return 1.0
    one, other = _SI[triad].get(unit), _SI[triad].get(wanted)
    if one is None or other is None:
        raise OptionError(
            f"the prior calibration's {triad} is in {unit}, the recording's in {wanted}. "
            "Read the recording with the units of the calibration (--units), or leave the prior out."
        )
    return one / other


def _parts(value: Floats, covariance: Floats, own: str) -> tuple[KnownScalars, ...]:
    """Return what is known, the triad that is known in its own frame alone apart from the rest."""
    variance = np.diag(covariance)
    known = np.flatnonzero((variance > 0) & np.isfinite(value))
    apart = np.zeros(len(known), dtype=bool)
    if own:
        apart = (known >= TRIADS[own].start) & (known < TRIADS[own].start + 9)
        apart |= (known >= TRIADS[own].start + 12) & (known < TRIADS[own].stop)
    found: list[KnownScalars] = []
    for index, frame in ((known[~apart], ""), (known[apart], own)):
        if len(index):
            sigma = np.sqrt(variance[index])
            correlation = covariance[np.ix_(index, index)] / np.outer(sigma, sigma)
            # an error that all share may have been taken off: nothing is known better than to a millionth of its sigma
            size, axes = np.linalg.eigh(correlation)
            inverse = (axes / np.maximum(size, 1e-10)) @ axes.T
            found.append(
                KnownScalars(
                    index=index, mean=value[index], precision=inverse / np.outer(sigma, sigma), own_frame=frame
                )
            )
    return tuple(found)


def _in_own_frame(part: KnownScalars, x: Floats) -> tuple[Floats, Floats]:
    """Return derivative (k, 45) and value (k,) of the known scalars, seen in the triad's own body frame."""
    at = TRIADS[part.own_frame]

    def seen(y: Floats) -> Floats:
        matrices = y[at].copy()
        sensitivity = matrices[:9].reshape(3, 3)
        turn = frame_rotation(sensitivity, "accel-x")
        matrices[:9] = (sensitivity @ turn.T).ravel()
        if len(matrices) > 12:
            matrices[12:] = (matrices[12:].reshape(3, 3) @ turn.T).ravel()
        return matrices[part.index - at.start]

    jacobian = np.zeros((len(part.index), SCALARS))
    step = 1e-6 * max(float(np.abs(x[at][:9]).max()), 1e-300)
    for column in range(at.start, at.stop):
        move = np.zeros(SCALARS)
        move[column] = step
        jacobian[:, column] = (seen(x + move) - seen(x - move)) / (2 * step)
    return jacobian, seen(x)


def _places(name: str, option: str, owners: dict[int, str]) -> Integers:
    """Return the places of the scalars that a name stands for: itself, a matrix, or a triad."""
    full = name if name.startswith("imu0.") else f"imu0.{name}"
    found = [i for i, scalar in enumerate(NAMES) if scalar == full or scalar.startswith((f"{full}[", f"{full}."))]
    if not found:
        known = sorted({scalar.partition("[")[0] for scalar in NAMES})
        close = difflib.get_close_matches(full, known, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise OptionError(f"--{option} {name}: there is no such parameter.{hint} Known: {', '.join(known)}.")
    for i in found:
        if owners.setdefault(i, option) != option:
            raise OptionError(f"--{option} {name}: {NAMES[i]} is also in --{owners[i]}. Keep one of them.")
    whole = "[" not in name
    frame_zero = {TRIADS["accelerometer"].start + i for i in _UPPER}
    if not whole and found[0] in frame_zero:
        raise OptionError(f"--{option} {name}: the body frame makes it zero. Name another entry, or leave it out.")
    return np.array([i for i in found if i not in frame_zero], dtype=np.int64)


def _with_value(name: str, option: str, at: Integers, value: Floats) -> Integers:
    if not np.isfinite(value[at]).all():
        raise OptionError(
            f"--{option} {name}: there is no value to hold it at, since the recording is in counts or has no such "
            "sensor. Give a calibration that knows it, --prior calibration.yaml."
        )
    return at


_TELLS = 0.1  # information of the recording against that of the prior, from which on it can contradict it
_SURE = 3.7  # sigmas of a normal variable: one healthy recording of ten thousand


def prior_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether the recording contradicts it.

    Parameters
    ----------
    values : (n,) estimate from the recording alone, of the first n of the 45 scalars in the order of `evidence.NAMES`
    covariance : (n, n)
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        chi2, degrees, worst = _disagreement(part, values, covariance)
        if chi2 > _limit(degrees):
            findings.append(make_finding("prior-disagrees/imu", chi2=chi2, degrees=degrees, worst_name=NAMES[worst]))
    return findings


def cameras_disagree(
    names: tuple[str, ...], difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats
) -> list[Finding]:
    """Return whether a recording contradicts what was known of its cameras, which the estimate rests on, too.

    Parameters
    ----------
    names : (n,) scalars
    difference : (n,) estimate minus prior
    prior : (n, n) covariance of the prior
    ordinary, covariance : (n, n) of the estimate, for independent errors and as it is published
    """
    chi2, degrees = _pulled(difference, prior, ordinary, covariance)
    if not degrees or chi2 <= _limit(degrees):
        return []
    worst = int(np.argmax(np.abs(difference) / np.sqrt(np.diag(prior))))
    return [make_finding("prior-disagrees/cameras", chi2=chi2, degrees=degrees, worst_name=names[worst])]


def pulled_findings(known: Prior, values: Floats, covariance: Floats) -> list[Finding]:
    """Return what was taken from elsewhere, and whether an estimate that rests on it, too, contradicts it.

    For recordings that determine too little on their own.

    Parameters
    ----------
    values, covariance : as for `prior_findings`, of the estimate from both
    """
    findings = prior_used(known)
    for part in known.known:
        if part.own_frame or part.index.min() >= len(values):
            continue
        shown = part.index < len(values)
        index = part.index[shown]
        estimated = covariance[np.ix_(index, index)]
        difference = values[index] - part.mean[shown]
        prior = np.asarray(np.linalg.inv(part.precision)[np.ix_(shown, shown)], dtype=np.float64)
        chi2, degrees = _pulled(difference, prior, estimated, estimated)
        if degrees and chi2 > _limit(degrees):
            worst = NAMES[int(index[np.argmax(np.abs(difference) / np.sqrt(np.diag(prior)))])]
            findings.append(make_finding("prior-disagrees/rig", chi2=chi2, degrees=degrees, worst=worst))
    return findings


def _pulled(difference: Floats, prior: Floats, ordinary: Floats, covariance: Floats) -> tuple[float, int]:
    """Return chi squared of recording minus prior, from an estimate that both made, and its degrees of freedom.

    In coordinates in which the prior's covariance is I and the recording's information diagonal, lambda, the estimate
    differs from the prior by w, and the recording alone would by w (1 + 1 / lambda), with the variance 1 + f / lambda
    where f is by how much its errors are larger than independent ones.
    """
    left = np.linalg.inv(np.linalg.cholesky(prior))
    kept, axes = np.linalg.eigh(left @ ordinary @ left.T)  # 1 / (1 + lambda)
    told = kept < 1 / (1 + _TELLS)
    if not told.any():
        return 0.0, 0
    information = 1 / np.maximum(kept[told], 1e-12) - 1
    white = axes[:, told].T @ left
    wider = np.maximum(np.einsum("ij,jk,ik->i", white, covariance, white) / kept[told], 1.0)
    by_recording = (white @ difference) ** 2 * (1 + 1 / information) ** 2
    return float(np.sum(by_recording / (1 + wider / information))), int(told.sum())


def prior_used(known: Prior) -> list[Finding]:
    """Return what was taken from elsewhere; nothing where nothing was."""
    if not known:
        return []
    paths = {NAMES[i].partition("[")[0].removeprefix("imu0.") for part in known.known for i in part.index}
    held = {NAMES[i].partition("[")[0].removeprefix("imu0.") for i in np.flatnonzero(known.fixed)}
    parts = [f"known beforehand: {', '.join(sorted(paths))}"] if paths else []
    parts += [f"held: {', '.join(sorted(held))}"] if held else []
    return [make_finding("prior-used", parts="; ".join(parts))]


def _disagreement(part: KnownScalars, values: Floats, covariance: Floats) -> tuple[float, int, int]:
    """Return chi squared of recording minus prior, its degrees of freedom, and the place of the worst scalar."""
    shown = part.index < len(values)
    index = part.index[shown]
    difference = values[index] - part.mean[shown]
    joint = covariance[np.ix_(index, index)] + np.linalg.inv(part.precision)[np.ix_(shown, shown)]
    sigma = np.sqrt(np.diag(joint))
    z = difference / sigma
    chi2 = z @ np.linalg.solve(joint / np.outer(sigma, sigma), z)
    return float(chi2), len(z), int(index[np.argmax(np.abs(z))])


def _limit(degrees: int) -> float:
    """Return the quantile of chi squared, by Wilson and Hilferty's approximation."""
    return degrees * (1 - 2 / (9 * degrees) + _SURE * np.sqrt(2 / (9 * degrees))) ** 3
