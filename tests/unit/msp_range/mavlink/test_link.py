"""The bridge's protocol behaviour as a MAVLink component, in virtual time, against other components in memory."""

import math
import random
import struct
import tracemalloc
from collections.abc import Callable, Mapping
from typing import Any

import pymavlink.dialects.v20.ardupilotmega as ardupilotmega
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msp_range import __version__
from msp_range.clock import VirtualClock
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import Frame
from msp_range.mavlink.link import (
    ANSWERS_PER_S,
    DECODED_FROM_AUTOPILOT,
    DECODED_FROM_OTHERS,
    WAITING_FROM_AUTOPILOT,
    Link,
)
from tests.support.mavlink_ends import Component, MemoryTransport

GROUND_STATION = (255, 190)
START_S = 1000.0


class Bench:
    """A link, its clock, its transport, and what it has sent."""

    def __init__(
        self,
        wanted: Mapping[str, float] | None = None,
        component_id: int = 191,
        transport: MemoryTransport | None = None,
        **link: Any,
    ) -> None:
        self.clock = VirtualClock(START_S)
        self.transport = transport or MemoryTransport()
        self.received: list[Any] = []
        self.received_s: list[float] = []
        self.link = Link(
            self.transport,
            self.clock,
            component_id=component_id,
            on_message=self._on_message,
            wanted=wanted or {},
            **link,
        )
        self._parser = dialect.MAVLink(None)
        self._taken = 0

    def _on_message(self, time_s: float, message: Any) -> None:
        self.received.append(message)
        self.received_s.append(time_s)

    def run(self, duration_s: float, each_second: Callable[[], bytes] = bytes) -> None:
        """Let the link work; what ``each_second`` returns arrives once a second."""
        end_s = self.clock.now() + duration_s
        next_s = self.clock.now()
        while self.clock.now() < end_s:
            if self.clock.now() >= next_s:
                self.transport.arrived += each_second()
                next_s += 1.0
            self.link.service()
            self.clock.sleep_until(self.link.next_event_s)

    def run_each(self, interval_s: float, duration_s: float, arriving: Callable[[], bytes]) -> None:
        """Let the link work; what ``arriving`` returns arrives this often."""
        for _ in range(round(duration_s / interval_s)):
            self.arrive(arriving())
            self.run(interval_s - 0.005)

    def receive(self, *messages: Any, sender: tuple[int, int] = (7, 1)) -> None:
        """Let messages of one component arrive, and the link look at them."""
        component = Component(*sender)
        self.arrive(*(component.frame(each) for each in messages))

    def arrive(self, *frames: bytes) -> None:
        """Let frames arrive and the link look at them."""
        self.transport.arrived += b"".join(frames)
        self.link.service()
        self.clock.sleep_until(self.link.next_event_s)

    @property
    def knows_the_time(self) -> bool:
        """Whether times count from the autopilot's boot, and not from the bridge's start."""
        return self.link.autopilot_clock.time_boot_ms(START_S + 1.0) != 1000

    def sent(self, *kinds: str) -> list[Any]:
        """Messages sent since the last call, of these kinds."""
        new, self._taken = self.transport.frames[self._taken :], len(self.transport.frames)
        messages = [message for frame in new for message in self._parser.parse_buffer(frame)]
        return [message for message in messages if not kinds or message.get_type() in kinds]

    def answers(self, *kinds: str) -> list[Any]:
        """As `sent`, without the link's own requests for the time."""
        sent = self.sent(*(kinds or ("PING", "TIMESYNC")))
        return [each for each in sent if each.get_type() != "TIMESYNC" or each.tc1 != 0]


def source(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def command(number: int, param1: float, target: tuple[int, int]) -> Any:
    return dialect.MAVLink_command_long_message(*target, number, 0, param1, 0, 0, 0, 0, 0, 0)


class NewerTimesync(dialect.MAVLink_timesync_message):  # type: ignore[misc]
    """TIMESYNC as common.xml has it since 2025, made by hand as mavgen makes it."""

    fieldnames = ("tc1", "ts1", "target_system", "target_component")

    def __init__(self, tc1: int, ts1: int, target_system: int = 0, target_component: int = 0) -> None:
        super().__init__(tc1, ts1)
        self.target_system, self.target_component = target_system, target_component

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        payload = struct.pack("<qqBB", self.tc1, self.ts1, self.target_system, self.target_component)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1)
        return frame


def newer_timesync(tc1: int, ts1: int, target: tuple[int, int]) -> bytes:
    """One of the autopilot of system 7."""
    return Component(7).frame(NewerTimesync(tc1, ts1, *target))


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def met() -> Bench:
    """A bench that knows the autopilot of system 7, and of which nothing is left to be looked at."""
    bench = Bench()
    bench.arrive(Component(7).heartbeat())
    bench.sent()
    return bench


class Listening(MemoryTransport):
    """A transport that can be waited for."""

    files = (3,)


class TestWaiting:
    def test_without_files_the_transport_is_asked_every_5_ms(self, bench: Bench) -> None:
        bench.link.service()
        assert bench.link.files == ()
        assert bench.link.next_event_s == pytest.approx(START_S + 0.005)

    def test_with_files_the_link_waits_for_them(self) -> None:
        bench = Bench(transport=Listening())
        bench.link.service()
        assert bench.link.files == (3,)
        assert bench.link.next_event_s == pytest.approx(START_S + 0.05)
        bench.run(10.0)
        assert len(bench.sent("HEARTBEAT")) == 10

    def test_messages_that_follow_each_other_closely_are_read_together(self) -> None:
        bench = Bench(transport=Listening())
        bench.link.service()
        waits = []
        for at_ms in (3, 4, 9, 14, 34):
            bench.clock.sleep_until(START_S + at_ms / 1000)
            bench.transport.arrived += Component(7).heartbeat()
            bench.link.service()
            waits.append(bool(bench.link.files))
            assert bench.link.next_event_s - bench.clock.now() == pytest.approx(0.05 if waits[-1] else 0.005)
        assert waits == [True, False, False, False, True]

    def test_files_that_can_always_be_read_do_not_keep_the_bridge_awake(self) -> None:
        """Such as those of a server with as many clients as it takes, and one more that waits."""
        bench = Bench(transport=Listening())
        services = 0
        while bench.clock.now() < START_S + 1.0:
            can_be_read = bool(bench.link.files)
            bench.clock.sleep_until(bench.clock.now() + 1e-4 if can_be_read else bench.link.next_event_s)
            bench.link.service(can_be_read)
            services += 1
        assert services < 410


class TestHeartbeat:
    def test_is_an_onboard_controllers(self, bench: Bench) -> None:
        bench.link.system_status = dialect.MAV_STATE_ACTIVE
        bench.run(0.5)
        (beat,) = bench.sent("HEARTBEAT")
        assert (beat.type, beat.autopilot, beat.mavlink_version) == (18, 8, 3)
        assert (beat.base_mode, beat.custom_mode, beat.system_status) == (0, 0, 4)

    def test_is_not_sent_twice_for_a_loop_that_was_held_up(self, bench: Bench) -> None:
        bench.run(2.5)
        bench.sent()
        bench.clock.sleep_until(bench.clock.now() + 30.0)
        bench.run(0.9)
        assert len(bench.sent("HEARTBEAT")) == 1
        bench.run(3.0)
        assert len(bench.sent("HEARTBEAT")) == 3


class TestAddress:
    def test_system_1_until_a_heartbeat_is_received(self, bench: Bench) -> None:
        bench.run(2.0)
        assert {source(message) for message in bench.sent()} == {(1, 191)}
        assert bench.link.autopilot_system is None
        assert not bench.link.autopilot_is_present

    def test_the_autopilots_system_from_then_on(self, bench: Bench) -> None:
        bench.arrive(Component(42).heartbeat())
        bench.sent()
        bench.run(2.0)
        assert {source(message) for message in bench.sent()} == {(42, 191)}
        assert bench.link.autopilot_is_present

    def test_component_id_is_the_airframes(self) -> None:
        bench = Bench(component_id=192)
        bench.run(0.5)
        assert {source(message) for message in bench.sent()} == {(1, 192)}

    def test_an_autopilot_that_speaks_mavlink_1_is_answered_in_mavlink_2(self, bench: Bench) -> None:
        bench.arrive(Component(5).heartbeat(mavlink1=True))
        assert bench.link.autopilot_system == 5
        bench.run(1.5)
        assert {frame[0] for frame in bench.transport.frames} == {0xFD}

    def test_frames_are_numbered_without_a_gap(self, met: Bench) -> None:
        first = len(met.transport.frames)
        met.run(200.0, Component(7).heartbeat)
        numbers = [frame[4] for frame in met.transport.frames[first:]]
        assert len(numbers) > 300
        assert numbers == [(numbers[0] + i) % 256 for i in range(len(numbers))]

    @pytest.mark.parametrize(
        ("type", "autopilot", "address"),
        [
            (dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, GROUND_STATION),
            (dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, (9, 1)),
            (dialect.MAV_TYPE_GIMBAL, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, (9, 154)),
        ],
    )
    def test_nobody_else_is_taken_for_an_autopilot(
        self, bench: Bench, type: int, autopilot: int, address: tuple[int, int]
    ) -> None:
        bench.arrive(Component(*address).frame(dialect.MAVLink_heartbeat_message(type, autopilot, 0, 0, 4, 3)))
        assert bench.link.autopilot_system is None
        assert not bench.link.autopilot_is_present

    def test_a_second_autopilot_takes_the_place_of_one_that_has_gone(self, bench: Bench) -> None:
        bench.arrive(Component(3).heartbeat(), Component(3).frame(dialect.MAVLink_system_time_message(0, 90_000)))
        bench.run(20.0, Component(4).heartbeat)
        assert bench.link.autopilot_system == 4
        assert not bench.knows_the_time
        assert source(bench.sent("HEARTBEAT")[-1]) == (4, 191)

    def test_a_second_autopilots_time_and_messages_are_not_the_firsts(self, bench: Bench) -> None:
        first, second = Component(3), Component(4)
        time = dialect.MAVLink_system_time_message(0, 777_000)
        bench.arrive(first.heartbeat())
        bench.arrive(second.heartbeat(), second.frame(time))
        assert not bench.knows_the_time
        assert [message.msgname for message in bench.received] == ["HEARTBEAT"]
        assert bench.received_s == [START_S]

    def test_an_autopilot_that_has_gone_is_missed(self, met: Bench) -> None:
        met.run(4.5)
        assert met.link.autopilot_is_present
        met.run(1.0)
        assert not met.link.autopilot_is_present
        assert met.link.autopilot_system == 7
        met.arrive(Component(7).heartbeat())
        assert met.link.autopilot_is_present

    def test_its_own_echo_is_passed_over(self, met: Bench) -> None:
        """An autopilot or a router may send back what it got."""
        met.receive(
            command(dialect.MAV_CMD_REQUEST_MESSAGE, 0, (7, 191)),
            dialect.MAVLink_timesync_message(0, 5),
            dialect.MAVLink_ping_message(1, 2, 0, 0),
            sender=(7, 191),
        )
        assert met.answers("COMMAND_ACK", "PING", "HEARTBEAT", "TIMESYNC") == []


class TestAnswers:
    def test_ping_of_all_is_answered_to_the_autopilot(self, met: Bench) -> None:
        met.receive(dialect.MAVLink_ping_message(123456, 9, 0, 0))
        (answer,) = met.sent("PING")
        assert (answer.time_usec, answer.seq) == (123456, 9)
        assert (answer.target_system, answer.target_component) == (7, 1)

    def test_an_answer_to_a_ping_is_not_answered(self, met: Bench) -> None:
        met.receive(dialect.MAVLink_ping_message(123456, 9, 7, 191))
        assert met.sent("PING") == []

    @pytest.mark.parametrize("stranger", [GROUND_STATION, (7, 240), (8, 1)])
    def test_nobody_else_gets_an_answer_to_ping_or_timesync(self, met: Bench, stranger: tuple[int, int]) -> None:
        requests = dialect.MAVLink_ping_message(1, 2, 0, 0), dialect.MAVLink_timesync_message(0, 4321)
        met.receive(*requests, sender=stranger)
        assert met.answers() == []

    def test_answers_come_at_a_limited_rate(self, met: Bench) -> None:
        """Each answer goes to every peer: without a limit, few bytes in would be many out."""
        autopilot = Component(7)
        met.run(0.05)
        met.sent()
        ground_station = Component(*GROUND_STATION)
        for _ in range(200):
            requests = [autopilot.frame(dialect.MAVLink_timesync_message(0, 4321)) for _ in range(5)]
            requests += [autopilot.frame(dialect.MAVLink_ping_message(1, 2, 0, 0)) for _ in range(5)]
            requests += [ground_station.frame(command(dialect.MAV_CMD_NAV_LAND, 0, (7, 191))) for _ in range(5)]
            met.arrive(*requests)
        took_s = 200 * 0.005
        answers = [each.get_type() for each in met.answers("PING", "TIMESYNC", "COMMAND_ACK")]
        acknowledged = answers.count("COMMAND_ACK")
        expected = pytest.approx(ANSWERS_PER_S * (1 + took_s), abs=2)
        assert len(answers) - acknowledged == expected
        assert acknowledged == expected

    def test_px4s_ten_requests_a_second_are_all_answered(self, met: Bench) -> None:
        autopilot = Component(7)
        for number in range(1, 101):
            met.arrive(autopilot.frame(dialect.MAVLink_timesync_message(0, number)))
            met.run(0.095)
        answers = [each.ts1 for each in met.answers("TIMESYNC")]
        assert answers == list(range(1, 101))

    def test_timesync_is_answered_with_the_bridges_time(self, met: Bench) -> None:
        met.receive(dialect.MAVLink_timesync_message(0, 4321))
        (answer,) = met.answers("TIMESYNC")
        assert answer.ts1 == 4321
        # Served at the moment of arrival, and the clock has gone on to the next event since.
        assert answer.tc1 * 1e-9 == pytest.approx(met.clock.now(), abs=0.006)

    @pytest.mark.parametrize("system", [0, 7])
    def test_request_for_the_heartbeat(self, met: Bench, system: int) -> None:
        request = command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_HEARTBEAT, (system, 191))
        met.receive(request, sender=GROUND_STATION)
        acknowledgement, beat = met.sent("COMMAND_ACK", "HEARTBEAT")
        assert (acknowledgement.command, acknowledgement.result) == (512, dialect.MAV_RESULT_ACCEPTED)
        assert (acknowledgement.target_system, acknowledgement.target_component) == GROUND_STATION
        assert beat.get_type() == "HEARTBEAT"

    def test_request_for_who_this_is(self, met: Bench) -> None:
        met.receive(command(dialect.MAV_CMD_REQUEST_MESSAGE, 396, (7, 191)), sender=GROUND_STATION)
        acknowledgement, basic = met.sent("COMMAND_ACK", "UNKNOWN_396")
        assert acknowledgement.result == dialect.MAV_RESULT_ACCEPTED
        assert b"msp-range\0" in basic.data
        assert __version__.encode() in basic.data

    @pytest.mark.parametrize("message_id", [30.0, 0.5, -1.0, 1e30, float("nan"), float("inf")])
    def test_request_for_what_it_does_not_have_is_denied(self, met: Bench, message_id: float) -> None:
        request = command(dialect.MAV_CMD_REQUEST_MESSAGE, message_id, (7, 191))
        met.receive(request, sender=GROUND_STATION)
        (acknowledgement,) = met.sent("COMMAND_ACK", "HEARTBEAT")
        assert acknowledgement.result == dialect.MAV_RESULT_DENIED

    def test_a_command_that_it_does_not_know_is_acknowledged_as_unsupported(self, met: Bench) -> None:
        arm = command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, (7, 191))
        land = dialect.MAVLink_command_int_message(7, 191, 0, dialect.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        met.receive(arm, land, sender=GROUND_STATION)
        answers = met.sent("COMMAND_ACK")
        assert [(answer.command, answer.result) for answer in answers] == [
            (dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_RESULT_UNSUPPORTED),
            (dialect.MAV_CMD_NAV_LAND, dialect.MAV_RESULT_UNSUPPORTED),
        ]

    @pytest.mark.parametrize("target", [(0, 0), (7, 0)])
    def test_a_command_to_all_gets_no_refusal(self, met: Bench, target: tuple[int, int]) -> None:
        """Otherwise arming the vehicle would show 'unsupported' in a ground station."""
        arm = command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, target)
        met.receive(arm, command(dialect.MAV_CMD_REQUEST_MESSAGE, 148, target), sender=GROUND_STATION)
        assert met.sent("COMMAND_ACK") == []
        met.receive(command(dialect.MAV_CMD_REQUEST_MESSAGE, 396, target), sender=GROUND_STATION)
        assert len(met.sent("COMMAND_ACK", "UNKNOWN_396")) == 2

    @pytest.mark.parametrize("target", [(7, 1), (7, 192), (8, 191), (1, 191), (8, 0)])
    def test_a_command_to_others_is_not_its_business(self, met: Bench, target: tuple[int, int]) -> None:
        requests = [command(each, 0, target) for each in (dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAV_CMD_NAV_LAND)]
        met.receive(*requests, sender=GROUND_STATION)
        assert met.sent("COMMAND_ACK", "HEARTBEAT") == []


class TestTime:
    def test_asks_nobody_while_there_is_no_autopilot(self, bench: Bench) -> None:
        bench.run(3.0)
        assert bench.sent("TIMESYNC") == []

    def test_is_the_autopilots_soon_after_its_first_heartbeat(self, bench: Bench) -> None:
        autopilot = Component(7)
        boot_s = START_S - 250.0
        bench.arrive(autopilot.heartbeat())
        for _ in range(200):
            requests = [message for message in bench.sent("TIMESYNC") if message.tc1 == 0]
            now_ns = round((bench.clock.now() - boot_s) * 1e9)
            bench.arrive(*(autopilot.frame(dialect.MAVLink_timesync_message(now_ns, each.ts1)) for each in requests))
        echo_s = bench.clock.now()
        # The link looks at what has come every 5 ms: the way back takes at most that, and half of it is the error.
        assert bench.link.autopilot_clock.time_boot_ms(echo_s) == pytest.approx((echo_s - boot_s) * 1e3, abs=2.5 + 1.0)

    def test_goes_on_asking_for_the_time_once_it_is_known(self, bench: Bench) -> None:
        """Clocks drift by some milliseconds a minute, and an autopilot may start anew."""
        autopilot = Component(7)
        for _ in range(10):
            bench.run(1.0, autopilot.heartbeat)
            requests = [message for message in bench.sent("TIMESYNC") if message.tc1 == 0]
            assert requests
            bench.arrive(*(autopilot.frame(dialect.MAVLink_timesync_message(10**12, each.ts1)) for each in requests))
        assert bench.knows_the_time

    @pytest.mark.parametrize(("target", "is_answered"), [((7, 191), True), ((0, 0), True), ((7, 192), False)])
    def test_newer_timesync_is_answered_only_where_it_is_for_the_bridge(
        self, met: Bench, target: tuple[int, int], is_answered: bool
    ) -> None:
        met.arrive(newer_timesync(0, 5, target))
        assert [each.ts1 for each in met.answers("TIMESYNC")] == [5] * is_answered
        met.run(0.2)
        request = [each for each in met.sent("TIMESYNC") if each.tc1 == 0][-1]
        met.arrive(newer_timesync(50 * 10**9, request.ts1, target))
        assert met.knows_the_time is is_answered

    def test_timesync_has_a_target_where_the_dialect_has_one(self, met: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(dialect, "MAVLink_timesync_message", NewerTimesync)
        met.arrive(Component(7).heartbeat(), newer_timesync(0, 5, (0, 0)))
        met.run(1.1)
        frames = [frame for frame in met.transport.frames if frame[7] == dialect.MAVLINK_MSG_ID_TIMESYNC]
        new = [tuple(frame[10 : 10 + frame[1]][16:]) for frame in frames if frame[1] > 16]
        assert len(new) >= 2
        assert set(new) == {(7, 1)}

    def test_another_companion_computers_answer_is_not_the_autopilots(self, bench: Bench) -> None:
        """mavros answers TIMESYNC too, from the same system."""
        bench.arrive(Component(7).heartbeat())
        bench.run(0.05)
        request = bench.sent("TIMESYNC")[0]
        bench.arrive(Component(7, 240).frame(dialect.MAVLink_timesync_message(10**15, request.ts1)))
        assert not bench.knows_the_time
        bench.receive(dialect.MAVLink_timesync_message(50 * 10**9, request.ts1))
        assert bench.knows_the_time

    def test_does_not_jump_at_the_first_heartbeat_of_an_autopilot_without_timesync(self, bench: Bench) -> None:
        bench.run(20.0)
        before_ms = bench.link.autopilot_clock.time_boot_ms(bench.clock.now())
        bench.arrive(Component(7).heartbeat())
        assert bench.link.autopilot_clock.time_boot_ms(bench.clock.now()) == pytest.approx(before_ms, abs=10)

    def test_system_time_of_the_autopilot_stands_in(self, met: Bench) -> None:
        met.receive(dialect.MAVLink_system_time_message(0, 60_000))
        assert met.link.autopilot_clock.time_boot_ms(met.clock.now()) == pytest.approx(60_000, abs=6)
        met.receive(dialect.MAVLink_system_time_message(0, 100))
        assert met.link.autopilot_clock.reboots == 1


class TestWanted:
    PRESSURE = dialect.MAVLINK_MSG_ID_SCALED_PRESSURE

    def requests(self, bench: Bench) -> list[Any]:
        asked = bench.sent("COMMAND_LONG")
        assert all(each.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL for each in asked)
        return asked

    def test_is_not_asked_for_before_there_is_an_autopilot(self) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 2.0})
        bench.run(10.0)
        assert self.requests(bench) == []

    def test_is_asked_of_the_autopilot_at_its_rate(self) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 2.0, "ATTITUDE": 20.0})
        bench.run(2.0, Component(7).heartbeat)
        asked = self.requests(bench)
        assert [(each.target_system, each.target_component) for each in asked] == [(7, 1)] * 2
        assert [(each.param1, each.param2) for each in asked] == [(30, 50_000), (self.PRESSURE, 500_000)]

    def test_is_asked_for_again_only_while_it_does_not_come(self) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 2.0})
        autopilot = Component(7)
        bench.run(30.0, autopilot.heartbeat)
        assert 5 <= len(self.requests(bench)) <= 7
        pressure = dialect.MAVLink_scaled_pressure_message(0, 1013.0, 0.0, 2000)
        twice = autopilot.frame(pressure) * 2
        bench.run(5.0, lambda: autopilot.heartbeat() + twice)
        self.requests(bench)
        bench.run(30.0, lambda: autopilot.heartbeat() + twice)
        assert self.requests(bench) == []
        bench.run(30.0, autopilot.heartbeat)
        assert 4 <= len(self.requests(bench)) <= 6

    def test_is_asked_for_where_it_comes_too_slowly(self) -> None:
        """Four attitudes a second that came by themselves kept the bridge from asking for ten."""
        bench = Bench(wanted={"ATTITUDE": 10.0})
        autopilot = Component(7)
        attitude = autopilot.frame(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
        bench.run(3.0, lambda: autopilot.heartbeat() + attitude * 4)
        assert len(self.requests(bench)) == 1
        bench.run(7.0, lambda: autopilot.heartbeat() + attitude * 10)
        self.requests(bench)
        bench.run(30.0, lambda: autopilot.heartbeat() + attitude * 10)
        assert self.requests(bench) == []

    @pytest.mark.parametrize(
        "result", [dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_UNSUPPORTED, dialect.MAV_RESULT_FAILED]
    )
    def test_is_not_asked_for_after_a_refusal(self, result: int) -> None:
        """ArduPilot shows the pilot a text for each request for a message that it does not know."""
        bench = Bench(wanted={"HIL_STATE_QUATERNION": 25.0, "ATTITUDE": 10.0})
        autopilot = Component(7)
        asked = []

        def answers() -> bytes:
            frames = autopilot.heartbeat()
            for each in self.requests(bench):
                asked.append(each.param1)
                accepted = each.param1 == dialect.MAVLINK_MSG_ID_ATTITUDE
                frames += self.answer(autopilot, dialect.MAV_RESULT_ACCEPTED if accepted else result)
            return frames

        bench.run_each(0.01, 60.0, answers)
        assert asked.count(dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION) == 1
        assert asked.count(dialect.MAVLINK_MSG_ID_ATTITUDE) > 3

    def answer(self, autopilot: Component, result: int, target: tuple[int, int] = (7, 191)) -> bytes:
        number = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
        return autopilot.frame(dialect.MAVLink_command_ack_message(number, result, 0, 0, *target))

    @pytest.mark.parametrize(
        ("sender", "target", "refused"),
        [((7, 1), (7, 191), True), ((7, 1), (0, 0), True), ((7, 1), (255, 190), False), ((8, 1), (7, 191), False)],
    )
    def test_a_refusal_is_the_autopilots_and_the_bridges(
        self, sender: tuple[int, int], target: tuple[int, int], refused: bool
    ) -> None:
        bench = Bench(wanted={"ATTITUDE": 10.0})
        bench.arrive(Component(7).heartbeat())
        bench.run(1.5)
        assert len(self.requests(bench)) == 1
        bench.arrive(self.answer(Component(*sender), dialect.MAV_RESULT_DENIED, target))
        assert [each.next_check_s == math.inf for each in bench.link.wanted._messages.values()] == [refused]

    def test_an_autopilot_that_comes_back_is_asked_anew(self) -> None:
        """It may have another program by now."""
        bench = Bench(wanted={"ATTITUDE": 10.0})
        autopilot = Component(7)
        bench.run(1.5, autopilot.heartbeat)
        bench.arrive(self.answer(autopilot, dialect.MAV_RESULT_DENIED))
        bench.run(30.0, autopilot.heartbeat)
        assert len(self.requests(bench)) == 1
        bench.run(10.0)
        bench.run(3.0, autopilot.heartbeat)
        assert len(self.requests(bench)) == 1

    def test_a_message_with_a_field_called_id_is_known_when_it_comes(self) -> None:
        bench = Bench(wanted={"HYGROMETER_SENSOR": 1.0})
        autopilot = Component(7)
        humidity = dialect.MAVLink_hygrometer_sensor_message(0, 2100, 4500)
        bench.run(30.0, lambda: autopilot.heartbeat() + autopilot.frame(humidity))
        assert len(self.requests(bench)) <= 1

    def test_another_message_with_a_field_called_id_is_not_taken_for_it(self) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 2.0})
        autopilot = Component(7)
        other = dialect.MAVLink_hygrometer_sensor_message(self.PRESSURE, 2100, 4500)
        bench.run(30.0, lambda: autopilot.heartbeat() + autopilot.frame(other))
        assert len(self.requests(bench)) >= 5


class TestSending:
    def test_status_texts_are_cut_to_what_the_message_holds(self, met: Bench) -> None:
        met.link.send_text(dialect.MAV_SEVERITY_WARNING, "x" * 60)
        met.link.send_text(dialect.MAV_SEVERITY_ERROR, "21 °C")
        long, odd = met.sent("STATUSTEXT")
        assert (long.severity, long.text) == (4, "x" * 50)
        assert (odd.severity, odd.text) == (3, "21 ?C")

    def test_what_the_transport_dropped_is_counted_apart(self, bench: Bench) -> None:
        bench.run(1.5)
        bench.transport.takes = False
        bench.run(3.0)
        assert bench.link.sent["HEARTBEAT"] == 2
        assert bench.link.dropped["HEARTBEAT"] == 3
        assert bench.link.send(dialect.MAVLink_ping_message(0, 0, 0, 0)) is None


class TestSomebodyElse:
    """Who is on the link and should not be."""

    def texts(self, bench: Bench) -> list[str]:
        texts = [condition.text for condition in bench.link.conditions() if condition.text is not None]
        assert all(len(text) <= 50 for text in texts)
        return texts

    def test_a_second_autopilot_is_reported_until_it_is_gone(self) -> None:
        bench = Bench()
        first, second = Component(3), Component(254)
        bench.run(5.0, lambda: first.heartbeat() + second.heartbeat())
        assert self.texts(bench) == ["Range: second autopilot, system 254 (using 3)"]
        bench.run(8.0, first.heartbeat)
        assert self.texts(bench) != []
        bench.run(3.0, first.heartbeat)
        assert self.texts(bench) == []

    def test_the_first_autopilot_wins_again_when_it_is_back(self) -> None:
        """After nine seconds of silence the bridge joined the neighbour's vehicle, and stayed there."""
        bench = Bench()
        first, second = Component(3), Component(254)
        bench.run(5.0, lambda: first.heartbeat() + second.heartbeat())
        bench.run(9.0, second.heartbeat)
        assert bench.link.autopilot_system == 254
        assert "Range: autopilot 3 is silent, using 254" in self.texts(bench)
        bench.arrive(second.heartbeat(), first.heartbeat())
        assert bench.link.autopilot_system == 3
        bench.run(1.0, lambda: first.heartbeat() + second.heartbeat())
        assert source(bench.sent()[-1]) == (3, 191)
        bench.run(12.0, lambda: first.heartbeat() + second.heartbeat())
        assert self.texts(bench) == ["Range: second autopilot, system 254 (using 3)"]

    def attitude(self, time_s: float, roll: float, rate: float = 0.0) -> Any:
        return dialect.MAVLink_attitude_message(round(time_s * 1e3), roll, 0.0, 0.0, rate, 0.0, 0.0)

    @pytest.mark.parametrize(("behind_s", "roll"), [(5.0, 0.0), (0.0, 0.5), (300.0, 0.5)])
    def test_two_vehicles_with_the_same_ids_are_reported(self, behind_s: float, roll: float) -> None:
        bench = Bench()
        autopilot = Component(7)

        def both() -> bytes:
            now_s = bench.clock.now()
            others = self.attitude(now_s - behind_s, roll)
            own = [autopilot.frame(self.attitude(now_s - 0.1, 0.01)), autopilot.frame(self.attitude(now_s, 0.0))]
            return autopilot.heartbeat() + b"".join([*own, autopilot.frame(others)])

        bench.run_each(0.2, 5.0, both)
        assert self.texts(bench) == ["Range: two autopilots send as system 7"]
        bench.run(12.0, autopilot.heartbeat)
        assert self.texts(bench) == []

    @pytest.mark.parametrize("hz", [4.0, 10.0])
    def test_one_vehicle_that_rocks_reboots_and_is_read_late_is_one(self, hz: float) -> None:
        bench = Bench()
        autopilot = Component(7)
        chance = random.Random(1)
        booted_s = START_S - 100.0
        for turn in range(600):
            if turn == 300:
                booted_s = bench.clock.now()
            time_s = bench.clock.now() - booted_s
            roll, rate = 0.6 * math.sin(6.0 * time_s), 3.6 * math.cos(6.0 * time_s)
            odd = float("inf") if turn % 50 == 0 else roll
            bench.transport.arrived += autopilot.heartbeat() + autopilot.frame(self.attitude(time_s, odd, rate))
            bench.clock.sleep_until(bench.clock.now() + 1.0 / hz)
            if chance.random() < 0.7:  # else several lie unread, as while a transfer on the bus keeps the loop
                bench.link.service()
            assert self.texts(bench) == []

    def test_a_pinned_autopilot_is_the_only_one(self) -> None:
        bench = Bench(system_id=7)
        bench.arrive(Component(3).heartbeat(), Component(3).frame(dialect.MAVLink_system_time_message(0, 90_000)))
        assert bench.link.autopilot_system is None
        assert not bench.link.autopilot_is_present
        assert bench.received == []
        assert self.texts(bench) == ["Range: autopilot is system 3, file says 7"]
        assert source(bench.link.send(dialect.MAVLink_ping_message(0, 0, 0, 0)) and bench.sent()[-1]) == (7, 191)
        bench.arrive(Component(3).heartbeat(), Component(7).heartbeat())
        assert bench.link.autopilot_system == 7
        bench.run(30.0, Component(3).heartbeat)
        assert bench.link.autopilot_system == 7
        assert not bench.link.autopilot_is_present

    @pytest.mark.parametrize(
        ("expected", "found", "text"),
        [
            ("ardupilot", dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, None),
            ("px4", dialect.MAV_AUTOPILOT_PX4, None),
            ("ardupilot", dialect.MAV_AUTOPILOT_PX4, "Range: autopilot is px4, file says ardupilot"),
            ("px4", dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, "Range: autopilot is ardupilot, file says px4"),
            ("ardupilot", dialect.MAV_AUTOPILOT_GENERIC, "Range: autopilot is type 0, file says ardupilot"),
        ],
    )
    def test_an_autopilot_of_another_type_is_reported(self, expected: str, found: int, text: str | None) -> None:
        bench = Bench(autopilot=expected)
        beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_QUADROTOR, found, 0, 0, 4, 3)
        autopilot = Component(7)
        bench.run(3.0, lambda: autopilot.frame(beat))
        assert self.texts(bench) == ([] if text is None else [text])

    def test_another_program_with_the_bridges_ids_is_reported_until_it_stops(self) -> None:
        bench = Bench()
        autopilot, double = Component(7), Component(7, 191)
        beat = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        bench.run(5.0, lambda: autopilot.heartbeat() + double.frame(beat))
        assert self.texts(bench) == ["Range: another program sends as 7/191"]
        bench.run(12.0, autopilot.heartbeat)
        assert self.texts(bench) == []

    def test_its_own_frames_that_come_back_are_not_another_programs(self) -> None:
        bench = Bench()
        autopilot = Component(7)
        bench.run_each(0.1, 60.0, lambda: autopilot.heartbeat() + b"".join(bench.transport.frames[-3:]))
        assert self.texts(bench) == []

    def test_what_a_router_still_held_from_before_a_restart_is_not_another_programs(self) -> None:
        bench = Bench()
        old = Component(7, 191)
        bench.arrive(Component(7).heartbeat())
        for _ in range(20):
            bench.arrive(old.frame(dialect.MAVLink_ping_message(1, 2, 0, 0)))
        assert self.texts(bench) == []


class TestFlood:
    """One call does a bounded amount of work."""

    ATTITUDE = dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)

    def decoded(self, monkeypatch: pytest.MonkeyPatch) -> list[int]:
        """System ids of what is decoded from now on."""
        systems: list[int] = []
        real = Frame.decode

        def decode(frame: Frame) -> Any:
            systems.append(frame.system)
            return real(frame)

        monkeypatch.setattr(Frame, "decode", decode)
        return systems

    def test_a_call_decodes_a_bounded_number(self, met: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        decoded = self.decoded(monkeypatch)
        autopilot, other = Component(7), Component(8)
        met.arrive(autopilot.frame(self.ATTITUDE) * 150, other.heartbeat() * 30)
        assert decoded == [7] * DECODED_FROM_AUTOPILOT + [8] * DECODED_FROM_OTHERS

    def test_what_arrived_in_a_second_of_a_locked_up_bus_is_not_lost(self, met: Bench) -> None:
        met.received.clear()
        met.arrive(Component(7).frame(self.ATTITUDE) * WAITING_FROM_AUTOPILOT)
        met.run(0.05)
        assert len(met.received) == WAITING_FROM_AUTOPILOT

    def test_a_flood_of_others_does_not_hide_the_autopilot(self, met: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        """20,000 messages a second of every kind that the bridge listens to, and 100 of the autopilot."""
        ground_station, autopilot = Component(*GROUND_STATION), Component(7)
        flood = [
            ground_station.frame(command(dialect.MAV_CMD_NAV_LAND, 0, (7, 191))) * 20,
            Component(8).heartbeat() * 20,
            Component(7, 191).frame(self.ATTITUDE) * 20,
            ground_station.frame(dialect.MAVLink_timesync_message(0, 1)) * 20,
            Component(7, 154).frame(self.ATTITUDE) * 20,
        ]
        met.received.clear()
        decoded = self.decoded(monkeypatch)
        for number in range(200):
            wanted = autopilot.frame(self.ATTITUDE) if number % 2 else b""
            met.arrive(*flood, wanted)
        assert len(met.received) == 100
        assert len(decoded) <= 200 * (1 + DECODED_FROM_OTHERS)

    def test_a_flood_of_the_autopilots_own_hides_no_heartbeat_and_is_not_decoded_late(self, met: Bench) -> None:
        """Of 20,000 attitudes a second the newest decoded one is at most 256 messages old, 13 ms."""
        autopilot = Component(7)
        heartbeats = 0
        for number in range(400):
            frames = [
                autopilot.frame(dialect.MAVLink_attitude_message(100 * number + i, 0, 0, 0, 0, 0, 0))
                for i in range(100)
            ]
            met.received.clear()
            met.arrive(*([autopilot.heartbeat()] if number % 50 == 0 else []), *frames)
            newest_ms = max((each.time_boot_ms for each in met.received if each.msgname == "ATTITUDE"), default=0)
            assert newest_ms >= 100 * number - WAITING_FROM_AUTOPILOT
            heartbeats += sum(each.msgname == "HEARTBEAT" for each in met.received)
            assert len(met.link._from_autopilot) <= WAITING_FROM_AUTOPILOT
        assert heartbeats == 8

    def test_what_is_kept_of_a_flood_is_in_order(self, met: Bench) -> None:
        autopilot = Component(7)
        times = [dialect.MAVLink_system_time_message(0, i) for i in range(2 * WAITING_FROM_AUTOPILOT)]
        met.received.clear()
        met.arrive(*map(autopilot.frame, [self.ATTITUDE, *times, self.ATTITUDE]))
        assert [each.msgname for each in met.received] == ["SYSTEM_TIME", "ATTITUDE"]
        assert met.received[0].time_boot_ms == times[-1].time_boot_ms

    def test_a_flood_of_all_systems_is_not_kept(self, bench: Bench) -> None:
        """Nobody is the autopilot yet, so that any of them may be."""
        kinds = [self.ATTITUDE, dialect.MAVLink_system_time_message(0, 1), dialect.MAVLink_ping_message(0, 0, 0, 0)]
        for _ in range(5):
            bench.arrive(*(Component(system).frame(kind) for kind in kinds for system in range(1, 256)))
            assert len(bench.link._from_autopilot) <= WAITING_FROM_AUTOPILOT

    @pytest.mark.parametrize("ending", [b"\xfd", b"\xfd\xff\x00", b"\xfe\xff", b"\xfd\xff\x01" + bytes(270)])
    def test_bytes_that_always_end_inside_a_frame_are_not_kept(self, met: Bench, ending: bytes) -> None:
        """pymavlink's own parser kept them all: 16 MB after ten seconds of 8 kB at each look."""
        tracemalloc.start()
        try:
            for _ in range(500):
                met.transport.arrived += bytes(8000) + ending
                met.link.service()
                met.clock.sleep_until(met.link.next_event_s)
                met.transport.frames.clear()
            _, peak_bytes = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak_bytes < 500_000


class TestWhatArrives:
    def test_messages_of_the_autopilot_are_passed_on_with_their_time(self, bench: Bench) -> None:
        attitude = dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
        bench.arrive(Component(7).heartbeat())
        bench.clock.sleep_until(START_S + 2.5)
        bench.arrive(Component(7).frame(attitude), Component(7, 154).frame(attitude))
        assert [each.msgname for each in bench.received] == ["HEARTBEAT", "ATTITUDE"]
        assert bench.received_s == [START_S, START_S + 2.5]

    def test_a_frame_may_come_in_pieces(self, bench: Bench) -> None:
        for byte in Component(7).heartbeat():
            assert bench.link.autopilot_system is None
            bench.arrive(bytes([byte]))
        assert bench.link.autopilot_system == 7

    def test_noise_before_a_heartbeat_does_not_hide_the_next_ones(self, bench: Bench) -> None:
        noise = random.Random(1)
        autopilot = Component(7)
        for _ in range(50):
            bench.arrive(noise.randbytes(noise.randrange(600)), autopilot.heartbeat())
            # A frame has at most 280 bytes: what noise took for the start of one ends within 14 heartbeats.
            bench.arrive(*(autopilot.heartbeat() for _ in range(14)))
            assert bench.link.autopilot_is_present
            bench.clock.sleep_until(bench.clock.now() + 10.0)
            assert not bench.link.autopilot_is_present

    def test_messages_of_ardupilots_own_dialect_do_no_harm(self, met: Bench) -> None:
        autopilot = Component(7, dialect=ardupilotmega)
        met.arrive(autopilot.frame(ardupilotmega.MAVLink_rangefinder_message(1.0, 2.0)), autopilot.heartbeat())
        assert [message.msgname for message in met.received][-1] == "HEARTBEAT"

    @given(st.lists(st.binary(max_size=400), max_size=5))
    def test_no_bytes_stop_it(self, chunks: list[bytes]) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 1.0})
        bench.arrive(Component(7).heartbeat())
        for chunk in chunks:
            bench.arrive(chunk)

    @given(
        kind=st.sampled_from(sorted(dialect.mavlink_map)),
        payload=st.binary(min_size=255, max_size=255),
        sender=st.sampled_from([(7, 1), GROUND_STATION, (0, 0)]),
    )
    def test_no_message_stops_it(self, kind: int, payload: bytes, sender: tuple[int, int]) -> None:
        bench = Bench(wanted={"SCALED_PRESSURE": 1.0})
        bench.arrive(Component(7).heartbeat())
        bench.arrive(frame_of(kind, payload, sender))
        bench.run(0.1)

    @pytest.mark.parametrize("target", [(0, 0), (7, 191)])
    @given(payload=st.binary(min_size=33, max_size=35), kind=st.sampled_from(["COMMAND_LONG", "COMMAND_INT"]))
    def test_no_command_stops_it(self, target: tuple[int, int], payload: bytes, kind: str) -> None:
        bench = Bench()
        bench.arrive(Component(7).heartbeat())
        addressed = payload[:28] + (512).to_bytes(2, "little") + bytes(target) + payload[32:]
        bench.arrive(frame_of(getattr(dialect, f"MAVLINK_MSG_ID_{kind}"), addressed, GROUND_STATION))


def frame_of(kind: int, payload: bytes, sender: tuple[int, int]) -> bytes:
    """A frame with a good checksum around any payload."""
    definition = dialect.mavlink_map[kind]
    message = dialect.MAVLink_message(kind, definition.msgname)
    plain = dialect.MAVLink(None, *sender)
    whole: bytes = message._pack(plain, definition.crc_extra, payload[: definition.unpacker.size])
    return whole
