"""Messages that the bridge requires from the autopilot: each is requested at its rate while it arrives too slowly.

`msp_range.mavlink.link.Link` reports what arrives and sends what is due (MAV_CMD_SET_MESSAGE_INTERVAL). A refusal is
final, because ArduPilot sends the pilot a text for each request for an unknown message. The answer does not contain the
message's name, so a refusal counts only if a single request was pending.
"""

from collections.abc import Mapping

from msp_range.mavlink.dialect import MESSAGE_IDS, dialect

ENOUGH = 0.8
"""A message that arrives with at least this share of its rate is not requested. Autopilots round intervals to their own
loop and lose messages on a slow port; closer to 1 they would be requested for ever, lower makes attitudes older."""
SOON_ENOUGH = 0.5
"""The same after the first three intervals: a message that arrives clearly slower is requested then, so that a bridge
that starts in flight soon knows the accelerations, without which it sees no part of the vehicle for what it is. Larger
makes messages that arrive in bursts slower for other programs."""
MEASURED_S = 5.0
"""Time over which a rate is measured [s], and at least three intervals. It is also the time after which an unanswered
request is repeated. Shorter detects a lost request sooner, and mistakes a delay of the loop for a slow message."""
MEASURED_INTERVALS = 3
FIRST_MEASURED_S = 1.0
"""Time for which messages are counted before the first request [s], so that a message which already arrives faster than
required is not made slower for other programs. Longer delays the first request."""
QUICK_REQUESTS = 6
"""Number of successive requests without effect after which a message is requested only every `SLOW_REQUEST_S`, to limit
the traffic on a slow port and to an autopilot that does not answer."""
SLOW_REQUEST_S = 60.0
ANSWER_S = 2.0
"""Time for which an unanswered request is pending [s]: longer than a round trip on a radio link."""
APART_S = 0.1
"""Time between two requests without an answer [s]: autopilots on a wire answer sooner. After a refusal while several
were pending, requests are `ANSWER_S` apart."""

_NOT_REFUSED = (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_TEMPORARILY_REJECTED)


class _Message:
    """The state of one required message."""

    requests = received = 0

    def __init__(self, rate_hz: float, now_s: float) -> None:
        self.rate_hz = rate_hz
        self.first_s = now_s
        self.measured_s = now_s + FIRST_MEASURED_S
        self.next_check_s = min(now_s + MEASURED_INTERVALS / rate_hz, self.measured_s)


class WantedMessages:
    """Keeps track of required and received messages, and decides what to request next.

    Parameters
    ----------
    rates_hz
        Required rate [Hz] by name of the message.

    Raises
    ------
    KeyError
        There is no such message.

    Attributes
    ----------
    next_request_s
        When `request` may have one [s].
    """

    next_request_s: float

    def __init__(self, rates_hz: Mapping[str, float]) -> None:
        self._rates_hz = {MESSAGE_IDS[name]: rate_hz for name, rate_hz in rates_hz.items()}
        self.ask_anew(float("-inf"))

    def ask_anew(self, now_s: float) -> None:
        """Forget refusals and rates: this may be another autopilot or another firmware."""
        self._messages = {message_id: _Message(rate_hz, now_s) for message_id, rate_hz in self._rates_hz.items()}
        self._under_way: list[tuple[float, _Message]] = []
        self.next_request_s = float("-inf")
        self._apart_s = APART_S

    def on_message(self, now_s: float, message_id: int) -> None:
        """Count a message of the autopilot."""
        message = self._messages.get(message_id)
        if message is not None:
            if message.received == 0:
                message.first_s = now_s
            message.received += 1

    def on_answer(self, now_s: float, result: int) -> None:
        """Record the autopilot's answer (MAV_RESULT) to the oldest pending request; the next may follow at once."""
        if result == dialect.MAV_RESULT_IN_PROGRESS:
            return
        under_way = self._not_yet_answered(now_s)
        if result not in _NOT_REFUSED:
            if len(under_way) == 1:
                under_way[0][1].next_check_s = float("inf")
            else:
                self._apart_s = ANSWER_S
        self._under_way = under_way[1:]
        self.next_request_s = now_s

    def request(self, now_s: float) -> tuple[int, float] | None:
        """The message to request now: its number, and its interval [us]."""
        if now_s < self.next_request_s:
            return None
        self.next_request_s = now_s + self._apart_s
        for message_id, message in self._messages.items():
            if now_s < message.next_check_s:
                continue
            # Not since the last check, or too slowly since it first arrived.
            is_soon = now_s < message.measured_s
            received, enough = (message.received - 1, SOON_ENOUGH) if is_soon else (message.received, ENOUGH)
            slow = received <= 0 or received < enough * message.rate_hz * (now_s - message.first_s)
            if is_soon and not slow:
                message.next_check_s = message.measured_s
                continue
            message.requests = message.requests + 1 if slow else 0
            message.received = 0
            measured_s = max(MEASURED_S, MEASURED_INTERVALS / message.rate_hz)
            message.next_check_s = now_s + (SLOW_REQUEST_S if message.requests > QUICK_REQUESTS else measured_s)
            if slow:
                self._under_way = [*self._not_yet_answered(now_s), (now_s, message)]
                return message_id, 1e6 / message.rate_hz
        return None

    def _not_yet_answered(self, now_s: float) -> list[tuple[float, _Message]]:
        return [each for each in self._under_way if now_s - each[0] < ANSWER_S]
