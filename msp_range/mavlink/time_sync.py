"""The autopilot's clock: how far it is ahead of the bridge's, and when it started again.

TIMESYNC gives the difference with half the round trip as its error; of the exchanges of the last seconds the one with
the shortest round trip counts. Where the autopilot does not answer, SYSTEM_TIME gives it, late by the link's delay: of
the last seconds the message that was least late counts.
"""

from collections import deque
from typing import NamedTuple

EXCHANGES_KEPT = 10
"""Exchanges among which the shortest round trip is chosen: ten seconds, in which clocks drift 0.5 ms at 50 ppm."""
SYSTEM_TIMES_KEPT = 30
"""SYSTEM_TIME messages among which the least late one is chosen. Autopilots send one or two a second."""
OLDEST_S = 30.0
"""What is older does not show the difference now [s]: clocks drift 1.5 ms in this time at 50 ppm. Shorter leaves fewer
messages to choose from on a link with a varying delay."""
REQUEST_INTERVAL_S = 1.0
FIRST_REQUESTS_INTERVAL_S = 0.1
FIRST_REQUESTS = 5
REBOOT_BACKWARDS_S = 5.0
"""An autopilot's clock that is this much behind where it should be has been started again [s].

Longer than SYSTEM_TIME may lie unread: on a locked-up bus every transfer blocks the loop for a second."""
ANSWERED_S = 2.0
"""While TIMESYNC was answered this lately [s], it alone shows a reboot: it is asked for each second, and SYSTEM_TIME
may come from somebody else too. Longer finds a reboot later where TIMESYNC is no longer answered after it."""
LATEST_ARRIVAL_S = 1.0
"""A message that seems to be older than this when it arrives carries a wrong time, or the autopilot's clock is wrong
here [s]: the time of its arrival is used. The delay of a slow radio link is below it; longer would let a wrong clock
make every attitude too old to be used."""

_WRAP_MS = 2**32
"""``time_boot_ms`` is 0 again after this, 49.7 days [ms]."""


class _Sample(NamedTuple):
    """What one message showed: when it came [s], the most that it can be wrong by [s], the autopilot's clock less the
    bridge's [s]."""

    received_s: float
    error_s: float
    offset_s: float


class AutopilotClock:
    """Translates the bridge's time into the autopilot's time since boot, and back.

    Parameters
    ----------
    start_s
        The bridge's own start [s on the bridge's clock]: until the autopilot's clock is known, time counts from here.
    """

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        self._exchanges: deque[_Sample] = deque(maxlen=EXCHANGES_KEPT)
        self._system_times: deque[_Sample] = deque(maxlen=SYSTEM_TIMES_KEPT)
        self._outstanding: deque[int] = deque(maxlen=EXCHANGES_KEPT)
        self._offset_s: float | None = None
        self._requests = 0
        self.next_request_s = start_s
        self.reboots = 0

    @property
    def synchronised(self) -> bool:
        """True where the autopilot's clock is known."""
        return self._offset_s is not None

    def time_boot_ms(self, time_s: float) -> int:
        """Time since the autopilot's boot [ms] at ``time_s`` on the bridge's clock, as its messages count it."""
        offset_s = -self._start_s if self._offset_s is None else self._offset_s
        return max(0, int((time_s + offset_s) * 1e3)) % _WRAP_MS

    def time_of(self, time_boot_ms: int, received_s: float) -> float:
        """When the autopilot's clock showed ``time_boot_ms`` [s on the bridge's clock].

        Parameters
        ----------
        time_boot_ms
            Time stamp of a message.
        received_s
            When it came [s]: the result where the autopilot's clock is not known, and where by it the message would be
            from the future or older than `LATEST_ARRIVAL_S`.
        """
        if self._offset_s is None:
            return received_s
        age_s = _shortest(received_s + self._offset_s - time_boot_ms * 1e-3)
        return received_s - age_s if 0.0 <= age_s <= LATEST_ARRIVAL_S else received_s

    def request(self, now_s: float) -> int:
        """``ts1`` of a TIMESYNC request that is sent now [ns]; also sets when the next one is due."""
        self._requests += 1
        first = self._requests <= FIRST_REQUESTS
        self.next_request_s = now_s + (FIRST_REQUESTS_INTERVAL_S if first else REQUEST_INTERVAL_S)
        sent_ns = round(now_s * 1e9)
        self._outstanding.append(sent_ns)
        return sent_ns

    def on_timesync(self, now_s: float, tc1_ns: int, ts1_ns: int) -> None:
        """Take an answer: offset = tc1 - (ts1 + now) / 2. Answers to others' requests are passed over."""
        if ts1_ns not in self._outstanding:
            return
        self._outstanding.remove(ts1_ns)
        sent_s = ts1_ns * 1e-9
        sample = _Sample(now_s, now_s - sent_s, tc1_ns * 1e-9 - (sent_s + now_s) / 2)
        self._check_reboot(sample)
        self._exchanges.append(sample)
        self._update(now_s)

    def on_system_time(self, now_s: float, time_boot_ms: int) -> None:
        """Take SYSTEM_TIME: it shows a reboot, and stands in while TIMESYNC is not answered."""
        offset_s = time_boot_ms * 1e-3 - now_s
        if self._offset_s is not None:
            # It has begun again at 0 where TIMESYNC, with 64 bits, has not.
            offset_s = self._offset_s + _shortest(offset_s - self._offset_s)
        sample = _Sample(now_s, 0.0, offset_s)
        if not self._exchanges or now_s - self._exchanges[-1].received_s > ANSWERED_S:
            self._check_reboot(sample)
        self._system_times.append(sample)
        self._update(now_s)

    def _update(self, now_s: float) -> None:
        exchanges = [each for each in self._exchanges if now_s - each.received_s <= OLDEST_S]
        if exchanges:
            self._offset_s = min(exchanges, key=lambda each: each.error_s).offset_s
            return
        system_times = [each.offset_s for each in self._system_times if now_s - each.received_s <= OLDEST_S]
        if system_times:
            self._offset_s = max(system_times)

    def _check_reboot(self, sample: _Sample) -> None:
        if self._offset_s is not None and sample.offset_s < self._offset_s - REBOOT_BACKWARDS_S - sample.error_s:
            self.reboots += 1
            self._exchanges.clear()
            self._system_times.clear()
            self._outstanding.clear()
            self._offset_s = None
            self._requests = 0


def _shortest(difference_s: float) -> float:
    """A difference of two times of which one or both have begun again at 0 after 49.7 days [s]."""
    wrap_s = _WRAP_MS / 1e3
    return (difference_s + wrap_s / 2) % wrap_s - wrap_s / 2
