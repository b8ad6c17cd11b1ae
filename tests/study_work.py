"""Work for studies of tests, in a module that other processes can load."""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gnomon.errors import RecordingError
from gnomon.recording import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    seed: int
    share: float = 0.1
    done: str = ""
    """File to which each run adds a line."""
    wait_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    name: str
    largest: float | None
    flags: tuple[bool, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    seed: int
    matrix: Floats
    counts: np.ndarray
    parts: tuple[Part, ...]
    infinite: float = float("inf")


def drawn(task: Task) -> Outcome:
    """Return numbers that depend on the task alone."""
    if task.done:
        with Path(task.done).open("a") as file:
            file.write(f"{task.seed}\n")
    time.sleep(task.wait_s)
    rng = np.random.default_rng(task.seed)
    a = rng.standard_normal((60, 60))
    return Outcome(
        seed=task.seed,
        matrix=np.linalg.svd(task.share * a @ a)[1].reshape(6, 10),
        counts=rng.integers(0, 9, 4),
        parts=(
            Part(name="ä, \n", largest=float(a.max()), flags=(True, False)),
            Part(name="", largest=None, flags=()),
        ),
    )


def product(seed: int) -> float:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((200, 200))
    return float(np.linalg.svd(a @ a)[1].sum())


def slow_product(seed: int) -> float:
    time.sleep(0.05)
    return product(seed)


def process(_: int) -> int:
    return os.getpid()


def refused(number: int) -> int:
    if number == 3:
        raise RecordingError("run 3 cannot be read.")
    return number


def lost(_: int) -> int:
    os._exit(1)
