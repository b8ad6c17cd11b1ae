"""The study of Krebs, small; `pytest -m slow` runs it whole (tests/e2e/test_study_krebs.py)."""

import csv
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from gnomon.report.page import render_page
from gnomon.report.studies.krebs import krebs_page
from gnomon.simulate.camera_imu import simulate_camera_imu
from gnomon.study.krebs import SERIES, SETTINGS, Independence, KrebsSample, KrebsStudy, group_mean, study_krebs
from gnomon.study.krebs_claims import krebs_claims, krebs_tables
from gnomon.study.krebs_run import (
    CHANGES,
    GROUPS,
    NAMES,
    OPTIONS,
    SCENARIO,
    KrebsRig,
    KrebsRun,
    KrebsTask,
    calibrated_run,
    change_parameter,
    group_columns,
    run_krebs,
    sense_motion,
    stated_sigma,
)
from gnomon.study.runs import Records, run_seeds
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser
from html_page import Page

RUNS = 40


def drawn_study(runs: int = RUNS, seed: int = 0) -> KrebsStudy:
    """Return what a study would have found where everything in Krebs is true."""
    rng = np.random.default_rng(seed)
    samples = []
    for k, series in enumerate(SERIES):
        sigma = np.nan_to_num(stated_sigma(k % 4 if k < 3 else 0), nan=1e-3) * series.task.noise_factor ** (k > 3)
        bias = np.zeros(len(NAMES))
        if series.task.model == "basic":
            bias[group_columns("p_cb")] = 4e-3, 1e-3, -2e-3
            sigma = sigma / 3
        errors = bias + sigma * rng.standard_normal((runs, len(NAMES)))
        outcomes = tuple(
            KrebsRun(error=e, sigma=sigma, nees=float(np.sum((e / sigma) ** 2)), iterations=4, converged=True)
            for e in errors
        )
        samples.append(KrebsSample(series=series, outcomes=outcomes))
    size = len(NAMES)
    quiet = KrebsRun(error=np.zeros(size), sigma=np.ones(size), nees=0.0, iterations=3, converged=True)
    return KrebsStudy(
        runs=runs,
        seed=seed,
        samples=tuple(samples),
        independence=Independence(moved=1e-6 * np.ones((size, size)), sigma=np.full(size, 1e-3)),
        settings=tuple((setting, samples[0].outcomes[0]) for setting in SETTINGS),
        quiet=(quiet, quiet),
    )


def test_the_numbers_of_the_thesis_agree_with_themselves():
    assert len(NAMES) == 34
    assert NAMES[group_columns("B_g")][5] == "B_g yz"
    means = group_mean(stated_sigma(0))
    agree = {group.symbol: means[group.symbol] / group.table_5_3 for group in GROUPS if group.sigma}
    for symbol in ("p_cb", "M_a", "S_a", "S_g", "B_g"):
        assert agree[symbol] == pytest.approx(1, abs=2e-3), symbol
    assert agree["M_g"] == pytest.approx(0.003739 / 0.002456, rel=1e-3)  # mission: Table 5.3 contradicts B.1 there
    assert agree["q_cb"] < 0.4


def test_a_rig_senses_what_the_equations_of_document_b_say():
    scenario = replace(SCENARIO, duration_s=1.0, noise_factor=0.0, pixel_noise_px=0.0, earth_rate_latitude=None)
    simulation = simulate_camera_imu(scenario, 3)
    rig = KrebsRig(gravity=simulation.gravity_target, time_shift_s=0.05)
    recording = sense_motion(simulation, rig)
    motion = simulation.trajectory.path.at(simulation.trajectory.t_s).of(rig.T_cam_imu)
    R = motion.R_target_body[7]
    f = R.T @ (motion.acceleration[7] - rig.gravity)
    M_a = np.array([[1, 0, 0], [0.0052, 1, 0], [-0.0017, 0.0026, 1]])
    M_g = np.array([[1, 0, 0], [0.0035, 1, 0], [-0.0026, -0.0044, 1]])
    imu = recording.imus["imu0"]
    np.testing.assert_allclose(imu.accelerometer.values[7], np.diag(rig.S_a) @ M_a @ f + 0.491, rtol=1e-12)
    rate = np.diag(rig.S_g) @ M_g @ rig.C_bg.T @ motion.omega[7] + rig.B_g @ f + 0.02
    np.testing.assert_allclose(imu.gyroscope.values[7], rate, rtol=1e-9)
    moved = recording.cameras["cam0"].t_ns - simulation.recording.cameras["cam0"].t_ns
    assert set(moved.tolist()) == {round((0.007 - 0.05) * 1e9)}


def test_noise_is_scaled_and_motion_kept():
    first, second = (
        simulate_camera_imu(replace(SCENARIO, duration_s=2.0, noise_factor=factor), 5) for factor in (1.0, 0.1)
    )
    np.testing.assert_array_equal(first.trajectory.f_imu, second.trajectory.f_imu)
    errors = [one.recording.imus["imu0"].gyroscope.values - one.trajectory.omega_imu for one in (first, second)]
    np.testing.assert_allclose(errors[0], 10 * errors[1], atol=1e-12)


@pytest.mark.parametrize("symbol", ["p_cb", "q_bg", "B_g", "g_w"])
def test_one_parameter_of_a_rig_changes_alone(symbol):
    name = NAMES[group_columns(symbol)][1]
    before, after = KrebsRig(), change_parameter(KrebsRig(), name)
    different = [
        field for field in before.__slots__ if not np.array_equal(getattr(before, field), getattr(after, field))
    ]
    assert len(different) == 1
    step = np.abs(np.asarray(getattr(after, different[0])) - getattr(before, different[0]))
    factor = 2 if symbol == "q_bg" else 1  # a quaternion's vector part is half of the angle
    assert step.max() == pytest.approx(factor * CHANGES[symbol], rel=2e-3)


@pytest.fixture(scope="module")
def short_runs():
    drawn = run_seeds(0, 2)
    return [run_krebs(KrebsTask(seed=number, duration_s=12.0)) for number in drawn]


def test_a_run_finds_the_truth(short_runs):
    for run in short_runs:
        assert run.converged
        assert run.failure == ""
        assert np.abs(run.error / run.sigma).max() < 5
        assert 10 < run.nees < 80
    assert not np.array_equal(short_runs[0].error, short_runs[1].error)


def test_sigmas_of_gravity_follow_from_direction_and_magnitude(short_runs):
    across, along, ahead = short_runs[0].sigma[group_columns("g_w")]
    assert 0.3 < across / ahead < 3
    assert along < 0.05  # the weak prior about the stated magnitude


def test_a_change_moves_its_own_estimate_alone(short_runs):
    sigma = short_runs[0].sigma
    before, after = (
        run_krebs(KrebsTask(changed=name, noise_factor=0.0, pixel_noise_px=0.0, duration_s=12.0, seed=1))
        for name in ("", "M_g zy")
    )
    assert np.abs((after.error - before.error) / sigma).max() < 0.05


def test_a_basic_model_does_not_estimate_the_rest():
    run = run_krebs(KrebsTask(seed=1, duration_s=12.0, model="basic"))
    known = np.isfinite(run.sigma)
    assert [name for name, is_known in zip(NAMES, known, strict=True) if is_known] == [
        *("p_cb x", "p_cb y", "p_cb z", "q_cb i", "q_cb j", "q_cb k", "g_w x", "g_w y", "g_w z", "d"),
    ]


def test_a_recording_that_cannot_be_used_is_told():
    simulation = simulate_camera_imu(replace(SCENARIO, duration_s=0.5), 1)
    run = calibrated_run(simulation, KrebsRig(), replace(OPTIONS, pixel_sigma=0.3))
    assert run.failure
    assert not run.converged


def test_runs_can_be_kept_in_a_journal():
    task = SERIES[4].run(7, 90.0)
    records = Records(run_krebs, [task])
    run = KrebsRun(error=np.array([1.5, np.nan]), sigma=np.array([0.1, np.nan]), nees=float("nan"), iterations=3,
                   converged=False, failure="no")  # fmt: skip
    (back,) = records.read(records.written(run))
    np.testing.assert_array_equal(back.error, run.error)
    assert (back.iterations, back.converged, back.failure) == (3, False, "no")
    others = Records(run_krebs, [series.run(7, 90.0) for series in SERIES])
    assert len({others.key(k) for k in range(len(SERIES))}) == len(SERIES)


def test_claims_hold_where_document_b_is_true():
    for claim in krebs_claims(drawn_study(150)):  # as many as its large scatter of p_cb asks for
        assert claim.holds, claim


def test_few_recordings_tell_little():
    held = {claim.claim: claim.holds for claim in krebs_claims(drawn_study(6))}
    assert False not in held.values()
    too_few = [text for text, holds in held.items() if holds is None]
    for word in ("mean lies", "Earth's rate", "each sigma", "by 2 to 4", "follows", "extended model"):
        assert sum(word in text for text in too_few) == 1, word
    for word in ("converge", "Change one", "same size"):
        assert not any(word in text for text in too_few)
    basic = drawn_study(6)
    hidden = replace(basic.basic, outcomes=tuple(replace(o, error=0.05 * (-1) ** k + 0.1 * o.error)
                                                 for k, o in enumerate(basic.basic.outcomes)))  # fmt: skip
    samples = (*basic.samples[:3], hidden, *basic.samples[4:])
    held = {claim.claim: claim.holds for claim in krebs_claims(replace(basic, samples=samples))}
    assert [holds for text, holds in held.items() if "biases p_cb" in text] == [None]


@pytest.mark.parametrize(
    ("word", "series", "symbol", "worse"),
    [
        ("Tables B.1", 1, "S_g", lambda e: 2 * e),
        ("same size", 2, "M_a", lambda e: e / 9),
        ("mean lies", 0, "d", lambda e: e + 2e-3),
        ("Earth's rate", 2, "B_g", lambda e: e + 4e-5),
        ("each sigma", 0, "B_g", lambda e: 3 * e),
        ("by 2 to 4", 2, "p_cb", lambda e: e / 20),
        ("follows", 6, "p_cb", lambda e: 20 * e),
        ("biases p_cb", 3, "p_cb", lambda e: e - e.mean(axis=0)),
    ],
)
def test_claims_fail_where_it_is_not(word, series, symbol, worse):
    study = drawn_study()
    errors = study.samples[series].errors.copy()
    errors[:, group_columns(symbol)] = worse(errors[:, group_columns(symbol)])
    outcomes = tuple(replace(run, error=e) for run, e in zip(study.samples[series].outcomes, errors, strict=True))
    samples = list(study.samples)
    samples[series] = replace(samples[series], outcomes=outcomes)
    found = {claim.claim: claim.holds for claim in krebs_claims(replace(study, samples=tuple(samples)))}
    assert [holds for claim, holds in found.items() if word in claim] == [False]


def test_the_page_shows_tables_and_figures():
    study = drawn_study()
    html = render_page(krebs_page(study)).decode()
    page = Page(html)
    assert html.count('<svg class="plot"') == 4
    assert "nan" not in page.text.split()
    assert all(link.startswith(("#", "data:")) for link in page.links)
    for name in (*NAMES, "6.855", "14.35", "2.456"):  # Tables 5.2 and 5.3, in thousandths
        assert name in page.text


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)
@pytest.mark.parametrize(("width", "mobile", "scheme"), [(1440, False, "light"), (390, True, "dark")])
def test_the_page_fits_any_screen(tmp_path, width, mobile, scheme):
    path = tmp_path / "study.html"
    path.write_bytes(render_page(krebs_page(drawn_study())))
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(path, width=width, height=900, mobile=mobile, scheme=scheme)
        seen = browser.evaluate(MEASURE)
        assert browser.problems() == []
        assert seen["scroll"] <= seen["client"]
        assert len(seen["plots"]) == 4
        assert all(left >= 0 and right <= width for left, right, _ in seen["plots"])
        assert seen["text"] >= 9
    finally:
        browser.close()


def test_tables_are_whole_csv_files():
    study = drawn_study(runs=5)
    found = {table.name: list(csv.DictReader(StringIO(table.csv()))) for table in krebs_tables(study)}
    assert set(found) == {"claims", "parameters", "table_5_3", "runs", "independence", "settings"}
    assert len(found["runs"]) == 5 * len(SERIES)
    assert len(found["parameters"]) == len(NAMES) * len(SERIES)
    assert float(found["parameters"][2]["sigma_thesis"]) == 6.855e-3
    assert float(found["runs"][0]["error p_cb x [m]"]) == study.samples[0].outcomes[0].error[0]


def test_every_run_comes_into_its_series(monkeypatch):
    def told(number):
        values = np.full(len(NAMES), float(number))
        return KrebsRun(error=values, sigma=values, nees=number, iterations=1, converged=True)

    settings = [setting.task for setting in SETTINGS]

    def run(task):
        if task.weighed_as < 1:
            return told(task.earth_rate)
        if task.noise_factor == 0:
            return told(1 + NAMES.index(task.changed or NAMES[0]))
        own = replace(task, seed=0)
        return told(settings.index(own) if own in settings[1:] else task.seed * (task.model == "full"))

    monkeypatch.setattr("gnomon.study.krebs.run_krebs", run)
    study = study_krebs(runs=3, seed=4)
    for sample in study.samples:
        expected = [0, 0, 0] if sample is study.basic else run_seeds(4, 3)
        np.testing.assert_array_equal(sample.errors[:, 0], np.array(expected, dtype=np.float64))
    np.testing.assert_array_equal(study.independence.moved[:, 0], np.arange(len(NAMES)))
    assert [run.nees for _, run in study.settings] == [run_seeds(4, 1)[0], *range(1, len(SETTINGS))]
    assert [run.nees for run in study.quiet] == [1, 0]


def test_a_study_needs_results(monkeypatch):
    from gnomon.errors import SolveError

    nothing = KrebsRun(error=np.full(34, np.nan), sigma=np.full(34, np.nan), nees=0.0, iterations=0, converged=False,
                       failure="too short")  # fmt: skip
    monkeypatch.setattr("gnomon.study.krebs.run_krebs", lambda _: nothing)
    with pytest.raises(SolveError, match="too short"):
        study_krebs(runs=2)
