"""Single recordings of document B's simulation: one parameter at a time (section 5.1.1), and what it leaves open."""

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.rotation_vector import rotation_from_rotvec
from ..recording import Floats
from ..simulate.camera_imu import simulate_camera_imu
from .krebs_run import OPTIONS, PIXEL_NOISE_PX, SCENARIO, KrebsRun, calibrated_run
from .krebs_thesis import NAMES, KrebsRig, columns

CHANGES = {
    "p_cb": 0.02,
    "q_cb": 0.02,
    "M_a": 0.01,
    "M_g": 0.01,
    "S_a": 0.01,
    "S_g": 0.01,
    "B_g": 1e-3,
    "q_bg": 0.02,
    "g_w": 0.01,
    "d": 0.02,
}
"""By how much one element of each group is changed, in its unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeTask:
    """A recording without noise by document B's rig, in which one parameter of `NAMES` is changed, or "" none."""

    name: str
    duration_s: float
    seed: int


def run_changed(task: ChangeTask) -> KrebsRun:
    """Simulate and calibrate it; errors are those against what is true of the changed rig."""
    scenario = replace(SCENARIO, noise_factor=0.0, pixel_noise_px=0.0, duration_s=task.duration_s)
    simulation = simulate_camera_imu(scenario, task.seed)
    rig = changed(KrebsRig(), task.name) if task.name else KrebsRig()
    return calibrated_run(simulation, rig, replace(OPTIONS, pixel_sigma=PIXEL_NOISE_PX))


def changed(rig: KrebsRig, name: str) -> KrebsRig:
    """Return the rig with one parameter of `NAMES` changed as `CHANGES` says."""
    step = np.zeros(len(NAMES))
    step[NAMES.index(name)] = CHANGES[name.split(maxsplit=1)[0]]

    def part(symbol: str) -> Floats:
        return step[columns(symbol)]

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Independence:
    """What a change of one parameter does to the estimates.

    Attributes
    ----------
    moved : (34, 34) of the estimates, beyond what was changed: row by row the parameter that was changed
    sigma : (34,) of one recording at the noise of Table A.1
    """

    moved: Floats
    sigma: Floats

    @property
    def of_own(self) -> Floats:
        """Error of the changed parameter's own move, in sigmas, (34,)."""
        return np.diag(self.moved) / self.sigma

    @property
    def of_others(self) -> Floats:
        """Largest move of another parameter, in sigmas, (34,)."""
        share = np.abs(self.moved / self.sigma)
        np.fill_diagonal(share, 0.0)
        return share.max(axis=1)

    def moved_most(self, row: int) -> str:
        """Return which other parameter moves most where one is changed."""
        share = np.abs(self.moved[row] / self.sigma)
        share[row] = 0.0
        return NAMES[int(np.argmax(share))]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuietTask:
    """A recording without noise, weighed as at a noise level, with the Earth's rate or without it."""

    weighed_as: float
    earth_rate: bool
    duration_s: float
    seed: int


def run_quiet(task: QuietTask) -> KrebsRun:
    """Simulate and calibrate it: what is left are errors of the model."""
    scenario = replace(SCENARIO, noise_factor=0.0, pixel_noise_px=0.0, duration_s=task.duration_s)
    if not task.earth_rate:
        scenario = replace(scenario, earth_rate_latitude=None)
    simulation = simulate_camera_imu(scenario, task.seed)
    return calibrated_run(simulation, KrebsRig(), replace(OPTIONS, pixel_sigma=PIXEL_NOISE_PX), task.weighed_as)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """S1 with one thing changed that document B leaves open, or that can be read otherwise.

    Attributes
    ----------
    name : in words
    pixel_noise_px, camera_rate_hz, gyroscope_random_walk : as in the scenario
    gravity_held : whether gravity's magnitude is known, and only its direction estimated
    """

    name: str
    pixel_noise_px: float = PIXEL_NOISE_PX
    camera_rate_hz: float = SCENARIO.camera_rate_hz
    gyroscope_random_walk: float | None = SCENARIO.gyroscope_random_walk
    gravity_held: bool = False


SETTINGS = (
    Setting(name="as S1"),
    Setting(name="corners with 1 px of noise", pixel_noise_px=1.0),
    Setting(name="10 frames per second", camera_rate_hz=10.0),
    Setting(name="gyroscope walk 2·10⁻⁵ rad/s/√s, as consumer sensors have", gyroscope_random_walk=2e-5),
    Setting(name="magnitude of gravity known", gravity_held=True),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingTask:
    """One recording with a setting."""

    setting: Setting
    duration_s: float
    seed: int


def run_setting(task: SettingTask) -> KrebsRun:
    """Simulate and calibrate it."""
    setting = task.setting
    scenario = replace(
        SCENARIO,
        duration_s=task.duration_s,
        pixel_noise_px=setting.pixel_noise_px,
        camera_rate_hz=setting.camera_rate_hz,
        gyroscope_random_walk=setting.gyroscope_random_walk,
    )
    options = replace(OPTIONS, pixel_sigma=setting.pixel_noise_px, free=() if setting.gravity_held else OPTIONS.free)
    return calibrated_run(simulate_camera_imu(scenario, task.seed), KrebsRig(), options)
