"""Random calibrations of any of the three triads of an IMU, and recordings that they fit."""

from itertools import chain, combinations

import numpy as np

from gnomon.findings import Finding
from gnomon.recording import ImuSamples, TriadSamples
from gnomon.results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    Holdout,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    calibration_parameters,
    covariance_names,
)

TRIADS = ("accelerometer", "gyroscope", "magnetometer")
SUBSETS = tuple(chain.from_iterable(combinations(TRIADS, count) for count in (1, 2, 3)))
"""Every choice of triads, none left out but the empty one."""

FRAMES = {
    "accelerometer": ("accel-x", "accel-z", "user"),
    "gyroscope": ("gyro-x", "user"),
    "magnetometer": ("mag-x", "user"),
}
"""Body frames that the first of some triads can define."""

METHODS = {"accelerometer": "imu", "gyroscope": "turntable", "magnetometer": "magnetometer"}


def subset_calibration(
    triads, *, seed=0, frame=None, units=("count", "count", "count"), field_unit="local field", g_sensitivity=True
) -> Calibration:
    """Return a calibration of these triads with a full covariance that respects the body frame."""
    rng = np.random.default_rng(seed)
    frame = frame or FRAMES[triads[0]][0]
    scale, bias = 10 ** rng.uniform(-1, 4, 3), rng.uniform(-30, 30, (3, 3))
    skewed = [np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)) for _ in range(3)]
    fixed = {"accel-z": np.triu, "user": np.array}.get(frame, np.tril)
    skewed[TRIADS.index(triads[0])] = fixed(skewed[TRIADS.index(triads[0])])
    S, b = [scale[i] * skewed[i] for i in range(3)], [scale[i] * bias[i] for i in range(3)]
    G = scale[1] * 1e-3 * rng.normal(size=(3, 3)) * g_sensitivity
    made = {
        "accelerometer": AccelerometerCalibration(sensitivity=S[0], bias=b[0], unit=units[0]),
        "gyroscope": GyroscopeCalibration(sensitivity=S[1], bias=b[1], g_sensitivity=G, unit=units[1]),
        "magnetometer": MagnetometerCalibration(sensitivity=S[2], bias=b[2], unit=units[2], field_unit=field_unit),
    }
    imus = {"imu0": ImuCalibration(**{name: made[name] for name in triads})}
    names = covariance_names(imus)
    free = np.concatenate([(value != 0).ravel() for _, value in calibration_parameters(imus)])
    size = np.array([scale[TRIADS.index(name.split(".")[1])] for name in names]) * 1e-4 * free
    root = rng.normal(size=(len(names), len(names))) * size[:, None]
    held = {"accelerometer": "accelerometer_rms", "gyroscope": "rate_rms", "magnetometer": "field_rms"}
    return Calibration(
        imus=imus,
        frame=frame,
        gravity=Gravity(value=9.81, sigma=0.003, source="given"),
        uncertainty=Covariance(names=names, matrix=root @ root.T),
        assessment=Assessment(
            verdict="pass",
            findings=(Finding(severity="info", code="one", message="Some poses."),),
            model={"gyroscope": "g-sensitivity", "magnetometer": "full"}.get(triads[-1], "none"),
            holdout=Holdout(**{held[name]: float(rng.uniform(1e-4, 1e-2)) for name in triads}),
            intervals_found=18,
            intervals_used=17,
        ),
        provenance=Provenance(gnomon_version="0.3.0", method=METHODS[triads[0]]),
    )


def recorded(triads, *, count=300, seed=0, own_stamps=False) -> ImuSamples:
    """Return samples in counts of these triads; with timestamps of their own the magnetometer is the slowest."""
    rng = np.random.default_rng(seed)
    start = 1_600_000_000_000_000_000
    made = {}
    for name, step in zip(TRIADS, (10_000_000, 5_000_000, 40_000_000), strict=True):
        apart = step if own_stamps else 10_000_000
        rows = count * 10_000_000 // apart if name in triads else 0
        t_ns = start + own_stamps * int(rng.integers(0, 3_000_000)) + apart * np.arange(rows)
        values = np.rint(rng.normal(0, 4000, (rows, 3)))
        made[name] = TriadSamples(t_ns=t_ns, values=values, unit="count")
    if "magnetometer" not in triads:
        made["magnetometer"] = None
    return ImuSamples(**made)
