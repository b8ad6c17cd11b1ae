"""What a format cannot represent, in words and numbers, and what a conversion knows besides the calibration."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, field
from itertools import groupby
from math import degrees
from textwrap import wrap
from typing import Any

import numpy as np

from ...errors import OptionError
from ...findings import join_names
from ...frozen import value_class
from ...models.camera import Camera, knows_lens
from ...models.frames import AXES, Floats, frame_rotation
from ...models.lens_names import PROGRAMS
from ...models.noise import ImuNoise
from ...results.calibration import Calibration, ImuCalibration, calibration_parameters, element_names
from ...units import STANDARD_GRAVITY_M_S2
from ..foreign import FOREIGN_METHOD


@value_class(eq=True)
class Loss:
    """One thing that a converted file does not say, or says otherwise.

    Attributes
    ----------
    what : what is not representable, or changed, such as "g-sensitivity"
    why : why the format cannot hold it, and what to do
    size : how much it matters, with its unit; may be empty
    """

    what: str
    why: str
    size: str = ""

    def __str__(self) -> str:
        return f"{self.what}{f' ({self.size})' if self.size else ''}: {self.why}"


@value_class(eq=True)
class Export:
    """A calibration in a foreign format: texts by file name, and what they do not say."""

    files: Mapping[str, str]
    losses: tuple[Loss, ...] = field(default=())


def require_triads(calibration: Calibration, format_name: str, *triads: str) -> None:
    """Refuse a calibration whose IMUs lack a triad that a format cannot do without.

    Raises
    ------
    OptionError
        If one is missing.
    """
    for name, imu in calibration.imus.items():
        missing = next((triad for triad in triads if getattr(imu, triad) is None), None)
        if missing is not None:
            raise OptionError(
                f"{format_name} needs {' and '.join(triads)}, and this calibration holds no {missing} of {name}. "
                f"Convert to imu_tk, c-header or csv, or calibrate {missing} too."
            )


def into_frame(calibration: Calibration, frame: str, whose: str) -> tuple[Calibration, tuple[Loss, ...]]:
    """Return the calibration in the frame that a format prescribes, and what its reader has to know about it."""
    if calibration.frame == frame:
        return calibration, ()
    another = "another" if calibration.cameras else "a"  # those of the calibration are turned with it
    turns = {
        name: frame_rotation(imu.required_accelerometer.sensitivity, frame) for name, imu in calibration.imus.items()
    }
    losses = tuple(
        Loss(
            what=f"body frame of {name}",
            why=f"{whose} frame is {frame}, the calibration's is {calibration.frame}. Turn whatever else is known in "
            f"the old frame, such as the pose of {another} camera, by R_new_old = {matrix_line(turn)}.",
            size=f"turned by {degrees(rotation_angle(turn)):.3g} deg",
        )
        for name, turn in turns.items()
    )
    return calibration.in_frame(frame), losses


def uncertainty_loss(format_name: str) -> Loss:
    """Say that sigmas, assessment and origin stay behind."""
    return Loss(
        what="uncertainty and origin",
        why=f"{format_name} has no place for sigmas, covariance, verdict and provenance. Keep calibration.yaml.",
    )


def magnetometer_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format has no place for magnetometers."""
    for name, imu in calibration.imus.items():
        if imu.magnetometer is not None:
            yield Loss(
                what=f"magnetometer of {name}",
                why=f"{format_name} knows none. Use c-header or csv to write it too, or keep calibration.yaml.",
            )


def rig_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say that a format of inertial sensors has no place for cameras, nor for where several IMUs are."""
    if calibration.cameras:
        yield Loss(
            what=", ".join(calibration.cameras),
            why=f"{format_name} knows no cameras: T_cam_imu, time shift and lens are left out. "
            f"Use {join_names(formats_of(c.camera for c in calibration.cameras.values()), 'or')} to write them too, or "
            "keep calibration.yaml.",
        )
    for name, imu in calibration.imus.items():
        if imu.T_imu_body is not None:
            yield Loss(
                what=f"pose and clock of {name}",
                why=f"{format_name} does not say how IMUs lie to each other: T_imu_body and time shift are left out. "
                "Use kalibr, json or csv to write them too.",
                size=f"{1e3 * float(np.linalg.norm(imu.T_imu_body[:3, 3])):.3g} mm, {1e3 * imu.time_shift_s:+.6g} ms",
            )


def g_sensitivity_losses(calibration: Calibration, format_name: str) -> Iterator[Loss]:
    """Say what leaving out the g-sensitivity costs, for each gyroscope that has one."""
    for name, imu in calibration.imus.items():
        size = g_sensitivity_rate(imu)
        if size:
            yield Loss(
                what=f"g-sensitivity of {name}",
                why=f"{format_name} knows no gyroscope bias that depends on the specific force. Use kalibr, "
                "openvins, imucal, c-header or csv to keep it, or calibrate with --model basic so that the bias "
                "absorbs what it can.",
                size=f"up to {size:.2g} rad/s = {degrees(size):.2g} deg/s at 1 g",
            )


def g_sensitivity_rate(imu: ImuCalibration) -> float:
    """Return the largest rate that the g-sensitivity feigns at 1 g, over all attitudes [rad/s]."""
    if imu.gyroscope is None:
        return 0.0
    response = np.linalg.inv(imu.gyroscope.sensitivity) @ imu.gyroscope.g_sensitivity
    return float(np.linalg.norm(response, 2)) * STANDARD_GRAVITY_M_S2


def rotation_angle(rotation: Floats) -> float:
    """Return the angle of a rotation matrix (3, 3) [rad]."""
    sine = np.linalg.norm(rotation - rotation.T) / (2 * np.sqrt(2))
    return float(np.arctan2(sine, (np.trace(rotation) - 1) / 2))


def matrix_line(matrix: Floats) -> str:
    """Return a matrix (3, 3) as one line."""
    return f"[{'; '.join(' '.join(f'{value:.9g}' for value in row) for row in matrix)}]"


def numbers_text(values: Floats, separator: str = " ") -> str:
    """Return numbers that read back bit by bit."""
    return separator.join(map(repr, values.tolist()))


_WIDTH = 116


@value_class(eq=True)
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


def stated_entry(stated: StatedImu) -> dict[str, Any]:
    """Return noise, rate and topic by Kalibr's keys, as far as they are known."""
    entry: dict[str, Any] = {}
    if stated.noise is not None:
        entry |= {name: float(value) for name, value in asdict(stated.noise).items()}
    if stated.update_rate_hz is not None:
        entry["update_rate"] = float(stated.update_rate_hz)
    return entry | ({"rostopic": stated.topic} if stated.topic else {})


@value_class(eq=True)
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


def file_remarks(calibration: Calibration) -> tuple[str, ...]:
    """Return the sentences that every file of a calibration has to carry; see `remark_losses`."""
    return loss_sentences(remark_losses(calibration))


def loss_sentences(losses: Iterable[Loss]) -> tuple[str, ...]:
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
    held = prior_held_names(calibration)
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


def prior_held_names(calibration: Calibration) -> tuple[str, ...]:
    """Return what a prior holds, whole parameters by their path and others number by number."""
    sizes = {
        path: len(element_names(path, value.shape))
        for path, value in calibration_parameters(calibration.imus, calibration.cameras)
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


_ANY = ("json", "csv")


def formats_of(cameras: Iterable[Camera]) -> tuple[str, ...]:
    """Return the formats that hold all of these lenses, json and csv where none of an estimator does."""
    lenses = tuple(cameras)
    return tuple(name for name in PROGRAMS if all(knows_lens(name, lens) for lens in lenses)) or _ANY


def unknown_lens(name: str, camera: Camera, known: str) -> OptionError:
    """Return the error of a lens that a program does not know, with the formats that can hold it.

    Parameters
    ----------
    name : of the camera
    known : who knows what, such as "OKVIS knows pinhole with radtan"
    """
    others = join_names(formats_of([camera]), "or")
    return OptionError(
        f"{name} is {camera.model}, and {known}. Calibrate the camera with one of these, or convert to {others}."
    )
