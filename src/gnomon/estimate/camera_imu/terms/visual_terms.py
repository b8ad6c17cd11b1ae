"""The error terms of the cameras (Krebs, section 4.1.2): e_c = h(T_cam_imu T_target_imu(t + d)^-1 p) - y.

The corners of one instant move as a rigid body in the camera's frame. With p a corner in the camera's frame, h(p) its
image and G = dh/dp, a small twist (rotation tau_r about the camera's origin, translation tau_t) moves the image by

    dh = -G [p]x tau_r + G tau_t,

whether the twist comes from the pose, the extrinsics, the time shift or the line delay. So the hundred corners of each
exposure are summed up once, in the eight or so columns [-G [p]x | G | own parameters | residual | probe], which is all
that the normal equations need of them (`corner_sums`), and mapped to the unknowns later. With x = p_cam_imu the origin
of the IMU in the camera's frame, a turn about it by tau_r is the twist (tau_r, x x tau_r) about the camera's origin,
and

    turning the body by d (right perturbation)     tau_r = -R_cam_imu d,
    moving the body by dp                          tau_t = -R_cam_imu R' dp,
    turning the extrinsics by d                    tau_r = R_cam_imu d,
    moving the extrinsics by dx                    tau_t = dx,
    exposing later by dt                           the body turns by omega dt and moves by v dt,
    exposing for longer, e^2 by ds                 its mean turns by alpha ds / 24 and moves by a ds / 24 (`Bases.at`).
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import skew
from ....kernel import library
from ....models.camera import Camera
from ....recording import Floats, Integers
from ..layout import BorderLayout
from ..parameters import OFFSETS, CameraParameters, RigParameters
from ..trajectory import POSE, Bases, MotionState, Trajectory
from .assembly import Columns
from .board_terms import CornerProducts, Coupling, PoseProducts, exposure_corners
from .corner_rows import add_corner_rows

_CHUNK = 8_000  # corners at a time; bounds the memory and stays in the cache

TWIST = 6
"""Columns of the twist: rotation and translation."""


@value_class
class Exposures:
    """Corners of one camera, gathered by the instant of their exposure.

    Attributes
    ----------
    frame : (e,) frame of each exposure
    start : (e + 1,) first corner of each exposure, and their number
    points : (m, 3) corners on the target [m]
    pixels : (m, 2) detected [px]
    delay_rows : (e,) image row that is exposed at this instant; zero for a global shutter
    spread : (m,) standard deviation of each corner over that of a usual one, or None where all are alike
    point : (m,) number of each corner on the target, or None where they are not asked for
    """

    frame: Integers
    start: Integers
    points: Floats
    pixels: Floats
    delay_rows: Floats
    spread: Floats | None = None
    point: Integers | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def of_corner(self) -> Integers:
        """Exposure of each corner, (m,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))

    def chunks(self) -> list[tuple[int, int]]:
        """Return (first, last + 1) of consecutive exposures that have some thousand corners together."""
        edges = [0]
        while edges[-1] < len(self):
            stop = int(np.searchsorted(self.start, self.start[edges[-1]] + _CHUNK, side="right")) - 1
            edges.append(max(stop, edges[-1] + 1))
        return list(pairwise(edges))


@value_class
class CornerNoise:
    """How corners are weighed.

    Attributes
    ----------
    sigma_px : standard deviation of a corner per axis
    huber : distance in sigmas beyond which a corner counts less (Huber); infinite for least squares
    probe_sign : (m, 2) random signs for the trace of the hat matrix, or None
    """

    sigma_px: float
    huber: float
    probe_sign: Floats | None = None


@value_class
class CornerSums:
    """Sums of products over the corners of each exposure.

    Attributes
    ----------
    sums : (e, w, w) products of the columns [twist 6 | own parameters | residual | probe, if any], in sigmas; or where
        every exposure is a single corner, as with a rolling shutter, (e, 2, w) the columns themselves
    cost : (e,) robust cost, half of chi-square for small residuals
    corner_cost : (m,) the same of each corner; zero where not valid
    mean_square : (e,) mean squared residual per axis [px^2]; nan without valid corners
    valid : (e,) corners that the camera model can image
    lengths : (e,) corners of each exposure
    residual : (m, 2) predicted minus detected [px]; nan where not valid
    weight : (m,) robust weight
    spread : (m,) or 1.0, standard deviation of each corner over that of a usual one
    """

    sums: Floats
    cost: Floats
    corner_cost: Floats
    mean_square: Floats
    valid: Integers
    lengths: Integers
    residual: Floats
    weight: Floats
    spread: Floats | float = 1.0

    @property
    def gram(self) -> Floats:
        """Products of the columns, (e, w, w)."""
        return np.swapaxes(self.sums, 1, 2) @ self.sums if self._single else self.sums

    def rows(self, chosen: Integers) -> Floats:
        """Return rows (n, r, w) of some exposures whose products are the sums: few, however many corners there are."""
        sums = self.sums[chosen]
        return sums if self._single else _square_roots(sums)

    @property
    def _single(self) -> bool:
        return self.sums.shape[1] != self.sums.shape[2]

    @property
    def comparable(self) -> Floats:
        """Residuals (m, 2), those of uncertain corners made as small as the others' [px]."""
        return self.residual / np.reshape(self.spread, (-1, 1))


def corner_sums(
    exposures: Exposures,
    camera: Camera,
    R_cam_target: Floats,
    p_cam_target: Floats,
    noise: CornerNoise,
    *,
    own_parameters: Integers | None = None,
    target_scale: float = 1.0,
    scale_column: bool = False,
    shape: Floats | None = None,
    offsets: CornerProducts | None = None,
) -> CornerSums:
    """Sum up the corners of every exposure.

    Parameters
    ----------
    exposures : e of them
    camera : lens and intrinsics
    R_cam_target : (e, 3, 3), p_cam_target : (e, 3) [m] pose of the target in the camera's frame at each exposure
    noise : weights
    own_parameters : indices of `Camera.parameters` that get a column each
    target_scale : size of the target relative to `exposures.points`
    scale_column : give it a column, after the own parameters
    shape : (k, m, 3) where on the target, per unit, each corner moves with each of k parameters of the target's shape
        that get a column, after the scale's; or None
    offsets : takes the products with the offset of each corner, where these are wanted
    """
    own = np.empty(0, np.int64) if own_parameters is None else own_parameters
    bends = 0 if shape is None else len(shape)
    width = TWIST + len(own) + scale_column + bends + 1 + (noise.probe_sign is not None)
    count = len(exposures)
    single = bool((np.diff(exposures.start) == 1).all())
    sums = np.zeros((count, 2 if single else width, width))
    cost, square = np.zeros(count), np.full(count, np.nan)
    valid = np.zeros(count, np.int64)
    residual, weight, each = (np.empty((len(exposures.points), *shape)) for shape in ((2,), (), ()))
    if width <= library.MOST_COLUMNS and library.load_kernel() is not None:
        library.add_corner_sums(
            start=exposures.start,
            pose=(R_cam_target, p_cam_target),
            points=exposures.points,
            pixels=exposures.pixels,
            lens=camera.packed(),
            own=own,
            scale=target_scale,
            scale_column=scale_column,
            shape=shape,
            spread=exposures.spread,
            sign=noise.probe_sign,
            sigma_px=noise.sigma_px,
            huber=noise.huber,
            sums=sums,
            of_exposure=(cost, square, valid),
            of_corner=(each, weight, residual),
            offsets=None if offsets is None else offsets.taking(),
        )
    else:
        add_corner_rows(
            exposures,
            camera,
            (R_cam_target, p_cam_target),
            noise,
            own,
            target_scale=target_scale,
            scale_column=scale_column,
            shape=shape,
            sums=sums,
            of_exposure=(cost, square, valid),
            of_corner=(each, weight, residual),
            offsets=offsets,
        )
    return CornerSums(
        sums=sums,
        cost=cost,
        corner_cost=each,
        mean_square=square,
        valid=valid,
        lengths=np.diff(exposures.start),
        residual=residual,
        spread=1.0 if exposures.spread is None else exposures.spread,
        weight=weight,
    )


def frame_scatter(exposures: Exposures, sums: CornerSums, known: np.ndarray) -> Floats:
    """Return the variance of the corners of every frame per axis, (frames,) [px^2]; nan where nothing was imaged.

    It comes from the median squared distance, 2 ln 2 sigma^2 for a normal distribution: wrong corners do not count.

    Parameters
    ----------
    known : (e,) exposures whose sums mean something
    """
    corner = np.repeat(known, sums.lengths) & np.isfinite(sums.residual[:, 0])
    frame = np.repeat(exposures.frame, sums.lengths)[corner]
    comparable = sums.comparable[corner]
    order = np.argsort(frame, kind="stable")  # frames of a rolling shutter come row by row
    frame, squared = frame[order], np.einsum("ij,ij->i", comparable, comparable)[order]
    found = np.full(int(exposures.frame.max()) + 1, np.nan)
    counts = np.bincount(frame, minlength=len(found))
    some = np.flatnonzero(counts)
    by_frame = np.full((len(found), int(counts.max(initial=0))), np.inf)
    by_frame[frame, np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts)] = squared
    by_frame.sort(axis=1)
    found[some] = by_frame[some, counts[some] // 2] / (2 * np.log(2))
    return found


def _square_roots(gram: Floats) -> Floats:
    """Return rows (e, w, w) whose products are the sums: as many rows as columns instead of two a corner."""
    diagonal = np.einsum("nii->ni", gram)
    w = gram.shape[1]
    eased = gram + (1e-13 * diagonal + 1e-30)[:, :, None] * np.eye(w)
    return np.swapaxes(np.linalg.cholesky(eased), 1, 2)


@value_class
class VisualData:
    """Corners of one camera.

    Attributes
    ----------
    camera : index of the camera
    exposures : corners, gathered by the instant of their exposure
    t_s : (e,) timestamps of the frames on the camera's clock [s]
    """

    camera: int
    exposures: Exposures
    t_s: Floats


def exposure_times(data: VisualData, entry: CameraParameters) -> Floats:
    """Return when the exposures happened, on the IMU's clock, (e,) [s]."""
    return data.t_s + entry.time_shift_s + data.exposures.delay_rows * entry.camera.line_delay_s


def board_in_camera(motion: MotionState, entry: CameraParameters) -> tuple[Floats, Floats]:
    """Return the target's pose in the camera's frame, R_cam_target (e, 3, 3) and p_cam_target (e, 3) [m]."""
    R_imu_target = np.swapaxes(motion.R, 1, 2)
    R_cam_target = entry.R_cam_imu @ R_imu_target
    return R_cam_target, entry.p_cam_imu - np.matmul(R_cam_target, motion.position[:, :, None])[:, :, 0]


class VisualTerms:
    """Error terms of the corners of one camera.

    Attributes
    ----------
    sums : over the corners of all exposures; of those outside of the trajectory they mean nothing
    known : (e,) exposures inside of the trajectory that have corners which can be imaged
    inside : (e,) those of them that are used
    """

    def __init__(
        self,
        data: VisualData,
        trajectory: Trajectory,
        parameters: RigParameters,
        *,
        layout: BorderLayout,
        noise: CornerNoise,
        used: np.ndarray,
        probe: int | None,
        part: Integers | None = None,
    ) -> None:
        """Sum up the corners of every exposure.

        Parameters
        ----------
        data : corners
        trajectory, parameters, layout : where to linearise
        noise : weights
        used : (e,) exposures that shall take part
        probe : right-hand side of the probe, or None
        part : (e,) part of the recording that each exposure counts for in `coupling`, ascending with time; None for one
        """
        self._part = np.zeros(len(data.t_s), np.int64) if part is None else part
        self._parts = int(self._part.max(initial=0)) + 1
        grid = trajectory.grid
        self._entry = entry = parameters.cameras[data.camera]
        places = grid.places(exposure_times(data, entry))
        self._bases = Bases.at(places, grid, entry.exposure_s2)
        self._motion = trajectory.motion(places, self._bases)
        own, scale_column = _own_columns(layout, entry)
        exposures, offsets = data.exposures, None
        if (board := parameters.board) is not None and board.offsets.any():
            assert exposures.point is not None
            exposures = replace(exposures, points=exposures.points + board.offsets[exposures.point])
        if board is not None and layout.get(OFFSETS) is not None:
            assert exposures.point is not None
            counted = np.repeat(places.inside & used, np.diff(exposures.start))
            width = len(own) + scale_column + 1 + (noise.probe_sign is not None)
            points = len(board.points)
            number = exposures.point + points * np.repeat(self._part, np.diff(exposures.start))
            offsets = CornerProducts(number, counted, points * self._parts, width)
        self.sums = corner_sums(
            exposures,
            entry.camera,
            *board_in_camera(self._motion, entry),
            noise,
            own_parameters=own,
            target_scale=parameters.target_scale,
            scale_column=scale_column,
            offsets=offsets,
        )
        self._exposures, self._offsets = exposures, offsets
        mine = (f"{entry.name}.", "target.scale")
        self.columns = Columns.of(
            layout, grid.order, lambda name: name.startswith(mine), imu=None, probes=() if probe is None else (probe,)
        )
        self._maps = _maps(self.columns.blocks, data, entry, self._motion)
        self.known = places.inside & (self.sums.valid > 0)
        self.inside = self.known & used
        chosen = np.flatnonzero(self.inside)
        self._order = chosen[np.argsort(places.first[chosen], kind="stable")]
        self._first = places.first[self._order]

    @property
    def first(self) -> Integers:
        """First control point of the span of each exposure that takes part, ascending."""
        return self._first

    @property
    def cost(self) -> float:
        """Robust cost of all exposures that take part."""
        return float(self.sums.cost[self.inside].sum())

    @property
    def height(self) -> int:
        """Number of rows of each exposure."""
        return self.sums.sums.shape[1]

    def coupling(self, sides: int) -> Coupling | None:
        """Return what the offsets of the corners have in common with everything else, where they have columns.

        Only once: the products of the corners are large, and turned where they are.

        Parameters
        ----------
        sides : number of right-hand sides
        """
        if self._offsets is None or self._exposures.point is None:
            return None
        products, order, self._offsets = self._offsets, self._order, None
        corner, place = exposure_corners(order, self._exposures.start)
        parts, points = self._parts, len(products.squares) // self._parts
        point = self._exposures.point[corner]
        by_twist = PoseProducts(place=place, point=point, by_twist=products.taken(corner), shape=(len(order), points))
        rest, blocks = products.rest.reshape(-1, parts, points * 3), self.columns.blocks
        runs = list(pairwise(np.searchsorted(self._part[order], np.arange(parts + 1)).tolist()))
        border = [(blocks[name], rest[index].swapaxes(0, 1)) for name, index in self._maps.own]
        for name, way in self._maps.twists:
            along = np.broadcast_to(way, (len(self._part), *way.shape[1:]))[order]
            border.append((blocks[name], np.stack([by_twist.pull(along, *run).T for run in runs])))
        residual = self._maps.count
        right = np.zeros((parts, points * 3, sides))
        right[:, :, 0] = -rest[residual]
        for number, probe in enumerate(self.columns.sides[1:], 1):
            right[:, :, probe] = rest[residual + number]
        return Coupling(
            first=self._first,
            value=self._bases.value[order],
            by_pose=by_twist.turned(np.swapaxes(self._by_pose()[order], 1, 2)),
            border=border,
            sides=right,
            squares=products.squares.reshape(parts, points, 3, 3),
        )

    def _by_pose(self) -> Floats:
        """Return the derivative of the twist by the pose at all exposures, (e, 6, 6)."""
        entry, motion = self._entry, self._motion
        R, x = entry.R_cam_imu, entry.p_cam_imu
        found = np.zeros((len(motion.R), TWIST, POSE))
        found[:, :, :3] = -np.vstack([R, skew(x) @ R]) @ motion.phi_jacobian
        found[:, 3:, 3:] = -R @ np.swapaxes(motion.R, 1, 2)
        return found

    def add_to(self, band: library.Band) -> Floats | None:
        """Return None: the products come from the rows."""
        del band

    def rows(self, part: slice) -> Floats:
        """Return the rows (e, r, w) that sum up the corners of some exposures."""
        chosen = self._order[part]
        return self._mapped(self.sums.rows(chosen), chosen)

    def _mapped(self, roots: Floats, chosen: Integers) -> Floats:
        """Return the rows (e, r, w) from rows (e, r, ...) in the columns of `corner_sums`."""
        entry, columns, motion = self._entry, self.columns, self._motion
        count, height, _ = roots.shape
        R, x = entry.R_cam_imu, entry.p_cam_imu
        turn = -np.vstack([R, skew(x) @ R])  # (6, 3)
        by_turn = (roots[:, :, :TWIST] @ turn) @ motion.phi_jacobian[chosen]
        by_move = -(roots[:, :, 3:TWIST] @ R) @ np.swapaxes(motion.R[chosen], 1, 2)
        rows = np.zeros((count, height, columns.width))
        pose = rows[:, :, : columns.pose].reshape(count, height, columns.order, POSE)  # a view
        value = self._bases.value[chosen][:, None, :, None]
        np.multiply(value, by_turn[:, :, None, :], out=pose[..., :3])
        np.multiply(value, by_move[:, :, None, :], out=pose[..., 3:])
        for name, twist in self._maps.twists:
            of_exposure = twist if len(twist) == 1 else twist[chosen]
            rows[:, :, columns.own[name]] = roots[:, :, :TWIST] @ of_exposure
        for name, index in self._maps.own:
            rows[:, :, columns.own[name]] = roots[:, :, TWIST + index.start : TWIST + index.stop]
        residual = TWIST + self._maps.count
        rows[:, :, columns.side] = -roots[:, :, residual]  # np.negative(x, out=y) errs where x has a stride of 64 bytes
        if len(columns.sides) > 1:
            rows[:, :, columns.side + 1] = roots[:, :, residual + 1]
        return rows


def _own_columns(layout: BorderLayout, entry: CameraParameters) -> tuple[Integers, bool]:
    """Return which of the lens' parameters have a column, and whether the target's scale has one."""
    name, lens = entry.name, entry.camera
    count = len(lens.intrinsics)
    own: list[int] = []
    if layout.get(f"{name}.intrinsics") is not None:
        own += range(count)
    if layout.get(f"{name}.distortion_coeffs") is not None:
        own += range(count, len(lens.parameters))
    return np.array(own, dtype=np.int64), layout.get("target.scale") is not None


@value_class
class _Maps:
    """How blocks of the border act: by a twist (e or 1, 6, b), or as own columns of the sums, `count` of them."""

    twists: list[tuple[str, Floats]]
    own: list[tuple[str, slice]]

    @property
    def count(self) -> int:
        return self.own[-1][1].stop if self.own else 0


def _maps(blocks: dict[str, slice], data: VisualData, entry: CameraParameters, motion: MotionState) -> _Maps:
    name, R, x = entry.name, entry.R_cam_imu, entry.p_cam_imu
    shift, delay, exposure = (f"{name}.{rest}" for rest in ("time_shift_cam_imu", "line_delay", "exposure_squared"))
    moving = blurring = np.zeros((0, TWIST, 1))
    if shift in blocks or delay in blocks:
        moving = _body_twists(entry, motion, motion.omega, motion.velocity)[:, :, None]
    if exposure in blocks:
        turn = np.matmul(motion.phi_jacobian, motion.phi_acceleration[:, :, None])[:, :, 0]
        blurring = _body_twists(entry, motion, turn / 24, motion.acceleration / 24)[:, :, None]
    twists = {
        f"{name}.T_cam_imu.rotation": np.vstack([R, skew(x) @ R])[None],
        f"{name}.T_cam_imu.translation": np.vstack([np.zeros((3, 3)), np.eye(3)])[None],
        shift: moving,
        delay: moving * (data.exposures.delay_rows if len(moving) else np.zeros(0))[:, None, None],
        exposure: blurring,
    }
    own = [block for block in (f"{name}.intrinsics", f"{name}.distortion_coeffs", "target.scale") if block in blocks]
    ends = np.cumsum([0, *(blocks[block].stop - blocks[block].start for block in own)]).tolist()
    return _Maps(
        twists=[(block, twist) for block, twist in twists.items() if block in blocks],
        own=[(block, slice(*edges)) for block, edges in zip(own, pairwise(ends), strict=True)],
    )


def _body_twists(entry: CameraParameters, motion: MotionState, turn: Floats, move: Floats) -> Floats:
    """Return the twists (e, 6) that follow from turning (IMU axes) and moving (target axes) the body, (e, 3) each."""
    rotation = -turn @ entry.R_cam_imu.T
    moved = np.matmul(move[:, None, :], motion.R)[:, 0] @ entry.R_cam_imu.T
    return np.concatenate([rotation, np.cross(entry.p_cam_imu, rotation) - moved], axis=1)
