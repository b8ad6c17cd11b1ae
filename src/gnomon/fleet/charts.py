"""Control charts of a line in numbers."""

import numpy as np

from ..frozen import value_class
from .line import LineAssessment
from .statistics import ewma_chart


@value_class(eq=True)
class ChartSummary:
    """The chart of one scalar over devices, in the order of their measurement.

    Attributes
    ----------
    name, unit : of the scalar
    devices : how many have it
    mean, spread, reproducibility : of the population [unit]; see `LineAssessment`
    lower, upper : limits of a device with the usual sigma, three standard deviations
    ewma, ewma_lower, ewma_upper : the newest average, and its limits
    signals : serial numbers at which the average was beyond its limits
    """

    name: str
    unit: str
    devices: int
    mean: float
    spread: float
    reproducibility: float
    lower: float
    upper: float
    ewma: float
    ewma_lower: float
    ewma_upper: float
    signals: tuple[str, ...]

    @property
    def cells(self) -> tuple[str, ...]:
        """The same as texts."""
        numbers = (self.mean, self.spread, self.reproducibility)
        one = f"{self.lower:.5g} .. {self.upper:.5g}"
        average = f"{self.ewma_lower:.5g} .. {self.ewma_upper:.5g}"
        return (
            self.name,
            str(self.devices),
            *(f"{n:.5g}" for n in numbers),
            one,
            f"{self.ewma:.5g}",
            average,
            self.unit,
        )


def chart_summary(line: LineAssessment, name: str) -> ChartSummary:
    """Return the chart of a scalar."""
    k, table = line.table.names.index(name), line.table
    known = line.populations[k]
    rows = [row for row in line.first if np.isfinite(table.values[row, k])]
    deviations = np.hypot(known.spread, table.sigmas[rows, k])
    chart = ewma_chart(table.values[rows, k], deviations, known.mean)
    reach = 3 * float(np.median(deviations))
    return ChartSummary(
        name=name,
        unit=table.units[k],
        devices=len(rows),
        mean=known.mean,
        spread=known.spread,
        reproducibility=float(line.reproducibility[k]),
        lower=known.mean - reach,
        upper=known.mean + reach,
        ewma=float(chart.points[-1]),
        ewma_lower=float(chart.lower[-1]),
        ewma_upper=float(chart.upper[-1]),
        signals=tuple(table.entries[rows[i]].serial for i in chart.signals),
    )
