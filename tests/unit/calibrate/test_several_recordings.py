"""Several recordings of one sensor: joined as recordings, with what the sensor itself changes between them."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.needs import needs_of_use
from gnomon.errors import OptionError, RecordingError
from gnomon.estimate.trust.between_recordings import RecordingBlock, join_estimates
from gnomon.formats.own.calibration_file import load
from gnomon.formats.own.calibration_text import save
from gnomon.options.requirements import BETWEEN_RECORDINGS, USES
from gnomon.readers.recordings import read_several
from gnomon.recording import ImuSamples, Recording, Source, TriadSamples
from gnomon.report.page import write_report
from gnomon.results.result import save_diagnostics
from html_page import Page

OPTIONS = gnomon.ImuOptions(gravity=9.80665)
BIASES = ("imu0.accelerometer.bias", "imu0.gyroscope.bias")
TURN_ON = np.array([0.04, 0.003])


def recorded(seed: int, **scenario) -> Recording:
    """Return a recording of one sensor, whose biases are others each time."""
    made, _ = gnomon.simulate(
        gnomon.Scenario(**({"intervals": 16, "t_init_s": 20.0, "sensor_seed": 7} | scenario)), seed
    )
    return shifted(made, np.random.default_rng(seed).normal(0, TURN_ON[:, None], (2, 3)))


def shifted(recording: Recording, by) -> Recording:
    imu = recording.imus["imu0"]

    def moved(triad: TriadSamples, offset) -> TriadSamples:
        return TriadSamples(t_ns=triad.t_ns, values=triad.values + offset, unit=triad.unit)

    samples = ImuSamples(accelerometer=moved(imu.accelerometer, by[0]), gyroscope=moved(imu.gyroscope, by[1]))
    return replace(recording, imus={"imu0": samples})


def as_csv(recording: Recording, path):
    imu = recording.imus["imu0"]
    table = np.column_stack([imu.accelerometer.t_s, imu.accelerometer.values, imu.gyroscope.values])
    np.savetxt(path, table, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="", fmt="%.7f")
    return path


@pytest.fixture(scope="module")
def recordings():
    return [recorded(seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def joined(recordings):
    return gnomon.calibrate_imu(recordings, OPTIONS)


@pytest.mark.parametrize("count", [2, 3, 6])
@pytest.mark.parametrize("times_usual", [0.3, 1.0, 5.0])
def test_the_next_recording_is_foretold(count, times_usual):
    rng = np.random.default_rng(count)
    blocks = [RecordingBlock(index=np.arange(3), usual=1.0), RecordingBlock(index=np.arange(3, 6), usual=0.2)]
    between = times_usual * np.repeat([1.0, 0.2], 3)
    within = np.diag([0.1] * 6) + 0.02
    z = []
    for _ in range(60):
        values = rng.normal(0, between, (count + 1, 6)) + rng.multivariate_normal(np.zeros(6), within, count + 1)
        found = join_estimates(values[1:], np.array([within] * count), blocks)
        z.append((values[0] - found.mean) / np.sqrt(np.diag(found.covariance + within)))
    z_rms = np.sqrt(np.mean(np.square(z)))
    # the prior leans on what is usual: too wide where the sensor is better, a little narrow where it is far worse
    assert (0.2 if times_usual < 1 else 0.5) < z_rms < (1.75 if (count, times_usual) == (2, 5.0) else 1.3)


def test_recordings_that_say_little_gain_from_each_other():
    within = np.array([np.eye(3)] * 4)
    found = join_estimates(
        np.random.default_rng(1).normal(0, 1, (4, 3)), within, [RecordingBlock(index=np.arange(3), usual=0.1)]
    )
    assert (np.sqrt(np.diag(found.covariance)) < 0.75).all()
    assert (np.sqrt(np.diag(found.mean_covariance)) > 0.5).all()


def test_turn_on_biases_are_in_the_sigmas(recordings, joined):
    calibration = joined.calibration
    note = calibration.assessment.trust
    assert (note.recordings, note.covariance) == (3, "between-recordings")
    for path, spread in zip(BIASES, TURN_ON, strict=True):
        assert (calibration.sigma(path) > 0.5 * spread).all()
        alone = np.array([gnomon.calibrate_imu(one, OPTIONS).calibration.parameter(path) for one in recordings[:2]])
        assert (np.abs(calibration.parameter(path) - alone).max(axis=0) < 4 * calibration.sigma(path)).all()
    fresh = gnomon.calibrate_imu(recorded(9), OPTIONS).calibration
    for path in ("imu0.accelerometer.sensitivity", "imu0.gyroscope.sensitivity", *BIASES):
        known = calibration.sigma(path) > 0
        sigma = np.hypot(calibration.sigma(path), fresh.sigma(path))[known]
        assert np.abs((calibration.parameter(path) - fresh.parameter(path))[known] / sigma).max() < 4


def test_a_joined_result_is_written_read_and_drawn(joined, tmp_path):
    save(joined.calibration, tmp_path / "calibration.yaml")
    again = load(tmp_path / "calibration.yaml")
    assert "schema: gnomon/1.6" in (tmp_path / "calibration.yaml").read_text()
    note, before = again.assessment.trust, joined.calibration.assessment.trust
    assert (note.covariance, note.recordings, note.between) == (before.covariance, 3, before.between)
    write_report(joined, tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text()).text
    assert "What changes between recordings" in page
    assert "recording 3" in page
    save_diagnostics(joined.diagnostics, tmp_path / "diagnostics.npz")
    with np.load(tmp_path / "diagnostics.npz") as arrays:
        assert arrays["recordings.2.values"].shape == arrays["mean"].shape


def test_what_one_recording_cannot_know_is_a_floor_that_several_measure(recordings, joined):
    single = gnomon.judge(gnomon.calibrate_imu(recordings[0], OPTIONS).calibration, "vio")
    floors = {need.block: need.floor for need in single.assessment.trust.needs}
    assert floors["accelerometer bias"] == pytest.approx(1e3 * BETWEEN_RECORDINGS["accelerometer_bias"])
    assert "use-turn-on" in [finding.code for finding in single.assessment.findings]
    assert next(n for n in single.assessment.trust.needs if n.block == "accelerometer bias").verdict == "pass"
    assert {need.floor for need in needs_of_use(joined.calibration, USES["vio"])} == {0.0}
    fine = replace(USES["vio"], needs={"gyroscope_scale": 0.8 * BETWEEN_RECORDINGS["gyroscope_scale"]})
    (need,) = needs_of_use(gnomon.calibrate_imu(recordings[0], OPTIONS).calibration, fine)
    assert need.sigma < need.needed
    assert need.verdict == "warn"
    assert "Join several recordings" in need.cure


def test_what_does_not_fit_several_recordings_is_refused(recordings, joined):
    for options, prior in (
        (replace(OPTIONS, preset="tedaldi2014"), None),
        (OPTIONS, joined.calibration),
        (replace(OPTIONS, prior=("imu0.gyroscope.bias=0.1",)), None),
        (replace(OPTIONS, frame="x=3 y=12 z=-7"), None),
    ):
        with pytest.raises(OptionError):
            gnomon.calibrate_imu(recordings, options, prior=prior)
    poses = replace(
        recordings[1],
        imus={
            "imu0": replace(
                recordings[1].imus["imu0"],
                gyroscope=TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s"),
            )
        },
    )
    with pytest.raises(RecordingError, match="different things"):
        gnomon.calibrate_imu([recordings[0], poses], OPTIONS)


def test_no_recording_is_said():
    with pytest.raises(OptionError, match="no recording"):
        gnomon.calibrate_imu([])


def test_another_sensor_is_named(recordings):
    other = recorded(4, sensor_seed=8)
    with pytest.raises(RecordingError, match=r"not of one sensor.*recording 4 against the others"):
        gnomon.calibrate_imu([*recordings, other], OPTIONS)


def test_an_accelerometer_alone_is_joined_too(recordings):
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s")
    alone = [replace(one, imus={"imu0": replace(one.imus["imu0"], gyroscope=nothing)}) for one in recordings[:2]]
    found = gnomon.calibrate_imu(alone, OPTIONS).calibration
    assert found.imus["imu0"].gyroscope is None
    assert set(found.assessment.trust.between) == {
        "accelerometer_scale",
        "accelerometer_misalignment",
        "accelerometer_bias",
    }


def test_files_are_told_apart_by_content(recordings, tmp_path):
    whole = [as_csv(one, tmp_path / f"run{i}.csv") for i, one in enumerate(recordings, 1)]
    assert len(read_several(*whole)) == 3
    assert len(read_several(*whole[:2])) == 2
    imu = recordings[0].imus["imu0"]
    halves = []
    for name, triad in (("first", imu.accelerometer), ("second", imu.gyroscope)):
        halves.append(tmp_path / f"{name}.csv")
        np.savetxt(halves[-1], np.column_stack([triad.t_s, triad.values]), delimiter=",", fmt="%.7f")
    (pair,) = read_several(*halves)
    assert len(pair.imus["imu0"].gyroscope) == len(imu.gyroscope)
    poses = []
    for i in range(4):
        poses.append(tmp_path / f"pose{i}.csv")
        rows = slice(2100 + 600 * i, 2200 + 600 * i)
        table = np.column_stack([imu.accelerometer.t_s, imu.accelerometer.values, imu.gyroscope.values])[rows]
        np.savetxt(poses[-1], table, delimiter=",", header="t,ax,ay,az,gx,gy,gz", comments="", fmt="%.7f")
    (of_poses,) = read_several(*poses)
    assert len(of_poses.pieces) == 4


def test_a_comparison_of_different_recordings_counts_what_the_sensor_changes(recordings):
    def of(recording, *hashes):
        sources = tuple(Source(name=f"{h}.csv", sha256=h * 64) for h in hashes)
        settings = Source(name="imu.yaml", sha256="0" * 64)  # the same of all: no recording
        return gnomon.calibrate_imu(replace(recording, sources=(*sources, settings)), OPTIONS).calibration

    first, again, other = of(recordings[0], "a"), of(recordings[0], "a"), of(recordings[1], "b")
    apart, same = gnomon.compare(first, other), gnomon.compare(first, again)
    assert [one.one_occasion for one in apart.calibrations] == [True, True]
    assert not any(one.one_occasion for one in same.calibrations)
    for path, usual in (("accelerometer.scale", "accelerometer_scale"), ("gyroscope.bias", "gyroscope_bias")):
        (wide,) = [item for item in apart.differences if item.path == f"imu0.{path}"]
        (narrow,) = [item for item in same.differences if item.path == f"imu0.{path}"]
        floor = np.sqrt(2) * BETWEEN_RECORDINGS[usual]
        assert (wide.sigmas > 0.99 * floor).all()
        assert (narrow.sigmas < 0.9 * floor).all()
    codes = [finding.code for finding in apart.findings]
    assert "different-recordings" in codes
    assert "same-recording" not in codes
    assert "same-recording" in [finding.code for finding in same.findings]
