"""The command that simulates poses."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ...simulate import PoseScenario
from ..command import Command, Flat, Seed, output_option
from ..files import result_folder
from ..results import USABLE
from ..simulated import truth_name
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...recording import Floats, Poses, Recording
    from ...simulate.poses import PoseSimulation


@dataclass(frozen=True, kw_only=True)
class SimulatePoses(Command):
    """Make an experiment in which a simulated sensor lies still in one attitude after another, and its truth.

    `gnomon imu` takes the table, the folder or the recording as it is.

    Examples
    --------
    $ gnomon simulate poses -o poses
    """

    output: Annotated[Path, output_option("PATH")]
    """A name that ends in .csv: a table of averaged poses; in .npz: one recording of all samples; any other: a folder
    with a file for each pose. The true calibration, truth.yaml, is written beside it, or into the folder."""
    seed: Seed = 0
    scenario: Annotated[PoseScenario, Flat] = field(default_factory=PoseScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate poses, write them and their truth, and return the exit code."""
        from ...formats.own.calibration_text import save
        from ...simulate import simulate_poses
        from ...writers.recording_file import save_pose_files, save_poses, save_recording

        path = self.output
        as_file = path.suffix.lower() in {".csv", ".npz"}
        folder = path.parent if as_file else path
        with result_folder(folder, own=()) as staging:
            terminal.progress("simulating")
            simulation = simulate_poses(self.scenario, self.seed)
            if path.suffix.lower() == ".csv":
                save_poses(pose_averages(simulation), staging / path.name)
                files = [path]
            elif path.suffix.lower() == ".npz":
                files = [
                    path.with_name(file.name) for file in save_recording(join_poses(simulation), staging / path.name)
                ]
            else:
                files = [path / file.name for file in save_pose_files(simulation.poses, staging)]
            true = truth_name(folder, [file.name for file in files])
            save(simulation.truth, staging / true)
        terminal.print(f"poses        {len(simulation.poses)} in {path}")
        terminal.print(f"truth        {folder / true}")
        terminal.propose("imu", path)
        terminal.document({"poses": [str(file) for file in files], "truth": str(folder / true)})
        return USABLE


def pose_averages(simulation: "PoseSimulation") -> "Poses":
    """Return the means of a simulation with what a person would know of them."""
    import numpy as np

    from ...recording import Poses

    count = simulation.scenario.samples

    def sigma(quantity: str) -> "Floats | None":
        """Return the sigma of the means by the scatter of the samples; None where they do not scatter."""
        values = np.array([getattr(samples, quantity).values for samples in simulation.poses])
        found = values.std(axis=1, ddof=1) / np.sqrt(count) if count > 1 else np.zeros((len(values), 3))
        return found if bool((found > 0).all()) else None

    return Poses(
        name=tuple(f"pose {k + 1}" for k in range(len(simulation.poses))),
        accelerometer=simulation.accelerometer,
        accelerometer_unit=simulation.poses[0].accelerometer.unit,
        gyroscope=simulation.gyroscope,
        gyroscope_unit=simulation.poses[0].gyroscope.unit,
        accelerometer_sigma=sigma("accelerometer"),
        gyroscope_sigma=sigma("gyroscope"),
        samples=np.full(len(simulation.poses), count),
        t_s=simulation.t_s,
        specific_force=simulation.meant if simulation.scenario.known else None,
    )


def join_poses(simulation: "PoseSimulation") -> "Recording":
    """Return the samples of all poses as one recording, without what happened between them."""
    import numpy as np

    from ...recording import ImuSamples, Recording, TriadSamples

    def triad(quantity: str) -> TriadSamples:
        parts = [getattr(samples, quantity) for samples in simulation.poses]
        return TriadSamples(
            t_ns=np.concatenate([part.t_ns for part in parts]),
            values=np.concatenate([part.values for part in parts]),
            unit=parts[0].unit,
        )

    samples = ImuSamples(accelerometer=triad("accelerometer"), gyroscope=triad("gyroscope"))
    return Recording(imus={"imu0": samples})
