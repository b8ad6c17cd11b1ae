"""Which shared parameters are estimated, in which columns, and how a step moves a rig."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import rotation_from_rotvec, skew
from ...models.camera import Camera
from ...models.target import Target
from ...recording import Floats, Integers
from ..camera_imu.parameters import BoardPoints
from ..camera_imu.terms.visual_terms import TWIST
from .rig import BoardShape, CameraRig

ASPECT, BOW, OFFSETS = "target.aspect", "target.bow", "target.offsets"
"""Names of the blocks."""

ASPECT_SIGMA = 0.1
"""Prior standard deviation of the aspect: no board is printed so badly."""

_BOW_SHARE = 0.1  # prior standard deviation of the bow over the size of the board
_GAUGE = 1e-3  # standard deviation of what the offsets leave to others, as a share of that of a point
POSE = 6
"""Columns of the pose of a view: a small rotation about cam0's origin and a shift, both in cam0's frame."""

_BOUNDS = {  # of lens parameters by symbol; within those of the models
    "xi": (-0.99, 1.0),
    "alpha": (0.0, 1.0),
    "beta": (0.01, 100.0),
    "w": (0.02, 3.1),
    "fu": (1e-3, np.inf),
    "fv": (1e-3, np.inf),
}
_LARGEST_XI = 20.0  # of omni
_POWER = {"fu": 1, "fv": 1, "p1": 1, "p2": 1, "k1": 2, "k2": 4, "k3": 6, "k4": 8}  # of 1 + xi


def stated_shape(target: Target) -> BoardShape:
    """Return the shape of a board that is as it was stated."""
    return BoardShape(aspect=0.0, bow_m=np.zeros(2), offsets=np.zeros((len(target), 3)))


def aspect_move(target: Target) -> Floats:
    """Return where each point moves as the aspect grows, (1, n, 3) [m]."""
    move = np.zeros((1, len(target), 3))
    move[0, :, 1] = target.points[:, 1]
    return move


def bow_moves(target: Target) -> Floats:
    """Return where each point moves as the bow along x and that along y grow, (2, n, 3) [m/m]."""
    centred = target.points[:, :2] - target.points[:, :2].mean(axis=0)
    half = np.maximum(np.ptp(centred, axis=0) / 2, 1e-12)
    moves = np.zeros((2, len(target), 3))
    moves[:, :, 2] = (1 - (centred / half) ** 2).T
    return moves


def bow_sigma(target: Target) -> float:
    """Return the prior standard deviation of the bow [m]: no board is bent so much."""
    return _BOW_SHARE * max(target.size_m)


def board_points(target: Target, shape: BoardShape) -> Floats:
    """Return where the points are, (n, 3) [m]."""
    moved = shape.aspect * aspect_move(target)[0] + np.tensordot(shape.bow_m, bow_moves(target), axes=1)
    return target.points + moved + shape.offsets


def offsets_information(target: Target, others: Floats) -> Floats:
    """Return the prior information of the points' offsets, (3 n, 3 n) [1/m^2].

    A shift, a turn or another size of the whole board is another pose or another distance of the cameras: the offsets
    hold none of it, nor of what else is estimated of the shape.

    Parameters
    ----------
    target : the board
    others : (k, n, 3) moves of the points that parameters of their own stand for
    """
    board = BoardPoints.nominal(target)
    rows = np.concatenate([board.similarity(), others.reshape(len(others), 3 * len(target))])
    rows = np.linalg.qr(rows.T)[0].T / (_GAUGE * board.sigma_m)
    return np.eye(3 * len(target)) / board.sigma_m**2 + rows.T @ rows


@value_class
class SharedLayout:
    """Columns of the shared parameters; those of the points of the board come last.

    Attributes
    ----------
    own : "cam0", ... -> (k,) which of the lens's parameters are estimated
    lens, place : "cam0", ... -> columns of the lens, and of T_cam_cam0; empty where they are held
    aspect, bow, offsets : columns of the board's shape; empty where it is held
    size : number of columns
    """

    own: Mapping[str, Integers]
    lens: Mapping[str, slice]
    place: Mapping[str, slice]
    aspect: slice
    bow: slice
    offsets: slice
    size: int

    @classmethod
    def of(
        cls, cameras: Mapping[str, Camera], own: Mapping[str, Integers], board: tuple[str, ...], points: int
    ) -> "SharedLayout":
        """Return the columns of some lens parameters, of all places but cam0's, and of parts of the board's shape."""
        at = 0
        lens: dict[str, slice] = {}
        place: dict[str, slice] = {}

        def columns(count: int) -> slice:
            nonlocal at
            at += count
            return slice(at - count, at)

        for number, name in enumerate(cameras):
            lens[name] = columns(len(own[name]))
            place[name] = columns(TWIST if number else 0)
        return cls(
            own=own,
            lens=lens,
            place=place,
            aspect=columns(1 if "aspect" in board else 0),
            bow=columns(2 if "bow" in board else 0),
            offsets=columns(3 * points if "corners" in board else 0),
            size=at,
        )

    @classmethod
    def poses_only(cls, cameras: Mapping[str, Camera]) -> "SharedLayout":
        """Return the columns where all that is shared is held: none."""
        none = slice(0, 0)
        return cls(
            own={name: np.empty(0, np.int64) for name in cameras},
            lens=dict.fromkeys(cameras, none),
            place=dict.fromkeys(cameras, none),
            aspect=none,
            bow=none,
            offsets=none,
            size=0,
        )

    @property
    def narrow(self) -> int:
        """Number of columns beside those of the points."""
        return self.offsets.start

    def names(self, cameras: Mapping[str, Camera]) -> tuple[str, ...]:
        """Return the name of each column."""
        found: list[str] = []
        for name, camera in cameras.items():
            found += [f"{name}.{camera.parameter_names[k]}" for k in self.own[name]]
            if self.place[name].stop > self.place[name].start:
                found += [f"{name}.T_cam_cam0.{kind}[{k}]" for kind in ("rotation", "translation") for k in range(3)]
        found += [ASPECT] * (self.aspect.stop - self.aspect.start)
        found += [f"{BOW}[{k}]" for k in range(self.bow.stop - self.bow.start)]
        points = (self.offsets.stop - self.offsets.start) // 3
        return (*found, *(f"{OFFSETS}[{k},{axis}]" for k in range(points) for axis in range(3)))

    def board_moves(self, target: Target) -> Floats:
        """Return where each point moves with aspect and bow, as far as they are estimated, (k, n, 3)."""
        return np.concatenate(
            [
                aspect_move(target)[: self.aspect.stop - self.aspect.start],
                bow_moves(target)[: self.bow.stop - self.bow.start],
            ]
        )

    def map(self, rig: CameraRig, name: str, number: int) -> Floats:
        """Return how the columns of an exposure follow from those of a view, (w, 6 + q + 1).

        The columns of an exposure are [twist | lens | aspect and bow | residual], those of a view [pose | shared,
        without the points | residual].
        """
        R, x = rig.T_cam_cam0[number, :3, :3], rig.T_cam_cam0[number, :3, 3]
        own, bends = len(self.own[name]), self.offsets.start - self.aspect.start
        found = np.zeros((TWIST + own + bends + 1, POSE + self.narrow + 1))
        found[:TWIST, :POSE] = np.block([[R, np.zeros((3, 3))], [skew(x) @ R, R]])
        if self.place[name].stop > self.place[name].start:
            at = POSE + self.place[name].start
            found[:3, at : at + 3], found[3:6, at : at + 3] = R, skew(x) @ R
            found[3:6, at + 3 : at + 6] = np.eye(3)
        found[TWIST : TWIST + own, POSE + self.lens[name].start : POSE + self.lens[name].stop] = np.eye(own)
        found[TWIST + own : -1, POSE + self.aspect.start : POSE + self.narrow] = np.eye(bends)
        found[-1, -1] = 1.0
        return found

    def moved(self, rig: CameraRig, poses: Floats, shared: Floats) -> CameraRig:
        """Return the rig after a step of the poses (v, 6) and of the shared parameters (size,)."""
        turn = rotation_from_rotvec(poses[:, :3])
        cameras: dict[str, Camera] = {}
        T = rig.T_cam_cam0.copy()
        for number, (name, camera) in enumerate(rig.cameras.items()):
            step = np.zeros(len(camera.parameters))
            step[self.own[name]] = shared[self.lens[name]]
            cameras[name] = _moved(camera, step)
            if self.place[name].stop > self.place[name].start:
                step = shared[self.place[name]]
                T[number, :3, :3] = T[number, :3, :3] @ rotation_from_rotvec(step[:3])
                T[number, :3, 3] += step[3:]
        board = rig.board
        return replace(
            rig,
            cameras=cameras,
            T_cam_cam0=T,
            R_cam0_target=turn @ rig.R_cam0_target,
            p_cam0_target=np.einsum("vij,vj->vi", turn, rig.p_cam0_target) + poses[:, 3:],
            board=BoardShape(
                aspect=board.aspect + float(shared[self.aspect].sum()),
                bow_m=board.bow_m + (shared[self.bow] if self.bow.stop > self.bow.start else 0.0),
                offsets=board.offsets
                + (shared[self.offsets].reshape(-1, 3) if self.offsets.stop > self.offsets.start else 0.0),
            ),
        )


def lens_bounds(camera: Camera) -> tuple[Floats, Floats]:
    """Return the least and the largest value of each parameter of a lens, (q,) both."""
    pairs = [_BOUNDS.get(symbol, (-np.inf, np.inf)) for symbol in camera.parameter_symbols]
    low, high = (np.array(side) for side in zip(*pairs, strict=True))
    if camera.projection == "omni":
        high[0] = _LARGEST_XI
    return low, high


def _moved(camera: Camera, step: Floats) -> Camera:
    """Return a lens after a step of its parameters, within their bounds.

    A larger xi makes the plane of the projection smaller by 1 + xi: focal lengths and coefficients go along with it, as
    they do along the valley in which the cost hardly changes. For a small step that is the same as adding it.
    """
    low, high = lens_bounds(camera)
    if "xi" not in camera.parameter_symbols:
        return camera.with_parameters(np.clip(camera.parameters + step, low, high))
    power = np.array([_POWER.get(symbol, 0) for symbol in camera.parameter_symbols])
    before = camera.parameters
    size = 1 + before[0]
    after = float(np.clip(before[0] + step[0], low[0], high[0]))
    # y = p / (1 + xi)^n of each parameter p, and its step dy = (dp - n p dxi / (1 + xi)) / (1 + xi)^n
    unit = (before + step - power * before * step[0] / size) / size**power
    vector = unit * (1 + after) ** power
    vector[0] = after
    return camera.with_parameters(np.clip(vector, low, high))
