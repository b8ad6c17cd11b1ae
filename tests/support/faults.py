"""Recordings with one thing wrong with them each, as people make them: what is wrong, how it shows, how it is named.

A fault is simulated like any recording and then spoilt, or stated wrongly, in one respect. The finding that a
calibration or the data doctor has to name it by stands beside it, so that the catalogue is a test of both, and a
gallery for whoever looks for what his own recording shows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from gnomon.errors import OptionError
from gnomon.options import CameraImuOptions, ImuOptions
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.scenarios.recorded import Scenario

if TYPE_CHECKING:
    import numpy as np

    from gnomon.models.target import Target
    from gnomon.recording import Recording
    from gnomon.results.calibration import Calibration

FaultKind = Literal["imu", "camera-imu"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaultyRecording:
    """A recording with a fault, and how its owner, who does not know of it, would have it calibrated.

    Attributes
    ----------
    recording : as it would be read
    target : the board as it was stated; None of an IMU alone
    options : as stated
    truth : what is true of the sensors before the fault
    """

    recording: "Recording"
    target: "Target | None"
    options: ImuOptions | CameraImuOptions
    truth: "Calibration"


Spoil = Callable[[FaultyRecording, "np.random.Generator"], FaultyRecording]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fault:
    """One thing that is wrong with a recording, or with what was stated of it.

    Attributes
    ----------
    name : such as "gyroscope-clips"
    kind : of the recording: of an IMU that rests in many attitudes, or of a rig before a board
    title : what is wrong, in a few words
    symptom : what its owner sees
    codes : findings any of which names the right cause
    says : regular expressions all of which the finding's text matches, such as a number that must be in it
    added : steps of the model choice, any of which takes the fault up into the model
    scenario : of the recording, which is sound but for what the scenario says
    spoil : makes the fault; None where the scenario does
    remedied : whether the calibration mends it, so that saying so is enough and no warning is needed
    """

    name: str
    title: str
    symptom: str
    codes: tuple[str, ...]
    says: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    scenario: Scenario | CameraImuScenario
    spoil: Spoil | None = None
    remedied: bool = False

    @property
    def kind(self) -> FaultKind:
        """Of the recording."""
        return "imu" if isinstance(self.scenario, Scenario) else "camera-imu"


def faults() -> tuple[Fault, ...]:
    """Return the catalogue: faults of IMUs alone, then those of cameras with an IMU."""
    from .camera_imu_faults import CAMERA_IMU_FAULTS
    from .imu_faults import IMU_FAULTS

    return (*IMU_FAULTS, *CAMERA_IMU_FAULTS)


def fault_named(name: str) -> Fault:
    """Return a fault of the catalogue.

    Raises
    ------
    OptionError
        If there is none of that name.
    """
    for fault in faults():
        if fault.name == name:
            return fault
    raise OptionError(f"fault {name}: there is none of that name. There are {', '.join(f.name for f in faults())}.")


def simulate_fault(name: str, seed: int = 0) -> FaultyRecording:
    """Make a recording with one thing wrong with it.

    Parameters
    ----------
    name : of the catalogue, see `faults`
    seed : every random number follows from it

    Raises
    ------
    OptionError
        If there is no fault of that name.

    Examples
    --------
    >>> case = simulate_fault("gyroscope-in-deg-s", seed=1)
    >>> bool(abs(case.recording.imus["imu0"].gyroscope.values).max() > 50)
    True
    """
    from .fault_recordings import faulty_recording

    return faulty_recording(fault_named(name), seed)
