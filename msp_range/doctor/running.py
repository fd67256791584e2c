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
    with connection:
        newest = read_once(connection)
    if not newest.status:
        yield unknown("running bridge", "it ended while it was asked", "msp-range doctor once more")
        return
    yield from findings(newest)


def findings(newest: Newest) -> Iterator[Finding]:
    """What its newest state means."""
    status = newest.status
    yield right("running bridge", f"{newest.airframe['vehicle']}, {status['state']}, for {status['uptime_s']:.0f} s")
    for fault in status["faults"]:
        # That the file names no thermometer is a step of its own.
        if NO_THERMOMETER not in fault["text"]:
            found = unknown if fault["severity"] == "info" else wrong
            yield found(fault["what"], fault["text"], fault["remedy"])
    for name, sensor in status["sensors"].items():
        if sensor["fault"] is not None:
            continue
        if sensor["readings"] == 0:
            yield unknown(f"sensor {name}", "no reading yet", "msp-range doctor once more")
        else:
            corrected_m = newest.readings.get(name, {}).get("corrected_m")
            now = "no echo now" if corrected_m is None else f"{corrected_m:.2f} m now"
            rejected = sum(sensor["rejected"].values())
            yield right(f"sensor {name}", f"{now}; {rejected} of {sensor['readings']} readings were not used")
    link = status["link"]
    sent = link["sent"].get("DISTANCE_SENSOR", 0)
    if link["autopilot"] is not None:
        yield right("autopilot", f"system {link['autopilot']} is received; {sent} distances were sent")
    elif not any(each["what"] == "autopilot" for each in status["faults"]):
        yield unknown("autopilot", f"{link['url']}: no heartbeat yet", "msp-range doctor once more")
