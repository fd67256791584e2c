"""Absorption of sound by the air: a pure tone, by ISO 9613-1.

It is a number of decibels per metre for a frequency in air. The report's eq 2 has it as alpha.
"""

import numpy as np

from msp_range.acoustics.air import STANDARD_PRESSURE_PA
from msp_range.numbers import Numbers
from msp_sim.acoustics.atmosphere import Atmosphere

REFERENCE_K = 293.15
"""T_0 of the standard, 20 deg C [K]."""

TRIPLE_POINT_K = 273.16
"""T_01 of the standard, the triple point of water [K]."""


def absorption_db_per_m(frequency_hz: float, air: Atmosphere) -> float:
    """Absorption of a pure tone, ISO 9613-1:1993 eq 3 to 5 and annex B.

    alpha = 8.686 f^2 (1.84e-11 (p_r / p) sqrt(T / T_0) + (T / T_0)^(-5/2) (0.01275 exp(-2239.1 / T) f_rO /
    (f_rO^2 + f^2) + 0.1068 exp(-3352 / T) f_rN / (f_rN^2 + f^2))), with the relaxation frequencies of oxygen and
    nitrogen

    f_rO = (p / p_r) (24 + 4.04e4 h (0.02 + h) / (0.391 + h)),
    f_rN = (p / p_r) (T / T_0)^(-1/2) (9 + 280 h exp(-4.170 ((T / T_0)^(-1/3) - 1))),

    and the molar concentration of water vapour [%] h = h_r (p_r / p) 10^(4.6151 - 6.8346 (T_01 / T)^1.261), h_r the
    relative humidity [%], p_r one atmosphere, T_0 = 293.15 K, T_01 = 273.16 K.

    Parameters
    ----------
    frequency_hz
        Above 0. The standard covers 0.0004 to 10 Hz/Pa of frequency over pressure: 40 Hz to 1 MHz at one atmosphere.
    air
        Temperature, humidity and pressure.

    Returns
    -------
    float
        [dB/m], a level: the same number for intensity and for pressure. Over 4.343 it is the intensity's coefficient
        in nepers a metre, over 8.686 the amplitude's. To 10 % for 0.05 to 5 % of water vapour, to 20 % below.

    Raises
    ------
    ValueError
        The frequency is not above 0.

    Examples
    --------
    >>> print(f"{absorption_db_per_m(42_000.0, Atmosphere()):.2f}")
    1.39
    """
    if not frequency_hz > 0.0:
        raise ValueError(f"found a frequency of {frequency_hz:g} Hz, expected more than 0")
    return float(db_per_m(frequency_hz, air.absolute_k, air.humidity_percent, air.pressure_pa))


def db_per_m(frequency_hz: float, absolute_k: Numbers, humidity_percent: Numbers, pressure_pa: float) -> Numbers:
    """The same of numbers, or of arrays of them; all in SI but for the humidity [%], and none is checked."""
    warmth = absolute_k / REFERENCE_K
    pressure = pressure_pa / STANDARD_PRESSURE_PA
    saturation = 10.0 ** (4.6151 - 6.8346 * (TRIPLE_POINT_K / absolute_k) ** 1.261)
    vapour_percent = humidity_percent / pressure * saturation
    oxygen_hz = pressure * (24.0 + 4.04e4 * vapour_percent * (0.02 + vapour_percent) / (0.391 + vapour_percent))
    sharing = np.exp(-4.170 * (warmth ** (-1 / 3) - 1.0))
    nitrogen_hz = pressure * warmth**-0.5 * (9.0 + 280.0 * vapour_percent * sharing)
    classical = 1.84e-11 / pressure * warmth**0.5
    oxygen = 0.01275 * np.exp(-2239.1 / absolute_k) * oxygen_hz / (oxygen_hz**2 + frequency_hz**2)
    nitrogen = 0.1068 * np.exp(-3352.0 / absolute_k) * nitrogen_hz / (nitrogen_hz**2 + frequency_hz**2)
    found: Numbers = 8.686 * frequency_hz**2 * (classical + warmth**-2.5 * (oxygen + nitrogen))
    return found
