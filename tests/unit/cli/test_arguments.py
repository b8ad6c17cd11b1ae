"""Ordinary command lines are read without tyro, and as tyro reads them."""

import pytest

from docs_pages import PAGES, shell_commands
from gnomon.cli.commands import COMMANDS
from gnomon.cli.parsing.arguments import read_line
from gnomon.cli.parsing.tyro_line import parse_line

LINES = [
    words
    for page in PAGES
    for words in shell_commands(page)
    if words[0] in COMMANDS and not {"--help", "--scenario"} & {*words}
]
MORE = [
    "imu a.csv --fix imu0.gyroscope.g_sensitivity imu0.accelerometer --no-report --preset imu_tk",
    "imu --gravity=9.81 a.csv b.csv",
    "camera-imu rig --imu a.yaml --imu b.yaml --cams c.yaml --no-cache",
    "convert c.yaml --to px4 --noise n.yaml",
    "simulate-cameras -o x --resolution 640 480 --intrinsics 460 458.5 322.4 237.1",
    "show c.yaml --for vio --json",
]
UNUSUAL = [
    "show",
    "show a b",
    "show a --json --json",
    "show a --no-json",
    "show a --jso",
    "show a --form tedaldy",
    "show a --for None",
    "show a --for --json",
    "imu a -o x b",
    "imu a --gravity nine",
    "imu a --gravity 3",
    "imu a --report",
    "simulate-cameras -o x --resolution 640",
    "apply c.yaml a b c -o x",
]


@pytest.mark.parametrize(
    "line", [*{" ".join(words): words for words in LINES}.values(), *map(str.split, MORE)], ids=str
)
def test_a_line_is_read_as_tyro_reads_it(line):
    name, *words = line
    mine = read_line(COMMANDS[name], words)
    assert mine is not None
    assert mine == parse_line(COMMANDS[name], words, prog=name)


@pytest.mark.parametrize("line", UNUSUAL)
def test_an_unusual_line_is_left_to_tyro(line):
    name, *words = line.split()
    assert read_line(COMMANDS[name], words) is None
