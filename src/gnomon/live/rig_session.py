"""A guided capture of a camera with an IMU: both are recorded, and both are looked at together."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from ..assess.checks.image_checks import ImageStatistics
from ..detect.boards.board import BoardView
from ..models.camera import Camera
from ..models.target import Target
from ..options.requirements import Use
from ..recording import Recording
from ..units import ACCELEROMETER_UNITS_M_S2, Units
from .board_coach import BoardCoach, BoardState, frames_of, speed_of_corners
from .camera_session import CameraSession
from .coach import Coach
from .faults import Fault
from .image_sources import ImageSource
from .prospect import rate_unit_of
from .session import LiveSession
from .sources import LiveSource
from .trials import TrialOutcome

_SHORTEST_S, _AGAIN_S, _LATER_S, _LONGEST_S, _LAST_TRY_S = 30.0, 10.0, 30.0, 120.0, 1200.0
_CHECK_S, _CHECK_TURNED_S, _CHECK_VIEWS = 0.5, 1.0, 30
_STEADY, _STEADY_S = 0.1, 1.0  # by which calibrations may differ for each second between them; least seconds
_CHECK_SHARE = 0.2  # of the recording so far, that passes until the next check
_FAST_RAD_S, _STRONG_M_S2, _MOVED_S = 0.3, 1.0, 3.0
_AFTER_S = 3.0  # until what was asked for last is done, and tells all that it can
_UNTILTED_S = 45.0  # from when on a calibration is tried of a rig that is not turned by 90 degrees
_TILTED_RAD, _UNLIKE_RAD = np.radians(70.0), 0.1
_MEAN_NS = 10**9  # over which a motion to and fro leaves gravity


class MotionCoach(Coach):
    """Adds up for how long an IMU was turned about each of its axes, and accelerated along them.

    Attributes
    ----------
    turned_s, shaken_s : (3,) faster than 0.3 rad/s, and by more than 1 m/s^2 [s]
    up : (k, 3) directions in the IMU that pointed up, means of a second each, each unlike the others
    """

    remembered = 20_000

    def __init__(self, use: Use, stated: Units | None = None) -> None:
        super().__init__(use, stated)
        self.turned_s, self.shaken_s, self.up = np.zeros(3), np.zeros(3), np.empty((0, 3))
        self._counted_ns = 0

    def _is_due(self, seconds: float, still_s: float) -> bool:
        return True

    def _look_ahead(self) -> None:
        """Count what came since the last look."""
        imu = self.samples
        unit, force_unit = rate_unit_of(imu), ACCELEROMETER_UNITS_M_S2[imu.accelerometer.unit]
        last = imu.accelerometer.values[imu.accelerometer.t_ns > imu.accelerometer.t_ns[-1] - _MEAN_NS].mean(axis=0)
        up = last / (np.linalg.norm(last) or 1.0)
        if (self.up @ up < np.cos(_UNLIKE_RAD)).all():
            self.up = np.vstack([self.up, up])
        since_ns, self._counted_ns = self._counted_ns, int(imu.accelerometer.t_ns[-1])
        for samples, factor, limit, counted in (
            (imu.gyroscope, unit, _FAST_RAD_S, self.turned_s),
            (imu.accelerometer, force_unit, _STRONG_M_S2, self.shaken_s),
        ):
            new = samples.values[samples.t_ns > since_ns]
            if factor is not None and len(new) > 1:
                moved = np.abs(factor * (new - (new.mean(axis=0) if samples is imu.accelerometer else 0))) > limit
                np.add(counted, moved.mean(axis=0) * len(new) / samples.rate_hz, out=counted)

    @property
    def tilted_rad(self) -> float:
        """The largest angle between two directions that pointed up."""
        return float(np.arccos(np.clip(np.min(self.up @ self.up.T, initial=1.0), -1, 1)))

    def _faults(self, *, still: bool) -> Iterator[Fault]:
        return super()._faults(still=False)

    def _said(self, spread: float) -> dict[str, Any]:
        return {"phase": "turn", "advice": ""}


class RigCoach(BoardCoach):
    """Asks for the motions that a camera with an IMU needs, in sight of a board.

    Parameters
    ----------
    target : the board
    lens : of the camera
    motion : of the IMU
    camera : its name
    """

    def __init__(self, target: Target, lens: Camera, motion: MotionCoach, camera: str = "cam0") -> None:
        super().__init__(target, camera)
        self._lens, self._motion = lens, motion
        self._tried_s = self._checked_s = self._asked_s = 0.0
        self._again_s, self._reached_s = _AGAIN_S, 0.0
        self._setup: tuple[Fault, ...] = ()
        self._foreseen: tuple[tuple[str, float], ...] = ()

    def keep_view(self, t_ns: int, view: BoardView, size: tuple[int, int]) -> None:
        """Keep what is seen in an image, of the last two minutes."""
        self._count_corners(view, size)
        self._speed_px_s = speed_of_corners(self._views[-1], (t_ns, view)) if self._views else float("nan")
        self._views.append((t_ns, view))
        first = int(np.searchsorted([t for t, _ in self._views[:64]], t_ns - _LONGEST_S * 1e9))
        del self._views[:first]

    def recording_so_far(self, more: Sequence[tuple[int, BoardView]] = ()) -> Recording:
        """Return the corners of the last two minutes."""
        self._checked_s = self.state.seconds
        if self.wants_calibration:
            self._tried_s = self.state.seconds
        return Recording(imus={}, cameras={self.camera: frames_of([*self._views, *more], self._lens)})

    @property
    def wants_calibration(self) -> bool:
        """Whether the motion so far may be enough, or still is."""
        done = self.state.phase == "trying" and self._seconds - self._asked_s >= _AFTER_S
        tried = done or (self.state.phase == "roll" and self._seconds >= _UNTILTED_S)
        return (self._confirmed or tried) and self.state.seconds - self._tried_s >= self._again_s

    @property
    def wants_trial(self) -> bool:
        """Whether the motion so far may be enough, or tells what an early check can find; not of a long recording."""
        due = self.state.seconds - self._checked_s >= max(_CHECK_S, _CHECK_SHARE * self._checked_s)
        moved = float(self._motion.turned_s.sum()) >= _CHECK_TURNED_S and len(self._views) >= _CHECK_VIEWS
        return self.state.seconds <= _LAST_TRY_S and (self.wants_calibration or (due and moved))

    def take_outcome(self, outcome: TrialOutcome) -> None:
        """Take what a check or a calibration of the recording so far said."""
        self._setup = outcome.faults
        if outcome.verdict:
            was = self._confirmed
            super().take_outcome(outcome)
            before, self._foreseen = dict(self._foreseen), outcome.needs
            reached = self._confirmed and all(ratio <= 1 for _, ratio in outcome.needs)
            change, self._reached_s = _STEADY * (self._tried_s - self._reached_s), self._tried_s
            steady = all(abs(before.get(name, 9.0) - ratio) <= change * ratio for name, ratio in outcome.needs)
            self._confirmed = reached and (steady or was)  # what still changes predicts nothing
            self._again_s = _LATER_S if self._confirmed else _STEADY_S if reached else _AGAIN_S

    def _faults(self, view: BoardView, statistics: ImageStatistics, *, seen: bool) -> list[Fault]:
        return [*self._setup, *super()._faults(view, statistics, seen=seen)]

    def _needs(self) -> dict[str, float]:
        found = {
            **{f"turned about {axis}": s / _MOVED_S for axis, s in zip("xyz", self._motion.turned_s, strict=True)},
            **{f"shaken along {axis}": s / _MOVED_S for axis, s in zip("xyz", self._motion.shaken_s, strict=True)},
            "quarter turn": self._motion.tilted_rad / _TILTED_RAD,
            "length": self._seconds / _SHORTEST_S,
        }
        return found | {f"precision: {name}": 1 / ratio for name, ratio in self._foreseen}

    def _said(self, needs: dict[str, float], size: tuple[int, int]) -> dict[str, Any]:
        if self._confirmed:
            return {"phase": "enough", "advice": "Enough: what is needed is reached. Stop, or go on for more."}
        for what, (phase, say) in _MOTIONS.items():
            missing = [name[-1] for name, share in needs.items() if name.startswith(what) and share < 1]
            if missing:
                self._asked_s = self._seconds
                return {"phase": f"{phase} {missing[0]}", "advice": say.format(axis=missing[0])}
        if needs["quarter turn"] < 1:
            self._asked_s = self._seconds
            return {"phase": "roll", "advice": _ROLL}
        if needs["length"] < 1:
            left = _SHORTEST_S - self._seconds
            return {"phase": "more", "advice": f"Go on turning and shaking in front of the board, {ceil(left)} s more."}
        if self._seconds > _LAST_TRY_S:
            return {"phase": "trying", "advice": "Enough time has passed: stop, and see what comes of all of it."}
        return {"phase": "trying", "advice": self._not_yet or "Go on: a calibration is tried meanwhile."}


_ROLL = (
    "Turn it slowly by 90 degrees about the way the camera looks, and back, with the board in sight: gravity "
    "tells more where it points to another side of the IMU."
)
_MOTIONS = {
    "turned": ("turn", "Turn it to and fro about the IMU's {axis} axis, briskly, with the board in sight."),
    "shaken": ("shake", "Move it to and fro along the IMU's {axis} axis, briskly, with the board in sight."),
}


class RigSession(CameraSession):
    """Records images and samples, and says what to do next.

    Parameters
    ----------
    source, samples : of the images, and of the IMU
    folder : to record in
    target : the board
    lenses : of the cameras, cam0 among them; those without one are recorded, and not guided
    use : what both are for
    units : of the samples, as far as they are stated
    """

    looks, joined = 15, False

    def __init__(
        self,
        source: ImageSource,
        samples: LiveSource,
        folder: Path,
        target: Target,
        *,
        lenses: Mapping[str, Camera],
        use: Use,
        units: Units | None = None,
    ) -> None:
        self._use, self._units, self._lenses = use, units, lenses
        self.samples = LiveSession(samples, folder, use, units=units, coach=MotionCoach, name="imu0")
        super().__init__(source, folder, target)
        self.trace = self.samples.trace

    def _coach(self, camera: str) -> BoardCoach | None:
        motion = self.samples.coach
        assert isinstance(motion, MotionCoach)
        return RigCoach(self._target, self._lenses[camera], motion, camera) if camera in self._lenses else None

    def begin_recording(self) -> None:
        """Begin to receive both, each in a thread of its own."""
        with suppress(OSError):  # it records without checks, too
            self._ready_trials()  # ready when the motion begins to tell something
        self.samples.begin_recording()
        super().begin_recording()

    def end_recording(self) -> None:
        """Stop receiving, and close the files."""
        super().end_recording()
        self.samples.end_recording()

    @property
    def recorded(self) -> str:
        """What was recorded."""
        return f"{super().recorded} and {self.samples.recorded}"

    @property
    def empty(self) -> bool:
        """Whether images or samples are missing."""
        return super().empty or self.samples.empty

    def take_arrivals(self) -> None:
        """Hand the samples that arrived to the coach and to the page; images wait until they are looked at."""
        self.samples.take_arrivals()

    def look_at_arrivals(self) -> BoardState:
        """Look at what arrived, and return what there is to say."""
        self.samples.look_at_arrivals()
        return super().look_at_arrivals()

    def troubles(self) -> list[Fault]:
        """Return why nothing can be said, and what is wrong with the sources, most important first."""
        return [*super().troubles(), *self.samples.troubles(), *self.samples.coach.state.faults]

    def _begin_trial(self, coaches: list[BoardCoach]) -> None:
        (coach,) = coaches
        assert isinstance(coach, RigCoach)
        more = coach.wants_calibration  # asked first: what is recorded so far counts as tried
        recording, trials = coach.recording_so_far(), self._ready_trials()
        trials.begin(recording, coach.target, self._use, self.folder, units=self._units, calibrates=more)
