"""Pictures of a board: what a camera records of black and white on a sheet.

The outlines of what is printed are projected by the camera's own model, and every cell of a grid that is finer than the
pixels takes the exact area that is inside them, so that no edge is displaced; summed over the exposure, blurred as the
lens does, and averaged over each pixel. What is behind the board is looked up ray by ray. Light and noise come last.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ...frozen import value_class
from ...models.board_pattern import BoardPattern
from ...models.camera import Booleans, Camera
from ...recording import Floats
from ...recording.recording import Grey
from ..scenarios.cameras import RenderedImages
from .board_outlines import (
    InstantPoses,
    MotionSegment,
    Movement,
    Outline,
    Pose,
    Singles,
    TrueBoard,
    outline_of,
    pixel_coverage,
)
from .clutter import Wall

_LONGEST_PX, _BENT_PX = 8.0, 0.0015  # of a straight piece, and by how much the lens may bend the line in it
_CELLS = ((2, 0.7), (3, 0.4), (4, 0.0))  # cells along a side of a pixel, and the blur from which on they do
_STEP_PX, _STEP = 0.25, 1.4  # between instants: without blur, and what is added, over its standard deviation
_GRID = 16  # points along a side of the board that tell where it is in the image
_NEAR_PX = 60.0  # beyond the image's border, the board's outlines may be coarse
_WALL_INSTANTS = 3  # at most: a wall may be smeared less smoothly
_FAR = 10000.0  # texels; further away, the wall is one grey


@value_class(eq=True)
class Optics:
    """Light, lens blur and sensor noise.

    Attributes
    ----------
    white, black : grey levels of the board, where the light is one
    background : grey level around the board, where there is no wall
    blur_px : standard deviation of the blur of lens and focus [px]; the pixels' own area comes on top of it (0.29 px)
    defocus_px : radius of the disc as which a point out of focus is seen [px]; with focus_m of a point at infinity
    focus_m : distance that is in focus [m]: a board at z is seen with discs of radius defocus_px |1 - focus_m / z|,
        z being that of its middle; None if the radius does not depend on the distance
    noise : standard deviation of the noise that does not depend on the light [grey levels]
    shot_noise : variance of the noise that does, over the grey level [grey levels]
    vignetting : fraction of the light that is lost in the corners of the image
    gradient : change of the light from the middle of the image to its right and to its lower edge, as a fraction
    """

    white: float = 210.0
    black: float = 30.0
    background: float = 95.0
    blur_px: float = 0.5
    defocus_px: float = 0.0
    focus_m: float | None = None
    noise: float = 1.0
    shot_noise: float = 0.0
    vignetting: float = 0.0
    gradient: tuple[float, float] = (0.0, 0.0)


def usual_light(scenario: RenderedImages) -> Optics:
    """Return indoor light, with blur, noise and vignetting as a scenario states them."""
    return Optics(
        white=205.0,
        black=28.0,
        background=90.0,
        gradient=(0.08, -0.05),
        blur_px=scenario.blur_px,
        defocus_px=scenario.defocus_px,
        focus_m=scenario.focus_m,
        noise=scenario.image_noise,
        shot_noise=scenario.shot_noise,
        vignetting=scenario.vignetting,
    )


def render_board(
    pattern: BoardPattern,
    camera: Camera,
    R_cam_target: Floats,
    p_cam_target: Floats,
    *,
    board: TrueBoard | None = None,
    options: Optics | None = None,
    wall: Wall | None = None,
    occluders: Sequence[Floats] = (),
    rng: np.random.Generator | None = None,
) -> Grey:
    """Return the image that a camera takes of a board.

    Parameters
    ----------
    pattern : what is printed on the board
    camera : the lens; all rows expose at once
    R_cam_target, p_cam_target : (3, 3) and (3,) pose of the board [m]; (k, 3, 3) and (k, 3) for k instants at equal
        distances within the exposure, which are averaged
    board : where the points of the board truly are, if not where the pattern has them
    options : light, blur and noise
    wall : what is behind the board
    occluders : polygons (n, 2) in the image in front of it [px], in alternating black and white
    rng : random numbers of the noise; without them there is none

    Returns
    -------
    image : (height, width)
    """
    R, p = np.reshape(R_cam_target, (-1, 3, 3)).astype(float), np.reshape(p_cam_target, (-1, 3)).astype(float)
    scene = _Scene(pattern=pattern, board=board, camera=camera, movement=InstantPoses(camera=camera, R=R, p=p))
    return _image(scene, options or Optics(), wall, occluders, rng)


def render_moving(
    pattern: BoardPattern,
    camera: Camera,
    pose: Pose,
    *,
    exposure_s: float = 0.0,
    board: TrueBoard | None = None,
    options: Optics | None = None,
    wall: Wall | None = None,
    occluders: Sequence[Floats] = (),
    rng: np.random.Generator | None = None,
) -> Grey:
    """Return the image that a camera takes of a board against which it moves, row by row with a rolling shutter.

    Parameters
    ----------
    pattern : what is printed on the board
    camera : the lens; row v is exposed line_delay_s v later than the top row
    pose : instants (n,) [s] from the middle of the exposure of the top row -> R_cam_target (n, 3, 3), p_cam_target
        (n, 3) [m]
    exposure_s : time during which each row is exposed [s]
    board, options, wall, occluders, rng : as for `render_board`
    """
    options = options or Optics()
    points = _sheet_points(pattern, board, 5)
    z = float((pose(np.zeros(1))[0][0] @ points.mean(axis=0) + pose(np.zeros(1))[1][0])[2])
    step_px = _STEP_PX + _STEP * float(np.hypot(options.blur_px, _disc_px(options, z) / 2))
    movement = MotionSegment.during(exposure_s, camera, pose, points, step_px)
    scene = _Scene(pattern=pattern, board=board, camera=camera, movement=movement)
    return _image(scene, options, wall, occluders, rng)


@value_class
class _Scene:
    """A board and a camera that may move against it; see `render_board`."""

    pattern: BoardPattern
    board: TrueBoard | None
    camera: Camera
    movement: Movement


def _image(
    what: _Scene, options: Optics, wall: Wall | None, occluders: Sequence[Floats], rng: np.random.Generator | None
) -> Grey:
    import cv2

    camera = what.camera
    width, height = camera.resolution
    R, p = what.movement.poses()
    middle = len(R) // 2
    z = float((R[middle] @ _sheet_points(what.pattern, what.board, 3).mean(axis=0) + p[middle])[2])
    lens = _Blur(sigma_px=options.blur_px, disc_px=_disc_px(options, z))
    if wall is None:
        scene = np.full((height, width), options.background, np.float32)
    else:
        scene = _wall_light(wall, camera, what.movement, lens)
    seen = _board(what, lens)
    if seen is not None:
        part = scene[seen.region]
        part += seen.sheet * (np.float32(options.white) - part)
        part -= np.float32(options.white - options.black) * seen.black
    for k, polygon in enumerate(occluders):
        _occlude(scene, polygon, options.black if k % 2 == 0 else options.white, options.blur_px)
    if options.vignetting or any(options.gradient):
        scene *= light_falloff(camera.resolution, options.vignetting, options.gradient)
    if rng is not None and (options.noise or options.shot_noise):
        add_noise(scene, options, rng)
    return np.asarray(cv2.convertScaleAbs(np.maximum(scene, 0, out=scene)), dtype=np.uint8)


@value_class(eq=True)
class _Blur:
    """Blur of the lens: standard deviation of a Gaussian, and radius of the disc of a point out of focus [px]."""

    sigma_px: float
    disc_px: float

    @property
    def reach_px(self) -> float:
        return 4 * self.sigma_px + self.disc_px

    def blurred(self, light: Singles, cells: int = 1) -> Singles:
        """Return light that is so blurred; of cells, so many along a side of a pixel."""
        import cv2

        if self.disc_px > 0:
            disc = _disc(self.disc_px * cells)
            light = np.asarray(cv2.filter2D(light, -1, disc, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
        if self.sigma_px > 0:
            sigma = self.sigma_px * cells
            light = np.asarray(
                cv2.GaussianBlur(light, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
            )
        return light


def _disc_px(options: Optics, z: float) -> float:
    if options.focus_m is None:
        return options.defocus_px
    return options.defocus_px * abs(1 - options.focus_m / max(z, 1e-3))


@lru_cache(maxsize=64)
def _disc(radius: float) -> Singles:
    """Return the part of each cell that is in a disc about the middle one, over the disc's area."""
    half, finer = int(np.ceil(radius)), 16
    places = (np.arange((2 * half + 1) * finer) + 0.5) / finer - half - 0.5
    inside = np.hypot(places[:, None], places) <= radius
    share = inside.reshape(2 * half + 1, finer, 2 * half + 1, finer).mean(axis=(1, 3))
    share[half, half] += share.sum() == 0
    return (share / share.sum()).astype(np.float32)


@value_class
class _Board:
    """How much of the pixels of a region, rows and columns, is the board's sheet, and how much of them is black."""

    region: tuple[slice, slice]
    sheet: Singles
    black: Singles


def _board(what: _Scene, lens: _Blur) -> _Board | None:
    """Return what is seen of the board, mean over the exposure; None where that is nothing."""
    movement = what.movement
    R, p = movement.poses()
    if (np.einsum("ki,ki->k", R[..., 2], p) >= 0).any():  # from behind, it shows nothing
        return None
    found = _extent(what, lens.reach_px + 3)
    if found is None:
        return None
    (rows, cols), finest_m, whole = found
    level = int(np.floor(2 * np.log2(finest_m)))
    corner = np.array([cols.start, rows.start]) - 0.5
    areas: list[Singles] = []
    cells = _cells(lens)
    for part in ("sheet" if whole else "tiles", "black"):
        outline = outline_of(what.pattern, part, level, what.board)
        pieces = [_pieces(outline, pixels) for pixels in movement.pixels(outline.points)]
        start, end = ((np.concatenate(ends) - corner) * cells for ends in zip(*pieces, strict=True))
        inside = pixel_coverage(start, end, ((rows.stop - rows.start) * cells, (cols.stop - cols.start) * cells))
        inside *= np.float32(1 / movement.instants)
        areas.append(_seen_by_pixels(inside, lens, cells))
    return _Board(region=(rows, cols), sheet=areas[0], black=areas[1])


def _cells(lens: _Blur) -> int:
    """Return into how many cells a pixel is divided, along a side, so that the blur is smooth between them."""
    if lens.sigma_px <= 0 and lens.disc_px <= 0:
        return 1
    blur_px = float(np.hypot(lens.sigma_px, lens.disc_px / 5))  # a disc has edges
    return next((cells for cells, least_px in _CELLS if blur_px >= least_px))


def _seen_by_pixels(inside: Singles, lens: _Blur, cells: int) -> Singles:
    import cv2

    inside = lens.blurred(inside, cells)
    size = (inside.shape[1] // cells, inside.shape[0] // cells)
    return inside if cells == 1 else np.asarray(cv2.resize(inside, size, interpolation=cv2.INTER_AREA), np.float32)


def _sheet_points(pattern: BoardPattern, board: TrueBoard | None, count: int) -> Floats:
    """Return points on the sheet, count along each side, (count^2, 3) [m]."""
    x0, y0, x1, y1 = pattern.sheet
    x, y = np.meshgrid(np.linspace(x0, x1, count), np.linspace(y0, y1, count))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return points if board is None else board.places(points)


def _extent(what: _Scene, margin_px: float) -> tuple[tuple[slice, slice], float, bool] | None:
    """Return what part of the image the board may cover, None where it is outside.

    Returns
    -------
    region : rows and columns
    finest_m : length on the board that is nowhere longer than _LONGEST_PX, nor bent by more than _BENT_PX
    whole : whether the lens model has an image of all of the board
    """
    size, sheet = np.array(what.camera.resolution), what.pattern.sheet
    low, high, finest_m, whole = np.full(2, np.inf), np.full(2, -np.inf), np.inf, True
    spacing_m = (sheet[2:] - sheet[:2]) / (_GRID - 1)
    every = list(what.movement.pixels(_sheet_points(what.pattern, what.board, _GRID)))
    for pixels in (every[0], every[len(every) // 2], every[-1]):
        known = np.isfinite(pixels[:, 0])
        whole &= bool(known.all())
        if known.any():
            low = np.minimum(low, pixels[known].min(axis=0))
            high = np.maximum(high, pixels[known].max(axis=0))
        finest_m = min(finest_m, _finest(pixels.reshape(_GRID, _GRID, 2), size, spacing_m))
    if not np.isfinite(finest_m):
        return None
    if not whole:  # nothing bounds the rest
        low, high = np.zeros(2), size.astype(float)
    first = np.floor(low - margin_px).clip(0, size).astype(int)
    last = np.ceil(high + margin_px + 1).clip(0, size).astype(int)
    if not (last > first).all():
        return None
    return (slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))), finest_m, whole


def _finest(grid: Floats, size: Floats, spacing_m: Floats) -> float:
    """Return the longest length of pieces [m] that suits the image of a grid of points (rows, cols, 2) [px].

    The points are `spacing_m` (2,) apart on the board, along x (columns) and y.
    """
    finest = np.inf
    for along, apart_m in ((grid.swapaxes(0, 1), spacing_m[0]), (grid, spacing_m[1])):
        before, here, after = along[:-2], along[1:-1], along[2:]
        with np.errstate(invalid="ignore"):
            near = np.isfinite(here[..., 0]) & ((here > -_NEAR_PX) & (here < size + _NEAR_PX)).all(axis=2)
            chord = after - before
            length = np.linalg.norm(chord, axis=2)
            bent = np.abs(chord[..., 0] * (here - before)[..., 1] - chord[..., 1] * (here - before)[..., 0]) / length
            near &= np.isfinite(bent)
        if near.any():
            longest, most = float(length[near].max()), float(bent[near].max())
            finest = min(finest, 2 * apart_m * min(_LONGEST_PX / longest, float(np.sqrt(_BENT_PX / max(most, 1e-9)))))
    return finest


def _pieces(outline: Outline, pixels: Floats) -> tuple[Floats, Floats]:
    """Return start and end (n, 2) [px] of the pieces whose points are at `pixels`."""
    start, outside = outline.start, np.isnan(pixels[:, 0])
    if outside.any():  # areas that the lens model does not show as a whole are left out: outlines have to be closed
        start = start[~np.isin(outline.area[start], outline.area[outside])]
    return pixels[start], pixels[start + 1]


def _wall_light(wall: Wall, camera: Camera, movement: Movement, lens: _Blur) -> Singles:
    """Return the grey levels of the wall, mean over the exposure."""
    import cv2

    rays = pixel_rays(camera)
    light = np.zeros((rays.shape[0], rays.shape[2]), np.float32)
    chosen = np.linspace(0, movement.instants - 1, min(movement.instants, _WALL_INSTANTS)).round().astype(int)
    for instant in chosen.tolist():
        rotation, position = movement.rows(instant)
        frame = np.stack([rotation[..., 0], rotation[..., 1], position - wall.behind_m * rotation[..., 2]], axis=-1)
        to_texels = np.linalg.inv(frame)  # of a ray to x w, y w and w of the point of the wall
        to_texels[:, :2] -= np.array(wall.origin)[:, None] * to_texels[:, 2:]
        to_texels[:, :2] /= wall.texel_m
        met = np.matmul(to_texels.astype(np.float32), rays)
        w = met[:, 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            u, v = met[:, 0] / w, met[:, 1] / w
        misses: Booleans = ~((w > 0) & (np.abs(u) < _FAR) & (np.abs(v) < _FAR))
        u[misses] = v[misses] = 0.0
        cv2.accumulate(cv2.remap(wall.texels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101), light)
    light *= np.float32(1 / len(chosen))
    return _Blur(sigma_px=max(lens.sigma_px, 0.3), disc_px=lens.disc_px).blurred(light)


@lru_cache(maxsize=4)
def pixel_rays(camera: Camera) -> Singles:
    """Return the rays of the pixels, (height, 3, width); zero where the lens has none."""
    width, height = camera.resolution
    rays = np.empty((height, 3, width), np.float32)
    for row in range(height):
        pixels = np.column_stack([np.arange(width, dtype=np.float64), np.full(width, float(row))])
        rays[row] = np.nan_to_num(camera.unproject(pixels)[0]).T
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=4)
def light_falloff(resolution: tuple[int, int], vignetting: float, gradient: tuple[float, float]) -> Singles:
    """Return the light in each pixel, one in the middle."""
    x, y = ((np.arange(side) - (side - 1) / 2) / (side / 2) for side in resolution)
    falls = 1 - vignetting * (x * x + (y * y)[:, None]) / 2
    return (falls * (1 + gradient[0] * x + gradient[1] * y[:, None])).astype(np.float32)


def add_noise(scene: Singles, options: Optics, rng: np.random.Generator) -> None:
    """Add the noise of sensor and light to grey levels, in place."""
    noise = rng.standard_normal(scene.shape, dtype=np.float32)
    if options.shot_noise:
        noise *= np.sqrt(np.float32(options.noise**2) + np.float32(options.shot_noise) * np.maximum(scene, 0))
    else:
        noise *= np.float32(options.noise)
    scene += noise


def _occlude(scene: Singles, polygon: Floats, level: float, blur_px: float) -> None:
    """Draw a polygon in front of the scene."""
    import cv2

    mask = np.zeros(scene.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(np.asarray(polygon) * 16).astype(np.int32)], 255, lineType=cv2.LINE_AA, shift=4)
    share = cv2.GaussianBlur(mask, (0, 0), max(blur_px, 0.3)).astype(np.float32) / 255
    scene += share * (np.float32(level) - scene)
