"""What a YAML file may not be: nested without end, or small in the file and huge in memory.

The parser of YAML recurses in C, where a hundred thousand brackets end the whole program, and its time grows with the
square of the depth. Aliases let nine lines stand for a thousand million values.
"""

import re
from collections.abc import Iterator
from os import PathLike
from typing import Any

from ..errors import FormatError

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


def _levels(text: str) -> int:
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
