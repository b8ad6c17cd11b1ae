"""Calibrations of one rig side by side: differences in their sigmas, scatter against predicted sigmas, who stands out.

A pair differs in a scalar by d with the variance v1 + v2 (less what both share by the same assumed gravity); where one
calibration states no sigmas, v is the other's alone. Over all calibrations the scatter s^2 of a scalar is held against
the mean v of the variances; the square root of the mean of s^2 / v is the z rms, 1 for honest sigmas.
"""

from collections.abc import Sequence
from dataclasses import field
from math import degrees, nan
from statistics import NormalDist

import numpy as np

from ...findings import Finding, join_names
from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec, rotvec_from_rotation, skew
from ...models.camera import Camera
from ...recording import Floats, Source, frozen_array
from ...results.calibration import Provenance
from ...results.trust import Verdict
from .quantities import Kind

_COLUMNS, _ROWS = 24, 18
_STEPS = 4
_LEAST_SHARE = 0.2
_SAME_PX = 1e-9


@value_class
class LensDifference:
    """How far the images of one ray lie apart, over the image that two models share.

    Attributes
    ----------
    camera, first, second : names of the camera and of the calibrations
    models : both models, such as ("pinhole-radtan", "ds-none")
    rms_px, largest_px : distance of the two images [px]
    turned_rms_px : the same after the one camera was turned as fits best: a turn is no error of the lens, since the
        pose takes it up
    turn : (3,) that turn, about the camera's x, y, z [rad]
    share : part of the image that both models see, 0 to 1
    resolutions : [px] of both
    """

    camera: str
    first: str
    second: str
    models: tuple[str, str]
    rms_px: float
    largest_px: float
    turned_rms_px: float
    turn: Floats
    share: float
    resolutions: tuple[tuple[int, int], tuple[int, int]]

    @property
    def same(self) -> bool:
        """Whether both are the same lens."""
        return self.largest_px <= _SAME_PX


def lens_difference(camera: str, first: tuple[str, Camera], second: tuple[str, Camera]) -> LensDifference | None:
    """Return how two models of one camera differ; None where they see hardly anything in common.

    Parameters
    ----------
    camera : its name
    first, second : name of each calibration, and its lens
    """
    one, other = first[1], second[1]
    if one.model == other.model and np.array_equal(one.parameters, other.parameters):
        return _same(camera, first, second)
    width, height = (min(sides) for sides in zip(one.resolution, other.resolution, strict=True))
    x, y = (np.linspace(0, side - 1, count) for side, count in ((width, _COLUMNS), (height, _ROWS)))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays, seen = one.unproject(pixels)
    image = other.project(np.where(seen[:, None], rays, [0.0, 0.0, -1.0]))
    both = seen & image.valid
    if np.mean(both) < _LEAST_SHARE:
        return None
    rays, pixels = rays[both], pixels[both]
    apart = np.linalg.norm(image.pixels[both] - pixels, axis=1)
    turn, turned = _best_turn(other, rays, pixels)
    return LensDifference(
        camera=camera,
        first=first[0],
        second=second[0],
        models=(one.model, other.model),
        rms_px=float(np.sqrt(np.mean(apart**2))),
        largest_px=float(apart.max()),
        turned_rms_px=min(turned, float(np.sqrt(np.mean(apart**2)))),
        turn=frozen_array(turn),
        share=float(np.mean(both)),
        resolutions=(one.resolution, other.resolution),
    )


def _same(camera: str, first: tuple[str, Camera], second: tuple[str, Camera]) -> LensDifference:
    """Return what is to be said of one and the same lens."""
    return LensDifference(
        camera=camera,
        first=first[0],
        second=second[0],
        models=(first[1].model, second[1].model),
        rms_px=0.0,
        largest_px=0.0,
        turned_rms_px=0.0,
        turn=frozen_array(np.zeros(3)),
        share=1.0,
        resolutions=(first[1].resolution, second[1].resolution),
    )


def _best_turn(lens: Camera, rays: Floats, pixels: Floats) -> tuple[Floats, float]:
    """Return the rotation vector by which rays (n, 3) are turned so that the lens sees them at pixels, and the rms."""
    turn = np.eye(3)
    rms = np.inf
    for _ in range(_STEPS):
        turned = rays @ turn.T
        image = lens.project(turned)
        good = image.valid
        assert image.by_point is not None
        residual = (pixels - image.pixels)[good]
        rms = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
        slopes = -image.by_point[good] @ skew(turned[good])
        step, *_ = np.linalg.lstsq(slopes.reshape(-1, 3), residual.ravel(), rcond=None)
        turn = rotation_from_rotvec(frozen_array(step)) @ turn
    return rotvec_from_rotation(turn), rms


ERROR_RATE = 0.01
"""Share of comparisons of honest calibrations that one limit refuses."""

UNJUDGED: tuple[Kind, ...] = ("bias",)
"""Kinds that may change from recording to recording, so that a difference is no error."""


@value_class(eq=True)
class ComparedCalibration:
    """One of the calibrations, for tables.

    Attributes
    ----------
    name, format, frame : as in `candidates.ComparisonCandidate`
    gravity : what it took for gravity, or ""
    sigmas : whether it states standard deviations
    exact : whether it is the truth of a simulation
    inputs : recording that it was made from
    verdict : its own, or ""
    sensors : IMUs and cameras, such as ("imu0", "cam0")
    notes : what was taken for what its files do not say
    one_occasion : whether it is of one recording and others are of others, so that its sigmas were widened by what the
        sensor itself changes from recording to recording, as is usual
    """

    name: str
    format: str
    frame: str
    gravity: str
    sigmas: bool
    exact: bool
    inputs: tuple[Source, ...]
    verdict: str
    sensors: tuple[str, ...]
    notes: tuple[str, ...]
    one_occasion: bool = False

    @property
    def stated_sigmas(self) -> str:
        """Whether its standard deviations are "exact", "stated", or "not stated"."""
        return "exact" if self.exact else "stated" if self.sigmas else "not stated"


@value_class
class Difference:
    """Two calibrations on one block.

    Attributes
    ----------
    first, second, path : names of the calibrations, and of the block
    values : (k,) first minus second, of a rotation the rotation vector about the body's axes of the second
    sigmas : (k,) standard deviation of the difference; nan where neither states one
    basis : names of the calibrations whose sigmas they are: of both, or of the one that states them; where neither
        does, of the others that do, whose mean variance is then the yardstick for the difference; empty without any
    z : (k,) difference in sigmas; nan where no sigma is known
    largest : largest |z|; nan where none is known
    """

    first: str
    second: str
    path: str
    values: Floats
    sigmas: Floats
    basis: tuple[str, ...]
    z: Floats = field(init=False)
    largest: float = field(init=False)

    def __post_init__(self) -> None:
        known = (self.sigmas > 0) & np.isfinite(self.sigmas)
        z = np.full(len(self.values), nan)
        z[known] = self.values[known] / self.sigmas[known]
        object.__setattr__(self, "z", frozen_array(z))
        object.__setattr__(self, "largest", float(np.abs(z[known]).max()) if known.any() else nan)

    @property
    def mutual(self) -> bool:
        """Whether the sigmas of both are known."""
        return set(self.basis) == {self.first, self.second}


@value_class
class Repeatability:
    """All calibrations on one block, as in tables B.3 to B.9 of Krebs.

    Attributes
    ----------
    path, kind, elements, unit : as in `quantities.ComparedQuantity`
    names : (m,) of the calibrations that estimated it, at least one
    values : (m, k); of a rotation small rotations about the body's axes against `reference`
    sigmas : (m, k) as stated; nan where they are not
    reference : (3, 3) mean rotation, or None
    mean : (k,)
    scatter : (k,) standard deviation over the calibrations; nan for one
    predicted : (k,) root mean square of the stated sigmas; nan where there are none
    z_rms : of the block, 1 for honest sigmas; nan where none are stated
    limit : which honest sigmas exceed in one of a hundred comparisons
    assumed : names of calibrations that held it at an ideal or a given value, and are not among `names`
    judged : whether it counts towards the verdict
    """

    path: str
    kind: Kind
    elements: tuple[str, ...]
    unit: str
    names: tuple[str, ...]
    values: Floats
    sigmas: Floats
    reference: Floats | None
    mean: Floats
    scatter: Floats
    predicted: Floats
    z_rms: float
    limit: float
    assumed: tuple[str, ...]
    judged: bool


@value_class
class Comparison:
    """What calibrations of one rig have in common, and where they differ.

    Attributes
    ----------
    calibrations : in the order given
    frame : body frame in which they were compared
    blocks : what at least two of them state and one estimated, in the order of a calibration file
    differences : of every pair on every block
    lenses : cameras of every pair, compared by their images
    z_rms, limit : pooled over all that is judged; what honest sigmas exceed in one of a hundred comparisons
    z_limit : |z| that the largest of all honest differences exceeds in one of a hundred comparisons
    compared : number of differences of scalars that were judged
    outside : names of calibrations that stand out, the farthest first
    findings : what was noticed, worst first
    verdict : "pass": they agree; "warn": with reservations; "fail": they differ by more than the sigmas of both allow
    headline : the result in a sentence
    provenance : what was stated for a certificate, and the files compared
    """

    calibrations: tuple[ComparedCalibration, ...]
    frame: str
    blocks: tuple[Repeatability, ...]
    differences: tuple[Difference, ...]
    lenses: tuple[LensDifference, ...]
    z_rms: float
    limit: float
    z_limit: float
    compared: int
    outside: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    verdict: Verdict = "pass"
    headline: str = ""
    provenance: Provenance = field(default_factory=lambda: Provenance(method="compare"))

    def difference(self, first: str, second: str, path: str) -> Difference:
        """Return how two calibrations differ on a block.

        Raises
        ------
        KeyError
            If they were not compared on it.
        """
        for found in self.differences:
            if (found.first, found.second, found.path) == (first, second, path):
                return found
        raise KeyError(f"{first} and {second} were not compared on {path}.")

    def block(self, path: str) -> Repeatability:
        """Return all calibrations on a block.

        Raises
        ------
        KeyError
            If there is no such block.
        """
        for found in self.blocks:
            if found.path == path:
                return found
        raise KeyError(f"{path} was not compared. There are: {', '.join(block.path for block in self.blocks)}.")


@value_class
class Scatter:
    """Scalars of several calibrations, for what is pooled over all of them.

    Attributes
    ----------
    values : (m, n) by calibration and scalar; nan where a calibration has none
    covariances : (m, n, n); zero where nothing is stated
    """

    values: Floats
    covariances: Floats

    def of(self, columns: Sequence[int]) -> "Scatter":
        """Return only some of the scalars."""
        index = np.array(columns, dtype=int)
        return Scatter(values=self.values[:, index], covariances=self.covariances[:, index[:, None], index])

    def z_rms(self) -> tuple[float, float]:
        """Return the pooled z rms and its limit; nan where no scalar has two values and a sigma.

        The mean of s^2 / v is a quadratic form in normal deviates with mean 1; its variance follows from the
        covariances, and with it that of a chi^2 of as many degrees of freedom.
        """
        there = np.isfinite(self.values)
        count = there.sum(axis=0)
        variance = np.einsum("mnn->mn", self.covariances)
        with np.errstate(divide="ignore", invalid="ignore"):
            predicted = np.where(there, variance, 0.0).sum(axis=0) / count
        used = (count > 1) & (predicted > 0)
        if not used.any():
            return nan, nan
        there, count, predicted = there[:, used], count[used], predicted[used]
        values = np.where(there, self.values[:, used], 0.0)
        deviations = np.where(there, values - values.sum(axis=0) / count, 0.0)
        weight = 1 / ((count - 1) * predicted * len(count))
        share = float(np.sum(weight * deviations**2))
        covariances = self.covariances[:, used][:, :, used]
        spread = 0.0
        for i, j in np.ndindex(len(values), len(values)):
            centred = weight * there[i] * there[j] * ((i == j) - 1 / count)
            spread += 2 * float(centred @ (covariances[i] * covariances[j]) @ centred)
        return float(np.sqrt(share)), z_rms_limit(max(2 / spread, 1.0))


def z_rms_limit(freedom: float) -> float:
    """Return the z rms that honest sigmas exceed in one of a hundred cases (Wilson and Hilferty's approximation).

    Examples
    --------
    >>> round(z_rms_limit(10.0) ** 2 * 10, 1)  # the table says 23.2
    23.2
    """
    deviate = NormalDist().inv_cdf(1 - ERROR_RATE)
    step = 2 / (9 * freedom)
    return float((1 - step + deviate * step**0.5) ** 1.5)


def largest_z_limit(comparisons: int) -> float:
    """Return the |z| that the largest of so many honest ones exceeds in one of a hundred cases.

    Examples
    --------
    >>> round(largest_z_limit(1), 2), round(largest_z_limit(50), 2)
    (2.58, 3.72)
    """
    each = (1 - ERROR_RATE) ** (1 / max(comparisons, 1))
    return NormalDist().inv_cdf((1 + each) / 2)


def standing_out(names: Sequence[str], conflicts: Sequence[tuple[str, str, float]]) -> tuple[str, ...]:
    """Return those that contradict at least two of the others, who agree among themselves; the worst first.

    Parameters
    ----------
    names : of all that were compared
    conflicts : pairs that contradict each other, and how much

    Examples
    --------
    >>> standing_out("ABC", [("A", "B", 5.2), ("A", "C", 4.8)]), standing_out("ABC", [("A", "B", 5.2)])
    (('A',), ())
    """
    left, still = set(names), list(conflicts)
    removed: list[str] = []
    while still:
        weight: dict[str, tuple[int, float]] = dict.fromkeys(left, (0, 0.0))
        for first, second, size in still:
            for name in (first, second):
                weight[name] = weight[name][0] + 1, weight[name][1] + size
        worst = max(sorted(left), key=lambda name: weight[name])
        removed.append(worst)
        left.remove(worst)
        still = [item for item in still if worst not in item[:2]]
    against = {name: sum(name in item[:2] and bool(left & {*item[:2]}) for item in conflicts) for name in removed}
    return tuple(name for name in removed if against[name] > 1)


_DEG = degrees(1.0)


_NAMES = {
    "scale": "scale",
    "misalignment": "misalignment",
    "bias": "bias",
    "g_sensitivity": "g-sensitivity",
    "translation": "translation",
    "rotation": "rotation",
    "time_shift": "time shift",
    "line_delay": "line delay",
    "lens": "lens",
    "lever_arms": "lever arms",
}


_SHOWN = {
    "rotation": (_DEG, "deg"),
    "translation": (1e3, "mm"),
    "lever arms": (1e3, "mm"),
    "time shift": (1e3, "ms"),
    "line delay": (1e6, "us"),
    "misalignment": (1e3, "mrad"),
}


_PIXELS = frozenset({"fu", "fv", "pu", "pv"})
_TRIADS = ("accelerometer", "gyroscope", "magnetometer")
_VECTORS = ("rotation", "translation")


def block_words(path: str) -> str:
    """Return what a block is called in a sentence.

    Examples
    --------
    >>> block_words("cam0.time_shift"), block_words("imu0.gyroscope.rotation"), block_words("imu1.gyroscope.bias")
    ('time shift of cam0', 'rotation from body to gyroscope', 'bias of the gyroscope of imu1')
    >>> block_words("cam1.cam0.rotation")
    'rotation of cam1 against cam0'
    """
    sensor, *middle, name = path.split(".")
    if middle and middle[0] not in _TRIADS:
        return f"{_NAMES.get(name, name)} of {sensor} against {middle[0]}"
    of_imu = "" if sensor == "imu0" else f" of {sensor}"
    if not middle:
        return f"{_NAMES.get(name, name)} of {sensor}"
    if name == "rotation":
        return f"rotation from body to {middle[0]}{of_imu}"
    return f"{_NAMES.get(name, name)} of the {middle[0]}{of_imu}"


def shown_unit(kind: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a block is shown."""
    if kind in _SHOWN:
        return _SHOWN[kind]
    if kind == "scale":
        return (100.0, "%") if unit == "1" else (1.0, unit)
    if kind == "g-sensitivity" and unit.startswith("(rad/s)"):
        return 1e3, "mrad/s/(m/s^2)"
    if kind == "bias" and unit == "rad/s":
        return _DEG, "deg/s"
    return 1.0, unit


def typical_size(block: Repeatability, values: Floats) -> tuple[float, str]:
    """Return the root mean square of a block's scalars, nan where none is known, and its unit; of a lens those in px.

    Parameters
    ----------
    values : (k,) in the block's unit
    """
    factor, unit = shown_unit(block.kind, block.unit)
    if block.kind == "lens":
        values, unit = values[[element in _PIXELS for element in block.elements]], "px"
    known = values[np.isfinite(values)]
    return (factor * float(np.sqrt(np.mean(known**2))) if known.size else np.nan), unit


def size_text(block: Repeatability, values: Floats, z: Floats) -> str:
    """Return how large a difference is: of a vector its length, else that of the scalar that differs most.

    Parameters
    ----------
    values : (k,) difference in the block's unit
    z : (k,) in sigmas; nan where not known
    """
    factor, unit = shown_unit(block.kind, block.unit)
    if block.kind in _VECTORS:
        return f"{np.linalg.norm(values) * factor:.2g} {unit}"
    size = np.where(np.isfinite(z), np.abs(z), 0.0) if np.isfinite(z).any() else np.abs(values)
    k = int(np.argmax(size))
    element = block.elements[k]
    where = f" ({element})" if element else ""
    if block.kind == "lens" and element in _PIXELS:
        unit = "px"
    return f"{abs(float(values[k])) * factor:.2g} {unit}".rstrip() + where


def sigma_text(difference: Difference) -> str:
    """Return how many sigmas a difference is at most, and whose; "" where none are known."""
    if not np.isfinite(difference.largest):
        return ""
    whose = "" if difference.mutual else f" of {join_names(difference.basis)} alone"
    return f"{difference.largest:.1f} sigma{whose}"
