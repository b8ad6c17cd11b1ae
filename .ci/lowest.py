"""Print the lowest version of each dependency that pyproject.toml admits, as constraints for pip.

Run as `python .ci/lowest.py >lowest.txt`, then `pip install --constraint lowest.txt ...`.
"""

import sys
import tomllib
from itertools import chain
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
optional = project["optional-dependencies"].values()
for requirement in [*project["dependencies"], *chain.from_iterable(optional)]:
    if requirement.count(">=") != 1:
        sys.exit(f"pyproject.toml: {requirement!r} does not state one lowest version with >=")
    print(requirement.replace(">=", "=="))
