"""What the command that simulates cameras without an IMU does."""

from pathlib import Path

from ..errors import OptionError, OutputError
from .places import result_folder
from .results import USABLE
from .simulate_cameras_command import SimulateCameras
from .terminal import Terminal

SCENARIO, TRUTH = "scenario.yaml", "truth.yaml"
_NOT_OURS = ("cam0", "mav0", "cam0_corners.csv", "cam0_corners.csv.gz", "target.yaml", "camchain.yaml")


def simulate_cameras(command: SimulateCameras, terminal: Terminal) -> int:
    """Simulate a recording, write its folder, and return the exit code."""
    from ..simulate.cameras import simulate_cameras
    from ..writers.cameras_recording import CAMERAS_FILES, save_cameras_recording

    folder = command.output
    refuse_other(folder, _NOT_OURS)
    replaced = (folder / SCENARIO).exists()
    if command.form != "folder" and not command.options.images:
        raise OptionError(f"--form {command.form} is a form of images. Add --images, or leave out --form.")
    with result_folder(folder, own=CAMERAS_FILES) as staging:
        terminal.progress("simulating")
        simulation = simulate_cameras(command.options, command.seed)
        files = save_cameras_recording(simulation, staging, command.form, terminal.progress)
        names = [path.relative_to(staging) for path in files]
    terminal.close()
    cameras = ", ".join(simulation.truth.cameras)
    terminal.say(f"recording    {folder}: {len(simulation.t_ns)} views by {cameras}; {simulation.target.describe()}")
    if replaced:
        terminal.say("             the recording that was simulated there before is replaced")
    terminal.say(f"truth        {folder / TRUTH}")
    terminal.say(f"scenario     {folder / SCENARIO}")
    terminal.document(
        {
            "recording": str(folder),
            "files": [str(folder / name) for name in names],
            "truth": str(folder / TRUTH),
            "scenario": str(folder / SCENARIO),
        }
    )
    return USABLE


def refuse_other(folder: Path, names: tuple[str, ...]) -> None:
    """Refuse to replace a recording that was not simulated.

    Raises
    ------
    OutputError
        If one of the names is in the folder, but no scenario.
    """
    if not (folder / SCENARIO).exists() and any((folder / name).exists() for name in names):
        raise OutputError(
            f"{folder}: this folder holds a recording that was not simulated. Choose another one with -o."
        )
