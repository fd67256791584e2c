"""ArduCopter follows the ground of the standing course by its range finder: four MB1242 and the bridge, and for
comparison an ideal laser."""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import Autopilot, running
from tests.sitl.course import END_M, HEIGHT_M, LEGS, Followed, Leg, Truth, followed, write_course
from tests.sitl.figures import note_followed
from tests.sitl.ground_station import BRIDGE, SITL_LIMIT_S
from tests.sitl.kinds import needs_arducopter
from tests.sitl.laser import ideal_laser
from tests.sitl.msp_sim import msp_sim

pytestmark = [needs_arducopter, pytest.mark.real_time]

RMS_M = 0.30
"""Largest error of the height above the ground over the whole course at 1 m/s, rms [m]: 15 % more than an ideal laser
has, most of which is the time that ArduCopter takes to climb or sink at an edge. A smaller one also fails the laser."""
HOME = "0.001,0.001,0,0"
"""Latitude, longitude [deg], altitude [m], heading [deg]. ArduPilot computes the latitude and longitude of SIM_STATE in
single precision (SIM_Aircraft.cpp, fill_fdm; -fsingle-precision-constant), so at 35 S 149 E the vehicle, and what its
sensors see, would move in steps of 0.42 m north and 1.4 m east; here the steps are 1 cm."""
THERE_M = 0.5
"""A leg ends this near its end [m]: the vehicle slows down there. Less adds seconds of hover, which make the error over
the course smaller."""


@contextlib.contextmanager
def bridge(autopilot: Autopilot, course: Path) -> Iterator[Callable[[], list[float]]]:
    """`msp-sim sitl` above the course; as `ideal_laser`, but the times are those of arrival at the ground station."""
    with msp_sim(autopilot, "--ground", str(course)):
        yield lambda: [time_s for time_s, _ in autopilot.station.all("DISTANCE_SENSOR", BRIDGE)]


def fly(copter: ArduCopter, truth: Truth, north_m: float, speed_m_s: float) -> Leg:
    """Fly to a place north of the start, or until a failsafe ends the flight there."""
    from_s = time.monotonic()
    copter.follow_ground(north_m, HEIGHT_M, speed_m_s)

    def has_ended() -> bool:
        return abs(truth.north_m() - north_m) < THERE_M or not copter.flies_as_commanded()

    copter.station.wait(f"arrival {north_m} m north", has_ended, SITL_LIMIT_S + 2 * END_M / speed_m_s)
    return Leg(speed_m_s, HEIGHT_M, from_s, time.monotonic())


@pytest.mark.parametrize(
    ("distances", "sender"), [("bridge", bridge), ("ideal laser", ideal_laser)], ids=["bridge", "laser"]
)
def test_following_the_ground(
    distances: str,
    sender: Callable[[Autopilot, Path], contextlib.AbstractContextManager[Callable[[], list[float]]]],
    tmp_path: Path,
) -> None:
    copter = ArduCopter(tmp_path, home=HOME)
    course = write_course(tmp_path)
    found: list[tuple[Leg, Followed]] = []
    flies_on = True
    with running(copter):
        copter.get_ready()
        with sender(copter, course) as arrivals_s:
            truth = Truth(copter, course)
            copter.take_off()
            copter.go_to(HEIGHT_M)
            copter.wait_for_hover(HEIGHT_M)
            for north_m, speed_m_s in LEGS:
                leg = fly(copter, truth, north_m, speed_m_s)
                copter.wait(1.0)  # Until SYS_STATUS and texts of the leg's end have arrived.
                failsafes = [text for text in copter.texts(leg.from_s) if "failsafe" in text.lower()]
                sections = followed(copter, truth, arrivals_s(), leg)
                note_followed(copter, distances, leg, sections, failsafes)
                found.append((leg, sections["all"]))
                flies_on = copter.flies_as_commanded()
                if not flies_on:
                    break
            copter.land()
    assert flies_on, copter.texts()[-10:]
    assert all(each.unhealthy_s == 0.0 for _, each in found), found
    assert found[0][1].rms_m < RMS_M
