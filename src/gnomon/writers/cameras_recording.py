"""A simulated recording of cameras -> a folder that `gnomon.read_camera_views` reads, with its truth beside it.

cam0_corners.csv.gz   ts_ns, corner_id, u_px, v_px: the corners detected, numbered in Kalibr's order
cam0_frames.csv       ts_ns, corners: every frame, also those without corners
cam0/data.csv, cam0/data/<timestamp>.png, or mav0, recording.bag, recording.mcap    images in their place
camchain.yaml         Kalibr's file with the sizes of the images and a lens that stands in, beside corners
target.yaml           the board as its owner describes it
truth.yaml            what is true, as a calibration file
scenario.yaml         what was simulated
"""

from pathlib import Path

from ..formats.kalibr.target import target_text
from ..formats.own.calibration_text import calibration_text
from ..formats.own.options_file import options_text
from ..formats.shared.yaml_text import kalibr_yaml
from ..output import write_whole
from ..progress import Progress
from ..simulate.cameras import CamerasSimulation
from ..simulate.images.board_images import rendered_cameras
from .camera_imu_recording import camera_node, save_frames
from .recording_forms import PLACES, ImageForm, save_images

CAMERAS_FILES = (
    *(f"cam{i}{ending}" for i in range(3) for ending in ("", "_corners.csv.gz", "_frames.csv")),
    *PLACES.values(),
    *("camchain.yaml", "target.yaml", "truth.yaml", "scenario.yaml"),
)
"""Files and folders of a simulated recording of cameras; it has some of them."""

_CHAIN = "# Sizes of the images; the lenses only stand in, what is true of them stands in truth.yaml.\n"
_SCENARIO = "# What was simulated, with seed {seed}. Units are in the names: _s seconds, _m metres, _px pixels.\n"


def save_cameras_recording(
    simulation: CamerasSimulation,
    folder: Path,
    form: ImageForm = "folder",
    progress: Progress | None = None,
) -> tuple[Path, ...]:
    """Write a simulated recording and its truth into a folder that is there, and return the files.

    Of images, which are rendered now, the tables are returned.

    Parameters
    ----------
    simulation : what was simulated
    folder : nothing of the recording's names is in it
    form : of images; corners, where the scenario wants no images, are always written as tables
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    written: list[Path] = []
    texts: dict[str, str] = {}
    if simulation.scenario.images:
        written += save_images(rendered_cameras(simulation), folder, form, progress)
    else:
        for name, frames in simulation.recording.cameras.items():
            written += save_frames(frames, folder, name)
        chain = {name: camera_node(frames.camera) for name, frames in simulation.recording.cameras.items()}
        texts["camchain.yaml"] = _CHAIN + kalibr_yaml(chain)
    texts["target.yaml"] = target_text(simulation.target)
    texts["truth.yaml"] = calibration_text(simulation.truth)
    texts["scenario.yaml"] = _SCENARIO.format(seed=simulation.seed) + options_text(simulation.scenario)
    for name, text in texts.items():
        write_whole(folder / name, text)
        written.append(folder / name)
    return tuple(written)
