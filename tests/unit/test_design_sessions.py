"""Sessions, how far they tell answers apart, and the power that follows."""

from dataclasses import replace

import numpy as np
import pytest

from msp_lab.design.answers import FittedAnswer, with_strength
from msp_lab.design.bench import Bench
from msp_lab.design.choose import Same, _classes
from msp_lab.design.flight import Pilot
from msp_lab.design.proof import Proof, merged
from msp_lab.design.questions import Answer
from msp_lab.design.separation import needed_nats, power_of, separation
from msp_lab.gap.prepared import BASE
from msp_range.config import load_airframe
from msp_sim.model.model import Model, load_model, make_term
from tests.support.measured import ROOT

SENSOR = ROOT / "configs/sensors/mb1242.yaml"
GIVEN = Model.of(load_model(SENSOR).sensor.model_copy(update={"effects": ()}))
BENCH = Bench(SENSOR, GIVEN.sensor, ("left",))
RECORD = frozenset({"true_range_cm", "air_temperature_c"})


def answer(name: str, values: dict[str, float]) -> FittedAnswer:
    model = replace(GIVEN, effects=(make_term(name, None, values),))
    return FittedAnswer(Answer(name), model.effects, np.zeros(len(BASE)), 0.0, model)


def nats(first: FittedAnswer, second: FittedAnswer, *varied: str) -> float:
    session = BENCH.session(varied, True, 200, RECORD)
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


def test_placements_limit_what_differs_between_runs() -> None:
    session = BENCH.session(("true_range_cm", "air_temperature_c"), True, 200, RECORD)
    of = [
        separation(GIVEN, (SCALE, AIR), (0, 1), session.sampled(400), offset_cm, np.random.default_rng(1))
        for offset_cm in (0.0, 1.0)
    ]
    assert of[0].nats(100_000, 4) / of[0].nats(100, 4) == pytest.approx(1000.0)
    assert of[1].nats(100_000, 4) < 20.0 * of[1].nats(100, 4)


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


def test_what_is_like_the_same_third_answer_is_alike() -> None:
    assert _classes(4, [Same(0, 1, 1.0), Same(1, 3, 1.0)]) == (frozenset({0, 1, 3}), frozenset({2}))


def test_a_bench_session_is_the_plan_of_a_campaign() -> None:
    session = BENCH.session(("true_range_cm", "vibration_hz"), False, 30, RECORD)
    assert (session.runs, session.readings) == (15, 450)
    assert set(session.contexts["vibration_hz"]) == {0.0, 50.0, 100.0}
    longer = BENCH.session(("true_range_cm", "vibration_hz"), False, 60, RECORD)
    assert longer.minutes - session.minutes == pytest.approx(450 * 0.1 / 60.0)


def test_a_flight_session_varies_throttle_and_climb_independently() -> None:
    file = ROOT / "configs/quad_pallet.yaml"
    pilot = Pilot(file, load_airframe(file))
    session = pilot.session(("throttle", "range_rate_cm_s"), False, 40, RECORD)
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


def test_tables_are_put_together_with_blanks() -> None:
    old = {"true_range_cm": np.array([1.0]), "run": np.array(["a"]), "throttle": np.array([0.5])}
    new = {"true_range_cm": np.array([2.0]), "run": np.array(["b"]), "target": np.array(["wall"])}
    data = merged(old, new)
    assert data["target"].tolist() == ["", "wall"]
    assert np.isnan(data["throttle"][1])


def test_the_interval_of_a_power_that_never_failed() -> None:
    low, high = Proof(60, 60).interval
    assert low == pytest.approx(0.025 ** (1 / 60))
    assert high == 1.0
