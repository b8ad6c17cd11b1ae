"""The page of the study of Tedaldi, and its figures."""

from collections.abc import Mapping

import numpy as np

from ...recording import Floats
from ...study.tedaldi import (
    DIVERGENCE,
    GROUPS,
    MEAN_ERROR,
    NAMES,
    ROTATION,
    SIGNAL_ERROR,
    SPREAD,
    Example,
    TedaldiStudy,
    group_errors,
    known_mean,
    noise_alone,
    sigma_over_scatter,
    tedaldi_claims,
)
from ...study.tedaldi_trial import METHODS, SCENARIO, Method
from ..drawing.figures import Plot, Sheet, draw_dots, draw_envelope, log_limits, set_y_limits
from ..numbers import fixed_text, number_text
from ..page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section
from . import study_page

_CALLED = {"gnomon": "gnomon", "tedaldi2014-text": "Algorithm 1 as printed", "tedaldi2014": "authors' script"}
"""The methods, as the page calls them; the last two are presets of gnomon."""
_SETUP = (
    "As Tedaldi says: 100 Hz; 5000 samples at rest, then 400 after each motion; three sinusoids of different "
    "pulsation, scaled at random in each motion, as accelerations; gravity turning at a random zenith and a random "
    "azimuth rate in each motion; distorted by Eqs. (4.1) and (4.2). The parameters are drawn from the ranges of its "
    "40 sets: accelerometer misalignments ±0.01, scales 1 ± 0.01, biases ±0.1 m/s²; gyroscope misalignments ±0.03, "
    "scales 0.84 to 1.13, biases ±0.02 rad/s.",
    "It states neither the noise nor the motion. The noise here is 0.007 m/s² and 0.0043 rad/s in each sample: the "
    "first follows from its calibrated residual of 0.0056 m/s², the mean absolute value of such noise, the second from "
    "0.0035 rad/s likewise. The motion here: 39 of 1.5 to 3 s, zenith and azimuth rate up to ±1.5 rad/s each, "
    "accelerations up to ±2 m/s². Faster or longer turns would show the gyroscope's parameters better, and the other "
    "way round, so Table 4.2 is a comparison only as far as the motions are alike; Tables 4.1, 4.3 and 4.4 hang on the "
    "noise alone. Its uncalibrated gyroscope is farther from the truth (Table 4.3), so that it may have turned faster.",
    "It adds the noise to the ideal signals and distorts both; here the noise is added to the readings, which differs "
    "by the scale factors. The local gravity is known to every method. Gnomon's recipe is its default; "
    "--preset tedaldi2014-text is Algorithm 1 as printed, --preset tedaldi2014 the authors' published script, which "
    "takes 100 samples of each rest instead of their mean and finds its T_init of 30 s in the 50 s at rest.",
)


def tedaldi_page(study: TedaldiStudy) -> ReportPage:
    """Return the page of the study."""
    return study_page(
        "Study of Tedaldi",
        f"Tedaldi: {len(study.outcomes)} parameter sets, {study.runs} recordings of each, seed {study.seed}",
        tuple(tedaldi_claims(study)),
        _key_numbers(study),
        (_parameters(study), _signals(study), _gravity(study), _rotations(study), *_figures(study), _setup()),
    )


def _key_numbers(study: TedaldiStudy) -> tuple[KeyNumber, ...]:
    ratio = group_errors(study, "gnomon") / np.array([theirs for _, theirs in GROUPS.values()])
    drift = float(np.nanmean(study.signals("gnomon", "drift_angle")[..., 0]))
    return (
        KeyNumber(
            "Accelerometer errors over Tedaldi's",
            f"{fixed_text(float(ratio[:3].min()), 2)} to {fixed_text(float(ratio[:3].max()), 2)}",
            "misalignment, scale, bias; mean absolute errors over all sets",
        ),
        KeyNumber(
            "Gyroscope errors over Tedaldi's",
            f"{fixed_text(float(ratio[3:].min()), 2)} to {fixed_text(float(ratio[3:].max()), 2)}",
            "misalignment, scale; its motion is not known",
        ),
        KeyNumber(
            "Gravity carried through the recording",
            f"{number_text(1e3 * drift, 3)} mrad",
            f"mean angle; Table 4.5: {number_text(1e3 * ROTATION['calibrated'][1][0], 3)} mrad",
        ),
    )


def _parameters(study: TedaldiStudy) -> Section:
    rows = [
        (
            NAMES[k],
            fixed_text(float(study.truth[0, k]), 4),
            *(
                fixed_text(1e3 * float(value), 4)
                for method in METHODS[:2]
                for value in (study.spread(method)[0, k], study.mean_error(method)[0, k])
            ),
            fixed_text(1e3 * float(SPREAD[k]), 4),
            fixed_text(1e3 * float(MEAN_ERROR[k]), 4),
        )
        for k in range(18)
    ]
    first = ReportTable(
        "The first set (Tables 4.1 and 4.2)",
        ("", "truth", "gnomon: spread", "error", "as printed: spread", "error", "Tedaldi: spread", "error"),
        rows,
        "Spread is the standard deviation of the estimates, error their mean absolute error, both in 10⁻³; "
        "biases in m/s². Tedaldi's first set is another one; all sets are in parameters.csv.",
        dense=True,
    )
    return Section(
        "parameters",
        "Parameters (Tables 4.1 and 4.2)",
        "Errors of the estimated parameters of Eqs. (2.6) and (2.7).",
        (_groups(study), set_errors(study, _CALLED), first, _sigma_table(study)),
    )


def _groups(study: TedaldiStudy) -> ReportTable:
    theirs = np.array([error for _, error in GROUPS.values()])
    rows = [("Tedaldi, its 40 sets", *(fixed_text(1e3 * error, 4) for error in theirs))]
    for method in METHODS:
        errors = group_errors(study, method)
        rows.append((f"{_CALLED[method]}: mean", *(fixed_text(1e3 * float(error), 4) for error in errors)))
        rows.append(
            (f"{_CALLED[method]}: median", *(fixed_text(1e3 * float(error), 4) for error in _medians(study, method)))
        )
    return ReportTable(
        f"Mean absolute errors over all {len(study.outcomes)} sets, in 10⁻³",
        ("", *(name.replace("accelerometer", "acc.").replace("gyroscope", "gyro.") for name in GROUPS)),
        rows,
        "Biases in m/s². Where the mean is far above the median, a few recordings went wrong: the published "
        "forms choose the threshold with the smallest sum of residuals, which few and short rests have.",
        marked=1,
    )


def _medians(study: TedaldiStudy, method: Method) -> Floats:
    errors = np.abs(study.estimates(method) - study.truth[:, None])
    return np.array([np.nanmedian(errors[..., where]) for where, _ in GROUPS.values()])


def _sigma_table(study: TedaldiStudy) -> ReportTable:
    ratios = {method: sigma_over_scatter(study, method) for method in METHODS}
    return ReportTable(
        "Stated sigma over scatter",
        ("", *(_CALLED[method] for method in METHODS)),
        tuple((name, *(fixed_text(float(ratios[m][k]), 2) for m in METHODS)) for k, name in enumerate(NAMES)),
        "1 over the rms of error over sigma, all recordings. The published forms count neighbouring rotations "
        "as independent, and the samples of one rest too.",
        dense=True,
    )


def _signals(study: TedaldiStudy) -> Section:
    noise = noise_alone()
    rows: list[tuple[str, ...]] = []
    for sensor, name, unit, alone in (
        ("accelerometer", "force", "m/s²", noise[0]),
        ("gyroscope", "rate", "rad/s", noise[1]),
    ):
        before, after = SIGNAL_ERROR[sensor]
        rows += [
            (f"{sensor} [{unit}], uncalibrated: Tedaldi, set 1", *_cells(np.array(before))),
            ("here, as recorded", *_cells(study.signals(None, name).mean(axis=(0, 1)))),
            ("calibrated: Tedaldi, set 1", *_cells(np.array(after))),
            *((f"{_CALLED[m]}", *_cells(known_mean(study.signals(m, name), axis=(0, 1)))) for m in METHODS),
            ("noise alone", *_cells(np.full(3, alone))),
        ]
    return Section(
        "signals",
        "Signals (Table 4.3)",
        "Mean absolute difference between the signals and those without noise and errors, over whole recordings.",
        (
            ReportTable(
                "Mean absolute error along each axis",
                ("", "x", "y", "z"),
                rows,
                "Of one set there, of all sets here. Each scale factor multiplies the noise of its axis.",
            ),
        ),
    )


def _cells(values: Floats) -> tuple[str, ...]:
    return tuple(fixed_text(float(value), 4) for value in values)


def _gravity(study: TedaldiStudy) -> Section:
    rows: list[tuple[str, ...]] = []
    for state, methods in (("uncalibrated", (None,)), ("calibrated", METHODS)):
        size, angle = DIVERGENCE[state]
        rows.append((f"{state}: Tedaldi, set 1", *_cells(np.array(size)), *_cells(np.array(angle))))
        for method in methods:
            worst = _worst(study.signals(method, "divergence")[..., 0])
            rows.append((
                _CALLED[method] if method else "here, as recorded",
                *_cells(_with_worst(study.signals(method, "divergence"), worst)),
                *_cells(_with_worst(study.signals(method, "tilt"), worst)),
            ))  # fmt: skip
    return Section(
        "gravity",
        "Divergence from gravity (Table 4.4)",
        "Length of the acceleration sensed at rest against gravity, sample by sample; and the tilt that it would "
        "be if all of it were along a level axis.",
        (
            ReportTable(
                "Divergence of the accelerometer at rest",
                ("", "mean [m/s²]", "largest", "worst: mean", "largest", "mean [rad]", "largest", "worst: mean",
                      "largest"),
                rows,
                "Means over the recordings, and the recording with the largest mean in the worst case. "
                "Tedaldi's angles are larger than g sin θ makes of its divergences (0.0665 m/s² are 0.0068 rad).",
                dense=True,
            ),
        ),
    )  # fmt: skip


def _worst(means: Floats) -> tuple[int, int]:
    """Return set and run of the recording with the largest mean, (sets, runs)."""
    index = np.unravel_index(int(np.nanargmax(means)), means.shape)
    return int(index[0]), int(index[1])


def _with_worst(values: Floats, worst: tuple[int, int]) -> Floats:
    """Return mean and largest (sets, runs, 2) of all recordings, and those of the worst one, (4,)."""
    return np.concatenate([known_mean(values, axis=(0, 1)), values[worst]])


def _rotations(study: TedaldiStudy) -> Section:
    blocks: list[ReportTable] = []
    for title, name, compared in (
        ("Carried from the first rest through the whole recording", "drift", True),
        ("Carried from each rest to the next", "rotation", False),
    ):
        rows: list[tuple[str, ...]] = []
        for state, methods in (("uncalibrated", (None,)), ("calibrated", METHODS)):
            size, angle = ROTATION[state]
            if compared:
                theirs = (*_cells(np.array(size)), *_cells(np.array(angle[:1])), "", *_cells(np.array(angle[1:])), "")
                rows.append((f"{state}: Tedaldi, set 1", *theirs))
            for method in methods:
                worst = _worst(study.signals(method, "divergence")[..., 0])
                rows.append((
                    _CALLED[method] if method else "here, as recorded",
                    *_cells(_with_worst(study.signals(method, name), worst)),
                    *_cells(_with_worst(study.signals(method, f"{name}_angle"), worst)),
                ))  # fmt: skip
        blocks.append(
            ReportTable(
                title,
                ("", "mean [m/s²]", "largest", "worst: mean", "largest", "mean [rad]", "largest", "worst: mean",
                      "largest"),
                rows,
                dense=True,
            )
        )  # fmt: skip
    return Section(
        "rotations",
        "Gravity carried by the gyroscope (Table 4.5)",
        "Acceleration sensed at rest against the one that the gyroscope carries there. Tedaldi does not say "
        "over how long it integrates, and prints one number for mean and largest angle; both readings are here. The "
        "worst case is the recording with the largest divergence of the accelerometer, as there. The gyroscope's mean "
        "over the first rest is removed in every row.",
        blocks,
    )


def _figures(study: TedaldiStudy) -> tuple[Section, ...]:
    return (
        Section(
            "examples",
            "Signals that were simulated (Figs. 4.1 to 4.9)",
            f"The first recordings of {len(study.examples)} parameter sets, each at "
            f"{SCENARIO.rate_hz:g} Hz, as recorded.",
            (*example_figures(study), detector_figure(study)),
        ),
        Section(
            "improvement",
            "Before and after (Figs. 4.10 to 4.15)",
            "One motion of the first recording for each axis: as recorded, calibrated by gnomon, and without "
            "noise and errors.",
            improvement_figures(study),
        ),
    )


def _setup() -> Section:
    return Section("setup", "How it was simulated, and where that differs", blocks=(Prose(_SETUP),))


_AXES = ("x", "y", "z")
_COLORS = ("after", "heldout", "accent")
"""Of the methods."""
_BINS = 700
"""Of an envelope over a whole recording."""
_SENSORS = (("accelerometer", "m/s²"), ("gyroscope", "rad/s"))


def set_errors(study: TedaldiStudy, called: Mapping[str, str]) -> Figure:
    """Return the mean absolute errors of every set, a group of parameters a panel."""
    number = np.arange(1.0, len(study.outcomes) + 1)

    sheet = Sheet()
    for at, (name, (where, theirs)) in enumerate(GROUPS.items()):
        last = at == len(GROUPS) - 1
        unit = " [10⁻³ m/s²]" if "bias" in name else " [10⁻³]"
        label = "parameter set" if last else ""
        panel = sheet.panel(f"{name[:1].upper()}{name[1:]}{unit}", top=36.0 + 170 * at, height=116, x_label=label)
        errors = [1e3 * study.mean_error(method)[:, where].mean(axis=1) for method in METHODS]
        log_limits(panel, *errors, np.array([1e3 * theirs]))
        panel.across(1e3 * theirs, "muted", width=1.4, dash=(5.0, 3.0))
        for values, color in zip(reversed(errors), reversed(_COLORS), strict=True):
            draw_dots(panel, number, values, color, size=6)
        panel.x.span(0.2, len(number) + 0.8)
        panel.x.whole, panel.x.labelled = True, last
    alt = "Mean absolute errors of the parameters of each set by three methods, and the mean of Tedaldi."
    return Figure(
        "Errors of every set",
        sheet.draw("set-errors", 36 + 170 * len(GROUPS) + 24, alt),
        (
            *(Legend("dot", c, called[m]) for m, c in zip(METHODS, _COLORS, strict=True)),
            Legend("dash", "muted", "Tedaldi, mean of its 40 sets"),
        ),
    )


def example_figures(study: TedaldiStudy) -> tuple[Figure, ...]:
    """Return the signals of the examples, accelerometers first as in Tedaldi."""
    return tuple(
        Figure(
            f"Fig. 4.{4 * which + k + 1}: {sensor}, example {k + 1}",
            _draw_signals(f"signals-{sensor}-{k}", example.t_s, example.before[which], f"{sensor} [{unit}]"),
            tuple(Legend("line", axis, axis) for axis in _AXES),
        )
        for which, (sensor, unit) in enumerate(_SENSORS)
        for k, example in enumerate(study.examples)
    )


def detector_figure(study: TedaldiStudy) -> Figure:
    """Return the detected rests over the accelerometer's signals."""
    example = study.examples[0]
    return Figure(
        "Fig. 4.9: static detector over the accelerometer, example 1",
        _draw_signals("detector", example.t_s, example.before[0], "accelerometer [m/s²]", rests=example.rests),
        (*(Legend("line", axis, axis) for axis in _AXES), Legend("band", "before", "at rest")),
    )


def _draw_signals(name: str, t_s: Floats, values: Floats, title: str, rests: Floats | None = None) -> Plot:
    """Return the envelope of signals (n, 3) over time, with rests (k, 2) shaded."""
    step = -(-len(t_s) // _BINS)
    first = np.arange(0, len(t_s), step)
    low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)

    sheet = Sheet()
    panel = sheet.panel(f"{title[:1].upper()}{title[1:]}", top=36, height=190, x_label="time [s]")
    for k, axis in enumerate(_AXES):
        draw_envelope(panel, t_s[first], low[:, k], high[:, k], axis)
    set_y_limits(panel, low, high)
    panel.x.span(t_s[0], t_s[-1])
    panel.across(0.0, "muted")
    if rests is not None:
        panel.shade(rests[:, 0], rests[:, 1], "before", alpha=0.3)
    return sheet.draw(name, 296, f"{title} over time, x, y and z.")


def improvement_figures(study: TedaldiStudy) -> tuple[Figure, ...]:
    """Return a motion of the first example before and after its calibration, one for each axis of each sensor."""
    example = study.examples[0]
    motions = np.stack([example.rests[:-1, 1], example.rests[1:, 0]], axis=1)
    return tuple(
        Figure(
            f"Fig. 4.{10 + 3 * which + k}: {sensor}, {axis} axis",
            _improved(example, which, k, motions[(3 * which + k) * len(motions) // 6], f"{sensor} {axis} [{unit}]"),
            (
                Legend("line", "before", "as recorded"),
                Legend("line", "after", "calibrated"),
                Legend("line", "heldout", "without noise and errors"),
            ),
        )
        for which, (sensor, unit) in enumerate(_SENSORS)
        for k, axis in enumerate(_AXES)
    )


def _improved(example: Example, which: int, k: int, motion: Floats, title: str) -> Plot:
    room = 0.3  # seconds on either side
    shown = (example.t_s >= motion[0] - room) & (example.t_s <= motion[1] + room)
    t_s = example.t_s[shown]
    before, after, truth = (pair[which][shown, k] for pair in (example.before, example.after, example.truth))

    sheet = Sheet()
    panel = sheet.panel(f"{title[:1].upper()}{title[1:]}", top=36, height=190)
    panel.line(t_s, before, "before", width=1.4)
    panel.line(t_s, after, "after", width=1.4)
    panel.line(t_s, truth, "heldout", width=1.2)
    set_y_limits(panel, before, after, truth)
    panel.x.span(t_s[0], t_s[-1])
    panel.x.labelled = False
    panel = sheet.panel("Error", top=276, height=90, x_label="time [s]")
    panel.line(t_s, before - truth, "before", width=1.4)
    panel.line(t_s, after - truth, "after", width=1.4)
    set_y_limits(panel, before - truth, after - truth)
    panel.across(0.0, "muted")
    panel.x.span(t_s[0], t_s[-1])
    return sheet.draw(f"improved-{which}-{k}", 436, f"{title} of one motion: as recorded, calibrated and true.")
