"""Axes of an accelerometer that are others from one instant on, in front of a camera."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.assess.checks.rig_doctor import check_corners


def edited(simulation, at_s, matrix):
    imu = simulation.recording.imus["imu0"]
    triad = imu.accelerometer
    later = (triad.t_ns - triad.t_ns[0]) * 1e-9 > at_s
    values = np.where(later[:, None], triad.values @ np.array(matrix, dtype=float).T, triad.values)
    imu = replace(imu, accelerometer=replace(triad, values=values))
    return replace(simulation.recording, imus={"imu0": imu})


@pytest.mark.parametrize(
    ("at_s", "matrix", "read"),
    [
        (8.0, np.diag([-1, 1, 1]), "x reads what would have been -x"),
        (4.0, np.diag([1, -1, -1]), "y reads what would have been -y, z reads what would have been -z"),
        (6.0, [[1, 0, 0], [0, 0, 1], [0, 1, 0]], "y reads what would have been z, z reads what would have been y"),
    ],
)
def test_axes_that_change_are_named_with_the_instant(at_s, matrix, read) -> None:
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=12.0, random_extrinsics=True), 9800)
    found = check_corners(edited(simulation, at_s, matrix), simulation.target)
    (change,) = [one for one in found if one.code == "axes-changed"]
    assert change.message.endswith(f"from then on {read}.")
    assert float(change.message.split()[1]) == pytest.approx(at_s, abs=1)


@pytest.mark.parametrize("motion", ["gentle", "shaky", "one-axis"])
def test_nothing_is_said_of_sound_ones(motion) -> None:
    scenario = CameraImuScenario(duration_s=10.0, random_extrinsics=True, motion=motion)
    simulation = simulate_camera_imu(scenario, 9801)
    assert not {"axes-changed", "rotation-breaks"} & {
        one.code for one in check_corners(simulation.recording, simulation.target)
    }
    constant = edited(simulation, -1.0, np.diag([1, 1, 1.1]))  # a scale is no change
    assert "axes-changed" not in {one.code for one in check_corners(constant, simulation.target)}
