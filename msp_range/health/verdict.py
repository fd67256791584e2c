"""What the bridge's state is, and why: the one verdict that heartbeat, page, terminal, metrics and doctor show."""

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

from msp_range.pilot_texts import Condition, Severity, Text

_WIDEST = ("bus", "signing", "other autopilot", "autopilot")
"""Conditions that concern more than one sensor, in the order in which they are shown, before those of single ones."""


class BridgeState(StrEnum):
    """What the bridge's work is worth to the autopilot."""

    STARTING = "starting"
    """nothing is wrong, but not all sensors and the autopilot are known yet"""
    ACTIVE = "active"
    """distances go out, and an autopilot is received"""
    SENDS_NOTHING = "sends nothing"
    """all is as for active, but the airframe file says that no distance is sent"""
    CRITICAL = "critical"
    """a distance is missing, or nobody gets it"""


class BridgeFinding(NamedTuple):
    """One thing that is wrong."""

    what: str
    text: str
    remedy: str
    severity: Severity
    is_reported: bool
    """As in its condition."""
    cause: str | None
    """``what`` of the finding that it follows from; None: it follows from none."""


class BridgeVerdict(NamedTuple):
    """The state, and what is wrong: each cause, errors first, and right behind it what follows from it."""

    state: BridgeState
    findings: tuple[BridgeFinding, ...] = ()


def verdict_of(conditions: Iterable[Condition], is_ready: bool) -> BridgeVerdict:
    """What conditions mean together; ``is_ready``: all sensors and the autopilot are known.

    Examples
    --------
    >>> found = [Condition("sensor a", "a: no answer", "", Severity.ERROR), Condition("bus", "no bus", "")]
    >>> [(each.what, each.cause) for each in verdict_of(found, True).findings]
    [('bus', None), ('sensor a', 'bus')]
    """
    present = {condition.key: condition for condition in conditions}
    groups: dict[str, list[BridgeFinding]] = {}
    state = BridgeState.STARTING
    if is_ready:
        state = BridgeState.SENDS_NOTHING if Text.NOT_SENT.key in present else BridgeState.ACTIVE
    for key, text, _, severity, _, remedy, is_reported in present.values():
        if text is None:
            continue
        if severity is Severity.ERROR:
            state = BridgeState.CRITICAL
        cause = next((each for each in _causes(key) if each in present), None)
        groups.setdefault(cause or key, []).append(BridgeFinding(key, text, remedy, severity, is_reported, cause))

    def rank(cause: str) -> tuple[int, int]:
        return min(each.severity for each in groups[cause]), (*_WIDEST, cause).index(cause)

    return BridgeVerdict(
        state,
        tuple(
            finding
            for cause in sorted(groups, key=rank)
            for finding in sorted(groups[cause], key=lambda each: each.cause is not None)
        ),
    )


def _causes(key: str) -> tuple[str, ...]:
    """Conditions that a condition follows from where they are present, the widest first."""
    if key == "autopilot":
        return "signing", "other autopilot"
    kind, _, name = key.partition(" ")
    return {"sensor": ("bus",), "silence": ("bus", f"sensor {name}")}.get(kind, ())
