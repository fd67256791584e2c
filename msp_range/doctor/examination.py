"""The order of the steps, from the bus to the autopilot; what an earlier step makes impossible is left out.

Bus and serial port are not touched while a bridge runs; its state is read from its socket.
"""

import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from socket import socket

from msp_range.bus.smbus import BusInUse, KernelBus
from msp_range.clock import Clock
from msp_range.config import Airframe, load_airframe
from msp_range.doctor.autopilot import check_autopilot
from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import UNKNOWN, Finding, first_of, right, unknown, while_right, wrong
from msp_range.doctor.heights import check_before_flight, maximum_of
from msp_range.doctor.port import check_clock, check_interface, check_port
from msp_range.doctor.sensors import SensorExamination, examine_sensors, glance_at_sensors
from msp_range.doctor.storage import check_date, check_disk, check_supply
from msp_range.doctor.thermometer import check_files
from msp_range.health import BridgeState
from msp_range.mavlink.transport import Transport, open_transport
from msp_range.mavlink.transport.url import SerialUrl, parse_url
from msp_range.pilot_texts import Text
from msp_range.plausible import doubts
from msp_range.state_folder import CHOOSE_AIRFRAME
from msp_range.watch.client import connect, read_once
from msp_range.watch.newest import Newest
from msp_range.watch.place import sockets
from msp_range.watch.view import airframe_message
from msp_range.yaml_file import ConfigError

STOP = "stop it (sudo systemctl stop msp-range), then again: bus and port are examined themselves then"


PREFLIGHT_S = 4.0
"""Time for a preflight [s]: with the start of the program the answer is there within 5 s. Less leaves out waypoints of
long missions, and the autopilot's parameters where the link is slow."""


def check_running(connection: socket | None, airframe: Airframe) -> Iterator[Finding]:
    """The running bridge's report on its sensors, its link and its recording, and whether it flies this airframe."""
    if connection is None:
        yield unknown("running bridge", "it cannot be asked: no socket of it was found", STOP)
        return
    with connection:
        newest = read_once(connection)
    if not newest.status:
        yield unknown("running bridge", "it does not answer, or ended while it was asked", "msp-range doctor once more")
        return
    # The link may be one of the command line.
    if newest.airframe | {"link": ""} != json.loads(json.dumps(airframe_message(airframe) | {"link": ""})):
        text = f"it flies another airframe, or another version of this one: {newest.airframe['vehicle']}"
        yield wrong("running bridge", text, "name its file, or let it read this one: sudo systemctl restart msp-range")
    yield from findings(newest)


def findings(newest: Newest) -> Iterator[Finding]:
    """Findings from the newest state of a running bridge."""
    status = newest.status
    text = f"{newest.airframe['vehicle']}, {status['state']}, for {status['uptime_s']:.0f} s"
    starts = newest.state == BridgeState.STARTING
    yield first_of("running bridge", (starts, text, "again in some seconds", UNKNOWN), (True, text))
    for fault in status["faults"]:
        # That the file names no thermometer is a step of its own.
        if fault["what"] != Text.NO_THERMOMETER.key:
            found = unknown if fault["severity"] == "info" else wrong
            yield found(fault["what"], fault["text"], fault["remedy"])
    for name, sensor in status["sensors"].items():
        if sensor["fault"] is not None:
            continue
        corrected_m, readings = newest.readings.get(name, {}).get("corrected_m"), sensor["readings"]
        now = "no echo now" if corrected_m is None else f"{corrected_m:.2f} m now"
        yield first_of(
            f"sensor {name}",
            (readings == 0, "no reading yet", "msp-range doctor once more", UNKNOWN),
            (True, f"{now}; {sum(sensor['rejected'].values())} of {readings} readings were not used"),
        )
    link = status["link"]
    sent = link["sent"].get("DISTANCE_SENSOR", 0)
    if link["autopilot"] is not None:
        yield right("autopilot", f"system {link['autopilot']} is received; {sent} distances were sent")
    elif not any(fault["what"] == "autopilot" for fault in status["faults"]):
        yield unknown("autopilot", f"{link['url']}: no heartbeat yet", "msp-range doctor once more")


def examine(
    path: Path,
    computer: Computer,
    clock: Clock,
    make_bus: Callable[[int | str], KernelBus] = KernelBus,
    make_transport: Callable[[str, Clock], Transport] = open_transport,
    preflight: bool = False,
) -> Iterator[Finding]:
    """All steps, each as soon as it is done.

    Parameters
    ----------
    path
        The airframe file.
    computer
        Whose files are looked at.
    clock
        Times of pings and messages.
    make_bus, make_transport
        Open what the airframe file names.
    preflight
        Only what is done in `PREFLIGHT_S`, and the autopilot's heights; a bridge that runs is asked at once.
    """
    end_s = clock.now() + PREFLIGHT_S if preflight else None
    try:
        airframe = load_airframe(path)
    except ConfigError as error:
        remedy = f"correct it; msp-range check {path} shows the rest"
        if not os.path.exists(path):
            remedy = f"name your airframe file: msp-range doctor AIRFRAME.yaml; that of the service: {CHOOSE_AIRFRAME}"
        yield wrong("airframe file", str(error), remedy)
        return
    yield right("airframe file", f"{path}: {airframe.vehicle}")
    for doubt in doubts(airframe):
        yield unknown("airframe file", doubt, "correct it if that is so")
    # Nothing but the I2C bus itself knows whether another program uses it.
    connection = connect(sockets()) if preflight or not airframe.on_i2c else None
    if connection is not None:
        yield from check_running(connection, airframe)
        if preflight and (maximum_m := maximum_of(airframe)) < math.inf:
            remedy = f"above {maximum_m:g} m distances read 'above the maximum': compare in the ground station"
            yield unknown("heights", "those of return and mission were not read, as the bridge has the link", remedy)
    else:
        yield from _bus_and_link(airframe, computer, clock, make_bus, make_transport, end_s)
    yield from check_files(computer, airframe.temperature)
    yield check_disk(computer, airframe.recording.folder if airframe.recording else None)
    yield check_date(computer, path)
    yield from check_supply(computer)


def _bus_and_link(
    airframe: Airframe,
    computer: Computer,
    clock: Clock,
    make_bus: Callable[[int | str], KernelBus],
    make_transport: Callable[[str, Clock], Transport],
    end_s: float | None,
) -> Iterator[Finding]:
    """The sensors and the autopilot; those of a preflight if it has to be done at ``end_s``."""
    examined = SensorExamination([], {}, None)
    bus_path = str(KernelBus(airframe.bus).path)
    is_ready = False
    for sensor in airframe.sensors:
        if isinstance(port := parse_url(sensor.shown_address) if sensor.driver.is_serial else None, SerialUrl):
            is_ready |= yield from while_right(check_port(computer, port))
    if airframe.on_i2c and (yield from while_right(check_interface(computer, bus_path))):
        is_ready = True
        if any(sensor.driver.stretches_clock for sensor in airframe.on_i2c):
            yield check_clock(computer, bus_path)
    if is_ready:
        with closing(make_bus(airframe.bus)) as bus:
            try:
                if airframe.on_i2c:
                    bus.claim()
            except BusInUse as error:
                remedy = "sudo systemctl stop msp-range, then again"
                yield unknown("I2C bus in use", f"{error}. Bus and port are left alone", remedy)
                yield from check_running(connect(sockets()), airframe)
                return
            examined = (examine_sensors if end_s is None else glance_at_sensors)(airframe, bus, clock)
            yield from examined.findings
    url = parse_url(airframe.link.url)
    if isinstance(url, SerialUrl) and not (yield from while_right(check_port(computer, url))):
        return
    with closing(make_transport(airframe.link.url, clock)) as transport:
        if end_s is not None:
            yield from check_before_flight(airframe, transport, clock, end_s)
        else:
            yield from check_autopilot(airframe, computer, transport, clock, examined.ranges_m, examined.latency_s)
