"""A recording: samples, frames and what is known of them beforehand."""

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ..errors import RecordingError
from ..findings import Finding
from ..frozen import FrozenMapping, value_class
from ..units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2, Units
from .arrays import frozen_array, ns_from_s
from .frames import CameraFrames, KnownRig
from .samples import ImuSamples, Poses, TriadSamples
from .sources import Piece, Source, sample_fingerprint, samples_fingerprint


@value_class
class Recording:
    """What was measured in one go.

    Attributes
    ----------
    imus : mapping from "imu0", "imu1", ... to ImuSamples
    cameras : mapping from "cam0", "cam1", ... to CameraFrames; empty for an IMU alone
    findings : what was noticed while it was read, such as clocks that drift
    poses : averages instead of samples; `imus` is empty then
    pieces : the parts of the only IMU's samples, where each was recorded on its own; a pose each
    sources : the files that were read
    assumptions : sentences on what the reader had to assume, such as units or the rate
    rig : what a calibration of the cameras alone tells of them, where one was given; None without
    """

    imus: Mapping[str, ImuSamples]
    sources: tuple[Source, ...] = ()
    assumptions: tuple[str, ...] = ()
    cameras: Mapping[str, CameraFrames] = field(default_factory=dict[str, "CameraFrames"])
    findings: tuple[Finding, ...] = ()
    poses: Poses | None = None
    pieces: tuple[Piece, ...] = ()
    rig: KnownRig | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "imus", FrozenMapping(self.imus))
        object.__setattr__(self, "cameras", FrozenMapping(self.cameras))
        if self.sources and not any(source.samples for source in self.sources):
            first = replace(self.sources[0], samples=self._fingerprints())
            object.__setattr__(self, "sources", (first, *self.sources[1:]))

    def _fingerprints(self) -> tuple[str, ...]:
        imus = [imu.accelerometer if len(imu.accelerometer) else imu.gyroscope for imu in self.imus.values()]
        fields = [imu.magnetometer for imu in self.imus.values() if imu.magnetometer is not None]
        series = [triad.values for triad in (*imus, *fields)] + [frames.pixels for frames in self.cameras.values()]
        return tuple(one for one in map(sample_fingerprint, series) if one)

    @classmethod
    def from_arrays(cls, t_s: ArrayLike, gyro: ArrayLike, accel: ArrayLike, units: str | Units = "si") -> Self:
        """Make a recording of one IMU from arrays.

        Parameters
        ----------
        t_s : (n,) [s], or a pair of them (gyroscope, accelerometer) where the two triads have their own timestamps
        gyro : (n, 3) [rad/s, or as `units` says]
        accel : (n, 3) [m/s^2, or as `units` says], specific force
        units : "si", "raw", a list such as "g deg/s", or Units

        Raises
        ------
        RecordingError
            If the shapes do not fit.
        OptionError
            If `units` names no unit.
        """
        stated = Units.parse(units) if isinstance(units, str) else units
        _refuse_swapped(gyro, accel, stated)
        t_gyro, t_accel = t_s if isinstance(t_s, tuple) else (t_s, t_s)
        samples = ImuSamples(
            accelerometer=TriadSamples(
                t_ns=ns_from_s(t_accel), values=frozen_array(accel), unit=stated.accelerometer or "m/s^2"
            ),
            gyroscope=TriadSamples(t_ns=ns_from_s(t_gyro), values=frozen_array(gyro), unit=stated.gyroscope or "rad/s"),
        )
        return cls(imus={"imu0": samples}, sources=(samples_fingerprint(samples),))


_ABOUT_GRAVITY, _NO_GRAVITY = 0.15, 0.3
"""How far from gravity the median of an accelerometer may be, and what it never is, over gravity."""


def _refuse_swapped(gyro: ArrayLike, accel: ArrayLike, units: Units) -> None:
    """Refuse arrays of which the gyroscope's reads gravity all the time, and the accelerometer's hardly anything."""
    in_m_s2 = ACCELEROMETER_UNITS_M_S2[units.accelerometer or "m/s^2"]
    if in_m_s2 is None or in_m_s2 == STANDARD_GRAVITY_M_S2:  # a gyroscope may well read 1 deg/s all the time
        return
    middle = [float(np.median(np.linalg.norm(np.asarray(one, dtype=np.float64), axis=-1))) for one in (gyro, accel)]
    turned, felt = (value * in_m_s2 / STANDARD_GRAVITY_M_S2 for value in middle)
    if abs(turned - 1) < _ABOUT_GRAVITY and felt < _NO_GRAVITY:
        raise RecordingError(
            f"gyro and accel seem to be swapped: the median magnitude of gyro is {middle[0]:.4g}, which is gravity in "
            f"{units.accelerometer or 'm/s^2'}, and that of accel is {middle[1]:.4g}. The order is from_arrays(t_s, "
            "gyro, accel)."
        )
