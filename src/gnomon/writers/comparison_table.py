"""All that was compared as one table that any program reads."""

import csv
from io import StringIO
from math import isfinite

from ..assess.comparison import Comparison

HEAD = ("calibration", "path", "element", "value", "sigma", "unit")


def comparison_csv(comparison: Comparison) -> str:
    """Return a row for each scalar of each calibration, in SI units, floating-point numbers with all their digits.

    Rotations are small rotations about the body's axes against their mean, whose matrix stands in rows of the
    calibration "mean"; a sigma that is not stated is left empty.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEAD)
    for block in comparison.blocks:
        if block.reference is not None:
            for i, row in enumerate(block.reference.tolist()):
                for j, value in enumerate(row):
                    writer.writerow(("mean", block.path, f"R_{'xyz'[i]}{'xyz'[j]}", repr(value), "", "1"))
        for name, values, sigmas in zip(block.names, block.values.tolist(), block.sigmas.tolist(), strict=True):
            for element, value, sigma in zip(block.elements, values, sigmas, strict=True):
                known = repr(sigma) if isfinite(sigma) else ""
                writer.writerow((name, block.path, element, repr(value), known, block.unit))
    return text.getvalue()
