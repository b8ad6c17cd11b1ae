"""The command that records a sensor and says, meanwhile, what to do with it."""

import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ...errors import OptionError
from ...output import write_whole
from ..command import Command, FileOption, Flat, ForUse, Input, PosesInput, Report, TableOptions, output_option
from ..inputs import files_beside, read_use_option
from ..output_folder import default_folder
from ..parsing.arguments import Argument
from ..terminal import Terminal
from .camera import NO_TARGET, CameraCommand
from .imu import Imu
from .magnetometer import Magnetometer
from .noise import Noise

if TYPE_CHECKING:
    from ...live.camera_session import CameraSession
    from ...live.image_sources import ImageSource
    from ...live.server import LivePage, Session
    from ...live.session import LiveSession
    from ...models.target import Target


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
    $ gnomon live camera camera:0 --target target.yaml -o lens
    """

    what: Annotated[Literal["imu", "camera", "magnetometer", "noise"], Argument(positional=True)]
    """What is to be calibrated."""
    source: Annotated[str, Argument(positional=True)]
    """Where the samples come from, such as serial:/dev/ttyUSB0@500000."""
    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording, which must hold nothing yet; the result goes beside it."""
    target: Annotated[Path | None, FileOption] = None
    """Of a camera: Kalibr's file of the board (default: target.yaml beside what is replayed); it is copied into the
    folder."""
    use: ForUse = None
    browser: bool = True
    """Show no page; the status line in the terminal says the same."""
    lan: bool = False
    """Let other devices in the network see the page, by the address with its token."""
    port: int = 0
    """Of the page; any that is free where it is 0."""
    until_enough: bool = False
    """Stop as soon as what is needed is reached, or what is replayed is at its end."""
    report: Report = True
    table: Annotated[TableOptions, Flat] = field(default_factory=TableOptions)

    def run(self, terminal: Terminal) -> int:
        """Record until it is stopped, calibrate what was recorded, and return the exit code."""
        session = self._open_images() if self.what == "camera" else self._open_samples()
        page = self._open_page(session, terminal)
        session.begin_recording()
        try:
            with suppress(KeyboardInterrupt):
                self._guide(session, terminal)
        finally:
            session.end_recording()
        terminal.print(f"recorded     {session.recorded} in {self.output}")
        try:
            return self._ordinary_command().run(terminal)
        finally:
            if page is not None:
                page.show_result(default_folder((self.output,), self.what) / "report.html")

    def _open_samples(self) -> "LiveSession":
        from ...live.coach import Coach
        from ...live.other_coaches import MagnetometerCoach, NoiseCoach
        from ...live.session import LiveSession
        from ...live.sources import open_source
        from ...options.requirements import GENERAL_IMU
        from ...units import Units

        table = self.table
        units = None if table.units is None else Units.parse(table.units)
        coach = {"imu": Coach, "magnetometer": MagnetometerCoach, "noise": NoiseCoach}[self.what]
        reading: Any = {"units": units, "columns": table.columns, "rate_hz": table.rate}
        use = read_use_option(self.use) or GENERAL_IMU
        return LiveSession(open_source(self.source, units), self.output, use, coach=coach, **reading)

    def _open_images(self) -> "CameraSession":
        from ...formats.kalibr.target import target_text
        from ...live.camera_session import CameraSession
        from ...live.image_sources import open_image_source

        source = open_image_source(self.source)
        target = self._board(source)
        session = CameraSession(source, self.output, target)
        write_whole(self.output / "target.yaml", target_text(target))
        return session

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
        recording = Input(path=self.output, **table)
        if self.what == "magnetometer":
            return Magnetometer(recording=recording, use=self.use, **shared)
        return Noise(recording=recording, **shared)

    def _open_page(self, session: "Session", terminal: Terminal) -> "LivePage | None":
        from ...live.sources import PushSource

        if not self.browser and not isinstance(session.source, PushSource):
            return None
        from ...live.server import LivePage

        page = LivePage(session, port=self.port, lan=self.lan)
        page.begin_serving()
        terminal.print(f"page         {page.address}")
        if isinstance(session.source, PushSource):
            terminal.print(f"push to      {page.push_address}")
        if self.browser:
            page.open_in_browser()
        return page

    def _guide(self, session: "Session", terminal: Terminal) -> None:
        """Look at what arrives, and say what to do, until it is stopped."""
        from ...live.session import LOOK_S

        told = ""
        while not session.stopped.wait(LOOK_S):
            state = session.look_at_arrivals()
            faults = [*session.troubles(), *state.faults]
            wrong = f" ! {faults[0].text}" if faults else ""
            line = f"{state.seconds:.0f} s, {state.known}. {state.advice}{wrong}"
            key = line if sys.stderr.isatty() else f"{state.subject}{wrong}"
            if key != told:
                terminal.progress(line)
                told = key
            if self.until_enough and (state.confirmed or session.source.ended):
                return
