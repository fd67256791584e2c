"""Absorption of sound in air against table 1 of ISO 9613-1, to its three digits, and beyond 10 kHz."""

import pytest

from msp_sim.acoustics.absorption import absorption_db_per_m
from msp_sim.acoustics.atmosphere import Atmosphere

TABLE_1 = [
    # Temperature [deg C], humidity [%], preferred frequency's number k, [dB/km].
    *[(-20, 10, -13, 0.589), (-20, 70, -9, 0.514), (-20, 10, 0, 1.65), (-20, 50, 6, 13.2), (-20, 100, 9, 41.1)],
    *[(-10, 10, 0, 4.65), (-10, 100, 0, 5.91), (-10, 70, 9, 86.2), (0, 30, -9, 0.469), (0, 15, 0, 18.3)],
    *[(0, 70, 0, 4.64), (0, 10, 9, 26.4), (10, 10, 0, 21.6), (10, 50, 0, 4.26), (10, 70, 6, 32.8)],
    *[(20, 100, -13, 0.0403), (20, 10, 0, 14.1), (20, 70, 0, 4.98), (20, 10, 6, 109.0), (20, 10, 7, 133.0)],
    *[(20, 80, 7, 30.6), (20, 15, 8, 175.0), (20, 80, 10, 105.0), (30, 50, 0, 7.03), (30, 10, 6, 96.0)],
    *[(35, 70, 0, 8.30), (40, 10, 0, 7.68), (50, 10, -10, 0.584), (50, 70, 6, 48.2), (50, 10, 9, 155.0)],
]


@pytest.mark.parametrize(("temperature_c", "humidity_percent", "k", "published_db_per_km"), TABLE_1)
def test_absorption_is_that_of_the_standards_table(
    temperature_c: float, humidity_percent: float, k: int, published_db_per_km: float
) -> None:
    # The table is for the exact frequencies 1000 * 10^(k/10) Hz and has three digits.
    computed = 1e3 * absorption_db_per_m(1e3 * 10 ** (k / 10), Atmosphere(temperature_c, humidity_percent))
    assert f"{computed:.2e}" == f"{published_db_per_km:.2e}"


def test_absorption_far_above_relaxation_is_classical() -> None:
    """At 10 MHz what is left is 8.686 * 1.84e-11 f^2, 0.16 dB/m per kHz^2 of a million, to the relaxations' 1 %."""
    assert absorption_db_per_m(1e7, Atmosphere(20, 0)) == pytest.approx(8.686 * 1.84e-11 * 1e14, rel=0.01)


def test_absorption_at_the_sensors_frequency() -> None:
    """1.3 dB/m is the rule of thumb for 40 kHz in a room; cold and dry air take less."""
    assert absorption_db_per_m(40e3, Atmosphere(20, 50)) == pytest.approx(1.3, abs=0.05)
    assert absorption_db_per_m(42e3, Atmosphere(20, 50)) == pytest.approx(1.39, abs=0.005)
    assert absorption_db_per_m(42e3, Atmosphere(0, 50)) < 0.5
    assert absorption_db_per_m(42e3, Atmosphere(20, 10)) < 0.5


def test_absorption_over_pressure_depends_on_frequency_over_pressure() -> None:
    """Relaxation frequencies are in proportion to pressure where the vapour's share stays the same."""
    low = absorption_db_per_m(21e3, Atmosphere(20, 25, 101_325 / 2))
    assert 2 * low == pytest.approx(absorption_db_per_m(42e3, Atmosphere(20, 50)), rel=1e-12)


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, float("nan")])
def test_no_frequency_is_refused(frequency_hz: float) -> None:
    with pytest.raises(ValueError, match="expected more than 0"):
        absorption_db_per_m(frequency_hz, Atmosphere())
