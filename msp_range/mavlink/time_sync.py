"""The autopilot's clock: how far it is ahead of the bridge's, and when it started again.

TIMESYNC gives the difference with half the round trip as its error; of the newest exchanges the one with the shortest
round trip counts. Where the autopilot does not answer, SYSTEM_TIME gives it, late by the link's delay.
"""

from collections import deque

EXCHANGES_KEPT = 10
"""Exchanges among which the shortest round trip is chosen: ten seconds, in which clocks drift 0.5 ms at 50 ppm."""
REQUEST_INTERVAL_S = 1.0
FIRST_REQUESTS_INTERVAL_S = 0.1
FIRST_REQUESTS = 5
REBOOT_BACKWARDS_S = 5.0
"""An autopilot's clock that is this much behind where it should be has been started again [s].

Longer than SYSTEM_TIME may lie unread: on a locked-up bus every transfer blocks the loop for a second."""


class AutopilotClock:
    """Translates the bridge's time into the autopilot's time since boot.

    Parameters
    ----------
    start_s
        The bridge's own start [s on the bridge's clock]: until the autopilot's clock is known, time counts from here.
    """

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        self._exchanges: deque[tuple[float, float]] = deque(maxlen=EXCHANGES_KEPT)
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
        """Time since the autopilot's boot [ms] at ``time_s`` on the bridge's clock."""
        offset_s = -self._start_s if self._offset_s is None else self._offset_s
        return max(0, int((time_s + offset_s) * 1e3))

    def request(self, now_s: float) -> int:
        """``ts1`` of a TIMESYNC request that is sent now [ns]; also sets when the next one is due."""
        self._requests += 1
        first = self._requests <= FIRST_REQUESTS
        self.next_request_s = now_s + (FIRST_REQUESTS_INTERVAL_S if first else REQUEST_INTERVAL_S)
        sent_ns = round(now_s * 1e9)
        self._outstanding.append(sent_ns)
        return sent_ns

    def hear_timesync(self, now_s: float, tc1_ns: int, ts1_ns: int) -> None:
        """Take an answer: offset = tc1 - (ts1 + now) / 2. Answers to others' requests are passed over."""
        if ts1_ns not in self._outstanding:
            return
        self._outstanding.remove(ts1_ns)
        sent_s = ts1_ns * 1e-9
        offset_s = tc1_ns * 1e-9 - (sent_s + now_s) / 2
        self._check_reboot(offset_s, now_s - sent_s)
        self._exchanges.append((now_s - sent_s, offset_s))
        self._offset_s = min(self._exchanges)[1]

    def hear_system_time(self, now_s: float, time_boot_ms: int) -> None:
        """Take SYSTEM_TIME: it shows a reboot, and stands in until TIMESYNC is answered."""
        offset_s = time_boot_ms * 1e-3 - now_s
        self._check_reboot(offset_s, 0.0)
        if not self._exchanges:
            self._offset_s = offset_s if self._offset_s is None else max(self._offset_s, offset_s)

    def _check_reboot(self, offset_s: float, error_s: float) -> None:
        if self._offset_s is not None and offset_s < self._offset_s - REBOOT_BACKWARDS_S - error_s:
            self.reboots += 1
            self._exchanges.clear()
            self._outstanding.clear()
            self._offset_s = None
            self._requests = 0
