"""A ROS 2 node that publishes what a running bridge does: run it where rclpy is (`python3 ros2_node.py`), next to it.

It reads the bridge's status socket, as the web page does, and sends the bridge nothing. Topics: `~/range/SENSOR` and
`~/fused` (sensor_msgs/Range, frame ids `msp_range_SENSOR` and `msp_range_fused`) and `/diagnostics` (diagnostic_msgs/
DiagnosticArray). Ranges follow REP 117: -inf nearer than the minimum, +inf no echo, nan a fault. Not run under ROS yet.
"""

import json
import math
import os
import socket
import time

SOCKETS = ("/run/msp-range/status.sock", f"{os.environ.get('XDG_RUNTIME_DIR', '')}/msp-range/status.sock")
ULTRASOUND, OK, WARN, ERROR = 0, 0, 1, 2
LONGEST_PACKET = 1 << 20


def stamp(time_s):
    """A time since 1970 [s] as builtin_interfaces/Time."""
    return {"sec": math.floor(time_s), "nanosec": int(time_s % 1.0 * 1e9)}


def range_of(name, sensor, distance_m, time_s, variance_m2):
    """A sensor_msgs/Range; `sensor` is that of `/airframe`, and the beam is that at the distance."""
    near_m = distance_m if math.isfinite(distance_m) else sensor["maximum_m"]
    half_deg = min(sensor["half_angle_deg"], key=lambda point: abs(point[0] - near_m))[1]
    return {
        "header": {"stamp": stamp(time_s), "frame_id": f"msp_range_{name}"},
        "radiation_type": ULTRASOUND,
        "field_of_view": math.radians(2 * half_deg),
        "min_range": sensor["minimum_m"],
        "max_range": sensor["maximum_m"],
        "range": distance_m,
        "variance": variance_m2,
    }


def sensor_range(name, sensor, message, ahead_s):
    """The Range of a packet of `/range/SENSOR`; `ahead_s` takes the bridge's clock to the time since 1970 [s]."""
    status = message["status"]
    distance_m = message.get("corrected_m", math.nan)
    distance_m = {"at_minimum": -math.inf, "no_echo": math.inf}.get(status, distance_m)
    return range_of(name, sensor, distance_m, message["time_s"] + ahead_s, (message.get("std_m") or 0.0) ** 2)


def fused_range(sensors, message, ahead_s):
    """The Range of a packet of `/fused`, with the widest limits of the sensors in it."""
    downward = [sensor for sensor in sensors if sensor["in_fused"]]
    limits = {
        "minimum_m": min(sensor["minimum_m"] for sensor in downward),
        "maximum_m": max(sensor["maximum_m"] for sensor in downward),
        "half_angle_deg": downward[0]["half_angle_deg"],
    }
    return range_of("fused", limits, message["range_m"], message["time_s"] + ahead_s, message["variance_m2"])


def diagnostics(message, time_s):
    """The DiagnosticArray of a packet of `/status`."""
    entries = []
    for name, sensor in message["sensors"].items():
        values = {"readings": sensor["readings"], **sensor["rejected"]}
        entries.append(_entry(name, ERROR if sensor["fault"] else OK, str(sensor["fault"] or "good"), values))
    level = OK if message["state"] == "active" else WARN
    text = "; ".join(fault["text"] for fault in message["faults"]) or message["state"]
    entries.append(_entry("bridge", level, text, {"state": message["state"], "uptime_s": message["uptime_s"]}))
    return {"header": {"stamp": stamp(time_s), "frame_id": ""}, "status": entries}


def _entry(name, level, text, values):
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": f"msp_range: {name}", "message": text, "hardware_id": name, "values": pairs}


def converted(packet, airframe, ahead_s):
    """(topic, kind, message as a dict) of a packet; None for one that is not published."""
    topic, message = packet["topic"], packet["message"]
    sensors = {sensor["name"]: sensor for sensor in airframe["sensors"]}
    name = topic.removeprefix("/range/")
    if name in sensors and name != topic:
        return f"~/range/{name}", "Range", sensor_range(name, sensors[name], message, ahead_s)
    if topic == "/fused":
        return "~/fused", "Range", fused_range(airframe["sensors"], message, ahead_s)
    if topic == "/status":
        return "/diagnostics", "DiagnosticArray", diagnostics(message, packet["time_s"] + ahead_s)
    return None


def connect(paths):
    """A connection to the first bridge that is there."""
    for path in paths:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.connect(path)
            return connection
        except OSError:
            connection.close()
    raise SystemExit(f"no bridge runs: none of {', '.join(paths)} can be read")


def run(connection, publish):
    """Call publish(topic, kind, message) for each packet until the bridge ends."""
    airframe = None
    while data := connection.recv(LONGEST_PACKET):
        packet = json.loads(data)
        if packet["topic"] == "/airframe":
            airframe = packet["message"]
        elif airframe is not None:
            # The bridge's clock is this computer's monotonic one.
            found = converted(packet, airframe, time.time() - time.monotonic())
            if found is not None:
                publish(*found)


def filled(kind, content, types):
    """A ROS message of a dict; nested messages are filled in turn."""
    message = types[kind]()
    for key, value in content.items():
        # Range has no variance in Humble and before.
        if (part := getattr(message, key, None)) is None:
            continue
        if isinstance(value, dict):
            for name, inner in value.items():
                if isinstance(inner, dict):
                    for innermost, number in inner.items():
                        setattr(getattr(part, name), innermost, number)
                else:
                    setattr(part, name, inner)
        elif isinstance(value, list):
            inner_kind = "DiagnosticStatus" if key == "status" else "KeyValue"
            setattr(message, key, [filled(inner_kind, each, types) for each in value])
        else:
            # rclpy takes a field of the type byte as bytes.
            setattr(message, key, bytes([value]) if key == "level" else value)
    return message


def main():
    """Publish until the bridge ends."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from sensor_msgs.msg import Range

    kinds = (Range, DiagnosticArray, DiagnosticStatus, KeyValue)
    types = {kind.__name__: kind for kind in kinds}
    rclpy.init()
    node = rclpy.create_node("msp_range")
    publishers = {}

    def publish(topic, kind, content):
        if topic not in publishers:
            publishers[topic] = node.create_publisher(types[kind], topic, 10)
        publishers[topic].publish(filled(kind, content, types))

    try:
        with connect(SOCKETS) as connection:
            run(connection, publish)
    finally:
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
