"""Kalibr's YAML layout: keys in alphabetical order, matrices as lists of rows right below their key."""

from collections.abc import Mapping
from typing import Any

from .yaml_text import yaml_lines


def kalibr_yaml(document: Mapping[str, Any], *, flush: bool = True) -> str:
    """Return a document as Kalibr writes it; without `flush` its lists are indented, as OpenCV demands it."""
    return "\n".join(yaml_lines(_sorted(document), flush=flush)) + "\n"


def _sorted(node: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _sorted(value) if isinstance(value, Mapping) else value for key, value in sorted(node.items())}
