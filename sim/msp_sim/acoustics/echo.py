"""The level of an echo: over range, angle, target and air (report eq 2 and 5, corrected).

The level in decibels follows from a source level, a piston, a target and the air. All levels share one reference, such
as the sensor's own threshold: breakaway angles cannot distinguish a loud source from a sensitive receiver.
"""

import math
from dataclasses import dataclass

from msp_sim.acoustics.absorption import absorption_db_per_m
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.acoustics.materials import reflection_coefficient
from msp_sim.acoustics.piston import directivity_db
from msp_sim.acoustics.spreading import small_target_spreading, wall_spreading


@dataclass(frozen=True)
class Target:
    """The surface that reflects the sound.

    Parameters
    ----------
    impedance_rayl
        Acoustic impedance [Pa s/m]; infinite: a perfect mirror.
    cross_section_m2
        Backscattering cross section of a small target [m^2]; None: a large flat wall.
    """

    impedance_rayl: float = math.inf
    cross_section_m2: float | None = None

    def reflection_db(self, air: Atmosphere) -> float:
        """10 log10 of `reflection_coefficient` [dB]."""
        if math.isinf(self.impedance_rayl):
            return 0.0
        share = reflection_coefficient(air.impedance_rayl, self.impedance_rayl)
        return 10.0 * math.log10(share) if share > 0.0 else -math.inf

    def spreading_db(self, range_m: float) -> float:
        """Echo intensity relative to that at 1 m from the source, for spreading alone [dB].

        10 log10(4 pi S), S of `wall_spreading` or `small_target_spreading`: at 1 m the power is distributed over
        4 pi (1 m)^2.
        """
        if self.cross_section_m2 is None:
            spread = wall_spreading(range_m)
        else:
            spread = small_target_spreading(range_m, self.cross_section_m2)
        return 10.0 * math.log10(4.0 * math.pi * spread)


WALL = Target()
"""A large, flat, smooth wall that reflects everything."""


def echo_level_db(
    source_level_db: float,
    range_m: float,
    off_axis_rad: float,
    target: Target,
    air: Atmosphere,
    piston_diameter_m: float,
    frequency_hz: float,
) -> float:
    """EL = SL + 2 P(theta) + spreading + reflection - alpha 2 R (report eq 5, corrected, in dB).

    As intensities, I = Gamma I_max b(theta)^2 S exp(-2 alpha R): b is the piston's directivity, which the ping passes
    on its way out and the echo on its way in; S is the spreading. The path is 2 R, so the 2 in the exponent is the way
    there and back and alpha is the intensity's coefficient; with the amplitude's it would be exp(-4 alpha R)
    (erratum 10 asks which). In dB there is no such choice: alpha is in dB/m.

    Parameters
    ----------
    source_level_db
        Level on the axis at 1 m from the source [dB over any reference, which the result shares].
    range_m
        To a small target, or perpendicular to a wall; above 0 [m].
    off_axis_rad
        Between the axis and the target, or the wall's normal, -pi/2 to pi/2 [rad].
    target, air
        The reflecting surface, and the air in between.
    piston_diameter_m, frequency_hz
        Properties of the transducer [m], [Hz].

    Returns
    -------
    float
        [dB]; minus infinity at a null of the piston.

    Raises
    ------
    ValueError
        The range is not above 0, or the angle is behind the sensor.

    Examples
    --------
    Twice as far from a wall: 6.0 dB of spreading, and 1.39 dB for each of 2 m more of air.

    >>> levels_db = [echo_level_db(0.0, r, 0.0, WALL, Atmosphere(), 0.0136, 42_000.0) for r in (1.0, 2.0)]
    >>> print(f"{levels_db[0] - levels_db[1]:.1f} dB")
    8.8 dB
    """
    return (
        source_level_db
        + 2.0 * directivity_db(off_axis_rad, piston_diameter_m, air.wavelength_m(frequency_hz))
        + target.spreading_db(range_m)
        + target.reflection_db(air)
        - 2.0 * range_m * absorption_db_per_m(frequency_hz, air)
    )
