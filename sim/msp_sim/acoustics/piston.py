"""Directivity of a flat circular piston: a transducer's level off its axis, for sending and receiving.

It is a level in dB, 0 on the axis, for an angle, a diameter and a wavelength. Follows the report's eq 3 with the sine
inside the Bessel function (erratum 3), as textbooks have it (Kinsler and others, Fundamentals of Acoustics, 7.4). Far
field, beyond D^2 / lambda: 3 cm for an MB1242. One way; for an echo it counts twice.
"""

import math

from scipy.optimize import brentq
from scipy.special import j1

FIRST_NULL_X = 3.8317059702
"""First zero of J1 above 0 (Abramowitz and Stegun, table 9.5)."""


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
    # Below 1e-8 it is 1 - x^2 / 8 = 1 to all digits, and J1 of the smallest numbers is 0.
    ratio = min(abs(2.0 * float(j1(x)) / x), 1.0) if abs(x) > 1e-8 else 1.0
    return 20.0 * math.log10(ratio) if ratio > 0.0 else -math.inf


def main_lobe_x(down_db: float) -> float:
    """The x before the first null at which the level is ``down_db`` (0 or more) below that on the axis."""
    if level_db(FIRST_NULL_X) > -down_db:
        return FIRST_NULL_X
    found: float = brentq(lambda x: level_db(x) + down_db, 0.0, FIRST_NULL_X, xtol=1e-14)
    return found
