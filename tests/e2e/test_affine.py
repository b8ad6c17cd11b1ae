"""The calibrated data do not depend on the raw data's offsets, scales, or order of axes; a flipped axis is named."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.geometry.rotations import frame_rotation
from gnomon.results.calibration import ImuCalibration, rotate_imu

OPTIONS = gnomon.ImuOptions(gravity=9.81)


@pytest.fixture(scope="module")
def samples(real_data):
    return gnomon.read(real_data("xsens_mti")).imus["imu0"]


@pytest.fixture(scope="module")
def plain(samples):
    return gnomon.calibrate_imu(gnomon.Recording(imus={"imu0": samples}), OPTIONS).calibration


class Distortion:
    """distorted = scale * original[:, order] + offset, for each triad."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.order = np.roll(np.arange(3), rng.integers(3))  # of both triads, so that the hand stays
        self.scale = 10.0 ** rng.uniform(-2, 2, (2, 3))
        self.offset = rng.uniform(-65536, 65536, (2, 3)) * self.scale

    def distorted(self, samples):
        triads = [
            replace(triad, values=scale * triad.values[:, self.order] + offset)
            for triad, scale, offset in zip(
                (samples.accelerometer, samples.gyroscope), self.scale, self.offset, strict=True
            )
        ]
        return gnomon.Recording(imus={"imu0": gnomon.ImuSamples(accelerometer=triads[0], gyroscope=triads[1])})

    def undone(self, imu):
        """Return the calibration of the distorted samples as one of the original samples, in frame accel-x."""
        back = np.argsort(self.order)

        def rows(values, triad):
            return (values.T / self.scale[triad]).T[back]

        accelerometer = replace(
            imu.accelerometer,
            sensitivity=rows(imu.accelerometer.sensitivity, 0),
            bias=rows(imu.accelerometer.bias - self.offset[0], 0),
        )
        gyroscope = replace(
            imu.gyroscope,
            sensitivity=rows(imu.gyroscope.sensitivity, 1),
            bias=rows(imu.gyroscope.bias - self.offset[1], 1),
            g_sensitivity=rows(imu.gyroscope.g_sensitivity, 1),
        )
        original = ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)
        return rotate_imu(original, frame_rotation(accelerometer.sensitivity, "accel-x"))


def worst_differences(samples, plain, seed):
    """Return the largest differences of the calibrated data [m/s^2], [rad/s] over the recording."""
    distortion = Distortion(seed)
    found = gnomon.calibrate_imu(distortion.distorted(samples), OPTIONS).calibration
    assert found.assessment.intervals_used == plain.assessment.intervals_used
    assert found.assessment.rotations_used == plain.assessment.rotations_used
    thin = gnomon.ImuSamples(
        **{
            name: replace(triad, t_ns=triad.t_ns[::7], values=triad.values[::7])
            for name, triad in (("accelerometer", samples.accelerometer), ("gyroscope", samples.gyroscope))
        }
    )
    ours, theirs = (imu.apply(thin) for imu in (distortion.undone(found.imus["imu0"]), plain.imus["imu0"]))
    return (
        np.abs(ours.accelerometer.values - theirs.accelerometer.values).max(),
        np.abs(ours.gyroscope.values - theirs.gyroscope.values).max(),
    )


# A parameter that stops within 1e-4 sigma of the minimum leaves some 1e-7 of gravity and of the rates.
TOLERANCE = {"force": 1e-6, "rate": 1e-6}  # [m/s^2], [rad/s]; the sigmas are a hundred times that and more


def assert_same(samples, plain, seeds):
    worst = np.max([worst_differences(samples, plain, seed) for seed in seeds], axis=0)
    assert worst[0] < TOLERANCE["force"]
    assert worst[1] < TOLERANCE["rate"]


@pytest.mark.first(2)
@pytest.mark.parametrize("seed", [*range(6), 1211])  # the last has a gyroscope whose lengths look like gravity's
def test_same_calibrated_data(samples, plain, seed):
    assert_same(samples, plain, [seed])


@pytest.mark.slow
def test_same_calibrated_data_a_thousand_times(samples, plain):
    assert_same(samples, plain, range(1000, 2000))


UNCHANGED = np.eye(3)


def remapped(samples, accelerometer=UNCHANGED, gyroscope=UNCHANGED):
    """Return the recording with axes exchanged or mirrored, about the middle of the converter's range."""
    triads = [
        replace(triad, values=(triad.values - 32768) @ matrix.T + 32768)
        for triad, matrix in ((samples.accelerometer, accelerometer), (samples.gyroscope, gyroscope))
    ]
    return gnomon.Recording(imus={"imu0": gnomon.ImuSamples(accelerometer=triads[0], gyroscope=triads[1])})


def axis_findings(calibration):
    return [finding for finding in calibration.assessment.findings if finding.code == "axes-differ"]


def test_sound_axes_are_not_mentioned(plain):
    assert axis_findings(plain) == []
    assert plain.verdict == "pass"


@pytest.mark.parametrize("axis", range(3))
def test_flipped_gyroscope_axis_is_named(samples, plain, axis):
    mirror = np.eye(3)
    mirror[axis, axis] = -1
    calibration = gnomon.calibrate_imu(remapped(samples, gyroscope=mirror), OPTIONS).calibration
    [finding] = axis_findings(calibration)
    assert finding.severity == "warning"
    assert f"gyroscope {'xyz'[axis]} is flipped" in finding.cure
    assert "left-handed" in finding.message
    assert calibration.verdict == "warn"
    # The calibration itself holds: the minus stands in the sensitivity, and the frame stays right-handed.
    found = calibration.parameter("imu0.gyroscope.sensitivity")
    expected = mirror @ plain.parameter("imu0.gyroscope.sensitivity")
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("axis", range(3))
def test_flipped_accelerometer_axis_is_named(samples, axis):
    mirror = np.eye(3)
    mirror[axis, axis] = -1
    calibration = gnomon.calibrate_imu(remapped(samples, accelerometer=mirror), OPTIONS).calibration
    [finding] = axis_findings(calibration)
    assert f"accelerometer {'xyz'[axis]} is flipped" in finding.cure
    assert calibration.assessment.rotations_used == 37
    assert calibration.assessment.holdout.rotation_rms <= 2.9e-3


def test_all_axes_of_the_gyroscope_flipped(samples):
    calibration = gnomon.calibrate_imu(remapped(samples, gyroscope=-np.eye(3)), OPTIONS).calibration
    [finding] = axis_findings(calibration)
    assert "all signs of the gyroscope" in finding.cure


@pytest.mark.parametrize("triad", ["accelerometer", "gyroscope"])
def test_swapped_axes_are_named(samples, triad):
    swap = np.eye(3)[[1, 0, 2]]
    calibration = gnomon.calibrate_imu(remapped(samples, **{triad: swap}), OPTIONS).calibration
    [finding] = axis_findings(calibration)
    assert "gyroscope x measures about " in finding.message
    assert "columns" in finding.cure
    along = np.argmax(np.abs(calibration.parameter("imu0.gyroscope.sensitivity")), axis=1)
    np.testing.assert_array_equal(along, [1, 0, 2])
