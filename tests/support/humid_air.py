"""Speed of sound in humid air, Cramer 1993 (J. Acoust. Soc. Am. 93, 2510): what the effect `humidity` is held to."""

import math

from msp_sim.acoustics.atmosphere import Atmosphere

CO2_MOLE_FRACTION = 400e-6
"""Mole fraction of carbon dioxide in open air; 100 ppm more lowers the speed of sound by 0.01 m/s."""


def speed_of_sound_humid(air: Atmosphere, co2_mole_fraction: float = CO2_MOLE_FRACTION) -> float:
    """Speed of sound with humidity, pressure and carbon dioxide (Cramer 1993, eq 15).

    c = a0 + a1 t + a2 t^2 + (a3 + a4 t + a5 t^2) x_w + (a6 + a7 t + a8 t^2) p + (a9 + a10 t + a11 t^2) x_c
    + a12 x_w^2 + a13 p^2 + a14 x_c^2 + a15 x_w p x_c, with t in deg C, p in Pa and x_w, x_c the mole fractions of
    water vapour and carbon dioxide. x_w = h f p_sv / p with h the relative humidity (0 to 1), the enhancement factor
    f = 1.00062 + 3.14e-8 p + 5.6e-7 t^2, and p_sv = exp(1.2811805e-5 T^2 - 1.9509874e-2 T + 34.04926034
    - 6353.6311 / T) [Pa], T in kelvin (its appendix, after Giacomo 1982).

    Parameters
    ----------
    air
        0 to 30 deg C, 75 to 102 kPa.
    co2_mole_fraction
        0 to 0.01.

    Returns
    -------
    float
        Zero-frequency speed [m/s], to 300 ppm. At 42 kHz oxygen no longer follows in dry air, which adds at most
        0.04 % (its largest absorption per wavelength over pi).

    Raises
    ------
    ValueError
        Outside of the range that the polynomial was fitted to.
    """
    t, p, x_c = air.temperature_c, air.pressure_pa, co2_mole_fraction
    if not (0.0 <= t <= 30.0 and 75e3 <= p <= 102e3 and 0.0 <= x_c <= 0.01):
        raise ValueError(
            f"found {t:g} deg C, {p / 1e3:g} kPa and a CO2 fraction of {x_c:g}, "
            "expected 0 to 30 deg C, 75 to 102 kPa and at most 0.01: no humid speed of sound is known outside of these"
        )
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    x_w = air.humidity_percent / 100.0 * enhancement * _saturation_pressure_pa(air.absolute_k) / p
    return (
        331.5024
        + 0.603055 * t
        - 0.000528 * t**2
        + (51.471935 + 0.1495874 * t - 0.000782 * t**2) * x_w
        + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p
        + (-85.20931 - 0.228525 * t + 5.91e-5 * t**2) * x_c
        - 2.835149 * x_w**2
        - 2.15e-13 * p**2
        + 29.179762 * x_c**2
        + 0.000486 * x_w * p * x_c
    )


def _saturation_pressure_pa(absolute_k: float) -> float:
    return math.exp(1.2811805e-5 * absolute_k**2 - 1.9509874e-2 * absolute_k + 34.04926034 - 6.3536311e3 / absolute_k)
