"""What a use needs, from a YAML file that its owner wrote: a line for each quantity.

    name: mapping drone
    camera_rotation: 0.05 deg
    time_shift: 0.2 ms
    gyroscope_scale: 0.1 %
    fails_at: 3

`fails_at` (3 where it is not stated) tells from how many times the need on the use is not served at all.
"""

from os import PathLike
from pathlib import Path

from ...errors import OptionError
from ...requirements import QUANTITIES, Use, known_use, stated
from ..structured import Node, read_yaml


def read_use(use: str | PathLike[str]) -> Use:
    """Return a built-in use by its name, or read one from a file.

    Raises
    ------
    OptionError
        If there is neither such a use nor such a file.
    FormatError
        If the file cannot be read, or states an unknown quantity or unit; the message names it.
    """
    path = Path(use)
    if not path.exists() and path.suffix not in (".yaml", ".yml"):
        return known_use(str(use))
    root = read_yaml(path)
    keys = root.mapping(optional=("name", "fails_at", *QUANTITIES))
    needs = {name: _need(node) for name, node in keys.items() if name in QUANTITIES}
    if not needs:
        raise root.fail(f"no quantity is stated. Known: {', '.join(QUANTITIES)}.")
    fails_at = keys["fails_at"].number() if "fails_at" in keys else 3.0
    if not fails_at > 1:
        raise keys["fails_at"].fail(f"found {fails_at:g}, expected a number above 1.")
    name = keys["name"].text() if "name" in keys else path.stem
    return Use(name=name, words=name, needs=needs, fails_at=fails_at)


def _need(node: Node) -> float:
    try:
        return stated(node.key, str(node.value))
    except OptionError as error:
        raise node.fail(str(error).partition(": ")[2]) from None
