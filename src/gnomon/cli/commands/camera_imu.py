"""The commands for cameras and an IMU, before a board and in a room."""

import shlex
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from ...errors import OptionError
from ...options import CameraImuOptions, FrameSelection
from ...simulate.scenarios.camera_imu import CameraImuScenario, RoomScenario
from ...units import Units
from ..arguments import Argument
from ..command import (
    Cache,
    CamFile,
    CertificateFacts,
    Command,
    FileOption,
    Flat,
    ForUse,
    FromScenario,
    ImuFiles,
    Report,
    Seed,
    Workers,
    output_option,
    topics_of,
)
from ..files import (
    CAMERA_IMU_FILES,
    default_folder,
    files_beside,
    read_priors,
    read_use_option,
    refuse_overwriting,
    result_folder,
)
from ..results import (
    USABLE,
    exit_code,
    judged_result,
    parameter_lines,
    print_assumptions,
    print_files,
    print_summary,
    propose_temperature,
    result_document,
    result_with_reading,
    write_result,
)
from ..simulated import RIG_FILES, check_form, folder_document, print_folder, replaces_simulated
from ..terminal import Terminal
from .camera import NO_TARGET, ImagesAs

if TYPE_CHECKING:
    from ...results.result import Result


_NO_CAM = (
    "--cam is missing: Kalibr's file of the cameras and their intrinsics, or gnomon's calibration.yaml. Name it, or "
    "put it into {folder} as camchain.yaml; gnomon camera {recording} --target {target} makes one."
)


@dataclass(frozen=True, kw_only=True)
class CameraImu(Command):
    """Calibrate cameras and an IMU that were waved together in front of a board.

    Fix the board and keep it in view, a checkerboard or grid of circles as a whole; of an AprilGrid or ChArUco board a
    part is enough. Turn the rig about all its axes and shake it along all of them, as fast as the images stay sharp,
    for one to two minutes.

    Examples
    --------
    $ gnomon camera-imu recording.bag --target target.yaml --cam camchain.yaml --imu imu.yaml
    $ gnomon camera-imu rig --for vio
    $ gnomon camera-imu walk.bag --target none --cam camera/calibration.yaml --imu imu.yaml
    """

    recording: Annotated[Path, Argument(positional=True)]
    """A ROS 1 bag, a ROS 2 bag (sqlite or MCAP), a folder in the layout of EuRoC, TUM-VI or Kalibr, a folder of images
    or videos with a table of samples, or a video; or a folder with corners and samples, cam0_corners.csv,
    cam1_corners.csv, ... and imu0.csv, also with .gz."""
    cam: CamFile = None
    """Kalibr's file of the cameras and their intrinsics, or gnomon's calibration.yaml (default: camchain.yaml in the
    recording's folder; else what the recording itself says, as EuRoC's does)."""
    imu: ImuFiles = ()
    """Kalibr's file of the IMU's noise; of several IMUs keyed imu0, imu1, ..., or this option once for each of them
    (default: imu.yaml in the recording's folder, where there is one)."""
    target: Annotated[Path | None, Argument(metavar="FILE", none=False)] = None
    """Kalibr's file of the board (default: target.yaml in the recording's folder); none where there was no board, but
    a scene that stands still."""
    topics: Annotated[tuple[str, ...], Argument(metavar="NAME=TOPIC")] = ()
    """Topics of a bag, such as cam0=/left/image_raw imu0=/imu/data; guessed where it is clear."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where the recording has none, as a video."""
    units: str | None = None
    """Units of a table of samples: "si", or a list such as "g deg/s us"; recognised where not given."""
    frames: Annotated[FrameSelection, Flat] = field(default_factory=FrameSelection)
    workers: Workers = None
    cache: Cache = True
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html, diagnostics.npz, trajectory.txt and Kalibr's camchain-imucam.yaml,
    imu.yaml and results-imucam.txt (default: NAME-camera-imu beside the recording)."""
    use: ForUse = None
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)
    options: Annotated[CameraImuOptions, Flat] = field(default_factory=CameraImuOptions)

    def __post_init__(self) -> None:
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)
        if self.workers is not None and self.workers < 1:
            raise OptionError(f"workers {self.workers} must be at least 1.")

    def _kalibr_files(self) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Return Kalibr's files by the option that names them, and a sentence on those that were not named."""
        return files_beside(self.recording, {"cam": self.cam, "imu": self.imu, "target": self.target})

    def lacking(self) -> list[str]:
        """Return what to say of files that are needed, were not named, and are not in the recording's folder."""
        from ...calibrate.steps.camera_reading import untold_sizes
        from ...readers.images.image_recording import refuse_without_cameras, tells_no_lens

        place = self.recording
        if not place.exists():
            return []
        folder, files = place if place.is_dir() else place.parent, self._kalibr_files()[0]
        missing = [NO_TARGET.format(folder=folder)] if files["target"] is None else []
        if files["cam"] is None and tells_no_lens(place):
            target = shlex.quote(str(files["target"] or "target.yaml"))
            size = " --resolution WIDTH HEIGHT" if untold_sizes(place) else ""
            missing.append(_NO_CAM.format(folder=folder, recording=shlex.quote(str(place)), target=target + size))
        if missing:
            refuse_without_cameras(place)
        return missing

    def run(self, terminal: Terminal) -> int:
        """Calibrate, write the folder of the result, and return the exit code."""
        from ...calibrate.camera_imu import calibrate_camera_imu
        from ...calibrate.steps.camera_imu_reading import read_camera_imu
        from ...writers.kalibr_files import save_camera_imu_files
        from ..camera_summary import programs_reading

        folder = self.output or default_folder((self.recording,), "camera-imu")
        known, use = read_priors(self.options.prior), read_use_option(self.use)
        inputs, taken = self._kalibr_files()
        refuse_overwriting(folder, self.recording, inputs, CAMERA_IMU_FILES)
        with result_folder(folder, "camera-imu", own=CAMERA_IMU_FILES) as staging:
            terminal.progress("reading the recording")
            recording, target = read_camera_imu(
                self.recording,
                **inputs,
                units=self.units,
                topics=topics_of(self.topics),
                imu_table=self.imu_table,
                selection=self.frames,
                workers=self.workers,
                cache=folder if self.cache else None,
                progress=terminal.progress,
            )
            if any(samples.noise is None for samples in recording.imus.values()):
                taken += ("no imu.yaml was given: the noise of a consumer IMU is assumed until the residuals tell it.",)
            recording = replace(recording, assumptions=(*taken, *recording.assumptions))
            print_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
            recording = known.known_of(recording)
            compare = self.options.compare or self.report
            options = replace(self.options, compare=compare, prior=known.stated)
            result = calibrate_camera_imu(
                recording, target, options, progress=terminal.progress, prior=known.calibrations
            )
            result = result_with_reading(judged_result(result, use), self.certificate.stated)
            terminal.progress("writing the result")
            save_camera_imu_files(result, recording, target, staging)
            write_result(result, staging, report=self.report, terminal=terminal)
        _print_result(result, folder, terminal)
        document = result_document(result.calibration, folder, recording.assumptions, CAMERA_IMU_FILES)
        if result.calibration.verdict != "fail":
            # into a program that reads the lenses as they are, where there is one; Kalibr's files lie there already
            reading = [name for name in programs_reading(result.calibration) if name != "kalibr"]
            terminal.print("")
            terminal.propose("convert", folder, "--to", (*reading, "openvins")[0])
        propose_temperature(result.calibration, folder, terminal)
        terminal.document({**document, **_findings_of_the_solution(result)})
        return exit_code(result.calibration)


def _print_result(result: "Result", folder: Path, terminal: Terminal) -> None:
    from ..camera_summary import camera_imu_lines, camera_pose_lines, imu_pose_lines

    print_summary(result.calibration, camera_imu_lines(result), terminal)
    poses = (*camera_pose_lines(result.calibration), *imu_pose_lines(result.calibration))
    terminal.print("\nestimate +- standard deviation\n" + "\n".join(poses))
    terminal.print("\nIMU; rows: sensor axes, columns: body axes")
    terminal.print("\n".join(parameter_lines(result.calibration)))
    print_files(folder, terminal, CAMERA_IMU_FILES)


def _findings_of_the_solution(result: "Result") -> dict[str, Any]:
    from ...results.camera_diagnostics import CameraImuDiagnostics

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CameraImuDiagnostics)
    return {
        "noise": diagnostics.noise,
        "gravity_target": {"value": diagnostics.gravity_target, "sigma": diagnostics.gravity_sigma},
        "baselines": diagnostics.baselines,
    }


@dataclass(frozen=True, kw_only=True)
class SimulateCameraImu(FromScenario):
    """Make a folder with a recording of simulated cameras and an IMU in front of a board, and its truth (truth.yaml).

    `gnomon camera-imu` takes the folder as it is.

    Examples
    --------
    $ gnomon simulate camera-imu -o rig
    $ gnomon simulate camera-imu -o rig --duration-s 30 --seed 7
    """

    scenario_type: ClassVar[type] = CameraImuScenario

    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording."""
    scenario: Annotated[Path | None, FileOption] = None
    """A scenario.yaml that states the options below; those that are given here as well replace its own."""
    form: ImagesAs = "folder"
    """With --images: images in folders cam0, ... beside a table of the samples (folder), or all of it in EuRoC's layout
    (euroc), a ROS 1 bag (ros1), a ROS 2 bag in SQLite (ros2), or an MCAP file (mcap)."""
    seed: Seed = 0
    options: Annotated[CameraImuScenario, Flat] = field(default_factory=CameraImuScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate a recording, write its folder, and return the exit code."""
        from ...simulate import simulate_camera_imu
        from ...writers.simulated_cameras import CAMERA_FILES, CAMERAS_FILES, save_camera_imu_recording

        folder = self.output
        replaced = replaces_simulated(folder, RIG_FILES)
        check_form(self.form, images=self.options.images)
        if self.options.motion == "walk":
            raise OptionError(
                "--motion walk leaves the board behind. A walk through a room: gnomon simulate room --motion walk."
            )
        own = (*CAMERA_FILES, *CAMERAS_FILES) if replaced else CAMERA_FILES
        with result_folder(folder, own=own) as staging:
            terminal.progress("simulating")
            simulation = simulate_camera_imu(self.options, self.seed)
            files = save_camera_imu_recording(simulation, staging, terminal.progress, self.form)
            names = [path.relative_to(staging) for path in files]
        cameras = {name: len(frames.t_ns) for name, frames in simulation.recording.cameras.items()}
        frames = ", ".join(f"{count} frames of {name}" for name, count in cameras.items())
        samples = ", ".join(
            f"{len(imu.gyroscope)} samples of {name}" for name, imu in simulation.recording.imus.items()
        )
        contents = f"{self.options.duration_s:g} s, {frames}, {samples}; {simulation.target.describe()}"
        print_folder(folder, contents, terminal, replaced=replaced)
        terminal.propose("camera-imu", folder)
        statistics = {item.name: getattr(simulation.statistics, item.name) for item in fields(simulation.statistics)}
        terminal.document(folder_document(folder, names) | {"statistics": statistics})
        return USABLE


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
        from ...writers.simulated_cameras import CAMERA_FILES, save_camera_imu_recording

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
