"""What the bridge says of two real autopilots: which distances they take, and when their estimator does not follow."""

import math
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from msp_range.recording.reader import Recording
from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import running
from tests.sitl.ground_station import CONFIGS
from tests.sitl.kinds import needs_arducopter, needs_px4
from tests.sitl.msp_sim import msp_sim
from tests.sitl.px4 import Px4

pytestmark = pytest.mark.real_time

OFF_S, LASTS_S = 90.0, 25.0
"""From the start of `msp-sim sitl`, when PX4 hovers, all sensors read 2 m too near for this long [s]."""
SENSORS = ("front_left", "front_right", "rear_left", "rear_right")


def said(folder: Path) -> list[tuple[float, dict[str, Any]]]:
    """The recording's `/acceptance`: times [s] and messages."""
    (path,) = folder.glob("*.mcap")
    return [(each.time_s, each.message) for each in Recording(path) if each.topic == "/acceptance"]


@needs_px4
def test_what_px4_rejects_of_two_metres_is_said_and_then_the_terrain_is_set_anew(tmp_path: Path) -> None:
    faults = [
        f"{{sensor: {each}, kind: offset, from_s: {OFF_S}, to_s: {OFF_S + LASTS_S}, offset_cm: -200}}"
        for each in SENSORS
    ]
    ground = tmp_path / "off.yaml"
    head = ["name: two_metres", f"airframe: {CONFIGS / 'loopback.yaml'}", "duration_s: 600"]
    flight = "flight: {altitude: [{kind: climb, to_m: 1.0}, {kind: land}]}"
    ground.write_text("\n".join([*head, flight, "faults:", *(f"  - {each}" for each in faults)]))
    px4 = Px4(tmp_path)
    with running(px4):
        px4.get_ready()
        with msp_sim(px4, "--ground", str(ground), "--record", str(tmp_path / "record")) as simulation:
            px4.take_off()
            remaining_s = simulation.start_s + OFF_S + LASTS_S - time.monotonic()
            assert remaining_s > LASTS_S, "the computer is too slow for OFF_S"
            px4.wait(remaining_s)
            px4.land()
    found = said(tmp_path / "record")
    (begin_s,) = [time_s for (time_s, first), (_, then) in pairwise(found) if stepped(first, then)][:1]
    # EKF2 takes none of it, or a part, before it rejects the rest.
    rejected = [time_s for time_s, message in found if "m off: rejected" in message["text"]]
    reset = [time_s for time_s, message in found if "terrain reset by +" in message["text"]]
    assert not [message for time_s, message in found if time_s < begin_s and "off" in message["text"]]
    assert begin_s < rejected[0] < begin_s + 2.0
    assert rejected[0] < reset[0] < rejected[0] + 8.0


def stepped(first: dict[str, Any], then: dict[str, Any]) -> bool:
    """Whether PX4's own distance has become two metres shorter between two messages."""
    return bool(first.get("received_m", 0.0) - then.get("received_m", math.inf) > 1.5)


@needs_arducopter
def test_arducopter_has_the_distance_and_does_not_report_its_estimator(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path)
    with running(copter):
        copter.get_ready()
        with msp_sim(copter, "--record", str(tmp_path / "record")):
            copter.station.wait("a healthy range finder", lambda: any(good for _, good in copter.healthy()))
            copter.wait(5.0)
    last = said(tmp_path / "record")[-1][1]
    assert last["text"].endswith("m, healthy; its estimator: not reported by this autopilot")
    assert last["received_m"] == pytest.approx(0.20, abs=0.02)


@needs_arducopter
def test_an_arducopter_that_lands_by_range_reports_its_ratio(tmp_path: Path) -> None:
    """`EK3_RNG_USE_HGT` makes range its source of height only while it takes off or lands (baro_ground_effect.cpp).

    The ratio is then that of the last reading before (`EstimateTerrainOffset` is left out), and does not change.
    """
    copter = ArduCopter(tmp_path)
    copter.top_m = 3.0
    with (tmp_path / "defaults.parm").open("a") as parameters:
        parameters.write("EK3_RNG_USE_HGT 70\n")
    with running(copter):
        copter.get_ready()
        with msp_sim(copter, "--record", str(tmp_path / "record")):
            copter.station.wait("a healthy range finder", lambda: any(good for _, good in copter.healthy()))
            copter.take_off()
            copter.wait(5.0)
            copter.land()
    found = said(tmp_path / "record")
    texts = [message["text"] for _, message in found]
    ratios = [message["ratio"] for _, message in found if "ratio" in message]
    hovering = next(i for i, (_, message) in enumerate(found) if message.get("received_m", 0.0) > 2.9)
    assert texts[hovering].endswith("its estimator: not reported by this autopilot")
    landing = [text for text in texts[hovering:] if "its estimator: ratio 0.0" in text]
    assert len(landing) > 3, texts[hovering:]
    assert 0.0 < ratios[-1] < 0.1
    assert ratios[-len(landing) :] == [ratios[-1]] * len(landing)


@needs_arducopter
def test_an_arducopter_whose_range_finder_looks_elsewhere_receives_nothing(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path)
    parameters = tmp_path / "defaults.parm"
    parameters.write_text(parameters.read_text().replace("RNGFND1_ORIENT 25", "RNGFND1_ORIENT 0"))
    with running(copter), msp_sim(copter, "--record", str(tmp_path / "record")):
        copter.wait(12.0)
    assert "RNGFND1_ORIENT 25" in said(tmp_path / "record")[-1][1]["text"]
