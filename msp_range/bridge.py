"""The bridge: rangings in, DISTANCE_SENSOR out. `Bridge.step` is the whole of what flies, in order.

Sensors are pinged and read, a reading is calibrated, corrected for the air's temperature, gated and filtered, the
downward ones become one distance, and messages go out. The same object runs on a vehicle, in a simulator and on a
recording: bus, clock, transport and recorder are arguments.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from msp_range.acoustics.air import NO_AIR, Air, compensate_range
from msp_range.assembly import (
    acceptance_of,
    fused_maximum_m,
    fusion_of,
    polling_order,
    sensor_watch_of,
    streams_of,
    wanted_of,
    windows_of,
)
from msp_range.bus import Bus
from msp_range.clock import Clock
from msp_range.config import Airframe, SensorSettings
from msp_range.correction.air_temperature import AirTemperature
from msp_range.correction.calibration import IDENTITY, Calibration
from msp_range.correction.thermometer import LoopReader
from msp_range.filters.chain import Chain, Filtered
from msp_range.fusion import (
    OBJECT,
    OUTLIER,
    REPEATED,
    SUSPECT,
    Angles,
    AttitudeTrack,
    Fused,
    Fusion,
    Outcome,
    Received,
    VerticalMotion,
)
from msp_range.health import (
    FUSED,
    BridgeState,
    BridgeVerdict,
    BusHealth,
    GroundUse,
    Health,
    ObservationsBelow,
    OutputWatch,
    Reminder,
    SensorWatch,
    Sighting,
    verdict_of,
)
from msp_range.health.finding import SensorFinding
from msp_range.mavlink.acceptance import Acceptance, AcceptanceWatch
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.inertial import motion_of
from msp_range.mavlink.link import Link
from msp_range.mavlink.signing import Signing
from msp_range.mavlink.streams import Streams
from msp_range.mavlink.transport import Transport
from msp_range.pilot_texts import Condition, Report, Severity, Text
from msp_range.reading import Reading, Status
from msp_range.recording.stages import stages_of
from msp_range.recording.topics import (
    ACCEPTANCE_TOPIC,
    ATTITUDE_TOPIC,
    FUSED_TOPIC,
    HEALTH_TOPIC,
    MOTION_TOPIC,
    RANGE_PREFIX,
    SENT_TOPIC,
    WITHHELD_TOPIC,
)
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import Schedule

LINK_WAITS_S = 0.02
"""While transfers follow each other without a pause, the link and the report of a silence wait for this time at most,
and for the transfer under way [s]. Longer than the pings of a group, so that they go out together (eight take 4 ms at
50 kHz); far shorter than the second between two heartbeats, and than the margin in `Windows.silence_s` (50 ms)."""
CONDITIONS_INTERVAL_S = 0.25
"""Longest time between two checks of what does not come with a reading: bus, temperature, autopilot, disk [s]. A
silence is reported when it is due, and why the fused distance stops when it does, whatever this is; a longer interval
reports the others later."""
LIMITS_FOLLOW_C = 1.0
"""The maximum of the streams follows the air where that has changed by more than this [deg C], which is 1.3 cm at 7.65
m. Smaller changes ``max_distance`` more often, larger calls a distance that the sensors cannot measure possible."""

_SYSTEM_STATUS = {
    BridgeState.STARTING: dialect.MAV_STATE_BOOT,
    BridgeState.ACTIVE: dialect.MAV_STATE_ACTIVE,
    BridgeState.SENDS_NOTHING: dialect.MAV_STATE_STANDBY,
    BridgeState.CRITICAL: dialect.MAV_STATE_CRITICAL,
}
_GROUND_USE = {
    None: GroundUse.GROUND,
    OBJECT: GroundUse.OTHER,
    OUTLIER: GroundUse.OTHER,
    REPEATED: GroundUse.REPEATED,
    SUSPECT: GroundUse.MISSED,
    Status.NO_ECHO.value: GroundUse.MISSED,
}


class Records(Protocol):
    """What the bridge needs of a recorder. No method waits for a disk, or raises because of one."""

    @property
    def fault(self) -> str | None:
        """Why nothing is recorded, in at most 28 characters (see `DISK_FAULTS`); None while recording works."""

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Keep one message."""

    def flush_if_due(self, now_s: float) -> None:
        """Write to the disk what was kept, when it is time."""


class Replayed(Schedule, Protocol):
    """A recorded flight that is played again: when who pings, and what was known of air and motion."""

    def air_at(self, now_s: float) -> Air:
        """The air at a time on the clock [s]."""

    def received(self, now_s: float) -> Iterable[tuple[float, Received]]:
        """Attitudes, accelerations and pressures that were received by a time and not before the last call, each with
        its time [s]."""


class _Channel:
    """One sensor in the bridge: its correction, its filters, and counts of its readings."""

    def __init__(self, sensor: SensorSettings, airframe: Airframe, memory_s: float) -> None:
        self.calibration = sensor.sensor_model.calibration_curve
        self.calibration_temperature_c = sensor.sensor_model.calibration_temperature_c
        self.by_sound = sensor.sensor_model.depends_on_air
        self.chain: Chain | None = None
        if sensor.name in airframe.sent_names:
            self.chain = Chain([parameters.make(sensor.sensor_model) for parameters in airframe.filters], memory_s)
        self.topic = RANGE_PREFIX + sensor.name
        self.is_fused = sensor in airframe.downward
        self.counts = Counts()


class Step(NamedTuple):
    """One reading at each stage of the bridge, for those who watch it."""

    ranging: Ranging
    """The reading as it came from the sensor."""
    air: Air
    """The air that the range was corrected for; of the source `NO_AIR` where it is a range of light."""
    corrected: Reading
    """The reading after the temperature correction."""
    filtered: Filtered
    """The outcome of the sensor's filters. A sensor without a stream of its own has none: then there is no estimate,
    and a reason where the fusion did not use the reading."""
    fused: Fused | None
    """The fused distance along the vehicle's down axis after this reading, where there is one."""


@dataclass(slots=True)
class Counts:
    """Readings of one sensor: all, and the rejected by reason."""

    readings: int = 0
    rejected: Counter[str] = field(default_factory=Counter)


MOTIONLESS = (Status.STUCK, Status.FIXED)
"""Faults that the fusion finds, by comparing a sensor's readings with the vehicle's motion."""


class Bridge:
    """The bridge of one airframe: it polls the sensors, fuses and filters their readings, and sends distances.

    Parameters
    ----------
    airframe
        The vehicle.
    bus, clock, transport
        The bus of the sensors, the clock for all times, and the transport for MAVLink frames.
    recorder
        Keeps every stage of every reading; None: nothing is kept.
    report
        Called with (severity, text) at every change of health, alongside the STATUSTEXT that is sent.
    on_message
        Called with (time [s], message) for every message of the autopilot.
    wanted
        Messages to ask the autopilot for: name -> rate [Hz].
    thermometer
        Reads the temperature sources that are files; None: in the loop.
    replayed
        A recorded flight; None: pings are in the airframe's polling order, the air is by its sources, and the autopilot
        sends attitudes, accelerations and pressures.
    signing
        Signs and verifies messages; None: they are not signed.

    Attributes
    ----------
    airframe
        The vehicle.
    acceptance
        What the autopilot makes of the downward distances; None: none are sent, or there is no autopilot.
    air
        The air that sound travels through now.
    started_s
        When it was made [s].
    sensor_watch_off
        Why sensors are not compared with their models; None: they are.
    verdict
        The bridge's state, with what is wrong.
    completed_s
        When a step last left nothing undone that was due, and every message had been handed to the link or counted as
        dropped [s]; whoever watches over the loop goes by it.
    """

    def __init__(
        self,
        airframe: Airframe,
        bus: Bus,
        clock: Clock,
        transport: Transport,
        *,
        recorder: Records | None = None,
        report: Report | None = None,
        on_message: Callable[[float, Any], None] | None = None,
        wanted: Mapping[str, float] | None = None,
        thermometer: LoopReader | None = None,
        replayed: Replayed | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.airframe = airframe
        self._clock = clock
        self.started_s = self.completed_s = self._next_conditions_s = now_s = clock.now()
        self._recorder = recorder
        self._publish: Callable[[str, float, dict[str, Any]], None] | None = None
        self._report, self._report_message = report, on_message
        windows = windows_of(airframe)
        self._channels = {sensor.name: _Channel(sensor, airframe, windows.memory_s) for sensor in airframe.sensors}
        self._temperature = AirTemperature(
            airframe.temperature, now_s, thermometer or LoopReader(), airframe.maximum_by_sound_m
        )
        self.air = self._temperature.now(now_s)
        self._replayed = replayed
        self._attitude, self._motion = AttitudeTrack(), VerticalMotion()
        self._fusion = fusion_of(airframe, self._attitude, self._motion)
        self._fused_by_sound = any(sensor.sensor_model.depends_on_air for sensor in airframe.downward)
        self._acceptance_watch = acceptance_of(airframe)
        self.acceptance: Acceptance | None = None
        self.link = Link(
            transport,
            clock,
            component_id=airframe.link.component_id,
            on_message=self._on_message,
            wanted=wanted_of(airframe) | dict(wanted or {}),
            autopilot=airframe.link.autopilot,
            system_id=airframe.link.system_id,
            signing=signing,
        )
        self._schedule = replayed or polling_order(airframe, bus, now_s)
        self._poller = Poller(bus, clock, self._schedule)
        self._streams = Streams({sensor.name: sensor.sensor_model.beam for sensor in airframe.sensors}, self._send)
        self._limits_c = float("inf")  # The first reading sets the limits of its air.
        always = [*airframe.sent_names, *([FUSED] if self._fusion is not None else [])]
        self._output = OutputWatch(always, windows.silence_s, now_s)
        watch = sensor_watch_of(airframe)
        self._sensor_watch = None if isinstance(watch, str) else watch
        self.sensor_watch_off = watch if isinstance(watch, str) else None
        self.health = Health(self._channels, self.notify)
        self._below = ObservationsBelow(self.notify)
        self._bus_health = BusHealth()
        self._reminder = Reminder()
        self.verdict = BridgeVerdict(BridgeState.STARTING)
        self._fused_is_sent = False

    @property
    def sensor_findings(self) -> Sequence[SensorFinding]:
        """Present findings of the sensor watch."""
        return () if self._sensor_watch is None else self._sensor_watch.findings

    def record_to(self, recorder: Records) -> None:
        """Keep every stage of every reading from here on."""
        self._recorder = recorder

    def show_to(self, publish: Callable[[str, float, dict[str, Any]], None]) -> None:
        """Call this with (topic, time [s], message) of everything that is or would be recorded from here on."""
        self._publish = publish

    def step(self) -> list[Step]:
        """Sleep until something is due, do it, and return the readings that it completed."""
        clock, poller, outbox, link = self._clock, self._poller, self._streams.outbox, self.link
        due_s = min(poller.next_event_s, outbox.next_event_s, link.next_event_s, self._next_conditions_s)
        has_arrived = clock.sleep_until(due_s, link.files)
        now_s = clock.now()
        steps: list[Step] = []
        if now_s >= poller.next_event_s:
            steps = list(map(self._on_ranging, poller.step()))
            now_s = clock.now()
        outbox.send_due(now_s)
        if has_arrived:
            link.next_event_s = min(link.next_event_s, now_s)
        if poller.next_event_s <= now_s < min(link.next_event_s, self._next_conditions_s) + LINK_WAITS_S:
            return steps
        if now_s >= link.next_event_s:
            link.service(has_arrived)
        if now_s >= self._next_conditions_s:
            self._check_conditions(now_s)
        self.completed_s = now_s
        return steps

    def on_stuck_transfer(self) -> None:
        """Report a transfer that does not end; called by a thread that holds `KernelBus.waiting`."""
        now_s = self._clock.now()
        self._bus_health.on_stuck(now_s)
        self._check_conditions(now_s)

    def _on_ranging(self, ranging: Ranging) -> Step:
        """Correct, fuse, filter, send and record one reading."""
        now_s = self._clock.now()
        channel = self._channels[ranging.reading.sensor]
        vehicle_air = self.air if self._replayed is None else self._replayed.air_at(now_s)
        if abs(vehicle_air.sonic_c - self._limits_c) > LIMITS_FOLLOW_C:
            self._set_limits(vehicle_air.sonic_c)
        air = vehicle_air if channel.by_sound else Air(channel.calibration_temperature_c, 0.0, NO_AIR)
        reading = correct(ranging.reading, air.sonic_c, channel.calibration_temperature_c, channel.calibration)
        boot_ms = self.link.autopilot_clock.time_boot_ms(reading.time_s)
        filtered, fused = Filtered(None), None
        if self._fusion is not None and channel.is_fused:
            if self._replayed is not None:
                for received_s, moved in self._replayed.received(now_s):
                    self._on_moved(received_s, moved)
            outcome = self._fusion.update(reading, now_s)
            reading, fused, filtered = outcome.reading, outcome.fused, Filtered(None, outcome.rejected)
            if self._sensor_watch is not None:
                self._compare(self._sensor_watch, self._fusion, outcome)
            self._send_fused(self._fusion, outcome, vehicle_air if self._fused_by_sound else air, now_s, boot_ms)
            if reading.range_m is not None and channel.by_sound:
                self._temperature.record_range(ranging.reading)
        if channel.chain is not None:
            filtered = channel.chain.update(reading)
            if self._streams.send_single(now_s, boot_ms, reading, filtered, air):
                self._output.on_usable(reading.sensor, now_s)
            if not channel.is_fused and reading.range_m is not None:
                self._output.on_range(filtered.estimate is not None, 1.0)
        if self._is_kept:
            self.write(channel.topic, now_s, stages_of(ranging, air, reading, filtered))
            if fused is not None:
                self.write(FUSED_TOPIC, now_s, fused.record(ranging.reading.time_s))
        channel.counts.readings += 1
        if filtered.rejected is not None:
            channel.counts.rejected[filtered.rejected] += 1
        self.health.on_ranging(ranging._replace(reading=reading) if reading.status in MOTIONLESS else ranging)
        self._bus_health.on_ranging(now_s, ranging)
        return Step(ranging, air, reading, filtered, fused)

    def _compare(self, watch: SensorWatch, fusion: Fusion, outcome: Outcome) -> None:
        """Hold a reading against its sensor's model."""
        reading, climb_m_s = outcome.reading, fusion.climb_m_s
        use = _GROUND_USE.get(outcome.rejected, GroundUse.NOTHING)
        if reading.status is Status.AT_MINIMUM:
            use = GroundUse.NOTHING
        if watch.is_single:
            rate = self._motion.rate(reading.time_s)
            climb_m_s = rate.m_s if rate is not None else 0.0
        height_m, std_m = fusion.level_height_m, reading.std_m or 0.0
        watch.update(
            Sighting(reading.sensor, reading.time_s, use, height_m, std_m, reading.raw, climb_m_s, fusion.down)
        )

    def _set_limits(self, temperature_c: float) -> None:
        """The longest distances of the streams are those that sound reaches in air of this temperature."""
        self._limits_c = temperature_c
        airframe, streams = self.airframe, self._streams
        streams.singles, streams.fused, streams.objects = streams_of(airframe, temperature_c)
        if self._fusion is not None:
            self._fusion.set_maximum(fused_maximum_m(airframe, temperature_c))

    def _send_fused(self, fusion: Fusion, outcome: Outcome, air: Air, now_s: float, boot_ms: int) -> None:
        """Send the fused distance, and what is below the sensor that is not ground."""
        reading, rejected = outcome.reading, outcome.rejected
        is_sent = self._streams.send_fused(now_s, boot_ms, outcome, air, fusion.confidence)
        if is_sent:
            self._output.on_usable(FUSED, now_s)
        if is_sent != self._fused_is_sent:
            # Why it has stopped, or that it is back, is reported at once.
            self._fused_is_sent, self._next_conditions_s = is_sent, now_s
        # No echo agrees with silence, and with 'above the maximum'.
        agrees = outcome.fused is None and reading.status is Status.NO_ECHO
        if agrees or (reading.range_m is not None and rejected != SUSPECT):
            self._output.on_range(agrees or rejected in (None, OBJECT), fusion.fit)
        is_in_doubt = fusion.is_ground_in_doubt(reading.sensor)
        object_m = fusion.object_m(reading.sensor)
        self._below.update(reading.sensor, object_m, is_in_doubt, rejected is None)
        if fusion.asks_again(outcome):
            self._schedule.again(reading.sensor)
        if rejected == OBJECT and object_m is not None and object_m > 0:
            self._streams.send_object(now_s, boot_ms, reading, air)

    def _send(self, message: Any) -> None:
        """Send a stream's message and record it; where nothing is to be sent, record it as withheld."""
        if self.airframe.send.nothing:
            sender = dialect.MAVLink(None, self.link.autopilot_system or 1, self.airframe.link.component_id)
            topic, frame = WITHHELD_TOPIC, message.pack(sender)
        else:
            topic, frame = SENT_TOPIC, self.link.send(message)
        if frame is None:
            return
        now_s = self._clock.now()
        if self._acceptance_watch is not None:
            down = self._attitude.down_at(now_s)
            self._acceptance_watch.on_sent(now_s, message, 1.0 if down is None else down[2])
        self.write(topic, now_s, {"name": message.msgname, "hex": frame.hex()})

    @property
    def _is_kept(self) -> bool:
        """Whether somebody records or watches."""
        return self._recorder is not None or self._publish is not None

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Record one message, and show it to whoever watches."""
        if self._recorder is not None:
            self._recorder.write(topic, time_s, message)
        if self._publish is not None:
            self._publish(topic, time_s, message)

    def _on_message(self, now_s: float, message: Any) -> None:
        self._temperature.on_message(now_s, message)
        if self._acceptance_watch is not None:
            self._acceptance_watch.on_message(now_s, message)
        if self._fusion is not None:
            moved = motion_of(message, now_s, self.link.autopilot_clock, self._attitude)
            if moved is not None:
                self._on_moved(now_s, moved)
        if self._report_message is not None:
            self._report_message(now_s, message)

    def _on_moved(self, received_s: float, moved: Received) -> None:
        """An attitude, an acceleration or a pressure, for the fusion and the record."""
        if isinstance(moved, Angles):
            topic, is_taken = ATTITUDE_TOPIC, self._attitude.update(moved)
        else:
            topic, is_taken = MOTION_TOPIC, self._motion.update(moved)
        if is_taken and self._is_kept:
            self.write(topic, received_s, moved._asdict())

    def _check_conditions(self, now_s: float) -> None:
        """Update the air, the recording and the conditions of all that is not a sensor, and report what has changed."""
        # A usable message only defers the limit of silence: no check is later than one that is reached.
        self._next_conditions_s = min(now_s + CONDITIONS_INTERVAL_S, self._output.next_event_s(now_s))
        conditions = [self._bus_health.condition(), *self.link.conditions()]
        if self._replayed is None:
            self.air = self._temperature.now(now_s)
            conditions += self._temperature.conditions(now_s)
        finding = self.sensor_findings[-1] if self.sensor_findings else None
        conditions += self._output.conditions(now_s, self.health.failing_sensors, finding)
        conditions.append(self._attitude.condition(now_s))
        if self.airframe.send.nothing:
            conditions.append(Text.NOT_SENT)
        if self._fusion is not None:
            conditions += self._fusion.conditions()
        if self._acceptance_watch is not None:
            conditions.append(self._accepted(self._acceptance_watch, now_s))
        if self._recorder is not None:
            self._recorder.flush_if_due(now_s)
            fault = self._recorder.fault
            conditions.append(Text.NOT_RECORDING.when(fault is not None, fault=fault))
        for condition in conditions:
            self.health.set(condition)
        is_there = self.link.autopilot_is_present
        self.verdict = verdict_of(self.health.conditions, self.health.complete and is_there)
        self.link.system_status = _SYSTEM_STATUS[self.verdict.state]
        if self._reminder.is_due(now_s, self.link.autopilot_clock.reboots if is_there else None):
            texts = [(reported.severity, reported.text) for reported in self.verdict.findings if reported.is_reported]
            for severity, text in texts + self._below.texts():
                self.link.send_text(severity, text)

    def _accepted(self, watch: AcceptanceWatch, now_s: float) -> Condition:
        """Note what the autopilot makes of the distances, and return what is wrong with it."""
        before, self.acceptance = self.acceptance, watch.now(now_s) if self.link.autopilot_is_present else None
        if self.acceptance is None:
            return Text.NOT_RECEIVED.when(False)
        if self.acceptance != before:
            self.write(ACCEPTANCE_TOPIC, now_s, {"text": self.acceptance.text} | self.acceptance.numbers)
        return self.acceptance.problem

    def notify(self, severity: Severity, text: str) -> None:
        """Report something to the pilot, the recording and the log."""
        self.link.send_text(severity, text)
        self.write(HEALTH_TOPIC, self._clock.now(), {"text": text, "severity": severity.name.lower()})
        if self._report is not None:
            self._report(severity, text)

    def counts(self) -> dict[str, Counts]:
        """Readings of every sensor so far; they go on counting."""
        return {name: channel.counts for name, channel in self._channels.items()}


def correct(
    reading: Reading, temperature_c: float, calibration_temperature_c: float, calibration: Calibration = IDENTITY
) -> Reading:
    """The reading with its range calibrated, then for the air's sonic temperature (report eq 7); status and time stay.

    In this order because an offset of the sensor is in its clock: it does not grow with the air's speed of sound. A
    reading shorter than what the sensor reads at range 0 is a range of 0.
    """
    if reading.range_m is None:
        return reading
    range_m = reading.range_m
    if not calibration.is_identity:
        range_m = max(calibration.inverse(100.0 * range_m) / 100.0, 0.0)
    range_m = compensate_range(range_m, temperature_c, calibration_temperature_c)
    return Reading(reading.time_s, reading.sensor, reading.status, range_m, reading.std_m, reading.raw, reading.suspect)
