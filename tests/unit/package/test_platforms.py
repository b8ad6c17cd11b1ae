"""What only some systems have is not needed: src runs where there is no POSIX, and reads text alike everywhere."""

import subprocess
import sys
from pathlib import Path

import pytest

import gnomon

WITHOUT_POSIX = """
import asyncio, concurrent.futures.process, importlib, os, pkgutil, signal, subprocess, sys
import av, cattrs, cv2, numpy, rich.console, rosbags.highlevel, scipy.linalg, scipy.optimize, yaml
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None  # importing it raises ImportError
for name in ("SIGKILL", "SIGHUP", "SIGALRM"):
    delattr(signal, name)
for name in ("fork", "getuid", "geteuid", "sched_getaffinity", "getloadavg"):
    delattr(os, name)
sys.platform = "win32"
import gnomon
names = [found.name for found in pkgutil.walk_packages(gnomon.__path__, "gnomon.") if "__main__" not in found.name]
for name in names:
    importlib.import_module(name)
print(len(names))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="that is this system")
def test_every_module_can_be_imported_where_there_is_no_posix():
    done = subprocess.run([sys.executable, "-c", WITHOUT_POSIX], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == len(list(Path(gnomon.__file__).parent.rglob("*.py"))) - 2  # gnomon itself, __main__


def test_text_files_are_opened_with_an_encoding():
    """Without one the system's would be taken: UTF-8 here, another on Windows."""
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--preview", "--select", "PLW1514", "--quiet"]
    done = subprocess.run([*ruff, Path(gnomon.__file__).parent], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
