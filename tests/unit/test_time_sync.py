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
    clock.hear_timesync(now_s + there_s + back_s, tc1_ns, ts1_ns)
    return now_s + there_s + back_s


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
    assert not clock.synchronised
    assert clock.time_boot_ms(BRIDGE_START_S + 12.3456) == 12345
    assert clock.time_boot_ms(BRIDGE_START_S - 1.0) == 0


@pytest.mark.parametrize(("there_s", "back_s"), [(0.0, 0.0), (0.030, 0.030), (0.001, 0.041), (0.080, 0.0)])
def test_the_error_is_half_of_what_the_ways_differ_by(clock: AutopilotClock, there_s: float, back_s: float) -> None:
    exchange(clock, BRIDGE_START_S + 1.0, there_s, back_s)
    assert clock.synchronised
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


def test_time_of_an_echo_before_now_is_on_the_autopilots_clock(clock: AutopilotClock) -> None:
    now_s = exchange(clock, BRIDGE_START_S + 7.0, 0.002, 0.002)
    echo_s = now_s - 0.058
    assert clock.time_boot_ms(echo_s) == int((echo_s + AUTOPILOT_AHEAD_S) * 1e3)


def test_answers_to_others_and_second_answers_are_passed_over(clock: AutopilotClock) -> None:
    ts1_ns = clock.request(BRIDGE_START_S)
    clock.hear_timesync(BRIDGE_START_S + 0.01, 77 * 10**9, ts1_ns + 1)
    assert not clock.synchronised
    clock.hear_timesync(BRIDGE_START_S + 0.01, round((BRIDGE_START_S + AUTOPILOT_AHEAD_S) * 1e9), ts1_ns)
    before_s = offset_error_s(clock)
    clock.hear_timesync(BRIDGE_START_S + 0.02, 77 * 10**9, ts1_ns)
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
        clock.hear_system_time(at_s + delay_s, int((at_s + AUTOPILOT_AHEAD_S) * 1e3))
    assert clock.synchronised
    # SYSTEM_TIME has whole milliseconds, and so has what is shown.
    assert offset_error_s(clock) == pytest.approx(-0.020 - 1e-3, abs=1e-3 + ROUNDING_S)


def test_timesync_takes_over_from_system_time(clock: AutopilotClock) -> None:
    clock.hear_system_time(BRIDGE_START_S + 0.5, int((BRIDGE_START_S + AUTOPILOT_AHEAD_S) * 1e3))
    exchange(clock, BRIDGE_START_S + 1.0, 0.001, 0.001)
    assert offset_error_s(clock) == approximately(0.0)
    clock.hear_system_time(BRIDGE_START_S + 2.0, int((BRIDGE_START_S + 2.0 + AUTOPILOT_AHEAD_S) * 1e3) + 40)
    assert offset_error_s(clock) == approximately(0.0)


@pytest.mark.parametrize("heard_by", ["timesync", "system_time"])
def test_a_clock_that_starts_again_is_a_reboot(clock: AutopilotClock, heard_by: str) -> None:
    now_s = BRIDGE_START_S
    for _ in range(10):
        now_s = exchange(clock, now_s + 1.0, 0.001, 0.001)
    booted_s = now_s + 8.0
    at_s = booted_s + 2.5
    if heard_by == "timesync":
        exchange(clock, at_s, 0.030, 0.030, ahead_s=-booted_s)
    else:
        clock.hear_system_time(at_s, round((at_s - booted_s) * 1e3))
    assert clock.reboots == 1
    # The long round trip of the new boot counts, not the short ones of the old.
    assert offset_error_s(clock, ahead_s=-booted_s) == pytest.approx(-0.5e-3, abs=0.5e-3 + 1e-3)
    now_s = exchange(clock, at_s + 1.0, 0.030, 0.030, ahead_s=-booted_s)
    assert clock.reboots == 1


def test_an_answer_to_a_request_from_before_the_reboot_is_passed_over(clock: AutopilotClock) -> None:
    exchange(clock, BRIDGE_START_S, 0.0, 0.0)
    lost_ns = clock.request(BRIDGE_START_S + 1.0)
    booted_s = BRIDGE_START_S + 10.0
    clock.hear_system_time(booted_s + 1.0, 1000)
    assert clock.reboots == 1
    clock.hear_timesync(booted_s + 1.1, round((BRIDGE_START_S + 1.0 + AUTOPILOT_AHEAD_S) * 1e9), lost_ns)
    assert offset_error_s(clock, ahead_s=-booted_s) == approximately(0.0)


def test_messages_that_lay_unread_while_the_bus_was_locked_up_are_no_reboot(clock: AutopilotClock) -> None:
    """The kernel holds a transfer on a locked-up bus for a second, and a group of four pings has four of them."""
    exchange(clock, BRIDGE_START_S, 0.001, 0.001)
    sent_s = BRIDGE_START_S + 1.0
    clock.hear_system_time(sent_s + 4.0, round((sent_s + AUTOPILOT_AHEAD_S) * 1e3))
    exchange(clock, BRIDGE_START_S + 6.0, 0.001, 12.0)
    assert clock.reboots == 0
    assert offset_error_s(clock) == approximately(0.0)
