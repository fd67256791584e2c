"""Sensors held against their reading models while they fly."""

import math
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from evaluation.sensor_watch.drawn import MODEL, NAMES, SLOT_S, STD_M, TURN_S, Fault, Ground, draw, feed, watch_of
from msp_range.assembly import expected_of, sensor_watch_of
from msp_range.config import load_airframe
from msp_range.health import Expected, GroundUse, SensorWatch
from msp_range.health.evidence import Evidence, Occurrences
from msp_range.health.finding import Kind, SensorFinding
from msp_range.health.neighbours import ACCELERATION_M_S2, Sighting, reference
from msp_range.pilot_texts import LONGEST_TEXT
from msp_range.reading_model.sensor_model import MEAN_EFFECTS, SensorModel, load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.model.in_flight import in_flight
from msp_sim.model.model import Model
from tests.support.bench import FOUR_DOWN, airframe
from tests.support.shipped import CONFIGS

DOWN, LEANS = (0.0, 0.0, 1.0), (math.sin(0.1), 0.0, math.cos(0.1))
KINDS: tuple[Kind, ...] = ("short", "missed", "wider", "shifted", "repeats")


def test_a_report_without_a_change_takes_as_many_readings_as_its_threshold_on_average() -> None:
    """E[T] >= A, with random ratios of expectation 1: of a normal mean of 1 against 0."""
    draws = np.random.default_rng(1)
    times = []
    for _ in range(150):
        evidence, count, is_found = Evidence(300.0), 0, False
        while not is_found:
            count += 1
            is_found = evidence.update(math.exp(draws.standard_normal() - 0.5), 1.0, 1.0)
        times.append(count)
    assert 300.0 < np.mean(times) < 900.0


def test_a_reading_that_is_taken_back_has_not_counted() -> None:
    taken_back, never = Evidence(300.0), Evidence(300.0)
    for evidence in (taken_back, never):
        assert not evidence.update(4.0, 0.5, 3.0)
    taken_back.update(30.0, 1.0, 9.0)
    taken_back.retract()
    assert taken_back.ratio == never.ratio == 6.0
    assert [taken_back.update(4.0, 0.5, 3.0) for _ in range(5)] == [never.update(4.0, 0.5, 3.0) for _ in range(5)]


def test_readings_in_which_nothing_happens_count_as_if_each_had_been_reported() -> None:
    one_by_one, at_once = Occurrences(1e9, 6.0), Occurrences(1e9, 6.0)
    for each in (one_by_one, at_once):
        for _ in range(5):
            each.happens(0.1, [])
    for _ in range(40):
        one_by_one.update(1.0 / 1.5, 0.1, 0.0)
    at_once.nones += 40
    assert at_once.happens(0.1, []) is one_by_one.happens(0.1, []) is False
    assert at_once._sum == pytest.approx(one_by_one._sum)


def test_what_never_happens_by_the_model_is_found_when_it_does() -> None:
    """A weight of 0 in a model file: all readings in which nothing happens are as likely by both."""
    never = Occurrences(1000.0, 6.0)
    for _ in range(5):
        never.nones += 10
        if never.happens(0.0, []):
            break
    assert never.is_found
    assert "99 times as often" in SensorFinding("front", "short", never.ratio).remedy


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["a", "front_left", "the_sensor_at_the_left_corner_32"])
@pytest.mark.parametrize("size", [0.08, 1.94, 12.3, 250.0])
def test_a_finding_is_a_text_that_fits_whatever_the_name(kind: Kind, name: str, size: float) -> None:
    """A name of a usual length leaves room for what to do; no text needs to know what a ratio is."""
    text = SensorFinding(name, kind, -size if kind == "shifted" else size).text
    assert text.startswith(f"Range {name}: ")
    assert len(text) <= LONGEST_TEXT
    assert text.endswith(", check sensor") == (len(name) <= 10)
    assert "expected" not in text


@pytest.mark.parametrize(("missed", "growth_per_m", "range_m", "expected"), [
    (0.02, 0.0, 6.0, 0.02), (0.5, 1.0, 4.0, 0.731), (0.0, 0.7, 6.0, 0.0), (1.0, 0.7, 6.0, 1.0),
    (0.1, 100.0, 30.0, 1.0), (0.1, -100.0, 30.0, 0.0),
])  # fmt: skip
def test_the_share_of_missed_echoes_grows_with_range(
    missed: float, growth_per_m: float, range_m: float, expected: float
) -> None:
    model = Expected(0.01, missed, 0.01, growth_per_m, 0.0, 1.0, 0.2, 40.0, DOWN, 0.0)
    assert model.missed_at(range_m) == pytest.approx(expected, abs=1e-3)
    # Of a sensor that reaches less than 3 m the share is that at its longest range.
    near = model._replace(maximum_m=1.0)
    assert near.missed_at(range_m - 2.0) == pytest.approx(expected, abs=1e-3)


def test_what_others_show_too_is_no_finding() -> None:
    sensors = [Occurrences(1e8, 6.0) for _ in range(4)]
    draws = np.random.default_rng(2)
    for _ in range(3000):
        for each in sensors:
            if draws.random() < 0.15:
                each.happens(0.01, [other for other in sensors if other is not each])
            else:
                each.nones += 1
    assert not any(each.is_found for each in sensors[1:])
    assert sensors[0].frequency == pytest.approx(0.15, abs=0.1)
    # Their mean replaces the model's probability but for its standard error.
    sensors[0].happens(0.01, sensors[1:])
    assert 0.01 < sensors[0]._probability < np.mean([each.frequency for each in sensors[1:]])


def test_the_reference_is_the_others_height_at_the_time_of_the_reading() -> None:
    """On a steady climb, exactly; its own reading and its own sensor's take no part."""
    climb_m_s = 1.5

    def seen(i: int, sensor: str, off_m: float = 0.0) -> Sighting:
        height_m = 2.0 + climb_m_s * i * SLOT_S + off_m
        return Sighting(sensor, i * SLOT_S, GroundUse.GROUND, height_m, STD_M, None, climb_m_s, DOWN, height_m)

    window = [
        seen(*each) for each in ((0, "d"), (1, "b", 5.0), (2, "a"), (3, "b", 5.0), (4, "c"), (5, "b", 5.0), (6, "d"))
    ]
    found = reference(window, 3, 1.0)
    assert found is not None
    assert found.height_m == pytest.approx(2.0 + climb_m_s * 0.3)
    assert found.climb_m_s == pytest.approx(climb_m_s)
    # The mean of four, and an acceleration that bends the line between 0.2 s before and 0.2 s after.
    assert found.variance_m2 == pytest.approx(STD_M**2 / 4 + (0.5 * ACCELERATION_M_S2 * 0.2**2) ** 2)
    assert reference(window[:4], 3, 1.0) is None, "nobody after it"
    stepped = window[:4] + [each._replace(common_m=(each.common_m or 0.0) + 0.3) for each in window[4:]]
    assert reference(stepped, 3, 1.0) is None, "the ground has a step"
    standing = [each._replace(climb_m_s=0.0) for each in window]
    assert reference(standing, 3, 1.0) is None, "the ground rises, and not the vehicle"


@pytest.mark.parametrize(
    ("fault", "kind", "size", "within_s"),
    [
        (Fault(300.0, short=0.10), "short", 7.5, 60.0),
        (Fault(300.0, short=0.20), "short", 14.0, 30.0),
        (Fault(300.0, missed=0.20), "missed", 10.0, 30.0),
        (Fault(300.0, wider=2.0), "wider", 2.0, 30.0),
        (Fault(300.0, shift_m=-0.12), "shifted", -0.12, 30.0),
    ],
)
def test_a_sensor_that_reads_otherwise_than_its_model_is_found_and_no_other(
    fault: Fault, kind: Kind, size: float, within_s: float
) -> None:
    draws = np.random.default_rng(3)
    delays_s, sizes = [], []
    for _ in range(11):
        time_s, finding = next(feed(watch_of(), draw(draws, 1200 / 3600, Ground(), fault)))
        assert time_s >= fault.from_s
        assert finding.sensor == "a"
        assert finding.kind == kind
        delays_s.append(time_s - fault.from_s)
        sizes.append(finding.size)
    assert median(delays_s) < within_s
    assert median(sizes) == pytest.approx(size, rel=0.35)


@pytest.mark.parametrize(
    "ground",
    [
        Ground(rough_m=0.03, rough_lasts=0.9),
        Ground(slope=0.1, turn_s=20.0, rough_m=0.03, rough_lasts=0.5),
        Ground(correlation=0.9),
        Ground(scale=1.04),
    ],
    ids=["rough", "slope", "correlation", "all 4 % too long"],
)
def test_what_is_common_to_all_sensors_is_not_blamed_on_one(ground: Ground) -> None:
    assert list(feed(watch_of(), draw(np.random.default_rng(4), 1.0, ground))) == []


def test_a_finding_ends_when_the_sensor_is_as_its_model_again() -> None:
    watch = watch_of()
    draws = np.random.default_rng(5)
    bad = draw(draws, 400 / 3600, Ground(), Fault(100.0, missed=0.3, short=0.2))
    assert {finding.kind for _, finding in feed(watch, bad)} == {"missed", "short"}
    list(feed(watch, draw(draws, 400 / 3600, Ground(), start_s=400.0)))
    assert watch.findings == []


def fly(
    watch: SensorWatch,
    off_m: Callable[[str, float], float | None],
    seconds: float,
    names: tuple[str, ...] = NAMES,
    seen: GroundUse = GroundUse.OTHER,
    down: tuple[float, float, float] = DOWN,
    climb_m_s: float = 0.0,
) -> set[tuple[str, Kind]]:
    """Findings over level ground; what is more than 15 cm off was ``seen`` by the fusion, and None is no echo."""
    draws = np.random.default_rng(6)
    found: set[tuple[str, Kind]] = set()
    for i in range(round(seconds / SLOT_S)):
        name, time_s = names[i % len(names)], i * SLOT_S
        off = off_m(name, time_s)
        if off is None:
            watch.update(Sighting(name, time_s, GroundUse.MISSED, None, 0.0, 765, climb_m_s, down))
        else:
            height_m = 2.0 + climb_m_s * time_s + off + STD_M * draws.standard_normal()
            kind = GroundUse.GROUND if abs(off) < 0.15 else seen
            raw = round(100 * height_m)
            watch.update(Sighting(name, time_s, kind, height_m, STD_M, raw, climb_m_s, down))
        found |= {(each.sensor, each.kind) for each in watch.findings}
    return found


def test_an_object_below_a_sensor_is_no_short_reading_and_single_ones_are() -> None:
    box = fly(watch_of(), lambda name, time_s: -0.5 if name == "a" and time_s % 20.0 < 4.0 else 0.0, 300.0)
    assert box == set()
    boxes = fly(watch_of(), lambda name, time_s: -0.5 if name == "a" and time_s % 4.0 < 0.8 else 0.0, 300.0)
    assert boxes == set()
    single = fly(watch_of(), lambda name, time_s: -0.5 if name == "a" and time_s % 4.0 < 0.4 else 0.0, 300.0)
    assert single == {("a", "short")}


def test_outliers_of_the_ground_do_not_teach_a_larger_scatter() -> None:
    watch = watch_of()
    fly(watch, lambda name, time_s: -0.14 if name == "a" and time_s % 4.0 < 0.4 else 0.0, 100.0)
    assert watch._sensors["a"].scale < 1.5


def test_a_shift_is_asked_for_only_while_the_vehicle_moves_over_level_ground() -> None:
    def shifted(name: str, time_s: float) -> float:
        return 0.10 if name == "a" else 0.0

    assert fly(watch_of(), shifted, 120.0, down=LEANS) == {("a", "shifted")}
    assert fly(watch_of(), shifted, 120.0) == set(), "a hover: it may be a stone"
    slope = dict(zip(NAMES, (0.10, 0.0, 0.0, -0.10), strict=True))
    assert fly(watch_of(), lambda name, _: slope[name], 120.0, down=LEANS) == set(), "the others see a slope"


def test_a_tuft_of_rough_ground_is_no_shift_while_the_others_happen_to_agree() -> None:
    phase = dict(zip(NAMES, (0.0, 1.5, 3.0, 4.5), strict=True))

    def rough(name: str, time_s: float) -> float:
        if time_s < 120.0:
            return 0.04 * math.sin(time_s / 20.0 + phase[name])
        return 0.10 if name == "a" else 0.0

    assert fly(watch_of(), rough, 180.0, down=LEANS) == set()


def test_a_leaning_sensor_is_not_asked_for_missed_echoes() -> None:
    def misses(name: str, time_s: float) -> float | None:
        return None if name == "a" and time_s % 2.0 < 0.4 else 0.0

    lean = math.radians(10.0)
    assert fly(watch_of(), misses, 120.0) == {("a", "missed")}
    assert fly(watch_of(), misses, 120.0, down=(math.sin(lean), 0.0, math.cos(lean))) == set()


@pytest.mark.parametrize("names", [NAMES, ("a",)], ids=["four sensors", "one"])
def test_a_sensor_that_repeats_old_readings_while_the_vehicle_climbs_is_found(names: tuple[str, ...]) -> None:
    watch = SensorWatch(dict.fromkeys(names, MODEL), len(names) * 0.4)
    height_m, found = 1.0, set()
    old_m = height_m
    for i in range(4000):
        name, time_s = names[i % len(names)], 0.4 * i
        climb_m_s = 0.8 if time_s % 20.0 < 10.0 else -0.8
        height_m += climb_m_s * 0.4
        draws = np.random.default_rng(i)
        if name != "a" or draws.random() > 0.5:
            reading_m = height_m + STD_M * draws.standard_normal()
            old_m = reading_m if name == "a" else old_m
        else:
            reading_m = old_m
        seen = GroundUse.GROUND if abs(reading_m - height_m) < 0.15 else GroundUse.REPEATED
        watch.update(Sighting(name, time_s, seen, reading_m, STD_M, round(100 * reading_m), climb_m_s, DOWN))
        found |= {(each.sensor, each.kind) for each in watch.findings}
    assert ("a", "repeats") in found
    assert {sensor for sensor, _ in found} == {"a"}


def test_a_single_sensor_is_asked_for_codes_and_nothing_else() -> None:
    one = SensorWatch({"a": MODEL}, SLOT_S)
    missed = fly(one, lambda _, time_s: None if round(time_s / SLOT_S) % 5 == 0 else 0.0, 120.0, ("a",))
    assert missed == {("a", "missed")}
    one = SensorWatch({"a": MODEL}, SLOT_S)
    assert fly(one, lambda _, time_s: -0.6 if round(time_s / SLOT_S) % 5 == 0 else 0.0, 120.0, ("a",)) == set()


def test_the_watch_says_why_it_is_off() -> None:
    assert isinstance(sensor_watch_of(airframe()), SensorWatch)
    assert sensor_watch_of(airframe(sensor_watch=False)) == "switched off in the airframe file"
    alone = airframe(FOUR_DOWN[:1], send={"sensors": ["a"]}, filters=[])
    assert sensor_watch_of(alone) == "there is no fused stream to compare with"
    with_effects = airframe([{**each, "model": "sensors/mb1242_bench.yaml"} for each in FOUR_DOWN])
    assert sensor_watch_of(with_effects) == (
        "sensors/mb1242_bench.yaml: no numbers (in_flight) of what beyond_field_of_view, crosstalk, external_source, "
        "small_target make of the readings"
    )


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_watch_is_on_for_each_airframe_with_a_fused_stream(path: Path) -> None:
    shipped = load_airframe(path)
    watch = sensor_watch_of(shipped)
    if shipped.send.fused is None:
        assert watch == "there is no fused stream to compare with"
    else:
        assert isinstance(watch, SensorWatch), watch


def expected_numbers(model: SensorModel, turn_s: float = 0.4) -> Expected:
    """What a sensor that looks down is expected to read."""
    numbers = expected_of(model, DOWN, turn_s)
    assert isinstance(numbers, Expected)
    return numbers


def test_the_watch_is_on_with_the_model_that_has_effects() -> None:
    """Its numbers are those of the command in docs/watching.md, and about what it makes of a hover at 3 m."""
    watched = load_sensor_model(CONFIGS / "sensors" / "mb1242_in_flight.yaml")
    numbers = expected_numbers(watched, TURN_S)
    contexts = {"true_range_cm": np.full(500, 300.0), "throttle": np.full(500, 0.5)}
    hover = in_flight(Model.of(watched), contexts, np.random.default_rng(1))
    assert hover is not None
    assert numbers.short == pytest.approx(hover.short, rel=0.4)
    assert numbers.missed == pytest.approx(hover.missed, rel=0.1)
    assert numbers.spread * watched.reading_model.sigma_cm == pytest.approx(hover.sigma_cm, rel=0.1)


def test_plain_numbers_for_the_flight_take_the_place_of_the_base_models() -> None:
    model = load_sensor_model(CONFIGS / "sensors" / "mb1242.yaml")
    assert expected_numbers(model)[:6] == (0.01, 0.02, 0.01, 0.0, 0.0, 1.0)
    in_flight = {"short": 0.05, "missed": 0.1, "sigma_cm": 2 * model.reading_model.sigma_cm}
    content = model.model_dump(mode="json") | {"effects": [{"name": "prop_wash"}], "in_flight": in_flight}
    content["reading_model"] |= {"correlation": 0.5, "correlation_spacing_s": 0.2}
    assert expected_numbers(type(model).model_validate(content))[:6] == pytest.approx((0.05, 0.1, 0.0, 0.0, 0.25, 2.0))


def test_the_effects_that_need_no_numbers_change_the_mean_only() -> None:
    assert {name for name, effect in CATALOGUE.items() if effect.channels == ("bias",)} >= MEAN_EFFECTS


@pytest.mark.parametrize(("spread", "found"), [(2.0, set()), (1.0, {("a", "wider")})])
def test_a_sensor_scatters_as_its_model_in_flight_says(spread: float, found: set[tuple[str, Kind]]) -> None:
    """Twice the deviation that its readings come with, which the model of its flights may have said."""
    draws = np.random.default_rng(7)
    watch = SensorWatch({name: MODEL._replace(spread=spread if name == "a" else 1.0) for name in NAMES}, TURN_S)

    def wider_m(name: str, time_s: float) -> float:
        return math.sqrt(3.0) * STD_M * float(draws.standard_normal()) if name == "a" else 0.0

    assert fly(watch, wider_m, 300.0) == found


def test_an_uneven_turn_or_a_dead_sensor_does_no_harm() -> None:
    watch = SensorWatch(dict.fromkeys(NAMES, MODEL), TURN_S)
    for i in range(2000):
        name = NAMES[i % 3]
        watch.update(Sighting(name, SLOT_S * (i // 2), GroundUse.GROUND, 2.0, STD_M, 200, 0.0, DOWN))
        watch.update(Sighting("d", SLOT_S * (i // 2), GroundUse.NOTHING, None, 0.0, None, 0.0, DOWN))
    assert watch.findings == []


@pytest.mark.parametrize(("stone_m", "every_s"), [(0.06, 30.0), (0.09, 20.0), (0.12, 14.0)])
def test_a_stone_below_a_sensor_is_no_scatter(stone_m: float, every_s: float) -> None:
    """The reading with which it begins is not counted either."""
    stones = fly(watch_of(), lambda name, time_s: -stone_m if name == "a" and time_s % every_s < 4.0 else 0.0, 600.0)
    assert stones == set()
