"""Speed of sound in air, and ranges corrected for temperature and humidity with their remaining uncertainty.

Temperatures are in degrees Celsius, speeds in metres per second, distances in metres. There is one formula for the
speed of sound, that of dry air; humid air is used with its sonic temperature, at which dry air has the same speed.
Follows the characterization report's eq 6 and 7. Its section 2.2 gives ultrasound 1540 m/s, which is the speed in soft
tissue: in air it is about 343 m/s at 20 deg C (erratum 1), and eq 7 takes absolute temperatures (erratum 4). The bridge
calls these functions for each reading, so plain numbers are computed with `math`; numpy is imported for arrays only.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from msp_range.numbers import Numbers

HEAT_CAPACITY_RATIO = 1.4
"""gamma of dry air: an ideal gas of two-atom molecules has 7/5."""

GAS_CONSTANT_J_PER_MOL_K = 8.314462618
"""R, exact since the SI of 2019 (CODATA 2018)."""

MOLAR_MASS_KG_PER_MOL = 0.02896546
"""M of dry air with 400 ppm of CO2 (CIPM-2007: Picard and others 2008, Metrologia 45, 149)."""

ZERO_CELSIUS_K = 273.15
"""0 deg C [K], by definition."""

STANDARD_PRESSURE_PA = 101_325.0
"""One standard atmosphere [Pa], by definition."""

SONIC_PER_VAPOUR = 0.32
"""Relative growth of the sonic temperature per mole fraction of water vapour, T_s = T (1 + 0.32 e / p) (Kaimal and
Gaynor 1991, Boundary-Layer Meteorology 56, 401). A mixture of ideal gases gives 0.321, Cramer (1993) 0.31 at 0 deg C
and 0.316 at 30."""

FIXED, HELD, NO_AIR = "fixed", "held", "none"
"""Sources of an `Air` that is not a new measurement: the airframe file's constant; an earlier value of a source; none,
because the sensor uses light."""
TWO_SIDED_95_PERCENT = 1.96
"""Half width, in standard deviations, of the interval that contains 95 % of a normal distribution."""

_SPEED_SQUARED_PER_K = HEAT_CAPACITY_RATIO * GAS_CONSTANT_J_PER_MOL_K / MOLAR_MASS_KG_PER_MOL


class Air(NamedTuple):
    """Temperature and humidity of the air between sensors and ground, with their uncertainty."""

    temperature_c: float
    """Mean temperature along the beam [deg C]."""
    std_c: float
    """Standard deviation of the error of ``sonic_c`` [deg C]."""
    source: str
    """Origin of the temperature: a temperature source's name, `FIXED` or `HELD`."""
    humidity_percent: float = 0.0
    """Relative humidity [%]; 0 where none is measured."""

    @property
    def sonic_c(self) -> float:
        """Temperature of dry air with the same speed of sound [deg C]."""
        return sonic_temperature_c(self.temperature_c, self.humidity_percent)


def source_in_words(source: str) -> str:
    """Where an `Air` comes from, for a person; a thermometer's file by the kernel's name of the device.

    Examples
    --------
    >>> source_in_words("/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"), source_in_words("/run/outside")
    ('from thermometer 1-0044', 'from thermometer outside')
    >>> source_in_words("SCALED_PRESSURE"), source_in_words(FIXED)
    ('from SCALED_PRESSURE', 'fixed in the airframe file')
    """
    if source in (FIXED, HELD):
        return "fixed in the airframe file" if source == FIXED else "an earlier value of a thermometer"
    if "/" not in source:
        return f"from {source}"
    device = re.search("/(?:devices|hwmon|thermal)/([^/]+)/", source)
    return f"from thermometer {device[1] if device else source.rpartition('/')[2]}"


def vapour_fraction(temperature_c: Numbers, humidity_percent: Numbers) -> Numbers:
    """Mole fraction of water vapour at one atmosphere, h p_sat(T) / p.

    p_sat = 610.94 Pa exp(17.625 t / (t + 243.04)) over water, t in deg C (Magnus; Alduchov and Eskridge 1996, Journal
    of Applied Meteorology 35, 601).

    Parameters
    ----------
    temperature_c, humidity_percent : float or ndarray
        Temperature [deg C], -40 to 60, and relative humidity [%].

    Returns
    -------
    float or ndarray
        Mole fraction, to 0.4 %; at 1000 m above the sea the pressure is lower and it is 13 % higher.
    """
    # A power stands for the exponential, so that arrays can enter without numpy.
    saturation_pa = 610.94 * math.e ** (17.625 * temperature_c / (temperature_c + 243.04))
    fraction: Numbers = humidity_percent / 100.0 * saturation_pa / STANDARD_PRESSURE_PA
    return fraction


def sonic_temperature_c(temperature_c: Numbers, humidity_percent: Numbers) -> Numbers:
    """Temperature of dry air with the speed of sound of this humid air, T_s = T (1 + 0.32 x), T in kelvin.

    Parameters
    ----------
    temperature_c, humidity_percent : float or ndarray
        Temperature [deg C], -40 to 60, and relative humidity [%]; x is their `vapour_fraction`.

    Returns
    -------
    float or ndarray
        Sonic temperature [deg C].

    Examples
    --------
    Saturated air at 30 deg C, in which sound is 0.7 % faster:

    >>> print(f"{sonic_temperature_c(30.0, 100.0):.1f}")
    34.1
    """
    vapour = vapour_fraction(temperature_c, humidity_percent)
    return temperature_c + SONIC_PER_VAPOUR * vapour * (temperature_c + ZERO_CELSIUS_K)


def speed_of_sound(temperature_c: Numbers) -> Numbers:
    """Speed of sound in dry air, c = sqrt(gamma R T / M), T in kelvin (report eq 6).

    Parameters
    ----------
    temperature_c : float or ndarray, any shape
        Air temperature [deg C], valid from -20 to 50; of humid air the sonic temperature. NaN gives NaN.

    Returns
    -------
    float or ndarray, same shape
        Speed [m/s]; with the temperature of saturated air at 30 deg C it is 0.7 % low.

    Raises
    ------
    ValueError
        At or below absolute zero, -273.15 deg C.

    Examples
    --------
    >>> print(f"{speed_of_sound(0.0):.1f}")
    331.3
    """
    absolute_k = _absolute_k(temperature_c)
    return _square_root(_SPEED_SQUARED_PER_K * absolute_k)


def compensate_range(range_m: Numbers, air_temperature_c: Numbers, calibration_temperature_c: float) -> Numbers:
    """Range compensated for the air temperature, r = r_m sqrt(T_T / T_C) (report eq 7).

    r_m is the reading, T_T the true air temperature and T_C the one that the sensor assumes, both in kelvin.

    Parameters
    ----------
    range_m : float or ndarray
        Range as the sensor reported it [m].
    air_temperature_c : float or ndarray
        Sonic temperature of the air between sensor and surface [deg C], valid from -20 to 50; arrays broadcast.
    calibration_temperature_c : float
        Temperature that the sensor's own conversion assumes [deg C], from its sensor model file: the report says
        20, the maker's pulse width implies 22.5 for the MB1242 (erratum 5).

    Returns
    -------
    float or ndarray
        Compensated range [m]: shorter than the reading in air colder than the calibration, longer in warmer air.

    Raises
    ------
    ValueError
        Either temperature is at or below absolute zero.

    Examples
    --------
    >>> print(f"{compensate_range(3.0, 0.0, 22.5):.3f}")
    2.884
    """
    ratio = _absolute_k(air_temperature_c) / _absolute_k(calibration_temperature_c)
    return range_m * _square_root(ratio)


def air_variance_m2(range_m: float, air: Air) -> float:
    """Variance of a compensated range's error from the air's temperature, (R / 2T)^2 var(T), T in kelvin.

    The derivative of eq 7 by the air's temperature. The error is common to all readings of all sensors, so it is
    added to the distance that is sent and not to a reading's own variance, which filters reduce by averaging.

    Parameters
    ----------
    range_m
        Compensated range R [m].
    air
        The air for which it was compensated.

    Returns
    -------
    float
        Variance [m^2].

    Examples
    --------
    5 m in air of 20 deg C, give or take 12 deg C:

    >>> print(f"{100 * math.sqrt(air_variance_m2(5.0, Air(20.0, 12.0, 'fixed'))):.1f} cm")
    10.2 cm
    """
    std_m = range_m * 0.5 * air.std_c / (air.temperature_c + ZERO_CELSIUS_K)
    return std_m * std_m


def air_error_m(range_m: float, air: Air) -> float:
    """Largest error of a range from the air temperature, with 95 % probability [m].

    It is that in the coldest air of ``air`` (1.96 standard deviations): in the warmest one a range errs less.
    """
    return compensate_range(range_m, air.temperature_c, coldest_c(air)) - range_m


def coldest_c(air: Air) -> float:
    """Lower end of the interval that contains the air's temperature with 95 % [deg C]."""
    return air.temperature_c - TWO_SIDED_95_PERCENT * air.std_c


def _absolute_k(temperature_c: Numbers) -> Numbers:
    absolute_k = temperature_c + ZERO_CELSIUS_K
    too_cold = absolute_k <= 0.0 if isinstance(absolute_k, int | float) else (absolute_k <= 0.0).any()
    if too_cold:
        coldest_c = temperature_c if isinstance(temperature_c, int | float) else temperature_c.min()
        raise ValueError(f"found a temperature of {coldest_c} deg C, expected one above absolute zero (-273.15 deg C)")
    return absolute_k


def _square_root(number: Numbers) -> Numbers:
    if isinstance(number, int | float):
        return math.sqrt(number)
    import numpy as np

    return np.sqrt(number)
