"""One simulated recording of Krebs, section 5.1, calibrated: errors and sigmas of all of Table 4.1's constants.

What Krebs states of its simulation comes first: Table A.1, Tables 5.2 and 5.3, and appendix B.1.
"""

from dataclasses import field, replace
from typing import Literal

import numpy as np

from ..calibrate.camera_imu import calibrate_camera_imu
from ..errors import GnomonError
from ..frozen import field_names, value_class
from ..geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from ..models.forms import DIAGONAL, LOWER
from ..options import CameraImuOptions
from ..recording import Floats, ImuSamples, Recording, TriadSamples
from ..recording.samples import ImuNoise
from ..results.calibration import Calibration
from ..results.camera_diagnostics import CameraImuDiagnostics
from ..simulate.camera_imu import CameraImuSimulation, simulate_camera_imu
from ..simulate.camera_imu_rig import TABLE_A1, THESIS_NOISE, earth_rate_target
from ..simulate.scenarios.camera_imu import CameraImuScenario

GRAVITY = 9.80665
"""Magnitude of gravity [m/s^2], section 3.2.5."""


def _cam_imu() -> Floats:
    """B.2: q_cb is the identity, the camera looks along z; the only p_cb that suits B.1 and B.2 alike."""
    T = np.eye(4)
    T[:3, 3] = 0.103, -0.015, -0.010
    return T


def _board_gravity() -> Floats:
    """Gravity in the frame of an upright board that leans back by 3 deg: down is -y."""
    lean = np.radians(3.0)
    return GRAVITY * np.array([0.0, -np.cos(lean), -np.sin(lean)])


@value_class
class KrebsRig:
    """What is true of the simulated camera and IMU; the defaults are those of Krebs.

    accelerometer = S_a M_a f + b_a, gyroscope = S_g M_g C_bg' omega + B_g f + b_g (section 4.1.2).

    Attributes
    ----------
    T_cam_imu : (4, 4)
    M_a, M_g : (3,) elements yz, zy, zx [rad]
    S_a, S_g : (3,) scale factors
    B_g : (3, 3) [rad/s per m/s^2]
    C_bg : (3, 3) rotation from the gyroscope's frame to the body's: one degree about z
    gravity : (3,) in the board's frame [m/s^2]
    time_shift_s : d, t_imu - t_cam [s]; not stated
    b_a, b_g : initial biases of every axis [m/s^2], [rad/s]
    """

    T_cam_imu: Floats = field(default_factory=_cam_imu)
    M_a: Floats = field(default_factory=lambda: TABLE_A1["M_a"])
    M_g: Floats = field(default_factory=lambda: TABLE_A1["M_g"])
    S_a: Floats = field(default_factory=lambda: TABLE_A1["S_a"])
    S_g: Floats = field(default_factory=lambda: TABLE_A1["S_g"])
    B_g: Floats = field(default_factory=lambda: TABLE_A1["B_g"].reshape(3, 3))
    C_bg: Floats = field(default_factory=lambda: rotation_from_rotvec(TABLE_A1["q_bg"]))
    gravity: Floats = field(default_factory=_board_gravity)
    time_shift_s: float = 0.007
    b_a: float = 0.491
    b_g: float = 0.02


@value_class(eq=True)
class Group:
    """Parameters that Krebs gives one name.

    Attributes
    ----------
    name, symbol, unit : as they are shown
    elements : their names
    table_5_3 : sigma of one recording of 90 s, mean over the elements
    sigma : those of S1, S2 and S3 in Tables B.1 and B.2, element by element; empty where they are not stated
    mean_error : the same of the mean errors in Table B.1
    """

    name: str
    symbol: str
    unit: str
    elements: tuple[str, ...]
    table_5_3: float
    sigma: tuple[tuple[float, ...], ...] = ()
    mean_error: tuple[tuple[float, ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.elements)


_XYZ = ("x", "y", "z")
_LOWER = ("yz", "zy", "zx")
_NINE = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")

GROUPS = (
    Group(
        name="translation camera to IMU",
        symbol="p_cb",
        unit="m",
        elements=_XYZ,
        table_5_3=0.004160,
        sigma=((1.715e-3, 3.909e-3, 6.855e-3), (8.439e-4, 8.685e-4, 1.681e-3), (3.524e-4, 2.380e-4, 4.640e-4)),
        mean_error=(
            (-2.640e-5, -7.096e-5, -2.106e-2),
            (-3.203e-5, -3.667e-5, -1.998e-2),
            (-6.373e-5, 5.165e-5, -2.002e-2),
        ),
    ),
    Group(
        name="rotation camera to IMU",
        symbol="q_cb",
        unit="-",
        elements=("i", "j", "k"),
        table_5_3=0.001586,
        sigma=((3.506e-4, 6.904e-4, 4.429e-4), (5.241e-5, 1.118e-4, 9.359e-5), (1.612e-5, 1.532e-5, 1.724e-5)),
    ),
    Group(
        name="misalignment of the accelerometer",
        symbol="M_a",
        unit="rad",
        elements=_LOWER,
        table_5_3=0.001745,
        sigma=((2.220e-3, 1.999e-3, 1.016e-3), (2.983e-4, 4.456e-4, 2.899e-4), (6.955e-5, 2.142e-4, 8.108e-5)),
        mean_error=(
            (4.933e-5, -1.794e-4, -8.920e-5),
            (-4.392e-5, -1.424e-5, 4.878e-6),
            (-2.916e-6, -2.224e-5, -1.853e-5),
        ),
    ),
    Group(
        name="misalignment of the gyroscope",
        symbol="M_g",
        unit="rad",
        elements=_LOWER,
        table_5_3=0.002456,
        sigma=((4.352e-3, 4.557e-3, 2.307e-3), (4.973e-4, 6.707e-4, 6.393e-4), (8.878e-5, 2.081e-4, 1.910e-4)),
        mean_error=((1.406e-4, -5.781e-4, 1.800e-4), (4.549e-5, -6.838e-7, 7.626e-5), (8.030e-6, -1.330e-6, 5.325e-5)),
    ),
    Group(
        name="scale factors of the accelerometer",
        symbol="S_a",
        unit="-",
        elements=_XYZ,
        table_5_3=0.001593,
        sigma=((2.175e-3, 1.282e-3, 1.323e-3), (2.880e-4, 1.891e-4, 2.825e-4), (5.264e-5, 4.801e-5, 1.011e-4)),
        mean_error=((3.082e-5, 1.759e-4, 1.656e-4), (5.818e-6, 3.818e-5, -1.712e-5), (1.239e-5, 9.961e-6, 2.068e-6)),
    ),
    Group(
        name="scale factors of the gyroscope",
        symbol="S_g",
        unit="-",
        elements=_XYZ,
        table_5_3=0.003081,
        sigma=((5.061e-3, 3.003e-3, 1.180e-3), (8.903e-4, 6.824e-4, 2.260e-4), (2.335e-4, 1.842e-4, 7.708e-5)),
        mean_error=(
            (-2.435e-3, -5.218e-5, -6.492e-5),
            (2.377e-5, -2.862e-5, -5.151e-6),
            (1.640e-5, 1.089e-6, 2.678e-6),
        ),
    ),
    Group(
        name="acceleration's influence on the gyroscope",
        symbol="B_g",
        unit="rad/s per m/s^2",
        elements=_NINE,
        table_5_3=0.000211,
        sigma=(
            (2.357e-4, 1.048e-4, 2.225e-4, 2.368e-4, 8.755e-5, 2.015e-4, 2.992e-4, 1.530e-4, 3.577e-4),
            (2.839e-5, 1.684e-5, 2.931e-5, 3.308e-5, 1.224e-5, 2.747e-5, 7.070e-5, 3.131e-5, 6.558e-5),
            (1.532e-5, 7.556e-6, 1.354e-5, 9.953e-6, 4.148e-6, 6.748e-6, 2.636e-5, 6.608e-6, 1.627e-5),
        ),
        mean_error=(
            (4.356e-5, -1.078e-5, 3.741e-6, 1.183e-5, 6.443e-7, -5.317e-6, 3.158e-5, -2.035e-6, -6.410e-6),
            (-1.708e-7, -1.004e-6, 8.672e-7, 4.224e-8, 4.529e-7, -4.546e-6, 5.624e-6, -1.810e-7, 2.192e-6),
            (3.288e-6, 5.578e-6, 2.679e-6, -3.217e-6, -3.465e-7, -1.635e-6, 9.451e-6, 3.289e-6, 3.214e-6),
        ),
    ),
    Group(
        name="rotation accelerometer to gyroscope",
        symbol="q_bg",
        unit="-",
        elements=("i", "j", "k"),
        table_5_3=0.000658,
        sigma=((9.092e-4, 8.173e-4, 8.993e-4), (1.869e-4, 2.088e-4, 1.228e-4), (3.880e-5, 7.000e-5, 3.561e-5)),
    ),
    Group(name="gravity", symbol="g_w", unit="m/s^2", elements=_XYZ, table_5_3=0.014348),
    Group(name="time offset of the camera", symbol="d", unit="s", elements=("",), table_5_3=0.000144),
)
"""In the order in which a study's numbers stand; of rotations the vector part of the quaternion of the error."""

NAMES = tuple(f"{group.symbol} {element}".strip() for group in GROUPS for element in group.elements)
UNITS = tuple(group.unit for group in GROUPS for _ in group.elements)


def group_columns(symbol: str) -> slice:
    """Return where a group stands among NAMES."""
    first = 0
    for group in GROUPS:
        if group.symbol == symbol:
            return slice(first, first + group.size)
        first += group.size
    raise KeyError(symbol)


def stated_sigma(series: int) -> Floats:
    """Return the sigmas of Tables B.1 and B.2 of a series, 0 to 2, in the order of NAMES; nan where there is none."""
    return np.concatenate([group.sigma[series] if group.sigma else np.full(group.size, np.nan) for group in GROUPS])


def stated_mean(series: int) -> Floats:
    """Return the mean errors of Table B.1 of a series, in the order of NAMES; nan where there is none."""
    return np.concatenate(
        [group.mean_error[series] if group.mean_error else np.full(group.size, np.nan) for group in GROUPS]
    )


SCENARIO = CameraImuScenario(
    duration_s=90.0,
    motion="gentle",
    target_type="checkerboard",
    target_cols=7,
    target_rows=6,
    target_size_m=0.06,
    earth_rate_latitude=47.4,
    imu="ideal",
    accelerometer_noise_density=THESIS_NOISE.accelerometer_noise_density,
    accelerometer_random_walk=THESIS_NOISE.accelerometer_random_walk,
    gyroscope_noise_density=THESIS_NOISE.gyroscope_noise_density,
    gyroscope_random_walk=THESIS_NOISE.gyroscope_random_walk,
    trajectory_seed=0,
)
"""One motion for all runs, as in Krebs; board, frame rate and pixel noise are not stated there."""

OPTIONS = CameraImuOptions(
    gravity=GRAVITY,
    model="full",
    free=("gravity.magnitude",),
    noise="nominal",
    covariance="ordinary",
    robust=False,
    knots_per_s=25.0,
)
"""Krebs's estimate: known weights, all of Table 4.1 with gravity's three elements; motion up to 2 Hz."""

PIXEL_NOISE_PX = SCENARIO.pixel_noise_px
NO_PIXEL_NOISE_PX = PIXEL_NOISE_PX / 100
"""By which corners without noise are weighed, beside an IMU of noise factor 1: next to nothing."""

Model = Literal["full", "basic"]

_NEGLIGIBLE = 1e-12

CHANGES = {
    **{"p_cb": 0.02, "q_cb": 0.02, "M_a": 0.01, "M_g": 0.01, "S_a": 0.01, "S_g": 0.01},
    **{"B_g": 1e-3, "q_bg": 0.02, "g_w": 0.01, "d": 0.02},
}
"""By how much one element of each group is changed, in its unit."""


@value_class(eq=True)
class KrebsTask:
    """What to simulate and with which model to calibrate it.

    Attributes
    ----------
    seed : of the noise
    duration_s, camera_rate_hz, gyroscope_random_walk : as in the scenario
    noise_factor : multiplies noise and walk of the IMU
    pixel_noise_px : standard deviation of a corner, per axis
    earth_rate : whether the Earth turns in the simulation; it does not in the model
    model : extended (full) or basic
    gravity_known : whether gravity's magnitude is known, and only its direction estimated
    weighed_as : noise factor by which a recording without noise is weighed
    changed : parameter of `NAMES` that is changed as `CHANGES` says; "" for none
    """

    seed: int = 0
    duration_s: float = SCENARIO.duration_s
    camera_rate_hz: float = SCENARIO.camera_rate_hz
    gyroscope_random_walk: float | None = SCENARIO.gyroscope_random_walk
    noise_factor: float = 1.0
    pixel_noise_px: float = PIXEL_NOISE_PX
    earth_rate: bool = True
    model: Model = "full"
    gravity_known: bool = False
    weighed_as: float = 1.0
    changed: str = ""


@value_class
class KrebsRun:
    """What became of it; in the order of `NAMES`, nan where the model does not estimate something.

    Attributes
    ----------
    error : (34,) estimate minus truth
    sigma : (34,) as predicted
    nees : squared error in units of the predicted covariance, all elements together
    iterations : of the batch estimation
    converged : whether it came to rest
    failure : why there is no result; "" where there is one
    """

    error: Floats
    sigma: Floats
    nees: float
    iterations: int
    converged: bool
    failure: str = ""


def run_krebs(task: KrebsTask) -> KrebsRun:
    """Simulate one recording and calibrate it; errors are those against what is true of the rig, changed or not."""
    scenario = replace(
        SCENARIO,
        duration_s=task.duration_s,
        camera_rate_hz=task.camera_rate_hz,
        gyroscope_random_walk=task.gyroscope_random_walk,
        noise_factor=task.noise_factor,
        pixel_noise_px=task.pixel_noise_px,
        earth_rate_latitude=SCENARIO.earth_rate_latitude if task.earth_rate else None,
    )
    unseen_px = NO_PIXEL_NOISE_PX * task.noise_factor or PIXEL_NOISE_PX
    options = replace(
        OPTIONS,
        model=task.model,
        pixel_sigma=task.pixel_noise_px or unseen_px,
        free=() if task.gravity_known else OPTIONS.free,
    )
    rig = change_parameter(KrebsRig(), task.changed) if task.changed else KrebsRig()
    return calibrated_run(simulate_camera_imu(scenario, task.seed), rig, options, task.weighed_as)


def change_parameter(rig: KrebsRig, name: str) -> KrebsRig:
    """Return the rig with one parameter of `NAMES` changed as `CHANGES` says."""
    step = np.zeros(len(NAMES))
    step[NAMES.index(name)] = CHANGES[name.split(maxsplit=1)[0]]

    def part(symbol: str) -> Floats:
        return step[group_columns(symbol)]

    T_cam_imu = rig.T_cam_imu.copy()
    T_cam_imu[:3, 3] += part("p_cb")
    T_cam_imu[:3, :3] = T_cam_imu[:3, :3] @ rotation_from_rotvec(2 * part("q_cb"))
    return KrebsRig(
        T_cam_imu=T_cam_imu,
        M_a=rig.M_a + part("M_a"),
        M_g=rig.M_g + part("M_g"),
        S_a=rig.S_a + part("S_a"),
        S_g=rig.S_g + part("S_g"),
        B_g=rig.B_g + part("B_g").reshape(3, 3),
        C_bg=rig.C_bg @ rotation_from_rotvec(2 * part("q_bg")),
        gravity=rig.gravity + part("g_w"),
        time_shift_s=rig.time_shift_s + float(part("d")[0]),
    )


def calibrated_run(
    simulation: CameraImuSimulation, rig: KrebsRig, options: CameraImuOptions, weighed_as: float = 1.0
) -> KrebsRun:
    """Calibrate what a rig records of a simulated motion; see `sense_motion`."""
    try:
        result = calibrate_camera_imu(sense_motion(simulation, rig, weighed_as), simulation.target, options)
    except GnomonError as error:
        nothing = np.full(len(NAMES), np.nan)
        return KrebsRun(
            error=nothing, sigma=nothing, nees=float("nan"), iterations=0, converged=False, failure=str(error)
        )
    assert isinstance(result.diagnostics, CameraImuDiagnostics)
    return against_truth(result.calibration, result.diagnostics, rig)


def sense_motion(simulation: CameraImuSimulation, rig: KrebsRig, weighed_as: float = 1.0) -> Recording:
    """Return the recording that a rig would have made of the motion of a simulation with an ideal IMU.

    Noise and walks are those of the simulation: what its ideal sensors show beside the motion. A simulation without
    noise is weighed by the noise of Table A.1 times `weighed_as`.
    """
    recording, trajectory = simulation.recording, simulation.trajectory
    imu, frames = recording.imus["imu0"], recording.cameras["cam0"]
    f, omega = _felt(simulation, rig)
    S_a = DIAGONAL.matrix(rig.S_a) @ LOWER.matrix(rig.M_a)
    S_g = DIAGONAL.matrix(rig.S_g) @ LOWER.matrix(rig.M_g) @ rig.C_bg.T
    force = f @ S_a.T + rig.b_a + (imu.accelerometer.values - trajectory.f_imu)
    rate = omega @ S_g.T + f @ rig.B_g.T + rig.b_g + (imu.gyroscope.values - trajectory.omega_imu)
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=imu.accelerometer.t_ns, values=force, unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=imu.gyroscope.t_ns, values=rate, unit="rad/s"),
        noise=imu.noise
        if simulation.scenario.noise_factor
        else ImuNoise(**{name: weighed_as * getattr(THESIS_NOISE, name) for name in field_names(ImuNoise)}),
    )
    later_ns = round((simulation.scenario.time_shift_s - rig.time_shift_s) * 1e9)
    moved = replace(frames, t_ns=frames.t_ns + later_ns)
    return replace(recording, imus={"imu0": samples}, cameras={"cam0": moved})


def _felt(simulation: CameraImuSimulation, rig: KrebsRig) -> tuple[Floats, Floats]:
    """Return specific force [m/s^2] and angular rate [rad/s] of the rig's body, each (n, 3)."""
    motion = simulation.trajectory.path.at(simulation.trajectory.t_s).of(rig.T_cam_imu)
    earth, R = earth_rate_target(simulation.scenario), motion.R_target_body
    acceleration = motion.acceleration + 2 * np.cross(earth, motion.velocity) - rig.gravity
    return np.einsum("nji,nj->ni", R, acceleration), motion.omega + earth @ R


def against_truth(calibration: Calibration, diagnostics: CameraImuDiagnostics, rig: KrebsRig) -> KrebsRun:
    """Return errors and sigmas of a result."""
    values, sigmas = dict[str, float](), dict[str, float]()
    for parameter in diagnostics.parameters:
        values[parameter.name] = parameter.value
        if parameter.status in ("estimated", "prior"):
            sigmas[parameter.name] = parameter.sigma
    free = list(sigmas)
    covariance = diagnostics.correlation * np.outer(list(sigmas.values()), list(sigmas.values()))
    error = np.full(len(NAMES), np.nan)
    by_free = np.zeros((len(NAMES), len(free)))

    def put(symbol: str, block: str, difference: Floats, factor: float = 1.0) -> None:
        place = group_columns(symbol)
        names = [f"{block}[{k}]" if place.stop - place.start > 1 else block for k in range(place.stop - place.start)]
        if all(name in sigmas for name in names):
            error[place] = factor * difference
            by_free[range(place.start, place.stop), [free.index(name) for name in names]] = factor

    def numbers(block: str, count: int) -> Floats:
        return np.array([values[f"{block}[{k}]"] for k in range(count)])

    T = calibration.cameras["cam0"].T_cam_imu
    put("p_cb", "cam0.T_cam_imu.translation", T[:3, 3] - rig.T_cam_imu[:3, 3])
    put("q_cb", "cam0.T_cam_imu.rotation", rotvec_from_rotation(rig.T_cam_imu[:3, :3].T @ T[:3, :3]), 0.5)
    for name in ("M_a", "M_g", "S_a", "S_g"):
        put(name, f"imu0.{name}", numbers(f"imu0.{name}", 3) - getattr(rig, name))
    put("B_g", "imu0.B_g", numbers("imu0.B_g", 9) - rig.B_g.ravel())
    C_bg = rotation_from_rotvec(numbers("imu0.q_bg", 3))
    put("q_bg", "imu0.q_bg", rotvec_from_rotation(rig.C_bg.T @ C_bg), 0.5)
    put("d", "cam0.time_shift_cam_imu", np.array([values["cam0.time_shift_cam_imu"] - rig.time_shift_s]))
    gravity, by_gravity = _gravity(diagnostics, free)
    error[group_columns("g_w")] = gravity - rig.gravity
    by_free[group_columns("g_w")] = by_gravity
    fit = calibration.assessment.camera_imu
    return _told(
        error,
        by_free @ covariance @ by_free.T,
        iterations=len(diagnostics.steps),
        converged=fit is not None and fit.converged,
    )


def _gravity(diagnostics: CameraImuDiagnostics, free: list[str]) -> tuple[Floats, Floats]:
    """Return gravity in the board's frame (3,) [m/s^2] and its derivative by the free scalars."""
    gravity, plane = diagnostics.gravity_target, diagnostics.gravity_plane
    size = float(np.linalg.norm(gravity))
    by_free = np.zeros((3, len(free)))
    for k in range(2):
        by_free[:, free.index(f"gravity.direction[{k}]")] = size * plane[:, k]
    if "gravity.magnitude" in free:
        by_free[:, free.index("gravity.magnitude")] = gravity / size
    return gravity, by_free


def _told(error: Floats, covariance: Floats, *, iterations: int, converged: bool) -> KrebsRun:
    sigma = np.sqrt(np.diag(covariance))
    told = np.flatnonzero(sigma > 0)
    z, correlation = error[told] / sigma[told], covariance[np.ix_(told, told)] / np.outer(sigma[told], sigma[told])
    # gravity of known magnitude has three elements, and two degrees of freedom
    inverse = np.linalg.pinv(correlation, rcond=_NEGLIGIBLE, hermitian=True)
    return KrebsRun(
        error=error,
        sigma=np.where(sigma > 0, sigma, np.nan),
        nees=float(z @ inverse @ z),
        iterations=iterations,
        converged=converged,
    )
