"""What the tests of the command line share."""

import contextlib
import io

import numpy as np
import pytest

import gnomon
import recorded
from gnomon.cli import main

SCENARIO = gnomon.Scenario(intervals=24, t_init_s=20.0, hold_s=(3.0, 3.5), rate_hz=50.0)


@pytest.fixture(scope="session")
def run():
    """Return a function that runs a command in this process: exit code, standard output, standard error."""

    def command(*arguments):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([str(argument) for argument in arguments])
        return code, out.getvalue(), err.getvalue()

    return command


@pytest.fixture(scope="session")
def names():
    """Return a function that lists a folder."""
    return lambda folder: sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="session")
def write_table():
    """Return a function that writes a table t ax ay az gx gy gz as CSV."""

    def write(path, table):
        rows = "\n".join(",".join(f"{x:.9g}" for x in row) for row in table)
        path.write_text(f"time [s],ax [m/s^2],ay,az,gx [rad/s],gy,gz\n{rows}\n")
        return path

    return write


@pytest.fixture(scope="session")
def good_table():
    """A recording from which a calibration succeeds, (n, 7)."""
    imu = gnomon.simulate(SCENARIO, seed=1)[0].imus["imu0"]
    return np.column_stack([imu.accelerometer.t_ns * 1e-9, imu.accelerometer.values, imu.gyroscope.values])


@pytest.fixture
def recording(tmp_path, good_table, write_table):
    """The same as a file, alone in a folder."""
    return write_table(tmp_path / "recording.csv", good_table)


@pytest.fixture(scope="session")
def walks(tmp_path_factory):
    """Small recordings of a rig as images, in every layout."""
    return recorded.Walks(tmp_path_factory.mktemp)
