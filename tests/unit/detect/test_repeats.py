"""The same data twice: in one file, in two recordings, as a prior, as a lens."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import gnomon
from gnomon.assess.checks.signals import check_signal
from gnomon.detect.samples.faults import RepeatWatch, repeated_stretches
from gnomon.errors import OptionError, RecordingError
from gnomon.recording import ImuSamples, Recording, Source, TriadSamples
from gnomon.recording.recording import same_measurements, sample_fingerprint

OPTIONS = gnomon.ImuOptions(gravity=9.80665)


def noise(count, seed=0, step=0.0):
    values = np.random.default_rng(seed).normal(0, 1, (count, 3))
    return step * np.rint(values / step) if step else values


def triad(values, rate_hz=100.0):
    return TriadSamples(t_ns=np.arange(len(values)) * int(1e9 / rate_hz), values=values, unit="m/s^2")


@pytest.fixture(scope="module")
def simulated():
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=16, t_init_s=20.0, sensor_seed=7), 1)
    return recording


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_copies_are_found_where_they_are(step):
    values = noise(3000, step=step)
    appended = np.vstack([values, values[1000:1400]])
    (found,) = repeated_stretches(appended)
    assert abs(found.first - 1000) <= 2
    assert abs(found.second - 3000) <= 2
    assert abs(found.second_stop - 3400) <= 2
    (whole,) = repeated_stretches(np.vstack([values, values]))
    assert (whole.first, whole.second, whole.second_stop) == (0, 3000, 6000)
    (between,) = repeated_stretches(values[:2000], values[1500:])
    assert (between.first, between.first_stop, between.second) == (1500, 2000, 0)


@pytest.mark.parametrize("decimals", [9, 4, 3])
def test_copies_with_other_decimals_are_found(decimals):
    values = noise(3000)
    copy = np.round(values[1000:2000], decimals)
    assert sum(one.second_stop - one.second for one in repeated_stretches(np.vstack([values, copy]))) > 900
    (between,) = repeated_stretches(values, copy)
    assert abs(between.first - 1000) <= 1
    watch = RepeatWatch()
    for start in range(0, 4000, 500):
        watch.add(np.vstack([values, copy])[start : start + 500], np.arange(start, start + 500) * 0.01)
    assert len(watch.copies()[0])


def test_copies_are_found_behind_a_block_in_which_nothing_changes():
    values, still = 0.02 * noise(1500), np.zeros((500, 3))  # rad/s of a sensor that starts late
    watch = RepeatWatch()
    for k, block in enumerate([still, *np.split(np.vstack([values, values]), 6)]):
        watch.add(block, (500 * k + np.arange(500)) * 0.01)
    assert len(watch.copies()[0])


def test_samples_that_were_held_are_found_too():
    values = np.repeat(noise(500), 5, axis=0)  # a slow sensor in a fast log
    (found,) = repeated_stretches(np.vstack([values, values[500:1500]]))
    assert (found.first, found.second) == (500, 2500)


@pytest.mark.parametrize("sigma", [0.0, 0.2, 0.5, 1.0, 3.0])
def test_coarse_noise_at_rest_is_no_copy(sigma):
    values = np.rint(np.random.default_rng(3).normal(0, sigma, (200_000, 3))) + np.array([0.0, 0.0, 981.0])
    assert repeated_stretches(values) == []


@pytest.mark.parametrize(("count", "severity"), [(30, None), (80, "warning"), (1000, "problem")])
def test_the_doctor_names_copies_by_their_share(count, severity):
    values = noise(10_000)
    findings = [
        f for f in check_signal(triad(np.vstack([values, values[:count]])), "imu0") if f.code == "data-repeated"
    ]
    assert [finding.severity for finding in findings] == ([] if severity is None else [severity])


def appended_to_itself(recording: Recording) -> Recording:
    imu = recording.imus["imu0"]

    def twice(samples: TriadSamples) -> TriadSamples:
        later = samples.t_ns + samples.t_ns[-1] - samples.t_ns[0] + 10_000_000
        return replace(
            samples,
            t_ns=np.concatenate([samples.t_ns, later]),
            values=np.concatenate([samples.values, samples.values]),
        )

    samples = replace(imu, accelerometer=twice(imu.accelerometer), gyroscope=twice(imu.gyroscope))
    return replace(recording, imus={"imu0": samples})


def test_a_recording_appended_to_itself_is_refused(simulated):
    with pytest.raises(RecordingError, match="once more"):
        gnomon.calibrate_imu(appended_to_itself(simulated), OPTIONS)
    rests = replace(OPTIONS, model="static")
    with pytest.raises(RecordingError, match="once more"):
        gnomon.calibrate_imu(appended_to_itself(simulated), rests)


def test_two_recordings_that_share_samples_are_refused(simulated):
    imu = simulated.imus["imu0"]
    part = {
        name: replace(samples, t_ns=samples.t_ns[500:], values=samples.values[500:])
        for name, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
    }
    later = replace(simulated, imus={"imu0": replace(imu, **part)})
    with pytest.raises(RecordingError, match=r"recording 1 and recording 2 share \d+ samples"):
        gnomon.calibrate_imu([simulated, later], OPTIONS)
    named = replace(simulated, sources=(Source(name="a.csv", sha256="a" * 64),))
    with pytest.raises(RecordingError, match="the same file"):
        gnomon.calibrate_imu([named, replace(named, imus=later.imus)], OPTIONS)


def test_a_prior_from_the_very_recording_is_refused(simulated):
    imu = simulated.imus["imu0"]
    from_memory = Recording.from_arrays(imu.gyroscope.t_s, imu.gyroscope.values, imu.accelerometer.values)
    found = gnomon.calibrate_imu(from_memory, OPTIONS).calibration
    with pytest.raises(OptionError, match="the very recording"):
        gnomon.calibrate_imu(from_memory, OPTIONS, prior=found)
    settings = Source(name="imu.yaml", sha256="0" * 64)  # the same in both, and no recording
    other = replace(simulated, sources=(settings,))
    of_other = replace(found, provenance=replace(found.provenance, inputs=(settings,)))
    assert gnomon.calibrate_imu(other, OPTIONS, prior=of_other).calibration.verdict != "fail"


def test_a_recording_in_another_format_is_known_again(simulated, tmp_path):
    """As text with six digits, in other units and without the last row, against the arrays themselves."""
    imu = simulated.imus["imu0"]
    t_s, rate, force = imu.gyroscope.t_s, imu.gyroscope.values, imu.accelerometer.values
    rows = np.column_stack([t_s, np.degrees(rate), force / 9.80665])[:-1]
    np.savetxt(tmp_path / "r.csv", rows, fmt="%.6g", delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="")
    text = gnomon.read(tmp_path / "r.csv", units="g deg/s")
    arrays = Recording.from_arrays(t_s, rate, force)
    with pytest.raises(RecordingError, match="are the same measurements"):
        gnomon.calibrate_imu([arrays, text], OPTIONS)
    found = gnomon.calibrate_imu(arrays, OPTIONS).calibration
    gnomon.save(found, tmp_path / "calibration.yaml")
    with pytest.raises(OptionError, match="the very recording"):
        gnomon.calibrate_imu(text, OPTIONS, prior=gnomon.load(tmp_path / "calibration.yaml"))


def test_other_recordings_have_other_fingerprints():
    """Of one sensor on one programme, at rest and coarsely quantised, too."""
    rng = np.random.default_rng(1)
    programme = np.sin(np.linspace(0, 40, 4000))[:, None] * [1.0, 2.0, 3.0]
    series = [programme + 0.05 * rng.standard_normal((4000, 3)) for _ in range(6)]
    series += [np.round(rng.standard_normal((4000, 3)) / step) * step for step in (0.1, 1.0, 4.0) for _ in range(6)]
    prints = [sample_fingerprint(values) for values in series]
    assert all(prints[:12])
    assert not any(same_measurements(a, b) for a, b in combinations(prints, 2))
    assert sample_fingerprint(np.zeros((500, 3))) == ""
    assert not same_measurements("xyz", "xyz")


@pytest.mark.parametrize("block", [700, 5000, 40_000])
def test_noise_looks_for_copies_while_it_streams(block):
    values = noise(20_000, seed=3)
    values[12_000:15_000] = values[2_000:5_000]
    watch, t_s = RepeatWatch(), np.arange(20_000) / 100
    for k in range(0, 20_000, block):
        watch.add(values[k : k + block], t_s[k : k + block])
    copies, share = watch.copies()
    assert share == pytest.approx(0.15, abs=0.01)
    assert copies[:, 0].min() == pytest.approx(120, abs=0.7)
    assert copies[:, 0].max() == pytest.approx(150, abs=1.4)
    assert np.allclose(copies[:, 0] - copies[:, 1], 100)


@pytest.mark.parametrize("step", [0.0, 0.5, 3.0])
def test_noise_alone_holds_no_copies(step):
    watch = RepeatWatch()
    for k in range(4):
        watch.add(noise(20_000, seed=k, step=step), k * 200 + np.arange(20_000) / 100)
    assert not len(watch.copies()[0])
    watch = RepeatWatch()
    watch.add(np.zeros((3, 3)), np.arange(3.0))
    assert watch.copies()[1] == 0


def test_the_noise_of_a_recording_appended_to_itself_is_none():
    values = 1e-3 * np.concatenate([noise(12_000, seed=5)] * 2)
    one = TriadSamples(t_ns=np.arange(len(values)) * 10_000_000, values=values, unit="rad/s")
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="m/s^2")
    found = gnomon.identify_noise(Recording(imus={"imu0": ImuSamples(accelerometer=nothing, gyroscope=one)})).noise
    assert {f.code: f.severity for f in found.findings}["data-repeated"] == "problem"
    assert found.verdict == "fail"
