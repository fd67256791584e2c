"""Unwanted participants on the link: a second autopilot, one of another type, one with the same ids, a program with the
bridge's ids, a key that only one side has.

Each is a condition of `msp_range.pilot_texts`. It ends when nothing of it has been received for
`HOLD_S`, so that one that comes and goes is reported once.
"""

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.signing import PX4_SIGNS_NOT
from msp_range.pilot_texts import Condition, Text

HOLD_S = 10.0
"""Time after which a condition ends [s]: ten heartbeats. Shorter reports an intermittent one repeatedly, longer reports
its end late."""
APART_S = 0.5
REPEATED = 3
"""Ids are used twice if that was seen this many times, at least this long apart [s]; every component sends a heartbeat
once a second. With fewer, own frames from before a restart that a router still held would count, and one reboot."""

AUTOPILOTS: dict[int, Autopilot] = {
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot",
    dialect.MAV_AUTOPILOT_PX4: "px4",
}
"""The autopilots that can be stated in an airframe file, by MAV_AUTOPILOT."""


class Participants:
    """Conditions that last while they are seen.

    Parameters
    ----------
    expected
        Autopilot type stated in the airframe file; None: any.
    """

    def __init__(self, expected: Autopilot | None) -> None:
        self._expected = expected
        # When each was last seen.
        self._seen: dict[str, tuple[float, Condition]] = {}
        self._suspected_s: dict[str, list[float]] = {}

    def seen(self, now_s: float, condition: Condition, **values: object) -> None:
        """Record that a condition is seen now; ``values`` are filled in."""
        if condition.key == Text.OTHER_KEY.key and self._expected == "px4":
            condition = condition._replace(remedy=PX4_SIGNS_NOT)
        self._seen[condition.key] = now_s, condition.when(True, **values)

    def suspected(self, now_s: float, condition: Condition, **values: object) -> None:
        """Count what only means something if it is seen repeatedly."""
        seen = [time_s for time_s in self._suspected_s.get(condition.key, []) if now_s - time_s < HOLD_S]
        if not seen or now_s - seen[-1] >= APART_S:
            seen.append(now_s)
        self._suspected_s[condition.key] = seen[-REPEATED:]
        if len(seen) >= REPEATED:
            self.seen(now_s, condition, **values)

    def on_autopilot(self, now_s: float, autopilot_type: int) -> None:
        """Check a heartbeat of the bridge's own autopilot (MAV_AUTOPILOT)."""
        found = AUTOPILOTS.get(autopilot_type, f"type {autopilot_type}")
        if self._expected not in (None, found):
            other = Text.AUTOPILOT_TYPE.of(expected=self._expected)
            self.seen(now_s, other, found=found, expected=self._expected)

    def conditions(self, now_s: float) -> list[Condition]:
        """All conditions that were ever seen, for `msp_range.health.Health.set`."""
        return [condition.when(now_s - last_s < HOLD_S) for last_s, condition in self._seen.values()]
