"""Free forms find what no name explains by channel and variable, and an experiment that is named does what it says."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.curve_scan import CandidateCurve, curves_of, scan
from msp_lab.gap.curves import add_curves
from msp_lab.gap.far_curves import far_curves
from msp_lab.gap.findings import FoundEffect
from msp_lab.gap.formula import formula
from msp_lab.gap.naming import AllReadings, name_effects
from msp_lab.gap.prepared import CHANNELS, Prepared
from msp_lab.gap.problem import Problem, first_state
from msp_lab.gap.refit import refit
from msp_lab.gap.splits import draw_splits
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects.curve import hats
from msp_sim.model.model import Model, make_curve_term
from msp_sim.model.sampler import Sampler
from tests.support.curves import with_curve
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor

Array = NDArray[np.float64]
Columns = dict[str, NDArray[np.generic]]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
SIGMA_CM = MODEL.sensor.reading_model.sigma_cm
N = 2000


def flown(seed: int, n: int = N, runs: int = 20) -> Columns:
    rng = np.random.default_rng(seed)
    return {
        "time_s": 0.1 * np.arange(n),
        "run": np.array([f"run{k:02d}" for k in np.arange(n) * runs // n]),
        "true_range_cm": rng.uniform(60.0, 350.0, n),
        "throttle": rng.uniform(0.2, 0.9, n),
        "humidity_pct": rng.uniform(20.0, 90.0, n),
        "target": rng.choice(["grass", "asphalt"], n),
    }


def number(contexts: Columns, name: str) -> Array:
    return np.asarray(contexts[name], dtype=float)


def read(contexts: Columns, seed: int, bias_cm: Array | float = 0.0) -> Array:
    return np.array(sensor().readings((number(contexts, "true_range_cm") + bias_cm).tolist(), seed))


def forms(contexts: Columns, reading_cm: Array) -> list[CandidateCurve]:
    fitted = refit(Prepared.of(MODEL, contexts, reading_cm), [])
    return scan(curves_of(contexts), fitted, None)


def hidden(channel: str, contexts: Columns, seed: int) -> Array:
    """Readings of which something is off above a throttle of 0.6."""
    rng = np.random.default_rng([seed, 9])
    true_cm, above = number(contexts, "true_range_cm"), number(contexts, "throttle") > 0.6
    if channel == "bias":
        return read(contexts, seed, np.where(above, 0.8, 0.0))
    if channel == "spread":
        return read(contexts, seed, 1.5 * SIGMA_CM * above * rng.standard_normal(N))
    is_changed = above & (rng.random(N) < 0.12)
    instead = {
        "short": np.rint(rng.uniform(20.0, np.maximum(true_cm - 20.0, 25.0))),
        "missed": np.full(N, 765.0),
        "random": rng.integers(20, 766, N).astype(float),
    }[channel]
    return np.where(is_changed, instead, read(contexts, seed))


@pytest.mark.parametrize("by_run", [False, True])
def test_a_scan_of_correlated_readings_has_the_statistic_of_each_curve_alone(by_run: bool) -> None:
    """Against the scores of its knots one by one, and what of them is left next to what is fitted."""
    contexts = flown(7, 600, 12)
    contexts["throttle"] = np.where(np.arange(600) % 9 == 0, np.nan, number(contexts, "throttle"))
    contexts["run"] = contexts["run"].reshape(12, 50).T.ravel()
    mixture = MODEL.sensor.reading_model.model_copy(update={"correlation": 0.6, "correlation_spacing_s": 0.1})
    correlated = Model.of(MODEL.sensor.model_copy(update={"reading_model": mixture}))
    model = with_curve(correlated, "missed", ["target"], [["asphalt", "grass"]], [0.0, 2.0])
    unit = np.unique(contexts["run"], return_inverse=True)[1]
    prepared = Prepared.of(model, contexts, model.sample(contexts, np.random.default_rng(7)))
    fitted = refit(prepared, [make_curve_term("bias", ["target"], [["asphalt", "grass"]], [0.0, 0.0])])
    here, free = fitted.here, ~fitted.at.held
    nuisance, inner = fitted.at.scores[:, free], np.linalg.inv(fitted.at.information[np.ix_(free, free)])
    found = scan(curves_of(contexts, unit), fitted, unit if by_run else None)
    assert {"bias", "spread", "missed"} <= {each.channel for each in found}
    assert {(len(each.variables), each.cost_nats) for each in found} == {(1, 0.0), (2, rules.PAIR_COST_NATS)}
    assert [each.log_p for each in found if each.channel == "bias" and each.variables == ("target",)] == [0.0]
    for form in found[::6]:
        there = np.all([number(contexts, each) > 0.0 for each in form.variables if each != "target"], axis=0)
        weights = hats(contexts, form.variables, form.knots) * np.broadcast_to(there, 600)[:, None]
        weights -= weights.sum(axis=1, keepdims=True) * weights.sum(axis=0) / weights.sum()
        channel = CHANNELS.index(form.channel)
        scores = np.column_stack([here.score(channel, each) for each in weights.T])
        carried = inner @ nuisance.T @ scores
        left, before = scores - nuisance @ carried, scores.T @ scores
        after = before - scores.T @ nuisance @ carried
        if channel > 1:
            share = here.shares[:, channel - 2]
            expected = share * (1.0 - share) * (here.by[:, channel] ** 2).sum() / (share * (1.0 - share)).sum()
            varies, mean = weights.T @ (expected[:, None] * weights), weights.T @ expected
            before, after = before + varies, after + varies - np.outer(mean, mean) / expected.sum()
            before, after = 0.5 * before, 0.5 * after
        scale = np.sqrt(np.diag(before))
        values, vectors = np.linalg.eigh(after / np.outer(scale, scale))
        turned = (vectors / np.sqrt(np.maximum(values, 1e-9)) / scale[:, None])[:, values.size - form.degrees :]
        z = (scores.sum(axis=0) - fitted.at.gradient[free] @ carried) @ turned
        if by_run:
            sums = np.array([left[unit == run].sum(axis=0) for run in range(12)]) @ turned
            variance = sums.var(axis=0, ddof=1) * 12
            z = z / np.sqrt(np.maximum(np.maximum(variance, variance.sum() / max(form.degrees, 1)), 1.0))
            z = z * np.sqrt(max(11 - form.degrees, 1) / 12)
        assert form.gain == pytest.approx(0.5 * float(z @ z), rel=1e-3, abs=1e-3), form


@pytest.mark.parametrize("channel", ["bias", "spread", "short", "missed", "random"])
def test_a_free_form_is_found_in_its_channel_over_its_variable(channel: str) -> None:
    contexts = flown(1)
    first = forms(contexts, hidden(channel, contexts, 1))[0]
    assert (first.channel, first.variables) == (channel, ("throttle",))
    assert first.log_p < -15.0
    assert first.gain > 15.0


def test_readings_of_a_kind_that_never_came_hide_no_curve() -> None:
    """Only its prior holds their share, so that its scores are all alike and do not sum to zero."""
    contexts = flown(1)
    reading_cm = hidden("bias", contexts, 1)
    first = forms(contexts, np.where(reading_cm == 765.0, number(contexts, "true_range_cm").round(), reading_cm))[0]
    assert (first.channel, first.variables) == ("bias", ("throttle",))
    assert first.gain > 15.0


def test_what_hardly_comes_but_at_one_word_is_found() -> None:
    """Of the misses that came nearly all are at one of four places, so nearly all that was expected is elsewhere."""
    contexts = flown(4) | {"anchor": np.random.default_rng(4).choice(["a1", "a2", "a3", "a4"], N)}
    reading_cm = np.array(sensor(missed=0.002, hit=0.978).readings(number(contexts, "true_range_cm").tolist(), 4))
    there = (contexts["anchor"] == "a1") & (np.random.default_rng(5).random(N) < 0.15)
    first = forms(contexts, np.where(there, 765.0, reading_cm))[0]
    assert (first.channel, first.variables, first.degrees) == ("missed", ("anchor",), 3)
    assert first.gain > 10.0


def test_p_values_are_uniform_where_nothing_is_there_and_a_constant_is_the_base_s() -> None:
    p_values = []
    for seed in range(4):
        contexts = flown(seed)
        for form in forms(contexts, read(contexts, seed, bias_cm=0.7)):
            knots = int(np.prod([len(each) for each in form.knots]))
            if form.channel == "bias" and form.variables == ("humidity_pct",):
                # Of as many knots one number is the offset, which is fitted.
                assert form.degrees == knots - 1
            p_values.append(np.exp(form.log_p))
    assert 0.02 < np.mean(np.array(p_values) < 0.1) < 0.25
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.12)


def test_p_values_that_underflow_still_have_an_order() -> None:
    contexts = flown(3)
    bias_cm = 50.0 * (number(contexts, "throttle") - 0.5) + 0.1 * (number(contexts, "humidity_pct") - 50.0)
    found = forms(contexts, read(contexts, 3, bias_cm))
    assert found[0].variables == ("throttle",)
    assert found[0].log_p < -650.0
    other = next(each for each in found if each.variables == ("humidity_pct",))
    assert found[0].log_p < other.log_p < -1.0


@pytest.mark.parametrize(
    ("curve", "text"),
    [
        (lambda x: 1.0 + 3.0 * x, r"1 \+ 3 throttle"),
        (lambda x: 1.0 - 4.0 * (x - 0.5) ** 2, r".* throttle \- 4 throttle\^2|.*throttle\^2"),
        (lambda x: np.sin(2.0 * np.pi * x), r".*sin.*cos.*"),
        (lambda x: 2.0 * (x > 0.5), r".*\[throttle > 0\.5.*\]"),
    ],
    ids=["line", "parabola", "wave", "step"],
)
def test_a_formula_is_the_shortest_that_goes_through(curve: object, text: str) -> None:
    at = np.linspace(0.0, 1.0, 12)
    values: Array = curve(at)  # type: ignore[operator]
    assert re.fullmatch(text, formula("throttle", at, values, np.full(12, 0.02)))


def test_noise_makes_a_formula_no_longer() -> None:
    at, rng = np.linspace(0.0, 1.0, 12), np.random.default_rng(4)
    lines = [formula("throttle", at, 3.0 * at + 0.1 * rng.standard_normal(12), np.full(12, 0.1)) for _ in range(40)]
    assert np.mean([re.fullmatch(r"\S+ [+-] \S+ throttle", each) is not None for each in lines]) > 0.5


def test_a_reading_whose_context_is_not_known_has_no_place_on_the_curve() -> None:
    contexts = flown(2)
    contexts["throttle"] = np.where(np.arange(N) % 3 == 0, np.nan, number(contexts, "throttle"))
    asked = curves_of(contexts)
    values = np.column_stack([np.ones(N), np.arange(N) % 3 == 0])
    sums = {variables: weights.sums(values) for variables, weights in asked.weights.items()}
    for (variables, _), form in zip(asked.curves, asked.forms, strict=True):
        # About their mean where the column is known, and nothing where it is not.
        of_all, of_unknown = (form.T @ sums[variables]).T
        assert of_all == pytest.approx(0.0, abs=1e-2)
        assert of_unknown.any() == ("throttle" not in variables)


def one_air(seed: int, low_c: float, high_c: float, n: int = N) -> Columns:
    contexts = flown(seed, n)
    del contexts["humidity_pct"], contexts["target"]
    contexts["air_temperature_c"] = low_c + (high_c - low_c) * np.mod(0.5 + 0.6180339887 * np.arange(n), 1.0)
    return contexts


def effect_of(contexts: Columns, seed: int) -> FoundEffect:
    """A clock that is 0.8 % slow."""
    reading_cm = read(contexts, seed, 0.008 * number(contexts, "true_range_cm"))
    rng = np.random.default_rng(1)
    # The reference model is calibrated at 22.5 C, and so are these readings.
    found = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    (effect,) = found.effects
    return effect


@pytest.mark.slow
def test_an_experiment_that_is_named_separates_the_two() -> None:
    together = effect_of(one_air(5, 15.0, 15.0), 5)
    names = {together.name, *(other.name for other in together.alternatives)}
    assert {"range_scale", "air_temperature"} <= names
    found = re.search(r"air_temperature[^;]*vary air_temperature_c evenly from (\S+) to (\S+) °C", together.experiment)
    assert found is not None, together.experiment
    low_c, high_c = float(found[1]), float(found[2])
    # 0.8 % of ranges that scatter by 84 cm are 15 standard errors of 2000 readings. Of air about 15 C, 7.5 from that of
    # the calibration, three are left where its scatter times 221 cm is 0.2 of 7.5 times 84 cm: 0.57 C, which is 2 C
    # evenly. The steps that are tried are 2.75 C, 5.5 C, 11 C, ...
    assert high_c - low_c == pytest.approx(2.75, abs=0.1)
    apart = effect_of(one_air(6, low_c, high_c, 3 * N), 6)
    names = {apart.name, *(other.name for other in apart.alternatives)}
    assert names & {"range_scale", "thermometer_offset"}
    assert "air_temperature" not in names


def test_a_column_of_words_of_ones_own_is_a_value_for_each() -> None:
    contexts = flown(21)
    anchor = np.random.default_rng(21).choice(["a1", "a2", "a3"], N)
    contexts["anchor"] = anchor
    best = forms(contexts, read(contexts, 21, 0.5 * (anchor == "a2")))[0]
    assert (best.channel, best.variables, best.degrees) == ("bias", ("anchor",), 2)
    found = with_curve(MODEL, "bias", ["anchor"], [["a1", "a2", "a3"]], [0.0, 30.0, 0.0])
    drawn = found.sample({name: contexts[name] for name in ("true_range_cm", "anchor")}, np.random.default_rng(1))
    off = drawn - number(contexts, "true_range_cm")
    assert np.median(off[anchor == "a2"]) - np.median(off[anchor != "a2"]) == pytest.approx(30.0, abs=1.0)
    # A word that the curve does not know has none of its values, and no word has none either.
    alone = Sampler(found, np.random.default_rng(1))
    many = [alone.sample_one({"true_range_cm": 100.0, "anchor": each}) for each in ["a2", "a9", None] for _ in range(9)]
    assert np.median(many[:9]) == pytest.approx(130.0, abs=2.0)
    assert np.median(many[9:]) == pytest.approx(100.0, abs=2.0)


@pytest.mark.slow
def test_a_step_is_found_where_it_is_and_written_as_one() -> None:
    contexts = flown(22)
    reading_cm = hidden("bias", contexts, 22)
    best = forms(contexts, reading_cm)[0]
    assert (best.channel, best.variables, best.degrees) == ("bias", ("throttle",), 1)
    assert np.mean(np.asarray(best.knots[0])) == pytest.approx(0.6, abs=0.05)
    rng = np.random.default_rng(1)
    (found,) = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng).unknown
    size, place = map(float, re.findall(r"\+ ([0-9.]+) \[throttle > ([0-9.]+)\]", found.formula)[0])
    assert size == pytest.approx(0.8, abs=0.3)
    assert place == pytest.approx(0.6, abs=0.05)
    # It is drawn over the whole column, not between its two knots alone.
    assert found.curve[-1][0] - found.curve[0][0] > 0.6


def test_what_differs_from_run_to_run_has_as_many_values_as_runs() -> None:
    contexts = flown(23)
    run = np.unique(contexts["run"], return_inverse=True)[1]
    contexts["pressure_hpa"] = np.random.default_rng(23).uniform(950.0, 1030.0, 20)[run] + 0.01 * np.arange(N) / N
    fine = {len(knots[0]) for names, knots in curves_of(contexts).curves if names == ("pressure_hpa",)}
    coarse = {len(knots[0]) for names, knots in curves_of(contexts, run).curves if names == ("pressure_hpa",)}
    assert (max(fine), max(coarse)) == (12, 6)


def test_a_value_for_each_of_eight_places_is_no_curve() -> None:
    """24 runs at eight ranges, each a little off its own way: eight numbers, and no function of the range."""
    rng = np.random.default_rng(6)
    contexts = flown(6, 2400, 24)
    place = np.arange(2400) // 100 % 8
    contexts["true_range_cm"] = 50.0 + 40.0 * place
    reading_cm = read(contexts, 6, rng.permutation(np.linspace(-1.5, 1.5, 8))[place] * SIGMA_CM * 0.3)
    found = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert ("bias", ("true_range_cm",)) not in {(each.channel, each.variables) for each in found.unknown}


def test_what_varies_inside_runs_is_found_where_few_runs_differ() -> None:
    """Seven runs with offsets of their own: of so few a scan over runs would ask more than the evidence does."""
    rng = np.random.default_rng(3)
    contexts, unit = flown(3, 2400, 7), np.arange(2400) * 7 // 2400
    contexts["throttle"] = np.clip(0.55 + 0.02 * rng.standard_normal(7)[unit] + 0.12 * rng.standard_normal(2400), 0, 1)
    bias_cm = 0.7 * (number(contexts, "throttle") > 0.6) + 0.35 * rng.standard_normal(7)[unit]
    problem = Problem.of(MODEL, contexts, read(contexts, 3, bias_cm), unit, rng)
    state = first_state(problem)
    assert state.by_run
    assert [each.label for each in add_curves(problem, state, 6.0, 6).terms] == ["bias over throttle"]


@pytest.mark.slow
def test_hits_so_far_off_that_they_count_as_outliers_are_a_curve_of_the_bias() -> None:
    """A drone that flies over a box twice in a flight: 40 cm nearer, where the model has no hit and no slope."""
    contexts = flown(31)
    place = np.abs(np.mod(np.arange(N) / 250.0, 2.0) - 1.0)
    contexts["x_m"] = place
    over = (place > 0.6) & (number(contexts, "true_range_cm") > 80.0)
    reading_cm = read(contexts, 31, np.where(over, -40.0, 0.0))
    rng = np.random.default_rng(1)
    problem = Problem.of(MODEL, contexts, reading_cm, np.arange(N) * 20 // N, rng)
    best = far_curves(problem, first_state(problem))[0]
    assert best.variables == ("x_m",)
    assert min(best.start) == pytest.approx(-40.0, abs=1.0)
    assert best.start[0] == pytest.approx(0.0, abs=1.0)
    found = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert ("bias", ("x_m",)) in {(each.channel, each.variables) for each in found.unknown}


def test_short_readings_here_and_there_are_no_far_hits() -> None:
    contexts = flown(32)
    reading_cm = read(contexts, 32)
    short = np.random.default_rng(32).random(N) < 0.3 * (number(contexts, "throttle") > 0.6)
    reading_cm = np.where(short, np.rint(0.5 * reading_cm), reading_cm)
    problem = Problem.of(MODEL, contexts, reading_cm, np.arange(N) * 20 // N, np.random.default_rng(1))
    assert far_curves(problem, first_state(problem)) == []
