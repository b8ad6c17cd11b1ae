"""Recordings that do not follow the protocol, or follow it with flaws: what the recipe says and what it still finds."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.geometry.rotations import (
    normalise_quaternion,
    quaternion_product,
    rk4n_steps,
    rotation_from_quaternion,
    running_products,
)
from gnomon.results.calibration import calibration_parameters

GRAVITY = 9.80665
STATED = gnomon.ImuOptions(gravity=GRAVITY)
NOISE = {"accelerometer": 0.007, "gyroscope": 0.0043}
RATE_HZ = 100.0


def calibrate(recording, **options):
    return gnomon.calibrate_imu(recording, replace(STATED, **options)).calibration


def codes(calibration, *severities):
    return [f.code for f in calibration.assessment.findings if not severities or f.severity in severities]


def errors_in_sigmas(calibration, truth):
    """Return errors over sigmas of all scalars that have one, and the NEES over their number."""
    pairs = zip(calibration_parameters(calibration.imus), calibration_parameters(truth.imus), strict=True)
    errors = np.concatenate([(found - true).ravel() for (_, found), (_, true) in pairs])
    covariance = calibration.uncertainty.matrix
    free = np.diag(covariance) > 0
    sigma = np.sqrt(np.diag(covariance)[free])
    scaled = errors[free] / sigma
    nees = scaled @ np.linalg.solve(covariance[np.ix_(free, free)] / np.outer(sigma, sigma), scaled)
    return scaled, nees / len(scaled)


def assert_true_within_sigmas(calibration, truth):
    scaled, nees = errors_in_sigmas(calibration, truth)
    assert np.abs(scaled).max() < 4.5
    assert nees < 2.0  # 1 +- 0.26 where all is as it should be


class Protocol:
    """A recording put together by hand: rests, turns of the body about chosen axes, and pauses of the recorder."""

    def __init__(self, seed=0):
        self.rng = np.random.default_rng(seed)
        self.q = normalise_quaternion(self.rng.normal(size=4))
        self.t, self.rate, self.force = 0.0, [], []
        self.stamps = []

    def _add(self, rate):
        n = len(rate)
        steps = rk4n_steps(rate[:-1], rate[1:], np.full(n - 1, 1 / RATE_HZ))
        turned = running_products(steps, np.array([n - 1])) if n > 1 else np.empty((0, 4))
        attitude = quaternion_product(self.q, np.concatenate([[[1.0, 0, 0, 0]], turned]))
        self.force.append(np.einsum("kij,i->kj", rotation_from_quaternion(attitude), [0, 0, GRAVITY]))
        self.rate.append(rate)
        self.stamps.append(self.t + np.arange(n) / RATE_HZ)
        self.q, self.t = attitude[-1], self.t + n / RATE_HZ

    def rest(self, seconds=3.0):
        self._add(np.zeros((round(seconds * RATE_HZ), 3)))
        return self

    def turn(self, axis, angle, seconds=2.0):
        x = np.linspace(0, 1, round(seconds * RATE_HZ))
        self._add((630 * (x * (1 - x)) ** 4 * angle / seconds)[:, None] * np.asarray(axis, dtype=float))
        return self

    def pause(self, seconds=5.0):
        """Turn to another attitude while nothing is recorded."""
        self.q, self.t = normalise_quaternion(self.rng.normal(size=4)), self.t + seconds
        return self

    def recording(self, noise=1.0):
        rate, force = np.concatenate(self.rate), np.concatenate(self.force)
        rate = rate + 0.01 + noise * NOISE["gyroscope"] * self.rng.normal(size=rate.shape)
        force = force + 0.05 + noise * NOISE["accelerometer"] * self.rng.normal(size=force.shape)
        return gnomon.Recording.from_arrays(np.concatenate(self.stamps), rate, force)


def direction(rng):
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def usual(attitudes=24, seed=0):
    protocol = Protocol(seed).rest(20.0)
    for _ in range(attitudes - 1):
        protocol.turn(direction(protocol.rng), protocol.rng.uniform(0.8, 2.5)).rest()
    return protocol


@pytest.fixture(scope="module")
def simulated():
    return gnomon.simulate(gnomon.Scenario(g_sensitivity=1e-4, intervals=30, t_init_s=20.0), seed=3)


@pytest.fixture(scope="module")
def flawless(simulated):
    """The result of it."""
    return gnomon.calibrate_imu(simulated[0], STATED)


def with_samples(recording, change):
    """Return the recording after `change(name, t_ns, values) -> (t_ns, values)` of both triads."""
    imu = recording.imus["imu0"]
    triads = {}
    for name in ("accelerometer", "gyroscope"):
        samples = getattr(imu, name)
        t_ns, values = change(name, samples.t_ns.copy(), samples.values.copy())
        triads[name] = replace(samples, t_ns=t_ns, values=values)
    return gnomon.Recording(imus={"imu0": gnomon.ImuSamples(**triads)})


# --- nothing to calibrate from -------------------------------------------------------------------------------------


def test_always_static():
    with pytest.raises(gnomon.DetectionError, match="attitude"):
        calibrate(Protocol(1).rest(120.0).recording())


def test_turned_about_the_vertical_only():
    protocol = Protocol(2)
    protocol.q = np.array([1.0, 0, 0, 0])  # it lies on a table
    for _ in range(20):
        protocol.rest().turn([0, 0, 1], 1.5)
    with pytest.raises(gnomon.DetectionError, match="attitude"):
        calibrate(protocol.rest().recording())


def test_never_static():
    protocol = Protocol(3)
    for _ in range(40):
        protocol.turn(direction(protocol.rng), protocol.rng.uniform(1, 3))
    swinging = with_samples(
        protocol.recording(),
        lambda name, t, v: (t, v + 0.3 * np.sin(np.arange(len(v)) / 11)[:, None] * [1.0, -0.5, 0.7]),
    )
    with pytest.raises(gnomon.DetectionError, match="rest"):
        calibrate(swinging)


@pytest.mark.parametrize("attitudes", [2, 5])
def test_too_few_attitudes(attitudes):
    with pytest.raises(gnomon.DetectionError, match="attitude"):
        calibrate(usual(attitudes, seed=attitudes).recording())


@pytest.mark.parametrize(("attitudes", "warning"), [(8, "few-attitudes"), (9, "few-redundant")])
def test_six_to_nine_attitudes_are_judged_by_their_rests(attitudes, warning):
    calibration = calibrate(usual(attitudes, seed=8).recording())
    assert calibration.verdict != "pass"
    assert warning in codes(calibration, "warning")
    assert "static-experiment" in codes(calibration)
    assert "rotations-few-attitudes" in codes(calibration)  # which tell the gyroscope's scales, not the unit alone
    assert not {f"imu0.gyroscope.sensitivity[{k},{k}]" for k in range(3)} & set(calibration.assessment.held_by_prior)
    assert np.diag(calibration.sigma("imu0.gyroscope.sensitivity")).max() < 0.01


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_attitudes_on_a_circle(seed):
    # Turning about one level axis of the body shows gravity in one plane: three numbers of nine stay open, and only
    # noise fills them.
    protocol = Protocol(seed)
    protocol.q = np.array([1.0, 0, 0, 0])
    for _ in range(20):
        protocol.rest().turn([1, 0, 0], 0.7)
    recording = protocol.rest().recording()
    try:
        calibration = calibrate(recording)
    except (gnomon.DetectionError, gnomon.InitialisationError):
        return  # refused: as good
    assert calibration.verdict == "fail"
    assert "imu0.accelerometer.sensitivity[0,0]" in calibration.assessment.held_by_prior
    assert "imu0.accelerometer.bias[0]" in calibration.assessment.held_by_prior
    assert "not-observable" in codes(calibration, "problem")


def test_silent_gyroscope():
    recording = with_samples(
        usual().recording(),
        lambda name, t, v: (
            t,
            v if name == "accelerometer" else 0.0043 * np.random.default_rng(1).normal(size=v.shape),
        ),
    )
    with pytest.raises(gnomon.DetectionError, match="gyroscope shows only noise"):
        calibrate(recording)


@pytest.mark.parametrize("triad", ["accelerometer", "gyroscope"])
def test_constant_signal(triad):
    recording = with_samples(usual().recording(), lambda name, t, v: (t, v if name != triad else 0 * v + 1.0))
    with pytest.raises((gnomon.RecordingError, gnomon.DetectionError)) as error:
        calibrate(recording)
    assert triad in str(error.value)


# --- weak, and said to be so ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_rotations_about_one_axis_leave_the_gyroscope_open(seed):
    # The recorder is stopped whenever the sensor is turned over; recorded are turns about its z axis alone.
    protocol = Protocol(seed).rest(20.0)
    for _ in range(24):
        protocol.turn([0, 0, 1], 1.5).rest().pause().rest()
    calibration = calibrate(protocol.recording())
    assert calibration.verdict == "fail"
    named = [f for f in calibration.assessment.findings if f.code in ("not-observable", "uncertainty-gyroscope")]
    assert named[0].severity == "problem"
    assert "gyroscope" in named[0].message
    assert "Turn the sensor about its" in named[0].cure
    assert "z axis" not in named[0].cure
    sensitivity = calibration.sigma("imu0.gyroscope.sensitivity")
    assert sensitivity[2, 2] < 0.01  # what was turned about is known
    assert sensitivity[0, 0] > 0.05
    assert sensitivity[1, 1] > 0.05
    assert not any("accelerometer" in name for name in calibration.assessment.held_by_prior)


def test_few_rotations_are_coarse():
    calibration = calibrate(usual(10, seed=6).recording(noise=6.0))
    assert calibration.verdict != "pass"
    assert {"uncertainty-gyroscope", "uncertainty-accelerometer"} & set(codes(calibration, "warning", "problem"))


# --- flaws that are worked around ----------------------------------------------------------------------------------


def test_flawless_recording_is_true_within_its_sigmas(simulated, flawless):
    calibration, truth = flawless.calibration, simulated[1]
    assert calibration.verdict == "pass"
    assert calibration.assessment.intervals_used == 30
    assert_true_within_sigmas(calibration, truth)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_touched_intervals_are_left_out(seed):
    scenario = gnomon.Scenario(intervals=40, touched=5, touch_acceleration=0.3, touch_angle=0.01, g_sensitivity=1e-4)
    recording, truth = gnomon.simulate(scenario, seed)
    calibration = calibrate(recording)
    assert 33 <= calibration.assessment.intervals_used <= 40  # a rest that is cut short by the touch may stay
    assert_true_within_sigmas(calibration, truth)


@pytest.mark.parametrize("pressed", [(6,), (6, 15), (3, 11, 22)], ids=str)
@pytest.mark.parametrize("push", [0.02, 0.1])
def test_pressed_intervals_are_left_out_and_named(simulated, flawless, pressed, push):
    # A steady push, to which the detector is blind, of 0.2 % and of 1 % of gravity.
    recording, truth = simulated
    plain = flawless.diagnostics.intervals
    t_s = recording.imus["imu0"].accelerometer.t_s

    def press(name, t, v):
        for k in pressed if name == "accelerometer" else ():
            inside = (t_s > plain.start_s[k] - 1.0) & (t_s < plain.stop_s[k] + 1.0)
            v[inside] += push * plain.direction[k]
        return t, v

    result = gnomon.calibrate_imu(with_samples(recording, press), STATED)
    calibration = result.calibration
    assert_true_within_sigmas(calibration, truth)
    assert calibration.assessment.intervals_found == 30
    np.testing.assert_array_equal(np.flatnonzero(~result.diagnostics.intervals.used), pressed)
    [finding] = [f for f in calibration.assessment.findings if f.code == "intervals-left-out"]
    assert str(pressed[-1] + 1) in finding.message


def test_gap_in_the_middle(simulated, flawless):
    recording, truth = simulated
    start_s = flawless.diagnostics.rotations.start_s[12] + 1.0  # in the middle of a rotation

    def cut(name, t, v):
        seconds = (t - t[0]) * 1e-9
        keep = (seconds < start_s) | (seconds > start_s + 0.5)
        return t[keep], v[keep]

    result = gnomon.calibrate_imu(with_samples(recording, cut), STATED)
    rotations = result.diagnostics.rotations
    assert not rotations.used[12]
    assert "gap" in rotations.reason[12]
    assert rotations.used.sum() == 28
    assert "rotations-left-out" in codes(result.calibration)
    assert_true_within_sigmas(result.calibration, truth)


def test_gap_of_a_whole_minute(simulated):
    recording, truth = simulated

    def cut(name, t, v):
        seconds = (t - t[0]) * 1e-9
        keep = (seconds < 70) | (seconds > 130)
        return t[keep], v[keep]

    calibration = calibrate(with_samples(recording, cut))
    assert_true_within_sigmas(calibration, truth)


def test_saturated_gyroscope():
    scenario = gnomon.Scenario(intervals=40, g_sensitivity=1e-4, gyroscope_range=3.0)
    recording, truth = gnomon.simulate(scenario, 4)
    result = gnomon.calibrate_imu(recording, STATED)
    rotations = result.diagnostics.rotations
    clipped = np.array(["saturated" in why for why in rotations.reason])
    assert 3 <= clipped.sum() <= 20
    assert not rotations.used[clipped].any()
    assert "saturation" in codes(result.calibration, "warning")
    assert_true_within_sigmas(result.calibration, truth)
    # Not knowing of it would be felt: as if the values were what the sensor had seen.
    unknown = with_samples(recording, lambda name, t, v: (t, v + 1e-6 * np.random.default_rng(1).normal(size=v.shape)))
    assert_true_within_sigmas(calibrate(unknown, gyroscope_range=2.99), truth)


@pytest.mark.parametrize(("accelerometer", "gyroscope"), [(200.0, 80.0), (50.0, 400.0), (100.0, 99.0)])
def test_triads_of_unequal_rates(accelerometer, gyroscope):
    scenario = gnomon.Scenario(g_sensitivity=1e-4, rate_hz=accelerometer, gyroscope_rate_hz=gyroscope, intervals=30)
    recording, truth = gnomon.simulate(scenario, 5)
    calibration = calibrate(recording)
    assert calibration.assessment.rotations_used == 29
    assert_true_within_sigmas(calibration, truth)


def test_lost_samples_and_rounded_stamps():
    scenario = gnomon.Scenario(g_sensitivity=1e-4, stamp_resolution_s=1e-3, dropped=0.02, intervals=30)
    recording, truth = gnomon.simulate(scenario, 6)
    assert_true_within_sigmas(calibrate(recording), truth)


# --- units and frames ----------------------------------------------------------------------------------------------


def test_units_do_not_matter(simulated, flawless):
    recording, _ = simulated
    imu = recording.imus["imu0"]
    other = gnomon.Recording.from_arrays(
        imu.accelerometer.t_ns * 1e-9,
        np.degrees(imu.gyroscope.values),
        imu.accelerometer.values / 9.80665,
        units="g deg/s",
    )
    si, mixed = flawless.calibration, calibrate(other)
    per_g, per_deg = 1 / 9.80665, 180 / np.pi
    units = {"accelerometer": per_g, "gyroscope": per_deg}
    for path, value in calibration_parameters(si.imus):
        unit = units[path.split(".")[1]]
        for found, expected in (
            (mixed.parameter(path), value * unit),
            (mixed.sigma(path), si.sigma(path) * unit),
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
    assert mixed.imus["imu0"].accelerometer.unit == "g"
    ours, theirs = si.imus["imu0"].apply(imu), mixed.imus["imu0"].apply(other.imus["imu0"])
    np.testing.assert_allclose(ours.accelerometer.values, theirs.accelerometer.values, atol=1e-7)
    np.testing.assert_allclose(ours.gyroscope.values, theirs.gyroscope.values, atol=1e-7)


def test_frames_of_a_result(simulated, flawless):
    plain, direct = flawless.calibration, calibrate(simulated[0], frame="accel-z")
    assert direct.frame == "accel-z"
    back = direct.in_frame("accel-x")
    for path, value in calibration_parameters(plain.imus):
        np.testing.assert_allclose(back.parameter(path), value, atol=1e-10 * np.abs(value).max())
        np.testing.assert_allclose(back.sigma(path), plain.sigma(path), atol=1e-6 * plain.sigma(path).max())
    assert (direct.parameter("imu0.accelerometer.sensitivity")[np.tril_indices(3, -1)] == 0).all()
    assert (direct.sigma("imu0.accelerometer.sensitivity")[np.tril_indices(3, -1)] < 1e-12).all()


@pytest.fixture(scope="module")
def repeated():
    """Return one motion of one sensor, recorded thirty times with noise of its own, and once without."""
    quiet = gnomon.Scenario(
        g_sensitivity=1e-4,
        intervals=24,
        t_init_s=10.0,
        accelerometer_noise_density=1e-6,
        gyroscope_noise_density=1e-6,
    )
    recording, truth = gnomon.simulate(quiet, 8)
    rng = np.random.default_rng(9)

    def noisy():
        return with_samples(recording, lambda name, t, v: (t, v + NOISE[name] * rng.normal(size=v.shape)))

    return recording, truth, [noisy() for _ in range(20)]


@pytest.fixture(scope="module")
def poses(repeated):
    """Return poses that name intervals in which the chosen axes of a body of the user's own pointed up or down."""
    recording, *_ = repeated
    up = gnomon.calibrate_imu(recording, STATED).diagnostics.intervals.direction
    x = int(np.argmax(up[:, 0]))
    y = int(np.argmin(np.abs(up @ up[x]) + 0.1 * np.abs(up[:, 1])))
    return f"x={x + 1} y=-{y + 1}", up[x], -up[y]


def test_users_frame_stands_as_its_poses_say(repeated, poses):
    recording, *_ = repeated
    text, x, y = poses
    plain, user = calibrate(recording), calibrate(recording, frame=text)
    assert user.frame == "user"
    turn = np.linalg.solve(
        plain.parameter("imu0.accelerometer.sensitivity"), user.parameter("imu0.accelerometer.sensitivity")
    ).T  # f_user = turn @ f_plain
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    # The poses are not quite at right angles: both give way alike.
    error_x, error_y = np.arccos(turn[0] @ x), np.arccos(turn[1] @ y)
    askew = np.abs(np.arccos(x @ y) - np.pi / 2)
    assert error_x == pytest.approx(askew / 2, abs=1e-6)
    assert error_y == pytest.approx(askew / 2, abs=1e-6)
    for path, value in calibration_parameters(plain.imus):
        moved = value @ turn.T if value.ndim == 2 else value
        np.testing.assert_allclose(user.parameter(path), moved, atol=1e-9 * np.abs(value).max())


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize("frame", ["poses", "accel-z"])
def test_sigmas_in_a_frame_are_what_repetitions_scatter_by(repeated, poses, frame):
    recording, _, noisy = repeated
    name = poses[0] if frame == "poses" else frame
    options = {"frame": name, "model": "g-sensitivity"}
    truth = calibrate(recording, **options)
    found = [calibrate(one, **options) for one in noisy]
    for path, value in calibration_parameters(truth.imus):
        sigma = np.mean([one.sigma(path) for one in found], axis=0)
        free = sigma > 1e-9 * np.abs(value).max()
        scatter = np.sqrt(np.mean([(one.parameter(path) - value) ** 2 for one in found], axis=0))
        ratio = np.sqrt(np.mean((scatter[free] / sigma[free]) ** 2))
        assert 0.7 < ratio < 1.35, (path, ratio)
        np.testing.assert_allclose(scatter[free] / sigma[free], 1.0, atol=0.65)  # each: 13 % at one sigma


@pytest.mark.parametrize("frame", ["x=1 y=99", "x=1", "x=1 x=2", "up=3", "accel-y"])
def test_frames_that_do_not_exist_are_refused(simulated, frame):
    with pytest.raises(gnomon.OptionError, match="frame"):
        calibrate(simulated[0], frame=frame)


# --- many bad rotations, and timestamps in packets
# -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def good_rotations():
    """Return a recording, how it is calibrated, and the result."""
    recording, _ = gnomon.simulate(gnomon.Scenario(g_sensitivity=1e-4, intervals=30, t_init_s=20.0), seed=3)
    options = gnomon.ImuOptions(gravity=9.80665, model="g-sensitivity")
    return recording, options, gnomon.calibrate_imu(recording, options)


@pytest.mark.parametrize("bad", [(4,), (4, 12), (2, 7, 12, 17, 22)], ids=str)
def test_bad_rotations_do_not_hide_each_other(good_rotations, bad):
    recording, options, good = good_rotations
    samples, rotations = recording.imus["imu0"], good.diagnostics.rotations
    t_s, values = samples.gyroscope.t_s, samples.gyroscope.values.copy()
    for k in bad:
        middle = 0.5 * (rotations.start_s[k] + rotations.stop_s[k])
        values[np.abs(t_s - middle) < 0.3] *= 0.9
    slipping = replace(samples, gyroscope=replace(samples.gyroscope, values=values))
    found = gnomon.calibrate_imu(gnomon.Recording(imus={"imu0": slipping}), options)
    assert tuple(np.flatnonzero(~found.diagnostics.rotations.used)) == bad
    sigma = "imu0.gyroscope.sensitivity"
    assert found.calibration.sigma(sigma).max() < 1.5 * good.calibration.sigma(sigma).max()


@pytest.fixture(scope="module")
def uniform():
    """Return samples at uniform times, and their calibration."""
    recording, _ = gnomon.simulate(gnomon.Scenario(g_sensitivity=1e-4, intervals=20, t_init_s=20.0), seed=4)
    return recording.imus["imu0"], calibrate(recording)


@pytest.mark.parametrize("apart_ns", [0, 10_000, 1_000_000])
def test_stamps_in_packets_give_the_calibration_of_uniform_ones(uniform, apart_ns):
    # Ten samples come together every tenth of a second, as over a serial port.
    samples, plain = uniform
    number = np.arange(len(samples.gyroscope))
    t_ns = (number // 10 + 1) * 100_000_000 + (number % 10) * apart_ns
    packets = gnomon.ImuSamples(
        accelerometer=replace(samples.accelerometer, t_ns=t_ns), gyroscope=replace(samples.gyroscope, t_ns=t_ns)
    )
    found = calibrate(gnomon.Recording(imus={"imu0": packets}))
    for name in ("imu0.accelerometer.sensitivity", "imu0.gyroscope.sensitivity"):
        difference = np.abs(found.parameter(name) - plain.parameter(name))
        assert (difference <= 0.2 * plain.sigma(name) + 1e-12).all()
