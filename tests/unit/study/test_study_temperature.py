"""The study of the temperature: one sensor of each kind, its claims, and its page."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.report.page import render_page
from gnomon.report.studies.temperature import temperature_study_page
from gnomon.study.temperature import (
    METHODS,
    TemperatureStudy,
    TemperatureTask,
    run_temperature,
    temperature_claims,
    temperature_tables,
)

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def runs():
    return run_temperature(TemperatureTask(seed=96003)), run_temperature(TemperatureTask(seed=96003, changes=False))


def study_of(changing, healthy, count=30):
    return TemperatureStudy(runs=count, seed=0, outcomes=(changing,) * count, healthy=(healthy,) * count)


def test_one_sensor(runs):
    changing, healthy = runs
    assert changing.order == changing.found
    assert (changing.errors > 0).all()
    assert changing.errors[0] < changing.errors[1:].min()
    assert 0 < changing.z < 4
    assert healthy.order == healthy.found == 0
    assert np.isnan(healthy.z)


def test_claims_can_fail(runs):
    changing, healthy = runs
    good = replace(changing, errors=np.array([1.0, 4.0, 4.0]), z=1.0)
    assert all(claim.holds for claim in temperature_claims(study_of(good, healthy)))
    bad = replace(good, found=good.order + 1, errors=np.array([2.0, 4.0, 4.0]), z=1.5)
    assert not any(claim.holds for claim in temperature_claims(study_of(bad, replace(healthy, found=1))))
    assert all(claim.holds is None for claim in temperature_claims(study_of(bad, healthy, 3)))


def test_page_and_tables(runs):
    study = study_of(*runs, count=3)
    page = render_page(temperature_study_page(study)).decode()
    assert all(name in page for name in METHODS)
    tables = {table.name: table for table in temperature_tables(study)}
    assert set(tables) == {"claims", "warm_ups"}
    assert len(tables["warm_ups"].rows) == 6
    assert all(len(row) == len(tables["warm_ups"].head) for row in tables["warm_ups"].rows)
