"""The fields of a running bridge's state: each is named here alone, and terminal, page and metrics show it.

The bridge makes them for each status, and sends them with it (`status_facts`). The fused distance is not among them: it
changes with each reading, so a watcher makes its field of the newest record (`facts_of`).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from msp_range.acoustics.air import source_in_words
from msp_range.bridge import Bridge
from msp_range.mavlink.transport import Transport
from msp_range.watch.newest import Newest

DISTANCE = "distance down"
SHOWN_CLIMB_M_S = 0.1
"""A slower climb is not shown [m/s]: noise reaches 0.05."""


class Fact(NamedTuple):
    """One field as it is now."""

    name: str
    """Name of the field, for a person."""
    text: str
    """What follows its name, for a person."""
    gauges: dict[str, tuple[str, float]]
    """Its numbers for Prometheus: help and value by name."""
    in_list: bool = True
    """Whether the page lists it; else it draws it in a form of its own."""


_GAUGES = {
    "received_m": "Distance that the autopilot says it has.",
    "height_m": "Height above the ground by the autopilot's estimator.",
    "off_m": "How much larger that is than the distances sent.",
    "ratio": "Innovation of the autopilot's estimator over its limit.",
}


def status_facts(bridge: Bridge, transport: Transport, recording: Path | None, uptime_s: float) -> Iterator[Fact]:
    """The fields of a status, in the order in which they are shown.

    Parameters
    ----------
    recording
        The file that is written; None: none.
    uptime_s
        Time since the bridge was started [s].
    """
    air, link = bridge.air, bridge.link
    text = f" {air.temperature_c:z.1f} C, deviation {air.std_c:.1f} C, {source_in_words(air.source)}"
    temperature_c = "Air temperature of the correction.", air.temperature_c
    yield Fact("air", text, {"msp_range_air_temperature_c": temperature_c})
    is_there = link.autopilot_is_present
    there = f"system {link.autopilot_system}" if is_there else "none received"
    armed = {True: ", armed", False: ", disarmed", None: ""}[link.autopilot_armed if is_there else None]
    down = "" if transport.connected else f", not connected: {transport.last_error or 'waiting'}"
    is_present = "1 if heartbeats arrive.", is_there
    text = f" {transport.description}{down}; autopilot: {there}{armed}"
    yield Fact("link", text, {"msp_range_autopilot_present": is_present})
    distances = f"{link.sent['DISTANCE_SENSOR']} distances{'' if is_there else ', nobody gets them'}"
    sent = "no distances" if bridge.airframe.send.nothing else distances
    yield Fact("sent", f" {sent}, {transport.stats.dropped_frames} frames dropped", {})
    if bridge.acceptance is not None:
        numbers = bridge.acceptance.numbers.items()
        gauges = {f"msp_range_autopilot_{name}": (_GAUGES[name], value) for name, value in numbers}
        yield Fact("the autopilot", f" {bridge.acceptance.text}", gauges)
    yield Fact("recording", f": {recording or 'none'}", {})
    uptime = {"msp_range_uptime_seconds": ("Time since the bridge was started.", uptime_s)}
    yield Fact("running for", f" {uptime_s:.0f} s", uptime, in_list=False)


def facts_of(newest: Newest) -> Iterator[Fact]:
    """All fields of a watched bridge, in the order in which they are shown; a distance, if the vehicle has one."""
    if newest.distance is not None:
        yield _distance_fact(newest, newest.distance)
    elif newest.airframe.get("reference_down_m") is not None:
        yield Fact(DISTANCE, ": none", {}, in_list=False)
    for field in newest.status.get("facts", []):
        yield Fact(**field)


def _distance_fact(newest: Newest, fused: dict[str, Any]) -> Fact:
    climb = f", climbing {fused['climb_m_s']:+.1f} m/s" if abs(fused["climb_m_s"]) >= SHOWN_CLIMB_M_S else ""
    not_sent = " (not sent)" * newest.airframe.get("sends_nothing", False)
    text = f" {fused['range_m']:.2f} m{not_sent}, deviation {100 * fused['variance_m2'] ** 0.5:.1f} cm{climb}"
    gauges = {
        "msp_range_distance_m": ("Fused distance along the down axis.", fused["range_m"]),
        "msp_range_distance_variance_m2": ("Variance of its error.", fused["variance_m2"]),
    }
    return Fact(DISTANCE, text, gauges, in_list=False)
