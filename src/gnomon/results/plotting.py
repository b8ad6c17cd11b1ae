"""Results that can be plotted."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Plotted:
    """A result whose report has figures."""

    __slots__ = ()

    def plot(self, name: str = "") -> "Figure":
        """Draw a figure of the report with Matplotlib, such as "allan" or "signals".

        Parameters
        ----------
        name : short name of the figure, or the beginning of several; an unknown one is answered with all that there are

        Returns
        -------
        Figure
            of Matplotlib, whose axes can be changed before it is shown or saved

        Raises
        ------
        OptionError
            If the report has no such figure, or Matplotlib is not installed.
        """
        # Drawing comes after results on the data's way, so it is looked up by name when somebody asks for it.
        return import_module("gnomon.report.plots").plot_result(self, name)
