"""The fields of a running bridge's state: each is a row here, which terminal, page and metrics show."""

from collections.abc import Iterator
from typing import NamedTuple

from msp_range.watch.newest import Newest

DISTANCE = "distance down"
SHOWN_CLIMB_M_S = 0.1
"""A slower climb is not shown [m/s]: noise reaches 0.05."""


class Fact(NamedTuple):
    """One field as it is now."""

    name: str
    """What it is."""
    text: str
    """What follows its name, for a person."""
    gauges: dict[str, tuple[str, float]]
    """Its numbers for Prometheus: help and value by name."""
    in_list: bool = True
    """Whether the page lists it; else it draws it in a form of its own."""


def facts_of(newest: Newest) -> Iterator[Fact]:
    """All that is known, in the order in which it is shown."""
    fused, airframe, status = newest.distance, newest.airframe, newest.status
    if fused is not None:
        climb = f", climbing {fused['climb_m_s']:+.1f} m/s" if abs(fused["climb_m_s"]) >= SHOWN_CLIMB_M_S else ""
        not_sent = " (not sent)" * airframe.get("sends_nothing", False)
        text = f" {fused['range_m']:.2f} m{not_sent}, deviation {100 * fused['variance_m2'] ** 0.5:.1f} cm{climb}"
        range_m = "Fused distance along the down axis.", fused["range_m"]
        variance_m2 = "Variance of its error.", fused["variance_m2"]
        gauges = {"msp_range_distance_m": range_m, "msp_range_distance_variance_m2": variance_m2}
        yield Fact(DISTANCE, text, gauges, in_list=False)
    elif airframe.get("reference_down_m") is not None:
        yield Fact(DISTANCE, ": none", {}, in_list=False)
    if not status:
        return
    air, link = status["air"], status["link"]
    text = f" {air['temperature_c']:.1f} C, deviation {air['std_c']:.1f} C, from {air['source']}"
    temperature_c = "Air temperature of the correction.", air["temperature_c"]
    yield Fact("air", text, {"msp_range_air_temperature_c": temperature_c})
    is_there = link["autopilot"] is not None
    there = f"system {link['autopilot']}" if is_there else "none received"
    armed = {True: ", armed", False: ", disarmed", None: ""}[link["armed"]]
    down = "" if link["connected"] else f", not connected: {link['error'] or 'waiting'}"
    is_present = "1 if heartbeats arrive.", is_there
    yield Fact("link", f" {link['url']}{down}; autopilot: {there}{armed}", {"msp_range_autopilot_present": is_present})
    distances = f"{link['sent'].get('DISTANCE_SENSOR', 0)} distances{'' if is_there else ', nobody gets them'}"
    sent = "no distances" if airframe.get("sends_nothing") else distances
    yield Fact("sent", f" {sent}, {link['dropped']} frames dropped", {})
    if (back := newest.received.get("DISTANCE_SENSOR")) is not None:
        text = f" {back['distance_m']:.2f} m (orientation {back['orientation']})"
        yield Fact("the autopilot has", text, {}, in_list=False)
    yield Fact("recording", f": {status['recording'] or 'none'}", {})
    uptime_s = "Time since the bridge was started.", status["uptime_s"]
    yield Fact("running for", f" {status['uptime_s']:.0f} s", {"msp_range_uptime_seconds": uptime_s}, in_list=False)
