"""Kalibr's results-cam.txt: standard deviations of the lens, for the cameras in camchain.yaml beside it.

Kalibr prints "projection: [...] +- [...]" and "distortion: [...] +- [...]" for each camera, and neither the resolution
nor all digits: both stand in camchain.yaml, which Kalibr writes along with it under a name alike.
"""

import re
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...recording import Floats, frozen_array
from ..rig.kalibr_camchain import CameraInput, read_camchain
from ..structured import read_text

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
    text = read_text(path)
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
