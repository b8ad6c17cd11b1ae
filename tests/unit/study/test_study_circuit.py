"""The study of a circuit: errors of paths, what follows from them, and its page; one short walk."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.report.page import render_page
from gnomon.report.studies.circuit import circuit_page
from gnomon.simulate.walk import WalkScenario
from gnomon.study import circuit_walk
from gnomon.study.circuit import PROBES, CircuitStudy, circuit_claims, circuit_tables
from gnomon.study.circuit_walk import (
    LEVELS,
    QUANTITIES,
    WAYS,
    CircuitRun,
    PartsRun,
    PartsTask,
    calibrated_rig,
    path_errors,
    perturb_rig,
    walk_with_parts_off,
)


def circle(radius_m=10.0, count=400):
    angle = np.linspace(0, 2 * np.pi, count)
    p = radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return rotation_from_rotvec(np.stack([0 * angle, 0 * angle, angle], axis=1)), p


def test_a_path_that_is_moved_as_a_whole_is_right():
    R, p = circle()
    turn = rotation_from_rotvec(np.array([0.3, -0.2, 1.0]))
    found = path_errors(turn @ R, p @ turn.T + 5.0, R, p)
    assert found.ate_m < 1e-12
    assert found.rpe_m < 1e-12


def test_a_path_that_is_too_large_is_off_by_its_share():
    R, p = circle()
    found = path_errors(R, 1.01 * p, R, p)
    assert found.closure_m < 1e-12
    assert found.ate_m == pytest.approx(0.01 * 10.0, rel=0.01)
    chord_m = 2 * 10.0 * np.sin(10.0 / 1.01 / 20.0)
    assert found.rpe_m == pytest.approx(0.01 * chord_m, rel=0.01)


def test_a_path_that_bends_wrongly_does_not_close():
    R, p = circle()
    bent = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    drift = p + np.stack([0 * bent, 0 * bent, 0.01 * bent], axis=1)
    assert path_errors(R, drift, R, p).closure_m == pytest.approx(0.01 * bent[-1])


def test_a_rig_is_off_in_what_is_asked_for_alone():
    truth = calibrated_rig(3, levels=False).truth
    drawn = {name: np.arange(1.0, 10.0) for name in QUANTITIES}
    for name in QUANTITIES:
        off = perturb_rig(truth, {name: 1e-3}, drawn)
        gyroscope, true_gyroscope = off.imu.gyroscope, truth.imu.gyroscope
        rate = np.linalg.solve(true_gyroscope.sensitivity, gyroscope.sensitivity) - np.eye(3)
        force = off.imu.required_accelerometer.sensitivity - truth.imu.required_accelerometer.sensitivity
        turn = rotvec_from_rotation(truth.T_cam_imu[:3, :3].T @ off.T_cam_imu[:3, :3])
        changed = {
            "camera_rotation": np.allclose(turn, [1e-3, 2e-3, 3e-3]),
            "camera_translation": np.allclose(off.T_cam_imu[:3, 3] - truth.T_cam_imu[:3, 3], [1e-3, 2e-3, 3e-3]),
            "time_shift": off.time_shift_s - truth.time_shift_s == pytest.approx(1e-3),
            "gyroscope_scale": np.allclose(np.diag(rate), [1e-3, 2e-3, 3e-3]),
            "gyroscope_misalignment": np.abs(rate - np.diag(np.diag(rate))).max() > 1e-3,
            "gyroscope_g_sensitivity": np.abs(gyroscope.g_sensitivity - true_gyroscope.g_sensitivity).max() > 1e-3,
            "accelerometer_scale": np.abs(np.diag(force)).max() > 5e-4,
            "accelerometer_misalignment": np.abs(np.tril(force, -1)).max() > 5e-4,
        }
        assert {key for key, value in changed.items() if value} == {name}


def made_up(runs=10):
    rng = np.random.default_rng(1)
    errors = np.abs(1 + 0.1 * rng.standard_normal((runs, len(WAYS), 3)))
    errors[:, : len(WAYS) - 3] *= 5
    errors[:, WAYS.index("truth")] = errors[:, WAYS.index("camera-imu full")] * 0.99
    errors[:, WAYS.index("without a board")] = errors[:, WAYS.index("truth")] * 1.05
    outcomes = tuple(
        CircuitRun(length_m=100.0, errors=one, sigma=np.ones(8), example=rng.standard_normal((len(WAYS) + 1, 50, 2)))
        for one in errors
    )
    sizes = np.array([0.1, 1.0, 10.0])[:, None] * [PROBES[name] for name in QUANTITIES]
    own = float(np.sqrt(np.mean(errors[:, WAYS.index("truth"), 1] ** 2)))
    added = np.repeat([0.1, 1.0, 10.0], 8)[:, None] * np.full(3, own)
    part = PartsRun(errors=added, added=added)
    joint = PartsRun(errors=added[:2], added=np.full((2, 3), own))
    return CircuitStudy(runs=runs, seed=0, outcomes=outcomes, sizes=sizes, parts=(part,) * runs, joint=(joint,) * runs)


def test_limits_share_the_drift_evenly():
    study = made_up()
    np.testing.assert_allclose(study.derived, study.sizes[1] / np.sqrt(8))


def test_claims_tables_and_page():
    study = made_up()
    assert [claim.holds for claim in circuit_claims(study)] == [True] * 6
    tables = {table.name: table for table in circuit_tables(study)}
    assert [row[0] for row in tables["levels"].rows] == list(WAYS)
    assert [row[0] for row in tables["parts"].rows] == list(QUANTITIES)
    assert len(tables["walks"].rows) == 10 * len(WAYS)
    html = render_page(circuit_page(study)).decode()
    assert "What an error of each quantity adds" in html
    assert all(way in html for way in LEVELS)


def test_of_few_walks_no_claim_is_made():
    assert [claim.holds for claim in circuit_claims(made_up(2))] == [None] * 6


@pytest.mark.long
def test_a_walk_with_a_part_off_goes_astray(monkeypatch):
    monkeypatch.setattr(circuit_walk, "SCENARIO", WalkScenario(length_m=(14.0, 14.0)))
    nothing, clock = np.zeros(len(QUANTITIES)), np.zeros(len(QUANTITIES))
    clock[QUANTITIES.index("time_shift")] = 0.01
    run = walk_with_parts_off(PartsTask(seed=5, off=(tuple(nothing), tuple(clock))))
    assert run.added[0].max() < 1e-12
    assert run.added[1, 1] > 0.01
    assert run.errors[1, 1] > run.errors[0, 1]


@pytest.mark.long
def test_each_calibration_knows_more_of_a_rig(monkeypatch):
    coarse = replace(circuit_walk.RECORDING, imu_rate_hz=100.0, camera_rate_hz=10.0)
    monkeypatch.setattr(circuit_walk, "RECORDING", coarse)
    found = calibrated_rig(3)
    assert set(found.levels) == set(LEVELS)
    off = {
        name: abs(rig.time_shift_s - found.truth.time_shift_s)
        + float(np.abs(rig.imu.gyroscope.sensitivity - found.truth.imu.gyroscope.sensitivity).max())
        for name, rig in found.levels.items()
    }
    assert off["truth"] == 0
    assert max(off["camera-imu full"], off["without a board"]) < 0.1 * min(off["nominal"], off["camera-imu basic"])
    assert (found.sigma > 0).all()
