"""What the readers of Kalibr's input files have in common: they are foreign, so that unknown keys are passed over."""

import re
from collections.abc import Iterable
from pathlib import Path

from ..structured import Node

_NOISE = "accelerometer_noise_density"


def sensors(root: Node, prefix: str, flat_key: str, expected: str) -> dict[str, Node]:
    """Return the sensors of a file keyed by name, "cam0", "cam1", ..., or the one of a file without such keys.

    Parameters
    ----------
    root : top of the file
    prefix : of the names, such as "cam"
    flat_key : key by which a file of one sensor without its name is known
    expected : what the file should be, for messages

    Raises
    ------
    FormatError
        If there is no such sensor in the file; the message says what the file seems to be instead.
    """
    entries = {node.key: node for node in root.entries()}
    named = {key: node for key, node in entries.items() if re.fullmatch(rf"{prefix}\d{{1,9}}", key)}
    if named:
        return dict(sorted(named.items(), key=lambda item: int(item[0].removeprefix(prefix))))
    if flat_key in entries:
        return {f"{prefix}0": root}
    raise root.fail(f"the key {prefix}0 is missing. Expected {expected}.{file_hint(root)}")


def file_hint(root: Node) -> str:
    """Return a sentence on what a file given in the wrong place seems to be; empty where nothing tells."""
    keys: set[str] = set()
    if isinstance(root.value, dict):
        keys = {str(key) for value in (root.value, *root.value.values()) if isinstance(value, dict) for key in value}
    kinds = (
        ("target_type", "a target, which belongs to --target"),
        ("camera_model", "a chain of cameras, which belongs to --cam"),
        (_NOISE, "the noise of an IMU, which belongs to --imu"),
    )
    return next((f" This seems to be {kind}." for key, kind in kinds if key in keys), "")


def passed_over(nodes: Iterable[Node], notes: list[str]) -> None:
    """Note keys that mean nothing to gnomon."""
    found = list(nodes)
    if found:
        names = ", ".join(node.path for node in found[:8]) + (", ..." if len(found) > 8 else "")
        notes.append(f"{file_name(found[0])}: {names} {'was' if len(found) == 1 else 'were'} passed over.")


def file_name(node: Node) -> str:
    """Return the name of the file without its folder."""
    return Path(node.file).name


def whole_number(node: Node) -> int:
    """Return a whole number, also one that is written like 6.0.

    Raises
    ------
    FormatError
        If it is another thing.
    """
    value = node.number()
    if value != int(value):
        raise node.fail(f"found {value:g}, expected a whole number.")
    return int(value)


def required(keys: dict[str, Node], name: str, parent: Node, expected: str) -> Node:
    """Return the value under a key.

    Raises
    ------
    FormatError
        If the key is missing; the message says what is expected there, and any key that was perhaps meant.
    """
    if name not in keys:
        from difflib import get_close_matches

        close = get_close_matches(name, keys, n=1, cutoff=0.7)
        meant = f" Found {close[0]}: was {name} meant?" if close else ""
        raise parent.fail(f"the key {name} is missing. Expected {expected}.{meant}")
    return keys[name]
