"""Decrease of an echo with range: for a small target, a wall, and a plate between the two.

The functions give the echo's intensity at the sensor divided by the power of an isotropic source of the same level.
`msp_sim.acoustics.echo` converts it to decibels and adds absorption, directivity and reflection.
The report's eq 2 and 5 have 16 pi R^4, which is (4 pi R^2)^2 with a pi lost, and use it for walls too (erratum 2).
"""

import math


def small_target_spreading(range_m: float, cross_section_m2: float) -> float:
    """Spreading to an isotropic scatterer and back, sigma / (4 pi R^2)^2 = sigma / (16 pi^2 R^4) (report eq 2,
    corrected).

    Valid where the target is smaller than the first Fresnel zone, of radius sqrt(lambda R / 2): 9 cm at 2 m and
    42 kHz. Twice the range is 12 dB less.

    Parameters
    ----------
    range_m
        Above 0 [m].
    cross_section_m2
        Backscattering cross section sigma, above 0 [m^2].

    Returns
    -------
    float
        Echo intensity over radiated power [1/m^2].

    Raises
    ------
    ValueError
        An argument is not above 0.
    """
    _refuse_none(range_m, "range", "m")
    _refuse_none(cross_section_m2, "cross section", "m^2")
    return cross_section_m2 / (16.0 * math.pi**2 * range_m**4)


def wall_spreading(range_m: float) -> float:
    """Spreading from the sensor's mirror image behind a large flat wall, 1 / (4 pi (2 R)^2) (erratum 2).

    Valid where the wall is flat to a fraction of a wavelength and larger than the first Fresnel zone about the foot of
    the perpendicular. Twice the range is 6 dB less.

    Parameters
    ----------
    range_m
        Perpendicular distance, above 0 [m].

    Returns
    -------
    float
        Echo intensity over radiated power [1/m^2].

    Raises
    ------
    ValueError
        The range is not above 0.
    """
    _refuse_none(range_m, "range", "m")
    return 1.0 / (4.0 * math.pi * (2.0 * range_m) ** 2)


def plate_cross_section_m2(area_m2: float, wavelength_m: float) -> float:
    """Backscattering cross section of a flat plate that faces the sensor, sigma = 4 pi A^2 / lambda^2.

    Physical optics (for instance Skolnik, Introduction to Radar Systems, table of cross sections); valid for sides of
    several wavelengths and beyond 2 A / lambda. Nearer than that the plate answers as a wall does, see
    `plate_spreading`.

    Parameters
    ----------
    area_m2, wavelength_m
        Above 0 [m^2], [m].

    Returns
    -------
    float
        [m^2].

    Raises
    ------
    ValueError
        An argument is not above 0.
    """
    _refuse_none(area_m2, "area", "m^2")
    _refuse_none(wavelength_m, "wavelength", "m")
    return 4.0 * math.pi * (area_m2 / wavelength_m) ** 2


def plate_spreading(range_m: float, area_m2: float, wavelength_m: float) -> float:
    """Spreading by a flat plate that faces the sensor: the lesser of `wall_spreading` and the plate's far field.

    Both are asymptotes and meet at R = 2 A / lambda; about there the true echo swings by several dB about them.

    Examples
    --------
    The report's plates are walls at every range of the sensor: the 8 inch one up to 10 m at 42 kHz, the 40 by 24 inch
    one up to 150 m.

    >>> inch_m, wavelength_m = 0.0254, 343.2 / 42_000
    >>> [f"{2 * width * height * inch_m**2 / wavelength_m:.0f} m" for width, height in ((8, 8), (40, 24))]
    ['10 m', '152 m']
    """
    far = small_target_spreading(range_m, plate_cross_section_m2(area_m2, wavelength_m))
    return min(wall_spreading(range_m), far)


def _refuse_none(value: float, what: str, unit: str) -> None:
    if not value > 0.0:
        raise ValueError(f"found a {what} of {value:g} {unit}, expected more than 0")
