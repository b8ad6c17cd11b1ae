"""Are the axes of magnetometer and accelerometer right-handed? Only the way in which the field dips tells.

A magnetometer with one axis negated, or two swapped, shows -R m of the field m, with some rotation R, which nothing but
the sign of the dip tells from a sensor that is turned by R (see `gnomon.estimate.triads.dip`).
"""

import numpy as np

from ..findings import Finding
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
        return [
            Finding(
                severity="problem",
                code="magnetometer-handedness",
                message=f"The field dips by {found:.1f} deg; {by}, asks for the other sign.",
                consequence="An axis of the magnetometer has the wrong sign, or two are swapped, and directions of the "
                "field are wrong by up to 180 deg; or the accelerometer shows -1 g up, and only the dip is wrong.",
                cure="Check that the accelerometer's upward axis reads +1 g at rest, then the signs and the order of "
                "the magnetometer's columns: turned to magnetic north, each axis reads most.",
            )
        ]
    checked = Finding(
        severity="good",
        code="magnetometer-handedness",
        message=f"The field dips the way that {by}, asks for: both sensors are right-handed.",
    )
    if stated is None or abs(found - stated) <= max(_OFF_DEG, _SIGNIFICANT * sigma):
        return [checked]
    return [
        checked,
        Finding(
            severity="warning",
            code="magnetometer-dip",
            message=f"The field dips by {found:.1f} +- {sigma:.1g} deg; {stated:g} deg was stated.",
            consequence="The field of the place is bent by iron, or how the sensors lie to each other is wrong.",
            cure="Record outdoors, away from iron, and check the stated dip.",
        ),
    ]


def _unchecked(found_deg: float, *, near_equator: bool) -> Finding:
    hemisphere = "north" if found_deg > 0 else "south"
    why = "there the sign of the dip tells nothing" if near_equator else "neither --dip nor --latitude was stated"
    return Finding(
        severity="info",
        code="magnetometer-handedness",
        message=f"Handedness was not checked: {why}. The field dips by {found_deg:.1f} deg, as {hemisphere} of the "
        "magnetic equator.",
        consequence="If that is not where you are, an axis of the magnetometer has the wrong sign or two are swapped, "
        "and directions are wrong, or the accelerometer shows -1 g up.",
        cure="State --dip, such as from the WMM, to check it."
        if near_equator
        else "State --dip, such as from the WMM, or --latitude, to check it.",
    )
