"""Unwanted participants on the link: a second autopilot, one of another type, one with the same ids, a program with the
bridge's ids, a key that only one side has.

Each is a condition with a text of at most 50 characters for the pilot. It ends when nothing of it has been received for
`HOLD_S`, so that one that comes and goes is reported once.
"""

from typing import Any

from msp_range.health import Condition
from msp_range.health.conditions import EXPLAINED
from msp_range.mavlink.contradictions import Contradictions
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


class _Sighting:
    """A condition: what to report, and when it was last seen."""

    def __init__(self, key: str, over: str, remedy: str = EXPLAINED) -> None:
        self._key = key
        self._over = over
        self._remedy = remedy
        self._text = ""
        self._last_s = float("-inf")
        self._seen_s: list[float] = []

    def seen(self, now_s: float, text: str) -> None:
        self._last_s = now_s
        self._text = text

    def suspected(self, now_s: float, text: str) -> None:
        """Count what only means something if it is seen repeatedly."""
        seen = [time_s for time_s in self._seen_s if now_s - time_s < HOLD_S]
        if not seen or now_s - seen[-1] >= APART_S:
            seen.append(now_s)
        self._seen_s = seen[-REPEATED:]
        if len(seen) >= REPEATED:
            self.seen(now_s, text)

    def condition(self, now_s: float) -> Condition:
        lasts = now_s - self._last_s < HOLD_S
        return Condition(self._key, self._text if lasts else None, self._over, remedy=self._remedy)


class Participants:
    """Conditions derived from heartbeats and from frames with the bridge's ids.

    Parameters
    ----------
    expected
        Autopilot type stated in the airframe file; None: any.
    """

    def __init__(self, expected: Autopilot | None) -> None:
        self._expected = expected
        self._other = _Sighting("other autopilot", "Range: the other autopilot is gone")
        self._wrong_type = _Sighting("autopilot type", f"Range: the autopilot is {expected} now")
        self._own_ids = _Sighting("own ids", "Range: no other program uses this bridge's id now")
        self._same_ids = _Sighting("autopilot's ids", "Range: one autopilot sends with its ids now")
        self._stand_in = _Sighting("autopilot lost", "Range: the first autopilot is back")
        self._contradictions = Contradictions()
        both = "msp-range sign AIRFRAME.yaml gives both the same key"
        remedy = PX4_SIGNS_NOT if expected == "px4" else both
        self._signing = _Sighting("signing", "Range: the autopilot's signature is right now", remedy)

    def on_autopilot(self, now_s: float, autopilot_type: int) -> None:
        """Check a heartbeat of the bridge's own autopilot (MAV_AUTOPILOT)."""
        found = AUTOPILOTS.get(autopilot_type, f"type {autopilot_type}")
        if self._expected not in (None, found):
            self._wrong_type.seen(now_s, f"Range: autopilot is {found}, file says {self._expected}")

    def on_other_autopilot(self, now_s: float, system: int, own_system: int, own_received: bool) -> None:
        """Record an autopilot with another system id; ``own_received``: whether the bridge's own is received too."""
        if own_received:
            self._other.seen(now_s, f"Range: second autopilot, system {system} (using {own_system})")
        else:
            self._other.seen(now_s, f"Range: autopilot is system {system}, file says {own_system}")

    def on_own_ids(self, now_s: float, system: int, component: int) -> None:
        """Record a frame with the bridge's ids that it did not send."""
        self._own_ids.suspected(now_s, f"Range: another program sends as {system}/{component}")

    def on_message(self, now_s: float, system: int, message: Any) -> None:
        """Check a message of the bridge's own autopilot against those before it."""
        if self._contradictions.update(message):
            self._same_ids.suspected(now_s, f"Range: two autopilots send as system {system}")

    def on_stand_in(self, now_s: float, system: int, first: int) -> None:
        """Record that another autopilot is used, because the first one is not received."""
        self._stand_in.seen(now_s, f"Range: autopilot {first} is silent, using {system}")

    def on_change(self) -> None:
        """Forget the messages of an autopilot that is not used any more."""
        self._contradictions = Contradictions()

    def on_unsigned(self, now_s: float) -> None:
        """Record an autopilot's heartbeat without the right signature, where there is a key."""
        self._signing.seen(now_s, "Range: autopilot does not sign with this key")

    def on_signed(self, now_s: float) -> None:
        """Record an autopilot's signed heartbeat, where there is no key: it drops what is not signed."""
        self._signing.seen(now_s, "Range: autopilot signs, signing_key is missing")

    def conditions(self, now_s: float) -> list[Condition]:
        """All conditions, for `msp_range.health.Health.set`."""
        sightings = self._other, self._wrong_type, self._own_ids, self._same_ids, self._stand_in, self._signing
        return [each.condition(now_s) for each in sightings]
