"""The two ranges that a tilted sensor may report for a flat surface: along its axis, or to the nearest point.

The report's 4.3.3 expects the first (eq 8); the first echo comes from the second. `oblique_reading` in the sensor model
says which one a sensor reports.
"""

import math


def slant_range(perpendicular_m: float, incidence_rad: float) -> float:
    """Distance along the axis to a plane, r = r_0 / cos(theta) (report eq 8).

    Parameters
    ----------
    perpendicular_m
        r_0, distance to the plane [m].
    incidence_rad
        theta, angle between the axis and the plane's normal, -pi/2 to pi/2 without the ends [rad].

    Returns
    -------
    float
        [m].

    Raises
    ------
    ValueError
        The axis does not meet the plane.

    Examples
    --------
    >>> print(f"{slant_range(2.0, math.radians(12.6)):.3f}")
    2.049
    """
    if not abs(incidence_rad) < math.pi / 2:
        raise ValueError(f"found an incidence of {math.degrees(incidence_rad):g} deg, expected less than 90")
    return perpendicular_m / math.cos(incidence_rad)


def nearest_range_in_beam(perpendicular_m: float, incidence_rad: float, half_angle_rad: float) -> float:
    """Distance to the nearest point of a plane within a cone about the axis.

    r_0 where the foot of the perpendicular is within the cone (theta <= a), else r_0 / cos(theta - a): the point
    at the cone's edge on the side of the normal. A smooth plane gives an echo from the foot only, so outside the cone
    there is an echo only if the surface is rough on the scale of the wavelength.

    Parameters
    ----------
    perpendicular_m, incidence_rad
        As in `slant_range`.
    half_angle_rad
        a, half angle of the cone, 0 or more [rad]; 0 gives the slant range.

    Returns
    -------
    float
        [m], between r_0 and the slant range.

    Raises
    ------
    ValueError
        The axis does not meet the plane.
    """
    slant_range(perpendicular_m, incidence_rad)  # refuses an axis that does not meet the plane
    return slant_range(perpendicular_m, max(abs(incidence_rad) - half_angle_rad, 0.0))
