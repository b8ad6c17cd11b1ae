"""What the command that simulates cameras without an IMU does."""

from .places import result_folder
from .results import USABLE
from .simulate_cameras_command import SimulateCameras
from .simulated import OF_IMUS, check_form, folder_document, replaces_simulated, say_folder
from .terminal import Terminal

_NOT_OURS = ("cam0", "mav0", "cam0_corners.csv", "cam0_corners.csv.gz", "target.yaml", "camchain.yaml")


def simulate_cameras(command: SimulateCameras, terminal: Terminal) -> int:
    """Simulate a recording, write its folder, and return the exit code."""
    from ..simulate.cameras import simulate_cameras
    from ..writers.camera_imu_recording import CAMERA_FILES
    from ..writers.cameras_recording import CAMERAS_FILES, save_cameras_recording

    folder = command.output
    replaced = replaces_simulated(folder, _NOT_OURS)
    check_form(command.form, images=command.options.images)
    own = (*CAMERAS_FILES, *CAMERA_FILES, *OF_IMUS) if replaced else CAMERAS_FILES
    with result_folder(folder, own=own) as staging:
        terminal.progress("simulating")
        simulation = simulate_cameras(command.options, command.seed)
        files = save_cameras_recording(simulation, staging, command.form, terminal.progress)
        names = [path.relative_to(staging) for path in files]
    terminal.close()
    cameras = ", ".join(simulation.truth.cameras)
    contents = f"{len(simulation.t_ns)} views by {cameras}; {simulation.target.describe()}"
    say_folder(folder, contents, terminal, replaced=replaced)
    terminal.propose("camera", folder)
    terminal.document(folder_document(folder, names))
    return USABLE
