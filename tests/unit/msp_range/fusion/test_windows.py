"""Time windows follow the polling: one sensor or eight, 0.05 to 10 s apart, keep a stream alive."""

import random
from itertools import pairwise

import pytest

from msp_range.assembly import intervals_s, windows_of
from msp_range.config import load_airframe
from msp_range.fusion import Windows
from tests.support.bench import FOUR_DOWN, FUSED_ID, Bench, airframe, sensor
from tests.support.shipped import CONFIGS
from tests.support.slow import slow_but

CORNERS = [(0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2)]


def pallet(sensors: int, interval_s: float) -> Bench:
    """So many sensors that look down at 3 m, each alone in its slot, with some noise."""
    draw = random.Random(sensors)
    content = [
        sensor(f"s{number}", number) | {"position_m": [*CORNERS[number % 4], 0.0]} for number in range(1, sensors + 1)
    ]
    vehicle = airframe(content, polling={"ping_interval_s": interval_s})
    return Bench(vehicle, lambda name, time_s: 300 + round(draw.gauss(0.0, 1.5)))


@pytest.mark.parametrize("sensors", slow_but({1, 4, 8}, range(1, 9)))
@pytest.mark.parametrize("interval_s", [0.05, 0.1, 0.5, 2.0, 10.0])
def test_the_fused_stream_lives_at_every_polling(sensors: int, interval_s: float) -> None:
    """Each reading but the first is a distance, none is far off, and nothing is reported to be silent."""
    bench = pallet(sensors, interval_s)
    slots = 40
    bench.fly(slots * max(interval_s, 0.067))
    sent = [(time_s, message.current_distance) for time_s, message in bench.sent() if message.id == FUSED_ID]
    assert len(sent) >= 0.9 * len(bench.steps) - 1
    assert all(abs(distance_cm - 300) < 8 for _, distance_cm in sent)
    assert max(late - early for (early, _), (late, _) in pairwise(sent)) < 2.1 * max(interval_s, 0.08)
    if interval_s <= 0.5:
        assert [text for text in bench.reported() if "distance" in text or "disagree" in text] == []


@pytest.mark.parametrize(("sensors", "interval_s"), [(1, 2.0), (4, 2.0), (8, 0.2)])
def test_a_long_turn_is_followed_in_a_climb(sensors: int, interval_s: float) -> None:
    """What used to send nothing for ever, since its windows were shorter than its turn."""
    content = [sensor(f"s{number}", number) for number in range(1, sensors + 1)]
    vehicle = airframe(content, polling={"ping_interval_s": interval_s})
    bench = Bench(vehicle, lambda name, time_s: 200 + round(10 * time_s)).fly(30.0)
    sent = [(time_s, message.current_distance) for time_s, message in bench.sent() if message.id == FUSED_ID]
    assert len(sent) > 0.8 * 30.0 / interval_s - 2
    assert all(abs(distance_cm - 200 - 10 * time_s) < 15 for time_s, distance_cm in sent[2:])


def test_windows_are_of_the_turn_and_of_the_gap_between_downward_readings() -> None:
    four = windows_of(load_airframe(CONFIGS / "quad_pallet.yaml"))
    assert (four.turn_s, four.gap_s) == pytest.approx((0.4, 0.1))
    # One looks ahead: behind its slot the next reading of the ground comes after two.
    mixed = windows_of(airframe([*FOUR_DOWN[:3], sensor("ahead", 4, 0.0)]))
    assert (mixed.turn_s, mixed.gap_s) == pytest.approx((0.4, 0.2))
    # Pings cannot follow faster than the sensor ranges, 80 ms at most.
    fast = windows_of(airframe(polling={"ping_interval_s": 0.05}))
    assert fast.turn_s == pytest.approx(0.32)
    together = airframe(polling={"groups": [["a", "b"], ["c", "d"]], "ping_interval_s": 1.0})
    assert (windows_of(together).turn_s, windows_of(together).gap_s) == (2.0, 1.0)
    assert windows_of(together).silence_s == pytest.approx(3.8)


def test_intervals_of_all_streams() -> None:
    link = {"url": "udpout:127.0.0.1:14550", "autopilot": "px4"}
    send = {"fused": {"id": FUSED_ID}, "sensors": ["b"]}
    vehicle = airframe(polling={"ping_interval_s": 0.5}, send=send, link=link)
    assert intervals_s(vehicle) == {"b": 2.0, "fused": 0.5}


def test_windows_are_so_many_turns_and_gaps_and_at_least_those_of_four_sensors() -> None:
    def lengths_s(windows: Windows) -> list[float]:
        return [windows.fresh_s, windows.held_s, windows.memory_s, windows.newest_s]

    assert lengths_s(Windows(2.0, 1.0)) == pytest.approx([3.2, 6.2, 7.5, 2.5])
    least_s = pytest.approx([0.64, 1.24, 1.5, 0.25])
    assert lengths_s(Windows()) == lengths_s(Windows(0.1, 0.05)) == least_s
    assert Windows(0.45, 0.11).fresh_s == pytest.approx(0.72)
    assert (Windows().silence_s, Windows(2.0, 1.0).silence_s) == pytest.approx((0.95, 3.8))
