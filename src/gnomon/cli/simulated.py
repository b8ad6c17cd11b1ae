"""What the commands that simulate have in common: where recordings and truth go, and what is said of them."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OptionError, OutputError
from .files import TRUTH, file_stem, result_folder
from .results import USABLE
from .terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..recording import Recording
    from ..results.calibration import Calibration

from collections.abc import Sequence

SCENARIO = "scenario.yaml"
OF_IMUS = ("imu.yaml", "groundtruth.txt")
"""Files beside a simulated recording of cameras and an IMU that one of cameras alone has not."""

RIG_FILES = ("imu0.csv.gz", "imu0-acc.csv.gz", "camchain.yaml", "imu.yaml", "target.yaml", "cam0", "mav0")
"""What a recording of cameras and an IMU consists of."""


def write_simulated(
    simulate: "Callable[[], tuple[Recording, Calibration]]", path: Path, terminal: Terminal, *, then: str
) -> int:
    """Simulate one sensor, write its recording as `path`, its truth beside it, and return the exit code.

    Parameters
    ----------
    then : the command that calibrates from it
    """
    from ..formats.own.calibration_text import save
    from ..writers.recording_file import check_suffix, save_recording

    check_suffix(path)
    terminal.progress("simulating")
    recording, truth = simulate()
    folder = path.parent
    true = truth_name(folder, [path.name])
    with result_folder(folder, own=()) as staging:
        names = [file.name for file in save_recording(recording, staging / path.name)]
        save(truth, staging / true)
    for name in names:
        terminal.print(f"recording    {folder / name}")
    terminal.print(f"truth        {folder / true}")
    terminal.propose(then, *(folder / name for name in names))
    terminal.document({"recording": [str(folder / name) for name in names], "truth": str(folder / true)})
    return USABLE


def replaces_simulated(folder: Path, recordings: tuple[str, ...]) -> bool:
    """Return whether a folder holds a recording that was simulated before.

    Parameters
    ----------
    folder : where a simulated recording shall go
    recordings : files and folders that make a recording

    Raises
    ------
    OutputError
        If the recording in it was not simulated: it is not replaced.
    """
    simulated = (folder / SCENARIO).exists()
    if not simulated and any((folder / name).exists() for name in recordings):
        raise OutputError(
            f"{folder}: this folder holds a recording that was not simulated. Choose another one with -o."
        )
    return simulated


def check_form(form: str, *, images: bool) -> None:
    """Check that a form of images is asked for where there are images.

    Raises
    ------
    OptionError
        If it is asked for without.
    """
    if form != "folder" and not images:
        raise OptionError(f"--form {form} is a form of images. Add --images, or leave out --form.")


def print_folder(folder: Path, contents: str, terminal: Terminal, *, replaced: bool) -> None:
    """Say what was written of a recording of cameras."""
    terminal.print(f"recording    {folder}: {contents}")
    if replaced:
        terminal.print("             the recording that was simulated there before is replaced")
    terminal.print(f"truth        {folder / TRUTH}")
    terminal.print(f"scenario     {folder / SCENARIO}")


def folder_document(folder: Path, names: list[Path]) -> dict[str, object]:
    """Return the same for programs."""
    return {
        "recording": str(folder),
        "files": [str(folder / name) for name in names],
        "truth": str(folder / TRUTH),
        "scenario": str(folder / SCENARIO),
    }


def truth_name(folder: Path, recordings: Sequence[str]) -> str:
    """Return what the truth of simulated recordings is called in a folder, in which another one's truth may lie.

    Parameters
    ----------
    recordings : names of their files; the first one names the truth where another one's is there

    Examples
    --------
    >>> truth_name(Path("nowhere"), ["recording.npz"])
    'truth.yaml'
    """
    own = f"{file_stem(recordings[0])}-{TRUTH}"
    again = any((folder / name).exists() for name in recordings) and not (folder / own).exists()
    return TRUTH if again or not (folder / TRUTH).exists() else own
