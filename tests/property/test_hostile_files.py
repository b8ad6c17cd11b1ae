"""Damaged files of every kind: a reader returns a value or refuses in words, whatever it is given.

`make fuzz` does the same for as long as one likes; see tests/hostile/fuzz.py.
"""

import sys
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gnomon.readers
from hostile.mutations import mutated
from hostile.promise import Target, address_space, keep
from hostile.targets import TARGETS

EXAMPLES = 9
SLOW = {"video", "video-stamps", "ros2-metadata", "ros1-bag", "mcap", "ros2-sqlite", "calibration-yaml", "prior-files"}
PARTLY = {"sensor-yaml", "calibration-yaml", "prior-files", "sample-table-stated"}
"""Targets of which each file is read in some of its ways only, and refused in others."""

NOT_READERS = {"__init__.py", "several_recordings.py"}
"""Modules that see no file, or leave it to the others to read it."""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """Return a function that prepares a target once."""
    made: dict[str, tuple[Path, tuple[bytes, ...]]] = {}

    def prepared(target: Target) -> tuple[Path, tuple[bytes, ...]]:
        if target.name not in made:
            made[target.name] = target.prepare(tmp_path_factory.mktemp(target.name)), tuple(target.seeds())
        return made[target.name]

    return prepared


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_read_or_refused_in_words(workshop, name):
    target = TARGETS[name]
    folder, seeds = workshop(target)
    outcomes = [keep(target, folder, seed) for seed in seeds]
    assert any(outcome is None for outcome in outcomes) or name in PARTLY

    @settings(
        max_examples=EXAMPLES // 3 if name in SLOW else EXAMPLES, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.integers(0, 2**32))
    def damage(number: int) -> None:
        chance = Random(number)
        with address_space():
            keep(target, folder, mutated(chance.choice(seeds), target.form, chance, seeds))

    damage()


@pytest.mark.long
def test_every_module_of_the_readers_is_reached(workshop):
    """A reader that comes later has to become a target: something of each module runs while valid files are read."""
    ran: set[str] = set()

    def entered(frame, event, _):
        if event == "call" and frame.f_code.co_name != "<module>":
            ran.add(frame.f_code.co_filename)

    for target in TARGETS.values():
        folder, seeds = workshop(target)
        for seed in seeds:
            (folder / target.file).write_bytes(seed)
            sys.setprofile(entered)
            try:
                target.read(folder)
            except gnomon.GnomonError:
                pass
            finally:
                sys.setprofile(None)
    root = Path(gnomon.readers.__file__).parent
    files = {file for file in root.rglob("*.py") if "\n    def " in (text := file.read_text()) or "\ndef " in text}
    missing = {file.relative_to(root).as_posix() for file in files if str(file) not in ran}
    assert missing <= NOT_READERS, "make them targets in tests/hostile"
