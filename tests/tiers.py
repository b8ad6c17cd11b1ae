"""The quick tier of the tests: what a newcomer needs to believe the tool works, and what is run after each change.

`pytest --quick` leaves out what durations.json says is costly, and keeps what is marked `main`: one job of each kind,
from a recording to the report; `pytest --costly` runs the others. `pytest --record-durations` (`make durations`) writes
that file: CPU seconds of each test over 0.1 s, and of the fixtures of each file over 0.5 s. CPU times on one machine
tell costly from cheap well enough on all; no test fails by the clock. Files that cost most run first, so that all
processes have work to the end.
"""

import json
import os
from collections import Counter
from collections.abc import Generator, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

DURATIONS = Path(__file__).with_name("durations.json")
QUICK_CALL_S, QUICK_FIXTURES_S = 0.1, 1.0
LONG_S = 3.0
"""A test that takes longer is marked `long`, by somebody who has asked himself why."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("tiers")
    group.addoption("--quick", action="store_true", help="leave out what tests/durations.json says is costly")
    group.addoption("--costly", action="store_true", help="only what --quick leaves out")
    group.addoption("--record-durations", action="store_true", help="write tests/durations.json; run all tests")


@cache
def _known() -> dict[str, dict[str, float]]:
    return json.loads(DURATIONS.read_text(encoding="utf-8")) if DURATIONS.exists() else {"calls": {}, "fixtures": {}}


class _FromTheEnd(pytest.Dir):
    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        return reversed(list(super().collect()))


def pytest_collect_directory(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Let every other process read the files from the end, so that each prepares the assertions of some for all."""
    number = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    backwards = int(number) % 2 == 1 and not (path / "__init__.py").exists()
    return _FromTheEnd.from_parent(parent, path=path) if backwards else None


@cache
def _file_s() -> Counter[str]:
    """Return how long each test file takes."""
    seconds = Counter[str](_known()["fixtures"])
    for name, s in _known()["calls"].items():
        seconds[name.split("::")[0]] += s
    return seconds


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out costly tests, or cheap ones, where that is asked for; and further cases where the first ones do."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: (-_file_s()[file := item.nodeid.split("::")[0]], file))
    cases = Counter[str]()
    for item in items:
        if few := item.get_closest_marker("first"):
            test = item.nodeid.partition("[")[0]
            cases[test] += 1
            if cases[test] > few.args[0]:
                item.add_marker("slow")
    if config.getoption("--quick") or config.getoption("--costly"):
        wanted = config.getoption("--costly")
        others = [item for item in items if _is_costly(item) != wanted]
        if others:
            config.hook.pytest_deselected(items=others)
            items[:] = [item for item in items if _is_costly(item) == wanted]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fail where a test takes long and is not marked as such."""
    marked = any(item.get_closest_marker(name) for name in ("long", "slow"))
    if _known()["calls"].get(item.nodeid, 0.0) > LONG_S and not marked:
        pytest.fail(f"takes more than {LONG_S:g} s and is not marked `long`: make it shorter, or mark it")


def _is_costly(item: pytest.Item) -> bool:
    call, fixtures = _known()["calls"].get(item.nodeid, 0.0), _known()["fixtures"].get(item.nodeid.split("::")[0], 0.0)
    return not item.get_closest_marker("main") and (call > QUICK_CALL_S or fixtures > QUICK_FIXTURES_S)


def _cpu_s() -> float:
    return sum(os.times()[:4])  # of this process and its children


class Recorder:
    """Gathers CPU times: measured where a test runs, sent with its reports, written where the session ends."""

    def __init__(self) -> None:
        self.calls: dict[str, float] = {}
        self.fixtures: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[Any]) -> Generator[None, Any, Any]:
        report = yield
        report.user_properties = [("cpu_s", _cpu_s() - self.start_s)]
        self.start_s = _cpu_s()
        return report

    def pytest_runtest_logstart(self) -> None:
        self.start_s = _cpu_s()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        seconds = dict(report.user_properties).get("cpu_s", 0.0)
        if report.when == "call":
            self.calls[report.nodeid] = seconds
        else:
            file = report.nodeid.split("::")[0]
            self.fixtures[file] = self.fixtures.get(file, 0.0) + seconds

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if not hasattr(session.config, "workerinput"):
            calls = {name: round(s, 2) for name, s in sorted(self.calls.items()) if s > 0.1}
            fixtures = {name: round(s, 2) for name, s in sorted(self.fixtures.items()) if s > 0.5}
            text = json.dumps({"calls": calls, "fixtures": fixtures}, indent=0, ensure_ascii=False)
            DURATIONS.write_text(text + "\n", encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--record-durations"):
        config.pluginmanager.register(Recorder(), "durations")
