"""Our calibration beside imucal's, from one recording: six faces up, a full turn about each axis, then free poses.

    python benchmarks/imucal_poses.py

imucal (Ferraris' procedure) is told where its six poses and three turns are, and takes them for exact; gnomon gets the
recording, finds what it needs and states uncertainties, so that the two times are of different work.
"""

import importlib.util
import statistics
import time

import numpy as np

import gnomon
from gnomon.geometry.rotations import quaternion_product
from gnomon.simulate.trajectory import Motions, rotvec_quaternions

RATE_HZ, REST_S, MOVE_S, FIRST_S = 100.0, 4.0, 2.0, 30.0
GRAVITY = 9.81
PLACED_RAD, FREE_POSES = np.radians(0.5), 18
"""How well a pose is set, one sigma; and the number of poses that only gnomon uses."""
RECORDINGS = 5
ACCELEROMETER_NOISE, GYROSCOPE_NOISE = 0.02, 2e-3  # of a sample [m/s^2, rad/s]

_HALF, _FULL = np.pi / 2, 2 * np.pi
_X, _Y, _Z = np.eye(3)
_FACES = (
    # the motion, in the body, and what imucal calls the motion or the rest after it
    (_FULL * -_Z, "z_rot"), (-_HALF * _Y, "x_p"), (_FULL * -_X, "x_rot"), (-_HALF * _Z, "y_p"), (_FULL * -_Y, "y_rot"),
    (-_HALF * _Z, "x_a"), (-_HALF * _Z, "y_a"), (-_HALF * _X, "z_a"),
)  # fmt: skip


def simulated(seed):
    """Return the recording, the same without noise, its truth (force, rate) and imucal's regions as slices by name."""
    rng = np.random.default_rng(seed)
    free = rng.standard_normal((FREE_POSES, 3))
    free *= rng.uniform(1.0, 2.5, (FREE_POSES, 1)) / np.linalg.norm(free, axis=1)[:, None]
    turn = np.array([motion for motion, _ in _FACES])
    turn += PLACED_RAD * rng.standard_normal(turn.shape) * [["rot" not in name] for _, name in _FACES]
    turn = np.concatenate([turn, free])
    start = FIRST_S + (MOVE_S + REST_S) * np.arange(len(turn))
    attitudes = [np.array([1.0, 0.0, 0.0, 0.0])]
    for one in turn:
        attitudes.append(quaternion_product(attitudes[-1], rotvec_quaternions(one[None], np.ones((1, 1)))[0]))
    nothing = np.zeros_like(turn)
    motions = Motions(
        start_s=start, duration_s=np.full(len(turn), MOVE_S), q_before_wxyz=np.array(attitudes[:-1]),
        q_after_wxyz=np.array(attitudes[1:]), turn=turn, bend=nothing, sway=nothing, shift=nothing, swing=nothing,
        push=nothing,
    )  # fmt: skip
    t_s = np.arange(0.0, start[-1] + MOVE_S + REST_S, 1 / RATE_HZ)
    force, rate = motions.evaluate(t_s, GRAVITY, np.zeros(3))
    lower = np.tril(rng.uniform(-0.01, 0.01, (3, 3)))
    accelerometer = force @ (np.eye(3) + lower).T + rng.uniform(-0.3, 0.3, 3)
    gyroscope = rate @ (np.eye(3) + rng.uniform(-0.01, 0.01, (3, 3))).T + rng.uniform(-0.02, 0.02, 3)
    noisy = [values + sigma * rng.standard_normal(values.shape)
             for values, sigma in ((gyroscope, GYROSCOPE_NOISE), (accelerometer, ACCELEROMETER_NOISE))]  # fmt: skip
    recording, clean = (gnomon.Recording.from_arrays(t_s, *both) for both in (noisy, (gyroscope, accelerometer)))
    regions = {"z_p": slice(0, int(FIRST_S * RATE_HZ))}
    for (_, name), begin in zip(_FACES, start, strict=False):
        end = begin + MOVE_S
        first, last = (begin, end) if "rot" in name else (end, end + REST_S)
        regions[name] = slice(round(first * RATE_HZ), round(last * RATE_HZ))
    return recording, clean, (force, rate), regions


def errors(force, rate, truth):
    """Return what is off whatever the axes are: norm of force at rest, of rate in motion, rms [mm/s^2, mrad/s]."""
    force_true, rate_true = truth
    speed = np.linalg.norm(rate_true, axis=1)
    off = np.linalg.norm(force, axis=1) - np.linalg.norm(force_true, axis=1)
    turning = np.linalg.norm(rate, axis=1) - speed
    return 1e3 * np.sqrt(np.mean(off[speed == 0] ** 2)), 1e3 * np.sqrt(np.mean(turning[speed > 1.0] ** 2))


def timed(work, runs):
    """Return the median CPU time of some work [s], and its result."""
    result, seconds = work(), []
    for _ in range(runs):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return statistics.median(seconds), result


def with_gnomon(recording, clean, _regions, runs):
    """Return the CPU time of our calibration [s], and force and rate of the recording without noise after it."""
    options = gnomon.ImuOptions(gravity=GRAVITY)
    seconds, result = timed(lambda: gnomon.calibrate_imu(recording, options), runs)
    applied = result.calibration.imus["imu0"].apply(clean.imus["imu0"])
    return seconds, applied.accelerometer.values, applied.gyroscope.values


def with_imucal(recording, clean, regions, runs):
    """Return the same of imucal."""
    from imucal import FerrarisCalibration, FerrarisSignalRegions

    (force, degrees), exact = (
        (one.imus["imu0"].accelerometer.values, np.degrees(one.imus["imu0"].gyroscope.values))
        for one in (recording, clean)
    )
    parts = {f"{kind}_{name}": values[region] for name, region in regions.items()
             for kind, values in (("acc", force), ("gyr", degrees))}  # fmt: skip
    signals, procedure = FerrarisSignalRegions(**parts), FerrarisCalibration(grav=GRAVITY)
    units = {"from_acc_unit": "m/s^2", "from_gyr_unit": "deg/s"}
    seconds, found = timed(lambda: procedure.compute(signals, RATE_HZ, **units), runs)
    force, degrees = found.calibrate(*exact, acc_unit="m/s^2", gyr_unit="deg/s")
    return seconds, force, np.radians(degrees)


def compared(runs):
    """Return rows of: what, ours, imucal's (None where it is not installed); medians over the recordings."""
    programs = [with_gnomon]
    if importlib.util.find_spec("imucal"):
        programs.append(with_imucal)
    found = {program: [] for program in programs}
    for seed in range(1, RECORDINGS + 1):
        recording, clean, truth, regions = simulated(seed)
        for program in programs:
            seconds, force, rate = program(recording, clean, regions, runs)
            found[program].append((seconds, *errors(force, rate, truth)))
    ours, *others = (np.median(rows, axis=0) for rows in found.values())
    names = (
        "CPU of the calibration [s]",
        "error of the force at rest [mm/s^2]",
        "error of the rate in motion [mrad/s]",
    )
    return list(zip(names, ours, others[0] if others else (None,) * 3, strict=True))


if __name__ == "__main__":
    for what, own, its in compared(5):
        print(f"{what}: gnomon {own:.4g}" + ("" if its is None else f", imucal {its:.4g}"))
