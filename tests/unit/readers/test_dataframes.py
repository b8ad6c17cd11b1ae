"""DataFrames in and out."""

import importlib

import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError, RecordingError
from gnomon.recording import dataframes

pandas = pytest.importorskip("pandas")
NAMES = ("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]")


@pytest.fixture(scope="module")
def samples():
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=3, t_init_s=5.0, hold_s=(2.0, 2.0)), seed=1)
    return recording.imus["imu0"]


@pytest.fixture
def columns(samples):
    values = np.hstack([samples.accelerometer.values, samples.gyroscope.values])
    return {"t": samples.gyroscope.t_s, **dict(zip(NAMES, values.T, strict=True))}


def test_a_dataframe_is_read_to_the_last_digit(samples, columns):
    read = gnomon.read(pandas.DataFrame(columns))
    again = read.imus["imu0"]
    assert np.array_equal(again.accelerometer.values, samples.accelerometer.values)
    assert np.array_equal(again.gyroscope.values, samples.gyroscope.values)
    assert np.array_equal(again.gyroscope.t_ns, samples.gyroscope.t_ns)
    assert (again.accelerometer.unit, again.gyroscope.unit) == ("m/s^2", "rad/s")
    assert read.sources[0].name == "DataFrame"


def test_an_index_of_times_is_the_time(samples, columns):
    frame = pandas.DataFrame({name: columns[name] for name in NAMES})
    frame.index = pandas.to_datetime(samples.gyroscope.t_ns + 1_700_000_000_000_000_000)
    read = gnomon.read(frame).imus["imu0"]
    assert np.array_equal(read.gyroscope.t_ns - read.gyroscope.t_ns[0], samples.gyroscope.t_ns)


def test_polars_will_do(columns):
    polars = pytest.importorskip("polars")
    assert len(gnomon.read(polars.DataFrame(columns)).imus["imu0"].gyroscope) == len(columns["t"])


def test_what_cannot_be_read_is_named(columns):
    with pytest.raises(RecordingError, match="column note"):
        gnomon.read(pandas.DataFrame({**columns, "note": "x"}))
    with pytest.raises(OptionError, match="one at a time"):
        gnomon.read(pandas.DataFrame(columns), "a.csv")
    with pytest.raises(OptionError, match="given a int"):
        gnomon.read(3)


def test_samples_as_a_table(samples):
    frame = samples.gyroscope.to_dataframe()
    assert list(frame.columns) == ["t [s]", "x [rad/s]", "y [rad/s]", "z [rad/s]"]
    assert np.array_equal(frame["y [rad/s]"], samples.gyroscope.values[:, 1])


def test_parameters_as_a_table():
    _, truth = gnomon.simulate(gnomon.Scenario(intervals=3, t_init_s=5.0), seed=1)
    frame = truth.to_dataframe().set_index("name")
    assert frame.loc["imu0.gyroscope.bias[1]", "value"] == truth.imus["imu0"].gyroscope.bias[1]
    assert frame.loc["imu0.gyroscope.bias[1]", "unit"] == "rad/s"


def test_noise_as_a_table():
    rng = np.random.default_rng(1)
    t_s = np.arange(20_000) / 100
    result = gnomon.identify_noise(gnomon.Recording.from_arrays(t_s, *rng.normal(scale=2e-3, size=(2, 20_000, 3))))
    frame = result.to_dataframe("gyroscope")
    assert np.array_equal(frame["x"], result.curves["gyroscope"].deviation[:, 0])
    with pytest.raises(OptionError, match="magnetometer"):
        result.to_dataframe("magnetometer")


def test_without_either_it_is_said(samples, monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(dataframes.importlib, "import_module", absent)
    with pytest.raises(OptionError, match="needs pandas or polars"):
        samples.gyroscope.to_dataframe()
    assert importlib is dataframes.importlib


def test_values_are_short_to_read(samples):
    recording, truth = gnomon.simulate(gnomon.Scenario(intervals=3, t_init_s=5.0), seed=1)
    assert len(repr(recording)) < 200
    assert repr(truth).startswith("Calibration(")
    assert len(repr(truth)) < 100
    assert "array(" in repr(samples.gyroscope)
    html = truth._repr_html_()
    assert "imu0.gyroscope.bias" in html
    assert "rad/s" in html
