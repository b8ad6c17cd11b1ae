"""How fast a platter turns, as people write it."""

from math import pi

import pytest

from gnomon.errors import OptionError
from gnomon.units import parse_rate


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("16rpm", 16 * pi / 30),
        ("33.33 RPM", 33.33 * pi / 30),
        ("2.0rad/s", 2.0),
        ("90deg/s", pi / 2),
        ("90 °/s", pi / 2),
        (".5Hz", pi),
        ("1e-1rad/s", 0.1),
        ("0rpm", 0.0),
    ],
)
def test_rates(text, rate):
    assert parse_rate(text) == pytest.approx(rate)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no number"),
        ("rpm", "no number"),
        ("16", "unit is missing"),
        ("16 furlongs", '"furlongs" is not a unit'),
        ("1.2.3rpm", "not a number"),
        ("-16rpm", "must not be negative"),
        ("1e999rpm", "must not be negative|not a number"),
        ("nanrpm", "no number"),
    ],
)
def test_what_is_no_rate(text, words):
    with pytest.raises(OptionError, match=words):
        parse_rate(text)
