"""Panels of figures: round ticks, places, and paths."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gnomon.report.drawing.figures import Sheet, log_limits
from gnomon.report.drawing.panel import DASHED, Panel, area_path, dot_path, line_path
from gnomon.report.numbers import Scale, decade_ticks, round_numbers


@pytest.mark.parametrize(
    ("low", "high", "most", "ticks"),
    [
        (0, 60, 7, [0, 10, 20, 30, 40, 50, 60]),
        (21.7, 23.7, 7, [22, 22.5, 23, 23.5]),
        (-0.54, 0.54, 5, [-0.5, -0.25, 0, 0.25, 0.5]),
        (-36.4, 36.4, 3, [-25, 0, 25]),
        (0, 0.0213, 5, [0, 0.005, 0.01, 0.015, 0.02]),
        (1e6, 1e6 + 3, 5, [1e6, 1e6 + 1, 1e6 + 2, 1e6 + 3]),
    ],
)
def test_round_numbers(low, high, most, ticks):
    assert round_numbers(low, high, most) == pytest.approx(ticks, abs=1e-12 * (abs(low) + abs(high)))


@given(low=st.floats(-1e6, 1e6), length=st.floats(1e-3, 1e6), most=st.integers(2, 9))
def test_round_numbers_lie_inside_in_equal_steps(low, length, most):
    high = low + length
    ticks = np.array(round_numbers(low, high, most))
    assert len(ticks) >= 2
    room = 1e-6 * length
    assert ticks[0] >= low - room
    assert ticks[-1] <= high + room
    step = np.diff(ticks)
    assert np.ptp(step) <= room
    mantissa = step[0] / 10.0 ** np.floor(np.log10(step[0] * (1 + 1e-6)))
    assert min(abs(mantissa - of) for of in (1, 2, 2.5, 5)) < 1e-3 * mantissa
    if len(ticks) > 2:  # else a smaller step was needed
        assert len(ticks) - 1 <= most


def test_counts_have_whole_ticks():
    assert list(round_numbers(0.4, 38.6, 8, whole=True)) == [5, 10, 15, 20, 25, 30, 35]
    assert list(round_numbers(0.4, 3.6, 8, whole=True)) == [1, 2, 3]
    assert list(round_numbers(0.4, 1.6, 8, whole=True)) == [1]


@pytest.mark.parametrize("span", [(0.0, 0.0), (0.0, float("nan")), (0.0, float("inf"))])
def test_no_round_numbers_where_there_is_no_span(span):
    assert list(round_numbers(*span, 5)) == []


def test_decades():
    assert decade_ticks(10**-3.1, 10**1.1) == pytest.approx([1e-3, 1e-2, 0.1, 1, 10])
    assert len(decade_ticks(1e-9, 1e9)) <= 7


def test_places_of_a_scale():
    scale = Scale(100.0, -50.0, 5)  # upwards, as y scales are
    scale.span(-1, 1)
    np.testing.assert_allclose(scale.places(np.array([-1.0, 0.0, 1.0, np.nan])), [100, 75, 50, np.nan])
    scale.span(0.1, 1000)
    scale.logarithmic = True
    np.testing.assert_allclose(scale.places(np.array([0.1, 10.0, 1000.0, 0.0, -1.0])), [100, 75, 50, np.nan, np.nan])
    assert [label for _, label in scale.marks()] == ["0.1", "1", "10", "100", "1000"]
    scale.span(3, 3)
    assert np.isfinite(scale.places(np.array([3.0]))).all()


def test_ticks_beyond_the_panel_are_left_out_and_labels_have_true_minus_signs():
    scale = Scale(0.0, 10.0, 5)
    scale.span(1, -1)  # downwards
    scale.ticks = (-2, -1, 0.1 + 0.2, 1)
    assert scale.marks() == [(10.0, "−1"), (pytest.approx(3.5), "0.3"), (0.0, "1")]


def test_a_line_is_interrupted_by_what_is_not_known():
    x = np.array([np.nan, 1.0, 2.0, 3.0, 4.0, 5.0])
    y = np.array([0.0, 1.234, -0.001, np.nan, 1e9, 7.0])
    assert line_path(x, y) == "M1 1.23 2 0M4 99999 5 7"
    assert area_path(x, y) == "M1 1.23 2 0zM4 99999 5 7z"
    assert dot_path(x, y) == "M1 1.23h0M2 0h0M4 99999h0M5 7h0"
    assert line_path(x[:1], y[:1]) == area_path(x[:0], y[:0]) == ""


def drawn(paint):
    """Return (path, style) of everything that is drawn in a panel of 100 by 50 at (10, 20), from 0 to 1 both ways."""

    sheet = Sheet()
    panel = sheet.bare_panel(left=10, top=20, width=100, height=50)
    panel.y.grid = False
    paint(panel)
    return re.findall(r'<path d="([^"]*)"[^>]* style="([^"]*)"', sheet.draw("name", 100, "alt").svg)


def test_what_can_be_drawn():
    x, y = np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 0.5])
    assert drawn(lambda p: p.line(x, y, "x", width=2, dash=DASHED)) == [
        ("M10 70 60 20 110 45", "fill:none;stroke:var(--plot-x);stroke-width:2;stroke-dasharray:8 6")
    ]
    assert drawn(lambda p: p.across(0.5, "y"))[0][0] == "M10 45 110 45"
    assert drawn(lambda p: p.upright(0.5, "y"))[0][0] == "M60 70 60 20"
    assert drawn(lambda p: p.shade(x[:1], x[1:2], "y", alpha=0.5))[0][0] == "M10 70H60V20H10z"
    assert drawn(lambda p: p.strip(0.2, 0.4, "y", alpha=0.5))[0][0] == "M10 60H110V50H10z"
    assert drawn(lambda p: p.steps(np.array([0.5, 1.0]), x, "y"))[0][0] == "M10 45 60 45 60 20 110 20"
    assert drawn(lambda p: p.dots(x, y, "y", 3))[0][0] == "M10 70h0M60 20h0M110 45h0"
    assert drawn(lambda p: p.band(x, y - 0.1, y, "y"))[0][0] == "M10 75 60 25 110 50 110 45 60 20 10 70z"
    assert drawn(lambda p: p.band(x, np.full(3, np.nan), y, "y")) == []


def test_areas_lie_below_lines_and_limits_may_come_last():
    def paint(panel):
        panel.line(np.array([0.0, 2.0]), np.array([0.0, 2.0]), "x")
        panel.strip(0, 2, "y", alpha=1.0)
        panel.x.span(0, 2)
        panel.y.span(0, 2)

    assert [path for path, _ in drawn(paint)] == ["M10 70H110V20H10z", "M10 70 110 20"]


def test_cells_are_one_path_a_level():
    corners = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5], [0.0, 0.0]])
    level = np.array([1.0, 1.0, 0.5, 0.0, np.nan])
    paths = drawn(lambda p: p.cells(corners, (0.5, 0.5), level=level, color="after"))
    assert paths == [
        ("M10 45H60V20H10z", "fill:var(--plot-after);fill-opacity:0.5"),
        ("M10 70H60V45H10zM60 70H110V45H60z", "fill:var(--plot-after)"),
    ]


def test_logarithmic_limits_hold_whole_decades():
    panel = Panel(0, 0, 100, 100)
    log_limits(panel, np.array([0.02, np.nan, -1.0]), np.array([7.0]))
    assert panel.y.low < 0.01 < 10 < panel.y.high
    assert [label for _, label in panel.y.marks()] == ["0.01", "0.1", "1", "10"]
    log_limits(panel, np.full(3, np.nan))
    assert panel.y.low < 1 < 10 < panel.y.high


def test_texts_are_escaped_and_empty_ones_left_out():
    sheet = Sheet()
    sheet.text("a < b & \udcff", x=1, y=2.345, color="ink", weight="bold")
    sheet.text("", x=1, y=1, color="ink")
    text = (
        '<text style="--size:12.5px;fill:var(--plot-ink);font-weight:600" x="1" y="2.35">a &lt; b &amp; \\udcff</text>'
    )
    assert sheet.draw("n", 100, "alt").svg.endswith(f'"alt">{text}</svg>')
