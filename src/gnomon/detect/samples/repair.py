"""Harmless faults of stamps, mended; harmful ones are left for the data doctor to name."""

import numpy as np

from ...recording import TriadSamples

_RARE = 0.01


def repaired(samples: TriadSamples) -> TriadSamples:
    """Return the samples without those whose stamp equals the one before; the first of them is kept.

    A sample that repeats stamp and values of the one before was written twice, and is always dropped. One that repeats
    the stamp alone is dropped only while such samples are rare (1 %): where they are many, the clock is coarser than
    the sample rate, and dropping them would lose good samples. Stamps that go backwards are never touched.
    """
    if len(samples) < 2:
        return samples
    same_stamp = samples.t_ns[1:] == samples.t_ns[:-1]
    if not same_stamp.any():
        return samples
    same_values = (samples.values[1:] == samples.values[:-1]).all(axis=1)
    rare = np.count_nonzero(same_stamp & ~same_values) <= _RARE * len(samples)
    drop = same_stamp if rare else same_stamp & same_values
    keep = np.concatenate([[True], ~drop])
    t_ns, values = samples.t_ns[keep], samples.values[keep]
    t_ns.flags.writeable = values.flags.writeable = False  # so that they are kept without a copy
    return TriadSamples(t_ns=t_ns, values=values, unit=samples.unit)
