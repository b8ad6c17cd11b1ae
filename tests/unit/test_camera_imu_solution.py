"""When the batch estimation goes on, and when it gives up."""

import pytest

from gnomon.estimate.camera_imu.gauss_newton import Iteration
from gnomon.estimate.camera_imu.solution import _stalled  # pyright: ignore[reportPrivateUsage]


def taken(costs: list[float], largest: float) -> list[Iteration]:
    return [Iteration(cost=cost, largest_step=largest, damping=0.0, accepted=True) for cost in costs]


@pytest.mark.parametrize(
    ("costs", "stalls"),
    [
        ([1e6] * 10, False),
        ([1e6] * 11, True),
        ([1e6 * 0.999**k for k in range(20)], True),
        ([1e6 * 0.9**k for k in range(20)], False),
    ],
    ids=["too early", "at one height", "hardly falling", "still going down"],
)
def test_steps_that_do_not_shrink_end_only_where_the_cost_does_not_fall(costs, stalls):
    assert _stalled(taken(costs, 150.0)) is stalls


def test_trials_that_were_not_taken_tell_nothing():
    missed = [Iteration(cost=1e6, largest_step=1.0, damping=0.0, accepted=False)] * 20
    assert not _stalled(taken([1e6] * 10, 150.0) + missed)


def test_steps_that_shrink_go_on():
    steps = [Iteration(cost=1e6, largest_step=100.0 * 0.5**k, damping=0.0, accepted=True) for k in range(20)]
    assert not _stalled(steps)
