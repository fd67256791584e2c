"""A bridge that runs, seen through its own socket: bus and port are its own, and are left alone."""

from collections.abc import Iterator

from msp_range.correction.air_temperature import NO_THERMOMETER
from msp_range.doctor.finding import Finding, right, unknown, wrong
from msp_range.watch.client import connect, read_once
from msp_range.watch.newest import Newest
from msp_range.watch.place import sockets

STOP = "sudo systemctl stop msp-range, then again, looks at bus and port themselves"


def check_running() -> Iterator[Finding]:
    """What the running bridge says of its sensors, its link and its recording."""
    connection = connect(sockets())
    if connection is None:
        yield unknown("running bridge", "it cannot be asked: no socket of it was found", STOP)
        return
    newest = Newest()
    with connection:
        for packet in read_once(connection):
            newest.update(packet)
    if not newest.status:
        yield unknown("running bridge", "it ended while it was asked", "msp-range doctor once more")
        return
    yield from findings(newest)


def findings(newest: Newest) -> Iterator[Finding]:
    """What its newest state means."""
    status = newest.status
    yield right("running bridge", f"{newest.airframe['vehicle']}, {status['state']}, for {status['uptime_s']:.0f} s")
    for name, sensor in status["sensors"].items():
        if sensor["fault"] is not None:
            yield wrong(f"sensor {name}", sensor["fault"], STOP)
        elif sensor["readings"] == 0:
            yield unknown(f"sensor {name}", "no reading yet", "msp-range doctor once more")
        else:
            corrected_m = newest.readings.get(name, {}).get("corrected_m")
            now = "no echo now" if corrected_m is None else f"{corrected_m:.2f} m now"
            rejected = sum(sensor["rejected"].values())
            yield right(f"sensor {name}", f"{now}; {rejected} of {sensor['readings']} readings were not used")
    link = status["link"]
    if not link["connected"]:
        yield wrong("link", f"{link['url']}: {link['error'] or 'nobody is there'}", STOP)
    elif link["autopilot"] is None:
        yield wrong("autopilot", f"{link['url']}: no heartbeat is received", STOP)
    else:
        sent = link["sent"].get("DISTANCE_SENSOR", 0)
        yield right("autopilot", f"system {link['autopilot']} is received; {sent} distances were sent")
    for fault in status["faults"]:
        # A sensor's own are above, and that the file names no thermometer is a step of its own.
        known = [NO_THERMOMETER, *(each["fault"] for each in status["sensors"].values() if each["fault"] is not None)]
        if not any(each in fault["text"] for each in known):
            yield wrong("reported to the pilot", fault["text"], "docs/flying.md explains the texts")
