"""What is reported of the streams as an autopilot gets them."""

import math
import random
from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range.assembly import windows_of
from msp_range.bridge import LINK_WAITS_S
from msp_range.health import Health, OutputWatch
from msp_range.health.finding import SensorFinding
from msp_range.health.output import FUSED
from msp_range.pilot_texts import Severity
from msp_sim.device.device import Fault
from tests.support.bench import FUSED_ID, Bench, airframe, sensor

NAMES = "abcd"
HEARTBEAT = common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)


class Watched:
    """An `OutputWatch` of the fused stream, asked each 0.1 s."""

    def __init__(self, silence_s: float = 1.0) -> None:
        self.reports: list[tuple[float, Severity, str]] = []
        self.now_s = 0.0
        self.health = Health((), lambda severity, text: self.reports.append((self.now_s, severity, text)))
        self.watch = OutputWatch([FUSED], silence_s, 0.0)

    def go(self, until_s: float, usable: bool = True, used: bool = True, fit: float = 1.0) -> "Watched":
        while self.now_s < until_s - 1e-9:
            self.now_s += 0.1
            self.watch.on_range(used, fit)
            if usable:
                self.watch.on_usable(FUSED, self.now_s)
            for condition in self.watch.conditions(self.now_s, self.health.failing_sensors):
                self.health.set(condition)
        return self

    @property
    def texts(self) -> list[str]:
        return [text for _, _, text in self.reports]


def test_silence_is_reported_after_the_limit_and_its_end_too() -> None:
    watched = Watched().go(5.0).go(9.0, usable=False).go(12.0)
    (begins_s, severity, begins), (ends_s, _, ends) = watched.reports
    assert (begins, ends) == ("Range: no distance to the ground", "Range: distance is back")
    assert severity is Severity.ERROR
    assert begins_s == pytest.approx(6.1, abs=0.11)
    assert ends_s == pytest.approx(9.1, abs=0.11)
    assert Watched().go(5.0).go(5.9, usable=False).go(8.0).texts == []
    assert Watched(silence_s=8.0).go(5.0).go(12.0, usable=False).texts == []
    assert Watched().go(3.0, usable=False).texts == ["Range: no distance to the ground"], "from the start on"


def silent(watch: OutputWatch, now_s: float) -> list[str]:
    return [each.key.removeprefix("silence ") for each in watch.conditions(now_s, ()) if each.text is not None]


def test_a_stream_is_silent_at_its_limit_whatever_was_rounded_and_whoever_is_silent_already() -> None:
    draw = random.Random(1)
    for _ in range(1000):
        usable_s = draw.uniform(0.0, 1e5)
        watch = OutputWatch(["a", "b"], 0.95, usable_s - 5.0)
        watch.on_usable("b", usable_s)
        limit_s = watch.next_event_s(usable_s)
        assert limit_s == usable_s + 0.95
        assert silent(watch, math.nextafter(limit_s, 0.0)) == ["a"]
        assert silent(watch, limit_s) == ["a", "b"]
        assert watch.next_event_s(limit_s) == math.inf


def test_readings_that_mostly_are_not_used_disagree() -> None:
    assert Watched().go(5.0).go(8.0, used=False).go(15.0).texts == ["Range: readings disagree", "Range: readings agree"]
    assert Watched().go(5.0).go(5.8, used=False).go(15.0).texts == [], "a step of the ground"
    half = Watched().go(5.0)
    for i in range(100):
        half.go(half.now_s + 0.1, used=i % 2 == 0)
    assert half.texts == [], "one sensor of two is out of order, and the other one is believed"


def test_a_deviation_that_is_too_small_is_reported() -> None:
    assert Watched().go(5.0).go(8.0, fit=6.0).go(15.0).texts == [
        "Range: readings are noisy",
        "Range: readings are steady",
    ]
    assert Watched().go(5.0).go(8.0, fit=3.0).texts == []


# In the bridge.


def states(bench: Bench, from_s: float, to_s: float) -> set[int]:
    return {message.system_status for time_s, message in bench.sent("HEARTBEAT") if from_s <= time_s < to_s}


def test_all_sensors_at_255_is_silence_that_is_reported() -> None:
    """Each of them is in order by itself: an echo, and a legal range."""
    faults = {name: [Fault("saturated", 5.0, 20.0)] for name in NAMES}
    bench = Bench(airframe(), 500, faults=faults).fly(25.0, with_autopilot=True)
    assert bench.distances_cm(from_s=6.0, to_s=20.0) == []
    (silent_s,) = [time_s for time_s, text in bench.reports if text == "Range: no distance to the ground"]
    assert 5.9 < silent_s < 6.9
    assert "Range: no distance to the ground" in bench.texts()
    assert states(bench, 8.0, 20.0) == {common.MAV_STATE_CRITICAL}
    assert bench.reported()[-1] == "Range: distance is back"
    assert states(bench, 22.0, 25.0) == {common.MAV_STATE_ACTIVE}


@pytest.mark.parametrize("interval_s", [0.1, 0.37, 2.0])
@pytest.mark.parametrize("quiet", [False, True])
def test_a_silence_is_reported_when_its_limit_is_reached_whatever_the_loop_waits_for(
    interval_s: float, quiet: bool
) -> None:
    """Neither the next ping nor the next message of the autopilot has to wake the loop."""
    vehicle = airframe(polling={"ping_interval_s": interval_s})
    from_s = 40.0 * interval_s
    bench = Bench(vehicle, 500, faults={name: [Fault("saturated", from_s, 1e3)] for name in NAMES})
    bench.wire.quiet_until_s = math.inf if quiet else -math.inf
    bench.fly(from_s + 20.0 * interval_s + 2.0)
    last_s = max(time_s for time_s, message in bench.sent() if message.current_distance == 500)
    (report_s,) = [time_s for time_s, text in bench.reports if text == "Range: no distance to the ground"]
    assert report_s - last_s == pytest.approx(windows_of(vehicle).silence_s, abs=1e-3)


@pytest.mark.parametrize("transfer_s", [0.004, 0.006, 0.008])
def test_a_silence_is_reported_in_time_by_a_loop_whose_transfers_follow_each_other_at_once(
    transfer_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a slow bus sensors that ping together are asked without a break."""
    vehicle = airframe(polling={"ping_interval_s": 0.075, "groups": [list(NAMES)]})
    bench = Bench(vehicle, 500, faults={name: [Fault("saturated", 5.0, 1e3)] for name in NAMES})
    read = bench.bus.read

    def slow_read(address: int, count: int) -> bytes:
        bench.clock.sleep_until(bench.clock.now() + transfer_s)
        return read(address, count)

    monkeypatch.setattr(bench.bus, "read", slow_read)
    bench.wire.quiet_until_s = math.inf
    bench.fly(8.0)
    last_s = max(time_s for time_s, message in bench.sent() if message.current_distance == 500)
    (report_s,) = [time_s for time_s, text in bench.reports if text == "Range: no distance to the ground"]
    assert report_s - last_s < 0.95 + LINK_WAITS_S + transfer_s


def test_a_message_that_arrives_waits_no_longer_for_transfers_that_follow_each_other_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    transfer_s = 0.008
    bench = Bench(airframe(polling={"ping_interval_s": 0.075, "groups": [list(NAMES)]}), 500)
    bench.wire.files = (3,)
    arrived_s, waits_s = [0.0], []
    read, sleep_until, receive = bench.bus.read, bench.clock.sleep_until, bench.wire.receive

    def slow_read(address: int, count: int) -> bytes:
        sleep_until(bench.clock.now() + transfer_s)
        if not bench.wire.arriving and bench.now() > arrived_s[0] + 0.04:
            arrived_s[0] = bench.now()
            bench.receive(HEARTBEAT)
        return read(address, count)

    def woken(time_s: float, files: Sequence[int] = ()) -> bool:
        if files and bench.wire.arriving:
            return True
        return sleep_until(time_s)

    def timed() -> bytes:
        if bench.wire.arriving:
            waits_s.append(bench.now() - arrived_s[0])
        return receive()

    monkeypatch.setattr(bench.bus, "read", slow_read)
    monkeypatch.setattr(bench.clock, "sleep_until", woken)
    monkeypatch.setattr(bench.wire, "receive", timed)
    bench.fly(4.0)
    assert len(waits_s) > 40
    assert max(waits_s) < LINK_WAITS_S + 2 * transfer_s


@pytest.mark.parametrize("roll", [1.7, 3.1, 1e38, float("nan"), float("inf")])
def test_an_attitude_that_makes_no_sense_is_reported_and_costs_no_distance(roll: float) -> None:
    bench = Bench(airframe(), 300)
    for i in range(150):
        lean = roll if i >= 50 else 0.02
        bench.receive(HEARTBEAT, common.MAVLink_attitude_message(100 * i, lean, 0.0, 0.0, 0, 0, 0))
        bench.fly(0.1 * (i + 1))
    assert set(bench.distances_cm()) == {300}
    assert len(bench.distances_cm(from_s=5.0)) == pytest.approx(100, abs=2)
    assert bench.reported(5.0) == ["Range: attitude makes no sense"]


@pytest.mark.parametrize("std_cm", [6.0, 12.0, 30.0])
def test_noise_of_all_sensors_is_in_the_deviation_and_much_of_it_a_text(std_cm: float) -> None:
    draw = random.Random(4)

    def noisy(name: str, time_s: float) -> int:
        return round(400 + (draw.gauss(0.0, std_cm) if time_s > 5.0 else 0.0))

    bench = Bench(airframe(), noisy).fly(40.0)
    later = [message for time_s, message in bench.sent() if message.id == FUSED_ID and time_s > 8.0]
    within = [abs(each.current_distance - 400) < 3 * each.covariance**0.5 for each in later]
    assert len(later) > 50
    assert sum(within) > (0.97 if std_cm < 20.0 else 0.85) * len(within)
    if std_cm > 20.0:
        assert {"Range: readings are noisy", "Range: readings disagree"} & set(bench.reported())


@pytest.mark.slow
def test_readings_of_nothing_but_outliers_are_no_distance() -> None:
    draw = random.Random(5)

    def noisy(name: str, time_s: float) -> int:
        return 400 if time_s < 5.0 else draw.randrange(21, 764)

    bench = Bench(airframe(), noisy).fly(105.0)
    wrong = [each for each in bench.distances_cm(from_s=6.0) if abs(each - 400) > 50]
    # Each holds for half a second at most: 2.5 % of the time.
    assert len(wrong) <= 5
    assert {"Range: readings disagree", "Range: no distance to the ground"} <= set(bench.reported(5.0, 8.0))


def test_a_single_silent_stream_whose_sensor_answers_is_reported() -> None:
    vehicle = airframe([sensor("front", 1, 0.0)], send={"sensors": ["front"]})
    faults = {"front": [Fault("saturated", 5.0, 15.0)]}
    bench = Bench(vehicle, 500, faults=faults).fly(20.0)
    assert bench.reported(1.5) == [
        "Range: readings disagree",
        "Range front: no distance",
        "Range front: distance is back",
    ] or ("Range front: no distance" in bench.reported(5.0, 8.0))
    dead: Any = Bench(vehicle, 500, faults={"front": [Fault("silent", 5.0, 15.0)]}).fly(20.0)
    assert "Range front: no distance" not in dead.reported(), "its fault says it already"


def test_a_finding_about_one_sensor_is_the_second_source_of_noisy_readings() -> None:
    texts: list[str] = []
    health = Health((), lambda _, text: texts.append(text))
    watch = OutputWatch([FUSED], 1.0, 0.0)

    def look(now_s: float, fit: float, finding: SensorFinding | None) -> None:
        watch.on_range(True, fit)
        for condition in watch.conditions(now_s, [FUSED], finding):
            if condition.key == "noisy":
                health.set(condition)

    short = SensorFinding("a", "short", 5.0)
    for i in range(20):
        look(0.25 * i, 9.0, None)
    for i in range(20, 40):
        look(0.25 * i, 9.0, short)
    for i in range(40, 60):
        look(0.25 * i, 1.0, short)
    for i in range(60, 80):
        look(0.25 * i, 1.0, None)
    assert texts == ["Range: readings are noisy", short.text, "Range: readings are steady"]
