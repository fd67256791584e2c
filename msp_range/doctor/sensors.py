"""Who answers on the bus, what each sensor reads, and whether neighbours disturb each other.

The bridge's own `Poller` pings them, in turns that are made for the question.
"""

import errno
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from math import cos, inf
from statistics import median
from typing import NamedTuple

from msp_range.assembly import polled_sensors
from msp_range.bus import Address, Bus, BusError, shown
from msp_range.clock import Clock
from msp_range.config import Airframe, SensorSettings
from msp_range.doctor.finding import UNKNOWN, WRONG, Finding, first_of, right, unknown, wrong
from msp_range.reading import Reading, Status
from msp_range.sensors.addressing import FIRST_ADDRESS, LAST_ADDRESS, scan
from msp_range.sensors.base import OTHERS
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import PolledSensor, RoundRobin

READINGS = 5
"""Readings of each sensor: enough for a median and for a fault of one in three to be seen in 87 %; more take longer."""
SILENCE_S = 0.25
"""Before each ping of a sensor alone, from the last one's deadline [s]: an echo has died away after some 100 ms, in a
hall after twice that."""
MOST_LATE = 20
"""So many answers that a busy computer reads too late are asked for again: with each sensor's readings some 10 s more.
Fewer ask the user to try again where one more turn would do."""
DISTURBED_M, DISTURBED_SHARE = 0.10, 0.05
"""A sensor whose median changes by more than this while others ping hears them [m, share of the range]. A hand-held
vehicle moves by some centimetres meanwhile; a neighbour's echo is off by decimetres."""
UNEVEN_M, UNEVEN_SHARE = 0.30, 0.20
"""A downward sensor whose height differs by more than this from the middle one [m, share of the height] is reported:
the vehicle is examined on the ground or in the hands, and a leg in the beam is nearer by more."""
GLANCES = 2
"""Readings of each sensor before a flight, in the polling order: one alone may be the outlier that is usual. More take
longer: 0.4 s a turn of four."""
SCATTER_M = 0.30
"""Readings that lie further apart [m] are reported: a still sensor scatters by 1 to 3 cm."""


class SensorExamination(NamedTuple):
    """Findings about the sensors, and their answers."""

    findings: list[Finding]
    """A finding for each step."""
    ranges_m: dict[str, float]
    """Median distance of the sensors that have one, by name [m]."""
    latency_s: float | None
    """Shortest time from an echo to its answer [s]; None where there was none. A busy computer adds to the others."""


def examine_sensors(airframe: Airframe, bus: Bus, clock: Clock) -> SensorExamination:
    """Make all checks of the sensors on the bus. Takes some 2 s for each sensor."""
    findings, present = _addresses(airframe, bus, clock)
    polled = polled_sensors(airframe, bus)
    alone: dict[str, list[Ranging]] = {}
    for sensor in present:
        rangings = _alone(polled[sensor.name], bus, clock, READINGS)
        # Clock faults now and then would look like two sensors with different answers.
        clock_faults = sum(ranging.reading.status is Status.CLOCK_FAULT for ranging in rangings)
        stranger = _recognised(sensor, bus, clock) if clock_faults in (0, READINGS) else None
        if stranger is None:
            alone[sensor.name] = rangings
        findings.append(stranger or _readings(sensor, rangings))
    if len(alone) > 1:
        findings.append(_crosstalk(airframe, polled, bus, clock, alone))
    ranges_m = {name: median(ranges) for name, rangings in alone.items() if (ranges := _ranges(rangings))}
    findings += disagreeing(airframe, ranges_m)
    answered = [ranging for rangings in alone.values() for ranging in rangings if ranging.reading.range_m is not None]
    return SensorExamination(
        findings, ranges_m, min([ranging.answered_s - ranging.reading.time_s for ranging in answered], default=None)
    )


def glance_at_sensors(airframe: Airframe, bus: Bus, clock: Clock) -> SensorExamination:
    """Whether all sensors are there and read, in their polling order. Takes a second with four sensors."""
    findings, present = _addresses(airframe, bus, clock)
    if not present:
        return SensorExamination(findings, {}, None)
    found = _in_turn(airframe, polled_sensors(airframe, bus), bus, clock, [each.name for each in present], GLANCES)
    findings += [_readings(sensor, found[sensor.name]) for sensor in present]
    ranges_m = {name: median(ranges) for name, rangings in found.items() if (ranges := _ranges(rangings))}
    return SensorExamination([*findings, *disagreeing(airframe, ranges_m)], ranges_m, None)


def _addresses(airframe: Airframe, bus: Bus, clock: Clock) -> tuple[list[Finding], list[SensorSettings]]:
    step = "addresses"
    sensors, on_ports = airframe.on_i2c, [sensor for sensor in airframe.sensors if sensor.driver.is_serial]
    if not sensors:
        return [], on_ports
    try:
        found = [device.address for device in scan(bus, clock, identify=False)]
    except BusError as error:
        held = f"the bus does not move (errno {error.errno}): SDA or SCL is held low"
        remedy = "find the device that holds it: disconnect one after the other; check for a short and for pull-ups"
        locked_up = error.locked_up, held, remedy
        return [first_of(step, locked_up, (True, str(error), "check the adapter and its cable"))], on_ports
    present = [sensor for sensor in sensors if sensor.address in found]
    others = [address for address in found if address not in {sensor.address for sensor in sensors}]
    listed = ", ".join(f"{each.name} answers at {_both(each.address)}" for each in present)
    every = len(found) == LAST_ADDRESS - FIRST_ADDRESS + 1
    answers = first_of(
        step,
        (
            every,
            "every address acknowledges: the data line SDA is held low",
            "check SDA for a short to ground, and each sensor's wires",
        ),
        (
            not found,
            "nothing answers on the bus",
            "check the sensors' power, ground, SDA and SCL (exchanged?), and the pull-ups",
        ),
        (True, listed),
    )
    if answers.verdict is WRONG:
        return [answers], on_ports
    findings = [answers] if present else []
    names: dict[Address, str] = {sensor.address: sensor.name for sensor in present}
    findings += [_absent(sensor, others, names) for sensor in sensors if sensor not in present]
    if others:
        listed = "; ".join(
            f"{_both(other)} {f'({OTHERS[other]})' if other in OTHERS else ''}".strip() for other in others
        )
        findings.append(right("other devices", f"the airframe file does not name {listed}"))
    return findings, present + on_ports


def _absent(sensor: SensorSettings, others: Sequence[int], present: Mapping[Address, str]) -> Finding:
    text, factory = f"nothing answers at {_both(sensor.address)}", sensor.driver.default_address
    move = f"msp-range address 0x{factory:02x} {sensor.shown_address}"
    return first_of(
        f"address of {sensor.name}",
        (
            factory in others,
            f"{text}, and something does at {_both(factory)}, the address from the factory",
            f"if that is it, connected alone: {move}",
        ),
        (
            others,
            f"{text}; the file does not name {', '.join(_both(other) for other in others)}",
            "is one of these it? 'msp-range scan --ping' shows",
        ),
        (
            factory in present,
            text,
            f"check its power and wires; as it was delivered it is at 0x{factory:02x}, together with "
            f"{present.get(factory)}, and they look like one: then connect it alone, and {move}",
        ),
        (True, text, "check its power and wires"),
    )


def _both(address: Address) -> str:
    """An address in the form of this project, and in that of some data sheets."""
    return shown(address) if isinstance(address, str) else f"0x{address:02x} (0x{address << 1:02X} in the 8-bit form)"


def _recognised(sensor: SensorSettings, bus: Bus, clock: Clock) -> Finding | None:
    """What is wrong where the device is not the sensor that it should be, or is two."""
    if isinstance(sensor.address, str):
        return None
    try:
        found = sensor.driver.identify(bus, clock, sensor.address)
    except BusError as error:
        return wrong(f"sensor {sensor.name}", str(error), "check its wires")
    if found.ranged or not any(each in found.answer for each in ("two sensors", "not an")):
        return None
    return wrong(
        f"sensor {sensor.name}",
        f"{sensor.shown_address}: {found.answer}",
        "connect one at a time, and give each an address of its own: msp-range address",
    )


def _alone(sensor: PolledSensor, bus: Bus, clock: Clock, turns: int) -> list[Ranging]:
    """What a sensor answers while no other one pings."""
    return _polled(bus, clock, [[sensor]], sensor.timing.deadline_s + SILENCE_S, turns)[sensor.name]


def _polled(
    bus: Bus, clock: Clock, groups: Sequence[Sequence[PolledSensor]], interval_s: float, turns: int
) -> dict[str, list[Ranging]]:
    """The answers of each sensor in this number of turns of all groups, by name."""
    order = RoundRobin(groups, interval_s, clock.now() + SILENCE_S, dead_after=inf)
    poller = Poller(bus, clock, order)
    found: dict[str, list[Ranging]] = {sensor.name: [] for group in groups for sensor in group}
    late = 0
    while any(len(each) < turns for each in found.values()):
        clock.sleep_until(poller.next_event_s)
        for ranging in poller.step():
            if _is_late(ranging) and late < MOST_LATE:
                late += 1
            else:
                found[ranging.reading.sensor].append(ranging)
    return found


def _is_late(ranging: Ranging) -> bool:
    """Whether the answer was not read in time, since the computer was busy."""
    return ranging.error is not None and ranging.error.errno == errno.ETIME


def _ranges(rangings: Sequence[Ranging]) -> list[float]:
    return [ranging.reading.range_m for ranging in rangings if ranging.reading.range_m is not None]


def _readings(sensor: SensorSettings, rangings: Sequence[Ranging]) -> Finding:
    readings = [ranging.reading for ranging in rangings]
    statuses = Counter(reading.status for reading in readings)
    missed, impossible = statuses[Status.NO_ANSWER], statuses[Status.IMPOSSIBLE] + statuses[Status.PART_INFO]
    suspect = any(reading.suspect for reading in readings)
    ranges = _ranges(rangings)
    apart_m = max(ranges, default=0.0) - min(ranges, default=0.0)
    after_ms = 1e3 * median(ranging.answered_s - ranging.ping_s for ranging in rangings)
    shown = " ".join(map(_shown, readings))
    late = sum(map(_is_late, rangings))
    return first_of(
        f"readings of {sensor.name}",
        (
            late,
            f"{late} of {len(readings)} answers were read too late: the computer or the bus was busy",
            "end what keeps it busy, and try again",
            UNKNOWN,
        ),
        (
            missed,
            f"{missed} of {len(readings)} pings were not answered: {shown}",
            "check its supply (3.0-5.5 V, 100 ohm and 100 uF at the sensor) and its wires",
        ),
        (
            statuses[Status.CLOCK_FAULT],
            f"the clock is too fast for this sensor: {shown}",
            "slow the bus down: dtparam=i2c_arm=on,i2c_arm_baudrate=50000, or dtoverlay=i2c-gpio",
        ),
        # A busy computer takes one for another now and then.
        (
            impossible,
            f"answers that cannot be: {shown}",
            "check its supply for dips while it pings, and that no other program uses the bus",
            WRONG if impossible > 1 else UNKNOWN,
        ),
        (
            suspect and statuses[Status.NO_ECHO],
            f"'no echo' comes garbled: {shown}",
            "bytes are lost or mixed up: check wires, pull-ups and the bus clock",
        ),
        (not ranges, f"no echo: {shown}", "point it at a wall or floor 1 m away and try again", UNKNOWN),
        (
            apart_m > SCATTER_M,
            f"they lie {apart_m:.2f} m apart: {shown}",
            "hold it still and try again; then it is noise: supply, rotors, another ultrasonic sensor",
            UNKNOWN,
        ),
        (
            suspect,
            f"{shown}: also the value of a damaged 'no echo'",
            "move it: a reading that stays at this value is a damaged 'no echo'",
            UNKNOWN,
        ),
        (True, f"{shown} after {after_ms:.0f} ms"),
    )


def _shown(reading: Reading) -> str:
    if reading.range_m is not None:
        return f"{reading.range_m:.2f} m"
    return "-" if reading.status is Status.NO_ANSWER else reading.status.value.replace("_", " ")


def _in_turn(
    airframe: Airframe,
    polled: Mapping[str, PolledSensor],
    bus: Bus,
    clock: Clock,
    names: Collection[str],
    turns: int,
) -> dict[str, list[Ranging]]:
    """The answers of some sensors in the airframe's polling order."""
    groups = [[polled[name] for name in group if name in names] for group in airframe.polling_groups]
    return _polled(bus, clock, [*filter(None, groups)], airframe.polling_interval_s, turns)


def _crosstalk(
    airframe: Airframe, polled: Mapping[str, PolledSensor], bus: Bus, clock: Clock, alone: Mapping[str, list[Ranging]]
) -> Finding:
    """Compare what each reads alone with what it reads in the airframe's polling order."""
    together = _in_turn(airframe, polled, bus, clock, alone, READINGS + 1)
    disturbed, moved = [], []
    for name, rangings in alone.items():
        # Before the first turn there was no neighbour.
        before, in_turn = _ranges(rangings), _ranges(together[name][1:])
        if in_turn and not before:
            disturbed.append(f"{name} has no echo alone and {median(in_turn):.2f} m in turn")
        elif in_turn and _differs(median(in_turn), median(before)):
            again = _ranges(_alone(polled[name], bus, clock, 3))
            if again and not _differs(median(again), median(before)):
                disturbed.append(f"{name} reads {median(before):.2f} m alone and {median(in_turn):.2f} m in turn")
            else:
                moved.append(name)
    return first_of(
        "crosstalk",
        (
            disturbed,
            f"sensors disturb each other: {', '.join(disturbed)}",
            "raise polling.ping_interval_s, take sensors that disturb each other out of a group, or turn them outwards",
        ),
        (moved, f"{', '.join(moved)} moved meanwhile", "hold the vehicle still and try again", UNKNOWN),
        (True, "each reads alone as it does in turn with the others"),
    )


def disagreeing(airframe: Airframe, ranges_m: Mapping[str, float]) -> Iterator[Finding]:
    """Downward sensors whose height above the ground differs from that of the others, if there are at least three."""
    heights_m = {
        sensor.name: ranges_m[sensor.name] * cos(sensor.tilt_from_down_rad) + sensor.position_m[2]
        for sensor in airframe.downward
        if sensor.name in ranges_m
    }
    if len(heights_m) < 3:
        return
    middle_m = median(heights_m.values())
    for name, height_m in heights_m.items():
        if abs(height_m - middle_m) > max(UNEVEN_M, UNEVEN_SHARE * middle_m):
            text = f"{name} reads {ranges_m[name]:.2f} m, and the other downward sensors {middle_m:.2f} m"
            remedy = "above level ground: is a leg, a cable or the stand in its beam, or is it mounted at an angle?"
            yield unknown("agreement", text, remedy)


def _differs(one_m: float, other_m: float) -> bool:
    return abs(one_m - other_m) > max(DISTURBED_M, DISTURBED_SHARE * other_m)
