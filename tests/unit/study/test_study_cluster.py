"""The same study on a Dask cluster whose workers come and go."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gnomon.errors import OptionError, RecordingError, SolveError
from gnomon.study import cluster
from gnomon.study.journal import study_journal
from gnomon.study.runs import Workers, carry_out
from study_work import Task, drawn, refused, slow_product

TESTS = str(Path(__file__).parents[2])


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class LocalCluster:
    """A scheduler and two workers, each a process that a test can kill."""

    def __init__(self):
        self.address = f"tcp://127.0.0.1:{free_port()}"
        port = self.address.rpartition(":")[2]
        self.scheduler = self._run("scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        self.workers = [
            self._run("worker", self.address, "--no-nanny", "--nthreads", "1", "--no-dashboard") for _ in range(2)
        ]

    def _run(self, kind, *arguments):
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_" + kind, *arguments],
            env=os.environ | {"PYTHONPATH": TESTS, "OPENBLAS_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def wait(self):
        """Wait until both workers are there."""
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)

    def close(self):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def dask(monkeypatch):
    """The library, whose own warnings are not gnomon's."""
    pytest.importorskip("distributed", reason="needs the library distributed (gnomon[dask])")
    monkeypatch.setattr(cluster, "CONNECT_S", 30.0)  # a busy machine


@pytest.fixture
def local_cluster(dask):
    made = LocalCluster()
    try:
        made.wait()
        yield made
    finally:
        made.close()


def test_without_the_library_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OptionError, match=r'pip install "gnomon\[dask\]"$'):
        carry_out(slow_product, [1], workers=Workers(scheduler="tcp://127.0.0.1:1"))


def test_nobody_at_the_address_is_one_error_within_seconds(dask, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    with socket.socket() as mute:  # something that is no scheduler listens here, and says nothing
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        for address in (f"tcp://127.0.0.1:{free_port()}", f"tcp://127.0.0.1:{mute.getsockname()[1]}", "udp://nobody"):
            began = time.monotonic()
            with pytest.raises(OptionError, match=f"no Dask scheduler answers at {address}"):
                carry_out(slow_product, [1], workers=Workers(scheduler=address))
            assert time.monotonic() - began < 25  # Dask itself would try for 30 s; a busy machine takes its time


@pytest.mark.slow
def test_a_killed_worker_loses_nothing_and_nothing_is_there_twice(local_cluster, monkeypatch, tmp_path):
    """One worker is killed midway; then errors of runs and of versions; at last the whole cluster is killed."""
    monkeypatch.setattr(cluster, "_PARCELS", 12)  # of two runs each
    counted = []

    def count(step):
        counted.append(step.done)
        if step.done == 8:
            local_cluster.workers[0].send_signal(signal.SIGKILL)

    workers = Workers(scheduler=local_cluster.address)
    found = carry_out(slow_product, range(24), workers=workers, progress=count)
    assert counted == list(range(1, 25))
    assert local_cluster.workers[0].wait() == -signal.SIGKILL
    assert found == carry_out(slow_product, range(24))
    with pytest.raises(RecordingError, match="run 3"):
        carry_out(refused, range(8), workers=Workers(scheduler=local_cluster.address))
    _refuse_another_version(local_cluster)
    _keep_what_is_done(local_cluster, tmp_path)


def _refuse_another_version(local_cluster):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster, "__version__", "9.9.9")
        with pytest.raises(OptionError, match=r"gnomon .*, this is gnomon 9\.9\.9"):
            carry_out(slow_product, [1], workers=Workers(scheduler=local_cluster.address))


def _keep_what_is_done(local_cluster, folder):
    tasks = [Task(seed=seed, wait_s=0.05) for seed in range(20)]

    def end_all(step):
        if step.done == 6:
            local_cluster.close()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster, "ALONE_S", 1.0)
        with study_journal(folder, "test", print) as journal:
            workers = Workers(scheduler=local_cluster.address, journal=journal)
            with pytest.raises(SolveError, match="ended before"):
                carry_out(drawn, tasks, workers=workers, progress=end_all)
    counted = []
    with study_journal(folder, "test", print) as journal:
        workers = Workers(journal=journal)
        found = carry_out(drawn, tasks, workers=workers, progress=counted.append)
    assert counted[1].done >= 7
    assert [outcome.seed for outcome in found] == list(range(20))
