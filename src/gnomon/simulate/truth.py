"""The calibration that is exactly true of a simulated recording."""

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from .._version import __version__
from ..results.calibration import (
    Assessment,
    Calibration,
    CameraCalibration,
    Covariance,
    Gravity,
    ImuCalibration,
    Provenance,
    covariance_names,
)

TRUTH_METHOD = "simulation"
"""By which a calibration is known to be the truth."""

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def true_calibration(
    scenario: "DataclassInstance",
    seed: int,
    *,
    imus: Mapping[str, ImuCalibration] | None = None,
    cameras: Mapping[str, CameraCalibration] | None = None,
    frame: str,
    gravity_m_s2: float,
    assessment: Assessment,
    also: Mapping[str, str] | None = None,
) -> Calibration:
    """Return what is true of simulated sensors, with zero covariance.

    Parameters
    ----------
    scenario : what was simulated; its options that differ from their default go into the provenance
    also : options that go there besides
    """
    names = covariance_names(imus or {}, cameras or {})
    return Calibration(
        imus=imus or {},
        cameras=cameras or {},
        frame=frame,
        gravity=Gravity(value=gravity_m_s2, sigma=0.0, source=TRUTH_METHOD),
        uncertainty=Covariance(names=names, matrix=np.zeros((len(names), len(names)))),
        assessment=assessment,
        provenance=Provenance(
            gnomon_version=__version__,
            method=TRUTH_METHOD,
            options={**(also or {}), **changed_options(scenario)},
            seed=seed,
        ),
    )


def changed_options(scenario: "DataclassInstance") -> dict[str, str]:
    """Return the options of a scenario that differ from their default, as text."""
    defaults = type(scenario)()
    return {
        option.name: str(getattr(scenario, option.name))
        for option in fields(scenario)
        if getattr(scenario, option.name) != getattr(defaults, option.name)
    }
