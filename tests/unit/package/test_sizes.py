"""How large the parts of the package are: functions, folders, files.

`python tests/unit/package/test_sizes.py` prints lines, files, and lines of functions with and without docstrings.
"""

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np

import gnomon
from gnomon.writers.recording_file import save_recording

ROOT = Path(gnomon.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
MOST_BESIDE, MOST_AT_ROOT, MOST_ENTERED = 25, 10, 60


def function_lines(*, docstrings):
    """Return the lines of each function, from `def` to its end."""
    lines = []
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines.append(node.end_lineno - node.lineno + 1)
                if ast.get_docstring(node, clean=False) is not None and not docstrings:
                    lines[-1] -= node.body[0].end_lineno - node.body[0].lineno + 1
    return np.array(lines)


def test_functions_are_small():
    lines = function_lines(docstrings=False)
    assert len(lines) > 1000
    assert np.median(lines) <= 8
    assert np.percentile(lines, 90) <= 25


def test_few_files_lie_beside_each_other():
    beside = Counter(path.parent for path in FILES)
    assert 0 < len([path for path in FILES if path.parent == ROOT and path.name[0] != "_"]) <= MOST_AT_ROOT
    assert max(beside.values()) <= MOST_BESIDE, beside.most_common(1)


def test_a_reader_opens_few_files_for_a_command(tmp_path):
    """Whoever follows `gnomon imu` through the code."""
    entered = Path(__file__).parents[3] / "benchmarks" / "entered.py"
    save_recording(gnomon.simulate(seed=7)[0], tmp_path / "imu.csv")
    words = [sys.executable, str(entered), "imu", str(tmp_path / "imu.csv"), "-o", str(tmp_path / "out")]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    loaded, called = (int(part.split()[0]) for part in said.split(","))
    assert 0 < called < loaded
    assert called <= MOST_ENTERED, said


if __name__ == "__main__":
    text = {path: path.read_text(encoding="utf-8").count("\n") for path in FILES}
    print(f"{sum(text.values())} lines in {len(text)} files, {max(text.values())} at most: {max(text, key=text.get)}")
    for docstrings in (True, False):
        lines = function_lines(docstrings=docstrings)
        median, p90 = np.median(lines), np.percentile(lines, 90)
        print(
            f"{len(lines)} functions, docstrings {'in' if docstrings else 'ex'}cluded: {median:g} median, {p90:g} p90"
        )
