"""Words become commands; mistakes are named, and help shows what there is."""

import inspect
import re
import shlex

import pytest

from docs_pages import PAGES, shell_commands
from gnomon.cli.command import COMMANDS, parse_command
from gnomon.errors import OptionError

LINES = [
    words
    for page in PAGES
    for words in shell_commands(page)
    if words[0] in [name.split()[0] for name in COMMANDS] and not {"--help", "--scenario"} & {*words}
]
MISTAKES = {
    "show": "CALIBRATION",
    "show a b": "one too many: b",
    "show a --jso": "Did you mean --json",
    "show a --form kalib": "did you mean kalibr",
    "show a --for --json": "expected 1 argument",
    "simulate cameras -o x --resolution 640 --json": "expected 2 arguments",
    "camera-imu rig --cam --json": "--cams/--cam: expected 1 argument",
    "imu a --gravity nine": "--gravity nine: expected a number",
    "imu a --gravity 3": "from 9 to 10.5",
    "imu a --report": "no option --report",
    "turntable a --rpm 33": "no option --rpm. gnomon turntable --help",
    "simulate cameras -o x --resolution 640": "expected 2 arguments",
    "simulate cameras -o x --resolution 640 4x": "expected a whole number",
    "simulate platter-video -o x --hidden 1 2 3": "expected 2 for each",
    "simulate": "KIND is one of imu, poses",
    "simulate imu": "--output",
    "apply c.yaml a b c -o x": "one too many: c",
}


def parsed(line):
    return parse_command(line.split())


@pytest.mark.parametrize("words", {" ".join(words): words for words in LINES}.values(), ids=" ".join)
def test_every_line_of_the_documentation_is_read(words):
    names = {words[0], " ".join(words[:2])} & set(COMMANDS)
    assert type(parse_command(words)) in [COMMANDS[name] for name in names]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_examples_that_are_read(name):
    _, _, examples = (inspect.getdoc(COMMANDS[name]) or "").partition("Examples\n--------\n")
    lines = [shlex.split(re.split(" >", line.removeprefix("$ gnomon "))[0]) for line in examples.splitlines()]
    assert lines
    assert {type(parse_command(line)) for line in lines} == {COMMANDS[name]}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_named(line):
    with pytest.raises(OptionError) as error:
        parsed(line)
    assert MISTAKES[line] in str(error.value)


def test_values_go_to_the_fields_of_their_kinds():
    command = parsed("imu --gravity=9.81 --fix imu0.bias imu0.scale --no-report --t-init-s 3 b.csv")
    assert [path.name for path in command.recording.paths] == ["b.csv"]
    assert (command.options.gravity, command.options.t_init_s) == (9.81, 3.0)
    assert command.options.fix == ("imu0.bias", "imu0.scale")
    assert not command.report


def test_operands_may_stand_on_both_sides_of_an_option():
    command = parsed("imu a.csv --gravity 9.81 b.csv")
    assert [path.name for path in command.recording.paths] == ["a.csv", "b.csv"]


def test_options_that_append_are_given_once_for_each():
    command = parsed("camera-imu rig --imu a.yaml --imu b.yaml --cams c.yaml")
    assert [path.name for path in command.imu] == ["a.yaml", "b.yaml"]
    assert command.cam.name == "c.yaml"


def test_rows_of_numbers_are_read_in_groups():
    command = parsed("simulate platter-video -o x.avi --hidden 1 2 -3 1e-3")
    assert command.scenario.hidden == ((1.0, 2.0), (-3.0, 1e-3))


def test_none_is_a_value_of_what_may_be_absent():
    assert parsed("imu a.csv --gravity none").options.gravity is None


def test_the_line_differs_from_the_scenario(tmp_path):
    (tmp_path / "s.yaml").write_text("views: 12\nrate_hz: 5\n")
    command = parse_command(["simulate", "cameras", "-o", "x", "--scenario", str(tmp_path / "s.yaml"), "--views", "7"])
    assert (command.options.views, command.options.rate_hz) == (7, 5.0)


def test_what_is_simulated_is_a_word_of_its_own_or_an_imu():
    kinds = {parsed(f"{name} -o x").__class__ for name in ("simulate poses", "simulate-poses")}
    assert kinds == {COMMANDS["simulate poses"]}
    assert type(parsed("simulate -o x.npz")) is COMMANDS["simulate imu"]
    with pytest.raises(OptionError, match="is one of imu, poses"):
        parsed("simulate pses -o x")


def test_of_an_option_that_is_given_twice_the_last_counts():
    assert parsed("imu a.csv --gravity 9.81 --json --gravity 9.8 --json").options.gravity == 9.8


@pytest.mark.parametrize("line", ["--projection ds", "--projection eucm --distortion none", "--distortion equidistant"])
def test_the_model_of_a_lens_alone_gives_a_usual_lens_of_it(tmp_path, line):
    for kind in ("cameras", "camera-imu", "room"):
        command = parse_command(["simulate", kind, "-o", str(tmp_path), *line.split()])
        assert command.options.resolution == (752, 480)
    own = parse_command(["simulate", "camera-imu", "-o", str(tmp_path), "--distortion", "radtan"])
    assert own.options == parse_command(["simulate", "camera-imu", "-o", str(tmp_path)]).options
