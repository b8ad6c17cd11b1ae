"""What scenarios of cameras have in common: the board, the lens, and how images of it are rendered. Needs no NumPy.

What to simulate of cameras before a board, without an IMU; it is also the simulated recording's scenario file.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

from ...errors import OptionError
from ...models.lens_names import COEFFICIENTS, LINEAR, SHAPES, DistortionName, ProjectionName
from ...options import check_ranges

if TYPE_CHECKING:
    from ...models.target import Target


BoardName = Literal["aprilgrid", "checkerboard", "circlegrid", "charuco"]

INTRINSICS = {name: len((*shape, *LINEAR)) for name, shape in SHAPES.items()}
DISTORTION_COEFFS = {name: len(coefficients) for name, coefficients in COEFFICIENTS.items()}
"""How many numbers each lens model has."""


@dataclass(frozen=True, kw_only=True)
class SeenBoard:
    """A board, as it is stated and as it truly is."""

    target_type: BoardName = "aprilgrid"
    """Kind of board. Of an AprilGrid and of a ChArUco board every corner in the image is detected, of other boards all
    corners or none."""

    target_cols: int = 6
    """Tags of an AprilGrid, inner corners of a checkerboard, circles, or squares of a ChArUco board in a row."""

    target_rows: int = 6
    """Rows of them."""

    target_size_m: float = 0.088
    """Side of a tag, of a square, or distance of two circles, in metres."""

    target_spacing: float = 0.3
    """Gap between the tags of an AprilGrid, as a fraction of a tag's side."""

    target_asymmetric: bool = False
    """Whether every other row of a circle grid is shifted."""

    marker_share: float = 0.75
    """Side of the marker of a ChArUco board, as a fraction of the square's."""

    dictionary: str = "4X4_50"
    """Markers of a ChArUco board, as OpenCV calls them."""

    target_scale: float = 1.0
    """How much larger the true board is than the board that goes with the recording."""

    corner_offset_m: float = 0.0
    """Standard deviation of the places of the board's corners, each axis, in metres: a bad print, or a detector's bias.
    The board as a whole is neither shifted, nor turned, nor larger for it."""

    def stated_board(self) -> "Target":
        """Return the board that goes with the recording; the true one is `target_scale` times as large."""
        from ...models.target import Target

        cols, rows, size = self.target_cols, self.target_rows, self.target_size_m
        if self.target_type == "aprilgrid":
            return Target.aprilgrid(tag_cols=cols, tag_rows=rows, tag_size_m=size, tag_spacing=self.target_spacing)
        if self.target_type == "checkerboard":
            return Target.checkerboard(cols=cols, rows=rows, row_spacing_m=size, col_spacing_m=size)
        if self.target_type == "charuco":
            marker = self.marker_share * size
            return Target.charuco(
                cols=cols, rows=rows, square_size_m=size, marker_size_m=marker, dictionary=self.dictionary
            )
        return Target.circlegrid(cols=cols, rows=rows, spacing_m=size, asymmetric=self.target_asymmetric)


@dataclass(frozen=True, kw_only=True)
class RenderedImages:
    """How images of a board are rendered."""

    images: bool = False
    """Render images in place of detected corners, whose errors (pixel_noise_px, outliers, ...) then do not apply: those
    of the detector come in their place."""

    blur_px: float = 0.6
    """Standard deviation of the blur of lens and focus in the images, in px."""

    defocus_px: float = 0.0
    """Radius of the disc as which a point out of focus is seen in the images, in px; with focus_m of one far away."""

    focus_m: float | None = None
    """Distance that is in focus, in metres: the board is the less sharp the farther it is from there, its disc being
    defocus_px |1 - focus_m / distance|. Without it all distances are alike."""

    image_noise: float = 2.0
    """Standard deviation of the noise in the images that does not depend on the light, in grey levels."""

    shot_noise: float = 0.0
    """Variance of the noise that does, over the grey level."""

    vignetting: float = 0.25
    """Fraction of the light that is lost in the corners of the images."""

    image_clutter: bool = False
    """Whether the images have a wall full of edges and foreign AprilTags behind the board, or even grey."""

    covers: int = 0
    """Hands and cables that move before the board in the images."""


@dataclass(frozen=True, kw_only=True)
class TrueLens:
    """The lens of a camera as it truly is."""

    projection: ProjectionName = "pinhole"
    """Projection of the lens, as Kalibr names it."""

    intrinsics: tuple[float, ...] = (460.0, 458.5, 322.4, 237.1)
    """True intrinsics of cam0 in Kalibr's order; of a pinhole fu fv pu pv."""

    distortion: DistortionName = "radtan"
    """Distortion of the lens, as Kalibr names it; radtan5 is radtan with k3, k1 k2 p1 p2 k3."""

    distortion_coeffs: tuple[float, ...] = (-0.28, 0.075, 0.0002, -0.00015)
    """True coefficients of the distortion."""

    resolution: tuple[int, int] = (640, 480)
    """Width and height of the images in px."""

    def with_usual_lens(
        self, projection: ProjectionName | None = None, distortion: DistortionName | None = None
    ) -> Self:
        """Return the same with a usual lens of another model, see `USUAL_LENSES`; of others without coefficients."""
        projection = projection or self.projection
        if distortion is None:
            distortion = self.distortion if f"{projection}-{self.distortion}" in USUAL_LENSES else "none"
        if (projection, distortion) == (self.projection, self.distortion):
            return self
        usual = USUAL_LENSES.get(f"{projection}-{distortion}")
        intrinsics, coeffs = usual or (self.intrinsics, ())
        model: dict[str, Any] = {"projection": projection, "distortion": distortion}
        size = (752, 480) if usual else self.resolution
        return replace(self, **model, intrinsics=intrinsics, distortion_coeffs=coeffs, resolution=size)

    def check_lens(self) -> None:
        """Check that a lens has as many numbers as its model.

        Raises
        ------
        OptionError
            If it has not, or there is no image.
        """
        for name, model, count in (
            ("intrinsics", self.projection, INTRINSICS[self.projection]),
            ("distortion_coeffs", self.distortion, DISTORTION_COEFFS[self.distortion]),
        ):
            values = getattr(self, name)
            if len(values) != count:
                raise OptionError(f"{name}: {model} has {count} of them, found {len(values)}.")
        if min(self.resolution) < 2:
            raise OptionError(f"resolution {self.resolution[0]} x {self.resolution[1]} is no image.")


AttitudeName = Literal["varied", "facing", "one"]

USUAL_LENSES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "pinhole-radtan": ((458.7, 457.3, 367.2, 248.4), (-0.283, 0.074, 0.0002, 0.00002)),
    "pinhole-radtan5": ((458.7, 457.3, 367.2, 248.4), (-0.32, 0.13, 0.0002, -0.0001, -0.028)),
    "pinhole-equidistant": ((320.4, 319.8, 374.1, 243.6), (-0.012, 0.019, -0.015, 0.004)),
    "pinhole-fov": ((330.4, 329.6, 374.1, 243.6), (0.92,)),
    "omni-radtan": ((1.35, 830.2, 829.1, 373.2, 244.8), (-0.21, 0.11, 0.0004, -0.0002)),
    "ds-none": ((-0.18, 0.59, 292.4, 291.7, 374.1, 243.6), ()),
    "eucm-none": ((0.62, 1.08, 355.2, 354.3, 374.1, 243.6), ()),
}
"""Intrinsics and distortion coefficients of a usual lens of each model, for images of 752 x 480."""


@dataclass(frozen=True, kw_only=True)
class ShownViews:
    """How the board is shown to the cameras."""

    views: int = 60
    """Number of views; all cameras expose at the same instants."""

    rate_hz: float = 1.0
    """Views in a second."""

    attitude: AttitudeName = "varied"
    """varied: the board is turned and tilted differently in each view. facing: it is parallel to the image in all of
    them. one: it has one and the same tilt in all of them."""

    tilt_deg: float = 40.0
    """Largest tilt of the board against the direction in which it is seen, in degrees."""

    roll_deg: float = 30.0
    """Largest turn of the board about that direction, in degrees."""

    fill: tuple[float, float] = (0.35, 0.85)
    """Smallest and largest width of the board in the image, as a fraction of the image's width."""

    spread: float = 0.9
    """How far from the middle of the image the board's middle may be, as a fraction of the way to the border; the board
    stays in the image as far as the detector of its kind asks."""

    between: int = 1
    """Frames from one attitude to the next: above 1 the board moves smoothly, as in a video."""

    cameras: Literal[1, 2, 3] = 1
    """Number of cameras."""

    baseline_m: float = 0.11
    """Distance of each camera from the one before, to its right, in metres."""

    shared_views: bool = True
    """Whether all cameras see the board at the same instants, or take turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CamerasScenario(RenderedImages, TrueLens, SeenBoard, ShownViews):
    """One to three cameras that see a board in view after view."""

    board_aspect: float = 0.0
    """By which fraction the true board is longer along its y axis than stated, against x: a printer's feed."""

    board_bow_m: tuple[float, float] = (0.0, 0.0)
    """How far the middle of the board bulges towards the viewer against the ends along x, and along y, in metres."""

    intrinsics: tuple[float, ...] = USUAL_LENSES["pinhole-radtan"][0]
    """True intrinsics of cam0 in Kalibr's order; of a pinhole fu fv pu pv. Those of further cameras differ a little."""

    distortion_coeffs: tuple[float, ...] = USUAL_LENSES["pinhole-radtan"][1]
    """True coefficients of the distortion."""

    resolution: tuple[int, int] = (752, 480)
    """Width and height of the images in px."""

    pixel_noise_px: float = 0.15
    """Standard deviation of a detected corner, per axis."""

    view_bias_px: float = 0.0
    """Errors that the corners of one view share, as motion and a bent hand-held board make them: rms of a random affine
    and quadratic displacement of its corners, per axis."""

    outliers: float = 0.0
    """Fraction of the corners that are detected in a wrong place."""

    outlier_px: float = 8.0
    """Mean distance of those from where they should be."""

    blurred_views: float = 0.0
    """Fraction of the views in which all corners are detected badly, as in a blurred image."""

    blurred_px: float = 3.0
    """Standard deviation of the corners in such a view, per axis."""

    resized_views: float = 0.0
    """Fraction of the views that come from images of half the size."""

    motion_px: float = 0.3
    """How far the board moves in the images while they are exposed, in px, and as much by turning: a hand holds it.
    In blurred views it moves thirty times as far."""

    def __post_init__(self) -> None:
        check_ranges(self, positive=_POSITIVE, not_negative=_NOT_NEGATIVE, fractions=_FRACTIONS)
        if not 0 < self.marker_share < 1:
            raise OptionError(f"marker_share {self.marker_share:g} must be between 0 and 1.")
        if self.board_aspect <= -1:
            raise OptionError(f"board_aspect {self.board_aspect:g} must be above -1.")
        if not (len(self.fill) == 2 and 0 < self.fill[0] <= self.fill[1]):
            raise OptionError(f"fill {self.fill}: give the smallest and the largest fraction, above 0.")
        if len(self.board_bow_m) != 2:
            raise OptionError(f"board_bow_m {self.board_bow_m}: give two numbers.")
        self.check_lens()

    @classmethod
    def with_lens(cls, model: str, **options: Any) -> Self:
        """Return a scenario with a usual lens of a model, such as "ds-none"; see `USUAL_LENSES`.

        Raises
        ------
        OptionError
            If there is none of that model.
        """
        if model not in USUAL_LENSES:
            raise OptionError(f"model {model}: there is no usual lens. There are {', '.join(USUAL_LENSES)}.")
        projection, _, distortion = model.partition("-")
        intrinsics, coeffs = USUAL_LENSES[model]
        lens: dict[str, Any] = {"projection": projection, "distortion": distortion}
        return cls(**lens, intrinsics=intrinsics, distortion_coeffs=coeffs, **options)


_POSITIVE = "between target_size_m target_scale"
_NOT_NEGATIVE = """
    tilt_deg roll_deg target_spacing corner_offset_m pixel_noise_px view_bias_px outlier_px blurred_px baseline_m
    motion_px blur_px defocus_px image_noise shot_noise
"""
_FRACTIONS = "spread outliers blurred_views resized_views vignetting"
