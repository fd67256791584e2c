"""Joint refits: slopes against finite differences, errors against scatter, and the model file that comes of a fit."""

from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.candidate_starts import _less_correlated
from msp_lab.gap.extended_model import extended, to_sensor
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem, first_state, with_candidate
from msp_lab.gap.refit import JointFit, refit
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_sim.effects.component import Normal
from msp_sim.model.model import Model, Term, make_curve_term, make_term
from tests.support.measured import MODEL as FILE
from tests.support.plain_sampler import PlainSensor

Array = NDArray[np.float64]
Columns = dict[str, NDArray[np.generic]]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
NB = len(BASE)


def flown(seed: int, n: int = 2000) -> Columns:
    rng = np.random.default_rng(seed)
    return {
        "true_range_cm": rng.uniform(60.0, 350.0, n),
        "range_rate_cm_s": 60.0 * rng.standard_normal(n),
        "throttle": rng.uniform(0.2, 0.9, n),
        "target": rng.choice(["grass", "asphalt"], n),
    }


def read(contexts: Columns, seed: int, bias_cm: Array | float = 0.0, **changes: float) -> Array:
    """Readings of the base by a sampler that shares no code with it."""
    mixture = MODEL.sensor.reading_model
    weights = mixture.weights
    usual = {
        "hit": weights.hit,
        "short": weights.short,
        "missed": weights.missed,
        "random": weights.random,
        "sigma_cm": mixture.sigma_cm,
        "short_rate_per_m": mixture.short_rate_per_m,
        "second_share": mixture.saturated_fraction,
    }
    true_cm = np.asarray(contexts["true_range_cm"], dtype=float) + bias_cm
    return np.array(PlainSensor(**(usual | changes)).readings(true_cm.tolist(), seed))


def placed(effects: tuple[Term, ...], values: Array) -> list[Term]:
    out, at = [], 0
    for each in effects:
        names = [parameter.name for parameter in each.effect.parameters]
        own = dict(zip(names, values[at : at + len(names)].tolist(), strict=True))
        out.append(Term(each.effect, own, each.of, each.shape))
        at += len(names)
    return out


EFFECTS = {
    "latency": make_term("latency", None, {"delay_ms": 8.0}),
    "rotor_noise": make_term("rotor_noise", None, {"growth": 0.8}),
    "missed_by_target": make_term("missed_by_target", "grass", {"log_odds": 1.5}),
    "multipath": make_term("multipath", None, {"share": 0.1}),
    "lost_high_byte": make_term("lost_high_byte", None, {"share": 0.1}),
    "curve": make_curve_term("bias", ["throttle"], [[0.2, 0.5, 0.9]], [0.5, -0.5, 1.0]),
    "spread curve": make_curve_term("spread", ["target"], [["asphalt", "grass"]], [0.2, 0.4]),
}


CORRELATED = ("latency", "rotor_noise", "spread curve")


@pytest.mark.parametrize(
    ("name", "correlation"), [*((name, 0.0) for name in EFFECTS), *((name, 0.6) for name in CORRELATED)]
)
def test_the_scores_of_a_fit_are_slopes(name: str, correlation: float) -> None:
    contexts = flown(1, 600) | {"run": np.repeat(["a", "b"], 300), "time_s": 0.1 * np.arange(600)}
    numbers = {"correlation": correlation, "correlation_spacing_s": 0.1}
    mixture = MODEL.sensor.reading_model.model_copy(update=numbers)
    model = Model.of(MODEL.sensor.model_copy(update={"reading_model": mixture}))
    reading_cm = Model(model.sensor, (EFFECTS[name],)).sample(contexts, np.random.default_rng(3))
    prepared = Prepared.of(model, contexts, reading_cm)
    fitted = refit(prepared, [EFFECTS[name]])
    assert len(fitted.names) == fitted.values.size == NB + len(EFFECTS[name].values)
    for k in range(fitted.values.size):
        step = 1e-4
        ends = []
        for sign in (1.0, -1.0):
            values = fitted.values.copy()
            values[k] += sign * step
            ends.append(prepared.log_prob(Base(*values[:NB]), placed(fitted.effects, values[NB:])))
        slope = (ends[0] - ends[1]) / (2.0 * step)
        if fitted.at.held[k] or not np.any(slope):
            continue
        usual = np.abs(slope) < 30.0
        size = np.abs(slope[usual]).max()
        np.testing.assert_allclose(
            fitted.at.scores[usual, k], slope[usual], atol=0.06 * size + 0.01, err_msg=fitted.names[k]
        )


def test_slopes_of_components_are_those_of_all_parts_together() -> None:
    contexts = flown(1, 600) | {"run": np.repeat(["a", "b"], 300), "time_s": 0.1 * np.arange(600)}
    effects = [
        make_term("heavy_tails", None, {"share": 0.1, "wider": 3.0}),
        make_term("multipath", None, {"share": 0.1}),
        make_term("lost_high_byte", None, {"share": 0.1}),
    ]
    reading_cm = Model(MODEL.sensor, tuple(effects)).sample(contexts, np.random.default_rng(3))
    prepared = Prepared.of(MODEL.adding("clutter", share=0.02), contexts, reading_cm, spacing_s=0.1)
    base = Base(0.2, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.3)
    here = prepared.slopes(base, effects)
    slopes = iter(prepared.slopes_of(base, effects, here))
    for k in (0, 1):
        for parameter in effects[k].effect.parameters:
            value = effects[k].values[parameter.name]
            step = parameter.step * (1.0 if parameter.neutral is not None else value)
            there = placed((effects[k],), np.array([*({**effects[k].values, parameter.name: value + step}).values()]))
            moved = prepared.log_prob(base, [*effects[:k], *there, *effects[k + 1 :]])
            assert next(slopes) == pytest.approx((moved - here.log_p) / step, abs=1e-7)


def test_a_component_with_another_share_is_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    contexts = flown(1, 600)
    tails = [make_term("multipath", None, {"share": 0.1, "sigma_cm": 3.0})]
    prepared = Prepared.of(MODEL, contexts, read(contexts, 1))
    here, asked = prepared.slopes(Base(), tails), Mock(wraps=Normal.prob)
    monkeypatch.setattr(Normal, "prob", lambda *given: asked(*given))
    assert prepared.slopes_of(Base(), tails, here).shape == (2, 600)
    # Each of both spreads for the readings, and for what arrives as 255.
    assert asked.call_count == 4


def test_a_fit_is_at_its_highest_and_its_errors_are_those_of_repetition() -> None:
    contexts = flown(2, 1000)
    rate = np.asarray(contexts["range_rate_cm_s"], dtype=float)
    found, errors = [], []
    for seed in range(25):
        prepared = Prepared.of(MODEL, contexts, read(contexts, seed, bias_cm=-0.008 * rate))
        fitted = refit(prepared, [EFFECTS["latency"]])
        found.append(fitted.values[NB])
        errors.append(float(np.sqrt(fitted.covariance()[NB, NB])))
        if seed == 0:
            for less in (-1.0, 1.0):
                other = prepared.log_prob(fitted.base, [make_term("latency", None, {"delay_ms": found[0] + less})])
                assert other.sum() < fitted.here.log_p.sum()
    assert np.mean(found) == pytest.approx(8.0, abs=4.0 * float(np.mean(errors)) / 5.0)
    assert np.std(found) == pytest.approx(np.mean(errors), rel=0.45)


def test_runs_that_share_an_offset_have_larger_errors() -> None:
    contexts = flown(3)
    run = np.repeat(np.arange(20), 100)
    offset_cm = np.random.default_rng(3).permutation(np.linspace(-3.0, 3.0, 20))
    prepared = Prepared.of(MODEL, contexts, read(contexts, 3, bias_cm=offset_cm[run]))
    fitted = refit(prepared, [])
    alone, by_run = (float(np.sqrt(fitted.covariance(unit)[0, 0])) for unit in (None, run))
    assert by_run == pytest.approx(offset_cm.std() / np.sqrt(20), rel=0.3)
    assert alone < 0.4 * by_run


def test_a_share_stays_within_its_bounds_and_is_held_there() -> None:
    contexts = flown(4)
    prepared = Prepared.of(MODEL, contexts, read(contexts, 4))
    fitted = refit(prepared, [make_term("multipath", None, {"share": 0.2})])
    assert 0.0 <= fitted.values[NB] < 0.01
    thermometer = Prepared.of(MODEL, contexts, read(contexts, 4, bias_cm=150.0))
    assert abs(refit(thermometer, []).base[0]) <= 20.0


def test_what_readings_do_not_determine_stays_near_the_file() -> None:
    contexts = flown(5, 60)
    reading_cm = np.rint(np.asarray(contexts["true_range_cm"], dtype=float))
    fitted = refit(Prepared.of(MODEL, contexts, reading_cm), [])
    # No outlier in 60 readings is no news of a share of 1 or 2 %.
    assert np.abs(fitted.base[2:5]).max() < 1.5
    assert np.abs(fitted.base[5:]).max() < 0.5


@pytest.mark.parametrize("calibrated", [False, True])
def test_a_model_of_a_fit_is_what_was_fitted(calibrated: bool) -> None:
    sensor = MODEL.sensor
    if calibrated:
        knots = [{"true_cm": 50.0, "reading_cm": 51.0}, {"true_cm": 300.0, "reading_cm": 303.0}]
        mixture = sensor.reading_model.model_dump() | {"sigma_growth_cm_per_m": 0.4}
        sensor = SensorModel.model_validate(sensor.model_dump() | {"calibration": knots, "reading_model": mixture})
    given = Model.of(sensor)
    contexts = flown(6)
    base = Base(1.5, 0.3, 0.8, -0.7, 1.2, 0.4, 0.1, 0.0)
    effects = (EFFECTS["latency"], EFFECTS["curve"], EFFECTS["missed_by_target"])
    reading_cm = read(contexts, 6)
    wanted = Prepared.of(given, contexts, reading_cm).log_prob(base, effects)
    model = extended(given, base, effects, None)
    # What grows with range is taken at the range that is read, which the fit leaves where it was.
    near = 0.03 if calibrated else 1e-6
    np.testing.assert_allclose(model.log_prob(reading_cm, contexts), wanted, atol=near)
    read_again = Model.of(SensorModel.model_validate(to_sensor(model).model_dump(mode="json")))
    np.testing.assert_allclose(read_again.log_prob(reading_cm, contexts), wanted, atol=near)


def test_a_fit_from_far_away_ends_where_the_readings_are() -> None:
    contexts = flown(7)
    throttle = np.asarray(contexts["throttle"], dtype=float)
    shape = make_curve_term("bias", ["throttle"], [[0.2, 0.55, 0.9]], [0.0, 0.0, 0.0])
    bow_cm = 2.0 * np.maximum(throttle - 0.55, 0.0) / 0.35
    fitted: JointFit = refit(Prepared.of(MODEL, contexts, read(contexts, 7, bias_cm=bow_cm)), [shape])
    values = fitted.values[NB:] + fitted.base[0]
    assert values == pytest.approx([0.0, 0.0, 2.0], abs=0.5)


def test_noise_that_follows_the_errors_is_also_tried_with_half_of_its_correlation() -> None:
    """Late readings err as those before them: correlated noise stands in for latency, and from there no step leads out.

    The second start has the same scatter from one reading to the next; effects that move no bias need none.
    """
    sweep = np.arange(900) // 100 % 2 == 0
    rate = np.where(sweep, 40.0, -40.0)
    contexts = {
        "time_s": 0.1 * np.arange(900.0),
        "true_range_cm": 100.0 + 0.1 * np.cumsum(rate),
        "range_rate_cm_s": rate,
    }
    reading_cm = read(contexts, 3, -0.35 * rate)
    problem = Problem.of(MODEL, contexts, reading_cm, np.arange(900) // 60, np.random.default_rng(1))
    state = first_state(problem)
    assert state.fit.base.correlation > 0.95
    latency, noise = (
        next(each for each in problem.candidates if each.effect.name == name) for name in ("latency", "heavy_tails")
    )
    (start,) = _less_correlated(problem.readings, latency, state.fit)
    assert start.correlation == pytest.approx(state.fit.base.correlation / 2.0)
    steps = [np.exp(2.0 * base.log_sigma) * (1.0 - base.correlation**2) for base in (start, state.fit.base)]
    assert steps[0] == pytest.approx(steps[1])
    assert not list(_less_correlated(problem.readings, noise, state.fit))
    found = with_candidate(problem, state.fit, latency, 50.0)
    assert found.effects[0].values["delay_ms"] == pytest.approx(350.0, abs=10.0)
    assert found.base.correlation < 0.3


def test_a_step_of_rounding_is_one_of_the_usual_ones_and_leaves_the_other_numbers_free() -> None:
    """The likelihood jumps along the step: a slope of it would end every fit at its start."""
    rng = np.random.default_rng(8)
    contexts = flown(8)
    reading_cm = np.rint(np.asarray(contexts["true_range_cm"], dtype=float) + 1.9 * rng.standard_t(4.0, 2000))
    reading_cm = np.where(rng.random(2000) < 0.5, 4.0 * np.rint(reading_cm / 4.0), reading_cm)
    problem = Problem.of(MODEL, contexts, reading_cm, np.arange(2000) // 100, rng)
    base = first_state(problem).fit
    rounding = next(each for each in problem.candidates if each.effect.name == "coarse_rounding")
    fit = with_candidate(problem, base, rounding, 0.1)
    assert fit.effects[0].values["step_cm"] == 4.0
    assert fit.effects[0].values["share"] == pytest.approx(0.5, abs=0.1)
    tails = make_term("heavy_tails", None, {"share": 0.02, "wider": 5.0})
    both = refit(problem.readings, [*fit.effects, tails], fit.base)
    alone = refit(problem.readings, [tails], base.base)
    assert both.effects[1].values["wider"] == pytest.approx(alone.effects[0].values["wider"], rel=0.2)
    assert both.at.held[both.names.index("0.step_cm")]
