"""Hard and soft iron, sigma, dip and alignment of a magnetometer against simulated truth and published numbers."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.magnetometer import calibrate_magnetometer
from gnomon.errors import DetectionError, OptionError, RecordingError
from gnomon.estimate.triads.attitudes import fit_dip
from gnomon.estimate.triads.field_poses import field_poses, rough_ellipsoid, sample_noise
from gnomon.estimate.triads.triad_start import Ellipsoid
from gnomon.estimate.triads.triad_trust import Stage, TimeBlocks, block_covariance, leave_blocks_out, memory_s
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.options import MagnetometerOptions
from gnomon.recording import ImuSamples, Recording, TriadSamples
from gnomon.simulate import FieldScenario, simulate_magnetometer

NAMES = "imu0.magnetometer.sensitivity", "imu0.magnetometer.bias"
IN_UT = MagnetometerOptions(field=48.0)


def errors(scenario, seed, options=IN_UT, prior=None):
    """Return the errors of a calibration in units of their sigmas, (12,), its NEES per parameter, and the result."""
    recording, truth = simulate_magnetometer(scenario, seed)
    result = calibrate_magnetometer(recording, options, prior=prior)
    calibration = result.calibration
    assert calibration.frame == truth.frame
    error = np.concatenate([(calibration.parameter(name) - truth.parameter(name)).ravel() for name in NAMES])
    covariance = calibration.covariance(*NAMES)
    free = np.diag(covariance) > 0
    scaled = error[free] / np.sqrt(np.diag(covariance)[free])
    inverse = np.linalg.pinv(covariance[np.ix_(free, free)], rcond=1e-10, hermitian=True)  # one scale is three entries
    nees = float(error[free] @ inverse @ error[free]) / free.sum()
    return scaled, nees, result


SCENARIOS = {
    "alone": FieldScenario(accelerometer=False),
    "correlated": FieldScenario(accelerometer=False, inhomogeneity=0.5, duration_s=120.0),
    "disturbed": FieldScenario(accelerometer=False, inhomogeneity=0.3, disturbances=3, outliers=0.01),
    "with accelerometer": FieldScenario(inhomogeneity=0.3, rests=12),
}


@pytest.mark.first(1)
@pytest.mark.parametrize("name", SCENARIOS)
def test_sigmas_are_honest(name) -> None:
    """Errors that are correlated in time would make sigmas of independent errors three to six times too small."""
    scaled, nees, dips = [], [], []
    for seed in range(2):
        one, consistency, result = errors(SCENARIOS[name], seed)
        scaled.append(one)
        nees.append(consistency)
        if result.diagnostics.dip is not None:
            dips.append(
                (np.degrees(result.diagnostics.dip.estimated_rad) - 64.0) / np.degrees(result.diagnostics.dip.sigma_rad)
            )
    assert 0.6 < np.sqrt(np.mean(np.square(scaled))) < 1.45
    assert np.abs(scaled).max() < 4.5
    assert 0.4 < np.mean(nees) < 2.2
    assert all(abs(dip) < 3.5 for dip in dips)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_sigmas_are_honest_in_many_runs(name) -> None:
    runs = [errors(SCENARIOS[name], seed)[:2] for seed in range(100, 200)]
    scaled = np.array([scaled for scaled, _ in runs])
    assert 0.8 < np.sqrt(np.mean(scaled**2)) < 1.2
    assert np.mean(np.abs(scaled) > 3) < 0.015
    assert 0.8 < np.mean([nees for _, nees in runs]) < 1.6


def test_independent_errors_need_no_larger_sigmas_and_correlated_ones_do() -> None:
    factor = [
        errors(SCENARIOS[name], 1)[2].diagnostics.noise["magnetometer.sigma_factor"] for name in ("alone", "correlated")
    ]
    assert factor[0] < 1.3
    assert factor[1] > 2.5


def test_noise_that_lengthens_vectors_leaves_the_scales_alone() -> None:
    """With 5 % noise least squares of |m| make the scales 0.5 % wrong, three of their sigmas."""
    scenario = FieldScenario(accelerometer=False, noise=2.4, duration_s=240.0)
    scaled = [errors(scenario, seed)[0] for seed in range(4)]
    assert np.abs(np.mean(scaled, axis=0)).max() < 2.0


def test_disturbed_stretches_are_named_and_left_out() -> None:
    scenario = FieldScenario(accelerometer=False, disturbances=2, disturbance=30.0)
    _, _, result = errors(scenario, 5)
    (found,) = [f for f in result.calibration.assessment.findings if f.code == "magnetometer-disturbed"]
    assert found.message.count(" s") >= 1
    table = result.diagnostics.triads["magnetometer"].poses
    assert not table.used.all()
    assert len(table.name) <= 400


def test_a_unit_that_changes_half_way_is_not_blamed_on_iron_nearby() -> None:
    recording, _ = simulate_magnetometer(FieldScenario(accelerometer=False), 8)
    imu = recording.imus["imu0"]
    values = imu.magnetometer.values.copy()
    values[3000:] *= 10.0
    changed = replace(imu, magnetometer=replace(imu.magnetometer, values=values))
    result = calibrate_magnetometer(replace(recording, imus={"imu0": changed}))
    (found,) = [f for f in result.calibration.assessment.findings if f.code == "magnetometer-disturbed"]
    assert "60.0" in found.message
    assert found.cure.startswith("See whether the unit, the range")


def test_alignment_to_the_accelerometer_and_dip_south_of_the_equator() -> None:
    scenario = FieldScenario(dip_deg=-38.0, misalignment_deg=40.0, rests=12, field=30.0)
    scaled, _, result = errors(scenario, 2, MagnetometerOptions(field=30.0))
    dip = result.diagnostics.dip
    assert np.abs(scaled).max() < 4.5
    assert abs(np.degrees(dip.estimated_rad) + 38.0) < 4 * np.degrees(dip.sigma_rad) < 1.0
    assert result.calibration.frame == "accel-x"
    assert len(dip.dip_rad) > 50


def test_soft_iron_is_estimated_with_the_sphere_beside_it() -> None:
    round_one = errors(FieldScenario(accelerometer=False, soft_iron=0.0, duration_s=60.0), 3)[2]
    bent_one = errors(FieldScenario(accelerometer=False, soft_iron=0.1, duration_s=60.0), 3)[2]
    trials = {trial.model: trial for trial in round_one.diagnostics.trials}
    assert set(trials) == {"full", "hard-iron"}
    assert trials["full"].chosen
    assert bent_one.calibration.assessment.model == round_one.calibration.assessment.model == "full"
    assert bent_one.calibration.assessment.holdout.field_rms < 0.01


@pytest.mark.parametrize("soft_iron", [0.0, 0.02])
def test_soft_iron_that_is_left_out_keeps_the_sigma_that_the_data_allow(soft_iron) -> None:
    scenario = FieldScenario(accelerometer=False, soft_iron=soft_iron, inhomogeneity=0.3)
    full = errors(scenario, 5)[2].calibration
    scaled, _, result = errors(scenario, 5, replace(IN_UT, model="hard-iron"))
    sphere = result.calibration
    assert np.abs(scaled).max() < 4.0
    for name in NAMES:
        assert np.all(sphere.sigma(name) >= 0.99 * full.sigma(name))
    codes = {finding.code for finding in sphere.assessment.findings if finding.severity == "warning"}
    assert ("soft-iron-left-out" in codes) == (soft_iron > 0)
    if soft_iron:
        assert sphere.verdict != "pass"


@pytest.mark.parametrize("stated", [{"dip": 64.0}, {"latitude": 48.0}])
@pytest.mark.parametrize("swap", [[0, 1, 2], [1, 0, 2]])
def test_axes_that_are_not_right_handed_show_in_the_sign_of_the_dip(stated, swap) -> None:
    recording, _ = simulate_magnetometer(FieldScenario(rests=6, duration_s=60.0), 4)
    imu = recording.imus["imu0"]
    swapped = replace(imu, magnetometer=replace(imu.magnetometer, values=imu.magnetometer.values[:, swap]))
    result = calibrate_magnetometer(Recording(imus={"imu0": swapped}), replace(IN_UT, **stated))
    found = {f.code: f.severity for f in result.calibration.assessment.findings}
    assert found["magnetometer-handedness"] == ("good" if swap == [0, 1, 2] else "problem")


@pytest.mark.parametrize("latitude", [None, 5.0])
def test_handedness_that_was_not_checked_is_said(latitude) -> None:
    recording, _ = simulate_magnetometer(FieldScenario(rests=6, duration_s=60.0), 4)
    result = calibrate_magnetometer(recording, replace(IN_UT, latitude=latitude))
    found = {f.code: f.severity for f in result.calibration.assessment.findings}
    assert found["magnetometer-handedness"] == "info"


def test_a_field_from_below_with_turned_axes_warns_where_nothing_tells_the_handedness() -> None:
    recording, _ = simulate_magnetometer(FieldScenario(rests=6, duration_s=60.0), 4)
    imu = recording.imus["imu0"]
    negated = replace(imu.magnetometer, values=imu.magnetometer.values * [1.0, -1.0, 1.0])
    result = calibrate_magnetometer(Recording(imus={"imu0": replace(imu, magnetometer=negated)}), IN_UT)
    assert result.calibration.verdict == "warn"
    found = {f.code: f.severity for f in result.calibration.assessment.findings}
    assert found["magnetometer-handedness"] == "warning"


def test_hard_iron_model_has_one_scale() -> None:
    scenario = FieldScenario(accelerometer=False, soft_iron=0.0)
    scaled, _, result = errors(scenario, 4, replace(IN_UT, model="hard-iron"))
    sensitivity = result.calibration.parameter(NAMES[0])
    np.testing.assert_allclose(sensitivity, sensitivity[0, 0] * np.eye(3))
    assert np.abs(scaled).max() < 4.0


def test_field_is_the_unit_where_it_was_not_stated() -> None:
    recording, truth = simulate_magnetometer(FieldScenario(accelerometer=False), 1)
    one = calibrate_magnetometer(recording).calibration
    other = calibrate_magnetometer(recording, IN_UT).calibration
    assert one.imus["imu0"].magnetometer.field_unit == "local field"
    assert other.imus["imu0"].magnetometer.field_unit == "uT"
    np.testing.assert_allclose(one.parameter(NAMES[0]), 48.0 * other.parameter(NAMES[0]), rtol=1e-4, atol=1e-4)
    strength = np.linalg.norm(one.imus["imu0"].apply(recording.imus["imu0"]).magnetometer.values, axis=1)
    assert np.median(strength) == pytest.approx(1.0, abs=2e-3)
    assert truth.frame == "mag-x"


def test_a_prior_of_the_accelerometer_brings_the_frames_closer() -> None:
    scenario = FieldScenario(hand_acceleration=0.5)
    recording, truth = simulate_magnetometer(scenario, 6)
    plain = calibrate_magnetometer(recording, IN_UT).calibration
    options = replace(IN_UT, prior=("imu0.accelerometer.bias=0.001", "imu0.accelerometer.sensitivity=0.0005"))
    known, _ = simulate_magnetometer(scenario, 6)
    told = calibrate_magnetometer(known, options, prior=_exact(truth)).calibration
    assert told.sigma(NAMES[0]).max() < plain.sigma(NAMES[0]).max()
    assert {f.code for f in told.assessment.findings} >= {"prior-used"}


def test_a_prior_in_another_frame_ends_in_the_own_one_without_accelerometer(tmp_path) -> None:
    recording, _ = simulate_magnetometer(FieldScenario(), 7)
    both = calibrate_magnetometer(recording, IN_UT).calibration
    imu = recording.imus["imu0"]
    nothing = replace(imu.accelerometer, t_ns=imu.accelerometer.t_ns[:0], values=imu.accelerometer.values[:0])
    bare = replace(recording, imus={"imu0": replace(imu, accelerometer=nothing)})
    told = calibrate_magnetometer(bare, IN_UT, prior=both).calibration
    plain = calibrate_magnetometer(bare, IN_UT).calibration
    assert told.frame == plain.frame == "mag-x"
    np.testing.assert_allclose(told.parameter(NAMES[0]), plain.parameter(NAMES[0]), atol=3e-3)
    gnomon.save(told, tmp_path / "calibration.yaml")
    assert gnomon.load(tmp_path / "calibration.yaml").frame == "mag-x"


def _exact(truth):
    imu = truth.imus["imu0"]
    names = gnomon.results.calibration.covariance_names({"imu0": replace(imu, magnetometer=None, gyroscope=None)})
    return replace(
        truth,
        imus={"imu0": replace(imu, magnetometer=None, gyroscope=None)},
        uncertainty=gnomon.Covariance(names=names, matrix=1e-8 * np.eye(len(names))),
    )


# ---- bad input ----


def alone(values, rate_hz=50.0):
    t_ns = np.rint(np.arange(len(values)) * 1e9 / rate_hz).astype(np.int64)
    nothing = TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="m/s^2")
    mag = TriadSamples(t_ns=t_ns, values=values, unit="uT")
    return Recording(imus={"imu0": ImuSamples(accelerometer=nothing, gyroscope=nothing, magnetometer=mag)})


@pytest.mark.parametrize("seed", [2, 4])
def test_a_cap_of_the_sphere_met_now_and_then_fails_in_words(seed) -> None:
    recording = simulate_magnetometer(FieldScenario(accelerometer=False, rests=8, inhomogeneity=0.2), seed)[0]
    imu = recording.imus["imu0"]
    away = imu.magnetometer.values - imu.magnetometer.values.mean(axis=0)
    near = away[:, 2] > 0.8 * np.linalg.norm(away, axis=1)
    cap = replace(imu.magnetometer, t_ns=imu.magnetometer.t_ns[near], values=imu.magnetometer.values[near])
    calibration = calibrate_magnetometer(Recording(imus={"imu0": replace(imu, magnetometer=cap)}), IN_UT).calibration
    assert calibration.verdict == "fail"
    assert "not-observable" in {one.code for one in calibration.assessment.findings}


def test_what_cannot_be_calibrated_is_refused_in_words() -> None:
    still = simulate_magnetometer(FieldScenario(motion="still", accelerometer=False), 1)[0]
    flat = simulate_magnetometer(FieldScenario(motion="one-axis", accelerometer=False), 1)[0]
    short = simulate_magnetometer(FieldScenario(duration_s=1.0, accelerometer=False), 1)[0]
    good = simulate_magnetometer(FieldScenario(accelerometer=False), 1)[0].imus["imu0"].magnetometer.values
    stuck = good.copy()
    stuck[:, 1] = 3.0
    for recording, kind, words in (
        (still, DetectionError, "one orientation"),
        (flat, DetectionError, "one axis only"),
        (short, RecordingError, "too short"),
        (alone(stuck), RecordingError, "axis y never changes"),
        (gnomon.simulate(gnomon.Scenario(intervals=3, t_init_s=5.0), 1)[0], RecordingError, "no magnetometer"),
    ):
        with pytest.raises(kind, match=words):
            calibrate_magnetometer(recording)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"field": 48_000.0}, "nowhere on Earth"),
        ({"magnetometer_range": -1.0}, "greater than zero"),
        ({"dip": 100.0}, "not between -90 and 90"),
        ({"latitude": -91.0}, "from -90 to 90"),
        ({"fix": ("imu0.magnetometer.sensitivity",)}, "--field"),
        ({"fix": ("imu0.magnetometer.bios",)}, "Did you mean"),
        ({"prior": ("imu0.magnetometer.bias=1",), "model": "hard-iron"}, "takes no prior"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(options, words) -> None:
    recording, _ = simulate_magnetometer(FieldScenario(accelerometer=False, duration_s=30.0), 1)
    with pytest.raises(OptionError, match=words):
        calibrate_magnetometer(recording, MagnetometerOptions(**options))


def test_a_bias_that_is_held_stays() -> None:
    recording, _ = simulate_magnetometer(FieldScenario(accelerometer=False, hard_iron=0.0), 1)
    held = calibrate_magnetometer(recording, replace(IN_UT, fix=("imu0.magnetometer.bias",))).calibration
    np.testing.assert_array_equal(held.parameter(NAMES[1]), 0.0)
    np.testing.assert_array_equal(held.sigma(NAMES[1]), 0.0)


def test_a_few_attitudes_are_not_a_usable_calibration() -> None:
    whole = simulate_magnetometer(FieldScenario(accelerometer=False, duration_s=120.0), 1)[0]
    values = whole.imus["imu0"].magnetometer.values
    centre = values.mean(axis=0)
    cap = values[(values - centre)[:, 2] > 35.0]
    result = calibrate_magnetometer(alone(cap))
    codes = {finding.code: finding.severity for finding in result.calibration.assessment.findings}
    assert codes["magnetometer-coverage"] == "warning"
    assert result.calibration.verdict != "pass"


def test_clipped_samples_are_masked() -> None:
    recording, truth = simulate_magnetometer(FieldScenario(accelerometer=False, magnetometer_range=50.0), 3)
    result = calibrate_magnetometer(recording, replace(IN_UT, magnetometer_range=50.0))
    assert "saturation" in {finding.code for finding in result.calibration.assessment.findings}
    error = result.calibration.parameter(NAMES[1]) - truth.parameter(NAMES[1])
    assert np.abs(error).max() < 0.3


# ---- real recordings ----


def spread(values):
    """Return spread and robust spread of strengths, relative to their middle."""
    middle = np.median(values)
    return np.std(values) / np.mean(values), 1.4826 * np.median(np.abs(values - middle)) / middle


def in_means(values, count):
    whole = len(values) // count * count
    return values[:whole].reshape(-1, count, 3).mean(axis=1)


def test_qmc5883l_beside_its_published_parameters(real_data) -> None:
    """The published parameters are the least squares of |m|, and no others can have a smaller spread of single samples.

    Two thirds of that spread is the noise of the sensor, 57 counts, which lengthens short axes more than long ones and
    draws least squares away from the ellipsoid. Where the noise is averaged, the spread is smaller than the published.
    """
    recording = gnomon.read(real_data("qmc5883l-mag/noisy_raw_data.csv"))
    assert recording.imus["imu0"].magnetometer.rate_hz == 50.0
    assert any("50 Hz as its preamble says" in note for note in recording.assumptions)
    samples = recording.imus["imu0"].magnetometer.values[3000:]
    numbers = np.loadtxt(real_data("qmc5883l-mag/published_parameters_mag.csv"))
    published_a, published_b = numbers[:9].reshape(3, 3), numbers[9:]
    result = calibrate_magnetometer(recording)
    magnetometer = result.calibration.imus["imu0"].magnetometer
    assert np.allclose(magnetometer.bias, [6158.6, 252.7, 3445.6], atol=10.0)
    for count, room in ((1, 1.006), (5, 1.0), (10, 1.0)):
        m = in_means(samples, count)
        theirs = spread(np.linalg.norm(m @ published_a.T + published_b, axis=1))
        ours = spread(np.linalg.norm(magnetometer.magnetic_field(m), axis=1))
        assert ours[0] <= room * theirs[0]
        assert ours[1] <= (room + 0.01) * theirs[1]
    assert result.calibration.verdict == "pass"
    assert result.calibration.frame == "mag-x"


def test_hmc5883l_beside_an_mpu6050(real_data) -> None:
    recording = gnomon.read(real_data("mpu6050-hmc5883l/set-2__full-sphere.npz"))
    imu = recording.imus["imu0"]
    assert (imu.accelerometer.unit, imu.gyroscope.unit, imu.magnetometer.unit) == ("g", "deg/s", "gauss")
    result = calibrate_magnetometer(recording)
    calibration = result.calibration
    magnetometer = calibration.imus["imu0"].magnetometer
    strength = np.linalg.norm(magnetometer.magnetic_field(imu.magnetometer.values), axis=1)
    assert spread(strength)[0] < 0.00465  # an algebraic fit: 0.46 %
    centre = np.array([-0.0065, -0.1054, 0.0203])
    assert np.all(np.abs(magnetometer.bias - centre) < 4 * calibration.sigma(NAMES[1]))
    # Germany's dip is 64 to 68 deg; this accelerometer shows -1 g up.
    assert np.degrees(result.diagnostics.dip.estimated_rad) == pytest.approx(-65.5, abs=1.0)
    assert calibration.frame == "accel-x"
    # The module stands on its board as the accelerometer does, to a few degrees.
    share = magnetometer.sensitivity / np.linalg.norm(magnetometer.sensitivity, axis=1, keepdims=True)
    assert np.diag(share).min() > 0.98


# ---- parts ----


def test_poses_follow_the_way_of_the_field_not_the_time() -> None:
    rng = np.random.default_rng(1)
    angle = np.concatenate([np.zeros(2000), np.linspace(0, np.pi, 1000), np.full(2000, np.pi)])
    t = np.arange(len(angle)) / 100
    true = 40.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    values = true + 0.1 * rng.standard_normal(true.shape)
    usable = np.ones(len(t), bool)
    usable[100:120] = False
    poses = field_poses(t, values, usable, Ellipsoid(correction=np.eye(3) / 40, bias=np.zeros(3)))
    assert 60 < len(poses) < 160  # 180 deg by 2 deg, and the rests in pieces of 5 s
    assert poses.samples.sum() == usable.sum()
    np.testing.assert_allclose(sample_noise(values), 0.1, rtol=0.1)
    strength = np.linalg.norm(poses.measured, axis=1) / 40
    assert np.all(np.abs(strength - poses.length) < 5 * 0.1 / 40 / np.sqrt(poses.samples) + 1e-4)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_rough_ellipsoid_withstands_outliers(share) -> None:
    rng = np.random.default_rng(2)
    u = rng.standard_normal((5000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    shape = np.array([[50.0, 0, 0], [4, 45, 0], [-3, 2, 55]])
    values = u @ shape.T + [100.0, -40, 7] + 0.2 * rng.standard_normal((5000, 3))
    bad = rng.random(5000) < share
    values[bad] += rng.uniform(20, 80, (int(bad.sum()), 3))
    found, usual = rough_ellipsoid(values)
    np.testing.assert_allclose(found.bias, [100.0, -40, 7], atol=1.0)
    np.testing.assert_allclose(np.linalg.inv(found.correction), shape, atol=1.5)
    assert usual < 0.05


def test_blocks_tell_the_sigma_of_a_mean_with_memory() -> None:
    """The mean of an autoregressive series: its variance is known, and some fifty times that of independent errors."""
    from scipy.signal import lfilter

    t = np.arange(0, 400, 0.05)
    keep = np.exp(-0.05 / 1.0)
    truth = np.sqrt((1 + keep) / (1 - keep) / len(t))
    found = []
    for seed in range(20):
        drive = np.random.default_rng(seed).standard_normal(len(t)) * np.sqrt(1 - keep**2)
        series = lfilter([1.0], [1.0, -keep], drive)
        residual = series - series.mean()
        stage = Stage(residual=residual, jacobian=-np.ones((len(t), 1)), covariance=np.array([[1 / len(t)]]))
        memory = memory_s(t, residual)
        assert 1.0 < memory < 6.0
        blocks = TimeBlocks.of(t, memory)
        assert blocks.long_enough
        moves = leave_blocks_out([stage], blocks.block)
        found.append(np.sqrt(block_covariance([stage], blocks, moves)[0, 0]))
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(truth, rel=0.2)


def test_leaving_a_block_out_is_fitting_without_it() -> None:
    rng = np.random.default_rng(3)
    a, y = rng.standard_normal((60, 3)), rng.standard_normal(60)
    x = np.linalg.lstsq(a, y, rcond=None)[0]
    block = np.repeat(np.arange(6), 10)
    stage = Stage(residual=a @ x - y, jacobian=a, covariance=np.linalg.inv(a.T @ a))
    moves = leave_blocks_out([stage], block)
    for k in range(6):
        kept = block != k
        np.testing.assert_allclose(moves[k], np.linalg.lstsq(a[kept], y[kept], rcond=None)[0] - x, atol=1e-12)


def test_rotation_and_dip_from_directions_alone() -> None:
    rng = np.random.default_rng(4)
    attitude = rotation_from_rotvec(rng.uniform(-3, 3, (400, 3)))
    turn = rotation_from_rotvec(np.array([0.4, -1.2, 2.0]))
    dip = np.radians(50.0)
    up = np.swapaxes(attitude, 1, 2) @ np.array([0.0, 0.0, 1.0])
    field = np.swapaxes(attitude, 1, 2) @ np.array([np.cos(dip), 0.0, -np.sin(dip)]) @ turn
    up[::10] = rng.standard_normal((40, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    nothing = np.zeros((400, 3, 0))
    found = fit_dip(up, field, np.full(400, 1e-6), np.ones(400, bool), by_up=nothing, by_field=nothing)
    assert np.abs(rotvec_from_rotation(found.rotation @ turn.T)).max() < 1e-5
    assert found.dip_rad == pytest.approx(dip, abs=1e-5)
    assert (found.weight[::10] == 0).mean() > 0.9
