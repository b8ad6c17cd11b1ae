"""Many runs of one experiment: seeds that are fixed beforehand, on one or several processors, results in order.

What a run gives depends on its task alone, and the libraries below NumPy use one thread in it; so the results are the
same bit by bit however many processes share the work.
"""

import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import OptionError, SolveError

Progress = Callable[[str], None]
Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Who does the work.

    Attributes
    ----------
    jobs : processes of this machine that share it; 1 does it here

    Raises
    ------
    OptionError
        If there is less than one job.
    """

    jobs: int = 1

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")


HERE = Workers()
"""One process, this one."""

_TOLD = 20  # times that progress is told
_SHARES, _LONGEST = 8, 16  # parts into which the work of each process is cut, and tasks in each at most


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

    Parameters
    ----------
    work : a function of a module
    tasks : what it is given, and what it returns, can be sent to another process
    workers : who does it
    progress : is told how far the work is
    name : of one task, for progress

    Raises
    ------
    SolveError
        If a process ends before its work is done.
    """
    outcomes: list[Outcome] = []
    with _stream(work, tasks, min(workers.jobs, max(len(tasks), 1))) as stream:
        for outcome in stream:
            outcomes.append(outcome)
            done = len(outcomes)
            if progress and done * _TOLD // len(tasks) > (done - 1) * _TOLD // len(tasks):
                progress(f"{name} {done} of {len(tasks)}")
    return outcomes


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


@contextmanager
def _stream(work: Callable[[Task], Outcome], tasks: Sequence[Task], jobs: int) -> Generator[Iterator[Outcome]]:
    """Give the outcomes as they come, in order; what was not begun is dropped when the caller stops."""
    if jobs == 1:
        with threadpool_limits(1):
            yield map(work, tasks)
        return
    pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_alone)
    try:
        yield pool.map(work, tasks, chunksize=min(max(1, len(tasks) // (_SHARES * jobs)), _LONGEST))
    except BrokenProcessPool as error:
        raise SolveError(
            f"one of {jobs} processes ended before its work was done, perhaps for want of memory. Use fewer jobs."
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _alone() -> None:
    """Let a new process use one thread, and end without words when it is interrupted."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threadpool_limits(1)
