"""Blocks of parameters that change in the middle of a recording: what is found, how often by chance, how it is told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fdtrc

import gnomon
from gnomon.assess.changes import change_findings, with_changes
from gnomon.estimate.trust import changes
from gnomon.estimate.trust.changes import f_tail, parameter_changes
from gnomon.estimate.trust.clusters import ClusterSums
from gnomon.formats.own.calibration_file import load
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.options.requirements import USES
from gnomon.results.trust import ParameterChange, QuantityChange, Trust

SIZES = {"imu0.gyroscope.sensitivity": 4, "imu0.gyroscope.bias": 3, "imu0.accelerometer.sensitivity": 3}
NAMES = [f"{path}[{k}]" for path, size in SIZES.items() for k in range(size)]
P = len(NAMES)
ROWS = 4


def pulls(seed, n=40, changed=None, share=None, memory=0.0, noise=1.0, beside=0):
    """Return the sums of `n` stretches at their minimum, of which a share has other parameters."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(n, ROWS, P))
    if beside:  # parameters that no scalar shows, and that look like the others in part
        unseen = rng.normal(size=(n, ROWS, beside)) + rows @ rng.normal(size=(P, beside)) / P
        rows = np.concatenate([rows, unseen], axis=2)
    error = noise * rng.normal(size=(n, ROWS))
    for k in range(1, n):
        error[k] = memory * error[k - 1] + np.sqrt(1 - memory**2) * error[k]
    if changed is not None:
        error = error + np.einsum("nip,p,n->ni", rows[:, :, :P], changed, share)
    information = np.swapaxes(rows, 1, 2) @ rows
    whole = np.linalg.solve(information.sum(axis=0), np.einsum("nip,ni->p", rows, error))
    return ClusterSums(
        t_s=np.arange(n) * 2.0,
        pull=np.einsum("nip,ni->np", rows, error - rows @ whole),
        information=information,
        prior_pull=np.zeros(P + beside),
        prior_information=np.zeros((P + beside, P + beside)),
    )


def found(sums, **options):
    return parameter_changes(sums, np.eye(P, sums.pull.shape[1]), NAMES, biases=("imu0.gyroscope.bias",), **options)


def step(at, n=40):
    return (np.arange(n) >= at) * 1.0


def only(path, values):
    changed = np.zeros(P)
    start = NAMES.index(f"{path}[0]")
    changed[start : start + len(values)] = values
    return changed


@pytest.mark.parametrize("options", [{}, {"memory": 0.6}, {"noise": 5.0}, {"n": 14}], ids=str)
def test_nothing_is_found_where_nothing_changed(options):
    assert [found(pulls(seed, **options)) for seed in range(12)] == [()] * 12


def test_parameters_that_no_scalar_shows_make_no_difference_when_only_their_common_ways_are_kept(monkeypatch):
    block = "imu0.gyroscope.sensitivity"
    sums = pulls(3, n=150, changed=only(block, [0.8, -0.5, 0.4, 0.6]), share=step(80, 150), beside=60)
    quick = found(sums)
    monkeypatch.setattr("gnomon.estimate.trust.changes._followed", lambda sums, jacobian: (sums, jacobian))
    exact = found(sums)
    assert [one.block for one in quick] == [one.block for one in exact] == [block]
    sigma = np.sqrt(np.diag(exact[0].covariance))
    assert quick[0].where == exact[0].where
    assert np.abs(quick[0].values - exact[0].values).max() < 0.1 * sigma.min()
    np.testing.assert_allclose(np.sqrt(np.diag(quick[0].covariance)), sigma, rtol=0.08)
    assert [found(pulls(seed, n=150, beside=60)) for seed in range(4)] == [()] * 4


def test_nothing_is_found_where_a_change_takes_all_data_up():
    """Beside ten parameters and a change of four, fourteen single rows leave nothing that shows how they scatter."""
    n = 14
    rng = np.random.default_rng(1)
    for _ in range(5):
        rows = rng.normal(size=(n, 1, P))
        error = rng.normal(size=(n, 1))
        information = np.swapaxes(rows, 1, 2) @ rows
        whole = np.linalg.solve(information.sum(axis=0), np.einsum("nip,ni->p", rows, error))
        sums = ClusterSums(
            t_s=np.arange(n) * 2.0,
            pull=np.einsum("nip,ni->np", rows, error - rows @ whole),
            information=information,
            prior_pull=np.zeros(P),
            prior_information=np.zeros((P, P)),
        )
        assert found(sums) == ()


@pytest.mark.parametrize("noise", [1.0, 0.1], ids=["as stated", "levels inflated tenfold by the change"])
def test_a_change_is_found_where_it_is_with_its_size(noise):
    """Noise levels that a change inflates make all information look smaller; the scatter that is left shows it."""
    truth = np.array([1.5, -1.0, 0.5, 1.0]) * noise
    z = []
    for seed in range(5):
        first, *others = found(
            pulls(seed, changed=only("imu0.gyroscope.sensitivity", truth), share=step(23), noise=noise)
        )
        assert (first.block, others) == ("imu0.gyroscope.sensitivity", [])
        assert first.chance < 1e-3
        assert 40 < float(first.where.split()[1]) < 50
        assert first.names == tuple(NAMES[:4])
        z += list((first.values - truth) / np.sqrt(np.diag(first.covariance)))
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.7


@pytest.mark.parametrize(
    ("share", "words"),
    [(np.arange(40) / 39, "steadily"), (np.arange(40) % 2, "every other"), (step(12) - step(28), "between")],
    ids=["drift", "alternating", "for a while"],
)
def test_other_courses_of_a_change(share, words):
    changed = only("imu0.accelerometer.sensitivity", [2.5, 1.5, -2.5])
    (one,) = found(pulls(3, changed=changed, share=share))
    assert one.block == "imu0.accelerometer.sensitivity"
    assert one.where.startswith(words)


@pytest.mark.parametrize(("size", "blocks"), [(8.0, {"imu0.accelerometer.sensitivity"}), (0.0, set())], ids=str)
def test_two_kinds_of_views_in_no_order_are_told_where_each_view_may_be_another(size, blocks):
    second = (np.random.default_rng(7).random(40) < 0.3) * 1.0
    changed = only("imu0.accelerometer.sensitivity", [size, -size, size])
    for seed in range(3):
        changes = found(pulls(seed, changed=changed, share=second), order=np.arange(40))
        assert {one.block for one in changes} == blocks
        for one in changes:
            assert one.where == f"in {int(second.sum())} of 40, in no order"
            z = (np.abs(one.values) - size) / np.sqrt(np.diag(one.covariance))
            assert np.abs(z).max() < 4


def test_views_that_scatter_in_a_block_are_no_two_kinds():
    """Errors of each view's own look like a lens of each view's own; only two kinds are a change."""
    rng = np.random.default_rng(11)
    sums = pulls(4)
    own = np.concatenate([rng.normal(scale=4.0, size=(40, 4)), np.zeros((40, P - 4))], axis=1)
    pull = sums.pull + np.einsum("npq,nq->np", sums.information, own)
    step = np.linalg.solve(sums.total, pull.sum(axis=0))
    assert not found(replace(sums, pull=pull - sums.information @ step), order=np.arange(40))


def test_two_changes_are_told_apart():
    sums = pulls(5, changed=only("imu0.accelerometer.sensitivity", [2.0, 2.0, 2.0]), share=step(15))
    other = pulls(5, changed=only("imu0.gyroscope.sensitivity", [1.5, 1.5, 1.5, 1.5]), share=step(25))
    clean = pulls(5)
    both = replace(sums, pull=sums.pull + other.pull - clean.pull)
    assert {one.block for one in found(both)} == {"imu0.accelerometer.sensitivity", "imu0.gyroscope.sensitivity"}


def at_once():
    return ParameterChange(
        block="x.sensitivity", names=("x.sensitivity[0]",), values=np.ones(1), covariance=np.eye(1),
        where="after 3 s, against the time before", chance=1e-9, at_s=3.0,
    )  # fmt: skip


def test_what_is_found_at_once_counts_where_its_block_shows_no_change_otherwise():
    shift = replace(at_once(), block="imu0.accelerometer.sensitivity")
    assert found(pulls(1), by_cause=lambda: shift) == (shift,)
    assert found(pulls(1), by_cause=lambda: None) == ()
    (own,) = found(pulls(4, changed=only(shift.block, [2.0, 2.0, 2.0]), share=step(20)), by_cause=lambda: shift)
    assert own is not shift


def test_a_bias_that_wanders_is_no_change_and_hides_none():
    wandering = pulls(1, changed=only("imu0.gyroscope.bias", [8.0, -8.0, 8.0]), share=step(20))
    assert found(wandering) == ()
    assert found(pulls(1), judged=np.zeros(P, dtype=bool)) == ()


def test_errors_that_outlast_all_clusters_are_no_change():
    """A lens that the model does not describe errs by where the board is: one way in each part, for any length."""
    rng = np.random.default_rng(2)
    n = 108
    slow = np.repeat(rng.normal(size=(12, P)), 9, axis=0)
    sums = pulls(2, n=n)
    bent = replace(sums, pull=sums.pull + np.einsum("npq,nq->np", sums.information, slow - slow.mean(axis=0)))
    whole = np.linalg.solve(bent.total, bent.pull.sum(axis=0))
    bent = replace(bent, pull=bent.pull - bent.information @ whole)
    assert found(bent) == ()


@pytest.mark.parametrize("seed", range(6))
def test_what_spares_the_scatter_is_never_above_how_often_chance_makes_a_change(seed):
    sums = pulls(seed, memory=0.4)
    scan = changes._Scan(sums=sums, wandering=None, looks=1)
    blocks, _ = changes._blocks(sums, np.eye(P), NAMES, np.ones(P, dtype=bool), ())
    for block in blocks:
        cut = changes._at(sums.t_s, 15)
        estimate = scan._estimate(block, cut)
        assert estimate is not None
        assert scan._explained([block], [cut])[0, 0] == pytest.approx(float(estimate.w @ estimate.w), rel=1e-5)
        for cluster in changes._clusters(len(sums)):
            exact = changes._chance_with(estimate, cluster, 0.0, lasting=False)
            assert changes._chance_with(estimate, cluster, 1e-300, lasting=False) <= exact * (1 + 1e-9)


def test_too_few_stretches_tell_nothing():
    assert found(pulls(0, n=9, changed=np.full(P, 50.0), share=step(5, 9))) == ()


CHANGE = QuantityChange(
    block="imu0.gyroscope.sensitivity", quantity="gyroscope_misalignment", sensor="imu0", size=np.radians(0.1),
    sigma=np.radians(0.01), where="after 61.2 s, against the time before",
)  # fmt: skip


@pytest.mark.parametrize(
    ("degrees", "use", "severity"),
    [
        (0.1, None, "info"),
        (0.2, None, "warning"),
        (2.0, None, "problem"),
        (0.11, "vio", "warning"),
        (0.1, "ahrs", "info"),
    ],
)
def test_a_change_is_held_against_what_the_use_needs(degrees, use, severity):
    change = replace(CHANGE, size=np.radians(degrees))
    (finding,) = change_findings([change], None if use is None else USES[use])
    assert (finding.code, finding.severity) == ("parameter-changed", severity)
    assert f"the gyroscope axes by {degrees:.2g} +- 0.01 deg" in finding.message
    assert "after 61.2 s" in finding.message
    assert bool(finding.cure) == (severity != "info")


def test_a_time_shift_that_changes_at_once_is_a_clock_that_jumped():
    jump = replace(
        CHANGE, block="cam0.time_shift_cam_imu", quantity="time_shift", sensor="cam0", size=8e-3, sigma=1e-4, at_s=61.2
    )
    (finding,) = change_findings([jump], None)
    assert (finding.code, finding.severity, finding.subject) == ("clock-jump", "problem", jump.block)
    assert "near 61.2 s: the time shift of cam0 by 8 +- 0.1 ms" in finding.message
    knocked = replace(jump, block="cam0.T_cam_imu.rotation", quantity="camera_rotation", size=0.03)
    both = list(change_findings([jump, knocked], None))  # as where images of two cameras are exchanged from then on
    assert [one.code for one in both] == ["parameter-changed"] * 2
    assert all("of one sensor throughout" in one.cure for one in both)
    elsewhere = replace(knocked, sensor="cam1", block="cam1.T_cam_imu.rotation")
    assert [one.code for one in change_findings([jump, elsewhere], None)] == ["clock-jump", "parameter-changed"]
    (finding,) = change_findings([replace(jump, at_s=None)], None)  # a clock that drifts
    assert finding.code == "parameter-changed"
    (finding,) = change_findings([jump], USES["ahrs"])
    assert (finding.code, finding.severity) == ("parameter-changed", "info")


def test_what_a_use_does_not_ask_for_is_no_fault():
    shift = replace(CHANGE, block="cam0.T_cam_imu.translation", quantity="camera_translation", sensor="cam0", size=0.1)
    (finding,) = change_findings([shift], USES["gimbal"])
    assert finding.severity == "info"
    assert "gimbal does not ask for it" in finding.message
    (finding,) = change_findings([shift], None)
    assert finding.severity == "problem"


@pytest.fixture(scope="module")
def remounted():
    """Return a calibration from a recording in whose middle the gyroscope was turned by a degree."""
    recording, truth = gnomon.simulate(gnomon.Scenario(intervals=24, t_init_s=20.0), seed=3)
    samples, sensor = recording.imus["imu0"], truth.imus["imu0"].gyroscope
    angle = np.radians(1.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    true_rate = (samples.gyroscope.values - sensor.bias) @ np.linalg.inv(sensor.sensitivity).T
    turned = true_rate @ turn.T @ sensor.sensitivity.T + sensor.bias
    t_s = samples.gyroscope.t_s
    rate = np.where((t_s > t_s.mean())[:, None], turned, samples.gyroscope.values)
    return gnomon.calibrate_imu(gnomon.Recording.from_arrays(t_s, rate, samples.accelerometer.values)).calibration


def test_scatter_of_rotations_beyond_the_noise_at_rest_is_named(remounted):
    """A degree in the middle of the recording makes rotations scatter by ten times their noise."""
    assert "beyond-noise" in {finding.code for finding in remounted.assessment.findings}
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=24, t_init_s=20.0), seed=4)
    healthy = gnomon.calibrate_imu(recording).calibration.assessment
    assert not {"beyond-noise", "parameter-changed"} & {finding.code for finding in healthy.findings}


def test_a_remounted_gyroscope_is_named(remounted, tmp_path):
    assert remounted.verdict != "pass"
    (finding,) = [f for f in remounted.assessment.findings if f.code == "parameter-changed"]
    assert "gyroscope axes" in finding.message
    (change,) = remounted.assessment.trust.changes
    assert change.quantity == "gyroscope_misalignment"
    assert abs(change.size - np.radians(1.0)) < 4 * change.sigma
    (tmp_path / "calibration.yaml").write_text(calibration_text(remounted), encoding="utf-8")
    again = load(tmp_path / "calibration.yaml")
    assert again.assessment.trust.changes == remounted.assessment.trust.changes
    assert "schema: gnomon/1.6" in (tmp_path / "calibration.yaml").read_text(encoding="utf-8")
    judged = gnomon.judge(again, "vio")
    assert [f.code for f in judged.assessment.findings].count("parameter-changed") == 1
    assert gnomon.judge(judged, "general").assessment.verdict == remounted.verdict


def test_a_change_of_a_lens_is_told_in_pixels(lens_result):
    calibration = replace(lens_result.calibration, assessment=replace(lens_result.calibration.assessment))
    names = tuple(f"cam0.intrinsics[{k}]" for k in range(4))
    shift = ParameterChange(
        block="cam0.intrinsics", names=names, values=np.array([0.0, 0.0, 3.0, 4.0]), covariance=np.diag([1e-2] * 4),
        where="after 31.5 s, against the time before", chance=1e-9,
    )  # fmt: skip
    trust = Trust(clusters=None, names=(), ordinary_sigma=np.zeros(0), sigma=np.zeros(0), changes=(shift,))
    told = with_changes(calibration, trust)
    (change,) = told.assessment.trust.changes
    assert (change.quantity, change.size) == ("lens", pytest.approx(5.0, rel=1e-6))
    assert change.sigma == pytest.approx(0.1, rel=1e-3)
    assert told.verdict == "fail"
    assert with_changes(calibration, None) is calibration


@pytest.fixture(scope="module")
def lens_result():
    from gnomon.simulate import CamerasScenario, simulate_cameras

    simulated = simulate_cameras(CamerasScenario(views=12), 1)
    return gnomon.calibrate_cameras(simulated.recording, simulated.target)


@pytest.mark.parametrize("first", [1, 2, 9])
@pytest.mark.parametrize("second", [1.0, 7.3, 4000.0])
def test_tails_of_f_are_those_of_scipy(first, second):
    for x in (1e-3, 0.3, 1.0, 4.0, 60.0):
        assert f_tail(x, first, second) == pytest.approx(float(fdtrc(first, second, x)), rel=1e-10)
    assert f_tail(0.0, first, second) == 1.0
    assert f_tail(np.inf, first, second) == 0.0
