"""What a conversion knows besides the calibration: the IMU's noise, and what every file has to say of the result."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from textwrap import wrap

import numpy as np

from ..calibration import Calibration, element_names, parameters
from ..models.noise import ImuNoise
from ..models.origin import AXES
from ..readers.projects.foreign import FOREIGN_METHOD
from .export import Loss

_WIDTH = 116


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedImu:
    """What is known of an IMU besides its model.

    Attributes
    ----------
    noise : noise densities and random walks, or None
    update_rate_hz : sample rate [Hz], or None
    topic : ROS topic, or ""
    comments : lines on the noise for people
    """

    noise: ImuNoise | None = None
    update_rate_hz: float | None = None
    topic: str = ""
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What goes into the files of a format besides the calibration.

    Attributes
    ----------
    stated : "imu0", ... -> noise, rate and topic, as far as they are known
    remarks : sentences that every file has to carry, such as which parameters are held by assumption
    """

    stated: Mapping[str, StatedImu] = field(default_factory=dict[str, StatedImu])
    remarks: tuple[str, ...] = ()

    def of(self, imu: str) -> StatedImu:
        """Return what is known of an IMU."""
        return self.stated.get(imu, StatedImu())

    def lines(self) -> list[str]:
        """Return the remarks in lines of moderate length."""
        return [line for remark in self.remarks for line in wrap(remark, _WIDTH, break_on_hyphens=False)]

    def comment(self, mark: str = "# ") -> str:
        """Return the remarks as lines of comment; "" where there are none."""
        return "".join(f"{mark}{line}\n" for line in self.lines())


def remarks(calibration: Calibration, *, cameras: bool = True) -> tuple[str, ...]:
    """Return the sentences that every file of a calibration has to carry; see `remark_losses`."""
    return sentences(remark_losses(calibration, cameras=cameras))


def sentences(losses: Iterable[Loss]) -> tuple[str, ...]:
    """Return losses as sentences for the comments of a file."""
    return tuple(
        f"{loss.what[0].upper()}{loss.what[1:]}: {loss.why}{f' ({loss.size})' if loss.size else ''}" for loss in losses
    )


def remark_losses(calibration: Calibration, *, cameras: bool = True) -> Iterator[Loss]:
    """Yield what holds for a calibration in any format: what in it was not measured, and that it should not be used.

    Parameters
    ----------
    cameras : whether the format holds cameras
    """
    held = held_names(calibration)
    if held:
        yield Loss(
            what="held by assumption, not measured",
            why=f"{', '.join(held)}: the recording does not determine them. Record the motion that calibration.yaml "
            "names, or do not rely on them.",
            size=f"{len(calibration.assessment.held_by_prior)} numbers",
        )
    given = _given(calibration) if cameras else ()
    if given:
        yield Loss(what="taken as given, not estimated", why=f"{', '.join(given)}, as stated beforehand.")
    if calibration.verdict == "fail":
        reasons = (finding.message for finding in calibration.assessment.findings if finding.severity == "problem")
        reason = next(reasons, "see calibration.yaml.")
        yield Loss(what="verdict fail", why=f"this calibration should not be used: {reason}")
    if calibration.provenance.method == FOREIGN_METHOD:
        origin = calibration.provenance.options.get("format", "another project's files")
        yield Loss(what="origin", why=f"converted from {origin}; how uncertain the numbers are is not known.")


def origin_remarks(calibration: Calibration) -> tuple[str, ...]:
    """Return sentences that tell of which point of each IMU its poses are; none where there are no poses."""
    if not calibration.cameras and len(calibration.imus) < 2:
        return ()
    found: list[str] = []
    for name, imu in calibration.imus.items():
        arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
        if arms is None:
            found.append(f"The origin of {name} is the one point at which its three accelerometers are taken to be.")
            continue
        places = ", ".join(
            f"{axis} at {' '.join(f'{1e3 * value:.2f}' for value in arm)}"
            for axis, arm in zip(AXES, arms.tolist(), strict=True)
        )
        where = "a point between its accelerometers" if imu.origin is None else imu.origin.words
        found.append(f"The origin of {name}, to which poses refer, is {where}; its accelerometers, in mm: {places}.")
    return tuple(found)


def held_names(calibration: Calibration) -> tuple[str, ...]:
    """Return what a prior holds, whole parameters by their path and others number by number."""
    sizes = {
        path: len(element_names(path, value.shape)) for path, value in parameters(calibration.imus, calibration.cameras)
    }
    names: list[str] = []
    for path, group in groupby(calibration.assessment.held_by_prior, key=lambda name: name.split("[")[0]):
        elements = list(group)
        names += [path] if len(elements) == sizes.get(path) else elements
    return tuple(names)


def _given(calibration: Calibration) -> tuple[str, ...]:
    """Return which lenses were taken as stated; where no sigma is known at all nothing is said."""
    names: list[str] = []
    for name in calibration.cameras:
        sigma = calibration.sigma(f"{name}.intrinsics")
        if np.isfinite(sigma).all() and not sigma.any():
            names.append(f"intrinsics of {name}")
    return tuple(names)
