"""No process that gnomon starts imports a module from the working directory, whatever is called there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2]
GNOMON = Path(sys.executable).with_name("gnomon")
ALWAYS = ("gnomon", "numpy", "cv2", "pickle", "random", "multiprocessing", "threadpoolctl", "sitecustomize", "signal")
WORKER = """
import numpy as np
from gnomon.detect.boards.worker import BoardProcess
from gnomon.models.target import Target
process = BoardProcess(Target.checkerboard(cols=6, rows=5, row_spacing_m=0.03, col_spacing_m=0.03))
assert len(process.views([np.full((64, 64), 128, np.uint8)], follows=False)) == 1
process.close()
"""
POOL = """
from gnomon.study.runs import Workers, carry_out
from study_work import slow_product
if __name__ == "__main__":
    assert len(carry_out(slow_product, range(2), workers=Workers(jobs=2))) == 2
"""
LIBRARY = """
import multiprocessing
from gnomon.processes import safe_path
from study_work import slow_product
if __name__ == "__main__":
    with safe_path():
        pool = multiprocessing.get_context("spawn").Pool(1)
    assert len(pool.map(slow_product, [1])) == 1
    pool.terminate()
"""


@pytest.fixture(scope="module")
def imported():
    """Every module that is loaded where a child of gnomon's has done its work, by its first name."""
    code = WORKER + POOL + "import sys, cv2, gnomon.detect.boards.checkerboard\nprint(*sys.modules)"
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    names = {name.partition(".")[0] for name in done.stdout.split()} | set(ALWAYS)
    names -= {"__main__", "study_work", "site", "os"}
    return [name for name in names if name.isidentifier()]


@pytest.fixture
def hostile(imported, tmp_path):
    """A folder with a module of each of these names, which leaves a trace of itself when it is run."""
    for name in imported:
        text = f"open({str(tmp_path / 'trace.txt')!r}, 'a').write({name!r} + chr(10))\nraise ImportError('hostile')\n"
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def environment():
    """What a person's shell has, and nothing that makes it safer."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONSAFEPATH"}
    return {**kept, "PYTHONPATH": str(TESTS)}


def run_in(folder, *command):
    done = subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=60, check=False
    )
    assert not (folder / "trace.txt").exists(), (folder / "trace.txt").read_text()
    assert done.returncode == 0, done.stderr


def test_the_folder_is_hostile(hostile):
    done = subprocess.run([sys.executable, "-c", "import pickle"], cwd=hostile, capture_output=True, check=False)
    assert done.returncode != 0
    assert (hostile / "trace.txt").exists()


@pytest.mark.parametrize("code", [WORKER, POOL, LIBRARY], ids=["board worker", "study", "library"])
def test_children_import_nothing_from_the_working_directory(code, hostile, tmp_path_factory):
    program = tmp_path_factory.mktemp("program") / "program.py"
    program.write_text(code)
    run_in(hostile, sys.executable, program)


@pytest.mark.skipif(not GNOMON.exists(), reason="gnomon is not installed as a program here")
def test_the_program_imports_nothing_from_the_working_directory(hostile):
    run_in(hostile, GNOMON, "simulate", "noise", "-o", "rest.npz", "--duration-s", "1")


def test_python_m_gnomon_leaves_the_working_directory_as_soon_as_it_can(hostile):
    """Python itself takes importlib and gnomon from there first, which nothing in gnomon can change."""
    kept = {"numpy", "scipy", "cv2", "pickle", "random", "json", "yaml", "rich", "subprocess"}
    for path in hostile.glob("*.py"):
        if path.stem not in kept:
            path.unlink()
    run_in(hostile, sys.executable, "-m", "gnomon", "simulate", "noise", "-o", "rest.npz", "--duration-s", "1")


def test_python_p_m_gnomon_does_not_even_take_gnomon_from_there(hostile):
    run_in(hostile, sys.executable, "-P", "-m", "gnomon", "--version")
