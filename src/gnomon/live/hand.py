"""A simulated sensor in a simulated hand, which does what it is asked, about."""

from collections.abc import Iterator

import numpy as np

from ..geometry.rotations import normalise_quaternion, quaternion_product
from ..recording import Floats
from ..results.calibration import ImuCalibration
from ..results.moved import rotate_imu
from ..simulate.scenarios.recorded import Scenario
from ..simulate.sensor import drawn_imu
from ..simulate.trajectory import Motions, rotated_back, rotvec_quaternions

FIRST_REST_S = 22.0
_TURN_S, _HOLD_S = (1.2, 2.0), 2.6
_NOISE_RAD = np.radians(10.0)
_ALIKE = 0.2


class SimulatedHand:
    """Turns a sensor to where `target` points, with ten degrees of noise, and pays no attention one time in five.

    Parameters
    ----------
    seed : of the sensor and of the hand
    scenario : of the sensor

    Attributes
    ----------
    target : (3,) direction in the sensor that shall point up; None where anything will do
    hold_s : how long it lets the sensor rest after a turn
    truth : of the sensor, in body frame "accel-x"
    """

    def __init__(self, seed: int, scenario: Scenario | None = None) -> None:
        self._scenario = scenario or Scenario(rate_hz=200.0, g_sensitivity=3e-4)
        for_sensor, self._rng = np.random.default_rng(seed).spawn(2)
        drawn = drawn_imu(self._scenario, for_sensor)
        upright, lower = np.linalg.qr(drawn.required_accelerometer.sensitivity.T)
        self.truth: ImuCalibration = rotate_imu(drawn, (upright * np.sign(np.diag(lower))).T)
        self.target: Floats | None = None
        self.rate_hz, self.hold_s = self._scenario.rate_hz, _HOLD_S
        self._count = 0
        self._pose = np.array([1.0, 0.0, 0.0, 0.0])

    def sample_lines(self) -> Iterator[bytes]:
        """Yield the lines that the sensor sends, for ever."""
        yield from self._lines(self._still(), FIRST_REST_S)
        while True:
            turn_s = float(self._rng.uniform(*_TURN_S))
            turn = self._turn(turn_s)
            yield from self._lines(turn, turn_s + self.hold_s)
            self._pose = turn.q_after_wxyz[0]

    def _still(self) -> Motions:
        return self._motion(1e-3, self._pose, np.zeros(3), stirred=False)

    def _turn(self, turn_s: float) -> Motions:
        """Return the turn that points up what was asked for, about; any other way up one time in five."""
        rng, up = self._rng, rotated_back(self._pose[None], np.array([0.0, 0.0, 1.0]))[0]
        wanted = self.target
        if wanted is None or rng.random() < 0.2:
            wanted = rng.standard_normal(3)
        wanted = wanted / np.linalg.norm(wanted) + _NOISE_RAD / np.sqrt(2) * rng.standard_normal(3)
        wanted /= np.linalg.norm(wanted)
        axis = np.cross(wanted, up)
        if np.linalg.norm(axis) < _ALIKE:  # over the back, or round again
            axis = np.cross(rng.standard_normal(3), up)
        angle = np.arctan2(np.linalg.norm(np.cross(up, wanted)), up @ wanted)
        return self._motion(turn_s, self._pose, axis / np.linalg.norm(axis) * angle, stirred=True)

    def _motion(self, turn_s: float, pose: Floats, turn: Floats, *, stirred: bool) -> Motions:
        rng, size = self._rng, float(stirred)
        after = quaternion_product(pose[None], rotvec_quaternions(turn[None], np.ones((1, 1))))
        return Motions(
            start_s=np.array([self._count / self._scenario.rate_hz]),
            duration_s=np.array([turn_s]),
            q_before_wxyz=pose[None],
            q_after_wxyz=normalise_quaternion(after[0])[None],
            turn=turn[None],
            bend=np.zeros((1, 3)),
            sway=size * 0.3 * rng.standard_normal((1, 3)),
            shift=size * 0.15 * rng.standard_normal((1, 3)),
            swing=size * 0.05 * rng.standard_normal((1, 3)),
            push=np.zeros((1, 3)),
        )

    def _lines(self, motions: Motions, length_s: float) -> Iterator[bytes]:
        """Yield what the sensor reads of a motion, and of the rest behind it, as the sketches send it."""
        scenario, rng = self._scenario, self._rng
        count = round(length_s * scenario.rate_hz)
        t_s = (self._count + np.arange(count)) / scenario.rate_hz
        self._count += count
        force, rate = motions.evaluate(t_s, scenario.gravity, np.zeros(3))
        accelerometer, gyroscope = self.truth.required_accelerometer, self.truth.gyroscope
        assert gyroscope is not None
        a = force @ accelerometer.sensitivity.T + accelerometer.bias
        g = rate @ gyroscope.sensitivity.T + gyroscope.bias + force @ gyroscope.g_sensitivity.T
        white = rng.standard_normal((2, count, 3)) * np.sqrt(scenario.rate_hz)
        a += scenario.accelerometer_noise_density * white[0]
        g += scenario.gyroscope_noise_density * white[1]
        g = np.clip(g, -scenario.gyroscope_range, scenario.gyroscope_range)
        for t_us, force_row, rate_row in zip(np.rint(1e6 * t_s).astype(np.int64) % (1 << 32), a, g, strict=True):
            yield imu_sentence(int(t_us), (*force_row, *rate_row))


def imu_sentence(t_us: int, values: tuple[float, ...]) -> bytes:
    """Return a line as the sketches of examples/devices send it: microseconds, m/s^2, rad/s, 25 degrees, checksum."""
    body = b"IMUSI,%d,%s,25.0" % (t_us, ",".join(f"{value:.6f}" for value in values).encode())
    total = 0
    for byte in body:
        total ^= byte
    return b"$%s*%02X" % (body, total)
