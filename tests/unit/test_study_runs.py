"""Many runs: fixed seeds, any number of processes, the same results."""

import os

import numpy as np
import pytest

from gnomon.errors import OptionError, RecordingError, SolveError
from gnomon.study.runs import Workers, carry_out, seeds


def product(seed):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((200, 200))
    return float(np.linalg.svd(a @ a)[1].sum())


def process(_):
    return os.getpid()


def refused(number):
    if number == 3:
        raise RecordingError("run 3 cannot be read.")
    return number


def lost(_):
    os._exit(1)


def test_seeds_differ_and_begin_alike():
    many = seeds(0, 1000)
    assert len(set(many)) == 1000
    assert many[:10] == seeds(0, 10)
    assert seeds(1, 10) != many[:10]


def test_results_do_not_depend_on_the_number_of_processes():
    tasks = seeds(3, 9)
    alone = carry_out(product, tasks)
    assert carry_out(product, tasks, workers=Workers(jobs=2)) == alone
    assert alone == [product(seed) for seed in tasks]


def test_several_processes_do_the_work():
    assert carry_out(process, range(3)) == [os.getpid()] * 3
    assert os.getpid() not in carry_out(process, range(8), workers=Workers(jobs=2))


def test_progress_is_told_but_not_of_every_run():
    told = []
    carry_out(abs, range(200), progress=told.append, name="experiment")
    assert told[-1] == "experiment 200 of 200"
    assert len(told) == 20
    assert carry_out(abs, [], progress=told.append) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_run_is_that_of_the_study(jobs):
    with pytest.raises(RecordingError, match="run 3"):
        carry_out(refused, range(8), workers=Workers(jobs=jobs))


def test_a_process_that_ends_is_an_error_in_words():
    with pytest.raises(SolveError, match="fewer jobs"):
        carry_out(lost, range(4), workers=Workers(jobs=2))


def test_no_jobs_are_refused():
    with pytest.raises(OptionError, match="jobs 0"):
        Workers(jobs=0)
