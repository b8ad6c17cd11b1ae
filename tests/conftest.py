"""Fixtures that several test files share."""

import gc
import os
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: threads of small products only wait for each other

import hypothesis
import numpy as np
import pytest

from gnomon.findings import Finding
from gnomon.recording import Source
from gnomon.results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    Holdout,
    ImuCalibration,
    Provenance,
    calibration_parameters,
    covariance_names,
)
from gnomon.results.result import Result
from gnomon.results.sensor_diagnostics import (
    AllanCurve,
    DetectorTrace,
    ImuDiagnostics,
    IntervalTable,
    ModelTrial,
    RotationTable,
    SignalEnvelope,
)
from tiers import (
    pytest_addoption,
    pytest_collect_directory,
    pytest_collection_modifyitems,
    pytest_configure,
    pytest_runtest_setup,
)
from trust_example import example_trust

__all__ = [
    "pytest_addoption",
    "pytest_collect_directory",
    "pytest_collection_modifyitems",
    "pytest_configure",
    "pytest_runtest_setup",
]

# The same examples on every run, and no limits by the clock, which a busy machine exceeds: what fails here fails for
# everyone.
hypothesis.settings.register_profile(
    "steady", derandomize=True, deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("steady")


def pytest_collection_finish() -> None:
    """Leave what has been imported out of every later search for garbage: thousands of tests make many."""
    gc.collect()
    gc.freeze()


def _calibration(findings, names, verdict, counts, *, gyroscope, unit) -> Calibration:
    accelerometer = AccelerometerCalibration(
        sensitivity=np.array([[414.87, 0, 0], [2.77, 412.50, 0], [8.32, 4.05, 415.08]]),
        bias=np.array([33124.2, 33275.2, 32364.4]),
        unit=unit,
    )
    gyro = GyroscopeCalibration(
        sensitivity=np.array([[4776.1, -72.0, -104.0], [6.1, 4768.0, 207.0], [-23.9, 60.1, 4771.5]]),
        bias=np.array([32770.3, 32451.0, 32509.5]),
        g_sensitivity=np.array([[0.09, 0.29, 0.66], [-1.31, 0.03, 0.82], [-0.71, -0.81, 0.22]]),
        unit=unit,
    )
    imus = {"imu0": ImuCalibration(accelerometer=accelerometer, gyroscope=gyro if gyroscope else None)}
    elements = covariance_names(imus)
    size = {"accelerometer.sens": 0.03, "accelerometer.bias": 0.2, "gyroscope.sens": 1.3, "gyroscope.bias": 0.3}
    sigma = np.array([next((s for key, s in size.items() if key in name), 0.04) for name in elements])
    sigma[[1, 2, 5]] = 0.0  # the body frame is accel-x
    return Calibration(
        imus=imus,
        frame="accel-x",
        gravity=Gravity(value=9.80665, sigma=0.02, source="standard gravity, since no place was given"),
        uncertainty=Covariance(names=elements, matrix=np.diag(sigma**2)),
        assessment=Assessment(
            verdict=verdict,
            findings=findings,
            holdout=Holdout(accelerometer_rms=1.46e-3, rotation_rms=2.65e-3 if gyroscope else float("nan")),
            intervals_found=counts[0],
            intervals_used=counts[1],
            rotations_found=counts[0] - 1,
            rotations_used=counts[1] - 1,
            model="g-sensitivity" if gyroscope else "none",
        ),
        provenance=Provenance(
            gnomon_version="0.1.0",
            method="imu",
            inputs=tuple(Source(name=name, sha256=f"{i:x}" * 64) for i, name in enumerate(names)),
            options={"window_s": "1.0"},
        ),
    )


def _intervals(rng, count, left_out, duration) -> IntervalTable:
    edges = np.sort(np.concatenate([[0.0], np.linspace(52, duration * 0.99, 2 * count - 1)]))
    start, stop = edges[0::2][:count], edges[1::2][:count]
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    used = np.ones(count, dtype=bool)
    used[rng.choice(count, left_out, replace=False)] = False
    after = rng.normal(0, 1.2e-3, count)
    return IntervalTable(
        start_s=start,
        stop_s=stop,
        samples=100 * (stop - start),
        accelerometer=32768 + 4070 * direction,
        gyroscope=32500 + rng.normal(size=(count, 3)),
        direction=direction,
        error_before=0.35 * direction[:, 0] - 0.2 * direction[:, 2] + after,
        error_after=after,
        error_holdout=after * 1.2 + rng.normal(0, 2e-4, count),
        sigma=np.full(count, 7e-4),
        used=used,
        reason=tuple("" if u else "moved slightly: its halves differ by 5 sigma" for u in used),
    )


def _rotations(rng, intervals) -> RotationTable:
    count = len(intervals.start_s) - 1
    angle = rng.uniform(0.4, 3.0, count)
    measured = intervals.direction[1:]
    after = np.abs(rng.normal(0, 1.3e-3, (3, count))).sum(axis=0)
    return RotationTable(
        start_s=intervals.stop_s[:-1],
        stop_s=intervals.start_s[1:],
        first=np.arange(count),
        angle_rad=angle,
        measured=measured,
        propagated=measured + rng.normal(0, 1e-3, (count, 3)),
        error_before=0.03 * angle + np.abs(rng.normal(0, 0.01, count)),
        error_after=after,
        error_holdout=after * 1.2,
        sigma=np.full(count, 1.9e-3),
        used=intervals.used[1:] & intervals.used[:-1],
        reason=tuple("" if u else "beside an interval that was left out" for u in intervals.used[1:]),
    )


def _signals(rng, intervals, duration, bins, unit) -> tuple[SignalEnvelope, SignalEnvelope, DetectorTrace]:
    t = (np.arange(bins) + 0.5) * duration / bins
    inside = np.searchsorted(intervals.start_s, t, side="right") - 1
    moving = (t > intervals.stop_s[inside])[:, None]
    level = 32768 + 4070 * intervals.direction[inside]
    wobble = rng.uniform(-2500, 2500, (bins, 3)) * moving
    spread = np.where(moving, rng.uniform(200, 1500, (bins, 3)), 10.0)
    force = SignalEnvelope(t_s=t, low=level + wobble - spread, high=level + wobble + spread, unit=unit)
    swing = rng.uniform(-14000, 14000, (bins, 3)) * moving
    rate = SignalEnvelope(t_s=t, low=32500 + swing - spread * 4, high=32500 + swing + spread * 4, unit=unit)
    multipliers = np.arange(2.0, 13.0)
    rms = 1.4e-3 + 2e-5 * (multipliers - 6) ** 2
    candidates = np.stack([multipliers, np.full(11, len(intervals.start_s)), rms, rms / 1.4e-3], axis=1)
    candidates[0, 1:] = [4, np.nan, np.nan]
    statistic = np.where(moving[:, 0], 10 ** rng.uniform(2, 7, bins), rng.uniform(0.4, 2.5, bins))
    return force, rate, DetectorTrace(t_s=t, statistic=statistic, multiplier=6.0, candidates=candidates)


FINDINGS = (
    Finding(
        severity="warning",
        code="gravity-assumed",
        message="Gravity was not given; standard gravity 9.80665 m/s² is assumed.",
        consequence="It differs from the local value by up to 0.3 %, and so do all accelerometer scales.",
        cure="Give --latitude (and --altitude), or --gravity.",
    ),
    Finding(
        severity="info",
        code="stamps-quantised",
        message="Time timestamps are quantised to 1 ms; a straight line fits them with 0.26 ms rms.",
        consequence="A uniform time base of 9.99900 ms was used.",
    ),
    Finding(severity="good", code="coverage", message="38 attitudes cover the sphere: no parameter is weak."),
)


@pytest.fixture
def make_result() -> Callable[..., Result]:
    """Make a result with realistic numbers, such as a recording of some minutes with a hand-held sensor gives."""

    def make(
        *, count=38, left_out=2, gyroscope=True, verdict="warn", unit="count", bins=2000,
        names=("xsens_acc.mat.gz", "xsens_gyro.mat.gz"), findings=FINDINGS,
    ) -> Result:  # fmt: skip
        rng = np.random.default_rng(7)
        duration = 52 + 12.0 * count
        intervals = _intervals(rng, count, left_out, duration)
        force, rate, detector = _signals(rng, intervals, duration, bins, unit)
        tau = np.geomspace(0.1, 26, 40)
        allan = 5.6e-4 / np.sqrt(tau)[:, None] * np.array([1.0, 1.02, 1.18]) + 6e-5
        return Result(
            calibration=_calibration(
                findings, names, verdict, (count, count - left_out), gyroscope=gyroscope, unit=unit
            ),
            diagnostics=ImuDiagnostics(
                accelerometer=force,
                gyroscope=rate if gyroscope else None,
                detector=detector,
                intervals=intervals,
                rotations=_rotations(rng, intervals),
                allan=AllanCurve(tau_s=tau, deviation=allan, t_init_s=18.0, static_s=52.0) if gyroscope else None,
                trials=(
                    ModelTrial(
                        model="basic", chosen=False, accelerometer_rms=1.5e-3, rotation_rms=1.03e-2, parameters=21
                    ),
                    ModelTrial(
                        model="g-sensitivity",
                        chosen=True,
                        accelerometer_rms=1.46e-3,
                        rotation_rms=2.65e-3,
                        parameters=30,
                    ),
                ),
                noise={"accelerometer.density": 7.8e-4, "gyroscope.density": 5.9e-4},
                trust=example_trust(),
            ),
        )

    return make


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Return the path of a real recording under $GNOMON_DATA, or skip the test where it is not there."""
    root = Path(os.environ.get("GNOMON_DATA", Path(__file__).parents[2] / "shared" / "data"))

    def path(name: str) -> Path:
        if not (root / name).exists():
            pytest.skip(f"needs the recording {name} in $GNOMON_DATA")
        return root / name

    return path


@pytest.fixture(scope="session")
def random_calibration() -> Callable[..., Calibration]:
    """Make a calibration of a random sensor, with a full covariance that respects the body frame."""

    def make(seed: int = 0, *, units=("count", "count"), frame="accel-x", gyroscope=True) -> Calibration:
        rng = np.random.default_rng(seed)
        scale = 10 ** rng.uniform(-1, 4, 2)
        bias = rng.uniform(-30, 30, (2, 3)) * scale[:, None]
        triangular = np.tril if frame == "accel-x" else np.triu if frame == "accel-z" else np.array
        skewed = [np.eye(3) + rng.uniform(-0.1, 0.1, (3, 3)) for _ in range(2)]
        accelerometer = AccelerometerCalibration(
            sensitivity=scale[0] * triangular(skewed[0]), bias=bias[0], unit=units[0]
        )
        gyro = GyroscopeCalibration(
            sensitivity=scale[1] * skewed[1],
            bias=bias[1],
            g_sensitivity=scale[1] * 1e-3 * rng.normal(size=(3, 3)),
            unit=units[1],
        )
        imus = {"imu0": ImuCalibration(accelerometer=accelerometer, gyroscope=gyro if gyroscope else None)}
        names = covariance_names(imus)
        free = np.concatenate([(value != 0).ravel() for _, value in calibration_parameters(imus)])
        size = np.array([scale[0 if "accelerometer" in name else 1] for name in names]) * 1e-4 * free
        root = rng.normal(size=(len(names), len(names))) * size[:, None]
        return Calibration(
            imus=imus,
            frame=frame,
            gravity=Gravity(value=9.81, sigma=0.003, source="given"),
            uncertainty=Covariance(names=names, matrix=root @ root.T),
            assessment=Assessment(
                verdict="pass",
                findings=FINDINGS,
                holdout=Holdout(accelerometer_rms=1.25e-3, rotation_rms=2e-3 if gyroscope else float("nan")),
                intervals_found=40,
                intervals_used=38,
                rotations_found=39,
                rotations_used=37,
                model="g-sensitivity" if gyroscope else "none",
                held_by_prior=("imu0.accelerometer.bias",),
            ),
            provenance=Provenance(
                gnomon_version="0.1.0",
                method="simulation",
                inputs=(Source(name="a b.csv", sha256="0" * 64),),
                options={"gravity": "9.81"},
                seed=seed,
            ),
        )

    return make
