"""Many runs: fixed seeds, any number of processes, the same results, nothing done twice."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import OptionError, RecordingError, SolveError
from gnomon.study.runs import Records, Workers, carry_out, run_seeds
from gnomon.study.tedaldi_trial import SCENARIO, run_tedaldi_trial, tedaldi_trial
from repeatable import to_the_last_digit
from study_work import Task, drawn, lost, process, product, refused


class Memory:
    """A journal that lasts as long as the test; interrupts after some runs."""

    def __init__(self, interrupt_after=None):
        self.records = {}
        self.interrupt_after = interrupt_after

    def find(self, key):
        return self.records.get(key)

    def keep(self, key, record):
        assert key not in self.records
        self.records[key] = record
        if len(self.records) == self.interrupt_after:
            raise KeyboardInterrupt


def assert_alike(a, b):
    assert Records(drawn, []).written(a) == Records(drawn, []).written(b)
    np.testing.assert_array_equal(a.matrix, b.matrix)
    assert a.counts.dtype == b.counts.dtype


def test_seeds_differ_and_begin_alike():
    many = run_seeds(0, 1000)
    assert len(set(many)) == 1000
    assert many[:10] == run_seeds(0, 10)
    assert run_seeds(1, 10) != many[:10]


@to_the_last_digit
def test_results_do_not_depend_on_the_number_of_processes():
    tasks = run_seeds(3, 9)
    alone = carry_out(product, tasks)
    assert carry_out(product, tasks, workers=Workers(jobs=2)) == alone
    assert alone == [product(seed) for seed in tasks]


def test_several_processes_do_the_work():
    assert carry_out(process, range(3)) == [os.getpid()] * 3
    assert os.getpid() not in carry_out(process, range(8), workers=Workers(jobs=2))


def test_progress_tells_how_many_of_how_many_runs_are_done():
    told = []
    carry_out(abs, range(200), progress=told.append, name="experiment")
    assert told[-1] == "experiment: 200 of 200"
    assert [step.done for step in told] == list(range(201))
    assert carry_out(abs, [], progress=told.append) == []


def test_progress_tells_what_was_done_before():
    told = []
    journal = Memory()
    tasks = [Task(seed=k) for k in range(5)]
    carry_out(drawn, tasks[:2], workers=Workers(journal=journal))
    carry_out(drawn, tasks, workers=Workers(journal=journal), progress=told.append, name="test")
    counted = [f"test: {done} of 5" for done in (2, 3, 4, 5)]
    assert told == ["test: 2 of 5 were done before and are taken over", *counted]


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
    with pytest.raises(OptionError, match="Leave out"):
        Workers(jobs=2, scheduler="tcp://host:8786")


@pytest.mark.parametrize("after", [1, 4, 5])
def test_an_interrupted_study_goes_on_where_it_was(after, tmp_path):
    done = tmp_path / "done"
    tasks = [Task(seed=seed, done=str(done)) for seed in run_seeds(0, 5)]
    journal = Memory(interrupt_after=after)
    with pytest.raises(KeyboardInterrupt):
        carry_out(drawn, tasks, workers=Workers(journal=journal))
    assert len(done.read_text().split()) == after
    journal.interrupt_after = None
    found = carry_out(drawn, tasks, workers=Workers(journal=journal))
    assert sorted(done.read_text().split()) == sorted(str(task.seed) for task in tasks)  # each once
    for task, outcome in zip(tasks, found, strict=True):
        assert_alike(outcome, drawn(replace(task, done="")))


def test_what_is_kept_belongs_to_its_task_and_its_work_alone():
    journal = Memory()
    carry_out(drawn, [Task(seed=1), Task(seed=2)], workers=Workers(journal=journal))
    assert len(journal.records) == 2
    for other in (Task(seed=3), Task(seed=1, share=0.2)):
        (found,) = carry_out(drawn, [other], workers=Workers(journal=journal))
        assert_alike(found, drawn(other))
    assert len(journal.records) == 4
    carry_out(product, [1], workers=Workers(journal=journal))
    carry_out(process, [1], workers=Workers(journal=journal))
    assert len(journal.records) == 6


@pytest.mark.parametrize(
    "damaged",
    [
        "", "null", "{}", "[1]", '"text"', "{", '{"seed": 1}', '{"__reduce__": "os.system"}',
        '{"seed":1,"matrix":{"dtype":"O","shape":[1],"base64":"gAR9lC4="},"counts":0,"parts":[],"infinite":0.0}',
    ],
)  # fmt: skip
def test_a_damaged_record_is_a_run_that_is_done_again(damaged):
    journal = Memory()
    task = Task(seed=1)
    journal.records[Records(drawn, [task]).key(0)] = damaged
    journal.keep = lambda key, record: journal.records.update({key: record})
    (found,) = carry_out(drawn, [task], workers=Workers(journal=journal))
    assert_alike(found, drawn(task))
    assert journal.records[Records(drawn, [task]).key(0)] != damaged


@pytest.mark.parametrize("change", ["dtype", "shape", "base64"])
def test_an_array_that_is_none_is_a_run_that_is_done_again(change):
    content = json.loads(Records(drawn, []).written(drawn(Task(seed=1))))
    assert Records(drawn, []).read(json.dumps(content)) is not None
    content["matrix"][change] = {"dtype": "|O", "shape": [7, -1, 3], "base64": "no base64"}[change]
    assert Records(drawn, []).read(json.dumps(content)) is None


def test_objects_are_not_kept():
    with pytest.raises(TypeError, match="object"):
        Records(drawn, []).written(replace(drawn(Task(seed=1)), counts=np.array([object()])))


def test_the_outcome_of_a_study_is_kept_to_the_bit():
    task = tedaldi_trial(replace(SCENARIO, intervals=12, t_init_s=20.0), 5, 6)
    outcome = run_tedaldi_trial(task)
    records = Records(run_tedaldi_trial, [task])
    (back,) = records.read(records.written(outcome))
    np.testing.assert_array_equal(back.truth, outcome.truth)
    for a, b in zip(back.methods, outcome.methods, strict=True):
        np.testing.assert_array_equal(a.estimate, b.estimate)
        np.testing.assert_array_equal(a.errors.drift, b.errors.drift)
        assert a.problem == b.problem
