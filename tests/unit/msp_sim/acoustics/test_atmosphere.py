"""Air with humidity and pressure against Cramer 1993 and handbook values."""

import math

import pytest

from msp_range.acoustics.air import speed_of_sound
from msp_sim.acoustics.atmosphere import Atmosphere
from tests.support.humid_air import speed_of_sound_humid


@pytest.mark.parametrize(
    ("temperature_c", "humidity_percent", "published_m_s"),
    [
        # Read off figure 1 of Cramer 1993, 314 ppm CO2; to 0.15 m/s, which is the width of its lines.
        *[(0, 30.174, 331.627), (0, 60.032, 331.706), (0, 99.526, 331.905), (10, 30.332, 337.698)],
        *[(10, 60.19, 337.857), (10, 99.21, 338.175), (20, 30.174, 343.730), (20, 60.19, 344.167)],
        *[(20, 98.736, 344.683), (30, 30.332, 349.881), (30, 60.19, 350.556), (30, 98.894, 351.508)],
    ],
)
def test_speed_with_humidity_is_that_of_cramers_figure(
    temperature_c: float, humidity_percent: float, published_m_s: float
) -> None:
    speed_m_s = speed_of_sound_humid(Atmosphere(temperature_c, humidity_percent), 314e-6)
    assert speed_m_s == pytest.approx(published_m_s, abs=0.15)


def test_dry_air_at_0_c_is_331_45() -> None:
    assert speed_of_sound_humid(Atmosphere(0, 0), 314e-6) == pytest.approx(331.45, abs=0.006)


@pytest.mark.parametrize("temperature_c", [0.0, 10.0, 20.0, 30.0])
def test_dry_air_agrees_with_the_ideal_gas(temperature_c: float) -> None:
    humid_m_s = speed_of_sound_humid(Atmosphere(temperature_c, 0.0))
    assert humid_m_s == pytest.approx(speed_of_sound(temperature_c), rel=6e-4)


@pytest.mark.parametrize(("pressure_pa", "published_m_s"), [(75_212, 343.304), (85_089, 343.348), (95_018, 343.393)])
def test_pressure_hardly_counts(pressure_pa: float, published_m_s: float) -> None:
    speed_m_s = speed_of_sound_humid(Atmosphere(20, 0, pressure_pa), 314e-6)
    assert speed_m_s == pytest.approx(published_m_s, abs=0.1)
    assert speed_m_s < speed_of_sound_humid(Atmosphere(20, 0), 314e-6)


@pytest.mark.parametrize("air", [Atmosphere(-0.1), Atmosphere(30.1), Atmosphere(20, 50, 74e3), Atmosphere(20, 50, 2e5)])
def test_no_humid_speed_outside_of_its_fit(air: Atmosphere) -> None:
    with pytest.raises(ValueError, match="no humid speed of sound is known"):
        speed_of_sound_humid(air)


def test_density_and_impedance_are_the_handbooks() -> None:
    # Kinsler and others, table A10: 1.21 kg/m^3, 415 rayl at 20 deg C with c = 343; 1.293 and 429 at 0 deg C.
    assert Atmosphere(20).density_kg_m3 == pytest.approx(1.205, abs=0.006)
    assert Atmosphere(0).density_kg_m3 == pytest.approx(1.293, abs=0.001)
    assert Atmosphere(20).impedance_rayl == pytest.approx(415, abs=2.5)
    assert Atmosphere(0).impedance_rayl == pytest.approx(428.5, abs=0.6)
    assert Atmosphere(20).wavelength_m(42e3) == pytest.approx(8.17e-3, abs=5e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((-20.5,), r"found an air temperature of -20\.5 deg C, expected -20 to 50"),
        ((20, 101), r"found a relative humidity of 101 %, expected 0 to 100"),
        ((20, 50, 0), r"found a pressure of 0 Pa, expected more than 0"),
        ((math.nan,), r"expected -20 to 50"),
    ],
)
def test_impossible_air_is_refused(values: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Atmosphere(*values)
