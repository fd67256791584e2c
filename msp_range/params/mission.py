"""The mission of an autopilot, read by MAVLink's mission protocol (https://mavlink.io/en/services/mission.html)."""

from functools import partial
from typing import Any, NamedTuple

from msp_range.mavlink.dialect import dialect
from msp_range.params.client import COMPONENT_ID, ParameterClient

FLIES_TO = frozenset(
    getattr(dialect, f"MAV_CMD_NAV_{name}")
    for name in (
        *("WAYPOINT", "SPLINE_WAYPOINT", "TAKEOFF", "VTOL_TAKEOFF", "LAND", "VTOL_LAND", "PAYLOAD_PLACE"),
        *("LOITER_UNLIM", "LOITER_TURNS", "LOITER_TIME", "LOITER_TO_ALT", "CONTINUE_AND_CHANGE_ALT"),
    )
)
"""Commands with a height that the vehicle flies to. Others, such as a return, have a frame and a height without a
meaning."""


class Waypoint(NamedTuple):
    """An item that the vehicle flies to."""

    number: int
    """Its number in the autopilot; QGroundControl shows PX4's one higher."""
    frame: int
    """What its height is counted from (MAV_FRAME)."""
    height_m: float
    """Its height [m]."""


def read_mission(client: ParameterClient) -> tuple[list[Waypoint], int | None]:
    """The waypoints, and the number of items that were not read until `ParameterClient.end_s`.

    That number is None if the autopilot reported no count. The mission is only read. ArduPilot's item 0 is home and no
    waypoint.
    """
    waypoints: list[Waypoint] = []

    def answer(kind: str) -> Any:
        """The newest message of this kind, if it is for this program and of the mission, not of a fence; else None."""
        message = client.messages.get(kind)
        is_own = message is not None and message.mission_type == 0 and message.target_component in (0, COMPONENT_ID)
        return message if is_own else None

    def item(number: int) -> Any:
        found = answer("MISSION_ITEM_INT")
        return found if found is not None and found.seq == number else None

    for kind in ("MISSION_COUNT", "MISSION_ITEM_INT"):
        client.messages.pop(kind, None)
    counted = partial(answer, "MISSION_COUNT")
    client.ask([dialect.MAVLink_mission_request_list_message(*client.target)], counted)
    if (count := counted()) is None:
        return [], None
    left = count.count
    for number in range(count.count):
        client.ask([dialect.MAVLink_mission_request_int_message(*client.target, number)], partial(item, number))
        if (found := item(number)) is None:
            break
        left -= 1
        if found.command in FLIES_TO and (number or client.autopilot == "px4"):
            waypoints.append(Waypoint(number, found.frame, found.z))
    result = dialect.MAV_MISSION_OPERATION_CANCELLED if left else dialect.MAV_MISSION_ACCEPTED
    client.link.send(dialect.MAVLink_mission_ack_message(*client.target, result))
    return waypoints, left
