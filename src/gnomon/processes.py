"""Python processes that gnomon starts: none of them imports modules from the working directory.

Recordings come from anywhere, and people work in their folders. Python looks for modules in the working directory
first, with `-m`, with `-c`, and so wherever `multiprocessing` starts a process: a file pickle.py beside the images
would be run.

Work on a stream of items, a few of which are worked on at the same time.
"""

import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_WORKERS, _AHEAD = 2, 8


def results_ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield work(item) in the order of the items; some of the next ones are begun meanwhile, in threads."""
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) >= _AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


_SAFE = "PYTHONSAFEPATH"
_HOME = str(Path(__file__).resolve().parents[1])


def python_command(module: str) -> list[str]:
    """Return the command that runs a module of gnomon's in a process of its own; see `python_environment`."""
    return [sys.executable, "-P", "-m", module]


def python_environment() -> dict[str, str]:
    """Return the environment of such a process: it finds what this one finds, the working directory apart."""
    places = [place for place in sys.path if place and os.path.isabs(place)]  # noqa: PTH117 - what sys.path holds is text
    path = os.pathsep.join(places if _HOME in places else [*places, _HOME])
    return {**os.environ, "PYTHONPATH": path, _SAFE: "1", "OPENBLAS_NUM_THREADS": "1"}


@contextmanager
def safe_path() -> Generator[None]:
    """Let every Python process that is started meanwhile, by whatever library, look for modules in safe places only."""
    before = os.environ.get(_SAFE)
    os.environ[_SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE]
        else:
            os.environ[_SAFE] = before
