"""The emulated MB1242 and the wires it hangs on, in a time that only the test moves."""

import errno
import os
import random
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import msp_sim.device.device
from msp_range.bus.base import Address, Bus, BusError
from msp_range.clock import VirtualClock
from msp_range.sensors.mb1242 import MB1242
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import Fault, NotAcknowledged
from msp_sim.device.mb1242 import PART_INFO, RANGE_COMMAND, EmulatedMB1242
from tests.support.plain_device import PlainDevice

AFTER_ANY_RANGING_S = 0.07
FOR_EVER = float("inf")


def lasting(kind: str, **values: Any) -> Fault:
    """A fault that lasts for ever."""
    return Fault(kind, 0.0, FOR_EVER, **values)


class Bench:
    """A sensor before a wall that moves as the test says, and a clock that stands until the test moves it."""

    def __init__(self, readings_cm: Sequence[int] = (258,), faults: Sequence[Fault] = (), seed: int = 1) -> None:
        self.time_s = 0.0
        self.ping_times_s: list[float] = []
        self._readings_cm: Iterator[int] = iter(readings_cm)
        self.sonar = EmulatedMB1242(0x70, self.now, self.echo, faults=faults, chance=random.Random(seed))

    def now(self) -> float:
        return self.time_s

    def echo(self, ping_time_s: float) -> int:
        self.ping_times_s.append(ping_time_s)
        return next(self._readings_cm)

    def ping(self) -> None:
        """Ping and let the ranging end."""
        self.sonar.write(RANGE_COMMAND)
        self.time_s += AFTER_ANY_RANGING_S

    def word(self) -> int:
        return int.from_bytes(self.sonar.read(2), "big")

    def range(self) -> int:
        self.ping()
        return self.word()

    def acknowledges(self) -> bool:
        try:
            self.sonar.read(2)
        except NotAcknowledged:
            return False
        return True


@pytest.mark.parametrize(("reading_cm", "ranging_s"), [(20, 0.02116), (300, 0.0374), (764, 0.064312), (765, 0.067)])
def test_acknowledges_nothing_while_ranging(reading_cm: int, ranging_s: float) -> None:
    bench = Bench([reading_cm])
    bench.time_s = 5.0
    bench.sonar.write(RANGE_COMMAND)
    for time_s, ready in ((5.0, False), (5.0 + ranging_s - 1e-6, False), (5.0 + ranging_s + 1e-6, True)):
        bench.time_s = time_s
        assert bench.acknowledges() is ready
    assert bench.word() == reading_cm


def test_a_ping_while_ranging_is_not_taken() -> None:
    bench = Bench([258])
    bench.sonar.write(RANGE_COMMAND)
    with pytest.raises(NotAcknowledged):
        bench.sonar.write(RANGE_COMMAND)
    assert bench.ping_times_s == [0.0]


def test_part_info_then_the_last_ranging_most_significant_byte_first() -> None:
    bench = Bench([258, 765])
    assert bench.sonar.read(2) == PART_INFO
    bench.ping()
    assert [bench.sonar.read(2).hex() for _ in range(2)] == ["0102", "0102"]
    bench.ping()
    assert [bench.sonar.read(count).hex() for count in (0, 1, 2, 3)] == ["", "02", "02fd", "02fdff"]
    assert bench.ping_times_s == [0.0, AFTER_ANY_RANGING_S]
    assert bench.sonar.pings == 2


@pytest.mark.parametrize("data", [b"", b"\x00", b"\xaa", b"\xe0", b"\x51\x51", b"\xaa\xa5", b"\xa5\xaa\xe2"])
def test_other_writes_are_acknowledged_and_ignored(data: bytes) -> None:
    bench = Bench()
    bench.sonar.write(data)
    assert (bench.word(), bench.sonar.address, bench.ping_times_s) == (int.from_bytes(PART_INFO, "big"), 0x70, [])


def test_a_driver_that_reads_through_the_range_register_pings_again() -> None:
    bench = Bench([258, 300, 400])
    bench.ping()
    for _ in range(2):
        bench.sonar.write(RANGE_COMMAND)
        assert not bench.acknowledges()
        bench.time_s += AFTER_ANY_RANGING_S
    assert len(bench.ping_times_s) == 3


def test_a_driver_that_reads_before_it_pings_is_a_round_old() -> None:
    bench = Bench([100, 200, 300])
    bench.ping()
    seen = []
    for _ in range(2):
        seen.append(bench.word())
        bench.ping()
    assert seen == [100, 200]


@pytest.mark.parametrize(
    ("new_8bit", "address"),
    [(0xE2, 0x71), (0xE3, 0x71), (0xFE, 0x7F), (2, 1), *((ignored, 0x70) for ignored in (0, 1, 80, 81, 164, 171))],
)
def test_address_change(new_8bit: int, address: int) -> None:
    bench = Bench()
    bench.sonar.write(bytes([0xAA, 0xA5, new_8bit]))
    assert bench.sonar.address == address
    bench.time_s = 0.1249
    assert bench.acknowledges() is (address == 0x70)
    bench.time_s = 0.1251
    assert bench.sonar.read(2) == PART_INFO
    bench.sonar.power_cycle()
    assert bench.sonar.address == address


def test_power_cycle_loses_the_ranging() -> None:
    bench = Bench([258, 300])
    assert bench.range() == 258
    bench.sonar.write(RANGE_COMMAND)
    bench.sonar.power_cycle()
    assert bench.sonar.read(2) == PART_INFO


@pytest.mark.parametrize(
    ("kind", "reading_cm", "word"),
    [
        ("clock_fault", 20, 32788),
        ("clock_fault", 765, 33533),
        ("or_ed", 765, 255),
        ("or_ed", 503, 247),
        ("or_ed", 200, 200),
        ("saturated", 765, 255),
        ("saturated", 500, 255),
        ("saturated", 200, 200),
        ("lost_high_byte", 765, 253),
        ("lost_high_byte", 503, 247),
        ("impossible", 258, 1000),
    ],
)
def test_a_corrupted_answer_is_seen_only_while_the_fault_lasts(kind: str, reading_cm: int, word: int) -> None:
    bench = Bench([reading_cm], [Fault(kind, 1.0, 2.0)])
    bench.ping()
    seen = []
    for bench.time_s in (0.5, 1.0, 1.99, 2.0):
        seen.append(bench.word())
    assert seen == [reading_cm, word, word, reading_cm]


def test_faults_of_the_answer_add_up_in_their_order() -> None:
    faults = [lasting("lost_high_byte"), lasting("clock_fault")]
    assert Bench([765], faults).range() == 0x80FD


def test_the_impossible_word_is_a_choice() -> None:
    assert Bench([258], [lasting("impossible", word=0)]).range() == 0


def test_silent_and_then_well_again() -> None:
    bench = Bench([258, 300], [Fault("silent", 1.0, 2.0)])
    assert bench.range() == 258
    bench.time_s = 1.5
    with pytest.raises(NotAcknowledged):
        bench.sonar.write(RANGE_COMMAND)
    assert not bench.acknowledges()
    bench.time_s = 2.0
    # Who reads only, and does not ping after a failed read, sees the old ranging for ever.
    assert [bench.word(), bench.word(), bench.range()] == [258, 258, 300]


def test_missed_read_happens_once_a_ranging() -> None:
    bench = Bench([258, 300], [lasting("missed_read")])
    for reading_cm in (258, 300):
        bench.ping()
        assert [bench.acknowledges(), bench.acknowledges()] == [False, True]
        assert bench.word() == reading_cm


def test_a_ranging_sensor_does_not_use_up_its_missed_read() -> None:
    bench = Bench([258], [lasting("missed_read")])
    bench.sonar.write(RANGE_COMMAND)
    assert not bench.acknowledges()
    bench.time_s = AFTER_ANY_RANGING_S
    assert [bench.acknowledges(), bench.acknowledges()] == [False, True]


def test_stuck_repeats_the_last_reading_and_the_world_is_asked_all_the_same() -> None:
    bench = Bench([100, 200, 300, 400], [Fault("stuck", 0.07, 0.2)])
    assert [bench.range() for _ in range(4)] == [100, 100, 100, 400]
    assert len(bench.ping_times_s) == 4


def test_stuck_from_the_start_holds_the_first_reading() -> None:
    bench = Bench([100, 200], [lasting("stuck")])
    assert [bench.range() for _ in range(2)] == [100, 100]


def test_power_cycles_at_their_times() -> None:
    bench = Bench([258, 300], [Fault("power_cycle", 3.0, 3.0), Fault("power_cycle", 1.0, 2.0)])
    assert bench.range() == 258
    bench.time_s = 1.5
    assert not bench.acknowledges()
    bench.time_s = 2.5
    assert bench.sonar.read(2) == PART_INFO
    assert bench.range() == 300
    bench.time_s = 3.5
    assert bench.sonar.read(2) == PART_INFO


def test_a_missed_echo_takes_the_whole_cycle() -> None:
    bench = Bench([258, 258], [Fault("no_echo", 1.0, 2.0)])
    assert bench.range() == 258
    bench.time_s = 1.5
    bench.sonar.write(RANGE_COMMAND)
    bench.time_s = 1.5 + 0.066
    assert not bench.acknowledges()
    bench.time_s = 1.5 + 0.068
    assert bench.word() == 765


@pytest.mark.parametrize(
    ("reading_cm", "offset_cm", "word"),
    [(258, -80, 178), (258, 40.4, 298), (40, -80, 20), (765, 9, 765), (765, -80, 765)],
)
def test_an_offset_stays_within_what_the_sensor_can_answer(reading_cm: int, offset_cm: float, word: int) -> None:
    assert Bench([reading_cm], [lasting("offset", offset_cm=offset_cm)]).range() == word


@pytest.mark.parametrize(("kind", "word"), [("offset", 255), ("noisy", 255), ("no_echo", 765)])
def test_a_reading_that_may_be_no_echo_has_no_error_on_top(kind: str, word: int) -> None:
    """Two sensors without an echo, both off by 34 cm, would agree on 2.21 m."""
    assert Bench([255], [lasting(kind, offset_cm=-34.0)]).range() == word


def test_noise_has_its_spread_and_leaves_no_echo_alone() -> None:
    count, spread_cm = 400, 50.0
    bench = Bench([400] * count + [765], [lasting("noisy", spread_cm=spread_cm)])
    errors_cm = [bench.range() - 400 for _ in range(count)]
    assert abs(sum(errors_cm) / count) < 4 * spread_cm / count**0.5
    assert statistics.pstdev(errors_cm) == pytest.approx(spread_cm, rel=0.15)
    assert bench.range() == 765


def test_a_drift_grows_from_its_beginning() -> None:
    """At 0.07 s a ranging and 100 cm/s, 7 cm more each time; no echo stays no echo."""
    bench = Bench([300, 300, 300, 765], [Fault("drift", 0.07, FOR_EVER, rate_cm_s=-100.0)])
    assert [bench.range() for _ in range(4)] == [300, 300, 293, 765]


def test_a_constant_reading_whatever_is_there() -> None:
    bench = Bench([300, 300, 765, 310], [Fault("constant", 0.07, 0.2, constant_cm=457)])
    assert [bench.range() for _ in range(4)] == [300, 457, 457, 310]
    assert len(bench.ping_times_s) == 4


def test_the_answer_of_the_ping_before() -> None:
    bench = Bench([100, 200, 300, 400, 500], [Fault("previous_ping", 0.07, 0.2)])
    assert [bench.range() for _ in range(5)] == [100, 100, 200, 400, 500]


def test_an_answer_of_the_ping_before_needs_one() -> None:
    bench = Bench([100, 200, 300], [lasting("previous_ping"), Fault("power_cycle", 1.0, 1.0)])
    assert [bench.range(), bench.range()] == [100, 100]
    bench.time_s = 2.0
    assert bench.range() == 300


def test_a_fixed_object_hides_what_is_behind_it() -> None:
    """The nearest echo counts, no echo is none from the object, and the object is never nearer than the minimum."""
    fault = lasting("fixed_object", object_cm=40.0, jitter_cm=0.0)
    bench = Bench([25, 39, 41, 500, 765], [fault])
    assert [bench.range() for _ in range(5)] == [25, 39, 40, 40, 40]
    nearer = lasting("fixed_object", object_cm=12.0, jitter_cm=0.0)
    assert Bench([500], [nearer]).range() == 20


def test_a_fixed_object_swings_and_jitters() -> None:
    """Over whole periods a sine of 6 cm has a deviation of 6 / sqrt(2) cm; jitter adds its own square."""
    count = 400
    fault = lasting("fixed_object", object_cm=50.0, jitter_cm=3.0, swing_cm=6.0, swing_period_s=2.8)
    bench = Bench([300] * count, [fault])
    seen_cm = [bench.range() for _ in range(count)]
    assert statistics.mean(seen_cm) == pytest.approx(50.0, abs=4 * 5.2 / count**0.5)
    assert statistics.pstdev(seen_cm) == pytest.approx((6.0**2 / 2 + 3.0**2) ** 0.5, rel=0.1)
    assert max(seen_cm) - min(seen_cm) > 12


def test_dust_is_anywhere_above_the_ground() -> None:
    count = 400
    bench = Bench([765] * count + [60] * count, [lasting("dust", dust_cm=120.0)])
    seen_cm = [bench.range() for _ in range(count)]
    assert statistics.mean(seen_cm) == pytest.approx(70.0, abs=4 * 28.9 / count**0.5)
    assert (min(seen_cm) < 25, max(seen_cm) > 115, max(seen_cm) <= 120) == (True, True, True)
    assert max(bench.range() for _ in range(count)) == 60


@pytest.mark.parametrize(
    "kind",
    ["clock_fault", "missed_read", "stuck", "silent", "no_echo", "offset", "previous_ping", "fixed_object", "dust"],
)
def test_probability(kind: str) -> None:
    """How often the fault shows lies within five standard deviations of its probability, and a seed repeats it."""
    count, probability = 600, 0.3

    def shows(seed: int) -> list[bool]:
        readings_cm = [100 + i for i in range(count)]
        bench = Bench(readings_cm, [lasting(kind, probability=probability)], seed)
        shown = []
        for reading_cm in readings_cm:
            if kind == "silent":
                shown.append(not bench.acknowledges())
                continue
            bench.sonar.write(RANGE_COMMAND)
            bench.time_s += AFTER_ANY_RANGING_S
            shown.append(not bench.acknowledges() if kind == "missed_read" else bench.word() != reading_cm)
        return shown

    assert abs(sum(shows(1)) / count - probability) < 5 * (probability * (1 - probability) / count) ** 0.5
    assert shows(1) == shows(1) != shows(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "gremlin"}, "expected one of clock_fault"),
        ({"start_s": 3.0}, "after start_s 3.0"),
        ({"start_s": 2.0}, "after start_s 2.0"),
        ({"probability": 0.0}, "more than 0"),
        ({"kind": "locked_up", "probability": 0.5}, "always happens"),
        ({"kind": "impossible", "word": 0x10000}, "16 bits"),
        ({"kind": "noisy", "spread_cm": 0.0}, "more than 0"),
        ({"kind": "constant", "constant_cm": 0}, "constant_cm 0: expected more than 0"),
        ({"kind": "fixed_object", "object_cm": 0.0}, "object_cm 0.0: expected more than 0"),
        ({"kind": "fixed_object", "jitter_cm": -1.0}, "jitter_cm -1.0: expected 0 or more"),
        ({"kind": "fixed_object", "swing_period_s": 0.0}, "swing_period_s 0.0: expected more than 0"),
        ({"kind": "dust", "dust_cm": 0.0}, "dust_cm 0.0: expected more than 0"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Fault(**{"kind": "silent", "start_s": 1.0, "end_s": 2.0, **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize("word", [20, 765, 0x8014])
def test_a_word_that_a_healthy_sensor_gives_is_not_impossible(word: int) -> None:
    with pytest.raises(ValueError, match=f"word: found 0x{word:x}, which is a range"):
        Bench(faults=[Fault("impossible", 1.0, 2.0, word=word)])


@pytest.mark.parametrize(
    "fault", [Fault("silent", 0.0, 1.0, 0.5), *(Fault(kind, 0.0, 1.0) for kind in ("noisy", "fixed_object", "dust"))]
)
def test_a_random_generator_has_to_be_given(fault: Fault) -> None:
    with pytest.raises(ValueError, match=r"random\.Random"):
        EmulatedMB1242(0x70, lambda: 0.0, lambda ping_time_s: 100, faults=[fault])


@pytest.mark.parametrize("reading_cm", [-1, 0x10000])
def test_a_world_that_returns_no_word_of_two_bytes_is_refused(reading_cm: int) -> None:
    with pytest.raises(ValueError, match="expected what two bytes hold, 0 to 65535"):
        Bench([reading_cm]).ping()


def test_standard_library_only() -> None:
    """The device runs without this environment's packages and without msp_range."""
    folder = Path(msp_sim.device.device.__file__).parents[2]
    code = "import sys, msp_sim.device.device; print(*sorted(m for m in sys.modules if m.startswith('msp_')))"
    done = subprocess.run(
        [sys.executable, "-S", "-c", code],
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["msp_sim", "msp_sim.device", "msp_sim.device.device"]


class Wires:
    """Devices on one bus and a clock."""

    def __init__(self, *devices: PlainDevice) -> None:
        self.time_s = 0.0
        self.bus: Bus = EmulatedBus(devices, lambda: self.time_s)

    def errno_of_read(self, address: int) -> int | None:
        try:
            self.bus.read(address, 2)
        except BusError as error:
            return error.errno
        return None


def test_nobody_at_an_address() -> None:
    bus = EmulatedBus([PlainDevice(0x70)], lambda: 0.0)
    for verb, transfer in (("write", lambda: bus.write(0x71, b"\x51")), ("read", lambda: bus.read(0x71, 2))):
        with pytest.raises(BusError) as raised:
            transfer()
        assert (raised.value.errno, raised.value.verb, raised.value.address) == (121, verb, 0x71)
        assert not raised.value.locked_up


def test_other_adapters_use_other_numbers() -> None:
    with pytest.raises(BusError, match="errno 6 ENXIO"):
        EmulatedBus([], lambda: 0.0, nack_errno=errno.ENXIO).read(0x70, 2)


def test_two_sensors_at_one_address_get_the_same_and_answer_with_the_and() -> None:
    near, far = Bench([0x0102]), Bench([0x00F6])
    bus = EmulatedBus([near.sonar, far.sonar], lambda: 0.0)
    bus.write(0x70, RANGE_COMMAND)
    near.time_s = AFTER_ANY_RANGING_S
    assert bus.read(0x70, 2).hex() == "0102"
    far.time_s = AFTER_ANY_RANGING_S
    assert bus.read(0x70, 2).hex() == "0002"
    bus.write(0x70, bytes([0xAA, 0xA5, 0xE2]))
    assert {near.sonar.address, far.sonar.address} == {0x71}


def test_a_moved_sensor_is_found_at_its_new_address() -> None:
    bench = Bench()
    bus = EmulatedBus([bench.sonar, PlainDevice(0x70)], bench.now)
    bus.write(0x70, bytes([0xAA, 0xA5, 0xE2]))
    bench.time_s = 0.2
    assert bus.read(0x71, 2) == PART_INFO
    assert bus.read(0x70, 2) == b"\xff\xff"


class CountingBus(EmulatedBus):
    """Counts the reads."""

    reads = 0

    def read(self, address: Address, count: int) -> bytes:
        self.reads += 1
        return super().read(address, count)


def flown(reports_busy: bool, *faults: Fault) -> tuple[list[tuple[Ranging, str]], int]:
    """What 3 s of polling two sensors give, and how many reads it took; the clocks do not begin at the same time."""
    clock = VirtualClock(1000.1)

    def now() -> float:
        return clock.now() - 1000.1

    def echo(ping_s: float) -> int:
        return 20 + int(ping_s * 997) % 746

    sonars = [EmulatedMB1242(0x70, now, echo, faults=faults), EmulatedMB1242(0x71, now, echo)]
    bus = CountingBus(sonars, now, reports_busy=reports_busy)
    sensors = [PolledSensor(str(each.address), MB1242(bus, each.address), AnswerTiming(0.021, 0.08)) for each in sonars]
    poller = Poller(bus, clock, RoundRobin([[each] for each in sensors], 0.1, clock.now()))
    rangings: list[tuple[Ranging, str]] = []
    while now() < 3.0:
        clock.sleep_until(poller.next_event_s)
        # Errors are compared by their text.
        rangings += [(each._replace(error=None), str(each.error)) for each in poller.step()]
    return rangings, bus.reads


def test_attempts_that_would_fail_are_left_out_and_change_nothing() -> None:
    (asked, all_reads), (foretold, reads) = flown(False), flown(True)
    assert foretold == asked
    assert len(asked) == 30
    assert reads == len(asked) < all_reads / 6


@pytest.mark.parametrize(
    "fault",
    [
        Fault("silent", 1.0, 1.05),
        Fault("missed_read", 0.5, 2.0),
        Fault("power_cycle", 1.02, 1.03),
        Fault("locked_up", 1.01, 1.04),
    ],
    ids=lambda fault: fault.kind,
)
def test_on_a_bus_with_faults_every_attempt_is_made(fault: Fault) -> None:
    assert flown(True, fault) == flown(False, fault)


def test_lock_up_stops_every_address_until_the_bus_is_reopened() -> None:
    wires = Wires(PlainDevice(0x70), PlainDevice(0x40, faults=[Fault("locked_up", 1.0, 2.0)]))
    reopen_at_s = (1.2, 2.5)
    seen = []
    for wires.time_s in (0.5, 1.0, 1.2, 2.5, 3.0):
        before = wires.errno_of_read(0x70)
        if wires.time_s in reopen_at_s:
            wires.bus.reopen()
        seen.append((before, wires.errno_of_read(0x71)))
    timed_out, nobody = errno.ETIMEDOUT, errno.EREMOTEIO
    assert seen == [
        (None, nobody),
        (timed_out, timed_out),
        (timed_out, timed_out),
        (timed_out, nobody),
        (None, nobody),
    ]


def test_a_lock_up_that_nobody_saw_begin_still_needs_a_reopen() -> None:
    wires = Wires(PlainDevice(0x70, faults=[Fault("locked_up", 1.0, 1.0)]))
    wires.bus.reopen()
    wires.time_s = 60.0
    assert wires.errno_of_read(0x70) == errno.ETIMEDOUT
    wires.bus.close()
    wires.bus.close()
    assert wires.errno_of_read(0x70) is None
