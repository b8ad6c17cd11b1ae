"""Tables with named columns, as those of pandas and polars are, to and from recordings."""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError, RecordingError, install_line

_MODULES = ("pandas", "polars")


def is_dataframe(thing: object) -> bool:
    """Return whether something is a table with named columns, as those of pandas and polars are."""
    return hasattr(thing, "columns") and hasattr(thing, "__getitem__") and not isinstance(thing, type)


def make_dataframe(columns: Mapping[str, Any]) -> Any:
    """Return columns as a DataFrame of pandas, or of polars where that is what is installed.

    Raises
    ------
    OptionError
        If neither is installed.
    """
    for name in _MODULES:
        try:
            return importlib.import_module(name).DataFrame(dict(columns))
        except ImportError:
            continue
    raise OptionError(f"a DataFrame needs pandas or polars. Run: {install_line('pandas')}")


def dataframe_text(frame: Any) -> bytes:
    """Return a DataFrame as the text of a table with a header; an index with a name, or of times, is a column.

    Raises
    ------
    RecordingError
        If a column holds no numbers or times.
    """
    index = getattr(frame, "index", None)
    if index is not None and (getattr(index, "name", None) or str(getattr(index, "dtype", "")).startswith("datetime")):
        frame = frame.reset_index()
    named = [_column(str(name), np.asarray(frame[name])) for name in frame.columns]
    lines = [",".join(name for name, _ in named)]
    lines += [",".join(map(repr, row)) for row in zip(*(values.tolist() for _, values in named), strict=True)]
    return ("\n".join(lines) + "\n").encode()


def _column(name: str, values: NDArray[Any]) -> tuple[str, NDArray[Any]]:
    """Return the name in the header, and numbers; times are nanoseconds."""
    if np.issubdtype(values.dtype, np.datetime64):
        return "timestamp [ns]", values.astype("datetime64[ns]").astype(np.int64)
    if values.dtype.kind not in "fiu":
        raise RecordingError(f"column {name} of the DataFrame holds {values.dtype}, not numbers. Leave it out.")
    return name.replace(",", " "), values
