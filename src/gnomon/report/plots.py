"""The pages of all kinds of results, and their figures one by one, for Matplotlib."""

from typing import TYPE_CHECKING

from ..errors import OptionError
from ..results.camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics
from ..results.result import Result
from ..results.sensor_noise import NoiseResult
from ..results.temperature import TemperatureResult
from .page import Figure, ReportPage

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MatplotlibFigure


def result_page(result: Result | NoiseResult | TemperatureResult) -> ReportPage:
    """Return the page that a result's report shows."""
    if isinstance(result, NoiseResult):
        from .noise import noise_page

        return noise_page(result)
    if isinstance(result, TemperatureResult):
        from .temperature import temperature_page

        return temperature_page(result)
    calibration, diagnostics = result.calibration, result.diagnostics
    if isinstance(diagnostics, CameraImuDiagnostics):
        from .camera_imu.page import camera_imu_page

        return camera_imu_page(calibration, diagnostics)
    if isinstance(diagnostics, CamerasDiagnostics):
        from .cameras.page import cameras_page

        return cameras_page(calibration, diagnostics)
    from .static.page import static_page

    return static_page(calibration, diagnostics)


def plot_result(result: Result | NoiseResult | TemperatureResult, name: str) -> "MatplotlibFigure":
    """Draw a figure of a result's report with Matplotlib.

    Parameters
    ----------
    result : what was calibrated
    name : short name of the figure, or the beginning of several, such as "allan", which are drawn below each other

    Raises
    ------
    OptionError
        If the report has no such figure, or Matplotlib is not installed.
    """
    page = result_page(result)
    blocks = [*page.front, *(block for section in page.sections for block in section.blocks)]
    figures = {block.plot.name: block for block in blocks if isinstance(block, Figure)}
    chosen = [figures[name]] if name in figures else [f for key, f in figures.items() if name and key.startswith(name)]
    if not chosen:
        known = "\n".join(f"  {key}: {figure.title}" for key, figure in figures.items())
        raise OptionError(f'there is no figure "{name}" here; there are:\n{known}')
    from .drawing.matplotlib_figure import draw_with_matplotlib

    return draw_with_matplotlib([(figure.title, figure.plot, figure.legend) for figure in chosen])
