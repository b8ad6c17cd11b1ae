"""Figures of reports on Matplotlib: all of them are drawn, with the numbers and the colours of the page."""

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from gnomon.errors import OptionError
from gnomon.report.drawing.figures import Sheet
from gnomon.report.drawing.matplotlib_figure import draw_with_matplotlib, page_colors
from gnomon.report.page import Figure, result_page

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
pyplot = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def _closed():
    yield
    pyplot.close("all")


def figures(result):
    page = result_page(result)
    blocks = [*page.front, *(block for section in page.sections for block in section.blocks)]
    return [block for block in blocks if isinstance(block, Figure)]


def test_every_figure_of_a_report_is_drawn(make_result):
    for result in (make_result(), make_camera_imu_result(cameras=1, duration_s=10.0)):
        for block in figures(result):
            figure = result.plot(block.plot.name)
            assert len(figure.axes) == len(block.plot.panels)
            figure.canvas.draw()
            texts = {text.get_text() for text in figure.texts}
            assert texts >= {block.title, *(text.text for text in block.plot.texts)}
            pyplot.close(figure)


def test_lines_keep_their_numbers_places_and_colours():
    sheet = Sheet()
    panel = sheet.panel("title", top=30, height=100)
    panel.line(np.array([0.0, 1.0, 2.0]), np.array([1.0, 10.0, 100.0]), "x", width=2.0)
    panel.strip(2.0, 3.0, "muted", alpha=0.5)
    panel.x.span(0.0, 2.0)
    panel.y.logarithmic = True
    panel.y.span(0.5, 200.0)
    figure = draw_with_matplotlib([("name", sheet.draw("n", 200, "alt"), ())])
    axes = figure.axes[0]
    line = axes.lines[0]
    assert line.get_ydata().tolist() == [1.0, 10.0, 100.0]
    assert line.get_color() == page_colors()["x"] == "#0072b2"
    assert line.get_linewidth() == pytest.approx(1.44)
    assert axes.get_yscale() == "log"
    assert axes.get_ylim() == (0.5, 200.0)
    assert axes.get_xlim() == (0.0, 2.0)
    assert [label.get_text() for label in axes.get_yticklabels()] == ["1", "10", "100"]
    box = axes.get_position()
    assert (box.width * 7.6, box.height * figure.get_figheight()) == pytest.approx((6.68, 1.0))
    assert len(axes.collections) == 1


def test_the_beginning_of_a_name_draws_all_that_have_it():
    result = make_camera_imu_result(cameras=2, duration_s=10.0)
    chosen = [block.plot for block in figures(result) if block.plot.name.startswith("overview")]
    assert len(chosen) >= 2
    assert len(result.plot("overview").axes) == sum(len(plot.panels) for plot in chosen)


def test_an_unknown_figure_is_answered_with_those_that_there_are(make_result):
    result = make_result()
    with pytest.raises(OptionError, match='no figure "allen" here') as error:
        result.plot("allen")
    for block in figures(result):
        assert f"{block.plot.name}: {block.title}" in str(error.value)
