"""The bridge: rangings in, DISTANCE_SENSOR out. `Bridge.step` is the whole of what flies, in order.

Sensors are pinged and read, a reading is corrected for the air's temperature, gated and filtered, the downward ones
become one distance, and messages go out. The same object runs on a vehicle, in a simulator and on a recording: bus,
clock, transport and recorder are arguments.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from msp_range.acoustics.air import compensate_range
from msp_range.acoustics.beam import BreakawayTable
from msp_range.bus import Bus
from msp_range.clock import Clock
from msp_range.config import Airframe, Sensor
from msp_range.correction.temperature import AirTemperature, FileSource, MavlinkSource, read_thermometer
from msp_range.filters.base import Estimate
from msp_range.filters.chain import Chain, Filtered
from msp_range.fusion import DownwardSensor, Fusion
from msp_range.health import Health, Report, Severity
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Stream, distance_sensor, make_stream, no_echo
from msp_range.mavlink.link import Link
from msp_range.mavlink.orientation import DOWN, Orientation
from msp_range.mavlink.outbox import Outbox
from msp_range.mavlink.transport import Transport
from msp_range.reading import Reading, Status
from msp_range.recording.error import RecordingError
from msp_range.sensors.mb1242 import MB1242
from msp_range.sensors.polling import PolledSensor, Poller, Ranging, RoundRobin, Schedule, Spacing, Timing

QUALITY_READINGS = 10
"""A stream's quality is the share of its last this many readings that were used."""
LOOK_INTERVAL_S = 0.25
"""Between two looks at what is not a reading's: temperature, autopilot, disk [s]."""
TEMPERATURE_REQUEST_HZ = 1.0
BUS_CALM_S = 2.0
"""A bus that has worked this long since its last fault works again [s]; a flickering one is told of once."""


class Records(Protocol):
    """What the bridge needs of a recorder."""

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Keep one message."""
        ...

    def flush_if_due(self, now_s: float) -> None:
        """Bring to the disk what was kept, where it is time."""
        ...


class _Channel:
    """One sensor's way through the bridge."""

    def __init__(self, sensor: Sensor, airframe: Airframe) -> None:
        model = sensor.sensor_model
        self.calibration_temperature_c = model.calibration_temperature_c
        self.beam: BreakawayTable = model.beam
        self.chain = Chain([parameters.make() for parameters in airframe.filters])
        self.stream: Stream | None = None
        if sensor.name in airframe.sent_names:
            self.stream = make_stream(sensor.id, sensor.orientation, model.maximum_cm, airframe.link.autopilot)
        self._used: deque[bool] = deque(maxlen=QUALITY_READINGS)
        self.quality = 0
        self.status: Status | None = None
        self.topics = tuple(f"/{sensor.name}/{stage}" for stage in ("reading", "corrected", "filtered"))
        self.readings = 0
        self.rejected: dict[str, int] = {}

    def note_used(self, used: bool) -> None:
        """Count the newest reading in, and the oldest out."""
        self._used.append(used)
        self.quality = 100 * sum(self._used) // len(self._used)


class Step(NamedTuple):
    """What one reading became; for those who watch the bridge.

    Attributes
    ----------
    ranging
        As it came from the sensor.
    corrected
        After the temperature correction.
    filtered
        The chain's outcome.
    fused
        The fused distance along the vehicle's down axis after this reading, where there is one.
    """

    ranging: Ranging
    corrected: Reading
    filtered: Filtered
    fused: Estimate | None


@dataclass(frozen=True, slots=True)
class Counts:
    """Readings of one sensor: all, and the rejected by reason."""

    readings: int
    rejected: dict[str, int] = field(default_factory=dict)


class Bridge:
    """All of an airframe's sensors, from bus to link.

    Parameters
    ----------
    airframe
        The vehicle.
    bus, clock, transport
        Where sensors answer, what time is, where frames go.
    recorder
        Keeps every stage of every reading; None: nothing is kept.
    report
        Called with (severity, text) at every change of health, beside the STATUSTEXT that goes out.
    hear
        Called with (time [s], message) for every message of the autopilot.
    wanted
        Messages to ask the autopilot for: name -> rate [Hz].
    thermometer
        Reads the temperature sources that are files.
    schedule
        Who pings when; None: the airframe's polling order.
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
        hear: Callable[[float, Any], None] | None = None,
        wanted: Mapping[str, float] | None = None,
        thermometer: Callable[[FileSource], float] = read_thermometer,
        schedule: Schedule | None = None,
    ) -> None:
        self._clock = clock
        self._recorder = recorder
        self._report = report
        self._hear = hear
        self._channels = {sensor.name: _Channel(sensor, airframe) for sensor in airframe.sensors}
        self._temperature = AirTemperature(airframe.temperature, clock.now(), thermometer)
        sources = airframe.temperature.sources
        asked = {each.message: TEMPERATURE_REQUEST_HZ for each in sources if isinstance(each, MavlinkSource)}
        self.link = Link(
            transport,
            clock,
            component_id=airframe.link.component_id,
            hear=self._take_message,
            wanted=asked | dict(wanted or {}),
        )
        self._outbox = Outbox(self._send)
        self._poller = Poller(bus, clock, schedule or polling_order(airframe, bus, clock.now()))
        self._fusion = make_fusion(airframe)
        self._fused_channels = [self._channels[name] for name in (self._fusion.sensors if self._fusion else ())]
        self._fused_stream: Stream | None = None
        if airframe.send.fused is not None:
            longest_cm = max(sensor.sensor_model.maximum_cm for sensor in airframe.downward)
            down = Orientation(DOWN, (0.0, 0.0, 0.0, 0.0))
            self._fused_stream = make_stream(airframe.send.fused.id, down, longest_cm, airframe.link.autopilot)
        self.health = Health(self._channels, self._tell)
        self._bus_fault = ""
        self._bus_fault_s = float("-inf")
        self._next_look_s = clock.now()
        self._known_reboots = 0
        self._autopilot_heard = False

    def step(self) -> list[Step]:
        """Sleep until something is due, do it, and return what became of the readings that ended."""
        self._clock.sleep_until(min(self._poller.next_event_s, self._outbox.next_event_s, self.link.next_event_s))
        steps = [self._take(ranging) for ranging in self._poller.step()]
        now_s = self._clock.now()
        self._outbox.send_due(now_s)
        if now_s >= self.link.next_event_s:
            self.link.service()
        if now_s >= self._next_look_s:
            self._next_look_s = now_s + LOOK_INTERVAL_S
            self._look_after(now_s)
        return steps

    def _take(self, ranging: Ranging) -> Step:
        channel = self._channels[ranging.reading.sensor]
        now_s = self._clock.now()
        temperature_c = self._temperature.now_c(now_s)
        corrected = correct(ranging.reading, temperature_c, channel.calibration_temperature_c)
        filtered = channel.chain.update(corrected)
        channel.status = corrected.status
        channel.readings += 1
        channel.note_used(filtered.estimate is not None)
        if filtered.rejected is not None:
            channel.rejected[filtered.rejected] = channel.rejected.get(filtered.rejected, 0) + 1
        fused = self._fuse(corrected, filtered)
        self._send_readings(now_s, channel, corrected, filtered, fused)
        step = Step(ranging, corrected, filtered, fused)
        if self._recorder is not None:
            self._record(self._recorder, now_s, channel, step, temperature_c)
        self.health.take(ranging)
        if ranging.error is not None and ranging.error.bus_at_fault:
            self._bus_fault_s = now_s
            what = "locked up" if ranging.error.locked_up else "gone"
            self._bus_fault = f"Range: I2C bus {what}, reopening (errno {ranging.error.errno})"
        return step

    def _fuse(self, corrected: Reading, filtered: Filtered) -> Estimate | None:
        """The fused distance at this reading's time; from the other sensors where this one gave none."""
        if self._fusion is None or not self._fusion.includes(corrected.sensor):
            return None
        if filtered.estimate is not None:
            return self._fusion.update(corrected.sensor, corrected.time_s, filtered.estimate)
        return self._fusion.at(corrected.time_s)

    def _send_readings(
        self, now_s: float, channel: _Channel, corrected: Reading, filtered: Filtered, fused: Estimate | None
    ) -> None:
        boot_ms = self.link.autopilot_clock.time_boot_ms(corrected.time_s)
        if self._fused_stream is not None and self._fusion is not None and self._fusion.includes(corrected.sensor):
            if self._fused_hears_nothing():
                view_rad = channel.beam.field_of_view_rad(self._fused_stream.max_distance_cm / 100)
                self._outbox.send_now(now_s, no_echo(self._fused_stream, boot_ms, view_rad))
            elif fused is not None:
                view_rad = channel.beam.field_of_view_rad(fused.range_m)
                message = distance_sensor(self._fused_stream, boot_ms, *fused, view_rad, self._fused_quality())
                self._outbox.send_now(now_s, message)
        if channel.stream is not None:
            if filtered.estimate is not None:
                view_rad = channel.beam.field_of_view_rad(filtered.estimate.range_m)
                message = distance_sensor(channel.stream, boot_ms, *filtered.estimate, view_rad, channel.quality)
                self._outbox.put(channel.stream.id, message)
            elif corrected.status is Status.NO_ECHO:
                view_rad = channel.beam.field_of_view_rad(channel.stream.max_distance_cm / 100)
                self._outbox.put(channel.stream.id, no_echo(channel.stream, boot_ms, view_rad))
            self._outbox.send_due(now_s)

    def _fused_hears_nothing(self) -> bool:
        """Most of the downward sensors that work heard nothing last time."""
        silent = working = 0
        for channel in self._fused_channels:
            if channel.status is not None and not channel.status.is_fault:
                working += 1
                silent += channel.status is Status.NO_ECHO
        return 2 * silent > working

    def _fused_quality(self) -> int:
        return sum([each.quality for each in self._fused_channels]) // len(self._fused_channels)

    def _send(self, message: Any) -> None:
        frame = self.link.send(message)
        if self._recorder is not None and frame is not None:
            self._write("/mavlink/sent", self._clock.now(), {"name": message.msgname, "hex": frame.hex()})

    def _record(self, recorder: Records, now_s: float, channel: _Channel, step: Step, temperature_c: float) -> None:
        ranging, corrected, filtered = step.ranging, step.corrected, step.filtered
        reading = ranging.reading
        time_s = corrected.time_s
        on_reading, on_corrected, on_filtered = channel.topics
        recorder.write(
            on_reading,
            now_s,
            {
                "time_s": time_s,
                "ping_s": ranging.ping_s,
                "read_s": ranging.answered_s,
                "status": reading.status.value,
                "raw": reading.raw,
                "range_m": reading.range_m,
                "std_m": reading.std_m,
                "suspect": reading.suspect,
            },
        )
        if corrected.range_m is not None:
            recorder.write(
                on_corrected,
                now_s,
                {
                    "time_s": time_s,
                    "range_m": corrected.range_m,
                    "temperature_c": temperature_c,
                    "source": self._temperature.source,
                },
            )
        if filtered.estimate is None:
            recorder.write(on_filtered, now_s, {"time_s": time_s, "rejected": filtered.rejected})
        else:
            recorder.write(on_filtered, now_s, _outcome(time_s, filtered.estimate))
        if step.fused is not None:
            recorder.write("/fused", now_s, _outcome(time_s, step.fused))

    def _write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        if self._recorder is not None:
            self._recorder.write(topic, time_s, message)

    def _take_message(self, now_s: float, message: Any) -> None:
        self._temperature.hear(now_s, message)
        if self._hear is not None:
            self._hear(now_s, message)

    def _look_after(self, now_s: float) -> None:
        """Conditions that are not a reading's: bus, temperature, autopilot, disk."""
        bus_works = now_s - self._bus_fault_s > BUS_CALM_S
        self.health.set("bus", None if bus_works else self._bus_fault, "Range: I2C bus works again", Severity.ERROR)
        self._temperature.now_c(now_s)
        fell_back = f"Range: no air temperature, using {self._temperature.fixed_c:.0f} C"
        self.health.set(
            "temperature", fell_back if self._temperature.fallen_back(now_s) else None, "Range: air temp is back"
        )
        heard = self.link.autopilot_heard
        reboots = self.link.autopilot_clock.reboots
        if heard and (not self._autopilot_heard or reboots != self._known_reboots):
            for severity, text in self.health.faults():
                self.link.send_text(severity, text)
        self._autopilot_heard, self._known_reboots = heard, reboots
        self.link.system_status = self._system_status()
        if self._recorder is not None:
            try:
                self._recorder.flush_if_due(now_s)
            except RecordingError as error:
                self._recorder = None
                self.health.set("recording", "Range: recording stopped, disk trouble", "")
                if self._report is not None:
                    self._report(Severity.WARNING, str(error))

    def _system_status(self) -> int:
        if not self.health.complete:
            status = dialect.MAV_STATE_BOOT
        elif self.health.bad_sensors:
            status = dialect.MAV_STATE_CRITICAL
        else:
            status = dialect.MAV_STATE_ACTIVE
        return int(status)

    def _tell(self, severity: Severity, text: str) -> None:
        self.link.send_text(severity, text)
        self._write("/health", self._clock.now(), {"text": text, "severity": severity.name.lower()})
        if self._report is not None:
            self._report(severity, text)

    def counts(self) -> dict[str, Counts]:
        """Readings of every sensor so far."""
        return {name: Counts(each.readings, dict(each.rejected)) for name, each in self._channels.items()}


def _outcome(time_s: float, estimate: Estimate) -> dict[str, Any]:
    return {"time_s": time_s, "range_m": estimate.range_m, "variance_m2": estimate.variance_m2}


def correct(reading: Reading, temperature_c: float, calibration_temperature_c: float) -> Reading:
    """The reading with its range for the air's temperature (report eq 7); its status and time stay."""
    if reading.range_m is None:
        return reading
    range_m = compensate_range(reading.range_m, temperature_c, calibration_temperature_c)
    return Reading(reading.time_s, reading.sensor, reading.status, range_m, reading.std_m, reading.raw, reading.suspect)


def polled_sensors(airframe: Airframe, bus: Bus) -> dict[str, PolledSensor]:
    """The airframe's sensors on a bus, by name."""
    return {sensor.name: _polled(sensor, bus, airframe.polling.adaptive) for sensor in airframe.sensors}


def polling_order(airframe: Airframe, bus: Bus, start_s: float) -> Schedule:
    """The airframe's sensors in their polling order, from ``start_s`` on."""
    polling = airframe.polling
    polled = polled_sensors(airframe, bus)
    names = polling.groups if polling.groups is not None else [[name] for name in polled]
    interval_s = polling.ping_interval_s
    if interval_s is None:
        interval_s = max(sensor.sensor_model.timing.ping_interval_s for sensor in airframe.sensors)
    near = polling.near
    spacing = Spacing(interval_s) if near is None else Spacing(interval_s, near.below_m, near.ping_interval_s)
    return RoundRobin([[polled[name] for name in group] for group in names], spacing, start_s)


def _polled(sensor: Sensor, bus: Bus, adaptive: bool) -> PolledSensor:
    model = sensor.sensor_model
    timing = model.timing
    first_answer_s = timing.ready_s + model.minimum_cm * timing.s_per_cm if adaptive else timing.deadline_s
    # Whole centimetres add the variance of their rounding.
    std_m = math.sqrt(model.reading_model.sigma_cm**2 + model.resolution_cm**2 / 12) / 100
    return PolledSensor(
        sensor.name,
        MB1242(bus, sensor.address),
        Timing(first_answer_s, timing.deadline_s, timing.s_per_cm * 100),
        std_m,
    )


def make_fusion(airframe: Airframe) -> Fusion | None:
    """The airframe's downward sensors as one; None where it sends no fused stream."""
    fused = airframe.send.fused
    if fused is None:
        return None
    return Fusion(
        {
            sensor.name: DownwardSensor(
                cos_tilt=math.cos(sensor.tilt_from_down_rad),
                below_reference_m=sensor.position_m[2] - fused.reference_down_m,
                oblique=sensor.sensor_model.oblique_reading,
            )
            for sensor in airframe.downward
        }
    )
