"""Harmless faults of timestamps, fixed; harmful ones are left for the data doctor to name."""

import numpy as np

from ...recording import TriadSamples
from ...results.intervals import Booleans

_RARE = 0.01


def drop_repeated_timestamps(samples: TriadSamples, *, counted: bool = False) -> TriadSamples:
    """Return the samples without those whose timestamp equals the one before; the first of them is kept.

    A sample that repeats timestamp and values of the one before was written twice, and is always dropped, unless a
    coarse converter repeats values as often where the timestamps differ. One that repeats the timestamp alone is
    dropped only while such samples are rare (1 %): where they are many, the clock is coarser than the sample rate, and
    dropping them would lose good samples. Timestamps that go backwards are never touched.

    Parameters
    ----------
    samples : timestamps in any order
    counted : samples are counted, not timed (a uniform time base is stated): a timestamp that is wrong costs none of
    them
    """
    if len(samples) < 2:
        return samples
    same_stamp = samples.t_ns[1:] == samples.t_ns[:-1]
    if not same_stamp.any():
        return samples
    same_values = (samples.values[1:] == samples.values[:-1]).all(axis=1)
    drop = same_stamp & same_values
    if _by_chance(same_values, same_stamp):
        drop[:] = False
    if not counted and np.count_nonzero(same_stamp & ~drop) <= _RARE * len(samples):
        drop = same_stamp
    if not drop.any():
        return samples
    keep = np.concatenate([[True], ~drop])
    t_ns, values = samples.t_ns[keep], samples.values[keep]
    t_ns.flags.writeable = values.flags.writeable = False  # so that they are kept without a copy
    return TriadSamples(t_ns=t_ns, values=values, unit=samples.unit)


def _by_chance(same_values: Booleans, same_stamp: Booleans) -> bool:
    """Return whether values repeat no more often (three sigma) where the timestamp is repeated than where it is not."""
    here, elsewhere = same_values[same_stamp], same_values[~same_stamp]
    if not elsewhere.any():
        return False
    usual = float(elsewhere.mean())
    return float(here.mean()) <= usual + 3 * np.sqrt(usual * (1 - usual) / len(here))
