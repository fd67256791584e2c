"""The autopilot's clock against exchanges with known delays."""

import random

import pytest

from msp_range.mavlink.time_sync import FIRST_REQUESTS, AutopilotClock

BRIDGE_START_S = 5000.0
AUTOPILOT_AHEAD_S = -4321.25
"""What the autopilot's clock shows less what the bridge's shows."""
ROUNDING_S = 1e-6


def exchange(
    clock: AutopilotClock, now_s: float, there_s: float, back_s: float, ahead_s: float = AUTOPILOT_AHEAD_S
) -> float:
    """One TIMESYNC, answered after ``there_s``, heard ``back_s`` later; when it was heard."""
    ts1_ns = clock.request(now_s)
    tc1_ns = round((now_s + there_s + ahead_s) * 1e9)
    clock.on_timesync(now_s + there_s + back_s, tc1_ns, ts1_ns)
    return now_s + there_s + back_s


def synchronised(clock: AutopilotClock) -> float:
    """Ten exchanges, one a second; the time of the last answer."""
    now_s = BRIDGE_START_S
    for _ in range(10):
        now_s = exchange(clock, now_s + 1.0, 0.001, 0.001)
    return now_s


def offset_error_s(clock: AutopilotClock, ahead_s: float = AUTOPILOT_AHEAD_S) -> float:
    """How far the clock is wrong, to the millisecond below that a message shows."""
    at_s = BRIDGE_START_S + 100.0
    return clock.time_boot_ms(at_s) / 1e3 - (at_s + ahead_s)


def approximately(error_s: float) -> object:
    return pytest.approx(error_s - 0.5e-3, abs=0.5e-3 + ROUNDING_S)


@pytest.fixture
def clock() -> AutopilotClock:
    return AutopilotClock(BRIDGE_START_S)


def test_until_the_autopilot_is_known_time_counts_from_the_bridges_start(clock: AutopilotClock) -> None:
    assert clock.time_boot_ms(BRIDGE_START_S + 12.3456) == 12345
    assert clock.time_boot_ms(BRIDGE_START_S - 1.0) == 0


@pytest.mark.parametrize(("there_s", "back_s"), [(0.0, 0.0), (0.030, 0.030), (0.001, 0.041), (0.080, 0.0)])
def test_the_error_is_half_of_what_the_ways_differ_by(clock: AutopilotClock, there_s: float, back_s: float) -> None:
    exchange(clock, BRIDGE_START_S + 1.0, there_s, back_s)
    assert offset_error_s(clock) == approximately((there_s - back_s) / 2)


def test_the_shortest_round_trip_counts_whatever_comes_after_it(clock: AutopilotClock) -> None:
    delays = random.Random(3)
    now_s = BRIDGE_START_S
    shortest_s = float("inf")
    for _ in range(10):
        there_s, back_s = delays.expovariate(20.0), delays.expovariate(20.0)
        now_s = exchange(clock, now_s + 1.0, there_s, back_s)
        shortest_s = min(shortest_s, there_s + back_s)
    # No more is known than that the answer was given between request and arrival.
    assert abs(offset_error_s(clock) + 0.5e-3) <= shortest_s / 2 + 0.5e-3 + ROUNDING_S
    assert shortest_s < 0.05


def test_an_old_exchange_does_not_hold_for_ever(clock: AutopilotClock) -> None:
    """Clocks drift: after ten more exchanges the first no longer counts, however short it was."""
    drifted_s = 0.040
    now_s = exchange(clock, BRIDGE_START_S, 0.0, 0.0)
    for _ in range(10):
        assert offset_error_s(clock) == approximately(0.0)
        now_s = exchange(clock, now_s + 1.0, 0.005, 0.005, AUTOPILOT_AHEAD_S + drifted_s)
    assert offset_error_s(clock) == approximately(drifted_s)


def test_answers_to_others_and_second_answers_are_passed_over(clock: AutopilotClock) -> None:
    ts1_ns = clock.request(BRIDGE_START_S)
    clock.on_timesync(BRIDGE_START_S + 0.01, 77 * 10**9, ts1_ns + 1)
    assert clock.time_boot_ms(BRIDGE_START_S + 1.0) == 1000
    clock.on_timesync(BRIDGE_START_S + 0.01, round((BRIDGE_START_S + AUTOPILOT_AHEAD_S) * 1e9), ts1_ns)
    before_s = offset_error_s(clock)
    clock.on_timesync(BRIDGE_START_S + 0.02, 77 * 10**9, ts1_ns)
    assert offset_error_s(clock) == before_s


def test_requests_come_quickly_at_first_and_then_each_second(clock: AutopilotClock) -> None:
    gaps_s = []
    for _ in range(FIRST_REQUESTS + 2):
        due_s = clock.next_request_s
        clock.request(due_s)
        gaps_s.append(clock.next_request_s - due_s)
    assert gaps_s == pytest.approx([0.1] * FIRST_REQUESTS + [1.0] * 2)


def test_system_time_stands_in_and_its_least_delayed_message_counts(clock: AutopilotClock) -> None:
    for second, delay_s in enumerate((0.200, 0.020, 0.300)):
        at_s = BRIDGE_START_S + second
        clock.on_system_time(at_s + delay_s, int((at_s + AUTOPILOT_AHEAD_S) * 1e3))
    # SYSTEM_TIME has whole milliseconds, and so has what is shown.
    assert offset_error_s(clock) == pytest.approx(-0.020 - 1e-3, abs=1e-3 + ROUNDING_S)


def test_timesync_takes_over_from_system_time(clock: AutopilotClock) -> None:
    clock.on_system_time(BRIDGE_START_S + 0.5, int((BRIDGE_START_S + AUTOPILOT_AHEAD_S) * 1e3))
    exchange(clock, BRIDGE_START_S + 1.0, 0.001, 0.001)
    assert offset_error_s(clock) == approximately(0.0)
    clock.on_system_time(BRIDGE_START_S + 2.0, int((BRIDGE_START_S + 2.0 + AUTOPILOT_AHEAD_S) * 1e3) + 40)
    assert offset_error_s(clock) == approximately(0.0)


@pytest.mark.parametrize("heard_by", ["timesync", "system_time"])
def test_a_clock_that_starts_again_is_a_reboot(clock: AutopilotClock, heard_by: str) -> None:
    now_s = synchronised(clock)
    booted_s = now_s + 8.0
    at_s = booted_s + 2.5
    if heard_by == "timesync":
        exchange(clock, at_s, 0.030, 0.030, ahead_s=-booted_s)
    else:
        clock.on_system_time(at_s, round((at_s - booted_s) * 1e3))
    assert clock.reboots == 1
    # The long round trip of the new boot counts, not the short ones of the old.
    assert offset_error_s(clock, ahead_s=-booted_s) == pytest.approx(-0.5e-3, abs=0.5e-3 + 1e-3)
    now_s = exchange(clock, at_s + 1.0, 0.030, 0.030, ahead_s=-booted_s)
    assert clock.reboots == 1


@pytest.mark.parametrize("up_s", [0.6, 1.5, 3.0, 4.9])
@pytest.mark.parametrize("away_s", [0.5, 2.0])
def test_a_reboot_soon_after_the_boot_is_noticed_at_once(clock: AutopilotClock, up_s: float, away_s: float) -> None:
    """Stamps were ahead by what it had been up, for nine seconds: the old exchange had the shortest round trip."""
    for step in range(5):
        exchange(clock, BRIDGE_START_S + up_s * step / 5, 0.0005, 0.0005, ahead_s=-BRIDGE_START_S)
    booted_s = BRIDGE_START_S + up_s + away_s
    at_s = booted_s + 0.3
    clock.on_system_time(at_s, 300)
    exchange(clock, at_s + 0.01, 0.004, 0.004, ahead_s=-booted_s)
    assert clock.reboots == 1
    assert offset_error_s(clock, ahead_s=-booted_s) == approximately(0.0)


@pytest.mark.parametrize("sign", ["late", "none"])
def test_a_message_whose_time_does_not_fit_has_the_time_requested_at_once(clock: AutopilotClock, sign: str) -> None:
    now_s = synchronised(clock)
    at_s = now_s + 0.3
    due_s = clock.next_request_s
    behind_s = 3.0 if sign == "late" else 0.001
    clock.time_of(round((at_s + AUTOPILOT_AHEAD_S - behind_s) * 1e3), at_s)
    assert (clock.next_request_s <= at_s) is (sign == "late")
    assert clock.next_request_s <= due_s
    clock.request(at_s)
    clock.time_of(round((at_s + AUTOPILOT_AHEAD_S - 3.0) * 1e3), at_s + 0.001)
    assert clock.next_request_s == pytest.approx(at_s + 0.1), "but not for each message"


def test_a_time_that_goes_back_is_a_reboot_whenever_it_began(clock: AutopilotClock) -> None:
    """A second autopilot of the same id may have run before the first one ended."""
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    exchange(clock, BRIDGE_START_S + 1.0, 0.001, 0.001, ahead_s=5.0 - BRIDGE_START_S)
    assert clock.reboots == 1
    assert offset_error_s(clock, ahead_s=5.0 - BRIDGE_START_S) == approximately(0.0)


def test_a_simulator_that_lags_has_not_rebooted(clock: AutopilotClock) -> None:
    now_s = BRIDGE_START_S
    for step in range(20):
        lag_s = 0.3 * step
        now_s = exchange(clock, now_s + 1.0, 0.001, 0.001, AUTOPILOT_AHEAD_S - lag_s)
        assert offset_error_s(clock, AUTOPILOT_AHEAD_S - lag_s) == approximately(0.0)
    assert clock.reboots == 0


def test_system_time_that_goes_back_is_a_reboot_where_timesync_is_not_answered(clock: AutopilotClock) -> None:
    for second in range(4):
        clock.on_system_time(BRIDGE_START_S + second, 1000 * second)
    clock.on_system_time(BRIDGE_START_S + 6.0, 1500)
    assert clock.reboots == 1
    assert clock.time_boot_ms(BRIDGE_START_S + 6.0) == 1500


def test_an_answer_to_a_request_from_before_the_reboot_is_passed_over(clock: AutopilotClock) -> None:
    exchange(clock, BRIDGE_START_S, 0.0, 0.0)
    lost_ns = clock.request(BRIDGE_START_S + 1.0)
    booted_s = BRIDGE_START_S + 10.0
    clock.on_system_time(booted_s + 1.0, 1000)
    assert clock.reboots == 1
    clock.on_timesync(booted_s + 1.1, round((BRIDGE_START_S + 1.0 + AUTOPILOT_AHEAD_S) * 1e9), lost_ns)
    assert offset_error_s(clock, ahead_s=-booted_s) == approximately(0.0)


def test_messages_that_lay_unread_while_the_bus_was_locked_up_are_no_reboot(clock: AutopilotClock) -> None:
    """The kernel holds a transfer on a locked-up bus for a second, and a group of four pings has four of them."""
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    sent_s = BRIDGE_START_S + 1.0
    clock.on_system_time(sent_s + 4.0, round((sent_s + AUTOPILOT_AHEAD_S) * 1e3))
    exchange(clock, BRIDGE_START_S + 6.0, 0.001, 12.0)
    assert clock.reboots == 0
    assert offset_error_s(clock) == approximately(0.0)


def drifting_ms(since_s: float, ahead_s: float, drift: float) -> int:
    """What an autopilot's clock shows this long after the bridge's start, in the 32 bits of a message."""
    return int((BRIDGE_START_S + since_s + ahead_s + drift * since_s) * 1e3) % 2**32


@pytest.mark.parametrize(
    ("drift", "interval_s", "error_s"), [(-50e-6, 1, 0.010), (50e-6, 1, 0.010), (-500e-6, 10, 0.050)]
)
def test_a_drifting_clock_without_timesync_is_followed(
    clock: AutopilotClock, drift: float, interval_s: int, error_s: float
) -> None:
    """The least late message counted for ever: at -50 ppm that was 160 ms wrong after an hour."""
    delays = random.Random(3)
    for second in range(0, 3600, interval_s):
        delay_s = delays.uniform(0.002, 0.030)
        at_s = BRIDGE_START_S + second + delay_s
        clock.on_system_time(at_s, drifting_ms(second, AUTOPILOT_AHEAD_S, drift))
    end_s = 3600.0
    shown_ms = clock.time_boot_ms(BRIDGE_START_S + end_s)
    assert shown_ms == pytest.approx(drifting_ms(end_s, AUTOPILOT_AHEAD_S, drift), abs=1e3 * error_s)


def test_system_time_counts_again_where_timesync_is_no_longer_answered(clock: AutopilotClock) -> None:
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    for second in range(1, 120):
        ahead_s = AUTOPILOT_AHEAD_S - 50e-6 * second
        clock.on_system_time(BRIDGE_START_S + second, int((BRIDGE_START_S + second + ahead_s) * 1e3))
    assert offset_error_s(clock, AUTOPILOT_AHEAD_S - 50e-6 * 119) == pytest.approx(0.0, abs=3e-3)


WRAP_S = 2**32 / 1e3
AHEAD_OF_WRAP_S = WRAP_S - BRIDGE_START_S - 30.0
"""An autopilot whose message time begins again at 0 half a minute after the bridge's start."""


@pytest.mark.parametrize("timesync", [False, True])
def test_a_clock_that_begins_again_after_49_days_is_no_reboot(clock: AutopilotClock, timesync: bool) -> None:
    """It was one with every SYSTEM_TIME from then on, and each sent all texts of what is wrong again."""
    for second in range(120):
        at_s = BRIDGE_START_S + second
        if timesync:
            exchange(clock, at_s, 0.001, 0.001, ahead_s=AHEAD_OF_WRAP_S)
        clock.on_system_time(at_s + 0.002, drifting_ms(second, AHEAD_OF_WRAP_S, 0.0))
        shown_ms = clock.time_boot_ms(at_s + 0.5)
        assert 0 <= shown_ms < 2**32, "it is a field of 32 bits"
        assert shown_ms == pytest.approx(drifting_ms(second + 0.5, AHEAD_OF_WRAP_S, 0.0), abs=4)
    assert clock.reboots == 0


def test_a_bridge_that_starts_after_49_days_meets_timesync_and_system_time(clock: AutopilotClock) -> None:
    ahead_s = WRAP_S + 86_400.0
    for second in range(60):
        at_s = BRIDGE_START_S + second
        clock.on_system_time(at_s + 0.002, drifting_ms(second, ahead_s, 0.0))
        exchange(clock, at_s + 0.01, 0.001, 0.001, ahead_s=ahead_s)
    assert clock.reboots == 0
    assert clock.time_boot_ms(at_s) == pytest.approx(drifting_ms(59.0, ahead_s, 0.0), abs=3)


def test_a_reboot_after_40_days_is_one(clock: AutopilotClock) -> None:
    """As 32 bits count it is a jump forward by ten days; TIMESYNC has 64."""
    exchange(clock, BRIDGE_START_S, 0.001, 0.001, ahead_s=40 * 86_400.0)
    booted_s = BRIDGE_START_S + 5.0
    clock.on_system_time(booted_s + 1.0, 1000)
    exchange(clock, booted_s + 1.2, 0.001, 0.001, ahead_s=-booted_s)
    assert clock.reboots == 1
    assert clock.time_boot_ms(booted_s + 2.0) == pytest.approx(2000, abs=2)


def test_somebody_elses_system_time_is_no_reboot_while_timesync_is_answered(clock: AutopilotClock) -> None:
    for second in range(60):
        at_s = BRIDGE_START_S + second
        exchange(clock, at_s, 0.001, 0.001)
        clock.on_system_time(at_s + 0.3, 1000 * second)
        assert clock.reboots == 0
        assert offset_error_s(clock) == approximately(0.0)


def test_the_time_of_a_message_is_the_autopilots(clock: AutopilotClock) -> None:
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    at_s = BRIDGE_START_S + 3.0
    time_boot_ms = round((at_s + AUTOPILOT_AHEAD_S) * 1e3)
    for delay_s in (0.0, 0.030, 0.9):
        assert clock.time_of(time_boot_ms, at_s + delay_s) == pytest.approx(at_s, abs=0.6e-3)


def test_the_time_of_a_message_is_its_arrival_where_it_cannot_be_known(clock: AutopilotClock) -> None:
    at_s = BRIDGE_START_S + 3.0
    time_boot_ms = round((at_s + AUTOPILOT_AHEAD_S) * 1e3)
    assert clock.time_of(time_boot_ms, at_s) == at_s
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    for wrong_ms in (time_boot_ms + 10, time_boot_ms - 1500, 0, 2**32 - 1):
        assert clock.time_of(wrong_ms, at_s) == at_s


def test_the_time_of_a_message_is_known_across_the_49_days(clock: AutopilotClock) -> None:
    exchange(clock, BRIDGE_START_S + 29.0, 0.001, 0.001, ahead_s=AHEAD_OF_WRAP_S)
    for since_s in (29.99, 30.01):
        time_boot_ms = drifting_ms(since_s, AHEAD_OF_WRAP_S, 0.0)
        assert (time_boot_ms > 2**31) is (since_s < 30.0)
        made_s = BRIDGE_START_S + since_s
        assert clock.time_of(time_boot_ms, made_s + 0.05) == pytest.approx(made_s, abs=2e-3)


@pytest.mark.parametrize("tc1_ns", [1, -(2**63), 2**63 - 1])
def test_no_answer_makes_a_time_that_a_message_cannot_hold(clock: AutopilotClock, tc1_ns: int) -> None:
    clock.on_timesync(BRIDGE_START_S + 0.01, tc1_ns, clock.request(BRIDGE_START_S))
    assert 0 <= clock.time_boot_ms(BRIDGE_START_S + 1.0) < 2**32
    assert clock.time_of(2**32 - 1, BRIDGE_START_S) <= BRIDGE_START_S
