"""Kalibr's results-cam.txt: standard deviations of the lens, for the cameras in camchain.yaml beside it.

Kalibr prints "projection: [...] +- [...]" and "distortion: [...] +- [...]" for each camera, and neither the resolution
nor all digits: both stand in camchain.yaml, which Kalibr writes along with it under a name alike.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...geometry.quaternion import quaternion_from_rotation
from ...models.target import Target
from ...output import write_together
from ...recording import Floats, frozen_array
from ...results.calibration import Calibration
from ...results.camera_diagnostics import CamerasDiagnostics
from ...results.result import Result
from ..shared.baselines import baseline_of
from ..shared.lens_refit import without_k3
from ..shared.losses import Context, file_remarks
from ..shared.structured import read_structured_text
from .camchain import LENS_FILE, CameraInput, lens_chain_text, read_camchain
from .results import board_lines

_CAMERA = re.compile(r"^(cam\d+) \(.*\):\s*$", re.MULTILINE)
_NAME = re.compile(r"results-cam(?=[-.])")


def is_kalibr_cam_results(text: str) -> bool:
    """Return whether a text is what Kalibr prints after a calibration of cameras."""
    return text.lstrip().startswith("Calibration results") and "Camera-system parameters" in text


def read_cam_results(path: str | PathLike[str], notes: list[str] | None = None) -> dict[str, CameraInput]:
    """Read cameras with the standard deviations of their lenses; camchain.yaml has to be beside the file.

    Parameters
    ----------
    path : results-cam.txt, or such as data-results-cam.txt with data-camchain.yaml beside it
    notes : where sentences on what was taken are appended

    Raises
    ------
    FormatError
        If a file cannot be read, is not laid out as Kalibr does, or the two do not belong together.
    """
    file = Path(path)
    text = read_structured_text(path)
    if not is_kalibr_cam_results(text):
        raise FormatError(f"{path}: expected Kalibr's results-cam.txt, with Camera-system parameters in it.")
    chain = file.with_name(_NAME.sub("camchain", file.name)).with_suffix(".yaml")
    if not chain.is_file() and (file.parent / "camchain.yaml").is_file():
        chain = file.parent / "camchain.yaml"
    if not chain.is_file():
        raise FormatError(
            f"{path}: it does not state the resolution, and {chain.name} is not beside it. Put the camchain.yaml that "
            "Kalibr wrote along with it there."
        )
    said: list[str] = [] if notes is None else notes
    blocks = _CAMERA.split(text)[1:]
    printed = {name: _parameters(path, name, block) for name, block in zip(blocks[::2], blocks[1::2], strict=True)}
    cameras = read_camchain(chain, said)
    for name, camera in cameras.items():
        if name not in printed:
            said.append(f"{file.name} has no standard deviations of {name}.")
            continue
        values, sigmas = printed[name]
        stated = camera.camera.parameters
        if values.shape != stated.shape or not np.allclose(values, stated, rtol=1e-4, atol=1e-6):
            raise FormatError(
                f"{path}: {name} has projection and distortion {values.tolist()}, but {chain.name} has "
                f"{stated.tolist()}. The two files are not of one calibration."
            )
        if not (sigmas > 0).all():
            said.append(f"{file.name}: the standard deviations of {name} are not all above zero; they were left out.")
            continue
        cameras[name] = replace(camera, lens_covariance=frozen_array(np.diag(np.square(sigmas))))
    said.append(f"{chain.name} holds the cameras of {file.name}, which does not tell how its errors hang together.")
    return cameras


def _parameters(path: str | PathLike[str], name: str, block: str) -> tuple[Floats, Floats]:
    """Return projection and distortion, and their standard deviations."""
    found: list[list[float]] = [[], []]
    for key in ("projection", "distortion"):
        match = re.search(rf"^[ \t]*{key}:\s*\[([^\]]*)\]\s*\+-\s*\[([^\]]*)\]", block, re.MULTILINE)
        try:
            pair = (
                [[float(word) for word in part.replace(",", " ").split()] for part in match.groups()] if match else []
            )
        except ValueError:
            pair = []
        if not pair:
            raise FormatError(f"{path}: {name} has no line {key}: [...] +- [...] with numbers.")
        if len(pair[0]) != len(pair[1]):
            raise FormatError(f"{path}: {name} has {len(pair[0])} values of {key}, and {len(pair[1])} behind +-.")
        found[0] += pair[0]
        found[1] += pair[1]
    return np.array(found[0]), np.array(found[1])


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
    said = Context(remarks=file_remarks(calibration)).comment()
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
    yield from Context(remarks=file_remarks(calibration)).lines()
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
