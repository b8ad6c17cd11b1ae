"""Every finding that the code makes is in the catalogue, with the facts that its texts name, and no other."""

import ast
import re
from functools import cache
from string import Formatter

import pytest

from docs_pages import ROOT
from gnomon.findings import (
    _template,  # pyright: ignore[reportPrivateUsage]
    make_finding,
    read_catalogue,
)

TEXTS = ("message", "consequence", "cure", "subject")
ENTRIES = {entry["code"]: entry for entry in read_catalogue() if "code" in entry}


def texts_of(entry):
    for name in TEXTS:
        value = entry.get(name, "")
        yield from value.values() if isinstance(value, dict) else (value,)


@cache
def made():
    """Return where findings are made, their keys as patterns, the names of their facts, their cases."""
    return list(_made())


def _made():
    for path in sorted((ROOT / "src" / "gnomon").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "make_finding":
                (key,) = node.args
                parts = key.values if isinstance(key, ast.JoinedStr) else [key]
                pattern = "".join(re.escape(p.value) if isinstance(p, ast.Constant) else r"[\w-]+" for p in parts)
                given = {keyword.arg: keyword.value for keyword in node.keywords}
                case = given.pop("case", None)
                cases = {n.value for n in ast.walk(case) if isinstance(n, ast.Constant) and n.value} if case else set()
                yield f"{path.name}:{node.lineno}", pattern, given, {str(one) for one in cases}


def test_every_finding_has_its_entry_and_every_entry_its_finding():
    assert len(made()) > 250
    assert [where for where, pattern, *_ in made() if not any(re.fullmatch(pattern, key) for key in ENTRIES)] == []
    patterns = [pattern for _, pattern, *_ in made()]
    assert {key for key in ENTRIES if not any(re.fullmatch(pattern, key) for pattern in patterns)} == set()


def test_the_code_gives_the_facts_that_the_texts_name_and_no_other():
    for where, pattern, given, cases in made():
        for key in filter(re.compile(pattern).fullmatch, ENTRIES):
            entry = ENTRIES[key]
            named = {name for text in texts_of(entry) for _, name, _, _ in Formatter().parse(text) if name is not None}
            assert named == given.keys() - {"severity"}, (where, key)
            assert ("severity" in given) != ("severity" in entry), (where, key)
            keys = {case for name in TEXTS if isinstance(entry.get(name), dict) for case in entry[name]}
            assert keys - {"else"} <= cases, (where, key)
            assert not cases or keys, (where, key)


def test_every_code_is_explained_once():
    explained = [code for entry in ENTRIES.values() if "when" in entry for code in _codes(entry)]
    assert sorted(explained) == sorted({key.partition("/")[0] for key in ENTRIES})


def _codes(entry):
    return [entry["code"].partition("/")[0], *entry.get("together", [])]


def test_numbers_are_shown_in_the_units_of_the_text():
    finding = make_finding("rotation-one-axis", name="cam0", **_facts("rotation-one-axis"))
    assert finding.subject == "cam0"
    told = make_finding("noise-misfit", severity="warning", name="gyroscope", axis="x", misfit=0.256)
    assert "by 26 % from" in told.message
    assert told.cure


def _facts(key):
    names = {name for text in texts_of(ENTRIES[key]) for _, name, _, _ in Formatter().parse(text) if name}
    return dict.fromkeys(names - {"name"}, 1.0)


def test_a_good_finding_is_a_message_alone_and_cases_choose_among_texts():
    facts = {"label": "imu0", "count": 3, "plural": "s", "lost": 5, "length_s": 0.1, "at": "2 s"}
    severe = make_finding("gaps", severity="warning", case="severe", **facts)
    short = make_finding("gaps", severity="info", **facts)
    assert severe.consequence == "Rotations with a gap in them are wrong."
    assert (short.consequence, short.cure) == ("Short gaps are bridged linearly.", "")
    good = make_finding("gaps", severity="good", case="severe", **facts)
    assert (good.consequence, good.cure) == ("", "")
    assert good.code == "gaps"


def test_a_fact_that_is_missing_is_an_error():
    with pytest.raises(KeyError):
        make_finding("noise-misfit", severity="warning", name="gyroscope")


def test_an_entry_alone_is_the_one_of_the_whole_catalogue():
    assert {code: _template(code) for code in ENTRIES} == ENTRIES
    with pytest.raises(KeyError):
        _template("no-such-code")
