"""What scenarios of cameras have in common: the board, the lens, and how images of it are rendered. Needs no NumPy."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ..errors import OptionError
from ..models.lens_names import COEFFICIENTS, LINEAR, SHAPES, DistortionName, ProjectionName

if TYPE_CHECKING:
    from ..models.target import Target

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
        from ..models.target import Target

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
