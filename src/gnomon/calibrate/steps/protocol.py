"""Which method a recording of one IMU asks for: rests alone, or rests and the rotations between them."""

import numpy as np

from ...detect.samples.rests import FEWEST_INTERVALS
from ...errors import DetectionError
from ...options import ImuOptions
from ...recording import Recording, TriadSamples
from ...results.result import Booleans
from .preparation import PreparedImu

LEFT_TO_RESTS = frozenset({"attitudes", "gyroscope-silent"})
"""What the data doctor holds against a multi-position recording, and what rests alone may do without."""

FEWEST_ROTATIONS = 3
"""With fewer rotations that the gyroscope measured whole, it is judged by its rests."""

GAP_NS = 500_000_000
"""A longer step between two samples is a time that was not recorded."""
_GAP_STEPS = 20


def by_rests(recording: Recording, options: ImuOptions) -> bool:
    """Tell whether a recording is calibrated from its rests alone: its content or an option says so."""
    if recording.poses is not None or recording.pieces or options.preset == "angrisano" or options.model == "static":
        return True
    return bool(recording.imus) and not len(next(iter(recording.imus.values())).gyroscope)


def left_to_rests(prepared: PreparedImu) -> bool:
    """Tell whether a recording is a static experiment: few rests, or the time between them was cut out.

    Raises
    ------
    DetectionError
        If the gyroscope shows only noise although the rotations were recorded.
    """
    problems = {f.code: f for f in prepared.findings if f.severity == "problem" and f.code in LEFT_TO_RESTS}
    silent = problems.get("gyroscope-silent")
    if silent is not None:
        from ...estimate.triads.static_g_sensitivity import FEWEST_POSES

        if np.sum(recording_gaps(prepared.accelerometer)) < FEWEST_POSES - 1:
            raise DetectionError(str(silent))
    rests = prepared.rests
    return bool(problems) or (
        rests is not None and max(len(trial.intervals) for trial in rests.trials) <= FEWEST_INTERVALS
    )


def recording_gaps(samples: TriadSamples) -> Booleans:
    """Return which steps from sample to sample are times that were not recorded, (n - 1,)."""
    steps = np.diff(samples.t_ns)
    return steps > max(GAP_NS, _GAP_STEPS * np.median(steps)) if len(steps) else np.empty(0, dtype=bool)
