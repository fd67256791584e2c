"""What each effect does at one place, against numbers worked out by hand: its sign, its size and its channel."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model

SENSOR = load_sensor_model(Path(__file__).parents[4] / "configs" / "sensors" / "mb1242.yaml")
BASE = Model.of(SENSOR.model_copy(update={"effects": ()}))
BEYOND = "beyond_field_of_view"
CHANNELS = ("bias", "spread", "short", "missed", "random")
Context = dict[str, Any]

NUMBERS: list[tuple[str, str | None, dict[str, float], Context, str, float]] = [
    ("mounting_offset", "left", {"offset_cm": 3.0}, {"sensor": "left"}, "bias", 3.0),
    ("mounting_offset", "left", {"offset_cm": 3.0}, {"sensor": "right"}, "bias", 0.0),
    ("session_offset", "b", {"offset_cm": -2.0}, {"run": "b"}, "bias", -2.0),
    ("range_scale", None, {"scale_pct": 1.5}, {}, "bias", 3.0),
    # 0.5 % from 150 cm on, at 200 cm.
    ("bend", None, {"slope_pct": 0.5, "from_cm": 150.0}, {}, "bias", 0.25),
    ("bend", None, {"slope_pct": 0.5, "from_cm": 250.0}, {}, "bias", 0.0),
    ("flooring", None, {"share": 1.0}, {}, "bias", -0.5),
    ("warm_up", None, {"offset_cm": 2.0, "time_constant_s": 300.0}, {"uptime_s": 300.0}, "bias", 2.0 / math.e),
    # 60 deg of the day's turn after its largest.
    ("day_cycle", None, {"swing_cm": 3.0, "hour_h": 14.0}, {"time_of_day_h": 18.0}, "bias", 1.5),
    ("day_cycle", None, {"swing_cm": 3.0, "hour_h": 14.0}, {"time_of_day_h": 2.0}, "bias", -3.0),
    # Spreading of 6.0 dB to twice the distance, and absorption of 1.4 dB/m for a metre there and back; a weaker echo is
    # found later, so farther.
    ("threshold_walk", None, {"walk_cm_per_10db": 1.0}, {}, "bias", 0.88),
    ("threshold_walk", None, {"walk_cm_per_10db": 1.0}, {"incidence_deg": 18.0}, "bias", 0.88 + 0.6),
    # In air of 0 deg C it absorbs 0.5 dB/m.
    ("threshold_walk", None, {"walk_cm_per_10db": 1.0}, {"air_temperature_c": 0.0, "humidity_pct": 50.0}, "bias", 0.69),
    # And so it does at 20 deg C with 10 % of humidity.
    (
        "threshold_walk",
        None,
        {"walk_cm_per_10db": 1.0},
        {"air_temperature_c": 20.0, "humidity_pct": 10.0},
        "bias",
        0.69,
    ),
    # Its amplitude is less by a factor of 2.754, and a linear rise takes so much longer: 1.754 / (ln(10) / 2) cm.
    ("threshold_walk", None, {"walk_cm_per_10db": 1.0, "exponent": 1.0}, {}, "bias", 1.52),
    ("spread_with_range", None, {"growth_per_m": 0.5}, {}, "spread", math.log(2.0)),
    ("spread_with_incidence", None, {"growth_per_10deg": 0.5}, {"incidence_deg": -20.0}, "spread", math.log(2.0)),
    ("rotor_noise", None, {"growth": 2.0, "exponent": 1.0}, {"throttle": 0.5}, "spread", math.log(2.0)),
    ("rotor_noise", None, {"growth": 4.0, "exponent": 2.0}, {"throttle": 0.5}, "spread", math.log(2.0)),
    ("vibration", None, {"growth": 1.0}, {"vibration_hz": 60.0}, "spread", math.log(2.0)),
    ("vibration", None, {"growth": 1.0}, {"vibration_hz": 0.0}, "spread", 0.0),
    ("missed", None, {"log_odds": 1.2}, {}, "missed", 1.2),
    ("missed_with_range", None, {"log_odds_per_m": 0.7, "from_cm": 100.0}, {}, "missed", 0.7),
    # The breakaway angle at 2 m is 12.6 deg.
    (BEYOND, None, {"log_odds": 4.0, "over_deg": 4.0}, {"incidence_deg": -15.6}, "missed", 3.0),
    (BEYOND, None, {"log_odds": 4.0, "over_deg": 4.0}, {"incidence_deg": 30.0}, "missed", 4.0),
    (
        BEYOND,
        None,
        {"log_odds": 4.0, "breakaway": 0.5, "narrowing": 0.0},
        {"incidence_deg": 8.9},
        "missed",
        0.0,
    ),
    (
        BEYOND,
        None,
        {"log_odds": 4.0, "breakaway": 0.5, "narrowing": 0.0},
        {"incidence_deg": 10.1},
        "missed",
        4.0,
    ),
    (BEYOND, None, {"log_odds": 4.0, "breakaway": 0.5}, {"incidence_deg": 7.3}, "missed", 4.0),
    (BEYOND, None, {"log_odds": 4.0}, {"incidence_deg": 12.0}, "missed", 0.0),
    ("missed_by_target", "grass", {"log_odds": 1.2}, {"target": "grass"}, "missed", 1.2),
    ("missed_by_target", "grass", {"log_odds": 1.2}, {"target": "asphalt"}, "missed", 0.0),
    ("unexpected_objects", None, {"log_odds": 1.2}, {}, "short", 1.2),
    ("prop_wash", None, {"log_odds": 2.0}, {"throttle": 0.6}, "short", 1.2),
    ("random_readings", None, {"log_odds": 1.2}, {}, "random", 1.2),
]


def changes(model: Model, context: Context) -> dict[str, float]:
    columns = {name: np.array([value]) for name, value in ({"true_range_cm": 200.0} | context).items()}
    before, after = BASE.rows(columns), model.rows(columns)
    logs = [float(np.ravel(b)[0] - np.ravel(a)[0]) for a, b in zip(before.log_weights, after.log_weights, strict=True)]
    return {
        "bias": float(after.centre_cm[0] - before.centre_cm[0]),
        "spread": float(np.log(after.sigma_cm[0] / before.sigma_cm[0])),
        "short": logs[1] - logs[0],
        "missed": logs[2] - logs[0],
        "random": logs[3] - logs[0],
    }


@pytest.mark.parametrize(("name", "of", "values", "context", "channel", "number"), NUMBERS)
def test_an_effect_at_two_metres(
    name: str, of: str | None, values: dict[str, float], context: Context, channel: str, number: float
) -> None:
    assert CATALOGUE[name].channels == (channel,)
    found = changes(BASE.adding(name, of, **values), context)
    assert found[channel] == pytest.approx(number, abs=0.02)
    for other in CHANNELS:
        assert other == channel or found[other] == pytest.approx(0.0, abs=1e-12)


# Where readings of a component lie, or what becomes of a reading of 200 cm.
PLACES: list[tuple[str, dict[str, float], Context, float, float]] = [
    ("multipath", {"share": 0.3, "sigma_cm": 0.1}, {}, 400.0, 0.3),
    ("clutter", {"share": 0.3, "location_cm": 45.0, "sigma_cm": 0.1}, {}, 45.0, 0.3),
    # 10 half wavelengths of 42 kHz in air of the calibration: 344.7 m/s / 42 kHz / 2 = 4.1 mm.
    ("cycle_slip", {"share": 0.3, "cycles": 10.0}, {}, 204.0, 0.3),
    ("dead_zone_minimum", {"share": 0.3, "depth_cm": 180.0}, {"true_range_cm": 150.0}, 20.0, 0.3),
    # Of readings of the maximum, a quarter arrives as 255.
    ("dead_zone_maximum", {"share": 0.3, "depth_cm": 180.0}, {"true_range_cm": 150.0}, 765.0, 0.225),
    ("stale", {"share": 0.3}, {"previous_reading_cm": 123.0}, 123.0, 0.3),
]
NOWHERE: list[tuple[str, dict[str, float], Context]] = [
    ("multipath", {"share": 0.3}, {"true_range_cm": 400.0}),
    ("clutter", {"share": 0.3, "location_cm": 245.0, "sigma_cm": 0.1}, {}),
    ("dead_zone_minimum", {"share": 0.3, "depth_cm": 150.0}, {}),
    ("dead_zone_maximum", {"share": 0.3, "depth_cm": 150.0}, {}),
    ("stale", {"share": 0.3}, {"previous_reading_cm": 32968.0}),
]


def drawn(model: Model, context: Context, n: int = 4000) -> np.ndarray:
    quiet = model.sensor.reading_model.model_copy(update={"sigma_cm": 0.05})
    still = Model(model.sensor.model_copy(update={"reading_model": quiet}), model.effects)
    columns = {name: np.full(n, value) for name, value in ({"true_range_cm": 200.0} | context).items()}
    readings: np.ndarray = still.sample(columns, np.random.default_rng(1))
    return readings


@pytest.mark.parametrize(("name", "values", "context", "place_cm", "share"), PLACES)
def test_where_readings_of_a_component_lie(
    name: str, values: dict[str, float], context: Context, place_cm: float, share: float
) -> None:
    there = np.mean(drawn(BASE.adding(name, None, **values), context) == place_cm)
    assert there == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize(("name", "values", "context"), NOWHERE)
def test_where_a_component_has_no_place(name: str, values: dict[str, float], context: Context) -> None:
    columns = {name: np.array([value]) for name, value in ({"true_range_cm": 200.0} | context).items()}
    (added,) = BASE.adding(name, None, **values).rows(columns).added
    assert np.ravel(added.odds)[0] == 0.0


def test_tails_are_as_many_and_as_wide_as_they_say() -> None:
    columns = {"true_range_cm": np.full(40_000, 200.0)}
    readings = BASE.adding("heavy_tails", share=0.2, wider=4.0).sample(columns, np.random.default_rng(1))
    error_cm = readings[np.abs(readings - 200.0) < 40.0] - 200.0
    sigma_cm = SENSOR.reading_model.sigma_cm
    # Beyond three standard deviations of 80 % there is hardly a reading, of the rest there are 45 %.
    assert np.mean(np.abs(error_cm) > 3.0 * sigma_cm) == pytest.approx(0.2 * 0.4533 + 0.8 * 0.0027, abs=0.015)


def test_coarse_readings_are_multiples_of_the_step() -> None:
    columns = {"true_range_cm": np.linspace(100.0, 300.0, 4000)}
    readings = BASE.adding("coarse_rounding", share=1.0, step_cm=5.0).sample(columns, np.random.default_rng(1))
    within = (readings > 20.0) & (readings < 765.0)
    assert (readings[within] % 5.0 == 0.0).all()
    assert np.median(readings - columns["true_range_cm"]) == pytest.approx(0.0, abs=0.5)


def test_a_source_is_heard_by_its_level_its_duty_and_its_distance() -> None:
    def share(**context: float) -> float:
        columns = {
            "true_range_cm": 220.0,
            "external_level_db": 110.0,
            "external_duty": 0.5,
            "external_distance_cm": 30.0,
        } | context
        model = BASE.adding("external_source", rate_per_m=1.0, threshold_db=90.0)
        (added,) = model.rows({name: np.array([value]) for name, value in columns.items()}).added
        return float(np.ravel(added.odds)[0] / (1.0 + np.ravel(added.odds)[0]))

    # Far above the threshold: half a crossing a metre, over the two metres before the own echo.
    assert share() == pytest.approx(1.0 - math.exp(-1.0), abs=0.002)
    assert share(external_duty=0.25) == pytest.approx(1.0 - math.exp(-0.5), abs=0.002)
    # Ten times as far is 20 dB weaker: at the threshold, heard half the time.
    assert share(external_distance_cm=300.0) == pytest.approx(1.0 - math.exp(-0.5), abs=0.002)
    assert share(external_frequency_khz=52.0) < 0.001
    assert share(true_range_cm=120.0) == pytest.approx(1.0 - math.exp(-0.5), abs=0.002)


def test_a_run_has_one_offset() -> None:
    columns = {"true_range_cm": np.full(6000, 200.0), "run": np.repeat(np.arange(300).astype(str), 20)}
    model = BASE.adding("run_offsets", deviation_cm=3.0)
    of_run = np.median(model.sample(columns, np.random.default_rng(1)).reshape(300, 20), axis=1)
    assert of_run.std() == pytest.approx(3.0, rel=0.15)
    assert model.rows(columns).sigma_cm[0] >= SENSOR.reading_model.sigma_cm
