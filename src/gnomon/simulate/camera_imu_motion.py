"""Motions of a rig before a board: which sinusoids, how large, drawn at random.

Hand-held motions turn and shake most at low frequencies; turns and shakes are scaled so that the mean rate and the mean
acceleration are the stated ones, whatever was drawn.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.quaternion import Floats
from .camera_imu_path import COORDINATES, SHAKES, TURNS, CameraPath, motion_of
from .camera_imu_scenario import CameraImuScenario, MotionName

_CHECKS_HZ, _CHECKED_S = 25.0, 120.0
"""Instants at which means are taken, and the longest time for which."""

_SCALINGS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class _Band:
    """Sinusoids of some coordinates: `size` is the rms of each [rad or m], and amplitudes fall as frequency^-fall."""

    coordinates: tuple[int, ...]
    size: float
    low_hz: float
    high_hz: float
    sinusoids: int = 5
    fall: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Style:
    """Bands of a motion; turns and shakes of `scaled` are scaled to the mean rate and acceleration, where stated."""

    scaled: tuple[_Band, ...] = ()
    added: tuple[_Band, ...] = ()
    mean_rate_rad_s: float | None = None
    mean_acceleration_m_s2: float | None = None
    turning_rad_s: float = 0.0


_ORBIT = (_Band(coordinates=(0, 1), size=0.1, low_hz=0.03, high_hz=0.12, sinusoids=3),)
_RANGE = (_Band(coordinates=(2,), size=0.05, low_hz=0.1, high_hz=0.5, sinusoids=3),)
_ROLL = _Band(coordinates=(3,), size=0.25, low_hz=0.1, high_hz=0.8)


def _by_hand(turns_to_hz: float, shakes_to_hz: float) -> tuple[_Band, ...]:
    return (
        _ROLL,
        _Band(coordinates=(4, 5), size=0.07, low_hz=0.15, high_hz=turns_to_hz),
        _Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=shakes_to_hz, fall=1.5),
    )


_NORMAL = _Style(scaled=_by_hand(2.5, 2.5), added=_ORBIT + _RANGE, mean_rate_rad_s=0.75, mean_acceleration_m_s2=3.9)
_STYLES: dict[MotionName, _Style] = {
    "gentle": _Style(
        scaled=_by_hand(1.2, 2.0), added=_ORBIT + _RANGE, mean_rate_rad_s=0.366, mean_acceleration_m_s2=3.12
    ),
    "normal": _NORMAL,
    "tremor": _Style(
        scaled=_NORMAL.scaled,
        added=(
            *_NORMAL.added,
            _Band(coordinates=TURNS, size=1.2e-3, low_hz=6.0, high_hz=12.0, sinusoids=4),
            _Band(coordinates=SHAKES, size=1.5e-4, low_hz=6.0, high_hz=12.0, sinusoids=4),
        ),
        mean_rate_rad_s=0.75,
        mean_acceleration_m_s2=3.9,
    ),
    "shaky": _Style(
        scaled=(
            *_NORMAL.scaled,
            _Band(coordinates=TURNS, size=0.01, low_hz=3.0, high_hz=20.0, sinusoids=6, fall=2.0),
            _Band(coordinates=SHAKES, size=0.004, low_hz=3.0, high_hz=20.0, sinusoids=6, fall=2.5),
        ),
        added=_ORBIT + _RANGE,
        mean_rate_rad_s=1.5,
        mean_acceleration_m_s2=10.0,
    ),
    "slow": _Style(
        scaled=(_ROLL, _Band(coordinates=(4, 5), size=0.07, low_hz=0.05, high_hz=0.3)),
        added=(_Band(coordinates=(0, 1), size=0.08, low_hz=0.02, high_hz=0.05, sinusoids=3),),
        mean_rate_rad_s=0.05,
    ),
    "static": _Style(),
    "one-axis": _Style(
        scaled=(_ROLL, _Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=2.5, fall=1.5)),
        mean_rate_rad_s=0.5,
        mean_acceleration_m_s2=3.9,
    ),
    "translation": _Style(
        scaled=(_Band(coordinates=SHAKES, size=0.06, low_hz=0.4, high_hz=2.5, fall=1.5),),
        added=_RANGE,
        mean_acceleration_m_s2=3.9,
    ),
    "rolling": _Style(
        scaled=_NORMAL.scaled[1:],
        added=_NORMAL.added,
        mean_rate_rad_s=1.0,
        mean_acceleration_m_s2=3.9,
        turning_rad_s=0.6,
    ),
}
_LEAST_TURNS = 3


def drawn_path(scenario: CameraImuScenario, middle: Floats, T_cam_imu: Floats, rng: np.random.Generator) -> CameraPath:
    """Draw the path of cam0.

    Parameters
    ----------
    scenario : what to simulate
    middle : (3,) of the board [m]
    T_cam_imu : (4, 4) of the IMU whose mean acceleration the motion states
    rng : random numbers
    """
    style = _STYLES[scenario.motion]
    offset, slope = np.zeros(len(COORDINATES)), np.zeros(len(COORDINATES))
    offset[2] = scenario.distance_m
    if style.turning_rad_s:
        slope[3] = max(style.turning_rad_s, 2 * np.pi * _LEAST_TURNS / scenario.duration_s)
        offset[3] = rng.uniform(0, 2 * np.pi)
    drawn = [_sinusoids(band, rng) for band in style.scaled + style.added]
    path = CameraPath(
        middle=middle,
        offset=offset,
        slope=slope,
        pulsation=np.concatenate([np.empty(0), *(part[0] for part in drawn)]),
        phase=np.concatenate([np.empty(0), *(part[1] for part in drawn)]),
        amplitude=np.concatenate([np.empty((len(COORDINATES), 0)), *(part[2] for part in drawn)], axis=1),
    )
    scaled = sum(len(part[0]) for part in drawn[: len(style.scaled)])
    return _scaled(path, scaled, style, T_cam_imu, scenario.duration_s)


def _sinusoids(band: _Band, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return pulsation (k,), phase (k,) and amplitude (9, k); frequencies are spread evenly on a logarithmic scale."""
    count = len(band.coordinates) * band.sinusoids
    place = (np.tile(np.arange(band.sinusoids), len(band.coordinates)) + rng.random(count)) / band.sinusoids
    frequency_hz = band.low_hz * (band.high_hz / band.low_hz) ** place
    amplitude = np.zeros((len(COORDINATES), count))
    for i, coordinate in enumerate(band.coordinates):
        own = slice(i * band.sinusoids, (i + 1) * band.sinusoids)
        weight = frequency_hz[own] ** -band.fall
        amplitude[coordinate, own] = band.size * np.sqrt(2) * weight / np.linalg.norm(weight)
    return 2 * np.pi * frequency_hz, rng.uniform(0, 2 * np.pi, count), amplitude


def _scaled(path: CameraPath, count: int, style: _Style, T_cam_imu: Floats, duration_s: float) -> CameraPath:
    """Return the path with the turns and shakes among its first `count` sinusoids scaled to the style's means."""
    if style.mean_rate_rad_s is None and style.mean_acceleration_m_s2 is None:
        return path
    t_s = np.linspace(0, duration_s, 1 + int(_CHECKS_HZ * min(duration_s, _CHECKED_S)))
    free = path.amplitude.copy()
    free[:, :count] = 0.0
    scaled = path.amplitude - free
    rest = replace(path, amplitude=free).coordinates(t_s)
    extra = replace(path, amplitude=scaled, slope=0 * path.slope, offset=0 * path.offset).coordinates(t_s)

    def means(turn: float, shake: float) -> tuple[float, float]:
        size = _sizes(turn, shake)
        motion = motion_of(path.middle, *(a + size * b for a, b in zip(rest, extra, strict=True))).of(T_cam_imu)
        return _mean_norm(motion.omega), _mean_norm(motion.acceleration)

    turn = shake = 1.0
    for _ in range(_SCALINGS):
        rate, acceleration = means(turn, shake)
        if style.mean_rate_rad_s is not None:
            turn *= _factor(style.mean_rate_rad_s, rate, means(0.0, shake)[0])
        if style.mean_acceleration_m_s2 is not None:
            shake *= _factor(style.mean_acceleration_m_s2, acceleration, means(turn, 0.0)[1])
    return replace(path, amplitude=free + _sizes(turn, shake) * scaled)


def _sizes(turn: float, shake: float) -> Floats:
    sizes = np.ones((len(COORDINATES), 1))
    sizes[list(TURNS)], sizes[list(SHAKES)] = turn, shake
    return sizes


def _factor(target: float, found: float, without: float) -> float:
    """Return by what to multiply a part that adds to the rest like independent signals do."""
    own, wanted = found**2 - without**2, target**2 - without**2
    return float(np.sqrt(np.clip(wanted / own, 0.01, 100.0))) if own > 0 else 1.0


def _mean_norm(v: Floats) -> float:
    return float(np.linalg.norm(v, axis=1).mean())
