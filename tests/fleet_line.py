"""Devices of a simulated line, as the library keeps them."""

from dataclasses import replace

import numpy as np

from gnomon.fleet.entries import LibraryEntry

NAMES = (
    *(f"imu0.accelerometer.sensitivity[{i},{i}]" for i in range(3)),
    *(f"imu0.accelerometer.bias[{i}]" for i in range(3)),
    *(f"imu0.gyroscope.sensitivity[{i},{i}]" for i in range(3)),
    *(f"imu0.gyroscope.bias[{i}]" for i in range(3)),
)
UNITS = ("1",) * 3 + ("m/s^2",) * 3 + ("1",) * 3 + ("rad/s",) * 3
SPREAD = np.repeat([0.005, 0.05, 0.01, 0.01], 3)
SIGMA = np.repeat([4e-5, 3e-4, 3e-4, 5e-5], 3)
BETWEEN = np.repeat([1e-4, 2e-3, 2e-4, 1e-3], 3)
"""What changes in a device from one measurement to the next."""
CENTRE = np.repeat([1.0, 0.0, 1.0, 0.0], 3)


def device(serial, day=0, *, values=CENTRE, station="A", seed=0, **more):
    """One calibration of the line."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(12, 12)) * 0.2 + np.eye(12)
    covariance = SIGMA[:, None] * (matrix @ matrix.T) * SIGMA
    covariance = (covariance + covariance.T) / 2  # to the last bit
    made = LibraryEntry(
        serial=serial,
        measured=str(np.datetime64("2026-01-01") + np.timedelta64(day, "D")),
        station=station,
        operator="",
        temperature_c=float("nan"),
        kind="imu",
        verdict="pass",
        use="ahrs",
        version="1.0",
        folder=f"results/{serial}",
        gravity=9.80665,
        inputs=((f"{serial}-{day}.csv", f"{seed:064x}"),),
        findings=(),
        needs=(("gyroscope scale", 0.03, 0.1, "%", "pass"),),
        names=NAMES,
        units=UNITS,
        values=np.asarray(values, dtype=float),
        sigmas=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        covered=tuple(range(12)),
    )
    return replace(made, **more)


def healthy_line(count, seed, *, again=0, stations=("A", "B")):
    """Devices with normal differences, `again` of them measured a second time later; in the order of their dates."""
    rng = np.random.default_rng(seed)
    truth = CENTRE + SPREAD * rng.normal(size=(count, 12))

    def measured(k, day):
        sigmas = SIGMA * rng.uniform(0.7, 1.5)
        values = truth[k] + BETWEEN * rng.normal(size=12) + sigmas * rng.normal(size=12)
        station = stations[int(rng.integers(len(stations)))]
        number = int(rng.integers(1 << 60))
        made = device(f"SN{k:05d}", day, values=values, station=station, inputs=(("r.csv", f"{number:064x}"),))
        return replace(made, sigmas=sigmas)

    first = [measured(k, 1 + k * 100 // count) for k in range(count)]
    return first + [measured(k, 110 + k * 50 // count) for k in range(again)]
