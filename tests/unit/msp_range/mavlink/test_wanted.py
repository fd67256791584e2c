"""What is asked of an autopilot, against autopilots that send at given rates and answer or do not."""

import itertools
import math
from collections import Counter
from collections.abc import Callable

import pytest

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.wanted import ANSWER_S, QUICK_REQUESTS, SLOW_REQUEST_S, WantedMessages

NAMES = ("RAW_IMU", "SCALED_IMU", "HIGHRES_IMU", "SCALED_PRESSURE", "ATTITUDE")
NUMBER = {name: getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in NAMES}
WITNESSES = {"RAW_IMU": 25.0, "SCALED_IMU": 25.0, "HIGHRES_IMU": 25.0, "SCALED_PRESSURE": 10.0, "ATTITUDE": 25.0}
TICK_S = 0.005


class Autopilot:
    """Sends messages at rates [Hz], and answers each request after a while with a result."""

    def __init__(
        self,
        wanted: WantedMessages,
        sends_hz: dict[str, float],
        answer: Callable[[str], int | None] = lambda _: None,
        answers_after_s: float = 0.01,
        obeys: bool = False,
    ) -> None:
        self.asked: list[tuple[float, str, float]] = []
        """Time [s], name, interval [us]."""
        self.now_s = 100.0
        self._wanted = wanted
        self._sends_hz = sends_hz
        self._answer = answer
        self._answers_after_s = answers_after_s
        self._obeys = obeys
        self._due_s = dict.fromkeys(sends_hz, self.now_s)
        self._answers: list[tuple[float, int]] = []
        wanted.ask_anew(self.now_s)

    def fly(self, duration_s: float) -> "Autopilot":
        names = {number: name for name, number in NUMBER.items()}
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            for name, rate_hz in self._sends_hz.items():
                if self.now_s >= self._due_s.setdefault(name, self.now_s):
                    self._due_s[name] += 1 / rate_hz
                    self._wanted.on_message(self.now_s, NUMBER[name])
            while self._answers and self.now_s >= self._answers[0][0]:
                self._wanted.on_answer(self.now_s, self._answers.pop(0)[1])
            request = self._wanted.request(self.now_s)
            if request is not None:
                name = names[request[0]]
                self.asked.append((self.now_s, name, request[1]))
                result = self._answer(name)
                if result is not None:
                    self._answers.append((self.now_s + self._answers_after_s, result))
                if self._obeys and result in (None, dialect.MAV_RESULT_ACCEPTED):
                    self._sends_hz[name] = 1e6 / request[1]
            self.now_s += TICK_S
        return self

    def counts(self) -> dict[str, int]:
        return Counter(name for _, name, _ in self.asked)


def test_all_that_does_not_come_is_asked_for_soon_at_its_rate() -> None:
    autopilot = Autopilot(WantedMessages(WITNESSES), {}).fly(2.0)
    assert {name: 1e6 / interval_us for _, name, interval_us in autopilot.asked} == WITNESSES
    assert len(autopilot.asked) == len(WITNESSES)


@pytest.mark.parametrize(("sends_hz", "after_s"), [(0.0, 0.3), (4.0, 0.3), (8.0, None), (10.0, None), (50.0, None)])
def test_what_does_not_come_for_three_intervals_is_asked_for_then(sends_hz: float, after_s: float | None) -> None:
    sends = {"ATTITUDE": sends_hz} if sends_hz else {}
    asked = Autopilot(WantedMessages({"ATTITUDE": 10.0, "SCALED_PRESSURE": 1.0}), sends).fly(2.0).asked
    assert [time_s for time_s, name, _ in asked if name == "SCALED_PRESSURE"] == pytest.approx([101.0], abs=0.06)
    soon_s = [time_s - 100.0 for time_s, name, _ in asked if name == "ATTITUDE"]
    assert soon_s == ([] if after_s is None else pytest.approx([after_s], abs=0.02))


def test_what_an_autopilot_sends_when_it_is_asked_is_not_asked_for_again() -> None:
    autopilot = Autopilot(WantedMessages(WITNESSES), {"ATTITUDE": 4.0}, obeys=True).fly(120.0)
    assert autopilot.counts() == dict.fromkeys(WITNESSES, 1)


@pytest.mark.parametrize(
    ("sends_hz", "asked"), [(4.0, True), (19.0, True), (20.5, False), (25.0, False), (100.0, False)]
)
def test_what_comes_by_itself_is_asked_for_where_it_is_slower_than_four_fifths(sends_hz: float, asked: bool) -> None:
    autopilot = Autopilot(WantedMessages({"ATTITUDE": 25.0}), {"ATTITUDE": sends_hz}).fly(30.0)
    assert bool(autopilot.asked) is asked


@pytest.mark.parametrize("rate_hz", [0.1, 0.5, 1.0, 2.0])
def test_a_slow_message_that_comes_at_its_rate_is_asked_for_once_at_most(rate_hz: float) -> None:
    autopilot = Autopilot(WantedMessages({"ATTITUDE": rate_hz}), {"ATTITUDE": rate_hz}).fly(300.0)
    assert len(autopilot.asked) <= 1
    silent = Autopilot(WantedMessages({"ATTITUDE": rate_hz}), {}).fly(300.0)
    assert len(silent.asked) > QUICK_REQUESTS


def test_a_message_that_never_comes_is_asked_for_less_often_after_a_while() -> None:
    autopilot = Autopilot(WantedMessages({"ATTITUDE": 25.0}), {}).fly(600.0)
    times_s = [time_s for time_s, _, _ in autopilot.asked]
    gaps_s = [after_s - before_s for before_s, after_s in itertools.pairwise(times_s)]
    assert gaps_s[: QUICK_REQUESTS - 1] == pytest.approx([5.0] * (QUICK_REQUESTS - 1), abs=0.2)
    assert gaps_s[QUICK_REQUESTS:] == pytest.approx([SLOW_REQUEST_S] * len(gaps_s[QUICK_REQUESTS:]), abs=0.2)
    assert len(times_s) < 20


def refused(wanted: WantedMessages) -> list[str]:
    return [
        name
        for name in NAMES
        if NUMBER[name] in wanted._messages and wanted._messages[NUMBER[name]].next_check_s == math.inf
    ]


def refuses(*names: str) -> Callable[[str], int]:
    return lambda name: dialect.MAV_RESULT_DENIED if name in names else dialect.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize("answers_after_s", [0.01, 0.3, 1.5])
def test_only_what_is_refused_is_given_up(answers_after_s: float) -> None:
    """On a slow link the answers to several requests are under way, and none says which message it is about."""
    wanted = WantedMessages(WITNESSES)
    autopilot = Autopilot(wanted, {}, refuses("HIGHRES_IMU"), answers_after_s, obeys=True).fly(60.0)
    assert refused(wanted) == ["HIGHRES_IMU"]
    assert autopilot.counts()["HIGHRES_IMU"] <= (1 if answers_after_s < 0.1 else 2)
    autopilot.asked.clear()
    autopilot.fly(300.0)
    assert autopilot.asked == []


def test_a_refusal_is_not_taken_for_that_of_a_request_whose_answer_was_lost() -> None:
    """The autopilot refuses the third and its answer to the first is lost: the next answer is not the first one's."""
    wanted = WantedMessages(WITNESSES)
    answers = refuses("HIGHRES_IMU")
    Autopilot(wanted, {}, lambda name: None if name == "RAW_IMU" else answers(name), 0.3, obeys=True).fly(60.0)
    assert refused(wanted) == ["HIGHRES_IMU"]


@pytest.mark.parametrize("result", [dialect.MAV_RESULT_TEMPORARILY_REJECTED, dialect.MAV_RESULT_IN_PROGRESS])
def test_what_is_refused_for_now_is_asked_for_again(result: int) -> None:
    wanted = WantedMessages({"ATTITUDE": 25.0})
    autopilot = Autopilot(wanted, {}, lambda _: result).fly(20.0)
    assert refused(wanted) == []
    assert len(autopilot.asked) >= 4


def test_an_answer_that_comes_too_late_is_nobodys() -> None:
    wanted = WantedMessages({"ATTITUDE": 25.0})
    Autopilot(wanted, {}, lambda _: dialect.MAV_RESULT_DENIED, ANSWER_S + 0.5).fly(4.0)
    assert refused(wanted) == []
