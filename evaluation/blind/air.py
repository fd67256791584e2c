"""Air: how fast sound crosses it and how much of it is left. Temperatures [deg C] enter, m/s and dB/m leave."""

import numpy as np
from numpy.typing import ArrayLike

from evaluation.blind.sound import Array

GAS_CONSTANT = 8.314462618
STANDARD_PRESSURE_PA = 101_325.0


def vapour_fraction(
    temperature_c: ArrayLike, humidity_pct: ArrayLike, pressure_pa: float = STANDARD_PRESSURE_PA
) -> Array:
    """Mole fraction of water vapour, with saturation after Magnus (Sonntag 1990)."""
    t = np.asarray(temperature_c, dtype=float)
    saturation_pa = 611.2 * np.exp(17.62 * t / (243.12 + t))
    return np.asarray(humidity_pct, dtype=float) / 100.0 * saturation_pa / pressure_pa


def speed_m_s(temperature_c: ArrayLike, humidity_pct: ArrayLike = 50.0) -> Array:
    """Speed of sound in air of this temperature and relative humidity."""
    return _of_mixture_m_s(temperature_c, vapour_fraction(temperature_c, humidity_pct))


def _of_mixture_m_s(temperature_c: ArrayLike, x: Array) -> Array:
    """sqrt(gamma R T / M) of an ideal mixture: dry air with 7/2 R of heat capacity, water vapour with 4 R."""
    heat_capacity = 3.5 * (1.0 - x) + 4.0 * x
    gamma = heat_capacity / (heat_capacity - 1.0)
    molar_mass = 0.0289647 * (1.0 - x) + 0.0180153 * x
    kelvin = np.asarray(temperature_c, dtype=float) + 273.15
    return np.sqrt(gamma * GAS_CONSTANT * kelvin / molar_mass)


def mean_slowness_s_m(near_c: ArrayLike, far_c: ArrayLike, humidity_pct: ArrayLike = 50.0) -> Array:
    """Mean of 1 / c along a path whose temperature changes evenly from one end to the other.

    The humidity is that at the near end. Air that the ground warms keeps its water, and its relative humidity falls.
    """
    near, far = np.broadcast_arrays(np.asarray(near_c, dtype=float), np.asarray(far_c, dtype=float))
    places, weights = np.polynomial.legendre.leggauss(4)
    water, total = vapour_fraction(near, humidity_pct), np.zeros(near.shape)
    for place, weight in zip(places, weights, strict=True):
        share = 0.5 * (place + 1.0)
        total = total + 0.5 * weight / _of_mixture_m_s(near + share * (far - near), water)
    return total


def boxed_slowness_s_m(box_c: ArrayLike, room_c: ArrayLike, range_m: ArrayLike, box_m: float, blur_m: float) -> Array:
    """Mean of 1 / c where air of one temperature fills a box before the sensor, and the room's is beyond.

    The temperature falls as a logistic step of width `blur_m` at `box_m`, through which it is integrated.
    """
    box, room, length = np.broadcast_arrays(*(np.asarray(each, dtype=float) for each in (box_c, room_c, range_m)))
    places, weights = np.polynomial.legendre.leggauss(24)
    total = np.zeros(length.shape)
    # Half of the nodes before and half beyond a split at the box's end, so that a long path does not thin them there.
    split = np.minimum(length, box_m + 4.0 * blur_m)
    for start, end in ((np.zeros(length.shape), split), (split, length)):
        for place, weight in zip(places, weights, strict=True):
            depth = start + 0.5 * (place + 1.0) * (end - start)
            temperature = room + (box - room) / (1.0 + np.exp(np.clip((depth - box_m) / blur_m, -60.0, 60.0)))
            total = total + 0.5 * weight * (end - start) / speed_m_s(temperature)
    found: Array = total / length
    return found


def absorption_db_m(temperature_c: ArrayLike, humidity_pct: ArrayLike = 50.0, frequency_hz: float = 42_000.0) -> Array:
    """Attenuation by ISO 9613-1 at one atmosphere."""
    kelvin = np.asarray(temperature_c, dtype=float) + 273.15
    ratio = kelvin / 293.15
    h = 100.0 * vapour_fraction(temperature_c, humidity_pct)
    oxygen_hz = 24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h)
    nitrogen_hz = ratio**-0.5 * (9.0 + 280.0 * h * np.exp(-4.17 * (ratio ** (-1.0 / 3.0) - 1.0)))
    square = frequency_hz**2
    oxygen = 0.01275 * np.exp(-2239.1 / kelvin) * oxygen_hz / (oxygen_hz**2 + square)
    nitrogen = 0.1068 * np.exp(-3352.0 / kelvin) * nitrogen_hz / (nitrogen_hz**2 + square)
    found: Array = 8.686 * square * (1.84e-11 * np.sqrt(ratio) + ratio**-2.5 * (oxygen + nitrogen))
    return found
