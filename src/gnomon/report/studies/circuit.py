"""The page of the study of a circuit."""

import numpy as np

from ...options.requirements import QUANTITIES as KNOWN
from ...study.circuit import CONFIDENCE, SIZES, CircuitStudy, circuit_claims, joint_costs, level_numbers
from ...study.circuit_walk import MEASURES, QUANTITIES, SCENARIO, WAYS
from ..drawing.figures import LEFT, RIGHT, WIDTH, Sheet, draw_dots, log_limits
from ..numbers import fixed_text, number_text
from ..page import Figure, KeyNumber, Legend, Prose, ReportPage, ReportTable, Section
from . import study_page

_SETUP = (
    f"A rig within the tolerances of a data sheet (MPU-6000; mounted by hand) is carried round an ellipse of "
    f"{SCENARIO.length_m[0]:g} to {SCENARIO.length_m[1]:g} m, with the steps and the sway of a walk. Nothing is "
    f"rendered: landmarks aside of the way are seen where they are but for {SCENARIO.pixel_noise_px:g} px of noise, "
    f"for {SCENARIO.longest} images at most, at {SCENARIO.camera_rate_hz:g} Hz; none is a wrong match, and the lens "
    "is known. So this is what calibration costs where everything else goes well.",
    "The path is estimated by gnomon's own filter (an invariant multi-state constraint filter) with the calibration "
    "frozen; it begins at the true pose, with biases as after switching the sensor on anew, and follows them. It "
    "never recognises the place where it began: the end is where odometry alone puts it.",
    "Calibrations are gnomon's own, of recordings of 30 s of the same rig; that of an IMU in many positions is off as "
    "another sensor's of the same noise was, and that without a board sees landmarks of a room, off by 0.3 px, of "
    "which only rough places are known.",
)
_PANEL = (WIDTH - LEFT - RIGHT, 380.0)
_COLORS = {"nominal": "before", "camera-imu basic": "heldout", "camera-imu full": "after"}


def circuit_page(study: CircuitStudy) -> ReportPage:
    """Return the page of the study."""
    return study_page(
        "Round a circuit",
        f"Odometry with calibrations of different depth: {study.runs} rigs, each with its own walk, seed {study.seed}",
        tuple(circuit_claims(study)),
        _key_numbers(study),
        (
            Section("levels", "Calibrations", blocks=(_levels(study), _closures(study), _example(study))),
            Section("parts", "One quantity off at a time", blocks=(_parts(study), Prose((_derivation(study),)))),
            Section("setup", "How it was simulated", blocks=(Prose(_SETUP),)),
        ),
    )


def _key_numbers(study: CircuitStudy) -> tuple[KeyNumber, ...]:
    def closure(way: str) -> str:
        mean, low, high = level_numbers(study, way)["closure_percent"]
        return f"{number_text(mean, 2)} % ({number_text(low, 2)} to {number_text(high, 2)})"

    return tuple(
        KeyNumber(f"End off the beginning, {way}", closure(way), "of the way's length, mean")
        for way in ("nominal", "camera-imu full", "without a board", "truth")
    )


def _levels(study: CircuitStudy) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for way in WAYS:
        numbers = level_numbers(study, way)
        rows.append((way, *(_interval(*numbers[name]) for name in ("closure_percent", *MEASURES))))
    return ReportTable(
        "Errors by calibration",
        ("calibration", "closure [% of the way]", "closure [m]", "absolute (ATE) [m]", "relative over 10 m (RPE) [m]"),
        rows,
        f"Means over {study.runs} walks, with {100 * CONFIDENCE:.0f} % confidence. Absolute and relative errors as evo "
        "defines them: rms distance after rigid alignment, and rms error of the translation over each 10 m.",
        dense=True,
    )


def _interval(mean: float, low: float, high: float) -> str:
    return f"{number_text(mean, 3)} ({number_text(low, 3)} to {number_text(high, 3)})"


def _closures(study: CircuitStudy) -> Figure:
    sheet = Sheet()
    panel = sheet.panel("End off the beginning [% of the way]", top=36, height=220)
    share = 100 * study.errors[..., MEASURES.index("closure_m")] / study.length_m[:, None]
    log_limits(panel, *share.T)
    spread = np.linspace(-0.3, 0.3, len(share))
    for column, way in enumerate(WAYS):
        draw_dots(panel, column + spread, share[:, column], "before", size=5)
        mean = level_numbers(study, way)["closure_percent"][0]
        draw_dots(panel, np.array([float(column)]), np.array([mean]), "heldout", size=9)
        sheet.text(_SHORT[way], x=LEFT + (column + 0.5) * _PANEL[0] / len(WAYS), y=276, color="ink", align="center")
    panel.x.span(-0.5, len(WAYS) - 0.5)
    panel.x.labelled, panel.x.ticks = False, ()
    return Figure(
        "Error at the closure of the loop",
        sheet.draw("closures", 290, "Error at the end of every walk by calibration, on a logarithmic scale."),
        (Legend("dot", "before", "a walk"), Legend("dot", "heldout", "mean")),
    )


_SHORT = dict(zip(WAYS, ("nominal, x 10", "nominal", "imu", "basic", "full", "no board", "truth"), strict=True))


def _example(study: CircuitStudy) -> Figure:
    """Return the walk whose end is off by the median, with the nominal calibration, seen from above."""
    errors = study.errors[:, WAYS.index("nominal"), 0]
    paths = study.outcomes[int(np.argsort(errors)[len(errors) // 2])].example
    sheet = Sheet()
    panel = sheet.panel("Seen from above [m]", top=36, height=_PANEL[1])
    for way, color in _COLORS.items():
        panel.line(paths[WAYS.index(way), :, 0], paths[WAYS.index(way), :, 1], color, width=1.6)
    panel.line(paths[-1, :, 0], paths[-1, :, 1], "ink", width=1.0, dash=(4.0, 3.0))
    drawn = np.concatenate([paths[-1], *(paths[WAYS.index(way)] for way in _COLORS)])
    low, high = np.nanmin(drawn, axis=0), np.nanmax(drawn, axis=0)
    middle, scale = (low + high) / 2, 1.05 * float(np.max((high - low) / _PANEL))
    for axis, centre, length in zip((panel.x, panel.y), middle, _PANEL, strict=True):
        axis.span(centre - scale * length / 2, centre + scale * length / 2)
    return Figure(
        "One walk",
        sheet.draw("walk", 460, "The true way round, and the ways by odometry with three calibrations."),
        (*(Legend("line", color, way) for way, color in _COLORS.items()), Legend("dash", "ink", "true")),
    )


def _parts(study: CircuitStudy) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(QUANTITIES):
        quantity = KNOWN[name]
        sizes = [number_text(size / quantity.size, 2) for size in study.sizes[:, k]]
        costs = [fixed_text(100 * cost, 1) for cost in study.costs_m[:, k]]
        derived = number_text(study.derived[k] / quantity.size, 2)
        cells = [cell for pair in zip(sizes, costs, strict=True) for cell in pair]
        rows.append((f"{quantity.words.format(sensor='camera')} [{quantity.unit}]", *cells, derived))
    return ReportTable(
        "What an error of each quantity adds",
        ("off in", *(text for what in SIZES for text in (what, "adds [cm]")), "limit that follows"),
        rows,
        f"Rms over {len(study.parts)} walks of the absolute distance between the path with the error and that with the "
        f"true calibration; noise alone costs {100 * study.own_m:.1f} cm. Errors are drawn per element, normally, with "
        "the size as standard deviation.",
        dense=True,
    )


def _derivation(study: CircuitStudy) -> str:
    by_limits, by_derived = joint_costs(study)
    return (
        f"A limit follows from asking that all {len(QUANTITIES)} quantities, each off by its limit, together add as "
        f"much as the odometry's own drift, and each the same part of it: its own drift over the root of "
        f"{len(QUANTITIES)}, over what an error of size one adds. With all quantities off at once, those that follow "
        f"added {100 * by_derived:.1f} cm; the limits of --for vio added {100 * by_limits:.1f} cm."
    )
