"""Calibrations of counts for flight controllers: refused with the likely full scale, and right where it is stated."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.errors import OptionError
from gnomon.formats.conversion import export_texts
from gnomon.formats.shared.si_units import with_full_scale

FLIGHT = ("px4", "ardupilot")
PER_G, PER_DEG_S = 16384.0, 131.0


@pytest.fixture
def counts(random_calibration):
    """A sensor in counts, 1 % and 0.6 % from its data sheet, with a bias of 0.2 m/s^2."""
    made = random_calibration(2, units=("count", "count"))
    imu = made.imus["imu0"]

    def near(sensitivity, nominal):
        return sensitivity * nominal / abs(np.linalg.det(sensitivity)) ** (1 / 3)

    accelerometer = replace(
        imu.accelerometer,
        sensitivity=near(imu.accelerometer.sensitivity, 1.01 * PER_G / 9.80665),
        bias=np.array([0.2, -0.1, 0.05]) * PER_G / 9.80665,
    )
    gyroscope = replace(
        imu.gyroscope,
        sensitivity=near(imu.gyroscope.sensitivity, 0.994 * np.degrees(PER_DEG_S)),
        bias=np.array([0.03, -0.02, 0.01]) * np.degrees(PER_DEG_S),
        g_sensitivity=np.zeros((3, 3)),
    )
    return replace(made, imus={"imu0": replace(imu, accelerometer=accelerometer, gyroscope=gyroscope)})


@pytest.mark.parametrize("to", FLIGHT)
def test_counts_are_refused_with_the_likely_full_scale(counts, to):
    with pytest.raises(OptionError) as refused:
        export_texts(counts, to)
    assert "1.0 % from 16384: likely --accelerometer-lsb-per-g 16384" in str(refused.value)
    assert "0.6 % from 131: likely --gyroscope-lsb-per-deg-s 131" in str(refused.value)


@pytest.mark.parametrize("to", FLIGHT)
def test_with_the_full_scale_offsets_are_those_of_the_drivers_samples(counts, to):
    (text,) = export_texts(counts, to, accelerometer_lsb_per_g=PER_G, gyroscope_lsb_per_deg_s=PER_DEG_S).files.values()
    values = dict(re.findall(r"(?m)^(?:1\t1\t)?([A-Z]\w+)[\t,]([-\d.e]+)", text))
    offset, scale, rate = (
        [float(values[name.format(axis)]) for axis in "XYZ"]
        for name in (
            ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF")
            if to == "px4"
            else ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}")
        )
    )
    assert offset == pytest.approx([0.2, -0.1, 0.05])
    assert rate == pytest.approx([0.03, -0.02, 0.01])
    assert np.mean(scale) == pytest.approx(1 / 1.01, rel=0.02)


def test_the_covariance_goes_along(counts):
    found = with_full_scale(counts, PER_G, PER_DEG_S)
    for path, lsb in (("accelerometer.bias", PER_G), ("gyroscope.sensitivity", PER_DEG_S)):
        assert found.sigma(f"imu0.{path}") == pytest.approx(counts.sigma(f"imu0.{path}") / lsb)
    sample = np.array([[200.0, -16000, 40]])
    force = counts.imus["imu0"].accelerometer.specific_force(sample)
    assert found.imus["imu0"].accelerometer.specific_force(sample / PER_G) == pytest.approx(force)


@pytest.mark.parametrize("to", FLIGHT)
def test_a_full_scale_of_another_range_is_refused(counts, to):
    with pytest.raises(OptionError, match=r"has 16548 counts per g\. State by what its driver divides"):
        export_texts(counts, to, accelerometer_lsb_per_g=8192.0, gyroscope_lsb_per_deg_s=PER_DEG_S)
    with pytest.raises(OptionError, match=r"the gyroscope of imu0 has 130\.21 counts per deg/s"):
        export_texts(counts, to, accelerometer_lsb_per_g=PER_G, gyroscope_lsb_per_deg_s=65.5)


@pytest.mark.parametrize("to", FLIGHT)
def test_unsigned_counts_are_said_not_to_be_those_of_a_driver(counts, to):
    imu = counts.imus["imu0"]
    shifted = replace(imu, accelerometer=replace(imu.accelerometer, bias=imu.accelerometer.bias + 32768))
    scales = {"accelerometer_lsb_per_g": PER_G, "gyroscope_lsb_per_deg_s": PER_DEG_S}
    said = [loss.what for loss in export_texts(replace(counts, imus={"imu0": shifted}), to, **scales).losses]
    assert "zero of the accelerometer of imu0" in said
    assert not any("zero of" in loss.what for loss in export_texts(counts, to, **scales).losses)


def test_what_does_not_fit_is_refused(counts, random_calibration):
    with pytest.raises(OptionError, match="above zero"):
        export_texts(counts, "px4", accelerometer_lsb_per_g=0.0)
    with pytest.raises(OptionError, match="no gyroscope of this calibration is in counts"):
        export_texts(random_calibration(0, units=("count", "rad/s")), "px4", gyroscope_lsb_per_deg_s=131.0)
    with pytest.raises(OptionError, match="counts per g, no usual full scale"):
        export_texts(random_calibration(0, units=("count", "rad/s")), "px4")


def test_the_command(counts, tmp_path, capsys):
    gnomon.save(counts, tmp_path / "calibration.yaml")
    line = ["convert", str(tmp_path / "calibration.yaml"), "--to", "px4", "-o", str(tmp_path / "out")]
    assert main(line) == 2
    assert not (tmp_path / "out").exists()
    proposed = re.findall(r"likely (--\S+ [\d.]+)", " ".join(capsys.readouterr().err.split()))
    assert main([*line, *" ".join(proposed).split()]) == 0
    assert (tmp_path / "out" / "px4.params").exists()
