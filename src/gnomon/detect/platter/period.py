"""Images of a turning platter -> small pictures of even exposure, and the period in which they roughly repeat."""

from dataclasses import field
from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...progress import Progress, Step
from ...recording import Floats, frozen_array
from ...recording.recording import ImageStream

Pictures = NDArray[np.float32]

_CELLS = 1200
_STEPS = 256.0  # of a grey level, that the means of cells are kept in
_MOST_FRAMES = 20_000
_STILL_SHARE = 0.5  # of the cells, which vary least, tell the exposure
_SAY_EVERY = 300

_HARMONICS = 8
_LEVELS = 4
"""Windows of the whole video, halves, quarters and eighths of it."""
_MOST_SAMPLES = 4096
_MOST_WINDOWS = 7
_PADDING = 4
_FEWEST_TURNS = 3.0
_SHORTER_IS_BETTER = 0.08  # share of the variance that a shorter window must explain in addition
_CURVE_POINTS = 400
_FEWEST_SAMPLES = 16
_MOST_CANDIDATES = 4
_AROUND = 24  # widths of a line
_PROMINENT = 3.0


@value_class
class PictureSeries:
    """A video as grey means over cells of its images.

    Attributes
    ----------
    t_s : (n,) timestamps, counted from the first [s]
    cells : (n, rows * cols) grey levels, exposure evened out
    shape : rows, cols
    notes : sentences on what could not be read
    """

    t_s: Floats
    cells: Pictures
    shape: tuple[int, int]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array(self.t_s))


def read_pictures(stream: ImageStream, progress: Progress | None = None) -> PictureSeries:
    """Reduce the images of a stream to some thousand grey means each.

    Raises
    ------
    RecordingError
        If fewer than two images can be decoded.
    """
    notes: list[str] = []
    t_ns: list[int] = []
    rows: list[NDArray[np.uint16]] = []
    shape: tuple[int, int] | None = None
    damaged = 0
    for number, frame in enumerate(stream.frames(notes)):
        if number >= _MOST_FRAMES:
            notes.append(f"only the first {_MOST_FRAMES} frames were used.")
            break
        if progress is not None and number % _SAY_EVERY == 0:
            progress(Step("looking at the images", number, stream.count))
        try:
            image = frame.decode()
        except RecordingError:
            damaged += 1
            continue
        shape = shape or _grid(image.shape[0], image.shape[1])
        small = cv2.resize(image.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
        rows.append(np.rint(small * _STEPS).astype(np.uint16).ravel())
        t_ns.append(frame.t_ns)
    if damaged:
        notes.append(f"{damaged} damaged frame{'s were' if damaged > 1 else ' was'} left out.")
    if len(rows) < 2 or shape is None:
        said = f" ({' '.join(notes)})" if notes else ""
        raise RecordingError(f"{len(rows)} images of the video can be read{said}; a rate needs many turns.")
    stamps = np.array(t_ns, dtype=np.int64)
    cells = np.stack(rows).astype(np.float32) / np.float32(_STEPS)
    return PictureSeries(t_s=(stamps - stamps[0]) * 1e-9, cells=_evenly_exposed(cells), shape=shape, notes=tuple(notes))


def _grid(height: int, width: int) -> tuple[int, int]:
    side = max(1.0, sqrt(height * width / _CELLS))
    return max(1, round(height / side)), max(1, round(width / side))


def _evenly_exposed(cells: Pictures) -> Pictures:
    """Undo gain and offset of each picture, by the cells that vary least."""
    mean = cells.mean(axis=0)
    spread = cells.std(axis=0)
    still = np.argsort(spread)[: max(8, int(_STILL_SHARE * len(spread)))]
    seen = cells[:, still]
    level = mean[still].mean()
    contrast = mean[still] - level
    noise = float(np.mean(spread[still] ** 2)) * 10 + 1e-3  # a share of gain that noise explains is left alone
    own = seen.mean(axis=1)
    gain = (seen @ contrast + noise) / (contrast @ contrast + noise)
    gain = np.clip(gain, 0.2, 5.0)
    return (cells - own[:, None]) / gain[:, None] + level


@value_class
class RoughPeriod:
    """A frequency at which the pictures may repeat themselves.

    Attributes
    ----------
    frequency_hz : of the repetition
    start_s, stop_s : where in the video it was seen
    periods_s, scores : (m,) for a figure: over all periods that were tried, the share of the pictures' variance that is
        in the harmonics of such a repetition, less that between them
    """

    frequency_hz: float
    start_s: float
    stop_s: float
    periods_s: Floats = field(default_factory=lambda: np.empty(0))
    scores: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "periods_s", frozen_array(self.periods_s))
        object.__setattr__(self, "scores", frozen_array(self.scores))


@value_class
class _Scored:
    """Frequencies in a window at the times t_s, and how much of the variance, and how sharply, repeats itself there."""

    t_s: Floats
    frequency: Floats
    energy: Floats
    sharpness: Floats


def rough_periods(series: PictureSeries) -> tuple[RoughPeriod, ...]:
    """Return the strongest repetitions, best first; none where the video is too short for any.

    In windows of several lengths the spectra of all cells are added, each cell counting alike: a comb of harmonics is
    looked for in the sum, and what lies between its teeth counts against it. Strong but slow changes, such as a hand
    that comes and goes, would hide the sharp lines of a platter: of the same window, combs that stand out from what is
    beside them are candidates, too.
    """
    step = float(np.median(np.diff(series.t_s)))
    even, values = _resampled(series, step)
    best: _Scored | None = None
    for level in range(_LEVELS):
        length = min(len(even), _MOST_SAMPLES) >> level
        if length < _FEWEST_SAMPLES:
            break
        count = min(_MOST_WINDOWS, 2 * len(even) // length - 1)
        for first in np.linspace(0, len(even) - length, count).astype(int).tolist():
            found = _in_window(even[first : first + length], values[first : first + length], step)
            better = _SHORTER_IS_BETTER if best is not None and len(best.t_s) > length else 0.0
            if best is None or found.energy.max() > best.energy.max() + better:
                best = found
    return () if best is None else _strongest(best)


def _strongest(found: _Scored) -> tuple[RoughPeriod, ...]:
    """Return the highest peaks by energy and by sharpness, in turn."""
    chosen: list[RoughPeriod] = []
    left = [found.energy.copy(), found.sharpness.copy()]
    apart = 2 / (found.t_s[-1] - found.t_s[0])
    periods, scores = _thinned(found)
    for turn in range(_MOST_CANDIDATES):
        top = float(found.frequency[np.argmax(left[turn % 2])])
        for one in left:
            one[np.abs(found.frequency - top) < apart] = -np.inf
        chosen.append(
            RoughPeriod(
                frequency_hz=top,
                start_s=float(found.t_s[0]),
                stop_s=float(found.t_s[-1]),
                periods_s=periods,
                scores=scores,
            )
        )
    return tuple(chosen)


def _thinned(found: _Scored) -> tuple[Floats, Floats]:
    """Return the highest of each few scores, over the period."""
    thin = max(1, len(found.frequency) // _CURVE_POINTS)
    ends = len(found.frequency) // thin * thin
    highest = found.energy[:ends].reshape(-1, thin).argmax(axis=1) + thin * np.arange(ends // thin)
    return 1 / found.frequency[highest], found.energy[highest]


def _resampled(series: PictureSeries, step: float) -> tuple[Floats, Floats]:
    """Return even times and the pictures there, of cells twice as wide."""
    rows, cols = series.shape
    pictures = series.cells.reshape(-1, rows, cols)
    if min(rows, cols) >= 4:
        pictures = pictures[:, : rows // 2 * 2, : cols // 2 * 2]
        pictures = pictures.reshape(-1, rows // 2, 2, cols // 2, 2).mean(axis=(2, 4))
    values = pictures.reshape(len(pictures), -1)
    even = np.arange(0.0, series.t_s[-1] + step / 2, step)[: 4 * len(series.t_s)]
    after = np.clip(np.searchsorted(series.t_s, even), 1, len(series.t_s) - 1)
    share = (even - series.t_s[after - 1]) / (series.t_s[after] - series.t_s[after - 1])
    share = np.clip(share, 0.0, 1.0).astype(np.float32)[:, None]
    return even, (1 - share) * values[after - 1] + share * values[after]


def _in_window(t_s: Floats, values: Floats, step: float) -> _Scored:
    """Score all frequencies in one window."""
    span = len(t_s) * step
    taper = np.hanning(len(t_s))[:, None]
    weighted = (values - values.mean(axis=0)) * taper
    energy = (weighted**2).sum(axis=0)
    alike = energy + np.median(energy) + 1e-3 * len(t_s)
    size = _PADDING * (1 << (len(t_s) - 1).bit_length())
    spectrum = (np.abs(np.fft.rfft(weighted, size, axis=0)) ** 2 / alike).sum(axis=1)
    around = _median_around(spectrum, round(_AROUND * size / len(t_s)))
    share = 2 * float((taper**2).sum()) / float(taper.sum()) ** 2 / float((energy / alike).sum() + 1e-9)
    nyquist = 0.5 / step
    trial = np.arange(_FEWEST_TURNS / span, nyquist, 1 / (2 * _HARMONICS * span))
    spectra = spectrum * share, np.log1p(spectrum / (_PROMINENT * around + 1e-12))
    energies, sharpness = np.zeros(len(trial)), np.zeros(len(trial))
    for k in range(1, _HARMONICS + 1):
        under = trial[k * trial <= nyquist]  # beyond half the frame rate harmonics fall upon each other
        on, beside = (np.rint(teeth * under * step * size).astype(np.int64) for teeth in (k, k - 0.5))
        for total, one in zip((energies, sharpness), spectra, strict=True):
            total[: len(under)] += one[on] - one[beside]
    return _Scored(t_s=t_s, frequency=trial, energy=energies, sharpness=sharpness)


def _median_around(spectrum: Floats, half_width: int) -> Floats:
    """Return a running median, at every quarter of its width and straight between."""
    stride = max(1, half_width // 2)
    centres = np.arange(0, len(spectrum), stride)
    medians = [np.median(spectrum[max(0, c - half_width) : c + half_width + 1]) for c in centres.tolist()]
    return np.interp(np.arange(len(spectrum)), centres, medians)
