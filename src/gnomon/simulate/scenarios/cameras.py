"""What to simulate of cameras before a board, without an IMU; it is also the simulated recording's scenario file."""

from dataclasses import dataclass
from typing import Any, Literal, Self

from ...errors import OptionError
from ...options import check_ranges
from ..seen_board import RenderedImages, SeenBoard, TrueLens

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
