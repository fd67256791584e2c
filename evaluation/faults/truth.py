"""What is true below the vehicle at any time of a flight, as one distance along its down axis or as several.

A simulation's world and vehicle enter. Over level, sloped or rough ground one number is true. Where steps or boxes are
near, each ground that a sensor or the down axis meets, or has met within the last second, is a height that a stream may
state: no number is wrong for following one sensor over an edge later than another.
"""

import math
from collections.abc import Sequence

from msp_range.config import Airframe
from msp_range.geometry import Vector, dot, rotation_matrix
from msp_sim.flight.scenario import Scenario
from msp_sim.world.vehicle import Vehicle
from msp_sim.world.world import MountedBeam, World

GRID_S = 0.05
"""Time between two looks at grounds that change under way [s]; at 1.5 m/s the vehicle moves 7 cm."""
MEMORY_S = 1.0
"""A ground that was met this long ago still counts [s]."""
UNEVEN_M = 0.08
"""Grounds this far apart are an object, a hole or a step [m]; the bridge reports none below 12 cm."""
MOVES_M_S = 0.2
"""A vehicle that climbs, sinks or travels faster than this does not hover [m/s]; a hover drifts by less."""
MOTIONS = ("hover", "climb", "cruise", "standing")
"""What a vehicle does; a descent is a climb."""
STANDS_M = 0.01
"""Feet this close to the ground stand on it [m]."""
UNEVEN_MEMORY_S = 2.0
"""How long after such a place an object or hole may still be reported [s]."""


def nearest_error_m(distance_m: float, trues_m: Sequence[float]) -> float:
    """A distance minus the true one nearest to it [m]."""
    return min([distance_m - true_m for true_m in trues_m], key=abs)


class Truth:
    """The distance from the fused stream's reference point along the down axis.

    With h the height of the reference point over the ground's mean plane, and e the down axis, a ground with relief r
    over that plane is at d = (h - r) / (e_d + g . e), g the plane's rise per metre.

    With ``only_below`` the ground that the down axis meets is the only one that is true: objects below some sensors
    are objects.
    """

    def __init__(self, scenario: Scenario, world: World, vehicle: Vehicle, *, only_below: bool = False) -> None:
        airframe: Airframe = scenario.airframe
        ground = scenario.ground
        self._world, self._vehicle, self._only_below = world, vehicle, only_below
        self._reference_m = airframe.send.fused.reference_down_m if airframe.send.fused else 0.0
        grade = math.tan(math.radians(ground.slope_deg))
        uphill_rad = math.radians(ground.uphill_deg)
        self._grade = (grade * math.cos(uphill_rad), grade * math.sin(uphill_rad))
        self._beams = [
            MountedBeam(sensor.position_m, sensor.boresight, sensor.sensor_model.beam.half_angle_rad)
            for sensor in airframe.downward
        ]
        self._reliefs: list[frozenset[float]] = []
        if ground.steps or ground.boxes:
            self._reliefs = [self._met(i * GRID_S) for i in range(math.ceil(scenario.duration_s / GRID_S) + 1)]

    def distances_m(self, time_s: float) -> list[float]:
        """Every distance that is true at a time of the flight [m]: the first is the down axis' own."""
        pose = self._vehicle.pose(time_s)
        below_m = self._world.down_axis_m(pose)
        own_m = math.inf if below_m is None else below_m - self._reference_m
        if self._only_below or not self._reliefs:
            return [own_m]
        height_m, rate, _ = self._reference(time_s)
        return [own_m, *((height_m - relief_m) / rate for relief_m in self._recent(time_s, MEMORY_S))]

    def motion(self, time_s: float) -> tuple[float, str]:
        """Lean of the vehicle [rad], and which of `MOTIONS` it does."""
        pose = self._vehicle.pose(time_s)
        north_m_s, east_m_s, down_m_s = pose.velocity_ned_m_s
        lean_rad = math.acos(min(math.cos(pose.roll_rad) * math.cos(pose.pitch_rad), 1.0))
        if self._vehicle.pose(time_s).clearance_m < STANDS_M:
            return lean_rad, "standing"
        if abs(down_m_s) > MOVES_M_S:
            return lean_rad, "climb"
        return lean_rad, "cruise" if math.hypot(north_m_s, east_m_s) > MOVES_M_S else "hover"

    def is_uneven(self, time_s: float) -> bool:
        """Whether an object, a hole or a step is below the vehicle, or was a moment ago."""
        reliefs = self._recent(time_s, UNEVEN_MEMORY_S)
        return bool(reliefs) and max(reliefs) - min(reliefs) > UNEVEN_M

    def _recent(self, time_s: float, memory_s: float) -> frozenset[float]:
        last = round(time_s / GRID_S)
        found = self._reliefs[max(last - round(memory_s / GRID_S), 0) : last + 1]
        return frozenset().union(*found)

    def _reference(self, time_s: float) -> tuple[float, float, tuple[Vector, Vector, Vector]]:
        """Height of the reference point over the plane [m], how much of it a metre of the down axis loses, rotation."""
        pose = self._vehicle.pose(time_s)
        rotation = rotation_matrix(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
        down = (rotation[0][2], rotation[1][2], rotation[2][2])
        height_m = self._over_plane_m(pose.position_ned_m)
        rate = self._rate(down)
        return height_m - self._reference_m * rate, rate, rotation

    def _over_plane_m(self, position: Vector) -> float:
        return -position[2] - self._grade[0] * position[0] - self._grade[1] * position[1]

    def _rate(self, axis: Vector) -> float:
        return axis[2] + self._grade[0] * axis[0] + self._grade[1] * axis[1]

    def _met(self, time_s: float) -> frozenset[float]:
        """Reliefs that the down axis and the sensors meet [m], in whole centimetres."""
        pose = self._vehicle.pose(time_s)
        height_m, rate, rotation = self._reference(time_s)
        below_m = self._world.down_axis_m(pose)
        reliefs = set() if below_m is None else {height_m - (below_m - self._reference_m) * rate}
        for beam in self._beams:
            offset = tuple(dot(row, beam.position_m) for row in rotation)
            north_m, east_m, down_m = (a + b for a, b in zip(pose.position_ned_m, offset, strict=True))
            elevation_m = self._world.elevation_m(north_m, east_m)
            reliefs.add(self._over_plane_m((north_m, east_m, -elevation_m)))
            ping = self._world.ping(pose, beam)
            if ping.has_echo and ping.slant_range_cm is not None:
                axis = (
                    dot(rotation[0], beam.boresight),
                    dot(rotation[1], beam.boresight),
                    dot(rotation[2], beam.boresight),
                )
                over_m = self._over_plane_m((north_m, east_m, down_m))
                reliefs.add(over_m - ping.slant_range_cm / 100 * self._rate(axis))
        return frozenset(round(relief_m, 2) for relief_m in reliefs)
