"""The autopilot at the other end: its heartbeat and type, its parameters, whether distances reach it, the latency.

Distances that the sensors have just measured are sent for some seconds, and only while the vehicle is disarmed.
"""

from collections.abc import Iterator, Mapping

from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, MAVLINK_FIELDS, MavlinkSource
from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import Finding, Verdict, right, unknown, wrong
from msp_range.doctor.port import check_holders
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import distance_sensor
from msp_range.mavlink.frames import Frame, FrameReader
from msp_range.mavlink.orientation import DOWN
from msp_range.mavlink.signing import PX4_SIGNS_NOT, signing_of
from msp_range.mavlink.transport import Transport, Wrapped, open_transport
from msp_range.mavlink.transport.url import NetworkUrl, SerialUrl, parse_url
from msp_range.params.client import ParameterClient
from msp_range.params.commands import described, differences
from msp_range.params.settings import (
    ADDRESS,
    DISTANCE_SENSOR_BY_MAVLINK,
    UNARMED,
    Firmware,
    downward_stream,
    settings,
)
from msp_range.yaml_file import ConfigError

CONNECT_S = 6.0
"""How long to wait for a heartbeat, which comes once a second; a link may have to be opened again [s]."""
SENT_S, SENT_INTERVAL_S = 4.0, 0.1
"""Distances are sent for this long at the bridge's rate [s]: ArduPilot wants three good ones in a row, and sends its
own once or twice a second until a faster rate is asked for."""
RETURNED_M = 0.10
"""What comes back may differ from what was sent by this [m]: both are whole centimetres."""
DELAY_MS = 25.0
"""EKF2_RNG_DELAY may be off by this [ms]: at 1 m/s it is 2.5 cm. From the ground to 6 m the latency itself grows by
18 ms, so less would call a good value wrong."""
PORT_NAMES = ("SERIAL", "MAV_", "SER_")
"""Beginnings of names of parameters of the port: messages arrive, so it is set up, whichever port it is."""
_EXISTS = {"ardupilot": "RNGFND1_TYPE", "px4": "EKF2_RNG_CTRL"}
"""A parameter that each autopilot has: it is asked for where TIMESYNC is not answered."""
LISTEN_S = 2.0
"""How long to listen for a program that sends to this computer, where nobody is at the address of the link [s]: an
autopilot sends a heartbeat once a second."""
FIELD_OF_VIEW_RAD = 0.4
QUALITY = 100


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
    temperatures = [each for each in airframe.temperature.sources if isinstance(each, MavlinkSource)]
    wanted = {each.message: 1.0 for each in temperatures} | {"DISTANCE_SENSOR": 5.0, "SYS_STATUS": 2.0}
    try:
        signing = signing_of(airframe.link.signing_key, clock)
    except ConfigError as error:
        yield wrong("signing", str(error), "msp-range sign AIRFRAME.yaml makes a key and gives it to the autopilot")
        return
    client = ParameterClient(tap, clock, airframe.link.system_id, wanted, signing)
    if not client.connect(CONNECT_S):
        yield silence(airframe, computer, tap, clock)
        return
    # Others that send on the link, and the messages asked for, need a moment.
    client.wait(lambda: False, 1.5)
    found = _type(airframe, client)
    yield found
    yield from _others(airframe, tap)
    yield from (_temperature(source, client) for source in temperatures)
    if found.verdict is not Verdict.RIGHT:
        return
    replies = _replies(airframe, tap, client)
    yield replies
    if replies.verdict is Verdict.WRONG:
        return
    if client.armed is not False:
        yield unknown("distances", "the vehicle is armed: nothing is sent", "disarm it and try again")
        return
    firmware = client.firmware()
    assert firmware is not None
    if airframe.send.nothing:
        yield _withheld(client)
    else:
        yield _parameters(airframe, client, firmware)
        yield _distances(airframe, client, clock, ranges_m)
    if latency_s is not None:
        yield _latency(client, latency_s)


def silence(airframe: Airframe, computer: Computer, tap: Tap, clock: Clock) -> Finding:
    """Why no heartbeat of the autopilot came, and what to do."""
    step = "heartbeat"
    autopilot = "SERIALn_PROTOCOL 2" if airframe.link.autopilot == "ardupilot" else "MAV_n_CONFIG and MAV_n_MODE 2"
    in_use = None if tap.received_bytes else check_holders(computer, parse_url(tap.description))
    if in_use is not None:
        return in_use
    if tap.last_error and not tap.connected:
        remedy = "check link.url, and what else uses it: sudo systemctl stop msp-range if the service runs"
        return wrong(step, f"the link cannot be opened: {tap.last_error}", remedy)
    autopilots = {frame.system for frame in tap.frames if frame.is_autopilot_heartbeat}
    if autopilots and airframe.link.signing_key is not None:
        text = f"system {sorted(autopilots)} is received, and not signed with the key {airframe.link.signing_key}"
        remedy = "msp-range sign AIRFRAME.yaml gives the autopilot the key"
        return wrong(step, text, PX4_SIGNS_NOT if airframe.link.autopilot == "px4" else remedy)
    if autopilots:
        text = f"link.system_id is {airframe.link.system_id}, and the autopilot received is {sorted(autopilots)}"
        return wrong(step, text, "correct link.system_id, or leave it out")
    if tap.frames:
        senders = sorted({(frame.system, frame.component) for frame in tap.frames})
        listed = ", ".join(f"{system}/{component}" for system, component in senders)
        remedy = "connect the bridge to a port of the autopilot, or let the router pass its messages on"
        return wrong(step, f"MAVLink comes from {listed} only, which is no autopilot", remedy)
    url = parse_url(tap.description)
    if tap.received_bytes:
        rate = f", not {url.baud} baud" if isinstance(url, SerialUrl) else ""
        remedy = f"set the same baud rate on both sides, and {autopilot} on the autopilot's port"
        return wrong(step, f"{tap.received_bytes} bytes arrive, and none are MAVLink{rate}", remedy)
    if isinstance(url, SerialUrl):
        remedy = f"exchange TX and RX, connect ground, switch the autopilot on, and set {autopilot} on its port"
        return wrong(step, f"nothing arrives at {url.path}", remedy)
    return _silent_network(url, tap, clock)


def _silent_network(url: NetworkUrl, tap: Tap, clock: Clock) -> Finding:
    """What to do where an address is silent: one side of a UDP link sends first, and the other one listens."""
    step, text = "heartbeat", f"nothing arrives by {url}"
    if url.kind == "udpin":
        remedy = "check that the other side sends to this computer's address and this port, and firewalls"
        return wrong(step, text, f"{remedy}; where it listens, too: udpout:HOST:PORT")
    if url.kind != "udpout":
        return wrong(step, text, "check address, port and firewall, and that the autopilot sends there")
    here = f"udpin:0.0.0.0:{url.port}"
    systems = _systems_at(here, clock)
    if systems:
        text += f", and system {systems} sends to port {url.port} of this computer, where nobody listens"
        return wrong(step, text, f"link.url: {here}")
    if tap.stats.refused:
        text += ": nobody listens there"
    remedy = "check address, port and firewall, and that the other side listens there"
    return wrong(step, text, f"{remedy}; where it sends to this computer instead: {here}")


def _systems_at(url: str, clock: Clock) -> list[int]:
    """Systems whose messages arrive at a port of this computer; none where another program listens there."""
    transport = open_transport(url, clock)
    tap = Tap(transport)
    try:
        end_s = clock.now() + LISTEN_S
        while not tap.frames and clock.now() < end_s:
            tap.receive()
            clock.sleep_until(clock.now() + SENT_INTERVAL_S)
    finally:
        transport.close()
    return sorted({frame.system for frame in tap.frames})


def _type(airframe: Airframe, client: ParameterClient) -> Finding:
    step = "heartbeat"
    name = {"ardupilot": "ArduPilot", "px4": "PX4", None: "neither ArduPilot nor PX4"}[client.autopilot]
    text = f"system {client.link.autopilot_system} is {name}"
    if client.autopilot != airframe.link.autopilot:
        return wrong(step, f"{text}, and link.autopilot is {airframe.link.autopilot}", "correct link.autopilot")
    return right(step, text)


def _others(airframe: Airframe, tap: Tap) -> Iterator[Finding]:
    autopilots = sorted({frame.system for frame in tap.frames if frame.is_autopilot_heartbeat})
    if len(autopilots) > 1 and airframe.link.system_id is None:
        text = f"heartbeats of several autopilots: systems {', '.join(map(str, autopilots))}"
        yield wrong("other autopilots", text, "state the vehicle's own as link.system_id")
    bridge = airframe.link.component_id
    if any(frame.component == bridge and frame.system in autopilots for frame in tap.frames):
        text = f"another program already sends as component {bridge}"
        yield wrong("component id", text, "stop it (is the bridge running?), or change link.component_id")


def _replies(airframe: Airframe, tap: Tap, client: ParameterClient) -> Finding:
    """Whether the autopilot receives what is sent to it: heartbeats show the other direction only."""
    name = _EXISTS[airframe.link.autopilot]
    answers = client.link.autopilot_clock.round_trip_s is not None or client.read(name) is not None
    if airframe.link.signing_key is None and any(frame.is_signed for frame in tap.frames):
        if answers:
            text = "the autopilot signs its messages, and answers unsigned ones on this port, as ArduPilot does by USB"
            return unknown("signing", text, "for another port give both the same key: msp-range sign")
        text = "the autopilot signs its messages and drops those of the bridge, which has no key"
        return wrong("signing", text, "give both the same key: msp-range sign; or clear it in the ground station")
    if answers:
        return right("replies", "the autopilot answers what is sent to it")
    text = "the autopilot is received, and answers nothing that is sent to it (TIMESYNC, parameters)"
    if isinstance(parse_url(airframe.link.url), SerialUrl):
        remedy = (
            "check the wire from this computer's TX to the autopilot's RX, and flow control if RTS and CTS are open"
        )
    else:
        remedy = "let the router pass messages on to the autopilot; check firewalls"
    return wrong("replies", text, remedy)


def _temperature(source: MavlinkSource, client: ParameterClient) -> Finding:
    step = "thermometer"
    message = client.messages.get(source.message)
    if message is None:
        text = f"the autopilot does not send {source.message}"
        return wrong(step, text, "does it have that sensor? Otherwise take it out of temperature.sources")
    value_c = getattr(message, source.field) * MAVLINK_FIELDS[source.message, source.field].c_per_unit
    if source.field == "temperature_press_diff" and value_c == 0:
        return wrong(step, f"{source.name} is 0: there is no airspeed sensor", "take it out of temperature.sources")
    air_c = value_c - source.bias_c
    if not COLDEST_C <= air_c <= HOTTEST_C:
        return wrong(step, f"{source.name} says {value_c:.1f} C, less bias_c {air_c:.1f} C", "check bias_c")
    return right(step, f"{source.name} says {value_c:.1f} C, less bias_c {air_c:.1f} C")


def _parameters(airframe: Airframe, client: ParameterClient, firmware: Firmware) -> Finding:
    step = "parameters"
    without = (*PORT_NAMES, ADDRESS) if firmware.any_id else PORT_NAMES
    needed = [each for each in settings(airframe, firmware, 2) if not each.name.startswith(without)]
    others = differences(client, needed)
    if others:
        listed = "; ".join(described(each) for each in others)
        return wrong(step, f"{len(others)} of {len(needed)} differ: {listed}", "msp-range params AIRFRAME.yaml --write")
    return right(step, f"{len(needed)} of {firmware} are as they should be")


def _withheld(client: ParameterClient) -> Finding:
    step = "distances"
    if client.autopilot == "ardupilot" and client.read("RNGFND1_TYPE") == DISTANCE_SENSOR_BY_MAVLINK:
        remedy = "set it to 0 (none), or to the vehicle's own range finder, until distances are sent"
        return wrong(step, f"the airframe file sends nothing. {UNARMED}", remedy)
    return unknown(step, "the airframe file sends nothing: not tried", "take nothing out of its send to try it")


def _distances(airframe: Airframe, client: ParameterClient, clock: Clock, ranges_m: Mapping[str, float]) -> Finding:
    step = "distances"
    stream = downward_stream(airframe)
    downward = {each.name for each in airframe.downward} or {
        each.name for each in airframe.sensors if each.orientation.value == DOWN
    }
    measured = [range_m for name, range_m in ranges_m.items() if name in downward]
    if stream is None:
        return unknown(step, "nothing looks down: what the autopilot makes of the others is not tried")
    if not measured:
        return unknown(step, "not tried: no downward sensor has a distance", "first let the sensors see something")
    range_m = sorted(measured)[len(measured) // 2]
    client.messages.pop("DISTANCE_SENSOR", None)
    end_s = clock.now() + SENT_S
    while clock.now() < end_s:
        if client.armed is not False:
            return unknown(step, "the vehicle was armed meanwhile", "disarm it and try again")
        boot_ms = client.link.autopilot_clock.time_boot_ms(clock.now())
        client.link.send(distance_sensor(stream, boot_ms, range_m, 0.0004, FIELD_OF_VIEW_RAD, QUALITY))
        client.wait(lambda: False, SENT_INTERVAL_S)
    back = client.messages.get("DISTANCE_SENSOR")
    status = client.messages.get("SYS_STATUS")
    remedy = "msp-range params AIRFRAME.yaml --write, then restart the autopilot: the type counts from then on"
    if back is None:
        return wrong(step, f"{range_m:.2f} m was sent, and the autopilot reports no distance of its own", remedy)
    back_m = back.current_distance / 100
    if back.orientation != DOWN or abs(back_m - range_m) > RETURNED_M:
        remedy = "is another range finder set up as the first one? See RNGFND1_TYPE, RNGFND1_ORIENT"
        return wrong(step, f"{range_m:.2f} m was sent, and the autopilot has {back_m:.2f} m", remedy)
    bit = dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION
    if status is not None and bit & status.onboard_control_sensors_present & ~status.onboard_control_sensors_health:
        return wrong(step, f"the autopilot has {back_m:.2f} m and calls its range finder unhealthy", remedy)
    return right(step, f"{range_m:.2f} m was sent, and the autopilot has {back_m:.2f} m")


def _latency(client: ParameterClient, latency_s: float) -> Finding:
    step = "latency"
    round_trip_s = client.link.autopilot_clock.round_trip_s
    if round_trip_s is None:
        remedy = "it does not answer TIMESYNC; messages are stamped by SYSTEM_TIME"
        return unknown(step, f"echo to answer {1e3 * latency_s:.0f} ms, and the way to the autopilot unknown", remedy)
    total_ms = 1e3 * (latency_s + round_trip_s / 2)
    parts = f"echo to answer {1e3 * latency_s:.0f} ms, to the autopilot {500 * round_trip_s:.1f} ms"
    if client.autopilot != "px4":
        return right(step, f"{total_ms:.0f} ms: {parts}")
    delay_ms = client.read("EKF2_RNG_DELAY")
    if delay_ms is not None and abs(delay_ms - total_ms) > DELAY_MS:
        return wrong(
            step, f"{total_ms:.0f} ms ({parts}), and EKF2_RNG_DELAY is {delay_ms:g}", f"set it to {total_ms:.0f}"
        )
    return right(step, f"{total_ms:.0f} ms: {parts}; EKF2_RNG_DELAY is {delay_ms or 0:g}")
