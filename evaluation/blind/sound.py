"""Sound: a piston's beam, a burst's envelope, what comes back from a mirror of finite size.

Angles, sizes and times enter, complex amplitudes relative to those of an endless mirror leave.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fresnel, j1

Array = NDArray[np.floating[Any]]
Complex = NDArray[np.complex128]

HEARING_PA = 20e-6


def pascal(level_db: ArrayLike) -> Array:
    """Rms pressure of a sound pressure level re 20 uPa."""
    return HEARING_PA * 10.0 ** (np.asarray(level_db, dtype=float) / 20.0)


def piston(angle_rad: ArrayLike, diameter_m: float, wavelength_m: ArrayLike) -> Array:
    """Pressure off the axis of a flat circular piston in a baffle, 1 on the axis; 2 J1(x) / x."""
    x = np.pi * diameter_m / np.asarray(wavelength_m, dtype=float) * np.sin(np.abs(np.asarray(angle_rad, dtype=float)))
    x = np.maximum(x, 1e-9)
    found: Array = np.abs(2.0 * j1(x) / x)
    return found


def burst(delay: NDArray[np.floating], rise_s: float, length_s: float) -> NDArray[np.floating]:
    """Envelope of a burst that rang one transducer up on the way out and again on the way back; 1 when steady.

    Parameters
    ----------
    delay
        Time since its first edge [s].
    rise_s
        Time constant of the transducer.
    length_s
        How long it is driven.
    """
    return _step(delay / rise_s) - _step((delay - length_s) / rise_s)


def _step(x: NDArray[np.floating]) -> NDArray[np.floating]:
    x = np.maximum(x, 0.0)
    found: NDArray[np.floating] = 1.0 - (1.0 + x) * np.exp(-x)
    return found


def edge(distance: ArrayLike) -> Complex:
    """Share of a mirror's echo that a half-plane gives, less its geometrical share of 0 or 1 (Fresnel's integrals).

    Parameters
    ----------
    distance
        From the mirror point to the edge in units of sqrt(wavelength x range) / 2, above 0 where the plane covers it.
    """
    u = np.asarray(distance, dtype=float)
    sine, cosine = fresnel(u)
    found: Complex = 0.5 * (np.sqrt(2.0) * np.exp(-0.25j * np.pi) * (cosine + 1j * sine) - np.sign(u))
    return found


def plate(
    range_m: ArrayLike, half_width_m: ArrayLike, half_height_m: ArrayLike, tilt_rad: ArrayLike, wavelength_m: ArrayLike
) -> tuple[Complex, Array]:
    """Echo of a rectangular mirror: its geometrical reflection and the waves from its edges, each with its delay.

    Parameters
    ----------
    range_m
        From the sensor to the middle of the plate, shape (n,).
    half_width_m, half_height_m
        Of the plate; infinite for a wall.
    tilt_rad
        Of the plate against the line of sight, about its vertical axis.
    wavelength_m
        Of the sound.

    Returns
    -------
    amplitudes : complex ndarray, shape (n, 6)
        Relative to an endless mirror's.
    ways_m : ndarray, shape (n, 6)
        What each is late, as one-way distance.
    """
    columns = (range_m, half_width_m, half_height_m, tilt_rad, wavelength_m)
    r, a, b, tilt, wavelength = np.broadcast_arrays(*(np.atleast_1d(np.asarray(each, dtype=float)) for each in columns))
    unit = 2.0 / np.sqrt(wavelength * r)
    foot = r * np.sin(tilt)
    across = []
    geometric = np.zeros(r.shape)
    for side in (a - foot, a + foot):
        finite = np.isfinite(side)
        reach = np.where(finite, side, 0.0)
        across.append((np.where(finite, edge(unit * reach), 0.0), reach**2 / (2.0 * r)))
        geometric += 0.5 * np.where(finite, np.sign(reach), 1.0)
    tall = np.isfinite(b)
    height = np.where(tall, b, 0.0)
    # Both edges of the height are alike, and one arrival stands for the two.
    vertical = (np.where(tall, 2.0 * edge(unit * height), 0.0), height**2 / (2.0 * r))
    amplitudes, ways = [], []
    for amplitude, way in ((geometric + 0j, np.zeros(r.shape)), *across):
        amplitudes += [amplitude, amplitude * vertical[0]]
        ways += [way, way + vertical[1]]
    return np.stack(amplitudes, axis=1), np.stack(ways, axis=1)
