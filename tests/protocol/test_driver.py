"""The driver and the poller against a scripted bus: which transfers, when, and what becomes of each answer."""

import errno
from collections.abc import Sequence
from typing import Any

import pytest

from msp_range.bus import Bus
from msp_range.clock import VirtualClock
from msp_range.reading import Status
from msp_range.sensors.mb1242 import MB1242, encode
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin
from tests.support.scripted_bus import Expected, read, reopen, scripted_bus, write

RANGE = b"\x51"
FRONT, REAR = 0x70, 0x71
NACK = errno.EREMOTEIO
FIRST_S, DEADLINE_S = 0.021, 0.080


def make_poller(bus: Bus, clock: VirtualClock, *addresses: int, together: bool = False) -> Poller:
    timing = AnswerTiming(FIRST_S, DEADLINE_S)
    sensors = [PolledSensor(f"at_{address:x}", MB1242(bus, address), timing, std_m=0.02) for address in addresses]
    groups = [sensors] if together else [[sensor] for sensor in sensors]
    return Poller(bus, clock, RoundRobin(groups, 0.100, clock.now()))


def poll(*script: Expected, until_s: float = 0.1, addresses: Sequence[int] = (FRONT,)) -> list[Ranging]:
    """What ended before ``until_s`` on a bus with this script; nothing is done at ``until_s`` itself."""
    clock, ended = VirtualClock(), []
    with scripted_bus(clock, *script) as bus:
        poller = make_poller(bus, clock, *addresses)
        while poller.next_event_s < until_s - 1e-9:
            clock.sleep_until(poller.next_event_s)
            ended += poller.step()
    return ended


def busy(address: int, ping_s: float, tries: int, first: int = 0) -> list[Expected]:
    """Reads that are not acknowledged, 3 ms apart from the first moment on."""
    return [read(address, errno=NACK, at_s=ping_s + FIRST_S + 0.003 * i) for i in range(first, first + tries)]


def test_one_ranging_is_one_command_and_plain_reads() -> None:
    script = [write(FRONT, RANGE, at_s=0.0), *busy(FRONT, 0.0, 5), read(FRONT, encode(258), at_s=0.036)]
    (ranging,) = poll(*script)
    reading = ranging.reading
    assert (reading.sensor, reading.status, reading.range_m, reading.raw) == ("at_70", Status.OK, 2.58, 258)
    assert reading.std_m == 0.02
    assert (ranging.ping_s, ranging.answered_s, ranging.error) == pytest.approx((0.0, 0.036, None))
    # The echo came after half of the way there and back, 58 us a centimetre; it was read 21 ms after the whole way.
    assert reading.time_s == pytest.approx(258 * 58e-6 / 2)


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (encode(20), Status.AT_MINIMUM),
        (encode(19), Status.IMPOSSIBLE),
        (encode(1000), Status.IMPOSSIBLE),
        (bytes([0x81, 0x02]), Status.CLOCK_FAULT),
    ],
)
def test_the_answer_ends_the_ranging_whatever_it_is(answer: bytes, status: Status) -> None:
    (ranging,) = poll(write(FRONT, RANGE), read(FRONT, answer))
    assert ranging.reading.status is status
    assert ranging.reading.raw == int.from_bytes(answer, "big")


def test_two_sensors_take_turns_and_no_echo_is_timed_at_the_ping() -> None:
    script = [
        write(FRONT, RANGE, at_s=0.0),
        *busy(FRONT, 0.0, 16),
        read(FRONT, encode(765), at_s=0.069),
        write(REAR, RANGE, at_s=0.1),
        read(REAR, encode(100), at_s=0.121),
        write(FRONT, RANGE, at_s=0.2),
        # It is not expected so soon after one that took 67 ms.
        read(FRONT, encode(100), at_s=0.240),
    ]
    nothing, near, _ = poll(*script, until_s=0.3, addresses=(FRONT, REAR))
    assert (nothing.reading.status, nothing.reading.time_s) == (Status.NO_ECHO, 0.0)
    assert nothing.reading.range_m is nothing.reading.std_m is None
    assert (near.reading.sensor, near.reading.time_s) == pytest.approx(("at_71", 0.1 + 0.0029))


def test_a_failed_read_is_given_up_at_the_deadline_and_pinged_again() -> None:
    script = [
        write(FRONT, RANGE, at_s=0.0),
        *busy(FRONT, 0.0, 20),
        read(FRONT, errno=NACK, at_s=DEADLINE_S),
        write(FRONT, RANGE, at_s=0.1),
        read(FRONT, encode(100), at_s=0.121),
    ]
    failed, good = poll(*script, until_s=0.2)
    assert (failed.reading.status, failed.reading.time_s, failed.reading.raw) == (Status.NO_ANSWER, 0.0, None)
    assert failed.error is not None
    assert failed.error.errno == NACK
    assert good.reading.range_m == 1.0


def test_a_ping_that_is_not_acknowledged_is_a_reading_and_does_not_stop_the_round() -> None:
    script = [
        write(FRONT, RANGE, errno=NACK, at_s=0.0),
        write(REAR, RANGE, at_s=0.1),
        read(REAR, encode(100)),
        write(FRONT, RANGE, at_s=0.2),
        read(FRONT, encode(100)),
    ]
    failed, *good = poll(*script, until_s=0.3, addresses=(FRONT, REAR))
    assert (failed.reading.status, failed.reading.sensor) == (Status.NO_ANSWER, "at_70")
    assert [each.reading.status for each in good] == [Status.OK, Status.OK]


@pytest.mark.parametrize("not_there", [errno.EREMOTEIO, errno.ENXIO, errno.ENODEV, errno.EIO])
def test_what_an_adapter_calls_not_acknowledged_makes_no_difference(not_there: int) -> None:
    script = [write(FRONT, RANGE), read(FRONT, errno=not_there), read(FRONT, encode(100))]
    (ranging,) = poll(*script)
    assert ranging.reading.range_m == 1.0


@pytest.mark.parametrize("lost", [errno.ETIMEDOUT, errno.ENOENT])
def test_a_bus_that_locks_up_or_goes_is_reopened_once_a_second(lost: int) -> None:
    script = [
        write(FRONT, RANGE, at_s=0.0),
        read(FRONT, errno=lost, at_s=FIRST_S),
        reopen(at_s=FIRST_S),
        *[write(FRONT, RANGE, errno=lost, at_s=0.1 * i) for i in range(1, 12)],
        reopen(at_s=1.1),
        write(FRONT, RANGE, at_s=1.2),
        read(FRONT, encode(100)),
    ]
    *failed, good = poll(*script, until_s=1.3)
    assert {each.reading.status for each in failed} == {Status.NO_ANSWER}
    assert {each.error.errno for each in failed if each.error} == {lost}
    assert good.reading.range_m == 1.0


def test_where_reopening_fails_that_is_the_error() -> None:
    script = [
        write(FRONT, RANGE, errno=errno.ENODEV),
        reopen(errno=errno.ENOENT),
        write(FRONT, RANGE, errno=errno.ENOENT),
    ]
    first, second = poll(*script, until_s=0.2)
    for each in (first, second):
        assert each.error is not None
        assert each.error.errno == errno.ENOENT
        assert each.error.bus_at_fault


LOCKED: dict[str, Any] = {"errno": errno.ETIMEDOUT, "takes_s": 1.0}
"""What a transfer of a bus that has locked up does: a second in the kernel, then errno 110."""


def test_on_a_bus_that_locks_up_each_step_is_one_transfer() -> None:
    """A group of three: what else is due has its time between any two of their transfers, and before a reopening."""
    clock = VirtualClock()
    third = 0x72
    script = [
        write(FRONT, RANGE, at_s=0.0),
        write(REAR, RANGE, **LOCKED, at_s=0.0),
        reopen(at_s=1.0, takes_s=1.0),
        write(third, RANGE, **LOCKED, at_s=2.0),
        reopen(at_s=3.0, errno=errno.ENOENT, takes_s=1.0),
        # The next turn; what the first sensor had to answer is too old to be asked for.
        write(FRONT, RANGE, at_s=4.0),
        write(REAR, RANGE, at_s=4.0),
        write(third, RANGE, at_s=4.0),
        read(FRONT, **LOCKED, at_s=4.0 + FIRST_S),
        reopen(at_s=5.0 + FIRST_S, takes_s=1.0),
    ]
    with scripted_bus(clock, *script) as bus:
        poller = make_poller(bus, clock, FRONT, REAR, third, together=True)
        ended: list[Ranging] = []
        while clock.now() < 6.0:
            clock.sleep_until(poller.next_event_s)
            began_s, done = clock.now(), bus.done
            ended += poller.step()
            assert bus.done <= done + 1
            assert clock.now() - began_s <= 1.0
    assert [(each.reading.sensor, each.error.errno if each.error else 0) for each in ended] == [
        ("at_71", errno.ETIMEDOUT),
        ("at_72", errno.ENOENT),
        ("at_70", errno.ETIME),
        ("at_70", errno.ETIMEDOUT),
    ]
    assert {each.reading.status for each in ended} == {Status.NO_ANSWER}


def test_the_pings_of_a_group_follow_each_other_at_once_and_so_do_their_reads() -> None:
    clock = VirtualClock()
    script = [
        write(FRONT, RANGE, at_s=0.0, takes_s=0.0005),
        write(REAR, RANGE, at_s=0.0005, takes_s=0.0005),
        read(FRONT, encode(100), at_s=0.0005 + FIRST_S, takes_s=0.0007),
        read(REAR, errno=NACK, at_s=0.0012 + FIRST_S, takes_s=0.0002),
        read(REAR, encode(100), at_s=0.0042 + FIRST_S, takes_s=0.0007),
        # From the last ping of the group to the first one of the next turn.
        write(FRONT, RANGE, at_s=0.101),
        write(REAR, RANGE, at_s=0.101),
    ]
    with scripted_bus(clock, *script) as bus:
        poller = make_poller(bus, clock, FRONT, REAR, together=True)
        while clock.now() < 0.101 or poller.next_event_s <= clock.now():
            clock.sleep_until(poller.next_event_s)
            done = bus.done
            poller.step()
            assert bus.done == done + 1


@pytest.mark.parametrize(
    ("reading_cm", "earliest_s"),
    [(100, 0.0158), (400, 0.0332), (765, 0.05437)],
)
def test_an_answer_that_comes_before_its_own_echo_could_is_impossible(reading_cm: int, earliest_s: float) -> None:
    clock = VirtualClock()
    with scripted_bus(clock, write(FRONT, RANGE), read(FRONT, encode(reading_cm))) as bus:
        sensor = MB1242(bus, FRONT)
        sensor.ping()
        answer = sensor.answer()
    soon, later = answer.arrived_after(earliest_s - 1e-4), answer.arrived_after(earliest_s + 1e-4)
    assert (soon.status, soon.range_m, soon.raw) == (Status.IMPOSSIBLE, None, reading_cm)
    assert later.status in (Status.OK, Status.NO_ECHO)


def test_what_is_read_without_a_ping_is_part_information() -> None:
    clock = VirtualClock()
    with scripted_bus(
        clock, read(FRONT, b"\x01\x2c"), write(FRONT, RANGE, errno=NACK), read(FRONT, b"\x01\x2c")
    ) as bus:
        sensor = MB1242(bus, FRONT)
        assert sensor.answer().status is Status.PART_INFO
        with pytest.raises(OSError, match="errno 121"):
            sensor.ping()
        assert sensor.answer().status is Status.PART_INFO
