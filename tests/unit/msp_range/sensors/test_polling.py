"""Who pings when: order, groups, reading as soon as there is an answer, spacing, and faster pings near the ground."""

import errno
import itertools
import math
import shutil
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from msp_range.assembly import polled_sensors
from msp_range.bus import Address, BusError
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.reading import Decoded, Status
from msp_range.sensors.polling import Poller, Ranging, reading_of
from msp_range.sensors.schedule import AnswerTiming, Near, PolledSensor, RoundRobin
from msp_sim.device.bus import EmulatedBus
from tests.support.scripted_bus import ScriptedBus
from tests.support.shipped import CONFIGS

FIRST_S, DEADLINE_S = 0.021, 0.080
READY_S = 0.0301
"""From ping to answer unless a test says otherwise."""
SAFE_S = 0.100
ROUND = ("a", "b", "c", "d")


class Sonar:
    """A sensor that answers as long after its ping as the test sets, with a range that is a function of the ping."""

    address: Address = 0x70

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.pings_s: list[float] = []
        self.asked_s: list[float] = []
        self.ready_s = READY_S
        self.range_m: Callable[[float], float | None] = lambda ping_s: 3.0
        # It measures for 10 ms longer than the sound needs, as an MB1242 does.
        self.earliest_s: Callable[[], float] = lambda: max(self.ready_s - 0.010, 0.0)
        self.is_absent = False
        self.status: Callable[[], Status] = lambda: Status.OK

    def ping(self) -> None:
        self.pings_s.append(self._clock.now())
        if self.is_absent:
            raise BusError(errno.EREMOTEIO, "write", 0x70)

    def answer(self) -> Decoded:
        self.asked_s.append(self._clock.now())
        if self.asked_s[-1] < self.pings_s[-1] + self.ready_s:
            raise BusError(errno.EREMOTEIO, "read", 0x70)
        status = self.status()
        if status.is_fault:
            return Decoded(status, None, 0x8000)
        range_m = self.range_m(self.pings_s[-1])
        return Decoded(Status.NO_ECHO if range_m is None else Status.OK, range_m, 300, False, self.earliest_s())


class Bench:
    """Sonars polled in groups, in virtual time."""

    def __init__(
        self,
        groups: Sequence[str],
        interval_s: float = SAFE_S,
        first_answer_s: float = FIRST_S,
        **options: Any,
    ) -> None:
        # A start that is no round number: nothing may depend on the clock's zero.
        self.clock = VirtualClock(71.3)
        self.start_s = self.clock.now()
        self.sonars = {name: Sonar(self.clock) for group in groups for name in group}
        timing = AnswerTiming(first_answer_s, DEADLINE_S)
        polled = [[PolledSensor(name, self.sonars[name], timing) for name in group] for group in groups]
        self.schedule = RoundRobin(polled, interval_s, self.start_s, **options)
        self.poller = Poller(ScriptedBus(self.clock, ()), self.clock, self.schedule)

    def poll(self, duration_s: float) -> list[Ranging]:
        ended = []
        until_s = self.clock.now() + duration_s
        while self.poller.next_event_s < until_s - 1e-9:
            self.clock.sleep_until(self.poller.next_event_s)
            ended += self.poller.step()
        self.clock.sleep_until(until_s)
        return ended

    def set(self, names: Iterable[str], **attributes: Any) -> None:
        """Give sonars other attributes."""
        for name in names:
            vars(self.sonars[name]).update(attributes)

    def names(self) -> list[str]:
        """Who pinged, one after the other."""
        return [name for _, name in self.order()]

    def times_s(self, from_s: float = 0.0) -> list[float]:
        """When anybody pinged, from a time since the start on [s]."""
        return [time_s for time_s, _ in self.order() if time_s >= from_s]

    def order(self) -> list[tuple[float, str]]:
        """All pings since the start: time [s] and sensor."""
        pings = [(time_s, name) for name, sonar in self.sonars.items() for time_s in sonar.pings_s]
        return sorted((round(time_s - self.start_s, 6), name) for time_s, name in pings)

    def intervals_s(self, name: str, from_s: float = 0.0) -> list[float]:
        """From each ping of a sensor to its next one, of the pings from a time since the start on [s]."""
        return [late - early for early, late in pairwise(self.pings_s(name, from_s))]

    def pings_s(self, name: str, from_s: float = 0.0) -> list[float]:
        """A sensor's pings since the start [s]."""
        return [time_s for time_s, pinged in self.order() if pinged == name and time_s >= from_s]


def check_steady(times_s: Sequence[float], interval_s: float) -> None:
    """They are so far apart."""
    gaps_s = [late - early for early, late in pairwise(times_s)]
    assert gaps_s == pytest.approx([interval_s] * len(gaps_s))


def test_four_sensors_in_turn_are_two_and_a_half_hertz_each_and_ten_together() -> None:
    bench = Bench(ROUND)
    rangings = bench.poll(20.0)
    assert bench.names() == list(ROUND) * 50
    assert len(rangings) == 200
    assert {name: len(sonar.pings_s) for name, sonar in bench.sonars.items()} == dict.fromkeys(ROUND, 50)
    check_steady(bench.times_s(), 0.1)


def test_a_sensor_whose_reading_did_not_fit_has_another_turn_soon_and_not_for_ever() -> None:
    bench = Bench(ROUND)
    order = []
    for _ in range(30):
        order += [ranging.reading.sensor for ranging in bench.poll(0.1)]
        if order[-1:] == ["b"]:
            bench.schedule.again("b")
    # The turn after b's is planned when its answer comes; twice within two seconds it has the one after that.
    assert "".join(order).startswith("abcbdbabcdabcdabcdab")
    # A sensor that is alone has all turns anyway.
    alone = Bench(["a"])
    alone.poll(0.3)
    alone.schedule.again("a")
    alone.poll(0.3)
    assert alone.intervals_s("a") == pytest.approx([0.1] * 5)


def test_a_group_pings_together_and_groups_take_turns() -> None:
    bench = Bench(["ab", "c"])
    bench.sonars["a"].ready_s, bench.sonars["b"].ready_s = 0.050, 0.025
    rangings = bench.poll(0.4)
    assert bench.order() == [(0.0, "a"), (0.0, "b"), (0.1, "c"), (0.2, "a"), (0.2, "b"), (0.3, "c")]
    assert [each.reading.sensor for each in rangings] == ["b", "a", "c"] * 2


@pytest.mark.parametrize("ready_s", [0.001, 0.0215, READY_S, 0.067, 0.0799])
def test_an_answer_is_read_within_three_milliseconds(ready_s: float) -> None:
    bench = Bench("a")
    bench.sonars["a"].ready_s = ready_s
    (ranging,) = bench.poll(0.1)
    asked_s = [time_s - bench.start_s for time_s in bench.sonars["a"].asked_s]
    assert asked_s[0] == pytest.approx(FIRST_S)
    assert ranging.answered_s - ranging.ping_s == pytest.approx(asked_s[-1])
    assert ranging.reading.status is Status.OK
    assert max(ready_s, FIRST_S) - 1e-9 <= asked_s[-1] <= max(ready_s + 0.003, FIRST_S) + 1e-9


def late_s(bench: Bench, ready_s: Sequence[float]) -> tuple[list[float], int]:
    """How late the answers are read that are ready so long after one ping after another [s]; attempts of all."""
    late = []
    bench.sonars["a"].asked_s.clear()
    for each_s in ready_s:
        bench.sonars["a"].ready_s = each_s
        while not (ended := bench.poller.step()):
            bench.clock.sleep_until(bench.poller.next_event_s)
        (ranging,) = ended
        assert ranging.reading.status is Status.OK
        late.append(ranging.answered_s - ranging.ping_s - max(each_s, FIRST_S))
    return late, len(bench.sonars["a"].asked_s)


@pytest.mark.parametrize(("ready_s", "attempts"), [(0.0215, 1.4), (READY_S, 1.4), (0.0374, 1.4), (0.067, 3.6)])
def test_a_sensor_is_asked_when_its_answer_is_expected(ready_s: float, attempts: float) -> None:
    bench = Bench("a")
    late, asked = late_s(bench, [ready_s] * 40)
    assert max(late) < 0.003 + 1e-9
    assert sum(late) / 40 < 0.0016
    assert asked / 40 <= attempts


def test_a_sensor_whose_duration_does_not_follow_its_answer_is_followed_too() -> None:
    """The answers of a driver that does not know when they can come, of a sensor that becomes quicker and slower."""
    bench = Bench("a")
    bench.sonars["a"].earliest_s = lambda: 0.0
    late, asked = late_s(bench, [*[0.035] * 10, *[0.030] * 10, *[0.036] * 10])
    assert max(late) < 0.006
    assert late[19] < 0.003
    assert asked / 30 <= 1.8


def test_a_fault_does_not_change_when_the_next_answer_is_expected() -> None:
    bench = Bench("a")
    late_s(bench, [0.035] * 4)
    bench.sonars["a"].status = lambda: Status.CLOCK_FAULT
    bench.poll(0.1)
    bench.sonars["a"].status = lambda: Status.OK
    assert late_s(bench, [0.035])[1] <= 2


def test_an_answer_that_comes_at_another_time_than_the_last_is_not_read_much_later() -> None:
    sinking_s = [0.060 - 0.0046 * i for i in range(8)]  # 2 m/s
    late, _ = late_s(Bench("a"), sinking_s)
    assert max(late) < 0.005
    late, _ = late_s(Bench("a"), sinking_s[::-1])
    assert max(late) < 0.003 + 1e-9
    for object_s in (0.0211, 0.035, 0.050):
        late, _ = late_s(Bench("a"), [0.067, object_s, object_s, object_s, object_s, object_s])
        assert max(late) < 0.019
        assert late[-1] < 0.003 + 1e-9


def test_a_bus_that_may_be_answered_at_any_time_is_asked_all_the_time() -> None:
    bench = Bench("a")
    bench.poller = Poller(EmulatedBus([], bench.clock.now), bench.clock, bench.schedule)
    assert late_s(bench, [READY_S] * 3)[1] == 3 * 5


def test_a_bus_that_cannot_take_silence_is_read_once_at_the_deadline() -> None:
    bench = Bench("a", first_answer_s=DEADLINE_S)
    (ranging,) = bench.poll(0.1)
    assert len(bench.sonars["a"].asked_s) == 1
    assert ranging.answered_s - bench.start_s == pytest.approx(DEADLINE_S)
    assert ranging.reading.status is Status.OK


def test_nobody_is_asked_after_the_deadline() -> None:
    bench = Bench(["ab"])
    bench.sonars["a"].ready_s = math.inf
    good, silent = bench.poll(0.1)
    assert good.reading.sensor == "b"
    assert silent.reading.status is Status.NO_ANSWER
    assert bench.sonars["a"].asked_s[-1] - bench.start_s == pytest.approx(DEADLINE_S)
    assert (silent.ping_s, silent.reading.time_s) == (bench.start_s, bench.start_s)


def test_nobody_pings_while_another_one_ranges() -> None:
    bench = Bench("ab", 0.030)
    bench.set("ab", ready_s=0.0600)
    bench.poll(1.0)
    times_s = bench.times_s()
    assert all(0.0600 - 1e-9 <= late - early <= 0.0621 for early, late in pairwise(times_s))


def test_an_interruption_does_not_make_up_for_lost_pings() -> None:
    bench = Bench("ab")
    bench.poll(0.2)
    bench.clock.sleep_until(bench.start_s + 1.25)
    bench.poll(0.35)
    assert bench.order()[2:] == [(1.25, "a"), (1.35, "b"), (1.45, "a"), (1.55, "b")]


def test_the_echo_came_after_half_the_time_of_flight() -> None:
    bench = Bench("ab")
    bench.set("a", range_m=lambda ping_s: 2.0)
    bench.set("b", range_m=lambda ping_s: None)
    echo, none = bench.poll(0.2)
    assert echo.reading.time_s - echo.ping_s == pytest.approx(0.0058)
    assert none.reading.time_s == none.ping_s


NEAR = Near(below_m=2.0, ping_interval_s=0.050)


def test_near_the_ground_pings_come_at_least_one_and_a_half_times_as_often() -> None:
    rates_hz = []
    for near in (None, NEAR):
        bench = Bench(ROUND, near=near)
        bench.set(ROUND, range_m=lambda ping_s: 1.9)
        rates_hz.append(len(bench.poll(60.0)) / 60.0)
    assert rates_hz[0] == pytest.approx(10.0, rel=0.01)
    assert rates_hz[1] >= 1.5 * rates_hz[0]


@pytest.mark.parametrize("far", [2.0, 5.0, None])
def test_one_sensor_that_sees_nothing_near_makes_all_wait(far: float | None) -> None:
    bench = Bench("ab", near=NEAR)
    bench.sonars["a"].range_m = lambda ping_s: 1.0 if ping_s - bench.start_s < 0.5 else far
    bench.sonars["b"].range_m = lambda ping_s: 1.0
    bench.poll(1.0)
    # Both have to answer before anything is known of them.
    assert bench.times_s()[:4] == [0.0, 0.1, 0.15, 0.2]
    check_steady(bench.times_s(0.51), 0.1)


def test_a_sensor_that_falls_silent_makes_all_wait_until_it_is_dead() -> None:
    bench = Bench("ab", near=NEAR)
    bench.set("ab", range_m=lambda ping_s: 1.0)
    bench.poll(0.5)
    bench.sonars["b"].is_absent = True
    bench.poll(4.5)
    first_s, _, third_s = bench.pings_s("b", 0.5)[:3]
    check_steady([time_s for time_s in bench.times_s(first_s) if time_s <= third_s], 0.100)
    check_steady(bench.pings_s("a", third_s), 0.050)


def test_where_all_are_dead_nobody_is_near_the_ground() -> None:
    bench = Bench("ab", near=NEAR)
    bench.set("ab", range_m=lambda ping_s: 1.0)
    bench.poll(0.5)
    bench.set("ab", is_absent=True)
    bench.poll(5.0)
    check_steady(bench.times_s(1.21), 0.1)


# Dead sensors and their slots.


@pytest.mark.parametrize("living", ["a", "b", "ad", "abd"])
def test_sensors_that_are_gone_give_their_slots_to_the_living(living: str) -> None:
    bench = Bench(ROUND)
    bench.set(set(ROUND) - set(living), is_absent=True)
    rangings = bench.poll(20.0)
    # The third fault in a row is a sensor's last before it gives its slot away.
    ended_s = [each.answered_s - bench.start_s for each in rangings if each.reading.status is Status.OK]
    assert len([each for each in ended_s if each > 1.2]) == pytest.approx(188, abs=1)
    for name in living:
        check_steady(bench.pings_s(name, 1.2), 0.1 * len(living))
    for name in set(ROUND) - set(living):
        assert len(bench.pings_s(name, 1.2)) >= 7
        assert all(2.0 - 1e-9 <= each < 2.0 + 0.1 * len(ROUND) for each in bench.intervals_s(name, 1.2))


@pytest.mark.parametrize("status", [each for each in Status if each.is_fault and each is not Status.NO_ANSWER])
def test_a_dead_sensor_that_makes_a_sound_has_a_slot_every_two_seconds(status: Status) -> None:
    bench = Bench(ROUND)
    bench.set("bcd", status=lambda: status)
    bench.poll(20.0)
    check_steady(bench.times_s(), 0.1)
    assert len(bench.pings_s("a", 2.0)) == 180 - len([each for name in "bcd" for each in bench.pings_s(name, 2.0)])
    for name in "bcd":
        assert all(2.0 - 1e-9 <= each < 2.4 for each in bench.intervals_s(name, 1.2))
    # Never two of them in a row.
    assert max(bench.intervals_s("a", 1.2)) == pytest.approx(0.2)


def test_a_sensor_that_answers_again_has_its_slot_back_and_others_are_tried_at_once() -> None:
    bench = Bench(ROUND)
    bench.sonars["d"].is_absent = True
    for name in "bc":
        bench.sonars[name].is_absent = True
        # Their retries are a second apart.
        bench.poll(1.0)
    bench.poll(3.0)
    bench.set("bc", is_absent=False)
    bench.poll(5.0)
    back_s = sorted(bench.pings_s(name, 5.0)[0] for name in "bc")
    assert back_s[0] < 5.0 + 1.5
    assert back_s[1] - back_s[0] <= 0.4
    for name in "abc":
        check_steady(bench.pings_s(name, 7.5), 0.3)
    assert len(bench.intervals_s("a", 7.5)) >= 7


@pytest.mark.parametrize("fails", [{1}, {1, 2}])
def test_a_sensor_that_fails_now_and_then_keeps_its_slot(fails: set[int]) -> None:
    bench = Bench(ROUND)
    count = itertools.count()
    bench.sonars["b"].status = lambda: Status.CLOCK_FAULT if next(count) % 3 in fails else Status.OK
    bench.poll(20.0)
    assert bench.names() == [*ROUND] * 50


def test_where_all_are_dead_all_take_turns_and_one_that_is_back_brings_the_others() -> None:
    bench = Bench(ROUND)
    bench.poll(2.0)
    bench.set(ROUND, is_absent=True)
    bench.poll(8.0)
    assert bench.names() == [*ROUND] * 25
    check_steady(bench.times_s(), 0.1)
    # In the middle of a round.
    bench.poll(0.2)
    bench.set(ROUND, is_absent=False)
    bench.poll(3.0)
    assert all(bench.pings_s(name, 10.2)[0] <= 10.2 + 0.6 for name in ROUND)
    assert bench.names()[-16:] in [[*ROUND[i:], *ROUND[:i]] * 4 for i in range(4)]


def test_dead_sensors_are_retried_one_after_the_other() -> None:
    """So far apart, all of them are always due, and each takes a slot."""
    bench = Bench(ROUND, 2.0)
    bench.set("bcd", status=lambda: Status.CLOCK_FAULT)
    bench.poll(144.0)
    assert [len(bench.pings_s(name, 24.0)) for name in ROUND] == [30, 10, 10, 10]


def test_a_group_keeps_its_living_sensors_and_retries_the_dead_one_with_them() -> None:
    bench = Bench(["ab", "cd"])
    bench.sonars["a"].is_absent = True
    bench.poll(10.0)
    for name in "bcd":
        assert bench.intervals_s(name) == pytest.approx([0.2] * 49)
    assert set(bench.pings_s("a")) <= set(bench.pings_s("b"))
    assert len(bench.pings_s("a", 0.5)) == 4
    assert all(2.0 - 1e-9 <= each < 2.3 for each in bench.intervals_s("a", 0.4))


def test_a_dead_group_gives_its_slot() -> None:
    bench = Bench(["ab", "cd"])
    bench.sonars["a"].is_absent = True
    bench.sonars["b"].status = lambda: Status.CLOCK_FAULT
    bench.poll(10.0)
    assert bench.pings_s("a") == bench.pings_s("b")
    retries_s = bench.pings_s("a", 0.5)
    assert len(retries_s) == 4
    # One of them acknowledges and ranges, so nobody else does.
    assert not set(retries_s) & set(bench.pings_s("c"))
    assert len(bench.pings_s("c", 0.5)) == len(bench.pings_s("d", 0.5)) == 95 - len(retries_s)


def test_with_no_number_of_faults_that_makes_it_dead_a_sensor_keeps_its_slot() -> None:
    bench = Bench(ROUND, dead_after=math.inf)
    bench.sonars["b"].is_absent = True
    bench.poll(4.0)
    assert bench.names() == [*ROUND] * 10


@pytest.mark.parametrize("interval_s", [0.05, 0.1, 2.0])
@pytest.mark.parametrize(
    ("groups", "dead", "slots"),
    [
        (["a"], "", 1),
        (["a"], "a", 1),
        (["a", "b", "c", "d"], "", 4),
        (["a", "b", "c", "d"], "b", 4),
        (["a", "b", "c", "d"], "bcd", 2),
        (["a", "b", "c", "d"], "abcd", 4),
        (["ab", "cd"], "a", 2),
        (["ab", "cd"], "ab", 2),
        (["ab", "c", "d"], "abc", 2),
    ],
)
@pytest.mark.parametrize("acknowledges", [True, False])
def test_the_longest_time_between_pings_of_a_living_sensor(
    interval_s: float, groups: list[str], dead: str, slots: int, acknowledges: bool
) -> None:
    bench = Bench(groups, interval_s)
    bench.set(dead, ready_s=math.inf, is_absent=not acknowledges)
    settled_s = 3 * len(groups) * max(interval_s, DEADLINE_S)
    bench.poll(settled_s + 60.0 * max(interval_s, DEADLINE_S))
    all_dead = len(dead) == len(bench.sonars)
    for name in bench.sonars:
        if name not in dead or all_dead:
            assert max(bench.intervals_s(name, settled_s)) <= slots * max(interval_s, DEADLINE_S) + 0.003


@pytest.mark.parametrize("groups", [[], [[]]])
def test_a_group_without_sensors_is_refused(groups: list[list[PolledSensor]]) -> None:
    with pytest.raises(ValueError, match="at least one sensor"):
        RoundRobin(groups, SAFE_S, 0.0)


class Broken:
    """A sensor on a bus that fails: pings or answers raise ``errno``."""

    address: Address = 0x70

    def __init__(self, verb: str, number: int) -> None:
        self.verb = verb
        self.number = number
        self.transfers: list[str] = []

    def ping(self) -> None:
        self._transfer("write")

    def answer(self) -> Decoded:
        self._transfer("read")
        return Decoded(Status.OK, 3.0, 300)

    def _transfer(self, verb: str) -> None:
        self.transfers.append(verb)
        if verb == self.verb:
            raise BusError(self.number, verb, 0x70)


class Reopened:
    """A bus of which only the times at which it is opened again count."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.reopened_s: list[float] = []

    def write(self, address: Address, data: bytes) -> None: ...
    def read(self, address: Address, count: int) -> bytes:
        return b""

    def busy_s(self, address: Address) -> None: ...

    def reopen(self) -> None:
        self.reopened_s.append(self._clock.now())

    def close(self) -> None: ...


def broken(verb: str, number: int, until_s: float) -> tuple[Broken, list[float], list[Ranging]]:
    clock = VirtualClock(71.3)
    device, bus = Broken(verb, number), Reopened(clock)
    sensor = PolledSensor("a", device, AnswerTiming(FIRST_S, DEADLINE_S))
    poller = Poller(bus, clock, RoundRobin([[sensor]], SAFE_S, clock.now()))
    ended: list[Ranging] = []
    while poller.next_event_s < 71.3 + until_s:
        clock.sleep_until(poller.next_event_s)
        ended += poller.step()
    return device, bus.reopened_s, ended


@pytest.mark.parametrize("number", [errno.ETIMEDOUT, errno.EBADF, errno.ENOENT, errno.EACCES])
def test_a_bus_that_is_at_fault_is_asked_once_a_ping(number: int) -> None:
    """Each transfer of a bus that is locked up holds the bridge for a second: forty tries would be forty seconds."""
    device, _, ended = broken("read", number, 0.99)
    assert device.transfers == ["write", "read"] * 10
    assert {each.reading.status for each in ended} == {Status.NO_ANSWER}


@pytest.mark.parametrize("verb", ["write", "read"])
@pytest.mark.parametrize("number", [errno.ETIMEDOUT, errno.EBADF, errno.ENODEV])
def test_a_bus_that_may_be_gone_is_opened_again_once_a_second(verb: str, number: int) -> None:
    _, reopened_s, ended = broken(verb, number, 9.99)
    assert len(reopened_s) == pytest.approx(10, abs=1)
    assert all(late - early >= 1.0 - 1e-9 for early, late in pairwise(reopened_s))
    assert len(ended) == 100


def test_a_bus_is_not_opened_again_for_a_sensor_that_does_not_answer() -> None:
    assert broken("write", errno.EREMOTEIO, 10.0)[1] == []
    assert broken("read", errno.EREMOTEIO, 10.0)[1] == []


def test_a_reading_scatters_as_its_sensor_model_says_for_its_range(tmp_path: Path) -> None:
    model = (CONFIGS / "sensors" / "mb1242.yaml").read_text()
    (tmp_path / "sensors").mkdir()
    (tmp_path / "sensors" / "mb1242.yaml").write_text(
        model.replace("sigma_cm: 1.9445", "sigma_cm: 1.5\n  sigma_growth_cm_per_m: 0.4")
    )
    shutil.copy(CONFIGS / "quad_pallet.yaml", tmp_path)
    airframe = load_airframe(tmp_path / "quad_pallet.yaml")
    polled = polled_sensors(airframe, Reopened(VirtualClock()))["front_left"]
    # sqrt(1.5^2 + (0.4 * 5)^2 + 1/12) cm, the last for the rounding to whole centimetres.
    std_m = reading_of(polled, 0.0, Decoded(Status.OK, 5.0, 500)).std_m
    assert std_m == pytest.approx(math.sqrt(1.5**2 + 2.0**2 + 1 / 12) / 100, rel=1e-9)
    assert reading_of(polled, 0.0, Decoded(Status.NO_ECHO, None, 765)).std_m is None
