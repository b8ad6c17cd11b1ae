"""Accelerometers that do not sit at one point: simulated, moved between frames and origins, in files, and estimated."""

import os
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.cli.camera_summary import imu_pose_lines
from gnomon.errors import FormatError, OptionError
from gnomon.formats.own.calibration_file import load
from gnomon.formats.own.calibration_text import calibration_text, save
from gnomon.geometry.rotations import acceleration_by_place, rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.origin import Origin, single_point_weights
from gnomon.options import CameraImuOptions
from gnomon.report.drawing.rig import origin_figure
from gnomon.results.calibration import Covariance
from gnomon.results.sensors import calibration_parameters, covariance_names
from gnomon.results.trust import Need, UncertaintySummary
from gnomon.simulate.camera_imu import simulate_camera_imu
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.writers.tables import summary_table
from kalibr_imus import read_kalibr

ARMS = (0.0075, -0.0116, 0.0006, 0.0074, -0.0112, 0.0015)
PLACES = np.array([0.0, 0.0, 0.0, *ARMS]).reshape(3, 3)


def with_arms(calibration, places=PLACES, seed=3):
    """Return a calibration with lever arms, all of them and everything else uncertain together."""
    imu = calibration.imus["imu0"]
    imus = {"imu0": replace(imu, accelerometer=replace(imu.accelerometer, lever_arms_m=places))}
    names = covariance_names(imus, calibration.cameras)
    old = [i for i, name in enumerate(names) if "lever_arms" not in name]
    matrix = np.zeros((len(names),) * 2)
    matrix[np.ix_(old, old)] = calibration.uncertainty.matrix
    arms = [i for i, name in enumerate(names) if "lever_arms" in name and np.any(places.ravel()) and name[-4] != "0"]
    root = np.random.default_rng(seed).normal(0, 1e-3, (len(arms), len(arms)))
    matrix[np.ix_(arms, arms)] = root @ root.T
    return replace(calibration, imus=imus, uncertainty=Covariance(names=names, matrix=matrix))


def test_every_accelerometer_feels_the_force_at_its_place():
    scenario = CameraImuScenario(
        duration_s=3.0, accelerometer_arms_m=ARMS, noise_factor=0.0, earth_rate_latitude=47.0, motion="tremor"
    )
    simulation, plain = (simulate_camera_imu(one, 1) for one in (scenario, replace(scenario, accelerometer_arms_m=())))
    sensor = simulation.truth.with_origin("x").imus["imu0"].accelerometer
    np.testing.assert_allclose(sensor.lever_arms_m, PLACES, rtol=0, atol=1e-15)
    felt = sensor.specific_force(simulation.recording.imus["imu0"].accelerometer.values - simulation.b_a + sensor.bias)
    earth = simulation.trajectory.omega_imu - simulation.trajectory.at(simulation.trajectory.t_s).omega
    for k, place in enumerate(PLACES):
        there = simulation.trajectory.T_cam0_imu.copy()
        there[:3, 3] += there[:3, :3] @ place
        motion = simulation.trajectory.path.at(simulation.trajectory.t_s).of(there)
        earth_target = np.einsum("nij,nj->ni", motion.R_target_body, earth)
        acceleration = motion.acceleration + 2 * np.cross(earth_target, motion.velocity) - simulation.gravity_target
        expected = np.einsum("nji,nj->ni", motion.R_target_body, acceleration)[:, k]
        np.testing.assert_allclose(felt[:, k], expected, rtol=0, atol=1e-8)  # less the centrifugal force of the Earth
    assert np.abs(felt - plain.trajectory.f_imu).max() > 0.1
    assert plain.truth.imus["imu0"].accelerometer.lever_arms_m is None
    a, b = (s.recording.imus["imu0"].gyroscope.values for s in (simulation, plain))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("arms", [(0.01,), (0.0, 0.0, 0.0, 0.0, 0.0, np.inf)])
def test_arms_that_are_no_two_places_are_refused(arms):
    with pytest.raises(OptionError, match="accelerometer_arms_m"):
        CameraImuScenario(accelerometer_arms_m=arms)


def scalars(calibration, at):
    """Return all scalars, of rotations the small ones on the right from those of `at`."""
    found = []
    for (name, value), (_, origin) in zip(
        calibration_parameters(calibration.imus, calibration.cameras),
        calibration_parameters(at.imus, at.cameras),
        strict=True,
    ):
        turn = rotation_from_rotvec(origin).T @ rotation_from_rotvec(value) if name.endswith("rotation") else None
        found.append(np.ravel(value) if turn is None else rotvec_from_rotation(turn))
    return np.concatenate(found)


def moved_by(calibration, k, step):
    """Return the calibration with one scalar changed: a lever arm, or the rotation of cam0."""
    imu, camera = calibration.imus["imu0"], calibration.cameras["cam0"]
    name = calibration.uncertainty.names[k]
    if "lever_arms" in name:
        places = imu.accelerometer.lever_arms_m.copy()
        places[int(name[-4]), int(name[-2])] += step
        accelerometer = replace(imu.accelerometer, lever_arms_m=places)
        return replace(calibration, imus={"imu0": replace(imu, accelerometer=accelerometer)})
    T = camera.T_cam_imu.copy()
    T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(step * np.eye(3)[int(name[-2])])
    return replace(calibration, cameras={**calibration.cameras, "cam0": replace(camera, T_cam_body=T)})


@pytest.mark.parametrize("axis", "xyz")
def test_another_origin_is_the_same_sensor(camera_calibration, axis):
    calibration = with_arms(camera_calibration(1))
    moved = calibration.with_origin(axis)
    place = PLACES["xyz".index(axis)]
    np.testing.assert_array_equal(moved.parameter("imu0.accelerometer.lever_arms_m"), PLACES - place)
    for name, camera in calibration.cameras.items():  # the origin itself is seen where it was
        seen = moved.cameras[name].T_cam_imu @ [0, 0, 0, 1]
        np.testing.assert_allclose(seen, camera.T_cam_imu @ [*place, 1], rtol=0, atol=1e-15)
    back = moved.with_origin("x")
    np.testing.assert_allclose(scalars(back, calibration), scalars(calibration, calibration), rtol=0, atol=1e-15)
    size = np.sqrt(np.outer(*[np.diag(calibration.uncertainty.matrix) + 1e-30] * 2))
    np.testing.assert_allclose(back.uncertainty.matrix / size, calibration.uncertainty.matrix / size, atol=1e-9)


def test_covariance_moves_with_the_origin(camera_calibration):
    calibration = with_arms(camera_calibration(1))
    moved, names = calibration.with_origin("y"), calibration.uncertainty.names
    J = np.eye(len(names))
    for k, name in enumerate(names):
        if "lever_arms" in name or name.startswith("cam0.T_cam_imu.rotation"):
            ahead, behind = (scalars(moved_by(calibration, k, s).with_origin("y"), moved) for s in (1e-6, -1e-6))
            J[:, k] = (ahead - behind) / 2e-6
    kept = [i for i, name in enumerate(names) if not name.startswith("cam1")]
    expected = (J @ calibration.uncertainty.matrix @ J.T)[np.ix_(kept, kept)]
    found = moved.uncertainty.matrix[np.ix_(kept, kept)]
    size = np.sqrt(np.outer(np.diag(expected) + 1e-30, np.diag(expected) + 1e-30))
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-6)
    sigma = moved.sigma("imu0.accelerometer.lever_arms_m")
    assert not sigma[1].any()
    assert (sigma[[0, 2]] > 0).all()


def test_origin_has_to_be_an_accelerometer(camera_calibration):
    for wrong in ("accel-y", "0.01,0", "0.01,0,nan", "0,0,2", "optimal,x,y"):
        with pytest.raises(OptionError, match=r"Choose optimal .* or z accelerometer, or state"):
            camera_calibration().with_origin(wrong)
    plain = camera_calibration(2)
    np.testing.assert_array_equal(plain.with_origin("z").uncertainty.matrix, plain.uncertainty.matrix)


def test_places_turn_with_the_body_frame(camera_calibration):
    calibration = with_arms(camera_calibration(2))
    turned = calibration.in_frame("accel-z")
    Q = turned.cameras["cam0"].T_cam_imu[:3, :3].T @ calibration.cameras["cam0"].T_cam_imu[:3, :3]
    np.testing.assert_allclose(turned.parameter("imu0.accelerometer.lever_arms_m"), PLACES @ Q.T, rtol=0, atol=1e-15)
    again = turned.in_frame("accel-x")
    np.testing.assert_allclose(again.parameter("imu0.accelerometer.lever_arms_m"), PLACES, rtol=0, atol=1e-15)


def trusted(calibration):
    note = UncertaintySummary(
        covariance="cluster-robust", clusters=29, cluster_s=2.0, split_z=1.125, added=("lever arms", "board"), tries=7,
        sigma_ratio={"imu0.gyroscope.bias": 3.5, "cam0.T_cam_imu.rotation": float("inf")}, use="vio",
        needs=(
            Need(block="rotation of cam0", sigma=0.02, needed=0.1, unit="deg", verdict="pass"),
            Need(block="time shift", sigma=2.5, needed=0.5, unit="ms", verdict="fail", cure="rotate: 10 s more"),
        ),
    )  # fmt: skip
    return replace(calibration, assessment=replace(calibration.assessment, trust=note))


def test_file_holds_arms_and_trust(camera_calibration, tmp_path):
    calibration = trusted(with_arms(camera_calibration(3)))
    save(calibration, tmp_path / "calibration.yaml")
    text = (tmp_path / "calibration.yaml").read_text()
    assert "schema: gnomon/1.3\n" in text
    assert "# Lever arms:" in text
    read = load(tmp_path / "calibration.yaml")
    np.testing.assert_array_equal(read.parameter("imu0.accelerometer.lever_arms_m"), PLACES)
    np.testing.assert_array_equal(read.uncertainty.matrix, calibration.uncertainty.matrix)
    assert read.assessment.trust == calibration.assessment.trust
    assert calibration_text(read) == text


def test_only_what_needs_the_newer_schema_has_it(camera_calibration, tmp_path):
    plain = camera_calibration(3)
    assert "schema: gnomon/1.1\n" in calibration_text(plain)
    assert "trust" not in calibration_text(plain)
    text = calibration_text(trusted(plain))
    assert "schema: gnomon/1.3\n" in text
    older = tmp_path / "older.yaml"
    for known in ("1.2", "1.1"):
        older.write_text(text.replace("gnomon/1.3", f"gnomon/{known}"))
        with pytest.raises(FormatError, match=r"assessment\.trust: unknown key"):
            load(older)
    older.write_text(calibration_text(with_arms(plain)).replace("gnomon/1.3", "gnomon/1.2"))
    with pytest.raises(FormatError, match=r"accelerometer\.lever_arms_m: unknown key"):
        load(older)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("covariance: cluster-robust", "covariance: robust", "covariance"),
        ("clusters: 29", "clusters: 2.5", "clusters"),
        ("verdict: fail\n        cure", "verdict: bad\n        cure", "verdict"),
        ("      use: vio", "      uses: vio", "use"),
    ],
)
def test_trust_that_makes_no_sense_is_refused(camera_calibration, tmp_path, old, new, words):
    text = calibration_text(trusted(camera_calibration(3)))
    old, new = old.replace("      use", "    use"), new.replace("      use", "    use")
    assert old in text, text[text.index("trust") :][:900]
    (tmp_path / "c.yaml").write_text(text.replace(old, new))
    with pytest.raises(FormatError, match=words):
        load(tmp_path / "c.yaml")


def test_kalibr_gets_them_from_the_same_origin_as_the_cameras(camera_calibration, tmp_path):
    calibration = with_arms(camera_calibration(4)).with_origin("optimal")
    gnomon.convert(calibration, "kalibr", tmp_path)
    text = (tmp_path / "imu.yaml").read_text()
    assert "model: scale-misalignment-size-effect" in text
    for name in ("imu.yaml", "camchain-imucam.yaml"):
        assert "The origin of imu0, to which poses refer, is the point" in (tmp_path / name).read_text()
    read = read_kalibr(tmp_path / "imu.yaml")
    found = read.imus["imu0"].accelerometer
    places = calibration.parameter("imu0.accelerometer.lever_arms_m")
    np.testing.assert_allclose(found.lever_arms_m, places, rtol=0, atol=1e-15)
    sensitivity = calibration.in_frame("accel-x").imus["imu0"].accelerometer.sensitivity
    np.testing.assert_allclose(found.sensitivity, sensitivity, rtol=1e-12, atol=1e-15)


@pytest.fixture(scope="module")
def recorded():
    scenario = CameraImuScenario(duration_s=20.0, accelerometer_arms_m=ARMS)
    return simulate_camera_imu(scenario, 5)


def calibrated(simulation, **options):
    from gnomon.calibrate.camera_imu import calibrate_camera_imu

    options = CameraImuOptions(**{"model": "full", **options})
    return calibrate_camera_imu(simulation.recording, simulation.target, options).calibration


def test_arms_are_found_where_they_are_asked_for(recorded):
    found = calibrated(recorded, free=("imu0.lever_arms",), covariance="ordinary", origin="x")
    places, sigma = (of("imu0.accelerometer.lever_arms_m") for of in (found.parameter, found.sigma))
    assert not sigma[0].any()
    assert not places[0].any()
    assert (sigma[1:] < 3e-3).all()
    assert np.abs(places / np.where(sigma > 0, sigma, np.inf)).max() > 8
    assert (np.abs(places - PLACES)[1:] < 4 * sigma[1:]).all()
    truth = recorded.truth.with_origin("x")
    camera, true = found.cameras["cam0"].T_cam_imu[:3, 3], truth.cameras["cam0"].T_cam_imu[:3, 3]
    assert (np.abs(camera - true) < 4 * found.sigma("cam0.T_cam_imu.translation")).all()
    # Without them the camera seems to sit elsewhere.
    plain = calibrated(recorded, covariance="ordinary")
    assert plain.imus["imu0"].accelerometer.lever_arms_m is None
    assert np.linalg.norm(plain.cameras["cam0"].T_cam_imu[:3, 3] - true) > 4 * np.linalg.norm(camera - true)


@pytest.mark.first(2)
@pytest.mark.parametrize("origin", ["optimal", "x", "z", "0.01,-0.02,0.003"])
def test_the_default_is_of_the_point_that_it_names(recorded, origin):
    """Lever arms are always estimated, at any origin the same rig, and best known at p*."""
    found = calibrated(recorded, model="auto", origin=origin, gravity=9.80665)
    assert found.assessment.trust.added == ()
    assert "lever-arms-found" in {finding.code for finding in found.assessment.findings}
    truth = recorded.truth.with_origin(found.imus["imu0"].origin)
    for path in ("cam0.T_cam_imu.translation", "imu0.accelerometer.lever_arms_m"):
        sigma = found.sigma(path)
        error = found.parameter(path) - truth.parameter(path)
        assert (np.abs(error[sigma > 0]) < 4 * sigma[sigma > 0]).all()
        assert np.abs(error[sigma == 0]).max(initial=0) < 1e-12
    sigma = found.sigma("cam0.T_cam_imu.translation")
    if origin == "optimal":
        assert sigma.max() < 5e-4
        assert np.abs(truth.parameter("cam0.T_cam_imu.translation")
                      - recorded.truth.parameter("cam0.T_cam_imu.translation")).max() < 1e-3  # fmt: skip
    else:
        assert sigma.max() > 1e-3
        best, default = found.with_origin("optimal"), calibrated(recorded, model="auto", gravity=9.80665)
        np.testing.assert_allclose(best.parameter("cam0.T_cam_imu.translation"),
                                   default.parameter("cam0.T_cam_imu.translation"), rtol=0, atol=1e-4)  # fmt: skip
        np.testing.assert_allclose(best.sigma("cam0.T_cam_imu.translation"),
                                   default.sigma("cam0.T_cam_imu.translation"), rtol=0.1)  # fmt: skip
        assert best.sigma("cam0.T_cam_imu.translation").max() < 5e-4
        back = best.with_origin(origin)
        np.testing.assert_allclose(back.uncertainty.matrix, found.uncertainty.matrix, rtol=1e-6, atol=1e-13)


def test_compare_moves_to_a_common_point(recorded):
    """The same rig at four points, an older file, and the truth agree; nearly no z is left of one recording."""
    found = calibrated(recorded, model="auto", gravity=9.80665)
    older = found.with_origin("x")
    older = replace(older, imus={"imu0": replace(older.imus["imu0"], origin=Origin(point="x"))})
    other = single_point_weights(*np.random.default_rng(1).normal(size=(2, 20, 3)))
    elsewhere = found.with_origin(Origin(point="optimal", weights=other))
    for first, second in ((found, older), (older, found), (found, elsewhere), (older, older.with_origin("z"))):
        compared = gnomon.compare(first, second, names=["a", "b"])
        differences = {one.path: one for one in compared.differences}
        for path in ("cam0.translation", "imu0.accelerometer.lever_arms"):
            np.testing.assert_allclose(differences[path].values, 0, atol=1e-12)
    for one in (found, older):
        compared = gnomon.compare(one, recorded.truth.with_origin("z"), names=["found", "truth"])
        assert compared.z_rms < 1.5
        assert not {"lever-arms-in-some", "origins-differ"} & {finding.code for finding in compared.findings}


def test_compare_says_what_it_cannot_move(recorded, camera_calibration):
    found = calibrated(recorded, model="auto", gravity=9.80665)
    plain = calibrated(recorded, gravity=9.80665)
    compared = gnomon.compare(found, plain, names=["arms", "plain"])
    assert "lever-arms-in-some" in {finding.code for finding in compared.findings}
    translation = next(one for one in compared.differences if one.path == "cam0.translation")
    assert np.linalg.norm(translation.values) < 1e-4 < 0.01 * np.linalg.norm(PLACES, axis=1).max()
    for path in ("cam0.T_cam_imu.translation",):  # the point of the default is that of the model with one place
        assert np.linalg.norm(found.parameter(path) - plain.parameter(path)) < 2e-4
    imu = plain.imus["imu0"]
    other = replace(
        imu, origin=Origin(point="optimal", weights=np.array([np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))]))
    )
    compared = gnomon.compare(plain, replace(plain, imus={"imu0": other}), names=["a", "b"])
    assert "origins-differ" in {finding.code for finding in compared.findings}


def test_without_lever_arms_there_is_one_point_alone(recorded):
    with pytest.raises(OptionError, match="one point"):
        calibrated(recorded, origin="x")
    with pytest.raises(OptionError, match="one point"):
        calibrated(recorded, model="auto", fix=("imu0.lever_arms",), origin="0.01,0,0")


def test_p_star_is_what_one_place_fits_best():
    """The minimum of sum_k E[(b_k' (r_k - p))^2], found by least squares; of planar motion what it tells."""
    rng = np.random.default_rng(7)
    omega, alpha = rng.normal(size=(500, 3)) * [1, 2, 0.5], rng.normal(size=(500, 3)) * [3, 1, 2]
    weights = single_point_weights(omega, alpha)
    np.testing.assert_allclose(weights.sum(axis=0), np.eye(3), rtol=0, atol=1e-14)
    B = acceleration_by_place(omega, alpha)
    felt = np.einsum("nkj,kj->nk", B, PLACES).ravel()
    expected = np.linalg.lstsq(B.reshape(-1, 3), felt, rcond=None)[0]
    np.testing.assert_allclose(Origin(point="optimal", weights=weights).of(PLACES), expected, rtol=0, atol=1e-7)
    about_z = single_point_weights(np.outer(omega[:, 2], [0, 0, 1]), np.outer(alpha[:, 2], [0, 0, 1]))
    np.testing.assert_allclose(about_z.sum(axis=0), np.eye(3), rtol=0, atol=1e-9)
    still = single_point_weights(np.zeros((3, 3)), np.zeros((3, 3)))
    np.testing.assert_allclose(np.einsum("kij,kj->i", still, PLACES), (PLACES.sum(0) - np.diag(PLACES)) / 2)


def test_files_hold_the_origin_and_older_ones_are_of_x(camera_calibration, tmp_path):
    weights = single_point_weights(*np.random.default_rng(1).normal(size=(2, 20, 3)))
    older = with_arms(camera_calibration(3))
    assert "origin:" not in calibration_text(older)
    imu = older.imus["imu0"]
    known = replace(older, imus={"imu0": replace(imu, origin=Origin(weights=weights))})
    for origin in ("optimal", "y", "0.01,0.02,-0.03"):
        moved = known.with_origin(origin)
        save(moved, tmp_path / "c.yaml")
        text = (tmp_path / "c.yaml").read_text()
        assert "schema: gnomon/1.6\n" in text
        assert "# Origin: which point" in text
        read = load(tmp_path / "c.yaml")
        assert calibration_text(read) == text
        assert read.imus["imu0"].origin.words == moved.imus["imu0"].origin.words
        np.testing.assert_array_equal(read.imus["imu0"].origin.weights, weights)
    save(older, tmp_path / "older.yaml")
    read = load(tmp_path / "older.yaml")
    assert read.imus["imu0"].origin.point == "x"
    np.testing.assert_allclose(read.with_origin("optimal").imus["imu0"].accelerometer.lever_arms_m,
                               PLACES - (PLACES.sum(0) - np.diag(PLACES)) / 2, atol=1e-15)  # fmt: skip
    for old, new, words in (
        ("point: place", "point: centre", "point"),
        ("point: place", "point: optimal", "place_m"),
        ("gnomon/1.6", "gnomon/1.5", "origin: unknown key"),
        ("        x:\n          - [", "        x:\n          - [1", "sum up"),
    ):
        assert old in text, text[text.index("origin:") : text.index("origin:") + 400]
        (tmp_path / "bad.yaml").write_text(text.replace(old, new, 1))
        with pytest.raises(FormatError, match=words):
            load(tmp_path / "bad.yaml")


def test_a_prior_holds_them(recorded):
    found = calibrated(recorded, prior=("imu0.lever_arms=0.0001",), covariance="ordinary", origin="x")
    places, sigma = found.parameter("imu0.accelerometer.lever_arms_m"), found.sigma("imu0.accelerometer.lever_arms_m")
    assert (sigma[1:] < 1.01e-4).all()
    assert (np.abs(places) < np.abs(PLACES) + 1e-4).all()
    assert np.abs(places[1, 1]) < 0.9 * np.abs(PLACES[1, 1])


def test_report_and_screen_show_the_point(recorded):
    found = calibrated(recorded, model="auto", gravity=9.80665)
    figure = origin_figure(found, "imu0")
    assert figure is not None
    for words in ("x accelerometer", "y accelerometer", "z accelerometer", "origin", "to cam0"):
        assert words in figure.svg
    assert "(p*)" in figure.caption
    assert origin_figure(calibrated(recorded), "imu0") is None
    lines = "\n".join(imu_pose_lines(found))
    places, sigma = (1e3 * of("imu0.accelerometer.lever_arms_m") for of in (found.parameter, found.sigma))
    assert "imu0 origin        the point of the IMU whose place is known best (p*)" in lines
    assert f"{places[0, 1]:.2f} +- {sigma[0, 1]:.2f}" in lines


@pytest.mark.slow
@pytest.mark.parametrize("size_mm", [0, 10, 2, 20])
def test_errors_at_p_star_are_what_their_sigmas_say(size_mm):
    """z of t over recordings of 15 s, by default and with one place for all; GNOMON_STUDY scales their number (50).

    A model with one place for all accelerometers is at its p* by its nature; its sigmas hold what it leaves out, too.
    """
    path = "cam0.T_cam_imu.translation"
    z: dict[str, list[np.ndarray]] = {"auto": [], "full": []}
    ratio, apart_mm = [], []
    for seed in range(max(6, round(50 * float(os.environ.get("GNOMON_STUDY", "1"))))):
        arms = np.random.default_rng((seed, 1)).normal(size=6)
        arms *= 1e-3 * size_mm / np.sqrt(np.mean(arms**2))
        scenario = CameraImuScenario(duration_s=15.0, accelerometer_arms_m=tuple(arms) if size_mm else ())
        simulation = simulate_camera_imu(scenario, 400 + seed)
        found = {model: calibrated(simulation, model=model, gravity=9.80665) for model in z}
        for model, one in found.items():
            truth = simulation.truth.with_origin(one.imus["imu0"].origin)
            z[model].append((one.parameter(path) - truth.parameter(path)) / one.sigma(path))
        ratio.append(found["auto"].sigma(path) / found["full"].sigma(path))
        there = found["auto"].with_origin(found["full"].imus["imu0"].origin)
        apart_mm.append(1e3 * (there.parameter(path) - found["full"].parameter(path)))
    rms = {model: float(np.sqrt(np.mean(np.square(values)))) for model, values in z.items()}
    told = f"{np.mean(ratio):.3f}, {np.min(ratio):.3f} to {np.max(ratio):.3f}"
    print(f"\narms of {size_mm} mm: z rms of t {rms}, {np.size(z['auto'])} scalars; sigma, auto by full: mean {told}; "
          f"apart {np.std(apart_mm):.3f} mm")  # fmt: skip
    assert abs(rms["auto"] - 1) < max(0.1, 2.5 / np.sqrt(2 * len(ratio) * 3))
    assert rms["full"] < 1.1
    if not size_mm:
        assert abs(np.mean(ratio) - 1) < 0.05


def test_show_names_the_origin(camera_calibration):
    calibration = with_arms(camera_calibration(2))
    for origin, words in (
        ("optimal", "p*"),
        ("y", "y accelerometer"),
        ("0.01,0,0", "10 0 0 mm from the x accelerometer"),
    ):
        moved = calibration.with_origin(origin)
        assert {row.name: row.value for row in summary_table(moved).rows}["origin of imu0"] == words
