"""Readings of gyroscopes and accelerometers, and where they lie on the trajectory."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ....frozen import value_class
from ....models.noise import ImuNoise
from ....recording import Floats
from ..layout import Status
from ..parameters import ImuParameters, RigParameters
from ..start.initial_trajectory import MARGIN_S
from ..trajectory import KnotGrid, Places


@value_class
class TriadData:
    """Readings of one triad.

    Attributes
    ----------
    values : (n, 3) [m/s^2 or rad/s]
    used : (n,) bool, False where masked
    """

    values: Floats
    used: np.ndarray


@value_class
class InertialData:
    """Readings of one IMU that share their timestamps.

    Attributes
    ----------
    imu : index of the IMU
    t_s : (n,) [s], ascending
    gyroscope, accelerometer : readings; None where the triad has other timestamps
    """

    imu: int
    t_s: Floats
    gyroscope: TriadData | None
    accelerometer: TriadData | None


def triad_readings(inertial: tuple[InertialData, ...]) -> Iterator[tuple[Floats, Floats]]:
    """Yield timestamps (n,) [s] and readings (n, 3) of every triad."""
    for data in inertial:
        for triad in (data.gyroscope, data.accelerometer):
            if triad is not None:
                yield data.t_s, triad.values


@value_class
class InertialNoise:
    """Standard deviation of a single reading of gyroscope [rad/s] and accelerometer [m/s^2]."""

    gyroscope: float
    accelerometer: float


@value_class
class ImuBeforehand:
    """What is known of an IMU's recording before anything is estimated.

    Attributes
    ----------
    name : such as "imu0"
    origin_ns : timestamp at which its seconds start, of its own clock [ns]
    rates_hz : sample rates of gyroscope and accelerometer
    nominal : noise as it was stated, or as consumer sensors have it
    stated : whether it was stated
    """

    name: str
    origin_ns: int
    rates_hz: tuple[float, float]
    nominal: ImuNoise
    stated: bool

    @property
    def noise(self) -> InertialNoise:
        """Standard deviation of single readings."""
        gyroscope, accelerometer = np.sqrt(self.rates_hz)
        return InertialNoise(
            gyroscope=self.nominal.gyroscope_noise_density * gyroscope,
            accelerometer=self.nominal.accelerometer_noise_density * accelerometer,
        )

    @property
    def walks(self) -> tuple[float, float]:
        """Random walk of the biases of gyroscope [rad/s/sqrt(s)] and accelerometer [m/s^2/sqrt(s)]."""
        return self.nominal.gyroscope_random_walk, self.nominal.accelerometer_random_walk


def body_clock_times(data: InertialData, imu: ImuParameters) -> Floats:
    """Return when the readings were taken, on the body's clock, (n,) [s].

    Readings of both triads are where the gyroscope is; `split_triads` comes first where the accelerometer has a shift.
    """
    shift_s = imu.shift_s(accelerometer=data.gyroscope is None)
    return data.t_s + shift_s if shift_s else data.t_s


def split_triads(data: InertialData) -> tuple[InertialData, ...]:
    """Return the readings of gyroscope and accelerometer one by one."""
    if data.gyroscope is None or data.accelerometer is None:
        return (data,)
    return replace(data, accelerometer=None), replace(data, gyroscope=None)


def on_grid(grid: KnotGrid, data: InertialData, imu: ImuParameters) -> tuple[InertialData, Places]:
    """Return those readings that lie on a grid, and where."""
    places = grid.places(body_clock_times(data, imu))
    keep = places.inside
    return some_readings(data, keep), places.some(keep)


def within_trajectory(grid: KnotGrid, data: InertialData, imu: ImuParameters, margin_s: float) -> InertialData:
    """Return those readings that stay in their segment of a grid while the clock moves by no more than a margin."""
    at = body_clock_times(data, imu)
    places = [grid.places(at + step) for step in (-margin_s, margin_s)]
    same = places[0].segment == places[1].segment
    return some_readings(data, places[0].inside & places[1].inside & same)


def on_trajectory(
    data: InertialData, parameters: RigParameters, status: Mapping[str, Status], grid: KnotGrid
) -> Iterator[InertialData]:
    """Yield readings, of clocks that are estimated those that stay on the trajectory while it comes out where.

    Were readings to enter and to leave it at its ends, the cost of two steps could not be compared.
    """
    imu = parameters.imus[data.imu]
    delayed = imu.accelerometer_shift_s != 0 or status[f"imu{data.imu}.accelerometer_shift"] != "fixed"
    for one in split_triads(data) if delayed else (data,):
        moves = data.imu > 0 or (delayed and one.gyroscope is None)
        yield within_trajectory(grid, one, imu, MARGIN_S / 2) if moves else one


def some_readings(data: InertialData, which: np.ndarray | slice) -> InertialData:
    """Return some of the readings."""

    def of(triad: TriadData | None) -> TriadData | None:
        return None if triad is None else TriadData(values=triad.values[which], used=triad.used[which])

    return InertialData(
        imu=data.imu, t_s=data.t_s[which], gyroscope=of(data.gyroscope), accelerometer=of(data.accelerometer)
    )
