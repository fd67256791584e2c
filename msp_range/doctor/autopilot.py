"""The autopilot at the other end: its heartbeat and type, its parameters, whether distances reach it, the latency.

Distances that the sensors have just measured are sent for some seconds, and only while the vehicle is disarmed.
"""

from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

from msp_range.assembly import downward_stream
from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, MAVLINK_FIELDS, MavlinkSource
from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import RIGHT, UNKNOWN, WRONG, Finding, first_of, right, unknown, wrong
from msp_range.doctor.port import check_holders
from msp_range.mavlink.acceptance import OTHER_FIRST, RETURNED_M, is_first, is_healthy, not_received
from msp_range.mavlink.distance_sensor import distance_sensor
from msp_range.mavlink.frames import Frame, FrameReader
from msp_range.mavlink.orientation import DOWN
from msp_range.mavlink.signing import PX4_SIGNS_NOT
from msp_range.mavlink.transport import Transport, Wrapped, open_transport
from msp_range.mavlink.transport.url import NetworkUrl, SerialUrl, parse_url
from msp_range.params.client import ParameterClient
from msp_range.params.commands import described, differences
from msp_range.params.settings import (
    ADDRESS,
    DISTANCE_SENSOR_BY_MAVLINK,
    UNARMED,
    Firmware,
    settings,
)
from msp_range.yaml_file import ConfigError

CONNECT_S = 6.0
"""How long to wait for a heartbeat, which comes once a second; a link may have to be opened again [s]."""
SENT_S, SENT_INTERVAL_S = 4.0, 0.1
"""Distances are sent for this long at the bridge's rate [s]: ArduPilot wants three good ones in a row, and sends its
own once or twice a second until a faster rate is asked for."""
DELAY, DELAY_MS = "EKF2_RNG_DELAY", 25.0
"""PX4's parameter for the latency may be off by this [ms]: at 1 m/s it is 2.5 cm. From the ground to 6 m the latency
itself grows by 18 ms, so less would call a good value wrong."""
PORT_NAMES = ("SERIAL", "MAV_", "SER_")
"""Beginnings of names of parameters of the port: messages arrive, so it is set up, whichever port it is."""
_EXISTS = {"ardupilot": "RNGFND1_TYPE", "px4": "EKF2_RNG_CTRL"}
"""A parameter that each autopilot has: it is asked for where TIMESYNC is not answered."""
LISTEN_S = 2.0
"""How long to listen for a program that sends to this computer, where nobody is at the address of the link [s]: an
autopilot sends a heartbeat once a second."""


class Tap(Wrapped):
    """A transport that counts what arrives.

    Attributes
    ----------
    received_bytes : int
        All of them.
    frames : list of Frame
        The valid ones.
    """

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport)
        self._reader = FrameReader()
        self.received_bytes = 0
        self.frames: list[Frame] = []

    def receive(self) -> bytes:
        """Count and return what has arrived."""
        arrived = super().receive()
        self.received_bytes += len(arrived)
        self.frames += self._reader.read(arrived)
        return arrived

    @property
    def autopilots(self) -> list[int]:
        """Systems of the autopilots that were received."""
        return sorted({frame.system for frame in self.frames if frame.is_autopilot_heartbeat})


def check_autopilot(
    airframe: Airframe,
    computer: Computer,
    transport: Transport,
    clock: Clock,
    ranges_m: Mapping[str, float],
    latency_s: float | None,
) -> Iterator[Finding]:
    """All steps on the link.

    Parameters
    ----------
    ranges_m
        Distances that the sensors measured, by name [m].
    latency_s
        From an echo to its answer [s]; None where it was not measured.
    """
    tap = Tap(transport)
    temperatures = [source for source in airframe.temperature.sources if isinstance(source, MavlinkSource)]
    wanted = {temperature.message: 1.0 for temperature in temperatures} | {"DISTANCE_SENSOR": 5.0, "SYS_STATUS": 2.0}
    try:
        client = ParameterClient(tap, clock, airframe.link, wanted)
    except ConfigError as error:
        yield wrong("signing", str(error), f"msp-range sign {airframe.path} makes a key and gives it to the autopilot")
        return
    if not client.connect(CONNECT_S):
        yield silence(airframe, computer, tap, clock)
        return
    # Others that send on the link, and the messages asked for, need a moment.
    client.wait(lambda: False, 1.5)
    found = check_type(airframe, client)
    yield found
    yield from _others(airframe, tap)
    yield from (_temperature(source, client) for source in temperatures)
    if found.verdict is not RIGHT:
        return
    replies = _replies(airframe, tap, client)
    yield replies
    if replies.verdict is WRONG:
        return
    if client.armed is not False:
        yield unknown("distances", "the vehicle is armed: nothing is sent", "disarm it and try again")
        return
    firmware = client.firmware()
    assert firmware is not None
    if airframe.send.nothing:
        yield _withheld(client)
    else:
        yield check_parameters(airframe, client, firmware)
        yield _distances(airframe, client, clock, ranges_m)
    if latency_s is not None:
        yield _latency(client, latency_s)


def silence(airframe: Airframe, computer: Computer, tap: Tap, clock: Clock) -> Finding:
    """Why no heartbeat of the autopilot came, and what to do."""
    link, count = airframe.link, tap.received_bytes
    url = None if tap.frames else parse_url(tap.description)
    in_use = check_holders(computer, url) if url and not count else None
    if in_use is not None:
        return in_use
    is_closed = tap.last_error and not tap.connected
    if isinstance(url, NetworkUrl) and not (count or is_closed):
        return _silent_network(url, tap, clock)
    place, rate = (url.path, f", not {url.baud} baud") if isinstance(url, SerialUrl) else ("", "")
    is_ardupilot = link.autopilot == "ardupilot"
    setup = "SERIALn_PROTOCOL 2" if is_ardupilot else "MAV_n_CONFIG and MAV_n_MODE 2"
    systems, senders = tap.autopilots, sorted({(frame.system, frame.component) for frame in tap.frames})
    listed = ", ".join(f"{system}/{component}" for system, component in senders)
    sign = f"msp-range sign {airframe.path} gives the autopilot the key" if is_ardupilot else PX4_SIGNS_NOT
    return first_of(
        "heartbeat",
        (
            is_closed,
            f"the link cannot be opened: {tap.last_error}",
            "check link.url, and what else uses it: sudo systemctl stop msp-range if the service runs",
        ),
        (
            systems and link.signing_key is not None,
            f"system {systems} is received, and not signed with the key {link.signing_key}",
            sign,
        ),
        (
            systems,
            f"link.system_id is {link.system_id}, and the autopilot received is {systems}",
            "correct link.system_id, or leave it out",
        ),
        (
            senders,
            f"MAVLink comes from {listed} only, which is no autopilot",
            "connect the bridge to a port of the autopilot, or let the router pass its messages on",
        ),
        (
            count,
            f"{count} bytes arrive, and none are MAVLink{rate}",
            f"set the same baud rate on both sides, and {setup} on the autopilot's port",
        ),
        (
            True,
            f"nothing arrives at {place}",
            f"exchange TX and RX, connect ground, switch the autopilot on, and set {setup} on its port",
        ),
    )


def _silent_network(url: NetworkUrl, tap: Tap, clock: Clock) -> Finding:
    """What to do where an address is silent: one side of a UDP link sends first, and the other one listens."""
    text, here = f"nothing arrives by {url}", f"udpin:0.0.0.0:{url.port}"
    systems = _systems_at(here, clock) if url.kind == "udpout" else []
    far = "check that the other side sends to this computer's address and this port, and firewalls"
    near = "check address, port and firewall, and that the other side listens there"
    return first_of(
        "heartbeat",
        (url.kind == "udpin", text, f"{far}; where it listens, too: udpout:HOST:PORT"),
        (url.kind != "udpout", text, "check address, port and firewall, and that the autopilot sends there"),
        (
            systems,
            f"{text}, and system {systems} sends to port {url.port} of this computer, where nobody listens",
            f"link.url: {here}",
        ),
        (
            True,
            f"{text}{': nobody listens there' * bool(tap.stats.refused)}",
            f"{near}; where it sends to this computer instead: {here}",
        ),
    )


def _systems_at(url: str, clock: Clock) -> list[int]:
    """Systems whose messages arrive at a port of this computer; none where another program listens there."""
    with closing(Tap(open_transport(url, clock))) as tap:
        end_s = clock.now() + LISTEN_S
        while not tap.frames and clock.now() < end_s:
            tap.receive()
            clock.sleep_until(clock.now() + SENT_INTERVAL_S)
    return sorted({frame.system for frame in tap.frames})


def check_type(airframe: Airframe, client: ParameterClient) -> Finding:
    """Whether the autopilot is of the kind that the airframe file names."""
    name = {"ardupilot": "ArduPilot", "px4": "PX4", None: "neither ArduPilot nor PX4"}[client.autopilot]
    text, expected = f"system {client.link.autopilot_system} is {name}", airframe.link.autopilot
    other = f"{text}, and link.autopilot is {expected}"
    is_other = client.autopilot != expected, other, "correct link.autopilot"
    return first_of("heartbeat", is_other, (True, text))


def _others(airframe: Airframe, tap: Tap) -> Iterator[Finding]:
    if len(tap.autopilots) > 1 and airframe.link.system_id is None:
        text = f"heartbeats of several autopilots: systems {', '.join(map(str, tap.autopilots))}"
        yield wrong("other autopilots", text, "state the vehicle's own as link.system_id")
    bridge = airframe.link.component_id
    if any(frame.component == bridge and frame.system in tap.autopilots for frame in tap.frames):
        text = f"another program already sends as component {bridge}"
        yield wrong("component id", text, "stop it (is the bridge running?), or change link.component_id")


def _replies(airframe: Airframe, tap: Tap, client: ParameterClient) -> Finding:
    """Whether the autopilot receives what is sent to it: heartbeats show the other direction only."""
    link = airframe.link
    answers = client.link.autopilot_clock.round_trip_s is not None or client.read(_EXISTS[link.autopilot]) is not None
    if link.signing_key is None and any(frame.is_signed for frame in tap.frames):
        by_usb = "the autopilot signs its messages, and answers unsigned ones on this port, as ArduPilot does by USB"
        drops = "the autopilot signs its messages and drops those of the bridge, which has no key"
        clear = f"give both the same key: msp-range sign {airframe.path}; or clear it in the ground station"
        return first_of(
            "signing",
            (answers, by_usb, f"for another port give both the same key: msp-range sign {airframe.path}", UNKNOWN),
            (True, drops, clear),
        )
    deaf = "the autopilot is received, and answers nothing that is sent to it (TIMESYNC, parameters)"
    return first_of(
        "replies",
        (answers, "the autopilot answers what is sent to it"),
        (
            isinstance(parse_url(link.url), SerialUrl),
            deaf,
            "check the wire from this computer's TX to the autopilot's RX, and flow control if RTS and CTS are open",
        ),
        (True, deaf, "let the router pass messages on to the autopilot; check firewalls"),
    )


def _temperature(source: MavlinkSource, client: ParameterClient) -> Finding:
    step, message = "thermometer", client.messages.get(source.message)
    if message is None:
        text = f"the autopilot does not send {source.message}"
        return wrong(step, text, "does it have that sensor? Otherwise take it out of temperature.sources")
    value_c = getattr(message, source.field) * MAVLINK_FIELDS[source.message, source.field].c_per_unit
    air_c = value_c - source.bias_c
    text = f"{source.name} says {value_c:.1f} C, less bias_c {air_c:.1f} C"
    is_absent = source.field == "temperature_press_diff" and value_c == 0
    return first_of(
        step,
        (is_absent, f"{source.name} is 0: there is no airspeed sensor", "take it out of temperature.sources"),
        (not COLDEST_C <= air_c <= HOTTEST_C, text, "check bias_c"),
        (True, text),
    )


def check_parameters(airframe: Airframe, client: ParameterClient, firmware: Firmware) -> Finding:
    """Whether the autopilot's parameters are those that the airframe needs, but for those of the port."""
    without = (*PORT_NAMES, ADDRESS) if firmware.any_id else PORT_NAMES
    needed = [setting for setting in settings(airframe, firmware, 2) if not setting.name.startswith(without)]
    others = differences(client, needed)
    return first_of(
        "parameters",
        (
            others,
            f"{len(others)} of {len(needed)} differ: {'; '.join(described(other) for other in others)}",
            f"msp-range params {airframe.path} --write",
        ),
        (True, f"{len(needed)} of {firmware} are as they should be"),
    )


def _withheld(client: ParameterClient) -> Finding:
    text = "the airframe file sends nothing"
    waits = client.autopilot == "ardupilot" and client.read("RNGFND1_TYPE") == DISTANCE_SENSOR_BY_MAVLINK
    return first_of(
        "distances",
        (
            waits,
            f"{text}. {UNARMED}",
            "set it to 0 (none), or to the vehicle's own range finder, until distances are sent",
        ),
        (True, f"{text}: not tried", "take nothing out of its send to try it", UNKNOWN),
    )


def _distances(airframe: Airframe, client: ParameterClient, clock: Clock, ranges_m: Mapping[str, float]) -> Finding:
    step, stream = "distances", downward_stream(airframe)
    downward = airframe.downward or [sensor for sensor in airframe.sensors if sensor.orientation.value == DOWN]
    measured = sorted(ranges_m[sensor.name] for sensor in downward if sensor.name in ranges_m)
    if stream is None:
        return unknown(step, "nothing looks down: what the autopilot makes of the others is not tried")
    if not measured:
        return unknown(step, "not tried: no downward sensor has a distance", "first let the sensors see something")
    range_m = measured[len(measured) // 2]
    back: Any = None
    client.messages.pop("DISTANCE_SENSOR", None)
    end_s = clock.now() + SENT_S
    while clock.now() < end_s:
        if client.armed is not False:
            return unknown(step, "the vehicle was armed meanwhile", "disarm it and try again")
        boot_ms = client.link.autopilot_clock.time_boot_ms(clock.now())
        client.link.send(distance_sensor(stream, boot_ms, range_m, 0.0004, field_of_view_rad=0.4, quality=100))
        client.wait(lambda: False, SENT_INTERVAL_S)
        newest = client.messages.pop("DISTANCE_SENSOR", None)
        if newest is not None and is_first(back, newest):
            back = newest
    status = client.messages.get("SYS_STATUS")
    sent = f"{range_m:.2f} m was sent, and the autopilot"
    remedy = f"msp-range params {airframe.path} --write, then restart the autopilot: the type counts from then on"
    if back is None:
        why = not_received(airframe.link.autopilot, status)
        return wrong(step, f"{sent} reports no distance of its own{'' if why is None else f': {why}'}", remedy)
    back_m = back.current_distance / 100
    is_other = back.orientation != DOWN or abs(back_m - range_m) > RETURNED_M
    is_unhealthy = status is not None and not is_healthy(status)
    return first_of(
        step,
        (is_other, f"{sent} has {back_m:.2f} m", OTHER_FIRST),
        (is_unhealthy, f"the autopilot has {back_m:.2f} m and calls its range finder unhealthy", remedy),
        (True, f"{sent} has {back_m:.2f} m"),
    )


def _latency(client: ParameterClient, latency_s: float) -> Finding:
    step, answer = "latency", f"echo to answer {1e3 * latency_s:.0f} ms"
    round_trip_s = client.link.autopilot_clock.round_trip_s
    if round_trip_s is None:
        remedy = "it does not answer TIMESYNC; messages are stamped by SYSTEM_TIME"
        return unknown(step, f"{answer}, and the way to the autopilot unknown", remedy)
    total_ms = 1e3 * (latency_s + round_trip_s / 2)
    total, parts = f"{total_ms:.0f} ms", f"{answer}, to the autopilot {500 * round_trip_s:.1f} ms"
    if client.autopilot != "px4":
        return right(step, f"{total}: {parts}")
    delay_ms = client.read(DELAY)
    is_off = delay_ms is not None and abs(delay_ms - total_ms) > DELAY_MS
    return first_of(
        step,
        (is_off, f"{total} ({parts}), and {DELAY} is {delay_ms or 0:g}", f"set it to {total_ms:.0f}"),
        (True, f"{total}: {parts}; {DELAY} is {delay_ms or 0:g}"),
    )
