"""`gnomon show`: every form's values and sigmas, against other ways to the same numbers."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.formats.shared.entries import value_text
from gnomon.geometry.rotations import invert_matrix
from gnomon.models.forms import TedaldiAccelerometer
from gnomon.results.calibration import (
    AccelerometerCalibration,
    GyroscopeCalibration,
    ImuCalibration,
    calibration_parameters,
)
from gnomon.simulate import CameraImuScenario, simulate_camera_imu
from gnomon.writers import tables
from gnomon.writers.tables import entries_with_sigmas, form_tables, summary_table

FORMS = ["sensitivity", "tedaldi", "krebs", "angrisano", "kalibr"]


def imu_and_covariance(calibration):
    imu = calibration.imus["imu0"]
    return imu, calibration.covariance(*[path for path, _ in calibration_parameters(calibration.imus)])


def by_name(calibration, form):
    entries, sigmas = entries_with_sigmas(*imu_and_covariance(calibration), form)
    return {(entry.triad, entry.name): (entry.value, sigma) for entry, sigma in zip(entries, sigmas, strict=True)}


@pytest.mark.parametrize("frame", ["accel-x", "accel-z"])
def test_kalibr_sigmas_are_those_of_the_frame_change(random_calibration, frame):
    """M of the accelerometer is the sensitivity in accel-x, whose covariance follows from an analytic Jacobian."""
    calibration = random_calibration(11, frame=frame)
    table = by_name(calibration, "kalibr")
    moved = calibration.in_frame("accel-x")
    value, sigma = moved.parameter("imu0.accelerometer.sensitivity"), moved.sigma("imu0.accelerometer.sensitivity")
    for i, j in ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)):
        assert table["accelerometer", f"M_{'xyz'[i]}{'xyz'[j]}"] == pytest.approx((value[i, j], sigma[i, j]), rel=1e-6)


def test_tedaldi_sigmas_by_hand(random_calibration):
    """K and the angles of T K = S^-1 have the derivatives of an inverse, d(S^-1) = -S^-1 dS S^-1."""
    calibration = random_calibration(12, frame="accel-z")
    table = by_name(calibration, "tedaldi")
    S = calibration.parameter("imu0.accelerometer.sensitivity")
    C = invert_matrix(S)
    jacobian = -np.kron(C, C.T)  # of the nine entries in row order
    K = np.diag(C)
    covariance = calibration.covariance("imu0.accelerometer.sensitivity")
    for i, axis in enumerate("xyz"):
        row = jacobian[4 * i]
        expected = np.sqrt(row @ covariance @ row)
        assert table["accelerometer", f"s_{axis}"] == pytest.approx((K[i], expected), rel=1e-6)
    for name, sign, i, j in (("yz", -1, 0, 1), ("zy", 1, 0, 2), ("zx", -1, 1, 2)):
        row = sign * (jacobian[3 * i + j] / K[j] - C[i, j] / K[j] ** 2 * jacobian[4 * j])
        # Entries that the frame fixes stay fixed under the change to the same frame.
        expected = np.sqrt(row @ covariance @ row)
        assert table["accelerometer", f"alpha_{name}"] == pytest.approx((sign * C[i, j] / K[j], expected), rel=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_sigmas_are_the_scatter_of_drawn_sensors(random_calibration, form):
    calibration = random_calibration(13, frame="accel-z")
    imu, covariance = imu_and_covariance(calibration)
    entries, sigmas = entries_with_sigmas(imu, covariance, form)
    start = np.concatenate([value.ravel() for _, value in calibration_parameters({"": imu})])
    drawn = np.random.default_rng(3).multivariate_normal(start, covariance, 2000)
    values = np.array([[entry.value for entry in tables._entries(x, imu, form)] for x in drawn])
    scatter, free = values.std(axis=0), sigmas > 0
    assert np.allclose(scatter[free], sigmas[free], rtol=0.1)
    assert free.all() or scatter[~free].max() < 1e-6 * scatter.max()
    assert len(entries) == len({(entry.triad, entry.name) for entry in entries})


def test_published_imu_tk_result_reads_as_printed():
    """imu_tk's numbers for the Xsens recording, in Tedaldi's letters: angles with their signs, 1/s, b added."""
    T = np.array([[1, -0.00335929903323, -0.00890639474323], [0, 1, -0.0213341193852], [0, 0, 1]])
    K = 1 / np.array([414.458873925, 412.010468453, 414.648662243])
    b = np.array([33124.1825646, 33275.1794342, 32364.4156494])
    S, bias = TedaldiAccelerometer(T=T, K=K, b=-b).to_sensor()
    imu = ImuCalibration(accelerometer=AccelerometerCalibration(sensitivity=S, bias=bias, unit="count"))
    entries, _ = entries_with_sigmas(imu, np.zeros((12, 12)), "tedaldi")
    found = {entry.name: entry.value for entry in entries}
    assert found["alpha_yz"] == pytest.approx(0.00335929903323)
    assert found["alpha_zy"] == pytest.approx(-0.00890639474323)
    assert found["alpha_zx"] == pytest.approx(0.0213341193852)
    assert [found[f"1/s_{axis}"] for axis in "xyz"] == pytest.approx([414.458873925, 412.010468453, 414.648662243])
    assert [found[f"b_{axis}"] for axis in "xyz"] == pytest.approx(list(-b))


def test_quaternion_of_a_cyclic_permutation(random_calibration):
    """Gyroscope axes y, z, x: q_bg is a turn by 120 degrees, far from small angles."""
    calibration = random_calibration(1)
    imu = calibration.imus["imu0"]
    cyclic = replace(imu.gyroscope, sensitivity=np.array([[0.0, 5, 0], [0, 0, 5], [5, 0, 0]]))
    entries, _ = entries_with_sigmas(replace(imu, gyroscope=cyclic), np.zeros((33, 33)), "krebs")
    q = np.abs([entry.value for entry in entries if entry.name.startswith("q_bg")])
    assert q == pytest.approx([0.5] * 4)


@pytest.mark.parametrize("form", FORMS)
def test_tables_say_everything(random_calibration, form):
    made = form_tables(random_calibration(14, units=("g", "deg/s")), form)
    assert [table.title.split(",")[0] for table in made] == ["imu0 accelerometer", "imu0 gyroscope"]
    for table in made:
        assert "measured" in table.note
        assert all(row.unit and "±" in row.value for row in table.rows if "fixed" not in row.value)
    units = {row.unit for table in made for row in table.rows}
    assert {"g", "deg/s"} <= units
    assert {"g/(m/s^2)", "(m/s^2)/g"} & units
    alone = form_tables(random_calibration(14, gyroscope=False), form)
    assert len(alone) == 1


def test_fixed_entries_are_marked(random_calibration):
    rows = {row.name: row for row in form_tables(random_calibration(15))[0].rows}
    assert rows["sensitivity_xy"].value == "0 (fixed)"
    assert "±" in rows["sensitivity_yx"].value


def test_unknown_form(random_calibration):
    with pytest.raises(OptionError, match="sensitivity, tedaldi, krebs, angrisano, kalibr"):
        form_tables(random_calibration(), "euler")


def test_form_that_cannot_hold_the_sensor(random_calibration):
    calibration = random_calibration()
    permuted = GyroscopeCalibration(
        sensitivity=np.array([[0.0, 5, 0], [0, 0, 5], [5, 0, 0]]),
        bias=np.zeros(3),
        g_sensitivity=np.zeros((3, 3)),
        unit="count",
    )
    imu = calibration.imus["imu0"]
    triangular = replace(imu.accelerometer, sensitivity=np.diag([3.0, 3.0, 3.0]))
    broken = replace(calibration, imus={"imu0": replace(imu, accelerometer=triangular, gyroscope=permuted)})
    with pytest.raises(OptionError, match="another form"):
        form_tables(broken, "tedaldi")


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (414.4075, 0.01234, "414.408 ± 0.012"),
        (-0.00336, 0.000996, "-0.0034 ± 0.0010"),
        (33124.18, 0.2, "33124.18 ± 0.20"),
        (33124.18, 12.3, "33124 ± 12"),
        (0.0, 0.0, "0 (fixed)"),
        (5.0, float("nan"), "5 (unknown sigma)"),
        (5.0, float("inf"), "5 (unknown sigma)"),
        (1.23456e-7, 1.2e-9, "(1.235 ± 0.012)e-07"),
        (0.0, 3e-6, "(0.0 ± 3.0)e-06"),
        (123.0, 456.0, "(1.2 ± 4.6)e+02"),
    ],
)
def test_two_digits_of_sigma(value, sigma, text):
    assert value_text(value, sigma) == text


def test_summary(random_calibration):
    rows = {row.name: row.value for row in summary_table(random_calibration(gyroscope=False)).rows}
    assert rows["verdict"] == "pass"
    assert rows["static intervals used"] == "38 of 40"
    assert rows["gravity"] == "9.8100 ± 0.0030"
    assert "hold-out rotations, rms" not in rows


def test_the_truth_of_a_simulation_is_shown_without_sigmas_and_verdict():
    truth = simulate_camera_imu(CameraImuScenario(duration_s=1.0, cameras=2, imus=2), 0).truth
    summary, *others = summary_table(truth), *form_tables(truth, "krebs")
    assert (summary.title, [row.name for row in summary.rows]) == ("truth of a simulation", ["body frame", "gravity"])
    titles = [table.title.split(",")[0] for table in others]
    assert titles == [
        "imu0 accelerometer",
        "imu0 gyroscope",
        "imu1 accelerometer",
        "imu1 gyroscope",
        "imu1",
        "cam0",
        "cam1",
    ]
    for table in (summary, *others):
        assert not any("fixed" in row.value or "±" in row.value for row in table.rows), table.title
