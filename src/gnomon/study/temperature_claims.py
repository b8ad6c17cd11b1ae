"""What the study of the temperature says, as claims and tables."""

from collections.abc import Iterator

import numpy as np

from .tables import Claim, StudyTable, claims_table
from .temperature import METHODS, TemperatureStudy

_FEWEST = 20
"""Sensors from which on shares and ratios tell something."""
_RIGHT, _STAYS, _SIGMAS, _SMALLER = 0.95, 0.975, 1.2, 3.0


def temperature_claims(study: TemperatureStudy) -> Iterator[Claim]:
    """Yield what gnomon promises, and what the study found."""
    right = np.array([outcome.order == outcome.found for outcome in study.outcomes])
    stays = np.array([outcome.found == 0 for outcome in study.healthy])
    ratios = study.rms[1:] / study.rms[0]

    def told(holds: bool, count: int) -> bool | None:
        return holds if count >= _FEWEST else None

    yield Claim(
        claim="the order of the polynomials is found",
        expected=f"in {100 * _RIGHT:.0f} % or more",
        found=f"in {right.sum()} of {len(right)}",
        holds=told(bool(right.mean() >= _RIGHT), len(right)),
    )
    yield Claim(
        claim="a sensor that does not change, or whose temperature is steady, keeps order 0",
        expected=f"in {100 * _STAYS:.1f} % or more",
        found=f"in {stays.sum()} of {len(stays)}",
        holds=told(bool(stays.mean() >= _STAYS), len(stays)),
    )
    yield Claim(
        claim="standard deviations are those of the errors in a warm-up that was left out",
        expected=f"errors of {_SIGMAS:g} sigma rms or less",
        found=f"{study.z_rms:.2f} sigma",
        holds=told(study.z_rms <= _SIGMAS, len(right)),
    )
    for name, ratio in zip(METHODS[1:], ratios, strict=True):
        yield Claim(
            claim=f"errors in a warm-up that was left out are smaller than by the method of {name}",
            expected=f"{_SMALLER:g} times or more",
            found=f"{ratio:.1f} times",
            holds=told(bool(ratio >= _SMALLER), len(right)),
        )


def temperature_tables(study: TemperatureStudy) -> Iterator[StudyTable]:
    """Yield the tables."""
    yield claims_table(temperature_claims(study))
    yield StudyTable(
        name="warm_ups",
        head=("kind", "order", "order_found", "lag_s", "step_k", *(f"error_{name}_rad_s" for name in METHODS), "z"),
        rows=[
            (kind, one.order, one.found, one.lag_s, one.step_k, *one.errors.tolist(), one.z)
            for kind, outcomes in (("changes", study.outcomes), ("healthy", study.healthy))
            for one in outcomes
        ],
    )
