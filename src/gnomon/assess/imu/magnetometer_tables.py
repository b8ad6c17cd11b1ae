"""What a magnetometer's calibration was made of and how well it explains it, as tables for the report."""

import numpy as np

from ...estimate.triads.attitudes import DipFit, GravityFit
from ...estimate.triads.field_poses import FieldPoses, field_of
from ...estimate.triads.magnetometer import MagnetometerFit
from ...estimate.trust.parts import RobustCovariance
from ...frozen import value_class
from ...recording import Floats, TriadSamples
from ...results.calibration import Gravity
from ...results.result import Booleans
from ...results.sensor_diagnostics import DipTable, PoseTable, TriadDiagnostics, TriadRecord, TriadTrial
from ...results.sensors import ImuCalibration

_ROWS, _ATTITUDES = 400, 200
_STRAY = 6.0  # sigmas
_STRETCH_S, _GAP_S = 0.5, 1.0
_FEWEST_IN_STRETCH = 4
_MAD = 1.4826


@value_class
class FieldFitSummary:
    """Everything that a magnetometer's calibration was made of.

    Attributes
    ----------
    t_s, values, usable : samples, their instants [s], and whether they are not clipped
    unit : of the samples
    field : strength of the field as stated [uT], or None
    stated_dip_deg, latitude_deg : as stated [deg], or None
    poses, fit : what was fitted, and the fit
    rivals : model -> fit
    up, dip : the accelerometer along, and how the magnetometer stands to it; None where that cannot be told
    accelerometer : its samples, or None
    dip_sigma_rad : of the dip; nan without
    imu, covariance : the result, and its covariance
    gravity : as it was taken
    trust : how far the parameters can be trusted, in the magnetometer's own frame
    """

    t_s: Floats
    values: Floats
    usable: Booleans
    unit: str
    field: float | None
    stated_dip_deg: float | None
    latitude_deg: float | None
    poses: FieldPoses
    fit: MagnetometerFit
    rivals: dict[str, MagnetometerFit]
    up: GravityFit | None
    accelerometer: TriadSamples | None
    dip: DipFit | None
    dip_sigma_rad: float
    imu: ImuCalibration
    covariance: Floats
    gravity: Gravity
    trust: RobustCovariance

    @property
    def strength(self) -> float:
        """Strength of the field in the unit of the calibrated field."""
        return self.field or 1.0

    @property
    def direction(self) -> Floats:
        """(n, 3) unit vectors of the field in each pose, body frame."""
        aligned = self.imu.accelerometer is not None and self.dip is not None
        return self.fit.direction @ self.dip.rotation.T if aligned and self.dip is not None else self.fit.direction


@value_class
class FieldOutliers:
    """Samples far off the ellipsoid: stretches of time [s], (m, 2), and how many stand alone."""

    stretches: Floats
    single: int


def field_outliers(evidence: FieldFitSummary) -> FieldOutliers:
    """Return where the strength of the field was not that of the place."""
    fit, t_s = evidence.fit, evidence.t_s
    error = sample_errors(evidence)
    pull = np.linalg.inv(fit.iron.sensitivity)
    by_noise = float(np.max(np.sum(pull**2 * evidence.poses.noise**2, axis=1)))
    far = np.abs(error) > _STRAY * np.sqrt(by_noise + fit.iron.extra_sigma**2)
    for start, stop in zip(evidence.poses.start[~fit.used], evidence.poses.stop[~fit.used], strict=True):
        far[start:stop] = True
    far = np.flatnonzero(far & evidence.usable)
    if not len(far):
        return FieldOutliers(stretches=np.empty((0, 2)), single=0)
    breaks = np.flatnonzero(np.diff(t_s[far]) > _GAP_S)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(far) - 1]])
    count = last - first + 1
    long = (t_s[far[last]] - t_s[far[first]] >= _STRETCH_S) & (count >= _FEWEST_IN_STRETCH)
    return FieldOutliers(
        stretches=np.column_stack([t_s[far[first[long]]], t_s[far[last[long]]]]), single=int(count[~long].sum())
    )


def sample_errors(evidence: FieldFitSummary) -> Floats:
    """Return |x| less the strength of the field of every sample, (n,)."""
    iron = evidence.fit.iron
    return np.linalg.norm(field_of(evidence.values, iron.sensitivity, iron.bias), axis=1) - evidence.strength


def describe_field(evidence: FieldFitSummary) -> TriadDiagnostics:
    """Return the tables."""
    fit, poses = evidence.fit, evidence.poses
    field = evidence.strength
    error = sample_errors(evidence)[evidence.usable]
    triads = {
        "magnetometer": TriadRecord(
            quantity="magnetic field",
            unit=evidence.unit,
            si_unit="uT" if evidence.field is not None else "",
            poses=_table(evidence, fit.used, poses.measured, evidence.direction, field),
            noise_sigma=float(np.median(np.sqrt(np.maximum(fit.sigma**2 - fit.iron.extra**2, 0.0)))),
            extra_sigma=fit.iron.extra_sigma,
        )
    }
    return TriadDiagnostics(
        kind="magnetometer",
        triads=triads,
        gravity=evidence.gravity if evidence.up is not None else None,
        dip=_dips(evidence),
        trials=tuple(
            TriadTrial(
                model=name,
                chosen=one is fit,
                holdout_rms=one.holdout_rms,
                parameters=9 if name == "full" else 4,
            )
            for name, one in evidence.rivals.items()
        ),
        noise={
            "magnetometer.sample_sigma": float(np.sqrt(np.mean(poses.noise**2))),
            "magnetometer.error_std": float(np.std(error)) / field,
            "magnetometer.error_spread": _MAD * float(np.median(np.abs(error - np.median(error)))) / field,
            "magnetometer.block_s": fit.blocks.length_s,
            "magnetometer.sigma_factor": fit.sigma_factor,
        },
        trust=evidence.trust.trust,
    )


def _table(evidence: FieldFitSummary, used: Booleans, measured: Floats, direction: Floats, field: float) -> PoseTable:
    fit, poses = evidence.fit, evidence.poses
    some = np.arange(0, len(poses), max(1, -(-len(poses) // _ROWS)))
    length = np.linalg.norm(measured, axis=1)
    return PoseTable(
        name=tuple(str(i + 1) for i in some),
        start_s=evidence.t_s[poses.start[some]],
        stop_s=evidence.t_s[poses.stop[some] - 1],
        samples=poses.samples[some],
        measured=measured[some],
        magnitude=np.full(len(some), field),
        direction=direction[some],
        error_before=(length[some] / np.median(length[used]) - 1) * field,
        error_after=fit.error[some],
        error_holdout=fit.error_holdout[some],
        sigma=fit.sigma[some],
        used=used[some],
        reason=tuple("" if one else "the strength of the field differs here" for one in used[some]),
    )


def _dips(evidence: FieldFitSummary) -> DipTable | None:
    dip, up = evidence.dip, evidence.up
    if dip is None or up is None:
        return None
    quiet = np.flatnonzero(dip.weight > 0)
    quiet = np.sort(quiet[np.argsort(dip.sigma[quiet], kind="stable")][:_ATTITUDES])
    sines = np.clip(dip.sine + dip.error[quiet], -1, 1)
    return DipTable(
        attitude=quiet.astype(np.float64) + 1,
        dip_rad=-np.arcsin(sines),
        estimated_rad=dip.dip_rad,
        sigma_rad=evidence.dip_sigma_rad,
    )
