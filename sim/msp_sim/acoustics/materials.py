"""Reflection of sound by a surface, from its acoustic impedance, and the impedances and roughness of typical ground.

The reflected share of the intensity follows from impedances in rayl (Pa s/m) (report eq 4). The table gives the source
and uncertainty of each number. In air, solids and water reflect all but 0.2 % or less, so their impedances need not be
accurate. For porous ground the impedance matters, and little is known about it at 42 kHz. The values are typical ones
from the works named, accurate to two digits at most.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

TORTUOSITY_EXPONENT = 0.5
"""q^2 = Omega^-n' with n' = 0.5, for packed grains (Attenborough 1985, J. Sound Vib. 99, 521)."""


@dataclass(frozen=True)
class Material:
    """A surface.

    Parameters
    ----------
    impedance_rayl
        Characteristic impedance, real [Pa s/m].
    source
        Where the number comes from.
    doubt
        Its uncertainty, and the effect on the echo.
    rms_m
        Root mean square of the height relative to the mean surface [m]; 0: smooth, an eighth of the 8 mm of a
        wavelength or less.
    length_m
        Typical distance between two bumps [m].
    roughness_source
        Where the two come from.
    """

    impedance_rayl: float
    source: str
    doubt: str
    rms_m: float = 0.0
    length_m: float = 0.3
    roughness_source: str = "assumed: smooth"


def reflection_coefficient(medium_rayl: float, target_rayl: float) -> float:
    """Share of the intensity that is reflected, ((Z_m - Z_T) / (Z_m + Z_T))^2 (report eq 4).

    An intensity coefficient: the pressure's is its root (erratum 4). Valid at normal incidence, on a smooth surface
    thicker than the length of the pulse in it; up to 23 deg from the normal a hard surface's is the same to 0.1 %.

    Parameters
    ----------
    medium_rayl, target_rayl
        Impedances of the medium and of the surface, above 0 [Pa s/m].

    Returns
    -------
    float
        0 to 1.

    Raises
    ------
    ValueError
        An impedance is not above 0.

    Examples
    --------
    From air to water, and how little it would matter to be wrong by half:

    >>> print(f"{reflection_coefficient(413.0, 1.48e6):.4f} {reflection_coefficient(413.0, 0.74e6):.4f}")
    0.9989 0.9978
    """
    for impedance_rayl in (medium_rayl, target_rayl):
        if not impedance_rayl > 0.0:
            raise ValueError(f"found an impedance of {impedance_rayl:g} rayl, expected more than 0")
    return ((medium_rayl - target_rayl) / (medium_rayl + target_rayl)) ** 2


def porous_impedance_rayl(air_rayl: float, porosity: float) -> float:
    """High-frequency limit of a rigid porous ground, Z = Z_air q / Omega with q^2 = Omega^-0.5.

    Attenborough 1985 (J. Sound Vib. 99, 521). Valid well above sigma Omega / (2 pi rho q^2), where the air in the pores
    moves by its inertia and not by friction: about 2 kHz for snow, 10 kHz for the soil under grass. One-parameter
    models of flow resistivity (Delany-Bazley, Miki) were fitted to some kilohertz and do not reach 42 kHz.

    Parameters
    ----------
    air_rayl
        Impedance of the air [Pa s/m].
    porosity
        Omega, share of the volume that is air and open to the surface, above 0 and at most 1.

    Returns
    -------
    float
        [Pa s/m].

    Raises
    ------
    ValueError
        The porosity is out of its bounds.
    """
    if not 0.0 < porosity <= 1.0:
        raise ValueError(f"found a porosity of {porosity:g}, expected more than 0 and at most 1")
    tortuosity: float = porosity**-TORTUOSITY_EXPONENT
    return air_rayl * math.sqrt(tortuosity) / porosity


def _porous(porosity: float) -> float:
    return porous_impedance_rayl(413.2, porosity)


MATERIALS: Mapping[str, Material] = MappingProxyType(
    {
        "plywood": Material(
            600.0 * 1300.0,
            "600 kg/m^3 and 1300 m/s through the sheet: USDA Wood Handbook, speed across the grain a fifth to a third "
            "of the 3000-6100 m/s along it",
            "a factor of 2; 0.02 dB",
        ),
        "asphalt": Material(
            2350.0 * 3300.0,
            "2350 kg/m^3 and 3300 m/s, the middle of 2500-4000 m/s for ultrasound in dense mixes; usual values, no one "
            "source",
            "a factor of 1.5, less when hot; 0.002 dB. Open-graded asphalt is porous and rough, and unknown",
        ),
        "concrete": Material(
            2600.0 * 3100.0,
            "Kinsler and others, Fundamentals of Acoustics, 4th edition, table A10(a): 2600 kg/m^3, bulk 3100 m/s",
            "a factor of 1.5; 0.001 dB",
        ),
        "water": Material(
            998.2 * 1482.3,
            "998.2 kg/m^3 and 1482.3 m/s at 20 deg C (Kaye and Laby; Del Grosso and Mader 1972)",
            "1 %; no effect. Waves and ripples, which tilt the surface, are not included",
        ),
        "grass": Material(
            _porous(0.5),
            "porosity 0.5 of the soil under a lawn (Attenborough 1985 and after), by porous_impedance_rayl at 20 deg C",
            "poorly known: 0.4 to 0.7 give -6 to -13 dB. Blades of grass are as wide as the wavelength and scatter; "
            "no measurement at 42 kHz was found",
            0.01,
            0.1,
            "assumed: a lawn cut to 5 cm, as in configs/campaigns/future.yaml; tufts of 3 cm are in rough_grass.yaml",
        ),
        "dirt": Material(
            _porous(0.4),
            "assumed: porosity 0.4 of dry earth, by porous_impedance_rayl at 20 deg C",
            "poorly known: 0.3 to 0.5 give -4 to -8 dB; wet or trodden earth reflects more",
            0.005,
            0.1,
            "assumed: raked even",
        ),
        "gravel": Material(
            2700.0 * 5000.0,
            "assumed: the stones are granite, 2700 kg/m^3 and 5000 m/s; usual values, no one source",
            "a factor of 2; 0.001 dB from a stone's face. Stones longer than the wavelength scatter, and are no porous "
            "medium at 42 kHz: how much comes back from a bed of them is unknown",
            0.01,
            0.05,
            "assumed: a third of the size of stones of 2 to 4 cm, as in configs/campaigns/future.yaml",
        ),
        "snow": Material(
            _porous(1.0 - 300.0 / 917.0),
            "settled snow of 300 kg/m^3 over ice of 917, by porous_impedance_rayl at 20 deg C. Gudra and Najwer 2011 "
            "(Acta Phys. Pol. A 120, 625) found at 40 kHz that the reflection grows linearly with density, 120 to 700",
            "poorly known: 100 kg/m^3 (new) gives -23 dB, 500 (old) -6 dB; a crust of ice reflects as a solid",
            0.01,
            0.5,
            "assumed: settled snow in the wind",
        ),
        "foam": Material(
            _porous(0.97),
            "assumed: porosity 0.97 of open-cell foam, by porous_impedance_rayl at 20 deg C",
            "poorly known: 0.95 to 0.99 give -30 to -44 dB, and foam whose cells are closed reflects nearly all",
        ),
    }
)
"""Surfaces by name. The echo is weaker than a perfect mirror's by 10 log10 of `reflection_coefficient`."""


def find_material(name: str) -> Material:
    """The surface of this name; raises ValueError with the names that there are."""
    if name not in MATERIALS:
        raise ValueError(f"found {name!r}; expected one of {', '.join(MATERIALS)}")
    return MATERIALS[name]
