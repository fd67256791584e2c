"""Every text that the pilot reads: what begins and ends it, how bad it is, and what to do about it.

docs/flying.md explains them, and a test compares its list with this one. What is in braces is filled in when a text is
sent. A text may have at most `LONGEST_TEXT` characters: a longer one is cut.
"""

import errno
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import NamedTuple

from msp_range.reading import Status

LONGEST_TEXT = 50
"""Characters of a STATUSTEXT. A sensor's name may have 32 of them, which leaves 10."""
EXPLAINED = "docs/flying.md explains the texts"
NAME_THERMOMETER = (
    "in the airframe file set temperature.fixed_c to the air's temperature of today and fixed_std_c to 3, or name a "
    "thermometer under temperature.sources"
)


class Severity(IntEnum):
    """MAV_SEVERITY, of which three are used."""

    ERROR = 3
    WARNING = 4
    INFO = 6


Report = Callable[[Severity, str], None]


class Condition(NamedTuple):
    """Something that is wrong while it lasts, or an event with a text of its own."""

    key: str
    """Identifies the condition; empty for an event."""
    text: str | None
    """Text for the pilot; None while the condition is absent."""
    over: str = ""
    """Text that is reported when it ends; empty: none."""
    severity: Severity = Severity.WARNING
    """How bad it is."""
    renews: bool = False
    """Whether another text while it lasts is reported too."""
    remedy: str = EXPLAINED
    """What to do about it."""
    is_reported: bool = True
    """Whether the pilot is to read it; else it only counts for the verdict."""

    def of(self, **values: object) -> "Condition":
        """The condition with ``values`` filled in at its key and its end."""
        return self._replace(key=self.key.format(**values), over=self.over.format(**values))

    def when(self, present: object, **values: object) -> "Condition":
        """The condition as it is now: its text with ``values`` filled in, or without a text if it is not present."""
        return self._replace(text=(self.text or "").format(**values)) if present else _absent(self)

    def said(self, **values: object) -> tuple[Severity, str]:
        """Severity and text, for a `Report`."""
        return self.severity, (self.text or "").format(**values)


@cache
def _absent(condition: Condition) -> Condition:
    return condition._replace(text=None)


def _event(text: str) -> Condition:
    return Condition("", text, severity=Severity.INFO)


class Text:
    """All texts. Further texts of a condition are copies of its first one with another text."""

    # Three of a sensor's readings in a row are faults, or half of the last ten; and three are good again.
    SENSOR = Condition("sensor {sensor}", "Range {sensor}: {fault}", "Range {sensor}: good again", Severity.ERROR)
    ALL_GOOD = _event("Range: all {count} sensors good")

    # The fusion knows a surface below one sensor that is not the ground of the others.
    OBJECT = Condition("", "Range {sensor}: object below, {high_m:.1f} m high")
    HOLE = Condition("", "Range {sensor}: hole below, {deep_m:.1f} m deep")
    GARBLED = Condition("", "Range {sensor} {deep_m:.1f} m longer: garbled?")
    GROUND = _event("Range {sensor}: ground below")
    NOT_SEEN = _event("Range {sensor}: {what} not seen now")

    # What the belief about the ground doubts, and attitudes beyond 75 deg or that are no numbers.
    STEEP = Condition(
        "doubt",
        "Range: ground seems too steep, maybe a fault",
        "Range: ground is certain again",
        renews=True,
        remedy="look for what is in the beams (payload, strap, dust); climbing a little shows whether it is ground",
    )
    CHANGE = STEEP._replace(text="Range: sudden change, maybe an object or fault")
    NO_RESPONSE = STEEP._replace(text="Range: readings do not follow the motion")
    SCATTER = STEEP._replace(
        key="scatter",
        text="Range: readings scatter, as in dust",
        over="Range: readings are of the ground again",
        renews=False,
    )
    LATE = Condition(
        "late answers",
        "Range: answers are those of the ping before",
        "Range: answers are in time again",
        remedy="switch the sensors' power off and on; check that pings are acknowledged",
    )
    ATTITUDE = Condition("attitude", "Range: attitude makes no sense", "Range: attitude is back")

    # A transfer failed, and the device at the address is not the reason.
    BUS = Condition(
        "bus",
        "Range: I2C bus gone, reopening (errno {errno})",
        "Range: I2C bus works again",
        Severity.ERROR,
        remedy="check the adapter's plug, the wires of data and clock and the sensors' power; msp-range doctor says "
        "more",
    )
    BUS_LOCKED_UP = BUS._replace(text="Range: I2C bus locked up, reopening (errno {errno})")
    BUS_STUCK = BUS._replace(text="Range: I2C bus locked up, transfer does not end")
    NO_BUS = BUS._replace(text="Range: no I2C bus: enable I2C (errno {errno})")
    BUS_REFUSED = BUS._replace(text="Range: no permission for the I2C bus (errno {errno})")
    BUS_NOT_OPENED = BUS._replace(text="Range: I2C bus cannot be opened (errno {errno})")

    # Nothing usable was sent on a stream for `Windows.silence_s`.
    FUSED_SILENT = Condition(
        "silence {sensor}",
        "Range: no distance to the ground",
        "Range: distance is back",
        Severity.ERROR,
        remedy="if nothing else here is the reason, the sensors get no echo, or do not agree on the ground",
    )
    SILENT = FUSED_SILENT._replace(text="Range {sensor}: no distance", over="Range {sensor}: distance is back")
    # More than half of the last eight readings were not used, where no echo agrees with silence.
    DISAGREE = Condition("disagree", "Range: readings disagree", "Range: readings agree")
    # They scatter by twice what their models state; or one sensor differs from its model, see `FINDINGS`.
    NOISY = Condition("noisy", "Range: readings are noisy", "Range: readings are steady", renews=True)

    # The airframe file: of a vehicle that only tries its sensors out, and read again by SIGHUP.
    NOT_SENT = Condition(
        "not sent",
        "Range: no distances are sent (send: nothing)",
        severity=Severity.INFO,
        remedy="the airframe file says so; to send them, take nothing out of its send",
    )
    RELOAD_WAITS = Condition(
        "reload",
        "Range: airframe reload waits for disarming",
        "Range: disarmed, reloading the airframe",
        Severity.INFO,
        remedy="disarm",
    )
    RELOADED = _event("Range: airframe file reloaded")
    NOT_VALID = Condition("", "Range: airframe file not valid, old one flies")

    # The disk does not take the recording, see `DISK_FAULTS`.
    NOT_RECORDING = Condition("recording", "Range: not recording, {fault}", "Range: recording again")
    DISK_HANGS = "disk does not answer"
    DISK_ERROR = "disk error (errno {errno})"

    # No thermometer, and the fixed temperature may be wrong by 10 cm of the longest range.
    NO_THERMOMETER = Condition(
        "no thermometer",
        "Range: no thermometer, {off_cm:.0f} cm off at {coldest_c:.0f} C, {maximum_m:.3g} m",
        remedy=NAME_THERMOMETER,
    )
    # A thermometer changed faster than air does, for 2 s, and no other source has a value.
    JUMP = Condition("temperature jump", "Range: air temp jumps to {to_c:.0f} C, using {using_c:.0f} C")
    SOURCE_AGREES = _event("Range: air temp {to_c:.0f} C: another source agrees")
    SOURCE_DISAGREES = _event("Range: air temp {to_c:.0f} C: another source disagrees")
    RANGES_AGREE = _event("Range: air temp {to_c:.0f} C: the ranges agree")
    RANGES_DISAGREE = _event("Range: air temp {to_c:.0f} C: the ranges disagree")
    USED = _event("Range: air temp {to_c:.0f} C used after {after_min:.0f} min, +-{doubt_c:.0f}")
    # All sources are silent for 5 s, or too old.
    NO_TEMPERATURE = Condition(
        "temperature", "Range: no air temperature, using {using_c:.0f} C", "Range: air temp is back"
    )
    WRONG_THERMOMETER = NO_TEMPERATURE._replace(
        key="thermometer wrong", text="Range: thermometer wrong at {to_c:.0f} C, using {using_c:.0f} C"
    )
    FLAPS = Condition(
        "thermometer flaps",
        "Range: thermometer flaps {low_c:.0f} to {high_c:.0f} C, using {using_c:.0f} C",
        "Range: thermometer flaps no more",
    )
    # A thermometer settles, and the distances may be wrong by 10 cm of the longest range.
    LAGS = Condition(
        "thermometer settles",
        "Range: air temp lags, up to {off_cm:.0f} cm off at {maximum_m:.3g} m",
        "Range: thermometer has settled",
    )
    HANGS = Condition(
        "thermometer hangs", "Range: thermometer file does not answer", "Range: thermometer file answers again"
    )

    # No heartbeat of an autopilot for 5 s: nobody gets a text then, so this is for those who look at the status.
    NO_AUTOPILOT = Condition(
        "autopilot", "Range: no autopilot, nobody gets the distances", severity=Severity.ERROR, is_reported=False
    )
    # What the autopilot's own messages say of the distances; it has texts of its own for the pilot.
    NOT_RECEIVED = Condition("acceptance", "Range: autopilot does not receive the distances", is_reported=False)
    OTHER_RANGE = NOT_RECEIVED._replace(text="Range: autopilot has {has_m:.2f} m, not what is sent")
    REJECTED = NOT_RECEIVED._replace(
        text="Range: autopilot rejects distances (ratio {ratio:.1f})",
        remedy="its other sources of height differ from the distances: compare the height above the ground on its map, "
        "and see what is in the beams",
    )
    NOT_FOLLOWED = REJECTED._replace(text="Range: autopilot is {off_m:.1f} m off: rejected")
    # Received on the link in the last 10 s, what is about ids three times.
    SECOND_AUTOPILOT = Condition(
        "other autopilot",
        "Range: second autopilot, system {system} (using {own})",
        "Range: the other autopilot is gone",
    )
    OTHER_AUTOPILOT = SECOND_AUTOPILOT._replace(text="Range: autopilot is system {system}, file says {own}")
    AUTOPILOT_LOST = Condition(
        "autopilot lost", "Range: autopilot {first} is silent, using {system}", "Range: the first autopilot is back"
    )
    AUTOPILOT_TYPE = Condition(
        "autopilot type", "Range: autopilot is {found}, file says {expected}", "Range: the autopilot is {expected} now"
    )
    OWN_IDS = Condition(
        "own ids",
        "Range: another program sends as {system}/{component}",
        "Range: no other program uses this bridge's id now",
    )
    AUTOPILOT_IDS = Condition(
        "autopilot's ids",
        "Range: two autopilots send as system {system}",
        "Range: one autopilot sends with its ids now",
    )
    OTHER_KEY = Condition(
        "signing",
        "Range: autopilot does not sign with this key",
        "Range: the autopilot's signature is right now",
        remedy="msp-range sign gives both the same key",
    )
    NO_KEY = OTHER_KEY._replace(text="Range: autopilot signs, signing_key is missing")
    # The file that keeps the time of signatures cannot be written.
    SIGNING_TIME = Condition(
        "signing time", "Range: signing time is not kept, check the disk", "Range: signing time is kept again"
    )


SENSOR_FAULTS = {
    Status.NO_ANSWER: ("no answer", "check its power, its wires and its address"),
    Status.CLOCK_FAULT: ("I2C clock fault, use 50 kHz", "msp-range doctor says how the bus's clock is set"),
    Status.IMPOSSIBLE: ("impossible answers", "check that it is of the model in the airframe file, and its supply"),
    Status.PART_INFO: ("answers without ranging", "switch its power off and on"),
    Status.STUCK: ("stuck at one value", "switch its power off and on"),
    Status.FIXED: ("sees part of the vehicle", "free its beam: payload, strap, landing gear, ice"),
    Status.GARBLED: ("garbled answers, check the bus", "check the bus's wires, pull-ups and clock"),
}
"""What `Text.SENSOR` says of each fault, and what to do."""
FINDINGS = {
    "short": ("often too short", "too short", "too short {times:.0f} times as often as its model says"),
    "missed": ("often no echo", "no echoes", "no echo {times:.0f} times as often as its model says"),
    "wider": ("unsteady readings", "unsteady", "scatters {times:.1f} times as much as its model says"),
    "shifted": ("{off}", "{shift_cm:+.0f} cm", "{off} by the other sensors"),
    "repeats": ("repeats readings", "repeats", "the same answer although the height has changed"),
}
"""What a sensor does otherwise than its model, the same in ten characters for a long name, and by how much."""
DISK_FAULTS = {
    errno.ENOSPC: "disk full",
    errno.EDQUOT: "disk full",
    errno.ENOENT: "folder gone",
    errno.ENOTDIR: "folder gone",
    errno.EROFS: "disk is read-only",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
}
"""What `Text.NOT_RECORDING` says of an error of the disk, in at most 28 characters; of others `Text.DISK_ERROR`."""
