"""A flight with an autopilot's own simulator: the pose comes over the link, and emulated sensors measure from there.

`AutopilotVehicle` turns messages of the autopilot into poses. `Sitl` adds emulated sensors and the real bridge, which
sends its distances over the same link to the autopilot.

Two kinds of message contain a pose. The simulator's truth: SIM_STATE (ArduPilot, libraries/SITL/SITL.cpp) or
HIL_STATE_QUATERNION (PX4's SIH, modules/mavlink/streams/HIL_STATE_QUATERNION.hpp). And the autopilot's estimate:
ATTITUDE with LOCAL_POSITION_NED. The truth is used if it is sent, and once it has been received the estimate is
ignored: sensors simulated from the estimate would confirm its errors to the estimator.

All of these messages count heights from an origin of their own. Therefore the vehicle is assumed to stand on the ground
whenever the autopilot reports that it is disarmed: each such HEARTBEAT sets the height of the last pose to that of a
landed vehicle. Before the first one the vehicle may be in flight at any height, and no sensor answers.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from numpy.random import SeedSequence

from msp_range.bridge import Records
from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.geometry import Vector
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.signing import signing_of
from msp_range.mavlink.transport import open_transport
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.device.device import Fault, NotAcknowledged
from msp_sim.flight.flight import EmulatedFlight
from msp_sim.world.vehicle import EulerAngles, Pose
from msp_sim.world.world import World

POSE_STALE_S = 1.0
"""Age at which a pose is no longer used [s]. A larger value lets sensors answer from a position that is only
extrapolated."""
POSE_RATE_HZ = 25.0
"""Requested rate of poses: at 5 m/s the vehicle moves 0.2 m between two, nearly all of which its velocity predicts."""
TRUTH: Mapping[Autopilot, str] = {"ardupilot": "SIM_STATE", "px4": "HIL_STATE_QUATERNION"}
"""The message with the simulator's truth. Only the autopilot's own one is requested: ArduPilot sends its pilot a text
at every request for an unknown message."""
ESTIMATE = ("ATTITUDE", "LOCAL_POSITION_NED")
EARTH_RADIUS_M = 6_371_000.0


class AutopilotVehicle:
    """The vehicle's pose according to its autopilot.

    Parameters
    ----------
    elevation_m
        Height of the surface at a north and east [m] over the world's origin [m].
    clearance_m
        Height of the body frame's origin above the surface when the vehicle has landed [m]; it is never lower.
    start_m
        North and east of the vehicle at the first pose [m].

    Attributes
    ----------
    armed : bool or None
        State in the last HEARTBEAT; None before the first.
    height_known : bool
        Whether it has been received disarmed, and so on the ground, and its first pose did not come after it was armed.
    source : str or None
        Message type of the last pose; LOCAL_POSITION_NED stands for the estimate.
    poses_received : Counter
        Number of poses by message type.

    Examples
    --------
    >>> vehicle = AutopilotVehicle(lambda north_m, east_m: 0.0, 0.25)
    >>> vehicle.pose(0.0).position_ned_m
    (0.0, 0.0, -0.25)
    """

    def __init__(
        self,
        elevation_m: Callable[[float, float], float],
        clearance_m: float,
        start_m: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.armed: bool | None = None
        self.height_known = False
        self.source: str | None = None
        self.poses_received: Counter[str] = Counter()
        self._elevation_m = elevation_m
        self._clearance_m = clearance_m
        self._last = Pose(0.0, (*start_m, self._landed_down_m(*start_m)), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0))
        self._origin_m: Vector = (0.0, 0.0, 0.0)
        self._cos_latitude: float | None = None
        self._angles: tuple[float, EulerAngles] | None = None

    def on_message(self, now_s: float, message: Any) -> None:
        """Update with a message of the autopilot received at ``now_s``: a HEARTBEAT or a pose; others are ignored."""
        kind = message.msgname
        if kind == "HEARTBEAT":
            self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
            if not self.armed:
                self.height_known = True
                self._land()
        elif kind == "SIM_STATE":
            place = self._global_place(message.lat_int, message.lon_int, message.alt)
            velocity = (message.vn, message.ve, message.vd)
            self._set_pose(kind, now_s, place, EulerAngles(message.roll, message.pitch, message.yaw), velocity)
        elif kind == "HIL_STATE_QUATERNION":
            # PX4 sends zeros until its simulator knows its position.
            if message.lat or message.lon:
                place = self._global_place(message.lat, message.lon, message.alt / 1e3)
                velocity = (message.vx / 100, message.vy / 100, message.vz / 100)
                self._set_pose(kind, now_s, place, euler_angles(*message.attitude_quaternion), velocity)
        elif kind == "ATTITUDE":
            self._angles = now_s, EulerAngles(message.roll, message.pitch, message.yaw)
        elif kind == "LOCAL_POSITION_NED" and self.source not in TRUTH.values() and self._angles is not None:
            angles_s, angles = self._angles
            if now_s - angles_s <= POSE_STALE_S:
                place = (message.x, message.y, message.z)
                self._set_pose(kind, now_s, place, angles, (message.vx, message.vy, message.vz))

    def pose(self, time_s: float) -> Pose:
        """Pose at ``time_s``, extrapolated with the last velocity; before the first pose at the start, on the
        ground."""
        last = self._last
        elapsed_s = time_s - last.time_s
        north_m, east_m, down_m = (
            place_m + speed_m_s * elapsed_s
            for place_m, speed_m_s in zip(last.position_ned_m, last.velocity_ned_m_s, strict=True)
        )
        down_m = min(down_m, self._landed_down_m(north_m, east_m))
        return last._replace(time_s=time_s, position_ned_m=(north_m, east_m, down_m))

    def is_known(self, time_s: float) -> bool:
        """Whether the pose is known: disarmed without any pose yet, or with a pose within `POSE_STALE_S`."""
        age_s = self.age_s(time_s)
        return self.height_known and (not self.armed if age_s is None else age_s <= POSE_STALE_S)

    def age_s(self, time_s: float) -> float | None:
        """Time since the last pose [s]; None before the first."""
        return None if self.source is None else time_s - self._last.time_s

    def _global_place(self, latitude_1e7: int, longitude_1e7: int, altitude_m: float) -> Vector:
        """North, east and down from 0 N 0 E at sea level, for a flat earth around the first position [m].

        ArduPilot before 4.1 leaves the integers 0; the vehicle then stays above its start.
        """
        latitude_rad, longitude_rad = math.radians(latitude_1e7 / 1e7), math.radians(longitude_1e7 / 1e7)
        if self._cos_latitude is None:
            self._cos_latitude = math.cos(latitude_rad)
        return EARTH_RADIUS_M * latitude_rad, EARTH_RADIUS_M * longitude_rad * self._cos_latitude, -altitude_m

    def _landed_down_m(self, north_m: float, east_m: float) -> float:
        """Down coordinate of the landed vehicle at a position [m]."""
        return -self._elevation_m(north_m, east_m) - self._clearance_m

    def _land(self) -> None:
        """Shift the origin of heights so that the vehicle stands on the ground at its last pose."""
        north_m, east_m, down_m = self._last.position_ned_m
        landed_m = self._landed_down_m(north_m, east_m)
        self._last = self._last._replace(position_ned_m=(north_m, east_m, landed_m))
        north_0_m, east_0_m, down_0_m = self._origin_m
        self._origin_m = (north_0_m, east_0_m, down_0_m + down_m - landed_m)

    def _set_pose(self, source: str, now_s: float, place: Vector, angles: EulerAngles, velocity: Vector) -> None:
        if source != self.source:
            if self.source is None and self.armed:
                self.height_known = False  # It may have climbed since it was last received disarmed.
            # Another message type has another origin; the vehicle itself has not moved.
            here = self.pose(now_s).position_ned_m
            self._origin_m = (place[0] - here[0], place[1] - here[1], place[2] - here[2])
            self.source = source
        origin = self._origin_m
        position = (place[0] - origin[0], place[1] - origin[1], place[2] - origin[2])
        self._last = Pose(now_s, position, *angles, velocity)
        self.poses_received[source] += 1


def euler_angles(w: float, x: float, y: float, z: float) -> EulerAngles:
    """Euler angles, intrinsic z-y'-x'', of the rotation from body to world.

    Examples
    --------
    >>> half = math.radians(30.0) / 2
    >>> [f"{math.degrees(angle):.1f}" for angle in euler_angles(math.cos(half), 0.0, math.sin(half), 0.0)]
    ['0.0', '30.0', '0.0']
    """
    return EulerAngles(
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def landed_clearance_m(airframe: Airframe) -> float:
    """The clearance at which the lowest sensor is at its minimum range above the ground [m]."""
    return max(sensor.position_m[2] + sensor.sensor_model.minimum_cm / 100 for sensor in airframe.sensors)


class Scene(NamedTuple):
    """What surrounds a vehicle that its autopilot simulates."""

    world: World
    """Ground, objects and air."""
    clearance_m: float
    """Height of the vehicle's reference point above the ground when landed [m]."""
    start_m: tuple[float, float] = (0.0, 0.0)
    """North and east of the vehicle in the world at the first pose [m]."""
    faults: Mapping[str, Sequence[Fault]] = MappingProxyType({})
    """Faults by sensor; times count from the start."""


class Sitl(EmulatedFlight):
    """The real bridge with emulated sensors on a vehicle that its autopilot simulates.

    While the pose is unknown no sensor answers, because a distance would be invented.

    Parameters
    ----------
    airframe
        The vehicle; its link is the one to the autopilot.
    clock
        The system's clock: the autopilot's simulator runs in real time.
    scene
        What surrounds it.
    seed
        Random seed.
    model
        Sensor model for all sensors; None: each sensor's own model file.
    recorder
        Records every stage of every reading, and the truth.
    """

    def __init__(
        self,
        airframe: Airframe,
        clock: Clock,
        scene: Scene,
        seed: int,
        model: SensorModel | None,
        recorder: Records | None,
    ) -> None:
        self.vehicle = AutopilotVehicle(scene.world.elevation_m, scene.clearance_m, scene.start_m)
        super().__init__(airframe, clock, scene.world, self.vehicle.pose, model, recorder)
        self._transport = open_transport(airframe.link.url, clock)
        self._make_bridge(
            self._transport,
            SeedSequence(seed),
            scene.faults,
            self._known_pose,
            on_message=lambda now_s, message: self.vehicle.on_message(now_s - self._start_s, message),
            wanted=dict.fromkeys((TRUTH[airframe.link.autopilot], *ESTIMATE), POSE_RATE_HZ),
            signing=signing_of(airframe.link.signing_key, clock),
        )

    def is_autopilot_connected(self) -> bool:
        """Whether heartbeats of an autopilot are being received."""
        return self.bridge.link.autopilot_is_present

    def _known_pose(self, time_s: float) -> Pose:
        if not self.vehicle.is_known(time_s):
            raise NotAcknowledged
        return self.vehicle.pose(time_s)

    def close(self) -> None:
        """Close the link to the autopilot."""
        self._transport.close()


def start_line(vehicle: AutopilotVehicle) -> str | None:
    """Whether the vehicle's height is known, in one line; None before the first HEARTBEAT."""
    if vehicle.height_known:
        return "the autopilot is disarmed: the vehicle stands on the ground"
    if vehicle.armed:
        return "the autopilot is armed, so the height is not known: no sensor answers until it has been disarmed"
    return None


def status_line(sitl: Sitl) -> str:
    """The present state in one line: time, source of the pose, height, fused distance, each sensor's last answer."""
    now_s = sitl.now_s()
    age_s = sitl.vehicle.age_s(now_s)
    if age_s is None:
        pose = "no pose yet" if sitl.is_autopilot_connected() else "no autopilot yet"
    elif not sitl.vehicle.height_known:
        pose = f"{sitl.vehicle.source}, height unknown until disarmed"
    elif not sitl.vehicle.is_known(now_s):
        pose = f"{sitl.vehicle.source} lost for {age_s:.0f} s"
    else:
        pose = f"{sitl.vehicle.source}, height {sitl.height_m():.2f} m"
    fused = sitl.flight.fused
    is_new = bool(fused.time_s) and now_s - fused.time_s[-1] < POSE_STALE_S
    answers = [f"fused {fused.filtered_m[-1]:.2f} m" if is_new else "fused -"]
    for name, track in sitl.flight.tracks.items():
        if track.time_s:
            filtered_m, raw_m = track.filtered_m[-1], track.raw_m[-1]
            # A sensor that is only fused has no filtered distance of its own, whatever it answers.
            distance_m = raw_m if filtered_m is None and track.why[-1] is None else filtered_m
            answers.append(f"{name} {track.why[-1] if distance_m is None else f'{distance_m:.2f} m'}")
    return f"{now_s:6.1f} s  {pose}  {', '.join(answers)}"
