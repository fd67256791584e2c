"""A short soak: the command flies, judges and writes its report."""

from pathlib import Path

import pytest

from evaluation.soak.command import growth_percent, simulated
from evaluation.soak.vehicle import Judge, Vehicle
from msp_range.clock import VirtualClock


def test_a_bridge_that_follows_another_height_is_judged_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the judge is for: without it a soak would always pass."""
    vehicle = Vehicle(VirtualClock(), 1, 0.0, None)
    vehicle.fly(20.0)
    assert vehicle.judge.wrong == 0
    assert vehicle.judge.messages > 150
    assert vehicle.judge.delays.quantile_ms(1.0) < 10.0
    monkeypatch.setattr(Vehicle, "_reading_cm", lambda self, true_m: 100 + round(100 * true_m))
    vehicle = Vehicle(VirtualClock(), 1, 0.0, None)
    vehicle.fly(20.0)
    assert vehicle.judge.wrong > 10
    assert isinstance(vehicle.judge, Judge)


def test_growth_counts_from_the_end_of_the_first_hour() -> None:
    assert growth_percent([(0.0, 50.0), (1.0, 60.0), (2.0, 63.0), (3.0, 61.0)]) == pytest.approx(5.0)
    assert growth_percent([(0.0, 50.0), (0.5, 60.0)]) is None


@pytest.mark.slow
def test_memory_stays_flat_and_no_distance_is_wrong(tmp_path: Path) -> None:
    lines, is_good = simulated(1.5, 2, tmp_path)
    assert is_good, "\n".join(lines)
