"""Many runs of one experiment: seeds that are fixed beforehand, on one or several processors, results in order.

What a run gives depends on its task alone, and the libraries below NumPy use one thread in it; so the results are the
same bit by bit whoever does the work, and whichever part of it was done before.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import OptionError, SolveError
from ..processes import safe_path
from .records import Records

Progress = Callable[[str], None]
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


class RunCount(Protocol):
    """Is told after each run how many there are."""

    def __call__(self, name: str, done: int, total: int) -> None:
        """Take notice that so many tasks of that name are done."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Who does the work, and who takes notice of it.

    Attributes
    ----------
    jobs : processes of this machine that share it; 1 does it here
    scheduler : address of a Dask scheduler, such as tcp://host:8786, whose workers do it instead; "" for none
    journal : holds what was done before, and is given what is done; None for none
    count : is told after each run how many there are; None for nobody

    Raises
    ------
    OptionError
        If there is less than one job, or there are jobs beside a scheduler.
    """

    jobs: int = 1
    scheduler: str = ""
    journal: Journal | None = None
    count: RunCount | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")
        if self.jobs > 1 and self.scheduler:
            raise OptionError("a scheduler's workers do all the work. Leave out jobs or the scheduler.")


HERE = Workers()
"""One process, this one."""

_MOST_PROCESSES = 61  # of one pool on Windows
_TOLD = 20  # times that progress is told where nobody counts


def seeds(seed: int, count: int) -> list[int]:
    """Return independent seeds of runs; those of fewer runs are the first of more.

    Examples
    --------
    >>> seeds(7, 2) == seeds(7, 5)[:2]
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
    dataclasses of such (`records`). A record is found again by the name of `work` and the whole content of the task.

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
    kept = None if workers.journal is None else _Kept(work, tasks, workers.journal)
    outcomes = {} if kept is None else dict(kept.found())
    if outcomes and progress:
        progress(f"{name}: {len(outcomes)} of {total} were done before and are taken over")
    if outcomes and workers.count:
        workers.count(name, len(outcomes), total)
    left = [index for index in range(total) if index not in outcomes]
    with closing(_stream(work, [tasks[index] for index in left], workers)) as stream:
        for place, outcome in stream:
            index = left[place]
            outcomes[index] = outcome
            if kept is not None:
                kept.keep(index, outcome)
            done = len(outcomes)
            if workers.count:
                workers.count(name, done, total)
            elif progress and done * _TOLD // total > (done - 1) * _TOLD // total:
                progress(f"{name} {done} of {total}")
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


class _Kept(Generic[Outcome]):
    """What the journal holds of these tasks."""

    def __init__(self, work: Callable[..., Outcome], tasks: Sequence[Any], journal: Journal) -> None:
        self._records, self._journal, self._total = Records(work, tasks), journal, len(tasks)

    def found(self) -> Iterator[tuple[int, Outcome]]:
        """Yield the index and the outcome of every task that was done before."""
        for index in range(self._total):
            record = self._journal.find(self._records.key(index))
            read = self._records.read(record) if record is not None else None
            if read is not None:
                yield index, read[0]

    def keep(self, index: int, outcome: Outcome) -> None:
        """Keep the outcome of a task."""
        self._journal.keep(self._records.key(index), self._records.written(outcome))


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
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threadpool_limits(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
