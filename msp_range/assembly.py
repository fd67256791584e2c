"""Make the parts of `msp_range.bridge.Bridge` from an airframe: sensors, polling order, fusion, streams."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from msp_range.acoustics.air import compensate_range
from msp_range.bus import Bus
from msp_range.config import Airframe, SensorSettings
from msp_range.correction.temperature import MavlinkSource
from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion, VerticalMotion, Windows
from msp_range.geometry import Vector, quaternion
from msp_range.health import Expected, SensorWatch
from msp_range.mavlink.acceptance import ACCEPTANCE_RATES, AcceptanceWatch
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Stream
from msp_range.mavlink.inertial import WITNESSES
from msp_range.mavlink.orientation import CUSTOM, DOWN, Orientation
from msp_range.reading_model.sensor_model import MEAN_EFFECTS, SensorModel
from msp_range.sensor_on_bus import SensorOnBus
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin

TEMPERATURE_REQUEST_HZ = 1.0
"""How often the autopilot is asked for temperatures, which change in minutes."""


def polled_sensors(airframe: Airframe, bus: Bus) -> dict[str, PolledSensor]:
    """The airframe's sensors on a bus, by name."""
    polled = {}
    for sensor in airframe.sensors:
        model = sensor.sensor_model
        # Rounding to whole centimetres adds its variance.
        std_m = math.sqrt(model.reading_model.sigma_cm**2 + model.answered_cm**2 / 12) / 100
        polled[sensor.name] = PolledSensor(
            sensor.name,
            sensor.driver(bus, sensor.address),
            answer_timing(sensor, airframe.polling.adaptive),
            std_m,
            model.reading_model.sigma_growth_cm_per_m / 100,
        )
    return polled


def answer_timing(sensor: SensorOnBus, adaptive: bool = True) -> AnswerTiming:
    """When a sensor is asked after a ping: from its shortest report on, or only at its deadline.

    One on a serial port is asked all the time, since its range is as old as its bytes; it sends each at the same time
    after its own ping, that of the longest range.
    """
    model = sensor.sensor_model
    timing = model.timing
    if sensor.driver.is_serial:
        return AnswerTiming(0.0, timing.deadline_s, timing.s_per_cm * 100, timing.answer_s(model.maximum_cm))
    first_answer_s = timing.answer_s(model.minimum_cm) if adaptive else timing.deadline_s
    return AnswerTiming(first_answer_s, timing.deadline_s, timing.s_per_cm * 100)


def polling_order(airframe: Airframe, bus: Bus, start_s: float) -> RoundRobin:
    """The airframe's sensors in their polling order, from ``start_s`` on."""
    polled = polled_sensors(airframe, bus)
    groups = [[polled[name] for name in group] for group in airframe.polling_groups]
    return RoundRobin(groups, airframe.polling_interval_s, start_s, airframe.polling.near)


def windows_of(airframe: Airframe) -> Windows:
    """Times for which a downward sensor's readings count, from the airframe's polling order."""
    groups = airframe.polling_groups
    # A ping waits for the answer of the previous one.
    ranging_s = max(sensor.sensor_model.timing.deadline_s for sensor in airframe.sensors)
    interval_s = max(airframe.polling_interval_s, ranging_s)
    fused = set(airframe.fused_names)
    turns = [i for i, group in enumerate(groups) if fused & set(group)] or [0]
    longest = max(late - early for early, late in pairwise([*turns, turns[0] + len(groups)]))
    return Windows(len(groups) * interval_s, longest * interval_s)


def intervals_s(airframe: Airframe) -> dict[str, float]:
    """Time between two messages of each permanent stream, by its name; ``fused`` for the fused one [s]."""
    windows = windows_of(airframe)
    intervals = dict.fromkeys(airframe.sent_names, windows.turn_s)
    return intervals if airframe.send.fused is None else intervals | {"fused": windows.gap_s}


def fusion_of(airframe: Airframe, attitude: AttitudeTrack, motion: VerticalMotion | None = None) -> Fusion | None:
    """The fusion of the airframe's downward sensors; None without a fused stream."""
    if airframe.send.fused is None:
        return None
    sensors = {
        sensor.name: DownwardSensor(
            (*sensor.position_m[:2], _below_reference_m(airframe, sensor)),
            sensor.boresight,
            sensor.sensor_model.oblique_reading,
            sensor.driver.garbled_from,
            math.cos(_widest_rad(sensor.sensor_model)),
        )
        for sensor in airframe.downward
    }
    return Fusion(sensors, attitude, windows_of(airframe), motion, fused_maximum_m(airframe))


def maximum_m(sensor: SensorSettings, temperature_c: float | None) -> float:
    """The longest distance that a sensor can report in air of this temperature [m]; None: where it is calibrated.

    It measures for as long in any air, and sound gets less far in cold air: an MB1242 7.08 m at -20 deg C.
    """
    model = sensor.sensor_model
    range_m = model.maximum_cm / 100
    if temperature_c is None or not model.depends_on_air:
        return range_m
    return compensate_range(range_m, temperature_c, model.calibration_temperature_c)


def fused_maximum_m(airframe: Airframe, temperature_c: float | None = None) -> float:
    """The longest fused distance, from the reference point [m]; see `maximum_m`."""
    return max(maximum_m(sensor, temperature_c) + _below_reference_m(airframe, sensor) for sensor in airframe.downward)


FACING_MARGIN_RAD = math.radians(3.0)
"""Missed echoes are counted while a sensor's angle to level ground is this far within its beam [rad]; slopes and the
attitude's error need the margin. Smaller: echoes that a leaning vehicle misses are counted; larger: less of a flight is
used."""


def sensor_watch_of(airframe: Airframe) -> SensorWatch | str:
    """The watch that compares each downward sensor with its model, or the reason why there is none."""
    if not airframe.sensor_watch:
        return "switched off in the airframe file"
    if airframe.send.fused is None:
        return "there is no fused stream to compare with"
    turn_s = windows_of(airframe).turn_s
    expected = {}
    for sensor in airframe.downward:
        numbers = expected_of(sensor.sensor_model, sensor.boresight, turn_s)
        if isinstance(numbers, str):
            return f"{sensor.model}: {numbers}"
        expected[sensor.name] = numbers
    return SensorWatch(expected, turn_s)


def expected_of(model: SensorModel, boresight: Vector, turn_s: float) -> Expected | str:
    """Numbers that a sensor model expects of a sensor's readings, or the reason why it cannot say."""
    mixture, in_flight = model.reading_model, model.in_flight
    weights = mixture.weights
    short, missed, random, spread = weights.short, weights.missed, weights.random, 1.0
    if in_flight is not None:
        short, missed, random = in_flight.short, in_flight.missed, 0.0
        spread = in_flight.sigma_cm / mixture.sigma_cm
    elif unknown := [name for effect in model.effects if (name := str(effect.get("name"))) not in MEAN_EFFECTS]:
        return f"no numbers (in_flight) of what {', '.join(unknown)} make of the readings"
    facing_rad = max(_widest_rad(model) - FACING_MARGIN_RAD, 0.0)
    return Expected(
        short,
        missed,
        random,
        mixture.missed_growth_per_m,
        mixture.correlation ** (turn_s / mixture.correlation_spacing_s),
        spread,
        model.minimum_cm / 100,
        model.maximum_cm / 100,
        boresight,
        math.cos(facing_rad),
    )


def _widest_rad(model: SensorModel) -> float:
    """The largest angle from straight down at which level ground at the maximum gives an echo [rad]."""
    return model.beam.half_angle_rad(model.maximum_cm / 100) if model.medium == "sound" else math.pi / 2


def _below_reference_m(airframe: Airframe, sensor: SensorSettings) -> float:
    """Distance of a downward sensor below the fused distance's reference point [m]."""
    return sensor.position_m[2] - airframe.reference_down_m


class AirframeStreams(NamedTuple):
    """All streams of an airframe."""

    singles: dict[str, Stream]
    """Streams of sensors that have a stream of their own, by name."""
    fused: Stream | None
    """The fused downward stream."""
    objects: dict[str, Stream]
    """Streams for objects below single sensors of the fused stream that have no stream of their own, by name. Their
    orientation is CUSTOM, with the mounting as a quaternion: ArduPilot and PX4 would mix another downward stream with
    the fused one."""


def streams_of(airframe: Airframe, temperature_c: float | None = None) -> AirframeStreams:
    """The streams in air of this temperature; see `maximum_m`."""
    autopilot = airframe.link.autopilot

    def own(sensor: SensorSettings, orientation: Orientation) -> Stream:
        minimum_cm, maximum_cm = round(sensor.sensor_model.minimum_cm), round(100 * maximum_m(sensor, temperature_c))
        return Stream(sensor.id, orientation, minimum_cm, maximum_cm, autopilot, _stream_type([sensor]))

    fused = None
    if airframe.send.fused is not None:
        # Counted from the reference point: for a sensor below it both limits are larger.
        fused = Stream(
            airframe.send.fused.id,
            Orientation(DOWN, (0.0, 0.0, 0.0, 0.0)),
            min(
                round(sensor.sensor_model.minimum_cm + 100 * _below_reference_m(airframe, sensor))
                for sensor in airframe.downward
            ),
            round(100 * fused_maximum_m(airframe, temperature_c)),
            autopilot,
            _stream_type(airframe.downward),
        )
    return AirframeStreams(
        {sensor.name: own(sensor, sensor.orientation) for sensor in airframe.sent},
        fused,
        {
            sensor.name: own(sensor, Orientation(CUSTOM, quaternion(*sensor.rotation_deg.radians)))
            for sensor in airframe.downward
            if sensor.name not in airframe.sent_names
        },
    )


def downward_stream(airframe: Airframe) -> Stream | None:
    """The stream with orientation 25, down: the fused one, or a single sensor's; None where there is none."""
    singles, fused, _ = streams_of(airframe)
    return fused or next((stream for stream in singles.values() if stream.orientation.value == DOWN), None)


def acceptance_of(airframe: Airframe) -> AcceptanceWatch | None:
    """What watches how the autopilot takes the downward distances; None where none are sent."""
    is_sent = downward_stream(airframe) is not None and not airframe.send.nothing
    return AcceptanceWatch(airframe.link.autopilot) if is_sent else None


def wanted_of(airframe: Airframe) -> dict[str, float]:
    """Messages that the bridge needs of the autopilot: rate [Hz] by name."""
    autopilot, sources = airframe.link.autopilot, airframe.temperature.sources
    wanted = {source.message: TEMPERATURE_REQUEST_HZ for source in sources if isinstance(source, MavlinkSource)}
    wanted |= WITNESSES[autopilot] if airframe.send.fused is not None else {}
    return wanted | ACCEPTANCE_RATES[autopilot]


def _stream_type(sensors: Sequence[SensorSettings]) -> int:
    """Sensor type in DISTANCE_SENSOR for a stream: ultrasound if one sensor is ultrasonic, radar if all are radio."""
    media = {sensor.sensor_model.medium for sensor in sensors}
    if "sound" in media:
        return int(dialect.MAV_DISTANCE_SENSOR_ULTRASOUND)
    return int(dialect.MAV_DISTANCE_SENSOR_RADAR if media == {"radio"} else dialect.MAV_DISTANCE_SENSOR_LASER)
