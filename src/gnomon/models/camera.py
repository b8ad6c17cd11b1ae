"""Cameras as Kalibr combines them: a projection, a distortion of its plane, focal lengths and principal point.

    p_cam (x right, y down, z forward) -> m = projection(p_cam) -> d = distortion(m) -> u = fu dx + pu,  v = fv dy + pv

Pixel (0, 0) is the centre of the top-left pixel. The equations of distortions stand in `models.distortions`, those of
projections here.

Every projection of Kalibr divides by one number, m = (x, y) / D(x, y, z), and is symmetric about the optical axis. So D
and its derivatives say all about it; with r^2 = x^2 + y^2 and dD/dx = x E, dD/dy = y E, they are

    pinhole   D = z
    omni      D = xi rho + z,                    rho = sqrt(r^2 + z^2)
    eucm      D = alpha d + (1 - alpha) z,       d = sqrt(beta r^2 + z^2)
    ds        D = alpha d_2 + (1 - alpha) z_2,   z_2 = xi rho + z,   d_2 = sqrt(r^2 + z_2^2)

after Mei and Rives 2007 (omni; Geyer and Daniilidis 2000), Khomutenko et al. 2016 (eucm) and Usenko et al. 2018 (ds; it
states the others in the same letters). The domain of each is the cone about the optical axis in which m is one-to-one:

    pinhole   z > 0
    omni      z > -w rho,   w = xi if xi <= 1, else 1 / xi
    eucm      z > -w d,     w = alpha / (1 - alpha) if alpha <= 0.5, else (1 - alpha) / alpha
    ds        z_2 > -w d_2, w as for eucm

Up to the first bound (xi <= 1, alpha <= 0.5) the image of the cone is the whole plane; beyond it, a disk.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite, sqrt
from typing import Literal, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError
from ..frozen import value_class
from .distortions import DISTORTIONS, Bent
from .lens_names import LENSES, LINEAR, SHAPES, DistortionName, ProjectionName

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Shape = tuple[float, ...]
"""The parameters of a projection beside focal lengths and principal point."""
ParameterKind = Literal["projection", "focal", "principal", "distortion"]

_NEAREST_M, _FARTHEST_M = 1e-100, 1e100  # beyond them the squares would leave the range of floating point numbers
_NOMINAL_FOCAL = 0.785  # over the width: 65 degrees from left to right
_BLOCK = 8192  # points at a time: the intermediate arrays of a block stay in the cache


class Divisor(NamedTuple):
    """D at some points, and its derivatives; scalars where it does not depend on the point.

    Attributes
    ----------
    value : (k,) D [m]
    inside : (k,) whether the point is in the domain
    by_radius : (k,) E = dD/dx / x = dD/dy / y [1/m]
    by_z : (k,) dD/dz
    by_shape : one (k,) for each parameter of the shape; empty where not asked for
    """

    value: Floats
    inside: Booleans
    by_radius: Floats | float
    by_z: Floats | float
    by_shape: tuple[Floats, ...]


@value_class(eq=True)
class Projection:
    """One projection.

    Attributes
    ----------
    names : names of the shape parameters, in the order of Kalibr's intrinsics
    check : raises OptionError where the shape parameters make no sense
    divide : (shape, x, y, z, whether derivatives by the shape are wanted) -> Divisor
    lift : (shape, mx^2 + my^2) -> (k, z, whether there is such a ray), of the ray (k mx, k my, z) of any length
    """

    names: tuple[str, ...]
    check: Callable[[Shape], None]
    divide: Callable[[Shape, Floats, Floats, Floats, bool], Divisor]
    lift: Callable[[Shape, Floats], tuple[Floats, Floats, Booleans]]


def _demand(name: str, value: float, fits: bool, demand: str) -> None:
    if not fits:
        raise OptionError(f"{name} {value:g} is out of range: it must be {demand}.")


# Pinhole.


def _check_pinhole(shape: Shape) -> None:
    del shape


def _divide_pinhole(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    del shape, x, y, derive
    return Divisor(value=z, inside=z > 0, by_radius=0.0, by_z=1.0, by_shape=())


def _lift_pinhole(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    del shape
    one = np.ones_like(square)
    return one, one, np.isfinite(square)


# Omni: the unified model of Mei and Rives 2007.


def _check_omni(shape: Shape) -> None:
    _demand("xi", shape[0], shape[0] > -1, "greater than -1")


def _divide_omni(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    (xi,) = shape
    rho = np.sqrt(x * x + y * y + z * z)
    value = xi * rho + z
    slope = xi / rho
    inside = z > -(xi if xi <= 1 else 1 / xi) * rho
    return Divisor(value=value, inside=inside, by_radius=slope, by_z=1 + slope * z, by_shape=(rho,) if derive else ())


def _lift_omni(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    (xi,) = shape
    under = 1 + (1 - xi * xi) * square
    scale = (xi + np.sqrt(np.maximum(under, 0.0))) / (1 + square)
    return scale, scale - xi, under >= 0


# Extended unified camera model of Khomutenko, Garcia and Martinet 2016.


def _check_eucm(shape: Shape) -> None:
    _demand("alpha", shape[0], 0 <= shape[0] <= 1, "from 0 to 1")
    _demand("beta", shape[1], shape[1] > 0, "greater than zero")


def _reach(alpha: float) -> float:
    """Return w, where z > -w d is the domain of a projection with D = alpha d + (1 - alpha) z (Usenko et al.)."""
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha


def _excess(length: Floats, z: Floats, square: Floats) -> Floats:
    """Return length - z for length^2 = square + z^2, without cancellation near the optical axis."""
    size = np.abs(z)
    return square / (length + size) + (size - z)


def _divide_eucm(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    alpha, beta = shape
    square = x * x + y * y
    d = np.sqrt(beta * square + z * z)
    value = alpha * d + (1 - alpha) * z
    slope = alpha / d
    return Divisor(
        value=value,
        inside=z > -_reach(alpha) * d,
        by_radius=slope * beta,
        by_z=slope * z + (1 - alpha),
        by_shape=(_excess(d, z, beta * square), (0.5 * slope) * square) if derive else (),
    )


def _lift_eucm(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    alpha, beta = shape
    under = 1 - (2 * alpha - 1) * beta * square
    z = (1 - alpha * alpha * beta * square) / (alpha * np.sqrt(np.maximum(under, 0.0)) + (1 - alpha))
    return np.ones_like(square), z, under >= 0


# Double sphere camera model of Usenko, Demmel and Cremers 2018.


def _check_ds(shape: Shape) -> None:
    _demand("xi", shape[0], -1 < shape[0] <= 1, "greater than -1 and not greater than 1")
    _demand("alpha", shape[1], 0 <= shape[1] <= 1, "from 0 to 1")


def _least_cosine_ds(xi: float, alpha: float) -> float:
    """Return the cosine of the widest angle from the optical axis.

    It is where z_2 = -w d_2, solved for z / rho. Usenko et al. print -w_2 = -(w + xi) / sqrt(2 w xi + xi^2 + 1), which
    is the same for xi = 0 or alpha = 0.5 only, and lets points with D < 0 in for xi < 0 and small w.
    """
    w = _reach(alpha)
    rest = 1 - w * w
    return -xi * rest - w * sqrt(1 - xi * xi * rest)


def _divide_ds(shape: Shape, x: Floats, y: Floats, z: Floats, derive: bool) -> Divisor:
    xi, alpha = shape
    square = x * x + y * y
    d_1 = np.sqrt(square + z * z)
    z_2 = xi * d_1 + z
    d_2 = np.sqrt(square + z_2 * z_2)
    value = alpha * d_2 + (1 - alpha) * z_2
    by_z_2 = alpha * z_2 / d_2 + (1 - alpha)
    slope = xi / d_1
    return Divisor(
        value=value,
        inside=z > _least_cosine_ds(xi, alpha) * d_1,
        by_radius=alpha / d_2 + by_z_2 * slope,
        by_z=by_z_2 * (1 + slope * z),
        by_shape=(by_z_2 * d_1, _excess(d_2, z_2, square)) if derive else (),
    )


def _lift_ds(shape: Shape, square: Floats) -> tuple[Floats, Floats, Booleans]:
    xi, alpha = shape
    under = 1 - (2 * alpha - 1) * square
    z_2 = (1 - alpha * alpha * square) / (alpha * np.sqrt(np.maximum(under, 0.0)) + (1 - alpha))
    length = z_2 * z_2 + square
    on_first = z_2 * z_2 + (1 - xi * xi) * square
    scale = (z_2 * xi + np.sqrt(on_first)) / length
    return scale, scale * z_2 - xi, under >= 0


PROJECTIONS: Mapping[ProjectionName, Projection] = {
    "pinhole": Projection(names=SHAPES["pinhole"], check=_check_pinhole, divide=_divide_pinhole, lift=_lift_pinhole),
    "omni": Projection(names=SHAPES["omni"], check=_check_omni, divide=_divide_omni, lift=_lift_omni),
    "eucm": Projection(names=SHAPES["eucm"], check=_check_eucm, divide=_divide_eucm, lift=_lift_eucm),
    "ds": Projection(names=SHAPES["ds"], check=_check_ds, divide=_divide_ds, lift=_lift_ds),
}


@value_class
class Projected:
    """Image of points, and its derivatives.

    All arrays are views whose components are contiguous, such as pixels[:, 0] or by_point[:, i, j].

    Attributes
    ----------
    pixels : (n, 2) [px]; nan where not valid
    valid : (n,) whether the point is inside the model's domain (in front of the camera, ...)
    by_point : (n, 2, 3) derivative by the point [px/m], zero where not valid; None where not asked for
    by_parameters : (n, 2, q) derivative by `Camera.parameters`, zero where not valid; None where not asked for
    """

    pixels: Floats
    valid: Booleans
    by_point: Floats | None
    by_parameters: Floats | None


@value_class
class Camera:
    """A camera with its intrinsics.

    Attributes
    ----------
    projection : "pinhole", "omni", "eucm" or "ds"
    intrinsics : pinhole (fu fv pu pv), omni (xi fu fv pu pv), eucm (alpha beta fu fv pu pv), ds (xi alpha fu fv pu pv)
    distortion : "none", "radtan", "radtan5", "equidistant" or "fov"
    distortion_coeffs : none (), radtan (k1 k2 p1 p2), radtan5 (k1 k2 p1 p2 k3), equidistant (k1 k2 k3 k4), fov (w)
    resolution : (width, height) [px]
    line_delay_s : time from the exposure of one row to that of the next [s]; zero for a global shutter
    topic : ROS topic that Kalibr's files name, or ""
    distortion_limit : distance from the optical axis, in the plane of the projection, beyond which the distortion folds
        back and is not used; follows from the coefficients

    Raises
    ------
    OptionError
        If there is no such model, or its parameters are not of it.

    Examples
    --------
    >>> camera = Camera(
    ...     projection="pinhole", intrinsics=[460, 458, 320, 240], distortion="none", distortion_coeffs=[],
    ...     resolution=(640, 480),
    ... )
    >>> camera.project(np.array([[0.1, 0.0, 1.0]])).pixels
    array([[366., 240.]])
    """

    projection: ProjectionName
    intrinsics: Floats
    distortion: DistortionName
    distortion_coeffs: Floats
    resolution: tuple[int, int]
    line_delay_s: float = 0.0
    topic: str = ""
    distortion_limit: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _check_name("projection", self.projection, get_args(ProjectionName))
        _check_name("distortion", self.distortion, get_args(DistortionName))
        projection, distortion = PROJECTIONS[self.projection], DISTORTIONS[self.distortion]
        intrinsics = _numbers(self.projection, "intrinsics", self.intrinsics, (*projection.names, *LINEAR))
        coeffs = _numbers(self.distortion, "distortion_coeffs", self.distortion_coeffs, distortion.names)
        for name, focal in zip(LINEAR, intrinsics[-4:-2], strict=False):
            if not focal > 0:
                raise OptionError(f"focal length {name} {focal:g} must be greater than zero.")
        projection.check(tuple(intrinsics[:-4]))
        distortion.check(coeffs)
        if not isfinite(self.line_delay_s):
            raise OptionError(f"line_delay_s {self.line_delay_s:g} must be a finite number of seconds.")
        object.__setattr__(self, "intrinsics", intrinsics)
        object.__setattr__(self, "distortion_coeffs", coeffs)
        object.__setattr__(self, "resolution", _resolution(self.resolution))
        object.__setattr__(self, "distortion_limit", distortion.limit(coeffs))

    @classmethod
    def nominal(cls, resolution: tuple[int, int], topic: str = "") -> Self:
        """Return a lens that stands in where none is known: a pinhole 65 degrees wide, centred in the image."""
        width, height = _resolution(resolution)
        focal = _NOMINAL_FOCAL * width
        middle = ((width - 1) / 2, (height - 1) / 2)
        return cls(
            projection="pinhole",
            intrinsics=np.array([focal, focal, *middle]),
            distortion="none",
            distortion_coeffs=np.empty(0),
            resolution=(width, height),
            topic=topic,
        )

    def with_k3(self) -> Self:
        """Return the same lens with k3 = 0 as a further parameter where it is radtan; any other as it is."""
        if self.distortion != "radtan":
            return self
        return replace(self, distortion="radtan5", distortion_coeffs=np.append(self.distortion_coeffs, 0.0))

    @property
    def model(self) -> str:
        """Both names in one, such as "pinhole-radtan"."""
        return f"{self.projection}-{self.distortion}"

    @property
    def parameters(self) -> Floats:
        """The intrinsics, then the distortion coefficients, (q,)."""
        return np.concatenate([self.intrinsics, self.distortion_coeffs])

    def packed(self) -> Floats:
        """Return all that an image depends on, in the order of Lens in kernel.c."""
        models = get_args(ProjectionName).index(self.projection), get_args(DistortionName).index(self.distortion)
        shape, linear = self.intrinsics[:-4], self.intrinsics[-4:]
        parts = (*models, self.distortion_limit), np.pad(shape, (0, 2 - len(shape))), linear, self.distortion_coeffs
        return np.concatenate([*parts, np.zeros(5 - len(self.distortion_coeffs))])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Where each parameter stands, such as "intrinsics[0]", (q,)."""
        return tuple(
            f"{name}[{k}]" for name in ("intrinsics", "distortion_coeffs") for k in range(len(getattr(self, name)))
        )

    @property
    def parameter_symbols(self) -> tuple[str, ...]:
        """How each parameter is called, such as "fu", (q,)."""
        return (*PROJECTIONS[self.projection].names, *LINEAR, *DISTORTIONS[self.distortion].names)

    @property
    def parameter_kinds(self) -> tuple[ParameterKind, ...]:
        """What each parameter does: the shape of the projection, focal length, principal point or distortion, (q,)."""
        shape: tuple[ParameterKind, ...] = ("projection",) * len(PROJECTIONS[self.projection].names)
        bending: tuple[ParameterKind, ...] = ("distortion",) * len(self.distortion_coeffs)
        return (*shape, "focal", "focal", "principal", "principal", *bending)

    def with_parameters(self, vector: ArrayLike) -> Self:
        """Return the camera with other intrinsics and distortion coefficients (q,), in the order of `parameters`.

        Raises
        ------
        OptionError
            If they are not of the model: as for the constructor.
        """
        values = _numbers(self.model, "parameters", vector, self.parameter_symbols)
        split = len(self.intrinsics)
        return replace(self, intrinsics=values[:split], distortion_coeffs=values[split:])

    def project(self, points: Floats, *, parameters_jacobian: bool = False, point_jacobian: bool = True) -> Projected:
        """Return where points (n, 3) [m] in the camera's frame are seen.

        Points outside the model's domain (behind the camera, beyond the cone in which its projection is one-to-one, or
        beyond `distortion_limit`) have no pixel and no derivatives. Whether a pixel is inside the image is not asked.

        Raises
        ------
        OptionError
            If the points are not (n, 3).
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise OptionError(f"points must be (n, 3); found {points.shape}.")
        n = len(points)
        image = _Image(
            pixels=np.empty((2, n)),
            valid=np.empty(n, dtype=np.bool_),
            by_point=np.empty((2, 3, n)) if point_jacobian else None,
            by_parameters=np.zeros((2, len(self.parameters), n)) if parameters_jacobian else None,
        )
        with np.errstate(all="ignore"):  # points outside the domain may overflow; they are blanked afterwards
            for start in range(0, n, _BLOCK):
                self._project_block(points[start : start + _BLOCK], slice(start, start + _BLOCK), image)
        image.blank_invalid()
        return image.projected()

    def _project_block(self, points: Floats, block: slice, image: "_Image") -> None:
        fu, fv, pu, pv = (float(value) for value in self.intrinsics[-4:])
        derive = image.by_parameters is not None
        shape = tuple(float(value) for value in self.intrinsics[:-4])
        x, y, z = (np.ascontiguousarray(points[:, axis]) for axis in range(3))
        divisor = PROJECTIONS[self.projection].divide(shape, x, y, z, derive)
        inverse = 1 / divisor.value
        mx, my = x * inverse, y * inverse
        s = mx * mx + my * my
        bent = DISTORTIONS[self.distortion].bend(self.distortion_coeffs, mx, my, s, derive)
        in_range = (divisor.value > _NEAREST_M) & (divisor.value < _FARTHEST_M)
        image.valid[block] = divisor.inside & in_range & (s < self.distortion_limit * self.distortion_limit)
        image.pixels[0, block] = fu * bent.x + pu
        image.pixels[1, block] = fv * bent.y + pv
        if image.by_parameters is not None:
            _plane_jacobian(image.by_parameters[:, len(shape) :, block], bent, (fu, fv))
        elif image.by_point is None:
            return
        for row, by_mx, by_my in ((0, fu * bent.xx, fu * bent.xy), (1, fv * bent.xy, fv * bent.yy)):
            by_x, by_y = by_mx * inverse, by_my * inverse  # with D held fast
            shrink = by_x * mx + by_y * my  # minus the derivative by D: m = (x, y) / D
            if image.by_point is not None:
                out, towards_axis = image.by_point[row, :, block], shrink * divisor.by_radius
                np.subtract(by_x, towards_axis * x, out=out[0])
                np.subtract(by_y, towards_axis * y, out=out[1])
                np.multiply(-shrink, divisor.by_z, out=out[2])
            if image.by_parameters is not None:
                for k, by_shape in enumerate(divisor.by_shape):
                    np.multiply(-shrink, by_shape, out=image.by_parameters[row, k, block])

    def unproject(self, pixels: Floats) -> tuple[Floats, Booleans]:
        """Return the rays that are seen at pixels (n, 2) [px].

        Returns
        -------
        rays : (n, 3) unit vectors in the camera's frame; nan where not valid
        valid : (n,) whether the model has a ray for the pixel

        Raises
        ------
        OptionError
            If the pixels are not (n, 2).
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        if pixels.ndim != 2 or pixels.shape[1] != 2:
            raise OptionError(f"pixels must be (n, 2); found {pixels.shape}.")
        fu, fv, pu, pv = self.intrinsics[-4:]
        projection, distortion = PROJECTIONS[self.projection], DISTORTIONS[self.distortion]
        with np.errstate(all="ignore"):
            dx, dy = (pixels[:, 0] - pu) / fu, (pixels[:, 1] - pv) / fv
            mx, my, straight = distortion.straighten(self.distortion_coeffs, self.distortion_limit, dx, dy)
            scale, z, lifted = projection.lift(tuple(self.intrinsics[:-4]), mx * mx + my * my)
            rays = np.stack([scale * mx, scale * my, z], axis=1)
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        valid = straight & lifted & np.isfinite(rays).all(axis=1)
        rays[~valid] = np.nan
        return rays, valid


@dataclass(slots=True, kw_only=True)
class _Image:
    """The arrays of `Projected` while they are filled, components first."""

    pixels: Floats
    valid: Booleans
    by_point: Floats | None
    by_parameters: Floats | None

    def blank_invalid(self) -> None:
        if self.valid.all():
            return
        invalid = ~self.valid
        self.pixels[:, invalid] = np.nan
        for jacobian in (self.by_point, self.by_parameters):
            if jacobian is not None:
                jacobian[:, :, invalid] = 0.0

    def projected(self) -> Projected:
        return Projected(
            pixels=self.pixels.T,
            valid=self.valid,
            by_point=None if self.by_point is None else self.by_point.transpose(2, 0, 1),
            by_parameters=None if self.by_parameters is None else self.by_parameters.transpose(2, 0, 1),
        )


def _plane_jacobian(out: Floats, bent: Bent, focal: tuple[float, float]) -> None:
    """Write the derivatives by fu, fv, pu, pv and the distortion's coefficients into out (2, 4 + c, k), zero so far."""
    out[0, 0], out[1, 1] = bent.x, bent.y
    out[0, 2] = out[1, 3] = 1.0
    for k, pair in enumerate(bent.by_coeffs, start=4):
        for row in range(2):
            np.multiply(focal[row], pair[row], out=out[row, k])


def _check_name(what: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        raise OptionError(f"there is no {what} {name!r}; it must be one of {', '.join(names)}.")


def _numbers(model: str, what: str, values: ArrayLike, names: tuple[str, ...]) -> Floats:
    """Return the values as a read-only array, one for each name."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{what} of {model} must be numbers; found {values!r}.") from None
    if array.size == 0:
        array = array.reshape(0)
    if array.shape != (len(names),):
        letters = f" ({' '.join(names)})" if names else ""
        raise OptionError(f"{model} takes {len(names)} {what}{letters}; found {array.size}.")
    for name, value in zip(names, array, strict=True):
        if not isfinite(value):
            raise OptionError(f"{name} of {model} is {value:g}; it must be a finite number.")
    array.flags.writeable = False
    return array


def _resolution(values: tuple[int, int]) -> tuple[int, int]:
    sides = tuple(values)
    if len(sides) != 2 or not all(float(side).is_integer() and side > 0 for side in sides):
        raise OptionError(f"resolution must be width and height, whole numbers above zero; found {list(sides)}.")
    return int(sides[0]), int(sides[1])


def knows_lens(name: str, camera: Camera) -> bool:
    """Return whether a program knows the model of a lens."""
    if name == "basalt" and camera.projection == "omni" and float(camera.intrinsics[0]) < 0:
        return False  # its ucm has alpha = xi / (1 + xi) of 0 to 1
    return camera.distortion in LENSES[name].get(camera.projection, ())
