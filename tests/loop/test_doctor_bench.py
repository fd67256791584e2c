"""`msp-range doctor --bench` on this computer: the figures are there and of a sensible size."""

import re

import pytest

from msp_range.doctor import bench
from msp_range.doctor.command import text_of
from msp_range.terminal import wrapped
from tests.support.shipped import CONFIGS
from tests.support.slow import slow


@pytest.mark.real_time
@pytest.mark.parametrize("airframe", ["quad_pallet", *slow("lidar_down", "proximity")])
def test_the_figures(airframe: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "BENCH_S", 1.5)
    findings = {each.step: each for each in bench.measure(CONFIGS / f"{airframe}.yaml")}
    assert findings.keys() == {"start", "processor", "delay", "schedule", "memory"}
    figures = {step: float(match[0]) for step, each in findings.items() if (match := re.search(r"[\d.]+", each.text))}
    assert 0.05 < figures["start"] < 20.0
    assert 0.01 < figures["processor"] < 100.0
    assert "readings a second" in findings["processor"].text
    assert not re.search("at 0.0 readings", findings["processor"].text)
    assert 5.0 < figures["memory"] < 2000.0
    assert all(len(line) <= 80 for each in findings.values() for line in wrapped(text_of(each)))
