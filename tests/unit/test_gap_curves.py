"""Free forms find what no name explains by channel and variable, and an experiment that is named does what it says."""

import re
from functools import reduce

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.curve_test import Asked, CandidateCurve, asked_of, log_p_of_sums, scan, step_of
from msp_lab.gap.curves import far_curves
from msp_lab.gap.estimates import FinalFit, formula, with_constants
from msp_lab.gap.findings import FoundEffect
from msp_lab.gap.naming import AllReadings, name_effects
from msp_lab.gap.prepared import CHANNELS, Prepared
from msp_lab.gap.problem import Problem, first_state
from msp_lab.gap.refit import refit
from msp_lab.gap.runs import draw_splits
from msp_lab.gap.search import add_curves
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


def all_asked(contexts: Columns) -> list[Asked]:
    return [each for some in asked_of(contexts) for each in some]


def forms(contexts: Columns, reading_cm: Array) -> list[CandidateCurve]:
    fitted = refit(Prepared.of(MODEL, contexts, reading_cm), [])
    return scan(contexts, all_asked(contexts), fitted)


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


def test_offsets_of_runs_do_not_hide_what_another_channel_depends_on() -> None:
    """By readings every column tells some offsets apart: it promises more of the bias than outliers over one column."""
    contexts, rng = flown(3, runs=12), np.random.default_rng(5)
    run = np.unique(contexts["run"], return_inverse=True)[1]
    for name in ("air_temperature_c", "time_of_day_h", "supply_v", "wind_m_s", "sensor_temperature_c", "uptime_s"):
        contexts[name] = rng.uniform(0.0, 20.0, 12)[run]
    reading_cm = read(contexts, 3, 3.0 * rng.standard_normal(12)[run])
    often = (number(contexts, "throttle") > 0.6) & (rng.random(N) < 0.06)
    reading_cm[often] = np.rint(rng.uniform(20.0, 765.0, N))[often]
    splits = draw_splits(contexts, np.random.default_rng(1))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    base = first_state(problem)
    assert base.by_run
    shapes = [term.active.shape for term in add_curves(problem, base, 6.0, 3).terms]
    assert [shape[:2] for shape in shapes if shape is not None] == [("random", ("throttle",))]


def test_a_scan_of_correlated_readings_has_the_statistic_of_each_curve_alone() -> None:
    """Against the scores of its knots one by one, and what of them is left next to what is fitted."""
    contexts = flown(7, 600, 12)
    contexts["throttle"] = np.where(np.arange(600) % 9 == 0, np.nan, number(contexts, "throttle"))
    contexts["run"] = contexts["run"].reshape(12, 50).T.ravel()
    mixture = MODEL.sensor.reading_model.model_copy(update={"correlation": 0.6, "correlation_spacing_s": 0.1})
    correlated = Model.of(MODEL.sensor.model_copy(update={"reading_model": mixture}))
    model = with_curve(correlated, "missed", ["target"], [["asphalt", "grass"]], [0.0, 2.0])
    prepared = Prepared.of(model, contexts, model.sample(contexts, np.random.default_rng(7)))
    fitted = refit(prepared, [make_curve_term("bias", ["target"], [["asphalt", "grass"]], [0.0, 0.0])])
    here, free = fitted.here, ~fitted.at.held
    nuisance, inner = fitted.at.scores[:, free], np.linalg.inv(fitted.at.information[np.ix_(free, free)])
    asked = dict(all_asked(contexts))
    found = scan(contexts, list(asked.items()), fitted)
    assert {"bias", "spread", "missed"} <= {each.channel for each in found}
    assert {len(each.variables) for each in found} == {1, 2}
    # It is fitted, and nothing of it is left.
    assert [each.log_p for each in found if each.channel == "bias" and each.variables == ("target",)] > [-0.1]
    for form in found[::3]:
        there = np.ones(600, dtype=bool)
        for name in set(form.variables) - {"target"}:
            there &= number(contexts, name) > 0.0
        walks = []
        for knots in asked[form.variables][-1]:
            steps = np.diff(knots) / np.ptp(knots) if knots[0] != "asphalt" else np.zeros(0)
            walk = np.tri(len(knots), len(knots) - 1, -1) * np.sqrt(steps) if steps.size else np.eye(len(knots))
            walks.append(np.column_stack([np.ones(len(knots)), walk]))
        weights = hats(contexts, form.variables, asked[form.variables][-1]) @ reduce(np.kron, walks)[:, 1:]
        weights = np.where(there[:, None], weights - weights[there].mean(axis=0), 0.0)
        channel = CHANNELS.index(form.channel)
        scores = np.column_stack([here.score(channel, each) for each in weights.T])
        carried = inner @ nuisance.T @ scores
        before = scores.T @ scores
        after = before - scores.T @ nuisance @ carried
        if channel > 1:
            share = here.shares[:, channel - 2]
            expected = share * (1.0 - share) * (here.by[:, channel] ** 2).sum() / (share * (1.0 - share)).sum()
            mean = weights.T @ expected
            varies = weights.T @ (expected[:, None] * weights)
            before = 0.5 * (before + varies)
            after += varies - np.outer(mean, mean) / expected.sum()
            after *= 0.5
        values, vectors = np.linalg.eigh(after)
        clear = values > 1e-3 * np.diag(before).max()
        values, vectors = values[clear][::-1], vectors[:, clear][:, ::-1]
        z = (scores.sum(axis=0) - fitted.at.gradient[free] @ carried) @ vectors / np.sqrt(values)
        shares = [values / (values + values[each - 1]) for each in (1, 2, 4) if each < values.size] + [np.ones(z.size)]
        likely = log_p_of_sums(np.array([share @ z**2 for share in shares]), shares)
        # The more degrees, the more readings have to speak of them.
        least = np.minimum.accumulate(likely)
        assert np.isclose(form.log_p, least, rtol=0.01, atol=0.01).any(), form


def test_a_sum_of_weighted_squares_has_the_tail_that_draws_have() -> None:
    weights = np.array([1.0, 0.5, 0.5, 0.1, 0.05])
    drawn = np.random.default_rng(1).standard_normal((400_000, 5)) ** 2 @ weights
    at = np.quantile(drawn, [0.3, 0.9, 0.999])
    log_p = log_p_of_sums(at, [weights] * 3)
    assert np.exp(log_p) == pytest.approx([0.7, 0.1, 0.001], rel=0.1)
    # Far out it is the tail of the largest.
    assert log_p_of_sums(np.array([2000.0]), [weights])[0] == pytest.approx(-1000.0, abs=6.0)


@pytest.mark.parametrize("channel", ["bias", "spread", "short", "missed", "random"])
def test_a_free_form_is_found_in_its_channel_over_its_variable(channel: str) -> None:
    contexts = flown(1)
    first = forms(contexts, hidden(channel, contexts, 1))[0]
    assert (first.channel, first.variables) == (channel, ("throttle",))
    assert first.log_p < -15.0


def test_readings_of_a_kind_that_never_came_hide_no_curve() -> None:
    """Only its prior holds their share, so that its scores are all alike and do not sum to zero."""
    contexts = flown(1)
    reading_cm = hidden("bias", contexts, 1)
    first = forms(contexts, np.where(reading_cm == 765.0, number(contexts, "true_range_cm").round(), reading_cm))[0]
    assert (first.channel, first.variables) == ("bias", ("throttle",))
    assert first.log_p < -15.0


def test_what_hardly_comes_but_at_one_word_is_found() -> None:
    """Of the misses that came nearly all are at one of four places, so nearly all that was expected is elsewhere."""
    contexts = flown(4) | {"anchor": np.random.default_rng(4).choice(["a1", "a2", "a3", "a4"], N)}
    reading_cm = np.array(sensor(missed=0.002, hit=0.978).readings(number(contexts, "true_range_cm").tolist(), 4))
    there = (contexts["anchor"] == "a1") & (np.random.default_rng(5).random(N) < 0.15)
    first = forms(contexts, np.where(there, 765.0, reading_cm))[0]
    assert (first.channel, first.variables) == ("missed", ("anchor",))
    assert first.log_p < -8.0


def test_p_values_are_uniform_where_nothing_is_there_and_a_constant_is_the_base_s() -> None:
    p_values = []
    for seed in range(4):
        contexts = flown(seed)
        for form in forms(contexts, read(contexts, seed, bias_cm=0.7)):
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


def test_a_formula_has_the_size_of_its_curve() -> None:
    """Values that are not well known are no reason to write a third of them."""
    at, error = np.array([60.0, 87.0, 112.0, 138.0, 161.0, 190.0, 220.0, 260.0]), np.full(8, 4.0)
    text = formula("height_cm", at, np.array([4.0, -3.0, 3.0, 3.0, -4.0, -4.0, 1.0, 4.0]), error)
    assert text == "60: 4, 87: -3, 112: 3, 138: 3, 161: -4, 190: -4, 220: 1, 260: 4"
    text = formula("height_cm", at, np.array([-4.1, -4.0, -3.5, -4.0, 4.1, 3.9, 4.0, 4.0]), error)
    assert text == "-3.9 + 7.9 [height_cm > 150]"


def test_noise_makes_a_formula_no_longer() -> None:
    at, rng = np.linspace(0.0, 1.0, 12), np.random.default_rng(4)
    lines = [formula("throttle", at, 3.0 * at + 0.1 * rng.standard_normal(12), np.full(12, 0.1)) for _ in range(40)]
    assert np.mean([re.fullmatch(r"\S+ [+-] \S+ throttle", each) is not None for each in lines]) > 0.5


def test_a_reading_whose_context_is_not_known_has_no_place_on_the_curve() -> None:
    contexts = flown(2)
    contexts["throttle"] = np.where(np.arange(N) % 3 == 0, np.nan, number(contexts, "throttle"))
    reading_cm = read(contexts, 2)
    elsewhere = np.where(np.arange(N) % 3 == 0, reading_cm + 2.0, reading_cm)
    best = next(each for each in forms(contexts, elsewhere) if each.variables == ("throttle",))
    # Those that are off are no part of what is asked, though the others are off from all.
    assert best.log_p > -8.0


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
    assert (best.channel, best.variables, best.forms) == ("bias", ("anchor",), ((("a1", "a2", "a3"),),))
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
    assert (best.channel, best.variables) == ("bias", ("throttle",))
    low, high = step_of(contexts, "throttle", "bias", refit(Prepared.of(MODEL, contexts, reading_cm), []))
    assert (low + high) / 2.0 == pytest.approx(0.6, abs=0.03)
    rng = np.random.default_rng(1)
    (found,) = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng).unknown
    size, place = map(float, re.findall(r"\+ ([0-9.]+) \[throttle > ([0-9.]+)\]", found.formula)[0])
    assert size == pytest.approx(0.8, abs=0.3)
    assert place == pytest.approx(0.6, abs=0.05)
    # It is drawn over the whole column, not between its two knots alone.
    assert found.curve[-1][0] - found.curve[0][0] > 0.6


def test_a_constant_is_one_number_and_curves_have_a_mean_of_0() -> None:
    """Every way of splitting 5 cm between offset and two curves predicts the same; what is printed has to add up."""
    contexts = flown(23)
    own_cm = np.where(contexts["target"] == "grass", 0.6, -0.2) + 0.8 * number(contexts, "throttle")
    readings = Prepared.of(MODEL, contexts, read(contexts, 23, 4.5 + own_cm))
    shapes = [
        ("bias", "target", ["asphalt", "grass"], [3.0, 3.8]),
        ("bias", "throttle", [0.2, 0.9], [1.0, 1.5]),
        ("spread", "throttle", [0.2, 0.9], [0.3, 0.3]),
    ]
    fit = refit(readings, [make_curve_term(channel, [name], [at], start) for channel, name, at, start in shapes])
    placed, change = with_constants(readings, fit)
    np.testing.assert_allclose(
        readings.log_prob(placed.base, placed.effects), readings.log_prob(fit.base, fit.effects), atol=1e-9
    )
    np.testing.assert_allclose(placed.values, change @ fit.values)
    for term in placed.effects:
        assert term.shape is not None
        weights = hats(contexts, *term.shape[1:])
        assert float((weights @ [*term.values.values()]).mean()) == pytest.approx(0.0, abs=1e-9)
    # What is known of the sum of offset and curves alone is known of the offset.
    final = FinalFit.of(readings, fit, np.zeros(N, dtype=np.intp), by_run=False)
    assert final.fit.base.offset_cm == pytest.approx(4.5 + own_cm.mean(), abs=final.half_widths[0] + 0.05)
    assert final.half_widths[0] == pytest.approx(1.96 * SIGMA_CM / np.sqrt(N), rel=0.2)


def test_a_constant_that_not_all_readings_have_stays_in_the_curve() -> None:
    """On water the curve is 0, so that the offset is that of water."""
    contexts = flown(24)
    contexts["target"] = np.random.default_rng(24).choice(["grass", "asphalt", "water"], N)
    readings = Prepared.of(MODEL, contexts, read(contexts, 24, 0.0 + 2.0 * (contexts["target"] != "water")))
    fit = refit(readings, [make_curve_term("bias", ["target"], [["asphalt", "grass"]], [0.0, 0.0])])
    placed, change = with_constants(readings, fit)
    assert placed.base == fit.base
    assert np.array_equal(change, np.eye(fit.values.size))


def test_a_value_for_each_of_eight_places_is_no_curve() -> None:
    """24 runs at eight ranges, each a little off its own way: eight numbers, and no function of the range."""
    rng = np.random.default_rng(6)
    contexts = flown(6, 2400, 24)
    place = np.arange(2400) // 100 % 8
    contexts["true_range_cm"] = 50.0 + 40.0 * place
    reading_cm = read(contexts, 6, rng.permutation(np.linspace(-1.5, 1.5, 8))[place] * SIGMA_CM * 0.3)
    found = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert ("bias", ("true_range_cm",)) not in {(each.channel, each.variables) for each in found.unknown}


@pytest.mark.parametrize(("both", "label"), [(False, "bias over target"), (True, "bias over throttle and target")])
def test_a_pair_of_columns_is_found_where_both_are_needed(both: bool, label: str) -> None:
    contexts, rng = flown(5), np.random.default_rng(5)
    side = np.where(number(contexts, "throttle") > 0.55, 1.0, -1.0) if both else 1.0
    bias_cm = 0.6 * np.where(contexts["target"] == "grass", side, -side)
    problem = Problem.of(MODEL, contexts, read(contexts, 5, bias_cm), np.arange(N) * 20 // N, rng)
    assert [each.label for each in add_curves(problem, first_state(problem), 6.0, 6).terms] == [label]


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
