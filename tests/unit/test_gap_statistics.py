"""The gap workflow's statistics on readings from a plain sampler that shares no code with the model."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap import runs
from msp_lab.gap.candidates import candidates_of
from msp_lab.gap.estimates import formula
from msp_lab.gap.extended_model import to_sensor
from msp_lab.gap.naming import AllReadings, NamedModel, name_effects
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem
from msp_lab.gap.refit import refit
from msp_lab.gap.run_offsets import run_scatter
from msp_lab.gap.runs import draw_splits
from msp_lab.gap.screen import score_matrix
from msp_lab.gap.validation import gain_of_runs
from msp_range.arrays import numbered
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import Model, make_curve_term
from tests.support.curves import with_curve
from tests.support.known import contains, known, width

Array = NDArray[np.float64]
SENSOR = load_sensor_model("configs/sensors/mb1242.yaml").model_copy(update={"effects": ()})
MODEL = Model.of(SENSOR)
RUNS, ROWS = 20, 100


def flown(seed: int) -> dict[str, NDArray[np.generic]]:
    """Contexts of flights."""
    rng = np.random.default_rng(seed)
    n = RUNS * ROWS
    run = np.repeat(np.arange(RUNS), ROWS)
    return {
        "time_s": 0.1 * np.arange(n),
        "sensor": np.full(n, "front"),
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": rng.uniform(60.0, 350.0, n),
        "air_temperature_c": rng.uniform(0.0, 35.0, RUNS)[run],
        "range_rate_cm_s": 60.0 * rng.standard_normal(n),
        "throttle": rng.uniform(0.2, 0.9, n),
    }


def read(
    contexts: dict[str, NDArray[np.generic]], seed: int, bias_cm: Array | float = 0.0, wider: Array | float = 1.0
) -> Array:
    """Plain draws of the base: hits, misses, short and random readings, in whole centimetres."""
    rng = np.random.default_rng([seed, 7])
    true_cm = np.asarray(contexts["true_range_cm"], dtype=float)
    n, mixture = true_cm.size, SENSOR.reading_model
    shares = np.array([mixture.weights.hit, mixture.weights.short, mixture.weights.missed, mixture.weights.random])
    kind = rng.choice(4, n, p=shares / shares.sum())
    reading_cm = np.round(true_cm + bias_cm + mixture.sigma_cm * wider * rng.standard_normal(n))
    rate, length = mixture.short_rate_per_m / 100.0, true_cm - SENSOR.minimum_cm
    short = SENSOR.minimum_cm - np.log(1.0 - rng.random(n) * (1.0 - np.exp(-rate * length))) / rate
    reading_cm = np.where(kind == 1, np.round(short), reading_cm)
    reading_cm = np.where(kind == 2, SENSOR.maximum_cm, reading_cm)
    reading_cm = np.where(
        kind == 3, rng.integers(round(SENSOR.minimum_cm), round(SENSOR.maximum_cm) + 1, n), reading_cm
    )
    saturated = (reading_cm == SENSOR.maximum_cm) & (rng.random(n) < mixture.saturated_fraction)
    return np.clip(np.where(saturated, 255.0, reading_cm), SENSOR.minimum_cm, SENSOR.maximum_cm)


def explained(contexts: dict[str, NDArray[np.generic]], reading_cm: Array, seed: int = 1) -> NamedModel:
    rng = np.random.default_rng(seed)
    return name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)


def test_runs_are_parted_whole_and_evenly() -> None:
    contexts = flown(1)
    parts = draw_splits(contexts, np.random.default_rng(1))
    assert len(parts.training_runs) == len(parts.held_out_runs) == RUNS // 2
    assert not set(parts.runs[parts.training]) & set(parts.runs[parts.held_out])


def test_few_runs_are_split_by_blocks_and_that_is_reported() -> None:
    contexts = flown(1)
    contexts["run"] = np.full(RUNS * ROWS, "one")
    parts = draw_splits(contexts, np.random.default_rng(1))
    assert "blocks of consecutive readings" in parts.messages[0]
    assert 0.4 < parts.training.mean() < 0.6


def test_dependence_is_seen_and_is_not_seen_where_there_is_none() -> None:
    rng = np.random.default_rng(2)
    unit = np.repeat(np.arange(20), 100)
    plain = rng.standard_normal(2000)
    slow = np.zeros(2000)
    for i in range(1, 2000):
        slow[i] = 0.9 * slow[i - 1] + plain[i]
    assert not runs.dependence(plain, unit).dependent
    assert runs.dependence(slow, unit).dependent
    between = runs.dependence(plain + 0.5 * rng.standard_normal(20)[unit], unit)
    assert between.dependent
    assert between.between_run_share > 0.1
    # Runs that have the same mean, and readings in them that follow one another.
    within = runs.dependence(slow - (np.bincount(unit, slow) / 100.0)[unit], unit)
    assert within.p_between > 0.5
    assert within.dependent


def test_previous_reading_is_of_the_same_run() -> None:
    contexts = {"run": np.array(["a", "a", "b", "b"]), "time_s": np.array([1.0, 0.0, 0.0, 1.0])}
    before = runs.previous(contexts, np.array([10.0, 11.0, 12.0, 13.0]))
    np.testing.assert_array_equal(before, [11.0, np.nan, np.nan, 12.0])


def test_scores_are_derivatives_of_the_log_probability() -> None:
    contexts = flown(3)
    reading_cm = read(contexts, 3)
    tested, missing = candidates_of(MODEL, contexts)
    assert ("humidity", ("humidity_pct",)) in missing
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    scores = score_matrix(prepared, prepared.slopes(Base(), []), tested)
    here = prepared.log_prob(Base(), [])
    for j, candidate in enumerate(tested):
        if candidate.parameter.power != 1 or "code" in candidate.effect.channels:
            continue
        step = 1e-5 * max(min(candidate.parameter.high, 1.0), 1e-3)
        there = prepared.log_prob(Base(), [candidate.at(candidate.neutral + step)])
        slope = (there - here) / step
        usual = np.abs(slope) < 50.0
        np.testing.assert_allclose(
            scores[usual, len(BASE) + j],
            slope[usual],
            atol=0.02 + 0.02 * np.abs(slope[usual]).max(),
            err_msg=str(candidate.key),
        )


def test_nothing_is_named_where_nothing_is_missing() -> None:
    named = 0
    for seed in range(3):
        contexts = flown(seed)
        found = explained(contexts, read(contexts, seed))
        named += bool(found.effects or found.unknown)
    assert named == 0


def test_latency_is_named_with_its_size() -> None:
    contexts = flown(4)
    rate = np.asarray(contexts["range_rate_cm_s"], dtype=float)
    found = explained(contexts, read(contexts, 4, bias_cm=-0.012 * rate))
    names = {each.name for each in found.effects} | {
        other.name for each in found.effects for other in each.alternatives
    }
    assert "latency" in names
    assert len(found.effects) == 1
    assert not found.unknown
    assert known(found.effects[0].z) > 2.0
    if found.effects[0].name == "latency":
        value = found.effects[0].parameters["delay_ms"]
        assert contains(value, 12.0)


def test_spread_with_throttle_is_named() -> None:
    contexts = flown(5)
    throttle = np.asarray(contexts["throttle"], dtype=float)
    found = explained(contexts, read(contexts, 5, wider=1.0 + 1.5 * throttle))
    assert [each.name for each in found.effects] == ["rotor_noise"]
    assert "sigma_cm" not in [each.name for each in found.calibration] or known(found.effects[0].z) > 4.0


@pytest.mark.slow
def test_what_is_in_no_catalogue_is_a_curve_and_flies() -> None:
    contexts = flown(6)
    throttle = np.asarray(contexts["throttle"], dtype=float)
    found = explained(contexts, read(contexts, 6, bias_cm=1.5 * np.sin(7.0 * throttle)))
    assert not found.effects
    assert [(each.channel, each.variables) for each in found.unknown] == [("bias", ("throttle",))]
    again = Model.of(to_sensor(found.models.final_fit))
    reading_cm = read(contexts, 6)
    np.testing.assert_allclose(
        again.log_prob(reading_cm, contexts), found.models.final_fit.log_prob(reading_cm, contexts)
    )


@pytest.mark.slow
def test_scale_and_thermometer_are_indistinguishable_in_air_of_one_temperature() -> None:
    contexts = flown(7)
    contexts["air_temperature_c"] = np.full(RUNS * ROWS, 15.0)
    range_cm = np.asarray(contexts["true_range_cm"], dtype=float)
    found = explained(contexts, read(contexts, 7, bias_cm=0.008 * range_cm))
    assert len(found.effects) == 1
    effect = found.effects[0]
    assert effect.verdict == "indistinguishable"
    assert "to tell" in effect.experiment
    assert {"range_scale", "air_temperature"} <= {effect.name, *(other.name for other in effect.alternatives)}


def test_a_shuffled_cause_has_no_name() -> None:
    contexts = flown(4)
    rate = np.asarray(contexts["range_rate_cm_s"], dtype=float)
    reading_cm = read(contexts, 4, bias_cm=-0.012 * rate)
    contexts["range_rate_cm_s"] = np.random.default_rng(1).permutation(rate)
    assert "latency" not in [each.name for each in explained(contexts, reading_cm).effects]


def test_correlated_noise_is_a_number_of_the_base_and_no_effect() -> None:
    contexts = flown(8)
    rng = np.random.default_rng(8)
    drift = np.zeros(RUNS * ROWS)
    for i in range(1, drift.size):
        drift[i] = (0.9 * drift[i - 1] if i % ROWS else 0.0) + 0.6 * rng.standard_normal()
    found = explained(contexts, read(contexts, 8, bias_cm=drift))
    assert not found.effects
    (correlation,) = [each for each in found.calibration if each.name == "correlation"]
    assert known(correlation.low) > 0.2
    assert found.models.final_fit.sensor.reading_model.correlation == pytest.approx(correlation.after)


def test_a_note_on_dependence_has_the_correlation_that_counts() -> None:
    """Noise that lasts for some readings is refitted; next to offsets of runs it has taken more than its share."""
    contexts, rng = flown(8), np.random.default_rng(8)
    off_cm = np.zeros(RUNS * ROWS)
    for i in range(1, off_cm.size):
        off_cm[i] = (0.7 * off_cm[i - 1] if i % ROWS else 0.0) + 1.5 * rng.standard_normal()
    off_cm += np.repeat(2.0 * rng.standard_normal(RUNS), ROWS)
    (note,) = [each for each in explained(contexts, read(contexts, 8, bias_cm=off_cm)).messages if "unit of" in each]
    found = re.search(r"of neighbours (0\.\d\d) in the refitted noise and (-?0\.\d\d) beyond it", note)
    assert found is not None, note
    assert float(found[1]) > 0.4
    assert float(found[2]) < 0.1


def test_a_spread_far_from_the_models_is_reported_as_it_is() -> None:
    """Of 200 readings the search's prior, of 0.15, would hold it by a tenth."""
    contexts = {name: column[::10] for name, column in flown(3).items()}
    sigma_cm = 0.25 * MODEL.sensor.reading_model.sigma_cm
    own = np.random.default_rng(5).standard_normal(RUNS * ROWS // 10)
    true_cm = np.rint(contexts["true_range_cm"].astype(float))
    contexts["true_range_cm"] = true_cm
    found = explained(contexts, np.rint(true_cm + sigma_cm * own))
    (spread,) = [number for number in found.calibration if number.name == "sigma_cm"]
    assert spread.low is not None
    assert spread.high is not None
    assert spread.low < float(np.std(sigma_cm * own)) < spread.high


def test_offsets_between_runs_are_named() -> None:
    contexts = flown(9)
    offset_cm = 1.5 * np.random.default_rng(9).standard_normal(RUNS)
    found = explained(contexts, read(contexts, 9, bias_cm=np.repeat(offset_cm, ROWS)))
    assert "run_offsets" in [each.name for each in found.effects]


@pytest.mark.parametrize(("differ", "wanders"), [(False, False), (True, False), (True, True)])
def test_how_far_runs_differ_and_whether_readings_wander_is_known_without_a_name(differ: bool, wanders: bool) -> None:
    contexts, rng = flown(12), np.random.default_rng(12)
    off_cm = np.repeat(rng.permutation(np.linspace(-1.5, 1.5, RUNS)), ROWS) * (differ and not wanders)
    off_cm = (
        off_cm + 1.2 * np.sin(np.arange(RUNS * ROWS) * 2.0 * np.pi / ROWS + np.repeat(np.arange(RUNS), ROWS)) * wanders
    )
    problem = Problem.of(MODEL, contexts, read(contexts, 12, bias_cm=off_cm), np.arange(RUNS * ROWS) // ROWS, rng)
    scatter = run_scatter(problem, problem.base)
    if not differ:
        assert scatter is None
        return
    assert scatter is not None
    assert scatter.inside_runs == wanders
    assert scatter.deviation_cm == pytest.approx(off_cm.std(), rel=0.25)
    # Of blocks of one run it is a wander.
    one_run = replace(problem, contexts={**problem.contexts, "run": np.full(RUNS * ROWS, "flight")})
    assert run_scatter(one_run, problem.base) == replace(scatter, inside_runs=True)


@pytest.mark.parametrize("explains", [True, False])
def test_a_column_that_explains_the_offsets_of_few_runs_is_an_alternative(explains: bool) -> None:
    """Two runs with each of five batteries: too few for a curve, and alike two by two or not."""
    contexts, rng = flown(2), np.random.default_rng(2)
    run = np.arange(RUNS * ROWS) // (2 * ROWS)
    contexts["run"] = np.array([f"run{k}" for k in run])
    battery = rng.permutation(np.repeat(["b1", "b2", "b3", "b4", "b5"], 2))[run]
    contexts["battery"] = battery
    contexts["pilot"] = np.array([f"pilot{k}" for k in run])
    contexts["air_temperature_c"] = rng.uniform(0.0, 35.0, 10)[run]
    off_cm = {
        True: np.linspace(0.0, 3.2, 5)[numbered(battery)],
        False: rng.permutation(np.linspace(-1.5, 1.5, 10))[run],
    }
    (found,) = explained(contexts, read(contexts, 2, bias_cm=off_cm[explains])).effects
    assert found.name == "run_offsets"
    assert [each.name for each in found.alternatives] == ["battery"] * explains
    assert found.verdict == ("indistinguishable" if explains else "named")
    assert ("to tell run_offsets from battery: more runs that differ in it alone" in found.experiment) == explains


@pytest.mark.slow
def test_what_lies_between_runs_is_not_in_the_spread_within_them() -> None:
    contexts = flown(9)
    offset_cm = np.random.default_rng(9).permutation(np.linspace(-3.0, 3.0, RUNS))
    found = explained(contexts, read(contexts, 9, bias_cm=np.repeat(offset_cm, ROWS)))
    assert [each.name for each in found.effects] == ["run_offsets"]
    mixture = found.models.final_fit.sensor.reading_model
    assert mixture.sigma_cm == pytest.approx(SENSOR.reading_model.sigma_cm, rel=0.08)
    deviation = found.effects[0].parameters["deviation_cm"]
    assert contains(deviation, float(offset_cm.std()))


def test_offsets_that_the_spread_of_the_model_holds_already_are_not_named() -> None:
    """A base that was fitted to readings of many runs takes what they differ by for spread."""
    contexts = flown(9)
    offset_cm = np.random.default_rng(9).permutation(np.linspace(-2.0, 2.0, RUNS))
    reading_cm = read(contexts, 9, bias_cm=np.repeat(offset_cm, ROWS))
    mixture = SENSOR.reading_model
    wider = mixture.model_copy(update={"sigma_cm": float(np.hypot(mixture.sigma_cm, offset_cm.std()))})
    rng = np.random.default_rng(1)
    model = Model.of(SENSOR.model_copy(update={"reading_model": wider}))
    found = name_effects(model, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert not found.effects


def test_values_are_those_of_all_runs() -> None:
    """The gap is measured with the values of one half, the model flies with those of all runs."""
    contexts = flown(4)
    rate = np.asarray(contexts["range_rate_cm_s"], dtype=float)
    parts = draw_splits(contexts, np.random.default_rng(1))
    delay_s = np.where(parts.held_out, 0.012, 0.018)
    found = explained(contexts, read(contexts, 4, bias_cm=-delay_s * rate))
    assert [each.name for each in found.effects] == ["latency"]
    value = found.effects[0].parameters["delay_ms"]
    error_ms = 1000.0 * np.hypot(SENSOR.reading_model.sigma_cm, 0.29) / np.sqrt(0.96 * rate.size) / rate.std()
    assert value.value == pytest.approx(1000.0 * delay_s.mean(), abs=3.5 * error_ms)
    assert width(value) == pytest.approx(2.0 * 1.96 * error_ms, rel=0.2)
    final, training = (
        each.effects[0].values["delay_ms"] for each in (found.models.final_fit, found.models.training_fit)
    )
    assert final == pytest.approx(value.value)
    assert training == pytest.approx(18.0, abs=3.5 * np.sqrt(2.0) * error_ms)
    # What could have been seen: 80 % power at the critical value of all entries.
    smallest_ms = float(re.findall(r"latency above ([\d.]+) ms", found.detectable)[0])
    assert 3.4 * error_ms < smallest_ms < 5.5 * error_ms


@pytest.mark.slow
def test_what_one_run_has_is_dropped_and_the_rest_is_kept() -> None:
    """Fitted on the part that has it, the other part scores worse for it; that part does not have it to fit."""
    contexts = flown(5)
    rate, throttle = (np.asarray(contexts[name], dtype=float) for name in ("range_rate_cm_s", "throttle"))
    wider = np.where(contexts["run"] == "run07", 1.0 + 6.0 * throttle, 1.0)
    found = explained(contexts, read(contexts, 5, bias_cm=-0.03 * rate, wider=wider))
    assert [each.name for each in found.effects] == ["latency"]
    assert found.effects[0].splits_agree == 1.0
    assert any("it holds in 0 of" in why for _, why in found.dropped)


def test_an_offset_of_one_run_is_named_next_to_what_all_have() -> None:
    """The other runs say nothing of it: stretches of this run do, and what all runs have is validated as without it."""
    contexts = flown(5)
    rate = np.asarray(contexts["range_rate_cm_s"], dtype=float)
    bias_cm = -0.03 * rate + np.where(contexts["run"] == "run07", 1.5, 0.0)
    found = explained(contexts, read(contexts, 5, bias_cm=bias_cm))
    assert {(each.name, each.of) for each in found.effects} == {("latency", None), ("session_offset", "run07")}
    of_run = next(each for each in found.effects if each.of)
    assert contains(of_run.parameters["offset_cm"], 1.5)
    assert all(each.splits_agree == 1.0 for each in found.effects)
    assert not found.dropped


def test_errors_of_correlated_readings_are_wider() -> None:
    contexts = flown(8)
    rng = np.random.default_rng(8)
    drift, rate = np.zeros(RUNS * ROWS), np.zeros(RUNS * ROWS)
    for i in range(1, drift.size):
        drift[i] = (0.9 * drift[i - 1] if i % ROWS else 0.0) + 0.9 * rng.standard_normal()
        rate[i] = (0.9 * rate[i - 1] if i % ROWS else 0.0) + 25.0 * rng.standard_normal()
    contexts["range_rate_cm_s"] = rate
    found = explained(contexts, read(contexts, 8, bias_cm=drift - 0.06 * rate))
    latency = next(each for each in found.effects if each.name == "latency")
    value = latency.parameters["delay_ms"]
    assert contains(value, 60.0)
    spread_cm = np.sqrt(SENSOR.reading_model.sigma_cm**2 + drift.var())
    independent_ms = 1000.0 * spread_cm / np.sqrt(0.96 * rate.size) / rate.std()
    assert width(value) > 1.3 * 2.0 * 1.96 * independent_ms


def test_a_refit_finds_the_base_and_stays_within_bounds() -> None:
    contexts = flown(10)
    prepared = Prepared.of(MODEL, contexts, read(contexts, 10, bias_cm=0.7, wider=1.2))
    fitted = refit(prepared, [])
    error = np.sqrt(np.diag(fitted.covariance()))
    assert abs(fitted.base[0] - 0.7) < 4.0 * error[0]
    assert abs(fitted.base[1] - np.log(1.2)) < 4.0 * error[1]


def test_gain_has_the_error_of_whole_runs() -> None:
    rng = np.random.default_rng(1)
    unit = np.repeat(np.arange(50), 40)
    per_run = rng.standard_normal(50)[unit]
    found = gain_of_runs(np.bincount(unit, per_run), np.bincount(unit))
    assert found.se == pytest.approx(1.0 / np.sqrt(50), rel=0.3)


def test_formula_is_the_shortest() -> None:
    at = np.linspace(0.0, 1.0, 6)
    error = np.full(6, 0.01)
    assert formula("throttle", at, 2.0 - 1.5 * at, error) == "2 - 1.5 throttle"
    assert formula("throttle", at, 1.0 + 3.0 * at, error) == "1 + 3 throttle"


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"channel": "colour"}, "channel"),
        ({"variables": []}, "variables"),
        ({"knots": [[1.0, 0.0]]}, "knots"),
        ({"values": [1.0]}, "values"),
    ],
)
def test_a_curve_that_is_none_is_refused(change: dict[str, object], key: str) -> None:
    right: dict[str, object] = {
        "channel": "bias",
        "variables": ["throttle"],
        "knots": [[0.0, 1.0]],
        "values": [0.0, 1.0],
    }
    wrong = right | change
    with pytest.raises(ConfigError, match=key):
        make_curve_term(wrong["channel"], wrong["variables"], wrong["knots"], wrong["values"])


def test_a_curve_draws_what_it_scores() -> None:
    model = with_curve(MODEL, "bias", ["throttle"], [[0.0, 1.0]], [0.0, 40.0])
    contexts = {"true_range_cm": np.full(2000, 200.0), "throttle": np.full(2000, 0.5)}
    drawn = model.sample(contexts, np.random.default_rng(1))
    assert abs(np.median(drawn) - 220.0) <= 1.0
    assert model.log_prob([220.0], {"true_range_cm": [200.0], "throttle": [0.5]})[0] > -3.0
