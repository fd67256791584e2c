"""A wrong name is given up for the right one, a needless one goes, and one that does as well is a rival."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap import naming
from msp_lab.gap.candidates import SelectedTerm
from msp_lab.gap.problem import Problem, State, _has_its_form, first_state, screened, without
from msp_lab.gap.refit import refit
from msp_lab.gap.search import Selection, select, select_more, settled
from msp_lab.gap.validation import Dropped, Validated
from msp_range.arrays import numbered
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model, make_curve_term, make_term
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor
from tests.support.slow import slow

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N, RUNS = 2000, 20


def problem_of(ranges_cm: tuple[float, float], delay_ms: float) -> Problem:
    """Readings up and down in no order, which are late."""
    rng = np.random.default_rng(3)
    contexts = {
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
        "true_range_cm": rng.uniform(*ranges_cm, N),
        "range_rate_cm_s": 80.0 * rng.standard_normal(N),
        "vibration_hz": rng.choice([0.0, 60.0], N),
    }
    heard_cm = contexts["true_range_cm"] - 1e-3 * delay_ms * contexts["range_rate_cm_s"]
    reading_cm = np.array(sensor().readings(heard_cm.tolist(), 3))
    return Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng)


def after_exchange(problem: Problem, *names: str) -> Selection:
    """What becomes of these names."""
    starts = {
        "latency": {"delay_ms": 5.0},
        "motion_during_ping": {"share": -0.5},
        "vibration": {"growth": 0.05},
        "nearest_point": {"share": 0.3, "beam": 1.0},
        "range_scale": {"scale_pct": 0.05},
        "heavy_tails": {"share": 0.1, "wider": 2.5},
        "cycle_slip": {"share": 0.05, "cycles": 8.0},
    }
    base = first_state(problem)
    first = screened(problem, base)
    of_name = {candidate.key[0]: candidate for candidate in problem.candidates}
    terms = [SelectedTerm(make_term(name, None, starts[name]), of_name[name]) for name in names]
    state = base.having(problem.refit([each.active for each in terms], base.fit.base), terms)
    return settled(problem, Selection(base, state, first, {}, first.needed_nats))


def names_of(selection: Selection) -> list[str]:
    return [term.key[0] for term in selection.state.terms]


def test_a_wrong_name_is_given_up_for_the_right_one() -> None:
    selection = after_exchange(problem_of((60.0, 700.0), 25.0), "motion_during_ping")
    assert names_of(selection) == ["latency"]
    assert selection.state.terms[0].active.values["delay_ms"] == pytest.approx(25.0, abs=3.0)
    assert "motion_during_ping" not in [each.active.effect.name for each in selection.alternatives["latency", None]]


@pytest.mark.parametrize(
    ("share", "start", "found"),
    [
        pytest.param(0.05, "heavy_tails", ["heavy_tails", "cycle_slip"], marks=pytest.mark.slow),
        (0.0, "cycle_slip", ["heavy_tails"]),
    ],
)
def test_a_slip_is_named_next_to_tails_and_not_in_their_place(share: float, start: str, found: list[str]) -> None:
    """Alone, each explains most of what the other does."""
    rng = np.random.default_rng(5)
    true_cm = rng.uniform(60.0, 500.0, 2 * N)
    off_cm = 1.6 * rng.standard_t(5.0, 2 * N) + np.where(rng.random(2 * N) < share, 5.3, 0.0)
    reading_cm = np.rint(true_cm + off_cm)
    problem = Problem.of(MODEL, {"true_range_cm": true_cm}, reading_cm, np.arange(2 * N) * RUNS // (2 * N), rng)
    assert names_of(after_exchange(problem, start)) == found


@pytest.mark.slow
def test_a_slip_of_which_offset_and_spread_have_taken_most_is_found() -> None:
    """A quarter of the echoes is 1.6 cm late: more scatter, 0.4 cm too far, and nothing that a small share improves."""
    rng = np.random.default_rng(5)
    true_cm = rng.uniform(60.0, 500.0, 3 * N)
    off_cm = 0.9 * rng.standard_normal(3 * N) + np.where(rng.random(3 * N) < 0.25, 1.63, 0.0)
    unit = np.arange(3 * N) * RUNS // (3 * N)
    fine = MODEL.with_step(0.1)
    problem = Problem.of(fine, {"true_range_cm": true_cm}, np.round(true_cm + off_cm, 1), unit, rng)
    base = first_state(problem)
    seen = screened(problem, base)
    of_slips = [gain for gain, each in zip(seen.gain, problem.candidates, strict=True) if each.key[0] == "cycle_slip"]
    assert max(of_slips) < seen.needed_nats
    (term,) = [each for each in select(problem, 6).state.terms if each.key[0] == "cycle_slip"]
    assert term.active.values["share"] == pytest.approx(0.25, abs=0.06)
    assert term.active.values["cycles"] == pytest.approx(4.0, abs=0.3)


@pytest.mark.slow
def test_a_slip_is_no_name_for_noise_that_is_only_wider_and_off() -> None:
    rng = np.random.default_rng(6)
    true_cm = rng.uniform(60.0, 500.0, 3 * N)
    reading_cm = np.rint(true_cm + 0.5 + 2.2 * rng.standard_normal(3 * N))
    unit = np.arange(3 * N) * RUNS // (3 * N)
    problem = Problem.of(MODEL, {"true_range_cm": true_cm}, reading_cm, unit, rng)
    assert "cycle_slip" not in names_of(select(problem, 6))


@pytest.mark.parametrize(
    ("name", "values", "alike"),
    [
        ("thermometer_offset", {"offset_c": 3.0}, True),
        ("threshold_walk", {"walk_cm_per_10db": 0.5, "exponent": 1.0}, True),
        ("threshold_walk", {"walk_cm_per_10db": 0.5, "exponent": 0.0}, False),
        ("bend", {"slope_pct": 1.0, "from_cm": 100.0}, False),
    ],
)
def test_two_effects_that_shift_the_same_readings_alike_are_not_fitted_together(
    name: str, values: dict[str, float], alike: bool
) -> None:
    rng = np.random.default_rng(8)
    true_cm = rng.uniform(20.0, 180.0, N)
    contexts = {"true_range_cm": true_cm, "air_temperature_c": rng.uniform(18.0, 22.0, N)}
    problem = Problem.of(MODEL, contexts, np.rint(true_cm), np.arange(N) * RUNS // N, rng)
    terms = [make_term("range_scale", None, {"scale_pct": -1.0}), make_term(name, None, values)]
    assert _has_its_form(problem, refit(problem.readings, terms, rounds=0)) == alike


def test_what_explains_something_else_takes_nobodys_place() -> None:
    assert names_of(after_exchange(problem_of((60.0, 700.0), 25.0), "vibration")) == ["vibration"]


def test_a_curve_that_a_name_explains_gets_the_name() -> None:
    problem = problem_of((60.0, 700.0), 25.0)
    base = first_state(problem)
    line = SelectedTerm(make_curve_term("bias", ("range_rate_cm_s",), ((-150.0, 150.0),), [1.0, -1.0]), None)
    state = base.having(problem.refit([line.active], base.fit.base), [line])
    selection = settled(problem, Selection(base, state, screened(problem, base), {}, 6.0))
    assert names_of(selection) == ["latency"]


@pytest.mark.slow
def test_the_right_name_is_proposed_where_few_runs_differ_by_it() -> None:
    """Air temperature of eight days: over so few runs its score says little, and readings are what proposes it."""
    rng = np.random.default_rng(0)
    day = np.arange(N) * 8 // N
    air_c = (15.0 + 12.0 * np.linspace(-1.0, 1.0, 8)[rng.permutation(8)])[day]
    true_cm = rng.uniform(60.0, 400.0, N)
    too_long = np.sqrt((273.15 + 22.5) / (273.15 + air_c)) - 1.0
    off_cm = 1.6 * rng.standard_normal(N) + 0.3 * rng.standard_normal(8)[day]
    contexts = {"true_range_cm": true_cm, "air_temperature_c": air_c, "run": np.array([f"day{k}" for k in day])}
    reading_cm = np.rint(true_cm * (1.0 + 0.2 * too_long) + off_cm)
    problem = Problem.of(MODEL, contexts, reading_cm, day, rng)
    assert names_of(after_exchange(problem, "range_scale")) == ["air_temperature"]


@pytest.mark.slow
def test_exchange_goes_on_until_no_name_is_better() -> None:
    """Three wrong names over the columns of the right ones, whose alternatives are known only once all are there."""
    rng = np.random.default_rng(4)
    true_cm, rate_cm_s = rng.uniform(60.0, 500.0, N), 80.0 * rng.standard_normal(N)
    tilt_deg, throttle = rng.uniform(0.0, 25.0, N), rng.uniform(0.2, 1.0, N)
    contexts = {
        "true_range_cm": true_cm,
        "range_rate_cm_s": rate_cm_s,
        "incidence_deg": tilt_deg,
        "throttle": throttle,
        "vibration_hz": np.where(throttle > 0.6, 60.0, 0.0),
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
    }
    heard_cm = true_cm / np.cos(np.radians(tilt_deg)) - 0.004 * rate_cm_s
    reading_cm = np.rint(heard_cm + (1.5 + 3.0 * throttle**2) * rng.standard_normal(N))
    problem = Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng)
    selection = after_exchange(problem, "motion_during_ping", "nearest_point", "vibration")
    assert sorted(names_of(selection)) == ["latency", "rotor_noise", "slant_range"]
    assert [each.active.effect.name for each in selection.alternatives["latency", None]] == ["motion_during_ping"]


@pytest.mark.parametrize("order", [("vibration", "latency"), *slow(("latency", "vibration", "range_scale"))])
def test_a_needless_name_goes(order: tuple[str, ...]) -> None:
    selection = after_exchange(problem_of((60.0, 700.0), 25.0), *order)
    assert names_of(selection) == ["latency"]


def test_a_name_that_does_as_well_is_an_alternative() -> None:
    """At one height the way back is always as long: what is late and what moves meanwhile are the same."""
    selection = after_exchange(problem_of((299.0, 301.0), 15.0), "latency")
    (near,) = selection.alternatives.values()
    (motion,) = [each for each in near if each.active.effect.name == "motion_during_ping"]
    assert abs(motion.correlation) > 0.99
    assert abs(motion.loss_nats) < 0.5


def test_a_bend_that_begins_before_the_nearest_reading_is_no_alternative_to_a_scale() -> None:
    rng = np.random.default_rng(7)
    true_cm = rng.uniform(150.0, 500.0, N)
    reading_cm = np.array(sensor().readings((1.02 * true_cm).tolist(), 7))
    problem = Problem.of(MODEL, {"true_range_cm": true_cm}, reading_cm, np.arange(N) * RUNS // N, rng)
    selection = after_exchange(problem, "range_scale")
    assert names_of(selection) == ["range_scale"]
    assert "bend" not in [each.active.effect.name for each in selection.alternatives["range_scale", None]]


def test_what_another_column_explains_as_well_is_an_alternative_whatever_its_numbers() -> None:
    """Rotors that are on or off: vibration and throttle are the same column, and rotor noise has an exponent more."""
    rng = np.random.default_rng(4)
    run = np.arange(N) * RUNS // N
    on = (rng.random(RUNS) < 0.5)[run]
    true_cm = rng.uniform(60.0, 350.0, N)
    contexts = {
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": true_cm,
        "throttle": np.where(on, 0.55, 0.0),
        "vibration_hz": np.where(on, 68.0, 0.0),
    }
    sigma_cm = MODEL.sensor.reading_model.sigma_cm * np.where(on, 1.5, 1.0)
    reading_cm = np.rint(true_cm + sigma_cm * rng.standard_normal(N))
    problem = Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng)
    selection = after_exchange(problem, "vibration")
    (term,) = selection.state.terms
    others = [each.active.effect.name for each in selection.alternatives[term.key]]
    assert {"vibration", "rotor_noise"} <= {term.key[0], *others}


@pytest.mark.slow
def test_a_search_that_had_no_room_goes_on_without_what_did_not_hold() -> None:
    problem = problem_of((200.0, 240.0), 25.0)
    full = select(problem, 1)
    assert (full.is_full, names_of(full)) == (True, ["latency"])
    (note,) = naming._messages(problem, full, full.base, len(problem.readings), 1)
    assert "as may be added, 1, of which 0 held; more may be missing (--max-effects 2)" in note
    more = select_more(problem, replace(full, state=full.base), {("latency", None)}, 2)
    (name,) = names_of(more)
    assert name != "latency"
    assert "range_rate_cm_s" in name


@pytest.mark.slow
def test_without_the_offset_of_one_sensor_that_of_another_is_still_sought() -> None:
    rng = np.random.default_rng(6)
    sensor_of = rng.choice(["a", "b", "c"], N)
    contexts = {
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
        "sensor": sensor_of,
        "true_range_cm": rng.uniform(60.0, 350.0, N),
    }
    off_cm = np.where(sensor_of == "a", 2.0, np.where(sensor_of == "b", -1.5, 0.0))
    reading_cm = np.array(sensor().readings((contexts["true_range_cm"] + off_cm).tolist(), 3))
    problem = Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng)
    full = select(problem, 2)
    assert {each.label for each in full.state.terms} == {"mounting_offset of a", "mounting_offset of b"}
    (kept,) = [k for k, each in enumerate(full.state.terms) if each.key[1] == "b"]
    left = without(problem, full.state, 1 - kept)
    more = select_more(problem, replace(full, state=left), {("mounting_offset", "a")}, 2)
    assert ("mounting_offset", "b") in more.state.keys
    assert ("mounting_offset", "a") not in more.state.keys


@pytest.mark.slow
def test_where_the_only_name_does_not_hold_another_one_is_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of((200.0, 240.0), 25.0)

    def without_latency(problem: Problem, state: State, splits: object) -> Validated:
        if "latency" not in [term.key[0] for term in state.terms]:
            return Validated(state, {})
        return Validated(first_state(problem), {}, (Dropped(state.terms[0], "for this test"),))

    monkeypatch.setattr(naming, "validated", without_latency)
    selection, kept = naming._validated(problem, select(problem, 1), cast(Any, None), 1)
    (name,) = names_of(selection)
    assert "range_rate_cm_s" in name
    assert [each.term.label for each in kept.dropped] == ["latency"]


def test_without_a_strong_effect_the_fit_is_that_of_the_base() -> None:
    """Next to the effect the spread is small; from there nearly every hit would end as a random reading."""
    rng = np.random.default_rng(3)
    contexts = {
        "time_s": 0.1 * np.arange(N),
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
        "true_range_cm": rng.uniform(60.0, 600.0, N),
    }
    reading_cm = np.array(sensor().readings((1.1 * contexts["true_range_cm"]).tolist(), 3))
    problem = Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), rng)
    base = first_state(problem)
    (scale,) = [each for each in problem.candidates if each.key == ("range_scale", None)]
    term = SelectedTerm(scale.at(10.0), scale)
    state = base.having(problem.refit([term.active], Base()), [term])
    assert state.fit.log_likelihood - base.fit.log_likelihood > 3000.0
    assert without(problem, state, 0).fit.log_likelihood == pytest.approx(base.fit.log_likelihood, abs=0.5)
