"""A process of its own that finds boards in images: Python lets threads of one process take turns only.

It is started with `python -P -m gnomon.detect.boards.worker` and speaks over its standard input and output: in come the
target, then pieces of runs of images; for each piece the views go out. `BoardProcess` is the other end.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from ...models.target import Target
from ...processes import python_command, python_environment
from ...recording.recording import Grey
from .board import BoardView

Detector = Callable[[Grey], BoardView]

_FIELDS = ("point", "pixels", "sigma_px", "blur_px", "black", "white")


class ProcessLostError(Exception):
    """The process ended, or never began; its work is to be done here."""


class BoardProcess:
    """A process that finds a board.

    Parameters
    ----------
    target : the board
    """

    def __init__(self, target: Target) -> None:
        try:
            self._process = subprocess.Popen(
                python_command("gnomon.detect.boards.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=python_environment(),
            )
            self._send(_stated(target))
        except (OSError, ValueError) as error:
            raise ProcessLostError from error

    def views(self, images: Sequence[Grey], follows: bool) -> list[BoardView]:
        """Return what consecutive images show; `follows` says that they follow those of the call before.

        Raises
        ------
        ProcessLostError
            If the process does not answer.
        """
        assert self._process.stdout is not None
        try:
            self._send((list(images), follows))
            found: list[dict[str, Any]] = pickle.load(self._process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            raise ProcessLostError from error
        return [BoardView(**entries) for entries in found]

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def _send(self, message: Any) -> None:
        assert self._process.stdin is not None
        pickle.dump(message, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()


class BoardFinder:
    """What finds a board in runs of consecutive images.

    Parameters
    ----------
    target : the board
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        self._find = make_detector(target)

    def views(self, images: Sequence[Grey], follows: bool) -> list[BoardView]:
        """Return what consecutive images show; `follows` says that they follow those of the call before."""
        if not follows:
            self._find = make_detector(self._target)
        return [self._find(image) for image in images]


def make_detector(target: Target) -> Detector:
    """Return what finds a board in one image after the other; it may remember the one before.

    Parameters
    ----------
    target : the board
    """
    if target.kind == "aprilgrid":
        from .aprilgrid_tracker import AprilGridTracker

        return AprilGridTracker(target).detect
    if target.kind == "charuco":
        from .charuco import detect_charuco

        return lambda image: detect_charuco(image, target)
    if target.kind == "circlegrid":
        from .circlegrid import CircleGridDetector

        return CircleGridDetector(target).detect
    from .checkerboard import CheckerboardTracker

    return CheckerboardTracker(target).detect


def _stated(target: Target) -> dict[str, Any]:
    return {item.name: getattr(target, item.name) for item in fields(target) if item.init}


def answer_requests() -> None:
    """Answer until the other end closes."""
    import cv2

    cv2.setNumThreads(1)
    source, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between
    finder = BoardFinder(Target(**pickle.load(source)))
    while True:
        try:
            images, follows = pickle.load(source)
        except EOFError:
            return
        views = finder.views(images, follows)
        found = [{name: getattr(view, name) for name in _FIELDS} | {"dropped": dict(view.dropped)} for view in views]
        pickle.dump(found, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


if __name__ == "__main__":
    answer_requests()
