"""What a camera-IMU calibration publishes, and the covariance of it by differences of the published values."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from camera_imu_problem import problem
from gnomon.estimate.camera_imu.result.publish import publish_rig
from gnomon.estimate.camera_imu.result.uncertainty import FixedParameterEffect, Uncertainty
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.forms import LOWER, KrebsAccelerometer, KrebsGyroscope
from gnomon.results.sensors import calibration_parameters, covariance_names

MODELS = (("pinhole", "fov"), ("ds", "none"), ("eucm", "radtan"))


def case(*, imus=1, fixed=(), gravity=True):
    """Return parameters with their columns, and an uncertainty of all that is free."""
    of = problem(MODELS, imus=imus, rolling=True, fixed=fixed)
    rng = np.random.default_rng(5)
    names = tuple(np.array(of.layout.names)[of.layout.free])
    count = len(names) + 6 * imus
    root = 1e-3 * rng.normal(size=(count, count))
    by_unit = rng.normal(size=(1, count))
    held = {"gravity.magnitude": FixedParameterEffect(
        names=("gravity.magnitude",), by_unit=by_unit, wanted=np.zeros(1), wanted_sigma=np.ones(1)
    )}  # fmt: skip
    found = Uncertainty(
        names=names,
        covariance=root @ root.T,
        ordinary=root @ root.T,
        bias_mean=rng.normal(size=(imus, 6)),
        held=held if gravity else {},
    )
    return of, found, by_unit[0]


def values(found, at):
    """Return all published scalars, of rotations the small ones on the right from those of `at`."""
    result = []
    for (name, value), (_, origin) in zip(
        calibration_parameters(found.imus, found.cameras), calibration_parameters(at.imus, at.cameras), strict=True
    ):
        if name.endswith("rotation"):
            value = rotvec_from_rotation(rotation_from_rotvec(origin).T @ rotation_from_rotvec(value))  # noqa: PLW2901
        result.append(np.ravel(value))
    return np.concatenate(result)


def jacobian(of, found, at):
    """Return the derivative of all published scalars by the free ones, then by the mean biases."""
    columns = []
    for k in of.layout.free_index:
        step = np.zeros(len(of.layout))
        step[k] = 1e-7 if "line_delay" in of.layout.names[k] else 1e-5
        ahead, behind = (
            values(publish_rig(found, of.layout.plus(of.state.parameters, sign * step), gravity_sigma=0.0), at)
            for sign in (1, -1)
        )
        columns.append((ahead - behind) / (2 * step[k]))
    for i, k in np.ndindex(found.bias_mean.shape):
        step = np.zeros_like(found.bias_mean)
        step[i, k] = 1.0
        moved = Uncertainty(
            names=found.names,
            covariance=found.covariance,
            ordinary=found.ordinary,
            bias_mean=found.bias_mean + step,
            held=found.held,
        )
        columns.append(values(publish_rig(moved, of.state.parameters, gravity_sigma=0.0), at) - values(at, at))
    return np.column_stack(columns)


@pytest.mark.parametrize(
    "changes",
    [{}, {"imus": 2}, {"fixed": ("imu0.M_g[1]", "cam0.T_cam_imu.rotation[2]", "cam2.intrinsics[0]")}],
    ids=str,
)
def test_covariance_is_that_of_the_published_values(changes):
    of, found, _ = case(**changes)
    at = publish_rig(found, of.state.parameters, gravity_sigma=0.0)
    assert at.covariance.shape == (len(covariance_names(at.imus, at.cameras)),) * 2
    J = jacobian(of, found, at)
    expected = J @ found.covariance @ J.T
    np.testing.assert_allclose(at.covariance, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_array_equal(at.covariance, at.covariance.T)
    dead = np.isin(
        covariance_names(at.imus, at.cameras), [f"imu0.accelerometer.sensitivity[{e}]" for e in ("0,1", "0,2", "1,2")]
    )
    assert not at.covariance[dead].any()


def test_uncertain_gravity_adds_what_it_does():
    of, found, by_unit = case()
    without, uncertain = (publish_rig(found, of.state.parameters, gravity_sigma=s).covariance for s in (0.0, 0.02))
    at = publish_rig(found, of.state.parameters, gravity_sigma=0.0)
    moved = jacobian(of, found, at) @ by_unit * 0.02
    np.testing.assert_allclose(uncertain - without, np.outer(moved, moved), rtol=0, atol=1e-7 * np.max(moved**2))
    of, found, _ = case(gravity=False)  # it was estimated
    a, b = (publish_rig(found, of.state.parameters, gravity_sigma=s).covariance for s in (0.0, 0.02))
    np.testing.assert_array_equal(a, b)


def test_values_are_those_of_document_b():
    of, found, _ = case()
    at, imu = publish_rig(found, of.state.parameters, gravity_sigma=0.0), of.state.parameters.imus[0]
    triads = at.imus["imu0"]
    accelerometer = KrebsAccelerometer.from_sensor(triads.accelerometer.sensitivity, triads.accelerometer.bias)
    np.testing.assert_allclose(accelerometer.S, imu.S_a, rtol=1e-14)
    np.testing.assert_allclose(accelerometer.M, LOWER.matrix(imu.M_a), atol=1e-14)
    gyro = triads.gyroscope
    form = KrebsGyroscope.from_sensor(gyro.sensitivity, gyro.bias, gyro.g_sensitivity, reading="chapter 4")
    np.testing.assert_allclose(form.S, imu.S_g, rtol=1e-12)
    np.testing.assert_allclose(form.M, LOWER.matrix(imu.M_g), atol=1e-12)
    np.testing.assert_allclose(form.C_bg, imu.C_bg, atol=1e-12)
    np.testing.assert_array_equal(form.B, imu.B_g)
    np.testing.assert_array_equal(gyro.bias, found.bias_mean[0, :3])
    np.testing.assert_array_equal(triads.accelerometer.bias, found.bias_mean[0, 3:])
    for entry in of.state.parameters.cameras:
        camera = at.cameras[entry.name]
        np.testing.assert_array_equal(camera.T_cam_imu[:3, :3], entry.R_cam_imu)
        np.testing.assert_array_equal(camera.T_cam_imu[:, 3], [*entry.p_cam_imu, 1.0])
        assert camera.time_shift_cam_imu == entry.time_shift_s
        assert camera.camera is entry.camera
