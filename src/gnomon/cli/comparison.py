"""An estimate beside the truth."""

from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration import Calibration, element_names, parameters
from ..writers.units_text import parameter_unit
from .summary import common_decimals, common_power

if TYPE_CHECKING:
    from rich.table import Table


def compared(estimate: Calibration, truth: Calibration) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, estimate, sigma and truth of every scalar that was estimated."""
    true = truth.in_frame(estimate.frame)
    known = dict(parameters(true.imus))
    for path, value in parameters(estimate.imus):
        names = element_names(path, value.shape)
        truly = known.get(path, np.zeros_like(value))  # without lever arms they are zero
        columns = value.ravel(), estimate.sigma(path).ravel(), truly.ravel()
        for name, number, sigma, expected in zip(names, *columns, strict=True):
            if sigma > 0:
                yield name, float(number), float(sigma), float(expected)


def comparison_table(estimate: Calibration, truth: Calibration) -> "Table":
    """Return a table of estimates, their sigmas, the truth, and the errors in sigmas."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, title="estimate and truth", pad_edge=False)
    table.add_column("parameter", max_width=26)
    for title in ("estimate", "sigma", "truth", "error/sigma"):
        table.add_column(title, justify="right", no_wrap=True)
    for path, rows in groupby(compared(estimate, truth), key=lambda row: row[0].split("[", maxsplit=1)[0]):
        block = list(rows)
        numbers = np.array([row[1:] for row in block])
        power = common_power(numbers[:, 0], numbers[:, 1])
        decimals = common_decimals(numbers[:, 1] / 10.0**power)
        scale = f"10^{power} " if power else ""
        unit = f"[{scale}{parameter_unit(estimate, path)}]"
        table.add_row(Text(path.removeprefix("imu0."), style="bold"), *[""] * 4)
        table.add_row(Text(f"  {unit}"), *[""] * 4)
        for name, number, sigma, expected in block:
            cells = [f"{value / 10.0**power:.{decimals}f}" for value in (number, sigma, expected)]
            element = name.removeprefix(path)
            table.add_row(Text(f"  {element}"), *cells, f"{(number - expected) / sigma:+.2f}")
        table.add_section()
    return table


def comparison_sentence(estimate: Calibration, truth: Calibration) -> str:
    """Return how large the errors are for their sigmas."""
    ratios = np.array([(number - expected) / sigma for _, number, sigma, expected in compared(estimate, truth)])
    return f"{len(ratios)} parameters: rms of error/sigma {np.sqrt(np.mean(ratios**2)):.2f}, where 1 is expected.\n"


def comparison_document(estimate: Calibration, truth: Calibration) -> list[dict[str, Any]]:
    """Return the same for a program."""
    keys = ("parameter", "estimate", "sigma", "truth")
    return [dict(zip(keys, row, strict=True)) for row in compared(estimate, truth)]
