"""What is legal in an airframe file and probably a mistake: lengths in centimetres, sensors of one place, streams that
an autopilot drops, and a beam that was not predicted. `check`, doctor and the service's log show it."""

from collections.abc import Iterator

from msp_range.assembly import intervals_s
from msp_range.config import Airframe
from msp_range.mavlink.distance_sensor import Autopilot

FAR_M = 3.0
"""A sensor further from the reference point than this [m] was probably written in centimetres: vehicles that land on a
pallet are 1 to 3 m across. Larger misses 5 cm written as 5; smaller warns of large vehicles."""


TIME_OUT_S: dict[Autopilot, float] = {"ardupilot": 0.5, "px4": 0.4}
"""Time without a message after which a range finder counts as lost [s]: ArduPilot's AP_RangeFinder_MAVLink.cpp; PX4's
EKF2 requires readings at least this often."""


def doubts(airframe: Airframe) -> Iterator[str]:
    """One sentence for each."""
    for sensor in airframe.sensors:
        far = max(abs(along_m) for along_m in sensor.position_m)
        if far > FAR_M:
            yield (
                f"sensors.{sensor.name}.position_m: {far:g} m from the reference point; positions are in metres: "
                f"is it {far:g} cm, so {far / 100:g}?"
            )
    fused = airframe.send.fused
    if fused is not None and abs(fused.reference_down_m) > FAR_M:
        far = fused.reference_down_m
        yield f"send.fused.reference_down_m: {far:g} m; lengths are in metres: is it {far:g} cm, so {far / 100:g}?"
    autopilot, time_out_s = airframe.link.autopilot, TIME_OUT_S[airframe.link.autopilot]
    for name, interval_s in intervals_s(airframe).items():
        if interval_s > time_out_s and not airframe.send.nothing:
            yield (
                f"{autopilot} drops a range finder after {time_out_s} s without a message, and {name} has one every "
                f"{interval_s:.2f} s; use fewer polling groups, or a shorter ping_interval_s"
            )
    places: dict[tuple[float, ...], str] = {}
    for sensor in airframe.sensors:
        key = (*sensor.position_m, *(round(each, 3) for each in sensor.boresight))
        if key in places:
            yield f"sensors.{sensor.name}: at the same place and angle as {places[key]}"
        places[key] = sensor.name
    for name, model in {sensor.model: sensor.sensor_model for sensor in airframe.sensors}.items():
        if model.beam_doubt:
            last = model.breakaway[-1]
            yield (
                f"{name}: {model.beam_doubt}, so the beam's half angle is held at {last.half_angle_deg:g} deg beyond "
                f"{last.range_cm:g} cm; to predict it: msp-lab beam {name}"
            )
