"""What a recording would tell that nobody has made yet, whether that is enough, and what would help most.

plan -> predicted calibration -> weak directions -> judge -> the same with one thing changed -> advice

What a planned multi-position recording would tell: the fit's own normal equations at the truth, no noise drawn.

plan -> exact samples and rests -> problem with the stated noise -> linearise once -> what it would publish
"""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike

import numpy as np

from ..assess.checks.imu_checks import find_imu_rests
from ..assess.needs import judge_for_use, needs_of_use
from ..assess.observability import HELD, known_of, weak_directions, weak_findings
from ..assess.verdict import with_verdict
from ..detect.samples.rests import Rests
from ..errors import GnomonError, SolveError
from ..estimate.multiposition.problem import MultiPositionProblem, TriadStream, build_problem
from ..formats.kalibr.camchain import CameraInput
from ..formats.kalibr.target import read_target
from ..formats.sensor_inputs import read_cameras, read_imus
from ..frozen import value_class
from ..models.gravity import EARTH_RATE_RAD_S
from ..models.target import Target
from ..options import ImuOptions
from ..options.requirements import GENERAL_IMU, GENERAL_RIG, Use
from ..progress import Progress, Step
from ..recording import Floats, ImuSamples, TriadSamples
from ..recording.samples import ImuNoise, consumer_mems
from ..results.calibration import Calibration, Provenance
from ..results.result import interval_means
from ..results.sensors import CameraCalibration
from ..results.trust import Need, WeakDirection
from ..simulate.planned import CameraImuPlan, ImuPlan, PlannedRig, planned_rests, usual_rig
from ..simulate.sensor import changed_options
from .judging import stated_use
from .predicted import nominal_fit, planned_camera_imu, predicted_calibration
from .steps.preparation import local_gravity


def planned_imu(plan: ImuPlan, noise: ImuNoise, seed: int = 0) -> Calibration:
    """Return the calibration that a planned recording would give of an ideal IMU, with its covariance.

    Parameters
    ----------
    plan : see there
    noise : of the IMU
    seed : of the attitudes

    Raises
    ------
    SolveError
        If such attitudes determine no calibration.
    """
    gravity = local_gravity(ImuOptions(gravity=plan.gravity, latitude=plan.latitude))
    problem, up, rests = _planned_problem(plan, noise, gravity.value, seed)
    walk = (noise.gyroscope_random_walk / problem.gyroscope.spread) ** 2
    fit = nominal_fit(problem, up, walk, g_sensitivity=plan.model == "g-sensitivity")
    return predicted_calibration(
        fit,
        problem,
        gravity,
        units={"accelerometer": "m/s^2", "gyroscope": "rad/s"},
        latitude=plan.latitude,
        found=len(rests),
        provenance=Provenance(method="plan", options=changed_options(plan), seed=seed),
    )


def _planned_problem(
    plan: ImuPlan, noise: ImuNoise, gravity_m_s2: float, seed: int
) -> tuple[MultiPositionProblem, Floats, Rests]:
    """Return the problem of exact samples with the stated noise, the specific force (n, 3) of each rest, and the rests.

    The rests are those that a calibration would find in the samples with their noise.
    """
    planned = planned_rests(plan, gravity_m_s2, seed)
    rng = np.random.default_rng(seed)
    t_ns = np.rint(1e9 * planned.t_s).astype(np.int64)

    def noisy(exact: Floats, density: float, unit: str) -> TriadSamples:
        """Return samples (n, 3) with white noise of a density."""
        drawn = density * plan.rate_hz**0.5 * rng.normal(size=exact.shape)
        return TriadSamples(t_ns=t_ns, values=exact + drawn, unit=unit)

    samples = ImuSamples(
        accelerometer=noisy(planned.f_imu, noise.accelerometer_noise_density, "m/s^2"),
        gyroscope=noisy(planned.omega_imu, noise.gyroscope_noise_density, "rad/s"),
    )
    found = find_imu_rests(samples, gravity_m_s2=gravity_m_s2)
    rests = Rests.none() if found is None else found.chosen.rests
    still = rests.intervals
    if len(still) < 2:
        raise SolveError(f"{len(still)} of {plan.intervals} rests would be found. Plan longer ones (--hold-s).")

    def stream(values: Floats, density: float) -> TriadStream:
        """Return exact samples (n, 3) with white noise of a density."""
        return TriadStream(
            t_s=planned.t_s,
            values=values,
            saturated=np.zeros(len(values), dtype=bool),
            rate_hz=plan.rate_hz,
            density=np.full(3, density**2),
            density_in_motion=np.full(3, density**2),
            rounding=np.zeros((len(still), 3)),
            intervals=still,
        )

    cosine_squared = 2 / 3 if plan.latitude is None else float(np.cos(np.radians(plan.latitude)) ** 2)
    problem = build_problem(
        stream(planned.f_imu, noise.accelerometer_noise_density),
        stream(planned.omega_imu, noise.gyroscope_noise_density),
        EARTH_RATE_RAD_S**2 * cosine_squared / 2,
    )
    return problem, interval_means(planned.f_imu, still), rests


_USUAL_RATE_HZ = 200.0


@value_class
class PlannedHardware:
    """What the recording would be made with.

    Attributes
    ----------
    cameras : by name
    target : the board
    noise : of the IMU
    imu_rate_hz : its sample rate [Hz]
    others : names of IMUs beside the first one, which are not planned
    """

    cameras: Mapping[str, CameraCalibration]
    target: Target
    noise: ImuNoise
    imu_rate_hz: float
    others: tuple[str, ...] = ()


@value_class(eq=True)
class Change:
    """A plan with one thing changed.

    Attributes
    ----------
    words : what is changed
    worst : largest standard deviation over what is needed of it
    before : the same without the change
    """

    words: str
    worst: float
    before: float


@value_class
class PlanResult:
    """What a planned recording would tell.

    Attributes
    ----------
    calibration : with the covariance that it would have, judged; its values are those of the rig
    needs : what the use needs, or general use where none was stated
    weak : directions that it would hardly determine
    changes : what would help, most first
    """

    calibration: Calibration
    needs: tuple[Need, ...]
    weak: tuple[WeakDirection, ...]
    changes: tuple[Change, ...]


def read_hardware(
    cam: str | PathLike[str] | None = None,
    target: str | PathLike[str] | None = None,
    imu: str | PathLike[str] | None = None,
) -> PlannedHardware:
    """Read what a recording would be made with; what is not named is that of `gnomon simulate camera-imu`.

    Parameters
    ----------
    cam : camchain.yaml, calibration.yaml, or what else describes cameras
    target : target.yaml
    imu : imu.yaml, of which the first IMU is planned

    Raises
    ------
    FormatError
        If a file cannot be read.
    """
    usual = usual_rig()
    cameras = dict(usual.cameras)
    if cam is not None:
        first = next(iter(usual.cameras.values()))
        cameras = {
            name: CameraCalibration(
                T_cam_body=_place(found, first.T_cam_imu),
                time_shift_cam_imu=found.time_shift_cam_imu_s or 0.0,
                camera=found.camera,
            )
            for name, found in read_cameras(cam).items()
        }
    noise, rate_hz, others = consumer_mems(), None, ()
    if imu is not None:
        imus = read_imus(imu)
        first, *others = imus
        noise, rate_hz = imus[first].noise, imus[first].update_rate_hz
    return PlannedHardware(
        cameras=cameras,
        target=usual.target if target is None else read_target(target),
        noise=noise,
        imu_rate_hz=rate_hz or _USUAL_RATE_HZ,
        others=tuple(others),
    )


def _place(camera: CameraInput, first: Floats) -> Floats:
    """Return T_cam_imu (4, 4) as it is stated, else by the pose to cam0, of which `first` is the usual T_cam_imu."""
    if camera.T_cam_imu is not None:
        return camera.T_cam_imu
    return first if camera.T_cam_cam0 is None else camera.T_cam_cam0 @ first


def plan(
    what: CameraImuPlan | ImuPlan,
    hardware: PlannedHardware | None = None,
    use: str | PathLike[str] | Use | None = None,
    *,
    seed: int = 0,
    changes: bool = True,
    progress: Progress | None = None,
) -> PlanResult:
    """Predict the standard deviations that a recording would reach, by the estimation's own normal equations.

    Parameters
    ----------
    what : how it is to be recorded
    hardware : what with; see `gnomon.read_hardware`
    use : what it is for, as for `gnomon.judge`; general use where not stated
    seed : of the path, of which only kind and size are planned
    changes : whether to try what would help
    progress : called with a sentence at each step

    Raises
    ------
    OptionError
        If there is no such use, or the board would hardly be seen.
    SolveError
        If such a recording determines no calibration at all.

    Examples
    --------
    >>> import gnomon
    >>> found = gnomon.plan(gnomon.ImuPlan(intervals=30), use="ahrs", changes=False)
    >>> [need.block for need in found.needs][:2]
    ['gyroscope scale', 'gyroscope axes']
    """
    tell = progress or (lambda _: None)
    hardware = hardware or read_hardware()
    wanted = None if use is None else stated_use(use)
    tell("predicting the recording as planned")
    bare, weak = _predicted(what, hardware, seed)
    calibration = judge_for_use(bare, wanted)
    asked = wanted or (GENERAL_IMU if isinstance(what, ImuPlan) else GENERAL_RIG)
    before = _worst(bare, asked)
    found: list[Change] = []
    others = list(_changed(what)) if changes else []
    for done, (words, other) in enumerate(others):
        tell(Step("predicting what would help", done, len(others)))
        try:
            after = _worst(_predicted(other, hardware, seed)[0], asked)
        except GnomonError:  # the board would leave the image
            continue
        found.append(Change(words=words, worst=after, before=before))
    return PlanResult(
        calibration=calibration,
        needs=needs_of_use(bare, asked),
        weak=weak,
        changes=tuple(sorted((change for change in found if change.worst < before), key=lambda change: change.worst)),
    )


def _predicted(
    what: CameraImuPlan | ImuPlan, hardware: PlannedHardware, seed: int
) -> tuple[Calibration, tuple[WeakDirection, ...]]:
    """Return a predicted calibration with its findings, and its weak directions."""
    if isinstance(what, ImuPlan):
        found = planned_imu(what, hardware.noise, seed)
    else:
        rig = PlannedRig(cameras=hardware.cameras, target=hardware.target)
        found = planned_camera_imu(what, rig, hardware.noise, what.imu_rate_hz or hardware.imu_rate_hz, seed)
    duration_s = what.duration_s if isinstance(what, CameraImuPlan) else float("nan")
    known = known_of(found.imus, found.cameras, found.uncertainty.matrix, duration_s=duration_s)
    weak = weak_directions(known)
    sigma = np.sqrt(np.diag(known.covariance))
    held = tuple(
        name for name, size, prior in zip(known.names, sigma, known.prior_sigma, strict=True) if size > HELD * prior
    )
    findings = weak_findings(weak, with_camera=bool(found.cameras))
    return replace(found, assessment=with_verdict(replace(found.assessment, held_by_prior=held), findings)), weak


def _worst(calibration: Calibration, use: Use) -> float:
    return max((need.sigma / need.needed for need in needs_of_use(calibration, use)), default=0.0)


def _changed(what: CameraImuPlan | ImuPlan) -> list[tuple[str, CameraImuPlan | ImuPlan]]:
    """Return plans with one thing changed, and what that is."""
    if isinstance(what, ImuPlan):
        return [
            (f"twice as many attitudes, {2 * what.intervals}", replace(what, intervals=min(2 * what.intervals, 1000))),
            (f"twice as long rests, {2 * what.hold_s:g} s", replace(what, hold_s=2 * what.hold_s)),
            (f"a first rest twice as long, {2 * what.t_init_s:g} s", replace(what, t_init_s=2 * what.t_init_s)),
            (f"faster turns, {what.motion_s / 1.5:.2g} s each", replace(what, motion_s=what.motion_s / 1.5)),
            *([("every attitude over the sphere", replace(what, attitudes="sphere"))] * (what.attitudes != "sphere")),
        ]
    changes: list[tuple[str, CameraImuPlan | ImuPlan]] = [
        (f"twice as long, {2 * what.duration_s:g} s", replace(what, duration_s=min(2 * what.duration_s, 3600.0))),
        (f"nearer to the board, {what.distance_m / 1.5:.2g} m", replace(what, distance_m=what.distance_m / 1.5)),
        ("turned 1.5 times as briskly", replace(what, turning=1.5 * what.turning)),
        ("moved 1.5 times as strongly to and fro", replace(what, shaking=1.5 * what.shaking)),
    ]
    if what.motion not in ("gentle", "normal", "tremor", "shaky", "rolling"):
        changes.append(
            ("waved by hand, turned and moved along all axes (motion normal)", replace(what, motion="normal"))
        )
    if set(what.turn_axes) != set("xyz"):
        changes.append(("turned about all three axes", replace(what, turn_axes="xyz")))
    return changes
