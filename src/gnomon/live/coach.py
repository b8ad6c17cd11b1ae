"""Tells a person what to do next with the sensor in the hand, or on a table: with an IMU, a magnetometer, for noise.

samples -> still or moving -> after each rest: what the rests would tell -> one sentence, one target
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from math import ceil
from typing import Any

import numpy as np

from ..assess.needs import judge_for_use, needs_of_use
from ..calibrate.imu import calibrate_imu
from ..detect.samples.stillness import quantisation_step
from ..errors import GnomonError
from ..frozen import value_class
from ..options.requirements import GENERAL, Use
from ..readers.recordings import samples_in_units
from ..readers.samples.recognise import WITH_RESTS
from ..readers.samples.stream import TRIADS
from ..readers.samples.table import Triad
from ..recording import Floats, ImuSamples, Integers, Recording, TriadSamples
from ..results.trust import Need
from ..units import Units
from .faults import Fault, faults_of
from .prospect import DIRECTIONS, Prospect, look_ahead, rate_unit_of

FIRST_REST_S = 20.0
_HOLD_S = 2.0
_WINDOW_S, _RECENT_S, _JUMP_S = 0.5, 1.5, 2.0
_STILL, _SHAKY = 10.0, 1e5  # times the level at rest, of s^2
_TURNING = 8.0  # times the gyroscope's noise
_FEWEST_RESTS = 12
_LEVELS, _FAR = 600, 1e9
_IDLE = 6.0  # times as long as a look at all rests took, until the next one
_MORE = 1.2  # times as many rests before a calibration is tried again
_PAST = frozenset({"gaps", "samples-lost"})
"""Findings that no more rests mend."""
_SIDES = {  # of a box whose z axis points out of its face, x to its front and y to its left
    (0, 0, 1): "flat, face up",
    (0, 0, -1): "flat, face down",
    (1, 0, 0): "upright, its front up",
    (-1, 0, 0): "upright, its back up",
    (0, 1, 0): "on its right edge",
    (0, -1, 0): "on its left edge",
}


@value_class
class CoachState:
    """What the coach has to say.

    Attributes
    ----------
    advice : one sentence
    phase : "waiting", "first rest", "turn", "hold", "shaking", or "enough"
    still_s : how long it rests by now
    up : (3,) where up is in the sensor now, None as long as nothing is known
    prospect : what the rests would tell
    counts : what is counted: rests, or directions of a field; "" where nothing is
    faults : what is wrong now
    seconds, rate_hz : of the recording
    confirmed : whether a calibration of the recording so far serves the use
    """

    advice: str = "Waiting for samples."
    phase: str = "waiting"
    still_s: float = 0.0
    up: Floats | None = None
    prospect: Prospect = field(default_factory=Prospect)
    counts: str = "rest"
    faults: tuple[Fault, ...] = ()
    seconds: float = 0.0
    rate_hz: float = 0.0
    confirmed: bool = False

    @property
    def subject(self) -> str:
        """What the advice is about; a status that is not drawn again is printed where it changes."""
        return f"{self.phase} {self.prospect.target}"

    @property
    def known(self) -> str:
        """How much is known, in a few words."""
        rests = len(self.prospect.up)
        worst = max((need.sigma / need.needed for need in self.prospect.needs), default=None)
        return f", {rests} {self.counts}{'s' * (rests != 1)}" * bool(self.counts) + (
            "" if worst is None else f", sigma {worst:.2g} of what is needed"
        )

    def document(self) -> dict[str, Any]:
        """Return it for the page."""
        target = self.prospect.target
        return {
            "advice": self.advice,
            "phase": self.phase,
            "still_s": round(self.still_s, 1),
            "hold_s": FIRST_REST_S if self.phase == "first rest" else _HOLD_S,
            "up": None if self.up is None else np.round(self.up, 3).tolist(),
            "target": None if target is None else np.round(target, 3).tolist(),
            "counts": self.counts,
            "rests": np.round(self.prospect.up, 3).tolist(),
            "bars": [[need.block, round(need.sigma / need.needed, 3)] for need in self.prospect.needs],
            "faults": [[fault.code, fault.text] for fault in self.faults],
            "seconds": round(self.seconds, 1),
            "rate_hz": round(self.rate_hz, 1),
            "confirmed": self.confirmed,
        }


class Coach:
    """Looks at the samples as they come.

    Parameters
    ----------
    use : what the sensor is for
    stated : units, as far as they are
    """

    counts, leading = "rest", "accelerometer"
    """What is counted, and the triad that tells motion from rest."""
    unwanted = "magnetometer"
    """The stream that is not recorded: of a folder, gnomon's commands read two files."""
    remembered = 500_000
    """How many samples of a triad are looked at, at least; up to twice as many are kept."""

    def __init__(self, use: Use, stated: Units | None = None) -> None:
        self._use, self._stated = use, stated or Units()
        self._triads = {name: _Growing() for name in TRIADS}
        self._first_ns: int | None = None
        self._named: dict[str, str | None] = {}
        self._told: dict[str, str] = {}
        self._levels: list[Floats] = []
        self._still_from: float | None = None
        self._looked, self._shaky = False, 0
        self._rate_unit: float | None = None
        self._factors: dict[str, float] = {}
        self._not_yet, self._tried = "", 0
        self._rested_s, self._cost_s = 0.0, 0.0
        self.state = CoachState(counts=self.counts)

    def add_samples(self, blocks: Mapping[str, TriadSamples], named: Mapping[str, str | None]) -> None:
        """Take the next samples of the triads, and the units that the lines name."""
        self._named |= dict(named)
        for name, block in blocks.items():
            self._triads[name].append_block(block)
            self._triads[name].keep_last(self.remembered)
            if name == self.leading and len(block) and self._first_ns is None:
                self._first_ns = int(block.t_ns[0])

    @property
    def samples(self) -> ImuSamples:
        """All samples so far, in units as a reader would tell them."""
        return self._in_units(None)

    def look_at_samples(self) -> CoachState:
        """Look at what came, and return what there is to say."""
        t_ns, values = self._triads[self.leading].rows
        if len(t_ns) < 2:
            return self.state
        kept_s, seconds = float(t_ns[-1] - t_ns[0]) * 1e-9, float(t_ns[-1] - (self._first_ns or 0)) * 1e-9
        rate_hz = (len(t_ns) - 1) / kept_s if kept_s > 0 else 0.0
        if seconds < 2 * _WINDOW_S:
            return self.state
        spread = self._spread(t_ns, values)
        self._notice_rest(seconds, still=spread < _STILL)
        still_s = 0.0 if self._still_from is None else seconds - self._still_from
        jumped = seconds - self.state.seconds > _JUMP_S  # a file that was there already, or sent faster than real time
        self.state = replace(
            self.state, seconds=seconds, rate_hz=rate_hz, still_s=still_s, up=_direction(values, rate_hz)
        )
        if self._is_due(seconds, still_s) or jumped:
            self._looked = still_s >= _HOLD_S
            before_s = time.thread_time()
            self._look_ahead()
            self._rested_s, self._cost_s = seconds, time.thread_time() - before_s
        faults = tuple(self._faults(still=still_s > _WINDOW_S))
        if self._not_yet:
            code, why = "not-yet", "A calibration of the recording so far is not enough"
            if self.state.confirmed:
                code, why = "stays", "More rests do not mend this"
            faults += (Fault(code=code, text=f"{why}: {self._not_yet}"),)
        self.state = replace(self.state, faults=faults)
        self.state = replace(self.state, **self._said(spread))
        return self.state

    def _is_due(self, seconds: float, still_s: float) -> bool:
        """Return whether to look at all rests again: after each of them, but most of the time goes to other things."""
        return still_s >= _HOLD_S and not self._looked and seconds - self._rested_s >= _IDLE * self._cost_s

    def _spread(self, t_ns: Integers, values: Floats) -> float:
        """Return s^2 of the last half second, over its level at rest."""
        first = int(np.searchsorted(t_ns, t_ns[-1] - int(_WINDOW_S * 1e9)))
        window = values[first:]
        variance = window.var(axis=0) + quantisation_step(window) ** 2 / 12 + 1e-300
        self._levels = [*self._levels[-_LEVELS:], variance]
        level = np.quantile(np.array(self._levels), 0.1, axis=0)
        spread = float(np.mean(np.minimum(variance / level, _FAR) ** 2))
        rates = self._triads["gyroscope"].rows[1][-len(window) :]
        if len(rates) > 4:  # turned about the vertical, too
            noise = np.std(np.diff(rates, axis=0), axis=0) / np.sqrt(2) + 1e-300
            third = len(rates) // 3
            moved = np.abs(rates[-third:].mean(axis=0) - rates[:third].mean(axis=0)) / noise
            spread = max(spread, _STILL * float(moved.max()) / _TURNING)
        return spread

    def _faults(self, *, still: bool) -> Iterator[Fault]:
        """Yield what is wrong with the last samples."""
        yield from faults_of(self._in_units(_RECENT_S), self._rate_unit, still=still)

    def _notice_rest(self, seconds: float, *, still: bool) -> None:
        if not still:
            self._still_from, self._looked = None, False
        elif self._still_from is None:
            self._still_from = max(0.0, seconds - _WINDOW_S)

    def _look_ahead(self) -> None:
        imu = self.samples
        if not len(imu.gyroscope):
            return
        self._rate_unit = rate_unit_of(imu)
        prospect = look_ahead(imu, self._use, self._factors)
        confirmed, rests = self.state.confirmed, len(prospect.up)
        if prospect.needs and not confirmed:
            serves, needs, why = self._tried_out(imu, prospect.needs)
            prospect = replace(prospect, needs=needs)
            if rests >= max(_FEWEST_RESTS, _MORE * self._tried) and _met(needs):
                self._tried, self._not_yet, confirmed = rests, why, serves
        self.state = replace(self.state, prospect=prospect, confirmed=confirmed)

    def _tried_out(self, imu: ImuSamples, foreseen: tuple[Need, ...]) -> tuple[bool, tuple[Need, ...], str]:
        """Return whether a calibration so far serves, what it reached, and why not; learn from the difference.

        What is past, such as a gap where the cable was pulled out, is told and holds nobody up.
        """
        try:
            calibration = calibrate_imu(Recording(imus={"imu0": imu})).calibration
        except GnomonError as error:
            return False, foreseen, str(error)
        needs = needs_of_use(calibration, self._use)
        reached = {need.block: need.sigma for need in needs}
        for need in foreseen:
            times = reached.get(need.block, need.sigma) / need.sigma
            self._factors[need.block] = self._factors.get(need.block, 1.0) * times
        judged = judge_for_use(calibration, None if self._use.name == GENERAL else self._use)
        wrong = [one for one in judged.assessment.findings if one.severity in {"problem", "warning"}]
        past = judged.verdict == "warn" and {finding.code for finding in wrong} <= _PAST
        serves = (judged.verdict == "pass" or past) and all(need.verdict == "pass" for need in needs)
        return serves, needs, f"{wrong[0].message} {wrong[0].cure}" if wrong else ""

    def _in_units(self, last_s: float | None) -> ImuSamples:
        """Return all samples, or those of the last seconds, in units as a reader would tell them."""
        streams: list[tuple[Integers, Triad] | None] = []
        for name in TRIADS:
            t_ns, values = self._triads[name].rows
            unit = self._named.get(name)
            if last_s is not None and len(t_ns):
                first = int(np.searchsorted(t_ns, t_ns[-1] - int(last_s * 1e9)))
                t_ns, values, unit = t_ns[first:], values[first:], unit or self._told.get(name)
            streams.append((t_ns, Triad(quantity=name, values=values, unit=unit)) if len(t_ns) else None)
        imu = samples_in_units((streams[0], streams[1], streams[2]), self._stated, WITH_RESTS, [])
        if last_s is None:  # of all samples it is told better than of the last few
            self._told = {"accelerometer": imu.accelerometer.unit, "gyroscope": imu.gyroscope.unit}
        return imu

    def _said(self, spread: float) -> dict[str, Any]:
        """Return phase and advice."""
        state = self.state
        rests, still_s = len(state.prospect.up), state.still_s
        if state.confirmed:
            return {"phase": "enough", "advice": "Enough: what is needed is reached. Stop, or go on for more."}
        if rests <= 1 and state.seconds < FIRST_REST_S + 2 and still_s > 0:
            left = FIRST_REST_S - still_s
            if left > 0:
                return {"phase": "first rest", "advice": f"Let it lie still on the table for {ceil(left)} s more."}
        if still_s > 0 and still_s < _HOLD_S:
            return {"phase": "hold", "advice": f"Hold still, {ceil(_HOLD_S - still_s)} s more."}
        self._shaky = self._shaky + 1 if still_s == 0 and spread < _SHAKY else 0
        if self._shaky > 2:
            return {"phase": "shaking", "advice": "It shakes: put it down or lean it against something, and let go."}
        more = _FEWEST_RESTS - rests
        met = state.prospect.needs and _met(state.prospect.needs)
        why = f"{more} more rest{'s' * (more > 1)} to be sure" if met and more > 0 else "any new attitude counts"
        return {"phase": "turn", "advice": f"Put it {words_of_attitude(state.prospect.target)}; {why}."}


def _met(needs: tuple[Need, ...]) -> bool:
    return all(need.sigma <= need.needed for need in needs)


class _Growing:
    """Rows that grow at their end."""

    def __init__(self) -> None:
        self.count = 0
        self._t_ns, self._values = np.empty(1024, np.int64), np.empty((1024, 3))

    @property
    def rows(self) -> tuple[Integers, Floats]:
        """Stamps (n,) and values (n, 3)."""
        return self._t_ns[: self.count], self._values[: self.count]

    def keep_last(self, count: int) -> None:
        """Forget all rows but the last ones, where there are twice as many."""
        if self.count > 2 * count:
            first = self.count - count
            self._t_ns[:count], self._values[:count] = self._t_ns[first : self.count], self._values[first : self.count]
            self.count = count

    def append_block(self, block: TriadSamples) -> None:
        """Add samples."""
        after = self.count + len(block)
        if after > len(self._t_ns):
            size = max(2 * len(self._t_ns), after)
            self._t_ns = np.concatenate([self._t_ns, np.empty(size - len(self._t_ns), np.int64)])
            self._values = np.concatenate([self._values, np.empty((size - len(self._values), 3))])
        self._t_ns[self.count : after], self._values[self.count : after] = block.t_ns, block.values
        self.count = after


def _direction(values: Floats, rate_hz: float) -> Floats | None:
    mean = values[-max(1, round(0.2 * rate_hz)) :].mean(axis=0)
    size = float(np.linalg.norm(mean))
    return mean / size if size > 0 else None


def words_of_attitude(up: Floats | None) -> str:
    """Return how to lay a box so that a direction of it points up.

    Examples
    --------
    >>> words_of_attitude(np.array([0.0, -1.0, 0.0]))
    'on its left edge (-y up)'
    >>> words_of_attitude(np.array([0.7, 0.0, 0.7]))
    'between upright, its front up, and flat, face up (+x +z up)'
    """
    if up is None:
        return "down in another attitude"
    large = [axis for axis in range(3) if abs(up[axis]) > 0.3]
    sides = [_SIDES[tuple(int(np.sign(up[axis])) * (axis == k) for k in range(3))] for axis in large]  # pyright: ignore[reportArgumentType]
    axes = " ".join(f"{'+' if up[axis] > 0 else '-'}{'xyz'[axis]}" for axis in large)
    if len(sides) == 1:
        return f"{sides[0]} ({axes} up)"
    return f"between {', '.join(sides[:-1])}, and {sides[-1]} ({axes} up)"


_UNIT = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
_TURNED_S = 60.0
_EVERY = 50  # samples
_NIGHT_S = 3 * 3600.0
_MOVED_S = 5.0


class MagnetometerCoach(Coach):
    """Asks for the directions of the field in the sensor that were not seen yet."""

    counts, leading, unwanted = "direction", "magnetometer", "gyroscope"

    def _is_due(self, seconds: float, still_s: float) -> bool:
        return seconds - self._rested_s >= 1.0

    def _look_ahead(self) -> None:
        """Count which of 26 directions the field came near to, about the middle of what was seen."""
        values = self._triads[self.leading].rows[1][::_EVERY]
        low, high = values.min(axis=0), values.max(axis=0)
        half = 0.5 * (high - low)
        if not (half > 0).all() or half.max() > 3 * half.min():  # one axis was hardly turned so far
            target = np.eye(3)[int(np.argmin(half))]
            self.state = replace(self.state, prospect=Prospect(target=target))
            return
        seen = (values - 0.5 * (low + high)) / half
        seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
        nearest = np.argmax(seen @ _UNIT.T, axis=1)
        found = np.unique(nearest)
        count = np.bincount(nearest, minlength=len(_UNIT))
        target = None if len(found) == len(_UNIT) else _UNIT[int(np.argmin(count))]
        prospect = Prospect(up=_UNIT[found], target=target)
        enough = target is None and self.state.seconds >= _TURNED_S
        self.state = replace(self.state, prospect=prospect, confirmed=enough)

    def _faults(self, *, still: bool) -> Iterator[Fault]:
        yield from (fault for fault in super()._faults(still=False) if fault.code not in {"no-gyroscope", "throttled"})

    def _said(self, spread: float) -> dict[str, Any]:
        target, seen = self.state.prospect.target, len(self.state.prospect.up)
        if self.state.confirmed:
            return {"phase": "enough", "advice": "Enough: all directions were seen. Stop, or go on for more."}
        if target is None:
            return {"phase": "turn", "advice": f"Go on turning it slowly, to {_TURNED_S:.0f} s in all."}
        axes = words_of_attitude(target).rpartition("(")[2].removesuffix(" up)")
        where = f"{seen} of {len(_UNIT)} directions seen" if seen else "all of its sides are wanted"
        return {
            "phase": "turn",
            "advice": f"Turn it slowly, far from iron, until {axes} points along the field; {where}.",
        }


class NoiseCoach(Coach):
    """Watches a sensor that is to be left alone, and says when somebody touched it."""

    counts, remembered = "", 20_000
    _touched_s = 0.0

    def _is_due(self, seconds: float, still_s: float) -> bool:
        return False

    def _look_ahead(self) -> None:
        """Nothing is foreseen of noise."""

    def _faults(self, *, still: bool) -> Iterator[Fault]:
        yield from (fault for fault in super()._faults(still=False) if fault.code != "throttled")

    def _said(self, spread: float) -> dict[str, Any]:
        seconds = self.state.seconds
        if self.state.still_s == 0 and seconds > _MOVED_S:
            self._touched_s = seconds
        left = self._touched_s + _NIGHT_S - seconds
        if left <= 0:
            self.state = replace(self.state, confirmed=True)
            return {"phase": "enough", "advice": "Enough: it lay still for three hours. Stop, or go on for more."}
        why = f" It was touched at {self._touched_s:.0f} s; three hours count from there." if self._touched_s else ""
        return {"phase": "hold", "advice": f"Leave it alone for {left / 60:.0f} min more.{why}"}
