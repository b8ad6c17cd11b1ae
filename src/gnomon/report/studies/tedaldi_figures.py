"""The figures of the study of Tedaldi: Figs. 4.1 to 4.15 drawn anew, and the errors of all sets."""

from collections.abc import Mapping

import numpy as np

from ...recording import Floats
from ...study.tedaldi import GROUPS, Example, TedaldiStudy
from ...study.tedaldi_trial import METHODS
from ..drawing.figures import Plot, Sheet, draw_dots, draw_envelope, log_limits, set_y_limits
from ..page import Figure, Legend

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
            _signals(f"signals-{sensor}-{k}", example.t_s, example.before[which], f"{sensor} [{unit}]"),
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
        _signals("detector", example.t_s, example.before[0], "accelerometer [m/s²]", rests=example.rests),
        (*(Legend("line", axis, axis) for axis in _AXES), Legend("band", "before", "at rest")),
    )


def _signals(name: str, t_s: Floats, values: Floats, title: str, rests: Floats | None = None) -> Plot:
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
