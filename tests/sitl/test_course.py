"""ArduCopter follows the ground of the standing course by its range finder: four MB1242 and the bridge, and for
comparison an ideal laser."""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import Autopilot, running
from tests.sitl.course import END_M, HEIGHT_M, SPEEDS_M_S, Followed, Leg, Truth, followed, write_course
from tests.sitl.figures import note_followed
from tests.sitl.ground_station import BRIDGE, SITL_LIMIT_S
from tests.sitl.kinds import needs_arducopter
from tests.sitl.laser import ideal_laser
from tests.sitl.msp_sim import msp_sim

pytestmark = [needs_arducopter, pytest.mark.real_time]

RMS_M = 0.30
"""Goal for the error of the height above the ground over the whole course at 1 m/s [m]."""
THERE_M = 0.5
"""It has arrived when it is this near; it slows down before that."""


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
    copter = ArduCopter(tmp_path)
    course = write_course(tmp_path)
    found: list[tuple[Leg, Followed]] = []
    failsafes: list[str] = []
    with running(copter):
        copter.get_ready()
        with sender(copter, course) as arrivals_s:
            truth = Truth(copter, course)
            copter.take_off()
            copter.go_to(HEIGHT_M)
            copter.wait_for_hover(HEIGHT_M)
            for north_m, speed_m_s in zip((END_M, 0.0), SPEEDS_M_S, strict=True):
                leg = fly(copter, truth, north_m, speed_m_s)
                copter.wait(1.0)  # Until SYS_STATUS and texts of the leg's end have arrived.
                failsafes = [text for text in copter.texts(leg.from_s) if "failsafe" in text.lower()]
                sections = followed(copter, truth, arrivals_s(), leg)
                note_followed(copter, distances, leg, sections, failsafes)
                found.append((leg, sections["all"]))
                if failsafes:
                    break
            copter.land()
    assert not failsafes
    assert copter.flies_as_commanded() or len(found) == len(SPEEDS_M_S)
    assert all(each.unhealthy_s == 0.0 for _, each in found), found
    assert found[0][1].rms_m < RMS_M
