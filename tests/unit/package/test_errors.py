"""What a message says that something is missing works where it is followed."""

import importlib.metadata
import importlib.util
import subprocess
import sys

import pytest

from gnomon.errors import install_line


def test_the_command_is_of_this_python_and_keeps_its_brackets_in_every_shell():
    assert install_line("gnomon[live]") == f'{sys.executable} -m pip install "gnomon[live]"'
    assert install_line("pandas", "pyarrow").endswith(" -m pip install pandas pyarrow")


def test_the_command_takes_the_gnomon_that_is_installed_and_no_other():
    words = install_line("gnomon[tls]").replace('"', "").split()
    done = subprocess.run([*words, "--dry-run", "--no-index"], capture_output=True, text=True, check=False)
    if "cryptography" in done.stdout + done.stderr and done.returncode:
        pytest.skip("cryptography is not installed")
    assert done.returncode == 0, done.stderr
    assert "Requirement already satisfied: gnomon[tls]" in done.stdout
    assert "Would install" not in done.stdout


def test_a_tree_that_is_not_installed_installs_itself(monkeypatch):
    def unknown(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", unknown)
    assert install_line("gnomon[live]").endswith(' -m pip install ".[live]"')


def test_an_environment_without_pip_and_a_path_with_a_space(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "executable", "/home/some one/bin/python")
    assert install_line("pandas") == 'uv pip install --python "/home/some one/bin/python" pandas'
