"""Real multi-position recordings cut in parts: do these agree within the sigmas of a part?

`pytest tests/unit/assess/test_real_splits.py -m "slow or not slow" -s` prints the table. Biases are compared between
intervals that take turns; how they differ between halves and thirds is instability, and told apart.
"""

import numpy as np
import pytest

import gnomon

ALIKE = 1.4
OCCASIONS, SENSORS = 6, 8
TICKS_HZ = 64e6


def xsens(folder):
    return {"Xsens MTi": gnomon.read(folder)}


def mikov(folder):
    return {f"MPU-9150 {k}": gnomon.read(folder / f"imu{k}.log", rate_hz=100.0, units="si") for k in range(3)}


def mimu(folder):
    found = {}
    for occasion in range(OCCASIONS):
        with np.load(folder / f"exp_{occasion + 1}.npz") as data:
            t_s, counts = data["t_ticks"] / TICKS_HZ, data["counts"]
        for k in range(SENSORS):
            found[f"MIMU occasion {occasion + 1}, sensor {k}"] = gnomon.Recording.from_arrays(
                t_s, counts[:, k, 3:], counts[:, k, :3], units="raw"
            )
    return found


def rms(values, weights):
    return float(np.sqrt(np.average(np.square(values), weights=weights)))


def pooled(recordings):
    """Return z rms of all recordings together, published and for independent errors, and print them block by block."""
    trusts = {}
    for name, recording in recordings.items():
        result = gnomon.calibrate_imu(recording, gnomon.ImuOptions(gravity=9.81))
        trusts[name] = result.diagnostics.trust
        unstable = [f.message for f in result.calibration.assessment.findings if f.code == "bias-instability"]
        if unstable:
            print(f"\n  {name}: {' '.join(unstable)}")
    rows = [block for trust in trusts.values() for block in trust.splits.blocks]
    for path in dict.fromkeys(block.block for block in rows):
        own = [block for block in rows if block.block == path]
        weights = [block.comparisons for block in own]
        ours, theirs = rms([b.z_rms for b in own], weights), rms([b.z_rms_ordinary for b in own], weights)
        print(f"\n  {path:34} z {ours:.2f} (independent errors {theirs:.2f}), {sum(weights)} comparisons", end="")
    weights = [block.comparisons for block in rows]
    found = rms([b.z_rms for b in rows], weights), rms([b.z_rms_ordinary for b in rows], weights)
    beyond = sum(trust.splits.z_rms > trust.splits.limit for trust in trusts.values())
    print(
        f"\n{len(trusts)} recordings: z {found[0]:.2f} (independent errors {found[1]:.2f}); beyond their limit {beyond}"
    )
    return found


def test_parts_of_the_xsens_recording_agree(real_data):
    ours, ordinary = pooled(xsens(real_data("xsens_mti")))
    assert ours <= ordinary < ALIKE
    assert ours > 0.5  # sigmas are not just large


def test_parts_of_the_mpu_recordings_agree(real_data):
    ours, _ = pooled(mikov(real_data("mikov-mpu9150-multipos")))
    assert 0.5 < ours < ALIKE


@pytest.mark.slow
def test_parts_of_the_mimu_recordings_agree(real_data):
    ours, _ = pooled(mimu(real_data("mimu4444-icosahedron")))
    assert 0.6 < ours < ALIKE
