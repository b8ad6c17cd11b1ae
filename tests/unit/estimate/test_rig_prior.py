"""What a calibration of the cameras alone tells a camera-IMU calibration: lenses and poses, with their covariance."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from cameras_example import cameras_calibration
from gnomon.estimate.camera_imu.choices import estimation_choices
from gnomon.estimate.camera_imu.layout import border_layout
from gnomon.estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters, gravity_axes
from gnomon.estimate.camera_imu.terms.assembly import border_priors, from_known, pose_residual
from gnomon.formats.shared.entries import baseline_of
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.options import CameraImuOptions
from gnomon.recording import KnownRig
from gnomon.results.sensors import CameraCalibration, covariance_names
from gnomon.writers.simulated_cameras import save_camera_imu_recording

SCENARIO = gnomon.CameraImuScenario(duration_s=12.0, cameras=2)


@pytest.fixture(scope="module")
def simulation():
    return gnomon.simulate_camera_imu(SCENARIO, 3)


def drawn_rig(truth, seed, error=None):
    """Return what a calibration with a drawn covariance and an error of it knows, and the lenses it has."""
    rng = np.random.default_rng(seed)
    poses = {name: camera.T_cam_imu for name, camera in truth.cameras.items()}
    T = poses["cam1"] @ np.linalg.inv(poses["cam0"])
    known = {
        name: CameraCalibration(
            T_cam_body=T if name == "cam1" else np.eye(4), time_shift_cam_imu=0.0, camera=camera.camera, body="cam0"
        )
        for name, camera in truth.cameras.items()
    }
    names = covariance_names({}, known)
    sigma = np.array([_usual(name) for name in names])
    root = sigma[:, None] * (np.eye(len(names)) + 0.2 * rng.normal(size=(len(names),) * 2))
    off = dict(zip(names, (root @ rng.normal(size=len(names))).tolist(), strict=True))
    for name, value in (error or {}).items():
        off[name] += value
    turned = T.copy()
    turned[:3, :3] = T[:3, :3] @ rotation_from_rotvec(
        np.array([off[f"cam1.T_cam_cam0.rotation[{k}]"] for k in range(3)])
    )
    turned[:3, 3] += [off[f"cam1.T_cam_cam0.translation[{k}]"] for k in range(3)]
    lenses = {
        name: camera.camera.with_parameters(
            camera.camera.parameters
            + [value for path, value in off.items() if path.startswith(name) and "T_cam" not in path]
        )
        for name, camera in truth.cameras.items()
    }
    return KnownRig(T_cam_cam0={"cam1": turned}, names=names, covariance=root @ root.T), lenses


def _usual(name):
    if "distortion" in name:
        return 1e-3 if name.endswith(("[0]", "[1]")) else 1e-4
    if "rotation" in name:
        return 4e-4
    return 1e-4 if "translation" in name else 0.3


def own_block(rig, name):
    at = [i for i, path in enumerate(rig.names) if path.startswith(name) and "T_cam" not in path]
    return rig.covariance[np.ix_(at, at)]


def parameters(truth, rig, lenses):
    return RigParameters(
        gravity_axes=gravity_axes(np.array([0.1, 0.2, -1.0])),
        gravity_m_s2=9.81,
        target_scale=1.0,
        imus=(ImuParameters.ideal(),),
        cameras=tuple(
            CameraParameters(
                name=name,
                R_cam_imu=camera.T_cam_imu[:3, :3],
                p_cam_imu=camera.T_cam_imu[:3, 3],
                time_shift_s=0.0,
                camera=lenses[name],
                lens_covariance=own_block(rig, name),
            )
            for name, camera in truth.cameras.items()
        ),
        rig=rig,
    )


@pytest.fixture(scope="module")
def border(simulation):
    rig, lenses = drawn_rig(simulation.truth, 0)
    start = parameters(simulation.truth, rig, lenses)
    chosen = estimation_choices(start, CameraImuOptions())
    return border_layout(start, chosen.status, chosen.prior_sigma), rig


def test_jacobian_of_the_poses(border):
    columns, rig = border
    rng = np.random.default_rng(1)
    at = columns.plus(columns.start, rng.normal(scale=1e-2, size=len(columns)))
    found = pose_residual(rig, columns, at)
    for i in range(len(columns)):
        step = np.zeros(len(columns))
        step[i] = 1e-6
        ahead, behind = (pose_residual(rig, columns, columns.plus(at, sign * step)).residual for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-6, found.jacobian[:, i], atol=1e-8)


def test_both_priors_together_are_the_joint_one(border):
    """Of lenses and poses: information and pull are those of the joint covariance, wherever they are taken."""
    columns, rig = border
    rng = np.random.default_rng(2)
    at = columns.plus(columns.start, rng.normal(scale=1e-4, size=len(columns)))
    found = from_known(rig, columns, at)
    order = [found.names.index(name) for name in rig.names]
    whole = np.linalg.inv(rig.covariance)
    jacobian, residual = found.jacobian[order], found.residual[order]
    information, pull, cost = border_priors(at, columns)
    lenses = np.array([".intrinsics" in name or ".distortion" in name for name in columns.names])
    places = np.array([".T_cam_imu" in name for name in columns.names])
    both = np.flatnonzero(lenses | places)
    own = np.diag(np.where(places, columns.prior_sigma**-2.0, 0.0))  # the weak ones of the poses against the IMU
    expected = jacobian.T @ whole @ jacobian + own
    size = np.sqrt(np.diag(expected)[both])
    got = information[np.ix_(both, both)] / np.outer(size, size)
    np.testing.assert_allclose(got, expected[np.ix_(both, both)] / np.outer(size, size), atol=1e-6)
    stepped = columns.values(at) - columns.prior_mean
    by_poses = np.where(places, columns.prior_sigma**-2.0 * stepped, 0.0)
    np.testing.assert_allclose(
        pull[lenses] / np.sqrt(np.diag(expected)[lenses]),
        (-jacobian.T @ whole @ residual - by_poses)[lenses] / np.sqrt(np.diag(expected)[lenses]),
        atol=1e-5,
    )
    rest = 0.5 * float(np.sum((stepped / columns.prior_sigma)[~lenses & columns.free] ** 2))
    assert np.isclose(cost, 0.5 * residual @ whole @ residual + rest, rtol=1e-6)


def calibrated(simulation, rig, lenses, *, with_poses):
    frames = {
        name: replace(one, camera=lenses[name], lens_covariance=own_block(rig, name), T_cam_imu=None)
        for name, one in simulation.recording.cameras.items()
    }
    recording = replace(simulation.recording, cameras=frames, rig=rig if with_poses else None)
    return gnomon.calibrate_camera_imu(recording, simulation.target).calibration


def test_poses_make_the_result_more_certain_and_the_truth_stays_inside(simulation):
    rig, lenses = drawn_rig(simulation.truth, 4)
    without = calibrated(simulation, rig, lenses, with_poses=False)
    found = calibrated(simulation, rig, lenses, with_poses=True)
    narrow, wide = baseline_of(found, "cam0", "cam1"), baseline_of(without, "cam0", "cam1")
    sigma = np.sqrt(np.diag(narrow.covariance))
    assert (sigma < np.sqrt(np.diag(wide.covariance)) * 1.02).all()
    assert sigma[5] < 0.8 * np.sqrt(wide.covariance[5, 5])
    poses = {name: camera.T_cam_imu for name, camera in simulation.truth.cameras.items()}
    T = poses["cam1"] @ np.linalg.inv(poses["cam0"])
    off = np.r_[rotvec_from_rotation(T[:3, :3].T @ narrow.T[:3, :3]), narrow.T[:3, 3] - T[:3, 3]]
    assert off @ np.linalg.solve(narrow.covariance, off) < 22.5  # 6 degrees of freedom, one of a thousand
    assert "prior-disagrees" not in {finding.code for finding in found.assessment.findings}


@pytest.mark.parametrize(
    ("error", "named"),
    [
        ({"cam1.T_cam_cam0.translation[0]": 1e-3}, "cam1.T_cam_cam0.translation[0]"),
        ({"cam0.intrinsics[0]": 3.0, "cam0.intrinsics[1]": 3.0}, "cam0.intrinsics["),
    ],
)
def test_a_wrong_calibration_of_the_cameras_is_noticed(simulation, error, named):
    rig, lenses = drawn_rig(simulation.truth, 4, error)
    found = calibrated(simulation, rig, lenses, with_poses=True)
    (said,) = [finding for finding in found.assessment.findings if finding.code == "prior-disagrees"]
    assert named in said.message
    assert "--cam" in said.message
    assert found.verdict != "pass"


def test_a_calibration_of_the_cameras_comes_along_with_the_recording(simulation, tmp_path):
    """By `read_camera_imu`; other files of lenses tell of no poses with a covariance."""
    save_camera_imu_recording(simulation, tmp_path)
    calibration = cameras_calibration(2, 2)
    gnomon.save(calibration, tmp_path / "cameras.yaml")
    files = {"imu": tmp_path / "imu.yaml", "target": tmp_path / "target.yaml"}
    recording, _ = gnomon.read_camera_imu(tmp_path, cam=tmp_path / "cameras.yaml", **files)
    assert recording.rig.names == calibration.uncertainty.names
    assert np.array_equal(recording.rig.T_cam_cam0["cam1"], calibration.cameras["cam1"].T_cam_body)
    assert recording.cameras["cam1"].T_cam_imu is None
    assert any("poses of the cameras to each other are known by cameras.yaml" in text for text in recording.assumptions)
    other, _ = gnomon.read_camera_imu(tmp_path, cam=tmp_path / "camchain.yaml", **files)
    assert other.rig is None


def test_cameras_that_were_calibrated_from_this_very_recording_are_no_prior(simulation, tmp_path):
    """The same corners would count twice: what they told is where the lenses start, and they are estimated jointly."""
    save_camera_imu_recording(simulation, tmp_path)
    calibration = cameras_calibration(2, 2)
    files = {"imu": tmp_path / "imu.yaml", "target": tmp_path / "target.yaml"}
    gnomon.save(calibration, tmp_path / "cameras.yaml")
    elsewhere, _ = gnomon.read_camera_imu(tmp_path, cam=tmp_path / "cameras.yaml", **files)
    corners = tuple(source for source in elsewhere.sources if "corners" in source.name)
    own = replace(calibration, provenance=replace(calibration.provenance, inputs=corners))
    gnomon.save(own, tmp_path / "cameras.yaml")
    same, _ = gnomon.read_camera_imu(tmp_path, cam=tmp_path / "cameras.yaml", **files)
    assert [finding.code for finding in same.findings if finding.code == "prior-same-data"]
    assert not [finding for finding in elsewhere.findings if finding.code == "prior-same-data"]
    assert (np.diag(same.rig.covariance) >= 1e4 * np.diag(elsewhere.rig.covariance)).all()
    for name, frames in same.cameras.items():
        assert (np.diag(frames.lens_covariance) >= 1e4 * np.diag(elsewhere.cameras[name].lens_covariance)).all()
