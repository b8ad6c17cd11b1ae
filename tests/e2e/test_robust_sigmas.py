"""Simulated multi-position recordings whose errors are not independent: do the published sigmas hold?

`pytest tests/e2e/test_robust_sigmas.py -m slow -s` prints the table of the whole study.
"""

import numpy as np
import pytest
from scipy.signal import lfilter

import gnomon
from gnomon.results.calibration import calibration_parameters

SCENARIO = gnomon.Scenario(g_sensitivity=1e-4, earth_rate_latitude=45.0)
OPTIONS = gnomon.ImuOptions(gravity=9.80665, latitude=45.0, model="g-sensitivity")
PARAMETERS = 30
KINDS = ("white", "tremor", "drift", "20 s")
"""tremor: the hand shakes during rests, with memories of 0.5 s and 0.1 s. drift: both biases drift steadily by 0.5 and
0.1 times what is usual from one switching on to the next. 20 s: biases wander with a memory of 20 s."""


def wandering(rng, n, dt_s, memory_s, sigma):
    decay = np.exp(-dt_s / memory_s)
    drive = sigma * np.sqrt(1 - decay**2) * rng.standard_normal((n, 3))
    drive[0] = sigma * rng.standard_normal(3)
    return lfilter([1.0], [1.0, -decay], drive, axis=0)


def added(kind, rng, t_s):
    """Return what is added to specific force and rate, and whether it belongs to the biases of this recording."""
    n, dt_s = len(t_s), float(np.median(np.diff(t_s)))
    if kind == "tremor":
        return wandering(rng, n, dt_s, 0.5, 1e-2), wandering(rng, n, dt_s, 0.1, 5e-3), False
    if kind == "20 s":
        return wandering(rng, n, dt_s, 20.0, 2e-3), wandering(rng, n, dt_s, 20.0, 4e-4), True
    time = ((t_s - t_s.mean()) / np.ptp(t_s))[:, None]
    return time * rng.normal(0, 5e-3, 3), time * rng.normal(0, 1e-3, 3), True


def calibrated(seed, kind):
    """Return errors in units of the published sigmas and of those for independent errors, (2, 30)."""
    recording, truth = gnomon.simulate(SCENARIO, seed)
    shift = np.zeros(33)
    if kind != "white":
        samples = recording.imus["imu0"]
        t_s = samples.accelerometer.t_s
        force, rate, of_bias = added(kind, np.random.default_rng(seed + 1_000_000), t_s)
        if of_bias:  # the bias of a recording is its mean
            shift[9:12], shift[21:24] = force.mean(axis=0), rate.mean(axis=0)
        recording = gnomon.Recording.from_arrays(
            t_s, samples.gyroscope.values + rate, samples.accelerometer.values + force
        )
    result = gnomon.calibrate_imu(recording, OPTIONS)
    calibration, trust = result.calibration, result.diagnostics.trust
    pairs = zip(calibration_parameters(calibration.imus), calibration_parameters(truth.imus), strict=True)
    errors = np.concatenate([(found - true).ravel() for (_, found), (_, true) in pairs]) - shift
    free = np.diag(calibration.uncertainty.matrix) > 0
    assert free.sum() == PARAMETERS
    np.testing.assert_allclose(trust.sigma, np.sqrt(np.diag(calibration.uncertainty.matrix))[free], rtol=1e-9)
    disagrees = any(finding.code == "parts-disagree" for finding in calibration.assessment.findings)
    return errors[free] / trust.sigma, errors[free] / trust.ordinary_sigma, disagrees


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def study(seeds, kind):
    found = [calibrated(seed, kind) for seed in seeds]
    robust, ordinary = (np.array([one[k] for one in found]) for k in (0, 1))
    parts = {"S_a": slice(0, 6), "b_a": slice(6, 9), "S_g": slice(9, 18), "b_g": slice(18, 21), "G": slice(21, 30)}
    by_block = {name: (rms(robust[:, part]), rms(ordinary[:, part])) for name, part in parts.items()}
    told = ", ".join(f"{name} {ours:.2f} ({theirs:.2f})" for name, (ours, theirs) in by_block.items())
    print(
        f"\n{len(found)} x {kind}: error / sigma {rms(robust):.2f}, independent errors {rms(ordinary):.2f}; {told}; "
        f"parts disagree in {sum(one[2] for one in found)}"
    )
    return by_block, found


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize("kind", ["white", "drift"])
def test_sigmas_hold(kind):
    by_block, found = study(range(8), kind)
    assert all(0.5 < ours < 1.6 for ours, _ in by_block.values())
    assert sum(one[2] for one in found) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_sigmas_hold_in_a_hundred_recordings(kind):
    by_block, found = study(range(500, 600), kind)
    # A drift of the gyroscope that joins the model makes its bias the surer the longer its memory is taken for.
    assert all(0.7 < ours < 1.2 for ours, _ in by_block.values())
    assert sum(one[2] for one in found) <= 4
