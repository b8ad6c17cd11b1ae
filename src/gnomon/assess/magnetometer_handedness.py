"""Are the axes of magnetometer and accelerometer right-handed? Only the way in which the field dips tells.

A magnetometer with one axis negated, or two swapped, shows -R m of the field m, with some rotation R, which nothing but
the sign of the dip tells from a sensor that is turned by R (see `gnomon.estimate.triads.dip`).
"""

import numpy as np

from ..findings import Finding, make_finding
from .magnetometer_tables import FieldEvidence

_SIGNIFICANT = 4.0  # sigmas
_LEAST_DIP_DEG = 3.0
_TELLING_LATITUDE_DEG = 20.0
"""Farther from the equator than this the field dips as on that hemisphere everywhere on Earth."""
_OFF_DEG = 5.0


def handedness_findings(evidence: FieldEvidence) -> list[Finding]:
    """Compare the dip with the stated one, or with that of the stated latitude; say where neither is known."""
    if evidence.dip is None or evidence.imu.accelerometer is None:
        return []
    found, sigma = np.degrees(evidence.dip.dip_rad), np.degrees(evidence.dip_sigma_rad)
    stated, latitude = evidence.stated_dip_deg, evidence.latitude_deg
    telling = abs(found) > max(_LEAST_DIP_DEG, _SIGNIFICANT * sigma)
    if stated is not None and abs(stated) > _LEAST_DIP_DEG:
        expected, by = float(np.sign(stated)), f"the stated dip, {stated:g} deg"
    elif latitude is not None and abs(latitude) >= _TELLING_LATITUDE_DEG:
        expected, by = float(np.sign(latitude)), f"latitude {latitude:g} deg"
    else:
        return [_unchecked(found, near_equator=stated is None and latitude is not None)]
    if not telling:
        return [_unchecked(found, near_equator=True)]
    if np.sign(found) != expected:
        return [make_finding("magnetometer-handedness/good", found=found, by=by)]
    checked = make_finding("magnetometer-handedness/wrong", by=by)
    if stated is None or abs(found - stated) <= max(_OFF_DEG, _SIGNIFICANT * sigma):
        return [checked]
    return [
        checked,
        make_finding("magnetometer-dip", found=found, sigma=sigma, stated=stated),
    ]


def _unchecked(found_deg: float, *, near_equator: bool) -> Finding:
    hemisphere = "north" if found_deg > 0 else "south"
    why = "there the sign of the dip tells nothing" if near_equator else "neither --dip nor --latitude was stated"
    return make_finding(
        "magnetometer-handedness/unchecked",
        case="near-equator" if near_equator else "",
        why=why,
        found_deg=found_deg,
        hemisphere=hemisphere,
    )
