"""Unwanted participants on the link: a second autopilot, one of another type, a program with the bridge's ids, a key
that only one side has.

Each is a condition with a text of at most 50 characters for the pilot. It ends when nothing of it has been received for
`HOLD_S`, so that one that comes and goes is reported once.
"""

from msp_range.health import Condition
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot

HOLD_S = 10.0
"""Time after which a condition ends [s]: ten heartbeats. Shorter reports an intermittent one repeatedly, longer reports
its end late."""
OWN_IDS_APART_S = 0.5
OWN_IDS_SEEN = 3
"""Another program uses the bridge's ids if its frames were seen this many times, at least this long apart [s]; every
component sends a heartbeat once a second. With fewer, own frames from before a restart that a router still held would
count."""

_TYPES: dict[Autopilot, int] = {
    "ardupilot": dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    "px4": dialect.MAV_AUTOPILOT_PX4,
}
_NAMES = {number: name for name, number in _TYPES.items()}


class _Sighting:
    """A condition: what to report, and when it was last seen."""

    def __init__(self, key: str, over: str) -> None:
        self._key = key
        self._over = over
        self._text = ""
        self._last_s = float("-inf")

    def seen(self, now_s: float, text: str) -> None:
        self._last_s = now_s
        self._text = text

    def condition(self, now_s: float) -> Condition:
        lasts = now_s - self._last_s < HOLD_S
        return Condition(self._key, self._text if lasts else None, self._over)


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
        self._own_ids_seen: list[float] = []
        self._signing = _Sighting("signing", "Range: the autopilot's signature is right now")

    def on_autopilot(self, now_s: float, autopilot_type: int) -> None:
        """Check a heartbeat of the bridge's own autopilot (MAV_AUTOPILOT)."""
        if self._expected is not None and autopilot_type != _TYPES[self._expected]:
            found = _NAMES.get(autopilot_type, f"type {autopilot_type}")
            self._wrong_type.seen(now_s, f"Range: autopilot is {found}, file says {self._expected}")

    def on_other_autopilot(self, now_s: float, system: int, own_system: int, own_received: bool) -> None:
        """Record an autopilot with another system id; ``own_received``: whether the bridge's own is received too."""
        if own_received:
            self._other.seen(now_s, f"Range: second autopilot, system {system} (using {own_system})")
        else:
            self._other.seen(now_s, f"Range: autopilot is system {system}, file says {own_system}")

    def on_own_ids(self, now_s: float, system: int, component: int) -> None:
        """Record a frame with the bridge's ids that it did not send."""
        seen = [time_s for time_s in self._own_ids_seen if now_s - time_s < HOLD_S]
        if not seen or now_s - seen[-1] >= OWN_IDS_APART_S:
            seen.append(now_s)
        self._own_ids_seen = seen[-OWN_IDS_SEEN:]
        if len(seen) >= OWN_IDS_SEEN:
            self._own_ids.seen(now_s, f"Range: another program sends as {system}/{component}")

    def on_unsigned(self, now_s: float) -> None:
        """Record an autopilot's heartbeat without the right signature, where there is a key."""
        self._signing.seen(now_s, "Range: autopilot does not sign with this key")

    def on_signed(self, now_s: float) -> None:
        """Record an autopilot's signed heartbeat, where there is no key: it drops what is not signed."""
        self._signing.seen(now_s, "Range: autopilot signs, signing_key is missing")

    def conditions(self, now_s: float) -> list[Condition]:
        """All conditions, for `msp_range.health.Health.set`."""
        return [each.condition(now_s) for each in (self._other, self._wrong_type, self._own_ids, self._signing)]
