"""The messages that watchers get besides the records: the vehicle, its state, and the distances that the autopilot
reports.

Pure functions from the bridge's objects to messages of the feed.
"""

import math
from pathlib import Path
from typing import Any

from msp_range import __version__
from msp_range.bridge import Bridge
from msp_range.config import Airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import Transport
from msp_range.watch.facts import status_facts

BEAM_RANGES_M = (0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0)
"""Ranges at which the width of a beam is given; between them it is drawn linearly [m]."""


def airframe_message(airframe: Airframe) -> dict[str, Any]:
    """The message of ``/airframe``: name, streams, and each sensor's place, direction and beam."""
    fused = airframe.send.fused
    return {
        "vehicle": airframe.vehicle,
        "version": __version__,
        "link": airframe.link.url,
        "autopilot": airframe.link.autopilot,
        "sends_nothing": airframe.send.nothing,
        "reference_down_m": fused.reference_down_m if fused is not None else None,
        "sensors": [
            {
                "name": sensor.name,
                "model": sensor.sensor_model.name,
                "address": sensor.shown_address,
                "position_m": sensor.position_m,
                "boresight": sensor.boresight,
                "in_fused": sensor.name in airframe.fused_names,
                "has_stream": sensor.name in airframe.sent_names,
                "minimum_m": sensor.sensor_model.minimum_cm / 100,
                "maximum_m": sensor.sensor_model.maximum_cm / 100,
                "half_angle_deg": [
                    [range_m, math.degrees(sensor.sensor_model.beam.half_angle_rad(range_m))]
                    for range_m in BEAM_RANGES_M
                ],
            }
            for sensor in airframe.sensors
        ],
    }


def status_message(
    bridge: Bridge,
    transport: Transport,
    recording: Path | None,
    now_s: float,
) -> dict[str, Any]:
    """The message of ``/status``: counts and faults of sensors, air, link and recording, and what watchers show of it.

    Parameters
    ----------
    recording
        The file that is written; None: none.
    now_s
        Now on the bridge's clock [s].
    """
    verdict, link, air = bridge.verdict, bridge.link, bridge.air
    faults = bridge.health.sensor_faults
    uptime_s = round(now_s - bridge.started_s, 1)
    return {
        "state": verdict.state,
        "uptime_s": uptime_s,
        "sensors": {
            name: {
                "fault": faults.get(name),
                "readings": counts.readings,
                "rejected": counts.rejected,
                "findings": [found.text for found in bridge.sensor_findings if found.sensor == name],
            }
            for name, counts in bridge.counts().items()
        },
        "sensor_watch_off": bridge.sensor_watch_off,
        "faults": [finding._asdict() | {"severity": finding.severity.name.lower()} for finding in verdict.findings],
        "air": {"temperature_c": air.temperature_c, "std_c": air.std_c, "source": air.source},
        "link": {
            "url": transport.description,
            "connected": transport.connected,
            "error": transport.last_error,
            "autopilot": link.autopilot_system if link.autopilot_is_present else None,
            "armed": link.autopilot_armed if link.autopilot_is_present else None,
            "sent": dict(link.sent),
            "dropped": transport.stats.dropped_frames,
            "reconnects": transport.stats.reconnects,
        },
        "recording": None if recording is None else str(recording),
        "facts": [fact._asdict() for fact in status_facts(bridge, transport, recording, uptime_s)],
    }


def autopilot_message(message: Any) -> dict[str, Any] | None:
    """The message of ``/autopilot``: what a message of the autopilot says of distances; None for other messages."""
    kind = message.msgname
    if kind == "DISTANCE_SENSOR":
        return {
            "kind": kind,
            "orientation": message.orientation,
            "distance_m": message.current_distance / 100,
            "minimum_m": message.min_distance / 100,
            "maximum_m": message.max_distance / 100,
            "quality": message.signal_quality,
        }
    if kind == "SYS_STATUS":
        bit = dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION  # of range finders of any kind
        present, health = message.onboard_control_sensors_present, message.onboard_control_sensors_health
        return {"kind": kind, "present": bool(present & bit), "healthy": bool(health & bit)}
    return None
