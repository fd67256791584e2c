"""An ideal laser: the reference for what a range finder can do for an autopilot on the course."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_range.config import load_airframe
from tests.sitl.autopilot import Autopilot
from tests.sitl.course import AIRFRAME, Truth
from tests.support.known import known

PERIOD_S = 0.05
"""ArduPilot reads its range finders at 20 Hz."""
MIN_CM, MAX_CM = 5, 4000


@contextlib.contextmanager
def ideal_laser(autopilot: Autopilot, course: Path) -> Iterator[Callable[[], list[float]]]:
    """Send the autopilot the true distance along its down axis at 20 Hz, without error or delay.

    Parameters
    ----------
    autopilot
        It runs, and its vehicle stands at the start.
    course
        The file of `write_course`.

    Yields
    ------
    callable
        Gives the times at which distances have been sent so far [s, monotonic].
    """
    truth = Truth(autopilot, course)
    reference_down_m = known(load_airframe(AIRFRAME).send.fused).reference_down_m
    sent_s: list[float] = []
    ended = threading.Event()

    def send() -> None:
        next_s = time.monotonic()
        while not ended.wait(max(next_s - time.monotonic(), 0.0)):
            next_s += PERIOD_S
            now_s = time.monotonic()
            range_cm = round(100 * (known(truth.world.down_axis_m(truth.pose(now_s))) - reference_down_m))
            down, laser = mavlink.MAV_SENSOR_ROTATION_PITCH_270, mavlink.MAV_DISTANCE_SENSOR_LASER
            fields = (int(1000 * now_s) % 2**32, MIN_CM, MAX_CM, range_cm, laser, 1, down, 0)
            autopilot.station.send(mavlink.MAVLink_distance_sensor_message(*fields))
            sent_s.append(now_s)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield lambda: list(sent_s)
    finally:
        ended.set()
        thread.join()
