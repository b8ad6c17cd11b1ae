"""How far a long piece of work is."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Self, TypeVar

T = TypeVar("T")
Progress = Callable[[str], None]
"""Takes a sentence on what is being done, or a `Step`."""


class Step(str):
    """A sentence on what is being done, which also tells how much of it is done; `print` takes it as a sentence.

    Parameters
    ----------
    stage : what is being done
    done : how many of its parts are
    of : how many there are; None where that is not known, or where it has no parts
    detail : of interest only to who looks closely
    """

    stage: str
    done: int
    of: int | None
    detail: bool

    def __new__(cls, stage: str, done: int = 0, of: int | None = None, *, detail: bool = False) -> Self:
        """Return the sentence, with what it tells."""
        counted = f": {done} of {of}" if of else f": {done}" if done else ""
        counted = f": {done} %" if of == 100 else counted
        step = super().__new__(cls, stage + counted)
        step.stage, step.done, step.of, step.detail = stage, done, of or None, detail
        return step

    def within(self, whole: str) -> Self:
        """Return it as a part of something larger.

        Examples
        --------
        >>> Step("reading", 3, 9).within("recording 1 of 2")
        'recording 1 of 2: reading: 3 of 9'
        """
        return type(self)(f"{whole}: {self.stage}", self.done, self.of, detail=self.detail)


def as_step(sentence: str) -> Step:
    """Return a sentence as a step; a step as it is."""
    return sentence if isinstance(sentence, Step) else Step(sentence)


_LISTENER: ContextVar[Progress | None] = ContextVar("listener", default=None)
_LONG_BYTES, _SOON_S = 1 << 25, 1.0


@contextmanager
def listening_to(listener: Progress) -> Generator[None]:
    """Let what is read in the meantime be told to a listener."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def tell_read(name: str, done_bytes: int, of_bytes: int) -> None:
    """Tell how much of a file is read to who listens, where it is a long one."""
    listener = _LISTENER.get()
    if listener is not None and of_bytes > _LONG_BYTES:
        listener(Step(f"reading {name}", int(100 * min(done_bytes / of_bytes, 1)), 100))


def tell_parts(stage: str, parts: Iterable[T], count: int) -> Iterator[T]:
    """Yield the parts of some work, so many, and where it takes long tell how many are done to who listens."""
    listener, began_s, each = _LISTENER.get(), time.monotonic(), max(1, count // 100)
    for done, part in enumerate(parts):
        if listener is not None and done % each == 0 and time.monotonic() - began_s > _SOON_S:
            listener(Step(stage, done, max(count, done)))
        yield part
