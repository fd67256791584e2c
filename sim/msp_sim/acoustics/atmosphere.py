"""Air with its humidity and pressure: density, impedance, wavelength.

This file is for absorption and echo levels; what humidity does to the speed of sound is in `msp_range.acoustics.air`.
"""

import math
from dataclasses import dataclass

from msp_range.acoustics.air import (
    GAS_CONSTANT_J_PER_MOL_K,
    MOLAR_MASS_KG_PER_MOL,
    STANDARD_PRESSURE_PA,
    ZERO_CELSIUS_K,
    speed_of_sound,
)


@dataclass(frozen=True)
class Atmosphere:
    """Uniform air.

    Parameters
    ----------
    temperature_c
        [deg C], -20 to 50.
    humidity_percent
        Relative humidity over water [%], 0 to 100.
    pressure_pa
        Static pressure [Pa], above 0.

    Raises
    ------
    ValueError
        A value out of these bounds.

    Examples
    --------
    >>> room = Atmosphere()
    >>> print(f"{room.impedance_rayl:.0f} {1e3 * room.wavelength_m(42_000.0):.2f} mm")
    413 8.17 mm
    """

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_pa: float = STANDARD_PRESSURE_PA

    def __post_init__(self) -> None:
        if not -20.0 <= self.temperature_c <= 50.0:
            raise ValueError(f"found an air temperature of {self.temperature_c:g} deg C, expected -20 to 50")
        if not 0.0 <= self.humidity_percent <= 100.0:
            raise ValueError(f"found a relative humidity of {self.humidity_percent:g} %, expected 0 to 100")
        if not 0.0 < self.pressure_pa < math.inf:
            raise ValueError(f"found a pressure of {self.pressure_pa:g} Pa, expected more than 0")

    @property
    def absolute_k(self) -> float:
        """Temperature [K]."""
        return self.temperature_c + ZERO_CELSIUS_K

    @property
    def density_kg_m3(self) -> float:
        """rho = p M / (R T) of dry air as an ideal gas [kg/m^3]; saturated air at 30 deg C is 1.6 % lighter."""
        return self.pressure_pa * MOLAR_MASS_KG_PER_MOL / (GAS_CONSTANT_J_PER_MOL_K * self.absolute_k)

    @property
    def impedance_rayl(self) -> float:
        """Characteristic impedance Z = rho c [Pa s/m], c of dry air (report eq 6)."""
        return self.density_kg_m3 * speed_of_sound(self.temperature_c)

    def wavelength_m(self, frequency_hz: float) -> float:
        """lambda = c / f [m], c of dry air (report eq 6)."""
        return speed_of_sound(self.temperature_c) / frequency_hz
