"""What the timestamps of a video are worth: a clock, or a number of frames.

What is said about the rate of a platter: its clock, its steady part, its evenness, its pattern.

How far the platter turns while its picture repeats itself once: by how the pattern moves in the image.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...findings import Finding, make_finding
from ...frozen import value_class
from ...recording import Floats, Integers
from .phase import PhaseTemplate

if TYPE_CHECKING:
    from .rate import PlatterRate


MEASURED_CLOCK, NOMINAL_CLOCK, UNCHECKED_CLOCK = 5e-5, 1e-3, 5e-3
"""Relative standard deviation of the time that timestamps tell: by a quartz that stamped the frames; by a frame rate
that the video merely states (29.97 against 30 frames per second, and what cameras make of it); the same where frames
may be missing, unnoticed."""

_ROUNDING_S = 6e-4  # Matroska rounds to 1 ms
_FEWEST = 8
_EVEN_S = 1e-6


def stamps_are_nominal(t_s: Floats) -> bool:
    """Tell whether frames stand at even times, so that the video states a frame rate and no times."""
    if len(t_s) < _FEWEST:
        return True
    steps = np.diff(t_s)
    step = float(np.median(steps))
    off = t_s - t_s[0]
    for _ in range(3):  # frames may be missing
        number = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / step), 1))])
        step, start = np.polyfit(number, t_s, 1).tolist()
        off = t_s - start - step * number
    return bool(np.abs(off).max() < _ROUNDING_S)


def rate_by_jitter(t_s: Floats, off: Floats) -> tuple[float, float]:
    """Return by how much the phase changes more with irregular timestamps than a line has it, and its sigma [rad/s].

    Between two frames a platter may have made whole turns more than it seems. Where frames come irregularly, its
    phase then runs ahead and behind with them.

    Parameters
    ----------
    t_s : (n,) timestamps [s]
    off : (n,) phase less that of a line [rad]
    """
    uneven = np.diff(t_s, 2)
    bent = np.diff(off, 2)
    usual = np.abs(uneven - np.median(uneven)) < 8 * np.median(np.abs(uneven - np.median(uneven))) + 1e-9
    kept = usual & (np.abs(bent) < 1.0)
    x, y = uneven[kept], bent[kept]
    power = float(x @ x)
    if len(x) < 20 or power <= len(x) * _EVEN_S**2:
        return 0.0, np.inf
    slope = float(x @ y) / power
    spread = float(np.sqrt(np.mean((y - slope * x) ** 2)))
    return slope, spread * np.sqrt(3.0 / power)  # of second differences every third is new


def missing_frames(step_s: float, index: Integers, t_s: Floats, phase: Floats) -> tuple[Integers, float]:
    """Return how many frames are missing before each one, in a video whose timestamps merely count frames.

    Where one is missing the phase makes two steps at once, where one is repeated none.

    Parameters
    ----------
    step_s : from frame to frame, as the video states it [s]
    index : (n,) numbers of the frames in the video
    t_s : (n,) their timestamps [s]
    phase : (n,) [rad], unwrapped

    Returns
    -------
    missing : (n,) since the first
    clearness : the usual step of the phase, in units of its noise
    """
    beside = np.diff(index) == 1
    steps = np.maximum(np.rint(np.diff(t_s) / step_s), 1)
    ahead = np.diff(phase)
    usual = float(np.median(ahead[beside] / steps[beside]))
    extra = np.where(beside, np.rint(ahead / usual) - steps, 0)
    noise = 1.4826 * float(np.median(np.abs(ahead - usual * (steps + extra))[beside]))
    return np.concatenate([[0], np.cumsum(extra)]).astype(np.int64), abs(usual) / max(noise, 1e-12)


_LEFT_OUT_S = 2.0
_HIDDEN_SHARE = 0.05
_UNEVEN = 5e-4
_FEW_TURNS = 8.0
_SURELY = 3.0
_LITTLE_DRIFT = 1e-4


def rate_findings(found: "PlatterRate", missing: int, notes: tuple[str, ...]) -> tuple[Finding, ...]:
    """Return what was noticed.

    Parameters
    ----------
    found : the result
    missing : frames that are missing in a video whose timestamps merely count them
    notes : on what could not be read
    """
    return (
        *_of_video(notes, missing),
        *_of_clock(found),
        *_of_part(found),
        *_of_evenness(found),
        *_of_pattern(found),
    )


def _of_video(notes: tuple[str, ...], missing: int) -> Iterator[Finding]:
    if notes:
        yield make_finding("video-damaged", notes=" ".join(notes))
    if missing:
        yield make_finding("video-frames-missing", missing=missing)


def _of_clock(found: "PlatterRate") -> Iterator[Finding]:
    if found.clock < NOMINAL_CLOCK:
        return
    unchecked = "; frames may be missing, unnoticed" if found.clock >= UNCHECKED_CLOCK else ""
    yield make_finding("video-nominal-times", frame_rate_hz=found.frame_rate_hz, unchecked=unchecked, clock=found.clock)


def _of_part(found: "PlatterRate") -> Iterator[Finding]:
    start, stop = found.steady_s
    step = 1 / found.frame_rate_hz
    if start + (found.duration_s - stop) > _LEFT_OUT_S:
        yield make_finding("platter-steady-part", start=start, stop=stop, duration_s=found.duration_s)
    hidden = 1 - found.frames_used * step / max(stop - start, step)
    if hidden > _HIDDEN_SHARE:
        yield make_finding("platter-hidden", hidden=hidden)
    if found.turns < _FEW_TURNS:
        yield make_finding("platter-few-turns", turns=found.turns)


def _of_evenness(found: "PlatterRate") -> Iterator[Finding]:
    rate = found.rate_rad_s
    drift, sigma = found.drift_rad_s
    drifts = abs(drift) > max(_SURELY * sigma, _LITTLE_DRIFT * rate)
    own = max(found.sigma_rad_s**2 - (found.clock * rate) ** 2, 0.0) ** 0.5 / rate
    if drifts:
        yield make_finding(
            "platter-drift", direction="rises" if drift > 0 else "falls", percent=100 * abs(drift) / rate
        )
    elif own > _UNEVEN:
        yield make_finding("platter-uneven", own=own)
    else:
        yield make_finding("platter-even", own=own)


def _of_pattern(found: "PlatterRate") -> Iterator[Finding]:
    if found.per_turn > 1:
        yield make_finding("platter-pattern", per_turn=found.per_turn)


Complex = NDArray[np.complex128]

_SMOOTHING = 1.2  # cells
_FLOW_HARMONICS = 4
_EDGE = 2  # cells
_RING = 1.5  # cells
_MOST_RINGS, _MOST_WAVES = 200, 40
_STRONGEST = 3
_EXPLAINED = 0.3
_CLEAR_SCORE, _CLEAR_RATIO = 0.25, 2.0
_OBVIOUS_SCORE, _OBVIOUS_RATIO = 0.5, 4.0
_ROUGHLY, _AT_ALL, _CLOSELY = 1.6, 3.0, 1.15
_AMBIGUOUS_RATIO = 1.05


@value_class(eq=True)
class PatternTurn:
    """Motion of the pattern in the image as that of a turning plane.

    Attributes
    ----------
    per_turn : how often the picture repeats itself in a turn of the platter: 1 where no part of a turn looks like
        another, 3 where a third of a turn looks the same; None where the pattern does not tell
    explained : share of the change of the pictures that a turning plane explains
    """

    per_turn: Fraction | None
    explained: float


def pattern_turn(template: PhaseTemplate, shape: tuple[int, int]) -> PatternTurn:
    """Return how the pattern turns while the phase of its repetition advances.

    A picture that a homography moves obeys the transport equation dI/dphase + v . grad I = 0 with the vector field v of
    a 3 x 3 generator. That of a turning plane in perspective has the eigenvalues 0 and +-i a, and a is the angle by
    which it turns while the phase advances by one; its eigenvectors are centre, angle and radius in the plane. Around
    the centre, a harmonic of the repetition has a whole number of waves, which is counted.
    """
    count = min(_FLOW_HARMONICS, template.sampled)
    if count < 1 or min(shape) < 4 * _EDGE:
        return PatternTurn(per_turn=None, explained=0.0)
    maps = template.maps().reshape(-1, *shape).astype(np.complex128)
    trust = float(np.median(template.sigma)) / template.sigma.reshape(shape).astype(np.float64)
    generator, explained = _generator(maps[:count], trust**2)
    values, left = (np.asarray(part, dtype=np.complex128) for part in np.linalg.eig(generator.T))
    turning, still = int(np.argmax(values.imag)), int(np.argmin(np.abs(values.imag)))
    angle = float(values[turning].imag)
    if explained < _EXPLAINED or angle <= 0:
        return PatternTurn(per_turn=None, explained=explained)
    x, y, _ = _coordinates(shape)
    points = np.stack([x, y, np.ones_like(x)], axis=-1)
    polar = (points @ left[:, turning]) / (points @ left[:, still].real)
    votes = [_waves(maps[k] * trust, polar, k + 1, angle) for k in _strongest(maps, template)]
    clear = {vote for vote in votes if vote is not None}
    per_turn = clear.pop() if len(clear) == 1 else None
    return PatternTurn(per_turn=per_turn, explained=explained)


def _coordinates(shape: tuple[int, int]) -> tuple[Floats, Floats, float]:
    """Return x and y of the cells about the middle, in units of half the width."""
    half = max(shape) / 2
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return (x - (shape[1] - 1) / 2) / half, (y - (shape[0] - 1) / 2) / half, half


def _generator(maps: Complex, trust: Floats) -> tuple[Floats, float]:
    """Fit the generator to the harmonics; return it and the share of the change that it explains.

    Parameters
    ----------
    maps : (h, rows, cols) complex amplitudes
    trust : (rows, cols) weight of the cells
    """
    x, y, half = _coordinates((maps.shape[1], maps.shape[2]))
    inner = (slice(_EDGE, -_EDGE),) * 2
    rows: list[Any] = []
    rights: list[Any] = []
    x, y, weight = x[inner].ravel(), y[inner].ravel(), trust[inner].reshape(-1, 1)
    for k, picture in enumerate(maps, start=1):
        smooth = cv2.GaussianBlur(picture.real, (0, 0), _SMOOTHING) + 1j * cv2.GaussianBlur(
            picture.imag, (0, 0), _SMOOTHING
        )
        dy, dx = (slope[inner].ravel() * half for slope in np.gradient(smooth))
        along = x * dx + y * dy
        columns = (x * dx, y * dx, dx, x * dy, y * dy, dy, -x * along, -y * along)
        rows.append(np.stack(columns, axis=1) * weight / k)
        # Re C e^(ik phase) changes as Re ik C e^(ik phase)
        rights.append(-1j * smooth[inner].ravel() * weight[:, 0])
    left_side, right_side = (np.concatenate(part) for part in (rows, rights))
    design = np.concatenate([np.real(left_side), np.imag(left_side)])
    right = np.concatenate([np.real(right_side), np.imag(right_side)])
    found = np.linalg.lstsq(design, right, rcond=None)[0]
    residual = right - design @ found
    explained = 1 - float(residual @ residual) / max(float(right @ right), 1e-300)
    return np.append(found, 0.0).reshape(3, 3), explained


def _strongest(maps: Complex, template: PhaseTemplate) -> list[int]:
    energy = (np.abs(maps) ** 2 / template.sigma.reshape(maps.shape[1:]) ** 2).sum(axis=(1, 2))
    return np.argsort(-energy[: template.sampled])[:_STRONGEST].tolist()


def _waves(picture: Complex, polar: Complex, harmonic: int, angle: float) -> Fraction | None:
    """Return how many waves a harmonic has around the centre for each of its periods, or None where that is not clear.

    Parameters
    ----------
    picture : (rows, cols) complex amplitude of the harmonic
    polar : (rows, cols) position in the platter's plane as a complex number, up to scale
    angle : of the motion, which must roughly agree
    """
    radius = np.abs(polar)
    width = float(np.median(np.hypot(*np.gradient(radius)))) * _RING
    ring = np.minimum(radius / width, _MOST_RINGS).astype(np.int64).ravel()
    size = np.maximum(np.bincount(ring), 1)
    waves = np.arange(_MOST_WAVES + 1)
    straight = polar / np.maximum(radius, 1e-12)
    score = np.empty(len(waves))
    turned: Any = picture
    for wave in waves:  # along a ring the picture turned back by its waves has one phase
        even = turned.ravel()
        score[wave] = ((np.bincount(ring, even.real) ** 2 + np.bincount(ring, even.imag) ** 2) / size).sum()
        turned = turned * straight
    score /= max(float((np.abs(picture) ** 2).sum()), 1e-300)
    top = int(np.argmax(score))
    second = float(np.delete(score, top).max())
    if top == 0 or score[top] < max(_CLEAR_SCORE, _AMBIGUOUS_RATIO * second):
        return None
    obvious = score[top] > max(_OBVIOUS_SCORE, _OBVIOUS_RATIO * second)
    limit = _AT_ALL if obvious else _ROUGHLY if score[top] > _CLEAR_RATIO * second else _CLOSELY
    agrees = 1 / limit < top * angle / harmonic < limit
    return Fraction(top, harmonic) if agrees else None
