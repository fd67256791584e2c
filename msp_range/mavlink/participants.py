"""Unwanted participants on the link: a second autopilot, one of another type, one with the same ids, a program with the
bridge's ids, a key that only one side has.

Each is a condition with a text of at most 50 characters for the pilot. It ends when nothing of it has been received for
`HOLD_S`, so that one that comes and goes is reported once.
"""

from msp_range.health import Condition
from msp_range.health.conditions import EXPLAINED
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.signing import PX4_SIGNS_NOT

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
        self._over = {
            "other autopilot": "Range: the other autopilot is gone",
            "autopilot type": f"Range: the autopilot is {expected} now",
            "own ids": "Range: no other program uses this bridge's id now",
            "autopilot's ids": "Range: one autopilot sends with its ids now",
            "autopilot lost": "Range: the first autopilot is back",
            "signing": "Range: the autopilot's signature is right now",
        }
        self._signing_remedy = "msp-range sign AIRFRAME.yaml gives both the same key"
        if expected == "px4":
            self._signing_remedy = PX4_SIGNS_NOT
        # When each was last seen, and its text.
        self._seen = dict.fromkeys(self._over, (float("-inf"), ""))
        self._suspected_s: dict[str, list[float]] = {}

    def seen(self, key: str, now_s: float, text: str) -> None:
        """Record that a condition is seen now."""
        self._seen[key] = now_s, text

    def suspected(self, key: str, now_s: float, text: str) -> None:
        """Count what only means something if it is seen repeatedly."""
        seen = [time_s for time_s in self._suspected_s.get(key, []) if now_s - time_s < HOLD_S]
        if not seen or now_s - seen[-1] >= APART_S:
            seen.append(now_s)
        self._suspected_s[key] = seen[-REPEATED:]
        if len(seen) >= REPEATED:
            self.seen(key, now_s, text)

    def on_autopilot(self, now_s: float, autopilot_type: int) -> None:
        """Check a heartbeat of the bridge's own autopilot (MAV_AUTOPILOT)."""
        found = AUTOPILOTS.get(autopilot_type, f"type {autopilot_type}")
        if self._expected not in (None, found):
            self.seen("autopilot type", now_s, f"Range: autopilot is {found}, file says {self._expected}")

    def conditions(self, now_s: float) -> list[Condition]:
        """All conditions, for `msp_range.health.Health.set`."""
        return [
            Condition(
                key,
                text if now_s - last_s < HOLD_S else None,
                self._over[key],
                remedy=self._signing_remedy if key == "signing" else EXPLAINED,
            )
            for key, (last_s, text) in self._seen.items()
        ]
