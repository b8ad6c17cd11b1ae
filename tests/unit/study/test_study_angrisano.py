"""The study of Angrisano, small; `pytest -m slow` runs it whole (tests/e2e/test_study_angrisano.py)."""

import csv
import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from gnomon.cli.commands.study import PAGE, Study
from gnomon.cli.terminal import Terminal
from gnomon.errors import OptionError, OutputError
from gnomon.estimate.triads.angrisano import fit_magnitudes
from gnomon.estimate.triads.triad import fit_triad
from gnomon.models.angrisano import AngrisanoTriad
from gnomon.report.page import render_page
from gnomon.report.studies.angrisano import angrisano_page
from gnomon.simulate import PoseScenario, simulate_poses
from gnomon.study.angrisano import SETTINGS, angrisano_claims, angrisano_group_rms, angrisano_tables, study_angrisano
from gnomon.study.angrisano_trial import (
    DATASHEET,
    TABLE_2,
    TRUTH,
    AngrisanoTrial,
    Basin,
    as_angrisano,
    drawn_start,
    pose_means,
    run_angrisano_trial,
    start_offsets,
)
from gnomon.study.runs import Workers, carry_out
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser
from html_page import Page

CUT_OFF = """(() => [...document.querySelectorAll("svg.plot")].flatMap((plot) => {
  const box = plot.getBoundingClientRect();
  return [...plot.querySelectorAll("text:not(.fine text)")].map((text) => [text, text.getBoundingClientRect()])
    .filter(([, b]) => b.width > 0 && Math.max(box.left - b.left, b.right - box.right, b.bottom - box.bottom) > 2)
    .map(([text]) => text.textContent);
}))()"""
"""Texts of figures that lie outside of their figure, where they cannot be read."""


@pytest.fixture(scope="module")
def small():
    return study_angrisano(runs=4, scans=1)


def test_every_claim_holds_but_for_what_few_runs_can_tell(small):
    found = {claim.claim: claim.holds for claim in angrisano_claims(small)}
    assert [text for text, holds in found.items() if holds is False] == []
    assert [text.split()[-1] for text, holds in found.items() if holds is None] == ["scatter", "scatter", "(C7)"]


def test_table_1_follows_from_its_noise(small):
    for sample in small.samples[:2]:
        stated = np.repeat(sample.setting.table_1, 3)
        np.testing.assert_array_less(np.abs(np.log(sample.sigma("paper") / stated)), np.log(2))


def test_both_methods_find_the_truth(small):
    for sample in small.samples:
        for method in ("paper", "ours"):
            z = (sample.stacked(method) - TRUTH) / sample.stacked(f"{method}_sigma")
            assert np.abs(z).max() < 6
            assert 0.4 < np.sqrt(np.mean(z**2)) < 2
        roughly_known = angrisano_group_rms(sample.scatter("components"))
        assert (roughly_known > 10 * angrisano_group_rms(sample.scatter("paper"))).all()


def test_document_c_needs_a_good_start_and_gnomon_none(small):
    for group, (low, high) in enumerate(TABLE_2):
        below, above = small.interval(group, "paper")
        assert 0.5 * abs(low) < abs(below) < 2.5 * abs(low)
        assert 0.5 * high < above < 2.9 * high
        np.testing.assert_allclose(small.interval(group, "ours"), 3 * TABLE_2[group])
    datasheet, inside, outside = (journey.fit for journey in small.journeys)
    assert datasheet.iterations in (4, 5)
    assert datasheet.converged
    assert inside.converged
    assert inside.iterations > datasheet.iterations
    assert not outside.converged
    for journey in small.journeys:
        np.testing.assert_allclose(journey.ours, small.journeys[0].ours, rtol=1e-4)


def test_a_run_depends_on_its_seed_alone():
    trials = [AngrisanoTrial(scenario=SETTINGS[1].scenario, seed=seed) for seed in (5, 6)]
    alone, shared = (
        [run_angrisano_trial(trial) for trial in trials],
        carry_out(run_angrisano_trial, trials, workers=Workers(jobs=2)),
    )
    for a, b in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(a.ours, b.ours)
        np.testing.assert_array_equal(a.paper, b.paper)
        assert a.status == b.status
    assert np.abs(alone[0].ours - alone[1].ours).max() > 0


def test_gnomons_result_in_the_letters_of_document_c():
    simulation = simulate_poses(PoseScenario(attitude_error_deg=10.0), seed=8)
    fit = fit_triad(pose_means(simulation))
    X, covariance = as_angrisano(fit)
    f = AngrisanoTriad.from_parameters(X).correction @ (simulation.accelerometer - X[3:6]).T
    np.testing.assert_allclose(
        np.linalg.norm(f, axis=0), np.linalg.norm(fit.physical(simulation.accelerometer), axis=1)
    )
    theirs = fit_magnitudes(simulation.accelerometer, 9.80665, DATASHEET)
    assert np.abs((X - theirs.parameters) / theirs.sigma).max() < 0.3
    alike = (covariance / theirs.covariance)[np.abs(theirs.covariance) > 0.3 * np.outer(theirs.sigma, theirs.sigma)]
    assert alike.std() / alike.mean() < 0.1  # whatever sigma_0 either method states


def test_starts_are_drawn_in_the_widened_intervals_with_positive_scales():
    rng = np.random.default_rng(0)
    starts = np.array([drawn_start(rng, 3.0) for _ in range(500)])
    assert (starts[:, 6:] > 0).all()
    bias = starts[:, 3:6] - DATASHEET[3:6]
    assert -4500 <= bias.min() < -4000
    assert 7000 < bias.max() <= 7500
    assert np.abs(starts[:, :3]).max() <= 3 * np.radians(19) + 1e-12


def test_the_interval_of_a_basin_ends_at_the_first_failure():
    offset = start_offsets(1, 3.0)
    found = (offset > -2000) & (offset < 3000)
    found[0] = True  # beyond the failures
    basin = Basin(group="biases", offset=offset, paper=found, printed=found, ours=np.ones(13, dtype=bool))
    below, above = basin.interval(basin.paper)
    assert below == offset[offset > -2000].min()
    assert above == offset[offset < 3000].max()
    assert basin.interval(basin.ours) == (-4500.0, 7500.0)


def test_the_page_shows_tables_and_figures(small):
    html = render_page(angrisano_page(small)).decode()
    page = Page(html)
    assert html.count('<svg class="plot"') == 4
    assert "nan" not in page.text.split()
    assert all(link.startswith(("#", "data:")) for link in page.links)
    for setting in SETTINGS:
        assert setting.name[1:] in page.text


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)
@pytest.mark.parametrize(("width", "mobile", "scheme"), [(1440, False, "light"), (390, True, "dark")])
def test_the_page_fits_any_screen(small, tmp_path, width, mobile, scheme):
    path = tmp_path / "study.html"
    path.write_bytes(render_page(angrisano_page(small)))
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(path, width=width, height=900, mobile=mobile, scheme=scheme)
        seen = browser.evaluate(MEASURE)
        assert browser.problems() == []
        assert seen["scroll"] <= seen["client"]
        assert len(seen["plots"]) == 4
        assert all(left >= 0 and right <= width for left, right, _ in seen["plots"])
        assert seen["text"] >= 9
        assert browser.evaluate(CUT_OFF) == []
    finally:
        browser.close()


def test_a_claim_that_fails_is_a_warning(small):
    outcomes = tuple(replace(outcome, iterations=9) for outcome in small.samples[0].outcomes)
    worse = replace(small, samples=(replace(small.samples[0], outcomes=outcomes), *small.samples[1:]))
    page = angrisano_page(worse)
    assert page.verdict == "warn"
    assert page.headline == "5 of 9 claims hold; 3 cannot be told from so few runs."
    assert angrisano_page(small).headline == "6 of 9 claims hold; 3 cannot be told from so few runs."


def test_tables_are_whole_csv_files(small):
    found = {table.name: list(csv.DictReader(StringIO(table.csv()))) for table in angrisano_tables(small)}
    assert set(found) == {"claims", "parameters", "runs", "starts", "iterations"}
    assert len(found["runs"]) == 12
    assert len(found["parameters"]) == 27
    first = small.samples[0].outcomes[0]
    assert float(found["runs"][0]["paper bias x [count]"]) == first.paper[3]
    assert float(found["parameters"][0]["truth"]) == TRUTH[0]


def run(monkeypatch, small, capsys, *, as_json=False, **options):
    monkeypatch.setattr("gnomon.study.angrisano.study_angrisano", lambda **_: small)
    terminal = Terminal(as_json=as_json)
    code = Study(name="angrisano", **options).run(terminal)
    terminal.close()
    return code, capsys.readouterr().out


def test_the_command_writes_a_folder_and_says_what_holds(small, monkeypatch, capsys, tmp_path):
    code, out = run(monkeypatch, small, capsys, output=tmp_path / "out")
    assert code == 0
    assert out.count("holds  ") == sum(claim.holds is True for claim in angrisano_claims(small)) == 6
    assert out.count("too few runs to tell: ") == 3
    assert str(tmp_path / "out" / PAGE) in out
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {PAGE, "claims.csv", "parameters.csv", "runs.csv", "starts.csv", "iterations.csv"}


def test_the_command_speaks_json(small, monkeypatch, capsys, tmp_path):
    _, out = run(monkeypatch, small, capsys, output=tmp_path / "out", as_json=True)
    document = json.loads(out)
    assert document["study"] == "angrisano"
    assert [claim["holds"] for claim in document["claims"]] == [None, None, True, True, None, True, True, True, True]
    assert document["files"]["runs"].endswith("runs.csv")


def test_nothing_is_written_where_the_study_fails(monkeypatch, tmp_path):
    def broken(**_):
        raise OptionError("no")

    monkeypatch.setattr("gnomon.study.angrisano.study_angrisano", broken)
    with pytest.raises(OptionError):
        Study(name="angrisano", output=tmp_path / "out").run(Terminal(as_json=False))
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        Study(name="angrisano", output=tmp_path / "file").run(Terminal(as_json=False))


@pytest.mark.parametrize(("options", "word"), [({"runs": 1}, "runs 1"), ({"jobs": 0}, "jobs 0")])
def test_impossible_options_are_refused(options, word):
    with pytest.raises(OptionError, match=word):
        Study(name="angrisano", **options)
