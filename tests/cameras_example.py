"""A calibration of cameras alone, made up: one lens, or several with their baselines and a full covariance."""

import numpy as np

from gnomon.findings import Finding
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.recording import Source
from gnomon.results.calibration import UNSTATED_GRAVITY, Assessment, Calibration, CamerasFit, Covariance, Provenance
from gnomon.results.sensors import CameraCalibration, covariance_names
from gnomon.results.trust import UncertaintySummary

LENSES = {
    "cam0": Camera(
        projection="pinhole", intrinsics=np.array([458.654, 457.296, 367.215, 248.375]), distortion="radtan",
        distortion_coeffs=np.array([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]), resolution=(752, 480),
        topic="/cam0/image_raw",
    ),
    "cam1": Camera(
        projection="pinhole", intrinsics=np.array([457.587, 456.134, 379.999, 255.238]), distortion="equidistant",
        distortion_coeffs=np.array([-0.0183, 0.0074, -0.0021, 0.0003]), resolution=(752, 480), line_delay_s=1.5e-5,
    ),
    "cam2": Camera(
        projection="ds", intrinsics=np.array([-0.2, 0.57, 310.0, 311.0, 365.5, 241.5]), distortion="none",
        distortion_coeffs=np.empty(0), resolution=(752, 480),
    ),
}  # fmt: skip
"""Lenses of other kinds, one a camera."""


def cameras_calibration(seed=0, cameras=2, *, findings=True) -> Calibration:
    """Return a calibration of the first cameras of `LENSES`."""
    rng = np.random.default_rng(seed)
    found = {}
    for i, (name, lens) in enumerate(list(LENSES.items())[:cameras]):
        T = np.eye(4)
        if i:
            T[:3, :3] = rotation_from_rotvec(rng.normal(scale=0.02, size=3))
            T[:3, 3] = (-0.11 * i, *rng.normal(scale=1e-3, size=2))
        found[name] = CameraCalibration(T_cam_body=T, time_shift_cam_imu=0.0, camera=lens, body="cam0")
    names = covariance_names({}, found)
    sigma = np.array([_usual(name) for name in names])
    mixed = np.eye(len(names)) + 0.1 * rng.normal(size=(len(names), len(names)))
    root = sigma[:, None] * mixed
    told = (Finding(severity="info", code="board-bow", message="The board is bowed.", cure="Glue it to glass."),)
    return Calibration(
        imus={},
        frame="cam0",
        gravity=UNSTATED_GRAVITY,
        uncertainty=Covariance(names=names, matrix=root @ root.T),
        assessment=Assessment(
            verdict="pass",
            findings=told if findings else (),
            model="cam0 pinhole-radtan",
            cameras=_fit(tuple(found)),
            trust=UncertaintySummary(covariance="cluster-robust", clusters=60, added=("target.bow",), tries=3),
        ),
        provenance=Provenance(
            gnomon_version="0.1.0",
            method="cameras",
            inputs=(Source(name="cam0_corners.csv", sha256="ab" * 32),),
            options={"views": "60"},
        ),
        cameras=found,
    )


def _usual(name: str) -> float:
    if "distortion" in name:
        return 1e-4
    if "rotation" in name:
        return 1e-5
    return 2e-5 if "translation" in name else 0.05


def _fit(names: tuple[str, ...]) -> CamerasFit:
    return CamerasFit(
        views_found=dict.fromkeys(names, 90),
        views_used=dict.fromkeys(names, 60),
        corners_used=dict.fromkeys(names, 7800),
        reprojection_rms_px=dict.fromkeys(names, 0.0871),
        holdout_rms_px={name: 0.0893 if name == "cam0" else float("nan") for name in names},
        coverage=dict.fromkeys(names, 0.86),
        models=dict.fromkeys(names, ("pinhole-radtan", "pinhole-equidistant")),
        board_added=("target.bow",),
        bow_m=4.1e-4,
        bow_sigma_m=3e-5,
    )
