"""Many runs of one experiment: seeds fixed beforehand, on one or several processors, results in order; tables of them.

What a run gives depends on its task alone, and the libraries below NumPy use one thread in it; so the results are the
same bit by bit whoever does the work, and whichever part of it was done before.
"""

import base64
import binascii
import csv
import gc
import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import cache, cached_property
from io import StringIO
from typing import Any, Generic, Protocol, TypeVar, get_origin, get_type_hints

import cattrs
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..errors import OptionError, SolveError
from ..frozen import value_class
from ..processes import safe_path
from ..progress import Progress, Step
from ..recording import Floats

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


class Journal(Protocol):
    """Outcomes of runs, kept so that a study that was interrupted need not begin anew."""

    def find(self, key: str) -> str | None:
        """Return the record that was kept under a key; None where there is none."""
        ...

    def keep(self, key: str, record: str) -> None:
        """Keep a record, one line of text, under a key."""
        ...


@value_class(eq=True)
class Workers:
    """Who does the work, and where its outcomes are kept.

    Attributes
    ----------
    jobs : processes of this machine that share it; 1 does it here
    scheduler : address of a Dask scheduler, such as tcp://host:8786, whose workers do it instead; "" for none
    journal : holds what was done before, and is given what is done; None for none

    Raises
    ------
    OptionError
        If there is less than one job, or there are jobs beside a scheduler.
    """

    jobs: int = 1
    scheduler: str = ""
    journal: Journal | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")
        if self.jobs > 1 and self.scheduler:
            raise OptionError("a scheduler's workers do all the work. Leave out jobs or the scheduler.")


HERE = Workers()
"""One process, this one."""

_MOST_PROCESSES = 61  # of one pool on Windows
_NUMBERS = "biufc"  # kinds of arrays that are kept: truth values, integers, floating-point and complex numbers


def run_seeds(seed: int, count: int) -> list[int]:
    """Return independent seeds of runs; those of fewer runs are the first of more.

    Examples
    --------
    >>> run_seeds(7, 2) == run_seeds(7, 5)[:2]
    True
    """
    return [int(state) for state in np.random.SeedSequence(seed).generate_state(count, np.uint64)]


def carry_out(
    work: Callable[[Task], Outcome],
    tasks: Sequence[Task],
    *,
    workers: Workers = HERE,
    progress: Progress | None = None,
    name: str = "run",
) -> list[Outcome]:
    """Return what `work` makes of each task, in the order of the tasks.

    With a journal, `work` states the type that it returns, and task and outcome are numbers, texts, arrays, tuples and
    dataclasses of such (`Records`). A record is found again by the name of `work` and the whole content of the task.

    Parameters
    ----------
    work : a function of a module, whose result depends on its task alone
    tasks : what it is given, and what it returns, can be sent to another process
    workers : who does it
    progress : is told how far the work is
    name : of one task, for progress

    Raises
    ------
    OptionError
        If the scheduler cannot be reached, or its workers have another gnomon.
    SolveError
        If a process or a cluster ends before its work is done.
    """
    total = len(tasks)
    records, journal = Records(work, tasks), workers.journal
    outcomes = {} if journal is None else dict(records.found(journal))
    if outcomes and progress:
        progress(f"{name}: {len(outcomes)} of {total} were done before and are taken over")
    left = [index for index in range(total) if index not in outcomes]
    if left and progress:
        progress(Step(name, len(outcomes), total))
    with closing(_stream(work, [tasks[index] for index in left], workers)) as stream:
        for place, outcome in stream:
            index = left[place]
            outcomes[index] = outcome
            if journal is not None:
                journal.keep(records.key(index), records.written(outcome))
            if progress:
                progress(Step(name, len(outcomes), total))
    return [outcomes[index] for index in range(total)]


def scatter_bounds(runs: int, wanted: float) -> tuple[float, float]:
    """Return the bounds of sigma over scatter that is 1 to within `wanted`, as far as so many runs can tell.

    A true sigma is outside in two of 10 000 cases.

    Examples
    --------
    >>> [round(bound, 2) for bound in scatter_bounds(500, 0.15)]
    [0.85, 1.15]
    >>> [round(bound, 2) for bound in scatter_bounds(20, 0.15)]
    [0.62, 2.13]
    """
    from scipy.special import gammaincinv

    least, most = (float(np.sqrt(0.5 * runs / gammaincinv(0.5 * runs, p))) for p in (0.9999, 0.0001))
    return min(1 - wanted, least), max(1 + wanted, most)


def _stream(work: Callable[[Task], Outcome], tasks: Sequence[Task], workers: Workers) -> Generator[tuple[int, Outcome]]:
    """Yield the place and the outcome of each task as it is done; what was not begun is dropped on close."""
    if workers.scheduler and tasks:
        from .cluster import cluster_stream

        return cluster_stream(work, tasks, workers.scheduler)
    jobs = min(workers.jobs, len(tasks), _MOST_PROCESSES)
    return _here(work, tasks) if jobs <= 1 else _pooled(work, tasks, jobs)


def _here(work: Callable[[Task], Outcome], tasks: Sequence[Task]) -> Generator[tuple[int, Outcome]]:
    with threadpool_limits(1):
        yield from enumerate(map(work, tasks))


def _pooled(work: Callable[[Task], Outcome], tasks: Sequence[Task], jobs: int) -> Generator[tuple[int, Outcome]]:
    with safe_path():  # multiprocessing starts one of its own for its locks
        pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_alone)
    try:
        with safe_path():  # submitting starts the processes
            places = {pool.submit(work, task): place for place, task in enumerate(tasks)}
        for future in as_completed(places):
            yield places[future], future.result()
    except BrokenProcessPool as error:
        raise SolveError(
            f"one of {jobs} processes ended before its work was done, perhaps for want of memory. Use fewer jobs."
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _alone() -> None:
    """Let a new process use one thread, end without words when it is interrupted, and not outlive its parent."""
    gc.set_threshold(50_000)  # as of the program (`__main__`)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threadpool_limits(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class Records(Generic[Outcome]):
    """How the tasks of some work are named in a journal, and how its outcomes are written and read.

    Lines of JSON give back the same bits, and nothing but data can be read from them. An outcome is made of numbers,
    texts, truth values, None, arrays, tuples, lists, mappings, and dataclasses of such. Which types there are is known
    from what the work says that it returns; a record names none.

    Parameters
    ----------
    work : states the type that it returns
    tasks : in order
    """

    def __init__(self, work: Callable[..., Outcome], tasks: Sequence[Any]) -> None:
        self._function = work
        self._work = f"{work.__module__}.{work.__qualname__}"
        self._tasks = tasks

    @cached_property
    def _returned(self) -> Any:
        return get_type_hints(self._function)["return"]

    def found(self, journal: Journal) -> Iterator[tuple[int, Outcome]]:
        """Yield the index and the outcome of every task of which a journal has one."""
        for index in range(len(self._tasks)):
            record = journal.find(self.key(index))
            read = self.read(record) if record is not None else None
            if read is not None:
                yield index, read[0]

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
            return (_converter().structure(json.loads(record), self._returned),)
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


Cell = str | int | float | bool


@value_class(eq=True)
class StudyTable:
    """One table; its name is that of its file, its head says the units."""

    name: str
    head: tuple[str, ...]
    rows: Sequence[tuple[Cell, ...]]

    def csv(self) -> str:
        """Return the table as CSV, floating-point numbers with all their digits."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.head)
        writer.writerows([repr(float(cell)) if isinstance(cell, float) else cell for cell in row] for row in self.rows)
        return text.getvalue()


@value_class(eq=True)
class Claim:
    """Something that a document says or that gnomon promises, and what the study found.

    Attributes
    ----------
    claim : in words
    expected : what it would be if it held
    found : what it was
    holds : whether it does; None where there are too few runs to tell
    """

    claim: str
    expected: str
    found: str
    holds: bool | None


_TELLING = 2.0
"""Bounds tell something while a number that is wrong by this factor would lie outside."""


def ratio_agrees(inside: bool, least: float, most: float) -> bool | None:
    """Return whether a ratio whose right value is 1 agrees with its bounds, as `Claim.holds`.

    Few runs need wide bounds because of chance. What lies inside of bounds that half or twice of the right value
    would satisfy as well says nothing; what lies outside is wrong however wide they are.

    Examples
    --------
    >>> ratio_agrees(True, 0.85, 1.15), ratio_agrees(True, 0.38, 24.0), ratio_agrees(False, 0.38, 24.0)
    (True, None, False)
    """
    return None if inside and (least <= 1 / _TELLING or most >= _TELLING) else inside


def sigmas_claim(claim: str, ratios: Floats, runs: int, where: str = "") -> Claim:
    """Return the claim that stated sigmas are those of the scatter of so many runs, to 15 % as far as they tell.

    Parameters
    ----------
    ratios : stated sigma over scatter, of every parameter
    where : of which parameters, in words
    """
    least, most = scatter_bounds(runs, 0.15)
    return Claim(
        claim=claim,
        expected=f"sigma over scatter {least:.2f} to {most:.2f}{where}",
        found=f"{ratios.min():.3f} to {ratios.max():.3f}",
        holds=ratio_agrees(bool(ratios.min() > least and ratios.max() < most), least, most),
    )


def claims_table(claims: Iterable[Claim]) -> StudyTable:
    """Return the claims of a study as a table."""
    return StudyTable(
        name="claims",
        head=("claim", "expected", "found", "holds"),
        rows=[(one.claim, one.expected, one.found, "" if one.holds is None else one.holds) for one in claims],
    )
