"""The judge of the fault campaign, on messages that are written by hand."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from evaluation import CONFIGS
from evaluation.faults.families import FAMILIES, FIRST
from evaluation.faults.judge import Conditions, Received, Verdict, judge
from evaluation.faults.plans import SHARES, draw_plan, group_of, row_of, turn_of
from evaluation.faults.truth import Truth
from msp_sim.flight.scenario import Scenario, load_scenario

pytestmark = pytest.mark.slow

BOOT_S = -40.0
DOWN, FORWARD = mavlink.MAV_SENSOR_ROTATION_PITCH_270, mavlink.MAV_SENSOR_ROTATION_NONE


OfTime = float | Callable[[float], float]


def at(value: OfTime, time_s: float) -> float:
    """A number, or what a function of time gives."""
    return value(time_s) if callable(value) else value


class StatedTruth:
    """Grounds at heights, each a number or a function of time, and objects where another function says so."""

    def __init__(self, *below_m: OfTime, uneven: Callable[[float], bool] = lambda time_s: False):
        self._below_m = below_m
        self.is_uneven = uneven

    def distances_m(self, time_s: float) -> list[float]:
        return [at(each, time_s) for each in self._below_m]

    def motion(self, time_s: float) -> tuple[float, str]:
        return (0.0, "hover") if time_s < 5.0 else (0.1, "climb")


def distance(time_s: float, current_cm: int, std_cm: float = 2, quality: int = 90, orientation: int = DOWN) -> Any:
    """A DISTANCE_SENSOR whose echo came 40 ms before; a deviation of 0 is 'unknown'."""
    boot_ms = round((time_s - 0.04 - BOOT_S) * 1e3)
    covariance = round(std_cm**2) if std_cm else 255
    message = mavlink.MAVLink_distance_sensor_message(
        boot_ms, 19, 765, current_cm, 1, 10, orientation, covariance, 0.4, 0.4, (0.0, 0.0, 0.0, 0.0), quality
    )
    return time_s, message


def text(time_s: float, words: str, severity: int = mavlink.MAV_SEVERITY_ERROR) -> Any:
    return time_s, mavlink.MAVLink_statustext_message(severity, words.encode())


def heartbeat(time_s: float, status: int) -> Any:
    return time_s, mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, status, 3)


def stream(current_cm: OfTime = 200, to_s: float = 10.0, **more: Any) -> list[Any]:
    """Ten messages a second."""
    return [distance(i / 10, round(at(current_cm, i / 10)), **more) for i in range(1, round(10 * to_s))]


def verdict_on(messages: Sequence[Any], truth: Any = None, end_s: float = 10.0, **conditions: Any) -> Verdict:
    given: dict[str, Any] = {"duration_s": end_s, "limit_s": 1.0, "nearest_m": 0.2, "farthest_m": 7.5}
    given["listens_s"] = [(0.0, end_s)]
    received = Received(sorted(messages, key=lambda each: each[0]), [BOOT_S])
    stated: Any = truth or StatedTruth(2.0)
    return judge(received, stated, Conditions(**(given | conditions)))


def test_a_right_stream_is_right() -> None:
    verdict = verdict_on(stream(203))
    assert (verdict.wrong, verdict.silences, verdict.above_wrong, verdict.false_objects) == ([], [], 0, [])
    # The first limit is not judged, and nothing is held in the last tenth.
    assert verdict.judged_s == pytest.approx(9.0)
    assert verdict.honest_in_range_s == pytest.approx(verdict.in_range_s) == pytest.approx(9.0)
    assert verdict.covered_s == pytest.approx(9.0)
    assert {key: covered_s for key, (covered_s, valid_s) in verdict.covered_by.items()} == pytest.approx(
        {"below 5 deg, hover": 4.0, "above 5 deg, climb": 5.0}
    )


@pytest.mark.parametrize(("error_cm", "wrong"), [(49, False), (51, True), (-51, True)])
@pytest.mark.parametrize(("lasts_s", "long_enough"), [(0.4, False), (0.8, True)])
def test_a_distance_is_wrong_where_it_is_far_off_for_long(
    error_cm: int, wrong: bool, lasts_s: float, long_enough: bool
) -> None:
    verdict = verdict_on(stream(lambda time_s: 200 + error_cm * (5.0 <= time_s < 4.99 + lasts_s)))
    assert len(verdict.wrong) == (wrong and long_enough)
    if verdict.wrong:
        (event,) = verdict.wrong
        assert event[:3] == pytest.approx((5.0, lasts_s, error_cm / 100), abs=0.03)


def test_a_right_distance_between_two_wrong_ones_makes_two_events() -> None:
    verdict = verdict_on(stream(lambda time_s: 300 if 3.0 <= time_s < 6.0 and abs(time_s - 4.5) > 0.01 else 200))
    assert [event.for_s for event in verdict.wrong] == pytest.approx([1.5, 1.4], abs=0.03)


def test_a_held_distance_becomes_wrong_when_the_vehicle_moves_on_and_ends_at_the_time_out() -> None:
    messages = [distance(i / 10, 200) for i in range(1, 51)]
    truth = StatedTruth(lambda time_s: 2.0 if time_s < 5.0 else 4.0)
    assert [event.for_s for event in verdict_on(messages, truth).wrong] == []
    messages.append(distance(5.3, 200))
    (event,) = verdict_on(messages, truth).wrong
    assert (event.from_s, event.for_s) == pytest.approx((5.0, 0.8), abs=0.03)


@pytest.mark.parametrize(("quality", "orientation", "current_cm"), [(1, DOWN, 400), (90, FORWARD, 400), (90, DOWN, 19)])
def test_what_is_no_valid_distance_down_is_never_a_wrong_one(quality: int, orientation: int, current_cm: int) -> None:
    verdict = verdict_on(stream(current_cm, quality=quality, orientation=orientation))
    assert (verdict.wrong, verdict.valid_s) == ([], 0.0)


def test_either_ground_is_right_where_there_are_two() -> None:
    truth = StatedTruth(2.0, 3.0)
    assert verdict_on(stream(lambda time_s: 300 if time_s < 5 else 200), truth).wrong == []
    assert len(verdict_on(stream(400), truth).wrong) == 1


def test_above_the_maximum_is_wrong_over_a_near_ground_and_usable_over_a_far_one() -> None:
    near, far = StatedTruth(7.0), StatedTruth(7.3)
    messages = stream(766, quality=1)
    verdict = verdict_on(messages, near)
    assert (verdict.above_wrong, verdict.silences) == (99, [])
    assert verdict.above_wrong_s == pytest.approx(9.9)
    (event,) = verdict.wrong
    assert event[:3] == pytest.approx((0.1, 9.9, 0.65), abs=0.03)
    assert (verdict_on(messages, far).above_wrong, verdict_on(messages, far).silences) == (0, [])
    either = StatedTruth(7.0, 9.0)
    assert verdict_on(messages, either).above_wrong == 0


def test_above_the_maximum_is_no_silence_although_the_vehicle_has_just_sunk_below() -> None:
    """One message a little too late is wrong for as long as it holds, but an autopilot has received something."""
    truth = StatedTruth(lambda time_s: 8.0 if time_s < 5.0 else 7.1)
    messages = [distance(i / 10, 766, quality=1) for i in range(1, 51)]
    messages += [distance(time_s, 710) for time_s in np.arange(5.9, 10.0, 0.1)]
    verdict = verdict_on(messages, truth)
    assert (verdict.above_wrong, verdict.silences, verdict.wrong) == (1, [], [])
    assert verdict.longest_gap_s == pytest.approx(0.9)
    (event,) = verdict_on([*messages, distance(5.1, 766, quality=1)], truth).wrong
    assert event.for_s == pytest.approx(0.6, abs=0.03)


@pytest.mark.parametrize(
    ("error_cm", "std_cm", "quality", "valid_s", "honest_s", "covered_s"),
    [
        (3, 2, 90, 9.0, 9.0, 9.0),
        (5, 2, 90, 9.0, 9.0, 0.0),
        (7, 2, 90, 9.0, 0.0, 0.0),
        (0, 0, 90, 9.0, 0.0, 0.0),
        (0, 0, 0, 0.0, 0.0, 0.0),
    ],
)
def test_stated_deviations(
    error_cm: int, std_cm: int, quality: int, valid_s: float, honest_s: float, covered_s: float
) -> None:
    verdict = verdict_on(stream(200 + error_cm, std_cm=std_cm, quality=quality))
    assert (verdict.valid_s, verdict.honest_s, verdict.covered_s) == pytest.approx((valid_s, honest_s, covered_s))


@pytest.mark.parametrize(
    ("error_cm", "quality", "sure_s", "sure_honest_s"),
    [(0, 90, 9.0, 9.0), (7, 90, 9.0, 0.0), (0, 89, 0.0, 0.0), (7, 89, 0.0, 0.0)],
)
def test_a_quality_of_ninety_is_counted_where_it_is_right_and_where_it_is_not(
    error_cm: int, quality: int, sure_s: float, sure_honest_s: float
) -> None:
    verdict = verdict_on(stream(200 + error_cm, std_cm=2, quality=quality))
    assert (verdict.sure_s, verdict.sure_honest_s) == pytest.approx((sure_s, sure_honest_s))


def test_the_time_with_a_fault_is_counted_by_itself() -> None:
    verdict = verdict_on(stream(lambda time_s: 200 + 20 * (time_s >= 7.0)), faulty_s=[(0.0, 2.0), (6.0, 8.0)])
    assert (verdict.faulty_s, verdict.faulty_in_range_s) == pytest.approx((3.0, 3.0))
    assert verdict.faulty_honest_s == pytest.approx(2.0)
    assert verdict.honest_in_range_s == pytest.approx(6.0)


def test_a_deviation_is_that_of_the_echo_and_not_of_the_receipt() -> None:
    """At 3 m/s the vehicle moves 12 cm in the 40 ms between them."""
    truth = StatedTruth(lambda time_s: 1.0 + 3.0 * time_s)
    at_echo = stream(lambda time_s: 100 + 300 * (time_s - 0.04), to_s=2.0)
    at_receipt = stream(lambda time_s: 100 + 300 * time_s, to_s=2.0)
    assert verdict_on(at_echo, truth, end_s=2.0).covered_s == pytest.approx(1.0)
    assert verdict_on(at_receipt, truth, end_s=2.0).covered_s == 0.0


def test_a_stamp_that_is_far_off_is_not_believed() -> None:
    truth = StatedTruth(lambda time_s: 1.0 + 3.0 * time_s)
    messages = stream(lambda time_s: 100 + 300 * time_s, to_s=2.0)
    for _, message in messages:
        message.time_boot_ms += 5000
    assert verdict_on(messages, truth, end_s=2.0).covered_s == pytest.approx(1.0)


SILENT = [each for each in stream() if not 4.0 < each[0] <= 8.0]


def off_from_5_s(time_s: float) -> float:
    """A distance that is a metre too long from then on [cm]."""
    return 300 if time_s >= 5.0 else 200


@pytest.mark.parametrize(
    ("report", "reported"),
    [
        (text(5.4, "Range: readings disagree"), "text"),
        (text(3.2, "Range front_left: no answer"), "text"),
        (text(2.9, "Range front_left: no answer"), None),
        (text(5.6, "Range: readings disagree"), None),
        (text(5.4, "Range: all 4 sensors good", mavlink.MAV_SEVERITY_INFO), None),
        (text(5.4, "Range front_left: object of 0.5 m below"), None),
        (text(5.4, "Range: sudden change, maybe an object or fault"), "text"),
        (text(5.4, "Range: no air temperature, using 20 C"), None),
        (heartbeat(5.4, mavlink.MAV_STATE_CRITICAL), "critical"),
        (heartbeat(5.4, mavlink.MAV_STATE_ACTIVE), None),
        (heartbeat(5.6, mavlink.MAV_STATE_CRITICAL), None),
    ],
)
def test_a_silence_is_reported_in_time_or_not(report: Any, reported: str | None) -> None:
    (silence,) = verdict_on([*SILENT, heartbeat(2.0, mavlink.MAV_STATE_ACTIVE), report]).silences
    assert silence == pytest.approx((4.0, 4.1, 0.0, reported))


def test_a_heartbeat_that_is_critical_no_more_reports_nothing() -> None:
    states = [heartbeat(3.0, mavlink.MAV_STATE_CRITICAL), heartbeat(5.0, mavlink.MAV_STATE_ACTIVE)]
    assert verdict_on([*SILENT, *states]).silences[0].reported is None


def test_slow_sensors_may_be_silent_for_longer_and_an_autopilot_that_is_away_misses_nothing() -> None:
    assert verdict_on(SILENT, limit_s=4.2).silences == []
    assert verdict_on(SILENT, listens_s=[(0.0, 4.5), (7.5, 10.0)]).silences == []


def test_a_stream_that_never_starts_is_a_silence_from_the_start() -> None:
    assert verdict_on([]).silences == [(0.0, 10.0, 0.0, None)]


def test_a_silence_at_the_end_counts_where_there_was_time_to_report_it() -> None:
    assert verdict_on(stream(to_s=8.7)).silences == []
    assert len(verdict_on(stream(to_s=8.4)).silences) == 1


def test_a_wrong_distance_is_reported_within_two_seconds_or_not() -> None:
    wrong = stream(off_from_5_s)
    for time_s, reported in ((6.9, "text"), (7.1, None)):
        (event,) = verdict_on([*wrong, text(time_s, "Range: no air temperature, using 20 C")]).wrong
        assert event.reported == reported


LAGS, SETTLED = "Range: air temp lags, up to 48 cm off at 7.65 m", "Range: thermometer has settled"


@pytest.mark.parametrize(
    ("off_cm", "texts", "reported"),
    [
        (45, [(1.0, LAGS)], "text"),
        (51, [(1.0, LAGS)], None),
        (45, [(1.0, LAGS), (2.0, SETTLED)], None),
        (45, [(1.0, LAGS), (2.0, "Range rear_left: stuck")], "text"),
        (45, [(9.0, LAGS)], None),
    ],
)
def test_that_the_air_temperature_lags_reports_what_it_says_until_that_is_over(
    off_cm: int, texts: list[tuple[float, str]], reported: str | None
) -> None:
    wrong = stream(lambda time_s: 200 + off_cm * (time_s > 5.0))
    said = [text(*each) for each in texts]
    (event,) = verdict_on([*wrong, *said], wrong_m=0.2, wrong_share=0.05).wrong
    assert event.reported == reported


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        ("Range rear_left: stuck at one value", None),
        ("Range front_left: stuck at one value", "text"),
        ("Range front_left_2: stuck at one value", None),
        ("Range: readings disagree", "text"),
    ],
)
def test_a_text_on_a_healthy_sensor_alone_reports_no_wrong_distance(words: str, reported: str | None) -> None:
    wrong = stream(off_from_5_s)
    faulty_from_s = {"front_left": 4.0, "front_left_2": 9.0, "rear_left": math.inf}
    (event,) = verdict_on([*wrong, text(6.0, words)], faulty_from_s=faulty_from_s).wrong
    assert event.reported == reported


HOSTILE = {"wrong_m": 0.2, "wrong_share": 0.05, "stamp_counts": True}


@pytest.mark.parametrize(("true_cm", "error_cm", "wrong"), [(200, 19, 0), (200, 21, 1), (600, 29, 0), (600, -31, 1)])
def test_a_hostile_flight_is_judged_by_20_cm_or_5_percent(true_cm: int, error_cm: int, wrong: int) -> None:
    truth = StatedTruth(true_cm / 100)
    assert len(verdict_on(stream(true_cm + error_cm), truth, **HOSTILE).wrong) == wrong


@pytest.mark.parametrize(("age_s", "stamp_counts", "wrong"), [(0.14, True, 0), (0.14, False, 1), (0.30, True, 1)])
def test_a_distance_may_be_as_old_as_its_time_stamp_says(age_s: float, stamp_counts: bool, wrong: int) -> None:
    """At 2.5 m/s, 0.14 s are 35 cm; a distance of 0.30 s ago that is said to be of 0.14 s ago is 40 cm off."""
    truth = StatedTruth(lambda time_s: 1.0 + 2.5 * time_s)
    messages = stream(lambda time_s: 100 + 250 * (time_s - age_s), to_s=2.0)
    for _, message in messages:
        message.time_boot_ms -= 100
    verdict = verdict_on(messages, truth, end_s=2.0, **HOSTILE | {"stamp_counts": stamp_counts})
    assert len(verdict.wrong) == wrong


def test_above_the_maximum_in_a_hostile_flight_is_wrong_5_percent_below() -> None:
    messages = stream(766, quality=1)
    assert verdict_on(messages, StatedTruth(7.2), **HOSTILE).above_wrong == 99
    assert verdict_on(messages, StatedTruth(7.3), **HOSTILE).above_wrong == 0


def test_warnings_count_but_for_those_on_an_object_that_is_there() -> None:
    truth = StatedTruth(2.0, uneven=lambda time_s: time_s < 5.0)
    texts = [text(time_s, "Range front_left: object below, 0.5 m high") for time_s in (4.0, 6.0)]
    info = text(7.0, "Range: all 4 sensors good", mavlink.MAV_SEVERITY_INFO)
    stuck = text(8.0, "Range front_left: stuck at one value")
    verdict = verdict_on([*stream(), *texts, info, stuck], truth)
    assert [each.split(":")[0] for each in verdict.warnings] == ["6.0 s", "8.0 s"]


def test_the_silence_of_an_edge_is_the_longest_that_reaches_into_it() -> None:
    """One ends 0.4 s after an edge, one lies between two edges, one begins 0.6 s before an edge."""
    truth = StatedTruth(2.0, uneven=lambda time_s: 3.0 <= time_s < 5.0 or 7.0 <= time_s < 8.0)
    silent_s = [(4.7, 5.4), (5.4, 6.3), (6.4, 7.4)]
    sent = [each for each in stream() if not any(a + 0.05 < each[0] < b - 0.05 for a, b in silent_s)]
    assert verdict_on(sent, truth).edges == [pytest.approx((3.0, 0.7)), pytest.approx((7.0, 1.0))]


def test_objects_count_where_there_is_none() -> None:
    truth = StatedTruth(2.0, uneven=lambda time_s: time_s < 5.0)
    warning = mavlink.MAV_SEVERITY_WARNING
    texts = [text(time_s, "Range front_left: object of 0.5 m below", warning) for time_s in (4.0, 6.0)]
    over = text(7.0, "Range front_left: ground below, no object", mavlink.MAV_SEVERITY_INFO)
    verdict = verdict_on([*stream(), *texts, over], truth)
    assert verdict.false_objects == ["6.0 s: Range front_left: object of 0.5 m below"]


def flown(ground: dict[str, Any], only_below: bool = False, **flight: Any) -> Truth:
    """The truth of a vehicle at 2.75 m over a ground, 2.7 m below the fused stream's reference point."""
    content = {
        "name": "truth",
        "airframe": "quad_pallet.yaml",
        "duration_s": 30,
        "flight": {"altitude": [{"kind": "step", "to_m": 2.5}, {"kind": "hold", "duration_s": 30}], **flight},
        "ground": ground,
    }
    scenario = Scenario.model_validate(content, context={"folder": CONFIGS})
    world = scenario.world()
    return Truth(scenario, world, scenario.vehicle(world, np.random.default_rng(0)), only_below=only_below)


def test_the_truth_over_a_slope_is_along_the_down_axis() -> None:
    truth = flown({"slope_deg": 5.0, "uphill_deg": 0.0}, attitude={"pitch_deg": 10.0})
    (below_m,) = truth.distances_m(3.0)
    # The down axis of a vehicle with its nose up points forward, uphill: h = d (cos p + tan s sin p).
    pitch_rad = math.radians(10.0)
    rate = math.cos(pitch_rad) + math.tan(math.radians(5.0)) * math.sin(pitch_rad)
    assert below_m == pytest.approx(2.75 / rate - 0.05)
    assert not truth.is_uneven(3.0)


def test_the_ground_behind_a_step_on_a_slope_is_the_slope_and_the_step() -> None:
    """Downhill at 1 m/s: a second behind the edge the height is the slope's alone, which has fallen by 12.2 cm/m."""
    legs = [{"duration_s": 25, "speed_m_s": 1.0, "heading_deg": 0.0}]
    ground = {"slope_deg": 7.0, "uphill_deg": 180.0, "steps": [{"at_m": 10.0, "rise_m": 0.5}]}
    truth = flown(ground, track={"legs": legs, "acceleration_m_s2": 100})
    own_m, *others_m = truth.distances_m(14.0)
    assert own_m == pytest.approx(2.7 + 14.0 * math.tan(math.radians(7.0)) - 0.5, abs=0.02)
    assert others_m == pytest.approx([own_m] * len(others_m), abs=0.011)
    assert len(set(others_m)) > 0


def test_before_and_behind_a_step_both_heights_are_true_for_a_second() -> None:
    """At 1 m/s over a step of 50 cm at 10 m: the front sensors are over it 0.25 s before the middle."""
    legs = [{"duration_s": 25, "speed_m_s": 1.0, "heading_deg": 0.0}]
    truth = flown({"steps": [{"at_m": 10.0, "rise_m": 0.5}]}, track={"legs": legs, "acceleration_m_s2": 100})
    heights_m = {
        time_s: sorted({round(each_m, 1) for each_m in truth.distances_m(time_s)}) for time_s in (8.0, 10.0, 11.0, 12.0)
    }
    assert heights_m[8.0] == [2.7]
    assert {2.2, 2.7} <= set(heights_m[10.0])
    assert heights_m[11.0] == [2.2, 2.7]
    assert heights_m[12.0] == [2.2]
    assert truth.distances_m(12.0)[0] == pytest.approx(2.2)
    assert [truth.is_uneven(time_s) for time_s in (5.0, 10.0, 12.0, 14.0)] == [False, True, True, False]


def test_the_top_of_a_box_below_one_side_is_true_only_where_objects_are_ground() -> None:
    ground = {"boxes": [{"centre_m": [0.0, 0.5], "size_m": [2.0, 0.6], "height_m": 0.4}]}
    assert {round(each_m, 1) for each_m in flown(ground).distances_m(1.0)} == {2.3, 2.7}
    below = flown(ground, only_below=True)
    assert below.distances_m(1.0) == pytest.approx([2.7])
    assert below.is_uneven(1.0)


def test_hostile_flights_have_indices_of_their_own() -> None:
    assert draw_plan(3, FIRST + 7) == draw_plan(3, FIRST + 7)
    assert draw_plan(3, FIRST + 7) != draw_plan(4, FIRST + 7)
    first = range(FIRST, FIRST + 6 * len(FAMILIES))
    assert {group_of(index) for index in first} == set(FAMILIES)
    rows = {row_of(index) for index in first}
    assert {"fixed: all four", "fixed: 8 sensors", "edge: one dead", "pairs"} <= rows
    assert not {row_of(index) for index in range(700)} & (rows | set(FAMILIES))


def test_every_family_draws_flights_that_can_be_flown(tmp_path: Path) -> None:
    healthy = {name: family.healthy for name, family in FAMILIES.items()}
    for index in range(FIRST, FIRST + 6 * len(FAMILIES)):
        plan = draw_plan(5, index)
        scenario = load_scenario(plan.write(tmp_path))
        is_healthy = turn_of(index) in healthy[group_of(index)]
        assert not (is_healthy and (scenario.faults or scenario.thermometer.faults))
        assert scenario.autopilot is not None
        assert scenario.autopilot.barometer.ground_effect_m


def test_a_plan_depends_on_seed_and_index_alone_and_every_group_has_its_share() -> None:
    assert draw_plan(3, 17) == draw_plan(3, 17)
    assert draw_plan(3, 17) != draw_plan(4, 17)
    groups = [group_of(index) for index in range(200)]
    assert {group: groups.count(group) for group in SHARES} == {group: 2 * share for group, share in SHARES.items()}
    rows = [row_of(index) for index in range(700)]
    assert min(rows.count(row) for row in set(rows)) >= 7
