"""Effects against hand-worked numbers, and model files that name them."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from msp_lab.cli import app as lab_app
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.cli import app
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model, load_model
from msp_sim.model.sampler import Sampler
from msp_sim.model.streams import RandomStreams
from tests.property.test_effects import strong
from tests.support.humid_air import speed_of_sound_humid

SENSORS = Path(__file__).parents[4] / "configs" / "sensors"


def sensor(*effects: dict[str, Any], **changes: Any) -> SensorModel:
    """The shipped sensor model with these effects."""
    return load_sensor_model(SENSORS / "mb1242.yaml").model_copy(update={"effects": effects, **changes})


def centre_cm(name: str, values: dict[str, Any], **context: float) -> float:
    """Where hits lie with one effect."""
    model = Model.of(sensor()).adding(name, **values)
    return float(model.rows({key: np.array([value]) for key, value in context.items()}).centre_cm[0])


def test_cold_air_reads_too_far() -> None:
    """The datasheet's 22.5 deg C against freezing: +4.0 %."""
    at_0 = centre_cm("air_temperature", {"share": 1.0}, true_range_cm=300.0, air_temperature_c=0.0)
    assert at_0 == pytest.approx(300.0 * math.sqrt(295.65 / 273.15), rel=1e-9)


def test_the_hot_box_errs_by_one_to_two_centimetres() -> None:
    """Report 4.3.5: 115 F in the box, a room at 70 F, and 1-2 cm at all ranges, where eq 7 alone would give 3.8 %."""
    model = Model.of(sensor()).adding("air_temperature", share=1.0).adding("hot_box", share=1.0)
    range_cm = np.arange(40.0, 261.0, 20.0)
    columns = {
        "true_range_cm": range_cm,
        "air_temperature_c": np.full(12, 46.1),
        "target_temperature_c": np.full(12, 21.1),
    }
    error_cm = model.rows(columns).centre_cm - range_cm
    # 30 cm at 46.1 deg C read 1.1 cm short; the rest, at 21.1 deg C, 0.24 % long.
    assert error_cm == pytest.approx(0.0024 * (range_cm - 30.0) - 1.13, abs=0.03)
    del columns["target_temperature_c"]
    assert model.rows(columns).centre_cm[-1] - 260.0 == pytest.approx(-9.8, abs=0.1)


def test_a_linear_gradient_is_the_integral_along_the_path() -> None:
    steps = np.linspace(30.0, 10.0, 100_001)
    slowness = np.trapezoid(1.0 / np.sqrt(steps + 273.15), dx=1e-5)
    model = Model.of(sensor()).adding("air_temperature", share=1.0).adding("temperature_gradient", share=1.0)
    columns = {"true_range_cm": [400.0], "air_temperature_c": [30.0], "target_temperature_c": [10.0]}
    assert model.rows(columns).centre_cm[0] == pytest.approx(400.0 * slowness * math.sqrt(295.65), rel=1e-6)


def test_humidity_is_cramers_to_a_twentieth() -> None:
    for temperature_c in (10.0, 20.0, 30.0):
        dry, humid = (speed_of_sound_humid(Atmosphere(temperature_c, percent)) for percent in (0.0, 100.0))
        read_cm = centre_cm(
            "humidity", {"share": 1.0}, true_range_cm=500.0, air_temperature_c=temperature_c, humidity_pct=100.0
        )
        assert 500.0 - read_cm == pytest.approx(500.0 * (1.0 - dry / humid), rel=0.06)


def test_a_thermometer_that_shows_too_much() -> None:
    """10 C too much at 15 C shown: the air has 5."""
    read_cm = centre_cm("thermometer_offset", {"offset_c": 10.0}, true_range_cm=300.0, air_temperature_c=15.0)
    assert read_cm == pytest.approx(300.0 * math.sqrt(288.15 / 278.15), rel=1e-9)


def test_motion_and_latency() -> None:
    """At 3 m/s and 4 m the vehicle moves 3.5 cm while the sound is on its way; 100 ms of delay are 30 cm."""
    moving = {"true_range_cm": 400.0, "range_rate_cm_s": 300.0}
    assert centre_cm("motion_during_ping", {"share": 1.0}, **moving) == pytest.approx(403.48, abs=0.01)
    assert centre_cm("latency", {"delay_ms": 100.0}, **moving) == pytest.approx(370.0)


def test_tilted_beams() -> None:
    tilted = {"true_range_cm": 200.0, "incidence_deg": -20.0}
    assert centre_cm("slant_range", {"share": 1.0}, **tilted) == pytest.approx(212.836, abs=1e-3)
    assert centre_cm("slant_range", {"share": 1.0}, **tilted, slant_range_cm=205.0) == pytest.approx(205.0)
    # The beam's half angle at 2 m is 12.6 deg: its edge is 7.4 deg off the normal.
    assert centre_cm("nearest_point", {"share": 1.0}, **tilted) == pytest.approx(200.0 / math.cos(math.radians(7.4)))
    half = {"share": 1.0, "beam": 0.5}
    assert centre_cm("nearest_point", half, **tilted) == pytest.approx(200.0 / math.cos(math.radians(13.7)))
    # Of a surface that is steeper than 85 deg the nearest point is not behind the sensor.
    steep = 200.0 / math.cos(math.radians(85.0 - 12.6))
    assert centre_cm("nearest_point", {"share": 1.0}, true_range_cm=200.0, incidence_deg=120.0) == pytest.approx(steep)


def test_the_false_echo_of_a_neighbour() -> None:
    """A neighbour that looks 150 cm far and pinged 2 ms before: 69 cm of sound, half of it as range."""
    model = Model.of(sensor()).adding("crosstalk", share=1.0, sigma_cm=0.1)
    columns = {"true_range_cm": [150.0], "neighbour_range_cm": [150.0], "neighbour_lag_ms": [2.0]}
    false_cm = round(150.0 - 100.0 * 344.7 * 0.002 / 2.0)
    assert model.sample(columns, np.random.default_rng(1)).tolist() == [false_cm]
    for lag_ms in (-1.0, 8.0, 100.0):
        rows = model.rows({**columns, "neighbour_lag_ms": [lag_ms]})
        assert rows.added[0].odds.tolist() == [0.0], "later, too near, or long gone"


@pytest.mark.parametrize(
    ("name", "arrives"),
    [("or_ed_bytes", 45.0), ("saturated_byte", 255.0), ("lost_high_byte", 44.0), ("clock_fault", 33068.0)],
)
def test_what_becomes_of_300(name: str, arrives: float) -> None:
    quiet = sensor(reading_model=sensor().reading_model.model_copy(update={"sigma_cm": 0.01}))
    model = Model.of(quiet).adding(name, share=1.0)
    columns = {"true_range_cm": np.full(200, 300.0)}
    readings_cm = model.sample(columns, np.random.default_rng(1))
    assert np.median(readings_cm) == arrives
    assert np.exp(model.log_prob([arrives], {"true_range_cm": [300.0]}))[0] > 0.95


def test_a_small_target_is_weaker_from_2_areas_over_the_wavelength() -> None:
    """A plate of 5 cm answers as a wall does up to 0.61 m; at 2.4 m it is 12 dB weaker."""
    model = Model.of(sensor()).adding("small_target", log_odds_per_10db=1.0)
    rows = model.rows({"true_range_cm": [50.0, 4 * 60.93], "target_size_cm": [5.0, 5.0]})
    assert rows.log_weights[2] - math.log(0.02) == pytest.approx([0.0, 1.204], abs=0.002)


def test_one_reading_at_a_time_is_missed_more_often_far_away() -> None:
    of = sensor()
    grown = of.reading_model.model_copy(update={"sigma_growth_cm_per_m": 1.0, "missed_growth_per_m": 1.5})
    model = Model.of(of.model_copy(update={"reading_model": grown}))
    sampler, streams = Sampler(model, np.random.default_rng(7)), RandomStreams(np.random.default_rng(7))
    readings_cm = np.array([sampler.sample_one({"true_range_cm": 600.0}) for _ in range(400)])
    many = [model.sample({"true_range_cm": [600.0]}, streams)[0] for _ in range(400)]
    assert readings_cm.tolist() == many
    # Odds of 1 to 49 at 3 m are 90 times as much at 6 m.
    assert np.isin(readings_cm, (255, 765)).mean() == pytest.approx(0.65, abs=0.08)


def test_a_slanting_sensor_reads_the_slant_range() -> None:
    model = Model.of(sensor(oblique_reading="slant"))
    assert [each.effect.name for each in model.effects] == ["slant_range"]
    assert model.rows({"true_range_cm": [200.0], "incidence_deg": [20.0]}).centre_cm[0] == pytest.approx(
        212.836, abs=1e-3
    )


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"name": "prop_wosh", "parameters": {}}, r"effects\[0\].name: found 'prop_wosh'.*Did you mean 'prop_wash'\?"),
        ({"name": "prop_wash"}, r"effects\[0\].parameters.log_odds: this key is missing; expected log odds at full"),
        ({"name": "prop_wash", "parameters": {"log_odd": 1}}, r"parameters.log_odd: unknown; prop_wash has log_odds"),
        ({"name": "prop_wash", "parameters": {"log_odds": 99}}, r"log_odds: found 99, expected -10 to 10 \[1\]"),
        ({"name": "prop_wash", "parameters": {"log_odds": "much"}}, r"log_odds: found 'much', expected a number"),
        ({"name": "prop_wash", "parameters": [1]}, r"parameters: found \[1\], expected names with numbers"),
        ({"name": "prop_wash", "of": "left", "parameters": {"log_odds": 1}}, r"of: found 'left', expected nothing"),
        (
            {"name": "mounting_offset", "parameters": {"offset_cm": 1}},
            r"of: found nothing, expected the name of a sens",
        ),
        ({"name": "prop_wash", "parameter": {}}, r"effects\[0\].parameter: unknown key. Did you mean 'parameters'\?"),
    ],
)
def test_user_errors_in_a_model_file_are_named(entry: dict[str, Any], text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=text):
        Model.of(sensor(entry))
    path = tmp_path / "wrong.yaml"
    text_of = (SENSORS / "mb1242.yaml").read_text()
    path.write_text(text_of[: text_of.index("effects:")] + f"effects: [{json.dumps(entry)}]\n")
    with pytest.raises(ConfigError, match=f"^{path}: effects"):
        load_model(path)


def test_an_interval_in_a_model_file_is_its_value() -> None:
    model = load_model(SENSORS / "mb1242_in_flight.yaml")
    assert [each.stream for each in model.effects][-1] == "mounting_offset of front_left"
    assert model.effects[4].values == {"share": 0.01, "sigma_cm": 3.0}


def test_contexts_that_do_not_fit_are_refused() -> None:
    model = strong("prop_wash")
    with pytest.raises(ValueError, match=r"found the context columns \['throttle'\], expected 'true_range_cm'"):
        model.sample({"throttle": np.zeros(3)}, np.random.default_rng(1))
    with pytest.raises(ValueError, match=r"different lengths: \{.*\}"):
        model.sample({"true_range_cm": np.zeros(3), "throttle": np.zeros(2)}, np.random.default_rng(1))
    with pytest.raises(ValueError, match=r"found readings of shape \(2,\) and true_range_cm of shape \(3,\)"):
        model.log_prob([20, 30], {"true_range_cm": np.zeros(3)})
    with pytest.raises(ValueError, match=r"expected one dimension"):
        model.sample({"true_range_cm": 300.0}, np.random.default_rng(1))
    assert model.sample({"true_range_cm": []}, np.random.default_rng(1)).shape == (0,)


def test_what_cannot_be_read_has_no_probability() -> None:
    readings_cm = [19.0, 766.0, 300.5, math.nan, 33068.0, -20.0, math.inf]
    columns = {"true_range_cm": np.full(7, 300.0)}
    assert (Model.of(sensor()).log_prob(readings_cm, columns) == -math.inf).all()
    faulty = Model.of(sensor()).adding("clock_fault", share=0.5)
    assert faulty.log_prob(readings_cm, columns)[4] == pytest.approx(math.log(0.5 * 0.195), abs=0.02)


def test_the_catalogue_explains_itself() -> None:
    assert all(name == effect.name for name, effect in CATALOGUE.items())
    listed = CliRunner().invoke(lab_app, ["effects"]).output
    data = json.loads(CliRunner().invoke(lab_app, ["effects", "--json"]).output)
    assert [each["name"] for each in data] == list(CATALOGUE)
    assert all(f"{name} (" in listed for name in CATALOGUE)


def test_samples_of_a_model_file_with_effects(tmp_path: Path) -> None:
    """A column that is absent is named; the others act."""
    csv = tmp_path / "contexts.csv"
    csv.write_text("true_range_cm,air_temperature_c\n" + "300,0\n" * 400)
    arguments = ["sample", SENSORS / "mb1242_in_flight.yaml", "--contexts", csv, "--out", tmp_path / "readings.csv"]
    result = CliRunner().invoke(app, [str(each) for each in arguments])
    assert result.exit_code == 0, result.output
    assert "prop_wash has no effect: there is no column throttle" in result.stderr
    readings_cm = np.loadtxt(tmp_path / "readings.csv", delimiter=",", skiprows=1, usecols=0)
    assert np.median(readings_cm) == pytest.approx(312.0, abs=1.0)
