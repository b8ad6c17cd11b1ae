"""Coaches for what takes no rests: a magnetometer that is turned slowly, and a sensor that is left alone."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from .coach import Coach, words_of_attitude
from .faults import Fault
from .prospect import DIRECTIONS, Prospect

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
