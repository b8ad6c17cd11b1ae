"""The command for a simulated room."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

from ...simulate import RoomScenario
from ..command import FileOption, Flat, FromScenario, Seed, output_option
from ..output_folder import result_folder
from ..results import USABLE
from ..simulated import RIG_FILES, folder_document, print_folder, replaces_simulated
from ..terminal import Terminal
from .camera import ImagesAs


@dataclass(frozen=True, kw_only=True)
class SimulateRoom(FromScenario):
    """Make a folder with images and samples of a simulated camera and an IMU in a furnished room, and its truth.

    There is no board: what the camera sees are walls and furniture, rendered at its true lens and pose.

    Examples
    --------
    $ gnomon simulate room -o room
    $ gnomon simulate room -o room --motion around --seed 7
    """

    scenario_type: ClassVar[type] = RoomScenario

    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording."""
    scenario: Annotated[Path | None, FileOption] = None
    """A scenario.yaml that states the options below; those that are given here as well replace its own."""
    form: ImagesAs = "folder"
    """Images in a folder cam0 beside a table of the samples (folder), or all of it in EuRoC's layout (euroc), a ROS 1
    bag (ros1), a ROS 2 bag in SQLite (ros2), or an MCAP file (mcap)."""
    seed: Seed = 0
    options: Annotated[RoomScenario, Flat] = field(default_factory=RoomScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate a recording, render its images, write its folder, and return the exit code."""
        from ...simulate import simulate_camera_imu
        from ...writers.camera_imu_recording import CAMERA_FILES, save_camera_imu_recording

        folder = self.output
        replaced = replaces_simulated(folder, RIG_FILES)
        with result_folder(folder, own=CAMERA_FILES) as staging:
            terminal.progress("simulating")
            simulation = simulate_camera_imu(self.options.rig(), self.seed)
            files = save_camera_imu_recording(simulation, staging, terminal.progress, self.form, self.options)
            names = [path.relative_to(staging) for path in files]
        frames = simulation.recording.cameras["cam0"]
        contents = f"{self.options.duration_s:g} s, {len(frames.t_ns)} images of a room"
        print_folder(folder, contents, terminal, replaced=replaced)
        terminal.document(folder_document(folder, names))
        return USABLE
