"""What gets between a camera and a board: hands and cables, as outlines in the image that move."""

from dataclasses import dataclass

import numpy as np

from ..recording import Floats

_POINTS = 48  # of an outline


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cover:
    """One of them; all numbers in px but for those of time.

    Attributes
    ----------
    outline : (n, 2) about its middle
    middle : (2,) of its way
    swing : (2,) how far it moves to both sides
    pulsation, phase : (2,) of the swing [rad/s], [rad]
    """

    outline: Floats
    middle: Floats
    swing: Floats
    pulsation: Floats
    phase: Floats

    def at(self, t_s: float) -> Floats:
        return self.outline + self.middle + self.swing * np.sin(self.pulsation * t_s + self.phase)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingCovers:
    """Hands and cables before a board."""

    covers: tuple[_Cover, ...]

    def at(self, t_s: float) -> list[Floats]:
        """Return their outlines (n, 2) [px] at an instant, for `gnomon.simulate.rendering.render`."""
        return [cover.at(t_s) for cover in self.covers]


def moving_covers(count: int, seed: tuple[int, ...], resolution: tuple[int, int]) -> MovingCovers | None:
    """Return so many of them, hands and cables in turn; None for none.

    Parameters
    ----------
    count : of hands and cables
    seed : every random number follows from it
    resolution : (width, height) of the images [px]
    """
    if not count:
        return None
    rng, size = np.random.default_rng([*seed, count]), np.array(resolution, dtype=np.float64)
    covers = [
        _Cover(
            outline=(_hand if k % 2 == 0 else _cable)(size, rng),
            middle=size * rng.uniform(0.15, 0.85, 2),
            swing=size * rng.uniform(0.1, 0.4, 2),
            pulsation=rng.uniform(0.3, 1.5, 2),
            phase=rng.uniform(0, 2 * np.pi, 2),
        )
        for k in range(count)
    ]
    return MovingCovers(covers=tuple(covers))


def _hand(size: Floats, rng: np.random.Generator) -> Floats:
    """Return a lump with fingers."""
    angle = np.linspace(0, 2 * np.pi, _POINTS, endpoint=False)
    fingers = 0.25 * np.cos(rng.integers(4, 7) * angle + rng.uniform(0, 6)) + 0.15 * np.cos(2 * angle)
    radius = size.min() * rng.uniform(0.06, 0.12) * (1 + fingers)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _cable(size: Floats, rng: np.random.Generator) -> Floats:
    """Return a thin band across the image, bent."""
    along = np.linspace(-0.8, 0.8, _POINTS // 2) * np.linalg.norm(size)
    bent = size.min() * rng.uniform(0.05, 0.15) * np.sin(along / size.min() * rng.uniform(2, 5) + rng.uniform(0, 6))
    half, turn = size.min() * rng.uniform(0.006, 0.015), rng.uniform(0, np.pi)
    band = np.concatenate([np.column_stack([along, bent + half]), np.column_stack([along[::-1], bent[::-1] - half])])
    return band @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
