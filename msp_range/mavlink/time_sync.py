"""The autopilot's clock: its offset to the bridge's clock, and reboots.

TIMESYNC gives the offset with an error of at most half the round trip; of the exchanges of the last seconds the one
with the shortest round trip is used. If the autopilot does not answer, SYSTEM_TIME gives it, late by the link's delay:
of the last seconds the message with the smallest delay is used.

An exchange that the known offset does not fit shows that the clock has stepped: all before it is forgotten. Any message
whose time does not fit only has the autopilot asked at once, since it may be late or somebody else's.
"""

from collections import deque
from typing import NamedTuple

EXCHANGES_KEPT = 10
"""Number of exchanges among which the shortest round trip is selected: ten seconds, in which clocks drift 0.5 ms at 50
ppm."""
SYSTEM_TIMES_KEPT = 30
"""Number of SYSTEM_TIME messages among which the one with the smallest delay is selected; autopilots send one or two a
second."""
OLDEST_S = 30.0
"""Age at which exchanges are no longer used [s]: clocks drift 1.5 ms in this time at 50 ppm. Shorter leaves fewer
messages to choose from on a link with a varying delay."""
REQUEST_INTERVAL_S = 1.0
FIRST_REQUESTS_INTERVAL_S = 0.1
FIRST_REQUESTS = 5
STEP_S = 0.1
"""A clock has stepped if an exchange puts it this far outside of what the known offset allows [s]. Clocks drift 15 ms
in 30 s at 500 ppm, which is no step; with more, time stamps after a quick reboot stay wrong by as much for 10 s."""
BACKWARDS_S = 0.5
"""Times that go back by more than this from a message to the next have another clock [s]; the ways of two radios may
differ by less. Smaller takes messages in the wrong order for a reboot, larger misses one soon after the boot."""
ANSWERED_S = 2.0
"""Time since the last answer to TIMESYNC during which only TIMESYNC shows a reboot [s]; SYSTEM_TIME may come from
others too. Longer detects a reboot later if TIMESYNC is not answered after it."""
LATEST_ARRIVAL_S = 1.0
"""If a message seems older than this when it arrives, its time or the clock offset is wrong [s], and the time of its
arrival is used. The delay of a slow radio link is shorter; with more, a wrong offset could make every attitude too old
to be used."""

_WRAP_MS = 2**32
"""Period after which ``time_boot_ms`` starts at 0 again: 49.7 days [ms]."""
_WRAP_S = _WRAP_MS / 1e3


class _Sample(NamedTuple):
    """The offset from one message: time of arrival [s], its error [s] (of TIMESYNC the largest, of SYSTEM_TIME counted
    from an unknown zero), autopilot's clock minus bridge's clock [s]."""

    received_s: float
    error_s: float
    offset_s: float


class AutopilotClock:
    """Converts the bridge's time into the autopilot's time since boot, and back.

    Parameters
    ----------
    start_s
        Start of the bridge [s on the bridge's clock]; until the autopilot's clock is known, time counts from here.
    """

    reboots = 0
    _newest_s: float | None = None

    def __init__(self, start_s: float) -> None:
        self._start_s = self._requested_s = self.next_request_s = start_s
        self._forget(False)

    def _forget(self, rebooted: bool) -> None:
        """Forget what the clock showed before it stepped."""
        self.reboots += rebooted
        self._exchanges: deque[_Sample] = deque(maxlen=EXCHANGES_KEPT)
        self._system_times: deque[_Sample] = deque(maxlen=SYSTEM_TIMES_KEPT)
        self._outstanding: deque[int] = deque(maxlen=EXCHANGES_KEPT)
        self._offset_s: float | None = None
        self._requests = 0

    @property
    def round_trip_s(self) -> float | None:
        """The shortest way there and back that TIMESYNC has shown lately [s]; None where it is not answered."""
        return min((exchange.error_s for exchange in self._exchanges), default=None)

    def time_boot_ms(self, time_s: float) -> int:
        """Time since the autopilot's boot [ms] at ``time_s`` on the bridge's clock, as its messages count it."""
        offset_s = -self._start_s if self._offset_s is None else self._offset_s
        return max(0, int((time_s + offset_s) * 1e3)) % _WRAP_MS

    def time_of(self, time_boot_ms: int, received_s: float) -> float:
        """Time on the bridge's clock at which the autopilot's clock was ``time_boot_ms`` [s].

        Parameters
        ----------
        time_boot_ms
            Time stamp of a message.
        received_s
            Time of its arrival [s]: the result if the autopilot's clock is not known, or if by it the message would be
            from the future or older than `LATEST_ARRIVAL_S`.
        """
        if self._offset_s is None:
            return received_s
        age_s = shortest(received_s + self._offset_s - time_boot_ms * 1e-3)
        if not -STEP_S < age_s <= LATEST_ARRIVAL_S:
            self.ask_soon()
        return received_s - age_s if 0.0 <= age_s <= LATEST_ARRIVAL_S else received_s

    def ask_soon(self) -> None:
        """Have the time requested at once, but not more often than at first: the autopilot may have rebooted."""
        self.next_request_s = min(self.next_request_s, self._requested_s + FIRST_REQUESTS_INTERVAL_S)

    def request(self, now_s: float) -> int:
        """``ts1`` of a TIMESYNC request sent now [ns]; also schedules the next one."""
        self._requests += 1
        self._requested_s = now_s
        first = self._requests <= FIRST_REQUESTS
        self.next_request_s = now_s + (FIRST_REQUESTS_INTERVAL_S if first else REQUEST_INTERVAL_S)
        sent_ns = round(now_s * 1e9)
        self._outstanding.append(sent_ns)
        return sent_ns

    def on_timesync(self, now_s: float, tc1_ns: int, ts1_ns: int) -> None:
        """Update with an answer: offset = tc1 - (ts1 + now) / 2. Answers to others' requests are ignored."""
        if ts1_ns not in self._outstanding:
            return
        self._outstanding.remove(ts1_ns)
        sent_s = ts1_ns * 1e-9
        sample = _Sample(now_s, now_s - sent_s, tc1_ns * 1e-9 - (sent_s + now_s) / 2)
        if self._offset_s is not None:
            error_s = (sample.error_s + (self.round_trip_s or 0.0)) / 2
            if abs(sample.offset_s - self._offset_s) > error_s + STEP_S:
                # A reboot: its time went back, or began since it was last received. A slow simulator's clock only lags.
                booted_s = sample.error_s / 2 - sample.offset_s
                last = self._exchanges[-1] if self._exchanges else sample
                self._forget(self._goes_back(tc1_ns * 1e-9) or booted_s > last.received_s - last.error_s)
        self._newest_s = tc1_ns * 1e-9
        self._exchanges.append(sample)
        self._update(now_s)

    def on_system_time(self, now_s: float, time_boot_ms: int) -> None:
        """Update with SYSTEM_TIME: it shows a reboot, and gives the offset while TIMESYNC is not answered."""
        self.time_of(time_boot_ms, now_s)
        time_s = time_boot_ms * 1e-3
        if not self._exchanges or now_s - self._exchanges[-1].received_s > ANSWERED_S:
            if self._goes_back(time_s):
                self._forget(True)
            self._newest_s = time_s
        offset_s = time_s - now_s
        if self._offset_s is not None:
            # It may have wrapped around to 0, unlike TIMESYNC with 64 bits.
            offset_s = self._offset_s + shortest(offset_s - self._offset_s)
        # The later it arrives, the smaller is the offset.
        self._system_times.append(_Sample(now_s, -offset_s, offset_s))
        self._update(now_s)

    def _update(self, now_s: float) -> None:
        for samples in (self._system_times, self._exchanges):
            used = [sample for sample in samples if now_s - sample.received_s <= OLDEST_S]
            if used:
                self._offset_s = min(used, key=lambda each: each.error_s).offset_s

    def _goes_back(self, time_s: float) -> bool:
        """Whether a time of the autopilot is before the newest one that it has sent."""
        return self._newest_s is not None and shortest(time_s - self._newest_s) < -BACKWARDS_S


def shortest(difference_s: float) -> float:
    """Difference of two times that may have wrapped around after 49.7 days [s]."""
    return (difference_s + _WRAP_S / 2) % _WRAP_S - _WRAP_S / 2
