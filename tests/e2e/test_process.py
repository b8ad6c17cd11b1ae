"""gnomon as a process among others: outputs that take nothing, few open files, narrow terminals, signals."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("resource", reason="limits and signals as POSIX has them")

SHOWN = "simulate poses -o poses.csv"
NATIVE = """
import hashlib, sys
sys.argv = ["gnomon"]
from gnomon import __main__ as program
from gnomon.output import files_together
import gnomon.cli.terminal
def work(arguments):
    with files_together("out") as staging:
        (staging / "part").write_text("half")
        print("ready", flush=True)
        hashlib.pbkdf2_hmac("sha256", b"", b"", 1_000_000_000)  # minutes in a library, which lets other threads run
gnomon.cli.terminal.main = work
program.main()
"""


def shell(folder, text):
    """Run a line of the shell in which `gnomon` is this program."""
    program = f'gnomon() {{ "{sys.executable}" -m gnomon "$@"; }}; '
    done = subprocess.run(["sh", "-c", program + text], cwd=folder, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "bug" not in done.stderr
    return done.returncode, done.stdout, done.stderr.splitlines()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device here")  # noqa: PTH110
@pytest.mark.parametrize("command", ["gnomon --version", f"gnomon {SHOWN}", f"gnomon {SHOWN} --json"])
def test_a_full_output_is_one_line(command, tmp_path):
    code, _, said = shell(tmp_path, f"{command} > /dev/full")
    assert code == 3
    assert [line for line in said if line.startswith("gnomon:")] == [
        f"gnomon: the output cannot be written ({os.strerror(28)}). Files that are there are whole."
    ]


def test_a_closed_output_is_said_and_costs_no_result(tmp_path):
    code, _, said = shell(tmp_path, f"gnomon {SHOWN} >&-")
    assert code == 0
    assert said[0] == "gnomon: standard output is closed; what would be printed there is lost."
    assert (tmp_path / "poses.csv").exists()


@pytest.mark.parametrize("place", ["&-", "/dev/full"])
def test_words_that_nobody_takes_cost_no_result(place, tmp_path):
    code, out, _ = shell(tmp_path, f"gnomon check nothing.csv 2>{place}; gnomon {SHOWN} 2>{place}")
    assert (code, "poses.csv" in out) == (0, True)


def test_few_open_files_are_one_line(tmp_path):
    """With fewer than about six Python itself does not start."""
    code, _, said = shell(tmp_path, f"gnomon {SHOWN}; ulimit -n 6; gnomon show truth.yaml; ulimit -n 5; gnomon {SHOWN}")
    assert code in {1, 3}
    assert all(line.startswith("gnomon: too few files may be open") for line in said if line.startswith("gnomon:"))


@pytest.mark.parametrize("columns", ["0", "1", "-5", "x"])
def test_help_in_a_narrow_terminal(columns, tmp_path):
    began = time.monotonic()
    code, out, said = shell(tmp_path, f"COLUMNS={columns} gnomon rate --help")
    assert (code, said) == (0, [])
    assert "--nominal" in out
    assert time.monotonic() - began < 10


def test_sigterm_ends_a_long_step_of_a_library_within_two_seconds(tmp_path):
    command = [sys.executable, "-c", NATIVE]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.3)  # until the library is at it
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
    assert time.monotonic() - began < 2.5  # half a second for a busy machine
    assert process.returncode == 128 + signal.SIGTERM
    assert said == "gnomon: interrupted; no file is half-written.\n"
    assert list(tmp_path.iterdir()) == []
