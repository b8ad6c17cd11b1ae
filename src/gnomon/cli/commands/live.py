"""The command that records a sensor and says, meanwhile, what to do with it."""

import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ..command import Command, Flat, ForUse, Input, PosesInput, Report, TableOptions, output_option
from ..inputs import read_use_option
from ..output_folder import default_folder
from ..parsing.arguments import Argument
from ..terminal import Terminal
from .imu import Imu
from .magnetometer import Magnetometer
from .noise import Noise

if TYPE_CHECKING:
    from ...live.server import LivePage
    from ...live.session import LiveSession


@dataclass(frozen=True, kw_only=True)
class Live(Command):
    """Record a sensor with guidance: what to do next, how much is known already, and what is wrong, as it happens.

    Sources are serial:PORT[@BAUD], tail:FILE (which another program writes), udp:PORT, phyphox:HOST, http (Sensor
    Logger on a phone), replay:RECORDING[@SPEED], and simulate[:SEED], which needs no sensor. A page in the browser
    shows which way to turn the sensor. Control-C, or Stop on the page, ends the recording, and gnomon imu (or
    magnetometer, or noise) works on the recording.

    Examples
    --------
    $ gnomon live imu simulate -o first
    $ gnomon live imu serial:/dev/ttyUSB0@500000 --for vio -o monday
    $ gnomon live imu tail:log.txt --no-browser -o monday
    """

    what: Annotated[Literal["imu", "magnetometer", "noise"], Argument(positional=True)]
    """What is to be calibrated."""
    source: Annotated[str, Argument(positional=True)]
    """Where the samples come from, such as serial:/dev/ttyUSB0@500000."""
    output: Annotated[Path, output_option("DIR")]
    """Folder for the recording, which must hold nothing yet; the result goes beside it."""
    use: ForUse = None
    browser: bool = True
    """Show no page; the status line in the terminal says the same."""
    lan: bool = False
    """Let other devices in the network see the page, by the address with its token."""
    port: int = 0
    """Of the page; any that is free where it is 0."""
    until_enough: bool = False
    """Stop as soon as what is needed is reached."""
    report: Report = True
    table: Annotated[TableOptions, Flat] = field(default_factory=TableOptions)

    def run(self, terminal: Terminal) -> int:
        """Record until it is stopped, calibrate what was recorded, and return the exit code."""
        from ...live.coach import Coach
        from ...live.other_coaches import MagnetometerCoach, NoiseCoach
        from ...live.session import LiveSession
        from ...live.sources import open_source
        from ...options.requirements import GENERAL_IMU
        from ...units import Units

        use = read_use_option(self.use) or GENERAL_IMU
        units = None if self.table.units is None else Units.parse(self.table.units)
        source = open_source(self.source, units)
        table = self.table
        coach = {"imu": Coach, "magnetometer": MagnetometerCoach, "noise": NoiseCoach}[self.what]
        reading: Any = {"units": units, "columns": table.columns, "rate_hz": table.rate}
        session = LiveSession(source, self.output, use, coach=coach, **reading)
        page = self._open_page(session, terminal)
        session.begin_recording()
        try:
            with suppress(KeyboardInterrupt):
                self._guide(session, terminal)
        finally:
            session.end_recording()
        terminal.print(f"recorded     {session.recorder.written} lines in {self.output}")
        try:
            return self._ordinary_command().run(terminal)
        finally:
            if page is not None:
                page.show_result(default_folder((self.output,), self.what) / "report.html")

    def _ordinary_command(self) -> Command:
        """Return the command that calibrates what was recorded."""
        table: Any = {"columns": self.table.columns, "rate": self.table.rate, "units": self.table.units}
        shared: Any = {name: getattr(self, name) for name in ("json", "quiet", "verbose", "log", "report")}
        if self.what == "imu":
            return Imu(recording=PosesInput(paths=(self.output,), **table), use=self.use, **shared)
        recording = Input(path=self.output, **table)
        if self.what == "magnetometer":
            return Magnetometer(recording=recording, use=self.use, **shared)
        return Noise(recording=recording, **shared)

    def _open_page(self, session: "LiveSession", terminal: Terminal) -> "LivePage | None":
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

    def _guide(self, session: "LiveSession", terminal: Terminal) -> None:
        """Look at what arrives, and say what to do, until it is stopped."""
        from ...live.session import LOOK_S

        told = ""
        while not session.stopped.wait(LOOK_S):
            state = session.look_at_arrivals()
            line = _status_line(session)
            key = line if sys.stderr.isatty() else f"{state.phase} {state.prospect.target} {line.partition('!')[2]}"
            if key != told:
                terminal.progress(line)
                told = key
            if state.confirmed and self.until_enough:
                return


def _status_line(session: "LiveSession") -> str:
    """Return what is said in one line."""
    state = session.coach.state
    rests = len(state.prospect.up)
    known = f"{rests} rest{'s' * (rests != 1)}"
    worst = max((need.sigma / need.needed for need in state.prospect.needs), default=None)
    if worst is not None:
        known += f", sigma {worst:.2g} of what is needed"
    faults = [*session.troubles(), *state.faults]
    wrong = f" ! {faults[0].text}" if faults else ""
    return f"{state.seconds:.0f} s, {known}. {state.advice}{wrong}"
