"""How fast noise is identified: the Allan deviation beside allantools', and a day at 400 Hz from a file.

python benchmarks/noise.py             both; allantools is compared with where it is installed
python benchmarks/noise.py --quick     without the day
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gnomon.estimate.allan.deviation import overlapping_allan

SAMPLES, RATE_HZ, REPEATS = 1_000_000, 100.0, 5
DAY = ("--duration-s", "86400", "--rate-hz", "400")


def best(work):
    """Return the shortest of some times that a piece of work takes [s], and its result."""
    times, result = [], None
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


def deviation():
    rng = np.random.default_rng(0)
    sensors = [rng.standard_normal((SAMPLES, 3)) for _ in range(2)]
    own, curves = best(lambda: [overlapping_allan(values, RATE_HZ) for values in sensors])
    tau_s = curves[0].tau_s
    print(f"6 axes of {SAMPLES} samples, {len(tau_s)} averaging times: gnomon {own:.3f} s", end="")
    try:
        import allantools
    except ImportError:
        print("; allantools is not installed")
        return
    columns = [np.ascontiguousarray(values[:, i]) for values in sensors for i in range(3)]
    theirs, found = best(lambda: [allantools.oadev(y, rate=RATE_HZ, data_type="freq", taus=tau_s)[1] for y in columns])
    ours = np.sqrt(np.concatenate([curve.variance.T for curve in curves]))
    worst = max(np.abs(a / b - 1).max() for a, b in zip(ours, found, strict=True))
    print(f", allantools {theirs:.3f} s, {theirs / own:.1f} times as long; largest difference {worst:.1g}")


def day():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "day.npz"
        gnomon = [sys.executable, "-m", "gnomon"]
        subprocess.run([*gnomon, "simulate-noise", "-o", path, *DAY], check=True, stdout=subprocess.DEVNULL)
        size = path.stat().st_size / 1e6
        start = time.perf_counter()
        subprocess.run([*gnomon, "noise", path], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        spent = time.perf_counter() - start
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        print(f"24 h at 400 Hz ({size:.0f} MB): {spent:.1f} s, at most {peak:.0f} MB of memory")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="without the day")
    options = parser.parse_args()
    with threadpool_limits(1, user_api="blas"):
        deviation()
    if not options.quick:
        day()


if __name__ == "__main__":
    main()
