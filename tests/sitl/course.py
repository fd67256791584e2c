"""The standing course: ground that an autopilot follows by its range finder, and how well it did.

The vehicle flies north from its start: over edges up and down, up a slope, and over boxes, some of which lie below two
of the four sensors. The ground exists for `msp-sim sitl` and for the judge only; the autopilot's own simulator is flat.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from msp_range.config import load_airframe
from msp_sim.flight.scenario import load_scenario
from msp_sim.sitl.sitl import TRUTH, AutopilotVehicle, landed_clearance_m
from msp_sim.world.vehicle import Pose
from tests.sitl.autopilot import Autopilot
from tests.sitl.ground_station import AUTOPILOT, CONFIGS, GroundStation

AIRFRAME = CONFIGS / "loopback.yaml"
HEIGHT_M = 3.0
"""Height above the ground that is flown [m]."""
END_M = 54.0
"""Length of the course [m]. Longer flat stretches make the error over the whole course smaller; with these an ideal
laser is expected to have 0.25 to 0.27 m at 1 m/s."""
LEGS = ((END_M, 1.0), (0.0, 0.25), (END_M, 0.25))
"""Where each leg ends [m north of the start] and its speed [m/s]. At the slower speed an edge is below one pair of
sensors 2 s before it is below the other, at the faster one 0.5 s."""
EDGES = ((3.0, 0.3), (6.5, -0.3), (10.0, 0.6), (14.0, -0.6), (19.0, 1.2))
"""North of the start and rise [m]; on the way back up is down."""
SLOPE_M, GRADE, TREAD_M = (25.0, 37.0), -0.1, 0.2
"""Where the slope begins and ends [m north], and its rise per metre. The simulated ground has one slope everywhere, so
this one is a staircase with treads of this length [m]: its lips lie on the slope, and the nearest of them is at most
2 mm further from a sensor than the slope itself."""
BOXES = (
    {"centre_m": [42.0, 0.0], "size_m": [1.5, 1.5], "height_m": 0.5},
    {"centre_m": [46.0, 0.85], "size_m": [2.0, 0.8], "height_m": 0.5},
    {"centre_m": [50.0, -0.85], "size_m": [2.0, 0.8], "height_m": 0.8},
)
"""Below all four sensors, below the right pair and below the left pair. The last two begin 0.45 m to the side of the
vehicle's middle, whose sensors are 0.20 m to its sides. From 0.35 m to the side on a box is in the beams of the other
pair, too, at its corners: then more than half of the sensors see it, and no ground below the middle."""
SECTIONS = {
    "edges of 0.3 and 0.6 m": (0.0, 16.5),
    "edge of 1.2 m": (16.5, 24.0),
    "slope of 10 %": (24.0, 39.0),
    "boxes of 0.5 and 0.8 m": (39.0, END_M),
    "all": (-1.0, END_M + 1.0),
}
"""Part of the course -> from where to where [m north]."""
SILENCE_S = 0.5
"""A longer gap between two distances counts as a silence [s]: ArduPilot then has no data (AP_RangeFinder_MAVLink.cpp).
PX4's EKF2 stops using the range after 0.4 s."""


def write_course(folder: Path) -> Path:
    """Write the ground as a scenario for `msp-sim sitl --ground`, and return the file's path."""
    first_m, last_m = SLOPE_M
    treads_m = np.arange(first_m, last_m - TREAD_M / 2, TREAD_M)
    steps = sorted([*EDGES, *((at_m, GRADE * TREAD_M) for at_m in treads_m.tolist())])
    scenario = {
        "name": "course",
        "airframe": str(AIRFRAME),
        "duration_s": 600,
        "flight": {"altitude": [{"kind": "climb", "to_m": 1.0}, {"kind": "land"}]},
        "ground": {
            "surface": "concrete",
            "steps": [{"at_m": round(at_m, 3), "rise_m": round(rise_m, 3)} for at_m, rise_m in steps],
            "boxes": [{"surface": "crate", **box} for box in BOXES],
        },
    }
    path = folder / "course.yaml"
    path.write_text(yaml.safe_dump(scenario))
    return path


class Truth:
    """Where the autopilot's simulator has the vehicle over the course.

    Parameters
    ----------
    autopilot
        It runs, and its vehicle stands at the start.
    course
        The file of `write_course`.

    Attributes
    ----------
    poses
        One for each message with the simulator's truth; times are those of arrival [s, monotonic].
    """

    def __init__(self, autopilot: Autopilot, course: Path) -> None:
        self.world = load_scenario(course).world()
        self._clearance_m = landed_clearance_m(load_airframe(AIRFRAME))
        self._autopilot = autopilot
        self._station: GroundStation | None = None
        self._read = 0
        self._vehicle: AutopilotVehicle
        self.poses: list[Pose] = []

    def pose(self, now_s: float) -> Pose:
        """The pose at a time [s, monotonic], after everything that has arrived."""
        if self._station is not self._autopilot.station:
            # The autopilot runs for the first time, or was started anew.
            self._station, self._read, self.poses = self._autopilot.station, 0, []
            self._vehicle = AutopilotVehicle(self.world.elevation_m, self._clearance_m)
        received = self._station.received
        end = len(received)
        for time_s, message in received[self._read : end]:
            if message.get_srcComponent() == AUTOPILOT:
                self._vehicle.on_message(time_s, message)
                if message.get_type() in TRUTH.values():
                    self.poses.append(self._vehicle.pose(time_s))
        self._read = end
        return self._vehicle.pose(now_s)

    def north_m(self) -> float:
        """How far north of the start the vehicle is now [m]."""
        return self.pose(time.monotonic()).position_ned_m[0]

    def range_m(self, pose: Pose) -> float:
        """What the autopilot's vertical distance to the ground should be [m]; see `Autopilot.standing_m`."""
        return self.world.height_m(pose) - self._clearance_m + self._autopilot.standing_m


class Leg(NamedTuple):
    """A flight over the course in one direction.

    Attributes
    ----------
    speed_m_s
        Commanded speed [m/s].
    range_m
        The distance to the ground that the autopilot should keep [m].
    from_s, to_s
        When it began and ended [s, monotonic].
    """

    speed_m_s: float
    range_m: float
    from_s: float
    to_s: float


class Followed(NamedTuple):
    """How the autopilot followed the ground of one section in one leg.

    Attributes
    ----------
    rms_m
        Root mean square of the error of its height above the true ground [m]. At an edge that error is the whole rise
        until the vehicle has climbed or sunk.
    unhealthy_s
        For how long it did not go by its range finder [s].
    gap_s
        Longest time between two distances [s].
    silences
        How many were longer than `SILENCE_S`.
    """

    rms_m: float
    unhealthy_s: float
    gap_s: float
    silences: int


def followed(autopilot: Autopilot, truth: Truth, arrivals_s: list[float], leg: Leg) -> dict[str, Followed]:
    """Judge a leg that has been flown, section by section; sections that were not reached are left out.

    Parameters
    ----------
    autopilot, truth, leg
        What has flown, and what.
    arrivals_s
        Times of all distances that were sent to it [s, monotonic].
    """
    truth.pose(leg.to_s)
    poses = [pose for pose in truth.poses if leg.from_s <= pose.time_s <= leg.to_s]
    time_s = [pose.time_s for pose in poses]
    north_m = np.array([pose.position_ned_m[0] for pose in poses])
    error_m = np.array([truth.range_m(pose) for pose in poses]) - leg.range_m
    health_s, good = np.array(autopilot.healthy()).T
    lost_s = np.where(good[:-1], 0.0, np.diff(health_s))
    gap_s = np.diff(arrivals_s)
    # A loss or gap belongs to the section where it begins; those outside the leg are nowhere.
    lost_m = np.interp(health_s[:-1], time_s, north_m, np.nan, np.nan)
    gap_m = np.interp(arrivals_s[:-1], time_s, north_m, np.nan, np.nan)
    result = {}
    for section, (first_m, last_m) in SECTIONS.items():
        here, lost, gap = ((first_m <= each) & (each < last_m) for each in (north_m, lost_m, gap_m))
        if here.any():
            result[section] = Followed(
                float(np.sqrt(np.mean(error_m[here] ** 2))),
                float(lost_s[lost].sum()),
                float(gap_s[gap].max(initial=0.0)),
                int((gap_s[gap] > SILENCE_S).sum()),
            )
    return result
