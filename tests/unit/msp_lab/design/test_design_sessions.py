"""Sessions, how far they tell answers apart, and the power that follows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from msp_lab.design.answers import FittedAnswer, OldReadings, fit_answers, with_strength
from msp_lab.design.bench import BenchSessions
from msp_lab.design.choose import Decision, Design, Same, SessionPlace, _classes, _long_enough, cheapest
from msp_lab.design.flight import Pilot
from msp_lab.design.proof import Proof
from msp_lab.design.questions import NONE, Answer, OpenQuestion
from msp_lab.design.separation import Separation, needed_nats, power_of, separation, threshold_nats
from msp_lab.design.session import PlannedSession
from msp_lab.gap import rules
from msp_lab.gap.findings import Settings
from msp_lab.gap.intake import Comparison, Readings
from msp_range.config import load_airframe
from msp_range.reading_model.rows import Base
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model, load_model, make_term
from tests.support.measured import ROOT

SENSOR = ROOT / "configs/sensors/mb1242.yaml"
GIVEN = Model.of(load_model(SENSOR).sensor.model_copy(update={"effects": ()}))
BENCH = BenchSessions(SENSOR, GIVEN.sensor, ("left",))
RECORD = frozenset({"true_range_cm", "air_temperature_c"})


def answer(name: str, values: dict[str, float]) -> FittedAnswer:
    model = replace(GIVEN, effects=(make_term(name, None, values),))
    return FittedAnswer(Answer(name), model.effects, Base(), 0.0, model)


def nats(first: FittedAnswer, second: FittedAnswer, *varied: str) -> float:
    session = BENCH.session(varied, True, RECORD, 200)
    found = separation(GIVEN, (first, second), (0, 1), session.sampled(400), 0.0, np.random.default_rng(1))
    return found.nats(800, session.runs)


SCALE, AIR, OFFSET = (
    answer("range_scale", {"scale_pct": -2.0}),
    answer("air_temperature", {"share": 0.7}),
    answer("thermometer_offset", {"offset_c": -11.0}),
)


def test_an_alternative_with_free_numbers_imitates_what_the_session_does_not_vary() -> None:
    assert nats(SCALE, OFFSET, "true_range_cm") < 2.0
    assert nats(SCALE, AIR, "true_range_cm", "air_temperature_c") > 50.0


def test_a_power_of_95_per_cent_needs_13_6_nats_beyond_which_five_are_alike() -> None:
    needed = needed_nats(0.95, 5.0)
    drawn = np.random.default_rng(1).normal(needed, np.sqrt(2.0 * needed), 20_000)
    assert np.mean(drawn > 5.0) == pytest.approx(0.95, abs=0.006)
    assert power_of(needed, 5.0) == pytest.approx(0.95)


def test_the_new_readings_have_to_outweigh_what_the_old_ones_say_against_the_right_answer() -> None:
    nothing = FittedAnswer(NONE, (), SCALE.base, 0.0, GIVEN)
    assert threshold_nats(SCALE, nothing) == 8.0
    for_it, against, far_against = (replace(SCALE, log_likelihood=nats) for nats in (3.0, -3.0, -30.0))
    assert [threshold_nats(each, AIR) for each in (for_it, against, far_against)] == [5.0, 8.0, 10.0]


def test_placements_limit_what_differs_between_runs() -> None:
    session = BENCH.session(("true_range_cm", "air_temperature_c"), True, RECORD, 200)
    of = [
        separation(GIVEN, (SCALE, AIR), (0, 1), session.sampled(400), offset_cm, np.random.default_rng(1))
        for offset_cm in (0.0, 1.0)
    ]
    assert of[0].nats(10_000, 4) / of[0].nats(100, 4) == pytest.approx(100.0)
    assert of[1].nats(10_000, 4) < 20.0 * of[1].nats(100, 4)


def test_far_shifts_keep_their_share_inside_runs() -> None:
    """Each run has one temperature and both ranges; a reading that is shifted by many sigma counts as an outlier."""
    contexts = {
        "run": np.repeat([f"r{each}" for each in range(4)], 200),
        "true_range_cm": np.tile(np.repeat([60.0, 400.0], 100), 4),
        "air_temperature_c": np.repeat([2.0, 32.0, 2.0, 32.0], 200),
    }
    found = separation(GIVEN, (AIR, SCALE), (0, 1), contexts, 1.0, np.random.default_rng(1))
    assert found.within_nats > 0.2 * found.between_nats


def test_offsets_of_runs_do_not_hide_a_wider_scatter() -> None:
    contexts = {
        "run": np.repeat([f"r{each}" for each in range(4)], 200),
        "true_range_cm": np.full(800, 200.0),
        "throttle": np.tile(np.linspace(0.0, 1.0, 200), 4),
    }
    rotors, nothing = answer("rotor_noise", {"growth": 2.0}), FittedAnswer(Answer(None), (), SCALE.base, 0.0, GIVEN)
    found = separation(GIVEN, (rotors, nothing), (0, 1), contexts, 1.0, np.random.default_rng(1))
    assert found.within_nats > 10.0 * found.between_nats


def test_the_lead_of_runs_does_not_scatter_by_chance() -> None:
    """Each of 60 runs has one of two temperatures: the wrong answer is as far off in all of them."""
    contexts = {
        "run": np.repeat([f"r{each:02d}" for each in range(60)], 20),
        "time_s": np.tile(0.1 * np.arange(20), 60),
        "true_range_cm": np.full(1200, 200.0),
        "air_temperature_c": np.repeat(np.tile([2.0, 32.0], 30), 20),
    }
    air = answer("air_temperature", {"share": 0.5})
    numbers = {"correlation": 0.3, "correlation_spacing_s": 0.1}
    mixture = GIVEN.sensor.reading_model.model_copy(update=numbers)
    correlated = Model.of(GIVEN.sensor.model_copy(update={"reading_model": mixture}))
    even, uneven = (
        separation(given, (air, SCALE), (0, 1), contexts, offset_cm, np.random.default_rng(1))
        for given, offset_cm in ((GIVEN, 0.0), (correlated, 1.5))
    )
    assert even.run_scatter is not None
    assert even.run_scatter < 0.05
    assert (even.correlation, uneven.correlation) == (0.0, 0.3)


def test_what_is_like_the_same_third_answer_is_alike() -> None:
    assert _classes(4, [Same(0, 1, 1.0), Same(1, 3, 1.0)]) == (frozenset({0, 1, 3}), frozenset({2}))


def test_a_bench_session_is_the_plan_of_a_campaign() -> None:
    session = BENCH.session(("true_range_cm", "vibration_hz"), False, RECORD, 30)
    assert (session.runs, session.readings) == (15, 450)
    assert set(session.contexts["vibration_hz"]) == {0.0, 50.0, 100.0}
    longer = BENCH.session(("true_range_cm", "vibration_hz"), False, RECORD, 60)
    assert longer.minutes - session.minutes == pytest.approx(450 * 0.1 / 60.0)


def test_a_flight_session_varies_throttle_and_climb_independently() -> None:
    file = ROOT / "configs/quad_pallet.yaml"
    pilot = Pilot(file, load_airframe(file))
    session = pilot.session(("throttle", "range_rate_cm_s"), False, RECORD, 40)
    throttle, rate = session.contexts["throttle"], session.contexts["range_rate_cm_s"]
    assert np.ptp(np.quantile(throttle, [0.02, 0.98])) > 0.5
    assert abs(np.corrcoef(throttle, rate)[0, 1]) < 0.2
    assert session.runs == 6


def test_an_effect_of_unknown_strength_gets_the_smallest_that_matters() -> None:
    effect = answer("rotor_noise", {"growth": 0.0})
    unknown = FittedAnswer(effect.answer, effect.terms, effect.base, None, effect.model, assumed=True)
    contexts = {"true_range_cm": np.full(2000, 200.0), "throttle": np.linspace(0.0, 1.0, 2000)}
    growth = with_strength(unknown, GIVEN, contexts, np.random.default_rng(1)).terms[-1].values["growth"]
    assert 0.3 < growth < 1.5
    assert with_strength(SCALE, GIVEN, contexts, np.random.default_rng(1)) is SCALE


def test_the_interval_of_a_power_that_never_failed() -> None:
    low, high = Proof(60, 60).interval
    assert low == pytest.approx(0.025 ** (1 / 60))
    assert high == 1.0


def test_a_session_is_as_long_as_its_own_readings_need_and_never_longer_than_gap_fits() -> None:
    """A flight's climbs come on top of the readings that were asked for: their number is that of the session made."""
    session = BENCH.session(("true_range_cm",), True, RECORD, 20)
    contexts = {name: np.tile(column, 5) for name, column in session.contexts.items()}

    def make(readings: int, visits: int) -> PlannedSession:
        some = {name: column[: visits * (100 + 2 * readings)] for name, column in contexts.items()}
        return replace(session, contexts=some, per_point=readings, visits=visits, minutes=visits * (9.0 + readings))

    def found(within_nats: float) -> PlannedSession | None:
        separated = Separation(0, 1, within_nats, 0.0, 0.0, 0.0)
        return _long_enough(make, make(20, 1), [separated], lambda truth, alternative: 15.0)

    contexts |= {name: np.resize(column, 40_000) for name, column in contexts.items()}
    enough = found(0.05)
    assert enough is not None
    assert 300 <= enough.readings < 330
    assert found(1e-4) is None


@pytest.mark.slow
def test_the_cheapest_session_decides_what_can_be_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a scale, the air and a thermometer's offset the first and the last are alike in all that a bench can vary."""
    monkeypatch.setattr("msp_lab.design.choose.DRAWN_ROWS", 600)
    monkeypatch.setattr("msp_lab.design.choose.CHECKED_ROWS", 1200)
    weak = [
        answer("range_scale", {"scale_pct": -0.875}),
        answer("air_temperature", {"share": 0.2625}),
        answer("thermometer_offset", {"offset_c": -4.375}),
    ]
    question = OpenQuestion("indistinguishable", tuple(each.answer for each in weak), "")

    def found(max_minutes: float) -> Design:
        decision = Decision(question, tuple(weak), GIVEN, 0.95, 0.0, 0, np.random.default_rng(1))
        return cheapest(decision, [BENCH], max_minutes, lambda what, share: None)

    design = found(240.0)
    assert design.classes == (frozenset({0, 2}), frozenset({1}))
    assert [(each.one, each.other, each.structural) for each in design.same] == [(0, 2, True)]
    assert {(each.truth, each.alternative) for each in design.separations} == {(0, 1), (1, 0), (1, 2), (2, 1)}
    session = design.session
    assert session is not None
    assert design.make is not None
    assert set(session.contexts["air_temperature_c"]) == {0.0, 40.0}

    def least(readings: int, runs: int) -> float:
        return min(each.nats(readings, runs) for each in design.separations)

    # A tenth more than are needed; the readings that checked it can only have made it longer.
    needed = needed_nats(0.95, 5.0)
    assert design.needed_nats == pytest.approx(needed)
    assert least(session.readings, session.runs) >= 1.1 * needed
    assert least(int(0.75 * session.readings), session.runs) < 1.1 * needed
    assert design.power == pytest.approx(power_of(least(session.readings, session.runs), 5.0))
    longer = design.longer(3.0)
    assert longer.session is not None
    assert longer.session.per_point == 3 * session.per_point
    # In less time there is none, and the words say how much it takes.
    none = found(session.minutes - 0.03)
    assert none.session is None
    assert f"takes {session.minutes:.0f} minutes; allow it with --max-minutes" in none.why
    assert none.classes == (frozenset({0, 1, 2}),)


def test_repeated_placements_make_what_differs_between_runs_certain() -> None:
    once, twice = (BENCH.session(("true_range_cm", "air_temperature_c"), True, RECORD, 50, n) for n in (1, 2))
    assert (once.runs, twice.runs) == (4, 8)
    assert set(twice.contexts["true_range_cm"]) == {60.0, 400.0}
    # The air, which is slow to change, is changed once in both; each point takes a minute to place.
    assert twice.minutes - once.minutes == pytest.approx(4.0 + 200 * 0.1 / 60.0)
    between = Separation(0, 1, 0.0, 0.1, 1.0, 0.0)
    assert between.nats(400, 8) > 1.9 * between.nats(400, 4)


def test_where_offsets_show_alternatives_are_compared_by_the_scatter_of_runs() -> None:
    """`gap` counts a lead by its scatter over runs there, so that more readings in as many runs do not help."""
    by_run = Separation(0, 1, 0.1, 0.0, 0.5, 0.0, run_scatter=0.2)
    assert by_run.nats(20_000, 6) < 1.1 * by_run.nats(10_000, 6)
    assert by_run.nats(20_000, 24) > 5.0 * by_run.nats(20_000, 6)
    assert replace(by_run, other_runs=18).nats(20_000, 6) > 2.0 * by_run.nats(20_000, 6)
    alone = replace(by_run, run_scatter=None)
    assert alone.nats(1000, 6) == pytest.approx(100.0)
    # Neighbours whose errors have a correlation of a half count as a third; of many readings alternatives get some.
    assert replace(alone, correlation=0.5).nats(900, 6) == pytest.approx(30.0)
    rows = int(2.5 * rules.READINGS)
    assert replace(by_run, offsets=0.0).nats(rows, 24) == pytest.approx(0.1 * rules.READINGS)
    assert replace(alone, offsets=0.0).nats(rows, 24) == pytest.approx(0.1 * rows)


def test_a_neighbour_is_heard_together_or_in_turn() -> None:
    bench = BenchSessions(SENSOR, GIVEN.sensor, ("left", "right"))
    record = frozenset({"neighbour_lag_ms", "neighbour_range_cm", "true_range_cm"})
    assert bench.can_record(record)
    assert bench.factors(record) == ("true_range_cm", "neighbour_lag_ms")
    session = bench.session(("neighbour_lag_ms",), True, record, 30)
    lag_ms, name = session.contexts["neighbour_lag_ms"], session.contexts["sensor"]
    assert set(lag_ms[name == "right"]) == {0.4, 100.0}
    assert session.campaign["conditions"][0]["firing"] == ["simultaneous", "sequential"]
    assert "neighbour_lag_ms" not in BENCH.factors(record)


@pytest.mark.parametrize(
    ("names", "at_bench", "words"),
    [
        (("rotor_noise", "spread_with_range"), True, "a bench has no rotors"),
        (("vibration", "spread_with_range"), False, "hold the sensor on a shaker"),
        (("crosstalk", "clutter"), False, "let two sensors ping together"),
    ],
)
def test_what_cannot_be_varied_comes_with_what_to_do_instead(
    names: tuple[str, str], at_bench: bool, words: str
) -> None:
    file = ROOT / "configs/quad_pallet.yaml"
    place: SessionPlace = BENCH if at_bench else Pilot(file, load_airframe(file))
    question = OpenQuestion("indistinguishable", (Answer(names[0]), Answer(names[1])), "")
    decision = Decision(question, (), GIVEN, 0.95, 0.0, 0, np.random.default_rng(1))
    design = cheapest(decision, [place], 240.0, lambda what, share: None)
    assert design.session is None
    assert words in design.why


def test_what_a_number_of_the_model_absorbed_is_planned_as_strong_as_it_explains_that_number() -> None:
    """A steady throttle: short readings are more frequent, by the rotors' wash or in any case."""
    rng = np.random.default_rng(4)
    size = 1200
    contexts = {
        "true_range_cm": rng.uniform(100.0, 300.0, size),
        "throttle": 0.5 + 0.005 * rng.standard_normal(size),
        "run": np.repeat([f"r{each}" for each in range(10)], size // 10),
    }
    washed = replace(GIVEN, effects=(make_term("prop_wash", None, {"log_odds": 3.0}),))
    data = contexts | {"reading_cm": washed.sample(contexts, rng)}
    old = OldReadings(Comparison.of(Readings(MeasuredData(data), ()), GIVEN, Settings(str(SENSOR))), ())
    question = OpenQuestion("absorbed", (Answer("prop_wash"), NONE), "")
    wash, nothing = fit_answers(old, question)
    assert not wash.assumed
    assert 1.5 < wash.terms[-1].values["log_odds"] < 3.0
    # Between the number and the wash, which a steady throttle does not tell apart, their priors decide.
    assert abs(wash.base[2]) < 0.35 < nothing.base[2]
    # What the run named itself is not in the model twice.
    named, _ = fit_answers(replace(old, terms=washed.effects), question)
    assert [each.values for each in named.terms] == [each.values for each in wash.terms]
    # Offsets of runs are those of the given model and those that were found.
    scattered = replace(old.comparison, model=GIVEN.adding("run_offsets", deviation_cm=3.0))
    offsets = make_term("run_offsets", None, {"deviation_cm": 4.0})
    assert OldReadings(scattered, (offsets,)).run_offset_cm == pytest.approx(5.0)


def test_a_strength_that_is_hardly_known_is_planned_as_strong_as_it_explains_the_number() -> None:
    """A throttle that hardly varies: the effect fits by some nats better, and its strength may be anything."""
    rng = np.random.default_rng(1)
    size = 2000
    contexts = {
        "true_range_cm": rng.uniform(100.0, 300.0, size),
        "throttle": 0.5 + 0.015 * rng.standard_normal(size),
        "run": np.repeat([f"r{each}" for each in range(10)], size // 10),
    }
    louder = replace(GIVEN, effects=(make_term("rotor_noise", None, {"growth": 2.0, "exponent": 1.0}),))
    data = contexts | {"reading_cm": louder.sample(contexts, rng)}
    old = OldReadings(Comparison.of(Readings(MeasuredData(data), ()), GIVEN, Settings(str(SENSOR))), ())
    noise, nothing = fit_answers(old, OpenQuestion("absorbed", (Answer("rotor_noise"), NONE), ""))
    assert noise.log_likelihood is not None
    assert nothing.log_likelihood is not None
    assert noise.log_likelihood - nothing.log_likelihood > 2.0
    values = noise.terms[-1].values
    assert np.log1p(values["growth"] * 0.5 ** values["exponent"]) == pytest.approx(np.log(2.0), abs=0.1)


def test_flights_at_the_ends_of_the_throttle_do_not_hover_between_them() -> None:
    file = ROOT / "configs/quad_pallet.yaml"
    pilot = Pilot(file, load_airframe(file))
    some, ends = (pilot.session(("throttle",), ends_only, RECORD, 40) for ends_only in (False, True))
    assert np.var(ends.contexts["throttle"]) > 1.4 * np.var(some.contexts["throttle"])
    assert len(pilot.flown) == 2


def test_sensors_that_ping_together_give_a_flight_as_many_readings_as_are_planned(tmp_path: Path) -> None:
    vehicle = yaml.safe_load((ROOT / "configs/quad_pallet.yaml").read_text())
    vehicle["sensors"] = [sensor | {"model": str(SENSOR)} for sensor in vehicle["sensors"]]
    first, second, *others = [sensor["name"] for sensor in vehicle["sensors"]]
    minutes = []
    for groups in ([[first], [second], others], [[first, second], others]):
        file = tmp_path / f"{len(groups)}.yaml"
        file.write_text(yaml.safe_dump(vehicle | {"polling": {"groups": groups}}))
        session = Pilot(file, load_airframe(file)).session(("throttle",), False, RECORD, 400)
        assert session.per_point == 400
        # The climb to the height of the session comes on top.
        assert 400 <= np.count_nonzero(session.contexts["sensor"] == first) / session.runs < 480
        minutes.append(session.minutes - session.runs * 3.0)
    assert minutes[1] < 0.75 * minutes[0]
