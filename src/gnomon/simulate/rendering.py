"""Pictures of a board: what a camera records of black and white in a plane.

The outlines of what is printed are projected by the camera's own model, and every cell of a grid that is finer than the
pixels takes the exact area that is inside them, so that no edge is displaced; summed over the exposure, blurred as the
lens does, and averaged over each pixel. What is behind the board is looked up ray by ray. Light and noise come last.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..images import Grey
from ..models.board_pattern import Pattern
from ..models.camera import Booleans, Camera
from ..recording import Floats, Integers
from .clutter import Wall
from .coverage import Singles, coverage

_PIECE_PX = 2.0  # longest straight piece: a lens bends lines by less than 0.01 px in it, half of that on average
_CELLS = ((2, 0.5), (3, 0.35), (4, 0.0))  # cells along a side of a pixel, and the blur from which on they do
_GRID = 16  # points along a side of the board that tell where it is in the image
_TILES = 48  # along a side of the board, where it is not in the image as a whole
_NEAR_PX = 60.0  # beyond the image's border, the board's outlines may be coarse
_ROW_SEARCHES = 3
_WALL_INSTANTS = 3  # at most: a wall may be smeared less smoothly
_FAR = 10000.0  # texels; further away, the wall is one grey


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Light, lens blur and sensor noise.

    Attributes
    ----------
    white, black : grey levels of the board, where the light is one
    background : grey level around the board, where there is no wall
    blur_px : standard deviation of the blur of lens and focus [px]; the pixels' own area comes on top of it (0.29 px)
    noise : standard deviation of the noise that does not depend on the light [grey levels]
    shot_noise : variance of the noise that does, over the grey level [grey levels]
    vignetting : fraction of the light that is lost in the corners of the image
    gradient : change of the light from the middle of the image to its right and to its lower edge, as a fraction
    """

    white: float = 210.0
    black: float = 30.0
    background: float = 95.0
    blur_px: float = 0.5
    noise: float = 1.0
    shot_noise: float = 0.0
    vignetting: float = 0.0
    gradient: tuple[float, float] = (0.0, 0.0)


def render(
    pattern: Pattern,
    camera: Camera,
    R_cam_target: Floats,
    p_cam_target: Floats,
    *,
    options: Optics | None = None,
    wall: Wall | None = None,
    covers: Sequence[Floats] = (),
    rng: np.random.Generator | None = None,
) -> Grey:
    """Return the image that a camera takes of a board.

    Parameters
    ----------
    pattern : what is printed on the board
    camera : the lens
    R_cam_target, p_cam_target : (3, 3) and (3,) pose of the board [m]; (k, 3, 3) and (k, 3) for k instants at equal
        distances within the exposure, which are averaged; (k, height, 3, 3) and (k, height, 3) for a pose of each row
    options : light, blur and noise
    wall : what is behind the board
    covers : polygons (n, 2) in the image in front of it [px], in alternating black and white
    rng : random numbers of the noise; without them there is none

    Returns
    -------
    image : (height, width)
    """
    import cv2

    options = options or Optics()
    width, height = camera.resolution
    R, p = _poses(R_cam_target, p_cam_target)
    if wall is None:
        scene = np.full((height, width), options.background, np.float32)
    else:
        scene = _wall_light(wall, camera, R, p, options.blur_px)
    board = _board(pattern, camera, R, p, options.blur_px)
    if board is not None:
        seen = scene[board.region]
        seen += board.sheet * (np.float32(options.white) - seen)
        seen -= np.float32(options.white - options.black) * board.black
    for k, polygon in enumerate(covers):
        _cover(scene, polygon, options.black if k % 2 == 0 else options.white, options.blur_px)
    if options.vignetting or any(options.gradient):
        scene *= _light(camera.resolution, options.vignetting, options.gradient)
    if rng is not None and (options.noise or options.shot_noise):
        _add_noise(scene, options, rng)
    return np.asarray(cv2.convertScaleAbs(np.maximum(scene, 0, out=scene)), dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Board:
    """How much of the pixels of a region, rows and columns, is the board's sheet, and how much of them is black."""

    region: tuple[slice, slice]
    sheet: Singles
    black: Singles


def _poses(R: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return poses (k, rows or 1, 3, 3) and (k, rows or 1, 3)."""
    missing = 4 - np.ndim(R)  # instants, rows
    instants, rows = (1, 1) if missing == 2 else (len(R), 1) if missing == 1 else np.shape(R)[:2]
    return np.reshape(R, (instants, rows, 3, 3)).astype(float), np.reshape(p, (instants, rows, 3)).astype(float)


def _board(pattern: Pattern, camera: Camera, R: Floats, p: Floats, blur_px: float) -> _Board | None:
    """Return what is seen of the board, mean over the poses; None where that is nothing."""
    facing = (np.einsum("kri,kri->kr", R[..., 2], p) < 0).all(axis=1)  # from behind, it shows nothing
    if not facing.any():
        return None
    found = _extent(pattern, camera, R[facing], p[facing], 4 * blur_px + 3)
    if found is None:
        return None
    (rows, cols), finest_m, whole = found
    level = int(np.ceil(2 * np.log2(finest_m)))
    corner = np.array([cols.start, rows.start]) - 0.5
    areas: list[Singles] = []
    # the rim of the sheet need not be finer than the pixels: nothing is measured there
    for what, cells in (("sheet" if whole else "tiles", 1), ("black", _cells(blur_px))):
        outline = _outline_of(pattern, level, what)
        pieces = [_projected(outline, camera, R[k], p[k]) for k in np.flatnonzero(facing)]
        start, end = ((np.concatenate(ends) - corner) * cells for ends in zip(*pieces, strict=True))
        inside = coverage(start, end, ((rows.stop - rows.start) * cells, (cols.stop - cols.start) * cells))
        inside *= np.float32(1 / len(R))
        areas.append(_seen_by_pixels(inside, blur_px, cells))
    return _Board(region=(rows, cols), sheet=areas[0], black=areas[1])


def _cells(blur_px: float) -> int:
    """Return into how many cells a pixel is divided, along a side, so that the blur is smooth between them."""
    return 1 if blur_px <= 0 else next((cells for cells, least_px in _CELLS if blur_px >= least_px))


def _seen_by_pixels(inside: Singles, blur_px: float, cells: int) -> Singles:
    import cv2

    if blur_px > 0:
        blurred = cv2.GaussianBlur(inside, (0, 0), blur_px * cells, borderType=cv2.BORDER_REPLICATE)
        inside = np.asarray(blurred, dtype=np.float32)
    size = (inside.shape[1] // cells, inside.shape[0] // cells)
    return inside if cells == 1 else np.asarray(cv2.resize(inside, size, interpolation=cv2.INTER_AREA), np.float32)


def _extent(
    pattern: Pattern, camera: Camera, R: Floats, p: Floats, margin_px: float
) -> tuple[tuple[slice, slice], float, bool] | None:
    """Return what part of the image the board may cover, None where it is outside.

    Returns
    -------
    region : rows and columns
    finest_m : length on the board that is nowhere longer than _PIECE_PX
    whole : whether the lens model has an image of all of the board
    """
    x0, y0, x1, y1 = pattern.sheet
    x, y = np.meshgrid(np.linspace(x0, x1, _GRID), np.linspace(y0, y1, _GRID))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    size = np.array(camera.resolution)
    low, high, most, whole = np.full(2, np.inf), np.full(2, -np.inf), 0.0, True
    poses = {(0, 0), (len(R) - 1, R.shape[1] - 1), (len(R) // 2, R.shape[1] // 2)}
    for k, row in poses:
        found = camera.project(points @ R[k, row].T + p[k, row])
        assert found.by_point is not None
        whole &= bool(found.valid.all())
        with np.errstate(invalid="ignore"):
            near = ((found.pixels > -_NEAR_PX) & (found.pixels < size + _NEAR_PX)).all(axis=1)
        if near.any():
            along = found.by_point[near] @ R[k, row][:, :2]
            most = max(most, float(np.linalg.norm(along, axis=(1, 2)).max()))
        if found.valid.any():
            low = np.minimum(low, found.pixels[found.valid].min(axis=0))
            high = np.maximum(high, found.pixels[found.valid].max(axis=0))
    if most == 0.0:
        return None
    if not whole:  # nothing bounds the rest
        low, high = np.zeros(2), size.astype(float)
    first = np.floor(low - margin_px).clip(0, size).astype(int)
    last = np.ceil(high + margin_px + 1).clip(0, size).astype(int)
    if not (last > first).all():
        return None
    return (slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))), _PIECE_PX / most, whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Outline:
    """Closed outlines, cut into short pieces.

    Attributes
    ----------
    points : (v, 3) in the board's frame [m]
    start : (n,) points at which the pieces start; each ends at the point after it
    area : (v,) number of the closed outline that a point belongs to
    """

    points: Floats
    start: Integers
    area: Integers


@lru_cache(maxsize=16)
def _outline_of(pattern: Pattern, level: int, what: str) -> _Outline:
    """Return the outlines of the sheet, of its tiles, or of all black, in pieces of 2^(level/2) m at most."""
    if what == "black":
        edges, area = pattern.edges, pattern.area
    else:
        edges, area = _tiles(pattern.sheet, 1 if what == "sheet" else _TILES)
    length = np.linalg.norm(edges[:, 2:] - edges[:, :2], axis=1)
    pieces = np.ceil(length / 2 ** (level / 2)).astype(np.int64).clip(1)
    edge = np.repeat(np.arange(len(edges)), pieces + 1)
    first = np.cumsum(pieces + 1) - (pieces + 1)
    step = np.arange(len(edge)) - first[edge]
    part = (step / pieces[edge])[:, None]
    points = np.zeros((len(edge), 3))
    points[:, :2] = edges[edge, :2] * (1 - part) + edges[edge, 2:] * part
    return _Outline(points=points, start=np.flatnonzero(step < pieces[edge]), area=area[edge])


def _tiles(sheet: Floats, count: int) -> tuple[Floats, Integers]:
    """Return the outlines of so many tiles along a side that the sheet is made of, and the tile of each edge."""
    x, y = (np.linspace(sheet[axis], sheet[axis + 2], count + 1) for axis in (0, 1))
    i, j = (index.ravel() for index in np.indices((count, count)))
    corners = np.stack([x[i], y[j], x[i + 1], y[j], x[i + 1], y[j + 1], x[i], y[j + 1], x[i], y[j]], axis=1)
    edges = np.stack([corners[:, 2 * k : 2 * k + 4] for k in range(4)], axis=1).reshape(-1, 4)
    return edges, np.repeat(np.arange(count * count), 4)


def _projected(outline: _Outline, camera: Camera, R: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return start and end (n, 2) [px] of the pieces in the image, for a pose of each row or one of all of them."""
    pixels = camera.project(outline.points @ R[len(R) // 2].T + p[len(R) // 2], point_jacobian=False).pixels
    for _ in range(_ROW_SEARCHES if len(R) > 1 else 0):  # each point is where it is when its row is exposed
        row = np.nan_to_num(pixels[:, 1]).clip(0, len(R) - 1.001)
        k = row.astype(int)
        points, after = (np.einsum("nij,nj->ni", R[i], outline.points) + p[i] for i in (k, k + 1))
        pixels = camera.project(points + (row - k)[:, None] * (after - points), point_jacobian=False).pixels
    outside = np.isnan(pixels[:, 0])
    start = outline.start
    if outside.any():  # areas that the lens model does not show as a whole are left out: outlines have to be closed
        start = start[~np.isin(outline.area[start], outline.area[outside])]
    return pixels[start], pixels[start + 1]


def _wall_light(wall: Wall, camera: Camera, R: Floats, p: Floats, blur_px: float) -> Singles:
    """Return the grey levels of the wall, mean over the poses."""
    import cv2

    rays = _rays(camera)
    light = np.zeros((rays.shape[0], rays.shape[2]), np.float32)
    chosen = np.linspace(0, len(R) - 1, min(len(R), _WALL_INSTANTS)).round().astype(int)
    for rotation, position in zip(R[chosen], p[chosen], strict=True):
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
    return np.asarray(cv2.GaussianBlur(light, (0, 0), max(blur_px, 0.3)), dtype=np.float32)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> Singles:
    """Return the rays of the pixels, (height, 3, width); zero where the lens has none."""
    width, height = camera.resolution
    rays = np.empty((height, 3, width), np.float32)
    for row in range(height):
        pixels = np.column_stack([np.arange(width, dtype=np.float64), np.full(width, float(row))])
        rays[row] = np.nan_to_num(camera.unproject(pixels)[0]).T
    rays.flags.writeable = False
    return rays


@lru_cache(maxsize=4)
def _light(resolution: tuple[int, int], vignetting: float, gradient: tuple[float, float]) -> Singles:
    """Return the light in each pixel, one in the middle."""
    x, y = ((np.arange(side) - (side - 1) / 2) / (side / 2) for side in resolution)
    falls = 1 - vignetting * (x * x + (y * y)[:, None]) / 2
    return (falls * (1 + gradient[0] * x + gradient[1] * y[:, None])).astype(np.float32)


def _add_noise(scene: Singles, options: Optics, rng: np.random.Generator) -> None:
    noise = rng.standard_normal(scene.shape, dtype=np.float32)
    if options.shot_noise:
        noise *= np.sqrt(np.float32(options.noise**2) + np.float32(options.shot_noise) * np.maximum(scene, 0))
    else:
        noise *= np.float32(options.noise)
    scene += noise


def _cover(scene: Singles, polygon: Floats, level: float, blur_px: float) -> None:
    """Draw a polygon in front of the scene."""
    import cv2

    mask = np.zeros(scene.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(np.asarray(polygon) * 16).astype(np.int32)], 255, lineType=cv2.LINE_AA, shift=4)
    share = cv2.GaussianBlur(mask, (0, 0), max(blur_px, 0.3)).astype(np.float32) / 255
    scene += share * (np.float32(level) - scene)
