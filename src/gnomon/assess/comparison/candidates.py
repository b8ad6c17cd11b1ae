"""Calibrations that are compared, whatever program made them: what each states, in one frame, one form and SI units.

All are brought into body frame "accel-x", and the sensors into the form of Krebs, whose tables of repeatability
B.3 to B.9 this follows: scale S and misalignment M of each triad (measured = S M R x + b), the rotation R from the body
to the triad, and the g-sensitivity. Scale and misalignment are the same in every body frame. Covariances go along by
the derivatives of all of it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from itertools import combinations
from typing import Literal, Self, cast

import numpy as np

from ...errors import OptionError
from ...findings import Finding, join_names, make_finding
from ...formats.foreign import FOREIGN_METHOD, ForeignCalibration
from ...frozen import FrozenMapping, value_class
from ...models.camera import Camera
from ...models.origin import Origin
from ...recording import Floats, Source, frozen_array
from ...results.calibration import TRUTH_METHOD, Calibration, CameraCalibration, Covariance, Gravity, ImuCalibration
from ...results.moved import moved_into_frame, moved_to_origin
from ...results.sensors import calibration_parameters, covariance_names, element_names
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT

FRAME = "accel-x"
_SCALED = ("sensitivity", "bias", "g_sensitivity")
_KALIBR_GRAVITY = Gravity(value=9.80655, sigma=0.0, source="Kalibr's constant")
_UNITS = {
    "accelerometer": (ACCELEROMETER_UNITS_M_S2, "m/s^2"),
    "gyroscope": (GYROSCOPE_UNITS_RAD_S, "rad/s"),
    "magnetometer": (MAGNETOMETER_UNITS_UT, "uT"),
}


@value_class
class ComparisonCandidate:
    """One of the calibrations that are compared.

    Attributes
    ----------
    name : by which it is called, unique among them
    format : what it was read from, such as "gnomon" or "Kalibr, cameras"
    imus, cameras : mappings as in a Calibration; either may be empty
    lenses : cameras whose place is not stated
    frame : body frame as stated
    covariance : of all scalars of the IMUs and the cameras; None where no standard deviations are stated
    exact : whether it is the truth of a simulation, which has no errors
    gravity : what it took for gravity; None where that is not known
    inputs : files of the recording that it was made from, with their hashes; empty where that is not known
    verdict : of gnomon's own calibrations, else ""
    recordings : from how many recordings, where the scatter between them is part of its covariance; 0 of a single one
    notes : sentences on what was taken for what the files do not say
    guessed_sizes : cameras whose size of the image was guessed
    """

    name: str
    format: str
    imus: Mapping[str, ImuCalibration]
    cameras: Mapping[str, CameraCalibration] = field(default_factory=dict[str, CameraCalibration])
    lenses: Mapping[str, Camera] = field(default_factory=dict[str, Camera])
    frame: str = FRAME
    covariance: Covariance | None = None
    exact: bool = False
    gravity: Gravity | None = None
    inputs: tuple[Source, ...] = ()
    verdict: str = ""
    recordings: int = 0
    notes: tuple[str, ...] = ()
    guessed_sizes: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for name in ("imus", "cameras", "lenses"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))

    @classmethod
    def of(cls, name: str, found: Calibration | ForeignCalibration) -> Self:
        """Return a calibration, gnomon's own or another project's, as a candidate."""
        if isinstance(found, Calibration):
            own, exact = found.provenance.method != FOREIGN_METHOD, found.provenance.method == TRUTH_METHOD
            stated = bool(np.nanmax(np.diag(found.uncertainty.matrix), initial=0.0) > 0)
            return cls(
                name=name,
                format=f"gnomon {found.provenance.gnomon_version}" + ("" if own else ", of another project's"),
                imus=found.imus,
                cameras=found.cameras,
                frame=found.frame,
                covariance=found.uncertainty if (own and not exact) or stated else None,
                exact=exact,
                gravity=found.gravity if own and found.imus else None,
                inputs=found.provenance.inputs,
                verdict=found.verdict if own else "",
                recordings=found.assessment.trust.recordings,
            )
        kalibrs = found.format.startswith("Kalibr") and any(imu.accelerometer for imu in found.imus.values())
        return cls(
            name=name,
            format=found.format,
            imus=_with_lever_arms(found),
            cameras=found.cameras,
            lenses=found.lenses,
            frame=found.frame,
            covariance=_stated_sigmas(found),
            gravity=_KALIBR_GRAVITY if kalibrs else None,
            notes=found.notes,
            guessed_sizes=found.guessed_sizes,
        )

    def renamed(self, names: Mapping[str, str]) -> Self:
        """Return the candidate with sensors called otherwise, old name -> new name.

        Raises
        ------
        OptionError
            If it has no such sensor, or two would have one name.
        """
        there = (*self.imus, *self.cameras, *self.lenses)
        for old, new in names.items():
            if old not in there:
                raise OptionError(f"{self.name} has no {old} to be renamed. There are: {', '.join(there)}.")
            if new in there and new not in names:
                raise OptionError(f"{self.name} has a {new} already, so that {old} cannot be called so.")
        if len({names.get(name, name) for name in there}) < len(there):
            raise OptionError(f"{self.name}: two sensors would be called alike ({', '.join(names.values())}).")
        imus = {names.get(name, name): imu for name, imu in self.imus.items()}
        cameras = {
            names.get(name, name): camera
            if camera.body == "imu0"
            else replace(camera, body=cast("Literal['imu0', 'cam0']", names.get(camera.body, camera.body)))
            for name, camera in self.cameras.items()
        }
        lenses = {names.get(name, name): lens for name, lens in self.lenses.items()}
        covariance = self.covariance
        if covariance is not None:
            covariance = Covariance(names=covariance_names(imus, cameras), matrix=covariance.matrix)
        sizes = frozenset(names.get(name, name) for name in self.guessed_sizes)
        return replace(self, imus=imus, cameras=cameras, lenses=lenses, covariance=covariance, guessed_sizes=sizes)

    @property
    def bodies(self) -> frozenset[str]:
        """Sensors to which its cameras are placed: "imu0", or a camera where they were calibrated without an IMU."""
        return frozenset(camera.body for camera in self.cameras.values())

    @property
    def all_lenses(self) -> dict[str, Camera]:
        """All cameras, with and without a place."""
        return {**{name: camera.camera for name, camera in self.cameras.items()}, **self.lenses}


def _with_lever_arms(found: ForeignCalibration) -> dict[str, ImuCalibration]:
    """Return the IMUs with the places of their accelerometers, which Kalibr's files state beside the sensor model."""
    imus = dict(found.imus)
    for name, data in found.imu_data.items():
        accelerometer = imus[name].accelerometer if name in imus else None
        if accelerometer is not None and accelerometer.lever_arms_m is None and data.lever_arms_m is not None:
            accelerometer = replace(accelerometer, lever_arms_m=data.lever_arms_m)
            imus[name] = replace(imus[name], accelerometer=accelerometer)
    return imus


def _stated_sigmas(found: ForeignCalibration) -> Covariance | None:
    """Return the covariance that follows from standard deviations, where a file states them."""
    if not found.sigmas:
        return None
    names = covariance_names(_with_lever_arms(found), found.cameras)
    variance = {
        name: float(sigma) ** 2
        for path, sigmas in found.sigmas.items()
        for name, sigma in zip(element_names(path, sigmas.shape), sigmas.ravel().tolist(), strict=True)
    }
    return Covariance(names=names, matrix=np.diag([variance.get(name, np.nan) for name in names]))


def in_common_frame(candidate: ComparisonCandidate) -> ComparisonCandidate:
    """Return the candidate in body frame "accel-x" and SI units; one without accelerometer stays in its own frame."""
    imus, matrix = candidate.imus, None if candidate.covariance is None else candidate.covariance.matrix
    if imus and all(imu.accelerometer is not None for imu in imus.values()):
        moved = moved_into_frame(imus, candidate.cameras, FRAME)
        matrix = None if matrix is None else moved.jacobian @ matrix @ moved.jacobian.T
        candidate = replace(candidate, imus=moved.imus, cameras=moved.cameras, frame=FRAME)
    factors = np.ones(len(covariance_names(candidate.imus, candidate.cameras)))
    turned: dict[str, ImuCalibration] = {}
    start = 0
    for name, imu in candidate.imus.items():
        turned[name], factor = _in_si(imu)
        factors[start : start + len(factor)] = factor
        start += len(factor)
    names = covariance_names(turned, candidate.cameras)
    covariance = None if matrix is None else Covariance(names=names, matrix=factors[:, None] * matrix * factors)
    return replace(candidate, imus=turned, covariance=covariance)


def _in_si(imu: ImuCalibration) -> tuple[ImuCalibration, Floats]:
    """Return the IMU for measurements in SI units, counts excepted, and the factor of each of its scalars."""
    factor: dict[str, float] = {}
    triads = {}
    for triad, (units, si) in _UNITS.items():
        sensor = getattr(imu, triad)
        if sensor is None:
            continue
        size = units.get(sensor.unit)
        for name in _SCALED if size else ():
            if hasattr(sensor, name):
                factor[f".{triad}.{name}"] = size or 1.0
                sensor = replace(sensor, **{name: (size or 1.0) * getattr(sensor, name)})
        triads[triad] = replace(sensor, unit=si) if size else sensor
    factors = [np.full(value.size, factor.get(path, 1.0)) for path, value in calibration_parameters({"": imu})]
    return replace(imu, **triads), frozen_array(np.concatenate(factors))


_SIGNIFICANT = 3.0  # sigmas
_CHIP_M = 0.01
_MATTERS_M = 1e-4
_OFF_P_STAR = 0.3
"""Share of a lever arm by which a model with one place may be off the p* of another recording or program,"""


_OFF_OWN = 0.01
"""and off that which its own estimate tells."""


def at_common_origins(candidates: Sequence[ComparisonCandidate]) -> list[ComparisonCandidate]:
    """Return the candidates, all in one body frame, with the origin of each IMU at one point as far as that is known.

    It is the p* of one with one place for all accelerometers, which cannot be moved; else of the first that states
    its own; else that of a motion alike about all axes.
    """
    origins = {name: _common(candidates, name) for one in candidates for name in one.imus}
    return [_at(one, origins) for one in candidates]


def _common(candidates: Sequence[ComparisonCandidate], imu: str) -> Origin:
    held = [one for one in candidates if imu in one.imus]
    weighed = sorted(
        (accelerometer_positions(one, imu) is not None, number)
        for number, one in enumerate(held)
        if (origin := one.imus[imu].origin) is not None and origin.weights is not None
    )
    if not weighed:
        return Origin(point="optimal")
    known = held[weighed[0][1]].imus[imu].origin
    assert known is not None
    return Origin(point="optimal", weights=known.weights)


def accelerometer_positions(one: ComparisonCandidate, imu: str) -> Floats | None:
    """Return where the accelerometers of an IMU sit, (3, 3) [m]; None where they are at one point."""
    sensor = one.imus[imu].accelerometer if imu in one.imus else None
    return None if sensor is None else sensor.lever_arms_m


def _at(one: ComparisonCandidate, origins: Mapping[str, Origin]) -> ComparisonCandidate:
    if all(accelerometer_positions(one, imu) is None for imu in one.imus):
        return one
    moved = moved_to_origin(one.imus, one.cameras, origins)
    covariance = one.covariance
    if covariance is not None:
        matrix = moved.jacobian @ covariance.matrix @ moved.jacobian.T
        covariance = Covariance(names=covariance.names, matrix=matrix)
    return replace(one, imus=moved.imus, cameras=moved.cameras, covariance=covariance)


def origin_findings(candidates: Sequence[ComparisonCandidate]) -> Iterator[Finding]:
    """Say whose translations are of points that are not quite the same, and by how much."""
    for imu in dict.fromkeys(name for one in candidates for name in one.imus):
        held = [one for one in candidates if imu in one.imus and (one.cameras or len(one.imus) > 1)]
        rest = [one for one in held if accelerometer_positions(one, imu) is None and not one.exact]
        having = {one.name: longest for one in held if (longest := _longest(one, imu)) > 0}
        if having and rest:
            most = max(having.values())
            share = _OFF_P_STAR if any(_weights(one, imu) is None for one in rest) else _OFF_OWN
            yield make_finding(
                "lever-arms-in-some",
                having=join_names(list(having)),
                imu=imu,
                rest=join_names([one.name for one in rest]),
                off_mm=1e3 * share * most,
            )
        for first, second in combinations(rest, 2):
            apart = _points_apart(first, second, imu)
            if apart > _MATTERS_M:
                yield make_finding("origins-differ", first=first.name, second=second.name, imu=imu, apart=apart)


def _longest(one: ComparisonCandidate, imu: str) -> float:
    """Return the longest lever arm that is there beyond its uncertainty [m]; zero where none is."""
    arms = accelerometer_positions(one, imu)
    if arms is None:
        return 0.0
    sigma = np.zeros(9)
    if one.covariance is not None:
        at = [one.covariance.names.index(name) for name in element_names(f"{imu}.accelerometer.lever_arms_m", (3, 3))]
        sigma = np.sqrt(np.diag(one.covariance.matrix)[at])
    proved = (np.abs(arms.ravel()) > _SIGNIFICANT * np.nan_to_num(sigma)).reshape(3, 3)
    return float(np.linalg.norm(arms * proved, axis=1).max())


def _points_apart(first: ComparisonCandidate, second: ComparisonCandidate, imu: str) -> float:
    """Return how far the points of two motions are apart, of accelerometers at random 10 mm from each other [m]."""
    weights = [_weights(one, imu) for one in (first, second)]
    if weights[0] is None or weights[1] is None:
        return 0.0
    return float(_CHIP_M * np.linalg.norm(weights[0] - weights[1]) / np.sqrt(3))


def _weights(one: ComparisonCandidate, imu: str) -> Floats | None:
    """Return what p* of an IMU is made of, where that is known."""
    origin = one.imus[imu].origin
    return None if origin is None else origin.weights
