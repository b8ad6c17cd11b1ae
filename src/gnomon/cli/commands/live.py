"""The command that records a sensor and says, meanwhile, what to do with it."""

import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ...errors import OptionError, RecordingError
from ...output import write_whole
from ..arguments import Argument
from ..command import CamFile, Command, FileOption, Flat, ForUse, Input, PosesInput, Report, TableOptions, output_option
from ..files import default_folder, files_beside, read_use_option
from ..terminal import Terminal
from .camera import NO_TARGET, CameraCommand
from .camera_imu import CameraImu
from .imu import Imu
from .magnetometer import Magnetometer
from .noise import Noise

if TYPE_CHECKING:
    from ...live.camera_session import CameraSession
    from ...live.image_sources import ImageSource
    from ...live.rig_session import RigSession
    from ...live.server import LivePage, Session
    from ...live.session import LiveSession
    from ...models.target import Target

_COPIED = {"cam": "camchain.yaml", "imu": "imu.yaml"}


@dataclass(frozen=True, kw_only=True)
class Live(Command):
    """Record a sensor with guidance: what to do next, how much is known already, and what is wrong, as it happens.

    Sources are serial:PORT[@BAUD], tail:FILE (which another program writes), udp:PORT, phyphox:HOST, http (Sensor
    Logger on a phone), replay:RECORDING[@SPEED], and simulate[:SEED], which needs no sensor; those of a camera
    camera:INDEX, camera:URL, replay:RECORDING[@SPEED] and simulate. A page in the browser shows which way to turn the
    sensor, or where to hold the board. Control-C, or Stop on the page, ends the recording, and gnomon imu (or camera,
    magnetometer, noise) works on the recording.

    Examples
    --------
    $ gnomon live imu simulate -o first
    $ gnomon live imu serial:/dev/ttyUSB0@500000 --for vio -o monday
    $ gnomon live imu tail:log.txt --no-browser -o monday
    $ gnomon live camera-imu camera:0 serial:/dev/ttyUSB0 --target target.yaml --cam lens-camera/calibration.yaml -o rig
    $ gnomon live camera camera:0 --target target.yaml -o lens
    """

    what: Annotated[Literal["imu", "camera", "camera-imu", "magnetometer", "noise"], Argument(positional=True)]
    """What is to be calibrated."""
    source: Annotated[tuple[str, ...], Argument(positional=True, metavar="SOURCE")]
    """Where samples or images come from, such as serial:/dev/ttyUSB0@500000; of camera-imu two, images first, or
    one that has both."""
    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording, which must hold nothing yet; the result goes beside it."""
    target: Annotated[Path | None, FileOption] = None
    """Of a camera: Kalibr's file of the board (default: target.yaml beside what is replayed); it is copied into the
    folder, as are the next two."""
    cam: CamFile = None
    """Of camera-imu: Kalibr's file of the camera and its intrinsics, or gnomon's calibration.yaml (default:
    camchain.yaml beside what is replayed)."""
    imu: Annotated[Path | None, FileOption] = None
    """Of camera-imu: Kalibr's file of the IMU's noise (default: imu.yaml beside what is replayed, where there is
    one)."""
    use: ForUse = None
    browser: bool = True
    """Show no page; the status line in the terminal says the same."""
    lan: bool = False
    """Let other devices in the network see the page, by the address with its token."""
    tls: bool = False
    """Serve the page under a certificate that is made for it, so that nobody in the network reads along; a browser
    warns of it once, and apps on phones refuse it."""
    port: int = 0
    """Of the page; any that is free where it is 0."""
    until_enough: bool = False
    """Stop as soon as what is needed is reached, or what is replayed is at its end."""
    report: Report = True
    table: Annotated[TableOptions, Flat] = field(default_factory=TableOptions)

    def run(self, terminal: Terminal) -> int:
        """Record until it is stopped, calibrate what was recorded, and return the exit code."""
        opened = {"camera": self._open_images, "camera-imu": self._open_rig}
        session = opened.get(self.what, self._open_samples)()
        page = self._open_page(session, terminal)
        session.begin_recording()
        try:
            with suppress(KeyboardInterrupt):
                self._guide(session, terminal)
        finally:
            session.end_recording()
        terminal.print(f"recorded     {session.recorded} in {self.output}")
        if session.empty:
            why = " ".join(fault.text for fault in session.troubles()[:1])
            raise RecordingError(f"{' '.join(self.source)}: nothing to calibrate arrived. {why}".rstrip())
        try:
            return self._ordinary_command().run(terminal)
        finally:
            if page is not None:
                page.show_result(default_folder((self.output,), self.what) / "report.html")

    def _open_samples(self) -> "LiveSession":
        from ...live.coach import Coach, MagnetometerCoach, NoiseCoach
        from ...live.session import LiveSession
        from ...live.sources import open_source
        from ...options.requirements import GENERAL_IMU
        from ...units import Units

        table = self.table
        units = None if table.units is None else Units.parse(table.units)
        coach = {"imu": Coach, "magnetometer": MagnetometerCoach, "noise": NoiseCoach}[self.what]
        reading: Any = {"units": units, "columns": table.columns, "rate_hz": table.rate}
        use = read_use_option(self.use) or GENERAL_IMU
        return LiveSession(open_source(self._only_source, units), self.output, use, coach=coach, **reading)

    def _open_images(self) -> "CameraSession":
        from ...formats.kalibr.target import target_text
        from ...live.camera_session import CameraSession
        from ...live.image_sources import open_image_source

        source = open_image_source(self._only_source)
        target = self._board(source)
        session = CameraSession(source, self.output, target)
        write_whole(self.output / "target.yaml", target_text(target))
        return session

    def _open_rig(self) -> "RigSession":
        from ...formats.kalibr.target import target_text
        from ...formats.sensor_inputs import read_cameras
        from ...live.image_sources import open_rig_sources, simulate_rig
        from ...live.rig_session import RigSession
        from ...options.requirements import GENERAL_RIG
        from ...units import Units
        from ...writers.simulated_cameras import simulated_texts

        units = None if self.table.units is None else Units.parse(self.table.units)
        images, samples = open_rig_sources(self.source, units)
        target = self._board(images)
        files = files_beside(Path(images.place or "-"), {"cam": self.cam, "imu": self.imu})[0]
        texts = {_COPIED[name]: path.read_text(encoding="utf-8") for name, path in files.items() if path is not None}
        if files["cam"] is not None:
            lenses = {name: stated.camera for name, stated in read_cameras(files["cam"]).items()}
        elif self.source[0].startswith("simulate"):
            simulation = simulate_rig(self.source[0].partition(":")[2])
            texts = dict(simulated_texts(simulation)) | texts
            lenses = {name: frames.camera for name, frames in simulation.recording.cameras.items()}
        else:
            raise OptionError("--cam is missing: the file of the camera and its intrinsics, as gnomon camera makes it.")
        use = read_use_option(self.use) or GENERAL_RIG
        session = RigSession(images, samples, self.output, target, lenses=lenses, use=use, units=units)
        for name, text in (texts | {"target.yaml": target_text(target)}).items():
            write_whole(self.output / name, text)
        return session

    @property
    def _only_source(self) -> str:
        if len(self.source) != 1:
            raise OptionError(f"{' '.join(self.source)}: expected one source; two, images and samples, has camera-imu.")
        return self.source[0]

    def _board(self, source: "ImageSource") -> "Target":
        """Return the board as it is stated, as the source knows it, or as it is described beside what is replayed."""
        from ...formats.kalibr.target import read_target

        if self.target is None and source.target is not None:
            return source.target
        beside = files_beside(Path(source.place or "-"), {"target": self.target})[0]["target"]
        if beside is None:
            raise OptionError(NO_TARGET.format(folder=source.place or "the folder of what is replayed"))
        return read_target(beside)

    def _ordinary_command(self) -> Command:
        """Return the command that calibrates what was recorded."""
        table: Any = {"columns": self.table.columns, "rate": self.table.rate, "units": self.table.units}
        shared: Any = {name: getattr(self, name) for name in ("json", "quiet", "verbose", "log", "report")}
        if self.what == "imu":
            return Imu(recording=PosesInput(paths=(self.output,), **table), use=self.use, **shared)
        if self.what == "camera":
            return CameraCommand(recording=self.output, cache=False, **shared)
        if self.what == "camera-imu":
            units = self.table.units
            return CameraImu(recording=self.output, cache=False, units=units, use=self.use, **shared)
        recording = Input(path=self.output, **table)
        if self.what == "magnetometer":
            return Magnetometer(recording=recording, use=self.use, **shared)
        return Noise(recording=recording, **shared)

    def _open_page(self, session: "Session", terminal: Terminal) -> "LivePage | None":
        from ...live.sources import PushSource

        if not self.browser and not isinstance(session.source, PushSource):
            return None
        from ...live.server import LivePage

        page = LivePage(session, port=self.port, lan=self.lan, tls=self.tls)
        page.begin_serving()
        terminal.print(f"page         {page.address}")
        if page.fingerprint:
            terminal.print(f"certificate  SHA-256 {page.fingerprint}")
        if self.lan and sys.stderr.isatty():
            page.draw_address(sys.stderr)
        if isinstance(session.source, PushSource):
            terminal.print(f"push to      {page.push_address}")
        if self.browser:
            page.open_in_browser()
        return page

    def _guide(self, session: "Session", terminal: Terminal) -> None:
        """Look at what arrives, and say what to do, until it is stopped."""
        from ...live.session import LOOK_S, TICK_S

        told, looked_s = "", 0.0
        while not session.stopped.wait(TICK_S):
            session.take_arrivals()
            if time.monotonic() - looked_s < LOOK_S:
                continue
            looked_s = time.monotonic()
            state = session.look_at_arrivals()
            faults = [*session.troubles(), *state.faults]
            wrong = f" ! {faults[0].text}" if faults else ""
            line = f"{state.seconds:.0f} s{state.known}. {state.advice}{wrong}"
            key = line if sys.stderr.isatty() else f"{state.subject}{wrong}"
            if key != told:
                terminal.progress(line)
                told = key
            if self.until_enough and (state.confirmed or session.source.ended):
                return
