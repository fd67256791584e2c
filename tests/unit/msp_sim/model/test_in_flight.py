"""Plain numbers of what effects make of a flight's readings, for the bridge."""

from dataclasses import replace

import numpy as np
import pytest

from msp_range.assembly import expected_of
from msp_range.health import Expected
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.model.in_flight import in_flight
from msp_sim.model.model import Model, Term
from tests.support.curves import with_curve
from tests.support.shipped import CONFIGS

SENSOR = load_sensor_model(CONFIGS / "sensors" / "mb1242.yaml")
DOWN = (0.0, 0.0, 1.0)


def flown(model: Model, throttle: float = 0.5, true_range_cm: float = 300.0) -> SensorModel:
    """The sensor model with its numbers of a flight at one height and throttle."""
    contexts = {"true_range_cm": np.full(500, true_range_cm), "throttle": np.full(500, throttle)}
    numbers = in_flight(model, contexts, np.random.default_rng(1))
    return model.sensor.model_copy(update={"in_flight": numbers})


def test_the_numbers_are_those_of_the_readings_with_the_effects() -> None:
    base = flown(Model.of(SENSOR).adding("random_readings", log_odds=0.001)).in_flight
    assert base is not None
    # Short readings, and random ones nearer than the surface but for its neighbourhood; missed as the weights have it.
    assert base.short == pytest.approx(0.01 * 0.97 + 0.01 * 270 / 746, abs=0.002)
    assert base.missed == pytest.approx(0.02, abs=0.002)
    assert base.sigma_cm == pytest.approx(SENSOR.reading_model.sigma_cm, rel=0.02)
    loud = Model.of(SENSOR).adding("rotor_noise", growth=2.0).adding("prop_wash", log_odds=4.0)
    numbers = flown(loud).in_flight
    assert numbers is not None
    assert numbers.sigma_cm == pytest.approx(2.0 * SENSOR.reading_model.sigma_cm, rel=0.03)
    assert numbers.short > 4 * base.short


def test_effects_that_change_the_mean_need_no_numbers_nor_does_a_flight_out_of_range() -> None:
    assert flown(Model.of(SENSOR).adding("mounting_offset", of="a", offset_cm=2.0)).in_flight is None
    assert flown(Model.of(SENSOR).adding("prop_wash", log_odds=4.0), true_range_cm=700.0).in_flight is None


def test_what_the_bridge_does_not_know_has_numbers_even_if_it_changes_the_mean_only() -> None:
    own = replace(CATALOGUE["range_scale"], name="supply_sag")
    curve = with_curve(Model.of(SENSOR), "bias", ["throttle"], [[0.0, 1.0]], [-2.0, 2.0])
    for model in (Model(SENSOR, (Term(own, {"scale_pct": 2.0}),)), curve):
        numbers = flown(model).in_flight
        assert numbers is not None
        assert numbers.sigma_cm == pytest.approx(SENSOR.reading_model.sigma_cm, rel=0.02)


def test_hits_that_scatter_by_metres_have_no_numbers_by_which_to_watch_them() -> None:
    """As of sensors in all directions that are compared with the height."""
    poor = SENSOR.reading_model.model_copy(update={"sigma_cm": 90.0})
    wide = Model.of(SENSOR.model_copy(update={"reading_model": poor})).adding("rotor_noise", growth=2.0)
    assert flown(wide, true_range_cm=500.0).in_flight is None


def test_a_model_file_with_the_numbers_switches_the_watch_on() -> None:
    model = Model.of(SENSOR).adding("prop_wash", log_odds=4.0)
    without = SENSOR.model_copy(update={"effects": ({"name": "prop_wash", "parameters": {"log_odds": 4.0}},)})
    assert expected_of(without, DOWN, 0.4) == "no numbers (in_flight) of what prop_wash make of the readings"
    numbers = flown(model).in_flight
    known = expected_of(without.model_copy(update={"in_flight": numbers}), DOWN, 0.4)
    assert isinstance(known, Expected)
    assert numbers is not None
    assert (known.short, known.random) == (numbers.short, 0.0)
