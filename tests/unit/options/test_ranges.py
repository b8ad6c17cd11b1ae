"""Every number option has a range: neither nan nor infinity nor absurd numbers get past it."""

from dataclasses import MISSING, fields, is_dataclass, replace
from math import inf, nan
from typing import Annotated, get_args, get_origin, get_type_hints

import pytest

from gnomon.cli.command import COMMANDS, parse_command
from gnomon.errors import OptionError
from gnomon.options import check_ranges, option_range
from gnomon.units import parse_rate


def plain(hint):
    return plain(get_args(hint)[0]) if get_origin(hint) is Annotated else hint


def option_classes():
    """Return every class of options that the commands are made from, the commands too."""
    found, todo = {}, list(COMMANDS.values())
    while todo:
        cls = todo.pop()
        found[cls.__name__] = cls
        hints = get_type_hints(cls, include_extras=True)
        todo += [kind for entry in fields(cls) if is_dataclass(kind := plain(hints[entry.name]))]
    return found


def numbers():
    """Return class, name and default of every option that is a number, or a tuple of them."""
    for cls in option_classes().values():
        hints = get_type_hints(cls)
        for entry in fields(cls):
            text = str(hints[entry.name]).replace("Literal", "")
            if any(word in text for word in ("int'", "float", " int", "[int")):
                default = entry.default if entry.default is not MISSING else None
                yield cls, entry.name, default


NUMBERS = list(numbers())


def test_there_are_many_and_their_defaults_are_in_range():
    assert len(NUMBERS) > 250
    for cls, name, default in NUMBERS:
        values = default if isinstance(default, tuple) else (default,)
        least, most = option_range(name)
        assert least < most
        for value in values:
            assert value is None or isinstance(value, tuple) or least <= value <= most, (cls, name)


@pytest.mark.parametrize("value", [nan, inf, -inf, 1e30, -1e30])
def test_no_class_of_options_takes_an_absurd_number(value):
    for cls, name, default in NUMBERS:
        if any(entry.default is MISSING and entry.default_factory is MISSING for entry in fields(cls)):
            continue  # a command, which asks `parse_command`
        if "tuple" in str(get_type_hints(cls)[name]):
            wrong = (value, *default[1:]) if default and not isinstance(default[0], tuple) else (value,)
        else:
            wrong = value
        with pytest.raises(OptionError, match=name):
            check_ranges(replace(cls(), **{name: wrong}))


@pytest.mark.parametrize(
    "words",
    [
        ("imu", "a.csv", "--altitude", "1e12", "--latitude", "3"),
        ("noise", "a.csv", "--rate", "0"),
        ("noise", "a.csv", "--rate", "nan"),
        ("camera-imu", "a", "--workers", "1000000"),
        ("study", "tedaldi", "--jobs", "1000000"),
        ("simulate", "-o", "a.csv", "--intervals", "1000000000"),
        ("simulate", "-o", "a.csv", "--seed", "-1"),
        ("simulate", "-o", "a.csv", "--hold-s", "nan", "4"),
        ("simulate", "platter-video", "-o", "a.mp4", "--width", "100000", "--height", "100000"),
        ("plan-imu", "--latitude", "inf"),
    ],
)
def test_the_command_line_refuses_them(words):
    with pytest.raises(OptionError, match=r"is out of range|not a finite number"):
        parse_command(words)


@pytest.mark.parametrize("text", ["1e300rpm", "1e9Hz", "nanrpm"])
def test_a_rate_with_a_unit_has_a_range_too(text):
    with pytest.raises(OptionError, match="rate"):
        parse_rate(text)
