"""What is called a finding: nothing that may be nothing, no impossible sign, no cancelling pair, no sound of light."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.candidates import candidates_of
from msp_lab.gap.curve_test import scan
from msp_lab.gap.naming import AllReadings, NamedModel, name_effects
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem, first_state, screened
from msp_lab.gap.refit import refit
from msp_lab.gap.runs import draw_splits
from msp_range.arrays import numbered
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.effects.plain import plain_finding
from msp_sim.model.model import Model
from tests.support.known import contains
from tests.support.measured import MODEL as FILE
from tests.support.measured import ROOT, sensor
from tests.support.slow import slow

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N, RUNS = 2000, 20


def flown(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "time_s": 0.1 * np.arange(N),
        "sensor": np.full(N, "front"),
        "run": np.array([f"run{k:02d}" for k in np.arange(N) * RUNS // N]),
        "true_range_cm": rng.uniform(60.0, 350.0, N),
        "range_rate_cm_s": 60.0 * rng.standard_normal(N),
        "neighbour_lag_ms": rng.uniform(0.0, 50.0, N),
        "throttle": rng.uniform(0.2, 0.9, N),
    }


def read(contexts: dict[str, Any], seed: int, bias_cm: Array | float = 0.0, **changes: float) -> Array:
    return np.array(sensor(**changes).readings((contexts["true_range_cm"] + bias_cm).tolist(), seed))


def named(contexts: dict[str, Any], reading_cm: Array, model: Model = MODEL) -> NamedModel:
    rng = np.random.default_rng(1)
    return name_effects(model, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)


@pytest.mark.slow
def test_readings_from_the_future_are_ahead_of_the_reference() -> None:
    """Of two clocks only the difference is known, and either may be the one that is late."""
    contexts = flown(1)
    found = named(contexts, read(contexts, 1, 0.02 * contexts["range_rate_cm_s"]))
    (effect,) = [each for each in found.effects if each.name == "latency"]
    assert effect.verdict == "named"
    assert contains(effect.parameters["delay_ms"], -20.0)
    assert plain_finding(CATALOGUE["latency"], {"delay_ms": -20.0}) == "readings are 20 ms ahead of the reference"


@pytest.mark.slow
@pytest.mark.parametrize("bench_pct", [None, 0.03, 0.15])
def test_a_scale_that_the_bench_leaves_open_is_calibration(bench_pct: float | None) -> None:
    """2,000 readings in flight know the scale to 0.03 %: what they find may be the bench's own error."""
    contexts = flown(5)
    stated = MODEL.sensor.model_copy(update={"calibration_scale_std_pct": bench_pct})
    found = named(contexts, read(contexts, 5, 0.003 * contexts["true_range_cm"]), Model(stated, ()))
    changed = [each.after for each in found.calibration if each.name == "calibration.scale"]
    if bench_pct == 0.15:
        assert (found.effects, found.unknown) == ((), ())
        assert changed == [pytest.approx(0.3, abs=0.1)]
    else:
        (effect,) = found.effects
        assert "range_scale" in (effect.name, *(each.name for each in effect.alternatives))
        assert not changed


@pytest.mark.slow
def test_what_the_runs_leave_open_is_suggested() -> None:
    contexts = flown(4)
    for size in (0.0012, 0.004, 0.006):
        found = named(contexts, read(contexts, 4, -size * contexts["range_rate_cm_s"]))
        for each in found.effects:
            value = each.parameters["delay_ms"]
            assert (each.verdict == "suggested") == contains(value, 0.0)


@pytest.mark.slow
def test_echoes_that_are_never_there_are_a_finding() -> None:
    """Beyond the breakaway angle every echo is missed: likely, and not certain for the next one."""
    contexts = flown(7)
    contexts["incidence_deg"] = np.abs(np.random.default_rng(7).normal(0.0, 7.0, N))
    half_angle_deg = np.degrees(MODEL.sensor.beam.half_angle_rad(contexts["true_range_cm"] / 100.0))
    beyond = contexts["incidence_deg"] > 1.02 * half_angle_deg
    assert 20 < beyond.sum() < 300
    found = named(contexts, np.where(beyond, 765.0, read(contexts, 7)))
    (effect,) = [each for each in found.effects if each.name == "beyond_field_of_view"]
    log_odds = effect.parameters["log_odds"]
    assert effect.verdict == "named"
    assert log_odds.low is not None
    assert 4.0 < log_odds.low < log_odds.value < 15.0


@pytest.mark.slow
def test_an_edge_at_one_angle_is_no_curve() -> None:
    """A step of misses beyond 6.5 deg at all ranges, a third of the angle that the sensor model has at 1 m."""
    contexts = flown(8)
    rng = np.random.default_rng(8)
    contexts["incidence_deg"] = np.abs(rng.normal(0.0, 5.0, N))
    missed = (contexts["incidence_deg"] > 6.5) & (rng.random(N) < 0.3)
    found = named(contexts, np.where(missed, 765.0, read(contexts, 8)))
    assert [(each.name, each.verdict) for each in found.effects] == [("beyond_field_of_view", "named")]
    assert found.unknown == ()
    numbers = found.effects[0].parameters
    at_one_metre_deg = np.degrees(MODEL.sensor.beam.half_angle_rad(1.0))
    assert numbers["breakaway"].value * at_one_metre_deg == pytest.approx(6.5, abs=0.6)
    assert numbers["narrowing"].value < 0.3


@pytest.mark.slow
def test_an_echo_that_rises_linearly_is_a_late_threshold_and_no_bend() -> None:
    """The time to a fixed level goes as one over the amplitude: range, and 1.4 dB more a metre there and back."""
    contexts = flown(9)
    range_m = contexts["true_range_cm"] / 100.0
    weaker = range_m * 10.0 ** (2.0 * 1.4 / 20.0 * (range_m - 1.0))
    found = named(contexts, read(contexts, 9, 0.5 * (weaker - 1.0)))
    names = [{each.name, *(other.name for other in each.alternatives)} for each in found.effects]
    assert any("threshold_walk" in each for each in names)
    assert found.effects[0].name == "threshold_walk"


@pytest.mark.slow
def test_growth_with_range_is_named_where_it_is_more_than_a_bench_leaves_open() -> None:
    """A fifth more scatter a metre is an effect; a twentieth, however sure, is what another bench might have said."""
    rng = np.random.default_rng(12)
    n = 6_000
    true_cm = rng.uniform(30.0, 400.0, n)
    contexts = {"true_range_cm": true_cm, "run": np.array([f"run{k:02d}" for k in np.arange(n) * RUNS // n])}
    sigma_cm = MODEL.sensor.reading_model.sigma_cm
    given = MODEL.sensor.reading_model.sigma_growth_cm_per_m / sigma_cm
    for growth, verdicts in ((0.2, ["named"]), (0.06, [])):
        spread_cm = sigma_cm * (1.0 + given * true_cm / 100.0) * (1.0 + growth * true_cm / 100.0)
        found = named(contexts, np.rint(true_cm + spread_cm * rng.standard_normal(n)))
        assert [each.verdict for each in found.effects if each.name == "spread_with_range"] == verdicts
        calibrated = "sigma_growth_cm_per_m" in " ".join(each.name for each in found.calibration)
        assert calibrated == (not verdicts)


def test_readings_in_half_centimetres_are_on_no_coarse_grid() -> None:
    contexts = flown(6)
    heard_cm = contexts["true_range_cm"] + np.random.default_rng(6).normal(0.0, 1.9, N)
    found = named(contexts, np.rint(2.0 * heard_cm) / 2.0)
    assert "coarse_rounding" not in [each.name for each in found.effects]


@pytest.mark.slow
def test_what_all_readings_have_is_a_finding() -> None:
    contexts = flown(5)
    found = named(contexts, 5.0 * np.rint(read(contexts, 5, sigma_cm=6.0) / 5.0))
    (effect,) = found.effects
    share = effect.parameters["share"]
    assert (effect.name, effect.verdict, effect.parameters["step_cm"].value) == ("coarse_rounding", "named", 5.0)
    assert share.value == share.high == 1.0
    assert share.low is not None
    assert 0.99 < share.low < 1.0


def test_light_is_not_asked_for_sound() -> None:
    contexts = flown(1) | {"air_temperature_c": np.random.default_rng(1).uniform(0.0, 30.0, N)}
    ranger = Model.of(load_sensor_model(ROOT / "configs" / "sensors" / "tof_ranger.yaml"))
    asked = {each.effect.name for each in candidates_of(ranger, contexts)[0]}
    heard = {each.effect.name for each in candidates_of(MODEL, contexts)[0]}
    assert {"air_temperature", "threshold_walk", "cycle_slip", "motion_during_ping"} <= heard
    assert not {"air_temperature", "threshold_walk", "cycle_slip", "motion_during_ping", "thermometer_offset"} & asked
    assert {"latency", "range_scale", "bend"} <= asked


def test_radio_is_asked_neither_for_sound_nor_for_a_beam() -> None:
    contexts = flown(1) | {"air_temperature_c": np.random.default_rng(1).uniform(0.0, 30.0, N)}
    contexts["incidence_deg"] = np.random.default_rng(2).uniform(-20.0, 20.0, N)
    ranger = load_sensor_model(ROOT / "configs" / "sensors" / "tof_ranger.yaml")
    light, radio = (
        {each.effect.name for each in candidates_of(Model.of(ranger.model_copy(update={"medium": each})), contexts)[0]}
        for each in ("light", "radio")
    )
    assert light - radio == {"slant_range", "beyond_field_of_view"}
    assert {"latency", "range_scale", "multipath"} <= radio


@pytest.mark.slow
def test_what_lacks_one_column_is_a_likely_cause_of_the_curve() -> None:
    contexts = flown(6)
    lag_ms = contexts["neighbour_lag_ms"]
    reading_cm = read(contexts, 6)
    heard = (np.random.default_rng([6, 1]).random(N) < 0.4) & (lag_ms > 10.0) & (lag_ms < 18.0)
    reading_cm = np.where(heard, np.rint(0.5 * contexts["true_range_cm"]), reading_cm)
    found = named(contexts, reading_cm)
    curves = [each for each in found.unknown if each.variables == ("neighbour_lag_ms",)]
    assert curves
    assert ("crosstalk", "neighbour_range_cm") in curves[0].likely_causes


@pytest.mark.parametrize("cut_cm", [150.0])
def test_two_effects_that_cancel_are_one_curve(cut_cm: float) -> None:
    contexts = flown(7)
    range_cm = contexts["true_range_cm"]
    bias_cm = np.where(range_cm < cut_cm, 0.0, 3.0 * np.sin((range_cm - cut_cm) / 40.0))
    found = named(contexts, read(contexts, 7, bias_cm))
    names = {each.name for each in found.effects}
    assert not {"bend", "range_scale"} <= names
    assert [each.variables for each in found.unknown] == [("true_range_cm",)]


def test_a_number_that_is_held_at_its_bound_removes_no_evidence() -> None:
    """No reading is 255, so the saturated share ends at its bound; missed readings stand out all the same."""
    contexts = flown(8)
    reading_cm = read(contexts, 8, second_share=0.0)
    reading_cm[reading_cm == 255.0] = 256.0
    lost = (contexts["throttle"] > 0.6) & (np.random.default_rng([8, 1]).random(N) < 0.08)
    reading_cm[lost] = 765.0
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    assert refit(prepared, []).at.held[BASE.index("saturated")]
    problem = Problem.of(MODEL, contexts, reading_cm, numbered(contexts["run"]), np.random.default_rng(1))
    state = first_state(problem)
    (best, *_) = scan(contexts, problem.curves_asked[0], state.fit, ("missed",))
    assert best.variables == ("throttle",)
    assert best.log_p < -30.0
    assert screened(problem, state).largest >= 0.0


@pytest.mark.parametrize("location_cm", [68.0, *slow(43.0, 118.0, 190.0)])
def test_clutter_is_found_wherever_it_is(location_cm: float) -> None:
    contexts, rng = flown(11), np.random.default_rng(11)
    contexts["true_range_cm"] = rng.uniform(220.0, 500.0, N)
    of_leg = rng.random(N) < 0.02
    reading_cm = np.where(of_leg, np.rint(rng.normal(location_cm, 2.0, N)), read(contexts, 11))
    (effect,) = named(contexts, reading_cm).effects
    assert effect.name == "clutter"
    assert contains(effect.parameters["location_cm"], location_cm)


def test_a_hump_of_short_readings_is_no_clutter() -> None:
    """Short readings over a metre, more of them in its middle, as a robot between furniture has them."""
    contexts, rng = flown(13), np.random.default_rng(13)
    contexts["true_range_cm"] = rng.uniform(220.0, 500.0, N)
    in_between = rng.random(N) < 0.1
    reading_cm = np.where(in_between, np.rint(rng.normal(110.0, 30.0, N)), read(contexts, 13))
    assert "clutter" not in [each.name for each in named(contexts, np.maximum(reading_cm, 20.0)).effects]


@pytest.mark.slow
def test_a_scale_is_a_scale_where_the_reference_knows_no_offset_of_a_run() -> None:
    """The other sensors as reference, each run's mean difference taken off; the runs are at different heights."""
    contexts, rng = flown(12), np.random.default_rng(12)
    number = np.arange(N) * RUNS // N
    true_cm = rng.uniform(80.0, 300.0, RUNS)[number] + rng.uniform(-40.0, 40.0, N)
    contexts |= {"true_range_cm": true_cm, "reference": np.full(N, "others")}
    reading_cm = read(contexts, 12, 0.02 * true_cm)
    off_cm = np.where(np.abs(reading_cm - true_cm) < 20.0, reading_cm - true_cm, np.nan)
    contexts["true_range_cm"] = true_cm + np.array([np.nanmean(off_cm[number == k]) for k in range(RUNS)])[number]
    contexts["true_range_std_cm"] = np.full(N, 0.5)
    (effect,) = named(contexts, reading_cm).effects
    assert effect.name == "range_scale"
    assert contains(effect.parameters["scale_pct"], 2.0)
