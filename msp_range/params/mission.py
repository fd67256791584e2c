"""The mission of an autopilot, read by MAVLink's mission protocol (https://mavlink.io/en/services/mission.html)."""

from functools import partial
from typing import NamedTuple

from msp_range.mavlink.dialect import dialect
from msp_range.params.client import ParameterClient


class Waypoint(NamedTuple):
    """An item that the vehicle flies to."""

    number: int
    """Its number, as ground stations show it."""
    frame: int
    """What its height is counted from (MAV_FRAME)."""
    height_m: float
    """Its height [m]."""


def read_mission(client: ParameterClient) -> tuple[list[Waypoint], int | None]:
    """The waypoints, and how many items were not read until `ParameterClient.end_s`; None: the autopilot gave no
    number.

    Nothing is changed there. ArduPilot's item 0 is home and no waypoint.
    """
    messages, waypoints = client.messages, list[Waypoint]()

    def has(number: int) -> bool:
        return "MISSION_ITEM_INT" in messages and bool(messages["MISSION_ITEM_INT"].seq == number)

    messages.pop("MISSION_COUNT", None)
    client.ask([dialect.MAVLink_mission_request_list_message(*client.target)], lambda: "MISSION_COUNT" in messages)
    if "MISSION_COUNT" not in messages:
        return [], None
    count = messages["MISSION_COUNT"].count
    for number in range(count):
        messages.pop("MISSION_ITEM_INT", None)
        client.ask([dialect.MAVLink_mission_request_int_message(*client.target, number)], partial(has, number))
        if not has(number):
            return waypoints, count - number
        item = messages["MISSION_ITEM_INT"]
        if item.command < dialect.MAV_CMD_NAV_LAST and (number or client.autopilot == "px4"):
            waypoints.append(Waypoint(number, item.frame, item.z))
    client.link.send(dialect.MAVLink_mission_ack_message(*client.target, dialect.MAV_MISSION_ACCEPTED))
    return waypoints, 0
