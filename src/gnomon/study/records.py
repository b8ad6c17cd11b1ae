"""Outcomes of runs as lines of JSON that give back the same bits, and that nothing but data can be read from.

An outcome is made of numbers, texts, truth values, None, arrays, tuples, lists, mappings, and dataclasses of such.
Which types there are is known from what the work says that it returns; a record names none.
"""

import base64
import binascii
import hashlib
import json
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Generic, TypeVar, get_origin, get_type_hints

import cattrs
import numpy as np
from numpy.typing import NDArray

Outcome = TypeVar("Outcome")

_NUMBERS = "biufc"
"""Kinds of arrays that are kept: truth values, integers, floating-point and complex numbers."""


class Records(Generic[Outcome]):
    """How the tasks of some work are named, and how its outcomes are written and read.

    Parameters
    ----------
    work : states the type that it returns
    tasks : in order
    """

    def __init__(self, work: Callable[..., Outcome], tasks: Sequence[Any]) -> None:
        self._work = f"{work.__module__}.{work.__qualname__}"
        self._type: Any = get_type_hints(work)["return"]
        self._tasks = tasks

    def key(self, index: int) -> str:
        """Return the name of a task: a hash of the work's name and of all that the task holds."""
        content = json.dumps([self._work, _converter().unstructure(self._tasks[index])], default=_plain)
        return hashlib.sha256(content.encode()).hexdigest()[:32]

    def written(self, outcome: Outcome) -> str:
        """Return an outcome as one line of JSON."""
        return json.dumps(_converter().unstructure(outcome), default=_plain, separators=(",", ":"))

    def read(self, record: str) -> tuple[Outcome] | None:
        """Return the outcome of a record, in a tuple; None where it is none of this work's."""
        try:
            return (_converter().structure(json.loads(record), self._type),)
        except Exception:  # whatever a damaged record provokes: the run is done again
            return None


def _plain(value: Any) -> Any:
    """Return what JSON does not know as what it knows."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return _array_written(value)
    raise TypeError(f"{type(value).__name__} cannot be kept in a journal.")


@cache
def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook_func(_is_array, _array_read)
    converter.register_unstructure_hook_func(_is_array, _array_written)
    return converter


def _is_array(kind: Any) -> bool:
    return kind is np.ndarray or get_origin(kind) is np.ndarray


def _array_written(values: NDArray[Any]) -> dict[str, Any]:
    if values.dtype.kind not in _NUMBERS:
        raise TypeError(f"an array of {values.dtype} cannot be kept in a journal.")
    content = base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
    return {"dtype": values.dtype.str, "shape": list(values.shape), "base64": content}


def _array_read(content: Any, _kind: Any) -> NDArray[Any]:
    dtype = np.dtype(str(content["dtype"]))
    if dtype.kind not in _NUMBERS:
        raise ValueError(f"an array of {dtype} is in no journal.")
    try:
        raw = base64.b64decode(content["base64"], validate=True)
    except binascii.Error as error:
        raise ValueError("this is no base64.") from error
    values = np.frombuffer(raw, dtype=dtype).reshape([int(n) for n in content["shape"]]).copy()
    values.flags.writeable = False
    return values
