"""Faults of a line are named, a healthy line is left alone."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fleet_line import BETWEEN, SIGMA, SPREAD, healthy_line
from gnomon.fleet.entries import line_table
from gnomon.fleet.line import assess_line
from gnomon.report.library import _gauge_studies, line_page
from gnomon.report.page import render_page


def named(line):
    return [(finding.code, finding.message) for finding in assess_line(line_table(line)).findings]


def with_added(entry, what, size):
    add = np.zeros(12)
    add[what] = size
    return replace(entry, values=entry.values + add)


def swapped(line):
    line[-1], line[-2] = (replace(line[-1], serial=line[-2].serial), replace(line[-2], serial=line[-1].serial))
    return line


def scaled(entry, what, factor):
    values = entry.values.copy()
    values[what] *= factor
    return replace(entry, values=values)


def one(k, change):
    return lambda line: [change(entry) if index == k else entry for index, entry in enumerate(line)]


def each(change):
    return lambda line: [change(k, entry) for k, entry in enumerate(line)]


FAULTS = {
    "step": ("line-step", "", each(lambda k, e: with_added(e, 6, 1.1 * SPREAD[6] * (k >= 120)))),
    "step of a bias": ("line-step", "bias[1]", each(lambda k, e: with_added(e, 4, 2 * SPREAD[4] * (k >= 60)))),
    "drift": ("line-drift", "", each(lambda k, e: with_added(e, 9, 2 * SPREAD[9] * min(k, 200) / 200))),
    "drift of a scale": ("line-drift", "", each(lambda k, e: with_added(e, 0, 3 * SPREAD[0] * min(k, 200) / 200))),
    "station": ("line-station", "Station C", each(lambda k, e: with_added(e, 1, 0.9 * SPREAD[1] * (e.station == "C")))),
    "station's bias": ("line-station", "Station A", each(lambda k, e: with_added(e, 3, 0.12 * (e.station == "A")))),
    "station by repeats": ("line-station", "Station B", each(lambda k, e: with_added(e, 4, 0.02 * (e.station == "B")))),
    "swapped": ("line-swapped", "exchanged", swapped),
    "mistaken": ("line-swapped", "looks like", lambda line: [*line[:-1], replace(line[-1], serial=line[-2].serial)]),
    "g for m/s^2": ("line-unit", "g in m/s^2", one(9, lambda e: scaled(e, slice(0, 3), 9.80665))),
    "m/s^2 for g": ("line-unit", "m/s^2 in g", one(19, lambda e: scaled(e, slice(0, 3), 1 / 9.80665))),
    "deg/s for rad/s": ("line-unit", "deg/s in rad/s", one(29, lambda e: scaled(e, slice(6, 9), 180 / np.pi))),
    "rad/s for deg/s": ("line-unit", "rad/s in deg/s", one(30, lambda e: scaled(e, slice(6, 9), np.pi / 180))),
    "milli": ("line-unit", "thousandths", one(31, lambda e: scaled(e, slice(0, 3), 1e3))),
    "copied file": ("line-duplicate", "SN7", lambda line: [*line, replace(line[3], serial="SN7")]),
    "same numbers": ("line-duplicate", "SN", lambda line: [*line, replace(line[3], serial="SN7", inputs=())][3:]),
    "gravity": ("line-gravity", "9.78", one(40, lambda e: replace(scaled(e, slice(0, 3), 1.002), gravity=9.787))),
    "gravity of two": (
        "line-gravity", "2 of",
        each(lambda k, e: replace(e, station="A", gravity=9.8 if k in (151, 152) else e.gravity)),
    ),
    "knocked": ("line-moved", "SN00", each(lambda k, e: with_added(e, 10, 12 * BETWEEN[10] * (k == 210)))),
    "bias jumped": ("line-moved", "bias", each(lambda k, e: with_added(e, 5, 15 * BETWEEN[5] * (k == 215)))),
    "unlike": ("line-outlier", "SN00050", one(50, lambda e: with_added(e, 8, 8 * SPREAD[8]))),
    "sign": ("line-outlier", "SN00060", one(60, lambda e: scaled(e, 2, -1))),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_line_are_named_alone(fault):
    code, words, change = FAULTS[fault]
    line = healthy_line(200, 100 + list(FAULTS).index(fault), again=40, stations=("A", "B", "C"))
    if fault == "same numbers":
        line = [replace(entry, inputs=()) for entry in line]
    found = named(change(line))
    assert {name for name, _ in found} == {code}
    assert all(words in message for _, message in found), found
    assert len(found) <= 2, found


def test_a_healthy_line_raises_no_alarm():
    assert [named(healthy_line(150, seed, again=30)) for seed in range(6)] == [[]] * 6


def test_what_a_line_tells_is_what_it_was_made_with():
    found = assess_line(line_table(healthy_line(600, 3, again=200)))
    spread = np.array([one.spread for one in found.populations])
    np.testing.assert_allclose(spread, np.hypot(SPREAD, BETWEEN), rtol=0.15)
    well = BETWEEN > SIGMA  # else the sigmas hide it
    np.testing.assert_allclose(found.reproducibility[well], BETWEEN[well], rtol=0.15)
    assert (len(found.first), found.repeats) == (600, 200)


def test_few_devices_tell_nothing_and_raise_nothing():
    for count in (0, 1, 2, 5):
        assert named(healthy_line(count, 1)) == []


def test_the_report_of_a_line_says_all_of_it_and_stays_small():
    line = healthy_line(120, 8, again=30)
    line[5] = with_added(line[5], 8, 9 * SPREAD[8])
    line = [replace(entry, serial="<script>x</script>") if entry.serial == "SN00005" else entry for entry in line]
    page = line_page(assess_line(line_table(line)))
    assert page.front[0].rows[0][5] == "–"  # sigmas that are equal but for rounding have no spread, and no Cpk
    small = render_page(page)
    text = small.decode()
    assert "<script>x" not in text
    assert "&lt;script&gt;x&lt;/script&gt; is unlike the others" in text
    assert "gyroscope scale" in text
    assert "limits of individuals" in text
    assert text.count('<svg class="plot"') == 6
    large = render_page(line_page(assess_line(line_table(healthy_line(1200, 8, again=30)))))
    assert len(large) < 3 * len(small) < 5e5  # points are thinned


def test_devices_measured_twice_at_every_station_make_a_gauge_study():
    rng = np.random.default_rng(4)
    truth = {k: healthy_line(1, 50 + k)[0] for k in range(8)}
    noise = 0.3 * SPREAD
    line = []
    for number, (k, station, turn) in enumerate(itertools.product(range(8), "AB", range(2))):
        add = noise * rng.normal(size=12)
        more = {"serial": f"SN{k}", "station": station, "inputs": (("r.csv", f"{number:064x}"),)}
        line.append(replace(truth[k], values=truth[k].values + add, measured=f"2026-01-0{1 + turn}", **more))
    studies = _gauge_studies(assess_line(line_table(line)))
    share = np.array([study.share for study in studies.values()])
    assert len(share) == 12
    assert 0.15 < np.median(share) < 0.5  # 0.3 / hypot(1, 0.3) is 0.29
