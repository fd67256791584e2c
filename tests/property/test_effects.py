"""Every effect of the catalogue keeps its contract; curves, and effects on each other, draw what they score."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError
from msp_sim.effects import CATALOGUE
from msp_sim.model.contract import CHECKS, Check, codes, uniformity
from msp_sim.model.model import Model
from msp_sim.model.trial import Trial, contexts
from tests.support.curves import with_curve
from tests.support.slow import slow_but

SHIPPED = Path(__file__).parents[2] / "configs" / "sensors"
SENSOR = load_sensor_model(SHIPPED / "mb1242.yaml")
CODES = codes(SENSOR)
TRIALS = {name: Trial(effect, SENSOR) for name, effect in CATALOGUE.items()}
IN_MILLIMETRES = Trial(CATALOGUE["clutter"], SENSOR).base.with_step(0.1).sensor


def sensor(**changes: object) -> SensorModel:
    """The shipped sensor model without effects."""
    return SENSOR.model_copy(update={"effects": (), **changes})


def strong(name: str, on: Model | None = None) -> Model:
    """A model with an effect that nobody can overlook."""
    return TRIALS[name].on(on or Model.of(sensor()))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.find.__name__)
@pytest.mark.parametrize("name", slow_but(list(CATALOGUE)[::6], CATALOGUE))
def test_an_effect_keeps_the_contract(name: str, check: Check) -> None:
    assert check.find(TRIALS[name]) is None, check.advice


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.find.__name__)
@pytest.mark.parametrize("name", ["clutter", "coarse_rounding", "crosstalk", "cycle_slip", "stale"])
def test_an_effect_keeps_the_contract_in_millimetres(name: str, check: Check) -> None:
    """One of each kind of component and fault, and one with the hits' own place."""
    assert check.find(Trial(CATALOGUE[name], IN_MILLIMETRES)) is None, check.advice


@pytest.mark.parametrize("name", ["lidar_sick", "hcsr04"])
def test_slopes_of_a_sensor_that_never_saturates(name: str) -> None:
    """Its saturated fraction of 0 cannot be lowered."""
    other = load_sensor_model(SHIPPED / f"{name}.yaml")
    assert other.reading_model.saturated_fraction == 0.0
    (slopes,) = [each for each in CHECKS if each.find.__name__ == "_slopes"]
    for effect in ("mounting_offset", "missed"):
        assert slopes.find(Trial(CATALOGUE[effect], other)) is None


def test_a_fault_of_bytes_needs_whole_centimetres() -> None:
    entry = {"name": "lost_high_byte", "parameters": {"share": 0.1}}
    assert Model.of(sensor(effects=(entry,))).effects[0].effect.name == "lost_high_byte"
    with pytest.raises(ConfigError, match=r"effects\[0\]\.name: lost_high_byte acts on bytes .* resolution_cm is 0\.1"):
        Model.of(sensor(effects=(entry,), resolution_cm=0.1))


CURVES: dict[str, Any] = {
    "bias": ("bias", ["throttle"], [[0.0, 0.4, 1.0]], [-9.0, 0.0, 25.0]),
    "spread": ("spread", ["target"], [["asphalt", "grass"]], [0.7, 1.5]),
    "short": ("short", ["uptime_s"], [[0.0, 900.0]], [0.0, 3.0]),
    "missed": ("missed", ["humidity_pct"], [[20.0, 50.0, 80.0]], [-1.0, 0.0, 3.0]),
    "random": ("random", ["air_temperature_c"], [[0.0, 30.0]], [-2.0, 4.0]),
    "pair": ("bias", ["throttle", "incidence_deg"], [[0.0, 1.0], [-20.0, 20.0]], [-8.0, 8.0, 8.0, -8.0]),
}


@pytest.mark.parametrize("name", CURVES)
def test_a_curve_draws_what_it_scores_and_rests_where_its_context_is_not_known(name: str) -> None:
    channel, variables, knots, values = CURVES[name]
    base = strong("multipath")
    model = with_curve(base, channel, variables, knots, values)
    given = contexts(20_000)
    readings_cm = model.sample(given, np.random.default_rng(2))
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    assert uniformity(model, given) > 1e-3
    without = np.exp(base.log_prob(readings_cm, given))
    with np.errstate(divide="ignore"):
        assert np.log(p).mean() > np.log(without).mean() + 1e-3
    each = {column: np.repeat(column_values[:24], CODES.size) for column, column_values in given.items()}
    of_codes = np.exp(model.log_prob(np.tile(CODES, 24), each)).reshape(24, CODES.size)
    assert of_codes.sum(axis=1) == pytest.approx(np.ones(24), abs=1e-9)
    for variable in variables:
        column = given[variable]
        unknown = (column == "") if column.dtype.kind == "U" else np.isnan(column)
        assert (p[unknown] == without[unknown]).all()


SHUFFLED = [str(name) for name in np.random.default_rng(1).permutation(list(CATALOGUE))]


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), [*pairwise(SHUFFLED), (SHUFFLED[-1], SHUFFLED[0])])
def test_two_effects_at_once_draw_what_they_score(one: str, other: str) -> None:
    given = contexts(8000, seed=4)
    given["run"] = np.arange(8000).astype(str)
    assert uniformity(strong(other, strong(one)), given) > 1e-4


def test_readings_of_a_run_share_its_offset_also_in_another_chunk() -> None:
    n, runs = 140_000, 100
    given = {
        "true_range_cm": np.full(n, 200.0),
        "run": np.tile(np.arange(runs).astype(str), n // runs),
    }
    readings_cm = Model.of(sensor()).adding("run_offsets", deviation_cm=3.0).sample(given, np.random.default_rng(1))
    of_run = readings_cm.reshape(-1, runs)
    first, second = np.median(of_run[:600], axis=0), np.median(of_run[800:], axis=0)
    assert np.abs(first - second).max() <= 1.0
    assert np.std(first) == pytest.approx(3.0, rel=0.25)


def test_without_effects_it_is_the_base_model() -> None:
    given = contexts(5000)
    readings_cm = Model.of(sensor()).sample(given, np.random.default_rng(1))
    base = ReadingModel.of(sensor()).log_prob(readings_cm, given)
    assert Model.of(sensor()).log_prob(readings_cm, given) == pytest.approx(base, rel=1e-12)


@pytest.mark.slow
def test_effects_upon_effects() -> None:
    """All of the catalogue at once still sums to one and follows its probabilities."""
    model = Model.of(sensor())
    for name in CATALOGUE:
        model = strong(name, model)
    given = contexts(20_000, seed=3)
    given["run"] = np.arange(20_000).astype(str)
    assert uniformity(model, given) > 1e-3
    sent = np.concatenate([CODES, CODES[CODES < 766] + 766.0])
    each = {column: np.repeat(values[:8], sent.size) for column, values in given.items()}
    p = np.exp(model.log_prob(np.tile(sent, 8), each)).reshape(8, sent.size)
    assert p.sum(axis=1) == pytest.approx(np.ones(8), abs=1e-9)
