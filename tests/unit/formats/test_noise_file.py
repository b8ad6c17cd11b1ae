"""noise.yaml, imu.yaml and allan.csv: exact, told apart, and clear about what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import FormatError, OptionError
from gnomon.findings import Finding
from gnomon.formats.kalibr.imu import read_imu_input
from gnomon.formats.own.noise_file import allan_text, load_noise, noise_text, save_noise, save_noise_files
from gnomon.recording import Source
from gnomon.report.noise import write_noise_report
from gnomon.results.calibration import Provenance
from gnomon.results.sensor_noise import (
    COEFFICIENTS,
    AllanTable,
    AxisNoise,
    Coefficient,
    NoiseResult,
    SensorNoise,
    TriadNoise,
)
from html_page import Page


def an_axis(rng, *, walk=True):
    values = dict(zip(COEFFICIENTS, rng.lognormal(-9, 1, 5).tolist(), strict=True))
    found = {name: Coefficient(value=value, sigma=value / 7) for name, value in values.items()}
    found["quantisation"] = Coefficient(value=0.0, bound=float(rng.lognormal(-12)))
    if not walk:
        found["random_walk"] = Coefficient(value=0.0, bound=3.5e-5)
    return AxisNoise(**found, fitted_from_s=0.04, misfit=0.0123)


def a_noise(seed=0, *, gyroscope=True, walk=True):
    rng = np.random.default_rng(seed)

    def triad():
        x, y, z = (an_axis(rng, walk=walk) for _ in range(3))
        return TriadNoise(rate_hz=199.98, samples=1_234_567, tau_s=(0.005, 1310.72), axes=(x, y, z))

    return SensorNoise(
        accelerometer=triad(),
        gyroscope=triad() if gyroscope else None,
        t_init_s=41.0 if gyroscope else float("nan"),
        verdict="warn",
        findings=(Finding(severity="warning", code="noise-drift", message='it "drifts"', cure="wait"),),
        provenance=Provenance(
            gnomon_version="9", method="noise", inputs=(Source(name="a.npz", sha256="0" * 64),), options={"stop_s": "9"}
        ),
    )


def a_result(noise):
    tau_s = np.geomspace(0.005, 1310.72, 19)
    curves = {}
    for sensor, triad in noise.triads.items():
        fitted = np.stack([axis.deviation(tau_s) for axis in triad.axes], axis=1)
        curves[sensor] = AllanTable(
            tau_s=tau_s, deviation=1.01 * fitted, lower=0.9 * fitted, upper=1.3 * fitted, fitted=fitted
        )
    return NoiseResult(noise=noise, curves=curves, topic="/os1/imu")


@pytest.mark.parametrize(("seed", "gyroscope", "walk"), [(0, True, True), (1, False, True), (2, True, False)])
def test_a_file_reads_back_bit_by_bit(tmp_path, seed, gyroscope, walk):
    noise = a_noise(seed, gyroscope=gyroscope, walk=walk)
    save_noise(noise, tmp_path / "noise.yaml")
    again = load_noise(tmp_path / "noise.yaml")
    assert noise_text(again) == noise_text(noise)
    for sensor, triad in noise.triads.items():
        for one, other in zip(again.triads[sensor].axes, triad.axes, strict=True):
            assert repr(one) == repr(other)
    assert again.verdict == noise.verdict
    assert again.findings == noise.findings
    assert repr(again.provenance) == repr(noise.provenance)


def test_kalibr_gets_what_it_needs(tmp_path):
    noise = a_noise(3)
    names = [path.name for path in save_noise_files(a_result(noise), tmp_path)]
    assert names == ["noise.yaml", "allan.csv", "imu.yaml"]
    known = read_imu_input(tmp_path / "imu.yaml")["imu0"]
    assert known.noise == noise.imu_noise()
    assert (known.update_rate_hz, known.topic) == (199.98, "/os1/imu")
    density = np.sqrt(np.mean([axis.white_noise.value**2 for axis in noise.gyroscope.axes]))
    assert known.noise.gyroscope_noise_density == pytest.approx(density)
    text = (tmp_path / "imu.yaml").read_text()
    scatter = density * np.sqrt(199.98)
    assert f"{scatter:.4g} rad/s" in text
    assert "rad/s/sqrt(Hz)" in text
    assert "upper bound" not in text


def test_a_bound_is_called_a_bound(tmp_path):
    noise = a_noise(4, walk=False)
    save_noise_files(a_result(noise), tmp_path)
    assert noise.imu_noise().gyroscope_random_walk == pytest.approx(3.5e-5)
    text = (tmp_path / "imu.yaml").read_text()
    assert "gyroscope_random_walk is an upper bound" in text
    assert "below: 3.5e-05" in (tmp_path / "noise.yaml").read_text()


def test_without_gyroscope_there_is_no_imu_yaml(tmp_path):
    noise = a_noise(5, gyroscope=False)
    assert [path.name for path in save_noise_files(a_result(noise), tmp_path)] == ["noise.yaml", "allan.csv"]
    with pytest.raises(OptionError, match="the noise of the accelerometer alone"):
        noise.imu_noise()


def test_the_table_holds_every_averaging_time():
    rows = allan_text(a_result(a_noise(6))).splitlines()
    assert rows[0] == "sensor,axis,tau_s,deviation,lower,upper,fitted,unit"
    assert len(rows) == 1 + 2 * 3 * 19
    sensor, axis, tau, deviation, lower, upper, _, unit = rows[1].split(",")
    assert (sensor, axis, unit) == ("accelerometer", "x", "m/s^2")
    assert float(tau) == pytest.approx(0.005)
    assert float(lower) < float(deviation) < float(upper)


def test_parts_add_up_to_the_deviation():
    noise = a_noise(7).gyroscope.axes[0]
    tau_s = np.geomspace(0.01, 1e4, 9)
    found = noise.coefficients()
    expected = (
        found["white_noise"].value ** 2 / tau_s
        + 2 * np.log(2) / np.pi * found["bias_instability"].value ** 2
        + found["random_walk"].value ** 2 * tau_s / 3
        + found["rate_ramp"].value ** 2 * tau_s**2 / 2
    )
    np.testing.assert_allclose(noise.deviation(tau_s) ** 2, expected)
    assert set(noise.parts(tau_s)) == set(COEFFICIENTS) - {"quantisation"}


CHANGES = {
    "another schema": ("gnomon-noise/1", "gnomon-noise/7", 'found "gnomon-noise/7", expected gnomon-noise/1'),
    "unknown key": ("update_rate:", "updaterate:", "unknown key. Did you mean update_rate?"),
    "negative": ("update_rate: 199.98", "update_rate: -1", "accelerometer.update_rate: found -1"),
    "no number": ("misfit: 0.0123", "misfit: much", 'accelerometer.axes.x.misfit: found the text "much"'),
    "another unit": ("bias_instability: m/s^2", "bias_instability: mg", 'found "mg". Expected: m/s^2'),
    "both": ("        below:", "        sigma: 1.0\n        below:", "expected value and sigma, or below"),
    "verdict": ("verdict: warn", "verdict: fine", 'verdict: found "fine"'),
    "no axis": ('    "y":', "    w:", "unknown key"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_wrong_file_is_refused_with_the_place(tmp_path, name):
    old, new, message = CHANGES[name]
    text = noise_text(a_noise(8))
    assert old in text
    path = tmp_path / "noise.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError) as error:
        load_noise(path)
    assert message in str(error.value)
    assert str(path) in str(error.value)


def test_other_files_are_told_apart(tmp_path):
    path = tmp_path / "imu.yaml"
    path.write_text("update_rate: 200.0\n")
    with pytest.raises(FormatError, match=r"no noise.yaml of gnomon's"):
        load_noise(path)
    path.write_text("schema: gnomon-noise/1\nverdict: pass\nfindings: []\nprovenance: {}\n")
    with pytest.raises(FormatError, match="neither accelerometer nor gyroscope"):
        load_noise(path)


@pytest.mark.parametrize("gyroscope", [True, False])
def test_the_report_is_complete_and_the_same_every_time(tmp_path, gyroscope):
    result = a_result(a_noise(9, gyroscope=gyroscope))
    result = replace(result, noise=replace(result.noise, verdict="pass"))
    write_noise_report(result, tmp_path / "report.html")
    content = (tmp_path / "report.html").read_bytes()
    write_noise_report(result, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == content
    page = Page(content.decode())
    order = ["Pass. This noise is good to use", "Allan deviation", "Coefficients", "white noise N", "Accelerometer",
             "What it is made of", "What the numbers mean", "gnomon camera-imu", "Provenance", "a.npz"]  # fmt: skip
    place = 0
    for words in order:
        assert words in page.text[place:], words
        place = page.text.index(words, place)
    assert ("Gyroscope white noise" in page.text) == gyroscope
    assert content.count(b'<svg class="plot"') == (4 if gyroscope else 2)
    assert len(page.ids) == len(set(page.ids))
    assert len(content) < 500_000
