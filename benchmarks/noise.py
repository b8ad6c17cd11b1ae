"""How fast noise is identified: the Allan deviation beside allantools', and a day at 400 Hz from a file.

python benchmarks/noise.py             both; allantools is compared with where it is installed
python benchmarks/noise.py --quick     without the day
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from imu import child
from threadpoolctl import threadpool_limits

from gnomon.estimate.allan.deviation import overlapping_allan

SAMPLES, RATE_HZ, REPEATS = 1_000_000, 100.0, 5
DAY_H, RECORDED_HZ = 24.0, 400.0


def best(work):
    """Return the shortest of some times that a piece of work takes [s], and its result."""
    times, result = [], None
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


def deviation():
    """Return how long ours takes and allantools' [s] (None where it is not installed), and how much they differ."""
    rng = np.random.default_rng(0)
    sensors = [rng.standard_normal((SAMPLES, 3)) for _ in range(2)]
    with threadpool_limits(1, user_api="blas"):
        own, curves = best(lambda: [overlapping_allan(values, RATE_HZ) for values in sensors])
    tau_s = curves[0].tau_s
    try:
        import allantools
    except ImportError:
        return own, None, None
    columns = [np.ascontiguousarray(values[:, i]) for values in sensors for i in range(3)]
    theirs, found = best(lambda: [allantools.oadev(y, rate=RATE_HZ, data_type="freq", taus=tau_s)[1] for y in columns])
    ours = np.sqrt(np.concatenate([curve.variance.T for curve in curves]))
    return own, theirs, max(np.abs(a / b - 1).max() for a, b in zip(ours, found, strict=True))


def recorded(hours):
    """Return how long `gnomon noise` takes with a recording of so many hours [s, wall], and its peak memory [MiB]."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "recording.npz")
        length = ["--duration-s", f"{3600 * hours:g}", "--rate-hz", f"{RECORDED_HZ:g}"]
        gnomon = [sys.executable, "-m", "gnomon"]
        subprocess.run([*gnomon, "simulate-noise", "-o", path, *length], check=True, stdout=subprocess.DEVNULL)
        start = time.perf_counter()
        _, peak, code = child(["-m", "gnomon", "noise", path])
        if code:
            raise SystemExit(f"gnomon noise ended with exit code {code}")
        return time.perf_counter() - start, peak


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="without the day")
    options = parser.parse_args()
    own, theirs, worst = deviation()
    print(f"6 axes of {SAMPLES} samples: gnomon {own:.3f} s", end="")
    if theirs is None:
        print("; allantools is not installed")
    else:
        print(f", allantools {theirs:.3f} s, {theirs / own:.1f} times as long; largest difference {worst:.1g}")
    if not options.quick:
        spent, peak = recorded(DAY_H)
        print(f"{DAY_H:g} h at {RECORDED_HZ:g} Hz: {spent:.1f} s, at most {peak:.0f} MiB of memory")


if __name__ == "__main__":
    main()
