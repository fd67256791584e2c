"""The autopilot before a flight: its parameters, and the heights of return and mission against the range's maximum.

A return at 15 m is normally flown without a sensor that reaches 8 m: distances read 'above the maximum' there. This is
reported, and is wrong only where the autopilot's own settings make it rely on the range at that height. What was not
read is not known.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.doctor.autopilot import check_parameters, check_type
from msp_range.doctor.finding import RIGHT, UNKNOWN, Finding, first_of, unknown, wrong
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import Transport
from msp_range.params.client import ParameterClient
from msp_range.params.mission import read_mission
from msp_range.params.settings import downward_stream
from msp_range.yaml_file import ConfigError

HEARTBEAT_S = 1.5
"""How long to wait for a heartbeat, which comes once a second [s]; more leaves less time for the mission."""
HEIGHTS = {
    "copter": (("RTL_ALT_M", "RTL_ALT"),),
    "plane": (("RTL_ALTITUDE", "ALT_HOLD_RTL"),),
    "px4": (("RTL_RETURN_ALT",), ("RTL_DESCEND_ALT",), ("MIS_TAKEOFF_ALT",)),
}
"""Parameters with heights above home, each with its older name (ArduCopter's and ArduPlane's Parameters.cpp, PX4's
rtl_params.c and mission_params.c)."""
IN_CENTIMETRES = ("RTL_ALT", "ALT_HOLD_RTL")
RETURNS = ("RTL_ALT_M", "RTL_ALT", "RTL_ALTITUDE", "ALT_HOLD_RTL")
"""ArduPilot's heights of return: where one is 0 or less, the vehicle returns at the height that it has."""
SOURCES = {"px4": "EKF2_HGT_REF", "ardupilot": "EK3_SRC1_POSZ"}
"""Parameter with the source of the height; in both, 2 selects the range finder."""
TERRAIN = {"copter": (("RTL_ALT_TYPE",), ("WP_RFND_USE", "WPNAV_RFND_USE"))}
"""Parameters by which a height above the terrain is one by range (ArduCopter's mode_rtl.cpp, AC_WPNav.cpp), each with
its older name."""
ABOVE_HOME = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
ABOVE_SEA = dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT
ABOVE_TERRAIN = dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT, dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT


class Height(NamedTuple):
    """One height that the autopilot may fly at."""

    what: str
    """Parameter or mission item."""
    height_m: float
    remedy: str | None = None
    """What to do if it is above the maximum; None: the autopilot does not rely on the range there."""

    def __str__(self) -> str:
        return f"{self.what} {self.height_m:.4g} m"


def maximum_of(airframe: Airframe) -> float:
    """Longest distance of the downward stream [m]; infinite where nothing looks down."""
    stream = downward_stream(airframe)
    return float("inf") if stream is None else stream.max_distance_cm / 100


def check_before_flight(airframe: Airframe, transport: Transport, clock: Clock, end_s: float) -> Iterator[Finding]:
    """Heartbeat, parameters, mission and heights; what is not known at ``end_s`` is reported so."""
    try:
        client = ParameterClient(transport, clock, airframe.link)
    except ConfigError as error:
        yield wrong("signing", str(error), f"msp-range sign {airframe.path} makes a key and gives it to the autopilot")
        return
    client.end_s = end_s
    if not client.connect(HEARTBEAT_S):
        if clock.now() >= end_s:
            yield unknown("autopilot", "no time was left to wait for it", f"msp-range doctor {airframe.path}")
            return
        yield wrong("heartbeat", f"none came for {HEARTBEAT_S:g} s", f"msp-range doctor {airframe.path} shows why")
        return
    found = check_type(airframe, client)
    yield found
    if found.verdict is not RIGHT or downward_stream(airframe) is None:
        return
    kind = client.vehicle if client.autopilot == "ardupilot" else "px4"
    groups = (*HEIGHTS.get(kind, ()), (SOURCES[airframe.link.autopilot],), *TERRAIN.get(kind, ()))
    values = client.read_any(*groups)
    firmware = client.firmware()
    assert firmware is not None
    compared = check_parameters(airframe, client, firmware)
    late = unknown("parameters", "not compared in time", f"msp-range params {airframe.path} --compare")
    yield late if clock.now() >= end_s else compared
    mission, heights = _mission(client, values, clock.now() >= end_s)
    yield from mission
    unread = [group[0] for group in groups if not any(name in values for name in group)]
    yield compare_heights([*_of_parameters(values), *heights], unread, maximum_of(airframe))


def compare_heights(heights: Sequence[Height], unread: Sequence[str], maximum_m: float) -> Finding:
    """Heights that the autopilot may fly at against the range's maximum [m]; ``unread``: names without an answer."""
    above = [each for each in heights if each.height_m > maximum_m]
    relied_on = [each for each in above if each.remedy is not None]
    present = [each for each in heights if each.what in RETURNS and each.height_m <= 0]
    compare = f"compare the heights of return and mission with {maximum_m:g} m in the ground station"
    return first_of(
        "heights",
        (
            relied_on,
            f"{_listed(relied_on)}: above the range's maximum of {maximum_m:g} m, and the autopilot relies on it there",
            f"lower, or {' and '.join(sorted({each.remedy or '' for each in relied_on}))}",
        ),
        (unread, f"the autopilot did not answer for {', '.join(unread)}", compare, UNKNOWN),
        (not heights, "none were read", compare, UNKNOWN),
        (present, f"with {_listed(present)} the vehicle returns at the height that it has then", compare, UNKNOWN),
        (
            above,
            f"{_listed(above)}: above {maximum_m:g} m distances read 'above the maximum', and the autopilot does not "
            "rely on them there",
        ),
        (True, f"{_listed(heights)}: within the range's maximum of {maximum_m:g} m"),
    )


def _listed(heights: Sequence[Height]) -> str:
    return ", ".join(map(str, heights))


def _source(values: dict[str, float]) -> str | None:
    """What to do where the range is the source of the autopilot's height; None where it is not."""
    return next((f"{name} 1 (not the range)" for name in SOURCES.values() if values.get(name) == 2), None)


def _terrain(values: dict[str, float]) -> str | None:
    """What to do where heights above the terrain are by range; None where they are not."""
    names = TERRAIN["copter"][1]
    return next((f"{name} 0 (terrain database)" for name in names if values.get(name)), None)


def _of_parameters(values: dict[str, float]) -> Iterator[Height]:
    """The heights among the parameters."""
    is_above_terrain = values.get("RTL_ALT_TYPE") == 1 and _terrain(values)
    remedy = _source(values) or ("RTL_ALT_TYPE 0 (above home)" if is_above_terrain else None)
    for name in (name for kind in HEIGHTS.values() for group in kind for name in group if name in values):
        yield Height(name, values[name] * (0.01 if name in IN_CENTIMETRES else 1.0), remedy)


def _mission(client: ParameterClient, values: dict[str, float], is_late: bool) -> tuple[list[Finding], list[Height]]:
    """What is not known of the mission, and the highest waypoints above home and above the terrain.

    ``is_late``: no time is left to read it.
    """
    waypoints, left = read_mission(client)
    by_sea = sum(each.frame in ABOVE_SEA for each in waypoints)
    others = sum(each.frame not in ABOVE_HOME + ABOVE_TERRAIN + ABOVE_SEA for each in waypoints)
    unanswered = "not read: no time was left" if is_late else "not read: the autopilot does not answer for it"
    findings = [
        unknown("mission", text, "compare their heights with the range's maximum in the ground station")
        for is_so, text in (
            (left is None, unanswered),
            (left, f"{left} of its items were not read in time"),
            (by_sea, f"waypoints above sea level are not compared: {by_sea}"),
            (others, f"waypoints in frames of their own are not compared: {others}"),
        )
        if is_so
    ]
    heights = []
    for frames, name, remedy in (
        (ABOVE_HOME, "mission item {}", _source(values)),
        (ABOVE_TERRAIN, "mission item {} above the terrain", _source(values) or _terrain(values)),
    ):
        if some := [each for each in waypoints if each.frame in frames]:
            highest = max(some, key=lambda each: each.height_m)
            heights.append(Height(name.format(highest.number), highest.height_m, remedy))
    return findings, heights
