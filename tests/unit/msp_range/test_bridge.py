"""From the bus to DISTANCE_SENSOR: when messages go out, and every field of them."""

import errno
import json
import math
import random
from collections import Counter, defaultdict
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from pymavlink.dialects.v20 import common
from scipy.spatial.transform import Rotation

from msp_range.acoustics.air import speed_of_sound
from msp_range.bus import BusError
from msp_range.config import load_airframe
from msp_range.recording.topics import schema_of
from msp_sim.device.device import Fault
from tests.support.bench import CALIBRATED_C, FOUR_DOWN, FUSED_ID, START_S, Bench, airframe, one_down, sensor
from tests.support.shipped import CONFIGS

NAMES = "abcd"
PREDICTED_VIEW_DEG = 22.6
"""Field of view from 3 m on, which nobody measured: the sonar equation through the measured angles."""
PX4 = {"url": "udpout:127.0.0.1:14550", "autopilot": "px4"}
HEARTBEAT = common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
AROUND = [sensor(name, number, 0.0, 90.0 * (number - 1)) for number, name in enumerate(NAMES, start=1)]
READY_S = 0.020
"""From ping to answer, besides the time of flight: as the device and the shipped sensor model have it."""


def last(bench: Bench, stream: int = FUSED_ID) -> Any:
    return [message for _, message in bench.sent() if message.id == stream][-1]


def test_the_fused_message_goes_out_on_each_reading() -> None:
    bench = Bench(airframe(), 300).fly(19.95)
    times_s = [time_s for time_s, _ in bench.sent()]
    answered_s = [ping_s + READY_S + 300 * 58e-6 for ping_s, _, _ in bench.pings]
    # The first reading waits for a second one that agrees with it.
    assert len(times_s) == 199
    # The sensor is asked every 2 ms.
    assert all(0 <= sent_s - there_s <= 0.003 for sent_s, there_s in zip(times_s, answered_s[1:], strict=True))


@pytest.mark.parametrize("dead", ["b", "bd", "abd"])
def test_the_fused_message_goes_out_on_each_turn_while_a_sensor_works(dead: str) -> None:
    """The turns of the dead go to the living; where two of these live, a retry is an occasion to send as well."""
    bench = Bench(airframe(), 300, absent=dead).fly(20.0)
    assert set(bench.distances_cm()) == {300}
    assert 160 <= len(bench.distances_cm(from_s=4.0)) <= 160 + 8 * len(dead)
    assert set(qualities(bench, 1.0, 20.0)) == {100}, "the distance is as good without them"


@pytest.mark.parametrize("late_s", [0.005, 0.020, 0.030])
@pytest.mark.parametrize("reading_cm", [20, 100, 400])
@pytest.mark.parametrize("late", ["write", "read"])
def test_a_busy_computer_makes_no_answer_impossible(
    late_s: float, reading_cm: int, late: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sensor has its ping when the write is on the bus, and may answer while the program waits for its turn."""
    bench = Bench(airframe(), reading_cm)
    write, read = bench.bus.write, bench.bus.read

    def stand_still(verb: str) -> None:
        if verb == late:
            bench.clock.sleep_until(bench.clock.now() + late_s)

    def late_write(address: int, data: bytes) -> None:
        write(address, data)
        stand_still("write")

    def late_read(address: int, count: int) -> bytes:
        stand_still("read")
        return read(address, count)

    monkeypatch.setattr(bench.bus, "write", late_write)
    monkeypatch.setattr(bench.bus, "read", late_read)
    bench.fly(5.0)
    assert bench.reported() == ["Range: all 4 sensors good"]
    assert {reason for name in "abcd" for reason in bench.rejected(name)} <= {"unconfirmed"}
    assert len(bench.distances_cm(from_s=1.0)) == pytest.approx(40, abs=12)


def test_without_sensors_nothing_goes_out() -> None:
    bench = Bench(airframe(), 300, absent=NAMES).fly(9.95)
    assert bench.sent() == []
    assert len(bench.steps) == 100


def test_above_the_maximum_ranges_at_random_do_not_disagree() -> None:
    """An MB1242 answers 765 where it has no echo; a range now and then is of nothing."""
    draw = random.Random(1)
    bench = Bench(airframe(), lambda name, time_s: draw.randint(30, 700) if draw.random() < 0.1 else 765).fly(40.0)
    codes = Bench(airframe(), lambda name, time_s: 765 if name == "d" or time_s < 5.0 else 255).fly(20.0)
    assert not [text for text in bench.texts() + codes.texts() if "disagree" in text]


@pytest.mark.parametrize(
    ("silent", "dead", "tells"),
    [("a", "", 300), ("ab", "", 300), ("abc", "", 300), ("abcd", "", 766), ("ab", "c", 300), ("a", "bcd", 766)],
)
def test_no_echo_of_all_sensors_that_work_is_above_the_maximum_and_one_that_sees_the_ground_knows_better(
    silent: str, dead: str, tells: int
) -> None:
    bench = Bench(airframe(), lambda name, time_s: 765 if name in silent else 300, absent=dead).fly(10.0)
    assert set(bench.distances_cm(from_s=2.0)) == {tells}
    # One that sees the ground alone speaks for its own readings only; the dead give their slots to the others.
    alone = len(set(NAMES) - set(silent + dead)) == 1
    least = 80 // (4 - len(dead)) - 1 if alone else 79
    assert least <= len(bench.distances_cm(from_s=2.0)) <= least + 2 + 4 * len(dead)
    if tells > 765:
        message = last(bench)
        assert (message.signal_quality, message.covariance) == (1, 255)
        assert math.degrees(message.horizontal_fov) == pytest.approx(PREDICTED_VIEW_DEG, abs=0.1)


@pytest.mark.parametrize(
    ("autopilot", "pitch_deg", "tells"), [("ardupilot", 0, 766), ("px4", 0, 765), ("px4", -90, 766)]
)
def test_no_echo_as_each_autopilot_understands_it(autopilot: str, pitch_deg: float, tells: int) -> None:
    link = {"url": "udpout:127.0.0.1:14550", "autopilot": autopilot}
    vehicle = airframe([sensor("a", 1, pitch_deg)], link=link, send={"sensors": ["a"]})
    bench = Bench(vehicle, 765).fly(2.0)
    assert set(bench.distances_cm(1)) == {tells}
    assert last(bench, 1).max_distance == 765
    assert list(bench.bridge.health.sensor_faults) == []


@pytest.mark.parametrize("to", ["a", FUSED_ID])
@pytest.mark.parametrize(
    ("reading_cm", "view_deg"),
    [(20, 46.8), (50, 46.8), (75, 41.4), (100, 36.0), (150, 28.8), (200, 25.2)],
)
def test_the_field_of_view_is_twice_the_breakaway_angle_at_the_range(reading_cm: int, view_deg: float, to: Any) -> None:
    send = {"sensors": ["a"]} if to == "a" else {"fused": {"id": FUSED_ID}}
    message = last(Bench(one_down(send=send), reading_cm).fly(2.0), 1 if to == "a" else FUSED_ID)
    assert message.current_distance == reading_cm
    assert math.degrees(message.horizontal_fov) == pytest.approx(view_deg, abs=1e-3)
    assert message.vertical_fov == message.horizontal_fov


@pytest.mark.parametrize(
    ("reading_cm", "view_deg"), [(250, 23.1), (300, PREDICTED_VIEW_DEG), (764, PREDICTED_VIEW_DEG)]
)
def test_beyond_the_measured_table_the_field_of_view_is_the_sonar_equations(reading_cm: int, view_deg: float) -> None:
    message = last(Bench(one_down(), reading_cm).fly(2.0), 1)
    assert math.degrees(message.horizontal_fov) == pytest.approx(view_deg, abs=0.1)
    assert message.signal_quality == 100


@pytest.mark.parametrize("to", ["a", FUSED_ID])
@pytest.mark.parametrize("reading_cm", [101, 400])
def test_a_beams_angle_that_is_only_assumed_is_no_reason_to_doubt_the_distance(
    tmp_path: Path, reading_cm: int, to: Any
) -> None:
    """Two breakaway angles cannot tell the three parameters of a sonar equation: the last of them is held."""
    model = yaml.safe_load((CONFIGS / "sensors" / "mb1242.yaml").read_text(encoding="utf-8"))
    model["breakaway"] = model["breakaway"][:2]
    (tmp_path / "two_angles.yaml").write_text(yaml.safe_dump(model), encoding="utf-8")
    send = {"sensors": ["a"]} if to == "a" else {"fused": {"id": FUSED_ID}}
    vehicle = airframe([FOUR_DOWN[0] | {"model": str(tmp_path / "two_angles.yaml")}], send=send, filters=[])
    message = last(Bench(vehicle, reading_cm).fly(2.0), 1 if to == "a" else FUSED_ID)
    assert (message.current_distance, message.signal_quality) == (reading_cm, 100)
    assert math.degrees(message.horizontal_fov) == pytest.approx(36.0, abs=0.3)


SIGMA2_CM2 = 1.9445**2 + 1 / 12
"""Of one reading: the sensor model's, and the rounding to whole centimetres."""


@pytest.mark.parametrize(
    ("filters", "covariance"),
    [
        ([], SIGMA2_CM2),
        ([{"filter": "moving_average", "window": 2}], SIGMA2_CM2 / 2),
        ([{"filter": "median", "window": 3}], SIGMA2_CM2 * math.pi / 2 / 3),
        ([{"filter": "kalman", "measurement_variance_cm2": 400, "acceleration_std_m_s2": 100}], 254),
    ],
)
def test_the_covariance_is_the_filters_own_rounded_up(filters: list[dict[str, Any]], covariance: float) -> None:
    assert last(Bench(one_down(filters=filters), 300).fly(4.0), 1).covariance == math.ceil(covariance)


AIR_CM2 = (500 * 12 / (2 * (CALIBRATED_C + 273.15))) ** 2
"""Of 5 m where nobody knows the air to better than 12 deg C."""


@pytest.mark.parametrize("filters", [[], [{"filter": "moving_average", "window": 5}], [{"filter": "changepoint"}]])
def test_the_covariance_of_a_single_stream_has_the_airs_on_top_of_its_filters(filters: list[dict[str, Any]]) -> None:
    """However long a filter averages: the air's error is the same in all its readings."""
    exact = {"temperature": {"fixed_c": CALIBRATED_C, "fixed_std_c": 0.0}}
    unknown = {"temperature": {"fixed_c": CALIBRATED_C}}
    own_m2 = [step.filtered.estimate for step in Bench(one_down(filters=filters, **exact), 500).fly(10.0).steps]
    bench = Bench(one_down(filters=filters, **unknown), 500).fly(10.0)
    assert [step.filtered.estimate for step in bench.steps] == own_m2
    assert own_m2[-1] is not None
    assert last(bench, 1).covariance == math.ceil(AIR_CM2 + 1e4 * own_m2[-1].variance_m2)


def test_the_covariance_of_the_fused_stream_has_the_airs_however_many_sensors_agree() -> None:
    bench = Bench(airframe(temperature={"fixed_c": CALIBRATED_C}), 500).fly(20.0)
    fused = [step.fused for step in bench.steps if step.fused is not None][-1]
    assert fused.variance_m2 < 1e-4
    assert last(bench).covariance == math.ceil(AIR_CM2 + 1e4 * fused.variance_m2)


def test_what_nobody_knows_of_the_air_lets_no_more_readings_through() -> None:
    """An outlier of 60 cm is one, with a thermometer and without."""

    def world(name: str, time_s: float) -> int:
        return 440 if name == "b" and 5.0 < time_s < 5.5 else 500

    for fixed_std_c in (0.0, 12.0):
        temperature = {"fixed_c": CALIBRATED_C, "fixed_std_c": fixed_std_c}
        bench = Bench(airframe(temperature=temperature), world).fly(8.0)
        assert set(bench.distances_cm()) == {500}
        assert bench.rejected("b") == {"outlier": 1}


def test_the_covariance_of_canted_sensors_covers_slant_and_nearest_point() -> None:
    canted = [sensor(name, number, -60.0, 90.0 * number) for number, name in enumerate(NAMES, start=1)]
    fused = {"id": FUSED_ID, "sensors": list(NAMES)}
    message = last(Bench(airframe(canted, filters=[], send={"fused": fused}), 150).fly(4.0))
    slant_cm = 150 * math.cos(math.radians(30))
    assert message.current_distance == round((150 + slant_cm) / 2)
    # What the readings leave is less than one of them has, and what they share does not average out.
    shared_cm2 = ((150 - slant_cm) / 2) ** 2
    assert shared_cm2 < message.covariance <= math.ceil(shared_cm2 + SIGMA2_CM2)


def qualities(bench: Bench, from_s: float, to_s: float, stream: int = FUSED_ID) -> list[int]:
    return [
        message.signal_quality for time_s, message in bench.sent() if message.id == stream and from_s <= time_s < to_s
    ]


@pytest.mark.parametrize("silent", ["b", "bd", "abd"])
def test_missed_echoes_do_not_lower_the_quality(silent: str) -> None:
    bench = Bench(airframe(), lambda name, time_s: 765 if name in silent and time_s > 3.0 else 300).fly(8.0)
    assert set(qualities(bench, 1.0, 8.0)) == {100}
    single = Bench(one_down(), lambda name, time_s: 765 if 2.0 <= time_s < 2.25 else 300).fly(5.0)
    assert set(qualities(single, 0.0, 5.0, 1)) == {1, 100}, "1 is that of no echo"
    assert len(single.distances_cm(1, 2.0, 2.3)) == qualities(single, 2.0, 2.3, 1).count(1) == 3


def test_one_outlier_leaves_the_quality_to_ardusub_and_more_within_a_second_do_not() -> None:
    """Of sensors that otherwise see the ground, never two in a row; readings scatter by less than stated."""
    from_s = [("a", 5.0), ("d", 10.0), ("b", 10.3), ("a", 10.6), ("c", 10.9)]

    def world(name: str, time_s: float) -> int:
        if from_s and name == from_s[0][0] and time_s > from_s[0][1]:
            del from_s[0]
            return 120
        return 298 + round(10 * time_s) * 7 % 5

    bench = Bench(airframe(), world).fly(16.0)
    assert all(299 <= each_cm <= 301 for each_cm in bench.distances_cm(from_s=2.0))
    assert 90 <= min(qualities(bench, 5.0, 5.6)) < 100
    assert min(qualities(bench, 10.9, 11.5)) < 90
    assert set(qualities(bench, 2.0, 4.9) + qualities(bench, 13.0, 16.0)) == {100}


def test_two_of_four_that_see_another_ground_lower_the_quality_until_the_belief_explains_them() -> None:
    """At first they contradict the ground; then they see something on it, which is the ground one time in 50."""
    bench = Bench(airframe(), lambda name, time_s: 200 if name in "cd" and 5.0 < time_s < 10.0 else 300).fly(14.0)
    assert set(bench.distances_cm()) == {300}
    assert set(qualities(bench, 1.0, 5.0)) == {100}
    assert max(qualities(bench, 5.6, 6.8)) < 90
    assert {97, 98, 99}.issuperset(qualities(bench, 7.5, 9.9))
    assert set(qualities(bench, 12.5, 14.0)) == {100}


def test_the_first_distance_has_the_quality_that_two_readings_give_it() -> None:
    first, *others = qualities(Bench(airframe(), 300).fly(4.0), 0.0, 4.0)
    assert 80 <= first < 98
    assert others[-1] == 100


def test_at_an_edge_no_sensor_gets_more_turns_than_the_others() -> None:
    """The first that sees something else is asked once more; further turns would delay the readings that decide."""
    bench = Bench(airframe(), lambda name, time_s: 200 if name in "cd" and 5.0 < time_s < 9.0 else 300).fly(9.0)
    turns = [name for ping_s, name, _ in bench.pings if ping_s > 5.0]
    asked = next(i for i in range(2, len(turns)) if turns[i] == turns[i - 2])
    del turns[asked]
    assert turns == [NAMES[(NAMES.index(turns[0]) + i) % 4] for i in range(len(turns))]


def test_a_sensor_that_sees_something_else_gets_one_more_turn() -> None:
    """More would delay the readings of those that see the ground: at an edge it would be lost."""
    bench = Bench(airframe(), lambda name, time_s: 240 if name == "c" and time_s > 5.0 else 300).fly(9.0)
    turns_s = [ping_s for ping_s, name, _ in bench.pings if name == "c"]
    assert sum(late - early < 0.3 for early, late in pairwise(turns_s)) == 1


def test_an_object_below_one_sensor_leaves_the_quality_of_the_ground_and_has_a_good_one_itself() -> None:
    bench = Bench(airframe(), lambda name, time_s: 240 if name == "c" and time_s > 5.0 else 300).fly(12.0)
    assert set(qualities(bench, 8.0, 12.0)) == set(qualities(bench, 8.0, 12.0, stream=3)) == {100}


def test_every_field_of_a_fused_message() -> None:
    bench = Bench(airframe(), 300).fly(4.0)
    assert bench.wire.frames[-1][1][0] == common.PROTOCOL_MARKER_V2
    time_s, message = bench.sent()[-1]
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
    assert (message.min_distance, message.max_distance, message.current_distance) == (19, 765, 300)
    assert (message.type, message.id, message.orientation) == (common.MAV_DISTANCE_SENSOR_ULTRASOUND, FUSED_ID, 25)
    assert list(message.quaternion) == [0, 0, 0, 0]
    assert 1 <= message.covariance <= 4
    assert message.signal_quality == 100
    # Half of the flight to 3 m, 8.7 ms; the answer is read up to 2 ms after it is there at 37.4 ms.
    assert 1000 * (time_s - 0.0374 - 0.003 + 0.0087) - 1 <= message.time_boot_ms <= 1000 * (time_s - 0.0374 + 0.0087)


def test_every_field_of_single_messages() -> None:
    """Right is YAW_90 (2), left YAW_270 (6); between the axes it is CUSTOM with the mounting's quaternion."""
    content = [*AROUND, sensor("e", 5, -60.0, 30.0), sensor("f", 6, -45.0), sensor("g", 7, -85.0, 40.0)]
    bench = Bench(airframe(content, send={"sensors": "all"}), 300).fly(4.0)
    messages = {message.id: message for _, message in bench.sent()}
    assert {stream: message.orientation for stream, message in messages.items()} == {
        1: 0, 2: 2, 3: 4, 4: 6, 5: common.MAV_SENSOR_ROTATION_CUSTOM, 6: 39, 7: 25,
    }  # fmt: skip
    for stream, message in messages.items():
        x, y, z, w = Rotation.from_euler("ZYX", [30, -60, 0], degrees=True).as_quat()
        assert list(message.quaternion) == pytest.approx([w, x, y, z] if stream == 5 else [0, 0, 0, 0], abs=1e-6)
        assert (message.type, message.min_distance, message.max_distance) == (1, 19, 765)
        assert message.current_distance == 300


@pytest.mark.parametrize("reading_cm", [20, 21, 764])
def test_what_the_sensor_reports_lies_between_the_messages_bounds(reading_cm: int) -> None:
    """Cold air makes the nearest reading shorter and warm air the farthest one longer than the sensor can report."""
    for fixed_c in (-20.0, CALIBRATED_C, 50.0):
        message = last(Bench(one_down(temperature={"fixed_c": fixed_c}), reading_cm).fly(2.0), 1)
        assert message.min_distance < message.current_distance <= message.max_distance


@pytest.mark.parametrize("air_c", [0.0, 15.0, 40.0])
def test_a_range_is_corrected_for_the_air(air_c: float) -> None:
    bench = Bench(one_down(temperature={"fixed_c": air_c}), 600).fly(2.0)
    expected_cm = 600 * speed_of_sound(air_c) / speed_of_sound(CALIBRATED_C)
    assert last(bench, 1).current_distance == round(expected_cm)
    assert abs(expected_cm - 600) > 6


@pytest.mark.parametrize("air_c", [-20.0, 45.0])
def test_the_maximum_is_the_longest_reading_in_this_air(air_c: float) -> None:
    """At -20 C sound gets no further than 7.08 m within a sensor's cycle, at 45 C 7.94 m."""
    factor = speed_of_sound(air_c) / speed_of_sound(CALIBRATED_C)
    seen_cm = round(764 * factor)
    for fixed, single in (({"fused": {"id": FUSED_ID}}, FUSED_ID), ({"sensors": ["a"]}, 1)):
        vehicle = airframe(send=fixed, temperature={"fixed_c": air_c})
        bench = Bench(vehicle, lambda name, time_s: 764 if time_s < 2.0 else 765).fly(4.0)
        assert {message.max_distance for _, message in bench.sent()} == {round(765 * factor)}
        assert set(bench.distances_cm(single, to_s=2.0)) == {seen_cm}
        assert last(bench, single).current_distance == round(765 * factor) + 1


def test_the_maximum_follows_the_air(tmp_path: Path) -> None:
    thermometer = tmp_path / "air"
    thermometer.write_text("20000")
    source = {"source": "file", "path": str(thermometer)}
    bench = Bench(airframe(temperature={"sources": [source]}), 300)
    for number, air_c in enumerate(range(20, -1, -1)):
        thermometer.write_text(f"{air_c}000")
        bench.fly(3.0 * (number + 1))
    bench.fly(300.0)  # After so quick a change the air counts as ahead of the thermometer for a while.
    maxima_cm = [message.max_distance for _, message in bench.sent()]
    assert maxima_cm[0] == round(765 * speed_of_sound(20.0) / speed_of_sound(CALIBRATED_C))
    assert maxima_cm[-1] == pytest.approx(765 * speed_of_sound(0.0) / speed_of_sound(CALIBRATED_C), abs=1.5)


def test_the_fused_distance_starts_at_the_reference_point() -> None:
    content = [each | {"position_m": [0, 0, 0.30]} for each in FOUR_DOWN]
    bench = Bench(airframe(content, send={"fused": {"id": FUSED_ID, "reference_down_m": 0.05}}), 300).fly(2.0)
    assert set(bench.distances_cm()) == {325}


def test_messages_of_single_streams_are_twenty_milliseconds_apart_and_none_is_lost() -> None:
    vehicle = airframe(AROUND, polling={"groups": [list(NAMES)]}, send={"sensors": "all"})
    bench = Bench(vehicle, 300).fly(10.0)
    times_s = [time_s for time_s, _ in bench.sent()]
    assert all(late - early >= 0.020 - 1e-9 for early, late in pairwise(times_s))
    assert set(Counter(message.id for _, message in bench.sent()).values()) <= {99, 100, 101}


@pytest.mark.parametrize(("down_cm", "ready_s"), [(300, READY_S + 300 * 58e-6), (765, 0.067)])
def test_the_fused_message_does_not_wait_and_single_ones_wait_for_it(down_cm: int, ready_s: float) -> None:
    vehicle = airframe(
        [*FOUR_DOWN[:3], sensor("front", 4) | {"rotation_deg": {"pitch": 0}}],
        polling={"groups": [["a", "front"], ["b"], ["c"]]},
        send={"fused": {"id": FUSED_ID}, "sensors": ["front"]},
    )
    bench = Bench(vehicle, lambda name, time_s: 400 if name == "front" else down_cm).fly(8.99)
    sent = [(time_s, message.id) for time_s, message in bench.sent()]
    fused_s = [time_s for time_s, stream in sent if stream == FUSED_ID]
    answered_s = [ping_s + ready_s for ping_s, name, _ in bench.pings if name != "front"]
    assert all(
        0 <= sent_s - there_s <= 0.003 for sent_s, there_s in zip(fused_s, answered_s[-len(fused_s) :], strict=True)
    )
    for (before_s, _), (time_s, stream) in pairwise(sent):
        if stream == 4:
            assert time_s - before_s >= 0.020 - 1e-9
    # A first distance waits for a second reading that agrees with it, and 'above the maximum' where no ground has been
    # seen for three of each sensor that looks down.
    assert Counter(stream for _, stream in sent) == {FUSED_ID: 82 if down_cm == 765 else 89, 4: 29}


@pytest.mark.parametrize(("reading_cm", "rate_hz"), [(150, 20.0), (250, 10.0)])
def test_near_the_ground_the_loopback_airframe_pings_faster(reading_cm: int, rate_hz: float) -> None:
    bench = Bench(load_airframe(CONFIGS / "loopback.yaml"), reading_cm).fly(10.0)
    assert len([time_s for time_s, _, _ in bench.pings if time_s >= 5.0]) == pytest.approx(5.0 * rate_hz, abs=1)


def test_polling_as_the_airframe_says() -> None:
    polling = {"groups": [["a", "c"], ["d", "b"]], "ping_interval_s": 0.15, "adaptive": False}
    bench = Bench(airframe(polling=polling), 300).fly(2.9)
    assert [(round(time_s, 6), name) for time_s, name, _ in bench.pings[:6]] == [
        (0.0, "a"), (0.0, "c"), (0.15, "d"), (0.15, "b"), (0.3, "a"), (0.3, "c"),
    ]  # fmt: skip
    # Not adaptive: read at the sensor model's deadline of 80 ms.
    assert {round(step.ranging.answered_s - step.ranging.ping_s, 6) for step in bench.steps} == {0.080}


def test_the_time_is_the_autopilots_once_it_is_known() -> None:
    bench = Bench(airframe(), 300).fly(2.0)
    bench.receive(HEARTBEAT, common.MAVLink_system_time_message(0, 3_600_000))
    bench.fly(2.5)
    time_s, message = bench.sent()[-1]
    echo_s = time_s - 0.0374 + 0.0087
    assert message.time_boot_ms == pytest.approx(3_600_000 + 1000 * (echo_s - 2.0), abs=8)


def statuses(bench: Bench, from_s: float) -> list[int]:
    return [message.system_status for time_s, message in bench.sent("HEARTBEAT") if time_s >= from_s]


def test_the_heartbeat_carries_the_state_of_the_sensors() -> None:
    good = Bench(airframe(), 300).fly(5.0, with_autopilot=True)
    assert statuses(good, 0.0)[:2] == [common.MAV_STATE_BOOT] * 2
    assert set(statuses(good, 2.0)) == {common.MAV_STATE_ACTIVE}
    bad = Bench(airframe(), 300, absent="c").fly(5.0, with_autopilot=True)
    assert set(statuses(bad, 2.0)) == {common.MAV_STATE_CRITICAL}


def test_an_autopilot_that_comes_late_gets_the_present_faults() -> None:
    bench = Bench(airframe(), 300, absent="c").fly(5.0)
    assert bench.texts() == ["Range c: no answer (errno 121)"]
    bench.receive(HEARTBEAT)
    bench.fly(9.0)
    assert bench.texts() == ["Range c: no answer (errno 121)"] * 2
    assert len(bench.reported()) == 1


def test_an_air_temperature_that_does_not_come_is_reported_and_that_it_is_back() -> None:
    temperature = {"fixed_c": 20.0, "sources": [{"source": "mavlink", "message": "SCALED_PRESSURE"}]}
    bench = Bench(airframe(temperature=temperature), 600)
    assert "no thermometer" not in str(bench.texts())
    bench.receive(HEARTBEAT)
    bench.fly(8.0)
    assert "Range: no air temperature, using 20 C" in bench.texts()
    asked = [(message.command, message.param1, message.param2) for _, message in bench.sent("COMMAND_LONG")]
    # Its pressures are wanted more often.
    assert (common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAVLINK_MSG_ID_SCALED_PRESSURE, 1e5) in asked
    before_cm = last(bench).current_distance
    bench.receive(HEARTBEAT, common.MAVLink_scaled_pressure_message(0, 1000, 0, 3500))
    bench.fly(12.0)
    assert "Range: air temp is back" in bench.reported()
    # 15 deg C are 2.5 % of the range.
    assert last(bench).current_distance - before_cm == pytest.approx(600 * 0.0252, abs=1)


def test_a_missing_thermometer_is_reported_at_the_start_and_to_an_autopilot_that_comes() -> None:
    bench = Bench(airframe(temperature={"fixed_c": 20.0}), 600).fly(5.0)
    text = "Range: no thermometer, 33 cm off at -4 C, 7.65 m"
    assert bench.reported() == [text, "Range: all 4 sensors good"]
    before = len(bench.texts())
    bench.receive(HEARTBEAT)
    bench.fly(7.0)
    assert bench.texts()[before:] == [text]


class Paper:
    """A recorder whose disk is full at times.

    Attributes
    ----------
    topics, last
        Messages of each topic, and the last one.
    frames
        Frames, by topic.
    """

    def __init__(self, full_from_s: float = math.inf, full_to_s: float = math.inf) -> None:
        self.full_from_s, self.full_to_s = full_from_s, full_to_s
        self.fault: str | None = None
        self.topics: Counter[str] = Counter()
        self.last: dict[str, dict[str, Any]] = {}
        self.frames: defaultdict[str, list[bytes]] = defaultdict(list)

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        self.topics[topic] += 1
        self.last[topic] = message
        if "hex" in message:
            self.frames[topic].append(bytes.fromhex(message["hex"]))

    def flush_if_due(self, now_s: float) -> None:
        self.fault = "disk full" if self.full_from_s < now_s < self.full_to_s else None


def test_with_send_nothing_all_that_would_be_sent_is_recorded_and_no_distance_goes_out() -> None:
    """Ground, an object below one sensor, then no echo; with a single stream next to the fused one."""

    def world(name: str, time_s: float) -> int:
        return 765 if time_s > 12.0 else 240 if name == "c" and time_s > 5.0 else 300

    streams = {"fused": {"id": FUSED_ID}, "sensors": ["a"]}
    papers = {nothing: Paper() for nothing in (False, True)}
    benches = [
        Bench(airframe(send=streams | {"nothing": nothing}, link=PX4), world, recorder=paper)
        for nothing, paper in papers.items()
    ]
    for bench in benches:
        bench.receive(HEARTBEAT)
        bench.fly(16.0)
    sends, silent = benches

    def payloads(frames: Iterable[bytes]) -> list[bytes]:
        """Without header and checksum: a frame that was not sent has no number."""
        return [frame[10:-2] for frame in frames if int.from_bytes(frame[7:10], "little") == 132]

    sent = payloads(frame for _, frame in sends.wire.frames)
    assert {message.id for _, message in sends.sent()} == {1, 3, FUSED_ID}
    assert payloads(papers[True].frames["/mavlink/withheld"]) == sent
    assert papers[False].topics["/mavlink/withheld"] == 0
    assert not silent.sent()
    assert not papers[True].topics["/mavlink/sent"]
    assert papers[True].topics["/fused"] == papers[False].topics["/fused"] > 100
    for kind in ("HEARTBEAT", "TIMESYNC", "COMMAND_LONG"):
        assert len(silent.sent(kind)) == len(sends.sent(kind)) > 0
    assert silent.bridge.counts() == sends.bridge.counts()
    (ids,) = {frame[5:7] for frame in papers[True].frames["/mavlink/withheld"]}
    assert ids == bytes((1, 191))


def test_with_send_nothing_a_silence_is_one_of_the_sensors_only() -> None:
    bench = Bench(airframe(send="nothing"), 300).fly(10.0, with_autopilot=True)
    assert bench.reported() == ["Range: no distances are sent (send: nothing)", "Range: all 4 sensors good"]
    faults = {name: [Fault("saturated", 5.0, 10.0)] for name in NAMES}
    bench = Bench(airframe(send="nothing"), 300, faults=faults).fly(10.0, with_autopilot=True)
    assert "Range: no distance to the ground" in bench.reported(5.0)


def test_every_stage_of_every_reading_is_recorded() -> None:
    paper = Paper()
    vehicle = airframe(
        temperature={"fixed_c": 0.0, "fixed_std_c": 4.0}, send={"fused": {"id": FUSED_ID}, "sensors": ["c"]}, link=PX4
    )
    bench = Bench(vehicle, lambda name, time_s: 765 if name == "b" else 300, recorder=paper).fly(9.95)
    assert [paper.topics[f"/range/{name}"] for name in NAMES] == [25] * 4
    good, silent, only_fused = paper.last["/range/c"], paper.last["/range/b"], paper.last["/range/a"]
    assert (good["status"], good["raw"], good["range_m"], good["temperature_c"]) == ("ok", 300, 3.0, 0.0)
    assert (good["temperature_std_c"], good["temperature_source"]) == (4.0, "fixed")
    air_m = 3.0 * speed_of_sound(0.0) / speed_of_sound(CALIBRATED_C)
    assert (good["corrected_m"], good["filtered_m"]) == (pytest.approx(air_m), pytest.approx(air_m))
    assert good["ping_s"] < good["time_s"] < good["read_s"]
    assert (silent["status"], silent["rejected"], silent["raw"]) == ("no_echo", "no_echo", 765)
    assert not {"range_m", "corrected_m", "filtered_m"} & silent.keys()
    assert only_fused["corrected_m"] == pytest.approx(air_m)
    assert not {"filtered_m", "rejected"} & only_fused.keys(), "filters run for a stream of their own only"
    assert paper.last["/fused"]["range_m"] == pytest.approx(air_m)
    sent = [frame.hex() for _, frame in bench.wire.frames]
    assert paper.last["/mavlink/sent"]["hex"] in sent
    assert paper.topics["/mavlink/sent"] == len(bench.sent())
    for topic, message in paper.last.items():
        assert message.keys() <= json.loads(schema_of(topic)[1])["properties"].keys()


@pytest.mark.parametrize("is_recorded", [True, False])
def test_who_watches_gets_all_that_is_recorded_whether_it_is_or_not(is_recorded: bool) -> None:
    paper, shown = Paper(), Paper()
    bench = Bench(airframe(), 300)
    bench.bridge.show_to(shown.write)
    if is_recorded:
        bench.bridge.record_to(paper)
    bench.fly(2.0)
    bench.bridge.write("/mark", bench.clock.now(), {"text": "here"})
    assert shown.topics.keys() >= {"/range/a", "/fused", "/mavlink/sent", "/mark"}
    assert paper.topics == (shown.topics if is_recorded else Counter())


def test_a_full_disk_is_reported_and_its_end_too() -> None:
    bench = Bench(airframe(), 300, recorder=Paper(START_S + 5.0, START_S + 8.0)).fly(10.0)
    texts = [(time_s, message.text) for time_s, message in bench.sent("STATUSTEXT")]
    assert [text for _, text in texts[-2:]] == ["Range: not recording, disk full", "Range: recording again"]
    assert [time_s for time_s, _ in texts[-2:]] == pytest.approx([5.0, 8.0], abs=0.4)
    # Apart from the texts nothing has changed.
    assert len(bench.distances_cm(from_s=5.0)) == pytest.approx(50, abs=1)
    assert len(bench.distances_cm()) == 99


def test_counts_of_readings_and_of_the_rejected() -> None:
    bench = Bench(airframe(), lambda name, time_s: 765 if name == "b" and time_s < 4 else 300, absent="d").fly(10.0)
    counts = bench.bridge.counts()
    # d does not answer three times and is retried every 2 s from then on; the others have its slots.
    assert {name: counts[name].readings for name in NAMES} == {"a": 33, "b": 32, "c": 32, "d": 7}
    assert [counts[name].rejected for name in NAMES] == [
        {"unconfirmed": 1},
        {"no_echo": 12},
        {},
        {"no_answer": 7},
    ]


def test_a_single_message_that_waits_gives_way_to_a_newer_one_of_its_stream() -> None:
    """Eight streams that answer together each 100 ms want 160 ms: what waits is the newest, and all get their turn."""
    names = "abcdefgh"
    content = [sensor(name, number, 0.0, 45.0 * (number - 1)) for number, name in enumerate(names, start=1)]
    polling = {"groups": [list(names)]}
    vehicle = airframe(content, polling=polling, filters=[], send={"sensors": "all"})
    bench = Bench(vehicle, lambda name, time_s: 100 + round(10 * time_s)).fly(10.0)
    sent = bench.sent()
    assert min(Counter(message.id for _, message in sent).values()) >= 49
    assert all(100 + 10 * time_s - message.current_distance < 3.5 for time_s, message in sent)


def test_outliers_of_a_single_stream_lower_its_quality() -> None:
    outliers_s = (2.95, 4.95, 5.15, 5.35)
    bench = Bench(
        one_down(filters=[{"filter": "kalman"}]),
        lambda name, time_s: 120 if any(first_s < time_s < first_s + 0.1 for first_s in outliers_s) else 300,
    ).fly(8.0)
    assert bench.rejected("a") == {"unconfirmed": 1, "unexpected": 4}
    assert set(qualities(bench, 0.0, 2.9, 1)) == {100}
    assert 90 <= min(qualities(bench, 3.0, 4.9, 1)) < 100
    assert min(qualities(bench, 5.4, 5.6, 1)) < 90
    assert qualities(bench, 7.0, 8.0, 1)[-1] == 100


def test_a_speed_is_not_lost_where_half_of_the_sensors_are_dead() -> None:
    """Held back in a known way: at 1 m/s at most by a turn of the polling, not by the age of the readings."""
    bench = Bench(airframe(), lambda name, time_s: round(100 + 100 * max(0.0, time_s - 4.0)), absent="bd").fly(9.0)
    for time_s, message in bench.sent():
        if time_s > 5.5:
            assert message.current_distance == pytest.approx(100 + 100 * (time_s - 0.03 - 4.0), abs=10)


@pytest.mark.parametrize("together", [True, False])
def test_a_locked_bus_leaves_the_link_its_time(together: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each transfer holds the bridge for a second in the kernel; eight sensors that ping together want eight."""
    names = "abcdefgh"
    content = [sensor(name, number, 0.0, 45.0 * (number - 1)) for number, name in enumerate(names, start=1)]
    groups = [list(names)] if together else [[name] for name in names]
    bench = Bench(airframe(content, polling={"groups": groups}, filters=[], send={"sensors": "all"}), 300).fly(5.0)

    def locked(address: int, data: object) -> None:
        bench.clock.sleep_until(bench.clock.now() + 1.0)
        raise BusError(errno.ETIMEDOUT, "write", address)

    monkeypatch.setattr(bench.bus, "write", locked)
    monkeypatch.setattr(bench.bus, "read", locked)
    monkeypatch.setattr(bench.bus, "reopen", lambda: bench.clock.sleep_until(bench.clock.now() + 1.0))
    longest_s = 0.0
    while bench.now() < 60.0:
        began_s = bench.now()
        bench.bridge.step()
        longest_s = max(longest_s, bench.now() - began_s)
    # A transfer, and the sleep before it.
    assert longest_s <= 1.1
    heartbeats_s = [time_s for time_s, _ in bench.sent("HEARTBEAT")]
    assert max(late - early for early, late in pairwise(heartbeats_s)) <= 2.0
    assert bench.texts()[-1].endswith("no answer (errno 110)")
    assert "Range: I2C bus locked up, reopening (errno 110)" in bench.texts()


def test_a_groups_pings_wait_for_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """The link and the looks at temperature and disk come after them, however long these take."""
    names = "abcdefgh"
    content = [sensor(name, number, 0.0, 45.0 * (number - 1)) for number, name in enumerate(names, start=1)]
    vehicle = airframe(content, polling={"groups": [list(names)]}, filters=[], send={"sensors": "all"})
    bench = Bench(vehicle, 300)
    write, service = bench.bus.write, bench.bridge.link.service

    def slow_write(address: int, data: bytes) -> None:
        bench.clock.sleep_until(bench.clock.now() + 0.0005)
        write(address, data)

    def slow_service(has_arrived: bool) -> None:
        service(has_arrived)
        bench.clock.sleep_until(bench.clock.now() + 0.01)

    monkeypatch.setattr(bench.bus, "write", slow_write)
    monkeypatch.setattr(bench.bridge.link, "service", slow_service)
    bench.fly(10.0)
    for first in range(0, len(bench.pings) - 8, 8):
        group = bench.pings[first : first + 8]
        assert [name for _, name, _ in group] == list(names)
        assert group[-1][0] - group[0][0] < 0.004


@pytest.mark.parametrize("stood_still_s", [1.0, 30.0])
@pytest.mark.parametrize("after_ping_s", [0.005, 0.030])
def test_what_was_received_before_the_program_stood_still_is_not_reported_after_it(
    stood_still_s: float, after_ping_s: float
) -> None:
    """A computer that swaps or was stopped, or a bus that held the loop: the answer that waits is of long ago."""
    bench = Bench(airframe(), lambda name, time_s: 600 if time_s < 5.5 else 500 + (name in "ac")).fly(
        5.0 + after_ping_s
    )
    bench.clock.sleep_until(bench.clock.now() + stood_still_s)
    bench.fly(7.0 + stood_still_s)
    assert set(bench.distances_cm(from_s=5.5)) <= {499, 500, 501, 502}
    assert bench.distances_cm(from_s=6.5 + stood_still_s)


# What is below single sensors, and sensors that are stuck. A corner each, so that slopes are slopes.

CORNERS = {"a": [0.25, -0.2, 0], "b": [0.25, 0.2, 0], "c": [-0.25, -0.2, 0], "d": [-0.25, 0.2, 0]}
PALLET = [each | {"position_m": CORNERS[each["name"]]} for each in FOUR_DOWN]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_an_object_below_one_sensor_is_sent_with_its_distance_and_leaves_the_ground_alone(autopilot: str) -> None:
    def world(name: str, time_s: float) -> int:
        return 240 if name == "b" and 5.0 <= time_s < 10.0 else 300

    link = {"url": "udpout:127.0.0.1:14550", "autopilot": autopilot}
    bench = Bench(airframe(PALLET, link=link), world).fly(15.0)
    assert set(bench.distances_cm()) == {300}
    distances = [(time_s, message) for time_s, message in bench.sent() if message.id == 2]
    assert 5.0 < distances[0][0] < 6.3
    assert 10.0 < distances[-1][0] + 0.4 < 11.3
    # Not a second stream that looks down: both autopilots would mix it with the fused one.
    assert {message.orientation for _, message in distances} == {common.MAV_SENSOR_ROTATION_CUSTOM}
    # What comes first is what the sensor's own filter makes of the change.
    assert {message.current_distance for _, message in distances} <= {239, 240}
    turned = Rotation.from_quat(distances[0][1].quaternion, scalar_first=True)
    assert turned.apply([1, 0, 0]) == pytest.approx([0, 0, 1], abs=1e-6)
    assert bench.reported(1.2) == ["Range b: object below, 0.6 m high", "Range b: ground below"]
    assert "Range b: object below, 0.6 m high" in bench.texts()
    # Two messages are never closer than PX4 can take them.
    times_s = [time_s for time_s, _ in bench.sent()]
    assert min(late - early for early, late in pairwise(times_s)) > 0.019


def test_ground_is_below_only_where_the_sensor_sees_ground() -> None:
    """What went away from an object, and then had no echo, has not seen any ground."""
    names = {5.0: 247, 9.0: 220, 9.4: 765, 20.0: 300}

    def world(name: str, time_s: float) -> int:
        return 300 if name != "b" or time_s < 5.0 else [cm for from_s, cm in names.items() if time_s >= from_s][-1]

    bench = Bench(airframe(PALLET, sensor_watch=False), world).fly(25.0)
    assert bench.reported(1.2) == ["Range b: object below, 0.5 m high", "Range b: object not seen now"]


def test_a_hole_is_reported_in_a_text_and_has_no_stream() -> None:
    bench = Bench(airframe(PALLET), lambda name, time_s: 380 if name == "c" and time_s > 5 else 300).fly(10.0)
    assert set(bench.distances_cm()) == {300}
    assert {message.id for _, message in bench.sent()} == {FUSED_ID}
    assert bench.reported(1.2) == ["Range c: hole below, 0.8 m deep"]


def test_a_sensor_that_has_a_stream_of_its_own_needs_no_second_one() -> None:
    send = {"fused": {"id": FUSED_ID}, "sensors": ["b"]}
    link = {"url": "udpout:127.0.0.1:14550", "autopilot": "px4"}
    vehicle = airframe(PALLET, link=link, send=send, filters=[])
    bench = Bench(vehicle, lambda name, time_s: 240 if name == "b" and time_s > 5 else 300).fly(10.0)
    assert {message.orientation for _, message in bench.sent()} == {25}
    assert bench.distances_cm(2, 6.0) == [240] * 10


def test_a_stuck_sensor_is_a_fault_from_when_the_vehicle_moves_until_it_answers_anew() -> None:
    def world(name: str, time_s: float) -> int:
        moving_cm = 300 + round(50 * max(0.0, min(time_s, 12.0) - 8.0))
        return 300 if name == "b" and 3.0 < time_s < 16.0 else moving_cm

    send = {"fused": {"id": FUSED_ID}, "sensors": ["b"]}
    vehicle = airframe(PALLET, send=send, filters=[], link={"url": "udpout:127.0.0.1:14550", "autopilot": "px4"})
    bench = Bench(vehicle, world).fly(20.0)
    assert bench.reported(1.2) == ["Range b: stuck at one value", "Range b: good again"]
    assert {message.current_distance for time_s, message in bench.sent() if 13.0 < time_s < 16.0} <= {
        499,
        500,
        501,
        502,
    }
    assert bench.rejected("b")["stuck"] > 10
    assert all(message.id == FUSED_ID for time_s, message in bench.sent() if 9.2 < time_s < 16.0), "a fault is silence"
    states = [message.system_status for time_s, message in bench.sent("HEARTBEAT") if 11.0 < time_s < 16.0]
    assert set(states) == {common.MAV_STATE_CRITICAL}


def test_the_attitude_is_asked_for_where_none_is_sent_and_recorded_where_it_is() -> None:
    paper = Paper()
    bench = Bench(airframe(PALLET), 300, recorder=paper)
    for i in range(100):
        bench.receive(HEARTBEAT)
        if i >= 50:
            bench.receive(common.MAVLink_attitude_message(100 * i, 0.1, 0.0, 0.0, 0, 0, 0))
        bench.fly(0.1 * (i + 1))
    asked = [time_s for time_s, each in bench.sent("COMMAND_LONG") if each.param1 == common.MAVLINK_MSG_ID_ATTITUDE]
    assert len(asked) == 1
    assert paper.topics["/attitude"] == pytest.approx(50, abs=2)
    # It leans, and its sensors read the same: so does the ground below it, and straight up it is farther.
    assert bench.distances_cm(from_s=9.0)[-1] == 300
    fused = [step.fused for step in bench.steps if step.fused is not None][-1]
    assert fused.height_m == pytest.approx(3.0 / math.cos(0.1), abs=0.005)
    assert abs(fused.rise_east) == pytest.approx(math.tan(0.1), abs=0.01)
