"""Normal gravity of the WGS 84 ellipsoid."""

from math import radians, sin, sqrt

_EQUATOR_M_S2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY_SQUARED = 0.00669437999014
_SEMI_MAJOR_M = 6378137.0
_FLATTENING = 1 / 298.257223563
_M = 0.00344978650684
"""omega^2 a^2 b / GM."""

NORMAL_GRAVITY_SIGMA_M_S2 = 5e-4
"""Spread of true gravity about normal gravity on land (gravity anomalies of some 50 mGal) [m/s^2]."""

WORLD_GRAVITY_SIGMA_M_S2 = 0.02
"""Spread of gravity over inhabited places about standard gravity [m/s^2]."""

EARTH_RATE_RAD_S = 7.292115e-5
"""Rotation rate of the Earth (Krebs, chapter 3: 15.041 deg/h) [rad/s]."""


def normal_gravity_m_s2(latitude_deg: float, altitude_m: float = 0.0) -> float:
    """Return normal gravity [m/s^2] by Somigliana's formula with the second-order height correction (NIMA TR8350.2).

    Examples
    --------
    >>> round(normal_gravity_m_s2(45.4), 4)
    9.8066
    """
    sine_squared = sin(radians(latitude_deg)) ** 2
    surface = _EQUATOR_M_S2 * (1 + _SOMIGLIANA * sine_squared) / sqrt(1 - _ECCENTRICITY_SQUARED * sine_squared)
    h = altitude_m / _SEMI_MAJOR_M
    return surface * (1 - 2 * (1 + _FLATTENING + _M - 2 * _FLATTENING * sine_squared) * h + 3 * h * h)
