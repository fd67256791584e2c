"""Every effect of the catalogue: it draws what it scores, at its null it is not there, and it keeps to itself."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chisquare, kstest

from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.rows import FREE
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model
from msp_sim.model.rows import Rows
from msp_sim.model.slopes import LEAST, log_prob, slopes
from msp_sim.model.streams import Streams

SENSOR = load_sensor_model(Path(__file__).parents[2] / "configs" / "sensors" / "mb1242.yaml")
CODES = np.concatenate([np.arange(766.0), 32768.0 + np.arange(766.0)])

STRONG: dict[str, dict[str, Any]] = {
    "mounting_offset": {"offset_cm": 7.3},
    "session_offset": {"offset_cm": -4.4},
    "range_scale": {"scale_pct": 3.0},
    "air_temperature": {"share": 1.0},
    "thermometer_offset": {"offset_c": 12.0},
    "temperature_gradient": {"share": 1.0},
    "hot_box": {"share": 1.0, "length_cm": 60.0},
    "humidity": {"share": 2.0},
    "latency": {"delay_ms": 120.0},
    "motion_during_ping": {"share": 1.0},
    "slant_range": {"share": 1.0},
    "nearest_point": {"share": 1.0},
    "threshold_walk": {"walk_cm_per_10db": 2.0},
    "cycle_slip": {"share": 0.3, "cycles": 20.0},
    "heavy_tails": {"share": 0.3, "wider": 4.0},
    "warm_up": {"offset_cm": 8.0},
    "bend": {"slope_pct": -5.0},
    "flooring": {"share": 1.0},
    "coarse_rounding": {"share": 0.8, "step_cm": 2.54},
    "spread_with_range": {"growth_per_m": 0.5},
    "spread_with_incidence": {"growth_per_10deg": 1.0},
    "rotor_noise": {"growth": 3.0},
    "vibration": {"growth": 1.0},
    "run_offsets": {"deviation_cm": 3.0},
    "missed": {"log_odds": 2.0},
    "missed_with_range": {"log_odds_per_m": 0.7},
    "beyond_field_of_view": {"log_odds_per_deg": 2.0},
    "missed_by_target": {"log_odds": 3.0},
    "small_target": {"log_odds_per_10db": 2.0},
    "dead_zone_minimum": {"share": 0.7, "depth_cm": 80.0},
    "dead_zone_maximum": {"share": 0.7, "depth_cm": 80.0},
    "unexpected_objects": {"log_odds": 2.5},
    "prop_wash": {"log_odds": 3.0},
    "crosstalk": {"share": 0.6},
    "external_source": {"rate_per_m": 0.8},
    "multipath": {"share": 0.3},
    "clutter": {"share": 0.3, "location_cm": 45.0},
    "stale": {"share": 0.3},
    "random_readings": {"log_odds": 2.5},
    "saturated_byte": {"share": 0.5},
    "lost_high_byte": {"share": 0.5},
    "or_ed_bytes": {"share": 0.5},
    "clock_fault": {"share": 0.5},
}
OF = {"sensor": "left", "run": "3", "target": "grass"}


def sensor(**changes: object) -> SensorModel:
    """The shipped sensor model without effects."""
    return SENSOR.model_copy(update={"effects": (), **changes})


def strong(name: str, on: Model | None = None) -> Model:
    """A model with an effect that nobody can overlook."""
    of = CATALOGUE[name].of
    return (on or Model.of(sensor())).adding(name, OF[of] if of else None, **STRONG[name])


def contexts(n: int, seed: int = 1) -> dict[str, NDArray[np.generic]]:
    """Contexts of all kinds, each column unknown in a tenth of the rows."""
    rng = np.random.default_rng(seed)
    columns: dict[str, NDArray[np.generic]] = {
        "true_range_cm": rng.choice([rng.uniform(10.0, 120.0, n), rng.uniform(20.0, 800.0, n)]),
        "air_temperature_c": rng.uniform(-10.0, 45.0, n),
        "target_temperature_c": rng.uniform(0.0, 60.0, n),
        "humidity_pct": rng.uniform(0.0, 100.0, n),
        "incidence_deg": rng.uniform(-30.0, 30.0, n),
        "range_rate_cm_s": rng.normal(0.0, 150.0, n),
        "throttle": rng.random(n),
        "vibration_hz": rng.choice([0.0, 60.0], n),
        "uptime_s": rng.uniform(0.0, 900.0, n),
        "target_size_cm": rng.uniform(2.0, 60.0, n),
        "neighbour_lag_ms": rng.choice([0.0, 2.0, 100.0], n),
        "neighbour_range_cm": rng.uniform(20.0, 700.0, n),
        "external_level_db": rng.uniform(80.0, 130.0, n),
        "external_duty": rng.random(n),
        "external_distance_cm": rng.uniform(10.0, 300.0, n),
        "external_frequency_khz": rng.uniform(38.0, 46.0, n),
        "previous_reading_cm": np.rint(rng.uniform(20.0, 765.0, n)),
    }
    for name, column in columns.items():
        if name == "true_range_cm":
            column[rng.random(n) < 0.02] = np.nan
        else:
            column[rng.random(n) < 0.1] = np.nan
    columns["sensor"] = rng.choice(["left", "right", ""], n)
    # Almost every reading is the only one of its run, so that the runs' offsets are independent.
    columns["run"] = np.where(rng.random(n) < 0.3, "3" if n > 1000 else "4", np.arange(n).astype(str))
    columns["target"] = rng.choice(["grass", "asphalt", ""], n)
    return columns


def test_every_effect_is_tried() -> None:
    assert STRONG.keys() == CATALOGUE.keys()


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_probabilities_of_all_codes_sum_to_one(name: str) -> None:
    rows = 24
    model = strong(name)
    each = {column: np.repeat(values, CODES.size) for column, values in contexts(rows, seed=5).items()}
    p = np.exp(model.log_prob(np.tile(CODES, rows), each)).reshape(rows, CODES.size)
    assert p.sum(axis=1) == pytest.approx(np.ones(rows), abs=1e-9)


@pytest.mark.parametrize("name", CATALOGUE)
def test_slopes_are_the_derivatives_of_log_prob(name: str) -> None:
    given = contexts(2000, seed=4)
    rows = strong(name).rows(given)
    rng = np.random.default_rng(6)
    reading_cm = np.where(rng.random(2000) < 0.7, rows.sample(Streams(rng)), rng.choice(CODES, 2000))
    reading_cm[:10] += 0.5
    log_p, by = slopes(rows, reading_cm)
    assert log_p == pytest.approx(np.maximum(rows.log_prob(reading_cm), np.log(LEAST)), abs=1e-9)
    assert log_prob(rows, reading_cm) == pytest.approx(log_p, abs=1e-9)
    hit, short, missed, random = rows.log_weights
    centre_cm, sigma_cm, rate = rows.centre_cm, rows.sigma_cm, rows.rate_per_m

    def moved(h: float) -> list[tuple[float, Rows]]:
        return [
            (1.0, replace(rows, centre_cm=centre_cm + h * sigma_cm)),
            (1.0, rows.wider(np.exp(h))),
            (1.0, replace(rows, log_weights=(hit, short + h, missed, random))),
            (1.0, replace(rows, log_weights=(hit, short, missed + h, random))),
            (1.0, replace(rows, log_weights=(hit, short, missed, random + h))),
            (1.0, replace(rows, rate_per_m=rate * float(np.exp(h)))),
            (1.0, replace(rows, saturated_fraction=rows.saturated_fraction + h)),
        ]

    can = log_p > np.log(1e-11)
    assert (by[~can & (log_p <= np.log(LEAST))] == 0.0).all()
    with np.errstate(invalid="ignore"):
        for j, ((scale, more), (_, less)) in enumerate(zip(moved(1e-4), moved(-1e-4), strict=True)):
            step = 2e-4 * scale * (sigma_cm if j == 0 else 1.0)
            numeric = ((more.log_prob(reading_cm) - less.log_prob(reading_cm)) / step)[can]
            # Short readings end at the hit: where a step of it crosses the edge of a code there is a kink.
            assert by[can, j] == pytest.approx(numeric, rel=5e-3, abs=2e-2 if j == 0 else 5e-3), FREE[j]


@pytest.mark.parametrize("name", CATALOGUE)
def test_samples_follow_log_prob(name: str) -> None:
    """The randomised probability integral transform is uniform over contexts of all kinds."""
    model = strong(name)
    given = contexts(40_000)
    if name == "run_offsets":
        given["run"] = np.arange(40_000).astype(str)
    readings_cm = model.sample(given, np.random.default_rng(2))
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    assert (p > 0.0).all()
    transformed = np.exp(rows.log_below(readings_cm)) + p * np.random.default_rng(3).random(p.size)
    assert kstest(transformed, "uniform").pvalue > 1e-3
    base_p = np.exp(Model.of(sensor()).log_prob(readings_cm, given))
    with np.errstate(divide="ignore"):
        assert np.log(p).mean() > np.log(base_p).mean() + 1e-3, "the effect is seen"


@pytest.mark.parametrize("name", CATALOGUE)
def test_samples_of_one_context_follow_log_prob(name: str) -> None:
    """Chi-square, code by code, in some contexts."""
    model = strong(name)
    few = contexts(500, seed=8)
    base = Model.of(sensor()).rows(few).log_prob(few["previous_reading_cm"].astype(float))
    acting = np.flatnonzero(model.log_prob(few["previous_reading_cm"].astype(float), few) != base)[:4]
    assert acting.size
    for row in acting:
        n = 20_000
        given = {column: np.repeat(values[row], n) for column, values in few.items()}
        if name == "run_offsets":
            given["run"] = np.arange(n).astype(str)
        readings_cm = model.sample(given, np.random.default_rng(int(row)))
        one = {column: np.repeat(values[row], CODES.size) for column, values in few.items()}
        expected = n * np.exp(model.log_prob(CODES, one))
        observed = np.bincount(np.searchsorted(CODES, readings_cm), minlength=CODES.size)
        assert observed[expected == 0.0].sum() == 0
        observed, expected = observed[expected > 0.0], expected[expected > 0.0]
        group = np.floor(np.cumsum(expected) / 10.0).astype(int)
        group = np.unique(group, return_inverse=True)[1]
        group[group == group.max()] = max(group.max() - 1, 0)
        sums = np.bincount(group, observed), np.bincount(group, expected)
        if sums[0].size > 1:
            assert chisquare(*sums).pvalue > 1e-4


@pytest.mark.parametrize("name", CATALOGUE)
def test_at_its_null_an_effect_is_not_there(name: str) -> None:
    effect = CATALOGUE[name]
    base = strong("crosstalk") if name != "crosstalk" else strong("clutter")
    null = base.adding(name, OF[effect.of] if effect.of else None, **effect.nulls())
    given = contexts(3000)
    readings_cm = base.sample(given, np.random.default_rng(4))
    assert (null.sample(given, np.random.default_rng(4)) == readings_cm).all()
    assert null.log_prob(readings_cm, given) == pytest.approx(base.log_prob(readings_cm, given), rel=1e-9)


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_rests_where_its_context_is_not_known(name: str) -> None:
    effect = CATALOGUE[name]
    given = contexts(3000)
    base, with_effect = strong("clutter"), strong(name, strong("clutter"))
    if name == "clutter":
        base = Model.of(sensor())
    readings_cm = base.sample(given, np.random.default_rng(4))
    for column in [*effect.needs, *([effect.of] if effect.of else [])]:
        if column == "true_range_cm":
            continue
        absent = {key: values for key, values in given.items() if key != column}
        empty = "" if given[column].dtype.kind == "U" else np.nan
        for unknown in (absent, {**given, column: np.full(3000, empty)}):
            assert (with_effect.sample(unknown, np.random.default_rng(4)) == readings_cm).all() or name == "clutter"
            assert (with_effect.log_prob(readings_cm, unknown) == base.log_prob(readings_cm, unknown)).all()


@pytest.mark.parametrize("name", CATALOGUE)
def test_adding_an_effect_leaves_what_the_others_draw(name: str) -> None:
    """Where the added effect does not act, the readings are the same, one by one."""
    given = contexts(3000)
    effect = CATALOGUE[name]
    rests = np.zeros(3000, dtype=bool)
    for column in effect.needs:
        values = given[column]
        rests |= (values == "") if values.dtype.kind == "U" else np.isnan(values)
    for other in ("multipath", "range_scale", "or_ed_bytes", "run_offsets"):
        if other != name:
            readings_cm = strong(other).sample(given, np.random.default_rng(9))
            for both in (strong(name, strong(other)), strong(other, strong(name))):
                same = both.sample(given, np.random.default_rng(9)) == readings_cm
                assert same[rests].all()


@pytest.mark.parametrize("name", [name for name in CATALOGUE if "share" in CATALOGUE[name].nulls()])
def test_a_rare_outlier_changes_few_readings(name: str) -> None:
    """An effect that befalls one reading in a hundred changes no more of them: the rest is drawn as it was."""
    effect = CATALOGUE[name]
    if not {"component", "code"} & set(effect.channels):
        return
    given = contexts(20_000)
    readings_cm = strong("threshold_walk").sample(given, np.random.default_rng(9))
    rare = strong("threshold_walk").adding(name, **{**STRONG[name], "share": 0.01})
    assert (rare.sample(given, np.random.default_rng(9)) != readings_cm).mean() < 0.0125


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
    model = base.adding_curve(channel, variables, knots, values)
    given = contexts(20_000)
    readings_cm = model.sample(given, np.random.default_rng(2))
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    transformed = np.exp(rows.log_below(readings_cm)) + p * np.random.default_rng(3).random(p.size)
    assert kstest(transformed, "uniform").pvalue > 1e-3
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


@pytest.mark.parametrize(("one", "other"), [*pairwise(SHUFFLED), (SHUFFLED[-1], SHUFFLED[0])])
def test_two_effects_at_once_draw_what_they_score(one: str, other: str) -> None:
    model = strong(other, strong(one))
    given = contexts(8000, seed=4)
    given["run"] = np.arange(8000).astype(str)
    readings_cm = model.sample(given, np.random.default_rng(2))
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    assert (p > 0.0).all()
    transformed = np.exp(rows.log_below(readings_cm)) + p * np.random.default_rng(3).random(p.size)
    assert kstest(transformed, "uniform").pvalue > 1e-4


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


def test_effects_upon_effects() -> None:
    """All of the catalogue at once still sums to one and follows its probabilities."""
    model = Model.of(sensor())
    for name in CATALOGUE:
        model = strong(name, model)
    given = contexts(20_000, seed=3)
    given["run"] = np.arange(20_000).astype(str)
    readings_cm = model.sample(given, np.random.default_rng(2))
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    transformed = np.exp(rows.log_below(readings_cm)) + p * np.random.default_rng(3).random(p.size)
    assert kstest(transformed, "uniform").pvalue > 1e-3
    codes = np.concatenate([CODES, CODES[CODES < 766] + 766.0])
    each = {column: np.repeat(values[:8], codes.size) for column, values in given.items()}
    p = np.exp(model.log_prob(np.tile(codes, 8), each)).reshape(8, codes.size)
    assert p.sum(axis=1) == pytest.approx(np.ones(8), abs=1e-9)
