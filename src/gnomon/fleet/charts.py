"""Control charts of a line in numbers."""

from collections.abc import Sequence

import numpy as np

from ..frozen import value_class
from .entries import LineTable
from .line import LineAssessment
from .statistics import ControlChart, Population, ewma_chart, individuals_chart


@value_class(eq=True)
class ChartSummary:
    """The chart of one scalar over devices, in the order of their measurement.

    Attributes
    ----------
    name, unit : of the scalar
    devices : how many have it
    mean, spread, reproducibility : of the population [unit]; see `LineAssessment`
    lower, upper : limits of the chart of individuals
    ewma, ewma_lower, ewma_upper : the newest average, and its limits
    outside : serial numbers beyond the limits of individuals
    signals : those at which the average was beyond its limits
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
    outside: tuple[str, ...]
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
            *("-" if n != n else f"{n:.5g}" for n in numbers),  # noqa: PLR0124 - repeated by too few, it is nan
            one,
            f"{self.ewma:.5g}",
            average,
            self.unit,
        )


def control_charts(
    table: LineTable, first: Sequence[int], k: int, known: Population
) -> tuple[ControlChart, ControlChart]:
    """Return the charts of individuals and of their weighted average, of the devices that have the scalar k.

    `first` are the rows of the first result of each device. Outliers of the population do not widen the limits.
    """
    has = np.isfinite(table.values[list(first), k])
    rows = np.array(first, dtype=int)[has]
    values = table.values[rows, k]
    individuals = individuals_chart(values, known.mean, usual=known.kept[has])
    return individuals, ewma_chart(values, np.hypot(known.spread, table.sigmas[rows, k]), known.mean)


def chart_summary(line: LineAssessment, name: str) -> ChartSummary:
    """Return the chart of a scalar."""
    k, table = line.table.names.index(name), line.table
    known = line.populations[k]
    rows = np.array(line.first, dtype=int)
    serials = [table.entries[row].serial for row in rows[np.isfinite(table.values[rows, k])].tolist()]
    individuals, average = control_charts(table, line.first, k, known)
    return ChartSummary(
        name=name,
        unit=table.units[k],
        devices=len(serials),
        mean=known.mean,
        spread=known.spread,
        reproducibility=float(line.reproducibility[k]),
        lower=float(individuals.lower[-1]),
        upper=float(individuals.upper[-1]),
        ewma=float(average.points[-1]),
        ewma_lower=float(average.lower[-1]),
        ewma_upper=float(average.upper[-1]),
        outside=tuple(serials[i] for i in individuals.signals),
        signals=tuple(serials[i] for i in average.signals),
    )
