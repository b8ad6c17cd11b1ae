"""Corners that were found in images, kept in a file, so that the same images need not be looked at again.

The file's name holds a hash of the images' contents, of the board, and of the version of the detectors: whatever
changes the corners changes the name.
"""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..errors import GnomonError
from ..formats.kalibr.camchain import CameraInput
from ..models.target import Target
from ..output import atomic_file, remove_parts
from ..readers.zips import ZIP_DAMAGE, refuse_false_arrays
from ..recording import CameraFrames, FrameQuality, Source
from .board_corners import BoardCorners

DETECTORS = 3
"""Version of the detectors within one of gnomon; to be raised whenever corners come out differently."""

PREFIX, SUFFIX = "corners-", ".npz"
_HASH = 16  # digits
_ARRAYS = ("t_ns", "frame", "point", "pixels", "sigma_px", "blur_px", "black", "white")


def cache_file(
    folder: Path, images: tuple[Source, ...], camera: str, topic: str, target: Target, *, lens_known: bool = True
) -> Path:
    """Return the file in which the corners of one camera are kept; a lens helps to number those without codes."""
    size = [target.tag_size_m, target.tag_spacing, target.row_spacing_m, target.col_spacing_m, target.spacing_m]
    board = [target.kind, target.cols, target.rows, *size, target.asymmetric, target.border_bits, target.first_tag]
    if target.kind == "charuco":
        board += [target.marker_size_m, target.square_size_m, target.dictionary, target.legacy]
    if target.kind in {"checkerboard", "circlegrid"} and not lens_known:
        board += ["numbered without the lens"]
    what = json.dumps([__version__, DETECTORS, [source.sha256 for source in images], camera, topic, board])
    return folder / f"{PREFIX}{camera}-{hashlib.sha256(what.encode()).hexdigest()[:_HASH]}{SUFFIX}"


def kept_corners(file: Path, known: CameraInput) -> BoardCorners | None:
    """Return the corners that are kept in a file; None where there is none, or none that can be read."""
    try:
        with file.open("rb") as stream, zipfile.ZipFile(stream) as packed:
            refuse_false_arrays(packed, file.name)
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in _ARRAYS}
            told = json.loads(str(kept["told"]))
        if tuple(told["resolution"]) != known.camera.resolution:
            return None
        return _corners(arrays, told, known)
    except (*ZIP_DAMAGE, GnomonError):
        return None


def _corners(arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any], known: CameraInput) -> BoardCorners:
    return BoardCorners(
        frames=CameraFrames(
            t_ns=arrays["t_ns"],
            frame=arrays["frame"],
            point=arrays["point"],
            pixels=arrays["pixels"],
            sigma_px=arrays["sigma_px"],
            camera=known.camera,
            T_cam_imu=known.T_cam_imu,
            time_shift_cam_imu_s=known.time_shift_cam_imu_s,
            lens_covariance=known.lens_covariance,
            quality=FrameQuality(
                blur_px=arrays["blur_px"],
                black=arrays["black"],
                white=arrays["white"],
                dropped=dict(told["dropped"]),
            ),
        ),
        notes=tuple(told["notes"]),
    )


def keep_corners(file: Path, corners: BoardCorners) -> None:
    """Keep corners in a file, whose folder is made; what was kept of other images of this camera goes.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    frames = corners.frames
    quality = frames.quality
    assert quality is not None
    told = {
        "resolution": frames.camera.resolution,
        "dropped": sorted(quality.dropped.items()),
        "notes": corners.notes,
    }
    arrays = {name: getattr(frames, name) for name in _ARRAYS[:5]} | {
        name: getattr(quality, name) for name in _ARRAYS[5:]
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(file) as stream:
        np.savez(stream, told=np.array(json.dumps(told)), **arrays)  # pyright: ignore[reportArgumentType]
    camera = file.name.removesuffix(SUFFIX).rpartition("-")[0]
    for older in file.parent.glob(f"{camera}-{'[0-9a-f]' * _HASH}{SUFFIX}"):
        if older.name != file.name:
            older.unlink(missing_ok=True)
    remove_parts(file.parent, f"{camera}-")
