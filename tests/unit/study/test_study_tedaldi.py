"""The study of Tedaldi, small; `pytest -m slow` runs it whole (tests/e2e/test_study_tedaldi.py)."""

import csv
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from gnomon.models.forms import TedaldiAccelerometer, TedaldiGyroscope
from gnomon.report.page import render_page
from gnomon.report.studies.tedaldi import tedaldi_page
from gnomon.simulate.imu import simulate_imu, true_signals
from gnomon.simulate.scenarios.recorded import Scenario
from gnomon.study import tedaldi
from gnomon.study.tedaldi import (
    GROUPS,
    MEAN_ERROR,
    SPREAD,
    UNITS,
    group_errors,
    noise_alone,
    sigma_over_scatter,
    study_tedaldi,
    tedaldi_claims,
    tedaldi_tables,
    tedaldi_trials,
)
from gnomon.study.tedaldi_trial import (
    METHODS,
    SCENARIO,
    SignalErrors,
    as_tedaldi,
    correct_samples,
    ideal_signals,
    recorded_samples,
    run_tedaldi_trial,
    signal_errors,
    tedaldi_trial,
)
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser
from html_page import Page

FEW = 2
"""Recordings of each of two sets; the first four sets give the examples of a whole study."""


@pytest.fixture(scope="module")
def small():
    return study_tedaldi(runs=FEW, sets=2)


def test_the_numbers_of_the_thesis_agree_with_themselves():
    assert len(SPREAD) == len(MEAN_ERROR) == len(UNITS) == 18
    for where, error in GROUPS.values():  # the first set is much like the 40
        assert 0.5 < MEAN_ERROR[where].mean() / error < 1.5
    np.testing.assert_array_less(0.6, MEAN_ERROR / SPREAD)  # of a normal distribution 0.8
    np.testing.assert_array_less(MEAN_ERROR / SPREAD, 1.1)
    assert noise_alone() == pytest.approx((0.0056, 0.00343), rel=5e-3)


def test_sets_and_runs_of_a_smaller_study_are_the_first_of_a_larger_one():
    many = tedaldi_trials(3, 3, 4)
    assert len({(task.scenario.sensor_seed, task.seed) for task in many}) == 12
    assert tedaldi_trials(3, 2, 2) == [*many[:2], *many[4:6]]
    assert not {task.seed for task in tedaldi_trials(4, 3, 4)} & {task.seed for task in many}


def test_ideal_signals_are_those_of_the_recording():
    silent = replace(SCENARIO, intervals=6, t_init_s=8.0, accelerometer_noise_density=0.0, gyroscope_noise_density=0.0)
    task = tedaldi_trial(silent, 5, 6)
    recording, truth = simulate_imu(task.scenario, task.seed)
    ideal = ideal_signals(task, truth)
    force, rate = correct_samples(truth.in_frame("accel-z").imus["imu0"], *recorded_samples(recording))
    np.testing.assert_allclose(force, ideal.force, atol=1e-12)
    np.testing.assert_allclose(rate, ideal.rate, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ideal.force[~ideal.moving], axis=1), silent.gravity, rtol=1e-12)
    assert np.abs(ideal.rate[~ideal.moving]).max() == 0
    moving = np.linalg.norm(ideal.rate, axis=1) > 1e-6
    assert not (moving & ~ideal.moving).any()
    errors = signal_errors(ideal, force, rate, silent.gravity)
    for name in SignalErrors.__slots__:  # carrying by RK4 through jumps of the rate leaves a little
        np.testing.assert_allclose(getattr(errors, name), 0, atol=2e-3 if name.startswith(("rot", "drift")) else 1e-7)
    assert errors.rotation_angle.max() < 1e-4


def test_the_metrics_measure_what_is_wrong():
    task = tedaldi_trial(replace(SCENARIO, intervals=6, t_init_s=8.0), 5, 6)
    ideal = true_signals(task.scenario, task.seed)
    shift, turn = np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.02, 0.0])
    errors = signal_errors(ideal, ideal.force + shift, ideal.rate + turn, task.scenario.gravity)
    np.testing.assert_allclose(errors.force, shift, atol=1e-12)
    np.testing.assert_allclose(errors.rate, turn, atol=1e-12)
    assert 0 < errors.divergence[0] < errors.divergence[1] <= 0.3 + 1e-9
    np.testing.assert_allclose(np.sin(errors.tilt[1]) * task.scenario.gravity, errors.divergence[1])
    larger = signal_errors(ideal, ideal.force, 1.1 * ideal.rate, task.scenario.gravity)
    assert larger.rotation_angle[0] > 0.02
    assert larger.drift_angle[1] > larger.rotation_angle[1]
    np.testing.assert_allclose(
        larger.rotation, 2 * task.scenario.gravity * np.sin(larger.rotation_angle / 2), rtol=0.05
    )


def test_letters_and_sigmas_of_document_a():
    _, truth = simulate_imu(Scenario(style="thesis", intervals=6, t_init_s=8.0), 3)
    known = truth.in_frame("accel-z")
    estimate, sigma = as_tedaldi(known)
    assert np.abs(sigma).max() == 0
    imu = known.imus["imu0"]
    a = TedaldiAccelerometer.from_sensor(np.triu(imu.accelerometer.sensitivity), imu.accelerometer.bias)
    g = TedaldiGyroscope.from_sensor(imu.gyroscope.sensitivity, imu.gyroscope.bias, imu.gyroscope.g_sensitivity)
    np.testing.assert_allclose(a.T, [[1, -estimate[0], estimate[1]], [0, 1, -estimate[2]], [0, 0, 1]], atol=1e-15)
    g_yz, g_zy, g_xz, g_zx, g_xy, g_yx = estimate[9:15]
    np.testing.assert_allclose(g.T, [[1, -g_yz, g_zy], [g_xz, 1, -g_zx], [-g_xy, g_yx, 1]], atol=1e-15)
    # Sigmas: a small change of one entry of the sensitivity, carried by hand.
    for triad, first, size in (("accelerometer", 0, 9), ("gyroscope", 9, 9)):
        names = known.uncertainty.names
        start = next(k for k, name in enumerate(names) if name.startswith(f"imu0.{triad}.sensitivity"))
        at = start + 1  # row 0, column 1
        step = 1e-6
        matrix = np.zeros_like(known.uncertainty.matrix)
        matrix[at, at] = step**2
        uncertain = replace(known, uncertainty=replace(known.uncertainty, matrix=matrix))
        _, sigma = as_tedaldi(uncertain)
        changed = getattr(imu, triad).sensitivity.copy()
        changed[0, 1] += step
        moved = replace(
            known, imus={"imu0": replace(imu, **{triad: replace(getattr(imu, triad), sensitivity=changed)})}
        )
        difference = as_tedaldi(moved)[0] - estimate
        np.testing.assert_allclose(sigma, np.abs(difference), atol=1e-10)
        assert sigma[first : first + size].max() > 0.5 * step


def test_every_claim_holds_but_for_what_few_runs_can_tell(small):
    found = {claim.claim: claim.holds for claim in tedaldi_claims(small)}
    assert [text for text, holds in found.items() if holds is False] == []
    assert [text for text, holds in found.items() if holds is None] == [
        "Gnomon's sigmas agree with the scatter, each of the 18 parameters"
    ]


def test_gnomon_is_nearer_to_the_truth_than_what_was_published(small):
    ours, printed, script = (group_errors(small, method) for method in METHODS)
    assert (ours < printed).all()
    assert (ours < script).all()
    z = 1 / sigma_over_scatter(small, "gnomon")
    assert 0.3 < z.min() < z.max() < 3


def test_a_recording_that_cannot_be_calibrated_is_counted(small):
    outcome = run_tedaldi_trial(tedaldi_trial(replace(SCENARIO, intervals=5, t_init_s=4.0), 1, 2))
    assert all(one.problem for one in outcome.methods)
    assert np.isnan(outcome.methods[0].estimate).all()
    assert np.isfinite(outcome.before.drift).all()
    first, *rest = small.outcomes[0]
    study = replace(small, outcomes=((outcome, *rest), *small.outcomes[1:]))
    failed = {claim.claim: claim for claim in tedaldi_claims(study)}["Every recording is calibrated"]
    assert not failed.holds
    assert failed.found.startswith("3;")
    assert np.isfinite(group_errors(study, "gnomon")).all()
    assert first.methods[0].problem == ""
    assert tedaldi_page(study).verdict == "warn"


def test_the_page_shows_tables_and_figures(small):
    html = render_page(tedaldi_page(small)).decode()
    page = Page(html)
    assert html.count('<svg class="plot"') == 1 + 2 * len(small.examples) + 1 + 6
    assert "nan" not in page.text.split()
    assert all(link.startswith(("#", "data:")) for link in page.links)
    for figure in range(10, 16):
        assert f"Fig. 4.{figure}:" in page.text
    for table in range(1, 6):
        assert f"4.{table}" in page.text


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)
@pytest.mark.parametrize(("width", "mobile", "scheme"), [(1440, False, "light"), (390, True, "dark")])
def test_the_page_fits_any_screen(small, tmp_path, width, mobile, scheme):
    path = tmp_path / "study.html"
    path.write_bytes(render_page(tedaldi_page(small)))
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(path, width=width, height=900, mobile=mobile, scheme=scheme)
        seen = browser.evaluate(MEASURE)
        assert browser.problems() == []
        assert seen["scroll"] <= seen["client"]
        assert all(left >= 0 and right <= width for left, right, _ in seen["plots"])
    finally:
        browser.close()


def test_tables_are_whole_csv_files(small):
    found = {table.name: list(csv.DictReader(StringIO(table.csv()))) for table in tedaldi_tables(small)}
    assert set(found) == {"claims", "parameters", "tedaldi_2014", "signals"}
    assert len(found["parameters"]) == 2 * len(METHODS) * 18
    assert len(found["signals"]) == 2 * FEW * (1 + len(METHODS))
    assert float(found["parameters"][0]["truth"]) == small.truth[0, 0]
    assert float(found["tedaldi_2014"][0]["mean_absolute_error"]) == MEAN_ERROR[0]
    assert {row["method"] for row in found["signals"]} == {"uncalibrated", *METHODS}
    assert tedaldi.SETS == 40
