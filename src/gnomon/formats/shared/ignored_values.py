"""What programs do not use of the numbers that their own files hold, as their source code was found to be."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...results.calibration import Calibration
from .losses import Loss

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
                why="Kalibr's camera-IMU tool does not read it: it takes all rows of an image to be of one instant.",
                size=f"{1e6 * camera.camera.line_delay_s:.3g} us a row, "
                f"{1e3 * abs(camera.camera.line_delay_s) * height:.3g} ms an image",
            )


def _px4_threshold(calibration: Calibration) -> Iterator[Loss]:
    from .flight_parameters import flight_imu

    for name, imu in calibration.imus.items():
        flight = flight_imu(imu)
        triads = {"accelerometer": (flight.accelerometer, "m/s^2"), "gyroscope": (flight.gyroscope, "rad/s")}
        for triad, (found, unit) in triads.items():
            if found is None:
                continue
            vectors = {"offsets": (found.offset, unit)}
            if triad == "accelerometer":
                vectors["scales"] = (found.scale - 1, "1")
            for what, (vector, own) in vectors.items():
                length = float(np.linalg.norm(vector))
                if 0 < length < _PX4_LEAST:
                    yield Loss(
                        what=f"{what} of the {triad} of {name}",
                        why=f"PX4 (in the versions seen) takes over a vector of {what} only where it changes by more "
                        f"than {_PX4_LEAST} {own}: from the default it keeps {0 if what == 'offsets' else 1}.",
                        size=f"their length is {length:.2g} {own}",
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
