"""The folder of a calibration of cameras alone: Kalibr's files beside gnomon's own."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from ..calibration import Calibration
from ..diagnostics import CamerasDiagnostics, Result
from ..geometry.quaternion import quaternion_from_rotation
from ..models.target import Target
from ..output import write_together
from ..recording import Floats
from .baselines import baseline_of
from .context import Context, remarks
from .kalibr_camchain import LENS_FILE, lens_chain_text
from .kalibr_results import board_lines
from .lens_fit import without_k3

RESULTS_FILE = "results-cam.txt"


def save_camera_files(result: Result, target: Target, directory: str | PathLike[str]) -> tuple[Path, ...]:
    """Write what Kalibr writes, `camchain.yaml` and `results-cam.txt`, into a folder that is there; return the files.

    Parameters
    ----------
    result : of `gnomon.calibrate_cameras`
    target : the board that was seen

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    texts = camera_texts(result, target)
    write_together(directory, texts)
    return tuple(Path(directory) / name for name in texts)


def camera_texts(result: Result, target: Target) -> dict[str, str]:
    """Return the texts of the files by name."""
    calibration, diagnostics = result.calibration, result.diagnostics
    assert isinstance(diagnostics, CamerasDiagnostics)
    said = Context(remarks=remarks(calibration)).comment()
    chain = lens_chain_text(calibration, said, seen_together(diagnostics))
    return {LENS_FILE: chain, RESULTS_FILE: "\n".join(_results(calibration, diagnostics, target)) + "\n"}


def seen_together(diagnostics: CamerasDiagnostics) -> dict[str, list[int]]:
    """Return the numbers of the cameras that saw the board in the same views as each camera."""
    together: dict[str, set[int]] = {name: set() for name in diagnostics.corners}
    for view in diagnostics.views:
        for name in view.cameras:
            together[name] |= {int(other.removeprefix("cam")) for other in view.cameras if other != name}
    return {name: sorted(others) for name, others in together.items()}


def _results(calibration: Calibration, diagnostics: CamerasDiagnostics, target: Target) -> Iterator[str]:
    """Yield the lines of results-cam.txt; quaternions are x y z w, as Kalibr has them (JPL)."""
    yield from ("Calibration results ", "====================", "Camera-system parameters:")
    for name, calibrated in calibration.cameras.items():
        lens = without_k3(calibrated.camera).camera
        kept = len(lens.distortion_coeffs)  # a k3 is of no model of Kalibr's
        yield from (f"{name} ({lens.topic}):", f"    type: {lens.model}")
        yield _pair("distortion", lens.distortion_coeffs, calibration.sigma(f"{name}.distortion_coeffs")[:kept])
        yield _pair("projection", lens.intrinsics, calibration.sigma(f"{name}.intrinsics"))
        yield from (_errors(name, diagnostics), "")
    numbers = {name: name.removeprefix("cam") for name in calibration.cameras}
    for first, second in pairwise(calibration.cameras):
        found = baseline_of(calibration, first, second)
        w, x, y, z = quaternion_from_rotation(found.T[:3, :3]).tolist()
        sigma = np.sqrt(np.diag(found.covariance))
        yield f"baseline T_{numbers[second]}_{numbers[first]}:"
        yield _pair("q", np.array([-x, -y, -z, w]), sigma[:3])
        yield from (_pair("t", found.T[:3, 3], sigma[3:]), "")
    yield from ("", "", "Target configuration", "====================", "", *board_lines(target))
    yield from ("", "", "Added by gnomon", "===============", "")
    yield f"Verdict: {calibration.verdict}; reasons are in calibration.yaml"
    yield "Standard deviations of a baseline: of a small rotation about the axes of the camera before [rad], of t [m]"
    yield from Context(remarks=remarks(calibration)).lines()
    yield from _unseen(calibration)


def _unseen(calibration: Calibration) -> Iterator[str]:
    fit = calibration.assessment.cameras
    holdout: Mapping[str, float] = {} if fit is None else fit.holdout_rms_px
    for name, rms in holdout.items():
        if np.isfinite(rms):
            yield f"Reprojection error ({name}) of views that were not used, rms per axis [px]: {rms:.4g}"


def _pair(name: str, values: Floats, sigmas: Floats) -> str:
    return f"    {name}: {_numbers(values)} +- {_numbers(sigmas)}"


def _numbers(values: Floats) -> str:
    return f"[{' '.join(f'{value:.8g}' for value in values.tolist())}]"


def _errors(name: str, diagnostics: CamerasDiagnostics) -> str:
    """Return mean and standard deviation of the residuals along u and v."""
    fit = diagnostics.corners[name]
    used = fit.residual[fit.frame_used[fit.frame]]
    used = used[np.isfinite(used).all(axis=1)]
    if not len(used):
        return "    reprojection error: no corners"
    (mu, mv), (su, sv) = used.mean(axis=0).tolist(), used.std(axis=0).tolist()
    return f"    reprojection error: [{mu:f}, {mv:f}] +- [{su:f}, {sv:f}]"
