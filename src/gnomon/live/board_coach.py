"""Tells a person how to show a board to a camera.

image -> board found, or why not -> what the views so far show -> one sentence, one region of the image
"""

from collections.abc import Sequence
from dataclasses import field
from typing import Any

import numpy as np

from ..assess.cameras.cameras_verdict import unseen_corners
from ..assess.checks.board_views import FEWEST_CORNERS
from ..assess.checks.image_checks import BLURRED_PX, BRIGHT, DARK, ImageStatistics
from ..detect.boards.board import NOT_WITH_NEIGHBOURS, BoardView
from ..estimate.camera_imu.start.board_poses import gather_exposures, homography_poses
from ..frozen import value_class
from ..models.camera import Camera
from ..models.target import Target
from ..recording import CameraFrames, Floats, Recording
from ..recording.recording import Grey
from .faults import Fault
from .trials import TrialOutcome

CELLS = (10, 8)
"""Along width and height of the image, in which corners are counted."""
_COVERED, _VIEWS = 0.75, 20
_TILTED, _SMALL, _NEAR_TO_FAR = np.sin(np.radians(15.0)), 0.15, 1.4
_NEW = 0.04  # of the image's diagonal, by which a view must differ from all others
_NEW_TILT = 0.15
_LARGE = 0.2  # spread of the corners over the image's height, of a board that fills it
FASTEST_PX_S = np.sqrt(12) * BLURRED_PX / 5e-3
"""Smears an exposure of 5 ms as much as is borne: a smear's standard deviation is its length over sqrt(12)."""
_MOST_VIEWS, _AWAY, _LOST = 120, 3, 6
_MORE = 1.3  # times as many views before a calibration is tried again
_THIRDS = (("upper left", "upper", "upper right"), ("left", "middle", "right"), ("lower left", "lower", "lower right"))
_TILTS = {"left": (1, 0), "right": (-1, 0), "upper": (0, 1), "lower": (0, -1)}
"""Edge that is nearer -> where the board's normal, which points to the camera, then points in the image."""
_SEARCH = {"phase": "searching", "advice": "The board is out of sight: show the whole of it to the camera."}


@value_class
class BoardState:
    """What there is to say of the images so far.

    Attributes
    ----------
    advice : one sentence
    phase : "waiting", "searching", "place", "tilt", "distance", "more", "trying" or "enough"
    pixels : (m, 2) corners in the last image that was looked at [px]
    resolution : (width, height) of it
    region : where the board is wanted, such as "lower left"; "" where it does not matter
    cells : (8, 10) how many corners were seen in each part of the image
    bars : what is needed -> how much of it is there
    blur_px, white : of the board in that image; nan where it was not found
    speed_px_s : of its corners, from one image to the next; nan where that is not looked at
    faults : what is wrong with it
    seconds, rate_hz : of the recording
    views : how many differ from each other
    confirmed : whether a calibration of the recording so far serves
    """

    advice: str = "Waiting for images."
    phase: str = "waiting"
    pixels: Floats = field(default_factory=lambda: np.empty((0, 2)))
    resolution: tuple[int, int] = (4, 3)
    region: str = ""
    cells: Floats = field(default_factory=lambda: np.zeros(CELLS[::-1]))
    bars: tuple[tuple[str, float], ...] = ()
    blur_px: float = float("nan")
    white: float = float("nan")
    speed_px_s: float = float("nan")
    faults: tuple[Fault, ...] = ()
    seconds: float = 0.0
    rate_hz: float = 0.0
    views: int = 0
    confirmed: bool = False

    @property
    def subject(self) -> str:
        """What the advice is about; a status that is not drawn again is printed where it changes."""
        return f"{self.phase} {self.region}"

    @property
    def known(self) -> str:
        """How much is there, in a few words."""
        return f", {self.views} view{'s' * (self.views != 1)}, corners in {np.mean(self.cells > 0):.0%} of the image"

    def document(self) -> dict[str, Any]:
        """Return it for the page."""
        found, speed = np.isfinite(self.blur_px), self.speed_px_s
        moved = [["speed", f"{speed:.0f} px/s", bool(speed <= FASTEST_PX_S)]] if np.isfinite(speed) else []
        return {
            "advice": self.advice,
            "phase": self.phase,
            "corners": np.round(self.pixels, 1).tolist(),
            "size": list(self.resolution),
            "region": self.region,
            "cells": self.cells.astype(int).tolist(),
            "bars": [[name, round(min(share, 9.0), 3)] for name, share in self.bars],
            "lights": [
                ["board", "found" if found else "not found", bool(found)],
                ["blur", f"{self.blur_px:.1f} px" if found else "?", bool(self.blur_px <= BLURRED_PX)],
                ["light", f"{self.white:.0f} of 255" if found else "?", bool(DARK <= self.white < BRIGHT)],
                *moved,
            ],
            "faults": [[fault.code, fault.text] for fault in self.faults],
            "seconds": round(self.seconds, 1),
            "rate_hz": round(self.rate_hz, 1),
            "views": self.views,
            "confirmed": self.confirmed,
        }


class BoardCoach:
    """Looks at images of a board, some of all that are recorded.

    Parameters
    ----------
    target : the board
    camera : its name
    """

    def __init__(self, target: Target, camera: str = "cam0") -> None:
        self.target, self.camera, self.state = target, camera, BoardState()
        self._views: list[tuple[int, BoardView]] = []
        self._places = np.empty((0, 8))
        self._cells = np.zeros(CELLS[::-1])
        self._lost, self._unlike = 0, ""
        self._unseen: list[Grey] = []
        self._tried, self._not_yet = 0, ""
        self._confirmed, self._seconds, self._speed_px_s = False, 0.0, float("nan")

    def look_at_image(
        self, t_ns: int, image: Grey, view: BoardView, statistics: ImageStatistics, *, seconds: float, rate_hz: float
    ) -> BoardState:
        """Take an image and what was found in it, and return what there is to say.

        Parameters
        ----------
        t_ns : when it was taken [ns]
        seconds, rate_hz : of the recording by now
        """
        odd = 2 * view.dropped.get(NOT_WITH_NEIGHBOURS, 0) > len(view)  # of a board with other rows or columns
        seen, self._seconds = len(view) >= FEWEST_CORNERS and not odd, seconds
        if seen:
            self._lost, self._unlike = 0, ""
            self.keep_view(t_ns, view, statistics.size)
        else:
            self._lost += 1
            self._unseen = [*self._unseen[-3:], image]
        needs = self._needs()
        said = self._said(needs, statistics.size) if seen or self._lost < _AWAY else _SEARCH
        self.state = BoardState(
            **said,
            pixels=view.pixels,
            resolution=statistics.size,
            cells=self._cells,
            bars=tuple(needs.items()),
            blur_px=view.blur_px,
            white=view.white,
            speed_px_s=self._speed_px_s,
            faults=tuple(self._faults(view, statistics, seen=seen)),
            seconds=seconds,
            rate_hz=rate_hz,
            views=len(self._views),
            confirmed=self._confirmed,
        )
        return self.state

    @property
    def wants_guess(self) -> list[Grey]:
        """Images in which the board was not found for long, once; empty else."""
        return self._unseen if self._lost == _LOST and not self._views else []

    def take_guess(self, words: str) -> None:
        """Take what another look at those images said of the board in them."""
        self._unlike = words

    @property
    def wants_trial(self) -> bool:
        """Whether the views so far may be enough."""
        count = len(self._views)
        return not self._confirmed and self.state.phase == "trying" and count >= _MORE * self._tried

    @property
    def in_sight(self) -> bool:
        """Whether the board was found in the image that was looked at last."""
        return self._lost == 0

    def recording_so_far(self, more: Sequence[tuple[int, BoardView]] = ()) -> Recording:
        """Return the views so far, and others, for a calibration."""
        self._tried = len(self._views)
        views = sorted(dict([*self._views, *more]).items())
        return Recording(imus={}, cameras={self.camera: frames_of(views, Camera.nominal(self.state.resolution))})

    def take_outcome(self, outcome: TrialOutcome) -> None:
        """Take what a calibration of the views said."""
        self._confirmed = outcome.verdict == "pass"
        self._not_yet = "" if self._confirmed else outcome.advice

    # ---- what was seen ----

    def keep_view(self, t_ns: int, view: BoardView, size: tuple[int, int]) -> None:
        """Keep a view that is sharp, and unlike all others."""
        self._count_corners(view, size)
        if view.blur_px > BLURRED_PX or len(self._views) >= _MOST_VIEWS:
            return
        exposures = gather_exposures(frames_of([(t_ns, view)], Camera.nominal(size)), self.target)
        if not len(exposures):  # on one line
            return
        middle, extent = view.pixels.mean(axis=0), view.pixels.std(axis=0)
        tilt = _tilt(*homography_poses(exposures, Camera.nominal(size)), self.target.points.mean(axis=0))
        place = np.concatenate([np.concatenate([middle, extent]) / (_NEW * np.hypot(*size)), tilt / _NEW_TILT, extent])
        apart = np.linalg.norm((self._places - place)[:, :6], axis=1)
        if not len(apart) or apart.min() > 1:
            self._places = np.vstack([self._places, place])
            self._views.append((t_ns, view))

    def _count_corners(self, view: BoardView, size: tuple[int, int]) -> None:
        cell = np.floor((view.pixels + 0.5) * (np.array(CELLS) / np.array(size))).astype(np.int64)
        np.add.at(self._cells, tuple(np.clip(cell, 0, np.array(CELLS) - 1).T[::-1]), 1)

    def _untilted(self) -> list[str]:
        """Return which edges of the board were not nearer to the camera yet."""
        tilts = self._places[:, 4:6] * _NEW_TILT
        return [edge for edge, way in _TILTS.items() if not (tilts @ np.array(way) > _TILTED).any()]

    def _needs(self) -> dict[str, float]:
        """Return what a calibration needs -> how much of it is there."""
        if not self._views:
            return {}
        size = np.linalg.norm(self._places[:, 6:], axis=1)
        return {
            "views": len(self._views) / _VIEWS,
            "image covered": float(np.mean(self._cells > 0)) / _COVERED,
            "tilted to four sides": 1 - len(self._untilted()) / 4,
            "near and far": float(size.max() / size.min()) / _NEAR_TO_FAR,
        }

    # ---- what to say ----

    def _said(self, needs: dict[str, float], size: tuple[int, int]) -> dict[str, Any]:
        """Return phase, region and advice."""
        if self._confirmed:
            return {"phase": "enough", "advice": "Enough: the lens is known well. Stop, or go on for more."}
        if not needs:
            return _SEARCH
        seen = np.argwhere(self._cells > 0)[:, ::-1].astype(np.float64)
        if (empty := unseen_corners(seen, CELLS)) or needs["image covered"] < 1:
            return _to_region(empty[0] if empty else self._emptiest())
        phase, advice = "trying", self._not_yet or "All was seen: a calibration is tried. Go on meanwhile."
        if needs["tilted to four sides"] < 1:
            edge = self._untilted()[0]
            phase, advice = "tilt", f"Tilt the board by about 30 degrees: its {edge} edge nearer to the camera."
        elif needs["near and far"] < 1:
            nearer = self._places[:, 6:].max() < _LARGE * min(size)
            phase = "distance"
            advice = f"Go {'nearer, until the board fills the image' if nearer else 'farther away'}."
        elif (more := _VIEWS - len(self._views)) > 0:
            phase, advice = "more", f"Go on, near and far, tilted to all sides; {more} more view{'s' * (more > 1)}."
        return {"phase": phase, "advice": advice}

    def _emptiest(self) -> str:
        """Return the region of the image in which the fewest parts were seen."""
        parts = [np.array_split(rows, 3, axis=1) for rows in np.array_split(self._cells > 0, 3, axis=0)]
        shares = np.array([[float(part.mean()) for part in row] for row in parts])
        row, column = np.unravel_index(int(np.argmin(shares)), shares.shape)
        return _THIRDS[row][column]

    def _faults(self, view: BoardView, statistics: ImageStatistics, *, seen: bool) -> list[Fault]:
        """Return why the board was not found, or what spoils this image."""
        white = view.white if seen else statistics.high
        found: list[Fault] = []
        if white < DARK:
            found.append(Fault(code="dark", text="It is too dark: light the board, or expose longer."))
        elif white >= BRIGHT and (seen or statistics.clipped > 0.5):
            found.append(Fault(code="bright", text="It is too bright: white is clipped. Expose shorter."))
        blur_px = view.blur_px if seen else statistics.blur_px
        if blur_px > (BLURRED_PX if seen else 2 * BLURRED_PX):
            text = f"The image is blurred ({blur_px:.1f} px): hold still, light it better, or focus."
            found.append(Fault(code="blurred", text=text))
        if seen and np.hypot(*np.ptp(view.pixels, axis=0)) < _SMALL * np.hypot(*statistics.size):
            found.append(Fault(code="small", text="The board is too small in the image: come nearer."))
        if not seen and self._unlike:
            text = f"The board was found in no image. {self._unlike}"
            found.append(Fault(code="other-board", text=text))
        return found


def frames_of(views: Sequence[tuple[int, BoardView]], camera: Camera) -> CameraFrames:
    """Return the corners of views with their timestamps [ns], as of a camera."""
    return CameraFrames(
        t_ns=np.array([t_ns for t_ns, _ in views], np.int64),
        frame=np.repeat(np.arange(len(views)), [len(view) for _, view in views]),
        point=np.concatenate([view.point for _, view in views]),
        pixels=np.concatenate([view.pixels for _, view in views]),
        sigma_px=np.concatenate([view.sigma_px for _, view in views]),
        camera=camera,
    )


def speed_of_corners(before: tuple[int, BoardView], after: tuple[int, BoardView]) -> float:
    """Return how fast the corners move that are in both of two views [px/s], their median; nan where none is."""
    (t0_ns, first), (t1_ns, second) = before, after
    _, of_first, of_second = np.intersect1d(first.point, second.point, assume_unique=True, return_indices=True)
    moved = np.linalg.norm(second.pixels[of_second] - first.pixels[of_first], axis=1)
    return float(np.median(moved)) / ((t1_ns - t0_ns) * 1e-9) if len(moved) and t1_ns > t0_ns else float("nan")


def _tilt(R_cam_target: Floats, p_cam_target: Floats, middle: Floats) -> Floats:
    """Return how the first board's normal differs from the way to the camera, to the right and down, (2,)."""
    ray = R_cam_target[0] @ middle + p_cam_target[0]
    ray /= np.linalg.norm(ray)
    normal = R_cam_target[0, :, 2]
    return (ray - normal * np.sign(normal @ ray))[:2]


def _to_region(region: str) -> dict[str, Any]:
    where = "middle" if region == "middle" else f"{region} {'corner' if ' ' in region else 'part'}"
    return {"phase": "place", "region": region, "advice": f"Move the board into the {where} of the image."}
