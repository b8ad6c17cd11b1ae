"""From an estimated rig to what a calibration publishes: scaled by a known baseline, with the covariance that holds."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...errors import OptionError
from ...estimate.cameras.rig import RigSolution
from ...estimate.trust.parts import robust_covariance
from ...frozen import value_class
from ...options import CameraOptions
from ...recording import Floats
from ...results.calibration import CameraCalibration
from ...results.sensors import covariance_names
from ...results.trust import Trust
from .camera_lenses import IndependentViews

SCALE = "target.scale"
"""Name of the true size of the board over the stated one."""

_BOARD = ("target.aspect", "target.bow")


@value_class
class PublishedCameras:
    """Cameras with the covariance of their scalars, and of what is known of the board after them.

    Attributes
    ----------
    cameras : "cam0", ... -> camera, in frame "cam0"
    names : (n,) scalars of the cameras as `covariance_names` has them; then "target.aspect" and "target.bow[0]", ...
        where they were estimated, and "target.scale" where a baseline tells it
    covariance : (n, n); zero rows where a scalar was held
    scale : true over stated size of the board; 1 where no baseline tells it
    trust : what the views tell of the uncertainty of the cameras
    """

    cameras: Mapping[str, CameraCalibration]
    names: tuple[str, ...]
    covariance: Floats
    scale: float
    trust: Trust

    @property
    def of_cameras(self) -> Floats:
        """Covariance of the scalars of the cameras alone."""
        count = len(covariance_names({}, self.cameras))
        return self.covariance[:count, :count]

    def sigma(self, name: str) -> float:
        """Return the standard deviation of a scalar; nan where it is not among the names."""
        if name not in self.names:
            return float("nan")
        at = self.names.index(name)
        return float(np.sqrt(max(self.covariance[at, at], 0.0)))


def check_baseline(options: CameraOptions, cameras: int) -> None:
    """Refuse a baseline that is none.

    Raises
    ------
    OptionError
        If a baseline was stated for a single camera.
    """
    if options.baseline is not None and cameras < 2:
        raise OptionError("baseline: it is the distance of cam1 from cam0, and this recording is of one camera.")


def publish_cameras(solution: RigSolution, options: CameraOptions, views: IndependentViews) -> PublishedCameras:
    """Return what the estimate says, in frame "cam0"."""
    rig, known = solution.rig, options.baseline is not None
    length = float(np.linalg.norm(rig.T_cam_cam0[1, :3, 3])) if known else 1.0
    scale = options.baseline / length if options.baseline is not None else 1.0
    cameras: dict[str, CameraCalibration] = {}
    for T, (name, camera) in zip(rig.T_cam_cam0, rig.cameras.items(), strict=True):
        placed = T.copy()
        placed[:3, 3] *= scale
        cameras[name] = CameraCalibration(T_cam_body=placed, time_shift_cam_imu=0.0, camera=camera, body="cam0")
    board = tuple(name for name in solution.names if name.partition("[")[0] in _BOARD)
    names = (*covariance_names({}, cameras), *board, *((SCALE,) if known else ()))
    jacobian, metric = _by_estimate(names, solution), _metric(names, solution)
    if known:
        by_length = (
            -scale / length**2 * rig.T_cam_cam0[1, :3, 3] @ _by_estimate(_translation(list(cameras)[1]), solution)
        )
        jacobian = np.where(metric != 0, scale, 1.0)[:, None] * jacobian + np.outer(metric, by_length)
    ordinary = jacobian @ solution.ordinary @ jacobian.T
    if known:
        by_baseline = options.baseline_sigma * metric / length
        ordinary += np.outer(by_baseline, by_baseline)
    found = robust_covariance(
        views.sums,
        jacobian,
        names,
        ordinary,
        biases=(),
        widened=options.covariance == "robust",
        single=solution.sums,
        order=solution.views.frame.max(axis=1),
        moves=views.moves,
    )
    return PublishedCameras(
        cameras=cameras,
        names=names,
        covariance=0.5 * (found.covariance + found.covariance.T),
        scale=scale,
        trust=_of_cameras(found.trust),
    )


def _translation(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.T_cam_cam0.translation[{k}]" for k in range(3))


def _by_estimate(names: tuple[str, ...], solution: RigSolution) -> Floats:
    """Return the derivative (n, p) of scalars by those of the estimate, before any scale."""
    column = {name: k for k, name in enumerate(solution.names)}
    jacobian = np.zeros((len(names), len(column)))
    for row, name in enumerate(names):
        if name in column:
            jacobian[row, column[name]] = 1.0
    return jacobian


def _metric(names: tuple[str, ...], solution: RigSolution) -> Floats:
    """Return the estimates (n,) of the scalars that grow with the size of the board; of this size itself 1."""
    rig = solution.rig
    values = {SCALE: 1.0} | {f"target.bow[{k}]": float(bow) for k, bow in enumerate(rig.board.bow_m)}
    for T, name in zip(rig.T_cam_cam0, rig.cameras, strict=True):
        values |= dict(zip(_translation(name), T[:3, 3].tolist(), strict=True))
    return np.array([values.get(name, 0.0) for name in names])


def _of_cameras(trust: Trust) -> Trust:
    """Return the trust in the cameras alone."""
    inside = np.array([not name.startswith("target.") for name in trust.names], dtype=bool)
    return replace(
        trust,
        names=tuple(np.array(trust.names, dtype=object)[inside]),
        ordinary_sigma=trust.ordinary_sigma[inside],
        sigma=trust.sigma[inside],
        ratios=tuple(one for one in trust.ratios if not one.block.startswith("target.")),
        changes=tuple(one for one in trust.changes if not one.block.startswith("target.")),
    )
