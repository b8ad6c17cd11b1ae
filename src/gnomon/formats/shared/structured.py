"""What a YAML file may not be: nested without end, or small in the file and huge in memory.

The parser of YAML recurses in C, where a hundred thousand brackets end the whole program, and its time grows with the
square of the depth. Aliases let nine lines stand for a thousand million values.
"""

import json
import re
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError
from ...frozen import value_class
from ...output import refuse_special
from ...recording import Floats

LARGEST_BYTES, LARGEST_YAML_BYTES = 32 << 20, 8 << 20
"""Of a structured file, and of YAML, which takes a second or two for each of its megabytes. A calibration of a hundred
parameters has some hundred kilobytes."""
DEEPEST = 50
"""Levels of a structured file; those of calibrations have six."""
MOST_VALUES, MOST_TIMES = 10_000, 10
"""Aliases may make a file stand for so many values, or for so many times the values that are written in it."""
_LONGEST_NUMBER = 1000  # digits; Python refuses more than 4300, slowly
_DEEP_LINE = re.compile(r"(?m)^[ \t?:-]{50}")  # each level of a block needs a column


def refuse_large(size: int, path: str | PathLike[str], largest: int = LARGEST_BYTES) -> None:
    """Refuse a structured file of more than `largest` bytes.

    Raises
    ------
    FormatError
        If it is larger than any calibration.
    """
    if size > largest:
        raise FormatError(
            f"{path}: the file has {size >> 20} MiB, and no calibration is larger than {largest >> 20} MiB. Is "
            "this the file that you meant?"
        )


def refuse_deep(text: str, path: str | PathLike[str], *, block: bool = True) -> None:
    """Refuse a text that is nested too deeply, before a parser sees it.

    Parameters
    ----------
    block : whether lines may be nested by their indents, as in YAML; not in JSON

    Raises
    ------
    FormatError
        If it is.
    """
    if _brackets(text) <= DEEPEST and not (block and _DEEP_LINE.search(text)):
        return
    if not block or _levels(text) > DEEPEST:
        raise FormatError(f"{path}: values are nested more than {DEEPEST} deep, which no file of this kind is.")


def _brackets(text: str) -> int:
    """Return the most brackets that are open at once, those in texts counted too."""
    depth = most = 0
    for match in re.finditer(r"[\[\]{}]", text):
        depth = depth + 1 if match[0] in "[{" else max(depth - 1, 0)
        if depth > most:
            most = depth
            if most > DEEPEST:
                break
    return most


def _levels(text: str, *, again: bool = True) -> int:
    """Return the depth as the parser sees it, up to where it is too deep."""
    import yaml

    depth = most = 0
    try:
        for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                most = max(most, depth)
                if most > DEEPEST:
                    break
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
    except yaml.MarkedYAMLError as error:
        # The scanner reads ahead, and since PyYAML 6.0.4 refuses a depth before any level of it is told.
        if again and (mark := error.problem_mark) is not None:
            return max(most, _levels(text[: mark.index], again=False))
    except yaml.YAMLError:  # the parser proper says so
        pass
    return most


def refuse_bombs(root: Any, path: str | PathLike[str]) -> None:
    """Refuse the nodes of a YAML file whose aliases stand for too much, or for what they stand in; and huge numbers.

    Raises
    ------
    FormatError
        If they do.
    """
    sizes: dict[int, int] = {}  # of every node that is done, all that it stands for
    within: set[int] = set()
    todo: list[tuple[Any, bool]] = [(root, False)] if root is not None else []
    while todo:
        node, done = todo.pop()
        key = id(node)
        if done:
            within.discard(key)
            sizes[key] = 1 + sum(sizes[id(child)] for child in _children(node))
            continue
        if key in sizes:
            continue
        if key in within:
            raise FormatError(f"{path}, line {node.start_mark.line + 1}: this value holds itself by an alias (*).")
        within.add(key)
        todo.append((node, True))
        for child in _children(node):
            if id(child) in within:
                line = child.start_mark.line + 1
                raise FormatError(f"{path}, line {line}: this value holds itself by an alias (*).")
            todo.append((child, False))
        if node.id == "scalar" and len(node.value) > _LONGEST_NUMBER and node.tag == "tag:yaml.org,2002:int":
            line = node.start_mark.line + 1
            raise FormatError(f"{path}, line {line}: this is a number of {len(node.value)} digits.")
    total = sizes[id(root)] if root is not None else 0
    if total > max(MOST_VALUES, MOST_TIMES * len(sizes)):
        raise FormatError(
            f"{path}: its aliases (*) make {len(sizes)} values stand for {total:.3g}. Write out what is meant."
        )


def _children(node: Any) -> Iterator[Any]:
    if node.id == "sequence":
        yield from node.value
    elif node.id == "mapping":
        for key, value in node.value:
            yield key
            yield value


_LARGEST = 1e60
"""The largest number that is read; squares and products of such ones are still finite."""
_LONGEST = 240
"""Characters of a value or a path that a message repeats."""


@value_class
class Node:
    """A value of a structured file.

    Attributes
    ----------
    file : name of the file, for messages
    path : keys from the top, such as "imus.imu0.gyroscope.bias"; "" at the top
    value : what the parser found
    key : the last key of the path
    """

    file: str
    path: str
    value: Any
    key: str = ""

    def fail(self, problem: str) -> FormatError:
        """Return an error that says where this value is."""
        place = f"{self.file}: {shorten_text(self.path)}" if self.path else self.file
        return FormatError(f"{place}: {shorten_text(problem, 4 * _LONGEST)}")

    def child(self, key: str) -> "Node":
        """Return the value under a key that is known to be there."""
        return Node(file=self.file, path=f"{self.path}.{key}" if self.path else key, value=self.value[key], key=key)

    def mapping(self, required: Sequence[str] = (), optional: Sequence[str] = ()) -> dict[str, "Node"]:
        """Return the values under the keys, all of which must be known.

        Raises
        ------
        FormatError
            If this is no mapping, a required key is missing, or a key is neither required nor optional.
        """
        found = {node.key: node for node in self.entries()}
        known = [*required, *optional]
        for key, node in found.items():
            if key not in known:
                raise node.fail(f"unknown key. {_nearest(key, known)}")
        missing = [key for key in required if key not in found]
        if missing:
            raise self.fail(f"the key {missing[0]} is missing. Expected: {', '.join(required)}.")
        return found

    def entries(self) -> Iterator["Node"]:
        """Yield the values of a mapping with arbitrary keys.

        Raises
        ------
        FormatError
            If this is no mapping, or a key is no text.
        """
        if not isinstance(self.value, dict):
            raise self.fail(f"found {_kind(self.value)}, expected keys and values.")
        for key in self.value:
            if not isinstance(key, str):
                raise self.fail(f"the key {_shown(key)} is {_kind(key)}, expected text; put it between quotes.")
            yield self.child(key)

    def items(self) -> Iterator["Node"]:
        """Yield the values of a list.

        Raises
        ------
        FormatError
            If this is no list.
        """
        if not isinstance(self.value, list):
            raise self.fail(f"found {_kind(self.value)}, expected a list.")
        for i, value in enumerate(self.value):
            yield Node(file=self.file, path=f"{self.path}[{i}]", value=value)

    def text(self, choices: Sequence[str] = ()) -> str:
        """Return a text, one of `choices` if there are any.

        Raises
        ------
        FormatError
            If it is another thing.
        """
        if not isinstance(self.value, str):
            raise self.fail(f"found {_kind(self.value)}, expected text.")
        if choices and self.value not in choices:
            raise self.fail(f'found "{shorten_text(self.value)}". {_nearest(self.value, choices)}')
        return self.value

    def integer(self) -> int:
        """Return a whole number.

        Raises
        ------
        FormatError
            If it is another thing.
        """
        if not isinstance(self.value, int) or isinstance(self.value, bool):
            raise self.fail(f"found {_kind(self.value)}, expected a whole number.")
        return self.value

    def number(self, *, finite: bool = True) -> float:
        """Return a number.

        Raises
        ------
        FormatError
            If it is another thing, or not finite where it must be.
        """
        value = self.value
        if isinstance(value, str):  # YAML 1.1 takes 1e-5 for text, YAML 1.2 and people for a number
            try:
                value = float(value)
            except ValueError:
                raise self.fail(f'found the text "{shorten_text(value)}", expected a number.') from None
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self.fail(f"found {_kind(value)}, expected a number.")
        try:
            number = float(value)
        except OverflowError:  # a whole number of more than 308 digits
            number = float("inf")
        if finite and not np.isfinite(number):
            raise self.fail(f"found {number}, expected a finite number.")
        if _LARGEST < abs(number) < np.inf:
            raise self.fail(f"found {number:g}; no quantity of a calibration is so large.")
        return number

    def floats(self, length: int, *others: int, finite: bool = True) -> Floats:
        """Return an array of numbers of shape (length, *others).

        Raises
        ------
        FormatError
            If there is anything else than numbers, or another count of them.
        """
        rows = list(self.items())
        if len(rows) != length:
            raise self.fail(f"found {len(rows)} {'rows' if others else 'numbers'}, expected {length}.")
        if others:
            return np.array([row.floats(*others, finite=finite) for row in rows])
        return np.array([row.number(finite=finite) for row in rows])


def read_yaml(path: str | PathLike[str]) -> Node:
    """Parse a YAML file; a first line %YAML:1.0, as OpenCV writes it, is tolerated.

    Raises
    ------
    FormatError
        If the file cannot be read, is no YAML, or holds a key twice.
    """
    text = read_structured_text(path)
    return Node(file=str(path), path="", value=parse_yaml("#" + text if text.startswith("%YAML:") else text, path))


def parse_yaml(text: str, path: str | PathLike[str], *, any_tag: bool = False) -> Any:
    """Return what a YAML text holds.

    Parameters
    ----------
    path : of the file, for messages
    any_tag : whether values with tags of other programs, such as !!opencv-matrix, are read as if they had none

    Raises
    ------
    FormatError
        If it is no YAML, holds a key twice, is nested too deeply, or its aliases stand for too much.
    """
    import yaml

    refuse_large(len(text), path, LARGEST_YAML_BYTES)
    refuse_deep(text, path)
    safe = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        loader = (_without_tags(safe) if any_tag else safe)(text)
    except (yaml.YAMLError, ValueError) as error:  # a character that YAML does not know
        raise FormatError(f"{path}: this is not YAML ({shorten_text(str(error))}).") from error
    try:
        root = loader.get_single_node()
        refuse_bombs(root, path)
        _refuse_duplicates(path, root)
        return None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise FormatError(f"{path}{line}: this is not YAML ({shorten_text(str(error.problem))}).") from error
    except FormatError:
        raise
    except Exception as error:  # what a tag promises and its value does not keep ends in errors of many kinds
        raise FormatError(f"{path}: this is not YAML ({shorten_text(str(error))}).") from error
    finally:
        loader.dispose()


def _without_tags(safe: Any) -> Any:
    """Return a loader that reads a value with an unknown tag as if the tag were not there."""

    class Loader(safe):
        pass

    def plain(loader: Any, node: Any) -> Any:
        if node.id == "scalar":
            tag = loader.resolve(type(node), node.value, (True, False))
            return loader.construct_object(type(node)(tag, node.value, node.start_mark, node.end_mark))
        construct = loader.construct_mapping if node.id == "mapping" else loader.construct_sequence
        return construct(node, deep=True)

    Loader.add_constructor(None, plain)
    return Loader


def read_json(path: str | PathLike[str]) -> Node:
    """Parse a JSON file.

    Raises
    ------
    FormatError
        If the file cannot be read, or is no JSON.
    """
    text = read_structured_text(path)
    refuse_large(len(text), path)
    refuse_deep(text, path, block=False)
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(f"{path}, line {error.lineno}: this is not JSON ({error.msg}).") from error
    except ValueError as error:  # a number of thousands of digits
        raise FormatError(f"{path}: this is not JSON that can be read ({shorten_text(str(error))}).") from error
    return Node(file=str(path), path="", value=value)


def read_structured_text(path: str | PathLike[str]) -> str:
    """Return the text of a file.

    Raises
    ------
    FormatError
        If the file cannot be read, or is no text.
    RecordingError
        If it is a pipe or a device.
    """
    try:
        refuse_special(Path(path))
        refuse_large(Path(path).stat().st_size, path)
        return Path(path).read_bytes().decode("utf-8-sig")
    except FileNotFoundError as error:
        raise FormatError(f"{path}: there is no such file. Check the path.") from error
    except IsADirectoryError as error:
        inside = Path(path) / "calibration.yaml"
        what = f"not a file. Name {inside}" if inside.is_file() else "without a calibration.yaml. Name a file"
        raise FormatError(f"{path}: this is a folder, {what}.") from error
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error}). Name a file that can be.") from error
    except UnicodeDecodeError as error:
        raise FormatError(
            f"{path}: this is no text file (byte {error.start} is not UTF-8), as those of calibrations, cameras and "
            "boards are. Is it the recording, given in the place of the calibration?"
        ) from error


def _refuse_duplicates(path: str | PathLike[str], root: Any) -> None:
    """Raise if a key stands twice in one mapping: the parser would silently keep the last one."""
    todo = [root] if root is not None else []
    done: set[int] = set()  # an alias may lead back to where it stands
    while todo:
        node = todo.pop()
        if id(node) in done:
            continue
        done.add(id(node))
        if node.id == "sequence":
            todo.extend(child for child in node.value if child.id != "scalar")
        elif node.id == "mapping":
            seen: set[str] = set()
            for key, value in node.value:
                name = str(key.value)
                if name in seen:
                    line = key.start_mark.line + 1
                    raise FormatError(f"{path}, line {line}: the key {name} stands here twice. Keep one of them.")
                seen.add(name)
                todo.append(value)


def shorten_text(text: str, most: int = _LONGEST) -> str:
    """Return a text for a message: its beginning, where it is too long to be read."""
    return text if len(text) <= most else f"{text[:most]}... ({len(text)} characters)"


def _shown(value: object) -> str:
    """Return a value for a message."""
    if isinstance(value, int) and value.bit_length() > 1000:
        return f"a whole number of {value.bit_length()} bits"
    return shorten_text(repr(value))


def _nearest(word: str, known: Sequence[str]) -> str:
    from difflib import get_close_matches

    close = get_close_matches(word[:_LONGEST], known, n=1, cutoff=0.6)
    if close:
        return f"Did you mean {close[0]}?"
    return f"Expected: {', '.join(known)}." if known else "Nothing is expected here."


def _kind(value: object) -> str:
    names = (
        (dict, "keys and values"),
        (list, "a list"),
        (str, "text"),
        (bool, "true or false"),
        (type(None), "nothing"),
    )
    return next((name for kind, name in names if isinstance(value, kind)), _shown(value))
