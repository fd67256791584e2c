"""Who answers on the bus, what each sensor reads, and whether neighbours disturb each other.

The bus is worked on as the bridge does it: the same drivers, timing and order.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import cos
from statistics import median
from typing import NamedTuple

from msp_range.assembly import polled_sensors, polling_groups, polling_interval_s
from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.config import Airframe, SensorSettings
from msp_range.doctor.finding import Finding, right, unknown, wrong
from msp_range.reading import Decoded, Status
from msp_range.sensors.addressing import FIRST_ADDRESS, LAST_ADDRESS, scan
from msp_range.sensors.base import OTHERS, POLL_INTERVAL_S
from msp_range.sensors.polling import reading_of
from msp_range.sensors.schedule import PolledSensor

READINGS = 5
"""Of each sensor: enough for a median and for a fault of one in three to be seen in 87 %. More takes longer."""
SILENCE_S = 0.25
"""Before each ping of a sensor alone [s]: an echo has died away after some 100 ms, in a hall after twice that."""
DISTURBED_M, DISTURBED_SHARE = 0.10, 0.05
"""A sensor whose median changes by more than this while others ping hears them [m, share of the range]. A hand-held
vehicle moves by some centimetres meanwhile; a neighbour's echo is off by decimetres."""
UNEVEN_M, UNEVEN_SHARE = 0.30, 0.20
"""A downward sensor whose height differs by more than this from the middle one [m, share of the height] is reported:
the vehicle is examined on the ground or in the hands, and a leg in the beam is nearer by more."""
SCATTER_M = 0.30
"""Readings that lie further apart [m] are reported: a still sensor scatters by 1 to 3 cm."""


class TimedPing(NamedTuple):
    """One ping: what it answered, None where it did not, and the times of answer and echo after the ping [s]."""

    decoded: Decoded | None
    answered_s: float
    echo_s: float

    @property
    def range_m(self) -> float | None:
        """The distance, where there is one [m]."""
        return None if self.decoded is None else self.decoded.range_m


class Looked(NamedTuple):
    """What the sensors answered."""

    findings: list[Finding]
    """A finding for each step."""
    ranges_m: dict[str, float]
    """Median distance of the sensors that have one, by name [m]."""
    latency_s: float | None
    """Shortest time from an echo to its answer [s]; None where there was none. A busy computer adds to the others."""


def look(airframe: Airframe, bus: Bus, clock: Clock) -> Looked:
    """All steps on the bus. Takes some 2 s for each sensor."""
    findings, present = _addresses(airframe, bus, clock)
    polled = polled_sensors(airframe, bus)
    alone: dict[str, list[TimedPing]] = {}
    for sensor in present:
        pings = [_ping(polled[sensor.name], clock, SILENCE_S) for _ in range(READINGS)]
        # Clock faults now and then would look like two sensors with different answers.
        if _count(pings, Status.CLOCK_FAULT) in (0, READINGS):
            finding = _recognised(sensor, bus, clock)
            if finding is not None:
                findings.append(finding)
                continue
        alone[sensor.name] = pings
        findings.append(_readings(sensor, pings))
    if len(alone) > 1:
        findings.append(_crosstalk(airframe, polled, clock, alone))
    ranges_m = {name: median(ranges) for name, pings in alone.items() if (ranges := _ranges(pings))}
    findings += disagreeing(airframe, ranges_m)
    delays_s = [each.answered_s - each.echo_s for pings in alone.values() for each in pings if each.range_m is not None]
    return Looked(
        findings,
        ranges_m,
        min(delays_s, default=None),
    )


def _addresses(airframe: Airframe, bus: Bus, clock: Clock) -> tuple[list[Finding], list[SensorSettings]]:
    step = "addresses"
    try:
        found = [each.address for each in scan(bus, clock, identify=False)]
    except BusError as error:
        if error.locked_up:
            remedy = "find the device that holds it: disconnect one after the other; check for a short and for pull-ups"
            return [wrong(step, f"the bus does not move (errno {error.errno}): SDA or SCL is held low", remedy)], []
        return [wrong(step, str(error), "check the adapter and its cable")], []
    if len(found) == LAST_ADDRESS - FIRST_ADDRESS + 1:
        text = "every address acknowledges: the data line SDA is held low"
        return [wrong(step, text, "check SDA for a short to ground, and each sensor's wires")], []
    if not found:
        remedy = "check the sensors' power, ground, SDA and SCL (exchanged?), and the pull-ups"
        return [wrong(step, "nothing answers on the bus", remedy)], []
    present = [sensor for sensor in airframe.sensors if sensor.address in found]
    absent = [sensor for sensor in airframe.sensors if sensor.address not in found]
    named = {sensor.address for sensor in airframe.sensors}
    others = [address for address in found if address not in named]
    findings = []
    if present:
        findings.append(right(step, ", ".join(f"{each.name} answers at {_both(each.address)}" for each in present)))
    for sensor in absent:
        findings.append(_absent(sensor, others, {each.address: each.name for each in present}))
    if others:
        listed = "; ".join(f"{_both(each)} {f'({OTHERS[each]})' if each in OTHERS else ''}".strip() for each in others)
        findings.append(right("other devices", f"the airframe file does not name {listed}"))
    return findings, present


def _absent(sensor: SensorSettings, others: Sequence[int], present: Mapping[int, str]) -> Finding:
    step = f"address of {sensor.name}"
    text = f"nothing answers at {_both(sensor.address)}"
    factory = sensor.driver.default_address
    if factory in others:
        return wrong(
            step,
            f"{text}, and something does at {_both(factory)}, the address from the factory",
            f"if that is it, connected alone: msp-range address 0x{factory:02x} 0x{sensor.address:02x}",
        )
    if others:
        listed = ", ".join(_both(each) for each in others)
        return wrong(
            step, f"{text}; the file does not name {listed}", "is one of these it? 'msp-range scan --ping' shows"
        )
    remedy = "check its power and wires"
    if factory in present:
        remedy += (
            f"; as it was delivered it is at 0x{factory:02x}, together with {present[factory]}, and they look like "
            f"one: then connect it alone, and msp-range address 0x{factory:02x} 0x{sensor.address:02x}"
        )
    return wrong(step, text, remedy)


def _both(address: int) -> str:
    """An address in the form of this project, and in that of some data sheets."""
    return f"0x{address:02x} (0x{address << 1:02X} in the 8-bit form)"


def _recognised(sensor: SensorSettings, bus: Bus, clock: Clock) -> Finding | None:
    """What is wrong where the device is not the sensor that it should be, or is two."""
    try:
        found = sensor.driver.identify(bus, clock, sensor.address)
    except BusError as error:
        return wrong(f"sensor {sensor.name}", str(error), "check its wires")
    if found.ranged or not any(each in found.answer for each in ("two sensors", "not an")):
        return None
    remedy = "connect one at a time, and give each an address of its own: msp-range address"
    return wrong(f"sensor {sensor.name}", f"0x{sensor.address:02x}: {found.answer}", remedy)


def _ping(sensor: PolledSensor, clock: Clock, silence_s: float) -> TimedPing:
    clock.sleep_until(clock.now() + silence_s)
    return _answer(sensor, clock, _start(sensor, clock))


def _count(pings: Sequence[TimedPing], status: Status) -> int:
    return sum(each.decoded is not None and each.decoded.status is status for each in pings)


def _start(sensor: PolledSensor, clock: Clock) -> float | None:
    # Before the write: on a busy computer it returns late, and the answer would seem to come too early.
    start_s = clock.now()
    try:
        sensor.device.ping()
    except BusError:
        return None
    return start_s


def _answer(sensor: PolledSensor, clock: Clock, pinged_s: float | None) -> TimedPing:
    if pinged_s is None:
        return TimedPing(None, 0.0, 0.0)
    # After the write: on a busy computer the ranging has begun late.
    end_s = clock.now() + sensor.timing.deadline_s
    clock.sleep_until(pinged_s + sensor.timing.first_answer_s)
    while True:
        now_s = clock.now()
        try:
            decoded = sensor.device.answer()
        except BusError:
            if now_s >= end_s:
                return TimedPing(None, now_s - pinged_s, 0.0)
            clock.sleep_until(now_s + POLL_INTERVAL_S)
            continue
        answered_s = clock.now() - pinged_s
        decoded = decoded.arrived_after(answered_s)
        return TimedPing(decoded, answered_s, reading_of(sensor, 0.0, decoded).time_s)


def _ranges(pings: Sequence[TimedPing]) -> list[float]:
    return [each.range_m for each in pings if each.range_m is not None]


def _readings(sensor: SensorSettings, pings: Sequence[TimedPing]) -> Finding:
    step = f"readings of {sensor.name}"
    answers = [each.decoded for each in pings if each.decoded is not None]
    statuses = {each.status for each in answers}
    shown = " ".join("-" if each.decoded is None else _shown(each.decoded) for each in pings)
    if len(answers) < len(pings):
        missed = len(pings) - len(answers)
        text = f"{missed} of {len(pings)} pings were not answered: {shown}"
        return wrong(step, text, "check its supply (3.0-5.5 V, 100 ohm and 100 uF at the sensor) and its wires")
    if Status.CLOCK_FAULT in statuses:
        remedy = "slow the bus down: dtparam=i2c_arm=on,i2c_arm_baudrate=50000, or dtoverlay=i2c-gpio"
        return wrong(step, f"the clock is too fast for this sensor: {shown}", remedy)
    impossible = sum(each.status in (Status.IMPOSSIBLE, Status.PART_INFO) for each in answers)
    if impossible:
        remedy = "check its supply for dips while it pings, and that no other program uses the bus"
        say = wrong if impossible > 1 else unknown  # a busy computer takes one for another now and then
        return say(step, f"answers that cannot be: {shown}", remedy)
    if Status.NO_ECHO in statuses and any(each.suspect for each in answers):
        remedy = "bytes are lost or mixed up: check wires, pull-ups and the bus clock"
        return wrong(step, f"'no echo' comes garbled: {shown}", remedy)
    ranges = _ranges(pings)
    if not ranges:
        return unknown(step, f"no echo: {shown}", "point it at a wall or floor 1 m away and try again")
    after_ms = 1e3 * median(each.answered_s for each in pings)
    if max(ranges) - min(ranges) > SCATTER_M:
        remedy = "hold it still and try again; then it is noise: supply, rotors, another ultrasonic sensor"
        return unknown(step, f"they lie {max(ranges) - min(ranges):.2f} m apart: {shown}", remedy)
    if any(each.suspect for each in answers):
        remedy = "move it: a reading that stays at this value is a damaged 'no echo'"
        return unknown(step, f"{shown}: also the value of a damaged 'no echo'", remedy)
    return right(step, f"{shown} after {after_ms:.0f} ms")


def _shown(decoded: Decoded) -> str:
    if decoded.range_m is not None:
        return f"{decoded.range_m:.2f} m"
    return str(decoded.status.value).replace("_", " ")


def _crosstalk(
    airframe: Airframe, polled: dict[str, PolledSensor], clock: Clock, alone: dict[str, list[TimedPing]]
) -> Finding:
    """Compare what each reads alone with what it reads in the airframe's polling order."""
    step = "crosstalk"
    together: dict[str, list[float]] = {name: [] for name in alone}
    groups = [[polled[name] for name in group if name in alone] for group in polling_groups(airframe)]
    for turn in range(READINGS + 1):
        for group in filter(None, groups):
            start_s = clock.now()
            started = [(sensor, _start(sensor, clock)) for sensor in group]
            for sensor, pinged_s in started:
                ping = _answer(sensor, clock, pinged_s)
                # Before the first turn there was no neighbour.
                if ping.range_m is not None and turn > 0:
                    together[sensor.name].append(ping.range_m)
            clock.sleep_until(start_s + polling_interval_s(airframe))
    disturbed, moved = [], []
    for name, pings in alone.items():
        before = _ranges(pings)
        if not together[name]:
            continue
        with_others_m = median(together[name])
        if not before:
            disturbed.append(f"{name} has no echo alone and {with_others_m:.2f} m in turn")
        elif _differs(with_others_m, median(before)):
            again = _ranges([_ping(polled[name], clock, SILENCE_S) for _ in range(3)])
            if again and not _differs(median(again), median(before)):
                disturbed.append(f"{name} reads {median(before):.2f} m alone and {with_others_m:.2f} m in turn")
            else:
                moved.append(name)
    if disturbed:
        remedy = (
            "raise polling.ping_interval_s, take sensors that disturb each other out of a group, or turn them outwards"
        )
        return wrong(step, f"sensors disturb each other: {', '.join(disturbed)}", remedy)
    if moved:
        return unknown(step, f"{', '.join(moved)} moved meanwhile", "hold the vehicle still and try again")
    return right(step, "each reads alone as it does in turn with the others")


def disagreeing(airframe: Airframe, ranges_m: Mapping[str, float]) -> Iterator[Finding]:
    """Downward sensors whose height above the ground differs from that of the others, if there are at least three."""
    heights_m = {
        each.name: ranges_m[each.name] * cos(each.tilt_from_down_rad) + each.position_m[2]
        for each in airframe.downward
        if each.name in ranges_m
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
