"""A lens of any kind from views of a board, with no guess: a sweep of focal lengths and shapes, then a short descent.

The extended unified model goes smoothly from a pinhole to a fisheye of more than 180 degrees; of it a grid of focal
lengths and shapes is tried on a few views that differ, and the best of them are refined. Any other lens model is then
fitted to the rays that this one sees at the pixels of the corners.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...errors import InitialisationError, OptionError
from ...frozen import value_class
from ...models.camera import PROJECTIONS, Camera
from ...models.distortions import DISTORTIONS
from ...models.lens_names import DistortionName, ProjectionName
from ...models.target import Target
from ...recording import Floats, Integers
from ...recording.samples import Booleans
from ...solve.least_squares import levenberg_marquardt
from ..camera_imu.start.board_poses import homography_poses, thin_exposures
from ..camera_imu.terms.visual_terms import CornerNoise
from .layout import SharedLayout, lens_bounds, stated_shape
from .normal import ViewNormalEquations, accumulate_normal_equations, inverse_poses, usual_sigma
from .rig import CameraCorners, CameraRig, RigViews, view_corners
from .solution import solve_rig

MOST_STEPS = 12
_AT_REST = 1e-8  # of the cost, of all views or of one
_FEWER = 0.75  # of the views that are moved, from which on the others are not looked at any more
_WEIGHED = (1, 3)  # steps before which the scatter is found anew
_HUBER = 2.0
_MOST_TURN = 0.5  # rad in one step
_VIEWS = 10  # of the sweep
_FOCALS = np.geomspace(0.18, 6.0, 16)  # over the image's width
_ALPHAS = (0.0, 0.4, 0.6, 0.75)
_BETA = 1.0
_SETTLED = 10  # best of the sweep, whose poses are refined
_REFINED = 3  # best of these, refined with the lens
_SWEEP_STEPS = 3
_SHORT = 15  # iterations
_MOST_RAYS = 600
_WIDEST = np.radians(80)  # of the rays to which a lens is fitted that cannot have wider ones
SHAPES: Mapping[ProjectionName, tuple[tuple[float, ...], ...]] = {
    "pinhole": ((),),
    "omni": ((1.0,), (0.3,), (2.0,)),
    "eucm": ((0.6, 1.0), (0.3, 1.0), (0.75, 1.0)),
    "ds": ((-0.2, 0.55), (0.2, 0.6), (-0.2, 0.3), (0.0, 0.1)),
}
"""Projection -> shapes from which its estimation starts, the likeliest first."""

BENDINGS: Mapping[DistortionName, tuple[tuple[float, ...], ...]] = {
    "none": ((),),
    "radtan": ((0.0,) * 4, (-0.2, 0.03, 0.0, 0.0)),
    "radtan5": ((0.0,) * 5, (-0.2, 0.03, 0.0, 0.0, 0.0)),
    "equidistant": ((0.0,) * 4,),
    "fov": ((0.9,), (0.3,)),
}
"""Distortion -> coefficients from which its estimation starts."""


def first_poses(seen: CameraCorners, camera: Camera) -> tuple[Floats, Floats]:
    """Return the pose of the board in a camera in each of its exposures by homographies, (e, 3, 3) and (e, 3)."""
    if not len(seen):
        return np.empty((0, 3, 3)), np.empty((0, 3))
    return homography_poses(thin_exposures(seen.exposures), camera)


def settle_poses(
    corners: Sequence[CameraCorners],
    target: Target,
    rig: CameraRig,
    *,
    steps: int = MOST_STEPS,
    noise: Mapping[str, CornerNoise] | None = None,
) -> tuple[CameraRig, Floats]:
    """Return the rig with each view's pose where its own robust cost is least, and that cost (v,).

    Each view is damped alone, and left where it came to rest. Without `noise` the corners' scatter about the poses is
    found on the way.
    """
    layout = SharedLayout.poses_only(rig.cameras)
    weights = noise or {name: CornerNoise(sigma_px=1.0, huber=np.inf) for name in rig.cameras}
    at = accumulate_normal_equations(corners, target, rig, layout, weights)
    pose, gradient, cost = at.pose, at.pose_gradient, at.cost
    damping, active = np.full(len(cost), 1e-6), np.ones(len(cost), dtype=bool)
    for step in range(steps):
        if noise is None and step in _WEIGHED:
            weights = _weights(corners, at)
            at = accumulate_normal_equations(corners, target, rig, layout, weights)
            pose, gradient, cost = at.pose, at.pose_gradient, at.cost
        moves = _moves(pose, gradient, damping)
        trial = layout.moved(rig, moves, np.empty(0))
        at = accumulate_normal_equations(corners, target, trial, layout, weights)
        better = active & (at.cost <= cost * (1 + 1e-12))
        gained = np.where(better, cost - at.cost, 0.0)
        rig = replace(
            rig,
            R_cam0_target=_either(better, trial.R_cam0_target, rig.R_cam0_target),
            p_cam0_target=_either(better, trial.p_cam0_target, rig.p_cam0_target),
        )
        pose, gradient = _either(better, at.pose, pose), _either(better, at.pose_gradient, gradient)
        cost = _either(better, at.cost, cost)
        damping = _either(better, np.maximum(0.1 * damping, 1e-9), np.maximum(10 * damping, 1e-3))
        if step <= max(_WEIGHED):
            continue
        moving = active & ~(better & (gained <= _AT_REST * cost))
        if gained.sum() <= _AT_REST * cost.sum():
            break
        if moving.sum() < _FEWER * active.sum():
            active, corners = moving, [seen.only(moving[seen.view]) for seen in corners]
    return rig, cost


def _moves(pose: Floats, gradient: Floats, damping: Floats) -> Floats:
    """Return damped steps (v, 6) of the poses, none of which turns by too much at once."""
    moves = -np.einsum("vij,vj->vi", inverse_poses(pose, damping), gradient)
    turn = np.linalg.norm(moves[:, :3], axis=1, keepdims=True)
    return moves * np.minimum(1.0, _MOST_TURN / np.maximum(turn, 1e-300))


def _either(better: Booleans, one: Floats, other: Floats) -> Floats:
    """Return the one (v, ...) of the views (v,) for which it is better, and the other of the others."""
    return np.where(better.reshape(-1, *[1] * (one.ndim - 1)), one, other)


def _weights(corners: Sequence[CameraCorners], at: ViewNormalEquations) -> dict[str, CornerNoise]:
    return {
        seen.name: CornerNoise(sigma_px=usual_sigma(sums), huber=_HUBER)
        for seen, sums in zip(corners, at.sums, strict=True)
    }


@value_class
class _Trial:
    """One lens on the views of the sweep, and the median distance of its corners [px]."""

    rig: CameraRig
    error_px: float


def first_lens(views: RigViews, number: int, model: str) -> Camera:
    """Return a lens that fits the views of one camera about as well as its model can.

    Parameters
    ----------
    views : of the board
    number : of the camera
    model : such as "pinhole-radtan"

    Raises
    ------
    InitialisationError
        If the camera saw the board too seldom, or no lens explains what it saw.
    OptionError
        If there is no such model.
    """
    return fit_lens_model(general_lens(views, number), model, view_corners(views, number).exposures.pixels)


def general_lens(views: RigViews, number: int) -> Camera:
    """Return an eucm-none lens that fits the views of one camera; see `first_lens`."""
    name = tuple(views.cameras)[number]
    frames = views.cameras[name]
    some = _alone(views, number)
    if len(some) < 1:
        raise InitialisationError(
            f"{name}: no image shows enough of the board to be used, at least six points that do not lie on one line. "
            "Record more views, closer to the board."
        )
    chosen = some.where(_well_spread(view_corners(some, 0)))
    few = view_corners(chosen, 0)
    few = replace(few, exposures=thin_exposures(few.exposures), own_sigma_px=None)
    trials = [
        trial
        for focal in _FOCALS * frames.camera.resolution[0]
        for alpha in _ALPHAS
        if (trial := _tried(few, views.target, _lens(frames.camera, focal, alpha))) is not None
    ]
    found: list[_Trial] = []
    for trial in _best(trials, _SETTLED):
        rig, _ = settle_poses((few,), views.target, trial.rig, steps=_SWEEP_STEPS)
        found.append(_Trial(rig=rig, error_px=_error(rig, few)))
    refined = [_refined(chosen, few, trial) for trial in _best(found, _REFINED)]
    if not refined or not np.isfinite(min(trial.error_px for trial in refined)):
        raise InitialisationError(
            f"{name}: no lens explains what {len(chosen)} of its images show. Do the target file and the numbering of "
            "the board's points fit?"
        )
    return _best(refined, 1)[0].rig.cameras[name]


def _best(trials: list[_Trial], count: int) -> list[_Trial]:
    return sorted(trials, key=lambda trial: trial.error_px)[:count]


def _alone(views: RigViews, number: int) -> RigViews:
    """Return the views of one camera alone."""
    name = tuple(views.cameras)[number]
    kept = views.frame[:, number] >= 0
    return replace(
        views,
        cameras={name: views.cameras[name]},
        t_ns=views.t_ns[kept],
        frame=views.frame[kept, number : number + 1],
    )


def _lens(like: Camera, focal: float, alpha: float) -> Camera:
    width, height = like.resolution
    return Camera(
        projection="eucm",
        intrinsics=np.array([alpha, _BETA, focal, focal, (width - 1) / 2, (height - 1) / 2]),
        distortion="none",
        distortion_coeffs=np.empty(0),
        resolution=like.resolution,
        topic=like.topic,
    )


def _well_spread(seen: CameraCorners) -> Integers:
    """Return views with many corners that differ from each other: where the board is, how large and how tilted."""
    lengths = np.diff(seen.exposures.start)
    rich = np.flatnonzero(lengths >= 0.5 * np.quantile(lengths, 0.9))
    looks = _looks(seen)[rich]
    chosen = [int(np.argmax(lengths[rich]))]
    distance = np.full(len(rich), np.inf)
    while len(chosen) < min(_VIEWS, len(rich)):
        distance = np.minimum(distance, np.linalg.norm(looks - looks[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.sort(rich[np.unique(chosen)])


def _looks(seen: CameraCorners) -> Floats:
    """Return eight numbers for each exposure: the pixels at the ends of the board, by an affine and a bending part."""
    ends = np.empty((len(seen), 8))
    for k, (a, b) in enumerate(zip(seen.exposures.start[:-1], seen.exposures.start[1:], strict=True)):
        points, pixels = seen.exposures.points[a:b, :2], seen.exposures.pixels[a:b]
        x, y = ((points - points.mean(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-12)).T
        columns = np.stack([np.ones_like(x), x, y, x * y], axis=1)
        ends[k] = np.linalg.lstsq(columns, pixels, rcond=None)[0].ravel()
    return ends


def _tried(seen: CameraCorners, target: Target, camera: Camera) -> _Trial | None:
    """Return a lens with poses by homographies; None where it has no rays for all pixels."""
    rays, valid = camera.unproject(seen.exposures.pixels)
    if not valid.all() or not np.isfinite(rays).all():
        return None
    R, p = first_poses(seen, camera)
    rig = CameraRig(
        cameras={seen.name: camera},
        T_cam_cam0=np.eye(4)[None],
        R_cam0_target=R,
        p_cam0_target=p,
        board=stated_shape(target),
    )
    return _Trial(rig=rig, error_px=_error(rig, seen))


def _error(rig: CameraRig, seen: CameraCorners) -> float:
    """Return the median distance of the corners; those that cannot be imaged count as infinitely far."""
    of = seen.exposures.of_corner
    points = np.einsum("mij,mj->mi", rig.R_cam0_target[of], seen.exposures.points) + rig.p_cam0_target[of]
    apart = rig.cameras[seen.name].project(points, point_jacobian=False).pixels - seen.exposures.pixels
    distance = np.linalg.norm(apart, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def _refined(views: RigViews, few: CameraCorners, trial: _Trial) -> _Trial:
    found = solve_rig(views, trial.rig, most_iterations=_SHORT)
    return _Trial(rig=found.rig, error_px=_error(found.rig, few))


def fit_lens_model(lens: Camera, model: str, pixels: Floats) -> Camera:
    """Return a lens of another model that sees about the same rays at the same pixels.

    Parameters
    ----------
    lens : any
    model : such as "pinhole-equidistant"
    pixels : (m, 2) where it matters [px]

    Raises
    ------
    OptionError
        If there is no such model.
    InitialisationError
        If no lens of the model sees these rays.
    """
    projection, distortion = names_of(model)
    if lens.model == model:
        return lens
    rays, valid = lens.unproject(pixels[:: max(len(pixels) // _MOST_RAYS, 1)])
    pixels = pixels[:: max(len(pixels) // _MOST_RAYS, 1)][valid]
    rays = rays[valid]
    best: tuple[float, Camera] | None = None
    for shape in SHAPES[projection]:
        for bending in BENDINGS[distortion]:
            candidate = _fit(_start(lens, projection, shape, distortion, bending), rays, pixels)
            error = _distance(candidate, rays, pixels)
            if best is None or error < best[0]:
                best = error, candidate
    if best is None:
        raise InitialisationError(f"no {model} lens is like the one that was found.")
    return best[1]


def names_of(model: str) -> tuple[ProjectionName, DistortionName]:
    """Return the projection and the distortion of a model such as "pinhole-radtan".

    Raises
    ------
    OptionError
        If there is no such model.
    """
    first, _, second = model.partition("-")
    projection: ProjectionName | None = next((name for name in PROJECTIONS if name == first), None)
    distortion: DistortionName | None = next((name for name in DISTORTIONS if name == second), None)
    if projection is None or distortion is None:
        raise OptionError(
            f"there is no lens model {model!r}; it must be one of {', '.join(PROJECTIONS)}, a dash, and one of "
            f"{', '.join(DISTORTIONS)}, such as pinhole-radtan."
        )
    return projection, distortion


def _start(
    lens: Camera,
    projection: ProjectionName,
    shape: tuple[float, ...],
    distortion: DistortionName,
    bending: tuple[float, ...],
) -> Camera:
    """Return a lens of typical shape that enlarges as much as another one on its axis."""
    unit = Camera(
        projection=projection,
        intrinsics=np.array([*shape, 1.0, 1.0, 0.0, 0.0]),
        distortion=distortion,
        distortion_coeffs=np.array(bending),
        resolution=lens.resolution,
        topic=lens.topic,
        line_delay_s=lens.line_delay_s,
    )
    near = np.array([[1e-4, 0.0, 1.0]])
    scale = float((lens.project(near).pixels - lens.intrinsics[-2:])[0, 0] / lens.intrinsics[-4])
    own = float(unit.project(near).pixels[0, 0])
    fu, fv, pu, pv = lens.intrinsics[-4:]
    return replace(unit, intrinsics=np.array([*shape, fu * scale / own, fv * scale / own, pu, pv]))


def _fit(start: Camera, rays: Floats, pixels: Floats) -> Camera:
    """Return the lens whose pixels of some rays are nearest; rays that it cannot have do not count."""
    low, high = lens_bounds(start)
    size = np.maximum(np.abs(start.parameters), 0.1)
    ahead = rays[:, 2] > np.cos(_WIDEST) if start.projection == "pinhole" else np.ones(len(rays), dtype=np.bool_)
    limit = 0.1 * start.resolution[0]

    def problem(x: Floats) -> tuple[Floats, Floats]:
        camera = start.with_parameters(np.clip(x * size, low, high))
        image = camera.project(rays[ahead], parameters_jacobian=True, point_jacobian=False)
        assert image.by_parameters is not None
        apart = np.where(image.valid[:, None], image.pixels - pixels[ahead], limit)
        return apart.ravel(), image.by_parameters.reshape(-1, len(x)) * size

    if np.sum(ahead) < len(size):
        return start
    found = levenberg_marquardt(problem, start.parameters / size, tolerance=1e-8, most_iterations=40)
    return start.with_parameters(np.clip(found.x * size, low, high))


def _distance(lens: Camera, rays: Floats, pixels: Floats) -> float:
    """Return the rms distance of a lens's pixels from others; what it cannot image counts as far off."""
    image = lens.project(rays, point_jacobian=False)
    far = lens.resolution[0]
    return float(np.sqrt(np.mean(np.where(image.valid[:, None], image.pixels - pixels, far) ** 2)))
