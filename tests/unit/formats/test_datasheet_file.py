"""Noise against data sheets: densities are one-sided there, and alias where the band is wider than half the rate."""

from math import degrees, nan, pi, sqrt

import pytest

from gnomon.errors import FormatError, OptionError
from gnomon.formats.own.noise_file import load_datasheet
from gnomon.results.datasheet import aliasing_factor, compare_datasheet
from gnomon.results.sensor_noise import AxisNoise, Coefficient, SensorNoise, TriadNoise

NAMES = ("BMI088", "BMI270", "ICM-20948", "ICM-42688", "MPU-6050", "LSM6DSO", "ADIS16448", "ADIS16470")


@pytest.mark.parametrize("name", [*NAMES, "mpu6050"])
def test_known_sheets_have_a_source_and_both_sensors(name):
    sheet = load_datasheet(name)
    assert sheet.source
    assert set(sheet.sensors) == {"accelerometer", "gyroscope"}


def test_densities_are_one_sided():
    """Analog Devices states 0.008 deg/s/sqrt(Hz) and 0.34 deg/sqrt(h) of the same noise."""
    gyroscope = load_datasheet("ADIS16470").sensors["gyroscope"]
    assert gyroscope.noise_density / sqrt(2) == pytest.approx(gyroscope.random_walk, rel=0.01)
    assert gyroscope.white_noise == gyroscope.random_walk
    assert load_datasheet("MPU-6050").sensors["gyroscope"].white_noise == pytest.approx(0.005 / degrees(1) / sqrt(2))


def noise_of(white, rate_hz=200.0):
    unseen = Coefficient(value=0.0, bound=1e-6)
    axis = AxisNoise(
        white_noise=Coefficient(value=white, sigma=1e-7),
        bias_instability=unseen, random_walk=unseen, quantisation=unseen, rate_ramp=unseen,
    )  # fmt: skip
    triad = TriadNoise(rate_hz=rate_hz, samples=1000, tau_s=(0.005, 1.0), axes=(axis,) * 3)
    return SensorNoise(
        accelerometer=None, gyroscope=triad, t_init_s=nan, verdict="pass", findings=(), provenance=None
    )  # fmt: skip


def test_noise_of_the_sheet_itself_has_ratio_one_and_aliases():
    sheet = load_datasheet("ADIS16470")
    noise = noise_of(sheet.sensors["gyroscope"].random_walk)
    density, walk, floor = compare_datasheet(noise, sheet).quantities
    assert walk.found == pytest.approx(0.34)
    assert (walk.ratio, density.ratio) == (pytest.approx(1), pytest.approx(1, rel=0.01))
    assert floor.bound
    compared = compare_datasheet(noise, sheet, 550.0)
    assert compared.quantities[1].ratio == pytest.approx(sqrt(100 / (pi / 2 * 550)))
    assert compared.quantities[2].expected == floor.expected
    assert "aliases" in compared.words()[0]


def test_a_narrow_filter_does_not_alias():
    assert aliasing_factor(20.0, 200.0) == aliasing_factor(nan, 200.0) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mine: {source: me, gyroscope: {noise_density: 0.01}}", "expected text"),
        ("mine: {source: me, gyroscope: {noise_density: 5 deg}}", "positive number with a unit"),
        ("mine: {source: me, gyroscope: {noise_density: -1 deg/s/sqrt(Hz)}}", "positive number with a unit"),
        ("mine: {gyroscope: {}}", "source is missing"),
    ],
)
def test_files_are_checked(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=words):
        load_datasheet(str(path))


def test_what_is_neither_known_nor_a_file_is_refused():
    with pytest.raises(OptionError, match="BMI088"):
        load_datasheet("BMI888")
