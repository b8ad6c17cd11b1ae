"""What the tests of the estimation share."""

from collections.abc import Callable

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.preparation import stream
from gnomon.detect.static import find_static
from gnomon.estimate.problem import MultiPositionProblem, build_problem


@pytest.fixture(scope="session")
def multiposition() -> Callable[..., tuple[MultiPositionProblem, gnomon.Calibration]]:
    """Return a function that simulates a recording and gathers its multi-position problem; the truth beside it."""

    def make(seed=0, *, earth_rate_variance=0.0, **scenario):
        recording, truth = gnomon.simulate(gnomon.Scenario(**scenario), seed)
        imu = recording.imus["imu0"]
        still = find_static(imu.accelerometer, multiplier=100.0)
        clipped = np.zeros(len(imu.accelerometer), dtype=bool)
        streams = [stream(samples, samples.t_s, clipped, still) for samples in (imu.accelerometer, imu.gyroscope)]
        return build_problem(*streams, earth_rate_variance), truth

    return make
