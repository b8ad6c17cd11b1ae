"""What a format cannot represent, in words and numbers, and what a conversion knows besides the calibration.

Also what programs do not use of the numbers that their own files hold, as their source code was found to be, and the
lens with k3 (radtan5) for programs that know radtan without: the coefficients that come nearest over the image.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, field, replace
from math import degrees
from textwrap import wrap
from typing import Any

import numpy as np

from ...errors import OptionError
from ...findings import join_names
from ...frozen import value_class
from ...geometry.rotations import Floats, frame_rotation
from ...models.camera import PROJECTIONS, Camera, knows_lens
from ...models.lens_names import PROGRAMS
from ...models.origin import AXES
from ...recording.samples import ImuNoise
from ...results.calibration import Calibration, CameraCalibration
from ...results.result import prior_held_names
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


_NEAR_GRID = 40  # pixels of the grid along each side of the image


@value_class
class NearestLens:
    """A lens of a simpler model, and how far its pixels are from those of the first [px]."""

    camera: Camera
    rms_px: float = 0.0
    largest_px: float = 0.0


def without_k3(camera: Camera) -> NearestLens:
    """Return the radtan lens that is nearest to a radtan5 one, focal lengths and principal point kept; others as is."""
    if camera.distortion != "radtan5":
        return NearestLens(camera=camera)
    width, height = camera.resolution
    u, v = np.meshgrid(np.linspace(0, width - 1, _NEAR_GRID), np.linspace(0, height - 1, _NEAR_GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays, valid = camera.unproject(pixels)
    rays, pixels = rays[valid], pixels[valid]
    shape = tuple(camera.intrinsics[:-4].tolist())
    x, y, z = rays[:, 0], rays[:, 1], rays[:, 2]
    divisor = PROJECTIONS[camera.projection].divide(shape, x, y, z, False).value
    mx, my = x / divisor, y / divisor
    s, cross = mx * mx + my * my, 2 * mx * my
    fu, fv, pu, pv = camera.intrinsics[-4:].tolist()
    rows_u = fu * np.column_stack([s * mx, s * s * mx, cross, s + 2 * mx * mx])
    rows_v = fv * np.column_stack([s * my, s * s * my, s + 2 * my * my, cross])
    wanted = pixels - np.column_stack([fu * mx + pu, fv * my + pv])
    coeffs = np.linalg.lstsq(np.vstack([rows_u, rows_v]), wanted.T.ravel(), rcond=None)[0]
    nearest = replace(camera, distortion="radtan", distortion_coeffs=coeffs)
    off = np.linalg.norm(wanted - np.column_stack([rows_u @ coeffs, rows_v @ coeffs]), axis=1)
    return NearestLens(camera=nearest, rms_px=float(np.sqrt(np.mean(off**2))), largest_px=float(off.max()))


def cameras_without_k3(cameras: Mapping[str, CameraCalibration]) -> dict[str, CameraCalibration]:
    """Return the cameras with such lenses."""
    return {name: replace(camera, camera=without_k3(camera.camera).camera) for name, camera in cameras.items()}


def k3_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say what leaving out k3 costs."""
    for name, camera in calibration.cameras.items():
        if camera.camera.distortion == "radtan5":
            nearest = without_k3(camera.camera)
            yield Loss(
                what=f"k3 of {name}",
                why=f"{whose} knows k1, k2, p1 and p2 only; they were chosen anew to be nearest over the image.",
                size=f"{nearest.rms_px:.2g} px rms, up to {nearest.largest_px:.2g} px",
            )


_GRAVITY_M_S2 = 9.81
_LEAST_GRAVITY_M_S2 = 5e-4
_PX4_LEAST = 0.01  # of the length of the change of a vector [m/s^2], [rad/s], [1]
_GRID = 24


def ignored_values(calibration: Calibration, to: str) -> Iterator[Loss]:
    """Yield what a program passes over although its file has it, each with its size and what to do.

    Parameters
    ----------
    to : the format, such as "basalt"
    """
    for found in _IGNORED.get(to, ()):
        yield from found(calibration)


def _basalt_shift(calibration: Calibration) -> Iterator[Loss]:
    yield from _shift(
        calibration,
        "cam_time_offset_ns",
        "Basalt's odometry does not use it: the line that would add it to the timestamps of the images is commented "
        "out",
    )


def _okvis_delay(calibration: Calibration) -> Iterator[Loss]:
    yield from _shift(
        calibration, "image_delay", "one of the two repositories of OKVIS2 reads it and does not apply it"
    )


def _shift(calibration: Calibration, key: str, why: str) -> Iterator[Loss]:
    shift = next((camera.time_shift_cam_imu for camera in calibration.cameras.values()), 0.0)
    if shift:
        yield Loss(
            what=key,
            why=f"{why}. Where yours does so, add the shift to the timestamps of the images (t_imu = t_cam + shift) "
            f"and set {key} to 0.",
            size=f"shift {shift * 1e3:+.6g} ms",
        )


def _gravity(whose: str, where: str) -> Callable[[Calibration], Iterator[Loss]]:
    def found(calibration: Calibration) -> Iterator[Loss]:
        apart = calibration.gravity.value - _GRAVITY_M_S2
        if calibration.cameras and abs(apart) > _LEAST_GRAVITY_M_S2:
            yield Loss(
                what="gravity",
                why=f"{whose} has {_GRAVITY_M_S2} m/s^2 {where}; this calibration rests on "
                f"{calibration.gravity.value:.5f} m/s^2. Set it there, or the bias takes the difference.",
                size=f"{1e3 * apart:+.2g} mm/s^2",
            )

    return found


def _orb_slam3_second_lens(calibration: Calibration) -> Iterator[Loss]:
    """`Settings::readCamera2` takes Camera1.k1 to Camera1.k4 for the second KannalaBrandt8 lens."""
    cameras = list(calibration.cameras.items())[:2]
    if len(cameras) == 2 and all(camera.camera.distortion == "equidistant" for _, camera in cameras):
        (_, first), (name, second) = cameras
        width, height = second.camera.resolution
        u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        rays, valid = second.camera.unproject(pixels)
        taken = replace(second.camera, distortion_coeffs=first.camera.distortion_coeffs)
        image = taken.project(rays[valid], point_jacobian=False)
        apart = np.linalg.norm(image.pixels - pixels[valid], axis=1)[image.valid]
        yield Loss(
            what=f"Camera2.k1 to k4 of {name}",
            why="ORB-SLAM3 reads Camera1.k1 to k4 for the second lens, too (Settings::readCamera2); fix it there.",
            size=f"{np.mean(apart):.2g} px off on average, {np.max(apart):.2g} px at worst",
        )


def _kalibr_line_delay(calibration: Calibration) -> Iterator[Loss]:
    for name, camera in calibration.cameras.items():
        if camera.camera.line_delay_s:
            height = camera.camera.resolution[1]
            yield Loss(
                what=f"line_delay of {name}",
                why="Kalibr's camera-IMU tool takes all rows of an image as of one instant: timeshift_cam_imu "
                f"{1e3 * camera.middle_row_delay_s:+.6g} ms; the file has that of row 0.",
                size=f"{1e6 * camera.camera.line_delay_s:.3g} us a row, "
                f"{1e3 * abs(camera.camera.line_delay_s) * height:.3g} ms an image",
            )


def _px4_threshold(calibration: Calibration) -> Iterator[Loss]:
    from ..flight_controllers import flight_imu

    for name, imu in calibration.imus.items():
        flight = flight_imu(imu)
        triads = {"accelerometer": (flight.accelerometer, "m/s^2"), "gyroscope": (flight.gyroscope, "rad/s")}
        for triad, (found, unit) in triads.items():
            if found is None:
                continue
            vectors = {"offsets": (found.offset, f" {unit}")}
            if triad == "accelerometer":
                vectors["scales"] = (found.scale - 1, "")
            for what, (vector, own) in vectors.items():
                length = float(np.linalg.norm(vector))
                if 0 < length < _PX4_LEAST:
                    yield Loss(
                        what=f"{what} of the {triad} of {name}",
                        why=f"PX4 (in the versions seen) takes over a vector of {what} only where it changes by more "
                        f"than {_PX4_LEAST}{own}: from the default it keeps {0 if what == 'offsets' else 1}.",
                        size=f"their length is {length:.2g}{own}",
                    )


def _ardupilot_identity(calibration: Calibration) -> Iterator[Loss]:
    numbers = ["" if i == 0 else str(i + 1) for i in range(min(len(calibration.imus), 3))]
    names = ", ".join(f"INS_ACC{number}_ID and INS_GYR{number}_ID" for number in numbers)
    yield Loss(
        what="identity of the sensor",
        why=f"ArduPilot takes these values only where {names} are those of the sensor that it finds, and refuses to "
        "arm otherwise: calibrate it once with the ground station, which sets them, then load this file.",
    )


_IGNORED: Mapping[str, tuple[Callable[[Calibration], Iterator[Loss]], ...]] = {
    "basalt": (_basalt_shift, _gravity("Basalt", "in its code")),
    "okvis": (_okvis_delay,),
    "orb-slam3": (_orb_slam3_second_lens, _gravity("ORB-SLAM3", "in its code")),
    "openvins": (_gravity("OpenVINS", "as gravity_mag in estimator_config.yaml"),),
    "kalibr": (_kalibr_line_delay,),
    "px4": (_px4_threshold,),
    "ardupilot": (_ardupilot_identity,),
}
