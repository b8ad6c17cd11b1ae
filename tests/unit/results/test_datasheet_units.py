"""Noise in the units of data sheets, against numbers that are known."""

import pytest

from gnomon.results.sensor_noise import DATASHEET_UNITS, UNITS, Coefficient

KNOWN = [  # one unit of a data sheet, in SI, worked out by hand
    ("gyroscope", "white_noise", "deg/sqrt(h)", 2.908882e-4),  # pi / 180 / 60
    ("gyroscope", "white_noise", "deg/s/sqrt(Hz)", 1.745329e-2),
    ("gyroscope", "bias_instability", "deg/h", 4.848137e-6),
    ("gyroscope", "random_walk", "deg/h/sqrt(h)", 8.080228e-8),
    ("accelerometer", "white_noise", "ug/sqrt(Hz)", 9.80665e-6),
    ("accelerometer", "white_noise", "m/s/sqrt(h)", 1.666667e-2),
    ("accelerometer", "bias_instability", "ug", 9.80665e-6),
    ("accelerometer", "random_walk", "ug/sqrt(h)", 1.634442e-7),
]


@pytest.mark.parametrize(("sensor", "name", "unit", "si"), KNOWN)
def test_one_unit_of_a_data_sheet(sensor, name, unit, si):
    factor = dict(DATASHEET_UNITS[sensor][name])[unit]
    found = Coefficient(value=si, sigma=si / 10).scaled(factor)
    assert found.value == pytest.approx(1.0, rel=1e-6)
    assert found.sigma == pytest.approx(0.1, rel=1e-6)


def test_every_unit_is_known():
    stated = {(s, n, unit) for s, names in DATASHEET_UNITS.items() for n, units in names.items() for unit, _ in units}
    assert stated == {entry[:3] for entry in KNOWN}
    assert set(DATASHEET_UNITS) == set(UNITS)


def test_bounds_are_scaled_too():
    assert Coefficient(value=0.0, bound=2.0).scaled(3.0).bound == 6.0
