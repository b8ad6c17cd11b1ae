"""Results of calibrations from magnitudes, with realistic numbers, made without any estimation."""

import numpy as np

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
    MagnetometerCalibration,
    Provenance,
    covariance_names,
)
from gnomon.results.result import Result
from gnomon.results.sensor_diagnostics import (
    DipTable,
    GyroscopeAtRest,
    IterationHistory,
    PeriodCurve,
    PoseTable,
    TriadDiagnostics,
    TriadRecord,
    TriadTrial,
    TurntableRate,
)

RPM16 = 16 * 2 * np.pi / 60

FINDINGS = (
    Finding(
        severity="warning", code="gravity-assumed",
        message="Gravity was not given; standard gravity 9.80665 m/s^2 is assumed.",
        consequence="It differs from the local value by up to 0.3 %, and so do all scales.",
        cure="Give --latitude (and --altitude), or --gravity.",
    ),
    Finding(severity="good", code="coverage", message="18 poses cover the sphere: no parameter is weak."),
)  # fmt: skip

ACCELEROMETER = AccelerometerCalibration(
    sensitivity=np.array([[655.4, 0, 0], [4.31, 649.2, 0], [-7.9, 3.3, 661.0]]),
    bias=np.array([12.4, -85.1, 140.7]),
    unit="count",
)
GYROSCOPE = GyroscopeCalibration(
    sensitivity=np.array([[12480.0, 0, 0], [41.0, 12530.0, 0], [-102.0, 66.0, 12466.0]]),
    bias=np.array([31.2, -12.9, 8.8]),
    g_sensitivity=np.array([[0.29, -0.06, 0.02], [0.11, 0.31, -0.04], [0.0, 0.07, -0.22]]),
    unit="count",
)
MAGNETOMETER = MagnetometerCalibration(
    sensitivity=np.array([[480.0, 0, 0], [-11.0, 455.0, 0], [6.0, 17.0, 502.0]]),
    bias=np.array([-118.0, 74.0, -36.0]),
    unit="mgauss",
)
_SIGMAS = {
    "accelerometer.sensitivity": 0.06, "accelerometer.bias": 0.4, "gyroscope.sensitivity": 2.4, "gyroscope.bias": 0.3,
    "gyroscope.g_sensitivity": 0.04, "magnetometer.sensitivity": 0.9, "magnetometer.bias": 0.5,
}  # fmt: skip


def calibration(imu, *, method, frame, verdict, model, counts, holdout, names, findings=FINDINGS) -> Calibration:
    """Return a calibration of one IMU with plausible sigmas."""
    imus = {"imu0": imu}
    elements = covariance_names(imus)
    sigma = np.array([_SIGMAS[name.removeprefix("imu0.").split("[")[0]] for name in elements])
    sigma[[1, 2, 5]] = 0.0  # the body frame is that of the first triad
    return Calibration(
        imus=imus,
        frame=frame,
        gravity=Gravity(value=9.80665, sigma=0.02, source="standard gravity, since no place was given"),
        uncertainty=Covariance(names=elements, matrix=np.diag(sigma**2)),
        assessment=Assessment(
            verdict=verdict, findings=findings, model=model, holdout=holdout,
            intervals_found=counts[0], intervals_used=counts[1],
        ),
        provenance=Provenance(
            gnomon_version="0.3.0", method=method,
            inputs=tuple(Source(name=name, sha256=f"{i:x}" * 64) for i, name in enumerate(names)),
        ),
    )  # fmt: skip


def _record(rng, triad, quantity, si_unit, count, magnitudes, noise, *, names, left_out=1, history=None) -> TriadRecord:
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    magnitude = np.resize(magnitudes, count).astype(float)
    direction[magnitude == 0] = np.nan
    used = np.ones(count, dtype=bool)
    used[rng.choice(count, left_out, replace=False)] = False
    after = rng.normal(0, noise, count)
    start = 5 + 14.0 * np.arange(count)
    vector = np.nan_to_num(direction) * magnitude[:, None]
    poses = PoseTable(
        name=tuple(names(i) for i in range(count)),
        start_s=start, stop_s=start + 8,
        samples=np.full(count, 800),
        measured=vector @ triad.sensitivity.T + triad.bias,
        magnitude=magnitude,
        direction=direction,
        error_before=magnitude * 0.02 * rng.normal(size=count) + after,
        error_after=after,
        error_holdout=1.3 * after + rng.normal(0, 0.2 * noise, count),
        sigma=np.full(count, noise * 0.9),
        used=used,
        reason=tuple("" if u else "moved slightly: its halves differ by 5 sigma" for u in used),
    )  # fmt: skip
    return TriadRecord(
        quantity=quantity, unit=triad.unit, si_unit=si_unit, poses=poses, noise_sigma=0.7 * noise,
        extra_sigma=0.6 * noise, history=history,
    )  # fmt: skip


def poses_result(*, gyroscope=True, verdict="warn", count=18, history=True, names=("poses.csv",), **changes) -> Result:
    """Accelerometer in static poses, by the paper's iteration; with a gyroscope at rest where wanted."""
    rng = np.random.default_rng(3)
    found = None
    if history:
        X = np.concatenate([[0.004, -0.008, 0.002, 12.4, -85.1, 140.7], 1 / np.array([655.4, 649.2, 661.0])])
        steps = 0.1 ** (2.0 * np.arange(6))[:, None]
        found = IterationHistory(q=2.1e3 * steps[:, 0] ** 2 + 8.1, parameters=X * (1 + 0.3 * steps))
    record = _record(
        rng, ACCELEROMETER, "specific force", "m/s^2", count, [9.80665], 1.4e-3,
        names=lambda i: f"pose {i + 1}", history=found,
    )  # fmt: skip
    rest = None
    if gyroscope:
        force = 9.80665 * np.nan_to_num(record.poses.direction)
        drift = np.outer(np.linspace(-1, 1, count), [0.9, -0.4, 0.2])
        predicted = force @ GYROSCOPE.g_sensitivity.T + GYROSCOPE.bias + drift
        rest = GyroscopeAtRest(
            t_s=record.poses.start_s + 4, force=force, measured=predicted + rng.normal(0, 0.12, (count, 3)),
            predicted=predicted, drift=drift, sigma=np.full((count, 3), 0.12), unit=GYROSCOPE.unit,
        )  # fmt: skip
    imu = ImuCalibration(accelerometer=ACCELEROMETER, gyroscope=GYROSCOPE if gyroscope else None)
    diagnostics = TriadDiagnostics(
        kind="poses", triads={"accelerometer": record}, at_rest=rest, noise={"accelerometer.density": 7.8e-4},
    )  # fmt: skip
    made = calibration(
        imu, method="imu", frame="accel-x", verdict=verdict, model="g-sensitivity" if gyroscope else "none",
        counts=(count, count - 1), holdout=Holdout(accelerometer_rms=1.9e-3), names=names, **changes,
    )  # fmt: skip
    return Result(calibration=made, diagnostics=diagnostics)


def turntable_result(
    *, accelerometer=False, verdict="pass", count=40, names=("turntable.csv", "webcam.mp4"), **changes
):
    """Gyroscope on a turntable at two speeds and at rest, one of them from a video."""
    rng = np.random.default_rng(4)
    rates = (
        TurntableRate(name="0rpm", stated=0, stated_sigma=0, estimated=0, estimated_sigma=0, parts=count // 3 + 1),
        TurntableRate(
            name="webcam.mp4", stated=RPM16, stated_sigma=1.6e-4, estimated=RPM16 * 1.00004, estimated_sigma=1.2e-4,
            parts=count // 3, turns=161.2,
        ),
        TurntableRate(
            name="33.33rpm", stated=3.4903, stated_sigma=3.5e-3, estimated=3.4951, estimated_sigma=4e-4,
            parts=count // 3,
        ),
    )  # fmt: skip
    period = np.linspace(0.4, 9, 700)
    t = np.arange(0, 600, 1 / 1.5)
    curve = PeriodCurve(
        name="webcam.mp4", period_s=period,
        score=0.2 + 0.75 * np.exp(-0.5 * ((period - 3.75 * np.maximum(np.rint(period / 3.75), 1)) / 0.05) ** 2),
        t_s=t, phase_error_turns=2e-3 * np.sin(t / 60) + rng.normal(0, 4e-4, len(t)),
    )  # fmt: skip
    triads = {}
    if accelerometer:
        triads["accelerometer"] = _record(
            rng, ACCELEROMETER, "specific force", "m/s^2", count, [9.80665], 2e-3, names=lambda i: f"part {i + 1}"
        )
    triads["gyroscope"] = _record(
        rng, GYROSCOPE, "angular rate", "rad/s", count, [0, RPM16, 3.4951], 8e-5, names=lambda i: f"part {i + 1}"
    )
    diagnostics = TriadDiagnostics(
        kind="turntable", triads=triads, rates=rates, videos=(curve,),
        trials=(
            TriadTrial(model="basic", chosen=False, holdout_rms=4.1e-4, parameters=9),
            TriadTrial(model="g-sensitivity", chosen=True, holdout_rms=1.1e-4, parameters=18),
        ),
        noise={"gyroscope.density": 3.1e-4},
    )  # fmt: skip
    imu = ImuCalibration(accelerometer=ACCELEROMETER if accelerometer else None, gyroscope=GYROSCOPE)
    made = calibration(
        imu, method="turntable", frame="accel-x" if accelerometer else "gyro-x", verdict=verdict, model="g-sensitivity",
        counts=(count, count - 1),
        holdout=Holdout(rate_rms=1.1e-4, accelerometer_rms=2e-3 if accelerometer else np.nan),
        names=names, **changes,
    )  # fmt: skip
    return Result(calibration=made, diagnostics=diagnostics)


def magnetometer_result(
    *, accelerometer=False, verdict="pass", count=4000, names=("compass.csv",), **changes
) -> Result:
    """Magnetometer turned by hand, aligned by the dip where there is an accelerometer."""
    rng = np.random.default_rng(5)
    record = _record(
        rng, MAGNETOMETER, "magnetic field", "", count, [1.0], 0.008, names=lambda i: f"sample {i + 1}",
        left_out=min(40, count // 4),
    )  # fmt: skip
    dip = None
    if accelerometer:
        number = np.arange(14)
        dip = DipTable(
            attitude=number, dip_rad=np.radians(64.2 + 0.4 * rng.normal(size=14)), estimated_rad=np.radians(64.21),
            sigma_rad=np.radians(0.08),
        )  # fmt: skip
    diagnostics = TriadDiagnostics(
        kind="magnetometer", triads={"magnetometer": record}, dip=dip,
        trials=(
            TriadTrial(model="hard-iron", chosen=False, holdout_rms=0.041, parameters=4),
            TriadTrial(model="full", chosen=True, holdout_rms=0.0084, parameters=9),
        ),
    )  # fmt: skip
    imu = ImuCalibration(accelerometer=ACCELEROMETER if accelerometer else None, magnetometer=MAGNETOMETER)
    made = calibration(
        imu, method="magnetometer", frame="accel-x" if accelerometer else "mag-x", verdict=verdict, model="full",
        counts=(count, count - 40), holdout=Holdout(field_rms=0.0084), names=names, **changes,
    )  # fmt: skip
    return Result(calibration=made, diagnostics=diagnostics)


RESULTS = {
    "poses": lambda **changes: poses_result(gyroscope=False, **changes),
    "poses with gyroscope": poses_result,
    "turntable": turntable_result,
    "turntable with accelerometer": lambda **changes: turntable_result(accelerometer=True, **changes),
    "magnetometer": magnetometer_result,
    "magnetometer with accelerometer": lambda **changes: magnetometer_result(accelerometer=True, **changes),
}
"""Every kind of result, by a name for people."""
