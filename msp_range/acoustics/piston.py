"""Directivity of a flat circular piston: a transducer's level off its axis, for sending and receiving.

Angle, diameter and wavelength enter, a level in dB leaves, 0 on the axis. Follows the report's eq 3 with the sine
inside the Bessel function (erratum 3), as textbooks have it (Kinsler and others, Fundamentals of Acoustics, 7.4).
Far field, beyond D^2 / lambda: 3 cm for an MB1242. One way; for an echo it counts twice.
"""

import math

FIRST_NULL_X = 3.8317059702
"""First zero of J1 above 0 (Abramowitz and Stegun, table 9.5)."""

_DB = 20.0 / math.log(10.0)
"""Decibels per factor of e."""


def directivity_db(off_axis_rad: float, diameter_m: float, wavelength_m: float) -> float:
    """P(theta) = 20 log10 |2 J1(x) / x| with x = (pi D / lambda) sin(theta) (report eq 3, corrected).

    Parameters
    ----------
    off_axis_rad
        theta, -pi/2 to pi/2 [rad].
    diameter_m, wavelength_m
        Above 0 [m].

    Returns
    -------
    float
        Level relative to the axis, 0 or less [dB]; minus infinity at a null.

    Raises
    ------
    ValueError
        The angle is behind the piston.

    Examples
    --------
    A piston of two wavelengths is half the power at 14.9 deg:

    >>> print(f"{directivity_db(math.radians(14.90), 2.0, 1.0):.2f} dB")
    -3.01 dB
    """
    if not abs(off_axis_rad) <= math.pi / 2:
        raise ValueError(f"found {math.degrees(off_axis_rad):g} deg off the axis, expected -90 to 90")
    return level_db(math.pi * diameter_m / wavelength_m * math.sin(off_axis_rad))


def level_db(x: float) -> float:
    """20 log10 |2 J1(x) / x| [dB] of x = (pi D / lambda) sin(theta); 0 at 0."""
    if abs(x) < 1e-4:
        # 2 J1(x) / x = 1 - x^2 / 8 + ...: here closer than `bessel`, whose 2e-15 are divided by x.
        return -_DB * x * x / 8.0 if x else 0.0
    ratio = abs(2.0 * bessel(1, abs(x)) / x)
    return 20.0 * math.log10(ratio) if ratio > 0.0 else -math.inf


def main_lobe_x(down_db: float) -> float:
    """The x before the first null at which the level is ``down_db`` (0 or more) below that on the axis.

    Newton's method in u = x^2. The level is 20 log10 of the product of 1 - u / j^2 over all zeros j of J1, so it is
    concave in u and below its first factor: starting where the first factor is ``down_db`` down, the iteration
    decreases monotonically towards the solution.
    """
    if down_db < 1e-6:
        # 2 J1(x) / x = 1 - x^2 / 8 + ...: closer than the difference of two levels near 0 dB.
        return math.sqrt(8.0 * down_db / _DB)
    null = FIRST_NULL_X * FIRST_NULL_X
    u = -null * math.expm1(-down_db / _DB)
    # Stay before the null, where the level is minus infinity.
    u = min(u, null * (1.0 - 1e-12))
    while True:
        x = math.sqrt(u)
        j1 = bessel(1, x)
        slope = -0.5 * _DB * bessel(2, x) / (x * j1)
        step = (_DB * math.log(2.0 * j1 / x) + down_db) / slope
        if not step > 1e-15 * u:
            return x
        u = max(u - step, 0.0)


def bessel(order: int, x: float) -> float:
    """J_n(x) = 1/pi times the integral of cos(n t - x sin t) over 0 ... pi (Abramowitz and Stegun, 9.1.21).

    Computed by the trapezoidal rule, whose error for this integrand is J_m(x) with m twice the number of points, which
    is below a float's precision.
    """
    points = 12 + math.ceil(abs(x))
    ends = 1.0 if order % 2 == 0 else 0.0
    angles = (math.pi / points * k for k in range(1, points))
    return (ends + sum(math.cos(order * t - x * math.sin(t)) for t in angles)) / points
