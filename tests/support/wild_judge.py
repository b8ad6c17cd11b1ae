"""Whether wild cases converge or are refused in words, and are never answered confidently and wrongly.

Everything by which a case is judged is in this file.
"""

import signal
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from gnomon.calibrate.camera_imu import calibrate_camera_imu
from gnomon.calibrate.imu import calibrate_imu
from gnomon.errors import GnomonError
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.models.gravity import EARTH_RATE_RAD_S
from gnomon.options import CameraImuOptions, ImuOptions
from gnomon.recording import Floats
from gnomon.results.calibration import Calibration, Verdict
from gnomon.results.moved import moved_to_origin
from gnomon.results.sensors import calibration_parameters, element_names
from gnomon.study.runs import HERE, Progress, Workers, carry_out

from .wild import WildCase, WildKind
from .wild_imu import wild_imu
from .wild_rig import wild_rig

Outcome = Literal["right", "refused", "failed", "named", "bad"]

MOST_SIGMAS = 6.0
RARE = 1e-6
CPU_LIMIT_S = 60.0

GENERAL = (
    *("parts-disagree", "not-observable", "not-converged", "holdout-accelerometer", "holdout-rotation"),
    "reprojection",
)
"""Findings that say, whatever the reason, that true errors are larger than the sigmas."""

OF_ROTATIONS = {
    *("jitter", "time-repeated", "time-backward", "time-base-stated", "triads-apart", "clocks-apart"),
    "holdout-rotation",
}
"""Findings that do not excuse the accelerometer of an IMU alone, which is calibrated from rests."""

PUBLISHED_FORMS = {"sensitivity": 0.05, "bias": 0.5}
"""What a preset may be off by beyond its sigmas: relative to the sensitivity; in m/s^2 and, a tenth of it, in rad/s.

A preset repeats what its document did, and says with each result that its sigmas are lower bounds.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What became of a case.

    Attributes
    ----------
    outcome : right: errors as published; refused in words; failed: the verdict says do not use; named: wrong, and a
        warning names it; bad: anything else
    verdict : of the calibration, "" where there was none
    why : of a bad case what is wrong; of a refused one the message
    worst : scalar with the largest error in units of its sigma
    z : that error
    said : codes of the warnings and problems
    odd : what was odd about the case
    cpu_s : time that the calibration took
    """

    kind: WildKind
    seed: int
    outcome: Outcome
    verdict: Verdict | Literal[""]
    why: str
    worst: str
    z: float
    said: tuple[str, ...]
    odd: tuple[str, ...]
    cpu_s: float


class _TooLong(BaseException):
    """The calibration took more time than it may."""


def wild_case(kind: WildKind, seed: int) -> WildCase:
    """Return a wild case."""
    return wild_imu(seed) if kind == "imu" else wild_rig(seed)


def judged(task: tuple[WildKind, int]) -> Judgement:
    """Calibrate a wild case and judge what is said of it."""
    return judge(wild_case(*task))


def judge(case: WildCase) -> Judgement:
    """Calibrate a case and judge what is said of it."""
    began = time.process_time()
    calibration, outcome, why, verdict = None, "right", "", ""
    try:
        calibration = _in_time(lambda: _calibrated(case))
    except GnomonError as refused:
        outcome, why = "refused", f"{type(refused).__name__}: {refused}"
    except _TooLong:
        outcome, why = "bad", "took too long: " + traceback.format_exc(limit=-6)
    except Exception:
        outcome, why = "bad", traceback.format_exc(limit=-6)
    worst, z, said = "", 0.0, tuple[str, ...]()
    if calibration is not None:
        verdict = calibration.verdict
        said = tuple(f.code for f in calibration.assessment.findings if f.severity in {"warning", "problem"})
        outcome, why, worst, z = _weighed(case, calibration, said)
    return Judgement(
        kind=case.kind,
        seed=case.seed,
        outcome=outcome,
        verdict=verdict,
        why=why,
        worst=worst,
        z=z,
        said=said,
        odd=tuple(oddity.name for oddity in case.oddities),
        cpu_s=time.process_time() - began,
    )


def _calibrated(case: WildCase) -> Calibration:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if isinstance(case.options, CameraImuOptions):
            assert case.target is not None
            return calibrate_camera_imu(case.recording, case.target, case.options).calibration
        return calibrate_imu(case.recording, case.options).calibration


def _in_time(work: Callable[[], Calibration]) -> Calibration:
    def stop(_number: int, _frame: FrameType | None) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, CPU_LIMIT_S)
    try:
        return work()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _weighed(case: WildCase, calibration: Calibration, said: Sequence[str]) -> tuple[Outcome, str, str, float]:
    fit = calibration.assessment.camera_imu
    told = {finding.code for finding in calibration.assessment.findings}
    if fit is not None and not fit.converged and "not-converged" not in told:
        return "bad", "did not converge and does not say so", "", 0.0
    names, error, covariance = _errors(case, calibration)
    if not (np.isfinite(error).all() and np.isfinite(covariance).all()):
        return "bad", "not a number", "", 0.0
    error = _beyond_what_is_published(case, calibration, names, error)
    sigma = np.sqrt(np.diag(covariance))
    z = np.abs(error) / sigma
    k = int(np.argmax(z))
    worst = f"{names[k]} off by {error[k]:.3g}, sigma {sigma[k]:.2g}"
    # A bias that wandered is right anywhere where it has been; its distance then says nothing.
    stays = np.array([name.partition("[")[0] not in case.wandering for name in names])
    distance = _mahalanobis(error[stays], covariance[np.ix_(stays, stays)])
    limit = _rare_distance(int(stays.sum()), calibration.assessment.trust.clusters)
    if z[k] <= MOST_SIGMAS and distance <= limit:
        return "right", "", worst, float(z[k])
    why = worst if z[k] > MOST_SIGMAS else f"Mahalanobis distance {distance:.0f} > {limit:.0f}"
    if calibration.verdict == "fail":
        return "failed", why, worst, float(z[k])
    decisive = tuple(oddity for oddity in case.oddities if oddity.decisive)
    naming = {*GENERAL, *(code for oddity in decisive or case.oddities for code in oddity.codes)}
    if case.kind == "imu" and names[k].startswith("imu0.accelerometer"):
        naming -= OF_ROTATIONS
    if calibration.verdict == "warn" and naming & set(said):
        return "named", why, worst, float(z[k])
    return "bad", why, worst, float(z[k])


def _errors(case: WildCase, calibration: Calibration) -> tuple[list[str], Floats, Floats]:
    """Return names, errors and covariance of what is published with a sigma, body frame accel-x.

    What has no sigma is what a frame makes zero, what was not estimated, and what the person who calibrates states.
    """
    if calibration.frame == "accel-z":
        calibration = calibration.in_frame("accel-x")
    origins = {name: imu.origin for name, imu in calibration.imus.items() if imu.origin is not None}
    true = moved_to_origin(case.imus, case.cameras, origins)
    truth = dict(calibration_parameters(true.imus, true.cameras))
    difference: dict[str, float] = {}
    for path, found in calibration_parameters(calibration.imus, calibration.cameras):
        true = truth.get(path, np.zeros(found.shape))  # accelerometers without lever arms sit at one point
        if path.endswith("T_cam_imu.rotation"):
            error = rotvec_from_rotation(rotation_from_rotvec(true).T @ rotation_from_rotvec(found))
        elif found.ndim == 1 and len(found) > len(true):  # a lens with k3, where the true one has none
            error = found - np.pad(true, (0, len(found) - len(true)))
        else:
            error = found - true
        if path in case.wandering:
            moved = np.broadcast_to(case.wandering[path], found.shape)
            error = np.sign(error) * np.maximum(np.abs(error) - moved, 0.0)
        if path.endswith("g_sensitivity") and isinstance(case.options, ImuOptions):
            error = error + _taken_off(case.options, calibration, truth)
        difference |= zip(element_names(path, found.shape), error.ravel().tolist(), strict=True)
    names, covariance = calibration.uncertainty.names, calibration.uncertainty.matrix
    error = np.array([difference[name] for name in names])
    told = ~(np.diag(covariance) == 0) & ~_taken_from_the_unit(calibration)
    return [n for n, t in zip(names, told, strict=True) if t], error[told], covariance[np.ix_(told, told)]


def _taken_from_the_unit(calibration: Calibration) -> NDArray[np.bool_]:
    """Return which scalars (n,) are what the stated unit says, since rests do not show a gyroscope's scale.

    The result says so (`gyroscope-scale-assumed`), and a wrong unit cannot be told from rests by anybody.
    """
    names = calibration.uncertainty.names
    if not any(finding.code == "gyroscope-scale-assumed" for finding in calibration.assessment.findings):
        return np.zeros(len(names), dtype=bool)
    return np.array([name.startswith("imu0.gyroscope.sensitivity") for name in names])


def _taken_off(options: ImuOptions, calibration: Calibration, truth: Mapping[str, Floats]) -> Floats:
    """Return by how much more of the Earth's rate was taken off a g-sensitivity (3, 3) for a scale that was assumed."""
    if options.latitude is None or not _taken_from_the_unit(calibration).any():
        return np.zeros((3, 3))
    path = "imu0.gyroscope.sensitivity"
    assumed = dict(calibration_parameters(calibration.imus))[path] - truth[path]
    return assumed * EARTH_RATE_RAD_S * np.sin(np.radians(options.latitude)) / calibration.gravity.value


def _beyond_what_is_published(case: WildCase, calibration: Calibration, names: list[str], error: Floats) -> Floats:
    """Return errors less what a preset says that it may be off by."""
    if getattr(case.options, "preset", "gnomon") == "gnomon":
        return error
    allowed = np.zeros(len(names))
    truth = dict(calibration_parameters(case.imus))
    for i, name in enumerate(names):
        path = name.partition("[")[0]
        triad = path.rpartition(".")[0]
        unit = float(np.abs(truth[f"{triad}.sensitivity"]).max())
        kind = "bias" if path.endswith("bias") else "sensitivity"
        smaller = 0.1 if "gyroscope" in path and kind == "bias" else 1.0
        allowed[i] = PUBLISHED_FORMS[kind] * smaller * unit
    return np.sign(error) * np.maximum(np.abs(error) - allowed, 0.0)


def _rare_distance(scalars: int, clusters: int) -> float:
    """Return the squared distance that a correct result exceeds in one of a million cases.

    A covariance that comes from the scatter of some clusters is itself known no better than their number tells.
    """
    return float(scalars * f.isf(RARE, scalars, clusters - 1)) if clusters > 1 else float(chi2.isf(RARE, scalars))


def _mahalanobis(error: Floats, covariance: Floats) -> float:
    """Return the squared distance in units of the covariance, along what it tells with more than rounding."""
    sigma = np.sqrt(np.diag(covariance))
    values, axes = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    told = values > 1e-9 * values[-1]
    return float(np.sum((axes[:, told].T @ (error / sigma)) ** 2 / values[told]))


def study_wild(
    kinds: Sequence[WildKind], seeds: Sequence[int], *, workers: Workers = HERE, progress: Progress | None = None
) -> list[Judgement]:
    """Return a judgement for each kind and seed."""
    tasks: list[tuple[WildKind, int]] = [(kind, seed) for kind in kinds for seed in seeds]
    return carry_out(judged, tasks, workers=workers, progress=progress, name="case")


def table(judgements: Sequence[Judgement]) -> str:
    """Return how many cases of each kind came to which end."""
    rows = [f"{'kind':12}{'right':>8}{'refused':>9}{'failed':>8}{'named':>7}{'bad':>6}{'of':>7}"]
    for kind in dict.fromkeys(one.kind for one in judgements):
        ends = [one.outcome for one in judgements if one.kind == kind]
        counts = [ends.count(end) for end in ("right", "refused", "failed", "named", "bad")]
        rows.append("{:12}{:>8}{:>9}{:>8}{:>7}{:>6}{:>7}".format(kind, *counts, len(ends)))
    return "\n".join(rows)
