"""Runs on an existing Dask cluster: the same work and the same results, whichever of its workers come or go.

`distributed` is loaded when a scheduler is named, and is not needed otherwise.
"""

import asyncio
import logging
import queue
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from .._version import __version__
from ..errors import GnomonError, OptionError, SolveError, install_line

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")

CONNECT_S = 5.0
"""How long a scheduler may take to answer, and its first worker to be there."""

ALONE_S = 60.0
"""How long a study waits for a scheduler or for workers that have gone, before it gives up."""

_LOOK_S = 1.0  # how often the cluster is looked at while nothing comes
_PARCELS = 200
"""Twice as many tasks, or more, are handed over in about so many parcels: each takes 10 to 20 ms of CPU."""


def cluster_stream(
    work: Callable[[Task], Outcome], tasks: Sequence[Task], address: str
) -> Generator[tuple[int, Outcome]]:
    """Yield the place and the outcome of each task, once, as the workers of a scheduler do it.

    What a worker had not handed over when it was lost is done by another one.

    Raises
    ------
    OptionError
        If `distributed` is not installed, nobody answers at the address, or a worker has another gnomon.
    SolveError
        If the cluster ends before its work is done, or a run ends every worker that tries it.
    """
    with _connected(address) as client:
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        size = max(1, len(tasks) // _PARCELS)
        firsts = range(0, len(tasks), size)
        parcels = [(work, tasks[first : first + size], __version__) for first in firsts]
        waiting = dict(zip(client.map(run_tasks, parcels, pure=False), firsts, strict=True))
        for future in waiting:
            future.add_done_callback(done.put)
        while waiting:
            future = _next_done(client, done, address)
            yield from enumerate(_outcomes(future, address), waiting.pop(future))


def run_tasks(parcel: tuple[Callable[[Task], Outcome], Sequence[Task], str]) -> list[Outcome]:
    """Do some tasks on a worker, which must have the gnomon of the study.

    Raises
    ------
    OptionError
        If it has another one.
    """
    work, tasks, version = parcel
    if version != __version__:
        raise OptionError(_other_version(__version__, version))
    with threadpool_limits(1):
        return [work(task) for task in tasks]


def version_there() -> str:
    """Return the version of gnomon where this is called."""
    return __version__


def _other_version(theirs: str, ours: str) -> str:
    return (
        f"a worker of the cluster has gnomon {theirs}, this is gnomon {ours}; their results may differ. "
        "Install the same version everywhere."
    )


@contextmanager
def _connected(address: str) -> Generator[Any]:
    """Give a client of the scheduler whose workers can do the work; it is closed at the end, the cluster is not."""
    try:
        from distributed import Client
    except ImportError as error:
        raise OptionError(f"a scheduler needs the library distributed. Run: {install_line('gnomon[dask]')}") from error
    with _quiet():
        try:
            asyncio.run(_ask(address))  # first, since a client that cannot connect is hard to get rid of
            client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # whatever something else sends that listens there, as the dashboard does
            raise OptionError(
                f"no Dask scheduler answers at {address}. Give the address that it prints when it starts, such as "
                "tcp://host:8786."
            ) from error
        try:
            _check_workers(client, address)
            yield client
        finally:
            with suppress(TimeoutError):
                client.close(timeout=CONNECT_S)


async def _ask(address: str) -> None:
    """Ask a scheduler who it is; raise whatever happens where there is none."""
    from distributed.core import rpc

    async with rpc(address, timeout=CONNECT_S) as scheduler:
        answer: Any = await asyncio.wait_for(scheduler.identity(), CONNECT_S)
    if answer["type"] != "Scheduler":
        raise ValueError(answer["type"])


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise OptionError(f"the scheduler at {address} has no workers. Start some: dask worker {address}") from error
    try:
        versions = client.run(version_there)
    except Exception as error:  # whatever the worker answers that cannot load this module
        raise OptionError(
            f"the workers of {address} cannot load gnomon ({type(error).__name__}: {error}). Install gnomon "
            f"{__version__} where the scheduler and the workers run."
        ) from error
    for version in versions.values():
        if version != __version__:
            raise OptionError(_other_version(version, __version__))


def _next_done(client: Any, done: "queue.SimpleQueue[Any]", address: str) -> Any:
    """Return the next future that is done.

    Raises
    ------
    SolveError
        If scheduler or workers are gone, and stay away.
    """
    alone_since = None
    while True:
        try:
            return done.get(timeout=_LOOK_S)
        except queue.Empty:
            there_is_one = client.status == "running" and bool(client.scheduler_info()["workers"])
        now = time.monotonic()
        alone_since = None if there_is_one else alone_since or now
        if client.status == "closed" or (alone_since is not None and now - alone_since > ALONE_S):
            raise _ended(address)


def _outcomes(future: Any, address: str) -> list[Any]:
    """Return what became of a parcel; its error, if it is one of gnomon's, is that of the study."""
    from distributed import CancelledError, KilledWorker

    try:
        return future.result(timeout=ALONE_S)
    except GnomonError:
        raise
    except KilledWorker as error:
        raise SolveError(
            f"a run ended every worker of {address} that tried it, perhaps for want of memory. {error}"
        ) from error
    except (CancelledError, OSError, TimeoutError) as error:
        raise _ended(address) from error


def _ended(address: str) -> SolveError:
    return SolveError(
        f"the cluster at {address} has no workers any more, or ended, before its work was done. What is done is kept: "
        "start workers, and give the same command again."
    )


@contextmanager
def _quiet() -> Generator[None]:
    """Keep the library's own words about lost connections from standard error; what matters is said here."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.core")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
