"""The commands, as dataclasses from which their options and their help are made. Nothing here needs NumPy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from ..errors import OptionError
from ..options import CameraImuOptions, ImuOptions
from ..simulate import CameraImuScenario, Scenario
from ..units import Units
from .camera_command import CameraCommand
from .command_parts import (
    CalibrationPath,
    FileOption,
    Flat,
    FromScenario,
    ImuFiles,
    Input,
    PosesInput,
    Switch,
    Topics,
    output_option,
)
from .compare_command import Compare
from .magnetometer_command import Magnetometer, SimulateMagnetometer
from .noise_command import Noise, SimulateNoise
from .plan_command import Plan, PlanImu
from .platter_command import Rate, SimulatePlatterVideo
from .poses_command import SimulatePoses
from .simulate_cameras_command import ImagesAs, SimulateCameras
from .study_command import Study
from .target_command import PrintTarget
from .topics import topics_of
from .turntable_command import SimulateTurntable, Turntable
from .use_option import UseOption

_DEMO_SCENARIO = Scenario(g_sensitivity=3e-4)

CalibrationForm = Literal[
    "imu_tk", "kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis", "px4", "ardupilot", "ros2", "imucal",
    "c-header", "json", "csv",
]  # fmt: skip
RecordingForm = Literal["euroc", "ros1", "ros2", "mcap"]


@dataclass(frozen=True, kw_only=True)
class Imu:
    """Calibrate accelerometer and gyroscope from hand-held recordings, or an accelerometer alone from static poses.

    Let the sensor rest for about 50 s, then turn it by hand into many different attitudes and let it rest for a few
    seconds in each. Several recordings of one sensor, such as of several days, join as recordings: what the sensor
    itself changes from one to the next (turn-on bias, temperature) is estimated, and is in the sigmas.
    """

    recording: Annotated[PosesInput, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-imu beside the recording)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed; the verdict is then for that
    use."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[ImuOptions, Flat] = field(default_factory=ImuOptions)


@dataclass(frozen=True, kw_only=True)
class CameraImu:
    """Calibrate cameras and an IMU that were waved together in front of a board.

    Hold the board still and the whole of it in view; turn the rig about all its axes and shake it along all of them,
    as fast as the images stay sharp, for about a minute.
    """

    recording: tyro.conf.Positional[Path]
    """A ROS 1 bag, a ROS 2 bag (sqlite or MCAP), a folder in the layout of EuRoC, TUM-VI or Kalibr, a folder of images
    or videos with a table of samples, or a video; or a folder with corners and samples, cam0_corners.csv,
    cam1_corners.csv, ... and imu0.csv, also with .gz."""
    cam: Annotated[Path | None, tyro.conf.arg(aliases=["--cams"], metavar="FILE", help_behavior_hint="")] = None
    """Kalibr's file of the cameras and their intrinsics, or gnomon's calibration.yaml (default: camchain.yaml in the
    recording's folder; else what the recording itself says, as EuRoC's does)."""
    imu: ImuFiles = ()
    """Kalibr's file of the IMU's noise; of several IMUs keyed imu0, imu1, ..., or this option once for each of them
    (default: imu.yaml in the recording's folder, where there is one)."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board (default: target.yaml in the recording's folder)."""
    topics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=TOPIC ...", help_behavior_hint="")] = ()
    """Topics of a bag, such as cam0=/left/image_raw imu0=/imu/data; guessed where it is clear."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where the recording has none, as a video."""
    units: str | None = None
    """Units of a table of samples: "si", or a list such as "g deg/s us"; recognised where not given."""
    workers: int | None = None
    """How many look for the board in the images at once; as many as there are cores where not given."""
    cache: Annotated[bool, Switch] = True
    """Do not keep the corners that were found in the result's folder, nor use those that an earlier run kept there."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html, diagnostics.npz, trajectory.txt and Kalibr's camchain-imucam.yaml,
    imu.yaml and results-imucam.txt (default: NAME-camera-imu beside the recording)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed; the verdict is then for that
    use."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[CameraImuOptions, Flat] = field(default_factory=CameraImuOptions)

    def __post_init__(self) -> None:
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)
        if self.workers is not None and self.workers < 1:
            raise OptionError(f"workers {self.workers} must be at least 1.")


@dataclass(frozen=True, kw_only=True)
class Check:
    """Say what a recording holds, what is wrong with it, and how to cure that.

    A recording of an IMU alone is judged as one with rests; one with cameras (a bag, a folder of images or corners, a
    video) as one that was waved in front of a board; neither lens nor board need be known.
    """

    recording: Annotated[Input, Flat]
    cam: Annotated[Path | None, tyro.conf.arg(aliases=["--cams"], metavar="FILE", help_behavior_hint="")] = None
    """Kalibr's file of the cameras (default: camchain.yaml in the recording's folder, where there is one)."""
    imu: ImuFiles = ()
    """Kalibr's file of the IMU's noise; of several IMUs keyed imu0, imu1, ..., or this option once for each of them
    (default: imu.yaml in the recording's folder, where there is one)."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board, which is then sought in some of the images (default: target.yaml in the recording's
    folder, where there is one)."""
    topics: Topics = ()
    """Topics of a bag, such as cam0=/left/image_raw imu0=/imu/data; guessed where it is clear."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where it is not in the recording of the cameras."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    def __post_init__(self) -> None:
        topics_of(self.topics)


@dataclass(frozen=True, kw_only=True)
class Show:
    """Show a calibration as tables with standard deviations; files of other projects without."""

    calibration: CalibrationPath
    """A calibration.yaml, a noise.yaml, or a file of another project: Kalibr's camchain, imu and target yaml and
    results-imucam.txt, OpenVINS' chains, Basalt's or imucal's JSON, imu_tk's .calib."""
    form: Literal["sensitivity", "kalibr", "tedaldi", "krebs", "angrisano"] = "sensitivity"
    """Form of the sensor model: gnomon's own, Kalibr's, or that of document A (tedaldi), B (krebs) or C (angrisano)."""
    use: UseOption = None
    """Judge it for vio, ahrs, gimbal, phone, or a YAML file that states what is needed; general takes back what it was
    judged for."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""


@dataclass(frozen=True, kw_only=True)
class Apply:
    """Turn a recording into specific force and angular rate with a calibration; of any length, in little memory."""

    calibration: CalibrationPath
    """A calibration.yaml."""
    recording: Annotated[Input, Flat]
    output: Annotated[Path, output_option("FILE", "(required)")]
    """CSV file to write."""
    imu: str | None = None
    """Which IMU of a calibration of several recorded the samples, such as imu1; told by the name of the file, as of
    imu1.csv or imu1/data.csv, where not given."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""


@dataclass(frozen=True, kw_only=True)
class Convert:
    """Write a calibration, gnomon's or another project's, in another format, and say what that format cannot hold.

    Or write a recording of cameras and an IMU, whatever it comes in, as a bag or as a folder in EuRoC's layout.
    """

    paths: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PATH [PATH ...]", help_behavior_hint="")
    ]
    """A calibration.yaml or the folder of a result, or files of another project that make one calibration, such as
    Kalibr's camchain-imucam.yaml and imu.yaml; or a recording: a bag, a folder with images or videos and IMU samples, a
    video."""
    to: CalibrationForm | RecordingForm
    """The format: imu_tk, kalibr, openvins, vins-fusion, orb-slam3, basalt, okvis, px4, ardupilot, ros2 (static
    transforms, camera_info), imucal, c-header, json or csv of a calibration; euroc, ros1, ros2 (SQLite) or mcap of a
    recording."""
    output: Annotated[Path | None, output_option("PATH")] = None
    """Folder for the files, file of a bag (default: beside the calibration or the recording, named after it and the
    format)."""
    imu: Annotated[Path | None, tyro.conf.arg(aliases=["--noise"], metavar="FILE", help_behavior_hint="")] = None
    """Kalibr's imu.yaml or gnomon's noise.yaml with the noise and rate that a format wants (default: imu.yaml or
    noise.yaml beside the calibration, where there is one)."""
    accelerometer_lsb_per_g: float | None = None
    """Counts per g by which the driver divides, such as 16384, where the calibration is of counts; PX4 and ArduPilot
    need it."""
    gyroscope_lsb_per_deg_s: float | None = None
    """The same per deg/s of the gyroscope, such as 131."""
    topics: Topics = ()
    """Which topics of a bag are read, such as cam0=/camera/image_raw imu0=/imu/data; found where not given."""
    imu_table: Annotated[Path | None, FileOption] = None
    """Table of the IMU's samples, where it is not in the recording."""
    units: str | None = None
    """Units of a table of samples: "si", or a list such as "g deg/s us"; recognised where not given."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    @property
    def path(self) -> Path:
        """The first of the paths, which is the only one but for files of another project."""
        return self.paths[0]

    def __post_init__(self) -> None:
        if not self.paths:
            raise OptionError("nothing to convert is given. Name a calibration.yaml or a recording.")
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)


@dataclass(frozen=True, kw_only=True)
class Simulate:
    """Make a recording of a simulated sensor, and its true calibration beside it (truth.yaml)."""

    output: Annotated[Path, output_option("FILE", "(required)")]
    """Recording to write, .npz or .csv."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[Scenario, Flat] = field(default_factory=Scenario)


@dataclass(frozen=True, kw_only=True)
class SimulateCameraImu(FromScenario):
    """Make a folder with a recording of simulated cameras and an IMU in front of a board, and its truth (truth.yaml).

    `gnomon camera-imu` takes the folder as it is.
    """

    scenario_type: ClassVar[type] = CameraImuScenario

    output: Annotated[Path, output_option("DIR", "(required)")]
    """Folder for the recording."""
    scenario: Annotated[Path | None, FileOption] = None
    """A scenario.yaml that states the options below; those that are given here as well replace its own."""
    form: ImagesAs = "folder"
    """With --images: images in folders cam0, ... beside a table of the samples (folder), or all of it in EuRoC's layout
    (euroc), a ROS 1 bag (ros1), a ROS 2 bag in SQLite (ros2), or an MCAP file (mcap)."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[CameraImuScenario, Flat] = field(default_factory=CameraImuScenario)


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Calibrate a simulated recording and compare the result with the truth."""

    output: Annotated[Path, output_option("DIR", "(default: gnomon-demo)")] = Path("gnomon-demo")
    """Folder for the recording, the truth and the results."""
    seed: int = 0
    """All random numbers follow from it."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    @property
    def scenario(self) -> Scenario:
        """What the demonstration simulates."""
        return _DEMO_SCENARIO


Command = (
    Imu
    | CameraCommand
    | CameraImu
    | Turntable
    | Rate
    | Magnetometer
    | Noise
    | Check
    | Plan
    | PlanImu
    | PrintTarget
    | Show
    | Apply
    | Convert
    | Compare
    | Simulate
    | SimulatePoses
    | SimulateTurntable
    | SimulatePlatterVideo
    | SimulateMagnetometer
    | SimulateNoise
    | SimulateCameras
    | SimulateCameraImu
    | Study
    | Demo
)

COMMANDS: dict[str, type[Command]] = {
    "imu": Imu,
    "camera": CameraCommand,
    "camera-imu": CameraImu,
    "turntable": Turntable,
    "rate": Rate,
    "magnetometer": Magnetometer,
    "noise": Noise,
    "check": Check,
    "plan": Plan,
    "plan-imu": PlanImu,
    "target": PrintTarget,
    "show": Show,
    "apply": Apply,
    "convert": Convert,
    "compare": Compare,
    "simulate": Simulate,
    "simulate-poses": SimulatePoses,
    "simulate-turntable": SimulateTurntable,
    "simulate-platter-video": SimulatePlatterVideo,
    "simulate-magnetometer": SimulateMagnetometer,
    "simulate-noise": SimulateNoise,
    "simulate-cameras": SimulateCameras,
    "simulate-camera-imu": SimulateCameraImu,
    "study": Study,
    "demo": Demo,
}
