"""A magnetometer turned by hand while its temperature rose and fell: what `calibrate_magnetometer` makes of it."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon import FieldScenario, calibrate_magnetometer, simulate_magnetometer
from gnomon.options import MagnetometerOptions
from gnomon.recording import TriadSamples

WARMED = FieldScenario(duration_s=600.0, imu_rate_hz=50.0, accelerometer=False, heating_k=15.0)
PARTS = ("magnetometer_bias", "magnetometer_sensitivity")


def calibrated(recording, field=48.0):
    return calibrate_magnetometer(recording, MagnetometerOptions(field=field)).calibration


@pytest.mark.long  # ten minutes of samples, fitted three times
@pytest.mark.parametrize("accelerometer", [False, True])
def test_offsets_and_scales_follow_a_temperature_that_rose_and_fell(accelerometer, tmp_path):
    scenario = replace(WARMED, offset_drift=0.15, sensitivity_drift=2e-3, accelerometer=accelerometer)
    recording, truth = simulate_magnetometer(scenario, 11)
    calibration = calibrated(recording)
    found = calibration.imus["imu0"].temperature
    for part in PARTS:
        sigma = calibration.sigma(f"imu0.temperature.{part}")[0]
        off = getattr(found, part)[0] - getattr(truth.imus["imu0"].temperature, part)[0]
        assert np.abs(off[sigma > 0] / sigma[sigma > 0]).max() < 3.5
        assert np.count_nonzero(sigma) == 3
        assert not off[sigma == 0].any()  # axes are not looked for
    there = truth.at_temperature(found.reference_degc).imus["imu0"].magnetometer
    for kind in ("bias", "sensitivity"):
        sigma = calibration.sigma(f"imu0.magnetometer.{kind}")
        off = getattr(calibration.imus["imu0"].magnetometer, kind) - getattr(there, kind)
        assert np.abs(off[sigma > 0] / sigma[sigma > 0]).max() < 4
    assert [one.code for one in calibration.assessment.findings].count("temperature-slope") == 2
    # What is applied has one strength, warm or cold; a file keeps all of it.
    gnomon.save(calibration, tmp_path / "calibration.yaml")
    assert "gnomon/1.9" in (tmp_path / "calibration.yaml").read_text(encoding="utf-8")
    read = gnomon.load(tmp_path / "calibration.yaml")
    assert np.allclose(read.uncertainty.matrix, calibration.uncertainty.matrix, rtol=1e-12, atol=0)
    strength = np.linalg.norm(read.imus["imu0"].apply(recording.imus["imu0"]).magnetometer.values, axis=1)
    minutes = strength.reshape(10, -1).mean(axis=1)
    assert np.ptp(minutes) < 0.1
    if accelerometer:  # one range holds for all that changes: a wider one of the accelerometer is another result
        with pytest.raises(gnomon.OptionError, match="gnomon imu"):
            gnomon.calibrate_temperature([recording], calibration)


def drifting(kind, seed):
    """Return a recording whose offset drifts by some uT with the time while the temperature rises and falls."""
    recording, _ = simulate_magnetometer(WARMED, seed)
    imu = recording.imus["imu0"]
    rng, field = np.random.default_rng([seed, 9]), imu.magnetometer
    share = np.linspace(0, 1, len(field))[:, None]
    walk = np.cumsum(rng.standard_normal((len(field), 3)), axis=0) / np.sqrt(len(field))
    drift = {"nothing": 0 * share, "line": share, "decay": np.exp(-4 * share), "step": share > 0.4, "walk": walk}[kind]
    values = field.values + 2.0 * drift * rng.standard_normal(3)
    moved = replace(imu, magnetometer=TriadSamples(t_ns=field.t_ns, values=values, unit=field.unit))
    return replace(recording, imus={"imu0": moved})


@pytest.mark.long
@pytest.mark.parametrize("kind", ["nothing", "line", "decay", "step", "walk"])
def test_a_drift_with_the_time_is_no_slope(kind):
    assert calibrated(drifting(kind, 12)).imus["imu0"].temperature is None


def test_a_temperature_that_only_rises_tells_nothing():
    recording, _ = simulate_magnetometer(replace(WARMED, offset_drift=0.15), 13)
    imu = recording.imus["imu0"]
    half = slice(0, len(imu.magnetometer) // 2)
    first = replace(imu.magnetometer, t_ns=imu.magnetometer.t_ns[half], values=imu.magnetometer.values[half])
    kept = imu.temperature.t_ns <= first.t_ns[-1]
    read = replace(imu.temperature, t_ns=imu.temperature.t_ns[kept], values=imu.temperature.values[kept])
    rising = replace(recording, imus={"imu0": replace(imu, magnetometer=first, temperature=read)})
    assert calibrated(rising).imus["imu0"].temperature is None
