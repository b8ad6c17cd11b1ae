"""The data doctor's look at images in which a board was sought: sharp, well exposed, the board in sight.

Bounds, and why they are there:

    blur 1.5 px      an edge is then four pixels wide (10 to 90 %), as wide as a module of a tag of 40 px: codes fade,
                     and corners are known half as well as in a sharp image, whose blur is 0.5 to 0.8 px
    white 250        an 8-bit sensor that reads 255 has lost the edge's upper part, and 250 is the mean of pixels of
                     which noise drives many to 255
    contrast 40      noise of two to three levels is then a fifteenth of the edge, and a corner is uncertain by 0.04 px
                     or more, as much as all else in a good image together
"""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...detect.boards.board import SECOND_BOARD
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...models.camera import Camera
from ...recording import CameraFrames, Floats, FrameQuality, Integers
from ...recording.recording import Grey

Booleans = NDArray[np.bool_]

BLURRED_PX = 1.5
BRIGHT, DARK, FLAT = 250.0, 60.0, 40.0
"""Grey levels: of white that is clipped, of white that is too dark, and of too little contrast."""

_SHARPEST = 0.1  # quantile of the blur that only the lens makes
_BLURRED_SHARE, _SOME_BLURRED = 0.2, 0.03
_BADLY_LIT_SHARE = 0.2
_RARE, _SOMETIMES = 0.6, 0.9
_DROPPED_SHARE, _SOME_DROPPED = 0.3, 0.02
_UNCERTAIN_PX = 0.12  # three to ten times what sharp images give
_AT_EDGE = 0.1  # of the image's smaller side
_SIDES = ("left", "top", "right", "bottom")


@value_class
class BoardDetections:
    """In which frames a board was seen, and how it went out of sight.

    Attributes
    ----------
    t_ns : (n,) timestamps of the frames that were looked at, ascending
    seen : (n,) whether the board was found
    box_px : (n, 4) left, top, right and bottom of the corners that were found; nan where none were
    blur_px : (n,) blur at the corners; nan where it is not known
    resolution : (width, height)
    consecutive : whether no frame is left out between them, so that the last one with the board tells where it left
    """

    t_ns: Integers
    seen: Booleans
    box_px: Floats
    blur_px: Floats
    resolution: tuple[int, int]
    consecutive: bool = True


def check_images(name: str, frames: CameraFrames, usable: Integers) -> list[Finding]:
    """Return findings on the images of a camera, where it is known what they were like.

    Codes: images, motion-blur, out-of-focus, images-bright, images-dark, images-flat, corners-dropped,
    corners-uncertain, board-rare.

    Parameters
    ----------
    usable : frames that tell a pose, as indices into the timestamps
    """
    quality = frames.quality
    if quality is None:
        return []
    seen = np.zeros(len(frames.t_ns), dtype=bool)
    seen[usable] = True
    sight = BoardDetections(
        t_ns=frames.t_ns,
        seen=seen,
        box_px=corner_boxes(frames.frame, frames.pixels, len(frames.t_ns)),
        blur_px=quality.blur_px,
        resolution=frames.camera.resolution,
    )
    findings = check_quality(name, quality, len(frames.frame), frames.sigma_px)
    return findings + check_sight(name, sight)


def corner_boxes(frame: Integers, pixels: Floats, count: int) -> Floats:
    """Return the rectangles around the corners of each of `count` frames, (count, 4); nan where there are none."""
    box = np.full((count, 4), np.nan)
    if len(frame):
        first = np.flatnonzero(np.concatenate([[True], np.diff(frame) > 0]))
        low, high = np.minimum.reduceat(pixels, first), np.maximum.reduceat(pixels, first)
        box[frame[first]] = np.concatenate([low, high], axis=1)
    return box


def check_quality(name: str, quality: FrameQuality, corners: int, sigma_px: Floats | None) -> list[Finding]:
    """Return findings on blur, exposure and dropped corners.

    Parameters
    ----------
    corners : number of corners that were kept
    sigma_px : (corners,) their standard deviations, where they are known
    """
    found = [
        *blur_findings(name, quality.blur_px),
        *_exposure(name, quality),
        *([make_finding("board-twice", name=name)] if quality.dropped.get(SECOND_BOARD) else []),
        *_dropped(name, quality.dropped, corners),
        *_uncertain(name, sigma_px),
    ]
    if any(finding.severity == "warning" for finding in found) or not np.isfinite(quality.blur_px).any():
        return found
    return [_good(name, quality, sigma_px), *found]


def _good(name: str, quality: FrameQuality, sigma_px: Floats | None) -> Finding:
    corners = "" if sigma_px is None or not len(sigma_px) else f"; corners known to {np.median(sigma_px):.2g} px"
    return make_finding(
        "images/detected",
        name=name,
        blur_px=_median(quality.blur_px),
        black=_median(quality.black),
        white=_median(quality.white),
        corners=corners,
    )


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def blur_findings(name: str, blur_px: Floats, limit_px: float = BLURRED_PX, where: str = "the board") -> list[Finding]:
    """Return what to say about blur, (n,) [px]; nan where it is not known."""
    known = blur_px[np.isfinite(blur_px)]
    if not len(known):
        return []
    sharpest, share = float(np.quantile(known, _SHARPEST)), float(np.mean(known > limit_px))
    if sharpest > limit_px:
        return [make_finding("out-of-focus", name=name, sharpest=sharpest, where=where, usual_px=np.median(known))]
    if share <= _SOME_BLURRED:
        return []
    many = share > _BLURRED_SHARE
    return [
        make_finding(
            "motion-blur",
            severity="warning" if many else "info",
            case="many" if many else "",
            name=name,
            share=share,
            where=where,
            limit_px=limit_px,
            worst_px=known.max(),
            sharpest=sharpest,
        )
    ]


def _exposure(name: str, quality: FrameQuality) -> list[Finding]:
    known = np.isfinite(quality.black) & np.isfinite(quality.white)
    if not known.any():
        return []
    black, white = quality.black[known], quality.white[known]
    clipped, dark, flat = white >= BRIGHT, white < DARK, white - black < FLAT
    findings: list[Finding] = []
    if np.mean(clipped) > _BADLY_LIT_SHARE:
        findings.append(
            make_finding(
                "images-bright/detected", name=name, clipped=np.mean(clipped), median_white=np.median(white[clipped])
            )
        )
    if np.mean(dark) > _BADLY_LIT_SHARE:
        findings.append(
            make_finding(
                "images-dark/detected",
                name=name,
                dark=np.mean(dark),
                median_white=np.median(white[dark]),
                median_black=np.median(black[dark]),
            )
        )
    elif np.mean(flat) > _BADLY_LIT_SHARE:
        findings.append(
            make_finding(
                "images-flat/detected",
                name=name,
                flat=np.mean(flat),
                median_black=np.median(black[flat]),
                median_white=np.median(white[flat]),
            )
        )
    return findings


def _dropped(name: str, dropped: Mapping[str, int], corners: int) -> list[Finding]:
    dropped = {reason: number for reason, number in dropped.items() if reason != SECOND_BOARD}
    count = sum(dropped.values())
    share = count / max(count + corners, 1)
    if share <= _SOME_DROPPED:
        return []
    many = share > _DROPPED_SHARE
    ordered = sorted(dropped.items(), key=lambda item: -item[1])
    why = ", ".join(f"{number} {reason}" for reason, number in ordered if number)
    return [
        make_finding(
            "corners-dropped",
            severity="warning" if many else "info",
            case="many" if many else "",
            name=name,
            dropped=count,
            corners=count + corners,
            why=why,
        )
    ]


def _uncertain(name: str, sigma_px: Floats | None) -> list[Finding]:
    if sigma_px is None or not len(sigma_px) or float(np.median(sigma_px)) <= _UNCERTAIN_PX:
        return []
    return [make_finding("corners-uncertain", name=name, median_sigma_px=np.median(sigma_px))]


# ---- where the board is ----


def check_sight(name: str, sight: BoardDetections) -> list[Finding]:
    """Return what to say where the board is often out of sight: how often, and where it leaves the image."""
    share = float(np.mean(sight.seen)) if len(sight.seen) else 0.0
    if share >= _SOMETIMES or not sight.seen.any():  # a board that is never seen has a finding of its own
        return []
    lost = np.flatnonzero(sight.seen[:-1] & ~sight.seen[1:] & sight.consecutive)
    sides, away = _lost_where(sight, lost)
    rare = share < _RARE
    where = ", ".join(f"{count} at the {side} edge" for side, count in sides.items())
    where = ", ".join(part for part in (where, f"{len(away)} away from the edges" if len(away) else "") if part)
    times = f"It was lost {len(lost)} time{'s' * (len(lost) > 1)}: {where}{_blur_before(sight, away)}." if where else ""
    return [
        make_finding(
            "board-rare",
            severity="warning" if rare else "info",
            case="rare" if rare else "",
            name=name,
            share=share,
            times=times,
            sides=_keep_in_sight(sides, len(away)),
        )
    ]


def _lost_where(sight: BoardDetections, lost: Integers) -> tuple[dict[str, int], Integers]:
    """Return how often the board left at which edge, most often first, and the frames before it vanished elsewhere."""
    width, height = sight.resolution
    box = sight.box_px[lost]
    margin = np.stack([box[:, 0], box[:, 1], width - 1 - box[:, 2], height - 1 - box[:, 3]], axis=1)
    margin = np.where(np.isfinite(margin), margin, np.inf)
    at_edge = margin.min(axis=1) < _AT_EDGE * min(width, height)
    nearest = np.argmin(margin, axis=1)[at_edge]
    counts = {side: int(np.count_nonzero(nearest == i)) for i, side in enumerate(_SIDES)}
    ordered = sorted(((side, count) for side, count in counts.items() if count), key=lambda item: -item[1])
    return dict(ordered), lost[~at_edge]


def _blur_before(sight: BoardDetections, away: Integers) -> str:
    """Return what the blur was before the board vanished in the middle of the image, where that explains it."""
    blur = sight.blur_px[away]
    blur = blur[np.isfinite(blur)]
    if not len(blur) or np.median(blur) < BLURRED_PX:
        return ""
    return f", where the images were blurred by {np.median(blur):.1f} px before"


def _keep_in_sight(sides: Mapping[str, int], away: int) -> str:
    edges = sum(sides.values())
    if not edges and not away:
        return "Keep the board in the image, lit and sharp; a step back gives room."
    if edges >= away and sides:
        side = next(iter(sides))
        return f"Keep the board in the image; mostly it leaves at the {side}. A step back gives room."
    return "Light the board better and expose shorter, and do not tilt it by more than about 60 degrees."


_WIDTHS_PX = (1.0, 2.0)
_DIFFERENCE = 1.0 / 3.0  # variance that the central difference adds [px^2]
_DIRECTIONS = 4
_FEWEST_EDGES = 300
_STRONGEST = 0.7  # quantile of the gradient from which edges are taken for those of sharp things
_WEAKEST = 2.0  # grey levels a pixel
_WIDEST_PX = 20.0

_BLURRED_PX = 2.0  # half a pixel beyond what is borne at a board: not everything in a room has sharp edges
_CLIPPED_SHARE = 0.25
_MANY = 0.2
_SAME = 0.5


@value_class(eq=True)
class ImageStatistics:
    """What one image is like.

    Attributes
    ----------
    size : (width, height)
    blur_px : standard deviation of the blur, along the direction in which it is worst [px]; nan where there are too
        few edges
    low, high : grey levels below which, and above which, a hundredth of the pixels lies
    clipped : share of pixels that read 250 or more
    digest : hash of the pixels
    """

    size: tuple[int, int]
    blur_px: float
    low: float
    high: float
    clipped: float
    digest: bytes


def measure_image(image: Grey) -> ImageStatistics:
    """Measure one image, (height, width)."""
    low, high = np.quantile(image[::2, ::2], [0.01, 0.99])
    return ImageStatistics(
        size=(image.shape[1], image.shape[0]),
        blur_px=edge_blur(image),
        low=float(low),
        high=float(high),
        clipped=float(np.mean(image >= BRIGHT)),
        digest=hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest(),
    )


def edge_blur(image: Grey) -> float:
    """Return the standard deviation of the blur at the strong edges of an image [px]; nan where there are too few."""
    if min(image.shape) < 16:
        return float("nan")
    (x, y), (x_wide, y_wide) = (_gradient(image, width) for width in _WIDTHS_PX)
    fine, wide = x * x + y * y, x_wide * x_wide + y_wide * y_wide
    across = np.abs(x) > np.abs(y)
    middle = np.s_[1:-1, 1:-1]
    before = np.where(across[middle], fine[1:-1, :-2], fine[:-2, 1:-1])
    after = np.where(across[middle], fine[1:-1, 2:], fine[2:, 1:-1])
    weakest = max(_WEAKEST, 3 * float(np.median(np.sqrt(fine[::4, ::4])))) ** 2
    peak = (fine[middle] >= before) & (fine[middle] >= after) & (fine[middle] > weakest)
    strength = fine[middle][peak]
    if len(strength) < _FEWEST_EDGES:
        return float("nan")
    fall = strength / np.maximum(wide[middle][peak], 1e-9)
    first, second = (width**2 + _DIFFERENCE for width in _WIDTHS_PX)
    blur = np.sqrt(np.clip((second - fall * first) / np.maximum(fall - 1, 1e-3), 0, _WIDEST_PX**2))
    angle = np.arctan2(y[middle][peak], x[middle][peak]) / np.pi
    sector = np.floor(np.mod(_DIRECTIONS * angle + 0.5, _DIRECTIONS)).astype(np.int64)
    found = [_of_strongest(blur[sector == k], strength[sector == k]) for k in range(_DIRECTIONS)]
    known = [value for value in found if np.isfinite(value)]
    return max(known, default=float("nan"))


def _gradient(image: Grey, width_px: float) -> tuple[Floats, Floats]:
    import cv2  # OpenCV takes half of a second to load

    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), width_px)
    x, y = np.zeros_like(smooth), np.zeros_like(smooth)
    x[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    y[1:-1] = (smooth[2:] - smooth[:-2]) / 2
    return x, y  # pyright: ignore[reportReturnType]


def _of_strongest(blur: Floats, strength: Floats) -> float:
    if len(blur) < _FEWEST_EDGES:
        return float("nan")
    return float(np.median(blur[strength >= np.quantile(strength, _STRONGEST)]))


def check_sizes(name: str, looks: Sequence[ImageStatistics], camera: Camera | None) -> list[Finding]:
    """Return findings on sizes of images that differ from each other or from the camera's, and on repeated images.

    Codes: image-size, images-same.
    """
    sizes = list(dict.fromkeys(look.size for look in looks))
    if not sizes:
        return []
    if len(sizes) > 1:
        return [make_finding("image-size/mixed", name=name, sizes=", ".join(f"{w} x {h}" for w, h in sizes[:4]))]
    if camera is not None and sizes[0] != camera.resolution:
        (width, height), (stated_width, stated_height) = sizes[0], camera.resolution
        return [
            make_finding(
                "image-size/stated",
                name=name,
                width=width,
                height=height,
                stated_width=stated_width,
                stated_height=stated_height,
            )
        ]
    same = 1 - len({look.digest for look in looks}) / len(looks)
    if len(looks) < 3 or same <= _SAME:
        return []
    return [make_finding("images-same", name=name, same=same, images=len(looks))]


def check_looks(name: str, looks: Sequence[ImageStatistics]) -> list[Finding]:
    """Return findings on the sharpness and the exposure of images in which no board is known.

    Codes: images, motion-blur, out-of-focus, images-bright, images-dark, images-flat.
    """
    if not looks:
        return []
    blur = np.array([look.blur_px for look in looks])
    low, high, clipped = (np.array([getattr(look, key) for look in looks]) for key in ("low", "high", "clipped"))
    findings = [*blur_findings(name, blur, _BLURRED_PX, "strong edges"), *_light(name, low, high, clipped)]
    if not findings and np.isfinite(blur).any():
        findings.append(
            make_finding(
                "images/sampled",
                name=name,
                blur_px=np.nanmedian(blur),
                median_low=np.median(low),
                median_high=np.median(high),
            )
        )
    return findings


def _light(name: str, low: Floats, high: Floats, clipped: Floats) -> list[Finding]:
    bright, dark, flat = clipped > _CLIPPED_SHARE, high < DARK, high - low < FLAT
    levels = f"grey levels {np.median(low):.0f} to {np.median(high):.0f} of 255"
    if np.mean(bright) > _MANY:
        return [
            make_finding(
                "images-bright/sampled", name=name, bright=np.mean(bright), median_clipped=np.median(clipped[bright])
            )
        ]
    if np.mean(dark) > _MANY:
        return [make_finding("images-dark/sampled", name=name, dark=np.mean(dark), levels=levels)]
    if np.mean(flat) > _MANY:
        return [make_finding("images-flat/sampled", name=name, flat=np.mean(flat), levels=levels)]
    return []
