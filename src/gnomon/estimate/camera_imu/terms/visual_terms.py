"""The error terms of the cameras (Krebs, section 4.1.2): e_c = h(T_cam_imu T_target_imu(t + d)^-1 p) - y.

All corners of an exposure share one twist of the camera's frame, so their sum comes from `corner_sums`; here it is
mapped to the unknowns. With x = p_cam_imu the origin of the IMU in the camera's frame, a turn about it by tau_r is the
twist (tau_r, x x tau_r) about the camera's origin, and

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
from ....geometry.rotation_vector import skew
from ....kernel import library
from ....recording import Floats, Integers
from ..layout import BorderLayout
from ..parameters import OFFSETS, CameraParameters, RigParameters
from ..trajectory import POSE, Bases, MotionState, Trajectory
from .assembly import Columns
from .board_terms import CornerProducts, Coupling, PoseProducts, exposure_corners
from .corner_sums import TWIST, CornerNoise, Exposures, corner_sums


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
