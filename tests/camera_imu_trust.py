"""Errors of what is published of a simulated recording, in sigmas of both kinds."""

from dataclasses import dataclass

import numpy as np

import gnomon
from gnomon.geometry.rotations import rotvec_from_rotation


@dataclass(frozen=True, kw_only=True)
class Trusted:
    """One simulated recording, calibrated.

    Attributes
    ----------
    blocks : (n,) path of each estimated scalar
    error : (n,) estimate minus truth, of rotations the small angles between them
    sigma, ordinary : (n,) published, and for independent errors
    splits : as in `Trust`
    clusters : as in `Trust`
    codes : of the findings
    """

    seed: int
    blocks: tuple[str, ...]
    error: np.ndarray
    sigma: np.ndarray
    ordinary: np.ndarray
    splits: object
    clusters: object
    codes: tuple[str, ...]

    @property
    def z(self):
        return self.error / self.sigma

    @property
    def z_ordinary(self):
        return self.error / self.ordinary


def trusted(scenario, options, seed) -> Trusted:
    """Simulate and calibrate; a process of its own can do it."""
    simulation = gnomon.simulate_camera_imu(scenario, seed)
    result = gnomon.calibrate_camera_imu(simulation.recording, simulation.target, options)
    return judged(result, simulation.truth, seed)


def judged(result, truth, seed=0) -> Trusted:
    """Compare a result with the truth."""
    calibration, trust = result.calibration, result.diagnostics.trust
    paths = tuple(name.partition("[")[0] for name in trust.names)
    error = []
    for path in dict.fromkeys(paths):
        found, true = calibration.parameter(path), truth.parameter(path)
        difference = np.ravel(found - true)
        if path.endswith("T_cam_imu.rotation"):
            name = path.partition(".")[0]
            rotations = [one.cameras[name].T_cam_imu[:3, :3] for one in (truth, calibration)]
            difference = rotvec_from_rotation(rotations[0].T @ rotations[1])
        names = gnomon.results.calibration.element_names(path, found.shape)
        error += [value for value, name in zip(difference, names, strict=True) if name in trust.names]
    return Trusted(
        seed=seed,
        blocks=paths,
        error=np.array(error),
        sigma=trust.sigma,
        ordinary=trust.ordinary_sigma,
        splits=trust.splits,
        clusters=trust.clusters,
        codes=tuple(f.code for f in calibration.assessment.findings),
    )


def rms_by_block(found, of):
    """Return block -> root mean square of a property over all recordings."""
    values = np.array([getattr(one, of) for one in found])
    blocks = np.array(found[0].blocks)
    return {block: float(np.sqrt(np.mean(values[:, blocks == block] ** 2))) for block in dict.fromkeys(blocks.tolist())}
