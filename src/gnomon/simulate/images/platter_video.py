"""Images of a turning platter as a webcam sees them, and the rate that is true of them."""

from collections.abc import Iterator
from functools import partial
from math import cos, pi, radians, sin
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers, frozen_array
from ...recording.recording import Frame, Grey, ImageStream
from ..scenarios.turntable import PlatterScenario

Shades = NDArray[np.float32]

_FINE_S = 1e-3
_SUBFRAMES = 5
_TEXELS = 640
_SETTLED = 9.0  # time constants until the rate is steady to 1e-4
_DISTANCE = 3.0  # of the camera, in radii


@value_class
class PlatterVideo:
    """A simulated video, whose images are drawn on demand, and its truth.

    Attributes
    ----------
    scenario : what was simulated
    seed : every random number follows from it
    t_ns : (n,) timestamps that the video states [ns]
    t_true_s : (n,) middle of the exposure of each frame [s]
    rate_rad_s : mean rate of the platter over the steady part
    steady_s : from when to when it turned at its rate [s]
    """

    scenario: PlatterScenario
    seed: int
    t_ns: Integers
    t_true_s: Floats
    rate_rad_s: float
    steady_s: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, np.int64))
        object.__setattr__(self, "t_true_s", frozen_array(self.t_true_s))

    def images(self) -> Iterator[Grey]:
        """Yield the images, (height, width) in 8 bits of grey."""
        return _images(self)

    def stream(self) -> ImageStream:
        """Return the video as the readers return one."""

        def frames(_: list[str]) -> Iterator[Frame]:
            for number, (stamp, image) in enumerate(zip(self.t_ns.tolist(), self.images(), strict=True)):
                yield Frame(t_ns=stamp, where=f"simulated video, frame {number}", decode=partial(_given, image))

        return ImageStream(frames=frames, count=len(self.t_ns))


def simulate_platter_video(scenario: PlatterScenario | None = None, seed: int = 0) -> PlatterVideo:
    """Make a video of a turning platter.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same video
    """
    scenario = scenario or PlatterScenario()
    rng = np.random.default_rng(seed)
    count = max(1, int(scenario.duration_s * scenario.frame_rate_hz))
    even = np.arange(count) / scenario.frame_rate_hz
    true = even / (1 + scenario.clock_error) + scenario.jitter_s * rng.standard_normal(count)
    true = np.maximum.accumulate(true - true[0] + 1e-6 * np.arange(count))
    kept = rng.random(count) >= scenario.dropped
    kept[0] = True
    true = true[kept]
    stated = true if scenario.stamps == "true" else even[: len(true)]
    start = scenario.start_s + _SETTLED * scenario.spin_up_s
    stop = min(true[-1], np.inf if scenario.stop_s is None else scenario.stop_s)
    turned = _phase(scenario, seed, np.array([start, stop]))
    return PlatterVideo(
        scenario=scenario,
        seed=seed,
        t_ns=np.rint(stated * 1e9).astype(np.int64),
        t_true_s=true,
        rate_rad_s=float(np.diff(turned)[0] / (stop - start)) if stop > start else 0.0,
        steady_s=(start, float(stop)),
    )


def _phase(scenario: PlatterScenario, seed: int, t_s: Floats) -> Floats:
    """Return by which angle the platter has turned at some times [rad]."""
    t = np.arange(-1.0, scenario.duration_s * (1 + abs(scenario.clock_error)) + 2, _FINE_S)
    since = t - scenario.start_s
    ramp = np.where(since < 0, 0.0, 1.0)
    if scenario.spin_up_s:
        ramp = ramp * (1 - np.exp(-np.maximum(since, 0) / scenario.spin_up_s))
    if scenario.stop_s is not None:
        late = np.maximum(t - scenario.stop_s, 0) / max(scenario.spin_down_s, _FINE_S)
        ramp = ramp * np.exp(-late)
    swing = scenario.wow * np.cos(scenario.rate_rad_s * t / 1.7)
    speed = scenario.rate_rad_s * (1 + swing + scenario.drift * (t / scenario.duration_s - 0.5))
    walk = np.random.default_rng((seed, 1)).standard_normal(len(t)) * scenario.flutter / np.sqrt(_FINE_S)
    return np.interp(t_s, t, np.cumsum((speed + walk) * ramp) * _FINE_S)


def _images(video: PlatterVideo) -> Iterator[Grey]:
    scenario = video.scenario
    rng = np.random.default_rng((video.seed, 2))
    size = (scenario.width, scenario.height)
    label = _label(scenario, rng)
    wall = _smooth_noise(rng, (scenario.height, scenario.width), scenario.height / 12) * 25 + 120
    wall = wall.astype(np.float32)
    view = _view(scenario)
    outline = cv2.warpPerspective(_disc(), view, size, flags=cv2.INTER_AREA)
    shutter = (np.arange(_SUBFRAMES) + 0.5) / _SUBFRAMES - 0.5
    slow = _smooth_noise(rng, (1, len(video.t_true_s) + 1), 3 * scenario.frame_rate_hz)[0].tolist()
    turned = _phase(scenario, video.seed, video.t_true_s[:, None] + shutter * scenario.exposure_s)
    for number, (t, angles) in enumerate(zip(video.t_true_s.tolist(), turned.tolist(), strict=True)):
        platter = np.zeros((scenario.height, scenario.width), np.float32)
        for angle in angles:
            platter += cv2.warpPerspective(label, view @ _turn(angle, scenario), size) / _SUBFRAMES
        blink = 1 + 0.5 * sin(angles[0]) if scenario.motion == "blink" else 1.0
        behind = _with_passer(wall, scenario, t) if scenario.background else wall
        picture = behind + outline * (platter * blink - behind)
        if any(start <= t < stop for start, stop in scenario.hidden):
            _hide(picture, scenario, t)
        gain = 1.0 + scenario.flicker * (np.sin(2 * pi * 0.83 * t) + slow[number])
        picture = gain * picture + scenario.noise_grey * rng.standard_normal(picture.shape, dtype=np.float32)
        yield np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _given(image: Grey) -> Grey:
    return image


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], scale: float) -> Floats:
    """Return noise of unit variance that varies over `scale` pixels."""
    coarse = rng.standard_normal((max(2, round(shape[0] / scale) + 1), max(2, round(shape[1] / scale) + 1)))
    fine = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine, dtype=np.float64)


def _polar() -> tuple[Floats, Floats]:
    """Return radius, 1 at the platter's rim, and angle of the texels."""
    line = (np.arange(_TEXELS) - (_TEXELS - 1) / 2) / (_TEXELS / 2)
    x, y = np.meshgrid(line, line)
    return np.hypot(x, y), np.arctan2(y, x)


def _disc() -> Shades:
    return np.clip((1 - _polar()[0]) * _TEXELS / 4, 0, 1).astype(np.float32)


def _label(scenario: PlatterScenario, rng: np.random.Generator) -> Shades:
    """Draw the platter: grooves, a label with its print, a mark and the sensor."""
    radius, angle = _polar()
    grey = 50 + 8 * np.sin(60 * radius)
    fold = scenario.symmetry
    along = np.linspace(0, 1.5, 300)
    print_ = np.zeros_like(grey)
    for k in range(1, 5):
        waves = np.zeros(len(along), np.complex128)
        for ring in np.linspace(0.15, 0.95, 9):
            amplitude, phase = rng.standard_normal() / k, rng.uniform(0, 2 * pi)
            waves += amplitude * np.exp(1j * phase) * np.exp(-(((along - ring) / 0.08) ** 2))
        print_ += np.interp(radius, along, waves.real) * np.cos(fold * k * angle)
        print_ -= np.interp(radius, along, waves.imag) * np.sin(fold * k * angle)
    grey += scenario.texture * 25 * print_ * (radius > 0.1)
    if scenario.mark:
        for k in range(fold):
            at = np.abs((angle - 2 * pi * k / fold + pi) % (2 * pi) - pi) * radius
            grey[(at < 0.04) & (radius > 0.5) & (radius < 0.95)] = 235
    if scenario.sensor:
        for k in range(fold):
            turn = 2 * pi * k / fold + 0.9
            x, y = radius * np.cos(angle - turn), radius * np.sin(angle - turn)
            grey[(np.abs(x - 0.45) < 0.12) & (np.abs(y) < 0.08)] = 170
    return grey.astype(np.float32)


def _view(scenario: PlatterScenario) -> Floats:
    """Return the homography from texels to pixels of a camera that looks down at an angle."""
    tilt = radians(scenario.tilt_deg)
    half = scenario.height / 2
    focal = scenario.radius * half * _DISTANCE
    centre = ((scenario.width - 1) / 2 + scenario.offset[0] * half, half - 0.5 + scenario.offset[1] * half)
    project = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    place = np.array([[1, 0, 0], [0, cos(tilt), 0], [0, sin(tilt), _DISTANCE]])
    middle = (_TEXELS - 1) / 2
    plane = np.array([[1, 0, -middle], [0, 1, -middle], [0, 0, _TEXELS / 2]]) / (_TEXELS / 2)
    return project @ place @ plane


def _turn(angle: float, scenario: PlatterScenario) -> Floats:
    """Return the rotation of texels about the platter's axis."""
    if scenario.motion == "blink":
        angle = 0.0
    if scenario.motion == "swing":
        angle = 0.8 * sin(angle)
    middle = (_TEXELS - 1) / 2
    c, s = cos(angle), sin(angle)
    return np.array([[c, -s, middle - c * middle + s * middle], [s, c, middle - s * middle - c * middle], [0, 0, 1]])


def _with_passer(wall: Shades, scenario: PlatterScenario, t: float) -> Shades:
    """Return the background with somebody who walks about, with a period that is none."""
    at = 0.5 + 0.35 * sin(0.9 * t) + 0.2 * sin(0.37 * t * 1.618 + 1)
    middle = (round(at * scenario.width), round(scenario.height * (0.3 + 0.05 * sin(4.1 * t))))
    axes = (round(scenario.width * 0.09), round(scenario.height * 0.45))
    shade: Any = np.zeros(wall.shape, np.float32)
    cv2.ellipse(shade, middle, axes, 0, 0, 360, 1.0, -1)
    return wall - np.float32(70 * scenario.background) * shade


def _hide(picture: Floats, scenario: PlatterScenario, t: float) -> None:
    """Draw a hand, which is never quite still."""
    half = scenario.height / 2
    middle = (
        round(scenario.width / 2 + half * (scenario.offset[0] + 0.2 * sin(1.3 * t))),
        round(half * (1 + scenario.offset[1] + 0.1 * sin(2.1 * t + 1))),
    )
    size = scenario.radius * half
    cv2.ellipse(picture, middle, (round(0.8 * size), round(0.9 * size)), 20 * sin(t), 0, 360, 190.0, -1)
