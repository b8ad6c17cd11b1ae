"""The commands for cameras alone."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ...errors import OptionError
from ...models.lens_names import check_program, refit_models
from ...options import CameraOptions
from ...simulate.scenarios.cameras import CamerasScenario
from ...units import Units
from ..arguments import Argument
from ..command import (
    Cache,
    CamFile,
    CertificateFacts,
    Command,
    FileOption,
    Flat,
    FromScenario,
    Report,
    Seed,
    Workers,
    output_option,
    topics_of,
)
from ..files import CAMERA_FILES, default_folder, files_beside, refuse_overwriting, result_folder
from ..results import (
    USABLE,
    exit_code,
    print_assumptions,
    print_files,
    print_summary,
    result_document,
    result_with_reading,
    write_result,
)
from ..simulated import OF_IMUS, check_form, folder_document, print_folder, replaces_simulated
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...results.result import Result


ImagesAs = Literal["folder", "euroc", "ros1", "ros2", "mcap"]
NO_TARGET = (
    "--target is missing: the file that describes the board. Name it, or put it into {folder} as target.yaml; "
    "gnomon target writes one beside the board that it prints; "
    "of an AprilGrid it holds five lines, such as target_type: aprilgrid, tagCols: 6, tagRows: 6, "
    "tagSize: 0.088 (metres), tagSpacing: 0.3 (gap over tagSize)."
)


@dataclass(frozen=True, kw_only=True)
class CameraCommand(Command):
    """Calibrate the lenses of one camera or several, and their relative poses, from views of a board.

    Show the board to the camera in thirty views or more: near and far, tilted by up to 45 degrees to all sides, and in
    every corner of the image; of several cameras as many as possible together. Nothing need be known of the lens.

    Examples
    --------
    $ gnomon camera recording.bag --target target.yaml
    $ gnomon camera images/ --target target.yaml --for openvins
    """

    recording: Annotated[Path, Argument(positional=True)]
    """A folder of images (of several cameras in cam0, cam1, ... or left and right), a ROS 1 or ROS 2 bag, a folder in
    the layout of EuRoC, TUM-VI or Kalibr, a video; or a folder with corners, cam0_corners.csv, cam1_corners.csv, ..."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board (default: target.yaml in the recording's folder)."""
    cam: CamFile = None
    """A camchain.yaml or calibration.yaml whose topics, line delays and image sizes are taken; its lenses are not
    used."""
    resolution: Annotated[tuple[int, int] | None, Argument(metavar="WIDTH HEIGHT")] = None
    """Size of the images in pixels, for a folder with corners; images tell it themselves."""
    topics: Annotated[tuple[str, ...], Argument(metavar="NAME=TOPIC")] = ()
    """Topics of a bag, such as cam0=/left/image_raw cam1=/right/image_raw; guessed where it is clear."""
    units: str | None = None
    """Unit of the timestamps in tables, such as us; recognised where not given."""
    workers: Workers = None
    cache: Cache = True
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html, diagnostics.npz and Kalibr's camchain.yaml and results-cam.txt
    (default: NAME-camera beside the recording)."""
    program: Annotated[str | None, Argument(name="for", metavar="PROGRAM")] = None
    """A program that shall read the result: kalibr, openvins, vins-fusion, orb-slam3, basalt, okvis or ros2; the lens
    model is then chosen among those that it knows."""
    report: Report = True
    certificate: Annotated[CertificateFacts, Flat] = field(default_factory=CertificateFacts)
    options: Annotated[CameraOptions, Flat] = field(default_factory=CameraOptions)

    def __post_init__(self) -> None:
        if self.program is not None:
            check_program(self.program)
            if self.options.model or self.options.among:
                raise OptionError("--for chooses among a program's lens models. Leave it out, or --model and --among.")
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)
        if self.workers is not None and self.workers < 1:
            raise OptionError(f"workers {self.workers} must be at least 1.")
        if self.resolution is not None and min(self.resolution) < 1:
            raise OptionError(
                f"resolution {self.resolution[0]} {self.resolution[1]} must be at least 1 pixel each way."
            )

    def lacking(self) -> list[str]:
        """Return what to say where there is no board's file, or nothing tells how large the images are."""
        from ...calibrate.steps.camera_reading import untold_sizes
        from ...readers.images.image_recording import refuse_without_cameras

        place = self.recording
        if not place.exists() or files_beside(place, {"target": self.target})[0]["target"] is not None:
            return []
        refuse_without_cameras(place)
        sizes = "" if self.cam or self.resolution else untold_sizes(place)
        return [NO_TARGET.format(folder=place if place.is_dir() else place.parent), *([sizes] if sizes else [])]

    def run(self, terminal: Terminal) -> int:
        """Calibrate, write the folder of the result, and return the exit code."""
        from ...calibrate.cameras import calibrate_cameras
        from ...calibrate.steps.camera_reading import read_camera_views
        from ...readers.images.image_recording import recording_holds_imu
        from ...writers.kalibr_files import save_camera_files

        folder = self.output or default_folder((self.recording,), "camera")
        beside, taken = files_beside(self.recording, {"target": self.target})
        target = beside["target"]
        refuse_overwriting(folder, self.recording, {"cam": self.cam, "target": target}, CAMERA_FILES)
        with result_folder(folder, "camera", own=CAMERA_FILES) as staging:
            terminal.progress("reading the recording")
            recording, board = read_camera_views(
                self.recording,
                target=target,
                cam=self.cam,
                resolution=self.resolution,
                units=self.units,
                topics=topics_of(self.topics),
                workers=self.workers,
                cache=folder if self.cache else None,
                progress=terminal.progress,
            )
            recording = replace(recording, assumptions=(*taken, *recording.assumptions))
            print_assumptions(recording.assumptions, terminal)  # before anything fails: they often explain why
            among = self.options.among if self.program is None else refit_models(self.program)
            result = calibrate_cameras(recording, board, replace(self.options, among=among), progress=terminal.progress)
            result = result_with_reading(result, self.certificate.stated)
            terminal.progress("writing the result")
            save_camera_files(result, board, staging)
            write_result(result, staging, report=self.report, terminal=terminal)
        _print_result(result, folder, terminal)
        document = result_document(result.calibration, folder, recording.assumptions, CAMERA_FILES)
        if result.calibration.verdict != "fail":  # on with the IMU of this recording, else with that of another
            here = recording_holds_imu(self.recording)
            stated = ["--topics", *self.topics] if here and self.topics else []
            words = ("--target", target, "--cam", folder / "calibration.yaml", *stated)
            terminal.print("")
            terminal.propose("camera-imu", self.recording if here else "RECORDING", *words)
        terminal.document({**document, **_lenses(result)})
        return exit_code(result.calibration)


def _print_result(result: "Result", folder: Path, terminal: Terminal) -> None:
    from ..camera_summary import baseline_lines, cameras_lines, parameter_table, trial_table

    calibration = result.calibration
    print_summary(calibration, cameras_lines(result), terminal)
    for table in (trial_table(result), *(parameter_table(calibration, name) for name in calibration.cameras)):
        terminal.print("")
        terminal.draw(table)
    if lines := list(baseline_lines(calibration)):
        terminal.print("\n" + "\n".join(lines))
    print_files(folder, terminal, CAMERA_FILES)


def _lenses(result: "Result") -> dict[str, Any]:
    from ...results.camera_diagnostics import CamerasDiagnostics
    from ..camera_summary import programs_reading

    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CamerasDiagnostics)
    return {
        "noise": diagnostics.noise,
        "trials": diagnostics.trials,
        "read_by": programs_reading(result.calibration),
    }


_NOT_OURS = ("cam0", "mav0", "cam0_corners.csv", "cam0_corners.csv.gz", "target.yaml", "camchain.yaml")


@dataclass(frozen=True, kw_only=True)
class SimulateCameras(FromScenario):
    """Make a folder with a recording of simulated cameras in front of a board, and its truth (truth.yaml).

    `gnomon camera` takes the folder as it is, or the bag in it.

    Examples
    --------
    $ gnomon simulate cameras -o cameras
    $ gnomon simulate cameras -o cameras --images --cameras 2
    """

    scenario_type: ClassVar[type] = CamerasScenario

    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording."""
    scenario: Annotated[Path | None, FileOption] = None
    """A scenario.yaml that states the options below; those that are given here as well replace its own."""
    form: ImagesAs = "folder"
    """With --images: images in folders cam0, ... (folder), in EuRoC's layout (euroc), a ROS 1 bag (ros1), a ROS 2 bag
    in SQLite (ros2), or an MCAP file (mcap)."""
    seed: Seed = 0
    options: Annotated[CamerasScenario, Flat] = field(default_factory=CamerasScenario)

    def run(self, terminal: Terminal) -> int:
        """Simulate a recording, write its folder, and return the exit code."""
        from ...simulate.cameras import simulate_cameras
        from ...writers.simulated_cameras import CAMERA_FILES, CAMERAS_FILES, save_cameras_recording

        folder = self.output
        replaced = replaces_simulated(folder, _NOT_OURS)
        check_form(self.form, images=self.options.images)
        own = (*CAMERAS_FILES, *CAMERA_FILES, *OF_IMUS) if replaced else CAMERAS_FILES
        with result_folder(folder, own=own) as staging:
            terminal.progress("simulating")
            simulation = simulate_cameras(self.options, self.seed)
            files = save_cameras_recording(simulation, staging, self.form, terminal.progress)
            names = [path.relative_to(staging) for path in files]
        cameras = ", ".join(simulation.truth.cameras)
        contents = f"{len(simulation.t_ns)} views by {cameras}; {simulation.target.describe()}"
        print_folder(folder, contents, terminal, replaced=replaced)
        terminal.propose("camera", folder)
        terminal.document(folder_document(folder, names))
        return USABLE
