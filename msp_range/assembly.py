"""From an airframe to the parts that `msp_range.bridge.Bridge` puts together: sensors, their order, fusion, streams."""

import math

from msp_range.bus import Bus
from msp_range.config import Airframe, Sensor
from msp_range.fusion import Attitude, DownwardSensor, Fusion
from msp_range.geometry import quaternion
from msp_range.mavlink.distance_sensor import Stream, make_stream
from msp_range.mavlink.orientation import CUSTOM, DOWN, Orientation
from msp_range.sensors.mb1242 import MB1242
from msp_range.sensors.schedule import PolledSensor, RoundRobin, Spacing, Timing


def polled_sensors(airframe: Airframe, bus: Bus) -> dict[str, PolledSensor]:
    """The airframe's sensors on a bus, by name."""
    return {sensor.name: _polled(sensor, bus, airframe.polling.adaptive) for sensor in airframe.sensors}


def polling_order(airframe: Airframe, bus: Bus, start_s: float) -> RoundRobin:
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
        model.reading_model.sigma_growth_cm_per_m / 100,
    )


def fusion_of(airframe: Airframe, attitude: Attitude) -> Fusion | None:
    """The airframe's downward sensors as one; None where it sends no fused stream."""
    fused = airframe.send.fused
    if fused is None:
        return None
    return Fusion(
        {
            sensor.name: DownwardSensor(
                (sensor.position_m[0], sensor.position_m[1], sensor.position_m[2] - fused.reference_down_m),
                sensor.boresight,
                sensor.sensor_model.oblique_reading,
            )
            for sensor in airframe.downward
        },
        attitude,
    )


def single_streams(airframe: Airframe) -> dict[str, Stream]:
    """The streams of the sensors that have one of their own, by name."""
    return {
        sensor.name: make_stream(sensor.id, sensor.orientation, sensor.sensor_model.maximum_cm, airframe.link.autopilot)
        for sensor in airframe.sensors
        if sensor.name in airframe.sent_names
    }


def object_streams(airframe: Airframe) -> dict[str, Stream]:
    """Streams for what lies below single sensors of the fused stream that have no stream of their own, by name.

    Their orientation is CUSTOM, with the mounting as a quaternion: as one more stream that looks down they would be
    mixed with the fused one, by ArduPilot and by PX4.
    """
    return {
        sensor.name: make_stream(
            sensor.id,
            Orientation(CUSTOM, quaternion(*sensor.rotation_deg.radians)),
            sensor.sensor_model.maximum_cm,
            airframe.link.autopilot,
        )
        for sensor in airframe.downward
        if sensor.name not in airframe.sent_names
    }


def fused_stream(airframe: Airframe) -> Stream | None:
    """The fused downward stream, where there is one."""
    if airframe.send.fused is None:
        return None
    below_m = airframe.send.fused.reference_down_m
    # What a sensor below the reference point can see reaches farther, counted from there.
    longest_cm = max(
        sensor.sensor_model.maximum_cm + round(100 * (sensor.position_m[2] - below_m)) for sensor in airframe.downward
    )
    return make_stream(
        airframe.send.fused.id, Orientation(DOWN, (0.0, 0.0, 0.0, 0.0)), longest_cm, airframe.link.autopilot
    )
