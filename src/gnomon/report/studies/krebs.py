"""The page of the study of Krebs, and its figures."""

from collections.abc import Sequence

import numpy as np

from ...recording import Floats
from ...study.krebs import KrebsSample, KrebsStudy, group_mean, krebs_group_rms, scatter_reduction
from ...study.krebs_claims import krebs_claims
from ...study.krebs_run import (
    CHANGES,
    GROUPS,
    NAMES,
    PIXEL_NOISE_PX,
    SCENARIO,
    UNITS,
    Group,
    KrebsRig,
    group_columns,
    stated_mean,
    stated_sigma,
)
from ..drawing.figures import WIDTH, Plot, Sheet
from ..drawing.panel import Panel
from ..numbers import finite_values, fixed_text, number_text, positive_or
from ..page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section
from . import study_page

_SHOWN = {"m": "mm", "s": "ms", "rad": "mrad", "-": "10⁻³", "rad/s per m/s^2": "mrad/s per m/s²", "m/s^2": "mm/s²"}
"""Units as which a thousandth of each is shown."""
_SETUP = (
    f"One motion of {SCENARIO.duration_s:g} s before a checkerboard, ever new noise: IMU at 200 Hz with the errors and "
    "the noise of Table A.1, gravity, the Earth's rate; mean rate 0.366 rad/s, mean acceleration 3.12 m/s². S2 and S3 "
    "have a tenth and a hundredth of the IMU's noise and of the walks of its biases.",
    "Krebs does not state board, lens, frame rate or pixel noise of its simulation. Here: 7 x 6 corners of 60 mm, "
    f"640 x 480 px, {SCENARIO.camera_rate_hz:g} frames/s, {PIXEL_NOISE_PX:g} px of noise on each corner and axis; "
    "chosen before the first run, and kept. The motion is another one than Krebs's, at the same means.",
    "The estimate is Krebs's: all constants of Table 4.1, gravity with its three elements, the noise known, no "
    "robust loss. A sixth-order spline of 25 knots/s follows the motion, which ends at 2 Hz. The basic model knows "
    "neither M, S, q_bg nor B_g.",
    "q_cb and q_bg are the vector parts of the quaternions of the error, half the angle, as in Table B.2.",
)
_DOUBTS = (
    "Table B.1 gives p_cb,z a mean error of -2 cm at every noise level, though section 5.1.2 finds the means on the "
    "truth. Table B.2 estimates -10 mm: the reference was +10 mm, so a sign in the reference explains all of it. Here "
    "the truth is -10 mm; σ does not depend on it.",
    "Table 5.3 is the mean of the elements in Tables B.1 and B.2 for p_cb, M_a, S_g, S_a, B_g and, with w as "
    "a fourth element, q_bg; but not for M_g (0.002456 against 0.003739) and q_cb (0.001586 against 0.000371). The "
    "tables of appendix B are compared here.",
    "Table A.1 has the walk of the gyroscope's bias as 0.0087 rad/√s, a unit of white noise. Read as a bias that "
    "walks by 0.0087 rad/s/√s, a hundred times what such sensors do, it gives σ of S_g and M_g as in Table B.1; with "
    "a consumer sensor's walk they would be far smaller (last table). It seems to have been simulated as printed.",
    "S_a,z is 0.9986 in Table A.1, and 0.9998 is found without error in Table B.2; B_g is 0.00018 in the table and "
    "seven times that in the matrix below it. Here S_a,z is 0.9986 and B_g the matrix.",
    "The Earth's rate is in the simulation and not in the model, as in Krebs. It turns in the body like gravity, "
    "so B_g takes up as much as Ω / g, 7·10⁻⁶ rad/s per m/s²: nothing beside the noise of S1, a sigma or two in S3. "
    "In Table B.1, too, B_g xy, zx and zy of S3 are off by 7.4, 3.6 and 5.0 standard errors of 100 runs.",
)


def krebs_page(study: KrebsStudy) -> ReportPage:
    """Return the page of the study."""
    return study_page(
        "Study of Krebs",
        f"Krebs: {study.runs} simulated recordings of each of {len(study.samples)} series, seed {study.seed}",
        tuple(krebs_claims(study)),
        _key_numbers(study),
        (_translation(study), _every(study), _levels(study), _neglect(study), _independent(study), _setup(study)),
    )


def _key_numbers(study: KrebsStudy) -> tuple[KeyNumber, ...]:
    first = study.samples[0]
    place = group_columns("p_cb")
    step = np.exp(np.mean(np.log(scatter_reduction(study.noise_levels)), axis=1))
    return (
        KeyNumber("σ of p_cb, S1", f"{_row(1e3 * first.scatter[place], 3)} mm", "x, y, z; Krebs: 1.71, 3.91, 6.86 mm"),
        KeyNumber(
            "Squared error over covariance",
            ", ".join(fixed_text(sample.nees, 1) for sample in study.noise_levels),
            f"S1, S2, S3; {len(NAMES)} where the stated covariance is true",
        ),
        KeyNumber(
            "A tenth of the noise",
            f"σ / {number_text(step[0], 3)}, / {number_text(step[1], 3)}",
            "of p_cb, mean of the axes; Krebs: 2 to 4",
        ),
        KeyNumber(
            "Basic model",
            f"{_row(1e3 * study.basic.mean[place], 2)} mm",
            "mean error of p_cb; Krebs: up to 5 mm on one axis",
        ),
    )


def _row(values: Floats, digits: int) -> str:
    return ", ".join(number_text(float(value), digits) for value in values)


def _translation(study: KrebsStudy) -> Section:
    group, place = GROUPS[0], group_columns("p_cb")
    rows = [
        cells
        for k, sample in enumerate(study.noise_levels)
        for cells in (
            (f"{sample.series.name}, Table 5.2", *(number_text(1e3 * s, 4) for s in group.sigma[k])),
            (f"{sample.series.name}, here", *(number_text(1e3 * float(s), 4) for s in sample.scatter[place])),
            (f"{sample.series.name}, stated by gnomon", *(number_text(1e3 * float(s), 4) for s in sample.sigma[place])),
        )
    ]
    return Section(
        "translation",
        "Translation from camera to IMU (Table 5.2, Figs. 5.2 and B.1)",
        "The truth is (103, -15, -10) mm.".replace("-", "−"),
        (
            ReportTable("σ of p_cb [mm]", ("", "x", "y", "z"), rows, dense=True),
            Figure(
                "Estimates of p_cb",
                draw_translation(study),
                (
                    *(Legend("band", axis, axis) for axis in ("x", "y", "z")),
                    Legend("line", "ink", "fitted normal distribution"),
                    Legend("dash", "accent", "truth"),
                ),
                "Each panel has its own scale.",
            ),
        ),
    )


def _every(study: KrebsStudy) -> Section:
    blocks = [_parameter_table(sample, k) for k, sample in enumerate(study.noise_levels)]
    return Section(
        "parameters",
        "All parameters (Tables 5.3, B.1 and B.2)",
        "σ is the scatter over the runs, σ_cal of Krebs. Beside it the σ that gnomon states for one "
        "recording, and z, the rms error in units of it, which is 1 where it is true.",
        (
            _table_5_3(study),
            _group_table(study),
            *blocks,
            Figure(
                "Errors of S_a (Fig. B.2)",
                draw_scale_errors(study),
                (
                    *(Legend("band", axis, axis) for axis in ("x", "y", "z")),
                    Legend("line", "ink", "fitted normal distribution"),
                    Legend("dash", "accent", "no error"),
                ),
            ),
        ),
    )


def _table_5_3(study: KrebsStudy) -> ReportTable:
    ours, tabled = group_mean(study.samples[0].scatter), group_mean(stated_sigma(0))
    return ReportTable(
        "Table 5.3: σ of one recording of 90 s, S1, mean of the elements",
        ("", "unit", "Table 5.3", "mean of B.1, B.2", "here"),
        tuple(
            (
                f"{group.symbol}, {group.name}",
                _SHOWN[group.unit],
                number_text(1e3 * group.table_5_3, 4),
                number_text(1e3 * tabled[group.symbol], 4),
                number_text(1e3 * ours[group.symbol], 4),
            )
            for group in GROUPS
        ),
        "Tables B.1 and B.2 have no σ of gravity and of the time offset. Of q_cb and q_bg, Table 5.3 has the "
        "mean of four elements, w among them; the other columns that of three.",
    )


def _group_table(study: KrebsStudy) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for group in GROUPS:
        cells = [group.symbol, _SHOWN[group.unit]]
        for k, sample in enumerate(study.noise_levels):
            ours = krebs_group_rms(sample.scatter)[group.symbol]
            theirs = krebs_group_rms(stated_sigma(k))[group.symbol]
            cells += [number_text(1e3 * theirs, 3), number_text(1e3 * ours, 3), fixed_text(ours / theirs, 2)]
        rows.append(tuple(cells))
    head = [f"{sample.series.name} {what}" for sample in study.noise_levels for what in ("B.1, B.2", "here", "ratio")]
    return ReportTable("σ of each group, rms over its elements", ("", "unit", *head), rows, dense=True)


def _parameter_table(sample: KrebsSample, k: int) -> ReportTable:
    stated, means = stated_sigma(k), stated_mean(k)
    z = np.sqrt(np.mean((sample.errors / np.array([run.sigma for run in sample.found])) ** 2, axis=0))
    return ReportTable(
        f"{sample.series.name}: every element",
        ("", "unit", "mean error, B.1", "here", "σ, B.1 and B.2", "here", "σ of gnomon", "z"),
        tuple(
            (
                name,
                _SHOWN[unit],
                number_text(1e3 * float(means[i]), 3),
                number_text(1e3 * float(sample.mean[i]), 2),
                number_text(1e3 * float(stated[i]), 3),
                number_text(1e3 * float(sample.scatter[i]), 3),
                number_text(1e3 * float(sample.sigma[i]), 3),
                fixed_text(float(z[i]), 2),
            )
            for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True))
        ),
        dense=True,
    )


def _levels(study: KrebsStudy) -> Section:
    rows: list[tuple[str, ...]] = []
    stated = [np.array(sigma) for sigma in GROUPS[0].sigma]
    rows.append(("Krebs, Table 5.2", *_steps(np.array([stated[0] / stated[1], stated[1] / stated[2]]))))
    rows.append((f"here, {PIXEL_NOISE_PX:g} px", *_steps(scatter_reduction(study.noise_levels))))
    rows.append(("here, without pixel noise", *_steps(scatter_reduction(study.without_pixel_noise))))
    sigmas = [
        (sample.series.name, *(number_text(1e3 * float(s), 3) for s in sample.scatter[group_columns("p_cb")]))
        for sample in (*study.noise_levels, *study.without_pixel_noise)
    ]
    return Section(
        "noise",
        "Noise levels (Fig. 5.3)",
        "The pixel noise stays where it is while the IMU's falls: p_cb then improves by less than the noise. "
        "Without pixel noise it follows the noise.",
        (
            ReportTable(
                "By what σ of p_cb falls when the IMU's noise falls to a tenth",
                ("", "S1 to S2: x", "y", "z", "S2 to S3: x", "y", "z"),
                rows,
            ),
            ReportTable("σ of p_cb [mm]", ("", "x", "y", "z"), tuple(sigmas), dense=True),
            Figure(
                "Fitted distributions of the error of p_cb",
                noise_levels(study),
                (
                    *(
                        Legend("line", color, sample.series.name)
                        for color, sample in zip(LEVELS, study.noise_levels, strict=True)
                    ),
                    Legend("dash", "accent", "truth"),
                ),
                "All peaks are drawn at the same height.",
            ),
        ),
    )


def _steps(values: Floats) -> tuple[str, ...]:
    return tuple(number_text(float(value), 3) for value in values.ravel())


def _neglect(study: KrebsStudy) -> Section:
    place = group_columns("p_cb")
    rows = [
        (
            name,
            *(number_text(1e3 * float(v), 3) for v in sample.mean[place]),
            *(number_text(1e3 * float(v), 3) for v in sample.scatter[place]),
            *(number_text(1e3 * float(v), 3) for v in sample.sigma[place]),
        )
        for name, sample in (("extended", study.samples[0]), ("basic", study.basic))
    ]
    return Section(
        "neglect",
        "Neglecting the influences between the axes (Fig. 5.4)",
        "The same recordings of S1, calibrated with the extended and with the basic model.",
        (
            ReportTable(
                "p_cb [mm]",
                ("", "mean error x", "y", "z", "σ x", "y", "z", "stated σ x", "y", "z"),
                rows,
                "The basic model states the σ of a model that were true.",
            ),
            Figure(
                "Error of p_cb",
                draw_model_neglect(study),
                (
                    Legend("band", "x", "extended model"),
                    Legend("band", "z", "basic model"),
                    Legend("dash", "accent", "truth"),
                ),
            ),
        ),
    )


def _independent(study: KrebsStudy) -> Section:
    found = study.independence
    rows = [
        (
            name,
            _SHOWN[unit],
            number_text(1e3 * CHANGES[name.split(maxsplit=1)[0]], 3),
            number_text(1e3 * (CHANGES[name.split(maxsplit=1)[0]] + float(found.moved[k, k])), 6),
            number_text(float(found.of_others[k]), 2),
            found.moved_most(k),
        )
        for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True))
    ]
    return Section(
        "independence",
        "One parameter at a time (section 5.1.1)",
        "Recordings without noise. One parameter of the rig is changed; its estimate has to move by as much, and "
        "no other one.",
        (
            ReportTable(
                "What a change does to the estimates",
                ("changed", "unit", "by", "its estimate moved by", "largest other move [σ of S1]", "of"),
                rows,
                "Gravity's magnitude has a weak prior of 0.05 m/s² about the usual one, which holds g_w back.",
                dense=True,
            ),
        ),
    )


def _setup(study: KrebsStudy) -> Section:
    rows = [
        (setting.name, *(_ratio(run.sigma, group) for group in GROUPS if group.sigma))
        for setting, run in study.settings
    ]
    return Section(
        "setup",
        "How it was simulated, and what Krebs leaves open",
        blocks=(
            Prose(_SETUP),
            Prose(tuple(_fine(line) for line in _DOUBTS), points=True),
            ReportTable(
                "σ over that of S1 in Tables B.1 and B.2, rms over each group, one recording each",
                ("", *(group.symbol for group in GROUPS if group.sigma)),
                rows,
                "The σ that gnomon states, which the runs above confirm.",
            ),
        ),
    )


def _ratio(sigma: Floats, group: Group) -> str:
    theirs = krebs_group_rms(stated_sigma(0))[group.symbol]
    ours = (
        krebs_group_rms(sigma)[group.symbol] if finite_values(sigma[group_columns(group.symbol)]).size else float("nan")
    )
    return fixed_text(ours / theirs, 2)


def _fine(text: str) -> str:
    return text.replace("m/s^2", "m/s²").replace(" -1", " −1").replace(" -2 cm", " −2 cm")


AXES = ("x", "y", "z")
LEVELS = ("t1", "t3", "t5")
"""Colours of S1, S2 and S3."""
_DASHED = (4.0, 3.0)
_GAP, _TOP, _HEIGHT = 32.0, 40.0, 118.0
_PITCH = _HEIGHT + 84


def _histograms(name: str, samples: Sequence[KrebsSample], symbol: str, *, unit: str, truth: Floats) -> Plot:
    """Draw histograms of the estimates of a vector, a row for each series, with fitted normal distributions.

    Parameters
    ----------
    unit : of what is shown, a thousandth of that of the estimates
    truth : (3,), marked by a line; the errors count from there
    """
    place = group_columns(symbol)

    sheet = Sheet()
    for row, sample in enumerate(samples):
        for k, axis in enumerate(AXES):
            values = 1e3 * (truth[k] + sample.errors[:, place.start + k])
            panel = _third(sheet, f"{sample.series.name}: {axis} [{unit}]", row, k)
            _histogram(panel, values, axis)
            _normal(panel, values, "ink")
            panel.upright(1e3 * float(truth[k]), "accent", width=1.6, dash=_DASHED)
    alt = f"Histograms of {symbol} in {unit} of {', '.join(sample.series.name for sample in samples)}, three axes."
    return sheet.draw(name, _PITCH * len(samples), alt)


def noise_levels(study: KrebsStudy) -> Plot:
    """Draw the fitted distributions of p_cb at each noise level, with pixel noise and without it (Fig. 5.3)."""
    sheet = Sheet()
    for row, (samples, title) in enumerate(
        ((study.noise_levels, "with pixel noise"), (study.without_pixel_noise, "without"))
    ):
        for k, axis in enumerate(AXES):
            panel = _third(sheet, f"{axis} [mm], {title}", row, k)
            reach = 3.5e3 * max(float(sample.scatter[group_columns("p_cb").start + k]) for sample in study.noise_levels)
            for sample, color in zip(samples, LEVELS, strict=True):
                _normal(panel, 1e3 * sample.errors[:, group_columns("p_cb").start + k], color, peak=1.0)
            panel.upright(0.0, "accent", width=1.6, dash=_DASHED)
            panel.x.span(-reach, reach)
            panel.y.span(0.0, 1.08)
    return sheet.draw("levels", 2 * _PITCH, "Normal distributions of the error of p_cb at three noise levels.")


def draw_model_neglect(study: KrebsStudy) -> Plot:
    """Draw the histograms of p_cb's error with the extended and with the basic model (Fig. 5.4)."""
    sheet = Sheet()
    for k, axis in enumerate(AXES):
        at = group_columns("p_cb").start + k
        panel = _third(sheet, f"{axis} [mm]", 0, k)
        both = [1e3 * sample.errors[:, at] for sample in (study.samples[0], study.basic)]
        edges = _edges(np.concatenate(both))
        for values, color in zip(both, ("x", "z"), strict=True):
            _histogram(panel, values, color, edges)
            _normal(panel, values, color)
        panel.upright(0.0, "accent", width=1.6, dash=_DASHED)
    return sheet.draw("neglect", _PITCH, "Error of p_cb with the extended and with the basic model.")


def _third(sheet: Sheet, title: str, row: int, k: int) -> Panel:
    """Return the panel of an axis in a row of three."""
    width = (WIDTH - 2 * _GAP) / 3
    left, top = k * (width + _GAP), _TOP + _PITCH * row
    panel = sheet.panel("", top=top, height=_HEIGHT, left=left, right=WIDTH - left - width)
    panel.x.most, panel.y.ticks, panel.y.grid = 3, (), False
    sheet.text(title, x=left, y=top - 16, color="ink", weight="bold")
    return panel


def _edges(values: Floats) -> Floats:
    kept = finite_values(values)
    low, high = (float(kept.min()), float(kept.max())) if kept.size else (0.0, 1.0)
    room = 0.06 * (high - low) or 0.5
    return np.linspace(low - room, high + room, 6 + round(2 * np.sqrt(max(len(kept), 1))))


def _histogram(panel: Panel, values: Floats, color: str, edges: Floats | None = None) -> None:
    """Fill the density of values; the panel grows with it."""
    edges = _edges(values) if edges is None else edges
    kept = finite_values(values)
    density = np.histogram(kept, edges)[0] / max(len(kept), 1) / (edges[1] - edges[0])
    panel.band(np.repeat(edges, 2)[1:-1], np.zeros(2 * len(density)), np.repeat(density, 2), color, alpha=0.4)
    _hold(panel, edges[0], edges[-1], float(density.max()))


def _normal(panel: Panel, values: Floats, color: str, *, peak: float | None = None) -> None:
    """Draw the normal distribution that is fitted to values, with its density or with a peak of this height."""
    kept = finite_values(values)
    middle, sigma = float(kept.mean()), positive_or(float(kept.std(ddof=1)))
    x = middle + sigma * np.linspace(-4, 4, 161)
    height = 1 / (sigma * np.sqrt(2 * np.pi)) if peak is None else peak
    panel.line(x, height * np.exp(-0.5 * ((x - middle) / sigma) ** 2), color, width=1.5)
    _hold(panel, middle - 3 * sigma, middle + 3 * sigma, height)


def _hold(panel: Panel, low: float, high: float, top: float) -> None:
    """Let the panel reach at least so far; a new one reaches from 0 to 1."""
    fresh = (panel.x.low, panel.x.high, panel.y.high) == (0.0, 1.0, 1.0)
    ends = (low, high) if fresh else (min(low, panel.x.low), max(high, panel.x.high))
    panel.x.span(*ends)
    panel.y.span(0.0, 1.06 * top if fresh else max(1.06 * top, panel.y.high))


def draw_translation(study: KrebsStudy) -> Plot:
    """Draw p_cb at each noise level (Figs. 5.2 and B.1)."""
    return _histograms("p-cb", study.noise_levels, "p_cb", unit="mm", truth=KrebsRig().T_cam_imu[:3, 3])


def draw_scale_errors(study: KrebsStudy) -> Plot:
    """Draw the errors of S_a at each noise level (Fig. B.2)."""
    return _histograms("s-a", study.noise_levels, "S_a", unit="10⁻³", truth=np.zeros(3))
