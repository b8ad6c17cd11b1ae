"""The data doctor: every fault is named by its code, and a good recording has none."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.errors import RecordingError
from gnomon.recording import ImuSamples, Recording, TriadSamples

BAD = {"warning", "problem"}


def imu(rests: int = 20, rate_hz: float = 100.0, start_s: float = 25.0, seed: int = 1) -> ImuSamples:
    """Return a hand-held recording with rests in different attitudes [m/s^2, rad/s]."""
    rng = np.random.default_rng(seed)
    up, force, rate = np.array([0.0, 0.0, 1.0]), [], []
    for number in range(rests):
        still = round((start_s if number == 0 else 3.0) * rate_hz)
        force += [9.81 * up] * still
        rate += [np.zeros(3)] * still
        axis = rng.normal(size=3)
        count = round(rate_hz)
        for omega in np.outer(np.hanning(count) * rng.uniform(1.5, 4), axis / np.linalg.norm(axis)):
            up = up - np.cross(omega, up) / rate_hz
            up /= np.linalg.norm(up)
            force.append(9.81 * up + rng.normal(0, 0.3, 3))
            rate.append(omega)
    n = len(force)
    t_ns = np.rint(np.arange(n) * 1e9 / rate_hz).astype(np.int64)
    accel = np.array(force) + rng.normal(0, 0.02, (n, 3))
    gyro = np.array(rate) + rng.normal(0, 0.004, (n, 3)) + 0.01
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=accel, unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=gyro, unit="rad/s"),
    )


def with_stamps(samples: ImuSamples, t_ns) -> ImuSamples:
    return ImuSamples(
        accelerometer=replace(samples.accelerometer, t_ns=t_ns), gyroscope=replace(samples.gyroscope, t_ns=t_ns)
    )


def findings(samples: ImuSamples):
    """Return the findings by code, the most severe of each."""
    return {finding.code: finding for finding in reversed(gnomon.check(Recording(imus={"imu0": samples})))}


def severities(samples: ImuSamples) -> dict[str, str]:
    return {code: finding.severity for code, finding in findings(samples).items()}


def test_good_recording_has_only_good_findings() -> None:
    found = severities(imu())
    assert found == {
        "rate": "good", "saturation": "good", "gravity-magnitude": "good", "attitudes": "good", "static-start": "good"
    }  # fmt: skip


def test_every_bad_finding_has_a_consequence_and_a_cure() -> None:
    samples = imu(rests=3, start_s=1.0)
    t_ns = samples.accelerometer.t_ns.copy()
    t_ns[500:] += 10**9
    t_ns[600:] -= 5 * 10**9
    found = findings(with_stamps(samples, t_ns)).values()
    bad = [finding for finding in found if finding.severity in BAD]
    assert len(bad) >= 3
    assert all(finding.consequence and finding.cure for finding in bad)


def test_time_going_backwards_is_a_problem_with_its_place() -> None:
    samples = imu()
    t_ns = samples.accelerometer.t_ns.copy()
    t_ns[1201] = t_ns[1199]
    found = findings(with_stamps(samples, t_ns))["time-backward"]
    assert found.severity == "problem"
    assert "1 time, first by 0.01 s after sample 1200 (12.000 s" in found.message


def test_stamps_all_the_same() -> None:
    samples = imu()
    assert severities(with_stamps(samples, np.zeros(len(samples.gyroscope), np.int64)))["time-constant"] == "problem"


@pytest.mark.parametrize(("lost", "severity"), [(1, "info"), (200, "warning")])
def test_gaps(lost, severity) -> None:
    samples = imu()
    t_ns = samples.accelerometer.t_ns.copy()
    t_ns[3000:] += lost * 10_000_000
    found = findings(with_stamps(samples, t_ns))["gaps"]
    assert found.severity == severity
    assert f"1 gap, about {lost} samples lost" in found.message
    assert "after sample 2999 (29.990 s" in found.message


def test_repeated_stamps() -> None:
    samples = imu()
    t_ns = samples.accelerometer.t_ns.copy()
    t_ns[[100, 900]] = t_ns[[99, 899]]
    assert severities(with_stamps(samples, t_ns))["time-repeated"] == "info"
    coarse = samples.accelerometer.t_ns // 30_000_000 * 30_000_000
    found = findings(with_stamps(samples, coarse))
    assert found["jitter"].severity == "warning"
    assert found["time-repeated"].follows_from == "jitter"


def test_rounded_stamps_are_named_with_their_step() -> None:
    samples = imu()
    exact = np.arange(len(samples.gyroscope)) * 9_990_000
    found = findings(with_stamps(samples, (exact + 500_000) // 1_000_000 * 1_000_000))["time-rounded"]
    assert found.severity == "info"
    assert "rounded to 1 ms" in found.message
    assert "time-rounded" not in findings(with_stamps(samples, exact))


def test_samples_that_arrive_in_bursts() -> None:
    samples = imu()
    count = len(samples.gyroscope)
    arrival = (np.arange(count) // 10) * 100_000_000 + (np.arange(count) % 10) * 1_000_000
    assert severities(with_stamps(samples, arrival))["jitter"] == "warning"


def test_a_rate_that_changes_once_is_named_with_its_time() -> None:
    samples = imu()
    number = np.arange(len(samples.gyroscope))
    once = np.cumsum(np.where(number < 5000, 10_000_000, 25_000_000))
    found = findings(with_stamps(samples, once))
    assert found["rate-changed"].message == (
        "imu0: from sample 4999 (49.990 s after the start) on, the rate is 40 Hz; before it is 100 Hz."
    )
    assert not {"jitter", "time-rounded"} & set(found)
    to_and_fro = np.cumsum(np.where(number // 2500 % 2, 10_000_000, 25_000_000))
    assert "rate-changed" not in findings(with_stamps(samples, to_and_fro))


@pytest.mark.parametrize(("end", "severity"), [(1.0, "problem"), (0.545, "warning")])
def test_an_axis_that_keeps_its_value_while_the_others_go_on(end, severity) -> None:
    samples = imu()
    values = samples.accelerometer.values.copy()
    first, last = len(values) // 2, int(end * len(values))
    values[first:last, 1] = values[first, 1]
    found = findings(replace(samples, accelerometer=replace(samples.accelerometer, values=values)))["axis-stuck"]
    assert found.severity == severity
    assert f"y keeps the same value from {samples.accelerometer.t_s[first]:.1f} to" in found.message


def test_a_coarse_axis_at_rest_is_not_stuck() -> None:
    samples = imu()
    coarse = replace(samples.accelerometer, values=np.round(samples.accelerometer.values))
    assert "axis-stuck" not in findings(replace(samples, accelerometer=coarse))


def test_jitter_of_a_few_percent_is_good() -> None:
    samples = imu()
    noise = np.random.default_rng(0).normal(0, 300_000, len(samples.gyroscope)).astype(np.int64)
    found = findings(with_stamps(samples, samples.accelerometer.t_ns + noise))
    assert found["rate"].severity == "good"
    assert "jitter 4." in found["rate"].message


def test_saturation_is_found() -> None:
    samples = imu()
    clipped = np.clip(samples.gyroscope.values, -1.0, 1.0)
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=clipped)))
    assert found["saturation"].severity == "warning"
    count = int((np.abs(samples.gyroscope.values) >= 1).any(axis=1).sum())
    assert f"{count} samples" in found["saturation"].message


def test_constant_signal_and_axis() -> None:
    samples = imu()
    constant = np.full_like(samples.accelerometer.values, 3.0)
    found = severities(replace(samples, accelerometer=replace(samples.accelerometer, values=constant)))
    assert found["signal-constant"] == "problem"
    assert "never-static" not in found
    values = samples.accelerometer.values.copy()
    values[:, 1] = 0
    found = findings(replace(samples, accelerometer=replace(samples.accelerometer, values=values)))
    assert "axis y never changes" in found["axis-constant"].message
    values[:, 1] = values[:, 0]
    found = findings(replace(samples, accelerometer=replace(samples.accelerometer, values=values)))
    assert "axes x and y read the same" in found["axis-constant"].message


def test_stuck_and_repeated_samples() -> None:
    samples = imu()
    values = samples.gyroscope.values.copy()
    values[2000:2100] = values[2000]
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=values)))
    assert "100 times in a row from 20.00 s" in found["samples-stuck"].message
    held = np.repeat(samples.gyroscope.values[::2], 2, axis=0)[: len(values)]
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=held)))
    assert found["samples-repeated"].severity == "warning"


def test_a_triad_that_is_stuck_while_the_other_moves_and_stamps_that_all_fall_are_problems() -> None:
    samples = imu()
    values, n = samples.gyroscope.values.copy(), len(samples.gyroscope)
    values[n // 2 :] = 0
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=values)))
    assert found["samples-stuck"].severity == "problem"
    found = findings(with_stamps(samples, samples.accelerometer.t_ns[::-1]))
    assert found["time-backward"].severity == "problem"
    assert "time-constant" not in found


def test_rests_without_samples_of_the_gyroscope_are_left_out_for_that_reason() -> None:
    samples = imu()
    g, half = samples.gyroscope, len(samples.gyroscope) // 2
    found = findings(replace(samples, gyroscope=replace(g, t_ns=g.t_ns[:half], values=g.values[:half])))
    assert "the gyroscope has no samples there" in found["intervals-left-out"].message


def test_an_unknown_unit_is_refused_with_those_that_are_known() -> None:
    samples = imu()
    with pytest.raises(RecordingError, match=r'gyroscope has no unit "raw"; known are rad/s.*count'):
        replace(samples, gyroscope=replace(samples.gyroscope, unit="raw"))


def test_coarse_sensor_at_rest_is_not_stuck() -> None:
    samples = imu()
    coarse = np.round(samples.gyroscope.values / 0.02) * 0.02
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=coarse)))
    assert not {"samples-stuck", "samples-repeated", "axis-constant"} & set(found)


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_readings_put_to_zero_when_small_are_named_and_coarse_steps_are_not(step: float) -> None:
    samples = imu()
    rate = samples.gyroscope.values
    rate = np.rint(rate / step) * step if step else rate
    dead = np.where(np.abs(rate - 0.01) < 0.006, 0.01, rate)
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=dead)))
    assert found["dead-band"].severity == "warning"
    assert "imu0 gyroscope x and y and z: 0.01 rad/s stands in" in found["dead-band"].message
    for coarse in (step or 1e-5, 2e-3, 0.01, 0.03):
        values = np.rint(rate / coarse) * coarse
        assert "dead-band" not in findings(replace(samples, gyroscope=replace(samples.gyroscope, values=values)))


def test_a_gyroscope_that_is_set_to_zero_in_every_rest_is_named() -> None:
    samples = imu()
    rate = samples.gyroscope.values
    moving = np.convolve(np.abs(rate - 0.01).max(axis=1) > 0.03, np.ones(25), "same") > 0.5
    found = findings(
        replace(samples, gyroscope=replace(samples.gyroscope, values=np.where(moving[:, None], rate, 0.0)))
    )
    assert "0 rad/s stands in 20 places" in found["dead-band"].message


def test_readings_that_were_normalised_are_a_problem() -> None:
    samples = imu()
    force = samples.accelerometer.values
    made = 9.80665 * force / np.linalg.norm(force, axis=1, keepdims=True)
    found = findings(replace(samples, accelerometer=replace(samples.accelerometer, values=np.round(made, 5))))
    assert found["magnitude-constant"].severity == "problem"


@pytest.mark.parametrize("period", [2, 3, 4])
def test_sensors_that_were_written_by_turns_are_a_problem(period: int) -> None:
    samples = imu()
    turn = np.arange(len(samples.gyroscope)) % period == 0
    values = samples.gyroscope.values + turn[:, None] * [0.0, 0.03, 0.0]
    found = findings(replace(samples, gyroscope=replace(samples.gyroscope, values=values)))
    assert found["samples-by-turns"].severity == "problem"
    size = re.search(rf"by turns of {period}, samples differ by (\S+) rad/s", found["samples-by-turns"].message)
    assert abs(float(size[1]) - 0.03) < 5e-4


@pytest.mark.parametrize(("unit", "severity"), [("m/s^2", "good"), ("g", "problem"), ("count", "info")])
def test_unit_is_held_against_gravity(unit, severity) -> None:
    samples = imu()
    found = findings(replace(samples, accelerometer=replace(samples.accelerometer, unit=unit)))
    assert found["gravity-magnitude"].severity == severity
    if unit == "count":
        assert "gravity is about 9.8" in found["gravity-magnitude"].message


def test_one_attitude_only() -> None:
    rng = np.random.default_rng(0)
    t_ns = np.arange(6000) * 10_000_000
    accel = TriadSamples(t_ns=t_ns, values=rng.normal([0, 0, 9.8], 0.02, (6000, 3)), unit="m/s^2")
    gyro = TriadSamples(t_ns=t_ns, values=rng.normal(0, 0.004, (6000, 3)), unit="rad/s")
    assert severities(ImuSamples(accelerometer=accel, gyroscope=gyro))["always-static"] == "problem"
    counts = replace(accel, values=np.round(accel.values * 415 + 33000), unit="count")
    assert severities(ImuSamples(accelerometer=counts, gyroscope=gyro))["always-static"] == "problem"


@pytest.mark.parametrize("seed", range(3))
def test_motion_without_rest(seed) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(0, 60, 0.005)

    def sway(noise: float):
        f, phase, size = rng.uniform(0.1, 1.5, (3, 5)), rng.uniform(0, 6, (3, 5)), rng.uniform(0.5, 2, (3, 5))
        waves = size * np.sin(2 * np.pi * f * t[:, None, None] + phase)
        return waves.sum(axis=2) + rng.normal(0, noise, (len(t), 3))

    accel, gyro = sway(0.02), sway(0.004)
    t_ns = np.rint(t * 1e9).astype(np.int64)
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=accel + np.array([0, 0, 9.8]), unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=t_ns, values=gyro, unit="rad/s"),
    )
    assert severities(samples)["never-static"] == "problem"


@pytest.mark.parametrize(("rests", "severity"), [(5, "problem"), (11, "warning"), (25, "good")])
def test_number_of_attitudes(rests, severity) -> None:
    assert severities(imu(rests=rests))["attitudes"] == severity


def test_no_rest_at_the_start() -> None:
    samples = imu()
    part = slice(2550, None)  # begins in the first turn
    cut = ImuSamples(
        accelerometer=TriadSamples(
            t_ns=samples.accelerometer.t_ns[part], values=samples.accelerometer.values[part], unit="m/s^2"
        ),
        gyroscope=TriadSamples(t_ns=samples.gyroscope.t_ns[part], values=samples.gyroscope.values[part], unit="rad/s"),
    )
    assert severities(cut)["static-start"] in {"info", "warning"}


def test_silent_gyroscope() -> None:
    samples = imu()
    noise = np.random.default_rng(0).normal(0, 0.004, samples.gyroscope.values.shape)
    found = severities(replace(samples, gyroscope=replace(samples.gyroscope, values=noise)))
    assert found["gyroscope-silent"] == "problem"
    assert "gyroscope-silent" not in severities(samples)


def test_missing_samples_and_gyroscope() -> None:
    samples = imu()
    none = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s")
    assert severities(replace(samples, gyroscope=none))["gyroscope-missing"] == "info"
    assert severities(replace(samples, accelerometer=none))["samples-missing"] == "problem"


def test_triads_that_were_not_recorded_together() -> None:
    samples = imu()
    late = replace(samples.gyroscope, t_ns=samples.gyroscope.t_ns + 10**12)
    assert severities(replace(samples, gyroscope=late))["clocks-apart"] == "problem"


def test_xsens(real_data) -> None:
    recording = gnomon.read(real_data("xsens_mti"))
    found = {finding.code: finding for finding in gnomon.check(recording)}
    assert not [finding for finding in found.values() if finding.severity in BAD]
    assert "rounded to 1 ms" in found["time-rounded"].message
    assert "starts with 52." in found["static-start"].message
    start = time.process_time()
    gnomon.check(recording)
    assert time.process_time() - start < 0.2  # about 0.02 s on an idle machine


@pytest.mark.parametrize("folder", ["a-aprilgrid-full", "b-aprilgrid-ideal-imu", "d-checkerboard-ideal-imu"])
def test_camera_recordings_have_no_rest(real_data, folder) -> None:
    recording = gnomon.read(real_data(f"rendered-camimu/{folder}/imu0.csv.gz"))
    assert {finding.code: finding.severity for finding in gnomon.check(recording)}["never-static"] == "problem"


def test_euroc_is_no_recording_for_an_imu_alone(real_data) -> None:
    recording = gnomon.read(real_data("euroc-imu-april/imu0.csv.gz"))
    assert "problem" in {finding.severity for finding in gnomon.check(recording)}


@pytest.mark.parametrize("number", [0, 1, 2])
def test_mikov(real_data, number) -> None:
    recording = gnomon.read(real_data(f"mikov-mpu9150-multipos/imu{number}.log"), rate_hz=100)
    assert not [finding for finding in gnomon.check(recording) if finding.severity in BAD]


def test_columns_of_both_triads_exchanged_are_named_before_units_and_rests() -> None:
    healthy = imu()
    triads = {
        "accelerometer": replace(healthy.accelerometer, values=healthy.gyroscope.values),
        "gyroscope": replace(healthy.gyroscope, values=healthy.accelerometer.values),
    }
    for made, wanted in ((healthy, False), (replace(healthy, **triads), True)):
        found = gnomon.check(Recording(imus={"imu0": made}))
        assert ("triads-exchanged" in {one.code for one in found}) is wanted
    with pytest.raises(RecordingError, match="exchanged"):
        gnomon.calibrate_imu(Recording(imus={"imu0": replace(healthy, **triads)}))


def test_lines_sorted_as_text_go_backwards_and_that_is_all() -> None:
    made = imu()
    order = np.array(sorted(range(len(made.accelerometer)), key=lambda k: f"{made.accelerometer.t_s[k]:.6g}"))
    accelerometer, gyroscope = (
        replace(triad, t_ns=triad.t_ns[order], values=triad.values[order])
        for triad in (made.accelerometer, made.gyroscope)
    )
    jumbled = Recording(imus={"imu0": replace(made, accelerometer=accelerometer, gyroscope=gyroscope)})
    assert [one.code for one in gnomon.check(jumbled) if one.severity == "problem"] == ["time-backward"]
