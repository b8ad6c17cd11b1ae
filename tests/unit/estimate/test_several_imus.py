"""IMUs beside the first: their poses and clocks moved between frames and origins, in files, and on the trajectory."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from camera_imu_problem import problem
from gnomon.assess.cameras.rig_findings import cut_findings
from gnomon.errors import FormatError, OptionError
from gnomon.estimate.camera_imu.choices import estimation_choices
from gnomon.estimate.camera_imu.parameters import ImuParameters
from gnomon.estimate.camera_imu.start.first_guess import ImuPath, initial_trajectory
from gnomon.estimate.camera_imu.start.imu_alignment import with_stated_pose
from gnomon.estimate.camera_imu.terms.inertial_terms import (
    InertialData,
    TriadData,
    predicted_readings,
    split_triads,
    within_trajectory,
)
from gnomon.formats.own.calibration_file import load
from gnomon.formats.own.calibration_text import calibration_text, save
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.forms import in_frame
from gnomon.models.origin import Origin, single_point_weights
from gnomon.options import CameraImuOptions
from gnomon.recording import ImuSamples, TriadSamples
from gnomon.results.calibration import Calibration, Covariance
from gnomon.results.moved import moved_into_frame, moved_to_origin
from gnomon.results.sensors import calibration_parameters, covariance_names
from gnomon.simulate.camera_imu import simulate_camera_imu
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario


def pose(seed):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rotvec(rng.normal(size=3)), rng.normal(0, 0.1, 3)
    return T


def _is_exact(name):
    """Tell whether frame or origin make a scalar zero."""
    return ".accelerometer." in name and name.endswith(
        ("sensitivity[0,1]", "sensitivity[0,2]", "sensitivity[1,2]", "_m[0,0]", "_m[0,1]", "_m[0,2]")
    )


@pytest.fixture(scope="module")
def two_imus(camera_calibration, random_calibration):
    """A calibration of two IMUs with lever arms, the second with a pose and a delayed accelerometer, all uncertain."""
    base = camera_calibration(3)
    other = random_calibration(8, units=("m/s^2", "rad/s")).imus["imu0"]
    rng = np.random.default_rng(4)
    arms = rng.normal(0, 0.02, (2, 3, 3)) * [[[0], [1], [1]]]
    imus = {
        name: replace(imu, accelerometer=replace(imu.accelerometer, lever_arms_m=places))
        for (name, imu), places in zip((*base.imus.items(), ("imu1", other)), arms, strict=True)
    }
    second = imus["imu1"]
    imus["imu1"] = replace(
        second,
        T_imu_body=pose(6),
        time_shift_s=-1.7e9,
        accelerometer=replace(second.accelerometer, time_shift_s=0.012),
    )
    names = covariance_names(imus, base.cameras)
    root = 1e-3 * rng.normal(size=(len(names), len(names)))
    root[[_is_exact(name) for name in names]] = 0.0
    return replace(base, imus=imus, uncertainty=Covariance(names=names, matrix=root @ root.T))


def scalars(imus, cameras, at):
    """Return all scalars, of rotations the small ones on the right from those of `at`."""
    found = []
    for (name, value), (_, origin) in zip(
        calibration_parameters(imus, cameras), calibration_parameters(*at), strict=True
    ):
        turn = rotation_from_rotvec(origin).T @ rotation_from_rotvec(value) if name.endswith("rotation") else None
        found.append(np.ravel(value) if turn is None else rotvec_from_rotation(turn))
    return np.concatenate(found)


def stepped(calibration, name, step):
    """Return IMUs and cameras with one scalar changed."""
    sensor, _, rest = name.partition(".")
    path, _, index = rest.partition("[")
    at = tuple(int(i) for i in index.rstrip("]").split(",")) if index else ()
    imus, cameras = dict(calibration.imus), dict(calibration.cameras)

    def changed(value):
        array = np.array(value, dtype=np.float64)
        array[at] += step
        return array if array.ndim else float(array)

    if path.endswith("rotation") or path.endswith("translation"):
        of = imus if sensor in imus else cameras
        link = "T_imu_body" if sensor in imus else "T_cam_body"
        T = getattr(of[sensor], link).copy()
        if path.endswith("rotation"):
            T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(step * np.eye(3)[at[0]])
        else:
            T[at[0], 3] += step
        of[sensor] = replace(of[sensor], **{link: T})
    elif sensor in imus and "." in path:
        triad, field = path.split(".")
        field = {"time_shift": "time_shift_s"}.get(field, field)
        own = getattr(imus[sensor], triad)
        imus[sensor] = replace(imus[sensor], **{triad: replace(own, **{field: changed(getattr(own, field))})})
    return imus, cameras


P_STAR = Origin(point="optimal", weights=single_point_weights(*np.random.default_rng(2).normal(size=(2, 9, 3))))
MOVES = {
    "accel-z": lambda imus, cameras: moved_into_frame(imus, cameras, "accel-z"),
    "origin at y": lambda imus, cameras: moved_to_origin(imus, cameras, dict.fromkeys(imus, Origin(point="y"))),
    "origin at p*": lambda imus, cameras: moved_to_origin(imus, cameras, dict.fromkeys(imus, P_STAR)),
}


@pytest.mark.parametrize("move", MOVES)
def test_covariance_moves_as_the_values_do(two_imus, move):
    there = MOVES[move](two_imus.imus, two_imus.cameras)
    at = there.imus, there.cameras
    names = np.array(two_imus.uncertainty.names)
    moving = [n for n in names if (n.startswith("imu") and "time_shift" not in n) or "T_cam" in n]
    for name in moving:
        if _is_exact(name):
            continue
        ahead, behind = (MOVES[move](*stepped(two_imus, name, size)) for size in (1e-6, -1e-6))
        slope = (scalars(ahead.imus, ahead.cameras, at) - scalars(behind.imus, behind.cameras, at)) / 2e-6
        np.testing.assert_allclose(there.jacobian[:, names == name][:, 0], slope, rtol=1e-5, atol=1e-5, err_msg=name)


def test_another_frame_and_another_origin_are_the_same_sensors(two_imus):
    turned = two_imus.in_frame("accel-z")
    pairs = zip(turned.imus.values(), two_imus.imus.values(), strict=True)
    Q = [np.linalg.solve(a.accelerometer.sensitivity, b.accelerometer.sensitivity) for a, b in pairs]
    point = np.array([0.3, -0.2, 0.5])
    before = two_imus.imus["imu1"].T_imu_body @ [*point, 1]
    after = turned.imus["imu1"].T_imu_body @ [*(Q[0] @ point), 1]
    np.testing.assert_allclose(after[:3], Q[1] @ before[:3], atol=1e-14)
    in_frame(turned.imus["imu1"].accelerometer.sensitivity, "accel-z")
    moved = two_imus.with_origin("z")
    arms = [imu.accelerometer.lever_arms_m for imu in two_imus.imus.values()]
    seen = moved.imus["imu1"].T_imu_body @ [*(point - arms[0][2]), 1]
    np.testing.assert_allclose(seen[:3], before[:3] - arms[1][2], atol=1e-15)
    for back in (turned.in_frame("accel-x"), moved.with_origin("x")):
        at = two_imus.imus, two_imus.cameras
        np.testing.assert_allclose(scalars(back.imus, back.cameras, at), scalars(*at, at), atol=1e-13)
        size = np.sqrt(np.diag(two_imus.uncertainty.matrix) + 1e-12)
        difference = back.uncertainty.matrix - two_imus.uncertainty.matrix
        np.testing.assert_allclose(difference / np.outer(size, size), 0, atol=1e-8)


def test_files_hold_poses_and_clocks(two_imus, tmp_path):
    save(two_imus, tmp_path / "calibration.yaml")
    text = (tmp_path / "calibration.yaml").read_text()
    assert "schema: gnomon/1.5" in text
    again = load(tmp_path / "calibration.yaml")
    assert calibration_text(again) == text
    np.testing.assert_array_equal(again.imus["imu1"].T_imu_body, two_imus.imus["imu1"].T_imu_body)
    assert again.imus["imu1"].time_shift_s == -1.7e9
    assert again.imus["imu1"].accelerometer.time_shift_s == 0.012
    assert again.imus["imu0"].T_imu_body is None
    assert again.imus["imu0"].accelerometer.time_shift_s is None
    np.testing.assert_array_equal(again.uncertainty.matrix, two_imus.uncertainty.matrix)
    alone = without_camera_fit(two_imus)  # as of a calibration that was converted
    save(alone, tmp_path / "alone.yaml")
    assert load(tmp_path / "alone.yaml").assessment.camera_imu is None


def without_camera_fit(calibration: Calibration) -> Calibration:
    names = covariance_names(calibration.imus)
    matrix = calibration.uncertainty.matrix[: len(names), : len(names)]
    return replace(
        calibration,
        cameras={},
        uncertainty=Covariance(names=names, matrix=matrix),
        assessment=replace(calibration.assessment, camera_imu=None),
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("    T_imu_body_translation_sigma: [", "    T_imu_body_translation_sigma: [1.0, ", "expected 3|found 4"),
        ("    time_shift_imu: ", "    time_shift_imux: ", "time_shift_imu"),
        ("schema: gnomon/1.5", "schema: gnomon/1.3", "T_imu_body|time_shift"),
        ("time_shift_sigma: ", "time_shift_sigma: 1", "contradicts the covariance"),
    ],
)
def test_files_that_are_wrong_are_refused(two_imus, tmp_path, old, new, said):
    text = calibration_text(two_imus)
    assert old in text
    (tmp_path / "wrong.yaml").write_text(text.replace(old, new))
    with pytest.raises(FormatError, match=said):
        load(tmp_path / "wrong.yaml")


def status_of(of, **options):
    return estimation_choices(of.state.parameters, CameraImuOptions(**options)).status


def test_pose_and_clock_are_always_estimated_and_delays_where_stamps_differ():
    of = problem(imus=2)
    for model in ("basic", "full", "auto"):
        status = status_of(of, model=model)
        assert status["imu1.T_imu_body.rotation[2]"] == status["imu1.time_shift"] == "estimated"
        assert status["imu0.accelerometer_shift"] == status["imu1.accelerometer_shift"] == "fixed"
        assert "imu0.time_shift" not in status
    imus = tuple(replace(imu, apart=bool(i)) for i, imu in enumerate(of.state.parameters.imus))
    separate = replace(of, state=replace(of.state, parameters=replace(of.state.parameters, imus=imus)))
    status = status_of(separate, fix=("imu1.T_imu_body",), free=("imu0.accelerometer_shift",))
    assert status["imu1.accelerometer_shift"] == status["imu0.accelerometer_shift"] == "estimated"
    assert status["imu1.T_imu_body.rotation[0]"] == status["imu1.T_imu_body.translation[2]"] == "fixed"
    assert status_of(separate, fix=("imu1.accelerometer_shift",))["imu1.accelerometer_shift"] == "fixed"


def samples(**stated):
    triad = TriadSamples(t_ns=np.arange(5), values=np.zeros((5, 3)), unit="m/s^2")
    return ImuSamples(accelerometer=triad, gyroscope=replace(triad, unit="rad/s"), **stated)


def test_what_is_kept_has_its_stated_value():
    of = problem(imus=2)
    imu, T = of.state.parameters.imus[1], pose(1)
    status = status_of(of, fix=("imu1.T_imu_body.translation", "imu1.time_shift"))
    kept = with_stated_pose(imu, "imu1", samples(T_imu_body=T, time_shift_s=0.5), status)
    np.testing.assert_array_equal(kept.p_imu_body, T[:3, 3])
    np.testing.assert_array_equal(kept.R_imu_body, imu.R_imu_body)  # it was found
    assert kept.time_shift_s + kept.epoch_s == pytest.approx(0.5, abs=1e-12)
    assert with_stated_pose(imu, "imu1", samples(T_imu_body=T), status).time_shift_s == -imu.epoch_s  # one clock
    with pytest.raises(OptionError, match=r"imu1\.T_imu_body\.translation shall be kept"):
        with_stated_pose(imu, "imu1", samples(), status)


def test_readings_near_the_ends_are_left_out_while_a_clock_moves():
    of = problem(segments=2)
    grid = of.state.trajectory.grid
    stamps = np.linspace(-0.5, 3.0, 701)
    data = InertialData(
        imu=0,
        t_s=stamps,
        gyroscope=TriadData(values=np.zeros((701, 3)), used=np.ones(701, dtype=bool)),
        accelerometer=TriadData(values=np.zeros((701, 3)), used=np.ones(701, dtype=bool)),
    )
    imu = replace(ImuParameters.ideal(), time_shift_s=0.1, accelerometer_shift_s=0.02)
    gyroscope, accelerometer = (within_trajectory(grid, one, imu, 0.05) for one in split_triads(data))
    for one, shift in ((gyroscope, 0.1), (accelerometer, 0.12)):
        at = one.t_s + shift
        edges = [(s.start_s, s.start_s + s.spans * grid.spacing_s) for s in grid.segments]
        inside = [(at >= low + 0.05 - 1e-9) & (at <= high - 0.05 + 1e-9) for low, high in edges]
        assert np.any(inside, axis=0).all()
        assert [int(which.sum()) for which in inside] == pytest.approx([61, 61], abs=1)
    assert gyroscope.accelerometer is None
    assert accelerometer.gyroscope is None


def test_the_model_reads_what_was_simulated():
    """Without noise every IMU reads what the model says of the exact path: place, axes, lever arms, and clocks."""
    scenario = CameraImuScenario(
        duration_s=6.0,
        imus=2,
        noise_factor=0.0,
        accelerometer_delay_s=0.013,
        accelerometer_rate_hz=130.0,
        imu_clock_offset_s=50.0,
    )
    simulation = simulate_camera_imu(scenario, 3)
    t_s = np.arange(0, 6.0, 0.002)
    motion = simulation.trajectory.at(t_s)
    path = ImuPath(t_s=t_s, R=motion.R_target_body, position=motion.p_target_body)
    flat = initial_trajectory(path, t_s[50:-50:20], 100.0, order=6, gyroscope_biases=[np.zeros(3), np.zeros(3)])
    truth, origin = simulation.truth_parameters, simulation.trajectory.start_ns
    of = problem(imus=2).state.parameters
    down = simulation.gravity_target / scenario.gravity
    imus = []
    for i in range(2):
        imu = simulation.truth.imus[f"imu{i}"]
        placed = {} if i == 0 else {
            "R_imu_body": imu.T_imu_body[:3, :3], "p_imu_body": imu.T_imu_body[:3, 3],
            "time_shift_s": imu.time_shift_s,
        }  # fmt: skip
        letters = {name: truth[f"imu{i}.{name}"] for name in ("S_a", "M_a", "S_g", "M_g", "B_g")}
        C_bg = rotation_from_rotvec(truth[f"imu{i}.q_bg"])
        shift = imu.accelerometer.time_shift_s
        assert shift == -0.013
        imus.append(ImuParameters(**letters, **placed, C_bg=C_bg, accelerometer_shift_s=shift, apart=True))
    axes = np.column_stack([*np.linalg.svd(down[None])[2][1:], down])
    known = replace(of, imus=tuple(imus), gravity_axes=axes, gravity_m_s2=scenario.gravity)
    for i, recorded in enumerate(simulation.recording.imus.values()):
        sensors = simulation.truth.imus[f"imu{i}"]
        for which, triad, bias in (
            (0, recorded.gyroscope, sensors.gyroscope.bias),
            (1, recorded.accelerometer, sensors.accelerometer.bias),
        ):
            own = TriadData(values=triad.values, used=np.ones(len(triad), dtype=bool))
            stamps = (triad.t_ns - origin) * 1e-9
            data = InertialData(
                imu=i, t_s=stamps, gyroscope=None if which else own, accelerometer=own if which else None
            )
            inside = within_trajectory(flat.grid, data, known.imus[i], 0.3)
            read = (inside.accelerometer if which else inside.gyroscope).values
            expected = predicted_readings(flat, known, inside)[which] + bias
            assert len(read) > 500
            error = np.abs(read - expected).max()
            assert error < (5e-3 if which else 1e-4), (i, which, error)  # that of the splines


def test_golden_file():
    """A file of two IMUs as version 1.5 of the schema wrote it; it stays readable, and is written as it was.

    The words of its comments may change.
    """

    def data(text):
        return [line for line in text.splitlines() if not line.lstrip().startswith("#")]

    golden = Path(__file__).parents[2] / "golden" / "calibration-gnomon-1.5.yaml"
    calibration = load(golden)
    assert data(calibration_text(calibration)) == data(golden.read_text(encoding="utf-8"))
    second = calibration.imus["imu1"]
    assert second.time_shift_s == pytest.approx(3.986e-3, abs=1e-6)
    assert second.accelerometer.time_shift_s == 0.0021
    assert np.linalg.norm(second.T_imu_body[:3, 3]) == pytest.approx(0.0678, abs=1e-4)
    assert calibration.imus["imu0"].accelerometer.lever_arms_m[1].tolist() == [0.004, -0.002, 0.001]
    assert calibration.sigma("imu1.time_shift_imu") == pytest.approx(1e-5)
    names = calibration.uncertainty.names
    pair = names.index("imu1.T_imu_body.translation[0]"), names.index("cam0.T_cam_imu.translation[0]")
    assert calibration.uncertainty.matrix[pair] > 0


def test_a_cut_at_gaps_of_the_first_imu_says_what_is_lost_of_the_others():
    assert cut_findings(1, ("imu0", "imu1")) == []
    (alone,), (several,) = cut_findings(2, ("imu0",)), cut_findings(2, ("imu0", "imu1", "imu2"))
    assert alone.consequence.startswith("Nothing is lost but")
    assert several.consequence.startswith("In a gap of imu0 neither frames nor the samples of imu1, imu2 are used;")
    assert (alone.cure, several.cure) == ("", "If it is imu0 that lost samples, let another one be the first IMU.")
